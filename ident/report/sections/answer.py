"""First section of a report page: error reduction and cards of the found effects, or the key parameters of a fit.

The section of a thruster's static thrust curve is here too.
"""

from __future__ import annotations

from typing import Any

from seatrial.ident.estimation import between_runs_title
from seatrial.ident.report import drawing, formatting
from seatrial.ident.report.blocks import Canvas, Dumbbell, Dumbbells, EffectCard, Facts, Grid, Prose, Section
from seatrial.ident.report.sections.predictions import by_role
from seatrial.ident.results import (
    DiagnosisResult,
    EffectRow,
    ErrorComparison,
    FitResult,
    FitSummary,
    ParameterRow,
    PredictionChangeRow,
    Result,
    StaticForce,
    candidate_title,
    curve_words,
    data_name,
    judged_by_blocks,
)

MAX_KEY_PARAMETERS = 9
FINE_PERCENT = 1.0  # change of the prediction error below which it has a decimal: "0 % larger" says nothing


def section(result: Result) -> Section:
    """Return the untitled section that follows the headline of a report page.

    A diagnosis has its caveat, the chart of prediction errors and a card for each added effect. Another fit has its key
    parameters. If a fit of the result did not converge, so that the estimates are not valid, only the caveat is left.
    The section is empty for any other result.
    """
    caveat = [result.caveat] if isinstance(result, DiagnosisResult) and result.caveat else []
    blocks: list[Any] = [Prose(line, "callout") for line in caveat]
    if isinstance(result, FitResult) and not result.converged:
        pass
    elif isinstance(result, DiagnosisResult):
        blocks += headline(result) + [effect_card(effect, result.horizon_seconds) for effect in result.effects]
    elif isinstance(result, FitResult):
        blocks += key_parameters(result.fit)
    return Section("answer", "", blocks)


def headline(result: DiagnosisResult) -> list[Any]:
    """Return the chart of prediction errors over the horizon, before and after effects were added, as a list of one.

    The errors are from validation data if the result has any, otherwise from estimation data. Channels whose prediction
    diverged are named in the caption. The list is empty if no effect was added, or if no channel has both errors.
    """
    role, data = by_role(result.errors.validation, result.errors.estimation)[0]
    if not result.effects:
        return []
    items = [(n, row) for n, row in data.horizon.items() if row.before is not None and row.after is not None]
    diverged = [name for name, row in data.horizon.items() if row.before is None or row.after is None]
    if not items:
        return []
    data_words = data_name(role, judged_by_blocks(result))
    caption = (
        f"RMS prediction error {result.horizon_seconds:g} s ahead on {data_words}, before → after. The axis is the "
        "ratio to the error before; the thin line is its 95 % interval. A channel is coloured only if its interval "
        "excludes an unchanged error."
    )
    caption += (
        f" Not drawn, because a prediction diverged: {', '.join(map(formatting.titled, diverged))}." if diverged else ""
    )
    return [Dumbbells(_dumbbells(items), caption)]


def _dumbbells(items: list[tuple[str, ErrorComparison]]) -> list[Dumbbell]:
    """Return one dumbbell (error before and after as two dots) for each channel, all on one scale.

    Positions are proportional to the ratio to the error before. The largest of 1, the ratios and the upper ends of
    their intervals, or 2.5 if that is less, is at 96 per cent of the width. ``items`` has name and errors of each
    channel.
    """
    ratios = [(row.after or 0.0) / max(row.before or 0.0, 1e-300) for _, row in items]
    widest = max([1.0, *ratios, *(row.high or 0.0 for _, row in items)])
    scale = 96.0 / min(widest, 2.5)  # per cent of the track's width for a ratio of one
    return [_channel_dumbbell(name, row, ratio, scale) for (name, row), ratio in zip(items, ratios, strict=True)]


def _channel_dumbbell(name: str, row: ErrorComparison, ratio: float, scale: float) -> Dumbbell:
    """Return the dumbbell of one channel: its errors before and after effects were added, as two dots on a track.

    Parameters
    ----------
    name
        Name of the channel.
    row
        RMS errors before and after, with the 95 % interval of their ratio.
    ratio
        Error after / error before. A change by less than 0.5 % is shown as ±0 %.
    scale
        Position of a ratio of one, in per cent of the track's width. Positions beyond 100 are drawn at 100.
    """
    factor, unit = formatting.degrees_for(row.unit)
    before, after = (factor * (value or 0.0) for value in (row.before, row.after))
    low, high = row.low, row.high
    same = abs(ratio - 1) < 0.005
    return Dumbbell(
        formatting.titled(name),
        formatting.plain(before),
        f"{formatting.plain(after)} {unit}".strip(),
        "±0 %" if same else formatting.percent(ratio - 1) if ratio < 1 else f"+{formatting.percent(ratio - 1)}",
        scale,
        min(ratio * scale, 100.0),
        None if low is None else min(low * scale, 100.0),
        None if high is None else min(high * scale, 100.0),
        {"fell": "better", "rose": "worse"}.get(row.verdict or "", "same"),
    )


