"""DroneCAN (UAVCAN v0) speed controllers: esc.Status -> `Esc`, and esc.RawCommand from commands.

Source: the DroneCAN specification, "Data structure description language", and dsdl/uavcan: equipment/esc/1034.Status,
equipment/esc/1030.RawCommand, protocol/341.NodeStatus. Three messages of fixed layout need no library.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

from daq.protocol.canframe import FrameDecoder
from daq.protocol.dronecan_transfer import Assembler, MessageType, frames_of
from daq.samples import NAN, Esc, Frame

STATUS = MessageType(1034, 0xA9AF28AEA2FBB254, 14)
RAW_COMMAND = MessageType(1030, 0x217F5C87D7EC951D, 35)
NODE_STATUS = MessageType(341, 0x0F0868D0C1A7C6F1, 7)
KELVIN = 273.15
FULL = 8191  # full ahead in 14 bits; full astern is its negative, so that zero is the middle
MOST = 20  # controllers in one command
URGENT = 8  # priority of commands: before the reports of everybody else
_HEAD = struct.Struct("<I3eH")  # error count, voltage, current, temperature, low bits of the rpm
_BITS = 14


class Decoder(FrameDecoder):
    """esc.Status -> `Esc`, the index of the controller as its node.

    rpm is the shaft's (the controller knows its motor's poles), with its sign changed for `reversed_nodes`; duty is not
    in the message. `t_rx` is that of the transfer's first frame. A transfer that lacks a frame counts as unparsed
    bytes, one whose checksum is wrong as a checksum error.
    """

    def __init__(self, reversed_nodes: frozenset[int] = frozenset()) -> None:
        super().__init__()
        self._reversed = reversed_nodes
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
            out.append(Frame(unpack(payload, self._reversed), t_first, NAN))
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


def unpack(payload: bytes, reversed_nodes: frozenset[int] = frozenset()) -> Esc:
    """The 14 bytes of an esc.Status. rpm has 18 bits, the rating 7 and the index 5, in this order."""
    _, voltage, current, kelvin, low = _HEAD.unpack_from(payload)
    node = payload[13] >> 2 & 0x1F
    rpm = low | payload[12] >> 6 << 16
    rpm -= (rpm & 0x20000) << 1
    return Esc(node, float(-rpm if node in reversed_nodes else rpm), current, NAN, voltage, kelvin - KELVIN)


def encode(esc: Esc, source: int, number: int) -> list[tuple[int, bytes]]:
    """The frames (identifier, data) by which node `source`, 1..127, reports `esc` in its transfer `number`."""
    values = [0.0 if value != value else value for value in (esc.voltage, esc.current, esc.temperature + KELVIN)]
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
    """The frame by which a node says once a second that it is there and well."""
    payload = struct.pack("<IBH", int(uptime_s) & 0xFFFFFFFF, 0, 0)
    return frames_of(NODE_STATUS, payload, source, number)
