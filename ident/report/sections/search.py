"""Section of the search for missing effects in the report page of a diagnosis.

It shows candidates and refits of each round, residual forces (forces that the model does not explain), and
nonparametric curves.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Any

from seatrial.daq.errors import counted
from seatrial.ident.report import drawing, formatting
from seatrial.ident.report.blocks import (
    Bar,
    Canvas,
    Cell,
    Grid,
    Heading,
    Key,
    OnScreen,
    Prose,
    Ranking,
    Section,
    Table,
    tabbed,
)
from seatrial.ident.report.record_tabs import RecordTab, of_record, record_tabs, roles_of
from seatrial.ident.report.sections.parameters import common_errors_blocks
from seatrial.ident.results import (
    Candidate,
    DetectableEffect,
    DiagnosisResult,
    NonparametricCurve,
    RefitRow,
    ResidualForce,
    RoundRow,
    of_judging_data,
)

MAX_BARS = 14  # candidates in the chart of a round
OUTCOMES = {
    "added": "added",
    "outranked": "accepted, but another effect explains more",
    "small": "small compared with the effects found before",
    "not-supported": "gain too small for its number of parameters",
    "not-validated": "not supported by validation data",
    "worse-prediction": "prediction is worse with it",
    "no-better-prediction": "prediction is not better with it",
}


def section(canvas: Canvas, result: DiagnosisResult) -> Section:
    """Return the section of the search for missing effects.

    It has the common errors, a tab for each round of the search, the residual forces, the nonparametric curves, and the
    smallest sizes of other effects that the data would have shown.

    Parameters
    ----------
    canvas
        Collector of the figures, to which the figures are added.
    result
        Result of a diagnosis.
    """
    found, removed = result.rounds, {row.name for row in result.removed_effects}
    rounds = [
        (_round_title(i, row, removed), _round_blocks(row, removed, result.cross_validated))
        for i, row in enumerate(found, 1)
    ]
    blocks: list[Any] = common_errors_blocks(result.common_errors, result.cross_validated) + tabbed(
        rounds, all_printed=True
    )
    blocks += _residual_force_blocks(canvas, result) + _curve_blocks(canvas, result.nonparametric_effects)
    blocks += _detectable_blocks(result.detectable)
    lead = (
        "Each round tests all candidates (effects that the model may lack) on the residuals by score tests, and refits "
        "the model with the best of them. Their ΔBIC is the gain 2 Δln L less df ln n. The validation data decide "
        "whether an effect is added: their likelihood has to rise with t above 2, or with t above 1 if t over "
        "estimation data and validation data together is above 3."
    )
    return Section(
        "search", "Search for missing effects", blocks, of_judging_data(lead, result.cross_validated) if found else ""
    )


def _detectable_blocks(detectable: Sequence[DetectableEffect]) -> list[Any]:
    """Return heading and table of the smallest sizes of other effects that the data would have shown.

    An effect without sizes has one row, which states that the estimated parameters explain the effect at any size. The
    list is empty without effects.
    """
    rows: list[list[Cell | str]] = []
    for effect in detectable:
        title: Cell | str = effect.title
        if not effect.sizes:
            rows.append([title, "explained by the estimated parameters at any size", Cell("–", "num"), ""])
        for row in effect.sizes:
            factor, unit = formatting.degrees_for(row.unit)
            size = Cell(formatting.plain(factor * row.size), "num")
            rows.append([title, f"{row.name}: {row.meaning}" if row.meaning else row.name, size, unit])
            title = ""
    if not rows:
        return []
    caption = (
        "The score test of each effect that the model lacks would have passed with a probability of 80 % at this size, "
        "with its other parameters at zero. The size follows from the information of the data that the estimated "
        "parameters do not explain. Differences between model and boat are left out, and so is the part of an effect "
        "that the disturbance forces of the fit would explain: a slow effect, such as a constant force, has to be up "
        "to twice as large. An effect that is not found is smaller than this, or resembles others."
    )
    columns = (("effect", ""), ("parameter", ""), ("smallest size", "num"), ("unit", ""))
    blocks = [Heading("What these data would have shown"), Table(columns, rows, caption)]
    words = (
        f"On the screen, the page also has the smallest sizes of {counted(len(detectable), 'other effect')} that these "
        "data would have shown."
    )
    return [OnScreen(blocks, words)]


def _round_title(i: int, row: RoundRow, removed: Collection[str]) -> str:
    """Return the title of the tab of a search round: ``Round 2: NAME``, with the name of the effect that was added.

    ``i`` is the number of the round, from 1. Without an added effect the text is ``nothing added``. The title states
    that the effect was removed again if it is in ``removed``, the names of the removed effects.
    """
    return f"Round {i}: {row.chosen or 'nothing added'}{', removed again' if row.chosen in removed else ''}"


def _round_blocks(row: RoundRow, removed: Collection[str], in_blocks: bool) -> list[Any]:
    """Return the contents of the tab of a search round: reason of the choice, chart of candidates, table of refits.

    ``removed`` has the names of the effects that were removed again later. If the effect of this round is among them, a
    paragraph states that, and the effect is not marked as added. ``in_blocks``: whether blocks of time take the place
    of validation logs.
    """
    blocks: list[Any] = [Prose(row.why, "why")] if row.why else []
    if row.chosen in removed:
        words = "This effect was removed again; the notes have the reason."
        blocks.append(Prose(words, "why"))
    chosen = None if row.chosen in removed else row.chosen
    return blocks + ranking(row, chosen) + _refits_table(row, chosen, in_blocks)


def ranking(row: RoundRow, chosen: str | None) -> list[Any]:
    """Return heading and bar chart of the score tests of the best 14 candidates of a search round.

    The axis is logarithmic, so that candidates with a statistic of zero are left out. The list is empty if no candidate
    is left.

    Parameters
    ----------
    row : RoundRow
        Round of the search with its candidates, best first.
    chosen : str or None
        Name of the effect that was added and is marked in the chart; None if there is none.
    """
    best = [c for c in row.candidates if c.lm > 0][:MAX_BARS]
    if not best:
        return []
    sizes = [c.lm for c in best]
    limits = [c.threshold for c in best]
    low = min(1.0, *sizes) if min(sizes) >= 0.1 else 0.1
    high = max(*sizes, *limits) * 1.25

    def at(value: float) -> float:
        """Return the position of a score statistic on the logarithmic axis, 0.4 to 100 % of its length.

        A statistic beyond the ends of the axis has the position 0.4 or 100.
        """
        return 100.0 * min(max(math.log(value / low) / math.log(high / low), 0.004), 1.0)

    bars = [_candidate_bar(c, at(size), at(limit), chosen) for c, size, limit in zip(best, sizes, limits, strict=True)]
    decades = range(math.ceil(math.log10(low)), math.floor(math.log10(high)) + 1)
    ticks = [(at(10.0**d) if d > math.log10(low) else 0.0, f"{10**d:,}" if d >= 0 else f"{10.0**d:g}") for d in decades]
    caption = (
        f"{row.passed} of {row.tested} candidates passed the score test. Shown are the {len(best)} candidates with the "
        "largest statistic per degree of freedom. The bar is the statistic (χ², logarithmic axis); the line is its "
        "threshold, which accounts for the number of tests."
    )
    return [Heading("Candidates"), Ranking(bars, ticks, caption)]


def _candidate_bar(candidate: Candidate, width: float, limit: float, chosen: str | None) -> Bar:
    """Return the bar of the score test of one candidate.

    Parameters
    ----------
    candidate
        Candidate with its score test.
    width, limit
        Positions of the statistic and of its critical value, in per cent of the width of the bar's track.
    chosen
        Name or title of the effect that was added, None if there is none.
    """
    p, p_block = (formatting.probability(value) for value in (candidate.p, candidate.p_block))
    statistic = f"{formatting.plain(candidate.lm)} on {formatting.count(candidate.df)} df"
    if candidate.df > 1:  # the candidates are sorted by it
        statistic += f" ({formatting.plain(candidate.lm / candidate.df)} per df)"
    numbers = f"{statistic}, p {p}, block-robust {p_block}"
    name = candidate.name
    return Bar(
        candidate.title or name,
        name,
        numbers,
        width,
        limit,
        candidate.generic,
        candidate.passed,
        bool(chosen) and chosen in (name, candidate.title),
    )


def _refits_table(row: RoundRow, chosen: str | None, in_blocks: bool) -> list[Any]:
    """Return heading and table of the refits of a search round; an empty list without refits.

    ``chosen`` is the name of the effect that was added and not removed again, None if there is none. ``in_blocks``:
    whether blocks of time take the place of validation logs.
    """
    found = row.refits
    columns = (
        ("refitted with", ""),
        ("effect parameters", ""),
        ("gain 2 Δln L", "num"),
        ("df", "num"),
        ("ΔBIC", "num"),
        (of_judging_data("Δln L on validation data", in_blocks), "num"),
        ("t", "num"),
        ("outcome", ""),
    )
    heading = Heading("Refits with the best candidates")
    return [heading, Table(columns, [_refit_cells(r, chosen, in_blocks) for r in found])] if found else []


def _refit_cells(row: RefitRow, chosen: str | None, in_blocks: bool) -> list[Cell | str]:
    """Return the table cells of one refit: effect, estimates, gains and outcome. Up to three estimates are printed.

    The gains are 2 d ln L with the number of parameters, the criterion, and d ln L on the validation data with its t
    statistic. ``chosen`` is the name of the effect that was added in the round and not removed again, None if there is
    none. A refit with the outcome "added" and another name is shown as removed again.
    """
    parameters = [f"{p.name} = {formatting.estimate_of_effect(p)}" for p in row.parameters]
    more = [f"and {len(parameters) - 3} more"] if len(parameters) > 3 else []
    won = bool(chosen) and row.name == chosen
    title = row.title or row.name
    return [
        Cell(f"✓ {title}" if won else title, "wide strong won" if won else "wide"),
        Cell("; ".join(parameters[:3] + more), "small"),
        Cell(formatting.plain(row.gain), "num"),
        Cell(formatting.count(row.df), "num"),
        Cell(formatting.plain(row.criterion), "num"),
        Cell(formatting.plain(row.validation_gain), "num"),
        Cell(formatting.plain(row.t, 2), "num"),
        of_judging_data(OUTCOMES[row.outcome], in_blocks)
        + (", removed again" if row.outcome == "added" and not won else ""),
    ]


def _residual_force_blocks(canvas: Canvas, result: DiagnosisResult) -> list[Any]:
    """Return heading, legend and figures of the residual forces over time, one tab for each record.

    Residual forces are smoothed estimates of forces that the model does not explain. The figures are added to
    ``canvas``. The list is empty if no force has finite values.
    """
    forces = result.residual_forces
    found = record_tabs(forces, roles_of(result.logs, result.traces))
    tabs = [(tab.title, _force_tab(canvas, of_record(forces, tab), tab)) for tab in found]
    if not any(blocks for _, blocks in tabs):
        return []
    after = any(row.after_mean is not None for row in forces)
    items = [("before", "before"), ("after", "after the effects were added")] if after else [("before", "estimate")]
    note = "smoothed forces that the model does not explain, with 95 % bands"
    return [Heading("Residual forces", note), Key(items), *tabbed(tabs)]


def _force_tab(canvas: Canvas, forces: Sequence[ResidualForce], tab: RecordTab) -> list[Any]:
    """Return the figure of the residual forces of one record over time, as a list of one; empty without finite values.

    ``tab`` has the title of the record for the description of the figure, which is added to ``canvas``.
    """
    panels = [p for row in forces if (p := _force_panel(canvas, row))]
    if not panels:
        return []
    figure, height = drawing.stacked(panels, "time since the start of the log [s]")
    return [Grid([canvas.plot(figure, height, f"Residual forces over time, {tab.title}")], 320)]


def _force_panel(canvas: Canvas, row: ResidualForce) -> drawing.Panel | None:
    """Return the panel of one residual force over time with its 95 % band; None without finite values.

    The curve of the model after effects were added is drawn too, if there is one. ``canvas`` has the largest number of
    points of a trace.
    """
    limit, traces = canvas.budget.points, []
    mean, sd, after_mean, after_sd = map(drawing.drawable, (row.mean, row.sd, row.after_mean, row.after_sd))
    for middle, half, name, color, dash in (
        (mean, sd, "before", drawing.BEFORE, "dash"),
        (after_mean, after_sd, "after", drawing.MODEL, "solid"),
    ):
        if middle is None:
            continue
        if half is not None:
            traces.append(drawing.band(row.t, middle, drawing.Z95 * half, limit, color=color, opacity=0.16))
        traces.append(drawing.line_trace(row.t, middle, name, limit, color=color, dash=dash))
    title = formatting.titled(row.force) + formatting.bracket(formatting.typeset_unit(row.unit))
    return drawing.Panel(title, traces) if traces else None


def _curve_blocks(canvas: Canvas, curves: Sequence[NonparametricCurve]) -> list[Any]:
    """Return heading and plots of the nonparametric curves, one plot for each curve.

    A curve is a force or a sensor error over one variable, estimated from the data. Curves without finite values are
    left out. The list is empty if no curve is left. The plots are added to ``canvas``.
    """
    plots = []
    for row in curves:
        if drawing.drawable(row.value) is None:
            continue
        scale, y_unit = formatting.degrees_for(row.unit)
        value, half = scale * row.value, scale * row.band
        factor, unit = formatting.degrees_for(row.variable_unit)
        x = factor * row.grid
        traces = [drawing.band(x, value, half, 600)] if drawing.drawable(half) is not None else []
        traces.append(drawing.line_trace(x, value, row.force, 600))
        force, variable = formatting.named(row.force), formatting.named(row.variable)
        if row.sensor_error:
            force = f"error of the {force}"
        y_title = force + formatting.bracket(y_unit)
        figure = drawing.single(traces, variable + formatting.bracket(unit), y_title)
        plots.append(canvas.plot(figure, 280, f"{force} over {variable}", f"{force} over {variable}"))
    note = (
        "disturbance force or sensor error over one variable, estimated from the data; "
        "the 95 % band contains the whole curve"
    )
    return [Heading("Nonparametric curves", note), Grid(plots, 320)] if plots else []
