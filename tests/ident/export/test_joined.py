"""Tests of boat models joined with bench models of their thrusters, and of models with thrusts as inputs."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner

from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.ident.cli.commands import ident
from seatrial.ident.data.record import Channel, Record, build_record
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.engine.vectorised_model import VectorisedModel
from seatrial.ident.estimation.model_file import SavedModel
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.export.codegen import collect_content
from seatrial.ident.export.formats import export
from seatrial.ident.export.joined import join, with_thrust_input
from seatrial.ident.model.parameter import ParameterOrigin
from seatrial.ident.model.structure import Model
from seatrial.ident.models.dead_zone import TURNS_INSIDE
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.kinematic import kinematic_model
from seatrial.ident.models.nomoto import nomoto_model
from seatrial.ident.models.thruster import delayed_channels, thruster_model
from tests.ident.exported import build_c_simulation, saved, simulate_casadi, simulate_python

COPY_STEP_S = 0.0125  # s between the copies of the command in a bench model
CURVE = {"c1": 40.0, "c2": 1.5}


def known(model: Model, **values: float) -> Model:
    """Return the model with given values, so that the scale of its thrust is known."""
    return model.replace_parameters(
        *(model.parameter(n).known(v, 0.0, ParameterOrigin.GIVEN) for n, v in values.items())
    )


def boat(**values: float) -> Model:
    return known(horizontal_model(), **{**CURVE, "y_left": -0.3, "y_right": 0.3, "V_x": 0.1, "d_vv": 3.0} | values)


LEFT = thruster_model().with_values({**CURVE, "tau": 0.2125, "a": 4.0, "d": 0.08, "bias": 2.0})
RIGHT = thruster_model().with_values({**CURVE, "tau": 0.1, "a": 7.0, "d": 0.03})
BENCHES = {"left": LEFT, "right": RIGHT}


def benches(**models: Model) -> dict[str, SavedModel]:
    return {name: saved(model) for name, model in (models or BENCHES).items()}


def commands(n: int) -> np.ndarray:
    """Return n random commands of both thrusters, each for five steps."""
    return np.repeat(np.random.default_rng(7).uniform(-1.0, 1.0, (n // 5 + 1, 2)), 5, axis=0)[:n]


def bench_record(model: Model, command: np.ndarray, dt: float, rate: float) -> Record:
    """Return the record of a bench log whose command has a sample every dt."""
    t = dt * np.arange(len(command) + 1)
    channels = delayed_channels(Channel(t, np.append(command, command[-1])), COPY_STEP_S)
    rows = np.arange(0.0, t[-1], 1.0 / rate)
    for output in model.outputs:
        channels[output.name] = Channel(rows, np.zeros(rows.size))
    return build_record(model, channels, rate=rate, t_from=0.0, t_to=float(t[-1]))


def cascade(values: np.ndarray, dt: float) -> np.ndarray:
    """Return the states of boat and shafts after each step: the bench models of ident, then its boat model.

    Each stage of Runge-Kutta evaluates the bench models at the rows of their records, and gives their shafts to the
    boat model. The rows are the steps of the copies of the command.
    """
    hull, sides = VectorisedModel(boat()), ("left", "right")
    shafts = [VectorisedModel(m) for m in BENCHES.values()]
    records = [bench_record(m, values[:, k], dt, 1.0 / COPY_STEP_S) for k, m in enumerate(BENCHES.values())]
    p_boat = np.array(list(boat().values.values()))
    p_bench = [np.array(list(m.values.values())) for m in BENCHES.values()]
    parts, x, found = round(dt / COPY_STEP_S), np.zeros(8), []
    for k in range(len(values)):
        for part in range(parts):
            t = dt * k + COPY_STEP_S * part + 1e-6
            u = [r.u[np.searchsorted(r.t, t, side="right") - 1] for r in records]

            def rates(z: np.ndarray, u: list[np.ndarray] = u) -> np.ndarray:
                motion = hull(z[None, :6], z[None, 6:], p_boat)[0, :6]
                turning = [
                    shafts[j](np.array([[z[6 + j], 0.0]]), u[j][None], p_bench[j])[0, 0] for j in range(len(sides))
                ]
                return np.concatenate([motion, turning])

            k1 = rates(x)
            k2 = rates(x + COPY_STEP_S / 2 * k1)
            k3 = rates(x + COPY_STEP_S / 2 * k2)
            x = x + COPY_STEP_S / 6 * (k1 + 2 * k2 + 2 * k3 + rates(x + COPY_STEP_S * k3))
        found.append(x)
    return np.array(found)


@pytest.mark.parametrize("reason", ["vague", "contradicted"])
def test_dead_zones_that_the_bench_does_not_show_are_zero_in_the_joined_model(reason: str) -> None:
    """Both sides are told in one warning, with the option that fixes a dead zone."""
    unsure = {
        side: replace(
            saved(model.replace_parameters(model.parameter("d").freed())),
            errors={"d": 0.6 * model.values["d"] if reason == "vague" else 0.001},
            flags={"d": TURNS_INSIDE} if reason == "contradicted" else {},
        )
        for side, model in BENCHES.items()
    }
    with pytest.warns(SeatrialWarning, match=r"d_left = 0\.08, d_right = 0\.03\. .*--fix d=0, .*--fix d=VALUE"):
        joined = join(collect_content(saved(boat())), unsure)
    assert [joined.model.values[n] for n in ("d_left", "d_right")] == [0.0, 0.0]
    fixed = {s: replace(x, model=known(x.model, d=x.model.values["d"])) for s, x in unsure.items()}
    sure = {s: replace(x, errors={"d": 0.001}, flags={}) for s, x in unsure.items()}
    for kept in (fixed, sure):  # the user knows it, or the data show it
        assert join(collect_content(saved(boat())), kept).model.values["d_left"] == 0.08


def test_header_of_a_joined_model_is_short() -> None:
    """Its equations have 98 inputs, the commands of both thrusters from now to 0.6 s ago, which nobody reads."""
    text = export(saved(boat()), "python", thrusters=benches())
    assert isinstance(text, str)
    about, _, head = text.partition("\nfrom math")[0].partition('\n"""\n')
    assert len(about.splitlines()) < 9  # docstring: the model and an example
    assert len(head.splitlines()) < 44  # one of them names the physical inputs
    words = "n_cmd_left [-], 49 delayed copies, 0 to 0.6 s late, made by the export"
    assert f"u[0] n_cmd_left_0 to u[48] n_cmd_left_48: {words}" in head
    for prefix in ("n_cmd_left_", "n_cmd_right_"):  # and so do the names at the top of the file
        assert f'\n    *("{prefix}" + str(k) for k in range(0, 49)),\n' in text
    scope: dict[str, Any] = {}
    exec(text, scope)
    assert scope["INPUTS"] == tuple(f"n_cmd_{side}_{k}" for side in ("left", "right") for k in range(49))
    assert scope["DELAYS"] == tuple(0.0125 * k for k in range(49)) * 2
    assert 'INPUT_UNITS = ("",) * 98' in text


