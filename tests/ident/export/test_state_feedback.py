"""Tests of the LQR of a linear model: it equals SciPy's, and holds speed and heading of the simulated boat."""

from __future__ import annotations

import json
import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat
from scipy.linalg import solve_continuous_are

from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.export.formats import export
from seatrial.ident.export.linearisation import LinearModel, linearise
from seatrial.ident.model.structure import Model
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


def test_states_of_waves_are_no_part_of_the_feedback() -> None:
    """No input changes them, nobody measures them, and the other gains are the same without them."""
    model = horizontal_model("shaft")
    model = model.with_values({n: v for n, v in VALUES.items() if n in model.values})
    waves = catalogue()["waves"]
    calm, rough = linearise(model, 0.7), linearise(model + waves, 0.7)
    assert len(rough.states) > len(calm.states)
    found, expected = rough.lqr(Q), calm.lqr(Q)
    assert found.states == expected.states
    assert set(found.units) == {*found.states, *found.inputs}
    for name in ("gain", "x0", "u0", "poles"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-6, atol=1e-12)
    state = next(s for s in rough.states if s not in calm.states)
    with pytest.raises(SeatrialError, match=rf"the weight of {state}: no input changes this state; .* u, v, r$"):
        rough.lqr({**Q, state: 1.0})


def test_states_of_effects_that_nobody_measures_give_a_warning() -> None:
    """The feedback was written for a controller, which then found no message with these states."""
    model = horizontal_model("shaft")
    model = model.with_values({n: v for n, v in VALUES.items() if n in model.values})
    late = (model + catalogue()["lag"]).with_values({"T_lag": 0.3})
    with pytest.warns(SeatrialWarning, match="no sensor measures the states "):
        linearise(late, 0.7).lqr(Q)


def test_an_operating_point_near_the_limit_gives_a_warning(linear: LinearModel) -> None:
    """The feedback then has too little room to steer. Forces have no limit that the model knows."""
    steady = float(np.abs(linear.u0).max())
    if "f_left" in linear.inputs:
        linear.lqr(Q, limit=0.01)
        return
    linear.lqr(Q, limit=steady / 0.85)
    name = linear.inputs[int(np.abs(linear.u0).argmax())]
    words = rf"needs {name} = {steady:.3g}, more than 0\.9 of the limit .*lower speed, or give a larger limit$"
    with pytest.warns(SeatrialWarning, match=words):
        found = linear.lqr(Q, limit=steady / 0.95)
    fast = dict(zip(found.states, found.x0, strict=True)) | {"u": -5.0}
    np.testing.assert_allclose(found(fast), steady / 0.95)
    for limit in (0.0, 1.2):
        with pytest.raises(SeatrialError, match=f"limit {limit:g}: give the largest shaft speed or command"):
            linear.lqr(Q, limit=limit)


def test_inputs_stay_in_the_fitted_data_without_a_limit(linear: LinearModel) -> None:
    """The thrust beyond the data is extrapolated, so a larger limit of the user gives a warning."""
    ranges = dict.fromkeys(linear.inputs, (0.1, 0.8))
    control = replace(linear, ranges=ranges).lqr(Q)
    known = dict(zip(control.states, control.x0, strict=True))
    fast, slow = control(known | {"u": -5.0}), control(known | {"u": 5.0})
    if "f_left" in linear.inputs:  # forces have no limit that the model knows
        assert fast.min() > 0.8
        assert "limits" not in repr(control)
        return
    np.testing.assert_allclose(fast, 0.8)
    np.testing.assert_allclose(slow, 0.0)  # the feedback can stop the boat
    assert f"limits {linear.inputs[0]} 0 to 0.8" in repr(control)
    np.testing.assert_allclose(linear.lqr(Q)(known | {"u": -5.0}), 1.0)  # without a range of the data
    both = dict.fromkeys(linear.inputs, (-0.8, 0.8))
    words = rf"limit 0\.95: the data of the fit end before it \({linear.inputs[0]} -0\.8 to 0\.8"
    with pytest.warns(SeatrialWarning, match=words):
        wide = replace(linear, ranges=both).lqr(Q, limit=0.95)
    np.testing.assert_allclose(wide(known | {"u": -5.0}), 0.95)
    with warnings.catch_warnings():
        warnings.simplefilter("error", SeatrialWarning)
        replace(linear, ranges=both).lqr(Q, limit=0.6)
    steady = float(np.abs(linear.u0).max())
    with pytest.warns(SeatrialWarning, match=r"of the limit \S+ \(the end of the fitted data\): .* larger limit$"):
        replace(linear, ranges=dict.fromkeys(linear.inputs, (0.0, steady / 0.95))).lqr(Q)


