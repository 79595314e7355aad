"""Residual analysis: whiteness of standardised innovations, and their correlation with the inputs.

Each channel is tested on its own samples, at its own rate.

- `whiteness_test`: the portmanteau test of Ljung and Box (1978) and the cumulative periodogram (Bartlett 1955; Durbin
  1969): is there any departure from white noise?
- `cross_correlation` with an input: is its effect modelled completely?
- `spectral_peak`: a narrow peak, as of waves or of an oscillation that the model lacks;
- `whiteness_diagnostics`: by how much innovations depart, in a regression on their past, as a spectral line and by
  octaves. In a long record a test sees departures that do not matter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import signal, special, stats

from seatrial.ident.numerics import NORMAL_MAD, Array

SEGMENT = 256  # samples of a segment whose periodogram is averaged (Welch)
FIRST_BIN = 3  # of such a periodogram: a mean and a slow drift leak into those before
SIGNIFICANCE = 1e-3  # p value below which a departure is no chance
MAX_PREDICTABLE_SHARE = 0.05  # of the variance: a filter that knew it would err by 2.5 % less
MAX_DENSITY_RATIO = 2.0  # of the spectral density of an octave to that of white noise, either way
MAX_LAGS = 30  # of the regression on past innovations
MIN_BINS = 8  # of the lowest band, which ends at zero
BLOCK_ROWS = 65536  # of that regression, done at once
OUTLYING = 6.0  # standard deviations: of normal innovations one in 5e8 is beyond
N_LAGS = 25  # of the autocorrelation of innovations that is shown
LAGS_OF_INPUT = np.linspace(0.0, 3.0, 31)  # s, at which innovations are correlated with an input
SAMPLES_PER_LAG = 20  # for each lag of the Ljung-Box statistic


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
    outliers: int  # beyond `OUTLYING` standard deviations
    largest: float  # absolute value

    @property
    def white(self) -> bool:
        """By both tests together at 1 % (Bonferroni): neither p value is below 0.5 %."""
        return 2 * min(self.ljung_box, self.periodogram) > 0.01


def whiteness_test(channel: str, t: Array, e: Array, n_lags: int = N_LAGS) -> Whiteness:
    """Tests of one channel's standardised innovations.

    Parameters: t (n,) [s]; e (n,), no NaN, not all the same; n_lags: of the autocorrelation that is returned. The
    Ljung-Box statistic is over a lag for every `SAMPLES_PER_LAG` samples, ``n_lags`` at most.
    """
    n, x = e.size, e - e.mean()
    acf = autocorrelation(e, n_lags)
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
        ljung_box(acf[: max(1, min(n_lags, n // SAMPLES_PER_LAG))], n, finite_sample=True),
        float(stats.kstwobign.sf(distance * np.sqrt(m))),
        frequency[1:],
        cumulative,
        float(stats.normaltest(e).pvalue) if n >= 20 else float("nan"),
        int(np.sum(np.abs(e) > OUTLYING)),
        float(np.abs(e).max()),
    )


def autocorrelation(e: Array, n_lags: int) -> Array:
    """Sample autocorrelation (n_lags,) of e (n,), evenly sampled, from lag 1 on."""
    x = e - e.mean()
    return np.asarray([x[k:] @ x[: x.size - k] for k in range(1, n_lags + 1)] / (x @ x))


def ljung_box(acf: Array, n: int, *, n_fitted: int = 0, finite_sample: bool = False) -> float:
    """p value of the portmanteau test of Ljung and Box (1978).

    Parameters: acf (n_lags,): autocorrelation from lag 1 on; n: samples that it is of; n_fitted: parameters of the
    noise model that were fitted to them; finite_sample: allow for the statistic's variance, which exceeds that of chi
    squared by some ``2 n_lags / n``, by a scaled chi squared of the same mean.
    """
    n_lags = acf.size
    q = n * (n + 2) * float(np.sum(acf**2 / (n - np.arange(1, n_lags + 1))))
    spread = 1 + 2 * n_lags / n if finite_sample else 1.0
    return float(stats.chi2.sf(q / spread, (n_lags - n_fitted) / spread))


@dataclass(frozen=True)
class CrossCorrelation:
    """Standardised correlation of one channel's innovations with one input at lags >= 0 (input earlier)."""

    channel: str
    input: str
    lags: Array  # s
    z: Array  # correlation in units of its standard deviation under independence
    p: float  # of the largest, over all lags
    largest: float  # coefficient of correlation over all lags, by its absolute value


