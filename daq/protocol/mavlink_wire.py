"""MAVLink 1 and 2 on the wire: headers, checksums, signatures, and the conversion between frames and messages.

The module does no I/O and reads no clock. Messages are those of pymavlink (dialect ardupilotmega). ESC_STATUS is
defined here, because the dialects of pymavlink lack this message. Sources: mavlink.io/en/guide/serialization.html,
mavlink.io/en/guide/message_signing.html, common.xml.
"""

from __future__ import annotations

import functools
import struct
from pathlib import Path
from typing import Any, NamedTuple

import fastcrc

from seatrial.daq.errors import SeatrialError

MARKER_1, MARKER_2 = 0xFE, 0xFD
HEADER_1, HEADER_2, CHECKSUM, SIGNATURE = 6, 10, 2, 13  # bytes; headers of version 1 and 2
SIGNED = 0x01  # the only defined incompatibility flag; a frame with another flag must be discarded
EPOCH_2015 = 1_420_070_400.0  # s since 1970; time stamps of signatures count units of 10 us from here
KEY_BYTES = 32
ESC_STATUS = 291  # id of the message
ESC_STATUS_SEED = 10  # CRC_EXTRA of the message


def crc16(data: bytes, crc: int = 0xFFFF) -> int:
    """Return CRC-16/MCRF4XX, the checksum of MAVLink. `crc` is the checksum of the bytes before `data`, if any.

    Without them it is 0xFFFF.
    """
    return int(fastcrc.crc16.mcrf4xx(data, crc))


@functools.cache
def dialect() -> Any:
    """Return the Python module of pymavlink that defines the MAVLink messages (dialect ardupilotmega).

    It is imported at the first call.
    """
    from pymavlink.dialects.v20 import ardupilotmega  # imported here: it takes 0.25 s, and only MAVLink needs it

    return ardupilotmega


class EscStatus(NamedTuple):
    """Message ESC_STATUS: the state of four consecutive speed controllers.

    Attributes
    ----------
    time_usec
        Time since boot or since 1970 [us].
    rpm
        Speed of each shaft, with sign [rev/min].
    voltage
        Voltage of each controller [V].
    current
        Current of each controller [A].
    first
        Number of the first controller, from 0; the field `index` on the wire.
    """

    time_usec: int
    rpm: tuple[int, ...]
    voltage: tuple[float, ...]
    current: tuple[float, ...]
    first: int

    @staticmethod
    def get_type() -> str:
        """Return "ESC_STATUS", the name of the message. Messages of pymavlink have the same method."""
        return "ESC_STATUS"


_ESC_STATUS = struct.Struct("<Q4i4f4fB")


def _unpack_esc_status(payload: bytes) -> EscStatus:
    """Decode the payload of the MAVLink message ESC_STATUS.

    Missing bytes at its end are zero, because MAVLink 2 omits trailing zeros. Surplus bytes are ignored.
    """
    values = _ESC_STATUS.unpack(payload.ljust(_ESC_STATUS.size, b"\0")[: _ESC_STATUS.size])
    return EscStatus(values[0], values[1:5], values[5:9], values[9:13], values[13])


class FrameHeader(NamedTuple):
    """Header of a MAVLink frame.

    Attributes
    ----------
    total
        Length of the whole frame [bytes].
    message_id
        Id of the message.
    system
        System id of the sender.
    component
        Component id of the sender.
    payload
        Length of the payload [bytes].
    signed
        Whether the frame has a signature.
    sequence
        Counter of the sender's frames on this link, 0 to 255.
    """

    total: int
    message_id: int
    system: int
    component: int
    payload: int
    signed: bool
    sequence: int


def parse_header(buffer: bytes | bytearray, start: int) -> FrameHeader | int:
    """Return the header of the MAVLink frame that begins at index `start` of the buffer.

    The byte at `start` has to be the first byte of a frame of MAVLink 1 (0xFE) or 2 (0xFD). Return 0 if more bytes are
    needed. A frame of MAVLink 2 with a message that the dialect lacks is accepted. The checksum is not checked. Return
    -1 if no frame can begin there: MAVLink 2 with a flag other than "signed", or MAVLink 1 with a message that the
    dialect lacks or a payload that is too long.
    """
    is_version_2 = buffer[start] == MARKER_2
    size = HEADER_2 if is_version_2 else HEADER_1
    if is_version_2 and len(buffer) > start + 2 and buffer[start + 2] & ~SIGNED:
        return -1
    if len(buffer) < start + size:
        return 0
    header = buffer[start : start + size]
    if is_version_2:
        signed = bool(header[2] & SIGNED)
        message_id = header[7] | header[8] << 8 | header[9] << 16
        total = size + header[1] + CHECKSUM + SIGNATURE * signed
        return FrameHeader(total, message_id, header[5], header[6], header[1], signed, header[4])
    definition = _seed_and_length(header[5])
    # Version 1 is only used with messages of the dialect. Their payload is never longer than defined.
    if definition is None or header[1] > definition[1]:
        return -1
    return FrameHeader(size + header[1] + CHECKSUM, header[5], header[3], header[4], header[1], False, header[2])


