"""A CSV file -> times and columns as arrays; every complaint names file, line and column."""

from __future__ import annotations

import csv
import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from daq.errors import SeatrialError, counted
from daq.importers.csv_map import TIME_UNITS, CsvStyle, Signal, Source, TimeColumn
from daq.importers.units import UNITS

if TYPE_CHECKING:
    import _csv

_EMPTY = {"", "nan", "na", "null", "none"}
Column = NDArray[np.float64]


@dataclass(frozen=True)
class SignalData:
    """One signal's samples in SI: t in s since 1970, shape (n,), and values, shape (n,)."""

    signal: Signal
    unit: str
    t: Column
    values: Column


@dataclass(frozen=True)
class FileData:
    """What one file gave, and which file it was."""

    path: Path
    sha256: str
    signals: tuple[SignalData, ...]
    n_dropped: int  # rows out of order and cells without a number, where the map drops them
    n_disordered: int  # of these, the rows whose times ran back or repeated


class _Cells:
    """The wanted columns of a file as text, with the line number of each row."""

    def __init__(self, path: Path, style: CsvStyle, wanted: list[str]) -> None:
        self.path = path
        self.lines: list[int] = []
        self.text: dict[str, list[str]] = {name: [] for name in wanted}
        try:
            with path.open(encoding="utf-8-sig", newline="") as file:
                for _ in range(style.skip_rows):
                    file.readline()
                self._read(csv.reader(file, delimiter=style.delimiter), style)
        except UnicodeDecodeError as error:
            raise SeatrialError(f"{path}: not UTF-8 text ({error.reason}); save it as UTF-8") from error
        except csv.Error as error:
            raise SeatrialError(f"{path}: not a CSV file: {error}") from error
        except OSError as error:
            raise SeatrialError(f"{path}: cannot be read: {error.strerror}") from error

    def _read(self, rows: _csv.Reader, style: CsvStyle) -> None:
        header = list(style.columns) or next(rows, [])
        if not header:
            raise SeatrialError(f"{self.path}: the file is empty")
        places = self._places([name.strip() for name in header])
        columns = [(self.text[name], place) for name, place in places.items()]
        for row in rows:
            if not row:
                continue
            if len(row) != len(header):
                line = rows.line_num + style.skip_rows
                raise SeatrialError(
                    f"{self.path}: line {line}: {counted(len(row), 'cell')} where the header has {len(header)}; "
                    "is the delimiter right, is the last line whole?"
                )
            self.lines.append(rows.line_num + style.skip_rows)
            for column, place in columns:
                column.append(row[place])
        if not self.lines:
            raise SeatrialError(f"{self.path}: no rows below the header")

    def _places(self, header: list[str]) -> dict[str, int]:
        for name in self.text:
            if header.count(name) != 1:
                there = ", ".join(one or "(unnamed)" for one in header)
                problem = "appears twice in" if name in header else "is not in"
                raise SeatrialError(f"{self.path}: column '{name}' {problem} the header; there is: {there}")
        return {name: header.index(name) for name in self.text}

    def error(self, row: int, column: str, problem: str) -> SeatrialError:
        return SeatrialError(f"{self.path}: line {self.lines[row]}, column '{column}': {problem}")

    def numbers(self, column: str, decimal: str) -> Column:
        """The column as numbers, NaN where a cell is empty. Raises SeatrialError at the first that is none."""
        cells = self.text[column]
        found = np.empty(len(cells))
        for row, cell in enumerate(cells):
            text = cell.strip()
            try:
                # Python's float also takes 1_000, which no instrument writes.
                found[row] = float((text if decimal == "." else text.replace(decimal, ".")).replace("_", "?"))
            except ValueError:
                if text.lower() not in _EMPTY:
                    raise self.error(row, column, f"'{text[:40]}' is not a number") from None
                found[row] = math.nan
            if math.isinf(found[row]):
                raise self.error(row, column, f"'{text[:40]}' is not a finite number")
        return found


