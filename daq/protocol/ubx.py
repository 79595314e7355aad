"""u-blox GNSS receivers: decoder of UBX navigation messages, and of NMEA sentences on the same port.

The messages with one time of week are joined to one `Gnss`. An attitude message becomes one `Ahrs`. All decoded
messages have fixed layouts, so one `struct` per message is enough (docs/decisions/0025-own-codecs.md).
Source: u-blox 8 / M8 Receiver Description (UBX-13003221), "UBX Protocol", class NAV. For messages of older receivers:
u-blox 6 Receiver Description (GPS.G6-SW-10018).
"""

from __future__ import annotations

import calendar
import math
import re
import struct
import time
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from seatrial.daq.geometry import ecef_to_ned, geodetic
from seatrial.daq.protocol import nmea
from seatrial.daq.samples import NAN, Ahrs, Frame, Gnss, wrap_angle

SYNC = b"\xb5\x62"
HEAD = 6  # bytes of sync, class, id and length
LENGTH_MAX = 8192  # bytes of a payload; a larger length means that the header was damaged
NAV_PVT = (0x01, 0x07)
GPS_EPOCH = 315_964_800  # s since 1970, of 1980-01-06
WEEK = 604_800.0  # s
REMEMBERED = 10  # epochs whose kinds of message are expected in the next epoch; some kinds are not sent in each epoch
HIGH_RATE_S = 2.0  # s without HNR-PVT, after which the solutions of the navigation epochs are used again
TIME_ACC_NS = 10_000_000  # ns; without a fix, a time with a larger error is from the receiver's own clock
# s since 1970 of each leap second: GPS time is one more second ahead of UTC from there on (IERS Bulletin C).
LEAPS = tuple(
    calendar.timegm((year, month, 1, 0, 0, 0))
    for year, month in (
        (1981, 7), (1982, 7), (1983, 7), (1985, 7), (1988, 1), (1990, 1), (1991, 1), (1992, 7), (1993, 7), (1994, 7),
        (1996, 1), (1997, 7), (1999, 1), (2006, 1), (2009, 1), (2012, 7), (2015, 7), (2017, 1),
    )
)  # fmt: skip
_PVT = struct.Struct("<IH5BBIi4B4i2I5iIIH")
_POSLLH = struct.Struct("<I4i2I")
_SOL = struct.Struct("<IihBB3iI3iIHBBI")
_VELNED = struct.Struct("<I3iIIi2I")
_TIMEUTC = struct.Struct("<IIiH5BB")
_TIMEGPS = struct.Struct("<IihbBI")
_DOP = struct.Struct("<I7H")
_HPPOSLLH = struct.Struct("<B2xBI4i4b2I")
_ATT = struct.Struct("<IB3x3i3I")
_STATUS = struct.Struct("<I4B2I")
_HNR_PVT = struct.Struct("<IH6Bi2B2x8i4I4x")
HNR_PVT = (0x28, 0x00)
# Class and id of a message -> allowed lengths [bytes] of its payload.
LENGTHS: dict[tuple[int, int], frozenset[int]] = {
    (0x01, 0x07): frozenset({84, 92}), (0x01, 0x02): frozenset({28}), (0x01, 0x06): frozenset({52}),
    (0x01, 0x12): frozenset({36}), (0x01, 0x21): frozenset({20}), (0x01, 0x20): frozenset({16}),
    (0x01, 0x04): frozenset({18}), (0x01, 0x14): frozenset({36}), (0x01, 0x05): frozenset({32}),
    (0x01, 0x03): frozenset({16}), HNR_PVT: frozenset({72}),
}  # fmt: skip
LONGEST = HEAD + max(max(lengths) for lengths in LENGTHS.values()) + 2  # bytes of the longest decoded message
_LENGTHS_OF = {bytes(kind): lengths for kind, lengths in LENGTHS.items()}
_POSITION_IDS = frozenset(
    {0x07, 0x02, 0x06, 0x14}
)  # ids of messages with a position, or with the report that there is none
_FIX = {1: 1, 2: 2, 3: 3, 4: 3}  # gpsFix -> Gnss.fix; 5 is a fix of time only, at a previously measured position
_DIMENSIONS = {1: 3, 2: 2, 3: 3, 4: 3, 5: 3}  # gpsFix -> Gnss.dimensions


