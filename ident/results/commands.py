"""Types of the results that are not fits, and builders of the results of a vehicle or thruster fit.

The types are those of information in logs, navigation, sensor noise, mission design, Monte Carlo study and fleet.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from seatrial.ident.characterisation import TurningShaft, directions, largest_speeds
from seatrial.ident.diagnosis import COMMON_ERRORS, ModelAssessment, ModelUncertainty
from seatrial.ident.effects import catalogue
from seatrial.ident.estimation import FittedModel, HomogeneityTest, Profile, ReportedEstimates
from seatrial.ident.model import Effect, Model
from seatrial.ident.models import is_own_model, residuals_of
from seatrial.ident.numerics import Array
from seatrial.ident.results.answers import (
    calibration_notes,
    candidate_sentence,
    check_warnings,
    coloured_sentence,
    course_sentence,
    dead_zone_warnings,
    estimation_logs,
    estimation_warnings,
    failed_run_warnings,
    faults_first,
    frames_assumed,
    homogeneity_sentence,
    late_command_sentence,
    late_sensor_warnings,
    mass_notes,
    moving_boat_warnings,
    not_converged,
    outlier_lines,
    position_drift_notes,
    prior_notes,
    short_data_warnings,
    simulated_durations,
    smallest_command,
    straight_sentence,
    structure_warnings,
    thruster_answer,
    thruster_warnings,
    vehicle_answer,
    warm_up_notes,
    wind_sentence,
)
from seatrial.ident.results.data_names import of_judging_data
from seatrial.ident.results.parts import (
    Calibrations,
    Dynamics,
    EffectParameter,
    InputTrace,
    Part,
    Provenance,
    Result,
    ShaftResponse,
    StaticForce,
    SteadyBench,
    ThrusterResult,
    UnusedSignal,
    VehicleResult,
    same_length,
)
from seatrial.ident.results.tables import (
    all_inputs,
    calibration_tables,
    common_errors_notes,
    common_errors_row,
    cross_correlations,
    error_tables,
    fit_summary,
    homogeneity_reported,
    homogeneity_row,
    model_uncertainty_notes,
    prediction_fit,
    profile_curve,
    residual_rows,
    thrust_difference_warnings,
    thrust_of_notes,
    traces,
    tracks,
)
from seatrial.ident.validation import PredictionEvaluation


@dataclass(frozen=True)
class FitContext:
    """Context of a fit: what is reported with the estimates, but is not part of the fit itself.

    Attributes
    ----------
    start
        Initial value of each parameter by name, in the unit of the parameter.
    notes
        Sentences that precede the other notes of the result.
    unused
        Signals of the logs that the model does not use.
    hull
        What the user knows of the boat, if anything: ``length`` [m], weighed ``mass`` [kg] and thrust ``ahead`` [N].
    assessment
        Result of the score tests of the model, with the common errors that were added. None if it was not tested.
    dynamics
        Steady motion, poles and step responses of the fitted model; None if it has none.
    uncertainty
        Shifts of the estimates by missing effects and by another scale of the forces, which the standard errors
        include; None if there are none.
    effect_parameters
        Names of the parameters of the effects that the user added to the model.
    """

    start: Mapping[str, float]
    notes: Sequence[str] = ()
    unused: Sequence[UnusedSignal] = ()
    hull: Mapping[str, float] = field(default_factory=dict)
    assessment: ModelAssessment | None = None
    dynamics: Dynamics | None = None
    uncertainty: ModelUncertainty | None = None
    effect_parameters: Sequence[str] = ()


# Beginning of the notes on a fit without score tests, which the terminal shows
NOT_TESTED = "The model was not tested for missing effects by score tests"
UNTESTED = (
    f"{NOT_TESTED}: the standard errors assume a complete model. Small errors of sensors and hull form are not "
    "estimated (--no-score-tests skips them), and neither these nor missing effects, such as a difference between the "
    "thrusters, are in the standard errors. Take the estimates as a first look."
)
STILL_UNTESTED = (
    f"{NOT_TESTED}: the standard errors assume a complete model, without the influence of effects that it lacks, such "
    "as a difference between the thrusters. It has these small errors of sensors and hull form: "
)
UNTESTED_OWN = (
    f"{NOT_TESTED}, because it is a model of your own: the standard errors assume a complete model, without the "
    "influence of effects that it lacks. "
)
# Beginning of a note that the terminal shows
ONLY_CHOSEN = "The chosen effects were added without the small errors of sensors and hull form"


def untested_notes(model: Model, effect_parameters: Sequence[str]) -> list[str]:
    """Return the notes on a fit without score tests.

    The score tests select the small errors of sensors and hull form (common errors). Without the tests, only those of
    the given model are estimated. The second note says how to keep them beside effects that the user chose.

    Parameters
    ----------
    model
        Fitted model.
    effect_parameters
        Names of the parameters of the effects that the user added to the model.
    """
    if is_own_model(model.source):
        return [f"{UNTESTED_OWN}{_common_errors_of_own_model(model)}"]
    common = [e.name for e in model.effects if e.name in COMMON_ERRORS and not _adds(e, effect_parameters)]
    if common:
        return [f"{STILL_UNTESTED}{', '.join(common)}."]
    if not effect_parameters:
        return [UNTESTED]
    keep = (
        f"{ONLY_CHOSEN}, because the score tests select these errors and were left out. The prediction can be much "
        "worse than that of a tested fit. To have both, leave the tests in, or add the effects to the model of a "
        "tested fit: --model FIT/model.toml."
    )
    return [UNTESTED, keep]


def _common_errors_of_own_model(model: Model) -> str:
    """Return the sentence on the common errors in a user-defined model, and on how to add those that it accepts."""
    has = [e.name for e in model.effects if e.name in COMMON_ERRORS]
    can = [name for name in COMMON_ERRORS if name in catalogue() and model.accepts(catalogue()[name])]
    more = f"--effect adds {'others' if has else 'one'}: {', '.join(n for n in can if n not in has)}"
    if has:
        return f"Small errors of sensors and hull form in it: {', '.join(has)}; {more}."
    return f"Small errors of sensors and hull form are not estimated; {more}." if can else ""


def _adds(effect: Effect, names: Sequence[str]) -> bool:
    """Return whether an effect has one of the parameters of ``names``."""
    return any(p.name in names for p in effect.parameters)


def vehicle_result(
    fitted: FittedModel,
    evaluation: PredictionEvaluation,
    made: Provenance,
    profiles: Sequence[Profile],
    homogeneity: Sequence[HomogeneityTest],
    posed: FitContext,
) -> VehicleResult:
    """Return the result of `seatrial ident vehicle` from a fit and its evaluation.

    If the fit did not converge, the answer states only that. If the logs have faults, the answer begins with them.

    Parameters
    ----------
    fitted : FittedModel
        Model, its fit, and its evaluation on each record.
    evaluation : PredictionEvaluation
        Predictions, residuals and calibration of the fitted model.
    made : Provenance
        Logs, command line, time and software version.
    profiles : sequence of Profile
        Profile likelihoods; empty without `--profile`.
    homogeneity : sequence of HomogeneityTest
        Tests of one value of a parameter for all logs; empty without `--test-homogeneity`.
    posed : FitContext
        Initial values, notes, unused signals, length of the hull and score tests of the model.
    """
    reported = ReportedEstimates(fitted.fit)
    common = None if posed.assessment is None else posed.assessment.common_errors
    rejected = None if posed.assessment is None else posed.assessment.rejected_common_errors
    homogeneity = [homogeneity_reported(a, reported) for a in homogeneity]
    errors, calibration = error_tables(evaluation), calibration_tables(evaluation)
    residuals, cross = residual_rows(evaluation), cross_correlations(evaluation)
    searchable = bool(residuals_of(evaluation.model))
    prediction = prediction_fit(evaluation)
    fit_answer = vehicle_answer(prediction, errors, evaluation.horizon, residuals, cross, searchable=searchable)
    dynamics = posed.dynamics
    course = course_sentence(dynamics.course if dynamics else None, fitted.fit.model, estimation_logs(made))
    tested = any(a.name.startswith("F_w") for a in homogeneity)  # the wind force: its sentence follows
    wind = "" if tested else wind_sentence(made, fitted.fit.model)
    candidate = candidate_sentence(posed.uncertainty) if searchable else ""
    straight = straight_sentence(dynamics, fitted, (e for e in fitted.fit.model.effects if e.place == "environment"))
    sentences = [fit_answer, candidate, straight, course, wind]
    sentences += [homogeneity_sentence(a) for a in homogeneity]
    answer = not_converged(fitted.fit) or "\n".join(filter(None, sentences))
    uncertainty, untested = posed.uncertainty, posed.assessment is None
    in_blocks = all(log.role != "validation" for log in made.logs)
    return VehicleResult(
        **msgspec.structs.asdict(made),
        answer=faults_first(made) + answer,
        prediction=prediction,
        warnings=(
            *check_warnings(made),
            *late_sensor_warnings(made, fitted.fit.model),
            *frames_assumed(fitted),
            *structure_warnings(fitted.fit.model, cross, "estimation"),
            *estimation_warnings(fitted.fit, fitted.records, posed.hull),
            *short_data_warnings(fitted, evaluation.horizon),
            *thrust_difference_warnings(uncertainty, fitted.fit, posed.hull.get("mass")),
            *failed_run_warnings(fitted.failed),
        ),
        notes=(
            *(untested_notes(fitted.model, posed.effect_parameters) if searchable and untested else ()),
            *of_judging_data(common_errors_notes(common, "the model", rejected), in_blocks),
            *model_uncertainty_notes(uncertainty, fitted.fit),
            *thrust_of_notes(fitted.fit),
            *prior_notes(fitted.fit),
            *mass_notes(fitted.fit, posed.hull.get("mass"), uncertainty),
            *_notes(posed.notes, evaluation, calibration),
            *position_drift_notes(residuals, fitted.fit.coloured),
            *mean_notes(fitted),
        ),
        common_errors=common_errors_row(common, fitted, evaluation.headline_set),
        dynamics=posed.dynamics,
        effect_parameters=tuple(
            reported.scale.name(n, fitted.fit.model.parameter(n).unit) for n in posed.effect_parameters
        ),
        fit=fit_summary(fitted.fit, posed.start),
        failed_runs=fitted.failed,
        horizon_seconds=evaluation.horizon,
        errors=errors,
        calibration=calibration,
        traces=traces(evaluation),
        track=tracks(evaluation),
        inputs=all_inputs(evaluation),
        residuals=residuals,
        cross=cross,
        unused_signals=tuple(posed.unused),
        profiles=tuple(profile_curve(p, reported) for p in profiles),
        homogeneity=tuple(homogeneity_row(a) for a in homogeneity),
    )


def mean_notes(fitted: FittedModel) -> list[str]:
    """Return the note that the rows of a fit are means of sensors that are faster than the rows; none without any.

    Parameters
    ----------
    fitted : FittedModel
        Model with its estimation records. Their ``meta["mean_rates"]`` has the sensors that are averaged.
    """
    rates: dict[str, float] = {}
    for evaluated in fitted.estimation:
        rates |= evaluated.record.meta.get("mean_rates", {})
    if not rates:
        return []
    of = ", ".join(dict.fromkeys(rates))
    return [
        f"The rows are means at {max(rates.values()):.3g} Hz of the faster sensors ({of}): their estimated noise, and "
        "the errors one step ahead, are those of the means."
    ]


@dataclass(frozen=True)
class BenchTables:
    """Tables of a thruster on the bench that are reported with its fit.

    Attributes
    ----------
    static
        Measured and fitted static thrust; None if the logs have no measured force.
    steady
        Steady-state table; None if no command was held.
    response
        Frequency response of the shaft; None if it is unknown.
    speeds
        Speed over ground [m/s] that the boat exceeded for a tenth of each log, by name of the log; None: unknown.
    turning
        Held command inside the fitted dead zone at which the shaft turned fastest, by name of the log; None: it did not
        turn.
    """

    static: StaticForce | None = None
    steady: SteadyBench | None = None
    response: ShaftResponse | None = None
    speeds: Mapping[str, float | None] = field(default_factory=dict)
    turning: Mapping[str, TurningShaft | None] = field(default_factory=dict)


def thruster_result(
    fitted: FittedModel,
    evaluation: PredictionEvaluation,
    made: Provenance,
    profiles: Sequence[Profile],
    bench: BenchTables,
    posed: FitContext,
    calibration: float | None,
) -> ThrusterResult:
    """Return the result of `seatrial ident thruster` for logs with a shaft speed, from a fit and its evaluation.

    If the fit did not converge, the answer states only that. If the logs have faults, the answer begins with them.

    Parameters
    ----------
    fitted : FittedModel
        Model, its fit, and its evaluation on each record.
    evaluation : PredictionEvaluation
        Predictions, residuals and calibration of the fitted model.
    made : Provenance
        Logs, command line, time and software version.
    profiles : sequence of Profile
        Profile likelihoods; empty without `--profile`.
    bench : BenchTables
        Static thrust, steady-state table and frequency response.
    posed : FitContext
        Initial values and notes; its other fields are not used.
    calibration : float or None
        Relative standard uncertainty of the load cell's force. The standard errors of forces include it if the logs
        have a measured force. None if the rig does not give it.
    """
    static = bench.static
    bands, ways = calibration_tables(evaluation), directions(fitted.records)
    contradictions = dead_zone_warnings(bench.turning, fitted.fit.estimate("d")[0])
    smallest = smallest_command(fitted.records)
    reach = largest_speeds(np.concatenate([record.y[:, 0] for record in fitted.records]))
    reach = {way: speed for way, speed in reach.items() if way in ways}
    residuals, cross = residual_rows(evaluation), cross_correlations(evaluation)
    errors = error_tables(evaluation)
    answer = thruster_answer(fitted.fit, static is not None, ways, calibration, smallest, bool(contradictions), reach)
    sentences = [answer, coloured_sentence(errors, residuals, cross, bool(residuals_of(evaluation.model)))]
    return ThrusterResult(
        **msgspec.structs.asdict(made),
        answer=faults_first(made)
        + (not_converged(fitted.fit) or late_command_sentence(made) + " ".join(filter(None, sentences))),
        warnings=(
            *check_warnings(made),
            *moving_boat_warnings(bench.speeds, static is not None),
            *contradictions,
            *(thruster_warnings(ways) if static is not None else ()),
            *estimation_warnings(fitted.fit, fitted.records),
            *short_data_warnings(fitted, evaluation.horizon),
            *failed_run_warnings(fitted.failed),
        ),
        notes=_notes(posed.notes, evaluation, bands),
        fit=fit_summary(fitted.fit, posed.start, calibration if static is not None else 0.0),
        failed_runs=fitted.failed,
        horizon_seconds=evaluation.horizon,
        errors=errors,
        calibration=bands,
        traces=traces(evaluation),
        track=tracks(evaluation),
        inputs=all_inputs(evaluation),
        residuals=residuals,
        cross=cross,
        static=static,
        steady=bench.steady,
        shaft_response=bench.response,
        profiles=tuple(profile_curve(p, ReportedEstimates(fitted.fit)) for p in profiles),
    )


def _notes(first: Sequence[str], evaluation: PredictionEvaluation, calibration: Calibrations) -> tuple[str, ...]:
    """Return the notes of the result of a vehicle or thruster fit.

    The order is: ``first`` (given sentences), channels with outliers, prediction intervals that are too narrow or too
    wide, and short simulations.
    """
    outliers = outlier_lines(evaluation.estimation_residuals, evaluation.model)
    return (
        *first,
        *outliers,
        *calibration_notes(calibration, evaluation.horizon),
        *warm_up_notes(simulated_durations(evaluation), evaluation.model.kind),
    )


class LogSpan(Part, frozen=True, kw_only=True):
    """Interval of time of a log, with the step of the mission in it."""

    record: Annotated[str, Meta(description="name of the record")]
    t_from: Annotated[float, Meta(description="[s of the log]")]
    t_to: Annotated[float, Meta(description="[s of the log]")]
    what: Annotated[str, Meta(description="step of the mission that takes up most of the interval, or empty")]


class InformedParameter(LogSpan, frozen=True, kw_only=True):
    """Fisher information of all logs about a parameter, and the segment of a log that contributes most to it."""

    name: Annotated[str, Meta(description="name of the parameter")]
    meaning: Annotated[str, Meta(description="meaning in words")]
    unit: Annotated[str, Meta(description="unit of the values, SI and radians; empty: none")]
    value: Annotated[float, Meta(description="value in the model file")]
    se: Annotated[float | None, Meta(description="standard error from all logs; null: no information")]
    weight: Annotated[
        float | None,
        Meta(description="factor by which `se` would grow without the segment; null: no other segment informs it"),
    ]
    alone: Annotated[float | None, Meta(description="standard error from the segment alone; null: no information")]
    known: Annotated[
        bool,
        Meta(description="`se` is below half of the value (of a value of 0: half of its prior's sd or of five steps)"),
    ]


class SegmentInformation(LogSpan, frozen=True, kw_only=True):
    """Fisher information of one segment of a log about each parameter; arrays are in the order of `names`."""

    weight: Annotated[
        Array,
        Meta(description="factors by which standard errors would grow without it; null: no other segment informs it"),
    ]
    lost: Annotated[Array, Meta(description="share of the information that would be lost without it, 0..1")]
    alone: Annotated[Array, Meta(description="standard errors from this segment alone; null: no information")]


class Information(Part, frozen=True, kw_only=True):
    """Fisher information of each segment of the logs about each parameter."""

    names: Annotated[tuple[str, ...], Meta(description="names of the parameters")]
    seconds: Annotated[float, Meta(description="length of a segment [s]")]
    parameters: Annotated[tuple[InformedParameter, ...], Meta(description="one for each parameter")]
    segments: Annotated[tuple[SegmentInformation, ...], Meta(description="one for each segment of each log")]


class InformationResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="information"):
    """Result of `seatrial ident information`: Fisher information of log segments about parameters of a fitted model."""

    information: Annotated[Information, Meta(description="information of the logs")]
    inputs: Annotated[tuple[InputTrace, ...], Meta(description="inputs of each log")]


class StateTrace(Part, frozen=True, kw_only=True):
    """State of the model in one log over time, estimated from the model and all sensors."""

    name: Annotated[str, Meta(description="name of the state")]
    unit: Annotated[str, Meta(description="unit of the values, SI and radians; empty: none")]
    meaning: Annotated[str, Meta(description="meaning in words")]
    angle: Annotated[bool, Meta(description="whether the state is an angle, which is known except for whole turns")]
    value: Annotated[Array, Meta(description="estimate at each time")]
    sd: Annotated[Array, Meta(description="standard deviation, including the errors of the parameters")]
    measured: Annotated[Array | None, Meta(description="measured channel of the same name; null: there is none")] = None


class GnssFixes(Part, frozen=True, kw_only=True):
    """Positions in one log that GNSS measured (fixes)."""

    t: Annotated[Array, Meta(description="[s of the log]")]
    x: Annotated[Array, Meta(description="north [m]")]
    y: Annotated[Array, Meta(description="east [m]")]
    used: Annotated[Array, Meta(description="1: used; 0: withheld on purpose")]


class NavigatedRecord(Part, frozen=True, kw_only=True):
    """Estimated states of the boat in one log."""

    record: Annotated[str, Meta(description="name of the record")]
    kind: Annotated[
        Literal["smoothed", "filtered"], Meta(description="estimated from all samples, or from the samples so far")
    ]
    t: Annotated[Array, Meta(description="[s of the log]")]
    states: Annotated[tuple[StateTrace, ...], Meta(description="one for each state of the model")]
    fixes: Annotated[GnssFixes, Meta(description="positions that GNSS measured")]


class PositionEllipse(Part, frozen=True, kw_only=True):
    """Ellipse about a predicted position that contains the true position with 95 % probability."""

    major: Annotated[float, Meta(description="half axis [m]")]
    minor: Annotated[float, Meta(description="half axis [m]")]
    azimuth: Annotated[float, Meta(description="direction of the major axis [rad from north]")]
    radius: Annotated[float, Meta(description="radius of the circle with the same probability [m]")]


class WithheldErrors(Part, frozen=True, kw_only=True):
    """Distances between estimated positions and the GNSS fixes that were withheld on purpose in an outage."""

    rms: Annotated[float, Meta(description="[m]")]
    largest: Annotated[float, Meta(description="[m]")]
    inside: Annotated[float, Meta(description="share inside the 95 % ellipses, which include the noise of the fix")]
    n: Annotated[int, Meta(description="number of fixes")]


class GnssOutage(Part, frozen=True, kw_only=True):
    """GNSS outage (time without a position fix): predicted position at its end, and the error of this prediction.

    Keys about fixes are null if the outage has no such fix.
    """

    record: Annotated[str, Meta(description="name of the record")]
    start: Annotated[float, Meta(description="[s of the log]")]
    end: Annotated[float, Meta(description="[s of the log]")]
    duration: Annotated[float, Meta(description="[s]")]
    open: Annotated[bool, Meta(description="no fix follows the outage")]
    leading: Annotated[bool, Meta(description="no fix precedes the outage: the prediction for its end is a guess")]
    withheld: Annotated[bool, Meta(description="whether the fixes were withheld on purpose (`--gnss-outage`)")]
    north: Annotated[float, Meta(description="position that is predicted for the end without GNSS: north [m]")]
    east: Annotated[float, Meta(description="the same: east [m]")]
    at_end: Annotated[PositionEllipse, Meta(description="95 % ellipse of that prediction")]
    error: Annotated[float | None, Meta(description="distance of the fix at the end from the prediction [m]")]
    allowed: Annotated[
        float | None, Meta(description="95 % limit of that distance, including the noise of the fix [m]")
    ]
    inside: Annotated[bool | None, Meta(description="whether `error` is at most `allowed`; null without a fix")]
    widest: Annotated[float, Meta(description="largest 95 % radius of the best estimate [m]")]
    predicted: Annotated[
        WithheldErrors | None, Meta(description="errors at withheld fixes, predicted without later fixes")
    ]
    best: Annotated[WithheldErrors | None, Meta(description="errors at withheld fixes, of the best estimate")]


class NavigationResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="navigation"):
    """Result of `seatrial ident navigate`: states of the boat, estimated with a fitted model."""

    navigation: Annotated[tuple[NavigatedRecord, ...], Meta(description="one for each log")]
    outages: Annotated[tuple[GnssOutage, ...], Meta(description="one for each outage")]
    inputs: Annotated[tuple[InputTrace, ...], Meta(description="inputs of each log")]


class SpectrumBands(Part, frozen=True, kw_only=True):
    """Power spectral density, averaged over bands of equal width in the logarithm of the frequency."""

    frequency: Annotated[Array, Meta(description="middle of each band [Hz]")]
    psd: Annotated[Array, Meta(description="[unit^2/Hz]")]
    low: Annotated[Array, Meta(description="lower end of the 95 % interval of the true density [unit^2/Hz]")]
    high: Annotated[Array, Meta(description="upper end of the 95 % interval of the true density [unit^2/Hz]")]


class AllanCurve(Part, frozen=True, kw_only=True):
    """Overlapping Allan deviation of a channel over the averaging time, and the numbers of a data sheet."""

    tau: Annotated[Array, Meta(description="averaging times [s]")]
    deviation: Annotated[Array, Meta(description="Allan deviation [unit]")]
    error: Annotated[Array, Meta(description="standard error of `deviation` [unit]")]
    density: Annotated[
        float, Meta(description="white noise of the fitted model as a density: `white` sqrt(sample interval)")
    ]
    bias_instability: Annotated[float, Meta(description="smallest deviation / 0.664 [unit]")]
    bias_tau: Annotated[float, Meta(description="averaging time of the smallest deviation [s]")]
    is_limit: Annotated[
        bool, Meta(description="`bias_instability` is an upper limit: the deviation still falls at the longest time")
    ]

    def __post_init__(self) -> None:
        """Raise ValueError if the arrays over the averaging time differ in length."""
        same_length(self, "tau", "deviation", "error")


class ChannelNoise(Part, frozen=True, kw_only=True):
    """Noise model of a channel of a sensor at rest: white noise plus a random walk, and the test of this model."""

    channel: Annotated[
        str, Meta(description="name of the channel, preceded by that of the log if there are several logs")
    ]
    unit: Annotated[str, Meta(description="unit of the values, SI and radians; empty: none")]
    white: Annotated[float, Meta(description="standard deviation of a sample [unit]")]
    random_walk: Annotated[float, Meta(description="[unit/sqrt(s)]")]
    se_white: Annotated[float | None, Meta(description="standard error; null: no white noise was found")]
    se_random_walk: Annotated[float | None, Meta(description="standard error; null: no random walk was found")]
    white_limit: Annotated[float | None, Meta(description="if no white noise was found: 95 % upper limit [unit]")] = (
        None
    )
    random_walk_limit: Annotated[
        float | None,
        Meta(description="if no random walk was found: 95 % upper limit [unit/sqrt(s)]"),
    ] = None
    accepted: Annotated[bool, Meta(description="whether the channel is white noise plus a random walk")]
    p: Annotated[float | None, Meta(description="p value of the Ljung-Box test of the innovations")]
    predictable: Annotated[float | None, Meta(description="share of the innovations' variance that could be predicted")]
    reason: Annotated[str | None, Meta(description="why the model is not accepted")]
    frequency: Annotated[Array, Meta(description="[Hz]")]
    psd: Annotated[Array, Meta(description="measured power spectral density (Welch) [unit^2/Hz]")]
    psd_model: Annotated[Array, Meta(description="power spectral density of the fitted model [unit^2/Hz]")]
    bands: Annotated[
        SpectrumBands | None, Meta(description="measured density averaged over bands, with its interval")
    ] = None
    allan: Annotated[
        AllanCurve | None, Meta(description="null: the channel is too short, or in files of older versions")
    ] = None


class NoiseResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="noise"):
    """Result of `seatrial ident noise`: the noise of sensors at rest."""

    noise: Annotated[tuple[ChannelNoise, ...], Meta(description="one for each channel of each log")]


class DesignedParameter(Part, frozen=True, kw_only=True):
    """Standard errors of a parameter before and after the designed mission; null: no information."""

    name: Annotated[str, Meta(description="name of the parameter")]
    meaning: Annotated[str, Meta(description="meaning in words")]
    unit: Annotated[str, Meta(description="unit of the values, SI and radians; empty: none")]
    value: Annotated[float, Meta(description="nominal value")]
    before: Annotated[float | None, Meta(description="from earlier logs")]
    after: Annotated[float | None, Meta(description="after this mission, by prediction error")]
    form: Annotated[
        float | None,
        Meta(description="after this mission, by the information that the design uses (`form` of the design)"),
    ]
    baseline: Annotated[float | None, Meta(description="after the best baseline signal instead, by prediction error")]
    chosen: Annotated[bool, Meta(description="whether the criterion includes this parameter")]


class Baseline(Part, frozen=True, kw_only=True):
    """Baseline signal: a kind of random sequence (PRBS or RGS) whose best sequence is compared with the design."""

    name: Annotated[str, Meta(description="`PRBS` or `RGS`")]
    value: Annotated[float, Meta(description="criterion of the best sequence")]
    bandwidth: Annotated[float, Meta(description="PRBS: clock [s]; RGS: corner [Hz]")]
    seeds: Annotated[Array, Meta(description="best criterion of each seed")]


class CommandTrace(Part, frozen=True, kw_only=True):
    """Command of the designed mission for one input over time."""

    name: Annotated[str, Meta(description="name of the input")]
    t: Annotated[Array, Meta(description="time since the first step [s]")]
    value: Annotated[Array, Meta(description="-1..1")]


class DesignTrack(Part, frozen=True, kw_only=True):
    """Predicted track of the boat in the designed mission, before, during and after its steps.

    The boat starts at rest, heading north. The other tracks are those of boats with sampled parameters.
    """

    t: Annotated[Array, Meta(description="time since the beginning of the mission [s]")]
    x: Annotated[Array, Meta(description="north of the start [m]")]
    y: Annotated[Array, Meta(description="east of the start [m]")]
    radius: Annotated[Array, Meta(description="radius around the track that contains 95 % of the sampled boats [m]")]
    others: Annotated[tuple[Array, ...], Meta(description="tracks (n, 2) of sampled boats: north, east [m]")]
    inside: Annotated[
        float | None, Meta(description="share of the sampled boats that stay inside the area; null: no area was given")
    ]
    corner: Annotated[
        tuple[float, float] | None,
        Meta(description="south-west corner of the area, relative to the start: north, east [m]"),
    ]
    area: Annotated[tuple[float, float] | None, Meta(description="size of the area: north, east [m]")]
    current: Annotated[float, Meta(description="largest current of the sampled boats [m/s]")]
    rest: Annotated[float, Meta(description="time at rest before the steps [s]")] = 0.0
    coasting: Annotated[float, Meta(description="time without thrust after the steps [s]")] = 0.0


class HypothesisSize(Part, frozen=True, kw_only=True):
    """Size of one of the two effects that a mission discriminates, and the origin of this size."""

    effect: Annotated[str, Meta(description="name of the effect")]
    origin: Annotated[
        Literal["fitted", "typical"],
        Meta(
            description="`fitted`: estimates of the model, or of a refit of its diagnosis; `typical`: half a standard "
            "deviation of the effect's prior, because no fit has the effect, or because its fitted size is negligible"
        ),
    ]
    parameters: Annotated[
        tuple[EffectParameter, ...], Meta(description="its parameters; `se` is null for a typical size")
    ]
    beside: Annotated[
        str, Meta(description="the other effect, if the fit of the size has both; empty: the fit has this effect alone")
    ] = ""


class Discrimination(Part, frozen=True, kw_only=True):
    """Discrimination of two effects by the designed mission (`--discriminate`).

    Criterion T is twice the expected log-likelihood ratio of the model with the true effect against the other model.
    The effects can be distinguished if both values are above 30.
    """

    effects: Annotated[tuple[str, str], Meta(description="names of the first and the second effect")]
    if_second: Annotated[float, Meta(description="criterion T if the second effect is true")]
    if_first: Annotated[float, Meta(description="criterion T if the first effect is true")]
    clear: Annotated[bool, Meta(description="whether both are large enough to distinguish the effects")]
    random: Annotated[
        Array,
        Meta(description="criterion T of all random sequences, the `seeds` of `baselines`; of 8 others in older files"),
    ]
    probability: Annotated[
        float | None,
        Meta(
            description="probability that the mission prefers the true one of the two effects, if one of them explains "
            "the boat completely: mean over either effect as the true one; null in older files"
        ),
    ] = None
    sizes: Annotated[tuple[HypothesisSize, ...], Meta(description="sizes of both effects; empty in older files")] = ()
    twice: Annotated[
        float | None,
        Meta(
            description="smaller criterion T of the mission run twice in a row, for the answer on a longer mission; "
            "null if `clear`, and in older files"
        ),
    ] = None

    @property
    def wrong_choice(self) -> str:
        """Sentence on the probability that a fit to the mission prefers the wrong effect; empty in older files.

        It is never below 0.1 %, because no model is exact enough for less.
        """
        if self.probability is None:
            return ""
        wrong = 1.0 - self.probability
        share = f"{100.0 * wrong:.1f} %" if wrong > LEAST_SHARE else f"less than {100.0 * LEAST_SHARE:.1f} %"
        return (
            f"If one of the two effects explains the boat completely, a fit to this mission prefers the wrong one with "
            f"a probability of {share} (guessing: 50 %; T = 30: 0.3 %)."
        )


class DesignResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="design"):
    """Result of `seatrial mission design`: the most informative mission for a model."""

    model: Annotated[str, Meta(description="file or name of the model")]
    criterion: Annotated[str, Meta(description="`D`, `A`, `E` or `Ds`; `T`: two effects are distinguished")]
    chosen: Annotated[tuple[str, ...], Meta(description="parameters that the criterion includes")]
    form: Annotated[str, Meta(description="kind of Fisher information: `prediction error` or `output error`")]
    value: Annotated[float, Meta(description="value of the criterion")]
    evaluations: Annotated[int, Meta(description="number of simulations in the search")]
    parameters: Annotated[tuple[DesignedParameter, ...], Meta(description="one for each parameter")]
    baselines: Annotated[tuple[Baseline, ...], Meta(description="one for each kind of baseline signal")]
    baseline: Annotated[str, Meta(description="name of the best baseline signal")]
    limited: Annotated[bool, Meta(description="whether the design had limits; baseline signals ignore limits")]
    samples: Annotated[
        dict[str, Array],
        Meta(description="for each signal, the criterion at 1000 samples of the parameters; empty for criterion `T`"),
    ]
    share_won: Annotated[
        float | None, Meta(description="share of the samples in which the design is best; null for the criterion `T`")
    ]
    inputs: Annotated[tuple[CommandTrace, ...], Meta(description="commands of the mission, one for each input")]
    track: Annotated[DesignTrack | None, Meta(description="null: the model has no position")]
    apart: Annotated[Discrimination | None, Meta(description="null: `--discriminate` was not given")] = None
    rates: Annotated[dict[str, float], Meta(description="assumed rate of each sensor [Hz]; empty in older files")] = (
        msgspec.field(default_factory=dict)
    )

    @property
    def margin(self) -> float:
        """Criterion of the designed mission minus that of the best baseline signal; negative if the design is worse."""
        return self.value - max(b.value for b in self.baselines)

    @property
    def random_sequences(self) -> str:
        """Random sequences that the design is compared with, in words: ``40 random sequences (20 PRBS, 20 RGS)``."""
        counts = {b.name: np.size(b.seeds) for b in self.baselines}
        return f"{sum(counts.values())} random sequences ({', '.join(f'{n} {name}' for name, n in counts.items())})"

    @property
    def less_informed(self) -> dict[str, float]:
        """Parameters about which the mission informs less than the best random sequence, the worst first.

        The value is the standard error after the mission over that after the sequence, above 1.2. The parameters that
        the mission is designed for are left out; a mission that distinguishes two effects is designed for none.
        """
        ratios = {
            p.name: p.after / p.baseline
            for p in self.parameters
            if p.after and p.baseline and (self.apart is not None or not p.chosen)
        }
        return dict(sorted(((n, r) for n, r in ratios.items() if r > WORSE_ERROR), key=lambda item: -item[1]))

    @property
    def other_parameters(self) -> str:
        """Sentences on the parameters about which a random sequence informs more, and what to do; empty without any."""
        worse = self.less_informed
        if not worse:
            return ""
        name, ratio = next(iter(worse.items()))
        aim = f"inform about {', '.join(self.chosen)}"
        if self.apart is not None:
            aim = f"distinguish {' from '.join(self.apart.effects)}"
        return (
            f"This mission is designed to {aim}. It can inform less about other parameters than a random sequence: "
            f"{len(worse)} of {len(self.parameters)} standard errors are larger, that of {name} {ratio:.1f} times. If "
            "you need these parameters too, record a random mission as well (`seatrial mission generate --kind "
            "mixed`), or one that is designed for them, and fit the model to all logs."
        )


LEAST_SHARE = 0.001  # smallest probability of a wrong choice that is shown
WORSE_ERROR = 1.2  # a standard error is larger than that after a random sequence from this ratio on
APART = 0.4  # initial values of the fits of a study are within a factor exp(+-APART) of the truth
BIAS, COVERAGE, VARIANCE = 0.15, (0.93, 0.97), 0.1  # aims of a study: |bias| / sd, coverage, |variance ratio - 1|
MOST_LOST = 0.05  # share of the replicates that may fail or not converge; with more, the others are a biased sample
AIMS = {"bias": (-BIAS, BIAS), "ratio": (1.0 - VARIANCE, 1.0 + VARIANCE), "coverage": COVERAGE}


class ParameterStudy(Part, frozen=True, kw_only=True):
    """Bias, variance and coverage of the estimates of a parameter in a Monte Carlo study.

    They are in the coordinate of the estimator, the parameter or the logarithm of a positive parameter. Intervals are
    95 % intervals.
    """

    name: Annotated[str, Meta(description="name of the parameter")]
    unit: Annotated[str, Meta(description="unit of the values, SI and radians; empty: none")]
    truth: Annotated[float, Meta(description="true value of the simulation")]
    n: Annotated[int, Meta(description="number of estimates with an interval")]
    at_bound: Annotated[int, Meta(description="number of these estimates that are at a bound")]
    sd: Annotated[float, Meta(description="standard deviation of the estimates")]
    bias: Annotated[float, Meta(description="bias of the estimates, in units of `sd`")]
    bias_error: Annotated[float, Meta(description="standard error of `bias`")]
    ratio: Annotated[float, Meta(description="variance of the estimates / variance that the fits report")]
    ratio_low: Annotated[float, Meta(description="lower end of the interval of `ratio`")]
    ratio_high: Annotated[float, Meta(description="upper end of that interval")]
    bound_ratio: Annotated[float, Meta(description="variance / Cramér-Rao bound, or / least variance near bounds")]
    bound_ratio_low: Annotated[float, Meta(description="lower end of the interval of `bound_ratio`")]
    bound_ratio_high: Annotated[float, Meta(description="upper end of that interval")]
    coverage: Annotated[float, Meta(description="share of the 95 % intervals that contain the truth, 0..1")]
    coverage_low: Annotated[float, Meta(description="lower end of the interval of `coverage`")]
    coverage_high: Annotated[float, Meta(description="upper end of that interval")]
    misses: Annotated[
        tuple[str, ...],
        Meta(description="missed aims: `bias`, `variance`, `coverage`; `(chance?)`: possibly by chance"),
    ]


class ModelStudy(Part, frozen=True, kw_only=True):
    """Monte Carlo study of one model: replicates are simulated, estimated and compared with the truth.

    Parameters with fewer than three usable replicates are left out.
    """

    model: Annotated[str, Meta(description="name of the model")]
    about: Annotated[str, Meta(description="description of the mission")]
    method: Annotated[Literal["PE", "OE"], Meta(description="prediction error or output error")]
    estimator: Annotated[str, Meta(description="description of the estimator")]
    replicates: Annotated[int, Meta(description="number of replicates")]
    failed: Annotated[int, Meta(description="number of replicates whose simulation or fit failed")]
    unconverged: Annotated[int, Meta(description="number of replicates whose fit did not converge")]
    cpu_fit: Annotated[float | None, Meta(description="median CPU time of a fit [s]")]
    cpu_simulation: Annotated[float | None, Meta(description="mean CPU time of a simulation [s]")]
    parameters: Annotated[tuple[ParameterStudy, ...], Meta(description="one for each free parameter")]

    @property
    def left_out(self) -> str:
        """Replicates that the statistics leave out as text, ``2 failed and 3 did not converge``; empty without any."""
        counts = ((self.failed, "failed"), (self.unconverged, "did not converge"))
        return " and ".join(f"{n} {reason}" for n, reason in counts if n)

    @property
    def too_many_left_out(self) -> bool:
        """Whether more than 5 % of the replicates failed or did not converge. The others are then a biased sample."""
        return self.failed + self.unconverged > MOST_LOST * self.replicates


class StudyResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="study"):
    """Result of `seatrial ident study`: Monte Carlo study of bias, variance and coverage of the estimator."""

    seed: Annotated[int, Meta(description="seed of the random numbers")]
    studies: Annotated[tuple[ModelStudy, ...], Meta(description="one for each model")]


class FleetParameter(Part, frozen=True, kw_only=True):
    """Values of one parameter from separate fits of the same model to several logs.

    Logs in which the parameter has no standard error, or whose fit did not converge, are left out. The errors from
    priors are the same in all logs.
    """

    name: Annotated[str, Meta(description="name of the parameter")]
    meaning: Annotated[str, Meta(description="meaning in words")]
    unit: Annotated[str, Meta(description="unit of the values, SI and radians; empty: none")]
    n: Annotated[int, Meta(description="number of logs that determine the parameter")]
    mean: Annotated[float, Meta(description="mean over the logs, weighted with `scatter` and the standard errors")]
    se_mean: Annotated[float, Meta(description="standard error of `mean`, with the errors from priors")]
    sd: Annotated[float, Meta(description="standard deviation between the logs")]
    se: Annotated[float, Meta(description="typical standard error of a log: root mean square")]
    se_own: Annotated[float, Meta(description="the same without the errors from priors; to be compared with `sd`")]
    scatter: Annotated[float, Meta(description="standard deviation between the logs beyond their standard errors")]
    p: Annotated[float, Meta(description="p value of one true value for all logs (Cochran's Q)")]
    agree: Annotated[
        bool, Meta(description="verdict: the logs agree in one value, `p` is above 0.01 / number of parameters")
    ]
    per_log: Annotated[bool, Meta(description="the true value differs from log to log, as that of the current")]


class FailedLog(Part, frozen=True, kw_only=True):
    """Log to which the model could not be fitted, or whose fit did not converge."""

    log: Annotated[str, Meta(description="path of the log")]
    reason: Annotated[str, Meta(description="reason in one line")]


SCORE_TESTED = "whether each fit was tested for missing effects (`--score-tests`); null: result of an earlier version"


class FleetResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="fleet"):
    """Result of `seatrial ident fleet`: one model fitted to each of many logs, and the differences between the logs."""

    model: Annotated[str, Meta(description="name of the model as given; `auto`: chosen for each log")]
    table: Annotated[str, Meta(description="file of all estimates; empty: no file was written")]
    score_tests: Annotated[bool | None, Meta(description=SCORE_TESTED)] = None
    n_logs: Annotated[int, Meta(description="number of logs")]
    fitted: Annotated[int, Meta(description="number of logs whose fit converged")]
    failed: Annotated[tuple[FailedLog, ...], Meta(description="logs without a fit")]
    unconverged: Annotated[tuple[FailedLog, ...], Meta(description="logs whose fit did not converge")]
    parameters: Annotated[tuple[FleetParameter, ...], Meta(description="parameters with values of two logs or more")]
