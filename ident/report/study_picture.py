"""The picture of a Monte Carlo study beside its table: a dot a parameter for bias, variance and coverage, as SVG.

What a verdict is, shape says as well as colour (Okabe and Ito's).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from ident.report import drawing
from ident.report.access import Row, number, rows, text
from ident.report.study_page import interval, verdict_of

Array = NDArray[np.float64]
Aims = Mapping[str, tuple[float, float]]
PANELS = (("bias", "bias, standard deviations", 1.0), ("ratio", "variance / bound", 1.0),
          ("coverage", "coverage of 95 % intervals, %", 100.0))
NAMES_PX, PANEL_PX, GAP_PX, ROW_PX, TOP_PX, AXIS_PX, KEY_PX = 64, 250, 22, 20, 30, 24, 26
N_TICKS = 5
KEY = (("fine", "as wanted"), ("chance", "beyond the aim, perhaps by chance"), ("miss", "beyond the aim"))


def picture(study: Row, aims: Aims) -> str:
    """SVG of one of ``studies``; ``aims`` as for the page, low and high of each number."""
    found = rows(study, "parameters")
    bottom = TOP_PX + ROW_PX * len(found)
    width, height = NAMES_PX + 3 * (PANEL_PX + GAP_PX), bottom + AXIS_PX + KEY_PX
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" '
        f'font-size="12" fill="{drawing.INK}" role="img">',
        f"<title>Bias, variance and coverage of {escape(text(study, 'model'))}</title>",
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
    ]
    for k, row in enumerate(found):
        name = escape(text(row, "name"))
        parts.append(f'<text x="{NAMES_PX - 8}" y="{_middle(k) + 4}" text-anchor="end">{name}</text>')
    for k, (key, title, factor) in enumerate(PANELS):
        left = NAMES_PX + k * (PANEL_PX + GAP_PX)
        parts += _panel(found, key, factor, aims[key], left, bottom)
        parts.append(f'<text x="{left + PANEL_PX / 2:g}" y="18" text-anchor="middle">{title}</text>')
    for k, (verdict, words) in enumerate(KEY):
        x, y = NAMES_PX + (0, 120, 370)[k], height - 10
        parts.append(f'{_mark(x, y - 4, verdict)}<text x="{x + 12}" y="{y}">{words}</text>')
    return "\n".join([*parts, "</svg>"]) + "\n"


def _panel(
    found: Sequence[Row], key: str, factor: float, aim: tuple[float, float], left: int, bottom: int
) -> list[str]:
    """One number of every parameter with its own interval, over its aim."""
    table = factor * np.array([interval(row, key) for row in found])
    edges, luck = factor * np.array(aim), factor * np.array(by_chance(key, _n(found)))
    least, most = np.nanmin([*table[:, 1], *edges, *luck]), np.nanmax([*table[:, 2], *edges, *luck])
    room = 0.04 * (most - least)

    def x(value: float) -> str:
        return f"{left + PANEL_PX * (value - least + room) / (most - least + 2 * room):.1f}"

    size = f'y="{TOP_PX}" height="{bottom - TOP_PX}"'
    parts = [f'<rect x="{x(edges[0])}" width="{float(x(edges[1])) - float(x(edges[0])):.1f}" {size} '
             f'fill="{drawing.MODEL}" fill-opacity="0.12"/>']
    for value in luck:
        parts.append(f'<line x1="{x(value)}" x2="{x(value)}" y1="{TOP_PX}" y2="{bottom}" stroke="{drawing.FAINT}" '
                     'stroke-dasharray="4 3"/>')
    parts.append(f'<rect x="{left}" width="{PANEL_PX}" {size} fill="none" stroke="{drawing.GRID}"/>')
    parts += _axis(float(least), float(most), x, bottom)
    for k, (row, (value, low, high)) in enumerate(zip(found, table.tolist(), strict=True)):
        if np.isfinite([value, low, high]).all():
            y = _middle(k)
            parts.append(f'<line x1="{x(low)}" x2="{x(high)}" y1="{y}" y2="{y}" stroke="{drawing.MEASURED}" '
                         f'stroke-width="1.4"/>{_mark(float(x(value)), y, verdict_of(row, key))}')
    return parts


def by_chance(key: str, n: int) -> tuple[float, float]:
    """What holds 95 % of the biases [standard deviations], variance ratios or coverages that an estimator shows in
    ``n`` replicates when there is nothing wrong with it."""
    if key == "bias":
        return -drawing.Z95 / float(np.sqrt(n)), drawing.Z95 / float(np.sqrt(n))
    if key == "ratio":
        low, high = stats.chi2.ppf([0.025, 0.975], n - 1) / (n - 1)
    else:
        low, high = np.asarray(stats.binom.ppf([0.025, 0.975], n, 0.95)) / n
    return float(low), float(high)


def _n(found: Sequence[Row]) -> int:
    return int(np.median([number(row, "n") or 3 for row in found]))


def _middle(k: int) -> int:
    return TOP_PX + ROW_PX * k + ROW_PX // 2


def _mark(x: float, y: float, verdict: str) -> str:
    if verdict == "fine":
        return f'<circle cx="{x:g}" cy="{y:g}" r="4" fill="{drawing.MODEL}"/>'
    fill = drawing.BEFORE if verdict == "miss" else "#ffffff"
    return f'<path d="M{x:g} {y - 6:g}l6 6-6 6-6-6z" fill="{fill}" stroke="{drawing.BEFORE}" stroke-width="1.6"/>'


def _axis(least: float, most: float, x: Callable[[float], str], bottom: int) -> list[str]:
    """Round numbers below a panel."""
    raw = (most - least) / N_TICKS
    step = float(10.0 ** np.floor(np.log10(raw)))
    step *= next(s for s in (1, 2, 5, 10) if s * step >= raw)
    ticks = np.arange(np.ceil(least / step), np.floor(most / step) + 1) * step
    return [f'<line x1="{x(v)}" x2="{x(v)}" y1="{bottom}" y2="{bottom + 4}" stroke="{drawing.FAINT}"/>'
            f'<text x="{x(v)}" y="{bottom + 17}" text-anchor="middle" font-size="11">{round(v, 6) + 0.0:g}</text>'
            for v in ticks.tolist()]
