"""A result in about forty lines of a terminal, 80 columns wide."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from ident.report import formatting
from ident.report.access import Row, array, flag, group, number, rows, text, texts
from ident.report.sections.errors import by_role, horizons
from ident.report.sections.information import place
from ident.report.sections.profiles import interval
from ident.results import (
    DiagnosisResult,
    EffectParameter,
    EffectRow,
    ErrorComparison,
    Errors,
    FitResult,
    FitSummary,
    ParameterRow,
    ProfileCurve,
    Result,
    Round,
    ThrusterResult,
    VehicleResult,
)

MOST_PARAMETERS, MOST_CANDIDATES, MOST_CHANNELS, MOST_OUTAGES, MOST_STRETCHES = 9, 6, 8, 8, 24
MOST_NOISES = 12
EVEN = 1.05  # a standard error that grows by less without a stretch does not hang on it


def print_result(result: Result | Row, console: Console) -> None:
    """Print the answer, the parameters, the ranked candidates, and the error before and after."""
    console.print()
    if isinstance(result, Result):
        answer, warnings, tables = result.answer, list(result.warnings), _tables(result)
        caveat = result.caveat if isinstance(result, DiagnosisResult) else None
    else:
        answer, warnings, caveat = text(result, "answer"), texts(result, "cautions"), None
        tables = [make(result) for make in (_noise, _known, _stretches, _outages)]
    console.print(Padding(Text(answer, style="bold"), (0, 1)))
    for line in (*([caveat] if caveat else []), *(f"⚠ {line}" for line in warnings)):
        console.print(Padding(Text(line, style="yellow"), (0, 1)))
    for table in tables:
        if table is not None:
            console.print()
            console.print(Padding(table, (0, 0, 0, 1)))
    console.print()


def _tables(result: Result) -> list[Table | None]:
    if not isinstance(result, FitResult):
        return []
    diagnosis = result if isinstance(result, DiagnosisResult) else None
    return [
        _parameters(result.fit, diagnosis.effects if diagnosis else ()),
        _profiles(result.profiles if isinstance(result, VehicleResult | ThrusterResult) else ()),
        _candidates(diagnosis.rounds if diagnosis else ()),
        _errors(result.errors, result.horizon_seconds),
    ]


def _table(title: str) -> Table:
    style = {"title_justify": "left", "title_style": "bold cyan", "header_style": "dim", "border_style": "dim"}
    return Table(title=Text(title), box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, **style)  # type: ignore[arg-type]


def _scaled(row: Row, *keys: str) -> tuple[list[float | None], str]:
    factor, unit = formatting.degrees_for(text(row, "unit"))
    values = [number(row, key) for key in keys]
    return [None if v is None else factor * v for v in values], unit


def _parameters(fit: FitSummary, added: Sequence[EffectRow]) -> Table | None:
    """The effects' parameters first, then those of the dynamics; noise and fixed ones are for the report."""
    effects = [row for effect in added for row in effect.parameters]
    own = {row.name for row in effects}
    fitted = [row for row in fit.parameters if row.free and row.name not in own and "noise" not in row.meaning]
    found: list[EffectParameter | ParameterRow] = [*effects, *fitted]
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
        factor, unit = formatting.degrees_for(row.unit)
        value, se = formatting.scaled(factor, row.value, row.se)
        name = Text(row.name, style="bold green" if row.name in own else "bold")
        flag = row.flag if isinstance(row, ParameterRow) else None
        words = f"⚠ {flag}" if flag else row.meaning
        table.add_row(name, Text(formatting.with_error(value, se)), Text(unit), Text(words))
    return table


def _profiles(found: Sequence[ProfileCurve]) -> Table | None:
    """The intervals that were asked for; the curves are for the report."""
    if not found:
        return None
    table = _table("Profile likelihood")
    table.add_column("", no_wrap=True, style="bold")
    for title in ("value", "95 % by profile", "95 % by s.e."):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("", style="dim", overflow="fold")
    for row in found:
        factor, unit = formatting.degrees_for(row.unit)
        spans = [
            interval(*formatting.scaled(factor, *ends))
            for ends in ((row.low, row.high), (row.wald_low, row.wald_high))
        ]
        words = [row.name, formatting.plain(factor * row.value), *spans, unit, "; ".join(row.notes)]
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


def _candidates(rounds: Sequence[Round]) -> Table | None:
    found = [row for row in rounds if row.candidates]
    if not found:
        return None
    every = found[0].candidates
    chosen = [row.chosen for row in found if row.chosen]
    table = _table(f"Candidates, first round ({min(len(every), MOST_CANDIDATES)} of {len(every)})")
    table.add_column("", no_wrap=True)
    table.add_column("", no_wrap=True, overflow="ellipsis", max_width=38)
    for title in ("score", "threshold", "p by blocks"):
        table.add_column(title, justify="right", no_wrap=True)
    for row in every[:MOST_CANDIDATES]:
        won = row.name in chosen
        style = "bold green" if won else "" if row.passed else "dim"
        numbers = (
            formatting.plain(row.lm), formatting.plain(row.threshold), formatting.probability(row.p_block)
        )
        mark = "✓" if won else "·" if row.passed else " "
        table.add_row(*(Text(part) for part in (mark, row.title or row.name, *numbers)), style=style)
    return table


def _errors(errors: Errors, seconds: float) -> Table | None:
    role, data = by_role(errors.validation, errors.estimation)[0]
    kinds = [(title, table) for title, table in horizons(data, seconds) if table]
    channels = list(dict.fromkeys(name for _, table in kinds for name in table))[:MOST_CHANNELS]
    if not channels:
        return None
    compared = any(table[c].before is not None for _, table in kinds for c in channels if c in table)
    table = _table(f"Error before → after, {role} data" if compared else f"Prediction error (rms), {role} data")
    table.add_column("", no_wrap=True)
    table.add_column("", no_wrap=True, style="dim")
    for title, _ in kinds:
        table.add_column(title.lower(), justify="right", no_wrap=True)
    for channel in channels:
        found = [rows_.get(channel) for _, rows_ in kinds]
        unit = next(formatting.degrees_for(row.unit)[1] for row in found if row is not None)
        table.add_row(Text(channel, style="bold"), Text(unit), *(_step(row) for row in found))
    return table


def _step(row: ErrorComparison | None) -> Text:
    factor = 1.0 if row is None else formatting.degrees_for(row.unit)[0]
    before, after = (None, None) if row is None else formatting.scaled(factor, row.before, row.after)
    if before is None or after is None:
        return Text(formatting.plain(after))
    color = "green" if after < 0.98 * before else "red" if after > 1.02 * before else ""
    return Text.assemble(f"{formatting.plain(before)} → ", (formatting.plain(after), color))
