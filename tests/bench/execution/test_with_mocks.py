"""Tests of the public commands against the mock devices: a bench run, kill -9 checked in the trace of the mock, the
preflight.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from seatrial.bench.demo import write_demo_rig
from seatrial.daq.config.mission_file import parse_mission
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Command, Esc, LoadCell
from tests.bench.guard_replay import replay
from tests.bench.mock_process import mock_process
from tests.bench.runs import assert_plan_was_run
from tests.bench.standin import until

SPEED = 10.0
CALM = 3.0  # speed of tests that judge rates: slow enough that a busy machine still keeps up
SEATRIAL = [sys.executable, "-m", "seatrial"]


@contextmanager
def mock(folder: Path, kind: str, *words: str, speed: float = SPEED) -> Iterator[subprocess.Popen[str]]:
    """Start a mock of `kind` in `folder` and wait until it is ready."""
    write_demo_rig(kind, folder, speed)
    with mock_process(folder, kind, f"{kind}-rig.toml", "--seed", "5", "--trace", "trace.jsonl", *words) as process:
        yield process


def trace(folder: Path) -> list[dict[str, Any]]:
    """Return the changes of a thruster's effective command so far."""
    lines = (folder / "trace.jsonl").read_text(encoding="utf-8").splitlines()
    return [json.loads(line) for line in lines if line.endswith("}")]


def run_bench(folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*SEATRIAL, "bench", "steps", "bench-rig.toml", "-o", "run.mcap"],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def turning(folder: Path) -> bool:
    rows = trace(folder)
    return bool(rows) and rows[-1]["n"] != 0.0


def test_bench_steps_end_to_end(tmp_path: Path) -> None:
    with mock(tmp_path, "bench"):
        run = run_bench(tmp_path)
        out, err = run.communicate(timeout=60)
        assert run.returncode == 0, err
        assert not turning(tmp_path)
    assert "tare: loadcell zero at the start" in out
    assert "done: bench steps thruster" in out
    log = open_log(tmp_path / "run.mcap")
    assert not log.warnings
    assert replay(tmp_path / "run.mcap").stop is None
    # A set-point of this plan holds for 0.18 s of wall time. A busy machine may miss one; the run then reports it.
    plan = parse_mission(log.attachments["mission.toml"].decode(), "log")
    levels = plan.setpoints()[1]
    assert (levels.max(), levels.min()) == (0.9, -0.9)
    skipped = assert_plan_was_run(tmp_path / "run.mcap", plan)
    assert (f"skipped: {skipped} of" in out) == (skipped > 0)
    assert skipped <= 3
    command = log.table(Command, "esc", node=1)["n_cmd"]
    rpm = log.table(Esc, "esc", node=1)["rpm"]
    assert rpm.max() == pytest.approx(4500.0 * command.max(), rel=0.03)
    assert rpm.min() == pytest.approx(4500.0 * command.min(), rel=0.03)
    force = log.table(LoadCell, "loadcell")["force"]
    assert force.max() > 20.0
    assert force.min() < -15.0
    spacing = log.table(Esc, "esc", node=1)["t"]
    assert len(spacing) == pytest.approx(50.0 * log.duration, rel=0.15)  # a busy machine starts late


def test_summary_of_a_run_as_json(tmp_path: Path) -> None:
    with mock(tmp_path, "bench"):
        words = [*SEATRIAL, "bench", "static", "bench-rig.toml", "-o", "run.mcap", "--json"]
        done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    tares = summary.pop("tares")
    assert 0.0 < summary.pop("wall_seconds") < 60.0
    assert summary == {
        "format": "seatrial-run 1",
        "plan": "bench static thruster",
        "log": "run.mcap",
        "seconds": 10.0,
        "still_armed": [],
        "next": "seatrial ident thruster run.mcap",
    }
    assert {(t["device"], t["where"]) for t in tares} == {("loadcell", "start")}
    assert "tare: loadcell zero at the start" in done.stderr
    assert "done:" not in done.stderr


# Kills of the runner alone: tests/bench/execution/test_stops.py.
@pytest.mark.parametrize("everything", [pytest.param(False, marks=pytest.mark.study), True])
def test_kill_9_stops_the_mock_thruster(tmp_path: Path, everything: bool) -> None:
    with mock(tmp_path, "bench") as devices:
        run = run_bench(tmp_path)
        until(lambda: (tmp_path / "trace.jsonl").exists() and turning(tmp_path), 30.0)
        if everything:
            out = subprocess.run(["ps", "-eo", "pid=,ppid="], capture_output=True, text=True, check=True).stdout
            children = [int(a) for a, b in (line.split() for line in out.splitlines()) if int(b) == run.pid]
            for pid in (run.pid, *children):
                os.kill(pid, signal.SIGKILL)
        else:
            run.kill()
        killed = time.monotonic()
        until(lambda: not turning(tmp_path), 5.0)
        # The time-out of the ESC is 10 run seconds, 1 s here. The time of the deadman is 0.25 s.
        assert time.monotonic() - killed < (1.0 if everything else 0.25) + 0.5
        run.communicate()
        assert devices.poll() is None
    log = open_log(tmp_path / "run.mcap")
    assert len(log.table(LoadCell, "loadcell")) > 100


def test_check_reports_good_and_bad_devices(tmp_path: Path) -> None:
    with mock(tmp_path, "boat", "--fault", "pull/gnss@0.1:10000", speed=CALM):
        done = subprocess.run(
            [*SEATRIAL, "check", "boat-rig.toml"], cwd=tmp_path, capture_output=True, text=True, check=False
        )
    assert done.returncode == 1
    faults = [line for line in done.stdout.splitlines() if line.startswith("fault")]
    assert [line.split()[1] for line in faults] == ["gnss", "mock"]
    assert "limits.radius_m = 300 is not watched" in faults[1]
    assert done.stderr.count("\n") == 1
    assert "not as it should be: gnss" in done.stderr


def test_check_of_a_healthy_boat_has_no_findings(tmp_path: Path) -> None:
    with mock(tmp_path, "boat", speed=CALM):
        done = subprocess.run(
            [*SEATRIAL, "check", "boat-rig.toml"], cwd=tmp_path, capture_output=True, text=True, check=False
        )
    assert done.returncode == 0, done.stdout + done.stderr
