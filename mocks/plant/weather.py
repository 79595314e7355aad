"""Waves and gusts: unmeasured forces of hidden effects on the mock boat."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from seatrial.mocks.plant.effect import Gust, HiddenEffect, Wave
from seatrial.mocks.random_streams import GUSTS, WAVES, OrnsteinUhlenbeck, normals, random_stream

COMPONENTS = 24  # sines that the waves are made of
Forces = tuple[float, float, float]  # X, Y, N in N, N, N m


class Weather:
    """All waves and gusts of a boat in one run. Its truth value is False if the boat has no waves and no gusts."""

    def __init__(self, effects: Sequence[HiddenEffect], seed: int, run: int, dt: float) -> None:
        """Set up the waves and gusts of a run of a simulated boat: draw their random numbers.

        Parameters
        ----------
        effects : sequence of HiddenEffect
            Hidden effects. Those without waves and gusts are ignored.
        seed : int
            Seed of the boat.
        run : int
            Number of the run. It selects the stream of random numbers.
        dt : float
            Time between two calls of `forces` [s].
        """
        self._sources: list[Sea | Squalls] = [
            Sea(e.wave, random_stream(seed, WAVES, run, k)) for k, e in enumerate(effects) if e.wave is not None
        ]
        self._sources += [
            Squalls(e.gust, random_stream(seed, GUSTS, run, k), dt) for k, e in enumerate(effects) if e.gust is not None
        ]

    def __bool__(self) -> bool:
        """Return whether the boat has waves or gusts."""
        return bool(self._sources)

    def forces(self, t: float, psi: float) -> Forces:
        """Return the sum of the forces of all waves and gusts on the boat: X, Y, N [N, N, N m] in body axes.

        ``t`` is the time [s], and ``psi`` the heading [rad]. Each call advances the gusts by one step. The sum is zero
        without waves and gusts.
        """
        every = [part.forces(t, psi) for part in self._sources]
        return sum(f[0] for f in every), sum(f[1] for f in every), sum(f[2] for f in every)


class Sea:
    """Forces of long-crested waves, as a sum of sines.

    The frequencies do not depend on the boat's speed: the change to the frequency of encounter is neglected. Sway and
    yaw follow the slope of the surface, a quarter of a period away from surge.
    """

    def __init__(self, wave: Wave, rng: np.random.Generator) -> None:
        """Set up the forces of the waves ``wave``: draw the frequencies and phases of 24 sines with ``rng``.

        The spectrum is ``1 / (1 + s^4)``. ``s`` is the distance from the peak in units of the peak's width, from about
        -3 to 3.
        """
        spread = np.linspace(-3.0, 3.0, COMPONENTS) + 3.0 / COMPONENTS * rng.uniform(-1.0, 1.0, COMPONENTS)
        power = 1.0 / (1.0 + spread**4)
        omega = 2.0 * math.pi * wave.frequency * (1.0 + wave.width * spread)
        amplitude = np.sqrt(2.0 * power / power.sum())
        phase = rng.uniform(0.0, 2.0 * math.pi, COMPONENTS)
        self._wave = wave
        self._components = list(zip(amplitude.tolist(), omega.tolist(), phase.tolist(), strict=True))

    def forces(self, t: float, psi: float) -> Forces:
        """Return the forces of the waves on the boat at time ``t`` [s] and heading ``psi`` [rad].

        They are X, Y, N [N, N, N m] in body axes.
        """
        w = self._wave
        angles = [(a, omega * t + phase) for a, omega, phase in self._components]
        along = sum(a * math.cos(angle) for a, angle in angles)
        across = sum(a * math.sin(angle) for a, angle in angles)
        c, s = math.cos(w.toward - psi), math.sin(w.toward - psi)
        return w.surge * c * along, w.sway * s * across, w.yaw * 2.0 * c * s * across


class Squalls:
    """Forces of gusts on the boat: first-order coloured noise, a fifth as strong in the second half of each period."""

    def __init__(self, gust: Gust, rng: np.random.Generator, dt: float) -> None:
        """Set up the forces of the gusts ``gust``: draw their initial values with ``rng``.

        `forces` must be called every ``dt`` [s] afterwards.
        """
        draw = normals(rng)
        self._period = gust.period
        self._sources = [OrnsteinUhlenbeck(draw, dt, sigma, gust.tau) for sigma in gust.sigma]

    def forces(self, t: float, psi: float) -> Forces:
        """Return the forces of the gusts on the boat at time ``t`` [s]: X, Y, N [N, N, N m] in body axes.

        Each call advances the coloured noise by one step. The forces do not depend on the heading ``psi``.
        """
        # The factors keep the mean variance near one: (1.4^2 + 0.28^2) / 2.
        strength = 1.4 if math.sin(2.0 * math.pi * t / self._period) > 0.0 else 0.28
        x, y, n = (strength * part.step() for part in self._sources)
        return x, y, n
