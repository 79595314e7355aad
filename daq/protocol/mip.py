"""MicroStrain (Parker, LORD) inertial sensors: MIP packets of the sensor, filter and GNSS data.

Source: MicroStrain MIP documentation, "MIP packets" and the data sets 0x80 (sensor), 0x82 (filter), 0x81 and 0x91
(GNSS). Each field is big-endian and follows its length and descriptor. Body axes are FRD; the attitude is relative to
NED. Accelerations on the wire are specific force in g.
"""

from __future__ import annotations

import itertools
import math
import re
import struct

from seatrial.daq.geometry import scalar_euler_angles
from seatrial.daq.protocol.framing import StreamDecoder
from seatrial.daq.protocol.ubx import GPS_EPOCH, WEEK, gps_to_utc
from seatrial.daq.samples import NAN, Ahrs, Frame, Gnss

SYNC = b"\x75\x65"
G = 9.80665  # m/s2, the sensor's definition of one g
GAUSS = 1e-4  # T
FILTER_S = 1.0  # s without an attitude of the filter, after which the attitude of the sensor packets is used
STALE_S = 1.5  # s; older rates, accelerations and fields become NaN in a sample
SENSOR, GNSS, FILTER, GNSS_1 = 0x80, 0x81, 0x82, 0x91
_NAN3 = (NAN, NAN, NAN)
_V3, _Q4 = struct.Struct(">3f"), struct.Struct(">4f")
_LLH, _INFO, _TIME = struct.Struct(">4d2fH"), struct.Struct(">BBHH"), struct.Struct(">dHH")
_VELOCITY, _DOP = struct.Struct(">8fH"), struct.Struct(">7fH")
_FIX = {0: 3, 1: 2, 5: 6, 6: 5, 7: 4}  # fix type -> Gnss.fix; 2 is a fix of time only, 3 and 4 are no fix
Fields = dict[int, bytes]


def checksum(packet: bytes) -> bytes:
    """Return the two bytes of Fletcher's checksum of a MIP packet. `packet` is the packet without its checksum."""
    return bytes((sum(packet) & 0xFF, sum(itertools.accumulate(packet)) & 0xFF))


def packet(data_set: int, fields: Fields) -> bytes:
    """Encode a MIP packet with sync bytes and checksum, the fields in the order of the mapping.

    Parameters
    ----------
    data_set
        Number of the data set, for example 0x80 (SENSOR).
    fields
        Content of each field, without length and descriptor, by its descriptor.
    """
    payload = b"".join(bytes((len(data) + 2, kind)) + data for kind, data in fields.items())
    body = SYNC + bytes((data_set, len(payload))) + payload
    return body + checksum(body)


