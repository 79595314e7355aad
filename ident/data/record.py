"""Data for estimation: channels on their own clocks, and records of rows with every sensor at its own times.

Records in the form that kernels read: checked once, with masks of the sensors, and the initial state.
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

from seatrial.ident.model import Input, Model, Sensor
from seatrial.ident.numerics import NORMAL_MAD, SECOND_DIFFERENCE, Array, noise_from_differences, wrap

ON_CHANGE = 1.0  # s between two samples of a command that is not written all the time
SHARE_LOST = 0.1  # of the data, that one signal's early end may cost without a word
TIME_INPUT = "t"  # an input of this name is the time since the start of the record
WORK_INPUT = "work"  # an input of this name is the integral of the cubed shaft speeds, over WORK_UNIT
WORK_UNIT = 150.0  # s, at full power: the input is one after a run at full speed of this duration
AVERAGED = 0.6  # of a row's 1/rate: sensors whose samples are closer are averaged
JITTER = 1.1  # times the longest step between rows: a gap that is longer by no more is none, as samples never keep time
MAX_GAP_ROWS = 100_000  # of one gap: hours, that a filter would cross step by step
MAX_ROWS = 20_000_000  # of a record: some gigabytes
SAME_TIME = 1e-6  # s; times closer than this are one row (seconds since 1970 have steps of 0.24 us)


@dataclass(frozen=True)
class LeftOut:
    """Samples left out of a signal: ``t`` (n,) seconds since its first sample, and ``value`` (n,)."""

    t: Array
    value: Array


@dataclass(frozen=True)
class Channel:
    """One signal on its own clock: ``t`` (n,) seconds, never decreasing; ``value`` (n,). ``hold``: what is known of it
    between the samples (``seatrial.ident.model.Input``), empty: nothing. ``sampled``: s between the samples that it was
    made of, where it is on a finer clock; else zero."""

    t: Array
    value: Array
    unit: str = ""
    source: str = ""
    hold: str = ""
    sampled: float = 0.0
    left_out: LeftOut | None = None  # outliers (seatrial.ident.data.outliers); None: nothing was left out


def sample_and_hold(channel: Channel, t: Array) -> Array:
    """Zero-order hold: the latest value at or before each of the times t (n,) [s]; the first value before that."""
    at = np.searchsorted(channel.t, t + SAME_TIME, side="right") - 1
    return channel.value[np.clip(at, 0, None)]


def block_mean(channel: Channel, edges: Array, angle: bool = False) -> tuple[Array, Array]:
    """Block averages of value and time (n,) each, between ``edges`` (n + 1,) [s]; NaN where a block is empty. An
    ``angle`` is unwrapped first."""
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
    """One log: its signals by name, and which part of it to use."""

    name: str
    channels: Mapping[str, Channel]
    t_from: float | None = None
    t_to: float | None = None
    meta: Mapping[str, object] = field(default_factory=dict)


def make_record(model: Model, run: LogSegment, rate: float) -> Record:
    """A log's segment as rows for a model; ``rate`` [Hz] as in `build_record`."""
    return build_record(model, run.channels, name=run.name, t_from=run.t_from, t_to=run.t_to, rate=rate, meta=run.meta)


