"""Reverse differentiation of CasADi expressions, with fewer products than CasADi's own.

``x / y`` is taken as ``x r`` with ``r = 1 / y``, as the kernels compute it: what all quotients by one y say of r is
added up before it goes on to y, which takes one product a quotient and not two. And ``x |x|`` has the slope ``2 |x|``.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca

from ident.engine.walk import operation, walk

LEAF = -1  # no operation: a symbol or a number


def reverse(expression: Any, by: Any, weight: Any) -> Any:
    """``weight'`` times the derivative of a column by the symbols ``by``, as a column."""
    others = [v for v in ca.symvar(expression) if not any(ca.which_depends(v, by))]
    given = (by, ca.vertcat(ca.SX(0, 1), *others))
    f = ca.Function("f", given, [ca.densify(ca.cse(expression))])
    sweep = _Sweep()
    leaves = [[sweep.leaf(v) for v in ca.vertsplit(part)] if part.numel() else [] for part in given]
    (ends,) = walk(f, lambda i, j: leaves[i][j], lambda x: sweep.leaf(ca.SX(x)), sweep.node)
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
