"""Recorder of samples, raw bytes, events and port counters to one MCAP log (docs/formats/log.md).

Only one thread may call a recorder.
"""

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
from seatrial.daq.log.provenance import collect_provenance
from seatrial.daq.log.segments import segment_path
from seatrial.daq.log.watchdog_note import discard_note
from seatrial.daq.rig import Rig
from seatrial.daq.samples import Event, Frame, PortHealth, Transducer

LOG_FORMAT = "seatrial-log 1"
RETRY_S = 0.25  # s of wall time between two checks of a full disk
ROOM_BYTES = 2 * 2**20  # space for the ballast of a segment and for some data
_DIRECTIONS = {"rx": 0, "tx": 1}


class Clock(Protocol):
    """Interface to the run clock, `seatrial.daq.clock.RunClock`, with the parts that the recorder uses.

    The run clock is the time of a run. It is faster than wall time only on simulated devices.
    """

    @property
    def speed(self) -> float:
        """Seconds of the run clock in one second of wall time."""

    @property
    def origin(self) -> object:
        """Numbers [s] from which another process can rebuild the run clock; the recorder stores them in the log."""

    def now(self) -> float:
        """Return the time of the run clock [s since 1970]."""


class Recorder:
    """Recorder of one MCAP log, in as many segments (files) as the [log] table of the rig requires.

    Parameters
    ----------
    path
        First segment, NAME.mcap. Later segments are NAME.1.mcap, NAME.2.mcap and so on.
    rig
        Rig of the log. Its [log] table contains the limits of the segments.
    clock
        Run clock of the times in the log.
    attachments
        Contents of further attached files, by name. The rig file is attached as "rig.toml".
    metadata
        Further texts of the metadata, by name. They replace texts of the recorder with the same name.
    patient
        Whether recording goes on after a full disk. A patient recorder ends its file if the disk is full. It keeps new
        messages in memory, without limit, `paused` contains the reason, and a new segment begins when there is room.
        The caller should write little while `paused` is not empty. If it is False, a full disk raises an error.

    Attributes
    ----------
    first_path : Path
        Path of the first segment.
    paused : str
        Reason why nothing is written to the disk at present; empty if recording is not paused.

    Raises
    ------
    SeatrialError
        If a file cannot be created or written. The methods that write raise it too.

    Notes
    -----
    Each segment has all metadata and attachments that a reader needs. If the log is larger than `keep_gb`, the oldest
    segments are deleted. The first segment stays, because it has the beginning and the name of the log. The log time of
    a message is the time of receipt, but never earlier than the log time of the message before.
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
        """Create the first file of the log at `path`, with the rig file, the attachments and the metadata.

        A `patient` recorder goes on when a full disk has room again. A watchdog's note beside an earlier log of the
        same name is deleted. Raise SeatrialError if the file exists or cannot be created.
        """
        origin = json.dumps(clock.origin)
        about = {"format": LOG_FORMAT, "rig": rig.name, "speed": repr(clock.speed), "origin": origin}
        self._metadata = {**collect_provenance("import" in (metadata or {})), **about, **(metadata or {})}
        self._attachments = {"rig.toml": rig.text.encode(), **(attachments or {})}
        self._log_ns = self._to_ns(clock.now(), 0)
        self._segments, self._patient = rig.segments, patient
        self.first_path = Path(path)
        self.paused = ""  # the reason if recording is paused
        self._kept: list[_KeptMessage] = []  # messages since the beginning of the pause
        self._retry_at = self._paused_at = 0.0
        self._lost_some = False
        self._sequences: dict[str, int] = {}
        self._packers: dict[str, Callable[..., bytes]] = {}
        self._units: dict[str, str] = {}  # of the transducers, by topic
        self._size_before = 0
        self._past: deque[_FinishedSegment] = deque()  # finished segments that may be deleted
        self._begin_segment(self.first_path, 0)
        discard_note(self.first_path)

    def _begin_segment(self, path: Path, number: int) -> None:
        """Create a file of the log, the segment `path`, with all metadata and attachments, and make it the current one.

        `number` is that of the segment, 0 for the first. The file before is not closed here. Topics are registered
        again with their next message. Raise SeatrialError if the file cannot be created.
        """
        about = {**self._metadata, "segment": str(number)}
        self._writer = LogWriter(path, metadata=about, attachments=self._attachments, time_ns=self._log_ns)
        self._number, self._started_ns = number, self._log_ns
        self._channels: dict[str, int] = {}

    @property
    def path(self) -> Path:
        """Path of the file of the log (segment) that is being written."""
        return self._writer.path

    @property
    def is_deleted(self) -> bool:
        """Whether the file of the log (segment) that is being written has been deleted; False during a pause."""
        return self._writer.is_deleted

    @property
    def size(self) -> int:
        """Number of bytes of the log in all segments, except those that the recorder has tried to delete.

        A segment whose deletion failed is not counted any more. One that another program has deleted is still counted.
        """
        return self._size_before + self._writer.size

    def write(self, device: str, frame: Frame, t: float) -> None:
        """Write one sample, event or set of port counters of a device to the log.

        During a pause (while the disk is full) the messages are kept in memory. All messages of a sample have the same
        sequence number.

        Parameters
        ----------
        device
            Name of the device, or of the signal for `Scalar`. A `Transducer` contains the name of its signal.
        frame
            The sample with its time of receipt.
        t
            Estimated time of the sample by the run clock [s since 1970]. NaN stands for the log time (time of receipt,
            but never earlier than the log time of the message before). Events and counters are logged at `t`, as by
            `event` and `health`; their time of receipt is not used.

        Raises
        ------
        SeatrialError
            If the file cannot be written. A patient recorder pauses instead if the disk is full.
        """
        sample = frame.sample
        if isinstance(sample, Event):
            self.event(t, sample.kind, sample.text)
            return
        if isinstance(sample, PortHealth):
            self.health(device, sample, t)
            return
        log_ns, stamp_ns = self._log_and_stamp_ns(frame.t_rx, t)
        messages = schema.messages(device, frame)
        # All messages of one sample have the same sequence number: the reader joins them by this number.
        key = messages[0].topic
        if isinstance(sample, Transducer):
            self._units[key] = sample.unit
        sequence = self._sequences[key] = (self._sequences.get(key, 0) + 1) & 0xFFFFFFFF
        for topic, type_name, frame_id, values in messages:
            pack = self._packers.get(topic)  # a topic has one type and one frame_id
            if pack is None:
                pack = self._packers[topic] = cdr_layout(type_name, frame_id.encode()).pack
            self._add_message(topic, type_name, log_ns, stamp_ns, sequence, pack(stamp_ns, *values))

    def write_raw(self, device: str, direction: str, data: bytes, t: float) -> None:
        """Write bytes of a device's port to the log, with the time t [s since 1970].

        The direction is "rx" for bytes read from the port, and "tx" for bytes written to it; another one raises
        KeyError. If t is NaN, it becomes the log time of the message before. SeatrialError is raised if the file cannot
        be written; a patient recorder pauses instead if the disk is full.
        """
        log_ns, stamp_ns = self._log_and_stamp_ns(t, t)
        message = cdr_layout(schema.RAW, device.encode()).pack(stamp_ns, _DIRECTIONS[direction], tail=(data,))
        self._add_message(f"/raw/{device}", schema.RAW, log_ns, stamp_ns, 0, message)

    def event(self, t: float, kind: str, text: str) -> None:
        """Write an event to the log at time t [s since 1970]: its kind, such as "warning", and its description.

        NUL characters in the texts are left out. If t is NaN, it becomes the log time of the message before. During a
        pause (while the disk is full) the event is kept in memory. SeatrialError is raised if the file cannot be
        written; a patient recorder pauses instead if the disk is full.
        """
        log_ns, stamp_ns = self._log_and_stamp_ns(t, t)
        message = cdr_layout(schema.EVENT, b"").pack(stamp_ns, tail=(_encode_text(kind), _encode_text(text)))
        self._add_message("/event", schema.EVENT, log_ns, stamp_ns, 0, message)

    def health(self, device: str, health: PortHealth, t: float) -> None:
        """Write the counters of a device's port (bytes, frames, errors, ...) to the log at time t [s since 1970].

        If t is NaN, it becomes the log time of the message before. SeatrialError is raised if the file cannot be
        written; a patient recorder pauses instead if the disk is full.
        """
        log_ns, stamp_ns = self._log_and_stamp_ns(t, t)
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
            tail=(_encode_text(health.port),),
        )
        self._add_message(f"/health/{device}", schema.HEALTH, log_ns, stamp_ns, 0, message)

    def tick(self) -> None:
        """Do the periodic work of the recorder when it is due. The caller calls this at least every 50 ms.

        The work is: flush and sync the segment, begin the next segment at the limits of size or time in the rig, and
        delete the oldest segments if the log is too large. During a pause it is only to check, every 0.25 s (wall),
        whether the full disk has room again, and then to go on with the recording. SeatrialError is raised if a file
        cannot be created or written; a patient recorder pauses instead if the disk is full.
        """
        if self.paused:
            if time.monotonic() >= self._retry_at:
                self._resume()
            return
        with self._pause_if_full():
            self._writer.tick()
        limits, age = self._segments, (self._log_ns - self._started_ns) / NANO
        by_size = limits.megabytes is not None and self._writer.size >= limits.megabytes * 1e6
        if not self.paused and (by_size or (limits.seconds is not None and age >= limits.seconds)):
            with self._pause_if_full():
                self._writer.close()
                self._begin_next_segment()
        keep = limits.keep_gigabytes
        while keep is not None and self._past and self.size > 1e9 * keep and not self.paused:
            self._delete_segment(self._past.popleft(), keep)

    def _delete_segment(self, segment: _FinishedSegment, keep: float) -> None:
        """Delete a finished file of the log, and record the deletion, or its failure, as an event.

        `keep` is the limit of the log's size [GB], for the text of the event. If another file has replaced the segment
        in the meantime, nothing is deleted or recorded. In each case `size` does not count the segment any more, and
        its deletion is not tried again.
        """
        self._size_before -= segment.size
        try:
            if _file_identity(segment.path) != segment.identity:
                return  # another file has this name now
            segment.path.unlink()
            text = f"deleted {segment.path.name}, because the log is larger than keep_gb = {keep:g}"
        except OSError as error:
            text = (
                f"{segment.path.name} could not be deleted ({error.strerror}), and the log is larger than "
                f"keep_gb = {keep:g}: delete this file yourself"
            )
        self.event(self._log_ns / NANO, "disk", text)

    def close(self) -> None:
        """End the log and close its file, also if an error is raised. During a pause, first try to write kept messages.

        Only a patient recorder pauses, while the disk is full; the file before the pause is closed already.

        Raises
        ------
        SeatrialError
            If the end of the log could not be written, or if the pause cannot be ended, even without kept messages. If
            the disk is full but the reserved space had room for the end, `DiskFull` is raised, with `complete` true.
        """
        if self.paused:
            self._resume()
        if self.paused:
            lost = counted(len(self._kept), "message")
            raise SeatrialError(
                f"{self.paused}; {lost} received since then could not be written; free disk space, and record again"
            )
        self._writer.close()

    def discard(self) -> None:
        """Close the log and delete its file, so that its name is free again.

        This is for a start that has failed: only a log in its first segment may be discarded, before any sample.
        """
        with contextlib.suppress(SeatrialError):  # a full disk does not matter to a file that is deleted
            self._writer.close()
        with contextlib.suppress(OSError):
            self.path.unlink()

    @contextlib.contextmanager
    def _pause_if_full(self) -> Iterator[None]:
        """Pause the recorder if the disk is full within the `with` block and the recorder is patient.

        A recorder that is not patient raises DiskFull. Other errors are passed on.
        """
        try:
            yield
        except DiskFull as error:
            if not self._patient:
                raise
            self._pause(error)

    def _pause(self, error: DiskFull) -> None:
        """Pause the recorder because of a full disk: store the reason in `paused`, and the time of the first retry.

        `error.complete` is whether the ended file contains all messages; otherwise the last ones are noted as lost. A
        pause that goes on keeps its first reason, but its duration counts from now.
        """
        self.paused = (
            self.paused or f"{self._writer.path.parent}: the disk is full, nothing is written now: free disk space"
        )
        self._lost_some = not error.complete
        self._paused_at = time.monotonic()
        self._retry_at = self._paused_at + RETRY_S

    def _resume(self) -> None:
        """End the pause of the recorder if the disk has room: write the kept messages to a new segment.

        Room means 2 MiB (ROOM_BYTES), and that the segment can be created. Otherwise the recorder stays paused. If the
        disk is full again while the messages are written, the recorder pauses again. The duration of the pause is
        recorded as an event.
        """
        self._retry_at = time.monotonic() + RETRY_S
        if free_bytes(self.first_path) < ROOM_BYTES:
            return
        try:
            self._begin_next_segment()
        except SeatrialError:
            return  # another program has taken the space
        kept, self._kept, self.paused = self._kept, [], ""
        for message in kept:
            self._add_message(*message)
        seconds = time.monotonic() - self._paused_at
        loss = "; the last messages before are lost" if self._lost_some else ""
        self.event(self._log_ns / NANO, "disk", f"full for {seconds:.1f} s; kept {counted(len(kept), 'message')}{loss}")

    def _begin_next_segment(self) -> None:
        """Begin the next file (segment) of the log, and note the finished one for a later deletion.

        Numbers whose file exists are skipped. The first segment, and a finished one that does not exist any more, are
        not noted. Raise SeatrialError if the file cannot be created.
        """
        before, number = self._size_before + self._writer.size, self._number + 1
        past = self._writer.path
        while (path := segment_path(self.first_path, number)).exists():
            number += 1
        self._begin_segment(path, number)
        self._size_before = before
        with contextlib.suppress(OSError):  # another program has deleted the segment
            if past != self.first_path:
                self._past.append(_FinishedSegment(past, past.stat().st_size, _file_identity(past)))

    def _log_and_stamp_ns(self, t_log: float, t_stamp: float) -> tuple[int, int]:
        """Convert log time (time of receipt) and time stamp of a message from s to ns since 1970.

        The log time never decreases from call to call. A log time that is NaN or outside 1970 to 2038 becomes the one
        before. A time stamp that is NaN or outside 1970 to 2038 becomes the log time.
        """
        self._log_ns = max(self._log_ns, self._to_ns(t_log, self._log_ns))
        return self._log_ns, self._to_ns(t_stamp, self._log_ns)

    @staticmethod
    def _to_ns(t: float, otherwise: int) -> int:
        """Convert a time from s to ns since 1970. A NaN or a time outside 1970 to 2038 gives `otherwise` [ns]."""
        # A clock estimate may be NaN before its first sample; the header's seconds end in 2038 (int32).
        return round(t * NANO) if 0.0 <= t < 2**31 else otherwise

    def _add_message(self, topic: str, type_name: str, log_ns: int, stamp_ns: int, sequence: int, data: bytes) -> None:
        """Write a message in CDR to the current file of the log, or keep it in memory during a pause.

        A new topic is registered first. If the disk is full, a patient recorder pauses; another one raises DiskFull.

        Parameters
        ----------
        topic, type_name
            Topic of the message, and its type `package/msg/Name`.
        log_ns, stamp_ns
            Times of receipt and of measurement [ns since 1970].
        sequence
            Sequence number.
        data
            Message in CDR.
        """
        if self.paused:
            self._kept.append(_KeptMessage(topic, type_name, log_ns, stamp_ns, sequence, data))
            return
        try:
            channel = self._channels.get(topic)
            if channel is None:
                about = (
                    {"unit": self._units[topic], "hold": "linear", "role": "output"} if topic in self._units else None
                )
                channel = self._channels[topic] = self._writer.channel(topic, type_name, about)
            self._writer.add(channel, log_ns, stamp_ns, sequence, data)
        except DiskFull as error:
            if not self._patient:
                raise
            self._pause(error)
            if not error.complete:  # a complete file contains this message already
                self._kept.append(_KeptMessage(topic, type_name, log_ns, stamp_ns, sequence, data))


class _FinishedSegment(NamedTuple):
    """File (segment) of the log that is complete and may be deleted to limit the size of the log.

    Attributes
    ----------
    path
        Path of the segment.
    size
        Size of the file [bytes].
    identity
        Device, inode, time of change [ns] and size, which distinguish the file from other files.
    """

    path: Path
    size: int
    identity: tuple[int, ...]


def _file_identity(path: Path) -> tuple[int, ...]:
    """Return numbers that distinguish a finished file from others: device, inode, time of change [ns], size [bytes].

    A symbolic link is not followed. Raise OSError if the file does not exist.
    """
    # The inode alone is not sufficient: the file system reuses the inode of a deleted file.
    about = path.stat(follow_symlinks=False)
    return about.st_dev, about.st_ino, about.st_mtime_ns, about.st_size


class _KeptMessage(NamedTuple):
    """Message that waits in memory while the disk is full: the arguments of `Recorder._add_message`.

    Attributes
    ----------
    topic
        Topic of the message.
    type_name
        Message type, package/msg/Name.
    log_ns
        Log time [ns since 1970].
    stamp_ns
        Time of the sample [ns since 1970].
    sequence
        Sequence number.
    data
        Message in CDR.
    """

    topic: str
    type_name: str
    log_ns: int
    stamp_ns: int
    sequence: int
    data: bytes


def free_bytes(path: Path) -> int:
    """Return the free space [bytes] of the disk to which a log is written.

    `path` is the log; the file and its folders need not exist yet. The space is that of its nearest parent folder that
    exists.
    """
    folder = next((parent for parent in path.absolute().parents if parent.is_dir()), Path("/"))
    return shutil.disk_usage(folder).free


def check_room(path: Path, megabytes: float) -> None:
    """Check that the disk of a new log has enough free space. Nothing is returned or reserved.

    Parameters
    ----------
    path
        The log.
    megabytes
        Free space that the rig requires [MB].

    Raises
    ------
    SeatrialError
        If the disk has less free space.
    """
    free = free_bytes(path) / 1e6
    if free < megabytes:
        raise SeatrialError(
            f"{path.parent}: only {free:.0f} MB free, but the rig requires {megabytes:.0f} MB to begin a log; "
            "free disk space or lower free_mb in [log]"
        )


def _encode_text(text: str) -> bytes:
    """Encode a text for a CDR message, as UTF-8 without NUL characters, which would end the text.

    A character that UTF-8 cannot encode becomes "?".
    """
    # A NUL would end the string; a lone surrogate cannot be encoded in UTF-8.
    return text.replace("\0", "").encode("utf-8", errors="replace")
