"""Kernels of a filter, compiled when first asked for or loaded from the cache."""

from __future__ import annotations

import threading
from collections import deque
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

_known: WeakValueDictionary[str, Programs] = WeakValueDictionary()
_met: dict[tuple[int, bool, bool], tuple[ref[Model], ref[Programs]]] = {}  # by the model's id
_recent: deque[Programs] = deque(maxlen=12)  # kept alive: a search that refits makes hundreds, of some megabytes each
_lock = threading.RLock()  # CasADi and LLVM build one kernel at a time


def programs_for(model: Model, *, covariance: bool = True, joseph: bool = False) -> Programs:
    """The kernels of a model, shared by all models that differ only in their values."""
    with _lock:
        at = id(model), covariance, joseph
        met, programs = _met.get(at, (None, None))
        found = programs() if programs and met and met() is model else None
        if found is None:
            made = Programs(model, covariance, joseph)
            found = _known.setdefault(made.key, made)
            _met[at] = ref(model, lambda _: _met.pop(at, None)), ref(found)
        if found in _recent:
            _recent.remove(found)
        _recent.append(found)
        return found


class Programs:
    """Kernels of a model by name: what each does is said in ``plans.Plans``."""

    def __init__(self, model: Model, covariance: bool, joseph: bool) -> None:
        self._model, self._covariance, self._joseph = model, covariance, joseph
        written = kernel_cache.kernel_key(model, covariance, joseph) if len(model.sensors) <= MAX_BITS else None
        self._kept = written if jit.AVAILABLE else None
        self.key = written or self.graphs.key

    @cached_property
    def graphs(self) -> EkfGraphs:
        from seatrial.ident.engine.ekf_graph import EkfGraphs

        return EkfGraphs(self._model, covariance=self._covariance, joseph=self._joseph)

    @cached_property
    def _plans(self) -> Plans:
        from seatrial.ident.engine.filter_plans import Plans

        return Plans(self.graphs)

    @cached_property
    def value(self) -> Kernel:
        return self._kernel("value")

    @cached_property
    def forward(self) -> Kernel:
        return self._kernel("forward")

    @cached_property
    def backward(self) -> Kernel:
        return self._kernel("backward")

    @cached_property
    def tangent(self) -> Kernel:
        return self._kernel("tangent")

    @cached_property
    def filter(self) -> Kernel:
        return self._kernel("filter")

    @cached_property
    def simulate(self) -> Kernel:
        return self._kernel("simulate")

    @property
    def tapes(self) -> frozenset[str]:
        """Rows in which ``forward`` keeps what ``backward`` needs of it."""
        layout = self.backward.layout
        return (layout.rows - ROWS).intersection(layout.sizes)

    def _kernel(self, name: str) -> Kernel:
        with _lock:

            def plan() -> Plan:
                with _lock:
                    made: Any = getattr(self._plans, name)()
                    return made  # type: ignore[no-any-return]

            known = kernel_cache.load_kernel(self._kept, name) if self._kept else None
            kernel = Kernel.at_hand(*known, plan) if known else None
            if kernel is None:
                kernel = Kernel(plan())
                if self._kept:
                    kernel_cache.store_kernel(self._kept, name, kernel.layout, kernel.code)
            return kernel
