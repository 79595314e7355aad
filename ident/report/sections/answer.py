"""The answer first: what the effect removed, or the parameters that matter, and the curve of a thruster."""

from __future__ import annotations

from typing import Any

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
    Result,
    StaticForce,
)

KEY_PARAMETERS = 9


def section(result: Result) -> Section:
    """Without a title: it follows the answer itself."""
    caveat = [result.caveat] if isinstance(result, DiagnosisResult) and result.caveat else []
    blocks: list[Any] = [Prose(line, "callout") for line in caveat]
    if isinstance(result, FitResult) and not result.converged:
        pass  # its estimates are no answer
    elif isinstance(result, DiagnosisResult):
        blocks += headline(result) + [effect_card(effect) for effect in result.effects]
    elif isinstance(result, FitResult):
        blocks += key_parameters(result.fit)
    return Section("answer", "", blocks)


def headline(result: DiagnosisResult) -> list[Any]:
    """Errors over the horizon before and after, on validation data where there are some."""
    role, data = by_role(result.errors.validation, result.errors.estimation)[0]
    items = [(n, row) for n, row in data.horizon.items() if row.before is not None and row.after is not None]
    lost = [name for name, row in data.horizon.items() if row.before is None or row.after is None]
    if not items:
        return []
    caption = (
        f"RMS prediction error {result.horizon_seconds:g} s ahead on {role} data, before → after; the axis is relative "
        "to before, the thin line is the 95 % interval. Only what changed beyond its interval is coloured."
    )
    caption += f" Not drawn, as a prediction diverged: {', '.join(map(formatting.titled, lost))}." if lost else ""
    return [Dumbbells(_dumbbells(items), caption)]


def _dumbbells(items: list[tuple[str, ErrorComparison]]) -> list[Dumbbell]:
    ratios = [(row.after or 0.0) / max(row.before or 0.0, 1e-300) for _, row in items]
    widest = max([1.0, *ratios, *(row.high or 0.0 for _, row in items)])
    scale = 96.0 / min(widest, 2.5)  # percent of the track for a ratio of one
    return [_dumbbell(name, row, ratio, scale) for (name, row), ratio in zip(items, ratios, strict=True)]


def _dumbbell(name: str, row: ErrorComparison, ratio: float, scale: float) -> Dumbbell:
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


def _behind(criterion: float) -> str:
    """A competing model may be ahead on the fitted data and yet not hold on the others."""
    if criterion < 0:
        return f"{formatting.plain(-criterion)} ahead, but not on the validation data"
    return f"{formatting.plain(criterion)} behind"


def effect_card(effect: EffectRow) -> EffectCard:
    """Formula, parameters with standard errors, source, and the experiment that shows it."""
    parameters = []
    for row in effect.parameters:
        factor, unit = formatting.degrees_for(row.unit)
        value, se = formatting.scaled(factor, row.value, row.se)
        parameters.append((row.name, formatting.with_error(value, se, unit), row.meaning))
    alternatives = [f"{row.name} ({_behind(row.criterion_behind)})" for row in effect.alternatives]
    facts = (
        ("Acts on", effect.place),
        ("Source", effect.source),
        ("Shown by", effect.experiment),
        ("Competing models, Δ BIC", ", ".join(alternatives)),
        ("How sure", how_sure(effect)),
    )
    return EffectCard(
        effect.title or effect.name,
        effect.name,
        effect.formula,
        parameters,
        [(label, value) for label, value in facts if value],
        *_importance(effect.error_ratio_without),
    )


def _importance(factor: float | None) -> tuple[str, str]:
    """How much larger the prediction error is without the effect (seatrial.ident.diagnosis.importance): the figure, and
    the words after it."""
    if factor is None:
        return "", ""
    if factor >= 2.0:
        return f"{formatting.plain(factor)} times", "as large a prediction error without it"
    larger = "larger" if factor >= 1.0 else "smaller"
    return formatting.percent(abs(factor - 1.0)), f"{larger} prediction error without it"


def how_sure(effect: EffectRow) -> str:
    """In words: a name that stands alone, or what speaks against it."""
    if effect.attribution == "ambiguous":
        others = [formatting.titled(name) for name in effect.not_excluded]
        reasons = [*effect.reasons, *([f"not excluded: {', '.join(others)}"] if others else [])]
        return "it resembles this; " + "; ".join(reasons)
    return {
        "identified": "nothing is left that this should explain, and no competing model comes close",
        "nonparametric": "no known effect explains it; the curve is what the data draw",
    }[effect.attribution]


def key_parameters(fit: FitSummary) -> list[Any]:
    """The free parameters of the dynamics that all runs share, not those of the noise."""
    found = []
    for row in fit.parameters:
        value, se = row.value, row.se
        if se is None or not row.free or row.record is not None or "noise" in row.meaning:
            continue
        factor, unit = formatting.degrees_for(row.unit)
        title = row.meaning or row.name
        title += f" (⚠ {row.flag})" if row.flag else ""
        found.append((title, _symbol(row, factor * value, factor * se, unit)))
    if not found:
        return []
    said = ["± one standard error" + (", statistical only" if fit.scale.statistical_only else "")]
    said += [f"{len(found) - KEY_PARAMETERS} more below"] if len(found) > KEY_PARAMETERS else []
    return [Facts(found[:KEY_PARAMETERS], "cards"), Prose("; ".join(said), "caption")]


def _symbol(row: ParameterRow, value: float, se: float, unit: str) -> str:
    return f"{row.name} = {formatting.with_error(value, se, unit)}"


def static_section(canvas: Canvas, static: StaticForce) -> Section:
    """Steady force against shaft speed, measured and fitted."""
    traces = [
        drawing.band(static.n_model, static.force_model, drawing.Z95 * static.force_sd, 600),
        drawing.line_trace(static.n_model, static.force_model, "model", 600),
    ]
    if static.n.size:
        where = {"x": drawing.packed(static.n), "y": drawing.packed(static.force)}
        points = {"type": "scatter", "mode": "markers", **where}
        marker = {"color": "#ffffff", "size": 8, "line": {"color": drawing.INK, "width": 1.5}}
        bars = {"type": "data", "array": drawing.packed(drawing.Z95 * static.sd), "thickness": 1.2, "width": 0}
        errors = {"error_y": {**bars, "color": drawing.INK}}
        traces.append({**points, "name": "measured", "marker": marker, **errors})
    lead = (
        "Circles: means of steady segments with 95 % bars. Line: the fitted curve with its 95 % band. Bars and band "
        "are statistical: the load cell's calibration, which moves all of it together, is not in them."
    )
    if static.force_quadratic is not None:
        n, force = static.n_model, static.force_quadratic
        traces.append(drawing.line_trace(n, force, "quadratic", 600, color=drawing.BEFORE, dash="dash"))
        lead += " Dashed: c1 n|n| + c2 n²."
    figure = drawing.single(traces, f"{static.abscissa}, part of full", "force [N]", hovermode="closest")
    title = f"orce against {static.abscissa.removesuffix(' n')}"
    plot = canvas.plot(figure, 380, f"Steady f{title}")
    return Section("static", f"F{title}", [Grid([plot], 320)], lead)
