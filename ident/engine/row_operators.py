"""Linear recursion with one matrix (the operator) for each row of a record, applied to many columns at once.

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
    """Return the number of columns, rounded up to a multiple of 8, 16 or 32 (``MULTIPLE``), as `apply_rows` needs it.

    The multiple is four times the number of doubles in a vector register of the processor.
    """
    return -(-n_columns // MULTIPLE) * MULTIPLE


def apply_rows(
    operators: Array,
    drive: Array,
    drive_columns: Index,
    next_drive_factors: Array,
    driven_states: Index,
    initial_states: Array,
    output_rows: Index,
    out: Array,
) -> Array:
    """Run the recursion ``[x_k+1; y_k] = B_k [x_k; d_k] + [a_k d_k+1; 0]`` over the rows k, and write y to ``out``.

    x are the s states, d the p drives (inputs of the recursion) and y the m outputs. Each of the w columns is an
    independent solution of the recursion, such as the sensitivity to one parameter. All arrays must be contiguous and
    of type float64, except those of indices (int64). The number of columns w must be a result of `padded`.

    Parameters
    ----------
    operators : Array (n, s + m, s + t)
        Matrices B of the n rows. The first s columns belong to x; the other t columns are available for d.
    drive : Array (n + 1, p, w)
        d of each row, and d at the end of the last row.
    drive_columns : Index (p,)
        Column of B, counted from zero among the t columns for d, by which each entry of d is multiplied. The r entries
        of d that are also added to x directly come first.
    next_drive_factors : Array (n,)
        Factor a_k of each row, by which the drive of the next row is multiplied.
    driven_states : Index (r,)
        Indices of the entries of x to which the first r entries of ``a_k d_k+1`` are added.
    initial_states : Array (s, w)
        x of the first row. It is not changed.
    output_rows : Index (n, m)
        Row of ``out`` into which each entry of y is written. An entry with NOWHERE (-1) is not computed.
    out : Array (n_out, w)
        Outputs y, written in place. Rows that no entry of ``output_rows`` names keep their values.

    Returns
    -------
    Array (s, w)
        x after the last row.

    Raises
    ------
    AssertionError
        If llvmlite is installed and an array is not contiguous; ``driven_states`` and ``initial_states`` are copied
        instead. Types and shapes are not checked.
    """
    n, s = len(operators), len(initial_states)
    x: Array = np.zeros((2, *initial_states.shape))
    x[0] = initial_states
    where = np.append(np.arange(s), s + drive_columns)
    if jit.AVAILABLE:
        sizes = (n, s, output_rows.shape[1], operators.shape[2], drive.shape[1], drive.shape[2], driven_states.size)
        arrays = (operators, where, x, drive, next_drive_factors, np.ascontiguousarray(driven_states), output_rows, out)
        assert all(a.flags.c_contiguous for a in arrays)
        _compiled_recursion()(*sizes, *(a.ctypes.data for a in arrays))
        return np.asarray(x[n % 2])
    now = x[0]
    for k in range(n):
        products = operators[k][:, where] @ np.concatenate([now, drive[k]])
        stored = output_rows[k] != NOWHERE
        out[output_rows[k][stored]] = products[s:][stored]
        now = products[:s]
        now[driven_states] += next_drive_factors[k] * drive[k + 1, : driven_states.size]
    return np.asarray(now)


@cache
def _compiled_recursion() -> Callable[..., None]:
    """Compile the recursion of `apply_rows` and return it as a function.

    The arguments of the function are seven sizes (n, s, m, t, p, w, r) and the addresses of eight arrays, in the order
    of `_recursion_ir`. It is compiled, or loaded from the cache on disk, once per process.
    """
    library, address = jit.load_machine_code(_recursion_ir(), "rows", has_loops=True)
    entry = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 7, *[ctypes.c_void_p] * 8)(address)

    def run(*arguments: Any) -> None:
        """Call the machine code of the recursion with seven sizes and eight addresses of arrays.

        It writes the arrays ``x`` and ``out`` in place. The arguments are not checked.
        """
        assert library is not None  # the code lives as long as its library
        entry(*arguments)

    return run


class _IrWriter:
    """Writer of the LLVM IR (intermediate code of the compiler) of one function, line by line.

    Loop indices and sums are kept in memory; LLVM moves them to registers.

    Attributes
    ----------
    lines : list[str]
        Lines of IR written so far. The first one is the label of the entry block.
    """

    def __init__(self) -> None:
        """Create a writer without lines; the caller writes the first line, the label of the entry block."""
        self.lines: list[str] = []
        self._n = 0

    def __call__(self, text: str) -> None:
        """Append an instruction without a result, such as a store or a branch, as a line of LLVM IR to `lines`."""
        self.lines.append(f"  {text}")

    def instruction(self, text: str) -> str:
        """Append an instruction and assign its result to a new name, such as ``%v7``. Return this name."""
        self._n += 1
        self(f"%v{self._n} = {text}")
        return f"%v{self._n}"

    def loop(self, end: str, body: Callable[[str], None], step: int = 1) -> None:
        """Write a loop over the index values 0, step, 2 step, ... below ``end``.

        Parameters
        ----------
        end : str
            Name of the value at which the loop ends, such as ``%n``.
        body : Callable[[str], None]
            Writes the instructions of one pass. Its argument is the name of the index.
        step : int
            Increment of the index.
        """
        self._n += 1
        here = f"l{self._n}"
        self.lines.insert(1, f"  %{here} = alloca i64")
        self(f"store i64 0, ptr %{here}")
        self(f"br label %{here}.head")
        self.lines.append(f"{here}.head:")
        i = self.instruction(f"load i64, ptr %{here}")
        more = self.instruction(f"icmp slt i64 {i}, {end}")
        self(f"br i1 {more}, label %{here}.body, label %{here}.end")
        self.lines.append(f"{here}.body:")
        body(i)
        after = self.instruction(f"add i64 {i}, {step}")
        self(f"store i64 {after}, ptr %{here}")
        self(f"br label %{here}.head")
        self.lines.append(f"{here}.end:")

    def address(self, base: str, *index: tuple[str, str]) -> str:
        """Write the instructions that compute the address of an item of an array of doubles.

        The result is the name of the address in the IR.

        Parameters
        ----------
        base : str
            Name of the array's address.
        *index : tuple[str, str]
            Pair (size of the dimension, index) of each dimension, outermost first. The size of the first is not used.
        """
        place = index[0][1]
        for size, i in index[1:]:
            place = self.instruction(f"add i64 {self.instruction(f'mul i64 {place}, {size}')}, {i}")
        return self.instruction(f"getelementptr double, ptr {base}, i64 {place}")


def _recursion_ir() -> str:
    """Return the LLVM IR (intermediate code of the compiler) of the recursion of `apply_rows`.

    It defines the function ``rows(n, s, m, t, p, w, r, B, where, x, d, a, to, at, out)``. n is the number of rows, and
    t is the total number of columns of B. The other sizes are those of `apply_rows`. B is ``operators``, d is
    ``drive``, a is ``next_drive_factors``, to is ``driven_states`` and at is ``output_rows`` of `apply_rows`. ``where``
    (s + p,) holds the columns of B for all entries of [x; d]. ``x`` (2, s, w) holds the states of two successive rows
    in turn.
    """
    width = jit.WIDTH
    vector, fma = f"<{width} x double>", f"@llvm.fmuladd.v{width}f64"
    text, sums = _IrWriter(), [f"%sum{k}" for k in range(VECTORS)]
    text.lines = ["entry:", *(f"  {name} = alloca {vector}" for name in sums)]

    def splat(number: str) -> str:
        """Write the instructions that repeat the scalar ``number`` in a vector. Return the name of the vector."""
        first = text.instruction(f"insertelement {vector} poison, double {number}, i32 0")
        return text.instruction(f"shufflevector {vector} {first}, {vector} poison, <{width} x i32> zeroinitializer")

    def vector_addresses(place: str) -> list[str]:
        """Write the computation of the addresses of four neighbouring vectors, and return the names of the addresses.

        The first vector is at the address ``place``.
        """
        return [text.instruction(f"getelementptr double, ptr {place}, i64 {k * width}") for k in range(VECTORS)]

    def add_product(row: str, column: str, item: str) -> None:
        """Write the addition of the entry (row, column) of B, times four vectors at the address ``item``, to the sums.

        The vectors hold neighbouring columns of x or d.
        """
        factor = splat(text.instruction(f"load double, ptr {text.address('%B', ('', row), ('%t', column))}"))
        for name, place in zip(sums, vector_addresses(item), strict=True):
            x = text.instruction(f"load {vector}, ptr {place}, align 8")
            so_far = text.instruction(f"load {vector}, ptr {name}")
            more = text.instruction(f"call {vector} {fma}({vector} {factor}, {vector} {x}, {vector} {so_far})")
            text(f"store {vector} {more}, ptr {name}")

    def write_row(k: str) -> None:
        """Write the loop body of row k: the next state, the outputs, and the term of the next drive ``a_k d_k+1``."""
        now = text.instruction(f"and i64 {k}, 1")
        later = text.instruction(f"xor i64 {now}, 1")
        after = text.instruction(f"add i64 {k}, 1")
        height = text.instruction("add i64 %s, %m")

        def write_product(i: str, target: str) -> None:
            """Write the product of row i of B with all columns of [x; d], stored at the address ``target``."""
            row = text.instruction(f"add i64 {text.instruction(f'mul i64 {k}, {height}')}, {i}")

            def write_columns(c: str) -> None:
                """Write the sum of the products for the columns from ``c`` on, as many as four vectors hold."""
                for name in sums:
                    text(f"store {vector} zeroinitializer, ptr {name}")
                text.loop("%s", lambda j: add_product(row, j, text.address("%x", ("", now), ("%s", j), ("%w", c))))

                def add_drive_product(j: str) -> None:
                    """Write the addition of the product of row i of B with entry j of the drive d to the sums."""
                    index = text.instruction(f"add i64 %s, {j}")
                    source = text.instruction(f"load i64, ptr {text.address('%where', ('', index))}")
                    add_product(row, source, text.address("%d", ("", k), ("%p", j), ("%w", c)))

                text.loop("%p", add_drive_product)
                to = vector_addresses(text.instruction(f"getelementptr double, ptr {target}, i64 {c}"))
                for name, place in zip(sums, to, strict=True):
                    text(f"store {vector} {text.instruction(f'load {vector}, ptr {name}')}, ptr {place}, align 8")

            text.loop("%w", write_columns, MULTIPLE)

        text.loop("%s", lambda i: write_product(i, text.address("%x", ("", later), ("%s", i), ("%w", "0"))))

        def store_output(i: str) -> None:
            """Write the computation and store of output i, which is skipped if its row in ``out`` is NOWHERE (-1)."""
            place = text.instruction(f"load i64, ptr {text.address('%at', ('', k), ('%m', i))}")
            text._n += 1
            here = f"if{text._n}"
            text(f"br i1 {text.instruction(f'icmp sge i64 {place}, 0')}, label %{here}.then, label %{here}.end")
            text.lines.append(f"{here}.then:")
            write_product(text.instruction(f"add i64 %s, {i}"), text.address("%out", ("", place), ("%w", "0")))
            text(f"br label %{here}.end")
            text.lines.append(f"{here}.end:")

        text.loop("%m", store_output)
        weight = splat(text.instruction(f"load double, ptr {text.address('%a', ('', k))}"))

        def add_next_drive(e: str) -> None:
            """Write the addition of entry e of the next drive, times the factor a_k, to its entry of the next x."""
            i = text.instruction(f"load i64, ptr {text.address('%to', ('', e))}")

            def write_columns(c: str) -> None:
                """Write this addition for the columns from ``c`` on, as many as four vectors hold."""
                target = text.address("%x", ("", later), ("%s", i), ("%w", c))
                source = text.address("%d", ("", after), ("%p", e), ("%w", c))
                for to, drive in zip(vector_addresses(target), vector_addresses(source), strict=True):
                    x, y = (text.instruction(f"load {vector}, ptr {place}, align 8") for place in (drive, to))
                    moved = text.instruction(f"call {vector} {fma}({vector} {weight}, {vector} {x}, {vector} {y})")
                    text(f"store {vector} {moved}, ptr {to}, align 8")

            text.loop("%w", write_columns, MULTIPLE)

        text.loop("%r", add_next_drive)

    text.loop("%n", write_row)
    text("ret void")
    sizes = ", ".join(f"i64 %{name}" for name in ("n", "s", "m", "t", "p", "w", "r"))
    arrays = ", ".join(f"ptr %{name}" for name in ("B", "where", "x", "d", "a", "to", "at", "out"))
    return "\n".join([
        f"declare {vector} {fma}({vector}, {vector}, {vector})",
        f"define void @rows({sizes}, {arrays}) {{", *text.lines, "}", "",
    ])  # fmt: skip
