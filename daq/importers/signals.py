"""Columns of tables -> signals in SI and our axes, by a map: the one place where values are converted."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.checks import held_signals, is_measured
from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.importers.import_map import Signal, Source, TimeColumn
from seatrial.daq.importers.missing_inputs import input_gaps
from seatrial.daq.importers.row_times import row_times
from seatrial.daq.importers.table import Column, Table
from seatrial.daq.importers.units import UNITS
from seatrial.daq.log import local_ned, schema

# Of another sign in north, east, down and forward, starboard, down than in east, north, up and forward, left, up
_TURNED = {"v", "w", "q", "r", "ay", "az", "theta", "N", "Y"}
COARSE = 0.3  # share of the rows whose time repeats: the stamps are coarser than the rows
_ATTITUDE = ("roll", "pitch", "yaw")


@dataclass(frozen=True)
class SignalData:
    """One signal's samples in SI: t in s since 1970, shape (n,), and values, shape (n,)."""

    signal: Signal
    unit: str
    t: Column
    values: Column
    has_gaps: bool = False  # whether it is an input that is unknown at times: its sample is NaN there


@dataclass(frozen=True)
class Held:
    """A signal whose values the source holds: of ``n`` samples, ``n_left_out`` repeat the one before."""

    name: str
    n: int
    n_left_out: int
    interval: float  # s from one measurement to the next


@dataclass(frozen=True)
class RowsLeftOut:
    """Rows of one table that are not in the log because of their times.

    ``why``: ``repeats``, their times repeat; ``back``, times run back (some may repeat); ``stamps``, the source itself
    found their stamps wrong. ``rate``: rows per second of the whole table [Hz].
    """

    topic: str
    n: int
    n_rows: int
    why: str
    rate: float

    @property
    def text(self) -> str:
        """What was left out, for people."""
        place = f"{self.topic}: " if self.topic else ""
        reason = "whose stamps are wrong" if self.why == "stamps" else "where time repeats or runs back"
        return f"{place}{counted(self.n, 'row')} left out, {reason} ({self.n_rows} in all)"


@dataclass(frozen=True)
class Signals:
    """What one file gave."""

    signals: tuple[SignalData, ...]
    held: tuple[Held, ...]  # signals of which repeats were left out
    n_dropped: int  # rows out of order and cells without a number, where the map drops them
    n_disordered: int  # of these, the rows whose times ran back or repeated
    left_out: tuple[RowsLeftOut, ...]  # the same by table, with those that the source has left out


def read_signals(tables: Sequence[Table], source: Source) -> Signals:
    """The signals of one file by its part of the map. Raises SeatrialError with the place and what to do."""
    signals: list[SignalData] = []
    n_dropped = 0
    uses: dict[tuple[int, str, str], _RowUse] = {}
    held: list[Held] = []
    of_table: dict[tuple[object, ...], list[int]] = {}  # places in `signals` of those that share their rows
    clocks: dict[tuple[int, str, str], tuple[Column, NDArray[np.bool_], NDArray[np.bool_]]] = {}
    for signal in source.signals:
        table = _table(tables, signal)
        time = source.time
        if signal.time:
            time = replace(time or TimeColumn(), column=signal.time, rate_hz=0.0)
            if signal.time_format:
                time = replace(time, format=signal.time_format, date="", fraction="")
        clock = (id(table), signal.time, signal.time_format)
        if clock not in clocks:
            t = row_times(table, time, lenient=source.options.style.time_order == "drop")
            ordered = _order(table, t, source)
            uses[clock] = _RowUse(table, t)
            shared = [s for s in source.signals if (id(_table(tables, s)), s.time, s.time_format) == clock]
            columns = [column for s in shared if not s.timeout for column in s.columns]
            new = ordered
            if source.options.style.repeats == "drop" and columns:
                new = ordered & _news([table.numbers(column) for column in columns])
            n_dropped += len(t) - int(new.sum())
            clocks[clock] = t, ordered, new
        t, ordered, new = clocks[clock]
        raw = _raw(table, signal)
        policy = signal.nan or source.options.style.nan or ("error" if table.strict else "drop")
        if policy == "zero":
            raw = np.where(np.isnan(raw), (0.0 - signal.offset) / signal.scale, raw)
        if policy == "drop" and not ordered.all() and np.isnan(raw).any():
            # A row of another sensor, with the same time and without a cell of this one, costs it nothing.
            known = np.isfinite(raw) & np.isfinite(t)
            own = np.zeros(len(raw), bool)
            own[known] = _rising(t[known])
            new, ordered = new | own if source.options.style.repeats != "drop" else new, ordered | own
            new, ordered = new & (own | ~known), ordered & (own | ~known)
        uses[clock].add(raw, ordered)
        kept = ordered if signal.timeout else new  # a command that is repeated stands for longer
        rows = kept & ~(np.isnan(raw) if policy == "drop" else np.zeros(len(raw), bool))
        gaps = np.zeros(len(raw), bool)
        if policy == "drop" and signal.role == "input" and not signal.timeout:
            gaps[kept] = input_gaps(t[kept], raw[kept])
            rows |= gaps  # as NaN: from there on the input is unknown
        values = signal.sign * (signal.scale * raw + signal.offset)
        if signal.missing is not None and signal.missing_is is None:
            rows &= raw != signal.missing
        elif signal.missing is not None:
            values[raw == signal.missing] = signal.missing_is
        n_dropped += int(kept.sum()) - int((rows & ~np.isnan(raw)).sum() if policy == "drop" else rows.sum())
        bad = np.flatnonzero(np.isnan(raw) & kept)
        if policy == "error" and len(bad):
            raise table.error(int(bad[0]), signal.columns[0], 'no number; nan = "drop" or "keep" would allow that')
        repeats = signal.repeats or source.options.style.repeats
        holds = signal.hold == "zero" or signal.timeout
        if repeats == "" and not holds and not np.isnan(raw[rows]).any():
            of_table.setdefault((clock, rows.tobytes()), []).append(len(signals))
        elif signal.repeats == "drop":
            rows[np.flatnonzero(rows)] &= _news([raw[rows]])
        unit, factor = UNITS[signal.unit]
        signal, values = _turned(signal, values[rows] * factor)
        t_signal, values = _expire(t[rows], _angle(values, signal.angle), signal.timeout)
        signals.append(SignalData(signal, unit, t_signal, values, bool(gaps.any())))
    for places in of_table.values():
        for k, data, one in _without_held([signals[k] for k in places], places):
            signals[k] = data
            held.append(one)
    left_out = {(one.topic, one.why): one for use in uses.values() for one in use.left_out()}
    n_disordered = sum(one.n for one in left_out.values() if one.why != "stamps")
    return Signals(tuple(signals), tuple(held), n_dropped, n_disordered, tuple(left_out.values()))


