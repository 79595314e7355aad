"""Files: regular files to read, and one writer for every output.

The writer makes a new scratch file beside the output and renames it when it is complete. It follows no symbolic link:
one that somebody has planted under the name of an output would otherwise lead the output to any place. What is no
regular file is never replaced.
"""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from seatrial.daq.errors import SeatrialError

_reports = -1  # a pipe to the parent process of a bounded command, which removes scratch files of a killed child


def require_file(path: Path) -> None:
    """Raise SeatrialError where a path is no regular file: a named pipe would wait for its writer, a device never ends.

    The path is opened without waiting and looked at before anything is read.
    """
    try:
        opened = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
    except OSError as error:
        if error.errno == errno.ENXIO:  # a socket
            raise SeatrialError(f"{path}: is not a file") from error
        raise SeatrialError(f"{path}: cannot be read: {error.strerror}") from error
    try:
        if not stat.S_ISREG(os.fstat(opened).st_mode):
            raise SeatrialError(f"{path}: is not a file")
    finally:
        os.close(opened)


def require_new(path: Path, force: bool = False, option: str = "-o") -> None:
    """Raise SeatrialError where an output cannot be made at a path.

    Parameters
    ----------
    path
        The output.
    force
        Whether a regular file there may be replaced.
    option
        The option that names another output, for the message.
    """
    try:
        mode = os.lstat(path).st_mode
    except OSError:  # what else is wrong with the path, the writer finds
        return
    if stat.S_ISLNK(mode):
        raise SeatrialError(f"{path}: is a symbolic link, and outputs follow none; remove it, or name another output")
    if not stat.S_ISREG(mode):
        raise SeatrialError(f"{path}: is there, and is not a file; name another output")
    if not force:
        raise SeatrialError(f"{path}: the file exists already; --force replaces it, {option} names another")


@contextlib.contextmanager
def new_file(path: Path, force: bool = True) -> Iterator[Path]:
    """Yield a scratch path beside `path`, which becomes `path` when the block ends well and is removed otherwise.

    Raises SeatrialError as `require_new` does, and OSError with the name of `path` where the disk refuses.
    """
    require_new(path, force)
    scratch = path.with_name(f".{path.name[:200]}.{secrets.token_hex(8)}.part")  # a name that nobody can plant
    note_scratch(scratch)
    try:
        yield scratch
        require_new(path, force)  # the block may have taken minutes
        if force:
            os.replace(scratch, path)
        else:
            _link(scratch, path)
    except OSError as error:
        if error.filename not in (None, str(scratch), os.fsencode(scratch)):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        with contextlib.suppress(OSError):
            scratch.unlink(missing_ok=True)


def _link(scratch: Path, path: Path) -> None:
    """Give a complete file its name, which nothing has got in the meantime."""
    try:
        os.link(scratch, path)
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS):
            raise
        os.rename(scratch, path)  # a memory stick has no hard links


def write_output(path: Path, content: str | bytes, force: bool = True) -> None:
    """Write a whole output: text as UTF-8 with its line ends as they are. Raises as `new_file` does."""
    with new_file(path, force) as scratch:
        opened = os.open(scratch, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666)
        with os.fdopen(opened, "wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)


def append_to(path: Path) -> IO[str]:
    """Open an output to append UTF-8 text. Raises SeatrialError where it is a link or no file, OSError otherwise."""
    require_new(path, force=True)
    opened = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    return os.fdopen(opened, "a", encoding="utf-8")


def report_scratch_to(pipe: int) -> None:
    """Name scratch files on this pipe from now on (see `seatrial.daq.bounds`)."""
    global _reports
    _reports = pipe


def note_scratch(path: Path) -> None:
    """Name a file that has to be removed where this process is killed before it has removed or renamed it."""
    if _reports >= 0:
        os.write(_reports, os.fsencode(path.absolute()) + b"\0")