@pytest.mark.parametrize("dt", [0.0125, 0.05, 0.1])
def test_joined_export_equals_bench_model_then_boat_model_in_ident(dt: float) -> None:
    values = commands(40)
    text = export(saved(boat()), "python", thrusters=benches())
    states, _ = simulate_python(text, np.zeros(8), values[0], values, dt)
    np.testing.assert_allclose(states, cascade(values, dt), rtol=1e-9, atol=1e-9)


def test_joined_export_is_close_to_two_simulations_one_after_the_other() -> None:
    """The boat is simulated with the shaft speeds of the bench models as a log, which is linear between its samples."""
    values, dt, fine = commands(40), 0.05, 1600.0
    speeds, t = [], np.zeros(0)
    for k, model in enumerate(BENCHES.values()):
        record = bench_record(model, values[:, k], dt, fine)
        run = simulate(model, record, x0=np.zeros(2))
        t = np.arange(0.0, dt * len(values), 1.0 / fine)
        speeds.append(np.interp(t, record.t, run.x[:, 0]))
    channels = {f"n_{side}": Channel(t, n) for side, n in zip(BENCHES, speeds, strict=True)}
    channels |= {o.name: Channel(t, np.zeros(t.size)) for o in boat().outputs}
    record = build_record(boat(), channels, rate=fine, t_from=0.0, t_to=float(t[-1]))
    run = simulate(boat(), record, x0=np.zeros(6))
    text = export(saved(boat()), "python", thrusters=benches())
    states, _ = simulate_python(text, np.zeros(8), values[0], values, dt)
    rows = np.searchsorted(record.t, dt * np.arange(1, 40) - 1e-6)
    np.testing.assert_allclose(states[:39, :6], run.x[rows], rtol=0.0, atol=1e-5)
    assert abs(states[:, :3]).max() > 0.2


