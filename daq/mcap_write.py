"""One MCAP segment on disk, written so that a kill, a power cut or a full disk costs at most the last moment.

Below the records (daq.mcap_build) is a stream of our own: raw file descriptor, nothing buffered, cut back to the last
whole record when a write fails; and a ballast file whose space pays for the footer when the disk is full.
"""

from __future__ import annotations

import contextlib
import errno
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NoReturn

from daq.cdr import full_definition
from daq.errors import SeatrialError
from daq.mcap_build import RecordWriter
from daq.safe_stream import BALLAST_BYTES, Syncer, WholeRecordStream

CHUNK_BYTES = 256 * 1024
FLUSH_S = 0.25  # wall; each flush ends a chunk, and a chunk is what a killed run keeps
FEW, FEW_S = 16, 0.1  # so few messages wait no longer than this: where they are rare, each counts
SYNC_S = 1.0  # wall
FULL = (errno.ENOSPC, errno.EDQUOT)
QOS = (
    "- {history: 1, depth: 10, reliability: 1, durability: 2, deadline: {sec: 2147483647, nsec: 4294967295}, "
    "lifespan: {sec: 2147483647, nsec: 4294967295}, liveliness: 1, "
    "liveliness_lease_duration: {sec: 2147483647, nsec: 4294967295}, avoid_ros_namespace_conventions: false}"
)


class DiskFull(SeatrialError):
    """There was no room for more. `complete`: everything added so far is in the file, which has its end."""

    def __init__(self, text: str, complete: bool) -> None:
        super().__init__(text)
        self.complete = complete


class LogWriter:
    """One MCAP file: metadata and attachments first, then channels and messages; `tick` keeps it safe.

    Raises SeatrialError where the file cannot be made, and from any method once a write failed; by then the file
    is closed, with a footer where the ballast allowed one.
    """

    def __init__(
        self,
        path: Path,
        *,
        metadata: Mapping[str, str],
        attachments: Mapping[str, bytes],
        time_ns: int,
    ) -> None:
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except FileExistsError as error:
            raise SeatrialError(f"{path}: the folder cannot be made: {path.parent} is no folder") from error
        except OSError as error:
            raise SeatrialError(f"{path}: the folder cannot be made: {error.strerror}") from error
        try:
            self._stream = WholeRecordStream(path)
        except FileExistsError as error:
            raise SeatrialError(f"{path}: there is such a file already; a log is never overwritten") from error
        except OSError as error:
            text = f"{path}: the log cannot be made: {error.strerror}"
            raise (DiskFull(text, complete=True) if error.errno in FULL else SeatrialError(text)) from error
        self._syncer = Syncer(self._stream)
        self._syncer.start()
        self._failed: SeatrialError | None = None
        self._closed = False
        self._schemas: dict[str, int] = {}
        self._waits = self._synced = time.monotonic()
        with self._guard():
            self._begin(metadata, attachments, time_ns)

    def _begin(self, metadata: Mapping[str, str], attachments: Mapping[str, bytes], time_ns: int) -> None:
        self._writer = RecordWriter(self._stream, chunk_bytes=CHUNK_BYTES, profile="ros2", library="seatrial")
        self._writer.add_metadata("seatrial", metadata)
        for name, data in attachments.items():
            kind = "application/toml" if name.endswith(".toml") else "application/octet-stream"
            self._writer.add_attachment(time_ns, time_ns, name, kind, data)

    @property
    def size(self) -> int:
        """Bytes on disk."""
        return self._stream.tell()

    def channel(self, topic: str, type_name: str, metadata: Mapping[str, str] | None = None) -> int:
        """Register a topic and return the number of its channel."""
        self._check()
        if type_name not in self._schemas:
            data = full_definition(type_name).encode()
            self._schemas[type_name] = self._writer.register_schema(type_name, "ros2msg", data)
        extra = {"offered_qos_profiles": QOS, **(metadata or {})}
        return self._writer.register_channel(topic, "cdr", self._schemas[type_name], extra)

    def add(self, channel: int, log_ns: int, stamp_ns: int, sequence: int, data: bytes) -> None:
        """Append one message; it is on disk after the next `tick` that flushes."""
        if self._closed:
            self._check()
        try:  # `_guard` written out: this is called for every message
            self._writer.add_message(channel, log_ns, data, stamp_ns, sequence)
        except OSError as error:
            self._fail(error, complete=False)
        if self._stream.failure is not None:
            self._end_saved()

    def tick(self) -> None:
        """Flush what has waited for 0.25 s, or 0.1 s where it is little, and sync every second of wall time.

        To be called often.
        """
        self._check()
        now = time.monotonic()
        n_waiting = self._writer.n_waiting
        if not n_waiting:
            self._waits = now
        elif now - self._waits >= (FLUSH_S if n_waiting > FEW else FEW_S):
            self._waits = now
            self.flush()
        if now - self._synced >= SYNC_S:
            self._synced = now
            self._syncer.request()
        if self._syncer.error is not None:
            self._fail(self._syncer.error, complete=False)

    def flush(self) -> None:
        """End the chunk and hand it to the operating system."""
        self._check()
        with self._guard():
            self._writer.flush()
        # The end of the file has about 80 bytes and 10 a channel for every chunk: the ballast has to pay for it.
        steps = -(-(2 * self._writer.summary_bytes) // BALLAST_BYTES)
        with contextlib.suppress(OSError):  # nearly full: the write that fails will say so
            self._stream.ballast.grow((1 + steps) * BALLAST_BYTES)

    def close(self) -> None:
        """Footer, sync, close; again is harmless. Raises SeatrialError where the file could not be completed."""
        if self._closed:
            return
        try:
            self._writer.finish()
            self._stream.sync()
        except OSError as error:
            self._fail(error, complete=False)
        self._end()
        if self._stream.failure is not None:
            raise self._explain(self._stream.failure, complete=True)

    @contextlib.contextmanager
    def _guard(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:  # records are lost: what the writer remembers no longer fits the file
            self._fail(error, complete=False)
        if self._stream.failure is not None:
            self._end_saved()

    def _end_saved(self) -> NoReturn:
        """A write that failed was saved by the ballast: nothing is lost, but this is the end."""
        assert self._stream.failure is not None
        complete = True
        try:
            self._writer.finish()
        except OSError:
            complete = False
        self._fail(self._stream.failure, complete)

    def _fail(self, error: OSError, complete: bool) -> NoReturn:
        """Close and raise; `complete` when the footer is written."""
        self._end()
        self._failed = self._explain(error, complete)
        raise self._failed from error

    def _end(self) -> None:
        self._closed = True
        self._syncer.end()
        self._stream.close()

    def _check(self) -> None:
        if self._failed is not None:
            raise self._failed
        if self._closed:
            raise SeatrialError(f"{self.path}: the log is closed already")

    def _explain(self, error: OSError, complete: bool) -> SeatrialError:
        state = "closed and complete up to there" if complete else "whole up to its last record, without its end"
        text = (
            f"{self.path}: writing failed ({error.strerror}) after {self.size} bytes; the log is {state}; "
            "free disk space and start a new one"
        )
        return DiskFull(text, complete) if error.errno in FULL else SeatrialError(text)
