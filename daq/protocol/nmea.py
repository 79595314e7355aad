"""NMEA 0183 of GNSS receivers and compasses: decoder of sentences to `Gnss`, `Ahrs` and `Transducer` samples.

The position sentences of one epoch are joined to one `Gnss`. A heading sentence becomes one `Ahrs`. A receiver with two
antennas sends both. The heading sentences are HDT, THS, HDG, HDM, ROT, XDR, $PASHR and $PSTI,036 of SkyTraq. The values
of XDR other than pitch and roll become `Transducer` samples.
Source: NMEA 0183 version 4.11. The library pynmeagps splits position sentences into fields.
"""

from __future__ import annotations

import datetime
import math
import re
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from pynmeagps import NMEAReader

from seatrial.daq.protocol.framing import StreamDecoder, sentence, take_sentence
from seatrial.daq.samples import NAN, Ahrs, Frame, Gnss, Transducer, wrap_angle

_FIX_TO_QUALITY = {0: 0, 1: 6, 2: 1, 3: 1, 4: 2, 5: 4, 6: 5}  # Gnss.fix -> GGA quality
KNOT = 1852.0 / 3600.0  # m/s
DAY = 86400.0  # s
REMEMBERED = 10  # epochs whose kinds of sentence are expected in the next one; some kinds are not sent in each epoch
# Epochs in a row with another order of sentences, after which that order is assumed. A pause of the link can change the
# apparent order of one epoch.
ORDER_BY = 3
_TIME = re.compile(rb"(\d\d)(\d\d)(\d\d(?:\.\d*)?)\Z")
_TIME_FIELD = {"GGA": 1, "RMC": 1, "GST": 1, "ZDA": 1, "GNS": 1, "GLL": 5}  # kind -> index of the field with the time
_POSITION = ("GGA", "GNS", "RMC", "GLL")  # sentences with a position; the first one in this order is used
# Epochs with two positions by the same kind of sentence, from which two receivers are assumed; and the least difference
# of the two positions [deg], about 0.1 m.
FEWEST_CONFLICTS, CONFLICT_DEG = 5, 1e-6
# s without a sentence that has a time. Afterwards sentences without a time are from a receiver that never had a fix.
TIMELESS_S = 1.5
KINDS = frozenset({*_TIME_FIELD, "VTG", "GSA"})
# GGA quality -> Gnss.fix. GGA does not distinguish 2-D and 3-D fixes; GSA does.
_QUALITY = {0: 0, 1: 3, 2: 4, 3: 3, 4: 5, 5: 6, 6: 1, 7: 1, 8: 1}
# Mode letter of GNS and RMC -> Gnss.fix.
_MODE = {"A": 3, "D": 4, "P": 3, "R": 5, "F": 6, "E": 1, "M": 1, "S": 3, "N": 0}
Message = dict[str, Any]
_NUMBER = re.compile(rb"[+-]?\d+(\.\d*)?\Z")
_DEG = math.pi / 180.0
# Rank of the heading sentences of a device that sends several: attitude first, then true, then magnetic headings.
_RANK = {"PASHR": 5, "PSTI": 5, "HDT": 4, "THS": 3, "HDG": 2, "HDM": 1}
_ATTITUDE = {"PASHR": (2, 5, 4), "PSTI": (4, 5, 6)}  # indices of the fields with heading, pitch and roll
_HEADING_TIME = {b"PASHR": 1, b"PSTI,": 2}  # heading sentences with a time -> index of the field with the time
# Kind and unit of a transducer of XDR -> unit and factor of its signal.
_TRANSDUCERS: dict[tuple[bytes, bytes], tuple[str, float]] = {
    (b"A", b"D"): ("rad", math.pi / 180.0), (b"C", b"C"): ("degC", 1.0), (b"D", b"M"): ("m", 1.0),
    (b"F", b"H"): ("Hz", 1.0), (b"H", b"P"): ("1", 0.01), (b"I", b"A"): ("A", 1.0), (b"N", b"N"): ("N", 1.0),
    (b"P", b"B"): ("Pa", 1e5), (b"P", b"P"): ("Pa", 1.0), (b"T", b"R"): ("rev/min", 1.0), (b"U", b"V"): ("V", 1.0),
}  # fmt: skip
XDR = "xdr_"  # prefix of the signal name of a transducer
_LEVEL = {b"PTCH": 0, b"PITCH": 0, b"ROLL": 1}  # names of the transducers of XDR for pitch (0) and roll (1)
_THS_VALID = (b"A", b"E")  # modes autonomous and estimated; M is manual, S simulated, V invalid
_FULL_TURN = 360.0  # deg; a larger heading, for example 999.9, means that there is no heading


