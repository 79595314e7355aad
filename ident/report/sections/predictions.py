"""Sections of prediction errors and of the calibration of prediction intervals in a report page.

The last sections of the page (recommended experiment, notes, provenance) are here too.
"""

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
    data_name,
    of_judging_data,
)

T = TypeVar("T")
LARGE_RISE = 1.2  # ratio of the errors after and before, from which a rise without a mark is named
Kinds = Sequence[tuple[str, Mapping[str, ErrorComparison]]]


def horizons(table: ErrorTable, seconds: float) -> list[tuple[str, Mapping[str, ErrorComparison]]]:
    """Return (title, errors by channel) of each kind of prediction, in the order of the report page.

    The order is: over the horizon, one step ahead, simulation.

    Parameters
    ----------
    table
        RMS prediction errors on one set of data.
    seconds
        Prediction horizon [s], for the title.
    """
    one_step, horizon, simulation = titles(seconds)
    return [(horizon, table.horizon), (one_step, table.one_step), (simulation, table.simulation)]


def titles(seconds: float) -> tuple[str, str, str]:
    """Return the titles of the three kinds of prediction: ``One step ahead``, ``10 s ahead``, ``Simulation``.

    ``seconds`` is the prediction horizon [s].
    """
    return "One step ahead", f"{seconds:g} s ahead", "Simulation"


def by_role(validation: T | None, estimation: T) -> list[tuple[str, T]]:
    """Return (role, data) of both sets of data, ``validation`` first, as validation data are stronger evidence.

    If ``validation`` is None, only the set ``estimation`` is returned. The data may be of any type, for example errors
    or calibration; they are not changed.
    """
    return [*([] if validation is None else [("validation", validation)]), ("estimation", estimation)]


def compared(errors: Errors) -> bool:
    """Return whether the errors are those of two models, before and after effects were added.

    They are if a channel of any kind of prediction has an error before that is another one than after. Without added
    effects both models are the same.
    """
    tables = [table for _, table in by_role(errors.validation, errors.estimation)]
    kinds = [kind for table in tables for kind in (table.one_step, table.horizon, table.simulation)]
    return any(row.before is not None and row.before != row.after for kind in kinds for row in kind.values())


def errors_section(errors: Errors, seconds: float, caveat: str = "", in_blocks: bool = False) -> Section:
    """Return the section with the tables of RMS prediction errors: one tab for validation, one for estimation data.

    With one model, a table has the fit in per cent; with two models, the ratio of their errors. The section is empty if
    there are no channels.

    Parameters
    ----------
    errors : Errors
        Errors of one model, or of the models before and after effects were added.
    seconds : float
        Prediction horizon [s].
    caveat : str
        Sentences on how the errors were computed, which follow the lead; empty: none.
    in_blocks : bool
        Whether blocks of time take the place of validation logs.
    """
    has_before = compared(errors)
    table = _before_after_table if has_before else _error_table
    roles = by_role(errors.validation, errors.estimation)
    tabs = []
    for role, data in roles:
        kinds = horizons(data, seconds)
        words = unmarked_rises(kinds) if has_before else ""
        tabs.append((data_name(role, in_blocks), [*table(kinds), *([Prose(words)] if words else [])]))
    lead = "Root mean square of the difference of measured and predicted values."
    if has_before:
        lead += " ▼ and ▲: the error fell or rose by more than 0.5 %, and the 95 % interval of the ratio excludes 1."
    lead = f"{lead} {caveat}".rstrip()
    return Section("errors", "Error before and after" if has_before else "Prediction error", tabbed(tabs), lead)


def unmarked_rises(kinds: Kinds) -> str:
    """Return a sentence on the channels whose error rose by a fifth or more, but without a mark.

    These are the predictions without an interval, such as a simulation, and those whose interval includes 1. The text
    is empty without such a channel. ``kinds`` is that of a table of errors before and after.
    """
    found = []
    for title, table in kinds:
        for name, row in table.items():
            factor, unit = formatting.degrees_for(row.unit)
            if row.verdict != "rose" and row.before and row.after and row.after >= LARGE_RISE * row.before:
                sizes = " → ".join(formatting.plain(factor * value) for value in (row.before, row.after))
                found.append(f"{title.lower()}, {formatting.named(name)} ({f'{sizes} {unit}'.rstrip()})")
    if not found:
        return ""
    return (
        "Larger after than before, but without a mark, because no interval shows whether it is chance: "
        f"{'; '.join(found)}."
    )


