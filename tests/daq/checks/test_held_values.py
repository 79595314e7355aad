"""Tests of the detection of sample-and-hold columns among coarse sensors, boats at rest and commands."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.daq.checks.held_values import FloatArray, held_signals

SECONDS = 120.0


def motion(t: FloatArray, phase: float = 0.0) -> FloatArray:
    """Return a signal that never stands still, with values of about 1."""
    return np.asarray(np.sin(0.31 * t + phase) + 0.5 * np.sin(0.83 * t + 2.0 * phase))


def measured(t: FloatArray, seed: int, noise: float = 0.01, phase: float = 0.0) -> FloatArray:
    return motion(t, phase) + np.random.default_rng(seed).normal(0.0, noise, t.size)


def held(t: FloatArray, sensor_hz: float, seed: int, jitter: float = 0.0, phase: float = 0.0) -> FloatArray:
    """Return the last sample of a sensor at each of the times t. ``jitter`` is a fraction of the sample interval."""
    rng = np.random.default_rng(seed)
    at = np.arange(-1.0 / sensor_hz, SECONDS, 1.0 / sensor_hz)
    at = np.sort(at + rng.normal(0.0, jitter / sensor_hz, at.size))
    values = measured(at, seed, phase=phase)
    return np.asarray(values[np.maximum(np.searchsorted(at, t + 1e-9, side="right") - 1, 0)])


@pytest.mark.parametrize("jitter", [0.0, 0.1, 0.2])
@pytest.mark.parametrize(("table_hz", "sensor_hz"), [(20, 1), (20, 5), (10, 5), (50, 8), (100, 10), (10, 4), (10, 7.5)])
def test_sample_and_hold_is_found_at_any_rate(table_hz: float, sensor_hz: float, jitter: float) -> None:
    t = np.arange(0.0, SECONDS, 1.0 / table_hz)
    found = held_signals(t, {"psi": held(t, sensor_hz, 1, jitter), "r": measured(t, 2)})
    assert set(found) == {"psi"}
    assert found["psi"].rows == pytest.approx(table_hz / sensor_hz, rel=0.15)
    assert found["psi"].new.sum() == pytest.approx(SECONDS * sensor_hz, rel=0.1)


@pytest.mark.parametrize("noise", [0.0, 0.003, 0.01, 0.03])
@pytest.mark.parametrize("resolution", [0.001, 0.01, 0.1])
def test_a_coarse_sensor_is_not_taken_for_sample_and_hold(noise: float, resolution: float) -> None:
    for hz in (5.0, 20.0, 100.0):
        t = np.arange(0.0, SECONDS, 1.0 / hz)
        values = np.round(measured(t, 3, noise) / resolution) * resolution
        assert not held_signals(t, {"psi": values}), hz


def test_a_boat_at_rest_is_not_taken_for_sample_and_hold() -> None:
    t = np.arange(0.0, SECONDS, 0.1)
    moving = np.repeat(np.random.default_rng(4).random(24) > 0.5, 50)
    vx, vy = (np.where(moving, measured(t, seed), 0.0) for seed in (5, 6))
    assert not held_signals(t, {"vx": vx, "vy": vy})


def test_set_points_are_not_taken_for_sample_and_hold() -> None:
    t = np.arange(0.0, 600.0, 0.1)
    assert not held_signals(t, {"speed": np.repeat(np.random.default_rng(7).random(40), 150)})


def test_a_coarse_value_of_a_held_sensor_keeps_its_measurements() -> None:
    """A velocity in whole dm/s often repeats although the receiver has measured it again."""
    t = np.arange(0.0, SECONDS, 0.05)
    signals = {n: held(t, 2.0, 8, phase=p) for n, p in (("x", 0.0), ("y", 1.0), ("vx", 2.0), ("vy", 3.0))}
    signals["vx"], signals["vy"] = np.round(signals["vx"], 1), np.round(signals["vy"], 1)
    found = held_signals(t, signals)
    assert set(found) == set(signals)
    for name in signals:
        assert found[name].new.sum() == pytest.approx(2.0 * SECONDS, abs=2), name


def test_a_frozen_sensor_stays_visible() -> None:
    """Repeats beyond the usual number count as measurements, so that a frozen value stays visible in the log."""
    t = np.arange(0.0, SECONDS, 0.05)
    values = held(t, 2.0, 9)
    frozen = (t >= 40.0) & (t < 60.0)
    values[frozen] = values[np.argmax(frozen)]
    found = held_signals(t, {"psi": values})["psi"]
    assert np.sum(found.new & frozen) == pytest.approx(40, abs=2)


def test_sample_and_hold_of_two_receivers_with_different_rates() -> None:
    t = np.arange(0.0, SECONDS, 0.05)
    found = held_signals(t, {"x": held(t, 5.0, 10), "y": held(t, 5.0, 10, phase=1.0), "psi": held(t, 1.0, 11)})
    assert {name: round(held.rows) for name, held in found.items()} == {"x": 4, "y": 4, "psi": 20}
