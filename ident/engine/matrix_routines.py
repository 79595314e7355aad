"""Routines on matrices that the machine code of kernels calls: each is compiled once, for all models.

Most of the work of a filter and of its forward sensitivities is on the covariance and its derivatives. The routines
depend on the number of states and on the type of the numbers, and not on the model. A kernel that calls them has fewer
instructions, so that it is compiled sooner.

Most routines work on matrices of vectors. For the derivatives, a vector has the derivatives of one entry by several
parameters, one in each lane. For the covariance itself, it has neighbouring entries of a row.
"""

from __future__ import annotations

import threading
from functools import cache
from typing import Any

from seatrial.ident.engine import jit

FLAGS = "contract"  # a product and a sum may become one instruction
# Entries of a row of a matrix that are kept in registers at the same time; the processor has 32 or 16 registers
ROW_ENTRIES = 24 if jit.WIDTH == 8 else 12
COMBINE, ADD_PRODUCTS, ADD_TRANSPOSED = "combine", "add_products", "add_transposed"
ADD_OUTER_PRODUCT, TRANSPOSE, MIRROR = "add_outer_product", "transpose", "mirror"
COPY_TO_SINGLE, ADD_GRAM = "copy_to_single", "add_gram"
_lock = threading.Lock()


def routine_name(kind: str, n: int, width: int, number: str) -> str:
    """Return the name of a routine in machine code.

    Parameters
    ----------
    kind : str
        One of the constants of this module, such as ``combine``.
    n : int
        Number of columns of the matrices, in vectors; for ``transpose`` and ``mirror``, in numbers. For ``add_gram``,
        number of entries; for ``copy_to_single``, number of vectors.
    width : int
        Numbers in a vector; for ``transpose`` and ``mirror``, the distance from a row to the next.
    number : str
        LLVM's type of the numbers: ``float`` or ``double``.
    """
    return f"{kind}_{n}_{width}_{number}"


def declaration(kind: str, name: str) -> str:
    """Return the line of LLVM IR that declares a routine, which is of the kind ``kind`` and has the name ``name``."""
    return f"declare void @{name}({', '.join(argument.split()[0] for argument in _ARGUMENTS[kind])})"


@cache
def _compiled(name: str) -> tuple[Any, int]:
    """Compile a routine, or load it from the cache on disk, once per process; return its library and its address."""
    kind, n, width, number = name.rsplit("_", 3)
    return jit.load_machine_code(_WRITERS[kind](name, int(n), int(width), number), name, has_loops=True)


def address_of(name: str) -> int:
    """Return the address of a routine, which is compiled at the first call. ``name`` is that of `routine_name`.

    The routine stays in memory until the process ends.
    """
    with _lock:
        return _compiled(name)[1]


_ARGUMENTS = {
    COMBINE: (
        "ptr %lanes", "ptr %lines", "ptr %scalars", "ptr %matrix", "ptr %result", "i64 %row.step", "i64 %entry.step",
        "ptr %table", "i64 %rows",
    ),
    ADD_PRODUCTS: ("ptr %matrix", "ptr %lanes", "ptr %scalars"),
    ADD_TRANSPOSED: ("ptr %result", "ptr %matrix"),
    ADD_OUTER_PRODUCT: ("ptr %matrix", "ptr %column", "ptr %line", "i64 %rows"),
    TRANSPOSE: ("ptr %result", "ptr %matrix"),
    MIRROR: ("ptr %matrix",),
    COPY_TO_SINGLE: ("ptr %result", "ptr %matrix"),
    ADD_GRAM: ("ptr %left", "ptr %right", "ptr %result"),
}  # fmt: skip


def _definition(kind: str, name: str, lines: list[str]) -> str:
    """Return the text of a module that defines one routine with these lines of IR, the first of which is a label."""
    arguments = ", ".join(a.replace("ptr ", "ptr noalias ") for a in _ARGUMENTS[kind])
    return "\n".join([f"define void @{name}({arguments}) {jit.FRAME} {{", *lines, "ret void", "}", ""])


def _repeated(name: str, scalar: str, vector: str, width: int, number: str) -> list[str]:
    """Return lines of IR that repeat the scalar ``scalar`` in all elements of a vector with the name ``name``."""
    return [
        f"{name}.0 = insertelement {vector} poison, {number} {scalar}, i32 0",
        f"{name} = shufflevector {vector} {name}.0, {vector} poison, <{width} x i32> zeroinitializer",
    ]


def _product_added(name: str, vector: str, a: str, b: str, to: str) -> list[str]:
    """Return lines of IR that compute ``name = a b + to``, all of them vectors."""
    return [f"{name}.m = fmul {FLAGS} {vector} {a}, {b}", f"{name} = fadd {FLAGS} {vector} {to}, {name}.m"]


