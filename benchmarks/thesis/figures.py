"""Writer of an HTML page with figures: panels of curves above each other, grouped under headings."""

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
from seatrial.ident.report.page import Answer, compose

COLORS = {"measured": MEASURED, "model": MODEL, "other": BEFORE, "truth": GREEN}
POINTS = 60_000  # largest number of points on the page


@dataclass(frozen=True)
class Curve:
    """Curve of a panel.

    Attributes
    ----------
    name : str
        Name in the legend.
    x, y : Array (n,)
        Points of the curve.
    role : str
        Role, which selects the colour. A "band" is filled between ``y`` and ``top``. Curves of role "axis" get
        different colours. Curves of role "other" are dotted.
    top : Array (n,), optional
        Upper edge of a band.
    """

    name: str
    x: Array
    y: Array
    role: Literal["measured", "model", "other", "truth", "band", "axis"] = "model"
    top: Array | None = None


@dataclass(frozen=True)
class Chart:
    """Panel of a figure.

    Attributes
    ----------
    title : str
        Title of the panel, with the unit of its ordinate.
    curves : sequence of Curve
        Curves in the panel.
    log : bool
        Whether both axes are logarithmic.
    """

    title: str
    curves: Sequence[Curve]
    log: bool = False


@dataclass(frozen=True)
class Drawing:
    """Figure of panels above each other, with a common abscissa.

    Attributes
    ----------
    title : str
        Title of the figure.
    x : str
        Title of the abscissa.
    charts : sequence of Chart
        Panels, from top to bottom.
    words : str
        Caption; may be empty.
    height : int
        Height of each panel in pixels.
    """

    title: str
    x: str
    charts: Sequence[Chart]
    words: str = ""
    height: int = 190


@dataclass(frozen=True)
class Part:
    """Section of the page: a heading with figures.

    Attributes
    ----------
    id : str
        Anchor of the section on the page.
    title : str
        Heading.
    drawings : sequence of Drawing
        Figures of the section.
    """

    id: str
    title: str
    drawings: Sequence[Drawing] = field(default_factory=tuple)


def write_figures(path: Path, kind: str, answer: str, lead: str, parts: Sequence[Part]) -> None:
    """Write a self-contained HTML page, which opens without a network.

    Parameters
    ----------
    path : Path
        File to write.
    kind : str
        Title of the page.
    answer : str
        Headline.
    lead : str
        Introduction.
    parts : sequence of Part
        Sections with their figures.
    """
    n_curves = sum(len(c.curves) for p in parts for d in p.drawings for c in d.charts)
    canvas = Canvas(Budget.for_traces(n_curves, POINTS))
    body = [_page_section(canvas, part) for part in parts]
    opening = Section("top", "", [Prose(lead, "lead")])
    page = compose(kind, Answer(answer), opening, body, canvas.figures, version=version("seatrial"))
    path.write_text(page, encoding="utf-8", newline="\n")


def _page_section(canvas: Canvas, part: Part) -> Section:
    """Return a section of the page with its plots and captions. The plots are added to ``canvas``."""
    blocks: list[object] = []
    for drawing in part.drawings:
        panels = [Panel(c.title, _panel_traces(c, canvas.budget.points), _axis_options(c.log)) for c in drawing.charts]
        figure, height = stacked(panels, drawing.x, panel_height=drawing.height)
        figure["layout"] |= {"showlegend": True, "legend": {"orientation": "h", "y": -0.22 * 190 / height}}
        figure["layout"]["xaxis"] |= {"type": "log"} if any(c.log for c in drawing.charts) else {}
        _hide_repeated_names(figure["data"])
        plot = canvas.plot(figure, height + 46, f"{drawing.title}. {drawing.words}", drawing.title)
        blocks += [Grid([plot], least=600), *([Prose(drawing.words, "caption")] if drawing.words else [])]
    return Section(part.id, part.title, blocks)


def _hide_repeated_names(traces: list[Trace]) -> None:
    """Hide repeated names in the legend, if curves in several panels have the same name. Change traces in place."""
    seen: set[str] = set()
    for trace in traces:
        trace["showlegend"] = trace["name"] not in seen
        seen.add(trace["name"])


def _axis_options(log: bool) -> dict[str, object]:
    """Return the plot options of a y axis: logarithmic with powers of ten if ``log`` is true, else empty."""
    return {"type": "log", "exponentformat": "power", "nticks": 8} if log else {}


def _panel_traces(chart: Chart, limit: int) -> list[Trace]:
    """Return the plot traces of a panel, one for each curve. ``limit`` is the largest number of points of a curve."""
    found, n_axes = [], 0
    for curve in chart.curves:
        if curve.role == "band" and curve.top is not None:
            found.append(between(curve.x, curve.y, curve.top) | {"name": curve.name})
            continue
        color = COLORS.get(curve.role) or LINES[n_axes % len(LINES)]
        n_axes += curve.role == "axis"
        dash = "dot" if curve.role == "other" else "solid"
        found.append(line_trace(curve.x, curve.y, curve.name, limit, color=color, dash=dash))
    return found
