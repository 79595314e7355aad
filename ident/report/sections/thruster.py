"""Sections of a thruster's report page: steady-state table, efficiency, steps of the shaft, and its Bode plot."""

from __future__ import annotations

from typing import Any

import numpy as np

from seatrial.ident.characterisation import newtons_per_watt
from seatrial.ident.numerics import Array
from seatrial.ident.report import drawing, formatting
from seatrial.ident.report.blocks import Canvas, Cell, Grid, Heading, Lines, Plot, Prose, Section, Table
from seatrial.ident.report.bode import DECIBEL, FREQUENCY, frequency_axis, gain_traces, phase_axis, phase_traces
from seatrial.ident.results import ShaftResponse, SteadyBench, ThrusterResult, Trace

STEPS, BEFORE_S, AFTER_S = 6, 0.5, 2.5  # number of enlarged steps, and time shown before and after each [s]
HELD_S = 1.5  # least time after an enlarged step in which the command is constant [s]
LEAST_STEP = 0.1  # smallest step of the command that is enlarged, as a part of full


def steady_section(canvas: Canvas, result: ThrusterResult) -> Section:
    """Return the section of the steady states: plots over the command or the shaft speed, and the table.

    Force and shaft speed are plotted over the command; power, efficiency and torque over the shaft speed. Quantities
    that were not measured have no plot, except the shaft speed. The section is empty if no command was held. The plots
    are added to ``canvas``.
    """
    table = result.steady
    if table is None:
        return Section("steady", "", [])
    command = ("command, part of full", table.command)
    plots = []
    if np.isfinite(table.force).any():
        plots.append(_points(canvas, *command, table.force, "force [N]", "Force against command"))
    shown = ("shaft speed n, part of full", table.n)
    if table.rpm_max is not None:
        shown = ("shaft speed [rev/min]", table.rpm_max * table.n)
    plots.append(_points(canvas, *command, shown[1], shown[0], "Shaft speed against command"))
    if np.isfinite(table.power).any():
        plots.append(_points(canvas, *shown, table.power, "electrical power [W]", "Electrical power"))
        grams = formatting.GRAMS_PER_NEWTON * newtons_per_watt(table.n, table.force, table.power)
        if np.isfinite(grams).any():
            plots.append(_points(canvas, *shown, grams, "thrust / power [g/W]", "Efficiency"))
    if np.isfinite(table.torque).any():
        plots.append(_points(canvas, *shown, table.torque, "torque [N m]", "Torque"))
    notes = [f"Electrical power: {table.power_formula}."] if table.power_formula else []
    if table.expo is not None:
        notes.append(
            f"ArduPilot: MOT_THST_EXPO = {table.expo:.2f} (ardupilot.param), from the steady forward commands. "
            "Set it to 0 again before seatrial drives the thrusters."
        )
    notes.append(
        "For other programs: steady.csv has this table"
        + (", and lookup.csv the command for each force." if result.static is not None else ".")
    )
    lead = "Means over the second half of each command that was held for 1.6 s or longer, and over at least 0.6 s."
    if words := _offset_sentence(table):
        lead += f" {words}"
    blocks = [Grid(plots, 260), _steady_table(table), Lines(notes, "quiet")]
    return Section("steady", "Steady states", blocks, lead)


def _offset_sentence(table: SteadyBench) -> str:
    """Return the sentence on the offset of the load cell, which the forces of the table are without; may be empty."""
    if table.offset is None:
        return ""
    by_log = dict(zip(table.log, (formatting.plain(float(x), 3) for x in table.offset), strict=True))
    same = len(set(by_log.values())) == 1
    values = [f"{x} N" for x in by_log.values()][:1] if same else [f"{x} N in {name}" for name, x in by_log.items()]
    return f"The force is the measured one less the fitted offset of the load cell: {', '.join(values)}."


def _points(canvas: Canvas, x_title: str, x: Array, y: Array, y_title: str, title: str) -> Plot:
    """Return the plot of the steady values ``y`` over ``x`` as circles, and add it to ``canvas``."""
    good = np.isfinite(x) & np.isfinite(y)
    marker = {"color": "#ffffff", "size": 7, "line": {"color": drawing.MODEL, "width": 1.6}}
    points = {"x": drawing.packed(x[good]), "y": drawing.packed(y[good]), "name": title, "marker": marker}
    trace = {"type": "scatter", "mode": "markers", **points}
    figure = drawing.single([trace], x_title, y_title, hovermode="closest")
    return canvas.plot(figure, 260, title, title)


def _steady_table(table: SteadyBench) -> Table:
    """Return the steady-state table. Columns of quantities that were not measured are left out."""
    newtons = newtons_per_watt(table.n, table.force, table.power)
    columns: list[tuple[str, Array, int]] = [("command", table.command, 3), ("shaft speed n", table.n, 3)]
    if table.rpm_max is not None:
        columns.append(("rev/min", table.rpm_max * table.n, 4))
    columns += [("force [N]", table.force, 4), ("± s.e.", table.force_se, 2), ("voltage [V]", table.voltage, 4)]
    columns += [("current [A]", table.current, 3), ("power [W]", table.power, 3), ("N/W", newtons, 3)]
    columns += [("g/W", formatting.GRAMS_PER_NEWTON * newtons, 3), ("torque [N m]", table.torque, 3)]
    used = [column for column in columns if np.isfinite(column[1]).any()]
    rows = [
        [Cell(formatting.plain(float(values[i]), digits), "num") for _, values, digits in used]
        for i in range(table.command.size)
    ]
    return Table([(title, "num") for title, _, _ in used], rows)


