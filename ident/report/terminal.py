"""A result in about forty lines of a terminal, 80 columns wide."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from seatrial.ident.report import formatting
from seatrial.ident.report.sections.parameters import interval, place
from seatrial.ident.report.sections.predictions import by_role, error_words, horizons
from seatrial.ident.results import (
    DiagnosisResult,
    EffectParameter,
    EffectRow,
    ErrorComparison,
    Errors,
    FitResult,
    FitSummary,
    ForceScale,
    InformationResult,
    NavigationResult,
    NoiseResult,
    ParameterRow,
    ProfileCurve,
    Result,
    ThrusterResult,
    VehicleResult,
)

MOST_OUTAGES, MOST_SEGMENTS, MOST_NOISES = 8, 24, 12
EVEN = 1.05  # a standard error that grows by less without a segment does not hang on it


def titled_table(title: str) -> Table:
    """An empty table in the style of all of them."""
    style = {"title_justify": "left", "title_style": "bold cyan", "header_style": "dim", "border_style": "dim"}
    return Table(title=Text(title), box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, **style)  # type: ignore[arg-type]


def tables_of(result: Result) -> list[Table]:
    """What the terminal shows of a result below its answer."""
    if isinstance(result, NoiseResult):
        return [noise_table(result)]
    if isinstance(result, NavigationResult):
        return [outage_table(result)] if result.outages else []
    if isinstance(result, InformationResult):
        return [parameter_table(result), segment_table(result)]
    return []


def noise_table(result: NoiseResult) -> Table:
    """White noise and random walk of each channel, those first whose model fails."""
    shown = sorted(result.noise, key=lambda c: c.accepted)[:MOST_NOISES]
    left = f" ({len(result.noise) - len(shown)} more in the report)" if len(result.noise) > len(shown) else ""
    table = titled_table(f"Noise{left}")
    table.add_column("", no_wrap=True, overflow="ellipsis")
    for title in ("white", "random walk, per √s"):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("R²", justify="right", no_wrap=True)
    table.add_column("model", no_wrap=True)
    for c in shown:
        factor, unit = formatting.degrees_for(c.unit)
        white = formatting.noise_level(c.white, c.se_white, c.white_limit, factor)
        random_walk = formatting.noise_level(c.random_walk, c.se_random_walk, c.random_walk_limit, factor)
        words = (c.channel, white, random_walk, unit, formatting.percent(c.predictable, 1))
        verdict = Text("holds", "green") if c.accepted else Text("fails", "bold red")
        table.add_row(*(Text(word) for word in words), verdict)
    return table


def outage_table(result: NavigationResult) -> Table:
    """The worst GNSS outages."""
    found = result.outages
    shown = sorted(found, key=lambda o: -o.at_end.radius)[:MOST_OUTAGES]
    worst = "" if len(shown) == len(found) else f" ({len(shown)} worst of {len(found)})"
    table = titled_table(f"GNSS outages{worst}")
    table.add_column("", no_wrap=True, overflow="ellipsis")
    for title in ("from [s]", "for [s]", "95 % radius [m]", "off by [m]", "allowed [m]"):
        table.add_column(Text(title), justify="right", no_wrap=True)
    for o in shown:
        words = [f"{o.start:.0f}", *(formatting.plain(v) for v in (o.duration, o.at_end.radius, o.error, o.allowed))]
        style = "bold red" if o.inside is False else ""
        table.add_row(Text(o.record), *(Text(word) for word in words), style=style)
    return table


def parameter_table(result: InformationResult) -> Table:
    """What logs already taken tell of each parameter, and the segment that it hangs on."""
    table = titled_table("What these logs tell")
    table.add_column("", no_wrap=True)
    table.add_column("value ± s.e.", justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("hangs most on", style="dim", no_wrap=True, overflow="ellipsis", max_width=32)
    table.add_column("× without", justify="right", no_wrap=True)
    for p in result.information.parameters:
        factor, unit = formatting.degrees_for(p.unit)
        shown, where, times = "nothing", "", "–"
        if p.se is not None:
            shown, where = formatting.with_error(factor * p.value, factor * p.se), place(p)
            times = _times(math.inf if p.weight is None else p.weight)
        table.add_row(Text(p.name, style="bold"), Text(shown), Text(unit), Text(where), Text(times))
    return table


def segment_table(result: InformationResult) -> Table:
    """How many times as large each standard error would be without each segment."""
    names, found = result.information.names, result.information.segments
    shown = names[:MOST_PARAMETERS]
    title = "Without a segment, standard errors grow by ×"
    if len(found) > MOST_SEGMENTS or len(names) > len(shown):
        title += f" (first {min(len(found), MOST_SEGMENTS)} of {len(found)}; all in the report)"
    table = titled_table(title)
    table.padding = (0, 1, 0, 0)
    table.add_column("", style="dim", no_wrap=True, overflow="ellipsis", max_width=26)
    for name in shown:
        table.add_column(name, justify="right", no_wrap=True, min_width=4)
    for row in found[:MOST_SEGMENTS]:
        values: Sequence[float] = row.weight[: len(shown)].tolist()
        cells = [Text(_times(v), style="dim" if v < EVEN else "bold green") for v in values]
        table.add_row(Text(place(row)), *cells)
    return table


def _times(weight: float) -> str:
    """``all``: only this segment tells; a dash: nothing tells."""
    if math.isnan(weight):
        return "–"
    return "all" if math.isinf(weight) else "·" if weight < EVEN else formatting.plain(weight, 2)


MOST_PARAMETERS, MOST_CANDIDATES, MOST_CHANNELS = 9, 6, 8


def print_result(result: Result, console: Console) -> None:
    """Print the answer, the parameters, the ranked candidates, and the error before and after."""
    console.print()
    for warning in result.warnings:
        console.print(Padding(Text(f"⚠ {warning.text}", style="yellow"), (0, 1)))
    failed = isinstance(result, FitResult) and not result.converged
    answer = Text(f"⚠ {result.answer}", "bold yellow") if failed else Text(result.answer, "bold")
    console.print(Padding(answer, (0, 1)))
    if isinstance(result, DiagnosisResult) and result.caveat:
        console.print(Padding(Text(result.caveat, style="yellow"), (0, 1)))
    for table in _tables(result):
        if table is not None:
            console.print()
            console.print(Padding(table, (0, 0, 0, 1)))
    console.print()


def _tables(result: Result) -> Sequence[Table | None]:
    if not isinstance(result, FitResult):
        return tables_of(result)
    diagnosis = result if isinstance(result, DiagnosisResult) else None
    return [
        _parameters(result.fit, diagnosis.effects if diagnosis else ()),
        _profiles(result.profiles if isinstance(result, VehicleResult | ThrusterResult) else ()),
        _candidates(diagnosis) if diagnosis else None,
        _errors(result.errors, result.horizon_seconds),
    ]


def _parameters(fit: FitSummary, added: Sequence[EffectRow]) -> Table | None:
    """The effects' parameters first, then those of the dynamics; noise and fixed ones are for the report."""
    effects = [row for effect in added for row in effect.parameters]
    own = {row.name for row in effects}
    fitted = [row for row in fit.parameters if row.free and row.name not in own and "noise" not in row.meaning]
    fitted.sort(key=lambda row: row.record is not None)  # those of single runs last
    found: list[EffectParameter | ParameterRow] = [*effects, *fitted]
    if not found:
        return None
    shown = found[:MOST_PARAMETERS]
    more = f" ({len(found) - len(shown)} more in the report)" if len(found) > len(shown) else ""
    table = titled_table(f"Parameters{more}")
    table.add_column("", no_wrap=True)
    table.add_column(error_title(fit.scale), justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("", style="dim", overflow="fold")  # a flag may be a sentence: it wraps, the numbers do not
    for row in shown:
        factor, unit = formatting.degrees_for(row.unit)
        value, se = formatting.scaled(factor, row.value, row.se)
        name = Text(row.name, style="bold green" if row.name in own else "bold")
        flag, record = (row.flag, row.record) if isinstance(row, ParameterRow) else (None, None)
        words = f"⚠ {flag}" if flag else row.meaning + (f", {record}" if record else "")
        table.add_row(name, Text(formatting.with_error(value, se)), Text(unit), Text(words))
    return table


def error_title(scale: ForceScale) -> str:
    """Of the column of standard errors: whether they know of the thrust's own uncertainty."""
    return "value ± s.e. (statistical only)" if scale.statistical_only else "value ± s.e."


def _profiles(found: Sequence[ProfileCurve]) -> Table | None:
    """The intervals that were asked for; the curves are for the report."""
    if not found:
        return None
    table = titled_table("Profile likelihood")
    table.add_column("", no_wrap=True, style="bold")
    for title in ("value", "95 % by profile", "95 % by s.e."):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("", style="dim", overflow="fold")
    for row in found:
        factor, unit = formatting.degrees_for(row.unit)
        spans = [
            interval(*formatting.scaled(factor, *ends)) for ends in ((row.low, row.high), (row.wald_low, row.wald_high))
        ]
        words = [row.name, formatting.plain(factor * row.value), *spans, unit, "; ".join(row.notes)]
        table.add_row(*(Text(word) for word in words))
    return table


def _candidates(result: DiagnosisResult) -> Table | None:
    found = [row for row in result.rounds if row.candidates]
    if not found:
        return None
    every, removed = found[0].candidates, {row.name for row in result.removed_effects}
    chosen = {row.chosen for row in found} - removed
    shown = every[:MOST_CANDIDATES]
    title = f"First round: {found[0].passed} of {found[0].tested} candidates passed the score test, {len(shown)} best"
    table = titled_table(title)
    legend = ["✓ added to the model", *["− added and removed again"] * bool(removed), "· passed", "(blank) not passed"]
    table.caption, table.caption_justify = "   ".join(legend), "left"
    table.add_column("", no_wrap=True)
    table.add_column("", no_wrap=True, overflow="ellipsis", max_width=38)
    for title in ("score", "threshold", "p by blocks"):
        table.add_column(title, justify="right", no_wrap=True)
    for row in shown:
        won = row.name in chosen
        style = "bold green" if won else "" if row.passed else "dim"
        numbers = (formatting.plain(row.lm), formatting.plain(row.threshold), formatting.probability(row.p_block))
        mark = "✓" if won else "−" if row.name in removed else "·" if row.passed else " "
        table.add_row(*(Text(part) for part in (mark, row.title or row.name, *numbers)), style=style)
    return table


def _errors(errors: Errors, seconds: float) -> Table | None:
    role, data = by_role(errors.validation, errors.estimation)[0]
    kinds = [(title, table) for title, table in horizons(data, seconds) if table]
    every = list(dict.fromkeys(name for _, table in kinds for name in table))
    channels = every[:MOST_CHANNELS]
    if not channels:
        return None
    more = f" ({len(every) - len(channels)} more in the report)" if len(every) > len(channels) else ""
    compared = any(table[c].before is not None for _, table in kinds for c in channels if c in table)
    what = "Error before → after" if compared else "Prediction error (rms)"
    table = titled_table(f"{what}, {role} data{more}")
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
        return Text("" if row is None else error_words(after))
    color = {"fell": "green", "rose": "red"}.get(row.verdict or "" if row else "", "")
    return Text.assemble(f"{formatting.plain(before)} → ", (formatting.plain(after), color))
