"""MCAP records -> a stream: what is done for every message is ours, every other record is mcap's own.

A message is its head, by one precompiled struct, and its data, put on a list; counts, times and message indexes are
made of whole columns when its chunk ends. mcap's own writer makes objects and one struct a field, at several times
the cost. A chunk and its indexes go to the stream in one `write`, and so does the end of the file.
Source: MCAP specification 0 (mcap.dev/spec).
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Mapping
from typing import Protocol

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

from daq.mcap_chunk import MESSAGE_HEAD, rows_at

_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE_CODE, _HEAD_BYTES = int(Opcode.MESSAGE), 22  # of a message's content, before its data
_INDEX = struct.Struct("<BQHI")  # opcode, length, channel, bytes of entries
_FOOTER = struct.Struct("<BQQQ")  # what of the footer its checksum covers
_SUMMARY_REST = 512  # statistics without its counts, six offsets, footer and magic, generously


class Output(Protocol):
    """What the records go to; gets whole records only."""

    def write(self, data: bytes, /) -> object:
        """Take all of it; raises OSError."""

    def tell(self) -> int:
        """Bytes written so far."""


class RecordWriter:
    """Writes one MCAP file in zstd chunks, each ended by `flush` or beyond `chunk_bytes`.

    Whatever the stream raises comes out of every method; the writer is of no use after that.
    """

    def __init__(self, stream: Output, *, chunk_bytes: int, profile: str, library: str) -> None:
        self._stream, self._chunk_bytes = stream, chunk_bytes
        self._compressor = zstandard.ZstdCompressor()
        # What the summary will repeat, as bytes: a day of chunks would be gigabytes of objects.
        self._schemas, self._channels = bytearray(), bytearray()
        self._chunk_index, self._attachment_index, self._metadata_index = bytearray(), bytearray(), bytearray()
        self._n_schemas = self._n_channels = self._n_attachments = self._n_metadata = self.n_chunks = 0
        self._counts: Counter[int] = Counter()  # messages by channel
        self._begin_ns, self._end_ns = 2**64 - 1, 0
        self._parts: list[bytes] = []  # the records of the chunk,
        self._held = 0  # their bytes,
        self._offsets: list[int] = []  # and where its messages begin
        stream.write(MCAP0_MAGIC + _bytes(Header(profile, library)))

    @property
    def n_waiting(self) -> int:
        """Messages in the chunk that is not written yet."""
        return len(self._offsets)

    @property
    def summary_bytes(self) -> int:
        """At most so much the end of the file will take, as things stand."""
        kept = (self._schemas, self._channels, self._chunk_index, self._attachment_index, self._metadata_index)
        return sum(map(len, kept)) + 10 * self._n_channels + _SUMMARY_REST

    def add_metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Write a metadata record at once."""
        at, record = self._stream.tell(), _bytes(Metadata(name=name, metadata=dict(data)))
        self._stream.write(record)
        self._n_metadata += 1
        self._metadata_index += _bytes(MetadataIndex(offset=at, length=len(record), name=name))

    def add_attachment(self, create_ns: int, log_ns: int, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment at once."""
        at = self._stream.tell()
        record = _bytes(Attachment(create_ns, log_ns, name, media_type, data))
        self._stream.write(record)
        index = AttachmentIndex(at, len(record), log_ns, create_ns, len(data), name, media_type)
        self._n_attachments += 1
        self._attachment_index += _bytes(index)

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Register a schema and return its number."""
        self._n_schemas += 1
        record = _bytes(Schema(id=self._n_schemas, name=name, encoding=encoding, data=data))
        self._schemas += record
        self._hold(record)
        return self._n_schemas

    def register_channel(self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]) -> int:
        """Register a topic and return the number of its channel; schema 0 is none."""
        self._n_channels += 1
        record = _bytes(Channel(self._n_channels, topic, encoding, dict(metadata), schema))
        self._channels += record
        self._hold(record)
        return self._n_channels

    def add_message(self, channel: int, log_ns: int, data: bytes, stamp_ns: int, sequence: int) -> None:
        """Append a message to the chunk."""
        head = _MESSAGE.pack(_MESSAGE_CODE, _HEAD_BYTES + len(data), channel, sequence, log_ns, stamp_ns)
        record = head + data
        self._parts.append(record)
        self._offsets.append(self._held)
        self._held += len(record)
        if self._held > self._chunk_bytes:
            self.flush()

    def _hold(self, record: bytes) -> None:
        self._parts.append(record)
        self._held += len(record)

    def flush(self) -> None:
        """End the chunk and write it with its message indexes; nothing where it has no message yet."""
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
        written = _bytes(chunk)
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
        self._chunk_index += _bytes(index)
        self._begin_ns = min(self._begin_ns, chunk.message_start_time)
        self._end_ns = max(self._end_ns, chunk.message_end_time)
        for number, n in zip(*np.unique(heads["channel"], return_counts=True), strict=True):
            self._counts[int(number)] += int(n)
        self._parts, self._offsets, self._held = [], [], 0

    def finish(self) -> None:
        """Write the last chunk and the end of the file: summary and footer."""
        self.flush()
        end = _bytes(DataEnd(0))
        start = self._stream.tell() + len(end)
        summary, offsets = b"", b""
        for group in (
            self._schemas, self._channels, _bytes(self._statistics()),
            self._chunk_index, self._attachment_index, self._metadata_index,
        ):  # fmt: skip
            if group:
                at = start + len(summary)
                offsets += _bytes(SummaryOffset(group_opcode=group[0], group_start=at, group_length=len(group)))
            summary += group
        offset_start = start + len(summary)
        footed = _FOOTER.pack(Opcode.FOOTER, 20, start, offset_start)
        footer = Footer(
            summary_start=start,
            summary_offset_start=offset_start,
            summary_crc=zlib.crc32(summary + offsets + footed),
        )
        self._stream.write(end + summary + offsets + _bytes(footer) + MCAP0_MAGIC)

    def _statistics(self) -> Statistics:
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
    """The message index records of a chunk, one a channel, and where each begins when the first stands at `at`."""
    order = np.argsort(channels, kind="stable")
    entries = np.stack((times[order], offsets[order].astype(np.uint64)), axis=1).astype("<u8")
    numbers, firsts = np.unique(channels[order], return_index=True)
    out, places = bytearray(), dict[int, int]()
    for number, begin, end in zip(numbers, firsts, [*firsts[1:], len(order)], strict=True):
        data = entries[begin:end].tobytes()
        places[int(number)] = at + len(out)
        out += _INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(data), number, len(data)) + data
    return bytes(out), places


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    written: bytes = builder.end()  # type: ignore[no-untyped-call]
    return written
