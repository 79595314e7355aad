"""Fisher information of the parameters, of a planned experiment or of a log.

Two forms. **Prediction error**: the information of the innovations of the filter, ``de' S^-1 de`` and, for noise
parameters, ``1/2 tr(S^-1 dS S^-1 dS)`` (``seatrial.ident.estimation.likelihood``); with process noise the distant past
carries no information. **Output error** (thesis chapter 5): no process noise, ``F = sum dz' R^-1 dz`` along a
simulation. ``Experiments`` computes either for thousands of inputs or parameter values at a time.
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
SINGULAR_EIGENVALUE = 1e-13  # of the information scaled to unit diagonal: up to it nothing is told
NULL_PART = 0.1  # of a unit vector
CHUNK = 4  # groups of vector lanes in a call; they fit into the cache of the processor
MISSIONS = 4  # of one task of a thread


@dataclass(frozen=True)
class ExperimentResults:
    """Results of n experiments.

    Attributes:
        information (n, q, q): by the free parameters, in their units.
        low, high (n, k): minimum and maximum of the states and of the squared speed, named by ``Experiments.extremes``.
    """

    information: Array
    low: Array
    high: Array


class Experiments:
    """Experiments of one model on common times, simulated in batches on ``threads`` threads.

    t (n_rows,) s; ``every``: a sensor's samples are this many rows apart (1 where it is not named). Inputs are arrays
    (n_rows, n_inputs, n) with time first and the experiments last, or (n_rows, n_inputs): the same in all.
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
        from seatrial.ident.engine import batch_for, extremes

        self.model, self.free, self.t, self.threads = model, tuple(free), t, threads
        self._batch = batch_for(model, free, covariance=process_noise)
        self.extremes = extremes(model)
        self.h = np.append(np.diff(t), 0.0)
        self.mask = sensor_mask(model, t.size, every or {})
        self.values = np.array([p.value for p in model.parameters])
        self._index = {p.name: i for i, p in enumerate(model.parameters)}

    def __call__(self, u: Array, values: Array | None = None) -> ExperimentResults:
        """values (n, n_parameters) or (n_parameters,): the model's own by default. An experiment that diverges has an
        information of NaN."""
        n, chunks = self._chunks(u, values)
        kernel = self._batch.information[u.ndim == 3]
        q, k = len(self.free), len(self.extremes)

        def work(lanes: slice) -> tuple[Array, Array, Array]:
            given = self._given(u, values, lanes)
            if self._batch.covariance:
                given["s"] = with_covariance(self.model, given["s"], given["p"])
            given["X"] = self._slopes(given["p"])
            done = self._run(kernel, given, k)
            return _flat(done["fisher"]), _flat(done["low"]), _flat(done["high"])

        parts = parallel(work, chunks, self.threads)
        triangle, low, high = (np.concatenate(column)[:n] for column in zip(*parts, strict=True))
        return ExperimentResults(square(triangle, q), low, high)

    def extents(self, u: Array, values: Array | None = None) -> tuple[Array, Array]:
        """Only ``low`` and ``high`` (n, k), several times as fast."""
        n, chunks = self._chunks(u, values)
        kernel = self._batch.tracks[u.ndim == 3]

        def work(lanes: slice) -> tuple[Array, Array]:
            done = self._run(kernel, self._given(u, values, lanes), len(self.extremes))
            return _flat(done["low"]), _flat(done["high"])

        parts = parallel(work, chunks, self.threads)
        low, high = (np.concatenate(column)[:n] for column in zip(*parts, strict=True))
        return low, high

    def extents_in_noise(self, u: Array, noise: Array, values: Array) -> tuple[Array, Array]:
        """``low`` and ``high`` (n, n_values, k) of n missions, each with the same samples of the parameters and the
        same noise.

        u (n_rows, n_common, n): the first inputs of the model; noise (n_rows, n_noisy, n_values): the inputs after
        them; values (n_values, n_parameters).
        """
        n_values, k = len(values), len(self.extremes)
        kernel = self._batch.tracks_in_noise(u.shape[1])
        width = kernel.layout.width
        groups = -(-n_values // width)
        p, w = in_lanes(values.T[None], groups, width)[0], in_lanes(noise, groups, width)
        linear = np.array([i.hold == "linear" for i in self.model.inputs])
        common, own = linear[: u.shape[1]], linear[u.shape[1] :]
        given = {"w": w, "w_next": _interval_ends(own, w, -2), "p": p, "h": self.h}
        start = start_in_lanes(self.model, p)

        def work(missions: slice) -> list[tuple[Array, Array]]:
            found = []
            for j in range(missions.start, missions.stop):
                shared = np.ascontiguousarray(u[:, :, j])
                done = self._run(
                    kernel, given | {"u": shared, "u_next": _interval_ends(common, shared), "s": start.copy()}, k
                )
                found.append((_flat(done["low"])[:n_values], _flat(done["high"])[:n_values]))
            return found

        n = u.shape[2]
        chunks = [slice(first, min(first + MISSIONS, n)) for first in range(0, n, MISSIONS)]
        low, high = zip(*(row for part in parallel(work, chunks, self.threads) for row in part), strict=True)
        return np.array(low), np.array(high)

    def _chunks(self, u: Array, values: Array | None) -> tuple[int, list[slice]]:
        counts = {a.shape[axis] for a, axis, full in ((u, 2, 3), (values, 0, 2)) if a is not None and a.ndim == full}
        if len(counts) > 1:
            raise ValueError(f"as many inputs as parameter values wanted, got {sorted(counts)}")
        n = counts.pop() if counts else 1
        width = self._batch.tracks[0].plan.width * CHUNK
        return n, [slice(first, min(first + width, n)) for first in range(0, n, width)]

    def _given(self, u: Array, values: Array | None, lanes: slice) -> dict[str, Array]:
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

    def _run(self, kernel: Kernel, given: dict[str, Array], k: int) -> dict[str, Array]:
        groups, _, width = given["p"].shape
        bounds = {"low": np.full((groups, k, width), np.inf), "high": np.full((groups, k, width), -np.inf)}
        return kernel(self.t.size, self.mask, {**given, **bounds}, groups=groups)

    def _slopes(self, p: Array) -> Array:
        X = np.zeros((p.shape[0], len(self.free), len(self.model.states), p.shape[2]))
        for i, state in enumerate(self.model.states):
            if state.x0 in self.free:
                X[:, self.free.index(str(state.x0)), i] = 1.0
        return X.reshape(p.shape[0], -1, p.shape[2])


def start_in_lanes(model: Model, p: Array) -> Array:
    """Means of the initial state (groups, n_states, width) at parameters p (groups, n_parameters, width)."""
    names = [q.name for q in model.parameters]
    s = np.zeros((p.shape[0], len(model.states), p.shape[2]))
    for i, state in enumerate(model.states):
        s[:, i] = p[:, names.index(state.x0)] if isinstance(state.x0, str) else state.x0
    return s


def with_covariance(model: Model, mean: Array, p: Array) -> Array:
    """Means followed by the upper triangle of the initial covariance."""
    n, names = len(model.states), [q.name for q in model.parameters]
    s = np.zeros((p.shape[0], n + n * (n + 1) // 2, p.shape[2]))
    s[:, :n] = mean
    for i, state in enumerate(model.states):
        sd = p[:, names.index(state.sd0)] if isinstance(state.sd0, str) else state.sd0
        s[:, n + i * n - i * (i - 1) // 2] = np.square(sd)
    return s


def sensor_mask(model: Model, n_rows: int, every: Mapping[str, int]) -> Mask:
    """(n_rows,): a bit for each sensor that has a sample in the row."""
    unknown = set(every) - {s.name for s in model.sensors}
    if unknown:
        raise ValueError(f"model {model.name} has no sensor {sorted(unknown)[0]!r}")
    mask = np.zeros(n_rows, np.uint32)
    for bit, sensor in enumerate(model.sensors):
        mask[:: every.get(sensor.name, 1)] |= np.uint32(1 << bit)
    return mask


def in_lanes(a: Array, groups: int, width: int) -> Array:
    """(n_rows, k, n) as (n_rows, groups, k, width); an incomplete group is filled with its last column."""
    missing = groups * width - a.shape[2]
    if missing:
        a = np.concatenate([a, np.repeat(a[:, :, -1:], missing, axis=2)], axis=2)
    return np.ascontiguousarray(a.reshape(a.shape[0], a.shape[1], groups, width).transpose(0, 2, 1, 3))


def interval_ends(model: Model, u: Array, axis: int = -1) -> Array:
    """The inputs at the end of each interval, of ``u`` (n_rows, ...), which has those of a row along ``axis``: those of
    the next row where they are linear in between, else the same."""
    return _interval_ends(np.array([i.hold == "linear" for i in model.inputs]), u, axis)


def _interval_ends(linear: NDArray[np.bool_], u: Array, axis: int = -1) -> Array:
    """``interval_ends`` of inputs that are ``linear`` (n_inputs,) or not."""
    shape = [1] * u.ndim
    shape[axis] = linear.size
    return np.where(linear.reshape(shape), np.concatenate([u[1:], u[-1:]]), u)


def square(triangle: Array, q: int) -> Array:
    """Upper triangles by rows (n, q (q + 1) / 2) as symmetric matrices (n, q, q)."""
    full = np.empty((len(triangle), q, q))
    i, j = np.triu_indices(q)
    full[:, i, j] = full[:, j, i] = triangle
    return full


def parallel(work: Callable[[slice], T], chunks: Sequence[slice], threads: int) -> list[T]:
    """Results in order; the kernels release the global interpreter lock."""
    if threads < 2 or len(chunks) < 2:
        return [work(c) for c in chunks]
    with ThreadPoolExecutor(min(threads, len(chunks))) as pool:
        return list(pool.map(work, chunks))


def _flat(a: Array) -> Array:
    """(groups, k, width) as (groups width, k)."""
    return np.asarray(a.transpose(0, 2, 1).reshape(-1, a.shape[1]))


def planned_record(
    model: Model,
    t: Array,
    u: Array,
    every: Mapping[str, int] | None = None,
    values: Array | None = None,
    name: str = "planned",
) -> Record:
    """Record of a planned experiment without process noise and measurement noise.

    t (n_rows,) s; u (n_rows, n_inputs).
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
    """Prediction-error information (q, q) of a record by the parameters ``free`` (those free in the model)."""
    values = np.array([p.value for p in model.parameters]) if values is None else values
    return Likelihood(model).scores(record, values, free).information


def prior_information(parameters: Sequence[Parameter]) -> Array:
    """Prior information (q, q) of the parameters, diagonal, in their units."""
    found = np.zeros(len(parameters))
    for i, p in enumerate(parameters):
        prior = p.free_prior()
        if prior is not None:
            found[i] = 1.0 / (prior[1] * p.slope(p.value)) ** 2
    return np.diag(found)


def errors_of(information: Array) -> Array:
    """Cramér-Rao bounds (..., q): standard errors with all other parameters unknown.

    inf where there is no information, or none that tells a parameter from others: the part of its direction in the null
    space is above ``NULL_PART``. The others have theirs, by the pseudo-inverse.
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
        told = np.square(V[:, null]).sum(axis=1) < NULL_PART**2
        variance = np.square(V[:, ~null]) @ (1.0 / w[~null])
        found[at][good[told]] = np.sqrt(variance[told]) / scale[told]
    return found


@dataclass(frozen=True)
class InformationSegment:
    """Information of one segment of a log.

    Attributes:
        weight (q,): factor by which each standard error would grow without the segment (1: none; inf: only this segment
            informs the parameter).
        alone, whole (q,): standard errors from this segment alone, and from all segments of all records.
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
    """Fisher information of each segment of the records about the parameters ``names`` (prediction error).

    seconds: length of a segment. values: the parameters in each record, over ``model.parameters``. The information of a
    segment is what it adds to that of all before it in its record. Per-record nuisance parameters (current, biases) and
    noise count as unknown. inflation: of the standard errors by correlated residuals; the data inform as much less, the
    priors do not.
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
    with np.errstate(invalid="ignore"):  # what nothing tells has no weight
        weights = [errors_of(whole - F)[:q] / best for *_, F in parts]
    return [
        InformationSegment(name, a, b, F[:q, :q], weight, errors_of(F + prior)[:q], best)
        for (name, a, b, F), weight in zip(parts, weights, strict=True)
    ]


def _increments(
    model: Model, record: Record, values: Array | None, free: Sequence[str], seconds: float
) -> list[tuple[float, float, Array]]:
    """Start and end [s] of each segment, and the information that it adds."""
    starts = np.arange(0.0, max(record.duration - seconds / 2, seconds / 2), seconds)  # of a short record one
    edges = np.append(starts, record.duration) + record.t[0]
    past = edges[-1] + 1.0  # the last row belongs to the last segment
    ends = [record.part(record.t[0], past if k == edges.size - 1 else float(edges[k])) for k in range(1, edges.size)]
    totals = parallel(partial(_total, model, ends, values, free), [slice(k, k + 1) for k in range(len(ends))], 2)
    steps = np.diff(np.concatenate([np.zeros((1, len(free), len(free))), totals]), axis=0)
    return [(float(a), float(b), F) for a, b, F in zip(edges[:-1], edges[1:], steps, strict=True)]


def _total(model: Model, ends: Sequence[Record], values: Array | None, free: Sequence[str], which: slice) -> Array:
    return prediction_information(model, ends[which.start], values, free)
