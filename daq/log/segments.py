"""Segments of a log, the files NAME.mcap, NAME.1.mcap, NAME.2.mcap and so on, read as one log.

A file belongs to the log of the first file if the metadata of both have the same run clock, rig and host. The name of
a file alone is not sufficient. Segments may be missing, and each segment may be cut off or damaged.
"""

from __future__ import annotations

import os
import re
import shlex
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from mcap.records import Attachment, Channel, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from seatrial.daq.errors import SeatrialError, first_names
from seatrial.daq.log.mcap_chunk import Messages
from seatrial.daq.log.mcap_reader import LAST_NS, MAX_WARNINGS, RawLog
from seatrial.daq.log.run_tables import run_folder_of

_NUMBER = r"[1-9]\d{0,5}"  # number of a later segment in its name
MAX_NAMED = 8  # logs that an error message names
MAX_IN_COMMAND = 4  # files that a command in an error message names
ROS_PROFILE = b"\x04\x00\x00\x00ros2"  # profile in the header of a .mcap file of ROS 2, with its length
OWN_LIBRARY = b"\x08\x00\x00\x00seatrial"  # program in the header of a log, with its length
HEADER_BYTES = 64  # of a .mcap file after its first bytes, in which both stand
BAG = b"rosbag2_bagfile_information"  # first key of the metadata.yaml of a bag of ROS 2
BAG_HEADS = (b"#ROSBAG V2.0", b"SQLite format 3\0")  # of a bag of ROS 1, and of a .db3 of ROS 2
RESULT_FILES = ("model.toml", "result.json")  # files of a fit, by which its folder is recognised
SHARED_METADATA = ("origin", "rig", "host")  # metadata that are equal in all segments of one log


def open_raw(path: Path, growing: bool = False) -> RawLog | SegmentedLog:
    """Open the MCAP log that begins at `path`, with all its segments (files), without decoding its messages.

    Later segments that cannot be read or that belong to another run are left out, with a warning. Segments that are
    missing before the last used one also cause a warning. A file whose metadata have no run clock is opened alone. With
    `growing`, the last file may still be written, and `extend` of the result reads what is appended.

    Returns
    -------
    RawLog or SegmentedLog
        The file, or the log of several segments; both have the same interface.

    Raises
    ------
    SeatrialError
        If the first file cannot be read or is no MCAP file, or if `path` is not the folder of one log (`log_file`).
    """
    path = log_file(path)
    later = segments(path)
    try:
        first = RawLog(path, growing and not later)
    except SeatrialError as error:
        if not later:
            raise
        names = ", ".join(segment.name for segment in later.values())
        raise SeatrialError(f"{error}; or open its possible later segments one by one: {names}") from error
    if not later or not _recorder_metadata(first).get("origin"):
        return first
    files, warnings, last = [first], [], 0
    first.close()  # a log of a week has more files than a process may have open
    for number, segment in later.items():
        try:
            raw = RawLog(segment, growing and number == max(later))
        except SeatrialError as error:
            warnings.append(f"a segment is left out: {error}")
            continue
        raw.close()
        if all(_recorder_metadata(raw).get(key) == _recorder_metadata(first).get(key) for key in SHARED_METADATA):
            files.append(raw)
            last = number
        else:
            warnings.append(f"{segment.name} belongs to another run and is left out")
    present = [0, *(number for number in later if number <= last)]
    for before, after in pairwise(present):
        missing = dict.fromkeys(segment_path(path, number).name for number in (before + 1, after - 1))
        if after - before > 1 and len(warnings) < MAX_WARNINGS:
            names = " to ".join(missing)
            warnings.append(f"a segment is missing: {names}; copy it into the folder of {path.name}, if you have it")
    return SegmentedLog(files, warnings) if len(files) > 1 or warnings else first


