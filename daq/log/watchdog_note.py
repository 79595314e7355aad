"""The note of a watchdog, LOG.stop: what it did when no process wrote the log any more, and why.

Imports nothing that a watchdog would wait for or need memory for.
"""

from __future__ import annotations

import contextlib
import os
import re
from pathlib import Path

from seatrial.daq.errors import printable

LONGEST = 500  # characters
NOTE = re.compile(r"\d{4}-\d\d-\d\dT\S+ watchdog: ")  # how it begins


def note_path(log: Path) -> Path:
    """Where it is written, beside the log."""
    return log.with_name(f"{log.name}.stop")


def write_note(log: Path, text: str) -> None:
    """Write it, in the place of an earlier one. A disk that is full or a name that is no plain file (a pipe without a
    reader, a link to what is somebody else's) leaves it unwritten: nothing must hold up a watchdog."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOFOLLOW", 0)
    with contextlib.suppress(OSError), os.fdopen(os.open(note_path(log), flags, 0o666), "w", encoding="utf-8") as file:
        file.write(f"{text}\n")


def read_note(log: Path) -> str:
    """What a watchdog wrote beside a log, in one line; empty where it did not have to."""
    path = note_path(log)
    try:
        text = path.read_bytes()[: 4 * LONGEST].decode("utf-8", errors="replace") if path.is_file() else ""
    except OSError:
        return ""
    return printable(" ".join(text.split())[:LONGEST])


def discard_note(log: Path) -> None:
    """Take away what a watchdog wrote of an earlier log of this name: a new one must not be blamed for it."""
    if NOTE.match(read_note(log)):
        with contextlib.suppress(OSError):
            note_path(log).unlink()
