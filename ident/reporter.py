"""Reporters of long computations: lines of progress and warnings for the user."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Sequence
from typing import Protocol


class Reporter(Protocol):
    """Receiver of progress and warnings of a computation.

    A command line prints them; another program may ignore them.
    """

    def progress(self, text: str, times: Callable[[], str] | None = None) -> None:
        """Report the step of the computation that starts now, as a text without a full stop.

        ``times`` returns the time so far and the time left as text. It is called again whenever the step is shown.
        """

    def detail(self, text: str) -> None:
        """Report how far the present step is, such as ``iteration 7``. It may be called many times per second."""

    def warning(self, text: str) -> None:
        """Report a problem that does not stop the computation, as a sentence."""


class Quiet:
    """Reporter that ignores progress and prints warnings to the standard error stream, preceded by ``seatrial:``."""

    def progress(self, text: str, times: Callable[[], str] | None = None) -> None:
        """Ignore the text."""

    def detail(self, text: str) -> None:
        """Ignore the text."""

    def warning(self, text: str) -> None:
        """Print ``seatrial: `` and the text in one line to the standard error stream."""
        print(f"seatrial: {text}", file=sys.stderr)


class StepLines:
    """Lines of a step of a computation, for reporters that print lines: the step, then its details now and then.

    Parameters
    ----------
    every_step
        Whether each step has a line. Otherwise a step has one only if the last line, or the start, is 30 s old.

    Attributes
    ----------
    SPACING_S
        Least time [s] from the last line to a line with a detail.
    """

    SPACING_S = 30.0

    def __init__(self, every_step: bool = True) -> None:
        """Begin without a step."""
        self._every_step = every_step
        self._step, self._detail, self._printed = "", "", -math.inf if every_step else time.monotonic()
        self._times: Callable[[], str] | None = None

    def start(self, step: str, times: Callable[[], str] | None = None) -> str:
        """Return the line of a step that starts now: its text, after the time so far if ``times`` returns it.

        It is empty if no line is due.
        """
        self._step, self._detail, self._times = step, "", times
        return self._due_line(self._every_step)

    def detail(self, text: str) -> str:
        """Return the line with a detail of the present step; "" if the last line is less than 30 s old."""
        self._detail = text
        return self._due_line(False)

    def _due_line(self, at_once: bool) -> str:
        """Return the line of the present step; "" if the last line is less than 30 s old and ``at_once`` is false."""
        now = time.monotonic()
        if not at_once and now - self._printed < self.SPACING_S:
            return ""
        self._printed = now
        return self.line()

    def line(self) -> str:
        """Return the line of the present step with its last detail, and with the times of now."""
        text = ": ".join(filter(None, (self._step, self._detail)))
        return f"{self._times()}: {text}" if self._times else text


def duration_text(seconds: float) -> str:
    """Return a duration as text: ``40 s`` or ``3 min``."""
    return f"{seconds:.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.0f} min"


def times_text(elapsed: float, left: tuple[float, float] | None) -> str:
    """Return the time so far and the time left as text: ``0:40 so far, about 2 min to go, seldom more than 5 min``.

    Parameters
    ----------
    elapsed
        Time so far [s].
    left
        Likely and largest time left [s]; None if it is not known yet. The largest one is stated if it is at least a
        half and 20 s more than the likely one, with the precision of the text.
    """
    so_far = "{}:{:02d} so far".format(*divmod(int(elapsed), 60))
    if left is None:
        return so_far
    likely, most = max(left[0], 1.0), left[1]
    limit = f", seldom more than {duration_text(most)}" if most > max(1.5 * likely, likely + 20.0) else ""
    return f"{so_far}, about {duration_text(likely)} to go{limit}"


class TimeLeft:
    """Time that a computation of a known number of equal parts still needs, by the time of the parts so far.

    Parameters
    ----------
    total
        Number of parts.
    scope
        What ends after these parts, such as "in this phase"; empty for the whole computation.
    """

    def __init__(self, total: int, scope: str = "") -> None:
        """Store the number of parts and the scope. The time counts from here on."""
        self._total, self._scope, self._began = total, scope, time.monotonic()

    def text(self, done: int, least: float = 0.0) -> str:
        """Return the time left after ``done`` parts as text, with the scope: ``40 s to go``.

        With more than ``total`` parts, their number is at least ``least``. In a scope, the time left is not zero: the
        parts may be more than expected, and other work follows.
        """
        total = max(self._total, least)
        seconds = (time.monotonic() - self._began) / max(done, 1) * max(total - done, 0)
        if not self._scope:
            return f"{duration_text(seconds)} to go"
        return f"{duration_text(seconds) if seconds >= 5.0 else 'a few seconds'} to go {self._scope}"


class TimedReporter:
    """Reporter that adds the time since its start to each step.

    Parameters
    ----------
    reporter
        Receiver of the texts.
    """

    def __init__(self, reporter: Reporter) -> None:
        """Store the receiver, and start to measure the time."""
        self._reporter, self._began = reporter, time.monotonic()

    def times(self) -> str:
        """Return a text with the time since the start, for example ``0:40 so far``."""
        return times_text(time.monotonic() - self._began, None)

    def progress(self, text: str, times: Callable[[], str] | None = None) -> None:
        """Report a step with the time so far, or with the times that are given."""
        self._reporter.progress(text, times or self.times)

    def detail(self, text: str) -> None:
        """Report how far the present step is."""
        self._reporter.detail(text)

    def warning(self, text: str) -> None:
        """Report a warning."""
        self._reporter.warning(text)


class PhasedReporter(TimedReporter):
    """Reporter that adds the time since its start and the number of the phase to each step.

    Parameters
    ----------
    reporter
        Receiver of the texts.
    phases
        Words of each phase, in their order. A phase begins with the first text that has its words.
    """

    def __init__(self, reporter: Reporter, phases: Sequence[str]) -> None:
        """Store the arguments. The time counts from here on."""
        super().__init__(reporter)
        self._phases, self._present = tuple(phases), 0

    def times(self) -> str:
        """Return the time since the start and the phase as text, such as ``0:40 so far, phase 3 of 7``."""
        return f"{super().times()}, phase {self._present + 1} of {len(self._phases)}"

    def progress(self, text: str, times: Callable[[], str] | None = None) -> None:
        """Report a step, which may begin the next phase or a later one."""
        later = range(self._present + 1, len(self._phases))
        self._present = next((k for k in later if self._phases[k] in text), self._present)
        super().progress(text, times)


QUIET: Reporter = Quiet()
