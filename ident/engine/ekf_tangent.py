"""Forward sensitivities of the extended Kalman filter, matrix by matrix.

The sensitivities are the derivatives of the filter state by chosen parameters, one in each lane. Those of the mean are
the vector dm, those of the covariance P the matrix dP. A stage of a plan computes the derivatives of the scalar
expressions of the model. Routines that are compiled once for all models do the work on matrices.

The update by one scalar measurement with the predicted value z, its derivatives H by the states, and the variance R is

    PH = P H',   S = H PH + R,   dx += PH slope(e, S),   P -= q(e, S) PH PH'.

Its sensitivities are

    dPH = P dH' + dP H',   dS = H dPH + dH PH + dR,   ddx += dPH slope + PH dslope,   dP += a PH' + PH a',

with ``a = -(q dPH + dq PH / 2)``. The covariance after the prediction is ``Phi (P + Q) Phi' + T Q T' + Q``, and its
sensitivity is the sum of a matrix and of its transpose, plus dQ. The matrix is

    (dPhi (P + Q) + Phi (dP + dQ) / 2) Phi' + (dT Q + T dQ / 2) T'.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from seatrial.ident.engine.array_layout import DERIVATIVE_OF_COVARIANCE as COVARIANCE
from seatrial.ident.engine.array_layout import DERIVATIVE_OF_MEAN as MEAN
from seatrial.ident.engine.ekf_graph import EkfGraphs, ScalarUpdate, Update
from seatrial.ident.engine.loop_plan import (
    AddEntriesStage,
    AddProductsStage,
    AddTransposedStage,
    CombinationStage,
    GramStage,
    Stage,
    stage,
)


class _Scalars:
    """Array of the numbers of a row that its stages in lanes read; they are computed once for all lanes.

    Attributes
    ----------
    name : str
        Name of the array.
    """

    def __init__(self, name: str) -> None:
        """Create an empty array with this name. `add` fills it."""
        self.name = name
        self._symbols: list[Any] = []
        self._values: list[Any] = []

    def __len__(self) -> int:
        """Return the number of entries so far."""
        return len(self._values)

    def add(self, value: Any) -> Any:
        """Append the nonzero entries of a matrix, and return the matrix with symbols in place of these entries.

        Constant entries are appended, too, so that the entries of the array follow each other, but remain constants in
        the result.
        """
        value = ca.SX(value)
        new = [ca.SX.sym(f"{self.name}_{len(self) + k}") for k in range(value.nnz())]
        entries = value.nonzeros()
        self._symbols += new
        self._values += entries
        shown = [e if e.is_constant() else symbol for e, symbol in zip(entries, new, strict=True)]
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

    @property
    def symbols(self) -> Any:
        """Symbols of all entries, as a column."""
        return ca.vertcat(ca.SX(0, 1), *self._symbols)

    @property
    def values(self) -> Any:
        """Expressions of all entries, as a column."""
        return ca.vertcat(ca.SX(0, 1), *self._values)


class _Lanes:
    """Array in lanes of derivatives, of which those that are zero are left out.

    Attributes
    ----------
    name : str
        Name of the array.
    """

    def __init__(self, name: str) -> None:
        """Create an empty array with this name. `add` fills it."""
        self.name = name
        self._symbols: list[Any] = []
        self._values: list[Any] = []

    def add(self, value: Any) -> tuple[Any, int | None]:
        """Append a derivative; return its symbol and its index. They are zero and None if the derivative is zero."""
        if value.is_zero():
            return ca.SX(0), None
        self._symbols.append(ca.SX.sym(f"{self.name}_{len(self._symbols)}"))
        self._values.append(value)
        return self._symbols[-1], len(self._symbols) - 1

    @property
    def symbols(self) -> Any:
        """Symbols of all entries, as a column."""
        return ca.vertcat(ca.SX(0, 1), *self._symbols)

    @property
    def values(self) -> Any:
        """Expressions of all entries, as a column."""
        return ca.vertcat(ca.SX(0, 1), *self._values)


class TangentStages:
    """Stages of a plan that compute the forward sensitivities of a filter with a covariance, in each row.

    Joseph's form of the update and the second-order filter have other sensitivities; the caller excludes both.

    Attributes
    ----------
    graphs : EkfGraphs
        Expressions of the filter.
    lanes, scalars : set[str]
        Names of the arrays in lanes, and of the arrays of numbers that stages in lanes read, so far.
    """

    def __init__(self, graphs: EkfGraphs, with_rounding: bool) -> None:
        """Prepare the stages. ``with_rounding``: whether ``lost`` is computed (`filter_plans.Plans.tangent`)."""
        self.graphs, self._with_rounding = graphs, with_rounding
        self.lanes: set[str] = {MEAN, COVARIANCE, "dp", "dll", *(["lost"] if with_rounding else [])}
        self.scalars: set[str] = set()
        self._dm, self._dp = ca.SX.sym(MEAN, graphs.n), ca.SX.sym("dp", graphs.p.numel())

    def update(self, q: int, u: Update) -> list[Stage]:
        """Return the stages of the update by the sensor with the number q, with its part of the results."""
        n, last = self.graphs.n, len(u.corrections) - 1
        w, lanes = _Scalars(f"w{q}"), _Lanes(f"l{q}")
        moved = self._measurement_derivatives(u, w, lanes)
        dPH, ddx, known = ca.SX.sym("dPH", n), ca.SX.sym("ddx", n), ca.SX.sym("known", 2 * last)
        chain: list[Stage | tuple[dict[str, Any], dict[str, Any]]] = []
        dx, P = 0 * self.graphs.mean, self.graphs.P
        for i, c in enumerate(u.corrections):
            de, dR, slopes = moved[i]
            columns = c.sample.H.sparsity().get_col()
            first = len(w)
            H = w.add(c.sample.H).nonzeros()
            by_scalars = tuple((first + k, column) for k, column in enumerate(columns))
            by_lanes = tuple(
                (index, w.add_dense(P[column, :])[1])
                for column, (_, index) in zip(columns, slopes, strict=True)
                if index is not None
            )
            combination = CombinationStage(
                lanes.name, w.name, COVARIANCE, f"dPH{q}", n, (by_lanes,), (by_scalars,), bit=q
            )
            PH, first_PH = w.add_dense(c.PH)
            dS = dR
            for k, column in enumerate(columns):
                dH = slopes[k][0]
                dS += H[k] * dPH[column] + dH * PH[column]
                if i:
                    de -= dH * w.add(dx[column]) + H[k] * ddx[column]
            slope, dslope, scale, dscale = self._gain_derivatives(c, w, de, dS)
            change = slope * dPH + PH * dslope + (ddx if i else 0)
            inputs = {lanes.name: lanes.symbols, f"dPH{q}": dPH} | ({f"ddx{q}": ddx, f"known{q}": known} if i else {})
            results = {f"a{q}": -(scale * dPH + PH * (dscale / 2))}
            so_far = ca.vertcat(known[: 2 * i], de, dS)
            if i < last:
                results |= {f"ddx{q}": change, f"known{q}": ca.vertcat(so_far, ca.SX.zeros(2 * (last - i - 1)))}
            else:
                inputs[MEAN] = self._dm
                results |= {MEAN: self._dm + change} | self._results(q, u, w, so_far)
            chain += [combination, (inputs, results), AddProductsStage(f"a{q}", w.name, first_PH, COVARIANCE, n, q)]
            dx, P = c.dx, c.P
        self.lanes |= {lanes.name, f"dPH{q}", f"a{q}", f"v{q}"} | ({f"ddx{q}", f"known{q}"} if last else set())
        self.scalars.add(w.name)
        inputs = {MEAN: self._dm, "dp": self._dp}
        done = [stage({**s[0], w.name: w.symbols}, s[1], q) if isinstance(s, tuple) else s for s in chain]
        return [
            self._row_stage({"s": u.s, "ll": u.ll}, w, q),
            stage({**inputs, w.name: w.symbols}, {lanes.name: lanes.values}, q),
            *done,
            GramStage(f"v{q}", "fisher", 2 * len(u.corrections), q),
        ]

    def prediction(self, q: int) -> list[Stage]:
        """Return the stages of the prediction to the next row; q is the number of its arrays."""
        g, n, t = self.graphs, self.graphs.n, self.graphs.transition
        w, lanes = _Scalars(f"w{q}"), _Lanes(f"l{q}")
        noisy = [k for k in range(n) if not t.Q[k, k].is_zero()]
        Q = ca.vertcat(ca.SX(0, 1), *[t.Q[k, k] for k in noisy])
        moved = self._derivative(ca.vertcat(g.mean_step[0], *t.A.nonzeros(), Q), w)
        dm, dA, dQ = moved[:n], moved[n : n + t.A.nnz()], moved[n + t.A.nnz() :]
        dA = ca.sparsify(ca.SX(t.A.sparsity(), dA))
        A, A2 = w.add(t.A), w.add(ca.sparsify(t.A @ t.A))
        dA2 = dA @ A + A @ dA
        dT = 2 * dA + dA2
        dPhi = ca.sparsify(dT + dA2 + 4 / 3 * (dA @ A2 + A @ dA2))
        of_Phi: list[list[tuple[int, int]]] = [[] for _ in range(n)]  # by row of the result, as in CombinationStage
        of_T: list[list[tuple[int, int]]] = [[] for _ in range(n)]
        spread = dict[int, int]()  # first index of the row of P + Q, by number of the row
        for i, k, value in _entries(dPhi):
            if (index := lanes.add(value)[1]) is not None:
                if k not in spread:
                    spread[k] = w.add_dense((g.P + t.Q)[k, :])[1]
                of_Phi[i].append((index, spread[k]))
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
        halves, wholes = ([[] for _ in range(n)] for _ in range(2))  # type: tuple[list[list[tuple[int, int]]], ...]
        for terms, matrix in ((halves, t.Phi / 2), (wholes, t.Phi)):
            first = len(w)
            for position, (i, k, _) in enumerate(_entries(w.add(matrix))):
                terms[i].append((first + position, k))
        arrays = (lanes.name, w.name)
        self.lanes |= {lanes.name, "product", "half"}
        self.scalars.add(w.name)
        inputs = {MEAN: self._dm, "dp": self._dp, w.name: w.symbols}
        noise = [AddEntriesStage(lanes.name, COVARIANCE, tuple(diagonal))] if diagonal else []
        return [
            self._row_stage({"s": g.predict[0]}, w, None),
            stage(inputs, {MEAN: dm, lanes.name: lanes.values}),
            *noise,
            CombinationStage(*arrays, COVARIANCE, "product", n, _frozen(of_Phi), _frozen(halves), transposed=True),
            CombinationStage(*arrays, "product", "half", n, _frozen(of_T), _frozen(wholes)),
            AddTransposedStage("half", COVARIANCE, n),
            *noise,
        ]

    def _measurement_derivatives(
        self, u: Update, w: _Scalars, lanes: _Lanes
    ) -> list[tuple[Any, Any, list[tuple[Any, int | None]]]]:
        """Return the derivatives of e, R and the nonzero entries of H of each scalar measurement of an update.

        Those of H are pairs (symbol, index in ``lanes``), as `_Lanes.add` returns them.
        """
        parts = [ca.vertcat(c.sample.e, c.sample.R, *c.sample.H.nonzeros()) for c in u.corrections]
        moved, found, first = self._derivative(ca.vertcat(*parts), w), [], 0
        for part in parts:
            added = [lanes.add(moved[first + k]) for k in range(part.numel())]
            found.append((added[0][0], added[1][0], added[2:]))
            first += part.numel()
        return found

    def _gain_derivatives(self, c: ScalarUpdate, w: _Scalars, de: Any, dS: Any) -> tuple[Any, Any, Any, Any]:
        """Return slope and its derivative, and the factor q of the covariance's update and its derivative.

        Both are functions of the innovation and its variance, whose derivatives are ``de`` and ``dS``.
        """
        e, S = ca.SX.sym("e"), ca.SX.sym("S")
        pair = ca.vertcat(*self.graphs.gain_factors(c.sample.output, e, S))
        slopes = ca.substitute(ca.jacobian(pair, ca.vertcat(e, S)), ca.vertcat(e, S), ca.vertcat(c.e, c.S))
        J = w.add(ca.sparsify(slopes))
        moved = J @ ca.vertcat(de, dS)
        return w.add(c.slope), moved[0], w.add(c.inverse_variance), moved[1]

    def _results(self, q: int, u: Update, w: _Scalars, known: Any) -> dict[str, Any]:
        """Return the results of an update by name: derivative of the log-likelihood, and parts of the information.

        ``known`` has the derivatives of innovation and variance of each scalar measurement, one pair after the other.
        """
        de, dS = known[::2], known[1::2]
        by_S, by_e = w.add(ca.densify(0.5 * (u.e * u.slope - 1) / u.S)), w.add(ca.densify(-u.slope))
        part = ca.sqrt(u.information)
        scale, of_S = w.add(part[:, 0] / ca.sqrt(u.S)), w.add(np.sqrt(0.5) * part[:, 1] / u.S)
        results = {"dll": ca.dot(by_S, dS) + ca.dot(by_e, de), f"v{q}": ca.vertcat(scale * de, of_S * dS)}
        if self._with_rounding:
            results["lost"] = ca.sumsqr(dS * w.add(1 / ca.vertcat(*[c.sample.R for c in u.corrections])))
        return results

    def _derivative(self, expression: Any, w: _Scalars) -> Any:
        """Return the derivative of an expression of the mean and the parameters, by the directions of the lanes.

        The numbers that it needs are appended to ``w``, and their symbols take their place.
        """
        g = self.graphs
        ds = ca.vertcat(self._dm, ca.SX.zeros(g.s.numel() - g.n))
        moved = ca.cse(directional_derivative(g, expression, ds, self._dp))
        rest, symbols, needed = ca.extract_parametric(
            [moved], ca.vertcat(*g.inputs.values()), {"extract_trivial": True}
        )
        w.add_known(symbols, needed)
        return ca.densify(rest[0])

    def _row_stage(self, results: dict[str, Any], w: _Scalars, bit: int | None) -> Stage:
        """Return the stage that computes a stage of the filter, and the numbers that the stages in lanes read."""
        return stage(self.graphs.inputs, {**results, w.name: w.values}, bit)


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


def _frozen(terms: list[list[tuple[int, int]]]) -> tuple[tuple[tuple[int, int], ...], ...]:
    """Return the terms of each row as tuples, as `CombinationStage` needs them."""
    return tuple(tuple(row) for row in terms)
