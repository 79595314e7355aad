"""Linear recursion with one operator for each row, applied to many columns at once.

The recursion computes the sensitivities of a filter: of its state from row to row, and of its whitened innovations.
The loop is compiled if llvmlite is installed. Otherwise numpy is used.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.engine import jit
from seatrial.ident.numerics import Array

VECTORS = 4  # vectors processed together: each number of an operator is loaded once for all of them
MULTIPLE = VECTORS * jit.WIDTH  # the number of columns is a multiple of this
NOWHERE = -1  # row of ``out`` for an output that is not stored

Index = NDArray[np.int64]


def padded(n_columns: int) -> int:
    """Return the number of columns, rounded up to the multiple that `apply_rows` requires."""
    return -(-n_columns // MULTIPLE) * MULTIPLE


def apply_rows(
    operators: Array, drive: Array, columns: Index, ahead: Array, rows: Index, begin: Array, at: Index, out: Array
) -> Array:
    """Run the recursion ``[x_k+1; y_k] = B_k [x_k; d_k] + [a_k d_k+1; 0]`` over the rows k, and write y to ``out``.

    All arrays are contiguous. The number of columns w is a result of `padded`.

    Parameters
    ----------
    operators : Array (n, s + m, s + t)
        Matrices B, with s entries of x, m of y and t possible columns for d.
    drive : Array (n + 1, p, w)
        d of each row, and d at the end of the last row.
    columns : Index (p,)
        Column of B, among the t columns for d, of each entry of d. Entries that drive rates come first.
    ahead : Array (n,)
        Factors a.
    rows : Index (r,)
        Entries of x to which the first r entries of d_k+1 are added.
    begin : Array (s, w)
        x of the first row.
    at : Index (n, m)
        Row of ``out`` for each entry of y, or NOWHERE.
    out : Array (n_out, w)
        Written in place.

    Returns
    -------
    Array (s, w)
        x after the last row.
    """
    n, s = len(operators), len(begin)
    x: Array = np.zeros((2, *begin.shape))
    x[0] = begin
    where = np.append(np.arange(s), s + columns)
    if jit.AVAILABLE:
        sizes = (n, s, at.shape[1], operators.shape[2], drive.shape[1], drive.shape[2], rows.size)
        arrays = (operators, where, x, drive, ahead, np.ascontiguousarray(rows), at, out)
        assert all(a.flags.c_contiguous for a in arrays)
        _compiled()(*sizes, *(a.ctypes.data for a in arrays))
        return np.asarray(x[n % 2])
    now = x[0]
    for k in range(n):
        products = operators[k][:, where] @ np.concatenate([now, drive[k]])
        stored = at[k] != NOWHERE
        out[at[k][stored]] = products[s:][stored]
        now = products[:s]
        now[rows] += ahead[k] * drive[k + 1, : rows.size]
    return np.asarray(now)


@cache
def _compiled() -> Callable[..., None]:
    """Return the compiled loop as a function of sizes and addresses."""
    library, address = jit.load_machine_code(_ir(), "rows")
    entry = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 7, *[ctypes.c_void_p] * 8)(address)

    def run(*arguments: Any) -> None:
        assert library is not None  # the code lives as long as its library
        entry(*arguments)

    return run


class _Text:
    """Writer of LLVM IR, line by line. Loop indices and sums are kept in memory; LLVM moves them to registers."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._n = 0

    def __call__(self, text: str) -> None:
        self.lines.append(f"  {text}")

    def value(self, text: str) -> str:
        """Append an instruction. Return the name of its value."""
        self._n += 1
        self(f"%v{self._n} = {text}")
        return f"%v{self._n}"

    def loop(self, end: str, body: Callable[[str], None], step: int = 1) -> None:
        """Write a loop that runs the body for 0, step, 2 step, ... below the end."""
        self._n += 1
        here = f"l{self._n}"
        self.lines.insert(1, f"  %{here} = alloca i64")
        self(f"store i64 0, ptr %{here}")
        self(f"br label %{here}.head")
        self.lines.append(f"{here}.head:")
        i = self.value(f"load i64, ptr %{here}")
        more = self.value(f"icmp slt i64 {i}, {end}")
        self(f"br i1 {more}, label %{here}.body, label %{here}.end")
        self.lines.append(f"{here}.body:")
        body(i)
        after = self.value(f"add i64 {i}, {step}")
        self(f"store i64 {after}, ptr %{here}")
        self(f"br label %{here}.head")
        self.lines.append(f"{here}.end:")

    def at(self, base: str, *index: tuple[str, str]) -> str:
        """Return the address of an item of an array. The index is a list of pairs (size of the dimension, index)."""
        place = index[0][1]
        for size, i in index[1:]:
            place = self.value(f"add i64 {self.value(f'mul i64 {place}, {size}')}, {i}")
        return self.value(f"getelementptr double, ptr {base}, i64 {place}")


