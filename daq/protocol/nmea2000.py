"""NMEA 2000: decoder of heading, rate of turn, attitude and GNSS from a ship's bus to `Ahrs` and `Gnss` samples.

Source of the messages' fields: canboat (canboat.github.io/canboat/canboat.html). Source of identifiers and addresses:
ISO 11783-3. A message longer than a CAN frame is sent as a fast packet. The first byte of each frame contains the
number of the packet (3 bits) and of the frame (5 bits). The second byte of the first frame is the message's length.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass

from seatrial.daq.protocol.canframe import FRAME_BYTES, FrameDecoder
from seatrial.daq.samples import NAN, Ahrs, Frame, Gnss, wrap_angle

# Numbers of the messages (PGN).
HEADING, TURN, ATTITUDE, VARIATION, COURSE, FIX, DOPS = 127250, 127251, 127257, 127258, 129026, 129029, 129539
# s; older attitudes and courses are not added to a heading or fix, and a sender silent for longer loses its priority.
STALE_S = 2.0
SETTLE_S = 1.2  # s in which the senders of a message are collected; most devices send each message once a second
MAGNETIC = 1  # direction reference; 0 is true, 2 an error
_HEADING = struct.Struct("<xHhhB")  # heading, deviation, variation, reference
_TURN = struct.Struct("<xi")
_ATTITUDE = struct.Struct("<xhhh")  # yaw, pitch, roll
_VARIATION = struct.Struct("<xBHh")  # source, age, variation
_COURSE = struct.Struct("<xBHH")  # reference, course, speed over ground
_DOPS = struct.Struct("<xB")  # 3 bits of the desired mode, 3 bits of the actual mode
# Date, time, latitude, longitude, altitude, type and method, integrity, satellites, HDOP, PDOP, height of the geoid.
_FIX = struct.Struct("<xHIqqqBBBhhi")
# Resolutions of the fields: rad, m/s, rad/s, deg, m, s.
_ANGLE, _SPEED, _RATE, _PLACE, _HEIGHT, _TICK = 1e-4, 0.01, 1e-6 / 32.0, 1e-16, 1e-6, 1e-4
_DAY = 86400.0  # s
_METHOD = {0: 0, 1: 3, 2: 4, 3: 3, 4: 5, 5: 6, 6: 1, 7: 1, 8: 3}  # method of FIX -> Gnss.fix
_DIMENSIONS = {1: 2, 2: 3}  # mode of DOPS -> Gnss.dimensions
_PRIORITY = {HEADING: 2, TURN: 2, ATTITUDE: 3, VARIATION: 7, COURSE: 2, FIX: 3}


def identifier(pgn: int, source: int) -> int:
    """Return the 29-bit CAN identifier of a message of NMEA 2000 from address `source` to all addresses.

    `pgn` is the number of the message. The priority is that of the standard for the messages that `encode` sends, and
    for the variation; it is 6 for any other message.
    """
    return _PRIORITY.get(pgn, 6) << 26 | pgn << 8 | source


def split_identifier(word: int) -> tuple[int, int]:
    """Return the message number (PGN) and the source address in a 29-bit CAN identifier of NMEA 2000.

    The destination address, which some identifiers contain, is left out.
    """
    pgn = word >> 8 & 0x3FFFF
    return (pgn if pgn >> 8 & 0xFF >= 0xF0 else pgn & ~0xFF), word & 0xFF


@dataclass
class _Packet:
    """Received frames of an incomplete fast packet: an NMEA 2000 message that is longer than one CAN frame.

    Attributes
    ----------
    sequence
        Number of the packet, 0 to 7.
    length
        Length of the message [bytes].
    frames
        Number of received frames.
    data
        Received bytes of the message.
    """

    sequence: int
    length: int
    frames: int
    data: bytearray


class Decoder(FrameDecoder):
    """Decoder of the CAN frames of a ship's bus (NMEA 2000) to `Ahrs` and `Gnss` samples.

    A heading gives one `Ahrs` with the newest pitch and roll. A rate of turn gives a separate `Ahrs`. A fix gives one
    `Gnss`. Its velocity is the newest course and speed over ground of the same sender, or of the best other sender if
    this one sends none. `t_device` of a fix is its UTC, NaN before the first fix of its sender; that of an `Ahrs` is
    NaN.

    If several senders send a heading, rate of turn, attitude, variation or fix, only one of them is used as long as it
    sends. The priorities are: a true heading before a magnetic heading; a receiver with a fix before a receiver without
    one; a fix with a number of satellites before a fix without it; a lower address before a higher address.

    Magnetic headings are corrected by the variation in the same message or on the bus. If both are missing, they are
    corrected by `declination`. Without it they give no sample, and `remark` reports this.
    """

    def __init__(self, declination: float | None = None, settle: float = SETTLE_S) -> None:
        """Start the decoder of a ship's bus without received messages.

        Parameters
        ----------
        declination
            True heading minus magnetic heading [rad], positive to the east, for magnetic headings without a variation.
            None if it is unknown.
        settle
            Time [s] after the first valid message of a kind in which this kind gives no sample. In this time the
            decoder finds the senders.
        """
        super().__init__()
        self._declination, self._settle = declination, settle
        self._take_message: dict[int, tuple[int, Callable[[int, bytes, float], list[Frame]]]] = {
            HEADING: (_HEADING.size, self._heading),
            TURN: (_TURN.size, self._turn),
            ATTITUDE: (_ATTITUDE.size, self._attitude),
            VARIATION: (_VARIATION.size, self._variation),
            COURSE: (_COURSE.size, self._course),
            FIX: (_FIX.size, self._fix),
            DOPS: (_DOPS.size, self._dops),
        }
        self._forget_state()

    def _forget_state(self) -> None:
        """Discard all values from earlier messages, because the port was reopened.

        These are incomplete packets, ranks of the senders, and values for the next samples. The first call creates
        them.
        """
        self._packets: dict[int, _Packet] = {}  # incomplete fixes by source
        self._senders: dict[int, dict[tuple[int, int], float]] = {}  # PGN -> rank and source -> last t_rx [s]
        self._since: dict[int, float] = {}  # PGN -> first t_rx [s]
        self._level = (NAN, NAN, -math.inf)  # pitch [rad], roll [rad], t_rx [s]
        # Source, or None for the best sender -> speed [m/s] and course [rad] over ground, t_rx [s].
        self._motions: dict[int | None, tuple[float, float, float]] = {}
        self._dimensions: dict[int, tuple[int, float]] = {}  # source -> dimensions of its fixes, t_rx [s]
        self._bus_variation = NAN  # rad
        self._timed: set[int] = set()  # sources that had a fix; before a fix their time is from their own clock

    def _decode_can_frame(self, identifier: int, extended: bool, data: bytes, t_rx: float) -> list[Frame]:
        """Decode one CAN frame if its NMEA 2000 message is used; return no sample otherwise.

        Return the samples that it completes. A frame with an 11-bit identifier is ignored. A frame that is too short
        counts as unparsed bytes.
        """
        pgn, source = split_identifier(identifier)
        if not extended or pgn not in self._take_message:
            return []
        size, take = self._take_message[pgn]
        content: bytes | None = data
        if pgn == FIX:
            content = self._complete_packet(source, data)
            if content is None:
                return []
        elif len(data) < size:
            self.unparsed_bytes += FRAME_BYTES
            return []
        assert content is not None
        self.frames += 1
        return take(source, content, t_rx)

    def _complete_packet(self, source: int, data: bytes) -> bytes | None:
        """Return the message that this CAN frame of a fast packet completes, or None.

        `source` is the sender's address. The frame with number 0 begins a packet and discards an incomplete one. A
        frame that does not continue the packet of its sender is discarded with this packet. A complete message is
        discarded if it is shorter than a fix. Discarded frames count as unparsed bytes. Bytes beyond the length of the
        message are cut off.
        """
        if len(data) < 2:
            self._drop_packet(source, 1)
            return None
        sequence, number = data[0] >> 5, data[0] & 0x1F
        packet = self._packets.get(source)
        if number == 0:
            self._drop_packet(source)
            packet = self._packets[source] = _Packet(sequence, data[1], 1, bytearray(data[2:]))
        elif packet is None or (packet.sequence, packet.frames) != (sequence, number):
            self._drop_packet(source, 1)
            return None
        else:
            packet.data += data[1:]
            packet.frames += 1
        if len(packet.data) < packet.length:
            return None
        if packet.length < _FIX.size:
            self._drop_packet(source)
            return None
        del self._packets[source]
        return bytes(packet.data[: packet.length])

    def _drop_packet(self, source: int, frames: int = 0) -> None:
        """Discard the incomplete fast packet of the sender with the address `source`, if there is one.

        Its frames, and `frames` more, count as unparsed bytes.
        """
        packet = self._packets.pop(source, None)
        self.unparsed_bytes += FRAME_BYTES * (frames + (packet.frames if packet is not None else 0))

    def _has_settled(self, pgn: int, t_rx: float) -> bool:
        """Return whether enough time has passed to have found all senders of a message, so that the best one is known.

        The time (1.2 s by default) starts with the first call for a message. `pgn` is the number of the message and
        `t_rx` the run time of receipt [s].
        """
        return t_rx - self._since.setdefault(pgn, t_rx) >= self._settle

    def _is_best_sender(self, pgn: int, rank: int, source: int, t_rx: float) -> bool:
        """Return whether a message is from the sender that is used, and note that this sender is active.

        The sender with the lowest rank is used; of several, the one with the lowest address.

        Parameters
        ----------
        pgn
            Number of the message.
        rank
            Rank of the message, such as 0 for a true and 1 for a magnetic heading.
        source
            Address of the sender.
        t_rx
            Run time of receipt [s].

        Notes
        -----
        Each rank of the last 2 s (STALE_S) counts, so that a sender keeps its best rank when it sends a worse one for a
        moment.
        """
        senders = self._senders.setdefault(pgn, {})
        senders[rank, source] = t_rx
        return min(key for key, when in senders.items() if t_rx - when <= STALE_S)[1] == source

    def _heading(self, source: int, data: bytes, t_rx: float) -> list[Frame]:
        """Return the sample of a heading from the best sender, with the newest pitch and roll.

        The list is empty for an invalid heading, for another sender, before all senders are found, and for a magnetic
        heading with an unknown variation. Pitch and roll are NaN if they are older than 2 s (STALE_S). `source` is the
        sender's address, and `data` are the bytes of the message. A magnetic heading is corrected by deviation and
        variation. If its variation is unknown and no usable heading has been received, `remark` advises, after 1.2 s,
        to add the declination.
        """
        raw, deviation, variation, reference = _HEADING.unpack_from(data)
        yaw, magnetic = _unsigned16(raw, _ANGLE), reference & 3 == MAGNETIC
        if not yaw <= math.tau + _ANGLE or reference & 3 > MAGNETIC:
            return []
        settled = self._has_settled(HEADING, t_rx)
        if magnetic:
            east = self._resolve_variation(_signed16(variation, _ANGLE))
            if math.isnan(east):
                if settled and HEADING not in self._senders:
                    self.remark = (
                        "magnetic headings are left out: the rig has no declination_deg for this device; add it"
                    )
                return []
            deviation_rad = _signed16(deviation, _ANGLE)
            yaw += east + (0.0 if math.isnan(deviation_rad) else deviation_rad)
        if not self._is_best_sender(HEADING, int(magnetic), source, t_rx) or not settled:
            return []
        self.remark = ""
        pitch, roll, when = self._level
        if t_rx - when > STALE_S:
            pitch = roll = NAN
        return [Frame(Ahrs(wrap_angle(yaw), pitch, roll), t_rx, NAN)]

    def _resolve_variation(self, message_variation: float) -> float:
        """Return the magnetic variation, true minus magnetic heading [rad]; NaN if it is unknown.

        `message_variation` is the variation in the message itself. If it is NaN, the variation on the bus or else the
        declination of the rig is returned.
        """
        for value in (message_variation, self._bus_variation, self._declination):
            if value is not None and not math.isnan(value):
                return value
        return NAN

    def _turn(self, source: int, data: bytes, t_rx: float) -> list[Frame]:
        """Return the sample of a rate of turn from the best sender; its angles are NaN.

        The list is empty for another sender, for an invalid rate, and before all senders are found. `source` is the
        sender's address, and `data` are the bytes of the message.
        """
        (raw,) = _TURN.unpack_from(data)
        rate = raw * _RATE if raw < 2**31 - 3 else NAN
        if math.isnan(rate) or not self._is_best_sender(TURN, 0, source, t_rx) or not self._has_settled(TURN, t_rx):
            return []
        return [Frame(Ahrs(NAN, NAN, NAN, r=rate), t_rx, NAN)]

    def _attitude(self, source: int, data: bytes, t_rx: float) -> list[Frame]:
        """Store pitch and roll of the best sender for the next heading. Return no sample.

        Other senders and invalid angles are ignored. `source` is the sender's address, and `data` are the bytes of the
        message.
        """
        _, pitch, roll = (_signed16(raw, _ANGLE) for raw in _ATTITUDE.unpack_from(data))
        if not math.isnan(pitch + roll) and self._is_best_sender(ATTITUDE, 0, source, t_rx):
            self._level = pitch, roll, t_rx
        return []

    def _variation(self, source: int, data: bytes, t_rx: float) -> list[Frame]:
        """Store the magnetic variation of the best sender, for magnetic headings and courses. Return no sample.

        Other senders and an invalid variation are ignored. `source` is the sender's address, and `data` are the bytes
        of the message.
        """
        variation = _signed16(_VARIATION.unpack_from(data)[2], _ANGLE)
        if not math.isnan(variation) and self._is_best_sender(VARIATION, 0, source, t_rx):
            self._bus_variation = variation
        return []

    def _course(self, source: int, data: bytes, t_rx: float) -> list[Frame]:
        """Store course and speed over ground of a sender for its next fix. Return no sample.

        Those of the best sender are also stored for fixes of other senders. A magnetic course is corrected by the
        variation; the course is NaN if the variation is unknown or the reference is invalid. At speed 0 an unknown
        course becomes 0. Nothing is stored if the speed is invalid. `source` is the sender's address, and `data` are
        the bytes of the message.
        """
        reference, raw_course, raw_speed = _COURSE.unpack_from(data)
        course, speed = _unsigned16(raw_course, _ANGLE), _unsigned16(raw_speed, _SPEED)
        if reference & 3:
            course += self._resolve_variation(NAN) if reference & 3 == MAGNETIC else NAN
        if speed == 0.0 and math.isnan(course):
            course = 0.0  # a receiver at rest has no course, and the velocity is zero for any course
        if not math.isnan(speed):
            self._motions[source] = speed, course, t_rx
            if self._is_best_sender(COURSE, reference & 3 if course == course else 3, source, t_rx):
                self._motions[None] = speed, course, t_rx
        return []

    def _dops(self, source: int, data: bytes, t_rx: float) -> list[Frame]:
        """Store the dimensions, 2 or 3, of a sender's fixes from a message DOPs. Return no sample.

        The message contains the dilution of precision and the mode, from which the dimensions follow. Other modes are
        ignored. `source` is the sender's address, and `data` are the bytes of the message.
        """
        if (mode := _DOPS.unpack_from(data)[0] >> 3 & 7) in _DIMENSIONS:
            self._dimensions[source] = _DIMENSIONS[mode], t_rx
        return []

    def _fix(self, source: int, data: bytes, t_rx: float) -> list[Frame]:
        """Return the sample of a fix from the best sender, with its newest course and speed.

        If this sender has sent none in the last 2 s (STALE_S), those of the best other sender are used, or NaN if they
        are older too. The list is empty for another sender, and before all senders are found. The dimensions are those
        that the sender has reported in the last 2 s (DOPs), or else 3 with a height and 2 without, or 0 without a fix;
        a fix of kind 3 with 2 dimensions becomes kind 2. Without a valid position, `fix` is 0. The device time is the
        UTC, NaN before the first fix of the sender. `source` is the sender's address, and `data` are the bytes of the
        message.
        """
        day, ticks, lat, lon, alt, method, _, n_sat, hdop, _, _ = _FIX.unpack_from(data)
        counts = 0 < n_sat < 0xFD  # a device that relays fixes of another device often omits the number of satellites
        place = lat * _PLACE, lon * _PLACE
        if not (abs(place[0]) <= 90.0 and abs(place[1]) <= 180.0):
            place = NAN, NAN
        fix = _METHOD.get(method >> 4, 0) if not math.isnan(place[0]) else 0
        if fix >= 2:
            self._timed.add(source)
        rank = (0 if fix >= 2 else 2 if fix else 4) + (0 if counts else 1)
        if not self._is_best_sender(FIX, rank, source, t_rx) or not self._has_settled(FIX, t_rx):
            return []
        utc = day * _DAY + ticks * _TICK if day < 0xFFFD and ticks * _TICK < _DAY + 2.0 else NAN
        motions = (self._motions.get(key, (NAN, NAN, -math.inf)) for key in (source, None))
        speed, course, _ = next((m for m in motions if t_rx - m[2] <= STALE_S), (NAN, NAN, NAN))
        # As in NMEA 0183, a position with a height has three dimensions unless its sender reports the dimensions.
        dimensions, when = self._dimensions.get(source, (-1, -math.inf))
        if t_rx - when > STALE_S:
            dimensions = 3 if alt < 2**63 - 3 else 2
        sample = Gnss(
            utc,
            *place,
            # Above mean sea level: receivers send the height of their GGA in this field.
            alt=alt * _HEIGHT if alt < 2**63 - 3 else NAN,
            vel_n=speed * math.cos(course),
            vel_e=speed * math.sin(course),
            fix=2 if fix == 3 and dimensions == 2 else fix,
            n_sat=n_sat if n_sat < 0xFD else -1,
            hdop=_signed16(hdop, 0.01),
            speed=speed,
            dimensions=dimensions if fix else 0,
        )
        return [Frame(sample, t_rx, utc if source in self._timed else NAN)]


def _unsigned16(raw: int, scale: float) -> float:
    """Return an unsigned 16-bit field of NMEA 2000 times its resolution `scale`; NaN if it is marked as unavailable.

    The three largest numbers mean "unavailable".
    """
    return raw * scale if raw < 0xFFFD else NAN  # the last three values mean "not available"


def _signed16(raw: int, scale: float) -> float:
    """Return a signed 16-bit field of NMEA 2000 times its resolution `scale`; NaN if it is marked as unavailable.

    The three largest positive numbers mean "unavailable".
    """
    return raw * scale if raw < 0x7FFD else NAN


def encode(sample: Ahrs | Gnss, sid: int = 0, source: int = 35) -> list[tuple[int, bytes]]:
    """Encode a sample as the CAN frames of a compass or a GNSS receiver on an NMEA 2000 bus.

    Parameters
    ----------
    sample
        Sample. Of an `Ahrs`, the messages rate of turn, attitude and true heading are sent if their values are not NaN.
        Of a `Gnss`, the fix is sent, and course and speed if the speed is not NaN; its UTC has to be a number.
    sid
        Sequence id that joins the messages of one measurement, 0 to 252.
    source
        Address of the sender.

    Returns
    -------
    list of tuple of int and bytes
        CAN identifier (29 bits) and data of each frame.
    """
    if isinstance(sample, Gnss):
        return _encode_gnss(sample, sid, source)
    out: list[tuple[int, bytes]] = []
    if not math.isnan(sample.r):
        out.append((TURN, struct.pack("<Bi3s", sid, round(sample.r / _RATE), b"\xff" * 3)))
    if not math.isnan(sample.pitch + sample.roll):
        angles = (0x7FFF, round(sample.pitch / _ANGLE), round(sample.roll / _ANGLE))
        out.append((ATTITUDE, struct.pack("<B3hB", sid, *angles, 0xFF)))
    if not math.isnan(sample.yaw):
        yaw = round(sample.yaw % math.tau / _ANGLE)
        out.append((HEADING, struct.pack("<BHhhB", sid, yaw, 0x7FFF, 0x7FFF, 0xFC)))
    return [(identifier(pgn, source), data) for pgn, data in out]


def _encode_gnss(fix: Gnss, sid: int, source: int) -> list[tuple[int, bytes]]:
    """Encode a fix as CAN frames (identifier, data): course and speed over ground if it has a speed, then the fix.

    NaN is sent as "not available"; the UTC has to be a number. `sid` joins the messages of one measurement, and
    `source` is the address of the sender.
    """
    out = []
    if not math.isnan(fix.speed):
        has_velocity = not math.isnan(fix.vel_n + fix.vel_e)
        course = round(math.atan2(fix.vel_e, fix.vel_n) % math.tau / _ANGLE) if has_velocity else 0xFFFF
        speed = round(fix.speed / _SPEED)
        out.append((identifier(COURSE, source), struct.pack("<BBHHH", sid, 0xFC, course, speed, 0xFFFF)))
    day, seconds = divmod(fix.utc, _DAY)
    method = {3: 1, 4: 2, 5: 4, 6: 5, 1: 6}.get(fix.fix, 0)
    body = struct.pack(
        "<BHIqqqBBBhhiB", sid, int(day), round(seconds / _TICK),
        *(round(value / _PLACE) if math.isfinite(value) else 2**63 - 1 for value in (fix.lat, fix.lon)),
        round(fix.alt / _HEIGHT) if math.isfinite(fix.alt) else 2**63 - 1,
        method << 4, 0xFC, fix.n_sat if fix.n_sat >= 0 else 0xFF,
        round(fix.hdop / 0.01) if math.isfinite(fix.hdop) else 0x7FFF, 0x7FFF, 0, 0,
    )  # fmt: skip
    return out + fast_packet(FIX, body, sid % 8, source)


def fast_packet(pgn: int, body: bytes, sequence: int, source: int = 35) -> list[tuple[int, bytes]]:
    """Encode an NMEA 2000 message of 7 to 223 bytes as the CAN frames of a fast packet.

    Parameters
    ----------
    pgn
        Number of the message.
    body
        Bytes of the message; their number is not checked. The last frame is filled with 0xFF.
    sequence
        Number of the packet, 0 to 7.
    source
        Address of the sender.

    Returns
    -------
    list of tuple of int and bytes
        CAN identifier (29 bits) and data of each frame.
    """
    pieces = [bytes((len(body),)) + body[:6], *(body[at : at + 7] for at in range(6, len(body), 7))]
    return [
        (identifier(pgn, source), bytes((sequence << 5 | number,)) + piece.ljust(7, b"\xff"))
        for number, piece in enumerate(pieces)
    ]
