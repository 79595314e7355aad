"""Types of result.json: the keys that all results have in common, the results of the fits, and their tables.

A table is an object of JSON with named keys, for example one parameter with its estimate. The results of the commands
that are not fits are in ``commands``.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from seatrial.ident.data import FrameOrigin
from seatrial.ident.estimation import FailedRun, Role
from seatrial.ident.model import FlagCode
from seatrial.ident.numerics import Array, stability_of

UNSTABLE = 1e-3  # growth [1/s] from which a course counts as unstable; slower ones are not noticed
UNEQUAL = 0.02  # difference of both sides that is worth a sentence, as a part of the largest command
FORMAT = "seatrial-result 3"
Verdict = Literal["right", "overconfident", "underconfident", "insufficient_data"]


Change = Literal["fell", "rose", "unchanged"]
RefitOutcome = Literal[
    "added", "outranked", "small", "not-supported", "not-validated", "worse-prediction", "no-better-prediction"
]


class Part(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base class of the tables of a result.json: immutable objects whose fields are given by keyword.

    Decoding a file with a key that is not a field of the table raises an error.

    Notes
    -----
    Subclasses repeat ``frozen=True, kw_only=True``, which msgspec does not inherit. Array fields have the type
    ``seatrial.ident.numerics.Array`` (float64, time along the first axis) and contain NaN for missing numbers. A
    scalar that may be missing is ``float | None``. The descriptions of the fields are printed in
    docs/formats/result.md.
    """


def same_length(part: Part, *names: str) -> None:
    """Check that array fields of a result's table have the same shape, for example times and values of a curve.

    Parameters
    ----------
    part
        The table.
    *names
        Names of the fields. A field that is None is not checked.

    Raises
    ------
    ValueError
        If the shapes differ.
    """
    sizes = {name: array.shape for name in names if (array := getattr(part, name)) is not None}
    if len(set(sizes.values())) > 1:
        raise ValueError(f"{' and '.join(sizes)} must be of one length, not {sizes}")


class LogFinding(Part, frozen=True, kw_only=True):
    """Warning or fault that the checks of a log before a fit (those of `seatrial check`) found."""

    level: Annotated[str, Meta(description="`warning` or `fault`")]
    code: Annotated[str, Meta(description="code of the finding, for programs")]
    check: Annotated[str, Meta(description="name of the check")]
    where: Annotated[str, Meta(description="device, thruster or signal")]
    text: Annotated[str, Meta(description="text of the finding, for readers")]
    advice: Annotated[str, Meta(description="what to do about it")] = ""
    spoils: Annotated[bool, Meta(description="a fit to this log is meaningless (`--despite-faults`)")] = False


class LogSummary(Part, frozen=True, kw_only=True):
    """Log that a result was made from: file, role, duration and findings of its checks.

    The role `navigated` is that of `seatrial ident navigate`, which estimates the states of the boat. The role `judged`
    is that of `seatrial ident information`, which computes the information of the log, and `compared` that of `seatrial
    ident compare`.
    """

    path: Annotated[str, Meta(description="file name, with the time window if only a part was used")]
    sha256: Annotated[
        str, Meta(description="SHA-256 of the file, also if only a part was used; empty if it is unknown")
    ]
    role: Annotated[str, Meta(description="`estimation`, `validation`, `navigated`, `judged` or `compared`")]
    name: Annotated[str, Meta(description="name of the log, which its record has too")]
    duration: Annotated[float, Meta(description="[s]")]
    start: Annotated[
        str | None,
        Meta(
            description="UTC time of its begin (ISO 8601), in 1970 without a date; null: a result of an earlier version"
        ),
    ] = None
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
    logs: Annotated[tuple[LogSummary, ...], Meta(description="logs that the result was made from")] = ()


WarningCode = Literal[
    "log-check",
    "thrust-scale-unknown",
    "arm-unknown",
    "shaft-lag-built-in",
    "stuck-sensor",
    "record-cut",
    "short-data",
    "frame-assumed",
    "noise-contradicted",
    "prior-contradicted",
    "inertia-too-small",
    "intervals-from-compared-log",
    "mass-implausible",
    "motion-not-excited",
    "nearly-converged",
    "model-not-converged",
    "one-direction",
    "zero-unknown",
    "validation-run-failed",
    "late-sensor-bias",
    "curve-not-drawn",
    "effect-untested",
    "rates-assumed",
    "beyond-validity",
    "track-not-predicted",
    "thrust-sides-differ",
    "thrust-ahead",
    "thrust-astern",
    "unusual-estimate",
    "antenna-contradicted",
    "compared-on-fitted-log",
    "navigated-fitted-log",
    "compared-on-validation-log",
    "compared-in-blocks",
    "compared-samples-limited",
    "effect-estimated-on-compared-log",
    "command-scale",
    "full-speed-differs",
    "boat-moves",
    "dead-zone-contradicted",
    "structure-unfit",
]


class ResultWarning(Part, frozen=True, kw_only=True):
    """Warning of a result, to be read before its estimates are used."""

    code: Annotated[WarningCode, Meta(description="code of the warning, for programs")]
    text: Annotated[str, Meta(description="one line for the reader")]


class CurvesFile(Part, frozen=True, kw_only=True):
    """Parquet file beside result.json, with the numbers of the curves of the result."""

    file: Annotated[str, Meta(description="name of the file, in the folder of result.json")]
    sha256: Annotated[str, Meta(description="SHA-256 of the file")]


class Result(Provenance, frozen=True, kw_only=True):
    """Keys that the results of all commands have in common."""  # subclasses add tag_field="kind" and their kind as tag

    format: Literal["seatrial-result 3"] = "seatrial-result 3"
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
    curves_file: Annotated[
        CurvesFile | None,
        Meta(
            description='file with the numbers of all arrays that are `{"parquet": n}` here; null: there is none, '
            "and in a result that was read"
        ),
    ] = None

    def __repr__(self) -> str:
        """Return ``<TYPE: answer>`` in place of all fields, whose curves would be megabytes of text."""
        return f"<{type(self).__name__}: {self.answer}>"


ORIGINS = (
    "`estimated` from these logs, `measured` on the bench, `given` by the user as a value, `prior`: given by the user "
    "with a standard deviation, `built-in`: default value of seatrial"
)


class ForceScale(Part, frozen=True, kw_only=True):
    """Scale of forces, masses and damping: the provenance of the thrust and of the thrusters' arms that determine it.

    An arm is the distance of a thruster from the centre line.
    """

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
    """Logged signal that is neither an input nor an output of the model."""

    signal: Annotated[str, Meta(description="name of the signal")]
    logs: Annotated[tuple[str, ...], Meta(description="names of the logs that contain the signal")]
    code: Annotated[
        Literal["incomplete-sensor", "other-name", "not-in-model", "unknown-name", "validation-only"],
        Meta(
            description="`incomplete-sensor`: another signal of the same sensor is missing; `other-name`: seatrial "
            "uses another name or unit for this signal; `not-in-model`: other models use it; `unknown-name`: no model "
            "uses that name; `validation-only`: no estimation log contains it, so its noise is unknown"
        ),
    ]
    reason: Annotated[str, Meta(description="reason in words why the signal is not used")]


class EffectParameter(Part, frozen=True, kw_only=True):
    """Parameter of an effect, a physical phenomenon that was added to the model, with its estimate."""

    name: Annotated[str, Meta(description="name of the parameter")]
    meaning: Annotated[str, Meta(description="meaning in words")]
    unit: Annotated[str, Meta(description="unit of the values, SI and radians; empty: none")]
    value: Annotated[float, Meta(description="estimate")]
    se: Annotated[
        float | None,
        Meta(description="standard error; null: the parameter is fixed, at a bound or not informed by the data"),
    ]
    at_bound: Annotated[
        bool, Meta(description="whether the value is a bound of the parameter, and so no estimate of its size")
    ] = False


