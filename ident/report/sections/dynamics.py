"""Section of steady motion, poles, step responses and Bode plots of a vehicle model in a report page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from seatrial.ident.export import conditions_text, frame_words, is_shortest_lag, outside_text, turn_sentence
from seatrial.ident.model import THRUSTER_FORCE, drive_word, is_of_thruster
from seatrial.ident.numerics import NOT_SHOWN, is_undetermined
from seatrial.ident.report import drawing, formatting
from seatrial.ident.report.blocks import Canvas, Cell, Grid, Heading, Plot, Prose, Section, Table
from seatrial.ident.report.bode import FREQUENCY, frequency_axis, gain_traces, phase_axis, phase_traces
from seatrial.ident.results import (
    Dynamics,
    FrequencyResponse,
    OperatingPoint,
    SteadyCurve,
    StepResponse,
    course_sentence,
)

POINTS = 600  # largest number of points of a curve
OTHER_HEADINGS = 'Another heading has other poles: st.linearise(model, speed, at={"psi": heading}), in rad.'
SHORTEST = (
    "≤: the shortest lag of a state of the model. A lag with a shorter time constant in the table of parameters, such "
    "as T_n = 0, has this pole too, and less part in the motion; with zero it has none."
)


def section(canvas: Canvas, dynamics: Dynamics | None) -> Section:
    """Return the section of steady curves, poles, step responses and Bode plots; empty if ``dynamics`` is None.

    Parameters
    ----------
    canvas
        Collector of the figures, to which the figures are added.
    dynamics
        Steady motion, poles, step responses and frequency responses of the model.
    """
    if dynamics is None:
        return Section("dynamics", "", [])
    curves = [_straight_plot(canvas, c, dynamics.speeds) for c in dynamics.steady if c.motion == "straight"]
    turns = [c for c in dynamics.steady if c.motion == "turn"]
    curves += [_turn_plot(canvas, turns, dynamics.ranges.get("r"))] if turns else []
    blocks: list[Any] = [Grid(curves, 320)] if curves else []
    two_sided = any(len(c.inputs) > 1 for c in dynamics.steady)
    if two_sided and not turns and (why := turn_sentence(dynamics.conditions)):
        blocks.append(Prose(why, "caption"))
    driving = [n for curve in dynamics.steady for n in curve.inputs]
    drive = drive_word([*driving, *(n for point in dynamics.points for n in point.inputs)])
    blocks += _pole_blocks(dynamics, drive) + _step_blocks(canvas, dynamics, drive)
    blocks += _bode_blocks(canvas, dynamics, drive)
    lead = (
        f"Computed from the model {frame_words(dynamics.conditions)}, and within the {drive}s of the data. Bands are "
        "95 % intervals from the standard errors of the parameters."
    )
    if dynamics.conditions:
        lead += f" Taken as constant: {conditions_text(dynamics.conditions)}."
    return Section("dynamics", "Steady motion and dynamics", blocks, lead)


def _command(curve: SteadyCurve) -> str:
    """Return the title of the axis of a steady curve's command or shaft speed, with the unit N, or ``part of full``."""
    unit = "N" if curve.inputs and is_of_thruster(curve.inputs[0], THRUSTER_FORCE) else ""
    names = formatting.bracket(unit) or ", part of full"
    if curve.motion == "turn":
        return f"half the difference of both sides{names}"
    if len(curve.inputs) > 1:
        return f"mean {drive_word(curve.inputs)} of both sides{names}"
    return f"{drive_word(curve.inputs)} of the drive{names}"


