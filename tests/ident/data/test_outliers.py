"""Tests of point outliers: they are left out and reported, and possible motion is kept."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.checks.log_checks import check_signals
from seatrial.ident.checks.outliers import check_outliers
from seatrial.ident.data import Channel, without_outliers
from seatrial.ident.data.gaps import slice_channel

RATE = 10.0  # Unit: Hz
T = np.arange(0.0, 120.0, 1.0 / RATE)
RNG = np.random.default_rng(5)


def craft() -> dict[str, Channel]:
    """Return a craft on a circle whose shafts reverse every 7 s with a lag of 0.25 s."""
    command = np.where(T % 14.0 < 7.0, 0.6, -0.6)
    shaft = np.zeros(T.size)
    for k in range(1, T.size):
        shaft[k] = shaft[k - 1] + (1.0 - np.exp(-1.0 / RATE / 0.25)) * (command[k] - shaft[k - 1])
    r = 0.1 + 0.005 * RNG.standard_normal(T.size)
    return {
        "x": Channel(T, 10.0 * np.sin(0.1 * T) + 0.15 * RNG.standard_normal(T.size), "m", "gnss"),
        "y": Channel(T, 10.0 - 10.0 * np.cos(0.1 * T) + 0.15 * RNG.standard_normal(T.size), "m", "gnss"),
        "vx": Channel(T, np.cos(0.1 * T) + 0.03 * RNG.standard_normal(T.size), "m/s", "gnss"),
        "vy": Channel(T, np.sin(0.1 * T) + 0.03 * RNG.standard_normal(T.size), "m/s", "gnss"),
        "psi": Channel(T, 0.1 * T + 0.01 * RNG.standard_normal(T.size), "rad", "ahrs"),
        "r": Channel(T, r, "rad/s", "ahrs"),
        "ax": Channel(T, 0.2 * RNG.standard_normal(T.size), "m/s2", "ahrs"),
        "n_left": Channel(T, shaft, "", "esc"),
        "force": Channel(T, 30.0 * shaft * np.abs(shaft) + 0.1 * RNG.standard_normal(T.size), "N", "cell"),
    }


def spoiled(name: str, rows: list[int], value: float) -> dict[str, Channel]:
    c = craft()
    values = c[name].value.copy()
    values[rows] = value
    return c | {name: Channel(T, values, c[name].unit, c[name].source)}


@pytest.mark.parametrize(
    ("name", "rows", "value"),
    [
        ("x", [500], 1000.0), ("x", [500], 1e7), ("y", [500, 501, 502], -200.0), ("vx", [500], 100.0),
        ("psi", [500], 8.2), ("r", [500], 50.0), ("r", [300, 700], -30.0), ("ax", [500], -2e38),
        ("n_left", [460], 0.1), ("n_left", [460, 461], 21.3), ("force", [460], 1000.0),
    ],
)  # fmt: skip
def test_outlier_is_left_out_and_reported(name: str, rows: list[int], value: float) -> None:
    cleaned = without_outliers(spoiled(name, rows, value))
    left_out = cleaned[name].left_out
    assert left_out is not None
    np.testing.assert_allclose(left_out.t, T[rows])
    assert np.all(left_out.value == value)
    assert cleaned[name].t.size == T.size - len(rows)
    finding = next(f for f in check_outliers(cleaned) if f.where == name)
    assert (finding.level, finding.code) == ("warning", "outliers-left-out")
    assert f"{value:.4g} at {T[rows[0]]:.2f} s" in finding.text


def test_outliers_of_one_percent_of_the_speeds_are_left_out() -> None:
    rows = np.arange(60, 1190, 93)
    c = craft()
    value = c["n_left"].value.copy()
    value[rows] = 0.0
    left_out = without_outliers(c | {"n_left": Channel(T, value, "", "esc")})["n_left"].left_out
    assert left_out is not None
    assert set(left_out.t) == set(T[rows])


def test_reversals_turns_and_noise_are_kept() -> None:
    c = craft()
    cleaned = without_outliers(c)
    assert all(cleaned[name] is c[name] for name in c)
    assert not list(check_outliers(cleaned))


def test_waves_and_impacts_that_move_the_neighbours_are_kept() -> None:
    slam = 45.0 * np.exp(-np.abs(T - 50.0) / 0.2)
    waves = Channel(T, 8.0 * np.sin(2.0 * np.pi * 1.5 * T) + slam, "m/s2", "ahrs")
    assert without_outliers({"ax": waves})["ax"] is waves


def test_short_pulses_of_a_command_are_kept() -> None:
    value = np.where(T % 10.0 < 5.0, 0.5, -0.2)
    value[[220, 470]] = 0.9
    joystick = Channel(T, value)
    assert without_outliers({"n_left": joystick})["n_left"] is joystick
    assert without_outliers({"n_cmd_left": joystick})["n_cmd_left"] is joystick


def test_positions_far_off_at_the_start_and_short_jumps_are_left_out() -> None:
    c = craft()
    x = c["x"].value.copy()
    x[:40] += 5000.0
    x[600:650] += 300.0
    cleaned = without_outliers(c | {"x": Channel(T, x, "m", "gnss")})
    left_out = cleaned["x"].left_out
    assert left_out is not None
    np.testing.assert_allclose(left_out.t, np.append(T[:40], T[600:650]))
    part = slice_channel(cleaned["x"], 10, cleaned["x"].t.size).left_out
    assert part is not None
    np.testing.assert_allclose(part.t + part.begin, T[600:650])  # a part keeps the times of its outliers
    assert np.array_equal(cleaned["x"].t, cleaned["y"].t)
    assert not [f for f in check_outliers(cleaned) if f.code == "position-jumps"]


def test_jump_without_return_is_a_fault_with_its_time() -> None:
    c = craft()
    x = c["x"].value + np.where(T > 60.05, 300.0, 0.0)
    cleaned = without_outliers(c | {"x": Channel(T, x, "m", "gnss")})
    codes = {f.code: f for f in check_signals(cleaned, {})}
    assert codes["position-jumps"].level == "fault"
    assert codes["position-jumps"].text.startswith("jumps by 30")
    assert "60.1 s" in codes["position-jumps"].text
    assert "position-and-velocity-axes" not in codes


FINE = np.arange(0.0, 60.0, 0.01)  # Times [s] of an inertial sensor at 100 Hz.


@pytest.mark.parametrize(
    ("name", "n_bad", "value"), [("r", 4, 8.0), ("r", 40, -9.0), ("ax", 5, 60.0), ("ax", 25, -80.0), ("psi", 60, 4.0)]
)
def test_long_burst_of_a_fast_sensor_is_left_out(name: str, n_bad: int, value: float) -> None:
    rng = np.random.default_rng(8)
    signal = 0.1 * np.sin(0.5 * FINE) + 0.005 * rng.standard_normal(FINE.size)
    rows = slice(3000, 3000 + n_bad)
    signal[rows] += value + 0.1 * rng.standard_normal(n_bad)
    cleaned = without_outliers({name: Channel(FINE, signal, "", "ahrs")})[name]
    assert cleaned.left_out is not None
    np.testing.assert_allclose(cleaned.left_out.t, FINE[rows])


@pytest.mark.parametrize("with_gyro", [True, False])
def test_burst_of_headings_over_seconds_is_found_only_with_a_gyro(with_gyro: bool) -> None:
    """A magnet beside the compass turns its heading by 80 degrees for 3 s."""
    c = craft()
    rows = list(range(500, 530))
    psi = c["psi"].value.copy()
    psi[rows] += 1.4
    found = {"psi": Channel(T, psi, "rad", "ahrs")} | ({"r": c["r"]} if with_gyro else {})
    left_out = without_outliers(found)["psi"].left_out
    assert (left_out is not None) == with_gyro
    if left_out is not None:
        np.testing.assert_allclose(left_out.t, T[rows])
        np.testing.assert_allclose(left_out.value, psi[rows])


def test_quick_turn_is_not_a_burst() -> None:
    """If a craft turns by 80 degrees and back, the gyro measures it."""
    rate = np.where((T >= 50.0) & (T < 51.0), 1.4, np.where((T >= 53.0) & (T < 54.0), -1.4, 0.0))
    psi = np.cumsum(rate) * 0.1
    noise = RNG.standard_normal((2, T.size))
    c = {"psi": Channel(T, psi + 0.01 * noise[0]), "r": Channel(T, rate + 0.005 * noise[1])}
    assert all(channel.left_out is None for channel in without_outliers(c).values())
