"""Tests of a yaw rate or a heading in degrees: the finding names the wrong unit."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.checks.log_checks import check_signals
from seatrial.ident.checks.sensors import Match, gyro_and_heading
from seatrial.ident.checks.signals import check_ranges
from seatrial.ident.data import Channel
from seatrial.ident.numerics import Array

T: Array = np.array(0.1 * np.arange(400), np.float64)


def channels(psi: Array) -> dict[str, Channel]:
    rate: Array = np.gradient(psi, T)
    return {"psi": Channel(T, psi), "r": Channel(T, rate)}


@pytest.mark.parametrize(
    ("scale", "top", "ending"),
    [
        (57.3, 3.0, "a yaw rate in rad/s that was declared deg/s?"),
        (57.3, 300.0, "a yaw rate in rad/s that was declared deg/s, or a heading in degrees?"),
        (1.0 / 57.3, 3.0, "yaw rate in deg/s?"),
    ],
)
def test_wrong_unit_of_heading_or_gyro_is_named(scale: float, top: float, ending: str) -> None:
    """The change of heading is `scale` times the yaw rate."""
    (finding, *_) = gyro_and_heading(
        channels(np.asarray(top * np.sin(T), np.float64)), Match(scale, 0.0, 1.0, half=0.01)
    )
    assert (finding.level, finding.code) == ("fault", "angle-in-degrees")
    assert finding.text.endswith(ending)


def test_advice_on_the_scale_is_the_same_for_both_sides() -> None:
    """Speeds in rev/min have the scale of the faster side, although the slower one alone could be in per cent."""
    t = np.arange(0.0, 20.0, 0.1)
    speeds = {"n_left": Channel(t, 1000.0 * np.cos(t)), "n_right": Channel(t, 90.0 * np.cos(t))}
    found = [f for f in check_ranges(speeds) if f.code == "n-out-of-range"]
    assert [f.where for f in found] == ["n_left", "n_right"]
    (advice,) = {f.advice for f in found}
    assert advice.startswith("set scale = 0.001 for all thrusters in the import map, a guess from the largest number")
    percent = {name: Channel(t, 100.0 * np.cos(t)) for name in speeds}
    assert {f.advice for f in check_ranges(percent)} == {
        'set unit = "%" for all thrusters in the import map, or correct rpm_max in the rig file'
    }


def test_heading_in_a_wrong_unit_does_not_accuse_the_gyro() -> None:
    """Radians that were converted as if they were degrees turn 57.3 times too slowly for the right yaw rate."""
    t = 0.1 * np.arange(1200)
    psi = 0.3 * t + 0.5 * np.sin(0.4 * t)
    rate = 0.3 + 0.2 * np.cos(0.4 * t) + 0.002 * np.random.default_rng(1).standard_normal(t.size)
    read = np.radians(np.mod(psi + np.pi, 2.0 * np.pi) - np.pi)
    c = {"psi": Channel(t, read, "rad"), "r": Channel(t, rate, "rad/s")}
    faults = [f for f in check_signals(c, {}) if f.level == "fault"]
    assert [(f.code, f.where) for f in faults] == [("angle-in-degrees", "psi")]
    assert "radians were converted as if they were degrees" in faults[0].text
