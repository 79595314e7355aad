"""Tests of the realistic boat: its small imperfections, each in the simulated signals, and unchanged other boats."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from seatrial.daq.samples import Esc
from seatrial.mocks.hidden_effects.catalogue import EFFECTS, EQUIPMENT, NOISE, OUTSIDE, make_effect, mixture
from seatrial.mocks.hidden_effects.realistic import IMPERFECTIONS, realistic, realistic_with
from seatrial.mocks.offline_simulation import BOAT, simulate, tables
from seatrial.mocks.plant import NONE, HeadingFilter, HiddenEffect, RigidBodyState, Shaft, ThrusterTruth, draw_bench
from seatrial.mocks.plant.boat import PLANT_STEP_S, BoatPlant, draw_boat
from seatrial.mocks.sensors import AhrsSensor
from seatrial.mocks.truth_file import ground_truth
from seatrial.mocks.world import boat_world

T = np.arange(0.0, 20.0, 4.0)
N = np.array([[0.5, 0.5], [0.8, 0.2], [0.2, 0.8], [-0.5, -0.4], [0.0, 0.0]])
REST = RigidBodyState(0.0, *[0.0] * 13)


def sampled(*effects: HiddenEffect, seconds: float = 20.0) -> dict[str, NDArray[np.void]]:
    """Return the samples of a boat with these effects by device. The random disturbances are off."""
    return tables(simulate(draw_boat(4, effects), T, N, seconds, disturbed=False).readings)


def test_the_boats_of_existing_seeds_have_not_changed() -> None:
    """The sizes are those of the version without the realistic boat, the samples those of ADR 0069 (dead band)."""
    sizes = {
        ("advance-ratio", "k"): 6.165879191426118,
        ("accelerometer-scale", "k"): -0.14010037304396017,
        ("jet-on-hull", "y"): 4.4408005074907955,
        ("noise-outliers", "share"): 0.009220678833955194,
    }
    for (name, key), size in sizes.items():
        assert make_effect(name, 3).parameters == {key: pytest.approx(size, rel=1e-12)}
    samples = tables(simulate(draw_boat(4, mixture("wind", 4)), T, N, 20.0, 1).readings)
    values = {
        ("ahrs", "yaw"): 0.6078066645801341,
        ("ahrs", "r"): 0.02095997520758508,
        ("ahrs", "mx"): 2.1278481430335297e-05,
        ("gnss", "lat"): 38.765792070465636,
        ("gnss", "vel_n"): -1.0889529500864366,
        ("esc/2/state", "current"): 0.18766334299485024,
    }
    for (device, column), value in values.items():
        assert samples[device][column][-60] == pytest.approx(value, rel=1e-9), (device, column)


def test_the_realistic_boat_has_all_imperfections_in_their_limits() -> None:
    assert set(IMPERFECTIONS) <= {*EFFECTS, *NOISE, *EQUIPMENT}
    for seed in range(100):
        effects = realistic(seed)
        assert tuple(e.name for e in effects) == IMPERFECTIONS
        assert all(e.minor for e in effects)
        found = {e.name: e.parameters for e in effects}
        assert 0.05 < math.hypot(*found["lever-arm"].values()) < 0.10
        assert 0.10 < found["gnss-latency"]["latency"] < 0.20
        assert 0.002 < abs(found["gyro-scale"]["k"]) < 0.004
        assert 3.0 < found["heading-lag"]["time_constant"] < 10.0
        assert 0.03 < found["heading-lag"]["lag"] < 0.08
        assert 0.05 <= found["telemetry-age"]["age"] <= 0.12
        assert found["telemetry-age"]["resolution"] == 0.005
        assert 0.2 < found["shaft-braking"]["slower"] < 0.5
        for name, key, low, high in (
            ("cross-flow", "n_vr", 0.2, 0.4),
            ("lift", "y_uv", 0.2, 0.4),
            ("sway-yaw", "y_r", 0.2, 0.4),
            ("wind", "drag", 0.2, 0.4),
            ("noise-gusts", "sigma", 0.2, 0.4),
            ("waves", "surge", 0.2, 0.4),
            ("mismatch", "eps", 0.1, 0.2),
            ("dead-band", "band", 0.2, 0.4),
            ("compass", "b_sin", 0.2, 0.4),
        ):
            assert low < found[name][key] / make_effect(name, seed).parameters[key] < high, name


def test_the_seed_decides() -> None:
    assert [e.parameters for e in realistic(5)] == [e.parameters for e in realistic(5)]
    assert [e.parameters for e in realistic(5)] != [e.parameters for e in realistic(6)]
    first, again = (simulate(draw_boat(5, realistic(5)), T, N, 5.0) for _ in range(2))
    assert first.readings == again.readings


def test_the_large_effect_comes_first_and_replaces_its_small_form() -> None:
    small = {e.name: e.parameters for e in realistic(3)}
    for name in ("wind", "pendulum", "jet-on-hull", "noise-gps", "telemetry-age"):
        large, *others = realistic_with(name, 3, 0.5)
        assert not large.minor
        assert large.parameters == make_effect(name, 3, 0.5).parameters
        assert {e.name: e.parameters for e in others} == {k: v for k, v in small.items() if k != name}
    assert [e.name for e in realistic_with("none", 3)] == list(IMPERFECTIONS)
    with pytest.raises(KeyError):
        realistic_with("kraken", 3)


@pytest.mark.parametrize("name", IMPERFECTIONS)
def test_each_imperfection_shows_in_the_signals(name: str) -> None:
    effect = next(e for e in realistic(4) if e.name == name)
    with_effect, plain = sampled(effect), sampled()
    changed = {
        (device, column)
        for device, rows in plain.items()
        for column in rows.dtype.names or ()
        if not np.array_equal(rows[column], with_effect[device][column], equal_nan=True)
    }
    expected = {
        "lever-arm": ("gnss", "lat"),
        "compass": ("ahrs", "yaw"),
        "gyro-scale": ("ahrs", "r"),
        "gnss-latency": ("gnss", "lat"),
        "heading-lag": ("ahrs", "yaw"),
        "telemetry-age": ("esc/1/state", "rpm"),
        "velocity-resolution": ("gnss", "vel_n"),
        "shaft-braking": ("esc/1/state", "rpm"),
    }
    assert expected.get(name, ("ahrs", "r")) in changed
    if name in ("heading-lag", "gyro-scale"):
        assert {device for device, _ in changed} == {"ahrs"}
    if name == "heading-lag":
        assert changed == {("ahrs", "yaw")}
    if name == "velocity-resolution":
        assert changed == {("gnss", "vel_n"), ("gnss", "vel_e"), ("gnss", "speed")}


@pytest.mark.parametrize("name", EQUIPMENT)
def test_equipment_of_scale_zero_does_not_change_the_motion(name: str) -> None:
    with_effect, plain = sampled(make_effect(name, 2, 0.0), seconds=8.0), sampled(seconds=8.0)
    for device, rows in plain.items():
        for column in rows.dtype.names or ():
            np.testing.assert_allclose(with_effect[device][column], rows[column], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("lag", [0.05, 0.07])  # at 50 Hz: 2.5 and 3.5 samples
def test_the_heading_trails_by_the_lag_times_the_yaw_rate(lag: float) -> None:
    late = HiddenEffect("heading-lag", "", heading_filter=HeadingFilter(5.0, lag))
    with_effect, plain = sampled(late)["ahrs"], sampled()["ahrs"]
    trail = np.unwrap(with_effect["yaw"]) - np.unwrap(plain["yaw"])  # the noise is the same
    turning = (plain["t"] > 7.0) & (plain["t"] < 8.0)
    rate = float(plain["r"][turning].mean())
    assert abs(rate) > 0.3
    assert float(trail[turning].mean()) == pytest.approx(-lag * rate, rel=0.1)


def test_the_compass_corrects_the_heading_with_the_time_constant_of_the_filter() -> None:
    """The boat turns from a heading without deviation to one with 0.1 rad. The gyro carries the heading through it."""
    compass = HiddenEffect("compass", "", compass=lambda psi: 0.1 if psi > 0.5 else 0.0)
    slow = HiddenEffect("heading-lag", "", heading_filter=HeadingFilter(4.0, 0.0))
    filtered, plain = AhrsSensor(1, 0, 50.0, (compass, slow)), AhrsSensor(1, 0, 50.0)
    errors, fields = [], []
    for k in range(1, 1001):
        m = REST._replace(t=0.02 * k, psi=1.0 if k > 1 else 0.0)
        measured, true = filtered.read(m), plain.read(m)
        errors.append(measured.yaw - true.yaw)
        fields.append(measured.mx - true.mx)
    t = 0.02 * np.arange(1000)
    assert np.allclose(errors, 0.1 * (1.0 - np.exp(-t / 4.0)), atol=1e-9)
    assert np.allclose(fields[1:], 26.4e-6 * (math.cos(1.1) - math.cos(1.0)))  # the magnetometer has no filter


def test_a_gyro_error_turns_the_filtered_heading_by_the_time_constant_times_the_error() -> None:
    gyro = HiddenEffect("gyro-scale", "", gyro=lambda r: 0.003 * r)
    slow = HiddenEffect("heading-lag", "", heading_filter=HeadingFilter(5.0, 0.0))
    filtered, plain = AhrsSensor(1, 0, 50.0, (gyro, slow)), AhrsSensor(1, 0, 50.0)
    for k in range(3000):
        m = REST._replace(psi=0.5, r=0.0 if k == 0 else 0.4)
        error = filtered.read(m).yaw - plain.read(m).yaw
    assert error == pytest.approx(5.0 * 0.003 * 0.4, rel=1e-4)


def test_the_telemetry_is_old_by_its_age_and_in_steps() -> None:
    effect = make_effect("telemetry-age", 3)
    age, resolution = effect.parameters["age"], effect.parameters["resolution"]
    steps = round(age / PLANT_STEP_S)
    assert steps * PLANT_STEP_S == pytest.approx(age)
    world = boat_world(draw_boat(3, (effect,)), 0, BOAT, disturbed=False)
    plant = world.plant
    assert isinstance(plant, BoatPlant)
    true, duties, rows = [], [], []
    for k in range(1200):
        if k in (100, 500, 800):
            for controller in world.controllers:
                controller.command(world.t, {100: 0.8, 500: 0.2, 800: -0.6}[k])
        true.append(plant.shafts[0].n)
        duties.append(world.controllers[0].n)
        rows += [(k, r.sample) for r in world.readings() if isinstance(r.sample, Esc) and r.sample.node == 1]
        world.advance()
    # The noise is 5 rev/min; rounding adds at most half a step of 22.5 rev/min.
    for k, sample in rows:
        past = max(0, k - steps)
        assert abs(sample.rpm / 4500.0 - true[past]) < 0.5 * resolution + 0.006
        assert sample.rpm / 22.5 == pytest.approx(round(sample.rpm / 22.5))
        assert sample.duty in duties[max(0, past - 1) : past + 1]
    now = max(abs(sample.rpm / 4500.0 - true[k]) for k, sample in rows)
    assert now > 0.1


def test_the_velocity_is_in_steps() -> None:
    fixes = sampled(make_effect("velocity-resolution", 1))["gnss"]
    plain = sampled()["gnss"]
    for column in ("vel_n", "vel_e"):
        assert np.allclose(fixes[column] * 100.0, np.round(fixes[column] * 100.0), atol=1e-9)
        assert np.abs(fixes[column] - plain[column]).max() <= 0.005 + 1e-12


def test_a_shaft_slows_down_with_its_own_lag() -> None:
    truth, dt = ThrusterTruth(pole=4.0, delay=0.0), 0.01
    shaft = Shaft(truth, dt, braking=1.5)
    shaft.command(0.0, 0.8)
    rising = [shaft.advance() for _ in range(100)]
    assert rising[49] == pytest.approx(0.8 * (1.0 - math.exp(-4.0 * 0.5)), rel=1e-9)
    shaft.command(1.0, -0.8)
    reversing = [shaft.advance() for _ in range(200)]
    assert reversing[9] == pytest.approx(-0.8 + (rising[-1] + 0.8) * math.exp(-4.0 / 1.5 * 0.1), rel=1e-9)
    negative = [n for n in reversing if n < 0.0]
    for before, after in pairwise(negative[:50]):
        assert (after + 0.8) / (before + 0.8) == pytest.approx(math.exp(-4.0 * dt), rel=1e-9)


def test_the_truth_file_lists_the_small_effects_beside_the_large_one() -> None:
    for effects, name in ((realistic_with("wind", 3), "wind"), (realistic(3), "none")):
        truth = ground_truth(draw_boat(3, effects), 1)
        assert truth["effect"] == name
        small = [e for e in effects if e.minor]
        assert [row["effect"] for row in truth["minor_effects"]] == [e.name for e in small]
        assert [row["parameters"] for row in truth["minor_effects"]] == [e.parameters for e in small]
    assert truth["sentence"] == "no large hidden effect"
    for world in (draw_boat(3), draw_bench(3)):
        truth = ground_truth(world, 0)
        assert (truth["effect"], truth["sentence"], truth["minor_effects"]) == ("none", NONE.sentence, [])


def test_names_are_unique_in_the_catalogue() -> None:
    names = [*EFFECTS, *OUTSIDE, *NOISE, *EQUIPMENT]
    assert len(names) == len(set(names))
