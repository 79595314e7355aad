"""Autocovariance, integrated autocorrelation time and effective sample size of series."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.numerics.arrays import Array

WINDOW = 5.0  # times the memory, over which it is summed (Sokal 1997, section 3)


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


def effective_sample_size(z: Array) -> float:
    """How many independent errors a series is worth; correlations count up to the first that is within its noise."""
    n, power = z.size, float(z @ z)
    if n < 3 or power == 0.0:
        return float(n)
    rho = autocovariance(z)[1:] / power
    small = np.flatnonzero(np.abs(rho) < 2.0 / np.sqrt(n))
    rho = rho[:small[0]] if small.size else rho
    return float(max(n / (1.0 + 2.0 * np.sum(rho**2)), 1.0))


def integrated_autocorrelation_time(parts: Sequence[Array]) -> float:
    """Rows that series (n,) of one kind remember: the sum of their autocorrelations, both sides; 1 for white noise."""
    longest = max(part.size for part in parts)
    covariance = np.zeros(longest)
    for part in parts:
        covariance[: part.size] += autocovariance(part - part.mean())
    if not covariance[0] > 0.0:
        return 1.0
    tau = 2.0 * np.cumsum(covariance / covariance[0]) - 1.0
    enough = np.flatnonzero(np.arange(longest) >= WINDOW * tau)
    return float(max(tau[enough[0]] if enough.size else longest, 1.0))


def autocovariance(x: Array) -> Array:
    """Sums of x_k x_k+lag for lags 0 to n - 1 (n,), of a series (n,) whose mean is zero."""
    size = 1 << (2 * x.size - 1).bit_length()
    return np.asarray(np.fft.irfft(np.abs(np.fft.rfft(x, size)) ** 2, size)[: x.size])
