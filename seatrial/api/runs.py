"""Thruster tests, navigation and mission design of the Python interface."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal, TypedDict, TypeVar, Unpack

import numpy as np
from numpy.typing import NDArray

from seatrial.api.fits import (
    FitReport,
    FittedDiagnosis,
    FittedVehicle,
    Logs,
    Messages,
    errors_of_users,
    known_options,
    model_path,
    python_call,
    window_of,
)
from seatrial.api.logs import PathLike, as_paths
from seatrial.daq.files import write_output
from seatrial.daq.log import import_library

if TYPE_CHECKING:
    from seatrial.ident.results import DesignResult, NavigationResult, ThrustCurveResult, ThrusterResult

T = TypeVar("T")
Files = Mapping[str, bytes]


class ThrusterOptions(TypedDict, total=False):
    """Options of `thruster`. All are optional; the defaults are those of ``seatrial ident thruster``.

    Attributes
    ----------
    name : str
        Name of the thruster in the rig, if the logs have several.
    settle : float
        For a static curve: time that is left out after each change of command [s].
    profiles : sequence of str
        Parameters whose profile likelihood is computed.
    outlier_model : bool
        Whether all sensors may have outliers.
    reml : bool
        Whether the noise is estimated by restricted maximum likelihood.
    horizon : float
        Horizon of the predictions [s].
    despite_faults : bool
        Whether to fit logs with faults that make a fit meaningless.
    progress : bool
        Whether to print a line for each step of the computation.
    """

    name: str
    settle: float
    profiles: Sequence[str]
    outlier_model: bool
    reml: bool
    horizon: float
    despite_faults: bool
    progress: bool


class DesignOptions(TypedDict, total=False):
    """Options of `design`. All are optional; the defaults are those of ``seatrial mission design``.

    Attributes
    ----------
    duration : float
        Length of the mission [s].
    steps : int
        Number of steps; one for each 5 s if it is left out.
    criterion : ``D``, ``A``, ``E`` or ``Ds``
        Scalar of the information matrix that is maximised.
    chosen : tuple of str
        Parameters of the criterion; empty for all.
    between : tuple of two str
        Two effects that the mission has to tell apart; empty for none.
    n_max : float
        Largest command, as a part of full command.
    slew : float
        Slew limit of a command [1/s].
    shortest : float
        Length of the shortest step [s].
    rates : dict of str to float
        Rate of each sensor [Hz].
    evaluations : int
        Number of simulations of the search.
    seed : int
        Seed of all random draws.
    progress : bool
        Whether to print a line for each step of the computation.
    """

    duration: float
    steps: int
    criterion: Literal["D", "A", "E", "Ds"]
    chosen: tuple[str, ...]
    between: tuple[str, ...]
    n_max: float
    slew: float
    shortest: float
    rates: Mapping[str, float]
    evaluations: int
    seed: int
    progress: bool


@dataclass(frozen=True, repr=False)
class WrittenResult:
    """Result of a command with the files that the command writes.

    Attributes
    ----------
    result : Result
        Content of result.json.
    files : dict of str to bytes
        Files that ``save`` writes, by name.
    """

    result: Any
    files: Files = field(repr=False, default_factory=dict)

    @property
    def answer(self) -> str:
        """Answer in one or two sentences."""
        return str(self.result.answer)

    @property
    def warnings(self) -> list[str]:
        """Warnings, as sentences."""
        return [w.text for w in self.result.warnings]

    def save(self, folder: PathLike) -> Path:
        """Write the files of the command to a folder, which is created, and return its path.

        Parameters
        ----------
        folder : path
            Folder. Existing files of the same names are replaced.
        """
        out = Path(folder)
        out.mkdir(parents=True, exist_ok=True)
        for name, content in self.files.items():
            write_output(out / name, content)
        return out


@dataclass(frozen=True, repr=False)
class FittedThruster(FitReport, WrittenResult):
    """Model of a thruster that was fitted to bench logs. `thruster` returns it.

    Attributes
    ----------
    result : ThrusterResult
        Content of result.json.
    files : dict of str to bytes
        Files that ``save`` writes: model.toml, result.json and report.html.
    """

    result: ThrusterResult


@dataclass(frozen=True, repr=False)
class ThrustCurve(WrittenResult):
    """Static thrust curve of a thruster whose shaft speed was not logged. `thruster` returns it.

    Attributes
    ----------
    result : ThrustCurveResult
        Content of result.json.
    files : dict of str to bytes
        Files that ``save`` writes: model.toml, result.json and report.html.
    """

    result: ThrustCurveResult

    def to_pandas(self) -> Any:
        """Return the measured points as a ``pandas.DataFrame``: command or shaft speed, force [N], standard error [N].

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        static = self.result.static
        return import_library("pandas").DataFrame({"n": static.n, "force": static.force, "se": static.sd})

    def __repr__(self) -> str:
        """Return the number of points and the answer."""
        return f"<ThrustCurve: {self.result.static.n.size} points>\n{self.answer}"


