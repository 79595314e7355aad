"""CAN ports: slcan adapters on a serial port, and SocketCAN by python-can."""

from __future__ import annotations

import contextlib
from typing import Any

from seatrial.daq.protocol import CAN_FRAME, EXTENDED, slcan
from seatrial.daq.transport.base import WRITE_S, Port, PortError, os_error_text
from seatrial.daq.transport.serial_port import SerialPort

CR, BELL = b"\r"[0], b"\a"[0]  # answers of an adapter: accepted, refused
MOST = 256  # frames of one read, at most; many received frames must not delay the set-points of the same thread
REFUSED = 10  # refused frames in a row, after which the adapter is off the bus or its channel is closed


class _OpeningAnswers:
    """Evaluation of the answers of an adapter to the commands that open its channel.

    The commands are an empty line, C (close), the bit rate and O (open). An answer is CR (accepted) or BELL (refused).
    Some adapters do not answer the empty line, and C is refused if the channel is closed, so only the last two answers
    count. An adapter without any answer is assumed to have accepted the commands.
    """

    def __init__(self) -> None:
        """Start without an answer of the adapter."""
        self._answers: list[bool] = []  # whether each answer was a refusal
        self._in_line = False  # whether the present line is a frame or an answer to a frame

    def feed(self, data: bytes) -> bool | None:
        """Process bytes that the adapter has sent after the commands that open its channel.

        Return True if it refused the bit rate or the opening, False if it accepted both, and None as long as this is
        unknown.
        """
        for byte in data:
            if byte not in (CR, BELL):
                self._in_line = True
                continue
            if not self._in_line:
                self._answers.append(byte == BELL)
            certain = len(self._answers) == 4 or (self._in_line and len(self._answers) == 3)
            self._in_line = False
            if certain:
                return any(self._answers[-2:])
        # The third of three answers is either that to the bit rate or that to O. A refusal of it is certain in both
        # cases; the empty line and C, which may be refused, are the first two commands.
        return True if len(self._answers) == 3 and self._answers[2] else None


class _FrameAnswers:
    """Counter of consecutive frames that an slcan adapter refuses to send.

    Attributes
    ----------
    refused : int
        Number of refused frames since the last accepted one.

    Notes
    -----
    An adapter answers an accepted frame with `z`, `Z` or an empty line, and a refused frame with BELL. For adapters
    that do not answer, the count stays zero.
    """

    def __init__(self) -> None:
        """Start with no refused frame."""
        self.refused = 0  # consecutive refused frames
        self._in_line = True  # whether the present line is a received frame; at first this is unknown

    def feed(self, data: bytes) -> None:
        """Update `refused`, the number of refused frames in a row, from bytes (answers, frames) of the adapter.

        Each BELL adds 1. An answer `z` or `Z`, or an empty line, sets the number to 0. Lines with received frames do
        not change it. A line may continue in the next call.
        """
        if not self.refused and BELL not in data:
            self._in_line = data[-1:] not in (b"\r", b"\a") if data else self._in_line
            return
        for byte in data:
            if byte == BELL:
                self.refused, self._in_line = self.refused + 1, False
            elif byte == CR:
                self.refused, self._in_line = self.refused if self._in_line else 0, False
            elif byte in b"zZ":
                self.refused = 0
            else:
                self._in_line = True


