"""Tests of the parts of the watchdog without processes: heartbeats over a socket, the monitor, the sender of zero on a
pty.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from seatrial.daq.acquisition import watchdog
from seatrial.daq.acquisition.ipc import (
    ACTIVE,
    ANSWER,
    FINISHED,
    IDLE,
    AcquisitionChannel,
    WatchdogConfiguration,
    WatchdogReady,
)
from seatrial.daq.acquisition.watchdog import (
    ANSWER_S,
    HANG_S,
    HEARTBEAT_S,
    POLL_S,
    FailsafeSender,
    Heartbeat,
    HeartbeatMonitor,
    _step_in,
    _watch,
)
from seatrial.daq.config.rig_file import load_rig, parse_rig
from seatrial.daq.drivers.dronecan import DronecanDriver
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log.watchdog_note import note_path, read_note
from tests.daq.ptys import TestBoat


@pytest.fixture
def beating(tmp_path: Path) -> Iterator[tuple[Heartbeat, socket.socket]]:
    """Yield the heartbeat of the acquisition, and the watchdog's end of its socket."""
    with TestBoat(tmp_path) as boat:
        rig = load_rig(boat.rig_path)
    ours, theirs = socket.socketpair()
    got: list[object] = []

    def answer() -> None:
        link = AcquisitionChannel(theirs)
        got.append(link.receive_first())
        link.send(WatchdogReady())

    thread = threading.Thread(target=answer)
    thread.start()
    heartbeat = Heartbeat(ours, rig, Path("run.mcap"))
    thread.join()
    assert got == [WatchdogConfiguration(rig.text, str(rig.path), os.getpid(), str(Path("run.mcap").absolute()))]
    theirs.setblocking(False)
    with ours, theirs:
        yield heartbeat, theirs


def words(sock: socket.socket) -> bytes:
    try:
        return sock.recv(4096)
    except BlockingIOError:
        return b""


def test_the_limits_equal_the_limits_of_the_safety_page() -> None:
    """An ESC stops after a second. The watchdog has to act earlier, but later than the pauses of a busy machine."""
    assert (HANG_S, ANSWER_S, POLL_S, HEARTBEAT_S) == (0.6, 1.0, 0.02, 0.02)
    assert (watchdog.OPEN_S, watchdog.ZERO_S, watchdog.READY_S, watchdog.READ_BYTES) == (3.0, 1.0, 20.0, 4096)


def test_a_heartbeat_reports_commanded_thrust_at_a_limited_rate(
    beating: tuple[Heartbeat, socket.socket],
) -> None:
    heartbeat, theirs = beating
    heartbeat.beat(False, 100.0)
    assert words(theirs) == IDLE
    heartbeat.beat(True, 100.0 + 0.5 * HEARTBEAT_S)
    assert words(theirs) == b""
    heartbeat.beat(True, 100.0 + 0.6 * HEARTBEAT_S, at_once=True)
    assert words(theirs) == ACTIVE
    heartbeat.beat(True, 100.0 + 1.7 * HEARTBEAT_S)
    assert words(theirs) == ACTIVE
    heartbeat.end()
    assert words(theirs) == FINISHED
    assert heartbeat.trouble == ""


def test_a_watchdog_that_does_not_answer_in_time_is_a_problem(beating: tuple[Heartbeat, socket.socket]) -> None:
    heartbeat, theirs = beating
    t = 100.0
    while not heartbeat.trouble and t < 105.0:
        t += 0.05
        heartbeat.beat(True, t)
        words(theirs)
    assert t - 100.05 == pytest.approx(ANSWER_S, abs=0.11)
    assert heartbeat.trouble.startswith(f"the watchdog has not answered for {ANSWER_S:g} s: ")


