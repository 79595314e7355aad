"""Saved models and results of the Python interface, and simulation of a model for given inputs."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict, Unpack, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from seatrial.api import tables
from seatrial.api.arguments import Role, as_path, named_arguments, shortened, with_short_help
from seatrial.api.findings import DiagnosisFindings
from seatrial.api.fits import FittedResult, MotionMethods, known_options, model_path
from seatrial.api.logs import Log, PathLike
from seatrial.api.messages import errors_of_users, text_of
from seatrial.api.plots import comparison_figure, prediction_figure
from seatrial.api.series import Series, Simulation
from seatrial.api.shown import Content, Shown, number, unknown_attribute
from seatrial.daq.errors import NamedValues, SeatrialError, UnknownAttribute, closest_name, counted, file_hint, warn
from seatrial.daq.log import import_library

if TYPE_CHECKING:
    from seatrial.api.figures import Figure
    from seatrial.ident.estimation import SavedModel
    from seatrial.ident.model import Model, Parameter

MODEL, RESULT, ESTIMATES = "model.toml", "result.json", "fits.parquet"
# What the fields are for that only results of fits have
OF_FITS = {
    "traces": "figure", "residuals": "residual tests", "horizon_seconds": "prediction errors",
    "converged": "search for a maximum of the likelihood",
}  # fmt: skip
ENDING_OF_FILES = re.compile(r"\.[A-Za-z]\w{0,4}")  # .txt, not that of a folder as boat.2 or run.2026-05-01
NEED_LOGS = ("residuals", "predict", "simulate", "plot_residuals", "fitted")  # attributes of a fit of this process
SHORTEST_STEP = 1e-5  # s between two times of a simulation; closer ones would be one row
FARTHEST = 10.0  # largest input of a simulation, as a multiple of the largest one in the fitted data
LARGEST_ANGLE = 4.0 * math.pi  # rad, or rad/s; larger initial values of a boat are degrees
ROWS_PER_SAMPLE = 10.0  # of a simulation, for the rate above which a sensor would be averaged
TEXT_TABLES = (".csv", ".tsv", ".txt", ".dat")  # suffixes of texts that probably contain a table
MODEL_COLUMNS = ("value", "se", "unit", "meaning")  # of the table of a model without its result


@with_short_help
class ExportOptions(TypedDict, total=False):
    """Options of `export`. All are optional; the defaults are those of ``seatrial ident export``.

    An option without a default below is not set.

    Attributes
    ----------
    name : str
        Prefix of functions and of the file; by default the name of the model.
    with_disturbance_states : bool
        Whether disturbance forces and sensor biases are kept as states, False by default.
    thruster : path, or dict of str to path
        model.toml of the bench test of all thrusters, or of each thruster by name (``left``, ``right``). The inputs of
        the exported model are then commands. A fit of ``st.thruster`` to a log of the boat with commands and shaft
        speeds gives such a model too.
    thrust_curve : "bench" or "boat"
        Thrust curve of a model with ``thruster``; ``bench`` by default.
    thrust_input : bool
        Whether the inputs are thrusts [N] in place of shaft speeds, False by default.
    source_only : bool
        Whether an FMU has no binary, and needs no compiler here. False by default.
    mass : float
        Mass of the boat without added mass [kg]; needed for Gazebo and VRX.
    inertia : float
        Moment of inertia about the vertical axis without added inertia [kg m2]; needed for Gazebo and VRX.
    force : bool
        Whether an existing file may be replaced; False by default.
    """

    name: str
    with_disturbance_states: bool
    thruster: PathLike | Mapping[str, PathLike]
    thrust_curve: Literal["bench", "boat"]
    thrust_input: bool
    source_only: bool
    mass: float
    inertia: float
    force: bool


@dataclass(frozen=True, repr=False)
class Saved(MotionMethods, Shown):
    """Fit that `load` has read from files. The fit has a model, a result, or both.

    Attributes
    ----------
    path : Path
        File or folder that was loaded.
    model : SavedModel or None
        The model in model.toml (`seatrial.ident.estimation.SavedModel`). None if the file does not exist.
    result : Result or None
        The result in result.json (`seatrial.ident.results`). None if the file does not exist.
    """

    path: Path
    model: SavedModel | None
    result: Any

    @property
    def params(self) -> dict[str, float]:
        """Values of all parameters by name, estimated and fixed, in SI units and radians.

        They are those of the file. Unlike `FittedVehicle.params`, they are never ratios to the thrust, and a parameter
        with its own value in each record has one entry, its mean.

        Raises
        ------
        SeatrialError
            If no model.toml was loaded.
        """
        return NamedValues(self.saved_model().model.values, "parameter")

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard errors of the parameters by name, in the units of `params`; NaN if a parameter has none.

        Raises
        ------
        SeatrialError
            If no model.toml was loaded.
        """
        return NamedValues(self.saved_model().errors, "estimated parameter")

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the n estimated parameters with a standard error that all records share, in the order of `cov`.

        Raises
        ------
        SeatrialError
            If no model.toml was loaded.
        """
        return self.saved_model().covariance().names

    @property
    def cov(self) -> NDArray[np.float64]:
        """Covariance of the estimates (n, n), in the order of `free` and in the units of `params`.

        Unlike that of a fit of this process, it has no parameters with their own value in each record.

        Raises
        ------
        SeatrialError
            If no model.toml was loaded.
        """
        found = self.saved_model().covariance().covariance
        return np.zeros((0, 0)) if found is None else np.asarray(found)

    def cov_to_pandas(self) -> Any:
        """Return the covariance of the estimates as a ``pandas.DataFrame`` with their names as index and columns.

        Raises
        ------
        SeatrialError
            If no model.toml was loaded, or if pandas is not installed.
        """
        return tables.labelled_covariance(self.cov, self.free)

    def __getattr__(self, name: str) -> Any:
        """Raise `UnknownAttribute`. If a fit has an attribute of this name, the message says how to obtain it."""
        if name in NEED_LOGS:
            computed = self._as_computed(with_files=False)  # a comparison has its residuals
            if computed is not None and hasattr(computed, name):
                return getattr(computed, name)
            raise UnknownAttribute(
                f"a loaded result has no {name}, which needs the logs: fit them again with st.fit or st.diagnose, or "
                "evaluate the model on logs with st.compare, whose result has residuals, residual_tests and predictions"
            )
        raise unknown_attribute(self, name)

    @property
    def answer(self) -> str:
        """Main conclusion of the result in a few sentences, as in its report; empty if no result was loaded.

        The caveat of a diagnosis follows its conclusion.
        """
        return "" if self.result is None else tables.conclusion(self.result)

    @property
    def warnings(self) -> list[str]:
        """Warnings of the loaded result, one text for each. The list is empty without a result or warnings."""
        return [] if self.result is None else tables.warning_texts(self.result)

    @property
    def notes(self) -> list[str]:
        """Notes of the loaded result: assumptions and choices of the computation, such as how sensors are modelled.

        One text for each; the report has them under *Notes*. The list is empty without a result.
        """
        return [] if self.result is None else tables.note_texts(self.result)

    @property
    def converged(self) -> bool:
        """Whether the search for the maximum of the likelihood converged, of the loaded result of a fit or diagnosis.

        Raises
        ------
        SeatrialError
            If no result of a fit was loaded.
        """
        self._require_fit("converged")
        return bool(self.result.converged)

    def summary(self) -> str:
        """Return the loaded result as text.

        For the result of a fit this is the table of its estimates, as `FittedVehicle.summary`. For any other result it
        is the answer with the tables that the command prints. Without a result the parameters of the model are listed
        with their standard errors.

        Raises
        ------
        SeatrialError
            If neither a result nor a model was loaded.
        """
        if hasattr(self.result, "fit"):
            return tables.summary(self.result)
        if self.result is not None:
            return text_of(self.result)
        errors = {n: f" ± {e:.2g}" for n, e in self.standard_errors.items() if np.isfinite(e)}
        lines = [f"{n} = {v:.6g}{errors.get(n, '')}" for n, v in self.params.items()]
        return "\n".join([*lines, *(["± is one standard error."] if errors else [])])

    def _require_fit(self, field: str) -> None:
        """Raise SeatrialError if the loaded result lacks a field, which every result of a fit has."""
        if hasattr(self.result, field):
            return
        if self.result is None:
            raise SeatrialError(f"{self.path}: no {RESULT} of a fit was loaded; load the folder that contains it")
        kind = self.result.__struct_config__.tag
        folder = self.path if self.path.is_dir() else self.path.parent
        page = folder / "report.html"
        figures = f"; its figures are in {page}" if page.is_file() else ""
        raise SeatrialError(
            f"{self.path}: a result of the kind {kind!r} has no {OF_FITS[field]} in Python; summary() returns its "
            f"tables{figures}"
        )

    def residual_tests(self, on: Role = "estimation") -> Any:
        """Return the tests of the residuals as a ``pandas.DataFrame``, as `FittedVehicle.residual_tests`.

        Those of a comparison are of its first model on the compared logs, as `Comparison.residual_tests`.

        Parameters
        ----------
        on : ``estimation`` or ``validation``
            Data whose residuals are tested.

        Raises
        ------
        SeatrialError
            If no result of a fit was loaded, if pandas is not installed, or if there are no residual tests of
            validation data.
        """
        if self.result is not None and self.result.__struct_config__.tag == "comparison":
            return self._as_computed(with_files=False).residual_tests()
        self._require_fit("residuals")
        return tables.residual_frame(self.result, on)

    def errors_to_pandas(self) -> Any:
        """Return the RMS prediction errors as a ``pandas.DataFrame``, as `FittedVehicle.errors_to_pandas`.

        Raises
        ------
        SeatrialError
            If no result of a fit was loaded, or if pandas is not installed.
        """
        self._require_fit("horizon_seconds")
        return tables.error_frame(self.result)

    def plot(self, *channels: str, record: str | None = None) -> Figure:
        """Return a figure of measured and predicted channels over the horizon, as that of a fit of this process.

        For the result of a comparison it has the predictions of all models, as `Comparison.plot`.

        Parameters
        ----------
        *channels : str
            Names of the channels to draw, such as ``"psi"``; without names all are drawn.
        record : str, optional
            Name of the only record to draw of the result of a fit; without it all are drawn.

        Raises
        ------
        SeatrialError
            If no result of a fit or of a comparison was loaded, or if it has no channel with one of the names, or no
            such record.
        """
        if self.result is not None and self.result.__struct_config__.tag == "comparison":
            return comparison_figure(self.result, channels, None)
        self._require_fit("traces")
        return prediction_figure(self.result, channels, record)

    def to_pandas(self) -> Any:
        """Return the loaded result as a ``pandas.DataFrame``, with the columns of the function that computes it.

        - Fit or diagnosis: a row for each parameter, with the columns of `FittedVehicle.to_pandas`.
        - Fleet: a row for each log and parameter, with the columns of `FittedFleet.to_pandas`, from the fits.parquet
          beside result.json. This file may also have logs of earlier runs.
        - Changes: a row for each compared parameter, with the columns of `CampaignComparison.to_pandas`.
        - Comparison: a row for each kind of prediction, channel and model, with the columns of `Comparison.to_pandas`.
        - Navigation: a row for each log and time, with the columns of `Navigated.to_pandas`, from the CSV files beside
          result.json.

        Without one of these results, the rows are the parameters of the model, with the columns value, se, unit and
        meaning.

        Raises
        ------
        SeatrialError
            If there is neither such a result nor a model, if a file beside result.json is missing or cannot be read, or
            if pandas is not installed.
        """
        if hasattr(self.result, "fit"):
            return tables.frame(self.result)
        computed = self._as_computed(with_files=True)
        if computed is not None:
            return computed.to_pandas()
        if self.result is not None and self.model is None:
            kind = self.result.__struct_config__.tag
            raise SeatrialError(f"{self.path}: a result of the kind {kind!r} has no table in pandas; use .result")
        rows = [
            (p.name, p.value, self.standard_errors.get(p.name, np.nan), p.unit, p.meaning) for p in self._parameters
        ]
        return import_library("pandas").DataFrame(rows, columns=("name", *MODEL_COLUMNS)).set_index("name")

    def saved_model(self) -> SavedModel:
        """Return the loaded content of model.toml (`seatrial.ident.estimation.SavedModel`).

        Raises
        ------
        SeatrialError
            If no model.toml was loaded.
        """
        if self.model is None:
            raise SeatrialError(f"{self.path}: no {MODEL} was loaded; load the folder that contains it")
        return self.model

    def _as_computed(self, with_files: bool) -> Any:
        """Return the object that the function of this result returns, or None for another result.

        The functions are those of a fleet, of changes, of a comparison and of a navigation. ``with_files``: whether the
        files beside result.json are read; otherwise the object has none of them. SeatrialError is raised if one of
        them is missing or cannot be read.
        """
        from seatrial.api.campaigns import CampaignComparison
        from seatrial.api.comparison import Comparison
        from seatrial.api.fleet import FittedFleet
        from seatrial.api.runs import Navigated
        from seatrial.ident.results import CampaignsResult, ComparisonResult, FleetResult, NavigationResult

        result = self.result
        if isinstance(result, ComparisonResult):
            return Comparison(result)
        if isinstance(result, CampaignsResult):
            return CampaignComparison(result, None)
        if isinstance(result, FleetResult):
            return FittedFleet(result, tables.read_parquet(self._beside(ESTIMATES)) if with_files else None)
        if isinstance(result, NavigationResult):
            names = [f"{row.record}.csv" for row in result.navigation] if with_files else []
            return Navigated(result, {name: self._beside(name).read_bytes() for name in names})
        return None

    def _beside(self, name: str) -> Path:
        """Return the path of a file beside the loaded result.json. SeatrialError is raised if it does not exist."""
        file = (self.path if self.path.is_dir() else self.path.parent) / Path(name).name
        if not file.is_file():
            raise SeatrialError(f"{file}: is missing, and the table of this result is in it; load the whole folder")
        return file

    @property
    def _parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the loaded model with their values; SeatrialError without a model."""
        return self.saved_model().model.parameters

    def _content(self) -> Content:
        """Return the content of the result of a fit, of many logs, of a comparison or of a navigation.

        For another result it is the answer, with the parameters of the model, if there is one.
        """
        if hasattr(self.result, "fit"):
            return tables.content(self.result)
        computed = self._as_computed(with_files=False)
        if computed is not None:
            content: Content = computed._content()
            return content
        notes = self.warnings
        if self.model is None:
            return Content(self.answer, notes)
        errors = self.standard_errors
        rows = [(p.name, number(p.value), number(errors.get(p.name), 2), p.unit) for p in self._parameters]
        return Content(self.answer or self.model.model.name, notes, ("", "value", "s.e.", "unit"), rows)

    def __repr__(self) -> str:
        """Return a short text for the interpreter: path, name of the model, and the answer of the result if any."""
        name = "no model" if self.model is None else self.model.model.name
        return f"<Saved {self.path}: {name}>" + (f"\n{self.answer}" if self.answer else "")


