"""VectorNav VN-100/200/300: ASCII sentences and binary messages.

Source: VN-100 User Manual UM001 and VN-300 User Manual UM005: asynchronous ASCII outputs, and "Binary Output Messages"
with the tables of groups 1 to 7. In ASCII and binary messages, angles are in degrees and magnetic fields in gauss. The
scalar of a quaternion is its last element. Acceleration is specific force in body axes (FRD), at rest about
(0, 0, -9.8) m/s2.
"""

from __future__ import annotations

import functools
import math
import re
import struct
from typing import NamedTuple

from seatrial.daq.geometry import scalar_euler_angles
from seatrial.daq.protocol.framing import StreamDecoder, crc16, sentence, take_sentence
from seatrial.daq.samples import NAN, Ahrs, Frame

SYNC = 0xFA
GAUSS = 1e-4  # T
DEG = math.pi / 180.0

# Bytes of each field by group, bit 0 first. A message with a bit beyond these fields is invalid.
GROUP_FIELDS: tuple[tuple[int, ...], ...] = (
    (8, 8, 8, 12, 16, 12, 24, 12, 12, 24, 20, 28, 2, 4, 8),  # 1 common
    (8, 8, 8, 2, 8, 8, 8, 4, 4, 1),  # 2 time
    (2, 12, 12, 12, 4, 4, 16, 12, 12, 12, 12, 2),  # 3 IMU
    (8, 8, 2, 1, 1, 24, 24, 12, 12, 12, 4, 4, 2, 28),  # 4 GNSS
    (2, 12, 16, 36, 12, 12, 12, 12, 12, 12, 28, 24),  # 5 attitude
    (2, 24, 24, 12, 12, 12, 12, 12, 12, 4, 4),  # 6 INS
    (8, 8, 2, 1, 1, 24, 24, 12, 12, 12, 4, 4, 2, 28),  # 7 GNSS 2
)
# Fields that are read: group, bit, quantity, offset [bytes] in the field. If a message contains a quantity twice
# (compensated and uncompensated), the first row of this table is used.
KEPT: tuple[tuple[int, int, str, int], ...] = (
    (0, 0, "startup", 0), (1, 0, "startup", 0),
    (0, 3, "ypr", 0), (4, 1, "ypr", 0),
    (0, 4, "quaternion", 0), (4, 2, "quaternion", 0),
    (0, 5, "rate", 0), (2, 10, "rate", 0), (0, 9, "rate", 12), (2, 3, "rate", 0),
    (0, 8, "accel", 0), (2, 9, "accel", 0), (0, 9, "accel", 0), (2, 2, "accel", 0),
    (0, 10, "mag", 0), (2, 8, "mag", 0), (2, 1, "mag", 0),
)  # fmt: skip
_FORMAT = {"startup": "<Q", "ypr": "<3f", "quaternion": "<4f", "rate": "<3f", "accel": "<3f", "mag": "<3f"}

# Sentence -> its first fields with their number of words. Other fields may follow (temperature, pressure, counters).
ASCII_FIELDS: dict[bytes, tuple[tuple[str, int], ...]] = {
    b"VNYMR": (("ypr", 3), ("mag", 3), ("accel", 3), ("rate", 3)),
    b"VNQMR": (("quaternion", 4), ("mag", 3), ("accel", 3), ("rate", 3)),
    b"VNIMU": (("mag", 3), ("accel", 3), ("rate", 3)),
    b"VNMAR": (("mag", 3), ("accel", 3), ("rate", 3)),
    b"VNYPR": (("ypr", 3),),
    b"VNQTN": (("quaternion", 4),),
}
_NUMBER = re.compile(rb"[+-]?\d+(\.\d*)?\Z")

Values = dict[str, tuple[float, ...]]


class MessageLayout(NamedTuple):
    """Layout of a binary message of a VectorNav sensor.

    Attributes
    ----------
    header
        Length of sync byte and header together [bytes].
    length
        Length of the whole message with its checksum [bytes].
    fields
        Quantity (such as "rate"), format and offset [bytes] in the message, of each field that is read.
    """

    header: int
    length: int
    fields: tuple[tuple[str, struct.Struct, int], ...]


