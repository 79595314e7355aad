"""Construction of Plotly figures as plain data: thinned and packed arrays, lines, bands, stacked panels.

A trace is a line, a set of dots or an area of a figure, in the JSON of Plotly.
"""

from __future__ import annotations

import base64
import heapq
import html
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.numerics import Array

Trace = dict[str, Any]
Figure = dict[str, Any]
Index = NDArray[np.intp]

# palette of Okabe and Ito (2008), distinguishable with any kind of colour vision
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
CUT = "The vertical range is limited: part of an interval or curve is outside. Double-click to show all of it."
Z95 = 1.96  # half width of a 95 % interval of the normal distribution, in standard deviations
ANGLES = (45.0, 90.0, 180.0, 360.0)  # distances of the ticks of an angle [deg]
INTERVALS = 5  # largest number of intervals between the ticks of an angle
LARGEST = float(np.finfo(np.float32).max)  # figures store 32-bit floats
# Colours of the figures on a dark page. Text has a contrast of at least 4.5 to the page, lines of at least 3.
DARK = {
    "#0072B2": "#5BB3EA",
    "#D55E00": "#FF9248",
    "#5b6470": "#A3AEBC",
    "#009E73": "#2FC79A",
    "#CC79A7": "#E29BC4",
    "#1c2430": "#E4E8EE",
    "#e6e9ee": "#2C3440",
    "#8a93a0": "#96A1AF",
    "#ffffff": "#151A21",
    "#FFFFFF": "#151A21",
    "rgba(0,114,178,": "rgba(91,179,234,",
    "rgba(255,255,255,": "rgba(21,26,33,",
    "#B34700": "#F08A45",
    "#F0A878": "#7A4A28",
    "#7DB8DE": "#2D5F82",
    "#005B93": "#4FA9E0",
    "#f4f6f8": "#1B222B",
    "#c3ddee": "#1F3D52",
    "#7db8dc": "#2A6590",
    "#2f8dc1": "#3F93C9",
    "#00466e": "#8FD0F5",
}
LEVELS = 65535  # whole numbers of 16 bits that a page stores in place of numbers; the largest one is a gap
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
    """Limit on the number of points of each trace (line of a figure), which keeps a page with many traces small.

    Attributes
    ----------
    points
        Largest number of points of a trace.
    """

    points: int = 3000

    @classmethod
    def for_traces(cls, n_traces: int, total: int = 200_000) -> Budget:
        """Return the limit for a page of about ``total`` points: ``total / n_traces``, at least ``total / 1000``.

        It is at most 3000.

        Parameters
        ----------
        n_traces
            Number of traces on the page; 0 counts as 1.
        total
            Number of points that all traces of the page together should have.
        """
        return cls(int(np.clip(total / max(n_traces, 1), total / 1000, 3000)))


def drawable(y: Array | None) -> Array | None:
    """Return the curve ``y``, or None if the page cannot draw it: it is missing, or it has no finite value."""
    return y if y is not None and np.isfinite(y).any() else None


def thinned(y: Array, limit: int) -> Index:
    """Return the indices of at most ``limit`` points of the line y (n,) that suffice to draw it, in ascending order.

    They are the first and the last point, and the minimum and the maximum of each of about ``limit / 2`` intervals.
    ``limit`` has to be four or more. All indices are returned if n is at most ``limit``. A value that is not finite is
    never the minimum or maximum of an interval that has finite values.
    """
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