@dataclass(frozen=True, repr=False)
class SavedDiagnosis(DiagnosisFindings, Saved):
    """Files of a diagnosis that were read from disk. `load` returns it if the result is that of a diagnosis."""


@named_arguments
def load(path: PathLike) -> Saved:
    """Load what a command or ``save`` has written: model.toml, result.json, or a folder with one of them or both.

    Parameters
    ----------
    path : str or Path
        File or folder. A file with the ending .json is read as result.json, any other file as model.toml.

    Returns
    -------
    Saved
        The model, the result, or both; what was not found is None. For the result of a diagnosis it is a
        `SavedDiagnosis`, which also has the findings.

    Raises
    ------
    SeatrialError
        If there is no such file, if a folder has neither file, if a file cannot be read, or if it is no .toml or .json
        file, such as a log.

    Examples
    --------
    >>> saved = st.load("vehicle")
    >>> print(saved.summary())
    """
    from seatrial.ident.estimation import load_model
    from seatrial.ident.results import DiagnosisResult, read_result

    try:
        path = Path(path)
    except TypeError:
        text = f"give the path of a {MODEL}, of a {RESULT}, or of their folder"
        raise SeatrialError(f"{type(path).__name__}: this is no path; {text}") from None
    if not path.exists():
        raise SeatrialError(
            f"{path}: no such file or folder; {file_hint(path)}give a {MODEL}, a {RESULT}, or their folder"
        )
    if path.suffix == ".mcap":
        raise SeatrialError(f"{path}: is a log, not a model or a result; open it with st.open_log")
    if path.is_file() and path.suffix not in (".toml", ".json"):
        raise SeatrialError(f"{path}: is neither a {MODEL} nor a {RESULT}; {_how_to_open(path)}")
    files = [path / MODEL, path / RESULT] if path.is_dir() else [path]
    found = {file.suffix == ".json": file for file in files if file.exists()}
    if not found:
        raise SeatrialError(f"{path}: contains neither {MODEL} nor {RESULT}; give the folder of a result")
    with errors_of_users():
        saved = load_model(found[False]) if False in found else None
        read = read_result(found[True]) if True in found else None
    return (SavedDiagnosis if isinstance(read, DiagnosisResult) else Saved)(path, saved, read)


