"""Autocorrelation of series: integrated autocorrelation time, effective sample size, standard error by blocks.

The variance of a mean and the variance of a mean of squares differ, so that there are two quantities:

- A mean of n samples is as accurate as a mean of ``n / tau`` independent ones, with ``tau = 1 + 2 sum rho_k``
  (`integrated_autocorrelation_time`).
- A mean of n squares of a normal series is as accurate as a mean of ``n / (1 + 2 sum rho_k^2)`` independent ones
  (Bartlett 1946; `effective_sample_size`).

The estimates of rho_k are noisy, so that the sum has to end somewhere. Two rules are used: the *window* of Sokal (1997,
section 3) for the contributions of rows to a gradient, and the *initial positive sequence* of Geyer (1992) for
measurements that drift, whose correlation is longer than a window.

A window ends before a long and weak tail, such as one per cent over hundreds of samples, which may contain most of the
variance of a sum. In sums over more and more samples the tail is no longer weak. `correlation_length` therefore tests
these sums, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from seatrial.ident.numerics.linear_algebra import Array

WINDOW = 5.0  # length of the window in autocorrelation times (Sokal 1997, section 3)
LEAST_SUMS = 24  # smallest number of sums whose correlation is estimated
# Correlations that exceed so many standard errors are significant: of samples, and of sums. The limit for sums is
# higher since many lengths are tried.
CORRELATED, CORRELATED_SUMS = 2.0, 3.3
# The autocorrelation time of white noise hardly exceeds 1 by more standard errors; its distribution is skewed upwards.
UNLIKELY = 4.0
MIN_SAMPLES = 3  # a shorter series counts as uncorrelated
Truncation = Literal["window", "positive"]


def autocovariance(x: Array) -> Array:
    """Return the sums of x_k x_k+lag over k, for the lags 0 to n - 1 (n,), of a series x (n,) with zero mean.

    The sums are not circular: the sum at a lag has n - lag products. They are not divided by their number or by n. The
    mean is not subtracted.
    """
    size = 1 << (2 * x.size - 1).bit_length()
    return np.asarray(np.fft.irfft(np.abs(np.fft.rfft(x, size)) ** 2, size)[: x.size])


def integrated_autocorrelation_time(series: Sequence[Array], truncation: Truncation = "window") -> float:
    """Return ``1 + 2 sum rho_k`` in samples, from the pooled autocorrelations rho_k of all series.

    Parameters
    ----------
    series : arrays (n,)
        Evenly sampled series of the same kind. At least one, none of them empty; the lengths may differ. Their means
        are subtracted.
    truncation
        Rule by which the sum ends: ``window`` (Sokal) or ``positive`` (initial positive sequence of Geyer).

    Returns
    -------
    float
        About 1 for white noise, and never less. It is 1 for constant series, or if any series has a NaN. By the window,
        it is the number of samples of the longest series if the correlation does not end.
    """
    longest = max(x.size for x in series)
    covariance = np.zeros(longest)
    for x in series:
        covariance[: x.size] += autocovariance(x - x.mean())
    if not covariance[0] > 0.0:
        return 1.0
    rho = covariance / covariance[0]
    return max(_time_by_window(rho) if truncation == "window" else _time_by_initial_positive(rho), 1.0)


def correlation_length(series: Sequence[Array]) -> float:
    """Return the correlation length m [samples] of all series together; zero for white noise.

    It determines how long blocks have to be: the sums of blocks of L samples miss a share ``m / 2L`` of the variance of
    the sum of all samples.

    Parameters
    ----------
    series : arrays (n,)
        Series of the same kind. Exact zeros are not samples, but rows between the samples of a slow sensor. The length
        counts these rows too. The mean of the samples of each series is subtracted.

    Returns
    -------
    float
        Zero also for fewer than three samples, and if no correlation is significant.

    Notes
    -----
    The length of first-order noise is ``tau - 1 / tau``, with tau the integrated autocorrelation time; other noise is
    treated alike. A first estimate uses tau of the samples, by Sokal's window. A second estimate uses the correlation
    of neighbouring sums over 2, 4, 8, ... samples. It replaces the first one if it is significantly longer.
    """
    kept = [x[x != 0.0] for x in series]
    n, rows = sum(x.size for x in kept), sum(x.size for x in series)
    if n < MIN_SAMPLES:
        return 0.0
    tau = integrated_autocorrelation_time([x for x in kept if x.size])
    error, of_white = (t * np.sqrt(2.0 * (2.0 * WINDOW * t + 1.0) / n) for t in (tau, 1.0))  # Sokal, 3.19
    z = max(_lag_one_correlation(kept)[1], (tau - 1.0) / error)
    # The standard error of a long time is about as large as the time itself, so that z stays small. Such a time is
    # significant nevertheless if white noise would hardly give one as long.
    found, length = tau - 1.0 / tau if z > CORRELATED or tau - 1.0 > UNLIKELY * of_white else 0.0, 2
    while n >= LEAST_SUMS * length:
        sums = [x[: x.size // length * length].reshape(-1, length).sum(axis=1) for x in kept]
        rho, z = _lag_one_correlation(sums)
        # for sums of first-order noise, accurate to 5 % up to the correlation length
        by_sums = length * 8.0 / 3.0 * rho / (1.0 - rho**2)
        if z > CORRELATED_SUMS and by_sums * (1.0 - 2.0 / z) > found:
            found = by_sums
        length *= 2
    return float(found * rows / n)


def _lag_one_correlation(series: Sequence[Array]) -> tuple[float, float]:
    """Return the correlation of neighbouring samples, -1 to 1, and its ratio to its standard error.

    Neighbours are successive samples of one series. The correlation is that of all series together, each without its
    mean. The standard error is that of white noise. Empty series are ignored. The result is (0, 0) if there is no pair
    of neighbours, or if all samples of a series are equal in every series.
    """
    centred = [x - x.mean() for x in series if x.size]
    pairs = np.concatenate([np.zeros(1), *(x[1:] * x[:-1] for x in centred)])
    power, error = sum(float(x @ x) for x in centred), float(np.sqrt(pairs @ pairs))
    return (float(pairs.sum()) / power, float(pairs.sum()) / error) if error > 0.0 else (0.0, 0.0)


def _time_by_window(rho: Array) -> float:
    """Return the integrated autocorrelation time [samples] by Sokal's window, from rho (n,) at the lags 0 to n - 1.

    It is ``tau(m) = 1 + 2 sum rho_k`` over the lags 1 to m, at the smallest m with ``m >= 5 tau(m)``. If there is no
    such m, return n.
    """
    tau = 2.0 * np.cumsum(rho) - 1.0
    enough = np.flatnonzero(np.arange(rho.size) >= WINDOW * tau)
    return float(tau[enough[0]] if enough.size else rho.size)


def _time_by_initial_positive(rho: Array) -> float:
    """Return the integrated autocorrelation time [samples] by Geyer's initial positive sequence.

    The autocorrelations rho (n,), from lag 0 on, are added in pairs; a single last one is left out. The sequence of
    these sums ends before the first one that is not positive. Each sum that exceeds an earlier one is replaced by the
    earlier one, since the true sums of a reversible chain are positive and decrease. The result is twice the total of
    the sums, minus 1. It may be below 1, and is -1 if the first sum is not positive.
    """
    pairs = rho[: rho.size // 2 * 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs <= 0)
    pairs = np.minimum.accumulate(pairs[: negative[0]] if negative.size else pairs)
    return float(2.0 * pairs.sum() - 1.0)


def effective_sample_size(z: Array) -> float:
    """Return the number of independent samples whose mean of squares is as accurate as that of z.

    Parameters
    ----------
    z : Array (n,)
        Evenly sampled series with zero mean.

    Returns
    -------
    float
        Number between 1 and n. It is n for fewer than three samples (0 without samples), and if all samples are zero.

    Notes
    -----
    The squares of the autocorrelations are summed up to the first that is within its noise, ``2 / sqrt(n)``. That one
    is left out.
    """
    n, power = z.size, float(z @ z)
    if n < MIN_SAMPLES or power == 0.0:
        return float(n)
    rho = autocovariance(z)[1:] / power
    small = np.flatnonzero(np.abs(rho) < 2.0 / np.sqrt(n))
    rho = rho[: small[0]] if small.size else rho
    return float(max(n / (1.0 + 2.0 * np.sum(rho**2)), 1.0))


def block_error(x: Array, n_blocks: int = 10) -> float:
    """Return the standard error of the mean of x (n,) from the scatter of the means of blocks.

    It includes slow drifts that autocorrelations lose in noise.

    Parameters
    ----------
    x : Array (n,)
        Evenly sampled measurements, at least one for each block.
    n_blocks
        Number of blocks of (nearly) equal length, at least two.
    """
    means = [part.mean() for part in np.array_split(x, n_blocks)]
    return float(np.std(means, ddof=1) / np.sqrt(n_blocks))


def mean_error(x: Array) -> tuple[float, float]:
    """Return the standard error of the mean of evenly sampled measurements, and their autocorrelation time [samples].

    The error is the larger of two: by the integrated autocorrelation time, and by the scatter of the means of ten
    blocks (of half as many blocks as samples below 20 samples).

    Parameters
    ----------
    x : Array (n,)
        The measurements, at least four.

    Returns
    -------
    error : float
        Standard error, in the unit of x.
    tau : float
        Integrated autocorrelation time [samples], at least 1.
    """
    tau = integrated_autocorrelation_time([x], "positive")
    by_tau = float(x.std(ddof=1)) * float(np.sqrt(tau / x.size))
    return max(by_tau, block_error(x, min(10, x.size // 2))), tau
