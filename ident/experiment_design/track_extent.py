"""Monte Carlo extent of the mission track, over parameter uncertainty, process noise and current.

Process noise is an input on the rates of the states. It is drawn once for each sampled boat and is linear between the
rows: white up to the rate of the rows, which is far above the bandwidth of a boat. All missions get the same noise
(common random numbers), so that a search compares missions and not noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.ident.experiment_design.information import Experiments
from seatrial.ident.model import Effect, Input, Model, Signals
from seatrial.ident.numerics import Array

CURRENT = ("V_x", "V_y")


def with_noise_inputs(model: Model) -> tuple[Model, list[str]]:
    """Return the model with process noise as inputs, and the names of the states that have it.

    The input ``w_STATE`` [unit of the state / s] is added to the rate of the state.
    """
    noisy = [s for s in model.states if s.noise != 0.0]

    def add_noise(s: Signals) -> None:
        for state in noisy:
            s.rate[state.name] = s.rate[state.name] + getattr(s.u, f"w_{state.name}")

    inputs = tuple(Input(f"w_{s.name}", f"{s.unit}/s", "linear") for s in noisy)
    effect = Effect("process-noise", "process noise as inputs", {"rate": add_noise}, inputs=inputs)
    return (model + effect if noisy else model), [s.name for s in noisy]


def in_current(model: Model, values: Array, largest: float, rng: np.random.Generator) -> Array:
    """Return parameter samples with a random current, uniform in a disc.

    Parameters
    ----------
    model
        The model.
    values
        Parameter samples (n, n_parameters).
    largest
        Radius of the disc [m/s].
    rng
        Random generator.

    Raises
    ------
    SeatrialError
        If the model has no current.
    """
    if largest == 0.0:
        return values
    names = [p.name for p in model.parameters]
    if not set(CURRENT) <= set(names):
        raise SeatrialError(f"model {model.name} has no current, so --current has no effect; leave it out")
    speed, toward = largest * np.sqrt(rng.uniform(size=len(values))), 2.0 * np.pi * rng.uniform(size=len(values))
    found = values.copy()
    found[:, [names.index(n) for n in CURRENT]] = np.column_stack([speed * np.cos(toward), speed * np.sin(toward)])
    return found


class TrackExtent:
    """Track extents of sampled boats (n_boats, n_parameters) on common times t (n_rows,) [s].

    The first boat has no process noise.
    """

    def __init__(self, model: Model, t: Array, boats: Array, seed: Sequence[int]) -> None:
        self._model, self._t, self._boats, self._seed = model, t, boats, list(seed)
        self._disturbed, self._noisy = with_noise_inputs(model)

    @cached_property
    def _experiments(self) -> Experiments:
        """Simulated experiments of the model with noise inputs."""
        return Experiments(self._disturbed, (), self._t, process_noise=False)

    @property
    def extremes(self) -> tuple[str, ...]:
        """Names of the quantities whose extremes are returned."""
        return self._experiments.extremes

    @cached_property
    def noise(self) -> Array:
        """White noise (n_rows, n_noisy, n_boats) [unit/s] whose integral has the diffusion of the model."""
        h, states = np.diff(self._t), {s.name: s for s in self._model.states}
        names = [p.name for p in self._model.parameters]
        out = np.zeros((self._t.size, len(self._noisy), len(self._boats)))
        for k in range(1, len(self._boats)):
            drawn = np.random.default_rng([*self._seed, k]).standard_normal((self._t.size, len(self._noisy)))
            for j, name in enumerate(self._noisy):
                noise = states[name].noise
                sd = self._boats[k, names.index(noise)] if isinstance(noise, str) else noise
                out[:, j, k] = sd * drawn[:, j] / np.sqrt(np.append(h, h[-1]))
        return out

    def __call__(self, u: Array) -> tuple[Array, Array]:
        """Return minimum and maximum (n, n_boats, k) of ``extremes`` for inputs u (n_rows, n_inputs, n)."""
        return self._experiments.extents_in_noise(u, self.noise, self._boats)