def test_a_problem_is_reported_only_if_the_watchdog_does_not_answer(
    beating: tuple[Heartbeat, socket.socket],
) -> None:
    heartbeat, theirs = beating
    for k in range(100):
        heartbeat.beat(True, 100.0 + 0.05 * k)
        if k % 10 == 0:
            theirs.send(ANSWER)
    heartbeat.beat(True, 110.0)  # this process stood still, and the answer may be in the socket
    assert heartbeat.trouble == ""
    for k in range(1, 19):
        heartbeat.beat(True, 110.0 + 0.05 * k)
    assert heartbeat.trouble == ""
    for k in range(19, 26):
        heartbeat.beat(True, 110.0 + 0.05 * k)
    assert "has not answered" in heartbeat.trouble


def test_a_closed_watchdog_is_a_problem_but_a_full_socket_is_not(
    beating: tuple[Heartbeat, socket.socket],
) -> None:
    heartbeat, theirs = beating
    for _ in range(100_000):  # until the buffer of the socket is full
        heartbeat.beat(True, 100.0, at_once=True)
        if heartbeat.trouble:
            break
    assert heartbeat.trouble == ""
    theirs.close()
    heartbeat.beat(True, 100.1, at_once=True)
    assert heartbeat.trouble.startswith("the watchdog is gone (")


def test_the_monitor_acts_in_time_to_within_one_poll() -> None:
    watch = HeartbeatMonitor(0.0)
    assert watch.look(POLL_S, ACTIVE) is None
    t = POLL_S
    while watch.look(t := t + POLL_S, b"") is None:
        assert t < 2.0 * HANG_S
    assert HANG_S < t - POLL_S <= HANG_S + 1.5 * POLL_S
    idle = HeartbeatMonitor(0.0)
    assert idle.look(POLL_S, ACTIVE + IDLE) is None  # the last message counts
    assert all(idle.look(POLL_S * k, b"") is None for k in range(2, 100))


def test_a_pause_of_the_monitor_counts_as_one_poll() -> None:
    watch = HeartbeatMonitor(0.0)
    assert watch.look(POLL_S, ACTIVE) is None
    t = 10.0
    assert watch.look(t, b"") is None
    while watch.look(t := t + POLL_S, b"") is None:
        assert t < 10.0 + 2.0 * HANG_S
    assert t - 10.0 == pytest.approx(HANG_S - POLL_S, abs=1.5 * POLL_S)
    # A poll that is late by at most three periods is no pause.
    late, t = HeartbeatMonitor(0.0), 0.0
    assert late.look(0.0, ACTIVE) is None
    while late.look(t := t + 2.9 * POLL_S, b"") is None:
        assert t < HANG_S
    assert t <= HANG_S + 2.9 * POLL_S


@pytest.mark.parametrize(
    ("sent", "closed", "reason"),
    [
        (ACTIVE, True, "the acquisition process died while thrust was commanded"),
        (IDLE, True, ""),
        (ACTIVE + FINISHED, False, ""),
        (ACTIVE, False, f"the acquisition process gave no sign of life for {HANG_S:g} s while thrust was commanded"),
    ],
)
def test_the_watch_answers_and_returns_the_reason_of_its_end(sent: bytes, closed: bool, reason: str) -> None:
    ours, theirs = socket.socketpair()
    found: list[str] = []
    thread = threading.Thread(target=lambda: found.append(_watch(theirs)))
    with ours, theirs:
        begun = time.monotonic()
        thread.start()
        ours.send(sent)
        ours.settimeout(2.0)
        if FINISHED not in sent:
            assert ours.recv(16)[:1] == ANSWER
        if closed:
            ours.close()
        thread.join(5.0)
        assert theirs.gettimeout() == 0.0  # a wake-up without a message must not end the watch
    assert found == [reason]
    took = time.monotonic() - begun
    assert took < (HANG_S if not closed and reason != "" else 0.0) + 0.3
    if "no sign of life" in reason:
        assert took > HANG_S


