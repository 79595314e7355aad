"""Sections of parameters in a report page.

- Estimates with standard errors, changes by the added effects, and correlation of the estimates.
- Profile likelihoods with their 95 % intervals.
- Fisher information of each segment of the logs about each parameter, as a table and as a map over time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from seatrial.daq.errors import counted
from seatrial.ident.numerics import Array
from seatrial.ident.report import drawing, formatting
from seatrial.ident.report.blocks import (
    Canvas,
    Cell,
    Facts,
    Grid,
    Heading,
    Key,
    OnScreen,
    Plot,
    Prose,
    Section,
    Table,
    tabbed,
)
from seatrial.ident.results import (
    CommonErrorsRow,
    Correlation,
    FitSummary,
    InformationResult,
    InformedParameter,
    InputTrace,
    LogSpan,
    ParameterChange,
    ParameterRow,
    ProfileCurve,
    SegmentInformation,
    data_name,
)

SMALLEST_T = 1e-3  # smaller t statistics are shown as zero
FROM_PRIOR = (
    "From prior: share of the information on a parameter that is from its own prior. Masses and damping are in "
    "proportion to the thrust, so that the prior of its scale (c1) counts for them too."
)
MAX_NUMBERED = 14  # parameters; larger correlation matrices show their numbers on hover only


def parameters_section(
    canvas: Canvas,
    fit: FitSummary,
    changes: Sequence[ParameterChange] = (),
    common_errors: CommonErrorsRow | None = None,
    in_blocks: bool = False,
) -> Section:
    """Return the section of estimates: facts and table of the fit, changes by effects, and correlation.

    The table has columns for the share of the prior and the record only if a parameter has such an entry. A problem of
    an estimate follows its meaning; a long text about it is below the table.

    Parameters
    ----------
    canvas : Canvas
        Collector of the figures, to which the figure is added.
    fit : FitSummary
        Fit of the model; in a diagnosis, of the model with the added effects.
    changes : sequence of ParameterChange
        Parameters before and after the effects or the common errors of a diagnosis were added; empty for other fits.
        They have no table if nothing was added, so that both are the same.
    common_errors : CommonErrorsRow, optional
        Common errors of the model (small errors that every craft has), which get a table of their own.
    """
    blocks: list[Any] = _fit_facts(fit)
    table = fit.parameters
    if table:
        error = "± s.e. (statistical only)" if fit.scale.statistical_only else "± s.e."
        columns = [("parameter", ""), ("value", "num"), (error, "num"), ("95 %", "num"), ("t", "num"), ("unit", "")]
        columns += [("SNAME", "")] if any(map(_sname, table)) else []
        columns += [("origin", "")]
        extra = (("prior_share", "from prior", "num"), ("record", "record", ""))
        used = [item for item in extra if any(getattr(row, item[0]) is not None for row in table)]
        columns += [*((title, style) for _, title, style in used), ("meaning", "")]
        titles, keys = [t for t, _ in columns], [key for key, _, _ in used]
        blocks.append(Table(columns, [_parameter_cells(row, titles, keys) for row in table]))
        if "prior_share" in keys:
            blocks.append(Prose(FROM_PRIOR, "quiet"))
        for row in table:
            if row.flag and len(row.flag) > formatting.LONGEST_FLAG:
                where = f", {row.record}" if row.record else ""
                blocks.append(Prose(f"⚠ {row.name}{where}: {row.flag}"))
    blocks += (
        common_errors_blocks(common_errors, in_blocks)
        + _change_blocks(changes)
        + _correlation_blocks(canvas, fit.correlation, table)
    )
    return Section("parameters", "Parameters", blocks)


def common_errors_blocks(row: CommonErrorsRow | None, in_blocks: bool) -> list[Any]:
    """Return heading, sentence and table of the common errors; an empty list if ``row`` is None.

    Common errors are small errors that every craft has: sensor timing, mounting, hull form. The sentence has the gain
    of the likelihood by them; if it is unknown, it states that they were in the given model. The table has the
    estimates of their parameters. ``in_blocks``: whether blocks of time take the place of validation logs.
    """
    if row is None:
        return []
    columns, cells = (("parameter", ""), ("estimate ± s.e.", "num"), ("meaning", "")), list[list[Cell | str]]()
    for p in row.parameters:
        factor, unit = formatting.degrees_for(p.unit)
        value, se = formatting.scaled(factor, p.value, p.se)
        cells.append(
            [Cell(p.name, "strong"), Cell(formatting.with_error(value, se, unit), "num"), Cell(p.meaning, "wide")]
        )
    note = "small errors of sensors and hull form that every craft has, estimated together"
    words = "They were in the model that was given."
    if row.gain is not None and row.validation_gain is not None and row.t is not None:
        judging = data_name("validation", in_blocks)
        words = (
            f"Together they gain {formatting.plain(row.gain)} in 2 ln L of the estimation data with {row.df} "
            f"parameters, and {formatting.plain(row.validation_gain)} in ln L of the {judging} "
            f"(t = {formatting.plain(row.t, 2)})."
        )
    return [Heading("Common errors", note), Prose(words), Table(columns, cells)]


def _fit_facts(fit: FitSummary) -> list[Any]:
    """Return the labelled facts of a fit as a list of one block.

    They are model, method, convergence, log-likelihood, iterations, kind of standard errors and CPU time of this fit,
    which is a small part of that of a diagnosis. Facts without a value are left out, and so is a number of iterations
    that the message has.
    """
    methods = {"OE": "output error (OE)", "PE": "prediction error (PE)"}
    converged, message = "yes" if fit.converged else "no", fit.message
    log_likelihood = fit.log_likelihood
    errors = ["robust (sandwich): the residuals are autocorrelated"] * fit.coloured
    errors += ["statistical only: the scale of the forces is taken as exact"] * fit.scale.statistical_only
    facts = (
        ("Model", fit.model),
        ("Method", methods[fit.method]),
        ("Converged", f"{converged}: {message}" if message else converged),
        ("Log-likelihood", "" if log_likelihood is None else f"{log_likelihood:,.1f}".replace("-", "−")),
        (
            "Iterations of all fits",
            "" if f"in {counted(fit.iterations, 'iteration')}" in message else str(fit.iterations),
        ),
        ("Standard errors", "; ".join(errors)),
        ("CPU time of the fit", f"{formatting.plain(fit.cpu)} s"),
    )
    found = [(label, value) for label, value in facts if value]
    return [Facts(found)] if found else []


# The derivatives of SNAME (1950) and Fossen (2011) that the parameters of the vehicle models stand for.
SNAME = {
    "m_u": "m − X_u̇",
    "m_v": "m − Y_v̇",
    "m_r": "I_z − N_ṙ",
    "d_u": "−X_u",
    "d_v": "−Y_v",
    "d_r": "−N_r",
    "d_uu": "−X_|u|u",
    "d_vv": "−Y_|v|v",
    "d_rr": "−N_|r|r",
}


def _sname(row: ParameterRow) -> str:
    """Return the derivative of SNAME that a parameter stands for, also of a ratio to the thrust; empty without one."""
    name, _, divisor = row.name.partition("/")
    return f"{SNAME[name]}{' / ' * bool(divisor)}{divisor}" if name in SNAME else ""


def _parameter_cells(row: ParameterRow, titles: Sequence[str], extra: Sequence[str]) -> list[Cell | str]:
    """Return the table cells of one parameter: value, standard error, 95 % interval, t, origin and others.

    A missing standard error, interval or t is a dash. The interval is the value ± 1.96 standard errors, and ends at
    zero if the parameter cannot be negative.

    Parameters
    ----------
    row
        The parameter.
    titles
        Titles of the columns, of which ``SNAME`` may be missing.
    extra
        Names of further columns: ``prior_share``, ``record``.
    """
    factor, unit = formatting.degrees_for(row.unit)
    value, se = formatting.scaled(factor, row.value, row.se)
    shown, error = formatting.pair(value, se)
    ends = "–"
    if se is not None and error and (interval := row.interval(drawing.Z95)):
        low, high = (formatting.pair(factor * end, se)[0] if end else "0" for end in interval)
        ends = f"{low} to {high}"
    ratio = 0.0 if value is None or not se else value / se
    t = "–" if value is None or not se else formatting.plain(ratio if abs(ratio) > SMALLEST_T else 0.0, 2)
    cells: list[Cell | str] = [
        Cell(row.name, "symbol"),
        Cell(shown, "num"),
        Cell(error or "–", "num" if error else "num quiet"),
        Cell(ends, "num"),
        Cell(t, "num"),
        Cell(unit, "nowrap"),
    ]
    cells += [Cell(_sname(row), "nowrap")] if "SNAME" in titles else []
    cells.append(Cell(row.origin_in_table, "quiet" if row.free else ""))
    flag = row.flag or ""
    problem = f" ⚠ {flag if len(flag) <= formatting.LONGEST_FLAG else 'see below'}" if flag else ""
    more: dict[str, Cell | str] = {
        "prior_share": Cell(formatting.percent(row.prior_share), "num"),
        "record": row.record or Cell("all", "quiet"),
    }
    return [*cells, *(more[key] for key in extra), Cell(row.meaning + problem, "wide bad" if flag else "wide")]


def _change_blocks(table: Sequence[ParameterChange]) -> list[Any]:
    """Return heading and table of the parameters before and after effects or common errors were added.

    The list is empty without parameters, and if all are the same before and after because nothing was added.
    """
    if all((row.before, row.before_se) == (row.after, row.after_se) for row in table):
        return []
    columns = (("parameter", ""), ("before", "num"), ("after", "num"), ("unit", ""), ("change", "num"))
    note = "change in standard errors of the value before"
    why = (
        "The diagnosis added effects, or common errors, between both. The standard errors before are those of that fit "
        "alone. On the page of the fit that was diagnosed they can be several times as large, "
        "since they include by how much each missing effect may shift the estimate. The "
        "standard errors after include this for the candidates that still pass the score tests."
    )
    shown = Table(columns, [_change_cells(row) for row in table])
    return [Heading("Before and after", note), Prose(why), shown]


def _change_cells(row: ParameterChange) -> list[Cell | str]:
    """Return the table cells of one parameter before and after effects were added: values, unit and change.

    The change is in standard errors of the value before, or of the value after if the former is unknown or zero. If
    both are unknown, or there is no value after, it is a dash; without a value before it is ``new``. A change beyond
    1.96 standard errors is in bold.
    """
    factor, unit = formatting.degrees_for(row.unit)
    before, before_se, after, after_se = formatting.scaled(factor, row.before, row.before_se, row.after, row.after_se)
    se = before_se or after_se
    shift: Cell | str = Cell("–" if before is not None else "new", "num quiet")
    if before is not None and after is not None and se:
        size = (after - before) / se
        words = f"{'+' if size > 0 else '−' if size < 0 else ''}{abs(size):.1f} s.e."
        shift = Cell(words, "num strong" if abs(size) > drawing.Z95 else "num", float(np.clip(size / 6, -1, 1)))
    texts = [formatting.with_error(before, before_se), formatting.with_error(after, after_se)]
    return [Cell(row.name, "symbol"), *(Cell(words, "num") for words in texts), Cell(unit, "nowrap"), shift]


def _correlation_blocks(canvas: Canvas, correlation: Correlation, rows: Sequence[ParameterRow]) -> list[Any]:
    """Return heading, strongest pairs, and heat map of the correlation of the estimated parameters.

    The list is empty for fewer than two parameters. The map shows its numbers for up to 14 parameters, otherwise only
    on hover, and the map is not printed. It is added to ``canvas``. ``rows`` are the rows of the parameters, with the
    record of those that have a value for each record.
    """
    names, table = [_with_record(name, rows) for name in correlation.names], correlation.matrix
    if len(names) < 2:
        return []
    labels = [drawing.escaped(name) for name in names]
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
    if len(names) <= MAX_NUMBERED:
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
    strong = _strongest_pairs(names, table)
    lead = [Prose(f"Strongest: {strong}.", "quiet")] if strong else []
    matrix = Grid([plot], 320, "narrow" if len(names) > 7 else "small")
    words = "On the screen, the page also has the matrix of all correlations."
    shown = matrix if len(names) <= MAX_NUMBERED else OnScreen([matrix], words)
    return [Heading("Correlation of the estimates"), *lead, shown]


def _with_record(name: str, rows: Sequence[ParameterRow]) -> str:
    """Return the name of an estimate with its record in place of the number of the record: ``V_x, run1`` of V_x@0."""
    own, _, number = name.partition("@")
    records = [row.record for row in rows if row.name == own and row.record]
    return f"{own}, {records[int(number)]}" if number and int(number) < len(records) else name


def _strongest_pairs(names: Sequence[str], table: Array, n: int = 4) -> str:
    """Return the ``n`` pairs of parameters with the largest absolute correlation as text: ``m_u and d_u 0.93``.

    Pairs below 0.5 are left out; the text is empty if no pair is left. ``table`` is the correlation matrix
    (n_names, n_names), in which NaN counts as no correlation.
    """
    i, j = np.triu_indices(len(names), 1)
    size = np.nan_to_num(np.abs(table[i, j]))
    order = [k for k in np.argsort(-size)[:n] if size[k] >= 0.5]
    return ", ".join(f"{names[i[k]]} and {names[j[k]]} {table[i[k], j[k]]:.2f}".replace("-", "−") for k in order)


DROP_95 = 1.92  # drop of the log-likelihood that bounds the 95 % interval: chi-squared quantile over two
MAX_DROP = 2.6  # drop of the log-likelihood at the upper end of the plots


def profiles_section(canvas: Canvas, table: Sequence[ProfileCurve]) -> Section:
    """Return the section of profile likelihoods: a table of 95 % intervals, and a plot of each profile.

    A profile with fewer than three points, or without a finite value, has no plot. The section is empty without
    profiles.

    Parameters
    ----------
    canvas
        Collector of the figures, to which the plots are added.
    table
        Profile likelihood of each parameter.
    """
    if not table:
        return Section("profiles", "Profile likelihoods", [])
    columns = [("parameter", ""), ("value", "num"), ("95 % by profile", "num"), ("95 % by s.e.", "num"), ("unit", "")]
    noted = any(row.notes for row in table)
    shown = Table([*columns, ("note", "")] if noted else columns, [_profile_cells(row, noted) for row in table])
    blocks: list[Any] = [shown]
    plots = [plot for row in table if (plot := _profile_plot(canvas, row)) is not None]
    if plots:
        blocks += [
            Key(
                [
                    ("line", "profile likelihood"),
                    ("before", "quadratic approximation by the standard error"),
                    ("bar weak", "95 % interval"),
                ]
            ),
            Grid(plots, 240),
        ]
    lead = (
        "Drop of the log-likelihood over one parameter, with all others fitted again. A drop of 1.92 bounds the 95 % "
        "interval."
    )
    return Section("profiles", "Profile likelihoods", blocks, lead)


def _profile_cells(row: ProfileCurve, noted: bool) -> list[Cell | str]:
    """Return the table cells of a profile likelihood: name and value of the parameter, 95 % intervals, and unit.

    One interval is that by the profile, the other that by the standard error. ``noted`` adds the cell of notes.
    """
    factor, unit = formatting.degrees_for(row.unit)
    ends = ((row.low, row.high), (row.wald_low, row.wald_high))
    cells: list[Cell | str] = [
        Cell(row.name, "symbol"),
        Cell(formatting.plain(factor * row.value), "num"),
        *(Cell(interval(*formatting.scaled(factor, *pair)), "num") for pair in ends),
        Cell(unit, "nowrap"),
    ]
    return [*cells, Cell("; ".join(row.notes), "wide")] if noted else cells


def interval(low: float | None, high: float | None) -> str:
    """Return an interval from ``low`` to ``high`` as text: ``1.2 to 3.4``.

    An end of None is written as ``open``: the data do not bound the parameter on that side. If both ends are None, the
    text is a dash.
    """
    if low is None and high is None:
        return "–"
    ends = ["open" if end is None else formatting.plain(end) for end in (low, high)]
    return f"{ends[0]} to {ends[1]}"


def _profile_plot(canvas: Canvas, row: ProfileCurve) -> Plot | None:
    """Return the plot of a profile likelihood: drop of the log-likelihood over the parameter, with its 95 % interval.

    The parabola that follows from the standard error is added if the interval of the latter is known and contains the
    value. The shaded interval goes to the end of the profile on a side where it is open. The plot is added to
    ``canvas``. The result is None if the profile has fewer than three points, or no finite value.
    """
    value = row.value
    if row.grid.size < 3 or drawing.drawable(row.drop) is None:
        return None
    factor, unit = formatting.degrees_for(row.unit)
    x, drop = factor * row.grid, row.drop
    traces = [drawing.line_trace(x, drop, "profile", canvas.budget.points)]
    low, high = row.wald_low, row.wald_high
    if low is not None and high is not None and low < value < high:
        # parabola of the standard error, each side by its own end: for logarithmic parameters the two sides differ
        fine = np.linspace(x.min(), x.max(), 60)
        half = factor * np.where(fine < factor * value, value - low, high - value)
        traces.append(
            drawing.line_trace(
                fine,
                DROP_95 * ((fine - factor * value) / half) ** 2,
                "standard error",
                60,
                color=drawing.BEFORE,
                dash="dash",
            )
        )
    ends = [row.low, row.high]
    a, b = (x.min() if ends[0] is None else factor * ends[0]), (x.max() if ends[1] is None else factor * ends[1])
    traces.append(drawing.between(np.array([a, b]), np.zeros(2), np.full(2, DROP_95), opacity=0.1))
    name = row.name
    figure = drawing.single(traces, f"{name} [{unit}]" if unit else name, "drop", yaxis={"range": [0, MAX_DROP]})
    return canvas.plot(figure, 220, f"Profile likelihood of {name}", name)


TIME = "time [s]"
# shades of one colour, light to dark: they keep their order in grey print and for every kind of colour vision
SHADES = [[0.0, "#f4f6f8"], [0.25, "#c3ddee"], [0.5, "#7db8dc"], [0.75, "#2f8dc1"], [1.0, "#00466e"]]
ROW_PX, AXES_PX, LEFT_PX = 26, 104, 74  # height of a row, height of colour bar and axis, left margin


def information_section(result: InformationResult) -> Section:
    """Return the section with the table of the standard errors of the parameters from all logs.

    It also has the segment of a log that each standard error depends on most. The section is empty without parameters.
    """
    found = result.information.parameters
    columns = [
        ("parameter", ""),
        ("value", "num"),
        ("± from all logs", "num"),
        ("depends most on", ""),
        ("± without this segment", "num"),
        ("± from it alone", "num"),
    ]
    lead = (
        "Standard errors of a prediction-error fit to these logs, for the noise of the model. The current and the "
        "sensor offsets of each log are estimated too."
    )
    rows = [_information_row(p) for p in found]
    return Section("known", "Information of these logs", [Table(columns, rows)] if rows else [], lead)


def _information_row(p: InformedParameter) -> list[Cell | str]:
    """Return the table cells of one parameter: name, value, standard error, and its most important segment of a log.

    The last two cells are the standard errors without this segment (``unknown`` if no other segment informs the
    parameter) and from it alone. If the logs have no information (no standard error), these cells are dashes.
    """
    factor, unit = formatting.degrees_for(p.unit)
    name, shown = f"{p.name}  {p.meaning}{formatting.bracket(unit)}", Cell(formatting.plain(factor * p.value), "num")
    if p.se is None:
        return [name, shown, Cell("no information", "num"), "", Cell("–", "num"), Cell("–", "num")]
    se, alone = factor * p.se, None if p.alone is None else factor * p.alone
    without = "unknown" if p.weight is None else f"{formatting.plain(se * p.weight)} (× {formatting.plain(p.weight)})"
    return [
        name,
        shown,
        Cell(formatting.plain(se), "num"),
        segment_in_words(p),
        Cell(without, "num"),
        Cell(formatting.plain(alone), "num"),
    ]


def segment_in_words(segment: LogSpan) -> str:
    """Return record, interval of time and step of the mission of a segment of a log: ``run, 30 to 60 s (zigzag)``.

    The step is left out if it is unknown.
    """
    words = f"{segment.record}, {segment.t_from:.0f} to {segment.t_to:.0f} s"
    return f"{words} ({segment.what})" if segment.what else words


def segments_section(canvas: Canvas, result: InformationResult) -> Section:
    """Return the section with the map of the information that would be lost without each segment of a log.

    It has one tab for each log: the map over parameters and time, and the inputs below it. The section is empty if no
    segment has information.

    Parameters
    ----------
    canvas
        Collector of the figures, to which the maps are added.
    result
        Information of each segment of each log about each parameter.
    """
    tabs = []
    for record in dict.fromkeys(row.record for row in result.information.segments):
        found = [row for row in result.information.segments if row.record == record]
        inputs = [row for row in result.inputs if row.record == record]
        tabs.append((record, _record_blocks(canvas, result.information.names, found, inputs)))
    if not any(blocks for _, blocks in tabs):
        return Section("segments", "", [])
    lead = (
        "Share of a parameter's information that would be lost without a segment; dark is a large share. The share is "
        "1 − (standard error with the segment / standard error without it)². Information that other segments contain "
        "too is not lost."
    )
    return Section("segments", "Segment by segment", tabbed(tabs), lead)


def _record_blocks(
    canvas: Canvas, names: Sequence[str], found: Sequence[SegmentInformation], inputs: Sequence[InputTrace]
) -> list[Any]:
    """Return the blocks of one log: a map of the information lost without each segment, and the log's inputs below it.

    The map has a row for each parameter, and the same time axis as the figure of the inputs. The list is empty if no
    segment has information.

    Parameters
    ----------
    canvas
        Collector of the figures, to which the figures are added.
    names
        Names of the parameters, from top to bottom.
    found
        Segments of the log in the order of time. Those without information are left out of the map; the next segment
        with information is then drawn over their time too, except at the beginning of the log.
    inputs
        Inputs of the log.
    """
    good = [row for row in found if np.isfinite(row.lost).any()]
    if not good:
        return []
    record = good[0].record
    edges = np.array([good[0].t_from, *(row.t_to for row in good)])
    z = np.clip(np.column_stack([row.lost for row in good]), 0.0, 1.0)
    words = [[segment_in_words(row) for row in good]] * len(names)
    parameter_axis = {"autorange": "reversed", "type": "category", "dtick": 1}
    figure = drawing.single(
        [_lost_information_map(edges, z, names, words)],
        TIME,
        yaxis=parameter_axis,
        hovermode="closest",
        margin={"l": LEFT_PX, "r": 8, "t": 56, "b": 44},
    )
    label = f"Information lost without each segment, {record}"
    blocks: list[Any] = [Grid([canvas.plot(figure, ROW_PX * len(names) + AXES_PX, label)], 600)]
    panels = [
        drawing.Panel(
            formatting.titled(row.name) + formatting.bracket(row.unit),
            [drawing.line_trace(row.t, row.value, "input", canvas.budget.points, color=drawing.MEASURED)],
        )
        for row in inputs
    ]
    if panels:
        shown, height = drawing.stacked(panels, TIME, panel_height=70)
        shown["layout"]["margin"]["l"] = LEFT_PX  # aligns the time axis with that of the map
        blocks += [Prose("Inputs over the same time:", "quiet"), Grid([canvas.plot(shown, height, "Inputs")], 600)]
    return blocks


def _lost_information_map(
    edges: Array, z: Array, names: Sequence[str], words: Sequence[Sequence[str]]
) -> drawing.Trace:
    """Return the trace of a heat map of the share of information that is lost without each segment of a log.

    Parameters
    ----------
    edges
        Times [s] between which the segments lie, Array (n_segments + 1,).
    z
        Shares, 0 to 1, Array (n_parameters, n_segments). A share that is not finite has no colour.
    names
        Names of the parameters, from top to bottom.
    words
        Text of each field of the map on hover: a list for each parameter.
    """
    shown = [[None if not np.isfinite(v) else round(float(v), 4) for v in line] for line in z]
    texts = [[drawing.escaped(word) for word in line] for line in words]
    return {
        "type": "heatmap", "x": edges.round(3).tolist(), "y": [drawing.escaped(n) for n in names], "z": shown,
        "zmin": 0.0, "zmax": 1.0, "colorscale": SHADES, "xgap": 1, "ygap": 2, "text": texts, "hoverongaps": False,
        "hovertemplate": "%{y}: %{z:.0%} lost without<br>%{text}<extra></extra>",
        "colorbar": {"tickformat": ".0%", "thickness": 8, "outlinewidth": 0, "orientation": "h", "len": 0.4, "x": 1.0,
                     "xanchor": "right", "y": 1.0, "yanchor": "bottom", "nticks": 5,
                     "title": {"text": "lost without it", "side": "top"}},
    }  # fmt: skip