def cross_correlation(
    channel: str, t: Array, e: Array, input_name: str, t_u: Array, u: Array, coefficients: Array | None = None
) -> CrossCorrelation:
    """Correlation of e(t) with the input at t - lag, over its standard deviation if the two are independent.

    White innovations make z standard normal, lags correlated as the input's are. Of innovations that are correlated
    among themselves, as the errors of a receiver or an estimator are, it would be wider without any input in them:
    there the variance is that of the input's spectrum times theirs, by an autoregression (Ljung 1999, section 16.6)
    with these ``coefficients``, by default those of `autoregression`. p is Hunter's bound (1976) on the largest of all,
    tight where it is small, whatever the input.
    """
    sd = e.std()
    past = np.array([_moved(np.interp(t - lag, t_u, u)) for lag in LAGS_OF_INPUT])
    z = past @ e / sd if sd > 0 else np.zeros(LAGS_OF_INPUT.size)
    largest = float(np.abs(z).max()) / np.sqrt(e.size)
    together = np.abs(np.sum(past[1:] * past[:-1], axis=1))
    coefficients = autoregression(e) if coefficients is None else coefficients
    if coefficients.size and past[0].any():
        own, neighbours = _coloured(past[:2], coefficients)  # the same at all lags, but for the first seconds
        z, together = z / np.sqrt(own), np.full(z.size - 1, abs(neighbours / own))
    return CrossCorrelation(channel, input_name, LAGS_OF_INPUT, z, _any_lag(float(np.abs(z).max()), together), largest)


def _coloured(past: Array, coefficients: Array) -> tuple[float, float]:
    """Variance of the correlation of past[0] (n,), of norm one, with an autoregression of variance one, and covariance
    with that of past[1]."""
    size = 2 * past.shape[1]
    gain = np.abs(np.fft.rfft(np.append(1.0, -coefficients), size)) ** 2
    one, other = np.fft.rfft(past, size)
    each = np.full(gain.size, 2.0)
    each[[0, -1]] = 1.0
    density = each / np.maximum(gain, np.finfo(float).tiny)
    density /= density.sum()
    return float(density @ np.abs(one) ** 2), float(density @ (one * other.conj()).real)


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
        frequency, power = frequency[FIRST_BIN:-1], power[FIRST_BIN:-1]
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
    z = np.log(np.arange(FIRST_BIN, FIRST_BIN + power.size))
    basis, y = np.vander(z - z.mean(), 4), np.log(power)
    weight = np.ones(y.size)
    fitted = y
    for _ in range(15):
        fitted = basis @ np.linalg.lstsq(basis * weight[:, None], y * weight, rcond=None)[0]
        sigma = NORMAL_MAD * float(np.median(np.abs(y - fitted))) + 1e-12
        weight = np.sqrt(1.0 / np.maximum(1.0, (y - fitted) / sigma))
    return np.asarray(np.exp(fitted) * np.median(power / np.exp(fitted)))


class WhitenessDiagnostics(NamedTuple):
    """All three; of the octaves the one that is farthest from chance, those that matter before the others."""

    predictable: Predictable
    line: SpectralLine
    band: FrequencyBand

    @property
    def share(self) -> float:
        """Of the variance, that is known to be predictable: by the regression or as a line."""
        return max(self.predictable.share, self.line.share if self.line.p < SIGNIFICANCE else 0.0)

    @property
    def matter(self) -> bool:
        return any(part.matters for part in self)

    @property
    def significant(self) -> bool:
        return any(part.p < SIGNIFICANCE for part in self)


class Predictable(NamedTuple):
    """``share`` of the variance that a constant and ``order`` - 1 lags predict, adjusted for their number."""

    share: float
    order: int
    p: float

    @property
    def matters(self) -> bool:
        return self.p < SIGNIFICANCE and self.share > MAX_PREDICTABLE_SHARE


class SpectralLine(NamedTuple):
    """The highest line of the periodogram: ``frequency`` [cycles a sample], ``share`` of the variance in its bin."""

    frequency: float
    share: float
    p: float

    @property
    def matters(self) -> bool:
        return self.p < SIGNIFICANCE and self.share > MAX_PREDICTABLE_SHARE


class FrequencyBand(NamedTuple):
    """An octave ``low`` to ``high`` [cycles a sample]: the density's ``ratio`` to that of white noise."""

    low: float
    high: float
    ratio: float
    p: float

    @property
    def matters(self) -> bool:
        return self.p < SIGNIFICANCE and not 1 / MAX_DENSITY_RATIO < self.ratio < MAX_DENSITY_RATIO