class ParameterRow(Part, frozen=True, kw_only=True):
    """Parameter of the model with its value and standard error.

    An estimated parameter that has its own value in each record (per-record parameter) has one row for each record.
    """

    name: Annotated[str, Meta(description="name of the parameter; a ratio to the thrust is `NAME/T`")]
    meaning: Annotated[str, Meta(description="meaning in words")]
    unit: Annotated[str, Meta(description="unit of the values, SI and radians; empty: none")]
    value: Annotated[float, Meta(description="estimate, or value of a fixed parameter")]
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
    flag_codes: Annotated[
        tuple[FlagCode, ...],
        Meta(
            description="short codes of `flag`, for tables and programs; empty also in a result of an earlier version"
        ),
    ] = ()
    record: Annotated[str | None, Meta(description="name of the record; null: shared by all")] = None
    positive: Annotated[
        bool, Meta(description="true: the quantity cannot be negative, and its 95 % interval in tables ends at zero")
    ] = False

    def interval(self, reach: float) -> tuple[float, float] | None:
        """Return the value ± ``reach`` standard errors; None without one.

        The interval of a quantity that cannot be negative ends at zero: this part contains the true value as often as
        the whole interval.
        """
        if self.se is None:
            return None
        low, high = self.value - reach * self.se, self.value + reach * self.se
        return (max(low, 0.0) if self.positive else low), high

    @property
    def origin_in_table(self) -> str:
        """Origin for the column of a table; of an estimate at a bound with the words ``at bound``."""
        return f"{self.origin}, at bound" if "at bound" in self.flag_codes else self.origin

    @property
    def flag_in_table(self) -> str:
        """Codes of the flag for a table; empty without a flag, ``other`` for one of a result of an earlier version."""
        return ", ".join(self.flag_codes) or ("other" if self.flag else "")


class Correlation(Part, frozen=True, kw_only=True):
    """Correlation matrix of the estimated parameters."""

    names: Annotated[tuple[str, ...], Meta(description="names of the parameters, in the order of the rows and columns")]
    matrix: Annotated[Array, Meta(description="(names, names)")]

    def __post_init__(self) -> None:
        """Raise ValueError if the correlation matrix does not have one row and one column for each parameter name."""
        if self.matrix.shape != (len(self.names), len(self.names)):
            raise ValueError(
                f"the correlation matrix has the shape {self.matrix.shape}, but there are {len(self.names)} names"
            )


class FitSummary(Part, frozen=True, kw_only=True):
    """Fit of a model: method, convergence and estimates."""

    model: Annotated[str, Meta(description="names of the model and of its effects")]
    method: Annotated[Literal["PE", "OE"], Meta(description="prediction error or output error")]
    restricted: Annotated[bool, Meta(description="noise variances are estimated by restricted maximum likelihood")]
    second_order: Annotated[bool, Meta(description="the filter is a second-order EKF")]
    converged: Annotated[bool, Meta(description="whether the search converged")]
    message: Annotated[str, Meta(description="why the search ended")]
    log_likelihood: Annotated[
        float | None, Meta(description="natural logarithm of the likelihood at the estimate; null: not finite")
    ]
    iterations: Annotated[int, Meta(description="number of iterations of the last fit; of a thruster: of both fits")]
    cpu: Annotated[float, Meta(description="CPU time of this fit [s]; of a diagnosis, that of its last fit alone")]
    coloured: Annotated[
        bool, Meta(description="residuals are autocorrelated: standard errors are the robust ones if these are larger")
    ] = False
    scale: Annotated[ForceScale, Meta(description="provenance of the force scale")] = ForceScale()
    parameters: Annotated[
        tuple[ParameterRow, ...],
        Meta(description="one for each parameter, or for each record of a per-record parameter"),
    ]
    correlation: Annotated[Correlation, Meta(description="correlation of the estimated parameters")]


class Trace(Part, frozen=True, kw_only=True):
    """Measured channel of a record over time, with its prediction over the horizon and its simulation.

    A prediction starts from the filtered state `horizon_seconds` earlier. The simulation uses the inputs alone. Times
    count from the start of the log.
    """

    record: Annotated[str, Meta(description="name of the record")]
    role: Annotated[Role, Meta(description="`estimation` or `validation`")]
    channel: Annotated[str, Meta(description="name of the measured channel")]
    unit: Annotated[str, Meta(description="unit of the values, SI and radians; empty: none")]
    angle: Annotated[bool, Meta(description="whether the channel is an angle, which is known except for whole turns")]
    t: Annotated[Array, Meta(description="[s]")]
    measured: Annotated[Array, Meta(description="measured values")]
    model: Annotated[Array, Meta(description="simulated")]
    sd: Annotated[Array, Meta(description="standard deviation of the simulation, widened by the validation data")]
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
        """Raise ValueError if arrays of the channel over the same times, `t` or `t_horizon`, differ in length."""
        same_length(self, "t", "measured", "model", "sd", "before")
        same_length(self, "t_horizon", "horizon", "sd_horizon", "horizon_before")


class Track(Part, frozen=True, kw_only=True):
    """Measured and simulated track of the boat in a record: positions north (x) and east (y) [m]."""

    record: Annotated[str, Meta(description="name of the record")]
    role: Annotated[Role, Meta(description="`estimation` or `validation`")]
    x_measured: Annotated[Array, Meta(description="measured, north [m]")]
    y_measured: Annotated[Array, Meta(description="measured, east [m]")]
    x_model: Annotated[Array, Meta(description="simulated, north [m]")]
    y_model: Annotated[Array, Meta(description="simulated, east [m]")]
    x_before: Annotated[Array | None, Meta(description="diagnosis: simulated without the effects, north [m]")] = None
    y_before: Annotated[Array | None, Meta(description="diagnosis: simulated without the effects, east [m]")] = None

    def __post_init__(self) -> None:
        """Raise ValueError if the arrays of the track's coordinates differ in length."""
        same_length(self, "x_measured", "y_measured", "x_model", "y_model", "x_before", "y_before")


class InputTrace(Part, frozen=True, kw_only=True):
    """Input of the model in a record over time.

    Times count from the start of the log.
    """

    record: Annotated[str, Meta(description="name of the record")]
    name: Annotated[str, Meta(description="name of the input")]
    unit: Annotated[str, Meta(description="unit of the values, SI and radians; empty: none")]
    t: Annotated[Array, Meta(description="[s]")]
    value: Annotated[
        Array,
        Meta(description="values of the input at `t`; of an averaged input its mean from there to the next time"),
    ]

    def __post_init__(self) -> None:
        """Raise ValueError if times and values of the input differ in length."""
        same_length(self, "t", "value")


class WhitenessTests(Part, frozen=True, kw_only=True):
    """Whiteness tests of the standardised innovations of a channel.

    A standardised innovation is measured minus predicted value, divided by the predicted standard deviation.
    """

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
    """Whiteness tests of the residuals (standardised innovations) of a channel in a record.

    Times count from the start of the log.
    """

    role: Annotated[Role, Meta(description="`estimation` or `validation`")] = "estimation"
    record: Annotated[str, Meta(description="name of the record")]
    channel: Annotated[str, Meta(description="name of the measured channel")]
    unit: Annotated[str, Meta(description="unit of the values, SI and radians; empty: none")]
    t: Annotated[Array, Meta(description="[s]")]
    lags: Annotated[Array, Meta(description="[s]")]
    band: Annotated[float, Meta(description="95 % half width of `acf` for white noise")]
    frequency: Annotated[Array, Meta(description="[Hz]")]
    after: Annotated[WhitenessTests | None, Meta(description="diagnosis: the same with the effects")] = None

    def __post_init__(self) -> None:
        """Raise ValueError if arrays of the tests over the same times, lags or frequencies differ in length."""
        same_length(self, "t", "e")
        same_length(self, "lags", "acf")
        same_length(self, "frequency", "cumulative")


