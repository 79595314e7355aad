"""Steady motion of a fitted model: the velocities that remain at constant inputs in still water, with their errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from seatrial.daq.errors import UnknownName
from seatrial.ident.export.codegen import without_nuisance
from seatrial.ident.export.conditions import chosen_conditions
from seatrial.ident.export.rates import Rates
from seatrial.ident.model import Model
from seatrial.ident.numerics import Array

FIRST_STEP_S, LAST_STEP_S, GROWTH, STEPS = 0.1, 1e6, 1.5, 80  # step of time in the search [s], and its growth
# The search ends early if a step of at least LONG_STEP_S [s] changes no state by more than REACHED, in its unit.
LONG_STEP_S, REACHED = 1e3, 1e-13
STEADY = 1e-7  # largest rate of a steady motion, in the unit of each state per second
RELATIVE_STEP = 1e-4  # step of the derivatives by the parameters, as a part of their standard errors


@dataclass(frozen=True)
class SteadyMotion:
    """Steady motions of a model at several constant inputs.

    Attributes
    ----------
    states : tuple of str
        Names of the n states: the velocities, and those on which these depend, as of shafts.
    x : Array (n_inputs, n)
        The states, NaN for inputs at which no stable steady motion is found.
    sd : Array (n_inputs, n)
        Standard errors of the states from those of the estimates; NaN if they are unknown.
    """

    states: tuple[str, ...]
    x: Array
    sd: Array

    def of(self, state: str) -> tuple[Array, Array]:
        """Return the values and the standard errors (n_inputs,) of one state. `UnknownName` if there is none."""
        if state not in self.states:
            raise UnknownName(f"the model has no state {state!r}; its states are {', '.join(self.states)}")
        j = self.states.index(state)
        return self.x[:, j], self.sd[:, j]


def steady_motion(
    model: Model,
    u: Array,
    names: tuple[str, ...] = (),
    covariance: Array | None = None,
    held: tuple[str, ...] = (),
    conditions: Mapping[str, float] | None = None,
) -> SteadyMotion:
    """Return the motions of a model that are steady in still water at constant inputs.

    Disturbance forces and random-walk biases are left out. Each motion is the end of a motion from rest. A steady
    motion that is not stable counts as not found (NaN).

    Parameters
    ----------
    model : Model
        Model with its estimates as values.
    u : Array (n_rows, m)
        Inputs of each motion: those of the model without delayed copies, time and work, in the order of the model.
    names : tuple of str
        Names of the estimates that ``covariance`` belongs to. Estimates of one record (``V_x@0``) are left out.
    covariance : Array (n_names, n_names), optional
        Covariance of the estimates; rows of NaN count as zero. None: the errors are NaN.
    held : tuple of str
        States that are held at zero, for example ``("v", "r")`` for straight motion. They are not in the result.
    conditions : mapping, optional
        Constant values of time, work, place and heading by name; a missing one has the default of `chosen_conditions`.

    Notes
    -----
    The search is the implicit Euler method with growing steps (pseudo-transient continuation, Kelley and Keyes 1998),
    which ends as Newton's method, as soon as all motions are reached. The errors are those of the implicit function
    theorem: ``dx/dp = -J^-1 df/dp``.
    """
    reduced, _ = without_nuisance(model)
    rates, u = Rates(reduced, held, chosen_conditions(reduced, at=conditions)), np.atleast_2d(u)
    n = len(rates.names)
    x = np.zeros((len(u), n))
    step = FIRST_STEP_S
    for _ in range(STEPS):
        rate, slope = rates.with_slopes(x, u)
        change = np.linalg.solve(np.eye(n) / step - slope, rate[..., None])[..., 0]
        x = x + change
        if step >= LONG_STEP_S and not np.any(np.abs(change) > REACHED):
            break
        step = min(step * GROWTH, LAST_STEP_S)
    rate, slope = rates.with_slopes(x, u)
    rest = np.abs(rate).max(axis=1)
    # A motion is steady in practice only if it is stable: the real parts of all poles are negative.
    good = np.isfinite(x).all(axis=1) & (rest < STEADY)
    good &= np.array([bool((np.linalg.eigvals(s).real < 0.0).all()) if np.isfinite(s).all() else False for s in slope])
    x = np.where(good[:, None], x, np.nan)
    return SteadyMotion(rates.names, x, _errors(rates, x, u, slope, good, names, covariance))


def _errors(
    rates: Rates,
    x: Array,
    u: Array,
    slope: Array,
    good: Array,
    names: tuple[str, ...],
    covariance: Array | None,
) -> Array:
    """Return the standard errors (n_rows, n) of steady motions ``x``; NaN where a motion is not ``good``.

    ``slope``: derivatives of the rates by the states (n_rows, n, n). The other arguments are those of `steady_motion`.
    """
    sd = np.full_like(x, np.nan)
    used = [k for k, name in enumerate(names) if name in rates.parameters]
    if covariance is None or not used or not good.any():
        return sd
    at, inputs = x[good], u[good]
    known = np.nan_to_num(covariance[np.ix_(used, used)])
    found = np.zeros((len(at), len(rates.names), len(used)))
    for j, k in enumerate(used):
        size = RELATIVE_STEP * np.sqrt(known[j, j])
        if size > 0.0:
            found[:, :, j] = rates.by_parameter(at, inputs, names[k], float(size))
    by_estimate = -np.linalg.solve(slope[good], found)
    variance = np.einsum("rip,pq,riq->ri", by_estimate, known, by_estimate)
    sd[good] = np.sqrt(np.maximum(variance, 0.0))
    return sd