def _ir() -> str:
    """Return the LLVM IR of the function ``rows(n, s, m, t, p, w, r, B, where, x, d, a, to, at, out)``."""
    width = jit.WIDTH
    vector, fma = f"<{width} x double>", f"@llvm.fmuladd.v{width}f64"
    text, sums = _Text(), [f"%sum{k}" for k in range(VECTORS)]
    text.lines = ["entry:", *(f"  {name} = alloca {vector}" for name in sums)]

    def splat(number: str) -> str:
        first = text.value(f"insertelement {vector} poison, double {number}, i32 0")
        return text.value(f"shufflevector {vector} {first}, {vector} poison, <{width} x i32> zeroinitializer")

    def vectors(place: str) -> list[str]:
        return [text.value(f"getelementptr double, ptr {place}, i64 {k * width}") for k in range(VECTORS)]

    def product(row: str, column: str, item: str) -> None:
        """Add the entry (row, column) of B times VECTORS vectors of an item's columns to the sums."""
        factor = splat(text.value(f"load double, ptr {text.at('%B', ('', row), ('%t', column))}"))
        for name, place in zip(sums, vectors(item), strict=True):
            x = text.value(f"load {vector}, ptr {place}, align 8")
            so_far = text.value(f"load {vector}, ptr {name}")
            more = text.value(f"call {vector} {fma}({vector} {factor}, {vector} {x}, {vector} {so_far})")
            text(f"store {vector} {more}, ptr {name}")

    def of_row(k: str) -> None:
        """Write the products of one row, its outputs, and the part of the next drive."""
        now = text.value(f"and i64 {k}, 1")
        later = text.value(f"xor i64 {now}, 1")
        after = text.value(f"add i64 {k}, 1")
        height = text.value("add i64 %s, %m")

        def of_result(i: str, target: str) -> None:
            """Write the product of one row of B with all columns to ``target``."""
            row = text.value(f"add i64 {text.value(f'mul i64 {k}, {height}')}, {i}")

            def of_columns(c: str) -> None:
                for name in sums:
                    text(f"store {vector} zeroinitializer, ptr {name}")
                text.loop("%s", lambda j: product(row, j, text.at("%x", ("", now), ("%s", j), ("%w", c))))

                def driven(j: str) -> None:
                    index = text.value(f"add i64 %s, {j}")
                    source = text.value(f"load i64, ptr {text.at('%where', ('', index))}")
                    product(row, source, text.at("%d", ("", k), ("%p", j), ("%w", c)))

                text.loop("%p", driven)
                to = vectors(text.value(f"getelementptr double, ptr {target}, i64 {c}"))
                for name, place in zip(sums, to, strict=True):
                    text(f"store {vector} {text.value(f'load {vector}, ptr {name}')}, ptr {place}, align 8")

            text.loop("%w", of_columns, MULTIPLE)

        text.loop("%s", lambda i: of_result(i, text.at("%x", ("", later), ("%s", i), ("%w", "0"))))

        def store_output(i: str) -> None:
            """Write one output, unless its row is NOWHERE."""
            place = text.value(f"load i64, ptr {text.at('%at', ('', k), ('%m', i))}")
            text._n += 1
            here = f"if{text._n}"
            text(f"br i1 {text.value(f'icmp sge i64 {place}, 0')}, label %{here}.then, label %{here}.end")
            text.lines.append(f"{here}.then:")
            of_result(text.value(f"add i64 %s, {i}"), text.at("%out", ("", place), ("%w", "0")))
            text(f"br label %{here}.end")
            text.lines.append(f"{here}.end:")

        text.loop("%m", store_output)
        weight = splat(text.value(f"load double, ptr {text.at('%a', ('', k))}"))

        def ahead(e: str) -> None:
            """Add the next drive, times its factor, to one entry of x."""
            i = text.value(f"load i64, ptr {text.at('%to', ('', e))}")

            def of_columns(c: str) -> None:
                target = text.at("%x", ("", later), ("%s", i), ("%w", c))
                source = text.at("%d", ("", after), ("%p", e), ("%w", c))
                for to, drive in zip(vectors(target), vectors(source), strict=True):
                    x, y = (text.value(f"load {vector}, ptr {place}, align 8") for place in (drive, to))
                    moved = text.value(f"call {vector} {fma}({vector} {weight}, {vector} {x}, {vector} {y})")
                    text(f"store {vector} {moved}, ptr {to}, align 8")

            text.loop("%w", of_columns, MULTIPLE)

        text.loop("%r", ahead)

    text.loop("%n", of_row)
    text("ret void")
    sizes = ", ".join(f"i64 %{name}" for name in ("n", "s", "m", "t", "p", "w", "r"))
    arrays = ", ".join(f"ptr %{name}" for name in ("B", "where", "x", "d", "a", "to", "at", "out"))
    return "\n".join([
        f"declare {vector} {fma}({vector}, {vector}, {vector})",
        f"define void @rows({sizes}, {arrays}) {{", *text.lines, "}", "",
    ])  # fmt: skip
