"""Text files of FlySight 2 (TRACK.CSV, SENSOR.CSV): columns and units by sensor, and rows that begin with its name.

Theory of operation. ``$COL,GNSS,time,lat,...`` names the columns of a sensor, ``$UNIT,GNSS,,deg,...`` their units, and
a row of it is ``$GNSS,2024-05-12T13:00:00.000Z,59.1,...``. Fixes have UTC. The other sensors count seconds since
power-on. ``$TIME,time,tow,week`` has such a time and the GPS time of the same instant, by which they are moved to UTC.
Without these rows the places of the fixes among the other rows tell the offset: a fix stands behind the last row before
its receipt. The shortest delay is that of the measurement to within one row.
"""

from __future__ import annotations

import csv
import math
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.importers.row_times import gps_seconds
from seatrial.daq.importers.table import Column, SourceOptions, Table

_TIME, _CLOCK = "time", "TIME"  # column of the time; sensor that has it with GPS time
_UTC = 1e9  # s: a time that is greater is one since 1970
_SLOWEST_RATE = 1e-3  # of the clock against GPS time: more is a wrong row


def read_flysight(path: Path, options: SourceOptions) -> list[Table]:
    """Read a file of a FlySight 2 as a table for each sensor, with UTC if the file has it.

    Raises
    ------
    SeatrialError
        It cannot be read, or has no rows.
    """
    columns: dict[str, list[str]] = {}
    units: dict[str, list[str]] = {}
    rows: dict[str, list[list[str]]] = {}  # each with the number of its line in front
    n_lost: Counter[str] = Counter()
    try:
        with path.open(encoding="utf-8", errors="replace", newline="") as file:
            for number, cells in enumerate(csv.reader(line.replace("\0", "") for line in file)):
                word, sensor = cells[0] if cells else "", cells[1] if len(cells) > 1 else ""
                if word == "$COL":
                    columns[sensor] = [cell.strip() for cell in cells[2:]]
                elif word == "$UNIT":
                    units[sensor] = [cell.strip() for cell in cells[2:]]
                elif (name := word[1:]) in columns and word.startswith("$"):
                    if len(cells) - 1 == len(columns[name]):
                        rows.setdefault(name, []).append([str(number), *cells[1:]])
                    else:
                        n_lost[name] += 1  # a card that was full, or a battery that was empty
    except (OSError, csv.Error) as error:
        raise SeatrialError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    sensors = [
        _sensor(
            path, name, columns[name], dict(zip(columns[name], units.get(name, ()), strict=False)), own, n_lost[name]
        )
        for name, own in rows.items()
        if _TIME in columns[name]
    ]
    if not sensors:
        raise SeatrialError(f"{path}: no rows below the header")
    _move_to_utc(sensors)
    return [one.table for one in sensors if one.table.topic != _CLOCK] or [one.table for one in sensors]


class _Sensor(NamedTuple):
    """A table and the numbers of the lines of its rows, (n,)."""

    table: Table
    lines: Column

    @property
    def t(self) -> Column:
        """Times of its rows [s], (n,)."""
        assert self.table.t is not None
        return self.table.t

    @property
    def has_utc(self) -> bool:
        """Whether its times are UTC."""
        return bool(len(self.t) and self.t[0] > _UTC)


def _sensor(
    path: Path, name: str, columns: list[str], units: dict[str, str], rows: list[list[str]], n_lost: int
) -> _Sensor:
    at = columns.index(_TIME)
    t = np.array([_seconds(row[at + 1]) for row in rows])
    known = np.isfinite(t)
    lines = np.array([float(row[0]) for row in rows])[known]
    values = {c: np.array([_number(row[k + 1]) for row in rows])[known] for k, c in enumerate(columns) if c and k != at}
    n_lost += int(np.sum(~known))
    remark = f"{counted(n_lost, 'row')} without a time or not whole left out" if n_lost else ""
    stated = {column: unit for column, unit in units.items() if unit and column in values}
    return _Sensor(Table(path, name, values, t[known], remark=remark, units=stated), lines)


def _seconds(cell: str) -> float:
    """A time of UTC [s since 1970] or of the device [s]; NaN if it is none."""
    try:
        return float(cell)
    except ValueError:
        pass
    try:
        moment = datetime.fromisoformat(cell)
    except ValueError:
        return math.nan
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan


def _move_to_utc(sensors: list[_Sensor]) -> None:
    """Move the times of the device's own clock to UTC."""
    clock = next(
        (one for one in sensors if one.table.topic == _CLOCK and {"tow", "week"} <= set(one.table.names)), None
    )
    fixes = next((one for one in sensors if one.has_utc), None)
    own = [one for one in sensors if one.table.topic != _CLOCK and len(one.t) and not one.has_utc]
    if clock is not None:
        delay = gps_seconds(clock.table.columns["week"], clock.table.columns["tow"]) - clock.t
        good = np.isfinite(delay) & (np.abs(delay - np.nanmedian(delay)) < 1.0 + _SLOWEST_RATE * np.ptp(clock.t))
        if good.any():
            for one in own:
                one.table.t = _moved(one.t, clock.t[good], delay[good])
            return
    if fixes is None:
        return
    for one in own:
        before = np.searchsorted(one.lines, fixes.lines) - 1  # the last row of the sensor in front of each fix
        delay = fixes.t - one.t[before]
        if not np.any(before >= 0):
            continue
        one.table.t = one.t + np.max(delay[before >= 0])
        moved = "its times are moved to UTC by the fixes among its rows, to within one row"
        one.table.remark = "; ".join(part for part in (one.table.remark, moved) if part)


def _moved(t: Column, known: Column, delay: Column) -> Column:
    """Times (n,) with the delay between the clocks, (m,) at the times known (m,), as a straight line through it."""
    if len(known) < 3 or np.ptp(known) == 0.0:
        return np.asarray(t + np.median(delay))
    rate, offset = np.polyfit(known - known[0], delay, 1)
    return np.asarray(t + offset + rate * (t - known[0]))
