"""Candidates of the score test: parametric effects linearised at zero, and nonparametric (spline) alternatives.

Waves are tested by a narrow peak in the spectrum of the innovations, since their score at zero vanishes.
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
from scipy import stats
from scipy.interpolate import BSpline
from scipy.linalg import solve_banded

from seatrial.ident.data import TIME_INPUT, Record
from seatrial.ident.diagnosis.score_test import (
    ColumnIndex,
    NormalEquations,
    Score,
    SensitivityColumns,
    SensitivityFilter,
    block_index,
    place,
    propagate_sensitivities,
    whole_blocks,
)
from seatrial.ident.effects import EFFECT, FORCES, harmonics, input_response_effects
from seatrial.ident.engine import VectorisedModel
from seatrial.ident.estimation import FittedModel, RecordEvaluation
from seatrial.ident.model import Effect, EffectKind, ForceCurve, Model, Parameter, Residual, curve_name
from seatrial.ident.models import products_of, readings_of, residuals_of, size_of, thrust_losses_of, variables_of
from seatrial.ident.numerics import Array, wrap
from seatrial.ident.validation import SpectralPeak, spectral_peak

MAX_PEAK_P = 1e-6  # p value that coloured innovations do not reach (tests/ident/diagnosis/test_spectral_peak.py)
MAX_SAMPLE_INTERVAL = 0.25  # s; a slower channel does not resolve waves
SMALLEST_P = 1e-300  # least p value with a finite chi-square quantile
TERMS = 14  # of the series of the exponential of a matrix whose norm is at most a half
INITIAL_WAVE_SIZE = 0.4  # of the usual wave forces, initial value of the refit


class TrajectoryLinearisation:
    """Linearisation of a model along the predicted trajectory of the filter on one record, by finite differences.

    ``record`` has the inputs of all candidates; x (n_rows, n_states) are the predicted states.
    """

    def __init__(self, model: Model, values: Array, record: Record, x: Array) -> None:
        self.model, self.values, self.record, self.x = model, values, record, x
        self.rowwise = VectorisedModel(model)
        self.own = record.for_model(model)
        self._larger: dict[tuple[str, ForceCurve | None], tuple[Model, VectorisedModel]] = {}
        self._ends: dict[tuple[str, ForceCurve | None], list[Array]] = {}  # states of effects at the last row

    def part(self, rows: slice) -> TrajectoryLinearisation:
        """Some rows of it; the first of each part is the last of the part before, from where states of effects go
        on."""
        part = copy(self)
        part.record, own = self.record.rows(rows), self.own.rows(rows)
        part.own, part.x = replace(own, u=np.asfortranarray(own.u)), np.asfortranarray(self.x[rows])
        for computed in ("base", "jacobian", "steps"):
            part.__dict__.pop(computed, None)
        return part

    @cached_property
    def base(self) -> Array:
        """Rates and outputs (n_rows, n_states + n_outputs)."""
        return self.rowwise(self.x, self.own.u, self.values)

    @cached_property
    def jacobian(self) -> Array:
        """Of the outputs by the state (n_rows, n_outputs, n_states)."""
        return self.rowwise.output_jacobian(self.x, self.own.u, self.values)

    @cached_property
    def steps(self) -> tuple[Array, NDArray[np.int64]]:
        """The different lengths of its intervals, s, and which of them each has."""
        lengths, which = np.unique(np.round(self.record.h[:-1], 9), return_inverse=True)
        return lengths, which

    def parameter(self, name: str) -> Array:
        """d(rates, outputs) / d parameter, (n_rows, n_states + n_outputs)."""
        index = [p.name for p in self.model.parameters].index(name)
        p = self.model.parameters[index]
        h = p.step or 0.01 * max(abs(self.values[index]), 1e-3)
        up, down = self.values.copy(), self.values.copy()
        up[index] += h / 2
        down[index] -= h / 2
        return (self.rowwise(self.x, self.own.u, up) - self.rowwise(self.x, self.own.u, down)) / h

    def state(self, name: str) -> Array:
        """d(rates, outputs) / d state; exact for the disturbance states, which enter linearly."""
        index = [s.name for s in self.model.states].index(name)
        moved = self.x.copy()
        moved[:, index] += 1.0
        change = self.rowwise(moved, self.own.u, self.values) - self.base
        change[:, index] = 0.0  # its own decay is not an effect on the boat
        return change

    def relative(self, residual: Residual) -> Array:
        """d(rates, outputs) / d relative change; exact, since it enters linearly."""
        name = f"change_of_{residual.name}"
        hooks = {residual.stage: lambda s: residual.add(s, getattr(s.p, name))}
        larger = self.model + Effect(name, residual.title, hooks, parameters=(Parameter(name, 0.0),))
        return VectorisedModel(larger)(self.x, self.own.u, np.append(self.values, 1.0)) - self.base

    def effect(self, effect: Effect) -> Iterator[SensitivityColumns]:
        """One candidate, or one for each combination of its scanned parameters."""
        key, n, m = (effect.name, effect.curve), len(self.model.states), len(effect.states)
        if key not in self._larger:
            self._larger[key] = self.model + effect, VectorisedModel(self.model + effect)
        larger, rowwise = self._larger[key]
        u = np.asfortranarray(self.record.for_model(larger).u)
        scans = [dict(zip(effect.scan, scan, strict=True)) for scan in product(*effect.scan.values())]
        all_values = [
            np.append(self.values, [tried.get(p.name, p.value) for p in effect.parameters]) for tried in scans
        ]
        driven = [np.zeros((len(self.x), 0))] * len(scans)
        if m:
            begin = self._ends.get(key, [np.zeros(m)] * len(scans))
            driven = self._driven(rowwise, begin, all_values, u)
            self._ends[key] = [z[-1].copy() for z in driven]
        for tried, values, z in zip(scans, all_values, driven, strict=True):
            x, changes, names = np.concatenate([self.x.T, z.T]).T, list[list[Array]](), []
            sizes = [
                (j, p) for j, p in enumerate(effect.parameters)  # the others are of its form
                if not (p.transform == "log" or p.name in tried or (j > 0 and p.value != 0.0))
            ]  # fmt: skip

            def without_own_states(values: Array, rowwise: VectorisedModel = rowwise, x: Array = x) -> list[Array]:
                columns = rowwise.columns(x, u, values)
                return columns[:n] + columns[n + m :]

            at_nothing = all(p.value == 0.0 for _, p in sizes)
            base = list(self.base.T) if at_nothing else without_own_states(values)
            for j, p in sizes:
                moved = values.copy()
                moved[len(self.values) + j] += p.step
                found = without_own_states(moved)
                changes.append([after - before for after, before in zip(found, base, strict=True)])
                names.append(p.name)
            own = all(p.per_record for p in effect.parameters)
            touched = np.flatnonzero([any(c.any() for c in column) for column in zip(*changes, strict=True)])
            delta = np.empty((len(x), touched.size, len(changes)))
            for k, (change, (_, p)) in enumerate(zip(changes, sizes, strict=True)):
                for i, j in enumerate(touched.tolist()):
                    np.divide(change[j], p.step, out=delta[:, i, k])
            yield SensitivityColumns(
                effect.name, delta, tuple(names), tried, effect.kind, effect.curve, effect.one_sided, own, touched
            )

    def _driven(self, rowwise: VectorisedModel, begin: list[Array], all_values: list[Array], u: Array) -> list[Array]:
        """States (n_rows, m) of an effect, driven along the trajectory while the effect is at zero (linear, constant
        coefficients), for each set of values, from those at the first row."""
        n, m = len(self.model.states), begin[0].size
        x = np.concatenate([self.x.T, np.zeros((m, len(self.x)))]).T
        steps, step_of = self.steps
        found = []
        for z, values in zip(begin, all_values, strict=True):
            drive = np.stack(rowwise.columns(x, u, values)[n : n + m], axis=1)
            A = rowwise.rate_jacobian(x[:1], u[:1], values)[0, n:, n:]
            transition, weight = (matrices[step_of] for matrices in _discrete(A, steps))
            mean = (drive[:-1] + drive[1:]) / 2
            found.append(_recursion(transition, np.einsum("kij,kj->ki", weight, mean), z))
        return found

    def generic(self, among: Mapping[str, SplineBasis] | None = None) -> Iterator[SensitivityColumns]:
        """Nonparametric candidates: each residual force as a smooth function of each variable, of products, and as
        lagged
        or resonant response to an input; each sensor error as a smooth function of some variables. ``among``: see
        splines."""
        table = generic_features(self.model, self.own, self.x, among, self.values)
        for residual in (*residuals_of(self.model), *readings_of(self.model), *thrust_losses_of(self.model)):
            direction = self.relative(residual) if residual.relative else self.state(residual.state)
            touched = np.flatnonzero(direction.any(axis=0))
            direction = direction[:, touched]
            for of, feature in table.items():
                if residual.of and (len(of) > 1 or of[0] not in residual.of):
                    continue
                curve, kind = ForceCurve(residual.name, *of), EffectKind.NONPARAMETRIC
                delta = direction[:, :, None] * feature[:, None, :]
                yield SensitivityColumns(curve_name(kind, curve), delta, kind=kind, curve=curve, touched=touched)
        for effect in input_response_effects(self.model):
            assert effect.curve is not None
            for columns in self.effect(effect):
                yield replace(columns, name=curve_name(effect.kind, effect.curve))


def _discrete(A: Array, steps: Array) -> tuple[Array, Array]:
    """Transition and weight of a constant drive (n_steps, m, m) of z' = A z + drive over each step: the exponential, by
    scaling and squaring of all at once. On a bench each of some thousand steps has its own length, and scipy's expm
    takes them one by one."""
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


def _recursion(transition: Array, drive: Array, begin: Array) -> Array:
    """``z_k+1 = transition_k z_k + drive_k`` from ``begin``, (n + 1, m): a banded system with ones on its diagonal."""
    n, m = drive.shape
    band = np.zeros((2 * m, (n + 1) * m))
    band[0] = 1.0
    for i in range(m):
        for j in range(m):
            band[m + i - j, j : n * m : m] = -transition[:, i, j]
    right = np.concatenate([begin, drive.ravel()])
    return np.asarray(solve_banded((2 * m - 1, 0), band, right)).reshape(n + 1, m)


def variables(model: Model, record: Record, x: Array, values: Array | None = None) -> dict[str, Array]:
    """Variables (n_rows,) that a residual may depend on; ``values``: of the parameters, by default those of the
    model."""
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
    """Regressors by variables: splines of single variables, harmonics of an angle, products of two of them.

    ``among``: bases of the variables of all records together, so that a column has the same meaning in each of them.
    """
    z = variables(model, record, x, values)
    known = variables_of(model)
    among = spline_bases(model, z) if among is None else among
    table: dict[tuple[str, ...], Array] = {
        (v.name,): feature for v in known if not v.angle and (feature := among[v.name](z[v.name])).size
    }
    for v in known:
        if v.angle:
            table[(v.name,)] = np.column_stack(harmonics(z[v.name]))
    for one, other in products_of(model):
        za, zb = z[one], z[other]
        table[(one, other)] = np.column_stack([za * zb, np.abs(za) * zb, za * np.abs(zb)])
    return table


@dataclass(frozen=True)
class SplineBasis:
    """Cubic B-splines over ``low`` to ``high``, each less its ``mean`` (n_functions - 1,) among the samples they were
    made for; without functions where those were constant."""

    low: float
    high: float
    knots: Array
    mean: Array

    def __call__(self, z: Array) -> Array:
        """At z (n,): (n, n_functions - 1)."""
        if not self.mean.size:
            return np.zeros((z.size, 0))
        return np.asarray(self._raw(z).toarray() - self.mean)

    def _raw(self, z: Array) -> Any:
        within = np.clip((z - self.low) / (self.high - self.low), 0, 1 - 1e-9)
        return BSpline.design_matrix(within, self.knots, 3)[:, 1:]


def spline_basis(among: Array, n_functions: int) -> SplineBasis:
    """Over the middle 99 % of the samples ``among`` (n,), centred there."""
    low, high = np.percentile(among, [0.5, 99.5])
    knots = np.concatenate([[0] * 3, np.linspace(0, 1, n_functions - 2), [1] * 3])
    basis = SplineBasis(float(low), float(high), knots, np.zeros(0))
    if high - low < 1e-6:
        return basis
    return replace(basis, mean=np.asarray(basis._raw(among).mean(axis=0)).ravel())


def spline_bases(model: Model, among: Mapping[str, Array]) -> dict[str, SplineBasis]:
    """Of all variables that are no angles."""
    return {v.name: spline_basis(among[v.name], v.functions) for v in variables_of(model) if not v.angle}


def splines(z: Array, n_functions: int, among: Array | None = None) -> Array:
    """``spline_basis`` of ``among`` (z itself by default), at z."""
    return spline_basis(z if among is None else among, n_functions)(z)


def all_columns(
    path: TrajectoryLinearisation, effects: Iterable[Effect], among: Mapping[str, SplineBasis] | None = None
) -> Iterator[SensitivityColumns]:
    """Every candidate along one record, in the same order along each; ``among``: see generic_features."""
    chosen = [e for e in effects if path.model.accepts(e) and _has_inputs(path, e)]
    for e in chosen:
        yield from path.effect(e)
    yield from path.generic(among)


def _has_inputs(path: TrajectoryLinearisation, effect: Effect) -> bool:
    return all(i.name in path.record.inputs for i in effect.inputs)


def normal_equations(
    stage: FittedModel, records: Sequence[Record], candidates: Sequence[Effect], fitted: Sequence[Parameter]
) -> tuple[NormalEquations, list[ColumnIndex]]:
    """Those of the fitted parameters and of every candidate, over all records, and where each candidate stands in them.
    Whole blocks of a long record are done one after the other, so that the memory does not grow with it."""
    model = stage.model
    paths = [
        TrajectoryLinearisation(model, v.values, r, v.run.x_pred)
        for r, v in zip(records, stage.estimation, strict=True)
    ]
    seen = [variables(model, p.own, p.x, p.values) for p in paths]
    among = spline_bases(model, {name: np.concatenate([v[name] for v in seen]) for name in seen[0]})
    normal: NormalEquations | None = None
    places: list[ColumnIndex] = []
    for i, (path, view) in enumerate(zip(paths, stage.estimation, strict=True)):
        own, begun = [j for j, p in enumerate(fitted) if p.segment in (None, i)], list[Array]()
        for rows in whole_blocks(path.own.t, model.block):
            part = path.part(slice(rows.start, rows.stop + 1))  # and the row at which the last interval ends
            along = np.stack([part.parameter(fitted[j].name) for j in own], axis=2)
            columns = all_columns(part, candidates, among)
            carrier = SensitivityFilter(view.run, path.own, part.jacobian, rows)
            g, slim = propagate_sensitivities(carrier, along, columns, begun)
            if normal is None:
                places, total = place(slim, len(fitted), len(records))
                normal = NormalEquations([str(k) for k in range(total)])
            at = own + [k for where in places for k in where.of_record(i)]
            normal.add(at, g, carrier.e, block_index(carrier.t, model.block))
    assert normal is not None
    return normal, places


def wave_peak_score(stage: FittedModel) -> Score | None:
    """Score of the candidate ``waves`` for a fitted model; None where no spectral peak is significant.

    ``step`` and ``scan`` are the initial values of the refit. The p value of the peak is used as the block-robust p
    value as well: it is of averages over blocks, and neighbouring bins keep it valid for coloured innovations.
    """
    peaks = [peak for view in stage.estimation for peak in _peak(stage.model, view)]
    low, high = next(p.bounds for p in EFFECT.parameters if p.name == "f_wave")
    # a peak beyond the waves' band, as resampled channels have at 5 Hz, is no wave
    best = min((peak for peak in peaks if low <= peak.frequency <= high), key=lambda peak: peak.p, default=None)
    if best is None or best.p * len(peaks) > MAX_PEAK_P:
        return None
    df = len(EFFECT.parameters)
    lm = float(stats.chi2.isf(max(best.p * len(peaks), SMALLEST_P), df))
    size = size_of(stage.model)
    step = {f"A_{force}": INITIAL_WAVE_SIZE * usual * size.of(unit) for force, (unit, usual) in FORCES.items()}
    return Score(EFFECT.name, lm, df, lm, step, {"f_wave": best.frequency})


def _peak(model: Model, view: RecordEvaluation) -> list[SpectralPeak]:
    """Spectral peaks of rates and accelerations, at most one for each sample interval."""
    by_step: dict[float, dict[str, Array]] = {}
    for j, output in enumerate(model.outputs):
        there = np.isfinite(view.run.standardised[:, j])
        if "/s" in output.unit and there.sum() > 2:
            t = view.record.t[there]
            step = round(float(np.median(np.diff(t))), 4)
            if 0.0 < step <= MAX_SAMPLE_INTERVAL:
                by_step.setdefault(step, {})[output.name] = _even(t, view.run.standardised[there, j], step)
    peaks = [spectral_peak(channels, step) for step, channels in by_step.items()]
    return [peak for peak in peaks if peak is not None]


def _even(t: Array, e: Array, step: float) -> Array:
    """The samples on a regular grid, NaN where one is missing."""
    at = np.round((t - t[0]) / step).astype(int)
    grid = np.full(at[-1] + 1, np.nan)
    grid[at] = e
    return grid
