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


def two_rates(slow: float, noise: float = 0.02, antenna: tuple[float, float] = (-1.0, 0.5)) -> dict[str, Channel]:
    """Return the track of a craft in a circle, by one receiver at 5 Hz and one at `slow` Hz with another antenna."""
    t = np.append(T, np.arange(0.03, 120.0, 1.0 / slow))
    second = np.arange(t.size) >= T.size
    t, psi = t + 0.005 * RNG.uniform(size=t.size), 0.1 * t
    ahead, right = antenna[0] * second, antenna[1] * second
    x = 15.0 * np.sin(psi) + ahead * np.cos(psi) - right * np.sin(psi) + noise * RNG.standard_normal(t.size)
    y = -15.0 * np.cos(psi) + ahead * np.sin(psi) + right * np.cos(psi) + noise * RNG.standard_normal(t.size)
    order = np.argsort(t)
    return {"x": Channel(t[order], x[order], "m"), "y": Channel(t[order], y[order], "m")}


@pytest.mark.parametrize("slow", [0.5, 1.0, 2.0, 4.0])
def test_two_receivers_of_unequal_rate_are_a_fault(slow: float) -> None:
    """Only receivers of equal rate were found."""
    (found,) = check_alternating(two_rates(slow))
    assert (found.code, found.level, found.where) == ("two-sensors", "fault", "x, y")
    assert "1.1 m beside the others: two receivers of unequal rate" in found.text


@pytest.mark.parametrize("noise", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("factor", [3, 4, 5])
def test_a_resampled_track_is_not_two_receivers(factor: int, noise: float) -> None:
    """The fixes between two measured ones lie on the chord, at regular times beside the track."""
    t = np.arange(0.0, 119.0, 0.2 / factor)
    c = {name: Channel(t, np.interp(t, T, x.value), "m") for name, x in track(noise=noise).items()}
    assert not list(check_alternating(c))


@pytest.mark.parametrize("period", [3, 5, 10])
def test_epochs_that_are_received_late_are_not_two_receivers(period: int) -> None:
    t = np.arange(0.0, 120.0, 0.1)
    x, y = 1.5 * t + 0.005 * RNG.standard_normal(t.size), 0.005 * RNG.standard_normal(t.size)
    received = t + np.where(np.arange(t.size) % period == 0, 0.08, 0.0)
    assert not list(check_alternating({"x": Channel(received, x, "m"), "y": Channel(received, y, "m")}))


@pytest.mark.parametrize("noise", [0.02, 0.4])
def test_a_coarse_position_is_not_two_receivers(noise: float) -> None:
    c = track(noise=noise)
    coarse = {name: Channel(T, np.round(0.02 * T + x.value / 15.0), "m") for name, x in c.items()}
    assert not list(check_alternating(coarse))


def test_a_track_that_leaves_its_place_for_some_seconds_is_not_two_receivers() -> None:
    """The displaced fixes have regular times, but they follow each other."""
    away = np.where(np.arange(T.size) % 96 >= 81, 9.0, 0.0)
    assert not list(check_alternating(track(offset=away, noise=0.02)))
