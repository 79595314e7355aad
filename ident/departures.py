"""By how much standardised innovations depart from white noise, and whether that can be chance.

Three ways to depart, each with the size that matters beside its p value: the share of the variance that innovations
before could predict (an autoregression, order by BIC), a narrow line (Fisher 1929), and a density off by a factor over
an octave. A long record finds every model wrong by p alone; a short one shows a large departure by chance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Array = NDArray[np.float64]
LEVEL = 1e-3  # p value below which a departure is no chance
PREDICTABLE = 0.05  # share of the variance: a filter that knew it would err by 2.5 % less
FACTOR = 2.0  # of a density over an octave
MOST_LAGS = 30
LEAST_BINS = 8  # of the lowest band, which ends at zero
ROWS = 65536  # of the regression at once


class Predictable(NamedTuple):
    """``share`` of the variance that a constant and ``order`` - 1 lags predict, adjusted for their number."""

    share: float
    order: int
    p: float

    @property
    def matters(self) -> bool:
        return self.p < LEVEL and self.share > PREDICTABLE


class Line(NamedTuple):
    """The highest line of the periodogram: ``frequency`` [cycles a sample], ``share`` of the variance in its bin."""

    frequency: float
    share: float
    p: float

    @property
    def matters(self) -> bool:
        return self.p < LEVEL and self.share > PREDICTABLE


class Band(NamedTuple):
    """An octave ``low`` to ``high`` [cycles a sample]: the density's ``ratio`` to that of white noise."""

    low: float
    high: float
    ratio: float
    p: float

    @property
    def matters(self) -> bool:
        return self.p < LEVEL and not 1 / FACTOR < self.ratio < FACTOR


class Departures(NamedTuple):
    """All three; of the octaves the one that is farthest from chance, those that matter before the others."""

    predictable: Predictable
    line: Line
    band: Band

    @property
    def share(self) -> float:
        """Of the variance, that is known to be predictable: by the regression or as a line."""
        return max(self.predictable.share, self.line.share if self.line.p < LEVEL else 0.0)

    @property
    def matter(self) -> bool:
        return any(part.matters for part in self)

    @property
    def significant(self) -> bool:
        return any(part.p < LEVEL for part in self)


def departures(e: Array) -> Departures:
    """Of innovations ``e`` (n,), evenly spaced, whose mean is zero under the model; n of 50 or more."""
    found = bands(e)
    return Departures(predictable(e), line(e), min(found, key=lambda b: (not b.matters, b.p)))


def predictable(e: Array, most_lags: int = MOST_LAGS) -> Predictable:
    """A regression on a constant and lags; p by the likelihood ratio, Bonferroni over the orders."""
    most = min(most_lags, e.size // 10)
    windows = np.lib.stride_tricks.sliding_window_view(e, most + 1)[:, ::-1]
    n = windows.shape[0]
    gram = np.zeros((most + 2, most + 2))
    for first in range(0, n, ROWS):
        part = windows[first : first + ROWS]
        z = np.column_stack([np.ones(part.shape[0]), part[:, 1:], part[:, 0]])
        gram += z.T @ z
    total = gram[-1, -1]
    factor = np.linalg.cholesky(gram + 1e-9 * total * np.eye(most + 2))  # what a smooth signal leaves is singular
    left = total - np.append(0.0, np.cumsum(factor[-1, :-1] ** 2))
    order = np.arange(left.size)
    chosen = int(np.argmin(n * np.log(left / n) + order * np.log(n)))
    if chosen == 0:
        return Predictable(0.0, 0, 1.0)
    p = float(stats.chi2.sf(n * np.log(total / left[chosen]), chosen)) * (left.size - 1)
    return Predictable(float(1 - (left[chosen] / (n - chosen)) / (total / n)), chosen, min(1.0, p))


def line(e: Array) -> Line:
    """Fisher's test (1929), the leading term of its p: exact where it is small."""
    power = np.abs(np.fft.rfft(e))[1 : (e.size - 1) // 2 + 1] ** 2
    at = int(np.argmax(power))
    share = float(power[at] / power.sum())
    return Line((at + 1) / e.size, share, min(1.0, power.size * (1 - share) ** (power.size - 1)))


def bands(e: Array) -> list[Band]:
    """Octaves from half the sampling rate down, the lowest with the mean; Bonferroni over them, both sides."""
    power = np.abs(np.fft.rfft(e)) ** 2 / (e @ e)
    freedom = np.full(power.size, 2.0)
    freedom[0] = 1.0
    if e.size % 2 == 0:
        freedom[-1] = 1.0
    edges = [power.size]
    while edges[0] // 2 >= LEAST_BINS:
        edges.insert(0, edges[0] // 2)
    return [_band(power, freedom, a, b, len(edges), e.size) for a, b in zip([0, *edges], edges, strict=False)]


def _band(power: Array, freedom: Array, first: int, end: int, n_bands: int, n: int) -> Band:
    dof = float(freedom[first:end].sum())
    square = float(power[first:end] @ freedom[first:end])
    p = 2 * n_bands * min(float(stats.chi2.sf(square, dof)), float(stats.chi2.cdf(square, dof)))
    return Band(first / n, (end - 1) / n, square / dof, min(1.0, p))
