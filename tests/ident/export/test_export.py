"""Tests of exported models: they equal the model for every target and effect at random points, and their headers are
right.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner

from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.ident.cli.commands import ident
from seatrial.ident.data.record import Record
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation import thrust_scale_of
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.export.codegen import collect_content, identifiers, prefix
from seatrial.ident.export.formats import SUFFIXES, TARGETS, export
from seatrial.ident.export.model_description import variables
from seatrial.ident.model.parameter import Parameter, ParameterOrigin
from seatrial.ident.model.structure import Model, Output, Sensor, State, plain_model
from seatrial.ident.models.components import estimator_error, telemetry_age
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.kinematic import kinematic_model
from seatrial.ident.models.nomoto import nomoto_model
from seatrial.ident.models.thruster import thruster_model
from seatrial.ident.workflows.export import Target
from tests.ident.exported import (
    ALONE,
    KNOWN_SCALE,
    MODELS,
    compare,
    moved,
    points,
    run_c,
    run_casadi,
    run_python,
    saved,
)
from tests.test_docs import ROOT, blocks


# Each model with one of the two contents. `make study` also runs the other one.
@pytest.mark.parametrize(
    ("name", "nuisance"),
    [
        pytest.param(name, nuisance, marks=[pytest.mark.study] * (nuisance == (k % 2 == 0)))
        for k, name in enumerate(MODELS)
        for nuisance in (False, True)
    ],
)
def test_python_and_casadi_exports_equal_the_model(name: str, nuisance: bool, tmp_path: Path) -> None:
    model = moved(MODELS[name], 1)
    c = collect_content(saved(model), nuisance=nuisance)
    for target, run in (("python", run_python), ("casadi", run_casadi)):
        functions, space = run(export(saved(model), target, nuisance=nuisance), tmp_path)
        assert list(space["P"].values()) == list(c.values)
        assert (space["STATES"], space["INPUTS"], space["OUTPUTS"]) == (c.states, c.inputs, c.outputs)
        compare(model, functions, list(c.values), nuisance)


# Effects that the models with every effect cannot have, and one of every other kind. `make study` also runs the others.
KINDS_ALONE = {
    *("compass-filtered", "compass-motor", "velocity-point", "lever-arm-attitude", "mount-attitude"),
    *("delay", "lag", "battery-sag", "waves", "tether"),
}


def some(names: Iterable[str], kept: set[str]) -> list[Any]:
    """Return test parameters of these names. All names that are not in `kept` run only with `make study`."""
    return [pytest.param(name, marks=[pytest.mark.study] * (name not in kept)) for name in names]


@pytest.mark.parametrize("name", some(ALONE, KINDS_ALONE))
def test_export_of_every_effect_alone(name: str, tmp_path: Path) -> None:
    model = moved(ALONE[name], 2)
    c = collect_content(saved(model))
    for target, run in (("python", run_python), ("casadi", run_casadi)):
        compare(model, run(export(saved(model), target), tmp_path)[0], list(c.values), False)
    effect = set(c.parameters) & {p.name for p in catalogue()[name].parameters}
    assert effect, "the effect is in the exported model"


@pytest.mark.parametrize("name", some(MODELS, {*MODELS} - {"force with every effect", "without sway"}))
def test_c_export_equals_the_model(name: str, tmp_path: Path) -> None:
    model = moved(MODELS[name], 3)
    c = collect_content(saved(model))
    functions, defaults = run_c(export(saved(model), "c"), tmp_path, c.name)
    assert defaults == list(c.values)
    compare(model, functions, list(c.values), False)


@pytest.mark.parametrize("name", some(MODELS, {*MODELS} - {"force with every effect", "without sway"}))
def test_ros2_values_are_exact(name: str) -> None:
    yaml = pytest.importorskip("ruamel.yaml", reason="no YAML reader here (ruamel.yaml)")
    model = moved(MODELS[name], 4).with_values({MODELS[name].parameters[0].name: 1e-5})
    c, text = collect_content(saved(model)), export(saved(model), "ros2")
    for version in ((1, 1), (1, 2)):
        reader = yaml.YAML(typ="safe", pure=True)
        reader.version = version
        table = reader.load(text)[c.name]["ros__parameters"]
        assert table["parameters"] == dict(zip(c.parameters, c.values, strict=True))
        assert all(isinstance(v, float) for v in table["parameters"].values())
        own, scale = list(zip(c.parameters, c.exported_parameters, c.errors, strict=True)), thrust_scale_of(model)
        known = {n: e for n, p, e in own if e == e and not any(scale.powers(p.unit))}
        assert table.get("standard_errors", {}) == known
        assert table["process_noise"] == dict(zip(c.states, c.state_noise, strict=True))
        assert table["measurement_noise"] == dict(zip(c.outputs, c.output_noise, strict=True))
        assert (tuple(table["states"]), tuple(table["outputs"])) == (c.states, c.outputs)
        assert table["units"] == {n: "relative" if any(scale.powers(p.unit)) else p.unit for n, p, _ in own}
        assert table.get("validity", {}) == ({"u": [-0.5, 1.2]} if "u" in c.states else {})


def test_exported_step_equals_that_of_the_engine() -> None:
    """The exported step must equal the step that the fit used."""
    model = moved(ALONE["pendulum"], 6)
    functions, _ = run_python(export(saved(model), "python"), Path())
    x, u = points(model, 2)
    u[0] = u[1]
    y = np.full((2, len(model.outputs)), np.nan)
    names = tuple(i.name for i in model.inputs), tuple(o.name for o in model.outputs)
    ran = simulate(model, Record("one", np.array([0.0, 0.1]), u, u, y, *names), x0=x[1])
    np.testing.assert_allclose(
        functions[2](x[1], u[1], 0.1, list(collect_content(saved(model)).values)), ran.x[1], rtol=1e-11
    )


def test_exported_parameters_can_be_replaced_and_contain_no_noise() -> None:
    text = export(saved(with_disturbances(horizontal_model())), "python")
    _, space = run_python(text, Path())
    x, u = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0], [0.5, 0.5]
    heavy = space["f"](x, u, {**space["P"], "m_u": 2 * space["P"]["m_u"]})[3]
    assert heavy == pytest.approx(space["f"](x, u)[3] / 2, rel=1e-12)
    assert not {"e_psi", "s_u", "q_X", "tau_b"} & set(space["P"])
    assert space["OUTPUT_NOISE"]["psi"] == 0.01


@pytest.mark.parametrize("name", some(("as fitted", "shaft with every effect"), {"as fitted"}))
@pytest.mark.parametrize("target", TARGETS)
def test_export_is_reproducible(target: str, name: str) -> None:
    model = MODELS[name]
    assert export(saved(model), target) == export(saved(replace(model)), target)


@pytest.mark.parametrize("target", TARGETS)
def test_header_describes_inputs_validity_and_omissions(target: str) -> None:
    model = with_disturbances(horizontal_model())
    for name in ("delay", "battery-sag", "current-drift"):
        model = model + catalogue()[name]
    text = export(saved(model), target)
    for words in (
        "made by: seatrial ident vehicle a.mcap --x",
        "a.mcap sha256:12",
        "n_left_ago_1 to u[9] n_left_ago_8: n_left [-], 8 delayed copies, 0.1 to 0.8 s late",
        "NAME~K",
        "Velocities: 98 % of the data, between the 1 % and 99 % quantiles. Inputs: all data.",
        "u from -0.5 to 1.2",
        "Left out, as a controller does not need them: b_X, b_Y, b_N, bias_",
        "|n_left|^3",
        "the time since the start of the run",
        "V_x, V_y, V_dx, V_dy",
        "psi [rad], an angle",
    ):
        assert words in text, words
    assert "gone" not in text
    kept = export(saved(model), target, nuisance=True)
    assert "Left out" not in kept
    assert "tau_b" in kept
    bench = export(saved(thruster_model()), target)
    assert "u[0] n_cmd_0 to u[48] n_cmd_48: n_cmd [-], 49 delayed copies, 0 to 0.6 s late" in bench


@pytest.mark.parametrize("target", TARGETS)
def test_header_explains_delayed_inputs_and_the_age_of_telemetry(target: str) -> None:
    model = (horizontal_model() + catalogue()["delay"] + telemetry_age()).with_values({"tau_age": 0.08})
    left_out, kept = (export(saved(model), target, nuisance=n) for n in (False, True))
    for text in (left_out, kept):
        assert "was measured 0.08 s before its time stamp (telemetry age, tau_age)" in text
        assert "which a delay, a lag or the age of telemetry in the model needs" in text
    assert "the inputs are present shaft speeds. Subtract it from the stamps of telemetry" in left_out
    assert "set tau_age = 0" in kept
    assert "telemetry age" not in export(saved(horizontal_model()), target)


def test_omitted_disturbance_forces_become_process_noise_of_the_same_strength() -> None:
    """A free body that is pushed by the force for a long time has the same spread of speed as with the white noise."""
    model = with_disturbances(horizontal_model(current=False))
    c = collect_content(saved(model))
    q, tau, m = (model.values[n] for n in ("q_X", "tau_b", "m_u"))
    rng, dt, n = np.random.default_rng(0), 0.05, 4000
    force, speed = rng.normal(0, q * math.sqrt(tau / 2), 3000), np.zeros(3000)
    for _ in range(n):
        speed += force / m * dt
        force += -force / tau * dt + q * math.sqrt(dt) * rng.normal(size=3000)
    found = speed.std() / math.sqrt(n * dt)
    assert c.state_noise[c.states.index("u")] == pytest.approx(found, rel=0.05)
    assert collect_content(saved(model), nuisance=True).state_noise[3] == 1e-4


@pytest.mark.parametrize("target", TARGETS)
def test_correlated_errors_are_in_the_noise_of_their_outputs(target: str) -> None:
    """The errors of an estimator, and of the force on a bench, are included with their stationary variance. The header
    contains their correlation times.
    """
    model = horizontal_model(sensors=("attitude", "gyro", "position"))
    model = (model + estimator_error([s.name for s in model.sensors])).with_values({"e_xy": 0.001, "A_xy": 0.2})
    noise = dict(zip(collect_content(saved(model)).outputs, collect_content(saved(model)).output_noise, strict=True))
    assert noise["x"] == noise["y"] == pytest.approx(math.hypot(0.001, 0.2))
    v = model.values
    # The integrated error of the gyro.
    turn = v["A_r"] * v["tau_psi"] * math.sqrt(v["tau_r"] / (v["tau_r"] + v["tau_psi"]))
    assert noise["psi"] == pytest.approx(math.hypot(v["e_psi"], v["A_psi"], turn))
    assert noise["r"] == pytest.approx(math.hypot(v["e_r"], v["A_r"]))
    assert "psi (3 s), r (0.1 s), x (3 s), y (3 s)." in " ".join(export(saved(model), target).split())
    kept = collect_content(saved(model), nuisance=True)
    assert (kept.output_noise[kept.outputs.index("x")], kept.noise_time_scale) == (0.001, {})
    bench = thruster_model()
    force, values = collect_content(saved(bench)).output_noise[-1], bench.values
    assert force == pytest.approx(math.hypot(values["e_f"], values["q_f"] * math.sqrt(values["tau_f"] / 2)))


def test_coupled_estimator_errors_have_the_size_of_their_simulation() -> None:
    """In an estimator with velocities, the acceleration error is integrated into the position. The reference is Euler's
    method.
    """
    model = horizontal_model(sensors=("attitude", "position", "ground_velocity"))
    model = model + estimator_error([s.name for s in model.sensors])
    v = {"tau_axy": 8.0, "tau_vxy": 2.0, "tau_xy": 4.0, "A_axy": 0.1, "A_vxy": 0.03, "A_xy": 0.2}
    model = model.with_values(v)
    c = collect_content(saved(model))
    noise = dict(zip(c.outputs, c.output_noise, strict=True))
    rng, dt, n, white = np.random.default_rng(1), 0.02, 4000, model.values
    a, speed, place = rng.normal(0, v["A_axy"], 4000), np.zeros(4000), np.zeros(4000)
    for _ in range(n):
        a, speed, place = (
            e + dt * (driven - e / v[f"tau_{name}"]) + v[f"A_{name}"] * np.sqrt(2 * dt / v[f"tau_{name}"]) * w
            for e, driven, name, w in zip((a, speed, place), (0.0, a, speed), ("axy", "vxy", "xy"),
                                          rng.normal(size=(3, 4000)), strict=True)
        )  # fmt: skip
    gain, area = 1.0, 0.0  # Area under the autocovariance: half of the spectral density at zero.
    for name in ("xy", "vxy", "axy"):
        gain *= v[f"tau_{name}"]
        area += gain**2 * v[f"A_{name}"] ** 2 / v[f"tau_{name}"]
    assert noise["vx"] == noise["vy"] == pytest.approx(math.hypot(speed.std(), white["e_vxy"]), rel=0.03)
    assert noise["x"] == pytest.approx(math.hypot(place.std(), white["e_xy"]), rel=0.03)
    assert c.noise_time_scale["x"] == pytest.approx(area / place.var(), rel=0.06)


def test_omitted_sideslip_is_noise_of_both_axes() -> None:
    """A filter may have any heading. With all noise in east, as at heading zero, north would be treated as exact."""
    model = nomoto_model(sampled=True)
    c, values = collect_content(saved(model)), model.values
    diffusion, spread = values["q_v"] * values["tau_v"], values["q_v"] * math.sqrt(values["tau_v"] / 2)
    for names, noise, own, whole in (
        (("x", "y"), dict(zip(c.states, c.state_noise, strict=True)), 0.0, diffusion),
        (("vx", "vy"), dict(zip(c.outputs, c.output_noise, strict=True)), values["e_vxy"], spread),
    ):
        assert noise[names[0]] == pytest.approx(noise[names[1]]) == pytest.approx(math.hypot(own, whole / math.sqrt(2)))
    assert c.states_without_noise == ("stamp_error_left", "stamp_error_right")
    assert "have no effect at rest: stamp_error_left, stamp_error_right." in " ".join(export(saved(model), "c").split())


def known_scale(model: Model) -> Model:
    """Return the horizontal model with the thrust and the arms of its thrusters as given values."""
    given = (("c1", 40.0), ("y_left", -0.2), ("y_right", 0.2))
    return model.replace_parameters(*(model.parameter(n).known(v, 0.0, ParameterOrigin.GIVEN) for n, v in given))


@pytest.mark.parametrize("target", TARGETS)
def test_unknown_thrust_is_stated_in_the_header(target: str) -> None:
    """Numbers whose scale is not known have a ratio in place of unit and standard error."""
    model = horizontal_model()
    fitted = replace(saved(model), errors={"m_u": 2.88, "m_r": 0.77, "q_u": 0.01})
    text = export(fitted, target)
    assert isinstance(text, str)
    line = "The thrust was not given: masses, damping and forces are right as ratios to c1 + c2 only"
    assert any(line in top for top in text.splitlines()[:4])
    assert any("The arms were not given" in top for top in text.splitlines()[:5])
    v = model.values
    full = v["c1"] + v["c2"]
    assert f"[relative: m_u/T = {v['m_u'] / full:.4g} kg/N] surge mass" in text
    assert f"[relative: m_r/(T y_arm) = {v['m_r'] / full / v['y_right']:.4g} kg m2/(N m)] " in text
    assert f"[relative: c1/T = {v['c1'] / full:.4g}] built-in, thrust" in text
    assert not [word for word in ("[kg", "[N", "2.88", "0.77", '"kg') if word in text]
    text = export(replace(fitted, model=known_scale(model)), target)
    assert "relative" not in text
    assert "[N] given, thrust" in text
    assert "[kg] +- 2.88 surge mass" in text


def test_unknown_thrust_has_no_unit_in_an_fmu() -> None:
    units = {v.name: v.unit for v in variables(collect_content(saved(horizontal_model())))}
    assert (units["p.m_u"], units["p.c1"], units["u"]) == ("", "", "m/s")
    units = {v.name: v.unit for v in variables(collect_content(saved(known_scale(horizontal_model()))))}
    assert (units["p.m_u"], units["p.c1"]) == ("kg", "N")


def test_export_of_an_unknown_thrust_prints_one_warning(tmp_path: Path) -> None:
    """The parameters that a model.toml lacks have built-in values."""
    text = blocks(ROOT / "docs/formats/model.md", "toml")[0]
    source, words = tmp_path / "model.toml", ["export", str(tmp_path / "model.toml"), "--to", "c"]
    source.write_text(text + KNOWN_SCALE, encoding="utf-8")
    CliRunner().invoke(ident, words, catch_exceptions=False)  # pytest turns a warning into an error
    source.write_text(text, encoding="utf-8")
    with pytest.warns(SeatrialWarning) as found:
        CliRunner().invoke(ident, words, catch_exceptions=False)
    (line,) = (str(w.message) for w in found)
    assert "right only as ratios to the thrust c1 + c2, not in kg and N" in line
    assert "right only as ratios to the arms" in line
    assert "--fix c1=VALUE" in line


@pytest.mark.parametrize(
    ("program", "meant"),
    [
        ("Simulink", "Did you mean 'fmu' (FMI 2.0 co-simulation, for Simulink, OpenModelica and others)?"),
        ("matlab", "to_mat(FILE)` in Python)?"),
        ("arduino", "Did you mean 'c'?"),
        ("pyton", "Did you mean 'python'?"),
    ],
)
def test_export_to_a_program_names_its_format(tmp_path: Path, program: str, meant: str) -> None:
    source = tmp_path / "model.toml"
    source.write_text("", encoding="utf-8")
    done = CliRunner().invoke(ident, ["export", str(source), "--to", program])
    assert done.exit_code == 2
    assert meant in done.output


def test_export_of_a_model_that_did_not_converge_says_so_on_the_screen_and_in_the_file(tmp_path: Path) -> None:
    text = blocks(ROOT / "docs/formats/model.md", "toml")[0] + KNOWN_SCALE
    for target in ("python", "c", "casadi", "ros2"):
        source, words = tmp_path / "model.toml", ["export", str(tmp_path / "model.toml"), "--to", target]
        source.write_text(text, encoding="utf-8")
        assert "did not converge" not in CliRunner().invoke(ident, words, catch_exceptions=False).stdout
        source.write_text(text.replace("name =", "converged = false\nname =", 1), encoding="utf-8")
        with pytest.warns(SeatrialWarning, match="the fit of this model did not converge") as found:
            done = CliRunner().invoke(ident, words, catch_exceptions=False)
        assert len(found) == 1
        assert any("WARNING: the fit of this model did not converge" in line for line in done.stdout.splitlines()[:4])


def test_offsets_of_a_measured_attitude_are_omitted_like_all_others() -> None:
    model = with_disturbances(kinematic_model(yaw=True))
    assert collect_content(saved(model)).states == ("x", "y", "u", "v", "r")
    text = export(saved(model), "python")
    left = "Left out, as a controller does not need them: bias_psi, bias_r, b_X, b_Y, b_N, bias_ax, bias_ay"
    assert left in text
    assert "bias" not in text.replace(left, "")
    assert {"bias_psi", "bias_r", "bias_ax"} <= set(collect_content(saved(model), nuisance=True).states)


def test_identifiers_are_valid_and_unique() -> None:
    names = identifiers(["n~3", "n_ago_3", "2fast", "u\u2080 x", "", "n_ago_3"])
    assert [prefix(n) for n in ("odd boat 2!", "2", "__", "a__b")] == ["odd_boat_2", "model_2", "model", "a_b"]
    assert names == ("n_ago_3", "n_ago_3_2", "_2fast", "u__x", "_", "n_ago_3_3")


def test_operation_that_cannot_be_exported_is_reported() -> None:
    strange = plain_model(
        "strange",
        f=lambda x, u, p: {"a": ca.erfinv(x.a)},
        h=lambda x, u, p: {"y": x.a},
        states=(State("a"),),
        inputs=(),
        sensors=(Sensor("s", (Output("y", noise="e"),)),),
        parameters=(Parameter("e", 1.0),),
    )
    with pytest.raises(ValueError, match=r"an operation .* that cannot be exported"):
        export(saved(strange), "python")


def test_command_and_request_have_the_same_targets() -> None:
    (option,) = [p for p in ident.commands["export"].params if p.name == "target"]
    assert tuple(option.type.choices) == get_args(Target) == tuple(SUFFIXES)


@pytest.mark.parametrize("target", TARGETS)
def test_export_command(target: str, tmp_path: Path) -> None:
    source, out = tmp_path / "model.toml", tmp_path / "out"
    source.write_text(blocks(ROOT / "docs/formats/model.md", "toml")[0], encoding="utf-8")
    words = ["export", str(source), "--to", target, "--name", "my-boat"]
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always", SeatrialWarning)
        done = CliRunner().invoke(ident, [*words, "-o", str(out)], catch_exceptions=False)
        shown = CliRunner().invoke(ident, words, catch_exceptions=False)
    lines = [str(w.message) for w in found]
    assert lines.count("the name 'my-boat' is not valid in the file and becomes my_boat") == 2
    assert done.stdout == f"wrote {out}\n"
    unnamed = "out: Python cannot import a file of this name; out.py would be a valid one"
    assert (unnamed in lines) == (target in ("python", "casadi"))
    assert shown.stdout == out.read_text(encoding="utf-8")
    assert "my_boat" in shown.stdout or target == "python"
    assert "35.53" in shown.stdout


@pytest.mark.parametrize(
    ("name", "valid"),
    [
        ("my-boat.py", "my_boat.py"),
        ("2nd.py", "model_2nd.py"),
        ("class.py", "class_model.py"),
        ("boat.txt", "boat_txt.py"),
    ],
)
def test_python_file_that_cannot_be_imported_is_reported(name: str, valid: str, tmp_path: Path) -> None:
    source = tmp_path / "model.toml"
    source.write_text(blocks(ROOT / "docs/formats/model.md", "toml")[0] + KNOWN_SCALE, encoding="utf-8")
    words = ["export", str(source), "--to", "python", "-o"]
    with pytest.warns(SeatrialWarning, match=f"^{name}: Python cannot import a file of this name; {valid} would be"):
        CliRunner().invoke(ident, [*words, str(tmp_path / name)], catch_exceptions=False)
    CliRunner().invoke(ident, [*words, str(tmp_path / valid)], catch_exceptions=False)
    CliRunner().invoke(ident, [*words[:3], "c", "-o", str(tmp_path / "my-boat.h")], catch_exceptions=False)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("python", "--mass", "30"), "--mass has no effect on an export to python; leave it out"),
        (("fmu", "--inertia", "3", "-o", "x.fmu"), "--inertia has no effect on an export to fmu; leave it out"),
        (("c", "--source-only"), "--source-only has no effect on an export to c; leave it out"),
        (("vrx", "--with-disturbance-states"), "--with-disturbance-states has no effect on an export to vrx;"),
        (
            ("c", "--thrust-curve", "boat"),
            "--thrust-curve chooses between the thrust curves of the boat and of a bench test, and no bench test was "
            "given; add --thruster",
        ),
    ],
)
def test_options_that_do_not_fit_are_refused(words: tuple[str, ...], line: str, tmp_path: Path) -> None:
    source = tmp_path / "model.toml"
    source.write_text(blocks(ROOT / "docs/formats/model.md", "toml")[0], encoding="utf-8")
    done = CliRunner().invoke(ident, ["export", str(source), "--to", *words])
    assert isinstance(done.exception, SeatrialError)
    assert str(done.exception).startswith(line)
    assert done.stdout == ""


def test_export_command_rejects_a_file_that_is_not_a_model(tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text("{}", encoding="utf-8")
    done = CliRunner().invoke(ident, ["export", str(tmp_path / "result.json"), "--to", "c"])
    assert isinstance(done.exception, SeatrialError)
    assert "result.json: this is a result file (JSON), not a model, and no model.toml is beside it" in str(
        done.exception
    )
