"""Tests of the autopilot guard with statuses made by hand: outputs compared with commands, arming and disarming."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import cast

import pytest

from seatrial.bench.execution import autopilots
from seatrial.bench.execution.autopilots import Autopilots
from seatrial.bench.execution.safety_guard import (
    LASTS_S,
    OPEN_SKY,
    TOLERANCE,
    OutputCheck,
    SafetyGuard,
    Stop,
    StopCode,
)
from seatrial.bench.preflight.rig_checks import check_ports
from seatrial.daq.acquisition.session import Acquisition
from seatrial.daq.acquisition.status import Latest, PortStatus, Status
from seatrial.daq.clock import RunClock
from seatrial.daq.drivers.base import LinkStatus
from seatrial.daq.errors import SeatrialError
from seatrial.daq.protocol.mavlink import ROVER
from seatrial.daq.samples import Servo
from tests.daq.mavlink_ends import Ends, mav_rig

T = 1_763_616_000.0
LATE_S = 0.06  # delay between a command and the reported output: the loop of the autopilot and the message


def command(t: float) -> float:
    """Return the command at a time: steps, a ramp slower than any on water, and a chirp."""
    if t < 4.0:
        return 0.6 if t > 1.0 else 0.0
    return 2.0 * t - 9.0 if t < 5.0 else math.sin(2.0 * math.pi * t * t / 4.0)


def run(output: Callable[[float], float], seconds: float = 8.0, node: int = 1) -> tuple[float, str]:
    """Return the time at which the guard ended the run, and the reason; infinity and "" if it did not."""
    check = OutputCheck(replace(mav_rig().thrusters[0], node=node), 1.0)
    name = mav_rig().thrusters[0].name
    for k in range(round(seconds / 0.05)):
        t = 0.05 * k
        servo = Latest(Servo(node, 1500.0, output(t - LATE_S)), T + t - 0.02)
        latest = {("autopilot", node): servo}
        status = Status(T + t, {}, latest, {name: command(t)}, 0, "run.mcap", 1, 1, t, "", ())
        if reason := check.reason(status):
            return t, reason
    return math.inf, ""


def test_outputs_that_follow_the_command_do_not_end_the_run() -> None:
    assert run(command) == (math.inf, "")
    assert run(lambda t: command(t) + 0.9 * TOLERANCE) == (math.inf, "")


@pytest.mark.parametrize(
    "bent",
    [lambda n: 0.0, lambda n: -n, lambda n: 0.7 * n, lambda n: min(n, 0.4)],
    ids=["blocked", "reversed", "scaled", "cut off"],
)
def test_an_output_that_differs_from_the_command_ends_the_run(bent: Callable[[float], float]) -> None:
    at, reason = run(lambda t: bent(command(t)), seconds=4.0)
    assert 1.0 + LASTS_S < at < 1.0 + 0.5
    assert "puts out n" in reason


def test_a_single_wrong_output_does_not_end_the_run() -> None:
    """A command lost on the link, or an output reported in the middle of a change, must not end the run."""
    assert run(lambda t: command(t) + (0.5 if round(t / 0.05) % 8 == 0 else 0.0)) == (math.inf, "")


def test_an_unknown_output_does_not_end_the_run() -> None:
    assert run(lambda t: math.nan) == (math.inf, "")


def test_outputs_that_the_mission_does_not_command_are_watched_too() -> None:
    """With crossed channels, the commanded output rests and its neighbour pushes."""
    guard = started()
    ports, links = dict(Told(LINK).status().ports), {"autopilot": LINK}
    outputs = {("autopilot", node): Latest(Servo(node, 1500.0, n), T) for node, n in ((1, 0.0), (3, 0.3))}
    first = Status(T, ports, outputs, {"left": 0.0}, 0, "", 1, 1, 0.0, "", (), links=links)
    assert guard.step(T, first).stop is None
    late = {key: latest._replace(t=T + 0.3) for key, latest in outputs.items()}
    stop = guard.step(T + 0.3, replace(first, t=T + 0.3, latest=late, bytes=2)).stop
    assert stop is not None
    assert stop.code is StopCode.OUTPUT
    assert stop.reason.startswith("autopilot puts out n = +0.30 for thruster right, commanded +0.00")


LINK = LinkStatus(
    received=True, vehicle=ROVER, age=0.1, armed=True, mode="MANUAL", parameters_pending=False, receiver=True
)


def started(changes: int = 0) -> SafetyGuard:
    """Return the guard of a run with one autopilot, while a mission of the left thruster is under way."""
    rig = mav_rig()
    guard = SafetyGuard(replace(rig, limits=replace(rig.limits, radius_m=None)), 1.0, ("left",))
    guard.start({"autopilot": changes})
    return guard


def judged(guard: SafetyGuard, link: LinkStatus) -> Stop | None:
    """Return the stop of the guard for an autopilot in this state with its output at neutral."""
    outputs = {("autopilot", 1): Latest(Servo(1, 1500.0, 0.0), T)}
    return guard.step(T, replace(Told(link).status(), latest=outputs)).stop


class Told:
    """Acquisition whose autopilot is always in the same state. It keeps the messages that it has to log."""

    path = Path("run.mcap")

    def __init__(self, link: LinkStatus, message: str = "") -> None:
        port = PortStatus("autopilot", "mavlink", "", 25.0, 25.0, 0.01, 9, 9, 0, 0, 0, 0, 99, 0.0, 0.0, message)
        links, ports = {"autopilot": link}, {"autopilot": port}
        self._status = Status(T, ports, {}, {}, 0, "run.mcap", 1, 1, 0.0, "", (), links=links)
        self.marks: list[str] = []

    def mark(self, kind: str, text: str) -> None:
        self.marks.append(text)

    def status(self) -> Status:
        return self._status


def fit(link: LinkStatus, n_max: float = 0.0, printed: list[str] | None = None, message: str = "") -> Autopilots:
    """Return the outcome of the fitness check for a rig with one autopilot in this state, while a mission commands its
    left thruster.
    """
    acquisition = cast("Acquisition", Told(link, message))
    say: Callable[[str], None] = (lambda line: None) if printed is None else printed.append
    vehicles = Autopilots(mav_rig(), ("left",), acquisition, RunClock(1.0), time.sleep, say, n_max)
    if link.armed and link.mode == "MANUAL":
        vehicles.prepare(arm=False)
    return vehicles


@pytest.mark.parametrize(
    ("link", "code", "reason"),
    [
        (replace(LINK, age=3.2), StopCode.LINK, "autopilot: no heartbeat received for 3.2 s; check"),
        (replace(LINK, age=math.inf), StopCode.LINK, "autopilot: no heartbeat received since its port was opened"),
        (replace(LINK, age=math.nan), StopCode.LINK, "autopilot: no heartbeat received since its port was opened"),
        (replace(LINK, armed=False), StopCode.LINK, "autopilot was disarmed during the run; find out"),
        (
            replace(LINK, armed=False, alarm="critical: Leak"),
            StopCode.LINK,
            "autopilot was disarmed during the run (critical: Leak)",
        ),
        (replace(LINK, mode="HOLD"), StopCode.LINK, "autopilot changed from mode MANUAL to HOLD; find out"),
        (replace(LINK, alarm="critical: Leak"), StopCode.LINK, "autopilot reports critical: Leak; remove the cause"),
        (
            replace(LINK, other_station_frames=1),
            StopCode.RIVAL,
            "autopilot: another ground station has the same system id as seatrial (own_system_id in the rig)",
        ),
        (
            replace(LINK, changed=("FS_THR_ENABLE was changed: 1 to 0",)),
            StopCode.PARAMETER,
            "autopilot: FS_THR_ENABLE was changed: 1 to 0 during the run; set it back, and run again",
        ),
        (
            replace(LINK, changed=("A was changed: 1 to 0", "B was changed: 1 to 0", "C was changed: 2 to 0")),
            StopCode.PARAMETER,
            "autopilot: A was changed: 1 to 0 (and 2 others) during the run",
        ),
    ],
)
def test_a_state_change_by_the_autopilot_ends_the_run(link: LinkStatus, code: StopCode, reason: str) -> None:
    guard = started()
    assert judged(guard, replace(LINK, age=2.8)) is None
    stop = judged(guard, link)
    assert stop is not None
    assert stop.code is code
    assert stop.reason.startswith(reason)


def test_a_parameter_that_changed_before_its_check_does_not_end_the_run() -> None:
    link = replace(LINK, changed=("A was changed: 1 to 0", "B was changed: 1 to 0"))
    assert judged(started(2), link) is None
    stop = judged(started(1), link)
    assert stop is not None
    assert "B was changed" in stop.reason


def answered(**wrong: float) -> dict[str, float]:
    """Return the parameters of a vehicle that is set up correctly, except for the given changes."""
    return {**Ends(mav_rig()).autopilot.vehicle.parameters, **wrong}


@pytest.mark.parametrize(
    ("link", "n_max", "reason"),
    [
        (replace(LINK, received=False), 0.0, r"no heartbeat or no parameters in 0.2 s \(its port is shut\)"),
        (replace(LINK, parameters_pending=True), 0.0, "no heartbeat or no parameters in 0.2 s"),
        (replace(LINK, vehicle="PX4"), 0.0, "autopilot is PX4: only ArduPilot Rover is driven"),
        (replace(LINK, vehicle=""), 0.0, "autopilot is of an unknown kind"),
        (replace(LINK, other_station_frames=2), 0.0, "another ground station has the same system id as seatrial"),
        (LINK, 0.0, r"not driven, because \d+ parameters were not answered by the autopilot \(RC_OVERRIDE_TIME, \w+, "),
        (replace(LINK, parameters=answered(FS_ACTION=1.0)), 0.0, "1 parameter forbids to drive, yours to set: FS_ACT"),
        (replace(LINK, parameters=answered()), 0.9, "a valid test of the lost link is needed: it was never done; run"),
    ],
)  # fmt: skip
def test_an_autopilot_that_is_not_fit_to_drive_is_refused(
    link: LinkStatus, n_max: float, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(autopilots, "AWAIT_S", 0.2)
    with pytest.raises(SeatrialError, match=reason):
        fit(link, n_max, message="its port is shut").await_ready()


def test_every_wait_for_a_position_gives_the_same_advice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(autopilots, "ESTIMATOR_S", 0.1)
    with pytest.raises(SeatrialError, match=re.escape(OPEN_SKY)):
        fit(replace(LINK, parameters=answered(), ekf=0xA7), 0.0).await_ready()
    rig = mav_rig()
    rig = replace(rig, limits=replace(rig.limits, radius_m=50.0))
    status = Status(1.0, {}, {}, {}, 0, "", 1, 1, 1.0, "", ())
    (fence,) = [s for s in SafetyGuard(rig, 1.0, ("left", "right")).unwatched(status) if s.key == "radius_m"]
    assert OPEN_SKY in fence.refusal(1.0)
    port = PortStatus("autopilot", "mavlink", "", 25.0, 25.0, 0.01, 999, 999, 0, 0, 0, 0, 9999, 0.0, 0.0, "")
    status = replace(status, ports={"autopilot": port}, links={"autopilot": replace(LINK, ekf=0xA7)})
    (found,) = [f for f in check_ports(rig, status) if f.code == "estimator-not-ready"]
    assert OPEN_SKY in found.advice


def test_a_problem_that_allows_driving_is_printed_and_logged() -> None:
    printed: list[str] = []
    link = replace(LINK, parameters=answered(MOT_SLEWRATE=9.0), refused=("RAW_IMU at 50 Hz: denied",), ekf=0x33F)
    vehicles = fit(link, printed=printed)
    vehicles.await_ready()
    assert printed[1].startswith("autopilot refuses RAW_IMU at 50 Hz: denied; raise SCHED_LOOP_RATE")
    assert printed[2].startswith("autopilot IS ARMED ALREADY")
    assert vehicles.found_armed == vehicles.still_armed() == ["autopilot"]
    assert printed[0].startswith("autopilot: MOT_SLEWRATE is 9, wanted 0")
    (mark,) = cast("Told", vehicles._acquisition).marks
    assert printed[0].removeprefix(mark).startswith("; set it")


class Stubborn:
    """Acquisition whose autopilot disarms only at a given request.

    Its heartbeats are 0.1 s old. In the first second the newest heartbeat is from before the arming.
    """

    def __init__(self, obeys_at: float, beats_at: float = 0.0) -> None:
        self.obeys_at, self.asked, self.begun, self.beats_at = obeys_at, 0, time.monotonic(), beats_at

    def request(self, device: str, action: str) -> None:
        assert (device, action) == ("autopilot", "disarm")
        self.asked += 1

    def status(self) -> Status:
        since = time.monotonic() - self.begun
        age, armed = (0.1, self.asked < self.obeys_at) if since > self.beats_at else (0.9 + since, False)
        link = LinkStatus(received=True, age=age, armed=armed, mode="MANUAL")
        return Status(T, {}, {}, {}, 0, "run.mcap", 1, 1, 0.0, "", (), links={"autopilot": link})


@pytest.mark.parametrize("obeys_at", [3, math.inf])
def test_a_normal_end_repeats_the_disarm_request_and_fails_if_the_vehicle_stays_armed(
    obeys_at: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(autopilots, "ASK_S", 0.1)
    monkeypatch.setattr(autopilots, "LEAVE_S", 1.0)
    link = Stubborn(obeys_at)
    acquisition = cast("Acquisition", link)
    vehicles = Autopilots(mav_rig(), ("left",), acquisition, RunClock(1.0), lambda seconds: None, lambda line: None)
    vehicles._armed["autopilot"] = time.monotonic()
    if obeys_at < math.inf:
        vehicles.release()
        assert link.asked >= obeys_at
        assert vehicles.maybe_armed() == []
    else:
        with pytest.raises(SeatrialError, match="autopilot: disarming was not confirmed"):
            vehicles.release()
        assert link.asked > 3
        assert vehicles.maybe_armed() == ["autopilot"]


def test_a_heartbeat_from_before_the_arming_does_not_count_as_disarmed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C right after the request to arm: the last heartbeat reports disarmed, and the next one armed."""
    monkeypatch.setattr(autopilots, "LEAVE_S", 1.5)
    link = Stubborn(math.inf, beats_at=0.5)
    acquisition = cast("Acquisition", link)
    vehicles = Autopilots(mav_rig(), ("left",), acquisition, RunClock(1.0), lambda seconds: None, lambda line: None)
    vehicles._armed["autopilot"] = link.begun
    assert vehicles.maybe_armed() == ["autopilot"]
    vehicles.disarm()
    assert link.asked == 2
    assert vehicles.maybe_armed() == ["autopilot"]
