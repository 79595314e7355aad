"""Tables for the terminal: noise, information and navigation."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich import box
from rich.table import Table
from rich.text import Text

from ident.report import formatting
from ident.report.sections.information import place
from ident.results import InformationResult, NavigationResult, NoiseResult, Result

MOST_PARAMETERS, MOST_OUTAGES, MOST_SEGMENTS, MOST_NOISES = 9, 8, 24, 12
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
        white, random_walk = (
            formatting.with_error(factor * value, None if se is None else factor * se)
            for value, se in ((c.white, c.se_white), (c.random_walk, c.se_random_walk))
        )
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
        words = [formatting.plain(v) for v in (o.start, o.duration, o.at_end.radius, o.error, o.allowed)]
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
