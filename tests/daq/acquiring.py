"""An acquisition of the test boat, and what a test wants to know of it."""

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

MAGIC = b"\x89MCAP0\r\n"  # an MCAP file that was closed ends with it


@contextmanager
def acquiring(boat: TestBoat, folder: Path) -> Iterator[tuple[Acquisition, Rig, RunClock]]:
    """An acquisition of the boat into `folder`/run.mcap, with every device heard."""
    rig = load_rig(boat.rig_path)
    clock = RunClock(rig.speed)
    with Acquisition(rig, folder / "run.mcap", clock=clock) as acquisition:
        wait_for(lambda: all(port.samples > 5 for port in acquisition.status().ports.values()), what="every device")
        yield acquisition, rig, clock


@contextmanager
def living(acquisition: Acquisition) -> Iterator[None]:
    """A runner that says it lives."""
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
    """The last thing that each thruster was told is zero, after having been told something else."""
    boat.catch_up()
    for node in (1, 2):
        told = [n for there, n in boat.ports["can"].commands() if there == node]
        assert any(told), "no thrust was ever commanded"
        assert told[-1] == 0.0