class CorrelationTest(Part, frozen=True, kw_only=True):
    """Correlation of the innovations of a channel with values of an input at earlier times, and its test."""

    z: Annotated[Array, Meta(description="correlation at `lags`, in standard deviations under independence")]
    p: Annotated[float | None, Meta(description="p value of the largest correlation over all lags")]
    largest: Annotated[float | None, Meta(description="largest absolute correlation coefficient over all lags")] = None


class CrossCorrelationRow(CorrelationTest, frozen=True, kw_only=True):
    """Correlation of the residuals (innovations) of a channel in a record with an input of the model."""

    role: Annotated[Role, Meta(description="`estimation` or `validation`")] = "estimation"
    record: Annotated[str, Meta(description="name of the record")]
    channel: Annotated[str, Meta(description="name of the measured channel")]
    input: Annotated[str, Meta(description="name of the input")]
    lags: Annotated[Array, Meta(description="[s]")]
    after: Annotated[CorrelationTest | None, Meta(description="diagnosis: the same with the effects")] = None

    def __post_init__(self) -> None:
        """Raise ValueError if the arrays of the lags and of the correlations differ in length."""
        same_length(self, "lags", "z")


class ErrorComparison(Part, frozen=True, kw_only=True):
    """RMS prediction error of a channel for one kind of prediction; in a diagnosis without and with the effects.

    The verdict is `fell` or `rose` if the 95 % interval excludes 1 and the change is more than half a per cent, and
    otherwise `unchanged`. Without an interval there is none.
    """

    before: Annotated[float | None, Meta(description="diagnosis: RMS error without the effects")] = None
    after: Annotated[float | None, Meta(description="RMS error of the model; null: the prediction diverged")]
    unit: Annotated[str, Meta(description="unit of the channel")]
    low: Annotated[float | None, Meta(description="over the horizon: 95 % interval of after / before")] = None
    high: Annotated[float | None, Meta(description="upper end of the interval")] = None
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
    """RMS prediction errors by channel for each kind of prediction: one step ahead, over the horizon, simulation."""

    one_step: Annotated[dict[str, ErrorComparison], Meta(description="one step ahead")]
    horizon: Annotated[dict[str, ErrorComparison], Meta(description="over `horizon_seconds`")]
    simulation: Annotated[dict[str, ErrorComparison], Meta(description="from the inputs alone")]


class PredictionFit(Part, frozen=True, kw_only=True):
    """Fit of all channels together over the horizon.

    The fit is 1 - g, where g is the geometric mean over all channels of RMS prediction error / standard deviation of
    the measured output.
    """

    role: Annotated[Role, Meta(description="`estimation` or `validation`")]
    fit: Annotated[float, Meta(description="fit, 1 for a perfect prediction")]
    low: Annotated[float | None, Meta(description="95 % interval of `fit`; null: the data are too short")] = None
    high: Annotated[float | None, Meta(description="upper end of the interval")] = None
    largest_errors: Annotated[
        LargestErrorsRow | None, Meta(description="interval of time with the largest errors; null: no errors")
    ] = None


class LargestErrorsRow(Part, frozen=True, kw_only=True):
    """Interval of time that has the largest share of the squared prediction errors over the horizon.

    It is two horizons long, or shorter at the end of the record.
    """

    record: Annotated[str, Meta(description="name of the record")]
    begin: Annotated[float, Meta(description="begin of the interval, in seconds of the log")]
    end: Annotated[float, Meta(description="end of the interval, in seconds of the log")]
    share: Annotated[float, Meta(description="share of the squared errors, mean over all channels")]


class PredictionChangeRow(Part, frozen=True, kw_only=True):
    """Prediction change: change of the RMS prediction errors over the horizon by effects that were added to the model.

    The ratio is the geometric mean over all channels of RMS error after / before. The verdict is `fell` or `rose` if
    the 95 % interval excludes 1 and the change is more than half a per cent; otherwise, and without an interval,
    `unchanged`.
    """

    role: Annotated[Role, Meta(description="`estimation` or `validation`")]
    ratio: Annotated[float, Meta(description="error after / before; below 1 the error fell")]
    low: Annotated[float | None, Meta(description="95 % interval of `ratio`; null: the data are too short")] = None
    high: Annotated[float | None, Meta(description="upper end of the interval")] = None
    verdict: Annotated[Change, Meta(description="verdict on the change, by the interval")]
    better: Annotated[tuple[str, ...], Meta(description="channels whose error fell significantly")] = ()
    worse: Annotated[tuple[str, ...], Meta(description="channels whose error rose significantly")] = ()


class Errors(Part, frozen=True, kw_only=True):
    """RMS prediction errors on the estimation data and on the validation data."""

    estimation: Annotated[ErrorTable, Meta(description="on the estimation data")]
    validation: Annotated[ErrorTable | None, Meta(description="null: there were no validation data")] = None


class CalibrationRow(Part, frozen=True, kw_only=True):
    """Calibration of the prediction intervals of a channel: whether the errors are as large as the model predicts.

    The verdict is by the 95 % interval of `scale`: `overconfident` if all of it is above 1.1, `underconfident` if all
    of it is below 1 / 1.1, otherwise `right` (calibrated). With fewer than eight independent errors it is
    `insufficient_data` unless it is `overconfident`.
    """

    n: Annotated[int, Meta(description="number of errors")]
    n_effective: Annotated[float, Meta(description="effective sample size: number of independent errors")]
    n_records: Annotated[
        int, Meta(description="number of records (runs) with errors; 0: a result of an earlier version")
    ] = 0
    inside_50: Annotated[float, Meta(description="share of the errors inside the 50 % interval")]
    inside_95: Annotated[float, Meta(description="share of the errors inside the 95 % interval")]
    scale: Annotated[float | None, Meta(description="RMS of error / predicted standard deviation")]
    low: Annotated[float | None, Meta(description="95 % interval of `scale`")]
    high: Annotated[float | None, Meta(description="upper end of the interval")]
    pit: Annotated[Array, Meta(description="(10,) shares of the errors in each tenth of the predicted distribution")]
    widening: Annotated[
        float | None,
        Meta(
            description="factor by which 95 % intervals of a further run have to be wider than predicted, at least 1; "
            "the standard deviations of `traces`, over the horizon and in simulation, are multiplied by that of the "
            "validation data"
        ),
    ] = None
    verdict: Annotated[
        Verdict,
        Meta(
            description="`right`; beyond 10 % `overconfident` (errors are larger than predicted) or `underconfident`; "
            "`insufficient_data`"
        ),
    ]

    def __post_init__(self) -> None:
        """Raise ValueError unless ``pit`` has ten shares, one for each tenth of the predicted distribution."""
        if self.pit.shape != (10,):
            raise ValueError(f"pit must have ten shares, one for each tenth of the distribution, not {self.pit.shape}")


class CalibrationTable(Part, frozen=True, kw_only=True):
    """Calibration of the prediction intervals by channel for each kind of prediction.

    The kinds are one step ahead, over the horizon, and simulation.
    """

    one_step: Annotated[dict[str, CalibrationRow], Meta(description="one step ahead")]
    horizon: Annotated[dict[str, CalibrationRow], Meta(description="over `horizon_seconds`")]
    simulation: Annotated[dict[str, CalibrationRow], Meta(description="from the inputs alone")]


