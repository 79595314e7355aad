"""`seatrial import ros2`: a bag of ROS 2 (MCAP or sqlite3) -> a log.

Imu becomes Ahrs and NavSatFix becomes Gnss; every other message gives a signal for each of its numbers. ROS counts
axes forward, left, up and the attitude from east (REP-103); ours are forward, starboard, down, from north.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from daq.errors import SeatrialError, counted
from daq.importers.common import SignalRow, write_frames
from daq.log import schema
from daq.samples import NAN, Ahrs, Frame, Gnss, Scalar, wrap_angle

IMU, FIX = "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix"
LONGEST = 16  # numbers of an array that become signals; images and clouds do not
# NavSatStatus -> Gnss.fix: no fix, fix, augmented by satellites, by ground stations.
_FIXES = {-1: 0, 0: 3, 1: 4, 2: 4}
_ROSBAGS = "ROS 2 bags need the package rosbags: pip install 'seatrial[ros2]'"


def import_ros2(
    path: Path,
    *,
    topics: Mapping[str, str] | None = None,
    axes: str = "ros",
    out: Path | None = None,
    force: bool = False,
) -> tuple[Path, str]:
    """Import a bag (a .mcap or .db3 file, or its folder); returns the path of the log and a summary in one line.

    `topics` names those to take, each with the name it gets here; without it all are taken, named after themselves.
    `axes` is "ros" (REP-103) or "ned" for bags that use our own axes already. The time of a message is its header's
    stamp, or else when the bag got it. Raises SeatrialError.
    """
    rows: list[SignalRow] = []
    left_out: Counter[str] = Counter()
    measured: dict[str, set[str]] = {}
    for topic, kind, t, message in _messages(path, topics):
        name = (topics or {}).get(topic) or _name(topic)
        if kind == IMU:
            measured.setdefault(name, set()).update(_measured(message))
        found = list(_rows(kind, name, t, message, axes))
        rows += found
        if not found:
            left_out[topic] += 1
    said = counted(len(rows), "sample") + (f"; nothing to take in {', '.join(left_out)}" if left_out else "")
    if not rows:
        raise SeatrialError(f"{path}: no messages with numbers in them{' on these topics' if topics else ''}")
    rows = [_without_unmeasured(row, measured[row.device]) if row.device in measured else row for row in rows]
    target = out or Path(f"{path.stem}-seatrial.mcap")
    metadata = {"import": "ros2", "import.axes": axes, "source.1.name": path.name, "source.1.sha256": _sha256(path)}
    write_frames(target, rows, metadata=metadata, note=f"{path.name}: {said}", force=force)
    return target, said


def _messages(path: Path, topics: Mapping[str, str] | None) -> Iterator[tuple[str, str, float, Any]]:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError as error:
        raise SeatrialError(_ROSBAGS) from error
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            there = {connection.topic for connection in reader.connections}
            for topic in topics or {}:
                if topic not in there:
                    raise SeatrialError(f"{path}: no topic {topic}; there is: {', '.join(sorted(there)) or 'none'}")
            wanted = [c for c in reader.connections if topics is None or c.topic in topics]
            for connection, log_ns, data in reader.messages(connections=wanted):
                message = reader.deserialize(data, connection.msgtype)
                yield connection.topic, connection.msgtype, _stamp(message) or 1e-9 * log_ns, message
    except SeatrialError:
        raise
    except Exception as error:  # rosbags has errors of many kinds for a file that is none, or damaged
        raise SeatrialError(f"{path}: cannot be read as a ROS 2 bag: {' '.join(str(error).split())}") from error


def _stamp(message: Any) -> float:
    """The header's time [s]; 0 where there is none."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return 0.0 if stamp is None else stamp.sec + 1e-9 * stamp.nanosec


def _name(topic: str) -> str:
    name = re.sub(r"[^A-Za-z0-9]+", "_", topic).strip("_")
    return name if name[:1].isalpha() else f"t_{name}"


def _rows(kind: str, name: str, t: float, message: Any, axes: str) -> Iterator[SignalRow]:
    if kind == IMU:
        yield SignalRow(t, name, Frame(_ahrs(message, axes), t, NAN))
    elif kind == FIX:
        yield SignalRow(t, name, Frame(_gnss(message, t), t, NAN))
    else:
        for field, value in _numbers(message):
            yield SignalRow(t, f"{name}_{field}", Frame(Scalar(value), t, NAN))


# What an Imu may have, the fields of Ahrs that it becomes, and what stands there where nothing was measured
IMU_PARTS = {
    "orientation": (("yaw", "pitch", "roll"), ((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))),
    "angular_velocity": (("p", "q", "r"), ((0.0, 0.0, 0.0),)),
    "linear_acceleration": (("ax", "ay", "az"), ((0.0, 0.0, 0.0),)),
}


def _measured(message: Any) -> set[str]:
    """Parts of an Imu with a measurement. By the standard, -1 as the first covariance says that there is none; but many
    drivers write it for an unknown covariance, so the part is taken all the same once it has other values than its
    default."""
    found = set()
    for part, (_, nothing) in IMU_PARTS.items():
        value = getattr(message, part)
        numbers = tuple(float(getattr(value, axis)) for axis in "xyzw" if hasattr(value, axis))
        if getattr(message, f"{part}_covariance")[0] != -1.0 or numbers not in nothing:
            found.add(part)
    return found


def _without_unmeasured(row: SignalRow, measured: set[str]) -> SignalRow:
    gone = [name for part, (names, _) in IMU_PARTS.items() if part not in measured for name in names]
    if not gone or not isinstance(row.frame.sample, Ahrs):
        return row
    return row._replace(frame=row.frame._replace(sample=replace(row.frame.sample, **dict.fromkeys(gone, NAN))))


def _ahrs(message: Any, axes: str) -> Ahrs:
    q, w, a = message.orientation, message.angular_velocity, message.linear_acceleration
    yaw, pitch, roll = (float(angle[0]) for angle in schema.angles(*(np.array([v]) for v in (q.x, q.y, q.z, q.w))))
    sign = 1.0
    if axes == "ros":
        yaw, pitch, sign = wrap_angle(math.pi / 2.0 - yaw), -pitch, -1.0
    if q.x == q.y == q.z == q.w == 0.0:
        yaw = pitch = roll = NAN
    return Ahrs(yaw, pitch, roll, w.x, sign * w.y, sign * w.z, a.x, sign * a.y, sign * a.z)


def _gnss(message: Any, t: float) -> Gnss:
    covariance = message.position_covariance
    sigma = math.sqrt(max(0.5 * (covariance[0] + covariance[4]), 0.0)) if message.position_covariance_type else NAN
    fix = _FIXES.get(int(message.status.status), 0)
    return Gnss(t, message.latitude, message.longitude, message.altitude, fix=fix, sigma_h=sigma)


def _numbers(message: Any, prefix: str = "") -> Iterator[tuple[str, float]]:
    """Every number of a message by the name of its field, in order; header and text left out."""
    for field in fields(message):
        if field.name in ("header", "__msgtype__"):
            continue
        value, name = getattr(message, field.name), f"{prefix}{field.name}"
        if is_dataclass(value):
            yield from _numbers(value, f"{name}_")
        elif isinstance(value, (bool, int, float, np.number)):
            yield name, float(value)
        elif isinstance(value, np.ndarray) and value.ndim == 1 and len(value) <= LONGEST:
            for k, one in enumerate(value.tolist()):
                yield f"{name}_{k}", float(one)


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        if file.is_file():
            with file.open("rb") as opened:
                while block := opened.read(1 << 20):
                    digest.update(block)
    return digest.hexdigest()
