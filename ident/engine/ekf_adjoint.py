"""Adjoint of the extended Kalman filter, stage by stage: the gradient of the log-likelihood in one backward pass.

A stage is the update by one sensor or the prediction to the next row. The adjoint of a stage starts from the
derivatives ``bar`` of the log-likelihood by the filter state after the stage. It returns the derivatives by the filter
state before the stage and by the parameters. The filter state holds the mean and the upper triangle of the covariance.

The forward pass writes the values that the adjoint needs to arrays with one entry vector per row, the tape.

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
from seatrial.ident.engine.loop_plan import ExpressionStage, Factor, ProductStage, replace_slow_operations, stage


@dataclass(frozen=True)
class Adjoint:
    """Adjoint of one stage of the filter (update by a sensor, or prediction): expressions of its derivatives.

    The tape is the memory in which the forward pass stores, for each row, the values that the adjoint needs.

    Attributes
    ----------
    derivatives : SX (n_s + n_parameters, 1)
        Derivatives of the log-likelihood by the filter state before the stage, followed by those by the parameters.
        They depend on ``bar``, the derivatives by the filter state after the stage, on the inputs of the stage except
        the filter state, and on `tape_symbols`.
    tape_symbols : Mapping[str, SX]
        Symbols of the values that the adjoint reads, by name of the array: values on the tape, and results of
        `products`.
    tape_values : Mapping[str, SX]
        Expressions of the values that the forward pass writes to the tape, by name of the array.
    products : tuple[ProductStage, ...]
        Matrix products that are computed before the derivatives.
    """

    derivatives: Any
    tape_symbols: Mapping[str, Any]
    tape_values: Mapping[str, Any]
    products: tuple[ProductStage, ...] = ()

    def stages(self, g: EkfGraphs, bar: Any, bit: int | None) -> tuple[ProductStage | ExpressionStage, ...]:
        """Return the stages of a kernel (steps in each row) that compute this adjoint, in the order in which they run.

        They replace the array ``bar``, which passes from row to row, by the derivatives by the filter state before the
        stage of the filter. They also add the derivatives by the parameters to the array ``g``.

        Parameters
        ----------
        g : EkfGraphs
            Expressions of the filter.
        bar : SX (n_s, 1)
            Symbols of the derivatives by the filter state after the stage.
        bit : int or None
            Number of the sensor (0 to 31): the stages run only in rows with its sample. None: in every row.
        """
        inputs = {name: v for name, v in g.inputs.items() if name != "s"} | dict(self.tape_symbols) | {"bar": bar}
        results = {"bar": self.derivatives[: bar.numel()], "g": self.derivatives[bar.numel() :]}
        return (*self.products, stage(inputs, results, bit))


def adjoint_of_stage(g: EkfGraphs, effect: Mapping[str, Any], tape: str, bar: Any) -> Adjoint:
    """Return the adjoint of any stage of the filter, by differentiation of its scalar expressions.

    A stage is the update by one sensor or the prediction to the next row.

    Parameters
    ----------
    g : EkfGraphs
        Expressions of the filter.
    effect : Mapping[str, SX]
        Results of the stage: the filter state ``s`` after it, then the log-likelihood ``ll`` if the stage is an update.
    tape : str
        Name of the array in which the forward pass stores values for the adjoint.
    bar : SX (n_s, 1)
        Symbols of the derivatives by the filter state after the stage.
    """
    weight = ca.vertcat(bar, *[1] * ("ll" in effect))
    both = reverse_mode(ca.vertcat(*effect.values()), ca.vertcat(g.s, g.p), weight)
    both, needs, keeps = _replace_tape_values(g, both, ca.SX(0, 1), bar)
    return Adjoint(both, {tape: needs}, {tape: keeps})


def adjoint_of_update(g: EkfGraphs, update: Update, tape: str, bar: Any) -> Adjoint:
    """Return the adjoint of the filter's update by one sensor: the derivatives of the log-likelihood through it.

    The outputs of the sensor are processed from the last to the first. The derivatives by the covariance are formed as
    matrices. Without a covariance, or with Joseph's form, the scalar expressions are differentiated instead
    (`adjoint_of_stage`).

    Parameters
    ----------
    g : EkfGraphs
        Expressions of the filter.
    update : Update
        Update by the sensor.
    tape : str
        Name of the array in which the forward pass stores values for the adjoint.
    bar : SX (n_s, 1)
        Symbols of the derivatives by the filter state after the update.
    """
    if not g.covariance or g.joseph:
        return adjoint_of_stage(g, {"s": update.s, "ll": update.ll}, tape, bar)
    n, n_s = g.n, g.s.numel()
    before = [ca.vertcat(0 * g.mean, pack(g.P)), *[ca.vertcat(c.dx, pack(c.P)) for c in update.corrections[:-1]]]
    # derivatives by dx and P, and derivatives by the mean and the parameters
    by_state, direct = bar, ca.SX(n + g.p.numel(), 1)
    for correction, values in zip(update.corrections[::-1], before[::-1], strict=True):
        s = ca.SX.sym("s", n_s)  # symbols of dx and P before this scalar, which are replaced by their values below
        c = g.correct(correction.sample, s[:n], unpack(s[n:], n))
        L_PH = _doubled_diagonal(unpack(by_state[n:], n)) @ c.PH
        weight = ca.vertcat(by_state[:n], 1, -c.inverse_variance * L_PH, -ca.dot(c.PH, L_PH) / 2)
        slopes = reverse_mode(ca.vertcat(c.dx, c.ll, c.PH, c.inverse_variance), ca.vertcat(s, g.mean, g.p), weight)
        slopes = ca.substitute(slopes, s, values)
        by_state = ca.vertcat(slopes[:n], by_state[n:] + slopes[n:n_s])
        direct += slopes[n_s:]
    both = ca.vertcat(bar[:n] + direct[:n], by_state[n:], direct[n:])
    both, needs, keeps = _replace_tape_values(g, both, ca.SX(0, 1), bar)
    return Adjoint(both, {tape: needs}, {tape: keeps})


def adjoint_of_prediction(g: EkfGraphs, tape: str, bar: Any) -> Adjoint:
    """Return the adjoint of the filter's prediction to the next row: the derivatives of the log-likelihood through it.

    The derivatives by the covariance are formed as matrices. The scalar expressions are differentiated instead
    (`adjoint_of_stage`) in three cases: without a covariance; in a second-order filter, because its mean depends on the
    covariance; and if the transition matrix Phi has only constant columns.

    Parameters
    ----------
    g : EkfGraphs
        Expressions of the filter.
    tape : str
        Name of the array in which the forward pass stores single values for the adjoint. It stores varying columns of
        the matrices Phi and T in the array ``moved``, and columns of P + Q in ``spread``. Phi is the transition matrix
        of the interval, T twice that from its midpoint to its end, P the covariance, and Q its process noise
        (`IntervalTransition`).
    bar : SX (n_s, 1)
        Symbols of the derivatives by the filter state after the prediction.
    """
    # columns of Phi that differ from the constant columns of an identity
    moving = [k for k in range(g.n) if g.covariance and not _is_constant(g.transition.Phi[:, k])]
    if not moving or g.model.second_order:
        return adjoint_of_stage(g, {"s": g.predict[0]}, tape, bar)
    n, A, Q, upper = g.n, g.transition.A, g.transition.Q, unpack(bar[g.n :], g.n)
    L, T = _doubled_diagonal(upper), g.transition.T @ ca.diag([not _is_constant(Q[k, k]) for k in range(n)])
    # moved: columns of Phi and T, to be multiplied by L; spread: columns of P + Q, to be multiplied by L Phi
    moved = _TapeColumns(
        "moved",
        {("Phi", k): g.transition.Phi[:, k] for k in moving}
        | {("T", k): T[:, k] for k in range(n) if not _is_constant(T[:, k])},
    )
    spread = _TapeColumns("spread", {("P", k): (g.P + Q)[:, k] for k in moving})
    Phi, LPhi = moved.with_tape_symbols("Phi", g.transition.Phi), moved.product_columns("Phi", L)
    T, LT = moved.with_tape_symbols("T", T), moved.product_columns("T", L @ T)
    by_P = Phi.T @ LPhi  # twice the derivative by P, see the module
    by_Q = (ca.diag(by_P) + ca.diag(T.T @ LT)) / 2 + ca.diag(upper)
    by_A = _adjoint_of_series(A, _restricted_to_pattern(Phi, spread.product_columns("P", ca.SX(n, n))), LT @ Q)
    effect = ca.vertcat(g.mean_step[0], *A.nonzeros(), ca.diag(Q))
    slopes = reverse_mode(effect, ca.vertcat(g.mean, g.p), ca.vertcat(bar[:n], *by_A.nonzeros(), by_Q))
    both = ca.vertcat(slopes[:n], pack(by_P - ca.diag(ca.diag(by_P)) / 2), slopes[n:])
    both, needs, keeps = _replace_tape_values(g, both, moved.array, ca.vertcat(bar, moved.result, spread.result))
    factors = _covariance_derivative_factors(n)
    products = (
        moved.product(factors),
        spread.product(
            [[moved.factor(("Phi", k), i) if k in moving else factors[i][k] for k in range(n)] for i in range(n)]
        ),
    )
    return Adjoint(
        both,
        {tape: needs} | moved.symbols | spread.symbols,
        {tape: keeps} | moved.tape_values | spread.tape_values,
        products,
    )


class _TapeColumns:
    """Matrix columns that the forward pass stores side by side for the adjoint, in an array (n, stride) by matrix rows.

    In the backward pass, a second array of the same shape receives the product of a matrix (n, n) with these columns.
    The matrix is the left factor that the caller gives to `product`: for the array ``moved`` the matrix L of the module
    (twice the derivatives by the covariance), for ``spread`` the matrix L Phi. The stride is the number of columns,
    rounded up for vector instructions. Unused columns are zero.

    Attributes
    ----------
    array : SX (n stride, 1)
        Symbols of the stored columns.
    result : SX (n stride, 1)
        Symbols of the product.
    symbols : dict[str, SX]
        `array` and `result` by name: the name of the object, and the same with ``_turned``.
    tape_values : dict[str, SX]
        Expressions that the forward pass stores, by name of the array.
    """

    def __init__(self, name: str, columns: Mapping[tuple[str, int], Any]) -> None:
        """Place the columns side by side. ``name`` is the name of the array.

        A key of ``columns`` is (name of the matrix, index of the column in this matrix). A value is the column,
        SX (n, 1). There must be at least one column.
        """
        self._n = n = next(iter(columns.values())).numel()
        self._width = min(jit.WIDTH, max(2, 1 << (len(columns) - 1).bit_length()))
        self._stride = -(-len(columns) // self._width) * self._width
        self._column_of = {column: j for j, column in enumerate(columns)}
        self._names = name, f"{name}_turned"
        self.array, self.result = (ca.SX.sym(s, n * self._stride) for s in self._names)
        self.symbols = dict(zip(self._names, (self.array, self.result), strict=True))
        values = ca.SX.zeros(n * self._stride)
        for column, value in columns.items():
            values[self._column_entries(column)] = value
        self.tape_values = {name: values}

    def with_tape_symbols(self, matrix: str, whole: Any) -> Any:
        """Return the matrix ``whole`` (n, n), with symbols of stored values in place of entries of its stored columns.

        ``matrix`` is the name of this matrix in the keys of the columns. Constant entries, and columns that are not
        stored, keep their expressions.
        """
        result = ca.SX(whole)
        for name, k in self._column_of:
            for i in range(self._n):
                if name == matrix and not _is_constant(result[i, k]):
                    result[i, k] = self.array[self.factor((name, k), i).entry]
        return result

    def product_columns(self, matrix: str, rest: Any) -> Any:
        """Return the product (n, n) of the left factor (L or L Phi, see the class) with the matrix named ``matrix``.

        Columns of the product that belong to stored columns are symbols of `result`. The other columns are those of
        ``rest`` (n, n).
        """
        result = ca.SX(rest)
        for name, k in self._column_of:
            if name == matrix:
                result[:, k] = self.result[self._column_entries((name, k))]
        return result

    def product(self, left: Sequence[Sequence[Factor]]) -> ProductStage:
        """Return the stage of a kernel that multiplies the matrix ``left`` (n, n) by the stored columns.

        ``left`` has, in each row of the matrix, references to entries of arrays. The result is written to the second
        array, whose name is that of the stored columns with ``_turned``.
        """
        return ProductStage(tuple(map(tuple, left)), *self._names, self._stride, self._width)

    def factor(self, column: tuple[str, int], i: int) -> Factor:
        """Return a reference to entry i of the product with one stored column, which is given by its key.

        The key ``column`` is (name of the matrix, index of the column). The reference is to the second array, which
        holds the product. Its index is also that of entry i of the stored column in the first array. KeyError is raised
        for a column that is not stored.
        """
        return Factor(self._names[1], i * self._stride + self._column_of[column])

    def _column_entries(self, column: tuple[str, int]) -> slice:
        """Return the slice of the array that holds one stored column: (name of the matrix, index of the column)."""
        return slice(self._column_of[column], None, self._stride)


def _covariance_derivative_factors(n: int) -> list[list[Factor]]:
    """Return the matrix L (n, n) of the module, as references to entries of the array ``bar``.

    L is twice the symmetric matrix of derivatives of the log-likelihood by the covariance. ``bar`` has the n
    derivatives by the mean, followed by those by the upper triangle of the covariance. As a derivative by an element of
    the triangle counts two elements of the covariance, only entries on the diagonal of L are doubled.
    """
    place = np.zeros((n, n), int)
    above = np.triu_indices(n)
    place[above] = place.T[above] = n + np.arange(above[0].size)
    return [[Factor("bar", int(place[i, j]), i == j) for j in range(n)] for i in range(n)]


def _adjoint_of_series(A: Any, Phi: Any, T: Any) -> Any:
    """Return the derivatives (n, n) of the log-likelihood by the matrix A, restricted to the nonzero entries of A.

    Parameters
    ----------
    A : SX (n, n)
        Matrix of which two others are polynomials: T = 2 I + 2 A + A^2 and Phi = T - I + A^2 + 4/3 A^3, with the
        identity I.
    Phi, T : SX (n, n)
        Derivatives of the log-likelihood by the matrices Phi and T.
    """
    A2, T = A @ A, T + Phi  # only the sparsity pattern of A2 is used
    right, left = (_restricted_to_pattern(A2, 4 / 3 * product) for product in (Phi @ A.T, A.T @ Phi))
    square = _restricted_to_pattern(A2, T + Phi)
    return _restricted_to_pattern(A, 2 * T + (square + right) @ A.T + A.T @ (square + right + left))


def _replace_tape_values(g: EkfGraphs, both: Any, early: Any, late: Any) -> tuple[Any, Any, Any]:
    """Collect the values that an adjoint reads from the forward pass, and replace its slow operations by such values.

    The values are the entries of the filter state that the adjoint contains, and the results of slow operations (such
    as sin and exp) that the forward pass has computed already.

    Only the entries of the state on which the adjoint depends are stored. In a filter these are less than half of the
    entries. Storing all of them would make the forward pass a sixth slower by memory traffic alone.

    Parameters
    ----------
    g : EkfGraphs
        Expressions of the filter.
    both : SX column
        Expressions of the adjoint: derivatives by the filter state, followed by those by the parameters.
    early : SX column
        Symbols in ``both``, besides those of ``g.inputs``, that are known in the forward pass.
    late : SX column
        Symbols in ``both`` that are known only in the backward pass.

    Returns
    -------
    tuple[SX, SX, SX]
        ``both`` with symbols in place of slow operations; a column of all symbols whose values the forward pass must
        store; a column of the expressions of these values.
    """
    known_forward = ca.vertcat(*[v for name, v in g.inputs.items() if name != "p"], early)
    both, symbols, values = replace_slow_operations(both, g.p, known_forward, late)
    kept = [entry for entry, used in zip(ca.vertsplit(g.s), ca.which_depends(both, g.s), strict=True) if used]
    return both, *(ca.vertcat(ca.SX(0, 1), *kept, *more) for more in (symbols, values))


def _doubled_diagonal(upper: Any) -> Any:
    """Return the matrix ``upper`` (n, n) with its diagonal doubled.

    If ``upper`` is the symmetric matrix of derivatives by the entries of the upper triangle of a covariance, the result
    is the matrix L of the module: twice the derivatives by all entries of the covariance.
    """
    return upper + ca.diag(ca.diag(upper))


def _is_constant(matrix: Any) -> bool:
    """Return whether all entries of a CasADi matrix are numbers, so that none depends on a symbol.

    Structural zeros count as numbers, so that the result is True for a matrix without nonzero entries.
    """
    return all(entry.is_constant() for entry in matrix.nonzeros())


def _restricted_to_pattern(pattern: Any, matrix: Any) -> Any:
    """Return ``matrix`` without the entries where the sparse matrix ``pattern`` (same shape) has no entry.

    An entry that only ``pattern`` has becomes zero in the result. The values of ``pattern`` do not matter.
    """
    return ca.project(matrix, pattern.sparsity())
