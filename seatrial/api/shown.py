"""Display of results in notebooks: one form for all results of the Python interface."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from seatrial.daq.errors import UnknownAttribute, closest_name

# Attributes of results in other libraries (statsmodels, scipy), and those with the same meaning here
OTHER_NAMES = {
    "bse": "standard_errors",
    "stderr": "standard_errors",
    "conf_int": "to_pandas",
    "pvalues": "to_pandas",
    "tvalues": "to_pandas",
    "llf": "log_likelihood",
    "loglik": "log_likelihood",
    "loglike": "log_likelihood",
    "cov_params": "cov_to_pandas",
    "resid": "residuals",
    "test_serial_correlation": "residual_tests",
    "test_normality": "residual_tests",
    "fittedvalues": "predict",
    "forecast": "predict",
    "x": "params",
}


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
    remarks : sequence of str
        Notes that are no warnings.
    """

    answer: str
    notes: Sequence[str] = ()
    columns: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    remarks: Sequence[str] = ()


class Shown:
    """Result that a notebook shows with its conclusion, its warnings and a table."""

    __slots__ = ()

    def __getattr__(self, name: str) -> Any:
        """Raise `UnknownAttribute`. The message has the attribute with this meaning, or with the most similar name."""
        raise unknown_attribute(self, name)

    def _content(self) -> Content:
        """Return the parts of the result that a notebook shows."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        """Return conclusion, warnings and table of the result as HTML, which a notebook shows."""
        return as_html(self._content())


def as_html(content: Content) -> str:
    """Return a content as HTML: the answer in bold, a paragraph for each warning, the table, and the remarks.

    Texts are escaped.
    """
    answer = f"<p><b>{html.escape(content.answer).replace(chr(10), '<br>')}</b></p>" if content.answer else ""
    notes = "".join(f"<p>⚠ {html.escape(note)}</p>" for note in content.notes)
    remarks = "".join(f"<p>{html.escape(remark)}</p>" for remark in content.remarks)
    if not content.columns:
        return answer + notes + remarks
    head = "".join(f"<th>{html.escape(c)}</th>" for c in content.columns)
    body = "".join(f"<tr>{''.join(f'<td>{html.escape(c)}</td>' for c in row)}</tr>" for row in content.rows)
    return f"{answer}{notes}<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{remarks}"


def number(value: float | None, digits: int = 4) -> str:
    """Return a number as text with significant digits, by default four; empty for None and NaN."""
    return "" if value is None or np.isnan(value) else f"{value:.{digits}g}"


def unknown_attribute(thing: object, name: str) -> UnknownAttribute:
    """Return the error about an attribute that a result lacks, with the one of this meaning or of a similar name.

    An attribute of `OTHER_NAMES` is suggested only if the result has it.
    """
    known = [n for n in dir(type(thing)) if not n.startswith("_")]
    same = OTHER_NAMES.get(name)
    near = same if same in known else closest_name(name, known)
    hint = f"; did you mean {near!r}?" if near and not name.startswith("_") else ""
    return UnknownAttribute(f"{type(thing).__name__!r} object has no attribute {name!r}{hint}", name=name, obj=None)
