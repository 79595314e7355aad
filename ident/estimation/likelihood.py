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
from seatrial.ident.engine import ArenaPool, FilterKernels, filter_kernels_for
from seatrial.ident.estimation.model_kernels import ModelKernels, kernel_inputs, model_kernels
from seatrial.ident.estimation.prepared_record import InitialCondition, Prepared, Preparer, initial_condition
from seatrial.ident.model import LIKELY, Model, robust_weight
from seatrial.ident.numerics import Array

# The adjoint filter needs 4 kB for each row, and the covariances another 4 kB. A record of more than WHOLE rows is
# therefore processed in pieces of PIECE rows. Only one piece is in memory. Of the others only the state at their start
# is kept, from which the filter runs again when needed. A piece fits into the cache of the processor.
WHOLE, PIECE = 16384, 1024  # rows
# Largest estimated rounding error of a score [standard errors of the parameter] for derivatives in single precision,
# and the relative rounding error of this precision
LARGEST_ROUNDING, SINGLE_ROUNDING = 0.01, 2.0**-24


@dataclass(frozen=True)
class LikelihoodAndScore:
    """Log-likelihood of one record, with its score and expected Fisher information by n_free parameters.

    The parameters are in their own units, not in logarithms.

    Attributes
    ----------
    value : float
        Log-likelihood, with its constants.
    gradient : Array (n_free,)
        Score: derivative of the log-likelihood by each parameter.
    information : Array (n_free, n_free)
        Expected Fisher information.
    by_row : Array (n_rows, n_free), optional
        Contributions of the rows to the score; their sum is `gradient`. None if they were not requested.
    """

    value: float
    gradient: Array
    information: Array
    by_row: Array | None = None


class Covariances(NamedTuple):
    """State covariances and transition matrices of an extended Kalman filter, for n consecutive rows of a record.

    A row is one instant of the record with its samples.

    Attributes
    ----------
    P_pred, P_filt : Array (n, n_states, n_states)
        Covariance of the states before and after the filter uses the samples of each row.
    Phi : Array (n, n_states, n_states)
        Transition matrix of the linearised model from each row to the next one.
    """

    P_pred: Array
    P_filt: Array
    Phi: Array


