"""Acquisition of the test boat, and checks of its result."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from seatrial.daq.acquisition.session import Acquisition
from seatrial.daq.clock import RunClock
from seatrial.daq.config.rig_file import load_rig
from seatrial.daq.rig import Rig
from tests.daq.ptys import TestBoat, wait_for

MAGIC = b"\x89MCAP0\r\n"  # a closed MCAP file ends with it


@contextmanager
def acquiring(boat: TestBoat, folder: Path) -> Iterator[tuple[Acquisition, Rig, RunClock]]:
    """Start an acquisition of the boat into `folder`/run.mcap, and wait until every device has sent."""
    rig = load_rig(boat.rig_path)
    clock = RunClock(rig.speed)
    with Acquisition(rig, folder / "run.mcap", clock=clock) as acquisition:
        wait_for(lambda: all(port.samples > 5 for port in acquisition.status().ports.values()), what="every device")
        yield acquisition, rig, clock


@contextmanager
def living(acquisition: Acquisition) -> Iterator[None]:
    """Send the runner's signs of life to the acquisition, as a running runner does."""
    ending = threading.Event()

    def live() -> None:
        while not ending.wait(0.02):
            acquisition.alive()

    thread = threading.Thread(target=live)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        thread.join()


def is_closed(path: Path) -> bool:
    return path.exists() and path.read_bytes()[-len(MAGIC) :] == MAGIC and path.stat().st_size > 100


def assert_ends_at_zero(boat: TestBoat) -> None:
    """Check that the last command of each thruster is zero, after a command that was not zero."""
    boat.catch_up()
    for node in (1, 2):
        received = [n for there, n in boat.ports["can"].commands() if there == node]
        assert any(received), "no thrust was ever commanded"
        assert received[-1] == 0.0
