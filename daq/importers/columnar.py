"""MATLAB files (version 5 to 7.3) and Parquet -> tables of columns of one length."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from daq.errors import SeatrialError
from daq.importers.own_hdf5 import refuse_data_of_other_files
from daq.importers.table import Column, SourceOptions, Table

_H5PY = "MATLAB files of version 7.3 need the package h5py: pip install 'seatrial[matlab]'"
_PYARROW = "Parquet needs the package pyarrow: pip install 'seatrial[parquet]'"
WIDEST = 16  # columns of a matrix that are taken


def read_matlab(path: Path, options: SourceOptions) -> list[Table]:
    """Vectors and matrices of numbers: those of the workspace without a topic, those of a struct under its name, with
    the names of nested structs and dots before their own. Columns of one length make a table. Raises SeatrialError.
    """
    try:
        values = dict(_workspace(path))
    except SeatrialError:
        raise
    except Exception as error:  # scipy and h5py have errors of many kinds for a file that is none, or damaged
        raise SeatrialError(f"{path}: cannot be read as a MATLAB file: {' '.join(str(error).split())}") from error
    groups: dict[tuple[str, int], dict[str, Column]] = {}
    for name, value in values.items():
        topic, _, field = name.rpartition("\0")
        array = np.atleast_1d(np.squeeze(value))
        if array.ndim == 1:
            groups.setdefault((topic, len(array)), {})[field] = array
        elif array.ndim == 2 and min(array.shape) <= WIDEST:
            long = array if array.shape[0] >= array.shape[1] else array.T
            for k in range(long.shape[1]):
                groups.setdefault((topic, len(long)), {})[f"{field}[{k}]"] = long[:, k]
    tables = [Table(path, topic, columns) for (topic, n), columns in groups.items() if n > 1]
    if not tables:
        raise SeatrialError(
            f"{path}: holds no vectors of numbers; objects (timetable, timeseries, table) are for MATLAB only: save "
            "their columns as vectors, e.g. t = seconds(TT.Time); x = TT.x; save('run.mat', 't', 'x')"
        )
    return tables


def _workspace(path: Path) -> Iterator[tuple[str, Column]]:
    """Numbers by name, that of a struct and a zero byte before those of its fields."""
    with path.open("rb") as file:
        head = file.read(520)
    if b"\x89HDF" in head:
        try:
            import h5py
        except ModuleNotFoundError as error:
            raise SeatrialError(_H5PY) from error
        with h5py.File(path) as file:
            refuse_data_of_other_files(path, file)
            for name, value in file.items():
                if not name.startswith("#"):
                    yield from _hdf(name, value)
        return
    from scipy.io import loadmat

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of objects that it cannot read; they are left out
        workspace = loadmat(path, squeeze_me=True, struct_as_record=True)
    for name, value in workspace.items():
        if not name.startswith("__"):
            yield from _flat(name, value)


def _flat(name: str, value: Any) -> Iterator[tuple[str, Column]]:
    if isinstance(value, np.ndarray) and value.dtype.names and value.size == 1 and type(value) is np.ndarray:
        for field in value.dtype.names:
            yield from _flat(
                f"{name}{'.' if chr(0) in name else chr(0)}{field}", value.item()[value.dtype.names.index(field)]
            )
    elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.size > 1:
        yield name if "\0" in name else f"\0{name}", value.astype(np.float64)


def _hdf(name: str, value: Any) -> Iterator[tuple[str, Column]]:
    if hasattr(value, "items"):
        for field, part in value.items():
            yield from _hdf(f"{name}{'.' if chr(0) in name else chr(0)}{field}", part)
    elif value.dtype.kind in "biuf" and value.size > 1 and "MATLAB_empty" not in value.attrs:
        yield name if "\0" in name else f"\0{name}", np.asarray(value, np.float64).T


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
