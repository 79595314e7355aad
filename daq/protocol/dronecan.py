"""DroneCAN (UAVCAN v0): `uavcan.equipment.esc.Status` of speed controllers -> `Esc`.

Source: the DroneCAN specification, "CAN bus transport layer" and "Data structure description language", and
dsdl/uavcan/equipment/esc/1034.Status.uavcan. The message is longer than a CAN frame: three frames make a transfer,
with a checksum over all of it. One message of fixed layout needs no library.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

from daq.protocol.canframe import FRAME_BYTES, FrameDecoder
from daq.protocol.framing import crc16_ccitt
from daq.samples import NAN, Esc, Frame

STATUS = 1034  # data type id
SIGNATURE = 0xA9AF28AEA2FBB254  # of the data type; goes into the checksum
SIZE = 14  # bytes of the message
KELVIN = 273.15
PRIORITY = 16
_SEED = crc16_ccitt(struct.pack("<Q", SIGNATURE))
_HEAD = struct.Struct("<I3eH")  # error count, voltage, current, temperature, low bits of the rpm
_SERVICE = 1 << 7


@dataclass
class _Transfer:
    """A transfer that is under way."""

    number: int  # 5 bits
    t_rx: float  # of its first frame
    toggle: int = 0
    data: bytearray = field(default_factory=bytearray)


class Decoder(FrameDecoder):
    """esc.Status -> `Esc`, the index of the controller as its node.

    rpm is the shaft's (the controller knows its motor's poles); duty is not in the message. `t_rx` is that of the
    transfer's first frame. A transfer that lacks a frame counts as unparsed bytes, one whose checksum is wrong as a
    checksum error.
    """

    def __init__(self) -> None:
        super().__init__()
        self._transfers: dict[int, _Transfer] = {}  # by the node that sends

    def _take(self, identifier: int, extended: bool, data: bytes, t_rx: float) -> list[Frame]:
        if not extended or identifier >> 8 & 0xFFFF != STATUS or identifier & _SERVICE or not data:
            return []
        source, tail = identifier & 0x7F, data[-1]
        number, toggle, ends, begins = tail & 0x1F, tail >> 5 & 1, tail & 0x40, tail & 0x80
        if begins:
            self._drop(source)
            self._transfers[source] = _Transfer(number, t_rx)
        transfer = self._transfers.get(source)
        if transfer is None:
            self.unparsed_bytes += FRAME_BYTES
            return []
        if (number, toggle) != (transfer.number, transfer.toggle) or len(transfer.data) > SIZE + 2:
            self._drop(source)
            self.unparsed_bytes += FRAME_BYTES
            return []
        transfer.data += data[:-1]
        transfer.toggle ^= 1
        return self._complete(source, transfer) if ends else []

    def _complete(self, source: int, transfer: _Transfer) -> list[Frame]:
        del self._transfers[source]
        checksum, payload = transfer.data[:2], bytes(transfer.data[2:])
        if len(payload) != SIZE or int.from_bytes(checksum, "little") != crc16_ccitt(payload, _SEED):
            self.checksum_errors += 1
            return []
        self.frames += 1
        return [Frame(unpack(payload), transfer.t_rx, NAN)]

    def _drop(self, source: int) -> None:
        """Give up the transfer of a node; what it had counts."""
        if (transfer := self._transfers.pop(source, None)) is not None:
            self.unparsed_bytes += FRAME_BYTES * -(-len(transfer.data) // 7)

    def _forget(self) -> None:
        for source in list(self._transfers):
            self._drop(source)


def unpack(payload: bytes) -> Esc:
    """The 14 bytes of a message. rpm has 18 bits, the rating 7 and the index 5, in this order."""
    _, voltage, current, kelvin, low = _HEAD.unpack_from(payload)
    rpm = low | payload[12] >> 6 << 16
    rpm -= (rpm & 0x20000) << 1
    return Esc(payload[13] >> 2 & 0x1F, float(rpm), current, NAN, voltage, kelvin - KELVIN)


def encode(esc: Esc, source: int, number: int) -> list[tuple[int, bytes]]:
    """The frames (identifier, data) by which node `source`, 1..127, reports `esc` in its transfer `number`."""
    values = [0.0 if value != value else value for value in (esc.voltage, esc.current, esc.temperature + KELVIN)]
    rpm = round(0.0 if esc.rpm != esc.rpm else min(max(esc.rpm, -131072), 131071)) & 0x3FFFF
    payload = _HEAD.pack(0, *values, rpm & 0xFFFF) + bytes((rpm >> 16 << 6, (esc.node & 0x1F) << 2))
    body = struct.pack("<H", crc16_ccitt(payload, _SEED)) + payload
    parts = [body[at : at + 7] for at in range(0, len(body), 7)]
    identifier = PRIORITY << 24 | STATUS << 8 | source
    return [
        (identifier, part + bytes(((k == 0) << 7 | (k == len(parts) - 1) << 6 | (k & 1) << 5 | number & 0x1F,)))
        for k, part in enumerate(parts)
    ]
