"""Tests of offline runs: results, repeatability and speed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from seatrial.daq.samples import Ahrs
from seatrial.mocks.offline_simulation import simulate, simulate_bench, tables
from seatrial.mocks.plant.bench import draw_bench
from seatrial.mocks.plant.boat import draw_boat
from seatrial.mocks.sensors import geodetic
from tests.machine import cpu_seconds

T = np.arange(0.0, 20.0, 4.0)
N = np.array([[0.5, 0.5], [0.8, 0.2], [0.2, 0.8], [-0.5, -0.4], [0.0, 0.0]])


def test_a_run_can_be_repeated_and_another_run_differs_by_noise_only() -> None:
    first, again, next_run = (simulate(draw_boat(4), T, N, 20.0, run) for run in (0, 0, 1))
    assert first.readings == again.readings
    yaw = [np.array([r.sample.yaw for r in run.readings if isinstance(r.sample, Ahrs)]) for run in (first, next_run)]
    assert not np.array_equal(*yaw)
    assert draw_boat(4) == draw_boat(4)
    assert draw_boat(4).hull != draw_boat(5).hull


def test_readings_come_in_order_at_their_rates() -> None:
    readings, _ = simulate(draw_boat(1), T, N, 20.0)
    times = [r.t for r in readings]
    assert times == sorted(times)
    table = tables(readings)
    counts = {key: len(rows) for key, rows in table.items()}
    assert counts == {
        "ahrs": 1001,
        "gnss": 101,
        "esc/1/state": 501,
        "esc/2/state": 500,
        "esc/1/command": 5,
        "esc/2/command": 5,
    }
    assert np.allclose(np.diff(table["ahrs"]["t"]), 0.02)


def test_the_sensors_see_the_truth_through_their_noise() -> None:
    readings, truth = simulate(draw_boat(2), T, N, 120.0, disturbed=False)
    table = tables(readings)
    t = table["ahrs"]["t"]
    yaw_error = np.unwrap(table["ahrs"]["yaw"]) - np.interp(t, truth["t"], np.unwrap(truth["psi"]))
    yaw_error -= 2.0 * math.pi * np.round(np.median(yaw_error) / (2.0 * math.pi))
    assert float(yaw_error.std()) == pytest.approx(math.radians(0.5), rel=0.3)
    gyro_error = table["ahrs"]["r"] - np.interp(t, truth["t"], truth["r"])
    assert float(gyro_error.std()) == pytest.approx(0.01, rel=0.1)
    assert abs(float(gyro_error.mean())) < 0.012
    assert float(table["ahrs"]["az"].mean()) == pytest.approx(-9.81, abs=0.2)
    t = table["gnss"]["t"]
    place = [geodetic(*xy) for xy in zip(*(np.interp(t, truth["t"], truth[k]) for k in "xy"), strict=True)]
    north = (table["gnss"]["lat"] - np.array(place)[:, 0]) * 111_000.0
    assert float(north.std()) == pytest.approx(0.15, rel=0.2)
    assert table["gnss"]["utc"][-1] == pytest.approx(120.0)
    rpm = table["esc/1/state"]["rpm"] - 4500.0 * np.interp(table["esc/1/state"]["t"], truth["t"], truth["n_left"])
    # The shaft speed bends between the samples of the truth. At steady speed only the noise remains.
    assert float(np.median(np.abs(rpm))) < 10.0


def test_offsets_in_metres_match_the_length_of_a_degree() -> None:
    """The reference is the length of a degree at 38.766 deg on WGS 84 (published series in cosines of the latitude)."""
    lat0, lon0 = geodetic(0.0, 0.0)
    phi = math.radians(lat0)
    per_lat = 111132.92 - 559.82 * math.cos(2 * phi) + 1.175 * math.cos(4 * phi)
    per_lon = 111412.84 * math.cos(phi) - 93.5 * math.cos(3 * phi) + 0.118 * math.cos(5 * phi)
    lat, lon = geodetic(100.0, -50.0)
    assert (lat - lat0) * per_lat == pytest.approx(100.0, rel=1e-5)
    assert (lon - lon0) * per_lon == pytest.approx(-50.0, rel=1e-5)


def test_an_offline_bench_run_measures_the_thrust_curve() -> None:
    bench = draw_bench(3)
    readings, truth = simulate_bench(bench, [1.0, 11.0], [0.6, 0.0], 30.0)
    table = tables(readings)
    assert len(table["loadcell"]) == 2401
    force = (table["loadcell"]["counts"] - 84210.0) * 0.001
    pushing = (table["loadcell"]["t"] > 3.0) & (table["loadcell"]["t"] < 11.0)
    thrust = bench.thruster.c1 * 0.36 + bench.thruster.c2 * 0.36
    idle = force[table["loadcell"]["t"] < 1.0].mean()
    assert float(force[pushing].mean() - idle) == pytest.approx(thrust, abs=0.6)
    assert truth["thrust"][100] == pytest.approx(thrust, rel=1e-6)
    assert simulate_bench(bench, [1.0, 11.0], [0.6, 0.0], 30.0).readings == readings


@pytest.mark.parametrize(
    ("t", "n", "match"),
    [([0.0, 1.0], [[0.0, 0.0]], "shape|must be"), ([1.0, 0.0], [[0.0, 0.0], [0.0, 0.0]], "decrease")],
)
def test_commands_of_the_wrong_shape(t: list[float], n: list[list[float]], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        simulate(draw_boat(1), t, n, 1.0)


def test_five_minutes_take_less_than_two_seconds() -> None:
    assert cpu_seconds(lambda: simulate(draw_boat(1), T, N, 300.0), 2.0) < 2.0
