"""Search for frames in a stream of bytes, and checksums. All decoders of serial protocols use this module."""

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
    """Base class of the decoders of a stream of frames: it buffers bytes and searches for the next frame.

    A subclass defines the first byte of a frame in `sync` and decodes one frame in `_decode_frame`.

    Attributes
    ----------
    sync : re.Pattern
        Pattern of the first byte of a frame.
    between : bytes
        Bytes that are allowed between frames, such as line ends. They do not count as unparsed.
    frames : int
        Number of frames with a correct checksum.
    checksum_errors : int
        Number of complete frames with a wrong checksum.
    unparsed_bytes : int
        Number of bytes outside valid frames, without those that are allowed between frames.
    remark : str
        Advice about the stream for the user, in one line; empty if there is none.
    """

    sync: re.Pattern[bytes]  # the first byte of a frame
    between: bytes = b"\r\n"  # bytes that are allowed between frames and do not count as unparsed

    def __init__(self) -> None:
        """Start without received bytes: all counters are 0, and the remark is empty."""
        self.frames = 0
        self.checksum_errors = 0
        self.unparsed_bytes = 0
        self.remark = ""
        self._buffer = bytearray()
        self._before = 0  # number of bytes of the stream before the buffer
        self._out: list[T] = []

    def feed(self, data: bytes, t_rx: float) -> list[T]:
        """Decode the bytes of one read that returned at run time `t_rx` [s].

        Return the items that they complete, which are samples or CAN frames. An incomplete frame at the end is kept for
        the next call.
        """
        buffer = self._buffer
        buffer += data
        position = 0
        while position < len(buffer):
            match = self.sync.search(buffer, position)
            start = match.start() if match else len(buffer)
            self._count_skipped(buffer, position, start)
            position = start
            if not match:
                break
            length = self._decode_frame(buffer, start, t_rx)
            if length == 0:
                break
            if length < 0:  # no frame begins here; a frame may begin at the next byte
                self._count_skipped(buffer, start, start + 1)
                length = 1
            position = start + length
        del buffer[:position]
        self._before += position
        out, self._out = self._out, []
        return out

    def reset(self) -> None:
        """Discard an incomplete frame of the stream, because the port was reopened. Its bytes count as unparsed.

        The counters are kept.
        """
        self._count_skipped(self._buffer, 0, len(self._buffer))
        self._before += len(self._buffer)
        self._buffer.clear()

    def _count_skipped(self, buffer: bytearray, start: int, end: int) -> None:
        """Count the bytes of the buffer from `start` up to, not including, `end` as unparsed: no frame contains them.

        Bytes that are allowed between frames (`between`, such as line ends) do not count.
        """
        if end > start:
            self.unparsed_bytes += len(buffer[start:end].translate(None, self.between))

    @abstractmethod
    def _decode_frame(self, buffer: bytearray, start: int, t_rx: float) -> int:
        """Decode the frame that begins at index `start` of the buffer, and append its samples to `self._out`.

        The function of a subclass also counts the frame or its checksum error. `t_rx` is the run time of receipt [s].
        Return the length of the frame in bytes, 0 if more bytes are needed, or -1 if no valid frame begins at `start`.
        After -1 the caller counts one byte as unparsed and searches from the next one. The result must not depend on
        the number of bytes received after the frame.
        """


class Sentence(NamedTuple):
    """Result of reading one sentence of NMEA 0183 or VectorNav: a line of text `$body*checksum`.

    Attributes
    ----------
    length
        Length [bytes] with the first byte of the line end; 0 if more bytes are needed, -1 if no valid sentence begins
        here.
    body
        Text between `$` and `*`; None without a valid sentence.
    bad_checksum
        Whether the sentence is complete and its checksum is wrong.
    """

    length: int
    body: bytes | None = None
    bad_checksum: bool = False


def take_sentence(buffer: bytearray, start: int) -> Sentence:
    """Read a sentence of NMEA 0183 or VectorNav, which begins with `$` and ends with CR or LF.

    The sentence is `$body*hh` with an XOR checksum (NMEA 0183), or `$body*hhhh` with a CRC-16 (VectorNav).

    Parameters
    ----------
    buffer
        Received bytes.
    start
        Index of the `$` in the buffer.

    Returns
    -------
    Sentence
        Length and text of the sentence. The length includes `$` and the first byte of the line end. The length is 0 if
        the end of the line has not been received, and -1 if the line is not a valid sentence: it has a wrong checksum
        or none, 256 bytes (SENTENCE_MAX) without an end, or a byte that is not allowed.
    """
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
    correct = xor(body) if len(digits) == 2 else crc16(body)
    if int(digits, 16) != correct:
        return Sentence(-1, bad_checksum=True)
    return Sentence(end + 1 - start, body)


def xor(body: bytes) -> int:
    """Return the checksum of NMEA 0183: the exclusive or of all bytes between `$` and `*` (`body`); 0 without bytes."""
    return functools.reduce(operator.xor, body, 0)


def crc16(data: bytes) -> int:
    """Return CRC-16/XMODEM, the checksum of VectorNav (polynomial 0x1021, initial value 0)."""
    return binascii.crc_hqx(data, 0)


def crc16_ccitt(data: bytes, seed: int = 0xFFFF) -> int:
    """Return CRC-16/CCITT-FALSE, the checksum of DroneCAN (polynomial 0x1021, initial value `seed`)."""
    return binascii.crc_hqx(data, seed)


def sentence(body: str) -> bytes:
    """Encode a text without `$` and checksum as a sentence of NMEA 0183: `$body*hh` and CR LF.

    Raise UnicodeEncodeError if the text is not ASCII.
    """
    data = body.encode("ascii")
    return b"$%b*%02X\r\n" % (data, xor(data))
