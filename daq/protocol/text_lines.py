"""Lines of text without a checksum, shared by load cells: line framing, and flags of saturation and spikes."""

from __future__ import annotations

from abc import ABC, abstractmethod

from seatrial.daq.samples import NAN, Frame

SATURATED, SPIKE = 1, 2
LINE_MAX = 256
_SPIKE_BITS = 12  # below 2^12 - 1 such a number is nothing special


class LineDecoder(ABC):
    """Lines -> samples, by what a subclass makes of one.

    With `skip_first` the first line after `reset`, which is what a port that was opened begins with, is dropped: it
    may have been read from its middle, and half a number is a number too.
    """

    end = b"\n"

    def __init__(self, skip_first: bool = False) -> None:
        self.frames = 0
        self.checksum_errors = 0
        self.unparsed_bytes = 0
        self.remark = ""
        self._skip_first, self._skipping = skip_first, False
        self._buffer = bytearray()

    def feed(self, data: bytes, t_rx: float) -> list[Frame]:
        """Take the bytes of one read that returned at run time `t_rx`; returns the samples they complete."""
        self._buffer += data
        *lines, rest = self._buffer.split(self.end)
        out = []
        for line in lines:
            skip, self._skipping = self._skipping or len(line) >= LINE_MAX, False
            frame = None if skip else self._take(bytes(line), t_rx)
            if frame is None:
                self._lose(line)
            else:
                self.frames += 1
                out.append(frame)
        # A line without an end must not fill the memory. It is cut at a place that does not depend on the reads.
        cut = len(rest) - len(rest) % LINE_MAX
        self._lose(rest[:cut])
        self._skipping = self._skipping or cut > 0
        self._buffer = rest[cut:]
        return out

    def reset(self) -> None:
        """Discard an incomplete line (the port was reopened). Counters stay."""
        self._lose(self._buffer)
        self._buffer.clear()
        self._skipping = self._skip_first

    def _lose(self, data: bytes | bytearray) -> None:
        self.unparsed_bytes += len(data.translate(None, b"\r\n"))

    @abstractmethod
    def _take(self, line: bytes, t_rx: float) -> Frame | None:
        """The sample of one line without its end; None if it is none."""


class Flags:
    """The flags of a reading: at the converter's limit `saturation`, or a spike of ones."""

    def __init__(self, saturation: float | None) -> None:
        self._saturation = saturation
        self._last = NAN  # last reading without a flag

    def of(self, counts: float) -> int:
        """The flags of the next reading."""
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
