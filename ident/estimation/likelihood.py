"""Prediction-error likelihood by a continuous-discrete extended Kalman filter (thesis eq. 2.3 with a corrected
constant).

    ln L = -1/2 sum [ e' S^-1 e + ln |S| + r ln 2 pi ]

``e`` are the r innovations of a row and ``S`` is their covariance. Scalar measurements are processed one after the
other. The mean is integrated by Runge-Kutta 4 over each interval, the covariance by the transition matrix and Simpson's
rule.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.data import Record
from seatrial.ident.engine import ArenaPool, FilterKernels, Kernel, filter_kernels_for
from seatrial.ident.estimation.prepared_record import InitialCondition, Prepared, Preparer, initial_condition
from seatrial.ident.model import LIKELY, Model, robust_weight
from seatrial.ident.numerics import Array

# The adjoint filter needs 4 kB for each row, and the covariances another 4 kB. A record of more than WHOLE rows is
# therefore processed in pieces of PIECE rows. Only one piece is in memory. Of the others only the state at their start
# is kept, from which the filter runs again when needed. A piece fits into the cache of the processor.
WHOLE, PIECE = 16384, 1024  # rows


@dataclass(frozen=True)
class LikelihoodAndScore:
    """Log-likelihood, score and expected Fisher information, by the parameters in their own units.

    Attributes
    ----------
    value
        Log-likelihood.
    gradient : Array (n_free,)
        Score.
    information : Array (n_free, n_free)
        Expected Fisher information.
    by_row : Array (n_rows, n_free), optional
        Contributions of the rows to the score.
    """

    value: float
    gradient: Array
    information: Array
    by_row: Array | None = None


class Covariances(NamedTuple):
    """Covariances of consecutive rows, each (n, n_states, n_states).

    Attributes
    ----------
    P_pred, P_filt
        Covariance of the state before and after a row's samples.
    Phi
        Transition matrix from the row to the next one.
    """

    P_pred: Array
    P_filt: Array
    Phi: Array


@dataclass(frozen=True)
class FilterResult:
    """Output of the extended Kalman filter for each row: state means, covariances and innovations.

    Attributes
    ----------
    t : Array (n_rows,)
        Time [s].
    x_pred, x_filt : Array (n_rows, n_states)
        State means before and after the row's samples.
    covariances
        Function from a slice of rows to their covariances. In a long record it runs the filter again; see ``pieces``.
    e : Array (n_rows, n_outputs)
        Measured minus predicted outputs, NaN if not measured.
    R : Array (n_outputs,)
        Variances of the measurement noise.
    eps, S : Array (n_rows, n_outputs)
        Innovations and their variances in sequential processing: each is conditional on those before it in its row, so
        that ``eps / sqrt(S)`` is white.
    ll : Array (n_rows,)
        Contribution of each row to ln L.
    allowed : Array (n_outputs,) of bool
        Outputs with the outlier model; None if no output has it.
    left : Array (n_rows, n_outputs) of bool
        Outliers before the first measurement, which the filter skips.
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
        """Consecutive slices of rows whose covariances are computed together."""
        return _pieces(self.t.size)

    @property
    def P_pred(self) -> Array:
        """State covariance of all rows (n_rows, n_states, n_states) before their samples."""
        return self.covariances(slice(None)).P_pred

    @property
    def P_filt(self) -> Array:
        """State covariance of all rows (n_rows, n_states, n_states) after their samples."""
        return self.covariances(slice(None)).P_filt

    @property
    def Phi(self) -> Array:
        """Transition matrix from each row to the next (n_rows, n_states, n_states)."""
        return self.covariances(slice(None)).Phi

    def output_variance(self, H: Array) -> Array:
        """Return the variances of the predicted outputs (n_rows, n_outputs).

        Parameters
        ----------
        H : Array (n_rows, n_outputs, n_states)
            Derivatives of the outputs by the states.
        """
        each = [np.einsum("kil,kil->ki", H[rows] @ self.covariances(rows).P_pred, H[rows]) for rows in self.pieces]
        return np.concatenate(each) + self.R

    @property
    def value(self) -> float:
        """Log-likelihood of the record."""
        return float(self.ll.sum())

    @property
    def standardised(self) -> Array:
        """Standardised innovations (n_rows, n_outputs), white if the model is right; NaN for outliers."""
        return np.where(self.outliers, np.nan, self.eps / np.sqrt(self.S))

    @cached_property
    def outliers(self) -> NDArray[np.bool_]:
        """Whether a sample is more likely an outlier than not (n_rows, n_outputs)."""
        left = np.zeros(self.eps.shape, dtype=bool) if self.left is None else self.left
        return (
            left if self.allowed is None else left | self.allowed & (robust_weight(self.eps / np.sqrt(self.S)) < LIKELY)
        )


