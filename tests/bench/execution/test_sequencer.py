"""Tests of pauses, repeats, marks and retries: with a simulated run clock, and once with keys on a real terminal."""

from __future__ import annotations

import math
import os
import pty
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seatrial.bench.execution.operator_interface import AGAIN_S
from seatrial.bench.execution.sequencer import CommandFollower, MissionSequencer, Schedule, follow_plan
from seatrial.daq.acquisition.status import PortStatus, Status
from seatrial.daq.config.mission_file import Mission, Segment
from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.errors import SafetyStop, SeatrialError
from seatrial.daq.log.reader import open_log
from seatrial.daq.tools.ros_live import ReceivedCommand
from tests.bench.runs import short_mission
from tests.bench.standin import RIG, StandIn, until

REST = np.zeros((1, 1))
MISSION = Mission(
    "m",
    "steps",
    ("left",),
    (
        Segment("static", np.array([0.0]), REST),
        Segment("one", np.array([2.0, 3.0]), np.array([[0.4], [0.8]])),
        Segment("two", np.array([4.0]), np.array([[-0.4]])),
        Segment("static", np.array([6.0]), REST),
    ),
    8.0,
)
PORT = PortStatus("esc", "", "", 40.0, 40.0, 0.01, 9, 9, 0, 0, 0, 0, 99, 0.0, 0.0, "")
GOOD = Status(0.0, {"esc": PORT}, {}, {}, 0, "run.mcap", 1, 1, 0.0, "", ())


class Acquisition:
    """Acquisition that keeps its commands. Zero clears the pending rows, as in the real acquisition."""

    def __init__(self) -> None:
        self.now = 0.0
        self.sent: list[tuple[float, float]] = []
        self.events: list[tuple[str, str]] = []

    def schedule(self, rows: list[tuple[float, dict[str, float]]]) -> None:
        self.sent += [(t, row["left"]) for t, row in rows]

    def zero(self, reason: str) -> None:
        self.sent = [row for row in self.sent if row[0] <= self.now] + [(self.now, 0.0)]
        self.events.append(("zero", reason))

    def mark(self, kind: str, text: str) -> None:
        self.events.append((kind, text))


class Drive:
    """Mission under control of the sequencer from run time 100 on, polled 20 times a second."""

    def __init__(self, retries: int = 0) -> None:
        self.acquisition, self.printed = Acquisition(), list[str]()
        self.course = MissionSequencer(
            MISSION, 100.0, 0.2, self.acquisition, lambda name: 1.0, self.printed.append, retries
        )
        self.now, self.status = 99.9, GOOD

    def until(self, t: float, keys: str = "") -> None:
        while self.now < t and (not self.course.is_over(self.now) or self.course.must_repeat(self.now, self.status)):
            self.acquisition.now = self.now
            self.course.step(self.now, 0.5, self.status, keys)
            self.now, keys = self.now + 0.05, ""

    def n(self, t: float) -> float:
        return [n for at, n in sorted(self.acquisition.sent, key=lambda row: row[0]) if at <= t][-1]

    def names(self, *kinds: str) -> list[str]:
        return [text for kind, text in self.acquisition.events if kind in kinds]


def test_a_mission_runs_without_changes_if_no_key_is_pressed() -> None:
    drive = Drive()
    drive.until(200.0)
    rows = [(0.0, 0.0), (2.0, 0.4), (3.0, 0.8), (4.0, -0.4), (6.0, 0.0), (8.0, 0.0)]
    assert drive.acquisition.sent == [(100.0 + t, n) for t, n in rows]
    assert drive.names("segment") == ["static", "one", "two", "static"]
    assert drive.now == pytest.approx(108.0, abs=0.1)


