"""Conversion of columns of tables to signals in SI units and NED axes, by a map. No other module converts values."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.checks import held_signals, is_measured, is_sampled_slower
from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.geometry import euler_angles, local_ned
from seatrial.daq.importers.import_map import Signal, Source, TimeColumn
from seatrial.daq.importers.missing_inputs import input_gaps
from seatrial.daq.importers.recognise import read_name
from seatrial.daq.importers.row_times import row_times
from seatrial.daq.importers.table import Column, Table
from seatrial.daq.importers.units import UNITS

# Signals whose sign differs between ENU and FLU (east, north, up; forward, left, up) and NED and FRD
TURNED = {"v", "w", "q", "r", "ay", "az", "theta", "N", "Y"}
COARSE = 0.3  # share of rows with a repeated time; with more, the stamps are coarser than the rows
# Times with two rows at least, and standard deviation of their intervals over the mean, of two sources in one table
FEWEST_PAIRS, REGULAR = 5, 0.4
# Units of a shaft speed -> rev/min
PER_MINUTE = {"rev/min": 1.0, "rev/s": 60.0, "Hz": 60.0, "rad/s": 30.0 / np.pi}
_OF_MESSAGES = {"data", "value"}  # fields of messages with a single number, which only the topic names
_ATTITUDE = ("roll", "pitch", "yaw")


@dataclass(frozen=True)
class SignalData:
    """Samples of one signal that is imported by a map, in SI units.

    Attributes
    ----------
    signal : Signal
        The signal of the map.
    unit : str
        SI unit of the values.
    t : Array (n,)
        Times [s of the file's clock], or [s since 1970] after the origin of the map was added.
    values : Array (n,)
        The values.
    has_gaps : bool
        Whether it is an input that is unknown in some intervals of time; a NaN sample begins each interval.
    origin : tuple of float or None
        Latitude and longitude [deg] of the zero of a position that was computed from them; None for other signals.
    rpm_max : float or None
        Shaft speed [rev/min] at which a relative shaft speed is 1; None if the source does not show it.
    """

    signal: Signal
    unit: str
    t: Column  # s of the file's clock, or since 1970 after `origin` was added; (n,)
    values: Column  # (n,)
    has_gaps: bool = False  # whether it is an input with unknown intervals; a NaN sample begins each
    origin: tuple[float, float] | None = None  # latitude and longitude of a position's zero, deg
    rpm_max: float | None = None  # rev/min at which a relative shaft speed is 1


@dataclass(frozen=True)
class Held:
    """Signal whose source repeats each measurement in all rows until the next measurement.

    Attributes
    ----------
    name : str
        Name of the signal.
    n : int
        Number of samples before repeats are left out.
    n_left_out : int
        Number of samples that repeat the previous one and are left out.
    interval : float
        Time from one measurement to the next [s].
    """

    name: str
    n: int  # samples
    n_left_out: int  # samples that repeat the previous one
    interval: float  # s from one measurement to the next


@dataclass(frozen=True)
class RowsLeftOut:
    """Number of rows of one table that are not in the log because of their times, and the reason.

    Attributes
    ----------
    topic : str
        Topic of the table; "" for a file with a single table.
    n : int
        Number of rows left out.
    n_rows : int
        Number of rows of the table.
    why : str
        "repeats" if times repeat; "pairs" if times repeat regularly, as with a second source in the table; "back" if
        times run back, and some may repeat; "stamps" if the reader found wrong stamps.
    rate : float
        Mean rate of the rows of the table [Hz]; 0 for "stamps".
    """

    topic: str
    n: int  # rows left out
    n_rows: int  # rows of the table
    # repeats: times repeat; pairs: times repeat because of a second source; back: times run back, and some may repeat;
    # stamps: the reader found wrong stamps
    why: str
    rate: float  # Hz; rows per second of the whole table

    @property
    def text(self) -> str:
        """Topic of the table, number of rows left out and reason, in one line for the user."""
        place = f"{self.topic}: " if self.topic else ""
        reason = "because stamps are wrong" if self.why == "stamps" else "because times repeat or run back"
        return f"{place}{counted(self.n, 'row')} of {self.n_rows} left out, {reason}"


@dataclass(frozen=True)
class Signals:
    """Signals of one source file, converted by an import map, and what was left out.

    Attributes
    ----------
    signals : tuple of SignalData
        The signals, in the order of the map.
    held : tuple of Held
        Signals whose repeats were left out.
    n_dropped : int
        Number of rows and cells that are dropped, for example rows out of order and cells without a number. Repeats in
        `held` do not count.
    n_disordered : int
        Number of rows that are not in the log because their times run back or repeat.
    left_out : tuple of RowsLeftOut
        The rows in `n_disordered` by table, and the rows with wrong stamps.
    """

    signals: tuple[SignalData, ...]
    held: tuple[Held, ...]  # signals whose repeats were left out
    n_dropped: int  # rows out of order and cells without a number that the map drops
    n_disordered: int  # rows among them whose times run back or repeat
    left_out: tuple[RowsLeftOut, ...]  # the same rows by table, and the rows with wrong stamps


def read_signals(tables: Sequence[Table], source: Source) -> Signals:
    """Convert the tables of one source file to signals in SI units and NED axes, by an import map.

    Parameters
    ----------
    tables
        Tables of the file.
    source
        The part of the map for this file.

    Returns
    -------
    Signals
        The signals, in the order of the map, and what was left out. An input that becomes unknown has a NaN sample
        there.

    Raises
    ------
    SeatrialError
        If a column is missing, a cell has no number, or times are out of order, and the map does not allow this. The
        message names the place.

    Notes
    -----
    The steps for each signal are, in this order: rows in the order of time, cells without a number (`nan`), scale,
    offset and sign, `missing`, repeats that the map drops, SI unit, NED axes, `angle`, `timeout` and `time_shift`.
    Repeats of held values are removed last, together for the signals with the same rows. If cells without a number are
    dropped, the order of times is judged by the rows with a value of the signal.
    """
    signals: list[SignalData] = []
    n_dropped = 0
    uses: dict[tuple[int, str, str], _RowCounter] = {}
    held: list[Held] = []
    of_table: dict[tuple[object, ...], list[int]] = {}  # indices in `signals` of the signals with the same rows
    # Times, rows in order, and rows in order that do not repeat the row before; each (n,)
    clocks: dict[tuple[int, str, str], tuple[Column, NDArray[np.bool_], NDArray[np.bool_]]] = {}
    for signal in source.signals:
        table = _table_of_signal(tables, signal)
        time = source.time
        if signal.time:
            time = replace(time or TimeColumn(), column=signal.time, rate_hz=0.0)
            if signal.time_format:
                time = replace(time, format=signal.time_format, date="", fraction="")
        clock = (id(table), signal.time, signal.time_format)
        if clock not in clocks:
            t = row_times(table, time, lenient=source.options.style.time_order == "drop")
            ordered = _rows_in_order(table, t, source)
            uses[clock] = _RowCounter(table, t)
            shared = [s for s in source.signals if (id(_table_of_signal(tables, s)), s.time, s.time_format) == clock]
            columns = [column for s in shared if not s.timeout for column in s.columns]
            new = ordered
            if source.options.style.repeats == "drop" and columns:
                new = ordered & _changed_rows([table.numbers(column) for column in columns])
            n_dropped += len(t) - int(new.sum())
            clocks[clock] = t, ordered, new
        t, ordered, new = clocks[clock]
        raw = _raw_values(table, signal)
        policy = signal.nan or source.options.style.nan or ("error" if table.strict else "drop")
        if policy == "zero":
            raw = np.where(np.isnan(raw), (0.0 - signal.offset) / signal.scale, raw)
        if policy == "drop" and not ordered.all() and np.isnan(raw).any():
            # A row of another sensor may have the same time and no value of this signal. It must not remove a row with
            # a value, so the order of times is judged by the rows with values alone.
            known = np.isfinite(raw) & np.isfinite(t)
            rises = np.zeros(len(raw), bool)
            rises[known] = _longest_rising(t[known])
            new, ordered = new | rises if source.options.style.repeats != "drop" else new, ordered | rises
            new, ordered = new & (rises | ~known), ordered & (rises | ~known)
        uses[clock].add(raw, ordered)
        kept = ordered if signal.timeout else new  # with a timeout, a repeated command holds for longer
        rows = kept & ~(np.isnan(raw) if policy == "drop" else np.zeros(len(raw), bool))
        gaps = np.zeros(len(raw), bool)
        if policy == "drop" and signal.role == "input" and not signal.timeout:
            gaps[kept] = input_gaps(t[kept], raw[kept])
            rows |= gaps  # a NaN sample: the input is unknown from there on
        values = signal.sign * (signal.scale * raw + signal.offset)
        if signal.missing is not None and signal.missing_is is None:
            rows &= raw != signal.missing
        elif signal.missing is not None:
            values[raw == signal.missing] = signal.missing_is
        n_dropped += int(kept.sum()) - int((rows & ~np.isnan(raw)).sum() if policy == "drop" else rows.sum())
        bad = np.flatnonzero(np.isnan(raw) & kept)
        if policy == "error" and len(bad):
            problem = 'there is no number; nan = "drop" in the import map leaves such values out'
            raise table.error(int(bad[0]), signal.columns[0], problem)
        repeats = signal.repeats or source.options.style.repeats
        holds = signal.hold == "zero" or signal.timeout
        if repeats == "" and not holds and not np.isnan(raw[rows]).any():
            of_table.setdefault((clock, signal.time_shift, rows.tobytes()), []).append(len(signals))
        elif signal.repeats == "drop":
            rows[np.flatnonzero(rows)] &= _changed_rows([raw[rows]])
        unit, factor = UNITS[signal.unit]
        signal, values = _in_ned(signal, values[rows] * factor)
        t_signal, values = _with_timeouts(t[rows], _wrapped_or_unwrapped(values, signal.angle), signal.timeout)
        origin = _origin_of_position(table, signal)
        full, t_signal = _rpm_at_one(table, signal), t_signal + signal.time_shift
        signals.append(SignalData(signal, unit, t_signal, values, bool(gaps.any()), origin, full))
    for places in of_table.values():
        for k, data, held_signal in _without_held([signals[k] for k in places], places):
            signals[k] = data
            held.append(held_signal)
    left_out = {(rows_out.topic, rows_out.why): rows_out for use in uses.values() for rows_out in use.left_out()}
    n_disordered = sum(rows_out.n for rows_out in left_out.values() if rows_out.why != "stamps")
    return Signals(tuple(signals), tuple(held), n_dropped, n_disordered, tuple(left_out.values()))


class _RowCounter:
    """Counter of the rows of a table that the log lacks because of their times, over all signals with one time column.

    Parameters
    ----------
    table
        The table.
    t
        Times of its rows (n,) [s]; NaN for rows without a time, which are not counted.
    """

    def __init__(self, table: Table, t: Column) -> None:
        """Begin the count for the rows of a table, whose times `t` (n,) are in s."""
        self._table, self._t = table, t
        self._kept, self._valued = np.zeros(len(t), bool), np.zeros(len(t), bool)
        self._again = np.append(False, np.diff(t) == 0.0)  # rows that are copies of the row before
        self._has_time = np.isfinite(t)  # a remark of the table counts the rows without a time

    def add(self, raw: Column, ordered: NDArray[np.bool_]) -> None:
        """Count the rows of one more signal: its values (n,), NaN for none, and flags (n,) of rows in order of time."""
        known = np.isfinite(raw)
        self._kept |= ordered & known
        self._valued |= known
        self._again[1:] &= (raw[1:] == raw[:-1]) | ~known[1:]

    def left_out(self) -> Iterator[RowsLeftOut]:
        """Yield the number of rows of the table that the log lacks, for wrong stamps and for times out of order.

        A row that is kept for any signal, has no value, or is a copy of the row before, does not count. Rows without a
        time do not count either. Nothing is yielded for a reason without missing rows.
        """
        table, t = self._table, self._t[self._has_time]
        if table.n_left_out:
            yield RowsLeftOut(table.topic, table.n_left_out, len(t) + table.n_left_out, "stamps", 0.0)
        if n := int(np.sum(self._valued & ~self._kept & ~self._again & self._has_time)):
            why = "back" if np.any(np.diff(t) < 0.0) else "pairs" if _is_of_two_sources(t) else "repeats"
            yield RowsLeftOut(table.topic, n, len(t), why, (len(t) - 1) / max(float(np.ptp(t)), 1e-9))


def _is_of_two_sources(t: Column) -> bool:
    """Return whether times (n,) [s] that repeat look like those of two sources of unequal rate in one table.

    Then no time has more than two rows, and at least 5 times, but not more than half of them, have two, at regular
    intervals. Stamps that are coarser than the rows have several rows at nearly every time.
    """
    times, number = np.unique(t, return_counts=True)
    twice = times[number == 2]
    if np.max(number) > 2 or len(twice) < FEWEST_PAIRS or len(twice) > 0.5 * len(times):
        return False
    steps = np.diff(twice)
    return bool(np.std(steps) <= REGULAR * np.mean(steps))


def _without_held(table: Sequence[SignalData], places: Sequence[int]) -> Iterator[tuple[int, SignalData, Held]]:
    """Remove the repeats of signals whose source repeats each measurement in all rows until the next one.

    Yield for each of these signals its index, the signal without repeats, and the number of repeats. Signals are found
    by changes at regular intervals of at most 5 s (`held_signals`), those of one sensor, as x and y, together. The
    interval is that of the rows (median) times the rows per measurement. Other signals are not yielded, nor inputs
    whose values look like commands instead of measurements, nor commands that were sampled almost in each row. `table`
    has signals with the same times, and `places` the index of each in the list of all signals.
    """
    t = table[0].t
    found = held_signals(t, {data.signal.name: data.values for data in table})
    for k, data in zip(places, table, strict=True):
        if (held := found.get(data.signal.name)) is None:
            continue
        interval = held.rows * float(np.median(np.diff(t)))
        if data.signal.role == "input" and not is_measured(data.values[held.new], interval):
            continue
        if data.signal.hold == "sampled" and not is_sampled_slower(held):
            continue
        n_left_out = len(t) - int(held.new.sum())
        data = replace(data, t=t[held.new], values=data.values[held.new])
        yield k, data, Held(data.signal.name, len(t), n_left_out, interval)


def _table_of_signal(tables: Sequence[Table], signal: Signal) -> Table:
    """Return the table that has the columns of a signal: the table of its topic; without a topic, the only table.

    A signal without a topic selects the tables without a topic if there are several tables. Of several selected tables,
    the one that has all columns of the signal is returned; if none has them, the first. Raise SeatrialError if no table
    has the topic, if none of its tables has one of the columns, or if several of its tables have all of them.
    """
    if len(tables) == 1 and not signal.topic:
        return tables[0]
    of_topic = [table for table in tables if table.topic == signal.topic]
    having = [table for table in of_topic if set(signal.columns) <= set(table.names)]
    if len(having) == 1:
        return having[0]
    if of_topic and not having:
        known = {name for table in of_topic for name in table.names}
        for column in signal.columns:
            if column not in known:
                of_topic[0].numbers(column)  # raises an error with similar names, before the times are read
        return of_topic[0]  # the columns are in several tables, of different lengths: reading them raises an error
    if signal.topic or not tables:
        topics = ", ".join(sorted({table.topic for table in tables if table.topic}))
        if not topics:
            raise SeatrialError(
                f"{_path_text(tables)}: there is no topic {signal.topic}: the file has no topics, so this import map "
                "is for another kind of source; make one for this file (seatrial import --guess FILE)"
            )
        raise SeatrialError(
            f"{_path_text(tables)}: there is no topic {signal.topic}; name one of these in the import map: {topics}"
        )
    raise SeatrialError(
        f"{_path_text(tables)}: signal {signal.name}: the source has {len(tables)} topics; add topic and field to "
        "this signal in the import map"
    )


def _path_text(tables: Sequence[Table]) -> str:
    """Return the path of the source file of tables, for messages; "the source" without a table."""
    return str(tables[0].path) if tables else "the source"


def _raw_values(table: Table, signal: Signal) -> Column:
    """Return the values of a signal (n,) before scale and sign, in the unit of its column.

    A signal with `make` is computed from its columns, in SI units. A position is in metres north or east of the first
    fix of the table; a fix at 0, 0 is NaN. A velocity is 0 at speed 0, also without a course. The angles of a
    quaternion of zeros are NaN. Without `make`, the numbers of the column are returned. Otherwise NaN in a column gives
    NaN.
    """
    if not signal.make:
        return table.numbers(signal.columns[0])
    parts = [table.numbers(c) * UNITS[unit][1] for c, unit in zip(signal.columns, signal.units, strict=True)]
    if signal.make in _ATTITUDE:
        size = np.sqrt(sum(part**2 for part in parts))
        yaw, pitch, roll = euler_angles(*(np.where(size > 0.0, part, np.nan) for part in parts))
        return {"roll": roll, "pitch": pitch, "yaw": yaw}[signal.make]
    if signal.make in ("velocity_north", "velocity_east"):
        # A receiver at rest reports no course, but its velocity is zero.
        course = np.where(parts[0] == 0.0, 0.0, parts[1])
        return parts[0] * (np.cos(course) if signal.make == "velocity_north" else np.sin(course))
    lat, lon = (np.degrees(part) for part in parts)
    known = _fix_rows(lat, lon)
    found = np.full(len(lat), np.nan)
    if len(known):
        found[known] = local_ned(lat[known], lon[known])[signal.make == "east"]
    return found


def _fix_rows(lat: Column, lon: Column) -> NDArray[np.intp]:
    """Return the rows with a fix, of latitudes and longitudes (n,) [deg]. Receivers without a fix write NaN or 0, 0."""
    return np.flatnonzero(np.isfinite(lat) & np.isfinite(lon) & ((lat != 0.0) | (lon != 0.0)))


def _rpm_at_one(table: Table, signal: Signal) -> float | None:
    """Return the shaft speed [rev/min] at which an imported relative shaft speed is 1; None if it is not known.

    It follows from the scale of the signals ``n`` and ``n_NAME``, if the unit of the column is that of a shaft speed:
    in the map, in the source or in the name of the column, as in ``rpm_left``.
    """
    is_speed = signal.name == "n" or (signal.name.startswith("n_") and not signal.name.startswith("n_cmd"))
    if not is_speed or signal.make or signal.offset or signal.unit not in ("1", *PER_MINUTE):
        return None
    column = signal.columns[0]
    stated = f" [{table.units[column]}]" if column in table.units else ""
    name = read_name(column.rpartition(".")[2] + stated)
    words = name.words | (read_name(signal.topic.rpartition("/")[2]).words if column in _OF_MESSAGES else frozenset())
    unit = signal.unit if signal.unit in PER_MINUTE else name.unit or ("rev/min" if "rpm" in words else "")
    return PER_MINUTE[unit] / abs(signal.scale) if unit in PER_MINUTE else None


def _origin_of_position(table: Table, signal: Signal) -> tuple[float, float] | None:
    """Return latitude and longitude [deg] of the zero of a signal that is made from them: the first fix of the table.

    None for other signals, without a fix, and for a signal that the map scales, shifts or turns.
    """
    plain = (signal.scale, signal.offset, signal.sign, signal.frame) == (1.0, 0.0, 1.0, "NED")
    if signal.make not in ("north", "east") or not plain:
        return None
    parts = zip(signal.columns, signal.units, strict=True)
    lat, lon = (np.degrees(table.numbers(column) * UNITS[unit][1]) for column, unit in parts)
    known = _fix_rows(lat, lon)
    return (float(lat[known[0]]), float(lon[known[0]])) if len(known) else None


def _in_ned(signal: Signal, values: Column) -> tuple[Signal, Column]:
    """Convert a signal and its values (n,) from ENU (east, north, up; forward, left, up) to NED axes.

    A signal of frame "NED" is unchanged. x and y exchange their names (`Signal.log_name`), psi becomes pi/2 - psi, and
    the sign of v, w, q, r, ay, az, theta, N and Y changes. All other signals keep their values.
    """
    if signal.frame == "NED":
        return signal, values
    if signal.name == "psi":
        values = np.pi / 2.0 - values
    sign = -1.0 if signal.name in TURNED else 1.0
    return replace(signal, name=signal.log_name), sign * values


def _wrapped_or_unwrapped(values: Column, how: str) -> Column:
    """Convert the angles (n,) [rad] of an imported signal as `how` says, the key `angle` of the import map.

    "wrap" gives -pi < angle <= pi, "unwrap" a continuous angle, and "keep" no change. NaN stays NaN; a continuous angle
    goes on after it.
    """
    if how == "wrap":
        return np.asarray(np.pi - np.mod(np.pi - values, 2.0 * np.pi))  # -pi < angle <= pi
    if how == "unwrap":
        found = values.copy()
        known = ~np.isnan(values)
        found[known] = np.unwrap(values[known])
        return found
    return values


def _changed_rows(values: Sequence[Column]) -> NDArray[np.bool_]:
    """Return the flags (n,) of rows of an imported table in which any of the columns (n,) differs from the row before.

    `values` has one or more columns. The first row counts as changed. NaN after NaN is no change.
    """
    new = np.zeros(len(values[0]), bool)
    new[:1] = True
    for column in values:
        new[1:] |= (column[1:] != column[:-1]) & ~(np.isnan(column[1:]) & np.isnan(column[:-1]))
    return new


def _with_timeouts(t: Column, values: Column, timeout: float) -> tuple[Column, Column]:
    """Insert a zero where an imported input times out, and return its times [s] and values, then longer than (n,).

    The zero is a new sample at the time of the timeout. An input times out `timeout` [s] after each sample that no
    other sample follows within this time, also after the last one. With a timeout of 0, or without samples, nothing is
    inserted.
    """
    if not timeout or not len(t):
        return t, values
    last = np.append(np.flatnonzero(np.diff(t) > timeout), len(t) - 1)
    return np.insert(t, last + 1, t[last] + timeout), np.insert(values, last + 1, 0.0)


def _rows_in_order(table: Table, t: Column, source: Source) -> NDArray[np.bool_]:
    """Return the flags (n,) of the largest set of rows of a table whose times `t` (n,) [s] rise strictly.

    Rows without a time (NaN) are not in it. A time that repeats the one before is out of order too. If rows are out of
    order, raise SeatrialError unless the import map (`source`) drops them, or the table is no text and the map has no
    key for this.
    """
    has_time = np.isfinite(t)
    behind = np.flatnonzero(np.diff(t[has_time]) <= 0.0)
    if not len(behind):
        return has_time
    row = int(behind[0]) + 1
    if (source.options.style.time_order or ("error" if table.strict else "drop")) == "error":
        fault = "repeats" if t[row] == t[row - 1] else f"runs back by {t[row - 1] - t[row]:.6g} s"
        column = source.time.column if source.time else "time"
        advice = 'csv.time_order = "drop" in the import map leaves such rows out'
        if np.all(np.diff(t) >= 0.0) and len(behind) > COARSE * len(t):
            advice = f"its stamps are too coarse: {coarse_advice((len(t) - 1) / max(float(np.ptp(t)), 1e-9))}"
        raise table.error(row, column, f"time {fault}; {advice}")
    ordered = np.zeros(len(t), bool)
    ordered[has_time] = _longest_rising(t[has_time])
    return ordered


def coarse_advice(rate: float) -> str:
    """Return the advice for the user if several rows have the same time stamp, as whole seconds at 10 Hz.

    Parameters
    ----------
    rate
        Mean rate of the rows [Hz].

    Returns
    -------
    str
        The advice, with the key of the import map that replaces the stamps by even times.
    """
    return f"time = {{ rate_hz = {rate:.4g} }} in the import map replaces them by even times"


def _longest_rising(t: Column) -> NDArray[np.bool_]:
    """Select the most rows of an imported table whose times `t` (n,) rise strictly; return their flags (n,).

    A single time that is too large then costs only its own row (Fredman, Discrete Mathematics 11, 1975). Of equal
    times, at most one is selected. The times must not be NaN.
    """
    ends: list[float] = []  # lowest last time of a rising subsequence of 1, 2, ... rows
    rows: list[int] = []  # the row of this time
    before = np.full(len(t), -1)
    for row, time in enumerate(t.tolist()):
        k = bisect_left(ends, time)
        if k < len(ends) and ends[k] == time:
            continue
        ends[k : k + 1], rows[k : k + 1] = [time], [row]
        before[row] = rows[k - 1] if k else -1
    kept, row = np.zeros(len(t), bool), rows[-1] if rows else -1
    while row >= 0:
        kept[row], row = True, int(before[row])
    return kept
