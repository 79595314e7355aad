"""Operations on CasADi expressions: evaluation in any algebra, simplification and reverse-mode differentiation."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

import casadi as ca

LEAF = -1  # code of a node without an operation: a symbol or a number
T = TypeVar("T")


def instructions(
    f: Any,
    argument: Callable[[int, int], T],
    constant: Callable[[float], T],
    apply: Callable[..., T],
    done: Callable[[int, int, T], None] | None = None,
) -> list[list[T]]:
    """Evaluate an SX function, instruction by instruction, in any algebra.

    Parameters
    ----------
    f : casadi.Function
        Function of SX expressions.
    argument : Callable[[int, int], T]
        ``argument(i, j)`` returns entry j of argument i.
    constant : Callable[[float], T]
        Returns the value of a number.
    apply : Callable[..., T]
        ``apply(code, *x)`` returns the result of an operation.
    done : Callable[[int, int, T], None], optional
        ``done(i, j, x)`` is called as soon as entry j of result i has its value x.

    Returns
    -------
    list[list[T]]
        Entries of each result. Entries that the function does not compute are zero.
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
    """Return the expression of one operation on one or two operands."""
    return (ca.SX.unary if len(x) == 1 else ca.SX.binary)(code, *x)


def simplified(expression: Any) -> Any:
    """Return the same column with ``x sign(x)`` as ``|x|`` and ``(a |x|) x`` as ``a (x |x|)``.

    Notes
    -----
    Drag and its derivatives are half of many models. The derivatives of the new form have half as many products.
    """
    symbols = ca.vertcat(ca.SX(0, 1), *ca.symvar(expression))
    f = ca.Function("f", [symbols], [ca.densify(ca.cse(expression))])

    def apply(code: int, *x: Any) -> Any:
        return _product(*x) if code == ca.OP_MUL else operation(code, *x)

    return ca.vertcat(ca.SX(0, 1), *instructions(f, lambda _, j: symbols[j], ca.SX, apply)[0])


def _product(a: Any, b: Any) -> Any:
    """Return the product a b. Combine x with |x| or sign(x), also if the latter is a factor of the other operand."""
    for first, second in ((a, b), (b, a)):
        if _is_modulus_or_sign(first, second):
            return ca.fabs(second) if first.is_op(ca.OP_SIGN) else first * second
        if first.is_op(ca.OP_MUL):
            for factor, rest in ((first.dep(0), first.dep(1)), (first.dep(1), first.dep(0))):
                if _is_modulus_or_sign(factor, second) or _is_modulus_or_sign(second, factor):
                    return rest * _product(factor, second)
    return a * b


def _is_modulus_or_sign(y: Any, x: Any) -> bool:
    """Return whether y is |x| or sign(x)."""
    return (y.is_op(ca.OP_FABS) or y.is_op(ca.OP_SIGN)) and ca.is_equal(y.dep(0), x)


def reverse_mode(expression: Any, by: Any, weight: Any) -> Any:
    """Return ``weight'`` times the derivative of a column by the symbols ``by``, computed in reverse mode.

    Parameters
    ----------
    expression : SX (n, 1)
        Column to differentiate.
    by : SX (m, 1)
        Symbols.
    weight : SX (n, 1)
        Weights of the entries of the column.

    Returns
    -------
    SX (m, 1)
        Derivatives.

    Notes ----- The result has fewer products than CasADi's own derivative. ``x / y`` is differentiated as ``x r`` with
    ``r = 1 / y``, which is how the kernels compute it. The derivatives by r of all quotients with the same y are added
    before they pass on to y. Each quotient then takes one product instead of two. The derivative of ``x |x|`` is
    ``2 |x|``.
    """
    other_symbols = [v for v in ca.symvar(expression) if not any(ca.which_depends(v, by))]
    arguments = (by, ca.vertcat(ca.SX(0, 1), *other_symbols))
    f = ca.Function("f", arguments, [ca.densify(ca.cse(expression))])
    sweep = _Sweep()
    leaves = [[sweep.leaf(v) for v in ca.vertsplit(part)] if part.numel() else [] for part in arguments]
    (ends,) = instructions(f, lambda i, j: leaves[i][j], lambda x: sweep.leaf(ca.SX(x)), sweep.node)
    for end, bar in zip(ends, ca.vertsplit(weight), strict=True):
        sweep.add(end, bar)
    sweep.back()
    return ca.vertcat(*[sweep.bars[leaf] for leaf in leaves[0]])


class _Sweep:
    """Nodes of an expression in the order of evaluation, and the derivatives ``bars`` by them."""

    def __init__(self) -> None:
        self.values: list[Any] = []
        self.bars: list[Any] = []
        self._made: list[tuple[int, tuple[int, ...]]] = []  # code and operands
        self._inverses: dict[int, int] = {}

    def leaf(self, value: Any) -> int:
        """Append a symbol or a number. Return its index."""
        return self._append(value, LEAF)

    def node(self, code: int, *operands: int) -> int:
        """Append an operation on nodes and return its index. Quotients are split into a product and a shared
        reciprocal.
        """
        if code == ca.OP_DIV:
            return self.node(ca.OP_MUL, operands[0], self.node(ca.OP_INV, operands[1]))
        if code == ca.OP_INV:
            y = operands[0]
            if y not in self._inverses:
                self._inverses[y] = self._append(1 / self.values[y], code, y)
            return self._inverses[y]
        return self._append(operation(code, *[self.values[j] for j in operands]), code, *operands)

    def _append(self, value: Any, code: int, *operands: int) -> int:
        self.values.append(value)
        self.bars.append(ca.SX(0))
        self._made.append((code, operands))
        return len(self.values) - 1

    def add(self, place: int, bar: Any) -> None:
        """Add to the derivative by one node."""
        self.bars[place] = self.bars[place] + bar

    def back(self) -> None:
        """Propagate the derivatives from the last node to the first."""
        for place in range(len(self.values) - 1, -1, -1):
            bar = self.bars[place]
            if self._made[place][0] != LEAF and not bar.is_zero():
                for operand, slope in self._slopes(place):
                    self.add(operand, bar * slope)

    def _slopes(self, place: int) -> list[tuple[int, Any]]:
        """Return the operands of a node and the derivatives of the node by them."""
        code, operands = self._made[place]
        x, value = [self.values[j] for j in operands], self.values[place]
        if code == ca.OP_INV:
            return [(operands[0], -value * value)]
        if code == ca.OP_MUL:
            for a, b in ((0, 1), (1, 0)):
                if self._made[operands[a]] == (ca.OP_FABS, (operands[b],)):
                    return [(operands[b], 2 * x[a])]
        return list(zip(operands, _derivatives(code, len(x)).call(x), strict=True))


@cache
def _derivatives(code: int, n: int) -> Any:
    """Return the derivatives of an operation with n operands, as a function of the operands."""
    x = [ca.SX.sym(name) for name in "xy"[:n]]
    return ca.Function("slopes", x, [ca.densify(ca.jacobian(operation(code, *x), v)) for v in x])