@functools.lru_cache(maxsize=256)
def message_layout(header: bytes) -> MessageLayout | None:
    """Return the layout of a binary message of a VectorNav sensor: its length and the places of the fields to read.

    Parameters
    ----------
    header
        Bytes after the sync byte: one byte of groups, then one 16-bit word of fields for each group.

    Returns
    -------
    MessageLayout or None
        None if the header contains a field that does not exist, or no field. If several fields contain a quantity, the
        first in the order of `KEPT` is read.
    """
    places: dict[tuple[int, int], int] = {}
    offset = 1 + len(header)
    words = iter(struct.unpack(f"<{(len(header) - 1) // 2}H", header[1:]))
    for group, fields in enumerate(GROUP_FIELDS):
        if header[0] >> group & 1:
            word = next(words)
            for bit in range(16):
                if word >> bit & 1:
                    if bit >= len(fields):
                        return None
                    places[group, bit] = offset
                    offset += fields[bit]
    if not places:
        return None
    kept: dict[str, tuple[str, struct.Struct, int]] = {}
    for group, bit, quantity, inside in KEPT:
        if (group, bit) in places and quantity not in kept:
            kept[quantity] = (quantity, struct.Struct(_FORMAT[quantity]), places[group, bit] + inside)
    return MessageLayout(1 + len(header), offset + 2, tuple(kept.values()))


class Decoder(StreamDecoder[Frame]):
    """Decoder of the ASCII and binary messages of a VectorNav sensor to `Ahrs` samples.

    One stream may contain both kinds. `t_device` is TimeStartup, the time since the start of the sensor [s], of a
    binary message. It is NaN if the message lacks this field, and for ASCII messages. Values that a message lacks are
    NaN. A valid message without any of the read quantities counts as a frame and gives no sample.
    """

    sync = re.compile(rb"[$\xfa]")

    def _decode_frame(self, buffer: bytearray, start: int, t_rx: float) -> int:
        """Decode the VectorNav message, ASCII or binary, that begins at index `start` of the buffer.

        Its sample is appended to `self._out`. Return its length in bytes, 0 if more bytes are needed, or -1 if no valid
        message begins there. `t_rx` is the run time of receipt [s].
        """
        return (
            self._take_binary(buffer, start, t_rx) if buffer[start] == SYNC else self._take_ascii(buffer, start, t_rx)
        )

    def _take_binary(self, buffer: bytearray, start: int, t_rx: float) -> int:
        """Decode the binary VectorNav message that begins at index `start` of the buffer.

        Its sample is appended to `self._out`; a message without any of the read quantities gives none. A wrong checksum
        counts as a checksum error. Return the length of the message in bytes, 0 if more bytes are needed, or -1 if no
        valid message begins there. `t_rx` is the run time of receipt [s].
        """
        if len(buffer) < start + 2:
            return 0
        groups = buffer[start + 1]
        if groups == 0 or groups & 0x80:
            return -1
        header_end = start + 2 + 2 * groups.bit_count()
        if len(buffer) < header_end:
            return 0
        layout = message_layout(bytes(buffer[start + 1 : header_end]))
        if layout is None:
            return -1
        if len(buffer) < start + layout.length:
            return 0
        message = bytes(buffer[start : start + layout.length])
        if crc16(message[1:]) != 0:  # the CRC of a message together with its own CRC is zero
            self.checksum_errors += 1
            return -1
        self.frames += 1
        values: Values = {quantity: form.unpack_from(message, at) for quantity, form, at in layout.fields}
        t_device = values.pop("startup", (NAN,))[0] * 1e-9
        if values:
            self._out.append(Frame(_ahrs_sample(values), t_rx, t_device))
        return layout.length

    def _take_ascii(self, buffer: bytearray, start: int, t_rx: float) -> int:
        """Decode the ASCII sentence of a VectorNav sensor that begins at index `start` of the buffer.

        Its sample is appended to `self._out`. Return its length in bytes, 0 if more bytes are needed, or -1 if it is
        invalid. A wrong checksum counts as a checksum error. A sentence of an unknown kind is counted as a frame and
        gives no sample. `t_rx` is the run time of receipt [s].
        """
        length, body, bad = take_sentence(buffer, start)
        self.checksum_errors += bad
        if body is None:
            return length
        words = body.split(b",")
        fields = ASCII_FIELDS.get(words[0])
        if fields is not None:
            values = _split_numbers(words[1:], fields)
            if values is None:
                return -1
            self._out.append(Frame(_ahrs_sample(values), t_rx, NAN))
        self.frames += 1
        return length


