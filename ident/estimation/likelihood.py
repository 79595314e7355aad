"""Prediction-error likelihood by a continuous-discrete extended Kalman filter (thesis eq. 2.3, constant put right).

    ln L = -1/2 sum [ e' S^-1 e + ln |S| + r ln 2 pi ]

with innovations ``e`` and their covariance ``S``; scalar measurements are processed sequentially. The mean is
integrated by Runge-Kutta 4 over each interval, the covariance by the transition matrix and Simpson's rule.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.data import InitialCondition, Prepared, Preparer, Record, initial_condition
from seatrial.ident.engine import ArenaPool, Kernel, Programs, programs_for
from seatrial.ident.model import LIKELY, Model, robust_weight
from seatrial.ident.numerics import Array

# A row takes 4 kB on its way back, and 4 kB of covariances. Of a longer record all is kept of one piece at a time, and
# of the others the state at their start, from where they are run again; a piece fits the cache of the processor.
WHOLE, PIECE = 16384, 1024  # rows


@dataclass(frozen=True)
class LikelihoodAndScore:
    """Log-likelihood, its gradient, the score (n_free,), and the expected Fisher information (n_free, n_free), in the
    parameters' own units; ``by_row`` (n_rows, n_free): contributions of the rows to the score, where they were asked
    for."""

    value: float
    gradient: Array
    information: Array
    by_row: Array | None = None


class Covariances(NamedTuple):
    """Of neighbouring rows, each (n, n_states, n_states): of the state before and after a row's samples, and the
    transition to the next row."""

    P_pred: Array
    P_filt: Array
    Phi: Array


@dataclass(frozen=True)
class FilterResult:
    """EKF output per time step: predicted and filtered means and covariances, and innovations.

    t (n_rows,) [s]; x_pred, x_filt (n_rows, n_states): state means before and after the row's samples; covariances: of
    a slice of rows, which are computed again where a record is long (``pieces``: as they are computed together); e
    (n_rows, n_outputs): measured minus predicted, NaN where nothing was measured; R (n_outputs,): variances of the
    measurement noise; eps, S (n_rows, n_outputs): innovations and their variances in sequential processing, each given
    those before it in its row, so that eps / sqrt(S) is white; ll (n_rows,): contribution of the row to ln L; allowed
    (n_outputs,): outputs with the outlier model, None: none; left (n_rows, n_outputs): outliers before the first
    measurement that the filter was given.
    """

    t: Array
    x_pred: Array
    x_filt: Array
    covariances: Callable[[slice], Covariances]
    e: Array
    R: Array
    eps: Array
    S: Array
    ll: Array
    allowed: NDArray[np.bool_] | None = None
    left: NDArray[np.bool_] | None = None

    @property
    def pieces(self) -> list[slice]:
        """Rows whose covariances are computed together, in order."""
        return _pieces(self.t.size)

    @property
    def P_pred(self) -> Array:
        """Of all rows (n_rows, n_states, n_states), before their samples."""
        return self.covariances(slice(None)).P_pred

    @property
    def P_filt(self) -> Array:
        """Of all rows (n_rows, n_states, n_states), after their samples."""
        return self.covariances(slice(None)).P_filt

    @property
    def Phi(self) -> Array:
        """Transitions from all rows to the next (n_rows, n_states, n_states)."""
        return self.covariances(slice(None)).Phi

    def output_variance(self, H: Array) -> Array:
        """Variances of the predicted outputs (n_rows, n_outputs), whose slopes by the state are H (n_rows, n_outputs,
        n_states)."""
        each = [np.einsum("kil,kil->ki", H[rows] @ self.covariances(rows).P_pred, H[rows]) for rows in self.pieces]
        return np.concatenate(each) + self.R

    @property
    def value(self) -> float:
        """Log-likelihood of the record."""
        return float(self.ll.sum())

    @property
    def standardised(self) -> Array:
        """Standardised innovations (n_rows, n_outputs): white if the model is right. Outliers are NaN."""
        return np.where(self.outliers, np.nan, self.eps / np.sqrt(self.S))

    @cached_property
    def outliers(self) -> NDArray[np.bool_]:
        """Samples that are more likely outliers than not (n_rows, n_outputs)."""
        left = np.zeros(self.eps.shape, dtype=bool) if self.left is None else self.left
        return (
            left if self.allowed is None else left | self.allowed & (robust_weight(self.eps / np.sqrt(self.S)) < LIKELY)
        )


class Likelihood:
    """The likelihood of any record under a model, as a function of the values of its parameters.

    ``values`` is always an array over ``model.parameters`` in order. Calls may run in threads. ``joseph`` uses
    the longer form of the covariance update. A parameter vector that makes the filter diverge gives NaN.
    ``process_noise=False`` is output error (``seatrial.ident.estimation.output_error``): a certain initial state and no
    process noise.
    """

    def __init__(self, model: Model, *, joseph: bool = False, process_noise: bool = True) -> None:
        self.model = model
        self.process_noise = process_noise
        self._joseph = joseph
        self._prepare = Preparer(model)
        self._arenas = ArenaPool()
        self._index = {p.name: i for i, p in enumerate(model.parameters)}

    @cached_property
    def _programs(self) -> Programs:
        return programs_for(self.model, covariance=self.process_noise, joseph=self._joseph)

    def value(self, record: Record, values: Array) -> float:
        """Log-likelihood of a record, with all its constants; values (n_parameters,)."""
        data, start = self._start(record, values)
        kernel = self._programs.value
        with self._arenas.borrow() as arena:
            given = {**_inputs(kernel, data), "p": _own(values), "s": start.s}
            done = kernel(data.n_rows, data.mask, given, arena=arena)
            return float(done["ll"][0])

    def gradient(self, record: Record, values: Array) -> tuple[float, Array]:
        """Log-likelihood and its gradient by all parameters (n_parameters,), by the adjoint filter."""
        data, start = self._start(record, values)
        there, back = self._programs.forward, self._programs.backward
        p, ll, state = _own(values), np.zeros(1), start.s
        pieces, begun = _pieces(data.n_rows), list[Array]()
        given = {"p": p, "g": np.zeros(p.size), "bar": np.zeros(state.size)}

        def forward(piece: slice, s: Array, total: Array) -> dict[str, Array]:
            rows = {**_inputs(there, data, piece), "p": p, "s": s, "ll": total}
            return there(piece.stop - piece.start, data.mask[piece], rows, arena=arena)

        with self._arenas.borrow() as arena:
            for piece in pieces:
                begun.append(state.copy())
                done = forward(piece, state, ll)
            for piece, s in zip(reversed(pieces), reversed(begun), strict=True):
                if piece is not pieces[-1]:
                    done = forward(piece, s, np.zeros(1))
                tapes = {name: done[name] for name in self._programs.tapes}
                rows = {**_inputs(back, data, piece), **given, **tapes}
                back(piece.stop - piece.start, data.mask[piece], rows, arena=arena)
        value, gradient = float(ll[0]), given["g"]
        for entry, parameter, slope in start.tangent:
            gradient[parameter] += slope * given["bar"][entry]
        return value, gradient

    def scores(
        self, record: Record, values: Array, free: Sequence[str] | None = None, *, by_row: bool = False
    ) -> LikelihoodAndScore:
        """Log-likelihood, score and expected Fisher information, by forward sensitivities.

        Parameters: values (n_parameters,); free: names to differentiate by, by default those free in the model;
        by_row: return the contributions of the rows to the score, too.
        """
        free = self.model.free if free is None else free
        data, start = self._start(record, values)
        kernel = self._programs.tangent
        chosen = [self._index[name] for name in free]
        groups, width, n = kernel.groups(len(free)), kernel.layout.width, len(free)
        lane_of = {parameter: lane for lane, parameter in enumerate(chosen)}
        with self._arenas.borrow() as arena:
            ds = arena.take("ds", (groups, start.s.size, width))
            for entry, parameter, slope in start.tangent:
                if parameter in lane_of:
                    lane = lane_of[parameter]
                    ds[lane // width, entry, lane % width] += slope
            given = {
                **_inputs(kernel, data),
                "p": _own(values),
                "s": start.s,
                "ds": ds,
                "dp": kernel.seeds(len(self._index), chosen, groups),
            }
            done = kernel(
                data.n_rows, data.mask, given, groups=groups, arena=arena, per_row={"dll"} if by_row else frozenset()
            )
            dll = done["dll"].reshape(-1, groups * width)[:, :n].copy()
            information = _symmetric(done["fisher"])[:n, :n]
            value = float(done["ll"][0])
        return LikelihoodAndScore(value, dll.sum(axis=0), information, dll if by_row else None)

    def value_by_row(self, record: Record, values: Array) -> Array:
        """Log-likelihood by row (n_rows,), by the kernel that a search has compiled already."""
        data, start = self._start(record, values)
        kernel = self._programs.tangent
        with self._arenas.borrow() as arena:
            given = {**_inputs(kernel, data), "p": _own(values), "s": start.s}
            done = kernel(data.n_rows, data.mask, given, arena=arena, per_row={"ll"})
            return done["ll"][:, 0].copy()

    def filter(self, record: Record, values: Array) -> FilterResult:
        """The filter's output for a record; values (n_parameters,). Raises ValueError without process noise."""
        if not self.process_noise:
            raise ValueError("output error has no filter; simulate with seatrial.ident.estimation.output_error")
        data, start = self._start(record, values)
        kernel, n, n_rows, p = self._programs.filter, len(self.model.states), data.n_rows, _own(values)
        outputs, pieces = len(self.model.outputs), _pieces(data.n_rows)

        def run(rows: slice, s: Array) -> dict[str, Array]:
            own = {
                f"{kind}{bit}": np.full((rows.stop - rows.start, len(sensor.outputs)), np.nan)
                for bit, sensor in enumerate(self.model.sensors)
                for kind in "eS"
            }
            given = {**_inputs(kernel, data, rows), "p": p, "s": s, **own}
            return kernel(rows.stop - rows.start, data.mask[rows], given, per_row={"ll"})

        x_pred, x_filt = np.empty((2, n_rows, n))
        e, eps, S = np.empty((3, n_rows, outputs))
        ll, state, begun = np.empty(n_rows), start.s, list[Array]()
        for rows in pieces:
            begun.append(state.copy())
            done = run(rows, state)
            x_pred[rows], x_filt[rows] = done["predicted"][:, :n], done["filtered"][:, :n]
            e[rows], ll[rows] = done["e"], done["ll"][:, 0]
            for kind, into in (("e", eps), ("S", S)):
                into[rows] = np.hstack([done[f"{kind}{bit}"] for bit in range(len(self.model.sensors))])
        last = {len(pieces) - 1: _covariances(done, n)}  # of the piece that was asked for last

        def covariances(wanted: slice) -> Covariances:
            first, end, _ = wanted.indices(n_rows)
            parts = []
            for k, rows in enumerate(pieces):
                if rows.start < end and first < rows.stop:
                    if k not in last:
                        last.clear()
                        last[k] = _covariances(run(rows, begun[k].copy()), n)
                    parts.append([a[max(first - rows.start, 0) : end - rows.start] for a in last[k]])
            return Covariances(*(p[0] if len(p) == 1 else np.concatenate(p) for p in zip(*parts, strict=True)))

        R = np.array([p[self._index[o.noise]] ** 2 for o in self.model.outputs])
        robust = np.array([o.robust for o in self.model.outputs])
        return FilterResult(record.t, x_pred, x_filt, covariances, e, R, eps, S, ll, robust, data.outliers)

    def forecast(self, record: Record, values: Array, x: Array, P: Array, first: int, last: int) -> tuple[Array, Array]:
        """Prediction from the inputs alone, without measurements.

        Parameters: values (n_parameters,); x (n_states,), P (n_states, n_states): mean and covariance at the row
        ``first``. Returns: means (n, n_states) and covariances (n, n_states, n_states) up to the row ``last``.
        """
        data, kernel, n = self._prepare(record), self._programs.filter, len(self.model.states)
        n_rows = last + 1 - first
        rows = {name: a[first : last + 1] for name, a in _inputs(kernel, data).items()}
        rows |= {
            f"{kind}{bit}": np.full((n_rows, len(sensor.outputs)), np.nan)
            for bit, sensor in enumerate(self.model.sensors)
            for kind in "eS"
        }
        s = np.append(x, P[np.triu_indices(n)])
        done = kernel(n_rows, np.zeros(n_rows, np.uint32), rows | {"p": _own(values), "s": s})
        return done["predicted"][:, :n].copy(), _covariance(done["predicted"], n)

    def measured(self, record: Record) -> int:
        """Number of measured values of a record that enter the likelihood."""
        return self._prepare(record).n_measured

    def _start(self, record: Record, values: Array) -> tuple[Prepared, InitialCondition]:
        if np.shape(values) != (len(self._index),):
            raise ValueError(f"model {self.model.name} has {len(self._index)} parameters, got {np.shape(values)}")
        data = self._prepare(record)
        return data, initial_condition(self.model, values, data, self.process_noise)