class SlcanPort(Port):
    """CAN port of an slcan adapter on a serial port.

    Parameters
    ----------
    path
        Path of the serial port.
    baud
        Baud rate of the serial port [bit/s].
    bitrate
        Bit rate of the CAN bus [bit/s].
    """

    def __init__(self, path: str, baud: int, bitrate: int) -> None:
        """Store the settings of the serial port and the bit rate of the bus [bit/s]. The port is not opened."""
        super().__init__()
        self._serial = SerialPort(path, baud)
        self._bitrate = bitrate
        self._decoder = slcan.Decoder()
        self._opening: _OpeningAnswers | None = None
        self._answers: _FrameAnswers | None = None  # None before the first frame is sent

    def open(self) -> None:
        """Open the serial port of the CAN adapter, then its channel.

        PortError is raised if the serial port cannot be opened or does not accept the commands, or if slcan has no
        command for this bit rate. A refusal by the adapter is noticed later, by `read`.
        """
        try:
            commands = slcan.open_channel(self._bitrate)
        except ValueError as error:
            raise PortError(str(error)) from error
        self._serial.open()
        self.hint = self._serial.hint
        self._decoder.reset()
        self._opening, self._answers = _OpeningAnswers(), None
        self._serial.write(commands)

    def fileno(self) -> int:
        """Return the file descriptor of the serial port, for `select`; -1 if the port is closed."""
        return self._serial.fileno()

    def read(self) -> bytes:
        """Return the complete CAN frames that have arrived, 16 bytes each (`struct can_frame`).

        If the adapter has refused the bit rate or the opening of its channel, `hint` is set. PortError is raised if the
        adapter refuses 10 sent frames in a row (REFUSED), or if it was unplugged.
        """
        data = self._serial.read()
        if self._opening is not None and (refused := self._opening.feed(data)) is not None:
            self._opening = None
            if refused:
                self.hint = (
                    f"the CAN adapter refused the bit rate {self._bitrate}, or to open its channel; check bitrate in "
                    "the rig"
                )
        if self._answers is not None:
            self._answers.feed(data)
            if self._answers.refused >= REFUSED:
                raise PortError(
                    f"the adapter refused {REFUSED} frames in a row (BELL): check the power and termination of the "
                    f"bus, its other nodes, and the bit rate {self._bitrate}"
                )
        frames = self._decoder.feed(data, 0.0)
        self.bytes_in, self.unparsed_bytes = self._serial.bytes_in, self._decoder.unparsed_bytes
        return b"".join(frames)

    def write(self, data: bytes) -> None:
        """Send CAN frames, 16 bytes each (`struct can_frame`). Every frame is sent with a 29-bit identifier.

        PortError is raised if the serial port accepts no more bytes or was disconnected. A refusal by the adapter is
        noticed later, by `read`.
        """
        self._answers = self._answers or _FrameAnswers()
        lines = (slcan.encode(word & ~EXTENDED, body[:length]) for word, length, body in CAN_FRAME.iter_unpack(data))
        self._serial.write(b"".join(lines))

    def close(self) -> None:
        """Close the channel of the CAN adapter, if the port is open, then the serial port. This raises no error."""
        if self._serial.fileno() >= 0:
            with contextlib.suppress(PortError):
                self._serial.write(slcan.CLOSE_CHANNEL)
        self._serial.close()


class SocketCanPort(Port):
    """CAN port of an interface of the kernel (`ip link set can0 up type can bitrate ...`).

    Parameters
    ----------
    channel
        Name of the interface, such as "can0".
    """

    def __init__(self, channel: str) -> None:
        """Store the name of the CAN interface, such as "can0". The port is not opened."""
        super().__init__()
        import can  # imported here because the import is slow and only this port needs it

        self._can: Any = can
        self._channel = channel
        self._bus: Any = None

    def open(self) -> None:
        """Open a raw socket on the CAN interface of the kernel. Raise PortError if this fails.

        A socket that is open is closed first. The interface must be up already; its bit rate is not set here.
        """
        self.close()
        try:
            self._bus = self._can.Bus(interface="socketcan", channel=self._channel)
        except (OSError, self._can.CanError) as error:
            raise PortError(os_error_text(error)) from error

    def fileno(self) -> int:
        """Return the file descriptor of the CAN socket, for `select`; -1 if the port is closed."""
        return -1 if self._bus is None else int(self._bus.fileno())

    def read(self) -> bytes:
        """Return the CAN data frames that have arrived, 16 bytes each (`struct can_frame`), at most 256 of them (MOST).

        Error frames, remote frames and frames of CAN FD are left out, but count for the 256. PortError is raised if the
        interface fails.
        """
        frames = []
        try:
            for _ in range(MOST):
                if (message := self._bus.recv(0.0)) is None:
                    break
                if not (message.is_error_frame or message.is_remote_frame or message.is_fd):
                    word = message.arbitration_id | (EXTENDED if message.is_extended_id else 0)
                    frames.append(CAN_FRAME.pack(word, message.dlc, bytes(message.data)))
        except (OSError, self._can.CanError) as error:
            raise PortError(os_error_text(error)) from error
        self.bytes_in += CAN_FRAME.size * len(frames)
        return b"".join(frames)

    def write(self, data: bytes) -> None:
        """Send CAN frames, 16 bytes each (`struct can_frame`). Every frame is sent with a 29-bit identifier.

        Raise PortError if this fails, or if the interface does not accept a frame within 50 ms (WRITE_S).
        """
        try:
            for word, length, body in CAN_FRAME.iter_unpack(data):
                message = self._can.Message(arbitration_id=word & ~EXTENDED, is_extended_id=True, data=body[:length])
                self._bus.send(message, timeout=WRITE_S)
        except (OSError, self._can.CanError) as error:
            raise PortError(os_error_text(error)) from error

    def close(self) -> None:
        """Close the CAN socket, if it is open. No error is raised."""
        if self._bus is not None:
            with contextlib.suppress(Exception):  # the interface of the socket may not exist any more
                self._bus.shutdown()
        self._bus = None
