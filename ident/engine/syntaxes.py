"""How plain Python, C99 and CasADi's Python write a scalar operation."""

from __future__ import annotations

import math

import casadi as ca

from ident.engine.lines import ATOM, PRODUCT, SUM, UNARY, Syntax

# One argument or two, named alike in math (Python), math.h (C99) and CasADi.
SHARED = (
    "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "sqrt", "exp",
    "log", "log1p", "expm1", "erf",
)
SHARED_TWO = ["atan2", "hypot", "fmod", "remainder", "copysign"]
Templates = dict[int, tuple[str, int]]


def _arithmetic() -> Templates:
    return {
        ca.OP_ADD: ("{0} + {1}", SUM), ca.OP_SUB: ("{0} - {1}", SUM), ca.OP_MUL: ("{0} * {1}", PRODUCT),
        ca.OP_DIV: ("{0} / {1}", PRODUCT), ca.OP_NEG: ("-{0}", UNARY), ca.OP_TWICE: ("2.0 * {0}", PRODUCT),
        ca.OP_INV: ("1.0 / {0}", PRODUCT), ca.OP_SQ: ("{0} * {0}", PRODUCT),
    }


def _functions(prefix: str) -> Templates:
    one = {getattr(ca, "OP_" + n.upper()): (f"{prefix}{n}({{0}})", ATOM) for n in SHARED}
    return one | {getattr(ca, "OP_" + n.upper()): (f"{prefix}{n}({{0}}, {{1}})", ATOM) for n in SHARED_TWO}


def _truth(template: str, both: str, either: str) -> Templates:
    """Comparisons, whose values are 0 and 1; ``template`` makes a number of a condition."""
    relations = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!="}
    table = {code: (template.format(f"{{0}} {sign} {{1}}"), ATOM) for code, sign in relations.items()}
    return table | {
        ca.OP_NOT: (template.format("{0} == 0.0"), ATOM),
        ca.OP_AND: (template.format(f"{{0}} != 0.0 {both} {{1}} != 0.0"), ATOM),
        ca.OP_OR: (template.format(f"{{0}} != 0.0 {either} {{1}} != 0.0"), ATOM),
    }


def _number(value: float, infinite: str, nan: str) -> str:
    if math.isnan(value):
        return nan
    return repr(value) if math.isfinite(value) else infinite if value > 0 else f"-{infinite}"


PYTHON = Syntax(
    _arithmetic() | _functions("") | _truth("float({0})", "and", "or") | {
        ca.OP_POW: ("pow({0}, {1})", ATOM), ca.OP_CONSTPOW: ("pow({0}, {1})", ATOM),
        ca.OP_FABS: ("abs({0})", ATOM), ca.OP_FMIN: ("min({0}, {1})", ATOM), ca.OP_FMAX: ("max({0}, {1})", ATOM),
        ca.OP_FLOOR: ("float(floor({0}))", ATOM), ca.OP_CEIL: ("float(ceil({0}))", ATOM),
        ca.OP_SIGN: ("float(({0} > 0.0) - ({0} < 0.0))", ATOM), ca.OP_IF_ELSE_ZERO: ("({1} if {0} else 0.0)", ATOM),
    },
    lambda value: _number(value, "inf", "nan"),
)
C = Syntax(
    _arithmetic() | _functions("") | _truth("(double)({0})", "&&", "||") | {
        ca.OP_POW: ("pow({0}, {1})", ATOM), ca.OP_CONSTPOW: ("pow({0}, {1})", ATOM),
        ca.OP_FABS: ("fabs({0})", ATOM), ca.OP_FMIN: ("fmin({0}, {1})", ATOM), ca.OP_FMAX: ("fmax({0}, {1})", ATOM),
        ca.OP_FLOOR: ("floor({0})", ATOM), ca.OP_CEIL: ("ceil({0})", ATOM),
        ca.OP_SIGN: ("(double)(({0} > 0.0) - ({0} < 0.0))", ATOM),
        ca.OP_IF_ELSE_ZERO: ("(({0}) != 0.0 ? ({1}) : 0.0)", ATOM),
    },
    lambda value: _number(value, "INFINITY", "NAN"),
    "const double {name} = {value};",
)
CASADI = Syntax(
    _arithmetic() | _functions("ca.") | _truth("({0})", "", "") | {
        ca.OP_NOT: ("ca.logic_not({0})", ATOM), ca.OP_AND: ("ca.logic_and({0}, {1})", ATOM),
        ca.OP_OR: ("ca.logic_or({0}, {1})", ATOM),
        ca.OP_POW: ("ca.power({0}, {1})", ATOM), ca.OP_CONSTPOW: ("ca.power({0}, {1})", ATOM),
        ca.OP_FABS: ("ca.fabs({0})", ATOM), ca.OP_FMIN: ("ca.fmin({0}, {1})", ATOM),
        ca.OP_FMAX: ("ca.fmax({0}, {1})", ATOM), ca.OP_FLOOR: ("ca.floor({0})", ATOM),
        ca.OP_CEIL: ("ca.ceil({0})", ATOM), ca.OP_SIGN: ("ca.sign({0})", ATOM),
        ca.OP_IF_ELSE_ZERO: ("ca.if_else({0}, {1}, 0.0)", ATOM),
    },
    lambda value: _number(value, "ca.inf", "ca.nan"),
)
