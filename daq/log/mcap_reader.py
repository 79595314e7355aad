"""Reader of one MCAP file: messages of selected channels and times, a few chunks at a time.

A chunk is a compressed group of messages, a channel the number of a topic in the file. The summary at the end of the
file contains the positions of the chunks. The summary is used if its checksum is right and if its records cover the
whole file. Otherwise the file is read once from beginning to end; the log of a killed run has no summary. Damaged parts
are skipped and reported. The reader trusts no length in the file: the size of the file and fixed limits bound every
record, and a chunk is used only if its checksum is right. Source: MCAP specification 0 (mcap.dev/spec).
"""

from __future__ import annotations

import contextlib
import os
import stat
import struct
import zlib
from array import array
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import TypeVar

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, Channel, Header, Metadata, MetadataIndex, Schema, Statistics
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from seatrial.daq.errors import SeatrialError, counted, printable
from seatrial.daq.log.mcap_chunk import (
    CHUNK_HEAD,
    CHUNK_NAME,
    DAMAGE,
    HEADER,
    INDEX_HEAD,
    MAX_CHUNK_BYTES,
    RECORD,
    Buffer,
    Messages,
    Offsets,
    chunk_at,
    index_entries,
    rows_at,
    scan,
    unpack_chunk,
    unpack_cut,
)

BATCH_BYTES = 4 * 2**20  # uncompressed chunks read at a time
CACHE_BYTES = 24 * 2**20  # uncompressed chunks kept for the next table
MAX_HELD_BYTES = 64 * 2**20  # bytes of attachments, metadata, schemas and channels of a file together
MAX_NAME_CHARACTERS = 2**16  # characters of a name; a longer name is an error
MAX_UNPACKED_BYTES = 2**28  # uncompressed bytes of all chunks together; a larger file may have more:
MAX_RATIO = 256  # uncompressed bytes of all chunks over the size of the file
MAX_WARNINGS = 20
FEW_MESSAGES = 2_000_000  # allowed for a file of any size
LAST_NS = 2**64 - 1
_BLOCK = 2**20
_ZSTD = b"\x04\0\0\0zstd"  # bytes of every zstd chunk at the offset CHUNK_NAME
_END = struct.Struct("<BQQQI8s")  # footer and magic
_END_CHECKED = 25  # bytes of the footer that its checksum covers
_DATA_END = HEADER + 4
# A chunk: its record lies at `at` .. `stop`, its message indexes follow; the rest is from its index record.
_CHUNK = np.dtype(
    [(name, "i8") for name in ("at", "stop", "index_bytes", "size")] + [("begin_ns", "u8"), ("end_ns", "u8")]
)
_CHUNK_INDEX = np.dtype(  # a chunk index record up to the offsets of the message indexes
    {
        "names": ["begin_ns", "end_ns", "at", "length", "n_map"],
        "formats": ["<u8", "<u8", "<i8", "<i8", "<u4"],
        "offsets": [9, 17, 25, 33, 41],
        "itemsize": 45,
    }
)
_KEPT = {  # records that are kept in memory
    Opcode.HEADER: Header, Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel,
    Opcode.ATTACHMENT: Attachment, Opcode.METADATA: Metadata,
}  # fmt: skip
Record = TypeVar("Record")
Chunks = NDArray[np.void]


