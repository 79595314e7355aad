"""The page of a designed mission: what it promises, against which baseline signals, and where the boat will go."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from seatrial.daq.files import write_output
from seatrial.ident.numerics import Array
from seatrial.ident.report import formatting
from seatrial.ident.report.blocks import Canvas, Cell, Facts, Grid, Prose, Section, Table
from seatrial.ident.report.drawing import AMBER, FAINT, GREEN, MODEL, Budget, Panel, Trace, line_trace, single, stacked
from seatrial.ident.report.page import compose
from seatrial.ident.results import DesignResult, DesignTrack

COLORS = {"design": MODEL, "PRBS": AMBER, "RGS": GREEN}
DASHES = {"design": "solid", "PRBS": "dash", "RGS": "dot"}
BINS = 60


def write_design_page(result: DesignResult, path: Path) -> None:
    """Write a design as one HTML page that opens without a network. Raises OSError where it cannot be written."""
    canvas = Canvas(Budget.for_traces(12))
    opening = Section("top", "", [Prose(_lead(result), "lead"), Facts(_facts(result))])
    body = [
        _errors(result),
        _inputs(canvas, result),
        _track(canvas, result.track),
        _baselines(canvas, result),
        _made(result),
    ]
    page = compose(
        "Mission design",
        result.answer,
        opening,
        [s for s in body if s.blocks],
        canvas.figures,
        version=result.seatrial,
        created=result.created,
        warnings=[warning.text for warning in result.warnings],
    )
    write_output(path, page)


def _lead(result: DesignResult) -> str:
    form = (
        "with process noise (prediction error)"
        if result.form == "prediction error"
        else ("without process noise (output error)")
    )
    return (
        f"Steps that maximise the {result.criterion} criterion of the Fisher information of "
        f"{', '.join(result.chosen)}, {form}. Standard errors after the mission are those of a "
        "prediction-error fit of this run together with what was known before."
    )


def _facts(result: DesignResult) -> list[tuple[str, str]]:
    found = [("model", result.model), ("criterion", formatting.plain(result.value, 4))]
    found += [(f"best of 20 {r.name}", formatting.plain(r.value, 4)) for r in result.baselines]
    found.append(("better than all in", formatting.percent(result.share_won, 1) + " of the samples"))
    if result.rates:
        found.append(("sensors", ", ".join(f"{name} {hz:.3g} Hz" for name, hz in result.rates.items())))
    if result.apart is not None:
        first, second = result.apart.effects
        found += [
            (f"T if {first} is true", formatting.plain(result.apart.if_first)),
            (f"T if {second} is true", formatting.plain(result.apart.if_second)),
        ]
    return found


def _errors(result: DesignResult) -> Section:
    columns = (
        ("parameter", ""),
        ("value", "num"),
        ("unit", ""),
        ("± before", "num"),
        ("± after", "num"),
        ("of the value", "num"),
        (f"± after the best {result.baseline}", "num"),
        ("meaning", ""),
    )
    lines: list[list[Cell | str]] = []
    for p in result.parameters:
        share = None if not p.value or p.after is None else abs(p.after / p.value)
        lines.append(
            [
                Cell(p.name, "symbol strong" if p.chosen else "symbol"),
                Cell(formatting.plain(p.value), "num"),
                Cell(formatting.tidy(p.unit), "nowrap"),
                Cell(formatting.plain(p.before), "num"),
                Cell(formatting.plain(p.after), "num"),
                Cell("> 100 %" if share is not None and share > 1 else formatting.percent(share, 1), "num"),
                Cell(formatting.plain(p.baseline), "num"),
                Cell(p.meaning, "wide"),
            ]
        )
    return Section(
        "errors",
        "What will be known",
        [Table(columns, lines)] if lines else [],
        "Standard errors; a dash before: nothing is known yet.",
    )


def _inputs(canvas: Canvas, result: DesignResult) -> Section:
    panels = [
        Panel(
            f"command {row.name}, -1..1",
            [line_trace(row.t, row.value, "command", canvas.budget.points)],
            {"range": [-1.08, 1.08]},
        )
        for row in result.inputs
    ]
    if not panels:
        return Section("inputs", "", [])
    figure, height = stacked(panels, "time since the first step [s]")
    return Section(
        "inputs", "What the thrusters are told", [Grid([canvas.plot(figure, height, "Commands over time")], 600)]
    )


def _track(canvas: Canvas, track: DesignTrack | None) -> Section:
    if track is None:
        return Section("track", "", [])
    traces: list[Trace] = []
    for k, other in enumerate(track.others):
        name = "boats within what is believed, with process noise" if k == 0 else ""
        traces.append(
            line_trace(other[:, 1], other[:, 0], name, 400, color=FAINT)
            | {"opacity": 0.35, "showlegend": k == 0, "hoverinfo": "skip"}
        )
    traces.append(line_trace(track.y, track.x, "nominal boat", 400) | {"showlegend": True})
    traces.append(_dot(track.y[:1], track.x[:1]))
    current = track.current
    water = f"the others in currents of up to {formatting.plain(current)} m/s" if current else "without current"
    words = f"The boat starts at 0, 0, at rest, heading north, {water}. The track is that of the whole "
    words += (
        f"mission: {track.rest:g} s at rest before the steps, and {track.coasting:g} s of coasting after the last. "
    )
    words += "Nobody steers: small errors of the model add up, so watch the geofence of the rig file."
    if track.corner is not None and track.area is not None and track.inside is not None:
        (south, west), area = track.corner, track.area
        words += (
            f" {formatting.percent(track.inside)} of the disturbed boats keep to the area (orange) if it begins "
            f"{formatting.plain(-south)} m south and {formatting.plain(-west)} m west of the start."
        )
        x, y = south + np.array([0, 1, 1, 0, 0]) * area[0], west + np.array([0, 0, 1, 1, 0]) * area[1]
        traces.append(line_trace(y, x, "area", 10, color=AMBER, dash="dash") | {"showlegend": True})
    figure = single(
        traces,
        "east [m]",
        "north [m]",
        yaxis={"scaleanchor": "x"},
        showlegend=True,
        hovermode="closest",
        legend={"orientation": "h", "y": 1.08},
    )
    return Section(
        "track",
        "Where the boat goes",
        [
            Grid([canvas.plot(figure, 560, "Predicted track with sampled boats")], 320, "narrow"),
            Prose(words, "caption"),
        ],
    )


def _dot(x: Array, y: Array) -> Trace:
    return {
        "type": "scatter",
        "mode": "markers",
        "x": x.tolist(),
        "y": y.tolist(),
        "name": "start",
        "marker": {"size": 9, "color": MODEL, "symbol": "square"},
        "showlegend": True,
    }


def _baselines(canvas: Canvas, result: DesignResult) -> Section:
    samples = result.samples
    if not samples:
        return Section("baselines", "", [])
    traces = [_histogram(name, values, edges_of(samples)) for name, values in samples.items()]
    figure = single(
        traces, f"{result.criterion} criterion", "samples", showlegend=True, legend={"orientation": "h", "y": 1.12}
    )
    lead = (
        "The criterion at 1000 samples of the parameters within what is believed of the boat: the standard errors of "
        "a model.toml, else uniform within the spread about the nominal values; "
        "larger is better, one unit is a factor e in the determinant. PRBS and RGS are each the best of 20, at the "
        "bandwidth and size that suit the nominal values, and keep to no limits of area, speed or energy."
    )
    return Section(
        "baselines",
        "Against random sequences, and if the boat is another",
        [Grid([canvas.plot(figure, 300, "Histogram of the criterion")], 520)],
        lead,
    )


def edges_of(samples: Mapping[str, Array]) -> Array:
    """Common bins of all histograms (n,), without the tails' last half per cent."""
    every = np.concatenate(list(samples.values()))
    low, high = np.quantile(every[np.isfinite(every)], [0.002, 0.998])
    return np.linspace(low, max(high, low + 1e-6), BINS + 1)


def _histogram(name: str, values: Array, edges: Array) -> Trace:
    count = np.histogram(np.clip(values, edges[0], edges[-1]), edges)[0].astype(float)
    outline_x, outline_y = np.repeat(edges, 2)[1:-1], np.repeat(count, 2)
    trace = line_trace(
        outline_x, outline_y, name, 1000, color=COLORS.get(name, FAINT), dash=DASHES.get(name, "dashdot")
    )
    return trace | {"fill": "tozeroy", "opacity": 0.8, "showlegend": True}


def _made(result: DesignResult) -> Section:
    facts = [("command", result.command), ("simulations", str(result.evaluations))]
    return Section("made", "How it was made", [Facts(facts, "made")])
