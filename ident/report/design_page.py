"""The page of a designed mission: what it promises, against what rivals, and what the boat is going to do."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ident.numerics import Array
from ident.report import formatting
from ident.report.access import Row, group, number, rows, text, texts
from ident.report.blocks import Canvas, Cell, Facts, Grid, Prose, Section, Table
from ident.report.drawing import AMBER, FAINT, GREEN, MODEL, Budget, Panel, Trace, line, single, stacked
from ident.report.page import compose

COLORS = {"design": MODEL, "PRBS": AMBER, "RGS": GREEN}
DASHES = {"design": "solid", "PRBS": "dash", "RGS": "dot"}
BINS = 60


def write_design_page(result: Mapping[str, Any], path: Path) -> None:
    """Write the content of a design's JSON as one HTML page that opens without a network."""
    canvas = Canvas(result, Budget.for_traces(12))
    opening = Section("top", "", [Prose(_lead(result), "lead"), Facts(_facts(result))])
    body = [_errors(result), _inputs(canvas), _track(canvas), _rivals(canvas), _made(result)]
    page = compose("Mission design", text(result, "answer"), opening, [s for s in body if s.blocks], canvas.figures,
                   version=text(result, "seatrial"), created=text(result, "created"))
    path.write_text(page, encoding="utf-8", newline="\n")


def _lead(result: Row) -> str:
    form = "with process noise (prediction error)" if text(result, "form") == "prediction error" else (
        "without process noise (output error)")
    return (f"Steps that maximise the {text(result, 'criterion')} criterion of the Fisher information of "
            f"{', '.join(texts(result, 'chosen'))}, {form}. Standard errors after the mission are those of a "
            "prediction-error fit of this run together with what was known before.")


def _facts(result: Row) -> list[tuple[str, str]]:
    found = [("model", text(result, "model")), ("criterion", formatting.plain(number(result, "value"), 4))]
    found += [
        (f"best of 20 {text(r, 'name')}", formatting.plain(number(r, "value"), 4)) for r in rows(result, "rivals")
    ]
    found.append(("better than all in", formatting.percent(number(result, "share_won"), 1) + " of the samples"))
    apart = group(result, "apart")
    if apart:
        first, second = texts(apart, "effects")
        found += [(f"T if {first} is true", formatting.plain(number(apart, "if_first"))),
                  (f"T if {second} is true", formatting.plain(number(apart, "if_second")))]
    return found


def _errors(result: Row) -> Section:
    columns = (("parameter", ""), ("value", "num"), ("unit", ""), ("± before", "num"), ("± after", "num"),
               ("of the value", "num"), (f"± after the best {text(result, 'rival')}", "num"), ("meaning", ""))
    lines: list[list[Cell | str]] = []
    for row in rows(result, "parameters"):
        value, after = number(row, "value"), number(row, "after")
        share = None if not value or after is None else abs(after / value)
        lines.append([Cell(text(row, "name"), "symbol strong" if row.get("chosen") else "symbol"),
                      Cell(formatting.plain(value), "num"), Cell(formatting.tidy(text(row, "unit")), "nowrap"),
                      Cell(formatting.plain(number(row, "before")), "num"), Cell(formatting.plain(after), "num"),
                      Cell("> 100 %" if share is not None and share > 1 else formatting.percent(share, 1), "num"),
                      Cell(formatting.plain(number(row, "rival")), "num"), Cell(text(row, "meaning"), "wide")])
    return Section("errors", "What will be known", [Table(columns, lines)] if lines else [],
                   "Standard errors; a dash before: nothing is known yet.")


def _inputs(canvas: Canvas) -> Section:
    panels = []
    for row in rows(canvas.result, "inputs"):
        t, value = np.asarray(row["t"]), np.asarray(row["value"])
        panels.append(Panel(f"command {text(row, 'name')}, -1..1", [line(t, value, "command", canvas.budget.points)],
                            {"range": [-1.08, 1.08]}))
    if not panels:
        return Section("inputs", "", [])
    figure, height = stacked(panels, "time since the first step [s]")
    return Section("inputs", "What the thrusters are told",
                   [Grid([canvas.plot(figure, height, "Commands over time")], 600)])


