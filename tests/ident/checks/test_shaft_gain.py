"""Tests of the change of the shaft speed at equal commands, within a log and between logs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import seatrial as st
from seatrial.daq.log import open_log
from seatrial.ident.checks import log_checks
from seatrial.ident.checks.shaft_gain import (
    check_shaft_gain,
    compare_shaft_gains,
    followed_command,
    held_of_thrusters,
)
from seatrial.ident.data.record import Channel
from tests.measured.data import import_boat, realistic_boats
from tests.missions import boat_log, boat_with

HOLD, RATE = 6.0, 10.0
DEAD, SAG = 0.04, 0.05


def log_of(seed: int, gain: Any = 1.0, n_held: int = 24, noise: float = 0.005) -> dict[str, Channel]:
    """Return command and speed of the left shaft, with a dead zone and sag; ``gain`` is a factor or a slope of time."""
    rng = np.random.default_rng(seed)
    level = rng.uniform(0.25, 1.0, n_held) * rng.choice([-1.0, 1.0], n_held)
    command = np.repeat(level, round(HOLD * RATE))
    t = np.arange(command.size) / RATE
    factor = gain(t / t[-1]) if callable(gain) else gain
    n = factor * np.sign(command) * (np.abs(command) - DEAD) * (1.0 - SAG * command**2)
    return {
        "n_cmd_left": Channel(t, command),
        "n_left": Channel(t + 0.01, n + noise * rng.standard_normal(t.size)),
    }


@pytest.mark.parametrize("lost", [0.0, 0.15])
def test_shaft_that_slows_down_within_a_log_is_named(lost: float) -> None:
    found = list(check_shaft_gain(log_of(0, lambda part: 1.0 - lost * part)))
    assert [(f.level, f.code, f.where) for f in found] == [("warning", "shaft-speed-drifts", "left")] * bool(lost)
    if lost:
        # The thirds have their middle at 1/6 and 5/6.
        change = float(found[0].text.split("equal commands is ")[1].split(" %")[0])
        assert change == pytest.approx(100 * lost * (4 / 6) / (1 - lost / 6), abs=1.5)
        assert " lower than in the first" in found[0].text


@pytest.mark.parametrize(
    ("right", "words"),
    [
        (0.14, "all shafts changed alike, which points to their supply: look at the voltage of the battery; a model"),
        (0.0, "only this shaft changed, so the cause is hardly the battery: look for weed"),
        (None, "look at the voltage of the battery, and for weed or a slipping propeller; a model"),
    ],
)
def test_shafts_that_slow_down_alike_point_to_the_battery(right: float | None, words: str) -> None:
    channels = log_of(0, lambda part: 1.0 - 0.15 * part)
    logs = [("a", log_of(1)), ("b", log_of(2, 0.85))]
    if right is not None:
        other = log_of(3, lambda part: 1.0 - right * part)
        channels |= {name.replace("left", "right"): channel for name, channel in other.items()}
        for (_, c), seed, gain in zip(logs, (4, 5), (1.0, 1.0 - right), strict=True):
            c |= {name.replace("left", "right"): channel for name, channel in log_of(seed, gain).items()}
    found = [f for f in check_shaft_gain(channels) if f.where == "left"]
    found += [f for _, f in compare_shaft_gains([(n, held_of_thrusters(c)) for n, c in logs]) if f.where == "left"]
    assert len(found) == 2
    for finding in found:
        assert finding.advice.startswith(words)


def test_log_that_differs_most_from_the_first_is_named() -> None:
    logs = [("a", log_of(1)), ("b", log_of(2, 0.95)), ("c", log_of(3, 0.88)), ("d", log_of(4, 0.99))]
    ((log, finding),) = compare_shaft_gains([(name, held_of_thrusters(c)) for name, c in logs])
    assert (log, finding.code, finding.where) == ("c", "shaft-speed-differs", "left")
    assert finding.text.startswith("the shaft speed at equal commands is 1")
    assert finding.text.endswith("lower than in a")
    assert float(finding.text.split("commands is ")[1].split(" %")[0]) == pytest.approx(12.0, abs=0.7)


def test_equal_shafts_with_other_commands_give_no_finding() -> None:
    """Dead zone and sag change the ratio with the size of the command, so that its mean differs between logs."""
    for seed in range(60):
        slow, fast = log_of(seed), log_of(100 + seed)
        assert compare_shaft_gains([("slow", held_of_thrusters(slow)), ("fast", held_of_thrusters(fast))]) == []
        assert list(check_shaft_gain(log_of(200 + seed))) == []


def test_noise_and_few_commands_claim_nothing() -> None:
    assert list(check_shaft_gain(log_of(0, lambda part: 1.0 - 0.15 * part, n_held=8))) == []
    copied = log_of(0, lambda part: 1.0 - 0.15 * part)
    copied["n_left"] = Channel(copied["n_cmd_left"].t, copied["n_left"].value)
    assert list(check_shaft_gain(copied)) == []  # the shaft speed is a copy of the command
    del copied["n_left"]
    assert list(check_shaft_gain(copied)) == []


def test_logs_are_compared_without_reading_them_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for run in (1, 2):
        boat_log(tmp_path / f"run{run}.mcap", boat_with(None, 3), 60.0, 100 + run, run)
    read: list[Path] = []

    def counted(path: Path) -> Any:
        read.append(path)
        return open_log(path)

    monkeypatch.setattr(log_checks, "open_log", counted)
    checks = log_checks.LogChecks()
    for path in (logs := [tmp_path / "run1.mcap", tmp_path / "run2.mcap"]):
        checks.check(path)
    assert checks.differences() == []
    assert read == logs


@pytest.mark.pages
@pytest.mark.skipif(not realistic_boats().is_dir(), reason="SEATRIAL_DATA has no boats of a realistic plant")
@pytest.mark.usefixtures("quick_compilation")
def test_battery_of_a_realistic_boat_is_found_by_check_and_fit(tmp_path: Path) -> None:
    """The voltage of this boat falls by 4.8 % of the full one from run to run."""
    import_boat("asv12-none", ["run1", "run3"], tmp_path)
    logs = [tmp_path / "run1.mcap", tmp_path / "run3.mcap"]
    found = [f for f in st.check(logs).warnings if f.code == "shaft-speed-differs"]
    assert [f.where for f in found] == ["run3: left", "run3: right"]
    for finding in found:
        change = float(finding.text.split("commands is ")[1].split(" %")[0])
        assert change == pytest.approx(2 * 4.78, abs=1.2)
        assert finding.text.endswith("lower than in run1")
    assert [f for f in st.check(logs[0]).warnings if f.code.startswith("shaft-speed-d")] == []
    # A model that the shaft speeds drive is right whatever the commands were.
    how: dict[str, Any] = {"rate": 5.0, "score_tests": False, "reml": False, "mean_order": 1}  # a quick fit
    for model, n_named in (("horizontal:command", 1), ("horizontal:shaft", 0)):
        with pytest.warns(st.SeatrialWarning) as caught:
            st.fit(logs[0], validate=logs[1], model=model, **how)
        named = [w for w in caught if "run3.mcap: left: the shaft speed at equal commands is" in str(w.message)]
        assert len(named) == n_named


LEVELS = (0.2, 0.35, 0.5, 0.65, 0.8, 1.0, -0.5, -0.3, 0.45, 0.95, 0.7)


def held_log(limit: float = 2.0, dead: float = 0.0, noise: float = 0.003, sides: tuple[str, ...] = ("left", "right"),
             levels: tuple[float, ...] = LEVELS) -> dict[str, Channel]:  # fmt: skip
    """Return commands and shaft speeds of both thrusters, with a limit and a dead zone; ``sides`` are measured."""
    rng, found = np.random.default_rng(1), {}
    command = np.repeat(levels, round(HOLD * RATE))
    t = np.arange(command.size) / RATE
    n = np.sign(command) * np.clip(np.abs(command) - dead, 0.0, limit)
    for side in ("left", "right"):
        found[f"n_cmd_{side}"] = Channel(t, command)
        if side in sides:
            found[f"n_{side}"] = Channel(t + 0.01, n + noise * rng.standard_normal(t.size))
    return found


@pytest.mark.parametrize(
    ("log", "largest"),
    [
        (held_log(), 1.0),
        (held_log(dead=0.08), 1.0),
        (held_log(levels=tuple(0.8 * x for x in LEVELS)), 0.8),
        *((held_log(limit), None) for limit in (0.1, 0.3, 0.5, 0.75, 0.9, 0.95)),
        (held_log(0.85, dead=0.08), None),
        (held_log(sides=("left",)), None),  # nothing is known of the right shaft
        (held_log(noise=0.0), None),  # the speed is a copy of the command
        (held_log(levels=(0.5, 1.0, 0.3)), None),  # too few held commands
    ],
)
def test_shaft_that_follows_its_commands_to_the_largest_has_no_limit(
    log: dict[str, Channel], largest: float | None
) -> None:
    assert followed_command([log]) == (None if largest is None else pytest.approx(largest))


def test_run_with_larger_commands_shows_the_limit() -> None:
    """The shafts of the first run follow its commands, and the commands of the second run are larger."""
    small, large = held_log(0.9, levels=tuple(0.8 * x for x in LEVELS)), held_log(0.9)
    assert followed_command([small]) == pytest.approx(0.8)
    assert followed_command([small, large]) is None
