"""Ports: serial, slcan on a serial port, SocketCAN. The only file that knows pyserial and python-can.

Sockets are in daq.net_port.

A port is opened, waited for through its file descriptor, read and written; whatever the operating system or a
library raises becomes a PortError of one line.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import select
import stat
import termios
import time
from abc import ABC, abstractmethod
from typing import Any

import serial

from daq.latency import set_latency_timer
from daq.protocol import slcan
from daq.protocol.canframe import CAN_FRAME, EXTENDED
from daq.rig import Device
from daq.rig_mavlink import NET_KINDS

READ_BYTES = 65536
WRITE_S = 0.05  # wall; a port that takes no bytes for longer is as good as gone


class PortError(Exception):
    """The port cannot be opened, or was lost. The message is one line without the port's name."""


class Port(ABC):
    """One port. CAN ports speak in whole 16-byte `struct can_frame`s, serial ports in bytes."""

    def __init__(self) -> None:
        self.bytes_in = 0
        self.unparsed_bytes = 0
        self.hint = ""  # what could be better about it, in one line; known when it is open

    @abstractmethod
    def open(self) -> None:
        """Open; raises PortError."""

    @abstractmethod
    def fileno(self) -> int:
        """What to wait on."""

    @abstractmethod
    def read(self) -> bytes:
        """What has arrived, after waiting; may be empty. Raises PortError when the other end is gone."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Write all of it; raises PortError."""

    @abstractmethod
    def close(self) -> None:
        """Close, whatever state it is in; never raises."""


class SerialPort(Port):
    """A serial device or pty."""

    def __init__(self, path: str, baud: int) -> None:
        super().__init__()
        self._path, self._baud = path, baud
        self._serial: Any = None
        self._fd = -1

    def open(self) -> None:
        """Open for ourselves alone, raw, 8N1."""
        self.close()
        try:
            if not stat.S_ISCHR(os.stat(self._path).st_mode):
                raise PortError("is no serial device")
            self._serial = serial.Serial(self._path, self._baud, timeout=0, exclusive=True)
        except (OSError, termios.error, ValueError) as error:  # serial.SerialException is an OSError
            raise PortError(why(error)) from error
        self._fd = self._serial.fileno()
        self.hint = set_latency_timer(self._path)

    def fileno(self) -> int:
        """What to wait on."""
        return self._fd

    def read(self) -> bytes:
        """What has arrived. An empty read of a device that said it had bytes is a hang-up."""
        try:
            data = os.read(self._fd, READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise PortError("hung up") from error
        if not data:
            raise PortError("hung up")
        self.bytes_in += len(data)
        return data

    def write(self, data: bytes) -> None:
        """Write all of it, waiting for room for `WRITE_S` at most."""
        deadline = time.monotonic() + WRITE_S
        left = memoryview(data)
        while left:
            try:
                left = left[os.write(self._fd, left) :]
            except BlockingIOError:
                wait = deadline - time.monotonic()
                if wait <= 0.0 or not select.select([], [self._fd], [], wait)[1]:
                    raise PortError("takes no more bytes") from None
            except OSError as error:
                raise PortError("hung up") from error

    def close(self) -> None:
        """Close; pyserial raises three kinds of error where the device has gone, and none matters here."""
        if self._serial is not None:
            with contextlib.suppress(OSError, termios.error):
                self._serial.close()
        self._serial, self._fd = None, -1


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
        """What to wait on."""
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
            raise PortError(why(error)) from error

    def fileno(self) -> int:
        """What to wait on."""
        return -1 if self._bus is None else int(self._bus.fileno())

    def read(self) -> bytes:
        """The frames that have arrived."""
        frames = []
        try:
            while (message := self._bus.recv(0.0)) is not None:
                if not (message.is_error_frame or message.is_remote_frame or message.is_fd):
                    word = message.arbitration_id | (EXTENDED if message.is_extended_id else 0)
                    frames.append(CAN_FRAME.pack(word, message.dlc, bytes(message.data)))
        except (OSError, self._can.CanError) as error:
            raise PortError(why(error)) from error
        self.bytes_in += CAN_FRAME.size * len(frames)
        return b"".join(frames)

    def write(self, data: bytes) -> None:
        """Send frames (29-bit identifiers)."""
        try:
            for word, length, body in CAN_FRAME.iter_unpack(data):
                message = self._can.Message(arbitration_id=word & ~EXTENDED, is_extended_id=True, data=body[:length])
                self._bus.send(message, timeout=WRITE_S)
        except (OSError, self._can.CanError) as error:
            raise PortError(why(error)) from error

    def close(self) -> None:
        """Close the socket."""
        if self._bus is not None:
            with contextlib.suppress(Exception):  # a socket whose interface has gone
                self._bus.shutdown()
        self._bus = None


def make_port(device: Device) -> Port:
    """The port that a device of the rig names; not open yet."""
    if device.port.startswith("slcan:"):
        return SlcanPort(device.port.removeprefix("slcan:"), device.baud, device.bitrate)
    if device.port.startswith("socketcan:"):
        return SocketCanPort(device.port.removeprefix("socketcan:"))
    if device.port.partition(":")[0] in NET_KINDS:
        from daq.net_port import make_net_port  # which needs this file

        return make_net_port(device.port)
    return SerialPort(device.port, device.baud)


_REASONS = {
    errno.ECONNREFUSED: "refuses the connection: nobody listens there",
    errno.ECONNRESET: "closed the connection",
    errno.EADDRINUSE: "is in use by another program",
    errno.EADDRNOTAVAIL: "is no address of this machine",
    errno.ENOENT: "is not there",
    errno.ENODEV: "is not there",
    errno.ENXIO: "is not there",
    errno.EIO: "is not there",
    errno.EACCES: "may not be opened by this user (group dialout?)",
    errno.EPERM: "may not be opened by this user (group dialout?)",
    errno.EBUSY: "is in use by another program",
    errno.EAGAIN: "is in use by another program",
    errno.ENOTTY: "is no serial device",
    errno.ENETDOWN: "is down (ip link set ... up)",
}


def why(error: BaseException) -> str:
    """One line for an error of the operating system or of a library."""
    number = getattr(error, "errno", None) or getattr(error, "error_code", None)
    if number is None and (inner := re.search(r"\((\d+), '", str(error))):  # pyserial quotes the one below it
        number = int(inner[1])
    return _REASONS.get(number or 0) or " ".join(str(error).split()) or type(error).__name__


def list_serial_ports() -> list[tuple[str, str]]:
    """The serial ports of this machine: path and what the system says of each."""
    from serial.tools import list_ports  # takes a while to import, and only a search needs it

    return sorted((port.device, port.description) for port in list_ports.comports())
