"""Cache of kernels on disk that is read without CasADi. A kernel is a program that runs over all rows of a record.

Importing CasADi and building graphs takes longer than the work of the kernels. The functions of a model are therefore
traced: they run on objects that record the operations. A hash of the recorded text, of the other properties in
`EkfGraphs.key` and of the source code of this package is the key of the kernel. The layout of the arrays and the key
of the machine code are stored under this key, beside the machine code.

Some functions cannot be recorded, for example functions with a condition or an array. Their kernels have no key and
are built by CasADi in each process.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from seatrial.ident.engine import jit
from seatrial.ident.engine.array_layout import Layout
from seatrial.ident.model import Model


class TracedNumber:
    """Number without a value that records the operations on it as text.

    An operation with a traced number appends a line to ``lines`` and returns a new traced number. numpy's elementwise
    functions are recorded under their names. A truth value, a reduction or an operand that is no number raises
    TypeError. Comparisons are recorded too: they return a traced number, not a bool. A traced number cannot be hashed.

    Attributes
    ----------
    lines : list[str]
        All operations recorded so far, shared by all numbers of one model.
    index : int
        Index of the line that defines this number.
    """

    __slots__ = ("index", "lines")

    def __init__(self, lines: list[str], line: str) -> None:
        """Append ``line``, the text of the operation that defines this number, to the list ``lines``, in place."""
        self.lines, self.index = lines, len(lines)
        lines.append(line)

    def _record_operation(self, name: str, *operands: Any) -> TracedNumber:
        """Append the line "name operand ..." to ``lines``, and return the traced number that it defines.

        TypeError is raised for an operand that is neither a traced number nor a number.
        """
        return TracedNumber(self.lines, f"{name} {' '.join(_operand_text(o) for o in operands)}")

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> TracedNumber:
        """Record the call of an elementwise numpy function ``ufunc`` on ``inputs``, and return its traced result.

        TypeError is raised for reductions (``method`` other than ``__call__``) and for calls with options.
        """
        if method != "__call__" or options:
            raise TypeError(f"{ufunc.__name__}.{method} cannot be recorded")
        return self._record_operation(ufunc.__name__, *inputs)

    def __bool__(self) -> bool:
        """Raise TypeError: a traced number has no value, so a condition on it cannot be recorded."""
        raise TypeError("a condition cannot be recorded")

    def __add__(self, other: Any) -> TracedNumber:
        """Record ``self + other`` and return its traced result."""
        return self._record_operation("add", self, other)

    def __radd__(self, other: Any) -> TracedNumber:
        """Record ``other + self`` and return its traced result."""
        return self._record_operation("add", other, self)

    def __sub__(self, other: Any) -> TracedNumber:
        """Record ``self - other`` and return its traced result."""
        return self._record_operation("subtract", self, other)

    def __rsub__(self, other: Any) -> TracedNumber:
        """Record ``other - self`` and return its traced result."""
        return self._record_operation("subtract", other, self)

    def __mul__(self, other: Any) -> TracedNumber:
        """Record ``self * other`` and return its traced result."""
        return self._record_operation("multiply", self, other)

    def __rmul__(self, other: Any) -> TracedNumber:
        """Record ``other * self`` and return its traced result."""
        return self._record_operation("multiply", other, self)

    def __truediv__(self, other: Any) -> TracedNumber:
        """Record ``self / other`` and return its traced result."""
        return self._record_operation("divide", self, other)

    def __rtruediv__(self, other: Any) -> TracedNumber:
        """Record ``other / self`` and return its traced result."""
        return self._record_operation("divide", other, self)

    def __pow__(self, other: Any) -> TracedNumber:
        """Record ``self ** other`` and return its traced result."""
        return self._record_operation("power", self, other)

    def __rpow__(self, other: Any) -> TracedNumber:
        """Record ``other ** self`` and return its traced result."""
        return self._record_operation("power", other, self)

    def __neg__(self) -> TracedNumber:
        """Record ``-self`` and return its traced result."""
        return self._record_operation("negative", self)

    def __pos__(self) -> TracedNumber:
        """Return this object. The operation ``+self`` is not recorded."""
        return self

    def __abs__(self) -> TracedNumber:
        """Record ``abs(self)`` and return its traced result."""
        return self._record_operation("absolute", self)

    def __lt__(self, other: Any) -> TracedNumber:
        """Record ``self < other`` and return its traced result."""
        return self._record_operation("less", self, other)

    def __le__(self, other: Any) -> TracedNumber:
        """Record ``self <= other`` and return its traced result."""
        return self._record_operation("less_equal", self, other)

    def __gt__(self, other: Any) -> TracedNumber:
        """Record ``self > other`` and return its traced result."""
        return self._record_operation("greater", self, other)

    def __ge__(self, other: Any) -> TracedNumber:
        """Record ``self >= other`` and return its traced result."""
        return self._record_operation("greater_equal", self, other)

    def __eq__(self, other: object) -> TracedNumber:  # type: ignore[override]
        """Record ``self == other`` and return its traced result."""
        return self._record_operation("equal", self, other)

    def __ne__(self, other: object) -> TracedNumber:  # type: ignore[override]
        """Record ``self != other`` and return its traced result."""
        return self._record_operation("not_equal", self, other)


def _operand_text(operand: Any) -> str:
    """Return the text of an operand of a recorded operation.

    A traced number is written as ``#`` and the index of the line that defines it, an ordinary number as ``float.hex``
    writes it. A bool counts as a number. TypeError is raised for any other type, also for a CasADi symbol or an array.
    """
    if isinstance(operand, TracedNumber):
        return f"#{operand.index}"
    if isinstance(operand, (int, float, np.integer, np.floating)):
        return float(operand).hex()
    raise TypeError(f"{type(operand).__name__} cannot be recorded")


def kernel_key(model: Model, covariance: bool, joseph: bool) -> str | None:
    """Return the key of a model's kernels in the cache on disk, without CasADi.

    Two models have the same key only if they have the same kernels. The values of the parameters are not part of the
    key. The version of the source code that builds kernels, the processor and the version of LLVM are.

    Parameters
    ----------
    model : Model
        Model whose functions are recorded.
    covariance : bool
        True for the extended Kalman filter, False for simulation (output error).
    joseph : bool
        Whether the covariance is updated in Joseph's form, which keeps it positive in spite of rounding.

    Returns
    -------
    str or None
        SHA-256 hash (hexadecimal). None if a function of the model cannot be recorded, for example because of a
        condition, or raises an error.
    """
    lines: list[str] = []
    try:
        x, u, p = (
            [TracedNumber(lines, f"{kind} {i}") for i in range(len(of))]
            for kind, of in (("x", model.states), ("u", model.inputs), ("p", model.parameters))
        )
        s = model.signals(x, u, p)
        lines += [f"rate {_operand_text(s.rate[v.name])}" for v in model.states]
        lines += [f"output {_operand_text(s.y[o.name])}" for o in model.outputs]
    except Exception:  # an error of the model occurs again in `EkfGraphs`, which reports it
        return None
    noise = ([s.noise for s in model.states], [(s.name, s.outputs) for s in model.sensors])
    names = [p.name for p in model.parameters]
    content = (lines, noise, names, covariance, joseph, model.second_order, _builder_hash())
    return hashlib.sha256(repr(content).encode()).hexdigest()


@cache
def _builder_hash() -> str:
    """Return a SHA-256 hash (hexadecimal) of the source code that builds kernels, for the keys of the cache.

    The code is that of ``ident/engine`` and ``ident/model``. The processor and the version of LLVM are hashed too. The
    hash is computed once per process.
    """
    folder = Path(__file__).parent
    digest = hashlib.sha256(repr(jit.target()).encode())
    for path in sorted([*folder.glob("*.py"), *(folder.parent / "model").glob("*.py")]):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def load_kernel(key: str, name: str) -> tuple[Layout, str] | None:
    """Read the layout of the arrays and the key of the machine code of a kernel from the cache on disk.

    Parameters
    ----------
    key : str
        Result of `kernel_key`.
    name : str
        Name of the kernel, such as ``value``.

    Returns
    -------
    tuple[Layout, str] or None
        Names, sizes and kinds of the arrays, and key for `jit.load_cached_machine_code`. None if the cache lacks the
        kernel, or if its file is damaged or may have been written by another user. A quickly compiled kernel is
        returned only where the thread would compile quickly (`jit.is_quick`), and only if there is no other.
    """
    content = jit.read_cache(f"{key}.{name}.json")
    if content is None and jit.is_quick():
        content = jit.read_cache(f"{key}.{name}.quick.json")
    if content is None:
        return None
    table = json.loads(content)
    sets = {field: frozenset(table[field]) for field in ("rows", "lanes", "carried", "grams", "single")}
    summed, routines = (tuple(table[field]) for field in ("summed", "routines"))
    layout = Layout(sizes=table["sizes"], summed=summed, width=table["width"], routines=routines, **sets)
    return layout, str(table["code"])


def store_kernel(key: str, name: str, layout: Layout, code: str) -> None:
    """Write the layout of the arrays and the key ``code`` of the machine code of a kernel to the cache on disk.

    ``key`` is a result of `kernel_key`, and ``name`` is the name of the kernel, such as ``value``. The file is
    ``<key>.<name>.json``, or ``<key>.<name>.quick.json`` if the thread compiles quickly. A cache that cannot be written
    is not an error.
    """
    table = {field: sorted(v) if isinstance(v, frozenset) else v for field, v in asdict(layout).items()}
    quick = ".quick" if jit.is_quick() else ""
    jit.write_cache(f"{key}.{name}{quick}.json", json.dumps(table | {"code": code}).encode())