def read_csv(path: Path, source: Source) -> FileData:
    """Read one file by its part of the map. Raises SeatrialError with file, line, column and what to do."""
    clock = [source.time.column] if source.time.column else []
    cells = _Cells(path, source.style, list(dict.fromkeys([*clock, *(s.column for s in source.signals)])))
    t = _times(cells, source.time, source.style)
    kept = _order(cells, t, source)
    n_disordered = len(t) - int(kept.sum())
    if source.style.repeats == "drop":
        kept &= _news(cells, [s.column for s in source.signals])
    n_dropped = len(t) - int(kept.sum())
    signals = []
    for signal in source.signals:
        raw = cells.numbers(signal.column, source.style.decimal)
        rows = kept & ~(np.isnan(raw) if signal.nan == "drop" else np.zeros(len(raw), bool))
        rows &= raw != (math.nan if signal.missing is None else signal.missing)
        n_dropped += int(kept.sum()) - int(rows.sum())
        bad = np.flatnonzero(np.isnan(raw) & kept)
        if signal.nan == "error" and len(bad):
            raise cells.error(int(bad[0]), signal.column, 'no number; nan = "drop" or "keep" would allow that')
        unit, factor = UNITS[signal.unit]
        values = signal.sign * (signal.scale * raw[rows] + signal.offset) * factor
        t_signal, values = _expire(t[rows], _angle(values, signal.angle), signal.timeout)
        signals.append(SignalData(signal, unit, t_signal, values))
    return FileData(path, _sha256(path), tuple(signals), n_dropped, n_disordered)


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _angle(values: Column, how: str) -> Column:
    if how == "wrap":
        return np.asarray(np.pi - np.mod(np.pi - values, 2.0 * np.pi))  # -pi < angle <= pi
    if how == "unwrap":
        found = values.copy()
        known = ~np.isnan(values)
        found[known] = np.unwrap(values[known])
        return found
    return values


def _news(cells: _Cells, columns: list[str]) -> NDArray[np.bool_]:
    """Rows in which any of the columns differs from the row before, shape (n,)."""
    new = np.zeros(len(cells.lines), bool)
    new[0] = True
    for column in columns:
        text = np.array(cells.text[column])
        new[1:] |= text[1:] != text[:-1]
    return new


def _expire(t: Column, values: Column, timeout: float) -> tuple[Column, Column]:
    """The signal with a zero `timeout` seconds after each sample that the next one does not follow sooner."""
    if not timeout or not len(t):
        return t, values
    last = np.append(np.flatnonzero(np.diff(t) > timeout), len(t) - 1)
    return np.insert(t, last + 1, t[last] + timeout), np.insert(values, last + 1, 0.0)


def _times(cells: _Cells, time: TimeColumn, style: CsvStyle) -> Column:
    """Time of each row in s of the file's clock, shape (n,)."""
    if not time.column:
        return np.arange(len(cells.lines)) / time.rate_hz
    if time.format in TIME_UNITS and not time.fraction:
        t = cells.numbers(time.column, style.decimal) * TIME_UNITS[time.format]
        empty = np.flatnonzero(np.isnan(t))
        if len(empty):
            raise cells.error(int(empty[0]), time.column, "no time; take the line out")
        return t
    parse = _parser(time)
    found = np.empty(len(cells.lines))
    for row, text in enumerate(cells.text[time.column]):
        try:
            found[row] = parse(text.strip())
        except ValueError as error:
            raise cells.error(row, time.column, f"'{text[:40]}' is not a time of format {time.format}") from error
    return found


def _parser(time: TimeColumn) -> Callable[[str], float]:
    def whole(text: str) -> float:
        if time.format == "s":
            return float(text)
        iso = time.format == "iso"
        moment = datetime.fromisoformat(text) if iso else datetime.strptime(text, time.format)
        return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()

    def split(text: str) -> float:
        head, point, tail = text.rpartition(".")
        if not point:
            return whole(text)
        if not (tail.isascii() and tail.isdigit()) or len(tail) > 9:
            raise ValueError(text)
        # unpadded-ns: a logger wrote seconds, a point, and the nanoseconds as a bare number
        return whole(head) + (int(tail) * 1e-9 if time.fraction == "unpadded-ns" else float(f"0.{tail}"))

    return split if time.fraction else whole


def _order(cells: _Cells, t: Column, source: Source) -> NDArray[np.bool_]:
    """Which rows have a time after all rows before them; raises at the first without, unless such rows are dropped."""
    highest = np.maximum.accumulate(t)
    later = np.ones(len(t), bool)
    later[1:] = t[1:] > highest[:-1]
    if source.style.time_order == "error" and not later.all():
        row = int(np.flatnonzero(~later)[0])
        what = "repeats" if t[row] == highest[row - 1] else f"runs back by {highest[row - 1] - t[row]:.6g} s"
        raise cells.error(row, source.time.column, f'time {what}; csv.time_order = "drop" would leave such rows out')
    return later
