"""A file that always ends with a whole record, and the disk space kept back to end it with."""

from __future__ import annotations

import contextlib
import errno
import os
import threading
from pathlib import Path

BALLAST_BYTES = 512 * 1024


class ReservedSpace:
    """Disk space held by a nameless file, so that it is free again at `release` or when the process dies."""

    def __init__(self, folder: Path) -> None:
        name = folder / f".seatrial-ballast-{os.getpid()}-{id(self):x}"
        self._fd = os.open(name, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        name.unlink()
        self.size = 0

    def grow(self, size: int) -> None:
        """Hold at least `size` bytes. Raises OSError where the disk has not got them."""
        if self._fd < 0 or size <= self.size:
            return
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(self._fd, 0, size)
        else:  # macOS
            os.pwrite(self._fd, b"\0" * (size - self.size), self.size)
        self.size = size

    def release(self) -> None:
        """Give the space back; again is harmless."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


class WholeRecordStream:
    """The file below `mcap.Writer`, which hands over whole records only; so the file always ends with one."""

    def __init__(self, path: Path) -> None:
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        for folder in (path.parent, path.absolute().parent.parent):  # or a loss of power may take the whole file
            sync_folder(folder)
        self._size = 0
        self.failure: OSError | None = None  # the first failed write, even where the ballast saved it
        try:
            self.ballast = ReservedSpace(path.parent)
            self.ballast.grow(BALLAST_BYTES)
        except OSError:
            os.close(self._fd)
            path.unlink()
            raise

    def tell(self) -> int:
        """Bytes in the file."""
        return self._size

    def write(self, data: bytes) -> int:
        """Write whole records. Raises OSError when they do not fit even without the ballast; none is torn then."""
        try:
            self._write_all(data)
        except OSError as error:
            os.ftruncate(self._fd, self._size)
            if self.failure is not None or error.errno not in (errno.ENOSPC, errno.EDQUOT):
                self.failure = self.failure or error
                raise
            self.failure = error
            self.ballast.release()
            # The same records once more, at the same place: the writer above has counted on them.
            try:
                self._write_all(data)
            except OSError:
                os.ftruncate(self._fd, self._size)
                raise
        self._size += len(data)
        return len(data)

    def _write_all(self, data: bytes) -> None:
        view = memoryview(data)
        at = self._size
        while view:
            written = os.pwrite(self._fd, view, at)
            view = view[written:]
            at += written

    @property
    def is_deleted(self) -> bool:
        """Whether no name leads to the file any more: what is written is lost when it is closed."""
        return os.fstat(self._fd).st_nlink == 0

    def flush(self) -> None:
        """Nothing is buffered here."""

    def sync(self) -> None:
        """Wait until the disk has it. Raises OSError."""
        os.fsync(self._fd)

    def close(self) -> None:
        """Close the file and free the reserved space."""
        self.ballast.release()
        os.close(self._fd)


def sync_folder(folder: Path) -> None:
    """Wait until the disk has the names in a folder, where the system can do that."""
    with contextlib.suppress(OSError):
        fd = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)


class FileSyncer(threading.Thread):
    """Calls `sync` on request, in a separate thread: on a memory card it can take a second."""

    def __init__(self, stream: WholeRecordStream) -> None:
        super().__init__(name="log-sync", daemon=True)
        self.error: OSError | None = None
        self._stream, self._wanted, self._ending = stream, threading.Event(), False

    def run(self) -> None:
        """Sync at every request until `end`."""
        while True:
            self._wanted.wait()
            self._wanted.clear()
            if self._ending:
                return
            try:
                self._stream.sync()
            except OSError as error:
                self.error = error
                return

    def request(self) -> None:
        """Ask for one sync."""
        self._wanted.set()

    def end(self) -> None:
        """Stop the thread and wait for it."""
        self._ending = True
        self._wanted.set()
        self.join()
