"""What a person sees while a plan runs: a live line on a terminal, plain lines elsewhere."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

PLAIN_EVERY_S = 2.0  # wall seconds between plain lines within a segment
LIVE_EVERY_S = 0.1


@dataclass(frozen=True)
class View:
    """One moment of a run, ready to be shown; times in run seconds, NaN where a value is not known."""

    segment: str
    elapsed: float
    total: float
    n_cmd: tuple[float, ...]
    rpm: tuple[float, ...]
    force: float = math.nan  # N
    speed: float = math.nan  # m/s over ground
    warning: str = ""

    def values(self) -> str:
        """Command, rpm, force or speed, and the guard's word."""
        parts = [
            "n " + " ".join(f"{value:+.2f}" for value in self.n_cmd),
            "rpm " + " ".join("  --" if math.isnan(value) else f"{value:+5.0f}" for value in self.rpm),
        ]
        if math.isfinite(self.force):
            parts.append(f"force {self.force:+6.1f} N")
        if math.isfinite(self.speed):
            parts.append(f"speed {self.speed:4.2f} m/s")
        parts.append(f"warning: {self.warning}" if self.warning else "guard ok")
        return "  ".join(parts)


class Display(Protocol):
    """Where a run shows itself."""

    def __enter__(self) -> Self:
        """Start to show."""
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the terminal clean."""
        ...

    def show(self, view: View) -> None:
        """Show one moment; may be called often, shows as often as is readable."""
        ...

    def say(self, line: str) -> None:
        """Print one line that stays."""
        ...


class LiveDisplay:
    """Two lines that are drawn over again, of 80 columns: where the plan is, and what the devices say."""

    def __init__(self, console: Console) -> None:
        # No thread of its own: a stuck terminal shall be seen by the deadman.
        self._live = Live(console=console, auto_refresh=False, transient=True)
        self._last = -math.inf

    def __enter__(self) -> Self:
        """Start to draw."""
        self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the lines away."""
        self._live.stop()

    def show(self, view: View) -> None:
        """Draw at most ten times a second."""
        if time.monotonic() - self._last < LIVE_EVERY_S:
            return
        self._last = time.monotonic()
        self._live.update(_drawn(view), refresh=True)

    def say(self, line: str) -> None:
        """Print above the lines."""
        self._live.console.print(line, markup=False, highlight=False, soft_wrap=True)


def _drawn(view: View) -> Group:
    done = min(max(view.elapsed, 0.0), view.total)
    head = Table.grid(padding=(0, 1))
    bar = ProgressBar(total=view.total, completed=done, width=28)
    head.add_row(Text(f"{view.segment:<24.24}"), bar, Text(f"{done:6.1f}/{view.total:.0f} s"))
    return Group(head, Text(f"  {view.values()}", style="bold red" if view.warning else ""))


class PlainDisplay:
    """A line at each segment's start and every few seconds, for pipes and files."""

    def __init__(self) -> None:
        self._last = -math.inf
        self._segment = ""

    def __enter__(self) -> Self:
        """Nothing to prepare."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing to clean up."""

    def show(self, view: View) -> None:
        """Print when the segment has changed or the last line is old."""
        now = time.monotonic()
        if view.segment == self._segment and now - self._last < PLAIN_EVERY_S:
            return
        self._last, self._segment = now, view.segment
        self.say(f"  {view.elapsed:6.1f}/{view.total:.0f} s  {view.segment:<14}  {view.values()}")

    def say(self, line: str) -> None:
        """Print."""
        print(line, flush=True)


def make_display() -> Display:
    """The live display on a terminal, the plain one elsewhere."""
    console = Console()
    return LiveDisplay(console) if console.is_terminal else PlainDisplay()