def _straight_plot(canvas: Canvas, curve: SteadyCurve, speeds: tuple[float, float] | None) -> Plot:
    """Return the plot of the steady speed on a straight course over the command.

    ``speeds`` are the smallest and the largest speed of the data [m/s]; the line is dotted beyond. None: unknown. It is
    dashed where the boat leaves the course without a controller.
    """
    lines = drawing.trusted_lines(
        curve.command, curve.value, "speed", POINTS, speeds, unstable=curve.unstable & np.isfinite(curve.value)
    )
    band = drawing.band(curve.command, curve.value, drawing.Z95 * np.nan_to_num(curve.sd), POINTS, gaps=True)
    figure = drawing.single([band, *lines], _command(curve), "speed [m/s]", hovermode="closest")
    title = "Steady speed on a straight course"
    if words := held_course(curve):
        title += f". {words}"
    dashes = {line["line"].get("dash") for line in lines}
    if "dash" in dashes:
        title += "; dashed: the boat leaves the course without a controller"
    if "dot" in dashes:
        title += "; dotted: beyond the speeds of 98 % of the data"
    return canvas.plot(figure, 320, f"Steady speed against {drive_word(curve.inputs)}", title)


def held_course(curve: SteadyCurve) -> str:
    """Return the words on the inputs that hold a straight course, if they differ; otherwise an empty text."""
    k = curve.unequal
    if k is None:
        return ""
    left, right = (formatting.plain(float(side[k]), 2) for side in curve.sides)
    drive = drive_word(curve.inputs)
    return (
        f"With equal {drive}s the boat turns: unequal ones hold the course, for example {left} left and {right} right "
        f"at {formatting.plain(float(curve.value[k]), 2)} m/s"
    )


def _turn_plot(canvas: Canvas, curves: Sequence[SteadyCurve], rates: tuple[float, float] | None) -> Plot:
    """Return the plot of the steady turn rate over half the difference of the commands, a line for each mean command.

    The plot is added to ``canvas``. ``rates`` are the smallest and the largest turn rate of the data [rad/s]. If a line
    is beyond them, the title says so. None: unknown.
    """
    traces = []
    for i, curve in enumerate(curves):
        factor, _ = formatting.degrees_for(curve.unit)
        value, half = factor * curve.value, drawing.Z95 * factor * np.nan_to_num(curve.sd)
        color = drawing.LINES[i % len(drawing.LINES)]
        traces.append({**drawing.band(curve.command, value, half, POINTS, color=color, gaps=True), "showlegend": False})
        name = f"mean {drive_word(curve.inputs)} {formatting.plain(curve.mean, 2)}"
        dash = drawing.DASHES[i % len(drawing.DASHES)]
        traces.append(drawing.line_trace(curve.command, value, name, POINTS, color=color, dash=dash))
    figure = drawing.single(
        traces,
        _command(curves[0]),
        "turn rate [deg/s]",
        hovermode="closest",
        showlegend=len(curves) > 1,
        legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0},
    )
    against = f"Steady turn rate against difference of the {drive_word(curves[0].inputs)}s"
    title = "Steady turn rate"
    if rates is not None:
        reached = max(-rates[0], rates[1])  # to either side
        if any(np.nanmax(np.abs(c.value), initial=0.0) > reached for c in curves):
            title += f"; extrapolated beyond ± {formatting.plain(float(np.degrees(reached)), 2)} deg/s, within which "
            title += "98 % of the data are"
    return canvas.plot(figure, 320, against, title)


