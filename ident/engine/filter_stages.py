"""Stages of the extended Kalman filter and of its forward sensitivities, matrix by matrix.

A stage of scalar expressions computes what depends on the model. Routines that are compiled once for all models do the
work on the covariance P and on its derivatives. Joseph's form of the update has other equations.

The update by one scalar measurement with the predicted value z, its derivatives H by the states, and the variance R is

    PH = P H',   S = H PH + R,   dx += PH slope(e, S),   P -= q(e, S) PH PH'.

The covariance after the prediction is ``Phi (P + Q) Phi' + T Q T' + Q``. It is computed as Phi times the transpose of
``Phi (P + Q)``. The second-order filter then adds products of second derivatives of the rates and of the covariance,
before and after the prediction, to the mean.

The sensitivities are the derivatives of the filter state by chosen parameters, one in each lane. Those of the mean are
the vector dm, those of the covariance P the matrix dP. Those of the update are

    dPH = P dH' + dP H',   dS = H dPH + dH PH + dR,   ddx += dPH slope + PH dslope,   dP += a PH' + PH a',

with ``a = -(q dPH + dq PH / 2)``. The sensitivity of the covariance after the prediction is the sum of a matrix and of
its transpose, plus dQ. The matrix is

    (dPhi (P + Q) + Phi (dP + dQ) / 2) Phi' + (dT Q + T dQ / 2) T'.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from seatrial.ident.engine import jit
from seatrial.ident.engine.array_layout import COVARIANCE, DERIVATIVE_OF_COVARIANCE, DERIVATIVE_OF_MEAN, MEAN
from seatrial.ident.engine.ekf_graph import EkfGraphs, Sample, ScalarUpdate, pack
from seatrial.ident.engine.loop_plan import (
    AddEntriesStage,
    AddOuterProductStage,
    AddProductsStage,
    AddTransposedStage,
    CombinationStage,
    GramStage,
    SingleCopyStage,
    Stage,
    Terms,
    TransposeStage,
    stage,
)
from seatrial.ident.model import outlier_density


class _Entries:
    """Array whose entries are collected one after the other: their symbols for later stages, and their expressions.

    Attributes
    ----------
    name : str
        Name of the array.
    """

    def __init__(self, name: str) -> None:
        """Create an empty array with this name."""
        self.name = name
        self._symbols: list[Any] = []
        self._values: list[Any] = []

    def __len__(self) -> int:
        """Return the number of entries so far."""
        return len(self._values)

    @property
    def symbols(self) -> Any:
        """Symbols of all entries, as a column."""
        return ca.vertcat(ca.SX(0, 1), *self._symbols)

    @property
    def values(self) -> Any:
        """Expressions of all entries, as a column."""
        return ca.vertcat(ca.SX(0, 1), *self._values)

    def append(self, value: Any) -> int:
        """Append an entry, and return its index."""
        self._symbols.append(ca.SX.sym(f"{self.name}_{len(self)}"))
        self._values.append(value)
        return len(self) - 1


class _Scalars(_Entries):
    """Array of the numbers of a row that later stages read. All lanes share them, so that they are computed once."""

    def add(self, value: Any) -> Any:
        """Append the nonzero entries of a matrix, and return the matrix with symbols in place of these entries.

        Constant entries are appended, too, so that the entries of the matrix follow each other in the array, but they
        remain constants in the result.
        """
        value = ca.SX(value)
        shown = [e if e.is_constant() else self._symbols[i] for e in value.nonzeros() for i in (self.append(e),)]
        return ca.SX(value.sparsity(), ca.vertcat(ca.SX(0, 1), *shown))

    def add_dense(self, vector: Any) -> tuple[Any, int]:
        """Append all entries of a vector, also those that are zero; return its symbols, and the index of the first."""
        first = len(self)
        return self.add(ca.densify(vector)), first

    def add_known(self, symbols: Sequence[Any], values: Sequence[Any]) -> None:
        """Append values of which an expression contains the symbols already."""
        for symbol, value in zip(symbols, values, strict=True):
            self._symbols += symbol.nonzeros()
            self._values += ca.SX(value).nonzeros()


class _Lanes(_Entries):
    """Array in lanes of derivatives, of which those that are zero are left out."""

    def add(self, value: Any) -> tuple[Any, int | None]:
        """Append a derivative; return its symbol and its index. They are zero and None if the derivative is zero."""
        if value.is_zero():
            return ca.SX(0), None
        index = self.append(value)
        return self._symbols[index], index


class FilterStages:
    """Stages of a plan that run a filter with a covariance in each row, and compute its derivatives if wanted.

    Attributes
    ----------
    graphs : EkfGraphs
        Expressions of the filter.
    derivatives : bool
        Whether the derivatives of the filter state and of the log-likelihood are computed.
    single : bool
        Whether the derivatives are in single precision. The array ``lost`` of `filter_plans.Plans.tangent` is then
        computed, too.
    stride : int
        Numbers in each row of the array of the covariance.
    dm : SX (n, 1)
        Symbols of the derivatives of the mean, in lanes.
    lanes, scalars : set[str]
        Names of the arrays in lanes, and of the arrays of numbers that stages in lanes read, so far.
    """

    def __init__(self, graphs: EkfGraphs, *, derivatives: bool = False, single: bool = False) -> None:
        """Prepare the stages; `update` and `prediction` return them. The options are those of the class."""
        self.graphs, self.derivatives, self.single = graphs, derivatives, single
        self.lanes: set[str] = {DERIVATIVE_OF_MEAN, DERIVATIVE_OF_COVARIANCE, "dp", "dll"} if derivatives else set()
        self.lanes |= {"lost"} if single else set()
        self.scalars: set[str] = set()
        n = graphs.n
        self.stride = -(-n // jit.WIDTH) * jit.WIDTH
        self._P = ca.SX.sym(COVARIANCE, n * self.stride)
        self._curvatures = graphs.curvatures if graphs.model.second_order else ()
        self.dm, self._dp = ca.SX.sym(DERIVATIVE_OF_MEAN, n), ca.SX.sym("dp", graphs.p.numel())

    @property
    def inputs(self) -> dict[str, Any]:
        """Symbols of the data, the parameters and the mean, by name of the array."""
        return {MEAN: self.graphs.mean} | {name: v for name, v in self.graphs.inputs.items() if name != "s"}

    @property
    def covariance(self) -> Any:
        """Covariance (n, n) as symbols of its array. Each row of the array has further numbers at its end."""
        n = self.graphs.n
        return ca.horzcat(*[self._P[k * self.stride : k * self.stride + n] for k in range(n)])

    @property
    def state(self) -> Any:
        """The filter state as a column: the mean, and the upper triangle of the covariance."""
        return ca.vertcat(self.graphs.mean, pack(self.covariance))

    @property
    def state_inputs(self) -> dict[str, Any]:
        """Symbols of the filter state by name of the array."""
        return {MEAN: self.graphs.mean, COVARIANCE: self._P}

    def update(self, q: int, innovations: bool = False) -> list[Stage]:
        """Return the stages of the update by the sensor with the number q.

        ``innovations``: whether the innovations ``e<q>`` and their variances ``S<q>`` are results.
        """
        samples, derivatives = self.graphs.samples[q], None
        measured, w = _Scalars(f"measured{q}"), _Scalars(f"w{q}")
        known = [Sample(s.output, measured.add(s.e), measured.add(s.H), measured.add(s.R)) for s in samples]
        results = {measured.name: measured.values}
        if self.derivatives:
            derivatives = _UpdateDerivatives(self, q, w)
            results[w.name] = w.values
        stages: list[Stage] = [stage(self.inputs, results, q)]
        if derivatives is not None:
            stages.append(derivatives.of_measurement)
        n, last, first = self.graphs.n, len(samples) - 1, 1
        PH, dx, seen = ca.SX.sym("PH", self.stride), ca.SX.sym("dx", n), ca.SX.sym("seen", 2 * last)
        at_PH, at_dx, at_gain, at_seen = f"PH{q}", f"dx{q}", f"gain{q}", f"seen{q}"
        for i, s in enumerate(known):
            terms = tuple((first + k, column) for k, (_, column, _) in enumerate(_entries(s.H)))
            first += len(terms) + 2  # e, the entries of H, and R
            c = self.graphs.innovation(s, dx if i else ca.SX.zeros(n), PH[:n])
            change = PH[:n] * c.slope + (dx if i else 0)
            inputs = {measured.name: measured.symbols, at_PH: PH} | ({at_dx: dx} if i else {})
            results = {"ll": c.ll, at_gain: -c.inverse_variance * PH[:n]}
            if i < last:
                results[at_dx] = change
            else:
                inputs[MEAN] = self.graphs.mean
                results[MEAN] = self.graphs.mean + change
            if innovations:
                inputs |= {at_seen: seen} if i else {}
                so_far = ca.vertcat(seen[: 2 * i], c.e, c.S)
                if i < last:
                    results[at_seen] = ca.vertcat(so_far, ca.SX.zeros(2 * (last - i - 1)))
                else:
                    results |= {f"e{q}": so_far[::2], f"S{q}": so_far[1::2]}
            before, after = list[Stage](), list[Stage]()
            if derivatives is not None:
                values, before, after = derivatives.of_scalar(i, c, PH[:n], dx)
                results |= values
            stages += [
                CombinationStage("", "", measured.name, COVARIANCE, at_PH, self.stride, ((),), (terms,), bit=q),
                stage(inputs, results, q),
                *before,
                AddOuterProductStage(at_gain, at_PH, COVARIANCE, n, self.stride, q),
                *after,
            ]
        return stages

    def prediction(self, results: dict[str, Any] | None = None) -> list[Stage]:
        """Return the stages of the prediction to the next row.

        ``results``: expressions of further results at its start, by name of the array.
        """
        g, n, t, stride = self.graphs, self.graphs.n, self.graphs.transition, self.stride
        steps, w = _Scalars("steps"), _Scalars("w")
        Phi: list[list[tuple[int, int]]] = [[] for _ in range(n)]
        for position, (i, k, _) in enumerate(_entries(steps.add(t.Phi))):
            Phi[i].append((position, k))
        noise = ca.sparsify(t.T @ t.Q @ t.T.T + t.Q)
        before = [(steps.append(t.Q[k, k]), k * (stride + 1)) for k in range(n) if not t.Q[k, k].is_zero()]
        after = [(steps.append(value), i * stride + j) for i, j, value in _entries(noise) if i <= j]
        curvatures = _Scalars("curvatures") if self._curvatures else None
        factors = [] if curvatures is None else [curvatures.add(g.h / 2 * value) for *_, value in self._curvatures]
        derivatives, last = self._prediction_derivatives(w) if self.derivatives else ([], [])
        values = {MEAN: g.mean_step[0], steps.name: steps.values} | ({w.name: w.values} if self.derivatives else {})
        if curvatures is not None:
            known = [curvatures.add(self.covariance[j, k]) for _, j, k, _ in self._curvatures]
            values[curvatures.name] = curvatures.values
            last = [self._curvature_stage(curvatures, factors, known), *last]
        inputs = self.inputs | ({COVARIANCE: self._P} if results or curvatures is not None else {})
        first, second = (
            CombinationStage("", "", steps.name, matrix, result, stride, ((),) * n, _frozen(Phi))
            for matrix, result in ((COVARIANCE, "half"), ("turned", COVARIANCE))
        )
        return [
            stage(inputs, values | (results or {})),
            AddEntriesStage(steps.name, COVARIANCE, tuple(before)),  # P is P + Q from here on
            *derivatives,
            first,
            TransposeStage("half", "turned", n, stride),
            second,
            AddEntriesStage(steps.name, COVARIANCE, tuple(after)),
            # Rounding would make both triangles differ, by more and more for an unstable boat.
            TransposeStage(COVARIANCE, COVARIANCE, n, stride),
            *last,
        ]

    def _curvature_stage(self, curvatures: _Scalars, factors: Sequence[Any], before: Sequence[Any]) -> Stage:
        """Return the stage of a second-order filter that changes the mean after the prediction of the covariance.

        Parameters
        ----------
        curvatures
            Array of `factors` and `before`.
        factors, before : Sequence[SX]
            Half of the interval times each of `EkfGraphs.curvatures`, and the element of the covariance before the
            prediction that belongs to it.
        """
        mean, sums = self.graphs.mean, []
        change = ca.SX.zeros(self.graphs.n)
        for (i, j, k, _), factor, P in zip(self._curvatures, factors, before, strict=True):
            sums.append(P + self.covariance[j, k])
            change[i] += factor * sums[-1]
        results = {MEAN: mean + change} | ({"sums": ca.vertcat(ca.SX(0, 1), *sums)} if self.derivatives else {})
        self.scalars |= {"sums"} if self.derivatives else set()
        return stage({MEAN: mean, COVARIANCE: self._P, curvatures.name: curvatures.symbols}, results)

    def _prediction_derivatives(self, w: _Scalars) -> tuple[list[Stage], list[Stage]]:
        """Return the stages of the derivatives of the prediction, and those of a second-order filter after it.

        The numbers that they read are appended to ``w``.
        """
        g, n, t, lanes = self.graphs, self.graphs.n, self.graphs.transition, _Lanes("l")
        noisy = [k for k in range(n) if not t.Q[k, k].is_zero()]
        Q = ca.vertcat(ca.SX(0, 1), *[t.Q[k, k] for k in noisy])
        factors = ca.vertcat(ca.SX(0, 1), *[g.h / 2 * value for *_, value in self._curvatures])
        moved = self.derivative(ca.vertcat(g.mean_step[0], *t.A.nonzeros(), Q, factors), w)
        ends = np.cumsum([n, t.A.nnz(), len(noisy)]).tolist()
        dm, dA, dQ, dfactors = (moved[a:b] for a, b in zip([0, *ends], [*ends, moved.numel()], strict=True))
        dA = ca.sparsify(ca.SX(t.A.sparsity(), dA))
        A, A2 = w.add(t.A), w.add(ca.sparsify(t.A @ t.A))
        dA2 = dA @ A + A @ dA
        dT = 2 * dA + dA2
        dPhi = ca.sparsify(dT + dA2 + 4 / 3 * (dA @ A2 + A @ dA2))
        # terms of each row of the result, as in `CombinationStage`
        of_Phi, of_T, halves, wholes = ([list[tuple[int, int]]() for _ in range(n)] for _ in range(4))
        for i, k, value in _entries(dPhi):
            if (index := lanes.add(value)[1]) is not None:
                of_Phi[i].append((index, k * self.stride))
        diagonal: list[tuple[int, int]] = []
        for j, k in enumerate(noisy):
            column, first = w.add_dense(t.T[:, k])
            variance = w.add(Q[j])
            if (index := lanes.add(dQ[j])[1]) is not None:
                diagonal.append((index, k * n + k))
            for i in range(n):
                index = lanes.add(dT[i, k] * variance + column[i] * (dQ[j] / 2))[1]
                if index is not None:
                    of_T[i].append((index, first))
        for terms, matrix in ((halves, t.Phi / 2), (wholes, t.Phi)):
            first = len(w)
            for position, (i, k, _) in enumerate(_entries(w.add(matrix))):
                terms[i].append((first + position, k))
        dP, (rows, copied) = DERIVATIVE_OF_COVARIANCE, self.covariance_of_lanes(None)
        first_stages, last = self._curvature_derivatives(w, lanes, factors, dfactors)
        self.lanes |= {lanes.name, "dhalf", "dproduct"}
        self.scalars.add(w.name)
        noise = [AddEntriesStage(lanes.name, dP, tuple(diagonal))] if diagonal else []
        stages: list[Stage] = [
            *first_stages,
            self.stage_in_lanes(w, {DERIVATIVE_OF_MEAN: dm, lanes.name: lanes.values}, None),
            *noise,
            *copied,
            CombinationStage(
                lanes.name, rows, w.name, dP, "dhalf", n, _frozen(of_Phi), _frozen(halves), transposed=True
            ),
            CombinationStage(lanes.name, w.name, w.name, "dhalf", "dproduct", n, _frozen(of_T), _frozen(wholes)),
            AddTransposedStage("dproduct", dP, n),
            *noise,
        ]
        return stages, last

    def _curvature_derivatives(
        self, w: _Scalars, lanes: _Lanes, factors: Any, dfactors: Any
    ) -> tuple[list[Stage], list[Stage]]:
        """Return the stages in lanes of a second-order filter before and after the prediction of the covariance.

        The first one keeps elements of the derivative of the covariance, the last one changes that of the mean.

        Parameters
        ----------
        w, lanes
            Arrays of the prediction, to which the factors of the curvatures and their derivatives are appended.
        factors, dfactors : SX (n_curvatures, 1)
            Half of the interval times each of `EkfGraphs.curvatures`, and the derivatives.
        """
        n, indices = self.graphs.n, [(i, j, k) for i, j, k, _ in self._curvatures]
        if not indices:
            return [], []
        dP, before = ca.SX.sym("dP", n * n), ca.SX.sym("before", len(indices))
        known, sums, changed = w.add(factors), ca.SX.sym("sums", len(indices)), ca.SX(self.dm)
        for c, (i, j, k) in enumerate(indices):
            changed[i] += lanes.add(dfactors[c])[0] * sums[c] + known[c] * (before[c] + dP[j * n + k])
        self.lanes.add("dP_before")
        kept = stage({DERIVATIVE_OF_COVARIANCE: dP}, {"dP_before": ca.vertcat(*[dP[j * n + k] for _, j, k in indices])})
        inputs = {DERIVATIVE_OF_MEAN: self.dm, DERIVATIVE_OF_COVARIANCE: dP, "dP_before": before, "sums": sums}
        inputs |= {w.name: w.symbols, lanes.name: lanes.symbols}
        return [kept], [stage(inputs, {DERIVATIVE_OF_MEAN: changed})]

    def derivative(self, expression: Any, w: _Scalars) -> Any:
        """Return the derivative of an expression of the mean and the parameters, by the directions of the lanes.

        The numbers that it needs are appended to ``w``, and their symbols take their place.
        """
        g = self.graphs
        ds = ca.vertcat(self.dm, ca.SX.zeros(g.s.numel() - g.n))
        moved = ca.cse(directional_derivative(g, expression, ds, self._dp))
        rest, symbols, needed = ca.extract_parametric(
            [moved], ca.vertcat(*g.inputs.values()), {"extract_trivial": True}
        )
        w.add_known(symbols, needed)
        return ca.densify(rest[0])

    def covariance_of_lanes(self, bit: int | None) -> tuple[str, list[Stage]]:
        """Return the name of the array of the covariance in the precision of the lanes, and the stages that fill it."""
        if not self.single:
            return COVARIANCE, []
        self.scalars.add("P_single")
        return "P_single", [SingleCopyStage(COVARIANCE, "P_single", self.graphs.n * self.stride, bit)]

    def stage_in_lanes(self, w: _Scalars, results: dict[str, Any], bit: int | None) -> Stage:
        """Return the stage that computes results from the derivatives of the mean, the directions and ``w``."""
        return stage({DERIVATIVE_OF_MEAN: self.dm, "dp": self._dp, w.name: w.symbols}, results, bit)


class _UpdateDerivatives:
    """Stages in lanes of the derivatives of the update by one sensor.

    Attributes
    ----------
    of_measurement : Stage
        Stage that computes the derivatives of the predicted values, of their derivatives and of the noise.
    """

    def __init__(self, stages: FilterStages, q: int, w: _Scalars) -> None:
        """Differentiate the measurements of the sensor q. The numbers that this takes are appended to ``w``."""
        self._of, self._q, self._samples = stages, q, stages.graphs.samples[q]
        self._lanes = lanes = _Lanes(f"l{q}")
        parts = [ca.vertcat(s.e, s.R, *s.H.nonzeros()) for s in self._samples]
        moved, first = stages.derivative(ca.vertcat(*parts), w), 0
        self._moved: list[list[tuple[Any, int | None]]] = []  # symbol and index, for each scalar
        for part in parts:
            self._moved.append([lanes.add(moved[first + k]) for k in range(part.numel())])
            first += part.numel()
        self.of_measurement = stages.stage_in_lanes(w, {lanes.name: lanes.values}, q)
        n = stages.graphs.n
        self._dPH, self._ddx = ca.SX.sym("dPH", n), ca.SX.sym("ddx", n)
        self._known = ca.SX.sym("known", 2 * (len(parts) - 1))
        between = {f"ddx{q}", f"known{q}"} if len(parts) > 1 else set()
        stages.lanes |= {lanes.name, f"dPH{q}", f"a{q}", f"v{q}"} | between
        stages.scalars.add(w.name)

    def of_scalar(self, i: int, c: ScalarUpdate, PH: Any, dx: Any) -> tuple[dict[str, Any], list[Stage], list[Stage]]:
        """Return the numbers that the derivatives of the scalar i take, by name of their array, and the stages.

        The first stages run before the covariance changes.

        Parameters
        ----------
        i : int
            Number of the scalar measurement of the sensor.
        c : ScalarUpdate
            Its innovation.
        PH, dx : SX (n, 1)
            Covariance times H', and change of the mean by the scalars before it, as symbols.
        """
        q, n, last, lanes = self._q, self._of.graphs.n, len(self._samples) - 1, self._lanes
        w = _Scalars(f"w{q}_{i}")
        (de, _), (dR, _), *slopes = self._moved[i]
        dPH, ddx, known = self._dPH, self._ddx, self._known
        columns = [column for _, column, _ in _entries(c.sample.H)]
        H = w.add(c.sample.H).nonzeros()
        by_scalars = tuple(enumerate(columns))
        by_lanes = tuple(
            (index, column * self._of.stride)
            for column, (_, index) in zip(columns, slopes, strict=True)
            if index is not None
        )
        now, first_PH = w.add_dense(PH)
        dS = dR
        for k, column in enumerate(columns):
            dH = slopes[k][0]
            dS = dS + H[k] * dPH[column] + dH * now[column]
            if i:
                de = de - dH * w.add(dx[column]) - H[k] * ddx[column]
        slope, dslope, scale, dscale = self._gain_derivatives(c, w, de, dS)
        change = slope * dPH + now * dslope + (ddx if i else 0)
        inputs = {lanes.name: lanes.symbols, f"dPH{q}": dPH} | ({f"ddx{q}": ddx, f"known{q}": known} if i else {})
        results = {f"a{q}": -(scale * dPH + now * (dscale / 2))} | self._results(c, w, de, dS)
        so_far = ca.vertcat(known[: 2 * i], *self._parts_of_information(c, w, de, dS))
        if i < last:
            results |= {f"ddx{q}": change, f"known{q}": ca.vertcat(so_far, ca.SX.zeros(2 * (last - i - 1)))}
        else:
            inputs[DERIVATIVE_OF_MEAN] = self._of.dm
            results |= {DERIVATIVE_OF_MEAN: self._of.dm + change, f"v{q}": so_far}
        self._of.scalars.add(w.name)
        dP = DERIVATIVE_OF_COVARIANCE
        rows, before = self._of.covariance_of_lanes(q) if by_lanes else (w.name, [])
        product = CombinationStage(lanes.name, rows, w.name, dP, f"dPH{q}", n, (by_lanes,), (by_scalars,), bit=q)
        after: list[Stage] = [
            stage(inputs | {w.name: w.symbols}, results, q),
            AddProductsStage(f"a{q}", w.name, first_PH, dP, n, q),
        ]
        after += [GramStage(f"v{q}", "fisher", 2 * (last + 1), q)] if i == last else []
        return {w.name: w.values}, [*before, product], after

    def _gain_derivatives(self, c: ScalarUpdate, w: _Scalars, de: Any, dS: Any) -> tuple[Any, Any, Any, Any]:
        """Return slope and its derivative, and the factor q of the covariance's update and its derivative.

        Both are functions of the innovation and its variance, whose derivatives are ``de`` and ``dS``.
        """
        e, S = ca.SX.sym("e"), ca.SX.sym("S")
        pair = ca.vertcat(*self._of.graphs.gain_factors(c.sample.output, e, S))
        slopes = ca.substitute(ca.jacobian(pair, ca.vertcat(e, S)), ca.vertcat(e, S), ca.vertcat(c.e, c.S))
        moved = w.add(ca.sparsify(slopes)) @ ca.vertcat(de, dS)
        return w.add(c.slope), moved[0], w.add(c.inverse_variance), moved[1]

    def _results(self, c: ScalarUpdate, w: _Scalars, de: Any, dS: Any) -> dict[str, Any]:
        """Return the summed results of a scalar measurement by name: derivative of the log-likelihood, and rounding."""
        by_S = w.add(0.5 * (c.e * c.slope - 1) / c.S)
        results = {"dll": by_S * dS - w.add(c.slope) * de}
        if self._of.single:
            results["lost"] = (dS * w.add(1 / c.sample.R)) ** 2
        return results

    @staticmethod
    def _parts_of_information(c: ScalarUpdate, w: _Scalars, de: Any, dS: Any) -> tuple[Any, Any]:
        """Return two numbers in lanes; the sum of the products of those of two lanes is the Fisher information."""
        of_e, of_S = outlier_density.INFORMATION if c.sample.output.robust else (1.0, 1.0)
        return w.add(np.sqrt(of_e) / ca.sqrt(c.S)) * de, w.add(np.sqrt(0.5 * of_S) / c.S) * dS


def directional_derivative(g: EkfGraphs, expression: Any, ds: Any, dp: Any) -> Any:
    """Return the directional derivative (n, 1) of an expression (n, 1).

    The direction is the change ``ds`` of the filter state together with the change ``dp`` of the parameters.

    Subexpressions of inputs and parameters alone are differentiated by the parameters once for all lanes. For example,
    a delayed command has fifty copies, each with a weight that depends on two parameters.
    """
    data = ca.vertcat(g.u, g.u_next, g.y, g.p, g.h)
    (rest,), symbols, parts = ca.extract_parametric([expression], data, {})
    q, part = ca.vertcat(ca.SX(0, 1), *symbols), ca.vertcat(ca.SX(0, 1), *parts)
    moved = ca.jtimes(rest, ca.vertcat(g.s, g.p, q), ca.vertcat(ds, dp, ca.jacobian(part, g.p) @ dp))
    return ca.substitute(moved, q, part)


def _entries(matrix: Any) -> list[tuple[int, int, Any]]:
    """Return row, column and expression of each nonzero entry of a matrix, in CasADi's order of the entries."""
    rows, columns = matrix.sparsity().get_triplet()
    return list(zip(rows, columns, matrix.nonzeros(), strict=True))


def _frozen(terms: list[list[tuple[int, int]]]) -> Terms:
    """Return the terms of each row as tuples, as `CombinationStage` needs them."""
    return tuple(tuple(row) for row in terms)
