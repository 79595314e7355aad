"""Data for estimation: channels (signals with their own sample times), and records (tables of rows that a model uses).

A row of a record is one instant: it has the samples of this instant, and the inputs from it to the next row.
`seatrial.ident.estimation.prepared_record` converts a record to the arrays of the compiled filter.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.model import Input, Model, Sensor, command_of, shaft_speed_of
from seatrial.ident.numerics import Array

BLOCK_TIMES = re.compile(r"\[[\d.e+-]+:[\d.e+-]+\]\Z")  # end of the name of a part of a record (`Record.part`)
ON_CHANGE = 1.0  # s between samples; a command with longer intervals is logged only when it changes
MEAN_S = 0.1  # length of a mean of samples; over 0.2 s, the smoothed yaw rate made m_r 4 % too large
SHARE_LOST = 0.1  # of the record; the early end of one signal may cost so much without a warning
TIME_INPUT = "t"  # an input of this name is the time since the start of the record
WORK_INPUT = "work"  # an input of this name is the integral of the cubed shaft speeds, over WORK_UNIT
WORK_UNIT = 150.0  # s; with one thruster at full speed the input is one after this time, with two after half of it
AVERAGED = 0.6  # of the interval 1/rate; a sensor with shorter sample intervals is averaged
JITTER = 1.1  # times the longest step between rows; samples jitter, so that only longer gaps get additional rows
MAX_GAP_ROWS = 100_000  # of one gap; a filter would need hours to cross more of them step by step
MAX_ROWS = 20_000_000  # of a record, which then has some gigabytes
SAME_TIME = 1e-6  # s; times closer than this are one row (times in s since 1970 have a resolution of 0.24 us)


@dataclass(frozen=True)
class LeftOut:
    """Outliers that were removed from a signal, kept for plots and reports.

    Attributes
    ----------
    t : Array (n,)
        Times of the outliers [s], since ``begin``.
    value : Array (n,)
        Values of the outliers, in the unit of the signal.
    begin : float
        Time of the first sample of the signal [s], which may itself be an outlier; in a part of a log, that of the
        first sample of the part that is no outlier.
    """

    t: Array
    value: Array
    begin: float


@dataclass(frozen=True)
class Channel:
    """Signal of a log with its own sample times.

    Attributes
    ----------
    t : Array (n,)
        Sample times [s], never decreasing.
    value : Array (n,)
        Samples, in `unit`.
    unit : str
        Unit, for example ``m/s``. Empty for a number without a unit, or if the unit is unknown.
    source : str
        Name of the device or of the imported column.
    hold : str
        Value of an input between its samples: ``zero`` (constant until the next sample), ``average`` (constant too, but
        a change starts no new row of a record: between two rows the record has the straight line of least squares
        through the held values, `held_lines`) or ``linear`` (linear interpolation). Empty if it is unknown, as for a
        sensor.
    sampled : float
        Original sample interval [s] of a signal that was resampled to a finer grid of times. Zero for all other
        signals.
    left_out : LeftOut or None
        Outliers that were removed from the samples. None if no sample was removed.
    """

    t: Array
    value: Array
    unit: str = ""
    source: str = ""
    hold: str = ""
    sampled: float = 0.0
    left_out: LeftOut | None = None


def sample_and_hold(channel: Channel, t: Array) -> Array:
    """Return the values of a signal at given times, if each sample is held until the next one (zero-order hold).

    Parameters
    ----------
    channel
        The signal, with at least one sample.
    t
        Times (n,) [s].

    Returns
    -------
    Array (n,)
        The latest sample at or before each time, where a sample up to `SAME_TIME` (1 us) later also counts. Before the
        first sample, the value is that of the first sample.
    """
    at = np.searchsorted(channel.t, t + SAME_TIME, side="right") - 1
    return channel.value[np.clip(at, 0, None)]


def block_mean(channel: Channel, edges: Array) -> Array:
    """Return the mean values of a signal over consecutive intervals of time (blocks).

    Parameters
    ----------
    channel
        The signal. Samples with NaN, and samples outside all blocks, are ignored.
    edges
        Edges of the blocks (n + 1,) [s], increasing. A block contains its first edge, but not its last edge.

    Returns
    -------
    Array (n,)
        Mean value of the samples of each block, NaN for an empty block.
    """
    value = channel.value
    index = np.searchsorted(edges, channel.t, side="right") - 1
    inside = (index >= 0) & (index < edges.size - 1) & np.isfinite(value)
    index, value = index[inside], value[inside]
    with np.errstate(invalid="ignore"):
        return np.asarray(np.bincount(index, value, edges.size - 1) / np.bincount(index, minlength=edges.size - 1))


@dataclass(frozen=True)
class LogSegment:
    """Signals of one log, or of a part of it, and the interval of time to use.

    Attributes
    ----------
    name : str
        Name of the log or of its part, for messages and results.
    channels : Mapping
        The signals by name.
    t_from : float or None
        Start of the interval [s]. None: it starts where all signals of the model are known.
    t_to : float or None
        End of the interval [s]. None: it ends where the first signal of the model ends.
    meta : Mapping
        Further information by name, which is copied to ``Record.meta``.
    """

    name: str
    channels: Mapping[str, Channel]
    t_from: float | None = None
    t_to: float | None = None
    meta: Mapping[str, object] = field(default_factory=dict)


def make_record(model: Model, run: LogSegment, rate: float) -> Record:
    """Convert a segment of a log to a record for a model, as `build_record` does.

    Parameters
    ----------
    model
        The model, whose inputs and outputs are the names of the channels.
    run
        Signals, name and interval of time of the segment.
    rate
        Rate [Hz]. Sensors with more samples per second are averaged over blocks of 1/rate.

    Raises
    ------
    ValueError
        If an input or all sensors are missing, if the signals do not overlap, or if a gap is too long.
    """
    return build_record(model, run.channels, name=run.name, t_from=run.t_from, t_to=run.t_to, rate=rate, meta=run.meta)


@dataclass(frozen=True)
class Record:
    """Rows of inputs and measurements of one segment of a log, for one model.

    A row is one instant: it has the samples of this instant, and the inputs from it to the next row.

    Attributes
    ----------
    name : str
        Name of the segment, for messages and results.
    t : Array (n_rows,)
        Times of the rows [s] since the start of the record (``meta["t0"]`` in the log), increasing. A part keeps the
        times of its record.
    u : Array (n_rows, n_inputs)
        Inputs at each row.
    u_next : Array (n_rows, n_inputs)
        Inputs at the end of the interval after each row. In the interval they are linear. For a zero-order hold without
        averaging they equal ``u``.
    y : Array (n_rows, n_outputs)
        Measurements, NaN for outputs without a sample. The outputs of one sensor are all measured or all NaN.
    inputs, outputs : tuple of str
        Names of the columns of ``u`` and ``y``.
    meta : Mapping
        Information on the segment: missing sensors (``missing``), start in the log [s] (``t0``), signal that ended
        early (``cut``).
    start : Mapping
        (Mean, standard deviation) of initial states by name, for states that no measurement gives. It is used for a
        block of time from the middle of a run, which does not start at rest.
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
        """Time [s] from each row to the next (n_rows,); zero for the last row."""
        return np.append(np.diff(self.t), 0.0)

    @property
    def t_from(self) -> float:
        """Start of the record in its log [s], which ``t`` counts from; 0 if it is unknown."""
        return float(self.meta.get("t0", 0.0))

    @property
    def t_log(self) -> Array:
        """Times of the rows [s] since the start of the log (n_rows,)."""
        return self.t + self.t_from

    @property
    def n_rows(self) -> int:
        """Number of rows of the record."""
        return int(self.t.size)

    @property
    def duration(self) -> float:
        """Time from the first to the last row [s]; 0 for one row. IndexError is raised for a record without rows."""
        return float(self.t[-1] - self.t[0])

    def for_model(self, model: Model) -> Record:
        """Return the record with the inputs and outputs of another model, in the order of that model.

        Outputs that the record lacks are NaN. Columns of the record that the model lacks are dropped. Arrays are shared
        with this record where the columns are neighbours, and must not be changed in place.

        Raises
        ------
        ValueError
            If the record lacks an input of the model.
        """
        inputs, outputs = [i.name for i in model.inputs], [o.name for o in model.outputs]
        missing = [n for n in inputs if n not in self.inputs]
        if missing:
            raise ValueError(
                f"{self.name}: no signal for the input {missing[0]!r} of model {model.name}; "
                f"the record has {', '.join(self.inputs) or 'no inputs'}; use another model, or a log with this signal"
            )
        columns, y = [self.inputs.index(n) for n in inputs], self.y
        if tuple(outputs) != self.outputs:
            y = np.full((self.n_rows, len(outputs)), np.nan)
            for j, name in enumerate(outputs):
                if name in self.outputs:
                    y[:, j] = self.y[:, self.outputs.index(name)]
        u, u_next = _select_columns(self.u, columns), _select_columns(self.u_next, columns)
        return replace(self, u=u, u_next=u_next, y=y, inputs=tuple(inputs), outputs=tuple(outputs))

    def part(self, t_from: float, t_to: float, name: str = "") -> Record:
        """Return the record with only its rows from ``t_from`` to before ``t_to`` [s], with unchanged times.

        The result may have no row. Without a ``name``, the name is that of this record with the times appended, for
        example ``run[0:10]``.
        """
        within = self.rows((self.t >= t_from) & (self.t < t_to))
        return replace(within, name=name or f"{self.name}[{t_from:g}:{t_to:g}]")

    def rows(self, which: slice | NDArray[np.bool_]) -> Record:
        """Return the record with only the selected rows, with unchanged times.

        ``which`` is a slice of the rows, or an array (n_rows,) that is True for rows to keep. The result may have no
        row. Its name is unchanged. ``u_next`` is kept too: after a removed row, it is not the next row of the result.
        """
        return replace(self, t=self.t[which], u=self.u[which], u_next=self.u_next[which], y=self.y[which])