class Decoder(nmea.Decoder):
    """Decoder of the UBX messages and NMEA sentences of a u-blox receiver to `Gnss`, `Ahrs` and `Transducer` samples.

    From the first position in UBX on, positions in NMEA of the same stream give no samples. Headings in NMEA, for
    example HDT, are used in any case.

    Parameters
    ----------
    declination
        True heading minus magnetic heading [rad], for magnetic headings in NMEA. None if it is unknown.
    signal_ending
        Ending of the signal names of transducers in NMEA. None if transducers are to be left out.
    """

    sync = re.compile(rb"[$\xb5]")

    def __init__(self, declination: float | None = None, signal_ending: str | None = None) -> None:
        """Start without received messages.

        `declination` (true minus magnetic heading [rad], None if it is unknown) and `signal_ending` (ending of the
        names of transducers, None to leave them out) are for NMEA sentences in the stream.
        """
        super().__init__(declination, signal_ending)
        self._epochs = Epochs()
        # Start and end, in the stream, of valid messages found after a doubtful header, and the end of the searched
        # part. With this record a stream with many doubtful headers is searched once, not once per header.
        self._ahead: deque[tuple[int, int]] = deque()
        self._looked = 0

    def flush(self) -> list[Frame]:
        """Return the GNSS sample of the last epoch (the messages with the same time) at the end of the stream.

        It is from UBX messages, or else from NMEA sentences. The list is empty if it was returned before, or if the
        epoch has no position.
        """
        return self._epochs.flush() or self._filter_frames(super().flush())

    def reset(self) -> None:
        """Discard an incomplete message and values from earlier messages, because the port was reopened.

        The counters, and the date of NMEA sentences, are kept.
        """
        super().reset()
        self._epochs.forget()

    def _decode_frame(self, buffer: bytearray, start: int, t_rx: float) -> int:
        """Decode the UBX message or the NMEA sentence that begins at index `start` of the buffer.

        Its samples are appended to `self._out`. Return its length in bytes, 0 if more bytes are needed, or -1 if no
        valid message begins there. `t_rx` is the run time of receipt [s].
        """
        if buffer[start] == SYNC[0]:
            return self._take_ubx(buffer, start, t_rx)
        return super()._decode_frame(buffer, start, t_rx)

    def _take_ubx(self, buffer: bytearray, start: int, t_rx: float) -> int:
        """Decode the UBX message that begins at index `start` of the buffer, and append its samples to `self._out`.

        A valid message of an unknown kind only counts as a frame. A message of a known kind with another length than
        usual is not valid, nor one of an unknown kind that would contain a known message. A wrong checksum counts as a
        checksum error. Return the length in bytes, 0 if more bytes are needed, or -1 if no valid message begins there.
        `t_rx` is the run time of receipt [s].
        """
        if len(buffer) < start + HEAD:
            return 0 if SYNC.startswith(buffer[start : start + 2]) else -1
        if buffer[start + 1] != SYNC[1]:
            return -1
        n_payload = buffer[start + 4] | buffer[start + 5] << 8
        kind = (buffer[start + 2], buffer[start + 3])
        lengths = LENGTHS.get(kind)
        if n_payload > LENGTH_MAX or (lengths is not None and n_payload not in lengths):
            return -1
        length = HEAD + n_payload + 2
        if lengths is None and self._holds_message(buffer, start + 1, start + length):
            return -1  # the length was damaged; waiting for this end would delay the fixes that follow
        if len(buffer) < start + length:
            return 0
        body = bytes(buffer[start + 2 : start + length - 2])
        if buffer[start + length - 2 : start + length] != checksum(body):
            self.checksum_errors += 1
            return -1
        self.frames += 1
        if lengths is not None:
            self._out += self._epochs.take(kind, body[4:], t_rx)
        return length

    def _holds_message(self, buffer: bytearray, start: int, end: int) -> bool:
        """Return whether a complete UBX message that this module decodes lies between two indices of the buffer.

        It serves to check a header that announces a message between these indices: a payload never contains such a
        message, so the header is then wrong. A message that ends exactly at `end` counts. The messages found are
        stored, so that no part of the stream is searched twice.
        """
        offset = self._before
        while self._ahead and self._ahead[0][0] < offset + start:
            self._ahead.popleft()
        first = max(self._looked - offset, start)
        last = min(end, len(buffer) - LONGEST)  # a decodable message that begins before here is complete
        if first < last:
            self._ahead += [(offset + a, offset + b) for a, b in _find_messages(buffer, first, last)]
            self._looked = offset + last
            first = last
        is_recorded = any(b <= offset + end for a, b in self._ahead)
        return is_recorded or any(b <= end for a, b in _find_messages(buffer, first, end))

    def _filter_frames(self, frames: list[Frame]) -> list[Frame]:
        """Return the samples of NMEA sentences to keep: without fixes if the receiver also sends positions in UBX."""
        return [f for f in frames if not (self._epochs.has_position and isinstance(f.sample, Gnss))]


