"""SparkFun OpenScale: lines such as `21024,4.11,kg,8421504,25.06,0,`.

Source: the firmware (sparkfun/OpenScale, firmware/OpenScale/OpenScale.ino): time since its start [ms], reading, unit,
raw reading, temperature of the board and of a remote sensor; all but reading and unit can be switched off. Version
1.0 has the temperatures in front of the reading.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from seatrial.daq.protocol.text_lines import Flags, LineDecoder
from seatrial.daq.samples import NAN, Frame, LoadCell

NEWTON = {b"kg": 9.80665, b"lbs": 4.4482216152605}  # standard gravity (CGPM 1901); pound-force
MILLIS = 2**32  # the counter of milliseconds begins again
_INTEGER = re.compile(rb"-?\d{1,10}\Z")
_NUMBER = re.compile(rb"-?\d{1,12}(\.\d{0,9})?\Z")


class Decoder(LineDecoder):
    """Lines -> `LoadCell`.

    With the raw reading switched on that is `counts`, flagged as an HX711's, and `force` [N] follows from it by the
    rig's calibration. Without it `counts` is the scale's own reading; without a calibration the force is the scale's
    own, kg and lbs taken as forces. `t_device` is the scale's clock, in s since its start.
    """

    def __init__(
        self, saturation: float | None = None, force: Callable[[float], float] | None = None, skip_first: bool = False
    ) -> None:
        super().__init__(skip_first)
        self._flags = Flags(saturation)
        self._force = force
        self._last_ms = 0
        self._turns = 0

    def _take(self, line: bytes, t_rx: float) -> Frame | None:
        words = line.rstrip(b"\r").rstrip(b",").split(b",")
        unit = next((k for k, word in enumerate(words) if word in NEWTON), 0)
        if unit == 0 or len(words) > 6 or not all(_NUMBER.match(w) for k, w in enumerate(words) if k != unit):
            return None
        reading = float(words[unit - 1])
        raw = words[unit + 1] if unit + 1 < len(words) and _INTEGER.match(words[unit + 1]) else b"0"
        # An absent remote sensor is "0", and so could stand where the raw reading does when that is switched off.
        counts, is_raw = (float(raw), True) if raw != b"0" else (reading, False)
        force = self._force(counts) if self._force is not None else reading * NEWTON[words[unit]]
        return Frame(LoadCell(counts, force, self._flags.of(counts) if is_raw else 0), t_rx, self._clock(words, unit))

    def _clock(self, words: list[bytes], unit: int) -> float:
        """The time stamp [s]: a whole number before the reading. It wraps after 49.7 days."""
        if unit < 2 or not _INTEGER.match(words[0]) or words[0] == b"0":
            return NAN
        now = int(words[0])
        if now < self._last_ms - MILLIS // 2:
            self._turns += 1
        self._last_ms = now
        return 1e-3 * (now + self._turns * MILLIS)


def encode(reading: float, unit: str = "kg", milliseconds: int | None = None, raw: int | None = None) -> bytes:
    """One line; fields that are None are switched off."""
    words = [f"{reading:.4f}", unit]
    if milliseconds is not None:
        words.insert(0, f"{milliseconds % MILLIS}")
    if raw is not None:
        words.append(f"{raw}")
    return ",".join([*words, "\r\n"]).encode("ascii")