def test_joined_model_is_the_same_in_all_languages(tmp_path: Path) -> None:
    values, x = commands(30), np.random.default_rng(1).normal(0.0, 0.2, 8)
    texts = {t: export(saved(boat()), t, name="boat", thrusters=benches()) for t in ("python", "casadi", "c")}
    wanted = simulate_python(texts["python"], x, values[0], values, 0.05)
    for got, want in zip(simulate_casadi(texts["casadi"], x, values[0], values, 0.05), wanted, strict=True):
        np.testing.assert_allclose(got, want, rtol=1e-9, atol=1e-9)
    run = build_c_simulation(texts["c"], tmp_path, "boat")
    in_c = np.array(run(x, values[0], np.column_stack([np.full(30, 0.05), values])))
    np.testing.assert_allclose(in_c[:, :-1], np.column_stack([wanted[1], wanted[0]]), rtol=1e-9, atol=1e-9)
    names = 'physical_inputs: ["n_cmd_left", "n_cmd_right"]'
    assert names in export(saved(boat()), "ros2", thrusters=benches())


def test_header_names_the_bench_model_of_each_thruster() -> None:
    unknown_log = replace(saved(RIGHT), provenance={"logs": ["right.mcap sha256:99"]})
    text = export(saved(boat()), "c", thrusters={"left": saved(LEFT), "right": unknown_log})
    assert "n_cmd_left drives n_left: shaft dynamics and thrust curve fitted to a.mcap sha256:12" in text
    assert "n_cmd_right drives n_right: shaft dynamics and thrust curve fitted to right.mcap sha256:99" in text
    content = join(collect_content(saved(boat())), {"": saved(LEFT)})
    assert {"tau_left", "a_right", "c1_left", "d_right"} <= set(content.parameters)
    assert not {"c1", "bias_left", "q_f_left", "s_n_left"} & set(content.parameters)
    assert content.states[-2:] == ("n_left", "n_right")
    assert content.state_noise[-1] == LEFT.values["s_n"]
    assert content.errors[content.parameters.index("tau_left")] == 0.1


def thrust_of(content: Any, n: float) -> float:
    """Return the surge acceleration of a joined model from rest with both shafts at n, times its mass: the thrust."""
    model = content.model
    x = [n if s.name in ("n_left", "n_right") else 0.0 for s in model.states]
    row = VectorisedModel(model)(np.array([x]), np.zeros((1, len(model.inputs))), np.array(list(model.values.values())))
    return float(row[0, [s.name for s in model.states].index("u")]) * model.values["m_u"]


