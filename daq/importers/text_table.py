"""Reader of text tables: CSV, other delimiters, columns between blanks. Errors name file, line and column.

Theory of operation. Loggers write more than rows of numbers: a title, units below the header, comments, a second header
after a restart, text for a missing value, and a last line that is cut off. A map with ``nan = "drop"``, as a guessed
map has, leaves such lines and cells out, and a remark counts them. Without this key they are errors, because a table
made by hand should not contain them.
"""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain, count
from pathlib import Path

import numpy as np

from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.importers.recognise import unit_of
from seatrial.daq.importers.table import Column, Table, TextStyle

_EMPTY = {"", "nan", "na", "null", "none", "n/a", "#n/a", "-", "--", "---", "nil"}
BLANK = "blank"
DELIMITERS = (",", ";", "\t", "|", BLANK)
_COMMENTS = ("#", "%", "//")  # begin of a comment line
MOST_TEXT = 0.5  # share of text in the filled cells of a column; with more it is a column of text
MOST_RAGGED = 0.2  # share of lines with a wrong number of cells; with more the delimiter is wrong
LEAST_NUMERIC = 0.25  # share of numbers and times in the cells of a row; with less the line is not a row of data
LEAST_OF_USUAL = 0.4  # the same, relative to the last rows; a title with some numbers has less
MOST_LINES = 4  # lines of a header cell in quotes
LEAST_SAME = 0.8  # share of rows with the usual number of cells; with less the text is not a table
_THOUSANDS = {".": re.compile(r"[+-]?\d{1,3}(,\d{3})+\.\d*"), ",": re.compile(r"[+-]?\d{1,3}([. ]\d{3})+,\d*")}
_WHOLE_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
_POINT = re.compile(r"[+-]?\d+\.\d+")
LOOKED_AT = 100  # rows; a decimal point is searched in the first rows
_WITH_UNIT = re.compile(r"([+-]?[\d.,]+(?:e[+-]?\d+)?)\s*([^\d\s.,+-]\S*)", re.IGNORECASE)
_DATE_OR_CLOCK = re.compile(r"(\d{1,4}[-/.:]\w{1,9}[-/.:]\d|\d{1,2}:\d{1,2})[\w :.,+-]{,30}")
ASCII = 0.8  # least share of ASCII characters in a table