def _select_columns(a: Array, columns: Sequence[int]) -> Array:
    """Return the columns with the indices ``columns`` of an array ``a`` (n, m), in the given order.

    The result is a view if the columns are neighbours in ascending order, otherwise a copy. The diagnosis keeps records
    of dozens of models, so that copies would need much memory.
    """
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
    """Convert the signals of a log to a record for a model: a table of rows with inputs and measurements.

    Parameters
    ----------
    model
        The model. Channels are found by the names of its inputs and outputs.
    channels
        The signals by name. A delayed copy ``NAME~k`` and the input ``work`` (integral of the cubed shaft speeds) are
        computed if they are missing. The input ``t`` is always the time since the start of the record.
    name
        Name of the record, for messages.
    t_from, t_to
        Times [s] of the interval to use, both included. By default the record covers the time in which all signals are
        known.
    rate
        Rate [Hz] above which a sensor is averaged over blocks of about 1/rate, below 10 Hz over the middle of each
        block (`mean_length`), or thinned to one sample of each block if the model asks for it (`Sensor.averaged`).
        A slower sensor keeps its own times, and the means are at these times and between them.
    max_step
        Longest interval between rows [s], by default ``model.max_step`` (0.1 s for most models). Longer intervals get
        additional rows without measurements.
    meta
        Further entries of ``Record.meta``.

    Returns
    -------
    Record
        Its rows are the union of the sample times of all sensors, of the changes of inputs with the hold ``zero`` that
        are not averaged, of both ends of the record, and of the additional rows. ``meta["mean_rates"]`` has, by name of
        the sensor that is averaged, the rate [Hz] at which it gives independent means as long as those of the rows,
        which can be more frequent than the rows. ``meta["missing"]`` names the sensors
        of which a channel is missing. ``meta["cut"]`` has the name of a signal that ends early and the seconds lost by
        it, if more than `SHARE_LOST` (10 %) of the record is lost and ``t_to`` is None.

    Raises
    ------
    ValueError
        If an input or all sensors are missing, if the signals do not overlap for two intervals of 1/rate, if the
        outputs of a sensor have no common time, if a gap needs more than `MAX_GAP_ROWS` (100 000) additional rows, or
        if the record has more than `MAX_ROWS` (20 million).

    Notes
    -----
    If all sensors on which inputs act without delay are averaged, the inputs on which forces depend without delay are
    averaged over the same time. Otherwise a measured acceleration would be smoother than the thrust that causes it, and
    the estimated mass would be too large (prefiltering: Ljung 1999, section 14.4).
    """
    derived = _derived_inputs(model, channels)
    channels = {**channels, **derived}
    present = _present_sensors(model, channels, name)
    own = [i for i in model.inputs if i.name != TIME_INPUT and not i.tap]
    used = [channels[o.name] for s in present for o in s.outputs] + [channels[i.name] for i in own]
    start = max(c.t[0] for c in used) if t_from is None else t_from
    ends = _signal_ends(present, own, channels)
    end = min(ends.values()) if t_to is None else t_to
    if end - start < 2.0 / rate:
        raise ValueError(
            f"{name}: inputs and sensors overlap for only {max(end - start, 0.0):.2f} s, and {2.0 / rate:g} s are "
            "needed: check the time stamps, or use a longer part of the log"
        )
    intervals = {s.name: _median_interval(channels[s.outputs[0].name], start, end) for s in present}
    fast = {n for n, interval in intervals.items() if interval <= AVERAGED / rate}
    samples = _samples(name, present, channels, (start, end), rate, fast)
    windows = {
        s.name: _averaging_window(intervals[s.name], samples[s.name][0], rate) if s.averaged and s.name in fast else 0.0
        for s in present
    }
    window = min((windows[s.name] for s in present if _has_feedthrough(model, s)), default=0.0)
    exact = [i for i in own if i.hold == "zero" and not (i.prefilter and window)]
    switches = [_change_times(channels[i.name]) for i in exact]
    t = _row_times(name, [times for times, _ in samples.values()], switches, start, end, max_step or model.max_step)
    shortest = mean_length(rate)
    mean_rates = {s.name: 1.0 / max(intervals[s.name], shortest) for s in present if s.averaged and s.name in fast}
    missing = tuple(s.name for s in model.sensors if s.name not in samples)
    lost_s, first = max(ends.values()) - end, min(ends, key=lambda n: ends[n])
    cut = {"cut": (first, lost_s)} if t_to is None and lost_s > SHARE_LOST * (lost_s + end - start) else {}
    return Record(
        name,
        t - start,
        *_input_rows(model, channels, t, start, window, frozenset(derived)),
        _measurement_rows(model, samples, t),
        tuple(i.name for i in model.inputs),
        tuple(o.name for o in model.outputs),
        {"missing": missing, "t0": start, "mean_rates": mean_rates, **cut, **(meta or {})},
    )


