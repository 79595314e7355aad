"""Residuals: is anything left in the innovations, and do they still know the inputs?"""

from __future__ import annotations

from typing import Any

import numpy as np

from ident.numerics import Array
from ident.report import drawing, formatting
from ident.report.access import RecordTab, Row, along, array, flag, group, number, of_take, rows, takes, text
from ident.report.blocks import Canvas, Cell, Grid, Heading, Key, Plot, Section, Table, tabbed

KOLMOGOROV_95 = 1.358  # of sqrt(m) times the largest distance of a cumulative periodogram (Bartlett 1955)


def section(canvas: Canvas) -> Section:
    """One tab a record: a table of verdicts, three plots a channel, and the correlations with the inputs."""
    result = canvas.result
    both = {take: None for key in ("residuals", "cross") for take in takes(result, key)}
    tabs = [(take.title, _verdicts(result, take) + _channels(canvas, take) + _cross(canvas, take)) for take in both]
    if not any(blocks for _, blocks in tabs):
        return Section("residuals", "", [])
    lead = "One-step prediction errors in units of their predicted standard deviation. Of a complete model they are "
    lead += "white: inside the grey bands in 95 of 100 cases. Each channel is judged alone, at 1 %; the answer "
    lead += "weighs all of them together."
    two = any(group(row, "after") for key in ("residuals", "cross") for row in rows(result, key))
    key = [Key([("before-dots", "before"), ("after-dots", "after the effects were added")])] if two else []
    return Section("residuals", "Residuals", [*key, *tabbed(tabs)], lead)


def _versions(row: Row) -> list[tuple[str, Row, str]]:
    """(name, values, colour): before and after where there are both, else the one."""
    after = group(row, "after")
    if after:
        return [("before", row, drawing.BEFORE), ("after", after, drawing.MODEL)]
    return [("residual", row, drawing.MODEL)]


def _verdicts(result: Row, take: RecordTab) -> list[Any]:
    found = of_take(result, "residuals", take)
    columns = (("channel", ""), ("white", ""), ("Ljung–Box p", "num"), ("periodogram p", "num"), ("normal p", "num"))
    return [Table(columns, [_verdict(row) for row in found])] if found else []


def _verdict(row: Row) -> list[Cell | str]:
    versions = [values for _, values, _ in _versions(row)]
    mark = {True: "✓", False: "✗", None: "–"}
    last = flag(versions[-1], "white")
    verdict = " → ".join(mark[flag(v, "white")] for v in versions)
    cells: list[Cell | str] = [
        formatting.named(text(row, "channel")),
        Cell(verdict, {True: "nowrap good", False: "nowrap bad", None: "nowrap"}[last]),
    ]
    for key in ("ljung_box_p", "periodogram_p", "normal_p"):
        cells.append(Cell(" → ".join(formatting.probability(number(v, key)) for v in versions), "num"))
    return cells


def _channels(canvas: Canvas, take: RecordTab) -> list[Any]:
    blocks: list[Any] = []
    for row in of_take(canvas.result, "residuals", take):
        makers = (_over_time, _autocorrelation, _periodogram)
        plots = [plot for make in makers if (plot := make(canvas, row, take))]
        if plots:
            blocks += [Heading(formatting.titled(text(row, "channel"))), Grid(plots, 250)]
    return blocks


