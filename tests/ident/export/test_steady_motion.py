"""Tests of steady motion: the balance of thrust and drag, the end of a simulation, and the spread of sampled models."""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np
import pytest

from seatrial.ident.data.record import Channel, build_record
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.export.formats import export
from seatrial.ident.export.rates import Rates
from seatrial.ident.export.steady_motion import steady_motion, straight_motion
from seatrial.ident.model.structure import Model
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from tests.ident.exported import saved, simulate_python

VALUES = {"m_u": 37.0, "m_v": 47.0, "m_r": 9.7, "d_u": 2.0, "d_uu": 25.0, "d_v": 50.0, "d_vv": 20.0, "d_r": 8.0}
VALUES |= {"d_rr": 6.2, "c1": 40.0, "c2": 1.0, "V_x": 0.2, "V_y": -0.1}
STRAIGHT = ("v", "r")
TURNING = np.array([1.0, -1.0])  # left ahead, right astern


@pytest.fixture(scope="module")
def model() -> Model:
    return with_disturbances(horizontal_model("shaft")).with_values(VALUES)


def speed(n: float, values: dict[str, float]) -> float:
    """Return the speed at which linear and quadratic drag balance the thrust of both shafts."""
    thrust = 2.0 * (values["c1"] * n * abs(n) + values["c2"] * n * n)
    a, b = values["d_uu"], values["d_u"]
    return math.copysign((-b + math.sqrt(b * b + 4.0 * a * abs(thrust))) / (2.0 * a), thrust)


def test_straight_speed_balances_thrust_and_drag_in_still_water(model: Model) -> None:
    n = np.array([-1.0, -0.3, 0.2, 0.7, 1.0])
    found, sd = steady_motion(model, np.stack([n, n], axis=1), held=STRAIGHT).of("u")
    np.testing.assert_allclose(found, [speed(k, VALUES) for k in n], rtol=1e-6)
    assert np.isnan(sd).all()
    with pytest.raises(KeyError, match="no state 'r'; its states are u"):
        steady_motion(model, np.array([[0.5, 0.5]]), held=STRAIGHT).of("r")


