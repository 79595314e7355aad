"""Cache of kernels, read without CasADi, whose import and graphs cost more than the kernels' work.

A model's functions are traced: run on objects that record the operations. The text, with all else that a kernel depends
on (`EkfGraphs.key`) and the code of this package, is the name under which the layout of its arrays
and the name of its machine code are kept beside the latter. A function that does something which cannot be written
down (a condition, an array) has no such name, and its kernels are made anew by way of CasADi.
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


class CachedKernel:
    """A number that is not known yet; operations with it are appended to ``lines``, its own is the one at ``place``."""

    __slots__ = ("lines", "place")

    def __init__(self, lines: list[str], what: str) -> None:
        self.lines, self.place = lines, len(lines)
        lines.append(what)

    def _then(self, name: str, *operands: Any) -> CachedKernel:
        return CachedKernel(self.lines, f"{name} {' '.join(_name(o) for o in operands)}")

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> CachedKernel:
        if method != "__call__" or options:
            raise TypeError(f"{ufunc.__name__}.{method} is not written down")
        return self._then(ufunc.__name__, *inputs)

    def __bool__(self) -> bool:
        raise TypeError("a condition is not written down")

    def __add__(self, other: Any) -> CachedKernel:
        return self._then("add", self, other)

    def __radd__(self, other: Any) -> CachedKernel:
        return self._then("add", other, self)

    def __sub__(self, other: Any) -> CachedKernel:
        return self._then("subtract", self, other)

    def __rsub__(self, other: Any) -> CachedKernel:
        return self._then("subtract", other, self)

    def __mul__(self, other: Any) -> CachedKernel:
        return self._then("multiply", self, other)

    def __rmul__(self, other: Any) -> CachedKernel:
        return self._then("multiply", other, self)

    def __truediv__(self, other: Any) -> CachedKernel:
        return self._then("divide", self, other)

    def __rtruediv__(self, other: Any) -> CachedKernel:
        return self._then("divide", other, self)

    def __pow__(self, other: Any) -> CachedKernel:
        return self._then("power", self, other)

    def __rpow__(self, other: Any) -> CachedKernel:
        return self._then("power", other, self)

    def __neg__(self) -> CachedKernel:
        return self._then("negative", self)

    def __pos__(self) -> CachedKernel:
        return self

    def __abs__(self) -> CachedKernel:
        return self._then("absolute", self)

    def __lt__(self, other: Any) -> CachedKernel:
        return self._then("less", self, other)

    def __le__(self, other: Any) -> CachedKernel:
        return self._then("less_equal", self, other)

    def __gt__(self, other: Any) -> CachedKernel:
        return self._then("greater", self, other)

    def __ge__(self, other: Any) -> CachedKernel:
        return self._then("greater_equal", self, other)

    def __eq__(self, other: object) -> CachedKernel:  # type: ignore[override]
        return self._then("equal", self, other)

    def __ne__(self, other: object) -> CachedKernel:  # type: ignore[override]
        return self._then("not_equal", self, other)


def _name(operand: Any) -> str:
    if isinstance(operand, CachedKernel):
        return f"#{operand.place}"
    if isinstance(operand, (int, float, np.integer, np.floating)):
        return float(operand).hex()
    raise TypeError(f"{type(operand).__name__} is not written down")


def kernel_key(model: Model, covariance: bool, joseph: bool) -> str | None:
    """The same for two models only if their kernels are; None where a function of the model cannot be written down."""
    lines: list[str] = []
    try:
        x, u, p = (
            [CachedKernel(lines, f"{kind} {i}") for i in range(len(of))]
            for kind, of in (("x", model.states), ("u", model.inputs), ("p", model.parameters))
        )
        s = model.signals(x, u, p)
        lines += [f"rate {_name(s.rate[v.name])}" for v in model.states]
        lines += [f"output {_name(s.y[o.name])}" for o in model.outputs]
    except Exception:  # whatever it is, the graphs meet it again and say what is wrong
        return None
    noise = ([s.noise for s in model.states], [(s.name, s.outputs) for s in model.sensors])
    names = [p.name for p in model.parameters]
    what = (lines, noise, names, covariance, joseph, model.second_order, _code())
    return hashlib.sha256(repr(what).encode()).hexdigest()


@cache
def _code() -> str:
    """A hash of what makes kernels of models, and of the machine they are for."""
    folder = Path(__file__).parent
    digest = hashlib.sha256(repr(jit.target()).encode())
    for path in sorted([*folder.glob("*.py"), *(folder.parent / "model").glob("*.py")]):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def load_kernel(key: str, name: str) -> tuple[Layout, str] | None:
    """Layout and name of the machine code of the kernel ``name``; None if it was never made here."""
    content = jit.read_cache(f"{key}.{name}.json")
    if content is None:
        return None
    table = json.loads(content)
    sets = {field: frozenset(table[field]) for field in ("rows", "lanes", "carried", "grams")}
    layout = Layout(sizes=table["sizes"], summed=tuple(table["summed"]), width=table["width"], **sets)
    return layout, str(table["code"])


def store_kernel(key: str, name: str, layout: Layout, code: str) -> None:
    """Keep them for the next process."""
    table = {field: sorted(v) if isinstance(v, frozenset) else v for field, v in asdict(layout).items()}
    jit.write_cache(f"{key}.{name}.json", json.dumps(table | {"code": code}).encode())
