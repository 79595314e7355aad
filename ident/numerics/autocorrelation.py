"""Autocorrelation of series: integrated autocorrelation time, effective sample size, standard error by blocks.

Two quantities, because the variance of a mean and that of a mean of squares differ:

- a mean of n samples is as certain as one of ``n / tau`` independent ones, ``tau = 1 + 2 sum rho_k``
  (`integrated_autocorrelation_time`);
- a mean of n squares of a normal series is as certain as one of ``n / (1 + 2 sum rho_k^2)`` (Bartlett 1946;
  `effective_sample_size`).

The sum over noisy estimates of rho_k has to end somewhere, and two rules are of use: the *window* of Sokal (1997,
section 3) for the pooled contributions to a gradient, and the *initial positive sequence* of Geyer (1992) for readings
that drift, whose correlation is long and would outlast a window.

A window ends before a tail that is long and weak, one per cent over hundreds of samples, though that may be most of the
variance of a sum. In sums over ever more samples it is no longer weak: `correlation_length` looks there, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from seatrial.ident.numerics.linear_algebra import Array

WINDOW = 5.0  # autocorrelation times that the window is long (Sokal 1997, section 3)
LEAST_SUMS = 24  # of samples, below which their correlation says nothing
# standard errors from which samples are taken to be correlated, and sums, which are tried at many lengths
CORRELATED, CORRELATED_SUMS = 2.0, 3.3
UNLIKELY = 4.0  # standard errors that white noise has, of its autocorrelation time, which scatters more to above
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


def correlation_length(series: Sequence[Array]) -> float:
    """Samples m by which blocks are cut: of the variance of the sum of all, blocks of L samples miss ``m / 2L``.

    Of first-order noise, where it is ``tau - 1 / tau``, and taken to be that of any: of the samples by their window, or
    of sums over two, four, ... of them by the correlation of neighbours, where that is longer by more than chance. Zero
    for white noise.

    Parameters: series: of one kind, each (n,); exact zeros are no samples, but the rows between those of a slow sensor.
    """
    kept = [x[x != 0.0] for x in series]
    n, rows = sum(x.size for x in kept), sum(x.size for x in series)
    if n < MIN_SAMPLES:
        return 0.0
    tau = integrated_autocorrelation_time([x for x in kept if x.size])
    error, of_white = (t * np.sqrt(2.0 * (2.0 * WINDOW * t + 1.0) / n) for t in (tau, 1.0))  # Sokal, 3.19
    z = max(_neighbours(kept)[1], (tau - 1.0) / error)
    # the error of a long time is about as large as that time itself; white noise has none that is so long
    found, length = tau - 1.0 / tau if z > CORRELATED or tau - 1.0 > UNLIKELY * of_white else 0.0, 2
    while n >= LEAST_SUMS * length:
        sums = [x[: x.size // length * length].reshape(-1, length).sum(axis=1) for x in kept]
        rho, z = _neighbours(sums)
        here = length * 8.0 / 3.0 * rho / (1.0 - rho**2)  # of sums over first-order noise, to 5 % up to its length
        if z > CORRELATED_SUMS and here * (1.0 - 2.0 / z) > found:
            found = here
        length *= 2
    return float(found * rows / n)


def _neighbours(series: Sequence[Array]) -> tuple[float, float]:
    """The correlation of neighbours in series without their means, and how many standard errors that is."""
    centred = [x - x.mean() for x in series if x.size]
    pairs = np.concatenate([np.zeros(1), *(x[1:] * x[:-1] for x in centred)])
    power, error = sum(float(x @ x) for x in centred), float(np.sqrt(pairs @ pairs))
    return (float(pairs.sum()) / power, float(pairs.sum()) / error) if error > 0.0 else (0.0, 0.0)


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
    rho = rho[: small[0]] if small.size else rho
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
