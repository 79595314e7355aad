"""Tests of two receivers whose values alternate in one signal. One sensor gives no alarm."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.checks.signals import check_alternating
from seatrial.ident.data import Channel
from seatrial.ident.numerics import Array

T = np.arange(0.0, 120.0, 0.2)
RNG = np.random.default_rng(4)


def track(late: Array | float = 0.0, offset: Array | float = 0.0, noise: float = 0.1) -> dict[str, Channel]:
    x = 15.0 * np.sin(0.1 * (T - late)) + offset + noise * RNG.standard_normal(T.size)
    y = 15.0 * np.cos(0.1 * (T - late)) + noise * RNG.standard_normal(T.size)
    return {"x": Channel(T, x, "m"), "y": Channel(T, y, "m")}


def every_second(value: float) -> Array:
    return np.where(np.arange(T.size) % 2 == 0, value, 0.0)


@pytest.mark.parametrize(
    "difference", [{"offset": every_second(2.0)}, {"late": every_second(0.5)}], ids=["place", "time"]
)
def test_two_receivers_in_one_signal_are_a_fault(difference: dict[str, Array]) -> None:
    (found,) = check_alternating(track(**difference))
    assert (found.code, found.level) == ("two-sensors", "fault")


@pytest.mark.parametrize("noise", [0.0, 0.003, 0.1, 1.0])
def test_one_receiver_gives_no_finding(noise: float) -> None:
    assert not list(check_alternating(track(noise=noise)))


def test_repeated_values_are_not_two_receivers() -> None:
    c = track()
    held = {n: Channel(T, np.repeat(x.value[::2], 2), "m") for n, x in c.items()}
    assert not list(check_alternating(held))


def test_fast_waves_are_not_two_receivers() -> None:
    """The boat rolls with a period of five samples."""
    c = {"r": Channel(T, 0.3 * np.sin(2.0 * np.pi * T) + 0.004 * RNG.standard_normal(T.size), "rad/s")}
    assert not list(check_alternating(c))
