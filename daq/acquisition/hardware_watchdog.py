"""Watchdog timer of the computer (Linux `/dev/watchdog`), which restarts a computer that hangs during a run."""

from __future__ import annotations

import contextlib
import fcntl
import os
import struct
from pathlib import Path

TIMEOUT_S = 10  # wall s without a beat after which the computer restarts
BEAT_S = 1.0  # wall s between beats
SET_TIMEOUT = 0xC0045706  # WDIOC_SETTIMEOUT of linux/watchdog.h
DISARM = b"V"  # the "magic close" of the kernel's watchdog API


class HardwareWatchdog:
    """Watchdog timer of the computer: until `close` the computer restarts if `beat` is not called for its time-out.

    The time-out is 10 s, or that of a timer whose time-out is fixed.

    Parameters
    ----------
    path : Path
        Device file of the timer, such as `/dev/watchdog`.

    Raises
    ------
    OSError
        If the device file cannot be opened.

    Notes
    -----
    The timer protects the computer and not the thrusters: speed controllers stop by their own time-out long before.
    A driver that was loaded with `nowayout` cannot be disarmed, so that the computer restarts after every run.
    """

    def __init__(self, path: Path) -> None:
        """Open the computer's watchdog timer `path`, which arms it, and set its time-out to 10 s (TIMEOUT_S).

        A timer with a fixed time-out keeps its own. Raise OSError if the device file cannot be opened.
        """
        self._file = os.open(path, os.O_WRONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        with contextlib.suppress(OSError):  # some drivers have a fixed time-out
            fcntl.ioctl(self._file, SET_TIMEOUT, struct.pack("i", TIMEOUT_S))
        self._next = -float("inf")

    def beat(self, now: float) -> None:
        """Restart the time-out of the watchdog timer, so that it does not restart the computer.

        `now` is a monotonic time [s]. A call within 1 s (`BEAT_S`) of the last one that wrote does nothing. A failed
        write is ignored.
        """
        if now >= self._next:
            self._next = now + BEAT_S
            with contextlib.suppress(OSError):
                os.write(self._file, b"\0")

    def close(self) -> None:
        """Disarm the watchdog timer of the computer and close its device file.

        A timer whose driver was loaded with `nowayout` stays armed. A failed write is ignored.
        """
        with contextlib.suppress(OSError):
            os.write(self._file, DISARM)
        os.close(self._file)
