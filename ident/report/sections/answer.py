"""The answer first: what the effect removed, or the parameters that matter; thrust curve and noise in their kinds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ident.report import drawing, formatting
from ident.report.access import Row, array, flag, group, number, rows, text, texts
from ident.report.blocks import Canvas, Cell, Dumbbell, Dumbbells, EffectCard, Facts, Grid, Prose, Section, Table
from ident.report.sections.errors import horizon

KEY_PARAMETERS = 9


def section(canvas: Canvas) -> Section:
    """Without a title: it follows the answer itself."""
    result = canvas.result
    told = [text(result, "doubt"), *texts(result, "cautions")]
    blocks: list[Any] = [Prose(line, "callout") for line in told if line]
    if rows(result, "effects") or rows(result, "rounds"):
        blocks += headline(result) + [effect_card(effect) for effect in rows(result, "effects")]
    else:
        blocks += key_parameters(result)
    return Section("answer", "", blocks)


def headline(result: Row) -> list[Any]:
    """Free-running error before and after on validation data, else the best there is."""
    sets = (("validation", "free_run"), ("validation", "ten_seconds"), ("estimation", "free_run"))
    words = {"free_run": "free-running", "ten_seconds": f"over {horizon(result)}"}
    for data, kind in sets:
        table = group(group(group(result, "before_after"), data), kind)
        items = [(str(name), row) for name, row in table.items() if isinstance(row, Mapping) and _both(row)]
        if items:
            caption = (
                f"Error of the model {words[kind]} on {data} data, before → after "
                "(root mean square; the axis is relative to before, the thin line a 95 % interval)"
            )
            return [Dumbbells(_dumbbells(items), caption)]
    return []


def _both(row: Row) -> bool:
    return number(row, "before") is not None and number(row, "after") is not None


def _dumbbells(items: list[tuple[str, Row]]) -> list[Dumbbell]:
    ratios = [(number(row, "after") or 0.0) / max(number(row, "before") or 0.0, 1e-300) for _, row in items]
    widest = max([1.0, *ratios, *(number(row, "high") or 0.0 for _, row in items)])
    scale = 96.0 / min(widest, 2.5)  # percent of the track for a ratio of one
    return [_dumbbell(name, row, ratio, scale) for (name, row), ratio in zip(items, ratios, strict=True)]


def _dumbbell(name: str, row: Row, ratio: float, scale: float) -> Dumbbell:
    factor, unit = formatting.degrees_for(text(row, "unit"))
    before, after = (factor * (number(row, key) or 0.0) for key in ("before", "after"))
    low, high = number(row, "low"), number(row, "high")
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
        "same" if same else "better" if ratio < 1 else "worse",
    )


def _behind(criterion: float) -> str:
    """A rival may be ahead on the fitted data and yet not hold on the others."""
    if criterion < 0:
        return f"{formatting.plain(-criterion)} ahead, but not on the validation data"
    return f"{formatting.plain(criterion)} behind"


def effect_card(effect: Row) -> EffectCard:
    """Formula, parameters with standard errors, source, and the experiment that shows it."""
    parameters = []
    for row in rows(effect, "parameters"):
        factor, unit = formatting.degrees_for(text(row, "unit"))
        value, se = (None if v is None else factor * v for v in (number(row, "value"), number(row, "se")))
        parameters.append((text(row, "name"), formatting.with_error(value, se, unit), text(row, "meaning")))
    rivals = [
        text(row, "name")
        + (
            ""
            if number(row, "criterion_behind") is None
            else f" ({_behind(number(row, 'criterion_behind') or 0.0)})"
        )
        for row in rows(effect, "rivals")
    ]
    facts = (
        ("Acts on", text(effect, "place")),
        ("Source", text(effect, "source")),
        ("Shown by", text(effect, "experiment")),
        ("Rivals", ", ".join(rivals)),
        ("How sure", how_sure(effect)),
    )
    return EffectCard(
        text(effect, "title") or text(effect, "name"),
        text(effect, "name"),
        text(effect, "formula"),
        parameters,
        [(label, value) for label, value in facts if value],
        *_weight(number(effect, "weight")),
    )


def _weight(factor: float | None) -> tuple[str, str]:
    """How much larger the prediction error is without the effect (ident.diagnosis.importance): the figure, and the
    words after it."""
    if factor is None:
        return "", ""
    if factor >= 2.0:
        return f"{formatting.plain(factor)} times", "as large a prediction error without it"
    larger = "larger" if factor >= 1.0 else "smaller"
    return formatting.percent(abs(factor - 1.0)), f"{larger} prediction error without it"


def how_sure(effect: Row) -> str:
    """In words: a name that stands alone, or what speaks against it."""
    reasons = texts(effect, "reasons")
    certainty = text(effect, "certainty")
    if certainty == "resembles":
        others = [formatting.titled(name) for name in texts(effect, "not_excluded")]
        return "it resembles this; " + "; ".join(reasons + ([f"not excluded: {', '.join(others)}"] if others else []))
    return {"named": "nothing is left that this should explain, and no rival comes close",
            "unknown": "no known effect explains it; the curve is what the data draw"}.get(certainty, "")


def key_parameters(result: Row) -> list[Any]:
    """The free parameters of the dynamics, not those of the noise."""
    found = []
    for row in rows(group(result, "fit"), "parameters"):
        value, se = number(row, "value"), number(row, "se")
        if value is None or se is None or flag(row, "free") is False or "noise" in text(row, "meaning"):
            continue
        factor, unit = formatting.degrees_for(text(row, "unit"))
        found.append((text(row, "meaning") or text(row, "name"), _symbol(row, factor * value, factor * se, unit)))
    return [Facts(found[:KEY_PARAMETERS], "cards")] if found else []


def _symbol(row: Row, value: float, se: float, unit: str) -> str:
    return f"{text(row, 'name')} = {formatting.with_error(value, se, unit)}"


def static_section(canvas: Canvas) -> Section:
    """Steady force against shaft speed, measured and fitted."""
    static = group(canvas.result, "static")
    n, force, sd = (array(static, key) for key in ("n", "force", "sd"))
    model_n, model, model_sd = (array(static, key) for key in ("n_model", "force_model", "force_sd"))
    traces = []
    if model_n is not None and model is not None and model_n.size == model.size:
        if model_sd is not None and model_sd.size == model.size:
            traces.append(drawing.band(model_n, model, drawing.Z95 * model_sd, 600))
        traces.append(drawing.line(model_n, model, "model", 600))
    if n is not None and force is not None and n.size == force.size:
        points = {"type": "scatter", "mode": "markers", "x": drawing.packed(n), "y": drawing.packed(force)}
        marker = {"color": "#ffffff", "size": 8, "line": {"color": drawing.INK, "width": 1.5}}
        traces.append({**points, "name": "measured", "marker": marker})
        if sd is not None and sd.size == n.size:
            bars = {"type": "data", "array": drawing.packed(drawing.Z95 * sd), "thickness": 1.2, "width": 0}
            traces[-1]["error_y"] = {**bars, "color": drawing.INK}
    if not traces:
        return Section("static", "", [])
    quadratic = array(static, "force_quadratic")
    lead = "Circles: means of steady stretches with 95 % bars. Line: the fitted curve with its 95 % band."
    if quadratic is not None and model_n is not None and quadratic.size == model_n.size:
        style = {"color": drawing.BEFORE, "dash": "dash"}
        traces.append(drawing.line(model_n, quadratic, "quadratic", 600, **style))
        lead += " Dashed: c1 n|n| + c2 n²."
    unit = formatting.bracket(formatting.tidy(text(static, "n_unit")))
    along = text(static, "abscissa") or "shaft speed n"
    figure = drawing.single(traces, f"{along}{unit or ', part of full'}", "force [N]", hovermode="closest")
    title = f"orce against {along.removesuffix(' n')}"
    plot = canvas.plot(figure, 380, f"Steady f{title}")
    return Section("static", f"F{title}", [Grid([plot], 320)], lead)


def noise_section(canvas: Canvas) -> Section:
    """White noise and random walk of each channel, and whether that model holds."""
    found = rows(canvas.result, "noise")
    lines = [_noise_row(row) for row in found]
    columns = (("channel", ""), ("white noise", "num"), ("random walk", "num"), ("model holds", ""),
               ("predictable", "num"), ("p", "num"))
    plots = [_density(canvas, row) for row in found]
    grid = [Grid([p for p in plots if p], 320)] if any(plots) else []
    key = "Power spectral densities: grey measured, blue the fitted model."
    blocks = [Table(columns, lines), *([Prose(key, "quiet"), *grid] if grid else [])] if lines else []
    return Section("noise", "Noise of each channel", blocks)


def _noise_row(row: Row) -> list[Cell | str]:
    factor, unit = formatting.degrees_for(text(row, "unit"))
    cells: list[Cell | str] = [formatting.named(text(row, "channel"))]
    for key, shown in (("white", unit), ("walk", f"{unit}/√s" if unit else "1/√s")):
        value, se = (None if v is None else factor * v for v in (number(row, key), number(row, f"se_{key}")))
        cells.append(Cell(formatting.with_error(value, se, shown if value is not None else ""), "num"))
    accepted = flag(row, "accepted")
    verdict = {True: Cell("✓ yes", "good"), False: Cell("✗ no", "bad"), None: Cell("–")}[accepted]
    share = Cell(formatting.percent(number(row, "predictable"), 1), "num")
    return [*cells, verdict, share, Cell(formatting.probability(number(row, "p")), "num")]


def _density(canvas: Canvas, row: Row) -> Any:
    frequency, psd, model = (array(row, key) for key in ("frequency", "psd", "psd_model"))
    factor, unit = formatting.degrees_for(text(row, "unit"))
    traces = []
    for values, name in ((psd, "measured"), (model, "model")):
        if frequency is None or values is None or values.size != frequency.size:
            continue
        good = (frequency > 0) & (values > 0)
        x, y, limit = frequency[good], factor**2 * values[good], canvas.budget.points
        if name == "model":
            traces.append(drawing.line(x, y, name, limit))
        else:
            at = drawing.thinned(np.log(y), limit) if y.size else np.arange(0)
            traces.append(drawing.line(x[at], y[at], name, limit, color=drawing.FAINT))
            traces[-1]["line"]["width"] = 0.9
    if not traces:
        return None
    log = {"type": "log", "exponentformat": "power", "nticks": 6}
    square = f"({unit})²" if not unit.isalpha() else f"{unit}²"
    title = formatting.named(text(row, "channel"))
    shown = f"{title} [{square}/Hz]" if unit else f"{title} [1/Hz]"
    figure = drawing.single(traces, "frequency [Hz]", xaxis=_ticks(frequency), yaxis=log | {"automargin": True})
    return canvas.plot(figure, 230, f"Power spectral density of {title}", shown)


def _ticks(frequency: Any) -> dict[str, Any]:
    """A logarithmic axis with 1, 2 and 5 of each decade where it has few of them, else with its powers of ten."""
    there = frequency[frequency > 0]
    if not there.size:
        return {"type": "log"}
    low, high = np.log10(there.min()), np.log10(there.max())
    steps = (1, 2, 5) if high - low < 2.5 else (1,)
    values = [m * 10.0**k for k in range(int(np.floor(low)), int(np.ceil(high)) + 1) for m in steps]
    shown = [v for v in values if low <= np.log10(v) <= high]
    return {"type": "log", "tickvals": shown, "ticktext": [f"{v:g}" for v in shown]}
