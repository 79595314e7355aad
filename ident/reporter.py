"""Reporters of long computations: lines of progress and warnings for the user."""

from __future__ import annotations

import sys
from typing import Protocol


class Reporter(Protocol):
    """Receiver of progress and warnings. A command line prints them; another program may ignore them."""

    def progress(self, text: str) -> None:
        """Report the step that starts now."""

    def warning(self, text: str) -> None:
        """Report a problem that does not stop the computation."""


class Quiet:
    """Reporter that ignores progress and prints warnings to the standard error stream."""

    def progress(self, text: str) -> None:
        """Ignore the line."""

    def warning(self, text: str) -> None:
        """Print one line to the standard error stream."""
        print(f"seatrial: {text}", file=sys.stderr)


QUIET: Reporter = Quiet()
