"""Section of residuals in a report page: whiteness of the innovations and their correlation with the inputs.

An innovation is a measured sample minus its prediction from earlier samples; here it is divided by its predicted
standard deviation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from seatrial.ident.numerics import Array
from seatrial.ident.report import drawing, formatting
from seatrial.ident.report.blocks import Canvas, Cell, Grid, Heading, Key, OnScreen, Plot, Section, Table, tabbed
from seatrial.ident.report.record_tabs import RecordTab, of_record, record_tabs, roles_of
from seatrial.ident.results import (
    ComparisonResult,
    CorrelationTest,
    CrossCorrelationRow,
    DiagnosisResult,
    FitResult,
    ResidualTests,
    WhitenessTests,
)

T = TypeVar("T", WhitenessTests, CorrelationTest)
# 95 % quantile of sqrt(m) times the largest distance of the cumulative periodogram of white noise from the diagonal,
# for m frequencies (Bartlett 1955)
KOLMOGOROV_95 = 1.358


def section(canvas: Canvas, result: FitResult) -> Section:
    """Return the section of the residuals of a fit: one tab for each record; empty without residuals.

    A tab has the table of whiteness tests, up to three plots for each channel, and the correlations with the inputs.

    Parameters
    ----------
    canvas
        Collector of the figures, to which the plots are added.
    result
        Result of a fit, with whiteness tests and correlations.
    """
    # The answer of a diagnosis has no sentence on the residuals.
    top = "The sentence at the top of the page tests all channels of the estimation data together."
    end = "" if isinstance(result, DiagnosisResult) else top
    return _section(canvas, result.residuals, result.cross, roles_of(result.logs, result.traces), end)


def evaluation_section(canvas: Canvas, result: ComparisonResult) -> Section:
    """Return the section of the residuals of one model on the logs of its evaluation; empty without residuals.

    Figures are added to ``canvas``.
    """
    (model,) = result.models
    return _section(canvas, model.residuals, model.cross, roles_of(result.logs))


def _section(
    canvas: Canvas,
    found: Sequence[ResidualTests],
    correlations: Sequence[CrossCorrelationRow],
    roles: Mapping[str, str],
    end: str = "",
) -> Section:
    """Return the section of residuals with a tab for each record; ``end`` is the last sentence of its lead."""
    tabs = []
    for tab in record_tabs([*found, *correlations], roles):
        rows, cross = of_record(found, tab), of_record(correlations, tab)
        tabs.append(
            (
                tab.title,
                _whiteness_table(rows)
                + _not_printed([*_channel_plots(canvas, rows, tab), *_cross_correlation_blocks(canvas, cross, tab)]),
            )
        )
    if not any(blocks for _, blocks in tabs):
        return Section("residuals", "", [])
    lead = (
        "One-step prediction errors divided by their predicted standard deviation. The residuals of a complete model "
        "are white: 95 % of the values are inside the grey bands. Each channel is tested alone, by both tests "
        f"together at 1 % (Bonferroni): ✗ if either p is below 0.5 %. {end}"
    ).rstrip()
    compared = any(r.after is not None for r in found) or any(c.after is not None for c in correlations)
    key = [Key([("before-dots", "before"), ("after-dots", "after the effects were added")])] if compared else []
    return Section("residuals", "Residuals", [*key, *tabbed(tabs)], lead)


def _not_printed(plots: list[Any]) -> list[Any]:
    """Return the plots of a record as a block that is not printed, in a list of one; empty without plots."""
    words = (
        "On the screen, the page also has the plots of the innovations of each channel over time, of their "
        "autocorrelation, of their cumulative periodogram and of their cross-correlation with the inputs."
    )
    return [OnScreen(plots, words)] if plots else []


def _before_and_after(row: T, after: T | None) -> list[tuple[str, T, str]]:
    """Return (label, values, colour) of the curves in a plot of residuals: those before and after effects were added.

    ``row`` has the values of the model before, and ``after`` those of the model with the effects. If ``after`` is None,
    because there is only one model, the only entry is that of ``row`` with the label ``residual``.
    """
    if after is not None:
        return [("before", row, drawing.BEFORE), ("after", after, drawing.MODEL)]
    return [("residual", row, drawing.MODEL)]


def _whiteness_table(found: Sequence[ResidualTests]) -> list[Any]:
    """Return the table of the whiteness tests of a record, one row for each channel, as a list of one.

    The list is empty without channels.
    """
    columns = (
        ("channel", ""),
        ("white", ""),
        *((title, "num") for title in ("Ljung–Box p", "periodogram p", "normal p", "beyond 6 σ", "largest")),
    )
    return [Table(columns, [_whiteness_cells(row) for row in found])] if found else []


def _whiteness_cells(row: ResidualTests) -> list[Cell | str]:
    """Return the table cells of one channel: name, verdict, p values, number of outliers, largest residual.

    The p values are those of the Ljung-Box test, of the cumulative periodogram and of the test of normality. An outlier
    is beyond six standard deviations. If effects were added, each cell except the name has the values before and after,
    joined by an arrow.
    """
    versions: list[WhitenessTests] = [row] if row.after is None else [row, row.after]
    verdict = " → ".join("✓" if v.white else "✗" for v in versions)
    cells: list[Cell | str] = [
        formatting.named(row.channel),
        Cell(verdict, "nowrap good" if versions[-1].white else "nowrap bad"),
    ]
    tests = ([v.ljung_box_p for v in versions], [v.periodogram_p for v in versions], [v.normal_p for v in versions])
    cells += [Cell(" → ".join(map(formatting.probability, values)), "num") for values in tests]
    style = "num bad" if versions[-1].outliers else "num"
    largest = " → ".join(formatting.plain(v.largest, 2) for v in versions)
    return [*cells, Cell(" → ".join(str(v.outliers) for v in versions), style), Cell(f"{largest} σ", "num")]


def _channel_plots(canvas: Canvas, rows: Sequence[ResidualTests], tab: RecordTab) -> list[Any]:
    """Return a heading and up to three plots for each channel of a record.

    The plots are innovations over time, autocorrelation and cumulative periodogram, as far as they have finite values.
    They are added to ``canvas``. A channel without plots has no heading. ``rows`` has the channels, and ``tab`` the
    title of the record.
    """
    blocks: list[Any] = []
    for row in rows:
        makers = (_innovations_plot, _autocorrelation_plot, _periodogram_plot)
        plots = [plot for make in makers if (plot := make(canvas, row, tab))]
        if plots:
            blocks += [Heading(formatting.titled(row.channel)), Grid(plots, 250)]
    return blocks


def _innovations_plot(canvas: Canvas, row: ResidualTests, tab: RecordTab) -> Plot | None:
    """Return the plot of the standardised innovations of a channel over time; None without finite values.

    95 % of the innovations of a complete model are between the lines at ±1.96. Of many innovations only a part is
    drawn, with the largest. ``tab`` has the title of the record for the description of the plot, which is added to
    ``canvas``.
    """
    traces = []
    for name, values, color in _before_and_after(row, row.after):
        t, e = row.t, values.e
        if drawing.drawable(e) is None or t.size != e.size:
            continue
        at = drawing.sampled(e, canvas.budget.points // 2)
        points = {"type": "scatter", "mode": "markers", "x": drawing.packed(t[at]), "y": drawing.packed(e[at])}
        traces.append({**points, "name": name, "marker": {"color": color, "size": 2.6, "opacity": 0.55}})
    if not traces:
        return None
    band = [_horizontal_line(level) for level in (-drawing.Z95, drawing.Z95)]
    figure = drawing.single(traces, "time since the start of the log [s]", shapes=band, hovermode="closest")
    return canvas.plot(figure, 210, _plot_label("Innovations over time", row, tab), "Standardised innovations")


def _horizontal_line(y: float) -> dict[str, Any]:
    """Return a dotted horizontal line at ``y``, over the width of the plot, as a shape of a Plotly layout."""
    line = {"color": drawing.FAINT, "width": 1, "dash": "dot"}
    return {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": y, "y1": y, "line": line}


def _horizontal_band(half: float) -> dict[str, Any]:
    """Return a grey band from ``-half`` to ``half``, over the width of the plot, as a shape of a Plotly layout."""
    style = {"fillcolor": "#8a93a0", "opacity": 0.22, "line": {"width": 0}, "layer": "below"}
    return {"type": "rect", "xref": "paper", "x0": 0, "x1": 1, "y0": -half, "y1": half, **style}


def _plot_label(plot: str, row: ResidualTests, tab: RecordTab) -> str:
    """Return the description of a plot for screen readers: kind (``plot``), channel, role and name of the record."""
    return f"{plot}, {formatting.named(row.channel)}, {tab.title}"


def _stem_trace(x: Array, y: Array, name: str, color: str) -> drawing.Trace:
    """Return the trace of markers at x and y (n,), joined by a thin line.

    ``name`` is the text on hover. If it is "before", the markers are open and the line is dotted.
    """
    marker = {"color": color, "size": 5, "symbol": "circle-open" if name == "before" else "circle"}
    line = {"color": color, "width": 1, "dash": "dot" if name == "before" else "solid"}
    coordinates = {"x": drawing.packed(x), "y": drawing.packed(y)}
    return {"type": "scatter", "mode": "lines+markers", "name": name, "marker": marker, "line": line, **coordinates}


def _autocorrelation_plot(canvas: Canvas, row: ResidualTests, tab: RecordTab) -> Plot | None:
    """Return the plot of the autocorrelation of a channel's innovations over the lag [s]; None without finite values.

    The band contains 95 % of the values of white innovations. ``tab`` has the title of the record for the description
    of the plot, which is added to ``canvas``.
    """
    traces = []
    for name, values, color in _before_and_after(row, row.after):
        if drawing.drawable(values.acf) is not None and values.acf.size == row.lags.size:
            traces.append(_stem_trace(row.lags, values.acf, name, color))
    if not traces:
        return None
    figure = drawing.single(traces, "lag [s]", shapes=[_horizontal_band(row.band)])
    return canvas.plot(figure, 210, _plot_label("Autocorrelation", row, tab), "Autocorrelation")


def _periodogram_plot(canvas: Canvas, row: ResidualTests, tab: RecordTab) -> Plot | None:
    """Return the plot of the cumulative periodogram of a channel's innovations; None without finite values.

    The curve is the share of the variance at frequencies up to each frequency [Hz]. For white innovations the whole
    curve is inside the band about the diagonal with 95 % probability. ``tab`` has the title of the record for the
    description of the plot, which is added to ``canvas``.
    """
    traces, top = [], 0.0
    for name, values, color in _before_and_after(row, row.after):
        x, y = row.frequency, values.cumulative
        if drawing.drawable(y) is not None and x.size == y.size:
            dash = "dot" if name == "before" else "solid"
            at = drawing.strided(x.size, canvas.budget.points // 4)
            traces.append(drawing.line_trace(x[at], y[at], name, 3000, color=color, dash=dash))
            top = max(top, float(np.nanmax(x)))
    if not traces:
        return None
    half = KOLMOGOROV_95 * row.band / drawing.Z95 * np.sqrt(2.0)  # band: 1.96 / sqrt(n), for n/2 frequencies
    ends, low, high = np.array([0.0, top]), np.array([-half, 1 - half]), np.array([half, 1 + half])
    traces.insert(0, drawing.between(ends, low, high, color=drawing.FAINT, opacity=0.22))
    figure = drawing.single(traces, "frequency [Hz]", yaxis={"range": [-0.05, 1.05]}, xaxis={"range": [0, top]})
    return canvas.plot(figure, 210, _plot_label("Cumulative periodogram", row, tab), "Cumulative periodogram")


def _cross_correlation_blocks(canvas: Canvas, rows: Sequence[CrossCorrelationRow], tab: RecordTab) -> list[Any]:
    """Return heading and plots of the correlation of residuals with inputs, one plot for each channel and input.

    The correlation, over the lag [s], is in standard deviations under independence. Plots without finite values are
    left out; the list is empty if no plot is left. ``tab`` has the title of the record. The plots are added to
    ``canvas``.
    """
    plots = []
    for row in rows:
        traces, p = [], []
        for name, values, color in _before_and_after(row, row.after):
            if drawing.drawable(values.z) is not None and values.z.size == row.lags.size:
                traces.append(_stem_trace(row.lags, values.z, name, color))
                p.append(formatting.probability(values.p))
        if traces:
            figure = drawing.single(traces, "lag [s]", shapes=[_horizontal_band(drawing.Z95)])
            channel, name = (formatting.symbol(word) for word in (row.channel, row.input))
            title = f"{channel} × {name}"
            shown = f"{title} · p {' → '.join(p)}"
            plots.append(canvas.plot(figure, 180, f"Cross-correlation, {title}, {tab.title}", shown))
    note = "in units of the standard deviation that independent signals have, over the lag of the input"
    return [Heading("Cross-correlation with the inputs", note), Grid(plots, 250)] if plots else []