class RawLog:
    """One MCAP file with its channels, schemas, metadata, attachments and warnings. `read` yields its messages.

    A channel is one topic of the file, and a schema the definition of a message type. Messages are stored in chunks
    (compressed groups).

    Attributes
    ----------
    path
        The file.
    warnings
        Faults of the parts that were read so far, one line each, at most 21. `verify` reads the other parts.
    complete
        Whether the file has its footer, the last record of a file that was closed.
    profile
        Profile in the header of the file, such as "ros2".
    channels, schemas
        Channel and schema records by number.
    metadata, attachments
        Metadata and attachment records of the file, except damaged ones. A record is also left out if all kept records
        together, schemas and channels included, would then be larger than 64 MiB (MAX_HELD_BYTES).
    counts
        Number of messages of each channel, by number of the channel. Channels without messages are absent.
    span_ns
        Smallest and largest log time of the messages [ns since 1970]; None if there is no message.

    Raises
    ------
    SeatrialError
        If the file cannot be read, is empty or is no MCAP file.
    """

    def __init__(self, path: Path, growing: bool = False) -> None:
        """Open an MCAP file and read its index, from its summary or, without a valid one, from all its records.

        With `growing`, a record that is cut off at the end of the file is not read yet: `extend` reads it when it is
        whole. Raise SeatrialError if the file cannot be read, is empty or is no MCAP file.
        """
        self.path = path
        self._growing = growing
        self._read_to = 0  # byte of the file at which the search for records stopped
        self.warnings: list[str] = []
        self.complete = False  # whether the file has its footer
        self.profile = ""
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.metadata: list[Metadata] = []
        self.attachments: list[Attachment] = []
        self.counts: Counter[int] = Counter()  # messages by channel
        self.span_ns: tuple[int, int] | None = None  # log times of the first and the last message
        self._held_bytes = 0
        self._chunks: Chunks = np.zeros(0, _CHUNK)
        # Pairs of chunk and channel from the message indexes, and a mask of the chunks without message indexes.
        self._chunk_channels: tuple[NDArray[np.int32], NDArray[np.uint16]] = (
            np.zeros(0, np.int32),
            np.zeros(0, np.uint16),
        )
        self._unindexed: NDArray[np.bool_] = np.zeros(0, bool)
        self._partial: Buffer | None = None  # the last chunk, if the file contains only its beginning
        self._seen: NDArray[np.int8] = np.zeros(0, np.int8)  # by chunk: 0 not read, 1 read, -1 damaged or left out
        self._cache: dict[int, tuple[Buffer, bytes]] = {}
        self._cached = 0
        self._fd, self._size, self._same = self._open()
        if not self._read_summary():
            self._read_records()
        elif (n := self._bound_chunks()) < len(self._chunks):
            self._seen[n:] = -1

    def _open(self) -> tuple[int, int, tuple[int, int]]:
        """Open the MCAP file. Raise SeatrialError if it cannot be read, is not regular, is empty or is no MCAP file.

        Returns
        -------
        tuple
            File descriptor, size of the file [bytes], and the pair of device and inode, which identifies the file.
        """
        # Plain reads, no mmap: the file may still grow, and a failing disk must cause an error message, not a signal.
        try:
            fd = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK)  # without O_NONBLOCK a named pipe waits for a writer
            about = os.fstat(fd)
            if not stat.S_ISREG(about.st_mode):
                os.close(fd)
                raise SeatrialError(f"{self.path}: is not a file; give the path of a log")
            magic, size = os.read(fd, len(MCAP0_MAGIC)), about.st_size
        except OSError as error:
            raise SeatrialError(
                f"{self.path}: cannot be read: {error.strerror}; check its path and permissions"
            ) from error
        if magic != MCAP0_MAGIC:
            os.close(fd)
            if not magic:
                raise SeatrialError(
                    f"{self.path}: the file is empty, so there is nothing to read or recover; give another log"
                )
            if Path(self.path).suffix.lower() == ".toml":
                raise SeatrialError(f"{self.path}: a TOML file and not a log; check the order of the arguments")
            raise SeatrialError(f"{self.path}: not an MCAP log; use `seatrial import` for logs of other formats")
        return fd, size, (about.st_dev, about.st_ino)

    def _read(self, start: int, stop: int) -> bytes:
        """Return the bytes `start` to `stop` of the MCAP file; fewer bytes if the file is shorter now.

        `stop` itself is not included. A closed file is opened again.

        Raises
        ------
        SeatrialError
            If the disk fails, or if a closed file cannot be opened again or was replaced by another file.
        """
        if self._fd < 0:
            self._fd, _, same = self._open()
            if same != self._same:
                raise SeatrialError(f"{self.path}: the file was replaced while it was read; run the command again")
        try:
            return os.pread(self._fd, max(stop - start, 0), start)
        except OSError as error:
            raise SeatrialError(
                f"{self.path}: cannot be read at byte {start}: {error.strerror}; check the disk"
            ) from error

    @property
    def files(self) -> list[RawLog]:
        """List of this MCAP file alone; a log of several segments has more files."""
        return [self]

    def close(self) -> None:
        """Close the MCAP file and free the uncompressed chunks. A later read opens the file again."""
        self._cache.clear()
        self._cached = 0
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def __del__(self) -> None:
        """Close the MCAP file if it is still open."""
        if getattr(self, "_fd", -1) >= 0:
            self.close()

    def read(
        self, channels: Collection[int] | None = None, begin_ns: int = 0, end_ns: int = LAST_NS
    ) -> Iterator[Messages]:
        """Yield the messages of some channels and log times in file order, a few chunks (groups of messages) at a time.

        A yielded batch may be empty. A chunk that cannot have such messages by its index is not read. Damaged chunks
        are left out, with one warning each. If the read chunks have far more messages than a real log of this size, the
        rest is left out, with a warning.

        Parameters
        ----------
        channels
            Numbers of the channels; None for all channels. A number that the file lacks is ignored.
        begin_ns, end_ns
            Interval of log times [ns since 1970], without `end_ns` itself. The default includes all times.
        """
        ids = np.fromiter(self.channels if channels is None else channels, np.uint16)
        n_found = 0
        for part in self._batches(self._chunks_to_read(ids, begin_ns, end_ns)):
            batch = self._read_messages(part, _ignore)
            n_found += len(batch.offsets)
            number, t = batch.heads["channel"], batch.heads["log_ns"]
            selected = number == ids[0] if len(ids) == 1 else np.isin(number, ids)
            yield batch.where(selected & (t >= begin_ns) & ((t < end_ns) | (end_ns == LAST_NS)))
            if self._has_too_many_messages(n_found):
                return

    def _bound_chunks(self) -> int:
        """Return how many chunks of the MCAP file, from the first on, may be decompressed. Warn if it is not all.

        Compression reduces the data of instruments by a factor of some tens at most. Therefore the uncompressed chunks
        together may have at most 256 MiB or 256 times the size of the file, whichever is more. A file with more would
        only cost time.
        """
        total = np.cumsum(np.minimum(self._chunks["size"], MAX_CHUNK_BYTES))
        n = int(np.searchsorted(total, max(MAX_UNPACKED_BYTES, MAX_RATIO * self._size), side="right"))
        if n < len(self._chunks):
            size = f"{total[-1] / 1e9:.1f} GB, {total[-1] / self._size:.0f} times the size of the file"
            self._warn(f"the uncompressed chunks have {size}, far more than a real log: the last chunks are left out")
        return n

    def _has_too_many_messages(self, n_messages: int) -> bool:
        """Return whether this number of messages is too large for a real log of this file's size, and warn if so.

        It is too large if it is above 2 million and above the number of bytes of the file.
        """
        if n_messages <= max(FEW_MESSAGES, self._size):  # a real message takes at least one compressed byte
            return False
        self._warn(f"more messages than a real log of its size has ({self._size} bytes): the rest is left out")
        return True

    def verify(self, begin_ns: int = 0, end_ns: int = LAST_NS) -> None:
        """Read the unread chunks of the file in an interval of log times [ns since 1970], to complete `warnings`.

        Chunks that overlap the interval, both ends included, are read. The messages are not returned.
        """
        inside = (self._chunks["end_ns"] >= begin_ns) & (self._chunks["begin_ns"] <= end_ns)
        for number in np.flatnonzero(inside & (self._seen == 0)).tolist():
            with contextlib.suppress(*DAMAGE):
                self._read_chunk(number)

    def _chunks_to_read(self, ids: NDArray[np.uint16], begin_ns: int, end_ns: int) -> Offsets:
        """Return the numbers of the chunks that may have messages of some channels and log times, shape (n,).

        The numbers ascend, as in the file. `ids` are the numbers of the channels. A chunk counts if its span of log
        times [ns since 1970] overlaps the interval from `begin_ns` to `end_ns`, both ends included. A chunk without
        message indexes may have messages of all channels. Chunks that are left out, or that an earlier read has found
        damaged, do not count.
        """
        chunk, channel = self._chunk_channels
        wanted = self._unindexed.copy()
        wanted[chunk[np.isin(channel, ids)]] = True
        wanted &= (self._chunks["end_ns"] >= begin_ns) & (self._chunks["begin_ns"] <= end_ns) & (self._seen >= 0)
        return np.flatnonzero(wanted)

    def _batches(self, numbers: Offsets) -> Iterator[list[int]]:
        """Split the numbers of chunks, shape (n,), into lists of chunks to read together.

        The order is kept. The chunks of a list have up to about 4 MiB of uncompressed data (BATCH_BYTES); a list with a
        larger chunk has more. No list is empty.
        """
        group = np.cumsum(self._chunks["size"][numbers]) // BATCH_BYTES
        for part in np.split(numbers, np.flatnonzero(np.diff(group)) + 1):
            if len(part):
                yield part.tolist()

    def _read_messages(self, numbers: list[int], register: Callable[[int, bytes], None]) -> Messages:
        """Return the messages of the chunks with these numbers. Chunks that `_read_chunk` cannot return are left out.

        Opcode and content of schemas and channels in the chunks are passed to `register`. The result has no messages if
        all chunks are left out.
        """
        chunks = []
        for number in numbers:
            with contextlib.suppress(*DAMAGE):
                chunks.append(self._read_chunk(number))
        return scan(chunks or [(np.zeros(0, np.uint8), b"")], register)

    def _read_chunk(self, number: int) -> tuple[Buffer, bytes]:
        """Return the uncompressed bytes of the chunk with this number, and the entries of its message indexes as bytes.

        Messages outside any chunk also have a number, and their bytes are returned. The result may be kept in memory
        for the next call.

        Raises
        ------
        ValueError, or another error in DAMAGE (errors that damaged bytes cause)
            If the chunk is damaged or was left out. When a chunk is found damaged for the first time, a warning is
            added.
        """
        if number in self._cache:
            return self._cache[number]
        if self._seen[number] < 0:
            raise ValueError("this chunk is left out")
        at, stop, index_bytes = (int(self._chunks[name][number]) for name in ("at", "stop", "index_bytes"))
        if self._partial is not None and number == len(self._chunks) - 1:
            self._seen[number] = 1
            return self._partial, b""
        try:
            # Of a chunk that is too large only the head is read, which is enough to reject it.
            too_large = stop - at > 2 * MAX_CHUNK_BYTES
            data = self._read(at, at + CHUNK_HEAD if too_large else stop + min(index_bytes, MAX_CHUNK_BYTES))
            opcode, length = RECORD.unpack_from(data)
            if opcode == Opcode.MESSAGE:  # messages outside any chunk
                found = np.frombuffer(data[: stop - at], np.uint8), b""
            elif opcode != Opcode.CHUNK or at + HEADER + length != stop:
                raise ValueError("the record is not a chunk")
            else:
                chunk = chunk_at(data[HEADER : HEADER + CHUNK_HEAD], at + HEADER, stop)
                packed = memoryview(data)[chunk.start - at : stop - at]
                found = unpack_chunk(packed, chunk), index_entries(data, stop - at)
        except DAMAGE as error:
            if self._seen[number] >= 0:
                self._warn(f"the chunk at byte {at} is damaged and left out ({_error_line(error)})")
            self._seen[number] = -1
            raise
        self._seen[number] = 1
        if self._cached + found[0].nbytes <= CACHE_BYTES:
            self._cache[number] = found
            self._cached += found[0].nbytes
        return found

    def _read_summary(self) -> bool:
        """Read the index of the MCAP file from the summary at its end. Return True if the index was read.

        Return False, and use nothing, if the file has no usable summary: for example, if the summary has no checksum,
        is damaged, or does not cover the whole file. The caller then reads all records instead.
        """
        size = self._size
        try:
            opcode, length, start, _, checksum, magic = _END.unpack(self._read(max(0, size - _END.size), size))
            stop = size - _END.size
            if (opcode, length, magic) != (Opcode.FOOTER, 20, MCAP0_MAGIC) or not (checksum and 0 < start <= stop):
                return False
            if self._checksum(start, stop + _END_CHECKED) != checksum:
                return False
            return self._use_summary(_Summary(self._read, start, stop))
        except DAMAGE:
            return False

    def _checksum(self, start: int, stop: int) -> int:
        """Return the CRC-32 of the bytes `start` to `stop` of the MCAP file, without `stop` itself.

        The bytes are read in blocks of 1 MiB.
        """
        checksum = 0
        for at in range(start, stop, _BLOCK):
            checksum = zlib.crc32(self._read(at, min(at + _BLOCK, stop)), checksum)
        return checksum

    def _use_summary(self, summary: _Summary) -> bool:
        """Use a decoded summary as the index of the MCAP file, and return True.

        Chunks, channels, schemas, counts, span of log times, attachments, metadata and the profile of the header are
        stored, and `complete` becomes True. A damaged header, attachment or metadata record is left out, with a
        warning. False is returned, and nothing stored, if the summary does not cover the whole file, if its chunks
        overlap, or if its statistics are missing or have other numbers of chunks or channels.
        """
        chunks, statistics = summary.chunks, summary.statistics
        if statistics is None or (statistics.chunk_count, statistics.channel_count) != (
            len(chunks),
            len(summary.channels),
        ):
            return False
        opcode, length = RECORD.unpack(self._read(len(MCAP0_MAGIC), len(MCAP0_MAGIC) + HEADER))
        first = len(MCAP0_MAGIC) + HEADER + length
        ends = chunks["stop"] + chunks["index_bytes"]
        parts = int((ends - chunks["at"]).sum()) + sum(length for _, length in summary.records)
        if opcode != Opcode.HEADER or first + parts + _DATA_END != summary.start:
            return False  # the file has bytes that the summary does not cover
        if np.any(chunks["at"] < first) or np.any(chunks["at"][1:] < ends[:-1]) or np.any(ends > summary.start):
            return False
        self._chunks, self._chunk_channels, self._unindexed = chunks, summary.chunk_channels, summary.unindexed
        self._seen = np.zeros(len(chunks), np.int8)
        for kind, data in [*summary.schemas, *summary.channels]:
            self._keep_definition(kind, data)
        self.counts.update({k: n for k, n in statistics.channel_message_counts.items() if k in self.channels and n})
        self.span_ns = (statistics.message_start_time, statistics.message_end_time) if self.counts else None
        for at, length in [(len(MCAP0_MAGIC), first - len(MCAP0_MAGIC)), *summary.records]:
            try:
                opcode, content = RECORD.unpack(self._read(at, at + HEADER))
                if content != length - HEADER:
                    raise ValueError("the record has a wrong length")
                self._keep_record(opcode, at, at + length)
            except DAMAGE as error:
                self._warn(f"the record at byte {at} is damaged and left out ({_error_line(error)})")
        self.complete = True
        return True

    def _read_records(self) -> None:
        """Build the index of an MCAP file without a valid summary: read all its records in order, and then its chunks.

        After an unknown opcode or a length beyond the file, the search continues at the next whole zstd chunk. If only
        the content of a record is damaged, only this record is left out. The first footer ends the search. Messages
        without a channel record are not counted. All these faults cause warnings. A missing footer causes one too, but
        not in a growing file. If the file is undamaged but has no footer, chunks with message indexes are usually
        counted by them and not read here.
        """
        whole = self._find_records(found := _FoundChunks(), len(MCAP0_MAGIC))
        self._chunks, self._seen = found.chunks(), np.zeros(len(found.at), np.int8)
        self._seen[self._bound_chunks() :] = -1
        # Only chunks have a checksum: channel records in chunks replace channel records outside of chunks.
        channels, schemas, self.channels, self.schemas = self.channels, self.schemas, {}, {}
        self._count_messages(found, only_new=whole and not self.complete)
        self.channels, self.schemas = {**channels, **self.channels}, {**schemas, **self.schemas}
        if lost := sum(n for channel, n in self.counts.items() if channel not in self.channels):
            self._warn(f"left out: {counted(lost, 'message')} whose channel record is damaged or missing")
        self.counts = Counter({channel: n for channel, n in self.counts.items() if channel in self.channels})

    def extend(self) -> bool:
        """Add the whole records that were appended to a file since it was opened as `growing`, or since the last call.

        Return whether there were any. The result is False, and the file is not read, if it is complete or was not
        opened as `growing`. Raise SeatrialError if the file was closed since (`close`) and another file has replaced
        it.
        """
        if self.complete or not self._growing:
            return False
        self._read(0, 0)  # opens a closed file again
        self._size = os.fstat(self._fd).st_size
        before, found = self._read_to, _FoundChunks()
        self._find_records(found, before)
        n, self._chunks = len(self._chunks), np.concatenate([self._chunks, found.chunks()])
        self._seen = np.concatenate([self._seen, np.zeros(len(found.at), np.int8)])
        self._seen[self._bound_chunks() :] = -1
        self._count_messages(found, only_new=True, first=n)
        return self._read_to > before

    def _find_records(self, found: _FoundChunks, at: int) -> bool:
        """Read the records of the file in order from byte `at` on, and add its chunks to `found`.

        Header, schema, channel, attachment and metadata records are kept (`_keep_record`). `_read_to` becomes the byte
        at which the search stops. Return whether no part was damaged; a cut end is no damage.
        """
        whole, size = True, self._size
        while at + HEADER <= size:
            opcode, length = RECORD.unpack(self._read(at, at + HEADER))
            stop = at + HEADER + length
            unknown = opcode == 0 or max(Opcode) < opcode < 0x80  # opcodes from 0x80 on are application records
            if self._growing and not unknown and stop > size:
                break  # the rest of this record may follow
            if unknown or stop > size:
                again = self._next_chunk(at + 1)
                if again is None:
                    whole &= self._read_cut_end(opcode, at, unknown, found)
                    break
                self._warn(f"damaged at byte {at}: {again - at} bytes are left out")
                at, whole = again, False
                continue
            try:
                if not found.add(opcode, at, stop, self._read(at, min(stop, at + HEADER + CHUNK_HEAD))):
                    self._keep_record(opcode, at, stop)
            except DAMAGE as error:
                self._warn(f"the record at byte {at} is damaged and left out ({_error_line(error)})")
                whole = False
            at = stop
            if opcode == Opcode.FOOTER:
                self.complete = True
                break
        else:
            if not self._growing:
                self._warn("the recording was cut off or still goes on (no footer): everything up to there is used")
        self._read_to = at
        return whole

    def _count_messages(self, found: _FoundChunks, only_new: bool, first: int = 0) -> None:
        """Read the chunks of the MCAP file to count the messages of each channel and to find the channels.

        `found` has the chunks with their message indexes; the first of them has the number `first`. With `only_new`, a
        chunk is not read if it has message indexes and they contain only channels that are known already; its messages
        are counted by the indexes. The last chunk is always read, because it may be cut. If the file has too many
        messages, the remaining chunks are left out, with a warning.
        """
        self._unindexed = np.append(self._unindexed[:first], np.ones(len(self._chunks) - first, bool))
        pairs: tuple[list[int], list[int]] = ([], [])
        waiting: list[int] = []
        n_bytes = 0
        for number in range(first, len(self._chunks)):
            # The last chunk is always read, because it may be cut.
            indexed = found.counts[number - first] if only_new and number + 1 < len(self._chunks) else {}
            if indexed and not waiting and all(channel in self.channels for channel in indexed):
                self._unindexed[number] = False
                pairs[0].extend([number] * len(indexed))
                pairs[1].extend(indexed)
                self.counts.update(indexed)
                self._extend_span(*(int(self._chunks[name][number]) for name in ("begin_ns", "end_ns")))
                continue
            waiting.append(number)
            n_bytes += int(self._chunks["size"][number])
            if only_new or number + 1 == len(self._chunks) or n_bytes > BATCH_BYTES:
                heads = self._read_messages(waiting, self._keep_definition).heads
                waiting, n_bytes = [], 0
                for channel, n in zip(*np.unique(heads["channel"], return_counts=True), strict=True):
                    self.counts[int(channel)] += int(n)
                if len(heads):
                    self._extend_span(int(heads["log_ns"].min()), int(heads["log_ns"].max()))
                if self._has_too_many_messages(self.counts.total()):
                    self._seen[number + 1 :] = -1
                    break
        chunks, channels = self._chunk_channels
        self._chunk_channels = (
            np.append(chunks, np.asarray(pairs[0], np.int32)),
            np.append(channels, np.asarray(pairs[1], np.uint16)),
        )

    def _extend_span(self, begin_ns: int, end_ns: int) -> None:
        """Extend the span of log times of the file (`span_ns`) so that it includes an interval [ns since 1970]."""
        before = self.span_ns or (begin_ns, end_ns)
        self.span_ns = min(before[0], begin_ns), max(before[1], end_ns)

    def _next_chunk(self, at: int) -> int | None:
        """Return the position [bytes] of the next complete zstd chunk at or after byte `at` of the file; None if none.

        A chunk that begins up to 37 bytes before `at` is found too. The reader calls this method after a damaged place,
        so that the chunks behind the damage are still read.
        """
        while at < self._size:
            block = self._read(at, at + _BLOCK)
            place = block.find(_ZSTD)
            while place >= 0:
                start = at + place - CHUNK_NAME
                with contextlib.suppress(*DAMAGE):
                    opcode, length = RECORD.unpack(self._read(max(start - HEADER, 0), start))
                    chunk_at(self._read(start, start + CHUNK_HEAD), start, start + length)
                    if opcode == Opcode.CHUNK and start + length <= self._size:
                        return start - HEADER
                place = block.find(_ZSTD, place + 1)
            at += _BLOCK - len(_ZSTD)
        return None

    def _read_cut_end(self, opcode: int, at: int, unknown: bool, found: _FoundChunks) -> bool:
        """Read what can be read of a record of the MCAP file after which no whole zstd chunk follows, and warn.

        Of a cut chunk, the existing zstd blocks, or data without compression, are added to `found`, because they may
        contain messages. A cut record of another kind, and a cut chunk with lz4 or with damaged data, are left out.

        Parameters
        ----------
        opcode, at
            Opcode of the record, and its byte in the file.
        unknown
            Whether the opcode is invalid. The rest of the file is then damaged and left out.
        found
            List of the chunks so far.

        Returns
        -------
        bool
            False if the opcode is invalid, so that the file is damaged; True otherwise.
        """
        if unknown:
            self._warn(f"damaged at byte {at}: the rest of the file is left out")
            return False
        self._warn("the recording was cut off inside a record: everything up to there is used")
        start = at + HEADER
        with contextlib.suppress(*DAMAGE):
            if opcode == Opcode.CHUNK:
                chunk = chunk_at(self._read(start, start + CHUNK_HEAD), start, self._size, cut=True)
                self._partial = unpack_cut(
                    self._read(chunk.start, min(chunk.stop, chunk.start + MAX_CHUNK_BYTES)), chunk
                )
                found.append(at, self._size, len(self._partial), 0, LAST_NS)
        return True

    def _keep_record(self, opcode: int, at: int, stop: int) -> None:
        """Decode and keep the record at the bytes `at` to `stop` if it describes the file or contains an attachment.

        These are header, schema, channel, attachment and metadata records; others are ignored. If the kept records
        together would be larger than 64 MiB, the record is left out with a warning.

        Raises
        ------
        ValueError, or another error in DAMAGE (errors that damaged bytes cause)
            If the record is damaged. A damaged schema or channel only causes a warning.
        """
        if opcode not in _KEPT:
            return
        if self._held_bytes + (stop - at) > MAX_HELD_BYTES:
            kind = _KEPT[Opcode(opcode)].__name__.lower()
            size, limit = f"{(stop - at) / 1e6:.0f} MB", f"{MAX_HELD_BYTES / 1e6:.0f} MB"
            self._warn(f"{kind} at byte {at} is left out: {size}, and a log has at most {limit} beside its messages")
            return
        self._held_bytes += stop - at
        data = self._read(at + HEADER, stop)
        if opcode in (Opcode.CHANNEL, Opcode.SCHEMA):
            self._keep_definition(opcode, data)
        elif opcode == Opcode.ATTACHMENT:
            (checksum,) = struct.unpack_from("<I", data, len(data) - 4)
            if checksum not in (0, zlib.crc32(memoryview(data)[:-4])):
                raise ValueError("the attachment has a wrong checksum")
            found = _parse(Attachment.read, data)
            _check_name(found.name)
            self.attachments.append(replace(found, name=printable(found.name)))
        elif opcode == Opcode.METADATA:
            about = _parse(Metadata.read, data)
            texts = {printable(key): printable(value) for key, value in about.metadata.items()}
            self.metadata.append(replace(about, metadata=texts))
        elif opcode == Opcode.HEADER:
            self.profile = _parse(Header.read, data).profile

    def _keep_definition(self, opcode: int, data: bytes) -> None:
        """Decode and keep a schema or channel record of the file by its opcode and content. Warn if it is damaged.

        The record replaces an earlier record of the same number. It is left out without a warning if the kept records
        would be larger than 64 MiB.
        """
        try:
            if opcode == Opcode.SCHEMA:
                schema = _parse(Schema.read, data)
                _check_name(schema.name)
                if schema.id not in self.schemas:
                    self._held_bytes += len(data)
                if self._held_bytes <= MAX_HELD_BYTES:
                    self.schemas[schema.id] = replace(schema, name=printable(schema.name))
            else:
                channel = _parse(Channel.read, data)
                _check_name(channel.topic)
                if channel.id not in self.channels:
                    self._held_bytes += len(data)
                if self._held_bytes <= MAX_HELD_BYTES:
                    about = {printable(key): printable(value) for key, value in channel.metadata.items()}
                    self.channels[channel.id] = replace(channel, topic=printable(channel.topic), metadata=about)
        except DAMAGE as error:
            self._warn(f"a schema or channel is damaged and left out ({_error_line(error)})")

    def _warn(self, text: str) -> None:
        """Add a warning about the file to `warnings`; the text has no path.

        Only the first 20 warnings are kept (MAX_WARNINGS). In place of the 21st, one line reports that there are more;
        later ones are dropped.
        """
        if len(self.warnings) < MAX_WARNINGS:
            self.warnings.append(text)
        elif len(self.warnings) == MAX_WARNINGS:
            self.warnings.append("and more warnings of this kind")


