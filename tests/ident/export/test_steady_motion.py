"""Tests of steady motion: the balance of thrust and drag, the end of a simulation, and the spread of sampled models."""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np
import pytest

from seatrial.ident.data.record import Channel, build_record
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.export.rates import Rates
from seatrial.ident.export.steady_motion import steady_motion
from seatrial.ident.model.structure import Model
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model

VALUES = {"m_u": 37.0, "m_v": 47.0, "m_r": 9.7, "d_u": 2.0, "d_uu": 25.0, "d_v": 50.0, "d_vv": 20.0, "d_r": 8.0}
VALUES |= {"d_rr": 6.2, "c1": 40.0, "c2": 1.0, "V_x": 0.2, "V_y": -0.1}
STRAIGHT = ("v", "r")


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
