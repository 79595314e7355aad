"""Conversion between samples and messages: topics and message types of a sample, and its columns from decoded messages.

docs/formats/log.md has the table of topics; the files in daq/msg define the messages.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields
from functools import cache
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.geometry import euler_angles, quaternion
from seatrial.daq.log.cdr import cdr_layout, doubles
from seatrial.daq.samples import (
    Ahrs,
    Autopilot,
    Battery,
    Command,
    Esc,
    Frame,
    Gnss,
    LoadCell,
    Scalar,
    Servo,
    Transducer,
)

IMU = "sensor_msgs/msg/Imu"
MAG = "sensor_msgs/msg/MagneticField"
FIX = "sensor_msgs/msg/NavSatFix"
TWIST = "geometry_msgs/msg/TwistStamped"
WRENCH = "geometry_msgs/msg/WrenchStamped"
DEVICE_TIME = "seatrial_msgs/msg/DeviceTime"
RAW = "seatrial_msgs/msg/RawBytes"
EVENT = "seatrial_msgs/msg/Event"
HEALTH = "seatrial_msgs/msg/PortHealth"
TYPES = {  # samples whose message consists of header, t_rx, t_device and the fields of the sample
    Gnss: "seatrial_msgs/msg/Gnss",
    Esc: "seatrial_msgs/msg/Esc",
    Command: "seatrial_msgs/msg/Command",
    LoadCell: "seatrial_msgs/msg/LoadCell",
    Servo: "seatrial_msgs/msg/Servo",
    Battery: "seatrial_msgs/msg/Battery",
    Autopilot: "seatrial_msgs/msg/Autopilot",
    Scalar: "seatrial_msgs/msg/Scalar",
}
SAMPLE_TYPES = frozenset((DEVICE_TIME, *TYPES.values())) - {TYPES[Command]}  # one message for each sample of a device
Measured = Ahrs | Gnss | Esc | Command | LoadCell | Servo | Battery | Autopilot | Scalar
NODE_TOPICS: dict[type, str] = {Esc: "state", Command: "command", Servo: "servo"}  # kinds with a topic for each node
_LAST: dict[type, str] = {
    Ahrs: "imu",
    Gnss: "gnss",
    LoadCell: "counts",
    Battery: "battery",
    Autopilot: "autopilot",
}
Columns = dict[str, NDArray[np.float64] | NDArray[np.int64]]

ADDED = {TYPES[Gnss]: ("speed", "dimensions")}  # last fields of a message that logs of older versions lack

_ZERO9 = doubles(*(0.0,) * 9)  # "covariance unknown" in sensor_msgs
_NONE9 = doubles(-1.0, *(0.0,) * 8)  # "no estimate of this quantity"
_UNKNOWN_VARIANCE = 1e6  # rad2, marks an unknown angle beside a known one, such as the roll of a compass
_VARIANCE_PLACE = {"roll": 0, "pitch": 4, "yaw": 8}  # index of the variance in the covariance of an orientation


class Message(NamedTuple):
    """One message to write to a log: its topic, type, frame and values.

    Attributes
    ----------
    topic
        Topic of the message.
    type_name
        Message type, package/msg/Name.
    frame_id
        Name of the coordinate frame, or of the device, in the header, such as "ahrs_frd_ned".
    values
        Values of the fixed fields after the header, in the form that `cdr.CdrLayout.pack` needs: numbers, and arrays as
        bytes.
    """

    topic: str
    type_name: str
    frame_id: str
    values: tuple[float | bytes, ...]

    def pack(self, stamp_ns: int) -> bytes:
        """Return the message as bytes in CDR with a time stamp [ns since 1970]."""
        return cdr_layout(self.type_name, self.frame_id.encode()).pack(stamp_ns, *self.values)


def field_names(kind: type[Measured]) -> list[str]:
    """Return the names of the fields of a class of samples, in order, for example "node", "rpm", ... for `Esc`.

    The times of a sample (t, t_rx, t_device) are no fields of its class.
    """
    return [field.name for field in fields(kind)]


_GETTERS: dict[type, Callable[[object], tuple[float, ...]]] = {
    kind: attrgetter(*field_names(kind)) for kind in TYPES if len(fields(kind)) > 1
}
_GETTERS[Scalar] = lambda sample: (sample.value,)  # type: ignore[attr-defined]


def topic(kind: type[Measured], source: str, node: int | None = None) -> str:
    """Return the topic of a log whose messages contain the samples of a kind, for example "/gps/gnss" for `Gnss`.

    Parameters
    ----------
    kind
        Class of the sample.
    source
        Name of the device, or of the signal for `Scalar`.
    node
        Id of the controller or servo output, for `Esc`, `Command` and `Servo` (`NODE_TOPICS`), which need one; unused
        for other kinds.
    """
    if kind is Scalar:
        return f"/signal/{source}"
    if kind in NODE_TOPICS:
        return f"/{source}/{node}/{NODE_TOPICS[kind]}"
    return f"/{source}/{_LAST[kind]}"


def messages(device: str, frame: Frame) -> list[Message]:
    """Convert one sample of a device to its messages in a log. The first of them contains t_rx and t_device.

    An `Ahrs`, a `Gnss`, and a `LoadCell` with a force also become standard ROS messages on topics of their own. All
    other samples become one message, which has all fields of the sample. A `Transducer` becomes the message of a
    `Scalar` with the name of the transducer instead of the device.

    Parameters
    ----------
    device
        Name of the device, or of the signal for `Scalar`.
    frame
        The sample with its times.

    Raises
    ------
    TypeError
        If the sample is an event or a set of port counters, which are not measurements.
    """
    sample = frame.sample
    if isinstance(sample, Ahrs):
        return _ahrs_messages(device, sample, (frame.t_rx, frame.t_device))
    if isinstance(sample, Transducer):
        device, sample = sample.name, Scalar(sample.value)
    type_name = TYPES.get(type(sample))
    if type_name is None:
        raise TypeError(f"{type(sample).__name__} is not a measurement")
    node = sample.node if isinstance(sample, (Esc, Command, Servo)) else None
    values = (frame.t_rx, frame.t_device, *_GETTERS[type(sample)](sample))
    first = Message(topic(type(sample), device, node), type_name, device, values)  # type: ignore[arg-type]
    if isinstance(sample, Gnss):
        return [first, *_gnss_messages(device, sample)]
    if isinstance(sample, LoadCell) and not math.isnan(sample.force):
        return [first, Message(f"/{device}/wrench", WRENCH, device, (sample.force, 0.0, 0.0, 0.0, 0.0, 0.0))]
    return [first]


@cache
def _ahrs_topics(device: str) -> tuple[str, str, str, str]:
    """Return the frame_id of an AHRS, and the topics of its device times, its Imu messages and its magnetic field."""
    return f"{device}_frd_ned", f"/{device}/device_time", f"/{device}/imu", f"/{device}/mag"


def _ahrs_messages(device: str, s: Ahrs, times: tuple[float, float]) -> list[Message]:
    """Return the messages of a sample of an AHRS: device times, Imu and, if any part of it is known, magnetic field.

    `times` are t_rx and t_device [s]. The covariances of the Imu message mark unknown quantities. The first element for
    the orientation is -1 if no angle is known. The first element for the rates, or for the accelerations, is -1 if one
    of the three is unknown. If only some angles are known, as by a compass, each unknown angle has the variance 1e6
    rad2. An unknown angle is written as 0.
    """
    frame_id, time, imu, mag = _ahrs_topics(device)
    whole = not math.isnan(s.yaw + s.pitch + s.roll)
    values = (
        *(quaternion(s.yaw, s.pitch, s.roll) if whole else quaternion(*_zero_if_unknown(s.yaw, s.pitch, s.roll))),
        _ZERO9 if whole else _partial_covariance(s.yaw == s.yaw, s.pitch == s.pitch, s.roll == s.roll),
        *(s.p, s.q, s.r),
        _NONE9 if math.isnan(s.p + s.q + s.r) else _ZERO9,
        *(s.ax, s.ay, s.az),
        _NONE9 if math.isnan(s.ax + s.ay + s.az) else _ZERO9,
    )
    found = [Message(time, DEVICE_TIME, frame_id, times), Message(imu, IMU, frame_id, values)]
    if s.mx == s.mx or s.my == s.my or s.mz == s.mz:
        found.append(Message(mag, MAG, frame_id, (s.mx, s.my, s.mz, _ZERO9)))
    return found


def _zero_if_unknown(*angles: float) -> tuple[float, ...]:
    """Return the angles with 0 in place of NaN."""
    return tuple(0.0 if math.isnan(angle) else angle for angle in angles)


@cache
def _partial_covariance(yaw: bool, pitch: bool, roll: bool) -> bytes:
    """Return the covariance of an orientation of which an angle is unknown, as bytes of 9 numbers.

    The arguments are whether the angles are known. If none is, the first number is -1, otherwise the variance of each
    unknown angle is 1e6 rad2.
    """
    known = {"yaw": yaw, "pitch": pitch, "roll": roll}
    covariance = [0.0] * 9
    for angle, place in _VARIANCE_PLACE.items():
        covariance[place] = 0.0 if known[angle] else _UNKNOWN_VARIANCE
    return doubles(*covariance) if any(known.values()) else _NONE9


def _gnss_messages(device: str, s: Gnss) -> list[Message]:
    """Return the standard ROS messages of a GNSS sample: NavSatFix, and TwistStamped for a known velocity.

    TwistStamped needs a `fix` other than 0 and a velocity north and east; an unknown velocity down becomes zero. The
    status of the fix in NavSatFix is -1 for `fix` below 2, 0 for 2 and 3, and 2 from 4 on. The variance of the position
    is `sigma_h` squared, four times as much vertically; without `sigma_h` the variances are marked as unknown.
    """
    # NavSatStatus: -1 no fix, 0 fix, 2 ground-based augmentation (differential and RTK); service 1 is GPS.
    status = -1 if s.fix < 2 else 2 if s.fix >= 4 else 0
    variance = s.sigma_h * s.sigma_h
    if math.isnan(variance):
        covariance, kind = _ZERO9, 0
    else:  # receivers do not report sigma_v; twice sigma_h is the usual rule, so the variance is four times as large
        covariance, kind = doubles(variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, 4.0 * variance), 1
    found = [Message(f"/{device}/fix", FIX, device, (status, 1, s.lat, s.lon, s.alt, covariance, kind))]
    if s.fix and not (math.isnan(s.vel_n) or math.isnan(s.vel_e)):
        down = 0.0 if math.isnan(s.vel_d) else s.vel_d
        found.append(Message(f"/{device}/velocity", TWIST, f"{device}_ned", (s.vel_n, s.vel_e, down, 0.0, 0.0, 0.0)))
    return found


def imu_columns(rows: NDArray[np.void]) -> Columns:
    """Convert decoded ROS Imu messages, shape (n,), to the columns of an `Ahrs` table, except the magnetic field.

    The columns are yaw, pitch and roll [rad], the rates p, q and r [rad/s], and the specific force ax, ay and az
    [m/s2], each with shape (n,). Angles that the covariance marks as unknown are NaN. Rates and specific forces are not
    changed.
    """
    yaw, pitch, roll = euler_angles(*(rows[f"orientation.{axis}"] for axis in "xyzw"))
    unknown = rows["orientation_covariance"][:, 0] == -1.0
    columns: Columns = {"yaw": yaw, "pitch": pitch, "roll": roll}
    for column in columns.values():
        column[unknown] = np.nan
    for name, place in _VARIANCE_PLACE.items():
        columns[name][rows["orientation_covariance"][:, place] >= _UNKNOWN_VARIANCE] = np.nan
    for names, vector in (("pqr", "angular_velocity"), (("ax", "ay", "az"), "linear_acceleration")):
        for name, axis in zip(names, "xyz", strict=True):
            columns[name] = rows[f"{vector}.{axis}"]
    return columns


def own_columns(kind: type[Measured], rows: NDArray[np.void]) -> Columns:
    """Convert decoded messages of a kind of samples, shape (n,), to the columns of its table, with t_rx and t_device.

    The kind is any but `Ahrs`. All fields of the messages become columns by their names, those of the header too. Two
    columns of `Gnss` that older logs lack are computed: `speed` is the norm of the horizontal velocity [m/s], and
    `dimensions` (of the fix) is `fix` if that is 0, 2 or 3, else -1.
    """
    columns: Columns = {name: rows[name] for name in rows.dtype.names or ()}
    if kind is Gnss and "speed" not in columns:  # a log of an older version: same rule as the defaults of `Gnss`
        fix = columns["fix"]
        columns["speed"] = np.hypot(columns["vel_n"], columns["vel_e"])
        columns["dimensions"] = np.where(np.isin(fix, (0, 2, 3)), fix, -1)
    return columns
