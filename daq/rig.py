"""rig.toml -> dataclasses: what is on the boat or on the bench (docs/formats/rig.md)."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from daq.device_table import CAN, DEVICES
from daq.errors import SeatrialError
from daq.rig_mavlink import NET_KINDS, MavlinkSettings, Output, read_output
from daq.rig_options import DEFAULT_PATTERN, OWN_NODE, DbcSignal, read_options
from daq.rig_options import Calibration as Calibration
from daq.toml_table import Table, parse_toml, read_text

FORMAT = "seatrial-rig 1"
PROTOCOLS = tuple(DEVICES)
DRIVES = ("vesc", "dronecan", "mavlink")  # what a thruster may hang on
HIGHEST_NODE = {"dronecan": 19}  # a command has room for so many
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


@dataclass(frozen=True)
class Device:
    """One port and what speaks there. Fields that a protocol has no use for keep their defaults."""

    name: str
    protocol: str
    port: str  # absolute; CAN keeps its `slcan:` or `socketcan:` in front
    baud: int
    bitrate: int
    rate_hz: float
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pattern: str = DEFAULT_PATTERN
    saturation: float | None = None
    calibration: Calibration | None = None
    mavlink: MavlinkSettings | None = None
    declination: float | None = None  # rad, east positive: true heading minus magnetic; None: magnetic is not taken
    dbc: str = ""  # absolute path
    signals: tuple[DbcSignal, ...] = ()
    query: str = ""  # what a device that speaks only when asked is asked for each reading
    own_node: int = OWN_NODE  # ours on a DroneCAN bus


@dataclass(frozen=True)
class Thruster:
    """One thruster: which controller drives it, where it sits, how commands scale."""

    name: str
    device: str
    node: int
    position_m: tuple[float, float, float]  # body axes: forward, starboard, down
    pole_pairs: int
    rpm_max: float  # n = rpm / rpm_max
    reversed: bool = False  # a positive command drives astern
    timeout_s: float = 1.0  # the ESC's own, run seconds
    output: Output | None = None  # behind an autopilot


@dataclass(frozen=True)
class Limits:
    """The guard's limits; None where the rig sets none."""

    n_max: float = 1.0
    force_n: float | None = None
    current_a: float | None = None
    temperature_c: float | None = None
    voltage_min_v: float | None = None
    radius_m: float | None = None
    rpm: float | None = None
    roll_deg: float | None = None
    pitch_deg: float | None = None
    battery_min: float | None = None  # 0..1 of the charge


@dataclass(frozen=True)
class Segments:
    """When a log goes on in a new file, and how much room there has to be to begin one."""

    megabytes: float | None = None  # 1e6 bytes; None: never
    seconds: float | None = None  # run seconds
    free_megabytes: float = 50.0


@dataclass(frozen=True)
class Live:
    """Where the live view listens: for this machine alone, unless the rig says otherwise."""

    host: str = "127.0.0.1"
    port: int = 8765


@dataclass(frozen=True)
class Rig:
    """A rig file, checked. `text` is the file as read, for the log's attachment."""

    name: str
    path: Path
    text: str
    speed: float  # run seconds a wall second
    log_directory: Path
    devices: tuple[Device, ...]
    thrusters: tuple[Thruster, ...] = ()
    limits: Limits = field(default_factory=Limits)
    vehicle: Mapping[str, float] = field(default_factory=dict)  # nominal model parameters by name
    segments: Segments = field(default_factory=Segments)
    live: Live = field(default_factory=Live)

    def device(self, name: str) -> Device:
        """The device of that name. Raises SeatrialError that lists those there are."""
        return _named(name, self.devices, "device", self.path)

    def thruster(self, name: str) -> Thruster:
        """The thruster of that name. Raises SeatrialError that lists those there are."""
        return _named(name, self.thrusters, "thruster", self.path)


Named = TypeVar("Named", Device, Thruster)


def _named(name: str, rows: Sequence[Named], what: str, path: Path) -> Named:
    for row in rows:
        if row.name == name:
            return row
    there = ", ".join(row.name for row in rows) or "none"
    raise SeatrialError(f"{path}: no {what} '{name}'; there is: {there}")


def load_rig(path: Path | str) -> Rig:
    """Read and check a rig file. Raises SeatrialError that names file and key of whatever is wrong."""
    path = Path(path)
    return parse_rig(read_text(path), path)


def parse_rig(text: str, source: Path | str) -> Rig:
    """As `load_rig`, from text; relative paths in it count from the folder of `source`."""
    path = Path(source)
    folder = path.absolute().parent
    root = parse_toml(text, path)
    root.text("format", choices=(FORMAT,))
    name = root.text("name")
    speed = _speed(root)
    directory, segments = _log(root)
    live = _live(root.table("live"))
    devices = tuple(_device(table, folder) for table in root.tables("device"))
    if not devices:
        raise root.error("device", "missing; a rig needs at least one [[device]]")
    _unique(root, "device", [device.name for device in devices])
    thrusters = tuple(_thruster(table, devices) for table in root.tables("thruster"))
    _unique(root, "thruster", [thruster.name for thruster in thrusters])
    _unique(root, "thruster", [f"{t.device} node {t.node}" for t in thrusters])
    limits = _limits(root.table("limits"))
    vehicle = _vehicle(root.table("vehicle"))
    root.done()
    return Rig(name, path, text, speed, folder / directory, devices, thrusters, limits, vehicle, segments, live)


