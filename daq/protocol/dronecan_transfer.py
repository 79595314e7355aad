"""DroneCAN (UAVCAN v0) transfers: messages of any length in CAN frames of at most eight bytes. No I/O, no clock.

Source: the DroneCAN specification, "CAN bus transport layer". The last byte of a frame says where in its transfer it
stands. A transfer of several frames begins with a checksum over the signature of its data type and all of it.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

from daq.protocol.canframe import FRAME_BYTES
from daq.protocol.framing import crc16_ccitt

PART = 7  # bytes of a message in a frame
NUMBERS = 32  # transfers are counted modulo this
_SERVICE = 1 << 7
_BEGINS, _ENDS, _TOGGLE, _NUMBER = 0x80, 0x40, 0x20, 0x1F


@dataclass(frozen=True)
class MessageType:
    """A data type: its number, its signature, and the most bytes that a message of it has."""

    number: int
    signature: int
    longest: int

    @cached_property
    def seed(self) -> int:
        """What the checksum of a transfer starts from."""
        return crc16_ccitt(struct.pack("<Q", self.signature))


def frames_of(
    kind: MessageType, payload: bytes, source: int, number: int, priority: int = 16
) -> list[tuple[int, bytes]]:
    """The frames (identifier, data) in which node ``source``, 1..127, broadcasts a message as its transfer ``number``.

    The lower the ``priority``, 0..31, the sooner it gets onto the bus.
    """
    identifier = priority << 24 | kind.number << 8 | source
    body = payload
    if len(payload) > PART:
        body = struct.pack("<H", crc16_ccitt(payload, kind.seed)) + payload
    parts = [body[at : at + PART] for at in range(0, max(len(body), 1), PART)]
    return [(identifier, part + bytes((_tail(k, len(parts), number),))) for k, part in enumerate(parts)]


def _tail(k: int, n_parts: int, number: int) -> int:
    return _BEGINS * (k == 0) | _ENDS * (k == n_parts - 1) | _TOGGLE * (k & 1) | number & _NUMBER


@dataclass
class _Transfer:
    """A transfer that is under way."""

    number: int
    t_rx: float  # of its first frame
    toggle: int = 0
    frames: int = 0
    data: bytearray = field(default_factory=bytearray)


class Assembler:
    """Puts the messages of one type together, from all nodes of a bus."""

    def __init__(self, kind: MessageType) -> None:
        self.checksum_errors = 0
        self.unparsed_bytes = 0  # of frames whose transfer was never complete
        self._kind = kind
        self._transfers: dict[int, _Transfer] = {}  # by the node that sends

    def take(self, identifier: int, data: bytes, t_rx: float) -> Iterator[tuple[bytes, float]]:
        """A frame with a 29-bit identifier; the message that it completes, and when its first frame came."""
        if identifier >> 8 & 0xFFFF != self._kind.number or identifier & _SERVICE or not data:
            return
        source, tail = identifier & 0x7F, data[-1]
        if tail & _BEGINS:
            self._drop(source)
            self._transfers[source] = _Transfer(tail & _NUMBER, t_rx)
        transfer = self._transfers.get(source)
        if transfer is None:
            self.unparsed_bytes += FRAME_BYTES
            return
        of_it = (tail & _NUMBER, bool(tail & _TOGGLE)) == (transfer.number, bool(transfer.toggle))
        if not of_it or len(transfer.data) > self._kind.longest + 2:
            self._drop(source)
            self.unparsed_bytes += FRAME_BYTES
            return
        transfer.data += data[:-1]
        transfer.frames += 1
        transfer.toggle ^= 1
        if tail & _ENDS:
            yield from self._complete(source, transfer)

    def _complete(self, source: int, transfer: _Transfer) -> Iterator[tuple[bytes, float]]:
        del self._transfers[source]
        payload = bytes(transfer.data)
        if transfer.frames > 1:
            checksum, payload = int.from_bytes(payload[:2], "little"), payload[2:]
            if checksum != crc16_ccitt(payload, self._kind.seed):
                self.checksum_errors += 1
                return
        yield payload, transfer.t_rx

    def _drop(self, source: int) -> None:
        """Give up the transfer of a node; what it had counts."""
        if (transfer := self._transfers.pop(source, None)) is not None:
            self.unparsed_bytes += FRAME_BYTES * transfer.frames

    def forget(self) -> None:
        """Give up all transfers that are under way."""
        for source in list(self._transfers):
            self._drop(source)
