"""Navigation: filtered and smoothed states of a fitted model along a record, with their covariance.

The current is among the states: a fit estimates it as a parameter of each record, a navigator does not know it
beforehand and estimates it along the record. Parameter errors are included as a consider covariance (Bierman 1977,
chapter 8):

    P_total = P + sum_i dx_i dx_i',   dx_i = the change of the estimate by one standard deviation of the parameters

over the principal directions i of their covariance; exact where the estimate is linear in the parameters and the
record is not one that they were estimated from. GNSS samples may be withheld to measure the effect of an outage
(``seatrial.ident.navigation.outages``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.data import Record
from seatrial.ident.engine import VectorisedModel
from seatrial.ident.estimation import (
    PARAMETER_STEP,
    FilterResult,
    Likelihood,
    ParameterCovariance,
    principal_directions,
    smooth,
    smoothed_mean,
)
from seatrial.ident.model import Model
from seatrial.ident.models import CURRENT_WALK, current_walk
from seatrial.ident.numerics import Array, wrap

Kind = Literal["smoothed", "filtered"]
CURRENT = {"V_x": "drift_x", "V_y": "drift_y"}  # parameters, and the states that replace them
POSITION = ("x", "y")
GNSS = {"x", "y", "vx", "vy", "speed"}  # outputs of a GNSS receiver
CURRENT_SD = 0.5  # m/s, prior standard deviation of a current that has none


@dataclass(frozen=True)
class Estimate:
    """Means x (n_rows, n_states) and covariances P (n_rows, n_states, n_states), parameter errors included."""

    x: Array
    P: Array

    @property
    def sd(self) -> Array:
        """Standard deviations (n_rows, n_states)."""
        return np.asarray(np.sqrt(np.maximum(np.diagonal(self.P, axis1=1, axis2=2), 0.0)))


@dataclass(frozen=True)
class Navigation:
    """State estimates along a record.

    Attributes:
        record: with all that was measured.
        predicted: one step ahead, before the samples of each row.
        best: by all samples (``kind`` smoothed) or by those up to the row (filtered).
        used, withheld (n_rows,): rows whose position was used, and rows whose position was withheld.
    """

    model: Model
    record: Record
    values: Array
    kind: Kind
    predicted: Estimate
    best: Estimate
    run: FilterResult
    used: NDArray[np.bool_]
    withheld: NDArray[np.bool_]

    @property
    def t(self) -> Array:
        return self.record.t

    @property
    def states(self) -> tuple[str, ...]:
        return tuple(s.name for s in self.model.states)

    @cached_property
    def _rowwise(self) -> VectorisedModel:
        return VectorisedModel(self.model)

    def position(self, of: Estimate) -> tuple[Array, Array]:
        """North and east of the antenna: means (n_rows, 2), covariances (n_rows, 2, 2) without measurement noise."""
        j = self._columns
        y = self._rowwise(of.x, self.record.u, self.values)[:, len(self.states) :][:, j]
        H = self._rowwise.output_jacobian(of.x, self.record.u, self.values)[:, j]
        return y, np.einsum("kij,kjl,kml->kim", H, of.P, H)

    @property
    def fixes(self) -> Array:
        """Measured positions (n_rows, 2), NaN where there is none, withheld ones included."""
        return self.record.y[:, self._columns]

    @property
    def fix_variance(self) -> Array:
        """Measurement-noise variance of a fix, north and east (2,)."""
        return self.run.R[self._columns]

    @cached_property
    def _columns(self) -> list[int]:
        names = [o.name for o in self.model.outputs]
        return [names.index(n) for n in POSITION]

    def current(self) -> Array | None:
        """Current to the north and east, as a mean and a standard deviation (n_rows, 4); None without one."""
        if not set(CURRENT.values()) <= set(self.states):
            return None
        at = [self.states.index(n) for n in CURRENT.values()]
        given = [p.value for n in CURRENT for p in self.model.parameters if p.name == n] or [0.0, 0.0]
        return np.hstack([self.best.x[:, at] + given, self.best.sd[:, at]])


def navigator(model: Model) -> Model:
    """The model with its per-record current as states, whose initial covariance is the prior."""
    own = {p.name: p for p in model.parameters if p.name in CURRENT and p.per_record}
    if set(own) != set(CURRENT):
        return model
    if CURRENT_WALK not in {e.name for e in model.effects}:
        walk = current_walk()  # constant without its diffusion
        constant = tuple(replace(s, noise=0.0) for s in walk.states)
        model = model + replace(walk, parameters=(), states=constant, requires=())
    uncertain = {CURRENT[n]: (p.prior or (0.0, CURRENT_SD))[1] for n, p in own.items()}
    states = tuple(replace(s, sd0=uncertain[s.name]) if s.name in uncertain else s for s in model.states)
    fixed = [p.at(p.prior[0] if p.prior else 0.0).fixed() for p in own.values()]
    return replace(model, states=states).replace_parameters(*fixed)


def navigate(
    model: Model,
    record: Record,
    *,
    smoothed: bool = True,
    without_gnss: Sequence[tuple[float, float]] = (),
    known: ParameterCovariance | None = None,
) -> Navigation:
    """States with their covariance along a record.

    model: fitted, as ``seatrial.ident.estimation.load_model`` returns it. smoothed: by all samples, else by those up to
    each row. without_gnss: intervals of ``record.t`` [s] whose GNSS samples are withheld. known: covariance of the
    parameters; without it they count as exact. Raises ValueError where the model has no position, an interval holds no
    fix, or the filter diverges.
    """
    lost = [n for n in POSITION if n not in {o.name for o in model.outputs} or n not in {s.name for s in model.states}]
    if lost:
        raise ValueError(f"model {model.name} has no position: {lost[0]} is not both a state and an output of it")
    model = navigator(model)
    record = record.for_model(model)
    likelihood = Likelihood(model)
    values = np.array([p.value for p in model.parameters])
    seen, withheld = _withhold(model, record, without_gnss)
    run = likelihood.filter(seen, values)
    if not np.isfinite(run.value):
        raise ValueError(
            f"{record.name}: the filter of model {model.name} diverges on this record; was it fitted to this boat?"
        )
    x, P = _best(run, smoothed)
    d_pred, d_best = _consider_covariance(likelihood, seen, values, run, x, known, smoothed)
    kind: Kind = "smoothed" if smoothed else "filtered"
    at = [o.name for o in model.outputs].index(POSITION[0])
    return Navigation(
        model,
        record,
        values,
        kind,
        Estimate(run.x_pred, run.P_pred + d_pred),
        Estimate(x, P + d_best),
        run,
        np.isfinite(seen.y[:, at]),
        withheld,
    )


def _best(run: FilterResult, smoothed: bool) -> tuple[Array, Array]:
    if not smoothed:
        return run.x_filt, run.P_filt
    done = smooth(run)
    return done.x, done.P


def _withhold(
    model: Model, record: Record, intervals: Sequence[tuple[float, float]]
) -> tuple[Record, NDArray[np.bool_]]:
    """The record without the GNSS samples of the intervals, and the rows whose position was withheld."""
    names = [o.name for o in model.outputs]
    columns = [names.index(o.name) for s in model.sensors if {o.name for o in s.outputs} <= GNSS for o in s.outputs]
    fixed = np.isfinite(record.y[:, names.index(POSITION[0])])
    gone = np.zeros(record.n_rows, dtype=bool)
    for begin, end in intervals:
        inside = (record.t >= begin) & (record.t < end)
        if not (inside & fixed).any():
            raise ValueError(f"{record.name}: no GNSS position between {begin:g} s and {end:g} s to withhold")
        gone |= inside
    if not (fixed & ~gone).any():
        raise ValueError(f"{record.name}: no GNSS position is left; withhold less")
    y = record.y.copy()
    y[np.ix_(np.flatnonzero(gone), np.array(columns))] = np.nan
    return replace(record, y=y), gone & fixed


def _consider_covariance(
    likelihood: Likelihood,
    record: Record,
    values: Array,
    run: FilterResult,
    x: Array,
    known: ParameterCovariance | None,
    smoothed: bool,
) -> tuple[Array, Array]:
    """Consider covariances (2, n_rows, n, n): contribution of parameter errors to prediction and estimate."""
    n = x.shape[1]
    added = np.zeros((2, len(x), n, n))
    for step in principal_directions(likelihood.model, values, known):
        other = likelihood.filter(record, step)
        if not np.isfinite(other.value):
            continue
        best = smoothed_mean(other) if smoothed else other.x_filt
        for k, (a, b) in enumerate(((other.x_pred, run.x_pred), (best, x))):
            d = _difference(likelihood.model, a, b) / PARAMETER_STEP
            added[k] += d[:, :, None] * d[:, None, :]
    return added[0], added[1]


def _difference(model: Model, a: Array, b: Array) -> Array:
    angles = {o.name for o in model.outputs if o.angle}
    d = a - b
    for i, state in enumerate(model.states):
        d[:, i] = wrap(d[:, i], state.name in angles)
    return d
