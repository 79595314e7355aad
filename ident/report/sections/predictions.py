"""Error before and after, whether the predicted bands are right, and the end of the page."""

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
    """Title and rows of each kind of prediction, that over the horizon of ``seconds`` first."""
    one_step, horizon, simulation = titles(seconds)
    return [(horizon, table.horizon), (one_step, table.one_step), (simulation, table.simulation)]


def titles(seconds: float) -> tuple[str, str, str]:
    """Of each kind of prediction, in the order of a table."""
    return "One step ahead", f"{seconds:g} s ahead", "Simulation"


def by_role(validation: T | None, estimation: T) -> list[tuple[str, T]]:
    """In the order of showing: what was not fitted convinces more."""
    return [*([] if validation is None else [("validation", validation)]), ("estimation", estimation)]


def compared(errors: Errors) -> bool:
    """Whether there is an error before."""
    tables = [table for _, table in by_role(errors.validation, errors.estimation)]
    kinds = [kind for table in tables for kind in (table.one_step, table.horizon, table.simulation)]
    return any(row.before is not None for kind in kinds for row in kind.values())


def errors_section(errors: Errors, seconds: float) -> Section:
    """One table for validation and one for estimation data."""
    two = compared(errors)
    table = _table if two else _alone
    both = by_role(errors.validation, errors.estimation)
    tabs = [(f"{role} data", table(horizons(data, seconds))) for role, data in both]
    lead = "Root mean square of measured less predicted."
    if two:
        lead += " ▼ and ▲: fell or rose beyond the 95 % interval of the ratio."
    return Section("errors", "Error before and after" if two else "Prediction error", tabbed(tabs), lead)


def _table(kinds: Kinds) -> list[Any]:
    columns = (("channel", ""), ("before", "num"), ("after", "num"), ("unit", ""), ("ratio", "num"), ("95 %", "num"))
    return _grouped(kinds, columns, _row)


def _alone(kinds: Kinds) -> list[Any]:
    """Of one model: its error, and how much of what was measured it explains."""
    return _grouped(kinds, (("channel", ""), ("error", "num"), ("unit", ""), ("fit", "num")), _single)


def _grouped(
    kinds: Kinds,
    columns: tuple[tuple[str, str], ...],
    cells: Callable[[str, ErrorComparison], list[Cell | str]],
) -> list[Any]:
    lines: list[list[Cell | str]] = []
    for title, table in kinds:
        found = [cells(name, row) for name, row in table.items()]
        lines += [[Cell(title, "group")], *found] if found else []
    return [Table(columns, lines)] if lines else []


def _single(channel: str, row: ErrorComparison) -> list[Cell | str]:
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
    """An RMS error that is not finite is of a prediction that diverged."""
    return "diverged" if error is None else formatting.plain(error)


def _row(channel: str, row: ErrorComparison) -> list[Cell | str]:
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
    """What to run next."""
    return Section("next", "Next experiment", [Prose(words, "callout")] if words else [])


def notes_section(lines: Sequence[str], unused: Sequence[UnusedSignal] = ()) -> Section:
    """What was left out, what failed, what to know; then a line for each signal that the model does not take."""
    blocks: list[Any] = [Lines(list(lines))] if lines else []
    if unused:
        blocks += [Heading("Signals that are not used", ""), Lines([f"{s.signal}: {s.reason}" for s in unused])]
    return Section("notes", "Notes", blocks)


def made_section(made: Provenance) -> Section:
    """Command, version, time."""
    facts = (("Command", made.command), ("seatrial", made.seatrial), ("Time", formatting.moment(made.created)))
    found = [(label, value) for label, value in facts if value]
    return Section("made", "How it was made", [Facts(found, "made")] if found else [])


COLUMNS = (
    ("channel", ""),
    ("inside 50 %", "num"),
    ("inside 95 %", "num"),
    ("error / claimed", "num"),
    ("95 %", "num"),
    ("independent", "num"),
    ("", ""),
)
VERDICTS: dict[Verdict, Cell] = {
    "right": Cell("✓ right", "good"),
    "overconfident": Cell("▲ too sure", "bad"),
    "underconfident": Cell("▼ too cautious", "weak"),
    "insufficient_data": Cell("too few to say", "weak"),
}


def calibration_section(canvas: Canvas, calibration: Calibrations, seconds: float) -> Section:
    """A table and three small reliability plots for each set of data; ``seconds``: the horizon."""
    both = by_role(calibration.validation, calibration.estimation)
    tabs = [(f"{role} data", _tables(canvas, role, data, seconds)) for role, data in both]
    lead = (
        "The model says how far off its predictions may be; here is whether they are. Right: as many errors inside the "
        "bands as they promise, and error over claimed error about 1."
    )
    return Section("calibration", "Are the predicted bands right?", tabbed(tabs), lead)


def _tables(canvas: Canvas, role: str, data: CalibrationTable, seconds: float) -> list[Any]:
    lines: list[list[Cell | str]] = []
    plots = []
    for title, found in zip(titles(seconds), (data.one_step, data.horizon, data.simulation), strict=True):
        lines += [[Cell(title, "group")], *(_line(n, row) for n, row in found.items())] if found else []
        plot = _reliability(canvas, f"{title}, {role} data", found)
        plots += [plot] if plot is not None else []
    if not lines:
        return []
    note = "A simulation is one experiment: its errors are correlated, and few of them are independent."
    drawn = "Shares of the errors inside the predicted bands against those promised; below the diagonal is too sure."
    return [Table(COLUMNS, lines), Prose(note, "quiet"), *([Prose(drawn, "quiet"), Grid(plots, 220)] if plots else [])]


def _line(channel: str, row: CalibrationRow) -> list[Cell | str]:
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


def _reliability(canvas: Canvas, title: str, found: Mapping[str, CalibrationRow]) -> Plot | None:
    """Central bands of 20, 40, ... 100 %, from the tenths of the predicted distribution."""
    promised: Any = 0.2 * np.arange(6)
    traces = [drawing.line_trace(promised, promised, "promised", 10, color=drawing.FAINT, dash="dot")]
    for i, (channel, row) in enumerate(found.items()):
        pit = row.pit
        inside = np.append(0.0, np.cumsum((pit[:5] + pit[:4:-1])[::-1]))
        color, dash = drawing.LINES[i % 6], drawing.DASHES[i // 6 % 6]
        traces.append(drawing.line_trace(promised, inside, formatting.symbol(channel), 10, color=color, dash=dash))
    if len(traces) == 1:
        return None
    axis = {"range": [0, 1], "tickformat": ".0%"}
    figure = drawing.single(traces, "promised", "inside", xaxis=axis, yaxis=axis, showlegend=True)
    return canvas.plot(figure, 260, f"Reliability, {title}", title)
