"""What results are made of: their common keys, and the tables that several of them have. Types alone."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import msgspec
from msgspec import Meta

from seatrial.ident.numerics import Array

FORMAT = "seatrial-result 2"
Role = Literal["estimation", "validation"]
Verdict = Literal["right", "overconfident", "underconfident", "insufficient_data"]


Change = Literal["fell", "rose", "unchanged"]
RefitOutcome = Literal[
    "added", "outranked", "small", "not-supported", "not-validated", "worse-prediction", "no-better-prediction"
]


class Part(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table of a result: immutable, fields by keyword (subclasses say ``frozen=True, kw_only=True`` again).

    Array fields are annotated ``seatrial.ident.numerics.Array`` (float64, time along the first axis), NaN where there
    is no number; a number that may not exist is ``float | None``. Descriptions make docs/formats/result.md. ``exact``:
    its numbers keep all their digits in a file.
    """

    exact: ClassVar[bool] = False


def same_length(part: Part, *names: str) -> None:
    """Arrays that are drawn over each other; raises ValueError where one is longer than another."""
    sizes = {name: array.shape for name in names if (array := getattr(part, name)) is not None}
    if len(set(sizes.values())) > 1:
        raise ValueError(f"{' and '.join(sizes)} must be of one length, not {sizes}")


class LogFinding(Part, frozen=True, kw_only=True):
    """What a check of a log found (`seatrial check`)."""

    level: Annotated[str, Meta(description="`warning` or `fault`")]
    code: Annotated[str, Meta(description="what was found, for programs")]
    check: str
    where: Annotated[str, Meta(description="device, thruster or signal")]
    text: str
    advice: Annotated[str, Meta(description="what to do about it")] = ""
    spoils: Annotated[bool, Meta(description="a fit to this log means nothing (`--despite-faults`)")] = False


class FrameOrigin(Part, frozen=True, kw_only=True):
    """Where x = y = 0 is."""

    exact: ClassVar[bool] = True  # seven digits of a latitude are 10 m
    latitude: Annotated[float, Meta(description="[deg]")]
    longitude: Annotated[float, Meta(description="[deg]")]
    log: Annotated[str, Meta(description="name of the log whose first fix that is")] = ""


class LogSummary(Part, frozen=True, kw_only=True):
    """A log that a result was made from."""

    path: str
    sha256: str
    role: Annotated[str, Meta(description="`estimation`, `validation`, `navigated` or `judged`")]
    name: str
    duration: Annotated[float, Meta(description="[s]")]
    rig: Annotated[str | None, Meta(description="name of the rig")] = None
    mission: Annotated[str | None, Meta(description="name of the mission")] = None
    origin: Annotated[
        FrameOrigin | None,
        Meta(description="of x and y; null: the log does not say from where they count, or has none"),
    ] = None
    warnings: Annotated[tuple[str, ...], Meta(description="what is wrong with the log")] = ()
    findings: Annotated[
        tuple[LogFinding, ...], Meta(description="what the checks before a fit found that is not in order")
    ] = ()


class Provenance(Part, frozen=True, kw_only=True):
    """Where a result comes from."""

    created: Annotated[str, Meta(description="UTC time (ISO 8601)")]
    seatrial: Annotated[str, Meta(description="version")]
    command: Annotated[str, Meta(description="command line")]
    logs: tuple[LogSummary, ...] = ()


WarningCode = Literal[
    "log-check",
    "thrust-scale-unknown",
    "arm-unknown",
    "shaft-lag-built-in",
    "stuck-sensor",
    "record-cut",
    "frame-assumed",
    "noise-contradicted",
    "prior-contradicted",
    "inertia-too-small",
    "one-direction",
    "zero-unknown",
    "validation-run-failed",
    "late-sensor-bias",
    "curve-not-drawn",
    "effect-untested",
    "rates-assumed",
    "beyond-validity",
]


class ResultWarning(Part, frozen=True, kw_only=True):
    """What must be known before an estimate is read."""

    code: WarningCode
    text: Annotated[str, Meta(description="a line for people")]