def _how_to_open(path: Path) -> str:
    """Return advice for the error about a file that is neither a model nor a result.

    The advice names the kind of the file, and the function that opens it.
    """
    from seatrial.daq.importers.sources import source_kind  # imported here, as only this error needs it

    if path.suffix in (".html", ".htm"):
        return "a report is read in a browser; give the folder of the result"
    if path.suffix == ".parquet" and (path.parent / RESULT).exists():
        return f"it seems to be a table of the result in {path.parent}; give this folder"
    try:
        kind = source_kind(path).name
    except SeatrialError:
        kind = ""
    if (kind == "csv" and path.suffix.lower() not in TEXT_TABLES) or not kind:
        return "give one of them, or their folder"
    what = "a text table" if kind == "csv" else f"a log of other software ({kind})"
    return f"it seems to be {what}: import it with st.import_log, and fit a model to the log with st.fit"


@named_arguments
def simulate(
    model: PathLike | Saved | FittedResult,
    t: ArrayLike,
    inputs: Mapping[str, ArrayLike],
    start: Mapping[str, float] | None = None,
    hold: Literal["zero", "linear"] | None = None,
) -> Simulation:
    """Simulate a fitted model for given inputs, without process noise and without measurement noise.

    An input that leaves its range in the fitted data by more than a tenth of this range gives a `SeatrialWarning`: the
    motion is then extrapolated. An input of more than ten times its largest value in these data is an error.

    Parameters
    ----------
    model : path, `Saved`, `FittedVehicle`, `FittedDiagnosis` or `FittedThruster`
        The model.
    t : Array (n,)
        Times [s] of the input samples, increasing.
    inputs : dict of str to Array (n,)
        Value of each input at these times, for example ``n_left`` and ``n_right`` (-1 to 1). For a model of commands
        (``n_cmd_left``), ``n_left`` is the command too, as in the import map and the log, although the state ``n_left``
        of the model is the shaft speed.
    start : dict of str to float, optional
        Initial values of states by name, for example ``{"u": 1.0}``. The other states begin at the initial values of
        the model.
    hold : ``zero`` or ``linear``, optional
        Inputs between their samples: constant until the next sample, or on a straight line to it. None: as in the
        model, where commands are constant, and a measured shaft speed is linear. The ``Simulation`` of `export` has the
        same option. Its ``step`` gets the value at the end of the step if the input is linear, and the value at its
        start if it is constant. Before the first time, the inputs are those at it; those of a ``Simulation`` are zero,
        unless it gets them as ``inputs``.

    Returns
    -------
    Simulation
        Dict of str to `Series`; `to_pandas` gives one table of all. States and outputs by name, in SI units and
        radians, with a value at each of the times ``t``. Where a state and an output have one name, it is the state.

    Raises
    ------
    SeatrialError
        If an input of the model is missing, if a state or input is unknown, if an input has another length than ``t``
        or a value that is not finite or far outside the fitted data, if an initial value is not a finite number, if
        the times do not increase, or if ``hold`` is unknown.

    Examples
    --------
    >>> t = np.arange(0.0, 60.0, 0.1)
    >>> motion = st.simulate("vehicle", t, {"n_left": 0.5 + 0 * t, "n_right": 0.4 + 0 * t})
    >>> motion["r"].value[-1]
    """
    from seatrial.ident.data import SAME_TIME, Channel, build_record
    from seatrial.ident.estimation import simulate as integrate
    from seatrial.ident.estimation import warn_of_run_means
    from seatrial.ident.model import ModelKind
    from seatrial.ident.models import delay_step, delayed_channels

    structure, ranges = _structure(model)
    warn_of_run_means(structure)
    if hold is not None:
        if hold not in ("zero", "linear"):
            raise SeatrialError(f"hold {hold!r}: give 'zero' or 'linear', or None for the hold of the model")
        structure = replace(structure, inputs=tuple(i if i.tap_of else replace(i, hold=hold) for i in structure.inputs))
    times = _checked_times(t)
    named = _checked_inputs(structure, times, inputs, ranges)
    channels = {name: Channel(times, values) for name, values in named.items()}
    if structure.kind is ModelKind.BENCH:
        (command,) = {i.tap_of for i in structure.inputs if i.tap_of}  # the model has delayed copies of it as inputs
        channels |= delayed_channels(channels[command], delay_step(structure))
    # A record needs samples of a sensor. They only define the rows: the simulation does not use their values.
    sensor = structure.sensors[0]
    channels |= {o.name: Channel(times, np.zeros(times.size)) for o in sensor.outputs}
    with errors_of_users():
        # At this rate no sample is averaged over several, so that the times `t` are rows. There are more rows if the
        # times are far apart, or if a delayed input changes between them.
        record = build_record(structure, channels, rate=ROWS_PER_SAMPLE / float(np.diff(times).min()))
        first = integrate(structure, record).x[0]
        for k, value in _initial_states(structure, start or {}).items():
            first[k] = value
        run = integrate(structure, record, x0=first)
    at = np.searchsorted(run.t, times - times[0] - SAME_TIME)
    found: dict[str, Series] = {}
    found |= {o.name: Series(times, run.y[at, j]) for j, o in enumerate(structure.outputs)}
    found |= {s.name: Series(times, run.x[at, j]) for j, s in enumerate(structure.states)}
    return Simulation(found)