def corners(x: Array, y: Array, limit: int) -> Index:
    """Return the indices of at most ``limit`` points that keep the shape of a line of steps and ramps, ascending.

    All indices are returned if n is at most ``limit``. `thinned` keeps the heights of a line, but joins the two levels
    of a step by a ramp as long as one of its intervals.

    Parameters
    ----------
    x, y
        Coordinates (n,) of the line; x ascends. The ends of the gaps of y (NaN) are kept, if they are few enough.
    limit
        Largest number of points; four or more.

    Notes
    -----
    The algorithm is that of Douglas and Peucker with vertical distances, and begins with the largest distance. Each new
    point is the one farthest from the straight line between the two points beside it.
    """
    n = y.size
    if n <= limit:
        return np.arange(n)
    good = np.isfinite(y)
    change = np.flatnonzero(np.diff(good))
    kept = list(np.unique(np.concatenate([[0], change, change + 1, [n - 1]])))
    if len(kept) > limit:
        return thinned(y, limit)
    parts: list[tuple[float, int, int, int]] = []

    def add(a: int, b: int) -> None:
        """Add the part from index a to index b to the heap, unless the points between them are on one line."""
        if b - a < 2 or not good[a] or not good[b]:
            return
        distance = np.abs(y[a + 1 : b] - np.interp(x[a + 1 : b], x[[a, b]], y[[a, b]]))
        k = int(np.argmax(distance))
        if distance[k] > 0.0:
            heapq.heappush(parts, (-float(distance[k]), a, a + 1 + k, b))

    for a, b in itertools.pairwise(kept):
        add(int(a), int(b))
    while parts and len(kept) < limit:
        _, a, middle, b = heapq.heappop(parts)
        kept.append(middle)
        add(a, middle)
        add(middle, b)
    return np.sort(np.array(kept, dtype=np.intp))


def strided(n: int, limit: int) -> Index:
    """Return the indices of at most ``limit`` of n points to draw, evenly spaced, with the first and the last point.

    All indices are returned if n is at most ``limit``.
    """
    return np.arange(n) if n <= limit else np.unique(np.linspace(0, n - 1, limit).round().astype(int))


def sampled(y: Array, limit: int, n_extreme: int = 40) -> Index:
    """Return the indices of the points y (n,) of a scatter plot to draw, in ascending order.

    If n is at most ``limit``, they are all indices. Otherwise they are those of ``limit`` evenly spaced points and of
    the ``n_extreme`` largest absolute values; NaN counts as 0.
    """
    if y.size <= limit:
        return np.arange(y.size)
    largest = np.argsort(-np.nan_to_num(np.abs(y)))[:n_extreme]
    return np.union1d(strided(y.size, limit), largest)


def packed(values: Any) -> Any:
    """Return an array (n,) of numbers in a compact form that Plotly reads.

    Up to 64 numbers become a list, in which each has six significant digits. More numbers become a dict with the base64
    text of little-endian 32-bit floats. Values that are not finite, or exceed the range of 32-bit floats (diverged
    models), become gaps of the line: None in the list, NaN in the floats.
    """
    a = np.asarray(values, dtype=float)
    a = np.where(np.abs(a) < LARGEST, a, np.nan)
    if a.size <= 64:
        return [float(f"{v:.6g}") if np.isfinite(v) else None for v in a]
    return {"dtype": "f4", "bdata": base64.b64encode(a.astype("<f4").tobytes()).decode("ascii")}


def compact(figure: Any) -> Any:
    """Return a figure with its packed numbers in 16 bits, for the JSON of a page; ``report.js`` restores them.

    A packed array becomes ``{"q": text, "low": l, "high": h}``: the base64 text of little-endian whole numbers. 0 is
    ``l``, 65534 is ``h`` and 65535 is a gap. The error is at most 1/131068 of the range of the array. A figure with a
    logarithmic axis, on which small numbers matter too, is returned unchanged.
    """
    axes = [value for key, value in figure["layout"].items() if key.startswith(("xaxis", "yaxis"))]
    return figure if any(axis.get("type") == "log" for axis in axes) else _in_16_bits(figure)


