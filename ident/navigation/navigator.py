"""Navigation: filtered and smoothed states of a fitted model along a record, with their covariance.

The ocean current is a state here. A fit estimates the current as a parameter of each record; a navigator does not have
this parameter in advance and estimates the current along the record.

Nor are the other parameters exact. They are constant states whose initial covariance is that of the fit. The two-stage
filter estimates them (Friedland 1969, Treatment of bias in recursive filtering, IEEE Trans. Automatic Control 14):

    x_total = x + D d,    P_total = P + D C D',    C = (1 + sum G' G)^-1,    d = -C sum G' e

The filter of the states runs with the parameters of the fit: state x, covariance P, innovations e over their standard
deviations. D and G are the derivatives of x and e by the parameters, along the principal directions of their covariance
and in standard deviations. The sums are over the samples that the estimate uses: all if it is smoothed. They are
divided by the excess of the score's variance, if the innovations are correlated because the model lacks something. The
result is that of one filter with states and parameters, if the model is linear in the parameters, and if the parameters
were estimated from other records. GNSS samples may be withheld to measure the effect of an outage
(``seatrial.ident.navigation.outages``).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
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
    principal_axes,
    smooth,
    smoothed_mean,
)
from seatrial.ident.model import Model
from seatrial.ident.models import CURRENT_WALK, current_walk
from seatrial.ident.numerics import Array, wrap

Kind = Literal["smoothed", "filtered"]
CURRENT = {"V_x": "drift_x", "V_y": "drift_y"}  # parameters of the current, and the states that replace them
POSITION = ("x", "y")
GNSS = {"x", "y", "vx", "vy", "speed"}  # outputs of a GNSS receiver
LARGEST_INNOVATION = 3.0  # standard deviations; larger innovations count as if they had this distance
MOST_MOVES = 4  # times that the derivatives are taken at other parameters
NEAR = 0.5  # standard deviations of the fit; over this distance the states are linear in the parameters
SCORE_BLOCK = 10.0  # s; blocks of the score's variance, longer than innovations are correlated
CURRENT_SD = 0.5  # m/s, initial standard deviation of the current if its parameter has no prior


@dataclass(frozen=True)
class Estimate:
    """Means and covariances of the states along a record. Parameter errors are included if their covariance was given.

    Attributes
    ----------
    x : Array (n_rows, n_states)
        Means, in the units of the states.
    P : Array (n_rows, n_states, n_states)
        Covariances, in the products of these units.
    """

    x: Array
    P: Array

    @property
    def sd(self) -> Array:
        """Standard deviations of the states (n_rows, n_states), in their units. A negative variance counts as zero."""
        return np.asarray(np.sqrt(np.maximum(np.diagonal(self.P, axis1=1, axis2=2), 0.0)))


@dataclass(frozen=True)
class Navigation:
    """Result of navigation along a record: estimated states with covariances, and which position fixes were used.

    A row is one instant of the record. A fix is a measured GNSS position. A fix is withheld if the filter does not use
    it on purpose, to measure the effect of a GNSS outage.

    Attributes
    ----------
    model : Model
        Model with the current as states.
    record : Record
        Record with the inputs and outputs of the model and all measurements, including withheld ones.
    values : Array (n_parameters,)
        Parameter values.
    kind : str
        Kind of ``best``: ``smoothed`` or ``filtered``.
    predicted : Estimate
        One-step predictions: states before the samples of each row are used.
    best : Estimate
        States from all samples (smoothed), or from the samples up to each row (filtered).
    run : FilterResult
        Filter run without the withheld samples.
    used : array of bool (n_rows,)
        Whether the row has a position fix that was given to the filter.
    withheld : array of bool (n_rows,)
        Whether the row has a position fix that was withheld. A row without a fix is in neither of the two.
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
        """Times of the rows (n_rows,) [s]."""
        return self.record.t

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states, in the order of the columns of estimates."""
        return tuple(s.name for s in self.model.states)

    @cached_property
    def _compiled(self) -> VectorisedModel:
        """Rates, outputs and Jacobians of the model, evaluated for many rows at once; created at the first use."""
        return VectorisedModel(self.model)

    def position(self, estimate: Estimate) -> tuple[Array, Array]:
        """Return the horizontal position of the antenna that follows from state estimates, with its covariance.

        The antenna is the point whose position the GNSS measures; a model without lever arm has it at the origin of the
        boat.

        Parameters
        ----------
        estimate : Estimate
            ``predicted`` or ``best``.

        Returns
        -------
        y : Array (n_rows, 2)
            Means of north and east [m].
        P : Array (n_rows, 2, 2)
            Covariances [m2], without measurement noise.
        """
        j = self._position_columns
        # the compiled model returns the rates of all states, then the outputs
        y = self._compiled(estimate.x, self.record.u, self.values)[:, len(self.states) :][:, j]
        H = self._compiled.output_jacobian(estimate.x, self.record.u, self.values)[:, j]
        return y, np.einsum("kij,kjl,kml->kim", H, estimate.P, H)

    @property
    def fixes(self) -> Array:
        """Measured positions, north and east (n_rows, 2) [m], with the withheld ones; NaN in rows without a fix."""
        return self.record.y[:, self._position_columns]

    @property
    def fix_variance(self) -> Array:
        """Measurement-noise variance of a fix, north and east (2,) [m2], the same for all rows."""
        return self.run.R[self._position_columns]

    @cached_property
    def _position_columns(self) -> list[int]:
        """Indices of the outputs x (north) and y (east), the position. ValueError is raised if one is missing."""
        names = [o.name for o in self.model.outputs]
        return [names.index(n) for n in POSITION]

    def current(self) -> Array | None:
        """Return the current of the estimate ``best`` (n_rows, 4) [m/s], None if the model has no current as states.

        The columns are the means to the north and east, then the standard deviations to the north and east.
        """
        if not set(CURRENT.values()) <= set(self.states):
            return None
        at = [self.states.index(n) for n in CURRENT.values()]
        # the states are deviations from the parameters, which are fixed at their prior means
        fixed = [p.value for n in CURRENT for p in self.model.parameters if p.name == n] or [0.0, 0.0]
        return np.hstack([self.best.x[:, at] + fixed, self.best.sd[:, at]])


def navigator(model: Model) -> Model:
    """Return the model with the ocean current as states, in place of its per-record parameters.

    A filter can then estimate the current along a record. The initial standard deviation of a state is that of the
    parameter's prior; without a prior it is 0.5 m/s, with the mean 0. Each parameter is fixed at the mean of its prior,
    and the state is the deviation from it. The states are constant unless the model has the effect of a random-walk
    current. A model without per-record parameters for both components of the current is returned unchanged.
    """
    currents = {p.name: p for p in model.parameters if p.name in CURRENT and p.per_record}
    if set(currents) != set(CURRENT):
        return model
    if CURRENT_WALK not in {e.name for e in model.effects}:
        walk = current_walk()  # without diffusion, its states are constant
        constant = tuple(replace(s, noise=0.0) for s in walk.states)
        model = model + replace(walk, parameters=(), states=constant, requires=())
    initial_sd = {CURRENT[n]: (p.prior or (0.0, CURRENT_SD))[1] for n, p in currents.items()}
    states = tuple(replace(s, sd0=initial_sd[s.name]) if s.name in initial_sd else s for s in model.states)
    fixed = [p.at(p.prior[0] if p.prior else 0.0).fixed() for p in currents.values()]
    return replace(model, states=states).replace_parameters(*fixed)


def navigate(
    model: Model,
    record: Record,
    *,
    smoothed: bool = True,
    without_gnss: Sequence[tuple[float, float]] = (),
    known: ParameterCovariance | None = None,
) -> Navigation:
    """Estimate the states of a fitted model along a record (position, velocity, current), with their covariance.

    Parameters
    ----------
    model : Model
        Fitted model, as ``seatrial.ident.estimation.load_model`` returns it.
    record : Record
        Outputs and inputs of one log. It must have all inputs of the model; an output that it lacks counts as not
        measured.
    smoothed : bool
        Whether ``Navigation.best`` uses all samples; otherwise it uses the samples up to each row.
    without_gnss : sequence of (float, float)
        Intervals of ``record.t`` [s] whose GNSS samples are not used, to measure the effect of an outage. The end of an
        interval does not belong to it.
    known : ParameterCovariance, optional
        Covariance of the parameters, whose errors widen the covariance of the states. Without it, the parameters count
        as exact.

    Returns
    -------
    Navigation
        States, their covariance, and which fixes were used.

    Raises
    ------
    ValueError
        If the model has no position, the record lacks an input, an interval contains no fix, no fix is left, or the
        filter diverges.
    """
    missing = [
        n for n in POSITION if n not in {o.name for o in model.outputs} or n not in {s.name for s in model.states}
    ]
    if missing:
        raise ValueError(
            f"model {model.name} has no position: {missing[0]} must be both a state and an output; use a model with "
            "the position, such as horizontal"
        )
    model = navigator(model)
    record = record.for_model(model)
    likelihood = Likelihood(model)
    values = np.array([p.value for p in model.parameters])
    reduced, withheld = _without_gnss_samples(model, record, without_gnss)
    run = likelihood.filter(reduced, values)
    if not np.isfinite(run.value):
        raise ValueError(
            f"{record.name}: the filter of model {model.name} diverges on this record; check that the model was fitted "
            "to this boat"
        )
    values, run, predicted, best = _with_estimated_parameters(likelihood, reduced, run, smoothed, known)
    kind: Kind = "smoothed" if smoothed else "filtered"
    at = [o.name for o in model.outputs].index(POSITION[0])
    return Navigation(
        model,
        record,
        values,
        kind,
        predicted,
        best,
        run,
        np.isfinite(reduced.y[:, at]),
        withheld,
    )


def _best_states(run: FilterResult, smoothed: bool) -> Estimate:
    """Return the best estimate: that of the smoother (given all samples) if ``smoothed``, else that of the filter.

    The estimate of the filter is that after the samples of each row. The errors of the parameters are not included.
    """
    if not smoothed:
        return Estimate(run.x_filt, run.P_filt)
    smoother = smooth(run)
    return Estimate(smoother.x, smoother.P)


def _without_gnss_samples(
    model: Model, record: Record, intervals: Sequence[tuple[float, float]]
) -> tuple[Record, NDArray[np.bool_]]:
    """Return a copy of the record without GNSS samples in some intervals, and in which rows a position was removed.

    The removed samples are NaN. They are those of all sensors whose outputs are all among ``x``, ``y``, ``vx``, ``vy``
    and ``speed``. Body velocities ``u``, ``v`` are not removed.

    Parameters
    ----------
    model
        Model of the record.
    record
        Record of the same outputs. It is not changed.
    intervals
        Pairs (begin, end) of times of the record [s], which may overlap; the end does not belong to the interval.
        Empty: nothing is removed.

    Returns
    -------
    Record
        Copy without these samples.
    Array (n_rows,) of bool
        Whether a position was removed from the row.

    Raises
    ------
    ValueError
        If an interval contains no fix, or no fix is left.
    """
    names = [o.name for o in model.outputs]
    columns = [names.index(o.name) for s in model.sensors if {o.name for o in s.outputs} <= GNSS for o in s.outputs]
    has_fix = np.isfinite(record.y[:, names.index(POSITION[0])])
    in_outage = np.zeros(record.n_rows, dtype=bool)
    for begin, end in intervals:
        inside = (record.t >= begin) & (record.t < end)
        if not (inside & has_fix).any():
            raise ValueError(
                f"{record.name}: no GNSS position between {begin:g} s and {end:g} s to withhold; give another interval"
            )
        in_outage |= inside
    if not (has_fix & ~in_outage).any():
        raise ValueError(f"{record.name}: no GNSS position is left; withhold shorter intervals")
    y = record.y.copy()
    y[np.ix_(np.flatnonzero(in_outage), np.array(columns))] = np.nan
    return replace(record, y=y), in_outage & has_fix


def _with_estimated_parameters(
    likelihood: Likelihood, record: Record, run: FilterResult, smoothed: bool, known: ParameterCovariance | None
) -> tuple[Array, FilterResult, Estimate, Estimate]:
    """Estimate states and parameters along a record.

    The filter, and the smoother if ``smoothed``, run again with parameters that are moved by 0.05 standard deviations
    to one side along each principal axis of their covariance. The changes, scaled to one standard deviation, are the
    derivatives of states and innovations. An axis for which the filter diverges is left out. If the parameters are
    found to be further than half a standard deviation from where the derivatives were taken, all is repeated there.

    Parameters
    ----------
    likelihood, record
        Likelihood of the model, and record.
    run
        Filter run with the parameters of the model.
    smoothed
        Whether the best estimate is that of the smoother.
    known
        Covariance of the parameters; None: the parameters are exact.

    Returns
    -------
    values : Array (n_parameters,)
        Parameters at which the derivatives were taken.
    run : FilterResult
        Filter run with these parameters.
    predicted, best : Estimate
        One-step prediction and best estimate.
    """
    model = likelihood.model
    values = np.array([p.value for p in model.parameters])
    axes = principal_axes(model, known)
    n = len(axes.at)
    if n == 0:
        return values, run, Estimate(run.x_pred, run.P_pred), _best_states(run, smoothed)
    centre = np.zeros(n)
    for later in range(MOST_MOVES, -1, -1):
        best = _best_states(run, smoothed)
        sd = np.sqrt(run.S)
        # Single precision is enough for derivatives, and a log of hours has many rows.
        slopes = np.zeros((*run.eps.shape, n), dtype=np.float32)
        d_pred, d_best = np.zeros((2, *best.x.shape, n), dtype=np.float32)
        for j, unit in enumerate(np.eye(n)):
            moved = likelihood.filter(record, axes.moved(values, centre + PARAMETER_STEP * unit))
            if not np.isfinite(moved.value):  # the filter diverges with these parameters
                continue
            moved_best = smoothed_mean(moved) if smoothed else moved.x_filt
            d_pred[:, :, j] = _state_difference(model, moved.x_pred, run.x_pred) / PARAMETER_STEP
            d_best[:, :, j] = _state_difference(model, moved_best, best.x) / PARAMETER_STEP
            slopes[:, :, j] = np.nan_to_num((moved.eps - run.eps) / sd) / PARAMETER_STEP
        e = np.nan_to_num(run.eps / sd)
        mean = _last_mean(_parameter_estimates(slopes, e, -centre))
        # A model that lacks something has innovations that are correlated for seconds: they inform less.
        root = np.sqrt(_excess_of_score_variance(record.t, slopes, e + slopes @ mean))
        mean = _last_mean(_parameter_estimates(slopes / root, e / root, -centre))
        if not later or np.max(np.abs(mean)) < NEAR:
            break
        moved_run = likelihood.filter(record, axes.moved(values, centre + mean))
        if not moved_run.value > run.value:
            break
        centre, run = centre + mean, moved_run
    predicted = Estimate(run.x_pred.copy(), run.P_pred.copy())
    best = Estimate(best.x.copy(), best.P.copy())
    for k, (mean, C) in enumerate(_parameter_estimates(slopes / root, e / root, -centre)):
        if k < len(d_pred):
            _add_parameters(predicted, k, d_pred[k], mean, C)
        if k > 0 and not smoothed:
            _add_parameters(best, k - 1, d_best[k - 1], mean, C)
    if smoothed:
        for k, D in enumerate(d_best):
            _add_parameters(best, k, D, mean, C)
    return axes.moved(values, centre), run, predicted, best


def _last_mean(estimates: Iterator[tuple[Array, Array]]) -> Array:
    """Return the mean of the last of the estimates, without keeping those before it."""
    ((mean, _),) = deque(estimates, maxlen=1)
    return mean


def _add_parameters(estimate: Estimate, row: int, D: Array, mean: Array, C: Array) -> None:
    """Add the errors of the parameters to one row of an estimate, in place.

    Parameters
    ----------
    estimate, row
        Estimate, and index of the row.
    D : Array (n_states, n_axes)
        Derivatives of its states by the parameters, along their axes and in standard deviations of the fit.
    mean, C : Array (n_axes,), (n_axes, n_axes)
        Means and covariance of the errors.
    """
    estimate.x[row] += D @ mean
    estimate.P[row] += D @ C @ D.T


def _excess_of_score_variance(t: Array, G: Array, e: Array) -> float:
    """Return by which factor the variance of the score exceeds the information of the innovations, at least 1.

    The factor is 1 if the innovations are white. The variance is that of sums over blocks of 10 s, as in a sandwich
    covariance (White 1982). Parameters that the innovations determine better than the fit count more.

    Parameters
    ----------
    t : Array (n_rows,)
        Times of the rows [s].
    G : Array (n_rows, n_outputs, n_axes)
        Derivatives of the innovations by the parameters, in standard deviations of both.
    e : Array (n_rows, n_outputs)
        Innovations with the estimated parameters, in their standard deviations.
    """
    if not G.shape[2]:
        return 1.0
    score = np.einsum("kij,ki->kj", G, np.clip(e, -LARGEST_INNOVATION, LARGEST_INNOVATION))
    block = np.unique(t // SCORE_BLOCK, return_inverse=True)[1]
    sums = np.zeros((block[-1] + 1, G.shape[2]))
    np.add.at(sums, block, score)
    information = np.einsum("kij,kil->jl", G, G)
    weight = np.linalg.inv(np.eye(G.shape[2]) + information)
    expected = np.trace(weight @ information)
    return max(float(np.trace(weight @ (sums.T @ sums)) / expected), 1.0) if expected > 0.0 else 1.0


def _parameter_estimates(G: Array, e: Array, mean: Array) -> Iterator[tuple[Array, Array]]:
    """Yield mean and covariance of the errors of the parameters before the first row, and after each row.

    They are in standard deviations of the fit, along the axes, and relative to where the derivatives were taken.

    Parameters
    ----------
    G : Array (n_rows, n_outputs, n_axes)
        Derivatives of the innovations by the parameters, in standard deviations of both.
    e : Array (n_rows, n_outputs)
        Innovations in their standard deviations. A sample that is not measured has 0 here and in ``G``.
    mean : Array (n_axes,)
        Estimates of the fit. Their covariance is the unit matrix.
    """
    C = np.eye(mean.size)
    yield mean, C
    for slopes, innovations in zip(G, e, strict=True):
        for g, own in zip(slopes, innovations, strict=True):  # the innovations of a row are independent of each other
            if own == 0.0:  # not measured
                continue
            Cg = C @ g
            variance = 1.0 + g @ Cg
            innovation = own + g @ mean
            # An outlier informs of the parameters no more than a sample at this distance (Huber).
            distance = abs(innovation) / math.sqrt(variance)
            gain = Cg / (variance * max(distance / LARGEST_INNOVATION, 1.0))
            mean = mean - gain * innovation
            C = C - gain[:, None] * Cg  # np.outer takes three times as long
        yield mean, C


def _state_difference(model: Model, a: Array, b: Array) -> Array:
    """Return the difference ``a - b`` of two state trajectories (n_rows, n_states).

    Differences of angles are wrapped to -pi to pi. A state is an angle if the model has an output of the same name that
    is one; other states are not wrapped. ``a`` and ``b`` are not changed.
    """
    angles = {o.name for o in model.outputs if o.angle}
    d = a - b
    for i, state in enumerate(model.states):
        d[:, i] = wrap(d[:, i], state.name in angles)
    return d
