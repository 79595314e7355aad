"""The rig as dataclasses: devices, thrusters, limits and calibrations of a boat or a test bench.

seatrial.daq.config reads them from rig.toml; the keys are described in docs/formats/rig.md.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from seatrial.daq.errors import SeatrialError
from seatrial.daq.samples import Ahrs, Gnss

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")  # of devices, thrusters and signals; a whole one, by fullmatch
MANY_KINDS = ("mavlink", "nmea2000")  # protocols with several kinds of samples over one port
DRIVES = ("vesc", "dronecan", "mavlink")  # protocols that drive thrusters
DEFAULT_PATTERN = r"^(?P<counts>-?\d+)$"
OWN_NODE = 100  # our node on a DroneCAN bus; 10 is an autopilot's, 126 and 127 are for tools
DEFAULT_QUERY = "!001:SYS?"
ESC_FIELDS = ("rpm", "current", "duty", "voltage", "temperature")
SOURCE = "source"  # a signal's node is the sender's address (J1939, NMEA 2000)
Counts = TypeVar("Counts", float, "NDArray[np.float64]")
NET_KINDS = ("udp", "udpin", "udpout", "tcp")
# Messages to request, with their rate [Hz]; None is the device's rate_hz. In the order of their importance, so that
# the last ones are refused on a link that cannot carry all.
RATES: dict[str, float | None] = {
    "ATTITUDE": None,
    "SERVO_OUTPUT_RAW": None,
    "RAW_IMU": None,
    "GPS_RAW_INT": 5.0,
    "EKF_STATUS_REPORT": 2.0,
    "SYSTEM_TIME": 1.0,
    "RC_CHANNELS": 1.0,
    "BATTERY_STATUS": 2.0,
    "ESC_TELEMETRY_1_TO_4": 10.0,
}
OTHER_RATES = (
    "SCALED_IMU",
    "HIGHRES_IMU",
    "GLOBAL_POSITION_INT",
    "SYS_STATUS",
    "ESC_TELEMETRY_5_TO_8",
    "ESC_STATUS",
)
HIGHEST_ID = 255


@dataclass(frozen=True)
class LoadCellCalibration:
    """Load cell: counts -> force at the thruster."""

    newton_per_count: float
    zero_counts: float = 0.0
    lever_ratio: float = 1.0
    newton_per_count_sd: float | None = None  # standard uncertainties; None: nobody gave them
    lever_ratio_sd: float | None = None

    @property
    def relative_sd(self) -> float | None:
        """Relative standard uncertainty of a force by gain and lever; None where neither is given."""
        given = ((self.newton_per_count_sd, self.newton_per_count), (self.lever_ratio_sd, self.lever_ratio))
        parts = [sd / abs(value) for sd, value in given if sd is not None]
        return math.hypot(*parts) if parts else None

    def force(self, counts: Counts) -> Counts:
        """Force at the thruster, N, of raw counts; a number or an array of any shape."""
        return (counts - self.zero_counts) * (self.newton_per_count * self.lever_ratio)


@dataclass(frozen=True)
class DbcSignal:
    """One signal of a DBC file and the field of `Esc` that it is: value = scale * (value by the DBC) + offset."""

    message: str
    signal: str
    field: str
    node: int | str  # a number, the signal that holds it, or SOURCE
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class MavlinkSettings:
    """The link to an autopilot: addresses of both ends, signing key, requested message rates."""

    system_id: int = 1
    component_id: int = 1
    own_system_id: int = 255
    own_component_id: int = 190
    key_file: Path | None = None  # 32 bytes or 64 hexadecimal digits; we sign, and ignore unsigned messages
    gnss: str = "raw"  # raw: the receiver's fixes; fused: the autopilot's estimate
    rates: Mapping[str, float] = field(default_factory=dict)  # Hz by message name, other than RATES

    def requested(self, rate_hz: float) -> dict[str, float]:
        """The requested rates [Hz] by message name, in the order of RATES."""
        rates = {name: rate_hz if rate is None else rate for name, rate in RATES.items()}
        if self.gnss == "fused":
            rates["GLOBAL_POSITION_INT"] = rates.pop("GPS_RAW_INT")
        return {name: rate for name, rate in (rates | dict(self.rates)).items() if rate > 0.0}


@dataclass(frozen=True)
class Device:
    """One port and the device behind it. Fields that its protocol does not use keep their defaults."""

    name: str
    protocol: str
    port: str  # absolute; CAN keeps its `slcan:` or `socketcan:` in front
    baud: int
    bitrate: int
    rate_hz: float
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pattern: str = DEFAULT_PATTERN
    saturation: float | None = None
    calibration: LoadCellCalibration | None = None
    mavlink: MavlinkSettings | None = None
    declination: float | None = None  # rad, east positive: true heading minus magnetic; None: magnetic is not taken
    dbc: str = ""  # absolute path
    signals: tuple[DbcSignal, ...] = ()
    query: str = ""  # request for each sample, of a device that sends only on request
    own_node: int = OWN_NODE  # ours on a DroneCAN bus
    index_offset: int = 0  # index of a controller in its DroneCAN telemetry, less its place in the command
    # Options of a protocol of another package: key of [[device]] -> value in the rig file.
    settings: Mapping[str, str | float | bool] = field(default_factory=dict, hash=False)

    @property
    def sends_many_kinds(self) -> bool:
        """Whether several kinds of samples come over its port, of which one counts for ``rate_hz``."""
        return self.protocol in MANY_KINDS

    def is_rated(self, kind: type, yaw: Any, with_attitudes: bool) -> Any:
        """Whether a sample of a kind counts for ``rate_hz``, or each of a table: all of a port do; of one with several
        kinds the attitudes, or on a ship's bus without any the fixes. ``yaw``: of an Ahrs, else of no meaning."""
        if not self.sends_many_kinds:
            return True
        if kind is Ahrs:
            return yaw == yaw
        return self.protocol == "nmea2000" and kind is Gnss and not with_attitudes


