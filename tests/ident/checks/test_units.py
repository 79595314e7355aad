"""Tests of a yaw rate or a heading in degrees: the finding names the wrong unit."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.checks.sensors import Match, gyro_and_heading
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
