"""Output of a check as JSON and as a page (HTML)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from seatrial.daq.checks import CheckReport, DryRun, Finding, PredictedTrack
from seatrial.daq.config import Mission
from seatrial.daq.log import TimeWindow
from seatrial.daq.rig import Rig

FORMAT = "seatrial-check 1"


class MotionChecks(Protocol):
    """Interface of the checks of recorded motion that the package `seatrial.ident` provides for `seatrial check`.

    `seatrial.command_line` puts an object of this kind into the context of the command, because the package bench must
    not import ident, which may not be installed. All methods raise SeatrialError if ident is not installed.
    """

    def check_log(self, path: Path, window: TimeWindow) -> list[Finding]:
        """Return the findings on the motion in the log ``path``: whether its sensors and thrusters agree.

        Only the interval of time ``window`` of the log is examined.

        Raises SeatrialError if the package ident is not installed.
        """
        ...

    def differences(self) -> list[tuple[str, Finding]]:
        """Return the findings on the checked logs together, each with the name of its log or the number of logs.

        Raises SeatrialError if the package ident is not installed.
        """
        ...

    def write_check_page(self, report: CheckReport, out: Path) -> None:
        """Write the findings in ``report`` to the file ``out`` as a page (HTML), with curves from its logs.

        Raises SeatrialError if the package ident is not installed.
        """
        ...


def as_json(found: Sequence[Finding]) -> str:
    """Return findings as the JSON text that `seatrial check --json` prints: an object with "format" and "findings".

    The findings keep their order. Each is an object with the fields of `Finding`.
    """
    return json.dumps({"format": FORMAT, "findings": [finding._asdict() for finding in found]}, indent=2)


def dry_run_of(mission: Mission, rig: Rig) -> DryRun:
    """Return the content of a report on a mission that is not run: commands, duration, geofence and predicted track.

    The geofence is `limits.radius_m` of the rig; None without one. The track is None if it cannot be predicted.
    """
    t, n = mission.setpoints()
    return DryRun(
        mission.name, tuple(mission.thrusters), t, n, mission.end, rig.limits.radius_m, _predicted_track(mission, rig)
    )


def _predicted_track(mission: Mission, rig: Rig) -> PredictedTrack | None:
    """Return the predicted track of a mission; None if it cannot be predicted.

    It is the prediction of the mission's experiment design if there is one, else a simulation of the rig's nominal
    vehicle. The simulation is not possible if [vehicle] of the rig lacks a parameter, or the rig lacks a thruster of
    the mission.
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