def _combine_ir(name: str, n: int, width: int, number: str) -> str:
    """Return the IR of the routine that combines rows of matrices linearly.

    Row r of the result is the sum of vectors of ``lanes`` times rows of numbers of ``lines``, and of numbers of
    ``scalars`` times rows of ``matrix``, which consist of vectors. For each row of the result ``table`` has the numbers
    of terms of both kinds, then the terms of the first kind, then those of the second kind. A term of the first kind
    has the index in ``lanes``, and the index in ``lines`` of the row's first number. A term of the second kind has the
    index in ``scalars``, and the number of the row of ``matrix``. Entry j of row r of the result is written to the
    entry ``r row.step + j entry.step``.
    """
    vector, align = f"<{width} x {number}>", 4 if number == "float" else 8
    lines = [
        "entry:",
        "br label %row",
        "row:",
        "%r = phi i64 [0, %entry], [%r.next, %row.end]",
        "%t = phi i64 [0, %entry], [%t.next, %row.end]",
        "%n1.p = getelementptr i32, ptr %table, i64 %t",
        "%n1.0 = load i32, ptr %n1.p, align 4",
        "%n1 = zext i32 %n1.0 to i64",
        "%n2.p = getelementptr i32, ptr %n1.p, i64 1",
        "%n2.0 = load i32, ptr %n2.p, align 4",
        "%n2 = zext i32 %n2.0 to i64",
        "%first = add i64 %t, 2",
        "%size1 = shl i64 %n1, 1",
        "%middle = add i64 %first, %size1",
        "%size2 = shl i64 %n2, 1",
        "%t.next = add i64 %middle, %size2",
        "%to = mul i64 %r, %row.step",
    ]
    before = "row"
    for start in range(0, n, ROW_ENTRIES):
        entries, b = range(start, min(start + ROW_ENTRIES, n)), f"{start}"
        lines += [f"br label %head1.{b}", f"head1.{b}:"]
        lines.append(f"%i.{b} = phi i64 [%first, %{before}], [%i.next.{b}, %body1.{b}]")
        lines += [f"%x{j} = phi {vector} [zeroinitializer, %{before}], [%x{j}.1, %body1.{b}]" for j in entries]
        lines += [
            f"%more1.{b} = icmp slt i64 %i.{b}, %middle",
            f"br i1 %more1.{b}, label %body1.{b}, label %head2.{b}",
            f"body1.{b}:",
            *_term_indices("i", b),
            *_loaded(f"%lane.{b}", vector, "%lanes", f"%i.{b}.a"),
            f"%line.{b} = getelementptr {number}, ptr %lines, i64 %i.{b}.b",
        ]
        for j in entries:
            lines += [
                *_loaded(f"%s{j}", number, f"%line.{b}", j),
                *_repeated(f"%v{j}", f"%s{j}", vector, width, number),
                *_product_added(f"%x{j}.1", vector, f"%lane.{b}", f"%v{j}", f"%x{j}"),
            ]
        lines += [f"br label %head1.{b}", f"head2.{b}:"]
        lines.append(f"%k.{b} = phi i64 [%middle, %head1.{b}], [%k.next.{b}, %body2.{b}]")
        lines += [f"%y{j} = phi {vector} [%x{j}, %head1.{b}], [%y{j}.1, %body2.{b}]" for j in entries]
        lines += [
            f"%more2.{b} = icmp slt i64 %k.{b}, %t.next",
            f"br i1 %more2.{b}, label %body2.{b}, label %done.{b}",
            f"body2.{b}:",
            *_term_indices("k", b),
            *_loaded(f"%scalar.{b}.1", number, "%scalars", f"%k.{b}.a"),
            *_repeated(f"%scalar.{b}", f"%scalar.{b}.1", vector, width, number),
            f"%at.{b} = mul i64 %k.{b}.b, {n}",
            f"%from.{b} = getelementptr {vector}, ptr %matrix, i64 %at.{b}",
        ]
        for j in entries:
            lines += [
                *_loaded(f"%d{j}", vector, f"%from.{b}", j),
                *_product_added(f"%y{j}.1", vector, f"%scalar.{b}", f"%d{j}", f"%y{j}"),
            ]
        lines += [f"br label %head2.{b}", f"done.{b}:"]
        for j in entries:
            lines += [
                f"%o{j}.0 = mul i64 %entry.step, {j}",
                f"%o{j}.1 = add i64 %o{j}.0, %to",
                f"%o{j} = getelementptr {vector}, ptr %result, i64 %o{j}.1",
                f"store {vector} %y{j}, ptr %o{j}, align {align}",
            ]
        before = f"done.{b}"
    lines += [
        "br label %row.end",
        "row.end:",
        "%r.next = add i64 %r, 1",
        "%more = icmp slt i64 %r.next, %rows",
        "br i1 %more, label %row, label %exit",
        "exit:",
    ]
    return _definition(COMBINE, name, lines)