def _before_after_table(kinds: Kinds) -> list[Any]:
    """Return the table of RMS errors before and after effects were added, with their ratio and its 95 % interval.

    The table is returned as a list of one; the list is empty without channels. ``kinds`` has title and errors by
    channel of each kind of prediction.
    """
    columns = (("channel", ""), ("before", "num"), ("after", "num"), ("unit", ""), ("ratio", "num"), ("95 %", "num"))
    return _grouped_table(kinds, columns, _before_after_cells)


def _error_table(kinds: Kinds) -> list[Any]:
    """Return the table of the RMS errors of one model with the fit in per cent, as a list of one.

    The list is empty without channels. ``kinds`` has title and errors by channel of each kind of prediction.
    """
    return _grouped_table(kinds, (("channel", ""), ("error", "num"), ("unit", ""), ("fit", "num")), _error_cells)


def _grouped_table(
    kinds: Kinds,
    columns: tuple[tuple[str, str], ...],
    cells: Callable[[str, ErrorComparison], list[Cell | str]],
) -> list[Any]:
    """Return a table with a heading and one row per channel for each kind of prediction, as a list of one.

    A kind without channels is left out. The list is empty if no kind has channels.

    Parameters
    ----------
    kinds
        Title and errors by channel of each kind of prediction.
    columns
        Title and CSS class of each column.
    cells
        Function that returns the cells of a row from the name and the errors of a channel.
    """
    lines: list[list[Cell | str]] = []
    for title, table in kinds:
        found = [cells(name, row) for name, row in table.items()]
        lines += [[Cell(title, "group")], *found] if found else []
    return [Table(columns, lines)] if lines else []


def _error_cells(channel: str, row: ErrorComparison) -> list[Cell | str]:
    """Return the table cells of one channel: name, RMS error of the model, unit, and fit in per cent.

    The fit is 1 - error / standard deviation of the measured output, or a dash if one of both is unknown or the
    standard deviation is zero. An error of None is written as ``diverged``.
    """
    factor, unit = formatting.degrees_for(row.unit)
    error = row.after
    fit = None if error is None or not row.spread else 1 - error / row.spread
    return [
        formatting.named(channel),
        Cell(error_words(error if error is None else factor * error), "num"),
        Cell(unit, "nowrap"),
        Cell("–" if fit is None else f"{100 * fit:z.0f} %", "num"),
    ]


def error_words(error: float | None) -> str:
    """Return an RMS prediction error as text with three digits. The text is ``diverged`` if the error is None.

    A result has None in place of an error that is not finite because the prediction diverged.
    """
    return "diverged" if error is None else formatting.plain(error)


