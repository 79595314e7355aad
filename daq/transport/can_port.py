"""CAN ports: slcan adapters on a serial port, and SocketCAN by python-can."""

from __future__ import annotations

import contextlib
from typing import Any

from daq.protocol import CAN_FRAME, EXTENDED, slcan
from daq.transport.base import WRITE_S, Port, PortError, os_error_text
from daq.transport.serial_port import SerialPort

MOST = 256  # frames a read: a flood must not keep the thread from its set-points


class SlcanPort(Port):
    """CAN through an slcan adapter."""

    def __init__(self, path: str, baud: int, bitrate: int) -> None:
        super().__init__()
        self._serial = SerialPort(path, baud)
        self._bitrate = bitrate
        self._decoder = slcan.Decoder()

    def open(self) -> None:
        """Open the adapter, then its channel."""
        try:
            commands = slcan.open_channel(self._bitrate)
        except ValueError as error:
            raise PortError(str(error)) from error
        self._serial.open()
        self.hint = self._serial.hint
        self._decoder.reset()
        self._serial.write(commands)

    def fileno(self) -> int:
        """The file descriptor to wait on."""
        return self._serial.fileno()

    def read(self) -> bytes:
        """The frames that are complete."""
        frames = self._decoder.feed(self._serial.read(), 0.0)
        self.bytes_in, self.unparsed_bytes = self._serial.bytes_in, self._decoder.unparsed_bytes
        return b"".join(frames)

    def write(self, data: bytes) -> None:
        """Send frames (29-bit identifiers)."""
        lines = (slcan.encode(word & ~EXTENDED, body[:length]) for word, length, body in CAN_FRAME.iter_unpack(data))
        self._serial.write(b"".join(lines))

    def close(self) -> None:
        """Close the channel, then the adapter."""
        if self._serial.fileno() >= 0:
            with contextlib.suppress(PortError):
                self._serial.write(slcan.CLOSE_CHANNEL)
        self._serial.close()


class SocketCanPort(Port):
    """CAN through the kernel (`ip link set can0 up type can bitrate ...`)."""

    def __init__(self, channel: str) -> None:
        super().__init__()
        import can  # takes a while to import, and only this port needs it

        self._can: Any = can
        self._channel = channel
        self._bus: Any = None

    def open(self) -> None:
        """Open a raw socket on the interface."""
        self.close()
        try:
            self._bus = self._can.Bus(interface="socketcan", channel=self._channel)
        except (OSError, self._can.CanError) as error:
            raise PortError(os_error_text(error)) from error

    def fileno(self) -> int:
        """The file descriptor to wait on."""
        return -1 if self._bus is None else int(self._bus.fileno())

    def read(self) -> bytes:
        """The frames that have arrived."""
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
        """Send frames (29-bit identifiers)."""
        try:
            for word, length, body in CAN_FRAME.iter_unpack(data):
                message = self._can.Message(arbitration_id=word & ~EXTENDED, is_extended_id=True, data=body[:length])
                self._bus.send(message, timeout=WRITE_S)
        except (OSError, self._can.CanError) as error:
            raise PortError(os_error_text(error)) from error

    def close(self) -> None:
        """Close the socket."""
        if self._bus is not None:
            with contextlib.suppress(Exception):  # a socket whose interface has gone
                self._bus.shutdown()
        self._bus = None
