"""Curves of a result in a Parquet file beside result.json: signals over time, and spectra over frequency.

The file has one row for each point of a curve. The columns ``table``, ``path``, ``record``, ``name`` and ``axis`` tell
which curve it is, ``at`` is its abscissa, and each further column is a field of a table of the result.
"""

from __future__ import annotations

import hashlib
import io
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.ident.numerics import Array
from seatrial.ident.results.commands import ChannelNoise, GnssFixes, NavigatedRecord, StateTrace
from seatrial.ident.results.comparison import ComparedPrediction, ComparedTrace
from seatrial.ident.results.parts import InputTrace, Part, ResidualForce, ResidualTests, Trace, Track, WhitenessTests

# The curves of each table: the field of their abscissa, and the fields over it. The abscissa of a table that lacks this
# field is that of the table around it. Tracks have the times of the traces of their record.
_TESTS = {"t": ("e",), "frequency": ("cumulative",)}
CURVES: Mapping[type[Part], Mapping[str, tuple[str, ...]]] = {
    Trace: {"t": ("measured", "model", "sd", "before"), "t_horizon": ("horizon", "sd_horizon", "horizon_before")},
    Track: {"t": ("x_measured", "y_measured", "x_model", "y_model", "x_before", "y_before")},
    InputTrace: {"t": ("value",)},
    ResidualTests: _TESTS,
    WhitenessTests: _TESTS,
    ResidualForce: {"t": ("mean", "sd", "after_mean", "after_sd")},
    NavigatedRecord: {"t": ()},
    StateTrace: {"t": ("value", "sd", "measured")},
    GnssFixes: {"t": ("x", "y", "used")},
    ChannelNoise: {"frequency": ("psd", "psd_model")},
    ComparedTrace: {"t": ("measured",)},
    ComparedPrediction: {"t": ("predicted", "sd")},
}
KEYS = ("table", "path", "record", "name", "axis")  # columns of text; ``at`` and the fields are numbers
STUB = "parquet"  # key in result.json that replaces the numbers of an array: {"parquet": n}
COMPRESSION = "zstd"


def moved_fields(part: Part) -> frozenset[str]:
    """Return the names of the fields of a table whose numbers are in the Parquet file; empty for other tables."""
    curves = CURVES.get(type(part), {})
    return frozenset(name for axis, names in curves.items() for name in (axis, *names) if hasattr(part, name))


@dataclass(frozen=True)
class _Curve:
    """Curves of one table over one abscissa: the keys of their rows, and their numbers by column."""

    keys: tuple[str, ...]
    columns: dict[str, Array] = field(default_factory=dict)


