"""Data for estimation: channels with their own sample times, and records of rows that a model uses.

The second half of the module prepares records for the compiled kernels: it checks them once, adds masks of the sensors,
and computes the initial state.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.model import Input, Model, Sensor, command_of, shaft_speed_of
from seatrial.ident.numerics import NORMAL_MAD, SECOND_DIFFERENCE, Array, noise_from_differences, wrap

ON_CHANGE = 1.0  # s between samples; a command with longer intervals is logged only when it changes
SHARE_LOST = 0.1  # of the record; the early end of one signal may cost so much without a warning
TIME_INPUT = "t"  # an input of this name is the time since the start of the record
WORK_INPUT = "work"  # an input of this name is the integral of the cubed shaft speeds, over WORK_UNIT
WORK_UNIT = 150.0  # s, at full power: the input is one after a run at full speed of this duration
AVERAGED = 0.6  # of the interval 1/rate; a sensor with shorter sample intervals is averaged
JITTER = 1.1  # times the longest step between rows; samples jitter, so that only longer gaps get additional rows
MAX_GAP_ROWS = 100_000  # of one gap; a filter would need hours to cross more of them step by step
MAX_ROWS = 20_000_000  # of a record, which then has some gigabytes
SAME_TIME = 1e-6  # s; times closer than this are one row (times in s since 1970 have a resolution of 0.24 us)


@dataclass(frozen=True)
class LeftOut:
    """Outliers that were left out of a signal."""

    t: Array  # (n,) [s], since the first sample of the signal
    value: Array  # (n,)


@dataclass(frozen=True)
class Channel:
    """One signal with its own sample times."""

    t: Array  # (n,) [s], never decreasing
    value: Array  # (n,)
    unit: str = ""
    source: str = ""  # device or imported column
    hold: str = ""  # value between the samples (`seatrial.ident.model.Input`); empty if unknown
    sampled: float = 0.0  # s, original sample interval if the signal was resampled to a finer clock; else zero
    left_out: LeftOut | None = None  # outliers (`seatrial.ident.data.outliers`); None if no sample was left out


def sample_and_hold(channel: Channel, t: Array) -> Array:
    """Return the zero-order hold of a channel.

    Parameters
    ----------
    channel
        The signal.
    t
        Times (n,) [s].

    Returns
    -------
    Array (n,)
        The latest value at or before each time. The first value holds for earlier times.
    """
    at = np.searchsorted(channel.t, t + SAME_TIME, side="right") - 1
    return channel.value[np.clip(at, 0, None)]


def block_mean(channel: Channel, edges: Array, angle: bool = False) -> tuple[Array, Array]:
    """Return block averages of a channel.

    Parameters
    ----------
    channel
        The signal.
    edges
        Edges of the blocks (n + 1,) [s].
    angle
        Whether the value is an angle and has to be unwrapped.

    Returns
    -------
    tuple of Array (n,)
        Mean value and mean time [s] of each block, NaN for an empty block.
    """
    value = np.unwrap(channel.value) if angle else channel.value
    index = np.searchsorted(edges, channel.t, side="right") - 1
    inside = (index >= 0) & (index < edges.size - 1) & np.isfinite(value)
    index, value, t = index[inside], value[inside], channel.t[inside]
    count = np.bincount(index, minlength=edges.size - 1)
    with np.errstate(invalid="ignore"):
        mean = np.bincount(index, value, edges.size - 1) / count
        centre = np.bincount(index, t, edges.size - 1) / count
    return mean, centre


@dataclass(frozen=True)
class LogSegment:
    """Signals of one log, and the part of it to use."""

    name: str
    channels: Mapping[str, Channel]  # by name
    t_from: float | None = None  # s; None: where all signals are known
    t_to: float | None = None  # s; None: where the first signal ends
    meta: Mapping[str, object] = field(default_factory=dict)  # copied to the record


def make_record(model: Model, run: LogSegment, rate: float) -> Record:
    """Convert a segment of a log to rows for a model; ``rate`` [Hz] as in `build_record`."""
    return build_record(model, run.channels, name=run.name, t_from=run.t_from, t_to=run.t_to, rate=rate, meta=run.meta)


@dataclass(frozen=True)
class Record:
    """Rows of inputs and measurements of one segment, for one model.

    Attributes
    ----------
    t : Array (n_rows,)
        Times [s], increasing.
    u : Array (n_rows, n_inputs)
        Inputs at each row.
    u_next : Array (n_rows, n_inputs)
        Inputs at the end of the interval after each row. For a zero-order hold without averaging they equal ``u``.
    y : Array (n_rows, n_outputs)
        Measurements, NaN for outputs without a sample. The outputs of one sensor are all measured or all NaN.
    inputs, outputs
        Names of the columns.
    meta
        Information on the segment: missing sensors, start in the log, signal that ended early.
    start
        Mean and standard deviation of initial states by name, for states that no measurement gives. It is used for a
        block from the middle of a run, which does not start at rest.
    """

    name: str
    t: Array
    u: Array
    u_next: Array
    y: Array
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    meta: Mapping[str, Any] = field(default_factory=dict)
    start: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def h(self) -> Array:
        """Interval to the next row (n_rows,) [s]; zero for the last row."""
        return np.append(np.diff(self.t), 0.0)

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return int(self.t.size)

    @property
    def duration(self) -> float:
        """Time from the first to the last row [s]."""
        return float(self.t[-1] - self.t[0])

    def for_model(self, model: Model) -> Record:
        """Return the record with the inputs and outputs of another model, in the order of that model.

        Outputs that the record lacks are NaN. Neighbouring columns are views of the same arrays.

        Raises
        ------
        ValueError
            If an input of the model is missing.
        """
        inputs, outputs = [i.name for i in model.inputs], [o.name for o in model.outputs]
        missing = [n for n in inputs if n not in self.inputs]
        if missing:
            raise ValueError(f"{self.name}: no signal for the input {missing[0]!r} of model {model.name}")
        columns, y = [self.inputs.index(n) for n in inputs], self.y
        if tuple(outputs) != self.outputs:
            y = np.full((self.n_rows, len(outputs)), np.nan)
            for j, name in enumerate(outputs):
                if name in self.outputs:
                    y[:, j] = self.y[:, self.outputs.index(name)]
        u, u_next = _columns(self.u, columns), _columns(self.u_next, columns)
        return replace(self, u=u, u_next=u_next, y=y, inputs=tuple(inputs), outputs=tuple(outputs))

    def part(self, t_from: float, t_to: float, name: str = "") -> Record:
        """Return the rows with t_from <= t < t_to [s]. Without a name the times are appended to the record's name."""
        within = self.rows((self.t >= t_from) & (self.t < t_to))
        return replace(within, name=name or f"{self.name}[{t_from:g}:{t_to:g}]")

    def rows(self, which: slice | NDArray[np.bool_]) -> Record:
        """Return the record with the selected rows only."""
        return replace(self, t=self.t[which], u=self.u[which], u_next=self.u_next[which], y=self.y[which])