def _recorder_metadata(raw: RawLog) -> dict[str, str]:
    """Return the texts that the recorder wrote into a file of a log, by name: run clock ("origin"), rig, host, ...

    They are those of the first metadata record with the name "seatrial". The result is empty if the file has none.
    """
    return next((dict(record.metadata) for record in raw.metadata if record.name == "seatrial"), {})


class SegmentedLog:
    """Log of several segments (MCAP files) that are read as one, with the interface of `RawLog`.

    Equal channels (topics) of different files become one channel. `read` and `verify` close each file after its use.

    Parameters
    ----------
    files
        The segments in order. Metadata and attachments come from the first one.
    warnings
        Further warnings, for example about missing segments.

    Attributes
    ----------
    channels, schemas, counts
        As in `RawLog`, by new numbers that are valid for all files.
    complete
        Whether every file has its footer, the last record of a file that was closed.
    span_ns
        Smallest and largest log time of all files [ns since 1970]; None if there is no message.
    """

    def __init__(self, files: list[RawLog], warnings: list[str]) -> None:
        """Join the channels, message counts and times of the segments of a log.

        `files` are the segments in order, and `warnings` further warnings about the log.
        """
        self.files = files
        self.path = files[0].path
        self._warnings = warnings
        self._join()

    def extend(self) -> bool:
        """Add the whole records that were appended to the last file since it was opened or since the last call.

        Return whether there were any. Raise SeatrialError if the file was closed since, and another file has replaced
        it.
        """
        extended = self.files[-1].extend()
        if extended:
            self._join()
        return extended

    def _join(self) -> None:
        """Join the present channels, message counts and times of the files."""
        files = self.files
        self.complete = all(raw.complete for raw in files)
        self.profile = files[0].profile
        self.metadata: list[Metadata] = files[0].metadata
        self.attachments: list[Attachment] = files[0].attachments
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.counts: Counter[int] = Counter()
        self._number_by_content: dict[tuple[object, ...], int] = {}
        self._numbers = [  # for each file: number of a channel in the log, by its number in the file
            {
                local: self._log_channel_number(channel, raw.schemas.get(channel.schema_id))
                for local, channel in raw.channels.items()
            }
            for raw in files
        ]
        for raw, numbers in zip(files, self._numbers, strict=True):
            self.counts.update({numbers[local]: n for local, n in raw.counts.items()})
        spans = [raw.span_ns for raw in files if raw.span_ns]
        self.span_ns = (min(a for a, _ in spans), max(b for _, b in spans)) if spans else None

    @property
    def warnings(self) -> list[str]:
        """Warnings about the log, one line each: first those about the parts of its files that were read so far.

        Those about missing segments, and segments left out, follow. A warning about a file begins with the name of the
        file.
        """
        return [f"{raw.path.name}: {text}" for raw in self.files for text in raw.warnings] + self._warnings

    def verify(self, begin_ns: int = 0, end_ns: int = LAST_NS) -> None:
        """Read the unread chunks of all files in an interval of log times [ns since 1970], to complete `warnings`.

        Chunks that overlap the interval, both ends included, are read. The messages are not returned, and the files are
        closed.
        """
        for raw in self.files:
            raw.verify(begin_ns, end_ns)
            raw.close()

    def read(
        self, channels: Collection[int] | None = None, begin_ns: int = 0, end_ns: int = LAST_NS
    ) -> Iterator[Messages]:
        """Yield the messages of all files of the log, one file after the other, some at a time.

        The heads of the messages have the numbers of channels in the log, not those in the file. A yielded batch may be
        empty. A file whose span of log times is outside the interval is not read. A file is closed after its last
        message.

        Parameters
        ----------
        channels
            Numbers of the channels in the log; None for all channels.
        begin_ns, end_ns
            Interval of log times [ns since 1970], without `end_ns` itself. The default includes all times.
        """
        for raw, numbers in zip(self.files, self._numbers, strict=True):
            renumbered = np.zeros(1 << 16, np.uint16)
            renumbered[list(numbers)] = list(numbers.values())
            local_channels = [number for number in numbers if channels is None or numbers[number] in channels]
            if not raw.span_ns or raw.span_ns[1] < begin_ns or raw.span_ns[0] >= end_ns:
                continue
            for batch in raw.read(local_channels, begin_ns, end_ns):
                batch.heads["channel"] = renumbered[batch.heads["channel"]]
                yield batch
            raw.close()

    def _log_channel_number(self, channel: Channel, schema: Schema | None) -> int:
        """Return the number that a channel (topic) of one file has in the whole log. A new channel gets a new number.

        Channels with equal topic, encoding, metadata and schema (message type) are the same. `schema` is None if the
        file lacks it.
        """
        content = ("", b"") if schema is None else (schema.name, schema.data)
        key = (channel.topic, channel.message_encoding, tuple(sorted(channel.metadata.items())), content)
        if key not in self._number_by_content:
            number = self._number_by_content[key] = len(self._number_by_content) + 1
            if schema is not None:
                self.schemas[number] = Schema(id=number, name=schema.name, encoding=schema.encoding, data=schema.data)
            self.channels[number] = Channel(
                id=number,
                topic=channel.topic,
                message_encoding=channel.message_encoding,
                metadata=channel.metadata,
                schema_id=number if schema is not None else 0,
            )
        return self._number_by_content[key]

    def close(self) -> None:
        """Close all files of the log. A later read opens them again."""
        for raw in self.files:
            raw.close()


