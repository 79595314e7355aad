"""`seatrial import ulog`: a flight log of PX4 -> a log. PX4's axes are ours: forward, starboard, down and north."""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from daq.errors import SeatrialError, counted
from daq.importers.common import SignalRow, write_frames
from daq.log import schema
from daq.samples import NAN, Ahrs, Frame, Gnss, Scalar

_PYULOG = "PX4 logs need the package pyulog: pip install 'seatrial[ulog]'"
_FIXES = {0: 0, 1: 0, 2: 2, 3: 3, 4: 4, 5: 6, 6: 5}  # sensor_gps.fix_type -> Gnss.fix


def import_ulog(path: Path, *, out: Path | None = None, force: bool = False) -> tuple[Path, str]:
    """Import a .ulg file; returns the path of the log and a summary in one line.

    Attitude (vehicle_attitude, with the newest vehicle_angular_velocity) becomes Ahrs, the receiver's fixes Gnss;
    every number of the other topics is a signal, TOPIC_FIELD. Times are those of the autopilot, moved to UTC by its
    first fix where there is one, else they begin in 1970. Raises SeatrialError.
    """
    log = _read(path)
    data = {f"{d.name}_{d.multi_id}" if d.multi_id else d.name: d.data for d in log.data_list}
    offset = _utc_offset(data)
    rows: list[SignalRow] = []
    for name, columns in data.items():
        t = 1e-6 * np.asarray(columns["timestamp"], dtype=np.float64) + offset
        rows += list(_CONVERT.get(name, _signals)(name, columns, t, data))
    said = f"{counted(len(rows), 'sample')} of {counted(len(data), 'topic')}"
    target = out or Path(f"{path.stem}.mcap")
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    metadata = {"import": "ulog", "source.1.name": path.name, "source.1.sha256": sha256}
    write_frames(target, rows, metadata=metadata, note=f"{path.name}: {said}", force=force)
    return target, said


def _read(path: Path) -> Any:
    try:
        from pyulog import ULog
    except ModuleNotFoundError as error:
        raise SeatrialError(_PYULOG) from error
    try:
        with _Bounded(path) as file:  # it does not close what it cannot read
            return ULog(file)
    except Exception as error:  # pyulog has errors of many kinds for a file that is none, or damaged
        raise SeatrialError(f"{path}: cannot be read as a PX4 log: {' '.join(str(error).split())}") from error


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


def _utc_offset(data: dict[str, Any]) -> float:
    for name in ("sensor_gps", "vehicle_gps_position"):
        columns = data.get(name, {})
        for here, utc in zip(columns.get("timestamp", ()), columns.get("time_utc_usec", ()), strict=False):
            if utc > 0:
                return float(1e-6 * (int(utc) - int(here)))
    return 0.0


Columns = dict[str, Any]


def _attitude(name: str, columns: Columns, t: Any, data: dict[str, Columns]) -> Iterator[SignalRow]:
    w, x, y, z = (np.asarray(columns[f"q[{k}]"], dtype=np.float64) for k in range(4))
    yaw, pitch, roll = schema.angles(x, y, z, w)
    rates = data.get("vehicle_angular_velocity")
    pqr = np.full((3, len(t)), np.nan)
    if rates is not None and len(rates["timestamp"]):
        newest = np.searchsorted(rates["timestamp"], columns["timestamp"], side="right") - 1
        for k in range(3):
            pqr[k] = np.where(newest >= 0, np.asarray(rates[f"xyz[{k}]"])[np.maximum(newest, 0)], np.nan)
    for k in range(len(t)):
        sample = Ahrs(float(yaw[k]), float(pitch[k]), float(roll[k]), *(float(row[k]) for row in pqr))
        yield SignalRow(float(t[k]), name, Frame(sample, float(t[k]), NAN))


def _gnss(name: str, columns: Columns, t: Any, data: dict[str, Columns]) -> Iterator[SignalRow]:
    new = "latitude_deg" in columns  # PX4 1.14 and later; before: 1e-7 degrees and millimetres
    lat, lon = (np.asarray(columns["latitude_deg" if new else "lat"]) * (1.0 if new else 1e-7),
                np.asarray(columns["longitude_deg" if new else "lon"]) * (1.0 if new else 1e-7))  # fmt: skip
    alt = np.asarray(columns["altitude_msl_m"]) if new else 1e-3 * np.asarray(columns["alt"])
    for k in range(len(t)):
        north, east, down = (float(columns[f"vel_{axis}_m_s"][k]) for axis in "ned")
        sample = Gnss(
            float(1e-6 * columns["time_utc_usec"][k]) or NAN, float(lat[k]), float(lon[k]), float(alt[k]),
            north, east, down, _FIXES.get(int(columns["fix_type"][k]), 0), int(columns["satellites_used"][k]),
            float(columns["hdop"][k]), float(columns["eph"][k]) / 2.0**0.5,
        )  # fmt: skip
        yield SignalRow(float(t[k]), name, Frame(sample, float(t[k]), NAN))


def _signals(name: str, columns: Columns, t: Any, data: dict[str, Columns]) -> Iterator[SignalRow]:
    for field, values in columns.items():
        if field.startswith(("timestamp", "_padding")):
            continue
        signal = re.sub(r"[^A-Za-z0-9]+", "_", f"{name}_{field}").strip("_")
        for when, value in zip(t.tolist(), np.asarray(values, dtype=np.float64).tolist(), strict=True):
            yield SignalRow(when, signal, Frame(Scalar(value), when, NAN))


_CONVERT: dict[str, Callable[[str, Columns, Any, dict[str, Columns]], Iterator[SignalRow]]] = {
    "vehicle_attitude": _attitude, "sensor_gps": _gnss, "vehicle_gps_position": _gnss,
}  # fmt: skip
