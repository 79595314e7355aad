"""Sections of the page of a navigation result: GNSS outages, track with 95 % ellipses, states with 95 % bands."""

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
ELLIPSE_ANGLES = np.linspace(0.0, 2 * np.pi, 73)  # rad


def outages_section(result: NavigationResult) -> Section:
    """Return the section with the table of GNSS outages; empty if there are none.

    The table has the 95 % radius of the predicted position at the end of each outage, and the distance of this position
    from the next fix, or from the last withheld fix if no fix follows. If GNSS fixes were withheld on purpose, it also
    has the RMS errors at these fixes.
    """
    found = result.outages
    if not found:
        return Section("outages", "", [])
    withheld = any(o.best is not None for o in found)
    columns = [
        ("record", ""),
        ("from", "num"),
        ("duration", "num"),
        ("95 % radius", "num"),
        ("error", "num"),
        ("allowed", "num"),
        ("verdict", ""),
    ]
    if withheld:
        columns += [("rms error, prediction", "num"), ("rms error, best estimate", "num")]
    lead = (
        "95 % radius: radius of the circle that contains the position at the end of the outage with 95 % probability, "
        "predicted without GNSS. Error: distance of this prediction from the first fix after the outage. Allowed: 95 % "
        "of these distances should be smaller, with the noise of the fix included. Inside: the error is at most the "
        "allowed one."
    )
    if withheld:
        lead += " RMS errors: for outages with GNSS fixes withheld on purpose, distances from all withheld fixes."
    return Section("outages", "GNSS outages", [Table(columns, [_outage_cells(o, withheld) for o in found])], lead)


def _outage_cells(o: GnssOutage, withheld: bool) -> list[Cell | str]:
    """Return the table cells of one GNSS outage; ``withheld`` adds two cells of RMS errors at withheld fixes.

    They are record, start, duration, 95 % radius of the position at the end, distance of a fix from it, 95 % limit of
    that distance, and whether the distance is within it. The fix is the next one, or the last withheld one if
    no fix follows. An unknown value is a dash.
    """
    verdict = {True: Cell("✓ inside", "good"), False: Cell("✗ outside", "bad"), None: Cell("–")}[o.inside]
    cells: list[Cell | str] = [
        o.record,
        Cell(f"{formatting.plain(o.start, 4)} s", "num"),
        Cell(f"{formatting.plain(o.duration)} s", "num"),
        _metres_cell(o.at_end.radius),
        _metres_cell(o.error),
        _metres_cell(o.allowed),
        verdict,
    ]
    errors = [None if e is None else e.rms for e in (o.predicted, o.best)]
    return [*cells, *(_metres_cell(rms) for rms in errors)] if withheld else cells


def _metres_cell(value: float | None) -> Cell:
    """Return the table cell of a length [m] with its unit. The cell has a dash if the length is None."""
    return Cell("–" if value is None else f"{formatting.plain(value)} m", "num")


def states_section(canvas: Canvas, result: NavigationResult) -> Section:
    """Return the section of the estimated states: one tab for each record with the track and all states over time.

    The section is empty if the model has no position and no state has finite values.

    Parameters
    ----------
    canvas
        Collector of the figures, to which the figures are added.
    result
        Estimated states and GNSS outages of each log.
    """
    tabs = []
    for row in result.navigation:
        outages, origin = [o for o in result.outages if o.record == row.record], origin_words(result.logs, row.record)
        tabs.append((row.record, _record_blocks(canvas, row, outages, origin)))
    if not any(blocks for _, blocks in tabs):
        return Section("navigation", "", [])
    lead = "Line: the estimate with its 95 % band, which includes the parameter errors. Grey: measurements."
    return Section("navigation", "Track and states", tabbed(tabs), lead)


