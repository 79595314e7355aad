"""Reporters of long computations: lines of progress and warnings for the user."""

from __future__ import annotations

import sys
from typing import Protocol


class Reporter(Protocol):
    """Receiver of progress and warnings of a computation.

    A command line prints them; another program may ignore them.
    """

    def progress(self, text: str) -> None:
        """Report the step of the computation that starts now, as a text without a full stop."""

    def warning(self, text: str) -> None:
        """Report a problem that does not stop the computation, as a sentence."""


class Quiet:
    """Reporter that ignores progress and prints warnings to the standard error stream, preceded by ``seatrial:``."""

    def progress(self, text: str) -> None:
        """Ignore the text."""

    def warning(self, text: str) -> None:
        """Print ``seatrial: `` and the text in one line to the standard error stream."""
        print(f"seatrial: {text}", file=sys.stderr)


QUIET: Reporter = Quiet()
