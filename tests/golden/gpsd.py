"""Comparison of our decoders with gpsd on the captures of gpsd's test suite.

Source: gpsd, test/daemon at 46977faa (BSD-2). A capture contains the bytes of a receiver after some lines with `#`. Its
`.chk` contains gpsd's decoding, one JSON report a line: positions in TPV, attitudes in ATT.

Conclusions of gpsd that contradict the receiver are not compared: a date moved by 1024 weeks, a speed computed from two
positions, and three dimensions because of a height although GSA reports two.

Positions can differ at the same time. gpsd reports the position of each sentence. We give one sample an epoch, with the
position of GGA, which has the most digits. Of the 1596 comparable fixes 1479 agree to gpsd's last digit. For the others
the receiver sends another position in RMC or GLL:

- A chart plotter updates the position between the sentences of one second (bundg_zeus_9, 103 fixes).
  66 of its RMC and GLL are 0.2 m, the distance of a tenth of a second, from GGA of the same time.
  37 have the position of the previous second with the time of this second. The error is 2 m at 6 kn.
- RMC has one digit less than GGA (ac12, ac12_binary, tcp-test, udp-test: 13 fixes, less than 1 m apart).

Such a fix agrees if our decoder gives the same position from the sentence that gpsd used (`Comparison.by_sentence`).
`Comparison.late` counts the fixes with the position of the previous epoch. One fix remains: in ublox-lea-4t gpsd has
not yet received the leap seconds.
"""

from __future__ import annotations

import datetime
import json
import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from seatrial.daq.protocol import nmea, ubx
from seatrial.daq.samples import NAN, Ahrs, Frame, Gnss

TIME_DIGITS = 1e-3  # s, resolution of the times that gpsd prints
SPEED_DIGITS = 6e-3  # m/s: a hundredth of a knot plus the resolution of gpsd's output
ANGLE_DIGITS = 5.1e-3  # deg
DAY = 86400.0
EPOCH_S = 1.5  # s: the longest time between two epochs
MOVED_DATE = "same place, another date"


class Fix(NamedTuple):
    """Position fix: UTC [s since 1970], latitude and longitude [deg], speed over ground [m/s], dimensions."""

    utc: float
    lat: float
    lon: float
    speed: float = NAN
    dimensions: int = -1


@dataclass
class Reported:
    """Report of gpsd on a fix: decimals of its latitude, reported speeds [m/s] and dimensions."""

    decimals: int
    speeds: list[float] = field(default_factory=list)
    modes: set[int] = field(default_factory=set)


@dataclass
class Share:
    """Number of comparable values that agree, and the values that differ."""

    comparable: int = 0
    agreeing: int = 0
    differing: list[str] = field(default_factory=list)
    # agreeing values that are in another sentence than gpsd used, or that contradict a conclusion of gpsd
    by_sentence: int = 0

    @property
    def part(self) -> float:
        """Return the share of agreeing values among the comparable values."""
        return self.agreeing / max(self.comparable, 1)

    def count(self, right: bool, text: str) -> None:
        """Count one more value."""
        self.comparable += 1
        self.agreeing += right
        if not right:
            self.differing.append(text)


@dataclass
class Comparison:
    """Result for one capture: the number of gpsd's fixes that agree with ours, and the reasons for the others."""

    name: str
    samples: int
    checksum_errors: int
    fixes: int
    agreeing: int
    by_sentence: int = 0  # agreeing fixes that are in another sentence of the epoch than the sentence we use
    late: int = 0  # agreeing fixes that have the position of the previous epoch with the time of this epoch
    misses: Counter[str] = field(default_factory=Counter)
    speeds: Share = field(default_factory=Share)
    modes: Share = field(default_factory=Share)
    headings: Share = field(default_factory=Share)

    @property
    def comparable(self) -> int:
        """Return the number of gpsd's fixes at the date that the receiver sent."""
        return self.fixes - self.misses[MOVED_DATE]


def receiver_bytes(path: Path) -> bytes:
    """Return the capture without its header."""
    data = path.read_bytes()
    while data.startswith(b"#"):
        data = data.partition(b"\n")[2]
    return data


def decode(data: bytes, near: float = 0.0) -> tuple[ubx.Decoder, list[Frame]]:
    """Return the decoder with its counters, and the frames of a capture received at `near` [s], north magnetic."""
    decoder = ubx.Decoder(declination=0.0)
    return decoder, decoder.feed(data, near) + decoder.flush()


