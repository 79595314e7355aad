"""Random numbers of the plant and the sensors.

Integers (seed, name, run, index) identify each stream of random numbers, so every run can be repeated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

Draw = Callable[[], float]

# Names of the streams. The streams of the first line belong to the boat and depend on the seed alone. The streams of
# the second line depend on the seed and the run.
PARAMETERS, CURRENT, EFFECT_NAME, EFFECT_SIZE, THRUSTER = range(5)
START, DISTURBANCE, AHRS, GNSS, ESC, LOADCELL, FAULT, WAVES, GUSTS, COLOUR, OUTLIERS = range(5, 16)


def random_stream(seed: int, name: int, run: int | None = None, index: int = 0) -> np.random.Generator:
    """Return a generator of random numbers that belongs to these arguments. The same arguments give the same numbers.

    Parameters
    ----------
    seed : int
        Seed of the boat or bench.
    name : int
        Purpose of the numbers: one of the constants of this module, for example `WAVES`.
    run : int, optional
        Number of the run; None for numbers that are the same in all runs of a boat.
    index : int
        Number that distinguishes generators of the same purpose, for example those of two GNSS receivers.
    """
    return np.random.default_rng([seed, name, 0 if run is None else run + 1, index])


def normals(rng: np.random.Generator) -> Draw:
    """Return a function without arguments that returns a new standard normal number at each call, drawn by ``rng``.

    The numbers are drawn ahead in blocks of 1024, so ``rng`` should not be used elsewhere.
    """

    # Numbers are drawn in blocks, since single draws are slow.
    def blocks() -> Iterator[float]:
        """Yield standard normal numbers of ``rng`` without end; they are drawn in blocks of 1024 for speed."""
        while True:
            yield from rng.standard_normal(1024).tolist()

    return blocks().__next__


class WhiteWalk:
    """Sensor noise as in section 4.1 of the thesis: white noise plus a random walk that starts at a bias."""

    def __init__(self, draw: Draw, dt: float, white: float, walk: float = 0.0, bias: float = 0.0) -> None:
        """Set up the noise of a sensor.

        Parameters
        ----------
        draw : callable
            Function that returns standard normal numbers.
        dt : float
            Time between two samples [s].
        white : float
            Standard deviation of the white noise, in the unit of the sensor.
        walk : float
            Diffusion of the random walk [unit/sqrt(s)].
        bias : float
            Standard deviation of the initial value of the random walk, in the unit of the sensor.
        """
        self._draw = draw
        self._white = white
        self._step = walk * math.sqrt(dt)
        self._walk = bias * draw()

    def __call__(self) -> float:
        """Return the next value of the sensor noise (white noise plus random walk), in the unit of the sensor.

        The random walk advances by one sample first.
        """
        draw = self._draw
        if self._step:
            self._walk += self._step * draw()
        return self._walk + self._white * draw()


class OrnsteinUhlenbeck:
    """First-order Gauss-Markov (Ornstein-Uhlenbeck) process. The attribute `value` is its present value."""

    def __init__(self, draw: Draw, dt: float, sigma: float, tau: float) -> None:
        """Set up a Gauss-Markov process, and draw its initial value from the stationary distribution.

        Parameters
        ----------
        draw : callable
            Function that returns standard normal numbers.
        dt : float
            Time between two steps [s]. The discretisation is exact for any step.
        sigma : float
            Stationary standard deviation, in the unit of the process.
        tau : float
            Correlation time [s].
        """
        self._draw = draw
        self._phi = math.exp(-dt / tau)
        self._sigma = sigma * math.sqrt(1.0 - self._phi**2)
        self.value = sigma * draw()

    def step(self) -> float:
        """Advance the Gauss-Markov process by one step ``dt``, and return its new value in its unit."""
        self.value = self._phi * self.value + self._sigma * self._draw()
        return self.value