def _present_sensors(model: Model, channels: Mapping[str, Channel], name: str) -> list[Sensor]:
    """Return the sensors of the model for which ``channels`` has all outputs.

    ``name`` is that of the record, for messages.

    Raises
    ------
    ValueError
        If no sensor has all its channels, or if the channel of an input other than ``t`` is missing. A sensor of
        which a channel is missing is left out without an error.
    """
    missing = [i.name for i in model.inputs if i.name not in channels and i.name != TIME_INPUT]
    if missing:
        available = ", ".join(sorted(channels)) or "no signals"
        raise ValueError(
            f"{name}: no signal for the input {missing[0]!r} of model {model.name}; the log has {available}; use "
            "another model, or a log with this signal"
        )
    present = [s for s in model.sensors if all(o.name in channels for o in s.outputs)]
    if not present:
        names = ", ".join(s.name for s in model.sensors)
        raise ValueError(
            f"{name}: none of the sensors of model {model.name} is in the log; it needs one of {names}; use another "
            "model, or a log with such a sensor"
        )
    return present


def _signal_ends(
    present: Sequence[Sensor], inputs: Sequence[Input], channels: Mapping[str, Channel]
) -> dict[str, float]:
    """Return the time [s] up to which each signal is known, by the names of outputs and inputs.

    Parameters
    ----------
    present
        Sensors of which all channels exist.
    inputs
        Inputs of the model that are in the log.
    channels
        The signals by name.

    Notes
    -----
    The time is that of the last sample. An input that is logged only when it changes (its longest sample interval
    exceeds 1 s, and it is neither linear nor resampled) is also known up to the last sample of the sensors, if this is
    less than twice its longest sample interval after its own last sample. Otherwise its source may have failed.
    """
    ends = {o.name: float(channels[o.name].t[-1]) for s in present for o in s.outputs}
    latest = max(ends.values())
    for signal in inputs:
        c = channels[signal.name]
        longest = float(np.diff(c.t).max(initial=0.0))
        on_change = signal.hold != "linear" and not c.sampled and longest > ON_CHANGE
        ends[signal.name] = latest if on_change and 0.0 < latest - c.t[-1] < 2.0 * longest else float(c.t[-1])
    return ends