def _criterion_in_words(criterion: float, why_not: str) -> str:
    """Return by how much the criterion (ΔBIC) of a competing model is worse, as text: ``12 worse``.

    ``criterion`` is that of the added effect minus that of the competing model. If it is negative, the text is ``12
    better on the estimation data, but ...`` with the reason ``why_not`` why the competing model was not chosen, if it
    is known.
    """
    if criterion < 0:
        reason = f", but {why_not}" if why_not else ""
        return f"{formatting.plain(-criterion)} better on the estimation data{reason}"
    return f"{formatting.plain(criterion)} worse"


def effect_card(effect: EffectRow, horizon: float) -> EffectCard:
    """Return the card of an added effect: formula, parameters, source, experiment, competing models, importance.

    Entries without a text are left out.

    Parameters
    ----------
    effect
        Effect that a diagnosis added to the model.
    horizon
        Prediction horizon [s] of the result, for the text on the importance.
    """
    parameters = []
    for row in effect.parameters:
        parameters.append((row.name, formatting.estimate_of_effect(row), row.meaning))
    alternatives = [f"{a.name} ({_criterion_in_words(a.criterion_behind, a.why_not)})" for a in effect.alternatives]
    facts: tuple[tuple[str, str | tuple[str, ...] | None], ...] = (
        ("In words", effect.in_words),
        ("Acts on", effect.place),
        ("Look for", effect.causes),
        ("Source", effect.source),
        ("Shown by", effect.experiment),
        ("Fitted in its place, ΔBIC", ", ".join(alternatives)),
        ("Attribution", attribution_points(effect)),
    )
    return EffectCard(
        effect.title or effect.name,
        effect.name,
        effect.formula,
        parameters,
        [(label, value) for label, value in facts if value],
        *_importance_in_words(effect.prediction, horizon),
        verdict="" if effect.prediction is None else effect.prediction.verdict,
    )


def _importance_in_words(change: PredictionChangeRow | None, horizon: float) -> tuple[str, str]:
    """Return how an effect changes the prediction error, as two texts: percentage, and words after it.

    As in the answer of the report, the percentages of an error that is smaller or larger have no sign, and those of an
    insignificant change have one. Both texts are empty if ``change`` is None.

    Parameters
    ----------
    change
        Change of the prediction error over the horizon by adding the effect to the others; None if it is unknown.
    horizon
        Prediction horizon [s].
    """
    if change is None:
        return "", ""
    error = f"prediction error {horizon:g} s ahead with this effect"
    shift = 100 * (change.ratio - 1)
    places = 0 if abs(shift) >= FINE_PERCENT else 1
    ends = None if change.low is None or change.high is None else [100 * (r - 1) for r in (change.low, change.high)]
    within = ""
    if ends is not None and change.verdict == "unchanged":
        within = f"95 %: {_signed(ends[0], places)} to {_signed(ends[1], places)} %"
    elif ends is not None:
        least, most = sorted(map(abs, ends))
        within = f"95 %: {least:.{places}f} to {most:.{places}f} %"
    if change.verdict == "unchanged":
        reason = "not significant" if ends is not None else "the data are too short for an interval"
        return f"{_signed(shift, places)} %", f"change of the {error}, {reason}{f' ({within})' if within else ''}"
    return (
        f"{abs(shift):.{places}f} %",
        f"{'smaller' if shift < 0.0 else 'larger'} {error}{f' ({within})' if within else ''}",
    )


def _signed(percent: float, places: int) -> str:
    """Return a percentage with this number of decimals and its sign, a plus or a true minus sign. Zero has a plus."""
    return f"{percent:+z.{places}f}".replace("-", "\N{MINUS SIGN}")


