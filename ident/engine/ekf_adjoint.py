"""Adjoint of the filter: derivatives of the likelihood by the state before a stage from those by the state after it.

Matrix by matrix (Giles 2008), not as the expressions stand, which do not know that a covariance is symmetric. Let L be
twice the symmetric matrix of slopes by the covariance after a stage. The prediction is

    P+ = Phi (P + Q) Phi' + T Q T' + Q:   P: Phi' L Phi / 2,   Phi: L Phi (P + Q),   T: L T Q

and a scalar of a sensor

    P+ = P - q PH PH':   P: L / 2,   PH: -q L PH,   q: -PH' L PH / 2.

Columns of Phi and T that are not the same in all rows stand side by side on the tape, and so do those of P + Q: then
L [Phi T] and L Phi (P + Q), a third of all products, are done with vectors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from seatrial.ident.engine import jit
from seatrial.ident.engine.ekf_graph import EkfGraphs, Update, pack, unpack
from seatrial.ident.engine.expressions import reverse_mode
from seatrial.ident.engine.loop_plan import Factor, LoopSegment, Product, stage, without_slow


@dataclass(frozen=True)
class Adjoint:
    """``both``: slopes by the state, then by the parameters, as a column of what the stage is given but the state, of
    ``bar``, and of the symbols ``needs`` by array; ``keeps``: what the way forward leaves on the tape, by array."""

    both: Any
    needs: Mapping[str, Any]
    keeps: Mapping[str, Any]
    before: tuple[Product, ...] = ()

    def stages(self, g: EkfGraphs, bar: Any, bit: int | None) -> tuple[Product | LoopSegment, ...]:
        """In the order in which they run."""
        inputs = {name: v for name, v in g.inputs.items() if name != "s"} | dict(self.needs) | {"bar": bar}
        results = {"bar": self.both[: bar.numel()], "g": self.both[bar.numel() :]}
        return (*self.before, stage(inputs, results, bit))


def of_stage(g: EkfGraphs, effect: Mapping[str, Any], tape: str, bar: Any) -> Adjoint:
    """Of any stage, as it stands; ``effect``: the state after it and, of an update, the log-likelihood."""
    weight = ca.vertcat(bar, *[1] * ("ll" in effect))
    both = reverse_mode(ca.vertcat(*effect.values()), ca.vertcat(g.s, g.p), weight)
    both, needs, keeps = _taped(g, both, ca.SX(0, 1), bar)
    return Adjoint(both, {tape: needs}, {tape: keeps})


def of_update(g: EkfGraphs, update: Update, tape: str, bar: Any) -> Adjoint:
    """Of a sensor's sample, from its last scalar to its first."""
    if not g.covariance or g.joseph:
        return of_stage(g, {"s": update.s, "ll": update.ll}, tape, bar)
    n, n_s = g.n, g.s.numel()
    before = [ca.vertcat(0 * g.mean, pack(g.P)), *[ca.vertcat(c.dx, pack(c.P)) for c in update.corrections[:-1]]]
    moved, direct = bar, ca.SX(n + g.p.numel(), 1)  # slopes by dx and P; and by mean and parameters
    for done, values in zip(update.corrections[::-1], before[::-1], strict=True):
        s = ca.SX.sym("s", n_s)
        c = g.correct(done.sample, s[:n], unpack(s[n:], n))
        turned = _doubled(unpack(moved[n:], n)) @ c.PH
        weight = ca.vertcat(moved[:n], 1, -c.inverse_variance * turned, -ca.dot(c.PH, turned) / 2)
        slopes = reverse_mode(ca.vertcat(c.dx, c.ll, c.PH, c.inverse_variance), ca.vertcat(s, g.mean, g.p), weight)
        slopes = ca.substitute(slopes, s, values)
        moved = ca.vertcat(slopes[:n], moved[n:] + slopes[n:n_s])
        direct += slopes[n_s:]
    both = ca.vertcat(bar[:n] + direct[:n], moved[n:], direct[n:])
    both, needs, keeps = _taped(g, both, ca.SX(0, 1), bar)
    return Adjoint(both, {tape: needs}, {tape: keeps})


def of_prediction(g: EkfGraphs, tape: str, bar: Any) -> Adjoint:
    """Of ``Graphs.predict``. Where the covariance moves the mean (second order), or nothing moves, ``of_stage``."""
    moving = [k for k in range(g.n) if g.covariance and not _constant(g.moved.Phi[:, k])]  # not as in the identity
    if not moving or g.model.second_order:
        return of_stage(g, {"s": g.predict[0]}, tape, bar)
    n, A, Q, upper = g.n, g.moved.A, g.moved.Q, unpack(bar[g.n :], g.n)
    L, T = _doubled(upper), g.moved.T @ ca.diag([not _constant(Q[k, k]) for k in range(n)])
    moved = _Columns(
        "moved",
        {("Phi", k): g.moved.Phi[:, k] for k in moving}
        | {("T", k): T[:, k] for k in range(n) if not _constant(T[:, k])},
    )
    spread = _Columns("spread", {("P", k): (g.P + Q)[:, k] for k in moving})
    Phi, LPhi = moved.read("Phi", g.moved.Phi), moved.turned("Phi", L)
    T, LT = moved.read("T", T), moved.turned("T", L @ T)
    by_P = Phi.T @ LPhi
    by_Q = (ca.diag(by_P) + ca.diag(T.T @ LT)) / 2 + ca.diag(upper)
    by_A = _of_series(A, _like(Phi, spread.turned("P", ca.SX(n, n))), LT @ Q)
    effect = ca.vertcat(g.stepped[0], *A.nonzeros(), ca.diag(Q))
    slopes = reverse_mode(effect, ca.vertcat(g.mean, g.p), ca.vertcat(bar[:n], *by_A.nonzeros(), by_Q))
    both = ca.vertcat(slopes[:n], pack(by_P - ca.diag(ca.diag(by_P)) / 2), slopes[n:])
    both, needs, keeps = _taped(g, both, moved.array, ca.vertcat(bar, moved.result, spread.result))
    factors = _factors(n)
    products = (
        moved.product(factors),
        spread.product(
            [[moved.factor(("Phi", k), i) if k in moving else factors[i][k] for k in range(n)] for i in range(n)]
        ),
    )
    return Adjoint(
        both, {tape: needs} | moved.symbols | spread.symbols, {tape: keeps} | moved.kept | spread.kept, products
    )