def _initial_states(structure: Model, start: Any) -> dict[int, float]:
    """Return the initial values of states by their index in the model.

    An angle or angular rate that is only plausible in degrees gives a `SeatrialWarning`. SeatrialError is raised if
    ``start`` is no dict, if a state is unknown, or if a value is not a finite number.
    """
    if not hasattr(start, "items"):
        raise SeatrialError('start: give a dict with the initial values of states by name, such as {"u": 1.0}')
    index = {s.name: k for k, s in enumerate(structure.states)}
    found = {}
    for name, value in start.items():
        if name not in index:
            near = closest_name(str(name), list(index))
            hint = f"did you mean {near!r}? Its" if near else "its"
            raise SeatrialError(f"start: the model has no state {name!r}; {hint} states are {', '.join(index)}")
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = math.nan
        if not math.isfinite(number):
            raise SeatrialError(f"start: {name} is {value!r}; give a finite number")
        unit = structure.states[index[name]].unit
        if unit in ("rad", "rad/s") and abs(number) > LARGEST_ANGLE:
            warn(f"start: {name} is {number:g} {unit}; give radians, for degrees math.radians({number:g})")
        found[index[name]] = number
    return found


def _checked_times(t: ArrayLike) -> NDArray[np.float64]:
    """Return the times of a simulation as an array. SeatrialError if they are not two or more that increase."""
    try:
        times = np.array(t, dtype=float)
    except (TypeError, ValueError):
        raise SeatrialError("times: give numbers [s]; the call is st.simulate(model, t, inputs)") from None
    if times.ndim != 1 or times.size < 2 or not np.isfinite(times).all():
        raise SeatrialError(f"times: they have the shape {times.shape}; give a list of two or more finite times [s]")
    if (steps := np.diff(times)).min() < SHORTEST_STEP:
        k = int(np.argmax(steps < SHORTEST_STEP))
        raise SeatrialError(f"times: {times[k + 1]:g} s follows {times[k]:g} s; the times must increase")
    return times


