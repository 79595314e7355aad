"""Section of sensor noise in a report page: white noise and random walk of each channel, and the test of this model."""

from __future__ import annotations

from typing import Any

import numpy as np

from seatrial.ident.numerics import Array
from seatrial.ident.report import drawing, formatting
from seatrial.ident.report.blocks import Canvas, Cell, Grid, Heading, Key, Plot, Prose, Section, Table
from seatrial.ident.results import AllanCurve, ChannelNoise, NoiseResult, SpectrumBands


def section(canvas: Canvas, result: NoiseResult) -> Section:
    """Return the section of sensor noise: a table of all channels, plots of power spectral densities, Allan deviations.

    The section is empty if the result has no channels.

    Parameters
    ----------
    canvas
        Collector of the figures, to which the plots are added.
    result
        Noise of each channel of sensors at rest.
    """
    columns = (
        ("channel", ""),
        ("white noise", "num"),
        ("random walk", "num"),
        ("model accepted", ""),
        ("predictable share", "num"),
        ("p", "num"),
    )
    blocks: list[Any] = [Table(columns, [_noise_cells(c) for c in result.noise])] if result.noise else []
    plots = [plot for c in result.noise if (plot := _density_plot(canvas, c)) is not None]
    if plots:
        lines = [("measured", "measured power spectral density, with averages over bands and their 95 % intervals")]
        blocks += [Key([*lines, ("after", "power spectral density of the fitted model")]), Grid(plots, 320)]
    blocks += _allan_blocks(canvas, result)
    return Section("noise", "Noise of each channel", blocks)


ROOT_HOUR, HOUR = 60.0, 3600.0  # square root of an hour, and an hour, in s


def data_sheet(c: ChannelNoise) -> tuple[tuple[float, str], tuple[float, str], tuple[float, str]]:
    """Return the factors and units in which a data sheet gives noise density, bias instability and random walk.

    The factors are from the units of the result (unit sqrt(s), unit, unit/sqrt(s)). A yaw rate is in deg/√h (angle
    random walk), deg/h and deg/h/√h. An acceleration is in m/s/√h (velocity random walk), µg and µg/√h. Other channels
    have the unit that the report shows (an angle is in deg), with the density per √Hz and the random walk per √s.
    """
    if c.unit == "rad/s":
        degrees = formatting.DEGREES
        walk = degrees * HOUR * ROOT_HOUR
        return (degrees * ROOT_HOUR, "deg/√h"), (degrees * HOUR, "deg/h"), (walk, "deg/h/√h")
    if c.unit in ("m/s2", "m/s^2"):
        micro_g = 1e6 / formatting.STANDARD_GRAVITY
        return (ROOT_HOUR, "m/s/√h"), (micro_g, "µg"), (micro_g * ROOT_HOUR, "µg/√h")
    factor, unit = formatting.degrees_for(c.unit)
    return (factor, f"{unit or '1'}/√Hz"), (factor, unit), (factor, f"{unit or '1'}/√s")


def _allan_blocks(canvas: Canvas, result: NoiseResult) -> list[Any]:
    """Return heading, table in the units of data sheets, and plots of the Allan deviation; empty without any.

    The plots are added to ``canvas``.
    """
    known = [(c, c.allan) for c in result.noise if c.allan is not None]
    if not known:
        return []
    columns = (
        ("channel", ""), ("white noise", "num"), ("bias instability", "num"), ("at", "num"), ("random walk", "num")
    )  # fmt: skip
    rows = [_data_sheet_cells(c, allan) for c, allan in known]
    words = (
        "White noise and random walk are those of the fitted model. The bias instability is the smallest Allan "
        "deviation / 0.664; ‘<’: the deviation still falls at the longest averaging time, so a longer record is needed."
    )
    key = Key([("measured", "Allan deviation, with its standard error"), ("after", "that of the fitted model")])
    plots = [_allan_plot(canvas, c, allan) for c, allan in known]
    return [Heading("In units of data sheets"), Table(columns, rows), Prose(words, "caption"),
            Heading("Allan deviation"), key, Grid(plots, 320)]  # fmt: skip


def _data_sheet_cells(c: ChannelNoise, allan: AllanCurve) -> list[Cell | str]:
    """Return the table cells of one channel in the units of data sheets. A noise that was not found has its limit."""
    (density, density_unit), (bias, bias_unit), (walk, walk_unit) = data_sheet(c)
    scale = allan.density / c.white if c.white > 0.0 else 0.0  # square root of the sample interval
    instability = formatting.plain(bias * allan.bias_instability, 2)
    return [
        formatting.named(c.channel),
        Cell(formatting.noise_level(c.white, c.se_white, c.white_limit, density * scale, density_unit), "num"),
        Cell(f"{'< ' * allan.is_limit}{instability} {bias_unit}".strip(), "num"),
        Cell(f"{formatting.plain(allan.bias_tau, 2)} s", "num"),
        Cell(formatting.noise_level(c.random_walk, c.se_random_walk, c.random_walk_limit, walk, walk_unit), "num"),
    ]


