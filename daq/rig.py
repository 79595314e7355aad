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
LOAD_CELLS = ("loadcell", "openscale", "mantracourt")  # protocols of load cells
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
UNCHECKED = "default, check"  # in the comment of a line that `seatrial init` wrote: nobody has given the value
HIGHEST_ID = 255  # of a MAVLink system or component


@dataclass(frozen=True)
class LoadCellCalibration:
    """Calibration of a load cell: from counts to the force at the thruster.

    Attributes
    ----------
    newton_per_count
        Gain of the load cell [N/count]; negative if the count falls with the force.
    zero_counts
        Reading without force [counts].
    lever_ratio
        Force at the thruster divided by the force at the load cell.
    newton_per_count_sd
        Standard uncertainty of `newton_per_count` [N/count]; None if it is not given.
    lever_ratio_sd
        Standard uncertainty of `lever_ratio`; None if it is not given.
    """

    newton_per_count: float
    zero_counts: float = 0.0
    lever_ratio: float = 1.0
    newton_per_count_sd: float | None = None
    lever_ratio_sd: float | None = None

    @property
    def relative_sd(self) -> float | None:
        """Relative standard uncertainty of a force, from those of gain and lever ratio (root of the sum of squares).

        It is a fraction of the force and has no unit. An uncertainty that is not given counts as zero. None if neither
        is given. The uncertainty of `zero_counts` is not included.
        """
        factors = ((self.newton_per_count_sd, self.newton_per_count), (self.lever_ratio_sd, self.lever_ratio))
        parts = [sd / abs(value) for sd, value in factors if sd is not None]
        return math.hypot(*parts) if parts else None

    def force(self, counts: Counts) -> Counts:
        """Convert raw counts to the force at the thruster [N]. `counts` is a number or an array of any shape.

        The force is `(counts - zero_counts) * newton_per_count * lever_ratio`.
        """
        return (counts - self.zero_counts) * (self.newton_per_count * self.lever_ratio)


@dataclass(frozen=True)
class DbcSignal:
    """Mapping of a signal in a DBC file to a field of `Esc`: value = scale * (value by the DBC file) + offset.

    Attributes
    ----------
    message
        Name of the message in the DBC file.
    signal
        Name of the signal in the message.
    field
        Field of `Esc` that gets the value, one of ESC_FIELDS.
    node
        Number of the node, name of the signal that contains it, or SOURCE for the address of the sender.
    scale
        Factor of the value by the DBC file.
    offset
        Number that is added after that, in the unit of the field.
    """

    message: str
    signal: str
    field: str
    node: int | str
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class MavlinkSettings:
    """Settings of the link to an autopilot: addresses of both ends, signing key, requested message rates.

    Attributes
    ----------
    system_id
        MAVLink system id of the autopilot.
    component_id
        MAVLink component id of the autopilot.
    own_system_id
        System id of this program; 255 is the usual one of a ground station.
    own_component_id
        Component id of this program.
    key_file
        File with the signing key. If it is given, we sign our messages and ignore unsigned ones.
    gnss
        "raw" for the fixes of the receiver, "fused" for the position estimate of the autopilot.
    rates
        Rates [Hz] by name of the message, which replace or extend RATES; 0 requests none.
    """

    system_id: int = 1
    component_id: int = 1
    own_system_id: int = 255
    own_component_id: int = 190
    key_file: Path | None = None
    gnss: str = "raw"
    rates: Mapping[str, float] = field(default_factory=dict)

    def requested(self, rate_hz: float) -> dict[str, float]:
        """Return the message rates [Hz] to request from an autopilot, by name of the MAVLink message.

        They are the messages of RATES, with the rates there, and of `rates`, which take precedence. `rate_hz` is the
        rate of the device in the rig file [Hz], which applies to messages whose rate in RATES is None. Messages with
        rate 0 are left out. If `gnss` is "fused", the position estimate of the autopilot takes the place of the fixes
        of its receiver in RATES, at the same rate.
        """
        rates = {name: rate_hz if rate is None else rate for name, rate in RATES.items()}
        if self.gnss == "fused":
            rates["GLOBAL_POSITION_INT"] = rates.pop("GPS_RAW_INT")
        return {name: rate for name, rate in (rates | dict(self.rates)).items() if rate > 0.0}


