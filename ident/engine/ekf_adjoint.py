"""Adjoint of the extended Kalman filter, stage by stage.

The adjoint of a stage starts from the derivatives of the log-likelihood by the state after the stage. It returns the
derivatives by the state before the stage and by the parameters.

The derivatives are formed matrix by matrix (Giles 2008). Differentiating the scalar expressions one by one would not
use the symmetry of the covariance. Let L be twice the symmetric matrix of derivatives by the covariance after a stage.
The prediction and the derivatives by its factors are

    P+ = Phi (P + Q) Phi' + T Q T' + Q:   P: Phi' L Phi / 2,   Phi: L Phi (P + Q),   T: L T Q

The update by one scalar measurement and its derivatives are

    P+ = P - q PH PH':   P: L / 2,   PH: -q L PH,   q: -PH' L PH / 2.

Columns of Phi, T and P + Q that vary from row to row are stored side by side on the tape. The products L [Phi T] and
L Phi (P + Q), a third of all products, then use vector instructions.
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
    """Adjoint of one stage.

    Attributes
    ----------
    both : SX column
        Derivatives by the state, followed by the derivatives by the parameters.
        The column depends on the inputs of the stage except the state, on ``bar``, and on the symbols in `needs`.
    needs : Mapping[str, SX]
        Symbols of the values that the adjoint reads from the tape, by array.
    keeps : Mapping[str, SX]
        Expressions that the forward pass writes to the tape, by array.
    before : tuple[Product, ...]
        Matrix products that run before the adjoint.
    """

    both: Any
    needs: Mapping[str, Any]
    keeps: Mapping[str, Any]
    before: tuple[Product, ...] = ()

    def stages(self, g: EkfGraphs, bar: Any, bit: int | None) -> tuple[Product | LoopSegment, ...]:
        """Return the stages of the adjoint in the order in which they run."""
        inputs = {name: v for name, v in g.inputs.items() if name != "s"} | dict(self.needs) | {"bar": bar}
        results = {"bar": self.both[: bar.numel()], "g": self.both[bar.numel() :]}
        return (*self.before, stage(inputs, results, bit))


def of_stage(g: EkfGraphs, effect: Mapping[str, Any], tape: str, bar: Any) -> Adjoint:
    """Return the adjoint of any stage by differentiating its expressions.

    Parameters
    ----------
    g : EkfGraphs
        Graphs of the filter.
    effect : Mapping[str, SX]
        Result of the stage: the state after it, and the log-likelihood ``ll`` if the stage is an update.
    tape : str
        Name of the array on the tape.
    bar : SX (n_s, 1)
        Symbols of the derivatives by the state after the stage.
    """
    weight = ca.vertcat(bar, *[1] * ("ll" in effect))
    both = reverse_mode(ca.vertcat(*effect.values()), ca.vertcat(g.s, g.p), weight)
    both, needs, keeps = _taped(g, both, ca.SX(0, 1), bar)
    return Adjoint(both, {tape: needs}, {tape: keeps})


def of_update(g: EkfGraphs, update: Update, tape: str, bar: Any) -> Adjoint:
    """Return the adjoint of the update by one sensor, from its last scalar to its first.

    Without a covariance, or with Joseph's form, `of_stage` is used.
    """
    if not g.covariance or g.joseph:
        return of_stage(g, {"s": update.s, "ll": update.ll}, tape, bar)
    n, n_s = g.n, g.s.numel()
    before = [ca.vertcat(0 * g.mean, pack(g.P)), *[ca.vertcat(c.dx, pack(c.P)) for c in update.corrections[:-1]]]
    # derivatives by dx and P, and derivatives by the mean and the parameters
    by_state, direct = bar, ca.SX(n + g.p.numel(), 1)
    for correction, values in zip(update.corrections[::-1], before[::-1], strict=True):
        s = ca.SX.sym("s", n_s)  # symbols of dx and P before this scalar, which are replaced by their values below
        c = g.correct(correction.sample, s[:n], unpack(s[n:], n))
        L_PH = _doubled(unpack(by_state[n:], n)) @ c.PH
        weight = ca.vertcat(by_state[:n], 1, -c.inverse_variance * L_PH, -ca.dot(c.PH, L_PH) / 2)
        slopes = reverse_mode(ca.vertcat(c.dx, c.ll, c.PH, c.inverse_variance), ca.vertcat(s, g.mean, g.p), weight)
        slopes = ca.substitute(slopes, s, values)
        by_state = ca.vertcat(slopes[:n], by_state[n:] + slopes[n:n_s])
        direct += slopes[n_s:]
    both = ca.vertcat(bar[:n] + direct[:n], by_state[n:], direct[n:])
    both, needs, keeps = _taped(g, both, ca.SX(0, 1), bar)
    return Adjoint(both, {tape: needs}, {tape: keeps})


def of_prediction(g: EkfGraphs, tape: str, bar: Any) -> Adjoint:
    """Return the adjoint of ``EkfGraphs.predict``.

    `of_stage` is used if the filter is of second order, because its mean then depends on the covariance. `of_stage` is
    also used if no column of Phi varies from row to row.
    """
    # columns of Phi that differ from the constant columns of an identity
    moving = [k for k in range(g.n) if g.covariance and not _constant(g.transition.Phi[:, k])]
    if not moving or g.model.second_order:
        return of_stage(g, {"s": g.predict[0]}, tape, bar)
    n, A, Q, upper = g.n, g.transition.A, g.transition.Q, unpack(bar[g.n :], g.n)
    L, T = _doubled(upper), g.transition.T @ ca.diag([not _constant(Q[k, k]) for k in range(n)])
    # moved: columns of Phi and T, to be multiplied by L; spread: columns of P + Q, to be multiplied by L Phi
    moved = _Columns(
        "moved",
        {("Phi", k): g.transition.Phi[:, k] for k in moving}
        | {("T", k): T[:, k] for k in range(n) if not _constant(T[:, k])},
    )
    spread = _Columns("spread", {("P", k): (g.P + Q)[:, k] for k in moving})
    Phi, LPhi = moved.read("Phi", g.transition.Phi), moved.turned("Phi", L)
    T, LT = moved.read("T", T), moved.turned("T", L @ T)
    by_P = Phi.T @ LPhi  # twice the derivative by P, see the module
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
    """Columns stored side by side in an array (n, stride) by rows.

    A second array of the same shape holds the product of a matrix, from the left, with these columns.
    Unused columns of the first array are zero.
    """

    def __init__(self, name: str, columns: Mapping[tuple[str, int], Any]) -> None:
        """Store the columns; a key is (name of the matrix, index of the column)."""
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
        """Return the matrix with symbols in the place of entries that vary from row to row."""
        result = ca.SX(whole)
        for name, k in self._first:
            for i in range(self._n):
                if name == matrix and not _constant(result[i, k]):
                    result[i, k] = self.array[self.factor((name, k), i).place]
        return result

    def turned(self, matrix: str, rest: Any) -> Any:
        """Return the product with the matrix. ``rest`` is the product for columns that are not in the array."""
        result = ca.SX(rest)
        for name, k in self._first:
            if name == matrix:
                result[:, k] = self.result[self._places((name, k))]
        return result

    def product(self, left: Sequence[Sequence[Factor]]) -> Product:
        """Return the product of the matrix ``left`` with the stored columns."""
        return Product(tuple(map(tuple, left)), *self._names, self._stride, self._width)

    def factor(self, column: tuple[str, int], i: int) -> Factor:
        """Return entry i of the product with one column."""
        return Factor(self._names[1], i * self._stride + self._first[column])

    def _places(self, column: tuple[str, int]) -> slice:
        return slice(self._first[column], None, self._stride)


def _factors(n: int) -> list[list[Factor]]:
    """Return the factors of L.

    In ``bar``, the derivatives by the upper triangle of the covariance follow those by the mean.
    """
    place = np.zeros((n, n), int)
    above = np.triu_indices(n)
    place[above] = place.T[above] = n + np.arange(above[0].size)
    return [[Factor("bar", int(place[i, j]), i == j) for j in range(n)] for i in range(n)]


def _of_series(A: Any, Phi: Any, T: Any) -> Any:
    """Return the adjoint of A from the adjoints of T = 2 + 2 A + A^2 and Phi = T - 1 + A^2 + 4/3 A^3."""
    A2, T = A @ A, T + Phi  # only the sparsity pattern of A2 is used
    right, left = (_like(A2, 4 / 3 * product) for product in (Phi @ A.T, A.T @ Phi))
    square = _like(A2, T + Phi)
    return _like(A, 2 * T + (square + right) @ A.T + A.T @ (square + right + left))


def _taped(g: EkfGraphs, both: Any, early: Any, late: Any) -> tuple[Any, Any, Any]:
    """Replace slow operations of an adjoint by symbols, and collect the values that it reads from the tape.

    Only the entries of the state on which the adjoint depends are stored. In a filter these are less than half of the
    entries. Storing all of them would make the forward pass a sixth slower by memory traffic alone.

    Parameters
    ----------
    both : SX column
        Adjoint.
    early, late : SX column
        Symbols outside ``g.inputs``: known in the forward pass (early), and known only in the backward pass (late).

    Returns
    -------
    tuple[SX, SX, SX]
        Adjoint with symbols; all symbols that it reads from the tape; the expressions of these symbols.
    """
    known_forward = ca.vertcat(*[v for name, v in g.inputs.items() if name != "p"], early)
    both, symbols, values = without_slow(both, g.p, known_forward, late)
    kept = [entry for entry, used in zip(ca.vertsplit(g.s), ca.which_depends(both, g.s), strict=True) if used]
    return both, *(ca.vertcat(ca.SX(0, 1), *kept, *more) for more in (symbols, values))


def _doubled(upper: Any) -> Any:
    """Return L, given the derivatives by the upper triangle of a covariance as a symmetric matrix."""
    return upper + ca.diag(ca.diag(upper))


def _constant(matrix: Any) -> bool:
    """Return whether no entry of the matrix depends on a symbol."""
    return all(entry.is_constant() for entry in matrix.nonzeros())


def _like(pattern: Any, matrix: Any) -> Any:
    """Return the matrix restricted to the sparsity of ``pattern``."""
    return ca.project(matrix, pattern.sparsity())
