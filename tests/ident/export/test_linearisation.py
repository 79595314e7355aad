"""Tests of the linearisation: it equals the derivatives of the equations of motion, and its step response the simulated
motion after a small step.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from seatrial.daq.errors import SeatrialError
from seatrial.ident.data.record import Channel, build_record
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.model_file import SavedModel
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.export.linearisation import Linearisation, linearise
from seatrial.ident.model.structure import Model
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.yaw import yaw_model

VALUES = {"m_u": 37.0, "m_v": 47.0, "m_r": 9.7, "d_u": 2.0, "d_uu": 25.0, "d_v": 50.0, "d_vv": 20.0, "d_r": 4.1}
VALUES |= {"d_rr": 6.2, "c1": 40.0, "c2": 1.1, "V_x": 0.2, "V_y": -0.1}


def saved(model: Model, values: dict[str, float] | None = None) -> SavedModel:
    return SavedModel(model.with_values(VALUES | (values or {})), {}, {})


@pytest.fixture(scope="module")
def found() -> Linearisation:
    return linearise(saved(with_disturbances(horizontal_model("shaft"))), 0.7)


def test_matrices_are_the_derivatives_of_the_equations_of_motion(found: Linearisation) -> None:
    """Fossen's surge, sway and yaw with Coriolis terms of the lumped masses, in still water."""
    p, u = VALUES, 0.7
    assert found.states == ("u", "v", "r")
    assert found.inputs == ("n_left", "n_right")
    thrust = (p["d_u"] + p["d_uu"] * u) * u / 2
    n = math.sqrt(thrust / (p["c1"] + p["c2"]))
    np.testing.assert_allclose(found.u0, [n, n], rtol=1e-8)
    np.testing.assert_allclose(found.x0, [u, 0.0, 0.0], atol=1e-9)
    slope, arm = 2 * n * (p["c1"] + p["c2"]), 0.15
    np.testing.assert_allclose(found.B[0], [slope / p["m_u"]] * 2, rtol=1e-6)
    np.testing.assert_allclose(found.B[2], [slope * arm / p["m_r"], -slope * arm / p["m_r"]], rtol=1e-6)
    assert found.A[0, 0] == pytest.approx(-(p["d_u"] + 2 * p["d_uu"] * u) / p["m_u"], rel=1e-6)
    np.testing.assert_allclose(found.A[0, 1:], 0.0, atol=1e-6)
    assert found.A[1, 1] == pytest.approx(-p["d_v"] / p["m_v"], rel=1e-3)  # |v| v has a slope of 1e-5 in the difference
    assert found.A[1, 2] == pytest.approx(-p["m_u"] * u / p["m_v"], rel=1e-6)
    assert found.A[2, 1] == pytest.approx((p["m_u"] - p["m_v"]) * u / p["m_r"], rel=1e-6)
    assert found.A[2, 2] == pytest.approx(-p["d_r"] / p["m_r"], rel=1e-3)
    assert found.delays == {}


def test_poles_and_time_constants(found: Linearisation) -> None:
    surge = found.A[0, 0]
    assert np.isclose(found.poles, surge).any()
    np.testing.assert_allclose(np.sort(found.poles.real), np.sort(np.linalg.eigvals(found.A).real))
    assert (np.diff(np.abs(found.poles.real)) >= 0).all()
    np.testing.assert_allclose(found.time_constants, -1 / found.poles.real)
    assert found.stable


def test_step_response_is_the_motion_after_a_small_step(found: Linearisation) -> None:
    model = horizontal_model("shaft").with_values(VALUES | {"V_x": 0.0, "V_y": 0.0})
    t, step = np.arange(0.0, 12.0, 0.1), 1e-3
    inputs = {"n_left": found.u0[0] + step + 0 * t, "n_right": found.u0[1] + 0 * t, "psi": 0 * t}
    record = build_record(model, {name: Channel(t, z) for name, z in inputs.items()})
    start = np.zeros(len(model.states))
    names = [s.name for s in model.states]
    start[names.index("u")] = 0.7
    run = simulate(model, record, x0=start)
    expected = found.step_response("n_left", run.t - run.t[0])
    for name in ("u", "v", "r"):
        moved = run.x[:, names.index(name)] - start[names.index(name)]
        np.testing.assert_allclose(moved, step * expected[name], atol=0.01 * np.abs(moved).max())
    with pytest.raises(KeyError, match="the model has no input 'n_top'"):
        found.step_response("n_top", t)


def test_weaker_side_and_the_shafts_of_a_command_model() -> None:
    model = horizontal_model("command") + catalogue()["mismatch"]
    found = linearise(saved(model, {"eps_LR": -0.1}), 0.7)
    assert {"n_left", "n_right"} < set(found.states)
    assert found.inputs == ("n_cmd_left", "n_cmd_right")
    left, right = found.u0
    assert left > right > 0.0
    assert 0.9 * left**2 == pytest.approx(1.1 * right**2, rel=1e-3)
    assert set(found.delays) == {"n_cmd_left", "n_cmd_right"}
    assert found.stable


def test_speed_beyond_full_thrust_is_refused() -> None:
    with pytest.raises(SeatrialError, match=r"3 m/s needs n_left = 1\.\d\d, more than full"):
        linearise(saved(horizontal_model("shaft")), 3.0)
    with pytest.raises(SeatrialError, match="give a speed other than zero"):
        linearise(saved(horizontal_model("shaft")), 0.0)
    with pytest.raises(SeatrialError, match="has no forward speed u among its states"):
        linearise(SavedModel(yaw_model(), {}, {}), 0.5)
