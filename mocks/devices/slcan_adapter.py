"""Emulator of a CAN-to-serial adapter with the LAWICEL protocol (slcan).

It turns bytes of the host into answers and CAN frames, and uses no ports. Source: LAWICEL CANUSB manual, ASCII
command set.
"""

from __future__ import annotations

from typing import NamedTuple

OK, ERROR = b"\r", b"\a"
LINE_MAX = 64  # bytes; a longer line is discarded
_CLOSED_ONLY = b"sSUWMm"  # set-up commands, which the adapter refuses while the channel is open


class CanFrame(NamedTuple):
    """CAN data frame.

    Attributes
    ----------
    arbitration_id : int
        Identifier with 29 bits, or 11 bits if not ``extended``.
    data : bytes
        Up to 8 bytes.
    extended : bool
        Whether the identifier has 29 bits.
    """

    arbitration_id: int
    data: bytes
    extended: bool = True


class Adapter:
    """Emulated CAN-to-serial adapter. It passes frames between host and bus while its channel is open.

    Attributes
    ----------
    open : bool
        Whether the channel is open.
    listen_only : bool
        Whether the channel was opened by the command `L`, in which case the host cannot send frames.
    """

    def __init__(self, version: str = "1013", serial_number: str = "A001") -> None:
        """Set up an adapter with a closed channel.

        ``version`` is its answer to the commands `V` and `v`, and ``serial_number`` that to the command `N`.
        """
        self.open = False
        self.listen_only = False
        self._version = version
        self._serial_number = serial_number
        self._line = bytearray()

    def feed(self, data: bytes) -> tuple[bytes, list[CanFrame]]:
        """Process bytes of the host. If they end within a command line, its beginning is kept for the next call.

        A line of more than 64 bytes is discarded; its further bytes count as a new line.

        Returns
        -------
        bytes
            Answers of the adapter: one for each complete line, and the character BELL for a line that is too long.
        list of CanFrame
            Frames that the adapter sends on the bus.
        """
        answers = bytearray()
        frames: list[CanFrame] = []
        for byte in data:
            if byte != 0x0D:
                self._line.append(byte)
                if len(self._line) > LINE_MAX:
                    self._line.clear()
                    answers += ERROR
                continue
            line, self._line = bytes(self._line), bytearray()
            frame = self._parse_frame(line) if line[:1] in (b"t", b"T") else None
            if frame is not None:
                frames.append(frame)
                answers += b"Z\r" if frame.extended else b"z\r"
            else:
                answers += self._execute_line(line)
        return bytes(answers), frames

    def encode(self, frame: CanFrame) -> bytes:
        """Return the bytes that the adapter sends to the host for a CAN frame; empty while the channel is closed."""
        if not self.open:
            return b""
        digits = f"T{frame.arbitration_id:08X}" if frame.extended else f"t{frame.arbitration_id:03X}"
        return f"{digits}{len(frame.data)}{frame.data.hex().upper()}\r".encode()

    def _parse_frame(self, line: bytes) -> CanFrame | None:
        """Return the CAN frame that the host sends by the command line `t` (11-bit identifier) or `T` (29 bits).

        Return None if the line is malformed, or if the channel is closed or listens only.
        """
        if not self.open or self.listen_only:
            return None
        extended = line[:1] == b"T"
        width = 8 if extended else 3
        try:
            arbitration_id, length = int(line[1 : 1 + width], 16), int(line[1 + width : 2 + width])
            data = bytes.fromhex(line[2 + width :].decode("ascii"))
        except ValueError:
            return None
        if length > 8 or len(data) != length or arbitration_id >> (29 if extended else 11):
            return None
        return CanFrame(arbitration_id, data, extended)

    def _execute_line(self, line: bytes) -> bytes:
        """Execute a command line of the host that sends no CAN frame, and return the adapter's answer.

        The commands `O` and `L` open the channel, and `C` closes it. `V`, `v` and `N` give version and serial number,
        `F` the status (no fault). A remote frame (`r`, `R`) is confirmed and not sent. Set-up commands such as `S6` are
        accepted while the channel is closed, and have no effect. The answer to an unknown command, or to one that is
        not possible in this state, is the character BELL.
        """
        command = line[:1]
        if command in (b"", b"X") or (command == b"Z" and line == b"Z0"):
            return OK  # a single CR clears the line; auto-poll is always on, time stamps are always off
        if command == b"V":
            return f"V{self._version}\r".encode()
        if command == b"v":
            return f"v{self._version}\r".encode()
        if command == b"N":
            return f"N{self._serial_number}\r".encode()
        if command == b"F":
            return b"F00\r" if self.open else ERROR
        if command in (b"O", b"L"):
            was_open, self.open = self.open, True
            self.listen_only = self.listen_only if was_open else command == b"L"
            return ERROR if was_open else OK
        if command == b"C":
            was_open, self.open = self.open, False
            return OK if was_open else ERROR
        if command in (b"r", b"R"):
            return (b"Z\r" if command == b"R" else b"z\r") if self.open and not self.listen_only else ERROR
        return OK if command in _CLOSED_ONLY and not self.open else ERROR
