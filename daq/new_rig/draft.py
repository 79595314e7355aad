"""Draft of a rig, and the commented text of its rig file.

Each value of a draft states whether the user has given it. Values that nobody has given are marked in the file as
"default, check".
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, NamedTuple, TypeVar

from seatrial.daq.protocol import CAN, DEVICES
from seatrial.daq.rig import DRIVES, LOAD_CELLS, UNCHECKED
from seatrial.daq.tools import DiscoveredAutopilot, DiscoveredDevice

RECEIVERS = ("nmea", "ubx", "nmea2000")  # protocols of devices with a GNSS antenna
POSITIONS = (*RECEIVERS, "mavlink")  # protocols that report a position
CONTROLLERS = ("vesc", "dronecan")  # protocols of speed controllers, which report speed, current, temperature, voltage
COLUMN = 30  # column at which the comments begin

# Usual name of a device by its protocol; other protocols are named after themselves.
NAMES = {
    "vectornav": "ahrs", "mip": "ahrs", "nmea": "gnss", "ubx": "gnss", "loadcell": "loadcell", "openscale": "loadcell",
    "mantracourt": "loadcell", "vesc": "esc", "dronecan": "esc", "dbc": "shaft", "nmea2000": "ship",
    "mavlink": "autopilot",
}  # fmt: skip
# Usual rate [Hz] of the samples by protocol, as the devices are delivered; 10 Hz for others.
RATES_HZ = {
    "vectornav": 40.0, "mip": 100.0, "nmea": 1.0, "ubx": 1.0, "vesc": 50.0, "dronecan": 50.0, "mavlink": 25.0,
}  # fmt: skip
USUAL_RATE_HZ = 10.0
Content = TypeVar("Content")


class Value(NamedTuple, Generic[Content]):
    """Value of a key, and whether the user has given it.

    Attributes
    ----------
    content
        The value: text, number, or tuple of numbers.
    given
        Whether the user has given it, or a device has shown it. Otherwise it is a default.
    """

    content: Content
    given: bool = True


Number = Value[float]
Position = Value[tuple[float, float, float]]


@dataclass(frozen=True)
class DeviceDraft:
    """Device of a draft.

    Attributes
    ----------
    name
        Name in the rig file.
    protocol
        Protocol, a name in the catalogue of protocols.
    port
        Port, as in a rig file.
    baud
        Baud rate; None for a port without one.
    rate_hz
        Expected rate of the samples [Hz].
    lever_arm_m
        Position of the antenna in body axes [m]; None for a device without an antenna.
    newton_per_count
        Gain of a load cell [N/count]; None for other devices, and for a device that is only discovered.
    about
        Comment above the table.
    tables
        Text of the tables of a discovered autopilot, which then has its [[thruster]] tables; "" otherwise.
    """

    name: str
    protocol: str
    port: Value[str]
    baud: Value[int] | None
    rate_hz: Number
    lever_arm_m: Position | None = None
    newton_per_count: Number | None = None
    about: str = ""
    tables: str = ""

    @property
    def drives(self) -> bool:
        """Whether `tables` contains [[thruster]] tables."""
        return "[[thruster]]" in self.tables.splitlines()


@dataclass(frozen=True)
class ThrusterDraft:
    """Thruster of a draft, with its controller on a bus or its output of an autopilot; see `Thruster`.

    Attributes
    ----------
    name, device
        Name of the thruster, and of the device that drives it.
    protocol
        Protocol of this device.
    node
        Id of the controller, or number of the servo output.
    position_m
        Position in body axes [m].
    pole_pairs
        Number of pole pairs of the motor. Not used behind an autopilot.
    rpm_max
        Shaft speed [rev/min] at full command. Not used behind an autopilot.
    timeout_s
        Time-out of the controller [s].
    """

    name: Value[str]
    device: str
    protocol: str
    node: Value[int]
    position_m: Position
    pole_pairs: Value[int]
    rpm_max: Number
    timeout_s: Number


@dataclass(frozen=True)
class RigDraft:
    """Content of a new rig file.

    Attributes
    ----------
    name
        Name of the boat or bench.
    devices
        Devices, in their order.
    thrusters
        Thrusters that are not in the tables of a discovered autopilot.
    limits
        Limits by key of the table [limits], in their order. Keys of LIMITS that are missing become comments.
    head
        Lines of comment at the top of the file, without the sign for a comment.
    """

    name: Value[str]
    devices: Sequence[DeviceDraft]
    thrusters: Sequence[ThrusterDraft] = ()
    limits: dict[str, Number] = field(default_factory=dict)
    head: Sequence[str] = ()


class LimitKind(NamedTuple):
    """Limit of a rig: its proposal, its meaning, and the protocols of devices that report its quantity.

    Attributes
    ----------
    proposal
        Value that is proposed if the user gives none.
    words
        Meaning, with the unit.
    reported_by
        Protocols of which one device is sufficient; empty if no device has to report it.
    guessed
        Whether the proposal may be active without an answer of the user. Otherwise it is written as a comment.
    """

    proposal: float
    words: str
    reported_by: tuple[str, ...]
    guessed: bool = True


LIMITS = {
    "n_max": LimitKind(0.5, "largest command, 1 is full forward; begin with a small one", ()),
    "current_a": LimitKind(20.0, "largest current of a motor [A]", CONTROLLERS),
    "temperature_c": LimitKind(70.0, "highest temperature of a speed controller [deg C]", CONTROLLERS),
    # The right value depends on the battery, and a wrong one ends every run or protects nothing.
    "voltage_min_v": LimitKind(14.0, "lowest voltage of the supply [V]", (*CONTROLLERS, "mavlink"), guessed=False),
    "radius_m": LimitKind(50.0, "geofence: largest distance from the start [m]", POSITIONS),
    "force_n": LimitKind(50.0, "largest force of a load cell [N]", LOAD_CELLS),
    "link_test_n": LimitKind(0.3, "largest command before the link test of an autopilot is passed", ("mavlink",)),
}


def reports(limit: str, devices: Sequence[DeviceDraft]) -> bool:
    """Return whether a device of the draft can report the quantity of a limit; True for limits that need no device."""
    protocols = LIMITS[limit].reported_by
    return not protocols or any(device.protocol in protocols for device in devices)


def name_devices(protocols: Sequence[str]) -> list[str]:
    """Return a name for each device by its protocol, such as "gnss". From the second of a name on, a number follows."""
    names: list[str] = []
    for k, protocol in enumerate(protocols):
        usual = NAMES.get(protocol, protocol)
        before = sum(NAMES.get(other, other) == usual for other in protocols[:k])
        names.append(f"{usual}{before + 1}" if before else usual)
    return names


def _device_of(found: DiscoveredDevice, name: str, alone: bool = True) -> DeviceDraft:
    """Return the draft of a discovered device. Its port, baud rate and rate count as given, because it was received.

    An unknown rate becomes the usual one of the protocol, which is then a default. An autopilot brings the text of its
    tables.

    Parameters
    ----------
    found
        Device whose `protocol` is that of a rig file.
    name
        Name in the rig file.
    alone
        Whether no other device of the rig has [[thruster]] tables.
    """
    known = math.isfinite(found.rate)
    rate = Value(float(f"{found.rate:.3g}")) if known else Value(usual_rate(found.protocol), False)
    tables = found.toml(name, alone) if isinstance(found, DiscoveredAutopilot) else ""
    return DeviceDraft(
        name,
        found.protocol,
        Value(found.port),
        Value(found.baud) if found.baud else None,
        rate,
        about=found.says,
        tables=tables,
    )


def drafts_of(found: Sequence[DiscoveredDevice]) -> list[DeviceDraft]:
    """Return the drafts of the discovered devices whose protocol is that of a rig file, each with a name."""
    known = [device for device in found if device.protocol in DEVICES]
    alone = sum(device.protocol == "mavlink" for device in known) < 2
    names = name_devices([device.protocol for device in known])
    return [_device_of(device, name, alone) for device, name in zip(known, names, strict=True)]


def usual_rate(protocol: str) -> float:
    """Return the rate [Hz] at which devices of a protocol send as they are delivered; 10 Hz if it is unknown."""
    return RATES_HZ.get(protocol, USUAL_RATE_HZ)


def usual_baud(protocol: str, port: str) -> int | None:
    """Return the commonest baud rate of a protocol at a port; None for a port that has no baud rate."""
    if port.startswith(("socketcan:", "udp", "tcp:")):
        return None
    bauds = DEVICES[protocol].bauds
    return bauds[0] if bauds else 115200


def usual_port(protocol: str, number: int, buses: Sequence[str] = ()) -> str:
    """Return a port for a device whose port is not given.

    `number` counts the USB serial ports that are in use already. `buses` are the CAN buses that were found; the first
    one is the port of a device on a CAN bus, and can0 if there is none.
    """
    if protocol == "mavlink":
        return "udp:127.0.0.1:14550"
    if DEVICES[protocol].bus == CAN:
        return buses[0] if buses else "socketcan:can0"
    return f"/dev/ttyUSB{number}"


def drivers_of(devices: Sequence[DeviceDraft]) -> list[DeviceDraft]:
    """Return the devices that can drive thrusters and bring no [[thruster]] tables of their own."""
    return [device for device in devices if device.protocol in DRIVES and not device.tables]


def rig_text(draft: RigDraft) -> str:
    """Return the text of a rig file: TOML with a comment for each key.

    The format's own parser has to accept it; the caller checks this (`seatrial.daq.config.parse_rig`).
    """
    blocks = [[*(f"# {line}".rstrip() for line in draft.head), 'format = "seatrial-rig 1"', _line("name", draft.name)]]
    blocks.append(["[log]", _line("directory", Value("logs"), "folder of the logs, relative to this file")])
    blocks += [_device_lines(device) for device in draft.devices]
    blocks += [_thruster_lines(thruster) for thruster in draft.thrusters]
    blocks.append(_limit_lines(draft))
    return "\n\n".join("\n".join(block) for block in blocks) + "\n"


def _line(key: str, value: Value[Any], words: str = "") -> str:
    """Return the line of a key, with a comment of its meaning; a value that is not given is marked in it."""
    from tomlkit import item

    content = value.content
    written = item(list(content) if isinstance(content, tuple) else content).as_string()
    comment = "; ".join(part for part in (words, "" if value.given else UNCHECKED) if part)
    text = f"{key} = {written}"
    return f"{text.ljust(COLUMN - 1)} # {comment}" if comment else text


def _device_lines(device: DeviceDraft) -> list[str]:
    """Return the lines of the [[device]] table of a device, with its calibration or signals below."""
    if device.tables:
        return device.tables.rstrip("\n").split("\n")
    can = DEVICES[device.protocol].bus == CAN
    serial = "serial device; a name in /dev/serial/by-id stays the same" if device.baud else ""
    where = "socketcan:NAME or slcan:SERIAL" if can else serial
    lines = [f"# {device.about}"] if device.about else []
    lines += ["[[device]]", _line("name", Value(device.name), f"its topics are /{device.name}/...")]
    lines += [_line("protocol", Value(device.protocol)), _line("port", device.port, where)]
    if device.baud is not None:
        lines.append(_line("baud", device.baud, "bit/s of the serial port"))
    if can:
        rate = 250_000 if device.protocol == "nmea2000" else 500_000
        lines.append(_line("bitrate", Value(rate, False), "bit/s of the CAN bus"))
    together = ", all nodes together" if device.protocol in CONTROLLERS else ""
    lines.append(_line("rate_hz", device.rate_hz, f"expected samples per second{together}"))
    if device.lever_arm_m is not None:
        lines.append(_line("lever_arm_m", device.lever_arm_m, "antenna: forward, starboard, down [m]"))
    if device.newton_per_count is not None:
        lines += ["[device.calibration]"]
        lines.append(_line("newton_per_count", device.newton_per_count, "gain [N/count]; hang a known mass"))
        lines.append(_line("zero_counts", Value(0.0, False), "reading without force [counts]"))
        lines.append(_line("lever_ratio", Value(1.0, False), "force at the thruster / force at the cell"))
    if device.protocol == "dbc":
        lines += [_line("dbc", Value("nmea2000", False), "DBC file, relative to this file, or nmea2000")]
        lines += ["[[device.signal]]", _line("message", Value("EngineParametersRapid", False))]
        lines += [_line("signal", Value("EngineSpeed", False)), _line("field", Value("rpm", False))]
        lines += [_line("node", Value("EngineInstance", False), "number, name of a signal, or source")]
    return lines


def _thruster_lines(thruster: ThrusterDraft) -> list[str]:
    """Return the lines of the [[thruster]] table of a thruster. Its name is marked if the user has not given it."""
    autopilot = thruster.protocol == "mavlink"
    lines = ["[[thruster]]", _line("name", thruster.name), _line("device", Value(thruster.device))]
    where = "number of the servo output" if autopilot else "id of the controller on the bus"
    lines.append(_line("node", thruster.node, where))
    if autopilot:
        lines.append(_line("rc_channel", Value(thruster.node.content, False), "RC channel of this thruster alone"))
        lines.append(_line("rc_us", Value((1000.0, 1500.0, 2000.0), False), "RCn_MIN, RCn_TRIM, RCn_MAX"))
        lines.append(_line("pwm_us", Value((1100.0, 1500.0, 1900.0), False), "SERVOn_MIN, SERVOn_TRIM, SERVOn_MAX"))
    lines.append(_line("position_m", thruster.position_m, "propeller: forward, starboard, down [m]"))
    if not autopilot:
        lines.append(_line("pole_pairs", thruster.pole_pairs, "pole pairs of the motor"))
        lines.append(_line("rpm_max", thruster.rpm_max, "shaft speed [rev/min] at full command"))
    lines.append(_line("reversed", Value(False, False), "true if a positive command drives in reverse"))
    lines.append(_line("timeout_s", thruster.timeout_s, "time-out that is set in the controller [s]"))
    return lines


def _limit_lines(draft: RigDraft) -> list[str]:
    """Return the lines of the table [limits]. Limits that the draft lacks follow as comments.

    If the draft has no limit, the whole table is a comment, so that the file states no limit that nobody has chosen.
    """
    active = [_line(key, value, _limit_words(key, draft.devices)) for key, value in draft.limits.items()]
    rest = [
        "# " + _line(key, Value(kind.proposal), _limit_words(key, draft.devices))
        for key, kind in LIMITS.items()
        if key not in draft.limits
    ]
    head = ["# A run ends at zero thrust when a limit is passed. Each limit needs a device that reports its quantity."]
    if not active:
        return [*head, "# Uncomment these lines and put in your own values.", "# [limits]", *rest]
    return [*head, "[limits]", *active, *rest]


def _limit_words(key: str, devices: Sequence[DeviceDraft]) -> str:
    """Return the comment of a limit: its meaning, and that no device of the draft reports it if this is so."""
    return LIMITS[key].words + ("" if reports(key, devices) else "; no device of this rig reports it")
