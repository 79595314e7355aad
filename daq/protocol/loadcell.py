"""A load cell that sends one text line a reading (an HX711 on a microcontroller, OpenScale and the like).

The pattern in the rig says what a line looks like; its named group `counts` is the number. There is no checksum,
so a line that does not match is all that can be told of a transmission error.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from daq.samples import NAN, Frame, LoadCell

SATURATED, SPIKE = 1, 2
LINE_MAX = 256
DEFAULT_PATTERN = r"^(?P<counts>-?\d+)$"
_SPIKE_BITS = 12  # below 2^12 - 1 such a number is nothing special


class Decoder:
    """Lines -> `LoadCell`. Flagged readings are passed on: what to leave out is the reader's decision.

    `pattern` is a regular expression with a named group `counts` (ValueError if it has none), `saturation` the
    largest reading of the converter, `force` turns counts into N. With `skip_first` the first line after the start
    and after `reset` is dropped: it may have been read from its middle, and half a number is a number too.
    """

    def __init__(
        self,
        pattern: str = DEFAULT_PATTERN,
        saturation: float | None = None,
        force: Callable[[float], float] | None = None,
        skip_first: bool = False,
    ) -> None:
        self.frames = 0
        self.checksum_errors = 0
        self.unparsed_bytes = 0
        self._pattern = re.compile(pattern)
        if "counts" not in self._pattern.groupindex:
            raise ValueError(f"the pattern {pattern!r} has no group (?P<counts>...)")
        self._saturation = saturation
        self._force = force
        self._skip_first = self._skipping = skip_first
        self._buffer = bytearray()
        self._last = NAN  # last reading without a flag

    def feed(self, data: bytes, t_rx: float) -> list[Frame]:
        """Take the bytes of one read that returned at run time `t_rx`; returns the samples they complete."""
        self._buffer += data
        *lines, rest = self._buffer.split(b"\n")
        out = []
        for line in lines:
            sample = self._sample(bytes(line))
            if sample is not None:
                out.append(Frame(sample, t_rx, NAN))
        # A line without an end must not fill the memory. It is cut at a place that does not depend on the reads.
        cut = len(rest) - len(rest) % LINE_MAX
        self._lose(rest[:cut])
        self._skipping = self._skipping or cut > 0
        self._buffer = rest[cut:]
        return out

    def reset(self) -> None:
        """Forget a half-read line (the port was reopened). Counters stay."""
        self._lose(self._buffer)
        self._buffer.clear()
        self._skipping = self._skip_first

    def _lose(self, data: bytes | bytearray) -> None:
        self.unparsed_bytes += len(data) - data.count(b"\r")

    def _sample(self, line: bytes) -> LoadCell | None:
        skip, self._skipping = self._skipping or len(line) >= LINE_MAX, False
        found = None if skip else self._pattern.search(line.rstrip(b"\r").decode("latin-1"))
        try:
            counts = NAN if found is None else float(found["counts"])
        except (TypeError, ValueError):  # the group took no part in the match, or what it matched is no number
            found = None
        if found is None:
            self._lose(line)
            return None
        self.frames += 1
        flags = self._flags(counts)
        return LoadCell(counts, NAN if self._force is None else self._force(counts), flags)

    def _flags(self, counts: float) -> int:
        if self._saturation is not None and (counts >= self._saturation or counts <= -self._saturation - 1.0):
            return SATURATED
        if is_spike(counts, self._last):
            return SPIKE
        self._last = counts
        return 0


def is_spike(counts: float, last: float) -> bool:
    """Whether a reading is the HX711's 2^n - 1 (or its negative): ones shifted in when the clock was disturbed.

    A reading that is merely near its predecessor `last` may well be such a number; `last` is NaN if there is none.
    """
    size = abs(counts)
    if not size.is_integer() or size < 2**_SPIKE_BITS - 1 or size > 2**32:
        return False
    whole = int(size)
    return whole & (whole + 1) == 0 and not abs(counts - last) <= size / 16.0


def encode(counts: float) -> bytes:
    """One reading as the default pattern expects it."""
    return b"%d\r\n" % round(counts)
