"""NMEA 0183, the sentences of a position: those of one epoch become one `Gnss`.

The fields are parsed by pynmeagps. Sentences are grouped by their time, not by their order: some receivers send RMC
first, some GGA, and VTG carries no time at all.
"""

from __future__ import annotations

import datetime
import math
import re
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from pynmeagps import NMEAReader

from daq.samples import NAN, Frame, Gnss

KNOT = 1852.0 / 3600.0  # m/s
DAY = 86400.0
REMEMBERED = 10  # epochs; some sentences do not come with each
_TIME = re.compile(rb"(\d\d)(\d\d)(\d\d(?:\.\d*)?)\Z")
_TIME_FIELD = {"GGA": 1, "RMC": 1, "GST": 1, "ZDA": 1, "GNS": 1, "GLL": 5}
_POSITION = ("GGA", "GNS", "RMC", "GLL")  # the first of them that has one gives the position
KINDS = frozenset({*_TIME_FIELD, "VTG", "GSA"})
# GGA quality -> Gnss.fix; 2-D and 3-D fixes are the same in GGA, GSA tells them apart.
_QUALITY = {0: 0, 1: 3, 2: 4, 3: 3, 4: 5, 5: 6, 6: 1, 7: 1, 8: 3}
_MODE = {"A": 3, "D": 4, "P": 3, "R": 5, "F": 6, "E": 1, "M": 1, "S": 3, "N": 0}
Message = dict[str, Any]


@dataclass
class _Epoch:
    """What the sentences of one time have said so far."""

    seconds: float  # of the day
    t_rx: float
    kinds: set[str] = field(default_factory=set)
    date: datetime.date | None = None
    position: dict[str, tuple[float, float]] = field(default_factory=dict)
    values: dict[str, float] = field(default_factory=dict)


class Epochs:
    """Sentences -> `Gnss`, one sample an epoch.

    An epoch is complete when all kinds of sentence that came in the last few epochs have come, or else when the next
    begins. `t_rx` of a sample is that of the epoch's first sentence, which is nearest to the measurement; `t_device` is
    its UTC. Without a date (no RMC or ZDA yet) the day is the one that puts the time next to `t_rx`.
    """

    def __init__(self) -> None:
        self._out: list[Frame] = []
        self._epoch: _Epoch | None = None
        self._emitted = False
        self._kinds: deque[set[str]] = deque(maxlen=REMEMBERED)
        self._expected: set[str] = set()
        self._last_utc = NAN
        self._mode_gsa = 0

    def take(self, kind: str, body: bytes, t_rx: float) -> list[Frame] | None:
        """Take one sentence whose kind is one of KINDS; the samples it completes, None if it is none after all."""
        message = _parse(body)
        if message is None:
            return None
        self._sentence(kind, message, body.split(b","), t_rx)
        return self._given()

    def flush(self) -> list[Frame]:
        """End of the stream: the sample of the epoch that has not been emitted, if there is one."""
        self._emit()
        return self._given()

    def forget(self) -> None:
        """Forget the epoch that is not complete (the port was reopened)."""
        self._epoch = None

    def _given(self) -> list[Frame]:
        out, self._out = self._out, []
        return out

    def _sentence(self, kind: str, message: Message, words: list[bytes], t_rx: float) -> None:
        if kind == "GSA":
            self._mode_gsa = _integer(message.get("navMode"), 0)
        elif kind == "VTG":
            self._add(kind, message)  # it carries no time: it belongs to the sentence that came before
        else:
            seconds = _seconds(words, _TIME_FIELD[kind])
            if math.isnan(seconds):
                return
            if self._epoch is None or self._epoch.seconds != seconds:
                self._begin(seconds, t_rx)
            self._add(kind, message)

    def _begin(self, seconds: float, t_rx: float) -> None:
        if self._epoch is not None:
            self._emit()
            self._kinds.append(self._epoch.kinds)
            self._expected = set().union(*self._kinds)
        self._epoch, self._emitted = _Epoch(seconds, t_rx), False

    def _add(self, kind: str, message: Message) -> None:
        epoch = self._epoch
        if epoch is None:
            return
        epoch.kinds.add(kind)
        _READ[kind](epoch, message)
        if self._expected and epoch.kinds >= self._expected:
            self._emit()

    def _emit(self) -> None:
        epoch = self._epoch
        if epoch is None or self._emitted:
            return
        self._emitted = True
        utc = self._utc(epoch)
        if epoch.kinds.isdisjoint(_POSITION):
            return
        self._out.append(Frame(_gnss(epoch, utc, self._mode_gsa), epoch.t_rx, utc))

    def _utc(self, epoch: _Epoch) -> float:
        if epoch.date is not None:
            midnight = datetime.datetime.combine(epoch.date, datetime.time(), datetime.UTC)
            utc = midnight.timestamp() + epoch.seconds
        else:
            near = self._last_utc if math.isfinite(self._last_utc) else epoch.t_rx
            if not math.isfinite(near):
                return NAN
            utc = math.floor(near / DAY) * DAY + epoch.seconds
            utc += round((near - utc) / DAY) * DAY  # past midnight
        self._last_utc = utc
        return utc


