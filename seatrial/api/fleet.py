"""Fits of one model to many logs, for the Python interface."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Unpack

from seatrial.api import tables
from seatrial.api.arguments import as_path
from seatrial.api.calls import python_call
from seatrial.api.fits import FitOptions, Logs, vehicle_request, window_of
from seatrial.api.logs import PathLike, as_paths
from seatrial.api.messages import Messages, errors_of_users, in_python, text_of, warn_of_result
from seatrial.api.shown import Content, Shown, number
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import import_library

if TYPE_CHECKING:
    from seatrial.ident.data import TimeWindow
    from seatrial.ident.results import FleetResult

TEXTS = ("error", "warning_texts")  # columns of the table with sentences


@dataclass(frozen=True, repr=False)
class FittedFleet(Shown):
    """One model that was fitted to each of many logs. `fit_many` returns it.

    Attributes
    ----------
    result : FleetResult
        Content of result.json: for each parameter the mean over the logs, and the differences between the logs.
    table : pyarrow.Table
        All estimates: a row for each log and parameter, and one for each failed log, with the columns of fits.parquet.
    """

    result: FleetResult
    table: Any

    @property
    def answer(self) -> str:
        """Number of fits, and the parameters that differ between the logs, in one or two sentences."""
        return tables.conclusion(self.result)

    @property
    def failed(self) -> dict[str, str]:
        """Reason by log of each log without a fit, in one line; empty if the model was fitted to all logs."""
        return {row.log: in_python(row.reason) for row in self.result.failed}

    def to_pandas(self) -> Any:
        """Return all estimates as a ``pandas.DataFrame`` with a row for each log and parameter.

        The columns are those of fits.parquet, such as log, parameter, value, se, unit, flag, converged and error.
        A flag is a short code, such as ``at bound``; `table` has its text.

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        import_library("pandas")
        frame = self.table.to_pandas()
        if "flag_codes" in frame:  # a table of an earlier version has texts alone
            frame["flag"] = frame.pop("flag_codes")
        for name in TEXTS:
            if name in frame:
                frame[name] = [in_python(x) if isinstance(x, str) else x for x in frame[name]]
        return frame

    def values(self, column: str = "value") -> Any:
        """Return one column of the estimates as a ``pandas.DataFrame`` with a row for each log, a column for each name.

        Logs without a fit are left out.

        Parameters
        ----------
        column : str
            Column of `to_pandas`, such as ``value`` or ``se``.

        Raises
        ------
        SeatrialError
            If pandas is not installed, or if there is no such column.
        """
        frame = self.to_pandas()
        if column not in frame:
            raise SeatrialError(f"there is no column {column!r}; choose one of {', '.join(frame)}")
        rows = frame.dropna(subset=["parameter"])
        wide = rows.pivot(index="log", columns="parameter", values=column)
        return wide[list(dict.fromkeys(rows["parameter"]))]

    def summary(self) -> str:
        """Return the answer, the differences between the logs and the failed logs as text, as the command does."""
        return text_of(self.result)

    def _content(self) -> Content:
        """Return the answer, the failed logs, and the mean of each parameter with its differences between the logs."""
        rows = [
            (p.name, str(p.n), number(p.mean), number(p.se_mean, 2), number(p.sd, 2), number(p.p, 2), p.unit)
            for p in self.result.parameters
        ]
        failed = [f"{log}: {reason}" for log, reason in self.failed.items()]
        return Content(self.answer, failed, ("", "logs", "mean", "s.e.", "sd between logs", "p", "unit"), rows)

    def __repr__(self) -> str:
        """Return a short text for the interpreter: number of logs, and `answer`."""
        return (
            f"<FittedFleet: {self.result.n_logs} logs>\n{self.answer}\nsummary() has the differences between the logs."
        )


def fit_many(
    logs: Logs,
    model: str = "auto",
    out: PathLike | None = None,
    backend: Literal["loky", "dask", "ray"] = "loky",
    scheduler: str = "",
    jobs: int = -1,
    force: bool = False,
    **options: Unpack[FitOptions],
) -> FittedFleet:
    """Fit a model of the boat to each of many logs in parallel, as ``seatrial ident fleet``.

    Parameters
    ----------
    logs : path, `Log` or sequence of them
        Logs, to each of which the model is fitted. A folder stands for all logs in it. All windows of `Log` have to be
        the same.
    model : str
        Name of the structure, as in `fit`.
    out : path, optional
        Folder for fits.parquet and result.json. A run that was interrupted continues there. Without it, no file is
        written.
    backend : ``loky``, ``dask`` or ``ray``
        Processes of this computer, or a Dask or Ray cluster.
    scheduler : str
        Address of the scheduler of a Dask cluster, or of the head of a Ray cluster; empty: one is started on this
        computer.
    jobs : int
        Number of processes on this computer; -1: one for each core.
    force : bool
        Whether to start again if ``out`` has fits.
    **options
        `FitOptions` of each fit, which ``help(st.FitOptions)`` describes, except ``profiles``,
        ``homogeneity`` and ``per_log``. With ``progress``, a line is printed for each log.

    Returns
    -------
    FittedFleet
        Estimates of all logs and the differences between them. A log that fails, also one that is missing, is
        listed with the reason.

    Raises
    ------
    SeatrialError
        If ``out`` has fits with other options, if a library is missing, if the cluster cannot be used, or if an option
        is unknown.

    Examples
    --------
    >>> fleet = st.fit_many(sorted(Path("logs").glob("*.mcap")), thruster="thruster/model.toml", out="fleet")
    >>> fleet.values()["m_u"].plot()
    >>> st.fit_many(logs, backend="dask", scheduler="tcp://192.168.1.5:8786", out="fleet").answer
    """
    from seatrial.ident.parallel import Workers
    from seatrial.ident.workflows.fleet import FleetRequest, fit_fleet

    window = common_window(options, logs)
    with errors_of_users():
        vehicle, progress = vehicle_request((), (), model, window, options)
        paths, folder = as_paths(logs, existing=False), None if out is None else as_path(out, "out")
        request = FleetRequest(paths, vehicle, folder, Workers(jobs, backend, scheduler), force)
        messages = Messages(progress)
        arguments = {"logs": logs, "model": model, "out": out, "backend": backend, "scheduler": scheduler}
        command = python_call(fit_many, {**arguments, "jobs": jobs, "force": force, **options})
        done = fit_fleet(request, command, messages)
        warn_of_result(done.result, messages)
    return FittedFleet(done.result, done.table)


def common_window(options: Mapping[str, Any], *logs: Logs) -> TimeWindow:
    """Return the one window of all logs of a run over many logs.

    The ``options`` may not have ``profiles``, ``homogeneity`` or ``per_log``, which belong to one fit.

    Raises
    ------
    SeatrialError
        If the options include one of these, or if the logs have different windows.
    """
    from seatrial.ident.data import TimeWindow

    if "homogeneity" in options:
        raise SeatrialError("homogeneity: this tests all logs of one fit together; use st.fit(logs, homogeneity=...)")
    if "profiles" in options:
        raise SeatrialError("profiles: the table of many logs has no profile likelihoods; compute them by st.fit")
    if "per_log" in options:
        raise SeatrialError(
            "per_log: each log has a fit of its own here, so that all parameters differ between the logs"
        )
    windows = {window_of(x) for x in logs}
    window = windows.pop()
    if windows or not isinstance(window, TimeWindow):
        raise SeatrialError("the logs have different windows: open all of them with the same start and end")
    return window
