"""Captures of gpsd's test suite: what our decoders make of them beside what gpsd makes of them.

Source: gpsd, test/daemon at 46977faa (BSD-2). A capture is what a receiver sent behind some lines with `#`; its `.chk`
is gpsd's own decoding, one JSON report a line: positions in TPV, attitudes in ATT.

What gpsd concludes against the receiver's own words is not compared: a date moved by 1024 weeks, a speed made of two
positions, three dimensions for a height where GSA says two.

Why places differ at the right time. gpsd reports the place of each sentence. We give one sample an epoch, with the
place of GGA, which has the most digits. Of the 1596 fixes that can be compared 1479 are ours to gpsd's last digit. Of
the others the receiver has another place in RMC or GLL:

- A chart plotter goes on with the place between the sentences of one second (bundg_zeus_9, 103 fixes). 66 of its RMC
  and GLL are 0.2 m, the way of a tenth of a second, from GGA of the same time. 37 have the place of the second before
  under the time of this one, 2 m at 6 kn: to take these would be an error.
- Its RMC has a digit less than GGA (ac12, ac12_binary, tcp-test, udp-test: 13 fixes, less than 1 m apart).

Such a fix agrees where the sentence that gpsd took gives it by our decoder, too (`Comparison.by_sentence`), and
`Comparison.late` counts those of the epoch before. One fix is left: ublox-lea-4t, where gpsd has not heard of the leap
seconds.
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

TIME_DIGITS = 1e-3  # s, as gpsd prints
SPEED_DIGITS = 6e-3  # m/s: a hundredth of a knot, and what gpsd prints
ANGLE_DIGITS = 5.1e-3  # deg
DAY = 86400.0
EPOCH_S = 1.5  # s: the longest time between two epochs
MOVED_DATE = "same place, another date"


class Fix(NamedTuple):
    """One position: UTC [s since 1970], latitude and longitude [deg], speed over ground [m/s], dimensions."""

    utc: float
    lat: float
    lon: float
    speed: float = NAN
    dimensions: int = -1


@dataclass
class Reported:
    """One of gpsd's fixes: decimals of its latitude, and what its reports say of speed [m/s] and dimensions."""

    decimals: int
    speeds: list[float] = field(default_factory=list)
    modes: set[int] = field(default_factory=set)


@dataclass
class Share:
    """How many of those that can be compared agree; what the others are."""

    comparable: int = 0
    agreeing: int = 0
    differing: list[str] = field(default_factory=list)
    by_sentence: int = 0  # of these: the receiver's word by another sentence than gpsd took, or beside its conclusion

    @property
    def part(self) -> float:
        """Part of the comparable ones that agree."""
        return self.agreeing / max(self.comparable, 1)

    def count(self, right: bool, text: str) -> None:
        """One more."""
        self.comparable += 1
        self.agreeing += right
        if not right:
            self.differing.append(text)


@dataclass
class Comparison:
    """A capture: how many of gpsd's fixes are ours too, and why the others are not."""

    name: str
    samples: int
    checksum_errors: int
    fixes: int
    agreeing: int
    by_sentence: int = 0  # of these: with another sentence of the epoch than the one we take
    late: int = 0  # of these: the place of the epoch before under the time of this one
    misses: Counter[str] = field(default_factory=Counter)
    speeds: Share = field(default_factory=Share)
    modes: Share = field(default_factory=Share)
    headings: Share = field(default_factory=Share)

    @property
    def comparable(self) -> int:
        """gpsd's fixes at the date that the receiver said."""
        return self.fixes - self.misses[MOVED_DATE]


def receiver_bytes(path: Path) -> bytes:
    """The capture without its header."""
    data = path.read_bytes()
    while data.startswith(b"#"):
        data = data.partition(b"\n")[2]
    return data


def decode(data: bytes, near: float = 0.0) -> tuple[ubx.Decoder, list[Frame]]:
    """The samples of a capture received at `near` [s], north magnetic; the decoder with its counters."""
    decoder = ubx.Decoder(declination=0.0)
    return decoder, decoder.feed(data, near) + decoder.flush()


def _reports(chk: Path, kind: bytes) -> list[dict[str, Any]]:
    lines = (line for line in chk.read_bytes().splitlines() if line.startswith(b'{"class":"%b"' % kind))
    return [json.loads(line, parse_float=str) for line in lines]