@dataclass(frozen=True)
class Record:
    """One segment as rows of time, each with the inputs and the measurements of that time.

    t (n_rows,) [s], increasing; u (n_rows, n_inputs) at each row; u_next (n_rows, n_inputs) at the end of the
    interval that follows (equal to ``u`` for a zero-order hold that is not averaged); y (n_rows, n_outputs), NaN where
    nothing was measured (a sensor's outputs are all there or all NaN); h (n_rows,) the interval that follows, 0 in the
    last row; ``start``: of a block from the middle of a run, mean and standard deviation of the states with which it
    begins, where no measurement gives them: not at rest, as the model has it.
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
        """Interval to the next row (n_rows,) [s]; zero in the last."""
        return np.append(np.diff(self.t), 0.0)

    @property
    def n_rows(self) -> int:
        return int(self.t.size)

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self.t[-1] - self.t[0])

    def for_model(self, model: Model) -> Record:
        """The columns that another model wants, in its order, of the same arrays where they are neighbours; an input
        that is not here is an error."""
        wanted, known = [i.name for i in model.inputs], [o.name for o in model.outputs]
        lost = [n for n in wanted if n not in self.inputs]
        if lost:
            raise ValueError(f"{self.name}: no signal for the input {lost[0]!r} of model {model.name}")
        columns, y = [self.inputs.index(n) for n in wanted], self.y
        if tuple(known) != self.outputs:
            y = np.full((self.n_rows, len(known)), np.nan)
            for j, name in enumerate(known):
                if name in self.outputs:
                    y[:, j] = self.y[:, self.outputs.index(name)]
        u, u_next = _columns(self.u, columns), _columns(self.u_next, columns)
        return replace(self, u=u, u_next=u_next, y=y, inputs=tuple(wanted), outputs=tuple(known))

    def part(self, t_from: float, t_to: float, name: str = "") -> Record:
        """The rows with t_from <= t < t_to."""
        within = self.rows((self.t >= t_from) & (self.t < t_to))
        return replace(within, name=name or f"{self.name}[{t_from:g}:{t_to:g}]")

    def rows(self, which: slice | NDArray[np.bool_]) -> Record:
        """Some of the rows."""
        return replace(self, t=self.t[which], u=self.u[which], u_next=self.u_next[which], y=self.y[which])


def _columns(a: Array, columns: Sequence[int]) -> Array:
    """Neighbouring columns are not copied: a search keeps a record for each of dozens of models."""
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
    """Rows for a model from channels named like its inputs and outputs.

    A sensor faster than ``rate`` [Hz] is averaged over blocks of 1/rate, whose noise is then smaller by the root of
    their size, or, where the model says so, gives one sample of each; a slower one keeps its own times. Where all
    sensors that feel inputs at once are averaged, inputs that forces follow at once are, too, over as long: an
    acceleration would be less sharp than the thrust that makes it, and the boat seem heavier (prefiltering: Ljung
    1999, section 14.4). Rows are the union of all times, with more where a gap exceeds ``max_step`` [s] by a tenth, by
    default that of the model, or where an input of hold ``zero`` changes that is not averaged. A sensor with a channel
    missing is left out, and said in ``meta["missing"]``; where a signal ends so early that a tenth of the others is
    lost, ``meta["cut"]`` has its name and the seconds.
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
        raise ValueError(f"{name}: inputs and sensors overlap for only {end - start:.2f} s")
    windows = {s.name: _averaging_window(_interval(channels[s.outputs[0].name], start, end), rate) for s in present}
    samples = {s.name: _sensor_samples(name, s, channels, start, end, rate, windows[s.name] > 0.0) for s in present}
    windows |= {s.name: 0.0 for s in present if not s.averaged}
    window = min((windows[s.name] for s in present if _feels_inputs(model, s)), default=0.0)
    exact = [i for i in own if i.hold == "zero" and not (i.prefilter and window)]
    switches = [_changes(channels[i.name]) for i in exact]
    t = _rows([times for times, _ in samples.values()], switches, start, end, max_step or model.max_step)
    missing = tuple(s.name for s in model.sensors if s.name not in samples)
    lost, first = max(ends.values()) - end, min(ends, key=lambda n: ends[n])
    cut = {"cut": (first, lost)} if t_to is None and lost > SHARE_LOST * (lost + end - start) else {}
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
    """The sensors of which every channel is there. Raises ValueError where there is none, or an input is missing."""
    lost = [i.name for i in model.inputs if i.name not in channels and i.name != TIME_INPUT]
    if lost:
        have = ", ".join(sorted(channels)) or "nothing"
        raise ValueError(f"{name}: no signal for the input {lost[0]!r} of model {model.name}; the log has {have}")
    present = [s for s in model.sensors if all(o.name in channels for o in s.outputs)]
    if not present:
        names = ", ".join(s.name for s in model.sensors)
        raise ValueError(f"{name}: none of the sensors of model {model.name} is in the log: {names}")
    return present


def _ends(present: Sequence[Sensor], inputs: Sequence[Input], channels: Mapping[str, Channel]) -> dict[str, float]:
    """The time up to which each signal is known [s]. A command that is written where it changes is held to the end of
    the sensors, if it has been held for half as long before: else its source may have died."""
    ends = {o.name: float(channels[o.name].t[-1]) for s in present for o in s.outputs}
    latest = max(ends.values())
    for signal in inputs:
        c = channels[signal.name]
        longest = float(np.diff(c.t).max(initial=0.0))
        on_change = signal.hold != "linear" and not c.sampled and longest > ON_CHANGE
        ends[signal.name] = latest if on_change and 0.0 < latest - c.t[-1] < 2.0 * longest else float(c.t[-1])
    return ends