class Calibrations(Part, frozen=True, kw_only=True):
    """Calibration of the prediction intervals on the estimation data and on the validation data.

    In a diagnosis it is that of the model with the effects.
    """

    estimation: Annotated[CalibrationTable, Meta(description="on the estimation data")]
    validation: Annotated[CalibrationTable | None, Meta(description="null: there were no validation data")] = None


class ProfileCurve(Part, frozen=True, kw_only=True):
    """Profile likelihood of a parameter: log-likelihood over its value, with all other parameters fitted again."""

    name: Annotated[str, Meta(description="parameter; `V_x@0` is that of the first log")]
    unit: Annotated[str, Meta(description="unit of the values, SI and radians; empty: none")]
    value: Annotated[float, Meta(description="estimate")]
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
    high: Annotated[float | None, Meta(description="upper end of the interval; null: open on that side")] = None
    wald_low: Annotated[float | None, Meta(description="95 % interval by 1.96 standard errors")] = None
    wald_high: Annotated[float | None, Meta(description="upper end of that interval")] = None
    notes: Annotated[
        tuple[str, ...],
        Meta(
            description="remarks on a side that is open or ends at a bound, with the searched range; or on a better "
            "fit that the profile found and that `value` and the profile are then of"
        ),
    ] = ()

    def __post_init__(self) -> None:
        """Raise ValueError if the grid of the parameter and the drop of the log-likelihood differ in length."""
        same_length(self, "grid", "drop")


class Homogeneity(Part, frozen=True, kw_only=True):
    """Homogeneity test of a parameter: likelihood ratio of one value for all logs against one for each log.

    The logs agree if `p` is above 0.01.
    """

    name: Annotated[str, Meta(description="name of the parameter")]
    unit: Annotated[str, Meta(description="unit of the values, SI and radians; empty: none")]
    value: Annotated[float, Meta(description="one value for all logs")]
    se: Annotated[float | None, Meta(description="standard error of `value`; null: not informed by the data")]
    se_robust: Annotated[float | None, Meta(description="robust standard error (sandwich covariance)")]
    records: Annotated[tuple[str, ...], Meta(description="names of the logs, in the order of `values`")]
    values: Annotated[Array, Meta(description="value of each log")]
    ses: Annotated[Array, Meta(description="standard errors of `values`")]
    lr: Annotated[float, Meta(description="likelihood ratio")]
    df: Annotated[int, Meta(description="degrees of freedom of `lr`")]
    p: Annotated[float, Meta(description="p value of `lr`")]
    agree: Annotated[bool, Meta(description="verdict: the logs agree in one value")]
    scatter: Annotated[float | None, Meta(description="standard deviation between logs beyond their standard errors")]
    mean: Annotated[float | None, Meta(description="mean over the logs, weighted with that scatter")]
    se_mean: Annotated[float | None, Meta(description="standard error of `mean`")]
    low: Annotated[float | None, Meta(description="95 % interval of `mean`")]
    high: Annotated[float | None, Meta(description="upper end of the interval")]
    left_out: Annotated[
        tuple[str, ...], Meta(description="logs that do not inform the parameter; `df` does not count them")
    ] = ()


class FitResult(Result, frozen=True, kw_only=True):
    """Result of a fit of a vehicle or thruster model, or of a diagnosis: estimates, predictions and residuals."""

    @property
    def converged(self) -> bool:
        """Whether the fit converged. A diagnosis replaces this by the convergence of its two fits."""
        return self.fit.converged

    fit: Annotated[FitSummary, Meta(description="method, convergence and estimates")]
    failed_runs: Annotated[tuple[FailedRun, ...], Meta(description="validation runs that were left out")] = ()
    horizon_seconds: Annotated[
        float,
        Meta(description="prediction horizon (`--horizon`) [s]: 10 by default, 1 on the bench"),
    ]
    errors: Annotated[Errors, Meta(description="RMS prediction errors")]
    calibration: Annotated[Calibrations, Meta(description="calibration of the prediction intervals")]
    traces: Annotated[tuple[Trace, ...], Meta(description="one for each record and channel")]
    track: Annotated[tuple[Track, ...], Meta(description="one for each record with positions")]
    inputs: Annotated[tuple[InputTrace, ...], Meta(description="one for each record and input")]
    residuals: Annotated[tuple[ResidualTests, ...], Meta(description="one for each record and channel")]
    cross: Annotated[tuple[CrossCorrelationRow, ...], Meta(description="one for each record, channel and input")]
    unused_signals: Annotated[
        tuple[UnusedSignal, ...], Meta(description="signals of the logs that the model does not use, with the reason")
    ] = ()


class StaticForce(Part, frozen=True, kw_only=True):
    """Static thrust curve, force against shaft speed or command: measured points and the fitted curve.

    `force_sd` are the standard errors of `force_model`.
    """

    n: Annotated[Array, Meta(description="measured shaft speed or command, as a part of full")]
    force: Annotated[Array, Meta(description="[N]")]
    sd: Annotated[Array, Meta(description="standard errors of `force` [N]")]
    n_model: Annotated[Array, Meta(description="shaft speeds or commands of the fitted curve")]
    force_model: Annotated[Array, Meta(description="[N]")]
    force_sd: Annotated[Array, Meta(description="[N]")]
    force_quadratic: Annotated[Array | None, Meta(description="static curve: c1 n|n| + c2 n^2 [N]")] = None
    abscissa: Annotated[str, Meta(description="quantity of `n`")] = "shaft speed n"

    def __post_init__(self) -> None:
        """Raise ValueError if arrays of the measured points, or of the fitted curve, differ in length."""
        same_length(self, "n", "force", "sd")
        same_length(self, "n_model", "force_model", "force_sd", "force_quadratic")


class CommonErrorsRow(Part, frozen=True, kw_only=True):
    """Small errors that every craft has, which are estimated beside the effects: sensor timing, mounting, hull form."""

    names: Annotated[tuple[str, ...], Meta(description="names in the catalogue, in the order of their selection")]
    titles: Annotated[tuple[str, ...], Meta(description="titles for readers, in the same order")]
    gain: Annotated[
        float | None,
        Meta(description="2 d ln L of the estimation data by all of them; null: they were in the model that was given"),
    ]
    df: Annotated[int | None, Meta(description="number of their parameters; null as `gain`")]
    validation_gain: Annotated[float | None, Meta(description="d ln L of the validation data; null as `gain`")]
    t: Annotated[float | None, Meta(description="t statistic of `validation_gain` over blocks; null as `gain`")]
    prediction: Annotated[
        PredictionChangeRow | None,
        Meta(
            description="change of the prediction errors by them alone; null: as `gain`, or no channel can be compared"
        ),
    ]
    parameters: Annotated[tuple[EffectParameter, ...], Meta(description="their estimates in the last model")]


