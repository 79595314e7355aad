"""Steady thrust against command: levels with honest errors, a monotone curve through them, and how a quadratic fits.

For benches that measure force and know only the command. Where the thruster saturates, is asymmetric or has a dead
band, ``c1 n|n| + c2 n^2`` (thesis section 4.2) does not hold; a monotone curve through the measured levels does:
isotonic regression (pool adjacent violators, Barlow et al. 1972) and between the levels the monotone cubic of Fritsch
and Carlson (1980). Which of them predicts better is judged by levels that were left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import interpolate, optimize, stats

from ident.dataset import Channel

Array = NDArray[np.float64]
SAME = 1e-3  # commands closer than this are one level
MIN_SAMPLES = 20


@dataclass(frozen=True)
class Levels:
    """Steady force at each command: n, force [N], se [N] (n_levels,), n_samples (n_levels,), and autocorrelation
    time [samples] of the readings (1: independent)."""

    n: Array
    force: Array
    se: Array
    n_samples: Array
    memory: Array


@dataclass(frozen=True)
class Quadratic:
    """``c1 n|n| + c2 n^2``: values, errors and covariance scaled by the misfit; rms and largest misfit [N]; chi2 with
    df degrees of freedom against the levels' own errors; rms of levels that were left out [N]."""

    c1: float
    c2: float
    covariance: Array
    rms: float
    largest: float
    at: float  # command of the largest misfit
    chi2: float
    df: int
    left_out: float

    def __call__(self, n: Array) -> Array:
        return np.asarray(self.c1 * n * np.abs(n) + self.c2 * n * n)


@dataclass(frozen=True)
class Curve:
    """A monotone curve: force [N] at the knots n, with standard errors; constant beyond the ends."""

    n: Array
    force: Array
    se: Array

    def __call__(self, n: Array) -> Array:
        return np.asarray(interpolate.PchipInterpolator(self.n, self.force)(np.clip(n, self.n[0], self.n[-1])))

    def slope(self, n: Array) -> Array:
        """d force / d n [N]; zero beyond the ends."""
        inside = (n > self.n[0]) & (n < self.n[-1])
        return np.where(inside, interpolate.PchipInterpolator(self.n, self.force).derivative()(n), 0.0)

    def error(self, n: Array) -> Array:
        """Standard error, linear between the knots."""
        return np.interp(n, self.n, self.se)


def find_levels(command: Channel, force: Channel, settle: float = 1.5) -> Levels:
    """Means of the force while the command is constant, without the first ``settle`` seconds after each change.

    A command given more than once is one level, whose error is at least the scatter between its visits.
    """
    changes = np.append(np.flatnonzero(np.diff(command.value, prepend=np.nan) != 0), command.t.size)
    visits: list[tuple[float, float, float, int, float]] = []
    for a, b in pairwise(changes):
        end = command.t[b] if b < command.t.size else np.inf
        held = force.value[(force.t >= command.t[a] + settle) & (force.t < end)]
        held = held[np.isfinite(held)]
        if held.size >= MIN_SAMPLES:
            memory = autocorrelation_time(held)
            error = max(float(held.std(ddof=1)) * np.sqrt(memory / held.size), block_error(held))
            visits.append((float(command.value[a]), float(held.mean()), float(error), held.size, memory))
    if not visits:
        raise ValueError(f"the command is nowhere held for {settle:g} s and {MIN_SAMPLES} readings of the force")
    return _merged(sorted(visits))


def _merged(visits: Sequence[tuple[float, float, float, int, float]]) -> Levels:
    table = np.array(visits)
    group = np.append(0, np.cumsum(np.diff(table[:, 0]) > SAME)).astype(int)
    rows = []
    for k in range(group[-1] + 1):
        n, force, se, count, memory = table[group == k].T
        se = np.maximum(se, 1e-9)
        weight = se**-2 / np.sum(se**-2)
        error = float(np.sum(se**-2)) ** -0.5
        if n.size > 1:
            error = max(error, float(force.std(ddof=1)) / np.sqrt(n.size))
        rows.append((n.mean(), weight @ force, error, count.sum(), memory.max()))
    return Levels(*np.array(rows).T)