class TextTable(Table):
    """Table of a text file, with columns of numbers and of text.

    A table of plain numbers alone is read by numpy, which is several times faster and does not keep the cells. Any
    other table is read cell by cell, which also finds the line of an error. A column of it is converted to numbers at
    its first use.

    Attributes
    ----------
    lines : list of int
        Number of the line in the file, counted from 1, of each row.
    units : dict
        Units by column, from a row of units below the header or from the cells.
    remark : str
        What was left out, for the user.
    """

    strict = True

    def __init__(self, path: Path, style: TextStyle) -> None:
        """Read the header and the cells of a text file in the style of an import map (delimiter, decimal mark, ...).

        Raise SeatrialError if it cannot be read as a table of this style.
        """
        super().__init__(path, "", {})
        self._style = style
        self.lines: list[int] = []  # number of the line of each row
        self._rows: list[list[str]] = []
        self._numbers: dict[str, Column] = {}
        if self._read_numbers():
            return
        self._read_cells()

    def _read_numbers(self) -> bool:
        """Read the text file by numpy, which is fast, and return whether this was possible.

        It is possible only if the file contains one header with unique names, and rows of plain numbers with decimal
        points, without blank lines. The word nan counts as a number, infinity does not. The import map must not give
        the names of the columns, a decimal comma or the delimiter "blank". Otherwise nothing is stored. An error of
        reading gives False too.
        """
        style = self._style
        if style.columns or style.decimal != "." or len(style.delimiter) != 1:
            return False
        try:
            with self.path.open(encoding=style.encoding, newline="") as file:
                for _ in range(style.skip_rows):
                    if not file.readline():
                        return False
                header = next(csv.reader([file.readline()], delimiter=style.delimiter), [])
                n_before = style.skip_rows + 1
                counter = count(n_before)
                first = file.readline()
                if not first.strip():
                    return False  # no rows: numpy would warn
                values = np.loadtxt(
                    (line for line, _ in zip(chain([first], file), counter, strict=False)),
                    delimiter=style.delimiter,
                    comments=None,
                    ndmin=2,
                )
        except (ValueError, UnicodeError, OSError, csv.Error):
            return False  # _read_cells reads the file, or raises the error
        names = [name.strip() for name in header]
        plain = all(names) and len(set(names)) == len(names) == values.shape[1] and names[0] not in _COMMENTS
        # numpy skips blank lines, after which the numbers of the lines would be wrong
        n_lines = next(counter) - n_before
        if not plain or not values.size or n_lines != len(values) or np.isinf(values).any():
            return False
        self._header = names
        self.lines = list(range(n_before + 1, n_before + 1 + n_lines))
        self._numbers = {name: np.ascontiguousarray(values[:, k]) for k, name in enumerate(names)}
        return True

    def _read_cells(self) -> None:
        """Read and store header and cells of the text file one by one, as text, behind the lines to skip.

        Cells and lines that were read before are replaced. Raise SeatrialError if the file cannot be read or is no
        table of this style.
        """
        path, style = self.path, self._style
        self.lines, self._rows = [], []
        try:
            with path.open(encoding=style.encoding, newline="") as file:
                for _ in range(style.skip_rows):
                    if not file.readline():  # the file ends before its header does
                        break
                self._read(file)
        except UnicodeError as error:
            name = "UTF-8" if style.encoding == "utf-8-sig" else style.encoding
            raise SeatrialError(
                f"{path}: is not {name} text ({getattr(error, 'reason', error)}); save it as UTF-8, or give its "
                'encoding in the import map, as csv.encoding = "latin-1" or "utf-16"'
            ) from error
        except csv.Error as error:
            raise SeatrialError(f"{path}: is not a CSV file: {error}; save it again as CSV") from error
        except OSError as error:
            raise SeatrialError(f"{path}: cannot be read: {error.strerror}; check its path and permissions") from error

    def _read(self, file: Iterable[str]) -> None:
        """Read and store header and rows of the text table from the lines of its file (behind the skipped lines).

        Comments and repeated headers are skipped, and below the header rows of units and, if the import map has the key
        `nan`, of words without digits. Surplus empty cells at the end of a line are cut off. The units are stored. A
        remark names columns that the header has twice. Lines with a wrong number of cells are left out with a remark,
        or raise SeatrialError (`_note_ragged_lines`). SeatrialError is also raised without a header or without rows.
        """
        watched = _WatchedLines(file)
        rows = _cells_of_lines(watched, self._style)
        header = list(self._style.columns) or next((cells for _, cells in rows), [])
        if not header:
            raise SeatrialError(f"{self.path}: the file is empty; give another file")
        first = next(rows, None)
        if first is not None and header[0].strip() in _COMMENTS and len(first[1]) == len(header) - 1:
            header = header[1:]  # a comment mark in front of the names
        self._header = [name.strip().replace("\r", "").replace("\n", " ") for name in header]
        width = len(header)
        ragged: list[tuple[int, int]] = []  # line and number of cells
        for line, cells in chain([first] if first else [], rows):
            names = [cell.strip().replace("\r", "").replace("\n", " ") for cell in cells]
            if names == self._header or names[1:] == self._header:
                continue  # the header again: the logger was restarted
            if is_comment(cells, width):
                continue
            if not self.lines and is_units_row(cells):
                self.units = self.units or {
                    name: found
                    for name, cell in zip(self._header, cells, strict=False)
                    if (found := without_brackets(cell))
                }
                continue
            if not self.lines and self._style.nan and is_subheading(cells):
                continue
            if len(cells) > width and not any(cell.strip() for cell in cells[width:]):
                cells = cells[:width]  # the rows end with separators, the header does not
            elif len(cells) == width - 1 and not self._header[-1]:
                cells.append("")  # the header ends with a separator, the rows do not
            if len(cells) != width:
                ragged.append((line + self._style.skip_rows, len(cells)))
                continue
            self.lines.append(line + self._style.skip_rows)
            self._rows.append(cells)
        if ragged:
            self._note_ragged_lines(ragged, watched.is_cut)
        if not self.lines:
            raise SeatrialError(f"{self.path}: no lines with data below the header; give a complete file")
        for name in {name for name in self._header if name and self._header.count(name) > 1}:
            self._add_remark(f"column '{name}' is {counted(self._header.count(name), 'time')} in the header: {_RENAME}")

    def _note_ragged_lines(self, ragged: Sequence[tuple[int, int]], is_cut: bool) -> None:
        """Add a remark about the lines of the text table whose number of cells differs from the header, or raise.

        `ragged` has line and number of cells of each. Raise SeatrialError if the import map does not have nan = "drop",
        or if these are more than 20 % of the lines. `is_cut` means that the last line of the file has no line end. If
        the last line is then the only one with a wrong number of cells, the remark reports this line as cut off.
        """
        line, n_cells = ragged[0]
        width, n = len(self._header), len(ragged)
        if self._style.nan != "drop" or n > MOST_RAGGED * (n + len(self.lines)):
            raise SeatrialError(
                f"{self.path}: line {line}: {counted(n_cells, 'value')}, but the header has {width}; check the "
                "delimiter in the import map, and whether the last line is cut off"
            )
        if n == 1 and is_cut and (not self.lines or line > self.lines[-1]):
            self._add_remark(f"line {line}, the last, is cut off and left out")
        else:
            fault = f"{counted(n_cells, 'value')}, but the header has {width}"
            self._add_remark(f"{counted(n, 'line')} left out; the first, line {line}, has {fault}")

    def _add_remark(self, text: str) -> None:
        """Add a text to the remark of the table, unless the remark contains it already."""
        if text not in self.remark:
            self.remark = "; ".join(part for part in (self.remark, text) if part)

    @property
    def names(self) -> list[str]:
        """Names of the columns of the text table, in the order of the header. They may repeat or be empty."""
        return self._header

    def __len__(self) -> int:
        """Return the number of rows of the text table, n, without header, comments and lines left out."""
        return len(self.lines)

    def text(self, column: str) -> list[str]:
        """Return the cells of a column of the text table as texts (n,).

        If numpy has read the file, so that its cells were not kept, the file is read again. Raise SeatrialError if the
        header lacks the column or has it twice.
        """
        if self._header.count(column) != 1:
            names = ", ".join(name or "(unnamed)" for name in self._header)
            if column in self._header:
                raise SeatrialError(f"{self.path}: column '{column}' appears twice in the header; {_RENAME}")
            raise SeatrialError(
                f"{self.path}: column '{column}' is not in the header; name one of these in the import map: {names}"
            )
        place = self._header.index(column)
        if not self._rows:  # numpy has read the numbers; the text of a cell is needed after all
            self._read_cells()
        return [cells[place] for cells in self._rows]

    def error(self, row: int, column: str, problem: str) -> SeatrialError:
        """Return an error that names the file, line and column of a cell. The caller raises the error.

        `row` is counted from 0 and is converted to the line, and `problem` is the text of the error.
        """
        return SeatrialError(f"{self.path}: line {self.lines[row]}, column '{column}': {problem}")

    def numbers(self, column: str) -> Column:
        """Return a column of the text table as numbers.

        Parameters
        ----------
        column
            Name of the column.

        Returns
        -------
        Column
            The numbers (n,), NaN for an empty cell or a word such as "nan". With ``nan = "drop"`` or ``"keep"`` also
            NaN for a cell of other text or with an infinite number.

        Raises
        ------
        SeatrialError
            If the header lacks the column or has it twice, or if a cell is other text or infinite. With ``nan =
            "drop"`` or ``"keep"``, such cells are an error only if the column has more of them than numbers.
        """
        if column not in self._numbers:
            self._numbers[column] = self._as_numbers(column)
        return self._numbers[column]

    def _as_numbers(self, column: str) -> Column:
        """Convert the cells of a column of the text table to numbers (n,).

        An empty cell, or a word such as "nan", becomes NaN. Other text and infinite numbers become NaN if the import
        map drops or keeps such cells (`nan`), with a remark. Raise SeatrialError otherwise, or if the column has more
        text than numbers.
        """
        cells = self._without_units(column, [cell.strip() for cell in self.text(column)])
        decimal = self._style.decimal
        # A comma in quotes, or in a table with decimal points, separates thousands.
        has_thousands = decimal == "." and (self._style.delimiter == "," or self._has_points())
        found, wrong = np.full(len(cells), math.nan), list[int]()
        try:
            found[:] = _numbers_of_plain_cells(cells, decimal)
        except ValueError:  # some cell is not a plain number: convert each cell separately
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
        if len(wrong) > MOST_TEXT * (len(wrong) + n_numbers):
            raise self.error(row, column, f"{problem}, nor are most cells; name another column in the import map")
        if self._style.nan not in ("drop", "keep"):
            raise self.error(
                row, column, f'{problem}; correct it, or leave it out by csv.nan = "drop" in the import map'
            )
        found[np.isinf(found)] = math.nan
        self._add_remark(
            f"line {self.lines[row]}, column '{column}': {problem}; {counted(len(wrong), 'such value')} left out"
        )
        return found

    def _has_points(self) -> bool:
        """Return whether any cell in the first 100 rows of the text table is a number with a decimal point.

        A comma in a number such as 1,500 then separates thousands.
        """
        return any(_POINT.fullmatch(cell.strip()) for cells in self._rows[:LOOKED_AT] for cell in cells)

    def _without_units(self, column: str, cells: list[str]) -> list[str]:
        """Return the cells of a column of a text table without their unit if all have the same unit (1.25 m).

        The unit is stored. Empty cells need no unit. Otherwise the cells are returned unchanged.
        """
        first = _WITH_UNIT.fullmatch(next((text for text in cells if text), ""))
        if first is None or not unit_of(first[2]):
            return cells
        end = first[2]
        if any(text and text.lower() not in _EMPTY and not text.endswith(end) for text in cells):
            return cells
        self.units = {**self.units, column: end}
        return [text.removesuffix(end).rstrip() for text in cells]


