"""Sensor noise at rest: white noise plus a random walk, estimated by exact likelihood.

The model is the IMA(1,1) of thesis section 4.1:

    y_k = b(t_k) + w_k,   db = q dW,   var w = r^2,   b(0) unknown

Here y is the output of one axis, b its random walk and w its white noise. The innovation form of the model is
``y_k = (1 + c z^-1) / (1 - z^-1) e_k`` with the innovations e. The filter is that of
``seatrial.ident.estimation.likelihood``, so that missing samples do not matter. At long gaps the samples are cut. If
the innovations under this model are not white (``seatrial.ident.validation.whiteness``), the sensor has other noise,
and ``NoiseFit.rejected`` is true. The filtered output of a single-point GPS receiver is an example.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np

from seatrial.ident.data import Channel, Record, silent_times
from seatrial.ident.estimation import Likelihood, fit
from seatrial.ident.model import INF, Model, ModelKind, Output, Parameter, Sensor, State, plain_model
from seatrial.ident.numerics import Array
from seatrial.ident.validation import WhitenessDiagnostics, autocorrelation, ljung_box, whiteness_diagnostics

NOISE_FLOOR = 1e-4  # of the scale, the standard deviation of the differences of samples; smaller noise counts as zero
N_LAGS = 20  # of the Ljung-Box test of the innovations
# Standard deviation of the unknown initial offset, in units of the channel's scale. A fitted offset would draw the
# white noise to zero, because the likelihood of the first sample is then unbounded.
INITIAL_SD = 1e3
Z95_ONE_SIDED = 1.645
PILE_UP = 17.0  # n walk sqrt(interval) / white, above which a random walk is found in 95 of 100 records
HEAVY = 4.0  # kurtosis (normal: 3) above which standard errors are wrong by a fifth or more
COARSE = 2.0  # resolution in standard deviations of the innovations, above which quantisation hides the noise
N_SEGMENTS = 8  # half-overlapping segments of Welch's method


@dataclass(frozen=True)
class NoiseFit:
    """White noise and random walk of one axis of a sensor at rest, as estimated from its samples.

    "unit" is the unit of the samples.

    Attributes
    ----------
    name
        Name of the axis.
    n
        Number of samples.
    interval
        Median sample interval [s].
    white, white_error
        Standard deviation of the white noise [unit] and its standard error. The error is NaN if no white noise was
        found (see ``flags``).
    walk, walk_error
        Intensity of the random walk [unit/sqrt(s)] and its standard error. The error is NaN if no random walk was found
        (see ``flags``).
    c, sd_innovation
        Coefficient c, -1 to 0, of the innovation form at the median interval, and standard deviation [unit] of the
        innovations (one-step prediction errors). -1: no random walk; 0: no white noise.
    log_likelihood
        Log-likelihood of the samples.
    innovations : Array (n,)
        Innovations divided by their standard deviation.
    t : Array (n,)
        Times from the first sample [s].
    resolution
        Median step between neighbouring distinct values of the samples, in ascending order [unit].
    ljung_box
        p value of the Ljung-Box test of the innovations.
    largest_correlation
        Autocorrelation of the innovations with the largest absolute value.
    departures
        Measures of the departure of the innovations from white noise, each with a p value.
    flags
        Problems of the estimates, as texts ``white: PROBLEM`` or ``walk: PROBLEM``. An example is an estimate at its
        bound: no such noise was found.
    """

    name: str
    n: int
    interval: float
    white: float
    white_error: float
    walk: float
    walk_error: float
    c: float
    sd_innovation: float
    log_likelihood: float
    innovations: Array
    t: Array
    resolution: float
    ljung_box: float
    largest_correlation: float
    departures: WhitenessDiagnostics
    flags: tuple[str, ...]

    @property
    def white_limit(self) -> float:
        """Detection limit: standard deviation of white noise [unit] that would be found in 95 of 100 such records.

        The limit holds beside the estimated random walk, with which it increases. Near zero, the coefficient c of the
        innovation form has a standard error of ``1 / sqrt(n)``.
        """
        c = min(Z95_ONE_SIDED / float(np.sqrt(self.n)), 0.5)
        return self.walk * float(np.sqrt(self.interval * c)) / (1 - c)

    @property
    def walk_limit(self) -> float:
        """Detection limit: random walk [unit/sqrt(s)] that would be found in 95 of 100 such records.

        The limit holds beside the estimated white noise, to which it is proportional. A random walk is not found if the
        estimate of the coefficient c is exactly -1. The probability of this depends only on
        ``n walk sqrt(interval) / white`` (Shephard and Harvey 1990).
        """
        return PILE_UP * self.white / (self.n * float(np.sqrt(self.interval)))

    @property
    def kurtosis(self) -> float:
        """Kurtosis of the innovations; 3 for normal innovations."""
        return _kurtosis(self.innovations)

    @property
    def heavy_tailed(self) -> bool:
        """Return whether the innovations have heavy tails: kurtosis above 4, and above 3 by six standard errors."""
        return _heavy_tailed(self.innovations)

    @property
    def coarse(self) -> bool:
        """Return whether the resolution of the samples exceeds two standard deviations of the innovations.

        In that case the estimates depend on the resolution instead of the noise.
        """
        return self.resolution > COARSE * self.sd_innovation

    @property
    def rejected(self) -> bool:
        """Return whether the model white noise plus random walk is rejected, because the innovations are not white.

        One departure from whiteness is enough, if it is significant (p below 0.001) and large: a predictable share or a
        spectral line with more than 5 % of the variance, or a density in an octave that is wrong by a factor of 2.
        """
        return self.departures.matter

    def psd(self, frequency: Array) -> Array:
        """Return the one-sided power spectral density (n,) [unit^2/Hz] of the fitted noise at ``frequency`` (n,) [Hz].

        It is the density of sampled white noise plus a random walk, including aliasing. It is infinite at frequency
        zero.
        """
        dt = self.interval
        wave = 4.0 * np.sin(np.pi * frequency * dt) ** 2
        return np.asarray(2.0 * dt * (self.white**2 + self.walk**2 * dt / wave))


def estimate_noise(channel: Channel, name: str = "") -> NoiseFit:
    """Estimate white noise and random walk of one axis at rest.

    Parameters
    ----------
    channel
        Samples of the axis. Samples that are not finite, or whose time is not later than that of the sample before,
        are left out. The samples are cut at gaps (`silent_times`: longer than 60 s and than ten usual intervals), and
        each part has its own unknown offset.
    name
        Name of the axis for the result and for messages; by default the source of the channel.

    Returns
    -------
    NoiseFit
        Estimates and tests. If the innovations have heavy tails, the standard errors are increased accordingly.

    Raises
    ------
    ValueError
        If fewer than 50 samples remain, or if all differences of neighbouring samples are equal, for example zero.

    Notes
    -----
    A random walk does not describe the change over a gap: the sensor may have been switched off, or have cooled down.
    """
    name = name or channel.source or "channel"
    good = np.isfinite(channel.value) & np.isfinite(channel.t) & np.append(True, np.diff(channel.t) > 0)
    t, y = channel.t[good], channel.value[good]
    if t.size < 50:
        raise ValueError(
            f"{name}: {t.size} samples are too few to separate white noise from a random walk; record at least 50"
        )
    dt = float(np.median(np.diff(t)))
    parts = _parts(t, y)
    scale = float(np.std(_differences(y, parts)))
    if scale == 0:
        raise ValueError(
            f"{name}: all samples have the same value, so there is no noise to estimate; check that the sensor works, "
            "or record with a finer resolution"
        )
    y = (y - y[0]) / scale  # values near one for any unit
    model = _model_with_initial_values(_differences(y, parts), dt)
    empty = (np.empty((part.stop - part.start, 0)) for part in parts)
    records = [
        Record(name, t[part] - t[part.start], none, none, (y[part] - y[part.start])[:, None], (), ("y",))
        for part, none in zip(parts, empty, strict=True)
    ]
    found = fit(model, records)
    likelihood = Likelihood(found.model)
    runs = [likelihood.filter(*pair) for pair in zip(records, found.record_values, strict=True)]
    (white, white_error), (walk, walk_error) = (found.estimate(n) for n in ("white", "walk"))
    c, sd = innovation_form(white, walk, dt)
    eps = np.concatenate([run.standardised[:, 0] for run in runs])
    # Factor of the standard error of a variance for innovations of this kurtosis: a single jump is one event, not n.
    spread = float(np.sqrt((_kurtosis(eps) - 1.0) / 2.0)) if _heavy_tailed(eps) else 1.0
    acf = autocorrelation(eps, N_LAGS)
    p, largest = ljung_box(acf, eps.size, n_fitted=2), float(acf[np.argmax(np.abs(acf))])  # white and walk
    flags = tuple(f"{n}: {flag}" for n, flag in found.flags)
    return NoiseFit(
        name,
        t.size,
        dt,
        white * scale,
        white_error * spread * scale,
        walk * scale,
        walk_error * spread * scale,
        c,
        sd * scale,
        found.log_likelihood - t.size * float(np.log(scale)),
        eps,
        t - t[0],
        float(np.median(np.diff(np.unique(y)))) * scale,
        p,
        largest,
        whiteness_diagnostics(eps),
        flags,
    )


def _parts(t: Array, y: Array) -> list[slice]:
    """Return the index range of each part of a signal between its gaps, as slices; one slice if it has no gap.

    ``t``, ``y``: times [s] and values (n,) of the signal. A gap is longer than 60 s and than ten usual intervals.
    """
    edges = [0, *(int(np.searchsorted(t, end)) for _, end in silent_times({"": Channel(t, y)})), t.size]
    return [slice(a, b) for a, b in pairwise(edges)]


def longest_part(channel: Channel) -> Channel:
    """Return the longest part of a channel between its gaps (longer than 60 s and than ten usual intervals)."""
    longest = max(_parts(channel.t, channel.value), key=lambda part: part.stop - part.start)
    return Channel(channel.t[longest], channel.value[longest], channel.unit, channel.source)


def _differences(y: Array, parts: Sequence[slice]) -> Array:
    """Return the differences of neighbouring samples of y (n,) within each of the ``parts``, joined to one array.

    Differences across a gap between two parts are left out.
    """
    return np.concatenate([np.diff(y[part]) for part in parts])


def _kurtosis(e: Array) -> float:
    """Return the kurtosis (fourth moment over squared variance) of e (n,), whose mean is zero; 3 for a normal e."""
    return float(np.mean(e**4) / np.mean(e**2) ** 2)


def _heavy_tailed(e: Array) -> bool:
    """Return whether the kurtosis of e (n,) is above 4 and exceeds 3, that of normal samples, by six standard errors.

    Fewer than one record of normal noise in a thousand does so by chance.
    """
    return _kurtosis(e) > max(HEAVY, 3.0 + 6.0 * float(np.sqrt(24.0 / e.size)))


def innovation_form(white: float, walk: float, dt: float) -> tuple[float, float]:
    """Convert white noise plus a random walk to the innovation form of the IMA(1,1), by its steady Kalman filter.

    Parameters
    ----------
    white
        Standard deviation of the white noise [unit].
    walk
        Intensity of the random walk [unit/sqrt(s)]. It must not be zero together with ``white``.
    dt
        Sample interval [s].

    Returns
    -------
    tuple of float
        Coefficient c, -1 to 0, and standard deviation s of the innovations [unit].

    Notes
    -----
    The differences of the samples have the variance ``q^2 dt + 2 r^2 = (1 + c^2) s^2``, and neighbouring differences
    have the covariance ``-r^2 = c s^2``, with random walk q and white noise r.
    """
    q, r = walk**2 * dt, white**2
    S = (q + 2 * r + np.sqrt(q * (q + 4 * r))) / 2
    return float(-r / S), float(np.sqrt(S))


def _model_with_initial_values(d: Array, dt: float) -> Model:
    """Return the noise model with initial values for a fit to samples at the interval ``dt`` [s].

    ``d`` (n,): differences of neighbouring samples, which are scaled so that d has the standard deviation 1. The
    initial values of random walk q and white noise r follow from the variance of d, ``q^2 dt + 2 r^2``, and the
    covariance of neighbouring differences, ``-r^2``.
    """
    variance, covariance = float(d @ d) / d.size, float(d[1:] @ d[:-1]) / (d.size - 1)
    white = np.sqrt(np.clip(-covariance, 1e-4 * variance, 0.4999 * variance))
    walk = np.sqrt(max(variance - 2 * white**2, 1e-5 * variance) / dt)
    low = NOISE_FLOOR / np.sqrt(dt)
    return noise_model(low).with_values({"white": float(white), "walk": float(max(walk, 2 * low))})


@cache
def noise_model(low_walk: float) -> Model:
    """Return the model of the noise of one axis at rest: white noise plus a random walk from an unknown offset.

    It is a model of scaled samples: samples divided by the standard deviation of their differences. The result is
    cached.

    Parameters
    ----------
    low_walk
        Lower bound of the random walk [1/sqrt(s)]. An estimate at this bound counts as zero. The lower bound of the
        white noise is 0.0001.
    """
    model = plain_model(
        "noise",
        f=lambda x, u, p: {"b": 0.0},
        h=lambda x, u, p: {"y": x.b},
        states=(State("b", noise="walk", x0=0.0, sd0=INITIAL_SD),),
        inputs=(),
        sensors=(Sensor("sensor", (Output("y", noise="white"),)),),
        parameters=(
            Parameter("white", 1.0, meaning="white noise", transform="log", bounds=(NOISE_FLOOR, INF)),
            Parameter("walk", 2 * low_walk, meaning="random walk", transform="log", bounds=(low_walk, INF)),
        ),
    )
    return replace(model, kind=ModelKind.NOISE)


@dataclass(frozen=True)
class BandSpectrum:
    """One-sided power spectral density, averaged over frequency bands.

    Attributes
    ----------
    frequency : Array (n_bands,)
        Geometric mean of the frequencies in each band [Hz].
    psd : Array (n_bands,)
        Mean density [unit^2/Hz].
    low, high : Array (n_bands,)
        95 % interval of the true density [unit^2/Hz].
    """

    frequency: Array
    psd: Array
    low: Array
    high: Array


def band_spectrum(frequency: Array, density: Array, n_segments: int = N_SEGMENTS, per_decade: int = 10) -> BandSpectrum:
    """Average a power spectral density of `welch` over bands of equal width in the logarithm of the frequency.

    Parameters
    ----------
    frequency : Array (n,)
        Frequencies [Hz], evenly spaced, above zero.
    density : Array (n,)
        One-sided density [unit^2/Hz].
    n_segments
        Number of segments of the signal that `welch` averaged.
    per_decade
        Number of bands per decade.

    Returns
    -------
    BandSpectrum
        Mean density of each band with its 95 % interval. Bands without a frequency are left out.

    Notes
    -----
    The interval is that of chi-squared with the degrees of freedom of half-overlapping Hann windows (Welch 1967). The
    amplitudes of neighbouring segments have a correlation of 1/6. Those of neighbouring frequencies have a correlation
    of 2/3, and those of the next frequencies one of 1/6. The correlations of the powers are the squares of these.
    """
    band = np.floor(per_decade * np.log10(frequency) + 0.5)
    _, first, size = np.unique(band, return_index=True, return_counts=True)
    psd = np.add.reduceat(density, first) / size
    segments = n_segments / (1 + 2 * (1 - 1 / n_segments) / 36)
    freedom = 2 * segments * size / (1 + 2 * (1 - 1 / size) * 4 / 9 + 2 * np.maximum(1 - 2 / size, 0.0) / 36)
    from scipy import special

    low, high = (freedom * psd / special.chdtri(freedom, p) for p in (0.025, 0.975))
    middle = np.exp(np.add.reduceat(np.log(frequency), first) / size)
    return BandSpectrum(middle, psd, low, high)


def welch(channel: Channel, n_segments: int = N_SEGMENTS) -> tuple[Array, Array]:
    """Return the one-sided power spectral density of an evenly sampled channel by Welch's method (1967).

    Parameters
    ----------
    channel
        Samples of the channel. Only the longest part between gaps (`silent_times`) is used.
    n_segments
        Number of half-overlapping segments. A straight line is subtracted from each. With few samples there are fewer
        segments, because a segment has at least 16 samples; fewer than 16 samples are one segment.

    Returns
    -------
    tuple of Array (n,)
        Frequencies [Hz] and density [unit^2/Hz], without frequency zero.
    """
    part = longest_part(channel)
    value, dt = part.value, float(np.median(np.diff(part.t)))
    length = max(16, int(2 * value.size / (n_segments + 1)))
    from scipy import signal  # imported here: it takes more than a second

    frequency, density = signal.welch(value, 1.0 / dt, nperseg=min(length, value.size), detrend="linear")
    return frequency[1:], density[1:]