class Decoder(StreamDecoder[Frame]):
    """Decoder of a stream of NMEA sentences to `Gnss`, `Ahrs` and `Transducer` samples.

    Parameters
    ----------
    declination
        True heading minus magnetic heading [rad], positive to the east. None if it is unknown.
    signal_ending
        Ending of the signal names of transducers (XDR): the transducer ENGINE#0 has the name `xdr_ENGINE_0` and this
        ending. None if transducers are to be left out.
    """

    sync = re.compile(rb"\$")

    def __init__(self, declination: float | None = None, signal_ending: str | None = None) -> None:
        """Start without received sentences.

        `declination` is the true heading minus the magnetic heading [rad], None if it is unknown. `signal_ending` is
        the ending of the names of transducers, None to leave transducers out.
        """
        super().__init__()
        self._sentences = Sentences(declination, signal_ending)

    @property
    def two_receivers(self) -> str:
        """Note for the user that two receivers send in the same stream, in one line.

        It is empty as long as fewer than 5 positions differed from another position with the same time and kind of
        sentence.
        """
        return self._sentences.epochs.remark

    @property
    def left_out_headings(self) -> bool:
        """Whether magnetic headings are left out, because neither the stream nor the rig has the declination."""
        return bool(self._sentences.headings.remark)

    def flush(self) -> list[Frame]:
        """Return the GNSS sample of the last epoch (the sentences with the same time) at the end of the stream.

        The list is empty if it was returned before, or if the epoch has no position sentence.
        """
        return self._sentences.epochs.flush()

    def reset(self) -> None:
        """Discard an incomplete sentence and values from earlier sentences, because the port was reopened.

        The counters, the date, the dimension of the fix by GSA and the expected kinds of sentence are kept.
        """
        super().reset()
        self._sentences.forget()

    def _decode_frame(self, buffer: bytearray, start: int, t_rx: float) -> int:
        """Decode the NMEA sentence that begins at index `start` of the buffer, and append its samples to `self._out`.

        A wrong checksum counts as a checksum error. Fields that cannot be read also give -1. Return the length of the
        sentence in bytes, 0 if more bytes are needed, or -1 if no valid sentence begins there. `t_rx` is the run time
        of receipt [s].
        """
        length, body, bad = take_sentence(buffer, start)
        self.checksum_errors += bad
        if body is None:
            return length
        frames = self._sentences.take(body, t_rx)
        if frames is None:
            return -1
        self.frames += 1
        self.remark = self._sentences.headings.remark or self._sentences.epochs.remark
        self._out += self._filter_frames(frames)
        return length

    def _filter_frames(self, frames: list[Frame]) -> list[Frame]:
        """Return the samples of an NMEA sentence to keep, here all of them. A subclass may drop some."""
        return frames


class Sentences:
    """Converter of complete NMEA sentences to samples, for all decoders of streams that contain NMEA.

    Parameters
    ----------
    declination
        True heading minus magnetic heading [rad], positive to the east. None if it is unknown.
    signal_ending
        Ending of the signal names of transducers (XDR). None if transducers are to be left out.

    Attributes
    ----------
    epochs
        Collector of the position sentences.
    headings
        Converter of the heading sentences.
    """

    def __init__(self, declination: float | None = None, signal_ending: str | None = None) -> None:
        """Start without received sentences.

        `declination` is the true heading minus the magnetic heading [rad], None if it is unknown. `signal_ending` is
        the ending of the names of transducers, None to leave transducers out.
        """
        self.epochs = Epochs()
        self.headings = Headings(declination, signal_ending)

    def take(self, body: bytes, t_rx: float) -> list[Frame] | None:
        """Return the samples that an NMEA sentence completes, or None if its fields are invalid.

        The list is empty for a sentence of an unknown kind. A heading sentence with a time gets its UTC as `t_device`,
        or NaN as long as the received positions had no fix.

        Parameters
        ----------
        body
            Text between `$` and `*`.
        t_rx
            Run time [s] at which the read of the sentence returned.
        """
        kind = body[2:5].decode("ascii") if body[5:6] == b"," and body[:1] != b"P" else ""
        if kind in KINDS:
            return self.epochs.take(kind, body, t_rx)
        frames = self.headings.take(kind, body, t_rx)
        if frames and body[:5] in _HEADING_TIME:
            seconds = _time_of_day(body.split(b","), _HEADING_TIME[body[:5]])
            utc = self.epochs.utc_of(seconds, t_rx) if self.epochs.has_time else NAN
            frames = [frame._replace(t_device=utc) for frame in frames]
        return frames

    def forget(self) -> None:
        """Discard the incomplete epoch of NMEA sentences and the values for the next heading.

        The decoder calls it because the port was reopened. The date is kept.
        """
        self.epochs.forget()
        self.headings.forget()


