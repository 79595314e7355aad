"""Text tables: CSV, other delimiters, columns between blanks. Every complaint names file, line and column.

Theory of operation. Loggers write more than rows of numbers: a title, units below the header, comments, the header
again after a restart, text where a value is missing or out of range, a last line that is cut. A map with
``nan = "drop"``, as the guess writes it, leaves such lines and cells out, and a remark counts them. Without it they are
errors, as a table that somebody made by hand should have none.
"""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.importers.recognise import unit_of
from seatrial.daq.importers.table import Column, Table, TextStyle

_EMPTY = {"", "nan", "na", "null", "none", "n/a", "#n/a", "-", "--", "---", "nil"}
BLANK = "blank"
DELIMITERS = (",", ";", "\t", "|", BLANK)
_COMMENTS = ("#", "%", "//")  # how a line begins that is no row
MOST_TEXT = 0.5  # share of the filled cells of a column: with more it is a column of text
MOST_RAGGED = 0.2  # share of the lines with another number of cells: more is another delimiter
LEAST_NUMERIC = 0.25  # share of the cells of a row that are numbers or times: in less it is no row
LEAST_OF_USUAL = 0.4  # of the share that the last rows have: a title with some numbers has less
MOST_LINES = 4  # of a cell of a header in quotes
LEAST_SAME = 0.8  # share of the rows with as many cells as most: less is no table
_THOUSANDS = {".": re.compile(r"[+-]?\d{1,3}(,\d{3})+\.\d*"), ",": re.compile(r"[+-]?\d{1,3}([. ]\d{3})+,\d*")}
_WHOLE_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
_POINT = re.compile(r"[+-]?\d+\.\d+")
LOOKED_AT = 100  # rows
_WITH_UNIT = re.compile(r"([+-]?[\d.,]+(?:e[+-]?\d+)?)\s*([^\d\s.,+-]\S*)", re.IGNORECASE)
_DATE_OR_CLOCK = re.compile(r"(\d{1,4}[-/.:]\w{1,9}[-/.:]\d|\d{1,2}:\d{1,2})[\w :.,+-]{,30}")
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
        watched = _WatchedLines(file)
        rows = _split(watched, self._style)
        header = list(self._style.columns) or next((cells for _, cells in rows), [])
        if not header:
            raise SeatrialError(f"{self.path}: the file is empty")
        first = next(rows, None)
        if first is not None and header[0].strip() in _COMMENTS and len(first[1]) == len(header) - 1:
            header = header[1:]  # the mark of a comment in front of the names
        self._header = [name.strip().replace("\r", "").replace("\n", " ") for name in header]
        width = len(header)
        ragged: list[tuple[int, int]] = []  # line and number of cells
        for line, cells in chain([first] if first else [], rows):
            names = [cell.strip().replace("\r", "").replace("\n", " ") for cell in cells]
            if names == self._header or names[1:] == self._header:
                continue  # the logger was restarted
            if is_comment(cells, width):
                continue
            if not self.lines and is_units_row(cells):
                self.units = self.units or {
                    name: found for name, cell in zip(self._header, cells, strict=False) if (found := bare(cell))
                }
                continue
            if not self.lines and self._style.nan and is_subheading(cells):
                continue
            if len(cells) > width and not any(cell.strip() for cell in cells[width:]):
                cells = cells[:width]  # separators at the end of the rows, but not of the header
            elif len(cells) == width - 1 and not self._header[-1]:
                cells.append("")  # a separator at the end of the header, but not of the rows
            if len(cells) != width:
                ragged.append((line + self._style.skip_rows, len(cells)))
                continue
            self.lines.append(line + self._style.skip_rows)
            self._rows.append(cells)
        if ragged:
            self._leave_out(ragged, watched.is_cut)
        if not self.lines:
            raise SeatrialError(f"{self.path}: no rows below the header")
        for name in {name for name in self._header if name and self._header.count(name) > 1}:
            self._note(f"column '{name}' is in the header {counted(self._header.count(name), 'time')}: {_RENAME}")

    def _leave_out(self, ragged: Sequence[tuple[int, int]], is_cut: bool) -> None:
        """Count the lines with another number of cells than the header. Raise where they may be rows."""
        line, n_cells = ragged[0]
        width, n = len(self._header), len(ragged)
        if self._style.nan != "drop" or n > MOST_RAGGED * (n + len(self.lines)):
            raise SeatrialError(
                f"{self.path}: line {line}: {counted(n_cells, 'cell')} where the header has {width}; is the delimiter "
                "right, is the last line whole?"
            )
        if n == 1 and is_cut and (not self.lines or line > self.lines[-1]):
            self._note(f"line {line}, the last, is not whole and left out")
        else:
            what = f"{counted(n_cells, 'cell')} where the header has {width}"
            self._note(f"{counted(n, 'line')} left out; the first, line {line}, has {what}")

    def _note(self, text: str) -> None:
        if text not in self.remark:
            self.remark = "; ".join(part for part in (self.remark, text) if part)

    @property
    def names(self) -> list[str]:
        return self._header

    def __len__(self) -> int:
        return len(self.lines)

    def text(self, column: str) -> list[str]:
        if self._header.count(column) != 1:
            there = ", ".join(one or "(unnamed)" for one in self._header)
            if column in self._header:
                raise SeatrialError(f"{self.path}: column '{column}' appears twice in the header; {_RENAME}")
            raise SeatrialError(f"{self.path}: column '{column}' is not in the header; there is: {there}")
        place = self._header.index(column)
        return [cells[place] for cells in self._rows]

    def error(self, row: int, column: str, problem: str) -> SeatrialError:
        return SeatrialError(f"{self.path}: line {self.lines[row]}, column '{column}': {problem}")

    def numbers(self, column: str) -> Column:
        """Return the column as numbers, shape (n,), NaN where a cell is empty.

        Raises
        ------
        SeatrialError
            A cell is text. With ``nan = "drop"`` or ``"keep"`` it is NaN, and the error is that of a column that has
            more text than numbers.
        """
        if column not in self._numbers:
            self._numbers[column] = self._as_numbers(column)
        return self._numbers[column]

    def _as_numbers(self, column: str) -> Column:
        cells = self._without_units(column, [cell.strip() for cell in self.text(column)])
        decimal = self._style.decimal
        # In quotes, or beside numbers with a point, a comma is no decimal mark.
        has_thousands = decimal == "." and (self._style.delimiter == "," or self._has_points())
        found, wrong = np.full(len(cells), math.nan), list[int]()
        try:
            found[:] = _plain_numbers(cells, decimal)
        except ValueError:  # a cell with more than digits: each by itself
            for row, text in enumerate(cells):
                try:
                    found[row] = to_number(text, decimal, has_thousands)
                except ValueError:
                    if text.lower() not in _EMPTY:
                        wrong.append(row)
        wrong += np.flatnonzero(np.isinf(found)).tolist()
        if not wrong:
            return found
        row = min(wrong)
        n_numbers = int(np.isfinite(found).sum())
        problem = f"'{cells[row][:40]}' is not a {'finite ' if math.isinf(found[row]) else ''}number"
        if self._style.nan not in ("drop", "keep") or len(wrong) > MOST_TEXT * (len(wrong) + n_numbers):
            raise self.error(row, column, problem)
        found[np.isinf(found)] = math.nan
        self._note(f"line {self.lines[row]}, column '{column}': {problem}; {counted(len(wrong), 'such cell')} left out")
        return found

    def _has_points(self) -> bool:
        """Whether the first rows have numbers with a decimal point."""
        return any(_POINT.fullmatch(cell.strip()) for cells in self._rows[:LOOKED_AT] for cell in cells)

    def _without_units(self, column: str, cells: list[str]) -> list[str]:
        """The cells without a unit that stands in each of them (1.25 m), which becomes the unit of the column."""
        first = _WITH_UNIT.fullmatch(next((text for text in cells if text), ""))
        if first is None or not unit_of(first[2]):
            return cells
        end = first[2]
        if any(text and text.lower() not in _EMPTY and not text.endswith(end) for text in cells):
            return cells
        self.units = {**self.units, column: end}
        return [text.removesuffix(end).rstrip() for text in cells]