def _measurement_rows(model: Model, samples: Mapping[str, tuple[Array, Array]], t: Array) -> Array:
    """Return the measurements of a record (n_rows, n_outputs), NaN where an output has no sample.

    Parameters
    ----------
    model
        The model, with the order of the outputs.
    samples
        Times (n,) [s] and values (n, n_outputs of the sensor) of the samples, by name of the sensor.
    t
        Times of the rows (n_rows,) [s], which contain all times of samples.
    """
    y, names = np.full((t.size, len(model.outputs)), np.nan), [o.name for o in model.outputs]
    for sensor in model.sensors:
        if sensor.name in samples:
            times, values = samples[sensor.name]
            rows = np.searchsorted(t, times - SAME_TIME)
            y[rows[:, None], [names.index(o.name) for o in sensor.outputs]] = values
    return y


def _derived_inputs(model: Model, channels: Mapping[str, Channel]) -> dict[str, Channel]:
    """Return, by name, the inputs of the model that ``channels`` lacks and that are computed from other channels.

    A delayed copy has the samples of its source, later by its delay. ``work`` is the integral of the cubed shaft speeds
    of both thrusters, left and right (or of their commands, without shaft speeds), divided by `WORK_UNIT` (150 s). It
    has the sample times of the left one and is 0 at the first of them. An input whose source is missing is left out.
    """
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


def _samples(
    name: str,
    present: Sequence[Sensor],
    channels: Mapping[str, Channel],
    interval: tuple[float, float],
    rate: float,
    fast: Set[str],
) -> dict[str, tuple[Array, Array]]:
    """Return the times (n,) [s] and values (n, n_outputs) of the samples of each sensor in a record, by its name.

    Parameters
    ----------
    name
        Name of the record, for messages.
    present
        The sensors.
    channels
        The signals by name.
    interval
        Start and end of the record [s], both included.
    rate
        Rate of the rows [Hz].
    fast
        Names of the sensors that are so fast that their samples are reduced to one for each block of 1/rate. This is
        the mean of the block or, if the model wants no mean (`Sensor.averaged`), the sample nearest to the middle of
        the block.

    Raises
    ------
    ValueError
        If the outputs of a sensor that is not averaged have no common time.
    """
    averaged = [s for s in present if s.averaged and s.name in fast]
    samples = {
        s.name: _own_samples(name, s, channels, *interval, rate if s.name in fast else None)
        for s in present
        if s not in averaged
    }
    blocks = _Blocks.around([times for times, _ in samples.values()], *interval, rate)
    return samples | {s.name: _averaged_samples(s, channels, blocks) for s in averaged}


