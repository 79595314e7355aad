"""`seatrial export`: the tables of a log as CSV or Parquet files, one per source."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.errors import SeatrialError
from daq.log import NODE_TOPICS, Log
from daq.samples import Ahrs, Autopilot, Battery, Command, Esc, Gnss, LoadCell, Scalar, Servo

UNITS = {  # of daq/samples.py, where they are explained
    "t": "s", "t_rx": "s", "t_device": "s", "utc": "s",
    "yaw": "rad", "pitch": "rad", "roll": "rad", "p": "rad/s", "q": "rad/s", "r": "rad/s",
    "ax": "m/s2", "ay": "m/s2", "az": "m/s2", "mx": "T", "my": "T", "mz": "T",
    "lat": "deg", "lon": "deg", "alt": "m", "vel_n": "m/s", "vel_e": "m/s", "vel_d": "m/s", "speed": "m/s",
    "sigma_h": "m", "rpm": "rev/min", "current": "A", "voltage": "V", "temperature": "degC", "force": "N", "pwm": "us",
}  # fmt: skip
ROWS = 65536  # written at a time
KINDS: tuple[type[Any], ...] = (Ahrs, Gnss, Esc, Command, Servo, LoadCell, Battery, Autopilot, Scalar)


class ExportTable(NamedTuple):
    """One table of a log: the name of its file without an ending, its rows, its units by column."""

    name: str
    rows: NDArray[np.void]
    units: dict[str, str]


def parts(log: Log) -> Iterator[ExportTable]:
    """Every table of samples, in the order of the kinds."""
    for kind in KINDS:
        for source in log.sources(kind):
            for node in log.nodes(kind, source) if kind in NODE_TOPICS else [None]:
                rows = log.table(kind, source, node)
                middle = "" if node is None else f"_{node}"
                name = source if kind is Scalar else f"{source}{middle}_{kind.__name__.lower()}"
                names = rows.dtype.names or ()
                units = {column: UNITS[column] for column in names if column in UNITS}
                if kind is Scalar:
                    units["value"] = log.unit(source)
                yield ExportTable(name, rows, units)


def export_log(log: Log, form: str, folder: Path, force: bool = False) -> list[Path]:
    """Write every table, and the events as events.csv, to `folder`; returns the files. Raises SeatrialError.

    `form` is "csv" or "parquet". Numbers are written with all their digits; what was not measured is an empty cell
    in CSV and NaN in Parquet. Times are seconds since 1970.
    """
    write = _csv if form == "csv" else _parquet()
    written: list[Path] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for part in parts(log):
            path = _new(folder, part.name, form, written, force)
            write(path, part)
            written.append(path)
        if events := log.events():
            path = _new(folder, "events", "csv", written, force)
            _write_csv(path, ["t [s]", "kind", "text"], ([repr(t), kind, text] for t, kind, text in events))
            written.append(path)
    except OSError as error:
        raise SeatrialError(f"{error.filename or folder}: cannot be written: {error.strerror}") from error
    if not written:
        raise SeatrialError(f"{log.path}: holds no samples to export")
    return written


def _new(folder: Path, name: str, ending: str, written: list[Path], force: bool) -> Path:
    """A path within `folder`, also for names of foreign logs with separators."""
    stem = re.sub(r"[^A-Za-z0-9_-]", "_", name) or "table"
    path = folder / f"{stem}.{ending}"
    number = 1
    while path in written:
        number += 1
        path = folder / f"{stem}-{number}.{ending}"
    if path.exists() and not force:
        raise SeatrialError(f"{path}: the file exists already; --force replaces it, --out names another folder")
    return path


def _csv(path: Path, part: ExportTable) -> None:
    names = list(part.rows.dtype.names or ())
    heads = [f"{name} [{part.units[name]}]" if part.units.get(name) else name for name in names]
    rows = (row for at in range(0, len(part.rows), ROWS) for row in part.rows[at : at + ROWS].tolist())
    _write_csv(path, heads, (["" if value != value else repr(value) for value in row] for row in rows))


def _write_csv(path: Path, heads: list[str], rows: Iterator[list[str]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(heads)
        writer.writerows(rows)


def _parquet() -> Callable[[Path, ExportTable], None]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ModuleNotFoundError as error:
        raise SeatrialError("Parquet needs the package pyarrow: pip install 'seatrial[parquet]'") from error

    def write(path: Path, part: ExportTable) -> None:
        fields = [
            pyarrow.field(
                name,
                pyarrow.int64() if part.rows.dtype[name].kind == "i" else pyarrow.float64(),
                metadata={"unit": part.units.get(name, "")},
            )
            for name in part.rows.dtype.names or ()
        ]
        columns = [pyarrow.array(np.ascontiguousarray(part.rows[field.name])) for field in fields]
        pyarrow.parquet.write_table(pyarrow.table(columns, schema=pyarrow.schema(fields)), path)

    return write