_RENAME = (
    'name the columns in the import map: csv.columns = ["...", ...], and csv.skip_rows larger by 1 to skip the header'
)


class _WatchedLines:
    """Iterator over the lines of a text file that notes whether the last line was cut off. Zero bytes are removed.

    Attributes
    ----------
    is_cut : bool
        Whether the last line so far has no line end; False before the first line.
    """

    def __init__(self, lines: Iterable[str]) -> None:
        """Prepare the iteration over the lines of a text file."""
        self._lines = lines
        self.is_cut = False

    def __iter__(self) -> Iterator[str]:
        """Yield each line of the file without zero bytes, and note whether it has a line end."""
        for line in self._lines:
            self.is_cut = not line.endswith(("\n", "\r"))
            yield line.replace("\0", "")  # zero bytes come from blocks of a card that were never written


def _numbers_of_plain_cells(cells: Sequence[str], decimal: str) -> list[float]:
    """Convert the cells of a column of a text table to numbers (n,). `decimal` is the decimal mark, "." or ",".

    Raise ValueError if a cell has an underscore, or if Python's `float` cannot read a cell with a point as decimal
    mark, for example an empty cell.
    """
    if any("_" in text for text in cells):  # Python's float also reads 1_000, which no instrument writes
        raise ValueError("_")
    return list(map(float, cells if decimal == "." else (text.replace(decimal, ".") for text in cells)))


