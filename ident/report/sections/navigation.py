"""Where the boat was: outages, the track with its 95 % ellipses, and every state with its band."""

from __future__ import annotations

from typing import Any

import numpy as np

from ident.numerics import Array
from ident.report import drawing, formatting
from ident.report.access import Row, along, array, flag, group, number, of_take, rows, takes, text
from ident.report.blocks import Canvas, Cell, Grid, Key, Prose, Section, Table, tabbed
from ident.report.record_tabs import RecordTab

TIME = "time [s]"
TURN = np.linspace(0.0, 2 * np.pi, 73)


def outages_section(canvas: Canvas) -> Section:
    """A row an outage: what was claimed at its end, and what came true."""
    found = rows(canvas.result, "outages")
    if not found:
        return Section("outages", "", [])
    withheld = any(group(row, "best") for row in found)
    columns = [("record", ""), ("from", "num"), ("duration", "num"), ("95 % radius", "num"), ("off by", "num"),
               ("allowed", "num"), ("", "")]
    if withheld:
        columns += [("rms without GNSS", "num"), ("rms by the best estimate", "num")]
    lead = (
        "95 % radius: of the circle that holds the position at the outage's end, predicted without GNSS. Off by: the "
        "distance from the first fix after it; allowed: 95 % of such distances, the noise of the fix included."
    )
    if withheld:
        lead += " Where GNSS was withheld on purpose: the distance from all fixes that were not used."
    return Section("outages", "GNSS outages", [Table(columns, [_outage(row, withheld) for row in found])], lead)


def _outage(row: Row, withheld: bool) -> list[Cell | str]:
    inside = flag(row, "inside")
    verdict = {True: Cell("✓ inside", "good"), False: Cell("✗ outside", "bad"), None: Cell("–")}[inside]
    cells: list[Cell | str] = [
        text(row, "record"),
        Cell(f"{formatting.plain(number(row, 'start'), 4)} s", "num"),
        Cell(f"{formatting.plain(number(row, 'duration'))} s", "num"),
        _metres(number(group(row, "at_end"), "radius")),
        _metres(number(row, "error")),
        _metres(number(row, "allowed")),
        verdict,
    ]
    return [*cells, *(_metres(number(group(row, key), "rms")) for key in ("predicted", "best"))] if withheld else cells


def _metres(value: float | None) -> Cell:
    return Cell("–" if value is None else f"{formatting.plain(value)} m", "num")


def section(canvas: Canvas) -> Section:
    """One tab a record: the track, then all states over time."""
    tabs = [(take.name, _record(canvas, take)) for take in takes(canvas.result, "navigation")]
    if not any(blocks for _, blocks in tabs):
        return Section("navigation", "", [])
    lead = "Line: the estimate with its 95 % band (the parameters' own errors included). Grey: what was measured."
    return Section("navigation", "Track and states", tabbed(tabs), lead)


def _record(canvas: Canvas, take: RecordTab) -> list[Any]:
    blocks: list[Any] = []
    for row in of_take(canvas.result, "navigation", take):
        track = _track(canvas, take, row)
        if track is not None:
            blocks += [Key([("after", "estimate, with 95 % ellipses"), ("measured", "fixes"),
                            ("before", "fixes withheld")]), Grid([track], 320)]
        t, spans = array(row, "t"), _spans(canvas, take)
        panels = [] if t is None else [p for s in rows(row, "states") if (p := _panel(canvas, t, s, spans)) is not None]
        if panels:
            figure, height = drawing.stacked(panels, TIME)
            blocks += [Prose("Shaded: without GNSS.", "quiet")] if spans else []
            blocks.append(Grid([canvas.plot(figure, height, f"States over time, {take.name}")], 320))
    return blocks


def _spans(canvas: Canvas, take: RecordTab) -> list[tuple[float, float]]:
    ends = [(number(o, "start"), number(o, "end")) for o in of_take(canvas.result, "outages", take)]
    return [(a, b) for a, b in ends if a is not None and b is not None]


