"""Results of the commands: fits of vehicle and thruster, information, navigation, noise, design and study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from seatrial.ident.characterisation import directions
from seatrial.ident.estimation import FittedModel, HomogeneityTest, Profile, ReportedEstimates
from seatrial.ident.models import residuals_of
from seatrial.ident.numerics import Array
from seatrial.ident.results.answers import (
    calibration_notes,
    check_warnings,
    estimation_warnings,
    failed_run_warnings,
    faults_first,
    frames_assumed,
    homogeneity_sentence,
    late_sensor_warnings,
    not_converged,
    outlier_lines,
    smallest_command,
    thruster_answer,
    thruster_warnings,
    vehicle_answer,
)
from seatrial.ident.results.parts import (
    Calibrations,
    InputTrace,
    Part,
    Provenance,
    Result,
    StaticForce,
    ThrusterResult,
    UnusedSignal,
    VehicleResult,
)
from seatrial.ident.results.tables import (
    all_inputs,
    calibration_tables,
    cross_correlations,
    error_tables,
    failed_runs,
    fit_summary,
    homogeneity_reported,
    homogeneity_row,
    prediction_fit,
    profile_curve,
    residual_rows,
    traces,
    tracks,
)
from seatrial.ident.validation import PredictionEvaluation


@dataclass(frozen=True)
class Posed:
    """What was known and said before the fit.

    Attributes:
        start: values that the search began with.
        notes: lines that come first.
        unused: signals of the logs that the model does not take.
        length: of the hull, where the rig gives it [m].
    """

    start: Mapping[str, float]
    notes: Sequence[str] = ()
    unused: Sequence[UnusedSignal] = ()
    length: float | None = None


def vehicle_result(
    stage: FittedModel,
    evaluation: PredictionEvaluation,
    made: Provenance,
    profiles: Sequence[Profile],
    homogeneity: Sequence[HomogeneityTest],
    posed: Posed,
) -> VehicleResult:
    """The result of a vehicle's fit and its evaluation; ``posed``: what came before the fit."""
    reported = ReportedEstimates(stage.fit)
    homogeneity = [homogeneity_reported(a, reported) for a in homogeneity]
    errors, calibration = error_tables(evaluation), calibration_tables(evaluation)
    residuals, cross = residual_rows(evaluation), cross_correlations(evaluation)
    searchable = bool(residuals_of(evaluation.model))
    prediction = prediction_fit(evaluation)
    said = vehicle_answer(prediction, errors, evaluation.horizon, residuals, cross, searchable=searchable)
    answer = not_converged(stage.fit) or " ".join([said, *(homogeneity_sentence(a) for a in homogeneity)])
    return VehicleResult(
        **msgspec.structs.asdict(made),
        answer=faults_first(made) + answer,
        prediction=prediction,
        warnings=(
            *check_warnings(made),
            *late_sensor_warnings(made, stage.fit.model),
            *frames_assumed(stage),
            *estimation_warnings(stage.fit, stage.records, posed.length),
            *failed_run_warnings(stage.failed),
        ),
        notes=_notes(posed.notes, evaluation, calibration),
        fit=fit_summary(stage.fit, posed.start),
        failed_runs=failed_runs(stage.failed),
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


def thruster_result(
    stage: FittedModel,
    evaluation: PredictionEvaluation,
    made: Provenance,
    profiles: Sequence[Profile],
    static: StaticForce | None,
    posed: Posed,
    calibration: float | None,
) -> ThrusterResult:
    """``static``: None where there was no load cell; ``posed``: what came before the fit; ``calibration``: relative
    standard uncertainty of the load cell's force, None where the rig does not give it."""
    bands, ways = calibration_tables(evaluation), directions(stage.records)
    return ThrusterResult(
        **msgspec.structs.asdict(made),
        answer=not_converged(stage.fit)
        or thruster_answer(stage.fit, static is not None, ways, calibration, smallest_command(stage.records)),
        warnings=(
            *(thruster_warnings(ways) if static is not None else ()),
            *estimation_warnings(stage.fit, stage.records),
            *failed_run_warnings(stage.failed),
        ),
        notes=_notes(posed.notes, evaluation, bands),
        fit=fit_summary(stage.fit, posed.start, calibration if static is not None else 0.0),
        failed_runs=failed_runs(stage.failed),
        horizon_seconds=evaluation.horizon,
        errors=error_tables(evaluation),
        calibration=bands,
        traces=traces(evaluation),
        track=tracks(evaluation),
        inputs=all_inputs(evaluation),
        residuals=residual_rows(evaluation),
        cross=cross_correlations(evaluation),
        static=static,
        profiles=tuple(profile_curve(p, ReportedEstimates(stage.fit)) for p in profiles),
    )


def _notes(first: Sequence[str], evaluation: PredictionEvaluation, calibration: Calibrations) -> tuple[str, ...]:
    outliers = outlier_lines(evaluation.residuals, evaluation.model)
    return (*first, *outliers, *calibration_notes(calibration, evaluation.horizon))


class LogSpan(Part, frozen=True, kw_only=True):
    """A part of a log."""

    record: str
    t_from: Annotated[float, Meta(description="[s of the log]")]
    t_to: Annotated[float, Meta(description="[s of the log]")]
    what: Annotated[str, Meta(description="the step of the mission that takes up most of it, or empty")]


class InformedParameter(LogSpan, frozen=True, kw_only=True):
    """What all logs tell of a parameter, and the segment that this hangs on most."""

    name: str
    meaning: str
    unit: str
    value: float
    se: Annotated[float | None, Meta(description="standard error from all logs; null: nothing tells")]
    weight: Annotated[
        float | None, Meta(description="factor by which `se` would grow without the segment; null: nothing else tells")
    ]
    alone: Annotated[float | None, Meta(description="standard error from the segment alone; null: it tells nothing")]
    known: Annotated[
        bool, Meta(description="`se` is below half of the value; of a value of 0, of its prior's sd or of five steps")
    ]


class SegmentInformation(LogSpan, frozen=True, kw_only=True):
    """What a segment tells of each parameter, in the order of `names`; null: no number."""

    weight: Annotated[
        Array, Meta(description="factors by which standard errors would grow without it; null: nothing else tells")
    ]
    lost: Annotated[Array, Meta(description="part of the information that would be lost without it, 0..1")]
    alone: Annotated[Array, Meta(description="standard errors from it alone; null: it tells nothing")]


class Information(Part, frozen=True, kw_only=True):
    """Which segments of logs tell of which parameter."""

    names: Annotated[tuple[str, ...], Meta(description="of the parameters")]
    seconds: Annotated[float, Meta(description="length of a segment [s]")]
    parameters: tuple[InformedParameter, ...]
    segments: tuple[SegmentInformation, ...]


class InformationResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="information"):
    """`seatrial ident information`: which segments of logs tell of which parameter of a fitted model."""

    information: Information
    inputs: tuple[InputTrace, ...]


