"""Logs read into memory: their signals, their rig and mission, and the provenance that goes into results."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from daq.errors import SeatrialError
from daq.log import Log, open_log
from daq.rig import Rig
from ident.data.log_channels import PropulsionInput, channels, propulsion_input
from ident.data.record import LogSegment


@dataclass(frozen=True)
class LoadedLog:
    """A log in memory: its signals, and what the report says of it. ``propulsion``: what it says of its thrusters."""

    run: LogSegment
    about: dict[str, Any]
    holds: Mapping[str, str]
    rig: Rig | None
    propulsion: PropulsionInput | None = None
    segments: tuple[tuple[float, str], ...] = ()  # steps of its mission: when each began [s of the log], and its name
    vehicle: Mapping[str, float] = field(default_factory=dict)  # what rig or map know of the boat, parameters by name
    path: Path = Path()


def load_all(logs: Sequence[Path], validate: Sequence[Path]) -> tuple[list[LoadedLog], list[LoadedLog]]:
    """The logs to fit, and those to judge by; the same log in both is an error."""
    same = {p.resolve() for p in logs} & {p.resolve() for p in validate}
    if same:
        raise SeatrialError(f"{sorted(same)[0].name}: the same log to fit and to validate proves nothing; give another")
    return [load_run(p, "estimation") for p in logs], [load_run(p, "validation") for p in validate]


def load_run(path: Path, role: str, t_from: float | None = None, t_to: float | None = None) -> LoadedLog:
    """Times ``t_from`` and ``t_to`` count from the start of the log."""
    with open_log(path) as log:
        found = channels(log)
        if not found:
            raise SeatrialError(f"{path}: no signal that ident knows; see what it holds with `seatrial info {path}`")
        start = min(c.t[0] for c in found.values())
        moved = {n: replace(c, t=c.t - start) for n, c in found.items()}
        about = {
            "path": path.name,
            "sha256": log.sha256,
            "role": role,
            "name": path.stem,
            "duration": log.duration,
            "rig": log.rig.name if log.rig else None,
            "mission": _mission_name(log),
            "warnings": list(log.warnings),
        }
        holds = {n: c.hold or _hold(log, n) for n, c in found.items()}
        segments = tuple((t - start, text) for t, kind, text in log.events() if kind == "segment")
        propulsion = propulsion_input(log, moved, holds)
        run = LogSegment(path.stem, moved, t_from, t_to)
        return LoadedLog(run, about, holds, log.rig, propulsion, segments, log.vehicle, path)


def _hold(log: Log, name: str) -> str:
    try:
        return str(log.hold(name))
    except (KeyError, SeatrialError):
        return ""


def _mission_name(log: Log) -> str | None:
    text = log.attachments.get("mission.toml")
    if text is None:
        return None
    try:
        return str(tomllib.loads(text.decode()).get("name"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError):
        return None
