"""Does a model know how well it predicts? Errors over their predicted standard deviations, by channel and horizon.

If the bands are right, ``z = error / sd`` is standard normal: half of it lies within +-0.674, 95 % within +-1.96, and
its distribution function at z (the probability integral transform; Dawid 1984, Gneiting, Balabdaoui and Raftery 2007)
is uniform. Successive errors of a long prediction hang together, so their number says little; what counts is

    n_eff = n / (1 + 2 sum_k rho_k^2)

(Bartlett 1946: the variance of a mean of squares), with which ``n_eff mean(z^2)`` is about chi-squared.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.data import Record
from seatrial.ident.engine import VectorisedModel
from seatrial.ident.estimation import FilterResult, Likelihood
from seatrial.ident.model import Model
from seatrial.ident.numerics import Array, effective_sample_size, wrap
from seatrial.ident.validation.prediction_errors import WARM_UP, SimulationRun

STRIDE = 0.2  # of the horizon, between the starts of predictions over it
MOST_STARTS = 1000  # of a record; errors within a horizon are much alike, so that more say little more
LATE = 0.2  # of the horizon, or a row where that is longer: within which after its end a sample must come
HALF, NEARLY_ALL = 0.6744898, 1.9599640  # quantiles of 50 % and 95 %
BINS = 10
TOLERANCE = 1.1  # times that the errors may be larger or smaller than claimed
FEW = 8.0  # independent errors below which nothing is said
Verdict = Literal["right", "overconfident", "underconfident", "insufficient_data"]


@dataclass(frozen=True)
class Calibration:
    """Of one channel over one horizon. inside_50, inside_95: shares of the errors within those bands; scale: root mean
    square of error over claimed standard deviation, 1 if right, with its 95 % interval; pit (10,): shares by tenths of
    the predicted distribution; n, n_effective: errors, and independent ones."""

    n: int
    n_effective: float
    inside_50: float
    inside_95: float
    scale: float
    low: float
    high: float
    pit: Array

    @property
    def verdict(self) -> Verdict:
        """``overconfident``: errors are larger than claimed."""
        if self.low > TOLERANCE:
            return "overconfident"
        if self.n_effective < FEW:
            return "insufficient_data"
        return "underconfident" if self.high < 1.0 / TOLERANCE else "right"


def calibration_test(series: Sequence[Array], effective: float | None = None) -> Calibration | None:
    """From standardised errors in their order, one series a record; NaN, where nothing was measured, are left out,
    infinite ones, of predictions that diverged, count. None where there are none. ``effective``: how many independent
    ones they are worth, where that is not told by their own correlation."""
    from scipy import stats

    kept = [z[~np.isnan(z)] for z in series]
    if not sum(z.size for z in kept):
        return None
    z = np.concatenate(kept)
    effective = sum(_effective(one) for one in kept if one.size) if effective is None else effective
    square = float(np.mean(z**2))
    low, high = (np.sqrt(square * effective / stats.chi2.ppf(q, effective)) for q in (0.975, 0.025))
    pit = np.histogram(stats.norm.cdf(z), BINS, (0.0, 1.0))[0] / z.size
    return Calibration(
        z.size,
        effective,
        float(np.mean(np.abs(z) < HALF)),
        float(np.mean(np.abs(z) < NEARLY_ALL)),
        float(np.sqrt(square)),
        float(low),
        float(high),
        pit,
    )


def _effective(z: Array) -> float:
    """Independent ones among standardised errors z (n,), no NaN; all that diverged are one."""
    finite = z[np.isfinite(z)]
    return effective_sample_size(finite) if finite.size else 1.0


def one_step_calibration(model: Model, run: FilterResult) -> dict[str, Array]:
    """Standardised innovations by channel."""
    return {o.name: run.standardised[:, j] for j, o in enumerate(model.outputs)}


@dataclass(frozen=True)
class Forecast:
    """Predictions of a channel over a horizon: times t (n,) [s], errors e and their predicted standard deviations."""

    t: Array
    e: Array
    sd: Array


def horizon_forecasts(
    model: Model, record: Record, values: Array, run: FilterResult, seconds: float, likelihood: Likelihood | None = None
) -> dict[str, Forecast]:
    """``seconds`` ahead of filtered states, from five starts in that time, or fewer in a long record; the sample is
    the first one after the horizon."""
    likelihood = likelihood or Likelihood(model)
    t, n_rows = record.t, record.n_rows
    starts = np.unique(np.searchsorted(t, np.arange(t[0], t[-1] - seconds, STRIDE * seconds)))
    if not starts.size:
        return {}
    starts = starts[:: -(-starts.size // MOST_STARTS)]
    due = np.searchsorted(t, t[starts] + seconds - 1e-6)
    ends = np.array([_next(np.isfinite(record.y[:, j]), due) for j in range(len(model.outputs))])
    latest = t[starts] + seconds + max(LATE * seconds, 1.01 * float(np.median(np.diff(t))))
    late = (ends >= n_rows) | (t[np.minimum(ends, n_rows - 1)] > latest)
    ends[late] = -1
    x = np.full((*ends.shape, len(model.states)), np.nan)
    P = np.full((*x.shape, len(model.states)), np.nan)
    for k, first in enumerate(starts.tolist()):
        last = int(ends[:, k].max())
        if last > first:
            P_first = run.covariances(slice(first, first + 1)).P_filt[0]
            mean, covariance = likelihood.forecast(record, values, run.x_filt[first], P_first, first, last)
            hit = np.flatnonzero(ends[:, k] > first)
            x[hit, k], P[hit, k] = mean[ends[hit, k] - first], covariance[ends[hit, k] - first]
    rowwise, found = VectorisedModel(model), {}
    for j, o in enumerate(model.outputs):
        good = np.flatnonzero(ends[j] >= 0)
        if good.size:
            u, y = record.u[ends[j, good]], record.y[ends[j, good], j]
            predicted = rowwise(x[j, good], u, values)[:, len(model.states) + j]
            H = rowwise.output_jacobian(x[j, good], u, values)[:, j]
            variance = np.einsum("ki,kij,kj->k", H, P[j, good], H) + run.R[j]
            found[o.name] = Forecast(t[ends[j, good]], wrap(y - predicted, o.angle), np.sqrt(variance))
    return found


def horizon_calibration(forecasts: Mapping[str, Forecast]) -> dict[str, Array]:
    """Standardised errors over the horizon by channel."""
    return {name: _standardised(f.e, f.sd, np.ones(f.e.size, dtype=bool)) for name, f in forecasts.items()}


def _standardised(e: Array, sd: Array, measured: NDArray[np.bool_]) -> Array:
    """Errors over their standard deviations; infinite where there is a measurement and the prediction of it, or its
    standard deviation, diverged: to leave these out would judge a prediction until it breaks."""
    with np.errstate(divide="ignore", invalid="ignore"):
        z = e / sd
    return np.where(measured & ~(np.isfinite(e) & ~np.isnan(sd)), np.inf, z)


def _next(there: NDArray[np.bool_], due: NDArray[np.int64]) -> NDArray[np.int64]:
    """The first measured row at or after each; n_rows where there is none."""
    rows = np.append(np.flatnonzero(there), there.size)
    return np.asarray(rows[np.searchsorted(rows, due)])


def simulation_calibration(model: Model, record: Record, run: SimulationRun) -> dict[str, Array]:
    """Predictions from the inputs alone after the first 15 s."""
    blind = record.t > record.t[0] + WARM_UP
    with np.errstate(invalid="ignore"):  # an angle that is infinite
        e = [wrap(record.y[blind, j] - run.y[blind, j], o.angle) for j, o in enumerate(model.outputs)]
    return {
        o.name: _standardised(e[j], run.sd[blind, j], np.isfinite(record.y[blind, j]))
        for j, o in enumerate(model.outputs)
    }


def pooled_calibration(parts: Sequence[Mapping[str, Array]], *, together: bool = False) -> dict[str, Calibration]:
    """Calibration of every channel over several records. ``together``: the channels share their errors, so each counts
    as many independent ones as that with the fewest has. So it is in a simulation, which is one experiment: the error
    of the heading turns every velocity over ground."""
    kept = [[z[~np.isnan(z)] for z in p.values()] for p in parts]
    counts = [[_effective(z) for z in series if z.size] for series in kept]
    least = float(sum(min(c) for c in counts if c)) if together else None
    found = {}
    for name in dict.fromkeys(n for p in parts for n in p):
        one = calibration_test([p[name] for p in parts if name in p], least)
        if one is not None:
            found[name] = one
    return found
