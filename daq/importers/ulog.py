"""Reader of PX4 logs (.ulg): a table for each topic. PX4 has seatrial's axes: NED and forward, starboard, down."""

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
MOST_RECORD = 65538  # bytes of the largest record
MOST_COLUMNS = 200_000  # columns of all topics; logs of PX4 have some thousands
DEEPEST_FORMAT = 30  # deepest nesting of formats; PX4 uses two levels
FIELD = re.compile(r"\s*([^\[\s]+)(?:\[(\d{1,9})\])?")  # type and length of an array
FIX_2D = 2  # sensor_gps.fix_type


def read_ulog(path: Path, options: SourceOptions) -> list[Table]:
    """Read the topics of a PX4 log (.ulg) as tables.

    Parameters
    ----------
    path
        The log.
    options
        `topics`: the topics to read; all topics if empty.

    Returns
    -------
    list of Table
        One table for each topic; the second instance of a topic is TOPIC_1. Topics with gps in their name are always
        read. Times are in UTC [s since 1970] by the first fix. In a log without a fix they are the time since the start
        of the autopilot [s]. Positions of fixes below 2D are NaN. Rows are in the order of their times; a remark counts
        damaged places, whose records are left out.

    Raises
    ------
    SeatrialError
        If the log cannot be read, or the package pyulog is not installed.
    """
    try:
        from pyulog import ULog
    except ModuleNotFoundError as error:
        raise SeatrialError(_PYULOG) from error
    try:
        whole = path.read_bytes()
        raw, n_torn = whole_records(whole)
        _require_few_columns(whole if raw is None else raw)
        with (
            _LimitedFile(path) if raw is None else io.BytesIO(raw) as file
        ):  # pyulog does not close a file that it cannot read
            data = ULog(file).data_list
    except Exception as error:  # pyulog raises many kinds of errors for a damaged file or another format
        raise SeatrialError(
            f"{path}: cannot be read as a PX4 log: {' '.join(str(error).split())}; give the original .ulg file"
        ) from error
    remark = f"{counted(n_torn, 'damaged place')}: the records there are left out" if n_torn else ""
    tables = []
    for dataset in data:
        topic = f"{dataset.name}_{dataset.multi_id}" if dataset.multi_id else dataset.name
        if options.topics and topic not in options.topics and "gps" not in topic:
            continue
        if "timestamp" not in dataset.data:  # damaged: every topic of PX4 has a timestamp
            continue
        columns = {name: np.asarray(values, np.float64) for name, values in dataset.data.items() if name != "timestamp"}
        if "fix_type" in columns:
            for name in {"lat", "lon", "latitude_deg", "longitude_deg"} & set(columns):
                columns[name] = np.where(columns["fix_type"] < FIX_2D, np.nan, columns[name])
        remarks = "; ".join(part for part in (stopped_motors(dataset.name, columns), remark) if part)
        order = np.argsort(dataset.data["timestamp"], kind="stable")
        t = 1e-6 * np.asarray(dataset.data["timestamp"], np.float64)
        tables.append(
            Table(path, topic, {n: c[order] for n, c in columns.items()}, t[order], dataset.name, remark=remarks)
        )
    offset = _utc_offset(tables)
    vehicle = next((int(t.columns["system_type"][-1]) for t in tables if "system_type" in t.columns), None)
    for table in tables:
        assert table.t is not None
        table.vehicle = vehicle
        table.t = table.t + offset
    return tables


def _require_few_columns(raw: bytes) -> None:
    """Raise SeatrialError if the message formats in a PX4 log make more than 200,000 columns (`MOST_COLUMNS`).

    `raw` are the bytes of the log. A format may contain other formats, and a subscription makes columns of all nested
    fields. A damaged or malicious log of some kilobytes could make columns that take gigabytes and hours.
    """
    formats: dict[str, list[tuple[str, int]]] = {}  # type and array length of each field
    columns: dict[str, float] = {}  # number of columns of each format
    total, place = 0.0, HEADER

    def columns_of(name: str, depth: int = 0) -> float:
        """Return the number of columns of a message format in the PX4 log; infinite if the format contains itself.

        Formats that are nested more than 30 deep give infinity too. A name without a format is a single number. `depth`
        is the number of formats around it.
        """
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
            raise SeatrialError(f"its formats define more than {MOST_COLUMNS} columns")
        place += RECORD.size + size


