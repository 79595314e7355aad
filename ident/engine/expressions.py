"""Operations on CasADi expressions: evaluation in any algebra, simplification and reverse-mode differentiation."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

import casadi as ca

LEAF = -1  # code of a node without an operation: a symbol or a number
T = TypeVar("T")


def evaluate_instructions(
    f: Any,
    argument: Callable[[int, int], T],
    constant: Callable[[float], T],
    apply: Callable[..., T],
    done: Callable[[int, int, T], None] | None = None,
) -> list[list[T]]:
    """Evaluate an SX function, instruction by instruction, with values of any type T.

    The callbacks define what a number and an operation mean. For example, T can be a CasADi expression, a node of a
    graph, or a line of generated code.

    Parameters
    ----------
    f : casadi.Function
        Function of SX expressions. i and j below count its arguments, its results and their entries from zero. Of a
        sparse argument or result, only the nonzero entries count.
    argument : Callable[[int, int], T]
        ``argument(i, j)`` returns the value of entry j of argument i.
    constant : Callable[[float], T]
        ``constant(x)`` returns the value that represents the number x.
    apply : Callable[..., T]
        ``apply(code, *x)`` returns the result of the operation with CasADi's ``code`` (such as ``casadi.OP_ADD``) on
        the one or two operands x.
    done : Callable[[int, int, T], None], optional
        ``done(i, j, x)`` is called as soon as entry j of result i has its value x.

    Returns
    -------
    list[list[T]]
        Element [i][j] is the value of entry j of result i. Entries that the function does not compute are
        ``constant(0.0)``.
    """
    work: dict[int, T] = {}
    results = [[constant(0.0)] * f.nnz_out(i) for i in range(f.n_out())]
    for k in range(f.n_instructions()):
        code, i, o = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if code == ca.OP_INPUT:
            work[o[0]] = argument(i[0], i[1])
        elif code == ca.OP_OUTPUT:
            results[o[0]][o[1]] = work[i[0]]
            if done:
                done(o[0], o[1], work[i[0]])
        elif code == ca.OP_CONST:
            work[o[0]] = constant(f.instruction_constant(k))
        else:
            work[o[0]] = apply(code, *[work[j] for j in i])
    return results


def operation(code: int, *x: Any) -> Any:
    """Return the CasADi expression of one operation on one or two expressions.

    Parameters
    ----------
    code : int
        CasADi's code of the operation, such as ``casadi.OP_ADD``.
    *x : SX
        One operand or two operands.
    """
    return (ca.SX.unary if len(x) == 1 else ca.SX.binary)(code, *x)


def simplified(expression: Any) -> Any:
    """Return a column (n, 1) of SX expressions in a form in which drag terms take few operations.

    ``x sign(x)`` becomes ``|x|``, and ``(a |x|) x`` becomes ``a (x |x|)``. The values do not change, except for
    rounding. The result is dense, and equal subexpressions are computed once.

    Notes
    -----
    Drag and its derivatives are half of many models. The derivatives of the new form have half as many products.
    """
    symbols = ca.vertcat(ca.SX(0, 1), *ca.symvar(expression))
    f = ca.Function("f", [symbols], [ca.densify(ca.cse(expression))])

    def apply(code: int, *x: Any) -> Any:
        """Return the expression of the operation ``code`` on the operands ``x``; products are simplified."""
        return _simplified_product(*x) if code == ca.OP_MUL else operation(code, *x)

    return ca.vertcat(ca.SX(0, 1), *evaluate_instructions(f, lambda _, j: symbols[j], ca.SX, apply)[0])


def _simplified_product(a: Any, b: Any) -> Any:
    """Return the product a b of two scalar expressions, simplified if it contains x |x| or x sign(x).

    ``x sign(x)`` becomes |x|. If one of them is inside a product, it is moved beside the other: ``(c |x|) x`` becomes
    ``c (x |x|)``. Other products are returned as a b.
    """
    for first, second in ((a, b), (b, a)):
        if _is_modulus_or_sign(first, second):
            return ca.fabs(second) if first.is_op(ca.OP_SIGN) else first * second
        if first.is_op(ca.OP_MUL):
            for factor, rest in ((first.dep(0), first.dep(1)), (first.dep(1), first.dep(0))):
                if _is_modulus_or_sign(factor, second) or _is_modulus_or_sign(second, factor):
                    return rest * _simplified_product(factor, second)
    return a * b


def _is_modulus_or_sign(y: Any, x: Any) -> bool:
    """Return whether the expression y is the modulus or the sign of the expression x, and x is structurally the same.

    An expression that is only mathematically equal to x does not count.
    """
    return (y.is_op(ca.OP_FABS) or y.is_op(ca.OP_SIGN)) and ca.is_equal(y.dep(0), x)


def reverse_mode(expression: Any, by: Any, weight: Any) -> Any:
    """Return ``weight'`` times the derivative of a column by the symbols ``by``, computed in reverse mode.

    Parameters
    ----------
    expression : SX (n, 1)
        Column to differentiate. It may contain symbols outside ``by``, which count as constants.
    by : SX (m, 1)
        Symbols to differentiate by.
    weight : SX (n, 1)
        Weights of the entries of the column.

    Returns
    -------
    SX (m, 1)
        Entry j is the sum over i of ``weight[i]`` times the derivative of entry i of the column by ``by[j]``. The
        derivative is zero for a symbol that the column does not contain.

    Notes
    -----
    The result has fewer products than CasADi's own derivative. ``x / y`` is differentiated as ``x r`` with
    ``r = 1 / y``, which is how the kernels compute it. The derivatives by r of all quotients with the same y are added
    before they pass on to y. Each quotient then takes one product instead of two. The derivative of ``x |x|`` is
    ``2 |x|``.
    """
    other_symbols = [v for v in ca.symvar(expression) if not any(ca.which_depends(v, by))]
    arguments = (by, ca.vertcat(ca.SX(0, 1), *other_symbols))
    f = ca.Function("f", arguments, [ca.densify(ca.cse(expression))])
    sweep = _ReverseSweep()
    leaves = [[sweep.add_leaf(v) for v in ca.vertsplit(part)] if part.numel() else [] for part in arguments]
    (ends,) = evaluate_instructions(
        f, lambda i, j: leaves[i][j], lambda x: sweep.add_leaf(ca.SX(x)), sweep.add_operation
    )
    for end, derivative in zip(ends, ca.vertsplit(weight), strict=True):
        sweep.add_derivative(end, derivative)
    sweep.propagate_backwards()
    return ca.vertcat(*[sweep.derivatives[leaf] for leaf in leaves[0]])


class _ReverseSweep:
    """Graph of an expression for its differentiation in reverse mode. A node is a symbol, a number or an operation.

    Nodes are added in the order of evaluation, so that the operands of a node come before it. A node is identified by
    its index in this order. The result to differentiate is a weighted sum of nodes.

    Attributes
    ----------
    values : list[SX]
        Expression of each node.
    derivatives : list[SX]
        Derivative of the weighted sum by each node; zero until `add_derivative` or `propagate_backwards` adds to it.
    """

    def __init__(self) -> None:
        """Create a graph without nodes."""
        self.values: list[Any] = []
        self.derivatives: list[Any] = []
        # code of the operation and indices of the operands, for each node
        self._operations: list[tuple[int, tuple[int, ...]]] = []
        self._reciprocals: dict[int, int] = {}  # index of the node 1 / y, by the index of the node y

    def add_leaf(self, value: Any) -> int:
        """Append a node for the symbol or number ``value``. Return its index. An equal value gets another node."""
        return self._append(value, LEAF)

    def add_operation(self, code: int, *operands: int) -> int:
        """Append a node for an operation on the nodes with the indices ``operands``. Return the index of the node.

        ``code`` is CasADi's code of the operation, such as ``casadi.OP_ADD``.

        A quotient x / y becomes a product of x and a node 1 / y. All quotients by the same y share one node 1 / y. For
        a repeated reciprocal, no node is appended, and the index of the earlier node is returned.
        """
        if code == ca.OP_DIV:
            return self.add_operation(ca.OP_MUL, operands[0], self.add_operation(ca.OP_INV, operands[1]))
        if code == ca.OP_INV:
            y = operands[0]
            if y not in self._reciprocals:
                self._reciprocals[y] = self._append(1 / self.values[y], code, y)
            return self._reciprocals[y]
        return self._append(operation(code, *[self.values[j] for j in operands]), code, *operands)

    def _append(self, value: Any, code: int, *operands: int) -> int:
        """Append a node with this expression ``value``, operation code and operands. Return the index of the node."""
        self.values.append(value)
        self.derivatives.append(ca.SX(0))
        self._operations.append((code, operands))
        return len(self.values) - 1

    def add_derivative(self, node: int, derivative: Any) -> None:
        """Add the expression ``derivative`` to the derivative of the weighted sum by the node with index ``node``."""
        self.derivatives[node] = self.derivatives[node] + derivative

    def propagate_backwards(self) -> None:
        """Apply the chain rule from the last node to the first, which completes ``derivatives`` in place.

        The weights of the sum must have been added to the derivatives of its nodes before. A second call would add all
        contributions again.
        """
        for node in range(len(self.values) - 1, -1, -1):
            derivative = self.derivatives[node]
            if self._operations[node][0] != LEAF and not derivative.is_zero():
                for operand, slope in self._operand_derivatives(node):
                    self.add_derivative(operand, derivative * slope)

    def _operand_derivatives(self, node: int) -> list[tuple[int, Any]]:
        """Return a pair (index of the operand, derivative of the node by this operand) for each operand of a node.

        For the product ``x |x|``, the only pair is (index of x, 2 |x|): |x| then needs no derivative of its own.
        """
        code, operands = self._operations[node]
        x, value = [self.values[j] for j in operands], self.values[node]
        if code == ca.OP_INV:
            return [(operands[0], -value * value)]
        if code == ca.OP_MUL:
            for a, b in ((0, 1), (1, 0)):
                if self._operations[operands[a]] == (ca.OP_FABS, (operands[b],)):
                    return [(operands[b], 2 * x[a])]
        return list(zip(operands, _operation_derivatives(code, len(x)).call(x), strict=True))


@cache
def _operation_derivatives(code: int, n: int) -> Any:
    """Return a CasADi function that maps the n operands of an operation to its n partial derivatives.

    ``code`` is CasADi's code of the operation, and n is 1 or 2.
    """
    x = [ca.SX.sym(name) for name in "xy"[:n]]
    return ca.Function("slopes", x, [ca.densify(ca.jacobian(operation(code, *x), v)) for v in x])