def _columns(a: Array, columns: Sequence[int]) -> Array:
    """Return some columns of an array, as a view if they are neighbours: a search keeps records of dozens of models."""
    first = columns[0] if columns else 0
    if list(columns) == list(range(first, first + len(columns))):
        return a[:, first : first + len(columns)]
    return np.ascontiguousarray(a[:, columns])


def build_record(
    model: Model,
    channels: Mapping[str, Channel],
    *,
    name: str = "record",
    t_from: float | None = None,
    t_to: float | None = None,
    rate: float = 10.0,
    max_step: float | None = None,
    meta: Mapping[str, Any] | None = None,
) -> Record:
    """Convert channels to rows for a model.

    Parameters
    ----------
    model
        The model. Channels are found by the names of its inputs and outputs.
    channels
        The signals by name.
    name
        Name of the record, for messages.
    t_from, t_to
        Times [s] of the part to use. By default the record covers the time in which all signals are known.
    rate
        Rate [Hz] above which a sensor is averaged over blocks of 1/rate, or thinned to one sample of each block if the
        model asks for it. A slower sensor keeps its own times.
    max_step
        Longest interval between rows [s], by default that of the model. Longer gaps get additional rows.
    meta
        Further entries of ``Record.meta``.

    Returns
    -------
    Record
        Its rows are the union of the sample times of all sensors, of the changes of inputs with the hold ``zero`` that
        are not averaged, and of the additional rows of gaps. ``meta["missing"]`` names the sensors of which a channel
        is missing. ``meta["cut"]`` has the name of a signal that ends early and the seconds lost by it, if more than
        `SHARE_LOST` of the record is lost.

    Raises
    ------
    ValueError
        If an input or all sensors are missing, if the signals do not overlap, or if a gap is too long.

    Notes
    -----
    If all sensors on which inputs act without delay are averaged, the inputs on which forces depend without delay are
    averaged over the same time. Otherwise a measured acceleration would be smoother than the thrust that causes it, and
    the estimated mass would be too large (prefiltering: Ljung 1999, section 14.4).
    """
    derived = _derived_inputs(model, channels)
    channels = {**channels, **derived}
    present = _present(model, channels, name)
    own = [i for i in model.inputs if i.name != TIME_INPUT and not i.tap]
    used = [channels[o.name] for s in present for o in s.outputs] + [channels[i.name] for i in own]
    start = max(c.t[0] for c in used) if t_from is None else t_from
    ends = _ends(present, own, channels)
    end = min(ends.values()) if t_to is None else t_to
    if end - start < 2.0 / rate:
        raise ValueError(
            f"{name}: inputs and sensors overlap for only {max(end - start, 0.0):.2f} s; record them at the same time"
        )
    windows = {s.name: _averaging_window(_interval(channels[s.outputs[0].name], start, end), rate) for s in present}
    samples = {s.name: _sensor_samples(name, s, channels, start, end, rate, windows[s.name] > 0.0) for s in present}
    windows |= {s.name: 0.0 for s in present if not s.averaged}
    window = min((windows[s.name] for s in present if _has_feedthrough(model, s)), default=0.0)
    exact = [i for i in own if i.hold == "zero" and not (i.prefilter and window)]
    switches = [_changes(channels[i.name]) for i in exact]
    t = _rows([times for times, _ in samples.values()], switches, start, end, max_step or model.max_step)
    missing = tuple(s.name for s in model.sensors if s.name not in samples)
    lost_s, first = max(ends.values()) - end, min(ends, key=lambda n: ends[n])
    cut = {"cut": (first, lost_s)} if t_to is None and lost_s > SHARE_LOST * (lost_s + end - start) else {}
    return Record(
        name,
        t - start,
        *_inputs(model, channels, t, start, window, frozenset(derived)),
        _measured(model, samples, t),
        tuple(i.name for i in model.inputs),
        tuple(o.name for o in model.outputs),
        {"missing": missing, "t0": start, **cut, **(meta or {})},
    )