class SteadyCurve(Part, frozen=True, kw_only=True):
    """Steady motion of the boat in still water over a constant command, from the model, within the fitted commands.

    Where the model has no stable steady motion, the value is null.
    """

    motion: Annotated[
        Literal["straight", "turn"],
        Meta(
            description="`straight`: the yaw rate is zero, which a difference of both sides holds; without two sides "
            "it is assumed; `turn`"
        ),
    ]
    quantity: Annotated[str, Meta(description="`u` or `r`")]
    unit: Annotated[str, Meta(description="unit of `value`, SI and radians")]
    inputs: Annotated[tuple[str, ...], Meta(description="names of the inputs that have the command")]
    mean: Annotated[
        float,
        Meta(description="turn: mean of both sides; the left side has mean + command, the right side mean - command"),
    ] = 0.0
    command: Annotated[
        Array,
        Meta(
            description="command, in the unit of the inputs; `straight`: mean of both sides; `turn`: half the "
            "difference of left and right"
        ),
    ]
    value: Annotated[Array, Meta(description="steady value")]
    sd: Annotated[Array, Meta(description="standard error of `value`; null: unknown")]
    difference: Annotated[
        Array | None,
        Meta(
            description="straight: half the difference of both sides that holds the course; the left side has command "
            "+ difference, the right side command - difference; null: no two sides, or result of an earlier version"
        ),
    ] = None
    growth: Annotated[
        Array | None,
        Meta(
            description="straight: largest real part of the poles at constant inputs [1/s]; positive: the boat leaves "
            "the course without a controller; null: no two sides, or result of an earlier version"
        ),
    ] = None

    def __post_init__(self) -> None:
        """Raise ValueError if the arrays of the curve differ in length."""
        same_length(self, "command", "value", "sd", "difference", "growth")

    @property
    def sides(self) -> tuple[Array, Array]:
        """Inputs of the left and of the right side at each command, in the unit of the inputs."""
        if self.motion == "turn":
            return self.mean + self.command, self.mean - self.command
        half = np.zeros(self.command.size) if self.difference is None else self.difference
        return self.command + half, self.command - half

    @property
    def unstable(self) -> NDArray[np.bool_]:
        """Whether the boat leaves the straight course at each command without a controller."""
        return np.zeros(self.command.size, np.bool_) if self.growth is None else self.growth > UNSTABLE

    @property
    def unequal(self) -> int | None:
        """Index of the command at which the sides that hold the course differ most; None if they hardly differ.

        A difference counts from 2 % of the largest command.
        """
        if self.difference is None or not np.isfinite(self.difference).any():
            return None
        k = int(np.nanargmax(np.abs(self.difference)))
        return k if 2.0 * abs(self.difference[k]) > UNEQUAL * float(np.abs(self.command).max()) else None


class OperatingPoint(Part, frozen=True, kw_only=True):
    """Linearisation of the model about straight motion at a speed: its inputs and its poles."""

    speed: Annotated[float, Meta(description="forward speed [m/s]")]
    inputs: Annotated[dict[str, float], Meta(description="inputs that keep the speed, by name")]
    real: Annotated[
        Array,
        Meta(
            description="real parts of the poles [1/s]: those of the boat, of its thrusters and of other states, the "
            "slowest of each first"
        ),
    ]
    imaginary: Annotated[Array, Meta(description="imaginary parts of the poles [rad/s]")]
    stable: Annotated[bool, Meta(description="whether all real parts are negative")]
    error: Annotated[
        Array | None,
        Meta(description="standard errors of the real parts [1/s], NaN if unknown; null: result of an earlier version"),
    ] = None
    states: Annotated[
        dict[str, float], Meta(description="states of the operating point by name; empty: result of an earlier version")
    ] = msgspec.field(default_factory=dict)
    mainly: Annotated[
        tuple[str, ...],
        Meta(
            description="states that take most part in each pole, such as `r, v`; empty: result of an earlier version"
        ),
    ] = ()


class StepResponse(Part, frozen=True, kw_only=True):
    """Response of the linear model to a step of the command at time zero, with the dead time of the command."""

    speed: Annotated[float, Meta(description="speed of the operating point [m/s]")]
    motion: Annotated[
        Literal["straight", "turn"],
        Meta(description="`straight`: both sides step up; `turn`: the left side steps up and the right side down"),
    ]
    step: Annotated[float, Meta(description="size of the step, in the unit of the inputs")]
    quantity: Annotated[str, Meta(description="name of the state")]
    unit: Annotated[str, Meta(description="unit of `value`, SI and radians")]
    t: Annotated[Array, Meta(description="[s]")]
    value: Annotated[Array, Meta(description="change of the state since the step")]
    sd: Annotated[Array | None, Meta(description="standard error of `value`; null: unknown")] = None

    def __post_init__(self) -> None:
        """Raise ValueError if the arrays of the response differ in length."""
        same_length(self, "t", "value", "sd")


class FrequencyResponse(Part, frozen=True, kw_only=True):
    """Frequency response of the linear model to the command, with the dead time of the command."""

    speed: Annotated[float, Meta(description="speed of the operating point [m/s]")]
    motion: Annotated[
        Literal["straight", "turn"],
        Meta(description="`straight`: command of both sides; `turn`: half the difference of left and right side"),
    ]
    quantity: Annotated[str, Meta(description="name of the state")]
    unit: Annotated[str, Meta(description="unit of `gain`, SI and radians: of the state per unit of the command")]
    stable: Annotated[bool, Meta(description="whether the linear model is stable")]
    frequency: Annotated[Array, Meta(description="[Hz]")]
    gain: Annotated[Array, Meta(description="amplitude of the state over that of the command")]
    gain_sd: Annotated[Array, Meta(description="standard error of the natural logarithm of `gain`; null: unknown")]
    phase: Annotated[Array, Meta(description="phase of the state to the command, without jumps of a full turn [rad]")]
    phase_sd: Annotated[Array, Meta(description="standard error of `phase` [rad]; null: unknown")]
    bandwidth: Annotated[
        float | None,
        Meta(description="frequency at which the gain is 3 dB below that of slow commands [Hz]; null: unknown"),
    ] = None
    bandwidth_sd: Annotated[float | None, Meta(description="standard error of `bandwidth` [Hz]; null: unknown")] = None
    lag_90: Annotated[
        float | None,
        Meta(
            description="frequency at which the state lags 90 deg behind the command [Hz], of an unstable model beyond "
            "the unstable pole; null: none"
        ),
    ] = None
    lag_90_sd: Annotated[float | None, Meta(description="standard error of `lag_90` [Hz]; null: unknown")] = None

    def __post_init__(self) -> None:
        """Raise ValueError if the arrays of the response differ in length."""
        same_length(self, "frequency", "gain", "gain_sd", "phase", "phase_sd")


class CourseStability(Part, frozen=True, kw_only=True):
    """Least stable pole of sway and yaw, at a speed in the data: whether the boat holds a straight course."""

    speed: Annotated[float, Meta(description="speed of the linear model [m/s]")]
    share: Annotated[
        float | None,
        Meta(
            description="`speed` as a part of the highest speed ahead in the estimation data (99 % quantile); null: "
            "the speed of the least stable linear model, or a result of an earlier version"
        ),
    ] = None
    heading: Annotated[
        float | None,
        Meta(
            description="heading on which this pole is the least stable one [rad]; null: the model does not depend on "
            "the heading, or a result of an earlier version"
        ),
    ] = None
    pole: Annotated[float, Meta(description="real part of the pole [1/s]; above zero: directionally unstable")]
    low: Annotated[float | None, Meta(description="lower end of the 95 % interval of `pole` [1/s]; null: unknown")]
    high: Annotated[float | None, Meta(description="upper end of the 95 % interval of `pole` [1/s]; null: unknown")]
    sway: Annotated[
        float | None,
        Meta(
            description="derivative of the rate of sway by the sway speed [1/s]; above zero: the damping of sway is "
            "negative, which no hull has; null: no sway"
        ),
    ] = None
    sway_from: Annotated[
        float | None,
        Meta(
            description="lowest speed in the data at which the damping of sway without drift is negative [m/s]; null: "
            "it is at none"
        ),
    ] = None

    @property
    def unstable(self) -> bool:
        """Whether the estimate is unstable."""
        return self.pole > 0.0

    @property
    def stability(self) -> str:
        """What the data show: ``stable``, ``unstable``, or ``not shown by the data`` (the interval contains zero)."""
        low, high = (math.nan if end is None else end for end in (self.low, self.high))
        return stability_of(self.pole, low, high)


class HeadingPoint(Part, frozen=True, kw_only=True):
    """Inputs of a straight course on one heading, for a model that depends on the heading, as in wind."""

    heading: Annotated[float, Meta(description="heading [rad]")]
    speed: Annotated[float, Meta(description="forward speed [m/s]")]
    inputs: Annotated[dict[str, float], Meta(description="inputs that keep speed and heading, by name")]