def _before_after_cells(channel: str, row: ErrorComparison) -> list[Cell | str]:
    """Return the table cells of one channel: name, errors before and after, unit, their ratio and its 95 % interval.

    A mark at the ratio shows whether the error fell or rose significantly. An unknown ratio or interval, or a ratio to
    an error of zero, is a dash; an error of None is written as ``diverged``.
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
    """Return the section of the report page with the recommended experiment; empty if ``words`` is None or empty."""
    return Section("next", "Next experiment", [Prose(words, "callout")] if words else [])


def notes_section(lines: Sequence[str], unused: Sequence[UnusedSignal] = ()) -> Section:
    """Return the section of the notes of a result, and of the unused signals with the reasons; empty without any.

    Parameters
    ----------
    lines
        Notes of the result.
    unused
        Signals of the logs that the model does not use.
    """
    blocks: list[Any] = [Lines(list(lines))] if lines else []
    if unused:
        by_reason: dict[str, list[str]] = {}
        for signal in unused:
            by_reason.setdefault(signal.reason, []).append(signal.signal)
        lines = [f"{', '.join(names)}: {reason}" for reason, names in by_reason.items()]
        blocks += [Heading("Signals that are not used", ""), Lines(lines)]
    return Section("notes", "Notes", blocks)


def made_section(made: Provenance) -> Section:
    """Return the section of the provenance of a result: command line, version of seatrial and time.

    Entries that are empty are left out. The section is empty if all are. The logs of ``made`` are not shown.
    """
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
    ("widened by", "num"),
    ("verdict", ""),
)
VERDICTS: dict[Verdict, Cell] = {
    "right": Cell("✓ calibrated", "good"),
    "overconfident": Cell("▲ overconfident", "bad"),
    "underconfident": Cell("▼ underconfident", "weak"),
    "insufficient_data": Cell("too few samples", "weak"),
}


def calibration_section(canvas: Canvas, calibration: Calibrations, seconds: float, in_blocks: bool = False) -> Section:
    """Return the section of the calibration of the prediction intervals.

    It has one tab for validation data and one for estimation data, each with a table and reliability plots. It is empty
    if there are no channels.

    Parameters
    ----------
    canvas : Canvas
        Collector of the figures, to which the plots are added.
    calibration : Calibrations
        Calibration of each channel by set of data and kind of prediction.
    seconds : float
        Prediction horizon [s].
    in_blocks : bool
        Whether blocks of time take the place of validation logs.
    """
    roles = by_role(calibration.validation, calibration.estimation)
    named = [(data_name(role, in_blocks), data) for role, data in roles]
    tabs = [(name, _calibration_blocks(canvas, name, data, seconds)) for name, data in named]
    lead = (
        "The model predicts the standard deviation of its own errors. It is calibrated if 50 % and 95 % of the errors "
        "are inside the 50 % and 95 % intervals, and if the errors over their predicted standard deviation are about "
        "1. Overconfident: the intervals are too narrow. Underconfident: they are too wide. The bands of the "
        "predictions over the horizon and of the simulation, and those in Python, are widened by the factor of the "
        "validation data in the column widened by: further data then lie inside the 95 % intervals as often as they "
        "should. model.toml has the factors, so that `seatrial ident compare` widens its intervals too."
    )
    return Section(
        "calibration", "Calibration of the prediction intervals", tabbed(tabs), of_judging_data(lead, in_blocks)
    )


def _calibration_blocks(canvas: Canvas, name: str, data: CalibrationTable, seconds: float) -> list[Any]:
    """Return the blocks of the calibration on one set of data: a table, and a reliability plot for each kind.

    The kinds of prediction are one step ahead, over the horizon of ``seconds`` [s], and simulation. ``name`` is
    that of the data (`data_name`). The plots are added to ``canvas``. The list is empty without channels.
    """
    lines: list[list[Cell | str]] = []
    plots = []
    for title, found in zip(titles(seconds), (data.one_step, data.horizon, data.simulation), strict=True):
        lines += [[Cell(title, "group")], *(_calibration_cells(n, row) for n, row in found.items())] if found else []
        plot = _reliability_plot(canvas, f"{title}, {name}", found)
        plots += [plot] if plot is not None else []
    if not lines:
        return []
    note = "The errors of a simulation are correlated in time, so that few of them are independent."
    axes = (
        "Share of the errors inside the prediction intervals over the nominal share. A curve below the diagonal is "
        "overconfident."
    )
    return [Table(COLUMNS, lines), Prose(note, "quiet"), *([Prose(axes, "quiet"), Grid(plots, 320)] if plots else [])]


def _calibration_cells(channel: str, row: CalibrationRow) -> list[Cell | str]:
    """Return the table cells of the calibration of one channel.

    They are the name of the channel, the shares of its errors inside the 50 % and 95 % interval, the RMS of error over
    predicted standard deviation with its 95 % interval, the number of independent errors, the factor by which the
    intervals have to be wider, and the verdict.
    """
    low, high = row.low, row.high
    return [
        formatting.named(channel),
        Cell(formatting.percent(row.inside_50), "num"),
        Cell(formatting.percent(row.inside_95, 1), "num"),
        Cell(formatting.plain(row.scale), "num"),
        Cell("–" if low is None or high is None else f"{formatting.plain(low)} to {formatting.plain(high)}", "num"),
        Cell(formatting.plain(row.n_effective, 2), "num"),
        Cell("–" if row.widening is None else formatting.plain(row.widening), "num"),
        _verdict_cell(row),
    ]


def _verdict_cell(row: CalibrationRow) -> Cell:
    """Return the verdict of a channel in words.

    A calibrated channel has no check mark if the 95 % interval of its ratio excludes 1: the ratio then differs from 1,
    by an amount that the data do not distinguish from the 10 % which still count as calibrated.
    """
    excludes_one = row.low is not None and row.high is not None and not row.low <= 1.0 <= row.high
    if row.verdict != "right" or not excludes_one:
        return VERDICTS[row.verdict]
    words = "narrow" if row.scale is None or row.scale > 1.0 else "wide"
    return Cell(f"too {words}, but not distinguishable from calibrated within 10 %", "weak")


def _reliability_plot(canvas: Canvas, title: str, found: Mapping[str, CalibrationRow]) -> Plot | None:
    """Return the reliability plot of one kind of prediction, with one curve for each channel; None without channels.

    A curve is the share of the errors inside the central 20, 40, ... 100 % prediction intervals over this nominal
    share. It is summed from the shares of the errors in each tenth of the predicted distribution (``pit``). ``found``
    is the calibration by channel. The plot is added to ``canvas``, with ``title`` above it.
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
