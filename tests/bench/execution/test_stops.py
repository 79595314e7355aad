"""Tests of every way a run can end, planned or not: zero thrust, one clear line, a readable log."""

from __future__ import annotations

import fcntl
import math
import os
import random
import re
import signal
import subprocess
import sys
import termios
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from seatrial.daq.acquisition.process import UNRESPONSIVE
from seatrial.daq.checks.device_checks import check_devices
from seatrial.daq.config.mission_file import Mission, Segment, save_mission
from seatrial.daq.drivers.setpoints import REPEAT_S, ZERO_FOR_S
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Command
from tests.bench.runs import (
    AT_ONCE_S,
    DEADMAN_S,
    SPEED,
    acquisition_of,
    assert_plan_was_run,
    is_alive,
    kinds,
    running,
    short_mission,
)
from tests.bench.standin import RIG, SLOW_ESC_S, TIMEOUT_S, StandIn, until

PARENT = "the program that started the acquisition"  # in messages of the acquisition process
RUNNER = "the program that runs the mission"


@pytest.mark.parametrize("moment", [0, *(pytest.param(k, marks=pytest.mark.study) for k in (1, 2, 3))])
def test_ctrl_c_at_any_moment_sends_zero_at_once_for_half_a_second(
    standin: StandIn, tmp_path: Path, moment: int
) -> None:
    short_mission(tmp_path, seconds=60.0)
    with running(tmp_path) as run:
        run.until_turning(standin)
        time.sleep(random.Random(moment).uniform(0.0, 1.5))  # the test needs interruptions at many different times
        sent = time.monotonic()
        run.process.send_signal(signal.SIGINT)
        assert run.end() == 130
    assert standin.zero_after(sent) - sent < AT_ONCE_S
    assert standin.commands[-1][1] == 0.0
    assert run.line() == "seatrial: stopped by Ctrl-C; thrust is zero, the log is run.mcap"
    log = open_log(run.log)
    assert not log.warnings
    assert "stop" in kinds(run.log)
    assert log.table(Command, "esc", node=1)["n_cmd"][-1] == 0.0
    last = max(k for k, (_, n) in enumerate(standin.commands) if n != 0.0)
    zeros = [t for t, _ in standin.commands[last + 1 :]]
    assert zeros[-1] - zeros[0] > 0.9 * ZERO_FOR_S
    assert len({round(t, 2) for t in zeros}) > 0.5 * ZERO_FOR_S / REPEAT_S  # and not all at once


def test_a_run_that_was_suspended_at_rest_does_not_resume_in_the_middle_of_the_plan(
    standin: StandIn, tmp_path: Path
) -> None:
    """A blocked terminal, a debugger or a swapping machine can cause such a pause.

    No command is active, so no other process detects it.
    """
    segments = (
        Segment("static", np.array([0.0]), np.zeros((1, 1))),
        Segment("steps", np.array([10.0 * SPEED]), np.array([[0.6]])),
    )
    save_mission(Mission("rest", "steps", ("left",), segments, 15.0 * SPEED, n_max=0.9), tmp_path / "mission.toml")
    with running(tmp_path) as run:
        until(lambda: run.log.exists() and run.log.stat().st_size > 1000 and "start" in kinds(run.log), 20.0)
        run.process.send_signal(signal.SIGSTOP)
        time.sleep(1.5)
        run.process.send_signal(signal.SIGCONT)
        assert run.end() == 3
    assert "this program stood still for 1." in run.line()
    assert {n for _, n in standin.commands} <= {0.0}


@pytest.mark.parametrize("after", [pytest.param(0.3, marks=pytest.mark.study), 1.0])
def test_a_returning_port_receives_zero_after_the_end_of_the_run(tmp_path: Path, after: float) -> None:
    short_mission(tmp_path, seconds=60.0)
    with StandIn(tmp_path, timeout_s=SLOW_ESC_S) as standin, running(tmp_path) as run:
        run.until_turning(standin)
        standin.pull(standin.can)
        time.sleep(after)
        assert standin.n != 0.0  # no process could send it before
        n_before = len(standin.commands)
        standin.plug(standin.can)
        until(lambda: standin.n == 0.0, 3.0)
        assert run.end() == 3
    assert "thrust is zero" in run.line()  # its status arrived after the port returned
    zeros = [t for t, n in standin.commands[n_before:] if n == 0.0]
    assert len(zeros) == len(standin.commands[n_before:])
    assert zeros[-1] - zeros[0] > 0.9 * ZERO_FOR_S
    assert not open_log(run.log).warnings