def test_feedback_of_an_unstable_boat_warns_of_motions_far_away() -> None:
    unstable = linearise(saved(horizontal_model("shaft"), {"d_r": 3.0, "d_v": 5.0}), 0.7)
    assert unstable.poles.real.max() > 0.05
    words = r"unstable at 0.7 m/s \(a pole at 0\.43 1/s\).* may not bring it there from rest"
    with pytest.warns(SeatrialWarning, match=words):
        unstable.lqr(Q)


def test_a_schedule_of_speeds_gives_one_warning_with_the_range_that_is_unstable() -> None:
    """The text is that of the range, so that Python shows it once. Outside the data, it names the single speed."""
    model = saved(horizontal_model("shaft"), {"d_r": 3.0, "d_v": 5.0})

    def texts(*speeds: float) -> set[str]:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            for speed in speeds:
                replace(linearise(model, speed), ranges={"u": (-0.2, 0.9)}).lqr(Q)
        return {str(w.message) for w in caught}

    (text,) = texts(0.4, 0.55, 0.9)
    low, high, pole = re.findall(r"unstable from ([\d.]+) to ([\d.]+) m/s \(a pole at up to ([\d.]+) 1/s\)", text)[0]
    assert float(high) == 0.9
    assert float(pole) == pytest.approx(linearise(model, 0.9).poles.real.max(), abs=0.005)
    assert linearise(model, float(low) - 0.03).poles.real.max() < 0.05
    assert linearise(model, float(low) + 0.03).poles.real.max() > 0.05
    assert not texts(float(low) - 0.03)
    (outside,) = texts(0.95)
    assert "unstable at 0.95 m/s" in outside


def test_weights_as_matrices_are_refused_in_one_line(linear: LinearModel) -> None:
    given: Any = np.eye(2)
    with pytest.raises(
        SeatrialError, match=r"R: give the weights of inputs by name, such as \{'\w+': 2.0\}, .* a matrix"
    ):
        linear.lqr(Q, given)
    with pytest.raises(SeatrialError, match=r"Q: give the weights of states by name, such as .* and not a matrix$"):
        linear.lqr(given)
    with pytest.raises(SeatrialError, match=r"and not 3.0$"):
        linear.lqr(Q, 3.0)  # type: ignore[arg-type]


