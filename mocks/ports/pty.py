"""Serial port of a mock: a pty with a link at the path where the rig expects a device."""

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

PATIENCE = 0.3  # wall s; if no byte was read for this time, the port has no reader
CHECK = 0.02  # wall s between two counts of the unread bytes, which take a moment from one end to the other
FULL = 4000  # unread bytes from which the line discipline (buffer of 4095) may hold back further bytes
BACKLOG_MAX = 1 << 20  # bytes that wait for a slow reader; more are dropped
READ_MAX = 1 << 16  # bytes


class PtyPort:
    """Serial port of a mock device: the device's end of a pty, and a symbolic link to the host's end.

    This process holds the host's end open as well. Otherwise the line discipline would return to echo when the last
    reader leaves.

    Bytes wait for a slow reader. Without a reader at most one write is kept, the first in each interval of 20 ms
    (CHECK), until the next interval. A reader that comes late therefore gets no old bytes, as on a UART.

    Attributes
    ----------
    path : Path
        Path of the link to the host's end.
    dropped : int
        Number of bytes that the host did not read in time.
    """

    def __init__(self, path: Path) -> None:
        """Lock the path of the port against other mocks, and open the port (`plug`).

        Parameters
        ----------
        path : Path
            Path of the link to the host's end.

        Raises
        ------
        SeatrialError
            If another mock serves this path, or the path is a file that is not a link.
        """
        self.path = path
        self.dropped = 0
        self._backlog = bytearray()
        self._progress = 0.0  # wall s, last time at which bytes were read
        self._idle = True  # whether the port has no reader
        self._checked = 0.0  # wall s of the last count of unread bytes
        self._unread = self._written = 0  # bytes unread at the last count, and bytes written since
        self._master = self._slave = -1
        self._port_lock = _lock_port_path(path)
        try:
            self.plug()
        except BaseException:
            self.close()
            raise

    @property
    def plugged(self) -> bool:
        """Whether the pty is open: between `plug` and `unplug`."""
        return self._master >= 0

    def plug(self) -> None:
        """Open the pty, and create the symbolic link to its host's end at the path of the port.

        A link of the same name is replaced. The port must not be plugged. Raises SeatrialError if the path exists and
        is not a link.
        """
        if os.path.lexists(self.path) and not self.path.is_symlink():
            raise SeatrialError(
                f"{self.path}: exists already, and is not the port of a mock; give the rig the path of a port that "
                "does not exist"
            )
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        os.set_blocking(self._slave, False)
        link = self.path.with_name(f".{self.path.name}.link")
        link.unlink(missing_ok=True)
        link.symlink_to(os.ttyname(self._slave))
        link.replace(self.path)  # a reader finds the old link or the new link at any time

    def unplug(self) -> None:
        """Remove the link and close the pty, as if the cable were pulled; waiting bytes are dropped, but not counted.

        A host that has the port open gets a hang-up. `plug` opens the port again.
        """
        if self.plugged:
            self.path.unlink(missing_ok=True)
            os.close(self._slave)
            os.close(self._master)
            self._master = self._slave = -1
            self._backlog.clear()
            self._become_idle()

    def close(self) -> None:
        """Close the port for good, release its lock and remove the lock file."""
        self.unplug()
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self._port_lock.name)
        self._port_lock.close()

    def fileno(self) -> int:
        """Return the file descriptor by which `select` waits for bytes of the host. The port must be plugged."""
        return self._master

    def read(self) -> bytes:
        """Return the bytes that the host has written since the last call; empty without any. The call never blocks.

        A host that has written counts as a reader, so that bytes for it are kept.
        """
        try:
            data = os.read(self._master, READ_MAX)
        except BlockingIOError:
            return b""
        if self._idle:
            self._idle, self._progress = False, self._checked
        return data

    def write(self, data: bytes, wall: float) -> None:
        """Send ``data`` to the host at the monotonic time ``wall`` [s]. The call never blocks.

        Bytes wait for a slow reader. They are dropped if the port is not plugged. Without a reader they are dropped
        too, except those of the first call in each interval of 20 ms, which wait until the next interval.
        """
        if not (self.plugged and data):
            return
        if wall - self._checked >= CHECK:
            self._detect_reader(wall)
        elif self._idle:
            self.dropped += len(data)
            return
        self._backlog += data
        self._written += len(data)
        self.flush(wall)

    def flush(self, wall: float) -> None:
        """Send the bytes that wait for a slow reader, as far as possible without blocking.

        If more than 1 MiB (BACKLOG_MAX) still wait, they and the unread bytes in the pty are dropped, and the port then
        counts as one without a reader. ``wall`` is not used.
        """
        if self._backlog:
            with contextlib.suppress(BlockingIOError):
                del self._backlog[: os.write(self._master, self._backlog)]
            if len(self._backlog) > BACKLOG_MAX:
                self._drop_waiting_bytes()

    def _detect_reader(self, wall: float) -> None:
        """Detect whether a host reads the port, from the number of unread bytes. Drop waiting bytes if none does.

        A host reads if no byte is unread, or fewer than were written; for a port without a reader, bytes must have been
        written since the last count. If no byte was read for 0.3 s (PATIENCE), no host reads. ``wall`` is the monotonic
        time [s].
        """
        unread: int = struct.unpack("i", fcntl.ioctl(self._slave, termios.FIONREAD, b"\0\0\0\0"))[0]
        read = unread == 0 or unread < min(self._unread + self._written, FULL)
        if self._idle and read and self._written:
            self._idle = False
        if read:
            self._progress = wall
        if self._idle or wall - self._progress > PATIENCE:
            self._drop_waiting_bytes()
            unread = 0
        self._checked, self._unread, self._written = wall, unread, 0

    def _drop_waiting_bytes(self) -> None:
        """Mark the port as one that no host reads, and drop all bytes that wait here or in the pty.

        They are counted in `dropped`.
        """
        self._become_idle()
        self.dropped += len(self._backlog)
        self._backlog.clear()
        with contextlib.suppress(BlockingIOError):
            while data := os.read(self._slave, READ_MAX):
                self.dropped += len(data)

    def _become_idle(self) -> None:
        """Mark the port as one that no host reads, and reset the counts of unread and written bytes."""
        self._idle = True
        self._unread = self._written = 0


def _lock_port_path(path: Path) -> IO[str]:
    """Lock the path of a mock's port against other mocks, and return the open lock file `.NAME.lock`.

    Its folder is made if it does not exist. The system releases the lock at the end of this process, even after a
    crash. Raises SeatrialError if another process holds the lock.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    file = open(path.with_name(f".{path.name}.lock"), "w")  # noqa: SIM115 (held open as long as the port)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        raise SeatrialError(f"{path}: another mock serves this port; stop that mock first") from None
    return file