def encode(gnss: Gnss) -> bytes:
    """Encode a fix as the NMEA sentences GGA, RMC, VTG and GST of one epoch.

    The resolution of the time is 1 ms. The resolution of the position is 1e-7 minutes (0.2 mm). The UTC has to be a
    number. The position is empty without a fix or with NaN. Other fields are empty if their values are NaN.
    """
    milliseconds = round(gnss.utc * 1000.0)
    when = datetime.datetime.fromtimestamp(milliseconds // 1000, datetime.UTC)
    time = f"{when:%H%M%S}.{milliseconds % 1000:03d}"
    void = gnss.fix == 0 or math.isnan(gnss.lat) or math.isnan(gnss.lon)
    place = ",,," if void else f"{_format_degrees(gnss.lat, 2, 'NS')},{_format_degrees(gnss.lon, 3, 'EW')}"
    course = math.degrees(math.atan2(gnss.vel_e, gnss.vel_n)) % 360.0
    knots, kmh, cog = (
        _to_text(gnss.speed / KNOT, 4),
        _to_text(gnss.speed * 3.6, 4),
        _to_text(course, 4),
    )
    sigma = _to_text(gnss.sigma_h, 4)
    quality = 0 if void else _FIX_TO_QUALITY[gnss.fix]
    mode = "N" if void else {1: "A", 2: "D", 4: "R", 5: "F", 6: "E"}[quality]
    n_sat = "" if gnss.n_sat < 0 else f"{gnss.n_sat:02d}"
    return b"".join(
        sentence(body)
        for body in (
            f"GNGGA,{time},{place},{quality},{n_sat},{_to_text(gnss.hdop, 2)},{_to_text(gnss.alt, 3)},M,,M,,",
            f"GNRMC,{time},{'V' if void else 'A'},{place},{knots},{cog},{when:%d%m%y},,,{mode}",
            f"GNVTG,{cog},T,,M,{knots},N,{kmh},K,{mode}",
            f"GNGST,{time},,,,,{sigma},{sigma},",
        )
    )


def _format_degrees(angle: float, digits: int, signs: str) -> str:
    """Format an angle [deg] as `ddmm.mmmmmmm,N`: whole degrees, minutes, hemisphere.

    `digits` is the number of digits of the whole degrees. `signs` has the letters of positive and negative angles, "NS"
    or "EW".
    """
    degrees, units = divmod(round(abs(angle) * 60e7), 600_000_000)
    return f"{degrees:0{digits}d}{units // 10_000_000:02d}.{units % 10_000_000:07d},{signs[angle < 0.0]}"


def _to_text(value: float, digits: int) -> str:
    """Format a number for an NMEA sentence with `digits` decimals; an empty text for NaN."""
    return "" if math.isnan(value) else f"{value:.{digits}f}"


@dataclass
class _Epoch:
    """Values of the received NMEA sentences of one epoch (one time of the receiver).

    Attributes
    ----------
    seconds
        Time of the day [s]; NaN if the receiver has no time.
    t_rx
        Run time of receipt of the first sentence [s].
    kinds
        Kinds of the received sentences, such as "GGA".
    date
        Date by RMC or ZDA; None before.
    position
        Latitude and longitude [deg], by kind of sentence.
    values
        Other values by name, in SI units and rad.
    """

    seconds: float
    t_rx: float
    kinds: set[str] = field(default_factory=set)
    date: datetime.date | None = None
    position: dict[str, tuple[float, float]] = field(default_factory=dict)
    values: dict[str, float] = field(default_factory=dict)

    @property
    def timeless(self) -> bool:
        """Whether the NMEA sentences of the epoch have no time of the day."""
        return math.isnan(self.seconds)


class Epochs:
    """Collector of position sentences: it joins the NMEA sentences of one epoch (one time) to one `Gnss` sample.

    An epoch is complete when all kinds of sentence of the last 10 epochs have been received, or when the next epoch
    begins. `t_rx` of a sample is the time of receipt of the epoch's first sentence, which is nearest to the
    measurement.

    `t_device` is the UTC of the epoch. It is NaN before the first fix, because the receiver's own clock may be wrong by
    seconds until then. Before the first date (RMC or ZDA), the date is chosen so that the UTC is nearest to `t_rx`. A
    receiver without any time gives samples without a fix, and their UTC is NaN.

    The sentence VTG (course and speed) contains no time. It usually belongs to the epoch of the sentence before it. If
    it regularly arrives between two epochs and nearer to the later one, it is the first sentence of the later epoch.

    Attributes
    ----------
    n_conflicts : int
        Number of sentences whose epoch already had another position by the same kind of sentence.
    """

    def __init__(self) -> None:
        """Start the collector of position sentences without received sentences.

        Until sentences show another order, VTG counts as the last sentence of an epoch.
        """
        self._out: list[Frame] = []
        self._epoch: _Epoch | None = None
        self._emitted = False  # whether the sample of the present epoch has been returned
        self._kinds: deque[set[str]] = deque(maxlen=REMEMBERED)  # kinds of sentence of the last epochs
        self._expected: set[str] = set()  # union of the last epochs' kinds
        self._last_utc = NAN
        self._mode_gsa = 0
        self._timed: bool | None = None  # whether there has been a fix; None before the first position
        self._t_last = -math.inf  # s, t_rx of the last sentence
        self._vtg_leads = False  # whether VTG is the first sentence of an epoch
        # Epochs in a row with the other order of VTG. The start value makes the first such epoch decide at once.
        self._epochs_against_order = ORDER_BY - 1
        # The last sentence if it was VTG: t_rx [s], fields, and time [s] since the sentence before it.
        self._vtg: tuple[float, Message, float] | None = None
        self.n_conflicts = 0  # sentences whose epoch already had another position by the same kind of sentence

    @property
    def remark(self) -> str:
        """Note for the user that two receivers send in one stream, in one line.

        It is empty as long as fewer than 5 positions (FEWEST_CONFLICTS) differed from another position with the same
        time and kind of sentence.
        """
        if self.n_conflicts < FEWEST_CONFLICTS:
            return ""
        return (
            f"two receivers send in one stream: {self.n_conflicts} positions have the time of another position; "
            "connect and record each receiver by itself"
        )

    def take(self, kind: str, body: bytes, t_rx: float) -> list[Frame] | None:
        """Decode one NMEA sentence and add it to its epoch. Return the `Gnss` samples that it completes.

        Return None if the sentence cannot be split into fields.

        Parameters
        ----------
        kind
            Kind of the sentence, one of KINDS: GGA, GNS, RMC, GLL, GST, ZDA, VTG, GSA.
        body
            Text between `$` and `*`.
        t_rx
            Run time of receipt [s].
        """
        message = _parse_sentence(body)
        if message is None:
            return None
        self._add_sentence(kind, message, body.split(b","), t_rx)
        return self._pop_completed()

    def flush(self) -> list[Frame]:
        """Return the GNSS sample of the last epoch (the sentences with the same time) at the end of the stream.

        The list is empty if it was returned before, or if the epoch has no position sentence.
        """
        self._emit_epoch()
        return self._pop_completed()

    def forget(self) -> None:
        """Discard the incomplete epoch and the learned place of VTG, because the port was reopened.

        Whether there has been a fix is forgotten too. The date (by the UTC of the last epoch), the dimension of the fix
        by GSA, and the kinds of sentence that are expected in an epoch are kept.
        """
        self._epoch = self._vtg = self._timed = None
        self._t_last, self._vtg_leads, self._epochs_against_order = -math.inf, False, ORDER_BY - 1

    @property
    def has_time(self) -> bool:
        """Whether the receiver has had a fix, so that its UTC is not from its own clock.

        True if no position was received yet.
        """
        return self._timed is not False

    def _pop_completed(self) -> list[Frame]:
        """Return the completed `Gnss` samples that no earlier call has returned."""
        out, self._out = self._out, []
        return out

    def _add_sentence(self, kind: str, message: Message, words: list[bytes], t_rx: float) -> None:
        """Add one NMEA sentence to its epoch, which begins with the first sentence that has another time.

        Of GSA, only the dimension of the fix is stored. VTG is added to the present epoch, or kept for the next one if
        VTG is the first sentence of an epoch. A sentence without a time is added by `_add_timeless_sentence`, which
        ignores it in most cases.

        Parameters
        ----------
        kind
            Kind of the sentence, one of KINDS.
        message
            Fields by name, as pynmeagps returns them.
        words
            Fields as text.
        t_rx
            Run time of receipt [s].
        """
        if kind == "GSA":
            self._mode_gsa = _to_integer(message.get("navMode"), 0)
            return
        if kind == "VTG":
            self._vtg = t_rx, message, t_rx - self._t_last
            self._t_last = t_rx
            if not self._vtg_leads:
                self._add_values(kind, message)
            return
        seconds = _time_of_day(words, _TIME_FIELD[kind])
        if math.isnan(seconds):
            self._add_timeless_sentence(kind, message, t_rx)
            return
        vtg, self._vtg = self._vtg, None
        begins = self._epoch is None or self._epoch.seconds != seconds
        leading_vtg = vtg if self._vtg_leads else None
        if begins:
            self._begin_epoch(seconds, t_rx if leading_vtg is None else leading_vtg[0])
        if vtg is not None and begins:
            self._learn_order_of_vtg(before=vtg[2], after=t_rx - vtg[0])
        self._t_last = t_rx
        if leading_vtg is not None:
            self._add_values("VTG", leading_vtg[1])
        self._add_values(kind, message)

    def _add_timeless_sentence(self, kind: str, message: Message, t_rx: float) -> None:
        """Add a position sentence without a time. A receiver that has never had a fix sends these sentences.

        A new epoch begins if the present epoch has a time, or already has this kind of sentence. A sentence (for
        example an old GLL) is ignored if it is not a position, or if the present epoch has a time and began at most 1.5
        s (TIMELESS_S) ago. `message` has the fields by name, and `t_rx` is the run time of receipt [s].
        """
        epoch = self._epoch
        if kind not in _POSITION or not (epoch is None or epoch.timeless or t_rx - epoch.t_rx > TIMELESS_S):
            return
        if epoch is None or not epoch.timeless or kind in epoch.kinds:
            self._begin_epoch(NAN, t_rx)
        self._add_values(kind, message)

    def _learn_order_of_vtg(self, before: float, after: float) -> None:
        """Decide from a VTG between two epochs whether VTG is the first or the last sentence of an epoch.

        `before` is the time [s] from the previous sentence to the VTG, `after` the time [s] from the VTG to the next
        sentence. VTG seems to be the first if `before` is more than twice `after`, and the last if `after` is longer.
        Any other VTG decides nothing. The stored order changes after three epochs in a row (ORDER_BY) with the other
        order; the very first decision after the start needs only one epoch.
        """
        if math.isfinite(before) and before > 2.0 * after:
            leads = True
        elif after > before:
            leads = False
        else:
            return
        self._epochs_against_order = self._epochs_against_order + 1 if leads != self._vtg_leads else 0
        if self._epochs_against_order >= ORDER_BY:
            self._vtg_leads, self._epochs_against_order = leads, 0

    def _begin_epoch(self, seconds: float, t_rx: float) -> None:
        """Complete the present epoch of NMEA sentences, and begin the next epoch.

        `seconds` is its time of the day [s], NaN without a time. `t_rx` is the run time of receipt [s] of its first
        sentence.
        """
        if self._epoch is not None:
            self._emit_epoch()
            self._kinds.append(self._epoch.kinds)
            self._expected = set().union(*self._kinds)
        self._epoch, self._emitted = _Epoch(seconds, t_rx), False

    def _add_values(self, kind: str, message: Message) -> None:
        """Add the values of an NMEA sentence to the present epoch. Complete the epoch if it has all expected sentences.

        Without an epoch nothing happens. Values of the sentence usually replace those that the epoch has. If the epoch
        already had a position by the same kind of sentence that differs by more than 1e-6 deg, a conflict is counted.
        `message` has the fields by name.
        """
        epoch = self._epoch
        if epoch is None:
            return
        epoch.kinds.add(kind)
        lat, lon = epoch.position.get(kind, (NAN, NAN))
        _READERS[kind](epoch, message)
        if lat == lat:  # not NaN: the second sentence of this kind
            other_lat, other_lon = epoch.position[kind]
            self.n_conflicts += max(abs(other_lat - lat), abs(other_lon - lon)) > CONFLICT_DEG
        if self._expected and epoch.kinds >= self._expected:
            self._emit_epoch()

    def _emit_epoch(self) -> None:
        """Append the GNSS sample of the present epoch to the completed ones.

        Nothing is appended if the sample has been appended before, or if the epoch has no position sentence. The device
        time is NaN until a sample had a fix of kind 2 or more.
        """
        epoch = self._epoch
        if epoch is None or self._emitted:
            return
        self._emitted = True
        utc = self._utc_of_epoch(epoch)
        if epoch.kinds.isdisjoint(_POSITION):
            return
        sample = _gnss_sample(epoch, utc, self._mode_gsa)
        self._timed = bool(self._timed) or sample.fix >= 2
        self._out.append(Frame(sample, epoch.t_rx, utc if self._timed else NAN))

    def _utc_of_epoch(self, epoch: _Epoch) -> float:
        """Return the UTC [s since 1970] of an epoch, and store it for the date of the next epoch.

        The epoch's own date is used. Without one, the date is chosen so that the UTC is nearest to that of the last
        epoch, or to the time of receipt. NaN if the epoch has no time.
        """
        if epoch.date is not None:
            midnight = datetime.datetime.combine(epoch.date, datetime.time(), datetime.UTC)
            utc = midnight.timestamp() + epoch.seconds
        else:
            utc = self.utc_of(epoch.seconds, epoch.t_rx)
        if not math.isnan(utc):
            self._last_utc = utc
        return utc

    def utc_of(self, seconds: float, t_rx: float) -> float:
        """Return the UTC [s since 1970] of a time of the day [s] without a date; NaN for NaN.

        The date is chosen so that the UTC is nearest to that of the last epoch. Without an earlier epoch it is nearest
        to `t_rx`, the time of receipt [s since 1970].
        """
        return nearest_day(seconds, self._last_utc if math.isfinite(self._last_utc) else t_rx)


def nearest_day(t: float, near: float) -> float:
    """Return the time `t` [s] shifted by whole days so that it is nearest to `near` [s].

    The result is NaN if `t` or `near` is NaN or infinite.
    """
    if not math.isfinite(t + near):
        return NAN
    return t + round((near - t) / DAY) * DAY


def _gnss_sample(epoch: _Epoch, utc: float, mode_gsa: int) -> Gnss:
    """Return the `Gnss` sample of an epoch of NMEA sentences.

    `utc` is the UTC [s since 1970], and `mode_gsa` the dimension of the fix by GSA: 2 or 3, 1 without a fix, 0 without
    GSA. A mode 2 or 3 becomes `dimensions`; otherwise `dimensions` is 3 with a height and 2 without. With mode 2, a fix
    of kind 3 becomes kind 2. The kind of fix is that of GGA, or else of RMC, GNS or GLL. The position is from GGA, or
    else GNS, RMC, GLL. Without a position, `fix` and `dimensions` are 0. Missing values are NaN, a missing number of
    satellites is -1. The velocity is 0 at speed 0 without a course.
    """
    value = epoch.values
    fix = int(value.get("quality", value.get("mode", 0)))
    # GSA contains the dimension. Without GSA a position with a height has three dimensions, as in gpsd.
    dimensions = mode_gsa if mode_gsa in (2, 3) else 3 if "alt" in value else 2
    if fix == 3 and mode_gsa == 2:
        fix = 2
    lat, lon = next((epoch.position[kind] for kind in _POSITION if kind in epoch.position), (NAN, NAN))
    if math.isnan(lat):
        fix = 0
    speed, course = value.get("speed", NAN), value.get("course", NAN)
    if speed == 0.0 and math.isnan(course):
        course = 0.0  # a receiver at rest has no course, but it has a velocity
    return Gnss(
        utc, lat, lon,
        alt=value.get("alt", NAN),
        vel_n=speed * math.cos(course),
        vel_e=speed * math.sin(course),
        fix=fix,
        n_sat=int(value.get("n_sat", -1)),
        hdop=value.get("hdop", NAN),
        sigma_h=value.get("sigma_h", NAN),
        speed=speed,
        dimensions=dimensions if fix else 0,
    )  # fmt: skip


def _parse_sentence(body: bytes) -> Message | None:
    """Return the fields of an NMEA sentence by name, as pynmeagps splits them; None if it cannot split them.

    `body` is the text between `$` and `*`. A sentence that is shorter than the standard lacks the last fields.
    """
    try:
        return dict(vars(NMEAReader.parse(b"$%b*00\r\n" % body, validate=0)))
    except Exception:
        # pynmeagps raises errors of its own and, for fields that are not numbers, of many other kinds. The caller
        # counts the sentence as unparsed bytes.
        return None


def _time_of_day(words: list[bytes], index: int) -> float:
    """Return the time of the day [s] in the word of an NMEA sentence with this index (`hhmmss.ss`).

    NaN if the word is missing, empty or invalid. A leap second (:60) is valid. pynmeagps rejects it, so its time is not
    used.
    """
    match = _TIME.match(words[index]) if index < len(words) else None
    if match is None:
        return NAN
    hours, minutes, seconds = int(match[1]), int(match[2]), float(match[3])
    return 3600.0 * hours + 60.0 * minutes + seconds if hours < 24 and minutes < 60 and seconds < 61.0 else NAN


def _read_gga(epoch: _Epoch, message: Message) -> None:
    """Store fix and satellites of an NMEA sentence GGA in the epoch; position, height and HDOP only with a fix.

    The quality indicator is converted to a kind of fix as in `Gnss.fix`; estimated, manual and simulated become 1, and
    an unknown or empty indicator 0. `message` has the fields by name. Other empty fields are not stored.
    """
    fix = _QUALITY.get(_to_integer(message.get("quality"), 0), 0)
    epoch.values["quality"] = fix
    _store_finite(epoch, "n_sat", _to_number(message.get("numSV")))
    if fix:
        _store_position(epoch, "GGA", message)
        _store_finite(epoch, "alt", _to_number(message.get("alt")))
        _store_finite(epoch, "hdop", _to_number(message.get("HDOP")))


def _read_gns(epoch: _Epoch, message: Message) -> None:
    """Store the position of an NMEA sentence GNS, and the best fix of its satellite systems, in the epoch.

    A fix that the epoch already has from RMC or GLL is kept. An unknown mode letter counts as no fix. Without a fix the
    position is not stored. `message` has the fields by name.
    """
    fix = max((_MODE.get(letter, 0) for letter in str(message.get("posMode", ""))), default=0)
    epoch.values.setdefault("mode", fix)
    if fix:
        _store_position(epoch, "GNS", message)


def _read_rmc(epoch: _Epoch, message: Message) -> None:
    """Store date, fix, position, speed and course of an NMEA sentence RMC in the epoch.

    The kind of fix, as in `Gnss.fix`, follows from the mode letter; a sentence without a letter has 3, one with an
    unknown letter 0. The year of the date is 1980 to 2079, because the sentence has two digits of it. If the sentence
    is flagged as invalid, only the date and the kind of fix (0) are stored. `message` has the fields by name.
    """
    if isinstance(date := message.get("date"), datetime.date):
        # RMC has two digits of the year. Before its first fix a receiver may send a year from 1980 on.
        century = 100 if date.year >= 2080 else 0
        epoch.date = date.replace(year=date.year - century)
    valid = message.get("status") == "A"
    epoch.values["mode"] = _MODE.get(str(message.get("posMode") or "A"), 0) if valid else 0
    if valid:
        _store_position(epoch, "RMC", message)
        _store_motion(epoch, _to_number(message.get("spd")) * KNOT, _to_number(message.get("cog")))


def _read_gll(epoch: _Epoch, message: Message) -> None:
    """Store the position of an NMEA sentence GLL in the epoch, unless the sentence is flagged as invalid.

    The fix becomes 3 if the epoch has none by RMC or GNS. `message` has the fields by name.
    """
    if message.get("status") == "A":
        epoch.values.setdefault("mode", 3)
        _store_position(epoch, "GLL", message)


def _read_vtg(epoch: _Epoch, message: Message) -> None:
    """Store speed and course of an NMEA sentence VTG in the epoch, unless the epoch has an RMC, which contains them.

    `message` has the fields by name.
    """
    if "RMC" not in epoch.kinds:  # RMC has the same values, and it contains the time of its epoch
        _store_motion(epoch, _to_number(message.get("sogk")) / 3.6, _to_number(message.get("cogt")))


def _read_gst(epoch: _Epoch, message: Message) -> None:
    """Store the standard deviation of the horizontal position per axis [m] of an NMEA sentence GST in the epoch.

    It is the root mean square of those of latitude and longitude. Nothing is stored if one of them is empty. `message`
    has the fields by name.
    """
    _store_finite(
        epoch,
        "sigma_h",
        math.hypot(_to_number(message.get("stdLat")), _to_number(message.get("stdLong"))) / math.sqrt(2.0),
    )


def _read_zda(epoch: _Epoch, message: Message) -> None:
    """Store the date of an NMEA sentence ZDA in the epoch. An invalid date is ignored.

    The date replaces that of an earlier RMC of the epoch. `message` has the fields by name.
    """
    try:
        epoch.date = datetime.date(
            int(message.get("year", "")), int(message.get("month", "")), int(message.get("day", ""))
        )
    except (TypeError, ValueError):
        return


def _store_position(epoch: _Epoch, kind: str, message: Message) -> None:
    """Store latitude and longitude [deg] of an NMEA sentence in the epoch, under its kind, if both are in range.

    Otherwise an earlier position of this kind stays. `message` has the fields by name.
    """
    lat, lon = _to_number(message.get("lat")), _to_number(message.get("lon"))
    if abs(lat) <= 90.0 and abs(lon) <= 180.0:
        epoch.position[kind] = (lat, lon)


def _store_finite(epoch: _Epoch, name: str, value: float) -> None:
    """Store a value of an NMEA sentence in the epoch by its name, if it is a finite number."""
    if math.isfinite(value):
        epoch.values[name] = value


def _store_motion(epoch: _Epoch, speed: float, course_deg: float) -> None:
    """Store speed [m/s] and course [deg, converted to rad] over ground in the epoch, if the speed is finite.

    The course may be NaN.
    """
    if math.isfinite(speed):
        epoch.values["speed"] = speed
        epoch.values["course"] = math.radians(course_deg)


def _to_number(word: Any) -> float:
    """Return a field of an NMEA sentence, as pynmeagps gives it, as a number; NaN for an empty field or a text."""
    return float(word) if isinstance(word, (int, float)) else NAN


def _to_integer(word: Any, default: int) -> int:
    """Return a field of an NMEA sentence as a whole number; `default` if the field is empty or not a number."""
    try:
        return int(word)
    except (TypeError, ValueError):
        return default


_READERS = {
    "GGA": _read_gga, "GNS": _read_gns, "RMC": _read_rmc, "GLL": _read_gll,
    "VTG": _read_vtg, "GST": _read_gst, "ZDA": _read_zda,
}  # fmt: skip


class Headings:
    """Converter of heading sentences of NMEA 0183 to `Ahrs` samples, and of XDR to `Transducer` samples.

    The best kind of sentence received so far gives the yaw: PASHR or PSTI, then HDT, THS, HDG, HDM. Other kinds give no
    sample, even if the best kind is no longer sent. Pitch and roll are from the same sentence or from XDR before it.
    The yaw rate is from ROT before it. Pitch, roll and yaw rate are used for one sample only. Missing values are NaN.

    Parameters
    ----------
    declination
        True heading minus magnetic heading [rad], positive to the east. None if it is unknown. The declination corrects
        magnetic headings without a variation in HDG. If variation and declination are missing, magnetic headings give
        no sample, and `remark` reports this.
    signal_ending
        Ending of the names of transducers. None if transducers are to be left out.

    Attributes
    ----------
    remark : str
        Advice for the user, in one line; empty if there is none.
    """

    def __init__(self, declination: float | None = None, signal_ending: str | None = None) -> None:
        """Start without received sentences.

        `declination` is the true heading minus the magnetic heading [rad], None if it is unknown. `signal_ending` is
        the ending of the names of transducers, None to leave transducers out.
        """
        self.remark = ""
        self._signal_ending = signal_ending
        self._declination = declination
        self._best = 0  # rank of the best kind of sentence so far
        self._rate = NAN  # rad/s
        self._level = [NAN, NAN]  # rad, pitch and roll

    def forget(self) -> None:
        """Discard all values from earlier heading sentences, because a reopened port may have another device."""
        self._best, self._rate, self._level = 0, NAN, [NAN, NAN]

    def take(self, kind: str, body: bytes, t_rx: float) -> list[Frame] | None:
        """Decode one NMEA sentence with heading, rate of turn or transducers. Return its samples.

        Return None if its fields are invalid. Return an empty list for other kinds of sentences, for a heading of a
        worse kind than an earlier one, for a heading that is empty, flagged as invalid or above 360 deg, and for a
        magnetic heading that cannot be corrected.

        Parameters
        ----------
        kind
            Kind of the sentence, such as "HDT"; empty for a proprietary sentence, whose kind is found in `body`.
        body
            Text between `$` and `*`.
        t_rx
            Run time of receipt [s].
        """
        words = body.split(b",")
        if words[0] == b"PASHR" and len(words) > 5 and words[3] == b"T":
            kind = "PASHR"
        elif words[:2] == [b"PSTI", b"036"] and len(words) > 6:
            kind = "PSTI"
        if kind == "ROT":
            return self._store_rate_of_turn(words)
        if kind == "XDR":
            return self._store_transducers(words, t_rx)
        rank = _RANK.get(kind, 0)
        if rank < max(self._best, 1):
            return []
        places = _ATTITUDE.get(kind, (1,))
        if len(words) < 2 or not words[places[0]] or _is_void(kind, words):
            return []
        numbers = _parse_numbers(words, places)
        if numbers is None:
            return None
        if abs(numbers[0]) > _FULL_TURN:
            return []
        yaw = numbers[0] * _DEG + self._heading_correction(kind, words)
        if math.isnan(yaw):
            self.remark = "magnetic headings are left out: the rig has no declination_deg for this device; add it"
            return []
        self._best, self.remark = rank, ""
        pitch, roll = [angle * _DEG for angle in numbers[1:]] or self._level
        rate, self._rate, self._level = self._rate, NAN, [NAN, NAN]
        return [Frame(Ahrs(wrap_angle(yaw), pitch, roll, r=rate), t_rx, NAN)]

    def _store_rate_of_turn(self, words: list[bytes]) -> list[Frame] | None:
        """Store the rate of turn of an NMEA sentence ROT, given as its fields, for the next heading sample.

        The rate is converted from deg/min to rad/s and is positive to starboard. Return an empty list, or None if the
        rate is not a number. An empty rate, or one flagged as invalid, is not stored.
        """
        if len(words) < 3 or words[2] != b"A" or not words[1]:
            return []
        numbers = _parse_numbers(words, (1,))
        if numbers is None:
            return None
        self._rate = numbers[0] * _DEG / 60.0  # ROT is in degrees per minute, positive to starboard
        return []

    def _store_transducers(self, words: list[bytes], t_rx: float) -> list[Frame] | None:
        """Store pitch and roll of an NMEA sentence XDR for the next heading. Return the samples of other transducers.

        `words` are the fields of the sentence, with groups of kind, value, unit and name. Pitch and roll are in
        degrees, positive with the bow up and with starboard down. Other values of known kinds are converted to the unit
        in the sample (bar to Pa, per cent to 1, angles to rad); those of unknown kinds are unchanged with the unit "1".
        A transducer without a name or without a number is left out; all are if `signal_ending` is None. Return None if
        pitch or roll is not a number.
        """
        frames = []
        for at in range(1, len(words) - 3, 4):
            if words[at] == b"A" and words[at + 2] == b"D" and words[at + 3] in _LEVEL:
                numbers = _parse_numbers(words, (at + 1,))
                if numbers is None:
                    return None
                self._level[_LEVEL[words[at + 3]]] = numbers[0] * _DEG
            elif self._signal_ending is not None and words[at + 3] and (numbers := _parse_numbers(words, (at + 1,))):
                unit, factor = _TRANSDUCERS.get((words[at], words[at + 2]), ("1", 1.0))
                name = re.sub("[^A-Za-z0-9_]+", "_", words[at + 3].decode("ascii", "replace")).strip("_")
                sample = Transducer(factor * numbers[0], f"{XDR}{name}{self._signal_ending}", unit)
                frames.append(Frame(sample, t_rx, NAN))
        return frames

    def _heading_correction(self, kind: str, words: list[bytes]) -> float:
        """Return the true heading minus the heading in an NMEA sentence [rad]; NaN if it is unknown.

        The difference is zero for true headings. For magnetic headings (HDG, HDM) it is variation plus deviation. The
        variation is that of the sentence, or else the declination of the rig. A missing deviation counts as zero.
        """
        if kind not in ("HDG", "HDM"):
            return 0.0
        deviation = _signed_angle(words, 2) if kind == "HDG" else 0.0
        variation = _signed_angle(words, 4) if kind == "HDG" and len(words) > 5 and words[4] else NAN
        if math.isnan(variation):
            variation = NAN if self._declination is None else self._declination
        return variation + (0.0 if math.isnan(deviation) else deviation)


def _is_void(kind: str, words: list[bytes]) -> bool:
    """Return whether a heading sentence of NMEA 0183 reports by its flags that its heading is invalid.

    `kind` is THS, PSTI or PASHR; sentences of other kinds have no such flag, and the result is False. `words` are the
    fields of the sentence as text. THS is void without the mode A or E, PSTI with an empty mode or N, and PASHR if its
    words 10 and 11 are 0.
    """
    if kind == "THS":
        return words[-1] not in _THS_VALID
    if kind == "PSTI":  # the mode letters are those of RMC; N is invalid
        return len(words) > 7 and words[7] in (b"", b"N")
    # PASHR is invalid without a position (first 0), except with an inertial sensor (second word not 0).
    return kind == "PASHR" and words[10:12] == [b"0", b"0"]


def _signed_angle(words: list[bytes], index: int) -> float:
    """Return an angle [rad] of an NMEA sentence: the word with this index in degrees, negative if the next word is W.

    The result is NaN if the word is not a number, or if the next word is neither E nor W.
    """
    if len(words) < index + 2 or words[index + 1] not in (b"E", b"W") or not _NUMBER.match(words[index]):
        return NAN
    return float(words[index]) * _DEG * (1.0 if words[index + 1] == b"E" else -1.0)


def _parse_numbers(words: list[bytes], places: tuple[int, ...]) -> list[float] | None:
    """Return the numbers in the words of an NMEA sentence with these indices.

    Return None if one is missing, not a number, or longer than 20 characters.
    """
    numbers = []
    for place in places:
        if place >= len(words) or not _NUMBER.match(words[place]) or len(words[place]) > 20:
            return None
        numbers.append(float(words[place]))
    return numbers
