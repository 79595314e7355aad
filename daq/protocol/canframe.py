"""CAN frames as bytes: the 16-byte `struct can_frame` of Linux. CAN ports read and write it, and the log contains it.

Source: linux/can.h. The 32-bit identifier word has 29 bits of identifier and three flags.
"""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod

from seatrial.daq.samples import Frame

EXTENDED = 0x8000_0000  # CAN_EFF_FLAG
REMOTE = 0x4000_0000  # CAN_RTR_FLAG
ERROR = 0x2000_0000  # CAN_ERR_FLAG
CAN_FRAME = struct.Struct("=IB3x8s")
FRAME_BYTES = CAN_FRAME.size


def pack_can(arbitration_id: int, data: bytes) -> bytes:
    """Encode a CAN frame with a 29-bit identifier as the 16 bytes of the `struct can_frame` of Linux.

    Parameters
    ----------
    arbitration_id
        CAN identifier, below 2^29. This is not checked.
    data
        At most 8 bytes. This is not checked. Fewer bytes are filled up with zeros behind them. Bytes after the eighth
        are cut off, but the length in the frame counts them.
    """
    return CAN_FRAME.pack(arbitration_id | EXTENDED, len(data), data)


def unpack_can(frame: bytes) -> tuple[int, bytes] | None:
    """Return identifier and data of a CAN frame, given as the 16 bytes of the `struct can_frame` of Linux.

    Return None for a remote frame, for an error frame, and for a frame with an 11-bit identifier. The data have the
    length that the frame states; a length above 8 counts as 8.

    Raises
    ------
    struct.error
        If `frame` does not have 16 bytes.
    """
    word, length, data = CAN_FRAME.unpack(frame)
    if not word & EXTENDED or word & (REMOTE | ERROR):
        return None
    return word & ~EXTENDED, data[:length]


class FrameDecoder(ABC):
    """Base class of the decoders of a CAN bus: it splits bytes into CAN frames and has the counters of the stream.

    A subclass decodes one CAN frame to samples in `_decode_can_frame`.

    Attributes
    ----------
    frames : int
        Number of valid messages of the kinds that the decoder knows.
    checksum_errors : int
        Number of messages of several frames with a wrong checksum; of DroneCAN also of those with a wrong length.
    unparsed_bytes : int
        Number of bytes of damaged frames and of frames of incomplete messages. Ignored frames do not count.
    remark : str
        Advice about the stream for the user, in one line; empty if there is none.
    """

    def __init__(self) -> None:
        """Start without received bytes: all counters are 0, and the remark is empty."""
        self.frames = 0
        # CAN controllers check each frame in hardware; only messages of several frames have a checksum of their own.
        self.checksum_errors = 0
        self.unparsed_bytes = 0
        self.remark = ""
        self._buffer = bytearray()

    def feed(self, data: bytes, t_rx: float) -> list[Frame]:
        """Decode bytes of a CAN bus: a sequence of 16-byte `struct can_frame` of Linux, which may be split at any byte.

        Remote frames and error frames are ignored. A frame with a length above 8 counts as unparsed bytes. The bytes of
        an incomplete frame at the end are kept for the next call.

        Parameters
        ----------
        data
            Bytes of one read.
        t_rx
            Run time [s] of receipt.

        Returns
        -------
        list of Frame
            The samples that these bytes complete.
        """
        self._buffer += data
        whole = len(self._buffer) - len(self._buffer) % FRAME_BYTES
        out: list[Frame] = []
        for word, length, body in CAN_FRAME.iter_unpack(bytes(self._buffer[:whole])):
            if length > 8:  # a classic CAN frame has at most 8 bytes of data
                self.unparsed_bytes += FRAME_BYTES
            elif not word & (REMOTE | ERROR):
                out += self._decode_can_frame(word & ~EXTENDED, bool(word & EXTENDED), body[:length], t_rx)
        del self._buffer[:whole]
        return out

    def reset(self) -> None:
        """Discard an incomplete CAN frame and all values from earlier frames, because the port was reopened.

        The counters are kept; the bytes of the incomplete frame count as unparsed.
        """
        self.unparsed_bytes += len(self._buffer)
        self._buffer.clear()
        self._forget_state()

    @abstractmethod
    def _decode_can_frame(self, identifier: int, extended: bool, data: bytes, t_rx: float) -> list[Frame]:
        """Decode one CAN data frame by the protocol of the subclass, and return the samples that it completes.

        The list is empty if the frame completes no sample.

        Parameters
        ----------
        identifier
            CAN identifier.
        extended
            Whether the identifier has 29 bits instead of 11.
        data
            At most 8 bytes.
        t_rx
            Run time [s] of receipt.
        """

    @abstractmethod
    def _forget_state(self) -> None:
        """Discard all values that the subclass keeps from earlier CAN frames, because the port was reopened."""