class Likelihood:
    """Likelihood of records under a model, as a function of the parameter values.

    ``values`` is always an Array (n_parameters,) over ``model.parameters`` in order. Methods may be called from several
    threads. A parameter vector for which the filter diverges gives NaN.

    Parameters
    ----------
    model
        The model.
    joseph
        Whether to use Joseph's form of the covariance update.
    process_noise
        False: output error (``seatrial.ident.estimation.output_error``), with an exact initial state and no process
        noise.
    """

    def __init__(self, model: Model, *, joseph: bool = False, process_noise: bool = True) -> None:
        self.model = model
        self.process_noise = process_noise
        self._joseph = joseph
        self._prepare = Preparer(model)
        self._arenas = ArenaPool()
        self._index = {p.name: i for i, p in enumerate(model.parameters)}

    @cached_property
    def _programs(self) -> FilterKernels:
        """Compiled programs of the model."""
        return filter_kernels_for(self.model, covariance=self.process_noise, joseph=self._joseph)

    def value(self, record: Record, values: Array) -> float:
        """Return the log-likelihood of a record with all its constants."""
        data, start = self._start(record, values)
        kernel = self._programs.value
        with self._arenas.borrow() as arena:
            arrays = {**_inputs(kernel, data), "p": _contiguous(values), "s": start.s}
            done = kernel(data.n_rows, data.mask, arrays, arena=arena)
            return float(done["ll"][0])

    def gradient(self, record: Record, values: Array) -> tuple[float, Array]:
        """Return the log-likelihood and its gradient by all parameters (n_parameters,), by the adjoint filter."""
        data, start = self._start(record, values)
        forward_kernel, backward_kernel = self._programs.forward, self._programs.backward
        p, ll, state = _contiguous(values), np.zeros(1), start.s
        pieces, initial = _pieces(data.n_rows), list[Array]()
        fixed_arrays = {"p": p, "g": np.zeros(p.size), "bar": np.zeros(state.size)}

        def forward(piece: slice, s: Array, total: Array) -> dict[str, Array]:
            rows = {**_inputs(forward_kernel, data, piece), "p": p, "s": s, "ll": total}
            return forward_kernel(piece.stop - piece.start, data.mask[piece], rows, arena=arena)

        with self._arenas.borrow() as arena:
            for piece in pieces:
                initial.append(state.copy())
                done = forward(piece, state, ll)
            for piece, s in zip(reversed(pieces), reversed(initial), strict=True):
                if piece is not pieces[-1]:
                    done = forward(piece, s, np.zeros(1))
                tapes = {name: done[name] for name in self._programs.tapes}
                rows = {**_inputs(backward_kernel, data, piece), **fixed_arrays, **tapes}
                backward_kernel(piece.stop - piece.start, data.mask[piece], rows, arena=arena)
        value, gradient = float(ll[0]), fixed_arrays["g"]
        for entry, parameter, slope in start.tangent:
            gradient[parameter] += slope * fixed_arrays["bar"][entry]
        return value, gradient

    def scores(
        self, record: Record, values: Array, free: Sequence[str] | None = None, *, by_row: bool = False
    ) -> LikelihoodAndScore:
        """Return log-likelihood, score and expected Fisher information, by forward sensitivities.

        Parameters
        ----------
        record, values
            The record and the parameter values.
        free
            Names of the parameters to differentiate by; by default those that are free in the model.
        by_row
            Whether to return the contributions of the rows to the score, too.
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
            arrays = {
                **_inputs(kernel, data),
                "p": _contiguous(values),
                "s": start.s,
                "ds": ds,
                "dp": kernel.seeds(len(self._index), chosen, groups),
            }
            done = kernel(
                data.n_rows, data.mask, arrays, groups=groups, arena=arena, per_row={"dll"} if by_row else frozenset()
            )
            dll = done["dll"].reshape(-1, groups * width)[:, :n].copy()
            information = _symmetric(done["fisher"])[:n, :n]
            value = float(done["ll"][0])
        return LikelihoodAndScore(value, dll.sum(axis=0), information, dll if by_row else None)

    def value_by_row(self, record: Record, values: Array) -> Array:
        """Return the log-likelihood by row (n_rows,). It uses the kernel that a search has already compiled."""
        data, start = self._start(record, values)
        kernel = self._programs.tangent
        with self._arenas.borrow() as arena:
            arrays = {**_inputs(kernel, data), "p": _contiguous(values), "s": start.s}
            done = kernel(data.n_rows, data.mask, arrays, arena=arena, per_row={"ll"})
            return done["ll"][:, 0].copy()

    def filter(self, record: Record, values: Array) -> FilterResult:
        """Run the filter over a record.

        Raises
        ------
        ValueError
            If the likelihood has no process noise.
        """
        if not self.process_noise:
            raise ValueError("output error has no filter; simulate with seatrial.ident.estimation.output_error")
        data, start = self._start(record, values)
        kernel, n, n_rows, p = self._programs.filter, len(self.model.states), data.n_rows, _contiguous(values)
        outputs, pieces = len(self.model.outputs), _pieces(data.n_rows)

        def run(rows: slice, s: Array) -> dict[str, Array]:
            """Run the filter over a slice of rows from the state s at its start."""
            sensor_arrays = {
                f"{kind}{bit}": np.full((rows.stop - rows.start, len(sensor.outputs)), np.nan)
                for bit, sensor in enumerate(self.model.sensors)
                for kind in "eS"
            }
            arrays = {**_inputs(kernel, data, rows), "p": p, "s": s, **sensor_arrays}
            return kernel(rows.stop - rows.start, data.mask[rows], arrays, per_row={"ll"})

        x_pred, x_filt = np.empty((2, n_rows, n))
        e, eps, S = np.empty((3, n_rows, outputs))
        ll, state, initial = np.empty(n_rows), start.s, list[Array]()
        for rows in pieces:
            initial.append(state.copy())
            done = run(rows, state)
            x_pred[rows], x_filt[rows] = done["predicted"][:, :n], done["filtered"][:, :n]
            e[rows], ll[rows] = done["e"], done["ll"][:, 0]
            for kind, into in (("e", eps), ("S", S)):
                into[rows] = np.hstack([done[f"{kind}{bit}"] for bit in range(len(self.model.sensors))])
        last = {len(pieces) - 1: _covariances(done, n)}  # covariances of the piece that was requested last

        def covariances(requested: slice) -> Covariances:
            """Return the covariances of the requested rows. Run the filter again for pieces that are not in memory."""
            first, end, _ = requested.indices(n_rows)
            parts = []
            for k, rows in enumerate(pieces):
                if rows.start < end and first < rows.stop:
                    if k not in last:
                        last.clear()
                        last[k] = _covariances(run(rows, initial[k].copy()), n)
                    parts.append([a[max(first - rows.start, 0) : end - rows.start] for a in last[k]])
            return Covariances(*(p[0] if len(p) == 1 else np.concatenate(p) for p in zip(*parts, strict=True)))

        R = np.array([p[self._index[o.noise]] ** 2 for o in self.model.outputs])
        robust = np.array([o.robust for o in self.model.outputs])
        return FilterResult(record.t, x_pred, x_filt, covariances, e, R, eps, S, ll, robust, data.outliers)

    def forecast(self, record: Record, values: Array, x: Array, P: Array, first: int, last: int) -> tuple[Array, Array]:
        """Predict states from the inputs alone, without measurements.

        Parameters
        ----------
        record, values
            The record and the parameter values.
        x : Array (n_states,)
            Mean of the state at the row ``first``.
        P : Array (n_states, n_states)
            Its covariance.
        first, last
            Indices of rows.

        Returns
        -------
        means : Array (n, n_states)
            From the row ``first`` to the row ``last``.
        covariances : Array (n, n_states, n_states)
            Their covariances.
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
        done = kernel(n_rows, np.zeros(n_rows, np.uint32), rows | {"p": _contiguous(values), "s": s})
        return done["predicted"][:, :n].copy(), _covariance(done["predicted"], n)

    def measured(self, record: Record) -> int:
        """Return the number of measured values of a record that enter the likelihood."""
        return self._prepare(record).n_measured

    def _start(self, record: Record, values: Array) -> tuple[Prepared, InitialCondition]:
        """Return the prepared record and its initial state. Raise ValueError if ``values`` has the wrong shape."""
        if np.shape(values) != (len(self._index),):
            raise ValueError(f"model {self.model.name} has {len(self._index)} parameters, got {np.shape(values)}")
        data = self._prepare(record)
        return data, initial_condition(self.model, values, data, self.process_noise)


