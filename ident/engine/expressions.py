"""CasADi expressions operation by operation: interpretation in any algebra, simplification, reverse differentiation."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

import casadi as ca

LEAF = -1  # no operation: a symbol or a number
T = TypeVar("T")


def instructions(
    f: Any,
    argument: Callable[[int, int], T],
    constant: Callable[[float], T],
    apply: Callable[..., T],
    done: Callable[[int, int, T], None] | None = None,
) -> list[list[T]]:
    """The results of an SX function in any algebra.

    ``argument(i, j)`` is entry j of argument i, ``apply(code, *x)`` an operation; ``done(i, j, x)`` is told of entry j
    of result i as soon as it is there. Entries that the function leaves out are zero.
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
    """The expression of an operation."""
    return (ca.SX.unary if len(x) == 1 else ca.SX.binary)(code, *x)


def simplified(expression: Any) -> Any:
    """The same column with ``x sign(x)`` as ``|x|`` and ``(a |x|) x`` as ``a (x |x|)``.

    Drag and its slopes are half of many models, and derivatives of the one form have half the products of the other's.
    """
    given = ca.vertcat(ca.SX(0, 1), *ca.symvar(expression))
    f = ca.Function("f", [given], [ca.densify(ca.cse(expression))])

    def apply(code: int, *x: Any) -> Any:
        return _product(*x) if code == ca.OP_MUL else operation(code, *x)

    return ca.vertcat(ca.SX(0, 1), *instructions(f, lambda _, j: given[j], ca.SX, apply)[0])


def _product(a: Any, b: Any) -> Any:
    for one, other in ((a, b), (b, a)):
        if _of(one, other):
            return ca.fabs(other) if one.is_op(ca.OP_SIGN) else one * other
        if one.is_op(ca.OP_MUL):
            for part, rest in ((one.dep(0), one.dep(1)), (one.dep(1), one.dep(0))):
                if _of(part, other) or _of(other, part):
                    return rest * _product(part, other)
    return a * b


def _of(y: Any, x: Any) -> bool:
    """Whether y is |x| or the sign of x."""
    return (y.is_op(ca.OP_FABS) or y.is_op(ca.OP_SIGN)) and ca.is_equal(y.dep(0), x)


def reverse_mode(expression: Any, by: Any, weight: Any) -> Any:
    """Reverse-mode derivative: ``weight'`` times the derivative of a column by the symbols ``by``, as a column.

    It takes fewer products than CasADi's own. ``x / y`` is taken as ``x r`` with ``r = 1 / y``, as the kernels compute
    it: what all quotients by one y say of r is added up before it goes on to y, which takes one product a quotient and
    not two. And ``x |x|`` has the slope ``2 |x|``.
    """
    others = [v for v in ca.symvar(expression) if not any(ca.which_depends(v, by))]
    given = (by, ca.vertcat(ca.SX(0, 1), *others))
    f = ca.Function("f", given, [ca.densify(ca.cse(expression))])
    sweep = _Sweep()
    leaves = [[sweep.leaf(v) for v in ca.vertsplit(part)] if part.numel() else [] for part in given]
    (ends,) = instructions(f, lambda i, j: leaves[i][j], lambda x: sweep.leaf(ca.SX(x)), sweep.node)
    for end, bar in zip(ends, ca.vertsplit(weight), strict=True):
        sweep.add(end, bar)
    sweep.back()
    return ca.vertcat(*[sweep.bars[leaf] for leaf in leaves[0]])


class _Sweep:
    """Nodes in the order of their values; ``bars`` are the slopes by them."""

    def __init__(self) -> None:
        self.values: list[Any] = []
        self.bars: list[Any] = []
        self._made: list[tuple[int, tuple[int, ...]]] = []  # code and operands
        self._inverses: dict[int, int] = {}

    def leaf(self, value: Any) -> int:
        return self._append(value, LEAF)

    def node(self, code: int, *operands: int) -> int:
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
        self.bars[place] = self.bars[place] + bar

    def back(self) -> None:
        """From the last node to the first."""
        for place in range(len(self.values) - 1, -1, -1):
            bar = self.bars[place]
            if self._made[place][0] != LEAF and not bar.is_zero():
                for operand, slope in self._slopes(place):
                    self.add(operand, bar * slope)

    def _slopes(self, place: int) -> list[tuple[int, Any]]:
        """Of a node: operands, and its slopes by them."""
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
    """The slopes of an operation of n operands, as a function of these."""
    x = [ca.SX.sym(name) for name in "xy"[:n]]
    return ca.Function("slopes", x, [ca.densify(ca.jacobian(operation(code, *x), v)) for v in x])