@dataclass(frozen=True, repr=False)
class Navigated(WrittenResult):
    """States of logs that a model has estimated. `navigate` returns it.

    Attributes
    ----------
    result : NavigationResult
        Content of result.json.
    files : dict of str to bytes
        Files that ``save`` writes: a CSV file for each log, result.json and report.html.
    """

    result: NavigationResult

    @property
    def states(self) -> dict[str, dict[str, NDArray[np.float64]]]:
        """Time, states, standard deviations (``sd_u``) and current of each log, by name; arrays (n_rows,), SI units."""
        found = {}
        for name, content in self.files.items():
            if name.endswith(".csv"):
                head, *rows = csv.reader(content.decode("utf-8").splitlines())
                found[name.removesuffix(".csv")] = dict(zip(head, np.array(rows, dtype=np.float64).T, strict=True))
        return found

    def to_pandas(self) -> Any:
        """Return the states of all logs as a ``pandas.DataFrame``, with the name of the log in the column ``log``.

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        pandas = import_library("pandas")
        frames = [pandas.DataFrame({"log": name, **columns}) for name, columns in self.states.items()]
        return pandas.concat(frames, ignore_index=True)

    def __repr__(self) -> str:
        """Return the names of the logs and the answer."""
        return f"<Navigated: {', '.join(self.states)}>\n{self.answer}"


def thruster(logs: Logs, **options: Unpack[ThrusterOptions]) -> FittedThruster | ThrustCurve:
    """Fit shaft dynamics and thrust curve to bench logs of one thruster, as ``seatrial ident thruster``.

    Parameters
    ----------
    logs : path, `Log` or sequence of them
        Bench logs.
    **options
        `ThrusterOptions`: name, settle, profiles, outlier_model, reml, horizon, despite_faults, progress.

    Returns
    -------
    FittedThruster or ThrustCurve
        The model, or only a static curve if the logs have no shaft speed. ``save`` writes the files of the command.

    Raises
    ------
    SeatrialError
        If the logs lack signals or have faults that make a fit meaningless.

    Examples
    --------
    >>> bench = st.thruster("bench.mcap")
    >>> bench.params["c1"]
    >>> st.fit("run1.mcap", thruster=bench.save("thruster") / "model.toml")
    """
    from seatrial.ident.estimation import EstimationOptions
    from seatrial.ident.results import ThrusterResult
    from seatrial.ident.workflows.thruster import ThrusterRequest, characterise

    given: dict[str, Any] = dict(options)
    reporter = Messages(given.pop("progress", False))
    estimation = {n: given.pop(n) for n in ("outlier_model", "reml", "horizon") if n in given}
    how = replace(EstimationOptions(reml=True), **estimation)
    paths = as_paths(logs)

    def work(out: Path) -> Any:
        """Run the workflow with this folder."""
        request = ThrusterRequest(paths, out, estimation=how, **known_options(given, ThrusterRequest))
        return characterise(request, python_call("thruster", paths), reporter)

    result, files = _with_files(work)
    return FittedThruster(result, files) if isinstance(result, ThrusterResult) else ThrustCurve(result, files)


def navigate(
    model: PathLike | FittedVehicle | FittedDiagnosis,
    logs: Logs,
    gnss_outages: Sequence[tuple[float, float]] = (),
    smoothed: bool = True,
    thruster: PathLike | None = None,
    rate: float = 10.0,
) -> Navigated:
    """Estimate position, heading, speeds, current and disturbance forces along logs, as ``seatrial ident navigate``.

    Parameters
    ----------
    model : path, `FittedVehicle` or `FittedDiagnosis`
        The fitted model.
    logs : path, `Log` or sequence of them
        Logs with different names, which the model should not have been fitted to.
    gnss_outages : sequence of (from, to)
        Intervals [s of the log] in which GNSS is withheld.
    smoothed : bool
        Whether states are estimated from all samples, or only from those so far.
    thruster : path, optional
        Static curve from command to thrust that the model was fitted with.
    rate : float
        Rate of the rows [Hz] to which faster sensors are averaged.

    Returns
    -------
    Navigated
        The states with their standard deviations. ``save`` writes the files of the command.

    Raises
    ------
    SeatrialError
        If two logs have one name, or if model and logs do not go together.

    Examples
    --------
    >>> st.navigate(fit, "run3.mcap", gnss_outages=[(60.0, 90.0)]).answer
    """
    from seatrial.ident.workflows.navigate import NavigationRequest, navigate_logs

    paths, curve = as_paths(logs), None if thruster is None else Path(thruster)

    def work(out: Path) -> Any:
        """Run the workflow with this folder."""
        request = NavigationRequest(path, paths, out, smoothed, gnss_outages, window_of(logs), rate, curve)
        return navigate_logs(request, python_call("navigate", paths), Messages(False))

    with model_path(model) as path:
        return Navigated(*_with_files(work))


def design(
    model: PathLike | FittedVehicle | FittedDiagnosis, out: PathLike, **options: Unpack[DesignOptions]
) -> DesignResult:
    """Design the next mission: commands that inform the parameters of a model most, as ``seatrial mission design``.

    Parameters
    ----------
    model : path, name, `FittedVehicle` or `FittedDiagnosis`
        A fitted model, or the name of a structure, such as ``horizontal:command``.
    out : path
        File of the mission, which must not exist. A .json file and an .html page are written beside it.
    **options
        `DesignOptions`: duration, steps, criterion, chosen, between, n_max, slew, shortest, rates, evaluations, seed,
        progress.

    Returns
    -------
    DesignResult
        Expected standard errors, comparison with baseline signals, and the commands.

    Raises
    ------
    SeatrialError
        If the model or an option cannot be used, or if a file exists.

    Examples
    --------
    >>> st.design(fit, "next.toml", duration=300.0).answer
    """
    from contextlib import nullcontext

    from seatrial.ident.workflows.design import DesignRequest, make_design

    given: dict[str, Any] = dict(options)
    reporter = Messages(given.pop("progress", False))
    fitted = isinstance(model, FittedVehicle | FittedDiagnosis) or Path(str(model)).exists()
    with errors_of_users(), model_path(model) if fitted else nullcontext(Path(str(model))) as source:
        request = DesignRequest(**known_options(given, DesignRequest))
        return make_design(str(source), request, Path(out), f"seatrial.design(out={str(out)!r})", reporter)


def _with_files(work: Callable[[Path], T]) -> tuple[T, Files]:
    """Run a workflow with a temporary folder; return its result and the files that it has written, by name."""
    with errors_of_users(), TemporaryDirectory() as folder:
        result = work(Path(folder))
        return result, {path.name: path.read_bytes() for path in sorted(Path(folder).iterdir())}
