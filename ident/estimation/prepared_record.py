"""Records as the arrays of the compiled filter, and the state at the start of a record.

`Preparer` checks a record once, marks in each row the sensors that have a sample (one bit for each sensor), and finds
the first measurement of each output.
`initial_condition` computes the initial mean and covariance of the states from it.
"""

from __future__ import annotations

import weakref
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.data import Record
from seatrial.ident.model import Model
from seatrial.ident.numerics import NORMAL_MAD, SECOND_DIFFERENCE, Array, noise_from_differences, wrap

N_AGREE = 7  # first samples of a sensor with outliers, from which the initial measurement is chosen
# A sample at the start is an outlier if its distance from a straight line is larger than both of these limits: a factor
# on the least distance of all samples, and standard deviations of the noise (6.6, which no noise reaches).
START_OUTLIER_GATE = 4.0
SAMPLE_OUTLIER_GATE = 4.0 * SECOND_DIFFERENCE / NORMAL_MAD
LATE = 2.0  # median sample intervals; a first measurement that comes later than that is late
FAST = 0.95  # quantile of the rates of change of an output; larger rates may be outliers
START_SPREAD = 5.0  # initial standard deviation over the noise: the first measurement is used twice to 4 % only
UNKNOWN_ANGLE = float(np.pi / np.sqrt(3.0))  # rad, standard deviation of a uniformly distributed direction


@dataclass(frozen=True)
class Prepared:
    """Record as contiguous float64 arrays for the compiled Kalman filter, with what its initial state needs.

    A row is one instant of the record, with its samples and the inputs until the next row.

    Attributes
    ----------
    n_rows : int
        Number of rows of the record.
    rows : dict of Array
        Arrays of the record: inputs ``u`` at the start and ``u_next`` at the end of the interval after each row
        (n_rows, n_inputs), measurements ``y`` (n_rows, n_outputs), length ``h`` of the interval (n_rows,) [s].
    mask : Array (n_rows,) of uint32
        Sensors whose samples the filter uses in each row, as bits of an integer: bit k is one if sensor k of the model
        has a sample and this sample is used.
    first : Array (n_outputs,)
        First measurement of each output that is no outlier, in the unit of the output. NaN for an output without a
        sample in the record.
    moved : Array (n_outputs,)
        Largest probable change of the output between the start of the record and its first measurement, in the unit of
        the output. Zero unless the first measurement comes later than two median sample intervals.
    noise : Array (n_outputs,)
        Upper estimate of the standard deviation of the white noise, in the unit of the output. Zero for an output that
        initialises no state or has no measurement.
    n_measured : int
        Number of measured values in ``y`` that the filter uses.
    outliers : Array (n_rows, n_outputs) of bool
        True for samples that are left out because they are outliers before the first regular measurement.
    start : Mapping
        Mean and standard deviation of initial states by name, copied from ``Record.start``.
    """

    n_rows: int
    rows: dict[str, Array]
    mask: NDArray[np.uint32]
    first: Array
    moved: Array
    noise: Array
    n_measured: int
    outliers: NDArray[np.bool_]
    start: Mapping[str, tuple[float, float]]