def to_parquet(result: Part) -> bytes | None:
    """Return the curves of a result as the content of a Parquet file.

    None for a result without curves, and if the package pyarrow (extra ``parquet``) is not installed. The abscissa
    keeps all digits, and other numbers have 32 bits (seven digits).
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        return None

    found = [c for c in _curves_of(result, (), "", None) if c.columns]
    if not found:
        return None
    sizes = [next(iter(c.columns.values())).size for c in found]
    data: dict[str, Any] = {}
    for k, key in enumerate(KEYS):
        words = _arrow_words([c.keys[k] for c in found]).dictionary_encode()
        data[key] = words.take(_arrow(np.repeat(np.arange(len(found)), sizes), pyarrow.int64()))
    for name in dict.fromkeys(["at", *(name for c in found for name in c.columns)]):
        kind = pyarrow.float64() if name == "at" else pyarrow.float32()
        with np.errstate(over="ignore"):  # a diverged simulation becomes infinite
            chunks = [
                pyarrow.nulls(n, kind) if name not in c.columns else _arrow(c.columns[name], kind)
                for c, n in zip(found, sizes, strict=True)
            ]
        data[name] = pyarrow.chunked_array(chunks, kind)
    content = io.BytesIO()
    # Measurements hardly repeat, so a dictionary of them is useless. Bytes of equal weight are stored together.
    numbers = [name for name in data if name not in KEYS]
    pyarrow.parquet.write_table(
        pyarrow.Table.from_arrays(list(data.values()), list(data)).combine_chunks(),
        content,
        compression=COMPRESSION,
        use_dictionary=list(KEYS),
        use_byte_stream_split=numbers,
    )
    return content.getvalue()


# `pyarrow.array` and `pyarrow.table` import pandas, which takes a fifth of a second, to recognise its objects.
def _arrow(values: Array, kind: Any) -> Any:
    """Return numbers as a ``pyarrow.Array`` of the type ``kind`` without nulls; NaN stays NaN."""
    import pyarrow

    numbers = np.ascontiguousarray(values, dtype=kind.to_pandas_dtype())
    return pyarrow.Array.from_buffers(kind, numbers.size, [None, pyarrow.py_buffer(numbers)])


def _arrow_words(words: Sequence[str]) -> Any:
    """Return texts as a ``pyarrow.StringArray``."""
    import pyarrow

    encoded = [word.encode() for word in words]
    ends = np.cumsum([0, *map(len, encoded)], dtype=np.int32)
    return pyarrow.StringArray.from_buffers(len(encoded), pyarrow.py_buffer(ends), pyarrow.py_buffer(b"".join(encoded)))


def _curves_of(value: Any, path: tuple[str, ...], record: str, around: Part | None) -> Iterator[_Curve]:
    """Yield the curves of a value of a result and of all that it contains.

    Parameters
    ----------
    value
        Result, table, tuple or dict of tables; other values have no curves.
    path
        Keys and indices that lead to the value.
    record
        Name of the record that the value belongs to; empty if it has none.
    around
        Table that contains the value; None for the result.
    """
    if isinstance(value, tuple | list):
        for i, item in enumerate(value):
            yield from _curves_of(item, (*path, str(i)), record, around)
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from _curves_of(item, (*path, str(key)), record, around)
    if not isinstance(value, Part):
        return
    record = str(getattr(value, "record", record))
    # the name of a table without a name, such as a prediction of a channel, is that of the table around it
    words = (getattr(part, key, None) for part in (value, around) for key in ("channel", "force", "name"))
    name = next((word for word in words if isinstance(word, str)), "")
    table = ".".join(key for key in path if not key.isdecimal())
    for axis, names in CURVES.get(type(value), {}).items():
        own: Array | None = getattr(value, axis, None)
        at: Array | None = getattr(around, axis, None) if own is None else own
        columns = {n: a for n in names if (a := getattr(value, n)) is not None and a.size}
        size = next((a.size for a in columns.values()), 0 if own is None else own.size)
        if at is not None and at.size == size and size:
            columns = {"at": at} | columns
        keys = (table, "/".join(path), record or str(getattr(around, "record", "")), name, axis)
        yield _Curve(keys, columns if size else {})
    for key in value.__struct_fields__:
        yield from _curves_of(getattr(value, key), (*path, key), record, value)


def read_parquet(path: Path, sha256: str) -> dict[str, Array]:
    """Return the curves of a Parquet file that `to_parquet` made: the array of each field by its path in the result.

    Parameters
    ----------
    path
        The file.
    sha256
        SHA-256 of the file that belongs to the result.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    SeatrialError
        If it is another file than that of the result, or if the package pyarrow is missing.
    """
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != sha256:
        raise SeatrialError(
            f"{path}: is not the file that was written with the result beside it; copy both files of one folder, or "
            "repeat the command"
        )
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as missing:
        raise SeatrialError(f"{path}: Parquet needs the package pyarrow: pip install 'seatrial[parquet]'") from missing
    table = pyarrow.parquet.read_table(pyarrow.BufferReader(content))
    codes = [table[key].combine_chunks().indices.to_numpy() for key in KEYS]
    words = [table[key].combine_chunks().dictionary.to_pylist() for key in KEYS]
    number = dict(zip(KEYS, codes, strict=True))
    change = np.diff(number["path"]).astype(bool) | np.diff(number["axis"]).astype(bool)
    starts = np.concatenate([[0], np.flatnonzero(change) + 1, [table.num_rows]])
    numbers = {n: table[n].combine_chunks() for n in table.column_names if n not in KEYS}
    found: dict[str, Array] = {}
    for begin, end in itertools.pairwise(starts):
        where, axis = words[1][number["path"][begin]], words[4][number["axis"][begin]]
        for name, column in numbers.items():
            part = column.slice(begin, end - begin)
            if part.null_count < len(part):
                found[f"{where}/{axis if name == 'at' else name}"] = part.to_numpy().astype(np.float64)
    return found


def with_curves(content: Any, curves: Mapping[str, Array], path: str = "") -> Any:
    """Return the content of result.json with its stubs ``{"parquet": n}`` replaced by arrays.

    Parameters
    ----------
    content
        Decoded JSON.
    curves
        Arrays by their path; a stub without one becomes an empty array.
    path
        Path of the content in the result.
    """
    if isinstance(content, dict):
        if content.keys() == {STUB}:
            return curves.get(path, np.empty(0))
        return {k: with_curves(v, curves, f"{path}/{k}" if path else k) for k, v in content.items()}
    if isinstance(content, list):
        return [with_curves(v, curves, f"{path}/{i}" if path else str(i)) for i, v in enumerate(content)]
    return content


def stub(value: Array) -> dict[str, int]:
    """Return what stands in result.json in place of the numbers of an array that are in the Parquet file."""
    return {STUB: int(value.shape[0])}
