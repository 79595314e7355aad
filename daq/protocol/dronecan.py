"""DroneCAN (UAVCAN v0) speed controllers: esc.Status to `Esc`, and esc.RawCommand from commands. No I/O, no clock.

Messages are sent as transfers: any length, in CAN frames of at most eight bytes.
Source: the DroneCAN specification, "Data structure description language" and "CAN bus transport layer", and
dsdl/uavcan: equipment/esc/1034.Status, equipment/esc/1030.RawCommand, protocol/341.NodeStatus.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property

from seatrial.daq.protocol.canframe import FRAME_BYTES, FrameDecoder
from seatrial.daq.protocol.framing import crc16_ccitt
from seatrial.daq.samples import NAN, Esc, Frame

KELVIN = 273.15
FULL = 8191  # full forward in 14 bits; full reverse is its negative, so that zero is the middle
MOST = 20  # controllers in one command
URGENT = 8  # priority of commands: before the reports of everybody else
_HEAD = struct.Struct("<I3eH")  # error count, voltage, current, temperature, low bits of the rpm
_BITS = 14
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


STATUS = MessageType(1034, 0xA9AF28AEA2FBB254, 14)
RAW_COMMAND = MessageType(1030, 0x217F5C87D7EC951D, 35)
NODE_STATUS = MessageType(341, 0x0F0868D0C1A7C6F1, 7)


class Decoder(FrameDecoder):
    """esc.Status -> `Esc`, the index of the controller, less ``index_offset``, as its node.

    rpm is the shaft's (the controller accounts for the poles), with its sign changed for `reversed_nodes`; duty is not
    in the message. `t_rx` is that of the transfer's first frame. A transfer that lacks a frame counts as unparsed
    bytes, one whose checksum is wrong as a checksum error.
    """

    def __init__(self, reversed_nodes: frozenset[int] = frozenset(), index_offset: int = 0) -> None:
        super().__init__()
        self._reversed, self._offset = reversed_nodes, index_offset
        self._assembler = Assembler(STATUS)

    def _take(self, identifier: int, extended: bool, data: bytes, t_rx: float) -> list[Frame]:
        if not extended:
            return []
        out = []
        for payload, t_first in self._assembler.take(identifier, data, t_rx):
            if len(payload) != STATUS.longest:
                self.checksum_errors += 1
                continue
            self.frames += 1
            out.append(Frame(unpack(payload, self._reversed, self._offset), t_first, NAN))
        self._count()
        return out

    def _count(self) -> None:
        """Take over what the assembler has counted."""
        self.unparsed_bytes += self._assembler.unparsed_bytes
        self.checksum_errors += self._assembler.checksum_errors
        self._assembler.unparsed_bytes = self._assembler.checksum_errors = 0

    def _forget(self) -> None:
        self._assembler.forget()
        self._count()


def unpack(payload: bytes, reversed_nodes: frozenset[int] = frozenset(), index_offset: int = 0) -> Esc:
    """The 14 bytes of an esc.Status. rpm has 18 bits, the rating 7 and the index 5, in this order.

    The node is the index less ``index_offset``, modulo 32: an index below the offset becomes one that no command has.
    """
    _, voltage, current, kelvin, low = _HEAD.unpack_from(payload)
    node = (payload[13] >> 2) - index_offset & 0x1F
    rpm = low | payload[12] >> 6 << 16
    rpm -= (rpm & 0x20000) << 1
    return Esc(node, float(-rpm if node in reversed_nodes else rpm), current, NAN, voltage, kelvin - KELVIN)


def encode(esc: Esc, source: int, number: int) -> list[tuple[int, bytes]]:
    """The frames (identifier, data) by which node `source`, 1..127, reports `esc` in its transfer `number`."""
    values = (esc.voltage, esc.current, esc.temperature + KELVIN)  # NaN where it is not known, as DSDL has it
    rpm = round(0.0 if esc.rpm != esc.rpm else min(max(esc.rpm, -131072), 131071)) & 0x3FFFF
    payload = _HEAD.pack(0, *values, rpm & 0xFFFF) + bytes((rpm >> 16 << 6, (esc.node & 0x1F) << 2))
    return frames_of(STATUS, payload, source, number)


def encode_command(commands: Mapping[int, float], source: int, number: int) -> list[tuple[int, bytes]]:
    """The frames of an esc.RawCommand: -1..1 by the controllers' indices, 0..19; zero for those between them.

    Raises ValueError for a command or an index beyond these.
    """
    for index, n in commands.items():
        if not (-1.0 <= n <= 1.0 and 0 <= index < MOST):
            raise ValueError(f"controller {index}: {n} is no command, -1 to 1, of the controllers 0 to {MOST - 1}")
    bits = "".join(_scalar(round(FULL * commands.get(k, 0.0))) for k in range(max(commands, default=-1) + 1))
    padded = bits.ljust(-(-len(bits) // 8) * 8, "0")
    payload = bytes(int(padded[at : at + 8], 2) for at in range(0, len(padded), 8))
    return frames_of(RAW_COMMAND, payload, source, number, URGENT)


def _scalar(value: int) -> str:
    """14 bits as they go onto the bus: the low byte first, each byte from its highest bit."""
    word = value & (1 << _BITS) - 1
    return f"{word & 0xFF:08b}{word >> 8:06b}"


def decode_command(payload: bytes) -> list[float]:
    """The commands, -1..1, in an esc.RawCommand, by the controllers' indices."""
    bits = "".join(f"{byte:08b}" for byte in payload)
    words = [bits[at : at + _BITS] for at in range(0, len(bits) - _BITS + 1, _BITS)]
    values = [int(word[8:] + word[:8], 2) for word in words]
    return [max(-1.0, (value - ((value & 0x2000) << 1)) / FULL) for value in values]


def encode_node_status(uptime_s: float, source: int, number: int) -> list[tuple[int, bytes]]:
    """The frame NodeStatus, sent once a second: the node is operational."""
    payload = struct.pack("<IBH", int(uptime_s) & 0xFFFFFFFF, 0, 0)
    return frames_of(NODE_STATUS, payload, source, number)


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
    """An incomplete transfer."""

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
        """Drop the transfer of a node; its frames count as unparsed."""
        if (transfer := self._transfers.pop(source, None)) is not None:
            self.unparsed_bytes += FRAME_BYTES * transfer.frames

    def forget(self) -> None:
        """Drop all incomplete transfers."""
        for source in list(self._transfers):
            self._drop(source)