def _measured(model: Model, samples: Mapping[str, tuple[Array, Array]], t: Array) -> Array:
    """Samples of the sensors, by their names, at the rows at which they came (n_rows, n_outputs)."""
    y, names = np.full((t.size, len(model.outputs)), np.nan), [o.name for o in model.outputs]
    for sensor in model.sensors:
        if sensor.name in samples:
            times, values = samples[sensor.name]
            rows = np.searchsorted(t, times - SAME_TIME)
            y[rows[:, None], [names.index(o.name) for o in sensor.outputs]] = values
    return y


def _derived_inputs(model: Model, channels: Mapping[str, Channel]) -> dict[str, Channel]:
    """Channels that follow from others: an input's own past, and the work the thrusters have done."""
    derived: dict[str, Channel] = {}
    for signal in (i for i in model.inputs if i.name not in channels):
        if signal.tap and signal.tap_of in channels:
            c = channels[signal.tap_of]
            derived[signal.name] = replace(c, t=c.t + signal.delay)
        elif signal.name == WORK_INPUT:
            pairs = (("n_left", "n_right"), ("n_cmd_left", "n_cmd_right"))
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
    """Times (n,) and values (n, n_outputs) of a sensor, ``faster`` than rows or not. Raises ValueError where its
    outputs share no time."""
    first = channels[sensor.outputs[0].name]
    if not (faster and sensor.averaged):
        # an import drops NaN signal by signal: a row has all outputs of one time, or does not exist
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
    """Return those edges [s] of the blocks of 1/rate [Hz] from start to end that lie next to one of the times (n,) [s].

    A gap of years has no edges inside; all of them would be gigabytes.
    """
    step = (start + 1.0 / rate) - start  # as np.arange has it
    last = math.ceil((end + 0.5 / rate - start) * rate) - 1
    block = np.unique(np.floor((times - start) / step))
    near = np.unique(np.concatenate([block + k for k in (-1.0, 0.0, 1.0, 2.0)]))  # one more: rounding
    return np.asarray(start + near[(near >= 0.0) & (near <= last)] * step)


def _in_the_middle(times: Array, start: float, end: float, rate: float) -> Array:
    """Of the times (n,) [s], in rising order, those next to the middle of each block of 1/rate, one of each at most."""
    # Only blocks that have a time: all blocks of a gap of years would be gigabytes.
    numbers = np.unique(np.floor((times - start) * rate + SAME_TIME))
    middle = start + (numbers + 0.5) / rate
    numbers, middle = numbers[middle < end], middle[middle < end]
    after = np.clip(np.searchsorted(times, middle), 1, max(times.size - 1, 1))
    nearest = after - (middle - times[after - 1] <= times[np.minimum(after, times.size - 1)] - middle)
    own = np.floor((times[nearest] - start) * rate + SAME_TIME) == numbers
    return np.asarray(times[nearest[own]])


def _interval(channel: Channel, start: float, end: float) -> float:
    """Between two samples of a sensor [s]; infinite where there are hardly any."""
    inside = (channel.t >= start) & (channel.t <= end)
    return float(np.median(np.diff(channel.t[inside]))) if inside.sum() > 2 else np.inf


def _averaging_window(interval: float, rate: float) -> float:
    """Length [s] of the moving average that does to a signal what the mean of a block of 1/rate [Hz] does, of samples
    ``interval`` [s] apart: the variance of their times is the same. Zero for a sensor that is not averaged."""
    return math.sqrt(1.0 / rate**2 - interval**2) if interval <= AVERAGED / rate else 0.0


def _feels_inputs(model: Model, sensor: Sensor) -> bool:
    """Whether what a sensor reads changes with an input at once, as an accelerometer does with thrust."""
    x, p = np.full(len(model.states), 0.1), list(model.values.values())
    u = np.array([[0.3] * len(model.inputs), [0.4] * len(model.inputs)])
    prefilter = np.array([i.prefilter and i.name != TIME_INPUT for i in model.inputs])
    now, then = (model.signals(list(x), list(np.where(prefilter, row, u[0])), p).y for row in u)
    return any(now[o.name] != then[o.name] for o in sensor.outputs)


