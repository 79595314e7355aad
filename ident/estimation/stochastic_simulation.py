"""Simulation of a model with its process noise, in plain numpy and independent of the filter's kernels.

Stochastic Heun steps, of weak order two for noise that does not depend on the state (Kloeden and Platen 1992, 14.1),
many to a row; all replicates at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from seatrial.ident.model import Model
from seatrial.ident.numerics import Array

SUBSTEP = 0.0125  # s


@dataclass(frozen=True)
class SampledInputs:
    """t (n_rows,) s; u, u_next (n_rows, n_inputs): inputs at each row and at the end of the interval that follows."""

    t: Array
    u: Array
    u_next: Array

    @classmethod
    def held(cls, t: Array, u: Array) -> SampledInputs:
        """Constant until the next row."""
        return cls(t, u, u)

    @classmethod
    def linear(cls, t: Array, u: Array) -> SampledInputs:
        """Straight lines between the rows."""
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
    """States (n_replicates, n_rows, n_states) and measurements with noise (n_replicates, n_rows, n_outputs).

    values (n_replicates, n_parameters): each replicate's parameters, in the model's order; rngs: a generator for
    each, so that a replicate does not depend on its neighbours. x0 (n_replicates, n_states): where they start; by
    default drawn from the model's own initial distribution (states that start from a measurement: at their x0).
    """
    step = np.diff(inputs.t)
    # Numbers where all replicates have the same: of a delay known to be one most copies of a command have no weight.
    p: list[Any] = [float(own[0]) if (own == own[0]).all() else own for own in np.asarray(values).T]
    n_sub = np.maximum(np.ceil(step / substep - 1e-9), 1).astype(int)
    x = np.array([_start(model, v, r) for v, r in zip(values, rngs, strict=True)]) if x0 is None else np.array(x0)
    shape = (int(n_sub.sum()), len(model.states))
    dw = np.stack([r.standard_normal(shape) for r in rngs], axis=2)  # (n_steps, n_states, n_replicates)
    diffusion = np.array([_named(model, values, s.noise) for s in model.states])
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
        z, done = _heun(model, z, (inputs.u[k], inputs.u_next[k]), p, step[k], noise), done + n_sub[k]
    noise_sd = np.array([_named(model, values, o.noise) for o in model.outputs])
    white = np.stack([r.standard_normal(outputs.shape[1:]) for r in rngs])
    return states, outputs + white * noise_sd.T[:, None, :]


def _heun(model: Model, z: Array, ends: tuple[Array, Array], p: Sequence[Any], step: float, noise: Array) -> Array:
    """Over one interval in as many substeps as there are ``noise`` (n, n_states, n_replicates); ends: its inputs."""
    n, (begin, end) = len(noise), ends
    h = step / n
    for i in range(n):
        a, b = (begin + (end - begin) * (i + e) / n for e in (0, 1))
        first = _rates(model, z, a, p)
        z = z + h / 2 * (first + _rates(model, z + h * first + noise[i], b, p)) + noise[i]
    return z


def _rates(model: Model, x: Array, u: Array, p: Sequence[Any]) -> Array:
    rate = model.signals(x, u, p).rate
    out = np.empty_like(x)
    for i, state in enumerate(model.states):
        out[i] = rate[state.name]
    return out


def _start(model: Model, values: Array, rng: np.random.Generator) -> Array:
    named = dict(zip([p.name for p in model.parameters], values, strict=True))
    seen = {o.name for o in model.outputs}
    out = np.empty(len(model.states))
    for i, state in enumerate(model.states):
        mean, sd = (float(named[v]) if isinstance(v, str) else v for v in (state.x0, state.sd0))
        out[i] = mean if state.from_output in seen else mean + sd * rng.standard_normal()
    return out


def _named(model: Model, values: Array, noise: float | str) -> Array:
    """A number or a parameter's values (n_replicates,)."""
    if not isinstance(noise, str):
        return np.full(len(values), float(noise))
    return np.asarray(values[:, [p.name for p in model.parameters].index(noise)])