def _record_blocks(canvas: Canvas, row: NavigatedRecord, outages: Sequence[GnssOutage], origin: str) -> list[Any]:
    """Return the blocks of one record: legend and figure of the track, and figure of the states over time.

    The list is empty if the model has no position and no state has finite values.

    Parameters
    ----------
    canvas
        Collector of the figures, to which the figures are added.
    row
        Estimated states of the record.
    outages
        GNSS outages of the record.
    origin
        End of the titles of the track's axes, for example `` of its first fix``.
    """
    blocks: list[Any] = []
    track = _track_plot(canvas, row, outages, origin)
    if track is not None:
        legend = [
            ("after", "estimate, with the 95 % ellipse at the end of each outage"),
            ("measured", "used fixes"),
            ("before", "withheld fixes"),
        ]
        blocks += [Key(legend), Grid([track], 320)]
    panels = [panel for s in row.states if (panel := _state_panel(canvas, row.t, s, outages)) is not None]
    if panels:
        figure, height = drawing.stacked(panels, TIME)
        blocks += [Prose("Shaded: GNSS outages.", "quiet")] if outages else []
        blocks.append(Grid([canvas.plot(figure, height, f"States over time, {row.record}")], 320))
    return blocks


def _state_panel(canvas: Canvas, t: Array, state: StateTrace, outages: Sequence[GnssOutage]) -> drawing.Panel | None:
    """Return the panel of one state over the times ``t`` (n,) [s] with its 95 % band; None without finite values.

    Measurements of the same quantity are added if there are any; those of an angle are shifted by whole turns to the
    estimate, which is not wrapped. The times of GNSS ``outages`` are shaded. ``canvas`` has the largest number of
    points of a trace; no figure is added to it.
    """
    if not np.isfinite(state.value).any():
        return None
    factor, unit = formatting.degrees_for(state.unit)
    value, sd = factor * state.value, factor * state.sd
    limit, traces = canvas.budget.points, []
    top, bottom = float(np.nanmax(value + drawing.Z95 * sd)), float(np.nanmin(value - drawing.Z95 * sd))
    if state.measured is not None and np.isfinite(state.measured).any():
        measured = factor * state.measured
        if state.angle:  # shifted by whole turns to the estimate, which is not wrapped
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


def _track_plot(canvas: Canvas, row: NavigatedRecord, outages: Sequence[GnssOutage], origin: str) -> Plot | None:
    """Return the plot of the track of a record with GNSS fixes and a 95 % ellipse at the end of each outage.

    An outage before the first fix has no ellipse. ``origin`` is the end of the titles of the axes. The plot is added to
    ``canvas``. The result is None if the states of the model do not include a position.
    """
    values = {s.name: s.value for s in row.states}
    if not {"x", "y"} <= set(values):
        return None
    traces = _fix_traces(row.fixes, canvas.budget.points)
    at = drawing.strided(row.t.size, canvas.budget.points)
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
        if not o.leading:  # before the first fix, the ellipse is wider than the track
            traces.append(_ellipse_trace(o))
    equal = {"scaleanchor": "x", "scaleratio": 1, "nticks": 7}
    figure = drawing.single(traces, f"east{origin} [m]", f"north{origin} [m]", hovermode="closest", yaxis=equal)
    return canvas.plot(figure, 420, f"Track, {row.record}", "Track, north up")


def _fix_traces(fixes: GnssFixes, limit: int) -> list[drawing.Trace]:
    """Return the traces of the used GNSS fixes and of the withheld ones, each of at most ``limit`` points.

    A trace without points is left out.
    """
    traces = []
    for used, name, color in ((1.0, "fix", drawing.MEASURED), (0.0, "withheld", drawing.BEFORE)):
        chosen = np.flatnonzero(fixes.used == used)
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


def _ellipse_trace(o: GnssOutage) -> drawing.Trace:
    """Return the trace of the 95 % ellipse about the position that is predicted for the end of a GNSS outage."""
    e = o.at_end
    a, b = e.major * np.cos(ELLIPSE_ANGLES), e.minor * np.sin(ELLIPSE_ANGLES)
    c, s = np.cos(e.azimuth), np.sin(e.azimuth)
    name = f"95 % after {formatting.plain(o.duration)} s"
    return {
        "type": "scatter",
        "mode": "lines",
        "name": drawing.escaped(name),
        "x": drawing.packed(o.east + s * a + c * b),
        "y": drawing.packed(o.north + c * a - s * b),
        "line": {"color": drawing.INK, "width": 1.4},
    }
