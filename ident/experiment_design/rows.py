"""Row spacing: the largest interval between the rows of a simulated experiment.

The engine takes one Runge-Kutta step (fourth order) from row to row. It is stable up to ``h |lambda|`` of 2.785 on the
negative real axis, and reasonably exact up to half of that. Delayed input taps (``NAME~k``) are interpolated between
the rows. Rows must not be further apart than the taps, because the interpolation would smooth the delay.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from seatrial.ident.estimation import SampledInputs, simulate_stochastic
from seatrial.ident.experiment_design.excitation import ThrusterResponse
from seatrial.ident.model import Model
from seatrial.ident.numerics import Array

STABLE = 1.4  # largest row spacing times the fastest pole
# Simulation of random steps of thrust for the fastest pole [s]: duration, duration of a step, row spacing, integration
# step.
TRIAL_S, HOLD_S, ROW_S, SUBSTEP = 4.0, 1.0, 0.1, 0.025
SHORTEST = 0.005  # s


def row_spacing(members: Sequence[tuple[Model, Array]], longest: float, n_max: float = 1.0) -> float:
    """Return the largest row spacing with which all models can be simulated.

    Parameters
    ----------
    members
        Models, each with parameter samples (n, n_parameters).
    longest
        Upper bound of the spacing [s].
    n_max
        Largest command, 0 to 1, of the random steps along which the fastest pole is computed.

    Returns
    -------
    float
        Spacing [s]: ``longest`` over a whole number. It is at most the smallest delay of the delayed input taps, and at
        most 1.4 over the fastest pole, or 0.005 s if the pole is faster than 280 1/s.
    """
    copies = divided_spacing(longest, min(copy_spacing(model, longest) for model, _ in members))
    pole = max(fastest_pole(model, boats, n_max) for model, boats in members)
    return divided_spacing(copies, max(STABLE / pole, SHORTEST) if pole > 0.0 else copies)


def copy_spacing(model: Model, longest: float) -> float:
    """Return the smallest delay or lead [s] of the delayed input taps of a model.

    It is at most ``longest`` [s], which is also the result for a model without taps.
    """
    return min([longest, *(abs(i.delay) for i in model.inputs if i.tap)])


def divided_spacing(spacing: float, most: float) -> float:
    """Divide a spacing by the smallest whole number with which the result is at most ``most``, and return the result.

    Both are in the same unit, for example s.
    """
    return spacing / int(np.ceil(spacing / most - 1e-9))


def fastest_pole(model: Model, boats: Array, n_max: float) -> float:
    """Return the fastest pole of a model along simulations of 4 s with random steps of thrust.

    The steps and the process noise are the same in every call.

    Parameters
    ----------
    model
        The model.
    boats
        Parameter samples (n, n_parameters).
    n_max
        Largest command of the random steps, 0 to 1.

    Returns
    -------
    float
        Largest absolute eigenvalue [1/s] of the Jacobian of the rates over all samples and steps. Jacobians that are
        not finite are left out. 0 for a model without states.
    """
    n, k = len(boats), len(model.states)
    if not k:
        return 0.0
    t = np.asarray(np.arange(round(TRIAL_S / ROW_S) + 1) * ROW_S)
    response = ThrusterResponse(model, t, n_max)
    steps = np.random.default_rng(0).uniform(-n_max, n_max, (round(TRIAL_S / HOLD_S) + 1, len(response.channels)))
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
    """Return the Jacobians (n, n_states, n_states) of the rates of the states by central differences.

    Rates are along the second axis and states along the third. The Jacobians are taken at states x (n, n_states),
    common inputs u (n_inputs,) and parameters ``boats`` (n, n_parameters).
    """
    J, steps = np.empty((len(x), x.shape[1], x.shape[1])), 1e-5 * (1.0 + np.abs(x))

    def rates(at: Array) -> Array:
        """Return the rates (n, n_states) of the states at states ``at`` (n, n_states)."""
        found = model.signals(at.T, u, boats.T).rate
        return np.column_stack([np.broadcast_to(found[s.name], len(x)) for s in model.states])

    for j in range(x.shape[1]):
        step = np.zeros_like(x)
        step[:, j] = steps[:, j]
        J[:, :, j] = (rates(x + step) - rates(x - step)) / (2.0 * steps[:, [j]])
    return J