def to_number(text: str, decimal: str, has_thousands: bool = False) -> float:
    """Convert the text of a cell of a text table to a number.

    Parameters
    ----------
    text
        The cell without blanks around it.
    decimal
        The decimal mark, "." or ",".
    has_thousands
        Whether a comma in a number without a decimal point, 1,500, separates thousands. In a number with a decimal
        mark, as 1,500.2, thousands may always be separated.

    Returns
    -------
    float
        The number, which may be infinite or NaN.

    Raises
    ------
    ValueError
        If the text is not a number.
    """
    if "_" in text:  # Python's float also reads 1_000, which no instrument writes
        raise ValueError(text)
    try:
        return float(text if decimal == "." else text.replace(decimal, "."))
    except ValueError:
        text = (
            text.replace("\u2212", "-").replace("\u202f", " ").replace("\u00a0", " ")
        )  # Unicode minus; narrow and fixed blanks
        if _THOUSANDS[decimal].fullmatch(text):
            text = re.sub("[. ]" if decimal == "," else ",", "", text)
        elif has_thousands and _WHOLE_THOUSANDS.fullmatch(text):
            text = text.replace(",", "")
        return float(text if decimal == "." else text.replace(decimal, "."))


def _cells_of_lines(file: Iterable[str], style: TextStyle) -> Iterator[tuple[int, list[str]]]:
    """Split the lines of a text table into cells. Yield the number, counted from 1, and the cells of each line.

    Lines without a filled cell are skipped. Cells keep the blanks around them unless the delimiter is "blank". The
    delimiter is that of `style`. For cells in quotes with line ends, the number is that of the last line.
    """
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
    """Return whether a line of a text table is a comment.

    Parameters
    ----------
    cells
        Cells of the line.
    width
        Number of cells of the header.

    Returns
    -------
    bool
        True if the line begins with #, or if it begins with % or // and has another number of cells than the header.
    """
    first = cells[0].strip()
    return first.startswith("#") or (first.startswith(_COMMENTS) and len(cells) != width)


