"""Tests of the simulated boat against mechanics, and of the integrator against its order."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from seatrial.mocks.plant.boat import PLANT_STEP_S, Boat, BoatPlant, draw_boat
from seatrial.mocks.plant.effect import HiddenEffect
from seatrial.mocks.plant.hull import ARM, CURRENT_MAX, Hull, State, draw_current, draw_hull
from seatrial.mocks.plant.thruster import Shaft, ThrusterTruth, thrust
from tests.machine import cpu_seconds

STILL = (0.0, 0.0)
CG = HiddenEffect("cg-offset", "", x_g=0.2)


def boat(
    hull: Hull | None = None, current: tuple[float, float] = STILL, effects: tuple[HiddenEffect, ...] = ()
) -> Boat:
    return Boat(hull or Hull(), ThrusterTruth(), current, effects, seed=0)


def at(u: float = 0.0, v: float = 0.0, r: float = 0.0, psi: float = 0.0) -> State:
    return (0.0, 0.0, psi, u, v, r, 0.0, 0.0)


def settled(n_left: float, n_right: float, seconds: float, **how: tuple[float, float]) -> BoatPlant:
    plant = BoatPlant(boat(**how), state=at(), disturbed=False)
    plant.command(0, 0.0, n_left)
    plant.command(1, 0.0, n_right)
    for _ in range(round(seconds / PLANT_STEP_S)):
        plant.advance()
    return plant


def test_straight_ahead_thrust_equals_drag() -> None:
    plant = settled(0.6, 0.6, 60.0)
    u, v, r = plant.state[3:6]
    hull = plant.boat.hull
    assert (v, r) == (0.0, 0.0)
    assert 2.0 * thrust(ThrusterTruth(), 0.6) == pytest.approx(hull.d_u * u + hull.d_uu * u * u, rel=1e-9)


def test_a_steady_turn_is_a_circle_that_balances_the_equations_of_the_thesis() -> None:
    plant = settled(0.7, 0.4, 80.0)
    u, v, r = plant.state[3:6]
    p = plant.boat.hull.lumped()
    left, right = thrust(ThrusterTruth(), 0.7), thrust(ThrusterTruth(), 0.4)
    surge = left + right + p["m_v"] * v * r - p["d_u"] * u - p["d_uu"] * abs(u) * u
    sway = -p["m_u"] * u * r - p["d_v"] * v - p["d_vv"] * abs(v) * v
    yaw = ARM * (left - right) + (p["m_u"] - p["m_v"]) * u * v - p["d_r"] * r - p["d_rr"] * abs(r) * r
    assert np.allclose((surge, sway, yaw), 0.0, atol=1e-6)
    assert r > 0.0  # the left thruster is the stronger one, so the boat turns to starboard
    track = []
    for _ in range(round(2.0 * math.pi / r / PLANT_STEP_S)):
        plant.advance()
        track.append(plant.state[:2])
    xy = np.array(track)
    radius = np.linalg.norm(xy - xy.mean(axis=0), axis=1)
    assert np.allclose(radius, math.hypot(u, v) / r, rtol=2e-3)


def test_without_thrust_the_boat_drifts_with_the_current() -> None:
    plant = settled(0.0, 0.0, 300.0, current=(0.2, -0.1))
    motion = plant.motion()
    # Surge drag is nearly quadratic, so the last of the velocity difference decays slowly.
    assert (motion.vel_n, motion.vel_e) == pytest.approx((0.2, -0.1), abs=0.02)


@pytest.mark.parametrize("effects", [(), (CG,)])
def test_a_constant_current_adds_only_a_drift(effects: tuple[HiddenEffect, ...]) -> None:
    """In a constant current the motion relative to the water is the same as in still water (Galilei)."""
    v_n, v_e = 0.3, -0.2
    c, s = math.cos(1.0), math.sin(1.0)
    in_still = BoatPlant(boat(effects=effects), state=at(0.5, 0.1, 0.2, psi=1.0), disturbed=False)
    adrift = at(0.5 + c * v_n + s * v_e, 0.1 + c * v_e - s * v_n, 0.2, psi=1.0)
    in_current = BoatPlant(boat(current=(v_n, v_e), effects=effects), state=adrift, disturbed=False)
    for plant in (in_still, in_current):
        plant.command(0, 0.0, 0.8)
        plant.command(1, 5.0, 0.5)
        for _ in range(round(20.0 / PLANT_STEP_S)):
            plant.advance()
    x, y, psi = in_current.state[:3]
    expected = (in_still.state[0] + 20.0 * v_n, in_still.state[1] + 20.0 * v_e, in_still.state[2])
    assert (x, y, psi) == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("x_g", [0.0, 0.2])
def test_without_drag_and_thrust_kinetic_energy_is_conserved(x_g: float) -> None:
    hull = replace(Hull(), d_u=0.0, d_uu=0.0, d_v=0.0, d_vv=0.0, d_r=0.0, d_rr=0.0)
    plant = BoatPlant(boat(hull, effects=(replace(CG, x_g=x_g),)), state=at(1.0, 0.3, 0.5), disturbed=False)

    def energy() -> float:
        u, v, r = plant.state[3:6]
        at_cg = hull.mass * (u * u + (v + x_g * r) ** 2) + hull.inertia * r * r
        return 0.5 * (at_cg + hull.added_u * u * u + hull.added_v * v * v + hull.added_r * r * r)

    before = energy()
    for _ in range(4000):
        plant.advance()
    assert plant.state[3:6] != pytest.approx((1.0, 0.3, 0.5), abs=0.05)
    assert energy() == pytest.approx(before, rel=1e-9)


def test_the_integrator_is_of_fourth_order() -> None:
    def end(step: float) -> np.ndarray:
        plant = BoatPlant(boat(), step=step, state=at(0.4, -0.2, 0.6), disturbed=False, n=0.6)
        for _ in range(round(2.0 / step)):
            plant.advance()
        return np.array(plant.state[:6])

    exact = end(0.001)
    errors = [float(np.abs(end(step) - exact).max()) for step in (0.2, 0.1, 0.05)]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert np.all(np.abs(orders - 4.0) < 0.4), orders


def test_the_accelerometer_agrees_with_the_track() -> None:
    plant = BoatPlant(boat(current=(0.1, 0.2), effects=(CG,)), state=at(0.8, -0.1, 0.3, psi=2.0), disturbed=False)
    plant.command(0, 0.0, 0.7)
    for _ in range(200):
        plant.advance()
    before = plant.motion()
    plant.advance()
    middle = plant.motion()
    plant.advance()
    after = plant.motion()
    a_n, a_e = (after.vel_n - before.vel_n) / (2 * PLANT_STEP_S), (after.vel_e - before.vel_e) / (2 * PLANT_STEP_S)
    c, s = math.cos(middle.psi), math.sin(middle.psi)
    assert (middle.ax, middle.ay) == pytest.approx((c * a_n + s * a_e, c * a_e - s * a_n), abs=1e-4)
    assert (middle.x - before.x) / PLANT_STEP_S == pytest.approx(middle.vel_n, abs=0.01)


def test_the_shaft_follows_its_step_exactly() -> None:
    truth = ThrusterTruth(pole=3.0, delay=0.1)
    shaft = Shaft(truth, 0.01)
    for t, n in ((0.0033, 0.5), (0.2041, -0.9), (0.2043, 0.8), (0.3, 0.05)):
        shaft.command(t, n)
    speeds = {k: shaft.advance() for k in range(1, 61)}

    def relaxed(start: float, ref: float, dt: float) -> float:
        return ref + (start - ref) * math.exp(-3.0 * dt)

    first = relaxed(0.0, 0.5, 0.3041 - 0.1033)
    second = relaxed(relaxed(first, -0.9, 0.0002), 0.8, 0.4 - 0.3043)
    assert speeds[10] == 0.0
    assert speeds[30] == pytest.approx(relaxed(0.0, 0.5, 0.30 - 0.1033), abs=1e-12)
    assert speeds[60] == pytest.approx(relaxed(second, 0.0, 0.2), abs=1e-12)  # 0.05 is in the dead zone


def test_boats_differ_by_seed_within_their_spread() -> None:
    nominal = Hull().lumped()
    totals = []
    for seed in range(200):
        drawn = draw_hull(seed).lumped()
        assert all(abs(drawn[k] / nominal[k] - 1.0) <= 0.1 for k in nominal)
        assert math.hypot(*draw_current(seed)) <= CURRENT_MAX
        totals.append(drawn["m_u"])
    assert max(totals) - min(totals) > 4.0
    assert draw_hull(7) == draw_hull(7)
    assert max(math.hypot(*draw_current(seed)) for seed in range(200)) > 0.2


def test_disturbances_have_the_specified_size() -> None:
    plant = BoatPlant(draw_boat(3), run=1)
    forces = []
    for k in range(200_000):
        plant.advance()
        if k % 4 == 0:
            forces.append(plant._forces)
    spread = np.array(forces).std(axis=0)
    assert spread == pytest.approx((0.3, 0.3, 0.03), rel=0.2)


def test_the_plant_is_fast_enough_for_speed_20() -> None:
    """4000 steps a second at speed 20 may take a tenth of a core. The limit allows for slow machines."""
    plant = BoatPlant(draw_boat(1))
    assert cpu_seconds(lambda: [plant.advance() for _ in range(4000)], 0.25) < 0.25
