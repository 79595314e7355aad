"""Checks of sensors and thrusters by the motion in a log, before any fit: part of `seatrial check`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from daq.checks import Finding
from daq.errors import SeatrialError
from daq.log import Log, open_log
from daq.samples import Command, Esc
from ident.checks.motion import check_motion
from ident.checks.sensors import Channels, gyro_and_heading, position_and_velocity, velocity_and_acceleration
from ident.checks.shafts import check_shafts
from ident.data import channels

# Starboard positions (m) of an imported log's thrusters, of which only the side is known.
IMPORTED = {"left": -1.0, "right": 1.0}


def check_log(path: Path | str) -> list[Finding]:
    """Findings of one log; that its signals cannot be read is one, too."""
    try:
        with open_log(path) as log:
            found = channels(log)
            return [*_mute(log), *findings(found, sides_of(log))]
    except SeatrialError as error:
        return [Finding("warning", "log-not-readable", "motion", Path(path).name, str(error))]


def findings(found: Channels, sides: Mapping[str, float]) -> Iterator[Finding]:
    """Findings of channels (ident.data.log_channels); ``sides``: thruster -> position to starboard [m]."""
    yield from gyro_and_heading(found)
    yield from velocity_and_acceleration(found)
    yield from position_and_velocity(found)
    of_shafts = list(check_shafts(found))
    yield from of_shafts
    yield from check_motion(found, sides, {f.where for f in of_shafts if f.check == "dead"})


def sides_of(log: Log) -> dict[str, float]:
    """Thruster -> position to starboard [m] by the log's rig; of an imported log only the side is known."""
    rig = log.rig
    return {t.name: t.position_m[1] for t in rig.thrusters} if rig else IMPORTED


def _mute(log: Log) -> Iterator[Finding]:
    """Thrusters that were commanded and whose controllers never said a word."""
    rig = log.rig
    for thruster in rig.thrusters if rig else ():
        device, node = thruster.device, thruster.node
        if thruster.output is None and node in log.nodes(Command, device) and node not in log.nodes(Esc, device):
            text = "commanded, and its controller has never said a word"
            yield Finding(
                "fault", "controller-never-heard", "dead", thruster.name, text, "its node on the bus, power and cable"
            )
