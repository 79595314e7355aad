"""MicroStrain (Parker, LORD) inertial sensors: MIP packets of the sensor, filter and GNSS data.

Source: MicroStrain MIP documentation, "MIP packets" and the data sets 0x80 (sensor), 0x82 (filter), 0x81 and 0x91
(GNSS): big-endian fields, each behind its length and descriptor; body axes FRD, attitude from NED. Acceleration is
specific force in g.
"""

from __future__ import annotations

import itertools
import math
import re
import struct

from seatrial.daq.protocol.framing import StreamDecoder
from seatrial.daq.protocol.ubx import GPS_EPOCH, WEEK, gps_to_utc
from seatrial.daq.samples import NAN, Ahrs, Frame, Gnss

SYNC = b"\x75\x65"
G = 9.80665  # m/s2, by which the sensor divides
GAUSS = 1e-4  # T
FILTER_S = 1.0  # without an attitude of the filter for so long, the sensor is heard alone
STALE_S = 1.5  # rates, accelerations and field are added to an attitude for no longer
SENSOR, GNSS, FILTER, GNSS_1 = 0x80, 0x81, 0x82, 0x91
_NAN3 = (NAN, NAN, NAN)
_V3, _Q4 = struct.Struct(">3f"), struct.Struct(">4f")
_LLH, _INFO, _TIME = struct.Struct(">4d2fH"), struct.Struct(">BBHH"), struct.Struct(">dHH")
_VELOCITY, _DOP = struct.Struct(">8fH"), struct.Struct(">7fH")
_FIX = {0: 3, 1: 2, 5: 6, 6: 5, 7: 4}  # fix type -> Gnss.fix; 2 is time only, 3 and 4 are none
Fields = dict[int, bytes]


def checksum(packet: bytes) -> bytes:
    """The two bytes of Fletcher's checksum over all bytes before them."""
    return bytes((sum(packet) & 0xFF, sum(itertools.accumulate(packet)) & 0xFF))


def packet(data_set: int, fields: Fields) -> bytes:
    """A packet on the wire."""
    payload = b"".join(bytes((len(data) + 2, kind)) + data for kind, data in fields.items())
    body = SYNC + bytes((data_set, len(payload))) + payload
    return body + checksum(body)


class Decoder(StreamDecoder[Frame]):
    """Packets -> `Ahrs` and `Gnss`.

    There is an `Ahrs` for each filter packet that has an attitude, with the newest rates and accelerations of the
    sensor; as long as there is none of these, one for each sensor packet. `t_device` of a fix is its UTC; an `Ahrs` has
    none.
    """

    sync = re.compile(rb"\x75")

    def __init__(self) -> None:
        super().__init__()
        self._filtered = -math.inf  # when the filter had an attitude last
        self._vectors: dict[str, tuple[tuple[float, ...], float]] = {}  # with the time of receipt

    def reset(self) -> None:
        """Discard an incomplete packet and all received state (the port was reopened). Counters stay."""
        super().reset()
        self._filtered = -math.inf
        self._vectors.clear()

    def _take(self, buffer: bytearray, start: int, t_rx: float) -> int:
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
        fields = _fields(body[4:])
        if fields is None:
            return -1
        self.frames += 1
        if body[2] == SENSOR:
            self._sensor(fields, t_rx)
        elif body[2] == FILTER:
            self._estimate(fields, t_rx)
        elif body[2] in (GNSS, GNSS_1) and len(fields.get(0x03, b"")) == _LLH.size:
            sample = _gnss(fields)
            self._out.append(Frame(sample, t_rx, sample.utc))
        return length

    def _sensor(self, fields: Fields, t_rx: float) -> None:
        for name, kind in (("accel", 0x04), ("rate", 0x05), ("mag", 0x06)):
            if kind in fields:  # each may have a rate of its own, in packets of its own
                self._vectors[name] = _unpack(_V3, fields[kind]) or _NAN3, t_rx
        if t_rx - self._filtered > FILTER_S:
            self._emit(_attitude(fields, quaternion=0x0A, euler=0x0C), t_rx)

    def _estimate(self, fields: Fields, t_rx: float) -> None:
        angles = _attitude(fields, quaternion=0x03, euler=0x05)
        if angles != _NAN3:
            self._filtered = t_rx
            self._emit(angles, t_rx)
        elif 0x03 in fields or 0x05 in fields:  # it has lost it, and says so
            self._filtered = -math.inf

    def _emit(self, angles: tuple[float, ...], t_rx: float) -> None:
        roll, pitch, yaw = angles
        ax, ay, az = (G * a for a in self._newest("accel", t_rx))
        mx, my, mz = (GAUSS * b for b in self._newest("mag", t_rx))
        p, q, r = self._newest("rate", t_rx)
        self._out.append(Frame(Ahrs(yaw, pitch, roll, p, q, r, ax, ay, az, mx, my, mz), t_rx, NAN))

    def _newest(self, name: str, t_rx: float) -> tuple[float, ...]:
        values, when = self._vectors.get(name, (_NAN3, -math.inf))
        return values if t_rx - when <= STALE_S else _NAN3


