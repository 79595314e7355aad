"""Lines of text without a checksum, as load cells send them: line framing, and flags for saturation and spikes."""

from __future__ import annotations

from abc import ABC, abstractmethod

from seatrial.daq.samples import NAN, Frame

SATURATED, SPIKE = 1, 2
LINE_MAX = 256  # bytes; longer lines are discarded
_SPIKE_BITS = 12  # below 2^12 - 1, numbers 2^n - 1 are ordinary readings and not spikes


class LineDecoder(ABC):
    """Base class of the decoders of lines of text. A subclass converts one line to a sample in `_decode_line`.

    Lines of 256 bytes (LINE_MAX) or more are discarded and count as unparsed.

    Parameters
    ----------
    skip_first
        Whether the first line after `reset` is discarded. A port is reset when it is opened. Its first line may then be
        incomplete, and a part of a number is a wrong reading without any sign of an error.

    Attributes
    ----------
    end : bytes
        Line end, LF unless a subclass defines another one.
    frames : int
        Number of lines that contained a reading.
    checksum_errors : int
        Always 0, because the lines have no checksum.
    unparsed_bytes : int
        Number of bytes of lines without a reading, not counting line ends.
    remark : str
        Advice about the stream for the user, in one line; empty if there is none.
    """

    end = b"\n"

    def __init__(self, skip_first: bool = False) -> None:
        """Set all counters to 0. `skip_first` is whether to discard the first line after `reset`."""
        self.frames = 0
        self.checksum_errors = 0
        self.unparsed_bytes = 0
        self.remark = ""
        self._skip_first, self._skipping = skip_first, False
        self._buffer = bytearray()

    def feed(self, data: bytes, t_rx: float) -> list[Frame]:
        """Decode the bytes of one read that returned at run time `t_rx` [s]. Return the samples that they complete.

        A line that is no reading counts as unparsed bytes. A line without its end is kept for the next call. A line of
        256 bytes (LINE_MAX) or more is discarded.
        """
        self._buffer += data
        *lines, rest = self._buffer.split(self.end)
        out = []
        for line in lines:
            skip, self._skipping = self._skipping or len(line) >= LINE_MAX, False
            frame = None if skip else self._decode_line(bytes(line), t_rx)
            if frame is None:
                self._count_unparsed(line)
            else:
                self.frames += 1
                out.append(frame)
        # A line without an end must not fill the memory. The place of the cut does not depend on the reads.
        cut = len(rest) - len(rest) % LINE_MAX
        self._count_unparsed(rest[:cut])
        self._skipping = self._skipping or cut > 0
        self._buffer = rest[cut:]
        return out

    def reset(self) -> None:
        """Discard an incomplete line of text, because the port was reopened. Its bytes count as unparsed.

        The counters are kept. If `skip_first` was set, the next line is discarded too.
        """
        self._count_unparsed(self._buffer)
        self._buffer.clear()
        self._skipping = self._skip_first

    def _count_unparsed(self, data: bytes | bytearray) -> None:
        """Count the bytes of a line that is not a reading as unparsed. CR and LF are not counted."""
        self.unparsed_bytes += len(data.translate(None, b"\r\n"))

    @abstractmethod
    def _decode_line(self, line: bytes, t_rx: float) -> Frame | None:
        """Convert one line, without its line end, to a sample. Return None if the line is not a reading.

        `t_rx` is the run time of receipt [s].
        """


class FlagDetector:
    """Detector of saturated readings of a load cell, and of spikes: false numbers of a disturbed HX711 converter.

    Parameters
    ----------
    saturation
        Largest reading of the converter [counts]; None if it is unknown. Saturation is then not detected.
    """

    def __init__(self, saturation: float | None) -> None:
        """Start without a reading. `saturation` is the largest reading [counts]; None if it is unknown."""
        self._saturation = saturation
        self._last = NAN  # last reading [counts] without a flag

    def flag(self, counts: float) -> int:
        """Return the flag of the next reading [counts] of a load cell: SATURATED (1), SPIKE (2) or 0.

        A reading is saturated if it is at least the largest reading `s` of the converter, or at most -s - 1. Spikes are
        detected by `is_spike`, from the reading and the last reading without a flag. A reading with a flag is not
        stored as the last one.
        """
        if self._saturation is not None and (counts >= self._saturation or counts <= -self._saturation - 1.0):
            return SATURATED
        if is_spike(counts, self._last):
            return SPIKE
        self._last = counts
        return 0


def is_spike(counts: float, last: float) -> bool:
    """Return whether a reading of a load cell is a spike: a false number of a disturbed HX711 converter.

    A disturbed clock makes the HX711 return 2^n - 1 or its negative, because bits of one are shifted in. Such a number
    is not a spike if its magnitude is less than 4095 or above 2^32, or if it differs from the previous reading by at
    most 1/16 of its magnitude.

    Parameters
    ----------
    counts
        Raw reading [counts].
    last
        Previous reading without a flag [counts]; NaN if there is none. A number 2^n - 1 is then a spike.
    """
    size = abs(counts)
    if not size.is_integer() or size < 2**_SPIKE_BITS - 1 or size > 2**32:
        return False
    whole = int(size)
    return whole & (whole + 1) == 0 and not abs(counts - last) <= size / 16.0