class Result(Provenance, frozen=True, kw_only=True):
    """What every result says."""  # subclasses add tag_field="kind" and their kind as tag

    format: Literal["seatrial-result 2"] = "seatrial-result 2"
    answer: Annotated[
        str, Meta(description="the answer in a sentence or two, for people; of a fit that did not converge, that alone")
    ]
    warnings: Annotated[
        tuple[ResultWarning, ...],
        Meta(description="to read before the estimates: no thrust scale was given, a validation run failed"),
    ] = ()
    notes: Annotated[
        tuple[str, ...],
        Meta(
            description="lines: what was left out, what failed, what to know; with `--robust` the number of outliers "
            "in each channel"
        ),
    ] = ()


ORIGINS = (
    "`estimated` from these logs, `measured` on the bench, `given` by the user as a value, `prior`: by the user with a "
    "standard deviation, `built-in`: by nobody"
)


class ForceScale(Part, frozen=True, kw_only=True):
    """What forces, masses and damping rest on."""

    thrust: Annotated[str | None, Meta(description=f"provenance of c1; null: the model has none. {ORIGINS}")] = None
    arm: Annotated[str | None, Meta(description="provenance of the thrusters' arms; null: none, or not needed")] = None
    relative: Annotated[
        bool,
        Meta(
            description="masses, damping and forces are ratios to T = c1 + c2, the full-ahead thrust of one thruster "
            "(of both in a surge model): `m_u/T` [kg/N]"
        ),
    ] = False
    relative_yaw: Annotated[
        bool,
        Meta(description="what belongs to the yaw equation is a ratio to the arm of the thrusters, too: `m_r/y_arm`"),
    ] = False
    statistical_only: Annotated[
        bool, Meta(description="standard errors leave out how well the thrust itself is known: nobody said")
    ] = False


class UnusedSignal(Part, frozen=True, kw_only=True):
    """A signal of a log that no input and no sensor of the model takes."""

    signal: str
    logs: Annotated[tuple[str, ...], Meta(description="names of the logs that have it")]
    code: Annotated[
        Literal["incomplete-sensor", "other-name", "not-in-model", "unknown-name", "validation-only"],
        Meta(
            description="`incomplete-sensor`: it needs another one beside it; `other-name`: ident knows it by another "
            "name or unit; `not-in-model`: this model has no place for it; `unknown-name`: no model takes that name; "
            "`validation-only`: no estimation log has it, so that its noise is not known"
        ),
    ]
    reason: str


class EffectParameter(Part, frozen=True, kw_only=True):
    """A parameter of an effect in a fit."""

    name: str
    meaning: str
    unit: str
    value: float
    se: Annotated[float | None, Meta(description="standard error; null: fixed, at a bound or not informed")]


class ParameterRow(Part, frozen=True, kw_only=True):
    """A parameter of the model, one row a record where every record has its own."""

    name: str
    meaning: str
    unit: str
    value: float
    se: Annotated[
        float | None,
        Meta(description="standard error, if considered the prior's; null: fixed, at a bound or not informed"),
    ]
    free: Annotated[bool, Meta(description="false: it was not estimated")]
    origin: Annotated[str, Meta(description=f"provenance of the value: {ORIGINS}")] = "estimated"
    prior_share: Annotated[
        float | None, Meta(description="part of its information from the prior, 0..1 (1: considered); null: fixed")
    ] = None
    start: Annotated[float | None, Meta(description="value that the search started from")] = None
    flag: Annotated[str | None, Meta(description="what is wrong with the estimate")] = None
    record: Annotated[str | None, Meta(description="name of the record; null: shared by all")] = None


class Correlation(Part, frozen=True, kw_only=True):
    """Correlation of the estimates."""

    names: tuple[str, ...]
    matrix: Annotated[Array, Meta(description="(names, names)")]

    def __post_init__(self) -> None:
        if self.matrix.shape != (len(self.names), len(self.names)):
            raise ValueError(f"matrix must be of {len(self.names)} names, not {self.matrix.shape}")


class FitSummary(Part, frozen=True, kw_only=True):
    """A fit: how it went, and the estimates."""

    model: Annotated[str, Meta(description="name of the model and of its effects")]
    method: Annotated[Literal["PE", "OE"], Meta(description="prediction error or output error")]
    restricted: Annotated[bool, Meta(description="noise by restricted likelihood")]
    second_order: Annotated[bool, Meta(description="the filter's mean is of second order")]
    converged: bool
    message: Annotated[str, Meta(description="why the search ended")]
    log_likelihood: float | None
    iterations: int
    cpu: Annotated[float, Meta(description="CPU time [s]")]
    coloured: Annotated[
        bool, Meta(description="residuals are autocorrelated: standard errors are the sandwich's where it is larger")
    ] = False
    scale: ForceScale = ForceScale()
    parameters: tuple[ParameterRow, ...]
    correlation: Correlation


