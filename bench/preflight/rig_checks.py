"""Checks of a rig with its devices at rest: answers, rates, autopilots, limits, and room for a log."""

from __future__ import annotations

import contextlib
import math
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

from seatrial.bench.execution import OPEN_SKY, TELEMETRY, SafetyGuard, silent_devices
from seatrial.daq.acquisition import Acquisition, PortStatus, Status
from seatrial.daq.checks import FAULT, OK, WARNING, Finding
from seatrial.daq.clock import RunClock
from seatrial.daq.drivers import LinkStatus, check_parameters, parameter_lines
from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.log import Log
from seatrial.daq.protocol import CAN, DEVICES, EKF_POSITION, EKF_STANDS, ROVER
from seatrial.daq.rig import LOAD_CELLS, UNCHECKED, Device, Rig

ARMED = "autopilot-armed"  # code of the finding that is also printed as the last line
STILL_WALL_S = 1.0  # wall s of silence that a busy machine alone can cause
LOST = 0.01  # fraction of an autopilot's frames that may be lost
HOURS = 4.0  # hours of logging for which the disk should have room
UNDERSTOOD = 5  # number of valid frames that proves baud rate and protocol
POLL_WALL_S = 0.05  # wall s between two checks of the status


def listen(rig: Rig, wall_s: float, path: Path, guard: SafetyGuard) -> Status:
    """Record every device of a rig at rest into a log, and return the last status of the acquisition.

    No thruster is commanded. Autopilots are requested to send their parameters, and messages at the rates of the rig.

    Parameters
    ----------
    rig : Rig
        The rig.
    wall_s : float
        Duration of the recording [wall s].
    path : Path
        Path of the new log.
    guard : SafetyGuard
        Safety guard. It gets every status, so that it finds which devices report the limited quantities.

    Raises
    ------
    SeatrialError
        If the acquisition cannot start or fails.
    """
    clock = RunClock(rig.speed)
    with Acquisition(rig, path, clock=clock, ask=True) as acquisition:
        until = clock.now() + wall_s * clock.speed
        while clock.now() < until:
            guard.unwatched(acquisition.status())
            clock.sleep_until(min(until, clock.now() + POLL_WALL_S * clock.speed))
        return acquisition.status()


def other_protocols(rig: Rig, status: Status, log: Log) -> dict[str, str]:
    """Return the protocol that the bytes of a device without a sample fit, by the name of the device.

    Devices whose bytes fit the protocol of the rig, or no known protocol, are left out. ``log`` is the recording, with
    the bytes of all ports, and ``status`` the last status of it.
    """
    from seatrial.daq.tools import recognise_protocol

    found = {}
    for device in rig.devices:
        port = status.ports.get(device.name)
        if port is None or port.samples or not port.bytes_in or DEVICES[device.protocol].bus == CAN:
            continue
        with contextlib.suppress(SeatrialError):  # a log without bytes of this port
            protocol = recognise_protocol((t, data) for t, way, data in log.raw(device.name) if way == "rx")
            if protocol not in ("", device.protocol):
                found[device.name] = protocol
    return found


def check_ports(rig: Rig, status: Status, others: Mapping[str, str] = MappingProxyType({})) -> Iterator[Finding]:
    """Yield the findings on the ports of a rig after a recording at rest.

    They are devices without a sample, ports with an error (fault) or a remark of the decoder on the received data
    (warning), devices that have fallen silent (for more than 10 periods of their rate, and 1 s of run and of wall
    time), autopilots, and thrusters that are not reported. The latter are left out if no device at all has sent a
    sample. For a device without a sample this fault is the only finding, and a port with an error or remark is not
    tested for silence. ``status`` is the last status of the recording. ``others`` has the protocol of devices whose
    bytes fit another protocol than that of the rig (`other_protocols`).
    """
    for device in rig.devices:
        port = status.ports.get(device.name)
        if port is None or port.samples == 0:
            if port is not None and device.name in others:
                yield _other_protocol_finding(rig, device, others)
            else:
                yield _silent_device_finding(device, port)
            continue
        if port.message and port.message == port.remark:
            yield Finding(
                WARNING, "port-error", "alive", device.name, port.message, "correct the rig, if this is not intended"
            )
        elif port.message:
            yield Finding(FAULT, "port-error", "alive", device.name, port.message, "check power, cable and port")
        elif port.age > max(1.0, 10.0 / device.rate_hz, STILL_WALL_S * rig.speed):
            yield Finding(
                FAULT,
                "device-fell-silent",
                "alive",
                device.name,
                f"no data received for {port.age:.1f} s",
                "check power, cable and port",
            )
        if device.mavlink is not None:
            yield from _autopilot_findings(rig, device, status, port)
    if not status.latest:
        return
    for name in silent_devices(rig, status, [thruster.name for thruster in rig.thrusters]):
        if name.startswith("thruster "):
            yield Finding(
                FAULT,
                "thruster-silent",
                "alive",
                name.split()[1],
                f"{name} sends nothing",
                "check its node number, its power and the bus",
            )


