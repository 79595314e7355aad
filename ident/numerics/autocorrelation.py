"""Autocorrelation of series: integrated autocorrelation time, effective sample size, standard error by blocks.

Two quantities, because the variance of a mean and that of a mean of squares differ:

- a mean of n samples is as certain as one of ``n / tau`` independent ones, ``tau = 1 + 2 sum rho_k``
  (`integrated_autocorrelation_time`);
- a mean of n squares of a normal series is as certain as one of ``n / (1 + 2 sum rho_k^2)`` (Bartlett 1946;
  `effective_sample_size`).

The sum over noisy estimates of rho_k has to end somewhere, and two rules are of use: the *window* of Sokal (1997,
section 3) for the pooled contributions to a gradient, whose correlation is short, and the *initial positive sequence*
of Geyer (1992) for readings that drift, whose correlation is long and would outlast a window.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from ident.numerics.linear_algebra import Array

WINDOW = 5.0  # autocorrelation times that the window is long (Sokal 1997, section 3)
MIN_SAMPLES = 3  # of a series, below which its autocorrelation cannot be told from zero
Truncation = Literal["window", "positive"]


def autocovariance(x: Array) -> Array:
    """Sums of x_k x_k+lag for lags 0 to n - 1 (n,), of a series (n,) whose mean is zero."""
    size = 1 << (2 * x.size - 1).bit_length()
    return np.asarray(np.fft.irfft(np.abs(np.fft.rfft(x, size)) ** 2, size)[: x.size])


def integrated_autocorrelation_time(series: Sequence[Array], truncation: Truncation = "window") -> float:
    """``1 + 2 sum rho_k`` in samples: 1 for white noise, and never below.

    Parameters: series: of one kind, each (n,), evenly sampled; truncation: where the sum ends, see above.
    """
    longest = max(x.size for x in series)
    covariance = np.zeros(longest)
    for x in series:
        covariance[: x.size] += autocovariance(x - x.mean())
    if not covariance[0] > 0.0:
        return 1.0
    rho = covariance / covariance[0]
    return max(_window(rho) if truncation == "window" else _initial_positive(rho), 1.0)


def _window(rho: Array) -> float:
    tau = 2.0 * np.cumsum(rho) - 1.0
    enough = np.flatnonzero(np.arange(rho.size) >= WINDOW * tau)
    return float(tau[enough[0]] if enough.size else rho.size)


def _initial_positive(rho: Array) -> float:
    """Sums of neighbours are positive and fall for a reversible chain: up to the first that is not, made to fall."""
    pairs = rho[: rho.size // 2 * 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs <= 0)
    pairs = np.minimum.accumulate(pairs[: negative[0]] if negative.size else pairs)
    return float(2.0 * pairs.sum() - 1.0)


def effective_sample_size(z: Array) -> float:
    """Independent samples that a mean of squares of z (n,), of mean zero, is worth; correlations count up to the first
    that is within its noise, ``2 / sqrt(n)``."""
    n, power = z.size, float(z @ z)
    if n < MIN_SAMPLES or power == 0.0:
        return float(n)
    rho = autocovariance(z)[1:] / power
    small = np.flatnonzero(np.abs(rho) < 2.0 / np.sqrt(n))
    rho = rho[:small[0]] if small.size else rho
    return float(max(n / (1.0 + 2.0 * np.sum(rho**2)), 1.0))


def block_error(x: Array, n_blocks: int = 10) -> float:
    """Standard error of the mean of x (n,) from the scatter of block means: sees slow drifts that correlations lose in
    noise."""
    means = [part.mean() for part in np.array_split(x, n_blocks)]
    return float(np.std(means, ddof=1) / np.sqrt(n_blocks))


def mean_error(x: Array) -> tuple[float, float]:
    """Standard error of the mean of evenly sampled readings x (n,), n >= 4, and their integrated autocorrelation time
    [samples]: the larger of the errors by that time and by blocks."""
    memory = integrated_autocorrelation_time([x], "positive")
    by_memory = float(x.std(ddof=1)) * float(np.sqrt(memory / x.size))
    return max(by_memory, block_error(x, min(10, x.size // 2))), memory
