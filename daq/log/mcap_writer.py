"""Writer of one MCAP file. A killed process, a power cut or a full disk costs at most the last moment of the log.

`LogWriter` owns the file. `RecordWriter` encodes the records. Messages are encoded by code of this module; all other
records are encoded by the mcap package. One precompiled struct packs the head of a message, and head and data are
appended to a list. Counts, times and message indexes are computed from whole columns at the end of a chunk. The writer
of the mcap package creates objects and one struct for each field, and takes several times as long
(docs/decisions/0025-own-codecs.md). The stream receives a chunk and its indexes in one `write`. It also receives the
end of the file in one `write`.
Source: MCAP specification 0 (mcap.dev/spec).
"""

from __future__ import annotations

import contextlib
import errno
import struct
import time
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NoReturn, Protocol

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from seatrial.daq.errors import SeatrialError
from seatrial.daq.log.cdr import full_definition
from seatrial.daq.log.mcap_chunk import HEAD_BYTES, MESSAGE_HEAD, rows_at
from seatrial.daq.log.record_stream import BALLAST_BYTES, FileSyncer, WholeRecordStream

_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE_CODE = int(Opcode.MESSAGE)
_INDEX = struct.Struct("<BQHI")  # opcode, length, channel, bytes of entries
_FOOTER = struct.Struct("<BQQQ")  # the part of the footer that its checksum covers
_SUMMARY_REST = 512  # bytes; upper bound of statistics without its counts, six offsets, footer and magic
MAX_CHANNELS = 65_535  # the file stores channel numbers in 16 bits
CHUNK_BYTES = 256 * 1024
FLUSH_S = 0.25  # s of wall time; a flush ends a chunk, and a killed run keeps only ended chunks
FEW_WAITING, FEW_FLUSH_S = 16, 0.1  # up to 16 messages wait only 0.1 s: if messages are rare, each one is important
SYNC_S = 1.0  # s of wall time
DISK_FULL_ERRORS = (errno.ENOSPC, errno.EDQUOT)  # error numbers of a full disk
QOS = (  # QoS profile as rosbag2 stores it: keep the last 10 messages, reliable, volatile
    "- {history: 1, depth: 10, reliability: 1, durability: 2, deadline: {sec: 2147483647, nsec: 4294967295}, "
    "lifespan: {sec: 2147483647, nsec: 4294967295}, liveliness: 1, "
    "liveliness_lease_duration: {sec: 2147483647, nsec: 4294967295}, avoid_ros_namespace_conventions: false}"
)


class DiskFull(SeatrialError):
    """Error that a log could not be written because the disk is full.

    Attributes
    ----------
    complete
        Whether the file contains every message added so far, and its footer. It is also True if no file could be
        created, since no message is lost then.
    """

    def __init__(self, text: str, complete: bool) -> None:
        """Store the message for the user, and whether the file of the log is complete."""
        super().__init__(text)
        self.complete = complete


