"""MATLAB files (version 5 to 7.3) and Parquet -> tables of columns of one length."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.matlab_values import Hdf5Variables, MatlabObject, Vector, scipy_value, vectors
from seatrial.daq.importers.own_hdf5 import refuse_data_of_other_files
from seatrial.daq.importers.table import Column, SourceOptions, Table

_SCIPY = "MATLAB files need the package scipy: pip install 'seatrial[matlab]'"
_H5PY = "MATLAB files of version 7.3 need the package h5py: pip install 'seatrial[matlab]'"
_PYARROW = "Parquet needs the package pyarrow: pip install 'seatrial[parquet]'"
WIDEST = 16  # columns of a matrix that are taken


def read_matlab(path: Path, options: SourceOptions) -> list[Table]:
    """Read vectors and matrices of numbers.

    Those of the workspace have no topic. Those of a struct, a table, a timetable or a timeseries have its name; those
    of nested structs have the names of these, with dots, before their own. The signals of a Simulink structure with
    time have their labels. Columns of one length make a table. Raises SeatrialError.
    """
    left_out: list[str] = []
    groups: dict[tuple[str, int], dict[str, Column]] = {}
    units: dict[str, dict[str, str]] = {}
    seconds: dict[str, set[str]] = {}
    try:
        for name, value in _workspace(path):
            for one in vectors(name, value, left_out):
                for called, column in _columns(one):
                    groups.setdefault((one.topic, len(column)), {})[called] = column
                    if one.unit:
                        units.setdefault(one.topic, {})[called] = one.unit
                    if one.is_time:
                        seconds.setdefault(one.topic, set()).add(called)
    except SeatrialError:
        raise
    except Exception as error:  # scipy and h5py have errors of many kinds for a file that is none, or damaged
        raise SeatrialError(f"{path}: cannot be read as a MATLAB file: {' '.join(str(error).split())}") from error
    tables = [
        Table(
            path,
            topic,
            columns,
            units={name: unit for name, unit in units.get(topic, {}).items() if name in columns},
            seconds=frozenset(seconds.get(topic, set()) & set(columns)),
        )
        for (topic, n), columns in groups.items()
        if n > 1
    ]
    if not tables:
        raise SeatrialError(
            f"{path}: holds no vectors of numbers; objects (timetable, timeseries, datetime) are read from files of "
            "version 7.3: save('run.mat', 'TT', '-v7.3'); or save their columns as vectors, e.g. "
            "t = seconds(TT.Time); x = TT.x; save('run.mat', 't', 'x')"
        )
    tables = _together(path, tables)
    if left_out:
        tables[0].remark = f"of a class that is not read: {', '.join(left_out)}"
    return tables


def _together(path: Path, tables: Sequence[Table]) -> list[Table]:
    """Put variables with one signal each, as Simulink's To Workspace blocks write them, into a table if their times are
    the same: x and y are a position then."""
    alone: dict[bytes, list[Table]] = {}
    for table in tables:
        others = [name for name in table.names if name.lower() != "time"]
        if others == [table.topic] and len(table.names) == 2:
            alone.setdefault(table.numbers(table.names[0]).tobytes(), []).append(table)
    merged = {id(one) for group in alone.values() if len(group) > 1 for one in group}
    found = [table for table in tables if id(table) not in merged]
    for group in alone.values():
        if len(group) > 1:
            columns = {name: one.columns[name] for one in group for name in one.columns}
            units = {name: unit for one in group for name, unit in one.units.items()}
            found.append(Table(path, "", columns, units=units, seconds=group[0].seconds))
    return found


def _columns(one: Vector) -> Iterator[tuple[str, Column]]:
    """Yield the columns of a vector or of a matrix that is not too wide."""
    array = np.atleast_1d(np.squeeze(one.values)).astype(np.float64)
    if array.ndim == 1:
        yield one.name, array
    elif array.ndim == 2 and min(array.shape) <= WIDEST:
        long = array if array.shape[0] >= array.shape[1] else array.T
        for k in range(long.shape[1]):
            yield f"{one.name}[{k}]", long[:, k]


def _workspace(path: Path) -> Iterator[tuple[str, Any]]:
    """Yield the variables of a file by name, as Python values."""
    with path.open("rb") as file:
        head = file.read(520)
    if b"\x89HDF" in head:
        try:
            import h5py
        except ModuleNotFoundError as error:
            raise SeatrialError(_H5PY) from error
        with h5py.File(path) as file:
            refuse_data_of_other_files(path, file)
            yield from Hdf5Variables(file).items()
        return
    try:
        from scipy.io import loadmat
    except ModuleNotFoundError as error:
        raise SeatrialError(_SCIPY) from error

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of objects that it cannot read; they are left out
        workspace = loadmat(path, squeeze_me=True, struct_as_record=True)
    for name, value in workspace.items():
        if type(value).__name__ == "MatlabOpaque":  # scipy keeps one of them, without its name
            yield str(name), MatlabObject("version 7: save it with '-v7.3'", {})
        elif not name.startswith("__"):
            yield name, scipy_value(value)


def read_parquet(path: Path, options: SourceOptions) -> list[Table]:
    """The columns of numbers, times and text; times are in s since 1970, those of a day since midnight, durations in s.
    A remark names what is none of these. Raises SeatrialError."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ModuleNotFoundError as error:
        raise SeatrialError(_PYARROW) from error
    columns: dict[str, Column] = {}
    texts: dict[str, list[str]] = {}
    seconds: set[str] = set()
    left_out: list[str] = []
    try:
        table = pyarrow.parquet.read_table(path)
        for name in table.column_names:
            column = table[name].combine_chunks()
            if pyarrow.types.is_dictionary(column.type):
                column = column.dictionary_decode()
            kind, types = column.type, pyarrow.types
            if types.is_string(kind) or types.is_large_string(kind):
                texts[name] = [text or "" for text in column.to_pylist()]
            elif types.is_temporal(kind) and not types.is_interval(kind):
                columns[name] = _seconds(pyarrow, column)
                seconds.add(name)
            # Not safe: whole numbers beyond 2^53, as ns since 1970, are rounded (to 256 ns), not refused.
            elif types.is_floating(kind) or types.is_integer(kind) or types.is_boolean(kind) or types.is_decimal(kind):
                columns[name] = np.asarray(column.cast(pyarrow.float64(), safe=False).to_numpy(zero_copy_only=False))
            else:
                left_out.append(f"{name} ({kind})")
    except Exception as error:  # pyarrow has errors of many kinds for a file that is none, or damaged
        raise SeatrialError(f"{path}: cannot be read as Parquet: {' '.join(str(error).split())}") from error
    remark = f"of a type that is not read: {', '.join(left_out)}" if left_out else ""
    return [Table(path, "", columns, remark=remark, texts=texts, seconds=frozenset(seconds))]


def _seconds(pyarrow: Any, column: Any) -> Column:
    """A column of dates, times or durations in s, (n,); NaN where a row has none."""
    kind, types = column.type, pyarrow.types
    if types.is_date(kind):
        column = column.cast(pyarrow.timestamp("ns"))
    elif types.is_time(kind):
        column = column.cast(pyarrow.time64("ns")).cast(pyarrow.int64())
    elif types.is_duration(kind):
        column = column.cast(pyarrow.duration("ns")).cast(pyarrow.int64())
    else:
        column = column.cast(pyarrow.timestamp("ns", kind.tz))
    if types.is_timestamp(column.type):
        column = column.cast(pyarrow.int64())
    missing = np.asarray(column.is_null().to_numpy(zero_copy_only=False), bool)
    return np.where(missing, np.nan, np.asarray(column.fill_null(0).to_numpy(zero_copy_only=False)) * 1e-9)
