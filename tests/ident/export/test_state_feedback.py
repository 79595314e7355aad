"""Tests of the LQR of a linear model: it equals SciPy's, and holds speed and heading of the simulated boat."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from seatrial.daq.errors import SeatrialError
from seatrial.ident.export.formats import export
from seatrial.ident.export.linearisation import LinearModel, linearise
from seatrial.ident.models.horizontal import horizontal_model
from tests.ident.export.test_linearisation import VALUES, saved
from tests.ident.exported import saved as saved_model

Q = {"u": 4.0, "r": 1.0, "psi": 4.0}


@pytest.fixture(scope="module", params=["shaft", "command", "force"])
def linear(request: pytest.FixtureRequest) -> LinearModel:
    model = horizontal_model(request.param)
    return linearise(model.with_values({n: v for n, v in VALUES.items() if n in model.values}), 0.7)


def test_gain_is_that_of_the_riccati_equation(linear: LinearModel) -> None:
    found = linear.lqr(Q, {linear.inputs[0]: 2.0})
    n = len(linear.states)
    assert found.states == (*linear.states, "psi")
    A, B = np.zeros((n + 1, n + 1)), np.zeros((n + 1, 2))
    A[:n, :n], B[:n] = linear.A, linear.B
    A[n, linear.states.index("r")] = 1.0
    weights = np.diag([Q.get(s, 0.0) for s in found.states])
    expected = np.diag([0.5, 1.0]) @ B.T @ solve_continuous_are(A, B, weights, np.diag([2.0, 1.0]))
    np.testing.assert_allclose(found.gain, expected, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(np.sort_complex(found.poles), np.sort_complex(np.linalg.eigvals(A - B @ expected)))
    assert np.all(found.poles.real < 0.0)
    assert "psi" in repr(found)
    assert linear.inputs[1] in repr(found)


@pytest.mark.parametrize("propulsion", ["shaft", "command"])
def test_feedback_steers_the_exported_boat(propulsion: Any) -> None:
    """The same lines work for both kinds of input: the shaft states have no weight."""
    model = saved(horizontal_model(propulsion), {"V_x": 0.0, "V_y": 0.0})
    control = linearise(model, 0.7).lqr(Q)
    space: dict[str, Any] = {"__name__": "boat"}
    exec(compile(str(export(saved_model(model), "python")), "boat.py", "exec"), space)
    simulation = space["Simulation"](0.1, hold="zero")
    for _ in range(500):
        commands = control(dict(zip(space["STATES"], simulation.x, strict=True)), psi=np.radians(200.0), u=0.6)
        assert np.abs(commands).max() <= 1.0
        simulation.step(commands)
    x = dict(zip(space["STATES"], simulation.x, strict=True))
    assert np.degrees(x["psi"]) % 360.0 == pytest.approx(200.0, abs=0.1)
    assert x["psi"] < 0.0  # the shorter turn is to port
    assert 0.6 <= x["u"] < 0.68  # without an integral the speed stays between the wanted one and that of u0


def test_wrong_weights_and_names_are_refused(linear: LinearModel) -> None:
    for weights, costs, words in (
        ({"heading": 1.0}, None, "the model has no state 'heading'; its states are u, v, r"),
        ({"psi_": 1.0}, None, "did you mean 'psi'"),
        ({"u": -1.0}, None, "the weight of u is -1: give a number of at least 0"),
        ({"u": 1.0}, {linear.inputs[0]: 0.0}, "is 0: give a number above 0"),
        ({"u": 1.0}, {"n_top": 1.0}, "the model has no input 'n_top'"),
    ):
        with pytest.raises(SeatrialError, match=words):
            linear.lqr(weights, costs)
    control = linear.lqr(Q)
    with pytest.raises(SeatrialError, match="the state psi is missing; the feedback needs"):
        control(dict.fromkeys(linear.states, 0.0))
    with pytest.raises(SeatrialError, match="the model has no state 'heading'"):
        control(dict.fromkeys(control.states, 0.0), heading=1.0)
    assert "psi" not in linear.lqr({"u": 1.0, "r": 1.0}).states
