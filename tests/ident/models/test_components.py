"""Tests of the components antenna, wandering current, thrust calibration and estimator error."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from seatrial.daq.errors import SeatrialError
from seatrial.ident.data.record import build_record
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.engine.vectorised_model import VectorisedModel
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.maximum_likelihood import SearchSettings, fit
from seatrial.ident.estimation.model_file import FittedData, load_model, save_model
from seatrial.ident.estimation.prior_knowledge import apply_rig_geometry
from seatrial.ident.model.parameter import ParameterOrigin
from seatrial.ident.models.catalogue import make_model
from seatrial.ident.models.components import (
    antenna,
    current_walk,
    estimator_error,
    estimator_error_units,
    thrust_calibration,
)
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from tests.missions import boat_with, channels_of, sail

pytestmark = pytest.mark.usefixtures("quick_compilation")


def outputs(model, x, u):
    return VectorisedModel(model)(x, u, np.array(list(model.values.values())))


def test_antenna_component_equals_the_lever_arm_effect() -> None:
    base = with_disturbances(make_model("horizontal:shaft"))
    arm = catalogue()["lever-arm"]
    x, u = np.random.default_rng(3).normal(size=(20, len(base.states))), np.full((20, 2), 0.4)
    here = outputs(base + antenna(0.4, -0.2), x, u)
    there = (base + arm).with_values({"l_x": 0.4, "l_y": -0.2})
    np.testing.assert_allclose(here, outputs(there, x, u), rtol=1e-12)


def test_antenna_position_of_the_rig_file_is_known_and_its_error_is_a_candidate() -> None:
    device = SimpleNamespace(lever_arm_m=(0.4, 0.0, -0.5))
    rig = SimpleNamespace(vehicle={}, thrusters=(), devices=(SimpleNamespace(lever_arm_m=(0.0, 0.0, 0.0)), device))
    model, notes = apply_rig_geometry(make_model("horizontal:shaft"), rig)
    assert not notes
    assert model.values["antenna_x"] == 0.4
    assert "antenna_x" not in model.free
    assert model.accepts(catalogue()["lever-arm"])


@pytest.mark.parametrize(("source", "n_inputs"), [("horizontal:force", 2), ("surge:force:speed", 1)])
def test_thrust_calibration_factor_scales_the_thrust(source: str, n_inputs: int) -> None:
    base = make_model(source)
    model = base + thrust_calibration(base, 0.05)
    n = len(base.states)
    rng = np.random.default_rng(3)
    x, u = rng.normal(size=(20, n)), rng.normal(size=(20, n_inputs))
    more = outputs(model.with_values({"k_thrust": 1.2}), x, u)
    np.testing.assert_allclose(more, outputs(base, x, 1.2 * u), rtol=1e-12)
    np.testing.assert_allclose(outputs(model, x, u), outputs(base, x, u), rtol=1e-12)
    assert model.parameter("k_thrust").prior == (1.0, 0.05)


def test_wandering_current_makes_the_position_less_certain() -> None:
    still, walk = (
        with_disturbances(make_model(s)) for s in ("horizontal:shaft", "horizontal:shaft:random-walk-current")
    )
    assert "q_V" in walk.free
    record = build_record(walk, channels_of(sail(boat_with(None, 1), 40.0, 1)[0]))
    certain, open_ = (
        Likelihood(m).filter(record.for_model(m), np.array(list(m.values.values()))).P_filt[-1, 0, 0]
        for m in (still, walk)
    )
    assert open_ > certain


def test_unknown_option_gives_a_one_line_error() -> None:
    with pytest.raises(SeatrialError, match="after horizontal: give one of shaft, command, force, general"):
        make_model("horizontal:sail")


def test_components_are_restored_from_a_model_file(tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    base = make_model("horizontal:shaft:random-walk-current")
    full = with_disturbances(base + antenna(0.3, 0.1) + estimator_error([s.name for s in base.sensors])).with_free(
        ["m_r"]
    )
    record = build_record(full, channels_of(sail(boat_with(None, 1), 30.0, 1)[0]))
    save_model(path, fit(full, [record], settings=SearchSettings(max_iterations=2)), data=FittedData(), provenance={})
    model = load_model(path).model
    assert {"antenna", "random-walk-current", "estimator-error"} <= {e.name for e in model.effects}
    assert [s.name for s in model.states] == [s.name for s in full.states]
    assert model.values["antenna_x"] == pytest.approx(0.3)


def test_estimator_errors_have_the_stationary_size_of_their_parameters() -> None:
    """The states have unit driving noise. The stationary standard deviation of the error must be A for any tau."""
    sensors = ("attitude", "gyro", "position", "body_velocity")
    model = (horizontal_model("shaft", sensors) + estimator_error(sensors)).with_values({"A_xy": 0.3, "tau_xy": 7.0})
    names = [s.name for s in model.states]
    assert {p.origin for p in model.effects[-1].parameters} == {ParameterOrigin.BUILT_IN}  # The priors are built in.
    k, y = names.index("error_x"), len(names) + [o.name for o in model.outputs].index("x")
    x = np.zeros((2, len(names)))
    x[1, k] = 1.0
    found = outputs(model, x, np.zeros((2, len(model.inputs))))
    decay, gain = found[1, k] - found[0, k], found[1, y] - found[0, y]
    assert decay == pytest.approx(-1 / 7.0)
    assert gain * np.sqrt(1 / (2 * -decay)) == pytest.approx(0.3)  # The variance of dz = -z/tau dt + dw is tau / 2.


def test_scaled_error_times_its_unit_is_the_error_of_the_reading() -> None:
    sensors = ("attitude", "gyro", "position", "ground_velocity")
    base = horizontal_model("shaft", sensors)
    model = (base + estimator_error(sensors)).with_values({"A_xy": 0.3, "tau_xy": 7.0, "A_psi": 0.02})
    units = estimator_error_units(model)
    assert units["error_x"][1] == "m"
    assert units["error_psi"][1] == "rad"
    assert estimator_error_units(base) == {}
    at = [0.0] * len(base.states)
    for state, (factor, _) in units.items():
        error = [float(x.name == state) for x in model.states[len(at) :]]
        moved = model.signals([*at, *error], [0.0] * len(model.inputs), list(model.values.values())).y
        still = base.signals(at, [0.0] * len(base.inputs), list(base.values.values())).y
        axis = state.removeprefix("error_")
        if axis not in ("ax", "ay"):  # these act through the error of the velocity
            assert moved[axis] - still[axis] == pytest.approx(factor)


@pytest.mark.parametrize(
    ("sensors", "wanted"),
    [
        (("attitude", "gyro", "position", "body_velocity"), "r psi ax ay vx vy x y"),
        (("attitude", "position", "ground_velocity", "body_velocity"), "psi ax ay vx vy x y"),
        (("attitude", "accelerometer", "position"), "psi x y"),
    ],
)
def test_estimator_errors_follow_the_error_equations_of_inertial_navigation(
    sensors: tuple[str, ...], wanted: str
) -> None:
    """The reference are the error equations of a strapdown navigator in the plane.

    The heading error integrates the gyro error, the velocity error integrates the accelerations turned to north, and
    the position error integrates the velocity error. The heading error turns the body velocity.
    """
    model = horizontal_model("shaft", sensors) + estimator_error(sensors)
    own = [p.name for p in model.effects[-1].parameters]
    apart = dict(zip(own, (0.7, 1.1, 1.3, 1.7, 0.5, 1.9, 2.3, 0.9, 1.5, 3.1), strict=False))
    model = model.with_values({n: factor * model.values[n] for n, factor in apart.items()})
    plain, values = horizontal_model("shaft", sensors), model.values
    names, outs = [s.name for s in model.states], [o.name for o in model.outputs]
    assert " ".join(n.removeprefix("error_") for n in names[len(plain.states) :]) == wanted
    x = np.random.default_rng(4).normal(size=(10, len(names)))
    found = outputs(model, x, np.full((10, len(model.inputs)), 0.4))
    at = dict(zip(names, x.T, strict=True))
    rate = dict(zip(names, found[:, : len(names)].T, strict=True))
    y = dict(zip(outs, found[:, len(names) :].T, strict=True))
    still = outputs(plain, x[:, : len(plain.states)], np.full((10, len(plain.inputs)), 0.4))[:, len(plain.states) :]
    true = dict(zip(outs, still.T, strict=True))
    has = wanted.split()
    of = {"r": "r", "psi": "psi", "ax": "axy", "ay": "axy", "vx": "vxy", "vy": "vxy", "x": "xy", "y": "xy"}
    scale = {axis: values[f"A_{n}"] * np.sqrt(2 / values[f"tau_{n}"]) for axis, n in of.items() if axis in has}
    e = {axis: size * at[f"error_{axis}"] for axis, size in scale.items()}
    de = {axis: size * rate[f"error_{axis}"] + e[axis] / values[f"tau_{of[axis]}"] for axis, size in scale.items()}
    cos, sin, zero = np.cos(at["psi"]), np.sin(at["psi"]), np.zeros(10)
    ax, ay, vx, vy = (e.get(n, zero) for n in ("ax", "ay", "vx", "vy"))
    parts = {"psi": e.get("r", zero), "vx": cos * ax - sin * ay, "vy": sin * ax + cos * ay, "x": vx, "y": vy}
    for axis in e:
        np.testing.assert_allclose(de[axis], parts.get(axis, zero), atol=1e-12, err_msg=axis)
    for name in y.keys() & {"psi", "r", "x", "y", "vx", "vy"}:
        np.testing.assert_allclose(y[name], true[name] + e.get(name, zero), atol=1e-12, err_msg=name)
    if "u" in y:
        ground = (true["u"] + 1j * true["v"]) * np.exp(1j * at["psi"]) + vx + 1j * vy
        body = ground * np.exp(-1j * (at["psi"] + e["psi"]))
        np.testing.assert_allclose(y["u"] + 1j * y["v"], body, atol=1e-12)


def test_estimator_errors_start_with_the_errors_that_they_integrate() -> None:
    """The reference is Lyapunov's equation at the default values. The uncertain correlation times double it."""
    sensors = ("attitude", "gyro", "position", "ground_velocity")
    model = horizontal_model("shaft", sensors) + estimator_error(sensors)
    first = len(model.states) - 8
    x = np.zeros((1, len(model.states)))
    u, values = np.zeros((1, len(model.inputs))), np.array(list(model.values.values()))
    A = VectorisedModel(model).rate_jacobian(x, u, values)[0][first:, first:]
    stationary = np.sqrt(np.diag(solve_continuous_lyapunov(A, -np.eye(8))))
    begins = np.array([s.sd0 for s in model.states[first:]])
    np.testing.assert_allclose(begins, 2.0 * stationary, rtol=0.05)


