"""Records in the form that kernels read: checked once, with masks of the sensors, and the initial state."""

from __future__ import annotations

import weakref
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ident.data.record import Record
from ident.model import Model
from ident.numerics import NORMAL_MAD, SECOND_DIFFERENCE, Array, noise_from_differences, wrap

N_AGREE = 7  # samples of a sensor with outliers that the first is chosen from
# A sample at the start is an outlier where it is farther from a straight line than both of
START_OUTLIER_GATE = 4.0  # times the least distance of all, and
SAMPLE_OUTLIER_GATE = 4.0 * SECOND_DIFFERENCE / NORMAL_MAD  # standard deviations of the noise: 6.6, beyond any chance


@dataclass(frozen=True)
class Prepared:
    """A record as arrays of a kernel.

    rows: ``u``, ``u_next`` (n_rows, n_inputs), ``y`` (n_rows, n_outputs), ``h`` (n_rows,) [s]; mask (n_rows,): a bit
    for each sensor that has a sample in that row; first (n_outputs,): the first measurement, NaN where there is none;
    n_measured: measured values; outliers (n_rows, n_outputs): those before the first measurement, without their bit;
    start: of ``Record``.
    """

    n_rows: int
    rows: dict[str, Array]
    mask: NDArray[np.uint32]
    first: Array
    n_measured: int
    outliers: NDArray[np.bool_]
    start: Mapping[str, tuple[float, float]]


