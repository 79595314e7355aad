"""An MCAP file read in pieces: the messages of some topics and times, some chunks at a time.

Where the chunks are stands in the summary at the end of the file. It is believed where its checksum holds and its parts
make up the whole file; otherwise (a killed run has none) the file is read once from front to back, and damaged parts
are skipped and reported. No length is believed: records are bounded by the file and by limits, and a chunk counts only
when its checksum holds. Source: MCAP specification 0 (mcap.dev/spec).
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
    MAX_CHUNK,
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
MAX_HELD = 64 * 2**20  # attachments, metadata, schemas and channels of a file, all together
MAX_TEXT = 2**16  # characters of a name; a longer one is no name
MAX_UNPACKED = 2**28  # bytes of all chunks together, that any file may have; else
MAX_RATIO = 256  # times its own bytes
MAX_WARNINGS = 20
FEW_MESSAGES = 2_000_000  # so many any file may have
LAST_NS = 2**64 - 1
_BLOCK = 2**20
_ZSTD = b"\x04\0\0\0zstd"  # what every zstd chunk has at CHUNK_NAME
_END = struct.Struct("<BQQQI8s")  # footer and magic
_END_CHECKED = 25  # bytes of the footer that its checksum covers
_DATA_END = HEADER + 4
_CHUNK = np.dtype(  # a chunk: its record at `at` .. `stop`, its indexes behind it, and what its index record says
    [(name, "i8") for name in ("at", "stop", "index_bytes", "size")] + [("begin_ns", "u8"), ("end_ns", "u8")]
)
_CHUNK_INDEX = np.dtype(  # up to the offsets of its message indexes
    {
        "names": ["begin_ns", "end_ns", "at", "length", "n_map"],
        "formats": ["<u8", "<u8", "<i8", "<i8", "<u4"],
        "offsets": [9, 17, 25, 33, 41],
        "itemsize": 45,
    }
)
_KEPT = {
    Opcode.HEADER: Header, Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel,
    Opcode.ATTACHMENT: Attachment, Opcode.METADATA: Metadata,
}  # fmt: skip
Record = TypeVar("Record")
Chunks = NDArray[np.void]


class RawLog:
    """A file: its channels, schemas, metadata, attachments and warnings; its messages by `read`.

    `warnings` are those of what was read so far, `verify` reads the rest. Raises SeatrialError where the file cannot
    be opened or is no MCAP at all.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.warnings: list[str] = []
        self.complete = False  # whether the file has its end
        self.profile = ""
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.metadata: list[Metadata] = []
        self.attachments: list[Attachment] = []
        self.counts: Counter[int] = Counter()  # messages by channel
        self.span_ns: tuple[int, int] | None = None  # log times of the first and the last message
        self._held = 0
        self._chunks: Chunks = np.zeros(0, _CHUNK)
        # Which channels a chunk has, by its message indexes: pairs; and the chunks that do not say.
        self._holds: tuple[NDArray[np.int32], NDArray[np.uint16]] = (np.zeros(0, np.int32), np.zeros(0, np.uint16))
        self._unknown: NDArray[np.bool_] = np.zeros(0, bool)
        self._partial: Buffer | None = None  # of the last chunk, where the file holds it in part
        self._seen: NDArray[np.int8] = np.zeros(0, np.int8)  # chunks that were read: 1, or -1 where damaged
        self._cache: dict[int, tuple[Buffer, bytes]] = {}
        self._cached = 0
        self._fd, self._size, self._same = self._open()
        if not self._believe_summary():
            self._walk()
        elif (n := self._bound_chunks()) < len(self._chunks):
            self._seen[n:] = -1

    def _open(self) -> tuple[int, int, tuple[int, int]]:
        # Plain reads, no mmap: the file may still be growing, and a disk that fails must end in a line, not a signal.
        try:
            fd = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK)  # a named pipe would wait for a writer
            about = os.fstat(fd)
            if not stat.S_ISREG(about.st_mode):
                os.close(fd)
                raise SeatrialError(f"{self.path}: is not a file")
            magic, size = os.read(fd, len(MCAP0_MAGIC)), about.st_size
        except OSError as error:
            raise SeatrialError(f"{self.path}: cannot be read: {error.strerror}") from error
        if magic != MCAP0_MAGIC:
            os.close(fd)
            if not magic:
                raise SeatrialError(f"{self.path}: the file is empty; there is nothing to recover")
            raise SeatrialError(f"{self.path}: not an MCAP log; foreign logs come in by `seatrial import`")
        return fd, size, (about.st_dev, about.st_ino)

    def _read(self, start: int, stop: int) -> bytes:
        """Bytes of the file; fewer where it has become shorter. Raises SeatrialError where the disk fails."""
        if self._fd < 0:
            self._fd, _, same = self._open()
            if same != self._same:
                raise SeatrialError(f"{self.path}: is another file than when it was opened")
        try:
            return os.pread(self._fd, max(stop - start, 0), start)
        except OSError as error:
            raise SeatrialError(f"{self.path}: cannot be read at byte {start}: {error.strerror}") from error

    @property
    def files(self) -> list[RawLog]:
        """This file alone; a log of several segments has more."""
        return [self]

    def close(self) -> None:
        """Let go of the file and of what was unpacked; it is opened again where more is read."""
        self._cache.clear()
        self._cached = 0
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def __del__(self) -> None:
        if getattr(self, "_fd", -1) >= 0:
            self.close()

    def read(
        self, channels: Collection[int] | None = None, begin_ns: int = 0, end_ns: int = LAST_NS
    ) -> Iterator[Messages]:
        """Messages in file order, some chunks at a time: of these channels (of all that are known), with log times from
        `begin_ns` to before `end_ns`. What can hold none of them is not read."""
        ids = np.fromiter(self.channels if channels is None else channels, np.uint16)
        n_found = 0
        for part in self._batches(self._choose(ids, begin_ns, end_ns)):
            found = self._messages(part, _ignore)
            n_found += len(found.offsets)
            number, t = found.heads["channel"], found.heads["log_ns"]
            these = number == ids[0] if len(ids) == 1 else np.isin(number, ids)
            yield found.where(these & (t >= begin_ns) & ((t < end_ns) | (end_ns == LAST_NS)))
            if self._too_many(n_found):
                return

    def _bound_chunks(self) -> int:
        """Return how many chunks from the first on may be unpacked, and warn where that is not all of them.

        The data of an instrument shrinks by a factor of some tens at most. A file that claims more only costs time.
        """
        total = np.cumsum(np.minimum(self._chunks["size"], MAX_CHUNK))
        n = int(np.searchsorted(total, max(MAX_UNPACKED, MAX_RATIO * self._size), side="right"))
        if n < len(self._chunks):
            whole = f"{total[-1] / 1e9:.1f} GB, {total[-1] / self._size:.0f} times the file"
            self._warn(f"its chunks unpack to {whole}, which no instrument writes: the last of them are left out")
        return n

    def _too_many(self, n_messages: int) -> bool:
        if n_messages <= max(FEW_MESSAGES, self._size):  # a message takes some bytes, however well it is packed
            return False
        self._warn(f"more messages than {self._size} bytes can hold in earnest: what follows is left out")
        return True

    def verify(self, begin_ns: int = 0, end_ns: int = LAST_NS) -> None:
        """Read what was not read yet, of chunks with these log times, for its warnings."""
        inside = (self._chunks["end_ns"] >= begin_ns) & (self._chunks["begin_ns"] <= end_ns)
        for number in np.flatnonzero(inside & (self._seen == 0)).tolist():
            with contextlib.suppress(*DAMAGE):
                self._chunk(number)

    def _choose(self, ids: NDArray[np.uint16], begin_ns: int, end_ns: int) -> Offsets:
        """Numbers of the whole chunks that may have messages of these channels and times."""
        chunk, channel = self._holds
        wanted = self._unknown.copy()
        wanted[chunk[np.isin(channel, ids)]] = True
        wanted &= (self._chunks["end_ns"] >= begin_ns) & (self._chunks["begin_ns"] <= end_ns) & (self._seen >= 0)
        return np.flatnonzero(wanted)

    def _batches(self, numbers: Offsets) -> Iterator[list[int]]:
        group = np.cumsum(self._chunks["size"][numbers]) // BATCH_BYTES
        for part in np.split(numbers, np.flatnonzero(np.diff(group)) + 1):
            if len(part):
                yield part.tolist()

    def _messages(self, numbers: list[int], register: Callable[[int, bytes], None]) -> Messages:
        """All messages of these chunks, without those that are damaged."""
        chunks = []
        for number in numbers:
            with contextlib.suppress(*DAMAGE):
                chunks.append(self._chunk(number))
        return scan(chunks or [(np.zeros(0, np.uint8), b"")], register)

    def _chunk(self, number: int) -> tuple[Buffer, bytes]:
        """The uncompressed bytes of a chunk and the entries of its indexes. Raises one of DAMAGE, and warns once."""
        if number in self._cache:
            return self._cache[number]
        if self._seen[number] < 0:
            raise ValueError("left out")
        at, stop, index_bytes = (int(self._chunks[name][number]) for name in ("at", "stop", "index_bytes"))
        if self._partial is not None and number == len(self._chunks) - 1:
            self._seen[number] = 1
            return self._partial, b""
        try:
            data = self._read(at, stop + min(index_bytes, MAX_CHUNK) if stop - at <= 2 * MAX_CHUNK else at + CHUNK_HEAD)
            opcode, length = RECORD.unpack_from(data)
            if opcode == Opcode.MESSAGE:  # without a chunk around it
                found = np.frombuffer(data[: stop - at], np.uint8), b""
            elif opcode != Opcode.CHUNK or at + HEADER + length != stop:
                raise ValueError("no chunk is there")
            else:
                chunk = chunk_at(data[HEADER : HEADER + CHUNK_HEAD], at + HEADER, stop)
                packed = memoryview(data)[chunk.start - at : stop - at]
                found = unpack_chunk(packed, chunk), index_entries(data, stop - at)
        except DAMAGE as error:
            if self._seen[number] >= 0:
                self._warn(f"the chunk at byte {at} is damaged and left out ({_what(error)})")
            self._seen[number] = -1
            raise
        self._seen[number] = 1
        if self._cached + found[0].nbytes <= CACHE_BYTES:
            self._cache[number] = found
            self._cached += found[0].nbytes
        return found

    def _believe_summary(self) -> bool:
        """Read the index of the file from its summary. Return False, and change nothing, if no summary is valid."""
        size = self._size
        try:
            opcode, length, start, _, checksum, magic = _END.unpack(self._read(max(0, size - _END.size), size))
            stop = size - _END.size
            if (opcode, length, magic) != (Opcode.FOOTER, 20, MCAP0_MAGIC) or not (checksum and 0 < start <= stop):
                return False
            if self._checksum(start, stop + _END_CHECKED) != checksum:
                return False
            return self._take(_Summary(self._read, start, stop))
        except DAMAGE:
            return False

    def _checksum(self, start: int, stop: int) -> int:
        checksum = 0
        for at in range(start, stop, _BLOCK):
            checksum = zlib.crc32(self._read(at, min(at + _BLOCK, stop)), checksum)
        return checksum

    def _take(self, summary: _Summary) -> bool:
        chunks, told = summary.chunks, summary.statistics
        if told is None or (told.chunk_count, told.channel_count) != (len(chunks), len(summary.channels)):
            return False
        opcode, length = RECORD.unpack(self._read(len(MCAP0_MAGIC), len(MCAP0_MAGIC) + HEADER))
        first = len(MCAP0_MAGIC) + HEADER + length
        ends = chunks["stop"] + chunks["index_bytes"]
        parts = int((ends - chunks["at"]).sum()) + sum(length for _, length in summary.records)
        if opcode != Opcode.HEADER or first + parts + _DATA_END != summary.start:
            return False  # there is something that the summary does not tell
        if np.any(chunks["at"] < first) or np.any(chunks["at"][1:] < ends[:-1]) or np.any(ends > summary.start):
            return False
        self._chunks, self._holds, self._unknown = chunks, summary.holds, summary.unknown
        self._seen = np.zeros(len(chunks), np.int8)
        for kind, data in [*summary.schemas, *summary.channels]:
            self._register(kind, data)
        self.counts.update({k: n for k, n in told.channel_message_counts.items() if k in self.channels and n})
        self.span_ns = (told.message_start_time, told.message_end_time) if self.counts else None
        for at, length in [(len(MCAP0_MAGIC), first - len(MCAP0_MAGIC)), *summary.records]:
            try:
                opcode, content = RECORD.unpack(self._read(at, at + HEADER))
                if content != length - HEADER:
                    raise ValueError("length")
                self._visit(opcode, at, at + length)
            except DAMAGE as error:
                self._warn(f"the record at byte {at} is damaged and left out ({_what(error)})")
        self.complete = True
        return True

    def _walk(self) -> None:
        """Visit the records of the file in order, as far as they make sense, and then the chunks."""
        found, whole = _Walk(), True
        at, size = len(MCAP0_MAGIC), self._size
        while at + HEADER <= size:
            opcode, length = RECORD.unpack(self._read(at, at + HEADER))
            stop = at + HEADER + length
            unknown = opcode == 0 or max(Opcode) < opcode < 0x80  # opcodes from 0x80 on are application records
            if unknown or stop > size:
                again = self._next_chunk(at + 1)
                if again is None:
                    whole &= self._end(opcode, at, unknown, found)
                    break
                self._warn(f"damaged at byte {at}: {again - at} bytes are left out")
                at, whole = again, False
                continue
            try:
                if not found.add(opcode, at, stop, self._read(at, min(stop, at + HEADER + CHUNK_HEAD))):
                    self._visit(opcode, at, stop)
            except DAMAGE as error:
                self._warn(f"the record at byte {at} is damaged and left out ({_what(error)})")
                whole = False
            at = stop
            if opcode == Opcode.FOOTER:
                self.complete = True
                break
        else:
            self._warn("the recording was cut off or still goes on (no footer): everything up to there is used")
        self._chunks, self._seen = found.chunks(), np.zeros(len(found.at), np.int8)
        self._seen[self._bound_chunks() :] = -1
        # Only chunks have a checksum: their channel records go before those elsewhere.
        channels, schemas, self.channels, self.schemas = self.channels, self.schemas, {}, {}
        self._scan(found, only_new=whole and not self.complete)
        self.channels, self.schemas = {**channels, **self.channels}, {**schemas, **self.schemas}
        if lost := sum(n for channel, n in self.counts.items() if channel not in self.channels):
            self._warn(f"left out: {counted(lost, 'message')} whose channel stood in a damaged part")
        self.counts = Counter({channel: n for channel, n in self.counts.items() if channel in self.channels})

    def _scan(self, found: _Walk, only_new: bool) -> None:
        """Read the chunks; with `only_new` those alone that are not told by their indexes or have a new channel."""
        self._unknown = np.ones(len(self._chunks), bool)
        holds: tuple[list[int], list[int]] = ([], [])
        waiting: list[int] = []
        n_bytes = 0
        for number in range(len(self._chunks)):
            told = found.counts[number] if only_new and number + 1 < len(self._chunks) else {}  # the last may be cut
            if told and not waiting and all(channel in self.channels for channel in told):
                self._unknown[number] = False
                holds[0].extend([number] * len(told))
                holds[1].extend(told)
                self.counts.update(told)
                self._span(*(int(self._chunks[name][number]) for name in ("begin_ns", "end_ns")))
                continue
            waiting.append(number)
            n_bytes += int(self._chunks["size"][number])
            if only_new or number + 1 == len(self._chunks) or n_bytes > BATCH_BYTES:
                heads = self._messages(waiting, self._register).heads
                waiting, n_bytes = [], 0
                for channel, n in zip(*np.unique(heads["channel"], return_counts=True), strict=True):
                    self.counts[int(channel)] += int(n)
                if len(heads):
                    self._span(int(heads["log_ns"].min()), int(heads["log_ns"].max()))
                if self._too_many(self.counts.total()):
                    self._seen[number + 1 :] = -1
                    break
        self._holds = (np.asarray(holds[0], np.int32), np.asarray(holds[1], np.uint16))

    def _span(self, begin_ns: int, end_ns: int) -> None:
        before = self.span_ns or (begin_ns, end_ns)
        self.span_ns = min(before[0], begin_ns), max(before[1], end_ns)

    def _next_chunk(self, at: int) -> int | None:
        """Where the next whole zstd chunk begins, at or behind `at`: damage need not cost all that follows."""
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

    def _end(self, opcode: int, at: int, unknown: bool, found: _Walk) -> bool:
        """Nothing whole follows `at`; of a chunk that is cut, the blocks that are there may still hold messages.

        Returns whether it is merely cut.
        """
        if unknown:
            self._warn(f"damaged at byte {at}: what follows is left out")
            return False
        self._warn("the recording was cut off inside a record: everything up to there is used")
        start = at + HEADER
        with contextlib.suppress(*DAMAGE):
            if opcode == Opcode.CHUNK:
                chunk = chunk_at(self._read(start, start + CHUNK_HEAD), start, self._size, cut=True)
                self._partial = unpack_cut(self._read(chunk.start, min(chunk.stop, chunk.start + MAX_CHUNK)), chunk)
                found.append(at, self._size, len(self._partial), 0, LAST_NS)
        return True

    def _visit(self, opcode: int, at: int, stop: int) -> None:
        """Keep the record at these bytes, if it is of the few that are kept. Raises one of DAMAGE."""
        if opcode not in _KEPT:
            return
        if self._held + (stop - at) > MAX_HELD:
            what = _KEPT[Opcode(opcode)].__name__.lower()
            size, limit = f"{(stop - at) / 1e6:.0f} MB", f"{MAX_HELD / 1e6:.0f} MB"
            self._warn(f"{what} at byte {at} is left out: {size}, and a log has at most {limit} beside its messages")
            return
        self._held += stop - at
        data = self._read(at + HEADER, stop)
        if opcode in (Opcode.CHANNEL, Opcode.SCHEMA):
            self._register(opcode, data)
        elif opcode == Opcode.ATTACHMENT:
            (checksum,) = struct.unpack_from("<I", data, len(data) - 4)
            if checksum not in (0, zlib.crc32(memoryview(data)[:-4])):
                raise ValueError("checksum of an attachment")
            found = _parse(Attachment.read, data)
            _check_name(found.name)
            self.attachments.append(replace(found, name=printable(found.name)))
        elif opcode == Opcode.METADATA:
            about = _parse(Metadata.read, data)
            texts = {printable(key): printable(value) for key, value in about.metadata.items()}
            self.metadata.append(replace(about, metadata=texts))
        elif opcode == Opcode.HEADER:
            self.profile = _parse(Header.read, data).profile

    def _register(self, opcode: int, data: bytes) -> None:
        try:
            if opcode == Opcode.SCHEMA:
                schema = _parse(Schema.read, data)
                _check_name(schema.name)
                if schema.id not in self.schemas:
                    self._held += len(data)
                if self._held <= MAX_HELD:
                    self.schemas[schema.id] = replace(schema, name=printable(schema.name))
            else:
                channel = _parse(Channel.read, data)
                _check_name(channel.topic)
                if channel.id not in self.channels:
                    self._held += len(data)
                if self._held <= MAX_HELD:
                    about = {printable(key): printable(value) for key, value in channel.metadata.items()}
                    self.channels[channel.id] = replace(channel, topic=printable(channel.topic), metadata=about)
        except DAMAGE as error:
            self._warn(f"a schema or channel is damaged and left out ({_what(error)})")

    def _warn(self, text: str) -> None:
        if len(self.warnings) < MAX_WARNINGS:
            self.warnings.append(text)
        elif len(self.warnings) == MAX_WARNINGS:
            self.warnings.append("and more of the kind")


