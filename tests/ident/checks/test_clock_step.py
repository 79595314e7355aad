"""Tests of a step of the delay of one device within a log."""

from __future__ import annotations

import re

import numpy as np
import pytest

from seatrial.ident.checks.clock_step import check_clock_step
from seatrial.ident.checks.log_checks import check_signals
from seatrial.ident.data import Channel
from tests.ident.checks.test_latency import ATTITUDE, COMMANDS, SHAFTS, SIDES, VELOCITY, log
from tests.missions import boat_with, channels_of, sail

POSITION = ("x", "y")
STEP_AT = 95.0  # s


def stepped(c: dict[str, Channel], late: tuple[str, ...], by: float, at: float = STEP_AT) -> dict[str, Channel]:
    """Return the signals with the times of ``late`` moved by ``by`` seconds from a time on; times stay in order."""
    found = dict(c)
    for name in late:
        old = c[name]
        t = old.t + by * (old.t > old.t[0] + at)
        kept = np.flatnonzero((old.t > old.t[0] + at) | (t < old.t[0] + at + min(by, 0.0)))
        found[name] = Channel(t[kept], old.value[kept], old.unit, old.source, old.hold)
    return found


@pytest.mark.parametrize("by", [1.0, -0.6])
@pytest.mark.parametrize(
    ("groups", "late", "words"),
    [
        ((ATTITUDE, POSITION), POSITION, "the positions of the GNSS come"),
        ((ATTITUDE, VELOCITY), VELOCITY, "the positions and velocities of the GNSS come"),
        ((ATTITUDE, VELOCITY), ATTITUDE, "heading and yaw rate come"),
    ],
)
@pytest.mark.parametrize("thrust", [SHAFTS, COMMANDS])
def test_step_of_a_device_is_found_with_its_time_and_size(
    thrust: tuple[str, ...], groups: tuple[tuple[str, ...], ...], late: tuple[str, ...], words: str, by: float
) -> None:
    (found,) = check_clock_step(stepped(log(*groups, thrust), late, by), SIDES)
    assert (found.level, found.code, found.where) == ("fault", "clock-step", "r" if late == ATTITUDE else late[-2])
    numbers = re.search(r"about (\d+) s of the log on, .* come (\d\.\d\d) s (later|earlier) than before", found.text)
    assert numbers is not None
    assert words in found.text
    assert abs(float(numbers[1]) - STEP_AT) <= 10.0
    assert float(numbers[2]) == pytest.approx(abs(by), abs=0.25)
    assert numbers[3] == ("later" if by > 0.0 else "earlier")
    assert "(--from, --to)" in found.advice


def test_step_of_the_thrust_is_found_by_the_yaw_rate() -> None:
    (found,) = check_clock_step(stepped(log(ATTITUDE, VELOCITY, SHAFTS), SHAFTS, 0.8), SIDES)
    assert re.search(r"heading and yaw rate come 0\.[78]\d s earlier than before, compared with the thrust", found.text)
    assert "or of the device of the thrust" in found.advice


@pytest.mark.parametrize("thrust", [COMMANDS, SHAFTS])
@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5, 6])
def test_no_step_of_sensors_in_time_or_with_one_delay(thrust: tuple[str, ...], seed: int) -> None:
    for late, by in (((), 0.0), (VELOCITY, 0.9), (ATTITUDE, 0.6), (POSITION, 0.2)):
        assert list(check_clock_step(log(ATTITUDE, VELOCITY, thrust, late=late, by=by, seed=seed), SIDES)) == []
    assert list(check_clock_step(log(ATTITUDE, POSITION, thrust, seed=seed), SIDES)) == []


@pytest.mark.parametrize("effect", [None, "payload-shift", "fouling", "growing-drag", "battery-sag", "current-drift"])
def test_no_step_of_boats_that_change_during_a_run(effect: str | None) -> None:
    c = channels_of(sail(boat_with(effect, 4), 200.0, 104)[0])
    assert list(check_clock_step(c, SIDES)) == []


def test_positions_of_1_hz_and_short_logs_claim_nothing() -> None:
    c = stepped(log(ATTITUDE, POSITION, SHAFTS), POSITION, 1.0)
    slow = c | {n: Channel(c[n].t[::5], c[n].value[::5]) for n in POSITION}
    assert list(check_clock_step(slow, SIDES)) == []
    short = {n: Channel(x.t[x.t < 130.0], x.value[x.t < 130.0], hold=x.hold) for n, x in c.items()}
    short = {n: Channel(x.t[x.t > 60.0], x.value[x.t > 60.0], hold=x.hold) for n, x in short.items()}
    assert list(check_clock_step(short, SIDES)) == []
    assert list(check_clock_step(log(ATTITUDE, POSITION), SIDES)) == []


def test_the_checks_of_a_log_report_the_step() -> None:
    found = check_signals(stepped(log(ATTITUDE, VELOCITY, SHAFTS), VELOCITY, 1.0), SIDES)
    assert [f.level for f in found if f.code == "clock-step"] == ["fault"]
