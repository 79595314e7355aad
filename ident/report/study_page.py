"""The page of a Monte Carlo study: is the estimator to be believed, and in which parameter not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ident.report import drawing, wording
from ident.report.access import Row, number, rows, text, texts
from ident.report.blocks import Canvas, Cell, Facts, Grid, Heading, Key, Plot, Prose, Section, Table
from ident.report.drawing import BEFORE, MODEL, Budget, single
from ident.report.page import compose

Aims = Mapping[str, tuple[float, float]]
ROW_PX, REST_PX = 26, 56  # height of a parameter's row, and of the axis below
COLUMNS = (("parameter", ""), ("true value", "num"), ("bias", "num"), ("variance / reported", "num"),
           ("variance / bound", "num"), ("coverage", "num"), ("at a bound", "num"), ("misses", ""))


def write_study_page(result: Mapping[str, Any], aims: Aims, path: Path) -> None:
    """Write a study's result as one HTML page that opens without a network.

    ``aims``: what is wanted of bias (standard deviations), ratio (of variances) and coverage (0..1), low and high.
    Raises OSError where ``path`` cannot be written.
    """
    canvas = Canvas(result, Budget())
    body = [_study(canvas, study, aims) for study in rows(result, "studies")]
    opening = Section("top", "", [Prose(_lead(aims), "lead")])
    made = Section("made", "How it was made",
                   [Facts([("command", text(result, "command")), ("seed", text(result, "seed"))], "made")])
    page = compose("Study of an estimator", text(result, "answer"), opening,
                   [*(s for s in body if s.blocks), made], canvas.figures, version=text(result, "seatrial"),
                   created=text(result, "created"))
    path.write_text(page, encoding="utf-8", newline="\n")


def _lead(aims: Aims) -> str:
    bias, (low, high), coverage = aims["bias"][1], aims["ratio"], aims["coverage"]
    return (f"Wanted: a bias below {bias:g} standard deviations, a variance of {low:g} to {high:g} times the "
            f"least possible one, and 95 % intervals that hold the truth in {wording.percent(coverage[0])} to "
            f"{wording.percent(coverage[1])} of the fits. Each estimate is of a simulated mission with its own noise.")


def _study(canvas: Canvas, study: Row, aims: Aims) -> Section:
    found = rows(study, "parameters")
    name = text(study, "model")
    if not found:
        return Section(f"study-{name}", name, [Prose("No replicate can be judged.")])
    plots = [_forest(canvas, found, key, title, factor, aims[key]) for key, title, factor in (
        ("bias", "bias [standard deviations]", 1.0), ("ratio", "variance over the least possible", 1.0),
        ("coverage", "coverage of 95 % intervals [%]", 100.0))]
    key = Key([("after", "as wanted: estimate with its own 95 % interval; the band is the aim"),
               ("diamond", "diamonds miss the aim, open ones perhaps by chance")])
    return Section(f"study-{name}", f"{name}: {text(study, 'about')}",
                   [Facts(_facts(study)), Heading("Against what is wanted"), key, Grid(plots, 290),
                    Heading("The numbers"), Table(COLUMNS, [_row(row) for row in found])])


def _facts(study: Row) -> list[tuple[str, str]]:
    fit, simulation = number(study, "cpu_fit"), number(study, "cpu_simulation")
    facts = [("estimator", text(study, "estimator")), *((word, text(study, key)) for key, word in (
        ("replicates", "replicates"), ("failed", "failed"), ("unconverged", "did not converge")))]
    times = [f"{1e3 * t:.0f} ms a {what}" for t, what in ((fit, "fit"), (simulation, "simulation")) if t is not None]
    return [*facts, *([("CPU time", ", ".join(times))] if times else [])]


def _forest(
    canvas: Canvas, found: Sequence[Row], key: str, title: str, factor: float, aim: tuple[float, float]
) -> Plot:
    """One number of every parameter with its own interval, against the aim."""
    value, low, high = factor * np.array([interval(row, key) for row in found]).T
    place = np.arange(len(found))[::-1]
    verdicts = [verdict_of(row, key) for row in found]
    color = [MODEL if verdict == "fine" else BEFORE for verdict in verdicts]
    symbol = [{"fine": "circle", "chance": "diamond-open", "miss": "diamond"}[verdict] for verdict in verdicts]
    bars = {"type": "data", "symmetric": False, "array": (high - value).tolist(), "arrayminus": (value - low).tolist(),
            "thickness": 1.4, "width": 0, "color": drawing.MEASURED}
    trace = {"type": "scatter", "mode": "markers", "x": value.tolist(), "y": place.tolist(), "error_x": bars,
             "text": [text(row, "name") for row in found], "hovertemplate": "%{text}: %{x:.3g}<extra></extra>",
             "marker": {"color": color, "symbol": symbol, "size": 9, "line": {"width": 1.5}}}
    edges = [factor * a for a in aim]
    band = {"type": "rect", "x0": edges[0], "x1": edges[1], "y0": 0, "y1": 1, "yref": "paper", "layer": "below",
            "line": {"width": 0}, "fillcolor": "rgba(0,114,178,0.12)"}
    names = {"tickmode": "array", "tickvals": place.tolist(), "ticktext": [text(row, "name") for row in found],
             "range": [-0.7, len(found) - 0.3], "automargin": True, "nticks": len(found)}
    least, most = float(np.nanmin([*low, edges[0]])), float(np.nanmax([*high, edges[1]]))
    room = 0.06 * (most - least)
    along = {"range": [least - room, most + room], "nticks": 6}
    figure = single([trace], title, xaxis=along, yaxis=names, shapes=[band], hovermode="closest")
    return canvas.plot(figure, REST_PX + ROW_PX * len(found), f"{title} of every parameter")


def interval(row: Row, key: str) -> tuple[float, float, float]:
    """A parameter's bias, ratio or coverage with the ends of its own 95 % interval; NaN where there is none."""
    column = "bound_ratio" if key == "ratio" else key  # the variance is judged by what is possible
    value = number(row, column)
    middle = np.nan if value is None else value
    if key == "bias":
        half = drawing.Z95 * (number(row, "bias_error") or 0.0)
        return middle, middle - half, middle + half
    ends = (number(row, f"{column}_low"), number(row, f"{column}_high"))
    low, high = (middle if end is None else end for end in ends)
    return middle, low, high


