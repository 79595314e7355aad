"""Noise of each channel: white noise and random walk, and whether that model holds."""

from __future__ import annotations

from typing import Any

import numpy as np

from ident.report import drawing, formatting
from ident.report.access import Row, array, flag, number, rows, text
from ident.report.blocks import Canvas, Cell, Grid, Prose, Section, Table


def section(canvas: Canvas) -> Section:
    """White noise and random walk of each channel, and whether that model holds."""
    found = rows(canvas.result, "noise")
    lines = [_noise_row(row) for row in found]
    columns = (("channel", ""), ("white noise", "num"), ("random walk", "num"), ("model holds", ""),
               ("predictable", "num"), ("p", "num"))
    plots = [_density(canvas, row) for row in found]
    grid = [Grid([p for p in plots if p], 320)] if any(plots) else []
    key = "Power spectral densities: grey measured, blue the fitted model."
    blocks = [Table(columns, lines), *([Prose(key, "quiet"), *grid] if grid else [])] if lines else []
    return Section("noise", "Noise of each channel", blocks)


def _noise_row(row: Row) -> list[Cell | str]:
    factor, unit = formatting.degrees_for(text(row, "unit"))
    cells: list[Cell | str] = [formatting.named(text(row, "channel"))]
    for key, shown in (("white", unit), ("walk", f"{unit}/√s" if unit else "1/√s")):
        value, se = (None if v is None else factor * v for v in (number(row, key), number(row, f"se_{key}")))
        cells.append(Cell(formatting.with_error(value, se, shown if value is not None else ""), "num"))
    accepted = flag(row, "accepted")
    verdict = {True: Cell("✓ yes", "good"), False: Cell("✗ no", "bad"), None: Cell("–")}[accepted]
    share = Cell(formatting.percent(number(row, "predictable"), 1), "num")
    return [*cells, verdict, share, Cell(formatting.probability(number(row, "p")), "num")]


def _density(canvas: Canvas, row: Row) -> Any:
    frequency, psd, model = (array(row, key) for key in ("frequency", "psd", "psd_model"))
    factor, unit = formatting.degrees_for(text(row, "unit"))
    traces = []
    for values, name in ((psd, "measured"), (model, "model")):
        if frequency is None or values is None or values.size != frequency.size:
            continue
        good = (frequency > 0) & (values > 0)
        x, y, limit = frequency[good], factor**2 * values[good], canvas.budget.points
        if name == "model":
            traces.append(drawing.line(x, y, name, limit))
        else:
            at = drawing.thinned(np.log(y), limit) if y.size else np.arange(0)
            traces.append(drawing.line(x[at], y[at], name, limit, color=drawing.FAINT))
            traces[-1]["line"]["width"] = 0.9
    if not traces:
        return None
    log = {"type": "log", "exponentformat": "power", "nticks": 6}
    square = f"({unit})²" if not unit.isalpha() else f"{unit}²"
    title = formatting.named(text(row, "channel"))
    shown = f"{title} [{square}/Hz]" if unit else f"{title} [1/Hz]"
    figure = drawing.single(traces, "frequency [Hz]", xaxis=_ticks(frequency), yaxis=log | {"automargin": True})
    return canvas.plot(figure, 230, f"Power spectral density of {title}", shown)


def _ticks(frequency: Any) -> dict[str, Any]:
    """A logarithmic axis with 1, 2 and 5 of each decade where it has few of them, else with its powers of ten."""
    there = frequency[frequency > 0]
    if not there.size:
        return {"type": "log"}
    low, high = np.log10(there.min()), np.log10(there.max())
    steps = (1, 2, 5) if high - low < 2.5 else (1,)
    values = [m * 10.0**k for k in range(int(np.floor(low)), int(np.ceil(high)) + 1) for m in steps]
    shown = [v for v in values if low <= np.log10(v) <= high]
    return {"type": "log", "tickvals": shown, "ticktext": [f"{v:g}" for v in shown]}