@dataclass(frozen=True)
class Device:
    """Device of the rig and its port. Fields that its protocol does not use keep their defaults.

    Attributes
    ----------
    name
        Name in the rig file, and first part of its topics in a log.
    protocol
        Name of its protocol, such as "vectornav".
    port
        Absolute path, or an address of the network; a CAN port begins with `slcan:` or `socketcan:`. In the rig of a
        log it is as it was written.
    baud
        Baud rate of a serial port [bit/s].
    bitrate
        Bit rate of a CAN bus [bit/s]; 0 for other ports.
    rate_hz
        Expected rate of the samples [Hz].
    lever_arm_m
        Position of its antenna or sensor in body axes [m]: forward, starboard, down.
    pattern
        Regular expression (RE2) of a line of a load cell; its group `counts` is the reading.
    saturation
        Largest reading of a load cell's converter [counts]; None: saturation is not detected.
    calibration
        Calibration of a load cell; None: the force is unknown.
    mavlink
        Settings of the link to an autopilot; None for all other devices.
    declination
        True heading minus magnetic heading [rad], positive to the east; None: magnetic headings are not used.
    dbc
        Absolute path of the DBC file.
    signals
        Signals of the DBC file to read.
    query
        Text of the request for each sample, for a device that sends only on request (Mantracourt).
    own_node
        Our node on a DroneCAN bus.
    index_offset
        Index of a controller in its DroneCAN telemetry, minus its index in the command.
    settings
        Options of a protocol of another package: value in the rig file by key.
    """

    name: str
    protocol: str
    port: str
    baud: int
    bitrate: int
    rate_hz: float
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pattern: str = DEFAULT_PATTERN
    saturation: float | None = None
    calibration: LoadCellCalibration | None = None
    mavlink: MavlinkSettings | None = None
    declination: float | None = None
    dbc: str = ""
    signals: tuple[DbcSignal, ...] = ()
    query: str = ""
    own_node: int = OWN_NODE
    index_offset: int = 0
    settings: Mapping[str, str | float | bool] = field(default_factory=dict, hash=False)

    @property
    def sends_many_kinds(self) -> bool:
        """Whether the device is an autopilot or a ship's bus, which sends several kinds of samples at different rates.

        Only one kind of its samples is compared with the rate ``rate_hz`` of the rig file.
        """
        return self.protocol in MANY_KINDS

    def is_rated(self, kind: type, yaw: Any, with_attitudes: bool) -> Any:
        """Return whether a sample, or each sample of a table, counts for the rate ``rate_hz`` of the rig file.

        Of an autopilot or a ship's bus (nmea2000), only attitudes count. On a ship's bus without attitudes, the fixes
        count. Of all other devices every sample counts.

        Parameters
        ----------
        kind
            Class of the sample.
        yaw
            Yaw of an `Ahrs` sample, or array (n_samples,) of a table [rad]; NaN if it is no attitude. Other kinds do
            not use it.
        with_attitudes
            Whether the device sends attitudes.

        Returns
        -------
        bool or Array (n_samples,)
            An array only if `yaw` is an array and decides; otherwise one bool, which applies to all samples.
        """
        if not self.sends_many_kinds:
            return True
        if kind is Ahrs:
            return yaw == yaw
        return self.protocol == "nmea2000" and kind is Gnss and not with_attitudes


