"""Thruster tests, navigation and mission design of the Python interface."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal, TypedDict, TypeVar, Unpack, get_args

import numpy as np
from numpy.typing import NDArray

from seatrial.api import tables
from seatrial.api.arguments import (
    as_intervals,
    as_path,
    as_sides,
    check_number,
    check_rate,
    named_arguments,
    output_folder,
    shortened,
    with_short_help,
)
from seatrial.api.calls import python_call
from seatrial.api.fits import (
    FittedDiagnosis,
    FittedResult,
    FittedVehicle,
    Logs,
    check_parameters,
    known_options,
    model_path,
    window_of,
)
from seatrial.api.logs import PathLike, as_logs
from seatrial.api.messages import (
    OF_DESIGN,
    OF_THRUSTER,
    Messages,
    errors_of_users,
    warn_of_result,
    with_texts_in_python,
)
from seatrial.api.shown import Content, Shown, number
from seatrial.daq.errors import SeatrialError
from seatrial.daq.files import write_output
from seatrial.daq.log import import_library

if TYPE_CHECKING:
    from seatrial.api.loading import Saved
    from seatrial.ident.results import DesignResult, NavigationResult, ThrustCurveResult, ThrusterResult

T = TypeVar("T")
Files = Mapping[str, bytes]


@with_short_help
class ThrusterOptions(TypedDict, total=False):
    """Options of `thruster`. All are optional; the defaults are those of ``seatrial ident thruster``.

    An option without a default below is not set.

    Attributes
    ----------
    name : str
        Name of the thruster in the rig; needed if the logs have several thrusters.
    settle : float
        Time after each change of command that is left out from means of the force [s], 1.5 s by default.
    fixed : dict of str to float
        Parameters to hold at a known value, by name, in SI units: for example ``{"tau": 0.0}``.
    profiles : sequence of str
        Names of the parameters whose profile likelihood is computed.
    outlier_model : bool
        Whether outliers are part of the noise of all sensors, so that they have little weight. False by default.
    reml : bool
        Whether the noise is estimated by restricted maximum likelihood, True by default.
    horizon : float
        Horizon [s] of the predictions with which the fit is evaluated, 1 s by default.
    despite_faults : bool
        Whether to fit logs with faults that make a fit meaningless, False by default.
    progress : bool
        Whether to print a line for each step of the computation. Without it, a terminal or notebook shows a line every
        30 s.
    """

    name: str
    settle: float
    fixed: Mapping[str, float]
    profiles: Sequence[str]
    outlier_model: bool
    reml: bool
    horizon: float
    despite_faults: bool
    progress: bool


@with_short_help
class DesignOptions(TypedDict, total=False):
    """Options of `design`. All are optional; the defaults are those of ``seatrial mission design``.

    An option without a default below is not set.

    Attributes
    ----------
    duration : float
        Length of the mission [s], 600 s by default.
    steps : int
        Number of steps of the commands. If it is left out: one for each 5 s, but at least 8, and no more than the
        shortest step allows.
    criterion : ``D``, ``A``, ``E`` or ``Ds``
        Scalar of the Fisher information that is optimised: determinant (D, the default), mean variance (A), largest
        variance (E), or determinant of the chosen parameters (Ds).
    chosen : tuple of str
        Names of the parameters of the criterion; empty for all that the sensors observe.
    between : tuple of two str
        Names of two effects that the mission distinguishes; empty for a design by the criterion. The search usually
        takes 2 to 10 minutes.
    area : tuple of two float
        Sides (north, east) [m] of the area for the whole track, which begins with a heading of north. No limit by
        default.
    max_speed : float
        Largest speed through the water [m/s]. No limit by default.
    energy : float
        Largest mean of ``|n|^3`` over time and thrusters, 0 to 1 (full power). No limit by default.
    current : float
        Largest current [m/s], from any direction, in which the track has to keep to area and speed; 0 by default.
    n_max : float
        Largest magnitude of a command, 0 to 1 (full command); 1 by default.
    slew : float
        Slew limit of a command [1/s]. No limit by default.
    thruster : path
        Bench model (folder or model.toml) whose time constant the shafts have; 358 ms by default. A model with commands
        as inputs has its own shafts.
    shortest : float
        Length of the shortest step [s], 1 s by default.
    rates : dict of str to float
        Sample rates [Hz] by name of the sensor. Others have the rate of the data that the model was fitted to, or 10 Hz
        if it is unknown.
    prior_halfwidth : float
        Relative half-width of the prior of the parameters, 0 to 0.9, if the model is a structure without a fit; 0.25 by
        default.
    evaluations : int
        Number of simulations of the mission in the search for the best commands, at least 500; 20000 by default.
    seed : int
        Seed of all random draws, 1 by default.
    progress : bool
        Whether to print a line for each step of the computation. Without it, a terminal or notebook shows a line every
        30 s.
    """

    duration: float
    steps: int
    criterion: Literal["D", "A", "E", "Ds"]
    chosen: tuple[str, ...]
    between: tuple[str, ...]
    area: tuple[float, float]
    max_speed: float
    energy: float
    current: float
    n_max: float
    slew: float
    thruster: PathLike
    shortest: float
    rates: Mapping[str, float]
    prior_halfwidth: float
    evaluations: int
    seed: int
    progress: bool


@dataclass(frozen=True, repr=False)
class WrittenResult(Shown):
    """Result of a workflow, with the files that the command of the same name would write.

    Attributes
    ----------
    result : Result
        Content of result.json.
    files : dict of str to bytes
        Contents of the files that ``save`` writes, by name of the file.
    """

    result: Any
    files: Files

    @property
    def answer(self) -> str:
        """Main conclusion of the result in one or two sentences, as in its report."""
        return tables.conclusion(self.result)

    @property
    def warnings(self) -> list[str]:
        """Warnings of the result, one sentence each. The list is empty if the result has no warning."""
        return tables.warning_texts(self.result)

    @property
    def notes(self) -> list[str]:
        """Notes of the result, one text for each: assumptions and choices that the computation made."""
        return tables.note_texts(self.result)

    def _content(self) -> Content:
        """Return answer and warnings."""
        return Content(self.answer, self.warnings)

    def save(self, folder: PathLike) -> Path:
        """Write the files of the command to a folder, and return its path.

        Parameters
        ----------
        folder : path
            Folder, which is created if it does not exist. Existing files of the same names are replaced.
        """
        out = output_folder(folder)
        out.mkdir(parents=True, exist_ok=True)
        for name, content in self.files.items():
            write_output(out / name, content)
        return out


@dataclass(frozen=True, repr=False)
class FittedThruster(FittedResult, WrittenResult):
    """Model of a thruster that was fitted to bench logs. `thruster` returns it.

    It has no ``linearise`` and no ``steady``, which are those of a boat: the steady force over the command is
    ``result.static``, and the frequency response of the shaft ``result.shaft_response``.

    Attributes
    ----------
    result : ThrusterResult
        Content of result.json.
    fitted : FittedModel
        The fitted model with its records (`seatrial.ident.estimation.FittedModel`). A bench has no validation data.
    files : dict of str to bytes
        Files that ``save`` writes: model.toml, result.json and report.html.
    """

    result: ThrusterResult

    def save(self, folder: PathLike) -> Path:
        """Write the files of the command to a folder, and return its path.

        Parameters
        ----------
        folder : path
            Folder, which is created if it does not exist. Existing files of the same names are replaced.
        """
        return WrittenResult.save(self, folder)


@dataclass(frozen=True, repr=False)
class ThrustCurve(WrittenResult):
    """Static thrust curve of a thruster whose shaft speed was not logged: force against command.

    `thruster` returns it if the logs have no shaft speed.

    Attributes
    ----------
    result : ThrustCurveResult
        Content of result.json.
    files : dict of str to bytes
        Files that ``save`` writes: model.toml, result.json and report.html.
    """

    result: ThrustCurveResult

    def to_pandas(self) -> Any:
        """Return the measured points of the curve as a ``pandas.DataFrame`` with a row for each.

        The columns are ``n`` (normalised command or shaft speed, -1 to 1), ``force`` [N] and ``se`` (its standard error
        [N]).

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        static = self.result.static
        return import_library("pandas").DataFrame({"n": static.n, "force": static.force, "se": static.sd})

    def _content(self) -> Content:
        """Return answer, warnings and the measured points of the curve."""
        static = self.result.static
        rows = [
            (number(n, 3), number(force), number(se, 2))
            for n, force, se in zip(static.n, static.force, static.sd, strict=True)
        ]
        return Content(self.answer, self.warnings, ("command n", "force [N]", "s.e. [N]"), rows)

    def __repr__(self) -> str:
        """Return a short text for the interpreter: number of points of the curve, and `answer`."""
        return f"<ThrustCurve: {self.result.static.n.size} points>\n{self.answer}"


