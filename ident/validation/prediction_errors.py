"""Prediction errors of a model: one step ahead, over the horizon and in simulation; comparison of two models.

`prediction_change` compares two models. Every statement that a model predicts better uses this comparison. For each
channel the measure is the ratio of the RMS prediction errors over the horizon. For all channels together the measure
is the geometric mean of these ratios. This mean is the Gaussian likelihood ratio with the variance of each channel
concentrated out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from seatrial.ident.data import Record
from seatrial.ident.engine import vectorised
from seatrial.ident.estimation import FilterResult, Likelihood, ParameterUncertainty, predict_ahead, prediction_variance
from seatrial.ident.model import Model
from seatrial.ident.numerics import Array, correlation_length, student_ppf, wrap

MIN_STRIDE = 2  # rows between the starts of predictions over the horizon
MAX_STARTS = 4000  # approximate largest number of starts in a record; longer records get a larger stride
RECORD_GAP_S = 1e3  # between the times of two pooled records
WARM_UP = 15.0  # s of measurements before a simulation
BLOCK_HORIZONS = 2.0  # block length of the jackknife: errors are correlated over one horizon
TINY = 1e-300  # smallest sum of squared errors by which others are divided
CORRELATION_LENGTHS = 4.0  # block length of the jackknife for simulations, in correlation lengths
# An interval needs the first number of blocks. More data than the second number of blocks get longer blocks instead.
FEWEST_BLOCKS, ENOUGH_BLOCKS = 4, 15
DIVERGED = 1e9  # in any unit: a prediction with a larger error has diverged
RUNAWAY = 10.0  # ranges of the measured values: a simulation farther from their middle has diverged
SMALL_PART = 0.05  # share of the time whose share of the squared errors is tested
PARTS_PER_HORIZON = 2  # intervals of a horizon from which the small part is chosen
MOST_SPANS = 3  # a small part in more places is no event that a reader can look at
LEAST_SHARE = 0.1  # of the squared errors of a channel that an interval of the small part has
LEAST_CHANGE = 0.005  # of a ratio: reports round to one per cent, so a smaller change is shown as no change


@dataclass(frozen=True)
class PredictionErrors:
    """Prediction errors of one channel.

    Attributes
    ----------
    t : Array (n,)
        Times of the samples [s].
    e : Array (n,)
        Measured less predicted values, in the unit of the channel. Angles are wrapped to a half turn; diverged
        predictions are infinite.
    about : Array (n,)
        Measured values less their mean in the record (circular mean for angles). These are the errors of a prediction
        by that mean.
    """

    t: Array
    e: Array
    about: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def rms(self) -> float:
        """RMS prediction error in the unit of the channel; NaN if there are no errors, infinite if one diverged."""
        return float(np.sqrt(np.mean(self.e**2))) if self.e.size else float("nan")

    @property
    def spread(self) -> float:
        """Standard deviation of the measured values about their mean in each record, NaN if there are none."""
        return float(np.sqrt(np.mean(self.about**2))) if self.about.size else float("nan")


@dataclass(frozen=True)
class SimulationRun:
    """Simulation of a record from the inputs alone, after 15 s of filtering.

    Attributes
    ----------
    y, sd : Array (n_rows, n_outputs)
        Predicted outputs and their standard deviations, in the units of the outputs. In the first 15 s the predictions
        are those of the filter, one step ahead.
    errors
        Prediction errors after the first 15 s, by channel. Channels without samples then are left out.
    diverged
        First time [s] at which a channel diverged, by channel. A channel diverges when the prediction is farther from
        the middle of the measured range than ten times that range, or is NaN. Channels that did not diverge, angles and
        channels whose samples are all equal are left out.
    """

    y: Array
    sd: Array
    errors: Mapping[str, PredictionErrors]
    diverged: Mapping[str, float] = field(default_factory=dict)


def one_step_errors(model: Model, record: Record, run: FilterResult) -> dict[str, PredictionErrors]:
    """Return the one-step prediction errors (innovations) of a filter run, by channel, in the unit of the channel.

    Outliers are included. The first sample of a channel is left out: it is predicted from the initial state, which may
    be unknown, as in a block of a run. So are channels with fewer than two samples.
    """
    found = {}
    for j, o in enumerate(model.outputs):
        later = np.flatnonzero(np.isfinite(record.y[:, j]))[1:]
        if later.size:
            found[o.name] = _channel_errors(record.t[later], record.y[later, j], run.e[later, j], o.angle)
    return {name: e for name, e in found.items() if e.e.size}


def horizon_errors(
    model: Model, record: Record, values: Array, x: Array, seconds: float, interval: float | None = None
) -> dict[str, PredictionErrors]:
    """Return the errors of predictions over a horizon, by channel.

    The predictions use the inputs alone; the disturbance forces decay. Each channel is predicted at its own samples. A
    prediction starts at the last row that is at least ``seconds`` earlier. Only one prediction of a channel starts in
    every two rows; in records of 12 000 rows or more the starts are farther apart, so that there are about 4000.

    Parameters
    ----------
    model, record
        Model and record.
    values : Array (n_parameters,)
        Parameter values.
    x : Array (n_rows, n_states)
        States at which predictions start, for example the filtered states.
    seconds
        Horizon [s].
    interval
        Length of the intervals [s] from time 0 on, of which each has one predicted sample of a channel, the first one.
        Give it if models with different rows are compared, so that they predict the same samples. None: one prediction
        starts in every two rows.

    Returns
    -------
    dict of str to PredictionErrors
        Errors by channel in their units, infinite for diverged predictions. Channels without a prediction are left out.
    """
    begin = np.searchsorted(record.t, record.t - seconds + 1e-6, side="right") - 1  # 1 us covers rounding of times
    stride = max(MIN_STRIDE, record.n_rows // MAX_STARTS)
    ends = []
    for j in range(len(model.outputs)):
        seen = np.flatnonzero(np.isfinite(record.y[:, j]) & (begin >= 0))
        group = begin[seen] // stride if interval is None else np.floor(record.t[seen] / interval + 1e-6)
        ends.append(seen[np.unique(group, return_index=True)[1]])
    every = np.unique(np.concatenate(ends))
    found = predict_ahead(model, record, values, x, begin[every], every)
    errors = {}
    for j, (o, end) in enumerate(zip(model.outputs, ends, strict=True)):
        if end.size:
            y = record.y[end, j]
            errors[o.name] = _channel_errors(record.t[end], y, y - found.y[np.searchsorted(every, end), j], o.angle)
    return errors


def simulation_run(
    model: Model,
    record: Record,
    values: Array,
    likelihood: Likelihood | None = None,
    uncertainty: ParameterUncertainty | None = None,
) -> SimulationRun:
    """Simulate a record: filter its first 15 s, then predict from the inputs alone.

    The filter sees no measurement after the first 15 s. Its covariance then gives the prediction interval.

    Parameters
    ----------
    model, record
        Model and record.
    values : Array (n_parameters,)
        Parameter values.
    likelihood
        Likelihood of the model, by default a new one.
    uncertainty
        Uncertainty of the parameters (``seatrial.ident.estimation.parameter_covariance``), which widens the interval.
        With None the parameters are taken as exactly known.

    Returns
    -------
    SimulationRun
        Predictions, errors and diverged channels.

    Notes
    -----
    The mean is always of first order. For a model with a second-order mean, ``likelihood`` is therefore not used.
    """
    if model.second_order:  # after a long prediction the heading is too uncertain for a second-order expansion
        model, likelihood = replace(model, second_order=False), None
    likelihood = likelihood or Likelihood(model)
    blind = record.t > record.t[0] + WARM_UP
    y = record.y.copy()
    y[blind] = np.nan
    run = likelihood.filter(replace(record, y=y), values)
    rowwise = vectorised(model)
    n = len(model.states)
    predicted = rowwise(run.x_pred, record.u, values)[:, n:]
    H = rowwise.output_jacobian(run.x_pred, record.u, values)
    variance = run.output_variance(H)
    if uncertainty is not None and blind.any():
        variance += prediction_variance(uncertainty, model, record, values, int(np.argmax(blind)), likelihood)
    errors, diverged = {}, {}
    for j, o in enumerate(model.outputs):
        y, at = record.y[blind, j], record.t[blind]
        e = _channel_errors(at, y, y - predicted[blind, j], o.angle)
        if e.e.size:
            errors[o.name] = e
            low, high = np.nanmin(y), np.nanmax(y)
            far = ~(np.abs(predicted[blind, j] - (low + high) / 2) <= RUNAWAY * (high - low))
            if far.any() and not o.angle and high > low:
                diverged[o.name] = float(at[np.argmax(far)])
    return SimulationRun(predicted, np.sqrt(np.maximum(variance, 0)), errors, diverged)


def pooled_errors(
    by_record: Sequence[Mapping[str, PredictionErrors]], ends: Sequence[float] | None = None
) -> dict[str, PredictionErrors]:
    """Concatenate the errors of several records. The times are shifted so that the records follow each other.

    Time 0 of each record is moved to 1000 s after the last time of the record before. A channel need not be in each
    record.

    Parameters
    ----------
    by_record
        Errors of each record, by channel.
    ends
        Last times of the records [s], by default those of their errors over all channels; a record without errors then
        takes no time. Give them if two models are compared, so that the times of both agree.

    Returns
    -------
    dict of str to PredictionErrors
        Errors by channel, in the order of their first appearance; empty without errors.
    """
    if ends is None:
        lengths = [_last_time(p) + RECORD_GAP_S if p else 0.0 for p in by_record]
    else:
        lengths = [end + RECORD_GAP_S for end in ends]
    starts = np.cumsum([0.0, *lengths])
    found: dict[str, PredictionErrors] = {}
    for name in dict.fromkeys(n for p in by_record for n in p):
        of_channel = [(p[name], start) for p, start in zip(by_record, starts, strict=False) if name in p]
        columns = zip(*((e.t + start, e.e, e.about) for e, start in of_channel), strict=True)
        found[name] = PredictionErrors(*(np.concatenate(column) for column in columns))
    return found


def _last_time(errors: Mapping[str, PredictionErrors]) -> float:
    """Return the last time [s] of the errors of one record over all channels; 0 if there are none."""
    return max((float(e.t[-1]) for e in errors.values()), default=0.0)


@dataclass(frozen=True)
class ErrorRatio:
    """RMS prediction error after a change of the model over that before it.

    Attributes
    ----------
    ratio
        The ratio.
    low, high
        Its 95 % interval, NaN with fewer than four blocks of time with errors (`prediction_change`).
    blocks
        Number of these blocks.
    """

    ratio: float
    low: float
    high: float
    blocks: int = field(default=0, kw_only=True)

    @property
    def verdict(self) -> Literal["fell", "rose", "unchanged"]:
        """Direction of the change by the 95 % interval of the ratio.

        ``fell`` if the whole interval is below 1, ``rose`` if it is above 1. ``unchanged`` if the interval contains 1,
        if there is no interval, or if the change of the ratio is at most half a per cent.
        """
        if self.high < 1.0 and self.ratio < 1.0 - LEAST_CHANGE:
            return "fell"
        return "rose" if self.low > 1.0 and self.ratio > 1.0 + LEAST_CHANGE else "unchanged"


@dataclass(frozen=True)
class ChannelChange(ErrorRatio):
    """Error ratio of one channel, with its RMS errors.

    Attributes
    ----------
    ratio, low, high
        RMS error after over before, and its 95 % interval.
    before, after
        RMS errors before and after the change, in the unit of the channel.
    """

    before: float
    after: float


@dataclass(frozen=True)
class PredictionChange(ErrorRatio):
    """Error ratio, after over before a change of the model, over all channels, with its interval and verdict.

    Attributes
    ----------
    ratio, low, high
        Geometric mean of the ratios of the channels, and its 95 % interval. All are NaN if the two models have no
        prediction errors of the same channel at the same time. The interval is NaN if the data are too short for it.
    horizon
        Prediction horizon [s].
    channels
        Error ratio of each channel.
    """

    horizon: float
    channels: Mapping[str, ChannelChange]

    def named(self, verdict: Literal["fell", "rose"]) -> list[str]:
        """Return the names of the channels whose RMS error fell or rose (``verdict``), the largest ratio change first.

        The list is empty if no channel has this verdict.
        """
        found = [n for n, c in self.channels.items() if c.verdict == verdict]
        return sorted(found, key=lambda n: -abs(np.log(self.channels[n].ratio)))


def prediction_change_by_record(
    before: Mapping[str, Mapping[str, PredictionErrors]],
    after: Mapping[str, Mapping[str, PredictionErrors]],
    horizon: float,
    block: float | None = None,
) -> PredictionChange:
    """Compare two models on the records that both could be evaluated on.

    Records are matched by name. The other records are left out. The pooled times of all records are the same for both
    models.

    Parameters
    ----------
    before, after
        Errors over the horizon of each model, by record and channel.
    horizon
        Prediction horizon [s].
    block
        Length of a block of time [s], for the intervals. None: two horizons.

    Returns
    -------
    PredictionChange
        Change from ``before`` to ``after``.
    """
    both = [(before[name], after[name]) for name in before if name in after]
    ends = [max(map(_last_time, pair)) for pair in both]
    old, new = (pooled_errors([pair[k] for pair in both], ends) for k in (0, 1))
    return prediction_change(old, new, horizon, block)


def correlated_blocks(
    before: Mapping[str, Mapping[str, PredictionErrors]], after: Mapping[str, Mapping[str, PredictionErrors]]
) -> dict[str, float]:
    """Return the length of the blocks of time [s] for the comparison of two simulations, by channel.

    Errors of a simulation are correlated over an unknown time, as it has no horizon. A block is four times as long as
    the correlation length of the errors, and zero without correlation. Channels that one of the models does not predict
    are left out.

    Parameters
    ----------
    before, after
        Errors of each model, by record and channel. Only the times that both models have are used.

    Notes
    -----
    The correlation is that of the series whose sum is the change of the logarithm of the error ratio, to first order:
    the difference of the squared errors of both models, each divided by its sum. In simulated comparisons of two equal
    models with first-order errors, four correlation lengths gave a false verdict in 4 to 10 % of the cases (records of
    300 and 600 s, correlation times of 2 to 100 s). With two lengths it was up to 20 %. With six or more, short records
    have too few blocks for any verdict.
    """
    blocks: dict[str, float] = {}
    for name in dict.fromkeys(n for by in before.values() for n in by):
        pairs = [(by[name], after[r][name]) for r, by in before.items() if name in by and name in after.get(r, {})]
        found = [_common_squares(a, b) for a, b in pairs]
        times = [t for t, _, _ in found if t.size > 1]
        if times:
            totals = [max(sum(float(squares[k].sum()) for _, *squares in found), TINY) for k in (0, 1)]
            series = [new / totals[1] - old / totals[0] for _, old, new in found]
            step = float(np.median(np.concatenate([np.diff(t) for t in times])))
            blocks[name] = CORRELATION_LENGTHS * step * correlation_length(series)
    return blocks


def _common_squares(before: PredictionErrors, after: PredictionErrors) -> tuple[Array, Array, Array]:
    """Return the times that the errors of both models have, and the squared errors of each model at these times.

    Errors above 1e9 in the unit of the channel (`DIVERGED`), also infinite ones, count as 1e9.
    """
    t, i, j = np.intersect1d(before.t, after.t, return_indices=True)
    old, new = (np.minimum(np.abs(e), DIVERGED) ** 2 for e in (before.e[i], after.e[j]))
    return t, old, new


def prediction_change(
    before: Mapping[str, PredictionErrors],
    after: Mapping[str, PredictionErrors],
    horizon: float,
    block: float | None = None,
) -> PredictionChange:
    """Return the change of the prediction errors over a horizon from one model to another.

    Parameters
    ----------
    before, after
        Errors of each model by channel, of the same records (``pooled_errors`` of ``horizon_errors``). If the records
        differ, use `prediction_change_by_record`. The errors of common channels are compared at common times.
    horizon
        Prediction horizon [s].
    block
        Length of a block of time [s], for the intervals. None: two horizons.

    Returns
    -------
    PredictionChange
        Ratios with 95 % intervals, NaN without common errors. Channels of which a model has no error other than zero
        are left out. Channels with errors in fewer than four blocks have no interval; they are also left out of the
        mean over all channels, unless no channel has four.

    Notes
    -----
    The intervals come from a delete-one jackknife of the logarithms of the ratios, with Student's t (Efron 1982; Künsch
    1989). The jackknife leaves out blocks of time, which are longer if there would be more than fifteen.
    """
    seconds, times = block or BLOCK_HORIZONS * horizon, [e.t for e in before.values()]
    seconds *= max(1.0, np.unique(np.floor(np.concatenate(times or [np.zeros(0)]) / seconds)).size / ENOUGH_BLOCKS)
    found = {n: _block_sums(before[n], after[n], seconds) for n in before if n in after}
    sums = {n: of for n, of in found.items() if of.before.sum() > 0 and of.after.sum() > 0}
    if not sums:
        return PredictionChange(float("nan"), float("nan"), float("nan"), horizon, {})
    blocks = np.unique(np.concatenate([of.block for of in sums.values()]))
    channels, logs = {}, np.zeros((len(sums), 1 + blocks.size))  # of all blocks, then without each block
    for row, (name, of) in zip(logs, sums.items(), strict=True):
        at = np.append(0, 1 + np.searchsorted(blocks, of.block))
        row[:] = 0.5 * np.log(of.after.sum() / of.before.sum())
        with np.errstate(divide="ignore", invalid="ignore"):  # a single block leaves no errors
            row[at[1:]] = 0.5 * np.log((of.after.sum() - of.after) / (of.before.sum() - of.before))
        rms = (float(np.sqrt(part.sum() / of.n)) for part in (of.before, of.after))
        channels[name] = ChannelChange(*_ratio_with_interval(row[at]), *rms, blocks=of.block.size)
    enough = np.array([of.block.size >= FEWEST_BLOCKS for of in sums.values()])
    mean = logs[enough if enough.any() else ~enough].mean(axis=0)
    return PredictionChange(*_ratio_with_interval(mean), horizon, channels, blocks=blocks.size)


@dataclass(frozen=True)
class LargestErrors:
    """Interval of time with the largest share of the squared prediction errors of a set of records.

    Attributes
    ----------
    record
        Name of the record.
    begin, end
        Begin and end of the interval [s] in the time of the record.
    share
        Share of the interval in the squared errors, as the mean over all channels (0 to 1).
    """

    record: str
    begin: float
    end: float
    share: float


def largest_errors(by_record: Mapping[str, Mapping[str, PredictionErrors]], horizon: float) -> LargestErrors | None:
    """Return the interval of time in which the prediction errors have the largest share of the total.

    The time of each record is divided into intervals of two horizons, from time 0 on.

    Parameters
    ----------
    by_record
        Errors over the horizon, by record and channel.
    horizon
        Prediction horizon [s].

    Returns
    -------
    LargestErrors or None
        The interval; its end is at most the last time of the errors of the record. The first of equal intervals is
        returned. None if there are no errors other than zero.

    Notes
    -----
    Each channel counts equally: its squared errors are divided by their sum over all records. Errors are limited to
    1e9 in the unit of the channel, so a prediction that diverged has a finite share.
    """
    seconds = BLOCK_HORIZONS * horizon
    found = _shares(by_record, seconds)
    if not found:
        return None
    n_channels = len({name for of in found.values() for name in of})
    shares = {at: sum(of.values()) / n_channels for at, of in found.items()}
    record, block = max(shares, key=lambda at: shares[at])
    end = min((block + 1) * seconds, _last_time(by_record[record]))
    return LargestErrors(record, block * seconds, end, shares[record, block])


class Span(NamedTuple):
    """Interval of time [s] of a record, with its begin and without its end."""

    record: str
    begin: float
    end: float


@dataclass(frozen=True)
class ConcentratedErrors:
    """Small part of the time that has most of the squared prediction errors of at least one channel.

    Attributes
    ----------
    spans
        The part: at most three intervals of time, in the order of the records and of time.
    shares
        Share of the part in the squared errors (0 to 1) of each channel of which it has more than half.
    """

    spans: tuple[Span, ...]
    shares: Mapping[str, float]


def concentrated_errors(
    by_record: Mapping[str, Mapping[str, PredictionErrors]], horizon: float
) -> ConcentratedErrors | None:
    """Return the small part of the time that has most of the squared errors of a channel; None if there is none.

    The time of each record is divided into intervals of half a horizon. The part has the intervals with the largest
    shares in the errors of any channel: at most 5 % of all intervals, each with at least 10 % of the squared errors of
    a channel, and together at most three intervals of time.

    Parameters
    ----------
    by_record
        Errors over the horizon, by record and channel.
    horizon
        Prediction horizon [s].
    """
    seconds = horizon / PARTS_PER_HORIZON
    shares = _shares(by_record, seconds)
    part: list[tuple[str, int]] = []
    spans: list[Span] = []
    for at in sorted(shares, key=lambda at: -max(shares[at].values())):
        joined = _joined([*part, at], list(by_record), seconds)
        few = len(part) + 1 <= SMALL_PART * len(shares) and len(joined) <= MOST_SPANS
        if not few or max(shares[at].values()) < LEAST_SHARE:
            break
        part, spans = [*part, at], joined
    sums = {name: sum(shares[at].get(name, 0.0) for at in part) for name in {n for of in shares.values() for n in of}}
    names = dict.fromkeys(name for channels in by_record.values() for name in channels)
    most = {name: sums[name] for name in names if sums.get(name, 0.0) > 0.5}
    return ConcentratedErrors(tuple(spans), most) if most else None


def without_spans(
    by_record: Mapping[str, Mapping[str, PredictionErrors]], spans: Iterable[Span]
) -> dict[str, dict[str, PredictionErrors]]:
    """Return the errors, by record and channel, without those in some intervals of time."""
    spans = tuple(spans)

    def rest(record: str, errors: PredictionErrors) -> PredictionErrors:
        """Return the errors of a channel of a record outside the intervals."""
        keep = np.ones(errors.t.size, dtype=bool)
        for span in spans:
            if span.record == record:
                keep &= (errors.t < span.begin) | (errors.t >= span.end)
        return PredictionErrors(
            errors.t[keep], errors.e[keep], errors.about[keep] if errors.about.size else errors.about
        )

    return {record: {name: rest(record, e) for name, e in by.items()} for record, by in by_record.items()}


def _joined(part: Sequence[tuple[str, int]], records: Sequence[str], seconds: float) -> list[Span]:
    """Join neighbouring intervals of ``seconds`` [s], each a record and its number, to longer ones."""
    spans: list[Span] = []
    for record, block in sorted(part, key=lambda at: (records.index(at[0]), at[1])):
        span = Span(record, block * seconds, (block + 1) * seconds)
        if spans and spans[-1].record == record and spans[-1].end == span.begin:
            span = Span(record, spans.pop().begin, span.end)
        spans.append(span)
    return spans


def _shares(
    by_record: Mapping[str, Mapping[str, PredictionErrors]], seconds: float
) -> dict[tuple[str, int], dict[str, float]]:
    """Return the share of each interval of time in the squared errors of each channel over all records.

    The intervals are ``seconds`` [s] long, from time 0 of each record on. Errors are limited to 1e9 in the unit of the
    channel. Channels without errors other than zero are left out. The keys are the record and the number of the
    interval.
    """
    sums: dict[tuple[str, int], dict[str, float]] = {}
    totals: dict[str, float] = {}
    for record, channels in by_record.items():
        for name, errors in channels.items():
            squares = np.minimum(np.abs(errors.e), DIVERGED) ** 2
            totals[name] = totals.get(name, 0.0) + float(squares.sum())
            blocks, index = np.unique(np.floor(errors.t / seconds), return_inverse=True)
            for block, total in zip(blocks, np.bincount(index, squares, blocks.size), strict=True):
                sums.setdefault((record, int(block)), {})[name] = float(total)
    counted = {at: {n: x / totals[n] for n, x in of.items() if totals[n] > 0.0} for at, of in sums.items()}
    return {at: of for at, of in counted.items() if of}


class _BlockSums(NamedTuple):
    """Sums of squared errors of a channel by block of time, at the times that both models have.

    Attributes
    ----------
    n
        Number of common errors.
    block : Array (n_blocks,)
        Indices of the blocks (intervals of equal length) that contain errors; block 0 starts at time 0.
    before, after : Array (n_blocks,)
        Sums of squared errors of each model, in the squared unit of the channel.
    """

    n: int
    block: Array
    before: Array
    after: Array


def _block_sums(before: PredictionErrors, after: PredictionErrors, seconds: float) -> _BlockSums:
    """Sum the squared errors of one channel of both models over each block (interval of ``seconds`` [s]).

    Only the times that both models have are used. Errors above 1e9 in the unit of the channel (`DIVERGED`), also
    infinite ones, count as 1e9.
    """
    t, *squares = _common_squares(before, after)
    block, index = np.unique(np.floor(t / seconds), return_inverse=True)
    old, new = (np.bincount(index, e2, block.size).astype(np.float64) for e2 in squares)
    return _BlockSums(t.size, block, old, new)


def _ratio_with_interval(logs: Array) -> tuple[float, float, float]:
    """Return the error ratio and the limits of its 95 % interval by the jackknife, as (ratio, low, high).

    ``logs`` (1 + n_blocks,) has the logarithm of the ratio from all blocks of time. Then it has, for each block, the
    logarithm of the ratio from all other blocks. The limits are NaN with fewer than four blocks.
    """
    n, reach = logs.size - 1, float("nan")
    if n >= FEWEST_BLOCKS:
        spread = np.sqrt((n - 1) / n * np.sum((logs[1:] - logs[1:].mean()) ** 2))
        reach = float(student_ppf(0.975, n - 1) * spread)
    return float(np.exp(logs[0])), float(np.exp(logs[0] - reach)), float(np.exp(logs[0] + reach))


def _channel_errors(t: Array, y: Array, e: Array, angle: bool) -> PredictionErrors:
    """Return the errors of a channel at its measured samples.

    Parameters
    ----------
    t, y, e
        Times [s], samples (NaN if missing) and errors, each (n,).
    angle
        Whether the channel is an angle [rad]. Errors are then wrapped to a half turn.

    Returns
    -------
    PredictionErrors
        Errors without the missing samples. Errors of 1e9 or more, and NaN, become infinite.
    """
    seen = np.isfinite(y)
    t, y, e = t[seen], y[seen], wrap(e[seen], angle)
    mean = np.angle(np.exp(1j * y).sum()) if angle else y.mean() if y.size else 0.0
    return PredictionErrors(t, np.where(np.abs(e) < DIVERGED, e, np.inf), wrap(y - mean, angle))
