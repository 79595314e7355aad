"""Sections of the runs in a report page.

They show logs and inputs, channels measured and predicted or simulated over time, and the track of the boat.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import msgspec
import numpy as np

from seatrial.ident.numerics import UNSTABLE, Array
from seatrial.ident.report import drawing, formatting
from seatrial.ident.report.blocks import Canvas, Cell, Grid, Key, Lines, Prose, Section, Table, tabbed
from seatrial.ident.report.record_tabs import (
    RecordTab,
    by_channel,
    joined,
    log_of_block,
    of_record,
    origin_lines,
    origin_words,
    record_tabs,
    roles_of,
    run_tabs,
)
from seatrial.ident.results import (
    DiagnosisResult,
    Dynamics,
    ErrorComparison,
    ErrorTable,
    FitResult,
    InputTrace,
    LogSummary,
    Trace,
    VehicleResult,
    disturbance_reason,
)

TIME = "time since the start of the log [s]"
INPUT_POINTS = 4  # times the points of another curve: the steps of an input need more than a smooth curve
MOST_INPUT_POINTS = 3000


def run_section(canvas: Canvas, logs: Sequence[LogSummary], inputs: Sequence[InputTrace]) -> Section:
    """Return the section of the logs (role, duration, rig, mission, origin, warnings) and of their inputs over time.

    The section is empty without logs and inputs.

    Parameters
    ----------
    canvas
        Collector of the figures, to which the figures are added.
    logs
        Logs of the result.
    inputs
        Inputs of the model over time, one for each record and input; may be empty.
    """
    columns = (("log", ""), ("role", ""), ("duration", "num"), ("rig", ""), ("mission", ""), ("SHA-256", ""))
    blocks: list[Any] = [Table(columns, [_log_cells(row) for row in logs])] if logs else []
    if places := origin_lines(logs):
        blocks.append(Lines(places))
    warnings = [f"{_log_name(row)}: {line}" for row in logs for line in row.warnings]
    if warnings:
        blocks.append(Lines(warnings, "warning"))
    # The inputs of the blocks of a log are parts of those of the log.
    of_logs = {row.record for row in inputs}
    whole = [row for row in inputs if log_of_block(row.record, (x.name for x in logs)) not in of_logs]
    tabs = record_tabs(whole, roles_of(logs))
    blocks += tabbed([(tab.title, _input_blocks(canvas, of_record(inputs, tab), tab)) for tab in tabs])
    return Section("run", "Runs and inputs", blocks)


def _log_name(row: LogSummary) -> str:
    """Return the name of a log; if it is empty, the last part of its path; if that is empty too, ``log``."""
    return row.name or row.path.replace("\\", "/").rsplit("/", 1)[-1] or "log"


def _log_cells(row: LogSummary) -> list[Cell | str]:
    """Return the table cells of one log: name, role, duration, rig, mission, first ten digits of the SHA-256.

    An unknown rig, mission or SHA-256 is a dash.
    """
    role = row.role
    return [
        Cell(_log_name(row), "strong"),
        Cell(role, f"badge {role}" if role in ("validation", "estimation") else ""),
        Cell(formatting.duration(row.duration), "num"),
        row.rig or "–",
        row.mission or "–",
        Cell(row.sha256[:10] or "–", "code"),
    ]


def _input_blocks(canvas: Canvas, inputs: Sequence[InputTrace], tab: RecordTab) -> list[Any]:
    """Return the figure of the inputs of one record over time, one panel for each unit, as a list of one block.

    The figure is added to ``canvas``. The list is empty if no input has finite values. ``tab`` has the title of the
    record for the description of the figure.
    """
    by_unit: dict[str, list[InputTrace]] = {}
    for row in inputs:
        by_unit.setdefault(row.unit, []).append(row)
    panels = []
    for unit, members in by_unit.items():
        factor, shown = formatting.degrees_for(unit)
        traces, names = [], []
        for i, row in enumerate(members):
            if drawing.drawable(row.value) is not None:
                color, dash = drawing.LINES[i % 6], ("solid", "dot")[i % 2]
                name = formatting.symbol(row.name) if len(members) > 1 else formatting.titled(row.name)
                value, limit = factor * row.value, min(INPUT_POINTS * canvas.budget.points, MOST_INPUT_POINTS)
                traces.append(drawing.step_trace(row.t, value, name, limit, color=color, dash=dash))
                names.append(f"{name} ({('solid', 'dotted')[i % 2]})" if len(members) > 1 else name)
        if traces:
            panels.append(drawing.Panel(" · ".join(names) + formatting.bracket(shown), traces))
    if not panels:
        return []
    figure, height = drawing.stacked(panels, TIME)
    return [Grid([canvas.plot(figure, height, f"Inputs over time, {tab.title}")], 320)]


def prediction_section(canvas: Canvas, result: FitResult) -> Section:
    """Return the section of the channels measured and predicted over the horizon, one tab for each record.

    The errors in the headline of the page are those of these predictions. A channel without predictions has only its
    measurements. The section is empty without finite values.

    Parameters
    ----------
    canvas
        Collector of the figures, to which the figures are added.
    result
        Result of a fit, with the predictions over the horizon.
    """
    seconds = result.horizon_seconds
    found = run_tabs(result.traces, roles_of(result.logs, result.traces), result.logs)
    tabs = [(tab.title, _prediction_blocks(canvas, result, of_record(result.traces, tab), tab)) for tab in found]
    if not any(blocks for _, blocks in tabs):
        return Section("prediction", "", [])
    compared = any(row.horizon_before is not None for row in result.traces)
    lead = (
        f"Each value is predicted from the filtered state {seconds:g} s earlier and the inputs since then. "
        f"The fit in the panel titles is over all records with the same role.{_block_sentence(found)}"
    )
    key = _legend(f"predicted {seconds:g} s ahead", compared)
    return Section("prediction", f"Predicted {seconds:g} s ahead against measured", [key, *tabbed(tabs)], lead)


def traces_section(canvas: Canvas, result: FitResult) -> Section:
    """Return the section of the channels measured and simulated, and of the track, one tab for each record.

    The section is empty if no channel and no track has finite values.

    Parameters
    ----------
    canvas
        Collector of the figures, to which the figures are added.
    result
        Result of a fit, with the simulations and tracks.
    """
    found = run_tabs([*result.traces, *result.track], roles_of(result.logs, result.traces), result.logs)
    tabs = [
        (
            tab.title,
            _simulation_blocks(canvas, result, of_record(result.traces, tab), tab) + _track_blocks(canvas, result, tab),
        )
        for tab in found
    ]
    if not any(blocks for _, blocks in tabs):
        return Section("traces", "", [])
    compared = any(row.before is not None for row in result.traces)
    moves = bool(result.track) or any(row.channel in ("psi", "x", "y") for row in result.traces)
    errors = ", so that small errors of speed and heading accumulate in the position" if moves else ""
    lead = (
        f"After the first 15 s, the simulation uses the inputs alone{errors}. The fit in the panel titles is over all "
        f"records with the same role.{_block_sentence(found)}"
    )
    return Section("traces", "Simulated against measured", [_legend("simulated", compared), *tabbed(tabs)], lead)


def _block_sentence(tabs: Sequence[RecordTab]) -> str:
    """Return the sentence on the blocks in time of a log, with a leading space; empty if no tab has blocks."""
    words = " A log in blocks is predicted and simulated anew in each block of time, by a fit to the other blocks."
    return words if any(tab.blocks for tab in tabs) else ""


def _legend(model: str, compared: bool) -> Key:
    """Return the legend of the measured curve and of the model's curve.

    ``model`` is the text for the model's curve, for example ``simulated``. ``compared`` adds the curve of the model
    before effects were added.
    """
    items = [("measured", "measured"), ("after", f"{model}, with 95 % interval")]
    return Key([*items, ("before", f"{model}, before the effects were added")] if compared else items)


@dataclass(frozen=True)
class _Curves:
    """Curves of the model for one channel of a record, in the unit of the channel. Gaps are NaN.

    Attributes
    ----------
    t : Array (n,)
        Times [s].
    model : Array (n,)
        Prediction over the horizon, or simulation.
    sd : Array (n,)
        Standard deviation of ``model``.
    before : Array (n,) or None
        The same as ``model`` by the model before effects were added; None if no models are compared.
    in_blocks : bool
        Whether the curves are those of blocks in time, with gaps between them.
    """

    t: Array
    model: Array
    sd: Array
    before: Array | None
    in_blocks: bool = False


def _prediction_blocks(canvas: Canvas, result: FitResult, rows: Sequence[Trace], tab: RecordTab) -> list[Any]:
    """Return the figure of one record with its channels measured and predicted over the horizon, as a list of blocks.

    Each panel has in its title the fit of the channel in per cent, over all records of the same role. The figure is
    added to ``canvas``. The list is empty without finite values. ``rows`` has the channels of the record, and ``tab``
    its title.
    """
    panels, channels = [], by_channel(rows)
    for row in map(joined, channels):
        curves = _Curves(row.t_horizon, row.horizon, row.sd_horizon, row.horizon_before, bool(tab.blocks))
        note = _fit_note(_errors_of(result, row.role).horizon.get(row.channel))
        if panel := _channel_panel(canvas, row, curves, note):
            panels.append(panel)
    found = _stacked(canvas, panels, f"Measured and predicted {result.horizon_seconds:g} s ahead, {tab.title}")
    wide = [(row, row.t_horizon, row.sd_horizon) for row in (_widest(c, lambda x: x.sd_horizon) for c in channels)]
    return [*found, *_wide_bands(wide, result.horizon_seconds, result), *_predicted_track(canvas, result, rows, tab)]


def _simulation_blocks(canvas: Canvas, result: FitResult, rows: Sequence[Trace], tab: RecordTab) -> list[Any]:
    """Return the figure of one record with its channels measured and simulated, as a list of blocks.

    Each panel has in its title the fit of the channel in per cent, over all records of the same role. A diverged
    simulation is drawn up to the time of its divergence, which is in the title instead. The simulation before effects
    were added is drawn as a whole. The figure is added to ``canvas``. The list is empty without finite values. ``rows``
    has the channels of the record, and ``tab`` its title.
    """
    panels, channels = [], by_channel(rows)
    for blocks in channels:
        note = _fit_note(_errors_of(result, blocks[0].role).simulation.get(blocks[0].channel))
        ends = [(row.diverged - row.t[0], row) for row in blocks if row.diverged is not None]
        if ends and len(blocks) > 1:
            note = f"simulation diverged in {len(ends)} of {len(blocks)} blocks"
        elif ends:
            note = f"simulation diverged after {ends[0][0]:.0f} s"
        row = joined([_until_divergence(block) for block in blocks])
        curves = _Curves(row.t, row.model, row.sd, row.before, bool(tab.blocks))
        if panel := _channel_panel(canvas, row, curves, note, simulated=True):
            panels.append(panel)
    found = _stacked(canvas, panels, f"Measured and simulated over time, {tab.title}")
    steady = [blocks for group in channels if (blocks := [row for row in group if row.diverged is None])]
    return [
        *found,
        *_wide_bands([(row, row.t, row.sd) for row in (_widest(c, lambda x: x.sd) for c in steady)], None, result),
    ]


def _until_divergence(row: Trace) -> Trace:
    """Return a channel whose simulation has gaps (NaN) from its divergence on."""
    if row.diverged is None:
        return row
    model, sd = (np.where(row.t < row.diverged, curve, np.nan) for curve in (row.model, row.sd))
    return msgspec.structs.replace(row, model=model, sd=sd)


def _widest(blocks: Sequence[Trace], sd: Callable[[Trace], Array]) -> Trace:
    """Return the block of a log with the largest standard deviation, which ``sd`` returns (n,) for a block."""
    return max(blocks, key=lambda row: float(np.max(sd(row), initial=0.0, where=np.isfinite(sd(row)))))


# Why the interval of a channel grows if no measurement corrects it
REASONS = {
    "x": "the position is the integral of the velocity, whose errors add up without a fix",
    "y": "the position is the integral of the velocity, whose errors add up without a fix",
    "psi": "the heading is the integral of the yaw rate, whose errors add up without a measured heading",
    "vx": "an error of the heading turns the velocity over ground",
    "vy": "an error of the heading turns the velocity over ground",
}
CHANCE = (
    "the model is directionally unstable at the speeds there, so that the motion depends on chance, as the side to "
    "which the boat turns"
)
SETTLING = 5.0  # s from the start of a simulation, in which a wide interval is not told
WIDE = 0.5  # an interval is wide if half of its width exceeds this part of the range of the measured values
# Times three quarters of all distances between neighbouring predictions of a position, beyond which two are not joined
FAR_APART = 3.0
USELESS = 5.0  # an interval is useless if its width exceeds so many ranges of the measured values, or a full turn
GAP = 5.0  # a gap is longer than this many median intervals of the samples


def _wide_bands(found: Sequence[tuple[Trace, Array, Array]], horizon: float | None, result: FitResult) -> list[Any]:
    """Return the sentences on wide intervals, one for each reason, as a list of one block; empty without any.

    ``found`` has the arguments of `wide_band` for each channel, and ``horizon`` is that of `wide_band`.
    ``result`` has the evidence of a missing effect.
    """
    forces = disturbance_reason(result)
    dynamics = result.dynamics if isinstance(result, (VehicleResult, DiagnosisResult)) else None
    speeds, rates = _forward_speeds(result), growth_over_speed(dynamics)
    by_reason: dict[str, list[str]] = {}
    for row, t, sd in found:
        chance = partial(_depends_on_chance, speeds.get(row.record), rates, horizon)
        if (wide := wide_band(row, t, sd, horizon, forces, chance)) is not None:
            block = log_of_block(row.record, (x.name for x in result.logs)) is not None
            of = f" of the block from {row.t[0]:.0f} to {row.t[-1]:.0f} s" if block else ""
            by_reason.setdefault(wide[1], []).append(wide[0] + of)
    lines = [f"Wide interval of {', '.join(places)}: {why}." for why, places in by_reason.items()]
    return [Lines(lines, "quiet")] if lines else []


def growth_over_speed(dynamics: Dynamics | None) -> tuple[Array, Array] | None:
    """Return forward speeds [m/s] and the growth rates [1/s] of the least stable motion there, both (n,), ascending.

    At rest the rate is zero, and so is that of a stable motion. The result is None if the fit does not show that the
    boat is directionally unstable.
    """
    if dynamics is None or dynamics.course is None or dynamics.course.stability != UNSTABLE:
        return None
    rates = {0.0: 0.0, dynamics.course.speed: dynamics.course.pole}
    rates |= {p.speed: float(np.max(p.real)) for p in dynamics.points if p.real.size and p.speed > 0.0}
    speeds = np.array(sorted(rates))
    return speeds, np.maximum([rates[speed] for speed in speeds.tolist()], 0.0)


def _forward_speeds(result: FitResult) -> dict[str, tuple[Array, Array]]:
    """Return times [s] and measured forward speeds [m/s] of each record that has them, by the name of the record.

    The speed is that of the channel ``u``, or else the velocity over ground along the heading.
    """
    by = {(row.record, row.channel): row for row in result.traces}
    found = {record: (row.t, row.measured) for (record, channel), row in by.items() if channel == "u"}
    for record in {name for name, channel in by if channel == "vx"} - set(found):
        rows = [by.get((record, name)) for name in ("vx", "vy", "psi")]
        seen = [(x.t[k], x.measured[k]) for x in rows if x is not None and (k := np.isfinite(x.measured)).any()]
        if len(seen) == len(rows):
            (t, north), east, heading = seen
            psi = np.interp(t, heading[0], np.unwrap(heading[1]))
            found[record] = (t, north * np.cos(psi) + np.interp(t, *east) * np.sin(psi))
    return found


def _depends_on_chance(
    measured: tuple[Array, Array] | None, rates: tuple[Array, Array] | None, horizon: float | None, at: float
) -> bool:
    """Return whether a deviation grows by a factor of e or more at the measured speeds before the time ``at`` [s].

    Parameters
    ----------
    measured
        Times [s] and measured forward speeds [m/s] of the record; None if they are unknown; the result is then False.
    rates
        Growth rates of the model over the speed (`growth_over_speed`); None: the model is not unstable.
    horizon
        Prediction horizon [s]. None: a simulation, from the start of the record.
    at
        Time [s].
    """
    if measured is None or rates is None:
        return False
    t, speed = measured
    inside = (t <= at) & (t >= (-np.inf if horizon is None else at - horizon)) & np.isfinite(speed)
    if inside.sum() < 2:
        return False
    return bool(np.trapezoid(np.interp(speed[inside], *rates), t[inside]) >= 1.0)


def wide_band(
    row: Trace,
    t: Array,
    sd: Array,
    horizon: float | None,
    forces: str,
    chance: Callable[[float], bool] = lambda _: False,
) -> tuple[str, str] | None:
    """Return where and why the 95 % interval of a channel is wide, as two texts; None if it is nowhere wide.

    The width of an interval that is wider than five ranges of the measured values, or than a full turn of an angle, is
    not stated: it says no more than that nothing is known. The time from which on there is no useful interval stands in
    its place.

    Parameters
    ----------
    row
        Channel of a record with its measurements.
    t, sd
        Times [s] (n,) and standard deviations (n,) of the predictions or of the simulation.
    horizon
        Prediction horizon [s]; None for a simulation.
    forces
        Reason for a channel that is no integral of another one: the text of `disturbance_reason`.
    chance
        Function that returns whether the motion depends on chance, given the time [s] at which the interval is widest,
        because the boat is directionally unstable. The reason then begins with it.

    Notes
    -----
    The reason is a gap in the samples of the channel just before the prediction starts, if there is one. Otherwise it
    is that of the channel (`REASONS`), or ``forces``.
    """
    seen = np.isfinite(row.measured)
    good = np.isfinite(sd)
    if not good.any() or seen.sum() < 2:
        return None
    factor, unit = formatting.degrees_for(row.unit)
    # Before that, the uncertainty is that of the initial state, which the figure hardly shows.
    settled = t >= t[0] + SETTLING if horizon is None and np.ptp(t) > 2.0 * SETTLING else np.ones(t.size, bool)
    half = drawing.Z95 * np.where(good & settled, sd, 0.0)
    k = int(np.argmax(half))
    spread = 2.0 * np.pi if row.angle else float(np.ptp(row.measured[seen]))
    if not half[k] > WIDE * spread:
        return None
    why = REASONS.get(row.channel) or (f"{CHANCE}. Besides, {forces}" if chance(float(t[k])) else forces)
    if horizon is not None:
        samples, start = row.t[seen], t[k] - horizon
        before = samples[samples <= start]
        last = float(before[-1]) if before.size else float(samples[0])
        if start - last > GAP * float(np.median(np.diff(samples))):
            why = f"the channel has no samples from {last:.0f} to {start:.0f} s"
    useless = np.flatnonzero(half > (np.pi if row.angle else 0.5 * USELESS * spread))
    if not useless.size:
        width = formatting.plain(float(factor * half[k]), 2)
        where = f"widest at {t[k]:.0f} s, ± {width} {unit}"
    elif horizon is None:
        where = f"no useful interval after {t[useless[0]]:.0f} s"
    else:
        where = f"no useful interval {horizon:g} s ahead, at {t[k]:.0f} s"
    return f"{formatting.named(row.channel)} ({where})", why


def _predicted_track(canvas: Canvas, result: FitResult, rows: Sequence[Trace], tab: RecordTab) -> list[Any]:
    """Return the figure of the track measured and predicted over the horizon, as a list of one block.

    The list is empty if the record has no positions with predictions. ``rows`` has the channels of the record, and
    ``tab`` its title. The figure is added to ``canvas``.
    """
    found = {(row.record, row.channel): row for row in rows}
    pairs = [(x, found[name, "y"]) for (name, channel), x in found.items() if channel == "x" and (name, "y") in found]
    pairs = [(x, y) for x, y in pairs if x.t.size == y.t.size and x.t_horizon.size == y.t_horizon.size]
    origin, limit = origin_words(result.logs, tab.name), canvas.budget.points // max(len(pairs), 1)
    traces, predicted = [], []
    for x, y in pairs:
        traces += _path_traces("measured", x.t, x.measured, y.measured, limit)
        traces += _path_traces("before", x.t_horizon, x.horizon_before, y.horizon_before, limit)
        predicted += _path_traces("model", x.t_horizon, x.horizon, y.horizon, limit)
    if not predicted:
        return []
    equal = {"scaleanchor": "x", "scaleratio": 1, "nticks": 7}
    axes = (f"east{origin} [m]", f"north{origin} [m]")
    figure = drawing.single([*traces, *predicted], *axes, hovermode="closest", yaxis=equal)
    title = f"Track measured and predicted {result.horizon_seconds:g} s ahead"
    return [Grid([canvas.plot(figure, 420, f"{title}, {tab.title}", f"{title}, north up")], 320, "narrow")]


def _errors_of(result: FitResult, role: str) -> ErrorTable:
    """Return the prediction errors of a result on the data of ``role``, ``estimation`` or ``validation``.

    They are those on the estimation data if there are no validation data, or for any other role.
    """
    estimation, validation = result.errors.estimation, result.errors.validation
    return validation if role == "validation" and validation is not None else estimation


def _fit_note(row: ErrorComparison | None) -> str:
    """Return the fit of one channel for the title of its panel: ``fit 87 %``, or ``fit 60 % → 87 %``.

    The second form is that before and after effects were added; the first one is used if both errors are the same,
    because nothing was added. An error of None is written as ``diverged``. The text
    is empty if ``row`` is None, or if the standard deviation of the measured channel is zero or unknown, so that it has
    no fit.
    """
    if row is None or not row.spread:
        return ""
    errors = (row.after,) if row.before is None or row.before == row.after else (row.before, row.after)
    return "fit " + " → ".join("diverged" if e is None else f"{100 * (1 - e / row.spread):z.0f} %" for e in errors)


def _stacked(canvas: Canvas, panels: Sequence[drawing.Panel], label: str) -> list[Any]:
    """Return the figure of the panels above each other as a list of blocks; an empty list without panels.

    A caption is added if the vertical range of any panel is limited, so that a part of a curve is outside. Panels of
    angles do not count. The figure is added to ``canvas``, with ``label`` as its description for screen readers.
    """
    if not panels:
        return []
    figure, height = drawing.stacked(panels, TIME)
    plots = [Grid([canvas.plot(figure, height, label)], 320)]
    return [*plots, Prose(drawing.CUT, "caption")] if drawing.cut(panels) else plots


def _channel_panel(
    canvas: Canvas, row: Trace, curves: _Curves, note: str, simulated: bool = False
) -> drawing.Panel | None:
    """Return the panel of one channel over time: measurements, curve of the model with 95 % band, curve before.

    The curve before is that of the model before effects were added. Angles are wrapped to half a turn about zero; those
    of a simulation are continuous. The result is None if there are no finite values.

    Parameters
    ----------
    canvas
        Collector of the figures, which has the largest number of points of a trace.
    row
        Channel of a record with its measurements.
    curves
        Curves of the model for the channel.
    note
        Text after the title; may be empty.
    simulated
        Whether the curves are a simulation, which may leave the samples by any angle. Its curves are continuous, so
        that the band can be read.
    """
    limit = canvas.budget.points
    factor, unit = formatting.degrees_for(row.unit)
    found = (drawing.drawable(a) for a in (row.measured, curves.model, curves.sd, curves.before))
    measured, model, sd, before = (None if a is None else factor * a for a in found)
    unwrapped = row.angle and simulated
    turn = 2 * np.pi * factor if row.angle and not unwrapped else None
    if unwrapped:
        measured, model, before = (
            None if a is None else drawing.continuous(a, 360.0) for a in (measured, model, before)
        )
        if measured is not None:
            model, before = (
                None if a is None else drawing.beside(curves.t, a, row.t, measured) for a in (model, before)
            )
    measured, model, before = (_wrapped_angle(a, turn) for a in (measured, model, before))
    traces = []
    if model is not None and sd is not None:
        traces.append(drawing.band(curves.t, model, drawing.Z95 * sd, limit, turn=turn, gaps=curves.in_blocks))
    if measured is not None:
        traces.append(drawing.dots(row.t, measured, "measured", limit, turn=turn))
    if before is not None:
        line = drawing.line_trace(curves.t, before, "before", limit, color=drawing.BEFORE, dash="dash", turn=turn)
        traces.append(line)
    if model is not None:
        traces.append(drawing.line_trace(curves.t, model, "model", limit, turn=turn))
    if not traces:
        return None
    edges = [] if model is None or sd is None else [model - drawing.Z95 * sd, model + drawing.Z95 * sd]
    frame = drawing.axis_limits([measured, model], [before, *edges])
    axis: dict[str, Any] = {"range": frame} if frame else {}
    if turn:
        axis = {"range": [-turn / 2, turn / 2], "tick0": 0, "dtick": turn / 4}
    if unwrapped:
        axis["dtick"] = drawing.angle_step(frame, [measured, model, before])
    title = formatting.titled(row.channel) + formatting.bracket(unit) + (f" · {note}" if note else "")
    return drawing.Panel(title, traces, axis)


def _wrapped_angle(angle: Array | None, turn: float | None) -> Array | None:
    """Return an angle wrapped to half a turn about zero. If ``angle`` or ``turn`` is None, return ``angle`` unchanged.

    Half a turn becomes minus half a turn. ``turn`` is a full turn in the unit of the angle, None for signals that are
    no angles.
    """
    return angle if angle is None or turn is None else np.mod(angle + turn / 2, turn) - turn / 2


def _track_blocks(canvas: Canvas, result: FitResult, tab: RecordTab) -> list[Any]:
    """Return the figure of the track of one record as a list of one block; empty without finite positions.

    It has the measured and the simulated track, and that simulated by the model before effects were added. ``tab`` is
    the tab of the record. The figure is added to ``canvas``.
    """
    rows, origin = of_record(result.track, tab), origin_words(result.logs, tab.name)
    traces: list[drawing.Trace] = []
    for style in ("measured", "before", "model"):
        for row in rows:
            x, y = getattr(row, f"x_{style}"), getattr(row, f"y_{style}")
            traces += _path_traces(style, None, x, y, canvas.budget.points // len(rows))
    if not traces:
        return []
    equal = {"scaleanchor": "x", "scaleratio": 1, "nticks": 7}
    figure = drawing.single(traces, f"east{origin} [m]", f"north{origin} [m]", hovermode="closest", yaxis=equal)
    return [Grid([canvas.plot(figure, 420, f"Track, {tab.title}", "Track, north up")], 320, "narrow")]


def _path_traces(
    style: str, t: Array | None, north: Array | None, east: Array | None, limit: int
) -> list[drawing.Trace]:
    """Return the trace of a track of at most ``limit`` points, and the trace of a marker at its start.

    ``style`` determines name, colour and width: ``measured``, ``before`` (model before effects were added) or
    ``model``. The list is empty if ``north`` or ``east`` [m] is None, or without finite positions. With the times ``t``
    [s] of the positions, the line has a gap where positions are missing. The line of a model then also has one where
    neighbouring predictions are far apart: they start from different states, and the boat has not moved between them.
    Without ``t`` the line has no gaps.
    """
    if north is None or east is None:
        return []
    good = np.isfinite(north) & np.isfinite(east)
    if not good.any():
        return []
    at = np.flatnonzero(good)[drawing.strided(int(good.sum()), limit)]
    line = {
        "measured": {"color": drawing.MEASURED, "width": 1.2},
        "before": {"color": drawing.BEFORE, "width": 1.6, "dash": "dash"},
        "model": {"color": drawing.MODEL, "width": 1.8},
    }[style]
    after = np.zeros(0, int)
    if t is not None and at.size > 2:
        interval, steps = np.diff(t[at]), np.hypot(np.diff(east[at]), np.diff(north[at]))
        far = steps > FAR_APART * np.quantile(steps, 0.75) if style != "measured" else np.zeros(steps.size, bool)
        after = np.flatnonzero(far | (interval > GAP * np.median(interval))) + 1
    coordinates = {"x": drawing.packed(np.insert(east[at], after, np.nan))}
    coordinates["y"] = drawing.packed(np.insert(north[at], after, np.nan))
    start = {"type": "scatter", "mode": "markers", "x": [float(east[at[0]])], "y": [float(north[at[0]])]}
    marker = {"symbol": "circle-open", "size": 9, "color": line["color"], "line": {"width": 2}}
    path = {"type": "scatter", "mode": "lines", "name": style, **coordinates, "line": line}
    return [path, {**start, "name": f"{style}, start", "marker": marker}]
