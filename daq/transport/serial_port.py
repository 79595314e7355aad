"""Serial ports by pyserial, and the list of those of this machine."""

from __future__ import annotations

import contextlib
import os
import select
import stat
import termios
import time
from typing import Any

import serial

from seatrial.daq.transport.base import READ_BYTES, WRITE_S, Port, PortError, os_error_text
from seatrial.daq.transport.ftdi_latency import set_latency_timer


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
                raise PortError("is not a serial device")
            self._serial = serial.Serial(self._path, self._baud, timeout=0, exclusive=True)
        except (OSError, termios.error, ValueError) as error:  # serial.SerialException is an OSError
            raise PortError(os_error_text(error)) from error
        self._fd = self._serial.fileno()
        self.hint = set_latency_timer(self._path)

    def fileno(self) -> int:
        """The file descriptor to wait on."""
        return self._fd

    def read(self) -> bytes:
        """What has arrived. An empty read of a device that reported bytes is a hang-up."""
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
                    raise PortError("accepts no more bytes") from None
            except OSError as error:
                raise PortError("hung up") from error

    def close(self) -> None:
        """Close; pyserial raises three kinds of error where the device has gone, and none matters here."""
        if self._serial is not None:
            with contextlib.suppress(OSError, termios.error):
                self._serial.close()
        self._serial, self._fd = None, -1


def list_serial_ports() -> list[tuple[str, str]]:
    """The serial ports of this machine: path and description by the system."""
    from serial.tools import list_ports  # takes a while to import, and only a search needs it

    return sorted((port.device, port.description) for port in list_ports.comports())