class StateTrace(Part, frozen=True, kw_only=True):
    """A state over time, by the model and all sensors."""

    name: str
    unit: str
    meaning: str
    angle: Annotated[bool, Meta(description="an angle, known but for whole turns")]
    value: Array
    sd: Annotated[Array, Meta(description="standard deviation, the parameters' own errors included")]
    measured: Annotated[Array | None, Meta(description="the channel of that name, where there is one")] = None


class GnssFixes(Part, frozen=True, kw_only=True):
    """The positions that were measured."""

    t: Annotated[Array, Meta(description="[s of the log]")]
    x: Annotated[Array, Meta(description="north [m]")]
    y: Annotated[Array, Meta(description="east [m]")]
    used: Annotated[Array, Meta(description="1: used; 0: withheld on purpose")]


class NavigatedRecord(Part, frozen=True, kw_only=True):
    """Where the boat was, in one log."""

    record: str
    kind: Annotated[Literal["smoothed", "filtered"], Meta(description="by all samples, or by those so far")]
    t: Annotated[Array, Meta(description="[s of the log]")]
    states: tuple[StateTrace, ...]
    fixes: GnssFixes


class PositionEllipse(Part, frozen=True, kw_only=True):
    """The region that holds the position with 95 %."""

    major: Annotated[float, Meta(description="half axis [m]")]
    minor: Annotated[float, Meta(description="half axis [m]")]
    azimuth: Annotated[float, Meta(description="of the major axis [rad from north]")]
    radius: Annotated[float, Meta(description="of the circle that holds as much [m]")]


