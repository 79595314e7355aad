"""Types of the results: their common keys, and the tables that several results share."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from seatrial.ident.data import FrameOrigin
from seatrial.ident.estimation import FailedRun
from seatrial.ident.numerics import Array

FORMAT = "seatrial-result 2"
Role = Literal["estimation", "validation"]
Verdict = Literal["right", "overconfident", "underconfident", "insufficient_data"]


Change = Literal["fell", "rose", "unchanged"]
RefitOutcome = Literal[
    "added", "outranked", "small", "not-supported", "not-validated", "worse-prediction", "no-better-prediction"
]


class Part(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base class of the tables of a result: immutable, with fields by keyword.

    Notes
    -----
    Subclasses repeat ``frozen=True, kw_only=True``, which msgspec does not inherit. Array fields have the type
    ``seatrial.ident.numerics.Array`` (float64, time along the first axis) and contain NaN for missing numbers. A
    scalar that may be missing is ``float | None``. The descriptions of the fields are printed in
    docs/formats/result.md.
    """


def same_length(part: Part, *names: str) -> None:
    """Compare the shapes of the named arrays of a table, which are plotted over each other; None is left out.

    Raises
    ------
    ValueError
        If the shapes differ.
    """
    sizes = {name: array.shape for name in names if (array := getattr(part, name)) is not None}
    if len(set(sizes.values())) > 1:
        raise ValueError(f"{' and '.join(sizes)} must be of one length, not {sizes}")


class LogFinding(Part, frozen=True, kw_only=True):
    """Finding of a check of a log (`seatrial check`)."""

    level: Annotated[str, Meta(description="`warning` or `fault`")]
    code: Annotated[str, Meta(description="code of the finding, for programs")]
    check: str
    where: Annotated[str, Meta(description="device, thruster or signal")]
    text: str
    advice: Annotated[str, Meta(description="what to do about it")] = ""
    spoils: Annotated[bool, Meta(description="a fit to this log is meaningless (`--despite-faults`)")] = False


class LogSummary(Part, frozen=True, kw_only=True):
    """Log that a result was made from."""

    path: str
    sha256: str
    role: Annotated[str, Meta(description="`estimation`, `validation`, `navigated` or `judged`")]
    name: str
    duration: Annotated[float, Meta(description="[s]")]
    rig: Annotated[str | None, Meta(description="name of the rig")] = None
    mission: Annotated[str | None, Meta(description="name of the mission")] = None
    origin: Annotated[
        FrameOrigin | None,
        Meta(description="origin of x and y; null: the log has no x and y, or their origin is unknown"),
    ] = None
    warnings: Annotated[tuple[str, ...], Meta(description="faults that were found while the log was read")] = ()
    findings: Annotated[
        tuple[LogFinding, ...], Meta(description="warnings and faults that the checks before a fit found")
    ] = ()


class Provenance(Part, frozen=True, kw_only=True):
    """Provenance of a result: time, software version, command line and logs."""

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
    """Warning to be read before the estimates."""

    code: WarningCode
    text: Annotated[str, Meta(description="one line for the reader")]


class Result(Provenance, frozen=True, kw_only=True):
    """Keys that all results have in common."""  # subclasses add tag_field="kind" and their kind as tag

    format: Literal["seatrial-result 2"] = "seatrial-result 2"
    answer: Annotated[
        str, Meta(description="the answer in one or two sentences; if the fit did not converge, only that statement")
    ]
    warnings: Annotated[
        tuple[ResultWarning, ...],
        Meta(description="to be read before the estimates, such as a missing thrust scale or a failed validation run"),
    ] = ()
    notes: Annotated[
        tuple[str, ...],
        Meta(
            description="remarks on what was left out or failed; with `--robust` also the number of outliers "
            "in each channel"
        ),
    ] = ()


ORIGINS = (
    "`estimated` from these logs, `measured` on the bench, `given` by the user as a value, `prior`: given by the user "
    "with a standard deviation, `built-in`: default value of seatrial"
)