def _track(canvas: Canvas) -> Section:
    track = group(canvas.result, "track")
    if not track:
        return Section("track", "", [])
    x, y = np.asarray(track["x"]), np.asarray(track["y"])
    traces: list[Trace] = []
    for k, other in enumerate(np.asarray(track["others"])):
        name = "boats within what is believed, with process noise" if k == 0 else ""
        traces.append(line(other[:, 1], other[:, 0], name, 400, color=FAINT)
                      | {"opacity": 0.35, "showlegend": k == 0, "hoverinfo": "skip"})
    traces.append(line(y, x, "nominal boat", 400) | {"showlegend": True})
    traces.append(_dot(y[:1], x[:1]))
    current = number(track, "current")
    water = f"the others in currents of up to {formatting.plain(current)} m/s" if current else "without current"
    words = f"The boat starts at 0, 0, at rest, heading north, {water}. Nobody steers: small errors of the "
    words += "model add up, so watch the geofence of the rig file."
    corner, area, inside = track.get("corner"), track.get("area"), number(track, "inside")
    if corner is not None and area is not None and inside is not None:
        south, west = corner
        words += (f" {formatting.percent(inside)} of the disturbed boats keep to the area (orange) if it begins "
                  f"{formatting.plain(-south)} m south and {formatting.plain(-west)} m west of the start.")
        x, y = south + np.array([0, 1, 1, 0, 0]) * area[0], west + np.array([0, 0, 1, 1, 0]) * area[1]
        traces.append(line(y, x, "area", 10, color=AMBER, dash="dash") | {"showlegend": True})
    figure = single(traces, "east [m]", "north [m]", yaxis={"scaleanchor": "x"}, showlegend=True, hovermode="closest",
                    legend={"orientation": "h", "y": 1.08})
    return Section("track", "Where the boat goes", [
        Grid([canvas.plot(figure, 560, "Predicted track with sampled boats")], 320, "narrow"), Prose(words, "caption")])


def _dot(x: Array, y: Array) -> Trace:
    return {"type": "scatter", "mode": "markers", "x": x.tolist(), "y": y.tolist(), "name": "start",
            "marker": {"size": 9, "color": MODEL, "symbol": "square"}, "showlegend": True}


def _rivals(canvas: Canvas) -> Section:
    samples = group(canvas.result, "samples")
    if not samples:
        return Section("rivals", "", [])
    traces = [_histogram(name, np.asarray(values), edges_of(samples)) for name, values in samples.items()]
    figure = single(traces, f"{text(canvas.result, 'criterion')} criterion", "samples", showlegend=True,
                    legend={"orientation": "h", "y": 1.12})
    lead = ("The criterion at 1000 samples of the parameters, uniform within the spread about the nominal values; "
            "larger is better, one unit is a factor e in the determinant. PRBS and RGS are each the best of 20, at the "
            "bandwidth and size that suit the nominal values, and keep to no limits of area, speed or energy.")
    return Section("rivals", "Against random sequences, and if the boat is another", [
        Grid([canvas.plot(figure, 300, "Histogram of the criterion")], 520)], lead)


def edges_of(samples: Mapping[str, Any]) -> Array:
    """Common bins of all histograms (n,), without the tails' last half per cent."""
    every = np.concatenate([np.asarray(v) for v in samples.values()])
    low, high = np.quantile(every[np.isfinite(every)], [0.002, 0.998])
    return np.linspace(low, max(high, low + 1e-6), BINS + 1)


def _histogram(name: str, values: Array, edges: Array) -> Trace:
    count = np.histogram(np.clip(values, edges[0], edges[-1]), edges)[0].astype(float)
    outline_x, outline_y = np.repeat(edges, 2)[1:-1], np.repeat(count, 2)
    trace = line(outline_x, outline_y, name, 1000, color=COLORS.get(name, FAINT), dash=DASHES.get(name, "dashdot"))
    return trace | {"fill": "tozeroy", "opacity": 0.8, "showlegend": True}


def _made(result: Row) -> Section:
    facts = [("command", text(result, "command")), ("simulations", text(result, "evaluations"))]
    return Section("made", "How it was made", [Facts(facts, "made")])
