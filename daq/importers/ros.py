"""Reader of bags of ROS 1 and ROS 2: a table for each topic, with a column for each number of its messages.

The columns have the names of the message fields. The axes stay those of the bag (REP-103: forward, left, up; east,
north, up); the import converts them by the map.
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
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.files import require_file
from seatrial.daq.importers.missing_inputs import stopped_motors
from seatrial.daq.importers.stamps import EstimatedTimes, MessageTimes, message_times
from seatrial.daq.importers.table import Column, SourceOptions, Table, clock_remark
from seatrial.daq.log import recover_log

BAG_ENDINGS = {".mcap", ".db3"}
SQLITE_LOGS = ("-wal", "-journal")  # appended to the name of a database
MCAP_MAGIC = b"\x89MCAP0\r\n"
IMU, FIX = "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix"
CLOCK = "rosgraph_msgs/msg/Clock"  # time of a simulation, without a header
TRANSFORM = "geometry_msgs/msg/TransformStamped"
LONGEST = 16  # numbers; a longer array (image, point cloud) does not become columns
_ROSBAGS = "bags of ROS need the package rosbags: pip install 'seatrial[ros2]'"
# Parts of an Imu message, and their values if they are not measured
IMU_PARTS = {
    "orientation": ((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
    "angular_velocity": ((0.0, 0.0, 0.0),),
    "linear_acceleration": ((0.0, 0.0, 0.0),),
}


def read_bag(path: Path, options: SourceOptions) -> list[Table]:
    """Read the topics of a ROS bag that contain numbers as tables.

    Parameters
    ----------
    path
        A bag file, or the folder of a bag.
    options
        `topics`: the topics to read; all topics if empty.

    Returns
    -------
    list of Table
        One table for each topic with numbers. The time of a message is estimated from the stamp of its header, or else
        from its receipt; messages with a wrong stamp are left out (`seatrial.daq.importers.stamps`). Each pair of
        frames in a TFMessage has its own topic: /tf:odom:base_link. Messages of an unknown type are left out.

    Raises
    ------
    SeatrialError
        If the bag cannot be read or lacks one of `topics`, or if the package rosbags is not installed.
    """
    topics: dict[str, _TopicMessages] = {}
    with _open_bag(path) as (reader, remark):
        in_bag = {connection.topic for connection in reader.connections}
        named = {topic.partition(":")[0] for topic in options.topics}
        for topic in sorted(named - in_bag):
            raise SeatrialError(
                f"{path}: the bag has no topic {topic}; name one of its topics in the import map: "
                f"{', '.join(sorted(in_bag)) or 'none'}"
            )
        wanted = [c for c in reader.connections if not named or c.topic in named or c.msgtype == CLOCK]
        for connection, log_ns, data in reader.messages(connections=wanted):
            try:
                message = reader.deserialize(data, connection.msgtype)
            except KeyError:  # neither the bag nor the library defines this type of message
                continue
            if isinstance(transforms := getattr(message, "transforms", None), list):
                for transform in transforms:
                    frames = transform.header.frame_id.strip("/"), transform.child_frame_id.strip("/")
                    name = ":".join((connection.topic, *frames))
                    topics.setdefault(name, _TopicMessages(TRANSFORM)).add(1e-9 * log_ns, transform)
            else:
                topics.setdefault(connection.topic, _TopicMessages(connection.msgtype)).add(1e-9 * log_ns, message)
        for topic in sorted(name for name in options.topics - topics.keys() if ":" in name):
            names = ", ".join(sorted(topics)) or "none"
            raise SeatrialError(
                f"{path}: the bag has no transform {topic}; name one of its topics in the import map: {names}"
            )
    times = message_times({topic: collected.times for topic, collected in topics.items()})
    asked = [(topic, collected) for topic, collected in topics.items() if not options.topics or topic in options.topics]
    tables = [table for topic, collected in asked if (table := collected.table(path, topic, times[topic])).columns]
    for table in tables:
        table.remark = "; ".join(part for part in (table.remark, remark) if part)
    return tables


def bag_receipts(path: Path) -> tuple[dict[tuple[str, str], Column], str]:
    """Return when the recorder received the messages of each topic of a ROS bag, and a remark about repairs.

    Parameters
    ----------
    path
        A bag file, or the folder of a bag.

    Returns
    -------
    dict
        Receipts (n,) [s since 1970] by topic and type, as ("/imu", "sensor_msgs/msg/Imu"), in the order of the topics.
        A topic without messages has none.
    str
        What was repaired or is missing, in one line; "" for a whole bag.

    Raises
    ------
    SeatrialError
        If the bag cannot be read, or if the package rosbags is not installed.
    """
    with _open_bag(path) as (reader, remark):
        found: dict[tuple[str, str], list[int]] = {(c.topic, c.msgtype): [] for c in reader.connections}
        for connection, log_ns, _ in reader.messages():
            found[connection.topic, connection.msgtype].append(log_ns)
    return {key: 1e-9 * np.array(found[key], float) for key in sorted(found)}, remark


@contextlib.contextmanager
def _open_bag(path: Path) -> Iterator[tuple[Any, str]]:
    """Open a ROS bag; yield its reader of the library, and a remark about repairs.

    Raise SeatrialError if the bag cannot be read, or if the package rosbags is not installed. Errors of the library in
    the `with` block are raised as SeatrialError too.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError as error:
        raise SeatrialError(_ROSBAGS) from error
    try:
        with (
            _readable_files(path) as (parts, remark),
            AnyReader(parts, default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader,
        ):
            yield reader, remark
    except SeatrialError:
        raise
    except Exception as error:  # rosbags raises many kinds of errors for a damaged file or another format
        raise SeatrialError(
            f"{path}: cannot be read as a ROS bag: {' '.join(str(error).split()).rstrip('.')}; check that the bag is "
            "complete"
        ) from error


@contextlib.contextmanager
def _readable_files(path: Path) -> Iterator[tuple[list[Path], str]]:
    """Yield the readable files of a ROS bag, and a remark about repairs. Temporary copies are deleted at the end.

    A folder without metadata.yaml is read file by file, and so is one with a .mcap that was cut off. Such a .mcap is
    recovered to a temporary file. A .db3 with a SQLite log beside it, which an interrupted recorder leaves, is
    completed in a temporary copy. Files that are read one by one are in the order of their numbers. One of several
    .mcap that was cut off and has no readable message is left out with a remark. Any other folder with metadata.yaml is
    yielded as a folder; only its .db3 are completed. Raise SeatrialError if nothing is readable, or for a bag of ROS 1
    that was not closed (.bag.active).
    """
    if path.name.endswith(".bag.active"):
        raise SeatrialError(
            f"{path}: this bag was not closed; repair it by `rosbag reindex {path.name}`, then rename it to {path.stem}"
        )
    parts, remarks = [path], []
    described = (path / "metadata.yaml").exists()
    cut = described and any(not _has_end(file) for file in path.glob("*.mcap") if file.is_file())
    if path.is_dir() and (cut or not described):
        parts = sorted((file for file in path.iterdir() if file.suffix in BAG_ENDINGS), key=_split_number)
        if not parts:
            raise SeatrialError(
                f"{path}: is not the folder of a ROS bag (no metadata.yaml, .mcap or .db3 in it); give that folder"
            )
        if not cut:
            remarks.append(f"without metadata.yaml: read from {counted(len(parts), 'file')}")
    with tempfile.TemporaryDirectory() as folder:
        readable: list[Path] = []
        if path.is_dir() and parts == [path]:
            parts, folder_remarks = _with_sqlite_logs_of_folder(path, Path(folder))
            remarks += folder_remarks
        for k, part in enumerate(parts):
            if part.suffix == ".db3" and _sqlite_logs(part):
                readable.append(_with_sqlite_logs(part, Path(folder) / f"{k}.db3"))
                remarks.append(f"{part.name} read with {' and '.join(log.name for log in _sqlite_logs(part))}")
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
                        f"{path}: cannot be read as a ROS bag: it is cut off and contains no readable message; use "
                        "another copy of it"
                    ) from error
                remarks.append(f"{part.name} contains no readable message and is left out")
                continue
            readable.append(whole)
            remarks.append(f"{part.name} is cut off: {counted(recovered.messages, 'message')} recovered")
        if not readable:
            raise SeatrialError(
                f"{path}: cannot be read as a ROS bag: none of its files contains a message; use another copy of it"
            )
        yield readable, "; ".join(remarks)