class Trace(Part, frozen=True, kw_only=True):
    """A channel of a record: measured, predicted over the horizon, and simulated from the inputs alone."""

    record: str
    role: Role
    channel: str
    unit: str
    angle: Annotated[bool, Meta(description="an angle, known but for whole turns")]
    t: Annotated[Array, Meta(description="[s]")]
    measured: Array
    model: Annotated[Array, Meta(description="simulated")]
    sd: Annotated[Array, Meta(description="standard deviation of the simulation")]
    diverged: Annotated[
        float | None, Meta(description="when the simulation left what was measured by ten times its range [s]")
    ] = None
    t_horizon: Annotated[Array, Meta(description="of the predictions over `horizon_seconds` [s]")]
    horizon: Annotated[Array, Meta(description="predicted over `horizon_seconds`")]
    sd_horizon: Annotated[Array, Meta(description="standard deviation of that prediction")]
    before: Annotated[Array | None, Meta(description="diagnosis: simulated without the effects")] = None
    horizon_before: Annotated[
        Array | None, Meta(description="diagnosis: predicted over `horizon_seconds` without the effects")
    ] = None

    def __post_init__(self) -> None:
        same_length(self, "t", "measured", "model", "sd", "before")
        same_length(self, "t_horizon", "horizon", "sd_horizon", "horizon_before")


class Track(Part, frozen=True, kw_only=True):
    """The path of a record, north (x) and east (y) [m]."""

    record: str
    role: Role
    x_measured: Array
    y_measured: Array
    x_model: Array
    y_model: Array
    x_before: Array | None = None
    y_before: Array | None = None

    def __post_init__(self) -> None:
        same_length(self, "x_measured", "y_measured", "x_model", "y_model", "x_before", "y_before")


class InputTrace(Part, frozen=True, kw_only=True):
    """An input as the model saw it."""

    record: str
    name: str
    unit: str
    t: Annotated[Array, Meta(description="[s]")]
    value: Array

    def __post_init__(self) -> None:
        same_length(self, "t", "value")


class WhitenessTests(Part, frozen=True, kw_only=True):
    """Standardised innovations of a channel and the tests whether they are white."""

    e: Annotated[Array, Meta(description="standardised innovations")]
    acf: Annotated[Array, Meta(description="autocorrelation at `lags`")]
    ljung_box_p: Annotated[float | None, Meta(description="p value of the Ljung-Box test")]
    periodogram_p: Annotated[float | None, Meta(description="p value of the cumulative periodogram")]
    cumulative: Annotated[Array, Meta(description="cumulative periodogram at `frequency`, 0..1")]
    normal_p: Annotated[float | None, Meta(description="p value of D'Agostino and Pearson's test of normality")]
    white: Annotated[bool, Meta(description="by both tests together at 1 % (Bonferroni: neither p below 0.5 %)")]
    outliers: Annotated[int, Meta(description="innovations beyond 6 standard deviations")]
    largest: Annotated[float, Meta(description="largest innovation, absolute, in standard deviations")]


class ResidualTests(WhitenessTests, frozen=True, kw_only=True):
    """Whiteness of the residuals of a channel in a record."""

    record: str
    channel: str
    unit: str
    t: Annotated[Array, Meta(description="[s]")]
    lags: Annotated[Array, Meta(description="[s]")]
    band: Annotated[float, Meta(description="95 % half width of `acf` for white noise")]
    frequency: Annotated[Array, Meta(description="[Hz]")]
    after: Annotated[WhitenessTests | None, Meta(description="diagnosis: the same with the effects")] = None

    def __post_init__(self) -> None:
        same_length(self, "t", "e")
        same_length(self, "lags", "acf")
        same_length(self, "frequency", "cumulative")


class CorrelationTest(Part, frozen=True, kw_only=True):
    """Correlation of innovations with an input that came before them."""

    z: Annotated[Array, Meta(description="in standard deviations under independence, at `lags`")]
    p: Annotated[float | None, Meta(description="of the largest, over all lags")]
    largest: Annotated[
        float | None, Meta(description="coefficient of correlation over all lags, by its absolute value")
    ] = None


