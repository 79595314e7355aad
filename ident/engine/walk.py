"""Expressions gone through operation by operation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import casadi as ca

T = TypeVar("T")


def walk(f: Any, argument: Callable[[int, int], T], constant: Callable[[float], T], apply: Callable[..., T],
         done: Callable[[int, int, T], None] | None = None) -> list[list[T]]:
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

    return ca.vertcat(ca.SX(0, 1), *walk(f, lambda _, j: given[j], ca.SX, apply)[0])


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