def _sqlite_logs(path: Path) -> list[Path]:
    """Return the log files (-wal, -journal) that SQLite left beside a database, with changes to be completed.

    An empty log is not returned. A symbolic link counts as a log, also without a target, unless it points to an empty
    file.
    """
    beside = (path.with_name(path.name + ending) for ending in SQLITE_LOGS)
    return [log for log in beside if os.path.lexists(log) and not (log.is_file() and log.stat().st_size == 0)]


def _with_sqlite_logs(path: Path, copy: Path) -> Path:
    """Copy a SQLite database with its logs to `copy`, let SQLite complete the copy, and return its path.

    The original is not changed. Raise SeatrialError if a log is a link or no regular file.
    """
    shutil.copyfile(path, copy)
    for log in _sqlite_logs(path):
        if log.is_symlink():  # the link could name any file of this computer
            raise SeatrialError(f"{log}: is a symbolic link, not a file; put the file itself beside the .db3")
        require_file(log)
        shutil.copyfile(log, copy.with_name(copy.name + log.name.removeprefix(path.name)))
    with contextlib.closing(sqlite3.connect(copy)) as database:
        database.execute("PRAGMA journal_mode=DELETE").fetchall()
        database.execute("SELECT count(*) FROM sqlite_master").fetchall()
    return copy