def _over_time(canvas: Canvas, row: Row, take: RecordTab) -> Plot | None:
    traces = []
    for name, values, color in _versions(row):
        t, e = array(values, "t"), array(values, "e")
        t = array(row, "t") if t is None else t
        if t is None or e is None or t.size != e.size:
            continue
        at = drawing.sampled(e, canvas.budget.points // 2)
        points = {"type": "scatter", "mode": "markers", "x": drawing.packed(t[at]), "y": drawing.packed(e[at])}
        traces.append({**points, "name": name, "marker": {"color": color, "size": 2.6, "opacity": 0.55}})
    if not traces:
        return None
    band = [_level(level) for level in (-drawing.Z95, drawing.Z95)]
    figure = drawing.single(traces, "time [s]", shapes=band, hovermode="closest")
    return canvas.plot(figure, 210, _label("Innovations over time", row, take), "Standardised innovations")


def _level(y: float) -> dict[str, Any]:
    line = {"color": drawing.FAINT, "width": 1, "dash": "dot"}
    return {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": y, "y1": y, "line": line}


def _stretch(half: float) -> dict[str, Any]:
    style = {"fillcolor": "#8a93a0", "opacity": 0.22, "line": {"width": 0}, "layer": "below"}
    return {"type": "rect", "xref": "paper", "x0": 0, "x1": 1, "y0": -half, "y1": half, **style}


def _label(what: str, row: Row, take: RecordTab) -> str:
    return f"{what}, {formatting.named(text(row, 'channel'))}, {take.title}"


def _stems(x: Array, y: Array, name: str, color: str) -> drawing.Trace:
    marker = {"color": color, "size": 5, "symbol": "circle-open" if name == "before" else "circle"}
    line = {"color": color, "width": 1, "dash": "dot" if name == "before" else "solid"}
    where = {"x": drawing.packed(x), "y": drawing.packed(y)}
    return {"type": "scatter", "mode": "lines+markers", "name": name, "marker": marker, "line": line, **where}


def _autocorrelation(canvas: Canvas, row: Row, take: RecordTab) -> Plot | None:
    traces = []
    for name, values, color in _versions(row):
        found = along(
            values if array(values, "lags") is not None else {**values, "lags": row.get("lags")}, "lags", "acf"
        )
        if found and found[1][0] is not None:
            traces.append(_stems(found[0], found[1][0], name, color))
    if not traces:
        return None
    half = number(row, "band")
    shapes = [_stretch(half)] if half else []
    figure = drawing.single(traces, "lag [s]", shapes=shapes)
    return canvas.plot(figure, 210, _label("Autocorrelation", row, take), "Autocorrelation")


def _periodogram(canvas: Canvas, row: Row, take: RecordTab) -> Plot | None:
    traces, top = [], 0.0
    for name, values, color in _versions(row):
        base = values if array(values, "frequency") is not None else {**values, "frequency": row.get("frequency")}
        found = along(base, "frequency", "cumulative")
        if found and found[1][0] is not None:
            dash = "dot" if name == "before" else "solid"
            x, y = found[0], found[1][0]
            at = drawing.strided(x.size, canvas.budget.points // 4)
            traces.append(drawing.line(x[at], y[at], name, 3000, color=color, dash=dash))
            top = max(top, float(np.nanmax(found[0])))
    if not traces:
        return None
    acf_band = number(row, "band")  # 1.96 / sqrt(n), and there are n/2 frequencies
    ends = np.array([0.0, top])
    if acf_band:
        half = KOLMOGOROV_95 * acf_band / drawing.Z95 * np.sqrt(2.0)
        low, high = np.array([-half, 1 - half]), np.array([half, 1 + half])
        traces.insert(0, drawing.between(ends, low, high, color=drawing.FAINT, opacity=0.22))
    figure = drawing.single(traces, "frequency [Hz]", yaxis={"range": [-0.05, 1.05]}, xaxis={"range": [0, top]})
    return canvas.plot(figure, 210, _label("Cumulative periodogram", row, take), "Cumulative periodogram")


def _cross(canvas: Canvas, take: RecordTab) -> list[Any]:
    plots = []
    for row in of_take(canvas.result, "cross", take):
        traces, p = [], []
        for name, values, color in _versions(row):
            base = values if array(values, "lags") is not None else {**values, "lags": row.get("lags")}
            found = along(base, "lags", "z")
            if found and found[1][0] is not None:
                traces.append(_stems(found[0], found[1][0], name, color))
                p.append(formatting.probability(number(values, "p")))
        if traces:
            figure = drawing.single(traces, "lag [s]", shapes=[_stretch(drawing.Z95)])
            channel, name = (formatting.symbol(text(row, key)) for key in ("channel", "input"))
            title = f"{channel} × {name}"
            shown = f"{title} · p {' → '.join(p)}"
            plots.append(canvas.plot(figure, 180, f"Cross-correlation, {title}, {take.title}", shown))
    note = "correlation in its standard deviations under independence, over the lag of the input"
    return [Heading("With the inputs", note), Grid(plots, 250)] if plots else []