def test_feedback_is_written_to_files(linear: LinearModel, tmp_path: Path) -> None:
    control = linear.lqr(Q)
    read = loadmat(control.to_mat(tmp_path / "control.mat"))
    data = json.loads(control.to_json(tmp_path / "control.json").read_text(encoding="utf-8"))
    for name, values in {"K": control.gain, "x0": control.x0, "u0": control.u0}.items():
        np.testing.assert_array_equal(read[name], np.reshape(values, (len(values), -1)))
        np.testing.assert_array_equal(data[name], values)
    units = ["m/s", "m/s", "rad/s", "rad"]
    for name, texts in {"states": list(control.states), "inputs": list(control.inputs)}.items():
        assert [str(cell[0]) for cell in read[name].ravel()] == data[name] == texts
    assert [u for n, u in zip(data["states"], data["state_units"], strict=True) if n in ("u", "v", "r", "psi")] == units
    is_force = control.inputs[0].startswith("f_")
    assert data["input_units"] == [("N" if is_force else "1")] * 2
    assert read["u_max"].tolist() == [[np.inf if is_force else 1.0]] * 2
    assert data["u_min"] == [None if is_force else -1.0] * 2
    # The law of the file is that of the object.
    x = dict(zip(control.states, control.x0 + 0.01, strict=True))
    u = read["u0"] - read["K"] @ (np.array([[v] for v in x.values()]) - read["x0"])
    np.testing.assert_allclose(np.clip(u, read["u_min"], read["u_max"])[:, 0], control(x))
    with pytest.raises(SeatrialError, match=r"control\.mat: the file exists already; force=True replaces it"):
        control.to_mat(tmp_path / "control.mat")
    control.to_json(tmp_path / "control.json", force=True)
    shafts = {"T_n": 0.3, "tau_n": 0.1, "dead_zone": 0.05}
    file = control.to_json(tmp_path / "control.json", force=True, shafts=shafts | {"m_u": 60.0})
    assert json.loads(file.read_text(encoding="utf-8")) == data | {"shafts": shafts}
    with pytest.raises(SeatrialError, match=r"shafts: dead_zone is missing; give P of the exported model"):
        control.to_json(tmp_path / "other.json", shafts={"T_n": 0.3, "tau_n": 0.1})
    (tmp_path / "of a folder.json").mkdir()
    with pytest.raises(SeatrialError, match=r"of a folder\.json: exists already, and is a folder, a pipe or a device"):
        control.to_json(tmp_path / "of a folder.json")  # force would not replace it
    with pytest.raises(SeatrialError, match=r"control\.m: MATLAB loads files whose name ends in \.mat"):
        control.to_mat(tmp_path / "control.m")
    with pytest.raises(SeatrialError, match=r"control\.yaml: give a name that ends in \.json; `to_mat` writes"):
        control.to_json(tmp_path / "control.yaml")


def test_unstable_speeds_are_searched_from_the_present_operating_point() -> None:
    """The range is that of searches that begin at rest, in less than half of the time for a boat with a towed line."""
    model = saved(horizontal_model("shaft"), {"d_r": 3.0, "d_v": 5.0})
    linear = replace(linearise(model, 0.7), ranges={"u": (0.0, 1.2)})
    at_speed, begun_near = linear.at_speed, list[LinearModel | None]()
    assert at_speed is not None

    def noted(speed: float, near: LinearModel | None = None) -> LinearModel:
        begun_near.append(near)
        return at_speed(speed, near=near)

    found = replace(linear, at_speed=noted).unstable_speeds
    assert len(begun_near) > 10
    assert all(near is not None and near.speed == linear.speed for near in begun_near)
    from_rest = replace(linear, at_speed=lambda speed, near: at_speed(speed)).unstable_speeds
    assert found is not None
    assert found == pytest.approx(from_rest, rel=1e-9)


def test_headings_in_degrees_give_a_warning(linear: LinearModel) -> None:
    control = linear.lqr(Q)
    x = dict.fromkeys(linear.states, 0.0) | {"psi": 0.1}
    with pytest.warns(SeatrialWarning, match=r"psi = 40 rad is the wanted heading; if these are degrees, give np\.rad"):
        control(x, psi=40.0)
    with pytest.warns(SeatrialWarning, match=r"the state psi = 90 rad; if these are degrees, give np\.radians\(90\)"):
        control({**x, "psi": 90.0}, psi=0.7)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a heading that counts its turns, and a wanted one that does so too
        control({**x, "psi": 13.0}, psi=12.6)


