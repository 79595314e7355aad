"""Tests of exported simulations, which keep the past of the inputs.

They equal the simulation of ident from a log of the physical inputs, and each other in Python, CasADi and C.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from seatrial.ident.data.record import Channel, build_record
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.export.formats import export
from seatrial.ident.export.history import history_of
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Model, Output, Sensor, State, plain_model
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.kinematic import kinematic_model
from seatrial.ident.models.nomoto import nomoto_model
from seatrial.ident.models.surge import surge_model
from seatrial.ident.models.thruster import delayed_channels, thruster_model
from tests.ident.exported import (
    MODELS,
    Steps,
    build_c_simulation,
    moved,
    saved,
    simulate_casadi,
    simulate_python,
)

N = 60  # steps of a simulation


def with_effects(model: Model, *names: str) -> Model:
    for name in names:
        model = model + catalogue()[name]
    return moved(model, 2)


# Delay, dead zone and lag of the shafts, and the dead band of the thrust
COMMAND = (horizontal_model("command") + catalogue()["dead-band"]).with_values(
    {"tau_n": 0.22, "T_n": 0.31, "dead_zone": 0.12, "n_dead": 0.05}
)
SHAFT = with_effects(horizontal_model(), "delay", "lag", "battery-sag", "current-drift")


def samples(model: Model, n: int = N) -> np.ndarray:
    """Return n + 1 values of the physical inputs (n + 1, n_inputs), each for three steps. A heading turns steadily."""
    inputs, rng = history_of(model).inputs, np.random.default_rng(3)
    values = np.repeat(rng.uniform(-1.0, 1.0, (n // 3 + 1, len(inputs))), 3, axis=0)[: n + 1]
    values[:, [i.name == "psi" for i in inputs]] = np.angle(np.exp(0.7j * np.arange(n + 1)))[:, None]
    return values


def initial(model: Model) -> np.ndarray:
    return np.random.default_rng(4).normal(0.0, 0.3, len(model.states))


def by_ident(model: Model, values: np.ndarray, dt: float) -> Steps:
    """Simulate a log that has the physical inputs every dt [s]. Return the states and the outputs at these times."""
    t, past = dt * np.arange(len(values)), history_of(model)
    channels = {i.name: Channel(t, values[:, k]) for k, i in enumerate(past.inputs)}
    if model.name == "thruster":
        channels |= delayed_channels(channels["n_cmd"], past.delays[1], len(past.delays))
    for output in model.outputs:
        channels.setdefault(output.name, Channel(t, np.zeros(t.size)))
    record = build_record(model, channels, rate=1.0 / dt, t_from=0.0, t_to=float(t[-1]))
    ran = simulate(model, record, x0=initial(model))
    rows = np.searchsorted(record.t, t - 1e-6)
    return ran.x[rows[1:]], ran.y[rows[:-1]]


def steps_of(model: Model, values: np.ndarray, hold: str | None = None) -> np.ndarray:
    """Return the physical inputs of each step. A held input has its value from the start, a linear one at the end."""
    linear = [(hold or i.hold) == "linear" for i in history_of(model).inputs]
    return np.where(linear, values[1:], values[:-1])


@pytest.mark.parametrize(
    ("model", "dt", "tolerance"),
    [
        *((COMMAND, dt, 1e-12) for dt in (0.1, 0.05, 0.04, 0.013, 0.25)),
        *((SHAFT, dt, 1e-12) for dt in (0.1, 0.04, 0.3)),
        (nomoto_model().with_values({"tau_n": 0.06}), 0.04, 1e-12),
        (kinematic_model(yaw=True), 0.1, 1e-12),
        # A log has a row for each change of a copy. At another step than that of the copies, the integration differs.
        (thruster_model(), 0.0125, 1e-12),
        (thruster_model(), 0.05, 1e-5),
    ],
    ids=lambda v: v.source if isinstance(v, Model) else str(v),
)
def test_simulation_equals_that_of_ident(model: Model, dt: float, tolerance: float) -> None:
    values = samples(model)
    wanted = by_ident(model, values, dt)
    text = export(saved(model), "python", nuisance=True)
    got = simulate_python(text, initial(model), values[0], steps_of(model, values), dt)
    np.testing.assert_allclose(got[0], wanted[0], rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(got[1], wanted[1], rtol=10 * tolerance, atol=10 * tolerance)


@pytest.mark.parametrize("hold", ["zero", "linear"])
def test_hold_of_a_simulation_can_be_chosen(hold: Any) -> None:
    """The inputs of a controller are held also if the model was fitted to measured shaft speeds."""
    model = horizontal_model(hold=hold)
    values = samples(model)
    fitted = horizontal_model(hold="zero" if hold == "linear" else "linear")
    got = simulate_python(
        export(saved(fitted), "python"), initial(model), values[0], steps_of(model, values), 0.07, hold
    )
    np.testing.assert_allclose(got[0], by_ident(model, values, 0.07)[0], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("model", "dt", "hold"),
    [
        *((COMMAND, dt, None) for dt in (0.1, 0.04)),
        (SHAFT, 0.07, None),
        (SHAFT, 0.07, "zero"),
        (nomoto_model().with_values({"tau_n": 0.02}), 0.04, None),  # with later values of the inputs
        (MODELS["measured attitude"], 0.1, None),  # inputs that are angles
        (MODELS["thruster"], 0.03, None),
        (MODELS["odd"], 0.15, "linear"),
    ],
    ids=lambda v: v.source or v.name if isinstance(v, Model) else str(v),
)
def test_python_casadi_and_c_simulations_are_equal(model: Model, dt: float, hold: str | None, tmp_path: Path) -> None:
    x, values = initial(model), samples(model)[:N]
    texts = {target: export(saved(model), target, name="boat", nuisance=True) for target in ("python", "casadi", "c")}
    states, outputs = simulate_python(texts["python"], x, values[0], values, dt, hold)
    assert np.isfinite(states).all()
    for got, wanted in zip(
        simulate_casadi(texts["casadi"], x, values[0], values, dt, hold), (states, outputs), strict=True
    ):
        np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-9)
    run = build_c_simulation(texts["c"], tmp_path, "boat")
    in_c = np.array(run(x, values[0], np.column_stack([np.full(N, dt), values]), hold))
    np.testing.assert_allclose(in_c[:, :-1], np.column_stack([outputs, states]), rtol=1e-9, atol=1e-9)


def test_c_simulation_rejects_a_step_that_is_too_short_and_continues(tmp_path: Path) -> None:
    text, x, before = export(saved(COMMAND), "c", name="boat"), initial(COMMAND), [0.1, 0.2]
    run = build_c_simulation(text, tmp_path, "boat")
    rejected = [[0.0099, 1.0, 1.0], [float("nan"), 1.0, 1.0], [-0.1, 1.0, 1.0], [1e4, 1.0, 1.0]]
    *errors, after = run(x, before, [*rejected, [0.1, 0.5, 0.4]])
    assert [row[-1] for row in errors] == [1.0, 1.0, 1.0, 2.0]
    assert all(row[:-1] == x.tolist() for row in errors)
    assert [after] == run(x, before, [[0.1, 0.5, 0.4]])
    (shortest,) = run(x, before, [[0.01, 0.5, 0.4]])
    assert shortest[-1] == 0.0
    smaller = build_c_simulation(text, tmp_path, "boat", "-Dboat_SHORTEST_DT_US=2000")
    many = np.column_stack([np.full(600, 0.002), np.linspace(-1.0, 1.0, 600), np.full(600, 0.3)])
    states, _ = simulate_python(export(saved(COMMAND), "python"), x, before, many[:, 1:], 0.002)
    np.testing.assert_allclose([row[-len(x) - 1 : -1] for row in smaller(x, before, many)], states, rtol=1e-9)


def test_c_simulation_merges_short_steps_on_request(tmp_path: Path) -> None:
    """Steps of 10 ms and more are not merged, so that their motion is the same as without the definition."""
    text, x, values = export(saved(COMMAND), "c", name="boat"), initial(COMMAND), samples(COMMAND)
    (tmp_path / "plain").mkdir()
    plain = build_c_simulation(text, tmp_path / "plain", "boat")
    merging = build_c_simulation(text, tmp_path, "boat", "-Dboat_MERGE_SHORT_STEPS=1")
    whole = [[0.01, *row] for row in values]
    assert merging(x, values[0], whole) == plain(x, values[0], whole)
    parts = [[dt, *row] for row in values for dt in (0.001, 0.0065, 0.0025)]
    n = len(x) + 1  # states and return code; outputs are those at the start of a step
    found, wanted = merging(x, values[0], parts)[-1][-n:], merging(x, values[0], whole)[-1][-n:]
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-6)
    refused = merging(x, values[0], [[0.0, 1.0, 1.0], [-1.0, 1.0, 1.0]])
    assert [row[-1] for row in refused] == [1.0, 1.0]


def test_c_simulation_accepts_steps_of_different_duration(tmp_path: Path) -> None:
    """Two steps of 0.05 s have the same effect as one of 0.1 s, also in the past of the command."""
    run = build_c_simulation(export(saved(COMMAND), "c", name="boat"), tmp_path, "boat")
    commands = samples(COMMAND)
    whole = run(initial(COMMAND), [0.0, 0.0], [[0.1, *row] for row in commands])
    rows = [[dt, *row] for k, row in enumerate(commands) for dt in ([0.1] if k % 2 else [0.05, 0.05])]
    halves = run(initial(COMMAND), [0.0, 0.0], rows)
    n = len(COMMAND.states) + 1
    np.testing.assert_allclose(halves[-1][-n:], whole[-1][-n:], rtol=1e-9)


def test_reset_starts_a_simulation_again() -> None:
    space: dict[str, Any] = {"__name__": "boat"}
    exec(compile(export(saved(SHAFT), "python"), "boat.py", "exec"), space)
    sim, x, values = space["Simulation"](0.1), initial(SHAFT).tolist(), samples(SHAFT)
    at_rest = [sim.step(now) for now in values]
    assert sim.t == pytest.approx(0.1 * len(values))
    assert sim.work > 0.0
    sim.reset()
    assert (sim.t, sim.work, sim.x) == (0.0, 0.0, [0.0] * len(SHAFT.states))
    assert [sim.step(now) for now in values] == at_rest
    sim.reset(x, values[0])
    started = space["Simulation"](0.1, x, inputs=values[0])
    assert [sim.step(now) for now in values] == [started.step(now) for now in values]


def test_invalid_arguments_of_a_simulation_are_reported() -> None:
    space: dict[str, Any] = {"__name__": "boat"}
    exec(compile(export(saved(COMMAND), "python"), "boat.py", "exec"), space)
    for dt in (0.0, -0.1, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="give a positive time"):
            space["Simulation"](dt)
    with pytest.raises(ValueError, match="give 'zero', 'linear'"):
        space["Simulation"](0.1, hold="cubic")
    with pytest.raises(ValueError, match="1 inputs, but the model has 2: n_cmd_left, n_cmd_right"):
        space["Simulation"](0.1).step([0.5])
    with pytest.raises(ValueError, match="3 states, but the model has 8"):
        space["Simulation"](0.1, [0.0, 0.0, 0.0])


def test_wrong_values_of_a_simulation_are_reported_at_once() -> None:
    space: dict[str, Any] = {"__name__": "boat"}
    exec(compile(export(saved(horizontal_model()), "python"), "boat.py", "exec"), space)
    new, p = space["Simulation"], space["P"]

    def refuse(words: str, create: Callable[[], object]) -> None:
        with pytest.raises(ValueError, match=words):
            create()

    sim = new(0.1)
    refuse("^n_right is nan: give a finite number$", lambda: sim.step([0.5, math.nan]))
    refuse("^n_left is 'full': give a finite number$", lambda: sim.step(["full", 0.0]))
    refuse("^n_left is -1500.0: give -1 to 1, where 1 is full speed ahead$", lambda: sim.step([-1500, 0.0]))
    refuse("n_left is inf", lambda: sim.outputs([math.inf, 0.0]))
    refuse("n_left is inf", lambda: sim.inputs_now([math.inf, 0.0]))
    refuse("n_left is inf", lambda: sim.reset(inputs=[math.inf, 0.0]))
    refuse("r is nan", lambda: new(0.1, x=[0.0] * 5 + [math.nan]))
    refuse(r"inputs is {'n_left': 1.0}: give a list of the numbers n_left, n_right", lambda: sim.step({"n_left": 1.0}))
    refuse("inputs is 0.5: give a list", lambda: sim.step(0.5))
    refuse(
        r"no parameter 'd_uuu'; it has m_u, m_v, .*y_right. Did you mean d_uu\?", lambda: new(0.1, p=p | {"d_uuu": 1})
    )
    refuse("^p lacks m_v, m_r, .*: give all parameters, as {", lambda: new(0.1, p={"m_u": 40.0}))
    refuse("m_u is nan", lambda: new(0.1, p=p | {"m_u": math.nan}))
    assert (sim.t, sim.x) == (0.0, [0.0] * 6)
    sim.step([1.04, -1.0])  # a measured speed may be a little above full speed
    assert new(0.1, p=p | {"m_u": 74.0}).step([1.0, 1.0])[3] < new(0.1).step([1.0, 1.0])[3]


def test_inputs_of_other_units_and_beyond_full_speed_in_the_data_are_accepted() -> None:
    for model, validity, inputs in (
        (horizontal_model("force"), {}, [400.0, -380.0]),
        (horizontal_model(), {"n_left": (-0.9, 1.2)}, [1.25, 1.0]),
    ):
        space: dict[str, Any] = {"__name__": "boat"}
        exec(compile(export(replace(saved(model), validity=validity), "python"), "boat.py", "exec"), space)
        assert np.isfinite(space["Simulation"](0.1).step(inputs)).all()


def test_model_without_delays_has_the_same_interface_and_an_empty_history() -> None:
    model = surge_model("force")
    spaces: dict[str, dict[str, Any]] = {}
    for target in ("python", "casadi"):
        spaces[target] = {"__name__": "boat"}
        exec(compile(export(saved(model), target), "boat.py", "exec"), spaces[target])
    boat, solver = spaces["python"], spaces["casadi"]
    step, names = solver["make_step"](0.1)
    assert (tuple(names), solver["initial_state"](0.1)) == (boat["STATES"], [0.0] * len(boat["STATES"]))
    sim, x = boat["Simulation"](0.1), [0.0] * len(boat["STATES"])
    for force in (10.0, -5.0, 3.0):
        x = boat["step"](x, [force], 0.1)
        np.testing.assert_allclose(sim.step([force]), x, rtol=1e-12)
    np.testing.assert_allclose(
        np.array(step([0.0] * len(names), [10.0], solver["DEFAULTS"])).ravel(),
        boat["step"]([0.0] * len(names), [10.0], 0.1),
        rtol=1e-12,
    )
    # A linear input starts from its last value, which is therefore a state.
    assert solver["make_step"](0.1, "linear")[1] == [*boat["STATES"], f"{boat['PHYSICAL_INPUTS'][0]}_past_1"]


def test_casadi_step_has_one_input_for_each_thruster_and_can_be_saved(tmp_path: Path) -> None:
    space: dict[str, Any] = {"__name__": "boat"}
    exec(compile(export(saved(COMMAND), "casadi", name="boat"), "boat.py", "exec"), space)
    step, names = space["make_step"](0.1)
    assert space["PHYSICAL_INPUTS"] == ("n_cmd_left", "n_cmd_right")
    assert step.size1_in("u") == 2
    assert names[len(COMMAND.states) :] == [f"n_cmd_{side}_past_{k}" for side in ("left", "right") for k in range(1, 9)]
    step.save(str(tmp_path / "step.casadi"))
    again = ca.Function.load(str(tmp_path / "step.casadi"))
    z = space["initial_state"](0.1, initial(COMMAND), [0.3, -0.3])
    assert z[-1] == -0.3
    later = again(z, [0.5, 0.4], space["DEFAULTS"])
    assert np.array_equal(later, step(z, [0.5, 0.4], space["DEFAULTS"]))
    assert float(later[names.index("n_cmd_left_past_1")]) == 0.5


def test_model_without_inputs_is_simulated(tmp_path: Path) -> None:
    model = plain_model(
        "decay",
        f=lambda x, u, p: {"a": -p.k * x.a},
        h=lambda x, u, p: {"y": x.a},
        states=(State("a"),),
        inputs=(),
        sensors=(Sensor("s", (Output("y", noise="e"),)),),
        parameters=(Parameter("k", 0.5), Parameter("e", 0.1)),
    )
    x, nothing = [1.0], np.zeros((20, 0))
    wanted = np.exp(-0.05 * np.arange(1, 21))
    for target, run in (("python", simulate_python), ("casadi", simulate_casadi)):
        np.testing.assert_allclose(run(export(saved(model), target), x, [], nothing, 0.1)[0].ravel(), wanted, rtol=1e-6)
    in_c = build_c_simulation(export(saved(model), "c"), tmp_path, "decay")(x, [], [[0.1]] * 20)
    np.testing.assert_allclose([row[1] for row in in_c], wanted, rtol=1e-6)


def test_header_of_python_names_the_constant_of_the_physical_inputs() -> None:
    """INPUTS has dozens of delayed copies, which is no size of an input vector for a simulation."""
    about = "# PHYSICAL_INPUTS has their names. INPUTS has those of the inputs of f and h, with delayed copies.\n"
    for model, copies in ((COMMAND, True), (horizontal_model(), False)):
        text, space = export(saved(model), "python"), dict[str, Any]()
        exec(text, space)
        assert (space["INPUTS"] != space["PHYSICAL_INPUTS"]) == copies
        assert (about in text) == copies


@pytest.mark.parametrize("model", [COMMAND, horizontal_model()], ids=["command", "shaft speeds"])
def test_docstring_of_python_has_an_example_that_runs_and_the_number_of_delayed_copies(model: Model) -> None:
    hostile = replace(saved(model), provenance={"made_by": 'seatrial ident vehicle C:\\new\\"""a".mcap'})
    text, space = export(hostile, "python"), dict[str, Any]()
    exec(text, space)
    about = space["__doc__"]
    assert about.startswith("horizontal: fitted model, exported to Python by seatrial.\n")
    assert 'made by: seatrial ident vehicle C:\\new\\"""a".mcap\n' in about
    example = [line.strip() for line in about.splitlines() if line.startswith("    ")]
    assert len(example) == 2
    exec("\n".join(example), space)
    assert space["x"] == space["Simulation"](0.1).step([0.5, 0.5])
    assert space["x"][3] > 0.0 or model is COMMAND  # the commands are late
    n = len(space["INPUTS"]) - 2
    copies = (
        f"{n} of the {n + 2} inputs are delayed copies: Simulation.step makes them and takes only n_cmd_left, n_cmd"
    )
    assert (copies in about) == (model is COMMAND)


