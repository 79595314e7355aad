"""The segments of a log, NAME.mcap, NAME.1.mcap, NAME.2.mcap, ..., read as one.

A file is a segment of the first one when its metadata has the same run clock, rig and host: a name alone may be
chance. Numbers may be missing, and each segment may be cut off or damaged by itself.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from mcap.records import Attachment, Channel, Metadata, Schema

from seatrial.daq.errors import SeatrialError
from seatrial.daq.log.mcap_chunk import Messages
from seatrial.daq.log.mcap_reader import LAST_NS, MAX_WARNINGS, RawLog

SAME = ("origin", "rig", "host")  # what segments of one log have in common


def open_raw(path: Path) -> RawLog | SegmentedLog:
    """The log at `path` with all its segments. Raises SeatrialError as `RawLog` does."""
    later = segments(path)
    try:
        first = RawLog(path)
    except SeatrialError as error:
        if not later:
            raise
        names = ", ".join(other.name for other in later.values())
        raise SeatrialError(f"{error}; what may be its later segments opens by itself: {names}") from error
    if not later or not _about(first).get("origin"):
        return first
    files, warnings, last = [first], [], 0
    first.close()  # a week has more files than a process may have open
    for number, other in later.items():
        try:
            raw = RawLog(other)
        except SeatrialError as error:
            warnings.append(f"a segment is left out: {error}")
            continue
        raw.close()
        if all(_about(raw).get(key) == _about(first).get(key) for key in SAME):
            files.append(raw)
            last = number
        else:
            warnings.append(f"{other.name} is of another run and left out")
    there = [0, *(number for number in later if number <= last)]
    for before, after in pairwise(there):
        gone = dict.fromkeys(segment_path(path, number).name for number in (before + 1, after - 1))
        if after - before > 1 and len(warnings) < MAX_WARNINGS:
            warnings.append(f"a segment is missing: {' to '.join(gone)}")
    return SegmentedLog(files, warnings) if len(files) > 1 or warnings else first


def _about(raw: RawLog) -> dict[str, str]:
    return next((dict(record.metadata) for record in raw.metadata if record.name == "seatrial"), {})


class SegmentedLog:
    """Several files with the face of one `RawLog`: channels that are alike are one. One file is open at a time."""

    def __init__(self, files: list[RawLog], warnings: list[str]) -> None:
        self.files = files
        self.path = files[0].path
        self._warnings = warnings
        self.complete = all(raw.complete for raw in files)
        self.profile = files[0].profile
        self.metadata: list[Metadata] = files[0].metadata
        self.attachments: list[Attachment] = files[0].attachments
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.counts: Counter[int] = Counter()
        self._known: dict[tuple[object, ...], int] = {}
        self._numbers = [
            {own: self._number(channel, raw.schemas.get(channel.schema_id)) for own, channel in raw.channels.items()}
            for raw in files
        ]
        for raw, numbers in zip(files, self._numbers, strict=True):
            self.counts.update({numbers[own]: n for own, n in raw.counts.items()})
        spans = [raw.span_ns for raw in files if raw.span_ns]
        self.span_ns = (min(a for a, _ in spans), max(b for _, b in spans)) if spans else None

    @property
    def warnings(self) -> list[str]:
        """Those of all files, as far as they were read."""
        return [f"{raw.path.name}: {text}" for raw in self.files for text in raw.warnings] + self._warnings

    def verify(self, begin_ns: int = 0, end_ns: int = LAST_NS) -> None:
        """As `RawLog.verify`, of all files."""
        for raw in self.files:
            raw.verify(begin_ns, end_ns)
            raw.close()

    def read(
        self, channels: Collection[int] | None = None, begin_ns: int = 0, end_ns: int = LAST_NS
    ) -> Iterator[Messages]:
        """As `RawLog.read`, the files one after the other."""
        for raw, numbers in zip(self.files, self._numbers, strict=True):
            new = np.zeros(1 << 16, np.uint16)
            new[list(numbers)] = list(numbers.values())
            own = [number for number in numbers if channels is None or numbers[number] in channels]
            if not raw.span_ns or raw.span_ns[1] < begin_ns or raw.span_ns[0] >= end_ns:
                continue
            for found in raw.read(own, begin_ns, end_ns):
                found.heads["channel"] = new[found.heads["channel"]]
                yield found
            raw.close()

    def _number(self, channel: Channel, schema: Schema | None) -> int:
        """The number of this channel in the set; new ones are given in the order of the files."""
        what = ("", b"") if schema is None else (schema.name, schema.data)
        key = (channel.topic, channel.message_encoding, tuple(sorted(channel.metadata.items())), what)
        if key not in self._known:
            number = self._known[key] = len(self._known) + 1
            if schema is not None:
                self.schemas[number] = Schema(id=number, name=schema.name, encoding=schema.encoding, data=schema.data)
            self.channels[number] = Channel(
                id=number,
                topic=channel.topic,
                message_encoding=channel.message_encoding,
                metadata=channel.metadata,
                schema_id=number if schema is not None else 0,
            )
        return self._known[key]

    def close(self) -> None:
        """Let go of all files."""
        for raw in self.files:
            raw.close()


def segment_path(first: Path, number: int) -> Path:
    """Where segment `number`, 1 and up, of the log that begins at `first` lies."""
    return first.with_suffix(f".{number}{first.suffix}")


def segments(path: Path) -> dict[int, Path]:
    """The files beside `path` that are named as its later segments, by their number, ascending."""
    name = re.compile(re.escape(path.stem) + r"\.(\d{1,6})" + re.escape(path.suffix))
    try:
        found = [(int(match[1]), other) for other in path.parent.iterdir() if (match := name.fullmatch(other.name))]
    except OSError:
        return {}
    return dict(sorted(found))


def first_segments(folder: Path) -> list[Path]:
    """The logs in a folder, each by its first segment, in the order of their names."""
    paths = sorted(folder.glob("*.mcap"))
    later = {other for path in paths for other in segments(path).values()}
    return [path for path in paths if path not in later]


def first_of(path: Path) -> Path | None:
    """The first segment of the log that `path` is named as a later segment of, where it is there."""
    match = re.fullmatch(r"(.+)\.\d{1,6}", path.stem)
    first = path.with_name(f"{match[1]}{path.suffix}") if match else path
    return first if first != path and first.is_file() else None
