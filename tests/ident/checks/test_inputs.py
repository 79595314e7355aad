"""Tests of inputs that did not drive the boat: constant, stuck, or of another thruster."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seatrial.ident.checks import invalidates_fit
from seatrial.ident.checks.inputs import check_inputs, check_thrust_present
from seatrial.ident.checks.log_checks import check_signals
from seatrial.ident.data import Channel
from tests.ident.checks.test_latency import ATTITUDE, COMMANDS, SHAFTS, SIDES, VELOCITY, sailed


def log(*groups: tuple[str, ...]) -> dict[str, Channel]:
    own = sailed(1)
    return {name: own[name] for group in groups for name in group}


def faults(c: dict[str, Channel]) -> list[str]:
    found = [f for f in check_signals(c, SIDES) if f.level == "fault"]
    assert all(invalidates_fit(f) for f in found)
    return [f.code for f in found]


def constant(c: dict[str, Channel], names: tuple[str, ...], value: float) -> dict[str, Channel]:
    return c | {n: replace(c[n], value=np.full(c[n].t.size, value)) for n in names}


@pytest.mark.parametrize("inputs", [COMMANDS, SHAFTS])
@pytest.mark.parametrize("value", [0.0, 0.0025, 0.6])
@pytest.mark.parametrize("sensors", [(ATTITUDE, VELOCITY), (("psi", "x", "y"),)])
def test_constant_inputs_of_a_moving_boat_are_a_fault(
    inputs: tuple[str, ...], value: float, sensors: tuple[tuple[str, ...], ...]
) -> None:
    (found,) = check_inputs(constant(log(*sensors, inputs), inputs, value))
    assert (found.code, found.level) == ("inputs-constant", "fault")
    assert invalidates_fit(found)


@pytest.mark.parametrize("inputs", [COMMANDS, SHAFTS])
def test_changing_inputs_give_no_finding(inputs: tuple[str, ...]) -> None:
    assert not list(check_inputs(log(ATTITUDE, VELOCITY, inputs)))


@pytest.mark.parametrize("inputs", [COMMANDS, SHAFTS])
@pytest.mark.parametrize(
    ("spread", "second", "found"),
    [(0.04, 0.55, ["inputs-one-level"]), (0.04, -0.7, ["inputs-one-level"]), (0.04, 0.0, ["inputs-one-level"]),
     (0.25, 0.6, []), (0.04, None, [])],
    ids=["one speed", "spins", "one thruster", "several speeds", "a second speed"],
)  # fmt: skip
def test_thrusters_at_one_speed_are_reported(
    inputs: tuple[str, ...], spread: float, second: float | None, found: list[str]
) -> None:
    """The signs change, and a start from rest does not count."""
    c = log(ATTITUDE, VELOCITY, inputs)
    for name, level in zip(inputs, (0.6, second), strict=True):
        t = c[name].t
        sizes = (0.6 if level is None else level) + spread * np.sin(t)
        if level == 0.0:
            sizes = np.zeros(t.size)
        elif level is None:
            sizes[t > 0.8 * t[-1]] = 0.3
        value = np.where(t < 0.03 * t[-1], 0.0, sizes * np.sign(np.sin(0.2 * t)))
        c |= {name: replace(c[name], value=value)}
    own = list(check_inputs(c))
    assert [f.code for f in own] == found
    if found:
        assert own[0].level == "warning"
        assert not invalidates_fit(own[0])
        assert own[0].where == ", ".join(n for n in inputs if np.any(c[n].value))
        assert f"{inputs[0]} 0.56 to 0.64" in own[0].text


def test_a_constant_speed_without_a_rise_is_one_speed() -> None:
    own = constant(log(ATTITUDE, VELOCITY, COMMANDS), COMMANDS, 0.6)
    own |= {n: replace(own[n], value=0.0 * own[n].value) for n in (*ATTITUDE, *VELOCITY) if n in own}
    assert [f.code for f in check_inputs(own)] == ["inputs-one-level"]
    assert not list(check_inputs({n: own[n] for n in COMMANDS}))  # a bench


@pytest.mark.parametrize(
    ("kept", "found"),
    [((), ["no-thrust"]), (("n_cmd_left",), ["one-side"]), (COMMANDS, []), (("n_left",), ["one-side"])],
)
def test_missing_thrusters_are_reported(kept: tuple[str, ...], found: list[str]) -> None:
    c = log(ATTITUDE, VELOCITY, COMMANDS, SHAFTS)
    moving = {n: x for n, x in c.items() if n in kept or not n.startswith("n_")}
    assert [f.code for f in check_thrust_present(moving)] == found
    assert not list(check_thrust_present({n: x for n, x in c.items() if n in kept}))  # a bench


def test_constant_inputs_are_the_only_fault_of_all_checks() -> None:
    assert faults(constant(log(ATTITUDE, VELOCITY, COMMANDS), COMMANDS, 0.0)) == ["inputs-constant"]


def test_coasting_boat_gives_no_finding() -> None:
    """Without thrust, a boat loses speed and oscillates in waves."""
    rng = np.random.default_rng(2)
    t = np.arange(0.0, 60.0, 0.1)
    speed, r = 1.5 / (1.0 + 0.2 * t), 0.3 * np.exp(-t / 4.0) + 0.1 * np.sin(2.5 * t)
    c = {
        "psi": Channel(t, np.cumsum(r) * 0.1 + rng.normal(0.0, 0.005, t.size)),
        "r": Channel(t, r + rng.normal(0.0, 0.004, t.size)),
        "vx": Channel(t, speed + rng.normal(0.0, 0.03, t.size)),
        "vy": Channel(t, rng.normal(0.0, 0.03, t.size)),
        "n_left": Channel(t, np.zeros(t.size), hold="zero"),
        "n_right": Channel(t, np.zeros(t.size), hold="zero"),
    }
    assert not list(check_inputs(c))


def test_half_a_velocity_over_ground_does_not_stop_the_check() -> None:
    """The log has vx without vy, and both velocities in body axes."""
    c = constant(log(ATTITUDE, VELOCITY, COMMANDS), ("n_cmd_left", "n_cmd_right"), 0.4)
    c |= {"u": c["vx"], "v": c["vy"]}
    del c["vy"]
    assert [f.code for f in check_inputs(c)] == ["inputs-constant"]


def test_one_idle_thruster_gives_no_finding() -> None:
    assert not list(check_inputs(constant(log(ATTITUDE, VELOCITY, COMMANDS), ("n_cmd_left",), 0.0)))


def test_shaft_speed_stuck_against_its_command_is_found() -> None:
    c = log(ATTITUDE, VELOCITY, COMMANDS, SHAFTS)
    shaft = c["n_left"]
    value = shaft.value.copy()
    begin = int(np.argmax(np.abs(value) > 0.3))
    inside = (shaft.t > shaft.t[begin]) & (shaft.t < shaft.t[begin] + 40.0)
    value[inside] = value[begin]
    (found,) = check_inputs(c | {"n_left": replace(shaft, value=value)})
    assert (found.code, found.where) == ("shaft-speed-stuck", "n_left")
    assert "although the command changes" in found.text


def test_slow_shaft_at_its_limit_is_not_stuck() -> None:
    """The shaft stays at its limit for seconds, and follows its command 3 s late."""
    t = np.arange(0.0, 90.0, 0.1)
    command = np.where(t % 18.0 < 9.0, 0.9, 0.1)
    shaft = np.minimum(np.where((t - 3.0) % 18.0 < 9.0, 0.9, 0.1), 0.75)
    c = {"n_cmd_pod": Channel(t, command, hold="zero"), "n_pod": Channel(t + 1e-3, shaft)}
    assert not list(check_inputs(c))


def test_exchanged_telemetry_is_reported_and_not_swapped_sides() -> None:
    c = log(ATTITUDE, VELOCITY, COMMANDS, SHAFTS)
    assert not faults(c)
    c["n_left"], c["n_right"] = c["n_right"], c["n_left"]
    (found,) = [f for f in check_signals(c, SIDES) if f.is_problem]
    assert found.code == "telemetry-exchanged"
    assert "the shaft speed of left follows the command of right" in found.text


@pytest.mark.parametrize("scale", [1.0, 3000.0])
def test_speed_that_follows_another_command_or_is_in_rpm_is_not_stuck(scale: float) -> None:
    """A measured speed without noise stays the same while one command is constant and the other one changes."""
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 200.0, 0.1)
    c = {}
    for side in ("left", "right"):
        command = np.repeat(rng.uniform(-0.5, 1.0, 20), 100)
        shaft = np.round(scale * np.interp(t - 0.15, t, command), 3)
        c |= {f"n_cmd_{side}": Channel(t, command, hold="zero"), f"n_{side}": Channel(t + 1e-3, shaft, hold="linear")}
    in_rpm = ["n-out-of-range"] * 2 if scale > 1.0 else []
    assert faults(c) == in_rpm
    c["n_left"], c["n_right"] = c["n_right"], c["n_left"]
    assert any(f.code == "shaft-speed-stuck" for f in check_inputs(c))
    assert faults(c) == ["telemetry-exchanged", *in_rpm]


def test_exchanged_telemetry_is_found_although_both_sides_are_driven_alike() -> None:
    """Most of both commands is the thrust ahead, so that each shaft also follows the command of the other side."""
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 200.0, 0.1)
    ahead, turn = (np.repeat(rng.uniform(low, high, 40), 50) for low, high in ((-0.2, 0.8), (-0.2, 0.2)))
    c = {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        command = ahead + sign * turn
        n = np.interp(t - 0.15, t, command) + 0.005 * rng.standard_normal(t.size)
        c |= {f"n_cmd_{side}": Channel(t, command, hold="zero"), f"n_{side}": Channel(t + 1e-3, n)}
    assert not faults(c)
    c["n_left"], c["n_right"] = c["n_right"], c["n_left"]
    assert faults(c) == ["telemetry-exchanged"]


def test_command_with_the_wrong_sign_is_no_stuck_shaft() -> None:
    """The noiseless speeds of a controller are constant between commands, and then they are against the command."""
    t = np.arange(0.0, 200.0, 0.1)
    level = np.repeat(np.random.default_rng(2).choice([0.3, 0.5, 0.7, 0.9], 20), 100)
    command, shaft = Channel(t, -level, hold="zero"), Channel(t + 1e-3, np.round(level, 2), hold="linear")
    c = log(ATTITUDE, VELOCITY) | {"n_cmd_left": command, "n_left": shaft}
    assert [f.code for f in check_inputs(c)] == []
    stopped = np.where((t > 100.0) & (t < 130.0), 0.0, level)
    against = c | {"n_cmd_left": replace(command, value=stopped), "n_left": replace(shaft, value=np.full(t.size, 0.6))}
    assert [f.code for f in check_inputs(against)] == ["shaft-speed-stuck"]
