"""Tests of swapped thrusters: they are found before any fit, also without a gyro, and a correct boat is never
reported.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seatrial.ident.checks.motion import check_motion, turning_signs
from seatrial.ident.data.record import Channel
from seatrial.mocks.offline_simulation import simulate
from tests.missions import boat_with, channels_of, sail

SIDES = {"left": -0.15, "right": 0.15}
Channels = dict[str, Channel]


def swapped(channels: Channels) -> Channels:
    return channels | {"n_left": channels["n_right"], "n_right": channels["n_left"]}


def as_force(channels: Channels) -> Channels:
    """Return the channels with thrusts in newtons instead of shaft speeds."""
    forces = {
        f"f_{side}": Channel(c.t, 40.0 * c.value * np.abs(c.value))
        for side in ("left", "right")
        if (c := channels[f"n_{side}"])
    }
    return {n: c for n, c in channels.items() if not n.startswith("n_")} | forces


def without_gyro(channels: Channels) -> Channels:
    return {n: c for n, c in channels.items() if n != "r"}


def faults(channels: Channels) -> list[str]:
    return [f.code for f in check_motion(channels, SIDES) if f.level == "fault"]


@pytest.fixture(scope="module")
def fleet() -> list[Channels]:
    """Return runs of six boats over two minutes, every other boat with a hidden effect, on missions of all kinds."""
    effects = ("wind", "sway-yaw", "yaw-bias", "mismatch", "cg-offset")
    kinds = ("mixed", "zigzag", "steps", "mixed", "chirp")
    found = []
    for seed in range(6):
        effect = effects[seed // 2 % 5] if seed % 2 else None
        found.append(channels_of(sail(boat_with(effect, seed), 120.0, seed, kind=kinds[seed % 5])[0]))
    return found


@pytest.fixture(scope="module")
def straight() -> list[Channels]:
    """Return runs of five boats with equal commands on both sides. Some boats have an effect that turns them."""
    effects = (None, "mismatch", None, "wind", "yaw-bias", "sway-yaw", "thruster-interaction", None, "cross-flow")
    found = []
    for seed in range(5):
        seconds = (60.0, 90.0)[seed % 2]
        t = np.arange(0.0, seconds, 4.0 + seed % 5)
        n = np.random.default_rng(seed).uniform(-1.0 if seed % 3 else 0.0, 1.0, size=t.size)
        boat = boat_with(effects[seed % len(effects)], seed)
        found.append(channels_of(simulate(boat, t, np.column_stack([n, n]), seconds, 1)))
    return found


def test_correct_boat_is_never_reported(fleet: list[Channels], straight: list[Channels]) -> None:
    for seed, channels in enumerate([*fleet, *straight]):
        for signals in (channels, without_gyro(channels), *([as_force(channels)] if seed % 5 == 0 else [])):
            assert not {"thruster-sides-swapped", "thruster-sign-reversed"} & set(faults(signals)), seed
            assert -1 not in turning_signs(signals, SIDES).values(), seed


def test_swapped_thrusters_are_found(fleet: list[Channels]) -> None:
    for boats, hidden in ((fleet, 1), ([without_gyro(c) for c in fleet], 2)):
        found = [faults(swapped(c)) == ["thruster-sides-swapped"] for c in boats]
        assert sum(found[::2]) == 3  # These boats have no hidden effect.
        assert sum(found[1::2]) >= 3 - hidden  # Within two minutes, a hidden effect may mask the swap.
    assert faults(as_force(swapped(fleet[0]))) == ["thruster-sides-swapped"]


def test_straight_runs_give_no_answer(straight: list[Channels]) -> None:
    assert sum(any(turning_signs(c, SIDES).values()) for c in straight) < 3
    for channels in straight:
        assert "thruster-sides-swapped" not in faults(swapped(channels)) or 1 in turning_signs(channels, SIDES).values()


def test_missing_or_equal_signals_give_no_answer(fleet: list[Channels]) -> None:
    without = {n: c for n, c in fleet[0].items() if n not in ("r", "psi", "x", "y")}
    assert turning_signs(without, SIDES) == {}
    assert turning_signs({n: c for n, c in fleet[0].items() if n != "n_left"}, SIDES) == {"gyro": 0, "heading": 0}
    assert set(turning_signs(fleet[0] | {"n_right": fleet[0]["n_left"]}, SIDES).values()) == {0}
    noise = Channel(fleet[0]["r"].t, np.random.default_rng(1).normal(size=fleet[0]["r"].t.size))
    assert turning_signs(fleet[0] | {"r": noise}, SIDES) == {"gyro": 0, "heading": 1}


def test_log_without_turning_information_says_why_the_sides_are_not_known(fleet: list[Channels]) -> None:
    north_only = {n: c for n, c in fleet[0].items() if n in ("x", "n_left", "n_right")}
    assert faults(north_only) == []
    together = dict.fromkeys(("n_left", "n_right"), fleet[0]["n_left"])
    short = {n: replace(s, t=s.t[s.t < 12.0], value=s.value[s.t < 12.0]) for n, s in fleet[0].items()}
    straight = fleet[0] | {
        "r": replace(fleet[0]["r"], value=np.random.default_rng(1).normal(size=fleet[0]["r"].t.size))
    }
    for c, why in (
        (north_only, "the log has no heading, yaw rate or position"),
        (fleet[0] | together, "all thrusters have the same thrust throughout"),
        (short, "thrust and motion are in the log together for less than 15 s"),
        (straight, "the thrust difference explains too little of the yaw rate"),
    ):
        (found,) = check_motion(c, SIDES)
        assert (found.level, found.code, found.where) == ("unknown", "thruster-sides-unknown", "left and right")
        assert found.text == f"it is not known whether the thrusters are on the right sides: {why}"
    assert not list(check_motion({n: fleet[0][n] for n in ("n_left", "n_right")}, SIDES))  # no motion: a bench
    assert not list(check_motion({n: s for n, s in fleet[0].items() if n[:2] != "n_"}, SIDES))


def test_advice_on_a_reversed_thruster_names_the_sign_in_the_import_map(fleet: list[Channels]) -> None:
    left = fleet[0]["n_left"]
    found = check_motion(fleet[0] | {"n_left": Channel(left.t, -left.value)}, SIDES)
    (fault,) = (f for f in found if f.code == "thruster-sign-reversed")
    assert "`reversed` in the rig file, or `sign` of the signal in the import map" in fault.advice


def spin(ratio: float, seed: int = 0) -> Channels:
    """Return a run with turns to starboard only, with thrusts in a fixed ratio, and with commands as inputs."""
    t = np.arange(0.0, 60.0, 6.0)
    ahead = np.where(np.arange(t.size) % 2, 0.6, 0.0)
    n = np.column_stack([ahead, -ratio * ahead])
    channels = channels_of(simulate(boat_with(None, seed), t, n, 60.0, seed))
    at = channels["n_left"].t
    k = np.searchsorted(t, at - at[0], side="right") - 1
    return channels | {f"n_{side}": Channel(at, n[k, j]) for j, side in enumerate(("left", "right"))}


@pytest.mark.parametrize("ratio", [0.9, 1.1])
def test_spins_to_one_side_show_the_sides(ratio: float) -> None:
    """The sum of the thrusts is in a fixed ratio to their difference, but much smaller."""
    for seed in range(2):
        (found,) = check_motion(spin(ratio, seed), SIDES)
        assert found.code == "thruster-sides-agree"
        (found,) = check_motion(swapped(spin(ratio, seed)), SIDES)
        assert found.code == "thruster-sides-swapped"


@pytest.mark.parametrize("ratio", [0.5, -0.5])
def test_turns_with_a_large_sum_of_thrusts_in_a_fixed_ratio_are_described(ratio: float) -> None:
    run = spin(ratio)
    for channels, word in ((run, "with"), (swapped(run), "against")):
        (found,) = check_motion(channels, SIDES)
        assert found.code == "thruster-sides-unknown"
        assert f"the boat turns {word} the thrust difference, which explains 9" in found.text
        assert (
            "% of the yaw rate, all to starboard; but the thrusts of both sides change in a fixed ratio" in found.text
        )
        assert "turns to both sides and straight parts" in found.advice