def _rows(measured: Sequence[Array], switches: Sequence[Array], start: float, end: float, max_step: float) -> Array:
    """Union of all times; times closer than a microsecond are one row."""
    t: Array = np.sort(np.concatenate([*measured, *[s[(s > start) & (s < end)] for s in switches], [start, end]]))
    t = t[np.append(True, np.diff(t) > SAME_TIME)]
    gaps: Array = np.diff(t)
    pieces = np.where(gaps > JITTER * max_step, np.ceil(gaps / max_step - 1e-6), 1)
    if pieces.max(initial=1) > MAX_GAP_ROWS or pieces.sum() > MAX_ROWS:
        longest = int(np.argmax(gaps))
        raise ValueError(
            f"no sample from {t[longest]:.1f} to {t[longest + 1]:.1f} s: too long to bridge; "
            "choose a part of the log by its times, or split the log there"
        )
    pieces = pieces.astype(int)
    if pieces.max(initial=1) == 1:
        return t
    within = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    filled = np.repeat(t[:-1], pieces) + np.repeat(gaps, pieces) * within / np.repeat(pieces, pieces)
    return np.asarray(np.append(filled, t[-1]))


def _changes(channel: Channel) -> Array:
    """When the value becomes another one: a command that is repeated adds no row."""
    return np.asarray(channel.t[1:][np.diff(channel.value) != 0.0])


def _inputs(
    model: Model, channels: Mapping[str, Channel], t: Array, start: float, window: float, derived: frozenset[str]
) -> tuple[Array, Array]:
    """Inputs at the rows t (n_rows,) and at the ends of their intervals (n_rows, n_inputs); ``window`` [s]: that of
    the moving average that the sensors went through; ``derived``: channels that were made of others."""
    u, u_next = np.empty((2, t.size, len(model.inputs)))
    known: dict[str, SmoothSignal] = {}  # of a signal with hundreds of delayed copies, once
    for j, signal in enumerate(model.inputs):
        if signal.name == TIME_INPUT:
            u[:, j], u_next[:, j] = t - start, np.append(t[1:], t[-1]) - start
        elif signal.prefilter and (window or signal.hold == "linear"):
            copied = signal.tap_of if signal.tap and signal.name in derived else ""
            own, late = (copied, signal.delay) if copied else (signal.name, 0.0)
            if own not in known:
                delays = [0.0, *(i.delay for i in model.inputs if i.tap_of == own)]
                asked = t[0] - max(delays) - window, t[-1] - min(delays) + window
                known[own] = smooth_signal(_between(channels[own], *asked), signal, window)
            u[:, j], u_next[:, j] = known[own].lines(t - late)
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
    """The samples between two times [s], and the one on either side."""
    first = max(int(np.searchsorted(channel.t, t_from, side="right")) - 1, 0)
    last = max(int(np.searchsorted(channel.t, t_to)) + 1, first + 1)
    return replace(channel, t=channel.t[first:last], value=channel.value[first:last])


@dataclass(frozen=True)
class SmoothSignal:
    """A signal that is a straight line between times ``t`` (n,) [s], never decreasing, and constant before and after.

    value (n,); integral (n,): from the first of the times.
    """

    t: Array
    value: Array
    integral: Array

    def lines(self, t: Array) -> tuple[Array, Array]:
        """The signal as one straight line in each interval between the times t (n,) [s], from its value at the start,
        with its mean: the line's values at the start and at the end of the interval (n,) each.

        A line to the value at the end would cut the corners that the signal has between them: an impulse that is lost.
        """
        value = np.interp(t, self.t, self.value)
        mean = np.diff(_integral(self.t, self.value, self.value[1:], self.integral, t)) / np.diff(t)
        return value, np.append(2.0 * mean - value[:-1], value[-1])


def smooth_signal(channel: Channel, signal: Input, window: float) -> SmoothSignal:
    """An input's signal, linear or held between its samples, as its centred moving average over ``window`` [s], exact
    at each of its samples and half a window before and after, and linear in between; with a window of zero a linear one
    as it is."""
    t, value, linear = channel.t, np.unwrap(channel.value) if signal.angle else channel.value, signal.hold == "linear"
    if not linear:  # before and after its samples it holds as well
        t, value = np.concatenate([t[:1] - window, t, t[-1:] + window]), np.pad(value, 1, mode="edge")
    after = value[1:] if linear else value[:-1]
    if window:
        whole, own, held = _cumulated(t, value, after), t, value
        t = np.unique(np.clip(np.concatenate([own - window / 2, own, own + window / 2]), own[0], own[-1]))
        half = np.minimum(window / 2, np.minimum(t - own[0], own[-1] - t))  # at the ends there is no more of it
        sums = _integral(own, held, after, whole, t + half) - _integral(own, held, after, whole, t - half)
        value = np.interp(t, own, held)
        np.divide(sums, 2 * half, out=value, where=half > SAME_TIME)
        after = value[1:]
    return SmoothSignal(t, value, _cumulated(t, value, after))