def whiteness_diagnostics(e: Array) -> WhitenessDiagnostics:
    """Of innovations ``e`` (n,), evenly spaced, whose mean is zero under the model; n of 50 or more."""
    found = bands(e)
    return WhitenessDiagnostics(predictable(e), line(e), min(found, key=lambda b: (not b.matters, b.p)))


def predictable(e: Array, most_lags: int = MAX_LAGS) -> Predictable:
    """A regression on a constant and lags; p by the likelihood ratio, Bonferroni over the orders."""
    found = _regression(e, most_lags)
    n, left, chosen, total = found.n, found.left, found.chosen, found.left[0]
    if chosen == 0:
        return Predictable(0.0, 0, 1.0)
    p = float(stats.chi2.sf(n * np.log(total / left[chosen]), chosen)) * (left.size - 1)
    return Predictable(float(1 - (left[chosen] / (n - chosen)) / (total / n)), chosen, min(1.0, p))


def autoregression(e: Array, most_lags: int = MAX_LAGS) -> Array:
    """Coefficients (order,) of the regression of e (n,) on its past, latest first; none where it is white. The order is
    that of the least BIC (Schwarz 1978)."""
    found = _regression(e, most_lags)
    if found.chosen < 2:
        return np.zeros(0)
    upper = found.factor[: found.chosen, : found.chosen].T
    return np.asarray(np.linalg.solve(upper, found.factor[-1, : found.chosen]))[1:]


class _Regression(NamedTuple):
    """On a constant and lags, ``n`` samples: ``left`` (orders,) squares with the first 0, 1, ... of them, ``chosen``:
    by BIC; ``factor``: the Cholesky factor of all their products, what is regressed last."""

    n: int
    left: Array
    chosen: int
    factor: Array


def _regression(e: Array, most_lags: int) -> _Regression:
    e = e / (np.sqrt(np.mean(e**2)) or 1.0)  # beside the constant: else what follows would depend on the unit
    most = min(most_lags, e.size // 10)
    windows = np.lib.stride_tricks.sliding_window_view(e, most + 1)[:, ::-1]
    n = windows.shape[0]
    gram = np.zeros((most + 2, most + 2))
    for first in range(0, n, BLOCK_ROWS):
        part = windows[first : first + BLOCK_ROWS]
        z = np.column_stack([np.ones(part.shape[0]), part[:, 1:], part[:, 0]])
        gram += z.T @ z
    total = gram[-1, -1]
    factor = np.linalg.cholesky(gram + 1e-9 * total * np.eye(most + 2))  # what a smooth signal leaves is singular
    left = total - np.append(0.0, np.cumsum(factor[-1, :-1] ** 2))
    order = np.arange(left.size)
    return _Regression(n, left, int(np.argmin(n * np.log(left / n) + order * np.log(n))), factor)


def line(e: Array) -> SpectralLine:
    """Fisher's test (1929), the leading term of its p: exact where it is small."""
    power = np.abs(np.fft.rfft(e))[1 : (e.size - 1) // 2 + 1] ** 2
    at = int(np.argmax(power))
    share = float(power[at] / power.sum())
    return SpectralLine((at + 1) / e.size, share, min(1.0, power.size * (1 - share) ** (power.size - 1)))


def bands(e: Array) -> list[FrequencyBand]:
    """Octaves from half the sampling rate down, the lowest with the mean; Bonferroni over them, both sides."""
    power = np.abs(np.fft.rfft(e)) ** 2 / (e @ e)
    freedom = np.full(power.size, 2.0)
    freedom[0] = 1.0
    if e.size % 2 == 0:
        freedom[-1] = 1.0
    edges = [power.size]
    while edges[0] // 2 >= MIN_BINS:
        edges.insert(0, edges[0] // 2)
    return [_band(power, freedom, a, b, len(edges), e.size) for a, b in zip([0, *edges], edges, strict=False)]


def _band(power: Array, freedom: Array, first: int, end: int, n_bands: int, n: int) -> FrequencyBand:
    dof = float(freedom[first:end].sum())
    square = float(power[first:end] @ freedom[first:end])
    p = 2 * n_bands * min(float(stats.chi2.sf(square, dof)), float(stats.chi2.cdf(square, dof)))
    return FrequencyBand(first / n, (end - 1) / n, square / dof, min(1.0, p))
