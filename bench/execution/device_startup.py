"""Start-up checks before the first set-point.

Each device must send samples at the rate in the rig, each limit needs its source, and no thruster may turn.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from seatrial.bench.execution.safety_guard import SafetyGuard
from seatrial.daq.acquisition import Acquisition, Status
from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.rig import Rig

AWAIT_S = 10.0  # wall seconds to wait for the first sample of every device, and again for the source of every limit
POLL_S = 0.02  # wall seconds between two checks


def silent_devices(rig: Rig, status: Status, thrusters: Sequence[str]) -> list[str]:
    """Return the devices of a rig, and which of the named thrusters, have not sent any sample yet.

    A thruster sends a sample when its speed controller, or the autopilot for its output, reports.

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
        A text for each silent device (name, port, and fault of the port if there is one), then for each silent thruster
        (name, node and device). It is empty if all have sent a sample.
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
        The running acquisition, which records the devices.
    thrusters : sequence of str
        Names of the thrusters of which a sample is needed, from the speed controller or the output of an autopilot.
    wait : Callable
        Function that waits for the given wall seconds. It may raise an error that ends the run.

    Returns
    -------
    list of str
        Names of all devices of the rig.

    Raises
    ------
    SeatrialError
        If a device or thruster sends no sample within 10 s (wall). The message names all silent ones.
    """
    deadline = time.monotonic() + AWAIT_S
    while silent := silent_devices(rig, acquisition.status(), thrusters):
        if time.monotonic() > deadline:
            raise SeatrialError(
                f"nothing from {', '.join(silent)} in {AWAIT_S:g} s; check its power, cable, port and baud rate"
            )
        wait(POLL_S)
    return [device.name for device in rig.devices]


def await_limits(rig: Rig, acquisition: Acquisition, guard: SafetyGuard, wait: Callable[[float], None]) -> None:
    """Wait until thrust may be commanded: every limit has a source, every device has its rate, and no thruster turns.

    A source of a limit is a device that reports the limited quantity. A device has its rate if it sends samples at
    `rate_hz` of the rig, within a factor of 3; a device whose rate is not measured yet is not waited for.

    Parameters
    ----------
    rig : Rig
        The rig. Only its path is used, for the message.
    acquisition : Acquisition
        The running acquisition, which records the devices.
    guard : SafetyGuard
        Safety guard of the run, which checks every status.
    wait : Callable
        Function that waits for the given wall seconds. It may raise an error that ends the run.

    Raises
    ------
    SeatrialError
        If one of these conditions is not fulfilled after 10 s (wall). The message contains the first such condition
        with its remedy, and the number of further ones.
    """
    deadline = time.monotonic() + AWAIT_S
    while reasons := _reasons_against_start(guard, acquisition.status()):
        if time.monotonic() > deadline:
            more = f" (and {counted(len(reasons) - 1, 'more reason')})" if len(reasons) > 1 else ""
            raise SeatrialError(f"{rig.path}: {reasons[0]}{more}")
        wait(POLL_S)


def _reasons_against_start(guard: SafetyGuard, status: Status) -> list[str]:
    """Return the reasons why no set-point may be sent at this status, one line with remedy each; empty if it may.

    The reasons are, in this order: thrusters that turn without a command, limits whose quantity no device reports, and
    devices whose rate differs from `rate_hz` of the rig.
    """
    turning = [
        f"thruster {text} though nothing was commanded: stop it, and look for another program that commands it; if the "
        'water turns it, write unwatched = ["telemetry"] in [limits]'
        for text in guard.turning(status)
    ]
    unwatched = [limit.refusal(status.t) for limit in guard.unwatched(status)]
    return [*turning, *unwatched, *guard.rate_conflicts(status)]