def segment_path(first: Path, number: int) -> Path:
    """Return the path of a later segment (file) of a log, such as run.1.mcap for run.mcap and number 1.

    `first` is the first segment. Numbers begin at 1. The file need not exist.
    """
    return first.with_suffix(f".{number}{first.suffix}")


def segments(path: Path) -> dict[int, Path]:
    """Return the files whose names make them later segments of the log `path`: NAME.1.mcap, NAME.2.mcap, ...

    A number has up to six digits, of which the first is not 0. The content of the files is not checked. They are sorted
    by number. The result is empty if there are none or the folder cannot be read.
    """
    name = re.compile(re.escape(path.stem) + rf"\.({_NUMBER})" + re.escape(path.suffix))
    try:
        found = [(int(match[1]), file) for file in path.parent.iterdir() if (match := name.fullmatch(file.name))]
    except OSError:
        return {}
    return dict(sorted(found))


def first_segments(folder: Path) -> list[Path]:
    """Return the first segment (file) of each log in a folder, sorted by name.

    They are the files *.mcap without the later segments NAME.1.mcap, NAME.2.mcap, ... of an existing NAME.mcap. Later
    segments whose NAME.mcap is missing are included. Subfolders are not searched.
    """
    paths = sorted(folder.glob("*.mcap"))
    later = {segment for path in paths for segment in segments(path).values()}
    return [path for path in paths if path not in later]


def log_file(path: Path) -> Path:
    """Return the file to open for the path of a log: the file itself, or the first segment of the only log in a folder.

    A path that is not a folder is returned unchanged, whether it exists or not.

    Raises
    ------
    SeatrialError
        If the path is a folder without a log, with more than one log, of a bag of ROS 2, or of a model without a log.
    """
    if not path.is_dir():
        return path
    if _describes_bag(path):
        raise SeatrialError(
            f"{path} is a bag of ROS 2; import it first with `seatrial import --guess {shlex.quote(str(path))}`"
        )
    found = first_segments(path)
    if not found and any((path / name).is_file() for name in RESULT_FILES):
        raise SeatrialError(f"{path} is the folder of a model or a result, not a log; give the path of a log")
    if not found:
        raise SeatrialError(f"{path} is a folder without a log (*.mcap) in it; give the path of a log")
    if len(found) > 1:
        names = ", ".join(file.name for file in found[:MAX_NAMED]) + (", ..." if len(found) > MAX_NAMED else "")
        raise SeatrialError(f"{path} is a folder of {len(found)} logs: name one of {names}")
    return found[0]