def _pole_blocks(dynamics: Dynamics, drive: str) -> list[Any]:
    """Return heading and table of the poles at each speed; an empty list without linear models.

    A sentence on the operating points outside the fitted data follows, if there are any. If the model is unstable at a
    speed, there is one on the lowest such speed. There is also one on the least stable pole of sway and yaw at the
    speeds of the data, if it is unstable, or on a negative damping of sway. ``drive`` is what the inputs are, in words.
    Each pole has the states that take most part in it, unless the result is of an earlier version.
    """
    points, course = dynamics.points, course_sentence(dynamics.course)
    if not points:
        return []
    rows: list[list[Cell | str]] = []
    any_lost = any_growing = any_shortest = False
    named = all(p.mainly for p in points)
    for point in points:
        rows.append([Cell(f"{point.speed:g} m/s, {drive} {_inputs_in_words(point)}", "group")])
        errors = np.full(point.real.size, np.nan) if point.error is None else point.error
        for k, (real, imaginary, error) in enumerate(zip(point.real, point.imaginary, errors, strict=True)):
            if imaginary < 0.0:
                continue  # of a pair, the pole with the positive imaginary part is shown
            pole = formatting.plain(float(real)) + (f" ± {formatting.plain(float(imaginary))} j" if imaginary else "")
            constant = f"{formatting.plain(float(-1.0 / real))} s" if real < 0.0 else "–"
            if not imaginary and real and is_shortest_lag(float(-1.0 / real)):
                any_shortest, constant = True, f"≤ {constant}"
            grows = f"unstable: grows by a factor of e in {formatting.plain(float(1.0 / real))} s" if real > 0.0 else ""
            if is_undetermined(float(real), float(error)):
                any_lost, constant, grows = True, "not determined", f"stability {NOT_SHOWN}" if real > 0.0 else ""
            any_growing = any_growing or bool(grows)
            names = [Cell(point.mainly[k], "symbol")] if named else []
            rows.append([Cell(pole, "num"), Cell(constant, "num"), *names, Cell(grows, "bad")])
    columns = [("pole [1/s]", "num"), ("time constant", "num")]
    columns += [("mainly", "")] if named else []
    columns += [("stability", "")] if any_growing else []
    rows = rows if any_growing else [row if len(row) == 1 else row[:-1] for row in rows]
    on = ""
    if (psi := dynamics.conditions.get("psi")) is not None:
        on = f"on heading {math.degrees(psi):.0f} deg"
    note = ", ".join(filter(None, ["of the model linearised at each speed", on]))
    blocks: list[Any] = [Heading("Poles on a straight course", note)]
    notes = ["Not determined: the standard error of the pole is more than half of its size."] * any_lost
    notes += [SHORTEST] * any_shortest
    notes += [OTHER_HEADINGS] * bool(on)
    blocks.append(Table(columns, rows, " ".join(notes)))
    if beyond := _outside_sentence(dynamics):
        blocks.append(Prose(beyond, "callout"))
    # the sentence on the course says it if the data do not show whether the boat is stable
    is_clear = dynamics.course is None or dynamics.course.stability != NOT_SHOWN
    if not all(p.stable for p in points) and is_clear:
        slowest = min(p.speed for p in points if not p.stable)
        blocks.append(
            Prose(
                f"From {slowest:g} m/s on{f' ({on})' if on else ''}, the boat does not hold a straight course without "
                f"a heading controller: a small yaw rate grows until the boat turns. {course}".rstrip(),
                "callout",
            )
        )
    elif course:
        blocks.append(Prose(course, "callout"))
    return blocks


def _outside_sentence(dynamics: Dynamics) -> str:
    """Return a sentence on the operating points whose states or inputs are outside the fitted data; often empty."""
    found = [(p.speed, outside_text({**p.states, **p.inputs}, dynamics.ranges)) for p in dynamics.points]
    words = "; ".join(f"at {speed:g} m/s {text}" for speed, text in found if text)
    return (
        f"Outside the fitted data, where the model extrapolates and its poles may be wrong: {words}." if words else ""
    )


def _inputs_in_words(point: OperatingPoint) -> str:
    """Return the inputs that keep a speed as text: one number if they are equal, otherwise ``n_left 0.25, ...``."""
    shown = {name: formatting.plain(value) for name, value in point.inputs.items()}
    if len(set(shown.values())) == 1:
        return next(iter(shown.values()))
    return ", ".join(f"{name} {value}" for name, value in shown.items())


def _step_blocks(canvas: Canvas, dynamics: Dynamics, drive: str) -> list[Any]:
    """Return heading and plots of the step responses, and the dead times; an empty list without responses."""
    plots = [_step_plot(canvas, step) for step in dynamics.steps]
    if not plots:
        return []
    step = dynamics.steps[0]
    note = f"linear model at {step.speed:g} m/s, step of {formatting.plain(step.step, 2)} of the {drive}"
    note += "" if step.sd is None else ", with 95 % bands"
    blocks: list[Any] = [Heading("Step responses", note), Grid(plots, 240)]
    if dynamics.delays:
        words = ", ".join(f"{1e3 * v:.0f} ms of {n}" for n, v in dynamics.delays.items())
        blocks.append(Prose(f"With the dead time: {words}.", "caption"))
    return blocks


