"""Output file that always ends with a whole record, and reserved disk space for its last records.

The reserved space is called the ballast. It is released when the disk is full, so that the end of the file fits.
"""

from __future__ import annotations

import contextlib
import errno
import os
import threading
from pathlib import Path

BALLAST_BYTES = 512 * 1024


class ReservedSpace:
    """Disk space that is reserved (the ballast), so that the end of a log fits on a full disk.

    Parameters
    ----------
    folder
        Folder on the disk in which the space is reserved.

    Attributes
    ----------
    size
        Reserved bytes; 0 at first. `release` does not change it.

    Notes
    -----
    A file without a name occupies the space. It is free again after `release`, or when the process ends for any reason.
    """

    def __init__(self, folder: Path) -> None:
        """Create a file without a name in `folder`, which has 0 bytes at first. Raise OSError if this fails."""
        name = folder / f".seatrial-ballast-{os.getpid()}-{id(self):x}"
        self._fd = os.open(name, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        name.unlink()
        self.size = 0

    def grow(self, size: int) -> None:
        """Increase the reserved disk space to at least `size` bytes in all. It never becomes smaller.

        Nothing happens after `release`.

        Raises
        ------
        OSError
            If the disk has too little space or refuses the reservation.
        """
        if self._fd < 0 or size <= self.size:
            return
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(self._fd, 0, size)
        else:  # macOS has no posix_fallocate
            os.pwrite(self._fd, b"\0" * (size - self.size), self.size)
        self.size = size

    def release(self) -> None:
        """Free the reserved disk space, so that other files can use it. A second call has no effect."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


class WholeRecordStream:
    """Output file of a log that ends with a whole record after a failed write too, for example on a full disk.

    The caller, a `RecordWriter`, passes whole records only.

    Parameters
    ----------
    path
        The new file, which must not exist.

    Attributes
    ----------
    failure
        Error of the first failed write, even if the reserved space (the ballast) has made room for its records; None
        before.
    ballast
        Reserved space of the disk for the last records.

    Raises
    ------
    OSError
        If the file exists or cannot be created, or if the ballast cannot be reserved.
    """

    def __init__(self, path: Path) -> None:
        """Create the output file `path` and reserve disk space for its last records.

        Raise OSError if the file exists or cannot be created, or if the space cannot be reserved; in the last case the
        file is deleted again.
        """
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        # Without this a loss of power may remove the name of the file, and with the name the whole file.
        for folder in (path.parent, path.absolute().parent.parent):
            sync_folder(folder)
        self._size = 0
        self.failure: OSError | None = None  # first failed write, even if the ballast made room for its records
        try:
            self.ballast = ReservedSpace(path.parent)
            try:
                self.ballast.grow(BALLAST_BYTES)
            except OSError:
                self.ballast.release()  # otherwise each retry of a recorder would leave one open file
                raise
        except OSError:
            os.close(self._fd)
            path.unlink()
            raise

    def tell(self) -> int:
        """Return the number of bytes written to the file so far."""
        return self._size

    def write(self, data: bytes) -> int:
        """Write whole records to the file and return their number of bytes.

        The first time that the disk is full, the reserved space (the ballast) is released and the write is repeated;
        `failure` has the error.

        Raises
        ------
        OSError
            If the records do not fit even without the ballast, if the write fails for another reason than a full disk,
            or if an earlier write has failed already and this one fails too. The file then ends with the last record
            before them.
        """
        try:
            self._write_all(data)
        except OSError as error:
            os.ftruncate(self._fd, self._size)
            if self.failure is not None or error.errno not in (errno.ENOSPC, errno.EDQUOT):
                self.failure = self.failure or error
                raise
            self.failure = error
            self.ballast.release()
            # Write the same records again at the same place: the caller has already counted them in its indexes.
            try:
                self._write_all(data)
            except OSError:
                os.ftruncate(self._fd, self._size)
                raise
        self._size += len(data)
        return len(data)

    def _write_all(self, data: bytes) -> None:
        """Write all bytes at the end of the file. The size that `tell` returns does not change.

        Raise OSError on failure; a part of the bytes may then be written.
        """
        view = memoryview(data)
        at = self._size
        while view:
            written = os.pwrite(self._fd, view, at)
            view = view[written:]
            at += written

    @property
    def is_deleted(self) -> bool:
        """Whether the file has been deleted. The data of a deleted file are lost when it is closed."""
        return os.fstat(self._fd).st_nlink == 0

    def flush(self) -> None:
        """Return at once: `write` has no buffer, so nothing remains to be written."""

    def sync(self) -> None:
        """Wait until the written data of the file are on the disk. Raise OSError if the disk reports an error."""
        os.fsync(self._fd)

    def close(self) -> None:
        """Close the output file and free the reserved disk space. The file is not synced before."""
        self.ballast.release()
        os.close(self._fd)


def sync_folder(folder: Path) -> None:
    """Wait until the names of the files in a folder are on the disk, so that a loss of power cannot remove a new file.

    An OSError is suppressed, for example if the folder cannot be opened, or the operating system does not support this.
    """
    with contextlib.suppress(OSError):
        fd = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)


class FileSyncer(threading.Thread):
    """Thread that syncs an output file to the disk on request, because one sync can take a second on a memory card.

    Attributes
    ----------
    error
        Error of the sync that failed; the thread has then ended. None before.
    """

    def __init__(self, stream: WholeRecordStream) -> None:
        """Prepare the thread that syncs the output file `stream` to the disk; `start` begins it."""
        super().__init__(name="log-sync", daemon=True)
        self.error: OSError | None = None
        self._stream, self._wanted, self._ending = stream, threading.Event(), False

    def run(self) -> None:
        """Wait for requests and sync the file after each, until `end` is called or a sync fails (`error`)."""
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
        """Request one sync of the file. The call returns at once. Requests during a sync become one further sync."""
        self._wanted.set()

    def end(self) -> None:
        """Stop the sync thread and wait until it has ended, also for a sync that is running.

        A request that the thread has not taken up is dropped.
        """
        self._ending = True
        self._wanted.set()
        self.join()