def _cumulated(t: Array, value: Array, after: Array) -> Array:
    """Integral (n,) of a signal that runs from ``value`` at each of its times t (n,) [s] to ``after`` (n - 1,) at the
    next."""
    return np.append(0.0, np.cumsum(np.diff(t) * (value[:-1] + after) / 2))


def _integral(t: Array, value: Array, after: Array, whole: Array, at: Array) -> Array:
    """The same up to the times ``at`` (m,) [s]; before its first time and after its last the signal is constant."""
    k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, max(t.size - 2, 0))
    since, slope = np.clip(at, t[0], t[-1]) - t[k], np.zeros(k.size)
    if t.size > 1:
        slope = (after - value[:-1])[k] / np.maximum(np.diff(t)[k], SAME_TIME)
    outside = np.minimum(at - t[0], 0.0) * value[0] + np.maximum(at - t[-1], 0.0) * value[-1]
    return np.asarray(whole[k] + since * (value[k] + slope * since / 2) + outside)


def held_lines(channel: Channel, t: Array) -> tuple[Array, Array]:
    """A zero-order hold as a straight line in each interval between the times t (n,) [s]: the line's values at the
    start and at the end of the interval (n,) each.

    The line is the least-squares one. It has the signal's mean and first moment, so that behind a lag no change is
    moved in time and none is smeared, to third order of the interval, though no row is where the signal changes.
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


N_AGREE = 7  # samples of a sensor with outliers that the first is chosen from
# A sample at the start is an outlier where it is farther from a straight line than both of
START_OUTLIER_GATE = 4.0  # times the least distance of all, and
SAMPLE_OUTLIER_GATE = 4.0 * SECOND_DIFFERENCE / NORMAL_MAD  # standard deviations of the noise: 6.6, beyond any chance
LATE = 2.0  # usual intervals of an output, after which its first measurement is late
FAST = 0.95  # quantile of an output's rates of change: beyond it are outliers
START_SPREAD = 5.0  # times its noise: what a first measurement then tells twice is 4 % of its information
UNKNOWN_ANGLE = float(np.pi / np.sqrt(3.0))  # rad, standard deviation of a direction of which nothing is known


@dataclass(frozen=True)
class Prepared:
    """A record as arrays of a kernel.

    rows: ``u``, ``u_next`` (n_rows, n_inputs), ``y`` (n_rows, n_outputs), ``h`` (n_rows,) [s]; mask (n_rows,): a bit
    for each sensor that has a sample in that row; first (n_outputs,): the first measurement, NaN where there is none;
    moved (n_outputs,): how far the output may have moved before it, zero unless it came late; noise (n_outputs,): its
    standard deviation by differences, or more, zero where nothing tells it;
    n_measured: measured values; outliers (n_rows, n_outputs): those before the first measurement, without their bit;
    start: of ``Record``.
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
            columns = there[:, first_output : first_output + len(sensor.outputs)]
            first_output += len(sensor.outputs)
            whole = columns.all(axis=1)
            partly = np.flatnonzero(columns.any(axis=1) & ~whole)
            if partly.size:
                raise ValueError(
                    f"record {record.name}: a sample of {sensor.name} at {record.t[partly[0]]:g} s has "
                    "some of its outputs and lacks others"
                )
            of_it = outliers[:, first_output - len(sensor.outputs) : first_output]
            of_it |= of_it.any(axis=1, keepdims=True)  # a sample is taken or left as a whole
            mask |= np.where(whole & ~of_it[:, 0], np.uint32(1 << bit), np.uint32(0))
        rows = {"u": record.u, "u_next": record.u_next, "y": record.y, "h": record.h}
        contiguous = {name: np.ascontiguousarray(a, dtype=np.float64) for name, a in rows.items()}
        n_measured = int((there & ~outliers).sum())
        moved, noise = _moved(model, record, there & ~outliers), _noise(model, record, there & ~outliers)
        return Prepared(record.n_rows, contiguous, mask, first, moved, noise, n_measured, outliers, record.start)

    def _check(self, record: Record) -> None:
        model, n = self.model, record.n_rows
        wanted = {"u": (n, len(model.inputs)), "u_next": (n, len(model.inputs)), "y": (n, len(model.outputs))}
        for name, shape in wanted.items():
            if getattr(record, name).shape != shape:
                raise ValueError(
                    f"record {record.name}: {name} is {getattr(record, name).shape}, but model "
                    f"{model.name} needs {shape}"
                )
        if n < 2 or not (np.diff(record.t) > 0).all():
            raise ValueError(f"record {record.name}: its times do not increase, or it has fewer than two rows")
        known = np.isfinite(record.u) & np.isfinite(record.u_next)
        whole = np.asarray(known.all(axis=0))  # of hundreds of inputs at once
        for j, signal in enumerate(model.inputs):
            if not whole[j]:
                at = record.t[np.argmin(known[:, j])]
                raise ValueError(f"record {record.name}: the input {signal.name} has no value at {at:g} s")


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


