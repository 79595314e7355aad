"""Tests of `mission follow` over real sockets and ptys: any fault of the sender of commands ends the thrust."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Command
from tests.bench.runs import AT_ONCE_S, Run, acquisition_of, kinds, running
from tests.bench.standin import StandIn, until
from tests.daq.ros_ends import Commander, Router

pytest.importorskip("rosbags", reason="no ROS types here (rosbags)")
FOLLOW = ("mission", "follow", "bench-rig.toml", "--seconds", "400", "--slew", "2")
TIMEOUT_S = 0.3
PROGRAM = """
import sys
sys.path.insert(0, {root!r})
from tests.daq.ros_ends import Commander, Router
with Commander(Router({address!r})) as commander:
    for line in sys.stdin:
        commander.n = float(line)
"""


@contextmanager
def following(standin: StandIn, folder: Path, router: Router) -> Iterator[Run]:
    """Start a run that waits for a zero command."""
    text = standin.rig.read_text(encoding="utf-8")
    standin.rig.write_text(f'{text}[ros2]\nrouter = "{router.address}"\ncommands = true\n', encoding="utf-8")
    with running(folder, FOLLOW) as run:
        yield run


def until_following(run: Run, command: Callable[[float], object], standin: StandIn, n: float = 0.5) -> None:
    """Send zero and `n` in turns until the devices are ready and the thruster follows."""
    for _ in range(20):
        command(0.0)
        time.sleep(0.4)
        command(n)
        deadline = time.monotonic() + 1.5
        while time.monotonic() < deadline:
            assert run.process.poll() is None, run.process.communicate()
            if abs(standin.n - n) < 1e-3:
                return
            time.sleep(0.01)
    raise AssertionError("it is not followed")


def test_commands_over_ros_are_driven_recorded_and_published(standin: StandIn, tmp_path: Path) -> None:
    with Router() as router, following(standin, tmp_path, router) as run, Commander(router) as commander:
        commander.n = 0.4
        until(lambda: run.log.exists(), 20.0)
        time.sleep(1.5)
        assert standin.n == 0.0  # neutral comes first
        until_following(run, commander.command, standin, 0.5)
        commander.n = -0.2
        until(lambda: abs(standin.n + 0.2) < 1e-3, 5.0)
        os.kill(run.process.pid, signal.SIGINT)
        assert run.end() == 130
    assert "commands are followed" in run.out
    assert "up to n = 0.9" in run.out
    assert "thrust is zero" in run.line()
    with open_log(run.log) as log:
        n = log.table(Command, "esc", node=1)["n_cmd"]
    assert (n.max(), n.min(), n[-1]) == pytest.approx((0.5, -0.2, 0.0), abs=1e-4)
    assert "follow" in kinds(run.log)


@pytest.mark.parametrize("how", ["killed", "router gone"])
def test_thrust_is_zero_when_commands_stop_and_resumes_after_a_zero_command(
    standin: StandIn, tmp_path: Path, how: str
) -> None:
    program = PROGRAM.format(root=str(Path(__file__).parents[3]), address="{}")
    with Router() as router, following(standin, tmp_path, router) as run, Commander(router) as commander:
        if how == "killed":
            commander.n = None
            words = [sys.executable, "-c", program.format(router.address)]
            with subprocess.Popen(words, stdin=subprocess.PIPE, text=True) as sender:
                assert sender.stdin is not None
                pipe = sender.stdin
                until_following(run, lambda n: print(n, file=pipe, flush=True), standin)
                stopped = time.monotonic()
                sender.kill()
        else:
            until_following(run, commander.command, standin)
            stopped = time.monotonic()
            router.stop()
        until(lambda: standin.n == 0.0, 3.0)
        assert standin.motion[-1][0] - stopped < TIMEOUT_S + AT_ONCE_S
        assert run.process.poll() is None
        time.sleep(0.5)
        assert standin.n == 0.0
        router.stop()
        with router:
            until_following(run, commander.command, standin, -0.3)
            run.process.send_signal(signal.SIGTERM)
            assert run.end() == 143
    assert standin.n == 0.0
    assert "silence" in kinds(run.log)


def _flood(commander: Commander) -> None:
    commander.n = None
    for _ in range(6000):
        commander.send(0.5)


BAD: dict[str, tuple[Callable[[Commander], object], str]] = {
    "nan": (lambda commander: commander.send(float("nan")), "n = nan"),
    "beyond the limit": (lambda commander: commander.send(0.95), "outside -0.9 to 0.9"),
    "flood": (_flood, "too fast"),
}


@pytest.mark.parametrize("kind", BAD)
def test_a_sender_of_invalid_commands_ends_the_run_at_zero(standin: StandIn, tmp_path: Path, kind: str) -> None:
    rave, words = BAD[kind]
    with Router() as router, following(standin, tmp_path, router) as run, Commander(router) as commander:
        until_following(run, commander.command, standin)
        begun = time.monotonic()
        rave(commander)
        assert run.end() == 3
    assert words in run.line()
    assert "thrust is zero" in run.line()
    assert standin.n == 0.0
    assert standin.motion[-1][0] - begun < 2.0 * AT_ONCE_S
    assert kinds(run.log)[-1] == "end"


def test_a_second_sender_ends_the_run(standin: StandIn, tmp_path: Path) -> None:
    with Router() as router, following(standin, tmp_path, router) as run, Commander(router) as commander:
        until_following(run, commander.command, standin)
        with Commander(router):
            assert run.end() == 3
    assert "two ROS 2 nodes" in run.line()
    assert standin.n == 0.0


def test_the_guard_and_the_deadman_end_a_run_that_follows_commands(standin: StandIn, tmp_path: Path) -> None:
    """A limit ends the run as in a mission, and so does a runner that hangs."""
    with Router() as router, following(standin, tmp_path, router) as run, Commander(router) as commander:
        until_following(run, commander.command, standin)
        assert acquisition_of(run.process.pid)
        hung = time.monotonic()
        os.kill(run.process.pid, signal.SIGSTOP)
        until(lambda: standin.n == 0.0, 3.0)
        assert standin.motion[-1][0] - hung < 0.25 + AT_ONCE_S
        os.kill(run.process.pid, signal.SIGCONT)
        assert run.end() in (1, 3)
    (tmp_path / "run.mcap").unlink()
    standin.motion.append((time.monotonic(), 0.0))
    text = standin.rig.read_text(encoding="utf-8")
    standin.rig.write_text(text.partition("[ros2]")[0], encoding="utf-8")
    with Router() as router, following(standin, tmp_path, router) as run, Commander(router) as commander:
        until_following(run, commander.command, standin)
        standin.extra_force = 80.0
        assert run.end() == 3
    assert "force is" in run.line()
    assert standin.n == 0.0


def test_a_rig_without_permission_is_not_commanded(standin: StandIn, tmp_path: Path) -> None:
    with running(tmp_path, FOLLOW) as run:
        assert run.end() == 1
    assert "commands = true" in run.line()
    assert standin.commands == []
    assert not run.log.exists()
