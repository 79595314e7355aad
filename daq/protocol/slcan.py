"""slcan: CAN frames as lines of text on a serial port (Lawicel CAN232, canable, usb-can adapters).

The slcan decoder of python-can is not used for three reasons: it reads byte by byte, it fails after one byte that is
not ASCII until its buffer is discarded, and it accepts a line that lost a character as a frame. This decoder rejects a
line whose length disagrees with its length digit, and it counts every byte outside valid frames.
"""

from __future__ import annotations

import re

from seatrial.daq.protocol.canframe import CAN_FRAME, EXTENDED
from seatrial.daq.protocol.framing import StreamDecoder

BITRATES = {
    10_000: "S0", 20_000: "S1", 50_000: "S2", 100_000: "S3", 125_000: "S4",
    250_000: "S5", 500_000: "S6", 750_000: "S7", 1_000_000: "S8",
}  # fmt: skip
_LINE_MAX = 1 + 8 + 1 + 16 + 4  # T, identifier, length, data, time stamp
_NOT_HEX = re.compile(rb"[^0-9A-Fa-f]")


class Decoder(StreamDecoder[bytes]):
    """Decoder of slcan text lines to CAN frames, each as the 16 bytes of the `struct can_frame` of Linux.

    Data frames with identifiers of 29 bits (`T`) and 11 bits (`t`) are decoded. Acknowledgements of the adapter and
    line ends are ignored. All other lines, such as remote frames, count as unparsed bytes. A time stamp after the data
    is ignored, because it wraps each minute.
    """

    sync = re.compile(rb"[Tt]")
    between = b"\r\n\azZ"  # line ends, and the acknowledgements of the adapter

    def _decode_frame(self, buffer: bytearray, start: int, t_rx: float) -> int:
        """Decode the slcan line that begins at index `start` of the buffer, and append its CAN frame to `self._out`.

        The frame is appended as the 16 bytes of the `struct can_frame` of Linux. Return the length of the line in
        bytes, 0 if more bytes are needed, or -1 if no valid line begins there. A line is invalid if its length
        disagrees with its length digit, or if its identifier is too large. `t_rx` is not used.
        """
        digits = 8 if buffer[start] == ord("T") else 3
        stop = _NOT_HEX.search(buffer, start + 1, start + _LINE_MAX + 1)
        if stop is None:
            return 0 if len(buffer) < start + _LINE_MAX + 1 else -1
        end = stop.start()
        if buffer[end] not in b"\r\n" or end < start + 2 + digits:
            return -1
        data_at = start + 2 + digits
        length = int(buffer[data_at - 1 : data_at], 16)
        if length > 8 or end - data_at not in (2 * length, 2 * length + 4):
            return -1
        identifier = int(buffer[start + 1 : data_at - 1], 16)
        if identifier >= 1 << (29 if digits == 8 else 11):
            return -1
        data = bytes.fromhex(buffer[data_at : data_at + 2 * length].decode("ascii"))
        self.frames += 1
        self._out.append(CAN_FRAME.pack(identifier | EXTENDED if digits == 8 else identifier, length, data))
        return end + 1 - start


def encode(arbitration_id: int, data: bytes) -> bytes:
    """Encode a CAN data frame with a 29-bit identifier as a line of slcan text with CR.

    `data` has at most 8 bytes. This is not checked.
    """
    return b"T%08X%d%b\r" % (arbitration_id, len(data), data.hex().upper().encode("ascii"))


def open_channel(bitrate: int) -> bytes:
    """Return the slcan commands that close the channel of a CAN adapter and open it at `bitrate` [bit/s].

    Raises
    ------
    ValueError
        If slcan does not have this bit rate.
    """
    if bitrate not in BITRATES:
        raise ValueError(
            f"slcan has no bit rate {bitrate}; set bitrate in the rig to one of {', '.join(map(str, BITRATES))}"
        )
    return f"\rC\r{BITRATES[bitrate]}\rO\r".encode("ascii")


CLOSE_CHANNEL = b"C\r"