class _FoundChunks:
    """List of the chunks that are found when an MCAP file is read from beginning to end.

    Messages that follow each other outside any chunk are one item of the list, like a chunk.

    Attributes
    ----------
    at : array of int
        Position of each chunk record in the file [bytes].
    counts : list of dict of int to int
        Number of messages by channel, for each chunk, from its message indexes.
    """

    def __init__(self) -> None:
        """Begin with an empty list of chunks (groups of messages of an MCAP file)."""
        self.at, self._stop, self._index_bytes, self._size = (array("q") for _ in range(4))
        self._begin_ns, self._end_ns = array("Q"), array("Q")
        self.counts: list[dict[int, int]] = []  # for each chunk: messages by channel, from its message indexes
        self._plain = False  # whether the last item is a row of messages outside any chunk

    def append(self, at: int, stop: int, size: int, begin_ns: int, end_ns: int) -> None:
        """Append a chunk to the list: the bytes `at` to `stop` of its record in the file, its size, and its log times.

        The size is that of the uncompressed data [bytes]. `begin_ns` and `end_ns` are the smallest and the largest log
        time of its messages [ns since 1970]. The chunk has no message index yet.
        """
        columns = (self.at, self._stop, self._index_bytes, self._size, self._begin_ns, self._end_ns)
        for column, value in zip(columns, (at, stop, 0, size, begin_ns, end_ns), strict=True):
            column.append(value)
        self.counts.append({})

    def add(self, opcode: int, at: int, stop: int, head: bytes) -> bool:
        """Add a record of an MCAP file to the list, if it is a chunk, a message, or a message index of the last chunk.

        Messages outside any chunk that follow each other become one item, until it has 1 MiB or more.

        Parameters
        ----------
        opcode
            Kind of the record.
        at, stop
            Bytes of the file between which the record lies.
        head
            First bytes of the record.

        Returns
        -------
        bool
            True if the record is a chunk, a message or a message index. It is True also for a message index that does
            not follow the last chunk and its indexes, although this one is not added. False for all other records.

        Raises
        ------
        ValueError, or another error in DAMAGE (errors that damaged bytes cause)
            If the header of a chunk is invalid, or an added message index is shorter than its channel number (2 bytes).
        """
        if opcode == Opcode.CHUNK:
            found = chunk_at(head[HEADER:], at + HEADER, stop)
            self.append(at, stop, found.size, *struct.unpack_from("<QQ", head, HEADER))
        elif opcode == Opcode.MESSAGE and self._plain and self._stop[-1] == at and self._size[-1] < _BLOCK:
            self._stop[-1], self._size[-1] = stop, stop - self.at[-1]
        elif opcode == Opcode.MESSAGE:
            self.append(at, stop, stop - at, 0, LAST_NS)
        elif opcode == Opcode.MESSAGE_INDEX and self.at and self._stop[-1] + self._index_bytes[-1] == at:
            self._index_bytes[-1] += stop - at
            (channel,) = struct.unpack_from("<H", head, HEADER)
            self.counts[-1][channel] = self.counts[-1].get(channel, 0) + (stop - at - HEADER - INDEX_HEAD) // 16
            return True
        else:
            return opcode == Opcode.MESSAGE_INDEX
        self._plain = opcode == Opcode.MESSAGE
        return True

    def chunks(self) -> Chunks:
        """Return all chunks of the list as an array with the columns of _CHUNK, shape (n,).

        The columns are positions in the file, sizes and log times.
        """
        table = np.zeros(len(self.at), _CHUNK)
        table["at"], table["stop"], table["index_bytes"] = self.at, self._stop, self._index_bytes
        table["size"], table["begin_ns"], table["end_ns"] = self._size, self._begin_ns, self._end_ns
        return table


