"""The search: what was tried in each round, what was chosen and why, and the forces that were unexplained."""

from __future__ import annotations

import math
from typing import Any

from scipy import special

from ident.report import drawing, formatting
from ident.report.access import RecordTab, Row, along, array, flag, number, of_take, rows, takes, text
from ident.report.blocks import Bar, Canvas, Cell, Grid, Heading, Key, Prose, Ranking, Section, Table, tabbed

SHOWN = 14


def section(canvas: Canvas) -> Section:
    """Rounds in tabs; then residual forces and unknown shapes."""
    result = canvas.result
    found = rows(result, "rounds")
    blocks: list[Any] = tabbed([(_round_title(i, row), _round(row)) for i, row in enumerate(found, 1)])
    blocks += _forces(canvas) + _shapes(canvas)
    lead = "Every candidate is tested on the residual at once, the best are fitted, validation data decide."
    return Section("search", "The search", blocks, lead if found else "")


def _round_title(i: int, row: Row) -> str:
    return f"Round {i}: {text(row, 'chosen') or 'nothing added'}"


def _round(row: Row) -> list[Any]:
    blocks: list[Any] = [Prose(text(row, "why"), "why")] if text(row, "why") else []
    return blocks + ranking(row) + _refits(row)


def threshold(candidate: Row, n_candidates: int) -> float:
    """The statistic at which the test passes: 5 % shared by all candidates (Bonferroni), from chi-squared."""
    given = number(candidate, "threshold")
    df = max(number(candidate, "df") or 1.0, 1.0)
    return given if given else float(special.chdtri(df, 0.05 / max(n_candidates, 1)))


def ranking(row: Row) -> list[Any]:
    """The best candidates on a logarithmic axis."""
    every = [c for c in rows(row, "candidates") if (number(c, "lm") or 0.0) > 0]
    best = every[:SHOWN]
    if not best:
        return []
    sizes = [number(c, "lm") or 1.0 for c in best]
    limits = [threshold(c, len(every)) for c in best]
    low = min(1.0, *sizes) if min(sizes) >= 0.1 else 0.1
    high = max(*sizes, *limits) * 1.25

    def at(value: float) -> float:
        return 100.0 * min(max(math.log(value / low) / math.log(high / low), 0.004), 1.0)

    chosen = text(row, "chosen")
    bars = [_bar(c, at(size), at(limit), chosen) for c, size, limit in zip(best, sizes, limits, strict=True)]
    decades = range(math.ceil(math.log10(low)), math.floor(math.log10(high)) + 1)
    ticks = [(at(10.0**d) if d > math.log10(low) else 0.0, f"{10**d:,}" if d >= 0 else f"{10.0**d:g}") for d in decades]
    left_out = f"; {len(every) - len(best)} weaker ones are not shown" if len(every) > len(best) else ""
    caption = f"Score statistic (χ², logarithmic axis) of {len(every)} candidates{left_out}"
    return [Heading("Candidates"), Ranking(bars, ticks, caption)]


def _bar(candidate: Row, width: float, limit: float, chosen: str) -> Bar:
    p, p_block = (formatting.probability(number(candidate, key)) for key in ("p", "p_block"))
    df = number(candidate, "df")
    numbers = f"{formatting.plain(number(candidate, 'lm'))} on {formatting.count(df)} df, p {p}, by blocks {p_block}"
    name = text(candidate, "name")
    return Bar(
        text(candidate, "title") or name,
        name,
        numbers,
        width,
        limit,
        flag(candidate, "generic") is True,
        flag(candidate, "passed") is True,
        bool(chosen) and chosen in (name, text(candidate, "title")),
    )


def _refits(row: Row) -> list[Any]:
    found = rows(row, "refits")
    columns = (
        ("refitted with", ""),
        ("its parameters", ""),
        ("gain 2 Δln L", "num"),
        ("df", "num"),
        ("criterion", "num"),
        ("on validation data Δln L", "num"),
        ("t", "num"),
    )
    chosen = text(row, "chosen")
    return [Heading("Refits of the best"), Table(columns, [_refit(r, chosen) for r in found])] if found else []


