"""Simulation of a model with its process noise, in plain numpy and independent of the compiled filter.

It uses stochastic Heun steps, of weak order two for noise that does not depend on the state (Kloeden and Platen 1992,
14.1). Each interval between rows has one step or more. All replicates are simulated at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from seatrial.ident.model import Model
from seatrial.ident.numerics import Array

SUBSTEP = 0.0125  # [s] largest step of the integration


@dataclass(frozen=True)
class SampledInputs:
    """Inputs of a simulation at the n_rows instants (rows) of a record, and how they change in between.

    Between rows, an input changes linearly from ``u`` to ``u_next``. It is constant if both are equal.

    Attributes
    ----------
    t : Array (n_rows,)
        Time [s], increasing.
    u, u_next : Array (n_rows, n_inputs)
        Inputs at each row, and at the end of the interval that follows the row, in the order of ``model.inputs``.
    """

    t: Array
    u: Array
    u_next: Array

    @classmethod
    def held(cls, t: Array, u: Array) -> SampledInputs:
        """Return inputs that keep the value ``u`` (n_rows, n_inputs) of a row until the next of the times ``t`` [s].

        The arrays are not copied.
        """
        return cls(t, u, u)

    @classmethod
    def linear(cls, t: Array, u: Array) -> SampledInputs:
        """Return inputs that are linear in time between the values ``u`` (n_rows, n_inputs) at the times ``t`` [s].

        After the last time they keep the last value.
        """
        return cls(t, u, np.vstack([u[1:], u[-1:]]))


def simulate_stochastic(
    model: Model,
    inputs: SampledInputs,
    values: Array,
    rngs: Sequence[np.random.Generator],
    *,
    x0: Array | None = None,
    substep: float = SUBSTEP,
) -> tuple[Array, Array]:
    """Simulate a model with process noise and measurement noise, for several independent replicates at once.

    Parameters
    ----------
    model
        Model to simulate.
    inputs
        Inputs, common to all replicates. They define the rows (instants) of the result.
    values : Array (n_replicates, n_parameters)
        Parameters of each replicate, in the order of ``model.parameters``.
    rngs
        A random generator for each replicate, so that a replicate does not depend on the others.
    x0 : Array (n_replicates, n_states), optional
        Initial states. By default they are drawn from the model's initial distribution; a state that starts from a
        measurement has its ``x0`` without a random part.
    substep
        Largest step of the integration [s].

    Returns
    -------
    states : Array (n_replicates, n_rows, n_states)
        Simulated states at the times of the inputs.
    outputs : Array (n_replicates, n_rows, n_outputs)
        All outputs in all rows, with white measurement noise. Angles are not wrapped.
    """
    step = np.diff(inputs.t)
    # A value that all replicates share is passed as a number: with a single delay, the model can skip most of the
    # delayed copies of a command, whose weight is zero.
    p: list[Any] = [float(own[0]) if (own == own[0]).all() else own for own in np.asarray(values).T]
    n_sub = np.maximum(np.ceil(step / substep - 1e-9), 1).astype(int)
    x = (
        np.array([_draw_initial_state(model, v, r) for v, r in zip(values, rngs, strict=True)])
        if x0 is None
        else np.array(x0)
    )
    shape = (int(n_sub.sum()), len(model.states))
    dw = np.stack([r.standard_normal(shape) for r in rngs], axis=2)  # (n_steps, n_states, n_replicates)
    diffusion = np.array([_noise_by_replicate(model, values, s.noise) for s in model.states])
    states = np.empty((len(rngs), inputs.t.size, len(model.states)))
    outputs = np.empty((len(rngs), inputs.t.size, len(model.outputs)))
    z, done = x.T.copy(), 0
    for k in range(inputs.t.size):
        states[:, k] = z.T
        y = model.signals(z, inputs.u[k], p).y
        for j, output in enumerate(model.outputs):
            outputs[:, k, j] = y[output.name]
        if k == step.size:
            break
        noise = diffusion * np.sqrt(step[k] / n_sub[k]) * dw[done : done + n_sub[k]]
        z, done = _integrate_interval(model, z, (inputs.u[k], inputs.u_next[k]), p, step[k], noise), done + n_sub[k]
    noise_sd = np.array([_noise_by_replicate(model, values, o.noise) for o in model.outputs])
    white = np.stack([r.standard_normal(outputs.shape[1:]) for r in rngs])
    return states, outputs + white * noise_sd.T[:, None, :]


def _integrate_interval(
    model: Model, z: Array, ends: tuple[Array, Array], p: Sequence[Any], step: float, noise: Array
) -> Array:
    """Integrate the states of all replicates over one interval by stochastic Heun steps.

    Parameters
    ----------
    model : Model
        Model to simulate.
    z : Array (n_states, n_replicates)
        States at the start of the interval.
    ends : tuple[Array, Array]
        Inputs (n_inputs,) at the start and at the end of the interval.
    p : Sequence
        Value of each parameter: a number, or an array (n_replicates,).
    step : float
        Length of the interval [s].
    noise : Array (n, n_states, n_replicates)
        Increments of the states by process noise in each of the n steps.

    Returns
    -------
    Array (n_states, n_replicates)
        States at the end of the interval.
    """
    n, (begin, end) = len(noise), ends
    h = step / n
    for i in range(n):
        a, b = (begin + (end - begin) * (i + e) / n for e in (0, 1))
        first = _state_rates(model, z, a, p)
        z = z + h / 2 * (first + _state_rates(model, z + h * first + noise[i], b, p)) + noise[i]
    return z


def _state_rates(model: Model, x: Array, u: Array, p: Sequence[Any]) -> Array:
    """Return the time derivatives (n_states, n_replicates) of the states of all replicates.

    Parameters
    ----------
    model
        Model to simulate.
    x : Array (n_states, n_replicates)
        States.
    u : Array (n_inputs,)
        Inputs.
    p
        Value of each parameter: a number, or an array (n_replicates,).
    """
    rate = model.signals(x, u, p).rate
    out = np.empty_like(x)
    for i, state in enumerate(model.states):
        out[i] = rate[state.name]
    return out


def _draw_initial_state(model: Model, values: Array, rng: np.random.Generator) -> Array:
    """Draw an initial state (n_states,) from the normal distributions with mean ``x0`` and standard deviation ``sd0``.

    A state that starts from a measurement of the model has its ``x0`` without a random part. ``values`` (n_parameters,)
    are the parameters of one replicate.
    """
    named = dict(zip([p.name for p in model.parameters], values, strict=True))
    seen = {o.name for o in model.outputs}
    out = np.empty(len(model.states))
    for i, state in enumerate(model.states):
        mean, sd = (float(named[v]) if isinstance(v, str) else v for v in (state.x0, state.sd0))
        out[i] = mean if state.from_output in seen else mean + sd * rng.standard_normal()
    return out


def _noise_by_replicate(model: Model, values: Array, noise: float | str) -> Array:
    """Return the standard deviation or diffusion of a noise for each replicate (n_replicates,).

    ``noise`` is a number for all replicates, or the name of a parameter. ``values`` (n_replicates, n_parameters) are
    the parameters of the replicates.
    """
    if not isinstance(noise, str):
        return np.full(len(values), float(noise))
    return np.asarray(values[:, [p.name for p in model.parameters].index(noise)])