def _checked_inputs(
    structure: Model, times: NDArray[np.float64], inputs: Any, ranges: Mapping[str, tuple[float, float]]
) -> dict[str, NDArray[np.float64]]:
    """Return the input signals of a simulation as arrays by name.

    `ranges` are those of the fitted data by signal. An input that leaves its range gives a warning. SeatrialError is
    raised if the inputs are not those of the model, or if they do not have one finite value for each time.
    """
    from seatrial.ident.data import TIME_INPUT, WORK_INPUT
    from seatrial.ident.estimation import leaves_validity
    from seatrial.ident.model import SHAFT_SPEED, SignalId, command_of, is_of_thruster

    known = list(dict.fromkeys(i.tap_of or i.name for i in structure.inputs))
    needed = [n for n in known if n not in (TIME_INPUT, WORK_INPUT)]  # those are computed
    form = "{" + ", ".join(f"{n!r}: 0.5 + 0 * t" for n in needed) + "}"
    if not hasattr(inputs, "items") or isinstance(inputs, Log):
        raise SeatrialError(f"inputs: give a dict with the values of each input by name, such as {form}")
    named = {}
    for name, values in inputs.items():
        try:
            named[str(name)] = np.asarray(values, dtype=float)
        except (TypeError, ValueError):
            raise SeatrialError(f"input {name}: {shortened(values)} is no array of numbers; give {form}") from None
    for name in [n for n in named if n not in known and is_of_thruster(n, SHAFT_SPEED)]:
        command = command_of(SignalId.parse(name).source)
        if command in known and command not in named:  # an import map calls the commands n_left and n_right
            named[command] = named.pop(name)
    for name, values in named.items():
        if name not in known:
            near = closest_name(name, needed)
            hint = f"did you mean {near!r}? Its" if near else "its"
            raise SeatrialError(f"the model has no input {name!r}; {hint} inputs are {', '.join(needed)}")
        if values.shape != times.shape:
            raise SeatrialError(
                f"input {name}: it has the shape {values.shape}, but the times have {times.shape}; give one value for "
                "each time"
            )
        if bad := int(np.sum(~np.isfinite(values))):
            raise SeatrialError(
                f"input {name}: {bad} of {counted(values.size, 'sample')} are not finite numbers; give finite ones"
            )
    if missing := [n for n in needed if n not in named]:
        raise SeatrialError(f"input {missing[0]}: it is missing; give the inputs by name, such as {form}")
    for name, values in named.items():
        least, most = float(values.min()), float(values.max())
        if name not in ranges or not leaves_validity(least, most, ranges[name]):
            continue
        low, high = ranges[name]
        fitted = f"its range in the fitted data, {low:.3g} to {high:.3g}"
        if max(-least, most) > FARTHEST * max(-low, high):
            raise SeatrialError(
                f"input {name}: {least:.3g} to {most:.3g} is far outside {fitted}; give it in the unit of the data "
                "(shaft speeds and commands: -1 to 1)"
            )
        warn(f"input {name}: {least:.3g} to {most:.3g} is outside {fitted}, so that the motion is extrapolated")
    return named


