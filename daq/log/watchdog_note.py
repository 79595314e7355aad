"""Note of a watchdog, the file LOG.stop: its action after the process that writes the log has stopped, and the reason.

A watchdog imports this module. The module therefore imports no library that loads slowly or needs much memory.
"""

from __future__ import annotations

import contextlib
import os
import re
from pathlib import Path

from seatrial.daq.errors import printable

MAX_CHARACTERS = 500  # characters of a note that are read
NOTE_BEGINNING = re.compile(r"\d{4}-\d\d-\d\dT\S+ watchdog: ")  # the beginning of every note


def note_path(log: Path) -> Path:
    """Return the path of the file LOG.stop beside a log, in which a watchdog notes that it stopped the run.

    `log` is the first file of the log, such as run.mcap; its note is run.mcap.stop.
    """
    return log.with_name(f"{log.name}.stop")


def write_note(log: Path, text: str) -> None:
    """Write a watchdog's note (the file LOG.stop) beside a log: what it did after the logging process stopped.

    The file then contains `text` and a line end. An earlier note is replaced. If the file cannot be written, or is a
    symbolic link or a pipe without a reader, no note is written and no error is raised.
    """
    # A watchdog must never wait or fail here: a pipe without a reader would block, and a symbolic link may lead to a
    # file of another user.
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOFOLLOW", 0)
    with contextlib.suppress(OSError), os.fdopen(os.open(note_path(log), flags, 0o666), "w", encoding="utf-8") as file:
        file.write(f"{text}\n")


def read_note(log: Path) -> str:
    """Return the note of a watchdog (the file LOG.stop) beside a log, as one line.

    Only the first 2000 bytes are read. White space, line ends included, becomes single spaces. The text is then cut to
    500 characters (MAX_CHARACTERS).
    Other characters that are not printable become escape sequences, which may lengthen the text. The result is empty if
    there is no note, if LOG.stop is not a regular file, or if the file cannot be read.
    """
    path = note_path(log)
    try:
        text = path.read_bytes()[: 4 * MAX_CHARACTERS].decode("utf-8", errors="replace") if path.is_file() else ""
    except OSError:
        return ""
    return printable(" ".join(text.split())[:MAX_CHARACTERS])


def discard_note(log: Path) -> None:
    """Delete the watchdog's note (the file LOG.stop) beside an earlier log of the same name.

    Otherwise the new log would show it. A file of the same name stays if its text does not begin as a note does, with
    a time and "watchdog:". No error is raised if the file cannot be deleted.
    """
    if NOTE_BEGINNING.match(read_note(log)):
        with contextlib.suppress(OSError):
            note_path(log).unlink()
