"""Are the innovations white, and do they still know the inputs? Tests on standardised innovations.

Each channel is tested on its own samples, at its own rate: the Ljung-Box statistic (Ljung and Box 1978), the
cumulative periodogram (Bartlett 1955; Durbin 1969) and the cross-correlation with every input, with bands.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal, stats

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Whiteness:
    """One channel. ``acf`` (n_lags,) from lag 1; ``band``: 95 % half-width of an ACF of white noise."""

    channel: str
    n: int
    mean: float
    sd: float
    acf: Array
    band: float
    ljung_box: float  # p value
    periodogram: float  # p value of the cumulative periodogram
    frequency: Array  # Hz
    cumulative: Array  # cumulative periodogram, 0..1
    normal: float  # p value of D'Agostino and Pearson's test

    @property
    def white(self) -> bool:
        return min(self.ljung_box, self.periodogram) > 0.01


@dataclass(frozen=True)
class CrossCorrelation:
    """Standardised correlation of one channel's innovations with one input at lags >= 0 (input earlier)."""

    channel: str
    input: str
    lags: Array  # s
    z: Array  # correlation in units of its standard deviation under independence
    p: float  # of the largest, over all lags


def whiteness(channel: str, t: Array, e: Array, n_lags: int = 25) -> Whiteness:
    """``t`` (n,), standardised innovations ``e`` (n,), no NaN."""
    n, x = e.size, e - e.mean()
    acf = np.array([x[k:] @ x[: n - k] for k in range(1, n_lags + 1)]) / (x @ x)
    q = n * (n + 2) * np.sum(acf**2 / (n - np.arange(1, n_lags + 1)))
    rate = 1.0 / float(np.median(np.diff(t)))
    frequency, power = signal.periodogram(x, rate)
    cumulative = np.cumsum(power[1:]) / power[1:].sum()
    m = cumulative.size
    distance = np.max(np.abs(cumulative - np.arange(1, m + 1) / m))
    return Whiteness(
        channel,
        n,
        float(e.mean()),
        float(e.std()),
        acf,
        1.96 / np.sqrt(n),
        float(stats.chi2.sf(q, n_lags)),
        float(stats.kstwobign.sf(distance * np.sqrt(m))),
        frequency[1:],
        cumulative,
        float(stats.normaltest(e).pvalue) if n >= 20 else float("nan"),
    )


def cross_correlation(
    channel: str, t: Array, e: Array, input_name: str, t_u: Array, u: Array, horizon: float = 3.0, n_lags: int = 31
) -> CrossCorrelation:
    """Correlation of e(t) with the input at t - lag. White innovations make z about standard normal."""
    lags = np.linspace(0.0, horizon, n_lags)
    sd = e.std()
    z = np.zeros(n_lags)
    for k, lag in enumerate(lags):
        past = np.interp(t - lag, t_u, u)
        size = float(np.abs(past).max(initial=0.0))
        past = past - past.mean()
        norm = np.sqrt(past @ past)
        moves = norm > 1e-9 * size * np.sqrt(past.size)  # else it is the rounding of a constant
        z[k] = (e @ past) / (norm * sd) if moves and sd > 0 else 0.0
    independent = max(1.0, n_lags / 3)  # neighbouring lags share most of their samples
    p = min(1.0, float(2 * stats.norm.sf(np.abs(z).max()) * independent))
    return CrossCorrelation(channel, input_name, lags, z, p)