def _with_sqlite_logs_of_folder(path: Path, folder: Path) -> tuple[list[Path], list[str]]:
    """Complete the databases (.db3) of a ROS bag that is a folder with metadata.yaml. Return folder and remarks.

    If a database in it has logs of SQLite, the returned folder is a copy inside `folder`: completed databases, and
    links to the other files, except logs of SQLite. Otherwise it is the bag itself, without remarks. The folder, in a
    list, is what is then read.
    """
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
    return [copy], [
        f"{name} read with {' and '.join(log.name for log in logs_of_file)}"
        for name, logs_of_file in logs.items()
        if logs_of_file
    ]


def _split_number(path: Path) -> tuple[int, str]:
    """Return the sort key of a file of a split bag, its number and its name: run_10.mcap comes after run_9.mcap.

    The number is the text behind the last _; it is -1 if this text is not a number.
    """
    digits = path.stem.rpartition("_")[2]
    return int(digits) if digits.isdecimal() else -1, path.name


def _has_end(path: Path) -> bool:
    """Return whether a .mcap file ends with the MCAP magic bytes. A file that was cut off, or is empty, does not."""
    with path.open("rb") as file:
        file.seek(-min(len(MCAP_MAGIC), path.stat().st_size), 2)
        return file.read() == MCAP_MAGIC


class _TopicMessages:
    """Collector of the messages of one topic of a ROS bag: their times and their numbers.

    Headers, texts, and lists and arrays of more than 16 elements are left out.

    Attributes
    ----------
    kind : str
        Type of the messages, for example "sensor_msgs/msg/Imu".
    frame_id : str
        First frame in the headers that is not empty; "" without one.
    t_log, t_stamp : array
        Receipt by the recorder and stamp of each message [s since 1970]. The stamp is that of the header, or the clock
        of a Clock message; NaN for other messages without a header.
    columns : dict
        Numbers by the name of their field, NaN for a message without the field. A column is shorter than the times if
        the last messages lack the field.
    """

    def __init__(self, kind: str) -> None:
        """Begin without messages. `kind` is the type of the topic's messages, as "sensor_msgs/msg/Imu"."""
        self.kind, self.frame_id = kind, ""
        self.t_log, self.t_stamp = array("d"), array("d")  # s
        self._frames: dict[str, list[float]] = {}  # frame_id -> number of messages, first and last receipt [s]
        self.columns: dict[str, array[float]] = {}  # arrays take 8 bytes a number; an hour has tens of millions

    def add(self, t_log: float, message: Any) -> None:
        """Add a ROS message received at `t_log` [s since 1970]: its times, its frame and its numbers.

        If a message has a number twice under one name, the first counts. Lists and arrays of more than 16 elements,
        such as images, are left out.
        """
        header = getattr(message, "header", None)
        stamp = message.clock if self.kind == CLOCK else getattr(header, "stamp", None)
        frame_id = str(getattr(header, "frame_id", ""))
        self.frame_id = self.frame_id or frame_id
        of_frame = self._frames.setdefault(frame_id, [0, t_log, t_log])
        of_frame[0], of_frame[2] = of_frame[0] + 1, t_log
        self.t_log.append(t_log)
        self.t_stamp.append(np.nan if stamp is None else stamp.sec + 1e-9 * stamp.nanosec)
        rows = len(self.t_log)
        for name, value in _message_numbers(message):
            column = self.columns.get(name)
            if column is None:
                column = self.columns[name] = array("d")
            if len(column) < rows:  # one value a row; NaN for earlier rows without this field
                column.extend([np.nan] * (rows - 1 - len(column)))
                column.append(value)

    @property
    def times(self) -> MessageTimes:
        """Receipts by the recorder and stamps of the messages of the topic, each [s since 1970]."""
        return MessageTimes(np.array(self.t_log), np.array(self.t_stamp))

    def table(self, path: Path, topic: str, times: EstimatedTimes) -> Table:
        """Return the messages of the ROS topic that have a time as a table, in the order of time.

        `path` is the bag, and `times` are the estimated times of measurement. Parts of an Imu that are not measured are
        left out. The position of a fix without a satellite fix becomes NaN. NaN in commands of stopped motors becomes
        zero. The remark of the table describes what is unusual.
        """
        t = times.t
        order = np.argsort(t, kind="stable")[: int(np.sum(np.isfinite(t)))]
        columns = {name: self._column_of_field(name)[order] for name in self.columns}
        if self.kind == IMU:
            _leave_out_unmeasured(columns)
        if self.kind == FIX:
            for name in ("latitude", "longitude"):
                columns[name] = np.where(columns["status.status"] < 0, np.nan, columns[name])
        n_lost = len(t) - len(order)
        parts = (times.remark, stopped_motors(self.kind, columns), self._two_sensors_remark())
        remark = "; ".join(part for part in parts if part)
        clock = "" if times.mixed else clock_remark(t[np.isfinite(t)])
        return Table(path, topic, columns, t[order], self.kind, self.frame_id, remark, clock=clock, n_left_out=n_lost)

    def _two_sensors_remark(self) -> str:
        """Return a remark if messages of several frame_ids (sensors) alternate in the topic, else "".

        Messages of one frame after another, without overlap in time, do not alternate; two such frames are enough for
        "". The remark has the number of messages of each frame.
        """
        frames = sorted(self._frames.items())
        if len(frames) < 2 or max(first for _, (_, first, _) in frames) > min(last for _, (_, _, last) in frames):
            return ""
        listed = " and ".join(f"{n:.0f} of frame {name!r}" for name, (n, _, _) in frames)
        return f"messages of several sensors in one topic ({listed}): record each sensor in its own topic"

    def _column_of_field(self, name: str) -> Column:
        """Return the numbers of a field, one for each message of the topic (n,), NaN for a message without it."""
        found = np.full(len(self.t_log), np.nan)
        found[: len(self.columns[name])] = self.columns[name]
        return found


