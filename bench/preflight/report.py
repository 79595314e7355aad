"""Output of a check as JSON and as a page (HTML)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from seatrial.daq.checks import CheckReport, DryRun, Finding, PredictedTrack
from seatrial.daq.config import Mission
from seatrial.daq.rig import Rig

FORMAT = "seatrial-check 1"


class MotionChecks(Protocol):
    """Interface of the checks that `seatrial.ident` provides for the command `check`.

    `seatrial.command_line` puts an object of this kind into the context of the command. The package bench must not
    import ident, which may not be installed. Both methods raise SeatrialError if ident is not installed.
    """

    def check_log(self, path: Path) -> list[Finding]:
        """Return the findings on sensors and thrusters from the motion in the log ``path``."""
        ...

    def write_check_page(self, report: CheckReport, out: Path) -> None:
        """Write the page (HTML) of the check ``report`` to the file ``out``, with curves from its logs."""
        ...


def as_json(found: Sequence[Finding]) -> str:
    """Return findings as the JSON text that `seatrial check --json` prints: an object with "format" and "findings"."""
    return json.dumps({"format": FORMAT, "findings": [finding._asdict() for finding in found]}, indent=2)


def dry_run_of(mission: Mission, rig: Rig) -> DryRun:
    """Return the dry run of a mission: its commands, its duration, the fence of the rig, and its predicted track."""
    t, n = mission.setpoints()
    return DryRun(
        mission.name, tuple(mission.thrusters), t, n, mission.end, rig.limits.radius_m, _predicted_track(mission, rig)
    )


def _predicted_track(mission: Mission, rig: Rig) -> PredictedTrack | None:
    """Return the predicted track of a mission; None if it cannot be predicted.

    The prediction of the mission's design takes precedence over a simulation of the rig's nominal vehicle. A track
    cannot be predicted if [vehicle] lacks a parameter, or the rig lacks a thruster of the mission.
    """
    if mission.prediction is not None:
        p = mission.prediction
        return PredictedTrack(p.x, p.y, f"the design, by model {p.model}", p.radius)
    from seatrial.bench.preflight.mission_checks import NEEDED, track

    if all(name in rig.vehicle for name in NEEDED) and all(name in _thruster_names(rig) for name in mission.thrusters):
        _, x, y = track(mission, rig)
        return PredictedTrack(x, y, "the rig's nominal vehicle without current")
    return None


def _thruster_names(rig: Rig) -> set[str]:
    """Return the names of all thrusters of a rig."""
    return {thruster.name for thruster in rig.thrusters}
