"""The note of a watchdog, LOG.stop: what it did when no process wrote the log any more, and why.

Imports nothing that a watchdog would wait for or need memory for.
"""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

from daq.errors import printable

LONGEST = 500  # characters
NOTE = re.compile(r"\d{4}-\d\d-\d\dT\S+ watchdog: ")  # how it begins


def note_path(log: Path) -> Path:
    """Where it is written, beside the log."""
    return log.with_name(f"{log.name}.stop")


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