class ForceScale(Part, frozen=True, kw_only=True):
    """Scale of forces, masses and damping: the provenance of the thrust and of the thrusters' arms."""

    thrust: Annotated[str | None, Meta(description=f"provenance of c1; null: the model has no c1. {ORIGINS}")] = None
    arm: Annotated[
        str | None,
        Meta(description="provenance of the thrusters' arms; null: the model has no arms, or does not need them"),
    ] = None
    relative: Annotated[
        bool,
        Meta(
            description="masses, damping and forces are ratios to T = c1 + c2, the full forward thrust of one thruster "
            "(of both in a surge model): `m_u/T` [kg/N]"
        ),
    ] = False
    relative_yaw: Annotated[
        bool,
        Meta(description="parameters of the yaw equation are also ratios to the arm of the thrusters: `m_r/y_arm`"),
    ] = False
    statistical_only: Annotated[
        bool, Meta(description="standard errors exclude the uncertainty of the thrust, which was not given")
    ] = False


class UnusedSignal(Part, frozen=True, kw_only=True):
    """Signal of a log that the model uses neither as an input nor as an output."""

    signal: str
    logs: Annotated[tuple[str, ...], Meta(description="names of the logs that contain the signal")]
    code: Annotated[
        Literal["incomplete-sensor", "other-name", "not-in-model", "unknown-name", "validation-only"],
        Meta(
            description="`incomplete-sensor`: another signal of the same sensor is missing; `other-name`: seatrial "
            "uses another name or unit for this signal; `not-in-model`: other models use it; `unknown-name`: no model "
            "uses that name; `validation-only`: no estimation log contains it, so its noise is unknown"
        ),
    ]
    reason: str


class EffectParameter(Part, frozen=True, kw_only=True):
    """Estimated parameter of an effect."""

    name: str
    meaning: str
    unit: str
    value: float
    se: Annotated[
        float | None,
        Meta(description="standard error; null: the parameter is fixed, at a bound or not informed by the data"),
    ]


class ParameterRow(Part, frozen=True, kw_only=True):
    """Parameter of the model. A per-record parameter has one row for each record."""

    name: str
    meaning: str
    unit: str
    value: float
    se: Annotated[
        float | None,
        Meta(
            description="standard error (of the prior if considered); null: fixed, at a bound or not informed by data"
        ),
    ]
    free: Annotated[bool, Meta(description="true: the parameter was estimated")]
    origin: Annotated[str, Meta(description=f"provenance of the value: {ORIGINS}")] = "estimated"
    prior_share: Annotated[
        float | None,
        Meta(description="share of its information that is from the prior, 0..1 (1: considered); null: fixed"),
    ] = None
    start: Annotated[float | None, Meta(description="initial value of the search")] = None
    flag: Annotated[str | None, Meta(description="what is wrong with the estimate")] = None
    record: Annotated[str | None, Meta(description="name of the record; null: shared by all")] = None


class Correlation(Part, frozen=True, kw_only=True):
    """Correlation matrix of the estimates."""

    names: tuple[str, ...]
    matrix: Annotated[Array, Meta(description="(names, names)")]

    def __post_init__(self) -> None:
        if self.matrix.shape != (len(self.names), len(self.names)):
            raise ValueError(f"matrix must be of {len(self.names)} names, not {self.matrix.shape}")


class FitSummary(Part, frozen=True, kw_only=True):
    """Fit of a model: method, convergence and estimates."""

    model: Annotated[str, Meta(description="names of the model and of its effects")]
    method: Annotated[Literal["PE", "OE"], Meta(description="prediction error or output error")]
    restricted: Annotated[bool, Meta(description="noise variances are estimated by restricted maximum likelihood")]
    second_order: Annotated[bool, Meta(description="the filter is a second-order EKF")]
    converged: bool
    message: Annotated[str, Meta(description="why the search ended")]
    log_likelihood: float | None
    iterations: int
    cpu: Annotated[float, Meta(description="CPU time [s]")]
    coloured: Annotated[
        bool, Meta(description="residuals are autocorrelated: standard errors are the robust ones if these are larger")
    ] = False
    scale: ForceScale = ForceScale()
    parameters: tuple[ParameterRow, ...]
    correlation: Correlation


