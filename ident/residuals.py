"""Are the innovations white, and do they still know the inputs? Tests on standardised innovations.

Each channel is tested on its own samples, at its own rate: the Ljung-Box statistic (Ljung and Box 1978), the
cumulative periodogram (Bartlett 1955; Durbin 1969) and the cross-correlation with every input, with bands.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import signal, special, stats

Array = NDArray[np.float64]
SEGMENT = 256  # samples of a segment whose periodogram is averaged
LOWEST = 3  # bins that a mean and a slow drift leak into


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
        """By both tests together, at 1 %."""
        return 2 * min(self.ljung_box, self.periodogram) > 0.01


@dataclass(frozen=True)
class CrossCorrelation:
    """Standardised correlation of one channel's innovations with one input at lags >= 0 (input earlier)."""

    channel: str
    input: str
    lags: Array  # s
    z: Array  # correlation in units of its standard deviation under independence
    p: float  # of the largest, over all lags


def whiteness(channel: str, t: Array, e: Array, n_lags: int = 25) -> Whiteness:
    """``t`` (n,), standardised innovations ``e`` (n,), no NaN, not all the same. Ljung-Box over a lag for every twenty
    samples, ``n_lags`` at most; its statistic varies more than chi squared, by some 2 lags / n, for which p allows."""
    n, x = e.size, e - e.mean()
    acf = np.array([x[k:] @ x[: n - k] for k in range(1, n_lags + 1)]) / (x @ x)
    tested = max(1, min(n_lags, n // 20))
    q = n * (n + 2) * np.sum(acf[:tested] ** 2 / (n - np.arange(1, tested + 1)))
    spread = 1 + 2 * tested / n
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
        float(stats.chi2.sf(q / spread, tested / spread)),
        float(stats.kstwobign.sf(distance * np.sqrt(m))),
        frequency[1:],
        cumulative,
        float(stats.normaltest(e).pvalue) if n >= 20 else float("nan"),
    )


class SpectralPeak(NamedTuple):
    """The most significant peak: ``frequency`` (Hz), ``p`` over all frequencies and channels, and its ``channel``."""

    frequency: float
    p: float
    channel: str


def spectral_peak(innovations: Mapping[str, Array], dt: float) -> SpectralPeak | None:
    """The most significant narrow peak in the spectra of standardised innovations: waves, or a swinging mass.

    ``innovations`` by channel (n,), evenly spaced by ``dt`` (s), NaN where there is none. Welch's spectrum of what is
    left of a first-order autoregression, each bin over a smooth spectrum, so that innovations that are merely coloured
    make no peak; against chi squared with the degrees of freedom of half-overlapping Hann segments (Percival and
    Walden 1993, section 6.17), Bonferroni over bins and channels. None where no channel has four segments. On coloured
    noise without a peak p falls short of 0.001 in 1 % of the cases, of 1e-6 in none of 2000: ask for the latter.
    """
    found: list[SpectralPeak] = []
    seen = {name: _without_gaps(e) for name, e in innovations.items()}
    long_enough = {name: e for name, e in seen.items() if e.size >= 5 * SEGMENT // 2}
    for name, e in long_enough.items():
        x = e - e.mean()
        x = x[1:] - (x[1:] @ x[:-1]) / (x @ x) * x[:-1]
        frequency, power = signal.welch(x, 1.0 / dt, "hann", SEGMENT)
        frequency, power = frequency[LOWEST:-1], power[LOWEST:-1]
        segments = 2 * x.size // SEGMENT - 1
        dof = 36 * segments**2 / (19 * segments - 1)
        over = power / _smooth(power) * (stats.chi2.median(dof) / dof)
        at = int(np.argmax(over))
        p = float(stats.chi2.sf(over[at] * dof, dof)) * power.size * len(long_enough)
        found.append(SpectralPeak(float(frequency[at]), min(1.0, p), name))
    return min(found, key=lambda peak: peak.p, default=None)


def _without_gaps(e: Array) -> Array:
    """A missing sample is taken as what is expected of an innovation, zero; a channel with fewer samples than every
    other row is not looked at."""
    there = np.isfinite(e)
    return np.where(there, e, 0.0) if there.mean() > 0.5 else np.zeros(0)


def _smooth(power: Array) -> Array:
    """What the bins lie about, as a median: a cubic of the logarithms that no peak draws up (Huber's weights)."""
    z = np.log(np.arange(LOWEST, LOWEST + power.size))
    basis, y = np.vander(z - z.mean(), 4), np.log(power)
    weight = np.ones(y.size)
    fitted = y
    for _ in range(15):
        fitted = basis @ np.linalg.lstsq(basis * weight[:, None], y * weight, rcond=None)[0]
        sigma = 1.4826 * float(np.median(np.abs(y - fitted))) + 1e-12
        weight = np.sqrt(1.0 / np.maximum(1.0, (y - fitted) / sigma))
    return np.asarray(np.exp(fitted) * np.median(power / np.exp(fitted)))


def cross_correlation(
    channel: str, t: Array, e: Array, input_name: str, t_u: Array, u: Array, horizon: float = 3.0, n_lags: int = 31
) -> CrossCorrelation:
    """Correlation of e(t) with the input at t - lag. White innovations make z standard normal, lags correlated as the
    input's are: p is Hunter's bound (1976) on the largest of all, tight where it is small, whatever the input."""
    lags = np.linspace(0.0, horizon, n_lags)
    sd = e.std()
    past = np.array([_moved(np.interp(t - lag, t_u, u)) for lag in lags])
    z = past @ e / sd if sd > 0 else np.zeros(n_lags)
    together = np.abs(np.sum(past[1:] * past[:-1], axis=1))
    return CrossCorrelation(channel, input_name, lags, z, _any_lag(float(np.abs(z).max()), together))


def _moved(past: Array) -> Array:
    """The input less its mean, of norm one; nothing where that is the rounding of a constant."""
    size = float(np.abs(past).max(initial=0.0))
    past = past - past.mean()
    norm = float(np.sqrt(past @ past))
    return past / norm if norm > 1e-9 * size * np.sqrt(past.size) else np.zeros(past.size)


def _any_lag(highest: float, together: Array) -> float:
    """P that any of standard normal z exceeds ``highest`` on either side, from the correlations of neighbours (n - 1,).

    ``P(any) <= P(z_0) + sum P(z_k, not z_k-1)``, and that is ``4 T(highest, sqrt((1 - r) / (1 + r)))`` with Owen's T
    less what exceeds it on the other side.
    """
    rho = np.minimum(together, 1.0)
    each = 4 * special.owens_t(highest, np.sqrt((1 - rho) / (1 + rho)))
    return min(1.0, float(2 * stats.norm.sf(highest) + each.sum()))
