"""Sensor noise: white noise and random walk of each channel, and whether that model holds."""

from __future__ import annotations

from typing import Any

import numpy as np

from seatrial.ident.numerics import Array
from seatrial.ident.report import drawing, formatting
from seatrial.ident.report.blocks import Canvas, Cell, Grid, Key, Plot, Section, Table
from seatrial.ident.results import ChannelNoise, NoiseResult, SpectrumBands


def section(canvas: Canvas, result: NoiseResult) -> Section:
    """A table of all channels, and the densities of each."""
    columns = (
        ("channel", ""),
        ("white noise", "num"),
        ("random walk", "num"),
        ("model holds", ""),
        ("predictable", "num"),
        ("p", "num"),
    )
    blocks: list[Any] = [Table(columns, [_row(c) for c in result.noise])] if result.noise else []
    plots = [plot for c in result.noise if (plot := _density(canvas, c)) is not None]
    if plots:
        lines = [("measured", "power spectral density, and its average over bands with 95 % interval")]
        blocks += [Key([*lines, ("after", "of the fitted model")]), Grid(plots, 320)]
    return Section("noise", "Noise of each channel", blocks)


def _row(c: ChannelNoise) -> list[Cell | str]:
    factor, unit = formatting.degrees_for(c.unit)
    cells: list[Cell | str] = [formatting.named(c.channel)]
    walk_unit = f"{unit}/√s" if unit else "1/√s"
    cells += [
        Cell(formatting.noise_level(c.white, c.se_white, c.white_limit, factor, unit), "num"),
        Cell(formatting.noise_level(c.random_walk, c.se_random_walk, c.random_walk_limit, factor, walk_unit), "num"),
    ]
    verdict = Cell("✓ yes", "good") if c.accepted else Cell("✗ no", "bad")
    share = Cell(formatting.percent(c.predictable, 1), "num")
    return [*cells, verdict, share, Cell(formatting.probability(c.p), "num")]


def _density(canvas: Canvas, c: ChannelNoise) -> Plot | None:
    factor, unit = formatting.degrees_for(c.unit)
    traces = []
    for values, name in ((c.psd, "measured"), (c.psd_model, "model")):
        if not np.isfinite(values).any():
            continue
        good = (c.frequency > 0) & (values > 0)
        x, y, limit = c.frequency[good], factor**2 * values[good], canvas.budget.points
        if name == "model":
            traces.append(drawing.line_trace(x, y, name, limit))
        else:
            at = drawing.thinned(np.log(y), limit) if y.size else np.arange(0)
            traces.append(drawing.line_trace(x[at], y[at], name, limit, color=drawing.GRID))
            traces[-1]["line"]["width"] = 0.9
    if not traces:
        return None
    if c.bands is not None:
        traces.append(_averages(c.bands, factor**2))
    log = {"type": "log", "exponentformat": "power", "nticks": 6}
    square = f"({unit})²" if not unit.isalpha() else f"{unit}²"
    title = formatting.named(c.channel)
    shown = f"{title} [{square}/Hz]" if unit else f"{title} [1/Hz]"
    figure = drawing.single(traces, "frequency [Hz]", xaxis=_ticks(c.frequency), yaxis=log | {"automargin": True})
    return canvas.plot(figure, 230, f"Power spectral density of {title}", shown)


def _averages(bands: SpectrumBands, factor: float) -> drawing.Trace:
    """Dots with bars: what can be told from the model by eye."""
    y, low, high = (factor * a for a in (bands.psd, bands.low, bands.high))
    bars = {"type": "data", "symmetric": False, "array": drawing.packed(high - y),
            "arrayminus": drawing.packed(y - low), "thickness": 1, "width": 0, "color": drawing.MEASURED}  # fmt: skip
    return drawing.dots(bands.frequency, y, "average", y.size) | {"error_y": bars}


def _ticks(frequency: Array) -> dict[str, Any]:
    """A logarithmic axis with 1, 2 and 5 of each decade where it has few of them, else with its powers of ten."""
    there = frequency[frequency > 0]
    if not there.size:
        return {"type": "log"}
    low, high = np.log10(there.min()), np.log10(there.max())
    steps = (1, 2, 5) if high - low < 2.5 else (1,)
    values = [m * 10.0**k for k in range(int(np.floor(low)), int(np.ceil(high)) + 1) for m in steps]
    shown = [v for v in values if low <= np.log10(v) <= high]
    return {"type": "log", "tickvals": shown, "ticktext": [f"{v:g}" for v in shown]}