def _present(model: Model, channels: Mapping[str, Channel], name: str) -> list[Sensor]:
    """Return the sensors of which all channels exist. Raise ValueError if there is none, or if an input is missing."""
    missing = [i.name for i in model.inputs if i.name not in channels and i.name != TIME_INPUT]
    if missing:
        available = ", ".join(sorted(channels)) or "no signals"
        raise ValueError(
            f"{name}: no signal for the input {missing[0]!r} of model {model.name}; the log has {available}"
        )
    present = [s for s in model.sensors if all(o.name in channels for o in s.outputs)]
    if not present:
        names = ", ".join(s.name for s in model.sensors)
        raise ValueError(f"{name}: none of the sensors of model {model.name} is in the log: {names}")
    return present


def _ends(present: Sequence[Sensor], inputs: Sequence[Input], channels: Mapping[str, Channel]) -> dict[str, float]:
    """Return the time up to which each signal is known [s].

    A command that is logged only when it changes is held to the end of the sensors, if it was held for at least half of
    that time before. Otherwise its source may have failed.
    """
    ends = {o.name: float(channels[o.name].t[-1]) for s in present for o in s.outputs}
    latest = max(ends.values())
    for signal in inputs:
        c = channels[signal.name]
        longest = float(np.diff(c.t).max(initial=0.0))
        on_change = signal.hold != "linear" and not c.sampled and longest > ON_CHANGE
        ends[signal.name] = latest if on_change and 0.0 < latest - c.t[-1] < 2.0 * longest else float(c.t[-1])
    return ends


def _measured(model: Model, samples: Mapping[str, tuple[Array, Array]], t: Array) -> Array:
    """Return the measurements at the rows t (n_rows, n_outputs), by the times and values of each sensor."""
    y, names = np.full((t.size, len(model.outputs)), np.nan), [o.name for o in model.outputs]
    for sensor in model.sensors:
        if sensor.name in samples:
            times, values = samples[sensor.name]
            rows = np.searchsorted(t, times - SAME_TIME)
            y[rows[:, None], [names.index(o.name) for o in sensor.outputs]] = values
    return y


