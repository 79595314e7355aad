"""Kernels: programs that run over all rows (instants) of a record, and the arrays that they work on.

A plan describes the program. It is compiled by `llvm_emitter` if llvmlite is installed. Otherwise `interpreter`
evaluates it.
"""

from __future__ import annotations

import ctypes
import math
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.errors import warn
from seatrial.ident.engine import jit, matrix_routines
from seatrial.ident.engine.array_layout import Layout
from seatrial.ident.numerics import Array

if TYPE_CHECKING:
    from seatrial.ident.engine.loop_plan import Plan

Mask = NDArray[np.uint32]
CACHE_LINE = 64  # bytes in a cache line of the processor
ALL_BITS = 0xFFFFFFFF  # mask of a row in which all sensors have a sample: all 32 bits are set
MAX_BITS = 32  # bits of a mask, one for each sensor


def allocate(shape: Sequence[int], zero: bool = True, dtype: type[np.floating] = np.float64) -> Array:
    """Return a new array of the given shape and type whose memory starts at a multiple of 64 bytes.

    This is the start of a cache line of the processor, so that vector instructions are fast. The values are zero if
    ``zero`` is true, otherwise arbitrary.
    """
    n_bytes = math.prod(shape) * np.dtype(dtype).itemsize
    a = (np.zeros if zero else np.empty)(n_bytes + CACHE_LINE, np.uint8)
    first = -a.ctypes.data % CACHE_LINE
    return a[first : first + n_bytes].view(dtype).reshape(tuple(shape))


@dataclass
class Arena:
    """Memory for the arrays of a kernel that is reused from call to call.

    Reuse saves time, because the operating system then maps the pages of the memory only once.

    Attributes
    ----------
    arrays : dict[str, Array]
        Memory by name of the array. A larger memory replaces it if a larger array of the same name is taken.
    """

    arrays: dict[str, Array] = field(default_factory=dict)

    def take(self, name: str, shape: Sequence[int], zero: bool = True, dtype: type[np.floating] = np.float64) -> Array:
        """Return an array of the given shape and type in the memory with this name.

        The next call with the same name returns the same memory, unless it is too small or of another type. The array
        is set to zero if ``zero`` is true; otherwise it has arbitrary values.
        """
        size = math.prod(shape)
        known = self.arrays.get(name)
        if known is None or known.size < size or known.dtype != dtype:
            known = self.arrays[name] = allocate((size,), zero=False, dtype=dtype)
        a = known[:size].reshape(tuple(shape))
        if zero:
            a[...] = 0.0
        return a


class ArenaPool:
    """Pool of arenas (reused memory for the arrays of kernels), with one arena for each thread at work."""

    def __init__(self) -> None:
        """Create a pool without arenas. `borrow` adds an arena whenever all others are lent."""
        self._free: list[Arena] = []
        self._lock = threading.Lock()

    @contextmanager
    def borrow(self) -> Iterator[Arena]:
        """Context that lends an arena (memory for arrays) which no other caller has. Create one if all are lent.

        It never waits for an arena. At the end of the context, also after an error, the arena returns to the pool with
        its memory. Arrays in it must not be used any more.
        """
        with self._lock:
            arena = self._free.pop() if self._free else Arena()
        try:
            yield arena
        finally:
            with self._lock:
                self._free.append(arena)


Loop = Callable[[int, int, Mask, Mapping[str, Array], AbstractSet[str]], None]
_warned: list[str] = []  # not empty after the warning that llvmlite is missing, which is shown once per process