class _Walk:
    """Chunks as a walk through the file finds them."""

    def __init__(self) -> None:
        self.at, self._stop, self._index_bytes, self._size = (array("q") for _ in range(4))
        self._begin_ns, self._end_ns = array("Q"), array("Q")
        self.counts: list[dict[int, int]] = []  # messages by channel, as the indexes of each chunk have it
        self._plain = False  # whether the last one is of messages without a chunk around them

    def append(self, at: int, stop: int, size: int, begin_ns: int, end_ns: int) -> None:
        """A chunk."""
        columns = (self.at, self._stop, self._index_bytes, self._size, self._begin_ns, self._end_ns)
        for column, value in zip(columns, (at, stop, 0, size, begin_ns, end_ns), strict=True):
            column.append(value)
        self.counts.append({})

    def add(self, opcode: int, at: int, stop: int, head: bytes) -> bool:
        """A record that begins with `head`; False where it is no part of a chunk. Raises one of DAMAGE."""
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
        """All of them, dtype _CHUNK."""
        found = np.zeros(len(self.at), _CHUNK)
        found["at"], found["stop"], found["index_bytes"] = self.at, self._stop, self._index_bytes
        found["size"], found["begin_ns"], found["end_ns"] = self._size, self._begin_ns, self._end_ns
        return found