def test_estimator_errors_in_an_older_format_are_rejected(tmp_path: Path) -> None:
    """In older files, A_vxy was the size of the total error. Read as its own part, a navigation filter would be
    overconfident.
    """
    path, sensors = tmp_path / "model.toml", ("attitude", "gyro", "position", "ground_velocity")
    base = with_disturbances(horizontal_model("shaft", sensors) + estimator_error(sensors)).with_free(["m_r"])
    record = build_record(base, channels_of(sail(boat_with(None, 1), 30.0, 1)[0]))
    save_model(path, fit(base, [record], settings=SearchSettings(max_iterations=1)), data=FittedData(), provenance={})
    rows = path.read_text(encoding="utf-8").split("[[parameter]]")
    assert any('name = "A_axy"' in row for row in rows)
    path.write_text("[[parameter]]".join(r for r in rows if 'name = "A_axy"' not in r), encoding="utf-8")
    with pytest.raises(SeatrialError, match="navigation errors are stored in an older format"):
        load_model(path)


def test_body_velocity_over_ground_includes_every_current() -> None:
    """The reference is the velocity over ground, turned into body axes, for a wandering and a drifting current."""
    sensors = ("attitude", "ground_velocity", "body_velocity")
    for part in (current_walk(), catalogue()["current-drift"]):
        model = (horizontal_model("shaft", sensors) + part).with_values({"V_x": 0.2})
        at = {n: i for i, n in enumerate(v.name for v in model.states)}
        y = {o.name: len(model.states) + j for j, o in enumerate(model.outputs)}
        x = np.random.default_rng(3).normal(size=(20, len(model.states)))
        values = np.array([0.1 if n == "V_dx" else v for n, v in model.values.items()])
        found = VectorisedModel(model)(x, np.full((20, len(model.inputs)), 0.4), values)
        psi, vx, vy = x[:, at["psi"]], found[:, y["vx"]], found[:, y["vy"]]
        still = np.cos(psi) * x[:, at["u"]] - np.sin(psi) * x[:, at["v"]]
        assert np.abs(vx - still - 0.2).max() > 0.01, part.name
        np.testing.assert_allclose(found[:, y["u"]], np.cos(psi) * vx + np.sin(psi) * vy, atol=1e-12)
        np.testing.assert_allclose(found[:, y["v"]], np.cos(psi) * vy - np.sin(psi) * vx, atol=1e-12)
