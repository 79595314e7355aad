"""MCAP chunks: unpacked within limits, and where their messages are.

The message indexes behind a chunk only speed things up: each entry is checked against the chunk, and what they
leave out is scanned.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from typing import Any, NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from numpy.typing import NDArray

MAX_CHUNK = 64 * 2**20  # bytes, uncompressed
MAX_KINDS = 70_000  # schemas and channels between two messages: a file has at most 2^16 channels
# Records of applications can have no content, and millions of them compress to nothing. What a real file has of them:
MAX_PRIVATE = 65_536  # between two messages of the index,
MAX_PRIVATE_PER_MESSAGE = 16  # and for each message that no index names
MAX_PACKED = MAX_CHUNK + 2**20  # what does not compress becomes a little longer
RECORD = struct.Struct("<BQ")  # opcode, length
HEADER = RECORD.size
HEAD_BYTES = 22  # of a message's content, before its data
INDEX_HEAD = 6  # of a message index's content, before its entries
_CHUNK = struct.Struct("<QQQII")  # start, end, uncompressed size, checksum, length of the compression's name
CHUNK_NAME = _CHUNK.size - 4  # offset of the length of the compression's name
CHUNK_HEAD = _CHUNK.size + 16  # bytes that hold all of a chunk's header
MESSAGE_HEAD = np.dtype(  # of a message record, up to its data
    {
        "names": ["opcode", "length", "channel", "sequence", "log_ns", "stamp_ns"],
        "formats": ["u1", "<u8", "<u2", "<u4", "<u8", "<u8"],
        "offsets": [0, 1, 9, 11, 15, 23],
        "itemsize": 31,
    }
)
DAMAGE = (
    struct.error,
    ValueError,
    OverflowError,
    EOFError,
    RuntimeError,
    McapError,
    zstandard.ZstdError,
)
Buffer = NDArray[np.uint8]
Offsets = NDArray[np.int64]


class ChunkAt(NamedTuple):
    """Position of a chunk's data in the file, and its compression."""

    start: int
    stop: int
    compression: str
    size: int
    checksum: int


def chunk_at(head: bytes, start: int, stop: int, cut: bool = False) -> ChunkAt:
    """Read the header of the chunk record whose content lies at `start` .. `stop` of the file and begins with `head`.

    Raises one of DAMAGE where it makes no sense; `cut` allows a chunk that the file does not hold to its end.
    """
    _, _, size, checksum, n_name = _CHUNK.unpack_from(head)
    at = _CHUNK.size
    name = head[at : at + n_name].decode()
    (length,) = struct.unpack_from("<Q", head, at + n_name)
    begin = start + at + n_name + 8
    if name not in ("", "zstd", "lz4") or (not cut and begin + length != stop):
        raise ValueError("header of a chunk")
    if size > MAX_CHUNK or (not cut and length > MAX_PACKED):
        raise ValueError(f"a chunk of {size} bytes; {MAX_CHUNK} is the limit")
    return ChunkAt(begin, stop, name, size, checksum)


def unpack_chunk(packed: bytes | memoryview, chunk: ChunkAt) -> Buffer:
    """The uncompressed bytes. Raises one of DAMAGE where size or checksum does not hold."""
    data: bytes | memoryview = packed
    if chunk.compression == "zstd":
        # The frame's own claim of its size decides what the library allocates: check it first.
        if zstandard.frame_content_size(packed) not in (-1, chunk.size):
            raise ValueError("size of a chunk")
        data = zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK).decompress(packed, chunk.size + 1)
    elif chunk.compression == "lz4":
        with lz4.frame.LZ4FrameFile(BytesIO(packed)) as file:
            data = file.read(chunk.size + 1)
    if len(data) != chunk.size:
        raise ValueError("size of a chunk")
    if chunk.checksum and zlib.crc32(data) != chunk.checksum:
        raise ValueError("checksum of a chunk")
    return np.frombuffer(data, np.uint8)


def unpack_cut(packed: bytes, chunk: ChunkAt) -> Buffer:
    """What the beginning of a chunk still gives: zstd has blocks of 128 KiB. Raises one of DAMAGE."""
    if chunk.compression == "lz4":
        raise ValueError("lz4")
    data = packed
    if chunk.compression == "zstd":
        with zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK).stream_reader(packed) as reader:
            data = reader.read(MAX_CHUNK)
    return np.frombuffer(data, np.uint8)