def _reports(chk: Path, kind: bytes) -> list[dict[str, Any]]:
    lines = (line for line in chk.read_bytes().splitlines() if line.startswith(b'{"class":"%b"' % kind))
    return [json.loads(line, parse_float=str) for line in lines]


def _time(words: dict[str, Any]) -> float:
    return datetime.datetime.fromisoformat(words["time"]).timestamp() if "time" in words else NAN


def reported(chk: Path) -> dict[Fix, Reported]:
    """Return gpsd's fixes without repetitions."""
    found: dict[Fix, Reported] = {}
    for words in _reports(chk, b"TPV"):
        if words.get("mode", 0) < 2 or "lat" not in words or "lon" not in words or "time" not in words:
            continue
        decimals = min(len(str(words[key]).partition(".")[2]) for key in ("lat", "lon"))
        fix = found.setdefault(Fix(_time(words), float(words["lat"]), float(words["lon"])), Reported(decimals))
        fix.modes.add(words["mode"])
        if "speed" in words:
            fix.speeds.append(float(words["speed"]))
    return found


def compare(path: Path) -> Comparison:
    """Decode a capture and look up each of gpsd's fixes among our fixes.

    gpsd may have used another sentence of an epoch than we do, and the sentences differ in digits. Then the fix has to
    be among the fixes that our decoder reads from the sentences of one kind alone.
    """
    data, chk = receiver_bytes(path), path.with_name(path.name + ".chk")
    decoder, frames = decode(data)
    ours, theirs = _fixes(frames), reported(chk)
    result = Comparison(path.stem, len(ours), decoder.checksum_errors, len(theirs), 0)
    alternatives = _by_sentence(data, ours[-1].utc) if ours and theirs else []
    _headings(result.headings, data, ours[-1].utc if ours else 0.0, chk)
    sent, is_ubx = SentValues(data), b"\xb5\x62\x01" in data
    for fix, report in theirs.items():
        _motion(result, fix, report, ours, None if is_ubx else sent)
        digits = 0.51 * 10.0**-report.decimals + 1e-12
        why = _difference(fix, digits, ours)
        if not why:
            result.agreeing += 1
        elif not _difference(fix, digits, alternatives):
            result.agreeing += 1
            result.by_sentence += 1
            result.late += _is_late(fix, ours)
        else:
            result.misses[why] += 1
    return result


class SentValues:
    """Speeds [m/s] and dimensions (GSA) in the sentences of a receiver, by the time of day [s]."""

    def __init__(self, data: bytes) -> None:
        self.speeds: dict[float, set[float]] = defaultdict(set)
        self.dimensions: dict[float, set[int]] = defaultdict(set)
        now, last = NAN, 0
        for words in (line.strip().partition(b"*")[0].split(b",") for line in data.split(b"\n")):
            kind = words[0][-3:]
            if kind == b"GSA" and len(words) > 2 and words[2].isdigit():
                last = int(words[2])
                self.dimensions[now].add(last)
            at = 5 if kind == b"GLL" else 1 if kind in (b"GGA", b"RMC", b"GNS", b"ZDA") else len(words)
            if at < len(words) and (time := re.match(rb"(\d\d)(\d\d)(\d\d\.?\d*)", words[at])):
                now = 3600.0 * int(time[1]) + 60.0 * int(time[2]) + float(time[3])
                self.dimensions[now].add(last)
            for column, unit in {b"RMC": ((7, nmea.KNOT),), b"VTG": ((5, nmea.KNOT), (7, 1.0 / 3.6))}.get(kind, ()):
                if len(words) > column and re.fullmatch(rb"\d+\.?\d*", words[column]):
                    self.speeds[now].add(float(words[column]) * unit)