def test_a_pause_commands_zero_and_resumes_at_the_beginning_of_the_step() -> None:
    drive = Drive()
    drive.until(103.5)
    drive.until(110.0, " ")
    assert drive.n(105.0) == 0.0
    assert not drive.course.is_over(500.0)
    assert drive.course.paused
    # the clock of the mission stands still during the pause
    assert drive.course.elapsed(110.0) == pytest.approx(3.5, abs=0.1)
    drive.until(200.0, " ")
    assert drive.printed[-1] == "resumed with the beginning of one"
    assert drive.n(110.1) == 0.0
    assert [drive.n(110.2 + dt) for dt in (0.1, 1.1, 2.1, 4.1)] == [0.4, 0.8, -0.4, 0.0]
    assert drive.names("segment") == ["static", "one", "one", "two", "static"]
    assert drive.names("pause", "resume") == ["one", "one"]
    assert [kind for kind, text in drive.acquisition.events if kind == "zero"] == ["zero"]


@pytest.mark.parametrize("key", [" ", "r"])
def test_keys_before_the_first_set_point_of_a_restart_do_not_restart_the_mission(key: str) -> None:
    drive = Drive()
    drive.until(104.5)
    drive.until(110.0, " ")
    drive.until(110.1, " ")  # The step starts 0.2 s after the key.
    drive.until(110.15, key)
    if key == " ":
        drive.until(120.0, " ")
    drive.until(200.0)
    assert drive.names("segment") == ["static", "one", "two", "two", "static"]
    assert drive.names("pause", "resume", "repeat") == {" ": ["two"] * 4, "r": ["two"] * 3}[key]


def test_a_step_is_repeated_and_a_moment_is_marked() -> None:
    drive = Drive()
    drive.until(104.5)
    drive.until(104.6, "m")
    drive.until(200.0, "r")
    assert drive.names("segment") == ["static", "one", "two", "two", "static"]
    assert drive.names("mark") == ["operator mark 1"]
    assert drive.names("repeat") == ["two"]
    windows = drive.course.timeline.static_windows()
    assert [where for where, _, _ in windows] == ["start", "end"]
    assert windows[0][1:] == (100.0, 102.0)
    assert windows[1][2] == pytest.approx(drive.course.timeline.end)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({"skipped": 2}, "2 set-points were skipped"),
        ({"skipped": 1}, "1 set-point was skipped"),
        ({"ports": {"esc": replace(PORT, dropped=3)}}, "3 samples were dropped"),
        ({"ports": {"esc": replace(PORT, reconnects=1)}}, "1 port was lost"),
        ({"ports": {"esc": replace(PORT, age=0.7)}}, "esc was silent for 0.7 s"),
    ],
)
def test_a_failed_step_is_repeated_up_to_the_allowed_number(fault: dict[str, object], words: str) -> None:
    drive = Drive(retries=1)
    drive.until(103.0)
    drive.status = replace(GOOD, **fault)  # type: ignore[arg-type]
    drive.until(103.5)
    drive.status = replace(drive.status, ports={"esc": replace(drive.status.ports["esc"], age=0.01)})
    drive.until(200.0)
    assert drive.names("segment") == ["static", "one", "one", "two", "static"]
    assert drive.names("retry") == [f"one: {words}"]
    again = Drive(retries=0)
    again.until(103.0)
    again.status = replace(GOOD, **fault)  # type: ignore[arg-type]
    again.until(200.0)
    assert f"one: {words}" in again.names("invalid")
    assert any(f"invalid: one: {words}" in line and "--retry" in line for line in again.printed)
    assert again.names("segment") == ["static", "one", "two", "static"]


@pytest.mark.parametrize("retries", [0, 1])
def test_the_last_step_is_judged_too(retries: int) -> None:
    drive = Drive(retries)
    drive.until(107.5)
    drive.status = replace(GOOD, skipped=3)
    drive.until(200.0)
    assert drive.names("retry", "invalid") == ["static: 3 set-points were skipped"]
    assert drive.now == pytest.approx(108.0 + retries * 2.2, abs=0.2)