def _find_messages(buffer: bytearray, start: int, end: int) -> Iterator[tuple[int, int]]:
    """Yield start and end of each complete UBX message that this module decodes, in a part of the buffer.

    A message counts if its length is usual for its kind and its checksum is correct. Only messages that begin at an
    index from `start` up to, not including, `end` are found. Such a message may end behind `end`.
    """
    while (start := buffer.find(SYNC, start, end + 1)) >= 0:
        n_payload = int.from_bytes(buffer[start + 4 : start + HEAD], "little")
        tail = start + HEAD + n_payload
        is_read = n_payload in _LENGTHS_OF.get(bytes(buffer[start + 2 : start + 4]), ())
        if is_read and buffer[tail : tail + 2] == checksum(bytes(buffer[start + 2 : tail])):
            yield start, tail + 2
        start += 1


def checksum(body: bytes) -> bytes:
    """Return the two bytes of Fletcher's checksum (RFC 1145) of a UBX message.

    `body` are the bytes of class, id, length and payload.
    """
    values = np.frombuffer(body, np.uint8).astype(float)  # the sums are whole numbers below 2^53, so they are exact
    return bytes((int(values.sum()) & 0xFF, int(values @ np.arange(len(body), 0.0, -1.0)) & 0xFF))


def message(kind: tuple[int, int], payload: bytes) -> bytes:
    """Encode a UBX message with sync bytes and checksum. `kind` is its class and id, `payload` its content."""
    body = struct.pack("<BBH", *kind, len(payload)) + payload
    return SYNC + body + checksum(body)


