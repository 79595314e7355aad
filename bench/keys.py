"""Single keys from the terminal while a run goes on."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import termios
import tty
from types import TracebackType
from typing import Any, Self

HELP = "space: pause and resume, r: repeat the step, m: mark, Ctrl-C: zero and end"


class Keys:
    """While the context lasts, keys that are pressed are given by `take`; none where stdin is no terminal."""

    def __init__(self) -> None:
        self._fd = -1
        self._before: list[Any] = []

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
            return os.read(self._fd, 64).decode("ascii", errors="ignore")
        except OSError:  # the terminal has gone; SIGHUP says so
            self._fd = -1
            return ""
