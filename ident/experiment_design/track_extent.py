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
    """Return the model with process noise as inputs, and the names of the states that have process noise.

    The new inputs follow those of the model. The input ``w_STATE`` [unit of the state / s], linear between rows, is
    added to the rate of the state. A model without process noise is returned unchanged, with an empty list.
    """
    noisy = [s for s in model.states if s.noise != 0.0]

    def add_noise(s: Signals) -> None:
        """Add each noise input to the rate of its state, in place."""
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

    Returns
    -------
    Array (n, n_parameters)
        Copy of the samples in which each has its own current ``V_x`` and ``V_y``. With a radius of 0 it is ``values``
        itself.

    Raises
    ------
    SeatrialError
        If the radius is not 0 and the model has no current.
    """
    if largest == 0.0:
        return values
    names = [p.name for p in model.parameters]
    if not set(CURRENT) <= set(names):
        raise SeatrialError(f"model {model.name} has no ocean current, so --current cannot be simulated; leave it out")
    speed, toward = largest * np.sqrt(rng.uniform(size=len(values))), 2.0 * np.pi * rng.uniform(size=len(values))
    found = values.copy()
    found[:, [names.index(n) for n in CURRENT]] = np.column_stack([speed * np.cos(toward), speed * np.sin(toward)])
    return found


class TrackExtent:
    """Simulator of the extent of the tracks of sampled boats, with process noise.

    A call returns the minimum and the maximum of each state and of the squared speed, for each mission and boat.

    Parameters
    ----------
    model
        The model.
    t
        Times of the rows (n_rows,) [s].
    boats
        Parameter samples (n_boats, n_parameters). The first boat has no process noise.
    seed
        Seed of the process noise.
    """

    def __init__(self, model: Model, t: Array, boats: Array, seed: Sequence[int]) -> None:
        """Store the arguments, and extend the model by process noise as inputs. Nothing is simulated here."""
        self._model, self._t, self._boats, self._seed = model, t, boats, list(seed)
        self._disturbed, self._noisy = with_noise_inputs(model)

    @cached_property
    def _experiments(self) -> Experiments:
        """Simulator of the model that has process noise as inputs, without any information about parameters."""
        return Experiments(self._disturbed, (), self._t, process_noise=False)

    @property
    def extremes(self) -> tuple[str, ...]:
        """Names of the k quantities whose minimum and maximum a call returns.

        They are the states, and then the squared speed ``speed2`` if the model has a surge speed.
        """
        return self._experiments.extremes

    @cached_property
    def noise(self) -> Array:
        """White noise of each noisy state (n_rows, n_noisy, n_boats) [unit of the state / s]; 0 for the first boat.

        Its integral is a random walk with the diffusion of the model.
        """
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
        """Return the minimum and the maximum (n, n_boats, k) of the quantities ``extremes`` in n missions.

        ``u``: inputs of the model (n_rows, n_inputs, n), without those of the process noise.
        """
        return self._experiments.extents_in_noise(u, self.noise, self._boats)