def test_effects_of_the_thruster_are_kept_and_effects_of_the_tank_are_removed() -> None:
    effects = catalogue()
    bench = (LEFT + effects["thrust-exponent"] + effects["recirculation"] + effects["cell-lag"]).with_values(
        {"p_n": 0.4}
    )
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always", SeatrialWarning)
        content = join(collect_content(saved(boat())), {"": saved(bench)})
    assert "thrust curves" in str(found) or any("its bench model has" in str(w.message) for w in found)
    gone = "recirculation, cell-lag of its bench test is left out; a boat has no load cell and no tank"
    for side in ("left", "right"):
        assert f"thruster {side}: {gone}" in [str(w.message) for w in found]
    assert content.effects == ("thrust-exponent (left)", "thrust-exponent (right)")
    assert content.states == ("x", "y", "psi", "u", "v", "r", "n_left", "n_right")
    assert thrust_of(content, 0.5) == pytest.approx(2 * (40.0 * 0.25 + 1.5 * 0.25) * 0.5**0.4)
    with pytest.warns(SeatrialWarning, match=gone):
        own = join(collect_content(saved(boat())), {"": saved(bench)}, own_curve=True)
    assert thrust_of(own, 0.5) == pytest.approx(2 * (40.0 * 0.25 + 1.5 * 0.25))
    dead = (boat() + effects["dead-band"]).with_values({"n_dead": 0.1})
    reduced = join(collect_content(saved(dead)), {"": saved(LEFT)})
    assert thrust_of(reduced, 0.5) == pytest.approx(2 * (40.0 + 1.5) * (0.4 / 0.9) ** 2)


def test_model_of_thrusts_is_joined_with_the_thrust_of_the_bench() -> None:
    model = known(horizontal_model("force"), y_left=-0.3, y_right=0.3)
    content = join(collect_content(saved(model)), {"": saved(LEFT)})
    assert content.physical_inputs == ("n_cmd_left", "n_cmd_right")
    assert thrust_of(content, -0.5) == pytest.approx(2 * (-40.0 * 0.25 + 1.5 * 0.25))


def test_work_of_the_shafts_is_a_state() -> None:
    model = (boat() + catalogue()["battery-sag"]).with_values({"beta_E": 0.1})
    content = join(collect_content(saved(model)), {"": saved(LEFT)})
    assert content.physical_inputs == ("n_cmd_left", "n_cmd_right")
    assert content.states[-1] == "work"
    assert len(content.state_noise) == len(content.states)


def test_unsuitable_models_are_refused() -> None:
    def refuse(model: Model, words: str, thrusters: dict[str, SavedModel] | None = None, **options: Any) -> None:
        with pytest.raises(SeatrialError, match=words):
            join(collect_content(saved(model)), thrusters or {"": saved(LEFT)}, **options)

    refuse(LEFT, "is not that of a boat")
    refuse(horizontal_model("command"), r"its inputs are n_cmd_left, n_cmd_right, not shaft speeds")
    refuse(horizontal_model("general"), "its inputs are X, N")
    refuse(nomoto_model(), "cannot be replaced, because the model nomoto.* needs its past")
    refuse(boat() + catalogue()["delay"], "because its effect delay needs its past")
    refuse(horizontal_model(), "the thrust of the boat model was not given.* --thrust-curve boat")
    in_rpm = replace(boat(), inputs=tuple(replace(i, unit="rev/min") for i in boat().inputs))
    refuse(in_rpm, "the input n_left of the boat model has the unit rev/min, but a bench model gives 1")
    refuse(boat(), "thruster right has no model: give --thruster right=FILE", {"left": saved(LEFT)})
    refuse(boat(), "the boat has no thruster 'bow'; it has left, right", {"bow": saved(LEFT)})
    refuse(boat(), "the model of thruster left is horizontal, not a bench model", {"": saved(boat())})
    force = known(horizontal_model("force"), y_left=-0.3, y_right=0.3)
    refuse(force, "its bench had no load cell", {"": saved(thruster_model(force=False))})
    assert join(collect_content(saved(horizontal_model())), {"": saved(LEFT)}, own_curve=True).states[-1] == "n_right"
    without_cell = join(collect_content(saved(boat())), {"": saved(thruster_model(force=False))})
    assert thrust_of(without_cell, 1.0) == pytest.approx(2 * 41.5)
    weaker = saved(LEFT.with_values({"c1": 39.7}))
    mixed = join(collect_content(saved(boat())), {"left": saved(thruster_model(force=False)), "right": weaker})
    assert thrust_of(mixed, 1.0) == pytest.approx(41.5 + 41.2)
    kinematic = known(kinematic_model(), **CURVE)
    assert join(collect_content(saved(kinematic)), {"": saved(LEFT)}).states[-1] == "n_right"


