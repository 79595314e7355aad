"""The report of a check: findings and dry run go to ident as a file, for bench imports nothing of ident."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from daq.checks import Finding
from daq.config import Mission
from daq.errors import SeatrialError
from daq.rig import Rig

FORMAT = "seatrial-check 1"


def as_json(found: Sequence[Finding], **more: Any) -> str:
    """Findings as `seatrial check --json` prints them; ``more``: what only a report shows."""
    return json.dumps({"format": FORMAT, "findings": [finding._asdict() for finding in found], **more}, indent=2)


def write_report(
    context: click.Context, found: Sequence[Finding], logs: Sequence[Path], out: Path, about: dict[str, Any]
) -> None:
    """Ask ident through the command tree for the page; raises SeatrialError where ident is not installed."""
    root = context.find_root().command
    ident = root.get_command(context, "ident") if isinstance(root, click.Group) else None
    command = ident.get_command(context, "check-page") if isinstance(ident, click.Group) else None
    if command is None:
        raise SeatrialError("--report: there is no `seatrial ident check-page` here")
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="seatrial-check-") as folder:
        findings = Path(folder) / "findings.json"
        findings.write_text(as_json(found, **about), encoding="utf-8")
        context.invoke(command, logs=tuple(logs), findings=findings, out=out)


def about_rig(rig: Rig, mission: Mission | None) -> dict[str, Any]:
    """What the page of a rig says of it, and the dry run of a mission: commands, way and fence."""
    told: dict[str, Any] = {"subject": rig.path.name, "rig": {"name": rig.name}}
    return told if mission is None else told | {"mission": _dry(mission, rig)}


def _dry(mission: Mission, rig: Rig) -> dict[str, Any]:
    t, n = mission.setpoints()
    told: dict[str, Any] = {
        "name": mission.name, "thrusters": list(mission.thrusters), "t": t.tolist(), "n": n.tolist(),
        "end": mission.end, "fence": rig.limits.radius_m,
    }
    if mission.prediction is not None:
        p = mission.prediction
        way = {"x": p.x.tolist(), "y": p.y.tolist(), "radius": p.radius.tolist()}
        return told | way | {"by": f"the design, by model {p.model}"}
    from bench.preflight.mission_checks import NEEDED, track

    if all(name in rig.vehicle for name in NEEDED) and all(name in _names(rig) for name in mission.thrusters):
        _, x, y = track(mission, rig)
        return told | {"x": x.tolist(), "y": y.tolist(), "by": "the rig's nominal vehicle in still water"}
    return told


def _names(rig: Rig) -> set[str]:
    return {thruster.name for thruster in rig.thrusters}
