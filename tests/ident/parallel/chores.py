"""Small tasks for the tests of parallel work, at the top level of a module, so that other processes can import them."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from seatrial.daq.errors import SeatrialError


def square(number: int) -> tuple[int, int]:
    """Return the square of a number, and the process that computed it."""
    time.sleep(0.05)
    return number * number, os.getpid()


def picky(number: int) -> int:
    """Return the number. Two numbers are refused."""
    if number == 3:
        raise SeatrialError("three is\nrefused")
    if number == 4:
        raise RuntimeError("four broke")
    return number


def die_once(mark: Path) -> str:
    """Kill the own process by SIGKILL at the first call, and return the name of the mark at the next."""
    if mark.name.startswith("victim") and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.1)
    with mark.with_suffix(".runs").open("a") as runs:
        runs.write("x")
    return mark.name


def die_always(number: int) -> int:
    """Return the number, but kill the own process for number 2."""
    if number == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.05)
    return number


def slow(mark: Path) -> str:
    """Return the name of a mark after a tenth of a second, and count the call in the file of the mark."""
    time.sleep(0.1)
    with mark.open("a") as calls:
        calls.write("x")
    return mark.name


def span(number: int) -> tuple[float, float]:
    """Return the times at which a task began and ended [s]."""
    began = time.time()
    time.sleep(0.1)
    return began, time.time()