def _own_samples(
    name: str, sensor: Sensor, channels: Mapping[str, Channel], start: float, end: float, thinned_to: float | None
) -> tuple[Array, Array]:
    """Return the times (n,) [s] and values (n, n_outputs) of the samples of a sensor from ``start`` to ``end`` [s].

    Both ends are included.

    Parameters
    ----------
    name
        Name of the record, for messages.
    sensor
        The sensor. Samples in which an output is NaN or missing are left out.
    channels
        The signals by name.
    start, end
        Interval of the record [s].
    thinned_to
        Rate [Hz] of the rows if only the sample nearest to the middle of each block of 1/rate is returned. None: all
        samples are returned.

    Raises
    ------
    ValueError
        If the outputs of the sensor have no common time.
    """
    first = channels[sensor.outputs[0].name]
    # An import drops NaN for each signal separately. A sample needs all outputs at the same time.
    own_channels, inside = [channels[o.name] for o in sensor.outputs], (first.t >= start) & (first.t <= end)
    times = reduce(np.intersect1d, [c.t for c in own_channels[1:]], first.t[inside])
    if not times.size and inside.any():
        names = " and ".join(o.name for o in sensor.outputs)
        raise ValueError(
            f"{name}: {names} are used together as the sensor {sensor.name}, but they have no common time stamp; "
            "give both the same time stamps"
        )
    if thinned_to is not None:
        times = _nearest_to_block_middles(times, start, end, thinned_to)
    values = np.column_stack([c.value[np.searchsorted(c.t, times)] for c in own_channels])
    good = np.isfinite(times) & np.isfinite(values).all(axis=1)
    return times[good], values[good]


def _averaged_samples(sensor: Sensor, channels: Mapping[str, Channel], block: _Blocks) -> tuple[Array, Array]:
    """Return the times (n,) [s] and values (n, n_outputs) of the means of a fast sensor, one for each block.

    Parameters
    ----------
    sensor
        The sensor. A block without a sample of one of its outputs is left out.
    channels
        The signals by name.
    block
        The blocks, which all averaged sensors have in common.
    """
    means = [block.mean(channels[o.name], o.angle) for o in sensor.outputs]
    times = reduce(np.intersect1d, [t for t, _ in means])
    return times, np.column_stack([value[np.searchsorted(t, times)] for t, value in means])


@dataclass(frozen=True)
class _Blocks:
    """Blocks of time over which all fast sensors are averaged, each around an instant that gets a row of the record.

    Attributes
    ----------
    start, end : float
        Interval of the record [s], with both ends.
    rate : float
        Rate [Hz]. A block is about 1/rate long.
    anchors : Array (n,)
        Instants [s] that other rows have already, increasing. Between two of them the other instants are equidistant,
        at most `JITTER` (1.1) times 1/rate apart. Before the first and after the last they are 1/rate apart.

    Notes
    -----
    A slow sensor, as a GPS of 5 Hz, keeps its own times. If the blocks of a fast sensor lay beside them, each sample of
    both would need a row of its own, and an evaluation of the likelihood takes time for each row.
    """

    start: float
    end: float
    rate: float
    anchors: Array

    @classmethod
    def around(cls, slow: Sequence[Array], start: float, end: float, rate: float) -> _Blocks:
        """Return the blocks around the times of slow sensors.

        Parameters
        ----------
        slow
            Times of the samples of each slow sensor [s]. Those of the sensor with the most samples are preferred. A
            time less than half a block away from another one is no anchor.
        start, end, rate
            As the attributes.
        """
        apart, anchors = 0.5 / rate, np.empty(0)
        for times in sorted(slow, key=lambda t: -t.size):
            free = times[np.append(True, np.diff(times) >= apart)[: times.size]]
            if anchors.size:
                after = np.searchsorted(anchors, free)
                padded = np.concatenate([[-np.inf], anchors, [np.inf]])
                free = free[(free - padded[after] >= apart) & (padded[after + 1] - free >= apart)]
            anchors = np.sort(np.concatenate([anchors, free]))
        return cls(start, end, rate, anchors if anchors.size else np.array([start + apart]))

    def instant(self, t: Array) -> Array:
        """Return the instant [s] of the block in which each of the times ``t`` (n,) [s] from start to end lies."""
        step, anchors = 1.0 / self.rate, self.anchors
        at = np.searchsorted(anchors, t, side="right")
        before, after = anchors[np.maximum(at - 1, 0)], anchors[np.minimum(at, anchors.size - 1)]
        inner = (at > 0) & (at < anchors.size)
        gap = np.where(inner, after - before, step)
        n = np.where(inner, np.maximum(np.ceil(gap / (JITTER * step) - 1e-6), 1.0), 1.0)
        k = np.round((t - before) / (gap / n))
        # No instant before the start or after the end. The whole part of a quotient such as 0.3/0.1 may be one too low.
        k = np.clip(k, np.ceil((self.start - before) / step - 1e-6), None)
        k = np.where(inner, k, np.minimum(k, np.floor((self.end - before) / step + 1e-6)))
        return np.where(inner & (k == n), after, before + k * (gap / n))

    def mean(self, channel: Channel, angle: bool) -> tuple[Array, Array]:
        """Return the instants (n,) [s] of the blocks with a sample of a signal, and the mean values (n,) at them.

        Parameters
        ----------
        channel
            The signal. Samples with NaN, and samples outside the record, are ignored.
        angle
            Whether the signal is an angle [rad]. It is then unwrapped before it is averaged.

        Notes
        -----
        The mean of the samples belongs to the mean of their times. It is moved to the instant, which is about half a
        sample interval away, by the slope of the straight line of least squares through these samples and their
        neighbours. A block whose samples have all the same time, without neighbours, has that time as its instant.
        """
        t, value = channel.t, channel.value
        known = np.isfinite(value) & (t >= self.start) & (t <= self.end)
        t, value = t[known], value[known]
        if not t.size:
            return t, value
        if angle:
            value = np.unwrap(value)
        of_block = self.instant(t)
        near = np.flatnonzero(self._near(t, of_block))
        of_block = of_block[near]
        first = np.flatnonzero(np.append(True, np.diff(of_block) > 0.0))
        last = np.append(first[1:], near.size) - 1
        instant, origin = of_block[first], value[near[first]]
        d, v = t[near] - of_block, value[near] - np.repeat(origin, last - first + 1)
        n = last - first + 1.0
        sum_d, sum_v, sum_dd, sum_dv = (np.add.reduceat(a, first) for a in (d, v, d * d, d * v))
        mean_d, mean_v = sum_d / n, sum_v / n
        for neighbour in (near[first] - 1, near[last] + 1):
            inside = np.clip(neighbour, 0, t.size - 1)
            d, v = t[inside] - instant, value[inside] - origin
            used = (inside == neighbour) & (np.abs(d - mean_d) <= 1.0 / self.rate)
            n, sum_d, sum_v = n + used, sum_d + used * d, sum_v + used * v
            sum_dd, sum_dv = sum_dd + used * d * d, sum_dv + used * d * v
        spread = n * sum_dd - sum_d**2
        sloped = spread > SAME_TIME**2
        slope = np.divide(n * sum_dv - sum_d * sum_v, spread, out=np.zeros(n.size), where=sloped)
        return np.where(sloped, instant, instant + mean_d), origin + mean_v - slope * mean_d

    def _near(self, t: Array, of_block: Array) -> NDArray[np.bool_]:
        """Return which samples at the times ``t`` (n,) [s] are averaged: those near the instants ``of_block`` (n,) [s].

        In a block as long as a mean (`mean_length`) these are all. In a longer block they are the samples in its
        middle, or the nearest one if there is none.
        """
        length = mean_length(self.rate)
        if length >= 1.0 / self.rate:
            return np.ones(t.size, dtype=np.bool_)
        first = np.flatnonzero(np.append(True, np.diff(of_block) > 0.0))
        away = np.abs(t - of_block)
        nearest = np.repeat(np.minimum.reduceat(away, first), np.diff(np.append(first, t.size)))
        return np.asarray(away <= np.maximum(length / 2.0, nearest) + SAME_TIME)


