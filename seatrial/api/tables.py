"""Tables of estimates as text, rows and data frames."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from seatrial.api.arguments import Role
from seatrial.api.messages import in_python, with_texts_in_python
from seatrial.api.shown import Content
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import import_library

if TYPE_CHECKING:
    from seatrial.ident.results import ComparedModel, FitResult, ParameterRow, Result, WhitenessTests

NORMAL_95 = 1.959964  # standard deviations of a normal distribution on each side of its 95 % interval
WIDTH = 100  # columns of a summary
LEVEL = 0.01  # significance level of the residual tests
STATISTICS = {  # name of the statistic of each test of the residuals
    "ljung-box": "largest autocorrelation",
    "periodogram": "largest distance of the cumulative periodogram",
    "normality": "largest residual [standard deviations]",
    "cross-correlation": "largest correlation coefficient",
}
COLUMNS = ("", "estimate", "s.e.", "2.5 %", "97.5 %", "t", "unit", "origin")


class Statistics(NamedTuple):
    """Estimate of one parameter with its uncertainty, as a row of the tables of a fit.

    Attributes
    ----------
    name : str
        Name; ``NAME@RECORD`` if the parameter has its own value in each record of a fit to several records.
    value, se : float
        Estimate, or value of a fixed parameter, and standard error (NaN if there is none).
    low, high : float
        Ends of the 95 % interval; NaN without a standard error. That of a quantity that cannot be negative ends at 0.
    t : float
        Value divided by the standard error; NaN if the standard error is missing or zero.
    unit : str
        Unit of value, standard error and interval.
    origin : str
        Origin of the value, for example ``estimated`` or ``built-in``; ``estimated, at bound`` if the search ended at a
        bound.
    free : bool
        Whether the parameter was estimated; otherwise it was fixed.
    flag : str
        Problem of the estimate in words, for example that it is at a bound; empty without one.
    meaning : str
        Meaning of the parameter in words.
    """

    name: str
    value: float
    se: float
    low: float
    high: float
    t: float
    unit: str
    origin: str
    free: bool
    flag: str
    meaning: str


class ResidualTest(NamedTuple):
    """Test of the residuals of one channel in a record, as a row of the table of residual tests.

    Attributes
    ----------
    record, channel : str
        Names of the record and of the measured channel.
    test : str
        ``ljung-box``, ``periodogram``, ``normality`` or ``cross-correlation``.
    input : str
        Input of a cross-correlation; empty for the other tests.
    statistic : float
        Largest deviation that the test found, without unit. Of ``ljung-box`` it is an autocorrelation, of
        ``cross-correlation`` a correlation coefficient. Of ``periodogram`` it is a distance of the cumulative
        periodogram, 0 to 1, from that of white noise. Of ``normality`` it is a residual in standard deviations.
    statistic_is : str
        Name of the statistic of this test, such as ``largest autocorrelation``.
    p : float
        p value of the test; NaN if it could not be computed.
    lag : float
        Lag [s] of the largest correlation; NaN for ``periodogram`` and ``normality``.
    frequency : float
        Frequency [Hz] of the largest distance of the periodogram; NaN for the other tests.
    limit : float
        Level of the test: it fails if p is not above it. Of ``cross-correlation`` it is 0.01 divided by the number of
        correlations of the result that could be computed.
    verdict : str
        Verdict in words, such as ``not white``.
    """

    record: str
    channel: str
    test: str
    input: str
    statistic: float
    statistic_is: str
    p: float
    lag: float
    frequency: float
    limit: float
    verdict: str


class ErrorRow(NamedTuple):
    """RMS prediction error of one channel for one kind of prediction, as a row of the table of errors.

    Attributes
    ----------
    role : str
        ``estimation`` or ``validation``: the data whose samples are predicted.
    kind : str
        ``one_step``, ``horizon`` or ``simulation``.
    seconds : float
        Horizon [s]; NaN for the other kinds.
    channel, unit : str
        Name of the channel, and unit of ``before`` and ``after``.
    before : float
        Error of the model without the effects that a diagnosis added; NaN for a fit.
    after : float
        Error of the model; of a diagnosis, of that with the effects. NaN: the prediction diverged.
    low, high : float
        Ends of the 95 % interval of after / before; NaN without an interval.
    verdict : str
        ``fell``, ``rose`` or ``unchanged``; empty without a comparison.
    """

    role: str
    kind: str
    seconds: float
    channel: str
    unit: str
    before: float
    after: float
    low: float
    high: float
    verdict: str


def full_name(row: ParameterRow) -> str:
    """Return the name of a parameter in the table of a result; ``NAME@RECORD`` if it belongs to one record only."""
    return row.name if row.record is None else f"{row.name}@{row.record}"


def statistics(row: ParameterRow) -> Statistics:
    """Return estimate, standard error, 95 % interval and t statistic of a parameter in the table of a result.

    Standard error, interval and t statistic are NaN if the result has no standard error, as for a fixed parameter or
    one at a bound. The interval is that of a normal distribution. That of a quantity that cannot be negative ends at
    zero.
    """
    se = row.se if row.se is not None else math.nan
    low, high = row.interval(NORMAL_95) or (math.nan, math.nan)
    return Statistics(
        full_name(row), row.value, se, low, high, row.value / se if se > 0 else math.nan,
        row.unit, row.origin_in_table, row.free, in_python(row.flag or ""), row.meaning,
    )  # fmt: skip


def conclusion(result: Result) -> str:
    """Return the main conclusion of a result, followed by its caveat, which only a diagnosis may have, in paragraphs.

    Commands and their options are replaced by functions and arguments of the Python interface. A last sentence explains
    ± if the text has it.
    """
    from seatrial.ident.results import standard_error_sentence

    texts = (result.answer, getattr(result, "caveat", None))
    paragraphs = "\n".join(filter(None, texts))
    return in_python(" ".join(filter(None, (paragraphs, standard_error_sentence(*texts)))))


def warning_texts(result: Result) -> list[str]:
    """Return the warnings of a result in the words of the Python interface; empty if there are none."""
    return [in_python(w.text) for w in result.warnings]


def note_texts(result: Result) -> list[str]:
    """Return the notes of a result in the words of the Python interface; empty if there are none."""
    return [in_python(text) for text in result.notes]


def summary(result: FitResult) -> str:
    """Return the result of a fit as text: its conclusion, a table of the estimates, fixed parameters, warnings, notes.

    The parameters of effects that the user or a diagnosis added come first in the table. Above it are method and
    log-likelihood, then the `conclusion`, and of a diagnosis the labels of the names and what to look for on the craft.
    Flags, which name problems of single estimates, follow the table. Notes come last.
    """
    from seatrial.ident.results import causes_sentence, name_probabilities

    result = with_texts_in_python(result)
    fit, effects = result.fit, getattr(result, "effects", ())
    lines = [
        f"{fit.model}: {fit.method}{', REML' if fit.restricted else ''}, {fit.message}",
        f"log-likelihood {fit.log_likelihood:.2f}" if fit.log_likelihood is not None else "log-likelihood not finite",
        "",
        *[textwrap.fill(paragraph, WIDTH) for paragraph in conclusion(result).splitlines()],
        *[textwrap.fill(text, WIDTH) for text in (name_probabilities(effects), causes_sentence(effects)) if text],
        "",
    ]
    first = effect_parameters(result)
    rows = sorted((statistics(row) for row in fit.parameters), key=lambda row: row.name.split("@")[0] not in first)
    table = [COLUMNS, *(_cells(row) for row in rows if row.free)]
    widths = [max(len(cells[k]) for cells in table) for k in range(len(COLUMNS))]
    rule = "-" * (sum(widths) + 2 * (len(widths) - 1))
    for k, cells in enumerate(table):
        # Numbers are right-aligned; the name, the unit and the origin are left-aligned.
        lines.append(
            "  ".join(
                c.ljust(w) if j in (0, 6, 7) else c.rjust(w) for j, (c, w) in enumerate(zip(cells, widths, strict=True))
            ).rstrip()
        )
        lines += [rule] if k == 0 else []
    lines += [rule] if len(table) > 1 else []
    flags = [f"{row.name}: {row.flag}" for row in rows if row.free and row.flag]
    lines += [textwrap.fill(flag, WIDTH, initial_indent="  ", subsequent_indent="    ") for flag in flags]
    if experiment := getattr(result, "next_experiment", ""):
        lines += ["", textwrap.fill(experiment, WIDTH)]
    fixed = [f"{row.name} = {row.value:.6g} {row.unit}".strip() + f" ({row.origin})" for row in rows if not row.free]
    lines += ["", textwrap.fill(f"fixed: {', '.join(fixed)}", WIDTH)] if fixed else []
    lines += (
        ["", *(textwrap.fill(f"warning: {text}", WIDTH) for text in warning_texts(result))] if result.warnings else []
    )
    notes = note_texts(result)
    lines += ["", *(textwrap.fill(f"note: {text}", WIDTH, subsequent_indent="  ") for text in notes)] if notes else []
    return "\n".join(lines)


def effect_parameters(result: FitResult) -> set[str]:
    """Return the names of the parameters of the effects that the user added to a fit, or that a diagnosis added."""
    added = {row.name for effect in getattr(result, "effects", ()) for row in effect.parameters}
    return added | set(getattr(result, "effect_parameters", ()))


def content(result: FitResult) -> Content:
    """Return what a notebook shows of a fit: its `conclusion`, its warnings and the table of the estimates.

    Fixed parameters, and the flags of estimates, are left out.
    """
    rows = [_cells(row) for row in map(statistics, result.fit.parameters) if row.free]
    return Content(conclusion(result), warning_texts(result), COLUMNS, rows)


def labelled_covariance(covariance: NDArray[np.float64], names: Sequence[str]) -> Any:
    """Return a covariance (n, n) as a ``pandas.DataFrame`` with the n names as index and columns."""
    return import_library("pandas").DataFrame(covariance, index=list(names), columns=list(names))


def frame(result: FitResult) -> Any:
    """Return the parameters of a fit as a ``pandas.DataFrame`` with a row for each; SeatrialError without pandas.

    The flags are short codes; their texts stand in `summary`.
    """
    rows = [statistics(row)._replace(flag=row.flag_in_table) for row in result.fit.parameters]
    return import_library("pandas").DataFrame(rows, columns=list(Statistics._fields)).set_index("name")


def residual_tests(result: FitResult | ComparedModel, on: Role = "estimation") -> list[ResidualTest]:
    """Return the tests of the residuals; of a diagnosis, those of the model with the effects.

    ``result`` is that of a fit, or a model of a comparison, whose logs have the role ``validation``.

    ``on`` is the role of the records, ``estimation`` or ``validation``. SeatrialError is raised for another word, and
    if the result has no tests of validation data.

    Each channel of a record has three tests of its own, and one of the correlation with each input. One of the two
    whiteness tests fails below 0.5 %, so that white residuals fail one of them in 1 % of the cases, as in the report.
    Normality fails below 1 %, and a correlation below 1 % divided by the number of correlations, as in the answer.
    """
    if on not in get_args(Role):
        raise SeatrialError(f"on: {on!r} names no data; give 'estimation' or 'validation'")
    if on == "validation" and not any(r.role == on for r in result.residuals):
        raise SeatrialError(
            "this result has no residual tests of validation data: it has no validation logs, or was validated in "
            "blocks of time; fit again with logs as the argument `validate`"
        )
    rows = []
    for row in (r for r in result.residuals if r.role == on):
        rows += _tests_of_channel(row.record, row.channel, row.after or row, row.lags, row.frequency)
    pairs = [(row, row.after or row) for row in result.cross if row.role == on]
    number = sum(test.p is not None for _, test in pairs)
    return rows + [
        ResidualTest(
            row.record, row.channel, "cross-correlation", row.input, _or_nan(test.largest),
            STATISTICS["cross-correlation"], _or_nan(test.p), _at_largest(row.lags, test.z), math.nan, LEVEL / number,
            _verdict(test.p, LEVEL / number, "uncorrelated", "correlated"),
        )
        for row, test in pairs if number
    ]  # fmt: skip


def residual_frame(result: FitResult | ComparedModel, on: Role = "estimation") -> Any:
    """Return the `residual_tests` of a fit as a ``pandas.DataFrame``; SeatrialError without pandas.

    The index names the test of each row, as `_test_labels` does: pandas prints the index in full, but leaves out
    columns and rows of a large table. It keeps the first and the last columns: p and the verdict.
    """
    pandas, rows = import_library("pandas"), residual_tests(result, on)
    index = pandas.Index(_test_labels(rows), name="name", dtype=object)
    table = pandas.DataFrame(rows, columns=list(ResidualTest._fields), index=index)
    first, last = ["p", "statistic"], ["limit", "verdict"]
    return table[[*first, *(name for name in ResidualTest._fields if name not in (*first, *last)), *last]]


def _test_labels(rows: Sequence[ResidualTest]) -> list[str]:
    """Return a label for each test: ``r ljung-box``, or ``r cross-correlation n_left``.

    The name of the record is in front if there are several records: ``run1 r ljung-box``.
    """
    several = len({row.record for row in rows}) > 1
    parts = [(row.record if several else "", row.channel, row.test, row.input) for row in rows]
    return [" ".join(filter(None, part)) for part in parts]


def error_rows(result: FitResult) -> list[ErrorRow]:
    """Return the prediction errors of a fit or a diagnosis by data, kind of prediction and channel."""
    found = []
    for role in ("estimation", "validation"):
        table = getattr(result.errors, role)
        for kind in () if table is None else table.__struct_fields__:
            seconds = result.horizon_seconds if kind == "horizon" else math.nan
            found += [
                ErrorRow(
                    role, kind, seconds, channel, e.unit, _or_nan(e.before), _or_nan(e.after), _or_nan(e.low),
                    _or_nan(e.high), e.verdict or "",
                )
                for channel, e in getattr(table, kind).items()
            ]  # fmt: skip
    return found


def error_frame(result: FitResult) -> Any:
    """Return the `error_rows` of a fit as a ``pandas.DataFrame``; SeatrialError without pandas."""
    return import_library("pandas").DataFrame(error_rows(result), columns=list(ErrorRow._fields))


def _tests_of_channel(
    record: str, channel: str, tests: WhitenessTests, lags: NDArray[np.float64], frequency: NDArray[np.float64]
) -> list[ResidualTest]:
    """Return both whiteness tests and the test of normality of a channel.

    ``lags`` [s] belong to the autocorrelation, and ``frequency`` [Hz] to the cumulative periodogram.
    """
    size = tests.cumulative.size
    distance = np.abs(tests.cumulative - np.arange(1, size + 1) / size)
    outliers = f", {tests.outliers} beyond 6 standard deviations" if tests.outliers else ""

    def row(test: str, statistic: float, p: float | None, lag: float, at: float, limit: float) -> ResidualTest:
        """Return the row of one test."""
        words = ("normal", "not normal") if test == "normality" else ("white", "not white")
        verdict = _verdict(p, limit, *words) + (outliers if test == "normality" else "")
        return ResidualTest(record, channel, test, "", statistic, STATISTICS[test], _or_nan(p), lag, at, limit, verdict)

    return [
        row("ljung-box", _largest(tests.acf), tests.ljung_box_p, _at_largest(lags, tests.acf), math.nan, LEVEL / 2),
        row("periodogram", _largest(distance), tests.periodogram_p, math.nan, _at_largest(frequency, distance),
            LEVEL / 2),
        row("normality", tests.largest, tests.normal_p, math.nan, math.nan, LEVEL),
    ]  # fmt: skip


def _verdict(p: float | None, level: float, passed: str, failed: str) -> str:
    """Return the word for a p value: ``failed`` if it is not above a level, and "not tested" without a p value."""
    return "not tested" if p is None else passed if p > level else failed


def _or_nan(value: float | None) -> float:
    """Return the value, or NaN if it is None."""
    return math.nan if value is None else value


def _largest(values: NDArray[np.float64]) -> float:
    """Return the largest absolute value of an array (n,). The result is NaN if no value is finite."""
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.max()) if finite.size else math.nan


def _at_largest(places: NDArray[np.float64], values: NDArray[np.float64]) -> float:
    """Return the place (lag or frequency) of the largest size of values (n,); NaN if none is finite."""
    sizes = np.where(np.isfinite(values), np.abs(values), -1.0)
    return float(places[np.argmax(sizes)]) if sizes.size and sizes.max() >= 0.0 else math.nan


def read_parquet(path: Path) -> Any:
    """Return the content of a Parquet file as a ``pyarrow.Table``; SeatrialError if it cannot be read."""
    parquet, arrow = import_library("pyarrow.parquet"), import_library("pyarrow")
    try:
        return parquet.read_table(path)
    except (OSError, arrow.ArrowException) as problem:
        line = str(problem).splitlines()[0]
        raise SeatrialError(f"{path}: cannot be read ({line}); run the command again") from None


def _cells(row: Statistics) -> tuple[str, ...]:
    """Return the cells of one row of the table of estimates, for one parameter, as texts in the order of `COLUMNS`.

    Numbers have four significant digits, the t statistic has one decimal, and NaN is empty.
    """
    numbers = (row.value, row.se, row.low, row.high)
    shown = ["" if math.isnan(v) else f"{v:.4g}" for v in numbers]
    return (row.name, *shown, "" if math.isnan(row.t) else f"{row.t:.1f}", row.unit, row.origin)
