"""Reader of MATLAB files (version 5 to 7.3) and Parquet files: tables whose columns have the same length."""

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
WIDEST = 16  # columns; a wider matrix is not data of signals


def read_matlab(path: Path, options: SourceOptions) -> list[Table]:
    """Read the vectors and matrices of numbers of a MATLAB file.

    Parameters
    ----------
    path
        The file.
    options
        Not used.

    Returns
    -------
    list of Table
        One table for each topic (name of a table) and each length of columns above 1. Tables of a single signal with
        equal times are merged into one. The remark of the first table lists the objects that cannot be read.

    Raises
    ------
    SeatrialError
        If the file cannot be read, contains no vectors of numbers, or needs a package that is not installed.

    Notes
    -----
    Variables of the workspace have the topic "". The fields of a struct, table, timetable or timeseries have its name
    as their topic. For nested structs the names of the inner structs stand before the name of the column, separated by
    dots. The signals of a Simulink structure with time have their labels as names.
    """
    left_out: list[str] = []
    groups: dict[tuple[str, int], dict[str, Column]] = {}
    units: dict[str, dict[str, str]] = {}
    seconds: dict[str, set[str]] = {}
    try:
        for name, value in _workspace_variables(path):
            for vector in vectors(name, value, left_out):
                for column_name, column in _vector_columns(vector):
                    groups.setdefault((vector.topic, len(column)), {})[column_name] = column
                    if vector.unit:
                        units.setdefault(vector.topic, {})[column_name] = vector.unit
                    if vector.is_time:
                        seconds.setdefault(vector.topic, set()).add(column_name)
    except SeatrialError as error:
        if str(path) in str(error) or isinstance(error.__cause__, ModuleNotFoundError):
            raise
        raise SeatrialError(f"{path}: {error}") from error
    except Exception as error:  # scipy and h5py raise many kinds of errors for a damaged file or another format
        raise SeatrialError(
            f"{path}: cannot be read as a MATLAB file: {' '.join(str(error).split())}; save it again with MATLAB"
        ) from error
    tables = [
        Table(
            path,
            topic,
            columns,
            units={name: unit for name, unit in units.get(topic, {}).items() if name in columns},
            seconds=frozenset(seconds.get(topic, set()) & set(columns)),
            lengths={c: m for (other, m), found in groups.items() if other == topic and m != n for c in found},
        )
        for (topic, n), columns in groups.items()
        if n > 1
    ]
    if not tables:
        raise SeatrialError(
            f"{path}: contains no vectors of numbers; objects (timetable, timeseries, datetime) are read only from "
            "files of version 7.3: save('run.mat', 'TT', '-v7.3'); or save their columns as vectors, for example "
            "t = seconds(TT.Time); x = TT.x; save('run.mat', 't', 'x')"
        )
    tables = _merged_by_times(path, tables)
    if left_out:
        tables[0].remark = f"left out, of a class that cannot be read: {', '.join(left_out)}; save them as numbers"
    return tables


def _merged_by_times(path: Path, tables: Sequence[Table]) -> list[Table]:
    """Merge tables that have a time and a single signal into one table if their times are equal, and return all tables.

    The signal must have the name of the topic, and the time the name "time" in small or capital letters. The merged
    table has the topic "" and comes after the other tables. Simulink's To Workspace blocks write one variable for each
    signal. Only signals of one table, as x and y, are recognised as a position.
    """
    by_times: dict[bytes, list[Table]] = {}
    for table in tables:
        signals = [name for name in table.names if name.lower() != "time"]
        if signals == [table.topic] and len(table.names) == 2:
            by_times.setdefault(table.numbers(table.names[0]).tobytes(), []).append(table)
    merged = {id(single) for group in by_times.values() if len(group) > 1 for single in group}
    found = [table for table in tables if id(table) not in merged]
    for group in by_times.values():
        if len(group) > 1:
            columns = {name: single.columns[name] for single in group for name in single.columns}
            units = {name: unit for single in group for name, unit in single.units.items()}
            found.append(Table(path, "", columns, units=units, seconds=group[0].seconds))
    return found


def _vector_columns(vector: Vector) -> Iterator[tuple[str, Column]]:
    """Yield name and values (n,) of a MATLAB vector, or of each column of a matrix M: M[0], M[1], ...

    Time runs along the longer side of a matrix, and along the first axis of a square one. Axes of length 1 are removed.
    A matrix of more than 16 columns, or an array of more dimensions, yields nothing.
    """
    array = np.atleast_1d(np.squeeze(vector.values)).astype(np.float64)
    if array.ndim == 1:
        yield vector.name, array
    elif array.ndim == 2 and min(array.shape) <= WIDEST:
        long = array if array.shape[0] >= array.shape[1] else array.T
        for k in range(long.shape[1]):
            yield f"{vector.name}[{k}]", long[:, k]


def _workspace_variables(path: Path) -> Iterator[tuple[str, Any]]:
    """Yield the name and the value of each variable of a MATLAB file, as Python values.

    Raise SeatrialError if the package for this version of file is not installed, or if a file of version 7.3 has links
    or data in other files (`refuse_data_of_other_files`). Names that begin with two underscores are skipped in files
    before version 7.3. An object in such a file is yielded without its properties, because scipy cannot read it.
    """
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
        warnings.simplefilter("ignore")  # scipy warns about objects that it cannot read; a remark lists them
        workspace = loadmat(path, squeeze_me=True, struct_as_record=True)
    for name, value in workspace.items():
        if type(value).__name__ == "MatlabOpaque":  # scipy keeps only one object of the file, without its name
            yield str(name), MatlabObject("version 7: save it with '-v7.3'", {})
        elif not name.startswith("__"):
            yield name, scipy_value(value)


def read_parquet(path: Path, options: SourceOptions) -> list[Table]:
    """Read the columns of numbers, times and text of a Parquet file as one table.

    Parameters
    ----------
    path
        The file.
    options
        Not used.

    Returns
    -------
    list of Table
        One table, in a list. Dates are in s since 1970, times of day in s since midnight, durations in s. A truth value
        is 0 or 1. An empty cell is NaN, in a column of text "". A remark lists the columns of other types, which are
        left out.

    Raises
    ------
    SeatrialError
        If the file cannot be read, or pyarrow is not installed.
    """
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
                columns[name] = _seconds_of_column(pyarrow, column)
                seconds.add(name)
            # safe=False: whole numbers above 2^53, as ns since 1970, are rounded (to 256 ns) instead of refused.
            elif types.is_floating(kind) or types.is_integer(kind) or types.is_boolean(kind) or types.is_decimal(kind):
                columns[name] = np.asarray(column.cast(pyarrow.float64(), safe=False).to_numpy(zero_copy_only=False))
            else:
                left_out.append(f"{name} ({kind})")
    except Exception as error:  # pyarrow raises many kinds of errors for a damaged file or another format
        raise SeatrialError(
            f"{path}: cannot be read as Parquet: {' '.join(str(error).split())}; write the file again"
        ) from error
    advice = "write them as columns of numbers"
    remark = f"left out, of a type that cannot be read: {', '.join(left_out)}; {advice}" if left_out else ""
    return [Table(path, "", columns, remark=remark, texts=texts, seconds=frozenset(seconds))]


def _seconds_of_column(pyarrow: Any, column: Any) -> Column:
    """Convert a pyarrow column of dates (s since 1970), times of day (s since midnight) or durations to s, shape (n,).

    An empty cell becomes NaN. `pyarrow` is the imported module.
    """
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