def is_bag(path: Path) -> bool:
    """Return whether a path is a bag of ROS that is no log: of ROS 1 (.bag), or of ROS 2, a .db3 or the folder.

    A .mcap file of ROS 2 is read as a log (`bag_of_ros` recognises it). The result is False if the path cannot be read.
    """
    if path.is_dir():
        return _describes_bag(path) or (not first_segments(path) and any(path.glob("*.db3")))
    try:
        with path.open("rb") as file:
            return file.read(max(map(len, BAG_HEADS))).startswith(BAG_HEADS)
    except OSError:
        return False


def _describes_bag(folder: Path) -> bool:
    """Return whether a folder has the metadata.yaml of a bag of ROS 2."""
    description = folder / "metadata.yaml"
    return description.is_file() and BAG in description.read_bytes()


def bag_of_ros(path: Path) -> Path | None:
    """Return the bag of ROS 2 to which a .mcap file belongs: its folder, or the file itself without a metadata.yaml.

    None for a log, and for a file of other programs than those of ROS 2, or one that cannot be read. A log has the
    profile of ROS 2 too, but names seatrial as the program that wrote it.
    """
    try:
        if _describes_bag(path.parent):
            return path.parent
        with path.open("rb") as file:
            head = file.read(len(MCAP0_MAGIC) + HEADER_BYTES)
    except OSError:
        return None
    is_of_ros = head.startswith(MCAP0_MAGIC) and ROS_PROFILE in head and OWN_LIBRARY not in head
    return path if is_of_ros else None


def is_log(path: Path) -> bool:
    """Return whether a path is that of a log: a name that ends with .mcap, or a file that begins as MCAP files do."""
    if path.suffix.lower() == ".mcap":
        return not path.is_dir()
    if not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            return file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC
    except OSError:  # the reader of the file reports it
        return False


def require_logs(paths: Iterable[Path]) -> None:
    """Check that all files are logs, before the first of them is read.

    Folders, missing files and files that cannot be read are left to the reader of logs.

    Raises
    ------
    SeatrialError
        If files are no logs. The error names all of them, and the commands that import them.
    """
    wrong = [path for path in dict.fromkeys(paths) if not is_log(path) and path.is_file() and os.access(path, os.R_OK)]
    if toml := [path for path in wrong if path.suffix.lower() == ".toml"]:
        raise SeatrialError(f"{toml[0]}: a TOML file and not a log; check the order of the arguments")
    if wrong:
        folders = {path: folder for path in wrong if (folder := run_folder_of(path)) is not None}
        sources = dict.fromkeys(folders.get(path, path) for path in wrong)
        files = shlex.join(map(str, sources)) if len(sources) <= MAX_IN_COMMAND else "FILE..."
        beside = dict.fromkeys(str(folder) for folder in folders.values())
        further = (
            f"; {first_names(list(beside), MAX_IN_COMMAND)}: has further tables of the same time" if beside else ""
        )
        raise SeatrialError(
            f"{', '.join(map(str, wrong))}: not {'an MCAP log' if len(wrong) == 1 else 'MCAP logs'}; use `seatrial "
            f"import` for logs of other formats: `seatrial import --guess {files} -o map.toml`, then `seatrial import "
            f"map.toml {files}`{further}"
        )


def first_segment_of(path: Path) -> Path | None:
    """Return the path of the first segment of a log from the path of a later segment.

    For NAME.2.mcap, the first segment is NAME.mcap. The result is None if `path` is not named like a later segment,
    or if the first segment does not exist.
    """
    match = re.fullmatch(rf"(.+)\.{_NUMBER}", path.stem)
    first = path.with_name(f"{match[1]}{path.suffix}") if match else path
    return first if first != path and first.is_file() else None
