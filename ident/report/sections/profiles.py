"""Profile likelihoods: how far each parameter can move before the data object."""

from __future__ import annotations

from typing import Any

import numpy as np

from ident.report import drawing, formatting
from ident.report.access import Row, along, number, rows, text, texts
from ident.report.blocks import Canvas, Cell, Grid, Key, Plot, Section, Table

DROP = 1.92  # of the log-likelihood: the 95 % interval
TOP = 2.6  # of the picture


def section(canvas: Canvas) -> Section:
    """A table of intervals and a small curve for each parameter."""
    table = rows(canvas.result, "profiles")
    if not table:
        return Section("profiles", "Profile likelihoods", [])
    columns = [("parameter", ""), ("value", "num"), ("95 % by profile", "num"), ("95 % by s.e.", "num"), ("unit", "")]
    noted = any(texts(row, "notes") for row in table)
    shown = Table([*columns, ("note", "")] if noted else columns, [_row(row, noted) for row in table])
    blocks: list[Any] = [shown]
    plots = [plot for row in table if (plot := _curve(canvas, row)) is not None]
    if plots:
        blocks += [Key([("line", "profile"), ("before", "as the standard error has it"), ("bar weak", "95 %")]),
                   Grid(plots, 240)]
    lead = "The drop of the log-likelihood as one parameter is moved and all others are fitted again; 1.92 is 95 %."
    return Section("profiles", "Profile likelihoods", blocks, lead)


def _row(row: Row, noted: bool) -> list[Cell | str]:
    factor, unit = formatting.degrees_for(text(row, "unit"))
    value = number(row, "value")
    cells: list[Cell | str] = [
        Cell(text(row, "name"), "symbol"),
        Cell("–" if value is None else formatting.plain(factor * value), "num"),
        *(Cell(interval(*(_times(number(row, key), factor) for key in ends)), "num")
          for ends in (("low", "high"), ("wald_low", "wald_high"))),
        Cell(unit, "nowrap"),
    ]
    return [*cells, Cell("; ".join(texts(row, "notes")), "wide")] if noted else cells


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else factor * value


def interval(low: float | None, high: float | None) -> str:
    """``1.2 to 3.4``; an end that the data do not close is open."""
    if low is None and high is None:
        return "–"
    ends = ["open" if end is None else formatting.plain(end) for end in (low, high)]
    return f"{ends[0]} to {ends[1]}"


def _curve(canvas: Canvas, row: Row) -> Plot | None:
    found = along(row, "grid", "drop")
    value = number(row, "value")
    if found is None or found[1][0] is None or found[0].size < 3 or value is None:
        return None
    factor, unit = formatting.degrees_for(text(row, "unit"))
    x, drop = factor * found[0], found[1][0]
    traces = [drawing.line(x, drop, "profile", canvas.budget.points)]
    low, high = number(row, "wald_low"), number(row, "wald_high")
    if low is not None and high is not None and low < value < high:
        # the parabola of the standard error, each side by its own end: in a logarithm they differ
        fine = np.linspace(x.min(), x.max(), 60)
        half = factor * np.where(fine < factor * value, value - low, high - value)
        traces.append(drawing.line(fine, DROP * ((fine - factor * value) / half) ** 2, "standard error", 60,
                                   color=drawing.BEFORE, dash="dash"))
    ends = [number(row, "low"), number(row, "high")]
    a, b = (x.min() if ends[0] is None else factor * ends[0]), (x.max() if ends[1] is None else factor * ends[1])
    traces.append(drawing.between(np.array([a, b]), np.zeros(2), np.full(2, DROP), opacity=0.1))
    name = text(row, "name")
    figure = drawing.single(traces, f"{name} [{unit}]" if unit else name, "drop", yaxis={"range": [0, TOP]})
    return canvas.plot(figure, 220, f"Profile likelihood of {name}", name)
