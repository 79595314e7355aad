"""Tests of findings about the response of a shaft, and of its limits in short logs."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.checks.shafts import check_shafts
from seatrial.ident.data.record import Channel

RATE = 20.0  # Unit: Hz


def step_response(step_at: float, seconds: float, delay: float = 0.15, first: float = 0.0) -> dict[str, Channel]:
    """Return one step of the command to 0.4, logged from ``first`` on, and a shaft that follows with a lag of 0.14
    s.
    """
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
def test_constant_command_shows_no_delay(step_at: float, first: float) -> None:
    assert "delay" not in {f.check for f in check_shafts(step_response(step_at, 60.0 + first, first=first))}


@pytest.mark.parametrize(
    ("delay", "level", "code"), [(0.15, "ok", "shaft-on-time"), (1.0, "fault", "shaft-late")], ids=["on time", "late"]
)
def test_one_step_shows_the_delay(delay: float, level: str, code: str) -> None:
    ((found_level, named, text),) = found(step_response(8.0, 60.0, delay))
    assert (found_level, named) == (level, code)
    late = ", later than 0.6 s" if level == "fault" else ""
    # The delay is rounded to the step of the grid.
    assert text == f"the shaft follows its command after about {delay + 0.05:.2f} s (tried in steps of 0.05 s){late}"


def stairs(late_rows: int, jitter: float = 0.0, row: float = 0.05) -> dict[str, Channel]:
    """Return a table of command and shaft speed, with the command so many rows late, or up to ``jitter`` s before."""
    rng, t = np.random.default_rng(1), np.arange(0.0, 100.0, row)
    levels = rng.permutation(np.linspace(-0.9, 0.9, 19))
    starts = 5.0 * np.arange(1, 20) - jitter * rng.random(19)
    n, level = np.zeros(t.size), np.zeros(t.size)
    for k, start in enumerate(starts):
        after = t > start
        n += (levels[k] - (levels[k - 1] if k else 0.0)) * np.where(after, -np.expm1(-(t - start) / 0.17), 0.0)
        level[t >= start - 1e-9] = levels[k]
    level = np.append(np.zeros(late_rows), level[: level.size - late_rows])
    return {"n_cmd_left": Channel(t, level), "n_left": Channel(t.copy(), n + 0.002 * rng.standard_normal(t.size))}


@pytest.mark.parametrize(
    ("c", "late"),
    [(stairs(1), True), (stairs(0), False), (stairs(0, 0.05), False), (stairs(1, row=0.5), False)],
    ids=["one row late", "simultaneous", "sent between rows", "slow rows"],
)
def test_shaft_that_moves_in_the_row_of_its_command(c: dict[str, Channel], late: bool) -> None:
    (named,) = (f for f in check_shafts(c) if f.check == "delay")
    assert (named.code == "command-one-row-late") is late
    if late:
        assert "moved by 25 % of the step (median of 19 steps)" in named.text
        assert "probably one row (0.05 s) apart" in named.text
        assert "time_shift = -0.05" in named.advice
    # Telemetry with stamps of its own is no table with one row for both.
    moved = Channel(c["n_left"].t + 0.02, c["n_left"].value)
    assert "command-one-row-late" not in {f.code for f in check_shafts(c | {"n_left": moved})}


@pytest.mark.parametrize("seconds", [2.0, 4.0])
def test_short_log_is_not_called_a_dead_shaft(seconds: float) -> None:
    assert [code for _, code, _ in found(step_response(0.5, seconds))] == ["shaft-too-short"]


def test_shaft_at_rest_does_not_turn() -> None:
    c = step_response(5.0, 20.0)
    still = Channel(c["n_left"].t, np.zeros(c["n_left"].t.size))
    assert [code for _, code, _ in found(c | {"n_left": still})] == ["shaft-does-not-turn"]


def last_seconds(seconds: float, turns: bool, from_start: bool) -> dict[str, Channel]:
    """Return a log of 600 s with a command only at its end. Before that, no command or zeros were sent."""
    c = step_response(600.0 - seconds, 600.0, first=0.0 if from_start else 600.0 - seconds)
    shaft = c["n_left"]
    return c if turns else c | {"n_left": Channel(shaft.t, np.zeros(shaft.t.size))}


@pytest.mark.parametrize("from_start", [False, True], ids=["none before", "zeros before"])
@pytest.mark.parametrize("seconds", [4.5, 1.5])
def test_shaft_that_never_turns_is_found_after_one_second_of_command(seconds: float, from_start: bool) -> None:
    findings = found(last_seconds(seconds, False, from_start))
    assert [(level, code) for level, code, _ in findings] == [("fault", "shaft-does-not-turn")]
    turns = {code for _, code, _ in found(last_seconds(seconds, True, from_start))}
    assert "shaft-does-not-turn" not in turns


def test_command_of_half_a_second_is_too_short() -> None:
    ((level, code, text),) = found(last_seconds(0.5, False, False))
    assert (level, code) == ("warning", "shaft-too-short")
    assert text == "command and shaft speed overlap for too short a time to estimate the response of the shaft"


def test_shaft_that_fails_in_the_first_seconds_is_found() -> None:
    c = step_response(0.5, 60.0)
    shaft = c["n_left"]
    dead = Channel(shaft.t, np.where(shaft.t < 2.0, shaft.value, 0.0))
    assert [code for _, code, _ in found(c | {"n_left": dead})] == ["shaft-does-not-turn"]


def brief_reversal(*losses: float) -> dict[str, Channel]:
    """Return four forward speeds and a reverse command of a quarter of a second.

    The shaft is 0.3 s late with a lag of 0.14 s, so it still turns forward when the command is forward again. The speed
    is lost for half a second at each time in ``losses``.
    """
    t = np.arange(0.0, 60.0, 1.0 / RATE)
    command = np.array([0.5, 0.8, 0.3, 0.6])[(t // 15.0).astype(int)]
    command[(t >= 10.0) & (t < 10.25)] = -0.5
    n = np.zeros(t.size)
    for k in range(1, t.size):
        n[k] = n[k - 1] + (np.interp(t[k] - 0.3, t, command) - n[k - 1]) * -np.expm1(-1.0 / RATE / 0.14)
    n[np.abs(n) < 0.07] = 0.0  # The controller cannot measure slow rotation.
    lost = np.any([(t >= at) & (t < at + 0.5) for at in losses], axis=0) if losses else np.zeros(t.size, bool)
    return {"n_cmd_left": Channel(t, command), "n_left": Channel(t + 1e-3, np.where(lost, 0.0, n))}


def test_shaft_that_reverses_has_no_lost_speed() -> None:
    assert "shaft-speed-drops-out" not in {code for _, code, _ in found(brief_reversal())}


@pytest.mark.parametrize(("losses", "often"), [((35.0,), "once"), ((35.0, 40.0), "2 times")])
def test_lost_speeds_are_counted(losses: tuple[float, ...], often: str) -> None:
    (text,) = [text for _, code, text in found(brief_reversal(*losses)) if code == "shaft-speed-drops-out"]
    assert text == f"the shaft speed falls to zero {often} while the command is not zero"
