"""Reader of the text files of FlySight 2 (TRACK.CSV, SENSOR.CSV): one table for each sensor, with times in UTC.

Theory of operation. ``$COL,GNSS,time,lat,...`` names the columns of a sensor and ``$UNIT,GNSS,,deg,...`` their units.
Each row begins with the name of its sensor: ``$GNSS,2024-05-12T13:00:00.000Z,59.1,...``. Fixes have UTC. The other
sensors have seconds since power-on. A row ``$TIME,time,tow,week`` has such a time and the GPS time of the same instant;
these rows move the other sensors to UTC. In a file without them, the offset follows from the order of the rows: the
recorder writes a fix after the last row that came before it. The largest difference between a fix and this row is the
offset, to within one row.
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

_TIME, _CLOCK = "time", "TIME"  # column of the time; name of the rows with GPS time
_UTC = 1e9  # s; greater times are since 1970, smaller ones since power-on
_LARGEST_DRIFT = 1e-3  # s/s of the device's clock against GPS time; a larger drift is a wrong row


def read_flysight(path: Path, options: SourceOptions) -> list[Table]:
    """Read a text file of a FlySight 2.

    Parameters
    ----------
    path
        The file.
    options
        Not used.

    Returns
    -------
    list of Table
        One table for each sensor with a column of times and complete rows. The times are in s since 1970, or in s since
        power-on if they cannot be converted to UTC. Rows with GPS time (TIME) make a table only if there is no other.
        Rows of a sensor without a line $COL before them are ignored. A remark counts incomplete rows.

    Raises
    ------
    SeatrialError
        If the file cannot be read, or no sensor with a column of times has complete rows.
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
                        n_lost[name] += 1  # cut off: the card was full or the battery empty
    except (OSError, csv.Error) as error:
        why = getattr(error, "strerror", None) or error
        raise SeatrialError(f"{path}: cannot be read: {why}; check its path and permissions") from error
    sensors = [
        _sensor_rows(
            path,
            name,
            columns[name],
            dict(zip(columns[name], units.get(name, ()), strict=False)),
            sensor_rows,
            n_lost[name],
        )
        for name, sensor_rows in rows.items()
        if _TIME in columns[name]
    ]
    if not sensors:
        raise SeatrialError(f"{path}: no lines with data below the header; give a complete file")
    _move_to_utc(sensors)
    return [sensor.table for sensor in sensors if sensor.table.topic != _CLOCK] or [sensor.table for sensor in sensors]


class _SensorRows(NamedTuple):
    """Rows of one sensor of a FlySight file.

    Attributes
    ----------
    table : Table
        The rows, with times in s since 1970 or since power-on.
    lines : Array (n,)
        Number of the line in the file, for each row.
    """

    table: Table
    lines: Column  # (n,); number of the line of each row

    @property
    def t(self) -> Column:
        """Times of the sensor's rows [s], (n,): since 1970, or since power-on."""
        assert self.table.t is not None
        return self.table.t

    @property
    def has_utc(self) -> bool:
        """Whether the times of the sensor's rows are UTC: the first one is above 1e9 s. False without rows."""
        return bool(len(self.t) and self.t[0] > _UTC)


def _sensor_rows(
    path: Path, name: str, columns: list[str], units: dict[str, str], rows: list[list[str]], n_lost: int
) -> _SensorRows:
    """Convert the text cells of one FlySight sensor to a table, with the line number of each row.

    `columns` are the names of the columns, "time" among them. Each of `rows` has its line number in front of its cells.
    `units` are the units by column; empty ones are left out. Rows whose time cannot be read are left out. The remark of
    the table counts these and the `n_lost` incomplete rows. A cell that is not a number becomes NaN.
    """
    at = columns.index(_TIME)
    t = np.array([_cell_seconds(row[at + 1]) for row in rows])
    known = np.isfinite(t)
    lines = np.array([float(row[0]) for row in rows])[known]
    values = {
        c: np.array([_cell_number(row[k + 1]) for row in rows])[known] for k, c in enumerate(columns) if c and k != at
    }
    n_lost += int(np.sum(~known))
    remark = f"{counted(n_lost, 'row')} left out, incomplete or without a time" if n_lost else ""
    stated = {column: unit for column, unit in units.items() if unit and column in values}
    return _SensorRows(Table(path, name, values, t[known], remark=remark, units=stated), lines)


def _cell_seconds(cell: str) -> float:
    """Return the time in a FlySight cell: UTC [s since 1970] or time since power-on [s]; NaN for another text.

    A date and time without a zone is UTC.
    """
    try:
        return float(cell)
    except ValueError:
        pass
    try:
        moment = datetime.fromisoformat(cell)
    except ValueError:
        return math.nan
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _cell_number(cell: str) -> float:
    """Return the number in a cell of a FlySight file; NaN if the cell is not a number."""
    try:
        return float(cell)
    except ValueError:
        return math.nan


def _move_to_utc(sensors: list[_SensorRows]) -> None:
    """Convert the times since power-on of FlySight sensors to UTC, in place.

    The TIME rows have both times and give the conversion; those whose difference is far from the median (1 s plus 1 ms
    per s of recording) are not used. Without them the first sensor with UTC (the position fixes) and the rows of the
    other sensor before its rows give an offset, with a remark. Without such rows the times are not changed.
    """
    clock = next(
        (sensor for sensor in sensors if sensor.table.topic == _CLOCK and {"tow", "week"} <= set(sensor.table.names)),
        None,
    )
    fixes = next((sensor for sensor in sensors if sensor.has_utc), None)
    on_device_clock = [
        sensor for sensor in sensors if sensor.table.topic != _CLOCK and len(sensor.t) and not sensor.has_utc
    ]
    if clock is not None:
        delay = gps_seconds(clock.table.columns["week"], clock.table.columns["tow"]) - clock.t
        good = np.isfinite(delay) & (np.abs(delay - np.nanmedian(delay)) < 1.0 + _LARGEST_DRIFT * np.ptp(clock.t))
        if good.any():
            for sensor in on_device_clock:
                sensor.table.t = _on_other_clock(sensor.t, clock.t[good], delay[good])
            return
    if fixes is None:
        return
    for sensor in on_device_clock:
        before = np.searchsorted(sensor.lines, fixes.lines) - 1  # the last row of the sensor before each fix
        delay = fixes.t - sensor.t[before]
        if not np.any(before >= 0):
            continue
        sensor.table.t = sensor.t + np.max(delay[before >= 0])
        moved = "times are converted to UTC by the fixes between the rows, accurate to one row"
        sensor.table.remark = "; ".join(part for part in (sensor.table.remark, moved) if part)


def _on_other_clock(t: Column, known: Column, delay: Column) -> Column:
    """Convert times `t` (n,) [s] to another clock by a straight line through the measured differences of both clocks.

    The differences `delay` (m,) [s], other clock minus clock of `t`, were measured at the times `known` (m,) of the
    clock of `t`. The line is their least-squares fit; the caller has removed outliers. Only their median is added if
    there are fewer than three of them, or all are of one time.
    """
    if len(known) < 3 or np.ptp(known) == 0.0:
        return np.asarray(t + np.median(delay))
    rate, offset = np.polyfit(known - known[0], delay, 1)
    return np.asarray(t + offset + rate * (t - known[0]))
