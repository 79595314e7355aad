"""Operator interface of a run: status display, signals that stop the run, and single keys.

The status is a live display on a terminal, and plain lines elsewhere. Signals (Ctrl-C and others) set a flag that the
runner checks. They never raise an exception at an arbitrary line.
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
from typing import Any, Protocol, Self, TextIO

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

PLAIN_EVERY_S = 2.0  # wall seconds between plain lines within a segment
LIVE_EVERY_S = 0.1
AGAIN_S = 1.0  # wall seconds within which a repeated key counts as one press
CAUGHT = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
WORDS = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM", signal.SIGHUP: "hang-up (SIGHUP)"}
HELP = "space: pause and resume, r: repeat the step, m: mark, Ctrl-C: zero thrust and end"


@dataclass(frozen=True)
class MissionStatus:
    """State of a run that is shown to the operator. A measured value that is unknown or outdated is NaN.

    Attributes
    ----------
    segment : str
        Name of the present segment of the mission; "paused" during a pause.
    elapsed : float
        Mission's own time [run s], which does not advance during a pause.
    total : float
        Length of the mission [run s].
    n_cmd : tuple of float
        Command of each thruster of the mission, -1 to 1.
    rpm : tuple of float
        Measured shaft speed of each thruster of the mission [rev/min].
    force : float or None
        Force of a load cell [N]; None if no device measures it.
    speed : float or None
        Speed over ground [m/s]; None if no device measures it.
    warning : str
        Last one of the present warnings of the acquisition process, for example on a silent device; empty without one.
    """

    segment: str
    elapsed: float
    total: float
    n_cmd: tuple[float, ...]
    rpm: tuple[float, ...]
    force: float | None = None
    speed: float | None = None
    warning: str = ""

    def values(self) -> str:
        """Return commands, shaft speeds, force, speed and warning of the run as one line of text.

        NaN is written as "--". A force or speed of None is left out. Without a warning the line ends with "guard ok".
        """
        parts = [
            "n " + " ".join(f"{value:+.2f}" for value in self.n_cmd),
            "rpm " + " ".join(_format_value(value, "+5.0f") for value in self.rpm),
        ]
        if self.force is not None:
            parts.append(f"force {_format_value(self.force, '+6.1f')} N")
        if self.speed is not None:
            parts.append(f"speed {_format_value(self.speed, '4.2f')} m/s")
        parts.append(f"warning: {self.warning}" if self.warning else "guard ok")
        return "  ".join(parts)


def _format_value(value: float, form: str) -> str:
    """Return ``value`` as text, with the format specification ``form`` such as "+6.1f"; "  --" if it is NaN."""
    return "  --" if math.isnan(value) else f"{value:{form}}"


class Display(Protocol):
    """Interface of a display that shows the state of a run. It is a context manager: live or plain display."""

    def __enter__(self) -> Self:
        """Start the display of a run and return it."""
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the display and leave the terminal clean. An error in the context is not suppressed."""
        ...

    def show(self, view: MissionStatus) -> None:
        """Show the state ``view`` of the run. The display may leave out states that come too fast."""
        ...

    def say(self, line: str) -> None:
        """Print the text ``line`` as a line that stays on the screen; later states do not overwrite it."""
        ...

    def clear(self) -> None:
        """Remove the last state of the run from the screen, because it is no longer updated."""
        ...


