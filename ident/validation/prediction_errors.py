"""Prediction errors of a model: one step ahead, over its horizon and in simulation; and how they change.

`prediction_change` compares two models, and is what everything that says "better" asks: by channel the ratio of the RMS
prediction errors over the horizon, and over all channels the geometric mean of these ratios, which is the Gaussian
likelihood ratio with the variance of each channel concentrated out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from seatrial.ident.data import Record
from seatrial.ident.engine import VectorisedModel
from seatrial.ident.estimation import FilterResult, Likelihood, ParameterUncertainty, predict_ahead, prediction_variance
from seatrial.ident.model import Model
from seatrial.ident.numerics import Array, wrap

THIN = 2  # of a channel, predictions over the horizon start from every second row,
MOST = 4000  # or, where a sensor is fast, from about so many
APART = 1e3  # s between the times of two records
WARM_UP = 15.0  # s of measurements that a simulation starts from
BLOCK = 2.0  # horizons: errors over a horizon are correlated for as long as it lasts
FEWEST_BLOCKS, ENOUGH_BLOCKS = 4, 15  # for an interval; with more of them the blocks are longer instead
DIVERGED = 1e9  # of any unit: an error that is larger is of a prediction that diverged
RUNAWAY = 10.0  # times the range of what was measured: a simulation that is farther off has diverged
LEAST_CHANGE = 0.005  # of a ratio: less than what is written as one per cent is no change


@dataclass(frozen=True)
class PredictionErrors:
    """Errors of one channel.

    Attributes:
        t: their times (n,) [s].
        e: measured less predicted (n,), angles wrapped to a half turn; infinite where the prediction diverged.
        about: measured less its mean in the record (n,), angles about their circular mean: the errors of a
            prediction by that mean.
    """

    t: Array
    e: Array
    about: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(self.e**2))) if self.e.size else float("nan")

    @property
    def spread(self) -> float:
        """Standard deviation of what was measured, about its mean in each record."""
        return float(np.sqrt(np.mean(self.about**2))) if self.about.size else float("nan")


@dataclass(frozen=True)
class SimulationRun:
    """Predicted from the inputs alone after the first 15 s: y, sd (n_rows, n_outputs), errors per channel;
    ``diverged``: when a channel left what was measured by ten times its range [s]."""

    y: Array
    sd: Array
    errors: Mapping[str, PredictionErrors]
    diverged: Mapping[str, float] = field(default_factory=dict)


def one_step_errors(model: Model, record: Record, run: FilterResult) -> dict[str, PredictionErrors]:
    """Innovations, in the unit of each channel."""
    found = {o.name: _errors(record.t, record.y[:, j], run.e[:, j], o.angle) for j, o in enumerate(model.outputs)}
    return {name: e for name, e in found.items() if e.e.size}


def horizon_errors(
    model: Model, record: Record, values: Array, x: Array, seconds: float
) -> dict[str, PredictionErrors]:
    """Errors of predictions from the states x (n_rows, n_states), such as the filtered ones, and the inputs alone, by
    channel; the disturbance forces decay. Each channel is predicted at its own samples, from the last row that is at
    least ``seconds`` earlier; a prediction that diverged has an infinite error."""
    begin = np.searchsorted(record.t, record.t - seconds + 1e-6, side="right") - 1  # a microsecond is no delay
    stride = max(THIN, record.n_rows // MOST)
    ends = []
    for j in range(len(model.outputs)):
        seen = np.flatnonzero(np.isfinite(record.y[:, j]) & (begin >= 0))
        ends.append(seen[np.unique(begin[seen] // stride, return_index=True)[1]])
    every = np.unique(np.concatenate(ends))
    found = predict_ahead(model, record, values, x, begin[every], every)
    errors = {}
    for j, (o, end) in enumerate(zip(model.outputs, ends, strict=True)):
        if end.size:
            y = record.y[end, j]
            errors[o.name] = _errors(record.t[end], y, y - found.y[np.searchsorted(every, end), j], o.angle)
    return errors


def simulation_run(
    model: Model,
    record: Record,
    values: Array,
    likelihood: Likelihood | None = None,
    uncertainty: ParameterUncertainty | None = None,
) -> SimulationRun:
    """The filter gets 15 s of measurements and then the inputs only; its covariance is the prediction's own band, and
    its mean is of first order.

    ``uncertainty``: of the parameters (``seatrial.ident.estimation.parameter_covariance``), which widens the band; None
    takes them for known.
    """
    if model.second_order:  # far ahead a heading is spread too widely for a series of second order in it
        model, likelihood = replace(model, second_order=False), None
    likelihood = likelihood or Likelihood(model)
    blind = record.t > record.t[0] + WARM_UP
    y = record.y.copy()
    y[blind] = np.nan
    run = likelihood.filter(replace(record, y=y), values)
    rowwise = VectorisedModel(model)
    n = len(model.states)
    predicted = rowwise(run.x_pred, record.u, values)[:, n:]
    H = rowwise.output_jacobian(run.x_pred, record.u, values)
    variance = run.output_variance(H)
    if uncertainty is not None and blind.any():
        variance += prediction_variance(uncertainty, model, record, values, int(np.argmax(blind)), likelihood)
    errors, diverged = {}, {}
    for j, o in enumerate(model.outputs):
        y, at = record.y[blind, j], record.t[blind]
        e = _errors(at, y, y - predicted[blind, j], o.angle)
        if e.e.size:
            errors[o.name] = e
            low, high = np.nanmin(y), np.nanmax(y)
            far = ~(np.abs(predicted[blind, j] - (low + high) / 2) <= RUNAWAY * (high - low))
            if far.any() and not o.angle and high > low:
                diverged[o.name] = float(at[np.argmax(far)])
    return SimulationRun(predicted, np.sqrt(np.maximum(variance, 0)), errors, diverged)


def pooled_errors(
    parts: Sequence[Mapping[str, PredictionErrors]], ends: Sequence[float] | None = None
) -> dict[str, PredictionErrors]:
    """Errors of several records as one, their times one after the other; ``ends`` [s] of the records, where others are
    pooled to be compared with these."""
    lengths = [_end(p) + APART if p else 0.0 for p in parts] if ends is None else [end + APART for end in ends]
    starts = np.cumsum([0.0, *lengths])
    found: dict[str, PredictionErrors] = {}
    for name in dict.fromkeys(n for p in parts for n in p):
        own = [(p[name], start) for p, start in zip(parts, starts, strict=False) if name in p]
        columns = zip(*((e.t + start, e.e, e.about) for e, start in own), strict=True)
        found[name] = PredictionErrors(*(np.concatenate(column) for column in columns))
    return found


def _end(part: Mapping[str, PredictionErrors]) -> float:
    return max((float(e.t[-1]) for e in part.values()), default=0.0)


@dataclass(frozen=True)
class ErrorRatio:
    """RMS prediction error after a change of the model over that before it, with its 95 % interval (NaN where the data
    are too short for one)."""

    ratio: float
    low: float
    high: float

    @property
    def verdict(self) -> Literal["fell", "rose", "unchanged"]:
        """By the interval: ``unchanged`` where it holds one, where there is none, and below half a per cent."""
        if self.high < 1.0 and self.ratio < 1.0 - LEAST_CHANGE:
            return "fell"
        return "rose" if self.low > 1.0 and self.ratio > 1.0 + LEAST_CHANGE else "unchanged"


@dataclass(frozen=True)
class ChannelChange(ErrorRatio):
    """The same of one channel, with its RMS errors before and after in its unit."""

    before: float
    after: float


@dataclass(frozen=True)
class PredictionChange(ErrorRatio):
    """Over all channels: the geometric mean of their ratios, its interval and verdict.

    Attributes:
        horizon: how far ahead was predicted [s].
        channels: each with its own ratio and interval.
    """

    horizon: float
    channels: Mapping[str, ChannelChange]

    def named(self, verdict: Literal["fell", "rose"]) -> list[str]:
        """The channels of one verdict, the largest change first."""
        found = [n for n, c in self.channels.items() if c.verdict == verdict]
        return sorted(found, key=lambda n: -abs(np.log(self.channels[n].ratio)))


def prediction_change_by_record(
    before: Mapping[str, Mapping[str, PredictionErrors]],
    after: Mapping[str, Mapping[str, PredictionErrors]],
    horizon: float,
) -> PredictionChange:
    """The change on the records, by their names, that both models have: one that a model could not be evaluated on is
    left out, and the times of all others stay the same for both."""
    both = [(before[name], after[name]) for name in before if name in after]
    ends = [max(map(_end, pair)) for pair in both]
    old, new = (pooled_errors([pair[k] for pair in both], ends) for k in (0, 1))
    return prediction_change(old, new, horizon)


def prediction_change(
    before: Mapping[str, PredictionErrors], after: Mapping[str, PredictionErrors], horizon: float
) -> PredictionChange:
    """Change of the prediction errors over a horizon [s] from one model to another, with 95 % intervals.

    Both of the same records (``pooled_errors`` of ``horizon_errors``; else `prediction_change_by_record`); of channels
    that both have, the errors at common times are compared. The intervals are those of a delete-one jackknife of the
    logarithms of the ratios, with Student's t, over blocks of two horizons in all records, or longer ones where that
    would be more than fifteen (Efron 1982; Künsch 1989). A channel with errors in fewer than four blocks is left out of
    the mean where others have more.
    """
    seconds, times = BLOCK * horizon, [e.t for e in before.values()]
    seconds *= max(1.0, np.unique(np.floor(np.concatenate(times or [np.zeros(0)]) / seconds)).size / ENOUGH_BLOCKS)
    found = {n: _block_sums(before[n], after[n], seconds) for n in before if n in after}
    sums = {n: of for n, of in found.items() if of.before.sum() > 0 and of.after.sum() > 0}
    if not sums:
        return PredictionChange(float("nan"), float("nan"), float("nan"), horizon, {})
    blocks = np.unique(np.concatenate([of.block for of in sums.values()]))
    channels, logs = {}, np.zeros((len(sums), 1 + blocks.size))  # of all, and without each block
    for row, (name, of) in zip(logs, sums.items(), strict=True):
        at = np.append(0, 1 + np.searchsorted(blocks, of.block))
        row[:] = 0.5 * np.log(of.after.sum() / of.before.sum())
        with np.errstate(divide="ignore", invalid="ignore"):  # a lone block
            row[at[1:]] = 0.5 * np.log((of.after.sum() - of.after) / (of.before.sum() - of.before))
        rms = (float(np.sqrt(part.sum() / of.n)) for part in (of.before, of.after))
        channels[name] = ChannelChange(*_jackknife(row[at]), *rms)
    enough = np.array([of.block.size >= FEWEST_BLOCKS for of in sums.values()])
    return PredictionChange(*_jackknife(logs[enough if enough.any() else ~enough].mean(axis=0)), horizon, channels)


class _BlockSums(NamedTuple):
    """Sums of squares by block, (n_blocks,) each, of the n errors of a channel at times that both models have."""

    n: int
    block: Array
    before: Array
    after: Array


def _block_sums(before: PredictionErrors, after: PredictionErrors, seconds: float) -> _BlockSums:
    t, i, j = np.intersect1d(before.t, after.t, return_indices=True)
    block, index = np.unique(np.floor(t / seconds), return_inverse=True)
    old, new = (np.minimum(np.abs(e), DIVERGED) ** 2 for e in (before.e[i], after.e[j]))
    old, new = (np.bincount(index, e2, block.size).astype(np.float64) for e2 in (old, new))
    return _BlockSums(t.size, block, old, new)


def _jackknife(logs: Array) -> tuple[float, float, float]:
    """Ratio and its 95 % interval from the logarithm of all and those without each block (1 + n_blocks,)."""
    from scipy import stats

    n, reach = logs.size - 1, float("nan")
    if n >= FEWEST_BLOCKS:
        spread = np.sqrt((n - 1) / n * np.sum((logs[1:] - logs[1:].mean()) ** 2))
        reach = float(stats.t.ppf(0.975, n - 1) * spread)
    return float(np.exp(logs[0])), float(np.exp(logs[0] - reach)), float(np.exp(logs[0] + reach))


def _errors(t: Array, y: Array, e: Array, angle: bool) -> PredictionErrors:
    """At the samples y (n,) of a channel, NaN where there is none."""
    seen = np.isfinite(y)
    t, y, e = t[seen], y[seen], wrap(e[seen], angle)
    mean = np.angle(np.exp(1j * y).sum()) if angle else y.mean() if y.size else 0.0
    return PredictionErrors(t, np.where(np.abs(e) < DIVERGED, e, np.inf), wrap(y - mean, angle))