def _in_16_bits(value: Any) -> Any:
    """Return a value of a figure with its packed arrays in 16 bits, recursively. Other values are unchanged."""
    if isinstance(value, list):
        return [_in_16_bits(v) for v in value]
    if not isinstance(value, dict):
        return value
    if value.keys() != {"dtype", "bdata"}:
        return {k: _in_16_bits(v) for k, v in value.items()}
    a = np.frombuffer(base64.b64decode(value["bdata"]), "<f4").astype(np.float64)
    good = np.isfinite(a)
    low, high = (float(f(a[good])) if good.any() else 0.0 for f in (np.min, np.max))
    step = (high - low) / (LEVELS - 1) or 1.0
    levels = np.where(good, np.round((np.where(good, a, low) - low) / step), LEVELS).astype("<u2")
    return {"q": base64.b64encode(levels.tobytes()).decode("ascii"), "low": low, "high": high}


def escaped(words: str) -> str:
    """Return a text escaped for a figure: Plotly shows ``<b>`` as written and ``%{x}`` as ``% {x}``, not as a value."""
    return html.escape(words, quote=False).replace("%{", "% {")


def step_trace(x: Array, y: Array, name: str, limit: int, *, color: str = MODEL, dash: str = "solid") -> Trace:
    """Return the trace of a line of steps and ramps, such as an input, of which `corners` keeps the shape.

    The arguments are those of `line_trace`.
    """
    at = corners(x, y, limit)
    return line_trace(x[at], y[at], name, at.size, color=color, dash=dash)