def mean_length(rate: float) -> float:
    """Return the time [s] over which fast sensors are averaged, in rows of a ``rate`` [Hz].

    It is `MEAN_S` (0.1 s), at least half the interval between rows, and at most the whole one.
    """
    return min(1.0 / rate, max(MEAN_S, 0.5 / rate))


def _nearest_to_block_middles(times: Array, start: float, end: float, rate: float) -> Array:
    """Return the one of the ``times`` in each block of 1/rate [s] that is nearest to the middle of the block.

    ``times`` (n,) [s] increase, and ``rate`` is in Hz. The first block begins at ``start`` [s]. Blocks without a time,
    and blocks whose middle is not before ``end`` [s], are left out. Of two equally near times, the earlier is returned.
    """
    # Only blocks that contain a time: all blocks in a gap of years would need gigabytes.
    numbers = np.unique(np.floor((times - start) * rate + SAME_TIME))
    middle = start + (numbers + 0.5) / rate
    numbers, middle = numbers[middle < end], middle[middle < end]
    after = np.clip(np.searchsorted(times, middle), 1, max(times.size - 1, 1))
    nearest = after - (middle - times[after - 1] <= times[np.minimum(after, times.size - 1)] - middle)
    own = np.floor((times[nearest] - start) * rate + SAME_TIME) == numbers
    return np.asarray(times[nearest[own]])


def _median_interval(channel: Channel, start: float, end: float) -> float:
    """Return the median sample interval [s] of a channel from ``start`` to ``end`` [s].

    The interval is infinite if fewer than three samples are in this time.
    """
    inside = (channel.t >= start) & (channel.t <= end)
    return float(np.median(np.diff(channel.t[inside]))) if inside.sum() > 2 else np.inf


def _averaging_window(interval: float, instants: Array, rate: float) -> float:
    """Return the length [s] of the moving average of a continuous signal that is equivalent to a mean of samples.

    The mean is that of the samples, ``interval`` [s] apart, in blocks around ``instants`` (n,) [s], of which the median
    length counts, or over their middle if the ``rate`` [Hz] of the rows is so low (`mean_length`). Both averages have
    the same variance of time.
    """
    block = float(np.median(np.diff(instants))) if instants.size > 1 else 0.0
    block = min(block, mean_length(rate)) if mean_length(rate) < 1.0 / rate else block
    return math.sqrt(max(block**2 - interval**2, 0.0))