def test_the_slew_limit_starts_from_zero_after_a_restart() -> None:
    timeline = Schedule(replace(MISSION, slew_per_s=0.8), 0.0)
    assert timeline.rows(3.4)[-1][1]["left"] > 0.4
    timeline.restart(1, 50.0)
    rows = [row["left"] for t, row in timeline.rows(50.25)]
    assert rows == sorted(rows)
    assert rows[0] <= 0.8 * 0.05
    assert rows[-1] < 0.3


def test_keys_on_a_terminal_pause_and_resume_a_run(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path, seconds=6.0)
    terminal, its_end = pty.openpty()
    words = [sys.executable, "-m", "seatrial", "mission", "run", "mission.toml", "bench-rig.toml", "-o", "run.mcap"]
    with subprocess.Popen(
        [sys.executable, "-c", _ON_A_TERMINAL, *words], cwd=tmp_path, stdin=its_end, stdout=subprocess.PIPE, text=True
    ) as run:
        os.close(its_end)
        until(lambda: standin.n != 0.0 or run.poll() is not None, 30.0)
        os.write(terminal, b" ")
        until(lambda: standin.n == 0.0, 5.0)
        time.sleep(1.2 * AGAIN_S)  # wait for the pause: a second press that comes too soon counts as the same press
        assert standin.commands[-1][1] == 0.0
        os.write(terminal, b"m ")
        until(lambda: standin.n != 0.0, 10.0)
        out, _ = run.communicate(timeout=60)
    os.close(terminal)
    assert run.returncode == 0
    assert "space: pause and resume" in out
    kinds = [kind for _, kind, _ in open_log(tmp_path / "run.mcap").events()]
    assert [kind for kind in kinds if kind in ("pause", "mark", "resume")] == ["pause", "mark", "resume"]


# The terminal has to be the controlling terminal of a session, and the run its foreground process.
_ON_A_TERMINAL = """
import fcntl, os, sys, termios
os.setsid()
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.execv(sys.argv[1], sys.argv[1:])
"""


class Following:
    """Follower of `left` on a simulated run clock, polled 50 times a second. A command may come at each poll."""

    def __init__(self) -> None:
        self.acquisition, self.printed, self.waiting = Acquisition(), list[str](), list[ReceivedCommand]()
        self.waiting.append(ReceivedCommand(0.9, b"old", number=1))
        self.number = 1
        mission = Mission("follow", "mission", ("left",), MISSION.segments[:1], 60.0, 0.8, 2.0)
        self.course = CommandFollower(mission, 100.0, 0.3, self.acquisition, self.printed.append, self)
        self.now = 99.9

    def put(self, samples: object, dropped: int) -> None:
        raise AssertionError

    def take(self) -> dict[str, list[ReceivedCommand]]:
        taken, self.waiting = self.waiting, []
        return {"left": taken}

    def until(self, t: float, n: float | None = None, sender: bytes = b"a", keys: str = "") -> None:
        while self.now < t:
            if n is not None:
                self.number += 1
                self.waiting.append(ReceivedCommand(n, sender, number=self.number))
            self.acquisition.now = self.now
            self.course.step(self.now, 0.5, GOOD, keys)
            self.now, keys = self.now + 0.02, ""

    @property
    def n(self) -> float:
        return self.acquisition.sent[-1][1] if self.acquisition.sent else 0.0


def test_commands_are_not_followed_before_a_zero_command() -> None:
    drive = Following()
    drive.until(102.0, 0.03)
    assert drive.acquisition.sent == []
    assert drive.course.segment == "waiting for zero"
    drive.until(102.1, -0.01)
    drive.until(104.0, 0.5)
    assert drive.n == 0.5
    assert drive.course.segment == "follow"
    steps = np.diff([n for _, n in drive.acquisition.sent])
    assert steps.max() <= 2.0 * 0.02 + 1e-9  # the slew rate
    assert drive.course.is_over(160.0)