class Decoder(StreamDecoder[Frame]):
    """Decoder of the MIP packets of a MicroStrain inertial sensor to `Ahrs` and `Gnss` samples.

    Each filter packet with a valid attitude gives one `Ahrs` with the newest rates, accelerations and magnetic field of
    the sensor packets. If the filter has sent no valid attitude for 1 s (FILTER_S), or its last attitude was invalid,
    each sensor packet gives one `Ahrs` instead. Each GNSS packet with a position field gives one `Gnss`. `t_device` of
    a fix is its UTC. `t_device` of an `Ahrs` is NaN.
    """

    sync = re.compile(rb"\x75")

    def __init__(self) -> None:
        """Start the decoder of a MicroStrain sensor without received MIP packets."""
        super().__init__()
        self._filtered = -math.inf  # s, t_rx of the last attitude of the filter
        self._vectors: dict[str, tuple[tuple[float, ...], float]] = {}  # name -> newest values, t_rx [s]

    def reset(self) -> None:
        """Discard an incomplete MIP packet and all values from earlier packets, because the port was reopened.

        The counters are kept.
        """
        super().reset()
        self._filtered = -math.inf
        self._vectors.clear()

    def _decode_frame(self, buffer: bytearray, start: int, t_rx: float) -> int:
        """Decode the MIP packet that begins at index `start` of the buffer, and append its samples to `self._out`.

        A valid packet of another data set counts as a frame and gives no sample. A packet with a wrong checksum counts
        as a checksum error. Return the length of the packet in bytes, 0 if more bytes are needed, or -1 if no valid
        packet begins there. `t_rx` is the run time of receipt [s].
        """
        if len(buffer) < start + 4:
            return 0 if SYNC.startswith(buffer[start : start + 2]) else -1
        if buffer[start + 1] != SYNC[1]:
            return -1
        length = 6 + buffer[start + 3]
        if len(buffer) < start + length:
            return 0
        body = bytes(buffer[start : start + length - 2])
        if buffer[start + length - 2 : start + length] != checksum(body):
            self.checksum_errors += 1
            return -1
        fields = _split_fields(body[4:])
        if fields is None:
            return -1
        self.frames += 1
        if body[2] == SENSOR:
            self._take_sensor_packet(fields, t_rx)
        elif body[2] == FILTER:
            self._take_filter_packet(fields, t_rx)
        elif body[2] in (GNSS, GNSS_1) and len(fields.get(0x03, b"")) == _LLH.size:
            sample = _gnss_sample(fields)
            self._out.append(Frame(sample, t_rx, sample.utc))
        return length

    def _take_sensor_packet(self, fields: Fields, t_rx: float) -> None:
        """Store rates, accelerations and magnetic field of a MIP sensor packet, received at run time `t_rx` [s].

        If the filter has sent no valid attitude for 1 s (FILTER_S), or its last attitude was invalid, an `Ahrs` sample
        is appended, with the attitude of this packet or, if it has none, NaN. `fields` are the bytes of the packet's
        fields by descriptor. A vector that the sensor flags as invalid is stored as NaN.
        """
        for name, kind in (("accel", 0x04), ("rate", 0x05), ("mag", 0x06)):
            if kind in fields:  # the vectors may arrive in separate packets with different rates
                self._vectors[name] = _unpack_valid(_V3, fields[kind]) or _NAN3, t_rx
        if t_rx - self._filtered > FILTER_S:
            self._append_sample(_attitude_angles(fields, quaternion=0x0A, euler=0x0C), t_rx)

    def _take_filter_packet(self, fields: Fields, t_rx: float) -> None:
        """Append an `Ahrs` sample for a MIP filter packet with a valid attitude, received at run time `t_rx` [s].

        If its attitude is invalid, no sample is appended, and the sensor packets give samples from now on. A packet
        without an attitude does nothing. `fields` are the bytes of the packet's fields by descriptor.
        """
        angles = _attitude_angles(fields, quaternion=0x03, euler=0x05)
        if angles != _NAN3:
            self._filtered = t_rx
            self._append_sample(angles, t_rx)
        elif 0x03 in fields or 0x05 in fields:  # the filter reports that it has lost the attitude
            self._filtered = -math.inf

    def _append_sample(self, angles: tuple[float, ...], t_rx: float) -> None:
        """Append one `Ahrs` sample with these angles (roll, pitch, yaw) [rad] and no device time.

        The newest rates, accelerations and magnetic field are added in SI units; those older than 1.5 s (STALE_S) at
        run time `t_rx` [s] are NaN.
        """
        roll, pitch, yaw = angles
        ax, ay, az = (G * a for a in self._newest_vector("accel", t_rx))
        mx, my, mz = (GAUSS * b for b in self._newest_vector("mag", t_rx))
        p, q, r = self._newest_vector("rate", t_rx)
        self._out.append(Frame(Ahrs(yaw, pitch, roll, p, q, r, ax, ay, az, mx, my, mz), t_rx, NAN))

    def _newest_vector(self, name: str, t_rx: float) -> tuple[float, ...]:
        """Return the newest vector (3,) "accel" [g], "rate" [rad/s] or "mag" [gauss] of the sensor packets.

        It is NaN if it was never received, or is older than 1.5 s (STALE_S) at run time `t_rx` [s].
        """
        values, when = self._vectors.get(name, (_NAN3, -math.inf))
        return values if t_rx - when <= STALE_S else _NAN3