def _term_indices(index: str, block: str) -> list[str]:
    """Return lines of IR that load both indices of a term from the table, and advance the index of the loop."""
    i = f"%{index}.{block}"
    return [
        f"{i}.p = getelementptr i32, ptr %table, i64 {i}",
        f"{i}.a0 = load i32, ptr {i}.p, align 4",
        f"{i}.a = zext i32 {i}.a0 to i64",
        f"{i}.q = getelementptr i32, ptr {i}.p, i64 1",
        f"{i}.b0 = load i32, ptr {i}.q, align 4",
        f"{i}.b = zext i32 {i}.b0 to i64",
        f"%{index}.next.{block} = add i64 {i}, 2",
    ]


def _loop(index: str, end: str, body: list[str]) -> list[str]:
    """Return lines of IR that run ``body`` for the values 0, 1, ... below ``end`` of an index, and end at ``exit``.

    The lines begin in the block ``entry``. ``index`` is the name of the index, with the percent sign.
    """
    return [
        "br label %loop",
        "loop:",
        f"{index} = phi i64 [0, %entry], [{index}.next, %loop]",
        *body,
        f"{index}.next = add i64 {index}, 1",
        f"%more = icmp slt i64 {index}.next, {end}",
        "br i1 %more, label %loop, label %exit",
        "exit:",
    ]


def _loaded(name: str, kind: str, pointer: str, index: int | str) -> list[str]:
    """Return lines of IR that load ``name`` of the type ``kind`` from the entry ``index`` at ``pointer``.

    The address remains in ``name.p``.
    """
    align = 4 if "float" in kind else 8
    return [
        f"{name}.p = getelementptr {kind}, ptr {pointer}, i64 {index}",
        f"{name} = load {kind}, ptr {name}.p, align {align}",
    ]


def _add_products_ir(name: str, n: int, width: int, number: str) -> str:
    """Return the IR of the routine that adds ``a w' + w a'`` to a symmetric matrix (n, n) in lanes.

    The vector a is in ``lanes``, and w in ``scalars``.
    """
    vector, align = f"<{width} x {number}>", 4 if number == "float" else 8
    body = [
        *_loaded("%ai", vector, "%lanes", "%i"),
        *_loaded("%wi.1", number, "%scalars", "%i"),
        *_repeated("%wi", "%wi.1", vector, width, number),
        f"%at = mul i64 %i, {n}",
        f"%line = getelementptr {vector}, ptr %matrix, i64 %at",
    ]
    for j in range(n):
        body += [
            *_loaded(f"%d{j}", vector, "%line", j),
            *_loaded(f"%w{j}.1", number, "%scalars", j),
            *_repeated(f"%w{j}", f"%w{j}.1", vector, width, number),
            *_loaded(f"%a{j}", vector, "%lanes", j),
            *_product_added(f"%x{j}", vector, "%ai", f"%w{j}", f"%d{j}"),
            *_product_added(f"%y{j}", vector, f"%a{j}", "%wi", f"%x{j}"),
            f"store {vector} %y{j}, ptr %d{j}.p, align {align}",
        ]
    return _definition(ADD_PRODUCTS, name, ["entry:", *_loop("%i", str(n), body)])


def _add_transposed_ir(name: str, n: int, width: int, number: str) -> str:
    """Return the IR of the routine that computes the sum of a matrix (n, n) in lanes and of its transpose."""
    vector, align = f"<{width} x {number}>", 4 if number == "float" else 8
    body = [
        f"%at = mul i64 %i, {n}",
        f"%line = getelementptr {vector}, ptr %matrix, i64 %at",
        f"%column = getelementptr {vector}, ptr %matrix, i64 %i",
        f"%to = getelementptr {vector}, ptr %result, i64 %at",
    ]
    for j in range(n):
        body += [
            *_loaded(f"%a{j}", vector, "%line", j),
            *_loaded(f"%b{j}", vector, "%column", j * n),
            f"%s{j} = fadd {FLAGS} {vector} %a{j}, %b{j}",
            f"%o{j}.p = getelementptr {vector}, ptr %to, i64 {j}",
            f"store {vector} %s{j}, ptr %o{j}.p, align {align}",
        ]
    return _definition(ADD_TRANSPOSED, name, ["entry:", *_loop("%i", str(n), body)])