class CrossCorrelation(CorrelationTest, frozen=True, kw_only=True):
    """Whether the residuals of a channel still know an input."""

    record: str
    channel: str
    input: str
    lags: Annotated[Array, Meta(description="[s]")]
    after: Annotated[CorrelationTest | None, Meta(description="diagnosis: the same with the effects")] = None

    def __post_init__(self) -> None:
        same_length(self, "lags", "z")


class ErrorComparison(Part, frozen=True, kw_only=True):
    """Prediction error of a channel, root mean square."""

    before: Annotated[float | None, Meta(description="diagnosis: without the effects")] = None
    after: Annotated[float | None, Meta(description="of the model; null: the prediction diverged")]
    unit: str
    low: Annotated[float | None, Meta(description="over the horizon: 95 % interval of after / before")] = None
    high: float | None = None
    verdict: Annotated[Change | None, Meta(description="over the horizon: of the change, by the interval")] = None
    spread: Annotated[
        float | None,
        Meta(
            description="standard deviation of what was measured, about its mean in each record (an angle's: about its "
            "circular mean); the fit in per cent is 100 (1 - error / spread)"
        ),
    ] = None


class ErrorTable(Part, frozen=True, kw_only=True):
    """Errors by how far ahead was predicted: channel -> error."""

    one_step: dict[str, ErrorComparison]
    horizon: Annotated[dict[str, ErrorComparison], Meta(description="over `horizon_seconds`")]
    simulation: Annotated[dict[str, ErrorComparison], Meta(description="from the inputs alone")]


class PredictionFit(Part, frozen=True, kw_only=True):
    """How much of all channels together is predicted over the horizon: one less the geometric mean over them of RMS
    prediction error over standard deviation of what was measured."""

    role: Role
    fit: float
    low: Annotated[float | None, Meta(description="95 % interval of `fit`; null: the data are too short")] = None
    high: float | None = None


class PredictionChange(Part, frozen=True, kw_only=True):
    """Change of the prediction errors over the horizon by the effects that were added: the geometric mean over all
    channels of RMS error after / before."""

    role: Role
    ratio: float
    low: Annotated[float | None, Meta(description="95 % interval of `ratio`; null: the data are too short")] = None
    high: float | None = None
    verdict: Annotated[Change, Meta(description="by the interval")]
    better: Annotated[tuple[str, ...], Meta(description="channels whose own error fell beyond its interval")] = ()
    worse: Annotated[tuple[str, ...], Meta(description="channels whose own error rose beyond its interval")] = ()


class Errors(Part, frozen=True, kw_only=True):
    """Prediction errors on each set of data."""

    estimation: ErrorTable
    validation: Annotated[ErrorTable | None, Meta(description="null: there were no such data")] = None


class CalibrationRow(Part, frozen=True, kw_only=True):
    """Whether the predicted band of a channel is right."""

    n: Annotated[int, Meta(description="number of errors")]
    n_effective: Annotated[float, Meta(description="of them independent")]
    inside_50: Annotated[float, Meta(description="share of the errors inside the 50 % band")]
    inside_95: Annotated[float, Meta(description="share of the errors inside the 95 % band")]
    scale: Annotated[float | None, Meta(description="root mean square of error over predicted standard deviation")]
    low: Annotated[float | None, Meta(description="95 % interval of `scale`")]
    high: float | None
    pit: Annotated[Array, Meta(description="(10,) shares by tenths of the predicted distribution")]
    verdict: Annotated[
        Verdict,
        Meta(
            description="`right`; beyond 10 % `overconfident` (errors are larger than predicted) or `underconfident`; "
            "`insufficient_data`"
        ),
    ]

    def __post_init__(self) -> None:
        if self.pit.shape != (10,):
            raise ValueError(f"pit must have ten shares, not {self.pit.shape}")


class CalibrationTable(Part, frozen=True, kw_only=True):
    """Calibration by how far ahead was predicted: channel -> calibration."""

    one_step: dict[str, CalibrationRow]
    horizon: Annotated[dict[str, CalibrationRow], Meta(description="over `horizon_seconds`")]
    simulation: Annotated[dict[str, CalibrationRow], Meta(description="from the inputs alone")]


