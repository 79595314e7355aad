"""Finding frames in a stream of bytes: the part that all serial protocols share."""

from __future__ import annotations

import binascii
import functools
import operator
import re
from abc import ABC, abstractmethod
from typing import Generic, NamedTuple, TypeVar

SENTENCE_MAX = 256  # bytes; NMEA 0183 allows 82, proprietary sentences are longer
_STOP = re.compile(rb"[\x00-\x1f\x7f-\xff$]")  # bytes that do not occur in a sentence
_CHECKSUM = re.compile(rb"\*([0-9A-Fa-f]{2}|[0-9A-Fa-f]{4})\Z")


T = TypeVar("T")


class StreamDecoder(ABC, Generic[T]):
    """A buffer and the search for the next frame. A subclass defines the start of a frame and decodes it."""

    sync: re.Pattern[bytes]  # what a frame may start with, one byte
    between: bytes = b"\r\n"  # what may stand between frames and is not counted as unparsed

    def __init__(self) -> None:
        self.frames = 0
        self.checksum_errors = 0
        self.unparsed_bytes = 0
        self.remark = ""
        self._buffer = bytearray()
        self._before = 0  # bytes of the stream in front of the buffer
        self._out: list[T] = []

    def feed(self, data: bytes, t_rx: float) -> list[T]:
        """Take the bytes of one read that returned at run time `t_rx`; returns what they complete."""
        buffer = self._buffer
        buffer += data
        position = 0
        while position < len(buffer):
            found = self.sync.search(buffer, position)
            start = found.start() if found else len(buffer)
            self._skip(buffer, position, start)
            position = start
            if not found:
                break
            length = self._take(buffer, start, t_rx)
            if length == 0:
                break
            if length < 0:  # no frame begins here, one may begin at the next byte
                self._skip(buffer, start, start + 1)
                length = 1
            position = start + length
        del buffer[:position]
        self._before += position
        out, self._out = self._out, []
        return out

    def reset(self) -> None:
        """Discard an incomplete frame (the port was reopened). Counters stay."""
        self._skip(self._buffer, 0, len(self._buffer))
        self._before += len(self._buffer)
        self._buffer.clear()

    def _skip(self, buffer: bytearray, start: int, end: int) -> None:
        if end > start:
            self.unparsed_bytes += len(buffer[start:end].translate(None, self.between))

    @abstractmethod
    def _take(self, buffer: bytearray, start: int, t_rx: float) -> int:
        """Take the frame that begins at `start`: its length, 0 to wait for more bytes, -1 if none begins there.

        The answer depends on the bytes alone, never on how many have arrived behind the frame. What it holds goes
        to `self._out`.
        """


class Sentence(NamedTuple):
    """What begins at a `$`: `length` as `StreamDecoder._take` returns it, and the text between `$` and `*`."""

    length: int
    body: bytes | None = None
    bad_checksum: bool = False


def take_sentence(buffer: bytearray, start: int) -> Sentence:
    """The sentence `$body*hh` (XOR) or `$body*hhhh` (CRC-16) that begins at `start` and ends with CR or LF."""
    stop = _STOP.search(buffer, start + 1, start + SENTENCE_MAX)
    if stop is None:
        return Sentence(0 if len(buffer) < start + SENTENCE_MAX else -1)
    end = stop.start()
    if buffer[end] not in b"\r\n":
        return Sentence(-1)
    line = bytes(buffer[start + 1 : end])
    checksum = _CHECKSUM.search(line)
    if checksum is None:
        return Sentence(-1)
    body, digits = line[: checksum.start()], checksum[1]
    right = xor(body) if len(digits) == 2 else crc16(body)
    if int(digits, 16) != right:
        return Sentence(-1, bad_checksum=True)
    return Sentence(end + 1 - start, body)


def xor(body: bytes) -> int:
    """The checksum of NMEA 0183: all bytes between `$` and `*`, exclusive-ored."""
    return functools.reduce(operator.xor, body, 0)


def crc16(data: bytes) -> int:
    """CRC-16/XMODEM, which VectorNav uses (polynomial 0x1021, initial value 0)."""
    return binascii.crc_hqx(data, 0)


def crc16_ccitt(data: bytes, seed: int = 0xFFFF) -> int:
    """CRC-16/CCITT-FALSE, which DroneCAN uses (polynomial 0x1021, initial value 0xFFFF)."""
    return binascii.crc_hqx(data, seed)


def sentence(body: str) -> bytes:
    """`body` as a sentence on the wire: `$body*hh` and CR LF."""
    data = body.encode("ascii")
    return b"$%b*%02X\r\n" % (data, xor(data))
