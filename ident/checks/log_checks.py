"""Checks of a log before any fit, by the motion in it: part of `seatrial check`, and what every fit of a boat begins
with."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from daq.checks import FAULT, Finding, check_devices
from daq.errors import SeatrialError
from daq.log import Log, open_log
from daq.samples import Command, Esc
from ident.checks.frames import check_accelerometer, check_frames
from ident.checks.motion import check_motion, turning
from ident.checks.sensors import (
    Channels,
    check_time_scale,
    gyro_and_heading,
    position_and_velocity,
    sensor_matches,
    velocity_and_acceleration,
)
from ident.checks.shafts import check_shafts
from ident.checks.signals import check_frozen, check_intervals, check_ranges, check_smoothing
from ident.data import channels
from ident.numerics import Array

# Starboard positions (m) of an imported log's thrusters, of which only the side is known.
IMPORTED = {"left": -1.0, "right": 1.0}
# Faults after which a fit means nothing: frames, signs, units, sides, time, and signals that measure nothing.
SPOILING = frozenset({
    "time-scale", "times-not-increasing", "lost-zeros", "clock-jumps", "clock-ran-back",
    "angle-in-degrees", "n-out-of-range", "positions-in-degrees", "velocity-unit", "velocity-and-acceleration-scale",
    "gyro-scale", "shaft-speed-in-rad-per-s", "shaft-speed-scale", "shaft-sign-reversed",
    "heading-sense", "heading-offset", "heading-half-turn", "gyro-sign-reversed", "position-axes", "velocity-axes",
    "position-and-velocity-axes", "frames-mirrored", "velocity-earth-fixed", "body-velocity-axes", "acceleration-axes",
    "thruster-sides-swapped", "thruster-sign-reversed", "channel-frozen", "channel-constant", "sensor-stuck",
    "log-copied",
})  # fmt: skip
COPIED, FEWEST_TRIPLES = 0.5, 50  # part of a log's triples of neighbouring values that another log has, too


def spoils_a_fit(finding: Finding) -> bool:
    """Whether a fit to a log with this finding means nothing."""
    return finding.level == FAULT and finding.code in SPOILING


def check_log(path: Path | str) -> list[Finding]:
    """Findings of one log; that its signals cannot be read is one, too."""
    try:
        with open_log(path) as log:
            found = channels(log)
            return [*_mute(log), *check_signals(found, sides_of(log))]
    except SeatrialError as error:
        return [Finding("warning", "log-not-readable", "motion", Path(path).name, str(error))]


def check_signals(c: Channels, sides: Mapping[str, float]) -> Iterator[Finding]:
    """Findings of channels (ident.data.log_channels); ``sides``: thruster -> position to starboard [m].

    What needs another signal to be right is not asked where that one is wrong: time, units, frames, thrusters.
    """
    found = list(check_intervals(c))
    yield from found
    if found:
        return
    ranges = [*check_ranges(c), *check_frozen(c)]
    yield from ranges
    yield from check_smoothing(c)
    matches = sensor_matches(c)
    clock = check_time_scale(matches)
    if clock is not None:
        yield clock
        return
    of_sensors = [
        *gyro_and_heading(c, matches.heading),
        *velocity_and_acceleration(c, matches.velocity),
        *position_and_velocity(c, matches.position),
    ]
    yield from of_sensors
    of_shafts = list(check_shafts(c))
    yield from of_shafts
    if any(f.level == "fault" and f.check in ("units", "stuck") for f in (*ranges, *of_sensors)):
        return
    of_frames = list(check_frames(c, matches.heading, turning(c, sides)))
    yield from of_frames
    of_motion = [] if of_frames else list(check_motion(c, sides, {f.where for f in of_shafts if f.check == "dead"}))
    yield from of_motion
    if not of_frames and all(f.level == "ok" for f in of_motion):
        yield from check_accelerometer(c, matches.velocity)


def device_faults(path: Path) -> list[Finding]:
    """Faults of a log's devices, and thrusters of which nothing was heard."""
    with open_log(path) as log:
        return [f for f in (*check_devices(log), *_mute(log)) if f.level == FAULT]


def check_copies(logs: Sequence[tuple[str, Channels]]) -> list[Finding]:
    """Logs (name, channels) that are copies, or parts, of one before them: measured noise never repeats."""
    known: list[tuple[str, dict[str, set[bytes]]]] = []
    found = []
    for name, c in logs:
        own = {n: _triples(c[n].value) for n in ("r", "psi", "x", "y", "vx", "ax", "u", "force") if n in c}
        own = {n: triples for n, triples in own.items() if len(triples) > FEWEST_TRIPLES}
        for other, its in known:
            shares = [len(own[n] & its[n]) / min(len(own[n]), len(its[n])) for n in own if n in its]
            if shares and np.median(shares) > COPIED:
                text = f"the same measurements as in {other}: a copy proves nothing"
                found.append(Finding(FAULT, "log-copied", "log", name, text, "give a log of another run"))
                break
        known.append((name, own))
    return found


def _triples(value: Array) -> set[bytes]:
    """Three neighbouring values each, where they differ: (n,) floats."""
    rows = np.column_stack([value[:-2], value[1:-1], value[2:]])
    moving = (rows[:, 0] != rows[:, 1]) & (rows[:, 1] != rows[:, 2])
    return {row.tobytes() for row in np.ascontiguousarray(rows[moving])}


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