class Messages(NamedTuple):
    """Messages of some chunks: their bytes one behind the other, where each message begins in them, and its head."""

    buffer: Buffer
    offsets: Offsets  # shape (n,), of the whole record
    heads: NDArray[np.void]  # dtype MESSAGE_HEAD, shape (n,)

    @property
    def lengths(self) -> NDArray[np.int64]:
        """Bytes of each payload, shape (n,)."""
        return self.heads["length"].astype(np.int64) - HEAD_BYTES

    def where(self, these: NDArray[np.bool_]) -> Messages:
        """Those of them."""
        return self if these.all() else Messages(self.buffer, self.offsets[these], self.heads[these])

    def rows(self, dtype: np.dtype[np.void]) -> NDArray[np.void]:
        """The payloads, each at least as long as `dtype`; shape (n,)."""
        return rows_at(self.buffer, self.offsets + MESSAGE_HEAD.itemsize, dtype)

    def payloads(self) -> Iterator[memoryview]:
        """The bytes of each message."""
        view, starts = memoryview(self.buffer.data), self.offsets + MESSAGE_HEAD.itemsize
        for start, length in zip(starts.tolist(), self.lengths.tolist(), strict=True):
            yield view[start : start + length]


def scan(chunks: list[tuple[Buffer, bytes]], register: Callable[[int, bytes], None]) -> Messages:
    """The messages of chunks: by the index of each where it is right, else by its records.

    A chunk comes with the entries of its message indexes; schemas and channels go to `register(opcode, content)`.
    """
    buffer = chunks[0][0] if len(chunks) == 1 else np.concatenate([data for data, _ in chunks])
    bounds = np.cumsum([0, *(len(data) for data, _ in chunks)])
    entries = np.frombuffer(b"".join(index for _, index in chunks), np.int64).reshape(-1, 2)[:, 1]
    chunk = np.repeat(np.arange(len(chunks)), [len(index) // 16 for _, index in chunks])
    inside = (entries >= 0) & (entries <= np.diff(bounds)[chunk] - MESSAGE_HEAD.itemsize)
    offsets = np.sort(entries[inside] + bounds[chunk[inside]])
    chunk = np.searchsorted(bounds, offsets, side="right") - 1
    heads = rows_at(buffer, offsets, MESSAGE_HEAD)
    good = (heads["opcode"] == Opcode.MESSAGE) & (heads["length"] >= HEAD_BYTES)
    ends = offsets + HEADER + np.minimum(heads["length"], len(buffer)).astype(np.int64)
    good &= ends <= bounds[chunk + 1]
    good[1:] &= offsets[1:] >= ends[:-1]
    if not good.all():  # a wrong index is no index
        right = ~np.isin(chunk, chunk[~good])
        offsets, ends, heads = offsets[right], ends[right], heads[right]
    # What lies between messages, or between them and the ends of their chunk.
    starts, stops = np.sort(np.append(bounds[:-1], ends)), np.sort(np.append(offsets, bounds[1:]))
    view = memoryview(buffer.data)
    found: list[int] = []
    for i in np.flatnonzero(stops > starts):
        found += _read_gap(view, int(starts[i]), int(stops[i]), register)
    if found:
        offsets = np.sort(np.append(offsets, np.asarray(found, np.int64)))
        heads = rows_at(buffer, offsets, MESSAGE_HEAD)
    return Messages(buffer, offsets, heads)


def index_entries(data: bytes, at: int) -> bytes:
    """The entries (time, offset) of the message indexes that lie in `data` from `at` on, as bytes."""
    parts = []
    while at + HEADER + INDEX_HEAD <= len(data):
        opcode, length = RECORD.unpack_from(data, at)
        end = at + HEADER + length
        if opcode != Opcode.MESSAGE_INDEX or end > len(data) or (length - INDEX_HEAD) % 16:
            break
        parts.append(data[at + HEADER + INDEX_HEAD : end])
        at = end
    return b"".join(parts)


def _read_gap(view: memoryview, at: int, stop: int, register: Callable[[int, bytes], None]) -> list[int]:
    found: list[int] = []
    n_kinds = n_private = 0
    while at + HEADER <= stop and n_kinds < MAX_KINDS:
        if n_private > MAX_PRIVATE + MAX_PRIVATE_PER_MESSAGE * len(found):
            break
        opcode, length = RECORD.unpack_from(view, at)
        end = at + HEADER + length
        if opcode == 0 or end > stop or (opcode == Opcode.MESSAGE and length < HEAD_BYTES):
            break
        if opcode == Opcode.MESSAGE:
            found.append(at)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            n_kinds += 1
            register(opcode, bytes(view[at + HEADER : end]))
        else:
            n_private += 1
        at = end
    return found


def rows_at(buffer: Buffer, offsets: Offsets, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Items of `dtype` at these offsets, all within the buffer; shape (n,)."""
    return _records_at(buffer, offsets, dtype.itemsize).view(dtype) if len(offsets) else np.zeros(0, dtype)


def _records_at(buffer: Buffer, offsets: Offsets, size: int) -> NDArray[np.void]:
    """As `rows_at`, without the fields: those make numpy slow."""
    starts: NDArray[np.void] = np.ndarray((len(buffer) - size + 1,), f"V{size}", buffer.data, strides=(1,))
    return starts[offsets]