@functools.cache
def _seed_and_length(message_id: int) -> tuple[int, int] | None:
    """Return the checksum seed (CRC_EXTRA) and the longest payload [bytes] of a MAVLink message, given by its id.

    Return None if the dialect lacks the message.
    """
    if message_id == ESC_STATUS:
        return ESC_STATUS_SEED, _ESC_STATUS.size
    kind = dialect().mavlink_map.get(message_id)
    return None if kind is None else (kind.crc_extra, kind.unpacker.size)


def is_known(message_id: int) -> bool:
    """Return whether the dialect defines the MAVLink message with an id, so that its checksum can be verified."""
    return _seed_and_length(message_id) is not None


def has_correct_checksum(frame: bytes, header: FrameHeader) -> bool:
    """Return whether the checksum of a MAVLink frame is correct. The signature is not checked.

    Parameters
    ----------
    frame
        All bytes of the frame.
    header
        Header of the frame, from `parse_header`.

    Notes
    -----
    The checksum includes a seed that depends on the definition of the message. If the dialect lacks the message, any of
    the 256 seeds is accepted. A damaged frame of this kind is then accepted with probability 1/256.
    """
    end = len(frame) - SIGNATURE * header.signed - CHECKSUM
    (received,) = struct.unpack_from("<H", frame, end)
    crc = crc16(frame[1:end])
    definition = _seed_and_length(header.message_id)
    if definition is not None:
        return crc16(bytes([definition[0]]), crc) == int(received)
    return any(crc16(bytes([seed]), crc) == received for seed in range(256))


class Codec:
    """Converter between frames and messages at our end of a MAVLink link.

    If there is a signing key, sent frames are signed, and received frames need a correct signature.

    Attributes
    ----------
    system : int
        Our system id.
    """

    def __init__(
        self, system: int, component: int, key: bytes | None = None, now_unix: float = EPOCH_2015, link: int = 0
    ) -> None:
        """Set our ids and the signing key.

        Parameters
        ----------
        system, component
            Our system id and component id, which sent frames contain.
        key
            Signing key, 32 bytes; None for unsigned frames.
        now_unix
            Present time [s since 1970], from which the time stamps of signatures start. A time before 2015 counts as
            2015. Receivers reject a frame with an older stamp than the last one of the link.
        link
            Link id of the signatures. Time stamps of one link must never decrease.
        """
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
        """Whether the link has a signing key: sent frames are signed, and received frames need a correct signature."""
        return self._key is not None

    def decode(self, frame: bytes) -> Any | None:
        """Return the message (object of pymavlink, or `EscStatus`) of a complete MAVLink frame.

        Return None if pymavlink cannot decode the frame, or if there is a signing key and the signature is missing or
        wrong. Without a key, signatures are not checked. With a signing key, ESC_STATUS is always rejected, because
        pymavlink cannot check its signature.
        """
        if frame[0] == MARKER_2 and frame[7:10] == b"\x23\x01\x00":
            # pymavlink lacks ESC_STATUS and cannot check its signature. It is rejected if a signature is required.
            return None if self._key is not None else _unpack_esc_status(frame[HEADER_2 : HEADER_2 + frame[1]])
        try:
            return self._mav.decode(bytearray(frame))
        except dialect().MAVError:
            return None

    def encode(self, name: str, *fields: Any) -> bytes:
        """Encode message `name`, for example `COMMAND_LONG`, as a MAVLink frame, signed if there is a key.

        `fields` are the values of its fields in pymavlink's order. Each call increments the sequence number of our
        frames.
        """
        kind = getattr(dialect(), f"MAVLink_{name.lower()}_message")
        data: bytes = kind(*fields).pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return data


def encode_esc_status(system: int, component: int, sequence: int, status: EscStatus) -> bytes:
    """Encode ESC_STATUS, the state of four speed controllers, as an unsigned frame of MAVLink 2.

    Parameters
    ----------
    system, component
        Ids of the sender.
    sequence
        Sequence number of the sender's frames, 0 to 255.
    status
        State of the controllers. Trailing zero bytes are not sent, as MAVLink 2 requires.
    """
    payload = _ESC_STATUS.pack(status.time_usec, *status.rpm, *status.voltage, *status.current, status.first)
    payload = payload.rstrip(b"\0") or b"\0"
    body = struct.pack("<BBBBBBHB", len(payload), 0, 0, sequence, system, component, ESC_STATUS, 0) + payload
    return bytes([MARKER_2]) + body + struct.pack("<H", crc16(body + bytes([ESC_STATUS_SEED])))


def read_key(path: Path) -> bytes:
    """Read a signing key from a file that contains 32 bytes or 64 hexadecimal digits.

    Returns
    -------
    bytes
        The key, 32 bytes. White space around the digits is ignored. A file of exactly 32 bytes is always the key
        itself.

    Raises
    ------
    SeatrialError
        If the file cannot be read or does not contain a key.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SeatrialError(
            f"{path}: the signing key cannot be read: {error.strerror}; check key_file in the rig"
        ) from error
    if len(data) == KEY_BYTES:
        return data
    try:
        key = bytes.fromhex(data.decode("ascii").strip())
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise SeatrialError(
            f"{path}: a signing key has {KEY_BYTES} bytes or {2 * KEY_BYTES} hexadecimal digits; give the key of the "
            "ground station"
        )
    return key
