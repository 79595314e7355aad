"""Kernels: executable plans, and the arrays that they work on.

The loop is compiled (`llvm_emitter`) where llvmlite is installed, else interpreted (`interpreter`).
"""

from __future__ import annotations

import ctypes
import math
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.errors import SeatrialWarning
from seatrial.ident.engine import jit
from seatrial.ident.engine.array_layout import Layout
from seatrial.ident.numerics import Array

if TYPE_CHECKING:
    from seatrial.ident.engine.loop_plan import Plan

Mask = NDArray[np.uint32]
LINE = 8  # doubles in a cache line
ALL_BITS = 0xFFFFFFFF
MAX_BITS = 32


def allocate(shape: Sequence[int], zero: bool = True) -> Array:
    """An array that starts at a cache line."""
    size = math.prod(shape)
    a = (np.zeros if zero else np.empty)(size + LINE)
    first = -a.ctypes.data // 8 % LINE
    return a[first : first + size].reshape(tuple(shape))


@dataclass
class Arena:
    """Arrays that are kept from call to call, so that their pages are mapped only once."""

    kept: dict[str, Array] = field(default_factory=dict)

    def take(self, name: str, shape: Sequence[int], zero: bool = True) -> Array:
        size = math.prod(shape)
        if name not in self.kept or self.kept[name].size < size:
            self.kept[name] = allocate((size,), zero=False)
        a = self.kept[name][:size].reshape(tuple(shape))
        if zero:
            a[...] = 0.0
        return a


class ArenaPool:
    """Arenas for as many threads as work at a time."""

    def __init__(self) -> None:
        self._free: list[Arena] = []
        self._lock = threading.Lock()

    @contextmanager
    def borrow(self) -> Iterator[Arena]:
        with self._lock:
            arena = self._free.pop() if self._free else Arena()
        try:
            yield arena
        finally:
            with self._lock:
                self._free.append(arena)


Loop = Callable[[int, int, Mask, Mapping[str, Array], AbstractSet[str]], None]
_warned: list[str] = []


