"""Flight logs of PX4 (.ulg) -> a table for each topic. PX4's axes are ours: forward, starboard, down and north."""

from __future__ import annotations

import io
import re
import struct
from pathlib import Path

import numpy as np

from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.importers.damage import is_chain
from seatrial.daq.importers.missing_inputs import stopped_motors
from seatrial.daq.importers.table import Column, SourceOptions, Table

_PYULOG = "PX4 logs need the package pyulog: pip install 'seatrial[ulog]'"
HEADER = 16  # bytes of the file header
RECORD = struct.Struct("<HB")  # size of the data, type
TYPES = frozenset(b"BFIMPQALCDSOR")
MOST_RECORD = 65538  # bytes of a record
MOST_COLUMNS = 200_000  # of all topics; PX4 has some thousands
DEEPEST_FORMAT = 30  # of formats in formats; PX4 has two
FIELD = re.compile(r"\s*([^\[\s]+)(?:\[(\d{1,9})\])?")  # type and length of an array
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
        whole = path.read_bytes()
        raw, n_torn = whole_records(whole)
        _require_few_columns(whole if raw is None else raw)
        with _Bounded(path) if raw is None else io.BytesIO(raw) as file:  # pyulog does not close what it cannot read
            data = ULog(file).data_list
    except Exception as error:  # pyulog has errors of many kinds for a file that is none, or damaged
        raise SeatrialError(f"{path}: cannot be read as a PX4 log: {' '.join(str(error).split())}") from error
    remark = f"{counted(n_torn, 'damaged place')}: the records there are left out" if n_torn else ""
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
        remarks = "; ".join(part for part in (stopped_motors(one.name, columns), remark) if part)
        order = np.argsort(one.data["timestamp"], kind="stable")
        t = 1e-6 * np.asarray(one.data["timestamp"], np.float64)
        tables.append(Table(path, topic, {n: c[order] for n, c in columns.items()}, t[order], one.name, remark=remarks))
    offset = _utc_offset(tables)
    vehicle = next((int(t.columns["system_type"][-1]) for t in tables if "system_type" in t.columns), None)
    for table in tables:
        assert table.t is not None
        table.vehicle = vehicle
        table.t = table.t + offset
    return tables


def _require_few_columns(raw: bytes) -> None:
    """Raise SeatrialError where the formats of a log make more columns than any log has.

    A format may contain others, and a subscription makes columns of all that its format contains. Some kilobytes can
    make columns that take gigabytes and hours.
    """
    formats: dict[str, list[tuple[str, int]]] = {}  # type and number of each field
    columns: dict[str, float] = {}
    total, place = 0.0, HEADER

    def columns_of(name: str, depth: int = 0) -> float:
        if name not in formats:
            return 1.0  # a number
        if depth > DEEPEST_FORMAT:
            return float("inf")  # it contains itself
        if name not in columns:
            columns[name] = sum(count * columns_of(kind, depth + 1) for kind, count in formats[name])
        return columns[name]

    while place + RECORD.size <= len(raw):
        size, kind = RECORD.unpack_from(raw, place)
        data = raw[place + RECORD.size : place + RECORD.size + size]
        if kind == ord("F"):
            name, _, text = data.decode("utf-8", "replace").partition(":")
            fields = (FIELD.match(field) for field in text.split(";"))
            formats[name] = [(field[1], int(field[2] or 1)) for field in fields if field]
            columns.clear()
        elif kind == ord("A"):
            total += columns_of(data[3:].decode("utf-8", "replace"))
        if total > MOST_COLUMNS:
            raise SeatrialError(f"its formats make more than {MOST_COLUMNS} columns")
        place += RECORD.size + size


def whole_records(raw: bytes) -> tuple[bytes | None, int]:
    """Return the log without its torn records, and the number of damaged places.

    A record is whole if another record follows it, or the end of the file. Of a torn record the size is right but the
    data are in part those of a later place, so that the next header is not where it should be.

    Returns
    -------
    tuple
        The bytes, None if nothing has to be taken out; the number of damaged places.
    """
    sizes: dict[int, int] = {}  # of the data of each subscription, by its number

    def end_of(place: int) -> int:
        """The end of a record, -1 if no record can begin here."""
        if place + RECORD.size > len(raw):
            return -1
        size, kind = RECORD.unpack_from(raw, place)
        if not size or kind not in TYPES or place + RECORD.size + size > len(raw):
            return -1
        if kind == ord("D"):
            number = int.from_bytes(raw[place + 3 : place + 5], "little")
            if size != sizes.get(number, size):
                return -1
        return place + int(RECORD.size) + int(size)

    kept: list[bytes] = [raw[:HEADER]]
    place, n_torn = HEADER, 0
    while place < len(raw):
        end = end_of(place)
        # The last record of a log that was cut off has no end; nothing is wrong with the one before it.
        cut_off = end > 0 and len(raw) - end < MOST_RECORD and _is_cut(raw, end)
        if end > 0 and (end == len(raw) or end_of(end) > 0 or cut_off):
            if raw[place + 2] == ord("D"):
                sizes.setdefault(int.from_bytes(raw[place + 3 : place + 5], "little"), end - place - RECORD.size)
            if raw[place + 2] == ord("B") and any(raw[place + 19 : place + 43]):
                return None, 0  # data are appended at places that count from the beginning of the file
            kept.append(raw[place:end])
            place = end
            continue
        place += 1
        while place < len(raw) and not is_chain(place, len(raw), end_of):
            place += 1
        n_torn += place < len(raw)  # else the log was cut off here
    return (b"".join(kept), n_torn) if n_torn else (None, 0)


def _is_cut(raw: bytes, place: int) -> bool:
    """Whether the record that begins here goes on behind the end of the file."""
    if place + RECORD.size > len(raw):
        return True
    size, kind = RECORD.unpack_from(raw, place)
    return kind in TYPES and place + RECORD.size + size > len(raw)


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
