"""Tests of the steady-state table, of the thrust exponent and of the measured frequency response of a shaft."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.characterisation.steady_bench import measured_response, newtons_per_watt, steady_rows, thrust_expo
from seatrial.ident.data.record import Channel

RATE = 50.0


def test_rows_are_means_at_the_end_of_each_held_command() -> None:
    t = np.arange(0.0, 9.0, 1.0 / RATE)
    level = np.select([t < 3.0, t < 6.0, t < 7.0], [0.0, 0.5, 0.8], 0.2)
    rise = np.where((t >= 3.0) & (t < 4.0), 0.3, 0.0)  # the shaft is late, which is not in the mean
    command = Channel(np.array([0.0, 3.0, 6.0, 7.0]), np.array([0.0, 0.5, 0.8, 0.2]))
    channels = {"n_cmd_a": command, "n_a": Channel(t, level - rise), "force": Channel(t, 40.0 * level**2 + 0.25)}
    channels |= {"voltage": Channel(t, 16.0 - level), "power": Channel(t, 100.0 * level)}
    rows = steady_rows(channels, "n_cmd_a", "n_a", bias=0.25)
    assert [r.command for r in rows] == [0.0, 0.5, 0.2]  # 0.8 was held for one second only
    assert rows[1].n == pytest.approx(0.5)
    assert rows[1].force == pytest.approx(10.0)
    assert (rows[1].voltage, rows[1].power) == (pytest.approx(15.5), pytest.approx(50.0))
    assert np.isnan([rows[1].current, rows[1].torque]).all()


def test_long_commands_are_averaged_over_their_second_half() -> None:
    """Rows of 20 Hz with a noise of 0.5 N: means over 4 s of 8 s scatter by 0.06 N, those over 0.6 s by 0.14 N."""
    rng, t = np.random.default_rng(3), np.arange(0.0, 400.0, 0.05)
    level = np.where((t // 8.0) % 2 == 0, 0.2, 0.4)
    channels = {"n_cmd_a": Channel(t, level), "n_a": Channel(t, level)}
    rows = steady_rows(channels | {"force": Channel(t, 0.5 * rng.normal(size=t.size))}, "n_cmd_a", "n_a")
    assert len(rows) == 50
    assert np.std([r.force for r in rows]) == pytest.approx(0.5 / np.sqrt(80), rel=0.3)


def test_a_propeller_at_rest_has_no_efficiency() -> None:
    n, force = np.array([0.0, 0.5, 0.5, 0.5]), np.array([-0.08, 10.0, -10.0, 10.0])
    found = newtons_per_watt(n, force, np.array([4.0, 50.0, 40.0, 0.4]))
    assert found == pytest.approx([np.nan, 0.2, 0.25, np.nan], nan_ok=True)


@pytest.mark.parametrize("expo", [0.0, 0.65, 1.0])
def test_expo_is_that_of_the_curve(expo: float) -> None:
    command = np.array([-0.9, -0.5, 0.0, 0.3, 0.6, 0.9])
    x = command / 0.9
    force = np.where(command > 0.0, 30.0 * ((1.0 - expo) * x + expo * x * x), -5.0)
    assert thrust_expo(command, force) == pytest.approx(expo, abs=1e-9)
    assert np.isnan(thrust_expo(command[:5], force[:5]))  # two forward commands do not determine it


def test_measured_response_is_that_of_the_shaft() -> None:
    """A first-order shaft with pole 5 1/s and a dead time of 0.1 s follows random steps."""
    rng = np.random.default_rng(1)
    at = np.cumsum(rng.uniform(0.1, 1.0, 600))
    command = Channel(np.append(0.0, at), rng.uniform(-1.0, 1.0, 601))
    t = np.arange(0.0, at[-1], 0.005)
    late = command.value[np.clip(np.searchsorted(command.t, t - 0.1, side="right") - 1, 0, None)]
    n = np.zeros(t.size)
    for k in range(1, t.size):
        n[k] = late[k - 1] + (n[k - 1] - late[k - 1]) * np.exp(-5.0 * 0.005)
    f, gain, phase = measured_response(command, Channel(t[::4], n[::4]), RATE)
    low = (f > 0.1) & (f < 1.0)
    assert low.sum() > 5
    w = 2.0 * np.pi * f[low]
    np.testing.assert_allclose(gain[low], 5.0 / np.hypot(5.0, w), rtol=0.05)
    np.testing.assert_allclose(phase[low], -np.arctan2(w, 5.0) - 0.1 * w, atol=0.08)
    assert measured_response(command, Channel(t[:4000], n[:4000]), RATE)[0].size == 0  # 20 s are too short
