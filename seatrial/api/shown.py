"""Display of results in notebooks: one form for all results of the Python interface."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Content(NamedTuple):
    """Content of a result that a notebook shows.

    Attributes
    ----------
    answer : str
        Main conclusion; empty without one.
    notes : sequence of str
        Warnings.
    columns : sequence of str
        Titles of the table; empty without a table.
    rows : sequence of sequences of str
        Cells of the table.
    """

    answer: str
    notes: Sequence[str] = ()
    columns: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()


class Shown:
    """Result that a notebook shows with its conclusion, its warnings and a table."""

    __slots__ = ()

    def _content(self) -> Content:
        """Return what a notebook shows of the result."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        """Return conclusion, warnings and table of the result as HTML, which a notebook shows."""
        return as_html(self._content())


def as_html(content: Content) -> str:
    """Return a content as HTML: the answer in bold, a paragraph for each warning, and the table. Texts are escaped."""
    answer = f"<p><b>{html.escape(content.answer)}</b></p>" if content.answer else ""
    notes = "".join(f"<p>⚠ {html.escape(note)}</p>" for note in content.notes)
    if not content.columns:
        return answer + notes
    head = "".join(f"<th>{html.escape(c)}</th>" for c in content.columns)
    body = "".join(f"<tr>{''.join(f'<td>{html.escape(c)}</td>' for c in row)}</tr>" for row in content.rows)
    return f"{answer}{notes}<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def number(value: float | None, digits: int = 4) -> str:
    """Return a number as text with significant digits, by default four; empty for None and NaN."""
    return "" if value is None or np.isnan(value) else f"{value:.{digits}g}"
