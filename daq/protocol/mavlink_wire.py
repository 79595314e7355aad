"""MAVLink 1 and 2 on the wire: whole frames, messages and back, signatures. No I/O and no clock.

Messages are pymavlink's (dialect ardupilotmega); ESC_STATUS, which its dialects lack, is ours. Sources:
mavlink.io/en/guide/serialization.html, mavlink.io/en/guide/message_signing.html, common.xml.
"""

from __future__ import annotations

import functools
import struct
from pathlib import Path
from typing import Any, NamedTuple

import fastcrc

from seatrial.daq.errors import SeatrialError

MARKER_1, MARKER_2 = 0xFE, 0xFD
HEADER_1, HEADER_2, CHECKSUM, SIGNATURE = 6, 10, 2, 13
SIGNED = 0x01  # the only incompatibility flag there is; a frame with another one must be dropped
EPOCH_2015 = 1_420_070_400.0  # s since 1970; signatures count units of 10 us from here
KEY_BYTES = 32
ESC_STATUS = 291  # the message's number
ESC_STATUS_SEED = 10  # of its checksum


def crc16(data: bytes, crc: int = 0xFFFF) -> int:
    """Return CRC-16/MCRF4XX, the checksum of MAVLink; `crc` is that of the bytes before."""
    return int(fastcrc.crc16.mcrf4xx(data, crc))


@functools.cache
def dialect() -> Any:
    """pymavlink's module of messages."""
    from pymavlink.dialects.v20 import ardupilotmega  # a quarter of a second, and only MAVLink needs it

    return ardupilotmega


class EscStatus(NamedTuple):
    """ESC_STATUS: four controllers from number `first` (0 is the first) on."""

    time_usec: int  # boot or 1970
    rpm: tuple[int, ...]  # signed
    voltage: tuple[float, ...]
    current: tuple[float, ...]
    first: int  # `index` on the wire

    @staticmethod
    def get_type() -> str:
        """As pymavlink's messages."""
        return "ESC_STATUS"


_ESC_STATUS = struct.Struct("<Q4i4f4fB")


def _unpack_esc_status(payload: bytes) -> EscStatus:
    values = _ESC_STATUS.unpack(payload.ljust(_ESC_STATUS.size, b"\0")[: _ESC_STATUS.size])
    return EscStatus(values[0], values[1:5], values[5:9], values[9:13], values[13])


class Head(NamedTuple):
    """The header of a frame."""

    total: int  # bytes of the whole frame
    message_id: int
    system: int
    component: int
    payload: int  # bytes
    signed: bool
    sequence: int  # of the sender's frames on this link, 0 to 255


def head(buffer: bytes | bytearray, start: int) -> Head | int:
    """The header that begins at `start`; 0 when bytes are missing, -1 when no frame can begin there."""
    two = buffer[start] == MARKER_2
    size = HEADER_2 if two else HEADER_1
    if two and len(buffer) > start + 2 and buffer[start + 2] & ~SIGNED:
        return -1
    if len(buffer) < start + size:
        return 0
    at = buffer[start : start + size]
    if two:
        signed = bool(at[2] & SIGNED)
        message_id = at[7] | at[8] << 8 | at[9] << 16
        total = size + at[1] + CHECKSUM + SIGNATURE * signed
        return Head(total, message_id, at[5], at[6], at[1], signed, at[4])
    known = _known(at[5])
    if known is None or at[1] > known[1]:  # version 1 has no truncation and no new messages
        return -1
    return Head(size + at[1] + CHECKSUM, at[5], at[3], at[4], at[1], False, at[2])


@functools.cache
def _known(message_id: int) -> tuple[int, int] | None:
    """Checksum seed and longest payload of a message; None for one that is not in the dialect."""
    if message_id == ESC_STATUS:
        return ESC_STATUS_SEED, _ESC_STATUS.size
    kind = dialect().mavlink_map.get(message_id)
    return None if kind is None else (kind.crc_extra, kind.unpacker.size)


def is_known(message_id: int) -> bool:
    """Whether the message is in the dialect, so that its checksum can be verified."""
    return _known(message_id) is not None


def is_whole(frame: bytes, found: Head) -> bool:
    """Whether the checksum is right; of a message that is not in the dialect, whether it can be (1 in 256 by chance).

    The checksum includes a seed that depends on the message's definition.
    """
    end = len(frame) - SIGNATURE * found.signed - CHECKSUM
    (said,) = struct.unpack_from("<H", frame, end)
    crc = crc16(frame[1:end])
    known = _known(found.message_id)
    if known is not None:
        return crc16(bytes([known[0]]), crc) == int(said)
    return any(crc16(bytes([seed]), crc) == said for seed in range(256))


class Codec:
    """One end of a link: frames to messages and messages to frames, signed where there is a key."""

    def __init__(
        self, system: int, component: int, key: bytes | None = None, now_unix: float = EPOCH_2015, link: int = 0
    ) -> None:
        """Our own ids; `now_unix` [s since 1970] starts the signatures' clock, which never goes back on one `link`."""
        self.system = system
        self._mav = dialect().MAVLink(None, srcSystem=system, srcComponent=component)
        if key is not None:
            self._mav.signing.secret_key = key
            self._mav.signing.timestamp = int(max(now_unix - EPOCH_2015, 0.0) * 1e5)
            self._mav.signing.sign_outgoing = True
            self._mav.signing.link_id = link
        self._key = key

    @property
    def signs(self) -> bool:
        """Whether there is a key."""
        return self._key is not None

    def decode(self, frame: bytes) -> Any | None:
        """The message of a whole frame; None where the signature is missing or wrong."""
        if frame[0] == MARKER_2 and frame[7:10] == b"\x23\x01\x00":
            # pymavlink has no such message and so checks no signature: where a signature is required, it is rejected.
            return None if self._key is not None else _unpack_esc_status(frame[HEADER_2 : HEADER_2 + frame[1]])
        try:
            return self._mav.decode(bytearray(frame))
        except dialect().MAVError:
            return None

    def encode(self, name: str, *fields: Any) -> bytes:
        """The frame of message `name` (as `COMMAND_LONG`) with its fields in pymavlink's order."""
        kind = getattr(dialect(), f"MAVLink_{name.lower()}_message")
        data: bytes = kind(*fields).pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return data


def encode_esc_status(system: int, component: int, sequence: int, status: EscStatus) -> bytes:
    """ESC_STATUS as a frame, unsigned."""
    payload = _ESC_STATUS.pack(status.time_usec, *status.rpm, *status.voltage, *status.current, status.first)
    payload = payload.rstrip(b"\0") or b"\0"
    body = struct.pack("<BBBBBBHB", len(payload), 0, 0, sequence, system, component, ESC_STATUS, 0) + payload
    return bytes([MARKER_2]) + body + struct.pack("<H", crc16(body + bytes([ESC_STATUS_SEED])))


def read_key(path: Path) -> bytes:
    """The 32 bytes of a signing key: as they are, or as 64 hexadecimal digits. Raises SeatrialError."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SeatrialError(f"{path}: the signing key cannot be read: {error.strerror}") from error
    if len(data) == KEY_BYTES:
        return data
    try:
        key = bytes.fromhex(data.decode("ascii").strip())
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise SeatrialError(f"{path}: a signing key is {KEY_BYTES} bytes or {2 * KEY_BYTES} hexadecimal digits")
    return key
