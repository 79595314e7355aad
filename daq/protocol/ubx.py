"""u-blox receivers: UBX messages, and the NMEA sentences that share the port with them.

Source: u-blox 8 / M8 Receiver Description (UBX-13003221) and, for what older receivers send, that of u-blox 6
(GPS.G6-SW-10018): "UBX Protocol", class NAV. The messages we read are of fixed layout, so a `struct` a message reads
them: a general parser costs twenty times as much and raises errors of many kinds.
"""

from __future__ import annotations

import itertools
import math
import re
import struct
import time

from daq.protocol import nmea
from daq.protocol.ubx_epoch import LENGTHS, Epochs
from daq.samples import Frame, Gnss

SYNC = b"\xb5\x62"
HEAD = 6  # sync, class, id, length
LENGTH_MAX = 8192  # bytes of a payload; a longer one is a header that was damaged
NAV_PVT = (0x01, 0x07)


def checksum(body: bytes) -> bytes:
    """The two bytes of Fletcher's checksum (RFC 1145) over class, id, length and payload."""
    return bytes((sum(body) & 0xFF, sum(itertools.accumulate(body)) & 0xFF))


def message(kind: tuple[int, int], payload: bytes) -> bytes:
    """A UBX message on the wire."""
    body = struct.pack("<BBH", *kind, len(payload)) + payload
    return SYNC + body + checksum(body)


class Decoder(nmea.Decoder):
    """UBX and NMEA -> `Gnss` and `Ahrs`.

    Where the receiver sends its solution in UBX, that is what is taken, and the positions that the same stream has in
    NMEA as well give no samples of their own; headings (HDT and the like) do all the same.
    """

    sync = re.compile(rb"[$\xb5]")

    def __init__(self, declination: float | None = None) -> None:
        super().__init__(declination)
        self._epochs = Epochs()

    def flush(self) -> list[Frame]:
        """End of the stream: the sample of the epoch that has not been emitted, if there is one."""
        return self._epochs.flush() or self._kept(super().flush())

    def reset(self) -> None:
        """Forget a half-read message and epoch (the port was reopened). Counters stay."""
        super().reset()
        self._epochs.forget()

    def _take(self, buffer: bytearray, start: int, t_rx: float) -> int:
        if buffer[start] == SYNC[0]:
            return self._take_ubx(buffer, start, t_rx)
        return super()._take(buffer, start, t_rx)

    def _take_ubx(self, buffer: bytearray, start: int, t_rx: float) -> int:
        if len(buffer) < start + HEAD:
            return 0 if SYNC.startswith(buffer[start : start + 2]) else -1
        if buffer[start + 1] != SYNC[1]:
            return -1
        n_payload = buffer[start + 4] | buffer[start + 5] << 8
        kind = (buffer[start + 2], buffer[start + 3])
        known = LENGTHS.get(kind)
        if n_payload > LENGTH_MAX or (known is not None and n_payload not in known):
            return -1
        length = HEAD + n_payload + 2
        if len(buffer) < start + length:
            return 0
        body = bytes(buffer[start + 2 : start + length - 2])
        if buffer[start + length - 2 : start + length] != checksum(body):
            self.checksum_errors += 1
            return -1
        self.frames += 1
        if known is not None:
            self._out += self._epochs.take(kind, body[4:], t_rx)
        return length

    def _kept(self, found: list[Frame]) -> list[Frame]:
        return [f for f in found if not (self._epochs.heard and isinstance(f.sample, Gnss))]


def encode(gnss: Gnss) -> bytes:
    """NAV-PVT of a fix, rounded as the receiver rounds it; NaN is sent as zero, `n_sat` below 0 as 0."""
    whole = math.floor(gnss.utc)
    nano = round((gnss.utc - whole) * 1e9)
    year, month, day, hour, minute, second = time.gmtime(whole)[:6]
    i_tow = round((gnss.utc + 18 - 315964800) * 1000) % 604_800_000  # GPS time is 18 s ahead of UTC since 2017
    fix = {0: 0, 1: 1, 2: 2}.get(gnss.fix, 3)
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
    return 0.0 if math.isnan(value) else value