class Dynamics(Part, frozen=True, kw_only=True):
    """Steady motion, poles, step responses and frequency responses of a fitted model in still water."""

    steady: Annotated[tuple[SteadyCurve, ...], Meta(description="steady speed and turn rate over the command")] = ()
    points: Annotated[tuple[OperatingPoint, ...], Meta(description="linear models, at several speeds")] = ()
    steps: Annotated[tuple[StepResponse, ...], Meta(description="step responses at one speed")] = ()
    responses: Annotated[tuple[FrequencyResponse, ...], Meta(description="frequency responses at this speed")] = ()
    delays: Annotated[dict[str, float], Meta(description="dead time of each input that has one [s]")] = msgspec.field(
        default_factory=dict
    )
    conditions: Annotated[
        dict[str, float],
        Meta(description="conditions taken as constant: time `t` [s], `work`, place `x`, `y` [m], heading `psi` [rad]"),
    ] = msgspec.field(default_factory=dict)
    speeds: Annotated[
        tuple[float, float] | None,
        Meta(description="1 % and 99 % quantile of the forward speed in the data of the fit [m/s]; null: unknown"),
    ] = None
    ranges: Annotated[
        dict[str, tuple[float, float]],
        Meta(description="range in the fitted data by name: of velocities 1 % and 99 % quantile, of inputs all values"),
    ] = msgspec.field(default_factory=dict)
    course: Annotated[
        CourseStability | None, Meta(description="stability of a straight course; null: no pole of sway and yaw")
    ] = None
    headings: Annotated[
        tuple[HeadingPoint, ...],
        Meta(description="straight course on eight headings; empty: the model does not depend on the heading"),
    ] = ()


class VehicleResult(FitResult, frozen=True, kw_only=True, tag_field="kind", tag="vehicle"):
    """Result of `seatrial ident vehicle`: the fit of a model of a vehicle."""

    prediction: Annotated[
        PredictionFit | None, Meta(description="null: no prediction over the horizon was possible")
    ] = None
    profiles: Annotated[tuple[ProfileCurve, ...], Meta(description="with `--profile`: one for each parameter")] = ()
    homogeneity: Annotated[
        tuple[Homogeneity, ...], Meta(description="with `--test-homogeneity`: one for each parameter")
    ] = ()
    common_errors: Annotated[
        CommonErrorsRow | None,
        Meta(description="small errors that every craft has, estimated together with the model; null: not added"),
    ] = None
    dynamics: Annotated[
        Dynamics | None, Meta(description="null: the model has no speed or turn rate, or the fit did not converge")
    ] = None
    effect_parameters: Annotated[
        tuple[str, ...], Meta(description="with `--effect`: names of the parameters of these effects, as in `fit`")
    ] = ()


class SteadyBench(Part, frozen=True, kw_only=True):
    """Steady-state table of the bench logs: means over the second half of each command that was held for 1.6 s.

    The means are over at least 0.6 s. A quantity that was not measured is null in every row. `steady.csv` has the same
    rows.
    """

    log: Annotated[tuple[str, ...], Meta(description="name of the log of each row")]
    command: Annotated[Array, Meta(description="command, as a part of full")]
    n: Annotated[Array, Meta(description="shaft speed, as a part of full")]
    force: Annotated[Array, Meta(description="force without the offset of the load cell [N]")]
    force_se: Annotated[Array, Meta(description="standard error of `force` [N]")]
    voltage: Annotated[Array, Meta(description="voltage of the supply [V]")]
    current: Annotated[Array, Meta(description="current of the supply [A]")]
    power: Annotated[Array, Meta(description="electrical power [W]")]
    torque: Annotated[Array, Meta(description="torque of the shaft [N m]")]
    power_formula: Annotated[str, Meta(description="formula of `power` in words; empty: not measured")] = ""
    rpm_max: Annotated[float | None, Meta(description="full shaft speed [rev/min]; null: unknown")] = None
    expo: Annotated[float | None, Meta(description="ArduPilot's MOT_THST_EXPO; null: too few forward commands")] = None
    offset: Annotated[
        Array | None,
        Meta(
            description="fitted offset of the load cell in the log of each row [N]: `force` is the measured mean less "
            "this offset; null: no load cell, or a result of an earlier version"
        ),
    ] = None

    def __post_init__(self) -> None:
        """Raise ValueError if the columns of the table differ in length."""
        same_length(self, "command", "n", "force", "force_se", "voltage", "current", "power", "torque", "offset")


class ShaftResponse(Part, frozen=True, kw_only=True):
    """Frequency response of the shaft speed to its command: that of the model, and the measured one."""

    frequency: Annotated[Array, Meta(description="frequencies of the model's response [Hz]")]
    gain: Annotated[Array, Meta(description="gain of the model")]
    phase: Annotated[Array, Meta(description="phase of the model, with its dead time [rad]")]
    frequency_measured: Annotated[Array, Meta(description="frequencies at which the data determine it [Hz]")]
    gain_measured: Annotated[Array, Meta(description="measured gain")]
    phase_measured: Annotated[Array, Meta(description="measured phase [rad]")]

    def __post_init__(self) -> None:
        """Raise ValueError if the arrays of the model's or of the measured response differ in length."""
        same_length(self, "frequency", "gain", "phase")
        same_length(self, "frequency_measured", "gain_measured", "phase_measured")


class ThrusterResult(FitResult, frozen=True, kw_only=True, tag_field="kind", tag="thruster"):
    """Result of `seatrial ident thruster` for logs with a measured shaft speed: the fit of a thruster model."""

    static: Annotated[StaticForce | None, Meta(description="null: there was no load cell")] = None
    steady: Annotated[SteadyBench | None, Meta(description="null: no command was held for 1.6 s")] = None
    shaft_response: Annotated[ShaftResponse | None, Meta(description="null: only in files of older versions")] = None
    profiles: Annotated[tuple[ProfileCurve, ...], Meta(description="with `--profile`: one for each parameter")] = ()


class ThrustCurveResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="thrust_curve"):
    """Result of `seatrial ident thruster` for logs without a shaft speed: a static thrust curve."""

    static: Annotated[StaticForce, Meta(description="measured points and fitted curve")]


class Candidate(Part, frozen=True, kw_only=True):
    """Candidate in a round of the search for missing effects: a possible effect, or a nonparametric curve.

    Its score test shows, without a refit, whether the likelihood would rise with the candidate in the model.
    """

    name: Annotated[str, Meta(description="name of the candidate")]
    title: Annotated[str, Meta(description="title for readers")]
    lm: Annotated[float, Meta(description="score test statistic")]
    df: Annotated[int, Meta(description="degrees of freedom")]
    p: Annotated[float, Meta(description="p value of `lm`")]
    p_block: Annotated[float | None, Meta(description="block-robust p value")]
    generic: Annotated[bool, Meta(description="nonparametric curve, not an effect of the catalogue")]
    threshold: Annotated[float, Meta(description="threshold of `lm`, corrected for the number of tests")]
    passed: Annotated[bool, Meta(description="whether the candidate passed the score test")]


class DetectableSize(Part, frozen=True, kw_only=True):
    """Smallest size of one parameter of an effect that the score test finds with a probability of 80 %."""

    name: Annotated[str, Meta(description="name of the parameter")]
    meaning: Annotated[str, Meta(description="meaning of the parameter")]
    unit: Annotated[str, Meta(description="unit")]
    size: Annotated[float, Meta(description="smallest size, with the other parameters of the effect at zero")]


