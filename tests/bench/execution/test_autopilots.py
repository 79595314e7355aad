"""What an autopilot puts out against what was commanded, and whether it disarms, on statuses made by hand."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import cast

import pytest

from bench.execution import autopilots
from bench.execution.autopilots import LASTS_S, TOLERANCE, Autopilots, OutputCheck
from daq.acquisition.session import Acquisition
from daq.acquisition.status import Latest, Status
from daq.clock import RunClock
from daq.drivers.base import LinkStatus
from daq.errors import SeatrialError
from daq.samples import Servo
from tests.daq.mavlink_ends import mav_rig

T = 1_763_616_000.0
LATE_S = 0.06  # a command, the autopilot's loop and the message about it


def command(t: float) -> float:
    """Steps, a ramp as fast as none on water, and a chirp."""
    if t < 4.0:
        return 0.6 if t > 1.0 else 0.0
    return 2.0 * t - 9.0 if t < 5.0 else math.sin(2.0 * math.pi * t * t / 4.0)


def run(output: Callable[[float], float], seconds: float = 8.0, node: int = 1) -> tuple[float, str]:
    """Time of the end and the reason; infinite and empty without."""
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


def test_outputs_that_follow_are_not_held_against_it() -> None:
    assert run(command) == (math.inf, "")
    assert run(lambda t: command(t) + 0.9 * TOLERANCE) == (math.inf, "")


@pytest.mark.parametrize(
    "bent",
    [lambda n: 0.0, lambda n: -n, lambda n: 0.7 * n, lambda n: min(n, 0.4)],
    ids=["blocked", "reversed", "scaled", "cut off"],
)
def test_an_output_that_is_not_the_command_ends_the_run(bent: Callable[[float], float]) -> None:
    at, reason = run(lambda t: bent(command(t)), seconds=4.0)
    assert 1.0 + LASTS_S < at < 1.0 + 0.5
    assert "puts out n" in reason


def test_one_wrong_output_is_no_reason() -> None:
    """A command lost on the way, or an output told in the middle of a change."""
    assert run(lambda t: command(t) + (0.5 if round(t / 0.05) % 8 == 0 else 0.0)) == (math.inf, "")


def test_an_output_that_is_not_known_is_no_reason() -> None:
    assert run(lambda t: math.nan) == (math.inf, "")


class Stubborn:
    """An acquisition with an autopilot that disarms at the request of that number; its heartbeats are 0.1 s old, but
    for the first second, when the last one came before it was armed."""

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
def test_a_normal_end_asks_to_disarm_until_it_is_and_fails_where_it_is_not(
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


def test_a_heartbeat_of_before_the_arming_says_nothing_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C right after the request to arm: the last heartbeat says disarmed, the next one armed."""
    monkeypatch.setattr(autopilots, "LEAVE_S", 1.5)
    link = Stubborn(math.inf, beats_at=0.5)
    acquisition = cast("Acquisition", link)
    vehicles = Autopilots(mav_rig(), ("left",), acquisition, RunClock(1.0), lambda seconds: None, lambda line: None)
    vehicles._armed["autopilot"] = link.begun
    assert vehicles.maybe_armed() == ["autopilot"]
    vehicles.disarm()
    assert link.asked == 2
    assert vehicles.maybe_armed() == ["autopilot"]
