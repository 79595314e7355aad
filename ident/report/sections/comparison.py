"""Sections of a comparison of models in a report page: models, verdicts, errors, likelihoods, and overlaid predictions.

The colour and the dash of a line belong to the model, so that the lines differ for any colour vision and in print.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from seatrial.daq.errors import counted, first_names
from seatrial.ident.numerics import Array
from seatrial.ident.report import drawing, formatting
from seatrial.ident.report.blocks import Canvas, Cell, Grid, Heading, Lines, Prose, Section, Table, tabbed
from seatrial.ident.report.record_tabs import of_record, record_tabs, roles_of
from seatrial.ident.report.sections.predictions import error_words
from seatrial.ident.results import (
    ComparedChannel,
    ComparedError,
    ComparedModel,
    ComparedRatio,
    ComparedTrace,
    ComparisonResult,
    ComparisonVerdict,
    DifferenceKind,
    LogScore,
    PredictionKind,
    Verdict,
)

TIME = "time since the start of the log [s]"
MARKS: dict[ComparisonVerdict, tuple[str, str]] = {
    "better": ("▼ ", "good"),
    "worse": ("▲ ", "bad"),
    "indistinguishable": ("", ""),
    "no-interval": ("", ""),
}
WORDS: dict[ComparisonVerdict, str] = {
    "better": "better",
    "worse": "worse",
    "indistinguishable": "not distinguishable",
    "no-interval": "no interval",
}
DIFFERENCES: dict[DifferenceKind, str] = {
    "structure": "structure",
    "effects": "effects",
    "inputs": "inputs",
    "channels": "measured channels",
    "estimated": "estimated parameters",
    "fixed": "fixed parameters",
    "priors": "priors",
    "logs": "fitted to",
    "method": "method of the fit",
}
MOST_TEXTS = 12  # texts of one kind of difference that a table lists
INSIDE = "inside the 95 % interval"
ABOUT_INSIDE = (
    "Inside the 95 % interval: share of the errors, which should be about 95 %. Successive errors are correlated, so "
    "that a share may differ from it by chance: too narrow or too wide are only intervals for which a test with the "
    "number of independent errors says so. A dash: there are no intervals, or they are wider than the range of the "
    "measured values, so that they say nothing."
)
BAND = 0.13  # opacity of the 95 % band of one of several models


def kind_title(kind: PredictionKind, seconds: float | None) -> str:
    """Return the title of a kind of prediction: ``One step ahead``, ``10 s ahead`` or ``Simulation``."""
    if kind == "horizon":
        return f"{seconds:g} s ahead"
    return "One step ahead" if kind == "one_step" else "Simulation"


def verdict_words(row: ComparedRatio | LogScore) -> str:
    """Return the verdict on a ratio or a log score as text; without an interval ``no interval: 2 blocks``."""
    words = WORDS[row.verdict]
    return words if row.verdict != "no-interval" or row.blocks is None else f"{words}: {counted(row.blocks, 'block')}"


TOO: dict[Verdict, str] = {"overconfident": "too narrow", "underconfident": "too wide"}
JUDGED: dict[Verdict, str] = TOO | {"right": "right", "insufficient_data": "too few errors for a verdict"}


def interval_sentence(result: ComparisonResult, m: ComparedModel) -> str:
    """Return what the 95 % intervals of a model are: whether they are widened, and where the errors show otherwise."""
    kinds = [kind_title("horizon", s) for s in m.widened_horizons] + ["simulation"] * m.widened_simulation
    words = f"widened by its validation data: {', '.join(kinds)}" if kinds else "those of the model itself"
    if kinds and (own := [f"{s:g} s ahead" for s in result.horizons if s not in m.widened_horizons]):
        words += f"; those of the model itself: {', '.join(own)}"
    for verdict, too in TOO.items():
        places = []
        for kind in result.kinds:
            names = [
                row.channel
                for row in result.channels
                for e in row.errors
                if (row.kind, row.seconds) == kind and (e.model, e.intervals) == (m.label, verdict)
            ]
            places += [f"{_lower(kind_title(*kind))} ({', '.join(names)})"] if names else []
        words += f"; {too}: {', '.join(places)}" if places else ""
    return words


def masses_sentence(m: ComparedModel, weighed: float | None) -> str:
    """Return the masses of a model with their standard errors, such as ``m_u 21.3 ± 0.4 kg``; empty without any.

    The mass in surge is also given as a multiple of the ``weighed`` mass [kg], if both are known in kg.
    """
    found = []
    for mass in m.masses:
        words = f"{mass.name} {formatting.with_error(mass.value, mass.se, formatting.typeset_unit(mass.unit))}"
        if mass.name == "m_u" and weighed is not None:
            words += f" ({formatting.plain(mass.value / weighed, 2)} times the weighed {weighed:g} kg)"
        found.append(words)
    return ", ".join(found)


def _lower(title: str) -> str:
    """Return a title with a small first letter: ``Simulation`` becomes ``simulation``."""
    return title[0].lower() + title[1:]


def _evaluation_blocks(result: ComparisonResult) -> list[Any]:
    """Return the table of the only model: name, number of parameters, and what its 95 % intervals are."""
    (m,) = result.models
    free = f"{m.n_free} + {len(m.per_log)} per log" if m.per_log else str(m.n_free)
    cells: list[Cell | str] = [Cell(f"{m.name}, {m.model}", "wide"), Cell(free, "num")]
    cells.append(Cell(interval_sentence(result, m), "wide"))
    note = "The model keeps its estimates; only what belongs to a log, such as the current, is estimated anew."
    masses = masses_sentence(m, result.weighed_mass)
    blocks: list[Any] = [Table((("model", ""), ("parameters", "num"), ("95 % intervals", "")), [cells])]
    return [*blocks, *([Prose(f"Masses: {masses}.", "quiet")] if masses else []), Prose(note, "quiet")]


def opening_blocks(result: ComparisonResult) -> list[Any]:
    """Return the table of the models: label, name, structure, number of parameters, error of all channels.

    The error is that over the first horizon, as a ratio to the first model. One model alone has no comparison.
    """
    if result.is_evaluation:
        return _evaluation_blocks(result)
    title = f"error {result.horizons[0]:g} s ahead"
    columns = (
        ("", ""),
        ("model", ""),
        (title, "num"),
        ("verdict", ""),
        ("95 %", "num"),
        ("parameters", "num"),
        ("better", "num"),
        ("worse", "num"),
        ("not distinguishable", "num"),
        ("no interval", "num"),
    )
    rows = []
    for m in result.models:
        change = m.ahead(result.horizons[0])
        verdict = "reference" if m is result.models[0] else "–" if change is None else verdict_words(change)
        rows.append(
            [
                Cell(f"({m.label})", "strong"),
                Cell(f"{m.name}, {m.model}", "wide"),
                Cell("1" if m is result.models[0] else ratio_words(change), "num"),
                Cell(verdict, "" if change is None else MARKS[change.verdict][1]),
                Cell(interval_words(change), "num"),
                Cell(f"{m.n_free} + {len(m.per_log)} per log" if m.per_log else str(m.n_free), "num"),
                *(Cell("–" if m is result.models[0] else str(n), "num") for n in result.counts(m.label).values()),
            ]
        )
    note = (
        "The error is the geometric mean over all channels of RMS error / RMS error of (a). Each model keeps its "
        "estimates; only what belongs to a log, such as the current, is estimated anew. The last four columns count "
        "the verdicts against (a) over all channels and kinds of prediction."
    )
    lines = [f"95 % intervals of ({m.label}): {interval_sentence(result, m)}." for m in result.models]
    masses = [(m.label, masses_sentence(m, result.weighed_mass)) for m in result.models]
    lines = [f"Masses of ({label}): {words}." for label, words in masses if words] + lines
    return [Table(columns, rows, stacked=True), Prose(note, "quiet"), Lines(lines, "quiet")]


def ratio_words(ratio: ComparedRatio | None) -> str:
    """Return an error ratio as text of three digits; a dash for None, and ``diverged`` beyond a factor of a million."""
    if ratio is None:
        return "–"
    return formatting.plain(ratio.ratio) if 1e-6 < ratio.ratio < 1e6 else "diverged"


def interval_words(ratio: ComparedRatio | None) -> str:
    """Return the 95 % interval of an error ratio as text; a dash without one, and for a prediction that diverged."""
    if ratio is None or ratio.low is None or ratio.high is None or not 1e-6 < ratio.ratio < 1e6:
        return "–"
    return f"{formatting.plain(ratio.low)} to {formatting.plain(ratio.high)}"


def differences_section(result: ComparisonResult) -> Section:
    """Return the section with the table of what differs between each model and the first one.

    The section is empty for a result of an earlier version, which does not contain the differences.
    """
    reference = result.models[0].label
    rows: list[list[Cell | str]] = []
    for m in result.models[1:]:
        for title, here, there in difference_rows(m):
            rows.append([Cell(f"({m.label})", "strong"), title, Cell(here or "–", "wide"), Cell(there or "–", "wide")])
    columns = (("model", ""), ("", ""), ("only in this model", ""), (f"only in ({reference})", ""))
    return Section("differences", "What differs", [Table(columns, rows, stacked=True)] if rows else [])


def difference_rows(m: ComparedModel) -> list[tuple[str, str, str]]:
    """Return the differences of a model from the first one: title, texts of this model, texts of the first.

    Two models that differ only in their estimates have one row that says so. There are no rows for the first model, and
    for a result of an earlier version. A list has its first twelve texts.
    """
    if m.differences is None:
        return []
    rows = [
        (DIFFERENCES[d.kind], first_names(d.here, MOST_TEXTS), first_names(d.in_reference, MOST_TEXTS))
        for d in m.differences
    ]
    return rows or [("values of the estimates only", "", "")]


def best_section(result: ComparisonResult) -> Section:
    """Return the section with the table of the best model for each channel and kind of prediction.

    A cell has the label of the best model, and of those that are not distinguishable from it. The section is empty if
    there are no channels.
    """
    kinds = result.kinds
    rows: list[list[Cell | str]] = []
    for name in dict.fromkeys(row.channel for row in result.channels):
        by_kind = {(row.kind, row.seconds): row for row in result.channels if row.channel == name}
        rows.append([formatting.named(name), *(_best_cell(by_kind.get(kind)) for kind in kinds)])
    columns = (("channel", ""), *((kind_title(*kind), "") for kind in kinds))
    lead = (
        "The best model of each channel, and those that are not distinguishable from it, as the 95 % interval of the "
        "ratio of both errors includes 1. A model that is better than all others is bold. Unclear: not "
        "shown to be worse, although a model with a smaller error is, because the errors vary much in time. No "
        "interval: the data have fewer than four independent blocks of time, so nothing is known about the difference."
    )
    return Section("best", "Which model is better", [Table(columns, rows)] if rows else [], lead)


def _best_cell(row: ComparedChannel | None) -> Cell:
    """Return the table cell with the labels of the best models of a channel, as ``(a) or (b)``; a dash without any.

    It is ``all`` if there are more than two models and all are equally good, and names no model if no ratio to the
    smallest error has an interval: ``undecided; no interval: 2 blocks``. Models without a verdict whose errors are
    larger than that of a worse one are unclear: ``(b); unclear: (a)``.
    """
    if row is None or row.best is None:
        return Cell("–")
    if row.undecided:
        return Cell(f"undecided; {verdict_words(row.unproven[0])}")
    best = [row.best, *(label for label in row.not_worse if label != row.best)]
    words = "all" if row.all_equal else " or ".join(f"({label})" for label in best)
    if row.unclear:
        words += f"; unclear: {' '.join(f'({label})' for label in row.unclear)}"
    if row.unproven:
        return Cell(f"{words}; {verdict_words(row.unproven[0])}")
    return Cell(words, "strong" if row.not_worse == (row.best,) and len(row.errors) > 1 else "")


def errors_section(result: ComparisonResult) -> Section:
    """Return the section of the prediction errors: one tab for each kind of prediction, with a table of all models.

    The section is empty if there are no channels.
    """
    if result.is_evaluation:
        return _evaluated_errors_section(result)
    reference = result.models[0].label
    columns = (
        ("model", ""),
        ("error", "num"),
        ("unit", ""),
        (f"ratio to ({reference})", "num"),
        ("95 %", "num"),
        ("verdict", ""),
        ("fit", "num"),
        (INSIDE, "num"),
        ("ratio to the best", "num"),
        ("95 %", "num"),
    )
    tabs = []
    for kind in result.kinds:
        lines: list[list[Cell | str]] = []
        for row in result.channels:
            if (row.kind, row.seconds) == kind:
                lines.append([Cell(f"{formatting.titled(row.channel)}, {row.n} samples", "group")])
                lines += [_error_cells(row, e) for e in row.errors]
        tabs.append((kind_title(*kind), [Table(columns, lines, stacked=True)] if lines else []))
    lead = (
        "Root mean square of the difference of measured and predicted values, at the samples that all models predict. "
        "The fit is 1 − error / standard deviation of the measured values. ▼ and ▲: the error is smaller or larger "
        f"than that of ({reference}) by more than 0.5 %, and the 95 % interval of the ratio excludes 1. The intervals "
        "are by a jackknife over blocks of time that are longer than the errors are correlated. Fewer than four blocks "
        "give no interval and no verdict: the errors of a simulation accumulate, so that a short log is one block or "
        "two. " + ABOUT_INSIDE
    )
    return Section("errors", "Prediction errors", tabbed(tabs), lead)


def _evaluated_errors_section(result: ComparisonResult) -> Section:
    """Return the section of the prediction errors of one model alone: a tab for each kind of prediction."""
    columns = (
        ("channel", ""),
        ("samples", "num"),
        ("error", "num"),
        ("unit", ""),
        ("fit", "num"),
        (INSIDE, "num"),
        ("intervals", ""),
    )
    tabs = []
    for kind in result.kinds:
        lines: list[list[Cell | str]] = []
        for row in result.channels:
            if (row.kind, row.seconds) == kind:
                factor, unit = formatting.degrees_for(row.unit)
                for e in row.errors:
                    shown: list[Cell | str] = [formatting.named(row.channel), Cell(str(row.n), "num")]
                    shown += [Cell(error_words(None if e.rms is None else factor * e.rms), "num"), Cell(unit, "nowrap")]
                    shown += [Cell(formatting.percent(e.fit), "num"), Cell(formatting.percent(e.inside_95), "num")]
                    lines.append([*shown, Cell("–" if e.intervals is None else JUDGED[e.intervals])])
        tabs.append((kind_title(*kind), [Table(columns, lines)] if lines else []))
    lead = (
        "Root mean square of the difference of measured and predicted values. The fit is 1 − error / standard "
        f"deviation of the measured values. {ABOUT_INSIDE}"
    )
    return Section("errors", "Prediction errors", tabbed(tabs), lead)


def _error_cells(row: ComparedChannel, e: ComparedError) -> list[Cell | str]:
    """Return the table cells of one model and channel: error, fit, ratio to the first model and to the best one."""
    factor, unit = formatting.degrees_for(row.unit)
    ratio = e.against_reference
    mark, style = ("", "") if ratio is None else MARKS[ratio.verdict]
    return [
        Cell(f"({e.model})", "strong" if e.model == row.best else "tight"),
        Cell(error_words(None if e.rms is None else factor * e.rms), "num"),
        Cell(unit, "nowrap"),
        Cell(mark + ratio_words(ratio), f"num {style}".strip()),
        Cell(interval_words(ratio), "num"),
        Cell("–" if ratio is None else verdict_words(ratio), style),
        Cell(formatting.percent(e.fit), "num"),
        Cell(_inside_with_verdict(e), "num"),
        Cell("best" if e.model == row.best else ratio_words(e.against_best), "num"),
        Cell(interval_words(e.against_best), "num"),
    ]


def _inside_with_verdict(e: ComparedError) -> str:
    """Return the share of the errors inside the 95 % intervals as text, with the verdict if these are not right."""
    too = None if e.intervals is None else TOO.get(e.intervals)
    return formatting.percent(e.inside_95) + (f", {too}" if too else "")


def likelihood_section(result: ComparisonResult) -> Section:
    """Return the section of log score, AIC, BIC and likelihood ratio of each model against the first one.

    If there are no criteria, the reason stands below the table, except if the log score is cross-validated.
    """
    columns = (
        ("model", ""),
        ("log score", "num"),
        ("95 %", "num"),
        ("verdict", ""),
        ("ΔAIC", "num"),
        ("ΔBIC", "num"),
        ("likelihood ratio", "num"),
        ("p", "num"),
    )
    rows = [_likelihood_cells(m) for m in result.models[1:]]
    reasons = [
        f"({m.label}): no AIC, BIC and likelihood ratio: {m.no_criteria}."
        for m in result.models[1:]
        if m.no_criteria and not (m.score is not None and m.score.held_out)
    ]
    held = [m.score.held_out for m in result.models if m.score is not None]
    lead = (
        f"Against ({result.models[0].label}). The log score is the difference in log-likelihood of the samples, each "
        "predicted one step ahead; above zero the model is better."
    )
    if held and all(held):
        lead += " No model was fitted to these logs, so that it needs no correction for the number of parameters."
    table = Table(columns, rows, stacked=True)
    return Section("likelihood", "Log score and criteria", [table, *map(Prose, reasons)], lead)


def _likelihood_cells(m: ComparedModel) -> list[Cell | str]:
    """Return the table cells of the likelihood of one model against the first one; dashes for what does not exist."""
    score, c = m.score, m.criteria
    shown = [Cell(f"({m.label})", "strong")]
    if score is None:
        shown += [Cell("–", "num"), Cell("–", "num"), Cell("other samples")]
    else:
        low, high = (None if v is None else signed(v) for v in (score.low, score.high))
        interval = "–" if low is None or high is None else f"{low} to {high}"
        shown += [Cell(signed(score.gain), "num"), Cell(interval, "num")]
        shown.append(Cell(verdict_words(score), MARKS[score.verdict][1]))
    if c is None:
        return [*shown, *(Cell("–", "num") for _ in range(4))]
    ratio = "–" if c.p is None else formatting.plain(2.0 * c.gain)
    return [
        *shown,
        Cell(signed(c.aic), "num"),
        Cell(signed(c.bic), "num"),
        Cell(ratio, "num"),
        Cell(formatting.probability(c.p), "num"),
    ]


def signed(value: float) -> str:
    """Return a number as text with its sign, with one decimal below 100: ``+12.3``; the minus sign is typographic."""
    return f"{value:+.{int(abs(value) < 100.0)}f}".replace("-", "−")


def overlay_section(canvas: Canvas, result: ComparisonResult) -> Section:
    """Return the section of the channels, measured and predicted by all models, one tab for each record.

    A tab has a figure for each horizon and for the simulation. The section is empty without traces. The figures are
    added to ``canvas``.
    """
    kinds = [kind for kind in result.kinds if kind[0] != "one_step"]
    tabs = []
    for tab in record_tabs(result.traces, roles_of(result.logs)):
        blocks: list[Any] = []
        for kind in kinds:
            short = {m.label: "predicted" if result.is_evaluation else f"({m.label})" for m in result.models}
            panels = overlay_panels(result, of_record(result.traces, tab), kind, canvas.budget.points, short)
            if panels:
                figure, height = with_legend(*drawing.stacked(panels, TIME), 1)
                label = f"Measured and predicted: {kind_title(*kind)}, {tab.title}"
                blocks += [Heading(kind_title(*kind)), Grid([canvas.plot(figure, height, label)], 320)]
                blocks += [Prose(drawing.CUT, "caption")] if drawing.cut(panels) else []
        tabs.append((tab.title, blocks))
    names = ", ".join(m.name if result.is_evaluation else f"({m.label}) {m.name}" for m in result.models)
    of = "" if result.is_evaluation else "by each model, "
    lead = (
        f"{names}. Measured samples are grey. The bands are the 95 % intervals of the predictions {of}which validation "
        "data may have widened. A click on a name of the legend hides its lines."
    )
    return Section("overlay", "Measured and predicted", tabbed(tabs), lead)


def with_legend(figure: drawing.Figure, height: int, lines: int) -> tuple[drawing.Figure, int]:
    """Return a figure of stacked panels with a legend above them, and its height [px].

    Parameters
    ----------
    figure, height
        The figure, and its height [px] without the legend.
    lines
        Number of lines of text for which the legend has room.
    """
    room = 12 + 20 * lines
    legend = {"orientation": "h", "x": 0, "xanchor": "left", "y": 1, "yref": "container", "yanchor": "top"}
    margin = figure["layout"]["margin"]
    layout = figure["layout"] | {"showlegend": True, "legend": legend, "margin": margin | {"t": margin["t"] + room}}
    return {**figure, "layout": layout}, height + room


def overlay_panels(
    result: ComparisonResult,
    rows: Sequence[ComparedTrace],
    kind: tuple[PredictionKind, float | None],
    limit: int,
    names: Mapping[str, str],
    first: bool = True,
) -> list[drawing.Panel]:
    """Return a panel for each channel with its samples and the prediction of each model with its 95 % band.

    Parameters
    ----------
    result : ComparisonResult
        The comparison, with the models and the fit of each channel.
    rows : sequence of ComparedTrace
        Channels to draw.
    kind : tuple
        Kind of prediction, with its horizon [s].
    limit : int
        Largest number of points of a line.
    names : mapping
        Name of each model in the legend, by its label.
    first : bool
        Whether the legend shows the models of these panels; false for further panels of a figure.

    Returns
    -------
    list of Panel
        Channels that no model predicts are left out. Angles are wrapped; those of a simulation are continuous. The
        traces of one model are one group of the legend, which has each model once.
    """
    panels: list[drawing.Panel] = []
    named: set[str] = set() if first else {"measured", *names}
    letters = list(names)
    for row in rows:
        own = [p for p in row.predictions if (p.kind, p.seconds) == kind]
        if not own:
            continue
        factor, unit = formatting.degrees_for(row.unit)
        # A simulation may leave the samples by any angle: the curves are continuous, so that their bands can be read.
        unwrapped = row.angle and kind[0] == "simulation"
        turn = 360.0 if row.angle and not unwrapped else None
        samples = factor * row.measured
        samples = drawing.continuous(samples, 360.0) if unwrapped else _turned(samples, turn)
        measured = drawing.dots(row.t, samples, "measured", limit, turn=turn)
        traces, edges, lines = [_in_legend(measured, "measured", named)], list[Array](), list[Array]()
        for p in own:
            k = letters.index(p.model)
            color, dash = drawing.LINES[k % len(drawing.LINES)], drawing.DASHES[k % len(drawing.DASHES)]
            y = factor * p.predicted
            y = drawing.beside(p.t, drawing.continuous(y, 360.0), row.t, samples) if unwrapped else _turned(y, turn)
            lines.append(y)
            half = drawing.Z95 * factor * p.sd
            edges += [y - half, y + half]
            shade = drawing.band(p.t, y, half, limit, color=color, opacity=BAND, turn=turn)
            traces.append(shade | {"legendgroup": p.model, "showlegend": False})
            line = drawing.line_trace(p.t, y, names[p.model], limit, color=color, dash=dash, turn=turn)
            traces.append(_in_legend(line, p.model, named))
        found = next((c for c in result.channels if (c.kind, c.seconds) == kind and c.channel == row.channel), None)
        title = formatting.titled(row.channel) + formatting.bracket(unit) + _fit_words(found)
        axis: dict[str, Any] = {}
        if turn:
            axis = {"range": [-turn / 2, turn / 2], "tick0": 0, "dtick": turn / 4}
        elif (frame := _frame(samples, lines, edges)) is not None:
            axis = {"range": frame}
        if unwrapped:
            axis["dtick"] = drawing.angle_step(axis.get("range"), [samples, *lines])
        panels.append(drawing.Panel(title, traces, axis))
    return panels


def _in_legend(trace: drawing.Trace, group: str, named: set[str]) -> drawing.Trace:
    """Return a trace as a member of a group of the legend, which shows the first trace of each group.

    ``named`` has the groups that the legend shows already; ``group`` is added to it.
    """
    shown = group not in named
    named.add(group)
    return trace | {"legendgroup": group, "showlegend": shown}


def _turned(angle: Array, turn: float | None) -> Array:
    """Return an angle wrapped to half a turn about zero; other signals (``turn`` is None) are returned unchanged."""
    return angle if turn is None else np.mod(angle + turn / 2, turn) - turn / 2


def _fit_words(row: ComparedChannel | None) -> str:
    """Return the fit of each model for the title of a panel: `` · fit (a) 67 %, (b) 95 %``; empty without a fit.

    The fit of one model alone has no label.
    """
    found = [] if row is None else [e for e in row.errors if e.fit is not None]
    fits = [f"({e.model}) " * (len(found) > 1) + formatting.percent(e.fit) for e in found]
    return f" · fit {', '.join(fits)}" if fits else ""


def _frame(measured: Array, predicted: Sequence[Array], edges: Sequence[Array]) -> list[float] | None:
    """Return limits of the vertical axis within which the samples can be read; None if none are needed.

    Parameters
    ----------
    measured : Array (n,)
        The samples.
    predicted : sequence of Array
        Predictions of each model. A prediction farther from the samples than their range, as that of a model that
        diverges, is outside the limits.
    edges : sequence of Array
        Lower and upper ends of the 95 % bands, for which the limits are those of `drawing.axis_limits`.
    """
    finite = measured[np.isfinite(measured)]
    if not finite.size or not np.ptp(finite) > 0.0:
        return None
    low, high, reach = float(finite.min()), float(finite.max()), float(np.ptp(finite))
    near = [np.clip(p, low - 0.5 * reach, high + 0.5 * reach) for p in predicted]
    return drawing.axis_limits([measured, *near], [*predicted, *edges])
