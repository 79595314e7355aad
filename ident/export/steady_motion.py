"""Steady motion of a fitted model: the velocities that remain at constant inputs in still water, with their errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
NEWTON_STEPS = 60
PARTS = (1.0, 0.5, 0.2, 0.05)  # parts of a step of Newton's method that are tried
# Half differences of the sides at which the search for a straight course starts. At zero command the thrust does not
# depend on the difference to first order, so that Newton's method cannot leave zero.
STARTS = (0.0, 0.1, -0.1)


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


@dataclass(frozen=True)
class StraightMotion:
    """Steady motions of a model on a straight course, which the inputs of both sides hold.

    Attributes
    ----------
    speed : Array (n_rows,)
        Forward speed [m/s]; NaN where no steady straight motion is found.
    sd : Array (n_rows,)
        Standard error of the speed from those of the estimates [m/s]; NaN if it is unknown.
    difference : Array (n_rows,)
        Factor of the direction ``turning`` that is added to the inputs to hold the course.
    growth : Array (n_rows,)
        Largest real part of the poles at constant inputs [1/s]. If it is positive, the boat leaves the course without
        a controller.
    """

    speed: Array
    sd: Array
    difference: Array
    growth: Array


def straight_motion(
    model: Model,
    u: Array,
    turning: Array,
    names: tuple[str, ...] = (),
    covariance: Array | None = None,
    conditions: Mapping[str, float] | None = None,
) -> StraightMotion:
    """Return the steady motions of a model without yaw rate, in still water, at inputs that hold the course.

    The inputs of a row are ``u + difference * turning``. The yaw rate is zero, and its rate of change too. Sway is
    free: a boat whose sides push unequally may drift. A motion whose surge is not stable counts as not found (NaN). A
    motion whose course is not stable is returned with a positive ``growth``.

    Parameters
    ----------
    model : Model
        Model with its estimates as values, with the states u and r.
    u : Array (n_rows, m)
        Inputs of each motion before the difference: those of the model without delayed copies, time and work.
    turning : Array (m,)
        Change of the inputs that turns the boat, for example +1 for the left side and -1 for the right side.
    names, covariance, conditions
        As those of `steady_motion`.

    Notes
    -----
    Newton's method with shortened steps starts from the motion whose sway and yaw rate are held at zero. The unknowns
    are the states without the yaw rate, and the difference. The errors are those of the implicit function theorem.
    """
    reduced, _ = without_nuisance(model)
    rates, u = Rates(reduced, (), chosen_conditions(reduced, at=conditions)), np.atleast_2d(u)
    yaw = rates.names.index("r")
    side = [k for k, n in enumerate(rates.names) if n in ("v", "r")]
    other = [k for k in range(len(rates.names)) if k not in side]
    start = np.zeros((len(u), len(rates.names)))
    start[:, other] = steady_motion(model, u, held=("v", "r"), conditions=conditions).x
    # The yaw rate is zero: its column has the difference instead.
    z, rest = np.nan_to_num(start), np.full(len(u), np.inf)
    for first in STARTS:
        open_ = np.flatnonzero(~(rest < STEADY))
        if not open_.size:
            break
        z[open_] = np.nan_to_num(start[open_])
        z[open_, yaw] = first
        z[open_], rest[open_] = _newton(rates, z[open_], u[open_], turning, yaw)
    x, difference = z.copy(), z[:, yaw].copy()
    x[:, yaw] = 0.0
    inputs = u + difference[:, None] * turning
    _, slope = rates.with_slopes(x, inputs)
    good = np.isfinite(z).all(axis=1) & (rest < STEADY) & np.isfinite(slope).all(axis=(1, 2))
    growth = np.full(len(u), np.nan)
    for k in np.flatnonzero(good):
        good[k] = bool((np.linalg.eigvals(slope[k][np.ix_(other, other)]).real < 0.0).all())
        growth[k] = np.linalg.eigvals(slope[k]).real.max() if good[k] else np.nan
    forward = rates.names.index("u")
    whole = _with_difference(slope, rates.by_inputs(x, inputs), turning, yaw)
    sd = _errors(rates, x, inputs, whole, good, names, covariance)[:, forward]
    speed, difference = np.where(good, x[:, forward], np.nan), np.where(good, difference, np.nan)
    return StraightMotion(speed, sd, difference, growth)


def _with_difference(slope: Array, by_inputs: Array, turning: Array, yaw: int) -> Array:
    """Return the slopes (n_rows, n, n) whose column ``yaw`` is the derivative by the difference of the inputs."""
    whole = slope.copy()
    whole[:, :, yaw] = by_inputs @ turning
    return whole


def _newton(rates: Rates, z: Array, u: Array, turning: Array, yaw: int) -> tuple[Array, Array]:
    """Return the unknowns z (n_rows, n) of straight motion, and their largest rates (n_rows,).

    The column ``yaw`` of z has the difference of the inputs; the yaw rate is zero.
    """

    def split(z: Array) -> tuple[Array, Array]:
        x = z.copy()
        x[..., yaw] = 0.0
        return x, u + z[..., yaw, None] * turning

    size = np.full(len(z), np.inf)
    for _ in range(NEWTON_STEPS):
        x, inputs = split(z)
        rate, slope = rates.with_slopes(x, inputs)
        size = np.abs(rate).max(axis=1)
        whole = _with_difference(slope, rates.by_inputs(x, inputs), turning, yaw)
        if not (np.isfinite(size).all() and np.isfinite(whole).all()):
            whole, rate = np.nan_to_num(whole, posinf=0.0, neginf=0.0), np.nan_to_num(rate, posinf=0.0, neginf=0.0)
        if np.all(size < REACHED):
            break
        step = -(np.linalg.pinv(whole) @ rate[..., None])[..., 0]
        tried = np.stack([z + part * step for part in PARTS])
        sizes = np.stack([np.abs(rates(*split(t))).max(axis=1) for t in tried])
        best = np.argmin(np.where(np.isfinite(sizes), sizes, np.inf), axis=0)
        rows = np.arange(len(z))
        better = sizes[best, rows] < size
        if not better.any():
            break
        z = np.where(better[:, None], tried[best, rows], z)
    return z, np.abs(rates(*split(z))).max(axis=1)


def _errors(
    rates: Rates,
    x: Array,
    u: Array,
    slope: Array,
    good: NDArray[np.bool_],
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
    # The pseudo-inverse: at zero command the thrust does not depend on a difference of the sides to first order.
    by_estimate = -np.linalg.pinv(slope[good]) @ found
    variance = np.einsum("rip,pq,riq->ri", by_estimate, known, by_estimate)
    sd[good] = np.sqrt(np.maximum(variance, 0.0))
    return sd
