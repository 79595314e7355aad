"""What a watchdog did to a run whose log nobody writes any more: a line of text in `LOG.stop` beside the log."""

from __future__ import annotations

from pathlib import Path

LONGEST = 500  # characters


def note_path(log: Path) -> Path:
    """Where the watchdog writes what it did to the run of a log."""
    return log.with_name(f"{log.name}.stop")


def read_note(log: Path) -> str:
    """What a watchdog wrote beside a log, in one line; empty where it did not have to."""
    try:
        text = note_path(log).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    return " ".join(text.split())[:LONGEST]