class Kernel:
    """A plan that can be run. ``compiled=False`` interprets it, slowly: the oracle of the tests.

    ``code``: the name of its machine code.
    """

    _entry: Callable[..., None] | None = None  # of the machine code

    def __init__(self, plan: Plan, compiled: bool | None = None) -> None:
        self.layout, self.code = plan.layout, ""
        self._make: Callable[[], Plan] = lambda: plan
        if compiled is None:
            compiled = jit.AVAILABLE
            if not compiled and not _warned:
                _warned.append("said")
                warnings.warn(
                    "llvmlite is not installed: estimation works, but some thousand times slower",
                    SeatrialWarning,
                    stacklevel=2,
                )
        self._loop: Loop = self._compile() if compiled else self._interpret()

    @classmethod
    def at_hand(cls, layout: Layout, code: str, make: Callable[[], Plan]) -> Kernel | None:
        """A kernel whose machine code is there already; None where it is not. ``make``: its plan, should it be
        asked for."""
        found = jit.load_known(code, "kernel")
        if found is None:
            return None
        self = cls.__new__(cls)
        self.layout, self._make, self.code = layout, make, code
        self._loop = self._linked(*found)
        return self

    @cached_property
    def plan(self) -> Plan:
        return self._make()

    def __call__(
        self,
        n_rows: int,
        mask: Mask | None,
        given: Mapping[str, Array],
        *,
        groups: int = 1,
        per_row: AbstractSet[str] = frozenset(),
        arena: Arena | None = None,
    ) -> dict[str, Array]:
        """Run over ``n_rows``; returns all arrays by name.

        mask (n_rows,) uint32, all set if None. Arrays that are not given start from zero and, with an arena, are
        valid until its next use; results among those given (carried, summed, in rows) are written in place.
        Summed results named in ``per_row`` are not summed but have a line for each row.
        """
        layout, take = self.layout, (arena or Arena()).take
        mask = np.full(n_rows, ALL_BITS, np.uint32) if mask is None else mask
        if n_rows < 1 or mask.dtype != np.uint32 or mask.shape != (n_rows,) or not mask.flags.c_contiguous:
            raise ValueError(f"mask: {n_rows} contiguous uint32 wanted, at least one")
        arrays: dict[str, Array] = {}
        for name in layout.sizes:
            shape = layout.shape(name, n_rows, groups, name in per_row)
            a = given[name] if name in given else take(name, shape, name not in layout.rows)
            if a.dtype != np.float64 or a.size != math.prod(shape) or not a.flags.c_contiguous:
                raise ValueError(f"{name}: contiguous doubles of shape {shape} wanted, got {a.dtype} {a.shape}")
            arrays[name] = a
        self._loop(n_rows, groups, mask, arrays, per_row)
        return arrays

    def segments(
        self, start: Sequence[int], stop: Sequence[int], given: Mapping[str, Array], begin: Array, wanted: Sequence[str]
    ) -> dict[str, Array]:
        """Run over many segments of the same rows, with all sensors, and keep the last row of each: where they are
        short, calls one by one would mostly prepare arrays.

        Parameters: start, stop (n,): rows [start, stop) of each; given: the arrays in rows, whole, and what all share;
        begin (n, size): what each carries at its start; wanted: arrays in rows. Returns their last rows (n, size).
        """
        layout, lengths = self.layout, [b - a for a, b in zip(start, stop, strict=True)]
        (carried,) = layout.carried
        rows_given = min(
            (
                given[name].size // size
                for name, size in layout.sizes.items()
                if size and name in layout.rows and name in given
            ),
            default=0,
        )
        if len(begin) != len(lengths) or min(lengths, default=1) < 1 or min(start, default=0) < 0 or (
                max(stop, default=0) > rows_given):  # fmt: skip
            raise ValueError(f"segments: one or more rows of the {rows_given} given wanted, and a beginning for each")
        longest = max(lengths, default=0)
        found = {name: np.empty((len(start), layout.sizes[name])) for name in wanted}
        state, mask = np.array(begin, dtype=np.float64, order="C"), np.full(longest, ALL_BITS, np.uint32)
        arrays, moves = {}, []
        for name, size in layout.sizes.items():
            own = state if name == carried else given.get(name)
            a = allocate(layout.shape(name, longest, 1)) if own is None else own
            if a.dtype != np.float64 or (a.size % size if size else a.size) or not a.flags.c_contiguous:
                raise ValueError(f"{name}: contiguous doubles, {size} a row, wanted, got {a.dtype} {a.shape}")
            arrays[name] = a
            along_rows, along_segments = name in layout.rows and name in given, name == carried
            moves.append((a.ctypes.data, 8 * size * along_rows, 8 * size * along_segments))
        flags = [0] * len(layout.summed)
        for k, (first, last) in enumerate(zip(start, stop, strict=True)):
            if self._entry is None:
                own_rows = {
                    name: a[first:last] if name in given else a[: last - first]
                    for name, a in arrays.items()
                    if name in layout.rows
                }
                self._loop(last - first, 1, mask, arrays | own_rows | {carried: state[k]}, frozenset())
            else:
                at = [a + first * row + k * segment for a, row, segment in moves]
                self._entry(last - first, 1, mask.ctypes.data, *at, *flags)
            for name, into in found.items():
                into[k] = arrays[name][last - first - 1]
        return found

    def seeds(self, size: int, chosen: Sequence[int], groups: int | None = None) -> Array:
        """Unit vectors (groups, size, width): lane j belongs to entry ``chosen[j]``."""
        width = self.layout.width
        groups = groups or self.groups(len(chosen))
        unit = np.zeros((groups, size, width))
        lane = np.arange(len(chosen))
        unit[lane // width, list(chosen), lane % width] = 1.0
        return unit

    def groups(self, n_lanes: int) -> int:
        return max(1, -(-n_lanes // self.layout.width))

    def _compile(self) -> Loop:
        from seatrial.ident.engine.llvm_emitter import LlvmEmitter

        ir = LlvmEmitter(self.plan).ir()
        self.code = jit.machine_code_key(ir)
        return self._linked(*jit.load_machine_code(ir, "kernel"))

    def _linked(self, library: Any, address: int) -> Loop:
        summed, n_arrays = self.layout.summed, len(self.layout.sizes)
        pointers = [ctypes.c_void_p] * (1 + n_arrays)
        entry = self._entry = ctypes.CFUNCTYPE(
            None, ctypes.c_int64, ctypes.c_int64, *pointers, *[ctypes.c_int64] * len(summed)
        )(address)

        def run(n_rows: int, groups: int, mask: Mask, arrays: Mapping[str, Array], per_row: AbstractSet[str]) -> None:
            assert library is not None  # the code lives as long as its library
            entry(
                n_rows,
                groups,
                mask.ctypes.data,
                *[a.ctypes.data for a in arrays.values()],
                *[int(name in per_row) for name in summed],
            )

        return run

    def _interpret(self) -> Loop:
        from seatrial.ident.engine.interpreter import interpret

        plan = self.plan
        return lambda n_rows, groups, mask, arrays, per_row: interpret(plan, n_rows, groups, mask, arrays, per_row)