class Calibrations(Part, frozen=True, kw_only=True):
    """Calibration of the predictions on each set of data (of a diagnosis: with the effects)."""

    estimation: CalibrationTable
    validation: Annotated[CalibrationTable | None, Meta(description="null: there were no such data")] = None


class ProfileCurve(Part, frozen=True, kw_only=True):
    """Profile likelihood of a parameter."""

    name: Annotated[str, Meta(description="`V_x@0`: of the first log")]
    unit: str
    value: float
    grid: Annotated[Array, Meta(description="increasing")]
    drop: Annotated[
        Array,
        Meta(description="of the log-likelihood there, all others fitted again; with priors, of the posterior"),
    ]
    low: Annotated[float | None, Meta(description="95 % interval, where the drop is 1.92; null: open on that side")] = (
        None
    )
    high: float | None = None
    wald_low: Annotated[float | None, Meta(description="1.96 standard errors either way")] = None
    wald_high: float | None = None
    notes: Annotated[
        tuple[str, ...],
        Meta(
            description="a side that ends at a bound or is open, and how far was looked; a better fit that was found "
            "on the way, whose `value` and profile these then are"
        ),
    ] = ()

    def __post_init__(self) -> None:
        same_length(self, "grid", "drop")


class Homogeneity(Part, frozen=True, kw_only=True):
    """Test whether a parameter has one value in all logs (likelihood ratio)."""

    name: str
    unit: str
    value: Annotated[float, Meta(description="one value for all logs")]
    se: float | None
    se_robust: Annotated[float | None, Meta(description="of the sandwich covariance")]
    records: tuple[str, ...]
    values: Annotated[Array, Meta(description="one a log")]
    ses: Array
    lr: Annotated[float, Meta(description="likelihood ratio")]
    df: int
    p: float
    agree: bool
    scatter: Annotated[float | None, Meta(description="between logs, beyond their errors")]
    mean: Annotated[float | None, Meta(description="with that scatter")]
    se_mean: float | None
    low: Annotated[float | None, Meta(description="95 % interval of `mean`")]
    high: float | None
    left_out: Annotated[
        tuple[str, ...], Meta(description="logs that do not inform the parameter; `df` does not count them")
    ] = ()


class FailedRun(Part, frozen=True, kw_only=True):
    """A validation run that could not be evaluated."""

    record: str
    reason: str


class FitResult(Result, frozen=True, kw_only=True):
    """A fit, what the fitted model predicts, and what it leaves."""

    @property
    def converged(self) -> bool:
        """Whether every fit did that the answer rests on."""
        return self.fit.converged

    fit: FitSummary
    failed_runs: tuple[FailedRun, ...] = ()
    horizon_seconds: Annotated[
        float,
        Meta(
            description="how far ahead was predicted between one step and the simulation (`--horizon`) [s]: 10 by "
            "default, 1 on the bench"
        ),
    ]
    errors: Errors
    calibration: Calibrations
    traces: Annotated[tuple[Trace, ...], Meta(description="one a record and channel")]
    track: Annotated[tuple[Track, ...], Meta(description="one a record with positions")]
    inputs: tuple[InputTrace, ...]
    residuals: Annotated[tuple[ResidualTests, ...], Meta(description="one a record of estimation and channel")]
    cross: Annotated[tuple[CrossCorrelation, ...], Meta(description="one a record of estimation, channel and input")]
    unused_signals: Annotated[
        tuple[UnusedSignal, ...], Meta(description="signals of the logs that the model does not take, and why")
    ] = ()


class StaticForce(Part, frozen=True, kw_only=True):
    """Steady force of a thruster: measured points and the fitted curve."""

    n: Annotated[Array, Meta(description="measured, part of full")]
    force: Annotated[Array, Meta(description="[N]")]
    sd: Annotated[Array, Meta(description="standard errors of `force` [N]")]
    n_model: Array
    force_model: Annotated[Array, Meta(description="[N]")]
    force_sd: Annotated[Array, Meta(description="[N]")]
    force_quadratic: Annotated[Array | None, Meta(description="static curve: c1 n|n| + c2 n^2 [N]")] = None
    abscissa: Annotated[str, Meta(description="what n is")] = "shaft speed n"

    def __post_init__(self) -> None:
        same_length(self, "n", "force", "sd")
        same_length(self, "n_model", "force_model", "force_sd", "force_quadratic")


