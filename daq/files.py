"""Checks of files before reading, and the writer of all output files.

The writer creates the folder of the output, if it does not exist. It writes to a scratch file in this folder, and
renames it when it is complete. It does not follow symbolic links. Otherwise an attacker could create a link with the
name of an output, and so redirect the output to any file. Folders, pipes, devices and other special files are never
replaced.
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

# Descriptor of a pipe to the parent process of a bounded command; the parent deletes the scratch files of a killed
# child. -1 in other processes.
_report_pipe = -1


def require_file(path: Path) -> None:
    """Check that a path is a regular file, or a symbolic link to one. No byte is read.

    Raises
    ------
    SeatrialError
        If the path is not a regular file or cannot be opened.

    Notes
    -----
    A reader of a named pipe would wait for a writer, and a device may never end. The path is therefore opened without
    waiting.
    """
    try:
        opened = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
    except OSError as error:
        if error.errno == errno.ENXIO:  # a socket
            raise SeatrialError(f"{path}: is not a file; give the path of a file") from None
        raise SeatrialError(f"{path}: cannot be read: {error.strerror}; check its path and permissions") from None
    try:
        if not stat.S_ISREG(os.fstat(opened).st_mode):
            raise SeatrialError(f"{path}: is not a file; give the path of a file")
    finally:
        os.close(opened)


def require_new(path: Path, force: bool = False, option: str = "-o", switch: str = "--force") -> None:
    """Check that an output may be created at a path.

    A path that does not exist, or cannot be examined, is accepted; the writer reports an error.

    Parameters
    ----------
    path
        The output.
    force
        Whether an existing regular file may be replaced.
    option
        The command-line option that names another output, for the error message; an argument of a Python function.
    switch
        The command-line option that lets an existing file be replaced, for the error message; ``force=True`` in Python.

    Raises
    ------
    SeatrialError
        If the path is a symbolic link, a folder or a special file, or if it is an existing file and `force` is false.
    """
    try:
        mode = os.lstat(path).st_mode
    except OSError:  # the path does not exist, or the writer will report the error
        return
    if stat.S_ISLNK(mode):
        raise SeatrialError(
            f"{path}: is a symbolic link, and outputs follow no links; remove it, or name another output"
        )
    if not stat.S_ISREG(mode):
        raise SeatrialError(f"{path}: exists already, and is a folder, a pipe or a device; name another output")
    if not force:
        raise SeatrialError(f"{path}: the file exists already; {switch} replaces it, {option} names another")


def require_parent(path: Path) -> None:
    """Raise SeatrialError if the folder of an output is below a file, so that it can never be created.

    A folder that does not exist is accepted; the writer creates it. So is one that cannot be examined; the writer
    reports the error.
    """
    for folder in path.parents:
        try:
            mode = os.stat(folder).st_mode
        except OSError:
            continue
        if not stat.S_ISDIR(mode):
            raise SeatrialError(f"{path}: {folder} is a file and no folder; name another output")
        return


def make_parent(path: Path) -> None:
    """Create the folder of an output, with its parents, if it does not exist.

    Raises
    ------
    SeatrialError
        If the folder cannot be created.
    """
    require_parent(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SeatrialError(
            f"{path}: the folder {path.parent} cannot be created: {error.strerror}; name another output"
        ) from None


@contextlib.contextmanager
def new_file(path: Path, force: bool = True) -> Iterator[Path]:
    """Yield the path of a scratch file beside an output, for a `with` block that writes it.

    The folder of the output is created if it does not exist. The block has to create the scratch file. At the end of
    the block the scratch file gets the name of the output. If the block raises an error, the scratch file is deleted,
    and so is the folder if it was created here and is empty; an existing output stays as it was.

    Parameters
    ----------
    path
        The output.
    force
        Whether an existing regular file may be replaced.

    Raises
    ------
    SeatrialError
        If the output may not be created (see `require_new`), or its folder cannot be (see `make_parent`).
    OSError
        If the output cannot be written. The error has the name of the output, not of the scratch file. An OSError of
        the block without a file name gets this name too; one with the name of another file is not changed.
    """
    require_new(path, force)
    created = [folder for folder in path.absolute().parents if not folder.exists()]
    make_parent(path)
    is_done = False
    scratch = path.with_name(f".{path.name[:200]}.{secrets.token_hex(8)}.part")  # random: nobody can guess the name
    note_scratch(scratch)
    try:
        yield scratch
        require_new(path, force)  # again, because the block may have taken minutes
        if force:
            os.replace(scratch, path)
        else:
            _rename_to_new(scratch, path)
        is_done = True
    except OSError as error:
        if error.errno is None or error.filename not in (None, str(scratch), os.fsencode(scratch)):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        with contextlib.suppress(OSError):
            scratch.unlink(missing_ok=True)
            for folder in () if is_done else created:
                folder.rmdir()  # an OSError if it has other files by now


def _rename_to_new(scratch: Path, path: Path) -> None:
    """Rename a complete scratch file to `path`. Raise FileExistsError if a file of this name was created meanwhile.

    The scratch file itself may stay; the caller deletes it. A file system without hard links cannot check the name;
    there an existing file is replaced.
    """
    try:
        os.link(scratch, path)
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS):
            raise
        os.rename(scratch, path)  # file systems of memory sticks have no hard links


def write_output(path: Path, content: str | bytes, force: bool = True) -> None:
    """Write a whole output. Text is encoded as UTF-8, and its line ends are not changed.

    The folder of the output is created if it does not exist. The output is never incomplete: after an error an existing
    file stays as it was.

    Parameters
    ----------
    path
        The output.
    content
        Text or bytes.
    force
        Whether an existing regular file may be replaced.

    Raises
    ------
    SeatrialError
        If the output may not be created (see `new_file`).
    OSError
        If the output cannot be written.
    """
    with new_file(path, force) as scratch:
        opened = os.open(scratch, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666)
        with os.fdopen(opened, "wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)


def append_to(path: Path) -> IO[str]:
    """Open an output for appending UTF-8 text, and return the open file. Folder and file are created if missing.

    The caller closes the file. The text goes to the output itself and not to a scratch file.

    Raises
    ------
    SeatrialError
        If the path is a symbolic link, a folder or a special file, or if its folder cannot be created.
    OSError
        If the file cannot be opened.
    """
    require_new(path, force=True)
    make_parent(path)
    opened = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    return os.fdopen(opened, "a", encoding="utf-8")


def report_scratch_to(pipe: int) -> None:
    """Set the pipe to which `note_scratch` writes the names of scratch files. `pipe` is its file descriptor.

    The parent process, which limits this process, reads the names and deletes the files if this process is killed.
    """
    global _report_pipe
    _report_pipe = pipe


def note_scratch(path: Path) -> None:
    """Report the path of a new scratch file to the parent process, which deletes it if this process is killed.

    Nothing happens in a process without a parent that limits it, in which `report_scratch_to` was not called.
    """
    if _report_pipe >= 0:
        os.write(_report_pipe, os.fsencode(path.absolute()) + b"\0")
