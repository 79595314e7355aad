"""Export of logs for `seatrial export`: the tables as CSV or Parquet files, or one resampled table."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.daq.files import new_file, require_new
from seatrial.daq.log import Log, LogTable, Resampled, log_tables, resample, unused_name
from seatrial.daq.samples import Scalar

CSV_BATCH_ROWS = 65536  # rows of CSV that are written at a time
DEFAULT_RATE_HZ = 10.0  # Hz, default for file formats with one table only


def export_log(log: Log, form: str, folder: Path, force: bool = False, zero: float = 0.0) -> list[Path]:
    """Write the samples of each device and kind in a log to a file of their own, and the events to events.csv.

    Numbers are written with all their digits. Unknown values are empty cells in CSV and NaN in Parquet. Times are
    seconds since 1970 or since `zero`, except t_device, the time by the clock of the device. The events are a CSV file
    in both formats; without events there is no such file. If a file cannot be written, those written before stay.

    Parameters
    ----------
    log
        The log.
    form
        "csv" or "parquet". For other formats of `export_resampled` one table, resampled at 10 Hz, is written.
    folder
        Folder of the files.
    force
        Whether existing files may be replaced.
    zero
        Time from which the times in the files count [s since 1970].

    Returns
    -------
    list
        The written files.

    Raises
    ------
    SeatrialError
        If the log has neither samples nor events, if a file exists already or cannot be written, or if a package is not
        installed. For other formats than CSV and Parquet also if the log has only events.
    """
    if form not in ("csv", "parquet"):
        return [export_resampled(log, form, folder, DEFAULT_RATE_HZ, force, zero)]
    write = _write_csv_table if form == "csv" else _parquet_writer()
    written: list[Path] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for part in log_tables(log):
            path = _new_path(folder, part.name, form, written, force)
            with new_file(path, force) as scratch:
                write(scratch, _counted_from(zero, part))
            written.append(path)
        if events := log.events():
            path = _new_path(folder, "events", "csv", written, force)
            with new_file(path, force) as scratch:
                rows = ([repr(t - zero if zero else t), kind, text] for t, kind, text in events)
                _write_csv_rows(scratch, ["t [s]", "kind", "text"], rows)
            written.append(path)
    except OSError as error:
        raise SeatrialError(
            f"{error.filename or folder}: cannot be written: {error.strerror}; give another folder with -o"
        ) from error
    if not written:
        raise SeatrialError(f"{log.path}: the log has no samples to export; `seatrial info` shows its content")
    return written


def export_resampled(log: Log, form: str, folder: Path, rate: float, force: bool = False, zero: float = 0.0) -> Path:
    """Write the whole log as one resampled table, and return the file.

    Commands, states and other held values keep the last sample. Other quantities are averaged over the samples nearest
    to each time, and the averages are interpolated linearly to the times. They are NaN in long gaps (`resample`).

    Times are seconds since 1970 or since `zero`: ``t`` in CSV, Parquet and MATLAB, the coordinate ``time`` in NetCDF.
    The units are in the column heads of CSV, the metadata of the columns of Parquet, the struct ``units`` of MATLAB,
    and the attributes of NetCDF.

    Parameters
    ----------
    log
        The log.
    form
        "csv", "parquet", "mat" or "netcdf".
    folder
        Folder of the file. The file has the name of the log.
    rate
        Rate of the table [Hz].
    force
        Whether an existing file may be replaced.
    zero
        Time from which the times in the file count [s since 1970].

    Raises
    ------
    SeatrialError
        If the log has no samples, the file exists already or cannot be written, or a package is not installed.
    """
    table = resample(log, rate)
    table = table._replace(t=table.t - zero) if zero else table
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path = _new_path(folder, log.path.stem, {"netcdf": "nc"}.get(form, form), [], force)
        with new_file(path, force) as scratch:
            if form in ("csv", "parquet"):
                (_write_csv_table if form == "csv" else _parquet_writer())(scratch, _as_log_table(table, path.stem))
            elif form == "mat":
                _write_mat(scratch, table)
            else:
                _write_netcdf(scratch, table, log.metadata, zero)
    except OSError as error:
        raise SeatrialError(
            f"{error.filename or folder}: cannot be written: {error.strerror}; give another folder with -o"
        ) from error
    return path


def _counted_from(zero: float, part: LogTable) -> LogTable:
    """Return a table of a log with its times t and t_rx from `zero` [s since 1970]; 0: the table itself."""
    if not zero:
        return part
    rows = part.rows.copy()
    for name in ("t", "t_rx"):
        rows[name] -= zero
    return part._replace(rows=rows)


def _as_log_table(table: Resampled, name: str) -> LogTable:
    """Convert a resampled log to one table with its times as the column ``t`` [s since 1970].

    A signal with the name t becomes ``t_``, with further underscores if there are signals of such names.
    """
    names = {name: unused_name(name, ("t", *table.columns)) if name == "t" else name for name in table.columns}
    columns = {"t": table.t, **{names[name]: values for name, values in table.columns.items()}}
    rows = np.empty(len(table.t), [(name, np.float64) for name in columns])
    for column, values in columns.items():
        rows[column] = values
    units = {"t": "s", **{names[name]: unit for name, unit in table.units.items()}}
    return LogTable(name, Scalar, rows, units, False)


def _write_mat(path: Path, table: Resampled) -> None:
    """Write a resampled log as a MATLAB file: time t [s since 1970], a vector for each column, and the struct units.

    The struct has the unit of each column as text, "1" for a number without a unit. Names that MATLAB does not allow
    are changed (`_variable_names`). Raise SeatrialError if scipy is not installed.
    """
    try:
        from scipy.io import savemat
    except ModuleNotFoundError as error:
        raise SeatrialError("MATLAB files need the package scipy: pip install 'seatrial[matlab]'") from error

    names = _variable_names(table.columns, 63)  # the longest name in MATLAB
    columns = {names[name]: values for name, values in table.columns.items()}
    units = {names[name]: unit or "1" for name, unit in table.units.items()}
    savemat(path, {"t": table.t, **columns, "units": units}, long_field_names=True, oned_as="column", appendmat=False)


def _write_netcdf(path: Path, table: Resampled, metadata: Mapping[str, str], zero: float) -> None:
    """Write a resampled log as a NetCDF file with the dimension time [s] and a variable for each column.

    The attribute `units` of the time states `zero` [s since 1970], from which it counts.
    The attribute `units` of a variable is its unit, "1" for a number without a unit. The attribute `source` of the file
    is "seatrial" with the version in the `metadata` of the log, if they have one. Names that NetCDF does not allow are
    changed (`_variable_names`). Raise SeatrialError if scipy is not installed.
    """
    try:
        from scipy.io import netcdf_file
    except ModuleNotFoundError as error:
        raise SeatrialError("NetCDF needs the package scipy: pip install 'seatrial[matlab]'") from error

    names = _variable_names(table.columns, 255)
    with netcdf_file(path, "w") as file:
        file.source = f"seatrial {metadata.get('seatrial', '')}".strip()
        file.createDimension("time", len(table.t))
        time = file.createVariable("time", "d", ("time",))
        origin = datetime.fromtimestamp(zero, UTC).isoformat(sep=" ").removesuffix("+00:00")
        time[:], time.units = table.t, f"seconds since {origin}"
        for name, values in table.columns.items():
            variable = file.createVariable(names[name], "d", ("time",))
            variable[:], variable.units = values, table.units[name] or "1"


def _variable_names(names: Iterable[str], longest: int) -> dict[str, str]:
    """Return valid and unique names of MATLAB or NetCDF variables, by name of the column.

    A valid name has at most `longest` characters. Characters other than letters, digits and underscores become
    underscores. A name that does not begin with a letter gets s_ in front. A longer name is cut at its end. A name that
    then repeats an earlier one, or is t, time or units, gets a number at its end, such as _2.
    """
    found: dict[str, str] = {}
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
        plain = (plain if plain[:1].isalpha() else f"s_{plain}")[:longest]
        number = 1
        while plain in (*found.values(), "t", "time", "units"):
            number += 1
            plain = f"{plain[: longest - 4]}_{number}"
        found[name] = plain
    return found


def _new_path(folder: Path, name: str, ending: str, written: list[Path], force: bool) -> Path:
    """Return the path of a new file of an export: NAME.ENDING, or the first of NAME-2.ENDING, ... not in `written`.

    The file is in `folder`.

    `written` are the files of this export so far; the path is not added to them, and no file is created. Characters
    other than letters, digits, _ and - become _, because names in a log from a stranger may contain separators. An
    empty name becomes "table". Raise SeatrialError if the file exists already and `force` is false, or if it is a link
    or special file.
    """
    stem = re.sub(r"[^A-Za-z0-9_-]", "_", name) or "table"
    path = folder / f"{stem}.{ending}"
    number = 1
    while path in written:
        number += 1
        path = folder / f"{stem}-{number}.{ending}"
    require_new(path, force, "--out")
    return path


def _write_csv_table(path: Path, part: LogTable) -> None:
    """Write a table of a log as the CSV file `path`, with units in the heads of the columns and empty cells for NaN.

    A head is "NAME [UNIT]", or NAME for a column without a unit. Numbers are written with all their digits.
    """
    names = list(part.rows.dtype.names or ())
    heads = [f"{name} [{part.units[name]}]" if part.units.get(name) else name for name in names]
    rows = (
        row for at in range(0, len(part.rows), CSV_BATCH_ROWS) for row in part.rows[at : at + CSV_BATCH_ROWS].tolist()
    )
    _write_csv_rows(path, heads, (["" if value != value else repr(value) for value in row] for row in rows))


def _write_csv_rows(path: Path, heads: list[str], rows: Iterator[list[str]]) -> None:
    """Write the CSV file `path` in UTF-8: a line with the heads of the columns, then the rows (text of each cell)."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(heads)
        writer.writerows(rows)


def _parquet_writer() -> Callable[[Path, LogTable], None]:
    """Return a function that writes a table of a log as a Parquet file.

    Raise SeatrialError if pyarrow is not installed.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ModuleNotFoundError as error:
        raise SeatrialError("Parquet needs the package pyarrow: pip install 'seatrial[parquet]'") from error

    def write(path: Path, part: LogTable) -> None:
        """Write a table of a log as a Parquet file, with the unit of each column in its metadata.

        Integers become int64, and all other numbers float64. A column without a unit has the empty unit. NaN stays NaN.
        """
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
