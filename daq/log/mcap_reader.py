"""An MCAP file as arrays of message positions, read front to back; damaged parts are skipped and reported.

Nothing here trusts the end of the file (a killed run has none) or any length in it: records are bounded by the
file, chunks by a limit, and a chunk counts only when its checksum holds. Source: MCAP specification 0 (mcap.dev/spec).
"""

from __future__ import annotations

import contextlib
import os
import stat
import struct
import zlib
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import TypeVar

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from daq.errors import SeatrialError, counted, printable
from daq.log.mcap_chunk import (
    CHUNK_HEAD,
    CHUNK_NAME,
    DAMAGE,
    HEADER,
    MAX_CHUNK,
    MESSAGE,
    RECORD,
    Buffer,
    ChunkAt,
    Chunked,
    Offsets,
    chunk_at,
    scan,
    unpack_chunk,
    unpack_cut,
)

CACHE_BYTES = 256 * 2**20  # uncompressed chunks kept for the next table
MAX_WARNINGS = 20
FEW_MESSAGES = 2_000_000  # so many any file may have
_BLOCK = 2**20
_ZSTD = b"\x04\0\0\0zstd"  # what every zstd chunk has at CHUNK_NAME
Record = TypeVar("Record")


class RawLog(Chunked):
    """Every message of a file by position, with channels, schemas, metadata, attachments and warnings.

    Raises SeatrialError where the file cannot be opened or is no MCAP at all.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.warnings: list[str] = []
        self.complete = False  # whether the footer was reached
        self.profile = ""
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.metadata: list[Metadata] = []
        self.attachments: list[Attachment] = []
        self._chunks: list[ChunkAt] = []
        self._indexes: list[list[Offsets]] = []
        self._partial: Buffer | None = None  # of a chunk that the file holds in part; numbered behind the others
        self._cache: OrderedDict[int, Buffer] = OrderedDict()
        self._cached = 0
        self._fd, self._size = self._open()
        self._walk()
        # Only chunks have a checksum: their channel records go before those elsewhere.
        channels, schemas, self.channels, self.schemas = self.channels, self.schemas, {}, {}
        rows = self._gather()
        self.channels, self.schemas = {**channels, **self.channels}, {**schemas, **self.schemas}
        self.messages = self._known(rows)

    def _open(self) -> tuple[int, int]:
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
        return fd, size

    def _read(self, start: int, stop: int) -> bytes:
        """Bytes of the file; fewer where it has become shorter. Raises SeatrialError where the disk fails."""
        try:
            return os.pread(self._fd, max(stop - start, 0), start)
        except OSError as error:
            raise SeatrialError(f"{self.path}: cannot be read at byte {start}: {error.strerror}") from error

    @property
    def files(self) -> list[RawLog]:
        """This file alone; a log of several segments has more."""
        return [self]

    @property
    def n_chunks(self) -> int:
        """Chunks, one that the file holds in part included."""
        return len(self._chunks) + (self._partial is not None)

    def close(self) -> None:
        """Let go of the file and of what was unpacked; harmless when it is closed already."""
        self._cache.clear()
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def __del__(self) -> None:
        if getattr(self, "_fd", -1) >= 0:
            self.close()

    def _walk(self) -> None:
        """Visit the records of the file in order, as far as they make sense."""
        at, size = len(MCAP0_MAGIC), self._size
        while at + HEADER <= size:
            opcode, length = RECORD.unpack(self._read(at, at + HEADER))
            start, stop = at + HEADER, at + HEADER + length
            unknown = opcode == 0 or max(Opcode) < opcode < 0x80  # opcodes from 0x80 on are application records
            if unknown or stop > size:
                again = self._next_chunk(at + 1)
                if again is None:
                    self._end(opcode, at, unknown)
                    return
                self._warn(f"damaged at byte {at}: {again - at} bytes are left out")
                at = again
                continue
            try:
                self._visit(opcode, start, stop)
            except DAMAGE as error:
                self._warn(f"the record at byte {at} is damaged and left out ({_what(error)})")
            at = stop
            if opcode == Opcode.FOOTER:
                self.complete = True
                return
        self._warn("the recording was cut off or still goes on (no footer): everything up to there is used")

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

    def _end(self, opcode: int, at: int, unknown: bool) -> None:
        """Nothing whole follows `at`; of a chunk that is cut, the blocks that are there may still hold messages."""
        if unknown:
            self._warn(f"damaged at byte {at}: what follows is left out")
            return
        self._warn("the recording was cut off inside a record: everything up to there is used")
        start = at + HEADER
        with contextlib.suppress(*DAMAGE):
            if opcode == Opcode.CHUNK:
                chunk = chunk_at(self._read(start, start + CHUNK_HEAD), start, self._size, cut=True)
                self._partial = unpack_cut(self._read(chunk.start, min(chunk.stop, chunk.start + MAX_CHUNK)), chunk)

    def _visit(self, opcode: int, start: int, stop: int) -> None:
        if opcode == Opcode.CHUNK:
            self._chunks.append(chunk_at(self._read(start, min(stop, start + CHUNK_HEAD)), start, stop))
            self._indexes.append([])
        elif opcode == Opcode.MESSAGE_INDEX and self._indexes:
            pairs = np.frombuffer(self._read(start + 6, stop), np.dtype("<i8"))
            self._indexes[-1].append(pairs.reshape(-1, 2)[:, 1])
        elif opcode == Opcode.MESSAGE:  # a file without chunks: each message is read as a chunk of its own
            self._chunks.append(ChunkAt(start - HEADER, stop, "", stop - start + HEADER, 0))
            self._indexes.append([])
        elif opcode in (Opcode.CHANNEL, Opcode.SCHEMA):
            self._register(opcode, self._read(start, stop))
        elif opcode == Opcode.ATTACHMENT:
            data = self._read(start, stop)
            (checksum,) = struct.unpack_from("<I", data, len(data) - 4)
            if checksum not in (0, zlib.crc32(data[:-4])):
                raise ValueError("checksum of an attachment")
            found = _parse(Attachment.read, data)
            self.attachments.append(replace(found, name=printable(found.name)))
        elif opcode == Opcode.METADATA:
            about = _parse(Metadata.read, self._read(start, stop))
            texts = {printable(key): printable(value) for key, value in about.metadata.items()}
            self.metadata.append(replace(about, metadata=texts))
        elif opcode == Opcode.HEADER:
            self.profile = _parse(Header.read, self._read(start, stop)).profile

    def _register(self, opcode: int, data: bytes) -> None:
        try:
            if opcode == Opcode.SCHEMA:
                schema = _parse(Schema.read, data)
                self.schemas[schema.id] = replace(schema, name=printable(schema.name))
            else:
                channel = _parse(Channel.read, data)
                about = {printable(key): printable(value) for key, value in channel.metadata.items()}
                self.channels[channel.id] = replace(channel, topic=printable(channel.topic), metadata=about)
        except DAMAGE as error:
            self._warn(f"a schema or channel is damaged and left out ({_what(error)})")

    def chunk(self, number: int) -> Buffer:
        """The uncompressed bytes of a chunk. Raises one of DAMAGE."""
        if number == len(self._chunks) and self._partial is not None:
            return self._partial
        if number in self._cache:
            self._cache.move_to_end(number)
            return self._cache[number]
        at = self._chunks[number]
        buffer = unpack_chunk(self._read(at.start, at.stop), at)
        self._cache[number] = buffer
        self._cached += buffer.nbytes
        while self._cached > CACHE_BYTES and len(self._cache) > 1:
            self._cached -= self._cache.popitem(last=False)[1].nbytes
        return buffer

    def _gather(self) -> NDArray[np.void]:
        """Positions of all messages in file order, shape (n,), dtype MESSAGE."""
        parts, n_rows = [], 0
        for number in range(self.n_chunks):
            if n_rows > max(FEW_MESSAGES, self._size):  # a message takes some bytes, however well it is packed
                self._warn(f"more messages than {self._size} bytes can hold in earnest: what follows is left out")
                break
            try:
                buffer = self.chunk(number)
                found = scan(buffer, self._indexes[number] if number < len(self._indexes) else [], self._register)
            except DAMAGE as error:
                where = self._chunks[number].start
                self._warn(f"the chunk at byte {where} is damaged and left out ({_what(error)})")
                continue
            found["chunk"] = number
            parts.append(found)
            n_rows += len(found)
        self._indexes.clear()
        return np.concatenate(parts) if parts else np.zeros(0, MESSAGE)

    def _known(self, rows: NDArray[np.void]) -> NDArray[np.void]:
        known = np.isin(rows["channel"], list(self.channels))
        if not known.all():
            self._warn(f"left out: {counted(int((~known).sum()), 'message')} whose channel stood in a damaged part")
        return rows[known]

    def _warn(self, text: str) -> None:
        if len(self.warnings) < MAX_WARNINGS:
            self.warnings.append(text)
        elif len(self.warnings) == MAX_WARNINGS:
            self.warnings.append("and more of the kind")


def _parse(read: Callable[[ReadDataStream], Record], data: bytes) -> Record:
    return read(ReadDataStream(BytesIO(data)))


def _what(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
