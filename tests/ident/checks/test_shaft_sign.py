"""Tests of shaft speeds that are right in one direction only. They are not called a dead band or a wrong unit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from seatrial.ident.checks.log_checks import check_signals
from seatrial.ident.data import Channel
from seatrial.ident.numerics import Array
from tests.ident.checks.test_latency import ATTITUDE, SHAFTS, SIDES, VELOCITY, sailed


def shafts(reported: Callable[[Array], Array], hold: float = 4.0) -> dict[str, Channel]:
    """Return a shaft that follows steps in both directions with a lag of 0.2 s, as ``reported`` by its controller."""
    t = np.arange(0.0, 120.0, 0.05)
    levels = np.random.default_rng(3).uniform(-0.8, 0.8, 30)
    command = levels[(t // hold).astype(int)]
    n = np.zeros(t.size)
    for k in range(1, t.size):
        n[k] = n[k - 1] + 0.22 * (command[k] - n[k - 1])
    return {"n_cmd_left": Channel(t, command), "n_left": Channel(t + 1e-3, reported(n))}


@pytest.mark.parametrize(
    ("reported", "code"),
    [
        (lambda n: np.maximum(n, 0.0), "shaft-speed-one-sided"),
        (lambda n: np.minimum(n, 0.0), "shaft-speed-one-sided"),
        (np.abs, "shaft-speed-one-sided"),
        (lambda n: np.where(n < 0.0, n + 65536.0 / 3000.0, n), "shaft-speed-wrapped"),
    ],
    ids=["zero astern", "zero ahead", "magnitude", "wrapped"],
)
def test_shaft_speed_of_one_direction_is_named(reported: Callable[[Array], Array], code: str) -> None:
    findings = list(check_signals(shafts(reported), {}))
    assert [f.code for f in findings if f.level == "fault"] == [code]
    assert not {f.code for f in findings} & {"dead-band-wide", "dead-band-narrow", "n-out-of-range"}


def test_wrapped_integer_speed_is_not_stuck() -> None:
    """Near its maximum, in whole rev/min, the value is constant for seconds while the command is in reverse."""
    c = shafts(lambda n: np.mod(np.trunc(3000.0 * n), 65536.0) / 3000.0, hold=8.0)
    assert [f.code for f in check_signals(c, {}) if f.level == "fault"] == ["shaft-speed-wrapped"]


def test_shaft_speed_of_both_directions_gives_no_finding() -> None:
    assert not [f for f in check_signals(shafts(lambda n: n), {}) if f.check == "sign"]


def test_shaft_speed_in_percent_is_not_called_wrapped() -> None:
    codes = {f.code for f in check_signals(shafts(lambda n: 100.0 * n), {})}
    assert "n-out-of-range" in codes
    assert "shaft-speed-wrapped" not in codes


def test_wrapped_gyro_is_named_and_not_a_wrong_unit() -> None:
    t = np.arange(0.0, 60.0, 0.05)
    rate = 0.4 * np.sin(0.3 * t) + 0.004 * np.random.default_rng(2).standard_normal(t.size)
    read = np.mod(np.trunc(1e3 * rate), 65536.0) / 1e3  # The value in mrad/s is read as an unsigned number.
    c = {"psi": Channel(t, -(0.4 / 0.3) * np.cos(0.3 * t), "rad"), "r": Channel(t, read, "rad/s")}
    faults = [f for f in check_signals(c, {}) if f.level == "fault"]
    assert [f.code for f in faults] == ["gyro-wrapped"]
    assert not [f for f in check_signals({**c, "r": Channel(t, rate, "rad/s")}, {}) if f.level == "fault"]


def test_wrapped_inputs_are_not_called_reversed_thrusters() -> None:
    own = sailed(1)
    c = {name: own[name] for name in (*ATTITUDE, *VELOCITY, *SHAFTS)}
    for name in SHAFTS:
        value = np.where(c[name].value < -0.01, c[name].value + 65536.0 / 3000.0, c[name].value)
        c[name] = replace(c[name], value=value)
    faults = [f.code for f in check_signals(c, SIDES) if f.level == "fault"]
    assert faults == ["shaft-speed-wrapped", "shaft-speed-wrapped"]
