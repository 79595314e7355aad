"""Kernels: executable plans, and the arrays that they work on.

The loop is compiled by `llvm_emitter` if llvmlite is installed. Otherwise `interpreter` evaluates the plan.
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
ALL_BITS = 0xFFFFFFFF  # mask of a row in which all sensors have a sample
MAX_BITS = 32  # bits of a mask, one for each sensor


def allocate(shape: Sequence[int], zero: bool = True) -> Array:
    """Return an array of the given shape that starts at a cache line."""
    size = math.prod(shape)
    a = (np.zeros if zero else np.empty)(size + LINE)
    first = -a.ctypes.data // 8 % LINE
    return a[first : first + size].reshape(tuple(shape))


@dataclass
class Arena:
    """Arrays that are reused from call to call, so that the operating system maps their pages only once."""

    kept: dict[str, Array] = field(default_factory=dict)

    def take(self, name: str, shape: Sequence[int], zero: bool = True) -> Array:
        """Return the array of this name. The array is set to zero if `zero`; otherwise it has arbitrary values."""
        size = math.prod(shape)
        if name not in self.kept or self.kept[name].size < size:
            self.kept[name] = allocate((size,), zero=False)
        a = self.kept[name][:size].reshape(tuple(shape))
        if zero:
            a[...] = 0.0
        return a


class ArenaPool:
    """Pool of arenas, with one arena for each thread that works at the same time."""

    def __init__(self) -> None:
        self._free: list[Arena] = []
        self._lock = threading.Lock()

    @contextmanager
    def borrow(self) -> Iterator[Arena]:
        """Lend an arena to the caller for the duration of the context."""
        with self._lock:
            arena = self._free.pop() if self._free else Arena()
        try:
            yield arena
        finally:
            with self._lock:
                self._free.append(arena)


Loop = Callable[[int, int, Mask, Mapping[str, Array], AbstractSet[str]], None]
_warned: list[str] = []  # not empty after the warning that llvmlite is missing: it is shown once a process


class Kernel:
    """Executable plan.

    Parameters
    ----------
    plan : Plan
        Plan to run.
    compiled : bool, optional
        False: interpret the plan, which is slow (reference of the tests). None: compile if llvmlite is installed.

    Attributes
    ----------
    layout : Layout
        Layout of the arrays.
    code : str
        Key of the machine code in the cache; empty if the plan is interpreted.
    """

    _entry: Callable[..., None] | None = None  # entry point of the machine code; None if the plan is interpreted

    def __init__(self, plan: Plan, compiled: bool | None = None) -> None:
        """Compile or interpret the plan."""
        self.layout, self.code = plan.layout, ""
        self._make: Callable[[], Plan] = lambda: plan
        if compiled is None:
            compiled = jit.AVAILABLE
            if not compiled and not _warned:
                _warned.append("llvmlite")
                warnings.warn(
                    "llvmlite is not installed: estimation works, but thousands of times slower; install llvmlite",
                    SeatrialWarning,
                    stacklevel=2,
                )
        self._loop: Loop = self._compile() if compiled else self._interpret()

    @classmethod
    def from_cache(cls, layout: Layout, code: str, make: Callable[[], Plan]) -> Kernel | None:
        """Return a kernel with cached machine code.

        Parameters
        ----------
        layout : Layout
            Layout of the arrays.
        code : str
            Key of the machine code.
        make : Callable[[], Plan]
            Builds the plan, if the plan is needed later.

        Returns
        -------
        Kernel or None
            None if the machine code is not in the cache.
        """
        loaded = jit.load_known(code, "kernel")
        if loaded is None:
            return None
        self = cls.__new__(cls)
        self.layout, self._make, self.code = layout, make, code
        self._loop = self._linked(*loaded)
        return self

    @cached_property
    def plan(self) -> Plan:
        """Plan of the kernel, built on first use."""
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
        """Run the kernel over ``n_rows`` rows and return all arrays by name.

        Parameters
        ----------
        n_rows : int
            Number of rows, at least 1.
        mask : Array (n_rows,) of uint32, optional
            Bits of the stages that run in each row. None: all bits are set.
        given : Mapping[str, Array]
            Contiguous arrays by name, of the shapes of ``Layout.shape``. Results among them are written in place.
            Other arrays start from zero, except arrays in rows: their rows are undefined until a stage writes them.
        groups : int
            Number of groups of lanes.
        per_row : Set[str]
            Summed results that are kept for each row instead.
        arena : Arena, optional
            Memory for the arrays that are not given. These arrays are valid until the next use of the arena.

        Returns
        -------
        dict[str, Array]
            All arguments and results.

        Raises
        ------
        ValueError
            If the mask or an array has the wrong type, shape or memory order.
        """
        layout, take = self.layout, (arena or Arena()).take
        mask = np.full(n_rows, ALL_BITS, np.uint32) if mask is None else mask
        if n_rows < 1 or mask.dtype != np.uint32 or mask.shape != (n_rows,) or not mask.flags.c_contiguous:
            raise ValueError(f"mask: expected a contiguous array of {n_rows} uint32, at least one")
        arrays: dict[str, Array] = {}
        for name in layout.sizes:
            shape = layout.shape(name, n_rows, groups, name in per_row)
            a = given[name] if name in given else take(name, shape, name not in layout.rows)
            if a.dtype != np.float64 or a.size != math.prod(shape) or not a.flags.c_contiguous:
                raise ValueError(f"{name}: expected contiguous doubles of shape {shape}, got {a.dtype} {a.shape}")
            arrays[name] = a
        self._loop(n_rows, groups, mask, arrays, per_row)
        return arrays

    def segments(
        self, start: Sequence[int], stop: Sequence[int], given: Mapping[str, Array], begin: Array, wanted: Sequence[str]
    ) -> dict[str, Array]:
        """Run over many segments of the same rows, with all sensors, and return the last row of each segment.

        Parameters
        ----------
        start, stop : Sequence[int] (n,)
            Rows [start, stop) of each segment.
        given : Mapping[str, Array]
            Arrays in rows for all rows, and the arrays that all segments share.
        begin : Array (n, size)
            Initial value of the carried array for each segment.
        wanted : Sequence[str]
            Names of the arrays in rows to return.

        Returns
        -------
        dict[str, Array (n, size)]
            Last row of each segment, by name.

        Raises
        ------
        ValueError
            If a segment is empty or outside the given rows, or if an array has the wrong type, shape or memory order.

        Notes
        -----
        For short segments, separate calls of the kernel would spend most of their time on the preparation of arrays.
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
            raise ValueError(f"segments: each needs a start value and at least one of the {rows_given} given rows")
        longest = max(lengths, default=0)
        last_rows = {name: np.empty((len(start), layout.sizes[name])) for name in wanted}
        state, mask = np.array(begin, dtype=np.float64, order="C"), np.full(longest, ALL_BITS, np.uint32)
        arrays, moves = {}, []
        for name, size in layout.sizes.items():
            own = state if name == carried else given.get(name)
            a = allocate(layout.shape(name, longest, 1)) if own is None else own
            if a.dtype != np.float64 or (a.size % size if size else a.size) or not a.flags.c_contiguous:
                raise ValueError(f"{name}: expected contiguous doubles, {size} in each row, got {a.dtype} {a.shape}")
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
            for name, into in last_rows.items():
                into[k] = arrays[name][last - first - 1]
        return last_rows

    def seeds(self, size: int, chosen: Sequence[int], groups: int | None = None) -> Array:
        """Return unit vectors (groups, size, width): lane j has a one at entry ``chosen[j]``."""
        width = self.layout.width
        groups = groups or self.groups(len(chosen))
        unit = np.zeros((groups, size, width))
        lane = np.arange(len(chosen))
        unit[lane // width, list(chosen), lane % width] = 1.0
        return unit

    def groups(self, n_lanes: int) -> int:
        """Return the number of groups for this number of lanes."""
        return max(1, -(-n_lanes // self.layout.width))

    def _compile(self) -> Loop:
        from seatrial.ident.engine.llvm_emitter import LlvmEmitter

        ir = LlvmEmitter(self.plan).ir()
        self.code = jit.machine_code_key(ir)
        return self._linked(*jit.load_machine_code(ir, "kernel"))

    def _linked(self, library: Any, address: int) -> Loop:
        """Return the loop that calls the machine code at this address."""
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
