"""Tests of the acquisition process on real ptys: set-points, and the end of thrust in every failure."""

from __future__ import annotations

import contextlib
import os
import random
import resource
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seatrial.daq.acquisition.device_loop import STUCK_S, DeviceLoop, source_of
from seatrial.daq.acquisition.log_thread import LogSink
from seatrial.daq.acquisition.session import Acquisition
from seatrial.daq.clock import RunClock, SuspendDetector
from seatrial.daq.config.rig_file import load_rig, parse_rig
from seatrial.daq.drivers.base import LinkRole
from seatrial.daq.drivers.factory import make_driver
from seatrial.daq.drivers.setpoints import REPEAT_S, Setpoints
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log.reader import open_log
from seatrial.daq.protocol.catalogue import make_decoder
from seatrial.daq.samples import Ahrs, Command, Gnss
from seatrial.daq.transport.factory import make_port
from tests.daq.acquiring import acquiring, assert_ends_at_zero, is_closed, living
from tests.daq.ptys import TestBoat, commands_in, wait_for


def test_set_points_are_sent_in_time_and_repeated(tmp_path: Path) -> None:
    with TestBoat(tmp_path) as boat:
        with acquiring(boat, tmp_path) as (acquisition, _, clock), living(acquisition):
            start = clock.now() + 0.3
            plan = [(start + 0.1 * k, {"left": 0.05 * k, "right": -0.05 * k}) for k in range(1, 11)]
            acquisition.schedule([*plan[:4]])
            acquisition.schedule([*plan[4:], (start + 1.2, {"left": 0.0, "right": 0.0})])
            wait_for(lambda: acquisition.status().commanded["left"] == pytest.approx(0.5))
            assert acquisition.status().commanded["right"] == pytest.approx(-0.5)
            wait_for(lambda: acquisition.status().commanded["left"] == 0.0)
        reported = boat.ports["can"].commands()
    log = open_log(tmp_path / "run.mcap")
    for node, sign in ((1, 1.0), (2, -1.0)):
        commands = log.table(Command, "esc", node=node)[: len(plan)]
        late = commands["t"] - [t for t, _ in plan]
        assert np.allclose(commands["n_cmd"], [sign * 0.05 * k for k in range(1, 11)])
        assert np.all(late >= -1e-6)
        assert np.median(late) < 0.005
    # On the wire the reversed thruster receives the opposite sign, and each set-point is repeated every 20 ms.
    assert {round(n, 5) for node, n in reported if node == 2} == {round(0.05 * k, 5) for k in range(11)}
    assert len([n for node, n in reported if node == 1 and n]) > 0.5 * 1.1 / REPEAT_S
    assert_ends_at_zero(boat)


def test_set_points_a_millisecond_of_wall_time_apart(tmp_path: Path) -> None:
    with (
        TestBoat(tmp_path, speed=20.0) as boat,
        acquiring(boat, tmp_path) as (acquisition, _, clock),
        living(acquisition),
    ):
        start = clock.now() + 4.0
        times = start + 0.04 * np.arange(500)  # 2 ms of wall time
        levels = np.random.default_rng(1).permutation(np.linspace(0.1, 0.7, 500))  # each value identifies its row
        acquisition.schedule([(float(t), {"left": float(n)}) for t, n in zip(times, levels, strict=True)])
        waited = waited_for_a_core(child_of(acquisition))
        wait_for(lambda: acquisition.status().pending == 0 and acquisition.status().t > times[-1])
        waited = waited_for_a_core(child_of(acquisition)) - waited
        skipped = acquisition.status().skipped
    log = open_log(tmp_path / "run.mcap")
    sent = log.table(Command, "esc", node=1)
    reported = sum(int(text.split()[0]) for _, kind, text in log.events() if kind == "skipped")
    # Rows that were due while the machine gave its cores to other programs may be skipped, and are reported; no other
    # rows.
    sent = sent[sent["n_cmd"] != 0.0]
    assert len(sent) + skipped == len(times)
    assert reported == skipped
    assert skipped <= 50 + waited / 0.002
    at = np.abs(levels - sent["n_cmd"][:, None]).argmin(axis=1)
    assert np.allclose(levels[at], sent["n_cmd"], atol=1e-6)
    assert np.all(np.diff(at) > 0)  # an older command never follows a newer one
    late = (sent["t"] - times[at]) / 20.0  # wall seconds
    assert np.all(late >= -1e-6)
    assert np.median(late) < 0.002