def _fields(payload: bytes) -> Fields | None:
    """The fields of a payload by descriptor; None where their lengths make no sense."""
    found: Fields = {}
    at = 0
    while at < len(payload):
        length = payload[at]
        if length < 2 or at + length > len(payload):
            return None
        found[payload[at + 1]] = payload[at + 2 : at + length]
        at += length
    return found


def _unpack(form: struct.Struct, data: bytes | None) -> tuple[float, ...] | None:
    """The numbers at the beginning of a field; None where it is missing, too short, or flagged invalid."""
    if data is None or len(data) < form.size:
        return None
    if len(data) == form.size + 2 and not data[-1] & 1:
        return None
    return form.unpack_from(data)


def _attitude(fields: Fields, quaternion: int, euler: int) -> tuple[float, ...]:
    """Roll, pitch, yaw [rad]; NaN where the packet has neither."""
    if (angles := _unpack(_V3, fields.get(euler))) is not None:
        return _NAN3 if math.isnan(sum(angles)) else angles  # before it has a heading a filter calls NaN valid
    if (turn := _unpack(_Q4, fields.get(quaternion))) is None:
        return _NAN3
    w, x, y, z = turn
    pitch = math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0)) if y == y else NAN
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return roll, pitch, math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def _gnss(fields: Fields) -> Gnss:
    lat, lon, _, height, h_acc, _, valid = _LLH.unpack(fields[0x03])
    kind, n_sat, _, told = _INFO.unpack(fields[0x0B]) if len(fields.get(0x0B, b"")) == _INFO.size else (0, 0, 0, 1)
    has_place = bool(valid & 1) and abs(lat) <= 90.0 and abs(lon) <= 180.0
    velocity = _unpack(_VELOCITY, fields.get(0x05)) or ()
    known = int(velocity[8]) if len(velocity) == 9 else 0
    north, east, down = velocity[:3] if known & 1 else _NAN3
    dilution = _unpack(_DOP, fields.get(0x07)) or ()
    tow, week, time_valid = _TIME.unpack(fields[0xD3]) if len(fields.get(0xD3, b"")) == _TIME.size else (0.0, 0, 0)
    utc = gps_to_utc(GPS_EPOCH + WEEK * week + tow) if time_valid & 3 == 3 and 0.0 <= tow < WEEK else NAN
    n_sat = n_sat if told & 2 else -1
    if not has_place:
        return Gnss(utc, NAN, NAN, n_sat=n_sat)
    return Gnss(
        utc, lat, lon, height if valid & 4 else NAN, north, east, down, _FIX.get(kind, 0) if told & 1 else 0, n_sat,
        dilution[2] if len(dilution) == 8 and int(dilution[7]) & 4 else NAN,
        h_acc / math.sqrt(2.0) if valid & 8 else NAN,
        velocity[4] if known & 4 else NAN,
    )  # fmt: skip
