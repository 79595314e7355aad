"""Table of results in one Parquet file, which grows while tasks are running, and from which an interrupted run resumes.

Parquet files cannot be appended to. The file is therefore replaced as a whole, at intervals that grow with the time of
one replacement. A killed run loses the results since the last replacement, and the file is complete at any moment.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from seatrial.daq.errors import SeatrialError
from seatrial.daq.files import new_file

INTERVAL_S = 10.0  # s: shortest time between two replacements of the file
SHARE = 0.05  # largest share of the time that is spent on replacements
SETTINGS = b"seatrial.settings"  # key of the metadata of the file
Row = dict[str, Any]
TYPES = {str: "string", float: "float64", int: "int64", bool: "bool_"}


def write_rows(path: Path, columns: Mapping[str, type], rows: Sequence[Row], settings: Mapping[str, Any]) -> None:
    """Write rows of results as one Parquet file, as `ResultTable` does. An existing file is replaced as a whole.

    Parameters
    ----------
    path : Path
        The file, in a folder that exists.
    columns, settings
        As for `ResultTable`.
    rows : sequence of dict
        The rows. A column that a row does not have is None.

    Raises
    ------
    SeatrialError
        If pyarrow is not installed.
    """
    pyarrow = _import_arrow()
    table = pyarrow.Table.from_pylist(list(rows), schema=_schema(pyarrow, columns, settings))
    with new_file(path) as scratch:
        pyarrow.parquet.write_table(table, scratch)


def _import_arrow() -> Any:
    """Import pyarrow with its modules for Parquet, and return it; SeatrialError with the extra if it is missing."""
    try:
        import pyarrow
        import pyarrow.compute
        import pyarrow.parquet
    except ModuleNotFoundError as problem:
        raise SeatrialError("Parquet needs the package pyarrow: pip install 'seatrial[parquet]'") from problem
    return pyarrow


def _schema(pyarrow: Any, columns: Mapping[str, type], settings: Mapping[str, Any]) -> Any:
    """Return the ``pyarrow.Schema`` of a table, with the settings as JSON in its metadata."""
    return pyarrow.schema(
        [(name, getattr(pyarrow, TYPES[kind])()) for name, kind in columns.items()],
        metadata={SETTINGS: json.dumps(settings, sort_keys=True).encode()},
    )


class ResultTable:
    """Rows of results, and the Parquet file that holds them.

    It is a context manager: at its end, also by an error or Ctrl-C, the file is written.

    Parameters
    ----------
    path : Path or None
        The file; None: the rows are only kept in memory.
    columns : dict of str to type
        Type of each column (str, float, int or bool), in their order. Any value may be None.
    key : str
        Column that names the task of a row; a task has one or more rows.
    error : str
        Column with the reason why a task failed. A failed task is not finished: it is left out when the file is read.
    settings : dict
        Options that all rows have in common, as values of JSON. They are stored in the file.

    Raises
    ------
    SeatrialError
        If pyarrow is not installed, or if the file exists and is no such table or has finished rows of other settings.
    """

    def __init__(
        self, path: Path | None, columns: Mapping[str, type], key: str, error: str, settings: Mapping[str, Any]
    ) -> None:
        """Read the finished rows of an earlier run from the file, if it exists."""
        self._arrow = pyarrow = _import_arrow()
        self.path, self._key, self._parquet = path, key, pyarrow.parquet
        self._schema = _schema(pyarrow, columns, settings)
        self._table = self._schema.empty_table() if path is None or not path.exists() else self._read(path, error)
        self._new: list[Row] = []
        self._written, self._took = time.monotonic(), 0.0

    def _read(self, path: Path, error: str) -> Any:
        """Return the rows of the finished tasks in the file.

        SeatrialError is raised for a file that is no such table, or whose finished rows have other settings.
        """
        advice = "give another --out, or --force to start again"
        try:
            table = self._parquet.read_table(path)
        except (OSError, self._arrow.ArrowException) as problem:
            raise SeatrialError(f"{path}: cannot be read as Parquet ({problem}); {advice}") from problem
        if not table.schema.equals(self._schema):
            raise SeatrialError(f"{path}: is not a table of this command; {advice}")
        finished = table.filter(self._arrow.compute.is_null(table[error]))
        if not finished.num_rows:
            return self._schema.empty_table()
        before, now = (json.loads((s.metadata or {}).get(SETTINGS, b"{}")) for s in (table.schema, self._schema))
        if different := [name for name in {**before, **now} if before.get(name) != now.get(name)]:
            raise SeatrialError(f"{path}: its rows were made with other options ({', '.join(different)}); {advice}")
        return finished

    @property
    def keys(self) -> set[str]:
        """Names of tasks: the finished ones that the file had, and all that were added since, also failed ones."""
        return {*self._table[self._key].to_pylist(), *(row[self._key] for row in self._new)}

    def add(self, rows: Sequence[Row]) -> None:
        """Add the rows of a task, and replace the file if the time for this has come.

        A column that a row does not have is None. The file is replaced at the earliest 10 s after the last replacement
        (the first time: after the table was opened), and so rarely that this takes at most 5 % of the time.
        """
        self._new += rows
        if time.monotonic() - self._written > max(INTERVAL_S, self._took / SHARE):
            self.write()

    def table(self) -> Any:
        """Return all rows as a ``pyarrow.Table``, in the order in which they were added."""
        if self._new:
            added = self._arrow.Table.from_pylist(self._new, schema=self._schema)
            self._table, self._new = self._arrow.concat_tables([self._table, added]), []
        return self._table

    def sort(self, column: str) -> None:
        """Sort the rows by a column, so that their order does not depend on the order in which tasks end.

        The rows of equal values, such as those of one task, keep their order.
        """
        values = self.table()[column].to_pylist()
        self._table = self._table.take(sorted(range(len(values)), key=values.__getitem__))

    def write(self) -> None:
        """Replace the file by one with all rows. Nothing is written without a file or without rows."""
        began, table = time.monotonic(), self.table()
        if self.path is None or not table.num_rows:
            return
        with new_file(self.path) as scratch:
            self._parquet.write_table(table, scratch)
        self._written = time.monotonic()
        self._took = self._written - began

    def __enter__(self) -> ResultTable:
        """Return the table itself."""
        return self

    def __exit__(self, *failure: object) -> None:
        """Write the file, also if the block raised an error."""
        self.write()
