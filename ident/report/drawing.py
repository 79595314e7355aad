"""Small tools for figures as plain data: thinned and packed arrays, lines, bands and stacked panels."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.numerics import Array

Trace = dict[str, Any]
Figure = dict[str, Any]
Index = NDArray[np.intp]

# Okabe and Ito's colours, which people with any kind of colour vision tell apart
MODEL, BEFORE, MEASURED, GREEN, PURPLE, SKY, AMBER = (
    "#0072B2",
    "#D55E00",
    "#5b6470",
    "#009E73",
    "#CC79A7",
    "#56B4E9",
    "#E69F00",
)
INK, GRID, FAINT = "#1c2430", "#e6e9ee", "#8a93a0"
LINES = (MODEL, AMBER, GREEN, PURPLE, SKY, BEFORE)
DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "solid")
Z95 = 1.96
LARGEST = float(np.finfo(np.float32).max)  # of what a figure can hold
FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif'
TEMPLATE: Figure = {
    "layout": {
        "font": {"family": FONT, "size": 12, "color": INK},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "colorway": list(LINES),
        "showlegend": False,
        "modebar": {"bgcolor": "rgba(255,255,255,0.8)", "color": FAINT, "activecolor": MODEL},
        "hovermode": "x unified",
        "hoverlabel": {"bgcolor": "#ffffff", "bordercolor": GRID, "font": {"size": 12}},
        "margin": {"l": 46, "r": 8, "t": 8, "b": 36},
        "xaxis": {"gridcolor": GRID, "zeroline": False, "automargin": False, "title": {"standoff": 6}},
        "yaxis": {"gridcolor": GRID, "zeroline": False, "automargin": False, "nticks": 5, "hoverformat": ".4~g"},
    }
}


@dataclass
class Budget:
    """How many points a trace may have, so that a page with many of them stays small."""

    points: int = 3000

    @classmethod
    def for_traces(cls, n_traces: int, total: int = 220_000) -> Budget:
        """About ``total`` points on the page; never more than 3000 a trace, never fewer than 200."""
        return cls(int(np.clip(total / max(n_traces, 1), 200, 3000)))


def drawable(y: Array | None) -> Array | None:
    """None where there is not one finite number."""
    return y if y is not None and np.isfinite(y).any() else None


def thinned(y: Array, limit: int) -> Index:
    """Indices of at most ``limit`` points that keep the smallest and the largest of every interval."""
    n = y.size
    if n <= limit:
        return np.arange(n)
    width = -(-n // max((limit - 2) // 2, 1))
    padded = np.full(-(-n // width) * width, np.nan)
    padded[:n] = y
    table = padded.reshape(-1, width)
    low = np.argmin(np.where(np.isfinite(table), table, np.inf), axis=1)
    high = np.argmax(np.where(np.isfinite(table), table, -np.inf), axis=1)
    start = np.arange(len(table)) * width
    return np.unique(np.concatenate([[0], np.minimum(start + low, n - 1), np.minimum(start + high, n - 1), [n - 1]]))


def strided(n: int, limit: int) -> Index:
    """Indices of at most ``limit`` points at equal distance, first and last among them."""
    return np.arange(n) if n <= limit else np.unique(np.linspace(0, n - 1, limit).round().astype(int))


def sampled(y: Array, limit: int, n_extreme: int = 40) -> Index:
    """Indices of at most about ``limit`` points of a cloud: at equal distance, and the largest of all."""
    if y.size <= limit:
        return np.arange(y.size)
    largest = np.argsort(-np.nan_to_num(np.abs(y)))[:n_extreme]
    return np.union1d(strided(y.size, limit), largest)


def packed(values: Any) -> Any:
    """Numbers for a figure: short ones as a list, long ones as little-endian 32-bit floats in base64. What is too large
    for these, of a model that ran away, is left out."""
    a = np.asarray(values, dtype=float)
    a = np.where(np.abs(a) < LARGEST, a, np.nan)
    if a.size <= 64:
        return [float(f"{v:.6g}") if np.isfinite(v) else None for v in a]
    return {"dtype": "f4", "bdata": base64.b64encode(a.astype("<f4").tobytes()).decode("ascii")}


def said(words: str) -> str:
    """A text for a figure: what looks like markup is shown as written."""
    return html.escape(words, quote=False).replace("%{", "% {")


def line_trace(
    x: Array, y: Array, name: str, limit: int, *, color: str = MODEL, dash: str = "solid", turn: float | None = None
) -> Trace:
    """A line of at most ``limit`` points; it breaks where y is NaN, and an angle where it jumps by a ``turn``."""
    at = thinned(y, limit)
    style = {"color": color, "width": 1.6, "dash": dash}
    return _scatter(*_broken(x[at], y[at], turn), name, mode="lines", line=style, connectgaps=False)


def _jumps(y: Array, turn: float | None) -> Index:
    """Points before which a wrapped angle jumps to the other side."""
    return np.flatnonzero(np.abs(np.diff(y)) > turn / 2) + 1 if turn else np.zeros(0, dtype=np.intp)


def _broken(x: Array, y: Array, turn: float | None) -> tuple[Array, Array]:
    """With a NaN at each jump."""
    at = _jumps(y, turn)
    return np.insert(x, at, x[at]), np.insert(y, at, np.nan)


def dots(x: Array, y: Array, name: str, limit: int, *, color: str = MEASURED, turn: float | None = None) -> Trace:
    """Measured values: dots where they are few, a thin line (broken at gaps) where they are many."""
    x, y = x[np.isfinite(y)], y[np.isfinite(y)]
    if x.size <= 700:
        return _scatter(x, y, name, mode="markers", marker={"color": color, "size": 3.5, "opacity": 0.7})
    gap = np.flatnonzero(np.diff(x) > 8 * np.median(np.diff(x)))
    x, y = np.insert(x, gap + 1, x[gap]), np.insert(y, gap + 1, np.nan)
    at = thinned(y, limit)
    at = np.union1d(at, gap + 1 + np.arange(gap.size)) if gap.size < limit // 4 else at
    return _scatter(*_broken(x[at], y[at], turn), name, mode="lines", line={"color": color, "width": 0.9})


def band(
    x: Array,
    middle: Array,
    half: Array,
    limit: int,
    *,
    color: str = MODEL,
    opacity: float = 0.18,
    turn: float | None = None,
) -> Trace:
    """What is between middle - half and middle + half, filled; in pieces where an angle jumps by a ``turn``."""
    good = np.flatnonzero(np.isfinite(x) & np.isfinite(middle) & np.isfinite(half))
    at = good[strided(good.size, max(limit // 2, 100))]
    ends = _jumps(middle[at], turn)
    return between(x[at], middle[at] - half[at], middle[at] + half[at], color=color, opacity=opacity, ends=ends)


def between(
    x: Array, low: Array, high: Array, *, color: str = MODEL, opacity: float = 0.18, ends: Index | None = None
) -> Trace:
    """What is between two curves, filled; it does not answer the pointer. ``ends``: points that begin a new piece."""
    pieces = [np.split(a, [] if ends is None else ends) for a in (x, low, high)]
    around = [(np.append(t, t[::-1]), np.append(b, a[::-1])) for t, a, b in zip(*pieces, strict=True)]
    sides = ([np.append(a, np.nan) for a in side] for side in zip(*around, strict=True))
    around_x, around_y = (np.concatenate(side)[:-1] for side in sides)
    red, green, blue = (int(color[i : i + 2], 16) for i in (1, 3, 5))
    fill = {"fill": "toself", "fillcolor": f"rgba({red},{green},{blue},{opacity})", "line": {"width": 0}}
    return _scatter(around_x, around_y, "", mode="lines", hoverinfo="skip", **fill)


def _scatter(x: Array, y: Array, name: str, **style: Any) -> Trace:
    return {"type": "scatter", "x": packed(x), "y": packed(y), "name": said(name), **style}


@dataclass
class Panel:
    """One row of a stacked figure: its traces and what stands above it."""

    title: str
    traces: list[Trace] = field(default_factory=list)
    y: dict[str, Any] = field(default_factory=dict)


def stacked(panels: Sequence[Panel], x_title: str, *, panel_height: int = 132) -> tuple[Figure, int]:
    """Panels above each other on one x axis, so they zoom together; returns the figure and its height [px]."""
    n, top, bottom, gap = len(panels), 22, 40, 26
    inner = n * panel_height + (n - 1) * gap
    data: list[Trace] = []
    layout: Figure = {
        "margin": {"l": 50, "r": 8, "t": top, "b": bottom},
        "xaxis": {
            "title": {"text": said(x_title)},
            "anchor": f"y{n}" if n > 1 else "y",
            "hoverformat": ".2f",
            "showspikes": True,
            "spikemode": "across",
            "spikethickness": 1,
            "spikecolor": FAINT,
            "spikedash": "solid",
        },
        "annotations": [],
    }
    for i, panel in enumerate(panels):
        high = 1 - i * (panel_height + gap) / inner
        axis = "" if i == 0 else str(i + 1)
        layout[f"yaxis{axis}"] = {"domain": [max(high - panel_height / inner, 0.0), high], "anchor": "x", **panel.y}
        data += [{**trace, "xaxis": "x", "yaxis": f"y{axis}"} for trace in panel.traces]
        layout["annotations"].append(heading(panel.title, high))
    return {"data": data, "layout": layout}, inner + top + bottom


def heading(title: str, y: float) -> dict[str, Any]:
    """A panel's title above its left corner."""
    place = {"x": 0, "y": y, "xref": "paper", "yref": "paper", "xanchor": "left", "yanchor": "bottom"}
    return {"text": said(title), "showarrow": False, "font": {"size": 12, "color": INK}, **place}


def single(traces: list[Trace], x_title: str, y_title: str = "", **layout: Any) -> Figure:
    """One pair of axes; further keyword arguments update the layout (``xaxis`` and ``yaxis`` are merged)."""
    x = {"title": {"text": said(x_title)}, **layout.pop("xaxis", {})}
    y = {"title": {"text": said(y_title)}, **layout.pop("yaxis", {})} if y_title else layout.pop("yaxis", {})
    margin = {"l": 58 if y_title else 42, "r": 8, "t": 8, "b": 36}
    return {"data": traces, "layout": {"xaxis": x, "yaxis": y, "margin": margin, **layout}}