def _derived_inputs(model: Model, channels: Mapping[str, Channel]) -> dict[str, Channel]:
    """Return channels that are computed from others: delayed inputs, and the work of the thrusters."""
    derived: dict[str, Channel] = {}
    for signal in (i for i in model.inputs if i.name not in channels):
        if signal.tap and signal.tap_of in channels:
            c = channels[signal.tap_of]
            derived[signal.name] = replace(c, t=c.t + signal.delay)
        elif signal.name == WORK_INPUT:
            pairs = [(name_of("left"), name_of("right")) for name_of in (shaft_speed_of, command_of)]
            shafts = next(([channels[n] for n in pair] for pair in pairs if set(pair) <= set(channels)), [])
            if shafts:
                t = shafts[0].t
                power = np.sum([np.abs(np.interp(t, c.t, c.value)) ** 3 for c in shafts], axis=0)
                steps_up = np.diff(t) * (power[1:] + power[:-1]) / 2
                derived[signal.name] = Channel(t, np.append(0.0, np.cumsum(steps_up)) / WORK_UNIT)
    return derived


def _sensor_samples(
    name: str, sensor: Sensor, channels: Mapping[str, Channel], start: float, end: float, rate: float, faster: bool
) -> tuple[Array, Array]:
    """Return times (n,) and values (n, n_outputs) of the samples of a sensor; ``faster``: than the rate of the rows.

    Raises ValueError if the outputs of the sensor have no common time.
    """
    first = channels[sensor.outputs[0].name]
    if not (faster and sensor.averaged):
        # An import drops NaN for each signal separately. A sample needs all outputs at the same time.
        own_channels, inside = [channels[o.name] for o in sensor.outputs], (first.t >= start) & (first.t <= end)
        times = reduce(np.intersect1d, [c.t for c in own_channels[1:]], first.t[inside])
        if not times.size and inside.any():
            names = " and ".join(o.name for o in sensor.outputs)
            raise ValueError(
                f"{name}: {names} are read together as the sensor {sensor.name}, and no row has them at the same time: "
                "give them the same time stamps"
            )
        if faster:
            times = _in_the_middle(times, start, end, rate)
        values = np.column_stack([c.value[np.searchsorted(c.t, times)] for c in own_channels])
    else:
        own_times = np.concatenate([channels[o.name].t for o in sensor.outputs])
        edges = _block_edges(own_times[(own_times >= start) & (own_times <= end)], start, end, rate)
        blocks = [block_mean(channels[o.name], edges, o.angle) for o in sensor.outputs]
        times, values = blocks[0][1], np.column_stack([b[0] for b in blocks])
    good = np.isfinite(times) & np.isfinite(values).all(axis=1)
    return times[good], values[good]


def _block_edges(times: Array, start: float, end: float, rate: float) -> Array:
    """Return the edges [s] of blocks of 1/rate from start to end [s], but only edges next to one of the times (n,) [s].

    All edges in a gap of years would need gigabytes.
    """
    step = (start + 1.0 / rate) - start  # as np.arange has it
    last = math.ceil((end + 0.5 / rate - start) * rate) - 1
    block = np.unique(np.floor((times - start) / step))
    near = np.unique(np.concatenate([block + k for k in (-1.0, 0.0, 1.0, 2.0)]))  # one more than needed: rounding
    return np.asarray(start + near[(near >= 0.0) & (near <= last)] * step)


def _in_the_middle(times: Array, start: float, end: float, rate: float) -> Array:
    """Return the time nearest to the middle of each block of 1/rate; ``times`` (n,) [s] increase."""
    # Only blocks that contain a time: all blocks in a gap of years would need gigabytes.
    numbers = np.unique(np.floor((times - start) * rate + SAME_TIME))
    middle = start + (numbers + 0.5) / rate
    numbers, middle = numbers[middle < end], middle[middle < end]
    after = np.clip(np.searchsorted(times, middle), 1, max(times.size - 1, 1))
    nearest = after - (middle - times[after - 1] <= times[np.minimum(after, times.size - 1)] - middle)
    own = np.floor((times[nearest] - start) * rate + SAME_TIME) == numbers
    return np.asarray(times[nearest[own]])


