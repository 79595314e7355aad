"""Sensor noise at rest: white noise plus a random walk, the IMA(1,1) of thesis section 4.1, by exact likelihood.

    y_k = b(t_k) + w_k,   db = q dW,   var w = r^2,   b(0) unknown

In innovation form ``n_k = (1 + c q^-1) / (1 - q^-1) e_k``. The filter is that of
``seatrial.ident.estimation.likelihood``, so that gaps in time do not matter. Where the innovations are not white under
this model (``seatrial.ident.validation.whiteness``), as of the filtered output of a single-point GPS receiver, the
sensor has other noise, and ``NoiseFit.rejected`` says so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy import signal, special

from seatrial.ident.data import Channel, Record
from seatrial.ident.estimation import Likelihood, fit
from seatrial.ident.model import INF, Model, ModelKind, Output, Parameter, Sensor, State, plain_model
from seatrial.ident.numerics import Array
from seatrial.ident.validation import WhitenessDiagnostics, autocorrelation, ljung_box, whiteness_diagnostics

NOISE_FLOOR = 1e-4  # of the channel's scale: a standard deviation below this is zero
N_LAGS = 20  # of the Ljung-Box test of the innovations
UNKNOWN = 1e3  # of the channel's scale: what is not known of the first sample. An offset to be fitted would pull the
# white noise to zero, as the likelihood of the first sample has no bound there.
Z95_ONE_SIDED = 1.645
PILE_UP = 17.0  # n walk sqrt(interval) / white, from which a walk is found in 95 of 100 records
HEAVY = 4.0  # kurtosis above which standard errors are off by a fifth and more; 3: normal
COARSE = 2.0  # standard deviations of the innovations: with longer steps between values their noise is hardly seen
N_SEGMENTS = 8  # half-overlapping, of Welch's method


@dataclass(frozen=True)
class NoiseFit:
    """One axis. white [unit] and walk [unit/sqrt(s)] with standard errors (NaN: none was found, see ``flags``);
    white_limit, walk_limit: larger ones would have been found in 95 of 100 such records; interval [s] the median
    between samples; c, sd_innovation of the innovation form at that interval; innovations (n,) standardised, at t (n,)
    [s] from the first sample; ljung_box: p value; largest_correlation of the innovations; departures: by how much they
    are not white; resolution [unit] the median step between values that occur."""

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
        """Beside a random walk: c of the innovation form has a standard error of ``1 / sqrt(n)`` near zero."""
        c = min(Z95_ONE_SIDED / float(np.sqrt(self.n)), 0.5)
        return self.walk * float(np.sqrt(self.interval * c)) / (1 - c)

    @property
    def walk_limit(self) -> float:
        """Beside white noise: c is near -1, where its estimate is -1 itself with a probability that depends on
        ``n walk sqrt(interval) / white`` alone (Shephard and Harvey 1990)."""
        return PILE_UP * self.white / (self.n * float(np.sqrt(self.interval)))

    @property
    def kurtosis(self) -> float:
        """Of the innovations; 3 where they are normal."""
        return _kurtosis(self.innovations)

    @property
    def heavy_tailed(self) -> bool:
        """The innovations are not normal, significantly and by enough to matter."""
        return _heavy_tailed(self.innovations)

    @property
    def coarse(self) -> bool:
        """The noise is small beside the resolution, which then decides what is found of it."""
        return self.resolution > COARSE * self.sd_innovation

    @property
    def rejected(self) -> bool:
        """The innovations are not white, significantly and by enough to matter."""
        return self.departures.matter

    def psd(self, frequency: Array) -> Array:
        """One-sided density [unit^2/Hz] of the sampled noise: white plus a random walk, aliasing included."""
        dt = self.interval
        wave = 4.0 * np.sin(np.pi * frequency * dt) ** 2
        return np.asarray(2.0 * dt * (self.white**2 + self.walk**2 * dt / wave))


def estimate_noise(channel: Channel, name: str = "") -> NoiseFit:
    """White noise and random walk of one axis at rest. Samples that are NaN are left out. Where the innovations have
    heavy tails the standard errors are those of a variance with their kurtosis. Raises ValueError."""
    name = name or channel.source or "channel"
    good = np.isfinite(channel.value) & np.isfinite(channel.t) & np.append(True, np.diff(channel.t) > 0)
    t, y = channel.t[good], channel.value[good]
    if t.size < 50:
        raise ValueError(f"{name}: {t.size} samples are too few to tell white noise from a random walk")
    dt = float(np.median(np.diff(t)))
    scale = float(np.std(np.diff(y)))
    if scale == 0:
        raise ValueError(f"{name}: all samples are the same")
    y = (y - y[0]) / scale  # the numbers near one, whatever the unit
    model = _start(y, dt)
    record = Record(name, t - t[0], np.empty((t.size, 0)), np.empty((t.size, 0)), y[:, None], (), ("y",))
    found = fit(model, [record])
    run = Likelihood(found.model).filter(record, found.record_values[0])
    (white, white_error), (walk, walk_error) = (found.estimate(n) for n in ("white", "walk"))
    c, sd = innovation_form(white, walk, dt)
    eps = run.standardised[:, 0]
    # Of a variance that is estimated from innovations of this kurtosis: a single jump is one event and not n.
    spread = float(np.sqrt((_kurtosis(eps) - 1.0) / 2.0)) if _heavy_tailed(eps) else 1.0
    acf = autocorrelation(eps, N_LAGS)
    p, largest = ljung_box(acf, eps.size, n_fitted=2), float(acf[np.argmax(np.abs(acf))])  # white and walk
    flags = tuple(f"{n}: {what}" for n, what in found.flags)
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


def _kurtosis(e: Array) -> float:
    return float(np.mean(e**4) / np.mean(e**2) ** 2)


def _heavy_tailed(e: Array) -> bool:
    """Six of the standard errors that a normal one has: by chance in fewer than one record in a thousand."""
    return _kurtosis(e) > max(HEAVY, 3.0 + 6.0 * float(np.sqrt(24.0 / e.size)))


def innovation_form(white: float, walk: float, dt: float) -> tuple[float, float]:
    """c and the innovations' standard deviation of the IMA(1,1), from its steady Kalman filter.

    The differences have variance ``q^2 dt + 2 r^2 = (1 + c^2) s^2`` and covariance ``-r^2 = c s^2``; -1 <= c <= 0.
    """
    q, r = walk**2 * dt, white**2
    S = (q + 2 * r + np.sqrt(q * (q + 4 * r))) / 2
    return float(-r / S), float(np.sqrt(S))


def _start(y: Array, dt: float) -> Model:
    """Moments of the differences: variance ``q^2 dt + 2 r^2``, covariance ``-r^2``."""
    d = np.diff(y)
    variance, covariance = float(d @ d) / d.size, float(d[1:] @ d[:-1]) / (d.size - 1)
    white = np.sqrt(np.clip(-covariance, 1e-4 * variance, 0.4999 * variance))
    walk = np.sqrt(max(variance - 2 * white**2, 1e-5 * variance) / dt)
    low = NOISE_FLOOR / np.sqrt(dt)
    return noise_model(low).with_values({"white": float(white), "walk": float(max(walk, 2 * low))})


@cache
def noise_model(low_walk: float) -> Model:
    """One axis at rest, in units of its scale; ``low_walk`` [1/sqrt(s)]: a random walk below this is none."""
    model = plain_model(
        "noise",
        f=lambda x, u, p: {"b": 0.0},
        h=lambda x, u, p: {"y": x.b},
        states=(State("b", noise="walk", x0=0.0, sd0=UNKNOWN),),
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
    """Density averaged over bands of frequency: frequency [Hz], psd, low, high [unit^2/Hz] (n_bands,); low and high are
    the 95 % interval of the true one."""

    frequency: Array
    psd: Array
    low: Array
    high: Array


def band_spectrum(frequency: Array, density: Array, n_segments: int = N_SEGMENTS, per_decade: int = 10) -> BandSpectrum:
    """Average of a density of `welch` over bands of equal width in the logarithm of the frequency.

    The interval is chi-square's with the degrees of freedom of Hann windows that overlap by half (Welch 1967): the
    amplitudes of neighbouring segments have a correlation of 1/6, those of neighbouring frequencies of 2/3, and of the
    next ones of 1/6; the powers of its square.
    """
    band = np.floor(per_decade * np.log10(frequency) + 0.5)
    _, first, size = np.unique(band, return_index=True, return_counts=True)
    psd = np.add.reduceat(density, first) / size
    segments = n_segments / (1 + 2 * (1 - 1 / n_segments) / 36)
    freedom = 2 * segments * size / (1 + 2 * (1 - 1 / size) * 4 / 9 + 2 * np.maximum(1 - 2 / size, 0.0) / 36)
    low, high = (freedom * psd / special.chdtri(freedom, p) for p in (0.025, 0.975))
    middle = np.exp(np.add.reduceat(np.log(frequency), first) / size)
    return BandSpectrum(middle, psd, low, high)


def welch(channel: Channel, n_segments: int = N_SEGMENTS) -> tuple[Array, Array]:
    """Frequency [Hz] and one-sided density [unit^2/Hz] of evenly sampled data, by Welch's method (1967)."""
    dt = float(np.median(np.diff(channel.t)))
    length = max(16, int(2 * channel.value.size / (n_segments + 1)))
    frequency, density = signal.welch(
        channel.value, 1.0 / dt, nperseg=min(length, channel.value.size), detrend="linear"
    )
    return frequency[1:], density[1:]