def _own(values: Array) -> Array:
    return np.ascontiguousarray(values, dtype=np.float64)


def _inputs(kernel: Kernel, data: Prepared, piece: slice = slice(None)) -> dict[str, Array]:
    return {name: a[piece] for name, a in data.rows.items() if name in kernel.layout.sizes}


def _pieces(n_rows: int) -> list[slice]:
    size = n_rows if n_rows <= WHOLE else PIECE
    return [slice(first, min(first + size, n_rows)) for first in range(0, n_rows, size)]


def _symmetric(blocks: Array) -> Array:
    """(groups, groups, width, width), blocks on and above the diagonal, as a matrix."""
    groups, _, width, _ = blocks.shape
    upper = np.triu(blocks.swapaxes(1, 2).reshape(groups * width, groups * width))
    return np.asarray(upper + np.triu(upper, 1).T)


def _covariances(done: Mapping[str, Array], n: int) -> Covariances:
    Phi = np.ascontiguousarray(done["Phi"].reshape(-1, n, n).swapaxes(1, 2))
    return Covariances(_covariance(done["predicted"], n), _covariance(done["filtered"], n), Phi)


def _covariance(s: Array, n: int) -> Array:
    i, j = np.triu_indices(n)
    at = np.empty((n, n), np.intp)
    at[i, j] = at[j, i] = n + np.arange(i.size)
    return np.take(s, at, axis=1)
