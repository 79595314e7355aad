"""Sine, cosine and logarithm written out as LLVM instructions, on the bits of a number where that is shorter.

A call of the library would have every register saved and loaded again, and knows no vectors. Reductions rely on the
order of their operations, so that these are not flagged as associative.
"""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, Any

import casadi as ca

from ident.engine.operations import FAST, STRICT

if TYPE_CHECKING:
    from ident.engine.emitter import Emitter, Value

ROUNDS = 1.5 * 2.0**52  # added to a number, it leaves the nearest whole number in the last bits
ROOT_HALF = 0x3FE6A09E667F3BCD  # bits of sqrt(1/2)
TINY = 2.2250738585072014e-308  # the least number with all its digits


def sine(emit: Emitter, x: Value, literal: Any, *, quarter: int = 0) -> Value:
    """sin(x + quarter pi / 2), for |x| below 1e5; NaN remains NaN."""
    bits, as_is = _bits(emit, x)
    emit.flags = STRICT
    quarters = emit._op("fmul {F} {T} {0}, {1}", x, literal(2 / math.pi))
    whole = emit._op("fadd {F} {T} {0}, {1}", quarters, literal(ROUNDS))
    k = emit._op("fsub {F} {T} {0}, {1}", whole, literal(ROUNDS))
    s, c = (found[0] for found in emit._inline(_reduced(), lambda i, j: (x, k)[i]))
    emit.flags = FAST
    turns = emit._op(f"bitcast {{T}} {{0}} to {bits}", whole).text
    if quarter:
        turns = emit._op(f"add {bits} {turns}, {_number(x, quarter)}", **as_is).text
    last = emit._op(f"trunc {bits} {turns} to {_type(emit, x, 'i1')}", **as_is).text
    found = emit._op(f"select {_type(emit, x, 'i1')} {last}, {{T}} {{0}}, {{T}} {{1}}", c, s, **as_is)
    second = emit._op(f"and {bits} {turns}, {_number(x, 2)}", **as_is).text
    sign = emit._op(f"shl {bits} {second}, {_number(x, 62)}", **as_is).text
    value = emit._op(f"bitcast {{T}} {{0}} to {bits}", found).text
    signed = emit._op(f"xor {bits} {value}, {sign}", **as_is).text
    return emit._op(f"bitcast {bits} {signed} to {{T}}", **as_is)


def logarithm(emit: Emitter, x: Value, literal: Any) -> Value:
    """ln x; below 2e-308 it is that of 0."""
    bits, as_is = _bits(emit, x)
    given = emit._op(f"bitcast {{T}} {{0}} to {bits}", x).text
    above = emit._op(f"sub {bits} {given}, {_number(x, ROOT_HALF)}", **as_is).text
    exponent = emit._op(f"ashr {bits} {above}, {_number(x, 52)}", **as_is).text
    shifted = emit._op(f"shl {bits} {exponent}, {_number(x, 52)}", **as_is).text
    rest = emit._op(f"sub {bits} {given}, {shifted}", **as_is).text
    mantissa = emit._op(f"bitcast {bits} {rest} to {{T}}", **as_is)
    power = emit._op(f"sitofp {bits} {exponent} to {{T}}", **as_is)
    emit.flags = STRICT
    found = emit._inline(_log_of_parts(), lambda i, j: (mantissa, power)[i])[0][0]
    emit.flags = FAST
    for comparison, limit, instead in (("olt", TINY, literal(-math.inf)), ("olt", 0.0, literal(math.nan)),
                                       ("ueq", math.inf, x)):
        c = emit._op(f"fcmp {comparison} {{T}} {{0}}, {{1}}", x, literal(limit)).text
        found = emit._op(f"select {_type(emit, x, 'i1')} {c}, {{T}} {{0}}, {{T}} {{1}}", instead, found, **as_is)
    return found


def _bits(emit: Emitter, x: Value) -> tuple[str, dict[str, bool]]:
    """The type of the bits of x, and what an instruction on them alone has to be told."""
    return _type(emit, x, "i64"), {"vector": x.vector, "constant": x.constant}


def _type(emit: Emitter, x: Value, of: str) -> str:
    return f"<{emit.plan.width} x {of}>" if x.vector else of


def _number(x: Value, n: int) -> str:
    return f"splat (i64 {n})" if x.vector else str(n)


@cache
def _reduced() -> Any:
    """Sine and cosine of x less k quarter turns, which is between -pi/4 and pi/4, by fdlibm's k_sin.c and k_cos.c."""
    x, k = ca.SX.sym("x"), ca.SX.sym("k")
    r = x - k * 1.5707963267948966 - k * 6.123233995736766e-17
    z = r * r
    s = r + r * z * ca.polyval([
        1.58969099521155010221e-10, -2.50507602534068634195e-08, 2.75573137070700676789e-06,
        -1.98412698298579493134e-04, 8.33333333332248946124e-03, -1.66666666666666324348e-01], z)
    c = 1 - z / 2 + z * z * ca.polyval([
        -1.13596475577881948265e-11, 2.08757232129817482790e-09, -2.75573143513906633035e-07,
        2.48015872894767294178e-05, -1.38888888888741095749e-03, 4.16666666666666019037e-02], z)
    return ca.Function("reduced", [x, k], [s, c])


@cache
def _log_of_parts() -> Any:
    """ln(m 2^k) of a mantissa m between sqrt(1/2) and sqrt(2) and an exponent k: the polynomial of fdlibm's e_log.c."""
    m, k = ca.SX.sym("m"), ca.SX.sym("k")
    f = m - 1
    s = f / (2 + f)
    z = s * s
    w = z * z
    odd = w * ca.polyval([1.531383769920937332e-01, 2.222219843214978396e-01, 3.999999999940941908e-01], w)
    even = z * ca.polyval([1.479819860511658591e-01, 1.818357216161805012e-01, 2.857142874366239149e-01,
                           6.666666666666735130e-01], w)
    half = f * f / 2
    result = k * 6.93147180369123816490e-01 - ((half - (s * (half + odd + even) + k * 1.90821492927058770002e-10)) - f)
    return ca.Function("log", [m, k], [ca.cse(result)])