class Preparer:
    """Converter of records to the arrays of the compiled filter (`Prepared`), for one model.

    A second call with the same `Record` object returns the stored result of the first one. A result is stored until its
    record is deleted.

    Parameters
    ----------
    model
        Model whose inputs, sensors and states determine the arrays.
    """

    def __init__(self, model: Model) -> None:
        """Create a converter for the model, with an empty store of results."""
        self.model = model
        self._cache: dict[int, tuple[weakref.ref[Record], Prepared]] = {}

    def __call__(self, record: Record) -> Prepared:
        """Check a record and return its arrays for the filter, or the stored arrays of an earlier call.

        A record for another model gets the inputs and outputs of this model first (`Record.for_model`).

        Raises
        ------
        ValueError
            If an input is missing or not finite, if an array has the wrong shape, if the times do not increase, if the
            record has fewer than two rows, or if a row has some outputs of a sensor and lacks others. The message
            contains the name of the record.
        """
        cached = self._cache.get(id(record))
        if cached is not None and cached[0]() is record:
            return cached[1]
        prepared = self._prepare(record)
        for key in [key for key, (reference, _) in list(self._cache.items()) if reference() is None]:
            self._cache.pop(key, None)
        self._cache[id(record)] = (weakref.ref(record), prepared)
        return prepared

    def _prepare(self, record: Record) -> Prepared:
        """Check the record and compute its arrays for the filter, without use of stored results.

        Raises
        ------
        ValueError
            If an input is missing, if the arrays are invalid, or if a row has some outputs of a sensor and lacks
            others.
        """
        model = self.model
        names = tuple(i.name for i in model.inputs), tuple(o.name for o in model.outputs)
        if (record.inputs, record.outputs) != names:
            record = record.for_model(model)
        self._check_arrays(record)
        measured = np.isfinite(record.y)
        first, outliers = _first_measurements(model, record, measured)
        mask = np.zeros(record.n_rows, np.uint32)
        first_output = 0
        for bit, sensor in enumerate(model.sensors):
            columns = measured[:, first_output : first_output + len(sensor.outputs)]
            first_output += len(sensor.outputs)
            whole = columns.all(axis=1)
            partly = np.flatnonzero(columns.any(axis=1) & ~whole)
            if partly.size:
                raise ValueError(
                    f"record {record.name}: the sample of the sensor {sensor.name} at {record.t[partly[0]]:g} s has "
                    f"only some of its outputs {', '.join(o.name for o in sensor.outputs)}; give all of them, or none"
                )
            of_sensor = outliers[:, first_output - len(sensor.outputs) : first_output]
            of_sensor |= of_sensor.any(axis=1, keepdims=True)  # a sample is used or left out with all its outputs
            mask |= np.where(whole & ~of_sensor[:, 0], np.uint32(1 << bit), np.uint32(0))
        rows = {"u": record.u, "u_next": record.u_next, "y": record.y, "h": record.h}
        contiguous = {name: np.ascontiguousarray(a, dtype=np.float64) for name, a in rows.items()}
        used = measured & ~outliers
        moved, noise = _changes_before_first(model, record, used), _initial_noise(model, record, used)
        return Prepared(record.n_rows, contiguous, mask, first, moved, noise, int(used.sum()), outliers, record.start)

    def _check_arrays(self, record: Record) -> None:
        """Check the arrays of a record, whose names of inputs and outputs are those of the model.

        Raises
        ------
        ValueError
            If an array has the wrong shape, if there are fewer than two rows, if the times do not increase, or if an
            input has a value that is not finite.
        """
        model, n = self.model, record.n_rows
        shapes = {"u": (n, len(model.inputs)), "u_next": (n, len(model.inputs)), "y": (n, len(model.outputs))}
        for name, shape in shapes.items():
            if getattr(record, name).shape != shape:
                raise ValueError(
                    f"record {record.name}: {name} is {getattr(record, name).shape}, but model "
                    f"{model.name} needs the shape {shape}"
                )
        if n < 2 or not (np.diff(record.t) > 0).all():
            raise ValueError(
                f"record {record.name}: its times t do not increase, or there are fewer than two; sort the samples by "
                "time, and leave out repeated times"
            )
        known = np.isfinite(record.u) & np.isfinite(record.u_next)
        whole = np.asarray(known.all(axis=0))  # fast for hundreds of inputs
        for j, signal in enumerate(model.inputs):
            if not whole[j]:
                unknown = record.t[~known[:, j]]
                raise ValueError(
                    f"record {record.name}: the input {signal.name} has no value (NaN) at {unknown.size} of {n} times, "
                    f"from {unknown[0]:g} to {unknown[-1]:g} s; give values for them, or use only the time before or "
                    "after"
                )


