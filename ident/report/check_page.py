"""HTML page of a check of logs or of a rig (`seatrial check`, preflight).

It has the answer, the findings, the curves of the logs, and the dry run of the rig's mission, in which no thruster is
commanded.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from seatrial.daq.checks import UNKNOWN, CheckReport, DryRun, Finding, PredictedTrack
from seatrial.daq.errors import counted
from seatrial.daq.files import write_output
from seatrial.ident.checks import CheckEvidence
from seatrial.ident.numerics import Array
from seatrial.ident.report import drawing, formatting
from seatrial.ident.report.blocks import Canvas, Facts, Grid, Key, Prose, Section, Verdict, Verdicts, tabbed
from seatrial.ident.report.drawing import BEFORE, MODEL, Budget, Panel, dots, line_trace, single, stacked
from seatrial.ident.report.page import Answer, compose

LEVELS = {"fault": "faults", "warning": "warnings", "ok": "ok"}
MAX_NAMED = 4  # findings named in the answer; of more findings, the first three are named
MAX_POINTS = 120_000  # of all traces of the page
PanelMaker = Callable[[CheckEvidence, int], Sequence[Panel]]  # from a log and the largest number of points of a trace


def write_check_page(report: CheckReport, logs: Sequence[CheckEvidence], command: str, path: Path) -> None:
    """Write the findings of a check, the curves of its logs and its dry run as one HTML page.

    The page opens without a network. An existing file is replaced.

    Parameters
    ----------
    report : CheckReport
        Findings, and the dry run of a rig's mission.
    logs : sequence of CheckEvidence
        Curves of each log; may be empty.
    command : str
        Command line of the check. If it is empty, the page has no section of provenance.
    path : Path
        HTML file to write.

    Raises
    ------
    OSError
        If ``path`` cannot be written.
    SeatrialError
        If ``path`` is a symbolic link, a folder or a special file.
    """
    canvas = Canvas(Budget.for_traces(sum(_trace_count(log) for log in logs), MAX_POINTS))
    problems = [f for f in report.findings if f.is_problem]
    opening = Section(
        "top", "", [*([_findings_block(problems)] if problems else []), Facts(_labelled_facts(report, logs))]
    )
    body = [_mission_section(canvas, report.mission), *_evidence_sections(canvas, logs)]
    body.append(Section("all", "All checks", [_findings_block(report.findings)] if report.findings else []))
    body.append(Section("made", "How it was made", [Facts([("command", command)], "made")] if command else []))
    page = compose(
        "Preflight" if report.rig is not None else "Check of a log",
        Answer(check_answer(report)),
        opening,
        [section for section in body if section.blocks],
        canvas.figures,
        version=version("seatrial"),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )
    write_output(path, page)


def check_answer(report: CheckReport) -> str:
    """Return the headline of the page of a check: whether the rig is ready or the log is in order, and why not.

    If there are faults, the first is given in full, and the others by place and name of the check. If there are only
    warnings, they are given by place and name of the check. If all findings are ``ok``, the headline has their number.
    If there is no finding at all, it states that no check applies.

    Parameters
    ----------
    report
        Findings of the check. They are about a rig if the report has the name of a rig, otherwise about logs.
    """
    found, subject, rig = report.findings, report.subject, report.rig is not None
    faults, warnings = ([f for f in found if f.level == level] for level in ("fault", "warning"))
    if faults:
        first, *more = faults
        rest = f" Other faults: {_findings_in_words(more)}." if more else ""
        verdict = "is not ready" if rig else "cannot be trusted yet"
        return f"{subject} {verdict}: {_with_full_stop(_finding_phrase(first))}{rest}"
    if warnings:
        named = _findings_in_words(warnings)
        return f"{subject} can be used{' for a run' if rig else ''}; read these warnings first: {named}."
    if not found:
        return f"{subject}: no check applies."
    return f"{subject} is {'ready' if rig else 'in order'}: {counted(len(found), 'check')}, no faults or warnings."


def _finding_phrase(finding: Finding) -> str:
    """Return the text of a finding, preceded by its place (device, thruster or file) and a comma.

    The place is left out if the text contains its last part (after ``: ``) as a word.
    """
    where, text = finding.where, finding.text
    # whole words only: the letter of a signal such as `r` is in most texts
    named = re.search(rf"(?<!\w){re.escape(where.rsplit(': ', 1)[-1])}(?!\w)", text)
    return text if named else f"{where}, {text}"


def _with_full_stop(phrase: str) -> str:
    """Return a sentence with a full stop added, or unchanged if it ends with a question mark.

    ``phrase`` must not end with a full stop itself.
    """
    return phrase if phrase.endswith("?") else f"{phrase}."


def _findings_in_words(found: Sequence[Finding]) -> str:
    """Return place and name of the check of each finding: ``gnss (rate), left (delay) and compass (noise)``.

    Of more than four findings, the first three are named and the others are counted: ``and 2 more``. ``found`` must not
    be empty.
    """
    shown = [f"{f.where} ({f.check})" for f in found]
    if len(shown) > MAX_NAMED:
        shown = [*shown[: MAX_NAMED - 1], f"{len(shown) - MAX_NAMED + 1} more"]
    return " and ".join([", ".join(shown[:-1]), shown[-1]] if len(shown) > 1 else shown)


def _findings_block(found: Sequence[Finding]) -> Verdicts:
    """Return the findings of a check, in their order, as a list for its report page."""
    return Verdicts([Verdict(f.level, f.where, f.check, f.text, f.advice) for f in found])


def _labelled_facts(report: CheckReport, logs: Sequence[CheckEvidence]) -> list[tuple[str, str]]:
    """Return (label, value) of the facts at the top of the check page.

    They are the rig, if the report has one, the duration of each log, and the numbers of faults, of warnings and of
    findings without a problem, also if a number is 0. If the data do not decide some findings, their number follows.
    """
    levels = [f.level for f in report.findings]
    facts = [] if report.rig is None else [("rig", report.rig)]
    for log in logs:
        label = "recorded" if len(logs) == 1 else f"recorded in {log.name}"
        facts.append((label, formatting.duration(log.duration)))
    facts += [(word, str(levels.count(level))) for level, word in LEVELS.items()]
    return [*facts, *([("unknown", str(levels.count(UNKNOWN)))] if UNKNOWN in levels else [])]


def _trace_count(log: CheckEvidence) -> int:
    """Return the approximate number of traces (lines) in the figures of one log.

    The more traces the page has, the fewer points each of them gets, so that the page does not become too large.
    """
    return sum(len(rows) for rows in (log.intervals, log.shafts, log.thrust_response, log.sensors, log.signals)) + 2


def _evidence_sections(canvas: Canvas, logs: Sequence[CheckEvidence]) -> list[Section]:
    """Return one section of figures for each kind of curve, with a tab for each log that has such a curve.

    There are no tabs if only one log has such a curve.

    The kinds are thrust response, shafts, pairs of sensors, signals, and time between samples. A section is empty if no
    log has such a curve. The figures are added to ``canvas``.
    """
    measured = ("measured", "measured")
    return [
        _curve_section(
            canvas,
            logs,
            "push",
            "Measured motion and motion expected from the thrust",
            _thrust_response_panels,
            170,
            [measured, ("line", "expected: thrust through a first-order lag, scaled to the measured motion")],
            "If the curves agree, sides and signs of the thrusters are right. If they are mirror images, left and "
            "right are exchanged or a sign is wrong.",
        ),
        _curve_section(
            canvas,
            logs,
            "shafts",
            "Commands and shaft speeds",
            _shaft_panels,
            132,
            [("before", "command"), ("line", "measured shaft speed")],
        ),
        _curve_section(
            canvas,
            logs,
            "sensors",
            "The same motion from two sensors",
            _sensor_panels,
            132,
            [
                ("measured", "change of heading in 1 s, or of position in 5 s"),
                ("line", "yaw rate of the gyro, or velocity as received"),
            ],
            "The two curves should agree. A constant factor between them indicates a wrong unit, a shift in time a "
            "delayed sensor.",
        ),
        _curve_section(canvas, logs, "signals", "Signals of the sensors", _signal_panels, 100),
        _curve_section(
            canvas,
            logs,
            "intervals",
            "Time between samples",
            _interval_panels,
            90,
            [("line", "time since the sample before"), ("before", "expected from rate_hz of the rig file")],
            "A peak is a gap in the data. If the level is above the dashed line, the device is slower than rate_hz of "
            "the rig file.",
        ),
    ]


def _curve_section(
    canvas: Canvas,
    logs: Sequence[CheckEvidence],
    key: str,
    title: str,
    make_panels: PanelMaker,
    height: int,
    legend: Sequence[tuple[str, str]] = (),
    lead: str = "",
) -> Section:
    """Return the section of the figures of one kind of curve; it is empty if no log has such a curve.

    Parameters
    ----------
    canvas : Canvas
        Collector of the figures, to which the figures are added.
    logs : sequence of CheckEvidence
        Curves of each log.
    key : str
        Anchor of the section in the page.
    title : str
        Title of the section.
    make_panels : callable
        Function that returns the panels of one log, given the log's curves and the largest number of points of a trace.
    height : int
        Height of a panel [px].
    legend : sequence
        CSS class of each symbol, and its meaning; may be empty.
    lead : str
        Introduction of the section; may be empty.
    """
    found = []
    for log in logs:
        panels, blocks = make_panels(log, canvas.budget.points), list[Any]()
        if panels:
            figure, high = stacked(panels, "time since the start of the log [s]", panel_height=height)
            blocks.append(Grid([canvas.plot(figure, high, f"{title} {log.name}")], 320))
        found.append((log.name, blocks))
    blocks = found[0][1] if len(found) == 1 else tabbed(found)
    return Section(key, title, [*([Key(legend)] if legend else []), *blocks] if blocks else [], lead)


def _thrust_response_panels(log: CheckEvidence, limit: int) -> list[Panel]:
    """Return one panel for each motion of the boat (such as the yaw rate): measured, and expected from the thrust.

    The expected motion is the thrust after the first-order lag that fits best, in the unit of the measurement.

    ``limit`` is the largest number of points of a trace.
    """
    panels = []
    for row in log.thrust_response:
        factor, unit = formatting.degrees_for(row.unit)
        traces = [
            dots(row.t, factor * row.measured, "measured", limit),
            line_trace(row.t, factor * row.expected, "expected", limit),
        ]
        panels.append(Panel(_capitalised(row.title) + formatting.bracket(unit), traces))
    return panels


def _shaft_panels(log: CheckEvidence, limit: int) -> list[Panel]:
    """Return one panel for each thruster: command and measured shaft speed, as fractions of full speed.

    ``limit`` is the largest number of points of a trace.
    """
    panels = []
    for row in log.shafts:
        commanded = _staircase(row.t_command, row.n_command, row.end, limit)
        traces = [
            line_trace(*commanded, "command", limit, color=BEFORE, dash="dash"),
            line_trace(row.t, row.n, "shaft speed", limit),
        ]
        panels.append(Panel(f"{_capitalised(row.name)}, fraction of full speed", traces))
    return panels


def _staircase(t: Array, value: Array, end: float, limit: int) -> tuple[Array, Array]:
    """Return times and values of commands as a staircase: each command is held until the next one.

    The last command is held until ``end`` [s], or is not held if its time is later. If the corners are more than
    ``limit`` points, the result is ``limit`` held values at equidistant times instead.

    Parameters
    ----------
    t, value
        Times [s] of the commands (n,), at least one, and the commands (n,).
    end
        Time [s] until which the last command is held.
    limit
        Largest number of points.
    """
    # line_trace would thin more corners, and join the remaining ones by slopes
    end = max(end, float(t[-1]))
    if 2 * t.size <= limit:
        return np.append(np.repeat(t, 2)[1:], end), np.repeat(value, 2)
    at = np.linspace(t[0], end, limit)
    return at, value[np.searchsorted(t, at, side="right") - 1]


def _sensor_panels(log: CheckEvidence, limit: int) -> list[Panel]:
    """Return one panel for each motion of the boat that two sensors measure, with both curves at common times.

    ``limit`` is the largest number of points of a trace.
    """
    panels = []
    for row in log.sensors:
        factor, unit = formatting.degrees_for(row.unit)
        first, second = row.names
        traces = [dots(row.t, factor * row.first, first, limit), line_trace(row.t, factor * row.second, second, limit)]
        panels.append(Panel(_capitalised(row.title) + formatting.bracket(unit), traces))
    return panels


def _signal_panels(log: CheckEvidence, limit: int) -> list[Panel]:
    """Return one panel for each measured signal. Angles are shown in degrees without jumps of a full turn.

    ``limit`` is the largest number of points of a trace.
    """
    panels = []
    for row in log.signals:
        factor, unit = formatting.degrees_for(row.unit)
        name = row.channel
        shown = np.degrees(np.unwrap(row.value)) if row.angle and unit == "deg" else factor * row.value
        title = formatting.titled(name) if name in formatting.MEANINGS else _capitalised(name.replace("_", " "))
        panels.append(Panel(title + formatting.bracket(unit), [dots(row.t, shown, name, limit)]))
    return panels


def _interval_panels(log: CheckEvidence, limit: int) -> list[Panel]:
    """Return one panel for each device: time between its samples [ms] over time.

    A point is at the time of the later of two samples. The expected time between samples is added as a dashed line if
    the rig file has the rate of the device.

    ``limit`` is the largest number of points of a trace.
    """
    panels = []
    for row in log.intervals:
        t, interval = row.t, 1e3 * row.interval
        traces, top = [dots(t, interval, "interval", limit, color=MODEL)], float(interval.max())
        if row.expected is not None:
            ends, top = np.array([t[0], t[-1]]), max(top, 1e3 * row.expected)
            traces.append(line_trace(ends, np.full(2, 1e3 * row.expected), "expected", 2, color=BEFORE, dash="dash"))
        panels.append(Panel(f"{row.source} [ms]", traces, {"range": [0.0, 1.2 * top]}))
    return panels


def _mission_section(canvas: Canvas, mission: DryRun | None) -> Section:
    """Return the section of the dry run of a mission: its commands over time, and the predicted track of the boat.

    The section is empty if ``mission`` is None. It has only the commands if there is no predicted track. The figures
    are added to ``canvas``.
    """
    if mission is None:
        return Section("mission", "", [])
    panels = []
    for column, name in enumerate(mission.thrusters):
        commanded = line_trace(
            *_staircase(mission.t, mission.n[:, column], mission.end, canvas.budget.points), name, canvas.budget.points
        )
        title = f"{_capitalised(name)}: command, fraction of full speed"
        panels.append(Panel(title, [commanded], {"range": [-1.08, 1.08]}))
    figure, high = stacked(panels, "time since the start of the mission [s]")
    blocks: list[Any] = [Grid([canvas.plot(figure, high, "Commands of the mission")], 320)]
    if mission.track is not None:
        track = single(
            _track_traces(mission.track, mission.fence),
            "east of the start [m]",
            "north of the start [m]",
            hovermode="closest",
            yaxis={"scaleanchor": "x"},
            showlegend=True,
            legend={"orientation": "h", "y": 1.08},
        )
        words = f"Predicted by {mission.track.source}, from rest, heading north, without wind and current."
        plot = canvas.plot(track, 540, "Predicted track and geofence")
        blocks += [Grid([plot], 320, "narrow"), Prose(words, "caption")]
    return Section("mission", f"Dry run of the mission {mission.name}", blocks)


def _track_traces(track: PredictedTrack, fence: float | None) -> list[drawing.Trace]:
    """Return the traces of the predicted track, one 95 % circle, the geofence and the start.

    The circle contains the boat with a probability of 95 %; of all points of the track, it is the circle that reaches
    farthest from the start. It is left out if the track has no such circles. ``fence`` is the radius [m] of the
    geofence about the start; None: the geofence is left out.
    """
    x, y = track.x - track.x[0], track.y - track.y[0]
    traces = [line_trace(y, x, "predicted track", 4000)]
    angle = np.linspace(0.0, 2.0 * np.pi, 121)
    if track.radius is not None:
        # only the circle that reaches farthest from the start, which is the one that matters for the geofence
        k = int(np.argmax(np.hypot(x, y) + track.radius))
        circle = (y[k] + track.radius[k] * np.sin(angle), x[k] + track.radius[k] * np.cos(angle))
        traces.append(line_trace(*circle, "95 % of the boats, at the farthest point", 200, color=drawing.FAINT))
    if fence is not None:
        circle = (fence * np.sin(angle), fence * np.cos(angle))
        traces.append(line_trace(*circle, "geofence", 200, color=drawing.AMBER, dash="dash"))
    marker = {"size": 9, "color": drawing.MEASURED, "symbol": "square"}
    traces.append({"type": "scatter", "mode": "markers", "x": [0.0], "y": [0.0], "name": "start", "marker": marker})
    return [trace | {"showlegend": True} for trace in traces]


def _capitalised(words: str) -> str:
    """Return a text with a capital first letter; an empty text stays empty."""
    return words[:1].upper() + words[1:]
