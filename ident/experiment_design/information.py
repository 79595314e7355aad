"""Fisher information about the parameters, in a planned experiment or in a log.

The information has two forms. That of **prediction error** is the information of the innovations of the filter,
``de' S^-1 de``, and for noise parameters ``1/2 tr(S^-1 dS S^-1 dS)`` (`seatrial.ident.estimation.likelihood`). With
process noise the distant past carries no information. That of **output error** (thesis chapter 5) is
``F = sum dz' R^-1 dz`` along a simulation without process noise. `Experiments` computes both forms for thousands of
inputs or parameter values at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.data import Record
from seatrial.ident.engine import Kernel
from seatrial.ident.estimation import Likelihood, simulate
from seatrial.ident.model import Model, Parameter
from seatrial.ident.numerics import Array, scaled_eigen

Mask = NDArray[np.uint32]
T = TypeVar("T")
SINGULAR_EIGENVALUE = 1e-13  # of the information scaled to a unit diagonal; smaller eigenvalues are rounding errors
NULL_PART = 0.1  # largest part of a parameter's unit vector in the null space for a finite standard error
# Experiments are simulated in vector lanes: the processor computes one group of experiments at once, one per lane.
CHUNK = 4  # such groups per call; so many fit into the cache of the processor
MISSIONS = 4  # missions per task of a thread


@dataclass(frozen=True)
class ExperimentResults:
    """Results of n simulated experiments.

    Attributes
    ----------
    information : Array (n, q, q)
        Fisher information about the q free parameters, in their units; NaN for an experiment that diverges.
    low, high : Array (n, k)
        Minimum and maximum over time of the k quantities `Experiments.extremes`: the states, and the squared speed.
    """

    information: Array
    low: Array
    high: Array


class Experiments:
    """Simulated experiments of one model on common times, computed in batches.

    A call returns information and extremes. Inputs are arrays (n_rows, n_inputs, n) with time first and experiments
    last, or (n_rows, n_inputs) if all experiments have the same inputs.

    Parameters
    ----------
    model
        The model.
    free
        Names of the q parameters of the information.
    t
        Times of the rows (n_rows,) [s].
    every
        Number of rows from one sample to the next, by sensor; 1 for a sensor that is not named.
    process_noise
        Whether the information is that of prediction error: of the innovations of a filter, with process noise. Else it
        is that of output error: of a simulation without process noise.
    threads
        Number of threads.

    Attributes
    ----------
    model, free, t, threads
        As the parameters.
    extremes
        Names of the k quantities whose minimum and maximum are found: the states, then ``speed2`` [m2/s2], the squared
        speed, if the model has a surge speed.
    h : Array (n_rows,)
        Interval from each row to the next [s]; 0 for the last row.
    mask : Array (n_rows,)
        Sensors that have a sample in each row, as an integer: bit k is 1 if sensor k of the model has one.
    values : Array (n_parameters,)
        Parameter values of the model.

    Raises
    ------
    ValueError
        If ``every`` names a sensor that the model lacks.
    """

    def __init__(
        self,
        model: Model,
        free: Sequence[str],
        t: Array,
        every: Mapping[str, int] | None = None,
        *,
        process_noise: bool = True,
        threads: int = 2,
    ) -> None:
        """Set up the attributes of the class: sensor mask, intervals between the rows, and parameter values.

        The simulations (kernels) of the model are not compiled here, but when they are used for the first time.
        ``every`` is the number of rows from one sample to the next, by sensor; None: each sensor has one in each row.
        """
        from seatrial.ident.engine import batch_for, extremes

        self.model, self.free, self.t, self.threads = model, tuple(free), t, threads
        self._batch = batch_for(model, free, covariance=process_noise)
        self.extremes = extremes(model)
        self.h = np.append(np.diff(t), 0.0)
        self.mask = sensor_mask(model, t.size, every or {})
        self.values = np.array([p.value for p in model.parameters])
        self._index = {p.name: i for i, p in enumerate(model.parameters)}

    def __call__(self, u: Array, values: Array | None = None) -> ExperimentResults:
        """Return information and extremes of n experiments. The information is NaN if an experiment diverges.

        Parameters
        ----------
        u
            Inputs (n_rows, n_inputs, n) or (n_rows, n_inputs).
        values
            Parameter values (n, n_parameters) or (n_parameters,). By default they are those of the model.

        Raises
        ------
        ValueError
            If the numbers of inputs and of parameter values differ.
        """
        n, chunks = self._chunks(u, values)
        kernel = self._batch.information[u.ndim == 3]
        q, k = len(self.free), len(self.extremes)

        def work(lanes: slice) -> tuple[Array, Array, Array]:
            """Return three arrays, with one row for each experiment of a slice.

            They are the Fisher information about the parameters ``free`` (upper triangle of the matrix), and the
            minimum and the maximum over time of the quantities ``extremes`` (states and squared speed). The last rows
            may repeat the last experiment, to fill up its group.
            """
            arguments = self._arguments(u, values, lanes)
            if self._batch.covariance:
                arguments["s"] = with_covariance(self.model, arguments["s"], arguments["p"])
            arguments["X"] = self._slopes(arguments["p"])
            results = self._run(kernel, arguments, k)
            return _from_lanes(results["fisher"]), _from_lanes(results["low"]), _from_lanes(results["high"])

        parts = parallel(work, chunks, self.threads)
        triangle, low, high = (np.concatenate(column)[:n] for column in zip(*parts, strict=True))
        return ExperimentResults(symmetric_matrices(triangle, q), low, high)

    def extents(self, u: Array, values: Array | None = None) -> tuple[Array, Array]:
        """Return only the minimum and the maximum (n, k) of the quantities ``extremes``, several times faster.

        The arguments are those of a call: inputs ``u`` and parameter values ``values`` of n experiments.
        """
        n, chunks = self._chunks(u, values)
        kernel = self._batch.tracks[u.ndim == 3]

        def work(lanes: slice) -> tuple[Array, Array]:
            """Return minima and maxima (m, k), one row for each experiment of a slice.

            The last rows may repeat the last experiment, to fill up its group.
            """
            results = self._run(kernel, self._arguments(u, values, lanes), len(self.extremes))
            return _from_lanes(results["low"]), _from_lanes(results["high"])

        parts = parallel(work, chunks, self.threads)
        low, high = (np.concatenate(column)[:n] for column in zip(*parts, strict=True))
        return low, high

    def extents_in_noise(self, u: Array, noise: Array, values: Array) -> tuple[Array, Array]:
        """Return the minimum and the maximum (n, n_values, k) of the quantities ``extremes`` in n missions.

        Each mission is simulated with the same ``n_values`` parameter samples, each with its own noise, which is the
        same in all missions.

        Parameters
        ----------
        u
            First inputs of the model (n_rows, n_common, n), one set for each mission.
        noise
            Remaining inputs of the model (n_rows, n_noisy, n_values), one set for each parameter sample.
        values
            Parameter samples (n_values, n_parameters).
        """
        n_values, k = len(values), len(self.extremes)
        kernel = self._batch.tracks_in_noise(u.shape[1])
        width = kernel.layout.width
        groups = -(-n_values // width)
        p, w = in_lanes(values.T[None], groups, width)[0], in_lanes(noise, groups, width)
        linear = np.array([i.hold == "linear" for i in self.model.inputs])
        common, own = linear[: u.shape[1]], linear[u.shape[1] :]
        arguments = {"w": w, "w_next": _interval_ends(own, w, -2), "p": p, "h": self.h}
        start = start_in_lanes(self.model, p)

        def work(missions: slice) -> list[tuple[Array, Array]]:
            """Return minima and maxima (n_values, k) of each mission of a slice, in a list of pairs in their order."""
            found = []
            for j in range(missions.start, missions.stop):
                shared = np.ascontiguousarray(u[:, :, j])
                results = self._run(
                    kernel, arguments | {"u": shared, "u_next": _interval_ends(common, shared), "s": start.copy()}, k
                )
                found.append((_from_lanes(results["low"])[:n_values], _from_lanes(results["high"])[:n_values]))
            return found

        n = u.shape[2]
        chunks = [slice(first, min(first + MISSIONS, n)) for first in range(0, n, MISSIONS)]
        low, high = zip(*(row for part in parallel(work, chunks, self.threads) for row in part), strict=True)
        return np.array(low), np.array(high)

    def _chunks(self, u: Array, values: Array | None) -> tuple[int, list[slice]]:
        """Return the number of experiments, and slices of their indices.

        One call of the compiled simulation (kernel) computes the experiments of one slice. ``u`` and ``values`` are
        those of a call of the class.

        Raises
        ------
        ValueError
            If the numbers of inputs and of parameter values differ.
        """
        counts = {a.shape[axis] for a, axis, full in ((u, 2, 3), (values, 0, 2)) if a is not None and a.ndim == full}
        if len(counts) > 1:
            raise ValueError(f"the numbers of inputs and of parameter values must agree, but are {sorted(counts)}")
        n = counts.pop() if counts else 1
        width = self._batch.tracks[0].plan.width * CHUNK
        return n, [slice(first, min(first + width, n)) for first in range(0, n, width)]

    def _arguments(self, u: Array, values: Array | None, lanes: slice) -> dict[str, Array]:
        """Return the arguments of the compiled simulation (kernel) by name, for a slice of the experiments.

        They are inputs at the start and at the end of each interval, parameters, initial state and intervals. Arrays
        that differ between experiments are arranged for the vector unit of the processor, as `in_lanes` does.

        Parameters
        ----------
        u, values
            Inputs and parameter values, as in a call of the class.
        lanes
            Slice of the indices of the experiments.
        """
        width, n = self._batch.tracks[0].plan.width, lanes.stop - lanes.start
        groups = -(-n // width)
        values = self.values if values is None else values
        rows = values[None] if values.ndim == 1 else values[lanes]
        p = in_lanes(np.broadcast_to(rows, (n, rows.shape[1])).T[None], groups, width)[0]
        part = u if u.ndim == 2 else in_lanes(u[:, :, lanes], groups, width)
        ends = interval_ends(self.model, part, -1 if part.ndim == 2 else -2)
        return {
            "u": np.ascontiguousarray(part),
            "u_next": ends,
            "p": p,
            "s": start_in_lanes(self.model, p),
            "h": self.h,
        }

    def _run(self, kernel: Kernel, arguments: dict[str, Array], k: int) -> dict[str, Array]:
        """Run a compiled simulation (kernel) over all rows, and return its results by name.

        ``arguments``: those of `_arguments`. ``k``: number of quantities whose minimum and maximum are found. Their
        minima start at plus infinity and their maxima at minus infinity.
        """
        groups, _, width = arguments["p"].shape
        bounds = {"low": np.full((groups, k, width), np.inf), "high": np.full((groups, k, width), -np.inf)}
        return kernel(self.t.size, self.mask, {**arguments, **bounds}, groups=groups)

    def _slopes(self, p: Array) -> Array:
        """Return the derivative of the initial state with respect to the free parameters.

        ``p``: parameters (groups, n_parameters, width), arranged as `in_lanes` does. The result (groups, q n_states,
        width) is 1 where a free parameter is the initial value of a state, else 0. It starts the sensitivity equations.
        """
        X = np.zeros((p.shape[0], len(self.free), len(self.model.states), p.shape[2]))
        for i, state in enumerate(self.model.states):
            if state.x0 in self.free:
                X[:, self.free.index(str(state.x0)), i] = 1.0
        return X.reshape(p.shape[0], -1, p.shape[2])


def start_in_lanes(model: Model, p: Array) -> Array:
    """Return the mean of the initial state (groups, n_states, width) at parameters p (groups, n_parameters, width).

    The arrays are arranged as `in_lanes` does: ``groups`` of ``width`` experiments.
    """
    names = [q.name for q in model.parameters]
    s = np.zeros((p.shape[0], len(model.states), p.shape[2]))
    for i, state in enumerate(model.states):
        s[:, i] = p[:, names.index(state.x0)] if isinstance(state.x0, str) else state.x0
    return s


def with_covariance(model: Model, mean: Array, p: Array) -> Array:
    """Return the initial mean of the state, followed by the upper triangle of the initial covariance, row by row.

    This is the initial value that a simulation with a Kalman filter needs. The arrays have ``groups`` of ``width``
    experiments, as `in_lanes` arranges them.

    Parameters
    ----------
    model
        The model, which defines the initial standard deviation of each state.
    mean
        Mean of the initial state (groups, n_states, width).
    p
        Parameters (groups, n_parameters, width).

    Returns
    -------
    Array (groups, n_states + n_states (n_states + 1) / 2, width)
        The covariance is diagonal.
    """
    n, names = len(model.states), [q.name for q in model.parameters]
    s = np.zeros((p.shape[0], n + n * (n + 1) // 2, p.shape[2]))
    s[:, :n] = mean
    for i, state in enumerate(model.states):
        sd = p[:, names.index(state.sd0)] if isinstance(state.sd0, str) else state.sd0
        s[:, n + i * n - i * (i - 1) // 2] = np.square(sd)
    return s


def sensor_mask(model: Model, n_rows: int, every: Mapping[str, int]) -> Mask:
    """Return which sensors have a sample in each row, as integers (n_rows,).

    Bit k of an integer is 1 if sensor k of the model, counted from 0, has a sample in that row. Every sensor has a
    sample in the first row.

    Parameters
    ----------
    model
        The model.
    n_rows
        Number of rows.
    every
        Number of rows from one sample to the next, by sensor; 1 for a sensor that is not named.

    Raises
    ------
    ValueError
        If ``every`` names a sensor that the model lacks.
    """
    unknown = set(every) - {s.name for s in model.sensors}
    if unknown:
        names = ", ".join(s.name for s in model.sensors)
        raise ValueError(f"model {model.name} has no sensor {sorted(unknown)[0]!r}; it has {names}")
    mask = np.zeros(n_rows, np.uint32)
    for bit, sensor in enumerate(model.sensors):
        mask[:: every.get(sensor.name, 1)] |= np.uint32(1 << bit)
    return mask


def in_lanes(a: Array, groups: int, width: int) -> Array:
    """Rearrange an array (n_rows, k, n) of n experiments to (n_rows, groups, k, width), for the vector unit.

    The processor computes the ``width`` experiments of a group at once, each in one lane of its vector registers. The
    last group is filled up with copies of the last experiment. ``groups * width`` must be n or more.
    """
    missing = groups * width - a.shape[2]
    if missing:
        a = np.concatenate([a, np.repeat(a[:, :, -1:], missing, axis=2)], axis=2)
    return np.ascontiguousarray(a.reshape(a.shape[0], a.shape[1], groups, width).transpose(0, 2, 1, 3))


def interval_ends(model: Model, u: Array, axis: int = -1) -> Array:
    """Return the inputs at the end of each interval.

    Parameters
    ----------
    model
        The model, which defines the hold of each input: constant or linear between rows.
    u
        Inputs at the rows (n_rows, ...).
    axis
        Axis of ``u`` along which the inputs lie.

    Returns
    -------
    Array
        Of the shape of ``u``: the value of the next row for linear inputs, else the same value. In the last row it is
        always the same value.
    """
    return _interval_ends(np.array([i.hold == "linear" for i in model.inputs]), u, axis)


def _interval_ends(linear: NDArray[np.bool_], u: Array, axis: int = -1) -> Array:
    """Return the inputs at the end of each interval, of the shape of u (n_rows, ...).

    ``linear`` (n_inputs,) is true for inputs that are linear between rows. ``axis`` is the axis of the inputs in ``u``.
    """
    shape = [1] * u.ndim
    shape[axis] = linear.size
    return np.where(linear.reshape(shape), np.concatenate([u[1:], u[-1:]]), u)


def symmetric_matrices(triangle: Array, q: int) -> Array:
    """Convert upper triangles by rows (n, q (q + 1) / 2) to symmetric matrices (n, q, q)."""
    full = np.empty((len(triangle), q, q))
    i, j = np.triu_indices(q)
    full[:, i, j] = full[:, j, i] = triangle
    return full


def parallel(work: Callable[[slice], T], chunks: Sequence[slice], threads: int) -> list[T]:
    """Return the results of ``work`` for each of the slices ``chunks``, in their order, computed on several threads.

    With fewer than two threads or slices it runs in the calling thread. An exception in ``work`` is raised here.
    Threads are useful here because the kernels release the global interpreter lock.
    """
    if threads < 2 or len(chunks) < 2:
        return [work(c) for c in chunks]
    with ThreadPoolExecutor(min(threads, len(chunks))) as pool:
        return list(pool.map(work, chunks))


def _from_lanes(a: Array) -> Array:
    """Convert results (groups, k, width) to one row for each experiment (groups * width, k).

    This reverses the arrangement of `in_lanes`. The rows include the copies that filled up the last group.
    """
    return np.asarray(a.transpose(0, 2, 1).reshape(-1, a.shape[1]))


def planned_record(
    model: Model,
    t: Array,
    u: Array,
    every: Mapping[str, int] | None = None,
    values: Array | None = None,
    name: str = "planned",
) -> Record:
    """Return the simulated record of a planned experiment, without process noise and measurement noise.

    Parameters
    ----------
    model
        The model.
    t
        Times of the rows (n_rows,) [s].
    u
        Inputs (n_rows, n_inputs), in the units of the model.
    every
        Number of rows from one sample to the next, by sensor; 1 for a sensor that is not named.
    values
        Parameter values (n_parameters,), by default those of the model.
    name
        Name of the record.

    Returns
    -------
    Record
        Inputs, and outputs that are NaN in rows without a sample of their sensor.

    Raises
    ------
    ValueError
        If ``every`` names a sensor that the model lacks.
    """
    end = interval_ends(model, u)
    columns = tuple(i.name for i in model.inputs), tuple(o.name for o in model.outputs)
    blank = Record(name, t, u, end, np.full((t.size, len(model.outputs)), np.nan), *columns)
    y = simulate(model, blank, values).y
    mask, first = sensor_mask(model, t.size, every or {}), 0
    for bit, sensor in enumerate(model.sensors):
        y[(mask & np.uint32(1 << bit)) == 0, first : first + len(sensor.outputs)] = np.nan
        first += len(sensor.outputs)
    return Record(name, t, u, end, y, *columns)


def prediction_information(
    model: Model, record: Record, values: Array | None = None, free: Sequence[str] | None = None
) -> Array:
    """Return the Fisher information of a record by prediction error, without prior information.

    Parameters
    ----------
    model
        The model.
    record
        The record.
    values
        Parameter values (n_parameters,), by default those of the model.
    free
        Names of the parameters of the information, by default the free parameters of the model.

    Returns
    -------
    Array (q, q)
        In the units of the parameters.
    """
    values = np.array([p.value for p in model.parameters]) if values is None else values
    return Likelihood(model).scores(record, values, free).information


def prior_information(parameters: Sequence[Parameter]) -> Array:
    """Return the diagonal matrix of the prior information (q, q) about parameters, in their units.

    An element is 1 over the variance of the prior of a parameter at its value; 0 for a parameter without a prior. With
    the transform "log", the standard deviation is that of the logarithm times the present value of the parameter.
    """
    found = np.zeros(len(parameters))
    for i, p in enumerate(parameters):
        deviation = p.prior_deviation(p.value)
        if deviation is not None:
            found[i] = 1.0 / deviation**2
    return np.diag(found)


def errors_of(information: Array) -> Array:
    """Return the Cramér-Rao bounds: standard errors with all other parameters unknown.

    Parameters
    ----------
    information
        Information matrices (..., q, q), in the units of the parameters.

    Returns
    -------
    Array (..., q)
        Standard errors in the units of the parameters. They are inf for a parameter without information, and for a
        parameter that cannot be separated from others: the part of its unit vector in the null space is 0.1
        (``NULL_PART``) or more. The errors of the other parameters are computed with the pseudo-inverse. A parameter
        whose diagonal element is NaN or infinite gets inf and is left out for the others. All are inf if an element
        between the others is not finite.
    """
    size = np.sqrt(np.maximum(np.diagonal(information, axis1=-2, axis2=-1), 0.0))
    found = np.full(size.shape, np.inf)
    for at in np.ndindex(size.shape[:-1]):
        good = np.flatnonzero(np.isfinite(size[at]) & (size[at] > 0))
        part = information[at][np.ix_(good, good)]
        if not good.size or not np.isfinite(part).all():
            continue
        w, V, scale = scaled_eigen(part)
        null = w <= SINGULAR_EIGENVALUE
        separable = np.square(V[:, null]).sum(axis=1) < NULL_PART**2
        variance = np.square(V[:, ~null]) @ (1.0 / w[~null])
        found[at][good[separable]] = np.sqrt(variance[separable]) / scale[separable]
    return found


@dataclass(frozen=True)
class InformationSegment:
    """Information about q parameters in one segment (interval of time) of a record.

    Attributes
    ----------
    record
        Name of the record.
    t_from, t_to
        Start and end of the segment [s], in the time of the record.
    information : Array (q, q)
        Information that the segment adds to the segments before it in its record, without the priors.
    weight : Array (q,)
        Factor by which the standard error of each parameter would grow without the segment. 1: the segment has no
        information; inf: only this segment informs the parameter; NaN: no segment does.
    alone : Array (q,)
        Standard errors from this segment and the priors alone; inf if they do not determine the parameter.
    whole : Array (q,)
        Standard errors from all segments of all records and the priors.
    """

    record: str
    t_from: float
    t_to: float
    information: Array
    weight: Array
    alone: Array
    whole: Array


def segment_information(
    model: Model,
    records: Sequence[Record],
    names: Sequence[str],
    *,
    seconds: float = 30.0,
    values: Sequence[Array] | None = None,
    inflation: Mapping[str, float] | None = None,
) -> list[InformationSegment]:
    """Return the Fisher information of each segment (interval of ``seconds``) of the records, by prediction error.

    Parameters
    ----------
    model
        The model.
    records
        The records.
    names
        Names of the q parameters of the result, each with one value for all records.
    seconds
        Length of a segment [s]. The last segment of a record has 0.5 to 1.5 times this length. A record of up to 1.5
        times this length is one segment.
    values
        Values of ``model.parameters`` (n_parameters,) for each record, by default those of the model.
    inflation
        Inflation of the standard errors by correlated residuals, by parameter. It reduces the information of the data
        but not that of the priors.

    Returns
    -------
    list of InformationSegment
        The segments of all records, in their order. The information of a segment is what it adds to the segments before
        it in its record. Per-record nuisance parameters (current, biases) and noise parameters are unknown.
    """
    nuisances = [p for p in model.parameters if p.free and p.name not in names]
    shared = [*names, *[p.name for p in nuisances if not p.per_record]]
    own = [p.name for p in nuisances if p.per_record]
    free, q, n = [*shared, *own], len(names), len(shared) + len(own) * len(records)
    larger = np.array([(inflation or {}).get(name, 1.0) for name in free])
    prior = np.zeros((n, n))
    parts: list[tuple[str, float, float, Array]] = []
    for i, record in enumerate(records):
        first = len(shared) + i * len(own)
        at_record = [*range(len(shared)), *range(first, first + len(own))]
        places = np.ix_(at_record, at_record)
        prior[places] = np.maximum(prior[places], prior_information([model.parameter(name) for name in free]))
        at = None if values is None else values[i]
        for t_from, t_to, F in _increments(model, record, at, free, seconds):
            parts.append((record.name, t_from, t_to, np.zeros((n, n))))
            parts[-1][-1][places] = F / np.outer(larger, larger)
    whole = np.sum([F for *_, F in parts], axis=0) + prior
    best = errors_of(whole)[:q]
    with np.errstate(invalid="ignore"):  # inf / inf: the weight of a parameter without information is NaN
        weights = [errors_of(whole - F)[:q] / best for *_, F in parts]
    return [
        InformationSegment(name, a, b, F[:q, :q], weight, errors_of(F + prior)[:q], best)
        for (name, a, b, F), weight in zip(parts, weights, strict=True)
    ]


def _increments(
    model: Model, record: Record, values: Array | None, free: Sequence[str], seconds: float
) -> list[tuple[float, float, Array]]:
    """Return start and end [s] of each segment of a record, and the information (n, n) that the segment adds.

    The n parameters are ``free``. The information of a segment is that of the record up to the end of the segment minus
    that up to its start.
    """
    starts = np.arange(0.0, max(record.duration - seconds / 2, seconds / 2), seconds)  # one for a short record
    edges = np.append(starts, record.duration) + record.t[0]
    past = edges[-1] + 1.0  # the last row belongs to the last segment
    ends = [record.part(record.t[0], past if k == edges.size - 1 else float(edges[k])) for k in range(1, edges.size)]
    totals = parallel(
        partial(_record_information, model, ends, values, free), [slice(k, k + 1) for k in range(len(ends))], 2
    )
    steps = np.diff(np.concatenate([np.zeros((1, len(free), len(free))), totals]), axis=0)
    return [(float(a), float(b), F) for a, b, F in zip(edges[:-1], edges[1:], steps, strict=True)]


def _record_information(
    model: Model, records: Sequence[Record], values: Array | None, free: Sequence[str], selected: slice
) -> Array:
    """Return the information (q, q) about the parameters ``free`` in one of the records.

    The record is the one whose index is the start of the slice ``selected``: `parallel` calls this function with a
    slice for each record.
    """
    return prediction_information(model, records[selected.start], values, free)