def is_subheading(cells: Sequence[str]) -> bool:
    """Return whether a row below the header of a text table has words and no digits.

    Campbell loggers write such rows (Smp, Avg).
    """
    texts = [text for cell in cells if (text := cell.strip())]
    return not any(c.isdigit() for text in texts for c in text) and any(text.lower() not in _EMPTY for text in texts)


def without_brackets(cell: str) -> str:
    """Return a cell of a text table without blanks and brackets around it: "[m/s]" becomes "m/s"."""
    return cell.strip().strip("()[]{}<>").strip()


def is_units_row(cells: list[str]) -> bool:
    """Return whether a row of a text table contains the units of the columns.

    At least half of the filled cells must be known units, one of them another than "1" and "-". No other cell may
    contain a digit.
    """
    texts = [text for cell in cells if (text := without_brackets(cell))]
    known = [text for text in texts if unit_of(text)]
    values = [text for text in texts if text not in known and any(character.isdigit() for character in text)]
    return not values and 2 * len(known) >= len(texts) and any(text not in ("1", "-") for text in known)


def has_decimal_commas(head: bytes) -> bool:
    """Return whether a text table has the comma as delimiter and as decimal mark: its rows are longer than its header.

    Parameters
    ----------
    head
        First bytes of the file.

    Returns
    -------
    bool
        True if more than 90 % of the rows are numbers, and more than 90 % have more cells between commas than the
        header, but at most twice as many; False for fewer than 3 lines, or a header with another delimiter.
    """
    lines = head.decode("utf-8-sig", "ignore").splitlines()[:-1]
    widths = [line.count(",") + 1 for line in lines if line.strip()]
    if len(widths) < 3 or widths[0] < 2 or any(character in ";\t" for character in lines[0]):
        return False
    numeric = [line for line in lines[1:] if re.fullmatch(r"[-+0-9eE.,\s]+", line)]
    wider = sum(widths[0] < width <= 2 * widths[0] for width in widths[1:])
    return len(numeric) > 0.9 * (len(lines) - 1) and wider > 0.9 * (len(widths) - 1)


def wide_encoding(head: bytes) -> str:
    """Return the encoding of a text table with two bytes per character (UTF-16, Excel's "Unicode text").

    Parameters
    ----------
    head
        First bytes of the file.

    Returns
    -------
    str
        "utf-16", "utf-16-le" or "utf-16-be"; "" for other texts.
    """
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    first, second = head[::2], head[1::2]  # nearly all characters are ASCII, so one of the two bytes is zero
    for name, zeros, letters in (("utf-16-le", second, first), ("utf-16-be", first, second)):
        if zeros and zeros.count(0) > ASCII * len(zeros) and not letters.count(0):
            return name
    return ""


def sniff_style(path: Path, head: bytes) -> TextStyle | None:
    """Recognise delimiter, decimal mark, encoding and header of a text table.

    Parameters
    ----------
    path
        The file; not used.
    head
        First bytes of the file.

    Returns
    -------
    TextStyle or None
        The style with the most numbers; None if the text is not a table. The encoding is UTF-8, UTF-16, or else
        Latin-1. The last of several lines is not used, because it may be cut off.
    """
    encoding = wide_encoding(head) or "utf-8-sig"
    try:
        text = head.decode(encoding)
    except UnicodeDecodeError as error:
        encoding = encoding if error.start > len(head) - 4 else "latin-1"
        text = head.decode(encoding, "ignore")
    lines, places = _joined_quoted_lines(text.splitlines()[:-1] or text.splitlines())
    best: tuple[float, TextStyle] | None = None
    for delimiter in DELIMITERS:
        for decimal in (".", ","):
            found = _score_of_style(lines, TextStyle(delimiter, decimal, encoding))
            if found is not None and (best is None or found[0] > best[0]):
                best = found
    return None if best is None else replace(best[1], skip_rows=places[best[1].skip_rows])


def _joined_quoted_lines(lines: Sequence[str]) -> tuple[list[str], list[int]]:
    """Join the lines of a text to rows of a table. Return the rows, and the index of the line at which each begins.

    A row is a line, or up to 4 lines if a cell in quotes contains line ends, which stay in the row.
    """
    found: list[str] = []
    places: list[int] = []
    for place, line in enumerate(lines):
        if found and found[-1].count('"') % 2 and place - places[-1] < MOST_LINES:
            found[-1] += f"\n{line}"
        else:
            found.append(line)
            places.append(place)
    return found, places