def _motion(result: Comparison, theirs: Fix, report: Reported, ours: list[Fix], sent: SentValues | None) -> None:
    """Compare speed and dimensions of gpsd's fix with our fix of the same time.

    `sent` is None if the receiver does not send NMEA.
    """
    own = min(
        (o for o in ours if abs(o.utc - theirs.utc) <= TIME_DIGITS),
        key=lambda o: abs(o.lat - theirs.lat) + abs(o.lon - theirs.lon),
        default=None,
    )
    if own is None:
        return  # a missing position is counted elsewhere
    at = round(theirs.utc % DAY, 3)
    words = set() if sent is None else sent.speeds.get(at, set())
    speeds = [s for s in report.speeds if sent is None or _among(s, words)]
    if _among(own.speed, speeds):
        result.speeds.count(True, "")
    elif speeds or (report.speeds and math.isfinite(own.speed)):
        # gpsd has used another sentence of the epoch, or its own conclusion: our value has to be that of the receiver
        result.speeds.by_sentence += (right := _among(own.speed, words))
        result.speeds.count(right, f"{theirs.utc}: {own.speed:.3f} m/s, gpsd {report.speeds}, receiver {words}")
    by_receiver = set() if sent is None else sent.dimensions.get(at, set()) & {2, 3}
    if not by_receiver or by_receiver & report.modes:
        result.modes.count(own.dimensions in report.modes, f"{theirs.utc}: {own.dimensions}, gpsd {report.modes}")


def _among(speed: float, alternatives: Iterable[float]) -> bool:
    return any(abs(speed - alternative) <= SPEED_DIGITS for alternative in alternatives)


def _headings(share: Share, data: bytes, near: float, chk: Path) -> None:
    """Compare each new heading of gpsd with ours, and its time if gpsd reports a time."""
    attitudes = [f for f in decode(data, near)[1] if isinstance(f.sample, Ahrs) and f.sample.yaw == f.sample.yaw]
    last: dict[str, Any] = {}
    for words in [*_reports(chk, b"ATT"), {}]:
        name = next((name for name in ("heading", "mheading") if name in last), "")
        if name and words.get(name) != last[name]:
            share.count(any(_is_attitude(own, last, name) for own in attitudes), str(last))
        last = words


def _is_attitude(own: Frame, words: dict[str, Any], name: str) -> bool:
    sample, when = own.sample, _time(words)
    assert isinstance(sample, Ahrs)
    if abs(math.remainder(math.degrees(sample.yaw) - float(words[name]), 360.0)) > ANGLE_DIGITS:
        return False
    return math.isnan(when) or abs(own.t_device - when) <= TIME_DIGITS


def _fixes(frames: list[Frame]) -> list[Fix]:
    samples = (f.sample for f in frames)
    return [Fix(s.utc, s.lat, s.lon, s.speed, s.dimensions) for s in samples if isinstance(s, Gnss) and s.lat == s.lat]


def _by_sentence(data: bytes, near: float) -> list[Fix]:
    """Return the fixes of each kind of sentence alone. `near` [s] supplies the day for kinds without a date."""
    found: list[Fix] = []
    for kind in (b"RMC", b"GGA", b"GLL", b"GNS"):
        decoder = nmea.Decoder()
        lines = [line + b"\n" for line in data.split(b"\n") if line.lstrip(b"$")[2:5] in (kind, b"ZDA")]
        found += _fixes(decoder.feed(b"".join(lines), near) + decoder.flush())
    return found


def _difference(theirs: Fix, digits: float, ours: list[Fix]) -> str:
    """Return the reason why no fix of ours equals this fix, or an empty string if one does."""
    same_place = [o for o in ours if abs(o.lat - theirs.lat) <= digits and abs(o.lon - theirs.lon) <= digits]
    same_time = [o for o in ours if abs(o.utc - theirs.utc) <= TIME_DIGITS]
    if any(abs(o.utc - theirs.utc) <= TIME_DIGITS for o in same_place):
        return ""
    if same_time:
        gap = min(max(abs(o.lat - theirs.lat), abs(o.lon - theirs.lon)) for o in same_time)
        return f"same time, {_size(gap)} apart"
    if same_place:
        gap = min(abs(o.utc - theirs.utc) for o in same_place)
        return MOVED_DATE if gap >= 0.5 * DAY else f"same place, {gap:.3f} s apart"
    return "no sample of ours at this time" if ours else "no fix of ours at all"


def _is_late(theirs: Fix, ours: list[Fix]) -> bool:
    """Return whether the position of a fix is closer to our previous epoch than to our epoch of its own time."""
    away = {o.utc: max(abs(o.lat - theirs.lat), abs(o.lon - theirs.lon)) for o in ours}
    own = min((away[t] for t in away if abs(t - theirs.utc) <= TIME_DIGITS), default=NAN)
    return any(away[t] < 0.5 * own for t in away if TIME_DIGITS < theirs.utc - t <= EPOCH_S)


def _size(degrees: float) -> str:
    return "below 1 m" if degrees < 9e-6 else "above 1 m"
