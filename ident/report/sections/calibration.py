"""Are the predicted bands right: the share of the errors inside them, and their size over the claimed one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ident.report import drawing, formatting
from ident.report.blocks import Canvas, Cell, Grid, Plot, Prose, Section, Table, tabbed
from ident.report.sections.errors import by_role, titles
from ident.results import CalibrationRow, Calibrations, CalibrationTable, Verdict

COLUMNS = (("channel", ""), ("inside 50 %", "num"), ("inside 95 %", "num"), ("error / claimed", "num"),
           ("95 %", "num"), ("independent", "num"), ("", ""))
VERDICTS: dict[Verdict, Cell] = {
    "right": Cell("✓ right", "good"),
    "overconfident": Cell("▲ too sure", "bad"),
    "underconfident": Cell("▼ too cautious", "weak"),
    "insufficient_data": Cell("too few to say", "weak"),
}


def section(canvas: Canvas, calibration: Calibrations, seconds: float) -> Section:
    """A table and three small reliability plots for each set of data; ``seconds``: the horizon."""
    both = by_role(calibration.validation, calibration.estimation)
    tabs = [(f"{role} data", _tables(canvas, role, data, seconds)) for role, data in both]
    lead = (
        "The model says how far off its predictions may be; here is whether they are. Right: as many errors inside the "
        "bands as they promise, and error over claimed error about 1."
    )
    return Section("calibration", "Are the predicted bands right?", tabbed(tabs), lead)


def _tables(canvas: Canvas, role: str, data: CalibrationTable, seconds: float) -> list[Any]:
    lines: list[list[Cell | str]] = []
    plots = []
    for title, found in zip(titles(seconds), (data.one_step, data.horizon, data.simulation), strict=True):
        lines += [[Cell(title, "group")], *(_line(n, row) for n, row in found.items())] if found else []
        plot = _reliability(canvas, f"{title}, {role} data", found)
        plots += [plot] if plot is not None else []
    if not lines:
        return []
    note = "A simulation is one experiment: its errors are correlated, and few of them are independent."
    drawn = "Shares of the errors inside the predicted bands against those promised; below the diagonal is too sure."
    return [Table(COLUMNS, lines), Prose(note, "quiet"), *([Prose(drawn, "quiet"), Grid(plots, 220)] if plots else [])]


def _line(channel: str, row: CalibrationRow) -> list[Cell | str]:
    low, high = row.low, row.high
    return [
        formatting.named(channel),
        Cell(formatting.percent(row.inside_50), "num"),
        Cell(formatting.percent(row.inside_95, 1), "num"),
        Cell(formatting.plain(row.scale), "num"),
        Cell("–" if low is None or high is None else f"{formatting.plain(low)} to {formatting.plain(high)}", "num"),
        Cell(formatting.plain(row.n_effective, 2), "num"),
        VERDICTS[row.verdict],
    ]


def _reliability(canvas: Canvas, title: str, found: Mapping[str, CalibrationRow]) -> Plot | None:
    """Central bands of 20, 40, ... 100 %, from the tenths of the predicted distribution."""
    promised: Any = 0.2 * np.arange(6)
    traces = [drawing.line_trace(promised, promised, "promised", 10, color=drawing.FAINT, dash="dot")]
    for i, (channel, row) in enumerate(found.items()):
        pit = row.pit
        inside = np.append(0.0, np.cumsum((pit[:5] + pit[:4:-1])[::-1]))
        color, dash = drawing.LINES[i % 6], drawing.DASHES[i // 6 % 6]
        traces.append(drawing.line_trace(promised, inside, formatting.symbol(channel), 10, color=color, dash=dash))
    if len(traces) == 1:
        return None
    axis = {"range": [0, 1], "tickformat": ".0%"}
    figure = drawing.single(traces, "promised", "inside", xaxis=axis, yaxis=axis, showlegend=True)
    return canvas.plot(figure, 260, f"Reliability, {title}", title)