def test_different_curve_and_range_give_a_warning() -> None:
    weak = saved(LEFT.with_values({"c1": 30.0}))
    with pytest.warns(
        SeatrialWarning, match=r"at the shaft speed -1 its bench model has -28\.5 N and the boat model -38\.5 N"
    ):
        join(collect_content(saved(boat())), {"": weak})
    wide = replace(saved(boat()), validity={"n_left": (-1.0, 1.0), "n_right": (-0.2, 1.0)})
    narrow = replace(saved(LEFT), validity={"n_cmd": (-0.3, 1.0)})
    with pytest.warns(SeatrialWarning, match=r"left: .* from -0\.30 to 1\.00; beyond them shaft and thrust are"):
        join(collect_content(wide), {"": narrow})
    with pytest.warns(SeatrialWarning, match="beyond them the shaft is extrapolated"):
        join(collect_content(wide), {"": narrow}, own_curve=True)


@pytest.mark.parametrize(("how", "are"), [({}, "shaft speeds"), ({"thrust_input": True}, "thrusts")])
def test_header_says_that_the_lag_of_the_shafts_is_missing(how: dict[str, Any], are: str) -> None:
    """A controller that is tested with such a file is closed without the delay and the lag of the thrusters."""
    for target in ("python", "casadi", "c", "ros2"):
        text = export(saved(boat()), target, **how)
        assert isinstance(text, str)
        assert f"The inputs are {are}. The delay and the lag of the shafts" in text
        assert "seatrial ident thruster LOG --thruster NAME" in text
    assert "--thruster NAME=FILE" not in str(export(saved(nomoto_model()), "python"))  # it cannot be joined
    for text in (export(saved(horizontal_model("command")), "c"), export(saved(boat()), "c", thrusters=benches())):
        assert "lag of the shafts" not in str(text)


def test_model_with_thrust_input_has_the_same_motion_and_a_slope_at_rest() -> None:
    model = boat()
    text, own = export(saved(model), "python", thrust_input=True), export(saved(model), "python")
    speeds = commands(40)
    thrusts = 40.0 * speeds * abs(speeds) + 1.5 * speeds**2
    states, _ = simulate_python(text, np.zeros(6), np.zeros(2), thrusts, 0.1, "zero")
    wanted, _ = simulate_python(own, np.zeros(6), np.zeros(2), speeds, 0.1, "zero")
    np.testing.assert_allclose(states, wanted, rtol=1e-12, atol=1e-12)
    space: dict[str, Any] = {"__name__": "boat"}
    exec(compile(text, "boat.py", "exec"), space)
    found = [space["shaft_speed"](f) for f in thrusts[:, 0]]
    np.testing.assert_allclose(found, speeds[:, 0], rtol=1e-12)
    solver: dict[str, Any] = {"__name__": "boat"}
    exec(compile(export(saved(model), "casadi", thrust_input=True), "boat_casadi.py", "exec"), solver)
    for file in (space, solver):
        c1, c2 = file["THRUST_CURVE"]
        assert (file["shaft_speed"](1.04 * (c1 + c2)), file["shaft_speed"](-1.04 * (c1 - c2))) == (1.0, -1.0)
        with pytest.warns(
            UserWarning, match=r"^the thrust -80 N is beyond full speed, -\d+\.?\d* to \d+\.?\d* N: full"
        ):
            assert file["shaft_speed"](-80.0) == -1.0
    slopes = []
    for options in ({}, {"thrust_input": True}):
        solver = {"__name__": "boat"}
        exec(compile(export(saved(model), "casadi", **options), "boat.py", "exec"), solver)
        x, u = ca.SX.sym("x", 6), ca.SX.sym("u", 2)
        jacobian = ca.Function("J", [x, u], [ca.jacobian(solver["f"](x, u, solver["DEFAULTS"]), u)])
        slopes.append(np.array(jacobian(np.zeros(6), np.zeros(2))))
    assert not slopes[0].any()
    np.testing.assert_allclose(slopes[1][3], 1.0 / model.values["m_u"])