def test_zero_is_sent_for_its_time_and_to_every_thruster(tmp_path: Path) -> None:
    with TestBoat(tmp_path) as boat:
        rig = load_rig(boat.rig_path)
        sender = FailsafeSender(rig.device("esc"), rig)
        assert sender.name == "failsafe esc"
        assert sender.outcome == "not tried"
        begun = time.monotonic()
        sender.start()
        sender.join(10.0)
        took = time.monotonic() - begun
        commands = boat.ports["can"].commands()
    assert watchdog.ZERO_S < took < watchdog.ZERO_S + 0.5
    assert sender.outcome == "zero thrust was sent"
    assert {node for node, _ in commands} == {t.node for t in rig.thrusters if t.device == "esc"}
    assert {n for _, n in commands} == {0.0}
    assert len(commands) > 20
    assert sender._port.fileno() < 0  # the port is closed again, because the next program needs it


def test_a_port_that_cannot_be_opened_is_tried_for_a_limited_time(tmp_path: Path) -> None:
    with TestBoat(tmp_path) as boat:
        rig = load_rig(boat.rig_path)
    sender = FailsafeSender(rig.device("esc"), rig)  # the port has vanished
    begun = time.monotonic()
    sender.start()
    sender.join(10.0)
    assert watchdog.OPEN_S <= time.monotonic() - begun < watchdog.OPEN_S + 0.5
    assert "zero thrust was sent" not in sender.outcome
    assert sender.outcome != "not tried"


def test_the_modules_of_a_driver_are_imported_in_advance(tmp_path: Path) -> None:
    """An import while thrust has to end would cost a tenth of a second."""
    with TestBoat(tmp_path) as boat:
        text = boat.rig_path.read_text(encoding="utf-8").replace('protocol = "vesc"', 'protocol = "dronecan"')
        rig = parse_rig(text, boat.rig_path)
        made: list[str] = []
        with pytest.MonkeyPatch.context() as patch:
            zero = DronecanDriver.zero
            patch.setattr(DronecanDriver, "zero", lambda self, now: made.append("zero") or zero(self, now))
            sender = FailsafeSender(rig.device("esc"), rig)
        assert made == ["zero"]
        assert sender._driver is not None
        first = sender._driver
        sender.start()
        sender.join(10.0)
        assert sender._driver is not first  # the frames are made again, because an old signature would be refused
        assert sender.outcome == "zero thrust was sent"


def test_a_watchdog_that_does_not_get_ready_is_an_error_after_a_while(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with TestBoat(tmp_path) as boat:
        rig = load_rig(boat.rig_path)
    monkeypatch.setattr(watchdog, "READY_S", 0.2)
    ours, theirs = socket.socketpair()
    with ours, theirs, pytest.raises((OSError, EOFError)):
        Heartbeat(ours, rig, Path("run.mcap"))


class _Sender(FailsafeSender):
    """Sender that only records that it was started."""

    log = Path()

    def __init__(self) -> None:
        threading.Thread.__init__(self, name="failsafe esc")
        self.outcome = "not tried"

    def run(self) -> None:
        deadline = time.monotonic() + 2.0
        while not note_path(self.log).exists() and time.monotonic() < deadline:
            time.sleep(0.01)
        # The reason is written before the senders have finished, because the process may not live to write it later.
        assert "watchdog: the acquisition process" in read_note(self.log)
        self.outcome = "zero thrust was sent"


def test_a_hanging_process_is_killed_and_a_dead_one_is_not(tmp_path: Path) -> None:
    victims = [subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]) for _ in range(2)]
    reasons = ("the acquisition process gave no sign of life", "the acquisition process died")
    for victim, reason, code in zip(victims, reasons, (-signal.SIGKILL, None), strict=True):
        log = tmp_path / f"{victim.pid}.mcap"
        log.touch()
        sender = _Sender()
        sender.log = log
        _step_in(victim.pid, log, reason, [sender])
        if code is not None:
            assert victim.wait(5.0) == code
        else:
            assert victim.poll() is None  # another process may have this number by now
        note = read_note(log)
        assert f"watchdog: {reason}" in note
        assert "esc: zero thrust was sent" in note
    for victim in victims:
        victim.kill()
        victim.wait()


