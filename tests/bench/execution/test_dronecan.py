"""Tests of a DroneCAN thruster with the public commands and the mock controller: run, guard, deadman and watchdog."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from seatrial.daq.config.mission_file import Mission, Segment, save_mission
from seatrial.daq.log.reader import open_log
from seatrial.daq.log.watchdog_note import read_note
from seatrial.daq.samples import Command, Esc
from tests.bench.guard_replay import replay
from tests.bench.runs import AT_ONCE_S, DEADMAN_S, acquisition_of, watchdog_of
from tests.bench.standin import until

SPEED = 4.0
ESC_S = 1.0  # wall seconds: the time-out of the controller itself
SEATRIAL = [sys.executable, "-m", "seatrial"]


def write_files(folder: Path, seconds: float) -> None:
    """Write the mock bench, with a reversed DroneCAN controller, and a mission: rest, ahead, astern."""
    text = files("seatrial.mocks").joinpath("rigs", "bench.toml").read_text(encoding="utf-8")
    text = text.replace('protocol = "vesc"', 'protocol = "dronecan"').replace("pole_pairs = 7\n", "reversed = true\n")
    text = re.sub(r"speed = [\d.]+", f"speed = {SPEED}", text)
    text = re.sub(r"timeout_s = [\d.]+", f"timeout_s = {ESC_S * SPEED}", text)
    (folder / "rig.toml").write_text(text, encoding="utf-8")
    rows = np.array([[0.6], [-0.4]])
    segments = (
        Segment("static", np.array([0.0]), np.zeros((1, 1))),
        Segment("steps", np.array([2.0, 2.0 + seconds / 2]), rows),
    )
    save_mission(Mission("short", "steps", ("thruster",), segments, 3.0 + seconds), folder / "mission.toml")


class Bench:
    """Mock bench and one run on it."""

    def __init__(self, folder: Path, devices: subprocess.Popen[str], run: subprocess.Popen[str]) -> None:
        self.folder, self.devices, self.run, self.log = folder, devices, run, folder / "run.mcap"

    def trace(self) -> list[dict[str, Any]]:
        """Return the changes of the thruster's effective command so far."""
        lines = (self.folder / "trace.jsonl").read_text(encoding="utf-8").splitlines()
        return [json.loads(line) for line in lines if line.endswith("}")]

    def turning(self) -> bool:
        rows = self.trace()
        return bool(rows) and rows[-1]["n"] != 0.0

    def until_turning(self) -> None:
        until(lambda: self.turning() or self.run.poll() is not None, 30.0)
        assert self.run.poll() is None, self.run.communicate()

    def zero_after(self, begun: float) -> float:
        """Return the time from `begun` until the thruster stands [s]."""
        until(lambda: not self.turning(), 10.0)
        return float(self.trace()[-1]["wall"]) - begun


@contextmanager
def bench(folder: Path, *words: str, seconds: float = 60.0) -> Iterator[Bench]:
    write_files(folder, seconds)
    mock = [*SEATRIAL, "mock", "bench", "rig.toml", "--seed", "5", "--trace", "trace.jsonl", *words]
    run = [*SEATRIAL, "mission", "run", "mission.toml", "rig.toml", "-o", "run.mcap"]
    pipes: dict[str, Any] = {"cwd": folder, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(mock, stderr=subprocess.DEVNULL, **pipes) as devices:
        try:
            assert devices.stdout is not None
            assert devices.stdout.readline() == "ready\n"
            with subprocess.Popen(run, stderr=subprocess.PIPE, start_new_session=True, **pipes) as process:
                try:
                    yield Bench(folder, devices, process)
                finally:
                    process.kill()
        finally:
            devices.terminate()
            devices.wait(timeout=10)


def test_a_run_from_command_to_log(tmp_path: Path) -> None:
    with bench(tmp_path, seconds=8.0) as it:
        _, err = it.run.communicate(timeout=60)
        assert it.run.returncode == 0, err
        commanded = {row["n"] for row in it.trace()}
        assert not it.turning()
    assert sorted(commanded) == pytest.approx([-0.4, 0.0, 0.6], abs=1e-4)
    assert replay(it.log).stop is None
    with open_log(it.log) as log:
        assert not log.warnings
        assert set(np.round(log.table(Command, "esc", node=1)["n_cmd"], 3)) == {0.6, -0.4, 0.0}
        esc = log.table(Esc, "esc", node=1)
    # positive is ahead, also if the thruster is reversed
    assert esc["rpm"].max() == pytest.approx(0.6 * 4500.0, rel=0.05)
    assert esc["rpm"].min() == pytest.approx(-0.4 * 4500.0, rel=0.05)
    assert 10.0 < np.nanmean(esc["voltage"]) < 60.0


def test_the_guard_reads_the_current_of_a_dronecan_controller(tmp_path: Path) -> None:
    with bench(tmp_path, "--fault", "overload/esc@usr1:3") as it:
        it.until_turning()
        begun = time.monotonic()
        it.devices.send_signal(signal.SIGUSR1)
        assert it.zero_after(begun) < 0.2 + AT_ONCE_S
        _, err = it.run.communicate(timeout=30)
        assert it.run.returncode == 3
    assert "current of node 1" in err
    assert "thrust is zero" in err


# The same faults with other rigs: tests/bench/execution/test_stops.py and test_with_mocks.py. Here the watchdog itself
# has to send DroneCAN.
@pytest.mark.parametrize(
    "who", ["acquisition", *(pytest.param(who, marks=pytest.mark.study) for who in ("runner", "everything"))]
)
def test_kill_9_ends_thrust_of_a_dronecan_controller(tmp_path: Path, who: str) -> None:
    with bench(tmp_path) as it:
        it.until_turning()
        acquisition, watchdog = acquisition_of(it.run.pid), watchdog_of(it.run.pid)
        killed = {
            "runner": [it.run.pid],
            "acquisition": [acquisition],
            "everything": [watchdog, acquisition, it.run.pid],
        }[who]
        begun = time.monotonic()
        for pid in killed:
            os.kill(pid, signal.SIGKILL)
        within = {"runner": DEADMAN_S, "acquisition": 0.1, "everything": ESC_S}[who]
        assert it.zero_after(begun) < within + AT_ONCE_S
        assert it.trace()[-1]["why"] == ("timeout" if who == "everything" else "command")
        it.run.communicate(timeout=30)
        if who == "acquisition":
            until(lambda: "zero thrust was sent" in read_note(it.log), 10.0)
    open_log(it.log)