def whole_records(raw: bytes) -> tuple[bytes | None, int]:
    """Remove torn records from the bytes of a PX4 log (.ulg).

    A record is complete if another record, a record that the end of the file cuts off, or the end of the file follows
    it. A torn record has the right size, but a part of its data belongs to a later place, so that no header follows it.

    Parameters
    ----------
    raw
        The bytes of the log.

    Returns
    -------
    tuple
        The remaining bytes, None if no record is torn; and the number of damaged places. A log with appended data is
        not changed: None and 0.
    """
    sizes: dict[int, int] = {}  # bytes of the data of each subscription, by its number

    def end_of(place: int) -> int:
        """Return the end [bytes] of the PX4 log record at the offset `place`; -1 if no record can begin there.

        That is so for an unknown type, a size of 0, an end beyond the file, or data of another size than the topic's
        before.
        """
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
        # In a log that was cut off, the last record has no end. The record before it is still complete.
        cut_off = end > 0 and len(raw) - end < MOST_RECORD and _continues_beyond_end(raw, end)
        if end > 0 and (end == len(raw) or end_of(end) > 0 or cut_off):
            if raw[place + 2] == ord("D"):
                sizes.setdefault(int.from_bytes(raw[place + 3 : place + 5], "little"), end - place - RECORD.size)
            if raw[place + 2] == ord("B") and any(raw[place + 19 : place + 43]):
                return None, 0  # appended data are at offsets from the begin of the file, so no bytes can be removed
            kept.append(raw[place:end])
            place = end
            continue
        place += 1
        while place < len(raw) and not is_chain(place, len(raw), end_of):
            place += 1
        n_torn += place < len(raw)  # otherwise the log was cut off here
    return (b"".join(kept), n_torn) if n_torn else (None, 0)


def _continues_beyond_end(raw: bytes, place: int) -> bool:
    """Return whether the PX4 log record at the offset `place` [bytes] continues beyond the end of the file.

    This is also true if the file ends within the header of the record. `raw` are the bytes of the log.
    """
    if place + RECORD.size > len(raw):
        return True
    size, kind = RECORD.unpack_from(raw, place)
    return kind in TYPES and place + RECORD.size + size > len(raw)


class _LimitedFile(io.BufferedReader):
    """File to read that raises SeatrialError if more bytes than 100 times its size plus 16 MiB are read from it.

    A reader of a damaged file could otherwise read the same bytes again without end.
    """

    def __init__(self, path: Path) -> None:
        """Open the file, and set how many bytes may be read: 100 times its size plus 16 MiB."""
        super().__init__(io.FileIO(path))
        self._bytes_left = 100 * path.stat().st_size + (16 << 20)

    def read(self, size: int | None = -1, /) -> bytes:
        """Read up to `size` bytes of the file; all for -1 or None.

        Raise SeatrialError if all reads together exceed 100 times the size of the file plus 16 MiB. Each read counts 16
        bytes more.
        """
        data = super().read(size)
        self._bytes_left -= len(data) + 16
        if self._bytes_left < 0:
            raise SeatrialError("too much of the file is damaged")
        return data


def _utc_offset(tables: list[Table]) -> float:
    """Return UTC minus the time since the start of the autopilot [s], by the first fix with a UTC in a PX4 log.

    `tables` are the topics of the log. The result is 0 if no topic with gps in its name has a UTC. The first topic with
    a UTC is used.
    """
    for table in tables:
        utc: Column | None = table.columns.get("time_utc_usec") if "gps" in table.topic else None
        if utc is not None and table.t is not None and (utc > 0).any():
            first = int(np.argmax(utc > 0))
            return float(1e-6 * utc[first] - table.t[first])
    return 0.0