class WithheldErrors(Part, frozen=True, kw_only=True):
    """Estimates less the fixes that were withheld."""

    rms: Annotated[float, Meta(description="[m]")]
    largest: Annotated[float, Meta(description="[m]")]
    inside: Annotated[float, Meta(description="share inside the 95 % regions, the noise of the fix included")]
    n: Annotated[int, Meta(description="number of fixes")]


class GnssOutage(Part, frozen=True, kw_only=True):
    """A time without GNSS: what was claimed for its end, and what came true."""

    record: str
    start: Annotated[float, Meta(description="[s of the log]")]
    end: Annotated[float, Meta(description="[s of the log]")]
    duration: Annotated[float, Meta(description="[s]")]
    open: Annotated[bool, Meta(description="no fix came after it")]
    leading: Annotated[bool, Meta(description="no fix came before it: what is predicted for its end is a guess")]
    withheld: Annotated[bool, Meta(description="on purpose (`--gnss-outage`)")]
    north: Annotated[float, Meta(description="predicted for the end without GNSS [m]")]
    east: Annotated[float, Meta(description="[m]")]
    at_end: Annotated[PositionEllipse, Meta(description="of that prediction")]
    error: Annotated[float | None, Meta(description="distance of the fix at the end from it [m]")]
    allowed: Annotated[float | None, Meta(description="95 % radius of that distance, with the noise of the fix [m]")]
    inside: Annotated[bool | None, Meta(description="whether the fix is inside that region")]
    widest: Annotated[float, Meta(description="largest 95 % radius by the best estimate [m]")]
    predicted: Annotated[WithheldErrors | None, Meta(description="on withheld fixes, without those to come")]
    best: Annotated[WithheldErrors | None, Meta(description="on withheld fixes, by the best estimate")]


class NavigationResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="navigation"):
    """`seatrial ident navigate`: where the boat was, by a fitted model."""

    navigation: Annotated[tuple[NavigatedRecord, ...], Meta(description="one a log")]
    outages: Annotated[tuple[GnssOutage, ...], Meta(description="one an outage")]
    inputs: tuple[InputTrace, ...]


class SpectrumBands(Part, frozen=True, kw_only=True):
    """A power spectral density averaged over bands of equal width in the logarithm of the frequency."""

    frequency: Annotated[Array, Meta(description="middle of each band [Hz]")]
    psd: Annotated[Array, Meta(description="[unit^2/Hz]")]
    low: Annotated[Array, Meta(description="of the 95 % interval of the true one [unit^2/Hz]")]
    high: Annotated[Array, Meta(description="of the 95 % interval of the true one [unit^2/Hz]")]


class ChannelNoise(Part, frozen=True, kw_only=True):
    """White noise plus a random walk, fitted to a channel of a sensor at rest, and whether it is that."""

    channel: Annotated[str, Meta(description="with the log's name where there are several")]
    unit: str
    white: Annotated[float, Meta(description="standard deviation of a sample [unit]")]
    random_walk: Annotated[float, Meta(description="[unit/sqrt(s)]")]
    se_white: Annotated[float | None, Meta(description="standard error; null: no white noise was found")]
    se_random_walk: Annotated[float | None, Meta(description="standard error; null: no random walk was found")]
    white_limit: Annotated[
        float | None, Meta(description="where none was found: more would have been, in 95 of 100 such records [unit]")
    ] = None
    random_walk_limit: Annotated[
        float | None,
        Meta(description="where none was found: more would have been, in 95 of 100 such records [unit/sqrt(s)]"),
    ] = None
    accepted: Annotated[bool, Meta(description="whether the channel is white noise plus a random walk")]
    p: Annotated[float | None, Meta(description="p value of the Ljung-Box test of the innovations")]
    predictable: Annotated[float | None, Meta(description="share of the innovations' variance that could be predicted")]
    reason: Annotated[str | None, Meta(description="why it is not accepted")]
    frequency: Annotated[Array, Meta(description="[Hz]")]
    psd: Annotated[Array, Meta(description="power spectral density that was measured (Welch) [unit^2/Hz]")]
    psd_model: Annotated[Array, Meta(description="that of the fit [unit^2/Hz]")]
    bands: Annotated[
        SpectrumBands | None, Meta(description="the measured one averaged over bands, with its interval")
    ] = None


class NoiseResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="noise"):
    """`seatrial ident noise`: the noise of sensors at rest."""

    noise: Annotated[tuple[ChannelNoise, ...], Meta(description="one a channel of each log")]


class DesignedParameter(Part, frozen=True, kw_only=True):
    """Standard errors of a parameter before and after the mission; null: nothing is known of it."""

    name: str
    meaning: str
    unit: str
    value: Annotated[float, Meta(description="nominal")]
    before: Annotated[float | None, Meta(description="by earlier logs")]
    after: Annotated[float | None, Meta(description="with this mission, by prediction error")]
    form: Annotated[float | None, Meta(description="with this mission, by the form of the design")]
    baseline: Annotated[float | None, Meta(description="with the best baseline signal instead, by prediction error")]
    chosen: Annotated[bool, Meta(description="the criterion is of it")]


class Baseline(Part, frozen=True, kw_only=True):
    """A random sequence at its best, which the design is compared with."""

    name: Annotated[str, Meta(description="`PRBS` or `RGS`")]
    value: Annotated[float, Meta(description="its criterion")]
    bandwidth: Annotated[float, Meta(description="PRBS: clock [s]; RGS: corner [Hz]")]
    seeds: Annotated[Array, Meta(description="each seed's best")]


class CommandTrace(Part, frozen=True, kw_only=True):
    """What an input is commanded."""

    name: str
    t: Annotated[Array, Meta(description="time since the first step [s]")]
    value: Annotated[Array, Meta(description="-1..1")]


class DesignTrack(Part, frozen=True, kw_only=True):
    """Where the boat is expected to go, from rest, heading north: before the steps, in them, and after them."""

    t: Annotated[Array, Meta(description="since the beginning of the mission [s]")]
    x: Annotated[Array, Meta(description="north of the start [m]")]
    y: Annotated[Array, Meta(description="east of the start [m]")]
    radius: Annotated[Array, Meta(description="95 % of the sampled boats are within it [m]")]
    others: Annotated[tuple[Array, ...], Meta(description="tracks (n, 2) of sampled boats: north, east [m]")]
    inside: Annotated[float | None, Meta(description="share of them that kept to the area; null without one")]
    corner: Annotated[tuple[float, float] | None, Meta(description="south-west corner of the area from the start [m]")]
    area: Annotated[tuple[float, float] | None, Meta(description="north by east [m]")]
    current: Annotated[float, Meta(description="the largest that they meet [m/s]")]
    rest: Annotated[float, Meta(description="before the steps [s]")] = 0.0
    coasting: Annotated[float, Meta(description="without thrust after the steps [s]")] = 0.0


class Discrimination(Part, frozen=True, kw_only=True):
    """How far apart the mission puts two effects (`--discriminate`)."""

    effects: tuple[str, str]
    if_second: Annotated[float, Meta(description="T if the second is true")]
    if_first: Annotated[float, Meta(description="T if the first is true")]
    clear: Annotated[bool, Meta(description="both are large enough to tell them apart")]
    random: Annotated[Array, Meta(description="T of random missions")]


class DesignResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="design"):
    """`seatrial mission design`: the mission that tells most about a model."""

    model: Annotated[str, Meta(description="file or name of the model")]
    criterion: Annotated[str, Meta(description="`D`, `A`, `E` or `Ds`")]
    chosen: Annotated[tuple[str, ...], Meta(description="parameters that the criterion is of")]
    form: Annotated[str, Meta(description="of the information: `prediction error` or `output error`")]
    value: Annotated[float, Meta(description="of the criterion")]
    evaluations: Annotated[int, Meta(description="simulations that the search took")]
    parameters: tuple[DesignedParameter, ...]
    baselines: tuple[Baseline, ...]
    baseline: Annotated[str, Meta(description="the best of the baseline signals")]
    limited: Annotated[bool, Meta(description="the design had to keep to limits, which baseline signals do not")]
    samples: Annotated[dict[str, Array], Meta(description="by input, the criterion at 1000 samples of the parameters")]
    share_won: Annotated[float, Meta(description="share of the samples in which the design is best")]
    inputs: tuple[CommandTrace, ...]
    track: Annotated[DesignTrack | None, Meta(description="null: the model has no position")]
    apart: Annotated[Discrimination | None, Meta(description="null: two effects were not named")] = None
    rates: Annotated[
        dict[str, float], Meta(description="by sensor [Hz], on which the errors rest; empty: an older file")
    ] = msgspec.field(default_factory=dict)

    @property
    def margin(self) -> float:
        """Criterion of the design less that of the best baseline signal; negative: the design is worse."""
        return self.value - max(b.value for b in self.baselines)


APART = 0.4  # a fit starts within a factor exp(+-APART) of the truth
BIAS, COVERAGE, VARIANCE = 0.15, (0.93, 0.97), 0.1  # what is wanted
MOST_LOST = 0.05  # share of the replicates that may fail or not converge: what is left is no fair sample beyond it
AIMS = {"bias": (-BIAS, BIAS), "ratio": (1.0 - VARIANCE, 1.0 + VARIANCE), "coverage": COVERAGE}


class ParameterStudy(Part, frozen=True, kw_only=True):
    """Bias, variance and coverage of a parameter in the coordinate in which the estimator moves; intervals are 95 %."""

    name: str
    unit: str
    truth: Annotated[float, Meta(description="the value that was simulated")]
    n: Annotated[int, Meta(description="estimates with an interval")]
    at_bound: Annotated[int, Meta(description="of them, those at their bound")]
    sd: Annotated[float, Meta(description="of the estimates")]
    bias: Annotated[float, Meta(description="in `sd`")]
    bias_error: Annotated[float, Meta(description="standard error of `bias`")]
    ratio: Annotated[float, Meta(description="variance of the estimates over the one that the fits reported")]
    ratio_low: float
    ratio_high: float
    bound_ratio: Annotated[
        float, Meta(description="variance over the Cramer-Rao bound, or over the least variance near bounds")
    ]
    bound_ratio_low: float
    bound_ratio_high: float
    coverage: Annotated[float, Meta(description="share of the 95 % intervals that hold the truth, 0..1")]
    coverage_low: float
    coverage_high: float
    misses: Annotated[
        tuple[str, ...],
        Meta(description="what is beyond the aim: `bias`, `variance`, `coverage`; `(chance?)`: perhaps by chance"),
    ]


class ModelStudy(Part, frozen=True, kw_only=True):
    """Replicates of one model: simulated, estimated, and compared with the truth."""

    model: str
    about: Annotated[str, Meta(description="the mission")]
    method: Annotated[Literal["PE", "OE"], Meta(description="prediction error or output error")]
    estimator: Annotated[str, Meta(description="in words")]
    replicates: int
    failed: int
    unconverged: int
    cpu_fit: Annotated[float | None, Meta(description="median CPU time of a fit [s]")]
    cpu_simulation: Annotated[float | None, Meta(description="mean CPU time of a simulation [s]")]
    parameters: tuple[ParameterStudy, ...]

    @property
    def left_out(self) -> str:
        """Replicates that the statistics leave out, in words; empty where they have them all."""
        counted = ((self.failed, "failed"), (self.unconverged, "did not converge"))
        return " and ".join(f"{n} {what}" for n, what in counted if n)

    @property
    def too_many_left_out(self) -> bool:
        """Whether so many are left out that the others are no fair sample."""
        return self.failed + self.unconverged > MOST_LOST * self.replicates


class StudyResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="study"):
    """`seatrial ident study`: does the estimator keep its promises?"""

    seed: int
    studies: Annotated[tuple[ModelStudy, ...], Meta(description="one a model")]