class _RowUse:
    """Which rows of a table with one clock are in the log, of all its signals."""

    def __init__(self, table: Table, t: Column) -> None:
        self._table, self._t = table, t
        self._kept, self._valued = np.zeros(len(t), bool), np.zeros(len(t), bool)
        self._again = np.append(False, np.diff(t) == 0.0)  # rows that say nothing beside the one before
        self._has_time = np.isfinite(t)  # a remark of the table counts the others

    def add(self, raw: Column, ordered: NDArray[np.bool_]) -> None:
        """Add the values (n,) of a signal, and which rows of it are in order (n,)."""
        known = np.isfinite(raw)
        self._kept |= ordered & known
        self._valued |= known
        self._again[1:] &= (raw[1:] == raw[:-1]) | ~known[1:]

    def left_out(self) -> Iterator[RowsLeftOut]:
        """What the log lacks because of the times of rows. Rows that are written twice are not lacking."""
        table, t = self._table, self._t[self._has_time]
        if table.n_left_out:
            yield RowsLeftOut(table.topic, table.n_left_out, len(t) + table.n_left_out, "stamps", 0.0)
        if n := int(np.sum(self._valued & ~self._kept & ~self._again & self._has_time)):
            why = "back" if np.any(np.diff(t) < 0.0) else "repeats"
            yield RowsLeftOut(table.topic, n, len(t), why, (len(t) - 1) / max(float(np.ptp(t)), 1e-9))


def _without_held(table: Sequence[SignalData], places: Sequence[int]) -> Iterator[tuple[int, SignalData, Held]]:
    """The signals of one table whose values are held, each with its place, without the repeats."""
    t = table[0].t
    found = held_signals(t, {one.signal.name: one.values for one in table})
    for k, one in zip(places, table, strict=True):
        if (held := found.get(one.signal.name)) is None:
            continue
        interval = held.rows * float(np.median(np.diff(t)))
        if one.signal.role == "input" and not is_measured(one.values[held.new], interval):
            continue
        n_left_out = len(t) - int(held.new.sum())
        data = replace(one, t=t[held.new], values=one.values[held.new])
        yield k, data, Held(one.signal.name, len(t), n_left_out, interval)


def _table(tables: Sequence[Table], signal: Signal) -> Table:
    """The table of a signal: the one of its topic, or without a topic the one that has its column."""
    if len(tables) == 1 and not signal.topic:
        return tables[0]
    here = [one for one in tables if one.topic == signal.topic]
    having = [one for one in here if set(signal.columns) <= set(one.names)]
    if len(having) == 1:
        return having[0]
    if here and not having:
        return here[0]  # it will say which columns there are
    if signal.topic or not tables:
        there = ", ".join(sorted({one.topic for one in tables if one.topic})) or "none"
        raise SeatrialError(f"{_path(tables)}: no topic {signal.topic}; there is: {there}")
    raise SeatrialError(
        f"{_path(tables)}: signal {signal.name}: has {len(tables)} topics; say which with topic and field"
    )


def _path(tables: Sequence[Table]) -> str:
    return str(tables[0].path) if tables else "the source"


