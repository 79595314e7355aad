"""Sections of two campaigns of logs in a report page: changes, prediction errors, estimates by log, and the logs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from seatrial.ident.report import drawing, formatting
from seatrial.ident.report.blocks import Canvas, Cell, Grid, Heading, Key, Plot, Prose, Section, Table
from seatrial.ident.report.sections.predictions import error_words
from seatrial.ident.results import (
    CampaignErrors,
    CampaignsResult,
    CombinationDifference,
    Difference,
    EffectDifference,
    ErrorComparison,
)

NOT_COMPARED = "not compared"  # effect of which no parameter tells whether it is present
VALUES = {"before": "values before", "changed": "with the changes", "after": "values after"}
# Titles of the families of parameters in the table of changes; masses and thrust come first, without a title
FAMILIES = {
    "boat": "",
    "coefficients": "Single coefficients of the hull",
    "surroundings": "Sensors and surroundings",
    "noise": "Noise, disturbances and offsets",
}
CAMPAIGNS: tuple[Literal["before", "after"], ...] = ("before", "after")
COLORS = {"before": drawing.BEFORE, "after": drawing.MODEL}
SYMBOLS = {"before": "circle-open", "after": "circle"}
INTERVAL = 0.95  # level of the intervals; the joint test is significant beyond it
SHORT_UNIT = 3  # characters; with longer ones beside the numbers the table is wider than a window (it has them once)
MOST_LABELS = 24  # logs whose names fit beside a figure
ROW_PX, REST_PX = 20, 62  # height of a log's row in a figure, and of the axis below


def change_of(p: Difference, longest_unit: int | None = None) -> str:
    """Return the change of a parameter or combination with its 95 % interval as text: ``+24 % (+15 to +33)``.

    Without a relative change, it is in the shown unit of the parameter, as in ``-0.02 deg (-0.1 to +0.06)``. A
    unit with more than ``longest_unit`` characters is left out. Without an interval, only the change is returned.
    """
    factor, shown = formatting.degrees_for(p.unit)
    relative = p.relative is not None and p.difference != 0.0
    scale = 100.0 * (p.relative or 0.0) / p.difference if relative else factor
    value, low, high = (
        None if v is None else _signed(scale * v, relative, scale * p.se) for v in (p.difference, p.low, p.high)
    )
    too_long = longest_unit is not None and len(shown) > longest_unit
    unit = " %" if relative else f" {'' if too_long else shown}".rstrip()
    return f"{value}{unit}" if low is None or high is None else f"{value}{unit} ({low} to {high})"


def absolute_change(p: Difference) -> str:
    """Return the change of a parameter with its sign, in the shown unit, with the decimals of its error: ``+8.4``."""
    factor, _ = formatting.degrees_for(p.unit)
    text, _ = formatting.pair(factor * p.difference, factor * p.se)
    return text if p.difference <= 0.0 else f"+{text}"


def _detectable_text(p: Difference) -> str:
    """Return the size from which on a change of a parameter would have been found, in the unit of `change_of`."""
    if p.detectable is None:
        return formatting.plain(None)
    if p.relative is not None and p.difference != 0.0:
        return f"{formatting.plain(100.0 * p.detectable / p.before.mean, 2)} %"
    factor, _ = formatting.degrees_for(p.unit)
    return formatting.plain(factor * p.detectable, 2)


def _signed(value: float, percent: bool, error: float) -> str:
    """Return a number with its sign: whole per cent, one decimal if the ``error`` is below 1 %, or three digits.

    Per cent that are zero when rounded have no sign.
    """
    if not percent:
        text = formatting.plain(value)
        return text if value <= 0.0 else f"+{text}"
    digits = 1 if error < 1.0 else 0
    rounded = round(value, digits)
    return f"{rounded:+.{digits}f}".replace("-", "−") if rounded else f"{0.0:.{digits}f}"


def effect_words(effect: EffectDifference, result: CampaignsResult) -> tuple[str, str, str, str]:
    """Return an effect as texts: its name, whether it is present before and after, and whether it has changed.

    An effect that is not significant in a campaign has its strongest parameter, with the standard errors that separate
    it from its value without the effect, and those that are needed, as in ``not significant: F_wx -0.6 ± 0.5 N
    (1.2 of 4.3)``.
    """
    before, after = (_presence(effect, result, c) for c in CAMPAIGNS)
    return effect.name, before, after, "changed" if effect.changed else ""


def _presence(effect: EffectDifference, result: CampaignsResult, campaign: Literal["before", "after"]) -> str:
    """Return in words whether an effect is present in a campaign."""
    present, evidence = effect.before, effect.evidence_before
    if campaign == "after":
        present, evidence = effect.after, effect.evidence_after
    words = {True: "present", False: "not significant", None: NOT_COMPARED}[present]
    p = None if evidence is None else next((p for p in result.parameters if p.name == evidence.name), None)
    if present is not False or evidence is None or p is None:
        return words
    mean, (factor, unit) = getattr(p, campaign), formatting.degrees_for(p.unit)
    size = f"{formatting.with_error(factor * mean.mean, factor * mean.se)} {unit}".rstrip()
    return f"{words}: {p.name} {size} ({evidence.distance:.1f} of {evidence.needed:.1f})"


def effects_caption(result: CampaignsResult) -> str:
    """Return the sentences that explain effects that are not significant or have no verdict; empty without them."""
    verdicts = {v for e in result.effects for v in (e.before, e.after)}
    lines = []
    if False in verdicts:
        lines.append(
            "Not significant: the logs of this campaign alone do not distinguish the effect from zero, at 5 % for all "
            "its parameters together. In brackets: standard errors from the value without the effect, of those that "
            "are needed. Few logs need many (Student's t)."
        )
    if None in verdicts:
        lines.append(
            f"{NOT_COMPARED[0].upper()}{NOT_COMPARED[1:]}: no parameter of the effect could be tested in this "
            "campaign; the reasons are in the table of what is not compared."
        )
    return " ".join(lines)


def joint_words(result: CampaignsResult) -> str:
    """Return the p value of all parameters together as a sentence; empty without this test.

    A second sentence says which numbers count if the test is not significant although single parameters have changed.
    """
    if result.joint is None or result.joint.p is None:
        return ""
    words = formatting.p_equals(result.joint.p)
    text = f"All {len(result.joint.parameters)} parameters together: p {words} for no change at all."
    if result.changed and result.joint.p > 1.0 - INTERVAL:
        text += (
            " Trust the q values of the single parameters: this test spreads over all directions, in which a change of "
            "few parameters is small."
        )
    return text


def changes_section(result: CampaignsResult) -> Section:
    """Return the section of the differences of all parameters, of the effects, and of what could not be compared."""
    columns = (
        ("parameter", ""), ("", ""), ("verdict", ""), ("q", "num"), ("change", "num"), ("change (95 %)", "num"),
        ("before ± s.e.", "num"), ("after ± s.e.", "num"), ("found from", "num"), ("scatter", "num"), ("p", "num"),
    )  # fmt: skip
    together = sorted(result.combinations, key=lambda c: not c.changed)
    rows: list[list[Cell | str]] = [_cells(p, result.false_discovery_rate) for p in result.parameters if p.changed]
    for family, title in FAMILIES.items():
        if own := [p for p in result.parameters if p.family == family and not p.changed]:
            rows += [[Cell(title)]] if title else []
            rows += [_cells(p, result.false_discovery_rate) for p in own]
    blocks: list[Any] = [Table(columns, rows, stacked=True)] if rows else []
    if together:
        of_them = Table(
            (("combination of parameters", ""), *columns[1:]),
            [_cells(c, result.false_discovery_rate) for c in together],
            stacked=True,
        )
        blocks.insert(0, of_them)
    lead = (
        "Means of the separate fits to the logs, with the scatter between logs as a random effect (REML) and intervals "
        "by Student's t (Hartung and Knapp). A parameter has changed if q, the p value adjusted for the number of "
        "parameters and combinations of its family (Benjamini and Hochberg), is at most "
        f"{100 * result.false_discovery_rate:g} %. Families are masses, thrust and combinations; single "
        "coefficients; sensors and surroundings; noise. "
        "Found from: size from which on a change would have been found. "
        "Changed ones come first. A combination, such as the drag at a speed of the logs, may be known better than "
        "each of its parameters."
    )
    lines = list(filter(None, [joint_words(result)]))
    if (f := result.common_factor) is not None and f.explains:
        factor, low, high = (formatting.plain(v) for v in (f.factor, f.low, f.high))
        lines.append(
            f"One factor of {', '.join(f.parameters)} explains the changes of all of them: {factor} "
            f"(95 %: {low} to {high}; p {formatting.p_equals(f.p)} for one factor). A change of the thrust does "
            "the same."
        )
    blocks += [Prose(line) for line in lines]
    if result.effects:
        found = [
            [Cell(w, "code") if k == 0 else Cell(w) for k, w in enumerate(effect_words(e, result))]
            for e in result.effects
        ]
        blocks += [Heading("Effects"), Table((("effect", ""), ("before", ""), ("after", ""), ("", "")), found)]
        blocks += [Prose(line) for line in filter(None, [effects_caption(result)])]
    if result.not_compared:
        reasons: dict[str, list[str]] = {}
        for p in result.not_compared:
            reasons.setdefault(p.reason, []).append(p.name)
        left = [[Cell(", ".join(names), "code"), Cell(reason)] for reason, names in reasons.items()]
        blocks += [Heading("Not compared"), Table((("parameter", ""), ("reason", "")), left)]
    return Section("changes", "Changes", blocks, lead if rows else "")


def _cells(p: Difference, rate: float) -> list[Cell | str]:
    """Return the table cells of one parameter, or of one combination; ``rate`` is the false discovery rate."""
    factor, unit = formatting.degrees_for(p.unit)
    before, after = (formatting.with_error(factor * m.mean, factor * m.se) for m in (p.before, p.after))
    scatter = None if p.scatter is None else factor * p.scatter
    changes = (absolute_change(p), change_of(p, SHORT_UNIT), _detectable_text(p))
    numbers = (formatting.probability(p.q, rate), *changes[:2], before, after, changes[2], formatting.plain(scatter, 2))
    verdict = Cell("changed", "strong") if p.changed else Cell("unknown" if p.q is None else "–", "quiet")
    return [
        Cell(p.name, "" if isinstance(p, CombinationDifference) else "symbol"),
        Cell(unit, "nowrap"),
        verdict,
        *(Cell(n, "num") for n in (*numbers, formatting.probability(p.p))),
    ]


def errors_section(result: CampaignsResult) -> Section:
    """Return the section of the prediction errors on the logs of each campaign; empty if no log was predicted."""
    errors = result.errors
    columns = [("channel", ""), ("", ""), *((f"logs {e.logs}, {VALUES[e.values]}", "num") for e in errors)]
    channels = dict.fromkeys(name for e in errors for name in e.channels)
    rows: list[list[Cell | str]] = []
    for name in channels:
        factor, unit = formatting.degrees_for(next(e.channels[name].unit for e in errors if name in e.channels))
        cells = [_error_cell(e.channels.get(name), factor) for e in errors]
        rows.append([Cell(formatting.titled(name)), Cell(unit), *cells])
    if any(e.ratio is not None for e in errors):
        rows.append([Cell("all channels", "strong"), Cell("ratio"), *(_ratio_cell(e) for e in errors)])
    lead = (
        f"RMS prediction error {result.horizon:g} s ahead. No log is predicted with values that were estimated from it"
        ". In brackets: error / error with the values before, on the same logs. The 95 % interval of the ratio over "
        "all channels is by a jackknife over blocks of time."
    )
    return Section("errors", "Prediction errors", [Table(columns, rows)] if rows else [], lead if rows else "")


def _error_cell(row: ErrorComparison | None, factor: float) -> Cell:
    """Return the cell of one error, with its ratio to that with the values before."""
    if row is None:
        return Cell("–", "num")
    words = error_words(None if row.after is None else factor * row.after)
    if row.before and row.after is not None:
        words += f" ({formatting.plain(row.after / row.before, 2)})"
    return Cell(words, f"num {_style(row.verdict)}".strip())


def _ratio_cell(e: CampaignErrors) -> Cell:
    """Return the cell of the ratio of the errors over all channels, with its 95 % interval."""
    if e.ratio is None:
        return Cell("1", "num")
    within = "" if e.low is None else f" ({formatting.plain(e.low, 2)} to {formatting.plain(e.high, 2)})"
    return Cell(f"{formatting.plain(e.ratio, 2)}{within}", f"num {_style(e.verdict)}".strip())


def _style(verdict: str | None) -> str:
    """Return the CSS class of a significant change of an error; empty without one."""
    return {"fell": "good", "rose": "bad"}.get(verdict or "", "")


def estimates_section(canvas: Canvas, result: CampaignsResult) -> Section:
    """Return the section of the estimates of each log: a figure for each combination and parameter of the boat.

    Combinations come first, then changed parameters.
    """
    shown: list[Difference] = [*result.combinations, *(p for p in result.changed_first if not p.nuisance)]
    key = Key([("before-dots", "log before, with 95 % interval"), ("after-dots", "log after, with 95 % interval")])
    lead = (
        "Line and band: mean of the campaign with its 95 % interval. Errors from priors are left out, because they are "
        "the same in all logs."
    )
    plots = [_estimates_plot(canvas, p) for p in shown]
    return Section("estimates", "Estimates of each log", [key, Grid(plots, 300)] if plots else [], lead)


def _estimates_plot(canvas: Canvas, p: Difference) -> Plot:
    """Return the plot of the estimates of one parameter, one row for each log, those before on top."""
    factor, unit = formatting.degrees_for(p.unit)
    logs = sorted(p.logs, key=lambda x: x.campaign == "after")
    place = np.arange(len(logs))[::-1]
    traces, shapes = [], []
    variances = {
        c: 1.0 / sum(1.0 / (x.se**2 + (p.scatter or 0.0) ** 2) for x in logs if x.campaign == c) for c in COLORS
    }
    for campaign, mean in (("before", p.before), ("after", p.after)):
        at = [k for k, x in enumerate(logs) if x.campaign == campaign]
        color = COLORS[campaign]
        bars = {"type": "data", "array": [factor * drawing.Z95 * logs[k].se for k in at], "thickness": 1.4, "width": 0}
        traces.append(
            {
                "type": "scatter", "mode": "markers", "name": campaign,
                "x": [factor * logs[k].value for k in at], "y": place[at].tolist(),
                "error_x": {**bars, "color": color}, "text": [drawing.escaped(logs[k].log) for k in at],
                "hovertemplate": "%{text}: %{x:.4g}<extra></extra>",
                "marker": {"color": color, "symbol": SYMBOLS[campaign], "size": 8, "line": {"width": 1.8}},
            }
        )  # fmt: skip
        rows = {"y0": float(place[at].min()) - 0.5, "y1": float(place[at].max()) + 0.5, "layer": "below"}
        center = factor * mean.mean
        shapes.append({"type": "line", "x0": center, "x1": center, "line": {"color": color, "width": 1.6}, **rows})
        if p.low is not None and p.high is not None:
            # The interval of the difference, shared between the means by their variances: without errors from priors.
            half = 0.5 * factor * (p.high - p.low) * (variances[campaign] / sum(variances.values())) ** 0.5
            fill = "rgba({},{},{},0.16)".format(*(int(color[i : i + 2], 16) for i in (1, 3, 5)))
            edge = {"type": "rect", "x0": center - half, "x1": center + half, "line": {"width": 0}, "fillcolor": fill}
            shapes.append({**edge, **rows})
    names = [_short_name(x.log) for x in logs]
    labels: dict[str, Any] = {"showticklabels": False}
    if len(logs) <= MOST_LABELS:
        labels = {"tickmode": "array", "tickvals": place.tolist(), "ticktext": [drawing.escaped(n) for n in names]}
    y = {**labels, "range": [-0.7, len(logs) - 0.3], "automargin": True, "showgrid": False}
    title = f"{p.name}{formatting.bracket(unit)}{', changed' if p.changed else ''}"
    figure = drawing.single(traces, title, xaxis={"nticks": 5}, yaxis=y, shapes=shapes, hovermode="closest")
    return canvas.plot(figure, REST_PX + ROW_PX * len(logs), f"Estimates of {p.name} from each log")


def _short_name(path: str, most: int = 18) -> str:
    """Return the file name of a log without its ending; of a longer name than ``most`` characters, the end."""
    name = path.replace("\\", "/").rsplit("/", 1)[-1].removesuffix(".mcap")
    return name if len(name) <= most else f"…{name[1 - most :]}"


def logs_section(result: CampaignsResult) -> Section:
    """Return the section of the logs of both campaigns, and of those without a fit."""
    columns = (("log", ""), ("campaign", ""), ("duration", "num"), ("SHA-256", ""))
    rows: Sequence[Sequence[Cell | str]] = [
        [x.log, x.campaign, Cell(formatting.duration(x.duration), "num"), Cell(x.sha256[:16], "code")]
        for x in result.campaigns
    ]
    blocks: list[Any] = [Table(columns, rows)]
    if result.failed:
        failed = [[Cell(f.log), Cell(f.reason)] for f in result.failed]
        blocks += [Heading("Logs without a fit"), Table((("log", ""), ("reason", "")), failed)]
    if result.unpredicted:
        left = [[Cell(x.log), Cell(x.reason)] for x in result.unpredicted]
        blocks += [Heading("Logs without a prediction"), Table((("log", ""), ("reason", "")), left)]
    return Section("logs", "Logs", blocks)
