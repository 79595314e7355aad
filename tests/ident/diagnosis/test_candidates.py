"""Tests of the columns of the score test: analytic derivatives, effects with states, and generic curves."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from seatrial.ident.data.record import Record
from seatrial.ident.diagnosis.candidates import (
    TrajectoryLinearisation,
    all_columns,
    generic_features,
    splines,
    variables,
)
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.engine.vectorised_model import VectorisedModel
from seatrial.ident.estimation.homogeneity import between_runs_effect
from seatrial.ident.model.structure import Effect, EffectKind, Model, Signals
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.scaling import VesselScale, scale_priors
from tests.ident.carriers import carrier
from tests.ident.sliders import whole

N_ROWS = 60


def base_for(effect: Effect | None = None) -> Model:
    return with_disturbances(horizontal_model()) if effect is None else carrier(effect)


def with_all_inputs(model: Model) -> Model:
    """Return the model with the inputs of every effect that it accepts."""
    for effect in catalogue().values():
        if model.accepts(effect):
            model = model + effect
    return model


def made_record(model: Model, seed: int = 0, n_rows: int = N_ROWS) -> Record:
    """Return a record with irregular rows, random inputs and no measured outputs."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.choice([0.05, 0.1], n_rows))
    u = rng.uniform(-1, 1, (n_rows, len(model.inputs)))
    names = [i.name for i in model.inputs]
    for scale, name in ((1.0, "t"), (0.01, "work")):
        if name in names:
            u[:, names.index(name)] = scale * t
    y = np.full((n_rows, len(model.outputs)), np.nan)
    outputs = tuple(o.name for o in model.outputs)
    return Record("made", t, u, np.vstack([u[1:], u[-1:]]), y, tuple(names), outputs)


def path_for(model: Model, seed: int = 0, n_rows: int = N_ROWS) -> TrajectoryLinearisation:
    record = made_record(with_all_inputs(model), seed, n_rows)
    x = np.random.default_rng(seed + 1).normal(size=(n_rows, len(model.states))) * 0.4
    return TrajectoryLinearisation(model, np.array(list(model.values.values())), record, x)


