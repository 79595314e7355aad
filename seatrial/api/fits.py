"""Fits and diagnoses of the Python interface, and their results as objects."""

from __future__ import annotations

import atexit
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Real
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal, TypedDict, Unpack, cast

import numpy as np
from numpy.typing import NDArray

from seatrial.api import plots, tables
from seatrial.api.arguments import (
    Role,
    as_path,
    check_switches,
    check_values,
    output_folder,
    shortened,
    with_short_help,
)
from seatrial.api.calls import python_call
from seatrial.api.figures import Figure
from seatrial.api.findings import DiagnosisFindings
from seatrial.api.logs import Log, PathLike, as_list, as_logs
from seatrial.api.messages import Messages, errors_of_users, warn_of_result
from seatrial.api.series import ByRecord, Prediction, Series
from seatrial.api.shown import Content, Shown
from seatrial.daq.errors import NamedValues, SeatrialError, closest_name, file_hint
from seatrial.daq.log import is_log

if TYPE_CHECKING:
    from seatrial.api.loading import Saved
    from seatrial.api.motion import Linearisation, Steady
    from seatrial.ident.diagnosis import Diagnosis
    from seatrial.ident.estimation import FittedModel, RecordEvaluation
    from seatrial.ident.model import Output
    from seatrial.ident.results import DiagnosisResult, FitResult, VehicleResult
    from seatrial.ident.validation import PredictionEvaluation, RecordPrediction
    from seatrial.ident.workflows.diagnose import DiagnosedModel
    from seatrial.ident.workflows.vehicle import VehicleFit
    from seatrial.ident.workflows.vehicle_model import VehicleRequest

Logs = PathLike | Log | Sequence[PathLike | Log]
ARGUMENTS = ("validate", "model", "logs")  # arguments that are no options, for the hint about an unknown option
# Names by which users look for an option that has another name
OTHER_NAMES = {"common_errors": "score_tests", "parameters": "chosen"}
LISTS = (
    "effects",
    "exclude",
    "profiles",
    "homogeneity",
    "per_log",
    "chosen",
)  # options with a list of names, for which one name may be given
# Options with values of parameters by name, with an example of each for the messages
PARAMETER_VALUES = {"fixed": '{"c1": 6.85}', "initial": '{"m_u": 30.0}', "priors": '{"c1": (6.85, 0.3)}'}


@with_short_help
class FitOptions(TypedDict, total=False):
    """Options of `fit`. All are optional; the defaults are those of ``seatrial ident vehicle``.

    An option without a default below is not set.

    Attributes
    ----------
    thruster : path
        File or folder with the thrust from a bench test: model.toml of a thruster model, or of a static curve from
        command to thrust. Without it the thrust is estimated or unknown.
    thrust_of : "left", "right", "both" or "unknown"
        Thruster that has the given thrust, if the thrusts of both sides differ; ``both``: their mean has it. Masses and
        standard errors follow from it. Without it, this is unknown, or that of a model.toml.
    fixed : dict of str to float
        Values of parameters, by name, that are known and not estimated, in SI units and radians.
    initial : dict of str to float
        Initial values of parameters, by name, for the search of the maximum of the likelihood, in SI units and radians.
    priors : dict of str to (mean, standard deviation)
        Priors of parameters by name, in SI units and radians.
    effects : sequence of str
        Names of effects of the catalogue, or of ``effects_file``, to add to the model with free parameters. As for all
        lists of names, one name may be given as text.
    effects_file : path
        Python file with user-defined effects to add to the model: all of them, or those that ``effects`` names.
    per_log : sequence of str
        Names of parameters of these effects that have a value of their own in each log, such as ``["F_wx", "F_wy"]``
        of a wind that differs between the days of the logs.
    mass : float
        Weighed mass of the boat [kg]. A warning tells if the estimated mass in surge is below it or above 1.3
        times it, both by more than two standard errors, or above twice it. It is no prior.
    score_tests : bool
        Whether to test the model for missing effects, True by default. Small errors of sensors and hull form are then
        estimated if the logs show them, and the standard errors include what remains unexplained. With False, also
        beside ``effects``, only the errors that the given model has already are estimated: those of the model.toml of
        a tested fit as ``model`` are kept.
    profiles : sequence of str
        Names of the parameters whose profile likelihood is computed.
    homogeneity : sequence of str
        Names of parameters that all logs share, for which the fit tests whether the logs agree in one value. The answer
        has the value of each log, and names the logs that differ.
    outlier_model : bool
        Whether outliers are part of the noise of all sensors, so that they have little weight. False by default.
    reml : bool
        Whether the noise is estimated by restricted maximum likelihood, True by default.
    mean_order : 1 or 2
        Order of the extended Kalman filter, 2 by default; at order 2 its mean includes the curvature of the model.
    horizon : float
        Horizon [s] of the predictions with which the fit is evaluated, 10 s by default.
    rate : float
        Rate of the rows [Hz] to which faster sensors are averaged, 10 Hz by default.
    despite_faults : bool
        Whether to fit logs with faults that make a fit meaningless, False by default.
    progress : bool
        Whether to print a line for each step of the computation. Without it, a terminal or notebook shows a line every
        30 s.
    """

    thruster: PathLike
    thrust_of: Literal["left", "right", "both", "unknown"]
    fixed: Mapping[str, float]
    initial: Mapping[str, float]
    priors: Mapping[str, tuple[float, float]]
    effects: Sequence[str]
    effects_file: PathLike
    per_log: Sequence[str]
    mass: float
    score_tests: bool
    profiles: Sequence[str]
    homogeneity: Sequence[str]
    outlier_model: bool
    reml: bool
    mean_order: Literal[1, 2]
    horizon: float
    rate: float
    despite_faults: bool
    progress: bool


