"""Classes of the samples of devices, one class per kind. Values are in SI units, and angles are in radians.

The body axes are forward, starboard, down (FRD). The local frame is north, east, down (NED). Yaw is positive clockwise
seen from above, and zero at true north. Latitude and longitude are in degrees, as in GNSS messages and in
``sensor_msgs/NavSatFix``. A value that the device does not report is NaN, or -1 for an integer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

NAN = float("nan")
# WGS 84 (NIMA TR8350.2, tables 3.1 and 3.3); the first eccentricity squared with the digits of the table.
WGS84_SEMI_MAJOR_AXIS = 6378137.0  # m
WGS84_FLATTENING = 1.0 / 298.257223563
WGS84_ECCENTRICITY_2 = 6.69437999014e-3


def wrap_angle(angle: float) -> float:
    """Wrap an angle [rad] to -pi..pi."""
    return math.remainder(angle, math.tau)


@dataclass(frozen=True, slots=True)
class Ahrs:
    """Attitude, body rates, specific force and magnetic field of an AHRS or IMU."""

    yaw: float  # rad, NED
    pitch: float  # rad
    roll: float  # rad
    p: float = NAN  # rad/s, body rates
    q: float = NAN
    r: float = NAN
    ax: float = NAN  # m/s2, specific force (at rest and level: 0, 0, -9.81)
    ay: float = NAN
    az: float = NAN
    mx: float = NAN  # T
    my: float = NAN
    mz: float = NAN


@dataclass(frozen=True, slots=True)
class Gnss:
    """One epoch of a GNSS receiver.

    A receiver at low speed may report a speed without a course; its velocity is then NaN. A differential or RTK fix may
    be two-dimensional, so `fix` and `dimensions` are separate fields.
    """

    utc: float  # s since 1970-01-01 UTC
    lat: float  # deg
    lon: float  # deg
    alt: float = NAN  # m above mean sea level
    vel_n: float = NAN  # m/s over ground
    vel_e: float = NAN
    vel_d: float = NAN
    fix: int = 0  # 0 none, 1 dead reckoning, 2 2D, 3 3D, 4 differential, 5 RTK fixed, 6 RTK float
    n_sat: int = -1  # number of satellites
    hdop: float = NAN
    sigma_h: float = NAN  # m, standard deviation of the horizontal position per axis
    speed: float = NAN  # m/s over ground, horizontal; the norm of the velocity if the receiver does not report a speed
    # 0 no fix, 2 with a fixed height, 3, -1 not reported. Follows from ``fix`` if that is 0, 2 or 3.
    dimensions: int = -1

    def __post_init__(self) -> None:
        if self.speed != self.speed:
            object.__setattr__(self, "speed", math.hypot(self.vel_n, self.vel_e))
        if self.dimensions < 0 and self.fix in (0, 2, 3):
            object.__setattr__(self, "dimensions", self.fix)


@dataclass(frozen=True, slots=True)
class Esc:
    """State of one thruster's speed controller."""

    node: int  # controller id on the bus
    rpm: float = NAN  # rev/min of the shaft (electrical speed divided by the pole pairs), signed
    current: float = NAN  # A, motor
    duty: float = NAN  # -1..1
    voltage: float = NAN  # V, supply
    temperature: float = NAN  # deg C, controller


@dataclass(frozen=True, slots=True)
class LoadCell:
    """One reading of a load cell. ``force`` follows from ``counts`` by the calibration in the rig."""

    counts: float  # raw reading
    force: float = NAN  # N, along the thrust axis, positive for forward thrust
    flags: int = 0  # bit 0 saturated, bit 1 spike


@dataclass(frozen=True, slots=True)
class Command:
    """Command to a thruster. Its time is that of sending."""

    node: int
    n_cmd: float  # normalised shaft speed or duty, -1..1, sign as in the rig (positive forward)


@dataclass(frozen=True, slots=True)
class Servo:
    """Pulse at one output of an autopilot, after the limits and the mixing of the autopilot."""

    node: int  # number of the output, from 1
    pwm: float  # us; 0 without a pulse
    n: float = NAN  # -1..1 by the pulse widths in the rig, positive forward; NaN without a rig


@dataclass(frozen=True, slots=True)
class Battery:
    """State of a battery."""

    voltage: float = NAN  # V
    current: float = NAN  # A, positive while the battery discharges
    remaining: float = NAN  # charge, 0..1


@dataclass(frozen=True, slots=True)
class Autopilot:
    """State of an autopilot."""

    armed: int  # 1 armed, 0 not
    mode: int  # number of the mode by the autopilot's definition (ArduPilot Rover: 0 MANUAL, 4 HOLD)
    state: int  # MAV_STATE: 3 standby, 4 active, 5 critical, 6 emergency
    ekf: int = -1  # flags of EKF_STATUS_REPORT; -1 before the first


@dataclass(frozen=True, slots=True)
class Scalar:
    """Value of a named signal of an imported file. The log's topic contains its name, the log's channel its unit."""

    value: float


@dataclass(frozen=True, slots=True)
class Transducer(Scalar):
    """Value of a named transducer of a device, for example of the NMEA sentence XDR.

    A log stores it as the `Scalar` signal `name`, not under the name of the device.
    """

    name: str  # of the signal in the log, for example xdr_ENGINE_0: letters, digits and _
    unit: str  # of `value`


@dataclass(frozen=True, slots=True)
class Event:
    """Event of a run, for example the start of a segment, a tare, or a stop with its reason."""

    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class PortHealth:
    """Counters of one port since the start of the log."""

    port: str
    bytes_in: int
    frames: int
    checksum_errors: int
    unparsed_bytes: int
    dropped: int
    reconnects: int
    clock_bias: float  # s, mean of receive time minus estimated sample time
    clock_spread: float  # s, standard deviation of the same difference


MEASURED = (Ahrs, Gnss, Esc, LoadCell, Servo, Battery, Autopilot, Scalar)  # kinds that a device or a file contains
Sample = Ahrs | Gnss | Esc | LoadCell | Command | Servo | Battery | Autopilot | Scalar | Event | PortHealth


class Frame(NamedTuple):
    """Decoded sample with its times, as ``Decoder.feed`` returns it."""

    sample: Sample
    t_rx: float  # s, run time at which the read of the sample's bytes returned
    t_device: float  # s, time by the clock of the device (any origin); NaN if the device has no clock
