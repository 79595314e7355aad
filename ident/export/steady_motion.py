"""Steady motion of a fitted model: the velocities that remain at constant inputs in still water, with their errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from seatrial.ident.engine import VectorisedModel
from seatrial.ident.export.codegen import without_nuisance
from seatrial.ident.export.linearisation import CURRENT, POSE
from seatrial.ident.model import Model
from seatrial.ident.numerics import Array

STEP = 1e-5  # step of the derivatives by the states, in their units
FIRST_STEP_S, LAST_STEP_S, GROWTH, STEPS = 0.1, 1e6, 1.5, 80  # step of time in the search [s], and its growth
STEADY = 1e-7  # largest rate of a steady motion, in the unit of each state per second
RELATIVE_STEP = 1e-4  # step of the derivatives by the parameters, as a part of their standard errors


@dataclass(frozen=True)
class SteadyMotion:
    """Steady motions of a model at several constant inputs.

    Attributes
    ----------
    states : tuple of str
        Names of the n states (velocities and shafts).
    x : Array (n_inputs, n)
        The states, NaN for inputs at which no stable steady motion is found.
    sd : Array (n_inputs, n)
        Standard errors of the states from those of the estimates; NaN if they are unknown.
    """

    states: tuple[str, ...]
    x: Array
    sd: Array

    def of(self, state: str) -> tuple[Array, Array]:
        """Return the values and the standard errors (n_inputs,) of one state. KeyError if there is none."""
        if state not in self.states:
            raise KeyError(f"the model has no state {state!r}; its states are {', '.join(self.states)}")
        j = self.states.index(state)
        return self.x[:, j], self.sd[:, j]


def steady_motion(
    model: Model,
    u: Array,
    names: tuple[str, ...] = (),
    covariance: Array | None = None,
    held: tuple[str, ...] = (),
) -> SteadyMotion:
    """Return the motions of a model that are steady in still water at constant inputs.

    Disturbance forces and random-walk biases are left out. Each motion is the end of a motion from rest. A steady
    motion that is not stable counts as not found (NaN).

    Parameters
    ----------
    model : Model
        Model with its estimates as values.
    u : Array (n_rows, m)
        Inputs of each motion: those of the model without delayed copies, in the order of the model.
    names : tuple of str
        Names of the estimates that ``covariance`` belongs to. Estimates of one record (``V_x@0``) are left out.
    covariance : Array (n_names, n_names), optional
        Covariance of the estimates; rows of NaN count as zero. None: the errors are NaN.
    held : tuple of str
        States that are held at zero, for example ``("v", "r")`` for straight motion. They are not in the result.

    Notes
    -----
    The search is the implicit Euler method with growing steps (pseudo-transient continuation, Kelley and Keyes 1998),
    which ends as Newton's method. The errors are those of the implicit function theorem: ``dx/dp = -J^-1 df/dp``.
    """
    reduced, _ = without_nuisance(model)
    rates = _Rates(reduced, held)
    u = rates.with_copies(np.atleast_2d(u))
    x = np.zeros((len(u), rates.n))
    step = FIRST_STEP_S
    for _ in range(STEPS):
        slope = rates.slope(x, u)
        x = x + np.linalg.solve(np.eye(rates.n) / step - slope, rates(x, u)[..., None])[..., 0]
        step = min(step * GROWTH, LAST_STEP_S)
    rest = np.abs(rates(x, u)).max(axis=1)
    slope = rates.slope(x, u)
    # A motion is steady in practice only if it is stable: the real parts of all poles are negative.
    good = np.isfinite(x).all(axis=1) & (rest < STEADY)
    good &= np.array([bool((np.linalg.eigvals(s).real < 0.0).all()) if np.isfinite(s).all() else False for s in slope])
    x = np.where(good[:, None], x, np.nan)
    return SteadyMotion(rates.names, x, _errors(rates, x, u, slope, good, names, covariance))


def _errors(
    rates: _Rates,
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
    found = np.zeros((len(at), rates.n, len(used)))
    for j, k in enumerate(used):
        size = RELATIVE_STEP * np.sqrt(known[j, j])
        if size > 0.0:
            found[:, :, j] = rates.by_parameter(at, inputs, names[k], float(size))
    by_estimate = -np.linalg.solve(slope[good], found)
    variance = np.einsum("rip,pq,riq->ri", by_estimate, known, by_estimate)
    sd[good] = np.sqrt(np.maximum(variance, 0.0))
    return sd


class _Rates:
    """Rates of the dynamic states of a model for many rows of states and inputs, in still water.

    Attributes
    ----------
    names : tuple of str
        Names of the n dynamic states.
    n : int
        Their number.
    parameters : tuple of str
        Names of the parameters, without the current.
    """

    def __init__(self, model: Model, held: tuple[str, ...]) -> None:
        """Set up the rates of a model without nuisance states. Current and states ``held`` have the value zero."""
        self.names = tuple(s.name for s in model.states if s.name not in (*POSE, *held))
        self.n = len(self.names)
        self.parameters = tuple(n for n in model.values if n not in CURRENT)
        self._at = [k for k, s in enumerate(model.states) if s.name in self.names]
        self._size, self._all = len(model.states), list(model.values)
        inputs = [i.name for i in model.inputs if not i.tap]
        self._own = [inputs.index(i.tap_of if i.tap else i.name) for i in model.inputs]
        self._values = np.array([0.0 if n in CURRENT else v for n, v in model.values.items()])
        self._model = VectorisedModel(model)

    def with_copies(self, u: Array) -> Array:
        """Return the inputs (n_rows, m) with their delayed copies, which have the same values."""
        return u[:, self._own]

    def __call__(self, x: Array, u: Array, values: Array | None = None) -> Array:
        """Return the rates (n_rows, n) at states x (n_rows, n) and inputs u, with position and heading zero."""
        whole = np.zeros((len(x), self._size))
        whole[:, self._at] = x
        found: Array = self._model(whole, u, self._values if values is None else values)[:, self._at]
        return found

    def slope(self, x: Array, u: Array) -> Array:
        """Return the derivatives (n_rows, n, n) of the rates by the states: central differences."""
        columns = []
        for j in range(self.n):
            d = np.zeros(self.n)
            d[j] = STEP
            columns.append((self(x + d, u) - self(x - d, u)) / (2.0 * STEP))
        return np.stack(columns, axis=2)

    def by_parameter(self, x: Array, u: Array, name: str, size: float) -> Array:
        """Return the derivatives (n_rows, n) of the rates by one parameter: central differences with step ``size``."""
        d = np.zeros(self._values.size)
        d[self._all.index(name)] = size
        return (self(x, u, self._values + d) - self(x, u, self._values - d)) / (2.0 * size)
