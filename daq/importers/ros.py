"""Bags of ROS 1 and ROS 2 -> a table for each topic, its columns the numbers of its messages by the names of fields.

Axes are those of the bag; the map turns them (REP-103: forward, left, up; east, north, up).
"""

from __future__ import annotations

import contextlib
import os
import shutil
import sqlite3
import tempfile
from array import array
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.files import require_file
from seatrial.daq.importers.missing_inputs import stopped_motors
from seatrial.daq.importers.stamps import EstimatedTimes, MessageTimes, message_times
from seatrial.daq.importers.table import Column, SourceOptions, Table, ran_back
from seatrial.daq.log import recover_log

BAG_ENDINGS = {".mcap", ".db3"}
SQLITE_LOGS = ("-wal", "-journal")  # appended to the name of a database
MCAP_MAGIC = b"\x89MCAP0\r\n"
IMU, FIX = "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix"
CLOCK = "rosgraph_msgs/msg/Clock"  # of a simulation: its time, without a header
TRANSFORM = "geometry_msgs/msg/TransformStamped"
LONGEST = 16  # numbers of an array that become columns; images and clouds do not
_ROSBAGS = "bags of ROS need the package rosbags: pip install 'seatrial[ros2]'"
# What an Imu may have, and what stands there where nothing was measured
IMU_PARTS = {
    "orientation": ((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
    "angular_velocity": ((0.0, 0.0, 0.0),),
    "linear_acceleration": ((0.0, 0.0, 0.0),),
}


def read_bag(path: Path, options: SourceOptions) -> list[Table]:
    """The topics with numbers. Raises SeatrialError where the bag, or a topic that the map names, is not there.

    The time of a message is its header's stamp, or else when the bag got it (`seatrial.daq.importers.stamps`). Each
    pair of
    frames in a TFMessage is a topic of its own: /tf:odom:base_link.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError as error:
        raise SeatrialError(_ROSBAGS) from error
    topics: dict[str, _Topic] = {}
    try:
        with (
            _readable(path) as (parts, remark),
            AnyReader(parts, default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader,
        ):
            there = {connection.topic for connection in reader.connections}
            named = {topic.partition(":")[0] for topic in options.topics}
            for topic in sorted(named - there):
                raise SeatrialError(f"{path}: no topic {topic}; there is: {', '.join(sorted(there)) or 'none'}")
            wanted = [c for c in reader.connections if not named or c.topic in named or c.msgtype == CLOCK]
            for connection, log_ns, data in reader.messages(connections=wanted):
                try:
                    message = reader.deserialize(data, connection.msgtype)
                except KeyError:  # of a type that neither the bag nor the library defines
                    continue
                if isinstance(transforms := getattr(message, "transforms", None), list):
                    for one in transforms:
                        name = f"{connection.topic}:{one.header.frame_id.strip('/')}:{one.child_frame_id.strip('/')}"
                        topics.setdefault(name, _Topic(TRANSFORM)).add(1e-9 * log_ns, one)
                else:
                    topics.setdefault(connection.topic, _Topic(connection.msgtype)).add(1e-9 * log_ns, message)
            for topic in sorted(one for one in options.topics - topics.keys() if ":" in one):
                raise SeatrialError(f"{path}: no transform {topic}; there is: {', '.join(sorted(topics)) or 'none'}")
    except SeatrialError:
        raise
    except Exception as error:  # rosbags has errors of many kinds for a file that is none, or damaged
        raise SeatrialError(f"{path}: cannot be read as a bag of ROS: {' '.join(str(error).split())}") from error
    times = message_times({topic: one.times for topic, one in topics.items()})
    asked = [(topic, one) for topic, one in topics.items() if not options.topics or topic in options.topics]
    tables = [table for topic, one in asked if (table := one.table(path, topic, times[topic])).columns]
    for table in tables:
        table.remark = "; ".join(part for part in (table.remark, remark) if part)
    return tables


@contextlib.contextmanager
def _readable(path: Path) -> Iterator[tuple[list[Path], str]]:
    """The files of a bag that can be read, and a remark on what was missing.

    A folder without metadata.yaml is read file by file. A .mcap without its end is recovered to a temporary file. A
    .db3 whose recorder left a log of SQLite beside it is completed in a temporary copy.
    """
    if path.name.endswith(".bag.active"):
        raise SeatrialError(
            f"{path}: a bag that was not closed; `rosbag reindex {path.name}` mends it, then name it {path.stem}"
        )
    parts, remarks = [path], []
    if path.is_dir() and not (path / "metadata.yaml").exists():
        parts = sorted((one for one in path.iterdir() if one.suffix in BAG_ENDINGS), key=_split_number)
        if not parts:
            raise SeatrialError(f"{path}: a folder without metadata.yaml, .mcap and .db3: no bag of ROS")
        remarks.append(f"without metadata.yaml: read from {counted(len(parts), 'file')}")
    with tempfile.TemporaryDirectory() as folder:
        readable: list[Path] = []
        if path.is_dir() and parts == [path]:
            parts, said = _with_sqlite_logs_of_folder(path, Path(folder))
            remarks += said
        for k, part in enumerate(parts):
            if part.suffix == ".db3" and _sqlite_logs(part):
                readable.append(_with_sqlite_logs(part, Path(folder) / f"{k}.db3"))
                remarks.append(f"{part.name} read with {' and '.join(one.name for one in _sqlite_logs(part))}")
                continue
            if part.suffix != ".mcap" or part.is_dir() or _has_end(part):
                readable.append(part)
                continue
            whole = Path(folder) / f"{k}.mcap"
            try:
                recovered = recover_log(part, whole)
            except SeatrialError as error:
                if len(parts) == 1:
                    raise SeatrialError(
                        f"{path}: cannot be read as a bag of ROS: it has no end and no message"
                    ) from error
                remarks.append(f"{part.name} holds no message that is readable")
                continue
            readable.append(whole)
            remarks.append(f"{part.name} has no end: {counted(recovered.messages, 'message')} recovered")
        if not readable:
            raise SeatrialError(f"{path}: cannot be read as a bag of ROS: none of its files has a message")
        yield readable, "; ".join(remarks)


def _sqlite_logs(path: Path) -> list[Path]:
    """The logs that SQLite has left beside a database: messages that are not in it yet, or have to be taken back."""
    beside = (path.with_name(path.name + ending) for ending in SQLITE_LOGS)
    return [one for one in beside if os.path.lexists(one) and not (one.is_file() and one.stat().st_size == 0)]


def _with_sqlite_logs(path: Path, copy: Path) -> Path:
    """Copy a database with its logs and let SQLite complete the copy: beside the original nothing may be written."""
    shutil.copyfile(path, copy)
    for log in _sqlite_logs(path):
        if log.is_symlink():  # it could name any file
            raise SeatrialError(f"{log}: is not a file")
        require_file(log)
        shutil.copyfile(log, copy.with_name(copy.name + log.name.removeprefix(path.name)))
    with contextlib.closing(sqlite3.connect(copy)) as database:
        database.execute("PRAGMA journal_mode=DELETE").fetchall()
        database.execute("SELECT count(*) FROM sqlite_master").fetchall()
    return copy


def _with_sqlite_logs_of_folder(path: Path, folder: Path) -> tuple[list[Path], list[str]]:
    """The bag of a folder with metadata.yaml, or a copy of it where a database has logs, and remarks."""
    logs = {part.name: _sqlite_logs(part) for part in sorted(path.glob("*.db3"))}
    if not any(logs.values()):
        return [path], []
    copy = folder / "bag"
    copy.mkdir()
    for part in path.iterdir():
        if logs.get(part.name):
            _with_sqlite_logs(part, copy / part.name)
        elif not part.name.endswith(SQLITE_LOGS):
            (copy / part.name).symlink_to(part.resolve())
    return [copy], [f"{name} read with {' and '.join(x.name for x in own)}" for name, own in logs.items() if own]


def _split_number(path: Path) -> tuple[int, str]:
    """The number of a split, run_10.mcap after run_9.mcap, and its name."""
    digits = path.stem.rpartition("_")[2]
    return int(digits) if digits.isdecimal() else -1, path.name


def _has_end(path: Path) -> bool:
    """Whether a .mcap ends as it should."""
    with path.open("rb") as file:
        file.seek(-min(len(MCAP_MAGIC), path.stat().st_size), 2)
        return file.read() == MCAP_MAGIC


class _Topic:
    """The messages of a topic, collected."""

    def __init__(self, kind: str) -> None:
        self.kind, self.frame_id = kind, ""
        self.t_log, self.t_stamp = array("d"), array("d")
        self._frames: dict[str, list[float]] = {}  # by frame_id: how many messages, and the first and the last receipt
        self.columns: dict[str, array[float]] = {}  # 8 bytes a number: a bag of an hour has tens of millions

    def add(self, t_log: float, message: Any) -> None:
        header = getattr(message, "header", None)
        stamp = message.clock if self.kind == CLOCK else getattr(header, "stamp", None)
        frame_id = str(getattr(header, "frame_id", ""))
        self.frame_id = self.frame_id or frame_id
        of_frame = self._frames.setdefault(frame_id, [0, t_log, t_log])
        of_frame[0], of_frame[2] = of_frame[0] + 1, t_log
        self.t_log.append(t_log)
        self.t_stamp.append(np.nan if stamp is None else stamp.sec + 1e-9 * stamp.nanosec)
        rows = len(self.t_log)
        for name, value in _numbers(message):
            column = self.columns.get(name)
            if column is None:
                column = self.columns[name] = array("d")
            if len(column) < rows:  # once a row, and NaN where rows before had no such field
                column.extend([np.nan] * (rows - 1 - len(column)))
                column.append(value)

    @property
    def times(self) -> MessageTimes:
        """Receipts and stamps of its messages."""
        return MessageTimes(np.array(self.t_log), np.array(self.t_stamp))

    def table(self, path: Path, topic: str, times: EstimatedTimes) -> Table:
        """The messages that have a time, in its order."""
        t = times.t
        order = np.argsort(t, kind="stable")[: int(np.sum(np.isfinite(t)))]
        columns = {name: self._column(name)[order] for name in self.columns}
        if self.kind == IMU:
            _leave_out_unmeasured(columns)
        if self.kind == FIX:
            for name in ("latitude", "longitude"):
                columns[name] = np.where(columns["status.status"] < 0, np.nan, columns[name])
        n_lost = len(t) - len(order)
        parts = (times.remark, stopped_motors(self.kind, columns), self._two_sensors())
        remark = "; ".join(part for part in parts if part)
        clock = "" if times.mixed else ran_back(t[np.isfinite(t)])
        return Table(path, topic, columns, t[order], self.kind, self.frame_id, remark, clock=clock, n_left_out=n_lost)

    def _two_sensors(self) -> str:
        """A remark if messages of several frames alternate: each sensor of a craft has a frame of its own."""
        frames = sorted(self._frames.items())
        if len(frames) < 2 or max(first for _, (_, first, _) in frames) > min(last for _, (_, _, last) in frames):
            return ""
        listed = " and ".join(f"{n:.0f} of frame {name!r}" for name, (n, _, _) in frames)
        return f"messages of several sensors in one topic ({listed}): give each a topic of its own"

    def _column(self, name: str) -> Column:
        found = np.full(len(self.t_log), np.nan)
        found[: len(self.columns[name])] = self.columns[name]
        return found


def _leave_out_unmeasured(columns: dict[str, Column]) -> None:
    """Take parts of an Imu without a measurement away. By the standard, -1 as the first covariance says that there is
    none; but many drivers write it for an unknown covariance, so the part stays if it ever has other values than its
    default."""
    for part, nothing in IMU_PARTS.items():
        axes = [name for name in columns if name.startswith(f"{part}.")]
        values = np.stack([columns[name] for name in axes], axis=1)
        unmeasured = columns[f"{part}_covariance[0]"] == -1.0
        default = np.any([np.all(values == one, axis=1) for one in nothing], axis=0)
        if np.all(unmeasured & default):
            for name in axes:
                del columns[name]


def _numbers(message: Any, prefix: str = "") -> Iterator[tuple[str, float]]:
    """Every number of a message by the name of its field, in order; header and text left out. Of a JointState, and
    what is built like it, the numbers have the names of the joints: velocity.left; of several messages in one their
    places: esc[0].rpm."""
    joints = getattr(message, "name", None)
    for field in fields(message):
        if field.name in ("header", "__msgtype__") or field.name.isupper():
            continue
        value, name = getattr(message, field.name), f"{prefix}{field.name}"
        if is_dataclass(value):
            yield from _numbers(value, f"{name}.")
        elif isinstance(value, list) and len(value) <= LONGEST:
            for k, one in enumerate(value):
                if is_dataclass(one):
                    yield from _numbers(one, f"{name}[{k}].")
        elif isinstance(value, (bool, int, float, np.number)):
            yield name, float(value)
        elif isinstance(value, np.ndarray) and value.ndim == 1 and len(value) <= LONGEST and value.dtype.kind in "biuf":
            named = isinstance(joints, list) and len(joints) == len(value)
            for k, one in enumerate(value.tolist()):
                yield f"{name}.{joints[k]}" if named and joints else f"{name}[{k}]", float(one)
