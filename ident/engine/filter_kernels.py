"""Kernels of a filter: programs that run over all rows of a record, compiled on first use or loaded from the cache."""

from __future__ import annotations

import gc
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any
from weakref import WeakValueDictionary, ref

from seatrial.ident.engine import jit, kernel_cache
from seatrial.ident.engine.array_layout import ROWS
from seatrial.ident.engine.kernel import MAX_BITS, Kernel
from seatrial.ident.model import Model

if TYPE_CHECKING:
    from seatrial.ident.engine.ekf_graph import EkfGraphs
    from seatrial.ident.engine.filter_plans import Plans
    from seatrial.ident.engine.loop_plan import Plan

PARTS = ("states", "inputs", "sensors", "stages", "effects")  # of a model, on which its kernels depend
_known: WeakValueDictionary[str, FilterKernels] = WeakValueDictionary()  # by ``FilterKernels.key``
# by the id of the model, so that the model is traced only once
_by_model: dict[tuple[int, bool, bool], tuple[ref[Model], ref[FilterKernels]]] = {}
# Only the most recent kernels stay alive. A search with refits makes hundreds of them, of some megabytes each.
_recent: deque[FilterKernels] = deque(maxlen=12)
_lock = threading.RLock()  # CasADi and LLVM build one kernel at a time


def filter_kernels_for(model: Model, *, covariance: bool = True, joseph: bool = False) -> FilterKernels:
    """Return the kernels of a model's filter. Models that differ only in parameter values share them.

    Kernels are compiled programs that run over all rows of a record. The 12 `FilterKernels` that were requested last
    stay in memory, and others as long as a caller refers to them. As long as it is in memory, a repeated call returns
    the same object.

    Parameters
    ----------
    model : Model
        Model to filter.
    covariance : bool
        True for the extended Kalman filter, False for simulation (output error).
    joseph : bool
        Whether to update the covariance in Joseph's form, which keeps it positive in spite of rounding.

    Returns
    -------
    FilterKernels
        Kernels, each of which is compiled on first use, or loaded from the cache on disk.

    Raises
    ------
    ValueError
        If the model has more than 32 sensors, or if its functions cannot be recorded by `kernel_cache` and do not
        return one scalar without NaN for each rate and output. If they can be recorded, errors of its functions are
        raised at the first use of a kernel.
    """
    with _lock:
        at = id(model), covariance, joseph
        known_model, programs = _by_model.get(at, (None, None))
        kernels = programs() if programs and known_model and known_model() is model else None
        if kernels is None:
            kernels = next((k for k in _recent if k.are_of(model, covariance, joseph)), None)
            if kernels is None:
                new = FilterKernels(model, covariance, joseph)
                kernels = _known.setdefault(new.key, new)
            _by_model[at] = ref(model, lambda _: _by_model.pop(at, None)), ref(kernels)
        if kernels in _recent:
            _recent.remove(kernels)
        _recent.append(kernels)
        return kernels