class _Summary:
    """Decoded summary of an MCAP file: the positions of its chunks, attachments and metadata, and its channels.

    Parameters
    ----------
    read
        Function that returns the bytes of the file between two positions.
    start, stop
        Position of the summary in the file [bytes].

    Attributes
    ----------
    schemas, channels
        Opcode and content of each schema and channel record, not decoded.
    records
        Position and length [bytes] of each attachment and metadata record in the file.
    statistics
        Statistics record: numbers of records, chunks and messages, and first and last log time; None if there is none.
    chunks
        Positions, sizes and log times of the chunks, with the columns of _CHUNK, shape (n,).
    chunk_channels
        Pairs of chunk and channel with messages, as two arrays of shape (n_pairs,).
    unindexed
        Mask (n,) of the chunks without message indexes.

    Raises
    ------
    ValueError, or another error in DAMAGE (errors that damaged bytes cause)
        If a record of the summary is invalid or longer than 1 MiB.
    """

    def __init__(self, read: Callable[[int, int], bytes], start: int, stop: int) -> None:
        """Decode the summary of an MCAP file, at the bytes `start` to `stop` of the file.

        `read` returns the bytes of the file between two positions. Raise ValueError, or another error in DAMAGE (errors
        that damaged bytes cause), if a record is invalid.
        """
        self.start = start
        self.schemas: list[tuple[int, bytes]] = []
        self.channels: list[tuple[int, bytes]] = []
        self.records: list[tuple[int, int]] = []  # attachments and metadata: byte and length
        self.statistics: Statistics | None = None
        parts: list[tuple[Chunks, NDArray[np.int32], NDArray[np.uint16]]] = []
        at = start
        while at < stop:
            block = read(at, min(at + _BLOCK, stop))
            begins, ends, place = list[int](), list[int](), 0
            while place + HEADER <= len(block):
                opcode, length = RECORD.unpack_from(block, place)
                end = place + HEADER + length
                if end > len(block):
                    break
                if opcode == Opcode.CHUNK_INDEX:
                    begins.append(place)
                    ends.append(end)
                else:
                    self._add_record(opcode, block[place + HEADER : end])
                place = end
            if not place:
                raise ValueError("a record of the summary is too long")
            if begins:
                parts.append(_chunk_indexes(np.frombuffer(block, np.uint8), np.asarray(begins), np.asarray(ends)))
            at += place
        before = np.cumsum([0, *(len(chunks) for chunks, _, _ in parts)], dtype=np.int32)
        self.chunks = np.concatenate([np.zeros(0, _CHUNK), *(chunks for chunks, _, _ in parts)])
        self.chunk_channels = (
            np.concatenate([np.zeros(0, np.int32), *(k + n for (_, k, _), n in zip(parts, before, strict=False))]),
            np.concatenate([np.zeros(0, np.uint16), *(channel for _, _, channel in parts)]),
        )
        self.unindexed = np.ones(len(self.chunks), bool)  # chunks without an index
        self.unindexed[self.chunk_channels[0]] = False

    def _add_record(self, opcode: int, data: bytes) -> None:
        """Decode a record of an MCAP summary by its opcode and content, and store it.

        Stored are schemas, channels, statistics (of several the last), and the positions of attachments and metadata.
        Schemas and channels are not decoded yet. Records of other kinds are ignored. An error in DAMAGE (errors that
        damaged bytes cause) is raised if a decoded record is invalid.
        """
        if opcode == Opcode.SCHEMA:
            self.schemas.append((opcode, data))
        elif opcode == Opcode.CHANNEL:
            self.channels.append((opcode, data))
        elif opcode == Opcode.STATISTICS:
            self.statistics = _parse(Statistics.read, data)
        elif opcode == Opcode.ATTACHMENT_INDEX:
            attachment = _parse(AttachmentIndex.read, data)
            self.records.append((attachment.offset, attachment.length))
        elif opcode == Opcode.METADATA_INDEX:
            about = _parse(MetadataIndex.read, data)
            self.records.append((about.offset, about.length))


