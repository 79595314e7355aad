"""Tests of hidden effects: each effect acts as described, with a relevant size, and has no other consequence."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest

from seatrial.mocks.hidden_effects.catalogue import DEMO, EFFECTS, OUTSIDE, SITE, draw_name, make_effect
from seatrial.mocks.plant.boat import PLANT_STEP_S, Boat, BoatPlant
from seatrial.mocks.plant.effect import HiddenEffect
from seatrial.mocks.plant.hull import Hull
from seatrial.mocks.plant.thruster import ThrusterTruth
from seatrial.mocks.plant.weather import Sea
from seatrial.mocks.sensors import AhrsSensor, EscSensor
from tests.mocks.sailing import REST, run

SIGNED = {
    "mismatch": "eps",
    "sway-yaw": "y_r",
    "cg-offset": "x_g",
    "compass": "b_sin",
    "lever-arm": "l_x",
    "yaw-bias": "n_0",
    "mount": "psi_0",
    "gyro-scale": "k",
    "current-drift": "change_n",
    "thrust-angle": "angle",
    "propeller-walk": "walk",
    "payload-shift": "x_g",
}
ON_SENSORS = {
    *("compass", "lever-arm", "gnss-latency", "mount", "gyro-scale", "accelerometer-tilt", "accelerometer-scale"),
    "shaft-clip",
}


def surge(name: str, n: float, seconds: float = 40.0) -> float:
    effects = (make_effect(name, 1),) if name else ()
    return run(effects, (n, n), seconds).state[3]


def sailed(name: str) -> Iterator[tuple[float, float]]:
    """Yield north and east [m] at every step of a minute with this effect; an empty name means no effect."""
    effects = (make_effect(name, 2),) if name else ()
    plant = BoatPlant(Boat(Hull(), ThrusterTruth(), (0.0, 0.0), effects, 0), state=REST, disturbed=False)
    for k in range(round(60.0 / PLANT_STEP_S)):
        if k % 2000 == 0:
            n = ((0.5, 0.6), (-0.6, -0.5), (0.9, 0.5), (0.5, 0.9), (0.7, 0.7), (0.0, 0.4))[k // 2000]
            plant.command(0, plant.t, n[0])
            plant.command(1, plant.t, n[1])
        plant.advance()
        yield plant.state[0], plant.state[1]


@cache
def plain_track() -> list[tuple[float, float]]:
    return list(sailed(""))


LATE = {"payload-shift", "leak", "fouling"}  # a minute is too short for them
OPPOSED = {"wash"}  # the thrusters never run in opposite directions in this minute


@pytest.mark.parametrize("name", sorted({*EFFECTS, *SITE, *OUTSIDE} - ON_SENSORS - LATE - OPPOSED - {"pendulum"}))
def test_every_effect_bends_the_track(name: str) -> None:
    """The deviation exceeds the GNSS noise, so that an analysis can resolve it."""
    both = zip(sailed(name), plain_track(), strict=False)  # until the deviation shows
    assert any(abs(x - plain_x) > 0.3 or abs(y - plain_y) > 0.3 for (x, y), (plain_x, plain_y) in both)


def test_the_pendulum_shakes_the_boat() -> None:
    """The pendulum is part of the boat's mass, so the track hardly bends.

    Its motion exceeds the noise of the accelerometers.
    """
    ahead = {}
    for effects in ((), (make_effect("pendulum", 2),)):
        plant = BoatPlant(Boat(Hull(), ThrusterTruth(), (0.0, 0.0), effects, 0), state=REST, disturbed=False)
        for thruster in (0, 1):
            plant.command(thruster, 0.0, 0.8)
        found = []
        for _ in range(round(10.0 / PLANT_STEP_S)):
            plant.advance()
            found.append(plant.motion().ax)
        ahead[bool(effects)] = np.array(found)
    assert np.abs(ahead[True] - ahead[False]).max() > 0.1


def test_an_effect_of_scale_zero_does_not_change_the_motion() -> None:
    plain = run((), (0.7, 0.4), 8.0).motion()
    for name in (*EFFECTS, *SITE, *OUTSIDE):
        assert run((make_effect(name, 2, scale=0.0),), (0.7, 0.4), 8.0).motion() == pytest.approx(plain, abs=1e-9), name


@pytest.mark.parametrize(("name", "key"), SIGNED.items())
def test_signs_are_drawn(name: str, key: str) -> None:
    values = [make_effect(name, seed).parameters[key] for seed in range(20)]
    assert min(values) < 0.0 < max(values)
    assert np.ptp(np.abs(values)) > 0.0


def test_advance_ratio_and_cubic_drag_reduce_speed_ahead() -> None:
    assert surge("advance-ratio", 0.7) < 0.93 * surge("", 0.7)
    fast, slow = surge("cubic-drag", 1.0) / surge("", 1.0), surge("cubic-drag", 0.3) / surge("", 0.3)
    assert fast < slow < 1.0
    assert fast < 0.85


def test_reverse_thrust_is_lost_astern_only() -> None:
    assert surge("reverse-thrust", 0.6) == surge("", 0.6)
    assert surge("reverse-thrust", -0.6) / surge("", -0.6) == pytest.approx(math.sqrt(0.7), abs=0.06)


def test_reverse_mismatch_weakens_one_thruster_in_reverse() -> None:
    effect = make_effect("reverse-mismatch", 2)
    assert effect.thrust is not None
    ahead, astern = (effect.thrust(n, n, 0.0, 0.0, 50.0 * n, 50.0 * n, 0.0) for n in (0.6, -0.6))
    assert ahead == (30.0, 30.0)
    weak = int(effect.parameters["right"])
    assert astern[1 - weak] == -30.0
    assert astern[weak] == pytest.approx(-30.0 * (1.0 - effect.parameters["loss"]), abs=0.6)


def test_fouling_takes_a_share_of_the_thrust_of_one_side_from_its_time_on() -> None:
    effect = make_effect("fouling", 4)
    assert effect.fouling is not None
    plant = run((effect,), (0.0, 0.0), effect.parameters["at"] - 2.0)
    still, n = (0.0,) * len(plant.state), (0.6, 0.6)
    before = plant._rhs(still, *n, 0.0, 0.0, 0.0, 0.0)
    for _ in range(round(4.0 / plant.step_s)):
        plant.advance()
    after = plant._rhs(still, *n, 0.0, 0.0, 0.0, 0.0)
    assert after[3] / before[3] == pytest.approx(1.0 - effect.parameters["loss"] / 2.0, rel=1e-6)
    assert before[5] == pytest.approx(0.0, abs=1e-12)
    assert (after[5] > 0.0) == bool(effect.parameters["right"])  # the stronger left thruster turns it to starboard


def test_lag_mismatch_delays_the_thrust_of_one_side() -> None:
    for seed in (1, 2, 3, 4):
        effect = make_effect("lag-mismatch", seed)
        plant, slow = run((effect,), (0.8, 0.8), 1.5), int(effect.parameters["right"])
        plain = run((), (0.8, 0.8), 1.5)
        assert plant._n[1 - slow] == pytest.approx(plain._n[1 - slow], abs=1e-9)
        assert 0.2 < plant._n[slow] < 0.8 * plain._n[slow]
        assert (plant.state[5] > 0.0) == bool(slow)  # the boat turns to the slower side


def test_derating_takes_thrust_of_a_hot_thruster_and_gives_it_back() -> None:
    effect = make_effect("derating", 3)
    loss, tau = effect.parameters["loss"], effect.parameters["tau"]
    plant = run((effect,), (1.0, 0.0), 8.0 * tau)
    still, n = (0.0,) * len(plant.state), (0.6, 0.6)

    def forces() -> tuple[float, float]:
        """Return the thrust [N] of the left and the right thruster of a boat at rest."""
        hot = plant._hot[0]
        return hot.thrust(*n, 0.0, 0.0, 10.0, 10.0, 0.0)

    assert forces() == pytest.approx((10.0 * (1.0 - loss), 10.0), rel=1e-3)
    turned = plant._rhs(still, *n, 0.0, 0.0, 0.0, 0.0)[5]
    assert turned < 0.0  # the weaker left thruster turns the boat to port
    plant.command(0, plant.t, 0.0)
    for _ in range(round(1.25 * tau / plant.step_s)):
        plant.advance()
    assert forces()[0] == pytest.approx(10.0 * (1.0 - loss * math.exp(-1.0)), rel=0.02)


def test_wash_acts_astern_while_the_other_thruster_runs_ahead() -> None:
    effect = make_effect("wash", 1)
    assert effect.thrust is not None
    loss = effect.parameters["loss"]
    for n in ((0.6, 0.6), (-0.6, -0.6), (-0.6, 0.0), (0.6, 0.0)):
        assert effect.thrust(*n, 0.0, 0.0, 10.0, -10.0, 0.0) == (10.0, -10.0)
    ahead, astern = effect.thrust(0.6, -0.6, 0.0, 0.0, 10.0, -10.0, 0.0)
    assert (ahead, astern) == (10.0, pytest.approx(-10.0 * (1.0 - loss), abs=0.1))
    assert abs(run((effect,), (0.7, -0.7)).state[5]) < 0.97 * abs(run((), (0.7, -0.7)).state[5])


def test_battery_sag_grows_with_use() -> None:
    assert surge("battery-sag", 0.8, 5.0) > 0.98 * surge("", 0.8, 5.0)
    assert surge("battery-sag", 0.8, 200.0) < 0.96 * surge("", 0.8, 200.0)


def test_load_sag_takes_thrust_of_both_thrusters_at_once_and_ends_with_the_load() -> None:
    effect = make_effect("load-sag", 1)
    k, hook = effect.parameters["k"], effect.thrust
    assert hook is not None

    def loss(n_l: float, n_r: float) -> tuple[float, float]:
        """Return the share of the thrust that each thruster loses."""
        left, right = hook(n_l, n_r, 0.0, 0.0, 10.0, -20.0, 1.0)
        return 1.0 - left / 10.0, 1.0 + right / 20.0

    assert loss(0.0, 0.0) == (0.0, 0.0)
    assert loss(1.0, -1.0) == pytest.approx((k / (1.0 + k),) * 2)
    assert loss(0.0, 0.8) == pytest.approx(loss(0.8, 0.0))
    # The voltage solves v = 1 - k i, with a current that is v times the mean cube of the shaft speeds.
    v = 1.0 - loss(0.9, 0.5)[0]
    assert v == pytest.approx(1.0 - k * v * (0.9**3 + 0.5**3) / 2.0)


def test_interaction_acts_only_with_both_thrusters() -> None:
    def forces(n_l: float, n_r: float) -> tuple[float, float]:
        hook = make_effect("thruster-interaction", 1).thrust
        assert hook is not None
        return hook(n_l, n_r, 0.0, 0.0, 10.0, 10.0, 0.0)

    assert forces(0.8, 0.0)[0] == 10.0
    assert forces(0.8, 0.8)[0] < 9.0


def test_the_loss_of_speed_by_turning_acts_only_in_turns() -> None:
    effect = (make_effect("turning-resistance", 1),)
    assert run(effect, (0.6, 0.6)).state[3] == run((), (0.6, 0.6)).state[3]
    assert run(effect, (0.9, 0.3)).state[3] < 0.95 * run((), (0.9, 0.3)).state[3]


@pytest.mark.parametrize("name", ["mismatch", "yaw-bias"])
def test_effects_that_turn_the_boat_turn_it_to_the_right_side(name: str) -> None:
    for seed in range(4):
        effect = make_effect(name, seed)
        side = effect.parameters["eps" if name == "mismatch" else "n_0"]
        r = run((effect,), (0.6, 0.6)).state[5]
        assert r * side > 0.0
        assert abs(r) > 0.03


def test_wind_pushes_a_boat_at_rest_downwind() -> None:
    effect = make_effect("wind", 3)
    motion = run((effect,), (0.0, 0.0), 120.0).motion()
    toward = (effect.parameters["wind_n"], effect.parameters["wind_e"])
    downwind = (motion.x * toward[0] + motion.y * toward[1]) / math.hypot(*toward)
    assert downwind > 10.0


def test_the_compass_effect_changes_the_reading_and_not_the_boat() -> None:
    effect = make_effect("compass", 4)
    plant = run((effect,), (0.7, 0.4))
    assert plant.motion() == run((), (0.7, 0.4)).motion()
    with_effect, plain = AhrsSensor(1, 0, 50.0, (effect,)), AhrsSensor(1, 0, 50.0)
    headings = np.linspace(-math.pi, math.pi, 37)
    motion = plant.motion()
    errors = [
        with_effect.read(motion._replace(psi=psi)).yaw - plain.read(motion._replace(psi=psi)).yaw
        for psi in headings.tolist()
    ]
    errors = [(e + math.pi) % (2 * math.pi) - math.pi for e in errors]
    expected = effect.parameters["b_sin"] * np.sin(headings) + effect.parameters["c_cos"] * np.cos(headings)
    assert np.allclose(errors, expected, atol=0.01)
    assert np.max(np.abs(errors)) > 0.03


def test_the_fix_is_at_the_lever_arm_of_the_antenna() -> None:
    effect = make_effect("lever-arm", 5)
    m = run((effect,), (0.8, 0.3)).motion()
    c, s = math.cos(m.psi), math.sin(m.psi)
    l_x, l_y = effect.parameters["l_x"], effect.parameters["l_y"]
    assert (m.fix_x - m.x, m.fix_y - m.y) == pytest.approx((c * l_x - s * l_y, s * l_x + c * l_y))
    assert (m.fix_vel_n - m.vel_n, m.fix_vel_e - m.vel_e) == pytest.approx(
        (m.r * (-s * l_x - c * l_y), m.r * (c * l_x - s * l_y))
    )


def test_a_late_fix_is_at_an_earlier_position_of_the_boat() -> None:
    effect = make_effect("gnss-latency", 6)
    m = run((effect,), (0.6, 0.6), 60.0).motion()
    assert m.x - m.fix_x == pytest.approx(effect.parameters["latency"] * m.vel_n, rel=0.02)


def test_the_pendulum_swings_at_its_frequency_and_keeps_momentum() -> None:
    effect = make_effect("pendulum", 7)
    assert effect.pendulum is not None
    mass, length, _ = effect.pendulum
    still = (HiddenEffect("pendulum", "", pendulum=(mass, length, 0.0)),)
    hull = Hull(d_u=0.0, d_uu=0.0)
    plant = BoatPlant(Boat(hull, ThrusterTruth(), (0.0, 0.0), still, 0), state=(*REST[:6], 0.05, 0.0), disturbed=False)
    momentum, angle = [], []
    for _ in range(4000):
        plant.advance()
        u, rate = plant.state[3], plant.state[7]
        momentum.append((hull.lumped()["m_u"] - mass) * u + mass * (u + length * rate))
        angle.append(plant.state[6])
    assert np.abs(momentum).max() < 0.002 * mass * length * 0.05 * 2 * math.pi
    ups = np.flatnonzero(np.diff(np.sign(angle)) > 0)
    measured = 1.0 / (PLANT_STEP_S * float(np.diff(ups).mean()))
    free = effect.parameters["frequency_hz"] * math.sqrt(1.0 + mass / (hull.lumped()["m_u"] - mass))  # the boat recoils
    assert measured == pytest.approx(free, rel=0.01)


def test_a_dead_band_removes_slow_thrust_and_little_else() -> None:
    hook = make_effect("dead-band", 1).thrust
    assert hook is not None
    slow, fast = (hook(n, -n, 0.0, 0.0, 1.0, -1.0, 0.0) for n in (0.05, 0.9))
    assert slow[0] == -slow[1]
    assert 0.0 < slow[0] < 0.2
    assert 0.8 < fast[0] < 1.0
    assert hook(1.0, -1.0, 0.0, 0.0, 1.0, -1.0, 0.0) == (1.0, -1.0)  # the known thrust at full speed was measured
    assert hook(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0) == (0.0, 0.0)


@pytest.mark.parametrize("name", ["delay", "lag"])
def test_delays_of_thrust_shift_the_speed(name: str) -> None:
    """Half way up the ramp of a start, the speed equals the speed without the effect some time before."""
    effect = make_effect(name, 3)
    speed: dict[bool, list[float]] = {False: [], True: []}
    for with_effect in (False, True):
        run(
            (effect,) if with_effect else (),
            (0.7, 0.7),
            5.0,
            each=lambda p, to=with_effect: speed[to].append(p.state[3]),
        )
    t = PLANT_STEP_S * np.arange(1, len(speed[True]) + 1)
    late = np.interp(0.3, speed[True], t) - np.interp(0.3, speed[False], t)
    assert late == pytest.approx(effect.parameters[name], rel=0.25)


def test_the_tide_turns_smoothly() -> None:
    effect = make_effect("current-drift", 1)
    assert effect.current is not None
    early, late = effect.current(0.0), effect.current(400.0)
    assert early == pytest.approx((-late[0], -late[1]), rel=1e-9)
    assert math.hypot(late[0] - early[0], late[1] - early[1]) == pytest.approx(0.18, abs=0.04)
    m = run((effect,), (0.0, 0.0), 400.0).motion()
    # the current carries the boat along
    assert math.hypot(m.vel_n - late[0], m.vel_e - late[1]) < 0.3 * math.hypot(*late)


def test_a_line_pulls_more_at_a_larger_distance() -> None:
    effect = make_effect("tether", 1)
    assert effect.tether is not None
    near, far = (effect.tether(x, 0.0, 1.0, 0.0) for x in (5.0, 80.0))
    assert far[0] < 10.0 * near[0] < 0.0
    assert run((effect,), (0.7, 0.7), 120.0).state[3] < 0.9 * run((), (0.7, 0.7), 120.0).state[3]


def test_a_turned_thruster_pushes_to_the_side_of_its_angle() -> None:
    for seed in range(4):
        effect = make_effect("thrust-angle", seed)
        assert effect.jet is not None
        angle, right = effect.parameters["angle"], bool(effect.parameters["right"])
        left_only, right_only = effect.jet(0.6, 0.0), effect.jet(0.0, 0.6)
        alone, opposite = (right_only, left_only) if right else (left_only, right_only)
        assert alone[0] * angle > 0.0 > alone[0] * alone[1]  # the thruster is at the stern
        assert opposite == (0.0, 0.0)
        assert run((effect,), (0.6, 0.6), 2.0).state[5] * angle < -0.001


def test_the_propellers_walk_the_stern_to_the_other_side_astern_and_farther() -> None:
    jet = make_effect("propeller-walk", 1).jet
    assert jet is not None
    ahead, astern = jet(0.5, 0.5), jet(-0.5, -0.5)
    assert astern[0] == pytest.approx(-3.0 * ahead[0])
    assert astern[0] * astern[1] < 0.0


def test_a_sheared_current_flows_in_one_direction_and_changes_across_it() -> None:
    effect = make_effect("current-shear", 1)
    assert effect.stream is not None
    along = effect.parameters["along"]
    c, s = math.cos(along), math.sin(along)
    assert effect.stream(70.0 * c, 70.0 * s) == pytest.approx((0.0, 0.0), abs=1e-9)
    near, far = effect.stream(-5.0 * s, 5.0 * c), effect.stream(-80.0 * s, 80.0 * c)
    assert near[0] * s == pytest.approx(near[1] * c)  # along the stream
    assert math.hypot(*far) > 5.0 * math.hypot(*near)
    carried = run((effect,), (0.0, 0.0), 120.0, state=(-60.0 * s, 60.0 * c, *REST[2:])).motion()
    assert carried.vel_n * c + carried.vel_e * s == pytest.approx(effect.parameters["jump"], rel=0.2)


def test_a_bank_draws_boats_of_both_directions_towards_it_and_turns_the_bow_away() -> None:
    effect = make_effect("bank", 2)
    assert effect.shore is not None
    bearing = effect.parameters["bearing"]
    forces = []
    for side in (1.0, -1.0):  # bank to starboard, bank to port
        psi = bearing - side * 0.5 * math.pi
        near, far = (
            effect.shore(d * math.cos(bearing), d * math.sin(bearing), math.cos(psi), math.sin(psi), 1.0, 0.0)
            for d in (8.0, -40.0)
        )
        assert side * near[1] > 0.0 > side * near[2]
        assert abs(far[1]) < 0.05 * abs(near[1])
        forces.append(near)
    assert forces[0] == pytest.approx((forces[1][0], -forces[1][1], -forces[1][2]))


def test_drag_is_larger_over_the_shoal() -> None:
    effect = make_effect("shallow-water", 3)
    assert effect.shore is not None
    bearing = effect.parameters["bearing"]
    over, beside = (
        effect.shore(d * math.cos(bearing), d * math.sin(bearing), 1.0, 0.0, 1.0, 0.0)[0] for d in (50.0, -50.0)
    )
    assert over == pytest.approx(-effect.parameters["k"], rel=0.01)
    assert abs(beside) < 0.01 * abs(over)


def test_the_payload_slides_once_and_does_not_return() -> None:
    effect = make_effect("payload-shift", 4)
    assert effect.payload is not None
    at, plain, moved = effect.payload.at, list[float](), list[float]()
    plant = run((effect,), (0.9, 0.5), at + 30.0, each=lambda p: moved.append(p.state[5]))
    run((), (0.9, 0.5), at + 30.0, each=lambda p: plain.append(p.state[5]))
    before = round(at / PLANT_STEP_S)
    assert moved[:before] == plain[:before]
    assert abs(moved[-1] - plain[-1]) > 1e-3
    fixed = (HiddenEffect("fixed", "", x_g=effect.payload.x_g),)
    rates = [BoatPlant(Boat(Hull(), ThrusterTruth(), (0.0, 0.0), e, 0), state=plant.state) for e in (fixed, ())]
    assert plant._rhs(plant.state, 0.9, 0.5, 0.0, 0.0, 0.0, 0.0) == rates[0]._rhs(
        plant.state, 0.9, 0.5, 0.0, 0.0, 0.0, 0.0
    )
    assert plant.boat.effects == (effect,)


@pytest.mark.parametrize(("name", "share"), [("leak", 17.0 / 37.0), ("growing-drag", 1.0)])
def test_mass_or_drag_grows_with_time(name: str, share: float) -> None:
    """A minute later, equal forces give a smaller acceleration, or the drag at a speed is larger, by the drawn rate.

    The growth has steps of two seconds.
    """
    effect = make_effect(name, 4)
    plant = run((effect,), (0.0, 0.0), 60.0)
    at_speed = (0.0, 0.0, 0.0, 0.8, 0.0, 0.0, 0.0, 0.0)
    changed, plain = (
        p._rhs(at_speed, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)[3]
        for p in (plant, BoatPlant(Boat(Hull(), ThrusterTruth(), (0.0, 0.0), (), 0), state=at_speed))
    )
    growth = 1.0 + share * 60.0 * effect.parameters["rate"]
    assert changed / plain == pytest.approx(1.0 / growth if name == "leak" else growth, rel=7e-3)


def test_a_towed_line_drags_as_much_as_its_end_and_follows_a_turn_late() -> None:
    effect = make_effect("towed-line", 1)
    line = effect.line
    assert line is not None
    ahead = run((effect,), (0.6, 0.6), 60.0)
    pull = ahead._forces
    assert pull[0] == pytest.approx(-line.drag * ahead.state[3] ** 2, rel=0.02)
    assert pull[1:] == pytest.approx((0.0, 0.0), abs=1e-3)
    turning: list[tuple[float, float]] = []

    def turn(plant: BoatPlant) -> None:
        if plant.t > 60.0:
            plant.command(1, plant.t, 0.2)
        turning.append((plant.state[5], plant._forces[2]))

    run((effect,), (0.6, 0.6), 90.0, each=turn)
    late = turning[round(63.0 / PLANT_STEP_S)]
    assert late[0] * late[1] < 0.0  # the line holds the stern back
    astern: list[float] = []
    run((effect,), (-0.5, -0.5), 3.0, each=lambda p: astern.append(p._forces[0]))
    assert astern == [0.0] * len(astern)  # a line that is pushed has no tension


def test_waves_have_the_specified_peak_and_size() -> None:
    wave = make_effect("waves", 1).wave
    assert wave is not None
    sea = Sea(wave, np.random.default_rng(1))
    t = np.arange(0.0, 1200.0, 0.1)
    surge = np.array([sea.forces(float(at), wave.toward)[0] for at in t])
    sway = np.array([sea.forces(float(at), wave.toward + math.pi / 2)[1] for at in t])
    assert surge.std() == pytest.approx(wave.surge, rel=0.1)
    assert sway.std() == pytest.approx(wave.sway, rel=0.1)
    power = np.abs(np.fft.rfft(surge)) ** 2
    assert np.fft.rfftfreq(t.size, 0.1)[power.argmax()] == pytest.approx(wave.frequency, rel=0.15)


def test_a_misaligned_ahrs_rotates_heading_and_accelerations() -> None:
    effect = make_effect("mount", 2)
    turn = effect.parameters["psi_0"]
    m = run((effect,), (0.8, 0.4), 3.0).motion()._replace(psi=0.3, ax=1.0, ay=0.0)
    with_effect, plain = AhrsSensor(1, 0, 50.0, (effect,)).read(m), AhrsSensor(1, 0, 50.0).read(m)
    assert with_effect.yaw - plain.yaw == pytest.approx(turn)
    assert (with_effect.ax - plain.ax, with_effect.ay - plain.ay) == pytest.approx(
        (math.cos(turn) - 1.0, -math.sin(turn))
    )


def test_the_inertial_sensors_have_the_specified_errors() -> None:
    plain, m = AhrsSensor(1, 0, 50.0), run((), (0.9, 0.3), 20.0).motion()
    true = plain.read(m)
    for name, field, moved in (("gyro-scale", "r", m.r), ("accelerometer-scale", "ay", m.ay)):
        effect = make_effect(name, 4)
        error = getattr(AhrsSensor(1, 0, 50.0, (effect,)).read(m), field) - getattr(true, field)
        assert error == pytest.approx(effect.parameters["k"] * moved, rel=0.2), name
    tilt = make_effect("accelerometer-tilt", 4)
    leaked = AhrsSensor(1, 0, 50.0, (tilt,)).read(m)
    assert leaked.ax - true.ax == pytest.approx(9.81 * tilt.parameters["pitch"] * m.thrust, rel=0.2)
    assert leaked.ay - true.ay > 0.0


def test_saturated_telemetry_reports_its_limit_in_both_directions() -> None:
    effect = make_effect("shaft-clip", 1)
    ceiling = effect.parameters["ceiling"]
    assert 0.55 < ceiling < 0.75
    clipped, plain = EscSensor(1, 0, 1, 4500.0, effect.telemetry), EscSensor(1, 0, 1, 4500.0)
    for n in (0.9, -0.9, 0.4):
        rpm, free = (sensor.read(n, 10.0, n, 0.0, 0.02).rpm for sensor in (clipped, plain))
        assert rpm == (math.copysign(ceiling, n) * 4500.0 if abs(n) > ceiling else free)


def test_the_demo_draws_each_effect_of_its_list() -> None:
    assert len(set(DEMO)) >= 8
    assert set(DEMO) <= set(EFFECTS)
    assert {draw_name(seed) for seed in range(200)} == set(DEMO)
    assert make_effect("wind", 9).parameters == make_effect("wind", 9).parameters