@with_short_help
class DiagnosisOptions(TypedDict, total=False):
    """Options of `diagnose`. All are optional; the defaults are those of ``seatrial ident diagnose``.

    An option without a default below is not set.

    Attributes
    ----------
    max_effects : int
        Largest number of effects to add to the model, 3 by default.
    exclude : sequence of str
        Names of effects that the search leaves out, such as ``["wind"]``.
    effects_file : path
        Python file with user-defined effects, which are tested too.
    fixed : dict of str to float
        Values of parameters of the model, by name, that are held in all fits of the diagnosis, in SI units and radians.
    thruster : str
        For a vehicle model: file of the static curve that it was fitted with. For a thruster model: name of the
        thruster, if the logs have several.
    thrust_of : "left", "right", "both" or "unknown"
        Thruster that has the given thrust, as that of `FitOptions`; without it, as in the fit of the model.
    mass : float
        Weighed mass of the boat [kg], as that of `FitOptions`.
    outlier_model : bool
        Whether outliers are part of the noise of all sensors, so that they have little weight. False by default.
    horizon : float
        Horizon [s] of the predictions with which the models are evaluated; by default 10 s, for a thruster 1 s.
    rate : float
        Rate of the rows [Hz] to which faster sensors are averaged; by default 5 Hz for a slow boat without
        accelerometers, 10 Hz for others, and 50 Hz for a thruster.
    despite_faults : bool
        Whether to search in logs with faults that make a fit meaningless, False by default.
    progress : bool
        Whether to print a line for each step of the computation. Without it, a terminal or notebook shows a line every
        30 s.
    """

    max_effects: int
    exclude: Sequence[str]
    effects_file: PathLike
    fixed: Mapping[str, float]
    thruster: str
    thrust_of: Literal["left", "right", "both", "unknown"]
    mass: float
    outlier_model: bool
    horizon: float
    rate: float | None
    despite_faults: bool
    progress: bool