def _time(words: dict[str, Any]) -> float:
    return datetime.datetime.fromisoformat(words["time"]).timestamp() if "time" in words else NAN


def reported(chk: Path) -> dict[Fix, Reported]:
    """gpsd's fixes, each once."""
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
    """Decode a capture and look up each of gpsd's fixes among our own.

    gpsd may have taken another sentence of an epoch than we do, and each has digits of its own: then the fix has to
    be among what our decoder reads from the sentences of that kind alone.
    """
    data, chk = receiver_bytes(path), path.with_name(path.name + ".chk")
    decoder, frames = decode(data)
    ours, theirs = _fixes(frames), reported(chk)
    result = Comparison(path.stem, len(ours), decoder.checksum_errors, len(theirs), 0)
    others = _by_sentence(data, ours[-1].utc) if ours and theirs else []
    _headings(result.headings, data, ours[-1].utc if ours else 0.0, chk)
    said, is_ubx = Said(data), b"\xb5\x62\x01" in data
    for fix, report in theirs.items():
        _motion(result, fix, report, ours, None if is_ubx else said)
        digits = 0.51 * 10.0**-report.decimals + 1e-12
        why = _difference(fix, digits, ours)
        if not why:
            result.agreeing += 1
        elif not _difference(fix, digits, others):
            result.agreeing += 1
            result.by_sentence += 1
            result.late += _is_late(fix, ours)
        else:
            result.misses[why] += 1
    return result


class Said:
    """What the sentences of a receiver say by the time of the day [s]: speeds [m/s], and dimensions (GSA)."""

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


def _motion(result: Comparison, theirs: Fix, report: Reported, ours: list[Fix], said: Said | None) -> None:
    """Compare speed and dimensions of gpsd's fix with ours of the same time; `said` None: not a receiver of NMEA."""
    own = min(
        (o for o in ours if abs(o.utc - theirs.utc) <= TIME_DIGITS),
        key=lambda o: abs(o.lat - theirs.lat) + abs(o.lon - theirs.lon),
        default=None,
    )
    if own is None:
        return  # a position that is missing is counted as that
    at = round(theirs.utc % DAY, 3)
    words = set() if said is None else said.speeds.get(at, set())
    speeds = [s for s in report.speeds if said is None or _among(s, words)]
    if _among(own.speed, speeds):
        result.speeds.count(True, "")
    elif speeds or (report.speeds and math.isfinite(own.speed)):
        # gpsd has taken another sentence of the epoch, or drawn its own conclusion: ours has to be the receiver's.
        result.speeds.by_sentence += (right := _among(own.speed, words))
        result.speeds.count(right, f"{theirs.utc}: {own.speed:.3f} m/s, gpsd {report.speeds}, receiver {words}")
    by_receiver = set() if said is None else said.dimensions.get(at, set()) & {2, 3}
    if not by_receiver or by_receiver & report.modes:
        result.modes.count(own.dimensions in report.modes, f"{theirs.utc}: {own.dimensions}, gpsd {report.modes}")


def _among(speed: float, others: Iterable[float]) -> bool:
    return any(abs(speed - other) <= SPEED_DIGITS for other in others)


def _headings(share: Share, data: bytes, near: float, chk: Path) -> None:
    """Compare each new heading of gpsd's, with its time where it has one, with ours."""
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
    """The fixes of each kind of sentence alone; `near` [s] says the day where a kind has no date."""
    found: list[Fix] = []
    for kind in (b"RMC", b"GGA", b"GLL", b"GNS"):
        decoder = nmea.Decoder()
        lines = [line + b"\n" for line in data.split(b"\n") if line.lstrip(b"$")[2:5] in (kind, b"ZDA")]
        found += _fixes(decoder.feed(b"".join(lines), near) + decoder.flush())
    return found


def _difference(theirs: Fix, digits: float, ours: list[Fix]) -> str:
    """Why none of our fixes is this one; empty if one is."""
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
    """Whether a fix has rather the place of our epoch before than that of its own time."""
    away = {o.utc: max(abs(o.lat - theirs.lat), abs(o.lon - theirs.lon)) for o in ours}
    own = min((away[t] for t in away if abs(t - theirs.utc) <= TIME_DIGITS), default=NAN)
    return any(away[t] < 0.5 * own for t in away if TIME_DIGITS < theirs.utc - t <= EPOCH_S)


def _size(degrees: float) -> str:
    return "below 1 m" if degrees < 9e-6 else "above 1 m"
