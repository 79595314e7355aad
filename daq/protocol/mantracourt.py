"""Mantracourt DSCUSB and DCell strain-gauge converters with the ASCII protocol. They answer each request with a number.

Source: DSCUSB Advanced User's Manual, "ASCII protocol". The host sends `!001:SYS?` and CR. The converter answers with a
decimal number and CR. If it refuses the request, it answers with `?` and CR. The protocol has no checksum.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from seatrial.daq.protocol.text_lines import FlagDetector, LineDecoder
from seatrial.daq.samples import NAN, Frame, LoadCell

DEFAULT_QUERY = "!001:SYS?"
_NUMBER = re.compile(rb"[+-]?\d{1,12}(\.\d{0,9})?\Z")


class Decoder(LineDecoder):
    """Decoder of the answers of a Mantracourt strain-gauge converter to `LoadCell` samples.

    `counts` is the answer in the unit of the converter. The driver of the device sends `request` for each reading at
    the rate of the rig file. An answer that is not a number, such as a refusal or an echo of the request, counts as
    unparsed. A refusal also sets `remark`, which the next number clears.

    Parameters
    ----------
    saturation
        Largest reading of the converter [counts]; None if it is unknown, and saturation is then not detected.
    force
        Function that converts counts to N; None if there is no calibration, and the force is then NaN. The unit of the
        answer to SYS is a setting of the converter.
    query
        Text of the request without CR.

    Attributes
    ----------
    request : bytes
        Request with CR.
    """

    end = b"\r"

    def __init__(
        self,
        saturation: float | None = None,
        force: Callable[[float], float] | None = None,
        query: str = DEFAULT_QUERY,
    ) -> None:
        """Start without received answers.

        `saturation` is the largest reading [counts], `force` the calibration from counts to N, and `query` the text of
        the request without CR.
        """
        super().__init__()
        self.request = query.encode("ascii") + b"\r"
        self._flags = FlagDetector(saturation)
        self._force = force

    def _decode_line(self, line: bytes, t_rx: float) -> Frame | None:
        """Convert one answer of the converter to a sample with counts, force [N] and flags (saturated, spike).

        Return None if the answer is not a number, such as an echo of the request, or the refusal `?`, which also sets
        `remark`. The next number clears `remark`. Without a calibration the force is NaN. `t_rx` is the run time of
        receipt [s].
        """
        line = line.lstrip(b"\n")
        if line == b"?":
            self.remark = (
                f"the load cell refuses the request {self.request[:-1].decode('ascii')}: correct `query` in the rig"
            )
        if not _NUMBER.match(line):
            return None
        self.remark = ""
        counts = float(line)
        force = NAN if self._force is None else self._force(counts)
        return Frame(LoadCell(counts, force, self._flags.flag(counts)), t_rx, NAN)


def encode(counts: float) -> bytes:
    """Encode a reading as the converter sends it: sign, at least seven digits, point, four decimals and CR."""
    return b"%+013.4f\r" % counts