def _speed(root: Table) -> float:
    clock = root.table("clock")
    if clock is None:
        return 1.0
    speed = clock.number("speed", 1.0, positive=True)
    clock.done()
    return speed


def _log(root: Table) -> tuple[str, Segments]:
    log = root.table("log")
    if log is None:
        return "logs", Segments()
    directory = log.text("directory", "logs")
    segments = Segments(
        log.maybe_number("segment_mb", low=1.0),
        log.maybe_number("segment_s", low=1.0),
        log.number("free_mb", Segments.free_megabytes, low=0.0),
    )
    log.done()
    return directory, segments


def _live(table: Table | None) -> Live:
    if table is None:
        return Live()
    found = Live(table.text("host", Live.host), table.integer("port", Live.port, low=0, high=65535))
    table.done()
    return found


def _device(table: Table, folder: Path) -> Device:
    name = _name(table)
    protocol = table.text("protocol", choices=PROTOCOLS)
    port = _port(table, protocol, folder)
    baud = table.integer("baud", 115200, low=1)
    rate = table.number("rate_hz", positive=True)
    forward, starboard, down = table.numbers("lever_arm_m", (0.0, 0.0, 0.0), length=3)
    lever_arm = (forward, starboard, down)
    options = {"bitrate": 0, **read_options(table, DEVICES[protocol].options, folder)}
    table.done()
    return Device(name, protocol, port, baud, rate_hz=rate, lever_arm_m=lever_arm, **options)


def _name(table: Table) -> str:
    name = table.text("name")
    if not _NAME.fullmatch(name):
        raise table.error("name", f"'{name}' becomes a topic of the log: a letter, then letters, digits or _")
    return name


def _port(table: Table, protocol: str, folder: Path) -> str:
    port = table.text("port")
    kind, colon, rest = port.partition(":")
    if DEVICES[protocol].bus == CAN:
        if kind not in ("slcan", "socketcan") or not rest:
            raise table.error("port", f"must be slcan:SERIAL or socketcan:NAME, not '{port}'")
        return port if kind == "socketcan" else f"slcan:{folder / rest}"
    if protocol == "mavlink" and kind in NET_KINDS:
        return _address(table, port)
    if not port or (colon and kind in ("slcan", "socketcan")):
        raise table.error("port", f"must be a serial device for protocol {protocol}, not '{port}'")
    return str(folder / port)


def _address(table: Table, port: str) -> str:
    host, _, number = port.partition(":")[2].rpartition(":")
    if not host or not (number.isascii() and number.isdigit() and 0 < int(number) < 65536):
        raise table.error("port", f"must be udp:HOST:PORT, udpin:, udpout: or tcp: the same way, not '{port}'")
    return port


def _thruster(table: Table, devices: Sequence[Device]) -> Thruster:
    name = _name(table)
    device = table.text("device")
    buses = {row.name: row.protocol for row in devices if row.protocol in DRIVES}
    if device not in buses:
        there = ", ".join(buses) or "none"
        raise table.error("device", f"no {' or '.join(DRIVES)} device '{device}'; there is: {there}")
    forward, starboard, down = table.numbers("position_m", length=3)
    node = table.integer("node", low=0, high=HIGHEST_NODE.get(buses[device], 255))
    autopilot = buses[device] == "mavlink"
    # Who reports the shaft's own speed, or none, has no use for the motor's poles.
    no_poles = autopilot or (buses[device] == "dronecan" and not table.has("pole_pairs"))
    found = Thruster(
        name,
        device,
        node,
        (forward, starboard, down),
        1 if no_poles else table.integer("pole_pairs", low=1, high=100),
        math.nan if autopilot and not table.has("rpm_max") else table.number("rpm_max", positive=True),
        table.flag("reversed", False),
        table.number("timeout_s", 1.0, positive=True),
        read_output(table, node) if autopilot else None,
    )
    table.done()
    return found


def _limits(table: Table | None) -> Limits:
    if table is None:
        return Limits()
    found = Limits(
        table.number("n_max", 1.0, low=0.0, high=1.0),
        table.maybe_number("force_n", low=0.0),
        table.maybe_number("current_a", low=0.0),
        table.maybe_number("temperature_c"),
        table.maybe_number("voltage_min_v", low=0.0),
        table.maybe_number("radius_m", low=0.0),
        table.maybe_number("rpm", low=0.0),
        table.maybe_number("roll_deg", low=0.0),
        table.maybe_number("pitch_deg", low=0.0),
        table.number("battery_min", low=0.0, high=1.0) if table.has("battery_min") else None,
    )
    table.done()
    return found


def _vehicle(table: Table | None) -> dict[str, float]:
    """Any parameter name may stand here, since the model that reads them may be the user's own."""
    return {} if table is None else {key: table.number(key) for key in table.values}


def _unique(root: Table, key: str, names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise root.error(key, f"'{name}' stands twice; give each its own name and node")