def _other_protocol_finding(rig: Rig, device: Device, others: Mapping[str, str]) -> Finding:
    """Return the fault that the bytes of a device are of another protocol, with the device whose port it may be.

    ``others`` has the recognised protocols of devices, by name.
    """
    protocol = others[device.name]
    text = f"the bytes of {device.port} are {protocol} ({DEVICES[protocol].description}), not {device.protocol}"
    same = [other for other in rig.devices if other.protocol == protocol and other.name != device.name]
    # The other device of an exchange gets the bytes of this one, if it gets bytes that fit a protocol.
    pairs = [other for other in same if others.get(other.name) == device.protocol] or same
    if pairs:
        names = f"{device.name} and {' or '.join(other.name for other in pairs)}"
        advice = f"are the ports of {names} exchanged? Correct `port` in the rig, or the cables"
    else:
        advice = "correct `protocol` or `port` of this device in the rig, or the output that the device is set to"
    return Finding(FAULT, "device-silent", "alive", device.name, text, advice)


def _silent_device_finding(device: Device, port: PortStatus | None) -> Finding:
    """Return the fault that a device has sent no sample, with its probable cause and a remedy.

    The cause is the error message of its ``port``, if it has one. Otherwise it is guessed from the counters of received
    bytes and frames: power or cable, baud rate or protocol, or the messages that the device is set to send. ``port`` is
    None if its state is not known.
    """
    text, advice = "nothing received", "check power, cable, port and baud rate"
    if port is not None and port.frames >= UNDERSTOOD:
        text = f"{port.frames} frames of {device.protocol} understood, but no frame contains a measurement"
        advice = "baud rate and protocol are right: look at the messages that the device is set to send"
    elif port is not None and port.bytes_in:
        text = f"{port.bytes_in} bytes received, but no sample: wrong baud rate or protocol?"
        advice = "compare baud rate and protocol in the rig with the settings of the device"
    if port is not None and port.message:
        # Most messages of a port end with an advice of their own.
        has_advice = "; " in port.message or ": check " in port.message
        text, advice = port.message, "" if has_advice else "check power, cable and port"
    return Finding(FAULT, "device-silent", "alive", device.name, text, advice)


