"""Probabilities and quantiles of the distributions that tests need, by the special functions of SciPy.

`scipy.stats` has the same functions, but its import takes a second of processor time in each command.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from seatrial.ident.numerics.linear_algebra import Array

STABLE, UNSTABLE, NOT_SHOWN = "stable", "unstable", "not shown by the data"  # stability of a motion
UNDETERMINED = 0.5  # standard error as a part of the estimate, above which the data do not determine it


def chi2_sf(x: Any, df: Any) -> Any:
    """Return the probability that a chi-squared variable with ``df`` degrees of freedom exceeds x.

    The arguments are numbers or arrays. A negative x counts as zero.
    """
    from scipy import special

    return special.chdtrc(df, np.maximum(x, 0.0))


def chi2_cdf(x: Any, df: Any) -> Any:
    """Return the probability that a chi-squared variable with ``df`` degrees of freedom is at most x.

    The arguments are numbers or arrays. A negative x counts as zero.
    """
    from scipy import special

    return special.chdtr(df, np.maximum(x, 0.0))


def chi2_isf(p: Any, df: Any) -> Any:
    """Return the value that a chi-squared variable with ``df`` degrees of freedom exceeds with the probability p.

    It is the inverse of `chi2_sf`. p is in 0 to 1: a small p gives a large value.
    """
    from scipy import special

    return special.chdtri(df, p)


def chi2_ppf(p: Any, df: Any) -> Any:
    """Return the quantile p (0 to 1) of the chi-squared distribution with ``df`` degrees of freedom."""
    from scipy import special

    return 2.0 * special.gammaincinv(0.5 * np.asarray(df), p)


def noncentrality(limit: float, df: float, power: float) -> float:
    """Return the noncentrality with which a noncentral chi-squared variable exceeds a limit with a given probability.

    Parameters
    ----------
    limit : float
        Limit, positive.
    df : float
        Degrees of freedom.
    power : float
        Probability, 0 to 1. If the central variable exceeds the limit more often, the result is NaN.
    """
    from scipy import special

    return float(special.chndtrinc(limit, df, 1.0 - power))


def student_ppf(p: Any, df: Any) -> Any:
    """Return the quantile p (0 to 1) of Student's t distribution with ``df`` degrees of freedom."""
    from scipy import special

    return special.stdtrit(df, p)


def normal_cdf(x: Any) -> Any:
    """Return the probability that a standard normal variable is at most x, a number or an array."""
    from scipy import special

    return special.ndtr(x)


def normal_ppf(p: Any) -> Any:
    """Return the quantile p (0 to 1) of the standard normal distribution."""
    from scipy import special

    return special.ndtri(p)


def fisher_sf(x: Any, df_numerator: Any, df_denominator: Any) -> Any:
    """Return the probability that a variable with Fisher's F distribution exceeds x.

    The degrees of freedom are those of the numerator and the denominator of the ratio. The arguments are numbers or
    arrays, and x is not negative.
    """
    from scipy import special

    return special.fdtrc(df_numerator, df_denominator, x)


def kolmogorov_sf(x: float) -> float:
    """Return the probability that Kolmogorov's statistic ``D sqrt(n)`` exceeds x, for large n."""
    from scipy import special

    return float(special.kolmogorov(x))


def normality_p(x: Array) -> float:
    """Return the p value of the omnibus test for a normal distribution by skewness and kurtosis.

    Parameters
    ----------
    x : Array (n,)
        Sample of at least 20 values, not all equal.

    Notes
    -----
    The test is that of D'Agostino and Pearson (1973), with the transformations to normal variables of D'Agostino (1970)
    for the skewness and of Anscombe and Glynn (1983) for the kurtosis. Their squares add up to chi-squared with two
    degrees of freedom.
    """
    n = x.size
    e = x - x.mean()
    variance = float(np.mean(e**2))
    skewness, kurtosis = float(np.mean(e**3)) / variance**1.5, float(np.mean(e**4)) / variance**2
    y = skewness * np.sqrt((n + 1) * (n + 3) / (6.0 * (n - 2)))
    beta = 3.0 * (n**2 + 27 * n - 70) * (n + 1) * (n + 3) / ((n - 2.0) * (n + 5) * (n + 7) * (n + 9))
    w = np.sqrt(2.0 * (beta - 1.0)) - 1.0
    scaled = y / np.sqrt(2.0 / (w - 1.0))
    z_skewness = np.arcsinh(scaled) / np.sqrt(0.5 * np.log(w))
    expected = 3.0 * (n - 1) / (n + 1)
    spread = np.sqrt(24.0 * n * (n - 2) * (n - 3) / ((n + 1.0) ** 2 * (n + 3) * (n + 5)))
    root = 6.0 * (n**2 - 5 * n + 2) / ((n + 7.0) * (n + 9))
    root *= np.sqrt(6.0 * (n + 3) * (n + 5) / (n * (n - 2.0) * (n - 3)))
    a = 6.0 + 8.0 / root * (2.0 / root + np.sqrt(1.0 + 4.0 / root**2))
    below = 1.0 + (kurtosis - expected) / spread * np.sqrt(2.0 / (a - 4.0))
    z_kurtosis = (1.0 - 2.0 / (9.0 * a) - np.cbrt((1.0 - 2.0 / a) / below)) / np.sqrt(2.0 / (9.0 * a))
    return float(chi2_sf(z_skewness**2 + z_kurtosis**2, 2))


def signed_rank_z(x: Array) -> float:
    """Return Wilcoxon's signed-rank statistic of a sample as a standard normal variable.

    Parameters
    ----------
    x : Array (n,)
        Sample of at least one value. Its distribution is symmetric about zero under the null hypothesis.

    Returns
    -------
    float
        Positive if large values of the sample are positive.

    Notes
    -----
    Values of equal size have ranks in the order of the sample. With few values the normal approximation is cautious:
    it is at most 2.2 for six values.
    """
    n = x.size
    rank = np.empty(n)
    rank[np.argsort(np.abs(x), kind="stable")] = np.arange(1, n + 1)
    return float((rank[x > 0.0].sum() - n * (n + 1) / 4.0) / np.sqrt(n * (n + 1) * (2 * n + 1) / 24.0))


def is_undetermined(value: float, error: float) -> bool:
    """Return whether the data do not determine a value: its standard error is more than half of its size.

    Its 95 % interval then reaches to zero, or to a multiple of the value. An error of NaN (unknown) gives False.
    """
    return bool(error > UNDETERMINED * abs(value))


def stability_of(pole: float, low: float, high: float) -> str:
    """Return what the data show of the stability of a motion, in the words of all results.

    Parameters
    ----------
    pole
        Estimate of the real part of the pole [1/s], not zero.
    low, high
        Ends of its 95 % interval [1/s]. NaN: unknown, so that the estimate alone decides.

    Returns
    -------
    str
        ``stable``, ``unstable``, or ``not shown by the data`` if the interval contains zero.
    """
    if low <= 0.0 <= high:
        return NOT_SHOWN
    return STABLE if pole < 0.0 else UNSTABLE
