"""NMEA 0183 of GNSS receivers and compasses: framing and checksum, and which reader a sentence goes to.

The sentences of one epoch become one `Gnss` (daq.protocol.nmea_epoch), those of a heading an `Ahrs`
(daq.protocol.heading); a receiver with two antennas sends both.
"""

from __future__ import annotations

import datetime
import math
import re

from daq.protocol.framing import StreamDecoder, sentence, take_sentence
from daq.protocol.heading import Headings
from daq.protocol.nmea_epoch import KINDS, KNOT, Epochs
from daq.samples import Frame, Gnss

_FIX_TO_QUALITY = {0: 0, 1: 6, 2: 1, 3: 1, 4: 2, 5: 4, 6: 5}


class Sentences:
    """Whole sentences -> samples: `take` is what every decoder of a stream with NMEA in it needs."""

    def __init__(self, declination: float | None = None) -> None:
        self.epochs = Epochs()
        self.headings = Headings(declination)

    def take(self, body: bytes, t_rx: float) -> list[Frame] | None:
        """The samples that the sentence `body` (between `$` and `*`) completes; None if its fields make no sense."""
        kind = body[2:5].decode("ascii") if body[5:6] == b"," and body[:1] != b"P" else ""
        if kind in KINDS:
            return self.epochs.take(kind, body, t_rx)
        return self.headings.take(kind, body, t_rx)

    def forget(self) -> None:
        """The port was reopened."""
        self.epochs.forget()
        self.headings.forget()


class Decoder(StreamDecoder[Frame]):
    """Sentences -> `Gnss` and `Ahrs`. `declination` [rad, east positive] makes magnetic headings true ones."""

    sync = re.compile(rb"\$")

    def __init__(self, declination: float | None = None) -> None:
        super().__init__()
        self._sentences = Sentences(declination)

    def flush(self) -> list[Frame]:
        """End of the stream: the sample of the epoch that has not been emitted, if there is one."""
        return self._sentences.epochs.flush()

    def reset(self) -> None:
        """Forget a half-read sentence and epoch (the port was reopened). Counters stay."""
        super().reset()
        self._sentences.forget()

    def _take(self, buffer: bytearray, start: int, t_rx: float) -> int:
        length, body, bad = take_sentence(buffer, start)
        self.checksum_errors += bad
        if body is None:
            return length
        found = self._sentences.take(body, t_rx)
        if found is None:
            return -1
        self.frames += 1
        self.remark = self._sentences.headings.remark
        self._out += self._kept(found)
        return length

    def _kept(self, found: list[Frame]) -> list[Frame]:
        """What is passed on of the samples that the sentences gave."""
        return found


def encode(gnss: Gnss) -> bytes:
    """The sentences GGA, RMC, VTG and GST of one epoch. Time is sent to 1 ms, position to 1e-7 minutes (0.2 mm)."""
    milliseconds = round(gnss.utc * 1000.0)
    when = datetime.datetime.fromtimestamp(milliseconds // 1000, datetime.UTC)
    time = f"{when:%H%M%S}.{milliseconds % 1000:03d}"
    void = gnss.fix == 0 or math.isnan(gnss.lat) or math.isnan(gnss.lon)
    place = ",,," if void else f"{_degrees(gnss.lat, 2, 'NS')},{_degrees(gnss.lon, 3, 'EW')}"
    speed = math.hypot(gnss.vel_n, gnss.vel_e)
    course = math.degrees(math.atan2(gnss.vel_e, gnss.vel_n)) % 360.0
    knots, kmh, cog = _text(speed / KNOT, 4), _text(speed * 3.6, 4), _text(course, 4)
    sigma = _text(gnss.sigma_h, 4)
    quality = 0 if void else _FIX_TO_QUALITY[gnss.fix]
    mode = "N" if void else {1: "A", 2: "D", 4: "R", 5: "F", 6: "E"}[quality]
    n_sat = "" if gnss.n_sat < 0 else f"{gnss.n_sat:02d}"
    return b"".join(
        sentence(body)
        for body in (
            f"GNGGA,{time},{place},{quality},{n_sat},{_text(gnss.hdop, 2)},{_text(gnss.alt, 3)},M,,M,,",
            f"GNRMC,{time},{'V' if void else 'A'},{place},{knots},{cog},{when:%d%m%y},,,{mode}",
            f"GNVTG,{cog},T,,M,{knots},N,{kmh},K,{mode}",
            f"GNGST,{time},,,,,{sigma},{sigma},",
        )
    )


def _degrees(angle: float, digits: int, signs: str) -> str:
    """`ddmm.mmmmmmm,N`: whole degrees, minutes, hemisphere."""
    degrees, units = divmod(round(abs(angle) * 60e7), 600_000_000)
    return f"{degrees:0{digits}d}{units // 10_000_000:02d}.{units % 10_000_000:07d},{signs[angle < 0.0]}"


def _text(value: float, digits: int) -> str:
    return "" if math.isnan(value) else f"{value:.{digits}f}"