def line_trace(
    x: Array, y: Array, name: str, limit: int, *, color: str = MODEL, dash: str = "solid", turn: float | None = None
) -> Trace:
    """Return the trace of a line through x and y, with gaps at NaN and where a wrapped angle jumps.

    A jump is a difference of neighbouring points of more than half a turn.

    Parameters
    ----------
    x, y
        Coordinates (n,) of the points.
    name
        Text in the legend and on hover.
    limit
        Largest number of points that are drawn, besides those of gaps; a longer line is thinned. Gaps of NaN are kept,
        unless they are more than an eighth of this number.
    color
        Colour, for example ``#0072B2``.
    dash
        Dash of the line in the words of Plotly, for example ``solid`` or ``dot``.
    turn
        A full turn in the unit of y if y is a wrapped angle, for example 360; None for other signals.
    """
    at = _with_ends_of_gaps(thinned(y, limit), y, limit // 8)
    style = {"color": color, "width": 1.6, "dash": dash}
    return _scatter(*_with_gaps_at_jumps(x[at], y[at], turn), name, mode="lines", line=style, connectgaps=False)


def trusted_lines(
    x: Array,
    y: Array,
    name: str,
    limit: int,
    trusted: tuple[float, float] | None,
    *,
    color: str = MODEL,
    unstable: NDArray[np.bool_] | None = None,
) -> list[Trace]:
    """Return the traces of a line that is solid where y is within the data, and dotted beyond.

    The dotted trace is named ``name, beyond the data``. A part within the data where the course is unstable is dashed,
    and named ``name, unstable course``.

    Parameters
    ----------
    x, y
        Coordinates (n,) of the points.
    name
        Text in the legend and on hover.
    limit
        Largest number of points of a trace.
    trusted
        Smallest and largest y of the data; None: the line is solid.
    color
        Colour, for example ``#0072B2``.
    unstable
        Whether the course is unstable at each point (n,); None: at none.

    Returns
    -------
    list of Trace
        One trace, and one for each further kind of part. Parts share the points at which they meet.
    """
    low, high = trusted or (-np.inf, np.inf)
    outside = (y < low) | (y > high)
    leaves = np.zeros(y.size, np.bool_) if unstable is None else unstable & ~outside
    traces = [line_trace(x, np.where(outside | leaves, np.nan, y), name, limit, color=color)]
    for part, words, dash in ((leaves, "unstable course", "dash"), (outside, "beyond the data", "dot")):
        if part.any():
            beside = part | np.append(part[1:], False) | np.append(False, part[:-1])
            beside &= part | ~outside  # the dashed part ends where the dotted one, which has this point too, begins
            traces.append(line_trace(x, np.where(beside, y, np.nan), f"{name}, {words}", limit, color=color, dash=dash))
    return traces


def continuous(angle: Array, turn: float) -> Array:
    """Return an angle (n,) without the jumps of whole turns; values that are not finite are unchanged.

    ``turn`` is a full turn in the unit of the angle, for example 360.
    """
    found, good = angle.copy(), np.isfinite(angle)
    found[good] = np.unwrap(angle[good], period=turn)
    return found


def beside(t: Array, angle: Array, t_samples: Array, samples: Array) -> Array:
    """Return a continuous angle (n,) [deg], shifted by whole turns so that its start is nearest to the samples (m,).

    Each piece between two gaps (NaN) is shifted by itself, because a simulation may begin anew after a gap.
    """
    seen = np.isfinite(samples)
    if not seen.any():
        return angle
    found = angle.copy()
    for piece in np.split(np.arange(angle.size), np.flatnonzero(np.diff(np.isfinite(angle))) + 1):
        if piece.size and np.isfinite(angle[piece[0]]):
            first = float(np.interp(t[piece[0]], t_samples[seen], samples[seen]))
            found[piece] += 360.0 * round((first - float(angle[piece[0]])) / 360.0)
    return found


def angle_step(limits: Sequence[float] | None, curves: Sequence[Array | None] = ()) -> float:
    """Return the distance of the ticks of an axis of angles [deg], for at most six ticks.

    It is 45, 90, 180 or 360 deg, or a multiple of 360 deg. The axis has the ``limits``, or those of the ``curves`` if
    they are None.
    """
    low, high = limits or _finite_span(curves)
    span = float(np.nan_to_num(high - low))
    whole = 360.0 * np.ceil(span / (360.0 * INTERVALS))
    return next((d for d in ANGLES if span <= INTERVALS * d), float(whole))


def _indices_after_jumps(y: Array, turn: float | None) -> Index:
    """Return the indices of the points just after a jump of a wrapped angle y (n,) by more than half a turn.

    ``turn`` is a full turn in the unit of y. If it is None, because y is no angle, the result is empty.
    """
    return np.flatnonzero(np.abs(np.diff(y)) > turn / 2) + 1 if turn else np.zeros(0, dtype=np.intp)


def _with_ends_of_gaps(at: Index, y: Array, most: int) -> Index:
    """Return indices of y (n,) with those of the ends of its gaps (NaN), if there are at most ``most`` gaps."""
    change = np.flatnonzero(np.diff(np.isfinite(y)))
    return np.union1d(at, np.append(change, change + 1)) if change.size <= 2 * most else at


def _with_gaps_at_jumps(x: Array, y: Array, turn: float | None) -> tuple[Array, Array]:
    """Return x and y (n,) with a NaN inserted in y before each jump of a wrapped angle by more than half a turn.

    ``turn`` is a full turn in the unit of y. If it is None, because y is no angle, x and y are returned unchanged.
    """
    at = _indices_after_jumps(y, turn)
    return np.insert(x, at, x[at]), np.insert(y, at, np.nan)


def dots(x: Array, y: Array, name: str, limit: int, *, color: str = MEASURED, turn: float | None = None) -> Trace:
    """Return the trace of measured values as dots, or as a thin line with gaps if there are more than 700.

    Values of y that are not finite are left out. The line has a gap where samples are more than eight times the median
    interval apart, and where a wrapped angle jumps by more than half a turn.

    Parameters
    ----------
    x, y
        Coordinates (n,) of the values.
    name
        Text in the legend and on hover.
    limit
        Largest number of points of the thin line; up to a quarter more may be added to keep its gaps. If there are more
        gaps than that, some are closed. Dots are kept.
    color
        Colour, for example ``#5b6470``.
    turn
        A full turn in the unit of y if y is a wrapped angle, for example 360; None for other signals.
    """
    x, y = x[np.isfinite(y)], y[np.isfinite(y)]
    if x.size <= 700:
        return _scatter(x, y, name, mode="markers", marker={"color": color, "size": 3.5, "opacity": 0.7})
    gap = np.flatnonzero(np.diff(x) > 8 * np.median(np.diff(x)))
    x, y = np.insert(x, gap + 1, x[gap]), np.insert(y, gap + 1, np.nan)
    at = thinned(y, limit)
    at = np.union1d(at, gap + 1 + np.arange(gap.size)) if gap.size < limit // 4 else at
    return _scatter(*_with_gaps_at_jumps(x[at], y[at], turn), name, mode="lines", line={"color": color, "width": 0.9})


def band(
    x: Array,
    middle: Array,
    half: Array,
    limit: int,
    *,
    color: str = MODEL,
    opacity: float = 0.18,
    turn: float | None = None,
    gaps: bool = False,
) -> Trace:
    """Return the trace of a filled band from ``middle - half`` to ``middle + half``, without hover text.

    Points that are not finite are left out. The band is split where a wrapped angle jumps by more than half a turn.

    Parameters
    ----------
    x
        Horizontal coordinates (n,).
    middle
        Curve (n,) in the middle of the band.
    half
        Half height (n,) of the band.
    limit
        Largest number of points of a trace on the page. The band has at most half as many, or 100 if that is more.
    color
        Colour, for example ``#0072B2``.
    opacity
        Opacity of the filling, 0 to 1.
    turn
        A full turn in the unit of ``middle`` if that is a wrapped angle, for example 360; None for other signals.
    gaps
        Whether the band is also split at points that are not finite; otherwise it continues across them.
    """
    good = np.flatnonzero(np.isfinite(x) & np.isfinite(middle) & np.isfinite(half))
    at = good[strided(good.size, max(limit // 2, 100))]
    ends = _indices_after_jumps(middle[at], turn)
    if gaps:
        missing = np.cumsum(~np.isin(np.arange(x.size), good))  # number of points that are left out so far
        ends = np.union1d(ends, np.flatnonzero(np.diff(missing[at])) + 1)
    return between(x[at], middle[at] - half[at], middle[at] + half[at], color=color, opacity=opacity, ends=ends)


def between(
    x: Array, low: Array, high: Array, *, color: str = MODEL, opacity: float = 0.18, ends: Index | None = None
) -> Trace:
    """Return the trace of the filled area between two curves, in one or more pieces, without hover text.

    All values must be finite.

    Parameters
    ----------
    x
        Horizontal coordinates (n,).
    low, high
        Lower and upper curve (n,).
    color
        Colour in hexadecimal digits, for example ``#0072B2``.
    opacity
        Opacity of the filling, 0 to 1.
    ends
        Indices of the points with which the second and each later piece begins. None: one piece.
    """
    pieces = [np.split(a, [] if ends is None else ends) for a in (x, low, high)]
    around = [(np.append(t, t[::-1]), np.append(b, a[::-1])) for t, a, b in zip(*pieces, strict=True)]
    sides = ([np.append(a, np.nan) for a in side] for side in zip(*around, strict=True))
    around_x, around_y = (np.concatenate(side)[:-1] for side in sides)
    red, green, blue = (int(color[i : i + 2], 16) for i in (1, 3, 5))
    fill = {"fill": "toself", "fillcolor": f"rgba({red},{green},{blue},{opacity})", "line": {"width": 0}}
    return _scatter(around_x, around_y, "", mode="lines", hoverinfo="skip", **fill)


def _scatter(x: Array, y: Array, name: str, **style: Any) -> Trace:
    """Return a Plotly scatter trace through x and y (n,), with packed coordinates and escaped name.

    ``name`` is the text in the legend and on hover, and ``style`` has further entries of the trace, for example its
    mode (lines or markers) and colour.
    """
    return {"type": "scatter", "x": packed(x), "y": packed(y), "name": escaped(name), **style}


@dataclass
class Panel:
    """Panel of a stacked figure: one pair of axes above or below others, with a common horizontal axis.

    Attributes
    ----------
    title
        Text above the left upper corner.
    traces
        Plotly traces (lines, dots, areas).
    y
        Entries of the Plotly layout of the vertical axis, for example its range.
    """

    title: str
    traces: list[Trace] = field(default_factory=list)
    y: dict[str, Any] = field(default_factory=dict)


def cut(panels: Sequence[Panel]) -> bool:
    """Return whether the vertical range of a panel is limited. Panels of wrapped angles do not count."""
    return any("range" in p.y and "tick0" not in p.y for p in panels)


def stacked(panels: Sequence[Panel], x_title: str, *, panel_height: int = 132) -> tuple[Figure, int]:
    """Return a figure of panels above each other with a common horizontal axis, and its height [px].

    The common axis makes all panels zoom together.

    Parameters
    ----------
    panels
        The panels from top to bottom; at least one.
    x_title
        Title of the common axis.
    panel_height
        Height of a panel without its title [px].
    """
    n, top, bottom, gap = len(panels), 22, 40, 26
    inner = n * panel_height + (n - 1) * gap
    data: list[Trace] = []
    layout: Figure = {
        "margin": {"l": 50, "r": 8, "t": top, "b": bottom},
        "xaxis": {
            "title": {"text": escaped(x_title)},
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


def axis_limits(shown: Sequence[Array | None], wide: Sequence[Array | None]) -> list[float] | None:
    """Return limits of the vertical axis that keep the curves ``shown`` readable; None if no limits are needed.

    Limits are needed if the curves ``wide`` are beyond ``shown``, above or below, by more than the height of ``shown``.
    They are then half of that height above and below ``shown``, or less if no curve reaches that far. A curve may be
    None. No limits are needed if ``shown`` has no finite values or no height.
    """
    least, most = _finite_span(shown)
    margin = 0.5 * (most - least)
    low, high = _finite_span([*shown, *wide])
    if not margin > 0.0 or (low >= least - 2.0 * margin and high <= most + 2.0 * margin):
        return None
    return [max(low, least - margin), min(high, most + margin)]


def _finite_span(curves: Sequence[Array | None]) -> tuple[float, float]:
    """Return the smallest and the largest finite value of several curves; both are NaN if there is no finite value.

    A curve of None is left out.
    """
    finite = [curve[np.isfinite(curve)] for curve in curves if curve is not None]
    every = np.concatenate(finite) if finite else np.empty(0)
    return (float(every.min()), float(every.max())) if every.size else (np.nan, np.nan)


def heading(title: str, y: float) -> dict[str, Any]:
    """Return the title of a panel as a Plotly annotation, above the left upper corner of the panel.

    ``y`` is the upper end of the panel, as a fraction (0 to 1) of the height of the figure's plotting area.
    """
    place = {"x": 0, "y": y, "xref": "paper", "yref": "paper", "xanchor": "left", "yanchor": "bottom"}
    return {"text": escaped(title), "showarrow": False, "font": {"size": 12, "color": INK}, **place}


def single(traces: list[Trace], x_title: str, y_title: str = "", **layout: Any) -> Figure:
    """Return a figure with one pair of axes.

    Parameters
    ----------
    traces
        Plotly traces (lines, dots, areas).
    x_title
        Title of the horizontal axis.
    y_title
        Title of the vertical axis. If it is empty, the left margin is smaller.
    **layout
        Further entries of the Plotly layout. Those of ``xaxis`` and ``yaxis`` are merged with the titles; the others
        replace the defaults.
    """
    x = {"title": {"text": escaped(x_title)}, **layout.pop("xaxis", {})}
    y = {"title": {"text": escaped(y_title)}, **layout.pop("yaxis", {})} if y_title else layout.pop("yaxis", {})
    margin = {"l": 58 if y_title else 42, "r": 8, "t": 8, "b": 36}
    return {"data": traces, "layout": {"xaxis": x, "yaxis": y, "margin": margin, **layout}}