def _interval(channel: Channel, start: float, end: float) -> float:
    """Return the median sample interval [s] from start to end [s]; infinite for fewer than three samples."""
    inside = (channel.t >= start) & (channel.t <= end)
    return float(np.median(np.diff(channel.t[inside]))) if inside.sum() > 2 else np.inf


def _averaging_window(interval: float, rate: float) -> float:
    """Return the length [s] of the moving average that is equivalent to the block mean of samples ``interval`` s apart.

    A block has the length 1/rate. Both averages have the same variance of time. Zero for a sensor that is too slow to
    be averaged.
    """
    return math.sqrt(1.0 / rate**2 - interval**2) if interval <= AVERAGED / rate else 0.0


def _has_feedthrough(model: Model, sensor: Sensor) -> bool:
    """Return whether an input acts on the output of a sensor without delay, as thrust acts on an accelerometer."""
    x, p = np.full(len(model.states), 0.1), list(model.values.values())
    u = np.array([[0.3] * len(model.inputs), [0.4] * len(model.inputs)])  # two arbitrary inputs at the same state
    prefilter = np.array([i.prefilter and i.name != TIME_INPUT for i in model.inputs])
    first, second = (model.signals(list(x), list(np.where(prefilter, row, u[0])), p).y for row in u)
    return any(first[o.name] != second[o.name] for o in sensor.outputs)


def _rows(measured: Sequence[Array], switches: Sequence[Array], start: float, end: float, max_step: float) -> Array:
    """Return the times of the rows [s]: the union of all times, with additional rows in gaps longer than ``max_step``.

    Times closer than `SAME_TIME` become one row. Raises ValueError if a gap is too long.
    """
    t: Array = np.sort(np.concatenate([*measured, *[s[(s > start) & (s < end)] for s in switches], [start, end]]))
    t = t[np.append(True, np.diff(t) > SAME_TIME)]
    gaps: Array = np.diff(t)
    pieces = np.where(gaps > JITTER * max_step, np.ceil(gaps / max_step - 1e-6), 1)
    if pieces.max(initial=1) > MAX_GAP_ROWS or pieces.sum() > MAX_ROWS:
        longest = int(np.argmax(gaps))
        raise ValueError(
            f"no sample from {t[longest]:.1f} to {t[longest + 1]:.1f} s: too long to bridge; "
            "choose a part of the log by its times, or split the log at the gap"
        )
    pieces = pieces.astype(int)
    if pieces.max(initial=1) == 1:
        return t
    within = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    filled = np.repeat(t[:-1], pieces) + np.repeat(gaps, pieces) * within / np.repeat(pieces, pieces)
    return np.asarray(np.append(filled, t[-1]))


def _changes(channel: Channel) -> Array:
    """Return the times [s] at which the value changes. A repeated command adds no row."""
    return np.asarray(channel.t[1:][np.diff(channel.value) != 0.0])


def _inputs(
    model: Model, channels: Mapping[str, Channel], t: Array, start: float, window: float, derived: frozenset[str]
) -> tuple[Array, Array]:
    """Return the inputs at the rows t (n_rows,) and at the ends of their intervals, (n_rows, n_inputs) each.

    ``start``: start of the record [s]. ``window`` [s]: length of the moving average that the sensors have passed.
    ``derived``: names of channels that were computed from others.
    """
    u, u_next = np.empty((2, t.size, len(model.inputs)))
    smoothed: dict[str, SmoothSignal] = {}  # once for a signal with hundreds of delayed copies
    for j, signal in enumerate(model.inputs):
        if signal.name == TIME_INPUT:
            u[:, j], u_next[:, j] = t - start, np.append(t[1:], t[-1]) - start
        elif signal.prefilter and (window or signal.hold == "linear"):
            copied = signal.tap_of if signal.tap and signal.name in derived else ""
            own, late = (copied, signal.delay) if copied else (signal.name, 0.0)
            if own not in smoothed:
                delays = [0.0, *(i.delay for i in model.inputs if i.tap_of == own)]
                span = t[0] - max(delays) - window, t[-1] - min(delays) + window
                smoothed[own] = smooth_signal(_between(channels[own], *span), signal, window)
            u[:, j], u_next[:, j] = smoothed[own].lines(t - late)
        elif signal.hold == "zero":
            u[:, j] = u_next[:, j] = sample_and_hold(channels[signal.name], t)
        elif signal.hold == "linear":
            value = channels[signal.name].value
            at = np.interp(t, channels[signal.name].t, np.unwrap(value) if signal.angle else value)
            u[:, j], u_next[:, j] = at, np.append(at[1:], at[-1])
        else:
            u[:, j], u_next[:, j] = held_lines(channels[signal.name], t)
    return u, u_next


