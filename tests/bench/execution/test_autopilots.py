"""What an autopilot puts out against what was commanded, on statuses made by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from bench.execution.autopilots import TOLERANCE, WINDOW_S, OutputCheck
from daq.acquisition.status import Latest, Status
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
    assert 1.0 + WINDOW_S < at < 1.0 + 2.0 * WINDOW_S + 0.3
    assert "puts out n" in reason


def test_an_output_that_is_not_known_is_no_reason() -> None:
    assert run(lambda t: math.nan) == (math.inf, "")