def test_a_closed_terminal_ends_the_run_like_a_signal(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path, seconds=60.0)
    master, slave = os.openpty()
    words = ["-m", "seatrial", "mission", "run", "mission.toml", "bench-rig.toml", "-o", "run.mcap"]
    run = subprocess.Popen(
        [sys.executable, *words], cwd=tmp_path, stdin=slave, stdout=slave, stderr=slave, start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
    )  # fmt: skip
    os.close(slave)
    try:
        until(lambda: standin.n != 0.0 or run.poll() is not None, 20.0)
        sent = time.monotonic()
        os.close(master)
        assert run.wait(20.0) == 128 + signal.SIGHUP
    finally:
        run.kill()
        run.wait()
    assert standin.zero_after(sent) - sent < AT_ONCE_S
    log = open_log(tmp_path / "run.mcap")
    assert not log.warnings
    assert any("SIGHUP" in text for _, kind, text in log.events() if kind == "stop")


def test_a_deleted_log_ends_the_run(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path, seconds=60.0)
    with running(tmp_path) as run:
        run.until_turning(standin)
        sent = time.monotonic()
        run.log.unlink()
        assert run.end() == 3
    assert standin.zero_after(sent) - sent < AT_ONCE_S
    assert "the log was deleted" in run.line()


def test_repeated_ctrl_c_does_not_prevent_zero_thrust(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path, seconds=60.0)
    with running(tmp_path) as run:
        run.until_turning(standin)
        sent = time.monotonic()
        while run.process.poll() is None and time.monotonic() < sent + 1.0:
            run.process.send_signal(signal.SIGINT)
            time.sleep(0.003)  # a person presses keys more slowly
        assert run.end() == 130
    assert standin.zero_after(sent) - sent < AT_ONCE_S
    assert not open_log(run.log).warnings


def test_ctrl_c_before_anything_moves(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path, seconds=60.0)
    with running(tmp_path) as run:
        until(run.log.exists, 20.0)
        run.process.send_signal(signal.SIGINT)
        assert run.end() == 130
    assert not any(n for _, n in standin.commands)
    open_log(run.log)


# SIGHUP also comes with a closed terminal.
@pytest.mark.parametrize(
    ("number", "word"),
    [(signal.SIGTERM, "SIGTERM"), pytest.param(signal.SIGHUP, "SIGHUP", marks=pytest.mark.study)],
)
def test_other_signals_end_the_run_like_ctrl_c(
    standin: StandIn, tmp_path: Path, number: signal.Signals, word: str
) -> None:
    short_mission(tmp_path, seconds=60.0)
    with running(tmp_path) as run:
        run.until_turning(standin)
        sent = time.monotonic()
        run.process.send_signal(number)
        assert run.end() == 128 + number
    assert standin.zero_after(sent) - sent < AT_ONCE_S
    assert word in run.line()
    assert not open_log(run.log).warnings


def test_a_signal_to_the_acquisition_process_is_named_as_the_reason(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path, seconds=60.0)
    with running(tmp_path) as run:
        run.until_turning(standin)
        sent = time.monotonic()
        os.kill(acquisition_of(run.process.pid), signal.SIGTERM)
        assert run.end() == 3
    assert standin.zero_after(sent) - sent < AT_ONCE_S
    assert "SIGTERM" in run.line()
    assert run.line().endswith("; thrust is zero, the log is run.mcap")
    log = open_log(run.log)
    assert not log.warnings
    assert any("SIGTERM" in text for _, kind, text in log.events() if kind == "stop")


def test_a_closed_output_pipe_does_not_endanger_the_run(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path, seconds=60.0)
    with running(tmp_path) as run:
        run.until_turning(standin)
        assert run.process.stdout is not None
        run.process.stdout.close()  # as `| head` does
        assert run.process.wait(timeout=20) == 1
    assert standin.n == 0.0
    assert standin.commands[-1][1] == 0.0
    assert not open_log(run.log).warnings
    assert "stop" in kinds(run.log)