class VehicleResult(FitResult, frozen=True, kw_only=True, tag_field="kind", tag="vehicle"):
    """`seatrial ident vehicle`: the model of a vehicle."""

    prediction: Annotated[PredictionFit | None, Meta(description="null: nothing was predicted over the horizon")] = None
    profiles: Annotated[tuple[ProfileCurve, ...], Meta(description="with `--profile`: one a parameter")] = ()
    homogeneity: Annotated[tuple[Homogeneity, ...], Meta(description="with `--test-homogeneity`: one a parameter")] = ()


class ThrusterResult(FitResult, frozen=True, kw_only=True, tag_field="kind", tag="thruster"):
    """`seatrial ident thruster`: the model of a thruster whose shaft was measured."""

    static: Annotated[StaticForce | None, Meta(description="null: there was no load cell")] = None
    profiles: Annotated[tuple[ProfileCurve, ...], Meta(description="with `--profile`: one a parameter")] = ()


class ThrustCurveResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="thrust_curve"):
    """`seatrial ident thruster` where nobody measured the shaft: a static curve."""

    static: StaticForce


class Candidate(Part, frozen=True, kw_only=True):
    """A candidate in a round of the search and its score test."""

    name: str
    title: str
    lm: Annotated[float, Meta(description="statistic of the test")]
    df: int
    p: float
    p_block: Annotated[float | None, Meta(description="p value of the test from blocks of the data")]
    generic: Annotated[bool, Meta(description="a force without a formula, not an effect of the catalogue")]
    threshold: Annotated[float, Meta(description="of `lm`, for as many tests as the search made")]
    passed: bool


class Refit(Part, frozen=True, kw_only=True):
    """The model of a round with one more effect, everything fitted again."""

    name: str
    title: str
    gain: Annotated[float, Meta(description="2 d ln L")]
    df: int
    criterion: Annotated[float, Meta(description="gain - df ln n")]
    validation_gain: Annotated[float, Meta(description="d ln L on the validation data")]
    t: Annotated[float, Meta(description="t statistic of `validation_gain` over blocks")]
    prediction: Annotated[PredictionChange | None, Meta(description="null: it came not as far as that")] = None
    outcome: Annotated[
        RefitOutcome,
        Meta(
            description="`added`; `outranked`: accepted, another explains more; `small` beside what was found; "
            "`not-supported` by the estimation data, `not-validated` by the validation data; `worse-prediction`; "
            "`no-better-prediction`, of a nonparametric effect"
        ),
    ]
    parameters: tuple[EffectParameter, ...]


class UntestedCandidate(Part, frozen=True, kw_only=True):
    """A candidate that passed the score test and could not be fitted."""

    name: str
    title: str
    reason: str


class RemovedEffect(Part, frozen=True, kw_only=True):
    """An effect that was added and removed again: beside the others it does not pay on the validation data."""

    name: str
    title: str
    validation_gain: Annotated[float, Meta(description="d ln L on the validation data of having it")]
    t: Annotated[float, Meta(description="t statistic of `validation_gain` over blocks")]
    prediction: PredictionChange | None


class ValidationMismatch(Part, frozen=True, kw_only=True):
    """A validation run that is predicted worse than the model says."""

    record: str
    channel: Annotated[str, Meta(description="whose one-step errors are most too large")]
    scale: Annotated[float, Meta(description="root mean square of these errors over predicted standard deviation")]
    parameter: Annotated[str | None, Meta(description="another value of it would explain the run best")] = None
    unit: str = ""
    fitted: Annotated[float | None, Meta(description="by the estimation runs")] = None
    value: Annotated[float | None, Meta(description="by this run alone")] = None
    se: float | None = None


class Round(Part, frozen=True, kw_only=True):
    """A round of the search."""

    tested: Annotated[int, Meta(description="number of candidates")] = 0
    passed: Annotated[int, Meta(description="how many of them passed the score test")] = 0
    candidates: Annotated[tuple[Candidate, ...], Meta(description="the best 24, best first")] = ()
    refits: tuple[Refit, ...] = ()
    untested: tuple[UntestedCandidate, ...] = ()
    chosen: Annotated[str | None, Meta(description="name of what was added")] = None
    why: str


class Alternative(Part, frozen=True, kw_only=True):
    """What was refitted in the same round and not chosen."""

    name: str
    title: str
    criterion_behind: float