def waited_for_a_core(pid: int) -> float:
    """Return the time that the threads of a process were ready to run and had to wait [s].

    Without such statistics of the system, return the time since boot.
    """
    if not Path("/proc/self/schedstat").exists():
        return time.monotonic()
    waited = 0.0
    for path in Path(f"/proc/{pid}/task").glob("*/schedstat"):
        with contextlib.suppress(OSError):  # a thread that has ended
            waited += 1e-9 * float(path.read_text().split()[1])
    return waited


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ({"middle": 0.1}, "no thruster 'middle'"),
        ({"left": 0.9}, "-0.8 to 0.8"),
        ({"left": float("nan")}, "allows only"),
    ],
)
def test_invalid_set_points_are_refused(tmp_path: Path, row: dict[str, float], message: str) -> None:
    with TestBoat(tmp_path) as boat, acquiring(boat, tmp_path) as (acquisition, _, clock):
        with pytest.raises(SeatrialError, match=message):
            acquisition.schedule([(clock.now(), row)])
        assert acquisition.status().pending == 0


def test_zero_clears_the_schedule(tmp_path: Path) -> None:
    with TestBoat(tmp_path) as boat:
        with acquiring(boat, tmp_path) as (acquisition, _, clock), living(acquisition):
            acquisition.schedule([(clock.now(), {"left": 0.5, "right": 0.5}), (clock.now() + 60.0, {"left": 0.7})])
            wait_for(lambda: acquisition.status().commanded["left"] == 0.5)
            acquisition.zero("enough")
            wait_for(lambda: acquisition.status().commanded == {"left": 0.0, "right": 0.0})
            assert acquisition.status().pending == 0
        assert_ends_at_zero(boat)
    assert ("zero", "enough") in [(kind, text) for _, kind, text in open_log(tmp_path / "run.mcap").events()]


def test_a_runner_that_falls_silent_ends_thrust_and_the_log(tmp_path: Path) -> None:
    with TestBoat(tmp_path) as boat:
        with acquiring(boat, tmp_path) as (acquisition, _, clock):
            acquisition.schedule([(clock.now(), {"left": 0.5, "right": 0.5})])
            fell_silent = time.monotonic()
            wait_for(lambda: is_closed(tmp_path / "run.mcap"), seconds=3.0, what="the end of the log")
            with pytest.raises(SeatrialError, match="has not responded"):
                wait_for(lambda: acquisition.status().t < 0)
            with pytest.raises(SeatrialError, match="has not responded"):
                acquisition.schedule([(clock.now(), {"left": 0.5})])
        assert_ends_at_zero(boat)
        heard = boat.ports["can"].heard
        last_thrust = max(t for t, data in heard if any(n for _, n in commands_in(data)))
        assert last_thrust - fell_silent < 0.6
    log = open_log(tmp_path / "run.mcap")
    stop = next(t for t, kind, text in log.events() if kind == "stop" and "has not responded" in text)
    assert log.table(Ahrs, "ahrs")["t"][-1] - stop > 0.8  # the recording went on


def test_without_thrust_a_silent_runner_does_not_end_the_acquisition(tmp_path: Path) -> None:
    with TestBoat(tmp_path) as boat, acquiring(boat, tmp_path) as (acquisition, _, _):
        began = acquisition.status().t
        wait_for(lambda: acquisition.status().t > began + 1.0)
        assert acquisition.status().stopped == ""


