"""Cache of kernels that is read without CasADi.

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
    """Number without a value that records the operations on it.

    Attributes
    ----------
    lines : list[str]
        All operations recorded so far.
    place : int
        Index of the line that defines this number.
    """

    __slots__ = ("lines", "place")

    def __init__(self, lines: list[str], line: str) -> None:
        self.lines, self.place = lines, len(lines)
        lines.append(line)

    def _then(self, name: str, *operands: Any) -> TracedNumber:
        return TracedNumber(self.lines, f"{name} {' '.join(_name(o) for o in operands)}")

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> TracedNumber:
        if method != "__call__" or options:
            raise TypeError(f"{ufunc.__name__}.{method} cannot be recorded")
        return self._then(ufunc.__name__, *inputs)

    def __bool__(self) -> bool:
        raise TypeError("a condition cannot be recorded")

    def __add__(self, other: Any) -> TracedNumber:
        return self._then("add", self, other)

    def __radd__(self, other: Any) -> TracedNumber:
        return self._then("add", other, self)

    def __sub__(self, other: Any) -> TracedNumber:
        return self._then("subtract", self, other)

    def __rsub__(self, other: Any) -> TracedNumber:
        return self._then("subtract", other, self)

    def __mul__(self, other: Any) -> TracedNumber:
        return self._then("multiply", self, other)

    def __rmul__(self, other: Any) -> TracedNumber:
        return self._then("multiply", other, self)

    def __truediv__(self, other: Any) -> TracedNumber:
        return self._then("divide", self, other)

    def __rtruediv__(self, other: Any) -> TracedNumber:
        return self._then("divide", other, self)

    def __pow__(self, other: Any) -> TracedNumber:
        return self._then("power", self, other)

    def __rpow__(self, other: Any) -> TracedNumber:
        return self._then("power", other, self)

    def __neg__(self) -> TracedNumber:
        return self._then("negative", self)

    def __pos__(self) -> TracedNumber:
        return self

    def __abs__(self) -> TracedNumber:
        return self._then("absolute", self)

    def __lt__(self, other: Any) -> TracedNumber:
        return self._then("less", self, other)

    def __le__(self, other: Any) -> TracedNumber:
        return self._then("less_equal", self, other)

    def __gt__(self, other: Any) -> TracedNumber:
        return self._then("greater", self, other)

    def __ge__(self, other: Any) -> TracedNumber:
        return self._then("greater_equal", self, other)

    def __eq__(self, other: object) -> TracedNumber:  # type: ignore[override]
        return self._then("equal", self, other)

    def __ne__(self, other: object) -> TracedNumber:  # type: ignore[override]
        return self._then("not_equal", self, other)


def _name(operand: Any) -> str:
    """Return the text of an operand of a recorded expression.

    A number that was computed before is written as ``#`` and its index, a constant as ``float.hex``.
    """
    if isinstance(operand, TracedNumber):
        return f"#{operand.place}"
    if isinstance(operand, (int, float, np.integer, np.floating)):
        return float(operand).hex()
    raise TypeError(f"{type(operand).__name__} cannot be recorded")


def kernel_key(model: Model, covariance: bool, joseph: bool) -> str | None:
    """Return the cache key of a model's kernels.

    Two models have the same key only if they have the same kernels.

    Parameters
    ----------
    model : Model
        Model to trace.
    covariance, joseph : bool
        As in `EkfGraphs`.

    Returns
    -------
    str or None
        None if a function of the model cannot be recorded.
    """
    lines: list[str] = []
    try:
        x, u, p = (
            [TracedNumber(lines, f"{kind} {i}") for i in range(len(of))]
            for kind, of in (("x", model.states), ("u", model.inputs), ("p", model.parameters))
        )
        s = model.signals(x, u, p)
        lines += [f"rate {_name(s.rate[v.name])}" for v in model.states]
        lines += [f"output {_name(s.y[o.name])}" for o in model.outputs]
    except Exception:  # an error of the model occurs again in `EkfGraphs`, which reports it
        return None
    noise = ([s.noise for s in model.states], [(s.name, s.outputs) for s in model.sensors])
    names = [p.name for p in model.parameters]
    content = (lines, noise, names, covariance, joseph, model.second_order, _code())
    return hashlib.sha256(repr(content).encode()).hexdigest()


@cache
def _code() -> str:
    """Return a hash of the source code that builds kernels, and of the target machine."""
    folder = Path(__file__).parent
    digest = hashlib.sha256(repr(jit.target()).encode())
    for path in sorted([*folder.glob("*.py"), *(folder.parent / "model").glob("*.py")]):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def load_kernel(key: str, name: str) -> tuple[Layout, str] | None:
    """Return the layout and the key of the machine code of the kernel ``name``. Return None if the cache lacks the
    kernel.
    """
    content = jit.read_cache(f"{key}.{name}.json")
    if content is None:
        return None
    table = json.loads(content)
    sets = {field: frozenset(table[field]) for field in ("rows", "lanes", "carried", "grams")}
    layout = Layout(sizes=table["sizes"], summed=tuple(table["summed"]), width=table["width"], **sets)
    return layout, str(table["code"])


def store_kernel(key: str, name: str, layout: Layout, code: str) -> None:
    """Store the layout and the key of the machine code of a kernel in the cache."""
    table = {field: sorted(v) if isinstance(v, frozenset) else v for field, v in asdict(layout).items()}
    jit.write_cache(f"{key}.{name}.json", json.dumps(table | {"code": code}).encode())
