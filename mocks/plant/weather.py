"""Waves and gusts: unmeasured forces of some hidden effects."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from seatrial.mocks.plant.effect import Gust, HiddenEffect, Wave
from seatrial.mocks.random_streams import GUSTS, WAVES, OrnsteinUhlenbeck, normals, random_stream

COMPONENTS = 24
Forces = tuple[float, float, float]  # X, Y, N: N, N, N m


class Weather:
    """All waves and gusts of a boat in one run; false where there are none."""

    def __init__(self, effects: Sequence[HiddenEffect], seed: int, run: int, dt: float) -> None:
        """To be asked every ``dt`` (s)."""
        self._parts: list[Sea | Squalls] = [
            Sea(e.wave, random_stream(seed, WAVES, run, k)) for k, e in enumerate(effects) if e.wave is not None
        ]
        self._parts += [
            Squalls(e.gust, random_stream(seed, GUSTS, run, k), dt) for k, e in enumerate(effects) if e.gust is not None
        ]

    def __bool__(self) -> bool:
        return bool(self._parts)

    def forces(self, t: float, psi: float) -> Forces:
        """At time ``t`` (s) on heading ``psi`` (rad)."""
        every = [part.forces(t, psi) for part in self._parts]
        return sum(f[0] for f in every), sum(f[1] for f in every), sum(f[2] for f in every)


class Sea:
    """Long-crested waves as a sum of sines; encounter frequency and wavelength are not distinguished.

    Sway and yaw follow the slope of the surface, a quarter of a period off the surge.
    """

    def __init__(self, wave: Wave, rng: np.random.Generator) -> None:
        spread = np.linspace(-3.0, 3.0, COMPONENTS) + 3.0 / COMPONENTS * rng.uniform(-1.0, 1.0, COMPONENTS)
        power = 1.0 / (1.0 + spread**4)
        omega = 2.0 * math.pi * wave.frequency * (1.0 + wave.width * spread)
        amplitude = np.sqrt(2.0 * power / power.sum())
        phase = rng.uniform(0.0, 2.0 * math.pi, COMPONENTS)
        self._wave = wave
        self._components = list(zip(amplitude.tolist(), omega.tolist(), phase.tolist(), strict=True))

    def forces(self, t: float, psi: float) -> Forces:
        """At time ``t`` (s) on heading ``psi`` (rad)."""
        w = self._wave
        angles = [(a, omega * t + phase) for a, omega, phase in self._components]
        along = sum(a * math.cos(angle) for a, angle in angles)
        across = sum(a * math.sin(angle) for a, angle in angles)
        c, s = math.cos(w.toward - psi), math.sin(w.toward - psi)
        return w.surge * c * along, w.sway * s * across, w.yaw * 2.0 * c * s * across


class Squalls:
    """First-order coloured forces that come and go: half of each period they are a fifth as strong."""

    def __init__(self, gust: Gust, rng: np.random.Generator, dt: float) -> None:
        draw = normals(rng)
        self._period = gust.period
        self._parts = [OrnsteinUhlenbeck(draw, dt, sigma, gust.tau) for sigma in gust.sigma]

    def forces(self, t: float, psi: float) -> Forces:
        """At time ``t`` (s); each call is one step."""
        strength = 1.4 if math.sin(2.0 * math.pi * t / self._period) > 0.0 else 0.28
        x, y, n = (strength * part.step() for part in self._parts)
        return x, y, n