def _first_measurements(model: Model, record: Record, measured: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """Return the first regular measurement of each output (n_outputs,), and which samples before it are outliers.

    The first measurements initialise the states of the filter. The outliers must be left out. While the initial state
    is uncertain every sample is probable: the filter would accept an outlier, become certain of it, and then reject the
    good samples.

    Parameters
    ----------
    model, record
        Model, and a record of its outputs.
    measured : Array (n_rows, n_outputs) of bool
        Whether a row has a sample of the output.

    Returns
    -------
    first : Array (n_outputs,)
        In the unit of the output; NaN for an output without a sample.
    outliers : Array (n_rows, n_outputs) of bool
        Whether the sample is an outlier before the first regular one. Outliers are searched only for outputs with
        ``robust``; for other outputs the first sample is the first measurement.
    """
    found, outliers = np.full(measured.shape[1], np.nan), np.zeros(measured.shape, dtype=bool)
    for j in np.flatnonzero(measured.any(axis=0)):
        output = model.outputs[j]
        rows = np.flatnonzero(measured[:, j])
        k = _first_inlier(record.t[rows], record.y[rows, j], output.angle) if output.robust else 0
        found[j], outliers[rows[:k], j] = record.y[rows[k], j], True
    return found, outliers


def _changes_before_first(model: Model, record: Record, measured: NDArray[np.bool_]) -> Array:
    """Return the largest probable change of each output before its first measurement (n_outputs,), in its unit.

    It makes the initial state less certain if a sensor starts late. The change is zero if the first measurement comes
    within two median sample intervals of the start of the record, or if an output has fewer than two samples. Otherwise
    it is the time from the start to the first measurement, times the fastest rate of change among all outputs of the
    same unit. The rate of an output is the 95 % quantile over its samples. All outputs of a unit are considered because
    north and east velocity exchange when a boat turns. The change of an angle is at most 1.81 rad, the standard
    deviation of an unknown direction.

    Parameters
    ----------
    model, record
        Model, and a record of its outputs.
    measured : Array (n_rows, n_outputs) of bool
        Whether a row has a sample of the output that is no outlier.
    """
    delay, rate = np.zeros(measured.shape[1]), np.zeros(measured.shape[1])
    for j in np.flatnonzero(measured.sum(axis=0) > 1):
        t = record.t[measured[:, j]]
        steps, late = np.diff(t), t[0] - record.t[0]
        if late > LATE * np.median(steps):
            delay[j] = late
        change = wrap(np.diff(record.y[measured[:, j], j]), model.outputs[j].angle)
        rate[j] = np.quantile(np.abs(change) / steps, FAST)
    found = np.zeros(measured.shape[1])
    for j in np.flatnonzero(delay):
        output = model.outputs[j]
        fastest = max(rate[k] for k, o in enumerate(model.outputs) if o.unit == output.unit)
        found[j] = min(fastest * delay[j], UNKNOWN_ANGLE if output.angle else np.inf)
    return found


def _initial_noise(model: Model, record: Record, measured: NDArray[np.bool_]) -> Array:
    """Estimate the standard deviation of the white noise of each output (n_outputs,), in the unit of the output.

    It limits how certain the initial state may be. The estimate uses the distance of each sample from the straight line
    between its neighbours. Curvature of the motion inflates it, which only makes the initial state less certain.
    Repeated samples, as of a slow sensor that is read often, are skipped. The result is zero for an output that
    initialises no state or has no sample. For an angle it is at most 1.81 rad.

    Parameters
    ----------
    model, record
        Model, and a record of its outputs.
    measured : Array (n_rows, n_outputs) of bool
        Whether a row has a sample of the output that is no outlier.
    """
    found, initial = np.zeros(measured.shape[1]), {s.from_output for s in model.states}
    for j, output in enumerate(model.outputs):
        if output.name in initial and measured[:, j].any():
            t, y = record.t[measured[:, j]], record.y[measured[:, j], j]
            new = np.append(True, np.diff(y) != 0.0)
            h, d = np.diff(t[new]), wrap(np.diff(y[new]), output.angle)
            before, after = h[1:] / (h[:-1] + h[1:]), h[:-1] / (h[:-1] + h[1:])
            bend = (before * d[:-1] - after * d[1:]) / np.sqrt(1.0 + before**2 + after**2)
            found[j] = min(noise_from_differences(SECOND_DIFFERENCE * bend), UNKNOWN_ANGLE if output.angle else np.inf)
    return found


def _first_inlier(t: Array, samples: Array, angle: bool) -> int:
    """Return the index of the first sample of an output that is no outlier; 0 if all second differences are zero.

    A robust straight line is fitted to the first 7 samples by repeated medians (Siegel 1982: its slope is the median of
    the median slopes of each sample to all others). The result is the first sample near this line. An earlier sample
    also counts if the two samples after it lead to it, as in a curve. Distances are compared with the noise by second
    differences. Second differences of zero, frequent for a sensor of coarse resolution, are ignored.

    Parameters
    ----------
    t : Array (n,)
        Increasing times [s].
    samples : Array (n,)
        Values of the output, without NaN.
    angle
        Whether the values are angles [rad], so that differences are wrapped to -pi to pi.
    """
    bend = wrap(np.diff(wrap(np.diff(samples), angle)), angle)
    noise = noise_from_differences(bend[bend != 0.0])
    if noise == 0.0:
        return 0
    reach = SAMPLE_OUTLIER_GATE * noise
    t, y = t[:N_AGREE], samples[:N_AGREE]
    y = wrap(y - y[np.argmin(_median_distances(y, angle))], angle)
    dt = t[:, None] - t + np.diag(np.full(t.size, np.nan))
    slope = np.median(np.nanmedian((y[:, None] - y) / dt, axis=1))
    distance = _median_distances(y - slope * t, False)
    k = int(np.argmax(distance <= max(START_OUTLIER_GATE * distance.min(), reach)))
    while 0 < k < y.size - 1:
        extrapolated = y[k] + (y[k + 1] - y[k]) / (t[k + 1] - t[k]) * (t[k - 1] - t[k])
        if abs(y[k - 1] - extrapolated) > reach:
            break
        k -= 1
    return k


def _median_distances(samples: Array, angle: bool) -> Array:
    """Return the median absolute difference of each sample to all samples (n,), in the samples' unit.

    ``samples`` (n,); ``angle``: whether they are angles [rad], whose differences are wrapped to -pi to pi.
    """
    return np.asarray(np.median(np.abs(wrap(samples[:, None] - samples, angle)), axis=1))


@dataclass(frozen=True)
class InitialCondition:
    """State of the Kalman filter at the start of a record, and its derivative with respect to the parameters.

    Attributes
    ----------
    s : Array (n_s,)
        Mean of the states (n_states,), followed by the upper triangle of their covariance by rows if it is required.
    tangent : tuple
        Nonzero derivatives ``d s[i] / d p[j]``: index i in ``s``, index j of the parameter in ``model.parameters``, and
        value of the derivative.
    """

    s: Array
    tangent: tuple[tuple[int, int, float], ...]


def initial_condition(model: Model, values: Array, data: Prepared, covariance: bool) -> InitialCondition:
    """Return the mean and covariance of the states with which the filter starts in a record, and their derivatives.

    Parameters
    ----------
    model
        The model.
    values
        Values of all parameters of the model (n_parameters,), in their own units.
    data
        Arrays of the record, from the `Preparer` of the same model.
    covariance
        Whether ``s`` contains the covariance after the mean.

    Returns
    -------
    InitialCondition
        The mean of a state is the first measurement of its ``from_output``. Without such a measurement it is the mean
        in ``Record.start``, and without an entry there the parameter or number ``x0`` of the model. The covariance is
        diagonal. Its entries are ``sd0^2`` (for an entry of ``Record.start``: the square of the standard deviation
        there), plus the square of the probable change before a first measurement that comes late.

    Notes
    -----
    The filter uses the first measurement again, so that the initial state must be much less certain than this
    measurement. ``sd0`` is therefore at least 5 times the noise. A state with ``sd0`` zero starts at its mean exactly,
    except for the change before a late measurement.
    """
    n = len(model.states)
    outputs = [o.name for o in model.outputs]
    index = {p.name: i for i, p in enumerate(model.parameters)}
    s = np.zeros(n + n * (n + 1) // 2 if covariance else n)
    tangent: list[tuple[int, int, float]] = []
    for i, state in enumerate(model.states):
        j = outputs.index(state.from_output) if state.from_output in outputs else -1
        measured = data.first[j] if j >= 0 else np.nan
        start = None if np.isfinite(measured) else data.start.get(state.name)
        if np.isfinite(measured):
            s[i] = measured
        elif start is not None:
            s[i] = start[0]
        elif isinstance(state.x0, str):
            s[i] = values[index[state.x0]]
            tangent.append((i, index[state.x0], 1.0))
        else:
            s[i] = state.x0
        if covariance:
            at = n + i * n - i * (i - 1) // 2  # index of P[i, i], after the mean, in the upper triangle by rows
            sd = values[index[state.sd0]] if isinstance(state.sd0, str) else state.sd0
            sd = sd if start is None else start[1]
            least = START_SPREAD * float(data.noise[j]) if np.isfinite(measured) and sd != 0.0 else 0.0
            s[at] = max(float(sd), least) ** 2 + (data.moved[j] ** 2 if np.isfinite(measured) else 0.0)
            if isinstance(state.sd0, str) and start is None and sd >= least:
                tangent.append((at, index[state.sd0], 2.0 * float(sd)))
    return InitialCondition(s, tuple(tangent))
