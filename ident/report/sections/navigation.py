"""Where the boat was: outages, the track with its 95 % ellipses, and every state with its band."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from seatrial.ident.numerics import Array
from seatrial.ident.report import drawing, formatting
from seatrial.ident.report.blocks import Canvas, Cell, Grid, Key, Plot, Prose, Section, Table, tabbed
from seatrial.ident.report.record_tabs import origin_words
from seatrial.ident.results import GnssFixes, GnssOutage, NavigatedRecord, NavigationResult, StateTrace

TIME = "time [s]"
TURN = np.linspace(0.0, 2 * np.pi, 73)


def outages_section(result: NavigationResult) -> Section:
    """A row an outage: what was claimed at its end, and what came true."""
    found = result.outages
    if not found:
        return Section("outages", "", [])
    withheld = any(o.best is not None for o in found)
    columns = [
        ("record", ""),
        ("from", "num"),
        ("duration", "num"),
        ("95 % radius", "num"),
        ("off by", "num"),
        ("allowed", "num"),
        ("", ""),
    ]
    if withheld:
        columns += [("rms without GNSS", "num"), ("rms by the best estimate", "num")]
    lead = (
        "95 % radius: of the circle that holds the position at the outage's end, predicted without GNSS. Off by: the "
        "distance from the first fix after it; allowed: 95 % of such distances, the noise of the fix included."
    )
    if withheld:
        lead += " Where GNSS was withheld on purpose: the distance from all fixes that were not used."
    return Section("outages", "GNSS outages", [Table(columns, [_outage(o, withheld) for o in found])], lead)


def _outage(o: GnssOutage, withheld: bool) -> list[Cell | str]:
    verdict = {True: Cell("✓ inside", "good"), False: Cell("✗ outside", "bad"), None: Cell("–")}[o.inside]
    cells: list[Cell | str] = [
        o.record,
        Cell(f"{formatting.plain(o.start, 4)} s", "num"),
        Cell(f"{formatting.plain(o.duration)} s", "num"),
        _metres(o.at_end.radius),
        _metres(o.error),
        _metres(o.allowed),
        verdict,
    ]
    errors = [None if e is None else e.rms for e in (o.predicted, o.best)]
    return [*cells, *(_metres(rms) for rms in errors)] if withheld else cells


def _metres(value: float | None) -> Cell:
    return Cell("–" if value is None else f"{formatting.plain(value)} m", "num")


def states_section(canvas: Canvas, result: NavigationResult) -> Section:
    """One tab a record: the track, then all states over time."""
    tabs = []
    for one in result.navigation:
        outages, of = [o for o in result.outages if o.record == one.record], origin_words(result.logs, one.record)
        tabs.append((one.record, _record(canvas, one, outages, of)))
    if not any(blocks for _, blocks in tabs):
        return Section("navigation", "", [])
    lead = "Line: the estimate with its 95 % band (the parameters' own errors included). Grey: what was measured."
    return Section("navigation", "Track and states", tabbed(tabs), lead)


def _record(canvas: Canvas, one: NavigatedRecord, outages: Sequence[GnssOutage], of: str) -> list[Any]:
    blocks: list[Any] = []
    track = _track(canvas, one, outages, of)
    if track is not None:
        key = Key([("after", "estimate, with 95 % ellipses"), ("measured", "fixes"), ("before", "fixes withheld")])
        blocks += [key, Grid([track], 320)]
    panels = [panel for s in one.states if (panel := _panel(canvas, one.t, s, outages)) is not None]
    if panels:
        figure, height = drawing.stacked(panels, TIME)
        blocks += [Prose("Shaded: without GNSS.", "quiet")] if outages else []
        blocks.append(Grid([canvas.plot(figure, height, f"States over time, {one.record}")], 320))
    return blocks


def _panel(canvas: Canvas, t: Array, state: StateTrace, outages: Sequence[GnssOutage]) -> drawing.Panel | None:
    if not np.isfinite(state.value).any():
        return None
    factor, unit = formatting.degrees_for(state.unit)
    value, sd = factor * state.value, factor * state.sd
    limit, traces = canvas.budget.points, []
    top, bottom = float(np.nanmax(value + drawing.Z95 * sd)), float(np.nanmin(value - drawing.Z95 * sd))
    if state.measured is not None and np.isfinite(state.measured).any():
        measured = factor * state.measured
        if state.angle:
            measured = measured - 360.0 * np.round((measured - value) / 360.0)
        top, bottom = max(top, float(np.nanmax(measured))), min(bottom, float(np.nanmin(measured)))
        traces.append(drawing.dots(t, measured, "measured", limit))
    traces.append(drawing.band(t, value, drawing.Z95 * sd, limit))
    traces.append(drawing.line_trace(t, value, "estimate", limit))
    ends = (np.full(2, bottom), np.full(2, top))
    shade = [drawing.between(np.array([o.start, o.end]), *ends, color=drawing.AMBER, opacity=0.15) for o in outages]
    name, meaning = state.name, state.meaning
    title = (
        formatting.titled(name) if name in formatting.MEANINGS else f"{meaning[:1].upper()}{meaning[1:]} {name}".strip()
    )
    return drawing.Panel(title + formatting.bracket(unit), [*shade, *traces])


def _track(canvas: Canvas, one: NavigatedRecord, outages: Sequence[GnssOutage], of: str) -> Plot | None:
    values = {s.name: s.value for s in one.states}
    if not {"x", "y"} <= set(values):
        return None
    traces = _fixes(one.fixes, canvas.budget.points)
    at = drawing.strided(one.t.size, canvas.budget.points)
    line = {"color": drawing.MODEL, "width": 1.8}
    traces.append(
        {
            "type": "scatter",
            "mode": "lines",
            "name": "estimate",
            "x": drawing.packed(values["y"][at]),
            "y": drawing.packed(values["x"][at]),
            "line": line,
        }
    )
    for o in outages:
        if not o.leading:  # its ellipse is wider than the track
            traces.append(_ellipse(o))
    equal = {"scaleanchor": "x", "scaleratio": 1, "nticks": 7}
    figure = drawing.single(traces, f"east{of} [m]", f"north{of} [m]", hovermode="closest", yaxis=equal)
    return canvas.plot(figure, 420, f"Track, {one.record}", "Track, north up")


def _fixes(fixes: GnssFixes, limit: int) -> list[drawing.Trace]:
    traces = []
    for wanted, name, color in ((1.0, "fix", drawing.MEASURED), (0.0, "withheld", drawing.BEFORE)):
        chosen = np.flatnonzero(fixes.used == wanted)
        at = chosen[drawing.strided(chosen.size, limit)]
        if at.size:
            traces.append(
                {
                    "type": "scatter",
                    "mode": "markers",
                    "name": name,
                    "x": drawing.packed(fixes.y[at]),
                    "y": drawing.packed(fixes.x[at]),
                    "marker": {"color": color, "size": 3, "opacity": 0.6},
                }
            )
    return traces


def _ellipse(o: GnssOutage) -> drawing.Trace:
    """The 95 % ellipse about the prediction at an outage's end."""
    e = o.at_end
    a, b, (c, s) = e.major * np.cos(TURN), e.minor * np.sin(TURN), (np.cos(e.azimuth), np.sin(e.azimuth))
    name = f"95 % after {formatting.plain(o.duration)} s"
    return {
        "type": "scatter",
        "mode": "lines",
        "name": drawing.said(name),
        "x": drawing.packed(o.east + s * a + c * b),
        "y": drawing.packed(o.north + c * a - s * b),
        "line": {"color": drawing.INK, "width": 1.4},
    }