def _has_feedthrough(model: Model, sensor: Sensor) -> bool:
    """Return whether an input acts on an output of the sensor without delay, as thrust acts on an accelerometer.

    Only inputs that may be averaged (`Input.prefilter`) are considered. The outputs are evaluated at one state with two
    sets of these inputs.
    """
    x, p = np.full(len(model.states), 0.1), list(model.values.values())
    u = np.array([[0.3] * len(model.inputs), [0.4] * len(model.inputs)])  # two arbitrary inputs at the same state
    prefilter = np.array([i.prefilter and i.name != TIME_INPUT for i in model.inputs])
    first, second = (model.signals(list(x), list(np.where(prefilter, row, u[0])), p).y for row in u)
    return any(first[o.name] != second[o.name] for o in sensor.outputs)


def _row_times(
    name: str, measured: Sequence[Array], switches: Sequence[Array], start: float, end: float, max_step: float
) -> Array:
    """Return the times of the rows of a record [s] from ``start`` to ``end`` [s], increasing.

    The times are the union of ``measured`` (times of the samples of each sensor), of ``switches`` (times at which an
    input changes) inside the record, and of both ends. Of times closer than `SAME_TIME` (1 us), the first is kept.
    Where two rows are farther apart than ``max_step`` [s] by more than 10 %, rows at equal intervals are added.
    ``name`` is that of the record, for messages.

    Raises
    ------
    ValueError
        If a gap needs more than `MAX_GAP_ROWS` (100 000) rows, or the record more than `MAX_ROWS` (20 million).
    """
    t: Array = np.sort(np.concatenate([*measured, *[s[(s > start) & (s < end)] for s in switches], [start, end]]))
    t = t[np.append(True, np.diff(t) > SAME_TIME)]
    gaps: Array = np.diff(t)
    pieces = np.where(gaps > JITTER * max_step, np.ceil(gaps / max_step - 1e-6), 1)
    if pieces.max(initial=1) > MAX_GAP_ROWS or pieces.sum() > MAX_ROWS:
        longest = int(np.argmax(gaps))
        raise ValueError(
            f"{name}: no sensor has a sample from {t[longest]:.1f} to {t[longest + 1]:.1f} s, which is too long for a "
            "record; use only the part before or after it (--from, --to)"
        )
    pieces = pieces.astype(int)
    if pieces.max(initial=1) == 1:
        return t
    within = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    filled = np.repeat(t[:-1], pieces) + np.repeat(gaps, pieces) * within / np.repeat(pieces, pieces)
    return np.asarray(np.append(filled, t[-1]))


def _change_times(channel: Channel) -> Array:
    """Return the times [s] of the samples of a channel that differ from the sample before.

    The first sample never counts as a change. A repeated command thus adds no row to a record. The result is empty for
    a constant channel.
    """
    return np.asarray(channel.t[1:][np.diff(channel.value) != 0.0])


