"""Sensor noise at rest: white noise plus a random walk, the IMA(1,1) of thesis section 4.1, by exact likelihood.

    y_k = b(t_k) + w_k,   db = q dW,   var w = r^2,   b(0) unknown

In innovation form ``n_k = (1 + c q^-1) / (1 - q^-1) e_k``. The filter is that of ``ident.estimation.likelihood``, so
that gaps in time do not matter. Where the innovations are not white under this model (``ident.validation.whiteness``),
as of the filtered output of a single-point GPS receiver, the sensor has other noise, and ``NoiseFit.rejected`` says so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy import signal

from ident.data import Channel, Record
from ident.estimation import Likelihood, fit
from ident.model import INF, Model, ModelKind, Output, Parameter, Sensor, State, plain_model
from ident.numerics import Array
from ident.validation import WhitenessDiagnostics, autocorrelation, ljung_box, whiteness_diagnostics

NOISE_FLOOR = 1e-4  # of the channel's scale: a standard deviation below this is zero
N_LAGS = 20  # of the Ljung-Box test of the innovations


@dataclass(frozen=True)
class NoiseFit:
    """One axis. white [unit] and walk [unit/sqrt(s)] with standard errors (NaN: none was found, see ``flags``);
    bias [unit] at the start; interval [s] the median between samples; c, sd_innovation of the innovation form at
    that interval; innovations (n,) standardised; ljung_box: p value; largest_correlation of the innovations;
    departures: by how much they are not white."""

    name: str
    n: int
    interval: float
    white: float
    white_error: float
    walk: float
    walk_error: float
    bias: float
    bias_error: float
    c: float
    sd_innovation: float
    log_likelihood: float
    innovations: Array
    ljung_box: float
    largest_correlation: float
    departures: WhitenessDiagnostics
    flags: tuple[str, ...]

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
    """White noise and random walk of one axis at rest. Samples that are NaN are left out."""
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
    (white, white_error), (walk, walk_error), (bias, bias_error) = (
        found.estimate(n) for n in ("white", "walk", "bias"))
    c, sd = innovation_form(white, walk, dt)
    eps = run.standardised[:, 0]
    acf = autocorrelation(eps, N_LAGS)
    p, largest = ljung_box(acf, eps.size, n_fitted=2), float(acf[np.argmax(np.abs(acf))])  # white and walk
    flags = tuple(f"{n}: {what}" for n, what in found.flags)
    return NoiseFit(
        name, t.size, dt, white * scale, white_error * scale, walk * scale, walk_error * scale,
        bias * scale + float(channel.value[good][0]), bias_error * scale, c, sd * scale,
        found.log_likelihood - t.size * float(np.log(scale)), eps, p, largest, whiteness_diagnostics(eps),
        flags)


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
        states=(State("b", noise="walk", x0="bias", sd0=0.0),),
        inputs=(),
        sensors=(Sensor("sensor", (Output("y", noise="white"),)),),
        parameters=(
            Parameter("white", 1.0, meaning="white noise", transform="log", bounds=(NOISE_FLOOR, INF)),
            Parameter("walk", 2 * low_walk, meaning="random walk", transform="log", bounds=(low_walk, INF)),
            Parameter("bias", 0.0, meaning="offset at the start"),
        ),
    )
    return replace(model, kind=ModelKind.NOISE)


def welch(channel: Channel, n_segments: int = 8) -> tuple[Array, Array]:
    """Frequency [Hz] and one-sided density [unit^2/Hz] of evenly sampled data, by Welch's method (1967)."""
    dt = float(np.median(np.diff(channel.t)))
    length = max(16, int(2 * channel.value.size / (n_segments + 1)))
    frequency, density = signal.welch(channel.value, 1.0 / dt, nperseg=min(length, channel.value.size),
                                      detrend="linear")
    return frequency[1:], density[1:]
