"""Tests of the simulated bench: nominal by default, and each effect as described."""

from __future__ import annotations

import math

import numpy as np
import pytest

from seatrial.mocks.hidden_effects.bench import DEMO, EFFECTS, draw_name, make_effect
from seatrial.mocks.plant.bench import Bench, BenchPlant, BenchShaft, draw_bench
from seatrial.mocks.plant.bench_effect import NONE, BenchEffect, ShaftEffect
from seatrial.mocks.plant.thruster import ThrusterTruth, thrust


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


def test_the_disturbance_has_the_specified_size() -> None:
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
    ringing = force[180:1500] - forces(NONE, 0.8, 20.0)[180:1500]  # after the rise of the shaft speed
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
    sag = forces(make_effect("supply-sag", 1), 0.8, 120.0)
    assert sag[-1] < 0.94 * sag[1000]


def shaft(effect: BenchEffect, commands: list[tuple[float, float]], seconds: float) -> np.ndarray:
    plant = BenchPlant(Bench(ThrusterTruth(delay=0.0), effect, 0), disturbed=False)
    out = []
    for command in commands:
        plant.command(0, *command)
    for _ in range(round(seconds / plant.step_s)):
        plant.advance()
        out.append(plant.shafts[0].n)
    return np.array(out)


def rise(n: np.ndarray, start: float, low: float, high: float) -> float:
    """Return the rise time from a tenth to nine tenths of the step [s]."""
    part = (n[round(start / 0.0025) :] - low) / (high - low)
    return 0.0025 * float(np.argmax(part > 0.9) - np.argmax(part > 0.1))


def test_a_shaft_without_an_effect_is_unchanged() -> None:
    plain = shaft(NONE, [(0.0, 0.8), (1.0011, -0.3)], 3.0)
    with_default_effect = BenchShaft(ThrusterTruth(delay=0.0), ShaftEffect(), 0.0025)
    with_default_effect.command(0.0, 0.8)
    with_default_effect.command(1.0011, -0.3)
    np.testing.assert_allclose([with_default_effect.advance() for _ in range(1200)], plain, atol=1e-12)


def test_the_shaft_is_late_brisk_or_limited() -> None:
    commands = [(0.0, 0.8), (3.0, 0.4)]
    up, down = ([0.0] * 3 for _ in range(2))
    for k, name in enumerate(("none", "spin-up", "second-lag")):
        n = shaft(NONE if name == "none" else make_effect(name, 1), commands, 6.0)
        up[k], down[k] = rise(n, 0.0, 0.0, 0.8), rise(n, 3.0, 0.8, 0.4)
    assert up[0] == pytest.approx(down[0], abs=0.006)
    assert up[1] < 0.9 * down[1]
    assert up[2] > 1.15 * up[0]
    limited = shaft(make_effect("slew-limit", 1), commands, 6.0)
    assert np.diff(limited).max() / 0.0025 <= 1.0 / make_effect("slew-limit", 1).shaft.slew + 1e-9
    assert rise(limited, 0.0, 0.0, 0.8) > 1.5 * up[0]
    assert rise(limited, 3.0, 0.8, 0.4) < rise(limited, 0.0, 0.0, 0.8)


def test_losses_at_low_speed_and_in_the_load_cell() -> None:
    for name, low, high in (("thrust-dead-band", 0.3, 0.85), ("thrust-exponent", 0.7, 0.85)):
        slow, fast = (forces(make_effect(name, 1), n, 5.0)[-1] / thrust(ThrusterTruth(), n) for n in (0.1, 0.9))
        assert low < slow < high < fast
    droop = shaft(make_effect("speed-curve", 1), [(0.0, 0.9)], 3.0)[-1]
    assert 0.8 < droop / 0.9 < 0.96
    band = make_effect("controller-dead-band", 1).shaft.ignored
    for command, speed in ((0.9 * band, 0.0), (0.5, (0.5 - band) / (1.0 - band)), (1.0, 1.0)):
        assert shaft(make_effect("controller-dead-band", 1), [(0.0, command)], 3.0)[-1] == pytest.approx(
            speed, abs=1e-6
        )
    smooth = forces(make_effect("cell-lag", 1), 0.8, 5.0)
    assert smooth[-1] == pytest.approx(thrust(ThrusterTruth(), 0.8), rel=1e-6)
    behind = np.argmax(smooth > 13.0) - np.argmax(forces(NONE, 0.8, 5.0) > 13.0)
    assert 0.0025 * behind == pytest.approx(make_effect("cell-lag", 1).smooth_s, rel=0.1)


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_at_half_scale_is_smaller(name: str) -> None:
    plain, full, half = (
        forces(e, 0.7, 4.0) + forces(e, -0.7, 4.0) for e in (NONE, make_effect(name, 2), make_effect(name, 2, 0.5))
    )
    whole, part = np.sqrt(np.mean((full - plain) ** 2)), np.sqrt(np.mean((half - plain) ** 2))
    assert 0.05 * whole < part < 0.8 * whole


def test_drawn_benches_differ_by_seed_and_effect() -> None:
    assert NONE.parameters == {}
    assert {draw_name(seed) for seed in range(50)} == set(DEMO)
    for name in EFFECTS:
        assert make_effect(name, 3) == make_effect(name, 3)
        assert all(math.isfinite(v) and v != 0.0 for v in make_effect(name, 3).parameters.values())
    c1 = [draw_bench(seed).thruster.c1 for seed in range(100)]
    assert all(abs(value / 40.05 - 1.0) <= 0.05 for value in c1)
    assert max(c1) - min(c1) > 2.0