def _input_rows(
    model: Model, channels: Mapping[str, Channel], t: Array, start: float, window: float, derived: frozenset[str]
) -> tuple[Array, Array]:
    """Return the inputs of a record at its rows, and those at the ends of the intervals after the rows.

    Both arrays are (n_rows, n_inputs). An input that may be averaged (`Input.prefilter`) is the moving average over
    ``window`` if this is not zero. It is then, and without the average if its hold is ``linear``, the straight line in
    each interval that has its mean there (`SmoothSignal.lines`). Any other input follows its `Input.hold`: ``zero``
    keeps the last sample, ``linear`` is interpolated (an angle is unwrapped), and ``average`` is the line of
    `held_lines`.

    Parameters
    ----------
    model
        The model, with the order and the holds of the inputs.
    channels
        The signals by name.
    t
        Times of the rows (n_rows,) [s].
    start
        Start of the record [s], which is the zero of the input ``t``.
    window
        Length [s] of the moving average that is equivalent to the averaging of the sensors; zero without averaging.
    derived
        Names of the channels that were computed from others. A delayed copy among them is the averaged source, shifted
        by the delay.
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
                smoothed[own] = smooth_signal(_samples_around(channels[own], *span), signal, window)
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


def _samples_around(channel: Channel, t_from: float, t_to: float) -> Channel:
    """Return the channel with only the samples between ``t_from`` and ``t_to`` [s], and the nearest at or beyond each.

    At an end of the channel there is no further sample.
    """
    first = max(int(np.searchsorted(channel.t, t_from, side="right")) - 1, 0)
    last = max(int(np.searchsorted(channel.t, t_to)) + 1, first + 1)
    return replace(channel, t=channel.t[first:last], value=channel.value[first:last])


@dataclass(frozen=True)
class SmoothSignal:
    """Signal in continuous time that is linear between given times, and constant before and after them.

    Attributes
    ----------
    t : Array (n,)
        Times [s], never decreasing.
    value : Array (n,)
        Values at the times.
    integral : Array (n,)
        Integral of the signal from the first time to each time.
    """

    t: Array
    value: Array
    integral: Array

    def lines(self, t: Array) -> tuple[Array, Array]:
        """Approximate the signal by a straight line in each interval between given times.

        Parameters
        ----------
        t
            Edges of the intervals (n,) [s], increasing.

        Returns
        -------
        first, last : Array (n,)
            Values of the line at the start and at the end of the interval after each time. The last entry of both is
            the value of the signal at the last time.

        Notes
        -----
        The line starts at the value of the signal and has its mean over the interval. A line to the value at the next
        time would lose the impulse of corners inside the interval.
        """
        value = np.interp(t, self.t, self.value)
        mean = np.diff(_integral_up_to(self.t, self.value, self.value[1:], self.integral, t)) / np.diff(t)
        return value, np.append(2.0 * mean - value[:-1], value[-1])


def smooth_signal(channel: Channel, signal: Input, window: float) -> SmoothSignal:
    """Return the centred moving average of an input in continuous time.

    Parameters
    ----------
    channel
        Samples of the input.
    signal
        Definition of the input: it is linear or held between its samples (`Input.hold`), and may be an angle, which is
        unwrapped.
    window
        Length of the moving average [s]. Zero, which is for a linear signal only, leaves it unchanged. Near both ends
        of the samples of a linear signal, the average is over a shorter time. A held signal continues with its first
        and last value there.

    Returns
    -------
    SmoothSignal
        Moving average, exact at each sample and half a window before and after it; linear in between.
    """
    t, value, linear = channel.t, np.unwrap(channel.value) if signal.angle else channel.value, signal.hold == "linear"
    if not linear:  # the first and the last value also hold before and after the samples
        t, value = np.concatenate([t[:1] - window, t, t[-1:] + window]), np.pad(value, 1, mode="edge")
    after = value[1:] if linear else value[:-1]
    if window:
        whole, own, held = _cumulative_integral(t, value, after), t, value
        t = np.unique(np.clip(np.concatenate([own - window / 2, own, own + window / 2]), own[0], own[-1]))
        half = np.minimum(window / 2, np.minimum(t - own[0], own[-1] - t))  # the window is shorter near both ends
        sums = _integral_up_to(own, held, after, whole, t + half) - _integral_up_to(own, held, after, whole, t - half)
        value = np.interp(t, own, held)
        np.divide(sums, 2 * half, out=value, where=half > SAME_TIME)
        after = value[1:]
    return SmoothSignal(t, value, _cumulative_integral(t, value, after))


def _cumulative_integral(t: Array, value: Array, after: Array) -> Array:
    """Return the integral (n,) of a signal from its first time to each of its times ``t`` (n,) [s].

    The signal is linear from ``value`` (n,) at each time to ``after`` (n - 1,) just before the next time.
    """
    return np.append(0.0, np.cumsum(np.diff(t) * (value[:-1] + after) / 2))


def _integral_up_to(t: Array, value: Array, after: Array, whole: Array, at: Array) -> Array:
    """Return the integral (m,) of a signal from its first time to each of the times ``at`` (m,) [s].

    Parameters
    ----------
    t
        Times of the signal (n,) [s].
    value, after
        The signal is linear from ``value`` (n,) at each time to ``after`` (n - 1,) just before the next time. It is
        constant before its first time and after its last time.
    whole
        Integral (n,) of the signal from its first time to each of its times (`_cumulative_integral`).
    at
        Times (m,) [s]. Before the first time, the integral of a positive signal is negative.
    """
    k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, max(t.size - 2, 0))
    since, slope = np.clip(at, t[0], t[-1]) - t[k], np.zeros(k.size)
    if t.size > 1:
        slope = (after - value[:-1])[k] / np.maximum(np.diff(t)[k], SAME_TIME)
    outside = np.minimum(at - t[0], 0.0) * value[0] + np.maximum(at - t[-1], 0.0) * value[-1]
    return np.asarray(whole[k] + since * (value[k] + slope * since / 2) + outside)


def given_inputs(model: Model, record: Record) -> Array:
    """Return the inputs of a record at its rows as they were given, for ranges and figures: (n_rows, n_inputs).

    An input with the hold ``average`` has its mean in the interval after the row. The rest of its line (`held_lines`)
    exceeds the given values where these change: after a step from 0 to 1 it reaches up to 4/3. Any other input has
    the values ``record.u``.

    Parameters
    ----------
    model
        The model, with the holds of the inputs in the order of the record.
    record
        A record that was built for this model.
    """
    averaged = np.array([i.hold == "average" and i.name != TIME_INPUT for i in model.inputs], dtype=bool)
    return np.where(averaged, (record.u + record.u_next) / 2.0, record.u)


def held_lines(channel: Channel, t: Array) -> tuple[Array, Array]:
    """Approximate a zero-order hold of samples by a straight line in each interval between given times.

    Parameters
    ----------
    channel
        The signal, each sample of which is held until the next one.
    t
        Edges of the intervals (n,) [s], increasing.

    Returns
    -------
    first, last : Array (n,)
        Values of the line at the start and at the end of the interval after each time. The last entry of both is the
        value of the signal at the last time.

    Notes
    -----
    The line is the least-squares line. It keeps the mean and the first moment of the signal. A lag that follows
    therefore sees each change at its right time, to third order of the interval, although no row lies at the change.
    """
    changes = _change_times(channel)
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