class EffectRow(Part, frozen=True, kw_only=True):
    """An effect that was added to the model."""

    name: str
    title: str
    formula: str
    source: str
    place: Annotated[str, Meta(description="what it acts on")]
    experiment: Annotated[str, Meta(description="what shows it")]
    alternatives: tuple[Alternative, ...]
    attribution: Annotated[
        Literal["identified", "ambiguous", "nonparametric"],
        Meta(
            description="`identified`: it explains what was missing, and nothing else does; `ambiguous`: the missing "
            "effect resembles it; `nonparametric`: a curve, no known effect"
        ),
    ]
    reasons: Annotated[tuple[str, ...], Meta(description="why it is ambiguous")]
    not_excluded: Annotated[tuple[str, ...], Meta(description="names of effects that it may be instead")]
    parameters: tuple[EffectParameter, ...]
    error_ratio_without: Annotated[
        float | None,
        Meta(
            description="the error three seconds ahead, on the bench 1.2, without it over that with it, disturbance "
            "forces left out; geometric mean over the channels of the validation data"
        ),
    ]
    gain_last: Annotated[
        float | None, Meta(description="2 d ln L on the estimation data that it brings when it comes last")
    ]


class RemainingCandidate(Part, frozen=True, kw_only=True):
    """A score test that passes after the last effect."""

    name: str
    lm: float
    df: int
    p: float


class NonparametricCurve(Part, frozen=True, kw_only=True):
    """A nonparametric effect as the data draw it."""

    force: Annotated[str, Meta(description="force, or relative change of thrust (`T`, `T_left`), or sensor in error")]
    sensor_error: Annotated[bool, Meta(description="not a force, but the error of this sensor")]
    variable: str
    unit: str
    variable_unit: str
    grid: Array
    value: Array
    sd: Array
    band: Annotated[Array, Meta(description="half width of the band that holds the whole curve with 95 %")]

    def __post_init__(self) -> None:
        same_length(self, "grid", "value", "sd", "band")


class ResidualForce(Part, frozen=True, kw_only=True):
    """A force that the model does not explain, smoothed."""

    record: str
    force: Annotated[str, Meta(description="`X`, `Y`, `N`; on the bench `F` [N] and `n_dot` [1/s]")]
    unit: str
    t: Annotated[Array, Meta(description="[s]")]
    mean: Array
    sd: Array
    after_mean: Annotated[Array | None, Meta(description="with the effects")] = None
    after_sd: Array | None = None

    def __post_init__(self) -> None:
        same_length(self, "t", "mean", "sd", "after_mean", "after_sd")


class ParameterChange(Part, frozen=True, kw_only=True):
    """A parameter without and with the effects."""

    name: str
    unit: str
    before: float
    before_se: float | None
    after: float
    after_se: float | None


class DiagnosisResult(FitResult, frozen=True, kw_only=True, tag_field="kind", tag="diagnosis"):
    """`seatrial ident diagnose`: what a model lacks. `fit` and `calibration` are of the model with its effects."""

    @property
    def converged(self) -> bool:
        return self.fit.converged and self.converged_before

    caveat: Annotated[
        str | None, Meta(description="why a name in the answer is not sure, and that --max-effects ended the search")
    ] = None
    converged_before: Annotated[bool, Meta(description="whether the fit without the effects converged")]
    prediction: Annotated[PredictionChange | None, Meta(description="null: no effect was added")] = None
    cross_validated: Annotated[
        bool,
        Meta(description="validation data are blocks in time of the estimation runs, predicted by a fit to the rest"),
    ] = False
    mismatches: Annotated[
        tuple[ValidationMismatch, ...], Meta(description="validation runs that the model claims too much of")
    ] = ()
    rounds: tuple[Round, ...]
    removed_effects: tuple[RemovedEffect, ...] = ()
    effects: Annotated[tuple[EffectRow, ...], Meta(description="what was added, the most important first")] = ()
    remaining_candidates: tuple[RemainingCandidate, ...] = ()
    nonparametric_effects: Annotated[
        tuple[NonparametricCurve, ...],
        Meta(description="nonparametric effects, and the residual that the first effect only resembles"),
    ] = ()
    residual_forces: Annotated[tuple[ResidualForce, ...], Meta(description="one a record and force")] = ()
    parameters_before_after: tuple[ParameterChange, ...] = ()
    recommended_experiment: Annotated[str | None, Meta(description="what would settle what is open")] = None
