"""Reader of LabVIEW measurement files (.lvm), text files with a header for the file and one for each segment of rows.

Theory of operation. The header of the file has the separators and the date and time of the start. The header of a
segment has for each channel the date and time, X0 and Delta_X of its first row, and its unit. The X of a row is a time
in seconds. It counts either since 1904 or from the start of the segment, at which it equals X0. In a file without X
(``X_Columns No``) the rows are Delta_X apart. Source: NI, "Specification for the LabVIEW Measurement File (.lvm)",
2023.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.importers.row_times import LABVIEW_EPOCH, read_date
from seatrial.daq.importers.table import Column, SourceOptions, Table
from seatrial.daq.importers.text_table import to_number

_END = "***End_of_Header***"
_SEPARATORS = {"tab": "\t", "comma": ",", "semicolon": ";"}
_SINCE_1904 = 1e9  # s; an X that is greater counts from 1904


def read_lvm(path: Path, options: SourceOptions) -> list[Table]:
    """Read a LabVIEW measurement file (.lvm) as one table with its own times.

    Parameters
    ----------
    path
        The file.
    options
        Not used.

    Returns
    -------
    list of Table
        One table, in a list. Times are in s since 1970, or since the start if the file has no date. A remark counts the
        rows that are incomplete or without a time, which are left out.

    Raises
    ------
    SeatrialError
        If the file cannot be read, its header has no end, it has no complete rows, its rows have neither X nor Delta_X,
        its channels have different times, or its segments have different channels.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    except OSError as error:
        raise SeatrialError(f"{path}: cannot be read: {error.strerror}; check its path and permissions") from error
    end = next((k for k, line in enumerate(lines) if line.startswith(_END)), None)
    if end is None:
        raise SeatrialError(f"{path}: the header of this LabVIEW file has no end ({_END}); copy the file again")
    named = next((line[len("Separator") :] for line in lines[:end] if line.startswith("Separator")), "")
    separator = named.strip("\t,; ").lower()
    mark = _SEPARATORS.get(separator, "\t")
    head = _header_cells([line.split(mark) for line in lines[:end]])
    decimal = _first_filled_cell(head, "Decimal_Separator", ".")
    found = _SegmentRows(path, decimal, _first_filled_cell(head, "X_Columns", "One"), _header_seconds(head, decimal))
    segment: list[list[str]] = []
    is_header = True  # whether the line is before the end of the header of a segment
    rows: list[list[str]] = []
    for line in lines[end + 1 :]:
        cells = line.split(mark)
        if cells[0] == "Channels":
            found.add(rows)
            rows, segment, is_header = [], [cells], True
        elif line.startswith(_END):
            found.begin(_header_cells(segment))
            is_header = False
        elif is_header:
            segment.append(cells)
        elif line.strip(f"{mark} "):
            rows.append(cells)
    found.add(rows)
    return [found.table()]


def _header_cells(lines: Sequence[Sequence[str]]) -> dict[str, Sequence[str]]:
    """Return the cells of each header line of a LabVIEW file, without the first cell, by the text of this first cell.

    A line without cells is skipped. If a first cell repeats, the last line counts.
    """
    return {cells[0].strip(): cells[1:] for cells in lines if cells}


def _first_filled_cell(head: Mapping[str, Sequence[str]], key: str, usual: str) -> str:
    """Return the first cell of a LabVIEW header line that is not blank; `usual` if there is no such line or cell.

    `head` has the cells of each header line by its name, and `key` is the name.
    """
    return next((cell.strip() for cell in head.get(key, ()) if cell.strip()), usual)


def _header_seconds(head: Mapping[str, Sequence[str]], decimal: str) -> float:
    """Return the entries Date and Time of a LabVIEW header, taken as UTC [s since 1970]; NaN if one is missing.

    `head` has the cells of each header line by name, and `decimal` is the decimal mark of the file. The date is
    yyyy/mm/dd or yyyy-mm-dd; NaN is also returned for another form.
    """
    text = f"{_first_filled_cell(head, 'Date', '')} {_first_filled_cell(head, 'Time', '').replace(decimal, '.')}"
    for pattern in ("%Y/%m/%d %H:%M:%S.%f", "%Y-%m-%d %H:%M:%S.%f"):
        try:
            moment: datetime = read_date(text, pattern)
        except ValueError:
            continue
        return moment.replace(tzinfo=UTC).timestamp()
    return math.nan


