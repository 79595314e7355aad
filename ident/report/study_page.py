"""Reports of a Monte Carlo study of estimators: HTML page, Markdown page with SVG pictures, and terminal tables.

All of them compare bias, variance and coverage of the estimates of each parameter with the aims of the study. Coverage
is the share of the 95 % intervals that contain the true value.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Literal

import numpy as np

from seatrial.daq.files import write_output
from seatrial.ident.report import drawing, formatting
from seatrial.ident.report.blocks import Canvas, Cell, Facts, Grid, Heading, Key, Plot, Prose, Section, Table
from seatrial.ident.report.drawing import BEFORE, MODEL, Budget, single
from seatrial.ident.report.page import Answer, compose
from seatrial.ident.results import AIMS, APART, BIAS, COVERAGE, VARIANCE, ModelStudy, ParameterStudy, StudyResult

Aims = Mapping[str, tuple[float, float]]
ROW_PX, REST_PX = 26, 56  # height of a parameter's row, and of the axis below
COLUMNS = (
    ("parameter", ""),
    ("true value", "num"),
    ("bias", "num"),
    ("variance / reported", "num"),
    ("variance / bound", "num"),
    ("coverage", "num"),
    ("at a bound", "num"),
    ("beyond the aim", ""),
)
PANELS: tuple[tuple[Number, str, float], ...] = (
    ("bias", "bias, standard deviations", 1.0),
    ("ratio", "variance / bound", 1.0),
    ("coverage", "coverage of 95 % intervals, %", 100.0),
)
# sizes in the SVG picture: width of the names, of a panel and of the gap; heights of row, title, axis and legend
NAMES_PX, PANEL_PX, GAP_PX, PICTURE_ROW_PX, TOP_PX, AXIS_PX, KEY_PX = 64, 250, 22, 20, 30, 24, 26
N_TICKS = 5
KEY = (("fine", "within the aim"), ("chance", "beyond the aim, perhaps by chance"), ("miss", "beyond the aim"))
Number = Literal["bias", "ratio", "coverage"]
HEAD = ("parameter", "n", "at bound", "bias, sd", "variance/reported", "variance/bound", "coverage", "")
PICTURES = "pictures"  # folder beside the Markdown page


def write_study_page(result: StudyResult, aims: Aims, path: Path) -> None:
    """Write a study's result as one HTML page that opens without a network. An existing file is replaced.

    Parameters
    ----------
    result : StudyResult
        Studies of one or more models.
    aims : mapping
        Lower and upper limit of the aim for ``bias`` [standard deviations], ``ratio`` (variance over the least possible
        variance) and ``coverage`` (0..1).
    path : Path
        HTML file to write.

    Raises
    ------
    OSError
        If ``path`` cannot be written.
    SeatrialError
        If ``path`` is a symbolic link, a folder or a special file.
    """
    canvas = Canvas(Budget())
    body = [_study_section(canvas, study, aims) for study in result.studies]
    opening = Section("top", "", [Prose(_introduction(aims), "lead")])
    made = Section(
        "made",
        "How it was made",
        [Facts([("command", result.command), ("seed", str(result.seed))], "made")],
    )
    page = compose(
        "Study of an estimator",
        Answer(result.answer),
        opening,
        [*(s for s in body if s.blocks), made],
        canvas.figures,
        version=result.seatrial,
        created=result.created,
    )
    write_output(path, page)


def _introduction(aims: Aims) -> str:
    """Return the introduction of the page of a Monte Carlo study: the aims for bias, variance and coverage in words."""
    bias, (low, high), coverage = aims["bias"][1], aims["ratio"], aims["coverage"]
    return (
        f"Aims: a bias below {bias:g} standard deviations, a variance of {low:g} to {high:g} times the least possible "
        f"variance, and 95 % intervals that contain the true value in {formatting.percent(coverage[0])} to "
        f"{formatting.percent(coverage[1])} of the fits. Each replicate is a fit to a simulated mission with its own "
        "noise."
    )


def _study_section(canvas: Canvas, study: ModelStudy, aims: Aims) -> Section:
    """Return the section of the study of one model: facts, plots of bias, variance and coverage, and their table.

    If the study has no parameters, because fewer than three replicates are usable, the section states that with
    advice. The plots are added to ``canvas``; ``aims`` are those of ``write_study_page``.
    """
    found, name = study.parameters, study.model
    if not found:
        left = f" ({study.left_out})" if study.left_out else ""
        words = (
            f"No parameter can be evaluated: fewer than three of {study.replicates} replicates are usable{left}. Give "
            "more --replicates, or longer missions (--seconds)."
        )
        return Section(f"study-{name}", name, [Prose(words)])
    kinds: tuple[tuple[Number, str, float], ...] = (
        ("bias", "bias [standard deviations]", 1.0),
        ("ratio", "variance / least possible variance", 1.0),
        ("coverage", "coverage of 95 % intervals [%]", 100.0),
    )
    plots = [_statistic_plot(canvas, found, key, title, factor, aims[key]) for key, title, factor in kinds]
    key = Key(
        [
            ("after", "within the aim; with 95 % interval of the study, the band is the aim"),
            ("diamond", "beyond the aim; an open diamond: perhaps by chance"),
        ]
    )
    return Section(
        f"study-{name}",
        f"{name}: {study.about}",
        [
            Facts(_labelled_facts(study)),
            Heading("Comparison with the aims"),
            key,
            Grid(plots, 290),
            Heading("Table"),
            Table(COLUMNS, [_table_cells(row) for row in found]),
        ],
    )


def _labelled_facts(study: ModelStudy) -> list[tuple[str, str]]:
    """Return (label, value) of the facts of the study of one model.

    They are the estimator, the numbers of replicates, of failed ones and of those that did not converge, and the CPU
    times if they are known.
    """
    facts = [
        ("estimator", study.estimator),
        ("replicates", str(study.replicates)),
        ("failed", str(study.failed)),
        ("did not converge", str(study.unconverged)),
    ]
    tasks = ((study.cpu_fit, "fit"), (study.cpu_simulation, "simulation"))
    times = [f"{1e3 * t:.0f} ms a {task}" for t, task in tasks if t is not None]
    return [*facts, *([("CPU time", ", ".join(times))] if times else [])]


def _statistic_plot(
    canvas: Canvas, found: Sequence[ParameterStudy], key: Number, title: str, factor: float, aim: tuple[float, float]
) -> Plot:
    """Return the plot of one statistic of every parameter with its 95 % interval; a shaded band marks the aim.

    A parameter whose statistic or interval is not finite has no mark.

    Parameters
    ----------
    canvas
        Collector of the figures, to which the figure is added.
    found
        Statistics of the parameters, from top to bottom; at least one.
    key
        Name of the statistic: ``bias``, ``ratio`` or ``coverage``.
    title
        Title of the axis.
    factor
        Factor from the statistic to the unit of the axis.
    aim
        Lower and upper limit of the aim, in the unit of the statistic.
    """
    intervals = factor * np.array([interval(row, key) for row in found])
    finite = np.all(np.isfinite(intervals), axis=1)
    value, low, high = intervals[finite].T
    place = np.arange(len(found))[::-1]
    marked = [row for row, shown in zip(found, finite, strict=True) if shown]
    verdicts = [verdict_of(row, key) for row in marked]
    color = [MODEL if verdict == "fine" else BEFORE for verdict in verdicts]
    symbol = [{"fine": "circle", "chance": "diamond-open", "miss": "diamond"}[verdict] for verdict in verdicts]
    bars = {
        "type": "data",
        "symmetric": False,
        "array": (high - value).tolist(),
        "arrayminus": (value - low).tolist(),
        "thickness": 1.4,
        "width": 0,
        "color": drawing.MEASURED,
    }
    trace = {
        "type": "scatter",
        "mode": "markers",
        "x": value.tolist(),
        "y": place[finite].tolist(),
        "error_x": bars,
        "text": [row.name for row in marked],
        "hovertemplate": "%{text}: %{x:.3g}<extra></extra>",
        "marker": {"color": color, "symbol": symbol, "size": 9, "line": {"width": 1.5}},
    }
    edges = [factor * a for a in aim]
    band = {
        "type": "rect",
        "x0": edges[0],
        "x1": edges[1],
        "y0": 0,
        "y1": 1,
        "yref": "paper",
        "layer": "below",
        "line": {"width": 0},
        "fillcolor": "rgba(0,114,178,0.12)",
    }
    names = {
        "tickmode": "array",
        "tickvals": place.tolist(),
        "ticktext": [row.name for row in found],
        "range": [-0.7, len(found) - 0.3],
        "automargin": True,
        "nticks": len(found),
    }
    least, most = float(min(*low, *edges)), float(max(*high, *edges))
    room = 0.06 * (most - least)
    along = {"range": [least - room, most + room], "nticks": 6}
    figure = single([trace], title, xaxis=along, yaxis=names, shapes=[band], hovermode="closest")
    return canvas.plot(figure, REST_PX + ROW_PX * len(found), f"{title} of every parameter")


def interval(row: ParameterStudy, key: Number) -> tuple[float, float, float]:
    """Return a statistic of a parameter, and the lower and upper end of its 95 % interval.

    Parameters
    ----------
    row
        Statistics of a parameter in a study.
    key
        Name of the statistic. ``bias``: bias of the estimates [standard deviations]. ``ratio``: variance of the
        estimates over the Cramér-Rao bound. ``coverage``: share of the 95 % intervals that contain the true value (0
        to 1).
    """
    if key == "bias":
        half = drawing.Z95 * row.bias_error
        return row.bias, row.bias - half, row.bias + half
    if key == "ratio":  # of the variance to the Cramér-Rao bound, not to the reported variance
        return row.bound_ratio, row.bound_ratio_low, row.bound_ratio_high
    return row.coverage, row.coverage_low, row.coverage_high


def verdict_of(row: ParameterStudy, key: Number) -> str:
    """Return the verdict on a statistic of a parameter, from the missed aims that the study lists.

    ``fine``: within the aim. ``chance``: beyond the aim, perhaps by chance. ``miss``: beyond the aim.

    Parameters
    ----------
    row
        Statistics of a parameter in a study, with its missed aims.
    key
        Name of the statistic: ``bias``, ``ratio`` (of variances) or ``coverage``.
    """
    word = {"bias": "bias", "ratio": "variance", "coverage": "coverage"}[key]
    misses = [miss for miss in row.misses if miss.startswith(word)]
    if not misses:
        return "fine"
    return "chance" if all("chance" in miss for miss in misses) else "miss"


def _table_cells(row: ParameterStudy) -> list[Cell | str]:
    """Return the table cells of one parameter for the HTML page of a study.

    They are name, true value, bias, variance over reported variance, variance over Cramér-Rao bound, coverage, number
    of estimates at a bound, and missed aims.
    """
    shown = [
        formatting.with_error(row.bias, row.bias_error),
        formatting.plain(row.ratio),
        _value_and_interval(row, "ratio", 1.0, 2),
        f"{_value_and_interval(row, 'coverage', 100.0, 1)} %",
        str(row.at_bound),
    ]
    value = f"{formatting.short(formatting.plain(row.truth, 4))} {formatting.typeset_unit(row.unit)}".strip()
    certain = [miss for miss in row.misses if "chance" not in miss]
    return [
        Cell(row.name, "symbol"),
        Cell(value, "num"),
        *(Cell(words, "num") for words in shown),
        Cell(", ".join(row.misses) or "–", "bad wide" if certain else "wide" if row.misses else "quiet"),
    ]


def _value_and_interval(row: ParameterStudy, key: Number, factor: float, digits: int) -> str:
    """Return a statistic of a parameter with its 95 % interval as text, ``value (low to high)``.

    ``key`` is the name of the statistic, and ``factor`` converts it to the shown unit. The numbers have ``digits``
    decimals. The text is a dash if one of them is not finite.
    """
    middle, low, high = (factor * value for value in interval(row, key))
    if not np.isfinite([middle, low, high]).all():
        return "–"
    return f"{middle:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


def picture(study: ModelStudy, aims: Aims) -> str:
    """Return an SVG picture of bias, variance and coverage of each parameter of a study.

    Parameters
    ----------
    study : ModelStudy
        Study of one model, with at least one parameter.
    aims : mapping
        Lower and upper limit of the aim for ``bias`` [standard deviations], ``ratio`` (variance over the least possible
        variance) and ``coverage`` (0..1).
    """
    found = study.parameters
    bottom = TOP_PX + PICTURE_ROW_PX * len(found)
    width, height = NAMES_PX + 3 * (PANEL_PX + GAP_PX), bottom + AXIS_PX + KEY_PX
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" '
        f'font-size="12" fill="{drawing.INK}" role="img">',
        f"<title>Bias, variance and coverage of {escape(study.model)}</title>",
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
    ]
    for k, row in enumerate(found):
        name = escape(row.name)
        parts.append(f'<text x="{NAMES_PX - 8}" y="{_row_middle(k) + 4}" text-anchor="end">{name}</text>')
    for k, (key, title, factor) in enumerate(PANELS):
        left = NAMES_PX + k * (PANEL_PX + GAP_PX)
        parts += _svg_panel(found, key, factor, aims[key], left, bottom)
        parts.append(f'<text x="{left + PANEL_PX / 2:g}" y="18" text-anchor="middle">{title}</text>')
    for k, (verdict, words) in enumerate(KEY):
        x, y = NAMES_PX + (0, 120, 370)[k], height - 10
        parts.append(f'{_svg_symbol(x, y - 4, verdict)}<text x="{x + 12}" y="{y}">{words}</text>')
    return "\n".join([*parts, "</svg>"]) + "\n"


def _svg_panel(
    found: Sequence[ParameterStudy], key: Number, factor: float, aim: tuple[float, float], left: int, bottom: int
) -> list[str]:
    """Return the SVG elements of a panel: one statistic of every parameter with its 95 % interval, and the aim.

    Dashed lines are the limits within which an ideal estimator is by chance (``by_chance``), for the median number of
    estimates of the parameters. A parameter whose statistic or interval is not finite has no mark.

    Parameters
    ----------
    found
        Statistics of the parameters, from top to bottom.
    key
        Name of the statistic: ``bias``, ``ratio`` or ``coverage``.
    factor
        Factor from the statistic to the unit of the axis.
    aim
        Lower and upper limit of the aim, in the unit of the statistic.
    left, bottom
        Left and lower edge of the panel in the picture [px].
    """
    table = factor * np.array([interval(row, key) for row in found])
    edges, chance = factor * np.array(aim), factor * np.array(by_chance(key, _median_count(found)))
    finite = np.all(np.isfinite(table), axis=1)
    least, most = min(*table[finite, 1], *edges, *chance), max(*table[finite, 2], *edges, *chance)
    room = 0.04 * (most - least)

    def x(value: float) -> str:
        """Return the horizontal position [px] in the picture of a value of the statistic, as text for SVG."""
        return f"{left + PANEL_PX * (value - least + room) / (most - least + 2 * room):.1f}"

    size = f'y="{TOP_PX}" height="{bottom - TOP_PX}"'
    parts = [
        f'<rect x="{x(edges[0])}" width="{float(x(edges[1])) - float(x(edges[0])):.1f}" {size} '
        f'fill="{drawing.MODEL}" fill-opacity="0.12"/>'
    ]
    for value in chance:
        parts.append(
            f'<line x1="{x(value)}" x2="{x(value)}" y1="{TOP_PX}" y2="{bottom}" stroke="{drawing.FAINT}" '
            'stroke-dasharray="4 3"/>'
        )
    parts.append(f'<rect x="{left}" width="{PANEL_PX}" {size} fill="none" stroke="{drawing.GRID}"/>')
    parts += _svg_axis(float(least), float(most), x, bottom)
    for k, (row, (value, low, high)) in enumerate(zip(found, table.tolist(), strict=True)):
        if finite[k]:
            y = _row_middle(k)
            parts.append(
                f'<line x1="{x(low)}" x2="{x(high)}" y1="{y}" y2="{y}" stroke="{drawing.MEASURED}" '
                f'stroke-width="1.4"/>{_svg_symbol(float(x(value)), y, verdict_of(row, key))}'
            )
    return parts


def by_chance(key: Number, n: int) -> tuple[float, float]:
    """Return the lower and upper limit between which a statistic of an ideal estimator is with 95 % probability.

    The ideal estimator is unbiased, attains the Cramér-Rao bound and reports its variance exactly. In a finite study
    its statistics still differ from these values by chance.

    Parameters
    ----------
    key
        Name of the statistic: ``bias`` [standard deviations], ``ratio`` (of variances) or ``coverage`` (0..1).
    n
        Number of replicates of the study; at least 2.
    """
    from scipy import stats  # imported here: it takes a second, and other reports load this module

    if key == "bias":
        return -drawing.Z95 / float(np.sqrt(n)), drawing.Z95 / float(np.sqrt(n))
    if key == "ratio":
        low, high = stats.chi2.ppf([0.025, 0.975], n - 1) / (n - 1)
    else:
        low, high = np.asarray(stats.binom.ppf([0.025, 0.975], n, 0.95)) / n
    return float(low), float(high)


def _median_count(found: Sequence[ParameterStudy]) -> int:
    """Return the median over the parameters of their numbers of estimates, the ``n`` of ``by_chance``.

    A median of half an integer is rounded down. ``found`` must not be empty.
    """
    return int(np.median([row.n for row in found]))


def _row_middle(k: int) -> int:
    """Return the vertical middle [px] of the row of the parameter with index ``k`` (from 0) in the SVG picture."""
    return TOP_PX + PICTURE_ROW_PX * k + PICTURE_ROW_PX // 2


def _svg_symbol(x: float, y: float, verdict: str) -> str:
    """Return the SVG symbol of the verdict on a statistic, with its middle at ``x``, ``y`` [px].

    ``fine`` (within the aim): a circle. ``miss`` (beyond the aim): a diamond. ``chance`` (beyond the aim, perhaps by
    chance): an open diamond.
    """
    if verdict == "fine":
        return f'<circle cx="{x:g}" cy="{y:g}" r="4" fill="{drawing.MODEL}"/>'
    fill = drawing.BEFORE if verdict == "miss" else "#ffffff"
    return f'<path d="M{x:g} {y - 6:g}l6 6-6 6-6-6z" fill="{fill}" stroke="{drawing.BEFORE}" stroke-width="1.6"/>'


def _svg_axis(least: float, most: float, x: Callable[[float], str], bottom: int) -> list[str]:
    """Return the SVG ticks and labels below a panel, at round numbers from ``least`` to ``most``.

    ``x`` converts a value to its horizontal position [px], and ``bottom`` is the lower edge of the panel [px].
    """
    raw = (most - least) / N_TICKS
    step = float(10.0 ** np.floor(np.log10(raw)))
    step *= next(s for s in (1, 2, 5, 10) if s * step >= raw)
    ticks = np.arange(np.ceil(least / step), np.floor(most / step) + 1) * step
    return [
        f'<line x1="{x(v)}" x2="{x(v)}" y1="{bottom}" y2="{bottom + 4}" stroke="{drawing.FAINT}"/>'
        f'<text x="{x(v)}" y="{bottom + 17}" text-anchor="middle" font-size="11">{round(v, 6) + 0.0:g}</text>'
        for v in ticks.tolist()
    ]


def write_study_docs(result: StudyResult, path: Path) -> None:
    """Write a study's result as a Markdown page, such as ``docs/study.md``, and SVG pictures of each model.

    The pictures are written into the folder ``pictures`` beside the page, which is made if it is missing. A model
    without parameters in the study has no picture. Existing files are replaced.

    Parameters
    ----------
    result
        Studies of one or more models.
    path
        Markdown file to write.

    Raises
    ------
    OSError
        If a file cannot be written.
    SeatrialError
        If the path of a file is a symbolic link, a folder or a special file.
    """
    (path.parent / PICTURES).mkdir(parents=True, exist_ok=True)
    for study in result.studies:
        if study.parameters:
            write_output(path.parent / _picture_path(study), picture(study, AIMS))
    write_output(path, page(result))


def _picture_path(study: ModelStudy) -> str:
    """Return the path of the SVG picture of the study of one model, relative to the Markdown page."""
    return f"{PICTURES}/study-{study.model}.svg"


def table(study: ModelStudy) -> list[tuple[str, ...]]:
    """Return the table of the study of one model: a tuple of texts for the header, then one for each parameter."""
    return [HEAD, *(_text_cells(r) for r in study.parameters)]


def _text_cells(r: ParameterStudy) -> tuple[str, ...]:
    """Return the cells of one parameter for the table of a study in a terminal or in Markdown, as texts.

    They are name, number of estimates, number of these at a bound, bias, variance over reported variance, variance over
    Cramér-Rao bound, coverage, and missed aims.
    """
    return (
        r.name,
        str(r.n),
        str(r.at_bound),
        f"{r.bias:+.2f} ± {r.bias_error:.2f}",
        f"{r.ratio:.2f}",
        f"{r.bound_ratio:.2f} ({r.bound_ratio_low:.2f} to {r.bound_ratio_high:.2f})",
        f"{100 * r.coverage:.1f} % ({100 * r.coverage_low:.1f} to {100 * r.coverage_high:.1f})",
        ", ".join(r.misses),
    )


def study_as_text(result: StudyResult) -> str:
    """Return the tables of all models of a study, and its answer, as text for a terminal.

    Before the table of a model stand its mission, its estimator and the number of replicates that are left out, if any.
    The columns are padded with spaces.
    """
    lines = []
    for study in result.studies:
        rows = table(study)
        width = [max(len(row[k]) for row in rows) for k in range(len(HEAD))]
        lines += ["", f"{study.model}, {study.method}: {study.about}", f"estimator: {study.estimator}"]
        lines += [f"left out of the table: {study.left_out}"] if study.left_out else []
        lines += [""]
        lines += ["  ".join(cell.ljust(w) for cell, w in zip(row, width, strict=True)).rstrip() for row in rows]
    return "\n".join([*lines[1:], "", result.answer, ""])


def page(result: StudyResult) -> str:
    """Return the text of the Markdown page of a study: the method in words, and a picture and table of each model.

    The pictures are links to the files that ``write_study_docs`` writes.
    """
    lines = [
        "# Monte Carlo study of the estimators",
        "",
        f"    {result.command}",
        "",
        "The data of each study are simulated from the model itself, with process noise, by the Heun method in plain "
        f"numpy (`seatrial.ident.estimation.stochastic_simulation`). Each fit starts within a factor "
        f"{2.718281828**APART:.1f} of the true values. Errors are in the coordinates of the estimator: the logarithm "
        "for positive parameters. Numbers in brackets are 95 % intervals of the statistics.",
        "",
        "- `bias, sd`: mean error divided by the standard deviation of the estimates, ± its standard error.",
        "- `variance/reported`: variance of the estimates divided by the mean of the variances that the fits reported.",
        "- `variance/bound`: variance of the estimates divided by the Cramér-Rao bound at the true values. For "
        "parameters near their bounds, the least variance replaces that bound (`seatrial.ident.studies.monte_carlo`).",
        "- `coverage`: share of the 95 % intervals that contain the true value. Intervals of estimates `at bound` are "
        "one-sided.",
        f"- The last column names the statistics beyond the aim (|bias| < {BIAS}, variance within "
        f"{100 * VARIANCE:.0f} %, coverage {100 * COVERAGE[0]:.0f}-{100 * COVERAGE[1]:.0f} %); `chance?` means that "
        "the interval of the statistic reaches into the aim.",
        "",
        "In the pictures, lines are the 95 % intervals and the light band is the aim. The dashed lines contain 95 % of "
        "the statistics of an ideal estimator with as many replicates (binomial distribution for the coverage).",
        "",
        "The estimator is given below each title (PE: prediction error, OE: output error). The page Glossary of the "
        "documentation defines these terms and the symbols of the dynamic parameters. Parameters `s_...` are "
        "diffusions of process noise, parameters `e_...` are standard deviations of measurement noise. Restricted "
        "likelihood is described in `seatrial.ident.estimation.restricted_likelihood`, the filter's second-order mean "
        "in `seatrial.ident.engine.ekf_graph`. "
        "Both are as in the commands.",
    ]
    for study in result.studies:
        head, *rows = table(study)
        lines += [
            "",
            f"## {study.model}, {study.method}",
            "",
            f"{study.about}; {study.estimator}; {study.replicates} replicates, {study.failed} failed, "
            f"{study.unconverged} did not converge; {_milliseconds(study.cpu_fit)} ms CPU per fit, "
            f"{_milliseconds(study.cpu_simulation)} ms per simulation.",
            "",
            *([f"![bias, variance and coverage of every parameter]({_picture_path(study)})", ""] if rows else []),
            "| " + " | ".join(head) + " |",
            "|" + "---|" * len(head),
            *("| " + " | ".join(r) + " |" for r in rows),
        ]
    return "\n".join(lines) + "\n"


def _milliseconds(seconds: float | None) -> str:
    """Return a time [s] as text in whole milliseconds. The text is a dash if the time is None."""
    return "–" if seconds is None else f"{1e3 * seconds:.0f}"
