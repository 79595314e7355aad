"""Sections of prediction errors and calibration of prediction intervals, and the last sections of the page."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from seatrial.ident.report import drawing, formatting
from seatrial.ident.report.blocks import Canvas, Cell, Facts, Grid, Heading, Lines, Plot, Prose, Section, Table, tabbed
from seatrial.ident.results import (
    CalibrationRow,
    Calibrations,
    CalibrationTable,
    ErrorComparison,
    Errors,
    ErrorTable,
    Provenance,
    UnusedSignal,
    Verdict,
)

T = TypeVar("T")
Kinds = Sequence[tuple[str, Mapping[str, ErrorComparison]]]


def horizons(table: ErrorTable, seconds: float) -> list[tuple[str, Mapping[str, ErrorComparison]]]:
    """Return title and errors by channel of each kind of prediction, in the order of the report page.

    The order is: over the horizon of ``seconds`` [s], one step ahead, simulation.
    """
    one_step, horizon, simulation = titles(seconds)
    return [(horizon, table.horizon), (one_step, table.one_step), (simulation, table.simulation)]


def titles(seconds: float) -> tuple[str, str, str]:
    """Return the titles of one-step prediction, prediction over the horizon of ``seconds`` [s], and simulation."""
    return "One step ahead", f"{seconds:g} s ahead", "Simulation"


def by_role(validation: T | None, estimation: T) -> list[tuple[str, T]]:
    """Return the role (``validation``, ``estimation``) and the data of each set, in the order of the report page.

    Validation data come first, as they are stronger evidence. If they are None, only the estimation data are returned.
    """
    return [*([] if validation is None else [("validation", validation)]), ("estimation", estimation)]


def compared(errors: Errors) -> bool:
    """Return whether the result compares two models, before and after effects were added.

    It does if any channel has an error of the model before.
    """
    tables = [table for _, table in by_role(errors.validation, errors.estimation)]
    kinds = [kind for table in tables for kind in (table.one_step, table.horizon, table.simulation)]
    return any(row.before is not None for kind in kinds for row in kind.values())


def errors_section(errors: Errors, seconds: float) -> Section:
    """Return the section of RMS prediction errors: one tab for validation data, one for estimation data.

    Parameters
    ----------
    errors : Errors
        Errors of one model, or of the models before and after effects were added.
    seconds : float
        Horizon [s].
    """
    has_before = compared(errors)
    table = _before_after_table if has_before else _error_table
    roles = by_role(errors.validation, errors.estimation)
    tabs = [(f"{role} data", table(horizons(data, seconds))) for role, data in roles]
    lead = "Root mean square of the difference of measured and predicted values."
    if has_before:
        lead += " ▼ and ▲: the error fell or rose; the 95 % interval of the ratio excludes 1."
    return Section("errors", "Error before and after" if has_before else "Prediction error", tabbed(tabs), lead)


def _before_after_table(kinds: Kinds) -> list[Any]:
    """Return the table of errors before and after, with their ratio and its interval; empty without channels."""
    columns = (("channel", ""), ("before", "num"), ("after", "num"), ("unit", ""), ("ratio", "num"), ("95 %", "num"))
    return _grouped_table(kinds, columns, _before_after_cells)


def _error_table(kinds: Kinds) -> list[Any]:
    """Return the table of the errors of one model, with the fit in per cent; empty without channels."""
    return _grouped_table(kinds, (("channel", ""), ("error", "num"), ("unit", ""), ("fit", "num")), _error_cells)


def _grouped_table(
    kinds: Kinds,
    columns: tuple[tuple[str, str], ...],
    cells: Callable[[str, ErrorComparison], list[Cell | str]],
) -> list[Any]:
    """Return a table with a heading and one row per channel for each kind of prediction; empty without channels.

    Parameters
    ----------
    kinds
        Title and errors by channel of each kind of prediction.
    columns
        Title and CSS class of each column.
    cells
        Function that returns the cells of a channel.
    """
    lines: list[list[Cell | str]] = []
    for title, table in kinds:
        found = [cells(name, row) for name, row in table.items()]
        lines += [[Cell(title, "group")], *found] if found else []
    return [Table(columns, lines)] if lines else []


def _error_cells(channel: str, row: ErrorComparison) -> list[Cell | str]:
    """Return channel, error, unit and fit; the fit is 1 - error / spread, or a dash if one of both is unknown."""
    factor, unit = formatting.degrees_for(row.unit)
    error = row.after
    fit = None if error is None or not row.spread else 1 - error / row.spread
    return [
        formatting.named(channel),
        Cell(error_words(error if error is None else factor * error), "num"),
        Cell(unit, "nowrap"),
        Cell("–" if fit is None else f"{100 * fit:.0f} %", "num"),
    ]


def error_words(error: float | None) -> str:
    """Return an RMS error as text; None (not finite in the computation) means that the prediction diverged."""
    return "diverged" if error is None else formatting.plain(error)


def _before_after_cells(channel: str, row: ErrorComparison) -> list[Cell | str]:
    """Return channel, error before and after, unit, ratio with its verdict, and the 95 % interval of the ratio.

    Unknown numbers are dashes; an error of None is printed as ``diverged``.
    """
    factor, unit = formatting.degrees_for(row.unit)
    before, after = formatting.scaled(factor, row.before, row.after)
    low, high = row.low, row.high
    ratio = after / before if before and after is not None else None
    mark, style = {"fell": ("▼ ", "good"), "rose": ("▲ ", "bad")}.get(row.verdict or "", ("", ""))
    return [
        formatting.named(channel),
        Cell(error_words(before), "num"),
        Cell(error_words(after), "num"),
        Cell(unit, "nowrap"),
        Cell("–" if ratio is None else f"{mark}{ratio:.2f}", f"num {style}".strip()),
        Cell("–" if low is None or high is None else f"{low:.2f} to {high:.2f}", "num"),
    ]


def next_section(words: str | None) -> Section:
    """Return the section of the report page with the recommended experiment; empty without a text."""
    return Section("next", "Next experiment", [Prose(words, "callout")] if words else [])


def notes_section(lines: Sequence[str], unused: Sequence[UnusedSignal] = ()) -> Section:
    """Return the section of the notes of a result and of the signals that the model does not use, with the reasons.

    Parameters
    ----------
    lines
        Notes, each a sentence.
    unused
        Signals that the model does not use.
    """
    blocks: list[Any] = [Lines(list(lines))] if lines else []
    if unused:
        blocks += [Heading("Signals that are not used", ""), Lines([f"{s.signal}: {s.reason}" for s in unused])]
    return Section("notes", "Notes", blocks)


def made_section(made: Provenance) -> Section:
    """Return the section of provenance: command line, version of seatrial and time; empty entries are left out."""
    facts = (("Command", made.command), ("seatrial", made.seatrial), ("Time", formatting.moment(made.created)))
    found = [(label, value) for label, value in facts if value]
    return Section("made", "How it was made", [Facts(found, "made")] if found else [])


COLUMNS = (
    ("channel", ""),
    ("inside 50 %", "num"),
    ("inside 95 %", "num"),
    ("error / predicted s.d.", "num"),
    ("95 %", "num"),
    ("independent samples", "num"),
    ("", ""),
)
VERDICTS: dict[Verdict, Cell] = {
    "right": Cell("✓ calibrated", "good"),
    "overconfident": Cell("▲ overconfident", "bad"),
    "underconfident": Cell("▼ underconfident", "weak"),
    "insufficient_data": Cell("too few samples", "weak"),
}


def calibration_section(canvas: Canvas, calibration: Calibrations, seconds: float) -> Section:
    """Return the section of calibration: a table and reliability plots for validation and for estimation data.

    Parameters
    ----------
    canvas : Canvas
        Collector of the figures, to which the plots are added.
    calibration : Calibrations
        Coverage of the prediction intervals.
    seconds : float
        Horizon of the prediction [s].
    """
    roles = by_role(calibration.validation, calibration.estimation)
    tabs = [(f"{role} data", _calibration_blocks(canvas, role, data, seconds)) for role, data in roles]
    lead = (
        "The model predicts the standard deviation of its own errors. It is calibrated if 50 % and 95 % of the errors "
        "are inside the 50 % and 95 % intervals, and if the errors over their predicted standard deviation are about "
        "1. Overconfident: the intervals are too narrow. Underconfident: they are too wide."
    )
    return Section("calibration", "Calibration of the prediction intervals", tabbed(tabs), lead)


def _calibration_blocks(canvas: Canvas, role: str, data: CalibrationTable, seconds: float) -> list[Any]:
    """Return the table of all kinds of prediction for one set of data, and a reliability plot for each kind.

    ``role`` is ``estimation`` or ``validation``, and ``seconds`` the horizon [s]. The result is empty without channels.
    """
    lines: list[list[Cell | str]] = []
    plots = []
    for title, found in zip(titles(seconds), (data.one_step, data.horizon, data.simulation), strict=True):
        lines += [[Cell(title, "group")], *(_calibration_cells(n, row) for n, row in found.items())] if found else []
        plot = _reliability_plot(canvas, f"{title}, {role} data", found)
        plots += [plot] if plot is not None else []
    if not lines:
        return []
    note = "The errors of a simulation are correlated in time, so that few of them are independent."
    axes = (
        "Share of the errors inside the prediction intervals over the nominal share. A curve below the diagonal is "
        "overconfident."
    )
    return [Table(COLUMNS, lines), Prose(note, "quiet"), *([Prose(axes, "quiet"), Grid(plots, 220)] if plots else [])]


def _calibration_cells(channel: str, row: CalibrationRow) -> list[Cell | str]:
    """Return the table cells of one channel.

    They are the channel, the shares inside the 50 % and 95 % interval, error over predicted standard deviation, its 95
    % interval, the number of independent samples, and the verdict.
    """
    low, high = row.low, row.high
    return [
        formatting.named(channel),
        Cell(formatting.percent(row.inside_50), "num"),
        Cell(formatting.percent(row.inside_95, 1), "num"),
        Cell(formatting.plain(row.scale), "num"),
        Cell("–" if low is None or high is None else f"{formatting.plain(low)} to {formatting.plain(high)}", "num"),
        Cell(formatting.plain(row.n_effective, 2), "num"),
        VERDICTS[row.verdict],
    ]


def _reliability_plot(canvas: Canvas, title: str, found: Mapping[str, CalibrationRow]) -> Plot | None:
    """Return the reliability plot: empirical over nominal coverage of the central 20, 40, ... 100 % intervals.

    The coverage is summed from the histogram of the probability integral transform, which has ten bins. None without
    channels.
    """
    nominal: Any = 0.2 * np.arange(6)
    traces = [drawing.line_trace(nominal, nominal, "nominal", 10, color=drawing.FAINT, dash="dot")]
    for i, (channel, row) in enumerate(found.items()):
        pit = row.pit
        # each central interval adds one bin on either side of the median
        inside = np.append(0.0, np.cumsum((pit[:5] + pit[:4:-1])[::-1]))
        color, dash = drawing.LINES[i % 6], drawing.DASHES[i // 6 % 6]
        traces.append(drawing.line_trace(nominal, inside, formatting.symbol(channel), 10, color=color, dash=dash))
    if len(traces) == 1:
        return None
    axis = {"range": [0, 1], "tickformat": ".0%"}
    figure = drawing.single(traces, "nominal", "inside", xaxis=axis, yaxis=axis, showlegend=True)
    return canvas.plot(figure, 260, f"Reliability, {title}", title)