def test_after_kill_9_of_the_runner_the_deadman_sends_zero(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path, seconds=60.0)
    with running(tmp_path) as run:
        run.until_turning(standin)
        acquisition = acquisition_of(run.process.pid)
        sent = time.monotonic()
        run.process.kill()
        until(lambda: standin.n == 0.0, 5.0)
        assert standin.zero_after(sent) - sent < DEADMAN_S + AT_ONCE_S
        assert standin.commands[-1][1] == 0.0  # it received zero and did not time out
        until(lambda: not is_alive(acquisition), 10.0)
        run.end()
    assert standin.n == 0.0
    # The killed runner cannot print its last line, so the acquisition process prints it.
    why, _, thrust = run.line().partition(": ")[2].partition("; ")
    silent = f"has not responded for 0.25 s {UNRESPONSIVE}"
    assert why in (f"{PARENT} has ended", f"{PARENT} {silent}", f"{RUNNER} {silent}")
    assert thrust.startswith("zero thrust was sent, not confirmed: make sure that")
    assert thrust.endswith(f"; the log is {run.log}")
    log = open_log(run.log)
    assert not log.warnings  # closed regularly, not salvaged
    assert log.table(Command, "esc", node=1)["n_cmd"][-1] == 0.0


def test_if_the_runner_hangs_the_deadman_sends_zero(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path, seconds=60.0)
    with running(tmp_path) as run:
        run.until_turning(standin)
        sent = time.monotonic()
        run.process.send_signal(signal.SIGSTOP)
        until(lambda: standin.n == 0.0, 5.0)
        assert standin.zero_after(sent) - sent < DEADMAN_S + AT_ONCE_S
        assert run.process.stderr is not None
        first = run.process.stderr.readline()  # printed by the acquisition process, because the runner still hangs
        # Both are true of a process that hangs. On a busy machine the heartbeat of the mission may be the older one.
        assert first in [
            f"seatrial: {program} has not responded for 0.25 s {UNRESPONSIVE}; zero thrust was sent, not confirmed: "
            f"make sure that the propellers stand still; the log is {run.log}\n"
            for program in (PARENT, RUNNER)
        ]
        run.process.send_signal(signal.SIGCONT)
        assert run.end() in (1, 3)
    run.line()
    assert standin.n == 0.0
    open_log(run.log)


# Kills of both processes: tests/bench/execution/test_watchdog.py, with an ESC that has a long time-out.
@pytest.mark.parametrize("both", [False, pytest.param(True, marks=pytest.mark.study)])
def test_after_kill_9_of_the_acquisition_the_esc_stops(standin: StandIn, tmp_path: Path, both: bool) -> None:
    short_mission(tmp_path, seconds=60.0)
    with running(tmp_path) as run:
        run.until_turning(standin)
        acquisition = acquisition_of(run.process.pid)
        sent = time.monotonic()
        if both:
            run.process.kill()
        os.kill(acquisition, signal.SIGKILL)
        until(lambda: standin.n == 0.0, 5.0)
        assert standin.zero_after(sent) - sent < TIMEOUT_S / SPEED + AT_ONCE_S
        status = run.end()
    if not both:
        assert status == 3
        # by the watchdog, which receives no frames from a controller
        assert "zero thrust was sent, not confirmed" in run.line()
        assert "run.mcap" in run.line()
    log = open_log(run.log)
    assert log.warnings  # salvaged
    recorded = log.table(Command, "esc", node=1)
    assert len(recorded) > 0


def test_a_pulled_can_port_is_a_safety_stop(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path, seconds=60.0)
    with running(tmp_path) as run:
        run.until_turning(standin)
        sent = time.monotonic()
        standin.pull(standin.can)
        assert run.end() == 3
    until(lambda: standin.n == 0.0, 5.0)
    assert standin.zero_after(sent) - sent < TIMEOUT_S / SPEED + AT_ONCE_S
    # No command can reach the controller.
    said = (
        "MAKE SURE THAT THE PROPELLERS STAND STILL before you approach: zero could not be sent to left, and only the "
        "time-out in the controller ends the thrust (in the rig: left 4 s); not measured; end of the run: esc "
    )
    assert run.line().startswith(f"seatrial: {said}")
    assert "was sent" not in run.line()
    assert run.line().endswith("\nseatrial: the log is run.mcap")
    assert "stop" in kinds(run.log)
    with open_log(run.log) as log:
        (found,) = [finding for finding in check_devices(log) if finding.code == "run-ended-early"]
    assert found.level == "warning"
    assert found.text.startswith("the run ended early: esc ")
    assert re.search(r"; silent at the end: esc node 1 \(\d+\.\d s\)$", found.text), found.text