class _Columns:
    """Columns side by side in an array (n, stride) by rows, and in another what comes of them by a matrix from the
    left; in the first, what is in no column is zero."""

    def __init__(self, name: str, columns: Mapping[tuple[str, int], Any]) -> None:
        self._n = n = next(iter(columns.values())).numel()
        self._width = min(jit.WIDTH, max(2, 1 << (len(columns) - 1).bit_length()))
        self._stride = -(-len(columns) // self._width) * self._width
        self._first = {column: j for j, column in enumerate(columns)}
        self._names = name, f"{name}_turned"
        self.array, self.result = (ca.SX.sym(s, n * self._stride) for s in self._names)
        self.symbols = dict(zip(self._names, (self.array, self.result), strict=True))
        values = ca.SX.zeros(n * self._stride)
        for column, value in columns.items():
            values[self._places(column)] = value
        self.kept = {name: values}

    def read(self, matrix: str, whole: Any) -> Any:
        """The matrix, with symbols where its entries are not the same in all rows."""
        found = ca.SX(whole)
        for name, k in self._first:
            for i in range(self._n):
                if name == matrix and not _constant(found[i, k]):
                    found[i, k] = self.array[self.factor((name, k), i).place]
        return found

    def turned(self, matrix: str, rest: Any) -> Any:
        """What comes of the matrix; ``rest``: the same, where columns are not in the array."""
        found = ca.SX(rest)
        for name, k in self._first:
            if name == matrix:
                found[:, k] = self.result[self._places((name, k))]
        return found

    def product(self, left: Sequence[Sequence[Factor]]) -> Product:
        """The matrix from the left."""
        return Product(tuple(map(tuple, left)), *self._names, self._stride, self._width)

    def factor(self, column: tuple[str, int], i: int) -> Factor:
        """Entry i of what comes of a column."""
        return Factor(self._names[1], i * self._stride + self._first[column])

    def _places(self, column: tuple[str, int]) -> slice:
        return slice(self._first[column], None, self._stride)


def _factors(n: int) -> list[list[Factor]]:
    """L, where ``bar`` holds the slopes by the upper triangle of a covariance behind those by the mean."""
    place = np.zeros((n, n), int)
    above = np.triu_indices(n)
    place[above] = place.T[above] = n + np.arange(above[0].size)
    return [[Factor("bar", int(place[i, j]), i == j) for j in range(n)] for i in range(n)]


def _of_series(A: Any, Phi: Any, T: Any) -> Any:
    """The adjoint of A, from those of T = 2 + 2 A + A^2 and Phi = T - 1 + A^2 + 4/3 A^3."""
    A2, T = A @ A, T + Phi  # of A2 only where it is zero
    right, left = (_like(A2, 4 / 3 * product) for product in (Phi @ A.T, A.T @ Phi))
    square = _like(A2, T + Phi)
    return _like(A, 2 * T + (square + right) @ A.T + A.T @ (square + right + left))


def _taped(g: EkfGraphs, both: Any, early: Any, late: Any) -> tuple[Any, Any, Any]:
    """An adjoint with symbols for sines and the like; all that it needs on the tape, and what that stands for.

    Of the state only the entries that the adjoint depends on: in a filter less than half of them, and a tape of all of
    them costs a sixth of the way forward in memory alone. ``early``, ``late``: symbols that are not in ``g.inputs``,
    those known on the way forward and the others.
    """
    given = ca.vertcat(*[v for name, v in g.inputs.items() if name != "p"], early)
    both, symbols, values = without_slow(both, g.p, given, late)
    kept = [entry for entry, used in zip(ca.vertsplit(g.s), ca.which_depends(both, g.s), strict=True) if used]
    return both, *(ca.vertcat(ca.SX(0, 1), *kept, *more) for more in (symbols, values))


def _doubled(upper: Any) -> Any:
    """L, of the slopes by the upper triangle of a covariance as a symmetric matrix."""
    return upper + ca.diag(ca.diag(upper))


def _constant(matrix: Any) -> bool:
    return all(entry.is_constant() for entry in matrix.nonzeros())


def _like(pattern: Any, matrix: Any) -> Any:
    return ca.project(matrix, pattern.sparsity())
