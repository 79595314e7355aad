"""DroneCAN (UAVCAN v0) speed controllers: decoder of esc.Status to `Esc`, and encoder of esc.RawCommand.

The module does no I/O and reads no clock. A message of any length is sent as a transfer: one or more CAN frames of at
most eight bytes.
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

KELVIN = 273.15  # K, of 0 deg C
FULL = 8191  # full forward in 14 bits; full reverse is its negative, so that zero is the middle
MOST = 20  # largest number of controllers in one command
URGENT = 8  # priority of commands; it is higher than that of the nodes' reports
_HEAD = struct.Struct("<I3eH")  # error count, voltage, current, temperature, low bits of the rpm
_BITS = 14  # of one controller in a command
PART = 7  # bytes of a message in one frame
NUMBERS = 32  # number of different transfer numbers; the number of the next transfer wraps at this value
_SERVICE = 1 << 7  # bit of the identifier: the frame belongs to a service, not to a broadcast message
_BEGINS, _ENDS, _TOGGLE, _NUMBER = 0x80, 0x40, 0x20, 0x1F  # bits of the last byte of a frame


@dataclass(frozen=True)
class MessageType:
    """Data type of a broadcast message of DroneCAN.

    Attributes
    ----------
    number
        Data type id, which is a part of the CAN identifier.
    signature
        Data type signature, from which the initial value of the checksum is computed.
    longest
        Largest number of bytes of a message of this type.
    """

    number: int
    signature: int
    longest: int

    @cached_property
    def seed(self) -> int:
        """Initial value of the checksum of a message in several CAN frames, computed from the signature."""
        return crc16_ccitt(struct.pack("<Q", self.signature))


STATUS = MessageType(1034, 0xA9AF28AEA2FBB254, 14)
RAW_COMMAND = MessageType(1030, 0x217F5C87D7EC951D, 35)
NODE_STATUS = MessageType(341, 0x0F0868D0C1A7C6F1, 7)


class Decoder(FrameDecoder):
    """Decoder of the DroneCAN message esc.Status, the state of a speed controller, to `Esc` samples.

    The rpm in the message is the speed of the shaft, because the controller accounts for the poles. The message has no
    duty. `t_rx` of a sample is the time of receipt of the first CAN frame of its transfer (all frames of one message),
    and `t_device` is NaN. A transfer that lacks a frame, or has far too many bytes, counts as unparsed bytes. Another
    transfer with a wrong checksum or a wrong length counts as a checksum error. Other messages are ignored.

    Parameters
    ----------
    reversed_nodes
        Nodes whose rpm changes its sign, so that positive means forward.
    index_offset
        Index of a controller in its status minus its index in a command. The index in the command is the node of the
        sample.
    """

    def __init__(self, reversed_nodes: frozenset[int] = frozenset(), index_offset: int = 0) -> None:
        """Start without received frames.

        `reversed_nodes` are the nodes whose rpm changes its sign. `index_offset` is the index of a controller in its
        status minus its index in a command.
        """
        super().__init__()
        self._reversed, self._offset = reversed_nodes, index_offset
        self._assembler = Assembler(STATUS)

    def _decode_can_frame(self, identifier: int, extended: bool, data: bytes, t_rx: float) -> list[Frame]:
        """Decode one CAN frame. Return the sample of the esc.Status that it completes, or an empty list.

        A frame with an 11-bit identifier is ignored. A complete message with another length than 14 bytes counts as a
        checksum error and gives no sample. The sample has the time of receipt of the first frame of its message.
        """
        if not extended:
            return []
        out = []
        for payload, t_first in self._assembler.take(identifier, data, t_rx):
            if len(payload) != STATUS.longest:
                self.checksum_errors += 1
                continue
            self.frames += 1
            out.append(Frame(unpack(payload, self._reversed, self._offset), t_first, NAN))
        self._take_counts()
        return out

    def _take_counts(self) -> None:
        """Add the error counters of the assembler (checksum errors, unparsed bytes) to those of the decoder.

        The counters of the assembler are then set to 0.
        """
        self.unparsed_bytes += self._assembler.unparsed_bytes
        self.checksum_errors += self._assembler.checksum_errors
        self._assembler.unparsed_bytes = self._assembler.checksum_errors = 0

    def _forget_state(self) -> None:
        """Discard all incomplete DroneCAN transfers, because the port was reopened. Their frames count as unparsed."""
        self._assembler.forget()
        self._take_counts()


def unpack(payload: bytes, reversed_nodes: frozenset[int] = frozenset(), index_offset: int = 0) -> Esc:
    """Decode an esc.Status of DroneCAN, the state of a speed controller.

    Parameters
    ----------
    payload
        The 14 bytes of the message; the number is not checked. Its last fields are rpm (18 bits), power rating (7 bits)
        and index (5 bits).
    reversed_nodes
        Nodes whose rpm changes its sign, so that positive means forward.
    index_offset
        Index of a controller in its status minus its index in a command.

    Returns
    -------
    Esc
        The node is the index minus `index_offset`, modulo 32. An index below the offset thus becomes a node that no
        command contains. The duty is NaN, because the message lacks it. The temperature is converted from K to deg C.
    """
    _, voltage, current, kelvin, low = _HEAD.unpack_from(payload)
    node = (payload[13] >> 2) - index_offset & 0x1F
    rpm = low | payload[12] >> 6 << 16
    rpm -= (rpm & 0x20000) << 1
    return Esc(node, float(-rpm if node in reversed_nodes else rpm), current, NAN, voltage, kelvin - KELVIN)


def encode(esc: Esc, source: int, number: int) -> list[tuple[int, bytes]]:
    """Encode the state of a speed controller as an esc.Status of DroneCAN.

    Parameters
    ----------
    esc
        State. Its node, modulo 32, is the index in the message. The rpm is rounded and clipped to 18 bits with sign.
        NaN as rpm is sent as zero, other NaN as NaN. The duty is not sent. Error count and power rating are sent as
        zero.
    source
        Node of the sender, 1..127.
    number
        Number of the transfer, modulo 32.

    Returns
    -------
    list of tuple of int and bytes
        CAN identifier (29 bits) and data of each frame.
    """
    values = (esc.voltage, esc.current, esc.temperature + KELVIN)  # DSDL defines NaN for unknown values
    rpm = round(0.0 if esc.rpm != esc.rpm else min(max(esc.rpm, -131072), 131071)) & 0x3FFFF
    payload = _HEAD.pack(0, *values, rpm & 0xFFFF) + bytes((rpm >> 16 << 6, (esc.node & 0x1F) << 2))
    return frames_of(STATUS, payload, source, number)


def encode_command(commands: Mapping[int, float], source: int, number: int) -> list[tuple[int, bytes]]:
    """Encode the commands of speed controllers as an esc.RawCommand of DroneCAN.

    Parameters
    ----------
    commands
        Command, -1..1, by index of the controller, 0..19; 1 is sent as 8191. Missing indices below the largest get
        zero. An empty mapping gives a message without commands.
    source
        Our node, 1..127.
    number
        Number of the transfer, modulo 32.

    Returns
    -------
    list of tuple of int and bytes
        CAN identifier (29 bits) and data of each frame.

    Raises
    ------
    ValueError
        If a command or an index is outside its range, or a command is NaN.
    """
    for index, n in commands.items():
        if not (-1.0 <= n <= 1.0 and 0 <= index < MOST):
            raise ValueError(
                f"controller {index}: command {n} is invalid; commands are -1 to 1, controllers 0 to {MOST - 1}"
            )
    bits = "".join(_command_bits(round(FULL * commands.get(k, 0.0))) for k in range(max(commands, default=-1) + 1))
    padded = bits.ljust(-(-len(bits) // 8) * 8, "0")
    payload = bytes(int(padded[at : at + 8], 2) for at in range(0, len(padded), 8))
    return frames_of(RAW_COMMAND, payload, source, number, URGENT)


def _command_bits(value: int) -> str:
    """Return the 14 bits of a command as text of "0" and "1", in the order of DroneCAN.

    `value` is -8192..8191; a negative one is in two's complement. The low byte is first, and each byte begins with its
    highest bit.
    """
    word = value & (1 << _BITS) - 1
    return f"{word & 0xFF:08b}{word >> 8:06b}"


def decode_command(payload: bytes) -> list[float]:
    """Return the commands, -1..1, that an esc.RawCommand contains, in the order of the controllers' indices from 0.

    `payload` are the bytes of the message. Each command has 14 bits; fewer bits at the end are ignored. The number 8191
    becomes 1, and -8192 becomes -1.
    """
    bits = "".join(f"{byte:08b}" for byte in payload)
    words = [bits[at : at + _BITS] for at in range(0, len(bits) - _BITS + 1, _BITS)]
    values = [int(word[8:] + word[:8], 2) for word in words]
    return [max(-1.0, (value - ((value & 0x2000) << 1)) / FULL) for value in values]


def encode_node_status(uptime_s: float, source: int, number: int) -> list[tuple[int, bytes]]:
    """Encode a NodeStatus, by which a DroneCAN node reports each second that it works.

    Parameters
    ----------
    uptime_s
        Time since the start of the node [s]. Fractions are cut off. The status is always "healthy, operational".
    source
        Our node, 1..127.
    number
        Number of the transfer, modulo 32.

    Returns
    -------
    list of tuple of int and bytes
        CAN identifier (29 bits) and data of each frame.
    """
    payload = struct.pack("<IBH", int(uptime_s) & 0xFFFFFFFF, 0, 0)
    return frames_of(NODE_STATUS, payload, source, number)


def frames_of(
    kind: MessageType, payload: bytes, source: int, number: int, priority: int = 16
) -> list[tuple[int, bytes]]:
    """Split a broadcast message of DroneCAN into the CAN frames of a transfer.

    Parameters
    ----------
    kind
        Type of the message.
    payload
        Bytes of the message. A message of more than 7 bytes is sent in several frames, with a checksum before it. An
        empty message is sent in one frame.
    source
        Node of the sender, 1..127.
    number
        Number of the transfer, modulo 32.
    priority
        Priority, 0..31. On a busy bus a frame with a lower number is sent before others.

    Returns
    -------
    list of tuple of int and bytes
        CAN identifier (29 bits) and data of each frame.
    """
    identifier = priority << 24 | kind.number << 8 | source
    body = payload
    if len(payload) > PART:
        body = struct.pack("<H", crc16_ccitt(payload, kind.seed)) + payload
    parts = [body[at : at + PART] for at in range(0, max(len(body), 1), PART)]
    return [(identifier, part + bytes((_tail_byte(k, len(parts), number),))) for k, part in enumerate(parts)]


def _tail_byte(k: int, n_parts: int, number: int) -> int:
    """Return the last byte of CAN frame `k`, from 0, of a DroneCAN transfer with `n_parts` frames.

    It contains three flags (first frame, last frame, toggle: odd `k`) and the number of the transfer, modulo 32.
    """
    return _BEGINS * (k == 0) | _ENDS * (k == n_parts - 1) | _TOGGLE * (k & 1) | number & _NUMBER


@dataclass
class _Transfer:
    """Received part of a DroneCAN transfer. A transfer is one message in one or more CAN frames.

    Attributes
    ----------
    number
        Number of the transfer, 0..31.
    t_rx
        Time of receipt of its first frame [s].
    toggle
        Expected toggle bit of the next frame, 0 or 1.
    frames
        Number of received frames.
    data
        Received bytes, the checksum included.
    """

    number: int
    t_rx: float
    toggle: int = 0
    frames: int = 0
    data: bytearray = field(default_factory=bytearray)


class Assembler:
    """Assembler of CAN frames to DroneCAN messages of one type, for all nodes of a bus.

    Parameters
    ----------
    kind
        Type of the messages. Frames of other types are ignored.

    Attributes
    ----------
    checksum_errors
        Number of transfers with a wrong checksum. A transfer is one message in one or more frames.
    unparsed_bytes
        Number of bytes of frames whose transfer was not completed.
    """

    def __init__(self, kind: MessageType) -> None:
        """Start without received frames. `kind` is the type of the messages to assemble."""
        self.checksum_errors = 0
        self.unparsed_bytes = 0  # of frames whose transfer was not completed
        self._kind = kind
        self._transfers: dict[int, _Transfer] = {}  # by sending node

    def take(self, identifier: int, data: bytes, t_rx: float) -> Iterator[tuple[bytes, float]]:
        """Add a CAN frame with a 29-bit identifier to the transfer of its sender.

        A frame of another message type, of a service, or without data is ignored. A frame that does not continue the
        transfer of its sender, or comes after too many bytes, is discarded together with this transfer; all their
        frames count as unparsed bytes. A frame without a first frame before it also counts so. A first frame begins a
        new transfer and discards an incomplete one, which has no time limit.

        Parameters
        ----------
        identifier
            CAN identifier.
        data
            Data of the frame, at most 8 bytes.
        t_rx
            Run time [s] of receipt.

        Yields
        ------
        tuple of bytes and float
            The message, if the frame completes it and the checksum is correct, and the time of receipt [s] of the first
            frame of its transfer.
        """
        if identifier >> 8 & 0xFFFF != self._kind.number or identifier & _SERVICE or not data:
            return
        source, tail = identifier & 0x7F, data[-1]
        if tail & _BEGINS:
            self._drop_transfer(source)
            self._transfers[source] = _Transfer(tail & _NUMBER, t_rx)
        transfer = self._transfers.get(source)
        if transfer is None:
            self.unparsed_bytes += FRAME_BYTES
            return
        continues = (tail & _NUMBER, bool(tail & _TOGGLE)) == (transfer.number, bool(transfer.toggle))
        if not continues or len(transfer.data) > self._kind.longest + 2:
            self._drop_transfer(source)
            self.unparsed_bytes += FRAME_BYTES
            return
        transfer.data += data[:-1]
        transfer.frames += 1
        transfer.toggle ^= 1
        if tail & _ENDS:
            yield from self._finish_transfer(source, transfer)

    def _finish_transfer(self, source: int, transfer: _Transfer) -> Iterator[tuple[bytes, float]]:
        """Yield the message of a complete DroneCAN transfer and the time of receipt [s] of its first frame.

        If the checksum is wrong, count an error and yield nothing. A transfer of a single frame has no checksum.
        `source` is the node that sent the transfer; the transfer is removed from the list of incomplete ones.
        """
        del self._transfers[source]
        payload = bytes(transfer.data)
        if transfer.frames > 1:
            checksum, payload = int.from_bytes(payload[:2], "little"), payload[2:]
            if checksum != crc16_ccitt(payload, self._kind.seed):
                self.checksum_errors += 1
                return
        yield payload, transfer.t_rx

    def _drop_transfer(self, source: int) -> None:
        """Discard the incomplete DroneCAN transfer of node `source`, if there is one. Its frames count as unparsed."""
        if (transfer := self._transfers.pop(source, None)) is not None:
            self.unparsed_bytes += FRAME_BYTES * transfer.frames

    def forget(self) -> None:
        """Discard the incomplete DroneCAN transfers of all nodes. Their frames count as unparsed."""
        for source in list(self._transfers):
            self._drop_transfer(source)
