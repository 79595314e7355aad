"""Serial ports by pyserial, and the list of the serial ports of this machine."""

from __future__ import annotations

import contextlib
import os
import select
import stat
import termios
import time
from typing import Any

import serial

from seatrial.daq.transport.base import NOT_SERIAL, READ_BYTES, WRITE_S, Port, PortError, os_error_text
from seatrial.daq.transport.ftdi_latency import set_latency_timer


class SerialPort(Port):
    """Serial port or pseudo-terminal.

    Parameters
    ----------
    path
        Path of the device file.
    baud
        Baud rate [bit/s].
    """

    def __init__(self, path: str, baud: int) -> None:
        """Store the path and the baud rate [bit/s]. The port is not opened."""
        super().__init__()
        self._path, self._baud = path, baud
        self._serial: Any = None
        self._fd = -1

    def open(self) -> None:
        """Open the serial port with exclusive access, for raw bytes with 8 data bits, no parity and 1 stop bit.

        A port that is open is closed first. The latency timer of an FTDI adapter is set to 1 ms; if this fails, `hint`
        has the advice. PortError is raised if the path is not a serial device or cannot be opened.
        """
        self.close()
        try:
            if not stat.S_ISCHR(os.stat(self._path).st_mode):
                raise PortError(NOT_SERIAL)
            self._serial = serial.Serial(self._path, self._baud, timeout=0, exclusive=True)
        except (OSError, termios.error, ValueError) as error:  # serial.SerialException is an OSError
            raise PortError(os_error_text(error)) from error
        self._fd = self._serial.fileno()
        self.hint = set_latency_timer(self._path)

    def fileno(self) -> int:
        """Return the file descriptor of the serial port, for `select`; -1 if the port is closed."""
        return self._fd

    def read(self) -> bytes:
        """Return the bytes that have arrived at the serial port. It must be called after waiting for bytes.

        PortError is raised if the device was disconnected, which an empty read after waiting shows.
        """
        try:
            data = os.read(self._fd, READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise PortError("the port was disconnected") from error
        if not data:
            raise PortError("the port was disconnected")
        self.bytes_in += len(data)
        return data

    def write(self, data: bytes) -> None:
        """Write all bytes to the serial port.

        Raise PortError if it does not accept all of them within 50 ms (WRITE_S), or if the device was disconnected.
        """
        deadline = time.monotonic() + WRITE_S
        left = memoryview(data)
        while left:
            try:
                left = left[os.write(self._fd, left) :]
            except BlockingIOError:
                wait = deadline - time.monotonic()
                if wait <= 0.0 or not select.select([], [self._fd], [], wait)[1]:
                    raise PortError("the port accepts no more bytes; plug device or adapter in again") from None
            except OSError as error:
                raise PortError("the port was disconnected") from error

    def close(self) -> None:
        """Close the serial port, if it is open. No error is raised, also if the device was removed."""
        if self._serial is not None:
            # pyserial raises these errors if the device was removed. They do not matter for a port that is closed.
            with contextlib.suppress(OSError, termios.error):
                self._serial.close()
        self._serial, self._fd = None, -1


def list_serial_ports() -> list[tuple[str, str]]:
    """Return the path of each serial port of this machine, and its description by the system, sorted by path.

    No port is opened. The list is empty if there are none.
    """
    from serial.tools import list_ports  # imported here because the import is slow and only a search needs it

    return sorted((port.device, port.description) for port in list_ports.comports())
