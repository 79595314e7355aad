"""Which segments of logs tell of which parameter, as a table and as a map over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ident.numerics import Array
from ident.report import drawing, formatting
from ident.report.blocks import Canvas, Cell, Grid, Prose, Section, Table, tabbed
from ident.results import InformationResult, InformedParameter, InputTrace, LogSpan, SegmentInformation

TIME = "time [s]"
# one colour from light to dark: it keeps its order in print and for every kind of colour vision
SCALE = [[0.0, "#f4f6f8"], [0.25, "#c3ddee"], [0.5, "#7db8dc"], [0.75, "#2f8dc1"], [1.0, "#00466e"]]
ROW_HEIGHT, AROUND, LEFT = 26, 104, 74  # px


def parameters_section(result: InformationResult) -> Section:
    """A row a parameter: what is known of it, and the segment that it hangs on."""
    found = result.information.parameters
    columns = [("parameter", ""), ("value", "num"), ("± from all logs", "num"), ("hangs most on", ""),
               ("± without it", "num"), ("± from it alone", "num")]
    lead = ("Standard errors by prediction error with the model's own noise; the current and the offsets of each log "
            "count as unknown.")
    return Section("known", "What these logs tell", [Table(columns, [_row(p) for p in found])] if found else [], lead)


def _row(p: InformedParameter) -> list[Cell | str]:
    factor, unit = formatting.degrees_for(p.unit)
    name, shown = f"{p.name}  {p.meaning}{formatting.bracket(unit)}", Cell(formatting.plain(factor * p.value), "num")
    if p.se is None:
        return [name, shown, Cell("nothing", "num"), "", Cell("–", "num"), Cell("–", "num")]
    se, alone = factor * p.se, None if p.alone is None else factor * p.alone
    without = (
        "unknown" if p.weight is None else f"{formatting.plain(se * p.weight)} (× {formatting.plain(p.weight)})"
    )
    return [name, shown, Cell(formatting.plain(se), "num"), place(p), Cell(without, "num"),
            Cell(formatting.plain(alone), "num")]


def place(segment: LogSpan) -> str:
    """``run, 30 to 60 s (zigzag)``."""
    words = f"{segment.record}, {segment.t_from:.0f} to {segment.t_to:.0f} s"
    return f"{words} ({segment.what})" if segment.what else words


def segments_section(canvas: Canvas, result: InformationResult) -> Section:
    """One tab a log: the part of each parameter's information that each segment alone brings, over the inputs."""
    tabs = []
    for record in dict.fromkeys(row.record for row in result.information.segments):
        found = [row for row in result.information.segments if row.record == record]
        inputs = [row for row in result.inputs if row.record == record]
        tabs.append((record, _record(canvas, result.information.names, found, inputs)))
    if not any(blocks for _, blocks in tabs):
        return Section("segments", "", [])
    lead = ("Dark: of what all logs tell of the parameter, so much would be lost without this segment (1 − the square "
            "of the standard error with it over that without it). What others tell as well is not lost.")
    return Section("segments", "Segment by segment", tabbed(tabs), lead)


def _record(
    canvas: Canvas, names: Sequence[str], found: Sequence[SegmentInformation], inputs: Sequence[InputTrace]
) -> list[Any]:
    good = [row for row in found if np.isfinite(row.lost).any()]
    if not good:
        return []
    record = good[0].record
    edges = np.array([good[0].t_from, *(row.t_to for row in good)])
    z = np.clip(np.column_stack([row.lost for row in good]), 0.0, 1.0)
    words = [[place(row) for row in good]] * len(names)
    every = {"autorange": "reversed", "type": "category", "dtick": 1}
    figure = drawing.single([_map(edges, z, names, words)], TIME, yaxis=every, hovermode="closest",
                            margin={"l": LEFT, "r": 8, "t": 56, "b": 44})
    blocks: list[Any] = [Grid([canvas.plot(figure, ROW_HEIGHT * len(names) + AROUND,
                                           f"Lost without each segment, {record}")], 600)]
    panels = [drawing.Panel(formatting.titled(row.name) + formatting.bracket(row.unit), [
        drawing.line_trace(row.t, row.value, "input", canvas.budget.points, color=drawing.MEASURED)]) for row in inputs]
    if panels:
        shown, height = drawing.stacked(panels, TIME, panel_height=70)
        shown["layout"]["margin"]["l"] = LEFT  # below the same times of the map
        blocks += [Prose("What was done meanwhile:", "quiet"), Grid([canvas.plot(shown, height, "Inputs")], 600)]
    return blocks


def _map(edges: Array, z: Array, names: Sequence[str], words: Sequence[Sequence[str]]) -> drawing.Trace:
    shown = [[None if not np.isfinite(v) else round(float(v), 4) for v in line] for line in z]
    said = [[drawing.said(word) for word in line] for line in words]
    return {
        "type": "heatmap", "x": edges.round(3).tolist(), "y": [drawing.said(n) for n in names], "z": shown, "zmin": 0.0,
        "zmax": 1.0, "colorscale": SCALE, "xgap": 1, "ygap": 2, "text": said, "hoverongaps": False,
        "hovertemplate": "%{y}: %{z:.0%} lost without<br>%{text}<extra></extra>",
        "colorbar": {"tickformat": ".0%", "thickness": 8, "outlinewidth": 0, "orientation": "h", "len": 0.4, "x": 1.0,
                     "xanchor": "right", "y": 1.0, "yanchor": "bottom", "nticks": 5,
                     "title": {"text": "lost without it", "side": "top"}},
    }  # fmt: skip