def _raw(table: Table, signal: Signal) -> Column:
    """The values before scale and sign, (n,), in `signal.unit`."""
    if not signal.make:
        return table.numbers(signal.columns[0])
    parts = [table.numbers(c) * UNITS[unit][1] for c, unit in zip(signal.columns, signal.units, strict=True)]
    if signal.make in _ATTITUDE:
        size = np.sqrt(sum(part**2 for part in parts))
        yaw, pitch, roll = schema.angles(*(np.where(size > 0.0, part, np.nan) for part in parts))
        return {"roll": roll, "pitch": pitch, "yaw": yaw}[signal.make]
    if signal.make in ("velocity_north", "velocity_east"):
        # A receiver at rest knows no course; its speed of zero is known all the same.
        course = np.where(parts[0] == 0.0, 0.0, parts[1])
        return parts[0] * (np.cos(course) if signal.make == "velocity_north" else np.sin(course))
    lat, lon = (np.degrees(part) for part in parts)
    known = np.flatnonzero(np.isfinite(lat) & np.isfinite(lon) & ((lat != 0.0) | (lon != 0.0)))
    found = np.full(len(lat), np.nan)  # 0, 0 is what receivers without a fix write
    if len(known):
        found[known] = local_ned(lat[known], lon[known])[signal.make == "east"]
    return found


def _turned(signal: Signal, values: Column) -> tuple[Signal, Column]:
    """A signal of the frame ENU in ours: its name and its values."""
    if signal.frame == "NED":
        return signal, values
    if signal.name == "psi":
        values = np.pi / 2.0 - values
    sign = -1.0 if signal.name in _TURNED else 1.0
    return replace(signal, name=signal.log_name), sign * values


def _angle(values: Column, how: str) -> Column:
    if how == "wrap":
        return np.asarray(np.pi - np.mod(np.pi - values, 2.0 * np.pi))  # -pi < angle <= pi
    if how == "unwrap":
        found = values.copy()
        known = ~np.isnan(values)
        found[known] = np.unwrap(values[known])
        return found
    return values


def _news(values: Sequence[Column]) -> NDArray[np.bool_]:
    """Rows in which any of the columns, each (n,), differs from the row before, shape (n,)."""
    new = np.zeros(len(values[0]), bool)
    new[:1] = True
    for one in values:
        new[1:] |= (one[1:] != one[:-1]) & ~(np.isnan(one[1:]) & np.isnan(one[:-1]))
    return new


def _expire(t: Column, values: Column, timeout: float) -> tuple[Column, Column]:
    """The signal with a zero `timeout` seconds after each sample that the next one does not follow sooner."""
    if not timeout or not len(t):
        return t, values
    last = np.append(np.flatnonzero(np.diff(t) > timeout), len(t) - 1)
    return np.insert(t, last + 1, t[last] + timeout), np.insert(values, last + 1, 0.0)


def _order(table: Table, t: Column, source: Source) -> NDArray[np.bool_]:
    """The most rows whose times rise; raises where these are not all, unless the others are dropped."""
    has_time = np.isfinite(t)
    behind = np.flatnonzero(np.diff(t[has_time]) <= 0.0)
    if not len(behind):
        return has_time
    row = int(behind[0]) + 1
    if (source.options.style.time_order or ("error" if table.strict else "drop")) == "error":
        what = "repeats" if t[row] == t[row - 1] else f"runs back by {t[row - 1] - t[row]:.6g} s"
        column = source.time.column if source.time else "time"
        advice = 'csv.time_order = "drop" would leave such rows out'
        if np.all(np.diff(t) >= 0.0) and len(behind) > COARSE * len(t):
            advice = f"its stamps are too coarse: {coarse_advice((len(t) - 1) / max(float(np.ptp(t)), 1e-9))}"
        raise table.error(row, column, f"time {what}; {advice}")
    ordered = np.zeros(len(t), bool)
    ordered[has_time] = _rising(t[has_time])
    return ordered


def coarse_advice(rate: float) -> str:
    """What to do about stamps that are coarser than the rows, which come at a rate [Hz]."""
    return f"time = {{ rate_hz = {rate:.4g} }} of the map gives even times in their place"


def _rising(t: Column) -> NDArray[np.bool_]:
    """A longest part of t that rises, (n,), of equal times the first: a single time far ahead costs no row but its own
    (Fredman, Discrete Mathematics 11, 1975)."""
    ends: list[float] = []  # of rising parts of 1, 2, ... rows the lowest time they can end with, and its row
    rows: list[int] = []
    before = np.full(len(t), -1)
    for row, time in enumerate(t.tolist()):
        k = bisect_left(ends, time)
        if k < len(ends) and ends[k] == time:
            continue
        ends[k : k + 1], rows[k : k + 1] = [time], [row]
        before[row] = rows[k - 1] if k else -1
    kept, row = np.zeros(len(t), bool), rows[-1]
    while row >= 0:
        kept[row], row = True, int(before[row])
    return kept
