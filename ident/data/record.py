"""Data for estimation: channels on their own clocks, and records of rows with every sensor at its own times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ident.model import Model, Sensor
from ident.numerics import Array

TIME_INPUT = "t"  # an input of this name is the time since the start of the record
WORK_INPUT = "work"  # an input of this name is the integral of the cubed shaft speeds, over WORK_UNIT
WORK_UNIT = 150.0  # s, at full power: the input is one after a run at full speed of this duration
SAME_TIME = 1e-6  # s; times closer than this are one row (seconds since 1970 have steps of 0.24 us)


@dataclass(frozen=True)
class Channel:
    """One signal on its own clock: ``t`` (n,) seconds, never decreasing; ``value`` (n,). ``hold``: what is known of it
    between the samples (``ident.model.Input``), empty: nothing."""

    t: Array
    value: Array
    unit: str = ""
    source: str = ""
    hold: str = ""


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
    interval that follows (equal to ``u`` for a zero-order hold); y (n_rows, n_outputs), NaN where nothing was
    measured (a sensor's outputs are all there or all NaN); h (n_rows,) the interval that follows, 0 in the
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

    A sensor faster than ``rate`` [Hz] is averaged over blocks of 1/rate, whose noise is then smaller by the
    root of their size; a slower one keeps its own times. Rows are the union of all times, with more where a gap exceeds
    ``max_step`` [s], by default that of the model, or where an input of hold ``zero`` changes. A sensor with a channel
    missing is left out, and said in ``meta["missing"]``.
    """
    channels = {**channels, **_derived_inputs(model, channels)}
    present = _present(model, channels, name)
    own = [i for i in model.inputs if i.name != TIME_INPUT and not i.tap]
    used = [channels[o.name] for s in present for o in s.outputs] + [channels[i.name] for i in own]
    start = max(c.t[0] for c in used) if t_from is None else t_from
    end = min(c.t[-1] for c in used) if t_to is None else t_to
    if end - start < 2.0 / rate:
        raise ValueError(f"{name}: inputs and sensors overlap for only {end - start:.2f} s")
    samples = {s.name: _sensor_samples(s, channels, start, end, rate) for s in present}
    switches = [_changes(channels[i.name]) for i in own if i.hold == "zero"]
    t = _rows([times for times, _ in samples.values()], switches, start, end, max_step or model.max_step)
    missing = tuple(s.name for s in model.sensors if s.name not in samples)
    return Record(
        name,
        t - start,
        *_inputs(model, channels, t, start),
        _measured(model, samples, t),
        tuple(i.name for i in model.inputs),
        tuple(o.name for o in model.outputs),
        {"missing": missing, "t0": start, **(meta or {})},
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
    sensor: Sensor, channels: Mapping[str, Channel], start: float, end: float, rate: float
) -> tuple[Array, Array]:
    first = channels[sensor.outputs[0].name]
    inside = (first.t >= start) & (first.t <= end)
    own = np.median(np.diff(first.t[inside])) if inside.sum() > 2 else np.inf
    if own > 0.6 / rate:
        columns = [
            channels[o.name].value[(channels[o.name].t >= start) & (channels[o.name].t <= end)] for o in sensor.outputs
        ]
        times, values = first.t[inside], np.column_stack(columns)
    else:
        edges = np.arange(start, end + 0.5 / rate, 1.0 / rate)
        blocks = [block_mean(channels[o.name], edges, o.angle) for o in sensor.outputs]
        times, values = blocks[0][1], np.column_stack([b[0] for b in blocks])
    good = np.isfinite(times) & np.isfinite(values).all(axis=1)
    return times[good], values[good]


def _rows(measured: Sequence[Array], switches: Sequence[Array], start: float, end: float, max_step: float) -> Array:
    """Union of all times; times closer than a microsecond are one row."""
    t: Array = np.sort(np.concatenate([*measured, *[s[(s > start) & (s < end)] for s in switches], [start, end]]))
    t = t[np.append(True, np.diff(t) > SAME_TIME)]
    gaps: Array = np.diff(t)
    pieces = np.maximum(np.ceil(gaps / max_step - 1e-6), 1).astype(int)
    if pieces.max(initial=1) == 1:
        return t
    filled = [t[i] + gaps[i] * np.arange(n) / n for i, n in enumerate(pieces)]
    return np.asarray(np.append(np.concatenate(filled), t[-1]))


def _changes(channel: Channel) -> Array:
    """When the value becomes another one: a command that is repeated adds no row."""
    return np.asarray(channel.t[1:][np.diff(channel.value) != 0.0])


def _inputs(model: Model, channels: Mapping[str, Channel], t: Array, start: float) -> tuple[Array, Array]:
    """Inputs at the rows t (n_rows,) and at the ends of their intervals (n_rows, n_inputs)."""
    u, u_next = np.empty((2, t.size, len(model.inputs)))
    for j, signal in enumerate(model.inputs):
        if signal.name == TIME_INPUT:
            at = t - start
        elif signal.hold == "linear":
            value = channels[signal.name].value
            at = np.interp(t, channels[signal.name].t, np.unwrap(value) if signal.angle else value)
        elif signal.hold == "average":
            u[:, j], u_next[:, j] = held_lines(channels[signal.name], t)
            continue
        else:
            u[:, j] = u_next[:, j] = sample_and_hold(channels[signal.name], t)
            continue
        u[:, j], u_next[:, j] = at, np.append(at[1:], at[-1])
    return u, u_next


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
