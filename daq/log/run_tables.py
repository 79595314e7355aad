"""Folder of a run: text tables beside each other that have other columns and the same times."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

MOST_FILES = 50  # in a folder that is searched
END_BYTES = 4096  # at the end of a table, in which its last line is
_Ends = tuple[str, float, float] | tuple[str, str, str]  # header line, first and last time
SAME_ENDS = 0.05  # of the longer of two tables of one run, by which their begins and their ends may differ


def run_folder_of(path: Path) -> Path | None:
    """Return the folder of a text table if it has further tables of the same run; else None.

    These have the same ending, another header line, and times that overlap with those of the table, judged by the first
    cells of the first and the last row. They are compared as numbers, or as text such as dates. Times that count from
    the start of a table overlap with those of any other such table. They show a run only if both tables begin and end
    together, and if the folder has as many tables of the one header line as of the other: several tables of equal
    columns beside one of others are runs, and the other one may be of a bench. The importers compare
    files better (`run_files`), but this package is below them, and they read whole files. This test reads the ends of
    the files only, for the advice of a message.
    """
    own = _ends(path)
    if own is None:
        return None
    try:
        beside = [file for file in path.parent.iterdir() if file.suffix == path.suffix and file != path]
    except OSError:
        return None
    found = [other for file in beside[:MOST_FILES] if (other := _ends(file)) is not None]
    n_of = Counter(header for header, _, _ in (own, *found))
    for other in found:
        if other[0] == own[0] or type(other[1]) is not type(own[1]):
            continue
        if _is_relative(own) and _is_relative(other):
            if n_of[own[0]] == n_of[other[0]] and _has_same_ends(own, other):
                return path.parent
        elif own[1] < other[2] and other[1] < own[2]:  # type: ignore[operator]  # of equal types
            return path.parent
    return None


def _is_relative(ends: _Ends) -> bool:
    """Return whether the times of a table count from its start: they begin before they are longer than the table."""
    _, begin, end = ends
    return isinstance(begin, float) and isinstance(end, float) and 0.0 <= begin < end - begin


def _has_same_ends(one: _Ends, other: _Ends) -> bool:
    """Return whether two tables with relative times begin and end together."""
    (begin, end), (other_begin, other_end) = (map(float, ends[1:]) for ends in (one, other))
    tolerance = SAME_ENDS * max(end - begin, other_end - other_begin)
    return abs(begin - other_begin) <= tolerance and abs(end - other_end) <= tolerance


def _ends(path: Path) -> _Ends | None:
    """Return the header line of a text table, and the first cells of its first and last row, as numbers if they are.

    None for a file that cannot be read, is no text or has fewer than three lines.
    """
    try:
        with path.open("rb") as file:
            head, first = (file.readline(END_BYTES).decode().strip() for _ in range(2))
            file.seek(max(file.tell(), os.fstat(file.fileno()).st_size - END_BYTES))
            lines = file.read().decode(errors="ignore").strip().splitlines()
    except (OSError, UnicodeDecodeError):
        return None
    separator = next((sign for sign in ",;\t" if sign in head), None)
    if separator is None or not lines:
        return None
    begin, end = (line.partition(separator)[0].strip() for line in (first, lines[-1]))
    try:
        return head, float(begin), float(end)
    except ValueError:
        return head, begin, end
