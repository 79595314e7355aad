"""Tests of the conditions of a linear model: time, work, place and heading are constant and no inputs."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from seatrial.daq.errors import SeatrialError
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.engine import VectorisedModel
from seatrial.ident.estimation.parameter_covariance import ParameterCovariance
from seatrial.ident.export.conditions import chosen_conditions, conditions_of, conditions_text, moving_states
from seatrial.ident.export.linearisation import linearise
from seatrial.ident.export.steady_motion import steady_motion
from seatrial.ident.model.structure import Model
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.nomoto import nomoto_model
from seatrial.ident.workflows.dynamics import Drives, steady_curves
from tests.ident.export.test_linearisation import saved


def boat(*effects: str, **values: float) -> Model:
    model = horizontal_model("shaft")
    for name in effects:
        model = model + catalogue()[name]
    return saved(with_disturbances(model), values)


def test_conditions_are_those_of_the_functions_of_a_model() -> None:
    """Two models with the same names have different conditions if their functions differ."""
    moved = boat("payload-shift", t_shift=100.0, x_shift=0.1)
    still = replace(moved, effects=tuple(e for e in moved.effects if e.name != "payload-shift"))
    for _ in range(2):
        assert (conditions_of(moved), conditions_of(still)) == (("t",), ())


def test_payload_is_where_it_is_after_its_shift() -> None:
    """The linear model has the inputs of the boat only, and the matrices of a boat with the payload there."""
    moved = boat("payload-shift", t_shift=100.0, x_shift=0.1, y_shift=0.02, x_before=0.03)
    found = linearise(moved, 0.7)
    assert found.inputs == ("n_left", "n_right")
    assert found.conditions == {"t": 110.0}
    assert "taken as constant: t = 110 s" in repr(found)
    fixed = linearise(boat("cg-offset", x_g=0.13, y_g=0.02), 0.7)
    np.testing.assert_allclose(found.A, fixed.A, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(found.u0, fixed.u0, rtol=1e-6)
    before = linearise(moved, 0.7, conditions={"t": 20.0})
    np.testing.assert_allclose(before.A, linearise(boat("cg-offset", x_g=0.03), 0.7).A, rtol=1e-5, atol=1e-7)
    assert np.abs(before.A - found.A).max() > 1e-3
    u = found.u0[None]
    assert steady_motion(moved, u).of("u")[0] == pytest.approx(
        steady_motion(moved, u, conditions={"t": 1e3}).of("u")[0]
    )
    assert list(Drives(moved, {"n_left": (0.0, 1.0), "n_right": (0.0, 1.0)}).names) == ["n_left", "n_right"]


def test_place_and_heading_of_a_bank_can_be_chosen() -> None:
    model = boat("bank", N_bank=0.5, N_slope=0.1, psi_bank=0.5)
    at_origin, near = (linearise(model, 0.7, conditions=at) for at in ({}, {"x": 10.0, "psi": 0.5}))
    assert at_origin.conditions == {"x": 0.0, "y": 0.0, "psi": 0.0}
    assert near.conditions == {"x": 10.0, "y": 0.0, "psi": 0.5}
    assert np.abs(at_origin.u0 - near.u0).max() > 1e-3
    assert conditions_text(near.conditions) == "x = 10 m, y = 0 m, psi = 0.5 rad"


def test_defaults_are_the_end_of_the_data() -> None:
    model = boat("payload-shift", "battery-sag", t_shift=100.0)
    assert conditions_of(model) == ("t", "work")
    assert chosen_conditions(model, {"t": (0.0, 300.0), "work": (0.0, 2.0)}) == {"t": 300.0, "work": 2.0}
    assert chosen_conditions(model, {"t": (0.0, 300.0)}, {"t": 5}) == {"t": 5.0, "work": 0.0}
    assert chosen_conditions(boat(), {"t": (0.0, 300.0)}, {"t": 5.0}) == {}
    assert linearise(boat(), 0.7).conditions == {}
    with pytest.raises(SeatrialError, match="there is no condition 'works'; did you mean 'work'"):
        linearise(model, 0.7, conditions={"works": 1.0})
    with pytest.raises(SeatrialError, match="the condition t is nan: give a finite number"):
        linearise(model, 0.7, conditions={"t": float("nan")})


@pytest.mark.parametrize("name", ["compass-filtered", "compass-motor"])
def test_filter_of_a_compass_is_no_part_of_the_motion(name: str) -> None:
    """A boat whose compass errs is linearised, turns and is controlled as the same boat with a compass that does not.

    The states of the filter have rates that depend on the heading.
    """
    amplitudes = {"compass-filtered": {"dev_f1s": 0.2, "dev_f2c": -0.1}, "compass-motor": {"dev_ms": 0.1}}
    model, plain = boat(name, **amplitudes[name]), boat()
    added = {s.name for s in model.states} - {s.name for s in plain.states}
    assert added
    assert conditions_of(model) == ()
    found, expected = linearise(model, 0.7), linearise(plain, 0.7)
    assert found.states == expected.states == ("u", "v", "r")
    np.testing.assert_array_equal(found.A, expected.A)
    np.testing.assert_array_equal(found.by_heading, [0.0, 0.0, 0.0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        feedback = found.lqr({"u": 4.0, "r": 1.0, "psi": 4.0})
    assert feedback.states == ("u", "v", "r", "psi")
    assert np.isfinite(feedback({"u": 0.6, "v": 0.0, "r": 0.0, "psi": 0.1}, psi=0.3)).all()
    u = np.array([[0.6, 0.1], [0.3, 0.3]])
    np.testing.assert_array_equal(steady_motion(model, u).x, steady_motion(plain, u).x)
    ranges = {"n_left": (-0.5, 1.0), "n_right": (-0.5, 1.0)}
    turns = [c for c in steady_curves(model, ranges, ParameterCovariance((), np.zeros((0, 0)))) if c.motion == "turn"]
    assert [t.mean for t in turns] == [0.0, 0.5, 0.25]


def test_gyro_filter_of_the_nomoto_model_is_no_part_of_the_motion() -> None:
    assert moving_states(nomoto_model()) == ("u", "v", "r")


@pytest.mark.parametrize(
    ("name", "states", "depends"),
    [
        ("wind", (), ("psi",)),
        ("towed-line", ("line_x", "line_y"), ()),
        ("derating", ("heat_left", "heat_right"), ()),
        ("waves", ("wave_X", "wave_X_rate", "wave_Y", "wave_Y_rate", "wave_N", "wave_N_rate"), ()),
    ],
)
def test_states_and_conditions_of_forces_stay(name: str, states: tuple[str, ...], depends: tuple[str, ...]) -> None:
    model = horizontal_model("shaft") + catalogue()[name]
    assert moving_states(model) == ("u", "v", "r", *states)
    assert conditions_of(model) == depends


def test_states_that_are_left_out_change_no_velocity() -> None:
    """For each effect of the boat: the rates of the velocities are the same with all other states moved."""
    rng, kept = np.random.default_rng(0), 0
    for name, effect in catalogue().items():
        try:
            model = with_disturbances(horizontal_model("command") + effect)
        except ValueError:  # an effect of another model
            continue
        names = [s.name for s in model.states]
        moving = set(moving_states(model)) | set(conditions_of(model))
        x, u = rng.uniform(0.1, 0.6, len(names)), rng.uniform(0.1, 0.6, len(model.inputs))
        p = {k: v if v else 0.1 for k, v in model.values.items()}
        velocities = [names.index(n) for n in ("u", "v", "r")]
        whole = VectorisedModel(model)
        before, slope = (f(x[None], u[None], np.array(list(p.values())))[0] for f in (whole.rates, whole.rate_jacobian))
        others = [j for j, n in enumerate(names) if n not in moving]
        x[others] += rng.uniform(0.1, 0.3, len(others))
        after = whole.rates(x[None], u[None], np.array(list(p.values())))[0]
        np.testing.assert_allclose(after[velocities], before[velocities], rtol=0.0, atol=1e-13, err_msg=name)
        # what acts on a velocity at once is kept
        assert {n for j, n in enumerate(names) if slope[velocities][:, j].any()} <= moving, name
        kept += 1
    assert kept > 40