@dataclass(frozen=True)
class AutopilotOutput:
    """Output of an autopilot to a thruster: its command channel, and the pulse widths of channel and output.

    Attributes
    ----------
    rc_channel
        Channel of RC_CHANNELS_OVERRIDE, from 1.
    rc_us
        Pulse widths [us] of the channel for full reverse, neutral and full forward: RCn_MIN, RCn_TRIM, RCn_MAX.
    pwm_us
        Pulse widths [us] of the servo output for the same three: SERVOn_MIN, SERVOn_TRIM, SERVOn_MAX.
    """

    rc_channel: int
    rc_us: tuple[float, float, float]
    pwm_us: tuple[float, float, float]

    def command(self, n: float) -> int:
        """Return the pulse width [us] on the command channel of the autopilot for a command, -1..1.

        It is linear from full reverse to neutral and from neutral to full forward (`rc_us`), and rounded. The width is
        neutral for NaN and for a command out of range.
        """
        low, neutral, high = self.rc_us
        if not -1.0 <= n <= 1.0:
            return round(neutral)
        return round(neutral + n * (high - neutral if n > 0.0 else neutral - low))

    def applied(self, pwm: float) -> float:
        """Return the command, -1..1, that belongs to a pulse width [us] at the servo output of the autopilot.

        It is linear between full reverse, neutral and full forward (`pwm_us`). It is NaN without a pulse (0 or less),
        and out of -1..1 if the pulse is out of the range of the output.
        """
        low, neutral, high = self.pwm_us
        if pwm <= 0.0:
            return float("nan")
        return (pwm - neutral) / (high - neutral if pwm > neutral else neutral - low)


@dataclass(frozen=True)
class Thruster:
    """Thruster: its controller, its position, and the scale of its commands.

    Attributes
    ----------
    name
        Name in the rig file.
    device
        Name of the device that drives the thruster.
    node
        Id of its controller on the bus, or number of its servo output.
    position_m
        Position in body axes [m]: forward, starboard, down.
    pole_pairs
        Number of pole pairs of the motor; 1 if it is not needed.
    rpm_max
        Shaft speed [rev/min] at n = 1, so that n = rpm / rpm_max; NaN if it is not given for a thruster behind an
        autopilot.
    reversed
        Whether a positive command of the controller gives reverse thrust.
    timeout_s
        Failsafe of the controller: time without a command after which it stops [run s].
    output
        Output of the autopilot to the thruster; None unless the thruster is behind an autopilot.
    """

    name: str
    device: str
    node: int
    position_m: tuple[float, float, float]
    pole_pairs: int
    rpm_max: float
    reversed: bool = False
    timeout_s: float = 1.0
    output: AutopilotOutput | None = None


Named = TypeVar("Named", Device, Thruster)


@dataclass(frozen=True)
class Limits:
    """Guard limits of a run. A limit that the rig does not set is None; `n_max` and `link_test_n` have defaults.

    Attributes
    ----------
    n_max
        Largest magnitude of a command, 0..1.
    force_n
        Largest force of a load cell [N].
    current_a
        Largest current of a motor [A].
    temperature_c
        Highest temperature of a controller [deg C].
    voltage_min_v
        Lowest voltage of the supply [V].
    radius_m
        Largest distance from the start [m].
    rpm
        Largest speed of a shaft [rev/min].
    roll_deg
        Largest magnitude of the roll angle [deg].
    pitch_deg
        Largest magnitude of the pitch angle [deg].
    battery_min
        Smallest remaining charge of a battery, 0..1.
    link_test_n
        Largest command, 0..1, to thrusters behind an autopilot whose link test has not been done.
    unwatched
        Names of limits that a run may have without a device which reports their quantity. If a device does report it,
        the limit is still compared. "telemetry" means that the reports of speed controllers are not compared with
        their commands.
    """

    n_max: float = 1.0
    force_n: float | None = None
    current_a: float | None = None
    temperature_c: float | None = None
    voltage_min_v: float | None = None
    radius_m: float | None = None
    rpm: float | None = None
    roll_deg: float | None = None
    pitch_deg: float | None = None
    battery_min: float | None = None
    link_test_n: float = 0.3
    unwatched: tuple[str, ...] = ()


@dataclass(frozen=True)
class Segments:
    """Segments of a log: their largest size and length, the needed disk space, and the size of the kept segments.

    Attributes
    ----------
    megabytes
        Size of a segment after which a new one begins [1e6 bytes]; None: no limit.
    seconds
        Duration of a segment after which a new one begins [run s]; None: no limit.
    free_megabytes
        Free disk space that is needed to begin a log or segment [1e6 bytes].
    keep_gigabytes
        Size of the log from which on the oldest segments, except the first, are deleted [1e9 bytes]; None: all are
        kept.
    """

    megabytes: float | None = None
    seconds: float | None = None
    free_megabytes: float = 50.0
    keep_gigabytes: float | None = None


