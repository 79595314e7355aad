"""The operator's side of a run: its status on the terminal, signals that stop it, and single keys.

The status is a live display on a terminal and plain lines elsewhere. Signals (Ctrl-C and others) set a flag that the
runner checks; they never raise an exception in the middle of a line.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import signal
import sys
import termios
import time
import tty
from dataclasses import dataclass
from types import FrameType, TracebackType
from typing import Any, Protocol, Self

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

PLAIN_EVERY_S = 2.0  # wall seconds between plain lines within a segment
LIVE_EVERY_S = 0.1
AGAIN_S = 1.0  # wall seconds within which a key that comes again is still the same press
CAUGHT = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
WORDS = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM", signal.SIGHUP: "hang-up (SIGHUP)"}
HELP = "space: pause and resume, r: repeat the step, m: mark, Ctrl-C: zero and end"


@dataclass(frozen=True)
class MissionStatus:
    """One moment of a run, ready to be shown; times in run seconds, NaN where a value is not known, or not any more."""

    segment: str
    elapsed: float
    total: float
    n_cmd: tuple[float, ...]
    rpm: tuple[float, ...]
    force: float | None = None  # N; None where nothing measures it
    speed: float | None = None  # m/s over ground
    warning: str = ""

    def values(self) -> str:
        """Command, rpm, force or speed, and the guard's warning."""
        parts = [
            "n " + " ".join(f"{value:+.2f}" for value in self.n_cmd),
            "rpm " + " ".join(_shown(value, "+5.0f") for value in self.rpm),
        ]
        if self.force is not None:
            parts.append(f"force {_shown(self.force, '+6.1f')} N")
        if self.speed is not None:
            parts.append(f"speed {_shown(self.speed, '4.2f')} m/s")
        parts.append(f"warning: {self.warning}" if self.warning else "guard ok")
        return "  ".join(parts)


def _shown(value: float, form: str) -> str:
    return "  --" if math.isnan(value) else f"{value:{form}}"


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

    def show(self, view: MissionStatus) -> None:
        """Show one moment; may be called often, shows as often as is readable."""
        ...

    def say(self, line: str) -> None:
        """Print one line that stays."""
        ...


class LiveDisplay:
    """Two lines that are drawn over again, of 80 columns: progress of the plan, and what the devices report.

    A terminal that has been closed is no error here: SIGHUP ends the run, or nobody, as under nohup.
    """

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
        with contextlib.suppress(OSError):
            self._live.stop()

    def show(self, view: MissionStatus) -> None:
        """Draw at most ten times a second."""
        if time.monotonic() - self._last < LIVE_EVERY_S:
            return
        self._last = time.monotonic()
        with contextlib.suppress(OSError):
            self._live.update(_drawn(view), refresh=True)

    def say(self, line: str) -> None:
        """Print above the lines."""
        with contextlib.suppress(OSError):
            self._live.console.print(line, markup=False, highlight=False, soft_wrap=True)


def _drawn(view: MissionStatus) -> Group:
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

    def show(self, view: MissionStatus) -> None:
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


class StopSignals:
    """While the context lasts, SIGINT, SIGTERM and SIGHUP only set `.caught` and end `.wait` early.

    No second Ctrl-C can break the way to zero thrust, because none of them raises.
    """

    def __init__(self) -> None:
        self.caught: signal.Signals | None = None
        self._read, self._write = -1, -1
        self._old: dict[signal.Signals, object] = {}

    def __enter__(self) -> Self:
        """Install the handlers; only the main thread can."""
        # A pipe rather than threading.Event: an Event set by a handler can meet its own lock and never return.
        self._read, self._write = os.pipe()
        os.set_blocking(self._write, False)
        for number in CAUGHT:
            self._old[number] = signal.signal(number, self._take)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Put back the handlers that were there; but once a signal has come, ignore any further one.

        The process is on its way out then, and an impatient hand must not cut off the line that says where the log
        is.
        """
        for number, handler in self._old.items():
            after = handler if self.caught is None else signal.SIG_IGN
            signal.signal(number, after)  # type: ignore[arg-type]  # what signal.signal itself returned
        os.close(self._read)
        os.close(self._write)

    def _take(self, number: int, frame: FrameType | None) -> None:
        self.caught = self.caught or signal.Signals(number)
        with contextlib.suppress(BlockingIOError):  # full of earlier signals: the wait ends anyway
            os.write(self._write, b"!")

    def wait(self, seconds: float) -> bool:
        """Wait so long [wall s] or until a signal comes; returns whether one has come."""
        if self.caught is None:
            select.select([self._read], [], [], seconds)
        return self.caught is not None


class Keys:
    """While the context lasts, keys that are pressed are given by `take`; none where stdin is no terminal."""

    def __init__(self) -> None:
        self._fd = -1
        self._before: list[Any] = []
        self._pressed: dict[str, float] = {}  # wall time, by key

    def __enter__(self) -> Self:
        """Take the keys one by one; Ctrl-C stays a signal."""
        with contextlib.suppress(OSError, ValueError, termios.error):
            if sys.stdin.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp():
                fd = sys.stdin.fileno()
                self._before = termios.tcgetattr(fd)
                tty.setcbreak(fd)
                self._fd = fd
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the terminal as it was."""
        if self._fd >= 0:
            with contextlib.suppress(termios.error):
                termios.tcsetattr(self._fd, termios.TCSADRAIN, self._before)
            self._fd = -1

    @property
    def there(self) -> bool:
        """Whether there is a terminal to press keys at."""
        return self._fd >= 0

    def take(self) -> str:
        """What was pressed since the last call."""
        if self._fd < 0 or not select.select([self._fd], [], [], 0.0)[0]:
            return ""
        try:
            return self._once(os.read(self._fd, 64).decode("ascii", errors="ignore"), time.monotonic())
        except OSError:  # the terminal has gone; SIGHUP says so
            self._fd = -1
            return ""

    def _once(self, keys: str, now: float) -> str:
        """A key that is held or hit twice counts once: the one that stops also resumes. Marks all count."""
        taken = ""
        for key in keys.replace("p", " "):
            if key == "m" or now - self._pressed.get(key, -math.inf) > AGAIN_S:
                taken += key
            self._pressed[key] = now
        return taken