def _split_fields(payload: bytes) -> Fields | None:
    """Split the payload of a MIP packet into its fields: the bytes of each field by descriptor.

    If a descriptor occurs twice, the last field counts. Return None if the length of a field is invalid.
    """
    fields: Fields = {}
    at = 0
    while at < len(payload):
        length = payload[at]
        if length < 2 or at + length > len(payload):
            return None
        fields[payload[at + 1]] = payload[at + 2 : at + length]
        at += length
    return fields


def _unpack_valid(form: struct.Struct, data: bytes | None) -> tuple[float, ...] | None:
    """Return the numbers at the beginning of a field of a MIP packet, in the format `form`.

    Return None if the field is missing (None), too short, or flagged as invalid by the two bytes after the numbers. A
    field with no, or with more than two, bytes after the numbers counts as valid.
    """
    if data is None or len(data) < form.size:
        return None
    if len(data) == form.size + 2 and not data[-1] & 1:
        return None
    return form.unpack_from(data)


def _attitude_angles(fields: Fields, quaternion: int, euler: int) -> tuple[float, ...]:
    """Return roll, pitch and yaw [rad] from a packet's fields, by Euler angles or else by the quaternion.

    `fields` are the bytes of each field by descriptor. `quaternion` and `euler` are the descriptors of the two fields.
    All angles are NaN if neither field is present and valid, or if one of the Euler angles is NaN; the quaternion is
    then not used.
    """
    if (angles := _unpack_valid(_V3, fields.get(euler))) is not None:
        return _NAN3 if math.isnan(sum(angles)) else angles  # a filter without a heading flags NaN as valid
    if (turn := _unpack_valid(_Q4, fields.get(quaternion))) is None:
        return _NAN3
    w, x, y, z = turn
    yaw, pitch, roll = scalar_euler_angles(x, y, z, w)
    return roll, pitch, yaw


def _gnss_sample(fields: Fields) -> Gnss:
    """Return the fix of a MIP GNSS packet, whose fields must include 0x03 (position). Invalid values are NaN.

    `fields` are the bytes of each field by descriptor. Without a valid position, the sample has only the UTC and the
    number of satellites, with `fix` 0. If the packet lacks the field 0x0B (fix information), `fix` is 3. An unknown
    number of satellites is -1.
    """
    lat, lon, _, height, h_acc, _, valid = _LLH.unpack(fields[0x03])
    kind, n_sat, _, info_valid = (
        _INFO.unpack(fields[0x0B]) if len(fields.get(0x0B, b"")) == _INFO.size else (0, 0, 0, 1)
    )
    has_place = bool(valid & 1) and abs(lat) <= 90.0 and abs(lon) <= 180.0
    velocity = _unpack_valid(_VELOCITY, fields.get(0x05)) or ()
    velocity_valid = int(velocity[8]) if len(velocity) == 9 else 0
    north, east, down = velocity[:3] if velocity_valid & 1 else _NAN3
    dilution = _unpack_valid(_DOP, fields.get(0x07)) or ()
    tow, week, time_valid = _TIME.unpack(fields[0xD3]) if len(fields.get(0xD3, b"")) == _TIME.size else (0.0, 0, 0)
    utc = gps_to_utc(GPS_EPOCH + WEEK * week + tow) if time_valid & 3 == 3 and 0.0 <= tow < WEEK else NAN
    n_sat = n_sat if info_valid & 2 else -1
    if not has_place:
        return Gnss(utc, NAN, NAN, n_sat=n_sat)
    return Gnss(
        utc, lat, lon, height if valid & 4 else NAN, north, east, down,
        _FIX.get(kind, 0) if info_valid & 1 else 0, n_sat,
        dilution[2] if len(dilution) == 8 and int(dilution[7]) & 4 else NAN,
        h_acc / math.sqrt(2.0) if valid & 8 else NAN,
        velocity[4] if velocity_valid & 4 else NAN,
    )  # fmt: skip
