"""CAN frames as bytes: Linux's 16-byte `struct can_frame`, which CAN ports hand over and the log keeps.

Source: linux/can.h. The word of the identifier carries three flags above its 29 bits.
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
    """A CAN frame with a 29-bit identifier as the 16 bytes of `struct can_frame`."""
    return CAN_FRAME.pack(arbitration_id | EXTENDED, len(data), data)


def unpack_can(frame: bytes) -> tuple[int, bytes] | None:
    """Identifier and data of a `struct can_frame`; None if it is no data frame with a 29-bit identifier."""
    word, length, data = CAN_FRAME.unpack(frame)
    if not word & EXTENDED or word & (REMOTE | ERROR):
        return None
    return word & ~EXTENDED, data[:length]


class FrameDecoder(ABC):
    """What all decoders of a CAN bus share: the cutting into frames, and the counters."""

    def __init__(self) -> None:
        self.frames = 0
        self.checksum_errors = 0  # CAN checks in hardware; only messages of several frames have a checksum
        self.unparsed_bytes = 0
        self.remark = ""
        self._buffer = bytearray()

    def feed(self, data: bytes, t_rx: float) -> list[Frame]:
        """Take raw CAN as logged: 16-byte `struct can_frame`s, in any pieces."""
        self._buffer += data
        whole = len(self._buffer) - len(self._buffer) % FRAME_BYTES
        out: list[Frame] = []
        for word, length, body in CAN_FRAME.iter_unpack(bytes(self._buffer[:whole])):
            if length > 8:  # this is no CAN frame
                self.unparsed_bytes += FRAME_BYTES
            elif not word & (REMOTE | ERROR):
                out += self._take(word & ~EXTENDED, bool(word & EXTENDED), body[:length], t_rx)
        del self._buffer[:whole]
        return out

    def reset(self) -> None:
        """Discard an incomplete frame and all received state (the port was reopened). Counters stay."""
        self.unparsed_bytes += len(self._buffer)
        self._buffer.clear()
        self._forget()

    @abstractmethod
    def _take(self, identifier: int, extended: bool, data: bytes, t_rx: float) -> list[Frame]:
        """Take one data frame; the samples that it completes."""

    @abstractmethod
    def _forget(self) -> None:
        """Discard all received state."""
