"""Random numbers for the plant and the sensors: every stream is named by integers, so every run can be repeated."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

Draw = Callable[[], float]

# Names of the streams. Those of the boat depend on the seed alone, those of a run on the seed and the run.
PARAMETERS, CURRENT, EFFECT_NAME, EFFECT_SIZE, THRUSTER = range(5)
START, DISTURBANCE, AHRS, GNSS, ESC, LOADCELL, FAULT, WAVES, GUSTS, COLOUR, OUTLIERS = range(5, 16)


def random_stream(seed: int, name: int, run: int | None = None, index: int = 0) -> np.random.Generator:
    """The generator of one stream of one seed; ``run`` None for what belongs to the boat and not to the run."""
    return np.random.default_rng([seed, name, 0 if run is None else run + 1, index])


def normals(rng: np.random.Generator) -> Draw:
    """A function that returns the next standard normal number; drawn in blocks, since one at a time is slow."""

    def blocks() -> Iterator[float]:
        while True:
            yield from rng.standard_normal(1024).tolist()

    return blocks().__next__


class WhiteWalk:
    """Sensor noise as in the thesis, section 4.1: white noise plus a random walk that starts at a bias."""

    def __init__(self, draw: Draw, dt: float, white: float, walk: float = 0.0, bias: float = 0.0) -> None:
        """``white`` in the sensor's unit, ``walk`` in unit/sqrt(s), ``bias`` the walk's standard deviation at first."""
        self._draw = draw
        self._white = white
        self._step = walk * math.sqrt(dt)
        self._walk = bias * draw()

    def __call__(self) -> float:
        """The noise of the next sample."""
        draw = self._draw
        if self._step:
            self._walk += self._step * draw()
        return self._walk + self._white * draw()


class OrnsteinUhlenbeck:
    """First-order Gauss-Markov process of standard deviation ``sigma`` and correlation time ``tau`` [s]."""

    def __init__(self, draw: Draw, dt: float, sigma: float, tau: float) -> None:
        """Discretised exactly at ``dt`` (s) and stationary from the first sample."""
        self._draw = draw
        self._phi = math.exp(-dt / tau)
        self._sigma = sigma * math.sqrt(1.0 - self._phi**2)
        self.value = sigma * draw()

    def step(self) -> float:
        """The force one ``dt`` later, held constant over the step."""
        self.value = self._phi * self.value + self._sigma * self._draw()
        return self.value