_RENAME = 'give each its name: csv.skip_rows = 1 more and csv.columns = ["...", ...] of the map'


class _WatchedLines:
    """Lines of a file; whether the last one has no end."""

    def __init__(self, lines: Iterable[str]) -> None:
        self._lines = lines
        self.is_cut = False

    def __iter__(self) -> Iterator[str]:
        for line in self._lines:
            self.is_cut = not line.endswith(("\n", "\r"))
            yield line.replace("\0", "")  # blocks of a card that were never written


def _plain_numbers(cells: Sequence[str], decimal: str) -> list[float]:
    """The numbers of a column. Raises ValueError where a cell is none, or may be one that no instrument writes."""
    if any("_" in text for text in cells):
        raise ValueError("_")
    return list(map(float, cells if decimal == "." else (text.replace(decimal, ".") for text in cells)))


def to_number(text: str, decimal: str, has_thousands: bool = False) -> float:
    """Return the number of a cell.

    Parameters
    ----------
    text
        The cell without blanks around it.
    decimal
        The decimal mark.
    has_thousands
        Whether a comma between digits without a decimal mark, 1,500, separates thousands.

    Returns
    -------
    float
        The number; it may be infinite.

    Raises
    ------
    ValueError
        It is none.
    """
    if "_" in text:  # Python's float also takes 1_000, which no instrument writes
        raise ValueError(text)
    try:
        return float(text if decimal == "." else text.replace(decimal, "."))
    except ValueError:
        text = text.replace("\u2212", "-").replace("\u202f", " ").replace("\u00a0", " ")  # minus; narrow, fixed blank
        if _THOUSANDS[decimal].fullmatch(text):
            text = re.sub("[. ]" if decimal == "," else ",", "", text)
        elif has_thousands and _WHOLE_THOUSANDS.fullmatch(text):
            text = text.replace(",", "")
        return float(text if decimal == "." else text.replace(decimal, "."))


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