class Trace(Part, frozen=True, kw_only=True):
    """Channel of a record: measured, predicted over the horizon, and simulated from the inputs alone."""

    record: str
    role: Role
    channel: str
    unit: str
    angle: Annotated[bool, Meta(description="whether the channel is an angle, which is known except for whole turns")]
    t: Annotated[Array, Meta(description="[s]")]
    measured: Array
    model: Annotated[Array, Meta(description="simulated")]
    sd: Annotated[Array, Meta(description="standard deviation of the simulation")]
    diverged: Annotated[
        float | None, Meta(description="time at which the simulation error exceeded ten times the measured range [s]")
    ] = None
    t_horizon: Annotated[Array, Meta(description="times of the predictions over `horizon_seconds` [s]")]
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
    """Track of a record: north (x) and east (y) [m]."""

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
    """Input of the model over time."""

    record: str
    name: str
    unit: str
    t: Annotated[Array, Meta(description="[s]")]
    value: Array

    def __post_init__(self) -> None:
        same_length(self, "t", "value")


class WhitenessTests(Part, frozen=True, kw_only=True):
    """Whiteness tests of the standardised innovations of a channel."""

    e: Annotated[Array, Meta(description="standardised innovations")]
    acf: Annotated[Array, Meta(description="autocorrelation at `lags`")]
    ljung_box_p: Annotated[float | None, Meta(description="p value of the Ljung-Box test")]
    periodogram_p: Annotated[float | None, Meta(description="p value of the cumulative periodogram")]
    cumulative: Annotated[Array, Meta(description="cumulative periodogram at `frequency`, 0..1")]
    normal_p: Annotated[float | None, Meta(description="p value of D'Agostino and Pearson's test of normality")]
    white: Annotated[
        bool, Meta(description="verdict of both tests together at 1 % (Bonferroni: neither p below 0.5 %)")
    ]
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
    """Correlation of innovations with earlier values of an input."""

    z: Annotated[Array, Meta(description="correlation at `lags`, in standard deviations under independence")]
    p: Annotated[float | None, Meta(description="p value of the largest correlation over all lags")]
    largest: Annotated[float | None, Meta(description="largest absolute correlation coefficient over all lags")] = None


class CrossCorrelation(CorrelationTest, frozen=True, kw_only=True):
    """Correlation of the residuals of a channel with an input."""

    record: str
    channel: str
    input: str
    lags: Annotated[Array, Meta(description="[s]")]
    after: Annotated[CorrelationTest | None, Meta(description="diagnosis: the same with the effects")] = None

    def __post_init__(self) -> None:
        same_length(self, "lags", "z")


class ErrorComparison(Part, frozen=True, kw_only=True):
    """RMS prediction error of a channel."""

    before: Annotated[float | None, Meta(description="diagnosis: RMS error without the effects")] = None
    after: Annotated[float | None, Meta(description="RMS error of the model; null: the prediction diverged")]
    unit: str
    low: Annotated[float | None, Meta(description="over the horizon: 95 % interval of after / before")] = None
    high: float | None = None
    verdict: Annotated[Change | None, Meta(description="over the horizon: verdict on the change, by the interval")] = (
        None
    )
    spread: Annotated[
        float | None,
        Meta(
            description="standard deviation of the measured samples about their mean in each record (circular mean for "
            "angles); the fit in per cent is 100 (1 - error / spread)"
        ),
    ] = None


class ErrorTable(Part, frozen=True, kw_only=True):
    """Prediction errors of each channel: one step ahead, over the horizon, and in simulation."""

    one_step: dict[str, ErrorComparison]
    horizon: Annotated[dict[str, ErrorComparison], Meta(description="over `horizon_seconds`")]
    simulation: Annotated[dict[str, ErrorComparison], Meta(description="from the inputs alone")]