@dataclass(frozen=True)
class Live:
    """Settings of the live view: the server to which Foxglove connects.

    Attributes
    ----------
    host
        Address to listen at; the default is reachable from this machine only.
    port
        TCP port; 0 for any free one.
    origins
        Web sites whose pages may connect.
    """

    host: str = "127.0.0.1"
    port: int = 8765
    origins: tuple[str, ...] = ("https://app.foxglove.dev",)


@dataclass(frozen=True)
class Ros2:
    """Settings of the ROS 2 node, which connects to a Zenoh router.

    Attributes
    ----------
    router
        Address of the Zenoh router, tcp/HOST:PORT.
    domain
        Number of the ROS domain (ROS_DOMAIN_ID).
    namespace
        Namespace of the node and its topics, without slashes; may be empty.
    commands
        Whether nodes of ROS 2 may command thrusters.
    timeout_s
        Time without a command after which thrust is zero [wall s]. A command that arrives later than the fastest one by
        more than this time is ignored.
    """

    router: str = "tcp/127.0.0.1:7447"
    domain: int = 0
    namespace: str = ""
    commands: bool = False
    timeout_s: float = 0.3


@dataclass(frozen=True)
class Rig:
    """Content of a checked rig file.

    Attributes
    ----------
    name
        Name of the boat or bench.
    path
        Path of the rig file.
    text
        Text of the file, which is attached to logs.
    speed
        Run seconds per wall second; above 1 only on simulated devices.
    log_directory
        Folder for new logs.
    devices
        Devices in the order of the file.
    thrusters
        Thrusters in the order of the file.
    limits
        Values at which a run ends.
    vehicle
        Nominal values of model parameters by name.
    segments
        Rules by which a log is split into files.
    live
        Settings of the live view.
    ros2
        Settings of the ROS 2 node.
    hardware_watchdog
        Device file of the watchdog timer of the computer, which is active while a run drives; None if it is not used.
    """

    name: str
    path: Path
    text: str
    speed: float
    log_directory: Path
    devices: tuple[Device, ...]
    thrusters: tuple[Thruster, ...] = ()
    limits: Limits = field(default_factory=Limits)
    vehicle: Mapping[str, float] = field(default_factory=dict)
    segments: Segments = field(default_factory=Segments)
    live: Live = field(default_factory=Live)
    ros2: Ros2 = field(default_factory=Ros2)
    hardware_watchdog: Path | None = None

    def device(self, name: str) -> Device:
        """Return the device with a name. Raise SeatrialError, which lists the known names, if there is none."""
        return _find_by_name(name, self.devices, "device", self.path)

    def thruster(self, name: str) -> Thruster:
        """Return the thruster with a name. Raise SeatrialError, which lists the known names, if there is none."""
        return _find_by_name(name, self.thrusters, "thruster", self.path)


def parse_address(port: str) -> tuple[str, int]:
    """Return host and port number of a network address: `udp:HOST:PORT`, or the same with `udpin`, `udpout` or `tcp`.

    The brackets of an IPv6 address are removed. The word before the first colon is not checked.

    Raises
    ------
    ValueError
        If the address lacks a host or a port number from 1 to 65535.
    """
    host, _, number = port.partition(":")[2].rpartition(":")
    if not host or not (number.isascii() and number.isdigit() and 0 < int(number) < 65536):
        raise ValueError(f"must be udp:HOST:PORT, udpin:HOST:PORT, udpout:HOST:PORT or tcp:HOST:PORT, not '{port}'")
    return host.strip("[]"), int(number)


def _find_by_name(name: str, rows: Sequence[Named], label: str, path: Path) -> Named:
    """Return the device or thruster of a rig with a name. If there is none, raise SeatrialError with the known names.

    `rows` are all devices or thrusters, `label` is "device" or "thruster", and `path` is that of the rig file.
    """
    for row in rows:
        if row.name == name:
            return row
    known = ", ".join(row.name for row in rows) or "none"
    raise SeatrialError(f"{path}: the rig has no {label} '{name}'; give one that it has: {known}")