@dataclass(frozen=True)
class AutopilotOutput:
    """A thruster behind an autopilot: the channel that commands it and the pulse widths of input and output."""

    rc_channel: int  # RC_CHANNELS_OVERRIDE, from 1
    rc_us: tuple[float, float, float]  # full reverse, neutral, full forward: RCn_MIN, RCn_TRIM, RCn_MAX
    pwm_us: tuple[float, float, float]  # of the servo output: SERVOn_MIN, SERVOn_TRIM, SERVOn_MAX

    def command(self, n: float) -> int:
        """The pulse [us] that commands n, -1..1; neutral for NaN and values outside."""
        low, neutral, high = self.rc_us
        if not -1.0 <= n <= 1.0:
            return round(neutral)
        return round(neutral + n * (high - neutral if n > 0.0 else neutral - low))

    def applied(self, pwm: float) -> float:
        """The command n of a pulse [us] at the output, beyond -1..1 where the pulse is; NaN without a pulse."""
        low, neutral, high = self.pwm_us
        if pwm <= 0.0:
            return float("nan")
        return (pwm - neutral) / (high - neutral if pwm > neutral else neutral - low)


@dataclass(frozen=True)
class Thruster:
    """One thruster: which controller drives it, where it sits, how commands scale."""

    name: str
    device: str
    node: int
    position_m: tuple[float, float, float]  # body axes: forward, starboard, down
    pole_pairs: int
    rpm_max: float  # n = rpm / rpm_max
    reversed: bool = False  # a positive command gives reverse thrust
    timeout_s: float = 1.0  # the ESC's own, run seconds
    output: AutopilotOutput | None = None  # behind an autopilot


Named = TypeVar("Named", Device, Thruster)


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
    link_test_n: float = 0.3  # commands beyond this, behind an autopilot, need a test of what a lost link does
    # Limits that no device has to report; they are compared if one does. "telemetry": speed controllers whose reports
    # are not compared with their commands.
    unwatched: tuple[str, ...] = ()


@dataclass(frozen=True)
class Segments:
    """When a log continues in a new file, the disk space needed to begin one, and how much of a log is kept."""

    megabytes: float | None = None  # 1e6 bytes; None: never
    seconds: float | None = None  # run seconds
    free_megabytes: float = 50.0
    keep_gigabytes: float | None = None  # 1e9 bytes; None: everything


@dataclass(frozen=True)
class Live:
    """The live view: its address, of this machine alone by default, and whose pages may open it."""

    host: str = "127.0.0.1"
    port: int = 8765
    origins: tuple[str, ...] = ("https://app.foxglove.dev",)


@dataclass(frozen=True)
class Ros2:
    """The node of ROS 2: the Zenoh router that it connects to, its names, and whether thrusters may be commanded."""

    router: str = "tcp/127.0.0.1:7447"
    domain: int = 0  # ROS_DOMAIN_ID
    namespace: str = ""  # of the node and its topics, without slashes
    commands: bool = False
    timeout_s: float = 0.3  # wall; without a command for so long thrust is zero


@dataclass(frozen=True)
class Rig:
    """A rig file, checked. `text` is the file as read, for the log's attachment."""

    name: str
    path: Path
    text: str
    speed: float  # run seconds per wall second
    log_directory: Path
    devices: tuple[Device, ...]
    thrusters: tuple[Thruster, ...] = ()
    limits: Limits = field(default_factory=Limits)
    vehicle: Mapping[str, float] = field(default_factory=dict)  # nominal model parameters by name
    segments: Segments = field(default_factory=Segments)
    live: Live = field(default_factory=Live)
    ros2: Ros2 = field(default_factory=Ros2)
    hardware_watchdog: Path | None = None  # device of the computer's watchdog timer, armed while a run drives

    def device(self, name: str) -> Device:
        """The device of that name. Raises SeatrialError that lists the known ones."""
        return _named(name, self.devices, "device", self.path)

    def thruster(self, name: str) -> Thruster:
        """The thruster of that name. Raises SeatrialError that lists the known ones."""
        return _named(name, self.thrusters, "thruster", self.path)


def parse_address(port: str) -> tuple[str, int]:
    """Host and number of `udp:HOST:PORT` and its relatives. Raises ValueError for one that has none."""
    host, _, number = port.partition(":")[2].rpartition(":")
    if not host or not (number.isascii() and number.isdigit() and 0 < int(number) < 65536):
        raise ValueError(f"must be udp:HOST:PORT, udpin:, udpout: or tcp: the same way, not '{port}'")
    return host.strip("[]"), int(number)


def _named(name: str, rows: Sequence[Named], what: str, path: Path) -> Named:
    for row in rows:
        if row.name == name:
            return row
    there = ", ".join(row.name for row in rows) or "none"
    raise SeatrialError(f"{path}: no {what} '{name}'; there is: {there}")
