"""Noise that differs from the assumed noise, on a boat without a hidden effect.

An analysis of these boats should not report an effect.
"""

from __future__ import annotations

import numpy as np

from seatrial.mocks.plant import Gust, HiddenEffect, Maker, Noise, effect_size


def _gps(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "noise-gps": time-correlated errors of the GNSS position.

    The error of each axis is a Gauss-Markov process of standard deviation ``sigma`` [m] and correlation time 30 s.
    ``sigma`` is drawn within 15 % of ``0.3 scale``.
    """
    sigma = scale * effect_size(rng, 0.3)  # m
    parameters = {"sigma": sigma, "tau": 30.0}
    return HiddenEffect("noise-gps", "time-correlated position errors", parameters, noise=Noise(colour=(sigma, 30.0)))


def _gusts(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "noise-gusts": coloured forces whose strength changes in a period of 97 s.

    The forces X and Y have the standard deviation ``sigma`` [N], the moment N has ``0.12 sigma`` [N m], and all three
    have a correlation time of 8 s. ``sigma`` is drawn within 15 % of ``1.5 scale``.
    """
    sigma = scale * effect_size(rng, 1.5)  # N
    gust = Gust((sigma, sigma, 0.12 * sigma), 8.0, 97.0)
    return HiddenEffect("noise-gusts", "gusts come and go", {"sigma": sigma, "tau": gust.tau}, gust=gust)


def _outliers(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "noise-outliers": outliers of the GNSS position.

    The fraction ``share`` of the fixes gets an additional error with a standard deviation of 3 m per axis. ``share`` is
    drawn within 15 % of ``0.01 scale``.
    """
    share = scale * effect_size(rng, 0.01)
    noise = Noise(outliers=(share, 3.0))
    return HiddenEffect("noise-outliers", "one fix in a hundred is wrong", {"share": share}, noise=noise)


def _small_r(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "noise-small-r": AHRS and GNSS are noisier than declared.

    Their white noise is multiplied by ``gain = 1 + scale (sqrt(2) - 1)``. With ``scale = 1`` this doubles the noise
    variance. Nothing is drawn from ``rng``.
    """
    gain = 1.0 + scale * (2.0**0.5 - 1.0)
    sentence = "the sensors have twice the noise variance that is declared"
    return HiddenEffect("noise-small-r", sentence, {"gain": gain}, noise=Noise(gain=gain))


MAKERS: dict[str, Maker] = {
    "noise-gps": _gps,
    "noise-gusts": _gusts,
    "noise-outliers": _outliers,
    "noise-small-r": _small_r,
}
