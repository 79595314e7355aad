"""Comparison of two campaigns of logs, for the Python interface."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Unpack

from seatrial.api import tables
from seatrial.api.arguments import as_path, output_folder
from seatrial.api.calls import python_call
from seatrial.api.fits import FitOptions, Logs, vehicle_request
from seatrial.api.fleet import common_window
from seatrial.api.logs import PathLike, as_logs
from seatrial.api.messages import Messages, errors_of_users, in_python, text_of, warn_of_result
from seatrial.api.shown import Content, Shown, number
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import import_library

if TYPE_CHECKING:
    from seatrial.ident.results import CampaignsResult


@dataclass(frozen=True, repr=False)
class CampaignComparison(Shown):
    """Comparison of two campaigns of logs by one model. `compare_campaigns` returns it.

    Attributes
    ----------
    result : CampaignsResult
        Content of result.json: the differences of parameters and effects, their tests, and the prediction errors.
    table : pyarrow.Table
        All estimates: a row for each log and parameter, and one for each failed log, with the columns of fits.parquet.
    """

    result: CampaignsResult
    table: Any

    @property
    def answer(self) -> str:
        """Changed parameters with their sizes, and the prediction errors with and without the changes."""
        return tables.conclusion(self.result)

    @property
    def changed(self) -> list[str]:
        """Names of the combinations and parameters that have changed, such as ``drag ahead at 1 m/s`` and ``d_uu``.

        Parameters of noise, disturbances and sensors are left out.
        """
        return [p.name for p in (*self.result.changed_combinations, *self.result.changed)]

    def to_pandas(self) -> Any:
        """Return the differences as a ``pandas.DataFrame`` with a row for each parameter, in SI units and radians.

        The rows of combinations of parameters, such as the drag at a speed, come first.

        The columns are before, after, difference, se, low, high, relative, scatter, p, q, changed, detectable and unit.
        The difference, its standard error and its interval (low, high) are in this unit, and so is detectable, the
        size from which on a difference would be a change. relative is the difference as a part of before.

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        names = ("difference", "se", "low", "high", "relative", "scatter", "p", "q", "changed", "detectable", "unit")
        rows = {
            p.name: {"before": p.before.mean, "after": p.after.mean} | {n: getattr(p, n) for n in names}
            for p in (*self.result.combinations, *self.result.parameters)
        }
        frame = import_library("pandas").DataFrame.from_dict(rows, orient="index", columns=["before", "after", *names])
        floats = [n for n in frame.columns if n not in ("changed", "unit")]
        return frame.astype(dict.fromkeys(floats, float))

    def save(self, folder: PathLike) -> Path:
        """Write result.json and report.html to a folder, as ``seatrial ident changes``, and return the folder.

        fits.parquet is written during the fits, if `compare_campaigns` gets the folder as ``out``. `table` has its
        rows.

        Parameters
        ----------
        folder : path
            Folder, which is created if it does not exist. Existing files of the same names are replaced.
        """
        from seatrial.ident.workflows.changes import write_changes

        found = output_folder(folder)
        write_changes(self.result, found)
        return found

    def summary(self) -> str:
        """Return the answer and the tables as text, as the command does."""
        return text_of(self.result)

    def _content(self) -> Content:
        """Return the answer, the notes, and a row for each combination and parameter with its change and q value.

        Combinations come first, of these and of the parameters the changed ones. Angles are in degrees.
        """
        from seatrial.ident.report.formatting import degrees_for
        from seatrial.ident.report.sections.campaigns import absolute_change, change_of, joint_words
        from seatrial.ident.results import q_beside

        rows, rate = [], self.result.false_discovery_rate
        combinations = sorted(self.result.combinations, key=lambda c: not c.changed)
        for p in (*combinations, *self.result.changed_first):
            factor, unit = degrees_for(p.unit)
            means = (number(factor * m.mean) for m in (p.before, p.after))
            rows.append(
                (p.name, *means, absolute_change(p), unit, change_of(p), "" if p.q is None else q_beside(p.q, rate))
            )
        return Content(
            self.answer,
            (),
            ("", "before", "after", "change", "", "change (95 %)", "q"),
            rows,
            tuple(map(in_python, filter(None, (joint_words(self.result), *self.result.notes)))),
        )

    def __repr__(self) -> str:
        """Return a short text for the interpreter: number of logs, and `answer`."""
        return f"<CampaignComparison: {len(self.result.campaigns)} logs>\n{self.answer}\nsummary() has the tables."