@dataclass(frozen=True, repr=False)
class FitReport(Shown):
    """Result of a fit as an object: estimates with their uncertainty, tables and the figure of its predictions.

    Attributes
    ----------
    result : FitResult
        Content of result.json (`seatrial.ident.results`).
    """

    result: FitResult

    @property
    def answer(self) -> str:
        """Main conclusion of the fit in a few sentences, as in its report; its caveat follows."""
        return tables.conclusion(self.result)

    @property
    def warnings(self) -> list[str]:
        """Warnings of the fit, one text for each. The list is empty if the fit has no warnings."""
        return tables.warning_texts(self.result)

    @property
    def notes(self) -> list[str]:
        """Notes of the fit: assumptions and choices that the computation made, such as how sensors are modelled.

        One text for each; the report has them under *Notes*.
        """
        return tables.note_texts(self.result)

    @property
    def converged(self) -> bool:
        """Whether the search for the maximum of the likelihood converged. Otherwise do not use the estimates.

        Of a diagnosis: whether the fit without the added effects and the fit with them both converged.
        """
        return self.result.converged

    @property
    def params(self) -> dict[str, float]:
        """Values of all parameters by name, estimated and fixed, in SI units and radians.

        In a fit to several records, a parameter with its own value in each record is ``NAME@RECORD``. If the thrust is
        not known in N, forces and masses are ratios to it, with names such as ``m_u/T``.
        """
        return NamedValues({tables.full_name(row): row.value for row in self.result.fit.parameters}, "parameter")

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard errors of the estimated parameters by name, as in `params`.

        NaN stands for a parameter without standard error, for example at a bound. Fixed parameters are left out.
        """
        errors = {
            tables.full_name(row): np.nan if row.se is None else row.se
            for row in self.result.fit.parameters
            if row.free
        }
        return NamedValues(errors, "estimated parameter")

    def summary(self) -> str:
        """Return a table of the estimates as text, with the answer, the warnings and the notes.

        The columns are estimate, standard error, 95 % interval, t statistic, unit and origin.
        """
        return tables.summary(self.result)

    def to_pandas(self) -> Any:
        """Return the parameters as a ``pandas.DataFrame`` with a row for each.

        The columns are value, se, low, high (95 % interval), t, unit, origin, free, flag and meaning. A flag is a short
        code of what is wrong with the estimate, such as ``at bound`` or ``prior``; `summary` has its text.

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        return tables.frame(self.result)

    def residual_tests(self, on: Role = "estimation") -> Any:
        """Return the tests of the residuals as a ``pandas.DataFrame`` with a row for each test.

        Each record and channel has the tests ``ljung-box`` and ``periodogram`` of whiteness, ``normality``, and a
        ``cross-correlation`` with each input. Of a diagnosis they are those of the model with the effects. The index
        names the test of a row, such as ``r ljung-box`` or ``r cross-correlation n_left``, after the record if there
        are several. The columns are:

        - p, the p value;
        - statistic, the largest deviation that the test found: an autocorrelation, a distance of the cumulative
          periodogram from that of white noise, a residual in standard deviations, or a correlation coefficient;
        - statistic_is, the name of that statistic;
        - lag [s] of the largest correlation, and frequency [Hz] of the largest distance of the periodogram;
        - record, channel, test, and input of a cross-correlation;
        - limit, the level below which p is a failure: 0.5 % for a test of whiteness, 1 % for normality, and 1 % divided
          by the number of correlations of the result for each of these;
        - verdict in words.

        Parameters
        ----------
        on : ``estimation`` or ``validation``
            Data whose residuals are tested.

        Raises
        ------
        SeatrialError
            If pandas is not installed, or if there are no residual tests of validation data.
        """
        return tables.residual_frame(self.result, on)

    def errors_to_pandas(self) -> Any:
        """Return the RMS prediction errors as a ``pandas.DataFrame``, with those before and after a diagnosis.

        There is a row for each role (``estimation`` and, if there are such data, ``validation``), kind of prediction
        and channel. The columns are:

        - role; kind (``one_step``, ``horizon`` or ``simulation``, which leaves out the first 15 s of each record, in
          which the filter sees the samples); seconds, the horizon [s], NaN for the other kinds;
        - channel, and unit of its errors (SI units and radians);
        - before and after, the RMS errors of the models without and with the effects of a diagnosis. For a fit, after
          is the error of the model, and before is NaN. A prediction that diverged is NaN;
        - low and high, the 95 % interval of after / before, NaN without one;
        - verdict on the change: ``fell``, ``rose`` or, if the interval contains 1, ``unchanged``. It is empty without
          an interval.

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        return tables.error_frame(self.result)

    def plot(self, *channels: str, record: str | None = None) -> Figure:
        """Return a figure of measured and predicted channels over the horizon, validation records first.

        Parameters
        ----------
        *channels : str
            Names of the channels to draw, such as ``"psi"``; without names all are drawn.
        record : str, optional
            Name of the only record to draw; without it all are drawn.

        Raises
        ------
        SeatrialError
            If the result has no channel with one of the names, or no such record.
        """
        return plots.prediction_figure(self.result, channels, record)

    def __repr__(self) -> str:
        """Return a short text for the interpreter: class of the result, name of the model, and `answer`."""
        return f"<{type(self).__name__}: {self.result.fit.model}>\n{self.answer}\nsummary() has the estimates."

    def _content(self) -> Content:
        """Return answer, warnings and the table of the estimates."""
        return tables.content(self.result)


@dataclass(frozen=True, repr=False)
class FittedResult(FitReport):
    """Model that was fitted in this process, with the records of its logs, and its result.

    Attributes
    ----------
    result : FitResult
        Content of the result.json that the command would write (`seatrial.ident.results`).
    fitted : FittedModel
        The fitted model with its estimation and validation records (`seatrial.ident.estimation.FittedModel`).
    """

    fitted: FittedModel

    @property
    def cov(self) -> NDArray[np.float64]:
        """Covariance of the estimates (n, n), in the order of `free` and in the parameters' own units.

        NaN stands for parameters without a standard error.
        """
        return np.asarray(self.fitted.fit.covariance)

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the n estimated parameters, in the order of `cov`. ``V_x@0`` is V_x in the first record.

        The number of the record, from 0, follows the @. The names in `params` have the name of the record instead.
        """
        return self.fitted.fit.names

    @property
    def log_likelihood(self) -> float:
        """Natural logarithm of the likelihood at the estimates, without the priors.

        With restricted likelihood (``reml``), it is that of the fit before the noise is estimated again.
        """
        return self.fitted.fit.log_likelihood

    @property
    def aic(self) -> float:
        """Akaike information criterion of the fit; among models of the same data the smaller value is better.

        It is two times the number of estimates, minus two times `log_likelihood`.
        """
        return self.fitted.fit.aic

    @property
    def bic(self) -> float:
        """Bayesian information criterion of the fit; among models of the same data the smaller value is better.

        It is the number of estimates times ln(number of measurements), minus two times `log_likelihood`.
        """
        return self.fitted.fit.bic

    def cov_to_pandas(self) -> Any:
        """Return the covariance of the estimates as a ``pandas.DataFrame`` with their names as index and columns.

        It is `cov` with the names of `free`, as ``cov_params()`` of statsmodels.

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        return tables.labelled_covariance(self.cov, self.free)

    def residuals(self, on: Role = "estimation") -> ByRecord[Series]:
        """Return the standardised residuals by record and channel: innovations divided by their standard deviations.

        Parameters
        ----------
        on : ``estimation`` or ``validation``
            Data whose residuals are returned.

        Returns
        -------
        ByRecord of Series
            By record and channel; `to_pandas` gives one table of all. White noise of variance 1 if the model is
            complete. A channel has values only at its samples. A channel without samples in a record is missing.

        Raises
        ------
        SeatrialError
            If ``on`` is ``validation`` and the fit has no validation data.
        """
        found = ByRecord[Series]()
        for view in self._views(on):
            by_channel = {}
            for j, output in enumerate(self.fitted.model.outputs):
                e = view.run.standardised[:, j]
                if np.isfinite(e).any():
                    by_channel[output.name] = Series(view.record.t_log[np.isfinite(e)], e[np.isfinite(e)])
            found[view.record.name] = by_channel
        return found

    def predict(self, horizon: float | None = None, on: Role | None = None) -> ByRecord[Prediction]:
        """Predict samples from the filtered state a time ``horizon`` earlier, by the inputs alone since then.

        Samples before this time has passed have no prediction. Of the other samples of a channel, about one in two rows
        is predicted, and about 4000 in a long record.

        Parameters
        ----------
        horizon : float, optional
            Horizon [s]. None: that of the fit.
        on : ``estimation`` or ``validation``, optional
            Data whose samples are predicted. None: the validation data if there are any, otherwise the estimation data.

        Returns
        -------
        ByRecord of Prediction
            Predictions by record and channel; `to_pandas` gives one table of all. Angles are not wrapped: the
            prediction is within half a turn of the sample.

        Raises
        ------
        SeatrialError
            If ``on`` is ``validation`` and the fit has no validation data, or if the horizon is no time above zero or
            longer than every record.
        """
        seconds = self.result.horizon_seconds if horizon is None else horizon
        if isinstance(seconds, bool) or not isinstance(seconds, Real) or not 0.0 < seconds < math.inf:
            raise SeatrialError(f"horizon {seconds!r}: give a time above zero [s]")
        longest = max(float(view.record.t[-1] - view.record.t[0]) for view in self._views(on))
        if seconds >= longest:
            raise SeatrialError(f"horizon {seconds:g}: the longest record lasts {longest:.1f} s; give a shorter time")
        found, outputs = ByRecord[Prediction](), {o.name: o for o in self.fitted.model.outputs}
        for predicted in self._evaluated(on, float(seconds)):
            record, sd = predicted.record, {name: far.sd for name, far in predicted.horizon.items()}
            found[record.name] = {
                n: _prediction(record, outputs[n], e.t, e.e, sd[n]) for n, e in predicted.errors.items()
            }
        return found

    def simulate(self, on: Role | None = None) -> ByRecord[Prediction]:
        """Simulate each record: the state is filtered for 15 s, and then predicted by the inputs alone to the end.

        Between their samples, the inputs have the hold of the log and of the model: commands are constant, and measured
        shaft speeds are linear.

        Parameters
        ----------
        on : ``estimation`` or ``validation``, optional
            Data to simulate. None: the validation data if there are any, otherwise the estimation data.

        Returns
        -------
        ByRecord of Prediction
            Simulated values at the samples after 15 s, by record and channel; `to_pandas` gives one table of all. A
            channel without such samples is missing.

        Raises
        ------
        SeatrialError
            If ``on`` is ``validation`` and the fit has no validation data.
        """
        found, outputs = ByRecord[Prediction](), {o.name: o for o in self.fitted.model.outputs}
        for simulated in self._evaluated(on, self.result.horizon_seconds):
            record, run = simulated.record, simulated.simulation
            found[record.name] = {
                n: _prediction(
                    record, outputs[n], e.t, e.e, run.sd[np.searchsorted(record.t, e.t), record.outputs.index(n)]
                )
                for n, e in run.errors.items()
            }
        return found

    def plot_residuals(self, *channels: str, on: Role = "estimation") -> Figure:
        """Return a figure of the standardised residuals (see `residuals`) over time, with lines at ± 2.

        Parameters
        ----------
        *channels : str
            Names of the channels to draw, such as ``"psi"``; without names all are drawn.
        on : ``estimation`` or ``validation``
            Data whose residuals are drawn.

        Raises
        ------
        SeatrialError
            If there is no channel with one of the names, or if ``on`` is ``validation`` and the fit has no validation
            data.
        """
        return plots.residual_figure(self.residuals(on), channels)

    def save(self, folder: PathLike) -> Path:
        """Write the files of the command to a folder, and return its path.

        Parameters
        ----------
        folder : path
            Folder, which is created if it does not exist. Existing files of the same names are replaced.
        """
        raise NotImplementedError

    def _save_model(self, folder: Path) -> Path:
        """Write to a folder what a command reads of this model: all files of `save`, or those but the report."""
        return self.save(folder)

    @cached_property
    def _evaluation(self) -> PredictionEvaluation:
        """Evaluation of the model over the horizon of its result."""
        from seatrial.ident.validation import evaluate

        return evaluate(self.fitted, self.result.horizon_seconds)

    def _evaluated(self, on: Role | None, horizon: float) -> tuple[RecordPrediction, ...]:
        """Return the predictions of each record of the data ``on``, as `_views` selects them, over ``horizon`` [s]."""
        from seatrial.ident.validation import evaluate

        is_own = horizon == self.result.horizon_seconds
        evaluation = self._evaluation if is_own else evaluate(self.fitted, horizon)
        role = "validation" if self._views(on) is self.fitted.validation else "estimation"
        return evaluation.sets[role].records

    def _views(self, on: Role | None) -> tuple[RecordEvaluation, ...]:
        """Return the evaluated records (with model, filter run and parameter values) of estimation or validation data.

        With None these are the validation data if there are any, otherwise the estimation data. SeatrialError is raised
        if `on` is another word, or if it is "validation" and there are no validation data.
        """
        if on not in (None, "estimation", "validation"):
            raise SeatrialError(f"on: {on!r} names no data; give 'estimation' or 'validation'")
        if on == "validation" and not self.fitted.validation:
            raise SeatrialError("this fit has no validation data; fit again with logs as the argument `validate`")
        return self.fitted.validation if on != "estimation" and self.fitted.validation else self.fitted.estimation


class MotionMethods:
    """Steady motion and linear models of a boat, as methods of its fitted or loaded model."""

    def linearise(self, speed: float, at: Mapping[str, float] | None = None) -> Linearisation:
        """Linearise the model about straight motion at a forward speed [m/s], as `st.linearise`.

        Parameters
        ----------
        speed : float
            Forward speed through the water [m/s], not zero.
        at : dict of str to float, optional
            Values of the conditions by name that an effect may depend on: ``t``, ``work``, ``x``, ``y``, ``psi``.

        Raises
        ------
        SeatrialError
            If the model has no forward speed, as that of a thruster, or if the boat does not reach this speed.
        """
        from seatrial.api.motion import linearise

        return linearise(cast(Any, self), speed, at)

    def steady(
        self, means: Sequence[float] | None = None, points: int = 41, at: Mapping[str, float] | None = None
    ) -> Steady:
        """Compute the steady speed and the steady turn rate over the command in still water, as `st.steady`.

        Parameters
        ----------
        means : sequence of float, optional
            Means of the left and the right command in turns, as parts of the largest command, 0 to 1. None: 0, 0.5, and
            the mean with the largest difference of both sides in the data, if it is another one.
        points : int
            Number of commands of each curve, at least 3.
        at : dict of str to float, optional
            Values of the conditions by name that an effect may depend on, as for `linearise`.

        Raises
        ------
        SeatrialError
            If the model has neither a speed nor a turn rate, as that of a thruster.
        """
        from seatrial.api.motion import steady

        return steady(cast(Any, self), means, points, at)


@dataclass(frozen=True, repr=False)
class FittedVehicle(MotionMethods, FittedResult):
    """Vehicle model that was fitted to logs. `fit` returns it.

    Attributes
    ----------
    result : VehicleResult
        Content of result.json.
    effects_file : Path or None
        Python file with user-defined effects that was given, or that the model.toml of ``model`` names; None without
        one.
    """

    result: VehicleResult
    effects_file: Path | None = None

    def save(self, folder: PathLike) -> Path:
        """Write model.toml, result.json and report.html, as ``seatrial ident vehicle``, and return the folder.

        Parameters
        ----------
        folder : path
            Folder for the files. Existing files of these names are replaced.
        """
        return self._write(folder, report=True)

    def _save_model(self, folder: Path) -> Path:
        """Write model.toml and result.json to a folder."""
        return self._write(folder, report=False)

    def _write(self, folder: PathLike, report: bool) -> Path:
        """Write model.toml, result.json and, if ``report``, report.html. Return the folder."""
        from seatrial.ident.workflows.vehicle import VehicleFit, write_vehicle_fit

        out = output_folder(folder)
        write_vehicle_fit(VehicleFit(self.fitted, self.result, effects_file=self.effects_file), out, report)
        return out


@dataclass(frozen=True, repr=False)
class FittedDiagnosis(DiagnosisFindings, MotionMethods, FittedResult):
    """Diagnosis of a model: the effects that it lacks, and the model with these effects. `diagnose` returns it.

    Attributes
    ----------
    result : DiagnosisResult
        Content of result.json.
    fitted : FittedModel
        The model with the effects.
    found : Diagnosis
        All steps and findings of the search (`seatrial.ident.diagnosis.Diagnosis`).
    effects_file : Path or None
        Python file with user-defined effects that was given, or that the diagnosed model.toml names; None without one.
    """

    result: DiagnosisResult
    found: Diagnosis
    effects_file: Path | None = None

    def save(self, folder: PathLike) -> Path:
        """Write model.toml with the effects, result.json and report.html, as ``seatrial ident diagnose``.

        Parameters
        ----------
        folder : path
            Folder for the files, which is returned. Existing files of these names are replaced.
        """
        return self._write(folder, report=True)

    def _save_model(self, folder: Path) -> Path:
        """Write model.toml and result.json to a folder."""
        return self._write(folder, report=False)

    def _write(self, folder: PathLike, report: bool) -> Path:
        """Write model.toml, result.json and, if ``report``, report.html. Return the folder."""
        from msgspec import structs

        from seatrial.ident.results import with_model_of_design
        from seatrial.ident.workflows.diagnose import DiagnosedModel, write_diagnosed_model

        out, result = output_folder(folder), self.result
        if advice := result.recommended_experiment:  # its command needs the model.toml of this folder
            advice = with_model_of_design(advice, str(out / "model.toml"), "model.toml")
            result = structs.replace(result, recommended_experiment=advice)
        elif result.no_experiment:  # so may the advice in place of an experiment
            reason = with_model_of_design(result.no_experiment, str(out / "model.toml"), "model.toml")
            result = structs.replace(result, no_experiment=reason)
        write_diagnosed_model(DiagnosedModel(self.found, result, self.effects_file), out, report)
        return out


def fit(logs: Logs, model: str = "auto", validate: Logs = (), **options: Unpack[FitOptions]) -> FittedVehicle:
    """Fit a model of the boat to logs, with the defaults and the checks of ``seatrial ident vehicle``.

    Parameters
    ----------
    logs : path, `Log` or sequence of them
        Logs that the model is fitted to. Of a `Log`, its own window is used.
    model : str
        Name of the structure, such as ``horizontal:command``, or ``FILE.py:NAME`` of your own; or a model.toml or the
        folder of a fit, whose structure and effects are fitted again. ``auto``: the horizontal model with the inputs
        that the logs have.
    validate : path, `Log` or sequence of them
        Other logs, on which the fit is evaluated. They are used whole, so a `Log` with a window is an error. Without
        them the fit is evaluated on ``logs``.
    **options
        `FitOptions`, which ``help(st.FitOptions)`` describes: thruster, thrust_of, fixed, initial, priors, effects,
        effects_file, per_log, mass, score_tests, profiles, homogeneity, outlier_model, reml, mean_order, horizon,
        rate, despite_faults, progress.

    Returns
    -------
    FittedVehicle
        The fitted model. No file is written; ``save`` writes the files of the command.

    Raises
    ------
    SeatrialError
        If a log cannot be read, lacks signals that the model needs, or has faults that make a fit meaningless; if an
        option is unknown.

    Examples
    --------
    >>> fit = st.fit("run1.mcap", validate="run3.mcap", priors={"c1": (40.0, 2.0)}, fixed={"c2": 1.1})
    >>> fit.params["m_u"], fit.standard_errors["m_u"]
    """
    from seatrial.ident.workflows.vehicle import fit_vehicle

    with errors_of_users():
        paths, validation = _logs_and_validation(logs, validate)
        request, progress = vehicle_request(paths, validation, model, window_of(logs), options)
        messages = Messages(progress)
        command = python_call(fit, {"logs": logs, "model": model, "validate": validate, **options})
        done: VehicleFit = fit_vehicle(request, command, messages)
    warn_of_result(done.result, messages)
    return FittedVehicle(done.result, done.fitted, done.effects_file)


def vehicle_request(
    logs: Sequence[Path], validation: Sequence[Path], model: str, window: Any, options: Mapping[str, Any]
) -> tuple[VehicleRequest, bool | None]:
    """Return the request of a vehicle fit from the options of the user, and whether progress is printed.

    Parameters
    ----------
    logs, validation : sequence of Path
        Estimation and validation logs.
    model : str
        Name of the structure.
    window : TimeWindows
        Interval of time of the estimation logs.
    options : mapping
        Options by name (`FitOptions`).

    Raises
    ------
    SeatrialError
        If there is no option of a name, if values of parameters are no dict of numbers, or if a prior is no pair of
        numbers.
    """
    from seatrial.ident.estimation import EstimationOptions, model_file, model_source
    from seatrial.ident.workflows.vehicle_model import VehicleRequest

    given = known_options(options, FitOptions)
    check_parameters(given)
    if not isinstance(model, str | Path):
        raise SeatrialError(
            f"model: {shortened(model)} is no name of a model; give a name, such as 'horizontal:command', the path of "
            "a model.toml, or FILE.py:NAME of your own"
        )
    progress = given.pop("progress", None)
    estimation = {n: given.pop(n) for n in ("outlier_model", "reml", "mean_order", "horizon") if n in given}
    if "thruster" in given:
        given["thruster"] = model_file(as_path(given["thruster"], "thruster"))
    if given.get("effects_file") is not None:
        given["effects_file"] = Path(given["effects_file"])
    how = replace(EstimationOptions(reml=True, mean_order=2), **estimation)
    source = model_source(str(model))
    return VehicleRequest(logs, validation, Path(), how, source, window=window, **given), progress


def check_parameters(given: Mapping[str, Any]) -> None:
    """Check the options with values of parameters (``fixed``, ``initial``, ``priors``), if they are in ``given``.

    Raises
    ------
    SeatrialError
        If one is no dict, if a value is no number, if a prior is no pair of mean and standard deviation, or if this
        deviation is not above zero.
    """
    for option, example in PARAMETER_VALUES.items():
        values = given.get(option, {})
        if not isinstance(values, Mapping):
            raise SeatrialError(f"{option}: give a dict, such as {example}, not {shortened(values)}")
        for name, value in values.items():
            if option == "priors" and np.shape(value) != (2,):
                text = f"give a pair of mean and standard deviation, such as ({value}, 1.0)"
                raise SeatrialError(f"priors: {name}: {text}")
            if not all(isinstance(x, Real) for x in (value if option == "priors" else [value])):
                raise SeatrialError(f"{option}: {name}: {value!r} is no number; give a dict, such as {example}")
            if not all(map(math.isfinite, value if option == "priors" else [value])):
                raise SeatrialError(f"{option}: {name}: {shortened(value)} is not finite; give finite numbers")
            if option == "priors" and not 0.0 < value[1] < math.inf:
                known = f"fixed={{{name!r}: {value[0]:g}}}"
                raise SeatrialError(
                    f"priors: {name}: the standard deviation {value[1]:g} is not above zero; if the value is known, "
                    f"give {known}"
                )


def diagnose(
    model: PathLike | FittedResult | Saved, logs: Logs, validate: Logs = (), **options: Unpack[DiagnosisOptions]
) -> FittedDiagnosis:
    """Find the effects (physical phenomena) that a model lacks, as ``seatrial ident diagnose``.

    Parameters
    ----------
    model : path, `FittedVehicle` or `FittedDiagnosis`
        Model to diagnose: a model.toml, a folder with one, a loaded or a fitted model.
    logs : path, `Log` or sequence of them
        Logs for the search. Of a `Log`, its own window is used.
    validate : path, `Log` or sequence of them
        Other logs that validate each effect. They are used whole, so a `Log` with a window is an error. Without them,
        blocks of ``logs`` are cross-validated.
    **options
        `DiagnosisOptions`, which ``help(st.DiagnosisOptions)`` describes: max_effects, exclude, effects_file,
        fixed, thruster, thrust_of, mass, outlier_model, horizon, rate, despite_faults, progress.

    Returns
    -------
    FittedDiagnosis
        The effects, and the model with them. No file is written; ``save`` writes the files of the command.

    Raises
    ------
    SeatrialError
        If model or logs cannot be used, if the logs have faults that make a fit meaningless, if an option is unknown,
        or if a parameter cannot be held at its given value.

    Examples
    --------
    >>> found = st.diagnose(fit, ["run1.mcap", "run2.mcap"], validate="run3.mcap")
    >>> found.answer
    >>> found.effects
    {'mismatch': 'identified'}
    """
    from seatrial.ident.estimation import EstimationOptions
    from seatrial.ident.workflows.diagnose import DiagnosisRequest, diagnose_model

    given = known_options(options, DiagnosisOptions)
    check_parameters(given)
    messages = Messages(given.pop("progress", None))
    estimation = {n: given.pop(n) for n in ("outlier_model", "horizon") if n in given}
    if "effects_file" in given:
        given["effects_file"] = Path(given["effects_file"])
    with errors_of_users(), model_path(model) as path:
        paths, validation = _logs_and_validation(logs, validate)
        request = DiagnosisRequest(
            path,
            paths,
            validation,
            Path(),
            EstimationOptions(**estimation),
            window=window_of(logs),
            **given,
        )
        command = python_call(diagnose, {"model": model, "logs": logs, "validate": validate, **options})
        done: DiagnosedModel = diagnose_model(request, command, messages)
    warn_of_result(done.result, messages)
    return FittedDiagnosis(done.result, done.found.after, done.found, done.effects_file)


def refuse_log(model: object) -> None:
    """Raise SeatrialError if a log, or the path of one, was given in place of a model."""
    if isinstance(model, Log) or (isinstance(model, str | Path) and is_log(Path(model))):
        name = model.path if isinstance(model, Log) else model
        raise SeatrialError(f"{name}: is a log, not a model; the model is the first argument, and the logs follow")


@contextmanager
def model_path(model: PathLike | FittedResult | Saved) -> Iterator[Path]:
    """Yield the path of a model.toml: of the file itself, of the one in a folder, or of a temporary file.

    Of a `Saved`, it is the file from which it was loaded, or that beside its result.json. A fitted model is written to
    a temporary folder, which is deleted after the `with` block. With a Python file of the user, the folder stays until
    the end of the process, because a model that is read from it names the copy of the file there.

    Raises
    ------
    SeatrialError
        If the path does not exist, or if it is a log.
    """
    if isinstance(model, FittedResult):
        from seatrial.ident.models import is_own_model

        with ExitStack() as stack:
            folder = stack.enter_context(TemporaryDirectory())
            if is_own_model(model.fitted.model.source):
                atexit.register(stack.pop_all().close)
            yield model._save_model(Path(folder)) / "model.toml"
        return
    from seatrial.api.loading import RESULT, Saved
    from seatrial.ident.estimation import model_file

    if isinstance(model, Saved):
        model = model.path.parent if model.path.name == RESULT else model.path
    refuse_log(model)
    if not isinstance(model, str | Path):
        raise SeatrialError(
            f"{type(model).__name__}: this is not a model; give a model.toml, a folder with one, or a fitted model"
        )
    path = model_file(Path(model))
    if not path.exists():
        raise SeatrialError(
            f"{path}: no such file; {file_hint(path)}give a model.toml, a folder with one, or a fitted model"
        )
    yield path


def window_of(logs: Logs) -> Any:
    """Return the intervals of time of the logs that a workflow uses (`seatrial.ident.data.TimeWindows`).

    Of a `Log` it is the window with which it was opened, of a path the whole log. The result is one interval if it is
    the same for all logs, and a tuple of one for each log otherwise. Without logs it is the whole log.
    """
    from seatrial.ident.data import WHOLE, TimeWindow

    several = as_list(logs)
    windows = tuple(TimeWindow(x.start, x.end) if isinstance(x, Log) else WHOLE for x in several)
    if not windows:
        return WHOLE
    return windows[0] if len(set(windows)) == 1 else windows


def _logs_and_validation(logs: Logs, validate: Logs) -> tuple[list[Path], list[Path]]:
    """Return the paths of the logs of a fit and of its validation logs, which are used whole and may be none.

    Raises
    ------
    SeatrialError
        As `as_logs`, or if a `Log` of the validation has a window.
    """
    several = as_list(validate)
    if cut := [x.path.name for x in several if isinstance(x, Log) and (x.start > 0.0 or np.isfinite(x.end))]:
        raise SeatrialError(f"validation logs are always used as a whole: open {', '.join(cut)} without start and end")
    paths, *validation = as_logs(logs, *([several] if several else ()))
    return paths, validation[0] if validation else []


def known_options(given: Mapping[str, Any], options: type) -> dict[str, Any]:
    """Return the options as a new dict, after a check of their names. A list of names may be given as one name.

    One name of effects, exclude, per_log, profiles or homogeneity becomes a list of one. The other values are not
    changed. Numbers and paths are checked as `check_values` does.

    Parameters
    ----------
    given : dict
        Options of the user by name.
    options : type
        The `TypedDict` with the options of the function, such as `FitOptions`.

    Raises
    ------
    SeatrialError
        If there is no option of a name, with the options in the message, or if a value cannot be used.
    """
    known = sorted(options.__annotations__)
    for name in given:
        if name not in known:
            similar = OTHER_NAMES.get(name)
            similar = similar if similar in known else closest_name(name, (*known, *ARGUMENTS))
            hint = f"did you mean {similar!r}? The options are" if similar else "the options are"
            raise SeatrialError(f"there is no option {name!r}; {hint} {', '.join(known)}")
    check_values(given)
    check_switches(given, options)
    return {n: [v] if n in LISTS and isinstance(v, str) else v for n, v in given.items()}


def _prediction(
    record: Any, output: Output, t: NDArray[np.float64], error: NDArray[np.float64], sd: NDArray[np.float64]
) -> Prediction:
    """Return the samples and predictions of a channel of a record, from the prediction errors at its sample times.

    `output` is the channel in the model. `t` (n,) are the times of the samples [s] in the record; those
    of the result count from the start of the log. `error` (n,) is measured minus
    predicted, and `sd` (n,) its predicted standard deviation, both in the unit of the channel.
    """
    measured = record.y[np.searchsorted(record.t, t), record.outputs.index(output.name)]
    return Prediction(t + record.t_from, measured, measured - error, sd, output.unit)
