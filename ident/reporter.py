"""How long work reports: lines of progress, and warnings that a person should see."""

from __future__ import annotations

import sys
from typing import Protocol


class Reporter(Protocol):
    """Receiver of lines for people; a command line shows them, a program may drop them."""

    def progress(self, text: str) -> None:
        """What is being done now."""

    def warning(self, text: str) -> None:
        """What is not as it should be, though the work goes on."""


class Quiet:
    """Drops progress; warnings go to the standard error."""

    def progress(self, text: str) -> None:
        """Nothing."""

    def warning(self, text: str) -> None:
        """One line."""
        print(f"seatrial: {text}", file=sys.stderr)


QUIET: Reporter = Quiet()
