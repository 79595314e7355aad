"""Row spacing: how far apart the rows of a simulated experiment may be.

The engine takes one Runge-Kutta step (fourth order) from row to row. It is stable up to ``h |lambda|`` of 2.785 on the
negative real axis, and reasonably exact up to half of that. Copies of an input that are delayed (``NAME~k``) are taken
from the rows, so that rows further apart than the copies blur what tells a delay.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from seatrial.ident.estimation import SampledInputs, simulate_stochastic
from seatrial.ident.experiment_design.excitation import ThrusterResponse
from seatrial.ident.model import Model
from seatrial.ident.numerics import Array

STABLE = 1.4  # largest row spacing times the fastest pole
TRIED_S, HOLD_S, ROW_S, SUBSTEP = 4.0, 1.0, 0.1, 0.025  # s: random steps of full thrust, in which poles are looked at
SHORTEST = 0.005  # s


def row_spacing(members: Sequence[tuple[Model, Array]], longest: float, n_max: float = 1.0) -> float:
    """Row spacing [s] on which all of ``members`` can be simulated: ``longest`` over the least whole number that does.

    By the spacing of the delayed copies of their inputs, of which it is a whole part, and by the fastest pole that any
    of the parameters (n, n_parameters) beside each model has while its thrusters take random steps up to ``n_max``.
    """
    copies = divided(longest, min(copy_spacing(model, longest) for model, _ in members))
    pole = max(fastest_pole(model, boats, n_max) for model, boats in members)
    return divided(copies, max(STABLE / pole, SHORTEST) if pole > 0.0 else copies)


def copy_spacing(model: Model, longest: float) -> float:
    """The least delay [s] of the copies of a model's inputs, ``longest`` at most."""
    return min([longest, *(abs(i.delay) for i in model.inputs if i.tap)])


def divided(spacing: float, most: float) -> float:
    """A spacing over the least whole number that leaves at most ``most``."""
    return spacing / int(np.ceil(spacing / most - 1e-9))


def fastest_pole(model: Model, boats: Array, n_max: float) -> float:
    """Largest absolute eigenvalue [1/s] of the rates' Jacobian by the states, by central differences, of all ``boats``
    (n, n_parameters); 0 of a model without states."""
    n, k = len(boats), len(model.states)
    if not k:
        return 0.0
    t = np.asarray(np.arange(round(TRIED_S / ROW_S) + 1) * ROW_S)
    response = ThrusterResponse(model, t, n_max)
    steps = np.random.default_rng(0).uniform(-n_max, n_max, (round(TRIED_S / HOLD_S) + 1, len(response.channels)))
    u = response.inputs(steps[(t / HOLD_S + 1e-9).astype(int)][:, :, None])[:, :, 0]
    rngs = [np.random.default_rng(i) for i in range(n)]
    x = simulate_stochastic(model, SampledInputs.linear(t, u), boats, rngs, x0=np.zeros((n, k)), substep=SUBSTEP)[0]
    found = 0.0
    for row in range(0, t.size, round(HOLD_S / ROW_S)):
        J = _jacobian(model, x[:, row], u[row], boats)
        J = J[np.isfinite(J).all(axis=(1, 2))]
        found = max(found, float(np.abs(np.linalg.eigvals(J)).max(initial=0.0)))
    return found


def _jacobian(model: Model, x: Array, u: Array, boats: Array) -> Array:
    """Of the rates (n, n_states, n_states) at states x (n, n_states) and inputs u (n_inputs,)."""
    J, steps = np.empty((len(x), x.shape[1], x.shape[1])), 1e-5 * (1.0 + np.abs(x))

    def rates(at: Array) -> Array:
        found = model.signals(at.T, u, boats.T).rate
        return np.column_stack([np.broadcast_to(found[s.name], len(x)) for s in model.states])

    for j in range(x.shape[1]):
        step = np.zeros_like(x)
        step[:, j] = steps[:, j]
        J[:, :, j] = (rates(x + step) - rates(x - step)) / (2.0 * steps[:, [j]])
    return J
