"""Tests of the scale of shaft speeds and commands: 1 is full speed for both."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from seatrial.ident.checks.log_checks import check_signals
from seatrial.ident.checks.shaft_sign import check_shaft_scale
from seatrial.ident.data import Channel
from seatrial.ident.numerics import Array

HOLD_S = 6.0
CODES = {"above-full-speed", "shaft-above-command", "shaft-below-command"}


def log_of(speed: Callable[[Array], Array], most: float = 1.0, scale: float = 1.0) -> dict[str, Channel]:
    """Return command and shaft speed of both sides; ``speed`` of the size of the command, which reaches ``most``."""
    rng, found = np.random.default_rng(5), {}
    for side in ("left", "right"):
        level = np.r_[most, -most, rng.uniform(0.2, most, 22) * rng.choice([-1.0, 1.0], 22)]
        command = np.repeat(level, round(10.0 * HOLD_S))
        t = 0.1 * np.arange(command.size)
        n = np.sign(command) * speed(np.abs(command)) + 0.003 * rng.standard_normal(t.size)
        found |= {f"n_cmd_{side}": Channel(t, scale * command), f"n_{side}": Channel(t + 0.01, n)}
    return found


def test_scale_of_shaft_speeds_above_full_speed_is_named() -> None:
    found = [f for f in check_signals(log_of(lambda n: 1.2 * n), {}) if f.code in CODES]
    assert [(f.level, f.code, f.where) for f in found] == [
        ("warning", "above-full-speed", f"n_{side}") for side in ("left", "right")
    ]
    assert found[0].text == "reaches 1.20, but 1 is full speed; it is 1.20 times the command at full command"
    assert found[0].advice.startswith("divide the scale of n_left in the import map by 1.20, or multiply rpm_max")


def test_without_full_command_either_scale_may_be_wrong() -> None:
    found = list(check_shaft_scale(log_of(lambda n: 1.2 * n, most=0.8)))
    assert [(f.code, f.where) for f in found] == [("shaft-above-command", f"n_{side}") for side in ("left", "right")]
    assert "divide the scale of n_left" in found[0].advice
    assert found[0].advice.endswith("if n_cmd_left is below 1 at full command, multiply its scale by 1.20 instead")


def test_scale_of_commands_above_full_command_is_named() -> None:
    found = list(check_shaft_scale(log_of(lambda n: n, scale=1.3)))
    assert [(f.code, f.where) for f in found] == [("above-full-speed", f"n_cmd_{side}") for side in ("left", "right")]
    assert found[0].advice.startswith("divide the scale of n_cmd_left in the import map by 1.30; ")


def test_scale_that_is_too_small_is_suspected_if_all_shafts_are_slow() -> None:
    """The number of 3600 was given as full speed, and the shafts reach 2900: 0.8 of the command everywhere."""
    slow = log_of(lambda n: 2900.0 / 3600.0 * n)
    (found,) = [f for f in check_signals(slow, {}) if f.code in CODES]
    assert (found.level, found.code, found.where) == ("warning", "shaft-below-command", "n_left, n_right")
    assert found.text.startswith("only 0.81 times the command at full command: ")
    assert "1 / (number at full speed)" in found.advice
    assert "low battery or a limit of the controller" in found.advice
    right = log_of(lambda n: n)
    assert not list(check_shaft_scale(slow | {"n_right": right["n_right"]}))  # one slow shaft is no wrong scale


@pytest.mark.parametrize(
    "speed",
    [
        lambda n: n,
        lambda n: 1.1 * n,
        lambda n: 0.87 * n,
        lambda n: n * (1.0 - 0.2 * n**2),
        lambda n: np.minimum(n, 0.6),
        lambda n: (n - 0.1) / 0.9,
        np.sqrt,
    ],
    ids=["exact", "10 % faster", "low battery", "sag", "limit", "dead zone", "linearised thrust"],
)
@pytest.mark.parametrize("most", [0.65, 1.0])
def test_right_scales_give_no_finding(speed: Callable[[Array], Array], most: float) -> None:
    assert not list(check_shaft_scale(log_of(speed, most)))