def _between(channel: Channel, t_from: float, t_to: float) -> Channel:
    """Return the channel with the samples between two times [s], and one more sample before and after them."""
    first = max(int(np.searchsorted(channel.t, t_from, side="right")) - 1, 0)
    last = max(int(np.searchsorted(channel.t, t_to)) + 1, first + 1)
    return replace(channel, t=channel.t[first:last], value=channel.value[first:last])


@dataclass(frozen=True)
class SmoothSignal:
    """Signal that is linear between its times and constant before and after them."""

    t: Array  # (n,) [s], never decreasing
    value: Array  # (n,)
    integral: Array  # (n,), from the first time

    def lines(self, t: Array) -> tuple[Array, Array]:
        """Approximate the signal by a straight line in each interval.

        Parameters
        ----------
        t
            Edges of the intervals (n,) [s].

        Returns
        -------
        tuple of Array (n,)
            Values of the line at the start and at the end of the interval after each time. The line starts at the value
            of the signal and has its mean over the interval. A line to the next value would lose the impulse of corners
            inside the interval.
        """
        value = np.interp(t, self.t, self.value)
        mean = np.diff(_integral(self.t, self.value, self.value[1:], self.integral, t)) / np.diff(t)
        return value, np.append(2.0 * mean - value[:-1], value[-1])


def smooth_signal(channel: Channel, signal: Input, window: float) -> SmoothSignal:
    """Return the centred moving average of an input.

    Parameters
    ----------
    channel
        Samples of the input.
    signal
        Definition of the input: it is linear or held between its samples, and may be an angle.
    window
        Length of the moving average [s]; zero leaves the signal unchanged.

    Returns
    -------
    SmoothSignal
        Exact at each sample and half a window before and after it; linear in between.
    """
    t, value, linear = channel.t, np.unwrap(channel.value) if signal.angle else channel.value, signal.hold == "linear"
    if not linear:  # the first and the last value also hold before and after the samples
        t, value = np.concatenate([t[:1] - window, t, t[-1:] + window]), np.pad(value, 1, mode="edge")
    after = value[1:] if linear else value[:-1]
    if window:
        whole, own, held = _cumulated(t, value, after), t, value
        t = np.unique(np.clip(np.concatenate([own - window / 2, own, own + window / 2]), own[0], own[-1]))
        half = np.minimum(window / 2, np.minimum(t - own[0], own[-1] - t))  # the window is shorter near both ends
        sums = _integral(own, held, after, whole, t + half) - _integral(own, held, after, whole, t - half)
        value = np.interp(t, own, held)
        np.divide(sums, 2 * half, out=value, where=half > SAME_TIME)
        after = value[1:]
    return SmoothSignal(t, value, _cumulated(t, value, after))


def _cumulated(t: Array, value: Array, after: Array) -> Array:
    """Return the integral (n,) of a signal over its times t (n,) [s].

    The signal is linear from ``value`` (n,) at each time to ``after`` (n - 1,) just before the next time.
    """
    return np.append(0.0, np.cumsum(np.diff(t) * (value[:-1] + after) / 2))


def _integral(t: Array, value: Array, after: Array, whole: Array, at: Array) -> Array:
    """Return the integral (m,) of the same signal up to the times ``at`` (m,) [s]; ``whole`` (n,): at its own times.

    The signal is constant before its first time and after its last time.
    """
    k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, max(t.size - 2, 0))
    since, slope = np.clip(at, t[0], t[-1]) - t[k], np.zeros(k.size)
    if t.size > 1:
        slope = (after - value[:-1])[k] / np.maximum(np.diff(t)[k], SAME_TIME)
    outside = np.minimum(at - t[0], 0.0) * value[0] + np.maximum(at - t[-1], 0.0) * value[-1]
    return np.asarray(whole[k] + since * (value[k] + slope * since / 2) + outside)