def _moved(model: Model, record: Record, there: NDArray[np.bool_]) -> Array:
    """How far each output may have moved before its first measurement (n_outputs,), where that came late: by how fast
    it and others of its unit change, as boats turn."""
    delay, rate = np.zeros(there.shape[1]), np.zeros(there.shape[1])
    for j in np.flatnonzero(there.sum(axis=0) > 1):
        t = record.t[there[:, j]]
        steps, late = np.diff(t), t[0] - record.t[0]
        if late > LATE * np.median(steps):
            delay[j] = late
        change = wrap(np.diff(record.y[there[:, j], j]), model.outputs[j].angle)
        rate[j] = np.quantile(np.abs(change) / steps, FAST)
    found = np.zeros(there.shape[1])
    for j in np.flatnonzero(delay):
        o = model.outputs[j]
        fastest = max(rate[k] for k, other in enumerate(model.outputs) if other.unit == o.unit)
        found[j] = min(fastest * delay[j], UNKNOWN_ANGLE if o.angle else np.inf)
    return found


def _noise(model: Model, record: Record, there: NDArray[np.bool_]) -> Array:
    """White noise of each output from which a state starts (n_outputs,), of the unit of its samples: from how far these
    are from a straight line between their neighbours in time. What the boat bends there adds to it, which only makes
    the start less certain; a sample like the one before is none, as of a slow sensor that is read often."""
    found, wanted = np.zeros(there.shape[1]), {s.from_output for s in model.states}
    for j, output in enumerate(model.outputs):
        if output.name in wanted and there[:, j].any():
            t, y = record.t[there[:, j]], record.y[there[:, j], j]
            new = np.append(True, np.diff(y) != 0.0)
            h, d = np.diff(t[new]), wrap(np.diff(y[new]), output.angle)
            before, after = h[1:] / (h[:-1] + h[1:]), h[:-1] / (h[:-1] + h[1:])
            bend = (before * d[:-1] - after * d[1:]) / np.sqrt(1.0 + before**2 + after**2)
            found[j] = min(noise_from_differences(SECOND_DIFFERENCE * bend), UNKNOWN_ANGLE if output.angle else np.inf)
    return found


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
    """Mean: first measurement (``from_output``), what the record says, parameter or number; covariance: diag(sd0^2),
    with what a state may have moved before its first measurement.

    That measurement is filtered, too, so the start must know much less than it: where ``sd0`` is below
    ``START_SPREAD`` times its noise, that takes its place. A state that is known exactly (``sd0`` zero) stays so.
    """
    n = len(model.states)
    outputs = [o.name for o in model.outputs]
    index = {p.name: i for i, p in enumerate(model.parameters)}
    s = np.zeros(n + n * (n + 1) // 2 if covariance else n)
    tangent: list[tuple[int, int, float]] = []
    for i, state in enumerate(model.states):
        j = outputs.index(state.from_output) if state.from_output in outputs else -1
        measured = data.first[j] if j >= 0 else np.nan
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
            least = START_SPREAD * float(data.noise[j]) if np.isfinite(measured) and sd != 0.0 else 0.0
            s[at] = max(float(sd), least) ** 2 + (data.moved[j] ** 2 if np.isfinite(measured) else 0.0)
            if isinstance(state.sd0, str) and begins is None and sd >= least:
                tangent.append((at, index[state.sd0], 2.0 * float(sd)))
    return InitialCondition(s, tuple(tangent))
