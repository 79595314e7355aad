"""The page of a check: is it fit for a run, what has to be mended first, and what shows it."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from seatrial.daq.checks import CheckReport, DryRun, Finding, PredictedTrack
from seatrial.daq.errors import counted
from seatrial.daq.files import write_output
from seatrial.ident.checks import CheckEvidence
from seatrial.ident.numerics import Array
from seatrial.ident.report import drawing, formatting
from seatrial.ident.report.blocks import Canvas, Facts, Grid, Key, Prose, Section, Verdict, Verdicts, tabbed
from seatrial.ident.report.drawing import BEFORE, MODEL, Budget, Panel, dots, line_trace, single, stacked
from seatrial.ident.report.page import compose

LEVELS = {"fault": "faults", "warning": "warnings", "ok": "in order"}
MOST_NAMED = 4
POINTS = 120_000  # on the page
Make = Callable[[CheckEvidence, int], Sequence[Panel]]  # a log and the points that a trace may have -> panels


def write_check_page(report: CheckReport, logs: Sequence[CheckEvidence], command: str, path: Path) -> None:
    """Write a check's findings, the curves of its logs and its dry run as one HTML page.

    It opens without a network. Raises OSError where ``path`` cannot be written.
    """
    canvas = Canvas(Budget.for_traces(sum(_count(log) for log in logs), POINTS))
    wrong = [f for f in report.findings if f.level != "ok"]
    opening = Section("top", "", [*([_verdicts(wrong)] if wrong else []), Facts(_facts(report, logs))])
    body = [_mission(canvas, report.mission), *_evidence(canvas, logs)]
    body.append(Section("all", "Every question", [_verdicts(report.findings)] if report.findings else []))
    body.append(Section("made", "How it was made", [Facts([("command", command)], "made")] if command else []))
    page = compose(
        "Preflight" if report.rig is not None else "Check of a log",
        check_answer(report),
        opening,
        [section for section in body if section.blocks],
        canvas.figures,
        version=version("seatrial"),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )
    write_output(path, page)


def check_answer(report: CheckReport) -> str:
    """May it be used, and if not, why not."""
    found, subject, rig = report.findings, report.subject, report.rig is not None
    faults, warnings = ([f for f in found if f.level == level] for level in ("fault", "warning"))
    if faults:
        first, *more = faults
        rest = f" Faulty as well: {_named(more)}." if more else ""
        return f"{subject} {'is not ready' if rig else 'cannot be trusted yet'}: {_sentence(_phrase(first))}{rest}"
    if warnings:
        fine = f"Nothing stops a run with {subject}" if rig else f"{subject} can be used"
        return f"{fine}; look first at {_named(warnings)}."
    if not found:
        return f"{subject}: there was nothing to check."
    return f"{subject} is {'ready' if rig else 'in order'}: {counted(len(found), 'check')}, nothing wrong."


def _phrase(finding: Finding) -> str:
    where, what = finding.where, finding.text
    named = re.search(rf"(?<!\w){re.escape(where.rsplit(': ', 1)[-1])}(?!\w)", what)  # `r` is in many a word
    return what if named else f"{where}, {what}"


def _sentence(phrase: str) -> str:
    return phrase if phrase.endswith("?") else f"{phrase}."


def _named(found: Sequence[Finding]) -> str:
    """``gnss (rate), left (delay) and 3 more``."""
    shown = [f"{f.where} ({f.check})" for f in found]
    if len(shown) > MOST_NAMED:
        shown = [*shown[: MOST_NAMED - 1], f"{len(shown) - MOST_NAMED + 1} more"]
    return " and ".join([", ".join(shown[:-1]), shown[-1]] if len(shown) > 1 else shown)


def _verdicts(found: Sequence[Finding]) -> Verdicts:
    return Verdicts([Verdict(f.level, f.where, f.check, f.text, f.advice) for f in found])


def _facts(report: CheckReport, logs: Sequence[CheckEvidence]) -> list[tuple[str, str]]:
    levels = [f.level for f in report.findings]
    facts = [] if report.rig is None else [("rig", report.rig)]
    for log in logs:
        label = "recorded" if len(logs) == 1 else f"recorded in {log.name}"
        facts.append((label, formatting.duration(log.duration)))
    return [*facts, *((word, str(levels.count(level))) for level, word in LEVELS.items())]


def _count(log: CheckEvidence) -> int:
    return sum(len(rows) for rows in (log.intervals, log.shafts, log.push, log.sensors, log.signals)) + 2


def _evidence(canvas: Canvas, logs: Sequence[CheckEvidence]) -> list[Section]:
    """One section for each kind of curve, with a tab a log; without tabs where there is one log."""
    measured = ("measured", "measured")
    return [
        _section(
            canvas,
            logs,
            "push",
            "Does the boat go where its thrusters push?",
            _push,
            170,
            [measured, ("line", "as the thrusters push, through a first-order lag and to scale")],
            "Two curves that go together: sides and signs are right. Mirror images: swapped, or a wrong sign.",
        ),
        _section(
            canvas,
            logs,
            "shafts",
            "Do the shafts do what they are told?",
            _shafts,
            132,
            [("before", "what it is told"), ("line", "what the shaft does")],
        ),
        _section(
            canvas,
            logs,
            "sensors",
            "Do the sensors agree?",
            _sensors,
            132,
            [("measured", "change of heading in 1 s, of position in 5 s"), ("line", "gyro, velocity as received")],
            "One motion by two sensors. A factor between them is a unit; a shift in time, a sensor that comes late.",
        ),
        _section(canvas, logs, "signals", "What the sensors said", _signals, 100),
        _section(
            canvas,
            logs,
            "intervals",
            "Time between samples",
            _intervals,
            90,
            [("line", "from sample to sample"), ("before", "by the rig's rate_hz")],
            "A peak is a pause; a level above the dashed line, a device that is slower than the rig says.",
        ),
    ]


def _section(
    canvas: Canvas,
    logs: Sequence[CheckEvidence],
    key: str,
    title: str,
    make: Make,
    height: int,
    items: Sequence[tuple[str, str]] = (),
    lead: str = "",
) -> Section:
    found = []
    for log in logs:
        panels, blocks = make(log, canvas.budget.points), list[Any]()
        if panels:
            figure, high = stacked(panels, "time since the start of the log [s]", panel_height=height)
            blocks.append(Grid([canvas.plot(figure, high, f"{title} {log.name}")], 320))
        found.append((log.name, blocks))
    blocks = found[0][1] if len(found) == 1 else tabbed(found)
    return Section(key, title, [*([Key(items)] if items else []), *blocks] if blocks else [], lead)


def _push(log: CheckEvidence, limit: int) -> list[Panel]:
    panels = []
    for row in log.push:
        factor, unit = formatting.degrees_for(row.unit)
        traces = [
            dots(row.t, factor * row.measured, "measured", limit),
            line_trace(row.t, factor * row.expected, "as pushed", limit),
        ]
        panels.append(Panel(_capital(row.title) + formatting.bracket(unit), traces))
    return panels


def _shafts(log: CheckEvidence, limit: int) -> list[Panel]:
    panels = []
    for row in log.shafts:
        told = _held(row.t_command, row.n_command, row.end, limit)
        traces = [line_trace(*told, "told", limit, color=BEFORE, dash="dash"), line_trace(row.t, row.n, "turns", limit)]
        panels.append(Panel(f"{_capital(row.name)}, part of full speed", traces))
    return panels


def _held(t: Array, value: Array, end: float, limit: int) -> tuple[Array, Array]:
    """The corners of a command that is held until the next one; where these are too many, what held at equal steps of
    time: thinned corners would be joined by slopes."""
    end = max(end, float(t[-1]))
    if 2 * t.size <= limit:
        return np.append(np.repeat(t, 2)[1:], end), np.repeat(value, 2)
    at = np.linspace(t[0], end, limit)
    return at, value[np.searchsorted(t, at, side="right") - 1]


def _sensors(log: CheckEvidence, limit: int) -> list[Panel]:
    panels = []
    for row in log.sensors:
        factor, unit = formatting.degrees_for(row.unit)
        first, second = row.names
        traces = [dots(row.t, factor * row.one, first, limit), line_trace(row.t, factor * row.other, second, limit)]
        panels.append(Panel(_capital(row.title) + formatting.bracket(unit), traces))
    return panels


def _signals(log: CheckEvidence, limit: int) -> list[Panel]:
    panels = []
    for row in log.signals:
        factor, unit = formatting.degrees_for(row.unit)
        name = row.channel
        shown = np.degrees(np.unwrap(row.value)) if row.angle and unit == "deg" else factor * row.value
        title = formatting.titled(name) if name in formatting.MEANINGS else _capital(name.replace("_", " "))
        panels.append(Panel(title + formatting.bracket(unit), [dots(row.t, shown, name, limit)]))
    return panels


def _intervals(log: CheckEvidence, limit: int) -> list[Panel]:
    panels = []
    for row in log.intervals:
        t, pause = row.t, 1e3 * row.interval
        traces, top = [dots(t, pause, "pause", limit, color=MODEL)], float(pause.max())
        if row.expected is not None:
            ends, top = np.array([t[0], t[-1]]), max(top, 1e3 * row.expected)
            traces.append(line_trace(ends, np.full(2, 1e3 * row.expected), "by the rig", 2, color=BEFORE, dash="dash"))
        panels.append(Panel(f"{row.source} [ms]", traces, {"range": [0.0, 1.2 * top]}))
    return panels


def _mission(canvas: Canvas, mission: DryRun | None) -> Section:
    """The dry run: what will be told, and the way that the boat is expected to take."""
    if mission is None:
        return Section("mission", "", [])
    panels = []
    for column, name in enumerate(mission.thrusters):
        told = line_trace(
            *_held(mission.t, mission.n[:, column], mission.end, canvas.budget.points), name, canvas.budget.points
        )
        panels.append(Panel(f"{_capital(name)}: command, part of full speed", [told], {"range": [-1.08, 1.08]}))
    figure, high = stacked(panels, "time since the start of the mission [s]")
    blocks: list[Any] = [Grid([canvas.plot(figure, high, "Commands of the mission")], 320)]
    if mission.track is not None:
        track = single(
            _way(mission.track, mission.fence),
            "east of the start [m]",
            "north of the start [m]",
            hovermode="closest",
            yaxis={"scaleanchor": "x"},
            showlegend=True,
            legend={"orientation": "h", "y": 1.08},
        )
        words = f"Predicted by {mission.track.source}, from rest, heading north. Wind and current add to it."
        blocks += [Grid([canvas.plot(track, 540, "Predicted track and fence")], 320, "narrow"), Prose(words, "caption")]
    return Section("mission", f"The mission, run dry: {mission.name}", blocks)


def _way(track: PredictedTrack, fence: float | None) -> list[drawing.Trace]:
    x, y = track.x - track.x[0], track.y - track.y[0]
    traces = [line_trace(y, x, "predicted track", 4000)]
    angle = np.linspace(0.0, 2.0 * np.pi, 121)
    if track.radius is not None:
        wide = int(np.argmax(np.hypot(x, y) + track.radius))
        around = (y[wide] + track.radius[wide] * np.sin(angle), x[wide] + track.radius[wide] * np.cos(angle))
        traces.append(line_trace(*around, "95 % of the boats, where farthest", 200, color=drawing.FAINT))
    if fence is not None:
        circle = (fence * np.sin(angle), fence * np.cos(angle))
        traces.append(line_trace(*circle, "fence", 200, color=drawing.AMBER, dash="dash"))
    marker = {"size": 9, "color": drawing.MEASURED, "symbol": "square"}
    traces.append({"type": "scatter", "mode": "markers", "x": [0.0], "y": [0.0], "name": "start", "marker": marker})
    return [trace | {"showlegend": True} for trace in traces]


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]