def test_missing_commands_set_zero_and_a_new_zero_command_is_required() -> None:
    drive = Following()
    drive.until(101.0, 0.0)
    assert drive.acquisition.sent == []
    drive.until(103.0, 0.5)
    heard = drive.now - 0.02
    drive.until(104.0)
    (stopped,) = [t for t, n in drive.acquisition.sent if n == 0.0]
    assert 0.3 < stopped - heard < 0.34
    assert drive.acquisition.events[-1] == ("silence", "no command for left")
    drive.until(105.0, 0.5)
    assert drive.n == 0.0
    drive.until(105.1, 0.0)
    drive.until(106.0, -0.5)
    assert drive.n == -0.5


def test_a_command_after_a_silence_does_not_hide_the_silence() -> None:
    """One sender stops. The first command of another sender arrives in the poll in which the time-out ends."""
    drive = Following()
    drive.until(101.0, 0.0)
    drive.until(103.0, 0.5)
    drive.until(103.3)
    assert drive.n == 0.5
    drive.until(103.34, -0.5, b"b")
    assert drive.n == 0.0
    drive.until(104.0, -0.5, b"b")
    assert drive.n == 0.0
    assert drive.course.segment == "waiting for zero"


@pytest.mark.parametrize("n", [math.nan, math.inf, 0.81, -1.0])
def test_an_invalid_command_or_one_beyond_the_limit_ends_the_run(n: float) -> None:
    drive = Following()
    drive.until(101.0, 0.0)
    with pytest.raises(SafetyStop, match=r"outside -0\.8 to 0\.8"):
        drive.until(101.1, n)


def test_a_second_sender_and_a_flood_end_the_run() -> None:
    drive = Following()
    drive.until(101.0, 0.0)
    with pytest.raises(SafetyStop, match="two ROS 2 nodes"):
        drive.until(101.1, 0.0, b"b")
    drive.until(102.0)
    drive.until(103.0, 0.0, b"b")  # one sender after the other is allowed
    drive.waiting = [ReceivedCommand(0.0, b"b", number=1)] * 512
    with pytest.raises(SafetyStop, match="too fast"):
        drive.until(103.1)


def test_a_command_without_a_complete_attachment_ends_the_run() -> None:
    drive = Following()
    drive.until(101.0, 0.0)
    with pytest.raises(SafetyStop, match="a command for thruster left lacks sequence number, time or id"):
        drive.until(101.1, 0.0, b"")


@pytest.mark.parametrize("number", [5, 4, 1, 0])
def test_a_command_that_is_repeated_or_out_of_order_ends_the_run(number: int) -> None:
    drive = Following()
    drive.waiting = [ReceivedCommand(0.0, b"a", number=5)]
    drive.until(100.0)
    drive.waiting = [ReceivedCommand(0.0, b"a", number=7)]  # number 6 was lost, which does not end the run
    drive.until(100.1)
    drive.waiting = [ReceivedCommand(0.0, b"a", number=number)]
    with pytest.raises(SafetyStop, match=f"command number {number} for thruster left came after number 7"):
        drive.until(100.2)


def test_after_a_pause_thrust_stays_zero_until_zero_was_commanded() -> None:
    drive = Following()
    drive.until(101.0, 0.0)
    drive.until(103.0, 0.5)
    drive.until(104.0, 0.5, keys=" ")
    assert drive.n == 0.0
    drive.until(105.0, 0.5, keys=" ")
    assert drive.n == 0.0
    drive.until(105.1, 0.0)
    drive.until(106.0, 0.5)
    assert drive.n == 0.5


def test_only_a_rig_with_permission_accepts_external_commands() -> None:
    rig = parse_rig(RIG.format(speed=1.0), Path("rig.toml"))
    with pytest.raises(SeatrialError, match=r"commands = true.*\[ros2\]"):
        follow_plan(rig, 60.0, None, 1.0)
    rig = parse_rig(RIG.format(speed=1.0) + "[ros2]\ncommands = true\n", Path("rig.toml"))
    assert follow_plan(rig, 60.0, None, 1.0).n_max == 0.9
    with pytest.raises(SeatrialError, match=r"limits\.n_max"):
        follow_plan(rig, 60.0, 0.95, 1.0)
