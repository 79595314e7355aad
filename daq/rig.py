"""rig.toml -> dataclasses: what is on the boat or on the bench (docs/formats/rig.md)."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from daq.errors import SeatrialError
from daq.toml_table import Table, parse_toml, read_text

FORMAT = "seatrial-rig 1"
PROTOCOLS = ("vectornav", "nmea", "vesc", "loadcell")
DEFAULT_PATTERN = r"^(?P<counts>-?\d+)$"
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")

Counts = TypeVar("Counts", float, NDArray[np.float64])


@dataclass(frozen=True)
class Calibration:
    """Load cell: counts -> force at the thruster."""

    newton_per_count: float
    zero_counts: float = 0.0
    lever_ratio: float = 1.0

    def force(self, counts: Counts) -> Counts:
        """Force at the thruster, N, of raw counts; a number or an array of any shape."""
        return (counts - self.zero_counts) * (self.newton_per_count * self.lever_ratio)


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


@dataclass(frozen=True)
class Limits:
    """The guard's limits; None where the rig sets none."""

    n_max: float = 1.0
    force_n: float | None = None
    current_a: float | None = None
    temperature_c: float | None = None
    voltage_min_v: float | None = None
    radius_m: float | None = None


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
    speed, directory = _clock_and_log(root)
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
    return Rig(name, path, text, speed, folder / directory, devices, thrusters, limits, vehicle)


def _clock_and_log(root: Table) -> tuple[float, str]:
    speed, directory = 1.0, "logs"
    if (clock := root.table("clock")) is not None:
        speed = clock.number("speed", 1.0, positive=True)
        clock.done()
    if (log := root.table("log")) is not None:
        directory = log.text("directory", directory)
        log.done()
    return speed, directory


def _device(table: Table, folder: Path) -> Device:
    name = _name(table)
    protocol = table.text("protocol", choices=PROTOCOLS)
    port = _port(table, protocol, folder)
    baud = table.integer("baud", 115200, low=1)
    rate = table.number("rate_hz", positive=True)
    forward, starboard, down = table.numbers("lever_arm_m", (0.0, 0.0, 0.0), length=3)
    lever_arm = (forward, starboard, down)
    bitrate, pattern, saturation, calibration = 0, DEFAULT_PATTERN, None, None
    if protocol == "vesc":
        bitrate = table.integer("bitrate", 500_000, low=10_000)
    if protocol == "loadcell":
        pattern = _pattern(table)
        saturation = table.maybe_number("saturation", low=1.0)
        calibration = _calibration(table.table("calibration"))
    table.done()
    return Device(name, protocol, port, baud, bitrate, rate, lever_arm, pattern, saturation, calibration)


def _name(table: Table) -> str:
    name = table.text("name")
    if not _NAME.fullmatch(name):
        raise table.error("name", f"'{name}' becomes a topic of the log: a letter, then letters, digits or _")
    return name


def _port(table: Table, protocol: str, folder: Path) -> str:
    port = table.text("port")
    kind, colon, rest = port.partition(":")
    if protocol == "vesc":
        if kind not in ("slcan", "socketcan") or not rest:
            raise table.error("port", f"must be slcan:SERIAL or socketcan:NAME, not '{port}'")
        return port if kind == "socketcan" else f"slcan:{folder / rest}"
    if not port or (colon and kind in ("slcan", "socketcan")):
        raise table.error("port", f"must be a serial device for protocol {protocol}, not '{port}'")
    return str(folder / port)


def _pattern(table: Table) -> str:
    pattern = table.text("pattern", DEFAULT_PATTERN)
    try:
        groups = re.compile(pattern).groupindex
    except re.error as error:
        raise table.error("pattern", f"not a regular expression: {error}") from error
    if "counts" not in groups:
        raise table.error("pattern", "must have a group (?P<counts>...) around the reading")
    return pattern


def _calibration(table: Table | None) -> Calibration | None:
    if table is None:
        return None
    gain = table.number("newton_per_count")
    if gain == 0.0:
        raise table.error("newton_per_count", "must not be zero")
    zero, ratio = table.number("zero_counts", 0.0), table.number("lever_ratio", 1.0, positive=True)
    found = Calibration(gain, zero, ratio)
    table.done()
    return found


def _thruster(table: Table, devices: Sequence[Device]) -> Thruster:
    name = _name(table)
    device = table.text("device")
    buses = [row.name for row in devices if row.protocol == "vesc"]
    if device not in buses:
        raise table.error("device", f"no vesc device '{device}'; there is: {', '.join(buses) or 'none'}")
    forward, starboard, down = table.numbers("position_m", length=3)
    found = Thruster(
        name,
        device,
        table.integer("node", low=0, high=255),
        (forward, starboard, down),
        table.integer("pole_pairs", low=1, high=100),
        table.number("rpm_max", positive=True),
        table.flag("reversed", False),
        table.number("timeout_s", 1.0, positive=True),
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
