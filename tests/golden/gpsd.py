"""Captures of gpsd's test suite: what our decoders make of them beside what gpsd makes of them.

Source: gpsd, test/daemon at 46977faa (BSD-2). A capture is what a receiver sent behind some lines with `#`; its `.chk`
is gpsd's own decoding, one JSON report a line, positions in TPV.
"""

from __future__ import annotations

import datetime
import json
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from daq.protocol import nmea, ubx
from daq.samples import Frame, Gnss

TIME_DIGITS = 1e-3  # s, as gpsd prints


class Fix(NamedTuple):
    """One position: UTC [s since 1970], latitude and longitude [deg]."""

    utc: float
    lat: float
    lon: float


@dataclass
class Comparison:
    """A capture: how many of gpsd's fixes are ours too, and why the others are not."""

    name: str
    samples: int
    checksum_errors: int
    fixes: int
    agreeing: int
    by_sentence: int = 0  # of these: with another sentence of the epoch than the one we take, of fewer digits
    misses: Counter[str] = field(default_factory=Counter)


def receiver_bytes(path: Path) -> bytes:
    """The capture without its header."""
    data = path.read_bytes()
    while data.startswith(b"#"):
        data = data.partition(b"\n")[2]
    return data


def decode(data: bytes) -> tuple[ubx.Decoder, list[Frame]]:
    """The samples of a capture; the decoder with its counters."""
    decoder = ubx.Decoder()
    return decoder, decoder.feed(data, 0.0) + decoder.flush()


def reported(chk: Path) -> list[tuple[Fix, int]]:
    """gpsd's fixes with the number of decimals of their latitude, each once."""
    found: dict[Fix, int] = {}
    for line in chk.read_bytes().splitlines():
        if not line.startswith(b'{"class":"TPV"'):
            continue
        words = json.loads(line, parse_float=str)
        if words.get("mode", 0) < 2 or "lat" not in words or "lon" not in words or "time" not in words:
            continue
        when = datetime.datetime.fromisoformat(words["time"]).timestamp()
        decimals = min(len(str(words[key]).partition(".")[2]) for key in ("lat", "lon"))
        found[Fix(when, float(words["lat"]), float(words["lon"]))] = decimals
    return list(found.items())


def compare(path: Path) -> Comparison:
    """Decode a capture and look up each of gpsd's fixes among our own.

    gpsd may have taken another sentence of an epoch than we do, and each has digits of its own: then the fix has to
    be among what our decoder reads from the sentences of that kind alone.
    """
    data = receiver_bytes(path)
    decoder, frames = decode(data)
    ours, theirs = _fixes(frames), reported(path.with_name(path.name + ".chk"))
    result = Comparison(path.stem, len(ours), decoder.checksum_errors, len(theirs), 0)
    others = _by_sentence(data, ours[-1].utc) if ours and theirs else []
    for fix, decimals in theirs:
        digits = 0.51 * 10.0**-decimals + 1e-12
        why = _difference(fix, digits, ours)
        if not why:
            result.agreeing += 1
        elif not _difference(fix, digits, others):
            result.agreeing += 1
            result.by_sentence += 1
        else:
            result.misses[why] += 1
    return result


def _fixes(frames: list[Frame]) -> list[Fix]:
    return [Fix(s.utc, s.lat, s.lon) for f in frames if isinstance(s := f.sample, Gnss) and s.lat == s.lat]


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
        return "same place, " + ("another date" if gap >= 43200.0 else f"{gap:.3f} s apart")
    return "no sample of ours at this time" if ours else "no fix of ours at all"


def _size(degrees: float) -> str:
    return "below 1 m" if degrees < 9e-6 else "above 1 m"
