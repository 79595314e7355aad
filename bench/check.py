"""Before anything moves: is the plan within the rig's limits, are the devices alive and at their rates?"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.mission import Mission
from daq.acquire import Acquisition, Status
from daq.clock import RunClock
from daq.errors import SeatrialError
from daq.rig import Device, Rig

AWAIT_S = 10.0  # wall seconds for every device to say something
POLL_S = 0.02
RATE_TOLERANCE = 0.2  # a rate within this part of the expected one is good
UNPARSED_PART, ONE_FRAME_BYTES = 0.01, 200  # bytes not understood that are no problem: a frame begun before us


def dry_run(mission: Mission, rig: Rig) -> None:
    """Raise SeatrialError when the rig has no such thruster or a set-point is beyond a limit; moves nothing."""
    t, n = mission.setpoints()
    for column, name in enumerate(mission.thrusters):
        rig.thruster(name)
        beyond = np.flatnonzero(np.abs(n[:, column]) > rig.limits.n_max)
        if beyond.size:
            k = int(beyond[0])
            raise SeatrialError(
                f"{rig.path}: the plan tells {name} n = {n[k, column]:+.3f} at {t[k]:.2f} s, and limits.n_max is"
                f" {rig.limits.n_max:g}; lower the plan or the limit was wrong"
            )


def silent_devices(rig: Rig, status: Status, thrusters: Sequence[str]) -> list[str]:
    """What has not said anything yet: devices, and the mission's thrusters by node."""
    silent = []
    for device in rig.devices:
        port = status.ports.get(device.name)
        if port is None or port.samples == 0:
            silent.append(f"{device.name} ({device.port})")
    for name in thrusters:
        thruster = rig.thruster(name)
        if (thruster.device, thruster.node) not in status.latest:
            silent.append(f"thruster {name} (node {thruster.node} on {thruster.device})")
    return silent


def await_devices(
    rig: Rig, acquisition: Acquisition, thrusters: Sequence[str], wait: Callable[[float], None]
) -> list[str]:
    """Wait until every device has spoken; returns their names. Raises SeatrialError that names the silent ones."""
    deadline = time.monotonic() + AWAIT_S
    while silent := silent_devices(rig, acquisition.status(), thrusters):
        if time.monotonic() > deadline:
            raise SeatrialError(
                f"nothing from {', '.join(silent)} in {AWAIT_S:g} s; check power, cable, port and baud rate"
            )
        wait(POLL_S)
    return [device.name for device in rig.devices]


@dataclass(frozen=True)
class DeviceCheck:
    """What was found about one device."""

    device: Device
    rate_hz: float
    age_s: float
    problem: str  # empty when there is none


def check_rig(rig: Rig, wall_s: float) -> list[DeviceCheck]:
    """Listen to every device for `wall_s` wall seconds and compare with the rig; commands nothing."""
    clock = RunClock(rig.speed)
    with (
        tempfile.TemporaryDirectory(prefix="seatrial-check-") as folder,
        Acquisition(rig, Path(folder) / "check.mcap", clock=clock) as acquisition,
    ):
        clock.sleep_until(clock.now() + wall_s * clock.speed)
        status = acquisition.status()
    return [_check(device, status) for device in rig.devices]


def _check(device: Device, status: Status) -> DeviceCheck:
    port = status.ports.get(device.name)
    if port is None or port.samples == 0:
        received = 0 if port is None else port.bytes_in
        problem = f"{received} bytes, no sample: wrong baud rate or protocol?" if received else "nothing received"
        return DeviceCheck(device, 0.0, float("inf"), (port.message if port else "") or problem)
    problems = []
    if abs(port.rate - device.rate_hz) > RATE_TOLERANCE * device.rate_hz:
        problems.append(f"rate {port.rate:.1f} Hz, expected {device.rate_hz:g}")
    if port.checksum_errors > 1:  # one may be the frame that was under way when the port was opened
        problems.append(f"{port.checksum_errors} checksum errors")
    if port.unparsed_bytes > UNPARSED_PART * port.bytes_in + ONE_FRAME_BYTES:
        problems.append(f"{port.unparsed_bytes} of {port.bytes_in} bytes not understood")
    if port.message:
        problems.append(port.message)
    if port.dropped:
        problems.append(f"{port.dropped} frames dropped")
    return DeviceCheck(device, port.rate, port.age, "; ".join(problems))
