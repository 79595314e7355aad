"""One linear operator a row, on many columns at once: compiled, or by numpy where there is no LLVM.

What the sensitivities of a filter are: of its state from row to row, and of its whitened innovations.
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

VECTORS = 4  # worked on at a time: each number of an operator is loaded once for so many
MULTIPLE = VECTORS * jit.WIDTH  # of columns
NOWHERE = -1

Index = NDArray[np.int64]


def padded(n_columns: int) -> int:
    """So many columns as ``apply_rows`` takes."""
    return -(-n_columns // MULTIPLE) * MULTIPLE


def apply_rows(
    operators: Array, drive: Array, columns: Index, ahead: Array, rows: Index, begin: Array, at: Index, out: Array
) -> Array:
    """Go along the rows, ``[x_k+1; y_k] = B_k [x_k; d_k] + [a_k d_k+1; 0]``; y is written to ``out``.

    operators (n, s + m, s + t): B, s the size of x, m of y; drive (n + 1, p, w): d of each row, and of the end of the
    last; columns (p,): which of B's t columns for d each of them has, those of rates first; ahead (n,): a; rows (r,):
    of x, to which the first r of d_k+1 are added; begin (s, w): x of the first row; at (n, m): the row of ``out`` that
    each y has, or NOWHERE; out (n_out, w). All are contiguous, and w is `padded`. Returns x behind the last row (s, w).
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
        found = operators[k][:, where] @ np.concatenate([now, drive[k]])
        known = at[k] != NOWHERE
        out[at[k][known]] = found[s:][known]
        now = found[:s]
        now[rows] += ahead[k] * drive[k + 1, : rows.size]
    return np.asarray(now)


@cache
def _compiled() -> Callable[..., None]:
    library, address = jit.load_machine_code(_ir(), "rows")
    entry = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 7, *[ctypes.c_void_p] * 8)(address)

    def run(*given: Any) -> None:
        assert library is not None  # the code lives as long as its library
        entry(*given)

    return run


class _Text:
    """LLVM IR, a line at a time; what changes lies in memory, from which the compiler takes it."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._n = 0

    def __call__(self, text: str) -> None:
        self.lines.append(f"  {text}")

    def value(self, text: str) -> str:
        """The name of a new value."""
        self._n += 1
        self(f"%v{self._n} = {text}")
        return f"%v{self._n}"

    def loop(self, end: str, body: Callable[[str], None], step: int = 1) -> None:
        """Run the body for 0, step, ... below the end."""
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
        """The place of an item: Horner's scheme of (size, index)."""
        place = index[0][1]
        for size, i in index[1:]:
            place = self.value(f"add i64 {self.value(f'mul i64 {place}, {size}')}, {i}")
        return self.value(f"getelementptr double, ptr {base}, i64 {place}")


def _ir() -> str:
    """``rows(n, s, m, t, p, w, r, B, where, x, d, a, to, at, out)``."""
    width = jit.WIDTH
    vector, fma = f"<{width} x double>", f"@llvm.fmuladd.v{width}f64"
    text, sums = _Text(), [f"%sum{k}" for k in range(VECTORS)]
    text.lines = ["entry:", *(f"  {name} = alloca {vector}" for name in sums)]

    def splat(number: str) -> str:
        one = text.value(f"insertelement {vector} poison, double {number}, i32 0")
        return text.value(f"shufflevector {vector} {one}, {vector} poison, <{width} x i32> zeroinitializer")

    def vectors(place: str) -> list[str]:
        return [text.value(f"getelementptr double, ptr {place}, i64 {k * width}") for k in range(VECTORS)]

    def product(row: str, column: str, item: str) -> None:
        """Add B's number times VECTORS vectors of an item's columns to the sums."""
        many = splat(text.value(f"load double, ptr {text.at('%B', ('', row), ('%t', column))}"))
        for name, place in zip(sums, vectors(item), strict=True):
            x = text.value(f"load {vector}, ptr {place}, align 8")
            so_far = text.value(f"load {vector}, ptr {name}")
            more = text.value(f"call {vector} {fma}({vector} {many}, {vector} {x}, {vector} {so_far})")
            text(f"store {vector} {more}, ptr {name}")

    def of_row(k: str) -> None:
        now = text.value(f"and i64 {k}, 1")
        later = text.value(f"xor i64 {now}, 1")
        after = text.value(f"add i64 {k}, 1")
        height = text.value("add i64 %s, %m")

        def of_result(i: str, target: str) -> None:
            row = text.value(f"add i64 {text.value(f'mul i64 {k}, {height}')}, {i}")

            def of_columns(c: str) -> None:
                for name in sums:
                    text(f"store {vector} zeroinitializer, ptr {name}")
                text.loop("%s", lambda j: product(row, j, text.at("%x", ("", now), ("%s", j), ("%w", c))))

                def driven(j: str) -> None:
                    known = text.value(f"add i64 %s, {j}")
                    source = text.value(f"load i64, ptr {text.at('%where', ('', known))}")
                    product(row, source, text.at("%d", ("", k), ("%p", j), ("%w", c)))

                text.loop("%p", driven)
                to = vectors(text.value(f"getelementptr double, ptr {target}, i64 {c}"))
                for name, place in zip(sums, to, strict=True):
                    text(f"store {vector} {text.value(f'load {vector}, ptr {name}')}, ptr {place}, align 8")

            text.loop("%w", of_columns, MULTIPLE)

        text.loop("%s", lambda i: of_result(i, text.at("%x", ("", later), ("%s", i), ("%w", "0"))))

        def seen(i: str) -> None:
            place = text.value(f"load i64, ptr {text.at('%at', ('', k), ('%m', i))}")
            text._n += 1
            here = f"if{text._n}"
            text(f"br i1 {text.value(f'icmp sge i64 {place}, 0')}, label %{here}.then, label %{here}.end")
            text.lines.append(f"{here}.then:")
            of_result(text.value(f"add i64 %s, {i}"), text.at("%out", ("", place), ("%w", "0")))
            text(f"br label %{here}.end")
            text.lines.append(f"{here}.end:")

        text.loop("%m", seen)
        weight = splat(text.value(f"load double, ptr {text.at('%a', ('', k))}"))

        def ahead(e: str) -> None:
            i = text.value(f"load i64, ptr {text.at('%to', ('', e))}")

            def of_columns(c: str) -> None:
                target = text.at("%x", ("", later), ("%s", i), ("%w", c))
                source = text.at("%d", ("", after), ("%p", e), ("%w", c))
                for to, what in zip(vectors(target), vectors(source), strict=True):
                    x, y = (text.value(f"load {vector}, ptr {place}, align 8") for place in (what, to))
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
