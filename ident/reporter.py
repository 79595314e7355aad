"""Reporters of long computations: lines of progress and warnings for the user."""

from __future__ import annotations

import math
import sys
import time
from typing import Protocol


class Reporter(Protocol):
    """Receiver of progress and warnings of a computation.

    A command line prints them; another program may ignore them.
    """

    def progress(self, text: str) -> None:
        """Report the step of the computation that starts now, as a text without a full stop."""

    def detail(self, text: str) -> None:
        """Report how far the present step is, such as ``iteration 7``. It may be called many times per second."""

    def warning(self, text: str) -> None:
        """Report a problem that does not stop the computation, as a sentence."""


class Quiet:
    """Reporter that ignores progress and prints warnings to the standard error stream, preceded by ``seatrial:``."""

    def progress(self, text: str) -> None:
        """Ignore the text."""

    def detail(self, text: str) -> None:
        """Ignore the text."""

    def warning(self, text: str) -> None:
        """Print ``seatrial: `` and the text in one line to the standard error stream."""
        print(f"seatrial: {text}", file=sys.stderr)


class StepLines:
    """Lines of a step of a computation, for reporters that print lines: the step, then its details now and then.

    Attributes
    ----------
    SPACING_S
        Least time [s] from the last line to a line with a detail.
    """

    SPACING_S = 30.0

    def __init__(self) -> None:
        """Begin without a step."""
        self._step, self._printed = "", -math.inf

    def start(self, step: str) -> str:
        """Return the line of a step that starts now: its text."""
        self._step, self._printed = step, time.monotonic()
        return step

    def detail(self, text: str) -> str:
        """Return the line with a detail of the present step; "" if the last line is less than 30 s old."""
        now = time.monotonic()
        if now - self._printed < self.SPACING_S:
            return ""
        self._printed = now
        return f"{self._step}: {text}" if self._step else text


def duration_text(seconds: float) -> str:
    """Return a duration as text: ``40 s`` or ``3 min``."""
    return f"{seconds:.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.0f} min"


class TimeLeft:
    """Time that a computation of a known number of equal parts still needs, by the time of the parts so far.

    Parameters
    ----------
    total
        Number of parts.
    """

    def __init__(self, total: int) -> None:
        """Store the number of parts. The time counts from here on."""
        self._total, self._began = total, time.monotonic()

    def text(self, done: int, least: float = 0.0) -> str:
        """Return the time left after ``done`` parts as text: ``40 s to go``.

        With more than ``total`` parts, their number is at least ``least``.
        """
        total = max(self._total, least)
        seconds = (time.monotonic() - self._began) / max(done, 1) * max(total - done, 0)
        return f"{duration_text(seconds)} to go"


QUIET: Reporter = Quiet()