class PredictionFit(Part, frozen=True, kw_only=True):
    """Fit of all channels together over the horizon.

    The fit is 1 - g, where g is the geometric mean over all channels of RMS prediction error / standard deviation of
    the measured output.
    """

    role: Role
    fit: float
    low: Annotated[float | None, Meta(description="95 % interval of `fit`; null: the data are too short")] = None
    high: float | None = None


class PredictionChange(Part, frozen=True, kw_only=True):
    """Prediction change: effect of the added effects on the prediction errors over the horizon.

    The ratio is the geometric mean over all channels of RMS error after / before.
    """

    role: Role
    ratio: float
    low: Annotated[float | None, Meta(description="95 % interval of `ratio`; null: the data are too short")] = None
    high: float | None = None
    verdict: Annotated[Change, Meta(description="verdict on the change, by the interval")]
    better: Annotated[tuple[str, ...], Meta(description="channels whose error fell significantly")] = ()
    worse: Annotated[tuple[str, ...], Meta(description="channels whose error rose significantly")] = ()


class Errors(Part, frozen=True, kw_only=True):
    """Prediction errors on the estimation data and on the validation data."""

    estimation: ErrorTable
    validation: Annotated[ErrorTable | None, Meta(description="null: there were no validation data")] = None


class CalibrationRow(Part, frozen=True, kw_only=True):
    """Calibration of the prediction intervals of a channel."""

    n: Annotated[int, Meta(description="number of errors")]
    n_effective: Annotated[float, Meta(description="effective sample size: number of independent errors")]
    inside_50: Annotated[float, Meta(description="share of the errors inside the 50 % interval")]
    inside_95: Annotated[float, Meta(description="share of the errors inside the 95 % interval")]
    scale: Annotated[float | None, Meta(description="RMS of error / predicted standard deviation")]
    low: Annotated[float | None, Meta(description="95 % interval of `scale`")]
    high: float | None
    pit: Annotated[Array, Meta(description="(10,) shares of the errors in each tenth of the predicted distribution")]
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
    """Calibration of each channel: one step ahead, over the horizon, and in simulation."""

    one_step: dict[str, CalibrationRow]
    horizon: Annotated[dict[str, CalibrationRow], Meta(description="over `horizon_seconds`")]
    simulation: Annotated[dict[str, CalibrationRow], Meta(description="from the inputs alone")]


class Calibrations(Part, frozen=True, kw_only=True):
    """Calibration on the estimation data and on the validation data (diagnosis: with the effects)."""

    estimation: CalibrationTable
    validation: Annotated[CalibrationTable | None, Meta(description="null: there were no validation data")] = None


class ProfileCurve(Part, frozen=True, kw_only=True):
    """Profile likelihood of a parameter."""

    name: Annotated[str, Meta(description="parameter; `V_x@0` is that of the first log")]
    unit: str
    value: float
    grid: Annotated[Array, Meta(description="values of the parameter, increasing")]
    drop: Annotated[
        Array,
        Meta(
            description="drop of the log-likelihood (with priors: of the log-posterior) at `grid`, all other "
            "parameters fitted again"
        ),
    ]
    low: Annotated[
        float | None, Meta(description="95 % interval, at whose ends the drop is 1.92; null: open on that side")
    ] = None
    high: float | None = None
    wald_low: Annotated[float | None, Meta(description="95 % interval by 1.96 standard errors")] = None
    wald_high: float | None = None
    notes: Annotated[
        tuple[str, ...],
        Meta(
            description="remarks on a side that is open or ends at a bound, with the searched range; or on a better "
            "fit that the profile found and that `value` and the profile are then of"
        ),
    ] = ()

    def __post_init__(self) -> None:
        same_length(self, "grid", "drop")


