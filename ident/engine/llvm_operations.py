"""CasADi's scalar operations as instructions of LLVM IR, the intermediate code of the compiler LLVM.

In a template of an instruction, ``{T}`` is the type (double or a vector of doubles), ``{S}`` its name in intrinsics,
``{F}`` the floating-point flags, and ``{0}`` and ``{1}`` the operands.
"""

from __future__ import annotations

import platform
from functools import cache
from typing import Any, NamedTuple

import casadi as ca

# `nnan` is never among the flags: a parameter vector that makes the filter diverge must give NaN.
STRICT = "contract nsz arcp"
FAST = STRICT + " reassoc"


class FlushToZero(NamedTuple):
    """Lines of LLVM IR with which a kernel treats numbers of a size below the smallest normal number (2e-308) as zero.

    All fields are empty on a processor for which these instructions are not known.

    Attributes
    ----------
    declared : tuple[str, ...]
        Lines of LLVM IR that declare the intrinsics in the module.
    first, last : tuple[str, ...]
        Lines of LLVM IR at the start of the kernel, which set the processor's mode, and at its end, which restore it.

    Notes
    -----
    A processor takes a hundred cycles for each subnormal number. Covariances that decay, for example of a
    biased sensor, stay in this range permanently. Without these instructions, filters were four to ten times slower on
    quiet data.
    """

    declared: tuple[str, ...] = ()
    first: tuple[str, ...] = ()
    last: tuple[str, ...] = ()


FTZ_DAZ, FZ = 0x8040, 1 << 24  # bits of the control registers MXCSR and FPCR
_X86 = FlushToZero(
    ("declare void @llvm.x86.sse.stmxcsr(ptr)", "declare void @llvm.x86.sse.ldmxcsr(ptr)"),
    ("%csr.before = alloca i32", "%csr.here = alloca i32", "call void @llvm.x86.sse.stmxcsr(ptr %csr.before)",
     "%csr = load i32, ptr %csr.before", f"%csr.flush = or i32 %csr, {FTZ_DAZ}",
     "store i32 %csr.flush, ptr %csr.here", "call void @llvm.x86.sse.ldmxcsr(ptr %csr.here)"),
    ("call void @llvm.x86.sse.ldmxcsr(ptr %csr.before)",),
)  # fmt: skip
_ARM = FlushToZero(
    ("declare i64 @llvm.aarch64.get.fpcr()", "declare void @llvm.aarch64.set.fpcr(i64)"),
    ("%csr = call i64 @llvm.aarch64.get.fpcr()", f"%csr.flush = or i64 %csr, {FZ}",
     "call void @llvm.aarch64.set.fpcr(i64 %csr.flush)"),
    ("call void @llvm.aarch64.set.fpcr(i64 %csr)",),
)  # fmt: skip
FLUSH_TO_ZERO = {"x86_64": _X86, "AMD64": _X86, "aarch64": _ARM, "arm64": _ARM}.get(platform.machine(), FlushToZero())


def _operation_templates() -> dict[int, str]:
    """Return the templates of LLVM instructions, by operation, for operations that LLVM has itself.

    A key is CasADi's code of the operation, such as ``casadi.OP_ADD``. A value is the text of an instruction or of the
    call of an intrinsic, with fields in braces for type and operands, which the module explains.
    """
    table = {
        ca.OP_ADD: "fadd {F} {T} {0}, {1}",
        ca.OP_SUB: "fsub {F} {T} {0}, {1}",
        ca.OP_MUL: "fmul {F} {T} {0}, {1}",
        ca.OP_SQ: "fmul {F} {T} {0}, {0}",
        ca.OP_TWICE: "fadd {F} {T} {0}, {0}",
        ca.OP_NEG: "fneg {T} {0}",
        ca.OP_FMOD: "frem {T} {0}, {1}",
    }
    unary = "sqrt exp log fabs floor ceil tan asin acos atan sinh cosh tanh"
    binary = "pow constpow copysign atan2 fmin fmax"
    renamed = {"constpow": "pow", "fmin": "minnum", "fmax": "maxnum"}
    for operands, names in (("{0}", unary), ("{0}, {T} {1}", binary)):
        for name in names.split():
            intrinsic = renamed.get(name, name)
            table[getattr(ca, "OP_" + name.upper())] = f"call {{T}} @llvm.{intrinsic}.{{S}}({{T}} {operands})"
    return table


TEMPLATES = _operation_templates()
COMPARISONS = {ca.OP_LT: "olt", ca.OP_LE: "ole", ca.OP_EQ: "oeq", ca.OP_NE: "une"}
LIBRARY = {
    getattr(ca, "OP_" + name.upper()): name
    for name in ["asinh", "acosh", "atanh", "erf", "log1p", "expm1", "hypot", "remainder"]
}


_SLOW = "sin cos tan asin acos atan atan2 sinh cosh tanh asinh acosh atanh exp expm1 log log1p erf pow constpow hypot"
# Operations that take longer to repeat than to read from memory
SLOW = frozenset(getattr(ca, "OP_" + name.upper()) for name in _SLOW.split())


@cache
def rewritten() -> dict[int, Any]:
    """Return expressions that replace certain operations by simpler ones: for sin, cos, sign, not, and, or.

    A key is CasADi's code of the operation. A value is a CasADi function of the operands (x, y) that returns the result
    of the operation; y is not used if the operation has one operand. Sine and cosine are accurate for |x| below 1e5.
    """
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    sine, cosine = _sine_and_cosine(x)
    table = {
        ca.OP_SIN: sine,
        ca.OP_COS: cosine,
        ca.OP_SIGN: (x > 0) - (x < 0),
        ca.OP_NOT: x == 0,
        ca.OP_AND: (x != 0) * (y != 0),
        ca.OP_OR: (x != 0) + (y != 0) > 0,
    }
    return {code: ca.Function("f", [x, y], [ca.cse(expression)]) for code, expression in table.items()}


def _sine_and_cosine(x: Any) -> tuple[Any, Any]:
    """Return CasADi expressions of the sine and the cosine of x [rad], accurate for |x| below 1e5.

    The argument is reduced to -pi/4 to pi/4 by subtraction of a multiple k of pi/2, which is represented by three
    numbers for accuracy. The products of k and the first two are exact on processors without fused multiplication, too,
    since these numbers have 33 bits and k has at most 17. The polynomials are those of the C library fdlibm.
    """
    k = ca.floor(x * 0.6366197723675814 + 0.5)
    r = x - k * 1.57079632673412561417 - k * 6.07710050630396597660e-11 - k * 2.02226624879595063154e-21
    z = r * r
    s = r + r * z * ca.polyval(
        [
            1.58969099521155010221e-10,
            -2.50507602534068634195e-08,
            2.75573137070700676789e-06,
            -1.98412698298579493134e-04,
            8.33333333332248946124e-03,
            -1.66666666666666324348e-01,
        ],
        z,
    )
    c = (
        1
        - z / 2
        + z
        * z
        * ca.polyval(
            [
                -1.13596475577881948265e-11,
                2.08757232129817482790e-09,
                -2.75573143513906633035e-07,
                2.48015872894767294178e-05,
                -1.38888888888741095749e-03,
                4.16666666666666019037e-02,
            ],
            z,
        )
    )
    quarter = k - 4 * ca.floor(k / 4)  # quarter turns, 0 to 3
    odd = ca.fabs(quarter - 2) == 1
    sine = ca.if_else(odd, c, s) * (1 - 2 * (quarter > 1.5))
    cosine = ca.if_else(odd, s, c) * (1 - 2 * (ca.fabs(quarter - 1.5) < 1))
    return sine, cosine