def encode(gnss: Gnss) -> bytes:
    """Encode a fix as the UBX message NAV-PVT, with the rounding of the receiver.

    Date, time and UTC are flagged as valid. The accuracy of the height is that of the horizontal position, and that of
    the time is 20 ns; the others are zero. Speed and course follow from the velocity. NaN and a negative `n_sat` are
    sent as zero. The UTC of the fix has to be a number.
    """
    whole = math.floor(gnss.utc)
    nano = round((gnss.utc - whole) * 1e9)
    year, month, day, hour, minute, second = time.gmtime(whole)[:6]
    i_tow = round((gnss.utc + 18 - 315964800) * 1000) % 604_800_000  # GPS time is 18 s ahead of UTC since 2017
    fix = {0: 0, 1: 1, 2: 2}.get(gnss.fix, 2 if gnss.dimensions == 2 else 3)
    flags = (1 if gnss.fix else 0) | (2 if gnss.fix >= 4 else 0) | {6: 0x40, 5: 0x80}.get(gnss.fix, 0)
    h_acc = round(_or_zero(gnss.sigma_h) * math.sqrt(2.0) * 1000)
    north, east, down = (round(_or_zero(v) * 1000) for v in (gnss.vel_n, gnss.vel_e, gnss.vel_d))
    ground = round(math.hypot(north, east))
    course = round(math.degrees(math.atan2(east, north)) % 360.0 * 1e5)
    height = round(_or_zero(gnss.alt) * 1000)
    payload = struct.pack(
        "<IH5BBIi4B4i2I5iIIH", i_tow, year, month, day, hour, minute, second, 0x07, 20, nano, fix, flags, 0,
        max(gnss.n_sat, 0), round(_or_zero(gnss.lon) * 1e7), round(_or_zero(gnss.lat) * 1e7), height, height,
        h_acc, h_acc, north, east, down, ground, course, 0, 0, 0,
    )  # fmt: skip
    return message(NAV_PVT, payload.ljust(92, b"\0"))


def _or_zero(value: float) -> float:
    """Return a number unchanged, and 0 for NaN."""
    return 0.0 if math.isnan(value) else value


@dataclass
class _Epoch:
    """Values of the received UBX messages of one epoch, which have the same time of week.

    Attributes
    ----------
    i_tow
        Time of week [ms].
    t_rx
        Run time of receipt of the first message [s].
    kinds
        Ids of the received messages.
    values
        Values by name, in SI units; latitude and longitude are in degrees.
    """

    i_tow: int
    t_rx: float
    kinds: set[int] = field(default_factory=set)
    values: dict[str, float] = field(default_factory=dict)


