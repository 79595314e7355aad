"""Samples, raw bytes, events and counters -> one MCAP log (docs/formats/log.md). Called from one thread."""

from __future__ import annotations

import contextlib
import json
import shutil
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple, Protocol

from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.log import schema
from seatrial.daq.log.cdr import NANO, cdr_layout
from seatrial.daq.log.mcap_writer import DiskFull, LogWriter
from seatrial.daq.log.provenance import collect
from seatrial.daq.log.segments import segment_path
from seatrial.daq.log.watchdog_note import discard_note
from seatrial.daq.rig import Rig
from seatrial.daq.samples import Event, Frame, PortHealth

LOG_FORMAT = "seatrial-log 1"
RETRY_S = 0.25  # wall; how often a full disk is looked at
ROOM_BYTES = 2 * 2**20  # a segment's ballast, and something to write
_DIRECTIONS = {"rx": 0, "tx": 1}


class Clock(Protocol):
    """What the recorder needs of `seatrial.daq.clock.RunClock`."""

    @property
    def speed(self) -> float:
        """Run seconds a wall second."""

    @property
    def origin(self) -> object:
        """Plain numbers from which another process can rebuild the clock."""

    def now(self) -> float:
        """Run seconds since 1970."""


class Recorder:
    """Writes one log, in as many files as the rig's [log] requires: NAME.mcap, NAME.1.mcap, NAME.2.mcap, ...

    Each holds all that a reader needs. Beyond `keep_gb` the oldest files that it has made are deleted, but for the
    first, which has the beginning and the name of the log. `log_time` is the receive time, but never before that of
    the message written last. A `patient` recorder does not fail when the disk is full: it ends its file, keeps what it
    is given (`paused` is the reason), and goes on in a new file when there is room; the caller should not write
    meanwhile.
    """

    def __init__(
        self,
        path: Path,
        *,
        rig: Rig,
        clock: Clock,
        attachments: Mapping[str, bytes] | None = None,
        metadata: Mapping[str, str] | None = None,
        patient: bool = False,
    ) -> None:
        origin = json.dumps(clock.origin)
        about = {"format": LOG_FORMAT, "rig": rig.name, "speed": repr(clock.speed), "origin": origin}
        self._metadata = {**collect(), **about, **(metadata or {})}
        self._attachments = {"rig.toml": rig.text.encode(), **(attachments or {})}
        self._log_ns = self._ns(clock.now(), 0)
        self._segments, self._patient = rig.segments, patient
        self.first_path = Path(path)
        self.paused = ""  # why nothing is written now
        self._kept: list[_Message] = []  # since then
        self._retry_at = self._paused_at = 0.0
        self._lost_some = False
        self._sequences: dict[str, int] = {}
        self._packers: dict[str, Callable[..., bytes]] = {}
        self._size_before = 0
        self._past: deque[_Segment] = deque()  # what may be deleted
        self._open(self.first_path, 0)
        discard_note(self.first_path)

    def _open(self, path: Path, number: int) -> None:
        """Begin a segment: each contains everything that a reader needs."""
        about = {**self._metadata, "segment": str(number)}
        self._writer = LogWriter(path, metadata=about, attachments=self._attachments, time_ns=self._log_ns)
        self._number, self._started_ns = number, self._log_ns
        self._channels: dict[str, int] = {}

    @property
    def path(self) -> Path:
        """The file being written."""
        return self._writer.path

    @property
    def is_deleted(self) -> bool:
        """Whether the file being written has been deleted."""
        return self._writer.is_deleted

    @property
    def size(self) -> int:
        """Bytes on disk, of all segments that are kept."""
        return self._size_before + self._writer.size

    def write(self, device: str, frame: Frame, t: float) -> None:
        """One sample of a device (or of a signal, for Scalar); t is its estimated time, run seconds since 1970."""
        sample = frame.sample
        if isinstance(sample, Event):
            self.event(t, sample.kind, sample.text)
            return
        if isinstance(sample, PortHealth):
            self.health(device, sample, t)
            return
        log_ns, stamp_ns = self._times(frame.t_rx, t)
        messages = schema.messages(device, frame)
        # All messages of one sample carry the sequence number of the first: the reader joins them by it.
        key = messages[0].topic
        sequence = self._sequences[key] = (self._sequences.get(key, 0) + 1) & 0xFFFFFFFF
        for topic, type_name, frame_id, values in messages:
            pack = self._packers.get(topic)  # a topic has one type and one frame_id
            if pack is None:
                pack = self._packers[topic] = cdr_layout(type_name, frame_id.encode()).pack
            self._add(topic, type_name, log_ns, stamp_ns, sequence, pack(stamp_ns, *values))

    def write_raw(self, device: str, direction: str, data: bytes, t: float) -> None:
        """Bytes as read from ("rx") or written to ("tx") a port at t."""
        log_ns, stamp_ns = self._times(t, t)
        message = cdr_layout(schema.RAW, device.encode()).pack(stamp_ns, _DIRECTIONS[direction], tail=(data,))
        self._add(f"/raw/{device}", schema.RAW, log_ns, stamp_ns, 0, message)

    def event(self, t: float, kind: str, text: str) -> None:
        """Something that happened at t."""
        log_ns, stamp_ns = self._times(t, t)
        message = cdr_layout(schema.EVENT, b"").pack(stamp_ns, tail=(_line(kind), _line(text)))
        self._add("/event", schema.EVENT, log_ns, stamp_ns, 0, message)

    def health(self, device: str, health: PortHealth, t: float) -> None:
        """The counters of a device's port at t."""
        log_ns, stamp_ns = self._times(t, t)
        message = cdr_layout(schema.HEALTH, device.encode()).pack(
            stamp_ns,
            health.bytes_in,
            health.frames,
            health.checksum_errors,
            health.unparsed_bytes,
            health.dropped,
            health.reconnects,
            health.clock_bias,
            health.clock_spread,
            tail=(_line(health.port),),
        )
        self._add(f"/health/{device}", schema.HEALTH, log_ns, stamp_ns, 0, message)

    def tick(self) -> None:
        """Flush, sync, begin the next segment, look for room again when it is time; call it at least every 50 ms."""
        if self.paused:
            if time.monotonic() >= self._retry_at:
                self._resume()
            return
        with self._waiting():
            self._writer.tick()
        limits, age = self._segments, (self._log_ns - self._started_ns) / NANO
        by_size = limits.megabytes is not None and self._writer.size >= limits.megabytes * 1e6
        if not self.paused and (by_size or (limits.seconds is not None and age >= limits.seconds)):
            with self._waiting():
                self._writer.close()
                self._next()
        keep = limits.keep_gigabytes
        while keep is not None and self._past and self.size > 1e9 * keep and not self.paused:
            self._delete(self._past.popleft(), keep)

    def _delete(self, segment: _Segment, keep: float) -> None:
        self._size_before -= segment.size
        try:
            if _identity(segment.path) != segment.identity:
                return  # another file has its name
            segment.path.unlink()
            text = f"deleted {segment.path.name}: keep_gb is {keep:g}"
        except OSError as error:
            text = f"{segment.path.name} could not be deleted ({error.strerror})"
        self.event(self._log_ns / NANO, "disk", text)

    def close(self) -> None:
        """End the log. Raises SeatrialError where its end could not be written."""
        if self.paused:
            self._resume()
        if self.paused:
            lost = counted(len(self._kept), "message")
            raise SeatrialError(f"{self.paused}; {lost} that came since could not be written")
        self._writer.close()

    @contextlib.contextmanager
    def _waiting(self) -> Iterator[None]:
        """A full disk within the block pauses a patient recorder."""
        try:
            yield
        except DiskFull as error:
            if not self._patient:
                raise
            self._pause(error)

    def _pause(self, error: DiskFull) -> None:
        self.paused = self.paused or f"{self._writer.path.parent}: the disk is full, nothing is written now"
        self._lost_some = not error.complete
        self._paused_at = time.monotonic()
        self._retry_at = self._paused_at + RETRY_S

    def _resume(self) -> None:
        """Go on in a new segment where there is room for one."""
        self._retry_at = time.monotonic() + RETRY_S
        if free_bytes(self.first_path) < ROOM_BYTES:
            return
        try:
            self._next()
        except SeatrialError:
            return  # another program has taken the space
        kept, self._kept, self.paused = self._kept, [], ""
        for message in kept:
            self._add(*message)
        seconds = time.monotonic() - self._paused_at
        loss = "; what came in the last moment before is lost" if self._lost_some else ""
        self.event(self._log_ns / NANO, "disk", f"full for {seconds:.1f} s; kept {counted(len(kept), 'message')}{loss}")

    def _next(self) -> None:
        """Begin the next segment; a name that is taken is passed over."""
        before, number = self._size_before + self._writer.size, self._number + 1
        past = self._writer.path
        while (path := segment_path(self.first_path, number)).exists():
            number += 1
        self._open(path, number)
        self._size_before = before
        with contextlib.suppress(OSError):  # somebody has deleted it
            if past != self.first_path:
                self._past.append(_Segment(past, past.stat().st_size, _identity(past)))

    def _times(self, t_log: float, t_stamp: float) -> tuple[int, int]:
        self._log_ns = max(self._log_ns, self._ns(t_log, self._log_ns))
        return self._log_ns, self._ns(t_stamp, self._log_ns)

    @staticmethod
    def _ns(t: float, otherwise: int) -> int:
        # A clock estimate may be NaN before its first sample; the header's seconds end in 2038 (int32).
        return round(t * NANO) if 0.0 <= t < 2**31 else otherwise

    def _add(self, topic: str, type_name: str, log_ns: int, stamp_ns: int, sequence: int, data: bytes) -> None:
        if self.paused:
            self._kept.append(_Message(topic, type_name, log_ns, stamp_ns, sequence, data))
            return
        try:
            channel = self._channels.get(topic)
            if channel is None:
                channel = self._channels[topic] = self._writer.channel(topic, type_name)
            self._writer.add(channel, log_ns, stamp_ns, sequence, data)
        except DiskFull as error:
            if not self._patient:
                raise
            self._pause(error)
            if not error.complete:  # else this message is in the file, too
                self._kept.append(_Message(topic, type_name, log_ns, stamp_ns, sequence, data))