@dataclass(frozen=True)
class FilterResult:
    """Output of the extended Kalman filter for each row of a record: state means, covariances and innovations.

    A row is one instant of the record with its samples. Angles are in rad; all values are in the units of the model.

    Attributes
    ----------
    t : Array (n_rows,)
        Time [s].
    x_pred, x_filt : Array (n_rows, n_states)
        State means before and after the filter uses the samples of the row.
    covariances : Callable[[slice], Covariances]
        Function that returns the covariances of a slice of rows (step 1). In a record of more than 16384 rows it runs
        the filter again for rows that are not in memory; it is fastest for the slices in `pieces`.
    e : Array (n_rows, n_outputs)
        Measured minus predicted outputs, from `x_pred`; NaN if not measured. Angles are in -pi to pi.
    R : Array (n_outputs,)
        Variances of the measurement noise.
    eps, S : Array (n_rows, n_outputs)
        Innovations and their variances in sequential processing: each is conditional on those before it in its row, so
        that ``eps / sqrt(S)`` is white. NaN if not measured, or if the filter skipped the sample.
    ll : Array (n_rows,)
        Contribution of each row to the log-likelihood.
    outliers_allowed : Array (n_outputs,) of bool or None
        Whether the output has the outlier model (contaminated normal innovations). None has the same meaning as all
        False.
    outliers_skipped : Array (n_rows, n_outputs) of bool or None
        Outliers before the first regular measurement, which the filter skips. None: there are none.
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
    outliers_allowed: NDArray[np.bool_] | None = None
    outliers_skipped: NDArray[np.bool_] | None = None

    @property
    def pieces(self) -> list[slice]:
        """Consecutive slices that cover all rows of the record, for which covariances are obtained fastest.

        A record of up to 16384 rows has one slice; a longer record has slices of 1024 rows. The covariances of one
        slice are computed together and held in memory.
        """
        return _row_pieces(self.t.size)

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
        """Return the variances of the measurements as predicted before each row, shape (n_rows, n_outputs).

        They are the diagonal of ``H P_pred H'`` plus the variances `R` of the measurement noise.

        Parameters
        ----------
        H : Array (n_rows, n_outputs, n_states)
            Derivatives of the outputs by the states, at the predicted states.
        """
        each = [np.einsum("kil,kil->ki", H[rows] @ self.covariances(rows).P_pred, H[rows]) for rows in self.pieces]
        return np.concatenate(each) + self.R

    @property
    def value(self) -> float:
        """Log-likelihood of the record: the sum over its rows."""
        return float(self.ll.sum())

    @property
    def standardised(self) -> Array:
        """Standardised innovations ``eps / sqrt(S)`` (n_rows, n_outputs).

        They are white and of variance 1 if the model is right. They are NaN for outliers and if not measured.
        """
        return np.where(self.outliers, np.nan, self.eps / np.sqrt(self.S))

    @cached_property
    def outliers(self) -> NDArray[np.bool_]:
        """Whether a sample is an outlier (n_rows, n_outputs); False where nothing was measured.

        A sample is an outlier if the filter skipped it before the first regular measurement. For an output with the
        outlier model, it is also an outlier if the probability that it belongs to the regular noise is below 0.5.
        """
        left = np.zeros(self.eps.shape, dtype=bool) if self.outliers_skipped is None else self.outliers_skipped
        return (
            left
            if self.outliers_allowed is None
            else left | self.outliers_allowed & (robust_weight(self.eps / np.sqrt(self.S)) < LIKELY)
        )


class Likelihood:
    """Likelihood of measured records under a model, as a function of the parameter values.

    In all methods, ``values`` is an Array (n_parameters,) in the order of ``model.parameters``, in their own units.
    ValueError is raised for another shape (except by `forecast`). Methods may be called from several threads. A
    parameter vector for which the filter diverges gives NaN. The filter code of the model is compiled at the first
    call.

    Parameters
    ----------
    model
        Model of the records.
    joseph
        Whether to use Joseph's form of the covariance update, which keeps the covariance positive in spite of rounding.
    process_noise
        True: prediction error by an extended Kalman filter. False: output error
        (``seatrial.ident.estimation.output_error``), with an exact initial state and no process noise.
    """

    def __init__(self, model: Model, *, joseph: bool = False, process_noise: bool = True) -> None:
        """Create the likelihood of a model. Each of its functions is compiled at the first call."""
        self.model = model
        self.process_noise = process_noise
        self._joseph = joseph
        self._prepare = Preparer(model)
        self._arenas = ArenaPool()
        self._index = {p.name: i for i, p in enumerate(model.parameters)}

    @cached_property
    def _kernels(self) -> FilterKernels:
        """Compiled filter functions of the model, which all models share that differ only in parameter values."""
        return filter_kernels_for(self.model, covariance=self.process_noise, joseph=self._joseph)

    @cached_property
    def _common(self) -> ModelKernels:
        """Compiled filter functions of the model, or of a larger model that contains it (`common_kernels`)."""
        return model_kernels(self.model, covariance=self.process_noise, joseph=self._joseph)

    def value(self, record: Record, values: Array) -> float:
        """Return the log-likelihood of a record, including the terms that do not depend on the parameters.

        ``values`` (n_parameters,) are all parameters of the model. The result is NaN if the filter diverges.
        """
        data, start = self._prepare_with_initial_state(record, values)
        kernel = self._common.kernels.value
        with self._arenas.borrow() as arena:
            arrays = {**self._common.arrays(kernel, data, values), **kernel.layout.state_arrays(start.s)}
            done = kernel(data.n_rows, data.mask, arrays, arena=arena)
            return float(done["ll"][0])

    def gradient(self, record: Record, values: Array) -> tuple[float, Array]:
        """Return the log-likelihood of a record and its gradient (n_parameters,) by all parameters, also fixed ones.

        ``values`` (n_parameters,) are the parameters at which it is computed. The adjoint filter, which runs backwards
        through the record, needs a time that does not depend on the number of parameters. The dependence of the initial
        state on the parameters is included. The log-likelihood is NaN if the filter diverges.
        """
        data, start = self._prepare_with_initial_state(record, values)
        forward_kernel, backward_kernel = self._kernels.forward, self._kernels.backward
        p, ll, state = _contiguous_doubles(values), np.zeros(1), start.s
        pieces, initial = _row_pieces(data.n_rows), list[Array]()
        fixed_arrays = {"p": p, "g": np.zeros(p.size), "bar": np.zeros(state.size)}

        def forward(piece: slice, s: Array, total: Array) -> dict[str, Array]:
            """Run the filter over a slice of rows, and store what the backward pass needs.

            The filter state ``s`` and the sum ``total`` (1,) of the log-likelihood are updated in place.
            """
            rows = {**kernel_inputs(forward_kernel, data, piece), "p": p, "s": s, "ll": total}
            return forward_kernel(piece.stop - piece.start, data.mask[piece], rows, arena=arena)

        with self._arenas.borrow() as arena:
            for piece in pieces:
                initial.append(state.copy())
                done = forward(piece, state, ll)
            for piece, s in zip(reversed(pieces), reversed(initial), strict=True):
                if piece is not pieces[-1]:
                    done = forward(piece, s, np.zeros(1))
                tapes = {name: done[name] for name in self._kernels.tapes}
                rows = {**kernel_inputs(backward_kernel, data, piece), **fixed_arrays, **tapes}
                backward_kernel(piece.stop - piece.start, data.mask[piece], rows, arena=arena)
        value, gradient = float(ll[0]), fixed_arrays["g"]
        for entry, parameter, slope in start.tangent:
            gradient[parameter] += slope * fixed_arrays["bar"][entry]
        return value, gradient

    def scores(
        self,
        record: Record,
        values: Array,
        free: Sequence[str] | None = None,
        *,
        by_row: bool = False,
        double: bool = False,
    ) -> LikelihoodAndScore:
        """Return log-likelihood, score and expected Fisher information of a record, by forward sensitivities.

        The score is the gradient of the log-likelihood. Parameters are in their own units, not in logarithms. The
        log-likelihood is NaN if the filter diverges. An unknown name in ``free`` raises KeyError.

        Parameters
        ----------
        record, values
            Data, and the values of all parameters (n_parameters,) at which the score is computed.
        free
            Names of the n_free parameters to differentiate by, in the order of the result; by default those that are
            free in the model.
        by_row
            Whether to return the contributions of the rows (instants of the record) to the score, too.
        double
            Whether to compute the derivatives in double precision. Single precision takes 0.6 of the time, and its
            errors are far below a standard error. Where they could be larger, double precision is used in any case: if
            the estimated rounding error of a score exceeds 1 % of a standard error, or if a number exceeds 1e38.
        """
        free = self.model.free if free is None else free
        data, start = self._prepare_with_initial_state(record, values)
        if not double:
            found, accurate = self._forward_sensitivities(data, start, values, free, by_row)
            if accurate or np.isnan(found.value):
                return found
        return self._forward_sensitivities(data, start, values, free, by_row, double=True)[0]

    def _forward_sensitivities(
        self,
        data: Prepared,
        start: InitialCondition,
        values: Array,
        free: Sequence[str],
        by_row: bool,
        double: bool = False,
    ) -> tuple[LikelihoodAndScore, bool]:
        """Run the kernel of forward sensitivities on a prepared record, and return the result of `scores`.

        The second value is False if the kernel's precision may not suffice. ``start`` is not changed.
        """
        common = self._common
        kernel = common.kernels.tangent_double if double else common.kernels.tangent
        chosen = [self._index[name] for name in free]
        groups, width, n = kernel.groups(len(free)), kernel.layout.width, len(free)
        lane_of = {parameter: lane for lane, parameter in enumerate(chosen)}
        with self._arenas.borrow() as arena:
            layout = kernel.layout
            moved = {
                name: arena.take(name, layout.shape(name, data.n_rows, groups), dtype=layout.dtype(name))
                for name in layout.derivative_arrays
            }
            for entry, parameter, slope in start.tangent:
                if parameter in lane_of:
                    lane = lane_of[parameter]
                    for name, at in layout.derivative_entries(entry):
                        moved[name][lane // width, at, lane % width] += slope
            arrays = {
                **common.arrays(kernel, data, values),
                **layout.state_arrays(start.s),
                **moved,
                "dp": kernel.seeds(common.without.size, common.place[chosen].tolist(), groups),
            }
            done = kernel(
                data.n_rows, data.mask, arrays, groups=groups, arena=arena, per_row={"dll"} if by_row else frozenset()
            )
            dll = done["dll"].reshape(-1, groups * width)[:, :n].copy()
            information = _symmetric_from_blocks(done["fisher"])[:n, :n]
            value, lost = float(done["ll"][0]), done["lost"].reshape(-1)[:n].copy() if "lost" in done else np.zeros(n)
        result = LikelihoodAndScore(value, dll.sum(axis=0), information, dll if by_row else None)
        finite = np.isfinite(result.gradient).all() and np.isfinite(information).all()
        # A score that is wrong by the root of its information moves the estimate by one standard error.
        is_accurate = SINGLE_ROUNDING**2 * lost <= LARGEST_ROUNDING**2 * np.diag(information)
        return result, bool(finite and is_accurate.all())

    def value_by_row(self, record: Record, values: Array) -> Array:
        """Return the contribution of each row (instant of the record) to the log-likelihood (n_rows,).

        ``values`` (n_parameters,) are all parameters of the model. The result is not finite from the row on in which
        the filter diverges.
        """
        data, start = self._prepare_with_initial_state(record, values)
        kernel = self._common.kernels.value
        with self._arenas.borrow() as arena:
            arrays = {**self._common.arrays(kernel, data, values), **kernel.layout.state_arrays(start.s)}
            done = kernel(data.n_rows, data.mask, arrays, arena=arena, per_row={"ll"})
            return done["ll"][:, 0].copy()

    def filter(self, record: Record, values: Array) -> FilterResult:
        """Run the extended Kalman filter over a record and return its output for each row.

        ``values`` (n_parameters,) are all parameters of the model. Validation, the smoother and plots use the result.
        If the filter diverges, its output is not finite from that row on, and no error is raised.

        Raises
        ------
        ValueError
            If the likelihood has no process noise (output error).
        """
        if not self.process_noise:
            raise ValueError(
                "output error has no filter, because it has no process noise; simulate the model with "
                "seatrial.ident.estimation.output_error instead"
            )
        data, start = self._prepare_with_initial_state(record, values)
        kernel, n, n_rows, p = self._common.kernels.filter, len(self.model.states), data.n_rows, values
        outputs, pieces = len(self.model.outputs), _row_pieces(data.n_rows)

        def run(rows: slice, state: Mapping[str, Array]) -> dict[str, Array]:
            """Run the filter over a slice of rows from the arrays of the state at its start; they are changed."""
            sensor_arrays = {
                f"{kind}{bit}": np.full((rows.stop - rows.start, len(sensor.outputs)), np.nan)
                for bit, sensor in enumerate(self.model.sensors)
                for kind in "eS"
            }
            arrays = {**self._common.arrays(kernel, data, p, rows), **state, **sensor_arrays}
            return kernel(rows.stop - rows.start, data.mask[rows], arrays, per_row={"ll"})

        x_pred, x_filt = np.empty((2, n_rows, n))
        e, eps, S = np.empty((3, n_rows, outputs))
        ll, state, initial = np.empty(n_rows), kernel.layout.state_arrays(start.s), list[dict[str, Array]]()
        for rows in pieces:
            initial.append({name: a.copy() for name, a in state.items()})
            done = run(rows, state)
            x_pred[rows], x_filt[rows] = done["predicted"][:, :n], done["filtered"][:, :n]
            e[rows], ll[rows] = done["e"], done["ll"][:, 0]
            for kind, into in (("e", eps), ("S", S)):
                into[rows] = np.hstack([done[f"{kind}{bit}"] for bit in range(len(self.model.sensors))])
        last = {len(pieces) - 1: _covariances_of_run(done, n)}  # covariances of the piece that was requested last

        def covariances(requested: slice) -> Covariances:
            """Return the covariances of the requested rows.

            Run the filter again for those 1024-row pieces of the record whose covariances are not in memory.
            """
            first, end, _ = requested.indices(n_rows)
            parts = []
            for k, rows in enumerate(pieces):
                if rows.start < end and first < rows.stop:
                    if k not in last:
                        last.clear()
                        last[k] = _covariances_of_run(run(rows, {name: a.copy() for name, a in initial[k].items()}), n)
                    parts.append([a[max(first - rows.start, 0) : end - rows.start] for a in last[k]])
            return Covariances(*(p[0] if len(p) == 1 else np.concatenate(p) for p in zip(*parts, strict=True)))

        R = np.array([p[self._index[o.noise]] ** 2 for o in self.model.outputs])
        robust = np.array([o.robust for o in self.model.outputs])
        return FilterResult(record.t, x_pred, x_filt, covariances, e, R, eps, S, ll, robust, data.outliers)

    def forecast(self, record: Record, values: Array, x: Array, P: Array, first: int, last: int) -> tuple[Array, Array]:
        """Predict states and their covariances from the inputs alone, without measurements.

        The samples of the record in these rows are not used, also not that of the row ``first``. The shape of
        ``values`` is not checked.

        Parameters
        ----------
        record, values
            Record with the inputs, and the parameter values.
        x : Array (n_states,)
            Mean of the states at the row ``first``.
        P : Array (n_states, n_states)
            Covariance of the states at the row ``first``.
        first, last
            Indices of the first and last row of the result, both included.

        Returns
        -------
        means : Array (n, n_states)
            Means of the n = last - first + 1 rows. The first one is ``x``.
        covariances : Array (n, n_states, n_states)
            Covariances of these rows, with the process noise. The first one is ``P``.
        """
        data, kernel, n = self._prepare(record), self._common.kernels.filter, len(self.model.states)
        n_rows = last + 1 - first
        rows = self._common.arrays(kernel, data, values, slice(first, last + 1))
        rows |= {
            f"{kind}{bit}": np.full((n_rows, len(sensor.outputs)), np.nan)
            for bit, sensor in enumerate(self.model.sensors)
            for kind in "eS"
        }
        s = np.append(x, P[np.triu_indices(n)])
        done = kernel(n_rows, np.zeros(n_rows, np.uint32), rows | kernel.layout.state_arrays(s))
        return done["predicted"][:, :n].copy(), _covariance_matrices(done["predicted"], n)

    def measured(self, record: Record) -> int:
        """Return the number of scalar measurements of a record that the filter uses: all except skipped outliers."""
        return self._prepare(record).n_measured

    def _prepare_with_initial_state(self, record: Record, values: Array) -> tuple[Prepared, InitialCondition]:
        """Return the arrays of a record for the filter, and the state with which the filter starts at these ``values``.

        Raise ValueError if ``values`` has not the shape (n_parameters,).
        """
        if np.shape(values) != (len(self._index),):
            raise ValueError(
                f"model {self.model.name} has {len(self._index)} parameters, but the array of their values has the "
                f"shape {np.shape(values)}; give one value for each parameter, in the order of the model"
            )
        data = self._prepare(record)
        return data, initial_condition(self.model, values, data, self.process_noise)


def _contiguous_doubles(values: Array) -> Array:
    """Return the values as a contiguous float64 array, as compiled code needs them; a copy only if necessary."""
    return np.ascontiguousarray(values, dtype=np.float64)


def _row_pieces(n_rows: int) -> list[slice]:
    """Return consecutive slices that cover all rows of a record and limit the memory of the filter.

    It is one slice for up to 16384 rows; otherwise each slice has 1024 rows, the last one possibly fewer.
    """
    size = n_rows if n_rows <= WHOLE else PIECE
    return [slice(first, min(first + size, n_rows)) for first in range(0, n_rows, size)]


def _symmetric_from_blocks(blocks: Array) -> Array:
    """Assemble a symmetric matrix (n, n) from square blocks, with n = n_blocks width.

    Parameters
    ----------
    blocks : Array (n_blocks, n_blocks, width, width)
        Block (i, j) holds the entries of block row i and block column j. Only entries on and above the diagonal of the
        whole matrix are used; the others are their mirror image.
    """
    groups, _, width, _ = blocks.shape
    upper = np.triu(blocks.swapaxes(1, 2).reshape(groups * width, groups * width))
    return np.asarray(upper + np.triu(upper, 1).T)


def _covariances_of_run(done: Mapping[str, Array], n: int) -> Covariances:
    """Unpack covariances and transition matrices from the result arrays of a filter run.

    ``done`` contains ``predicted`` and ``filtered`` (states with covariances, one row each) and ``Phi``; ``n`` is the
    number of states of the model.
    """
    Phi = np.ascontiguousarray(done["Phi"].reshape(-1, n, n).swapaxes(1, 2))
    return Covariances(_covariance_matrices(done["predicted"], n), _covariance_matrices(done["filtered"], n), Phi)


def _covariance_matrices(s: Array, n: int) -> Array:
    """Unpack covariance matrices (n_rows, n, n) from filter states.

    Parameters
    ----------
    s : Array (n_rows, n + n (n + 1) / 2)
        In each row n state means, then the upper triangle of their covariance by matrix rows.
    n
        Number of states of the model.
    """
    i, j = np.triu_indices(n)
    at = np.empty((n, n), np.intp)
    at[i, j] = at[j, i] = n + np.arange(i.size)
    return np.take(s, at, axis=1)