class LogWriter:
    """Writer of one MCAP log file: metadata and attachments first, then channels (topics) and messages.

    The caller calls `tick` often, so that written messages reach the disk in time.

    Parameters
    ----------
    path
        The new file. Its folder is created. An existing file is never overwritten.
    metadata
        Texts of the metadata record "seatrial", by name.
    attachments
        Contents of attached files, by name.
    time_ns
        Time of the attachments [ns since 1970].

    Raises
    ------
    SeatrialError
        If the file cannot be created, or if a later write fails. After a failed write the file is closed. It then has a
        footer only if the disk was full and the reserved disk space (ballast) had room for the footer. Every later call
        of `channel`, `add`, `tick` or `flush` raises SeatrialError.
    """

    def __init__(
        self,
        path: Path,
        *,
        metadata: Mapping[str, str],
        attachments: Mapping[str, bytes],
        time_ns: int,
    ) -> None:
        """Create the file of a log and write its header, metadata and attachments.

        `metadata` and `attachments` are by name; `time_ns` is the time of the attachments [ns since 1970]. Raise
        SeatrialError if the file exists, or cannot be created or written.
        """
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except FileExistsError:
            raise SeatrialError(
                f"{path}: the folder cannot be created: {path.parent} is not a folder; give another path"
            ) from None
        except OSError as error:
            raise SeatrialError(f"{path}: the folder cannot be created: {error.strerror}; give another path") from error
        try:
            self._stream = WholeRecordStream(path)
        except FileExistsError:
            raise SeatrialError(
                f"{path}: the file exists already, and a log is never overwritten; give another name"
            ) from None
        except OSError as error:
            text = f"{path}: the log cannot be created: {error.strerror}; give another path, or free disk space"
            raise (DiskFull(text, complete=True) if error.errno in DISK_FULL_ERRORS else SeatrialError(text)) from error
        self._syncer = FileSyncer(self._stream)
        self._syncer.start()
        self._failed: SeatrialError | None = None
        self._closed = False
        self._schemas: dict[str, int] = {}
        self._waits = self._synced = time.monotonic()
        with self._close_on_error():
            self._write_head(metadata, attachments, time_ns)

    def _write_head(self, metadata: Mapping[str, str], attachments: Mapping[str, bytes], time_ns: int) -> None:
        """Write the first records of the log file: the header, the metadata and the attachments.

        The attachments, by name, get the time `time_ns` [ns since 1970]. Their media type is "application/toml" if the
        name ends with ".toml", and "application/octet-stream" otherwise.
        """
        self._writer = RecordWriter(self._stream, chunk_bytes=CHUNK_BYTES, profile="ros2", library="seatrial")
        self._writer.add_metadata("seatrial", metadata)
        for name, data in attachments.items():
            kind = "application/toml" if name.endswith(".toml") else "application/octet-stream"
            self._writer.add_attachment(time_ns, time_ns, name, kind, data)

    @property
    def size(self) -> int:
        """Number of bytes written to the log file so far, without the messages that wait for the next flush."""
        return self._stream.tell()

    @property
    def is_deleted(self) -> bool:
        """Whether the log file has been deleted while it is open; False after `close`."""
        return not self._closed and self._stream.is_deleted

    def channel(self, topic: str, type_name: str, metadata: Mapping[str, str] | None = None) -> int:
        """Register a topic of the log and return the number of its channel, which `add` needs.

        Numbers begin at 1. Call this once for each topic; a second call gives another number. The definition of the
        message type is registered with the first topic of the type.

        Parameters
        ----------
        topic
            Name of the topic.
        type_name
            Message type, `package/msg/Name`.
        metadata
            Further texts of the channel, such as unit and hold of an imported signal.

        Raises
        ------
        SeatrialError
            If the log is closed, an earlier write failed, or the log has 65,535 topics already.
        FileNotFoundError
            If daq/msg has no definition of the message type.
        """
        self._require_open()
        if type_name not in self._schemas:
            data = full_definition(type_name).encode()
            self._schemas[type_name] = self._writer.register_schema(type_name, "ros2msg", data)
        extra = {"offered_qos_profiles": QOS, **(metadata or {})}
        try:
            return self._writer.register_channel(topic, "cdr", self._schemas[type_name], extra)
        except SeatrialError as error:
            raise SeatrialError(f"{self.path}: {error}") from error

    def add(self, channel: int, log_ns: int, stamp_ns: int, sequence: int, data: bytes) -> None:
        """Append one message to the log. The operating system receives it at the next flush, or in a full chunk.

        Parameters
        ----------
        channel
            Number of the channel.
        log_ns
            Time of receipt [ns since 1970].
        stamp_ns
            Time of the sample [ns since 1970], the publish time of the message.
        sequence
            Sequence number of the message.
        data
            Message in CDR.

        Raises
        ------
        SeatrialError
            If the log is closed, or if this or an earlier write failed. It is `DiskFull` if the disk is full.
        """
        if self._closed:
            self._require_open()
        try:  # the code of `_close_on_error` is repeated here, because a context manager for every message is too slow
            self._writer.add_message(channel, log_ns, data, stamp_ns, sequence)
        except OSError as error:
            self._close_and_raise(error, complete=False)
        if self._stream.failure is not None:
            self._finish_with_ballast()

    def tick(self) -> None:
        """Flush waiting messages of the log and sync its file when it is time. The caller calls this often.

        Messages are flushed after 0.25 s (FLUSH_S), or after 0.1 s (FEW_FLUSH_S) if at most 16 wait. A sync of the file
        is requested every second of wall time; another thread does it. Raise SeatrialError if the log is closed, or if
        a write or a sync has failed; it is `DiskFull` if the disk is full.
        """
        self._require_open()
        now = time.monotonic()
        n_waiting = self._writer.n_waiting
        if not n_waiting:
            self._waits = now
        elif now - self._waits >= (FLUSH_S if n_waiting > FEW_WAITING else FEW_FLUSH_S):
            self._waits = now
            self.flush()
        if now - self._synced >= SYNC_S:
            self._synced = now
            self._syncer.request()
        if self._syncer.error is not None:
            self._close_and_raise(self._syncer.error, complete=False)

    def flush(self) -> None:
        """End the current chunk (group of messages) of the log and pass it to the operating system.

        Without waiting messages nothing is written. Also reserve more disk space for the end of the file if the log has
        grown; a failure of this is ignored. Raise SeatrialError if the log is closed, or if this or an earlier write
        failed; it is `DiskFull` if the disk is full.
        """
        self._require_open()
        with self._close_on_error():
            self._writer.flush()
        # The end of the file needs about 80 bytes for every chunk and 10 more for each of its channels. The ballast
        # must have room for it.
        steps = -(-(2 * self._writer.summary_bytes) // BALLAST_BYTES)
        with contextlib.suppress(OSError):  # the disk is nearly full: the first failed write reports it
            self._stream.ballast.grow((1 + steps) * BALLAST_BYTES)

    def close(self) -> None:
        """Write the end of the log file, sync and close it.

        A second call, or a call after a failed write, has no effect.

        Raises
        ------
        SeatrialError
            If the end of the file could not be written or synced. If the disk is full but the reserved space had room
            for the end, the file is complete; `DiskFull` with `complete` true is raised nevertheless.
        """
        if self._closed:
            return
        try:
            self._writer.finish()
            self._stream.sync()
        except OSError as error:
            self._close_and_raise(error, complete=False)
        self._close_file()
        if self._stream.failure is not None:
            raise self._write_error(self._stream.failure, complete=True)

    @contextlib.contextmanager
    def _close_on_error(self) -> Iterator[None]:
        """Close the log file and raise SeatrialError if a write within the `with` block fails.

        If the disk was full, but the reserved space had room for the records, the end of the file is written first if
        there is room for it too. `DiskFull` is raised in both cases.
        """
        try:
            yield
        except OSError as error:  # records are lost: the indexes of the writer no longer agree with the file
            self._close_and_raise(error, complete=False)
        if self._stream.failure is not None:
            self._finish_with_ballast()

    def _finish_with_ballast(self) -> NoReturn:
        """End the log file after the disk was full, and raise DiskFull.

        The disk space that was reserved for the last records (the ballast) has made room for them. `DiskFull.complete`
        is whether the end of the file could be written; no record is then lost.
        """
        assert self._stream.failure is not None
        complete = True
        try:
            self._writer.finish()
        except OSError:
            complete = False
        self._close_and_raise(self._stream.failure, complete)

    def _close_and_raise(self, error: OSError, complete: bool) -> NoReturn:
        """Close the log file and raise the error of a failed write: DiskFull if the disk is full, or SeatrialError.

        The error is also stored, and `_require_open` raises it again. `complete` is whether the file contains every
        message and its footer.
        """
        self._close_file()
        self._failed = self._write_error(error, complete)
        raise self._failed from error

    def _close_file(self) -> None:
        """Stop the sync thread of the log and close its file. No record is written."""
        self._closed = True
        self._syncer.end()
        self._stream.close()

    def _require_open(self) -> None:
        """Raise the error of an earlier failed write to the log, or SeatrialError if the log is closed."""
        if self._failed is not None:
            raise self._failed
        if self._closed:
            raise SeatrialError(f"{self.path}: the log is closed already; write all data before it is closed")

    def _write_error(self, error: OSError, complete: bool) -> SeatrialError:
        """Return the error for the user that a write to the log failed; `DiskFull` if the disk is full.

        The caller raises it. The text has the path, the cause, and the size of the file [bytes]. `complete` is whether
        the file contains every message and its footer.
        """
        state = "closed and complete up to there" if complete else "whole up to its last record, but has no footer"
        is_full = error.errno in DISK_FULL_ERRORS
        text = (
            f"{self.path}: writing failed ({error.strerror}) after {self.size} bytes; the log is {state}; "
            f"{'free disk space' if is_full else 'check the disk'} and start a new one"
        )
        return DiskFull(text, complete) if is_full else SeatrialError(text)


class Output(Protocol):
    """Interface of the file to which a `RecordWriter` writes whole records."""

    def write(self, data: bytes, /) -> object:
        """Write all bytes to the file, or raise OSError. The returned value is not used.

        It may be anything, such as the number of bytes that files of Python return.
        """

    def tell(self) -> int:
        """Return the number of bytes written to the file so far."""


class RecordWriter:
    """Encoder of the records of one MCAP file, with messages in zstd chunks (compressed groups).

    A chunk ends at `flush`, at `finish`, or with the message that makes it longer than `chunk_bytes`. Errors of the
    stream pass through every method; do not use the writer after an error.

    Parameters
    ----------
    stream
        Destination of the records.
    chunk_bytes
        Number of uncompressed bytes after which a chunk ends.
    profile, library
        Texts of the header record.

    Attributes
    ----------
    n_chunks : int
        Number of chunks written so far.
    """

    def __init__(self, stream: Output, *, chunk_bytes: int, profile: str, library: str) -> None:
        """Begin an MCAP file: write its magic bytes and its header record to `stream`.

        `chunk_bytes` is the number of uncompressed bytes after which a chunk ends. `profile` and `library` are texts of
        the header.
        """
        self._stream, self._chunk_bytes = stream, chunk_bytes
        self._compressor = zstandard.ZstdCompressor()
        # Records that the summary repeats at the end, as bytes: objects for a day of chunks would take gigabytes.
        self._schemas, self._channels = bytearray(), bytearray()
        self._chunk_index, self._attachment_index, self._metadata_index = bytearray(), bytearray(), bytearray()
        self._n_schemas = self._n_channels = self._n_attachments = self._n_metadata = self.n_chunks = 0
        self._counts: Counter[int] = Counter()  # messages by channel
        self._begin_ns, self._end_ns = 2**64 - 1, 0
        self._parts: list[bytes] = []  # records of the current chunk
        self._held = 0  # bytes of these records
        self._offsets: list[int] = []  # offset of each message in the chunk
        stream.write(MCAP0_MAGIC + _encode_record(Header(profile, library)))

    @property
    def n_waiting(self) -> int:
        """Number of messages in the current MCAP chunk, which is not written yet."""
        return len(self._offsets)

    @property
    def summary_bytes(self) -> int:
        """Upper bound of the size [bytes] of summary and footer of the MCAP file, if it ended now.

        The index of the current chunk, which is not written yet, is not included.
        """
        kept = (self._schemas, self._channels, self._chunk_index, self._attachment_index, self._metadata_index)
        return sum(map(len, kept)) + 10 * self._n_channels + _SUMMARY_REST

    def add_metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Write a metadata record, which contains texts by name, to the MCAP file immediately."""
        at, record = self._stream.tell(), _encode_record(Metadata(name=name, metadata=dict(data)))
        self._stream.write(record)
        self._n_metadata += 1
        self._metadata_index += _encode_record(MetadataIndex(offset=at, length=len(record), name=name))

    def add_attachment(self, create_ns: int, log_ns: int, name: str, media_type: str, data: bytes) -> None:
        """Write an attached file to the MCAP file immediately.

        Parameters
        ----------
        create_ns, log_ns
            Times of creation and of recording [ns since 1970].
        name
            Name of the attached file.
        media_type
            Kind of the content, such as "application/toml".
        data
            Content.
        """
        at = self._stream.tell()
        record = _encode_record(Attachment(create_ns, log_ns, name, media_type, data))
        self._stream.write(record)
        index = AttachmentIndex(at, len(record), log_ns, create_ns, len(data), name, media_type)
        self._n_attachments += 1
        self._attachment_index += _encode_record(index)

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add the definition of a message type to the MCAP file, and return the number of its schema, from 1.

        The definition is appended to the current chunk, and is also written in the summary. Each call gives a new
        number.

        Parameters
        ----------
        name
            Name of the type, `package/msg/Name`.
        encoding
            Language of the definition, for example "ros2msg".
        data
            Text of the definition.
        """
        self._n_schemas += 1
        record = _encode_record(Schema(id=self._n_schemas, name=name, encoding=encoding, data=data))
        self._schemas += record
        self._append_record(record)
        return self._n_schemas

    def register_channel(self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]) -> int:
        """Add a topic to the MCAP file and return the number of its channel, from 1.

        The record of the channel is appended to the current chunk, and is also written in the summary. Each call gives
        a new number, also for the same topic.

        Parameters
        ----------
        topic
            Name of the topic.
        encoding
            Encoding of its messages, for example "cdr".
        schema
            Number of the schema (message type) of its messages, 0 for none.
        metadata
            Texts of the channel, by name.

        Raises
        ------
        SeatrialError
            If the file has 65,535 channels already.
        """
        if self._n_channels == MAX_CHANNELS:
            raise SeatrialError(
                f"a log holds at most {MAX_CHANNELS} topics, and this one would have more; leave some of them out"
            )
        self._n_channels += 1
        record = _encode_record(Channel(self._n_channels, topic, encoding, dict(metadata), schema))
        self._channels += record
        self._append_record(record)
        return self._n_channels

    def add_message(self, channel: int, log_ns: int, data: bytes, stamp_ns: int, sequence: int) -> None:
        """Append a message to the current chunk of the MCAP file. A chunk longer than `chunk_bytes` is written.

        Parameters
        ----------
        channel
            Number of the channel.
        log_ns
            Time of receipt [ns since 1970].
        data
            Encoded message.
        stamp_ns
            Time of the measurement [ns since 1970].
        sequence
            Sequence number.
        """
        head = _MESSAGE.pack(_MESSAGE_CODE, HEAD_BYTES + len(data), channel, sequence, log_ns, stamp_ns)
        record = head + data
        self._parts.append(record)
        self._offsets.append(self._held)
        self._held += len(record)
        if self._held > self._chunk_bytes:
            self.flush()

    def _append_record(self, record: bytes) -> None:
        """Append an encoded schema or channel record to the current chunk of the MCAP file. Nothing is written yet."""
        self._parts.append(record)
        self._held += len(record)

    def flush(self) -> None:
        """End the current chunk (group of messages) and write it to the MCAP file with its message indexes.

        A chunk without messages is not written; its other records stay for the next flush.
        """
        if not self._offsets:
            return
        data, offsets = b"".join(self._parts), np.asarray(self._offsets, np.int64)
        heads = rows_at(np.frombuffer(data, np.uint8), offsets, MESSAGE_HEAD)
        times, packed, begin = heads["log_ns"], self._compressor.compress(data), self._stream.tell()
        chunk = Chunk(
            compression="zstd",
            data=packed,
            message_start_time=int(times.min()),
            message_end_time=int(times.max()),
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        written = _encode_record(chunk)
        indexes, places = _message_indexes(heads["channel"], times, offsets, begin + len(written))
        self._stream.write(written + indexes)
        index = ChunkIndex(
            chunk_length=len(written),
            chunk_start_offset=begin,
            compression=chunk.compression,
            compressed_size=len(packed),
            message_end_time=chunk.message_end_time,
            message_index_length=len(indexes),
            message_index_offsets=places,
            message_start_time=chunk.message_start_time,
            uncompressed_size=len(data),
        )
        self.n_chunks += 1
        self._chunk_index += _encode_record(index)
        self._begin_ns = min(self._begin_ns, chunk.message_start_time)
        self._end_ns = max(self._end_ns, chunk.message_end_time)
        for number, n in zip(*np.unique(heads["channel"], return_counts=True), strict=True):
            self._counts[int(number)] += int(n)
        self._parts, self._offsets, self._held = [], [], 0

    def finish(self) -> None:
        """Write the last chunk and the end of the MCAP file, which consists of summary and footer.

        Nothing may be added after it. The stream is not closed.
        """
        self.flush()
        end = _encode_record(DataEnd(0))
        start = self._stream.tell() + len(end)
        summary, offsets = b"", b""
        for group in (
            self._schemas, self._channels, _encode_record(self._statistics()),
            self._chunk_index, self._attachment_index, self._metadata_index,
        ):  # fmt: skip
            if group:
                at = start + len(summary)
                offsets += _encode_record(SummaryOffset(group_opcode=group[0], group_start=at, group_length=len(group)))
            summary += group
        offset_start = start + len(summary)
        footed = _FOOTER.pack(Opcode.FOOTER, 20, start, offset_start)
        footer = Footer(
            summary_start=start,
            summary_offset_start=offset_start,
            summary_crc=zlib.crc32(summary + offsets + footed),
        )
        self._stream.write(end + summary + offsets + _encode_record(footer) + MCAP0_MAGIC)

    def _statistics(self) -> Statistics:
        """Return the MCAP statistics record: numbers of records, messages by channel, and span of the log times.

        The span is the smallest and the largest log time. Only messages in written chunks count. Without one both times
        are 0.
        """
        return Statistics(
            attachment_count=self._n_attachments,
            channel_count=self._n_channels,
            channel_message_counts=dict(self._counts),
            chunk_count=self.n_chunks,
            message_count=self._counts.total(),
            message_end_time=self._end_ns,
            message_start_time=min(self._begin_ns, self._end_ns),
            metadata_count=self._n_metadata,
            schema_count=self._n_schemas,
        )


def _message_indexes(
    channels: NDArray[np.uint16], times: NDArray[np.uint64], offsets: NDArray[np.int64], at: int
) -> tuple[bytes, dict[int, int]]:
    """Encode the message indexes of an MCAP chunk: one record for each channel, with time and offset of its messages.

    Parameters
    ----------
    channels
        Channel of each message of the chunk, shape (n,).
    times
        Log time of each message [ns since 1970], shape (n,).
    offsets
        Offset of each message in the uncompressed chunk [bytes], shape (n,).
    at
        Position of the first index record in the file [bytes].

    Returns
    -------
    tuple of bytes and dict
        The records, in ascending order of the channels, and the position of each record in the file [bytes] by channel.
        The messages of a channel keep their order.
    """
    order = np.argsort(channels, kind="stable")
    entries = np.stack((times[order], offsets[order].astype(np.uint64)), axis=1).astype("<u8")
    numbers, firsts = np.unique(channels[order], return_index=True)
    out, places = bytearray(), dict[int, int]()
    for number, begin, end in zip(numbers, firsts, [*firsts[1:], len(order)], strict=True):
        data = entries[begin:end].tobytes()
        places[int(number)] = at + len(out)
        out += _INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(data), number, len(data)) + data
    return bytes(out), places


def _encode_record(record: McapRecord) -> bytes:
    """Encode an MCAP record to bytes by the mcap package, with its opcode and length at the beginning."""
    builder = RecordBuilder()
    record.write(builder)
    written: bytes = builder.end()  # type: ignore[no-untyped-call]
    return written