def test_slope_by_a_thrust_is_right_if_an_effect_needs_the_shaft_speed(tmp_path: Path) -> None:
    """The shaft speed is an inverse with a branch for each direction. Neither branch has a slope outside its own."""
    hull = boat(d_u=8.0)
    model = (hull + catalogue()["advance-ratio"]).with_values({"k_J": 6.0})
    with pytest.warns(SeatrialWarning, match="infinite at zero thrust"):
        texts = {t: str(export(saved(model), t, name="boat", thrust_input=True)) for t in ("casadi", "python", "c")}
    solver: dict[str, Any] = {"__name__": "boat"}
    exec(compile(texts["casadi"], "boat.py", "exec"), solver)
    f, p = solver["f"], solver["DEFAULTS"]
    x, u = ca.SX.sym("x", 6), ca.SX.sym("u", 2)
    slope = ca.Function("J", [x, u], [ca.jacobian(f(x, u, p), u)])
    curvature = ca.Function("H", [x, u], [ca.hessian(ca.sum1(f(x, u, p)), ca.vertcat(x, u))[0]])
    moving = np.array([0.0, 0.0, 0.3, 0.5, 0.05, 0.1])
    for thrust in ((5.0, 5.0), (-5.0, -5.0), (15.0, -3.0), (0.3, 0.4), (0.01, -0.01)):
        wanted = np.zeros((6, 2))
        for k, h in enumerate(1e-4 * np.abs(thrust)):
            step = h * np.eye(2)[k]
            ends = [np.array(f(moving, np.add(thrust, sign * step), p)).ravel() for sign in (1.0, -1.0)]
            wanted[:, k] = (ends[0] - ends[1]) / (2.0 * h)
        np.testing.assert_allclose(np.array(slope(moving, thrust)), wanted, rtol=1e-5, atol=1e-8)
        assert np.isfinite(np.array(curvature(moving, thrust))).all()
    for at in (np.zeros(6), moving):  # without a slope of its own at zero thrust, but a finite one
        assert np.isfinite(np.array(slope(at, np.zeros(2)))).all()
        assert np.isfinite(np.array(curvature(at, np.zeros(2)))).all()

    with_speeds = str(export(saved(model), "python"))
    speeds = commands(40)
    thrusts = 40.0 * speeds * abs(speeds) + 1.5 * speeds**2
    wanted, _ = simulate_python(with_speeds, np.zeros(6), np.zeros(2), speeds, 0.1, "zero")
    in_python, _ = simulate_python(texts["python"], np.zeros(6), np.zeros(2), thrusts, 0.1, "zero")
    np.testing.assert_allclose(in_python, wanted, rtol=1e-3, atol=1e-5)
    without, _ = simulate_python(str(export(saved(hull), "python")), np.zeros(6), np.zeros(2), speeds, 0.1, "zero")
    assert np.abs(without - wanted).max() > 0.01  # the effect shows
    in_casadi, _ = simulate_casadi(texts["casadi"], np.zeros(6), np.zeros(2), thrusts, 0.1, "zero")
    np.testing.assert_allclose(in_casadi, in_python, rtol=1e-10, atol=1e-12)
    run = build_c_simulation(texts["c"].replace("NAME_init", "x"), tmp_path, "boat")
    rows = run(np.zeros(6), [0.0, 0.0], [[0.1, *row] for row in thrusts], "zero")
    np.testing.assert_allclose(np.array(rows)[:, -7:-1], in_python, rtol=1e-9, atol=1e-10)


def test_thrust_input_in_c(tmp_path: Path) -> None:
    text = export(saved(boat()), "c", name="boat", thrust_input=True)
    assert "boat_in_f_left" in text
    run = build_c_simulation(text.replace("NAME_init", "x"), tmp_path, "boat")
    (row,) = run(np.zeros(6), [20.0, 20.0], [[0.1, 20.0, 20.0]])
    assert row[-4] == pytest.approx(2 * 20.0 / boat().values["m_u"] * 0.1, rel=0.02)