def verdict_of(row: Row, key: str) -> str:
    """``fine``, ``chance`` (beyond the aim, but perhaps by chance) or ``miss``."""
    word = {"bias": "bias", "ratio": "variance", "coverage": "coverage"}[key]
    misses = [miss for miss in texts(row, "misses") if miss.startswith(word)]
    if not misses:
        return "fine"
    return "chance" if all("chance" in miss for miss in misses) else "miss"


def _row(row: Row) -> list[Cell | str]:
    shown = [wording.with_error(number(row, "bias"), number(row, "bias_error")),
             wording.plain(number(row, "ratio")), _between(row, "ratio", 1.0, 2),
             f"{_between(row, 'coverage', 100.0, 1)} %", text(row, "at_bound")]
    value = f"{wording.short(wording.plain(number(row, 'truth'), 4))} {wording.tidy(text(row, 'unit'))}".strip()
    misses = texts(row, "misses")
    sure = [miss for miss in misses if "chance" not in miss]
    return [Cell(text(row, "name"), "symbol"), Cell(value, "num"), *(Cell(words, "num") for words in shown),
            Cell(", ".join(misses) or "–", "bad wide" if sure else "wide" if misses else "quiet")]


def _between(row: Row, key: str, factor: float, digits: int) -> str:
    middle, low, high = (factor * number_ for number_ in interval(row, key))
    return f"{middle:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"