def _refit(row: Row, chosen: str) -> list[Cell | str]:
    parameters = []
    for p in rows(row, "parameters"):
        factor, unit = formatting.degrees_for(text(p, "unit"))
        value, se = (None if v is None else factor * v for v in (number(p, "value"), number(p, "se")))
        parameters.append(f"{text(p, 'name')} = {formatting.with_error(value, se, unit)}")
    more = [f"and {len(parameters) - 3} more"] if len(parameters) > 3 else []
    won = bool(chosen) and text(row, "name") == chosen
    title = text(row, "title") or text(row, "name")
    return [
        Cell(f"✓ {title}" if won else title, "wide strong won" if won else "wide"),
        Cell("; ".join(parameters[:3] + more), "small"),
        Cell(formatting.plain(number(row, "gain")), "num"),
        Cell(formatting.count(number(row, "df")), "num"),
        Cell(formatting.plain(number(row, "criterion")), "num"),
        Cell(formatting.plain(number(row, "validation_gain")), "num"),
        Cell(formatting.plain(number(row, "t"), 2), "num"),
    ]


def _forces(canvas: Canvas) -> list[Any]:
    tabs = [(take.title, _force_tab(canvas, take)) for take in takes(canvas.result, "residual_forces")]
    if not any(blocks for _, blocks in tabs):
        return []
    after = any(array(row, "after_mean") is not None for row in rows(canvas.result, "residual_forces"))
    items = [("before", "before"), ("after", "after the effects were added")] if after else [("before", "estimate")]
    note = "what the model does not explain, smoothed, with 95 % bands"
    return [Heading("Residual forces", note), Key(items), *tabbed(tabs)]


def _force_tab(canvas: Canvas, take: RecordTab) -> list[Any]:
    panels = [p for row in of_take(canvas.result, "residual_forces", take) if (p := _force_panel(canvas, row))]
    if not panels:
        return []
    figure, height = drawing.stacked(panels, "time [s]")
    return [Grid([canvas.plot(figure, height, f"Residual forces over time, {take.title}")], 320)]


def _force_panel(canvas: Canvas, row: Row) -> drawing.Panel | None:
    found = along(row, "t", "mean", "sd", "after_mean", "after_sd")
    if found is None:
        return None
    t, limit, traces = found[0], canvas.budget.points, []
    mean, sd, after_mean, after_sd = found[1]
    for middle, half, name, color, dash in (
        (mean, sd, "before", drawing.BEFORE, "dash"),
        (after_mean, after_sd, "after", drawing.MODEL, "solid"),
    ):
        if middle is None:
            continue
        if half is not None:
            traces.append(drawing.band(t, middle, drawing.Z95 * half, limit, color=color, opacity=0.16))
        traces.append(drawing.line(t, middle, name, limit, color=color, dash=dash))
    title = formatting.titled(text(row, "force")) + formatting.bracket(formatting.tidy(text(row, "unit")))
    return drawing.Panel(title, traces) if traces else None


def _shapes(canvas: Canvas) -> list[Any]:
    plots = []
    for row in rows(canvas.result, "shapes"):
        found = along(row, "grid", "value", "band")
        if found is None or found[1][0] is None:
            continue
        scale, y_unit = formatting.degrees_for(text(row, "unit"))
        value, half = scale * found[1][0], None if found[1][1] is None else scale * found[1][1]
        factor, unit = formatting.degrees_for(text(row, "variable_unit"))
        x = factor * found[0]
        traces = [drawing.band(x, value, half, 600)] if half is not None else []
        traces.append(drawing.line(x, value, text(row, "force"), 600))
        force, variable = formatting.named(text(row, "force")), formatting.named(text(row, "variable"))
        if flag(row, "reading"):
            force = f"error of the {force}"
        y_title = force + formatting.bracket(y_unit)
        figure = drawing.single(traces, variable + formatting.bracket(unit), y_title)
        plots.append(canvas.plot(figure, 280, f"{force} over {variable}", f"{force} over {variable}"))
    note = "what is unexplained over one variable, as the data draw it; 95 % bands hold the whole curve"
    return [Heading("What the data draw", note), Grid(plots, 320)] if plots else []