def held_lines(channel: Channel, t: Array) -> tuple[Array, Array]:
    """Approximate a zero-order hold by a straight line in each interval.

    Parameters
    ----------
    channel
        The signal.
    t
        Edges of the intervals (n,) [s].

    Returns
    -------
    tuple of Array (n,)
        Values of the line at the start and at the end of the interval after each time.

    Notes
    -----
    The line is the least-squares line. It keeps the mean and the first moment of the signal. A lag that follows
    therefore sees each change at its right time, to third order of the interval, although no row lies at the change.
    """
    changes = _changes(channel)
    edges = np.unique(np.concatenate([t, changes[(changes > t[0]) & (changes < t[-1])]]))
    start, end = edges[:-1], edges[1:]
    value = sample_and_hold(channel, (start + end) / 2)
    row = np.searchsorted(t, (start + end) / 2) - 1
    h, middle = np.diff(t), (t[:-1] + t[1:]) / 2
    mean = np.bincount(row, value * (end - start), h.size) / h
    moment = value * ((end - middle[row]) ** 2 - (start - middle[row]) ** 2) / 2
    half = 6.0 * np.bincount(row, moment, h.size) / h**2
    last = sample_and_hold(channel, t[-1:])
    return np.append(mean - half, last), np.append(mean + half, last)


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
    """Record as arrays for a kernel.

    Attributes
    ----------
    rows
        ``u``, ``u_next`` (n_rows, n_inputs), ``y`` (n_rows, n_outputs), ``h`` (n_rows,) [s] of the record.
    mask : Array (n_rows,)
        One bit for each sensor that has a sample in the row.
    first : Array (n_outputs,)
        First measurement of each output, NaN for an output without one.
    moved : Array (n_outputs,)
        Possible change of the output before its first measurement; zero unless this measurement came late.
    noise : Array (n_outputs,)
        Upper estimate of the standard deviation of the noise by differences; zero if unknown.
    n_measured
        Number of measured values.
    outliers : Array (n_rows, n_outputs)
        Outliers before the first measurement. Their bits in the mask are zero.
    start
        Initial states of ``Record.start``.
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
    """Converter of records to `Prepared` for one model, with a cache for records that are still in use."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self._cache: dict[int, tuple[weakref.ref[Record], Prepared]] = {}

    def __call__(self, record: Record) -> Prepared:
        """Return the prepared record, from the cache if it was prepared before.

        Raises
        ------
        ValueError
            If the record does not fit the model. The message has the name of the record.
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
        """Check the record and compute mask, first measurements, noise and outliers."""
        model = self.model
        names = tuple(i.name for i in model.inputs), tuple(o.name for o in model.outputs)
        if (record.inputs, record.outputs) != names:
            record = record.for_model(model)
        self._check(record)
        measured = np.isfinite(record.y)
        first, outliers = _first(model, record, measured)
        mask = np.zeros(record.n_rows, np.uint32)
        first_output = 0
        for bit, sensor in enumerate(model.sensors):
            columns = measured[:, first_output : first_output + len(sensor.outputs)]
            first_output += len(sensor.outputs)
            whole = columns.all(axis=1)
            partly = np.flatnonzero(columns.any(axis=1) & ~whole)
            if partly.size:
                raise ValueError(
                    f"record {record.name}: a sample of {sensor.name} at {record.t[partly[0]]:g} s has "
                    "some of its outputs and lacks others"
                )
            of_sensor = outliers[:, first_output - len(sensor.outputs) : first_output]
            of_sensor |= of_sensor.any(axis=1, keepdims=True)  # a sample is used or left out with all its outputs
            mask |= np.where(whole & ~of_sensor[:, 0], np.uint32(1 << bit), np.uint32(0))
        rows = {"u": record.u, "u_next": record.u_next, "y": record.y, "h": record.h}
        contiguous = {name: np.ascontiguousarray(a, dtype=np.float64) for name, a in rows.items()}
        n_measured = int((measured & ~outliers).sum())
        moved, noise = _moved(model, record, measured & ~outliers), _noise(model, record, measured & ~outliers)
        return Prepared(record.n_rows, contiguous, mask, first, moved, noise, n_measured, outliers, record.start)

    def _check(self, record: Record) -> None:
        """Raise ValueError if shapes, times or inputs of the record are invalid."""
        model, n = self.model, record.n_rows
        shapes = {"u": (n, len(model.inputs)), "u_next": (n, len(model.inputs)), "y": (n, len(model.outputs))}
        for name, shape in shapes.items():
            if getattr(record, name).shape != shape:
                raise ValueError(
                    f"record {record.name}: {name} is {getattr(record, name).shape}, but model "
                    f"{model.name} needs {shape}"
                )
        if n < 2 or not (np.diff(record.t) > 0).all():
            raise ValueError(f"record {record.name}: its times do not increase, or it has fewer than two rows")
        known = np.isfinite(record.u) & np.isfinite(record.u_next)
        whole = np.asarray(known.all(axis=0))  # fast for hundreds of inputs
        for j, signal in enumerate(model.inputs):
            if not whole[j]:
                at = record.t[np.argmin(known[:, j])]
                raise ValueError(f"record {record.name}: the input {signal.name} has no value at {at:g} s")


def _first(model: Model, record: Record, measured: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """Return the first measurement of each output (n_outputs,), and the outliers before it (n_rows, n_outputs).

    The outliers must be left out. While the initial state is uncertain every sample is probable: the filter would
    accept an outlier, become certain of it, and then reject the good samples.
    """
    found, outliers = np.full(measured.shape[1], np.nan), np.zeros(measured.shape, dtype=bool)
    for j in np.flatnonzero(measured.any(axis=0)):
        output = model.outputs[j]
        rows = np.flatnonzero(measured[:, j])
        k = _agreeing(record.t[rows], record.y[rows, j], output.angle) if output.robust else 0
        found[j], outliers[rows[:k], j] = record.y[rows[k], j], True
    return found, outliers


def _moved(model: Model, record: Record, measured: NDArray[np.bool_]) -> Array:
    """Return the possible change of each output before a late first measurement (n_outputs,); zero if it was not late.

    The change is the delay times the fastest rate among all outputs of the same unit, since north and east velocity
    exchange when a boat turns.
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