@pytest.mark.parametrize("propulsion", ["shaft", "command"])
def test_feedback_steers_the_exported_boat(propulsion: Any) -> None:
    """The same lines work for both kinds of input: the shaft states have no weight."""
    model = saved(horizontal_model(propulsion), {"V_x": 0.0, "V_y": 0.0})
    control = linearise(model, 0.7).lqr(Q)
    space = exported(model)
    simulation = space["Simulation"](0.1, hold="zero")
    for _ in range(500):
        commands = control(dict(zip(space["STATES"], simulation.x, strict=True)), psi=np.radians(200.0), u=0.6)
        assert np.abs(commands).max() <= 1.0
        simulation.step(commands)
    x = dict(zip(space["STATES"], simulation.x, strict=True))
    assert np.degrees(x["psi"]) % 360.0 == pytest.approx(200.0, abs=0.1)
    assert x["psi"] < 0.0  # the shorter turn is to port
    assert 0.6 <= x["u"] < 0.68  # without an integral the speed stays between the wanted one and that of u0


def exported(model: Model) -> dict[str, Any]:
    """Return the names of the exported Python file of a model."""
    space: dict[str, Any] = {"__name__": "boat"}
    exec(compile(str(export(saved_model(model), "python")), "boat.py", "exec"), space)
    return space


def test_feedback_in_wind_is_that_of_the_boat_and_its_heading() -> None:
    """The boat has a stiffness by the heading in wind, and other inputs that keep its course, at each heading."""
    wind = {"F_wx": -6.0, "F_wy": 4.0, "w_n": 0.4, "V_x": 0.0, "V_y": 0.0}
    model = saved(horizontal_model("shaft") + catalogue()["wind"], wind)
    at = linearise(model, 0.6, conditions={"psi": 0.7})
    boat = exported(model)

    def rates(z: np.ndarray) -> np.ndarray:
        """Return the rates of u, v, r and psi at these states, with the inputs of the feedback."""
        x = dict.fromkeys(boat["STATES"], 0.0) | dict(zip(("u", "v", "r", "psi"), z, strict=True))
        simulation = boat["Simulation"](1e-4, hold="zero")
        simulation.x[:] = [x[n] for n in boat["STATES"]]
        simulation.step(control(x))
        end = dict(zip(boat["STATES"], simulation.x, strict=True))
        return np.array([(end[n] - x[n]) / 1e-4 for n in ("u", "v", "r", "psi")])

    with warnings.catch_warnings():
        warnings.simplefilter("error")  # the heading was chosen
        control = at.lqr(Q)
    assert control.x0[-1] == 0.7
    np.testing.assert_allclose(rates(control.x0), 0.0, atol=1e-4)
    slope = np.stack([(rates(control.x0 + d) - rates(control.x0 - d)) / 2e-3 for d in 1e-3 * np.eye(4)], axis=1)
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(slope).real), np.sort(control.poles.real), rtol=0.01)
    assert abs(at.by_heading[2]) > 0.05
    assert not linearise(saved(horizontal_model("shaft")), 0.6).by_heading.any()
    north = linearise(model, 0.6)
    assert np.abs(north.u0 - at.u0).max() > 0.01
    assert "The model depends on the heading" in repr(north)
    with pytest.warns(SeatrialWarning, match=r"linearised at psi = 0 rad: linearise with at=\{'psi': ...\}"):
        north.lqr(Q)


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
    with pytest.raises(SeatrialError, match=r"the state psi is missing; the feedback needs [a-z_, ]*$"):
        control(dict.fromkeys(linear.states, 0.0))
    if "n_left" in control.states:
        words = r"n_left is missing; .* estimate it from the commands that were sent, .* \(documentation: Controllers"
        with pytest.raises(SeatrialError, match=words):
            control(dict.fromkeys(set(control.states) - {"n_left"}, 0.0))
    with pytest.raises(SeatrialError, match="the model has no state 'heading'"):
        control(dict.fromkeys(control.states, 0.0), heading=1.0)
    assert "psi" not in linear.lqr({"u": 1.0, "r": 1.0}).states