def export(
    model: PathLike | Saved | FittedResult,
    folder: PathLike,
    format: Literal["python", "casadi", "c", "ros2", "fmu", "gazebo", "vrx"],
    **options: Unpack[ExportOptions],
) -> Path:
    """Write a fitted model as a file for another program, as ``seatrial ident export``.

    Parameters
    ----------
    model : path, `Saved`, `FittedVehicle`, `FittedDiagnosis` or `FittedThruster`
        The model.
    folder : path
        Folder for the file, which then has the name below; it is created if it does not exist. Or the file itself, such
        as ``boat.yaml``, with the ending of the format.
    format : str
        ``python``, ``casadi``, ``c``, ``ros2``, ``fmu`` (FMI 2.0 co-simulation), ``gazebo`` or ``vrx``.
    **options
        `ExportOptions`, which ``help(st.ExportOptions)`` describes: name, with_disturbance_states, thruster,
        thrust_curve, thrust_input, source_only, mass, inertia, force.

    Returns
    -------
    Path
        The file: ``folder`` itself, or in it NAME.py, NAME_casadi.py, NAME.h, NAME.yaml, NAME.fmu, NAME.sdf or
        NAME_vrx.sdf.

    Raises
    ------
    SeatrialError
        If the model cannot be exported in this format, if an option is unknown or does not fit the model or the format,
        if ``folder`` has the ending of another format, or if the file exists and ``force`` is False.

    Warns
    -----
    SeatrialWarning
        If the format cannot have a part of the model, if a name or value has to be changed, or if thrust or arms were
        not given, so that masses and damping are only ratios.

    Examples
    --------
    >>> st.export(fit, "exported_files", "fmu", name="boat", thruster="thruster/model.toml")
    PosixPath('exported_files/boat.fmu')
    """
    from seatrial.daq.files import require_new, write_output
    from seatrial.ident.export import FORMATS_OF_PROGRAMS, described_format
    from seatrial.ident.workflows.export import ExportRequest, Target, export_model, warn_of_module_name

    given: dict[str, Any] = known_options(options, ExportOptions)
    if format not in (targets := get_args(Target)):
        near = closest_name(str(format), targets)
        meant = FORMATS_OF_PROGRAMS.get(str(format).lower()) or (described_format(near) if near else "")
        hint = f"did you mean {meant}? The formats are" if meant else "choose"
        raise SeatrialError(f"there is no format {format!r}; {hint} {', '.join(targets)}")
    if not isinstance(given.get("name", ""), str):
        raise SeatrialError(f"name {shortened(given['name'])}: give a text, the prefix of functions and of the file")
    out, benches, force = as_path(folder, "folder"), given.pop("thruster", {}), given.pop("force", False)
    if not isinstance(benches, str | Path | Mapping):
        example = '{"left": "left/model.toml"}'
        raise SeatrialError(f"thruster: give a path, or a dict of them, such as {example}, not {shortened(benches)}")
    thrusters = benches if isinstance(benches, Mapping) else {"": benches}
    with errors_of_users(), model_path(model) as path:
        benches = {n: as_path(p, "thruster") for n, p in thrusters.items()}
        exported = export_model(ExportRequest(path, format, thrusters=benches, **given))
    file = _export_file(out, exported.file_name)
    with errors_of_users():
        require_new(file, force, "folder or name")
        write_output(file, exported.content, force)
    if file == out:
        warn_of_module_name(file, format)
    return file


