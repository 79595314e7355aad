"""Which stretches of logs already taken tell of which parameter: a table, and a map over time for each log."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ident.numerics import Array
from ident.report import drawing, formatting
from ident.report.access import Row, array, group, number, of_take, rows, takes, text, texts
from ident.report.blocks import Canvas, Cell, Grid, Prose, Section, Table, tabbed
from ident.report.record_tabs import RecordTab

TIME = "time [s]"
# one colour from light to dark: it keeps its order in print and for every kind of colour vision
SCALE = [[0.0, "#f4f6f8"], [0.25, "#c3ddee"], [0.5, "#7db8dc"], [0.75, "#2f8dc1"], [1.0, "#00466e"]]
ROW_HEIGHT, AROUND, LEFT = 26, 104, 74  # px


def parameters_section(canvas: Canvas) -> Section:
    """A row a parameter: what is known of it, and the stretch that it hangs on."""
    found = rows(group(canvas.result, "information"), "parameters")
    if not found:
        return Section("known", "", [])
    columns = [("parameter", ""), ("value", "num"), ("± from all logs", "num"), ("hangs most on", ""),
               ("± without it", "num"), ("± from it alone", "num")]
    lead = ("Standard errors by prediction error with the model's own noise; the current and the offsets of each log "
            "count as unknown.")
    return Section("known", "What these logs tell", [Table(columns, [_row(row) for row in found])], lead)


def _row(row: Row) -> list[Cell | str]:
    factor, unit = formatting.degrees_for(text(row, "unit"))
    name = f"{text(row, 'name')}  {text(row, 'meaning')}{formatting.bracket(unit)}"
    value, se, alone = (None if v is None else factor * v for v in (number(row, k) for k in ("value", "se", "alone")))
    weight, shown = number(row, "weight"), Cell(formatting.plain(value), "num")
    if se is None:
        return [name, shown, Cell("nothing", "num"), "", Cell("–", "num"), Cell("–", "num")]
    without = "unknown" if weight is None else f"{formatting.plain(se * weight)} (× {formatting.plain(weight)})"
    return [name, shown, Cell(formatting.plain(se), "num"), place(row), Cell(without, "num"),
            Cell(formatting.plain(alone), "num")]


def place(row: Row) -> str:
    """``run, 30 to 60 s (zigzag)``."""
    words = f"{text(row, 'record')}, {number(row, 'from') or 0.0:.0f} to {number(row, 'to') or 0.0:.0f} s"
    return f"{words} ({text(row, 'what')})" if text(row, "what") else words


def stretches_section(canvas: Canvas) -> Section:
    """One tab a log: the part of each parameter's information that each stretch alone brings, over the inputs."""
    part = group(canvas.result, "information")
    names = texts(part, "names")
    tabs = [(take.name, _record(canvas, part, names, take)) for take in takes(part, "stretches")]
    if not any(blocks for _, blocks in tabs):
        return Section("stretches", "", [])
    lead = ("Dark: of what all logs tell of the parameter, so much would be lost without this stretch (1 − the square "
            "of the standard error with it over that without it). What others tell as well is not lost.")
    return Section("stretches", "Stretch by stretch", tabbed(tabs), lead)


def _record(canvas: Canvas, part: Row, names: Sequence[str], take: RecordTab) -> list[Any]:
    found = of_take(part, "stretches", take)
    shares = [array(row, "lost") for row in found]
    good = [(row, share) for row, share in zip(found, shares, strict=True)
            if share is not None and share.size == len(names)]
    if not good or not names:
        return []
    edges = np.array([number(good[0][0], "from") or 0.0, *(number(row, "to") or 0.0 for row, _ in good)])
    z = np.clip(np.column_stack([share for _, share in good]), 0.0, 1.0)
    words = [[place(row) for row, _ in good]] * len(names)
    every = {"autorange": "reversed", "type": "category", "dtick": 1}
    figure = drawing.single([_map(edges, z, names, words)], TIME, yaxis=every, hovermode="closest",
                            margin={"l": LEFT, "r": 8, "t": 56, "b": 44})
    blocks: list[Any] = [Grid([canvas.plot(figure, ROW_HEIGHT * len(names) + AROUND,
                                           f"Lost without each stretch, {take.name}")], 600)]
    panels = [drawing.Panel(formatting.titled(text(row, "name")) + formatting.bracket(text(row, "unit")), [
        drawing.line(t, value, "input", canvas.budget.points, color=drawing.MEASURED)])
        for row in of_take(canvas.result, "inputs", take)
        if (t := array(row, "t")) is not None and (value := array(row, "value")) is not None and t.size == value.size]
    if panels:
        inputs, height = drawing.stacked(panels, TIME, panel_height=70)
        inputs["layout"]["margin"]["l"] = LEFT  # below the same times of the map
        blocks += [Prose("What was done meanwhile:", "quiet"), Grid([canvas.plot(inputs, height, "Inputs")], 600)]
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