class Homogeneity(Part, frozen=True, kw_only=True):
    """Homogeneity test of a parameter: likelihood ratio of one value for all logs against one for each log."""

    name: str
    unit: str
    value: Annotated[float, Meta(description="one value for all logs")]
    se: float | None
    se_robust: Annotated[float | None, Meta(description="robust standard error (sandwich covariance)")]
    records: tuple[str, ...]
    values: Annotated[Array, Meta(description="value of each log")]
    ses: Annotated[Array, Meta(description="standard errors of `values`")]
    lr: Annotated[float, Meta(description="likelihood ratio")]
    df: int
    p: float
    agree: bool
    scatter: Annotated[float | None, Meta(description="standard deviation between logs beyond their standard errors")]
    mean: Annotated[float | None, Meta(description="mean over the logs, weighted with that scatter")]
    se_mean: float | None
    low: Annotated[float | None, Meta(description="95 % interval of `mean`")]
    high: float | None
    left_out: Annotated[
        tuple[str, ...], Meta(description="logs that do not inform the parameter; `df` does not count them")
    ] = ()


class FitResult(Result, frozen=True, kw_only=True):
    """Result of a fit: estimates, predictions and residuals."""

    @property
    def converged(self) -> bool:
        """Return whether all fits that the answer depends on converged."""
        return self.fit.converged

    fit: FitSummary
    failed_runs: tuple[FailedRun, ...] = ()
    horizon_seconds: Annotated[
        float,
        Meta(description="prediction horizon (`--horizon`) [s]: 10 by default, 1 on the bench"),
    ]
    errors: Errors
    calibration: Calibrations
    traces: Annotated[tuple[Trace, ...], Meta(description="one for each record and channel")]
    track: Annotated[tuple[Track, ...], Meta(description="one for each record with positions")]
    inputs: tuple[InputTrace, ...]
    residuals: Annotated[tuple[ResidualTests, ...], Meta(description="one for each estimation record and channel")]
    cross: Annotated[
        tuple[CrossCorrelation, ...], Meta(description="one for each estimation record, channel and input")
    ]
    unused_signals: Annotated[
        tuple[UnusedSignal, ...], Meta(description="signals of the logs that the model does not use, with the reason")
    ] = ()


class StaticForce(Part, frozen=True, kw_only=True):
    """Static thrust curve: measured points and the fitted curve."""

    n: Annotated[Array, Meta(description="measured shaft speed or command, as a part of full")]
    force: Annotated[Array, Meta(description="[N]")]
    sd: Annotated[Array, Meta(description="standard errors of `force` [N]")]
    n_model: Array
    force_model: Annotated[Array, Meta(description="[N]")]
    force_sd: Annotated[Array, Meta(description="[N]")]
    force_quadratic: Annotated[Array | None, Meta(description="static curve: c1 n|n| + c2 n^2 [N]")] = None
    abscissa: Annotated[str, Meta(description="quantity of `n`")] = "shaft speed n"

    def __post_init__(self) -> None:
        same_length(self, "n", "force", "sd")
        same_length(self, "n_model", "force_model", "force_sd", "force_quadratic")


class VehicleResult(FitResult, frozen=True, kw_only=True, tag_field="kind", tag="vehicle"):
    """`seatrial ident vehicle`: the model of a vehicle."""

    prediction: Annotated[
        PredictionFit | None, Meta(description="null: no prediction over the horizon was possible")
    ] = None
    profiles: Annotated[tuple[ProfileCurve, ...], Meta(description="with `--profile`: one for each parameter")] = ()
    homogeneity: Annotated[
        tuple[Homogeneity, ...], Meta(description="with `--test-homogeneity`: one for each parameter")
    ] = ()


class ThrusterResult(FitResult, frozen=True, kw_only=True, tag_field="kind", tag="thruster"):
    """`seatrial ident thruster`: the model of a thruster whose shaft was measured."""

    static: Annotated[StaticForce | None, Meta(description="null: there was no load cell")] = None
    profiles: Annotated[tuple[ProfileCurve, ...], Meta(description="with `--profile`: one for each parameter")] = ()


class ThrustCurveResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="thrust_curve"):
    """`seatrial ident thruster` if the logs have no shaft speed: a static thrust curve."""

    static: StaticForce


class Candidate(Part, frozen=True, kw_only=True):
    """Candidate in a round of the search, with its score test."""

    name: str
    title: str
    lm: Annotated[float, Meta(description="score test statistic")]
    df: int
    p: float
    p_block: Annotated[float | None, Meta(description="block-robust p value")]
    generic: Annotated[bool, Meta(description="nonparametric curve, not an effect of the catalogue")]
    threshold: Annotated[float, Meta(description="threshold of `lm`, corrected for the number of tests")]
    passed: bool


class Refit(Part, frozen=True, kw_only=True):
    """Refit: the model of a round with one more effect, all parameters estimated again."""

    name: str
    title: str
    gain: Annotated[float, Meta(description="2 d ln L")]
    df: int
    criterion: Annotated[float, Meta(description="gain - df ln n")]
    validation_gain: Annotated[float, Meta(description="d ln L on the validation data")]
    t: Annotated[float, Meta(description="t statistic of `validation_gain` over blocks")]
    prediction: Annotated[
        PredictionChange | None, Meta(description="null: the refit was rejected before its prediction was compared")
    ] = None
    outcome: Annotated[
        RefitOutcome,
        Meta(
            description="`added`; `outranked`: acceptable, but another candidate explains more; `small`: negligible "
            "compared with the effects already found; `not-supported` by the estimation data; `not-validated` by the "
            "validation data; `worse-prediction`; `no-better-prediction`: of a nonparametric effect"
        ),
    ]
    parameters: tuple[EffectParameter, ...]


class UntestedCandidate(Part, frozen=True, kw_only=True):
    """Candidate that passed the score test but could not be fitted."""

    name: str
    title: str
    reason: str


class RemovedEffect(Part, frozen=True, kw_only=True):
    """Effect that was added and removed again by backward elimination: the validation data do not support it."""

    name: str
    title: str
    validation_gain: Annotated[
        float, Meta(description="d ln L on the validation data with the effect against without it")
    ]
    t: Annotated[float, Meta(description="t statistic of `validation_gain` over blocks")]
    prediction: PredictionChange | None


class ValidationMismatch(Part, frozen=True, kw_only=True):
    """Validation run whose prediction errors are larger than the model predicts."""

    record: str
    channel: Annotated[str, Meta(description="channel with the largest `scale`")]
    scale: Annotated[float, Meta(description="RMS of one-step error / predicted standard deviation")]
    parameter: Annotated[str | None, Meta(description="parameter whose change would explain the run best")] = None
    unit: str = ""
    fitted: Annotated[float | None, Meta(description="value from the estimation runs")] = None
    value: Annotated[float | None, Meta(description="value from this run alone")] = None
    se: float | None = None


class Round(Part, frozen=True, kw_only=True):
    """Round of the search for missing effects."""

    tested: Annotated[int, Meta(description="number of candidates")] = 0
    passed: Annotated[int, Meta(description="number of candidates that passed the score test")] = 0
    candidates: Annotated[tuple[Candidate, ...], Meta(description="the best 24, best first")] = ()
    refits: tuple[Refit, ...] = ()
    untested: tuple[UntestedCandidate, ...] = ()
    chosen: Annotated[str | None, Meta(description="name of the added effect")] = None
    why: Annotated[str, Meta(description="reason for the choice, or for the end of the search")]


class Alternative(Part, frozen=True, kw_only=True):
    """Competing model: another refit of the same round, which was not chosen."""

    name: str
    title: str
    criterion_behind: Annotated[float, Meta(description="criterion of the chosen effect less that of this one")]