class _Summary:
    """The summary at bytes `start` .. `stop` of a file. Raises one of DAMAGE where it makes no sense."""

    def __init__(self, read: Callable[[int, int], bytes], start: int, stop: int) -> None:
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
                    self._add(opcode, block[place + HEADER : end])
                place = end
            if not place:
                raise ValueError("a record of the summary is too long")
            if begins:
                parts.append(_chunk_indexes(np.frombuffer(block, np.uint8), np.asarray(begins), np.asarray(ends)))
            at += place
        before = np.cumsum([0, *(len(chunks) for chunks, _, _ in parts)], dtype=np.int32)
        self.chunks = np.concatenate([np.zeros(0, _CHUNK), *(chunks for chunks, _, _ in parts)])
        self.holds = (
            np.concatenate([np.zeros(0, np.int32), *(k + n for (_, k, _), n in zip(parts, before, strict=False))]),
            np.concatenate([np.zeros(0, np.uint16), *(channel for _, _, channel in parts)]),
        )
        self.unknown = np.ones(len(self.chunks), bool)  # chunks without an index
        self.unknown[self.holds[0]] = False

    def _add(self, opcode: int, data: bytes) -> None:
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
    """Chunk index records at these bytes: chunks, and pairs of chunk and channel. Raises ValueError."""
    least = _CHUNK_INDEX.itemsize + 8 + 4 + 8 + 8
    if np.any(ends - begins < least):
        raise ValueError("length of a chunk index")
    heads = rows_at(block, begins, _CHUNK_INDEX)
    n_map = heads["n_map"].astype(np.int64)
    if np.any(n_map % 10) or np.any(ends - begins < least + n_map):
        raise ValueError("length of a chunk index")
    found = np.zeros(len(begins), _CHUNK)
    for name in ("at", "begin_ns", "end_ns"):
        found[name] = heads[name]
    found["stop"] = heads["at"] + heads["length"]
    found["index_bytes"] = rows_at(block, begins + _CHUNK_INDEX.itemsize + n_map, np.dtype("<i8"))
    found["size"] = rows_at(block, ends - 8, np.dtype("<i8"))
    if min(heads["length"].min() - HEADER, found["index_bytes"].min(), found["size"].min()) < 0:
        raise ValueError("lengths of a chunk index")
    chunk = np.repeat(np.arange(len(begins)), n_map // 10)
    k = np.arange(len(chunk)) - np.repeat(np.cumsum(n_map // 10) - n_map // 10, n_map // 10)
    channel = rows_at(block, begins[chunk] + _CHUNK_INDEX.itemsize + 10 * k, np.dtype("<u2"))
    return found, chunk.astype(np.int32), channel


def _check_name(name: str) -> None:
    """Raise ValueError where a text is too long for a name."""
    if len(name) > MAX_TEXT:
        raise ValueError(f"a name of {len(name)} characters")


def _ignore(opcode: int, data: bytes) -> None:
    """What a schema or channel is taken for once all are known."""


def _parse(read: Callable[[ReadDataStream], Record], data: bytes) -> Record:
    return read(ReadDataStream(BytesIO(data)))


def _what(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