class Epochs:
    """Collector of UBX navigation messages: it joins the messages of one epoch (one time of week) to one `Gnss` sample.

    An epoch is complete when all kinds of message of the last 10 epochs have been received, or when the next epoch
    begins. Position and velocity without a valid fix (gnssFixOK not set) are kept with `fix` 0. While the receiver
    sends HNR-PVT (solutions at the rate of its inertial sensors), each of these messages gives a sample, and the epochs
    give none.

    `t_rx` of a sample is the time of receipt of the epoch's first message. `t_device` is the UTC of the epoch. It is
    NaN until the receiver has resolved UTC, because its own clock may be wrong by seconds before.

    Attributes
    ----------
    has_position : bool
        Whether a message of a kind that contains a position has been received.
    """

    def __init__(self) -> None:
        """Start the collector of UBX navigation messages without received messages."""
        self.has_position = False  # whether a message with a position has been received
        self._epoch: _Epoch | None = None
        self._emitted = False  # whether the sample of the present epoch has been returned
        self._kinds: deque[set[int]] = deque(maxlen=REMEMBERED)  # kinds of message of the last epochs
        self._expected: set[int] = set()  # union of the last epochs' kinds
        self._high_rate_at = -math.inf  # s, t_rx of the last HNR-PVT
        self._utc, self._utc_tow = NAN, 0  # of the last epoch: UTC [s since 1970], time of week [ms]

    def take(self, kind: tuple[int, int], payload: bytes, t_rx: float) -> list[Frame]:
        """Decode one UBX navigation message. Return the samples that it completes.

        Parameters
        ----------
        kind
            Class and id of the message, one of LENGTHS.
        payload
            Content of the message, with a length that LENGTHS allows.
        t_rx
            Run time [s] of receipt.

        Returns
        -------
        list of Frame
            An `Ahrs` for an attitude message, with its UTC as device time, or the `Gnss` samples of completed epochs.
            The list may be empty.
        """
        number = kind[1]
        if kind == HNR_PVT:
            return self._take_high_rate(payload, t_rx)
        if number == 0x05:
            utc = self._utc_of(struct.unpack_from("<I", payload)[0])
            return [frame._replace(t_device=utc) for frame in _attitude_sample(payload, t_rx)]
        self.has_position = self.has_position or number in _POSITION_IDS
        (i_tow,) = struct.unpack_from("<I", payload, 4 if number == 0x14 else 0)
        out: list[Frame] = []
        if self._epoch is None or self._epoch.i_tow != i_tow:
            out = self.flush()
            if self._epoch is not None:
                self._kinds.append(self._epoch.kinds)
                self._expected = set().union(*self._kinds)
            self._epoch, self._emitted = _Epoch(i_tow, t_rx), False
        self._epoch.kinds.add(number)
        _READERS[number](self._epoch.values, payload)
        if self._expected and self._epoch.kinds >= self._expected:
            out += self.flush()
        return out

    def flush(self) -> list[Frame]:
        """Return the GNSS sample of the present epoch (the UBX messages with the same time of week).

        The list is empty if the epoch has no position message, if its sample has been returned before, or if an HNR-PVT
        message was received in the 2 s (HIGH_RATE_S) before the first message of the epoch, or later.
        """
        epoch = self._epoch
        if epoch is None or self._emitted or not epoch.kinds & _POSITION_IDS:
            return []
        self._emitted = True
        sample, resolved = _gnss_sample(epoch.values), not epoch.values.get("unresolved")
        if math.isfinite(sample.utc) and resolved:
            self._utc, self._utc_tow = sample.utc, epoch.i_tow
        if epoch.t_rx - self._high_rate_at <= HIGH_RATE_S:
            return []
        if math.isnan(sample.utc):
            sample = replace(sample, utc=self._utc_of(epoch.i_tow))
        return [Frame(sample, epoch.t_rx, sample.utc if resolved else NAN)]

    def _take_high_rate(self, payload: bytes, t_rx: float) -> list[Frame]:
        """Return the sample of the UBX message HNR-PVT, a solution at the rate of the inertial sensors.

        These samples replace the samples of the navigation epochs. The device time is the UTC, NaN until the receiver
        has resolved UTC. `t_rx` is the run time of receipt [s].
        """
        self.has_position, self._high_rate_at = True, t_rx
        sample, resolved = _hnr_pvt_sample(payload), payload[11] & 7 == 7
        if math.isfinite(sample.utc) and resolved:
            self._utc, self._utc_tow = sample.utc, struct.unpack_from("<I", payload)[0]
        return [Frame(sample, t_rx, sample.utc if resolved else NAN)]

    def _utc_of(self, i_tow: int) -> float:
        """Return the UTC [s since 1970] of a GPS time of week [ms]; NaN before the first epoch with a resolved UTC.

        The week is the one in which the result is nearest to the UTC of the newest such epoch.
        """
        return self._utc + math.remainder(1e-3 * (i_tow - self._utc_tow), WEEK)

    def forget(self) -> None:
        """Discard all values from earlier UBX messages: a reopened port may have another receiver or configuration."""
        self._epoch, self._emitted, self.has_position = None, False, False
        self._kinds.clear()
        self._expected = set()
        self._high_rate_at = -math.inf
        self._utc, self._utc_tow = NAN, 0


