"""Mantracourt DSCUSB and DCell strain-gauge converters with the ASCII protocol: a request, answered by a number.

Source: DSCUSB Advanced User's Manual, "ASCII protocol": the host sends `!001:SYS?` and CR; the answer is a decimal
number and CR, or `?` and CR where the request was refused. There is no checksum.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from seatrial.daq.protocol.text_lines import Flags, LineDecoder
from seatrial.daq.samples import NAN, Frame, LoadCell

DEFAULT_QUERY = "!001:SYS?"
_NUMBER = re.compile(rb"[+-]?\d{1,12}(\.\d{0,9})?\Z")


class Decoder(LineDecoder):
    """Answers -> `LoadCell`; `counts` is what the converter answers in its own unit, `force` turns that into N.

    `request` is what has to be sent for each reading; the device's loop does so at the rig's rate. Without a
    calibration there is no force: which unit SYS has was set in the converter. An echo of the request is passed over.
    """

    end = b"\r"

    def __init__(
        self,
        saturation: float | None = None,
        force: Callable[[float], float] | None = None,
        query: str = DEFAULT_QUERY,
    ) -> None:
        super().__init__()
        self.request = query.encode("ascii") + b"\r"
        self._flags = Flags(saturation)
        self._force = force

    def _take(self, line: bytes, t_rx: float) -> Frame | None:
        line = line.lstrip(b"\n")
        if line == b"?":
            self.remark = f"the converter refuses {self.request[:-1].decode('ascii')}: look at `query` in the rig"
        if not _NUMBER.match(line):
            return None
        self.remark = ""
        counts = float(line)
        force = NAN if self._force is None else self._force(counts)
        return Frame(LoadCell(counts, force, self._flags.of(counts)), t_rx, NAN)


def encode(counts: float) -> bytes:
    """An answer as the converter gives it."""
    return b"%+013.4f\r" % counts