class EffectRow(Part, frozen=True, kw_only=True):
    """Effect that was added to the model."""

    name: str
    title: str
    formula: str
    source: str
    place: Annotated[str, Meta(description="part of the model that the effect acts on")]
    experiment: Annotated[str, Meta(description="experiment that shows the effect")]
    alternatives: tuple[Alternative, ...]
    attribution: Annotated[
        Literal["identified", "ambiguous", "nonparametric"],
        Meta(
            description="`identified`: the effect explains what was missing, and no competing model does; `ambiguous`: "
            "the missing effect resembles this one; `nonparametric`: a curve, no known effect"
        ),
    ]
    reasons: Annotated[tuple[str, ...], Meta(description="reasons for the attribution `ambiguous`")]
    not_excluded: Annotated[tuple[str, ...], Meta(description="names of effects that may be the true one instead")]
    parameters: tuple[EffectParameter, ...]
    error_ratio_without: Annotated[
        float | None,
        Meta(
            description="effect importance: prediction error 3 s ahead (on the bench 1.2 s) without the effect / with "
            "it, disturbance forces left out; geometric mean over the channels of the validation data"
        ),
    ]
    gain_last: Annotated[float | None, Meta(description="2 d ln L on the estimation data if the effect is added last")]


class RemainingCandidate(Part, frozen=True, kw_only=True):
    """Candidate that still passes the score test after the last effect was added."""

    name: str
    lm: float
    df: int
    p: float


class NonparametricCurve(Part, frozen=True, kw_only=True):
    """Nonparametric effect: curve estimated from the data."""

    force: Annotated[str, Meta(description="force, relative change of thrust (`T`, `T_left`), or sensor")]
    sensor_error: Annotated[bool, Meta(description="true: the curve is the error of this sensor, not a force")]
    variable: str
    unit: str
    variable_unit: str
    grid: Array
    value: Array
    sd: Array
    band: Annotated[
        Array, Meta(description="half width of the band that contains the whole curve with 95 % probability")
    ]

    def __post_init__(self) -> None:
        same_length(self, "grid", "value", "sd", "band")


class ResidualForce(Part, frozen=True, kw_only=True):
    """Disturbance force: smoothed estimate of a force that the model does not explain."""

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
    """Estimate of a parameter without and with the effects."""

    name: str
    unit: str
    before: float
    before_se: float | None
    after: float
    after_se: float | None


class DiagnosisResult(FitResult, frozen=True, kw_only=True, tag_field="kind", tag="diagnosis"):
    """`seatrial ident diagnose`: effects that a model lacks.

    `fit` and `calibration` are those of the model with the added effects.
    """

    @property
    def converged(self) -> bool:
        """Return whether the fits without and with the effects converged."""
        return self.fit.converged and self.converged_before

    caveat: Annotated[
        str | None,
        Meta(description="why a name in the answer is uncertain, and whether --max-effects ended the search"),
    ] = None
    converged_before: Annotated[bool, Meta(description="whether the fit without the effects converged")]
    prediction: Annotated[PredictionChange | None, Meta(description="null: no effect was added")] = None
    cross_validated: Annotated[
        bool,
        Meta(
            description="blocked cross-validation: blocks of the estimation runs, each predicted by a fit to the others"
        ),
    ] = False
    mismatches: Annotated[
        tuple[ValidationMismatch, ...],
        Meta(description="validation runs whose errors are larger than the model predicts"),
    ] = ()
    rounds: tuple[Round, ...]
    removed_effects: tuple[RemovedEffect, ...] = ()
    effects: Annotated[tuple[EffectRow, ...], Meta(description="added effects, the most important first")] = ()
    remaining_candidates: tuple[RemainingCandidate, ...] = ()
    nonparametric_effects: Annotated[
        tuple[NonparametricCurve, ...],
        Meta(description="nonparametric effects, and the curve that the first ambiguous effect approximates"),
    ] = ()
    residual_forces: Annotated[tuple[ResidualForce, ...], Meta(description="one for each record and force")] = ()
    parameters_before_after: tuple[ParameterChange, ...] = ()
    recommended_experiment: Annotated[
        str | None, Meta(description="experiment that would distinguish the competing models")
    ] = None