def _autopilot_findings(rig: Rig, device: Device, status: Status, port: PortStatus) -> Iterator[Finding]:
    """Yield the findings on an autopilot: its link, parameters, message rates, arming and position estimator.

    ``status`` is the last status of a recording, and ``port`` the state of the autopilot's port in it. If no heartbeat
    was received, this fault is the only finding.
    """
    link = status.links.get(device.name, LinkStatus())
    if not link.received:
        text, advice = "no heartbeat was received", "check system_id, port and baud rate of this link"
        if port.message:  # such as the ids of other systems; it has its own advice
            text, advice = f"{text}: {port.message}", ""
        yield Finding(FAULT, "no-heartbeat", "link", device.name, text, advice)
        return
    assert device.mavlink is not None
    here = [thruster for thruster in rig.thrusters if thruster.device == device.name]
    if link.parameters_pending:
        yield Finding(
            WARNING,
            "parameters-unanswered",
            "parameters",
            device.name,
            "the autopilot has not sent all parameters yet",
            "repeat the check with a longer --seconds",
        )
    else:
        for told in parameter_lines(check_parameters(link.parameters, here, device.mavlink.own_system_id)):
            # A line on unanswered parameters has its own advice.
            advice = "set it with a ground station: seatrial does not change it" if told.is_answered else ""
            level = FAULT if told.fatal else WARNING
            yield Finding(level, "autopilot-parameter", "parameters", device.name, told.text, advice)
    for line in link.refused:
        yield Finding(
            WARNING,
            "rate-refused",
            "rate",
            device.name,
            f"the autopilot refuses {line}",
            "raise SCHED_LOOP_RATE, or lower the rate in the rig",
        )
    name = device.name
    if here and link.vehicle != ROVER:
        text = f"the autopilot is {link.vehicle or 'of an unknown kind'}: seatrial drives only {ROVER}"
        yield Finding(
            FAULT,
            "autopilot-not-driven",
            "link",
            name,
            text,
            "only record it, without [[thruster]], and drive it with its own tools",
        )
    if link.other_station_frames:
        own = device.mavlink.own_system_id
        text = f"another ground station has system id {own}, the same as seatrial (own_system_id in the rig)"
        advice = "end that station, or give one of the two another id: the autopilot cannot notice the loss of one"
        yield Finding(FAULT, "rival-station", "link", name, text, advice)
    if link.lost > LOST * port.frames:
        text = f"{link.lost} frames of the autopilot lost, {port.frames} received"
        yield Finding(
            WARNING,
            "frames-lost",
            "link",
            name,
            text,
            "check range and data rate of the radio link, or request lower rates",
        )
    if link.alarm:
        advice = "look at its messages in a ground station, and remove the cause: an alarm during a run ends it"
        yield Finding(WARNING, "autopilot-alarm", "link", device.name, f"reports {link.alarm}", advice)
    if link.armed:
        yield armed_finding(name)
    trip = f", round trip {1e3 * link.round_trip:.0f} ms" if math.isfinite(link.round_trip) else ""
    state = f"mode {link.mode}, {'armed' if link.armed else 'disarmed'}"
    if link.receiver is not None:
        state += ", a transmitter is received" if link.receiver else ", no transmitter received"
    text = f"{link.vehicle}, {state}, EKF flags {link.ekf}{' (position)' * bool(link.ekf & EKF_POSITION)}{trip}"
    if link.ekf >= 0 and (not link.ekf & EKF_POSITION or link.ekf & EKF_STANDS):
        text, advice = (
            f"{text}: its position estimator has no position",
            f"{OPEN_SKY}; a run cannot start before",
        )
        yield Finding(WARNING, "estimator-not-ready", "link", name, text, advice)
    else:
        yield Finding(OK, "autopilot-answers", "link", name, text)


def armed_finding(name: str) -> Finding:
    """Return the finding, a warning, that the autopilot ``name`` is armed, with the advice to disarm it."""
    text = "it is armed: its outputs follow any command that it receives"
    return Finding(
        WARNING, ARMED, "link", name, text, "keep clear of the propellers, and disarm it unless a run follows"
    )


def check_computer(rig: Rig, status: Status) -> Iterator[Finding]:
    """Yield one finding on the free space of the disk to which logs are written: a fault, a warning or OK.

    The finding is a fault if the space is below `free_mb` in [log] of the rig. The finding is a warning if the space
    above that lasts for less than four hours of logging. ``status`` is the last status of a recording, from which the
    size of a log per hour is computed.
    """
    place = rig.log_directory
    while not place.exists() and place != place.parent:
        place = place.parent
    free = shutil.disk_usage(place).free
    need = rig.segments.free_megabytes * 1e6
    rate = status.bytes / max(status.duration / rig.speed, 1.0)
    text = f"{free / 1e9:.1f} GB free, a log takes about {3.6e-3 * rate:.0f} MB an hour"
    if free < need:
        yield Finding(
            FAULT,
            "disk-full",
            "disk",
            str(place),
            f"{text}; free_mb in [log] requires {need / 1e6:g} MB",
            "free disk space, or log to another disk",
        )
    elif free < need + HOURS * 3600.0 * rate:
        yield Finding(
            WARNING,
            "disk-low",
            "disk",
            str(place),
            f"{text}: room for less than {HOURS:g} h",
            "free disk space, or log to another disk",
        )
    else:
        yield Finding(OK, "disk-as-expected", "disk", str(place), text)


