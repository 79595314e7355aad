"""Load cell that sends one line of text per sample, for example an HX711 converter on a microcontroller.

A line has to match the regular expression in the rig file, whose named group `counts` is the reading. The protocol has
no checksum, so a line that does not match is the only sign of a transmission error. The library RE2 evaluates the
expression, because its run time is linear in the length of the line for every expression.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from seatrial.daq.protocol.text_lines import LINE_MAX, SATURATED, SPIKE, FlagDetector, LineDecoder, is_spike
from seatrial.daq.samples import NAN, Frame, LoadCell

__all__ = ["DEFAULT_PATTERN", "LINE_MAX", "SATURATED", "SPIKE", "Decoder", "encode", "is_spike"]

DEFAULT_PATTERN = r"^(?P<counts>-?\d+)$"


def compile_pattern(pattern: str) -> Any:
    """Return the regular expression of a load cell's lines of text, compiled by the library RE2.

    Raises
    ------
    ValueError
        If `pattern` is not a regular expression of RE2 (RE2 has no look-around and no back-references), or if it lacks
        the named group ``counts``, whose text is the reading.
    """
    import re2  # imported here because only a load cell with lines of text needs it

    options = re2.Options()
    options.log_errors = False
    try:
        compiled = re2.compile(pattern, options)
    except re2.error as error:
        raise ValueError(
            f"not a regular expression (RE2): {error.args[0].decode(errors='replace')}; correct it"
        ) from error
    if "counts" not in compiled.groupindex:
        raise ValueError("must have a group (?P<counts>...) around the number that the load cell sends")
    return compiled


class Decoder(LineDecoder):
    """Decoder of the text lines of a load cell to `LoadCell` samples.

    A saturated reading, or a spike (a false number that a disturbed HX711 converter returns), gets a flag and is kept;
    the user of the log may exclude it. A line that does not match the pattern counts as unparsed bytes. `t_device` is
    NaN.

    Parameters
    ----------
    pattern
        Regular expression with a named group `counts`, whose text is the reading (`compile_pattern`). It has to match a
        part of the line.
    saturation
        Largest reading of the converter [counts]; None if it is unknown, and saturation is then not detected.
    force
        Function that converts counts to N; None if there is no calibration, and the force is then NaN.
    skip_first
        Whether to discard the first line after `reset`, which may be incomplete.

    Raises
    ------
    ValueError
        If the pattern is invalid.
    """

    def __init__(
        self,
        pattern: str = DEFAULT_PATTERN,
        saturation: float | None = None,
        force: Callable[[float], float] | None = None,
        skip_first: bool = False,
    ) -> None:
        """Compile the pattern of the lines, and start without received lines. Raise ValueError for an invalid pattern.

        `saturation` is the largest reading [counts], `force` the calibration from counts to N, and `skip_first` whether
        to discard the first line after a reset.
        """
        super().__init__(skip_first)
        self._pattern = compile_pattern(pattern)
        self._flags = FlagDetector(saturation)
        self._force = force

    def _decode_line(self, line: bytes, t_rx: float) -> Frame | None:
        """Convert one text line of a load cell to a sample with counts, force [N] and flags (saturated, spike).

        Return None if the pattern matches no part of the line, or if its group `counts` is not a number. A CR at the
        end of the line is removed before. Without a calibration the force is NaN. `t_rx` is the run time of receipt
        [s].
        """
        match = self._pattern.search(line.rstrip(b"\r").decode("latin-1"))
        if match is None:
            return None
        try:
            counts = float(match["counts"])
        except (TypeError, ValueError):  # the group is not part of the match, or its text is not a number
            return None
        force = NAN if self._force is None else self._force(counts)
        return Frame(LoadCell(counts, force, self._flags.flag(counts)), t_rx, NAN)


def encode(counts: float) -> bytes:
    """Encode a reading [counts], rounded to a whole number, as a line of text that the default pattern matches.

    Raise ValueError for NaN.
    """
    return b"%d\r\n" % round(counts)