PARENT = """
import sys, time
from pathlib import Path
from seatrial.daq.acquisition.device_loop import STUCK_S, DeviceLoop
from seatrial.daq.acquisition.log_thread import LogSink
from seatrial.daq.acquisition.session import Acquisition
from seatrial.daq.clock import RunClock, SuspendDetector
from seatrial.daq.config.rig_file import load_rig, parse_rig
rig = load_rig(sys.argv[1])
clock = RunClock(rig.speed)
with Acquisition(rig, Path(sys.argv[2]), clock=clock) as acquisition:
    acquisition.schedule([(clock.now(), {"left": 0.5, "right": 0.5}), (clock.now() + 600.0, {"left": 0.6})])
    while True:
        acquisition.alive()
        if acquisition.status().commanded["left"] == 0.5:
            print("thrust", flush=True)
        time.sleep(0.02)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_parent_that_is_killed_or_stopped_leaves_zero_thrust_and_a_closed_log(
    tmp_path: Path, number: signal.Signals
) -> None:
    path = tmp_path / "run.mcap"
    with TestBoat(tmp_path) as boat:
        parent = subprocess.Popen(
            [sys.executable, "-c", PARENT, str(boat.rig_path), str(path)], stdout=subprocess.PIPE, text=True
        )
        try:
            assert parent.stdout is not None
            assert parent.stdout.readline() == "thrust\n"
            wait_for(lambda: len(boat.ports["can"].commands()) > 4)
            parent.send_signal(number)
            wait_for(lambda: is_closed(path), seconds=3.0, what="the end of the log")
            assert_ends_at_zero(boat)
        finally:
            parent.kill()
            parent.communicate()
    log = open_log(path)
    assert log.warnings == []
    stop = next(t for t, kind, _ in log.events() if kind == "stop")
    assert log.table(Ahrs, "ahrs")["t"][-1] - stop > 0.8
    assert log.table(Command, "esc", node=1)["n_cmd"][-1] == 0.0


def child_of(acquisition: Acquisition) -> int:
    return acquisition._process.pid


def test_sigterm_ends_at_zero_and_closes_the_log(tmp_path: Path) -> None:
    with TestBoat(tmp_path) as boat:
        with acquiring(boat, tmp_path) as (acquisition, _, clock), living(acquisition):
            acquisition.schedule([(clock.now(), {"left": 0.5, "right": 0.5})])
            wait_for(lambda: acquisition.status().commanded["left"] == 0.5)
            os.kill(child_of(acquisition), signal.SIGINT)  # the acquisition process ignores Ctrl-C
            os.kill(child_of(acquisition), signal.SIGTERM)
            wait_for(lambda: is_closed(tmp_path / "run.mcap"), seconds=3.0)
        assert_ends_at_zero(boat)
    assert open_log(tmp_path / "run.mcap").warnings == []


def test_a_killed_acquisition_process_gives_a_one_line_error(tmp_path: Path) -> None:
    with TestBoat(tmp_path) as boat:
        rig = load_rig(boat.rig_path)
        path = tmp_path / "run.mcap"
        acquisition = Acquisition(rig, path, clock=RunClock())
        acquisition.__enter__()
        wait_for(lambda: acquisition.status().messages > 50)
        os.kill(child_of(acquisition), signal.SIGKILL)
        with pytest.raises(SeatrialError, match=r"ended by itself .*run\.mcap"):
            wait_for(lambda: acquisition.status().t < 0)
        with pytest.raises(SeatrialError, match="ended by itself"):
            acquisition.stop()
        acquisition.stop()


def test_an_acquisition_overwrites_no_log(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_text("mine")
    with TestBoat(tmp_path) as boat:
        rig = load_rig(boat.rig_path)
        with (
            pytest.raises(SeatrialError, match="never overwritten"),
            Acquisition(rig, tmp_path / "run.mcap", clock=RunClock()),
        ):
            pass
    assert (tmp_path / "run.mcap").read_text() == "mine"


def test_a_start_that_fails_leaves_no_log_and_can_be_repeated(tmp_path: Path) -> None:
    with TestBoat(tmp_path) as boat:
        good = load_rig(boat.rig_path)
        text = good.text.replace("\n[", '\nhardware_watchdog = "/nowhere/watchdog"\n[', 1)
        path = tmp_path / "logs" / "run.mcap"
        for _ in range(2):
            bad = Acquisition(parse_rig(text, boat.rig_path), path, clock=RunClock(), drive=True)
            with pytest.raises(SeatrialError, match="hardware_watchdog /nowhere/watchdog cannot be opened"), bad:
                pass
            assert os.listdir(path.parent) == []
        with Acquisition(good, path, clock=RunClock(), drive=True):
            pass
        assert is_closed(path)


def test_a_bus_lost_under_thrust_does_not_resume_thrust_when_it_returns(tmp_path: Path) -> None:
    with TestBoat(tmp_path) as boat, acquiring(boat, tmp_path) as (acquisition, _, clock), living(acquisition):
        acquisition.schedule([(clock.now(), {"left": 0.5, "right": 0.5}), (clock.now() + 60.0, {"left": 0.7})])
        wait_for(lambda: len(boat.ports["can"].commands()) > 4)
        boat.pull("can")
        wait_for(lambda: acquisition.status().stopped != "")
        assert "esc" in acquisition.status().stopped
        boat.plug("can")
        boat.ports["can"].received.clear()
        acquisition.schedule([(clock.now(), {"left": 0.6})])  # a command that was under way: not accepted
        wait_for(lambda: len(boat.ports["can"].commands()) >= 2, what="zero after the return")
        assert {n for _, n in boat.ports["can"].commands()} == {0.0}
        assert acquisition.status().pending == 0
        stopped = acquisition.status().stopped
        acquisition.zero("pause")  # a command of an operator who has not seen the loss
        acquisition.schedule([(clock.now(), {"left": 0.3})])
        seen = acquisition.status().t
        wait_for(lambda: acquisition.status().t > seen + 1.0)
        assert acquisition.status().stopped == stopped
        assert {n for _, n in boat.ports["can"].commands()} == {0.0}


def test_a_bus_that_is_lost_at_rest_ends_thrust_for_good(tmp_path: Path) -> None:
    with TestBoat(tmp_path) as boat, acquiring(boat, tmp_path) as (acquisition, _, clock), living(acquisition):
        acquisition.schedule([(clock.now(), {"left": 0.5}), (clock.now() + 0.2, {"left": 0.0})])
        wait_for(lambda: len(boat.ports["can"].commands()) > 4 and acquisition.status().commanded["left"] == 0.0)
        boat.pull("can")
        wait_for(lambda: acquisition.status().stopped != "")
        boat.plug("can")
        acquisition.schedule([(clock.now() + 0.2, {"left": 0.6})])
        seen = acquisition.status().t
        wait_for(lambda: acquisition.status().t > seen + 2.0)
        assert boat.ports["can"].commands()[-1][1] == 0.0


def test_a_log_that_cannot_grow_any_more_ends_thrust(tmp_path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    rng = random.Random(1)
    with TestBoat(tmp_path) as boat:
        rig = load_rig(boat.rig_path)
        clock = RunClock()
        # the process inherits this limit, which acts like a full disk
        resource.setrlimit(resource.RLIMIT_FSIZE, (700_000, hard))
        try:
            acquisition = Acquisition(rig, tmp_path / "run.mcap", clock=clock)
            acquisition.__enter__()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        with living(acquisition):
            acquisition.schedule([(clock.now(), {"left": 0.5, "right": 0.5})])

            def failed() -> bool:
                boat.write("ahrs", rng.randbytes(3000))
                return acquisition.status().t < 0

            with pytest.raises(SeatrialError, match=r"run\.mcap"):
                wait_for(failed, seconds=30.0)
            with pytest.raises(SeatrialError, match=r"run\.mcap"):
                acquisition.stop()
        assert_ends_at_zero(boat)
    assert len(open_log(tmp_path / "run.mcap").table(Ahrs, "ahrs")) > 10


def driving_loop(boat: TestBoat, setpoints: Setpoints, reasons: list[str]) -> DeviceLoop:
    """Return the thread of the boat's thrusters. `reasons` receives the reason for the end of thrust."""
    rig = load_rig(boat.rig_path)
    device = rig.device("esc")
    decoder = make_decoder(device, rig)
    driver = make_driver(device, rig, decoder, LinkRole.DRIVE)
    return DeviceLoop(device, make_port(device), decoder, RunClock(), LogSink(), setpoints, driver, reasons.append)