class _Segment(NamedTuple):
    """A file that is finished."""

    path: Path
    size: int
    identity: tuple[int, ...]


def _identity(path: Path) -> tuple[int, ...]:
    """What tells a file that is finished from any other; an inode alone is given again."""
    about = path.stat(follow_symlinks=False)
    return about.st_dev, about.st_ino, about.st_mtime_ns, about.st_size


class _Message(NamedTuple):
    """What `Recorder._add` takes."""

    topic: str
    type_name: str
    log_ns: int
    stamp_ns: int
    sequence: int
    data: bytes


def free_bytes(path: Path) -> int:
    """Room on the disk that holds the nearest folder above `path` that there is."""
    folder = next((parent for parent in path.absolute().parents if parent.is_dir()), Path("/"))
    return shutil.disk_usage(folder).free


def check_room(path: Path, megabytes: float) -> None:
    """Raises SeatrialError where the disk has less than that."""
    free = free_bytes(path) / 1e6
    if free < megabytes:
        raise SeatrialError(
            f"{path.parent}: only {free:.0f} MB free and the rig asks for {megabytes:.0f} to begin a log; "
            "free disk space or lower free_mb in [log]"
        )


def _line(text: str) -> bytes:
    """Text as CDR can carry it: a NUL would end it, a lone surrogate has no UTF-8."""
    return text.replace("\0", "").encode("utf-8", errors="replace")
