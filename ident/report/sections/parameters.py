"""Parameters: what was estimated and how well, what moved, and what goes with what."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ident.numerics import Array
from ident.report import drawing, formatting
from ident.report.blocks import Canvas, Cell, Facts, Grid, Heading, Prose, Section, Table
from ident.results import Correlation, FitSummary, ParameterChange, ParameterRow

MANY = 14  # parameters, above which the correlation's numbers show on hover only


def section(canvas: Canvas, fit: FitSummary, changes: Sequence[ParameterChange] = ()) -> Section:
    """Table of the fit, before and after, and the correlation."""
    blocks: list[Any] = _fit_facts(fit)
    table = fit.parameters
    if table:
        columns = [("parameter", ""), ("value", "num"), ("± s.e.", "num"), ("unit", ""), ("meaning", "")]
        extra = (("prior_share", "from prior", "num"), ("record", "record", ""), ("flag", "note", ""))
        used = [item for item in extra if any(getattr(row, item[0]) is not None for row in table)]
        columns += [(title, style) for _, title, style in used]
        blocks.append(Table(columns, [_row(row, [key for key, _, _ in used]) for row in table]))
    blocks += _moved(changes) + _correlation(canvas, fit.correlation)
    return Section("parameters", "Parameters", blocks)


def _fit_facts(fit: FitSummary) -> list[Any]:
    methods = {"OE": "output error (OE)", "PE": "prediction error (PE)"}
    converged, message = "yes" if fit.converged else "no", fit.message
    log_likelihood = fit.log_likelihood
    facts = (
        ("Model", fit.model),
        ("Method", methods[fit.method]),
        ("Converged", f"{converged}: {message}" if message else converged),
        ("Log-likelihood", "" if log_likelihood is None else f"{log_likelihood:,.1f}".replace("-", "−")),
        ("Iterations", str(fit.iterations)),
        ("CPU time", f"{formatting.plain(fit.cpu)} s"),
    )
    found = [(label, value) for label, value in facts if value]
    return [Facts(found)] if found else []


def _row(row: ParameterRow, extra: list[str]) -> list[Cell | str]:
    factor, unit = formatting.degrees_for(row.unit)
    value, se = formatting.scaled(factor, row.value, row.se)
    shown, error = formatting.pair(value, se)
    cells: list[Cell | str] = [
        Cell(row.name, "symbol"),
        Cell(shown, "num"),
        Cell(error or ("–" if row.free else row.origin), "num" if error else "num quiet"),
        Cell(unit, "nowrap"),
        Cell(row.meaning, "wide"),
    ]
    more: dict[str, Cell | str] = {
        "prior_share": Cell(formatting.percent(row.prior_share), "num"),
        "record": row.record or Cell("all", "quiet"),
        "flag": Cell(f"⚠ {row.flag}", "bad") if row.flag else "",
    }
    return cells + [more[key] for key in extra]


def _moved(table: Sequence[ParameterChange]) -> list[Any]:
    if not table:
        return []
    columns = (("parameter", ""), ("before", "num"), ("after", "num"), ("unit", ""), ("moved by", "num"))
    note = "in standard errors of the value before"
    return [Heading("Before and after the effects", note), Table(columns, [_moved_row(row) for row in table])]


def _moved_row(row: ParameterChange) -> list[Cell | str]:
    factor, unit = formatting.degrees_for(row.unit)
    before, before_se, after, after_se = formatting.scaled(factor, row.before, row.before_se, row.after, row.after_se)
    se = before_se or after_se
    shift: Cell | str = Cell("–" if before is not None else "new", "num quiet")
    if before is not None and after is not None and se:
        size = (after - before) / se
        words = f"{'+' if size > 0 else '−' if size < 0 else ''}{abs(size):.1f} s.e."
        shift = Cell(words, "num strong" if abs(size) > drawing.Z95 else "num", float(np.clip(size / 6, -1, 1)))
    texts_ = [formatting.with_error(before, before_se), formatting.with_error(after, after_se)]
    return [Cell(row.name, "symbol"), *(Cell(words, "num") for words in texts_), Cell(unit, "nowrap"), shift]


def _correlation(canvas: Canvas, correlation: Correlation) -> list[Any]:
    names, table = correlation.names, correlation.matrix
    if len(names) < 2:
        return []
    labels = [drawing.said(name) for name in names]
    heat: drawing.Trace = {
        "type": "heatmap",
        "x": labels,
        "y": labels,
        "z": [[round(float(v), 3) if np.isfinite(v) else None for v in line] for line in table],
        "zmin": -1,
        "zmax": 1,
        "xgap": 1,
        "ygap": 1,
        "colorscale": [[0, "#B34700"], [0.25, "#F0A878"], [0.5, "#FFFFFF"], [0.75, "#7DB8DE"], [1, "#005B93"]],
        "colorbar": {"thickness": 10, "len": 0.7, "outlinewidth": 0, "tickvals": [-1, -0.5, 0, 0.5, 1]},
        "hovertemplate": "%{y}, %{x}: %{z:.2f}<extra></extra>",
    }
    if len(names) <= MANY:
        heat |= {"texttemplate": "%{z:.1f}", "textfont": {"size": 9}}
    layout: drawing.Figure = {
        "hovermode": "closest",
        "xaxis": {"type": "category", "tickangle": -60, "automargin": True, "showgrid": False, "dtick": 1},
        "yaxis": {"type": "category", "autorange": "reversed", "automargin": True, "showgrid": False, "dtick": 1},
        "margin": {"l": 40, "r": 8, "t": 8, "b": 40},
    }
    for axis in ("xaxis", "yaxis"):
        layout[axis]["tickfont"] = {"size": 10 if len(names) <= 20 else 8}
    height = min(190 + 22 * len(names), 720)
    plot = canvas.plot({"data": [heat], "layout": layout}, height, "Correlation of the estimates")
    strong = _strongest(names, table)
    lead = [Prose(f"Strongest: {strong}.", "quiet")] if strong else []
    return [Heading("Correlation of the estimates"), *lead, Grid([plot], 320, "narrow" if len(names) > 7 else "small")]


def _strongest(names: Sequence[str], table: Array, n: int = 4) -> str:
    """The pairs that the data tell apart least."""
    i, j = np.triu_indices(len(names), 1)
    size = np.nan_to_num(np.abs(table[i, j]))
    order = [k for k in np.argsort(-size)[:n] if size[k] >= 0.5]
    return ", ".join(f"{names[i[k]]} and {names[j[k]]} {table[i[k], j[k]]:.2f}".replace("-", "−") for k in order)
