"""The simulated bench: nominal by default, and each effect as its sentence says."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mocks.bench_plant import DEMO, EFFECTS, NONE, Bench, BenchEffect, BenchPlant, draw_bench, draw_name, make_effect
from mocks.thruster import ThrusterTruth, thrust


def forces(effect: BenchEffect, n: float, seconds: float) -> np.ndarray:
    plant = BenchPlant(Bench(ThrusterTruth(), effect, 0), disturbed=False)
    plant.command(0, 0.0, n)
    out = []
    for _ in range(round(seconds / plant.step_s)):
        plant.advance()
        out.append(plant.force())
    return np.array(out)


@pytest.mark.parametrize("n", [0.7, -0.7])
def test_the_nominal_bench_shows_the_thrust_curve(n: float) -> None:
    assert forces(NONE, n, 10.0)[-1] == pytest.approx(thrust(ThrusterTruth(), n), rel=1e-9)


def test_command_reaches_the_force_by_delay_and_pole() -> None:
    force = forces(NONE, 1.0, 3.0)
    t = 0.0025 * np.arange(1, len(force) + 1)
    n = 1.0 - np.exp(-7.2115 * np.maximum(t - 0.345, 0.0))
    assert np.allclose(force, 41.16 * n * n, atol=1e-9)


def test_the_disturbance_has_its_size() -> None:
    plant = BenchPlant(draw_bench(5), run=1)
    force = []
    for _ in range(200_000):
        plant.advance()
        force.append(plant.force())
    assert float(np.std(force)) == pytest.approx(0.1, rel=0.1)


def test_the_rod_rings_at_its_frequency_and_settles_at_the_force() -> None:
    effect = make_effect("rod-flex", 1)
    force = forces(effect, 0.8, 20.0)
    assert force[-1] == pytest.approx(thrust(ThrusterTruth(), 0.8), rel=1e-3)
    ringing = force[180:1500] - forces(NONE, 0.8, 20.0)[180:1500]  # after the shaft's rise
    ups = np.flatnonzero(np.diff(np.sign(ringing)) > 0)
    assert 1.0 / (0.0025 * float(np.diff(ups).mean())) == pytest.approx(effect.flex_hz, rel=0.03)


def test_the_pool_takes_thrust_after_the_start() -> None:
    force = forces(make_effect("recirculation", 1), 0.8, 30.0)
    at_first = force[round(1.2 / 0.0025)]
    assert force[-1] < 0.96 * at_first


def test_the_cell_creeps() -> None:
    effect = make_effect("cell-drift", 1)
    force = forces(effect, 0.0, 60.0)
    assert force[-1] == pytest.approx(effect.drift, rel=1e-3)
    assert abs(force[-1]) > 0.8


def test_reverse_loss_and_sag() -> None:
    nominal = thrust(ThrusterTruth(), -0.8)
    assert forces(make_effect("reverse-loss", 1), 0.8, 5.0)[-1] == pytest.approx(thrust(ThrusterTruth(), 0.8))
    assert forces(make_effect("reverse-loss", 1), -0.8, 5.0)[-1] > 0.92 * nominal
    sag = forces(make_effect("battery-sag", 1), 0.8, 120.0)
    assert sag[-1] < 0.94 * sag[1000]


def test_draws() -> None:
    assert NONE.parameters == {}
    assert {draw_name(seed) for seed in range(50)} == set(DEMO)
    for name in EFFECTS:
        assert make_effect(name, 3) == make_effect(name, 3)
        assert all(math.isfinite(v) and v != 0.0 for v in make_effect(name, 3).parameters.values())
    c1 = [draw_bench(seed).thruster.c1 for seed in range(100)]
    assert all(abs(value / 40.05 - 1.0) <= 0.05 for value in c1)
    assert max(c1) - min(c1) > 2.0