def _chunk_indexes(
    block: Buffer, begins: Offsets, ends: Offsets
) -> tuple[Chunks, NDArray[np.int32], NDArray[np.uint16]]:
    """Decode the chunk index records of an MCAP summary: position and times of each chunk, and its channels.

    Parameters
    ----------
    block
        Bytes of a part of the summary.
    begins, ends
        Offsets of the records in the block, shape (n,), at least one record. `ends` are the first bytes after them.

    Returns
    -------
    tuple
        Chunks, dtype _CHUNK, shape (n,); and pairs of chunk (by its position in this table) and channel, each with
        shape (n_pairs,).

    Raises
    ------
    ValueError
        If the lengths within a record do not agree, or if a length is negative.
    """
    shortest = _CHUNK_INDEX.itemsize + 8 + 4 + 8 + 8
    if np.any(ends - begins < shortest):
        raise ValueError("a chunk index has a wrong length")
    heads = rows_at(block, begins, _CHUNK_INDEX)
    n_map = heads["n_map"].astype(np.int64)
    if np.any(n_map % 10) or np.any(ends - begins < shortest + n_map):
        raise ValueError("a chunk index has a wrong length")
    found = np.zeros(len(begins), _CHUNK)
    for name in ("at", "begin_ns", "end_ns"):
        found[name] = heads[name]
    found["stop"] = heads["at"] + heads["length"]
    found["index_bytes"] = rows_at(block, begins + _CHUNK_INDEX.itemsize + n_map, np.dtype("<i8"))
    found["size"] = rows_at(block, ends - 8, np.dtype("<i8"))
    if min(heads["length"].min() - HEADER, found["index_bytes"].min(), found["size"].min()) < 0:
        raise ValueError("a chunk index has a negative length")
    chunk = np.repeat(np.arange(len(begins)), n_map // 10)
    k = np.arange(len(chunk)) - np.repeat(np.cumsum(n_map // 10) - n_map // 10, n_map // 10)
    channel = rows_at(block, begins[chunk] + _CHUNK_INDEX.itemsize + 10 * k, np.dtype("<u2"))
    return found, chunk.astype(np.int32), channel


def _check_name(name: str) -> None:
    """Raise ValueError if the name of a topic, message type or attachment in a log has more than 65,536 characters."""
    if len(name) > MAX_NAME_CHARACTERS:
        raise ValueError(f"a name of {len(name)} characters is too long")


def _ignore(opcode: int, data: bytes) -> None:
    """Ignore a schema or channel record in a chunk of a log, because all of them are known already.

    This is the function that `RawLog.read` passes to `scan`.
    """


def _parse(read: Callable[[ReadDataStream], Record], data: bytes) -> Record:
    """Decode the content of an MCAP record (`data`) by a function of the mcap package, and return the record.

    An error of this function is passed on.
    """
    return read(ReadDataStream(BytesIO(data)))


def _error_line(error: BaseException) -> str:
    """Return the text of an error about a damaged log as one line; the name of its class if it has no text."""
    return " ".join(str(error).split()) or type(error).__name__