class Kernel:
    """Program that runs over all rows (instants) of a record, such as a filter or its adjoint.

    Parameters
    ----------
    plan : Plan
        Description of the computation in each row, and of the arrays that it reads and writes.
    compiled : bool, optional
        False: interpret the plan, which is slow (reference of the tests). None: compile if llvmlite is installed, else
        interpret. True: compile; RuntimeError is raised without llvmlite.

    Attributes
    ----------
    layout : Layout
        Names, sizes and kinds of the arrays.
    code : str
        Key of the machine code in the cache on disk; empty if the plan is interpreted.
    """

    _entry: Callable[..., None] | None = None  # entry point of the machine code; None if the plan is interpreted

    def __init__(self, plan: Plan, compiled: bool | None = None) -> None:
        """Compile the plan, or load its machine code from the cache, or prepare its interpretation.

        If ``compiled`` is None and llvmlite is missing, a warning is shown once per process. NotImplementedError is
        raised if the plan is compiled and has an operation that cannot be.
        """
        self.layout, self.code = plan.layout, ""
        self._build_plan: Callable[[], Plan] = lambda: plan
        if compiled is None:
            compiled = jit.AVAILABLE
            if not compiled and not _warned:
                _warned.append("llvmlite")
                warn("llvmlite is not installed: estimation works, but thousands of times slower; pip install llvmlite")
        self._loop: Loop = self._compile_loop() if compiled else self._interpreting_loop()

    @classmethod
    def from_cache(cls, layout: Layout, code: str, build_plan: Callable[[], Plan]) -> Kernel | None:
        """Return a kernel with machine code from the cache on disk.

        Parameters
        ----------
        layout : Layout
            Names, sizes and kinds of the arrays.
        code : str
            Key of the machine code, a result of `jit.machine_code_key`.
        build_plan : Callable[[], Plan]
            Function that returns the plan. It is called only if the attribute `plan` is used.

        Returns
        -------
        Kernel or None
            None if the machine code is not in the cache, or if llvmlite is not installed.
        """
        loaded = jit.load_cached_machine_code(code, "kernel", _addresses_of(layout.routines))
        if loaded is None:
            return None
        self = cls.__new__(cls)
        self.layout, self._build_plan, self.code = layout, build_plan, code
        self._loop = self._loop_at_address(*loaded)
        return self

    @cached_property
    def plan(self) -> Plan:
        """Plan of the kernel: its stages (steps in each row) and arrays.

        A kernel from the cache on disk builds it at the first access.
        """
        return self._build_plan()

    def __call__(
        self,
        n_rows: int,
        mask: Mask | None,
        arguments: Mapping[str, Array],
        *,
        groups: int = 1,
        per_row: AbstractSet[str] = frozenset(),
        arena: Arena | None = None,
    ) -> dict[str, Array]:
        """Run the kernel over ``n_rows`` rows of a record and return all of its arrays by name.

        Parameters
        ----------
        n_rows : int
            Number of rows, at least 1.
        mask : Array (n_rows,) of uint32, optional
            Bits of the stages that run in each row. In a filter, bit k is set if sensor k has a sample. None: all bits
            are set.
        arguments : Mapping[str, Array]
            Contiguous arrays by name, of the type ``Layout.dtype`` and with the number of items of ``Layout.shape``.
            Results among them, and arrays whose values pass from row to row, are written in place. Sums are added to
            their present values. Names that the kernel does not use are ignored. Missing arrays start from zero, except
            arrays with entries for each row: these are undefined in rows in which they are not written.
        groups : int
            Number of groups of ``layout.width`` lanes. A lane is one number of each entry of certain arrays, for
            example the derivative by one parameter.
        per_row : Set[str]
            Names of results that are summed over the rows otherwise, and of which the contribution of each row is
            wanted instead.
        arena : Arena, optional
            Memory for the arrays that are not in ``arguments``. These arrays are valid until the next use of the arena.
            None: new memory.

        Returns
        -------
        dict[str, Array]
            All arrays of the kernel by name, including those of ``arguments``.

        Raises
        ------
        ValueError
            If ``n_rows`` is less than 1, or if the mask or an array has the wrong type, size or memory order.
        """
        layout, take = self.layout, (arena or Arena()).take
        mask = np.full(n_rows, ALL_BITS, np.uint32) if mask is None else mask
        if n_rows < 1 or mask.dtype != np.uint32 or mask.shape != (n_rows,) or not mask.flags.c_contiguous:
            raise ValueError(f"mask: expected a contiguous array of {n_rows} uint32, at least one")
        arrays: dict[str, Array] = {}
        for name in layout.sizes:
            shape = layout.shape(name, n_rows, groups, name in per_row)
            a = arguments[name] if name in arguments else take(name, shape, name not in layout.rows, layout.dtype(name))
            if a.dtype != layout.dtype(name) or a.size != math.prod(shape) or not a.flags.c_contiguous:
                raise ValueError(
                    f"{name}: expected contiguous {np.dtype(layout.dtype(name))} of shape {shape}, got {a.dtype} "
                    f"{a.shape}"
                )
            arrays[name] = a
        self._loop(n_rows, groups, mask, arrays, per_row)
        return arrays

    def segments(
        self,
        start: Sequence[int],
        stop: Sequence[int],
        arguments: Mapping[str, Array],
        initial_values: Array,
        wanted: Sequence[str],
    ) -> dict[str, Array]:
        """Run the kernel over many intervals of one record, each with its own initial state; return the last rows.

        All steps run in all rows, as if every sensor had a sample in each row. The kernel must have exactly one array
        whose values pass from row to row, such as the state.

        Parameters
        ----------
        start, stop : Sequence[int] (n,)
            Each interval (segment) consists of the rows from ``start`` to ``stop - 1``. Intervals may overlap.
        arguments : Mapping[str, Array]
            Contiguous float64 arrays by name: those with entries for each row, for all rows of the record, and those
            that all intervals share, for example parameters.
        initial_values : Array (n, size)
            Initial values of the array that passes from row to row, for each interval. It is not changed.
        wanted : Sequence[str]
            Names of the results to return, which must have entries for each row. An unknown name raises KeyError.

        Returns
        -------
        dict[str, Array (n, size)]
            Values in the last row of each interval, by name of the array.

        Raises
        ------
        ValueError
            If an interval is empty or outside the record, if their number differs from that of the initial values, or
            if an array has the wrong type, size or memory order.

        Notes
        -----
        For short intervals, separate calls of the kernel would spend most of their time on the preparation of arrays.
        """
        layout, lengths = self.layout, [b - a for a, b in zip(start, stop, strict=True)]
        (carried,) = layout.carried
        n_available = min(
            (
                arguments[name].size // size
                for name, size in layout.sizes.items()
                if size and name in layout.rows and name in arguments
            ),
            default=0,
        )
        if len(initial_values) != len(lengths) or min(lengths, default=1) < 1 or min(start, default=0) < 0 or (
                max(stop, default=0) > n_available):  # fmt: skip
            raise ValueError(
                "start, stop: each segment of rows needs one initial value and at least one row, and has to lie within "
                f"the {n_available} rows of the arrays"
            )
        longest = max(lengths, default=0)
        last_rows = {name: np.empty((len(start), layout.sizes[name])) for name in wanted}
        state, mask = np.array(initial_values, dtype=np.float64, order="C"), np.full(longest, ALL_BITS, np.uint32)
        arrays, moves = {}, []
        for name, size in layout.sizes.items():
            own = state if name == carried else arguments.get(name)
            a = allocate(layout.shape(name, longest, 1)) if own is None else own
            if a.dtype != np.float64 or (a.size % size if size else a.size) or not a.flags.c_contiguous:
                raise ValueError(f"{name}: expected contiguous doubles, {size} in each row, got {a.dtype} {a.shape}")
            arrays[name] = a
            along_rows, along_segments = name in layout.rows and name in arguments, name == carried
            moves.append((a.ctypes.data, 8 * size * along_rows, 8 * size * along_segments))
        flags = [0] * len(layout.summed)
        for k, (first, last) in enumerate(zip(start, stop, strict=True)):
            if self._entry is None:
                own_rows = {
                    name: a[first:last] if name in arguments else a[: last - first]
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
        """Return the directions of derivatives for a kernel of sensitivities, as an array (groups, size, width).

        Each lane (one of ``layout.width`` numbers of an entry) computes the derivative by one parameter. Its direction
        is a unit vector of ``size`` entries, one for each parameter. Lane j, which is lane j % width of group
        j // width, has a one at entry ``chosen[j]``. Unused lanes have zeros. With ``groups`` None or 0, the array has
        the least number of groups that hold all of ``chosen``, at least one.
        """
        width = self.layout.width
        groups = groups or self.groups(len(chosen))
        unit = np.zeros((groups, size, width), self.layout.dtype("dp"))
        lane = np.arange(len(chosen))
        unit[lane // width, list(chosen), lane % width] = 1.0
        return unit

    def groups(self, n_lanes: int) -> int:
        """Return the least number of groups of ``layout.width`` lanes that hold ``n_lanes`` lanes, at least 1.

        A lane is one number of each entry of certain arrays, for example the derivative by one parameter.
        """
        return max(1, -(-n_lanes // self.layout.width))

    def _compile_loop(self) -> Loop:
        """Compile the plan, or load its machine code from the cache on disk. Return the function that runs it.

        The function runs the loop over the rows of a record. The key of the machine code is stored in `code`.
        """
        from seatrial.ident.engine.llvm_emitter import LlvmEmitter

        emitter = LlvmEmitter(self.plan)
        ir = emitter.ir()
        self.code = jit.machine_code_key(ir)
        self.layout = replace(self.layout, routines=tuple(sorted(emitter.routines)))
        return self._loop_at_address(*jit.load_machine_code(ir, "kernel", routines=_addresses_of(self.layout.routines)))

    def _loop_at_address(self, library: Any, address: int) -> Loop:
        """Return a function that runs the machine code at the address ``address`` over the rows of a record.

        The function holds a reference to ``library``, because the machine code is freed with the library. The entry
        point of the code is also stored, for `segments`.
        """
        summed, n_arrays = self.layout.summed, len(self.layout.sizes)
        pointers = [ctypes.c_void_p] * (1 + n_arrays)
        entry = self._entry = ctypes.CFUNCTYPE(
            None, ctypes.c_int64, ctypes.c_int64, *pointers, *[ctypes.c_int64] * len(summed)
        )(address)

        def run(n_rows: int, groups: int, mask: Mask, arrays: Mapping[str, Array], per_row: AbstractSet[str]) -> None:
            """Run the machine code over all rows. The results are written into ``arrays``, in place.

            ``mask``: for each row, the bits of the stages that run. ``per_row``: names of summed results of which the
            contribution of each row is wanted.
            """
            assert library is not None  # the code lives as long as its library
            entry(
                n_rows,
                groups,
                mask.ctypes.data,
                *[a.ctypes.data for a in arrays.values()],
                *[int(name in per_row) for name in summed],
            )

        return run

    def _interpreting_loop(self) -> Loop:
        """Return a function that runs the plan over the rows of a record without compilation."""
        from seatrial.ident.engine.interpreter import interpret

        plan = self.plan
        return lambda n_rows, groups, mask, arrays, per_row: interpret(plan, n_rows, groups, mask, arrays, per_row)


def _addresses_of(routines: Sequence[str]) -> dict[str, int]:
    """Return the addresses of routines by name. Those that are not in memory yet are compiled or loaded."""
    return {name: matrix_routines.address_of(name) for name in routines}