def _gnss_sample(v: dict[str, float]) -> Gnss:
    """Return the `Gnss` sample of the values of one UBX epoch, `v`, by name. Missing values are NaN.

    A value from a more precise message has priority. If no message reports a solution with a position, or if the
    position is out of range, all values except UTC, number of satellites and HDOP are NaN, with `fix` 0.
    """
    fix = int(v.get("fix", v.get("sol_fix", v.get("status_fix", 0))))
    lat, lon = (v.get(f"hp_{name}", v.get(name, v.get(f"sol_{name}", NAN))) for name in ("lat", "lon"))
    has_place = "place" in v and abs(lat) <= 90.0 and abs(lon) <= 180.0
    fix, lat, lon = (fix, lat, lon) if has_place else (0, NAN, NAN)
    return Gnss(
        v.get("utc", v.get("sol_utc", NAN)), lat, lon,
        alt=v.get("hp_alt", v.get("alt", NAN)) if has_place else NAN,
        vel_n=v.get("vel_n", v.get("sol_vel_n", NAN)) if has_place else NAN,
        vel_e=v.get("vel_e", v.get("sol_vel_e", NAN)) if has_place else NAN,
        vel_d=v.get("vel_d", v.get("sol_vel_d", NAN)) if has_place else NAN,
        fix=fix,
        n_sat=int(v.get("n_sat", -1)),
        hdop=v.get("hdop", NAN),
        sigma_h=v.get("hp_sigma", v.get("sigma", NAN)) if has_place else NAN,
        dimensions=int(v["place"]) if has_place else 0,
    )  # fmt: skip


def _attitude_sample(payload: bytes, t_rx: float) -> list[Frame]:
    """Return the `Ahrs` sample of the UBX message NAV-ATT, without a device time; no sample if no angle is valid.

    An angle is NaN if its accuracy in the message is zero or at least half a turn. `t_rx` is the run time of receipt
    [s].
    """
    _, _, roll, pitch, heading, acc_roll, acc_pitch, acc_heading = _ATT.unpack(payload)
    # The accuracy of an invalid angle is 0 (M8) or at least half a turn.
    valid = [0 < acc < 180e5 for acc in (acc_heading, acc_pitch, acc_roll)]
    yaw, pitch, roll = (
        wrap_angle(math.radians(1e-5 * angle)) if ok else NAN
        for angle, ok in zip((heading, pitch, roll), valid, strict=True)
    )
    return [Frame(Ahrs(yaw, pitch, roll), t_rx, NAN)] if any(valid) else []


def _read_pvt(v: dict[str, float], payload: bytes) -> None:
    """Store time, fix, satellites, position and velocity of the UBX message NAV-PVT in `v`.

    `v` are the values of its epoch by name. The fix is numbered as in `Gnss.fix`. It is 5 if the carrier phase solution
    is fixed (RTK fixed), 6 if it is floating (RTK float), and 4 with differential corrections only. It is 0 unless the
    receiver marks the fix as valid. The UTC is stored if date and time are valid. `unresolved` is then true if the UTC
    may still be wrong: it is not fully resolved, or there is no fix and its error is above 10 ms.
    """
    (
        _, year, month, day, hour, minute, second, valid, t_acc, nano, fix, flags, _, n_sat, lon, lat, _, h_msl, h_acc,
        _, vel_n, vel_e, vel_d, *_,
    ) = _PVT.unpack_from(payload)  # fmt: skip
    v["fix"] = 0
    if fix in _DIMENSIONS:
        v["place"] = _DIMENSIONS[fix]
    if flags & 1:  # gnssFixOK
        carrier = flags >> 6
        v["fix"] = {1: 6, 2: 5}.get(carrier) or (4 if flags & 2 and fix in (2, 3, 4) else _FIX.get(fix, 0))
    if valid & 3 == 3:  # date and time
        v["utc"] = _utc(year, month, day, hour, minute, second, nano)
        v["unresolved"] = not valid & 4 or not (v["fix"] or t_acc <= TIME_ACC_NS)
    v["n_sat"] = n_sat
    v["lat"], v["lon"], v["alt"], v["sigma"] = 1e-7 * lat, 1e-7 * lon, 1e-3 * h_msl, 1e-3 * h_acc / math.sqrt(2.0)
    v["vel_n"], v["vel_e"], v["vel_d"] = 1e-3 * vel_n, 1e-3 * vel_e, 1e-3 * vel_d