def _noise(model: Model, record: Record, measured: NDArray[np.bool_]) -> Array:
    """Estimate the white noise of each output that initialises a state (n_outputs,), in the unit of the output.

    The estimate uses the distance of each sample from the straight line between its neighbours. Curvature of the motion
    inflates it, which only makes the initial state less certain. Repeated samples, as of a slow sensor that is read
    often, are skipped.
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


def _agreeing(t: Array, samples: Array, angle: bool) -> int:
    """Return the index of the first sample that is no outlier.

    A robust straight line is fitted to the first samples by repeated medians (Siegel 1982: its slope is the median of
    the median slopes of each sample to all others). The result is the first sample near this line. An earlier sample
    also counts if the two samples after it lead to it, as in a curve. Distances are compared with the noise by second
    differences. Second differences of zero, frequent for a sensor of coarse resolution, are ignored.
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
        extrapolated = y[k] + (y[k + 1] - y[k]) / (t[k + 1] - t[k]) * (t[k - 1] - t[k])
        if abs(y[k - 1] - extrapolated) > reach:
            break
        k -= 1
    return k


def _distances(samples: Array, angle: bool) -> Array:
    """Return the median distance of each sample to all samples (n,)."""
    return np.asarray(np.median(np.abs(wrap(samples[:, None] - samples, angle)), axis=1))


@dataclass(frozen=True)
class InitialCondition:
    """State at the start of a record, and its derivative with respect to the parameters."""

    s: Array  # (n_s,), mean and, if required, the upper triangle of the covariance
    tangent: tuple[tuple[int, int, float], ...]  # entry of s, index of the parameter, derivative


def initial_condition(model: Model, values: Array, data: Prepared, covariance: bool) -> InitialCondition:
    """Return the initial mean and covariance of the states.

    Parameters
    ----------
    model
        The model.
    values
        Values of its parameters (n_parameters,).
    data
        The prepared record.
    covariance
        Whether the covariance is required.

    Returns
    -------
    InitialCondition
        The mean of a state is the first measurement (``from_output``), else that of ``Record.start``, else the
        parameter or number ``x0`` of the model. The covariance is diagonal with ``sd0^2``, plus the square of the
        possible change before a late first measurement.

    Notes
    -----
    The filter uses the first measurement again, so that the initial state must be much less certain than this
    measurement. ``sd0`` is therefore at least ``START_SPREAD`` times the noise. A state with ``sd0`` zero remains known
    exactly.
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
