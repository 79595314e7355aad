"""Tests of the watchdog process: it ends thrust if the acquisition hangs or dies, and its own death ends the run."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from seatrial.daq.acquisition.ipc import ACTIVE, FINISHED, IDLE
from seatrial.daq.acquisition.watchdog import ANSWER_S, HANG_S, POLL_S, HeartbeatMonitor
from seatrial.daq.log.reader import open_log
from seatrial.daq.log.watchdog_note import note_path, read_note, write_note
from tests.bench.runs import AT_ONCE_S, acquisition_of, is_alive, kinds, running, short_mission, watchdog_of
from tests.bench.standin import SLOW_ESC_S, StandIn, until


def looks(watch: HeartbeatMonitor, t: float, seconds: float, words: bytes = b"") -> tuple[float, str | None]:
    """Poll every POLL_S for `seconds`. Return the time at which the watchdog has to act, and the reason."""
    end = t + seconds
    while t < end:
        t += POLL_S
        found = watch.look(t, words)
        if found is not None:
            return t, found
    return t, None


def test_silence_is_a_reason_only_while_thrust_is_commanded() -> None:
    watch = HeartbeatMonitor(0.0)
    assert looks(watch, 0.0, 10.0)[1] is None
    assert watch.look(10.03, IDLE) is None
    t, _ = looks(watch, 10.03, 10.0)
    assert watch.look(t, IDLE + ACTIVE) is None
    at, reason = looks(watch, t, 10.0)
    assert at - t == pytest.approx(HANG_S, abs=2 * POLL_S)
    assert reason is not None
    assert "no sign of life" in reason


def test_a_pause_of_the_watchdog_process_does_not_count_as_silence() -> None:
    watch = HeartbeatMonitor(0.0)
    assert watch.look(0.0, ACTIVE) is None
    assert watch.look(5.0, b"") is None
    assert looks(watch, 5.0, HANG_S / 2)[1] is None


def test_on_a_slow_machine_a_hang_is_found_late_but_found() -> None:
    watch = HeartbeatMonitor(0.0)
    assert watch.look(0.0, ACTIVE) is None
    looks_at = (0.07 * k for k in range(1, 100))
    t = next(t for t in looks_at if watch.look(t, b""))
    assert HANG_S < t < 4.0 * HANG_S


def test_a_closed_socket_is_a_reason_unless_announced_or_at_zero_thrust() -> None:
    assert HeartbeatMonitor(0.0).look(0.0, None) == ""
    moving = HeartbeatMonitor(0.0)
    assert moving.look(0.0, ACTIVE) is None
    assert "died" in str(moving.look(0.02, None))
    leaving = HeartbeatMonitor(0.0)
    assert leaving.look(0.0, ACTIVE + IDLE + FINISHED) == ""


def test_the_watchdog_imports_only_the_modules_for_sending_zero() -> None:
    program = "import sys, seatrial.daq.acquisition.watchdog; from seatrial.daq.log import write_note; "
    program += "print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert not {"numpy", "mcap", "zstandard", "pymavlink", "can"} & set(done.stdout.split())


@pytest.mark.parametrize("failure", ["acquisition hangs", "acquisition killed", "both killed"])
def test_after_a_hang_or_death_zero_is_sent_long_before_the_esc_timeout(tmp_path: Path, failure: str) -> None:
    short_mission(tmp_path, seconds=60.0)
    with StandIn(tmp_path, 4.0, timeout_s=SLOW_ESC_S) as standin, running(tmp_path) as run:
        run.until_turning(standin)
        acquisition = acquisition_of(run.process.pid)
        begun = time.monotonic()
        os.kill(acquisition, signal.SIGSTOP if failure == "acquisition hangs" else signal.SIGKILL)
        # killed after the acquisition, because it would end by itself when its parent is gone
        if failure == "both killed":
            run.process.kill()
        until(lambda: standin.n == 0.0, 10.0)
        took = standin.zero_after(begun) - begun
        assert took < (HANG_S if failure == "acquisition hangs" else 0.0) + AT_ONCE_S
        assert standin.commands[-1][1] == 0.0  # it received zero and did not time out
        status = run.end()
        until(lambda: not is_alive(acquisition), 10.0)
        until(lambda: "zero thrust was sent" in read_note(run.log), 10.0)
        assert standin.n == 0.0
    if failure != "both killed":
        assert status in (1, 3)
        assert "watchdog" in run.line() or "has not answered" in run.line()
    log = open_log(run.log)
    assert any("watchdog: the acquisition process" in warning for warning in log.warnings)


def test_a_note_that_cannot_be_written_does_not_keep_thrust_on(tmp_path: Path) -> None:
    short_mission(tmp_path, seconds=60.0)
    with StandIn(tmp_path, 4.0, timeout_s=SLOW_ESC_S) as standin, running(tmp_path) as run:
        run.until_turning(standin)
        os.mkfifo(note_path(run.log))  # opening a FIFO blocks until it has a reader, as a write to a disk can block
        watchdog = watchdog_of(run.process.pid)
        begun = time.monotonic()
        os.kill(acquisition_of(run.process.pid), signal.SIGKILL)
        until(lambda: standin.n == 0.0, 10.0)
        assert standin.zero_after(begun) - begun < AT_ONCE_S
        run.end()
        until(lambda: not is_alive(watchdog), 10.0)


def test_a_note_is_not_written_through_a_link(tmp_path: Path) -> None:
    log, foreign_file = tmp_path / "run.mcap", tmp_path / "other.txt"
    foreign_file.write_text("somebody else's")
    note_path(log).symlink_to(foreign_file)
    write_note(log, "the acquisition process died")
    assert foreign_file.read_text() == "somebody else's"


def test_a_run_ends_if_its_watchdog_dies(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path, seconds=60.0)
    with running(tmp_path) as run:
        run.until_turning(standin)
        begun = time.monotonic()
        os.kill(watchdog_of(run.process.pid), signal.SIGKILL)
        until(lambda: standin.n == 0.0, 10.0)
        assert standin.zero_after(begun) - begun < AT_ONCE_S
        assert run.end() == 3
    assert run.line().startswith("seatrial: the watchdog is gone (")
    assert "; thrust is zero" in run.line()
    assert "stop" in kinds(run.log)


def test_a_run_ends_if_its_watchdog_hangs(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path, seconds=60.0)
    with running(tmp_path, impatient=True) as run:
        run.until_turning(standin)
        watchdog = watchdog_of(run.process.pid)
        begun = time.monotonic()
        os.kill(watchdog, signal.SIGSTOP)
        until(lambda: standin.n == 0.0, 10.0)
        assert standin.zero_after(begun) - begun < ANSWER_S + AT_ONCE_S
        assert run.end() == 3
        assert not is_alive(watchdog)
    assert run.line().startswith(
        f"seatrial: the watchdog has not answered for {ANSWER_S:g} s: the computer is too busy"
    )
    assert "; thrust is zero" in run.line()


def test_a_run_that_ends_well_leaves_no_note_and_no_process(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path, seconds=1.0)
    with running(tmp_path) as run:
        run.until_turning(standin)
        watchdog = watchdog_of(run.process.pid)
        assert run.end() == 0
        assert not is_alive(watchdog)
    assert read_note(run.log) == ""
    assert not open_log(run.log).warnings
