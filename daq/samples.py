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


def wrap_angle(angle: float) -> float:
    """Return an angle [rad] plus or minus whole turns, so that it is within -pi..pi. NaN stays NaN.

    Raise ValueError if the angle is infinite.
    """
    return math.remainder(angle, math.tau)


@dataclass(frozen=True, slots=True)
class Ahrs:
    """Attitude, body rates, specific force and magnetic field of an AHRS or IMU, in body axes (FRD).

    Attributes
    ----------
    yaw
        Heading from true north, clockwise [rad].
    pitch
        Pitch angle, positive with the bow up [rad].
    roll
        Roll angle, positive with starboard down [rad].
    p
        Roll rate [rad/s].
    q
        Pitch rate [rad/s].
    r
        Yaw rate [rad/s].
    ax
        Specific force forward [m/s2]; at rest and level the three are 0, 0, -9.81.
    ay
        Specific force to starboard [m/s2].
    az
        Specific force down [m/s2].
    mx
        Magnetic field forward [T].
    my
        Magnetic field to starboard [T].
    mz
        Magnetic field down [T].
    """

    yaw: float
    pitch: float
    roll: float
    p: float = NAN
    q: float = NAN
    r: float = NAN
    ax: float = NAN
    ay: float = NAN
    az: float = NAN
    mx: float = NAN
    my: float = NAN
    mz: float = NAN


@dataclass(frozen=True, slots=True)
class Gnss:
    """One epoch of a GNSS receiver.

    A receiver at low speed may report a speed without a course; its velocity is then NaN. A differential or RTK fix may
    be two-dimensional, so `fix` and `dimensions` are separate fields.

    Attributes
    ----------
    utc
        Time of the fix [s since 1970, UTC].
    lat
        Latitude [deg], positive to the north.
    lon
        Longitude [deg], positive to the east.
    alt
        Height above mean sea level [m].
    vel_n
        Velocity over ground, north [m/s].
    vel_e
        Velocity over ground, east [m/s].
    vel_d
        Velocity down [m/s].
    fix
        Kind of fix: 0 none, 1 dead reckoning, 2 two-dimensional, 3 three-dimensional, 4 differential, 5 RTK fixed, 6
        RTK float.
    n_sat
        Number of satellites; -1 if it is not reported.
    hdop
        Horizontal dilution of precision.
    sigma_h
        Standard deviation of the horizontal position per axis [m].
    speed
        Horizontal speed over ground [m/s]; the norm of the velocity if the receiver does not report a speed.
    dimensions
        0 without a fix, 2 with a fixed height, 3 with a height, -1 if it is not reported. It follows from `fix` if that
        is 0, 2 or 3.
    """

    utc: float
    lat: float
    lon: float
    alt: float = NAN
    vel_n: float = NAN
    vel_e: float = NAN
    vel_d: float = NAN
    fix: int = 0
    n_sat: int = -1
    hdop: float = NAN
    sigma_h: float = NAN
    speed: float = NAN
    dimensions: int = -1

    def __post_init__(self) -> None:
        """Complete a GNSS fix whose receiver reports no speed or no dimensions.

        The speed is then the norm of the horizontal velocity (NaN if that is unknown). The dimensions follow from `fix`
        if it is 0, 2 or 3, and else stay -1.
        """
        if self.speed != self.speed:
            object.__setattr__(self, "speed", math.hypot(self.vel_n, self.vel_e))
        if self.dimensions < 0 and self.fix in (0, 2, 3):
            object.__setattr__(self, "dimensions", self.fix)


@dataclass(frozen=True, slots=True)
class Esc:
    """State of one thruster's speed controller.

    Attributes
    ----------
    node
        Controller id on the bus, or number of the servo output of an autopilot.
    rpm
        Speed of the shaft [rev/min], positive forward: the electrical speed divided by the pole pairs. The sign of a
        thruster with `reversed` in the rig is changed, except with the protocol dbc. Behind an autopilot, a speed
        without a sign gets that of the command.
    current
        Current of the motor [A].
    duty
        Duty cycle, -1..1, positive forward; behind an autopilot the command of the output.
    voltage
        Voltage of the supply [V].
    temperature
        Temperature of the controller [deg C].
    """

    node: int
    rpm: float = NAN
    current: float = NAN
    duty: float = NAN
    voltage: float = NAN
    temperature: float = NAN