class _SegmentRows:
    """Collector of the rows of all segments of one LabVIEW file, which become one table.

    A segment is a part of the file with a header and names of columns of its own.

    Parameters
    ----------
    path
        The file, for messages.
    decimal
        Decimal mark.
    x_columns
        Entry X_Columns of the file's header: "No" if the rows have no X, else "One" or "Multi".
    start
        Date and time of the start of the file [s since 1970]; NaN without a date.
    """

    def __init__(self, path: Path, decimal: str, x_columns: str, start: float) -> None:
        """Begin without rows, with values from the header of the LabVIEW file. The class describes the parameters."""
        self._path, self._decimal, self._x_columns, self._start = path, decimal, x_columns.lower(), start
        self._names: list[str] = []
        self._units: dict[str, str] = {}
        self._places: list[int] = []  # positions of the channels in a row
        self._t: list[Column] = []
        self._values: list[Column] = []
        self._n_short = 0  # incomplete rows
        self._segment: Mapping[str, Sequence[str]] = {}

    def begin(self, segment: Mapping[str, Sequence[str]]) -> None:
        """Begin a segment of a LabVIEW file: store the cells of its header by line name, for the rows that follow.

        The header of the segment before is replaced.
        """
        self._segment = segment

    def add(self, rows: Sequence[Sequence[str]]) -> None:
        """Add the rows of a segment of a LabVIEW file, each a list of cells. The first has the names of the columns.

        Without rows nothing is added. Columns without a name, X_Value and Comment are no channels. The units are those
        of the first segment. A row with too few cells is left out and counted. A cell that is not a number becomes NaN.
        If the name of a column repeats, a number is added: "Force (2)".

        Raises
        ------
        SeatrialError
            If the channels differ from those of the segments before, or have different times, or no times.
        """
        if not rows:
            return
        names: list[str] = []
        for cell in rows[0]:
            n = sum(name.partition(" (")[0] == cell.strip() for name in names if name != "X_Value")
            names.append(cell.strip() if not n or not cell.strip() else f"{cell.strip()} ({n + 1})")
        columns = [k for k, name in enumerate(names) if name and name not in ("X_Value", "Comment")]
        if not self._names:
            self._names, self._places = [names[k] for k in columns], columns
            units = [cell.strip() for cell in self._segment.get("Y_Unit_Label", ())]
            self._units = {name: unit for name, unit in zip(self._names, units, strict=False) if unit}
        elif [names[k] for k in columns] != self._names:
            raise SeatrialError(
                f"{self._path}: its segments have different channels; export each segment to its own file"
            )
        width = max(self._places, default=0) + 1
        whole = [row for row in rows[1:] if len(row) >= width]
        self._n_short += len(rows) - 1 - len(whole)
        values = np.array([[self._cell_number(row[k]) for k in self._places] for row in whole]).reshape(
            -1, len(columns)
        )
        x = [k for k, name in enumerate(names) if name == "X_Value"]
        if len(x) > 1 and any(row[k].strip() != row[x[0]].strip() for row in whole for k in x):
            raise SeatrialError(f"{self._path}: each channel has its own times; export it with one X column")
        self._t.append(self._times(whole, x[0] if x and self._x_columns != "no" else None))
        self._values.append(values)

    def _cell_number(self, cell: str) -> float:
        """Return the number in a cell by the decimal mark of the LabVIEW file; NaN if the cell is not a number."""
        try:
            return to_number(cell.strip(), self._decimal)
        except ValueError:
            return math.nan

    def _times(self, rows: Sequence[Sequence[str]], place: int | None) -> Column:
        """Return the times (n,) of the rows of a LabVIEW segment [s since 1970, or since the start without a date].

        `place` is the index of the column X, which has the times; None if the rows have no X and are Delta_X apart. X
        counts from the start in the header of the segment, at which it is X0. X counts from the start of the file if
        its first value differs from X0 by more than two Delta_X, or the segment has no date. X counts from 1904 if its
        first value is above 1e9. Raise SeatrialError if the rows have neither X nor Delta_X. A cell of X that is not a
        number gives NaN.
        """
        x0 = self._cell_number(_first_filled_cell(self._segment, "X0", "0"))
        dx = self._cell_number(_first_filled_cell(self._segment, "Delta_X", "nan"))
        if place is None:
            if not dx > 0.0:
                raise SeatrialError(
                    f"{self._path}: the file has neither times (X_Value) nor Delta_X; export it with one of them"
                )
            x = x0 + dx * np.arange(len(rows))
        else:
            x = np.array([self._cell_number(row[place]) for row in rows])
        if len(x) and x[0] > _SINCE_1904:
            return np.asarray(x + LABVIEW_EPOCH, np.float64)
        begin = _header_seconds(self._segment, self._decimal)
        begin, start = (moment if math.isfinite(moment) else 0.0 for moment in (begin, self._start))
        # If the first X is not X0, X continues from the segment before: it counts from the start of the file.
        is_continued = len(x) > 0 and abs(x[0] - x0) > 2.0 * abs(dx)
        return np.asarray(start + x if is_continued or not begin else begin + x - x0)

    def table(self) -> Table:
        """Return the rows of all segments of the LabVIEW file that have a time as one table, in the order of the file.

        A remark counts the rows that were left out. Raise SeatrialError if there are no complete rows.
        """
        if not self._t or not sum(map(len, self._t)):
            raise SeatrialError(f"{self._path}: no lines with data below the header; give a complete file")
        t, values = np.concatenate(self._t), np.concatenate(self._values)
        known = np.isfinite(t)
        n_lost = self._n_short + int(np.sum(~known))
        remark = f"{counted(n_lost, 'row')} left out, incomplete or without a time" if n_lost else ""
        columns = dict(zip(self._names, values[known].T, strict=True))
        return Table(self._path, "", columns, t[known], remark=remark, units=self._units)
