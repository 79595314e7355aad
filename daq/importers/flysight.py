"""Text files of FlySight 2 (TRACK.CSV, SENSOR.CSV): columns and units by sensor, and rows that begin with its name.

Theory of operation. ``$COL,GNSS,time,lat,...`` names the columns of a sensor, ``$UNIT,GNSS,,deg,...`` their units, and
a row of it is ``$GNSS,2024-05-12T13:00:00.000Z,59.1,...``. Fixes have UTC. The other sensors count seconds since
power-on. ``$TIME,time,tow,week`` has such a time and the GPS time of the same instant, by which they are moved to UTC.
"""

from __future__ import annotations

import csv
import math
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from daq.errors import SeatrialError, counted
from daq.importers.row_times import gps_seconds
from daq.importers.table import Column, SourceOptions, Table

_TIME, _CLOCK = "time", "TIME"  # column of the time; sensor that has it with GPS time
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
    rows: dict[str, list[list[str]]] = {}
    n_lost: Counter[str] = Counter()
    try:
        with path.open(encoding="utf-8", errors="replace", newline="") as file:
            for cells in csv.reader(line.replace("\0", "") for line in file):
                word, sensor = cells[0] if cells else "", cells[1] if len(cells) > 1 else ""
                if word == "$COL":
                    columns[sensor] = [cell.strip() for cell in cells[2:]]
                elif word == "$UNIT":
                    units[sensor] = [cell.strip() for cell in cells[2:]]
                elif (name := word[1:]) in columns and word.startswith("$"):
                    if len(cells) - 1 == len(columns[name]):
                        rows.setdefault(name, []).append(cells[1:])
                    else:
                        n_lost[name] += 1  # a card that was full, or a battery that was empty
    except (OSError, csv.Error) as error:
        raise SeatrialError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    tables = [
        _table(
            path,
            name,
            columns[name],
            dict(zip(columns[name], units.get(name, ()), strict=False)),
            rows[name],
            n_lost[name],
        )
        for name in rows
        if _TIME in columns[name]
    ]
    if not tables:
        raise SeatrialError(f"{path}: no rows below the header")
    _move_to_utc(tables)
    return [table for table in tables if table.topic != _CLOCK] or tables


def _table(
    path: Path, name: str, columns: list[str], units: dict[str, str], rows: list[list[str]], n_lost: int
) -> Table:
    at = columns.index(_TIME)
    t = np.array([_seconds(row[at]) for row in rows])
    known = np.isfinite(t)
    values = {c: np.array([_number(row[k]) for row in rows])[known] for k, c in enumerate(columns) if c and k != at}
    n_lost += int(np.sum(~known))
    remark = f"{counted(n_lost, 'row')} without a time or not whole left out" if n_lost else ""
    stated = {column: unit for column, unit in units.items() if unit and column in values}
    return Table(path, name, values, t[known], remark=remark, units=stated)


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


def _move_to_utc(tables: list[Table]) -> None:
    """Move the times of the device's own clock to UTC, by the rows that have both; without these they stay."""
    clock = next((table for table in tables if table.topic == _CLOCK and {"tow", "week"} <= set(table.names)), None)
    if clock is None or clock.t is None:
        return
    utc = gps_seconds(clock.columns["week"], clock.columns["tow"])
    delay = utc - clock.t
    good = np.isfinite(delay) & (np.abs(delay - np.nanmedian(delay)) < 1.0 + _SLOWEST_RATE * np.ptp(clock.t))
    if not good.any():
        return
    for table in tables:
        if table.t is not None and table is not clock and len(table.t) and table.t[-1] < utc[good][0]:
            table.t = _moved(table.t, clock.t[good], delay[good])


def _moved(t: Column, known: Column, delay: Column) -> Column:
    """Times (n,) with the delay between the clocks, (m,) at the times known (m,), as a straight line through it."""
    if len(known) < 3 or np.ptp(known) == 0.0:
        return np.asarray(t + np.median(delay))
    rate, offset = np.polyfit(known - known[0], delay, 1)
    return np.asarray(t + offset + rate * (t - known[0]))