def shaft_section(canvas: Canvas, result: ThrusterResult) -> Section:
    """Return the section of the shaft's dynamics: its largest steps, enlarged, and its Bode plot.

    The section is empty without both. The plots are added to ``canvas``.
    """
    blocks: list[Any] = []
    steps = _step_plots(canvas, result)
    if steps:
        blocks += [
            Heading("Steps", "the largest steps of the command; grey: measured, blue: simulated, dotted: command")
        ]
        blocks.append(Grid(steps, 240))
    if result.shaft_response is not None:
        blocks += [Heading("Bode plot", "shaft speed against command")]
        blocks.append(Grid(_bode_plots(canvas, result.shaft_response), 320))
        if result.shaft_response.frequency_measured.size:
            blocks.append(
                Prose("Line: model with its dead time. Circles: measured, where the log determines it.", "caption")
            )
    return Section("shaft", "Dynamics of the shaft", blocks)


def _step_plots(canvas: Canvas, result: ThrusterResult) -> list[Plot]:
    """Return plots of the largest steps of the command, with the measured and simulated shaft speed.

    There are at most six plots. The largest steps of each record are chosen, of at least 10 % of full command, and more
    than three seconds apart. The plots are in the order of the records and of time. The command is constant for 0.5 s
    before and for 1.5 s after each step.
    """
    plots = []
    for row in result.traces:
        command = next((i for i in result.inputs if i.record == row.record and i.name.startswith("n_cmd")), None)
        if row.channel != "n" or command is None or command.t.size < 2 or not row.t.size:
            continue
        size = np.abs(np.diff(command.value))
        chosen: list[int] = []
        for k in np.argsort(-size, kind="stable"):
            if len(chosen) == STEPS or size[k] < LEAST_STEP:
                break
            at = command.t[k + 1]
            moved = command.t[1:][size > 0.0]
            if ((moved > at - BEFORE_S) & (moved < at + HELD_S) & (moved != at)).any():
                continue
            if row.t[0] + BEFORE_S <= at <= row.t[-1] - AFTER_S and all(
                abs(at - command.t[j + 1]) > BEFORE_S + AFTER_S for j in chosen
            ):
                chosen.append(int(k))
        plots += [_step_plot(canvas, row, command.t, command.value, k) for k in sorted(chosen)]
    return plots[:STEPS]


def _step_plot(canvas: Canvas, row: Trace, t: Array, command: Array, k: int) -> Plot:
    """Return the plot of the step of the command after its sample ``k``, with the shaft speed of the trace ``row``.

    ``t`` and ``command`` (n,) are the times [s] and values of the command, which holds until the next sample.
    """
    start = float(t[k + 1])
    window = (row.t >= start - BEFORE_S) & (row.t <= start + AFTER_S)
    edges = np.union1d(row.t[window], t[(t >= start - BEFORE_S) & (t <= start + AFTER_S)])
    held = command[np.clip(np.searchsorted(t, edges, side="right") - 1, 0, None)]
    line = drawing.line_trace(edges - start, held, "command", 1000, color=drawing.FAINT, dash="dot")
    line["line"]["shape"] = "hv"
    traces = [
        line,
        drawing.dots(row.t[window] - start, row.measured[window], "measured", 1000),
        drawing.line_trace(row.t[window] - start, row.model[window], "simulated", 1000),
    ]
    figure = drawing.single(traces, "time after the step [s]", xaxis={"range": [-BEFORE_S, AFTER_S]})
    title = f"{formatting.plain(float(command[k]), 2)} → {formatting.plain(float(command[k + 1]), 2)} at {start:.1f} s"
    return canvas.plot(figure, 220, f"Step of the command, {title}", title)


def _bode_plots(canvas: Canvas, response: ShaftResponse) -> list[Plot]:
    """Return the plots of gain [dB] and phase [deg] over the frequency [Hz] of the shaft's response."""
    plots = []
    f, at, name = response.frequency, response.frequency_measured, "model"
    gain = DECIBEL * np.log(np.maximum(response.gain_measured, 1e-12))
    measured_phase, angles = np.degrees(response.phase_measured), phase_axis([response.phase, response.phase_measured])
    for title, unit, traces, measured, yaxis in (
        ("Gain", "dB", gain_traces(f, response.gain, None, name, 600), gain, {}),
        ("Phase", "deg", phase_traces(f, response.phase, None, name, 600), measured_phase, angles),
    ):
        if measured.size:
            marker = {"color": "#ffffff", "size": 6, "line": {"color": drawing.INK, "width": 1.2}}
            points = {"x": drawing.packed(at), "y": drawing.packed(measured)}
            traces.append({"type": "scatter", "mode": "markers", **points, "name": "measured", "marker": marker})
        axes = {"xaxis": frequency_axis(), "yaxis": yaxis, "hovermode": "closest"}
        figure = drawing.single(traces, FREQUENCY, f"{title.lower()} [{unit}]", **axes)
        plots.append(canvas.plot(figure, 260, f"Bode plot, {title.lower()}", title))
    return plots
