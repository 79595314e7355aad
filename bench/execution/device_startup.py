"""Start-up checks before the first set-point.

Each device must send samples at the rate in the rig, each limit needs its source, and no thruster may turn.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from seatrial.bench.execution.safety_guard import SafetyGuard
from seatrial.daq.acquisition import Acquisition, Status
from seatrial.daq.errors import SeatrialError
from seatrial.daq.rig import Rig

AWAIT_S = 10.0  # wall seconds to wait for the first sample of every device, and again for the source of every limit
POLL_S = 0.02  # wall seconds between two checks


def silent_devices(rig: Rig, status: Status, thrusters: Sequence[str]) -> list[str]:
    """Return the devices and thrusters that have not sent any sample yet.

    Parameters
    ----------
    rig : Rig
        The rig with its devices and thrusters.
    status : Status
        Newest status of the acquisition.
    thrusters : sequence of str
        Names of the thrusters to check.

    Returns
    -------
    list of str
        A text for each silent device (name, port and fault if known) and for each silent thruster (name and node).
    """
    silent = []
    for device in rig.devices:
        port = status.ports.get(device.name)
        if port is None or port.samples == 0:
            fault = f": {port.message}" if port is not None and port.message else ""
            silent.append(f"{device.name} ({device.port}{fault})")
    for name in thrusters:
        thruster = rig.thruster(name)
        if (thruster.device, thruster.node) not in status.latest:
            silent.append(f"thruster {name} (node {thruster.node} on {thruster.device})")
    return silent


def await_devices(
    rig: Rig, acquisition: Acquisition, thrusters: Sequence[str], wait: Callable[[float], None]
) -> list[str]:
    """Wait for a sample of every device and of every named thruster, and return the names of all devices.

    Parameters
    ----------
    rig : Rig
        The rig.
    acquisition : Acquisition
        The running acquisition.
    thrusters : sequence of str
        Names of the thrusters whose speed controller or output must be reported.
    wait : Callable
        Waits for the given wall seconds. It may raise an error that ends the run.

    Raises
    ------
    SeatrialError
        If a device or thruster sends no sample within 10 s. The message names all silent ones.
    """
    deadline = time.monotonic() + AWAIT_S
    while silent := silent_devices(rig, acquisition.status(), thrusters):
        if time.monotonic() > deadline:
            raise SeatrialError(
                f"nothing from {', '.join(silent)} in {AWAIT_S:g} s; check power, cable, port and baud rate"
            )
        wait(POLL_S)
    return [device.name for device in rig.devices]


def await_limits(rig: Rig, acquisition: Acquisition, guard: SafetyGuard, wait: Callable[[float], None]) -> None:
    """Wait until every limit has a source, every device its rate, and no thruster turns.

    A source is a device that reports the limited quantity. The rates are compared with `rate_hz` of the rig.

    Parameters
    ----------
    rig : Rig
        The rig, for the message.
    acquisition : Acquisition
        The running acquisition.
    guard : SafetyGuard
        Safety guard, which gets every status.
    wait : Callable
        Waits for the given wall seconds. It may raise an error that ends the run.

    Raises
    ------
    SeatrialError
        If one of these conditions is not fulfilled after 10 s. The message contains the first one and its remedy.
    """
    deadline = time.monotonic() + AWAIT_S
    while reasons := _reasons_against_start(guard, acquisition.status()):
        if time.monotonic() > deadline:
            more = f" (and {len(reasons) - 1} more)" if len(reasons) > 1 else ""
            raise SeatrialError(f"{rig.path}: {reasons[0]}{more}")
        wait(POLL_S)


def _reasons_against_start(guard: SafetyGuard, status: Status) -> list[str]:
    """Return the reasons why no set-point may be sent at this status, with remedies; empty if the run may start.

    The reasons are, in this order, turning thrusters, limits without a source, and devices with a wrong rate.
    """
    turning = [
        f"thruster {text} though nothing was commanded: stop it, and look for another program that commands it; "
        'unwatched = ["telemetry"] in [limits] allows it'
        for text in guard.turning(status)
    ]
    unwatched = [limit.refusal(status.t) for limit in guard.unwatched(status)]
    return [*turning, *unwatched, *guard.rate_conflicts(status)]
