"""The page of a check: is it fit for a run, what has to be mended first, and what shows it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from daq.errors import counted
from ident.numerics import Array
from ident.report import drawing, formatting
from ident.report.access import Row, array, group, number, rows, text, texts
from ident.report.blocks import Canvas, Facts, Grid, Key, Prose, Section, Verdict, Verdicts, tabbed
from ident.report.drawing import BEFORE, MODEL, Budget, Panel, dots, line, single, stacked
from ident.report.page import compose

LEVELS = {"fault": "faults", "warning": "warnings", "ok": "in order"}
MOST_NAMED = 4
POINTS = 120_000  # on the page
Make = Callable[[Row, int], Sequence[Panel]]  # a log and the points that a trace may have -> panels


def write_check_page(content: Mapping[str, Any], path: Path) -> None:
    """Write a check's findings, curves (``logs``: of ident.checks.evidence) and dry run as one HTML page.

    It opens without a network. Raises OSError where ``path`` cannot be written.
    """
    canvas = Canvas(content, Budget.for_traces(sum(_count(log) for log in rows(content, "logs")), POINTS))
    found = rows(content, "findings")
    wrong = [f for f in found if text(f, "level") != "ok"]
    opening = Section("top", "", [*([_verdicts(wrong)] if wrong else []), Facts(_facts(content))])
    body = [_mission(canvas), *_evidence(canvas)]
    body.append(Section("all", "Every question", [_verdicts(found)] if found else []))
    command = text(content, "command")
    body.append(Section("made", "How it was made", [Facts([("command", command)], "made")] if command else []))
    page = compose(
        "Preflight" if group(content, "rig") else "Check of a log",
        answer(content),
        opening,
        [section for section in body if section.blocks],
        canvas.figures,
        version=text(content, "seatrial"),
        created=text(content, "created"),
    )
    path.write_text(page, encoding="utf-8", newline="\n")


def answer(content: Row) -> str:
    """May it be used, and if not, why not."""
    found, subject, rig = rows(content, "findings"), text(content, "subject"), bool(group(content, "rig"))
    faults, warnings = ([f for f in found if text(f, "level") == level] for level in ("fault", "warning"))
    if faults:
        first, *more = faults
        rest = f" Faulty as well: {_named(more)}." if more else ""
        return f"{subject} {'is not ready' if rig else 'cannot be trusted yet'}: {_phrase(first)}.{rest}"
    if warnings:
        fine = f"Nothing stops a run with {subject}" if rig else f"{subject} can be used"
        return f"{fine}; look first at {_named(warnings)}."
    if not found:
        return f"{subject}: there was nothing to check."
    return f"{subject} is {'ready' if rig else 'in order'}: {counted(len(found), 'check')}, nothing wrong."


def _phrase(finding: Row) -> str:
    where, what = text(finding, "where"), text(finding, "text")
    return what if where.rsplit(": ", 1)[-1] in what else f"{where}, {what}"


def _named(found: Sequence[Row]) -> str:
    """``gnss (rate), left (delay) and 3 more``."""
    shown = [f"{text(f, 'where')} ({text(f, 'check')})" for f in found]
    if len(shown) > MOST_NAMED:
        shown = [*shown[: MOST_NAMED - 1], f"{len(shown) - MOST_NAMED + 1} more"]
    return " and ".join([", ".join(shown[:-1]), shown[-1]] if len(shown) > 1 else shown)


def _verdicts(found: Sequence[Row]) -> Verdicts:
    return Verdicts([Verdict(*(text(f, key) for key in ("level", "where", "check", "text", "advice"))) for f in found])


def _facts(content: Row) -> list[tuple[str, str]]:
    rig, levels = group(content, "rig"), [text(f, "level") for f in rows(content, "findings")]
    facts = [("rig", text(rig, "name"))] if rig else []
    logs = rows(content, "logs")
    for log in logs:
        label = "recorded" if len(logs) == 1 else f"recorded in {text(log, 'name')}"
        facts.append((label, formatting.duration(number(log, "duration"))))
    return [*facts, *((word, str(levels.count(level))) for level, word in LEVELS.items())]


def _count(log: Row) -> int:
    return sum(len(rows(log, key)) for key in ("pauses", "shafts", "push", "sensors", "signals")) + 2


def _evidence(canvas: Canvas) -> list[Section]:
    """One section for each kind of curve, with a tab a log; without tabs where there is one log."""
    measured = ("measured", "measured")
    return [
        _section(canvas, "push", "Does the boat go where its thrusters push?", _push, 170, [
            measured, ("line", "as the thrusters push, through a first-order lag and to scale")],
            "Two curves that go together: sides and signs are right. Mirror images: swapped, or a wrong sign."),
        _section(canvas, "shafts", "Do the shafts do what they are told?", _shafts, 132, [
            ("before", "what it is told"), ("line", "what the shaft does")]),
        _section(canvas, "sensors", "Do the sensors agree?", _sensors, 132, [
            ("measured", "change of heading in 1 s, of position in 5 s"), ("line", "gyro, velocity as received")],
            "One motion by two sensors. A factor between them is a unit; a shift in time, a sensor that comes late."),
        _section(canvas, "signals", "What the sensors said", _signals, 100),
        _section(canvas, "pauses", "Time between samples", _pauses, 90, [
            ("line", "from sample to sample"), ("before", "by the rig's rate_hz")],
            "A peak is a pause; a level above the dashed line, a device that is slower than the rig says."),
    ]


def _section(
    canvas: Canvas, key: str, title: str, make: Make, height: int, items: Sequence[tuple[str, str]] = (), lead: str = ""
) -> Section:
    found = []
    for log in rows(canvas.result, "logs"):
        panels, blocks = make(log, canvas.budget.points), list[Any]()
        if panels:
            figure, high = stacked(panels, "time since the start of the log [s]", panel_height=height)
            blocks.append(Grid([canvas.plot(figure, high, f"{title} {text(log, 'name')}")], 320))
        found.append((text(log, "name"), blocks))
    blocks = found[0][1] if len(found) == 1 else tabbed(found)
    return Section(key, title, [*([Key(items)] if items else []), *blocks] if blocks else [], lead)


def _push(log: Row, limit: int) -> list[Panel]:
    panels = []
    for row in rows(log, "push"):
        factor, unit = formatting.degrees_for(text(row, "unit"))
        t, measured, expected = (np.asarray(row[key]) for key in ("t", "measured", "expected"))
        traces = [dots(t, factor * measured, "measured", limit), line(t, factor * expected, "as pushed", limit)]
        panels.append(Panel(_capital(text(row, "title")) + formatting.bracket(unit), traces))
    return panels


def _shafts(log: Row, limit: int) -> list[Panel]:
    panels = []
    for row in rows(log, "shafts"):
        told = _held(np.asarray(row["t_cmd"]), np.asarray(row["n_cmd"]), float(row["end"]))
        traces = [line(*told, "told", limit, color=BEFORE, dash="dash"),
                  line(np.asarray(row["t"]), np.asarray(row["n"]), "turns", limit)]
        panels.append(Panel(f"{_capital(text(row, 'name'))}, part of full speed", traces))
    return panels


def _held(t: Array, value: Array, end: float) -> tuple[Array, Array]:
    """The corners of a command that is held until the next one."""
    return np.append(np.repeat(t, 2)[1:], max(end, float(t[-1]))), np.repeat(value, 2)


def _sensors(log: Row, limit: int) -> list[Panel]:
    panels = []
    for row in rows(log, "sensors"):
        factor, unit = formatting.degrees_for(text(row, "unit"))
        t, one, other = (np.asarray(row[key]) for key in ("t", "one", "other"))
        first, second = texts(row, "names")
        traces = [dots(t, factor * one, first, limit), line(t, factor * other, second, limit)]
        panels.append(Panel(_capital(text(row, "title")) + formatting.bracket(unit), traces))
    return panels


def _signals(log: Row, limit: int) -> list[Panel]:
    panels = []
    for row in rows(log, "signals"):
        factor, unit = formatting.degrees_for(text(row, "unit"))
        name, t, value = text(row, "channel"), np.asarray(row["t"]), np.asarray(row["value"])
        shown = np.degrees(np.unwrap(value)) if row.get("angle") is True and unit == "deg" else factor * value
        title = formatting.titled(name) if name in formatting.MEANINGS else _capital(name.replace("_", " "))
        panels.append(Panel(title + formatting.bracket(unit), [dots(t, shown, name, limit)]))
    return panels


def _pauses(log: Row, limit: int) -> list[Panel]:
    panels = []
    for row in rows(log, "pauses"):
        t, pause, expected = np.asarray(row["t"]), 1e3 * np.asarray(row["value"]), number(row, "expected")
        traces, top = [dots(t, pause, "pause", limit, color=MODEL)], float(pause.max())
        if expected is not None:
            ends, top = np.array([t[0], t[-1]]), max(top, 1e3 * expected)
            traces.append(line(ends, np.full(2, 1e3 * expected), "by the rig", 2, color=BEFORE, dash="dash"))
        panels.append(Panel(f"{text(row, 'source')} [ms]", traces, {"range": [0.0, 1.2 * top]}))
    return panels


def _mission(canvas: Canvas) -> Section:
    """The dry run: what will be told, and the way that the boat is expected to take."""
    mission = group(canvas.result, "mission")
    if not mission:
        return Section("mission", "", [])
    t, n = np.asarray(mission["t"]), np.asarray(mission["n"])
    panels = []
    for column, name in enumerate(texts(mission, "thrusters")):
        told = line(*_held(t, n[:, column], float(mission["end"])), name, canvas.budget.points)
        panels.append(Panel(f"{_capital(name)}: command, part of full speed", [told], {"range": [-1.08, 1.08]}))
    figure, high = stacked(panels, "time since the start of the mission [s]")
    blocks: list[Any] = [Grid([canvas.plot(figure, high, "Commands of the mission")], 320)]
    x, y = array(mission, "x"), array(mission, "y")
    if x is not None and y is not None:
        track = single(_way(mission, x, y), "east of the start [m]", "north of the start [m]", hovermode="closest",
                       yaxis={"scaleanchor": "x"}, showlegend=True, legend={"orientation": "h", "y": 1.08})
        words = f"Predicted by {text(mission, 'by')}, from rest, heading north. Wind and current add to it."
        blocks += [Grid([canvas.plot(track, 540, "Predicted track and fence")], 320, "narrow"), Prose(words, "caption")]
    return Section("mission", f"The mission, run dry: {text(mission, 'name')}", blocks)


def _way(mission: Row, x: Array, y: Array) -> list[drawing.Trace]:
    x, y = x - x[0], y - y[0]
    traces = [line(y, x, "predicted track", 4000)]
    radius, fence = array(mission, "radius"), number(mission, "fence")
    angle = np.linspace(0.0, 2.0 * np.pi, 121)
    if radius is not None and radius.size == x.size:
        wide = int(np.argmax(np.hypot(x, y) + radius))
        around = (y[wide] + radius[wide] * np.sin(angle), x[wide] + radius[wide] * np.cos(angle))
        traces.append(line(*around, "95 % of the boats, where farthest", 200, color=drawing.FAINT))
    if fence is not None:
        circle = (fence * np.sin(angle), fence * np.cos(angle))
        traces.append(line(*circle, "fence", 200, color=drawing.AMBER, dash="dash"))
    marker = {"size": 9, "color": drawing.MEASURED, "symbol": "square"}
    traces.append({"type": "scatter", "mode": "markers", "x": [0.0], "y": [0.0], "name": "start", "marker": marker})
    return [trace | {"showlegend": True} for trace in traces]


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]