@dataclass(frozen=True, repr=False)
class Navigated(WrittenResult):
    """States of the boat over the time of one or more logs, estimated with a fitted model. `navigate` returns it.

    Attributes
    ----------
    result : NavigationResult
        Content of result.json.
    files : dict of str to bytes
        Files that ``save`` writes: a CSV file for each log, or for each segment of a log that is cut at long times
        without a sample; result.json and report.html.
    """

    result: NavigationResult

    @property
    def states(self) -> dict[str, dict[str, NDArray[np.float64]]]:
        """Columns of the estimated states: for each name of a log or segment a dictionary of arrays (n_rows,) by name.

        The columns are the time ``t`` [s of the log], the states, their standard deviations (such as ``sd_u``), the
        current if the model estimates it, the covariance ``cov_x_y`` [m2] of the position, and ``gnss``: 1 for a fix
        that was used, -1 for one that was withheld, 0 without a fix. Units are SI and radians; forces are ratios to the
        thrust if it is not known in N.
        """
        found = {}
        for name, content in self.files.items():
            if name.endswith(".csv"):
                head, *rows = csv.reader(content.decode("utf-8").splitlines())
                found[name.removesuffix(".csv")] = dict(zip(head, np.array(rows, dtype=np.float64).T, strict=True))
        return found

    def to_pandas(self) -> Any:
        """Return the states of all logs as one ``pandas.DataFrame``, with the name of the log in the column ``log``.

        The other columns are those of `states`.

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        pandas = import_library("pandas")
        frames = [pandas.DataFrame({"log": name, **columns}) for name, columns in self.states.items()]
        return pandas.concat(frames, ignore_index=True)

    def _content(self) -> Content:
        """Return answer, warnings and a table of the GNSS outages; without outages, of the states at the end."""
        if self.result.outages:
            outages = [
                (o.record, number(o.start), number(o.duration), number(o.at_end.radius, 3), number(o.error, 3))
                for o in self.result.outages
            ]
            columns = ("outage in", "from [s]", "for [s]", "95 % radius [m]", "error [m]")
            return Content(self.answer, self.warnings, columns, outages)
        ends = [
            (log, name, number(values[-1]), number(states[f"sd_{name}"][-1], 2))
            for log, states in self.states.items()
            for name, values in states.items()
            if f"sd_{name}" in states
        ]
        return Content(self.answer, self.warnings, ("log", "state at the end", "value", "s.d."), ends)

    def __repr__(self) -> str:
        """Return a short text for the interpreter: names of the logs, and `answer`."""
        return f"<Navigated: {', '.join(self.states)}>\n{self.answer}"


def thruster(logs: Logs, **options: Unpack[ThrusterOptions]) -> FittedThruster | ThrustCurve:
    """Fit shaft dynamics and thrust curve to bench logs of one thruster, as ``seatrial ident thruster``.

    Parameters
    ----------
    logs : path, `Log` or sequence of them
        Bench logs. Of a `Log`, its own window is used.
    **options
        `ThrusterOptions`, which ``help(st.ThrusterOptions)`` describes: name, settle, fixed, profiles, outlier_model,
        reml, horizon, despite_faults, progress.

    Returns
    -------
    FittedThruster or ThrustCurve
        The model, or only a static curve if the logs have no shaft speed. ``save`` writes the files of the command.

    Raises
    ------
    SeatrialError
        If the logs lack signals or have faults that make a fit meaningless, or if an option is unknown.

    Examples
    --------
    >>> bench = st.thruster("bench.mcap")
    >>> bench.params["c1"]
    >>> st.fit("run1.mcap", thruster=bench.save("thruster") / "model.toml")
    """
    from seatrial.ident.estimation import EstimationOptions
    from seatrial.ident.workflows.thruster import ThrusterFit, ThrusterRequest, fit_thruster

    given = known_options(options, ThrusterOptions)
    check_parameters(given)
    if "settle" in given:
        check_number("settle", given["settle"], "s")
    reporter = Messages(given.pop("progress", None))
    estimation = {n: given.pop(n) for n in ("outlier_model", "reml", "horizon") if n in given}
    how = replace(EstimationOptions(reml=True), **estimation)
    (paths,) = as_logs(logs)

    def work(out: Path) -> Any:
        """Fit the thruster, write the files of the command to the folder `out`, and return the fit."""
        found = fit_thruster(
            ThrusterRequest(paths, out, estimation=how, window=window_of(logs), **given),
            python_call(thruster, {"logs": logs, **options}),
            reporter,
        )
        found.write(out)
        return found

    found, files = _with_files(work, OF_THRUSTER)
    warn_of_result(found.result, reporter)
    if isinstance(found, ThrusterFit):
        return FittedThruster(result=found.result, files=files, fitted=found.fitted)
    return ThrustCurve(found.result, files)


@named_arguments
def navigate(
    model: PathLike | FittedVehicle | FittedDiagnosis | Saved,
    logs: Logs,
    gnss_outages: Sequence[tuple[float, float]] | tuple[float, float] = (),
    smoothed: bool = True,
    thruster: PathLike | None = None,
    rate: float = 10.0,
) -> Navigated:
    """Estimate position, heading, speeds, current and disturbance forces along logs, as ``seatrial ident navigate``.

    Parameters
    ----------
    model : path, `Saved`, `FittedVehicle` or `FittedDiagnosis`
        The fitted model.
    logs : path, `Log` or sequence of them
        Logs with different names, which the model should not have been fitted to. Of a `Log`, its own window is used.
    gnss_outages : sequence of (from, to), or one pair
        Intervals [s from the start of the log] in which the samples of GNSS are not used.
    smoothed : bool
        Whether each state is estimated from all samples (smoother), or only from those up to its time (filter).
    thruster : path, optional
        File of the static curve from command to thrust with which the model was fitted.
    rate : float
        Rate of the rows [Hz] to which faster sensors are averaged.

    Returns
    -------
    Navigated
        The states with their standard deviations. ``save`` writes the files of the command.

    Raises
    ------
    SeatrialError
        If two logs have the same name, if they lack signals that the model needs, if the rate is not from 1 to 200 Hz,
        or if an outage is no pair of numbers whose second is the larger one.

    Examples
    --------
    >>> st.navigate(fit, "run3.mcap", gnss_outages=[(60.0, 90.0)]).answer
    """
    from seatrial.ident.estimation import model_file
    from seatrial.ident.workflows.navigate import NavigationRequest, navigate_logs

    check_rate(rate)
    outages = as_intervals("gnss_outages", gnss_outages)
    (paths,), curve = as_logs(logs), None if thruster is None else model_file(as_path(thruster, "thruster"))

    def work(out: Path) -> Any:
        """Estimate the states, write the files of the command to the folder `out`, and return the result."""
        request = NavigationRequest(path, paths, out, smoothed, outages, window_of(logs), rate, curve)
        return navigate_logs(request, command, messages)

    messages = Messages()
    arguments = {"model": model, "logs": logs, "gnss_outages": outages, "smoothed": smoothed, "thruster": thruster}
    command = python_call(navigate, {**arguments, "rate": rate})
    with model_path(model) as path:
        found = Navigated(*_with_files(work))
    warn_of_result(found.result, messages)
    return found


def design(
    model: PathLike | FittedVehicle | FittedDiagnosis | Saved,
    out: PathLike,
    force: bool = False,
    **options: Unpack[DesignOptions],
) -> DesignResult:
    """Design the next mission: commands that inform the parameters of a model most, as ``seatrial mission design``.

    Parameters
    ----------
    model : path, name, `Saved`, `FittedVehicle` or `FittedDiagnosis`
        A fitted model, or the name of a structure, such as ``horizontal:command``.
    out : path
        File of the mission. A .json file and an .html page are written beside it.
    force : bool
        Whether existing files are replaced. If false, an existing file is an error.
    **options
        `DesignOptions`, which ``help(st.DesignOptions)`` describes: duration, steps, criterion, chosen, between, area,
        max_speed, energy, current, n_max, slew, thruster, shortest, rates, prior_halfwidth, evaluations, seed,
        progress.

    Returns
    -------
    DesignResult
        Expected standard errors after the mission, comparison with baseline signals, and the commands of the mission.

    Raises
    ------
    SeatrialError
        If the model or an option cannot be used, or if a file exists and ``force`` is false.

    Notes
    -----
    A design takes some 20 s for a structure without limits, and several minutes for a fitted model with many effects
    and an area. ``progress=True`` prints how long the search still takes.

    Examples
    --------
    >>> st.design(fit, "next.toml", duration=300.0, area=(60.0, 40.0)).answer
    """
    from contextlib import nullcontext

    from seatrial.api.loading import Saved
    from seatrial.ident.experiment_design import DesignLimits
    from seatrial.ident.workflows.design import DesignRequest, make_design

    given, file = known_options(options, DesignOptions), as_path(out, "out")
    _check_design(given)
    reporter = Messages(given.pop("progress", None), OF_DESIGN)
    if "prior_halfwidth" in given:
        given["spread"] = given.pop("prior_halfwidth")
    area, speed, energy, current = (given.pop(name, None) for name in ("area", "max_speed", "energy", "current"))
    limits = DesignLimits(None if area is None else as_sides("area", area), speed, energy, current or 0.0)
    if "thruster" in given:
        given["thruster"] = as_path(given["thruster"], "thruster")
    fitted = isinstance(model, FittedVehicle | FittedDiagnosis | Saved) or Path(str(model)).exists()
    with errors_of_users(OF_DESIGN), model_path(model) if fitted else nullcontext(Path(str(model))) as source:
        request = DesignRequest(**given, limits=limits)
        command = python_call(design, {"model": model, "out": out, "force": force, **options})
        found = make_design(str(source), request, file, command, reporter, force)
    found = with_texts_in_python(found, OF_DESIGN)
    warn_of_result(found, reporter)
    return found


def _check_design(given: Mapping[str, Any]) -> None:
    """Raise SeatrialError if options of a design (`DesignOptions`) are no names, or are not as the command wants them.

    These are ``criterion``, ``chosen``, ``between``, ``rates`` and ``prior_halfwidth``.
    """
    from seatrial.ident.experiment_design import Kind

    criterion, between, rates = given.get("criterion", "D"), given.get("between", ()), given.get("rates", {})
    if criterion not in (known := get_args(Kind)):
        raise SeatrialError(f"criterion {shortened(criterion)}: choose {', '.join(known)}")
    if criterion == "Ds" and not given.get("chosen"):
        raise SeatrialError("criterion Ds needs the parameters to estimate; give them as chosen=('d_v', 'm_v')")
    if isinstance(between, str) or not isinstance(between, Sequence) or len(between) not in (0, 2):
        raise SeatrialError(f"between {shortened(between)}: give exactly two effects, such as ('delay', 'lag')")
    if not isinstance(rates, Mapping):
        raise SeatrialError(f'rates {shortened(rates)}: give a dict by sensor, in Hz, such as {{"position": 1.0}}')
    width = given.get("prior_halfwidth", 0.0)
    if isinstance(width, bool) or not isinstance(width, Real) or not 0.0 <= float(width) <= 0.9:
        raise SeatrialError(f"prior_halfwidth {shortened(width)}: give a number from 0 to 0.9")
    for sensor, rate in rates.items():
        if isinstance(rate, bool) or not isinstance(rate, Real) or not 0.0 < float(rate) < np.inf:
            raise SeatrialError(f"rates: {sensor}: {shortened(rate)}: give a number above zero, in Hz")


def _with_files(work: Callable[[Path], T], own: Mapping[str, str] | None = None) -> tuple[T, Files]:
    """Call `work` with a temporary folder; return its result, and the contents of the files in the folder by name.

    ValueError and KeyError become SeatrialError. ``own`` has the arguments that differ from those of other functions.
    """
    with errors_of_users(own or {}), TemporaryDirectory() as folder:
        result = work(Path(folder))
        return result, {path.name: path.read_bytes() for path in sorted(Path(folder).iterdir())}