@contextmanager
def _without_collection() -> Iterator[None]:
    """Context without garbage collection, which would search the many small objects of a plan again and again."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


class FilterKernels:
    """Kernels of one model's filter: programs that run over all rows (instants) of a record.

    Each is compiled, or loaded from the cache on disk, on first use. `filter_plans.Plans` describes the arrays of each
    kernel.

    Attributes
    ----------
    key : str
        SHA-256 hash (hexadecimal) of everything that the kernels depend on. It identifies them in this process and in
        the cache on disk.
    """

    def __init__(self, model: Model, covariance: bool, joseph: bool) -> None:
        """Store the options of the filter and compute `key`. Kernels are compiled on first use.

        ``covariance``: True for the extended Kalman filter, False for simulation. ``joseph``: whether the covariance is
        updated in Joseph's form.
        """
        self._model, self._covariance, self._joseph = model, covariance, joseph
        traced_key = kernel_cache.kernel_key(model, covariance, joseph) if len(model.sensors) <= MAX_BITS else None
        self._cache_key = traced_key if jit.AVAILABLE else None
        self.key = traced_key or self.graphs.key

    def are_of(self, model: Model, covariance: bool, joseph: bool) -> bool:
        """Return whether these are the kernels of a model that has the same parts, with other parameter values.

        The parts have to be the same objects, as after `Model.with_values`. False says nothing: equal parts may have
        the same kernels. ``covariance`` and ``joseph`` are the options of the filter.
        """
        own = self._model
        return (
            (covariance, joseph, model.second_order) == (self._covariance, self._joseph, own.second_order)
            and all(getattr(model, part) is getattr(own, part) for part in PARTS)
            and [p.name for p in model.parameters] == [p.name for p in own.parameters]
        )

    @cached_property
    def graphs(self) -> EkfGraphs:
        """CasADi expressions of the model's filter, built on first use. Kernels from the cache do not need them."""
        from seatrial.ident.engine.ekf_graph import EkfGraphs

        return EkfGraphs(self._model, covariance=self._covariance, joseph=self._joseph)

    @cached_property
    def _plans(self) -> Plans:
        """Plans (descriptions before compilation) of the kernels, built on first use."""
        from seatrial.ident.engine.filter_plans import Plans

        return Plans(self.graphs)

    @cached_property
    def value(self) -> Kernel:
        """Kernel (program that runs over all rows of a record) of the log-likelihood of the record."""
        return self._kernel("value")

    @cached_property
    def forward(self) -> Kernel:
        """Kernel (program over all rows of a record) of the log-likelihood that also stores the tape.

        The tape has, for each row, the values that the kernel `backward` needs.
        """
        return self._kernel("forward")

    @cached_property
    def backward(self) -> Kernel:
        """Kernel (program over all rows of a record) of the gradient of the log-likelihood by all parameters.

        It is the adjoint of the filter. It runs after `forward`, from the last row to the first.
        """
        return self._kernel("backward")

    def has(self, name: str) -> bool:
        """Return whether the kernel with this name (``tangent``, ``simulate``, ...) is in memory already."""
        return name in vars(self)

    @cached_property
    def tangent(self) -> Kernel:
        """Kernel (program over all rows of a record) of log-likelihood, score and Fisher information.

        The score is the gradient of the log-likelihood by chosen parameters. The derivatives are in single precision.
        """
        return self._kernel("tangent")

    @cached_property
    def tangent_double(self) -> Kernel:
        """Kernel (program over all rows of a record) that computes what `tangent` does, in double precision."""
        return self._kernel("tangent_double")

    @cached_property
    def filter(self) -> Kernel:
        """Kernel (program over all rows of a record) that returns the output of the filter for each row.

        The output has predicted and filtered states, covariances and innovations. The filter must have a covariance;
        without one the kernel cannot be built.

        It is compiled quickly: its code then takes up to twice as long to run, but a fit runs it only a few times.
        """
        with jit.quick_kernel():
            return self._kernel("filter")

    @cached_property
    def simulate(self) -> Kernel:
        """Kernel (program over all rows of a record) of a simulation without process noise.

        It is valid only for a filter without a covariance; this is not checked.
        """
        return self._kernel("simulate")

    @property
    def tapes(self) -> frozenset[str]:
        """Names of the arrays, with values for each row, that ``forward`` writes and ``backward`` reads (the tape).

        Inputs, samples and interval lengths are not among them. The first access compiles or loads ``backward``.
        """
        layout = self.backward.layout
        return (layout.rows - ROWS).intersection(layout.sizes)

    def _kernel(self, name: str) -> Kernel:
        """Return the kernel with this name (``value``, ``forward``, ...) from the cache on disk.

        If the cache lacks the kernel, it is compiled and stored in the cache. A model whose functions cannot be
        recorded by `kernel_cache` has no key in this cache, so that its plans are built in each process.
        """
        with _lock:

            def plan() -> Plan:
                """Build the plan (description before compilation) of the kernel with this name, anew in each call."""
                with _lock:
                    made: Any = getattr(self._plans, name)()
                    return made  # type: ignore[no-any-return]

            cached = kernel_cache.load_kernel(self._cache_key, name) if self._cache_key else None
            kernel = Kernel.from_cache(*cached, plan) if cached else None
            if kernel is None:
                with _without_collection():
                    kernel = Kernel(plan())
                if self._cache_key:
                    kernel_cache.store_kernel(self._cache_key, name, kernel.layout, kernel.code)
            return kernel