def autocorrelation_time(x: Array) -> float:
    """``1 + 2 sum rho_k``, by the initial positive sequence of Geyer (1992); never below one."""
    x = x - x.mean()
    if not x.any():
        return 1.0
    size = 1 << (2 * x.size - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(x, size)) ** 2
    rho = np.fft.irfft(spectrum, size)[: x.size // 2 * 2] / np.sum(x * x)
    pairs = rho[0::2] + rho[1::2]
    negative = np.flatnonzero(pairs <= 0)
    last = int(negative[0]) if negative.size else pairs.size
    pairs = np.minimum.accumulate(pairs[:last])
    return float(max(1.0, 2.0 * pairs.sum() - 1.0))


def block_error(x: Array, n_blocks: int = 10) -> float:
    """Standard error of the mean from the scatter of block means: sees slow drifts that correlations lose in noise."""
    means = [part.mean() for part in np.array_split(x, n_blocks)]
    return float(np.std(means, ddof=1) / np.sqrt(n_blocks))


def fit_curve(levels: Levels) -> Curve:
    """Isotonic regression on the levels. A pooled knot's error covers what pooling moved it by."""
    force = optimize.isotonic_regression(levels.force, weights=levels.se**-2).x
    return Curve(levels.n, np.asarray(force), np.hypot(levels.se, force - levels.force))


def fit_quadratic(levels: Levels) -> Quadratic:
    """Least squares with equal weights: the misfit is far above the readings' errors wherever it matters."""
    theta = _quadratic(levels.n, levels.force)
    B = _basis(levels.n)
    misfit = levels.force - B @ theta
    df = max(levels.n.size - 2, 1)
    worst = int(np.argmax(np.abs(misfit)))
    weights = levels.se**-2
    best = np.linalg.lstsq(B * np.sqrt(weights)[:, None], levels.force * np.sqrt(weights), rcond=None)[0]
    return Quadratic(
        float(theta[0]),
        float(theta[1]),
        np.linalg.inv(B.T @ B) * float(misfit @ misfit) / df,
        float(np.sqrt(np.mean(misfit**2))),
        float(misfit[worst]),
        float(levels.n[worst]),
        float(np.sum(weights * (levels.force - B @ best) ** 2)),
        df,
        _left_out(levels, lambda n, f, at: _basis(at) @ _quadratic(n, f)),
    )


def curve_left_out(levels: Levels) -> float:
    """Root mean square [N] over inner levels of what the curve through all others misses them by."""
    return _left_out(levels, lambda n, f, at: np.asarray(_through(n, f)(at)))


def adequate(quadratic: Quadratic) -> bool:
    """Whether the quadratic fits within the levels' errors (chi-square, 1 %)."""
    return bool(stats.chi2.sf(quadratic.chi2, quadratic.df) > 0.01)


def _through(n: Array, force: Array) -> interpolate.PchipInterpolator:
    return interpolate.PchipInterpolator(n, optimize.isotonic_regression(force).x)


def _left_out(levels: Levels, predict: Callable[[Array, Array, Array], Array]) -> float:
    missed = []
    for k in range(1, levels.n.size - 1):
        keep = np.arange(levels.n.size) != k
        at = predict(levels.n[keep], levels.force[keep], levels.n[k : k + 1])
        missed.append(levels.force[k] - float(np.squeeze(at)))
    return float(np.sqrt(np.mean(np.square(missed)))) if missed else float("nan")


def _basis(n: Array) -> Array:
    return np.column_stack([n * np.abs(n), n * n])


def _quadratic(n: Array, force: Array) -> Array:
    return np.asarray(np.linalg.lstsq(_basis(n), force, rcond=None)[0])
