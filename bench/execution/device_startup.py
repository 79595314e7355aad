"""Waiting for the devices: before anything moves, each has to send a sample, and each limit needs its source."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from bench.execution.safety_guard import SafetyGuard
from daq.acquisition import Acquisition, Status
from daq.errors import SeatrialError
from daq.rig import Rig

AWAIT_S = 10.0  # wall seconds for the first sample of every device, and then for that of every limit
POLL_S = 0.02


def silent_devices(rig: Rig, status: Status, thrusters: Sequence[str]) -> list[str]:
    """What has not sent anything yet: devices, and the mission's thrusters by node."""
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
    """Wait for a sample of every device; returns their names. Raises SeatrialError that names the silent ones."""
    deadline = time.monotonic() + AWAIT_S
    while silent := silent_devices(rig, acquisition.status(), thrusters):
        if time.monotonic() > deadline:
            raise SeatrialError(
                f"nothing from {', '.join(silent)} in {AWAIT_S:g} s; check power, cable, port and baud rate"
            )
        wait(POLL_S)
    return [device.name for device in rig.devices]


def await_limits(rig: Rig, acquisition: Acquisition, guard: SafetyGuard, wait: Callable[[float], None]) -> None:
    """Wait until every limit has a source that has spoken. Raises SeatrialError that names limit, source and remedy."""
    deadline = time.monotonic() + AWAIT_S
    while unwatched := guard.unwatched(status := acquisition.status()):
        if time.monotonic() > deadline:
            more = f" (and {len(unwatched) - 1} more)" if len(unwatched) > 1 else ""
            raise SeatrialError(f"{rig.path}: {unwatched[0].refusal(status.t)}{more}")
        wait(POLL_S)