@dataclass(frozen=True, slots=True)
class LoadCell:
    """One reading of a load cell. ``force`` follows from ``counts`` by the calibration in the rig.

    Attributes
    ----------
    counts
        Raw reading of the converter [counts].
    force
        Force along the thrust axis, positive for forward thrust [N].
    flags
        Bit 0 is set if the reading is saturated, bit 1 if it is a spike.
    """

    counts: float
    force: float = NAN
    flags: int = 0


@dataclass(frozen=True, slots=True)
class Command:
    """Command to a thruster. Its time is that of sending.

    Attributes
    ----------
    node
        Controller id on the bus, or number of the servo output.
    n_cmd
        Normalised shaft speed or duty, -1..1, positive forward.
    """

    node: int
    n_cmd: float


@dataclass(frozen=True, slots=True)
class Servo:
    """Pulse at one output of an autopilot, after the limits and the mixing of the autopilot.

    Attributes
    ----------
    node
        Number of the output, from 1.
    pwm
        Pulse width [us]; 0 without a pulse.
    n
        Command, -1..1, by the pulse widths in the rig, positive forward; 0 without a pulse. NaN without a rig, or if
        the autopilot drives no thruster of the rig.
    """

    node: int
    pwm: float
    n: float = NAN


@dataclass(frozen=True, slots=True)
class Battery:
    """State of a battery.

    Attributes
    ----------
    voltage
        Voltage [V].
    current
        Current [A], positive while the battery discharges.
    remaining
        Remaining charge, 0..1.
    """

    voltage: float = NAN
    current: float = NAN
    remaining: float = NAN


@dataclass(frozen=True, slots=True)
class Autopilot:
    """State of an autopilot.

    Attributes
    ----------
    armed
        1 if the motors are armed, 0 if not.
    mode
        Number of the mode by the autopilot's definition (ArduPilot Rover: 0 MANUAL, 4 HOLD).
    state
        State of the system (MAV_STATE): 3 standby, 4 active, 5 critical, 6 emergency.
    ekf
        Flags of its estimator (EKF_STATUS_REPORT); -1 before the first.
    """

    armed: int
    mode: int
    state: int
    ekf: int = -1


@dataclass(frozen=True, slots=True)
class Scalar:
    """Value of a named signal of an imported file. The log's topic contains its name, the log's channel its unit.

    Attributes
    ----------
    value
        Value in the unit of the channel.
    """

    value: float


@dataclass(frozen=True, slots=True)
class Transducer(Scalar):
    """Value of a named transducer of a device, for example of the NMEA sentence XDR.

    A log stores it as the `Scalar` signal `name`, not under the name of the device.

    Attributes
    ----------
    name
        Name of the signal in the log, such as `xdr_ENGINE_0`.
    unit
        Unit of the value.
    """

    name: str  # of the signal in the log, for example xdr_ENGINE_0: letters, digits and _
    unit: str  # of `value`


@dataclass(frozen=True, slots=True)
class Event:
    """Event of a run, for example the start of a segment, a tare, or a stop with its reason.

    Attributes
    ----------
    kind
        Kind of the event, such as "segment" or "stop".
    text
        Description in one line.
    """

    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class PortHealth:
    """Counters of one port since the start of the log.

    Attributes
    ----------
    port
        Device file or address.
    bytes_in
        Number of received bytes.
    frames
        Number of valid frames.
    checksum_errors
        Number of frames with a wrong checksum.
    unparsed_bytes
        Number of received bytes that belong to no valid frame.
    dropped
        Number of samples, and of reads and writes without samples, for which the log queue had no room.
    reconnects
        How often the port was opened again after a loss.
    clock_bias
        Mean of receive time minus estimated sample time [s]; NaN for a device without a clock, or before its first
        sample.
    clock_spread
        Standard deviation of the same difference [s]; NaN for a device without a clock, or before its second sample.
    """

    port: str
    bytes_in: int
    frames: int
    checksum_errors: int
    unparsed_bytes: int
    dropped: int
    reconnects: int
    clock_bias: float
    clock_spread: float


MEASURED = (Ahrs, Gnss, Esc, LoadCell, Servo, Battery, Autopilot, Scalar)  # kinds that a device or a file contains
Sample = Ahrs | Gnss | Esc | LoadCell | Command | Servo | Battery | Autopilot | Scalar | Event | PortHealth


class Frame(NamedTuple):
    """Decoded sample with its times, as ``Decoder.feed`` returns it.

    Attributes
    ----------
    sample
        The sample.
    t_rx
        Run time at which the read of the sample's bytes returned [s].
    t_device
        Time by the clock of the device [s] (any origin); NaN if the sample has no such time.
    """

    sample: Sample
    t_rx: float
    t_device: float