class Preparer:
    """Prepares records for a model, and keeps what it made for records that are still in use."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self._known: dict[int, tuple[weakref.ref[Record], Prepared]] = {}

    def __call__(self, record: Record) -> Prepared:
        """Raises ValueError, naming the record, where it does not fit the model."""
        known = self._known.get(id(record))
        if known is not None and known[0]() is record:
            return known[1]
        prepared = self._prepare(record)
        for key in [key for key, (reference, _) in list(self._known.items()) if reference() is None]:
            self._known.pop(key, None)
        self._known[id(record)] = (weakref.ref(record), prepared)
        return prepared

    def _prepare(self, record: Record) -> Prepared:
        model = self.model
        names = tuple(i.name for i in model.inputs), tuple(o.name for o in model.outputs)
        if (record.inputs, record.outputs) != names:
            record = record.for_model(model)
        self._check(record)
        there = np.isfinite(record.y)
        first, outliers = _first(model, record, there)
        mask = np.zeros(record.n_rows, np.uint32)
        first_output = 0
        for bit, sensor in enumerate(model.sensors):
            columns = there[:, first_output:first_output + len(sensor.outputs)]
            first_output += len(sensor.outputs)
            whole = columns.all(axis=1)
            partly = np.flatnonzero(columns.any(axis=1) & ~whole)
            if partly.size:
                raise ValueError(f"record {record.name}: a sample of {sensor.name} at {record.t[partly[0]]:g} s has "
                                 "some of its outputs and lacks others")
            of_it = outliers[:, first_output - len(sensor.outputs):first_output]
            of_it |= of_it.any(axis=1, keepdims=True)  # a sample is taken or left as a whole
            mask |= np.where(whole & ~of_it[:, 0], np.uint32(1 << bit), np.uint32(0))
        rows = {"u": record.u, "u_next": record.u_next, "y": record.y, "h": record.h}
        contiguous = {name: np.ascontiguousarray(a, dtype=np.float64) for name, a in rows.items()}
        n_measured = int((there & ~outliers).sum())
        return Prepared(record.n_rows, contiguous, mask, first, n_measured, outliers, record.start)

    def _check(self, record: Record) -> None:
        model, n = self.model, record.n_rows
        wanted = {"u": (n, len(model.inputs)), "u_next": (n, len(model.inputs)), "y": (n, len(model.outputs))}
        for name, shape in wanted.items():
            if getattr(record, name).shape != shape:
                raise ValueError(f"record {record.name}: {name} is {getattr(record, name).shape}, but model "
                                 f"{model.name} needs {shape}")
        if n < 2 or not (np.diff(record.t) > 0).all():
            raise ValueError(f"record {record.name}: its times do not increase, or it has fewer than two rows")
        for j, signal in enumerate(model.inputs):
            bad = ~(np.isfinite(record.u[:, j]) & np.isfinite(record.u_next[:, j]))
            if bad.any():
                at = record.t[np.argmax(bad)]
                raise ValueError(f"record {record.name}: the input {signal.name} has no value at {at:g} s")
            if signal.hold == "zero" and not np.array_equal(record.u[:, j], record.u_next[:, j]):
                raise ValueError(f"record {record.name}: the input {signal.name} changes within an interval, but "
                                 f"model {model.name} holds it")


def _first(model: Model, record: Record, there: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """The first measurement of each output (n_outputs,), and the outliers before it (n_rows, n_outputs).

    To begin elsewhere is not enough: while the state is uncertain any sample is likely, so the filter would take an
    outlier in full, be sure of it, and take the good ones after it for outliers.
    """
    found, outliers = np.full(there.shape[1], np.nan), np.zeros(there.shape, dtype=bool)
    for j in np.flatnonzero(there.any(axis=0)):
        output = model.outputs[j]
        rows = np.flatnonzero(there[:, j])
        k = _agreeing(record.t[rows], record.y[rows, j], output.angle) if output.robust else 0
        found[j], outliers[rows[:k], j] = record.y[rows[k], j], True
    return found, outliers


def _agreeing(t: Array, samples: Array, angle: bool) -> int:
    """The first sample that is not far from where most of those at the start are, along a straight line through them
    (Siegel 1982: its slope is the median of each sample's median slope to all others), or one before it that the next
    two lead to, as in a curve.

    Far is several times what second differences typically are; where they are zero, as they often are of a sensor of
    coarse resolution, they do not count.
    """
    bend = wrap(np.diff(wrap(np.diff(samples), angle)), angle)
    noise = noise_from_differences(bend[bend != 0.0])
    if noise == 0.0:
        return 0
    reach = SAMPLE_OUTLIER_GATE * noise
    t, y = t[:N_AGREE], samples[:N_AGREE]
    y = wrap(y - y[np.argmin(_distances(y, angle))], angle)
    dt = t[:, None] - t + np.diag(np.full(t.size, np.nan))
    slope = np.median(np.nanmedian((y[:, None] - y) / dt, axis=1))
    distance = _distances(y - slope * t, False)
    k = int(np.argmax(distance <= max(START_OUTLIER_GATE * distance.min(), reach)))
    while 0 < k < y.size - 1:
        led = y[k] + (y[k + 1] - y[k]) / (t[k + 1] - t[k]) * (t[k - 1] - t[k])
        if abs(y[k - 1] - led) > reach:
            break
        k -= 1
    return k


def _distances(samples: Array, angle: bool) -> Array:
    """Of each sample, the median of how far it is from all."""
    return np.asarray(np.median(np.abs(wrap(samples[:, None] - samples, angle)), axis=1))


@dataclass(frozen=True)
class InitialCondition:
    """The state at the start of a record and its derivative by the parameters.

    s (n_s,): mean and, with a covariance, its upper triangle; tangent: list of (entry of s, parameter, slope).
    """

    s: Array
    tangent: tuple[tuple[int, int, float], ...]


def initial_condition(model: Model, values: Array, data: Prepared, covariance: bool) -> InitialCondition:
    """Mean: first measurement (``from_output``), what the record says, parameter or number; covariance: diag(sd0^2)."""
    n = len(model.states)
    outputs = [o.name for o in model.outputs]
    index = {p.name: i for i, p in enumerate(model.parameters)}
    s = np.zeros(n + n * (n + 1) // 2 if covariance else n)
    tangent: list[tuple[int, int, float]] = []
    for i, state in enumerate(model.states):
        measured = data.first[outputs.index(state.from_output)] if state.from_output in outputs else np.nan
        begins = None if np.isfinite(measured) else data.start.get(state.name)
        if np.isfinite(measured):
            s[i] = measured
        elif begins is not None:
            s[i] = begins[0]
        elif isinstance(state.x0, str):
            s[i] = values[index[state.x0]]
            tangent.append((i, index[state.x0], 1.0))
        else:
            s[i] = state.x0
        if covariance:
            at = n + i * n - i * (i - 1) // 2  # of P[i, i] in the upper triangle
            sd = values[index[state.sd0]] if isinstance(state.sd0, str) else state.sd0
            sd = sd if begins is None else begins[1]
            s[at] = sd * sd
            if isinstance(state.sd0, str) and begins is None:
                tangent.append((at, index[state.sd0], 2.0 * float(sd)))
    return InitialCondition(s, tuple(tangent))