class DetectableEffect(Part, frozen=True, kw_only=True):
    """Catalogue effect that the last model lacks, with the smallest size that the data would have shown."""

    name: Annotated[str, Meta(description="name of the effect")]
    title: Annotated[str, Meta(description="title for readers")]
    sizes: Annotated[
        tuple[DetectableSize, ...],
        Meta(description="one for each parameter; empty if the estimated parameters explain the effect at any size"),
    ]


class RefitRow(Part, frozen=True, kw_only=True):
    """Refit in a round of the search: the model with one more effect, all parameters estimated again.

    The n of the criterion is the number of rows (instants) of the estimation records.
    """

    name: Annotated[str, Meta(description="name of the added effect")]
    title: Annotated[str, Meta(description="title for readers")]
    gain: Annotated[float, Meta(description="2 d ln L")]
    df: Annotated[int, Meta(description="number of added parameters")]
    criterion: Annotated[float, Meta(description="gain - df ln n")]
    validation_gain: Annotated[float, Meta(description="d ln L on the validation data")]
    t: Annotated[float, Meta(description="t statistic of `validation_gain` over blocks")]
    prediction: Annotated[
        PredictionChangeRow | None, Meta(description="null: the refit was rejected before its prediction was compared")
    ] = None
    outcome: Annotated[
        RefitOutcome,
        Meta(
            description="`added`; `outranked`: acceptable, but another candidate explains more; `small`: negligible "
            "compared with the effects already found; `not-supported` by the estimation data; `not-validated` by the "
            "validation data; `worse-prediction`; `no-better-prediction`: of a nonparametric effect"
        ),
    ]
    parameters: Annotated[
        tuple[EffectParameter, ...], Meta(description="estimates of the parameters of the added effect")
    ]


class UntestedCandidateRow(Part, frozen=True, kw_only=True):
    """Candidate of a round of the search that passed the score test, but whose refit failed."""

    name: Annotated[str, Meta(description="name of the candidate")]
    title: Annotated[str, Meta(description="title for readers")]
    reason: Annotated[str, Meta(description="reason in words why no fit succeeded")]


class RemovedEffectRow(Part, frozen=True, kw_only=True):
    """Effect that the search added and that backward elimination removed again.

    For example, the validation data do not support it with the other effects in the model, or the prediction is as good
    without it.
    """

    name: Annotated[str, Meta(description="name of the effect")]
    title: Annotated[str, Meta(description="title for readers")]
    validation_gain: Annotated[
        float, Meta(description="d ln L on the validation data with the effect against without it")
    ]
    t: Annotated[float, Meta(description="t statistic of `validation_gain` over blocks")]
    prediction: Annotated[
        PredictionChangeRow | None,
        Meta(description="change of the prediction errors by adding the effect; null: no channel can be compared"),
    ]


class ValidationMismatchRow(Part, frozen=True, kw_only=True):
    """Validation run whose one-step prediction errors are larger than the model predicts.

    The keys from `parameter` on are empty or null if no change of a parameter explains the errors.
    """

    record: Annotated[str, Meta(description="name of the validation run")]
    channel: Annotated[str, Meta(description="channel with the largest `scale`")]
    scale: Annotated[float, Meta(description="RMS of one-step error / predicted standard deviation")]
    parameter: Annotated[str | None, Meta(description="parameter whose change would explain the run best")] = None
    unit: Annotated[str, Meta(description="unit of the parameter")] = ""
    fitted: Annotated[float | None, Meta(description="value from the estimation runs")] = None
    value: Annotated[float | None, Meta(description="value from this run alone")] = None
    se: Annotated[float | None, Meta(description="standard error of `value`; null: unknown")] = None


class RoundRow(Part, frozen=True, kw_only=True):
    """Round of the search for missing effects.

    The candidates have a score test, the model is refitted with the best that passed, and at most one effect is added.
    The best candidate has the largest statistic per degree of freedom. All that passed are listed, also beyond the best
    24.
    """

    tested: Annotated[int, Meta(description="number of candidates")] = 0
    passed: Annotated[int, Meta(description="number of candidates that passed the score test")] = 0
    candidates: Annotated[tuple[Candidate, ...], Meta(description="the best 24, best first")] = ()
    refits: Annotated[
        tuple[RefitRow, ...], Meta(description="refits of the best candidates, the largest criterion first")
    ] = ()
    untested: Annotated[
        tuple[UntestedCandidateRow, ...], Meta(description="candidates that passed and could not be fitted")
    ] = ()
    chosen: Annotated[str | None, Meta(description="name of the added effect")] = None
    why: Annotated[str, Meta(description="reason for the choice, or for the end of the search")]


class Alternative(Part, frozen=True, kw_only=True):
    """Competing model of an added effect: another refit of the round that added the effect."""

    name: Annotated[str, Meta(description="name of the competing effect")]
    title: Annotated[str, Meta(description="title for readers")]
    criterion_behind: Annotated[float, Meta(description="criterion of the chosen effect less that of this one")]
    why_not: Annotated[
        str,
        Meta(description="why it was not chosen although its criterion is larger; empty: it is not, or an older file"),
    ] = ""


class EffectRow(Part, frozen=True, kw_only=True):
    """Effect that the search added to the model and did not remove again."""

    name: Annotated[str, Meta(description="name of the effect")]
    title: Annotated[str, Meta(description="title for readers")]
    formula: Annotated[str, Meta(description="formula")]
    source: Annotated[str, Meta(description="literature")]
    place: Annotated[str, Meta(description="part of the model that the effect acts on")]
    experiment: Annotated[str, Meta(description="experiment that shows the effect")]
    causes: Annotated[str, Meta(description="what to look for on the craft and around it")] = ""
    alternatives: Annotated[tuple[Alternative, ...], Meta(description="competing models")]
    attribution: Annotated[
        Literal["identified", "ambiguous", "nonparametric"],
        Meta(
            description="`identified`: the effect explains what was missing, and no competing model does; `ambiguous`: "
            "the missing effect resembles this one; `nonparametric`: a curve, no known effect"
        ),
    ]
    reasons: Annotated[tuple[str, ...], Meta(description="reasons for the attribution `ambiguous`")]
    probability: Annotated[
        float | None,
        Meta(
            description="share of the names with this attribution that were right on simulated boats with known "
            "effects; it is no probability for this boat; null for curves and thruster models"
        ),
    ] = None
    not_excluded: Annotated[tuple[str, ...], Meta(description="names of effects that may be the true one instead")]
    parameters: Annotated[
        tuple[EffectParameter, ...], Meta(description="estimates of its parameters in the last model")
    ]
    in_words: Annotated[
        str | None, Meta(description="the estimates as a clause; null: the parameters need no explanation")
    ] = None
    prediction: Annotated[
        PredictionChangeRow | None,
        Meta(
            description="effect importance: change of the prediction errors over the horizon if this effect is added "
            "to the others; null: no comparison was possible"
        ),
    ] = None
    error_ratio_without: Annotated[
        float | None,
        Meta(
            description="prediction error 3 s ahead (on the bench 1.2 s) without the effect / with it, by the inputs "
            "alone; geometric mean over the channels of the validation data. The effects are sorted by this ratio"
        ),
    ]
    gain_last: Annotated[float | None, Meta(description="2 d ln L on the estimation data if the effect is added last")]


class RemainingCandidate(Part, frozen=True, kw_only=True):
    """Candidate that still passes the score test after the last effect was added."""

    name: Annotated[str, Meta(description="name of the candidate")]
    lm: Annotated[float, Meta(description="score test statistic")]
    df: Annotated[int, Meta(description="degrees of freedom")]
    p: Annotated[float, Meta(description="p value of `lm`")]