def test_the_search_ends_when_all_motions_are_reached(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    """A fit searches for four curves, which take a fifth of its time. A motion that is not reached takes all steps."""
    calls, evaluate = [], Rates.__call__

    def counted(rates: Rates, *arguments: Any) -> Any:
        calls.append(rates)
        return evaluate(rates, *arguments)

    monkeypatch.setattr(Rates, "__call__", counted)
    n = np.linspace(-1.0, 1.0, 9)
    found = steady_motion(model, np.stack([n, 0.5 * n], axis=1))
    assert 20 < len(calls) < 30
    monkeypatch.setattr(sys.modules[steady_motion.__module__], "REACHED", -1.0)
    np.testing.assert_allclose(steady_motion(model, np.stack([n, 0.5 * n], axis=1)).x, found.x, rtol=1e-12, atol=1e-14)
    assert len(calls) > 100


def test_turn_is_the_end_of_a_simulation(model: Model) -> None:
    left, right = 0.6, 0.1
    found = steady_motion(model, np.array([[left, right]]))
    t = np.arange(0.0, 120.0, 0.1)
    still = model.with_values({"V_x": 0.0, "V_y": 0.0})
    channels = {n: Channel(t, np.full(t.size, v)) for n, v in (("n_left", left), ("n_right", right))}
    channels |= {o.name: Channel(t, np.zeros(t.size)) for o in still.sensors[0].outputs}
    run = simulate(still, build_record(still, channels))
    names = [s.name for s in still.states]
    for state in ("u", "v", "r"):
        assert found.of(state)[0][0] == pytest.approx(run.x[-1, names.index(state)], rel=1e-3)


def test_errors_are_the_spread_of_sampled_models(model: Model) -> None:
    names = ("d_u", "d_uu", "c1", "V_x@0")
    half = np.array([[0.5, 0, 0, 0], [-3.0, 1.0, 0, 0], [0.2, 0.1, 0.3, 0], [0, 0, 0, 1.0]])
    covariance = half @ half.T
    _, sd = steady_motion(model, np.array([[0.7, 0.7]]), names, covariance, STRAIGHT).of("u")
    samples = np.random.default_rng(0).multivariate_normal(
        [VALUES["d_u"], VALUES["d_uu"], VALUES["c1"], 0], covariance, 4000
    )
    spread = np.std([speed(0.7, VALUES | dict(zip(names, row, strict=True))) for row in samples])
    assert sd[0] == pytest.approx(spread, rel=0.05)


def test_inputs_without_a_steady_motion_are_gaps(model: Model) -> None:
    """With negative damping the boat accelerates for ever."""
    wild = model.with_values({"d_u": 0.0, "d_uu": 0.0})
    found, _ = steady_motion(wild, np.array([[0.5, 0.5]]), held=STRAIGHT).of("u")
    assert np.isnan(found).all()


def test_sides_of_a_straight_course_keep_it_in_the_exported_model(model: Model) -> None:
    """The right thruster loses 45 % of its thrust in reverse: equal commands astern turn the boat."""
    lossy = (model + catalogue()["reverse-mismatch"]).with_values({"rho_left": 0.0, "rho_right": 0.45})
    lossy = lossy.with_values({"V_x": 0.0, "V_y": 0.0})
    mean = np.array([-0.8, -0.4, 0.5])
    found = straight_motion(lossy, np.stack([mean, mean], axis=1), TURNING)
    assert found.difference[2] == pytest.approx(0.0, abs=1e-6)
    # The thrust of both sides is equal: the left one turns slower.
    left, right = mean + found.difference, mean - found.difference
    np.testing.assert_allclose(left[:2] / right[:2], math.sqrt(0.55), rtol=1e-6)
    one_side = VALUES["c1"] * left[0] * abs(left[0]) + VALUES["c2"] * left[0] ** 2
    thrust = math.copysign(math.sqrt(abs(one_side) / (VALUES["c1"] - VALUES["c2"])), one_side)
    assert found.speed[0] == pytest.approx(speed(thrust, VALUES), rel=1e-6)
    content = saved(lossy)
    text = str(export(content, "python"))
    states = [s.name for s in lossy.states]
    kept = [states.index(n) for n in ("u", "v", "r") if n in states]
    for k in range(mean.size):
        x = np.zeros(len(states))
        x[states.index("u")] = found.speed[k]
        at = np.array([left[k], right[k]])
        run, _ = simulate_python(text, x[: _exported_states(text)], at, np.tile(at, (50, 1)), 0.1)
        np.testing.assert_allclose(run[:, kept], np.tile([found.speed[k], 0.0, 0.0], (50, 1)), atol=1e-5)
    # Equal commands astern do not: the boat turns.
    x[states.index("u")] = -0.9
    equal = np.full(2, mean[0])
    run, _ = simulate_python(text, x[: _exported_states(text)], equal, np.tile(equal, (50, 1)), 0.1)
    assert abs(run[-1, kept[2]]) > 0.1


def _exported_states(text: str) -> int:
    """Return the number of states of a Python export."""
    space: dict[str, Any] = {"__name__": "boat"}
    exec(compile(text, "boat.py", "exec"), space)
    return len(space["STATES"])


def test_growth_of_a_straight_course_is_that_of_the_free_boat(model: Model) -> None:
    """The Munk moment makes a slender boat leave its course: the speed is found all the same, with a growth."""
    n = np.array([[0.7, 0.7]])
    stable, unstable = (straight_motion(model.with_values({"d_v": d, "d_r": d}), n, TURNING) for d in (50.0, 1.0))
    assert stable.growth[0] < 0.0 < unstable.growth[0]
    assert stable.speed[0] == pytest.approx(unstable.speed[0], rel=1e-9)


def test_straight_course_beside_a_yaw_moment_at_zero_command_has_a_difference(model: Model) -> None:
    """At zero command a difference of the sides has no first-order effect on the moment that holds the course."""
    biased = (model + catalogue()["yaw-bias"]).with_values({"N_0": 1.0})
    found = straight_motion(biased, np.array([[0.0, 0.0], [0.5, 0.5]]), TURNING)
    assert np.isfinite(found.speed).all()
    assert (found.difference < -1e-3).all()


def test_errors_of_a_straight_course_are_the_spread_of_sampled_models(model: Model) -> None:
    """The standard error includes that of the difference, which follows the estimated loss."""
    lossy = (model + catalogue()["reverse-mismatch"]).with_values({"rho_left": 0.0, "rho_right": 0.45})
    n = np.array([[-0.8, -0.8]])
    sd = straight_motion(lossy, n, TURNING, ("rho_right",), np.array([[0.02**2]])).sd[0]
    either = [straight_motion(lossy.with_values({"rho_right": 0.45 + d}), n, TURNING).speed[0] for d in (0.02, -0.02)]
    assert sd == pytest.approx(0.5 * abs(either[0] - either[1]), rel=1e-3)