def _panel(canvas: Canvas, t: Array, state: Row, spans: list[tuple[float, float]]) -> drawing.Panel | None:
    found = along({"t": t, **state}, "t", "value", "sd", "measured")
    if found is None or found[1][0] is None:
        return None
    factor, unit = formatting.degrees_for(text(state, "unit"))
    value, sd, measured = (None if a is None else factor * a for a in found[1])
    assert value is not None
    limit, traces = canvas.budget.points, []
    reach = drawing.Z95 * sd if sd is not None else 0.0
    top, bottom = float(np.nanmax(value + reach)), float(np.nanmin(value - reach))
    if measured is not None:
        if flag(state, "angle") is True:
            measured = measured - 360.0 * np.round((measured - value) / 360.0)
        top, bottom = max(top, float(np.nanmax(measured))), min(bottom, float(np.nanmin(measured)))
        traces.append(drawing.dots(t, measured, "measured", limit))
    if sd is not None:
        traces.append(drawing.band(t, value, drawing.Z95 * sd, limit))
    traces.append(drawing.line(t, value, "estimate", limit))
    shade = [drawing.between(np.array(span), np.full(2, bottom), np.full(2, top), color=drawing.AMBER, opacity=0.15)
             for span in spans]
    name, meaning = text(state, "name"), text(state, "meaning")
    title = (
        formatting.titled(name) if name in formatting.MEANINGS else f"{meaning[:1].upper()}{meaning[1:]} {name}".strip()
    )
    return drawing.Panel(title + formatting.bracket(unit), [*shade, *traces])


def _track(canvas: Canvas, take: RecordTab, row: Row) -> Any:
    values = {text(s, "name"): array(s, "value") for s in rows(row, "states")}
    north, east, t = values.get("x"), values.get("y"), array(row, "t")
    if north is None or east is None or t is None or not north.size == east.size == t.size:
        return None
    traces = _fixes(row, canvas.budget.points)
    at = drawing.strided(t.size, canvas.budget.points)
    line = {"color": drawing.MODEL, "width": 1.8}
    traces.append({"type": "scatter", "mode": "lines", "name": "estimate", "x": drawing.packed(east[at]),
                   "y": drawing.packed(north[at]), "line": line})
    for o in of_take(canvas.result, "outages", take):
        traces += _ellipse(o)
    equal = {"scaleanchor": "x", "scaleratio": 1, "nticks": 7}
    figure = drawing.single(traces, "east [m]", "north [m]", hovermode="closest", yaxis=equal)
    return canvas.plot(figure, 420, f"Track, {take.name}", "Track, north up")


def _fixes(row: Row, limit: int) -> list[drawing.Trace]:
    fixes = group(row, "fixes")
    found = along(fixes, "x", "y", "used")
    if found is None or found[1][0] is None or found[1][1] is None:
        return []
    north, (east, used) = found[0], (found[1][0], found[1][1])
    traces = []
    for wanted, name, color in ((1.0, "fix", drawing.MEASURED), (0.0, "withheld", drawing.BEFORE)):
        chosen = np.flatnonzero(used == wanted)
        at = chosen[drawing.strided(chosen.size, limit)]
        if at.size:
            traces.append({"type": "scatter", "mode": "markers", "name": name, "x": drawing.packed(east[at]),
                           "y": drawing.packed(north[at]), "marker": {"color": color, "size": 3, "opacity": 0.6}})
    return traces


def _ellipse(row: Row) -> list[drawing.Trace]:
    """The 95 % ellipse about the prediction at an outage's end."""
    e = group(row, "at_end")
    major, minor, azimuth = (number(e, key) for key in ("major", "minor", "azimuth"))
    north, east = number(row, "north"), number(row, "east")
    if major is None or minor is None or azimuth is None or north is None or east is None:
        return []
    a, b, (c, s) = major * np.cos(TURN), minor * np.sin(TURN), (np.cos(azimuth), np.sin(azimuth))
    name = f"95 % after {formatting.plain(number(row, 'duration'))} s"
    return [{"type": "scatter", "mode": "lines", "name": drawing.said(name), "x": drawing.packed(east + s * a + c * b),
             "y": drawing.packed(north + c * a - s * b), "line": {"color": drawing.INK, "width": 1.4}}]