class NonparametricCurve(Part, frozen=True, kw_only=True):
    """Nonparametric effect: a force or sensor error as a curve over one variable, estimated from the data."""

    force: Annotated[str, Meta(description="force, relative change of thrust (`T`, `T_left`), or sensor")]
    sensor_error: Annotated[bool, Meta(description="true: the curve is the error of this sensor, not a force")]
    variable: Annotated[str, Meta(description="name of the variable")]
    unit: Annotated[str, Meta(description="unit of `value`, `sd` and `band`")]
    variable_unit: Annotated[str, Meta(description="unit of `grid`")]
    grid: Annotated[Array, Meta(description="values of the variable")]
    value: Annotated[Array, Meta(description="estimated curve at `grid`")]
    sd: Annotated[Array, Meta(description="standard deviation of `value`")]
    band: Annotated[
        Array, Meta(description="half width of the band that contains the whole curve with 95 % probability")
    ]

    def __post_init__(self) -> None:
        """Raise ValueError if the arrays of the curve over its variable differ in length."""
        same_length(self, "grid", "value", "sd", "band")


class ResidualForce(Part, frozen=True, kw_only=True):
    """Disturbance force in a record over time: smoothed estimate of a force that the model does not explain.

    Times count from the start of the log.
    """

    record: Annotated[str, Meta(description="name of the record")]
    force: Annotated[str, Meta(description="`X`, `Y`, `N`; on the bench `F` [N] and `n_dot` [1/s]")]
    unit: Annotated[str, Meta(description="unit of the values, SI and radians; empty: none")]
    t: Annotated[Array, Meta(description="[s]")]
    mean: Annotated[Array, Meta(description="smoothed estimate, in a diagnosis without the effects")]
    sd: Annotated[Array, Meta(description="standard deviation of `mean`")]
    after_mean: Annotated[Array | None, Meta(description="with the effects")] = None
    after_sd: Annotated[Array | None, Meta(description="standard deviation of `after_mean`")] = None

    def __post_init__(self) -> None:
        """Raise ValueError if the arrays of the force over time differ in length."""
        same_length(self, "t", "mean", "sd", "after_mean", "after_sd")


class ParameterChange(Part, frozen=True, kw_only=True):
    """Estimate of a parameter without and with the effects that a diagnosis added."""

    name: Annotated[str, Meta(description="name of the parameter")]
    unit: Annotated[str, Meta(description="unit of the values, SI and radians; empty: none")]
    before: Annotated[float, Meta(description="estimate without the effects")]
    before_se: Annotated[float | None, Meta(description="its standard error; null: not informed by the data")]
    after: Annotated[float, Meta(description="estimate with the effects")]
    after_se: Annotated[float | None, Meta(description="its standard error; null: not informed by the data")]


class DiagnosisResult(FitResult, frozen=True, kw_only=True, tag_field="kind", tag="diagnosis"):
    """Result of `seatrial ident diagnose`: effects that a model lacks.

    `fit` and `calibration` are those of the model with the added effects.
    """

    @property
    def errors_caveat(self) -> str:
        """Sentences on how the prediction errors are computed, and on the command that gives comparable ones.

        If the diagnosis added common errors, but no effect, the first sentences say that this is the difference of the
        errors before and after.
        """
        if self.cross_validated:
            how = "each block of time of the estimation logs is predicted by a fit to the others"
        elif self.validated_in_blocks:
            how = "each block of time of a validation log is predicted with estimates from the others"
        else:
            how = "the model is fitted again by plain maximum likelihood"
        return (
            f"{self._common_errors_alone}Not comparable with errors of `ident vehicle` and `ident compare`: "
            f"{how}. Comparable errors of both models: `seatrial ident compare MODEL DIAGNOSIS --on LOG`."
        )

    @property
    def _common_errors_alone(self) -> str:
        """Sentences on errors before and after that differ by added common errors alone, with a space; often empty."""
        common = self.common_errors
        if self.effects or common is None or common.gain is None:
            return ""
        found = common.prediction
        result = {
            "fell": " The prediction over the horizon is better with them.",
            "rose": " The prediction over the horizon is worse with them.",
            "unchanged": " The prediction over the horizon is not significantly better or worse with them: compare "
            "both models before you choose one.",
        }.get("" if found is None else found.verdict, "")
        return (
            "No effect was added: the errors differ because the small errors that every craft has (common errors) "
            f"were added to the model.{result} "
        )

    @property
    def converged(self) -> bool:
        """Whether the fit without the added effects and the fit with them both converged."""
        return self.fit.converged and self.converged_before

    caveat: Annotated[
        str | None,
        Meta(description="why a name in the answer is uncertain, and whether --max-effects ended the search"),
    ] = None
    converged_before: Annotated[bool, Meta(description="whether the fit without the effects converged")]
    prediction: Annotated[PredictionChangeRow | None, Meta(description="null: no effect was added")] = None
    cross_validated: Annotated[
        bool,
        Meta(
            description="blocked cross-validation: blocks of the estimation runs, each predicted by a fit to the others"
        ),
    ] = False
    validated_in_blocks: Annotated[
        bool,
        Meta(
            description="the validation runs are predicted in blocks of time, each with the estimates from the other "
            "blocks of its run, because an added effect has separate parameters for each run"
        ),
    ] = False
    mismatches: Annotated[
        tuple[ValidationMismatchRow, ...],
        Meta(description="validation runs whose errors are larger than the model predicts"),
    ] = ()
    rounds: Annotated[tuple[RoundRow, ...], Meta(description="rounds of the search, in their order")]
    excluded_effects: Annotated[
        tuple[str, ...], Meta(description="names of the effects that --exclude left out of the search")
    ] = ()
    removed_effects: Annotated[
        tuple[RemovedEffectRow, ...], Meta(description="effects that were added and removed again")
    ] = ()
    common_errors: Annotated[
        CommonErrorsRow | None,
        Meta(description="small errors that every craft has, estimated beside the effects; null: they were not added"),
    ] = None
    effects: Annotated[tuple[EffectRow, ...], Meta(description="added effects, the most important first")] = ()
    remaining_candidates: Annotated[
        tuple[RemainingCandidate, ...], Meta(description="candidates that still pass the score test, best first")
    ] = ()
    detectable: Annotated[
        tuple[DetectableEffect, ...],
        Meta(
            description="catalogue effects that the last model lacks: the smallest sizes that these data would have "
            "shown with a probability of 80 %, by the information of the score tests; a slow effect has to be up to "
            "twice as large, because the disturbance forces explain a part of it"
        ),
    ] = ()
    nonparametric_effects: Annotated[
        tuple[NonparametricCurve, ...],
        Meta(description="nonparametric effects, and the curve that the first ambiguous effect approximates"),
    ] = ()
    residual_forces: Annotated[tuple[ResidualForce, ...], Meta(description="one for each record and force")] = ()
    environment_parameters: Annotated[
        tuple[str, ...],
        Meta(description="shared free parameters of environment effects (waves) of the given model, as in `fit`"),
    ] = ()
    parameters_before_after: Annotated[
        tuple[ParameterChange, ...], Meta(description="shared free parameters of the model without effects")
    ] = ()
    dynamics: Annotated[
        Dynamics | None,
        Meta(description="of the model with the effects; null: no vehicle, or a fit did not converge"),
    ] = None
    recommended_experiment: Annotated[
        str | None,
        Meta(description="experiment that would distinguish the competing models; null: as `no_experiment` says"),
    ] = None
    no_experiment: Annotated[
        str,
        Meta(description="why no experiment is recommended; empty: there is one, or a result of an earlier version"),
    ] = ""

    @property
    def next_experiment(self) -> str:
        """Recommended experiment, or a sentence that none is recommended with the reason; empty if neither is known."""
        if self.recommended_experiment or not self.no_experiment:
            return self.recommended_experiment or ""
        return f"No experiment is recommended: {self.no_experiment}."
