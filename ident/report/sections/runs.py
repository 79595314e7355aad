"""What was run, and measured against model: logs, inputs, channels over time, track."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ident.numerics import Array
from ident.report import drawing, formatting
from ident.report.blocks import Canvas, Cell, Grid, Key, Lines, Prose, Section, Table, tabbed
from ident.report.record_tabs import RecordTab, of_record, record_tabs, roles_of
from ident.results import FitResult, InputTrace, LogSummary, Trace, Track

TIME = "time [s]"


def run_section(canvas: Canvas, logs: Sequence[LogSummary], inputs: Sequence[InputTrace]) -> Section:
    """Logs with their roles, and what the thrusters were told."""
    columns = (("log", ""), ("role", ""), ("duration", "num"), ("rig", ""), ("mission", ""), ("SHA-256", ""))
    blocks: list[Any] = [Table(columns, [_log_row(row) for row in logs])] if logs else []
    warnings = [f"{_log_name(row)}: {line}" for row in logs for line in row.warnings]
    if warnings:
        blocks.append(Lines(warnings, "warning"))
    tabs = record_tabs(inputs, roles_of(logs))
    blocks += tabbed([(tab.title, _inputs(canvas, of_record(inputs, tab), tab)) for tab in tabs])
    return Section("run", "What was run", blocks)


def _log_name(row: LogSummary) -> str:
    return row.name or row.path.replace("\\", "/").rsplit("/", 1)[-1] or "log"


def _log_row(row: LogSummary) -> list[Cell | str]:
    role = row.role
    return [
        Cell(_log_name(row), "strong"),
        Cell(role, f"badge {role}" if role in ("validation", "estimation") else ""),
        Cell(formatting.duration(row.duration), "num"),
        row.rig or "–",
        row.mission or "–",
        Cell(row.sha256[:10] or "–", "code"),
    ]


def _inputs(canvas: Canvas, inputs: Sequence[InputTrace], tab: RecordTab) -> list[Any]:
    by_unit: dict[str, list[InputTrace]] = {}
    for row in inputs:
        by_unit.setdefault(row.unit, []).append(row)
    panels = []
    for unit, members in by_unit.items():
        factor, shown = formatting.degrees_for(unit)
        traces, names = [], []
        for i, row in enumerate(members):
            if drawing.drawable(row.value) is not None:
                style = {"color": drawing.LINES[i % 6], "dash": ("solid", "dot")[i % 2]}
                name = (
                    formatting.symbol(row.name) if len(members) > 1 else formatting.titled(row.name)
                )
                traces.append(drawing.line_trace(row.t, factor * row.value, name, canvas.budget.points, **style))
                names.append(f"{name} ({('solid', 'dotted')[i % 2]})" if len(members) > 1 else name)
        if traces:
            panels.append(drawing.Panel(" · ".join(names) + formatting.bracket(shown), traces))
    if not panels:
        return []
    figure, height = drawing.stacked(panels, TIME)
    return [Grid([canvas.plot(figure, height, f"Inputs over time, {tab.title}")], 320)]


def traces_section(canvas: Canvas, result: FitResult) -> Section:
    """Every channel measured and free-running, and the track, one tab a record."""
    tabs = [
        (tab.title, _channels(canvas, of_record(result.traces, tab), tab) + _track(canvas, result.track, tab))
        for tab in record_tabs([*result.traces, *result.track], roles_of(result.logs, result.traces))
    ]
    if not any(blocks for _, blocks in tabs):
        return Section("traces", "", [])
    before = any(row.before is not None for row in result.traces)
    return Section("traces", "Measured against model", [_key(before), *tabbed(tabs)])


def _key(before: bool) -> Key:
    items = [("measured", "measured"), ("after", "model, free-running, with 95 % band")]
    return Key([*items, ("before", "before the effects were added")] if before else items)


def _channels(canvas: Canvas, rows: Sequence[Trace], tab: RecordTab) -> list[Any]:
    panels = [panel for row in rows if (panel := _channel(canvas, row))]
    if not panels:
        return []
    figure, height = drawing.stacked(panels, TIME)
    plots = [Grid([canvas.plot(figure, height, f"Measured and model over time, {tab.title}")], 320)]
    cut = "Cut where a band or a curve leaves the frame; a double click shows all of it."
    return [*plots, Prose(cut, "caption")] if any(panel.y for panel in panels) else plots


def _channel(canvas: Canvas, row: Trace) -> drawing.Panel | None:
    t, limit = row.t, canvas.budget.points
    factor, unit = formatting.degrees_for(row.unit)
    curves = (drawing.drawable(a) for a in (row.measured, row.model, row.sd, row.before))
    measured, model, sd, before = (None if a is None else factor * a for a in curves)
    if row.angle and row.unit == "rad":
        measured, model, before = _one_turn([measured, model, before])
    traces = []
    if model is not None and sd is not None:
        traces.append(drawing.band(t, model, drawing.Z95 * sd, limit))
    if measured is not None:
        traces.append(drawing.dots(t, measured, "measured", limit))
    if before is not None:
        traces.append(drawing.line_trace(t, before, "before", limit, color=drawing.BEFORE, dash="dash"))
    if model is not None:
        traces.append(drawing.line_trace(t, model, "model", limit))
    if not traces:
        return None
    edges = [] if model is None or sd is None else [model - drawing.Z95 * sd, model + drawing.Z95 * sd]
    frame = _frame([measured, model], [before, *edges])
    title = formatting.titled(row.channel) + formatting.bracket(unit)
    return drawing.Panel(title, traces, {"range": frame} if frame else {})


def _frame(shown: list[Array | None], wide: list[Array | None]) -> list[float] | None:
    """Limits of y where curves that ran away would squeeze what is shown to a line; None where they do not."""
    least, most = _span(shown)
    room = 0.5 * (most - least)
    low, high = _span([*shown, *wide])
    if not room > 0.0 or (low >= least - 2.0 * room and high <= most + 2.0 * room):
        return None
    return [max(low, least - room), min(high, most + room)]


def _span(curves: list[Array | None]) -> tuple[float, float]:
    finite = [curve[np.isfinite(curve)] for curve in curves if curve is not None]
    every = np.concatenate(finite) if finite else np.empty(0)
    return (float(every.min()), float(every.max())) if every.size else (np.nan, np.nan)


def _one_turn(curves: list[Array | None]) -> list[Array | None]:
    """Angles [deg] without jumps at the half turn, all starting on the same turn."""
    start: float | None = None
    shown: list[Array | None] = []
    for curve in curves:
        if curve is None:
            shown.append(None)
            continue
        good, smooth = np.isfinite(curve), curve.copy()
        smooth[good] = np.unwrap(curve[good], period=360.0)
        first = float(smooth[good][0])
        start = first if start is None else start
        shown.append(smooth - 360.0 * round((first - start) / 360.0))
    return shown


def _track(canvas: Canvas, tracks: Sequence[Track], tab: RecordTab) -> list[Any]:
    plots = []
    for row in of_record(tracks, tab):
        styles = (
            ("measured", row.x_measured, row.y_measured),
            ("before", row.x_before, row.y_before),
            ("model", row.x_model, row.y_model),
        )
        traces = [t for style, x, y in styles for t in _path(style, x, y, canvas.budget.points)]
        if traces:
            equal = {"scaleanchor": "x", "scaleratio": 1, "nticks": 7}
            figure = drawing.single(traces, "east [m]", "north [m]", hovermode="closest", yaxis=equal)
            plots.append(canvas.plot(figure, 420, f"Track, {tab.title}", "Track, north up"))
    return [Grid(plots, 320, "narrow" if len(plots) == 1 else "")] if plots else []


def _path(style: str, north: Array | None, east: Array | None, limit: int) -> list[drawing.Trace]:
    if north is None or east is None:
        return []
    good = np.isfinite(north) & np.isfinite(east)
    if not good.any():
        return []
    at = np.flatnonzero(good)[drawing.strided(int(good.sum()), limit)]
    line = {
        "measured": {"color": drawing.MEASURED, "width": 1.2},
        "before": {"color": drawing.BEFORE, "width": 1.6, "dash": "dash"},
        "model": {"color": drawing.MODEL, "width": 1.8},
    }[style]
    where = {"x": drawing.packed(east[at]), "y": drawing.packed(north[at])}
    start = {"type": "scatter", "mode": "markers", "x": [float(east[at[0]])], "y": [float(north[at[0]])]}
    marker = {"symbol": "circle-open", "size": 9, "color": line["color"], "line": {"width": 2}}
    path = {"type": "scatter", "mode": "lines", "name": style, **where, "line": line}
    return [path, {**start, "name": f"{style}, start", "marker": marker}]