def _step_plot(canvas: Canvas, step: StepResponse) -> Plot:
    """Return the plot of a step response, with its 95 % band if its standard errors are known."""
    factor, unit = formatting.degrees_for(step.unit)
    what = "both sides up" if step.motion == "straight" else "left up, right down"
    title = f"{formatting.titled(step.quantity)} [{unit}] · {what}"
    traces = [drawing.line_trace(step.t, factor * step.value, "response", POINTS)]
    if step.sd is not None:
        traces.insert(0, drawing.band(step.t, factor * step.value, drawing.Z95 * factor * step.sd, POINTS))
    figure = drawing.single(traces, "time [s]", yaxis={"rangemode": "tozero"})
    return canvas.plot(figure, 220, f"Step response, {title}", title)


def _bode_blocks(canvas: Canvas, dynamics: Dynamics, drive: str) -> list[Any]:
    """Return heading, plots and a sentence for each frequency response; an empty list without responses."""
    if not dynamics.responses:
        return []
    first = dynamics.responses[0]
    words = f"from the {drive} to speed and turn rate" if len(dynamics.responses) > 1 else f"from the {drive}"
    blocks: list[Any] = [Heading("Bode plot", f"linear model at {first.speed:g} m/s, {words}")]
    blocks.append(Grid([plot for response in dynamics.responses for plot in _bode_plots(canvas, response)], 400))
    sentences = [words for response in dynamics.responses if (words := _bode_words(response))]
    if not first.stable:
        sentences.append(
            "The model is not stable at this speed: without a heading controller the boat does not turn in this way. "
            "The plots are for the design of such a controller."
        )
    return [*blocks, Prose(" ".join(sentences), "caption")]


def _bode_plots(canvas: Canvas, response: FrequencyResponse) -> list[Plot]:
    """Return the plots of gain [dB] and phase [deg] of a frequency response over the frequency [Hz]."""
    factor, unit = formatting.degrees_for(response.unit)
    f, name, plots = response.frequency, formatting.titled(response.quantity), []
    what = "both sides" if response.motion == "straight" else "left minus right side, halved"
    reference = f"gain [dB, 0 dB: 1 {unit}]"
    angles = phase_axis([response.phase], [response.phase_sd])
    for title, axis, traces, yaxis in (
        ("gain", reference, gain_traces(f, factor * response.gain, response.gain_sd, name, POINTS), {}),
        ("phase", "phase [deg]", phase_traces(f, response.phase, response.phase_sd, name, POINTS), angles),
    ):
        figure = drawing.single(traces, FREQUENCY, axis, xaxis=frequency_axis(), yaxis=yaxis, hovermode="closest")
        plots.append(canvas.plot(figure, 260, f"Bode plot, {title} of {name}", f"{name}, {title} · {what}"))
    return plots


def _bode_words(response: FrequencyResponse) -> str:
    """Return a sentence on the bandwidth of a response, and on the frequency at which it lags by 90 deg.

    The text is empty if both are unknown.
    """
    name = {"u": "speed", "r": "turn rate"}.get(response.quantity, response.quantity)
    parts = []
    if response.bandwidth is not None:
        period = formatting.plain(1.0 / response.bandwidth, 2)
        band = _frequency_words(response.bandwidth, response.bandwidth_sd)
        parts.append(f"falls by 3 dB at {band} (a period of {period} s)")
    if response.lag_90 is not None:
        limit = ", where the heading lags by 180°" if response.quantity == "r" else ""
        parts.append(f"lags by 90° at {_frequency_words(response.lag_90, response.lag_90_sd)}{limit}")
    return f"The {name} {' and '.join(parts)}." if parts else ""


def _frequency_words(value: float, error: float | None) -> str:
    """Return a frequency [Hz] with its standard error, or with two digits if that is unknown."""
    return formatting.with_error(value, error, "Hz") if error else f"{formatting.plain(value, 2)} Hz"