def compare_campaigns(
    before: Logs,
    after: Logs,
    model: PathLike = "auto",
    out: PathLike | None = None,
    false_discovery_rate: float = 0.05,
    backend: Literal["loky", "dask", "ray"] = "loky",
    scheduler: str = "",
    jobs: int = -1,
    force: bool = False,
    common_errors: bool = True,
    **options: Unpack[FitOptions],
) -> CampaignComparison:
    """Fit one model to the logs of two campaigns, and find what differs, as ``seatrial ident changes``.

    The question is whether the means of two groups of logs differ. Whether one parameter is the same in all logs of one
    fit is another question, which ``st.fit(logs, homogeneity="NAME")`` asks.

    Parameters
    ----------
    before, after : path, `Log` or sequence of them
        Logs of each campaign. All windows of `Log` have to be the same. One campaign needs two logs, three of each are
        better.
    model : str or path
        Name of the structure, as in `fit`, or a model.toml, whose structure and effects are fitted again.
    out : path, optional
        Folder for fits.parquet, result.json and report.html. A run that was interrupted continues there. Without it, no
        file is written.
    false_discovery_rate : float
        Largest expected share of false ones among the changed parameters, above 0 and at most 0.5.
    backend, scheduler, jobs, force
        As in `fit_many`.
    common_errors : bool
        Whether the first four logs before are fitted together first, and the small errors of sensors and hull form that
        they show are added to the model of all logs, with a difference of the thrusts of both sides. A model.toml gets
        this difference only, and a model of your own nothing.
    **options
        `FitOptions` of each fit, which ``help(st.FitOptions)`` describes, except ``profiles``,
        ``homogeneity``, ``per_log`` and ``thrust_of``. The default of ``score_tests`` is False.

    Returns
    -------
    CampaignComparison
        Differences between the campaigns.

    Raises
    ------
    SeatrialError
        As `fit_many`, or if a log is in both campaigns, or if no fit of a campaign converges.

    Examples
    --------
    >>> found = st.compare_campaigns(["may1.mcap", "may2.mcap"], ["june1.mcap", "june2.mcap"], fixed={"c1": 40.0})
    >>> found.changed
    ['drag ahead at 1 m/s', 'd_uu']
    """
    from seatrial.ident.parallel import Workers
    from seatrial.ident.workflows.changes import ChangesRequest, find_changes

    if not 0.0 < false_discovery_rate <= 0.5:
        raise SeatrialError(f"false_discovery_rate={false_discovery_rate:g}: give a number above 0, at most 0.5")
    earlier, later = as_logs(before, after)
    window = common_window(options, before, after)
    with errors_of_users():
        vehicle, progress = vehicle_request((), (), str(model), window, {"score_tests": False, **options})
        folder = None if out is None else as_path(out, "out")
        request = ChangesRequest(
            earlier, later, vehicle, folder, Workers(jobs, backend, scheduler), force, false_discovery_rate,
            common_errors,
        )  # fmt: skip
        arguments: dict[str, Any] = {"before": before, "after": after, "model": model, "out": out}
        arguments |= {"false_discovery_rate": false_discovery_rate, "backend": backend, "scheduler": scheduler}
        command = python_call(
            compare_campaigns, {**arguments, "jobs": jobs, "force": force, "common_errors": common_errors, **options}
        )
        messages = Messages(progress)
        done = find_changes(request, command, messages)
        warn_of_result(done.result, messages)
    return CampaignComparison(done.result, done.table)
