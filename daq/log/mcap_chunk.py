"""One MCAP chunk: unpacked within limits, and where its messages are.

The message indexes behind a chunk only speed things up: each entry is checked against the chunk, and what they
leave out is scanned.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Sequence
from io import BytesIO
from itertools import pairwise
from typing import NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from numpy.typing import NDArray

MAX_CHUNK = 64 * 2**20  # bytes, uncompressed
RECORD = struct.Struct("<BQ")  # opcode, length
HEADER = RECORD.size
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
MESSAGE = np.dtype(  # where a message is: payload at `offset` in the uncompressed chunk number `chunk`
    [
        ("chunk", "i4"),
        ("offset", "i8"),
        ("length", "i8"),
        ("channel", "u2"),
        ("sequence", "u4"),
        ("log_ns", "i8"),
        ("stamp_ns", "i8"),
    ]
)
DAMAGE = (
    struct.error,
    ValueError,
    OverflowError,
    MemoryError,
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
    if size > MAX_CHUNK:
        raise ValueError(f"a chunk of {size} bytes; {MAX_CHUNK} is the limit")
    return ChunkAt(begin, stop, name, size, checksum)


def unpack_chunk(packed: bytes, chunk: ChunkAt) -> Buffer:
    """The uncompressed bytes. Raises one of DAMAGE where size or checksum does not hold."""
    data = packed
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


def scan(buffer: Buffer, index: Sequence[Offsets], register: Callable[[int, bytes], None]) -> NDArray[np.void]:
    """Messages of a chunk as MESSAGE rows (chunk number 0): by the index where it is right, else by its records.

    `index` are the offsets that the message indexes give; schemas and channels go to `register(opcode, content)`.
    """
    offsets = np.unique(np.concatenate(index)) if index else np.zeros(0, np.int64)
    offsets = offsets[(offsets >= 0) & (offsets <= len(buffer) - MESSAGE_HEAD.itemsize)]
    heads = rows_at(buffer, offsets, MESSAGE_HEAD)
    good = (heads["opcode"] == Opcode.MESSAGE) & (heads["length"] >= 22) & (heads["length"] <= len(buffer))
    ends = offsets + HEADER + np.minimum(heads["length"], len(buffer)).astype(np.int64)
    good &= ends <= len(buffer)
    good[1:] &= offsets[1:] >= ends[:-1]
    if not good.all():  # a wrong index is no index
        offsets, ends = offsets[:0], ends[:0]
    found: list[int] = []
    starts, stops = np.append(0, ends), np.append(offsets, len(buffer))
    view = memoryview(buffer.data)
    for i in np.flatnonzero(stops > starts):
        found += _read_gap(view, int(starts[i]), int(stops[i]), register)
    if found:
        offsets = np.sort(np.append(offsets, np.asarray(found, np.int64)))
    heads = rows_at(buffer, offsets, MESSAGE_HEAD)
    rows = np.zeros(len(offsets), MESSAGE)
    rows["offset"] = offsets + MESSAGE_HEAD.itemsize
    rows["length"] = heads["length"].astype(np.int64) - 22
    for name in ("channel", "sequence", "log_ns", "stamp_ns"):
        rows[name] = heads[name]
    return rows


def _read_gap(view: memoryview, at: int, stop: int, register: Callable[[int, bytes], None]) -> list[int]:
    found = []
    while at + HEADER <= stop:
        opcode, length = RECORD.unpack_from(view, at)
        end = at + HEADER + length
        if opcode == 0 or end > stop or (opcode == Opcode.MESSAGE and length < 22):
            break
        if opcode == Opcode.MESSAGE:
            found.append(at)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            register(opcode, bytes(view[at + HEADER : end]))
        at = end
    return found


def rows_at(buffer: Buffer, offsets: Offsets, dtype: np.dtype[np.void]) -> NDArray[np.void]:
    """Structures of `dtype` at these offsets, all within the buffer; shape (n,)."""
    return _records_at(buffer, offsets, dtype.itemsize).view(dtype) if len(offsets) else np.zeros(0, dtype)


def _records_at(buffer: Buffer, offsets: Offsets, size: int) -> NDArray[np.void]:
    """As `rows_at`, without the fields: those make numpy slow."""
    starts: NDArray[np.void] = np.ndarray((len(buffer) - size + 1,), f"V{size}", buffer.data, strides=(1,))
    return starts[offsets]


def by_chunk(messages: NDArray[np.void]) -> list[tuple[int, NDArray[np.void]]]:
    """MESSAGE rows in file order, split at the borders of the chunks: (chunk number, its rows)."""
    if not len(messages):
        return []
    borders = np.flatnonzero(np.diff(messages["chunk"])) + 1
    parts = [messages[a:b] for a, b in pairwise([0, *borders.tolist(), len(messages)])]
    return [(int(part["chunk"][0]), part) for part in parts]


class Chunked:
    """What is read by position from whatever has chunks: a file, or a set of them."""

    def chunk(self, number: int) -> Buffer:
        """The uncompressed bytes of a chunk."""
        raise NotImplementedError

    def rows(self, messages: NDArray[np.void], dtype: np.dtype[np.void]) -> NDArray[np.void]:
        """Payloads of `messages` (MESSAGE rows in file order), each at least as long as `dtype`; shape (n,)."""
        size = dtype.itemsize
        parts = [_records_at(self.chunk(number), part["offset"], size) for number, part in by_chunk(messages)]
        return np.concatenate(parts).view(dtype) if parts else np.zeros(0, dtype)

    def payload(self, message: np.void) -> memoryview:
        """The bytes of one message (a MESSAGE row)."""
        start = int(message["offset"])
        return memoryview(self.chunk(int(message["chunk"])).data)[start : start + int(message["length"])]