def _allan_plot(canvas: Canvas, c: ChannelNoise, allan: AllanCurve) -> Plot:
    """Return the plot of the Allan deviation of a channel, and of that of white noise plus a random walk.

    The variance of the model is ``N^2 / tau + K^2 tau / 3`` with the density N and the intensity K of the random walk.
    The plot is added to ``canvas``.
    """
    factor, unit = formatting.degrees_for(c.unit)
    model = np.sqrt(allan.density**2 / allan.tau + c.random_walk**2 * allan.tau / 3.0)
    error = drawing.packed(factor * np.minimum(allan.error, 0.9 * allan.deviation))
    bars = {"type": "data", "array": error, "thickness": 1, "width": 0, "color": drawing.MEASURED}
    points = {"x": drawing.packed(allan.tau), "y": drawing.packed(factor * allan.deviation), "name": "measured"}
    marker = {"color": drawing.MEASURED, "size": 4}
    traces = [
        {"type": "scatter", "mode": "markers", **points, "marker": marker, "error_y": bars},
        drawing.line_trace(allan.tau, factor * model, "model", canvas.budget.points),
    ]
    log = {"type": "log", "exponentformat": "power", "dtick": 1}
    if allan.deviation.max() < 300.0 * allan.deviation.min():
        log["dtick"] = "D2"  # labels at 1, 2 and 5 too
    figure = drawing.single(traces, "averaging time [s]", xaxis={"type": "log", "dtick": 1}, yaxis=log)
    title = formatting.named(c.channel)
    return canvas.plot(figure, 230, f"Allan deviation of {title}", f"{title}{formatting.bracket(unit)}")


def _noise_cells(c: ChannelNoise) -> list[Cell | str]:
    """Return the table cells of one channel: name, white noise, random walk, verdict, predictable share and p value.

    The predictable share is that of the variance of the innovations; the p value is that of the Ljung-Box test. The
    noise is in the unit that the report shows. A noise that was not found is shown by its 95 % upper limit.
    """
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


def _density_plot(canvas: Canvas, c: ChannelNoise) -> Plot | None:
    """Return the plot of the measured and modelled power spectral density of a channel; None without finite values.

    Both axes are logarithmic; points whose frequency or density is not positive are left out. The plot is added to
    ``canvas``.
    """
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
        traces.append(_band_averages_trace(c.bands, factor**2))
    log = {"type": "log", "exponentformat": "power", "nticks": 6}
    square = f"({unit})²" if not unit.isalpha() else f"{unit}²"
    title = formatting.named(c.channel)
    shown = f"{title} [{square}/Hz]" if unit else f"{title} [1/Hz]"
    figure = drawing.single(
        traces, "frequency [Hz]", xaxis=_frequency_axis(c.frequency), yaxis=log | {"automargin": True}
    )
    return canvas.plot(figure, 230, f"Power spectral density of {title}", shown)


def _band_averages_trace(bands: SpectrumBands, factor: float) -> drawing.Trace:
    """Return the trace of the measured power spectral density, averaged over frequency bands, with 95 % intervals.

    ``factor`` converts the density to the shown unit.
    """
    y, low, high = (factor * a for a in (bands.psd, bands.low, bands.high))
    bars = {"type": "data", "symmetric": False, "array": drawing.packed(high - y),
            "arrayminus": drawing.packed(y - low), "thickness": 1, "width": 0, "color": drawing.MEASURED}  # fmt: skip
    return drawing.dots(bands.frequency, y, "average", y.size) | {"error_y": bars}


def _frequency_axis(frequency: Array) -> dict[str, Any]:
    """Return the Plotly layout of a logarithmic axis for the frequencies [Hz], with ticks at powers of ten.

    If they span less than 2.5 decades, ticks at 2 and 5 times these powers are added. If no frequency is positive, the
    ticks are left to Plotly.
    """
    positive = frequency[frequency > 0]
    if not positive.size:
        return {"type": "log"}
    low, high = np.log10(positive.min()), np.log10(positive.max())
    steps = (1, 2, 5) if high - low < 2.5 else (1,)
    values = [m * 10.0**k for k in range(int(np.floor(low)), int(np.ceil(high)) + 1) for m in steps]
    shown = [v for v in values if low <= np.log10(v) <= high]
    return {"type": "log", "tickvals": shown, "ticktext": [f"{v:g}" for v in shown]}