def attribution_points(effect: EffectRow) -> tuple[str, ...]:
    """Return the attribution of an added effect as items of a list: how far its name can be trusted.

    If the attribution is ambiguous, the items are the reasons and the effects that are not excluded. The last item is
    the share of such names that are right, if it is known.
    """
    odds: list[str] = []
    if effect.probability is not None:
        share = formatting.percent(effect.probability)
        odds.append(
            f"on simulated boats with known effects, {share} of such names were right, which is no probability for "
            "this boat"
        )
    if effect.attribution == "ambiguous":
        alternatives = [
            candidate_title(name) if curve_words(name) else between_runs_title(formatting.titled(name))
            for name in effect.not_excluded
        ]
        # An effect with a far worse ΔBIC in this place may still be there beside this effect, by its score test.
        rule = "not excluded, by ΔBIC or by the tests with this effect in the model"
        reasons = [*effect.reasons, *([f"{rule}: {', '.join(alternatives)}"] if alternatives else [])]
        return ("ambiguous", *reasons, *odds)
    found = {
        "identified": "identified: the effect keeps its size beside the candidates that remain, and no other effect "
        "explains about as much (a curve may, but it is no explanation)",
        "nonparametric": "nonparametric: no known effect explains the residual; the curve is estimated from the data",
    }[effect.attribution]
    return (found, *odds)


def key_parameters(fit: FitSummary) -> list[Any]:
    """Return the first nine estimated parameters of a fit, with standard errors, as labelled values, and a caption.

    The caption has the number of the other estimated parameters, as the table for the terminal has. Noise parameters
    (with the word noise in their meaning), per-record parameters, and parameters without a standard error are left out.
    The list is empty if no parameter is left.
    """
    estimated = sum(row.free and "noise" not in row.meaning for row in fit.parameters)
    found = []
    for row in fit.parameters:
        value, se = row.value, row.se
        if se is None or not row.free or row.record is not None or "noise" in row.meaning:
            continue
        factor, unit = formatting.degrees_for(row.unit)
        title = row.meaning or row.name
        title += f" (⚠ {row.flag})" if row.flag else ""
        found.append((title, _symbol_and_value(row, factor * value, factor * se, unit)))
    if not found:
        return []
    caption = ["± is one standard error" + (", statistical only" if fit.scale.statistical_only else "")]
    shown = found[:MAX_KEY_PARAMETERS]
    caption += [f"{estimated - len(shown)} more below"] if estimated > len(shown) else []
    return [Facts(shown, "cards"), Prose("; ".join(caption), "caption")]


def _symbol_and_value(row: ParameterRow, value: float, se: float, unit: str) -> str:
    """Return ``NAME = value ± standard error unit`` as text; ``value`` and ``se`` are in the shown unit."""
    return f"{row.name} = {formatting.with_error(value, se, unit)}"


def static_section(canvas: Canvas, static: StaticForce, rpm_max: float | None = None) -> Section:
    """Return the section with the figure of a thruster's static thrust curve, measured and fitted.

    The curve is the steady force [N] over the shaft speed or the command, as a fraction of full speed or command.

    Parameters
    ----------
    canvas
        Collector of the figures, to which the figure is added.
    static
        Measured points and fitted curve.
    rpm_max
        Full shaft speed [rev/min], by which the axis is in rev/min. None: it is a fraction of full.
    """
    full = 1.0 if rpm_max is None else rpm_max
    traces = [
        drawing.band(full * static.n_model, static.force_model, drawing.Z95 * static.force_sd, 600),
        drawing.line_trace(full * static.n_model, static.force_model, "model", 600),
    ]
    if static.n.size:
        coordinates = {"x": drawing.packed(full * static.n), "y": drawing.packed(static.force)}
        points = {"type": "scatter", "mode": "markers", **coordinates}
        marker = {"color": "#ffffff", "size": 8, "line": {"color": drawing.INK, "width": 1.5}}
        bars = {"type": "data", "array": drawing.packed(drawing.Z95 * static.sd), "thickness": 1.2, "width": 0}
        errors = {"error_y": {**bars, "color": drawing.INK}}
        traces.append({**points, "name": "measured", "marker": marker, **errors})
    lead = (
        "Circles: means of steady segments with 95 % intervals. Line: the fitted curve with its 95 % band. Intervals "
        "and band are statistical only: an error of the load cell's calibration, which scales all forces alike, is "
        "not included."
    )
    if static.force_quadratic is not None:
        n, force = full * static.n_model, static.force_quadratic
        traces.append(drawing.line_trace(n, force, "quadratic", 600, color=drawing.BEFORE, dash="dash"))
        lead += " Dashed: c1 n|n| + c2 n²."
    abscissa = static.abscissa.removesuffix(" n")
    axis = f"{static.abscissa}, fraction of full" if rpm_max is None else f"{abscissa} [rev/min]"
    figure = drawing.single(traces, axis, "force [N]", hovermode="closest")
    plot = canvas.plot(figure, 380, f"Steady force against {abscissa}")
    return Section("static", f"Force against {abscissa}", [Grid([plot], 320)], lead)