class LiveDisplay:
    """Display on a terminal: two lines that are redrawn, with the progress and the newest values.

    Errors of a terminal that was closed after the start are ignored: SIGHUP ends the run, unless it runs under nohup.
    """

    def __init__(self, console: Console) -> None:
        """Prepare the display on the terminal ``console``. The display draws its first lines within the context."""
        # Without a refresh thread a blocked terminal blocks the runner, and the acquisition then commands zero.
        self._live = Live(console=console, auto_refresh=False, transient=True)
        self._last = -math.inf

    def __enter__(self) -> Self:
        """Start to draw the two lines of the display, and return the display."""
        self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Remove the two lines of the display. An error in the context is not suppressed."""
        with contextlib.suppress(OSError):
            self._live.stop()

    def show(self, view: MissionStatus) -> None:
        """Draw the state ``view`` of the run. A call within 0.1 s (wall) of the last drawing is ignored."""
        if time.monotonic() - self._last < LIVE_EVERY_S:
            return
        self._last = time.monotonic()
        with contextlib.suppress(OSError):
            self._live.update(_live_lines(view), refresh=True)

    def say(self, line: str) -> None:
        """Print the text ``line`` above the two lines of the display, where it stays."""
        with contextlib.suppress(OSError):
            self._live.console.print(line, markup=False, highlight=False, soft_wrap=True)

    def clear(self) -> None:
        """Remove the two lines of the display at once. The next state draws them again."""
        with contextlib.suppress(OSError):
            self._live.update(Group(), refresh=True)


def _live_lines(view: MissionStatus) -> Group:
    """Return the two lines of the live display for the state ``view`` of a run, as an object that rich can draw.

    The first line has the segment (cut to 24 characters), a progress bar and the elapsed time, clipped to the length
    of the mission. The second line has commands and measured values; it is red if there is a warning.
    """
    done = min(max(view.elapsed, 0.0), view.total)
    head = Table.grid(padding=(0, 1))
    bar = ProgressBar(total=view.total, completed=done, width=28)
    head.add_row(Text(f"{view.segment:<24.24}"), bar, Text(f"{done:6.1f}/{view.total:.0f} s"))
    return Group(head, Text(f"  {view.values()}", style="bold red" if view.warning else ""))


class PlainDisplay:
    """Display for pipes and files: it prints the state of a run at each new segment, and every 2 s (wall) within it."""

    def __init__(self, stream: TextIO) -> None:
        """Prepare the plain display of a run on the stream. The first state of the run will be printed at once."""
        self._stream = stream
        self._last = -math.inf
        self._segment = ""

    def __enter__(self) -> Self:
        """Return the plain display of a run. It needs no start."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the context. The display changes no terminal setting, and errors are passed on."""

    def show(self, view: MissionStatus) -> None:
        """Print the state ``view`` of the run as one line.

        Nothing is printed if the segment is the same as in the last printed line and that line is less than 2 s (wall)
        old.
        """
        now = time.monotonic()
        if view.segment == self._segment and now - self._last < PLAIN_EVERY_S:
            return
        self._last, self._segment = now, view.segment
        self.say(f"  {view.elapsed:6.1f}/{view.total:.0f} s  {view.segment:<14}  {view.values()}")

    def say(self, line: str) -> None:
        """Print the text ``line`` to the stream at once, without a buffer."""
        print(line, file=self._stream, flush=True)

    def clear(self) -> None:
        """Change nothing, because each printed line has its mission time, which shows that the line is old."""


def make_display(stderr: bool = False) -> Display:
    """Return a display for standard output or standard error: the live one if it is a terminal, else the plain one."""
    console = Console(stderr=stderr)
    return LiveDisplay(console) if console.is_terminal else PlainDisplay(sys.stderr if stderr else sys.stdout)