def test_the_watchdog_ignores_signals_and_ends_on_request(tmp_path: Path) -> None:
    with TestBoat(tmp_path) as boat:
        rig = load_rig(boat.rig_path)
    ours, theirs = socket.socketpair()
    process = start_watchdog(theirs)
    heartbeat = Heartbeat(ours, rig, tmp_path / "run.mcap")
    monitored(heartbeat, process)
    ours.close()


def monitored(heartbeat: Heartbeat, process: subprocess.Popen[bytes]) -> None:
    """Send signals to a watchdog, heartbeats for a second, and the end."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        process.send_signal(number)
    begun = time.monotonic()
    while time.monotonic() - begun < 1.0:
        heartbeat.beat(False, time.monotonic())
        time.sleep(0.01)
    assert heartbeat.trouble == ""
    assert process.poll() is None
    heartbeat.end()
    assert process.wait(5.0) == 0


def start_watchdog(end: socket.socket) -> subprocess.Popen[bytes]:
    with end:
        command = [sys.executable, "-m", "seatrial.daq.acquisition.watchdog", str(end.fileno())]
        return subprocess.Popen(command, pass_fds=[end.fileno()], start_new_session=True)


def test_the_computers_watchdog_timer_is_kept_running_and_disarmed_at_the_end(tmp_path: Path) -> None:
    timer = tmp_path / "timer"  # a file receives the bytes that a device would receive
    timer.touch()
    with TestBoat(tmp_path) as boat:
        text = boat.rig_path.read_text(encoding="utf-8")
    rig = parse_rig(text.replace("\n[", f'\nhardware_watchdog = "{timer}"\n[', 1), boat.rig_path)
    ours, theirs = socket.socketpair()
    process = start_watchdog(theirs)
    heartbeat = Heartbeat(ours, rig, tmp_path / "run.mcap")
    begun = time.monotonic()
    while time.monotonic() - begun < 1.3:
        heartbeat.beat(False, time.monotonic())
        time.sleep(0.01)
    assert set(timer.read_bytes()) == {0}  # the watchdog writes to the timer and is armed
    heartbeat.end()
    assert process.wait(5.0) == 0
    ours.close()
    written = timer.read_bytes()
    assert written[-1:] == b"V"
    assert 2 <= len(written) <= 4  # once a second


def test_a_watchdog_timer_that_cannot_be_opened_is_named_before_anything_moves(tmp_path: Path) -> None:
    with TestBoat(tmp_path) as boat:
        text = boat.rig_path.read_text(encoding="utf-8")
    rig = parse_rig(text.replace("\n[", '\nhardware_watchdog = "/nowhere/watchdog"\n[', 1), boat.rig_path)
    ours, theirs = socket.socketpair()
    process = start_watchdog(theirs)
    with ours, pytest.raises(SeatrialError, match="hardware_watchdog /nowhere/watchdog cannot be opened"):
        Heartbeat(ours, rig, tmp_path / "run.mcap")
    assert process.wait(5.0) == 0


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="needs the scheduling classes of Linux")
def test_the_watchdog_has_real_time_priority_if_the_system_permits(tmp_path: Path) -> None:
    with TestBoat(tmp_path) as boat:
        rig = load_rig(boat.rig_path)
    probe = [sys.executable, "-c", "from seatrial.daq.realtime_priority import *; set_realtime_priority(); import os;"
             "print(os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0))"]  # fmt: skip
    allowed = subprocess.run(probe, capture_output=True, text=True, check=True).stdout.split()
    ours, theirs = socket.socketpair()
    process = start_watchdog(theirs)
    heartbeat = Heartbeat(ours, rig, tmp_path / "run.mcap")
    pid = process.pid
    assert [str(os.sched_getscheduler(pid)), str(os.getpriority(os.PRIO_PROCESS, pid))] == allowed
    heartbeat.end()
    assert process.wait(5.0) == 0
    ours.close()


def test_the_watchdog_starts_without_large_modules() -> None:
    """Until it has started, a run waits for it."""
    program = "import sys; from seatrial.daq.acquisition import watchdog; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert not {"numpy", "importlib.metadata"} & set(done.stdout.split())