def _add_outer_product_ir(name: str, n: int, width: int, number: str) -> str:
    """Return the IR of the routine that adds the product ``a w'`` to a matrix with n vectors in each row.

    The vector a is in ``column``, and w in ``line``.
    """
    vector, align = f"<{width} x {number}>", 4 if number == "float" else 8
    body = [
        *_loaded("%a.1", number, "%column", "%i"),
        *_repeated("%a", "%a.1", vector, width, number),
        f"%at = mul i64 %i, {n}",
        f"%to = getelementptr {vector}, ptr %matrix, i64 %at",
    ]
    for j in range(n):
        body += [
            *_loaded(f"%d{j}", vector, "%to", j),
            *_product_added(f"%x{j}", vector, "%a", f"%w{j}", f"%d{j}"),
            f"store {vector} %x{j}, ptr %d{j}.p, align {align}",
        ]
    first = [line for j in range(n) for line in _loaded(f"%w{j}", vector, "%line", j)]
    return _definition(ADD_OUTER_PRODUCT, name, ["entry:", *first, *_loop("%i", "%rows", body)])


def _transpose_ir(name: str, n: int, stride: int, number: str) -> str:
    """Return the IR of the routine that transposes a matrix of n rows, of which each takes ``stride`` numbers."""
    align = 4 if number == "float" else 8
    body = [
        f"%at = mul i64 %i, {stride}",
        f"%line = getelementptr {number}, ptr %matrix, i64 %at",
        f"%column = getelementptr {number}, ptr %result, i64 %i",
    ]
    for j in range(n):
        body += [
            *_loaded(f"%a{j}", number, "%line", j),
            f"%o{j}.p = getelementptr {number}, ptr %column, i64 {j * stride}",
            f"store {number} %a{j}, ptr %o{j}.p, align {align}",
        ]
    return _definition(TRANSPOSE, name, ["entry:", *_loop("%i", str(n), body)])


def _mirror_ir(name: str, n: int, stride: int, number: str) -> str:
    """Return the IR of the routine that copies the upper triangle of a matrix of n rows to its lower triangle.

    Each row takes ``stride`` numbers.
    """
    align, lines = 4 if number == "float" else 8, ["entry:"]
    for i in range(n):
        for j in range(i + 1, n):
            a = f"%a{i}.{j}"
            lines += [
                *_loaded(a, number, "%matrix", i * stride + j),
                f"{a}.q = getelementptr {number}, ptr %matrix, i64 {j * stride + i}",
                f"store {number} {a}, ptr {a}.q, align {align}",
            ]
    return _definition(MIRROR, name, lines)


def _copy_to_single_ir(name: str, n: int, width: int, number: str) -> str:
    """Return the IR of the routine that copies n vectors of doubles to an array in single precision."""
    vector, single = f"<{width} x {number}>", f"<{width} x float>"
    body = [
        *_loaded("%a", vector, "%matrix", "%i"),
        f"%s = fptrunc {vector} %a to {single}",
        f"%s.p = getelementptr {single}, ptr %result, i64 %i",
        f"store {single} %s, ptr %s.p, align 4",
    ]
    return _definition(COPY_TO_SINGLE, name, ["entry:", *_loop("%i", str(n), body)])


def _add_gram_ir(name: str, n: int, width: int, number: str) -> str:
    """Return the IR of the routine that adds inner products of lanes to a block (width, width) of doubles.

    ``left`` and ``right`` have n vectors. Element (i, j) of the block is increased by the sum over the vectors of (lane
    i of ``left``) times (lane j of ``right``).
    """
    sums, source = f"<{width} x double>", f"<{width} x {number}>"
    first = [line for e in range(n) for line in _loaded_double(f"%b{e}", source, sums, "%right", e)]
    body = _loaded("%s0", sums, "%result", "%i")
    for e in range(n):
        body += [
            f"%at{e} = add i64 %i, {e * width}",
            *_loaded_double(f"%a{e}", number, "double", "%left", f"%at{e}"),
            *_repeated(f"%v{e}", f"%a{e}", sums, width, "double"),
            *_product_added(f"%s{e + 1}", sums, f"%v{e}", f"%b{e}", f"%s{e}"),
        ]
    body.append(f"store {sums} %s{n}, ptr %s0.p, align 8")
    return _definition(ADD_GRAM, name, ["entry:", *first, *_loop("%i", str(width), body)])


def _loaded_double(name: str, kind: str, wanted: str, pointer: str, index: int | str) -> list[str]:
    """Return lines of IR that load a number or vector as `_loaded`, and convert it to doubles, the type ``wanted``."""
    if kind == wanted:
        return _loaded(name, kind, pointer, index)
    return [*_loaded(f"{name}.0", kind, pointer, index), f"{name} = fpext {kind} {name}.0 to {wanted}"]


_WRITERS = {
    COMBINE: _combine_ir,
    ADD_PRODUCTS: _add_products_ir,
    ADD_TRANSPOSED: _add_transposed_ir,
    ADD_OUTER_PRODUCT: _add_outer_product_ir,
    TRANSPOSE: _transpose_ir,
    MIRROR: _mirror_ir,
    COPY_TO_SINGLE: _copy_to_single_ir,
    ADD_GRAM: _add_gram_ir,
}