class StopSignals:
    """Context in which SIGINT, SIGTERM and SIGHUP raise no exception: they only set `caught` and end `wait` early.

    A second Ctrl-C can therefore not interrupt the return to zero thrust. The attribute `caught` is the first signal
    that has arrived, or None.
    """

    def __init__(self) -> None:
        """Prepare the handling of SIGINT, SIGTERM and SIGHUP. The handlers are installed when the context begins."""
        self.caught: signal.Signals | None = None
        self._read, self._write = -1, -1
        self._old: dict[signal.Signals, object] = {}

    def __enter__(self) -> Self:
        """Install handlers of SIGINT, SIGTERM and SIGHUP, and return this object. Only the main thread may do this."""
        # A pipe and not threading.Event: an Event set by a signal handler can deadlock on its own lock.
        self._read, self._write = os.pipe()
        os.set_blocking(self._write, False)
        for number in CAUGHT:
            self._old[number] = signal.signal(number, self._note_signal)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Restore the earlier signal handlers. If a signal has arrived, ignore SIGINT, SIGTERM and SIGHUP instead.

        The process then ends, and a second Ctrl-C must not suppress its last line, which names the log. An error in the
        context is not suppressed.
        """
        for number, handler in self._old.items():
            after = handler if self.caught is None else signal.SIG_IGN
            signal.signal(number, after)  # type: ignore[arg-type]  # a value that signal.signal returned
        os.close(self._read)
        os.close(self._write)

    def _note_signal(self, number: int, frame: FrameType | None) -> None:
        """Handle the signal ``number``: store it in `caught` if it is the first one, and wake up `wait`."""
        self.caught = self.caught or signal.Signals(number)
        with contextlib.suppress(BlockingIOError):  # the pipe is full of earlier signals, so that `wait` ends anyway
            os.write(self._write, b"!")

    def wait(self, seconds: float) -> bool:
        """Wait for ``seconds`` (wall) or until SIGINT, SIGTERM or SIGHUP arrives.

        Return whether such a signal has arrived since the context began. If one has, the method returns at once.
        """
        if self.caught is None:
            select.select([self._read], [], [], seconds)
        return self.caught is not None


class Keys:
    """Context in which single keys of the terminal are read, without Enter; `take` returns them.

    No keys are read if, at the beginning of the context, standard input is not a terminal or this process is not in the
    foreground of it.
    """

    def __init__(self) -> None:
        """Prepare the reading of keys. The mode of the terminal is changed when the context begins."""
        self._fd = -1
        self._before: list[Any] = []
        self._pressed: dict[str, float] = {}  # wall time, by key

    def __enter__(self) -> Self:
        """Put the terminal into a mode without line editing and echo, and return this object. Ctrl-C remains a signal.

        Nothing is changed if standard input is not a terminal, or if this process is not in the foreground.
        """
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
        """Restore the mode of the terminal if it was changed. An error in the context is not suppressed."""
        if self._fd >= 0:
            with contextlib.suppress(termios.error):
                termios.tcsetattr(self._fd, termios.TCSADRAIN, self._before)
            self._fd = -1

    @property
    def available(self) -> bool:
        """Whether keys are read: True only inside the context, and only until `take` finds the terminal closed.

        The terminal is tested once, at the beginning of the context: standard input must be a terminal, and this
        process must be in the foreground of it.
        """
        return self._fd >= 0

    def take(self) -> str:
        """Return the keys that were pressed since the last call, as characters in their order; empty without any.

        The key `p` is returned as a space. A key other than `m` is left out if it was last pressed (or repeated by
        holding it) at most 1 s ago. One call reads at most 64 bytes; the next call reads the rest. Characters that are
        not ASCII are left out. The call never waits. If no keys are read from a terminal, or it was closed, the text is
        empty.
        """
        if self._fd < 0 or not select.select([self._fd], [], [], 0.0)[0]:
            return ""
        try:
            return self._without_repetitions(os.read(self._fd, 64).decode("ascii", errors="ignore"), time.monotonic())
        except OSError:  # the terminal was closed; SIGHUP reports that
            self._fd = -1
            return ""

    def _without_repetitions(self, keys: str, now: float) -> str:
        """Return the pressed ``keys`` without those that repeat the same key within 1 s, at monotonic time ``now`` [s].

        The 1 s counts from the last press of the key, even if that was left out too. Pause and resume are the same key,
        so that a held key must count once. The key `m` (mark) always counts. The key `p` is returned as a space. The
        time of each key is stored for the next call.
        """
        taken = ""
        for key in keys.replace("p", " "):
            if key == "m" or now - self._pressed.get(key, -math.inf) > AGAIN_S:
                taken += key
            self._pressed[key] = now
        return taken