def _read_posllh(v: dict[str, float], payload: bytes) -> None:
    """Store the position of the UBX message NAV-POSLLH in `v`, the values of its epoch by name.

    The message does not report the kind of fix.
    """
    _, lon, lat, _, h_msl, h_acc, _ = _POSLLH.unpack(payload)
    v["lat"], v["lon"], v["alt"], v["sigma"] = 1e-7 * lat, 1e-7 * lon, 1e-3 * h_msl, 1e-3 * h_acc / math.sqrt(2.0)


def _read_hpposllh(v: dict[str, float], payload: bytes) -> None:
    """Store the position of the UBX message NAV-HPPOSLLH, with a resolution of 0.1 mm, in `v`, the values of its epoch.

    Nothing is stored if the receiver flags the position as invalid.
    """
    _, invalid, _, lon, lat, _, h_msl, lon_hp, lat_hp, _, h_msl_hp, h_acc, _ = _HPPOSLLH.unpack(payload)
    if not invalid & 1:
        v["hp_lat"], v["hp_lon"] = 1e-7 * lat + 1e-9 * lat_hp, 1e-7 * lon + 1e-9 * lon_hp
        v["hp_alt"], v["hp_sigma"] = 1e-3 * h_msl + 1e-4 * h_msl_hp, 1e-4 * h_acc / math.sqrt(2.0)


def _read_sol(v: dict[str, float], payload: bytes) -> None:
    """Store the values of the UBX message NAV-SOL, from older receivers, in `v`, the values of its epoch by name.

    Position and velocity are converted from ECEF to latitude, longitude, north, east and down. The fix is 0 unless the
    receiver marks it as valid.
    """
    i_tow, f_tow, week, fix, flags, x, y, z, _, vel_x, vel_y, vel_z, *_, n_sat, _ = _SOL.unpack(payload)
    v["sol_fix"] = 0
    if fix in _DIMENSIONS:
        v["place"] = _DIMENSIONS[fix]
    if flags & 1:
        v["sol_fix"] = 4 if flags & 2 and fix in (2, 3, 4) else _FIX.get(fix, 0)
    if flags & 0x0C == 0x0C and week > 0:  # week and time of week are valid
        v["sol_utc"] = gps_to_utc(GPS_EPOCH + week * WEEK + 1e-3 * i_tow + 1e-9 * f_tow)
    v["n_sat"] = n_sat
    v["sol_lat"], v["sol_lon"] = lat, lon = geodetic(1e-2 * x, 1e-2 * y, 1e-2 * z)
    v["sol_vel_n"], v["sol_vel_e"], v["sol_vel_d"] = ecef_to_ned(1e-2 * vel_x, 1e-2 * vel_y, 1e-2 * vel_z, lat, lon)


def _read_status(v: dict[str, float], payload: bytes) -> None:
    """Store the kind of fix of the UBX message NAV-STATUS in `v`, the values of its epoch by name.

    The fix is 0 unless the receiver marks it as valid.
    """
    _, fix, flags, *_ = _STATUS.unpack(payload)
    v["status_fix"] = 0
    if fix in _DIMENSIONS:
        v["place"] = _DIMENSIONS[fix]
    if flags & 1:
        v["status_fix"] = 4 if flags & 2 and fix in (2, 3, 4) else _FIX.get(fix, 0)