def check_defaults(rig: Rig) -> Iterator[Finding]:
    """Yield one warning that names the values of a rig file which are still the defaults of `seatrial init`; or none.

    They are the lines whose comment has the mark "default, check". The user removes it when the value is checked.
    """
    names, place, key_of_table = [], "", ""
    for number, line in enumerate(rig.text.splitlines(), start=1):
        written, _, comment = line.partition("#")
        written = written.strip()
        if written.startswith("["):
            place = key_of_table = written.strip("[] ")
        key, is_value, value = (part.strip() for part in written.partition("="))
        if is_value and key == "name" and key_of_table in ("device", "thruster"):
            place = value.strip("\"'")
        if is_value and UNCHECKED in comment and key != "name":  # a name spoils no fit
            names.append(f"{place + '.' if place else ''}{key} = {value} (line {number})")
    if names:
        text = f'{counted(len(names), "value")} of {rig.path.name} marked "{UNCHECKED}": {", ".join(names)}'
        advice = "measure or look up each value, and remove its mark; a wrong one spoils a fit without an error message"
        yield Finding(WARNING, "rig-default", "rig", rig.name, text, advice)


def _wanted_limits(rig: Rig) -> list[str]:
    """Return the keys of the limits that [limits] of this rig should have.

    They are "voltage_min_v", without a load cell (on a boat) also "radius_m", and with a thruster that no autopilot
    drives also "current_a".
    """
    on_bench = any(device.protocol in LOAD_CELLS for device in rig.devices)
    on_bus = any(thruster.output is None for thruster in rig.thrusters)  # an autopilot does not report motor currents
    return [*([] if on_bench else ["radius_m"]), "voltage_min_v", *(["current_a"] if on_bus else [])]


def check_limits(rig: Rig, guard: SafetyGuard, status: Status) -> Iterator[Finding]:
    """Yield the findings on the limits of a rig; no finding if the rig has no thruster.

    Faults are limits whose quantity no device reports. Warnings are limits that are not watched because `unwatched` in
    [limits] names them, and recommended limits that are not set. The last finding (OK) lists the limits that are
    watched.

    Parameters
    ----------
    rig : Rig
        The rig with its limits.
    guard : SafetyGuard
        Safety guard that has got every status of a recording.
    status : Status
        The last status of the recording.
    """
    if not rig.thrusters:
        return
    silent = guard.unwatched(status)
    for limit in silent:
        text, _, remedy = limit.refusal(status.t).partition("; ")
        yield Finding(FAULT, "limit-without-source", "limits", rig.name, text, remedy)
    for key in rig.limits.unwatched:
        if key == TELEMETRY:
            text = "the telemetry of the speed controllers is not compared with their commands, because `unwatched` in "
            text += '[limits] names "telemetry"'
            advice = (
                "take it out of `unwatched` once the telemetry follows the commands: a stuck controller is not noticed"
            )
        else:
            text = (
                f"limits.{key} = {getattr(rig.limits, key):g} is not watched, because `unwatched` in [limits] names it"
            )
            advice = "add a device that reports the quantity, and take the name out of `unwatched`"
        yield Finding(WARNING, "limit-unwatched", "limits", rig.name, text, advice)
    missing = [key for key in _wanted_limits(rig) if getattr(rig.limits, key) is None]
    if missing:
        which = "this quantity" if len(missing) == 1 else "these quantities"
        text = f"[limits] has no {', '.join(missing)}: no value of {which} ends a run"
        advice = "set them (`seatrial devices --toml` writes examples), or leave them out on purpose"
        yield Finding(WARNING, "limit-missing", "limits", rig.name, text, advice)
    watched = [f"n_max {rig.limits.n_max:g}"]
    watched += [
        f"{limit.key} {limit.limit:g}{f' of {limit.whom}' * (limit.whom not in ('', limit.source))} by {limit.source}"
        f", {max(status.t - limit.t, 0.0):.2f} s old"
        for limit in guard.limits
        if limit not in silent
    ]
    yield Finding(OK, "limits-watched", "limits", rig.name, f"watched: {'; '.join(watched)}")