def _contiguous(values: Array) -> Array:
    """Return the values as a contiguous array, as kernels need them."""
    return np.ascontiguousarray(values, dtype=np.float64)


def _inputs(kernel: Kernel, data: Prepared, piece: slice = slice(None)) -> dict[str, Array]:
    """Return the arrays of a record that a kernel reads, for a slice of rows."""
    return {name: a[piece] for name, a in data.rows.items() if name in kernel.layout.sizes}


def _pieces(n_rows: int) -> list[slice]:
    """Return consecutive slices that cover all rows: one for up to ``WHOLE`` rows, otherwise ``PIECE`` rows each."""
    size = n_rows if n_rows <= WHOLE else PIECE
    return [slice(first, min(first + size, n_rows)) for first in range(0, n_rows, size)]


def _symmetric(blocks: Array) -> Array:
    """Return a symmetric matrix from its blocks (groups, groups, width, width).

    Only the blocks on and above the diagonal are used.
    """
    groups, _, width, _ = blocks.shape
    upper = np.triu(blocks.swapaxes(1, 2).reshape(groups * width, groups * width))
    return np.asarray(upper + np.triu(upper, 1).T)


def _covariances(done: Mapping[str, Array], n: int) -> Covariances:
    """Return the covariances from the arrays of a filter run; ``n`` is the number of states."""
    Phi = np.ascontiguousarray(done["Phi"].reshape(-1, n, n).swapaxes(1, 2))
    return Covariances(_covariance(done["predicted"], n), _covariance(done["filtered"], n), Phi)


def _covariance(s: Array, n: int) -> Array:
    """Return covariances (n_rows, n, n) from rows that contain n means and the upper triangle of the covariance."""
    i, j = np.triu_indices(n)
    at = np.empty((n, n), np.intp)
    at[i, j] = at[j, i] = n + np.arange(i.size)
    return np.take(s, at, axis=1)
