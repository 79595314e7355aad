"""Error before and after, and the end of the page: next experiment, notes, how it was made."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ident.report import formatting
from ident.report.access import ROLES, Row, group, number, text, texts
from ident.report.blocks import Canvas, Cell, Facts, Lines, Prose, Section, Table, tabbed

KINDS = ("one_step", "ten_seconds", "free_run")
Titles = Sequence[tuple[str, str]]


def horizon(result: Row) -> str:
    """``10 s``: how far ahead predictions were judged, which they were where a result does not say."""
    return f"{number(result, 'horizon') or 10.0:g} s"


def horizons(result: Row) -> Titles:
    """Key and title of each kind of prediction."""
    return list(zip(KINDS, ("One step ahead", f"{horizon(result)} ahead", "Free-running"), strict=True))


def section(canvas: Canvas) -> Section:
    """One table for validation and one for estimation data."""
    both = group(canvas.result, "before_after")
    compared = any(
        number(row, "before") is not None
        for role in ROLES
        for key in KINDS
        for row in group(group(both, role), key).values()
        if isinstance(row, Mapping)
    )
    titles, table = horizons(canvas.result), _table if compared else _alone
    tabs = [(f"{role} data", table(group(both, role), titles)) for role in ROLES]
    lead = "Root mean square of measured less predicted."
    if compared:
        lead += " A ratio below 1 is an improvement."
    return Section("errors", "Error before and after" if compared else "Prediction error", tabbed(tabs), lead)


def _table(data: Row, titles: Titles) -> list[Any]:
    columns = (("channel", ""), ("before", "num"), ("after", "num"), ("unit", ""), ("ratio", "num"), ("95 %", "num"))
    return _grouped(data, titles, columns, _row)


def _alone(data: Row, titles: Titles) -> list[Any]:
    """Of one model: its error, and how much of what was measured it explains."""
    return _grouped(data, titles, (("channel", ""), ("error", "num"), ("unit", ""), ("fit", "num")), _single)


def _grouped(
    data: Row, titles: Titles, columns: tuple[tuple[str, str], ...], cells: Callable[[str, Row], list[Cell | str]]
) -> list[Any]:
    lines: list[list[Cell | str]] = []
    for key, title in titles:
        table = group(data, key)
        found = [cells(str(name), row) for name, row in table.items() if isinstance(row, Mapping)]
        lines += [[Cell(title, "group")], *found] if found else []
    return [Table(columns, lines)] if lines else []


def _single(channel: str, row: Row) -> list[Cell | str]:
    factor, unit = formatting.degrees_for(text(row, "unit"))
    error, spread = number(row, "after"), number(row, "spread")
    fit = None if error is None or not spread else 1 - error / spread
    return [
        formatting.named(channel),
        Cell("–" if error is None else formatting.plain(factor * error), "num"),
        Cell(unit, "nowrap"),
        Cell("–" if fit is None else f"{100 * fit:.0f} %", "num"),
    ]


def _row(channel: str, row: Row) -> list[Cell | str]:
    factor, unit = formatting.degrees_for(text(row, "unit"))
    before, after = (None if v is None else factor * v for v in (number(row, "before"), number(row, "after")))
    low, high = number(row, "low"), number(row, "high")
    ratio = after / before if before and after is not None else None
    sure = "" if ratio is None else "good" if high is not None and high < 1 else "bad" if low and low > 1 else ""
    mark = {"good": "▼ ", "bad": "▲ ", "": ""}[sure]
    return [
        formatting.named(channel),
        Cell(formatting.plain(before), "num"),
        Cell(formatting.plain(after), "num"),
        Cell(unit, "nowrap"),
        Cell("–" if ratio is None else f"{mark}{ratio:.2f}", f"num {sure}".strip()),
        Cell("–" if low is None or high is None else f"{low:.2f} to {high:.2f}", "num"),
    ]


def next_section(canvas: Canvas) -> Section:
    """What to run next."""
    words = text(canvas.result, "next_experiment")
    return Section("next", "Next experiment", [Prose(words, "callout")] if words else [])


def notes_section(canvas: Canvas) -> Section:
    """What was left out, what failed, what to know."""
    lines = texts(canvas.result, "notes")
    return Section("notes", "Notes", [Lines(lines)] if lines else [])


def made_section(canvas: Canvas) -> Section:
    """Command, version, time."""
    result = canvas.result
    facts = (
        ("Command", text(result, "command")),
        ("seatrial", text(result, "seatrial")),
        ("Time", formatting.moment(text(result, "created"))),
    )
    found = [(label, value) for label, value in facts if value]
    return Section("made", "How it was made", [Facts(found, "made")] if found else [])
