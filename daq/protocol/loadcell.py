"""A load cell that sends one line of text per sample (an HX711 on a microcontroller and the like).

A line matches the pattern in the rig; its named group `counts` is the number. There is no checksum: a line that does
not match is the only sign of a transmission error. Patterns are those of RE2, whose time grows with the line and not
with what a rig of somebody else's may ask of it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from seatrial.daq.protocol.text_lines import LINE_MAX, SATURATED, SPIKE, Flags, LineDecoder, is_spike
from seatrial.daq.samples import NAN, Frame, LoadCell

__all__ = ["DEFAULT_PATTERN", "LINE_MAX", "SATURATED", "SPIKE", "Decoder", "encode", "is_spike"]

DEFAULT_PATTERN = r"^(?P<counts>-?\d+)$"


def compile_pattern(pattern: str) -> Any:
    """The pattern of a reading, as RE2 compiles it. Raises ValueError for what is no regular expression of RE2 (which
    has no look-around and no back-references) and for one without a group ``counts``."""
    import re2  # only a load cell with lines of text needs it

    options = re2.Options()
    options.log_errors = False
    try:
        found = re2.compile(pattern, options)
    except re2.error as error:
        raise ValueError(f"not a regular expression (RE2): {error.args[0].decode(errors='replace')}") from error
    if "counts" not in found.groupindex:
        raise ValueError("must have a group (?P<counts>...) around the reading")
    return found


class Decoder(LineDecoder):
    """Lines -> `LoadCell`. Flagged readings are passed on: what to leave out is the reader's decision.

    `pattern` is a regular expression with a named group `counts` (`compile_pattern`), `saturation` the
    largest reading of the converter, `force` turns counts into N. `skip_first` is as in `LineDecoder`.
    """

    def __init__(
        self,
        pattern: str = DEFAULT_PATTERN,
        saturation: float | None = None,
        force: Callable[[float], float] | None = None,
        skip_first: bool = False,
    ) -> None:
        super().__init__(skip_first)
        self._pattern = compile_pattern(pattern)
        self._flags = Flags(saturation)
        self._force = force

    def _take(self, line: bytes, t_rx: float) -> Frame | None:
        found = self._pattern.search(line.rstrip(b"\r").decode("latin-1"))
        if found is None:
            return None
        try:
            counts = float(found["counts"])
        except (TypeError, ValueError):  # the group took no part in the match, or what it matched is no number
            return None
        force = NAN if self._force is None else self._force(counts)
        return Frame(LoadCell(counts, force, self._flags.of(counts)), t_rx, NAN)


def encode(counts: float) -> bytes:
    """One reading as the default pattern expects it."""
    return b"%d\r\n" % round(counts)
