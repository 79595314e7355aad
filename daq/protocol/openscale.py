"""SparkFun OpenScale: lines such as `21024,4.11,kg,8421504,25.06,0,`.

Source: the firmware (sparkfun/OpenScale, firmware/OpenScale/OpenScale.ino). The fields are: time since start [ms],
reading, unit, raw reading, temperature of the board, temperature of a remote sensor. All fields except reading and unit
can be switched off. Version 1.0 has the temperatures before the reading.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from seatrial.daq.protocol.text_lines import FlagDetector, LineDecoder
from seatrial.daq.samples import NAN, Frame, LoadCell

NEWTON = {b"kg": 9.80665, b"lbs": 4.4482216152605}  # N per unit: standard gravity (CGPM 1901); pound-force
MILLIS = 2**32  # ms; the counter of milliseconds wraps at this value
_INTEGER = re.compile(rb"-?\d{1,10}\Z")
_NUMBER = re.compile(rb"-?\d{1,12}(\.\d{0,9})?\Z")


class Decoder(LineDecoder):
    """Decoder of the text lines of a SparkFun OpenScale board to `LoadCell` samples.

    If the lines contain the raw reading of the HX711 converter, it becomes `counts` and is checked for saturation and
    spikes. Otherwise, or if it is 0, `counts` is the scaled reading, which gets no flag. `t_device` is the time [s]
    since the start of the board, NaN if the lines do not contain it. A line that is not a reading counts as unparsed
    bytes.

    Parameters
    ----------
    saturation
        Largest raw reading of the converter [counts]; None if it is unknown, and saturation is then not detected.
    force
        Function that converts counts to N. If it is None, the force is the scaled reading, with kg and lbs converted to
        N.
    skip_first
        Whether to discard the first line after `reset`, which may be incomplete.
    """

    def __init__(
        self, saturation: float | None = None, force: Callable[[float], float] | None = None, skip_first: bool = False
    ) -> None:
        """Start without received lines.

        `saturation` is the largest raw reading [counts], `force` the calibration from counts to N, and `skip_first`
        whether to discard the first line after a reset.
        """
        super().__init__(skip_first)
        self._flags = FlagDetector(saturation)
        self._force = force
        self._last_ms = 0
        self._turns = 0

    def _decode_line(self, line: bytes, t_rx: float) -> Frame | None:
        """Convert one text line of the OpenScale board to a sample with counts, force [N] and flags (saturated, spike).

        Return None if the line has no unit kg or lbs after the reading, has more than six words, or has a word that is
        not a number. `t_rx` is the run time of receipt [s].
        """
        words = line.rstrip(b"\r").rstrip(b",").split(b",")
        unit = next((k for k, word in enumerate(words) if word in NEWTON), 0)
        if unit == 0 or len(words) > 6 or not all(_NUMBER.match(w) for k, w in enumerate(words) if k != unit):
            return None
        reading = float(words[unit - 1])
        raw = words[unit + 1] if unit + 1 < len(words) and _INTEGER.match(words[unit + 1]) else b"0"
        # An absent remote sensor sends "0". With the raw reading switched off, this "0" may follow the unit.
        counts, is_raw = (float(raw), True) if raw != b"0" else (reading, False)
        force = self._force(counts) if self._force is not None else reading * NEWTON[words[unit]]
        return Frame(
            LoadCell(counts, force, self._flags.flag(counts) if is_raw else 0), t_rx, self._device_time(words, unit)
        )

    def _device_time(self, words: list[bytes], unit: int) -> float:
        """Return the time since the start of the OpenScale board [s]; NaN if the line does not contain it.

        The time is the first of the `words` of a line, if it is a whole number, not 0, and not the reading. `unit` is
        the index of the unit; the reading is before it. The board's counter of milliseconds wraps after 49.7 days: a
        number that falls by more than half of this counts as a wrap, which is added.
        """
        if unit < 2 or not _INTEGER.match(words[0]) or words[0] == b"0":
            return NAN
        now = int(words[0])
        if now < self._last_ms - MILLIS // 2:
            self._turns += 1
        self._last_ms = now
        return 1e-3 * (now + self._turns * MILLIS)


def encode(reading: float, unit: str = "kg", milliseconds: int | None = None, raw: int | None = None) -> bytes:
    """Encode one reading of a load cell as a line of the OpenScale board, with CR LF.

    Parameters
    ----------
    reading
        Scaled reading, in `unit`.
    unit
        "kg" or "lbs".
    milliseconds
        Time since the start of the board [ms], sent modulo 2^32; None to leave it out.
    raw
        Raw reading of the converter [counts]; None to leave it out.
    """
    words = [f"{reading:.4f}", unit]
    if milliseconds is not None:
        words.insert(0, f"{milliseconds % MILLIS}")
    if raw is not None:
        words.append(f"{raw}")
    return ",".join([*words, "\r\n"]).encode("ascii")
