"""A serial port that is a pty, linked at the path where a rig expects a device."""

from __future__ import annotations

import contextlib
import fcntl
import os
import struct
import termios
import tty
from pathlib import Path
from typing import IO

from seatrial.daq.errors import SeatrialError

PATIENCE = 0.3  # wall s without a byte read after which nobody is listening
CHECK = 0.02  # wall s between looks at what is unread; bytes need a moment to get from one end to the other
FULL = 4000  # unread bytes from which the line discipline (4095) may hold back others
BACKLOG_MAX = 1 << 20
READ_MAX = 1 << 16


class PtyPort:
    """The device's end of a pty and the link to the other end.

    This process holds the other end open as well: else the line discipline falls back to echo whenever the last
    reader leaves. Bytes wait for a slow reader. While there is none, no more than one write is kept, the newest of
    every CHECK: who comes late gets nothing stale, as on a UART.
    """

    def __init__(self, path: Path) -> None:
        """``path``: where the link goes. Raises SeatrialError if another mock or something else is there."""
        self.path = path
        self.dropped = 0  # bytes that nobody read in time
        self._backlog = bytearray()
        self._progress = 0.0
        self._idle = True  # nobody reads
        self._checked = 0.0
        self._unread = self._written = 0  # bytes unread at the last look, and written since
        self._master = self._slave = -1
        self._lock = _lock(path)
        try:
            self.plug()
        except BaseException:
            self.close()
            raise

    @property
    def plugged(self) -> bool:
        """Whether the port is there."""
        return self._master >= 0

    def plug(self) -> None:
        """Make the pty and its link."""
        if os.path.lexists(self.path) and not self.path.is_symlink():
            raise SeatrialError(f"{self.path}: exists and is no mock's port; give the rig a port path that is free")
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        os.set_blocking(self._slave, False)
        link = self.path.with_name(f".{self.path.name}.link")
        link.unlink(missing_ok=True)
        link.symlink_to(os.ttyname(self._slave))
        link.replace(self.path)  # a reader finds the old link or the new one, never none

    def unplug(self) -> None:
        """The port vanishes, and whoever has it open gets a hang-up."""
        if self.plugged:
            self.path.unlink(missing_ok=True)
            os.close(self._slave)
            os.close(self._master)
            self._master = self._slave = -1
            self._backlog.clear()
            self._become_idle()

    def close(self) -> None:
        """Unplug for good."""
        self.unplug()
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self._lock.name)
        self._lock.close()

    def fileno(self) -> int:
        """For select; only while plugged."""
        return self._master

    def read(self) -> bytes:
        """What the host has written."""
        try:
            data = os.read(self._master, READ_MAX)
        except BlockingIOError:
            return b""
        if self._idle:  # whoever writes, reads
            self._idle, self._progress = False, self._checked
        return data

    def write(self, data: bytes, wall: float) -> None:
        """Send ``data`` to the host, at ``wall`` (s, monotonic). Never blocks."""
        if not (self.plugged and data):
            return
        if wall - self._checked >= CHECK:
            self._look(wall)
        elif self._idle:
            self.dropped += len(data)
            return
        self._backlog += data
        self._written += len(data)
        self.flush(wall)

    def flush(self, wall: float) -> None:
        """Send what waits."""
        if self._backlog:
            with contextlib.suppress(BlockingIOError):
                del self._backlog[: os.write(self._master, self._backlog)]
            if len(self._backlog) > BACKLOG_MAX:
                self._discard()

    def _look(self, wall: float) -> None:
        """Find out from what is unread whether anybody reads."""
        unread: int = struct.unpack("i", fcntl.ioctl(self._slave, termios.FIONREAD, b"\0\0\0\0"))[0]
        read = unread == 0 or unread < min(self._unread + self._written, FULL)
        if self._idle and read and self._written:
            self._idle = False
        if read:
            self._progress = wall
        if self._idle or wall - self._progress > PATIENCE:
            self._discard()
            unread = 0
        self._checked, self._unread, self._written = wall, unread, 0

    def _discard(self) -> None:
        """Nobody reads: throw away all that waits, here and in the line discipline."""
        self._become_idle()
        self.dropped += len(self._backlog)
        self._backlog.clear()
        with contextlib.suppress(BlockingIOError):
            while data := os.read(self._slave, READ_MAX):
                self.dropped += len(data)

    def _become_idle(self) -> None:
        self._idle = True
        self._unread = self._written = 0


def _lock(path: Path) -> IO[str]:
    """A lock on the port's name that ends with this process, however it ends."""
    path.parent.mkdir(parents=True, exist_ok=True)
    file = open(path.with_name(f".{path.name}.lock"), "w")  # noqa: SIM115 (held open as long as the port)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        raise SeatrialError(f"{path}: another mock serves this port; stop it first") from None
    return file
