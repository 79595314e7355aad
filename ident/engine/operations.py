"""CasADi's scalar operations as LLVM instructions.

In a template ``{T}`` is the type (double or a vector of them), ``{S}`` its name in intrinsics, ``{F}`` the
floating-point flags and ``{0}``, ``{1}`` the operands.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca

# `nnan` is never among the flags: a parameter vector that makes the filter diverge must give NaN.
STRICT = "contract nsz arcp"
FAST = STRICT + " reassoc"


def _templates() -> dict[int, str]:
    table = {
        ca.OP_ADD: "fadd {F} {T} {0}, {1}",
        ca.OP_SUB: "fsub {F} {T} {0}, {1}",
        ca.OP_MUL: "fmul {F} {T} {0}, {1}",
        ca.OP_SQ: "fmul {F} {T} {0}, {0}",
        ca.OP_TWICE: "fadd {F} {T} {0}, {0}",
        ca.OP_NEG: "fneg {T} {0}",
        ca.OP_FMOD: "frem {T} {0}, {1}",
    }
    one = "sqrt exp fabs floor ceil tan asin acos atan sinh cosh tanh"
    two = "pow constpow copysign atan2 fmin fmax"
    renamed = {"constpow": "pow", "fmin": "minnum", "fmax": "maxnum"}
    for operands, names in (("{0}", one), ("{0}, {T} {1}", two)):
        for name in names.split():
            intrinsic = renamed.get(name, name)
            table[getattr(ca, "OP_" + name.upper())] = f"call {{T}} @llvm.{intrinsic}.{{S}}({{T}} {operands})"
    return table


TEMPLATES = _templates()
COMPARISONS = {ca.OP_LT: "olt", ca.OP_LE: "ole", ca.OP_EQ: "oeq", ca.OP_NE: "une"}
LIBRARY = {
    getattr(ca, "OP_" + name.upper()): name
    for name in ["asinh", "acosh", "atanh", "erf", "log1p", "expm1", "hypot", "remainder"]
}


@cache
def rewritten() -> dict[int, Any]:
    """Operations that are replaced by expressions of others, as functions of x and y."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    table = {
        ca.OP_SIGN: (x > 0) - (x < 0),
        ca.OP_NOT: x == 0,
        ca.OP_AND: (x != 0) * (y != 0),
        ca.OP_OR: (x != 0) + (y != 0) > 0,
    }
    return {code: ca.Function("f", [x, y], [ca.cse(expression)]) for code, expression in table.items()}