def _hnr_pvt_sample(payload: bytes) -> Gnss:
    """Return the `Gnss` sample of the UBX message HNR-PVT, a solution at the rate of the inertial sensors.

    Position, height, accuracy and velocity are NaN, and `fix` is 0, without a solution. `fix` is also 0 if the receiver
    does not mark the solution as valid. The UTC is NaN without a valid date and time, and the vertical velocity always.
    The velocity follows from ground speed and course.
    """
    (
        _, year, month, day, hour, minute, second, valid, nano, gps_fix, flags, lon, lat, _, h_msl, ground, _, course,
        _, h_acc, *_,
    ) = _HNR_PVT.unpack(payload)  # fmt: skip
    fix = (4 if flags & 2 and gps_fix in (2, 3, 4) else _FIX.get(gps_fix, 0)) if flags & 1 else 0
    has_place = gps_fix in _DIMENSIONS and abs(lat) <= 90e7 and abs(lon) <= 180e7
    heading = math.radians(1e-5 * course)
    return Gnss(
        _utc(year, month, day, hour, minute, second, nano) if valid & 3 == 3 else NAN,
        1e-7 * lat if has_place else NAN, 1e-7 * lon if has_place else NAN,
        alt=1e-3 * h_msl if has_place else NAN,
        vel_n=1e-3 * ground * math.cos(heading) if has_place else NAN,
        vel_e=1e-3 * ground * math.sin(heading) if has_place else NAN,
        fix=fix if has_place else 0,
        sigma_h=1e-3 * h_acc / math.sqrt(2.0) if has_place else NAN,
        dimensions=_DIMENSIONS[gps_fix] if has_place else 0,
    )  # fmt: skip


def _read_velned(v: dict[str, float], payload: bytes) -> None:
    """Store the velocity north, east and down [m/s] of the UBX message NAV-VELNED in `v`, the values of its epoch."""
    _, north, east, down, *_ = _VELNED.unpack(payload)
    v["vel_n"], v["vel_e"], v["vel_d"] = 1e-2 * north, 1e-2 * east, 1e-2 * down


def _read_timeutc(v: dict[str, float], payload: bytes) -> None:
    """Store the UTC of the UBX message NAV-TIMEUTC in `v`, the values of its epoch, if the receiver has resolved it.

    A UTC that the epoch has from another message is replaced.
    """
    _, _, nano, year, month, day, hour, minute, second, valid = _TIMEUTC.unpack(payload)
    if valid & 4:  # UTC is valid, leap seconds included
        v["utc"] = _utc(year, month, day, hour, minute, second, nano)


def _read_timegps(v: dict[str, float], payload: bytes) -> None:
    """Store the UTC of the UBX message NAV-TIMEGPS in `v`, the values of its epoch by name.

    Nothing is stored if the time is not valid, or if another message of the epoch has a UTC.
    """
    i_tow, f_tow, week, leap, valid, _ = _TIMEGPS.unpack(payload)
    if valid & 7 == 7:  # time of week, week and leap seconds are valid
        v.setdefault("utc", GPS_EPOCH + week * WEEK + 1e-3 * i_tow + 1e-9 * f_tow - leap)


def _read_dop(v: dict[str, float], payload: bytes) -> None:
    """Store the horizontal dilution of precision of the UBX message NAV-DOP in `v`, the values of its epoch."""
    v["hdop"] = _DOP.unpack(payload)[5] / 100.0


def _utc(year: int, month: int, day: int, hour: int, minute: int, second: int, nano: int) -> float:
    """Return the UTC in s since 1970 of a date and time of day.

    The result is NaN if the year is not 1980..2105, or if month or day is out of range (1..12, 1..31). The time of day
    is not checked. `nano` is the fraction of the second [ns], which may be negative.
    """
    if not (1980 <= year < 2106 and 1 <= month <= 12 and 1 <= day <= 31):
        return NAN
    return calendar.timegm((year, month, day, hour, minute, second)) + 1e-9 * nano


def gps_to_utc(seconds: float) -> float:
    """Convert GPS time to UTC in s since 1970, by the leap seconds up to 2017.

    `seconds` is the GPS time as s since 1970 of a clock that has no leap seconds and agreed with UTC in 1980.
    """
    return seconds - bisect_right([leap + k for k, leap in enumerate(LEAPS, start=1)], seconds)


_READERS: dict[int, Callable[[dict[str, float], bytes], None]] = {
    0x07: _read_pvt, 0x02: _read_posllh, 0x14: _read_hpposllh, 0x06: _read_sol, 0x12: _read_velned,
    0x21: _read_timeutc, 0x20: _read_timegps, 0x04: _read_dop, 0x03: _read_status,
}  # fmt: skip
