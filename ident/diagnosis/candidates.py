"""Candidates of the score test: parametric effects linearised at zero, and nonparametric (spline) alternatives.

The score of waves is zero at zero amplitude. Waves are therefore tested by a narrow peak in the spectrum of the
innovations.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.data import TIME_INPUT, Record
from seatrial.ident.diagnosis.policy import DEFAULT_POLICY, SearchPolicy
from seatrial.ident.diagnosis.score_test import (
    ColumnIndex,
    NormalEquations,
    Score,
    SensitivityColumns,
    SensitivityFilter,
    assign_columns,
    block_index,
    propagate_sensitivities,
    whole_blocks,
)
from seatrial.ident.effects import WAVES, harmonics, input_response_effects
from seatrial.ident.engine import VectorisedModel, vectorised
from seatrial.ident.estimation import FittedModel, wave_peak, wave_sizes
from seatrial.ident.model import (
    DisturbanceChannel,
    Effect,
    EffectKind,
    ForceCurve,
    Model,
    Parameter,
    RecordedEvaluation,
    curve_name,
)
from seatrial.ident.models import products_of, residuals_of, sensor_errors_of, thrust_losses_of, variables_of
from seatrial.ident.numerics import Array, chi2_isf, wrap

SMALLEST_P = 1e-300  # smaller p values have no finite chi-squared quantile
TERMS = 14  # of the series of a matrix exponential, for a norm of at most one half


class TrajectoryLinearisation:
    """Linearisation of a model along the states that the filter predicted on one record, by finite differences.

    It gives the sensitivities of state rates and outputs to parameters and candidate effects in each row.

    Parameters
    ----------
    model
        The model.
    values : Array (n_parameters,)
        Parameter values.
    record
        Record with the inputs of all candidates.
    x : Array (n_rows, n_states)
        Predicted states.

    Attributes
    ----------
    rowwise
        The model, compiled to be evaluated on all rows of the record at once.
    own
        The record with the inputs of the model only.
    """

    def __init__(self, model: Model, values: Array, record: Record, x: Array) -> None:
        self.model, self.values, self.record, self.x = model, values, record, x
        self.rowwise = vectorised(model)
        self.own = record.for_model(model)
        self._larger: dict[tuple[str, ForceCurve | None], tuple[Model, VectorisedModel]] = {}
        self._acting: dict[tuple[str, ForceCurve | None], list[bool]] = {}  # results of `_act_through_states`
        self._ends: dict[tuple[str, ForceCurve | None], list[Array]] = {}  # states of effects at the last row

    def share_models(self, other: TrajectoryLinearisation) -> None:
        """Use the compiled models with candidates of ``other``, so that each is derived only once.

        Both linearisations must have the same model. They then share one store: a model that either of them derives
        later is also used by the other.
        """
        self.rowwise, self._larger, self._acting = other.rowwise, other._larger, other._acting

    def part(self, rows: slice) -> TrajectoryLinearisation:
        """Return the linearisation of consecutive rows of the record, so that a long record is processed in parts.

        The caller has to choose ``rows`` so that the first row of each part is the last row of the part before, because
        the states that effects add continue from there. All parts share one store of these states, so the parts have to
        be processed in the order of time. The original is not changed.
        """
        part = copy(self)
        part.record, own = self.record.rows(rows), self.own.rows(rows)
        part.own, part.x = replace(own, u=np.asfortranarray(own.u)), np.asfortranarray(self.x[rows])
        for computed in ("base", "recorded", "jacobian", "steps"):
            part.__dict__.pop(computed, None)
        return part

    @cached_property
    def base(self) -> Array:
        """Rates of the states, then values of the outputs, in each row, Array (n_rows, n_states + n_outputs)."""
        return self.rowwise(self.x, self.own.u, self.values)

    @cached_property
    def recorded(self) -> RecordedEvaluation | None:
        """Evaluation of the model, from which those of the model with a candidate continue.

        None if a function of the model does not accept arrays or changes them in place.
        """
        try:
            with np.errstate(all="ignore"):
                return RecordedEvaluation(self.model, list(self.x.T), list(self.own.u.T), self.values.tolist())
        except (TypeError, ValueError):
            return None

    @cached_property
    def jacobian(self) -> Array:
        """Derivatives of the outputs by the states in each row, Array (n_rows, n_outputs, n_states)."""
        return self.rowwise.output_jacobian(self.x, self.own.u, self.values)

    @cached_property
    def steps(self) -> tuple[Array, NDArray[np.int64]]:
        """Distinct lengths of the intervals between rows [s], and the index of the length of each interval.

        The lengths are an Array (n_distinct,), rounded to 1e-9 s. The indices are an Array (n_rows - 1,).
        """
        lengths, which = np.unique(np.round(self.record.h[:-1], 9), return_inverse=True)
        return lengths, which

    def parameter(self, name: str) -> Array:
        """Return the derivatives of state rates and outputs by a parameter of the model.

        The result is an Array (n_rows, n_states + n_outputs). The derivatives are central differences with the step of
        the parameter, or with 1 % of its value (at least 1e-5) if it has no step.

        Raises
        ------
        ValueError
            If the model has no parameter of this name.
        """
        index = [p.name for p in self.model.parameters].index(name)
        p = self.model.parameters[index]
        h = p.step or 0.01 * max(abs(self.values[index]), 1e-3)
        up, down = self.values.copy(), self.values.copy()
        up[index] += h / 2
        down[index] -= h / 2
        return (self.rowwise(self.x, self.own.u, up) - self.rowwise(self.x, self.own.u, down)) / h

    def state(self, name: str) -> Array:
        """Return the derivatives of state rates and outputs by a disturbance state of the model.

        The result is an Array (n_rows, n_states + n_outputs), per unit of the state. The difference is exact for these
        states, because they enter linearly. The rate of the state itself is set to zero, because its decay is not an
        effect on the boat.

        Raises
        ------
        ValueError
            If the model has no state of this name.
        """
        index = [s.name for s in self.model.states].index(name)
        moved = self.x.copy()
        moved[:, index] += 1.0
        change = self.rowwise(moved, self.own.u, self.values) - self.base
        change[:, index] = 0.0  # the decay of the state itself is not an effect on the boat
        return change

    def relative(self, residual: DisturbanceChannel) -> Array:
        """Return the derivatives of state rates and outputs by a relative change of a thrust.

        The result is an Array (n_rows, n_states + n_outputs) for a change by 1, that is by 100 % of the thrust.
        ``residual`` is the thrust of one or of all thrusters. The difference is exact, because the change enters
        linearly.
        """
        name = f"change_of_{residual.name}"
        hooks = {residual.stage: lambda s: residual.add(s, getattr(s.p, name))}
        larger = self.model + Effect(name, residual.title, hooks, parameters=(Parameter(name, 0.0),))
        return VectorisedModel(larger)(self.x, self.own.u, np.append(self.values, 1.0)) - self.base

    def effect(self, effect: Effect) -> Iterator[SensitivityColumns]:
        """Yield the sensitivities of one parametric candidate, once for each combination of its scanned parameters.

        The columns are the derivatives by the size parameters of the effect, as forward differences over their steps. A
        size parameter is not scanned and not on a log scale, and its value in the effect is zero (the first parameter
        may have another value). The other parameters describe the form and keep their values. The states of the effect
        at the last row are stored for the next `part`.
        """
        key, n, m = (effect.name, effect.curve), len(self.model.states), len(effect.states)
        if key not in self._larger:
            self._larger[key] = self.model + effect, VectorisedModel(self.model + effect)
        larger, rowwise = self._larger[key]
        u = np.asfortranarray(self.record.for_model(larger).u)
        scans = [dict(zip(effect.scan, scan, strict=True)) for scan in product(*effect.scan.values())]
        sizes = [
            (j, p) for j, p in enumerate(effect.parameters)  # the other parameters describe the form of the effect
            if not (p.transform == "log" or p.name in effect.scan or (j > 0 and p.value != 0.0))
        ]  # fmt: skip
        # for each scan: the values at zero, followed by those with each size moved by its step
        value_sets = [
            _each_moved(
                np.append(self.values, [scanned.get(p.name, p.value) for p in effect.parameters]),
                len(self.values),
                sizes,
            )
            for scanned in scans
        ]
        state_sets = self._effect_states(effect, value_sets, u)
        for scanned, (zero, *moved), (z0, *z_moved) in zip(scans, value_sets, state_sets, strict=True):
            x_zero = self._with_states(z0)

            def without_own_states(values: Array, x: Array, rowwise: VectorisedModel = rowwise) -> list[Array]:
                """Return the columns (n_rows,) of rates and outputs at x, without the rates of the effect's own states.

                ``values`` are the parameters of the model with the effect, ``rowwise``.
                """
                columns = rowwise.columns(x, u, values, self.recorded)
                return columns[:n] + columns[n + m :]

            at_zero = all(p.value == 0.0 for _, p in sizes)
            base = list(self.base.T) if at_zero else without_own_states(zero, x_zero)
            changes = []
            for values, z in zip(moved, z_moved, strict=True):
                found = without_own_states(values, x_zero if z is z0 else self._with_states(z))
                changes.append([after - before for after, before in zip(found, base, strict=True)])
            per_record = effect.kind is EffectKind.BETWEEN_RUNS or all(p.per_record for p in effect.parameters)
            touched = np.flatnonzero([any(c.any() for c in column) for column in zip(*changes, strict=True)])
            delta = np.empty((len(self.x), touched.size, len(changes)))
            for k, (change, (_, p)) in enumerate(zip(changes, sizes, strict=True)):
                for i, j in enumerate(touched.tolist()):
                    np.divide(change[j], p.step, out=delta[:, i, k])
            yield SensitivityColumns(
                effect.name,
                delta,
                tuple(p.name for _, p in sizes),
                scanned,
                effect.kind,
                effect.curve,
                effect.one_sided,
                per_record,
                touched,
            )

    def _with_states(self, z: Array) -> Array:
        """Return the states of the model followed by those z (n_rows, m) of an effect; the columns are contiguous."""
        return np.concatenate([self.x.T, z.T]).T

    def _effect_states(self, effect: Effect, value_sets: Sequence[Sequence[Array]], u: Array) -> list[list[Array]]:
        """Return the states (n_rows, m) that an effect adds, along the trajectory, for each of the sets of values.

        The states do not act on the model, because the size of the effect is zero. They are driven by the states and
        inputs of the model. Their values at the last row are stored for the next `part`. For a size that does not act
        through the states, the states are those at zero.

        Parameters
        ----------
        effect
            The effect. Without states, m is zero.
        value_sets
            Values of the parameters of the model with the effect: for each scan those at zero, and those with each size
            parameter moved.
        u : Array (n_rows, n_inputs)
            Inputs of the model with the effect.
        """
        if not effect.states:
            none = np.zeros((len(self.x), 0))
            return [[none] * len(values) for values in value_sets]
        key = (effect.name, effect.curve)
        larger, rowwise = self._larger[key]
        if key not in self._acting:
            self._acting[key] = _act_through_states(rowwise, value_sets[0], len(effect.states))
        acting = self._acting[key]
        distinct = [v for values in value_sets for v, acts in zip(values, acting, strict=True) if acts]
        begin = self._ends.get(key, [_initial_states(larger, effect, values) for values in distinct])
        found = self._driven_states(rowwise, begin, distinct, u)
        self._ends[key] = [z[-1].copy() for z in found]
        states, each = list[list[Array]](), iter(found)
        for _ in value_sets:
            at_zero = next(each)
            states.append([at_zero, *(next(each) if acts else at_zero for acts in acting[1:])])
        return states

    def _driven_states(
        self, rowwise: VectorisedModel, begin: list[Array], all_values: list[Array], u: Array
    ) -> list[Array]:
        """Return the states (n_rows, m) that an effect adds, along the trajectory, for each set of parameter values.

        States that are linear with constant coefficients are solved for all rows at once, others are integrated from
        row to row.

        Parameters
        ----------
        rowwise
            The model with the effect, evaluated on all rows at once.
        begin
            States (m,) at the first row, for each set of values.
        all_values
            Sets of parameter values of the model with the effect.
        u : Array (n_rows, n_inputs)
            Inputs of the model with the effect.
        """
        n, m = len(self.model.states), begin[0].size
        x = np.concatenate([self.x.T, np.zeros((m, len(self.x)))]).T
        steps, step_of = self.steps
        matrices = [_constant_coefficients(rowwise, x, u, values, m) for values in all_values]
        if any(A is None for A in matrices):
            h = self.record.h[:-1]
            return list(rowwise.integrate_last_states(self.x, u, np.stack(all_values), h, np.stack(begin)))
        found = []
        for z, values, A in zip(begin, all_values, matrices, strict=True):
            assert A is not None
            drive = rowwise.rates(x, u, values, self.recorded)[:, n:]
            transition, weight = (each[step_of] for each in _discretised_dynamics(A, steps))
            mean = (drive[:-1] + drive[1:]) / 2
            found.append(_solved_recursion(transition, np.einsum("kij,kj->ki", weight, mean), z))
        return found

    def generic(self, among: Mapping[str, SplineBasis] | None = None) -> Iterator[SensitivityColumns]:
        """Yield the sensitivities of the nonparametric candidates, one after the other.

        Each residual force is a smooth function of each variable and of products of two, or a lagged or resonant
        response to the thrusters. Each sensor error or thrust loss is a smooth function of those variables that its
        definition lists.

        Parameters
        ----------
        among
            Spline bases by the name of their variable, by default those of this record. Give the bases of all records
            together, so that a column has the same meaning in each record.
        """
        table = generic_features(self.model, self.own, self.x, among, self.values)
        for residual in (*residuals_of(self.model), *sensor_errors_of(self.model), *thrust_losses_of(self.model)):
            direction = self.relative(residual) if residual.relative else self.state(residual.state)
            touched = np.flatnonzero(direction.any(axis=0))
            direction = direction[:, touched]
            for names, feature in table.items():
                if residual.of and (len(names) > 1 or names[0] not in residual.of):
                    continue
                curve, kind = ForceCurve(residual.name, *names), EffectKind.NONPARAMETRIC
                delta = direction[:, :, None] * feature[:, None, :]
                yield SensitivityColumns(curve_name(kind, curve), delta, kind=kind, curve=curve, touched=touched)
        for effect in input_response_effects(self.model):
            assert effect.curve is not None
            for columns in self.effect(effect):
                yield replace(columns, name=curve_name(effect.kind, effect.curve))


def _each_moved(values: Array, n: int, sizes: Sequence[tuple[int, Parameter]]) -> list[Array]:
    """Return the values of the parameters of a model with an effect, then these values with each size parameter moved.

    Each copy has one size parameter increased by its step. The index of a size parameter counts the parameters of the
    effect, which follow ``n`` parameters of the model.
    """
    moved = [values]
    for j, p in sizes:
        moved.append(values.copy())
        moved[-1][n + j] += p.step
    return moved


def _act_through_states(rowwise: VectorisedModel, value_set: Sequence[Array], m: int) -> list[bool]:
    """Return for each set of parameter values whether it acts through the last m states of a model, to first order.

    A set does if it changes the rates of these states, compared with the first set, and if these states act on other
    rates or on outputs with the first set. The result of the first set itself is True. A test at two states and one
    input, which are different numbers without meaning, decides.
    """
    n = len(rowwise.model.states)
    x = np.tile(np.linspace(0.31, 0.57, n), (2, 1))
    x[1, -m:] += 0.1
    u = np.tile(np.linspace(0.43, 0.71, len(rowwise.model.inputs)), (2, 1))
    others = np.delete(rowwise(x, u, value_set[0]), np.s_[n - m : n], axis=1)
    if np.array_equal(others[0], others[1], equal_nan=True):
        return [True, *(False for _ in value_set[1:])]
    same_row = np.zeros(len(value_set), dtype=np.int64)
    rates = rowwise.rates(x[same_row], u[same_row], np.stack(value_set))[:, n - m :]
    return [True, *(not np.array_equal(rate, rates[0], equal_nan=True) for rate in rates[1:])]


def _initial_states(larger: Model, effect: Effect, values: Array) -> Array:
    """Return the initial means (m,) of the states of an effect, which is part of the model ``larger``.

    ``values`` are the values of its parameters. A mean may be the value of a parameter.
    """
    named = dict(zip(larger.values, values.tolist(), strict=True))
    return np.array([named[s.x0] if isinstance(s.x0, str) else s.x0 for s in effect.states], dtype=np.float64)


def _constant_coefficients(rowwise: VectorisedModel, x: Array, u: Array, values: Array, m: int) -> Array | None:
    """Return the matrix (m, m) of the last m states of a model if their equations are linear and do not change in time.

    The result is None otherwise. The test compares the changes of their rates by steps of one in each of these states,
    at the first, middle and last rows of states x (n_rows, n_states) and inputs u, from the last states as they are and
    from these plus one. Other rows are not compared. ``rowwise`` is the model, and ``values`` are its parameter values.
    """
    rows = [0, len(x) // 2, len(x) - 1]
    n = x.shape[1]
    start = np.concatenate([x[rows], x[rows]])
    start[3:, -m:] += 1.0
    moved = np.tile(start, (m + 1, 1, 1))  # the points themselves, then each state increased by one
    moved[np.arange(1, m + 1), :, np.arange(n - m, n)] += 1.0
    inputs = np.tile(u[rows], (2 * (m + 1), 1))
    rates = rowwise.rates(moved.reshape(-1, n), inputs, values)
    by_state = rates[:, n - m :].reshape(m + 1, len(start), m)
    slopes = (by_state[1:] - by_state[0]).transpose(1, 2, 0)
    return slopes[0] if np.allclose(slopes, slopes[0], rtol=1e-6, atol=1e-9) else None


def _discretised_dynamics(A: Array, steps: Array) -> tuple[Array, Array]:
    """Discretise z' = A z + drive for each step length; the drive is constant over a step.

    The result gives z after a step: transition z + weight drive. The matrix exponentials of all steps are computed at
    once by scaling and squaring.

    Parameters
    ----------
    A : Array (m, m)
        Matrix of the rates [1/s].
    steps : Array (n_steps,)
        Step lengths [s].

    Returns
    -------
    transition : Array (n_steps, m, m)
        Transition matrices.
    weight : Array (n_steps, m, m)
        Matrices that multiply the constant drive.
    """
    # On a bench each of some thousand steps has its own length, and scipy's expm is slower by a loop over them.
    m = len(A)
    rates = np.zeros((2 * m, 2 * m))
    rates[:m] = np.column_stack([A, np.eye(m)])
    halvings = max(0, int(np.frexp(np.linalg.norm(rates, 1) * steps.max())[1]) + 1)
    x = rates * (steps / 2.0**halvings)[:, None, None]
    blocks = np.broadcast_to(np.eye(2 * m), x.shape)
    for k in range(TERMS, 0, -1):
        blocks = np.eye(2 * m) + x @ blocks / k
    for _ in range(halvings):
        blocks = blocks @ blocks
    return blocks[:, :m, :m], blocks[:, :m, m:]


def _solved_recursion(transition: Array, drive: Array, begin: Array) -> Array:
    """Solve ``z_k+1 = transition_k z_k + drive_k`` from ``begin`` (m,); return z (n + 1, m), with ``begin`` first.

    ``transition`` is (n, m, m) and ``drive`` is (n, m). The recursion is solved as a banded system with ones on its
    diagonal.
    """
    from scipy.linalg import solve_banded  # imported here, as it takes 0.3 s

    n, m = drive.shape
    band = np.zeros((2 * m, (n + 1) * m))
    band[0] = 1.0
    for i in range(m):
        for j in range(m):
            band[m + i - j, j : n * m : m] = -transition[:, i, j]
    right = np.concatenate([begin, drive.ravel()])
    return np.asarray(solve_banded((2 * m - 1, 0), band, right)).reshape(n + 1, m)


def variables(model: Model, record: Record, x: Array, values: Array | None = None) -> dict[str, Array]:
    """Return the variables that a residual may depend on, by name, each Array (n_rows,).

    Angles are wrapped to -pi to pi.

    Parameters
    ----------
    model, record
        Model, and record with its inputs.
    x : Array (n_rows, n_states)
        States.
    values : Array (n_parameters,)
        Parameter values, by default those of the model.
    """
    p = list(model.values.values()) if values is None else values.tolist()
    bag = model.bag(list(x.T), list(record.u.T), p)
    found = {}
    for v in variables_of(model):
        z = record.t if v.name == TIME_INPUT else np.asarray(v.read(bag), dtype=np.float64)
        found[v.name] = wrap(z, v.angle)
    return found


def generic_features(
    model: Model,
    record: Record,
    x: Array,
    among: Mapping[str, SplineBasis] | None = None,
    values: Array | None = None,
) -> dict[tuple[str, ...], Array]:
    """Return the regressors of the nonparametric candidates, by the names of their variables.

    The regressors are splines of single variables, harmonics of an angle, and products of two variables.

    Parameters
    ----------
    model, record
        Model, and record with its inputs.
    x : Array (n_rows, n_states)
        States.
    among
        Spline bases by the name of their variable, by default those of this record. Give the bases of all records
        together, so that a column has the same meaning in each record.
    values : Array (n_parameters,)
        Parameter values, by default those of the model.

    Returns
    -------
    dict
        Array (n_rows, n_features) by a tuple of one or two variable names. A variable other than an angle
        has no entry of its own if the middle 99 % of the samples of its basis differ by less than 1e-6.
    """
    z = variables(model, record, x, values)
    available = variables_of(model)
    among = spline_bases(model, z) if among is None else among
    table: dict[tuple[str, ...], Array] = {
        (v.name,): feature for v in available if not v.angle and (feature := among[v.name](z[v.name])).size
    }
    for v in available:
        if v.angle:
            table[(v.name,)] = np.column_stack(harmonics(z[v.name]))
    for first, second in products_of(model):
        za, zb = z[first], z[second]
        table[(first, second)] = np.column_stack([za * zb, np.abs(za) * zb, za * np.abs(zb)])
    return table


@dataclass(frozen=True)
class SplineBasis:
    """Cubic B-splines over an interval, less their means over some samples. The first function is left out.

    All functions together sum to one, so the first would add nothing to a constant.

    Attributes
    ----------
    low, high
        Ends of the interval, in the unit of the variable. Values outside are moved to the ends.
    knots
        Knots, scaled to 0 to 1, each end four times.
    mean : Array (n_functions - 1,)
        Mean of the functions over the samples of the basis, empty if the middle 99 % of them differ by less than 1e-6.
    """

    low: float
    high: float
    knots: Array
    mean: Array

    def __call__(self, z: Array) -> Array:
        """Return the functions less their means at z (n,), Array (n, n_functions - 1).

        Values of z outside the interval of the basis are moved to its ends. The result has no columns if the middle
        99 % of the samples of the basis differ by less than 1e-6.
        """
        if not self.mean.size:
            return np.zeros((z.size, 0))
        return np.asarray(self._raw(z).toarray() - self.mean)

    def _raw(self, z: Array) -> Any:
        """Return the B-splines at z (n,), without the first, before their means are subtracted.

        The result is a sparse matrix (n, n_functions - 1). Values of z outside the interval are moved to its ends.
        """
        within = np.clip((z - self.low) / (self.high - self.low), 0, 1 - 1e-9)
        from scipy.interpolate import BSpline  # imported here, as it takes half a second

        return BSpline.design_matrix(within, self.knots, 3)[:, 1:]


def spline_basis(among: Array, n_functions: int) -> SplineBasis:
    """Return the spline basis over the middle 99 % of samples, less its mean over all of them.

    Parameters
    ----------
    among : Array (n,)
        Samples of the variable. If the middle 99 % differ by less than 1e-6, the basis has no functions.
    n_functions
        Number of B-splines, including the first, which is left out.
    """
    low, high = np.percentile(among, [0.5, 99.5])
    knots = np.concatenate([[0] * 3, np.linspace(0, 1, n_functions - 2), [1] * 3])
    basis = SplineBasis(float(low), float(high), knots, np.zeros(0))
    if high - low < 1e-6:
        return basis
    return replace(basis, mean=np.asarray(basis._raw(among).mean(axis=0)).ravel())


def spline_bases(model: Model, among: Mapping[str, Array]) -> dict[str, SplineBasis]:
    """Return the spline basis of each variable of a model except angles, by name of the variable.

    ``among`` contains the samples (n,) of each variable. The interval of a basis is their middle 99 %, and its
    functions are less their means over all samples. A basis has no functions if its interval is shorter than 1e-6.
    """
    return {v.name: spline_basis(among[v.name], v.functions) for v in variables_of(model) if not v.angle}


def splines(z: Array, n_functions: int, among: Array | None = None) -> Array:
    """Return the values (n, n_functions - 1) of the functions of a `SplineBasis` at z (n,).

    The samples ``among`` (m,) determine its interval and mean; None: z itself. There are no columns if the middle 99 %
    of the samples differ by less than 1e-6.
    """
    return spline_basis(z if among is None else among, n_functions)(z)


def all_columns(
    path: TrajectoryLinearisation, effects: Iterable[Effect], among: Mapping[str, SplineBasis] | None = None
) -> Iterator[SensitivityColumns]:
    """Yield the sensitivities of every candidate along one record; the parametric candidates come first.

    The order is the same for records with the same inputs. Effects are skipped if the model does not accept them or if
    the record lacks one of their inputs.

    Parameters
    ----------
    path
        Linearisation of the model along the record.
    effects
        Parametric candidates. The nonparametric ones follow from the model.
    among
        Spline bases by the name of their variable, by default the bases of this record.
    """
    chosen = [e for e in effects if path.model.accepts(e) and _has_inputs(path, e)]
    for e in chosen:
        yield from path.effect(e)
    yield from path.generic(among)


def _has_inputs(path: TrajectoryLinearisation, effect: Effect) -> bool:
    """Return whether the record along which a model is linearised has all inputs of an effect."""
    return all(i.name in path.record.inputs for i in effect.inputs)


def normal_equations(
    fitted: FittedModel, records: Sequence[Record], candidates: Sequence[Effect], free_parameters: Sequence[Parameter]
) -> tuple[NormalEquations, list[ColumnIndex]]:
    """Return the normal equations of the fitted parameters and of every candidate, summed over all records.

    Parameters
    ----------
    fitted
        The fitted model.
    records
        Estimation data with the inputs of all candidates; at least one record.
    candidates
        Parametric candidates. The nonparametric ones follow from the model and are added.
    free_parameters
        Fitted parameters, which get the first columns.

    Returns
    -------
    normal
        The normal equations.
    column_indices
        The indices of the columns of each candidate.

    Notes
    -----
    Parts of a long record are processed one after the other, each of whole blocks of time. The memory therefore does
    not grow with the length of the record.
    """
    model = fitted.model
    paths = [
        TrajectoryLinearisation(model, v.values, r, v.run.x_pred)
        for r, v in zip(records, fitted.estimation, strict=True)
    ]
    for path in paths[1:]:
        path.share_models(paths[0])
    by_record = [variables(model, p.own, p.x, p.values) for p in paths]
    among = spline_bases(model, {name: np.concatenate([v[name] for v in by_record]) for name in by_record[0]})
    normal: NormalEquations | None = None
    column_indices: list[ColumnIndex] = []
    for i, (path, view) in enumerate(zip(paths, fitted.estimation, strict=True)):
        indices, carried = [j for j, p in enumerate(free_parameters) if p.segment in (None, i)], list[Array]()
        for rows in whole_blocks(path.own.t, model.block):
            part = path.part(slice(rows.start, rows.stop + 1))  # and the row at which the last interval ends
            along = np.stack([part.parameter(free_parameters[j].name) for j in indices], axis=2)
            columns = all_columns(part, candidates, among)
            carrier = SensitivityFilter(view.run, path.own, part.jacobian, rows)
            g, slim = propagate_sensitivities(carrier, along, columns, carried)
            if normal is None:
                column_indices, total = assign_columns(slim, len(free_parameters), len(records))
                normal = NormalEquations([str(k) for k in range(total)])
            at = indices + [k for where in column_indices for k in where.of_record(i)]
            normal.add(at, g, carrier.e, block_index(carrier.t, model.block))
    assert normal is not None
    return normal, column_indices


def wave_peak_score(fitted: FittedModel, policy: SearchPolicy = DEFAULT_POLICY) -> Score | None:
    """Return the score of the candidate ``waves`` (wave forces) from the spectrum of the innovations of a fitted model.

    The peak with the smallest p value in the band of waves counts, and its p value is multiplied by the number of all
    peaks (Bonferroni). ``lm`` of the score is the chi-squared quantile of that p value. ``step`` and ``scan`` are the
    initial values of the refit. The p value of the peak is also the block-robust p value: the peak is an average over
    segments of time, and the comparison with neighbouring bins makes it valid for coloured innovations.

    Parameters
    ----------
    fitted
        The fitted model, with its evaluation of the estimation data.
    policy
        Thresholds: largest p value and longest sample interval.

    Returns
    -------
    Score or None
        None if no peak in the band of waves is significant (``policy.max_peak_p``), or if no channel can be searched.
    """
    runs = [view.run for view in fitted.estimation]
    best = wave_peak(fitted.model, runs, policy.max_peak_p, policy.max_wave_sample_interval)
    if best is None:
        return None
    df = len(WAVES.parameters)
    lm = float(chi2_isf(max(best.p, SMALLEST_P), df))
    return Score(WAVES.name, lm, df, lm, wave_sizes(fitted.model), {"f_wave": best.frequency})