def _export_file(out: Path, name: str) -> Path:
    """Return the path of an exported file: `out` itself if it has the ending of the file, otherwise `name` in it.

    An existing folder is always a folder, also with such an ending. SeatrialError is raised if `out` is an existing
    file with another ending, or has an ending of letters as files have, such as .txt.
    """
    ending = Path(name).suffix
    if out.is_dir():
        return out / name
    if out.suffix == ending:
        return out
    if out.exists() or ENDING_OF_FILES.fullmatch(out.suffix):
        raise SeatrialError(
            f"{out}: is not the name of a folder, nor of a file with the ending {ending} of this format"
        )
    return out / name


def _structure(model: PathLike | Saved | FittedResult) -> tuple[Model, Mapping[str, tuple[float, float]]]:
    """Return a model with its estimates as the values of the parameters, and the ranges of its data by signal.

    `model` is a file, a folder, a loaded or a fitted model. SeatrialError is raised if there is no model.toml. A fit
    that did not converge gives a `SeatrialWarning`.
    """
    from seatrial.ident.estimation import warn_if_unconverged

    if isinstance(model, FittedResult):
        from seatrial.ident.workflows.output import validity

        warn_if_unconverged(model.fitted.fit.converged)
        return model.fitted.fit.model, validity(model.fitted)
    saved = (model if isinstance(model, Saved) else load(model)).saved_model()
    warn_if_unconverged(saved.converged)
    return saved.model, saved.validity