def test_after_a_pause_of_the_process_no_old_command_is_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SIGSTOP and SIGCONT of all programs: the first frame after the pause is zero."""
    with TestBoat(tmp_path) as boat:
        setpoints, reasons = Setpoints(), list[str]()
        loop = driving_loop(boat, setpoints, reasons)
        paused, wait = [0.0], loop._wait_for_bytes

        def waiting(fd: int, seconds: float) -> bool:
            found, pause = wait(fd, seconds), paused[0]
            paused[0] = 0.0
            time.sleep(pause)
            return found

        monkeypatch.setattr(loop, "_wait_for_bytes", waiting)
        loop.start()
        setpoints.append([(0.0, {1: 0.5}), (time.time() + 60.0, {1: 0.6})])
        loop.wake()
        wait_for(lambda: (1, 0.5) in boat.ports["can"].commands())
        paused[0] = 0.5 * STUCK_S  # a pause of a busy machine
        wait_for(lambda: paused[0] == 0.0)
        before = len(boat.ports["can"].commands())
        wait_for(lambda: len(boat.ports["can"].commands()) > before + 3)
        assert reasons == []
        paused[0] = 1.5 * STUCK_S
        wait_for(lambda: bool(reasons))
        loop.end()
        loop.join()
        wait_for(lambda: boat.ports["can"].commands()[-1] == (1, 0.0))
        commands = boat.ports["can"].commands()
    assert reasons[0].startswith("the acquisition process stood still for 0.")
    first_zero = commands.index((1, 0.0))
    assert set(commands[first_zero:]) == {(1, 0.0)}


def test_after_a_suspend_an_earlier_command_is_replaced_by_zero(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asleep = [0.0]
    monkeypatch.setattr(SuspendDetector, "_suspended_time", staticmethod(lambda: asleep[0]))
    with TestBoat(tmp_path) as boat:
        setpoints, reasons = Setpoints(), list[str]()
        loop = driving_loop(boat, setpoints, reasons)
        loop.start()
        setpoints.append([(0.0, {1: 0.5}), (time.time() + 60.0, {1: 0.6})])
        loop.wake()
        wait_for(lambda: (1, 0.5) in boat.ports["can"].commands())
        asleep[0] = 0.05  # the two clocks are not read at the same instant
        before = len(boat.ports["can"].commands())
        wait_for(lambda: len(boat.ports["can"].commands()) > before + 3)
        assert boat.ports["can"].commands()[-1] == (1, 0.5)
        asleep[0] = 7.0
        wait_for(lambda: boat.ports["can"].commands()[-1] == (1, 0.0))
        loop.end()
        loop.join()
        last = boat.ports["can"].commands()[-1]
    assert last == (1, 0.0)
    assert not setpoints.active
    assert [reason.partition("; ")[0] for reason in reasons] == ["the computer was suspended for 7.0 s"]


@pytest.mark.parametrize("place", ["_decode_received", "_check_suspend", "_queue_for_log"])
def test_a_pause_at_any_place_of_the_loop_ends_thrust(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    setpoints, reasons, paused = Setpoints(), list[str](), [0.0]
    with TestBoat(tmp_path) as boat:
        loop = driving_loop(boat, setpoints, reasons)
        through = getattr(loop, place)

        def pausing(*words: object) -> object:
            pause, paused[0] = paused[0], 0.0
            time.sleep(pause)
            return through(*words)

        monkeypatch.setattr(loop, place, pausing)
        loop.start()
        setpoints.append([(0.0, {1: 0.5}), (time.time() + 60.0, {1: 0.6})])
        loop.wake()
        wait_for(lambda: (1, 0.5) in boat.ports["can"].commands())
        paused[0] = 1.5 * STUCK_S
        boat.ports["can"].write(b"\r")  # the port has bytes to receive
        wait_for(lambda: bool(reasons))
        loop.end()
        loop.join()
        wait_for(lambda: boat.ports["can"].commands()[-1] == (1, 0.0))
    assert reasons[0].startswith("the acquisition process stood still for 0.")


def test_fixes_and_attitudes_of_one_port_are_both_in_the_status(tmp_path: Path) -> None:
    with TestBoat(tmp_path) as boat:
        rig = load_rig(boat.rig_path)
        for name, protocol in (("gnss", "nmea"), ("gnss", "ubx"), ("ahrs", "mip"), ("ahrs", "vectornav")):
            device = replace(rig.device(name), protocol=protocol)
            sources = [source_of(device, sample) for sample in (Gnss(0.0, 41.0, -8.0), Ahrs(0.0, 0.0, 0.0))]
            assert sources == [("gnss", None), ("gnss/ahrs", None)] or sources == [("ahrs/gnss", None), ("ahrs", None)]


def test_a_suspend_at_rest_ends_thrust_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asleep = [0.0]
    monkeypatch.setattr(SuspendDetector, "_suspended_time", staticmethod(lambda: asleep[0]))
    with TestBoat(tmp_path) as boat:
        setpoints, reasons = Setpoints(), list[str]()
        loop = driving_loop(boat, setpoints, reasons)
        loop.start()
        setpoints.append([(0.0, {1: 0.0})])
        loop.wake()
        wait_for(lambda: (1, 0.0) in boat.ports["can"].commands())
        asleep[0] = 3600.0
        wait_for(lambda: bool(reasons))
        loop.end()
        loop.join()
    assert [reason.partition("; ")[0] for reason in reasons] == ["the computer was suspended for 3600.0 s"]


def test_the_clocks_that_reveal_a_suspend_agree_without_a_suspend() -> None:
    detector = SuspendDetector()
    for _ in range(1000):
        assert detector.slept() == 0.0
