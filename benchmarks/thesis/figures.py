"""A page of figures from plain data: panels of curves above each other, grouped under headings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Literal

from seatrial.ident.numerics.linear_algebra import Array
from seatrial.ident.report.blocks import Canvas, Grid, Prose, Section
from seatrial.ident.report.drawing import (
    BEFORE,
    GREEN,
    LINES,
    MEASURED,
    MODEL,
    Budget,
    Panel,
    Trace,
    between,
    line_trace,
    stacked,
)
from seatrial.ident.report.page import compose

COLORS = {"measured": MEASURED, "model": MODEL, "other": BEFORE, "truth": GREEN}
POINTS = 60_000  # on the page


@dataclass(frozen=True)
class Curve:
    """x, y (n,); ``band``: the stretch between y and ``top`` (n,) is filled; ``axis``: one of several alike."""

    name: str
    x: Array
    y: Array
    role: Literal["measured", "model", "other", "truth", "band", "axis"] = "model"
    top: Array | None = None


@dataclass(frozen=True)
class Chart:
    """One panel: ``log`` makes both axes logarithmic."""

    title: str
    curves: Sequence[Curve]
    log: bool = False


@dataclass(frozen=True)
class Drawing:
    """One figure: its panels share an abscissa."""

    title: str
    x: str
    charts: Sequence[Chart]
    words: str = ""
    height: int = 190


@dataclass(frozen=True)
class Part:
    """Drawings under a heading."""

    id: str
    title: str
    drawings: Sequence[Drawing] = field(default_factory=tuple)


def write_figures(path: Path, kind: str, answer: str, lead: str, parts: Sequence[Part]) -> None:
    """One self-contained page that opens without a network."""
    n_curves = sum(len(c.curves) for p in parts for d in p.drawings for c in d.charts)
    canvas = Canvas(Budget.for_traces(n_curves, POINTS))
    body = [_section(canvas, part) for part in parts]
    opening = Section("top", "", [Prose(lead, "lead")])
    page = compose(kind, answer, opening, body, canvas.figures, version=version("seatrial"))
    path.write_text(page, encoding="utf-8", newline="\n")


def _section(canvas: Canvas, part: Part) -> Section:
    blocks: list[object] = []
    for drawing in part.drawings:
        panels = [Panel(c.title, _traces(c, canvas.budget.points), _axis(c.log)) for c in drawing.charts]
        figure, height = stacked(panels, drawing.x, panel_height=drawing.height)
        figure["layout"] |= {"showlegend": True, "legend": {"orientation": "h", "y": -0.22 * 190 / height}}
        figure["layout"]["xaxis"] |= {"type": "log"} if any(c.log for c in drawing.charts) else {}
        _name_once(figure["data"])
        plot = canvas.plot(figure, height + 46, f"{drawing.title}. {drawing.words}", drawing.title)
        blocks += [Grid([plot], least=600), *([Prose(drawing.words, "caption")] if drawing.words else [])]
    return Section(part.id, part.title, blocks)


def _name_once(traces: list[Trace]) -> None:
    """Curves of one name in several panels have one entry in the legend."""
    seen: set[str] = set()
    for trace in traces:
        trace["showlegend"] = trace["name"] not in seen
        seen.add(trace["name"])


def _axis(log: bool) -> dict[str, object]:
    return {"type": "log", "exponentformat": "power", "nticks": 8} if log else {}


def _traces(chart: Chart, limit: int) -> list[Trace]:
    found, alike = [], 0
    for curve in chart.curves:
        if curve.role == "band" and curve.top is not None:
            found.append(between(curve.x, curve.y, curve.top) | {"name": curve.name})
            continue
        color = COLORS.get(curve.role) or LINES[alike % len(LINES)]
        alike += curve.role == "axis"
        dash = "dot" if curve.role == "other" else "solid"
        found.append(line_trace(curve.x, curve.y, curve.name, limit, color=color, dash=dash))
    return found