def in_floats(model: Model, x: np.ndarray, u: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the rates and then the outputs of one row, evaluated by the model's own functions in floats."""
    s = model.signals(x.tolist(), u.tolist(), values.tolist())
    return np.array([s.rate[v.name] for v in model.states] + [s.y[o.name] for o in model.outputs], dtype=float)


def test_column_of_a_fitted_parameter_is_its_analytic_derivative() -> None:
    """Check surge damping and yaw inertia of the horizontal model, in the rates and in the accelerometer."""
    model = base_for()
    path = path_for(model)
    states, outputs = [s.name for s in model.states], [o.name for o in model.outputs]
    x = {n: path.x[:, i] for i, n in enumerate(states)}
    p = model.values
    damping = path.parameter("d_uu")
    wanted = -np.abs(x["u"]) * x["u"] / p["m_u"]
    np.testing.assert_allclose(damping[:, states.index("u")], wanted, atol=1e-12)
    np.testing.assert_allclose(damping[:, len(states) + outputs.index("ax")], wanted, atol=1e-12)
    others = [states.index(n) for n in ("v", "r", "psi")] + [len(states) + outputs.index(n) for n in ("ay", "r")]
    assert not damping[:, others].any()
    inertia = path.parameter("m_r")[:, states.index("r")]
    N = path.base[:, states.index("r")] * p["m_r"]
    # The column is a finite difference with a relative step of half a percent.
    np.testing.assert_allclose(inertia, -N / p["m_r"] ** 2, rtol=1e-4, atol=1e-9)


def test_columns_of_simple_effects_equal_analytic_derivatives() -> None:
    path = path_for(base_for())
    states = [s.name for s in path.model.states]
    u, p = path.x[:, states.index("u")], path.model.values
    found = {name: next(path.effect(catalogue()[name])) for name in ("cubic-drag", "yaw-bias", "mismatch")}
    cubic = whole(path, found["cubic-drag"])[:, states.index("u"), 0]
    np.testing.assert_allclose(cubic, -(u**3) / p["m_u"], atol=1e-9)
    np.testing.assert_allclose(whole(path, found["yaw-bias"])[:, states.index("r"), 0], 1 / p["m_r"], atol=1e-9)
    n = {side: path.own.u[:, path.own.inputs.index(f"n_{side}")] for side in ("left", "right")}
    f = {side: p["c1"] * z * np.abs(z) + p["c2"] * z * z for side, z in n.items()}
    mismatch = whole(path, found["mismatch"])[:, :, 0]
    np.testing.assert_allclose(mismatch[:, states.index("u")], (f["left"] - f["right"]) / p["m_u"], atol=1e-9)
    np.testing.assert_allclose(mismatch[:, states.index("r")], 0.15 * (f["left"] + f["right"]) / p["m_r"], atol=1e-9)


# One effect whose states a solver integrates is enough for the quick tests.
SOLVED = {"rod-flex", "sway-slosh", "second-lag"}
NONLINEAR = {"towed-line"}  # Effects whose states are not linear with constant coefficients.
THROUGH_STATES = {"compass-filtered"}  # Effects whose sizes act on an output through a state to first order.


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.study] * (name in SOLVED)) for name in catalogue()]
)
def test_columns_of_every_effect_are_finite_differences_of_the_extended_model(name: str) -> None:
    """Repeat the step in plain floats. This finds any mix-up of rows, inputs, states or scan points."""
    effect = catalogue()[name]
    path = path_for(base_for(effect), n_rows=12)
    larger = path.model + effect
    n, m = len(path.model.states), len(effect.states)
    u = path.record.for_model(larger).u
    found = list(path.effect(effect))
    assert len(found) == np.prod([len(values) for values in effect.scan.values()], initial=1.0)
    for columns, point in zip(found, product(*effect.scan.values()), strict=True):
        assert columns.scan == dict(zip(effect.scan, point, strict=True))
        values = np.append(path.values, [columns.scan.get(p.name, p.value) for p in effect.parameters])
        own = driven(larger, effect, path, values, u) if m else np.zeros((12, 0))
        x = np.column_stack([path.x, own])
        delta = whole(path, columns)
        assert delta.shape == (12, n + len(path.model.outputs), len(columns.parameters))
        assert columns.parameters[0] == effect.parameters[0].name
        for j, parameter in enumerate(columns.parameters):
            at = len(path.values) + [p.name for p in effect.parameters].index(parameter)
            step = effect.parameters[at - len(path.values)].step
            moved = values.copy()
            moved[at] += step
            own_moved = driven(larger, effect, path, moved, u) if name in THROUGH_STATES else own
            there = np.column_stack([path.x, own_moved])
            for k in range(12):
                change = (in_floats(larger, there[k], u[k], moved) - in_floats(larger, x[k], u[k], values)) / step
                wanted = np.delete(change, np.s_[n : n + m])
                np.testing.assert_allclose(delta[k, :, j], wanted, atol=1e-6 * (1 + np.abs(wanted).max()))


def driven(
    larger: Model, effect: Effect, path: TrajectoryLinearisation, values: np.ndarray, u: np.ndarray
) -> np.ndarray:
    """Integrate the effect's own states from their initial means. Their drive is held at its mean between two rows.

    States that are not linear are integrated by Heun's method.
    """
    n, m, t = len(path.model.states), len(effect.states), path.record.t
    z = np.zeros((t.size, m))
    z[0] = [
        values[list(larger.values).index(state.x0)] if isinstance(state.x0, str) else state.x0
        for state in effect.states
    ]
    if effect.name in NONLINEAR:
        for k in range(t.size - 1):
            first = in_floats(larger, np.append(path.x[k], z[k]), u[k], values)[n : n + m]
            there = np.append(path.x[k + 1], z[k] + (t[k + 1] - t[k]) * first)
            z[k + 1] = z[k] + (t[k + 1] - t[k]) * (first + in_floats(larger, there, u[k + 1], values)[n : n + m]) / 2
        return z

    def rate(at: float, z: np.ndarray) -> np.ndarray:
        ends = [in_floats(larger, np.append(path.x[i], z), u[i], values)[n : n + m] for i in (k, k + 1)]
        return np.asarray((ends[0] + ends[1]) / 2)

    for k in range(t.size - 1):
        solution = solve_ivp(rate, (t[k], t[k + 1] - 1e-12), z[k], rtol=1e-9, atol=1e-12, method="DOP853")
        z[k + 1] = solution.y[:, -1]
    return z


