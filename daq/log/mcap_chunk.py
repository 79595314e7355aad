"""MCAP chunks: decompression within limits, and search for their messages.

A chunk is a record that contains a group of messages, usually compressed. The message indexes after a chunk only save
time. Each entry is checked against the chunk, and the parts of the chunk that no entry covers are scanned record by
record.
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

MAX_CHUNK_BYTES = 64 * 2**20  # bytes, uncompressed
MAX_KINDS = 70_000  # schemas and channels between two messages: a file has at most 2^16 channels
# Application records can be empty, and millions of empty records compress to a few bytes. Limits for real files:
MAX_PRIVATE = 65_536  # application records between two messages of the index
MAX_PRIVATE_PER_MESSAGE = 16  # further application records for each message that no index contains
MAX_PACKED_BYTES = MAX_CHUNK_BYTES + 2**20  # bytes, compressed; data that cannot be compressed become a little longer
RECORD = struct.Struct("<BQ")  # opcode, length
HEADER = RECORD.size
HEAD_BYTES = 22  # bytes of the content of a message before its data
INDEX_HEAD = 6  # bytes of the content of a message index before its entries
_CHUNK = struct.Struct("<QQQII")  # start, end, uncompressed size, checksum, length of the compression's name
CHUNK_NAME = _CHUNK.size - 4  # offset of the length of the compression's name
CHUNK_HEAD = _CHUNK.size + 16  # bytes that contain the whole header of a chunk
MESSAGE_HEAD = np.dtype(  # a message record up to its data
    {
        "names": ["opcode", "length", "channel", "sequence", "log_ns", "stamp_ns"],
        "formats": ["u1", "<u8", "<u2", "<u4", "<u8", "<u8"],
        "offsets": [0, 1, 9, 11, 15, 23],
        "itemsize": 31,
    }
)
DAMAGE = (  # errors that the decoding of a damaged record raises
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
    """Position of the data of an MCAP chunk (a group of messages) in the file, and their compression.

    Attributes
    ----------
    start
        First byte of the data in the file.
    stop
        First byte after the data.
    compression
        Compression of the data: "" (none), "zstd" or "lz4".
    size
        Number of uncompressed bytes.
    checksum
        CRC-32 of the uncompressed bytes; 0 if there is none.
    """

    start: int
    stop: int
    compression: str
    size: int
    checksum: int


def chunk_at(head: bytes, start: int, stop: int, cut: bool = False) -> ChunkAt:
    """Decode the header of an MCAP chunk record, and return position and compression of its data.

    Parameters
    ----------
    head
        First bytes of the content of the record; `CHUNK_HEAD` bytes are enough.
    start, stop
        Bytes of the file between which the content lies.
    cut
        Whether the chunk may end after the end of the file. The length of the data is then not checked, and the result
        has the position of the data up to `stop`.

    Raises
    ------
    ValueError, or another error in DAMAGE (errors that damaged bytes cause)
        If the header is invalid, its compression is unknown, or the chunk is larger than 64 MiB uncompressed
        (MAX_CHUNK_BYTES) or 65 MiB compressed (MAX_PACKED_BYTES).
    """
    _, _, size, checksum, n_name = _CHUNK.unpack_from(head)
    at = _CHUNK.size
    name = head[at : at + n_name].decode()
    (length,) = struct.unpack_from("<Q", head, at + n_name)
    begin = start + at + n_name + 8
    if name not in ("", "zstd", "lz4") or (not cut and begin + length != stop):
        raise ValueError("the header of the chunk is invalid")
    if size > MAX_CHUNK_BYTES or (not cut and length > MAX_PACKED_BYTES):
        raise ValueError(f"the chunk has {size} bytes, and the limit is {MAX_CHUNK_BYTES}")
    return ChunkAt(begin, stop, name, size, checksum)


def unpack_chunk(packed: bytes | memoryview, chunk: ChunkAt) -> Buffer:
    """Decompress the data of an MCAP chunk and return its bytes, shape (size,).

    Parameters
    ----------
    packed
        The compressed data.
    chunk
        Compression, size and checksum of the chunk. Data without compression ("") are returned as they are. A checksum
        of 0 is not checked.

    Raises
    ------
    ValueError, or another error in DAMAGE (errors that damaged bytes cause)
        If size or checksum is wrong, or if the data cannot be decompressed.
    """
    data: bytes | memoryview = packed
    if chunk.compression == "zstd":
        # The library allocates the size that the zstd frame states. Check this size first.
        if zstandard.frame_content_size(packed) not in (-1, chunk.size):
            raise ValueError("the chunk has a wrong size")
        data = zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK_BYTES).decompress(packed, chunk.size + 1)
    elif chunk.compression == "lz4":
        with lz4.frame.LZ4FrameFile(BytesIO(packed)) as file:
            data = file.read(chunk.size + 1)
    if len(data) != chunk.size:
        raise ValueError("the chunk has a wrong size")
    if chunk.checksum and zlib.crc32(data) != chunk.checksum:
        raise ValueError("the chunk has a wrong checksum")
    return np.frombuffer(data, np.uint8)


def unpack_cut(packed: bytes, chunk: ChunkAt) -> Buffer:
    """Decompress the existing data (`packed`) of an MCAP chunk whose end is missing, and return its bytes, shape (n,).

    The result may be empty: zstd blocks have at most 128 KiB each, and a block that is cut gives nothing. At most 64
    MiB are decompressed (MAX_CHUNK_BYTES). Data without compression are returned as they are. The checksum is not
    checked.

    Raises
    ------
    ValueError, or another error in DAMAGE (errors that damaged bytes cause)
        If the compression is lz4, or if the zstd data before the cut are damaged.
    """
    if chunk.compression == "lz4":
        raise ValueError("the chunk is cut off, and cannot be read because its compression is lz4")
    data = packed
    if chunk.compression == "zstd":
        with zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK_BYTES).stream_reader(packed) as reader:
            data = reader.read(MAX_CHUNK_BYTES)
    return np.frombuffer(data, np.uint8)


class Messages(NamedTuple):
    """Messages of some MCAP chunks (groups of messages in the file), not yet decoded.

    Attributes
    ----------
    buffer
        Uncompressed bytes of the chunks, one chunk after the other.
    offsets
        Offset of each message record in the buffer, shape (n,).
    heads
        Head of each message record (channel, times, sequence number), dtype MESSAGE_HEAD, shape (n,).
    """

    buffer: Buffer
    offsets: Offsets
    heads: NDArray[np.void]

    @property
    def lengths(self) -> NDArray[np.int64]:
        """Number of bytes of the data of each message, without its head, shape (n,)."""
        return self.heads["length"].astype(np.int64) - HEAD_BYTES

    def where(self, mask: NDArray[np.bool_]) -> Messages:
        """Return the messages for which a mask (n,) is true, in their order; the buffer is shared and not copied.

        If the mask is true for all messages, the same object is returned.
        """
        return self if mask.all() else Messages(self.buffer, self.offsets[mask], self.heads[mask])

    def rows(self, dtype: np.dtype[np.void]) -> NDArray[np.void]:
        """Return the first bytes of the data of each message as an array of the numpy type `dtype`, shape (n,).

        The data are those after the head. The result is a copy. The caller checks first that no message is shorter than
        `dtype`; otherwise an item also contains bytes of the next record, or IndexError is raised at the end.
        """
        return rows_at(self.buffer, self.offsets + MESSAGE_HEAD.itemsize, dtype)

    def payloads(self) -> Iterator[memoryview]:
        """Yield the data of each message (without channel, times and sequence number), in order.

        Each item is a view of the buffer and no copy.
        """
        view, starts = memoryview(self.buffer.data), self.offsets + MESSAGE_HEAD.itemsize
        for start, length in zip(starts.tolist(), self.lengths.tolist(), strict=True):
            yield view[start : start + length]


def scan(chunks: list[tuple[Buffer, bytes]], register: Callable[[int, bytes], None]) -> Messages:
    """Find the messages in the bytes of uncompressed MCAP chunks.

    Parameters
    ----------
    chunks
        Bytes of each chunk, and the entries of its message indexes as bytes (see `index_entries`). At least one chunk.
    register
        Function that receives opcode and content of each schema and channel record that is found.

    Returns
    -------
    Messages
        Messages in file order.

    Notes
    -----
    Index entries outside a chunk, or too near to its end for the head of a message, are ignored. If another entry is
    not the offset of a whole message, or its message overlaps another one, all entries of its chunk are ignored. All
    bytes outside the messages of the used entries are scanned record by record. An invalid record, or too many other
    records, end the scan up to the next used entry or the next chunk.
    """
    buffer = chunks[0][0] if len(chunks) == 1 else np.concatenate([data for data, _ in chunks])
    bounds = np.cumsum([0, *(len(data) for data, _ in chunks)])
    entries = np.frombuffer(b"".join(index for _, index in chunks), np.int64).reshape(-1, 2)[:, 1]
    chunk = np.repeat(np.arange(len(chunks)), [len(index) // 16 for _, index in chunks])
    inside = (entries >= 0) & (entries <= np.diff(bounds)[chunk] - MESSAGE_HEAD.itemsize)
    # The entries are sorted by channel. The stable sort merges such runs, in a tenth of the time.
    offsets = np.sort(entries[inside] + bounds[chunk[inside]], kind="stable")
    chunk = np.searchsorted(bounds, offsets, side="right") - 1
    heads = rows_at(buffer, offsets, MESSAGE_HEAD)
    good = (heads["opcode"] == Opcode.MESSAGE) & (heads["length"] >= HEAD_BYTES)
    ends = offsets + HEADER + np.minimum(heads["length"], len(buffer)).astype(np.int64)
    good &= ends <= bounds[chunk + 1]
    good[1:] &= offsets[1:] >= ends[:-1]
    if not good.all():  # ignore all entries of a chunk that has a wrong one
        valid = ~np.isin(chunk, chunk[~good])
        offsets, ends, heads = offsets[valid], ends[valid], heads[valid]
    # Gaps: bytes between two messages, or between a message and the beginning or end of its chunk.
    starts = np.sort(np.append(bounds[:-1], ends), kind="stable")
    stops = np.sort(np.append(offsets, bounds[1:]), kind="stable")
    view = memoryview(buffer.data)
    unindexed: list[int] = []
    for i in np.flatnonzero(stops > starts):
        unindexed += _read_gap(view, int(starts[i]), int(stops[i]), register)
    if unindexed:
        offsets = np.sort(np.append(offsets, np.asarray(unindexed, np.int64)))
        heads = rows_at(buffer, offsets, MESSAGE_HEAD)
    return Messages(buffer, offsets, heads)


def index_entries(data: bytes, at: int) -> bytes:
    """Return the entries (time, offset) of the MCAP message index records in `data` from byte `at` on.

    The entries of all records are returned as one byte string, 16 bytes for each entry. The search ends at the first
    record that is not a valid message index.
    """
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
    """Scan the MCAP records between the offsets `at` and `stop` of a byte buffer, which no message index covers.

    Return the offsets of the message records in the buffer, ascending. `stop` is the first byte after the gap. Opcode
    and content of schemas and channels are passed to `register`; records of further kinds are skipped. The scan ends at
    the first invalid record, and after too many other records: 70,000 schemas and channels, or 65,536 records of
    further kinds plus 16 for each message. Millions of empty records would compress to a few bytes.
    """
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
    """Return the items of the numpy type `dtype` that begin at the `offsets` of a byte buffer, shape (n,).

    The items are copied, in the order of the offsets, and may overlap. Without offsets the result is empty. An item
    that goes beyond the end of the buffer raises IndexError or ValueError. The offsets must not be negative; this is
    not checked.
    """
    return _records_at(buffer, offsets, dtype.itemsize).view(dtype) if len(offsets) else np.zeros(0, dtype)


def _records_at(buffer: Buffer, offsets: Offsets, size: int) -> NDArray[np.void]:
    """Return copies of the items of `size` bytes at the `offsets` of a byte buffer, shape (n,), without named fields.

    With named fields numpy would be slow here. All items must lie within the buffer, which must have at least `size`
    bytes.
    """
    starts: NDArray[np.void] = np.ndarray((len(buffer) - size + 1,), f"V{size}", buffer.data, strides=(1,))
    return starts[offsets]
