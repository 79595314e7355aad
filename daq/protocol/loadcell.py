"""A load cell that sends one line of text per sample (an HX711 on a microcontroller and the like).

A line matches the pattern in the rig; its named group `counts` is the number. There is no checksum: a line that does
not match is the only sign of a transmission error.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from daq.protocol.text_lines import LINE_MAX, SATURATED, SPIKE, Flags, LineDecoder, is_spike
from daq.samples import NAN, Frame, LoadCell

__all__ = ["DEFAULT_PATTERN", "LINE_MAX", "SATURATED", "SPIKE", "Decoder", "encode", "is_spike"]

DEFAULT_PATTERN = r"^(?P<counts>-?\d+)$"


class Decoder(LineDecoder):
    """Lines -> `LoadCell`. Flagged readings are passed on: what to leave out is the reader's decision.

    `pattern` is a regular expression with a named group `counts` (ValueError if it has none), `saturation` the
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
        self._pattern = re.compile(pattern)
        if "counts" not in self._pattern.groupindex:
            raise ValueError(f"the pattern {pattern!r} has no group (?P<counts>...)")
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
