"""Profile likelihoods: how far each parameter can move before the data object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ident.report import drawing, formatting
from ident.report.blocks import Canvas, Cell, Grid, Key, Plot, Section, Table
from ident.results import ProfileCurve

DROP = 1.92  # of the log-likelihood: the 95 % interval
TOP = 2.6  # of the picture


def section(canvas: Canvas, table: Sequence[ProfileCurve]) -> Section:
    """A table of intervals and a small curve for each parameter."""
    if not table:
        return Section("profiles", "Profile likelihoods", [])
    columns = [("parameter", ""), ("value", "num"), ("95 % by profile", "num"), ("95 % by s.e.", "num"), ("unit", "")]
    noted = any(row.notes for row in table)
    shown = Table([*columns, ("note", "")] if noted else columns, [_row(row, noted) for row in table])
    blocks: list[Any] = [shown]
    plots = [plot for row in table if (plot := _curve(canvas, row)) is not None]
    if plots:
        blocks += [Key([("line", "profile"), ("before", "as the standard error has it"), ("bar weak", "95 %")]),
                   Grid(plots, 240)]
    lead = "The drop of the log-likelihood as one parameter is moved and all others are fitted again; 1.92 is 95 %."
    return Section("profiles", "Profile likelihoods", blocks, lead)


def _row(row: ProfileCurve, noted: bool) -> list[Cell | str]:
    factor, unit = formatting.degrees_for(row.unit)
    ends = ((row.low, row.high), (row.wald_low, row.wald_high))
    cells: list[Cell | str] = [
        Cell(row.name, "symbol"),
        Cell(formatting.plain(factor * row.value), "num"),
        *(Cell(interval(*formatting.scaled(factor, *pair)), "num") for pair in ends),
        Cell(unit, "nowrap"),
    ]
    return [*cells, Cell("; ".join(row.notes), "wide")] if noted else cells


def interval(low: float | None, high: float | None) -> str:
    """``1.2 to 3.4``; an end that the data do not close is open."""
    if low is None and high is None:
        return "–"
    ends = ["open" if end is None else formatting.plain(end) for end in (low, high)]
    return f"{ends[0]} to {ends[1]}"


def _curve(canvas: Canvas, row: ProfileCurve) -> Plot | None:
    value = row.value
    if row.grid.size < 3 or drawing.drawable(row.drop) is None:
        return None
    factor, unit = formatting.degrees_for(row.unit)
    x, drop = factor * row.grid, row.drop
    traces = [drawing.line_trace(x, drop, "profile", canvas.budget.points)]
    low, high = row.wald_low, row.wald_high
    if low is not None and high is not None and low < value < high:
        # the parabola of the standard error, each side by its own end: in a logarithm they differ
        fine = np.linspace(x.min(), x.max(), 60)
        half = factor * np.where(fine < factor * value, value - low, high - value)
        traces.append(drawing.line_trace(fine, DROP * ((fine - factor * value) / half) ** 2, "standard error", 60,
                                   color=drawing.BEFORE, dash="dash"))
    ends = [row.low, row.high]
    a, b = (x.min() if ends[0] is None else factor * ends[0]), (x.max() if ends[1] is None else factor * ends[1])
    traces.append(drawing.between(np.array([a, b]), np.zeros(2), np.full(2, DROP), opacity=0.1))
    name = row.name
    figure = drawing.single(traces, f"{name} [{unit}]" if unit else name, "drop", yaxis={"range": [0, TOP]})
    return canvas.plot(figure, 220, f"Profile likelihood of {name}", name)