def is_comment(cells: Sequence[str], width: int) -> bool:
    """Whether a line is a comment by how it begins. A row may begin so where the mark is a cell (-- for no value)."""
    first = cells[0].strip()
    return first.startswith("#") or (first.startswith(_COMMENTS) and len(cells) != width)


def is_subheading(cells: Sequence[str]) -> bool:
    """Whether a row below the header has words and no number: kinds of values, as Smp and Avg of Campbell."""
    texts = [text for cell in cells if (text := cell.strip())]
    return not any(c.isdigit() for text in texts for c in text) and any(text.lower() not in _EMPTY for text in texts)


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
    lines, places = _whole_lines(text.splitlines()[:-1] or text.splitlines())
    best: tuple[float, TextStyle] | None = None
    for delimiter in DELIMITERS:
        for decimal in (".", ","):
            found = _table_in(lines, TextStyle(delimiter, decimal, encoding))
            if found is not None and (best is None or found[0] > best[0]):
                best = found
    return None if best is None else replace(best[1], skip_rows=places[best[1].skip_rows])


def _whole_lines(lines: Sequence[str]) -> tuple[list[str], list[int]]:
    """Lines of rows, of which a cell in quotes may have several lines of the file; and at which line each begins."""
    found: list[str] = []
    places: list[int] = []
    for place, line in enumerate(lines):
        if found and found[-1].count('"') % 2 and place - places[-1] < MOST_LINES:
            found[-1] += f"\n{line}"
        else:
            found.append(line)
            places.append(place)
    return found, places


def _table_in(lines: list[str], style: TextStyle) -> tuple[float, TextStyle] | None:
    """The style with its header, and how many numbers these lines have in it, times their share; None: no table."""
    rows = [next((cells for _, cells in _split(line.splitlines(keepends=True), style)), []) for line in lines]
    widths = Counter(len(cells) for cells in rows if cells).most_common(1)
    if not widths:
        return None
    width = widths[0][0]
    # A line of a title that a spreadsheet has filled up with separators has fewer cells with something in them.
    last = [cells for cells in rows if len(cells) == width][-20:]
    least = min(_n_filled(cells) for cells in last) / 2
    least_share = max(LEAST_NUMERIC, LEAST_OF_USUAL * float(np.median([_share(cells, style) for cells in last])))
    first = next(
        (
            k
            for k, cells in enumerate(rows)
            if len(cells) == width and _share(cells, style) >= least_share and _n_filled(cells) >= least
        ),
        None,
    )
    if first is None:
        return None
    body = [cells for cells in rows[first:] if cells and not is_comment(cells, width)]
    if sum(len(cells) == width for cells in body) < LEAST_SAME * len(body):
        return None
    shares = [_share(cells, style, with_times=False) for cells in body]
    score = sum(share**2 * len(cells) for share, cells in zip(shares, body, strict=True))
    open_rows = all(not cells[-1].strip() for cells in body if len(cells) == width)  # end with a separator
    above = _header_above(rows, first, width, open_rows, style)
    if above is not None:
        return score, TextStyle(style.delimiter, style.decimal, style.encoding, above)
    header = tuple(f"column_{k}" for k in range(1, width + 1))
    return score, TextStyle(style.delimiter, style.decimal, style.encoding, first, header)


def _header_above(rows: Sequence[list[str]], first: int, width: int, open_rows: bool, style: TextStyle) -> int | None:
    """The row of the header above the first row of data; None if it has none."""
    above = [k for k in range(first) if rows[k]]
    while above:
        cells, n = rows[above[-1]], len(rows[above[-1]])
        is_named = n == width or (n == width - 1 and open_rows) or (n == width + 1 and not cells[-1].strip())
        is_named |= n == width + 1 and cells[0].strip() in _COMMENTS
        texts = [text for cell in cells if (text := cell.strip())]
        is_below = len(above) > 1 and (is_units_row(cells) or len(set(texts)) <= len(texts) / 2)  # the header is above
        if not (is_below or (is_comment(cells, width) and not is_named)):
            return above[-1] if is_named and _share(cells, style) < LEAST_NUMERIC else None
        above.pop()
    return None


def _n_filled(cells: Sequence[str]) -> int:
    return sum(bool(cell.strip()) for cell in cells)


def _share(cells: Sequence[str], style: TextStyle, with_times: bool = True) -> float:
    """Which part of the cells are numbers, times or empty; 0 where none is a number or a time."""
    n, empty = 0, 0
    for cell in cells:
        text = cell.strip()
        with_unit = _WITH_UNIT.fullmatch(text)
        if style.decimal == "," and _POINT.fullmatch(text):
            continue  # speaks for the other mark, though it can be read with this one
        try:
            to_number(with_unit[1] if with_unit and unit_of(with_unit[2]) else text, style.decimal)
            n += 1
        except ValueError:
            n += with_times and bool(_DATE_OR_CLOCK.fullmatch(text))
            empty += text.lower() in _EMPTY
    return (n + empty) / len(cells) if n else 0.0
