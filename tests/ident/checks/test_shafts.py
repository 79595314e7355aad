"""What is said of a shaft's response, and what a log does not show of it."""

from __future__ import annotations

import numpy as np
import pytest

from ident.checks.shafts import check_shafts
from ident.data.record import Channel

RATE = 20.0  # Hz


def told_and_turned(step_at: float, seconds: float, delay: float = 0.15, first: float = 0.0) -> dict[str, Channel]:
    """One step of the command to 0.4, logged from ``first`` on, and a shaft that follows it with a lag of 0.14 s."""
    t = np.arange(0.0, seconds, 1.0 / RATE)
    since = np.clip(t - step_at - delay, 0.0, None)
    n = 0.4 * -np.expm1(-since / 0.14) + 0.002 * np.random.default_rng(2).standard_normal(t.size)
    command = Channel(t[t >= first], np.where(t >= step_at, 0.4, 0.0)[t >= first])
    return {"n_cmd_left": command, "n_left": Channel(t + 1e-3, n)}


def found(c: dict[str, Channel]) -> list[tuple[str, str, str]]:
    return [(f.level, f.code, f.text) for f in check_shafts(c)]


@pytest.mark.parametrize(
    ("step_at", "first"),
    [(0.5, 0.0), (5.0, 5.0), (12.0, 12.0), (-1.0, 0.0)],
    ids=["early", "at 5", "at 12", "constant"],
)
def test_a_command_that_does_not_change_in_the_fit_shows_no_delay(step_at: float, first: float) -> None:
    assert "delay" not in {f.check for f in check_shafts(told_and_turned(step_at, 60.0 + first, first=first))}


@pytest.mark.parametrize(
    ("delay", "level", "code"), [(0.15, "ok", "shaft-on-time"), (1.0, "fault", "shaft-late")], ids=["on time", "late"]
)
def test_one_step_shows_the_delay(delay: float, level: str, code: str) -> None:
    ((said, named, text),) = found(told_and_turned(8.0, 60.0, delay))
    assert (said, named) == (level, code)
    assert text == f"the shaft follows {delay + 0.05:.2f} s after its command"  # to the step of the grid


@pytest.mark.parametrize("seconds", [2.0, 4.0])
def test_a_log_that_is_too_short_is_no_dead_shaft(seconds: float) -> None:
    assert [code for _, code, _ in found(told_and_turned(0.5, seconds))] == ["shaft-too-short"]


def test_a_shaft_that_stands_is_dead() -> None:
    c = told_and_turned(5.0, 20.0)
    still = Channel(c["n_left"].t, np.zeros(c["n_left"].t.size))
    assert [code for _, code, _ in found(c | {"n_left": still})] == ["shaft-does-not-turn"]
