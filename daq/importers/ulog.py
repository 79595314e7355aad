"""Flight logs of PX4 (.ulg) -> a table for each topic. PX4's axes are ours: forward, starboard, down and north."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from daq.errors import SeatrialError
from daq.importers.missing_inputs import stopped_motors
from daq.importers.table import Column, SourceOptions, Table

_PYULOG = "PX4 logs need the package pyulog: pip install 'seatrial[ulog]'"
FIX_2D = 2  # sensor_gps.fix_type


def read_ulog(path: Path, options: SourceOptions) -> list[Table]:
    """Its topics, the second instance of one as TOPIC_1. Raises SeatrialError.

    Times are those of the autopilot, moved to UTC by its first fix where there is one, else they begin in 1970.
    """
    try:
        from pyulog import ULog
    except ModuleNotFoundError as error:
        raise SeatrialError(_PYULOG) from error
    try:
        with _Bounded(path) as file:  # it does not close what it cannot read
            data = ULog(file).data_list
    except Exception as error:  # pyulog has errors of many kinds for a file that is none, or damaged
        raise SeatrialError(f"{path}: cannot be read as a PX4 log: {' '.join(str(error).split())}") from error
    tables = []
    for one in data:
        topic = f"{one.name}_{one.multi_id}" if one.multi_id else one.name
        if options.topics and topic not in options.topics and "gps" not in topic:
            continue
        if "timestamp" not in one.data:  # damaged: every topic of PX4 has one
            continue
        columns = {name: np.asarray(values, np.float64) for name, values in one.data.items() if name != "timestamp"}
        if "fix_type" in columns:
            for name in {"lat", "lon", "latitude_deg", "longitude_deg"} & set(columns):
                columns[name] = np.where(columns["fix_type"] < FIX_2D, np.nan, columns[name])
        remark = stopped_motors(one.name, columns)
        order = np.argsort(one.data["timestamp"], kind="stable")
        t = 1e-6 * np.asarray(one.data["timestamp"], np.float64)
        tables.append(Table(path, topic, {n: c[order] for n, c in columns.items()}, t[order], one.name, remark=remark))
    offset = _utc_offset(tables)
    vehicle = next((int(t.columns["system_type"][-1]) for t in tables if "system_type" in t.columns), None)
    for table in tables:
        assert table.t is not None
        table.vehicle = vehicle
        table.t = table.t + offset
    return tables


class _Bounded(io.BufferedReader):
    """A file of which only so much is read: on damage pyulog goes back by a message, and may do so for ever."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self._left = 100 * path.stat().st_size + (16 << 20)

    def read(self, size: int | None = -1, /) -> bytes:
        """As of any file. Raises SeatrialError beyond the bound."""
        data = super().read(size)
        self._left -= len(data) + 16
        if self._left < 0:
            raise SeatrialError("too much of it is damaged")
        return data


def _utc_offset(tables: list[Table]) -> float:
    for table in tables:
        utc: Column | None = table.columns.get("time_utc_usec") if "gps" in table.topic else None
        if utc is not None and table.t is not None and (utc > 0).any():
            first = int(np.argmax(utc > 0))
            return float(1e-6 * utc[first] - table.t[first])
    return 0.0