@pytest.mark.parametrize(
    ("target", "stepper"), [("casadi", "make_step"), ("c", "horizontal_advance"), ("ros2", "The node")]
)
def test_header_says_what_makes_the_delayed_copies(target: str, stepper: str) -> None:
    words = f"inputs are delayed copies: {stepper} makes them and takes only n_cmd_left, n_cmd_right."
    assert words in export(saved(COMMAND), target)
    assert "delayed copies:" not in export(saved(horizontal_model()), target)


def test_ros2_parameters_list_physical_inputs_and_delays() -> None:
    yaml = pytest.importorskip("ruamel.yaml", reason="no YAML reader here (ruamel.yaml)")
    reader = yaml.YAML(typ="safe", pure=True)
    table = reader.load(export(saved(COMMAND), "ros2", name="boat"))["boat"]["ros__parameters"]
    assert table["physical_inputs"] == ["n_cmd_left", "n_cmd_right"]
    assert table["physical_input_holds"] == ["zero", "zero"]
    assert table["max_step"] == 0.05
    pairs = dict(zip(table["inputs"], zip(table["input_sources"], table["input_delays"], strict=True), strict=True))
    assert pairs["n_cmd_left"] == ("n_cmd_left", 0.0)
    assert pairs["n_cmd_right_ago_16"] == ("n_cmd_right", pytest.approx(0.8))
    shaft = reader.load(export(saved(SHAFT), "ros2", name="boat"))["boat"]["ros__parameters"]
    assert shaft["physical_inputs"] == ["n_left", "n_right"]
    assert {"t", "work"} < set(shaft["input_sources"])