def test_late_sensors_are_left_out_because_the_thrusts_have_no_past() -> None:
    """A fit may add the latency of the GNSS by itself. It does not act on the motion."""
    plain = with_thrust_input(collect_content(saved(boat())))
    late = boat() + catalogue()["gnss-latency"]
    with pytest.warns(SeatrialWarning, match="gnss-latency: left out, .* the motion is the same"):
        found = with_thrust_input(collect_content(saved(late)))
    for part in ("inputs", "states", "parameters", "values", "effects"):
        assert getattr(found, part) == getattr(plain, part)


def test_thrust_input_refuses_models_without_shaft_speeds() -> None:
    def refuse(model: Model, words: str) -> None:
        with pytest.raises(SeatrialError, match=words):
            with_thrust_input(collect_content(saved(model)))

    refuse(horizontal_model("command"), "--thrust-input needs a model with the shaft speeds")
    refuse(horizontal_model("command"), "make_step of the CasADi file .*, MPC for a model of commands")
    refuse(horizontal_model("force"), "the inputs of horizontal:force are f_left, f_right: leave it out$")
    refuse(boat() + catalogue()["dead-band"], "the effect dead-band acts on the shaft speed")
    refuse(boat() + catalogue()["delay"], "because its effect delay needs its past")
    refuse(
        boat() + catalogue()["battery-sag"], "the effect battery-sag depends on the energy that the shafts have used"
    )
    with pytest.warns(
        SeatrialWarning, match="slope by the thrust is infinite at zero thrust.* limit of its iterations"
    ):
        with_thrust_input(collect_content(saved((boat() + catalogue()["advance-ratio"]).with_values({}))))


def files(folder: Path) -> tuple[Path, Path]:
    """Write the model.toml of a boat and of a bench test."""
    texts = []
    for source, sensors, values in (
        ("horizontal:shaft", '["attitude", "position"]', {**CURVE, "y_left": -0.3, "y_right": 0.3}),
        ("thruster:0.0125", '["rpm", "load_cell"]', {**CURVE, "tau": 0.2125, "a": 4.0}),
    ):
        lines = ['format = "seatrial-model 1"', f'name = "{source.split(":")[0]}"', f'source = "{source}"']
        lines += [f"sensors = {sensors}", "effects = []"]
        for name, value in values.items():
            lines += ["[[parameter]]", f'name = "{name}"', f"value = {value!r}", "free = false", 'origin = "given"']
        texts.append("\n".join(lines))
    for name, text in zip(("boat", "thruster"), texts, strict=True):
        (folder / name).mkdir()
        (folder / name / "model.toml").write_text(text, encoding="utf-8")
    return folder / "boat", folder / "thruster/model.toml"


def test_export_command_joins_one_file_or_one_for_each_thruster(tmp_path: Path) -> None:
    hull, bench = files(tmp_path)
    words = ["export", str(hull), "--to", "python"]
    shared = CliRunner().invoke(ident, [*words, "--thruster", str(bench)], catch_exceptions=False)
    two = [*words, "--thruster", f"left={bench.parent}", "--thruster", f"right={bench}"]
    assert shared.stdout == CliRunner().invoke(ident, two, catch_exceptions=False).stdout
    assert 'PHYSICAL_INPUTS = ("n_cmd_left", "n_cmd_right")' in shared.stdout
    spaced = [*words, "--thruster", f" left = {bench.parent}", "--thruster", f"right= {bench}"]
    assert shared.stdout == CliRunner().invoke(ident, spaced, catch_exceptions=False).stdout
    blank = CliRunner().invoke(ident, [*words, "--thruster", f" ={bench}"])
    assert "has no name of a thruster; write NAME=FILE, or FILE for all" in " ".join(blank.output.split())
    twice = CliRunner().invoke(ident, [*words, "--thruster", str(bench), "--thruster", str(bench)])
    assert "all thrusters: two files" in twice.output
    missing = CliRunner().invoke(ident, [*words, "--thruster", "left=nowhere.toml"])
    assert "nowhere.toml" in missing.output
    assert missing.exit_code == 2