def test_a_pulled_sensor_is_a_safety_stop(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path, seconds=60.0)
    with running(tmp_path) as run:
        run.until_turning(standin)
        standin.pull(standin.cell)
        assert run.end() == 3
    assert standin.n == 0.0
    assert standin.commands[-1][1] == 0.0
    assert "loadcell" in run.line()
    assert "was lost" in run.line()
    assert not open_log(run.log).warnings
    assert "stop" in kinds(run.log)


def test_too_much_force_is_a_safety_stop(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path, seconds=60.0)
    with running(tmp_path) as run:
        run.until_turning(standin)
        sent = time.monotonic()
        standin.extra_force = 70.0
        until(lambda: standin.n == 0.0, 5.0)
        assert standin.zero_after(sent) - sent < AT_ONCE_S
        assert run.end() == 3
    assert run.line().startswith("seatrial: force is ")
    assert run.line().endswith(
        "limits.force_n = 60; lower n_max, or correct the limit; thrust is zero, the log is run.mcap"
    )
    stops = [text for _, kind, text in open_log(run.log).events() if kind == "stop"]
    assert any("force is" in text for text in stops)


@pytest.mark.parametrize(
    ("key", "silence"),
    [
        ("temperature_c", {"temperature": math.nan}),
        pytest.param("voltage_min_v", {"voltage": math.nan}, marks=pytest.mark.study),
        ("force_n", {"calibration": ""}),
    ],
)
def test_a_limit_without_a_source_is_refused_before_thrust(
    standin: StandIn, tmp_path: Path, key: str, silence: dict[str, Any]
) -> None:
    short_mission(tmp_path, seconds=60.0)
    if "calibration" in silence:
        text = standin.rig.read_text(encoding="utf-8")
        begin, end = text.index("[device.calibration]"), text.index("[[thruster]]")
        standin.rig.write_text(text[:begin] + text[end:], encoding="utf-8")
    else:
        vars(standin).update(silence)
    with running(tmp_path, impatient=True) as run:
        assert run.end() == 1
    assert f"limits.{key} = " in run.line()
    assert f'unwatched = ["{key}"]' in run.line()
    assert not any(n for _, n in standin.commands)


def test_a_limited_quantity_that_falls_silent_ends_the_run_at_zero(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path, seconds=60.0)
    with running(tmp_path) as run:
        run.until_turning(standin)
        standin.temperature = math.nan
        assert run.end() == 3
    assert "limits.temperature_c is not watched any more" in run.line()
    assert standin.commands[-1][1] == 0.0
    assert open_log(run.log).table(Command, "esc", node=1)["n_cmd"][-1] == 0.0


def test_a_limit_may_be_explicitly_left_unwatched(standin: StandIn, tmp_path: Path) -> None:
    mission = short_mission(tmp_path, seconds=2.0)
    standin.temperature = math.nan
    with standin.rig.open("a", encoding="utf-8") as file:
        file.write('unwatched = ["temperature_c"]\n')
    with running(tmp_path) as run:
        assert run.end() == 0
    assert_plan_was_run(run.log, mission)


def test_a_run_that_is_refused_before_any_sample_leaves_no_file_and_no_folder(tmp_path: Path) -> None:
    (tmp_path / "bench-rig.toml").write_text(RIG.format(speed=1.0))  # without any of its ports
    short_mission(tmp_path)
    before = set(tmp_path.iterdir())
    with running(tmp_path, impatient=True, out="logs/first/run.mcap") as run:
        assert run.end() == 1
    assert set(tmp_path.iterdir()) - before == set(), run.err
    assert "nothing from esc" in run.err
    assert run.err.endswith("no thrust was commanded, no device sent a sample, so that no log is kept\n")
