"""NMEA 0183, the sentences of a heading: HDT, THS, HDG, HDM, HCHDG and the like, and the attitude of $PASHR.

Source: NMEA 0183 v4.11 (HDT, THS, HDG, HDM, ROT); $PASHR as two-antenna receivers and inertial sensors send it
(heading, roll, pitch). None of them carries a time that is known to be that of the measurement.
"""

from __future__ import annotations

import math
import re

from daq.samples import NAN, Ahrs, Frame

_NUMBER = re.compile(rb"[+-]?\d+(\.\d*)?\Z")
_DEG = math.pi / 180.0
# Which sentence to believe where a device sends several: the one with attitude, then true, then magnetic.
_RANK = {"PASHR": 5, "HDT": 4, "THS": 3, "HDG": 2, "HDM": 1}
_THS_VALID = b"AE"  # autonomous, estimated; M is by hand, S simulated, V void


class Headings:
    """Sentences -> `Ahrs` with yaw, from the best kind of sentence heard; roll and pitch where it has them.

    A rate of turn (ROT) goes into the next heading. Magnetic headings become true ones by the variation that HDG
    carries or else by `declination` [rad, east positive]; without either they give no sample, and `remark` says so.
    """

    def __init__(self, declination: float | None = None) -> None:
        self.remark = ""
        self._declination = declination
        self._best = 0
        self._rate = NAN

    def forget(self) -> None:
        """The port was reopened: there may be another device now."""
        self._best, self._rate = 0, NAN

    def take(self, kind: str, body: bytes, t_rx: float) -> list[Frame] | None:
        """Take one sentence; None if its fields make no sense. A sentence of another kind gives nothing."""
        words = body.split(b",")
        if words[0] == b"PASHR" and len(words) > 5 and words[3] == b"T":
            kind = "PASHR"
        if kind == "ROT":
            return self._turn(words)
        rank = _RANK.get(kind, 0)
        if rank < max(self._best, 1):
            return []
        void = len(words) < 2 or not words[2 if kind == "PASHR" else 1]
        if void or (kind == "THS" and words[-1] not in _THS_VALID):
            return []
        numbers = _numbers(words, (2, 4, 5) if kind == "PASHR" else (1,))
        if numbers is None:
            return None
        yaw = numbers[0] * _DEG + self._variation(kind, words)
        if math.isnan(yaw):
            self.remark = "magnetic headings are left out: the rig has no declination_deg for this device"
            return []
        self._best, self.remark = rank, ""
        roll, pitch = (angle * _DEG for angle in (*numbers[1:], NAN, NAN)[:2])
        rate, self._rate = self._rate, NAN
        return [Frame(Ahrs(math.remainder(yaw, math.tau), pitch, roll, r=rate), t_rx, NAN)]

    def _turn(self, words: list[bytes]) -> list[Frame] | None:
        if len(words) < 3 or words[2] != b"A" or not words[1]:
            return []
        numbers = _numbers(words, (1,))
        if numbers is None:
            return None
        self._rate = numbers[0] * _DEG / 60.0  # degrees a minute, positive to starboard
        return []

    def _variation(self, kind: str, words: list[bytes]) -> float:
        """What has to be added to the heading that was read, rad; NaN where that is not known."""
        if kind not in ("HDG", "HDM"):
            return 0.0
        deviation = _signed(words, 2) if kind == "HDG" else 0.0
        variation = _signed(words, 4) if kind == "HDG" and len(words) > 5 and words[4] else NAN
        if math.isnan(variation):
            variation = NAN if self._declination is None else self._declination
        return variation + (0.0 if math.isnan(deviation) else deviation)


def _signed(words: list[bytes], at: int) -> float:
    """An angle [rad] with E or W behind it; NaN where void."""
    if len(words) < at + 2 or words[at + 1] not in (b"E", b"W") or not _NUMBER.match(words[at]):
        return NAN
    return float(words[at]) * _DEG * (1.0 if words[at + 1] == b"E" else -1.0)


def _numbers(words: list[bytes], places: tuple[int, ...]) -> list[float] | None:
    found = []
    for place in places:
        if place >= len(words) or not _NUMBER.match(words[place]) or len(words[place]) > 20:
            return None
        found.append(float(words[place]))
    return found
