"""Residual analysis: whiteness of standardised innovations, and their correlation with the inputs.

Each channel is tested on its own samples, at its own rate.

- `whiteness_test`: the portmanteau test of Ljung and Box (1978) and the cumulative periodogram (Bartlett 1955; Durbin
  1969). Both test for any departure from white noise.
- `cross_correlation` tests whether the model describes the effect of an input completely.
- `whiteness_diagnostics` measures the size of the departures: in a regression on past innovations, as a spectral line
  and by octaves. In long records a test is significant also for departures too small to matter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from seatrial.ident.numerics import (
    Array,
    chi2_cdf,
    chi2_sf,
    kolmogorov_sf,
    normal_cdf,
    normality_p,
)

SIGNIFICANCE = 1e-3  # p value below which a departure is significant
MAX_PREDICTABLE_SHARE = 0.05  # of the variance: a filter that predicted this share would have 2.5 % smaller errors
MAX_DENSITY_RATIO = 2.0  # spectral density of an octave over that of white noise, or the inverse
MAX_LAGS = 30  # of the regression on past innovations
MIN_BINS = 8  # of the lowest band, which begins at frequency zero
BLOCK_ROWS = 65536  # rows of the regression that are computed at once
OUTLIER_SDS = 6.0  # standard deviations; one in 5e8 normal innovations is larger
N_LAGS = 25  # of the reported autocorrelation
LAGS_OF_INPUT = np.linspace(0.0, 3.0, 31)  # s, lags of the correlation of innovations with an input
SAMPLES_PER_LAG = 20  # smallest number of samples for each lag of the Ljung-Box statistic


@dataclass(frozen=True)
class Whiteness:
    """Tests of one channel for whiteness.

    Attributes
    ----------
    channel, n
        Name of the channel and number of samples.
    mean, sd
        Mean and standard deviation of the standardised innovations; 0 and 1 for a right model.
    acf : Array (n_lags,)
        Autocorrelation from lag 1 on.
    band
        95 % half-width of the autocorrelation of white noise.
    ljung_box
        p value of the Ljung-Box test.
    periodogram
        p value of the test of the cumulative periodogram.
    frequency, cumulative : Array (n_frequencies,)
        Frequencies [Hz] and the cumulative periodogram there, from 0 to 1.
    normal
        p value of the normality test of D'Agostino and Pearson, NaN with fewer than 20 samples.
    outliers
        Number of standardised innovations beyond 6 standard deviations (`OUTLIER_SDS`).
    largest
        Largest absolute standardised innovation.
    """

    channel: str
    n: int
    mean: float
    sd: float
    acf: Array
    band: float
    ljung_box: float
    periodogram: float
    frequency: Array
    cumulative: Array
    normal: float
    outliers: int
    largest: float

    @property
    def white(self) -> bool:
        """Return whether the Ljung-Box and the cumulative periodogram test both pass: each p value is above 0.5 %.

        By Bonferroni's correction, white innovations fail with a probability of at most 1 %.
        """
        return 2 * min(self.ljung_box, self.periodogram) > 0.01


def whiteness_test(channel: str, t: Array, e: Array, n_lags: int = N_LAGS) -> Whiteness:
    """Test the standardised innovations of one channel for whiteness.

    Parameters
    ----------
    channel
        Name of the channel.
    t : Array (n,)
        Times [s].
    e : Array (n,)
        Standardised innovations without NaN, not all equal.
    n_lags
        Number of lags of the returned autocorrelation.

    Returns
    -------
    Whiteness
        The results. The Ljung-Box statistic uses one lag for every 20 samples, at least one and at most ``n_lags``.
    """
    n, x = e.size, e - e.mean()
    acf = autocorrelation(e, n_lags)
    rate = 1.0 / float(np.median(np.diff(t)))
    frequency, power = np.fft.rfftfreq(n, 1.0 / rate), np.abs(np.fft.rfft(x)) ** 2
    power[1 : (n + 1) // 2] *= 2.0  # one-sided: the frequency of half the rate has no negative counterpart
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
        kolmogorov_sf(distance * np.sqrt(m)),
        np.asarray(frequency[1:], dtype=np.float64),
        cumulative,
        normality_p(e) if n >= 20 else float("nan"),
        int(np.sum(np.abs(e) > OUTLIER_SDS)),
        float(np.abs(e).max()),
    )


def autocorrelation(e: Array, n_lags: int) -> Array:
    """Return the sample autocorrelation (n_lags,) of an evenly sampled series e (n,), from lag 1 on.

    The mean is subtracted. Each lag is divided by the sum of squares of all samples, not by the number of its products
    (biased estimate). The result is NaN if all samples are equal.
    """
    x = e - e.mean()
    return np.asarray([x[k:] @ x[: x.size - k] for k in range(1, n_lags + 1)] / (x @ x))


def ljung_box(acf: Array, n: int, *, n_fitted: int = 0, finite_sample: bool = False) -> float:
    """Return the p value of the portmanteau test of Ljung and Box (1978).

    Parameters
    ----------
    acf : Array (n_lags,)
        Autocorrelation from lag 1 on.
    n
        Number of samples of the series.
    n_fitted
        Number of noise parameters that were fitted to the series, below ``n_lags``. They reduce the degrees of freedom.
    finite_sample
        Whether to correct for short series. The variance of the statistic then exceeds that of chi-squared by a factor
        of about ``1 + 2 n_lags / n``. The correction uses a scaled chi-squared distribution with the same mean.

    Returns
    -------
    float
        Probability of so large a statistic for white noise, 0 to 1.
    """
    n_lags = acf.size
    q = n * (n + 2) * float(np.sum(acf**2 / (n - np.arange(1, n_lags + 1))))
    spread = 1 + 2 * n_lags / n if finite_sample else 1.0
    return float(chi2_sf(q / spread, (n_lags - n_fitted) / spread))


@dataclass(frozen=True)
class CrossCorrelation:
    """Standardised correlation of one channel's innovations with one input, at lags >= 0 (input earlier).

    Attributes
    ----------
    channel, input
        Names of channel and input.
    lags : Array (n_lags,)
        Lags [s].
    z : Array (n_lags,)
        Correlation in units of its standard deviation under independence.
    p
        Upper bound of the p value of the largest absolute z over all lags.
    largest
        Largest absolute correlation coefficient over all lags.
    """

    channel: str
    input: str
    lags: Array
    z: Array
    p: float
    largest: float


def cross_correlation(
    channel: str, t: Array, e: Array, input_name: str, t_u: Array, u: Array, coefficients: Array | None = None
) -> CrossCorrelation:
    """Correlate innovations e(t) with an input at t - lag, in units of the standard deviation under independence.

    Parameters
    ----------
    channel, input_name
        Names of channel and input.
    t, e : Array (n,)
        Times [s] and standardised innovations of the channel.
    t_u, u : Array (n_rows,)
        Times [s] and values of the input. In between it is interpolated linearly; before the first time it keeps the
        first value.
    coefficients : Array (order,)
        Autoregression of the innovations, by default that of `autoregression`.

    Returns
    -------
    CrossCorrelation
        z at lags of 0 to 3 s, 0.1 s apart, and the p value of the largest. A constant input, or constant innovations,
        give z = 0.

    Notes
    -----
    For white innovations z is standard normal, with the autocorrelation of the input between lags. Innovations
    that are autocorrelated, for example by the errors of a receiver or an estimator, make the correlation vary more
    even without an effect of the input. Its variance is then that of the product of both spectra, with the spectrum of
    the innovations from an autoregression (Ljung 1999, section 16.6). The p value is Hunter's upper bound (1976). The
    bound is tight if it is small, for every input.
    """
    sd = e.std()
    past = np.array([_centred_unit_norm(np.interp(t - lag, t_u, u)) for lag in LAGS_OF_INPUT])
    z = past @ e / sd if sd > 0 else np.zeros(LAGS_OF_INPUT.size)
    largest = float(np.abs(z).max()) / np.sqrt(e.size)
    together = np.abs(np.sum(past[1:] * past[:-1], axis=1))
    coefficients = autoregression(e) if coefficients is None else coefficients
    if coefficients.size and past[0].any():
        # The values of the first two lags are used for all; they differ only by the first seconds of the input.
        variance, covariance = _variance_for_coloured(past[:2], coefficients)
        z, together = z / np.sqrt(variance), np.full(z.size - 1, abs(covariance / variance))
    return CrossCorrelation(
        channel, input_name, LAGS_OF_INPUT, z, _largest_z_bound(float(np.abs(z).max()), together), largest
    )


def _variance_for_coloured(past: Array, coefficients: Array) -> tuple[float, float]:
    """Return variance and lag covariance of the correlation between an input and coloured (autocorrelated) innovations.

    ``past`` (2, n) has the input at two neighbouring lags, each with mean zero and Euclidean norm one. The first result
    is the variance of its correlation at the first lag, the second one the covariance of those at both lags. The
    innovations are an autoregression of variance one with ``coefficients`` (order,), latest first. For white
    innovations the variance is 1.
    """
    size = 2 * past.shape[1]
    gain = np.abs(np.fft.rfft(np.append(1.0, -coefficients), size)) ** 2
    first, second = np.fft.rfft(past, size)
    each = np.full(gain.size, 2.0)
    each[[0, -1]] = 1.0
    density = each / np.maximum(gain, np.finfo(float).tiny)
    density /= density.sum()
    return float(density @ np.abs(first) ** 2), float(density @ (first * second.conj()).real)


def _centred_unit_norm(u: Array) -> Array:
    """Return a signal u (n,) less its mean, scaled to Euclidean norm one.

    The result is zero if the signal is constant except for rounding.
    """
    size = float(np.abs(u).max(initial=0.0))
    u = u - u.mean()
    norm = float(np.sqrt(u @ u))
    return u / norm if norm > 1e-9 * size * np.sqrt(u.size) else np.zeros(u.size)


def _largest_z_bound(highest: float, neighbours: Array) -> float:
    """Return an upper bound of the probability that any |z| of the lags exceeds ``highest``.

    Each z is standard normal. ``neighbours`` (n_lags - 1,) has the correlations of neighbouring z. Hunter's bound is
    ``P(any) <= P(z_0) + sum P(z_k, not z_k-1)``. Each term of the sum is at most
    ``4 T(highest, sqrt((1 - r) / (1 + r)))`` with Owen's T, which also counts z_k-1 below ``-highest``.
    """
    rho = np.minimum(neighbours, 1.0)
    from scipy import special  # imported here: only correlations with inputs need it

    each = 4 * special.owens_t(highest, np.sqrt((1 - rho) / (1 + rho)))
    return min(1.0, float(2 * normal_cdf(-highest) + each.sum()))


class WhitenessDiagnostics(NamedTuple):
    """Size of the departures from whiteness.

    Attributes
    ----------
    predictable
        Share of the variance that past innovations predict.
    line
        Highest spectral line.
    band
        Octave with the most significant departure; octaves whose departure also is large enough to matter come first.
    """

    predictable: Predictable
    line: SpectralLine
    band: FrequencyBand

    @property
    def share(self) -> float:
        """Share of the variance, 0 to 1, that is predictable: the larger one of regression and spectral line.

        A line that is not significant counts as zero.
        """
        return max(self.predictable.share, self.line.share if self.line.p < SIGNIFICANCE else 0.0)

    @property
    def matter(self) -> bool:
        """Return whether a departure (regression on the past, spectral line or octave) is significant and large enough.

        Large enough are more than 5 % of the variance, and a factor of 2 or more in the density of an octave.
        """
        return any(part.matters for part in self)

    @property
    def significant(self) -> bool:
        """Return whether a departure (regression on the past, spectral line or octave) has a p value below 0.001.

        Small departures count too.
        """
        return any(part.p < SIGNIFICANCE for part in self)


class Predictable(NamedTuple):
    """Share of the variance of innovations that a regression on their past predicts.

    Attributes
    ----------
    share
        Share of the mean square that a constant and ``order - 1`` past values predict, adjusted for the number of
        coefficients (adjusted R^2).
    order
        Number of coefficients; 0 if no regressor improves the BIC.
    p
        p value of the likelihood ratio against white noise, corrected for the number of orders (Bonferroni).
    """

    share: float
    order: int
    p: float

    @property
    def matters(self) -> bool:
        """Return whether the predicted share of the variance is significant (p below 0.001) and above 5 %."""
        return self.p < SIGNIFICANCE and self.share > MAX_PREDICTABLE_SHARE


class SpectralLine(NamedTuple):
    """Highest spectral line: the largest bin of a periodogram.

    Attributes
    ----------
    frequency
        Frequency of the bin [cycles per sample].
    share
        Share of the variance in the bin, 0 to 1.
    p
        p value of Fisher's test for the largest bin.
    """

    frequency: float
    share: float
    p: float

    @property
    def matters(self) -> bool:
        """Return whether the line is significant (p below 0.001) and has more than 5 % of the variance."""
        return self.p < SIGNIFICANCE and self.share > MAX_PREDICTABLE_SHARE


class FrequencyBand(NamedTuple):
    """Octave of a spectrum: a band of frequencies whose upper edge is about twice the lower one.

    The lowest band of a spectrum begins at frequency zero.

    Attributes
    ----------
    low, high
        Edges of the octave [cycles per sample].
    ratio
        Mean spectral density in the band over that of white noise of the same mean square; 1 for white innovations.
    p
        Two-sided p value of the ratio for white noise, corrected for the number of bands (Bonferroni).
    """

    low: float
    high: float
    ratio: float
    p: float

    @property
    def matters(self) -> bool:
        """Return whether the spectral density in the band differs from that of white noise by a factor of 2 or more.

        The difference must also be significant (p below 0.001).
        """
        return self.p < SIGNIFICANCE and not 1 / MAX_DENSITY_RATIO < self.ratio < MAX_DENSITY_RATIO


def whiteness_diagnostics(e: Array) -> WhitenessDiagnostics:
    """Measure how far innovations depart from white noise.

    Parameters
    ----------
    e : Array (n,)
        Evenly sampled innovations with mean zero under the model, n >= 50.

    Returns
    -------
    WhitenessDiagnostics
        Departures in a regression, as a spectral line and by octaves.
    """
    found = octave_bands(e)
    return WhitenessDiagnostics(predictable_share(e), highest_line(e), min(found, key=lambda b: (not b.matters, b.p)))


def predictable_share(e: Array, most_lags: int = MAX_LAGS) -> Predictable:
    """Fit a regression of innovations e (n,) on a constant and their past, and return the predicted share of variance.

    The past is up to ``most_lags`` lags, and at most n / 10. The number of regressors has the least BIC; they enter in
    the order constant, lag 1, lag 2, ... If no regressor is chosen, the share is 0 and the p value is 1. The p value
    comes from the likelihood ratio, with a Bonferroni correction for the number of orders.
    """
    found = _regression(e, most_lags)
    n, rest, order, total = found.n, found.left, found.chosen, found.left[0]
    if order == 0:
        return Predictable(0.0, 0, 1.0)
    p = float(chi2_sf(n * np.log(total / rest[order]), order)) * (rest.size - 1)
    return Predictable(float(1 - (rest[order] / (n - order)) / (total / n)), order, min(1.0, p))


def autoregression(e: Array, most_lags: int = MAX_LAGS) -> Array:
    """Return the coefficients (order,) of the regression of innovations e (n,) on their past, latest first.

    The order has the least BIC (Schwarz 1978). It is at most ``most_lags`` and at most n / 10. The regression also has
    a constant, which is not returned. The result is empty if no lag improves the BIC, as for white innovations.
    """
    found = _regression(e, most_lags)
    if found.chosen < 2:
        return np.zeros(0)
    upper = found.factor[: found.chosen, : found.chosen].T
    return np.asarray(np.linalg.solve(upper, found.factor[-1, : found.chosen]))[1:]


class _Regression(NamedTuple):
    """Regression of innovations, scaled to mean square one, on a constant and their past values (lags).

    Attributes
    ----------
    n
        Number of rows of the regression.
    left : Array (n_orders,)
        Residual sum of squares with the first 0, 1, ... regressors: the constant, then lag 1, 2, ...
    chosen
        Number of regressors with the least BIC; 0 if none is useful.
    factor : Array (n_orders, n_orders)
        Lower Cholesky factor of Z'Z. The columns of Z are all regressors and, as the last one, the regressed variable.
    """

    n: int
    left: Array
    chosen: int
    factor: Array


def _regression(e: Array, most_lags: int) -> _Regression:
    """Regress innovations e (n,) on a constant and on past values, for all orders at once.

    The number of past values is up to ``most_lags``, and at most n / 10. The innovations are scaled to mean square one.
    """
    e = e / (np.sqrt(np.mean(e**2)) or 1.0)  # the constant regressor is one, so the scale of e has to be one too
    most = min(most_lags, e.size // 10)  # at least ten samples per lag
    windows = np.lib.stride_tricks.sliding_window_view(e, most + 1)[:, ::-1]
    n = windows.shape[0]
    gram = np.zeros((most + 2, most + 2))
    for first in range(0, n, BLOCK_ROWS):
        part = windows[first : first + BLOCK_ROWS]
        z = np.column_stack([np.ones(part.shape[0]), part[:, 1:], part[:, 0]])
        gram += z.T @ z
    total = gram[-1, -1]
    # the lags of a smooth signal are nearly collinear, hence the small term on the diagonal
    factor = np.linalg.cholesky(gram + 1e-9 * total * np.eye(most + 2))
    left = total - np.append(0.0, np.cumsum(factor[-1, :-1] ** 2))
    order = np.arange(left.size)
    return _Regression(n, left, int(np.argmin(n * np.log(left / n) + order * np.log(n))), factor)


def highest_line(e: Array) -> SpectralLine:
    """Find the highest spectral line in the periodogram of innovations e (n,), with Fisher's test (1929).

    The mean and the frequency of half the sampling rate are left out. The first of equally high lines is returned.

    The p value is the leading term of Fisher's series, which is accurate if it is small.
    """
    power = np.abs(np.fft.rfft(e))[1 : (e.size - 1) // 2 + 1] ** 2
    at = int(np.argmax(power))
    share = float(power[at] / power.sum())
    return SpectralLine((at + 1) / e.size, share, min(1.0, power.size * (1 - share) ** (power.size - 1)))


def octave_bands(e: Array) -> list[FrequencyBand]:
    """Compare the spectral density of innovations e (n,) with white noise in octaves down from half the sampling rate.

    The bands are in ascending order of frequency. The lowest band begins at frequency zero and includes the mean. The
    p values are two-sided, with a Bonferroni correction for the number of bands.
    """
    power = np.abs(np.fft.rfft(e)) ** 2 / (e @ e)
    freedom = np.full(power.size, 2.0)
    freedom[0] = 1.0
    if e.size % 2 == 0:
        freedom[-1] = 1.0
    edges = [power.size]
    while edges[0] // 2 >= MIN_BINS:
        edges.insert(0, edges[0] // 2)
    return [_test_band(power, freedom, a, b, len(edges), e.size) for a, b in zip([0, *edges], edges, strict=False)]


def _test_band(power: Array, freedom: Array, first: int, end: int, n_bands: int, n: int) -> FrequencyBand:
    """Test one band of frequencies: the bins ``first`` to ``end - 1`` of a normalised periodogram.

    Parameters
    ----------
    power : Array (n_bins,)
        Squared Fourier transform over the sum of squares of the n samples; 1 on average for white noise.
    freedom : Array (n_bins,)
        Degrees of freedom of each bin, 1 or 2.
    first, end
        First bin, and the bin after the last one.
    n_bands
        Number of bands that are tested, for the Bonferroni correction.
    n
        Number of samples.
    """
    dof = float(freedom[first:end].sum())
    square = float(power[first:end] @ freedom[first:end])
    p = 2 * n_bands * min(float(chi2_sf(square, dof)), float(chi2_cdf(square, dof)))
    return FrequencyBand(first / n, (end - 1) / n, square / dof, min(1.0, p))