def _parse(body: bytes) -> Message | None:
    """The sentence's fields as pynmeagps reads them; None if it cannot. A short sentence lacks the last fields."""
    try:
        return dict(vars(NMEAReader.parse(b"$%b*00\r\n" % body, validate=0)))
    except Exception:
        # It raises errors of its own and, for fields that are no numbers, of many other kinds. Such a sentence is
        # counted among the unparsed bytes by the caller.
        return None


def _seconds(words: list[bytes], at: int) -> float:
    """Seconds of the day; NaN where void. A leap second (:60) is one, which pynmeagps makes void."""
    found = _TIME.match(words[at]) if at < len(words) else None
    if found is None:
        return NAN
    hours, minutes, seconds = int(found[1]), int(found[2]), float(found[3])
    return 3600.0 * hours + 60.0 * minutes + seconds if hours < 24 and minutes < 60 and seconds < 61.0 else NAN


def _gnss(epoch: _Epoch, utc: float, mode_gsa: int) -> Gnss:
    value = epoch.values
    fix = int(value.get("quality", value.get("mode", 0)))
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
    )  # fmt: skip


def _number(word: Any) -> float:
    return float(word) if isinstance(word, (int, float)) else NAN


def _integer(word: Any, default: int) -> int:
    try:
        return int(word)
    except (TypeError, ValueError):
        return default


def _place(epoch: _Epoch, kind: str, message: Message) -> None:
    lat, lon = _number(message.get("lat")), _number(message.get("lon"))
    if abs(lat) <= 90.0 and abs(lon) <= 180.0:
        epoch.position[kind] = (lat, lon)


def _keep(epoch: _Epoch, name: str, value: float) -> None:
    if math.isfinite(value):
        epoch.values[name] = value


def _motion(epoch: _Epoch, speed: float, course_deg: float) -> None:
    if math.isfinite(speed):
        epoch.values["speed"] = speed
        epoch.values["course"] = math.radians(course_deg)


def _read_gga(epoch: _Epoch, message: Message) -> None:
    fix = _QUALITY.get(_integer(message.get("quality"), 0), 0)
    epoch.values["quality"] = fix
    _keep(epoch, "n_sat", _number(message.get("numSV")))
    if fix:
        _place(epoch, "GGA", message)
        _keep(epoch, "alt", _number(message.get("alt")))
        _keep(epoch, "hdop", _number(message.get("HDOP")))


def _read_gns(epoch: _Epoch, message: Message) -> None:
    fix = max((_MODE.get(letter, 0) for letter in str(message.get("posMode", ""))), default=0)
    epoch.values.setdefault("mode", fix)
    if fix:
        _place(epoch, "GNS", message)


def _read_rmc(epoch: _Epoch, message: Message) -> None:
    if isinstance(date := message.get("date"), datetime.date):
        # Two digits of a year: before its first fix a receiver counts from 1980.
        century = 100 if date.year >= 2080 else 0
        epoch.date = date.replace(year=date.year - century)
    valid = message.get("status") == "A"
    epoch.values["mode"] = _MODE.get(str(message.get("posMode") or "A"), 0) if valid else 0
    if valid:
        _place(epoch, "RMC", message)
        _motion(epoch, _number(message.get("spd")) * KNOT, _number(message.get("cog")))


def _read_gll(epoch: _Epoch, message: Message) -> None:
    if message.get("status") == "A":
        epoch.values.setdefault("mode", 3)
        _place(epoch, "GLL", message)


def _read_vtg(epoch: _Epoch, message: Message) -> None:
    if "RMC" not in epoch.kinds:  # RMC says the same and is sure to be of this epoch
        _motion(epoch, _number(message.get("sogk")) / 3.6, _number(message.get("cogt")))


def _read_gst(epoch: _Epoch, message: Message) -> None:
    _keep(
        epoch, "sigma_h", math.hypot(_number(message.get("stdLat")), _number(message.get("stdLong"))) / math.sqrt(2.0)
    )


def _read_zda(epoch: _Epoch, message: Message) -> None:
    try:
        epoch.date = datetime.date(
            int(message.get("year", "")), int(message.get("month", "")), int(message.get("day", ""))
        )
    except (TypeError, ValueError):
        return


_READ = {
    "GGA": _read_gga, "GNS": _read_gns, "RMC": _read_rmc, "GLL": _read_gll,
    "VTG": _read_vtg, "GST": _read_gst, "ZDA": _read_zda,
}  # fmt: skip
