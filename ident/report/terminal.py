"""A result in about forty lines of a terminal, 80 columns wide."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from rich import box
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from ident.report import formatting
from ident.report.access import ROLES, Row, array, flag, group, number, rows, text, texts
from ident.report.sections.errors import horizons
from ident.report.sections.information import place
from ident.report.sections.profiles import interval
from ident.report.sections.search import threshold

MOST_PARAMETERS, MOST_CANDIDATES, MOST_CHANNELS, MOST_OUTAGES, MOST_STRETCHES = 9, 6, 8, 8, 24
MOST_NOISES = 12
EVEN = 1.05  # a standard error that grows by less without a stretch does not hang on it


def print_result(result: Mapping[str, Any], console: Console) -> None:
    """Print the answer, the parameters, the ranked candidates, and the error before and after."""
    console.print()
    console.print(Padding(Text(text(result, "answer"), style="bold"), (0, 1)))
    if text(result, "doubt"):
        console.print(Padding(Text(text(result, "doubt"), style="yellow"), (0, 1)))
    for line in texts(result, "cautions"):
        console.print(Padding(Text(f"⚠ {line}", style="yellow"), (0, 1)))
    tables = (_parameters, _profiles, _noise, _known, _stretches, _outages, _candidates, _errors)
    for table in (make(result) for make in tables):
        if table is not None:
            console.print()
            console.print(Padding(table, (0, 0, 0, 1)))
    console.print()


def _table(title: str) -> Table:
    style = {"title_justify": "left", "title_style": "bold cyan", "header_style": "dim", "border_style": "dim"}
    return Table(title=Text(title), box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, **style)  # type: ignore[arg-type]


def _scaled(row: Row, *keys: str) -> tuple[list[float | None], str]:
    factor, unit = formatting.degrees_for(text(row, "unit"))
    values = [number(row, key) for key in keys]
    return [None if v is None else factor * v for v in values], unit


def _parameters(result: Row) -> Table | None:
    """The effects' parameters first, then those of the dynamics; noise and fixed ones are for the report."""
    effects = [row for effect in rows(result, "effects") for row in rows(effect, "parameters")]
    own = {text(row, "name") for row in effects}
    fitted = [
        row
        for row in rows(group(result, "fit"), "parameters")
        if flag(row, "free") is not False and text(row, "name") not in own and "noise" not in text(row, "meaning")
    ]
    found = effects + fitted
    if not found:
        return None
    shown = found[:MOST_PARAMETERS]
    more = f" ({len(found) - len(shown)} more in the report)" if len(found) > len(shown) else ""
    table = _table(f"Parameters{more}")
    table.add_column("", no_wrap=True)
    table.add_column("value ± s.e.", justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("", style="dim", overflow="fold")  # a flag may be a sentence: it wraps, the numbers do not
    for row in shown:
        (value, se), unit = _scaled(row, "value", "se")
        name = Text(text(row, "name"), style="bold green" if text(row, "name") in own else "bold")
        words = f"⚠ {text(row, 'flag')}" if text(row, "flag") else text(row, "meaning")
        table.add_row(name, Text(formatting.with_error(value, se)), Text(unit), Text(words))
    return table


def _profiles(result: Row) -> Table | None:
    """The intervals that were asked for; the curves are for the report."""
    found = rows(result, "profiles")
    if not found:
        return None
    table = _table("Profile likelihood")
    table.add_column("", no_wrap=True, style="bold")
    for title in ("value", "95 % by profile", "95 % by s.e."):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("", style="dim", overflow="fold")
    for row in found:
        (value, *ends), unit = _scaled(row, "value", "low", "high", "wald_low", "wald_high")
        spans = [interval(*pair) for pair in (ends[:2], ends[2:])]
        words = [text(row, "name"), formatting.plain(value), *spans, unit, "; ".join(texts(row, "notes"))]
        table.add_row(*(Text(word) for word in words))
    return table


def _noise(result: Row) -> Table | None:
    found = rows(result, "noise")
    if not found:
        return None
    shown = sorted(found, key=lambda row: flag(row, "accepted") is not False)[:MOST_NOISES]
    left = f" ({len(found) - len(shown)} more in the report)" if len(found) > len(shown) else ""
    table = _table(f"Noise{left}")
    table.add_column("", no_wrap=True, overflow="ellipsis")
    for title in ("white", "random walk, per √s"):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("R²", justify="right", no_wrap=True)
    table.add_column("model", no_wrap=True)
    for row in shown:
        (white, se_white, walk, se_walk), unit = _scaled(row, "white", "se_white", "walk", "se_walk")
        verdict = {True: Text("holds", "green"), False: Text("fails", "bold red"), None: Text("–")}[
            flag(row, "accepted")
        ]
        texts = (text(row, "channel"), formatting.with_error(white, se_white), formatting.with_error(walk, se_walk))
        more = (unit, formatting.percent(number(row, "predictable"), 1))
        table.add_row(*(Text(words) for words in texts + more), verdict)
    return table


def _outages(result: Row) -> Table | None:
    found = rows(result, "outages")
    if not found:
        return None
    shown = sorted(found, key=lambda row: -(number(group(row, "at_end"), "radius") or 0.0))[:MOST_OUTAGES]
    table = _table("GNSS outages" if len(shown) == len(found) else f"GNSS outages ({len(shown)} worst of {len(found)})")
    table.add_column("", no_wrap=True, overflow="ellipsis")
    for title in ("from [s]", "for [s]", "95 % radius [m]", "off by [m]", "allowed [m]"):
        table.add_column(Text(title), justify="right", no_wrap=True)
    for row in shown:
        values = (number(row, "start"), number(row, "duration"), number(group(row, "at_end"), "radius"))
        words = [formatting.plain(value) for value in (*values, number(row, "error"), number(row, "allowed"))]
        outside = flag(row, "inside") is False
        table.add_row(Text(text(row, "record")), *(Text(word) for word in words), style="bold red" if outside else "")
    return table


def _known(result: Row) -> Table | None:
    """What logs already taken tell of each parameter, and the stretch that it hangs on."""
    found = rows(group(result, "information"), "parameters")
    if not found:
        return None
    table = _table("What these logs tell")
    table.add_column("", no_wrap=True)
    table.add_column("value ± s.e.", justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("hangs most on", style="dim", no_wrap=True, overflow="ellipsis", max_width=32)
    table.add_column("× without", justify="right", no_wrap=True)
    for row in found:
        (value, se), unit = _scaled(row, "value", "se")
        shown = formatting.with_error(value, se) if se is not None else "nothing"
        where = place(row) if se is not None else ""
        weight = _times(row.get("weight"))
        table.add_row(Text(text(row, "name"), style="bold"), Text(shown), Text(unit), Text(where), Text(weight))
    return table


def _stretches(result: Row) -> Table | None:
    """How many times as large each standard error would be without each stretch."""
    part = group(result, "information")
    names, found = texts(part, "names"), rows(part, "stretches")
    if not found:
        return None
    weights = [array(row, "weight") for row in found]
    shown = names[:MOST_PARAMETERS]
    title = "Without a stretch, standard errors grow by ×"
    if len(found) > MOST_STRETCHES or len(names) > len(shown):
        title += f" (first {min(len(found), MOST_STRETCHES)} of {len(found)}; all in the report)"
    table = _table(title)
    table.padding = (0, 1, 0, 0)
    table.add_column("", style="dim", no_wrap=True, overflow="ellipsis", max_width=26)
    for name in shown:
        table.add_column(name, justify="right", no_wrap=True, min_width=4)
    for row, weight in list(zip(found, weights, strict=True))[:MOST_STRETCHES]:
        values = [None] * len(shown) if weight is None else weight[: len(shown)].tolist()
        cells = [Text(_times(v), style="dim" if v is not None and v < EVEN else "bold green") for v in values]
        table.add_row(Text(place(row)), *cells)
    return table


def _times(weight: float | None) -> str:
    """``all``: only this stretch tells; a dash: nothing tells."""
    if weight is None or math.isnan(weight):
        return "–"
    return "all" if math.isinf(weight) else "·" if weight < EVEN else formatting.plain(weight, 2)


def _candidates(result: Row) -> Table | None:
    found = [row for row in rows(result, "rounds") if rows(row, "candidates")]
    if not found:
        return None
    every = rows(found[0], "candidates")
    chosen = [text(row, "chosen") for row in found if text(row, "chosen")]
    table = _table(f"Candidates, first round ({min(len(every), MOST_CANDIDATES)} of {len(every)})")
    table.add_column("", no_wrap=True)
    table.add_column("", no_wrap=True, overflow="ellipsis", max_width=38)
    for title in ("score", "threshold", "p by blocks"):
        table.add_column(title, justify="right", no_wrap=True)
    for row in every[:MOST_CANDIDATES]:
        won, passed = text(row, "name") in chosen, flag(row, "passed") is True
        style = "bold green" if won else "" if passed else "dim"
        numbers = (
            formatting.plain(number(row, "lm")),
            formatting.plain(threshold(row, len(every))),
            formatting.probability(number(row, "p_block")),
        )
        mark = "✓" if won else "·" if passed else " "
        words = (mark, text(row, "title") or text(row, "name"), *numbers)
        table.add_row(*(Text(part) for part in words), style=style)
    return table


def _errors(result: Row) -> Table | None:
    both = group(result, "before_after")
    role = next((role for role in ROLES if group(both, role)), None)
    if role is None:
        return None
    data = group(both, role)
    kinds = [(title, group(data, key)) for key, title in horizons(result) if group(data, key)]
    channels = list(dict.fromkeys(str(name) for _, table in kinds for name in table))[:MOST_CHANNELS]
    if not channels:
        return None
    compared = any(number(group(t, c), "before") is not None for _, t in kinds for c in channels)
    table = _table(f"Error before → after, {role} data" if compared else f"Prediction error (rms), {role} data")
    table.add_column("", no_wrap=True)
    table.add_column("", no_wrap=True, style="dim")
    for title, _ in kinds:
        table.add_column(title.lower(), justify="right", no_wrap=True)
    for channel in channels:
        found = [group(table_, channel) for _, table_ in kinds]
        unit = next((_scaled(row)[1] for row in found if text(row, "unit")), "")
        table.add_row(Text(channel, style="bold"), Text(unit), *(_step(row) for row in found))
    return table


def _step(row: Row) -> Text:
    (before, after), _ = _scaled(row, "before", "after")
    if before is None or after is None:
        return Text(formatting.plain(after))
    color = "green" if after < 0.98 * before else "red" if after > 1.02 * before else ""
    return Text.assemble(f"{formatting.plain(before)} → ", (formatting.plain(after), color))
