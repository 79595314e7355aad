"""Text tables: CSV, other delimiters, columns between blanks. Every complaint names file, line and column."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from daq.errors import SeatrialError, counted
from daq.importers.recognise import unit_of
from daq.importers.table import Column, Table, TextStyle

_EMPTY = {"", "nan", "na", "null", "none"}
BLANK = "blank"
ASCII = 0.8  # of the characters of a table at least


class TextTable(Table):
    """Cells as text; a column becomes numbers when it is asked for."""

    strict = True

    def __init__(self, path: Path, style: TextStyle) -> None:
        super().__init__(path, "", {})
        self._style = style
        self.lines: list[int] = []  # of each row
        self._rows: list[list[str]] = []
        self._numbers: dict[str, Column] = {}
        try:
            with path.open(encoding=style.encoding, newline="") as file:
                for _ in range(style.skip_rows):
                    if not file.readline():  # the file ends before its header does
                        break
                self._read(file)
        except UnicodeError as error:
            name = "UTF-8" if style.encoding == "utf-8-sig" else style.encoding
            raise SeatrialError(
                f"{path}: not {name} text ({getattr(error, 'reason', error)}); "
                'save it as UTF-8, or say csv.encoding = "latin-1", "utf-16"'
            ) from error
        except csv.Error as error:
            raise SeatrialError(f"{path}: not a CSV file: {error}") from error
        except OSError as error:
            raise SeatrialError(f"{path}: cannot be read: {error.strerror}") from error

    def _read(self, file: Iterable[str]) -> None:
        rows = _split(file, self._style)
        header = list(self._style.columns) or next((cells for _, cells in rows), [])
        self._header = [name.strip() for name in header]
        if not self._header:
            raise SeatrialError(f"{self.path}: the file is empty")
        width = len(self._header)
        for line, cells in rows:
            if cells[0].lstrip().startswith("#") or [cell.strip() for cell in cells] == self._header:
                continue  # a comment, or the header again: the logger was restarted
            if not self.lines and not self.units and is_units_row(cells):
                self.units = {
                    name: found for name, cell in zip(self._header, cells, strict=False) if (found := bare(cell))
                }
                continue
            if len(cells) == width + 1 and not cells[-1].strip():
                cells.pop()  # a separator at the end of the rows, but not of the header
            elif len(cells) == width - 1 and not self._header[-1]:
                cells.append("")  # a separator at the end of the header, but not of the rows
            if len(cells) != width:
                raise SeatrialError(
                    f"{self.path}: line {line + self._style.skip_rows}: {counted(len(cells), 'cell')} where the "
                    f"header has {len(self._header)}; is the delimiter right, is the last line whole?"
                )
            self.lines.append(line + self._style.skip_rows)
            self._rows.append(cells)
        if not self.lines:
            raise SeatrialError(f"{self.path}: no rows below the header")

    @property
    def names(self) -> list[str]:
        return self._header

    def __len__(self) -> int:
        return len(self.lines)

    def text(self, column: str) -> list[str]:
        if self._header.count(column) != 1:
            there = ", ".join(one or "(unnamed)" for one in self._header)
            problem = "appears twice in" if column in self._header else "is not in"
            raise SeatrialError(f"{self.path}: column '{column}' {problem} the header; there is: {there}")
        place = self._header.index(column)
        return [cells[place] for cells in self._rows]

    def error(self, row: int, column: str, problem: str) -> SeatrialError:
        return SeatrialError(f"{self.path}: line {self.lines[row]}, column '{column}': {problem}")

    def numbers(self, column: str) -> Column:
        """The column as numbers, NaN where a cell is empty. Raises SeatrialError at the first that is none."""
        if column in self._numbers:
            return self._numbers[column]
        cells, decimal = self.text(column), self._style.decimal
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
        self._numbers[column] = found
        return found


def _split(file: Iterable[str], style: TextStyle) -> Iterator[tuple[int, list[str]]]:
    """Number and cells of each line that is not blank."""
    if style.delimiter == BLANK:
        for number, line in enumerate(file, start=1):
            if cells := line.split():
                yield number, cells
        return
    rows = csv.reader(file, delimiter=style.delimiter)
    for cells in rows:
        if any(cell.strip() for cell in cells):
            yield rows.line_num, cells


def bare(cell: str) -> str:
    """Return the text of a cell of a units row without blanks and brackets."""
    return cell.strip().strip("()[]{}<>").strip()


def is_units_row(cells: list[str]) -> bool:
    """Whether the cells of a row are the units of the columns: most of them are known, and none is a measured value."""
    texts = [text for cell in cells if (text := bare(cell))]
    known = [text for text in texts if unit_of(text)]
    values = [text for text in texts if text not in known and any(character.isdigit() for character in text)]
    return not values and 2 * len(known) >= len(texts) and any(text not in ("1", "-") for text in known)


def has_decimal_commas(head: bytes) -> bool:
    """Whether a table has the comma as delimiter and as decimal mark: its rows have more cells than its header."""
    lines = head.decode("utf-8-sig", "ignore").splitlines()[:-1]
    widths = [line.count(",") + 1 for line in lines if line.strip()]
    if len(widths) < 3 or widths[0] < 2 or any(character in ";\t" for character in lines[0]):
        return False
    numeric = [line for line in lines[1:] if re.fullmatch(r"[-+0-9eE.,\s]+", line)]
    wider = sum(widths[0] < width <= 2 * widths[0] for width in widths[1:])
    return len(numeric) > 0.9 * (len(lines) - 1) and wider > 0.9 * (len(widths) - 1)


def wide_encoding(head: bytes) -> str:
    """The encoding of text of two bytes a character (Excel's "Unicode text") that begins so; "" where it is none."""
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    first, second = head[::2], head[1::2]  # the bytes of characters that are ASCII, as those of a table nearly all are
    for name, zeros, letters in (("utf-16-le", second, first), ("utf-16-be", first, second)):
        if zeros and zeros.count(0) > ASCII * len(zeros) and not letters.count(0):
            return name
    return ""


def sniff_style(path: Path, head: bytes) -> TextStyle | None:
    """The style of a text table of which ``head`` is the beginning; None where it looks like none."""
    encoding = wide_encoding(head) or "utf-8-sig"
    try:
        text = head.decode(encoding)
    except UnicodeDecodeError as error:
        encoding = encoding if error.start > len(head) - 4 else "latin-1"
        text = head.decode(encoding, "ignore")
    lines = text.splitlines()[:-1] or text.splitlines()
    best: tuple[float, TextStyle] | None = None
    for delimiter in (",", ";", "\t", BLANK):
        for decimal in (".", ",") if delimiter != "," else (".",):
            found = _table_in(lines, TextStyle(delimiter, decimal, encoding))
            if found is not None and (best is None or found[0] > best[0]):
                best = found
    return None if best is None else best[1]


def _table_in(lines: list[str], style: TextStyle) -> tuple[float, TextStyle] | None:
    """The style with its header, and how many numbers these lines have in it, times their share; None: no table."""
    rows = [next((cells for _, cells in _split([line], style)), []) for line in lines]
    widths = Counter(len(cells) for cells in rows[-20:] if cells).most_common(1)
    if not widths:
        return None
    width = widths[0][0]
    first = next((k for k, cells in enumerate(rows) if len(cells) == width and _share(cells, style) >= 0.5), None)
    if first is None:
        return None
    body = [cells for cells in rows[first:] if cells]
    if sum(len(cells) == width for cells in body) < 0.9 * len(body):
        return None
    shares = [_share(cells, style) for cells in body]
    score = sum(share**2 * len(cells) for share, cells in zip(shares, body, strict=True))
    filled = [k for k in range(first) if rows[k]]
    if len(filled) > 1 and is_units_row(rows[filled[-1]]):
        filled.pop()  # the header stands above the units
    above = filled[-1] if filled else None
    open_rows = all(not cells[-1].strip() for cells in body if len(cells) == width)  # end with a separator
    named = above is not None and _share(rows[above], style) < 0.5
    if named and above is not None:
        n = len(rows[above])
        named = n == width or (n == width - 1 and open_rows) or (n == width + 1 and not rows[above][-1].strip())
    header: tuple[str, ...] = () if named else tuple(f"column_{k}" for k in range(1, width + 1))
    skip = above if named and above is not None else first
    return score, TextStyle(style.delimiter, style.decimal, style.encoding, skip, header)


def _share(cells: list[str], style: TextStyle) -> float:
    """Which part of the cells are numbers or empty, 0 where none is a number."""
    n, empty = 0, 0
    for cell in cells:
        text = cell.strip()
        try:
            float(text if style.decimal == "." else text.replace(style.decimal, "."))
            n += 1
        except ValueError:
            empty += text.lower() in _EMPTY
    return (n + empty) / len(cells) if n else 0.0
