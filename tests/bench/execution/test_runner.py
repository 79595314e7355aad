"""Tests of the runner on real ptys: a mission is carried out, and no thruster moves without a command."""

from __future__ import annotations

import os
import random
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seatrial.daq.config.mission_file import Mission, Segment, parse_mission, save_mission
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Command, Esc, LoadCell
from tests.bench.guard_replay import replay
from tests.bench.runs import SPEED, acquisition_of, assert_plan_was_run, running, short_mission
from tests.bench.standin import RPM_MAX, StandIn


def test_a_mission_is_driven_recorded_and_tared(standin: StandIn, tmp_path: Path) -> None:
    mission = short_mission(tmp_path)
    with running(tmp_path) as run:
        assert run.end() == 0, run.err
    assert standin.n == 0.0
    levels = [n for _, n in standin.motion]
    np.testing.assert_allclose(levels, [0.0, 0.6, -0.3, 0.0], atol=1e-4)
    assert assert_plan_was_run(run.log, mission) == 0  # the rows are one second of wall time apart
    assert "skipped" not in run.out
    hold = np.diff([t for t, _ in standin.motion[1:]]) * SPEED
    np.testing.assert_allclose(hold, 4.0, atol=0.6)

    log = open_log(run.log)
    assert not log.warnings
    assert parse_mission(log.attachments["mission.toml"].decode(), "log") == mission
    events = [(kind, text) for _, kind, text in log.events()]
    assert [text for kind, text in events if kind == "segment"] == ["static", "steps", "static"]
    command = log.table(Command, "esc", node=1)
    assert command["n_cmd"].max() == pytest.approx(0.6, abs=1e-4)
    assert command["n_cmd"].min() == pytest.approx(-0.3, abs=1e-4)
    assert command["n_cmd"][-1] == 0.0
    start = next(t for t, kind, _ in log.events() if kind == "start")
    first = command["t"][np.flatnonzero(command["n_cmd"])[0]]
    assert first - start == pytest.approx(3.0 + 0.2 * SPEED, abs=0.6)
    assert log.table(Esc, "esc", node=1)["rpm"].max() == pytest.approx(0.6 * RPM_MAX, rel=1e-3)
    assert log.table(LoadCell, "loadcell")["force"].max() == pytest.approx(40 * 0.36, rel=1e-3)
    tares = [text for kind, text in events if kind == "tare"]
    assert [text.split(":")[0] for text in tares] == [
        "loadcell zero at the start",
        "loadcell zero at the end",
        "loadcell drift",
    ]
    assert "84210.0 counts" in tares[0]
    for text in tares:
        assert f"tare: {text}" in run.out
    assert "guard ok" in run.out
    assert replay(run.log).stop is None
    assert log.rig is not None
    strict = replace(log.rig, limits=replace(log.rig.limits, force_n=10.0))
    found = replay(run.log, strict)
    assert found.stop is not None
    assert found.stop.code == "limit"
    assert found.stop.reason.startswith("force is 1")


def test_skipped_set_points_are_reported(standin: StandIn, tmp_path: Path) -> None:
    levels = 0.3 + 0.01 * np.arange(30.0)
    segments = (Segment("rows", 2.0 + 0.2 * np.arange(30.0), levels[:, None]),)  # every 0.05 s of wall time
    mission = Mission("rows", "steps", ("left",), segments, 15.0, n_max=0.9)
    save_mission(mission, tmp_path / "mission.toml")
    with running(tmp_path) as run:
        run.until_turning(standin)
        child = acquisition_of(run.process.pid)
        os.kill(child, signal.SIGSTOP)
        time.sleep(0.2)  # shorter than the pause that the acquisition process counts as its own
        os.kill(child, signal.SIGCONT)
        assert run.end() == 0, run.err
    skipped = assert_plan_was_run(run.log, mission)
    assert skipped >= 3
    assert f"skipped: {skipped} of 31 set-points" in run.out
    sent = [n for _, n in standin.commands]
    changes = [n for k, n in enumerate(sent) if k == 0 or n != sent[k - 1]]
    assert changes == [*sorted(changes[:-1]), 0.0]  # an older command never follows a newer command


def test_garbage_on_the_lines_is_counted_and_the_run_continues(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path, seconds=4.0)
    noise = random.Random(1)
    with running(tmp_path) as run:
        run.until_turning(standin)
        for _ in range(10):
            standin.garble(noise.randbytes(40))
            time.sleep(0.05)  # spread over the run
        assert run.end() == 0, run.err
    np.testing.assert_allclose([n for _, n in standin.motion], [0.0, 0.6, -0.3, 0.0], atol=1e-4)
    log = open_log(run.log)
    assert log.table(LoadCell, "loadcell")["force"].min() > -60.0


def test_a_plan_beyond_the_rigs_limit_is_refused_before_thrust(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path, n=0.9)
    text = standin.rig.read_text(encoding="utf-8")
    standin.rig.write_text(text.replace("n_max = 0.9", "n_max = 0.5"), encoding="utf-8")
    with running(tmp_path) as run:
        assert run.end() == 1
    assert "limits.n_max is 0.5" in run.line()
    assert standin.commands == []
    assert not run.log.exists()


def test_a_missing_device_is_named_before_thrust(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path)
    standin.pull(standin.cell)
    with running(tmp_path, impatient=True) as run:
        assert run.end() == 1
    assert "loadcell" in run.line()
    assert not any(n for _, n in standin.commands)


def test_a_log_is_never_overwritten(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path)
    (tmp_path / "run.mcap").write_bytes(b"precious")
    with running(tmp_path) as run:
        assert run.end() == 1
    assert "never overwritten" in run.line()
    assert (tmp_path / "run.mcap").read_bytes() == b"precious"
    assert standin.commands == []
