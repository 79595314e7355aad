"""Progress of a search for missing effects: the time so far, and an estimate of the time that it still needs.

A search consists of parts of a few kinds (`SHARES`): the start, score tests, refits with a candidate, exact fits,
fits without an effect, and evaluations at the end. How many parts are still ahead depends on what the search finds. So
two numbers are planned for each kind, the likely one and the largest one, and the search corrects them as it goes on.
The time of a part is the mean of those of its kind so far. The times are only shown, and no decision of the search
depends on them.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal

from seatrial.ident.reporter import Reporter, TimedReporter, times_text

Kind = Literal["start", "candidate", "tests", "exact", "without", "evaluation"]

# Time of a part of each kind in refits with a candidate, used until one of the kind was measured. The first fit and the
# first score tests ("start") say little: most of their time may be the compilation of the model, which comes once.
SHARES: Mapping[Kind, float] = {
    "start": 1.0, "candidate": 1.0, "tests": 1.0, "exact": 1.2, "without": 0.5, "evaluation": 1.1,
}  # fmt: skip


@dataclass
class SearchWork:
    """Parts of a search that are done, with their times, and those that are still ahead.

    Attributes
    ----------
    began
        Time [s] of the monotonic clock at the start.
    seconds
        Times [s] of the parts that are done, by kind.
    ahead
        Likely and largest number of parts still ahead, with those that run, by kind. Empty before a plan.
    """

    began: float = field(default_factory=lambda: time.monotonic())
    seconds: dict[Kind, list[float]] = field(default_factory=lambda: {kind: [] for kind in SHARES})
    ahead: dict[Kind, tuple[float, float]] = field(default_factory=dict)
    _running: tuple[Kind, int, float] | None = None  # kind, number of parts, and start

    def plan(self, kind: Kind, likely: float, most: float) -> None:
        """Store the likely and the largest number of parts of a kind that are still ahead."""
        self.ahead[kind] = (min(likely, most), most)

    @contextmanager
    def timed(self, kind: Kind, parts: int = 1) -> Iterator[None]:
        """Measure the time of the block, which computes so many parts of a kind, and count them as done.

        A block inside another one is not counted: its time is part of that of the outer block.
        """
        if self._running is not None or parts == 0:
            yield
            return
        start = time.monotonic()
        self._running = kind, parts, start
        try:
            yield
        finally:
            self._running = None
            self.seconds[kind] += [(time.monotonic() - start) / parts] * parts
            likely, most = self.ahead.get(kind, (0.0, 0.0))
            self.ahead[kind] = (max(likely - parts, 0.0), max(most - parts, 0.0))

    def left(self) -> tuple[float, float] | None:
        """Return the likely and the largest time [s] left; None before the first refits with candidates are done."""
        means: dict[Kind, float] = {kind: sum(times) / len(times) for kind, times in self.seconds.items() if times}
        if "candidate" not in means:
            return None
        likely = most = 0.0
        kind, parts, start = self._running or ("", 0, 0.0)
        for ahead, (few, many) in self.ahead.items():
            mean = means.get(ahead, SHARES[ahead] * means["candidate"])
            likely, most = likely + few * mean, most + many * mean
            if ahead == kind:  # a part that already takes longer than usual may end at any time
                done = min(time.monotonic() - start, parts * mean)
                likely, most = likely - min(done, few * mean), most - min(done, many * mean)
        return likely, most

    def text(self) -> str:
        """Return the time so far and the time left as text, such as ``0:40 so far, about 2 min to go``."""
        return times_text(time.monotonic() - self.began, self.left())


class SearchProgress(TimedReporter):
    """Reporter that adds the time so far and the time left to each step of a search.

    Parameters
    ----------
    reporter
        Receiver of the texts.

    Attributes
    ----------
    work
        Parts of the search, from which the time left is estimated.
    """

    def __init__(self, reporter: Reporter) -> None:
        """Store the receiver. The time counts from here on."""
        super().__init__(reporter)
        self.work = SearchWork()

    def times(self) -> str:
        """Return the time so far and the time left as text."""
        return self.work.text()


def with_times(reporter: Reporter) -> SearchProgress:
    """Return a reporter that adds the times to each step: the given one if it does so already."""
    return reporter if isinstance(reporter, SearchProgress) else SearchProgress(reporter)


def work_of(reporter: Reporter) -> SearchWork:
    """Return the work of a `SearchProgress`. Another reporter shows no times: its work is new and is not shown."""
    return reporter.work if isinstance(reporter, SearchProgress) else SearchWork()