def _split_numbers(words: list[bytes], fields: tuple[tuple[str, int], ...]) -> Values | None:
    """Return the numbers of a VectorNav ASCII sentence by quantity. Return None if a word is missing or not a number.

    `words` are the fields of the sentence after its name. `fields` are the quantities in order, each with its number of
    words. Further words are ignored. Empty words and exponents are no numbers.
    """
    values: Values = {}
    at = 0
    for quantity, count in fields:
        part = words[at : at + count]
        if len(part) < count or not all(_NUMBER.match(word) for word in part):
            return None
        values[quantity] = tuple(map(float, part))
        at += count
    return values


_NAN3 = (NAN, NAN, NAN)


def _ahrs_sample(values: Values) -> Ahrs:
    """Return the `Ahrs` sample of one VectorNav message in SI units.

    `values` are the numbers by quantity: "ypr" [deg], or else "quaternion", for the attitude, "rate" [rad/s], "accel"
    [m/s2], "mag" [gauss]. Missing ones become NaN.
    """
    if "ypr" in values:
        yaw, pitch, roll = (angle * DEG for angle in values["ypr"])
    elif "quaternion" in values:
        yaw, pitch, roll = scalar_euler_angles(*values["quaternion"])
    else:
        yaw, pitch, roll = _NAN3
    p, q, r = values.get("rate", _NAN3)
    ax, ay, az = values.get("accel", _NAN3)
    mx, my, mz = (b * GAUSS for b in values.get("mag", _NAN3))
    return Ahrs(yaw, pitch, roll, p, q, r, ax, ay, az, mx, my, mz)


def encode_ascii(ahrs: Ahrs) -> bytes:
    """Encode a sample as the VectorNav sentence $VNYMR, with the rounding of the device.

    The sentence contains attitude, magnetic field, specific force and rates. NaN is sent as zero, because the sentence
    cannot contain an empty field.
    """
    yaw, pitch, roll = (_or_zero(angle) / DEG for angle in (ahrs.yaw, ahrs.pitch, ahrs.roll))
    mag = [_or_zero(b) / GAUSS for b in (ahrs.mx, ahrs.my, ahrs.mz)]
    accel = [_or_zero(a) for a in (ahrs.ax, ahrs.ay, ahrs.az)]
    rate = [_or_zero(w) for w in (ahrs.p, ahrs.q, ahrs.r)]
    words = [f"{angle:+08.3f}" for angle in (yaw, pitch, roll)]
    words += [f"{b:+08.4f}" for b in mag] + [f"{a:+07.3f}" for a in accel] + [f"{w:+010.6f}" for w in rate]
    return sentence("VNYMR," + ",".join(words))


# Common group: TimeStartup, YawPitchRoll, AngularRate, Accel, and MagPres if the magnetic field is sent.
_BINARY = (1 << 0) | (1 << 3) | (1 << 5) | (1 << 8)
_BINARY_MAG = _BINARY | (1 << 10)


def encode_binary(ahrs: Ahrs, t_device: float) -> bytes:
    """Encode a sample as a binary VectorNav message of the common group: time, attitude, rates and specific force.

    The message contains MagPres if the magnetic field is not NaN. Its temperature and pressure are zero.

    Parameters
    ----------
    ahrs
        Sample without NaN, except in the magnetic field.
    t_device
        Time of sending since the start of the device [s], not negative.
    """
    with_mag = not math.isnan(ahrs.mx)
    body = struct.pack("<BH", 1, _BINARY_MAG if with_mag else _BINARY)
    body += struct.pack("<Q", round(t_device * 1e9))
    body += struct.pack("<3f", ahrs.yaw / DEG, ahrs.pitch / DEG, ahrs.roll / DEG)
    body += struct.pack("<6f", ahrs.p, ahrs.q, ahrs.r, ahrs.ax, ahrs.ay, ahrs.az)
    if with_mag:
        body += struct.pack("<5f", ahrs.mx / GAUSS, ahrs.my / GAUSS, ahrs.mz / GAUSS, 0.0, 0.0)
    return bytes([SYNC]) + body + struct.pack(">H", crc16(body))


def _or_zero(value: float) -> float:
    """Return a number unchanged, and 0 for NaN."""
    return 0.0 if math.isnan(value) else value