def _leave_out_unmeasured(columns: dict[str, Column]) -> None:
    """Remove orientation, angular velocity or acceleration from the columns of ROS Imu messages if it is not measured.

    Not measured means that in all messages its first covariance is -1 and its values are the defaults. `columns` has
    the values (n,) by the name of the field and is changed in place.
    """
    # By the definition of the message, a first covariance of -1 marks such a part. Many drivers write -1 also for an
    # unknown covariance, so a part with other values than its default stays.
    for part, defaults in IMU_PARTS.items():
        axes = [name for name in columns if name.startswith(f"{part}.")]
        values = np.stack([columns[name] for name in axes], axis=1)
        unmeasured = columns[f"{part}_covariance[0]"] == -1.0
        is_default = np.any([np.all(values == default, axis=1) for default in defaults], axis=0)
        if np.all(unmeasured & is_default):
            for name in axes:
                del columns[name]


@cache
def _fields_of(kind: type) -> tuple[str, ...] | None:
    """Return the names of the fields of a type of ROS messages without header and constants; None for other types."""
    if not is_dataclass(kind):
        return None
    return tuple(f.name for f in fields(kind) if f.name not in ("header", "__msgtype__") and not f.name.isupper())


def _message_numbers(message: Any, prefix: str = "") -> Iterator[tuple[str, float]]:
    """Yield name and value of each number in a ROS message, in order. Skip header, text and constants.

    The name is that of the field. An array with the same length as the list `name` of the message, as in a JointState,
    has the names of the joints: velocity.left. Messages in a list have their index: esc[0].rpm. A truth value is 0 or
    1. Arrays of several dimensions, and lists and arrays of more than 16 elements, are skipped.
    """
    joints = getattr(message, "name", None)
    for field in _fields_of(message.__class__) or ():
        value, name = getattr(message, field), f"{prefix}{field}"
        if isinstance(value, (bool, int, float, np.number)):
            yield name, float(value)
        elif isinstance(value, list) and len(value) <= LONGEST:
            for k, element in enumerate(value):
                if _fields_of(element.__class__) is not None:
                    yield from _message_numbers(element, f"{name}[{k}].")
        elif _fields_of(value.__class__) is not None:
            yield from _message_numbers(value, f"{name}.")
        elif isinstance(value, np.ndarray) and value.ndim == 1 and len(value) <= LONGEST and value.dtype.kind in "biuf":
            named = isinstance(joints, list) and len(joints) == len(value)
            for k, element in enumerate(value.tolist()):
                yield f"{name}.{joints[k]}" if named and joints else f"{name}[{k}]", float(element)
