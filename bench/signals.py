"""Ctrl-C and its relatives as a flag that the runner looks at, never as an exception in the middle of a line."""

from __future__ import annotations

import contextlib
import os
import select
import signal
from types import FrameType, TracebackType
from typing import Self

CAUGHT = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
WORDS = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM", signal.SIGHUP: "hang-up (SIGHUP)"}


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