def _score_of_style(lines: list[str], style: TextStyle) -> tuple[float, TextStyle] | None:
    """Return a score of how well the lines of a text are a table in this style, and the style with the header.

    The style has the number of lines before the header or, without a header, names column_1, column_2, ... None means
    that the lines are not a table in this style: no row has the usual number of cells and enough numbers, or fewer than
    80 % of the rows below the first such row have the usual number of cells. The score is the sum over the rows of the
    squared share of numbers times the number of cells.
    """
    rows = [next((cells for _, cells in _cells_of_lines(line.splitlines(keepends=True), style)), []) for line in lines]
    widths = Counter(len(cells) for cells in rows if cells).most_common(1)
    if not widths:
        return None
    width = widths[0][0]
    # A spreadsheet fills up the line of a title with separators; it has fewer filled cells than a row of data.
    last = [cells for cells in rows if len(cells) == width][-20:]
    least = min(_n_filled(cells) for cells in last) / 2
    least_share = max(
        LEAST_NUMERIC, LEAST_OF_USUAL * float(np.median([_share_of_numbers(cells, style) for cells in last]))
    )
    first = next(
        (
            k
            for k, cells in enumerate(rows)
            if len(cells) == width and _share_of_numbers(cells, style) >= least_share and _n_filled(cells) >= least
        ),
        None,
    )
    if first is None:
        return None
    body = [cells for cells in rows[first:] if cells and not is_comment(cells, width)]
    if sum(len(cells) == width for cells in body) < LEAST_SAME * len(body):
        return None
    shares = [_share_of_numbers(cells, style, with_times=False) for cells in body]
    score = sum(share**2 * len(cells) for share, cells in zip(shares, body, strict=True))
    open_rows = all(not cells[-1].strip() for cells in body if len(cells) == width)  # rows end with a separator
    above = _header_above(rows, first, width, open_rows, style)
    if above is not None:
        return score, TextStyle(style.delimiter, style.decimal, style.encoding, above)
    header = tuple(f"column_{k}" for k in range(1, width + 1))
    return score, TextStyle(style.delimiter, style.decimal, style.encoding, first, header)


def _header_above(rows: Sequence[list[str]], first: int, width: int, open_rows: bool, style: TextStyle) -> int | None:
    """Return the index of the header above the first row of data (index `first`) of a text; None without a header.

    Rows of units or of kinds of values, and comments, above the data are skipped. A header has `width` cells, or one
    less if all rows of data end with a separator (`open_rows`), or one more if its last cell is blank or its first is a
    comment mark. Fewer than 25 % of its cells are numbers.
    """
    above = [k for k in range(first) if rows[k]]
    while above:
        cells, n = rows[above[-1]], len(rows[above[-1]])
        is_named = n == width or (n == width - 1 and open_rows) or (n == width + 1 and not cells[-1].strip())
        is_named |= n == width + 1 and cells[0].strip() in _COMMENTS
        texts = [text for cell in cells if (text := cell.strip())]
        is_below = len(above) > 1 and (
            is_units_row(cells) or len(set(texts)) <= len(texts) / 2
        )  # units or kinds of values; the header is above them
        if not (is_below or (is_comment(cells, width) and not is_named)):
            return above[-1] if is_named and _share_of_numbers(cells, style) < LEAST_NUMERIC else None
        above.pop()
    return None


def _n_filled(cells: Sequence[str]) -> int:
    """Return the number of cells in a row of a text table that are not blank."""
    return sum(bool(cell.strip()) for cell in cells)


def _share_of_numbers(cells: Sequence[str], style: TextStyle, with_times: bool = True) -> float:
    """Return the share (0 to 1) of the cells of a row of a text that are numbers, empty, or (`with_times`) times.

    `style` has the decimal mark. The share is 0 if no cell is a number or a time. A number may have a known unit behind
    it.
    """
    n, empty = 0, 0
    for cell in cells:
        text = cell.strip()
        with_unit = _WITH_UNIT.fullmatch(text)
        if style.decimal == "," and _POINT.fullmatch(text):
            continue  # a decimal point is evidence for the other mark, although it could separate thousands
        try:
            to_number(with_unit[1] if with_unit and unit_of(with_unit[2]) else text, style.decimal)
            n += 1
        except ValueError:
            n += with_times and bool(_DATE_OR_CLOCK.fullmatch(text))
            empty += text.lower() in _EMPTY
    return (n + empty) / len(cells) if n else 0.0