def test_states_of_a_towed_line_equal_an_independent_integration() -> None:
    """The boat goes ahead, turns and stops. Its line of 3 m becomes slack and taut again."""
    model = base_for()
    larger = model + catalogue()["towed-line"]
    values = np.array(list(larger.with_values({"l_line": 3.0, "x_line": -0.6}).values.values()))
    t = 0.05 * np.arange(800)
    states = [s.name for s in model.states]

    def motion(at: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Return surge velocity and yaw rate."""
        return 0.3 + 0.5 * np.sin(0.3 * np.asarray(at)), 0.5 * np.sin(0.21 * np.asarray(at))

    x = np.zeros((t.size, len(states)))
    x[:, states.index("u")], x[:, states.index("r")] = motion(t)
    u = np.zeros((t.size, len(larger.inputs)))
    found = VectorisedModel(larger).integrate_last_states(x, u, values[None], np.diff(t), np.array([[3.0, 0.0]]))[0]

    def rate(at: float, z: np.ndarray) -> list[float]:
        surge, turn = (float(v) for v in motion(at))
        distance = float(np.sqrt(z @ z + 0.05**2))
        e = z / distance
        along = surge * e[0] - 0.6 * turn * e[1]
        taut = 1.05 / (1 + 0.05 * np.exp(min((1 - distance / 3.0) / 0.02, 50.0)))
        speed = (along + np.sqrt(along**2 + 1e-4)) / 2 * taut
        return [surge + turn * z[1] - speed * e[0], -0.6 * turn - turn * z[0] - speed * e[1]]

    wanted = solve_ivp(rate, (0.0, t[-1]), [3.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-10).y.T
    np.testing.assert_allclose(found, wanted, atol=5e-3)
    assert np.hypot(*wanted.T).min() < 2.5  # slack in the meantime


@pytest.mark.parametrize("frequency", [0.25, 0.55, 1.37])
def test_pendulum_states_equal_an_independent_integration(frequency: float) -> None:
    """Integrate z'' + 2 zeta w z' + w^2 z = -a_x independently along a smooth path."""
    model = base_for()
    effect = catalogue()["pendulum"]
    t = 0.05 * np.arange(400)
    record = replace(made_record(with_all_inputs(model), n_rows=400), t=t)
    states = [s.name for s in model.states]
    x = np.zeros((400, len(states)))
    x[:, states.index("u")] = 0.5 + 0.2 * np.sin(0.8 * t)
    x[:, states.index("b_X")] = 6.0 * np.sin(2.1 * t) + 3.0 * np.cos(5.3 * t)
    record.u[:, [j for j, n in enumerate(record.inputs) if n.startswith("n_")]] = 0.0
    path = TrajectoryLinearisation(model, np.array(list(model.values.values())), record, x)
    columns = next(c for c in path.effect(effect) if c.scan["f_p"] == frequency)
    p = model.values
    omega, zeta = 2 * np.pi * frequency, effect.parameters[2].value

    def acceleration(at: float) -> float:
        u = 0.5 + 0.2 * np.sin(0.8 * at)
        force = 6.0 * np.sin(2.1 * at) + 3.0 * np.cos(5.3 * at)
        return float((force - p["d_u"] * u - p["d_uu"] * abs(u) * u) / p["m_u"])

    swing = solve_ivp(
        lambda at, z: [z[1], -2 * zeta * omega * z[1] - omega**2 * z[0] - acceleration(at)],
        (0.0, t[-1]),
        [0.0, 0.0],
        t_eval=t,
        rtol=1e-9,
        atol=1e-12,
    ).y
    spring = (2 * zeta * omega * swing[1] + omega**2 * swing[0]) / p["m_u"]
    wanted = spring + [acceleration(at) / p["m_u"] for at in t]  # The pendulum's mass no longer moves with the hull.
    np.testing.assert_allclose(whole(path, columns)[:, states.index("u"), 0], wanted, atol=0.01 * np.abs(spring).max())


def test_generic_features_are_smooth_functions_of_single_variables_and_products() -> None:
    path = path_for(base_for(), n_rows=500)
    table = generic_features(path.model, path.own, path.x)
    single = {(name,) for name in ("u", "v", "r", "t", "n_sum", "n_diff", "psi")}
    assert set(table) == single | {("u", "r"), ("u", "v"), ("v", "r")}
    z = variables(path.model, path.own, path.x)
    assert np.abs(z["psi"]).max() <= np.pi
    left, right = (path.own.u[:, path.own.inputs.index(n)] for n in ("n_left", "n_right"))
    np.testing.assert_allclose(z["n_sum"], (left + right) / 2)
    np.testing.assert_allclose(z["n_diff"], left - right)
    np.testing.assert_allclose(table[("psi",)][:, 2], np.sin(2 * z["psi"]), atol=1e-12)
    np.testing.assert_allclose(table[("u", "r")][:, 1], np.abs(z["u"]) * z["r"])
    for feature in table.values():
        assert feature.shape[0] == 500
        assert np.linalg.matrix_rank(feature) == feature.shape[1]


def test_generic_columns_act_along_one_force() -> None:
    path = path_for(base_for())
    states, p = [s.name for s in path.model.states], path.model.values
    found = {c.name: c for c in path.generic()}
    curves = {n for n in found if " " not in n or "," in n}
    assert len([n for n in curves if n[0] in "XYN"]) == 3 * 10
    losses = {f"{thrust}({of})" for thrust in ("T", "T_left", "T_right") for of in "vr"}
    assert curves - {n for n in curves if n[0] in "XYN"} == losses | {
        "psi(psi)",
        "psi(n_sum)",
        "psi(n_diff)",
        "r(r)",
        "ax(u)",
        "ax(r)",
        "ay(v)",
        "ay(r)",
    }
    assert set(found) - curves == {
        f"{force}({how} {of})" for force, of in (("X", "n_sum"), ("N", "n_diff")) for how in ("past of", "swing after")
    }
    table = generic_features(path.model, path.own, path.x)
    for force, state, mass in (("X", "u", p["m_u"]), ("Y", "v", p["m_v"]), ("N", "r", p["m_r"])):
        column = whole(path, found[f"{force}(u)"])
        np.testing.assert_allclose(column[:, states.index(state)], table[("u",)] / mass, atol=1e-9)
        assert found[f"{force}(u)"].kind is EffectKind.NONPARAMETRIC
        rest = [states.index(n) for n in ("u", "v", "r", "x", "y", "psi", "b_X", "b_Y", "b_N") if n != state]
        assert not column[:, rest].any()


def test_loss_of_one_thruster_acts_on_surge_and_yaw() -> None:
    path = path_for(base_for())
    states, p = [s.name for s in path.model.states], path.model.values
    n = path.own.u[:, path.own.inputs.index("n_left")]
    thrust = (p["c1"] * n * np.abs(n) + p["c2"] * n * n)[:, None]
    column = whole(path, {c.name: c for c in path.generic()}["T_left(r)"])
    z = generic_features(path.model, path.own, path.x)[("r",)]
    np.testing.assert_allclose(column[:, states.index("u")], thrust * z / p["m_u"], atol=1e-9)
    np.testing.assert_allclose(column[:, states.index("r")], 0.15 * thrust * z / p["m_r"], atol=1e-9)
    assert not column[:, [states.index(name) for name in ("x", "psi", "v", "b_X")]].any()


def test_columns_of_a_steady_wind_equal_the_columns_of_its_force() -> None:
    """The columns do not contain the drag that a wind of finite speed adds to a moving boat, for boats of any size."""
    path = path_for(base_for())
    states, p = [s.name for s in path.model.states], path.model.values
    psi = path.x[:, states.index("psi")]
    for factor in (1.0, 0.2):
        effect = scale_priors(catalogue()["wind"], VesselScale(factor))
        w_x = next(q.value for q in effect.parameters if q.name == "w_x")
        for columns in path.effect(effect):
            assert columns.parameters[:2] == ("F_wx", "F_wy")
            delta = whole(path, columns)
            surge, sway, yaw = (
                delta[:, states.index(s), :2] * p[m] for s, m in (("u", "m_u"), ("v", "m_v"), ("r", "m_r"))
            )
            across = np.column_stack([-np.sin(psi), np.cos(psi)])
            np.testing.assert_allclose(surge, w_x * np.column_stack([np.cos(psi), np.sin(psi)]), atol=0.01)
            np.testing.assert_allclose(sway, across, atol=0.02)
            np.testing.assert_allclose(yaw, columns.scan["w_n"] * across, atol=0.01)


def test_column_of_a_sensor_error_changes_only_its_output() -> None:
    path = path_for(base_for())
    n, outputs = len(path.model.states), [o.name for o in path.model.outputs]
    found = {c.name: c for c in path.generic()}
    column = whole(path, found["psi(psi)"])
    z = generic_features(path.model, path.own, path.x)[("psi",)]
    np.testing.assert_allclose(column[:, n + outputs.index("psi")], z, atol=1e-9)
    assert not np.delete(column, n + outputs.index("psi"), axis=1).any()


def test_splines_follow_a_smooth_function_and_omit_constant_variables() -> None:
    z = np.random.default_rng(0).uniform(-1, 2, 2000)
    basis = splines(z, 7)
    assert basis.shape == (2000, 6)
    np.testing.assert_allclose(basis.mean(0), 0.0, atol=1e-12)
    for f in (z, z * np.abs(z), z**3):
        wanted = f - f.mean()
        rest = wanted - basis @ np.linalg.lstsq(basis, wanted, rcond=None)[0]
        assert rest.std() < 0.02 * wanted.std()
    assert splines(np.full(50, 0.3), 6).shape == (50, 0)


def test_all_columns_omits_effects_without_inputs_and_effects_already_in_the_model() -> None:
    model = base_for()
    bare = made_record(model)
    x = np.random.default_rng(1).normal(size=(N_ROWS, len(model.states))) * 0.4
    values = np.array(list(model.values.values()))
    names = [c.name for c in all_columns(TrajectoryLinearisation(model, values, bare, x), catalogue().values())]
    assert not {"delay", "battery-sag", "force-delay", "force-lag", "lever-arm-force"} & set(names)
    assert "advance-ratio" in names
    assert "heading-moment" in names
    assert "N(psi)" in names  # This curve has a third harmonic, which heading-moment lacks.
    full = [c.name for c in all_columns(path_for(model), catalogue().values())]
    assert {"delay", "lag", "battery-sag"} <= set(full)
    present = model + catalogue()["cubic-drag"]
    again = TrajectoryLinearisation(present, np.array(list(present.values.values())), bare, x)
    assert "cubic-drag" not in [c.name for c in all_columns(again, catalogue().values())]


def test_spline_columns_have_the_same_meaning_in_every_record() -> None:
    """A run with a constant variable keeps its columns. They use the knots and the mean of all runs."""
    whole = np.random.default_rng(5).normal(size=400)
    still = np.full(50, 0.3)
    among = np.concatenate([whole, still])
    at_rest = splines(still, 6, among)
    assert at_rest.shape == (50, 5)
    together = splines(among, 6)
    np.testing.assert_allclose(at_rest, together[400:])
    np.testing.assert_allclose(splines(whole, 6, among), together[:400])
    assert splines(still, 6).shape == (50, 0)  # Alone, the constant variable carries no information.


def test_a_payload_has_one_column_in_each_record() -> None:
    """Drag and inertia of the load have no derivative without a load."""
    model = base_for()
    (columns,) = path_for(model).effect(between_runs_effect(model, "payload"))
    assert (columns.parameters, columns.per_record) == (("m_payload",), True)


def in_full(larger: Model, path: TrajectoryLinearisation, values: np.ndarray) -> list[np.ndarray]:
    """Return rates and outputs of a larger model, evaluated from its first stage on, with its own states at 0.1."""
    x = np.hstack([path.x, np.full((len(path.x), len(larger.states) - path.x.shape[1]), 0.1)])
    return VectorisedModel(larger).columns(x, path.record.for_model(larger).u, values)


@pytest.mark.parametrize("inputs", ["shaft", "command", "force"])
def test_continued_evaluation_equals_one_from_the_first_stage(inputs: str) -> None:
    """Check every candidate on a model with late sensors, which evaluates its dynamics again at an earlier time."""
    model = with_disturbances(horizontal_model(inputs))
    latency = {"shaft": "gnss-latency", "command": "gnss-latency-command", "force": "gnss-latency-force"}[inputs]
    for name in (latency, "delay", "lag", "compass", "wind"):
        effect = catalogue()[name]
        model = model + effect if model.accepts(effect) else model
    assert latency in [e.name for e in model.effects]
    model = model.with_values({p.name: p.step or 0.1 for p in model.parameters if p.value == 0.0 and p.free})
    path, tried = path_for(model), 0
    for effect in catalogue().values():
        if not model.accepts(effect):
            continue
        larger = model + effect
        values = np.array([p.value or p.step for p in larger.parameters])
        values[: len(path.values)] = path.values
        x = np.hstack([path.x, np.full((N_ROWS, len(effect.states)), 0.1)])
        u = path.record.for_model(larger).u
        assert path.recorded is not None
        continued = VectorisedModel(larger).columns(x, u, values, path.recorded)
        np.testing.assert_array_equal(continued, in_full(larger, path, values), err_msg=effect.name)
        np.testing.assert_array_equal(
            VectorisedModel(larger).rates(x, u, values, path.recorded), VectorisedModel(larger).rates(x, u, values)
        )
        tried += 1
    assert tried > 30


def test_continued_evaluation_computes_only_what_the_effect_changes() -> None:
    calls = []

    def counted(s: Signals) -> None:
        calls.append(1)

    model = horizontal_model() + Effect("counter", "", {"force": counted}) + catalogue()["gnss-latency"]
    path = path_for(model)
    assert path.recorded is not None
    once = len(calls)
    for name, again in (("lever-arm", 0), ("mismatch", 2)):  # at present, and at the time of the fix
        larger = model + catalogue()[name]
        path.recorded.signals(
            larger, list(path.x.T), list(path.record.for_model(larger).u.T), list(larger.values.values())
        )
        assert len(calls) - once == again
        once = len(calls)


def test_effect_that_changes_inputs_gets_no_recorded_result() -> None:
    """Check that the shaft speeds at the time of a late fix follow an input that the candidate changes."""

    def double(s: Signals) -> None:
        s.u.n_left = 2.0 * s.u.n_left

    model = (horizontal_model() + catalogue()["gnss-latency"]).with_values({"tau_gnss": 0.13})
    path = path_for(model)
    larger = model + Effect("double", "", {"rate": double})
    values = np.array(list(larger.values.values()))
    continued = VectorisedModel(larger).columns(path.x, path.record.for_model(larger).u, values, path.recorded)
    np.testing.assert_array_equal(continued, in_full(larger, path, values))
    assert not np.array_equal(continued, list(path.base.T))


def test_recorded_evaluation_refuses_functions_that_change_arrays_in_place() -> None:
    def spoil(s: Signals) -> None:
        s.x.u *= 2.0

    path = path_for(horizontal_model() + Effect("spoil", "", {"rate": spoil}))
    assert path.recorded is None


def test_recorded_evaluation_refuses_another_model() -> None:
    path = path_for(horizontal_model())
    other = horizontal_model() + catalogue()["wind"] + catalogue()["mismatch"]
    assert path.recorded is not None
    with pytest.raises(ValueError, match="is not the recorded model horizontal with one more effect"):
        path.recorded.signals(other, [], [], [])
