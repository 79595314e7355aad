"""Dataclasses of a rig: devices, thrusters, limits and calibrations of a boat or a test bench.

seatrial.daq.config reads them from rig.toml. The page docs/formats/rig.md describes the keys of the file.
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

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")  # name of a device, thruster or signal; use it with fullmatch
MANY_KINDS = ("mavlink", "nmea2000")  # protocols with several kinds of samples over one port
DRIVES = ("vesc", "dronecan", "mavlink")  # protocols that drive thrusters
DEFAULT_PATTERN = r"^(?P<counts>-?\d+)$"  # of a load cell that sends lines of text
OWN_NODE = 100  # our node on a DroneCAN bus; usually 10 is an autopilot, and 126 and 127 are for tools
DEFAULT_QUERY = "!001:SYS?"  # request of a Mantracourt converter
ESC_FIELDS = ("rpm", "current", "duty", "voltage", "temperature")
SOURCE = "source"  # as the node of a signal: the node is the sender's address (J1939, NMEA 2000)
Counts = TypeVar("Counts", float, "NDArray[np.float64]")
NET_KINDS = ("udp", "udpin", "udpout", "tcp")  # kinds of network ports
# Messages to request from an autopilot, with their rates [Hz]; None stands for rate_hz of the device. The most
# important ones are first: if the link is too slow for all, the autopilot refuses the last ones.
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
OTHER_RATES = (  # other messages that may be requested
    "SCALED_IMU",
    "HIGHRES_IMU",
    "GLOBAL_POSITION_INT",
    "SYS_STATUS",
    "ESC_TELEMETRY_5_TO_8",
    "ESC_STATUS",
)
HIGHEST_ID = 255  # of a MAVLink system or component


@dataclass(frozen=True)
class LoadCellCalibration:
    """Calibration of a load cell: from counts to the force at the thruster."""

    newton_per_count: float  # gain of the load cell [N/count]; negative if the count falls with the force
    zero_counts: float = 0.0  # reading without force [counts]
    lever_ratio: float = 1.0  # force at the thruster over force at the load cell
    # Standard uncertainties, in the units of the values; None: not given.
    newton_per_count_sd: float | None = None
    lever_ratio_sd: float | None = None

    @property
    def relative_sd(self) -> float | None:
        """Relative standard uncertainty of a force due to gain and lever; None if neither uncertainty is given."""
        factors = ((self.newton_per_count_sd, self.newton_per_count), (self.lever_ratio_sd, self.lever_ratio))
        parts = [sd / abs(value) for sd, value in factors if sd is not None]
        return math.hypot(*parts) if parts else None

    def force(self, counts: Counts) -> Counts:
        """Convert raw counts to the force at the thruster [N]. `counts` is a number or an array of any shape."""
        return (counts - self.zero_counts) * (self.newton_per_count * self.lever_ratio)


@dataclass(frozen=True)
class DbcSignal:
    """Mapping of a signal in a DBC file to a field of `Esc`: value = scale * (value by the DBC file) + offset."""

    message: str  # name of the message in the DBC file
    signal: str  # name of the signal in the message
    field: str  # one of ESC_FIELDS
    node: int | str  # number of the node, name of the signal that contains it, or SOURCE
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class MavlinkSettings:
    """Settings of the link to an autopilot: addresses of both ends, signing key, requested message rates."""

    system_id: int = 1  # MAVLink system id of the autopilot
    component_id: int = 1  # its component id
    own_system_id: int = 255  # system id of this program; 255 is the usual one of a ground station
    own_component_id: int = 190  # component id of this program
    # File with the signing key. If it is given, we sign our messages and ignore unsigned ones.
    key_file: Path | None = None
    gnss: str = "raw"  # raw: fixes of the receiver; fused: position estimate of the autopilot
    rates: Mapping[str, float] = field(default_factory=dict)  # Hz by name of the message; they replace or extend RATES

    def requested(self, rate_hz: float) -> dict[str, float]:
        """Return the rates to request [Hz] by name of the message, in the order of RATES.

        `rate_hz` is the rate of the device [Hz]. Messages with rate 0 are left out. With fused positions the estimate
        of the autopilot takes the place of the fixes of its receiver.
        """
        rates = {name: rate_hz if rate is None else rate for name, rate in RATES.items()}
        if self.gnss == "fused":
            rates["GLOBAL_POSITION_INT"] = rates.pop("GPS_RAW_INT")
        return {name: rate for name, rate in (rates | dict(self.rates)).items() if rate > 0.0}


@dataclass(frozen=True)
class Device:
    """Device of the rig and its port. Fields that its protocol does not use keep their defaults."""

    name: str  # name in the rig file, and first part of its topics in a log
    protocol: str  # name of its protocol, such as "vectornav"
    port: str  # absolute path, or an address of the network; a CAN port begins with `slcan:` or `socketcan:`
    baud: int  # bit/s of a serial port
    bitrate: int  # bit/s of a CAN bus
    rate_hz: float  # expected rate of the samples [Hz]
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # position in body axes [m]: forward, starboard, down
    pattern: str = DEFAULT_PATTERN  # regular expression of a line of a load cell
    saturation: float | None = None  # counts, largest reading of a load cell's converter
    calibration: LoadCellCalibration | None = None  # of a load cell; None: the force is unknown
    mavlink: MavlinkSettings | None = None  # of an autopilot; None for all other devices
    # rad, true heading minus magnetic heading, positive to the east; None: magnetic headings are not used.
    declination: float | None = None
    dbc: str = ""  # absolute path of the DBC file
    signals: tuple[DbcSignal, ...] = ()  # signals of the DBC file to read
    query: str = ""  # request for each sample, for a device that sends only on request
    own_node: int = OWN_NODE  # our node on a DroneCAN bus
    index_offset: int = 0  # index of a controller in its DroneCAN telemetry, minus its index in the command
    # Options of a protocol of another package: key of [[device]] -> value in the rig file.
    settings: Mapping[str, str | float | bool] = field(default_factory=dict, hash=False)

    @property
    def sends_many_kinds(self) -> bool:
        """Whether the port has several kinds of samples, of which only one counts for ``rate_hz``."""
        return self.protocol in MANY_KINDS

    def is_rated(self, kind: type, yaw: Any, with_attitudes: bool) -> Any:
        """Return whether a sample, or each sample of a table, counts for ``rate_hz``.

        All samples of a device with one kind of samples count. Of a device with several kinds, only attitudes count.
        On a ship's bus without attitudes, the fixes count.

        Parameters
        ----------
        kind
            Class of the sample.
        yaw
            Yaw of an `Ahrs` sample, or array (n_samples,) of a table [rad]. Other kinds do not use it.
        with_attitudes
            Whether the device sends attitudes.

        Returns
        -------
        bool or Array (n_samples,)
        """
        if not self.sends_many_kinds:
            return True
        if kind is Ahrs:
            return yaw == yaw
        return self.protocol == "nmea2000" and kind is Gnss and not with_attitudes


@dataclass(frozen=True)
class AutopilotOutput:
    """Output of an autopilot to a thruster: its command channel, and the pulse widths of channel and output."""

    rc_channel: int  # channel of RC_CHANNELS_OVERRIDE, from 1
    rc_us: tuple[float, float, float]  # us, full reverse, neutral, full forward: RCn_MIN, RCn_TRIM, RCn_MAX
    pwm_us: tuple[float, float, float]  # us, the same of the servo output: SERVOn_MIN, SERVOn_TRIM, SERVOn_MAX

    def command(self, n: float) -> int:
        """Return the pulse [us] of a command, -1..1. Return the neutral pulse for NaN and for values out of range."""
        low, neutral, high = self.rc_us
        if not -1.0 <= n <= 1.0:
            return round(neutral)
        return round(neutral + n * (high - neutral if n > 0.0 else neutral - low))

    def applied(self, pwm: float) -> float:
        """Return the command of a pulse [us] at the output, NaN without a pulse.

        The result is out of -1..1 if the pulse is out of the range of the output.
        """
        low, neutral, high = self.pwm_us
        if pwm <= 0.0:
            return float("nan")
        return (pwm - neutral) / (high - neutral if pwm > neutral else neutral - low)


@dataclass(frozen=True)
class Thruster:
    """Thruster: its controller, its position, and the scale of its commands."""

    name: str  # name in the rig file
    device: str  # name of the device that drives it
    node: int  # id of its controller on the bus, or number of its servo output
    position_m: tuple[float, float, float]  # body axes [m]: forward, starboard, down
    pole_pairs: int  # of the motor
    rpm_max: float  # rev/min at n = 1: n = rpm / rpm_max; NaN if it is not given for a thruster behind an autopilot
    reversed: bool = False  # whether a positive command of the controller gives reverse thrust
    timeout_s: float = 1.0  # run s; failsafe of the controller: it stops after this time without a command
    output: AutopilotOutput | None = None  # only of a thruster behind an autopilot


Named = TypeVar("Named", Device, Thruster)


@dataclass(frozen=True)
class Limits:
    """Guard limits of a run. A limit is None if the rig does not set it."""

    n_max: float = 1.0  # largest magnitude of a command, 0..1
    force_n: float | None = None  # N, of a load cell
    current_a: float | None = None  # A, of a motor
    temperature_c: float | None = None  # deg C, of a controller
    voltage_min_v: float | None = None  # V, of the supply
    radius_m: float | None = None  # m, largest distance from the start
    rpm: float | None = None  # rev/min, of a shaft
    roll_deg: float | None = None  # deg, largest magnitude of the roll angle
    pitch_deg: float | None = None  # deg, largest magnitude of the pitch angle
    battery_min: float | None = None  # smallest charge, 0..1
    link_test_n: float = 0.3  # larger commands to thrusters behind an autopilot need a link test first
    # Limits that need no device which reports their quantity. A limit is compared if a device reports it all the same.
    # "telemetry": the reports of speed controllers are not compared with their commands.
    unwatched: tuple[str, ...] = ()


@dataclass(frozen=True)
class Segments:
    """Segments of a log: their largest size and length, the needed disk space, and the size of the kept segments."""

    megabytes: float | None = None  # 1e6 bytes, after which a new segment begins; None: no limit
    seconds: float | None = None  # run s, after which a new segment begins; None: no limit
    free_megabytes: float = 50.0  # 1e6 bytes of free disk space that are needed to begin a log or segment
    keep_gigabytes: float | None = (
        None  # 1e9 bytes; the oldest segments except the first are deleted; None: all are kept
    )


@dataclass(frozen=True)
class Live:
    """Settings of the live view: the server to which Foxglove connects."""

    host: str = "127.0.0.1"  # address to listen at; the default is reachable from this machine only
    port: int = 8765  # TCP port; 0 for any free one
    origins: tuple[str, ...] = ("https://app.foxglove.dev",)  # web sites whose pages may connect


@dataclass(frozen=True)
class Ros2:
    """Settings of the ROS 2 node, which connects to a Zenoh router."""

    router: str = "tcp/127.0.0.1:7447"  # Zenoh router that the node connects to
    domain: int = 0  # ROS_DOMAIN_ID
    namespace: str = ""  # of the node and its topics, without slashes
    commands: bool = False  # whether nodes of ROS 2 may command thrusters
    timeout_s: float = 0.3  # wall s without a command, after which thrust is zero


@dataclass(frozen=True)
class Rig:
    """Content of a checked rig file."""

    name: str  # name of the boat or bench
    path: Path  # path of the rig file
    text: str  # text of the file, which is attached to logs
    speed: float  # run seconds per wall second
    log_directory: Path  # folder for new logs
    devices: tuple[Device, ...]
    thrusters: tuple[Thruster, ...] = ()
    limits: Limits = field(default_factory=Limits)
    vehicle: Mapping[str, float] = field(default_factory=dict)  # nominal model parameters by name
    segments: Segments = field(default_factory=Segments)
    live: Live = field(default_factory=Live)
    ros2: Ros2 = field(default_factory=Ros2)
    hardware_watchdog: Path | None = None  # device of the computer's watchdog timer, which is active while a run drives

    def device(self, name: str) -> Device:
        """Return the device with a name. Raise SeatrialError, which lists the known names, if there is none."""
        return _find_by_name(name, self.devices, "device", self.path)

    def thruster(self, name: str) -> Thruster:
        """Return the thruster with a name. Raise SeatrialError, which lists the known names, if there is none."""
        return _find_by_name(name, self.thrusters, "thruster", self.path)


def parse_address(port: str) -> tuple[str, int]:
    """Return host and port number of `udp:HOST:PORT`, `udpin:`, `udpout:` or `tcp:`.

    Raises
    ------
    ValueError
        If the text lacks a host or a valid port number.
    """
    host, _, number = port.partition(":")[2].rpartition(":")
    if not host or not (number.isascii() and number.isdigit() and 0 < int(number) < 65536):
        raise ValueError(f"must be udp:HOST:PORT, udpin:, udpout: or tcp: the same way, not '{port}'")
    return host.strip("[]"), int(number)


def _find_by_name(name: str, rows: Sequence[Named], label: str, path: Path) -> Named:
    """Return the device or thruster with a name. If there is none, raise SeatrialError, which lists the known names.

    `label` is "device" or "thruster", and `path` is that of the rig file, for the message.
    """
    for row in rows:
        if row.name == name:
            return row
    known = ", ".join(row.name for row in rows) or "none"
    raise SeatrialError(f"{path}: no {label} '{name}'; there is: {known}")
