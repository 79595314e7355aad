"""Tests of model.toml: a fitted model is restored with its effects and curves, and a damaged file gives a one-line
error.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pytest
import tomlkit

from seatrial.api.fits import vehicle_request
from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.ident.characterisation.thrust_curve import load_curve
from seatrial.ident.cli.commands import vehicle
from seatrial.ident.cli.options import ModelSource
from seatrial.ident.data.record import build_record
from seatrial.ident.effects.nonparametric import input_response_effects, nonparametric_effect
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.engine.vectorised_model import VectorisedModel
from seatrial.ident.estimation.homogeneity import between_runs_effect
from seatrial.ident.estimation.interval_widening import ErrorScale, IntervalCalibration
from seatrial.ident.estimation.maximum_likelihood import Fit, SearchSettings, fit
from seatrial.ident.estimation.model_file import FittedData, load_model, model_file, save_model
from seatrial.ident.estimation.refitted_effect import RefittedEffect
from seatrial.ident.model.structure import ForceCurve, Model
from seatrial.ident.models.catalogue import make_model
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.scaling import VesselScale, rescale, scale_priors, size_of
from tests.missions import boat_with, channels_of, sail

SPAN = (-0.3, 1.1)
VALIDITY = {"u": (-0.2, 1.3), "n_left": (-1.0, 1.0)}


@pytest.fixture(scope="module")
def found() -> Fit:
    """Return a short fit of few parameters. Only the model file matters here."""
    channels = channels_of(sail(boat_with(None, 1), 40.0, 1)[0])
    model = horizontal_model(sensors=("attitude", "gyro", "position")).with_free(["m_r", "d_rr", "d_vv", "V_x", "V_y"])
    runs = [build_record(model, channels, name=f"run {a:g}", t_from=a, t_to=a + 20.0) for a in (0.0, 20.0)]
    return fit(model, runs, settings=SearchSettings(max_iterations=8))


def with_model(found: Fit, model: Model) -> Fit:
    """Return the fit with another model and without estimated parameters."""
    none, square = np.zeros(0), np.zeros((0, 0))
    return replace(found, model=model, parameters=(), values=none, errors=none, correlation=square, flags=())


def saved(path: Path, found: Fit, rates: dict[str, float] | None = None, **extra: object) -> Path:
    data, provenance = FittedData(VALIDITY, rates or {}), {"made_by": "a test", "logs": ["a"], "none": None}
    save_model(path, found, data=data, provenance=provenance, **extra)  # type: ignore[arg-type]
    return path


def rates(model: Model) -> np.ndarray:
    rng = np.random.default_rng(0)
    x, u = rng.normal(size=(20, len(model.states))), rng.uniform(-1, 1, (20, len(model.inputs)))
    return VectorisedModel(model)(x, u, np.array(list(model.values.values())))


def test_effects_that_a_diagnosis_tried_are_restored(tmp_path: Path, found: Fit) -> None:
    tried = (
        RefittedEffect("delay", (), {"tau_delay": 0.125}, {"tau_delay": 0.02}),
        RefittedEffect("tether", ("wind", "lag"), {"k": 0.1, "x_tether": -3.0}, {}),
    )
    assert load_model(saved(tmp_path / "tried.toml", found, refits=tried)).refits == tried
    assert load_model(saved(tmp_path / "none.toml", found)).refits == ()


def test_scales_of_the_validation_errors_are_restored(tmp_path: Path, found: Fit) -> None:
    """A file without the table, as of an earlier version, loads without scales, and a wrong number is named."""
    ahead = {"r": ErrorScale(1.2345, 40.25, 2), "psi": ErrorScale(np.inf, 1.0, 1)}
    known = IntervalCalibration(10.0, ahead, {"r": ErrorScale(0.75, 2.5, 1)})
    path, data = tmp_path / "model.toml", FittedData(VALIDITY, intervals=known)
    save_model(path, found, data=data, provenance={})
    assert load_model(path).intervals == known
    assert load_model(saved(tmp_path / "none.toml", found)).intervals is None
    text = path.read_text(encoding="utf-8")
    for old, new, message in (
        ("n_records = 2", "n_records = 0", "intervals: r needs a scale of 0 or more"),
        ("scale = 1.2345", "scale = nan", "intervals: r needs a scale of 0 or more"),
        ("horizon = 10.0", "horizon = 0.0", "intervals: horizon = 0; it must be finite and above 0 s"),
        ("n_effective = 40.25, ", "", "it has no entry 'n_effective'"),
    ):
        assert old in text
        path.write_text(text.replace(old, new), encoding="utf-8")
        with pytest.raises(SeatrialError, match=message):
            load_model(path)


@pytest.mark.parametrize("converged", [True, False])
def test_a_fit_that_did_not_converge_is_marked(tmp_path: Path, found: Fit, converged: bool) -> None:
    path = saved(tmp_path / "model.toml", replace(found, converged=converged))
    assert load_model(path).converged is converged
    assert ("converged = false" in path.read_text(encoding="utf-8")) is not converged


def test_fitted_model_is_restored(tmp_path: Path, found: Fit) -> None:
    found = replace(found, inflation=np.where(np.array(found.names) == "m_r", 2.5, 1.0))
    back = load_model(saved(tmp_path / "model.toml", found))
    assert back.inflation == {"m_r": 2.5}
    for p in found.model.parameters:
        again = back.model.parameter(p.name)
        assert again.free == p.free, p.name
        assert again.value == (p.value if p.per_record else found.estimate(p.name)[0]), p.name
        assert (again.unit, again.prior, again.transform) == (p.unit, p.prior, p.transform)
    assert [s.name for s in back.model.sensors] == ["attitude", "gyro", "position"]
    np.testing.assert_array_equal(rates(back.model), rates(found.model))
    for name in found.model.values:
        if not found.model.parameter(name).per_record:
            np.testing.assert_equal(back.errors[name], found.estimate(name)[1])
    assert np.isfinite(back.errors["m_r"])
    assert np.isnan(back.errors["c1"])
    assert back.validity == VALIDITY
    assert back.rates == {}
    assert load_model(saved(tmp_path / "with_rates.toml", found, rates={"gyro": 9.98765})).rates == {"gyro": 9.988}
    assert back.provenance == {"made_by": "a test", "logs": ["a"]}


@pytest.mark.parametrize("propulsion", ["shaft", "force"])
def test_effects_are_restored_with_their_values(tmp_path: Path, found: Fit, propulsion: str) -> None:
    model = with_disturbances(horizontal_model(propulsion))  # type: ignore[arg-type]
    chosen = [e for e in catalogue().values() if model.accepts(e)]
    assert len(chosen) > 15
    for effect in chosen:
        model = model + effect
    moved = {p.name: p.value + 0.7 * p.step for e in chosen for p in e.parameters if p.step}
    model = model.with_values(moved)
    back = load_model(saved(tmp_path / "model.toml", with_model(found, model))).model
    assert [e.name for e in back.effects] == [e.name for e in model.effects]
    assert {n: back.values[n] for n in moved} == moved
    np.testing.assert_array_equal(rates(back), rates(model))


@pytest.mark.parametrize("variable", ["u", "psi", "u, r", "n_diff", "t"])
def test_nonparametric_effects_are_restored_with_their_span(tmp_path: Path, found: Fit, variable: str) -> None:
    effect = nonparametric_effect(horizontal_model(), ForceCurve("X", *variable.split(", ")), SPAN)
    model = horizontal_model() + effect
    model = model.with_values({p.name: 0.3 * (k + 1) for k, p in enumerate(effect.parameters)})
    path = saved(tmp_path / "model.toml", with_model(found, model))
    back = load_model(path).model
    np.testing.assert_allclose(rates(back), rates(model), rtol=1e-12)
    assert back.effects[0].span == SPAN
    # A command that only refits the model writes it again.
    again = load_model(saved(tmp_path / "again.toml", with_model(found, back))).model
    np.testing.assert_allclose(rates(again), rates(model), rtol=1e-12)
    assert back.effects[0].parameters[0].prior == effect.parameters[0].prior
    assert (back.effects[0].kind, back.effects[0].curve) == (effect.kind, effect.curve)


@pytest.mark.parametrize("difference", ["payload", "thrust", "d_uu"])
def test_differences_between_runs_are_restored(tmp_path: Path, found: Fit, difference: str) -> None:
    effect = between_runs_effect(found.model, difference)
    name = effect.parameters[0].name
    model = (found.model + effect).with_values({name: 0.2})
    path = saved(tmp_path / "model.toml", with_model(found, model))
    back = load_model(path).model
    assert back.parameter(name).per_record
    assert back.parameter(name).prior == pytest.approx(effect.parameters[0].prior)
    np.testing.assert_allclose(rates(back), rates(model), rtol=1e-12)
    assert np.abs(rates(model) - rates(model.with_values({name: 0.0}))).max() > 1e-4


def test_responses_to_inputs_are_restored(tmp_path: Path, found: Fit) -> None:
    for effect in input_response_effects(horizontal_model()):
        model = horizontal_model() + effect
        model = model.with_values({p.name: 0.3 for p in effect.parameters if p.transform == "none"})
        back = load_model(saved(tmp_path / "model.toml", with_model(found, model))).model
        assert [(e.name, e.kind, e.curve) for e in back.effects] == [(effect.name, effect.kind, effect.curve)]
        assert back.values == pytest.approx(model.values)


def test_responses_in_another_unit_are_rejected(tmp_path: Path, found: Fit) -> None:
    """The coefficients of a share of the thrust are not coefficients in newtons."""
    model = horizontal_model("force") + input_response_effects(horizontal_model("force"))[0]
    path = saved(tmp_path / "model.toml", with_model(found, model))
    document = tomlkit.parse(path.read_text(encoding="utf-8"))
    for row in document["parameter"]:
        if row["name"].startswith("X_f_sum"):
            row["unit"] = "N"
    path.write_text(tomlkit.dumps(document), encoding="utf-8")
    with pytest.raises(SeatrialError, match=r"X_f_sum_late_0 is stored in N, but this version has it in 1"):
        load_model(path)


def test_effect_of_a_large_boat_is_restored_with_its_bounds_and_states(tmp_path: Path, found: Fit) -> None:
    """A mass of 400 kg swings in a boat of 1 t. The bounds of the catalogue are for a boat of 37 kg."""
    boat = horizontal_model("force").with_values({"m_u": 1000.0, "m_r": 2000.0})
    model = boat
    for name in ("pendulum", "force-lag"):
        model = model + scale_priors(catalogue()[name], size_of(boat))
    model = model.with_values({"m_p": 400.0})
    back = load_model(saved(tmp_path / "model.toml", with_model(found, model))).model
    assert back.parameter("m_p") == model.parameter("m_p")
    assert [s.sd0 for s in back.states] == [s.sd0 for s in model.states]
    full = model.with_values({"m_p": model.parameter("m_p").bounds[1], "m_u": 990.0})  # The refitted boat is lighter.
    again = load_model(saved(tmp_path / "again.toml", with_model(found, full))).model
    assert again.values["m_p"] > 800.0
    # The states keep the scale of the original model.
    assert [(s.sd0, s.noise) for s in again.states] == [(s.sd0, s.noise) for s in model.states]


def test_model_in_user_code_is_restored(tmp_path: Path, found: Fit) -> None:
    file = tmp_path / "mine.py"
    file.write_text(
        "from dataclasses import replace\nfrom seatrial.ident.models import yaw_model\n"
        f"def boat():\n    return replace(yaw_model(), source={f'{file}:boat'!r})\n",
        encoding="utf-8",
    )
    mine = make_model(f"{file}:boat")
    back = load_model(saved(tmp_path / "model.toml", with_model(found, mine.with_values({"m_r": 12.0})))).model
    assert back.values["m_r"] == 12.0
    assert [s.name for s in back.states] == ["r"]


def test_considered_parameters_are_restored(tmp_path: Path, found: Fit) -> None:
    arm = replace(horizontal_model().parameter("y_left"), prior=(-0.15, 0.01), considered=True)
    for p in (arm, replace(arm, considered=False)):
        model = with_disturbances(horizontal_model()).replace_parameters(p)
        back = load_model(saved(tmp_path / "model.toml", with_model(found, model))).model
        assert back.considered == model.considered == (("y_left",) if p.considered else ())
        assert back.parameter("y_left").prior == p.prior


def test_priors_are_restored(tmp_path: Path, found: Fit) -> None:
    """This covers priors of the user and of an effect for a large boat. The priors of disturbance forces are scaled
    again.
    """
    size = VesselScale(20.0, 3.0)
    model = with_disturbances(horizontal_model()) + scale_priors(catalogue()["yaw-bias"], size)
    given_priors = (
        replace(model.parameter("m_r"), prior=(600.0, 50.0)),
        replace(model.parameter("d_u"), prior=(0.5, 2.0)),
    )
    model = rescale(model.replace_parameters(*given_priors), size)
    path = saved(tmp_path / "model.toml", with_model(found, model))
    back = load_model(path).model
    unexplained = {"q_X", "q_Y", "q_N", "tau_b"}
    wanted = {p.name: p.prior for p in model.parameters if p.name not in unexplained}
    assert {n: back.parameter(n).prior for n in wanted} == wanted
    assert wanted["m_r"] == (600.0, 50.0)
    assert wanted["N_0"] == tuple(60.0 * z for z in catalogue()["yaw-bias"].parameters[0].prior or ())
    again = rescale(back, size)
    for name in unexplained:
        assert again.parameter(name).prior == pytest.approx(model.parameter(name).prior), name


def change(**keys: object) -> object:
    def apply(document: tomlkit.TOMLDocument) -> None:
        for key, value in keys.items():
            if value is None:
                del document[key]
            else:
                document[key] = value

    return apply


def rename_parameter(document: tomlkit.TOMLDocument) -> None:
    document["parameter"][0]["name"] = "m_x"  # type: ignore[index]


def word_for_value(document: tomlkit.TOMLDocument) -> None:
    document["parameter"][0]["value"] = "heavy"  # type: ignore[index]


def prior(*numbers: float) -> object:
    def apply(document: tomlkit.TOMLDocument) -> None:
        next(p for p in document["parameter"] if p["name"] == "m_u")["prior"] = list(numbers)  # type: ignore[union-attr]

    return apply


def value_beyond_bounds(document: tomlkit.TOMLDocument) -> None:
    row = next(p for p in document["parameter"] if p["name"] == "d_uu")  # type: ignore[union-attr]
    row["value"] = -3.0


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (change(format="seatrial-rig 1"), "format is 'seatrial-rig 1', not 'seatrial-model 1'"),
        (change(source=None), "fit it again: it has no entry 'source'"),
        (change(source="submarine"), "no model 'submarine'"),
        (change(source="nowhere.py:boat"), "nowhere.py: no such"),
        (change(effects=["perpetual-motion"]), "there is no effect 'perpetual-motion' in the catalogue"),
        (change(parameter=None), "parameter"),
        (change(validity={"u": [1.0]}), "the model in this file is incomplete"),
        (change(parameter=5), "the model in this file is incomplete"),
        (change(validity=[1.0]), "fit it again: one of its entries has a wrong type"),
        (change(correlation=[1.0]), "the model in this file is incomplete"),
        (change(scale="newtons"), "the model in this file is incomplete"),
        (change(scale={"calibration": "small"}), "the model in this file is incomplete"),
        (change(provenance=5), "the model in this file is incomplete"),
        (rename_parameter, "has no parameter 'm_x'"),
        (word_for_value, "the model in this file is incomplete"),
        (value_beyond_bounds, "d_uu: -3.0 is outside its bounds"),
        (prior(30.0), "the model in this file is incomplete"),
        (prior(30.0, 0.0), "m_u: its prior [30, 0] needs a positive mean and standard deviation"),
        (prior(-30.0, 2.0), "m_u: its prior [-30, 2] needs"),
    ],
)
def test_damaged_file_gives_a_one_line_error(tmp_path: Path, found: Fit, damage: object, message: str) -> None:
    path = saved(tmp_path / "model.toml", found)
    document = tomlkit.parse(path.read_text(encoding="utf-8"))
    damage(document)  # type: ignore[operator]
    path.write_text(tomlkit.dumps(document), encoding="utf-8")
    with pytest.raises(SeatrialError) as problem:
        load_model(path)
    assert message in str(problem.value)
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize("rate", ["0.0", "-1", "nan", "inf", "[1]"])
def test_sensor_rate_must_be_a_positive_number(tmp_path: Path, found: Fit, rate: str) -> None:
    path = saved(tmp_path / "model.toml", found, rates={"gyro": 10.0})
    path.write_text(path.read_text(encoding="utf-8").replace("gyro = 10.0", f"gyro = {rate}"), encoding="utf-8")
    with pytest.raises(
        SeatrialError,
        match=r"model\.toml: the model in this file is incomplete or does not match this version of",
    ):
        load_model(path)


@pytest.mark.parametrize("content", [b"format = ", b"\xff\xfe\x00", b"", b"[[parameter]]\n" * 3])
def test_file_that_is_not_toml_gives_a_one_line_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "model.toml"
    path.write_bytes(content)
    with pytest.raises(SeatrialError, match=r"model\.toml: ") as problem:
        load_model(path)
    assert "\n" not in str(problem.value)
    with pytest.raises(SeatrialError, match=r"absent\.toml: cannot be read: No such file"):
        load_model(tmp_path / "absent.toml")


def test_truncated_file_gives_a_one_line_error_or_a_complete_model(tmp_path: Path, found: Fit) -> None:
    path = saved(tmp_path / "model.toml", found)
    text = path.read_text(encoding="utf-8")
    rng = np.random.default_rng(1)
    for cut in rng.integers(0, len(text), 60):
        path.write_text(text[:cut], encoding="utf-8")
        with contextlib.suppress(SeatrialError):  # No other error is allowed.
            assert isinstance(load_model(path).model, Model)


@pytest.mark.parametrize("text", ["a = {" * 9000, "a = " + "[" * 50_000, "a = " + "9" * 20_000])
def test_file_that_is_nested_too_deeply_or_too_long_gives_a_one_line_error(tmp_path: Path, text: str) -> None:
    (tmp_path / "model.toml").write_text(text, encoding="utf-8")
    with pytest.raises(SeatrialError, match="nested too deeply") as refused:
        load_model(tmp_path / "model.toml")
    assert "\n" not in str(refused.value)
    assert load_curve(tmp_path / "model.toml") is None


def test_folder_and_result_file_stand_for_the_model_in_them(tmp_path: Path) -> None:
    model = tmp_path / "model.toml"
    model.write_text("")
    (tmp_path / "result.json").write_text("{}")
    assert model_file(tmp_path) == model
    assert model_file(model) == model
    assert model_file(tmp_path / "other.json") == tmp_path / "other.json"
    with pytest.warns(SeatrialWarning, match=r"result\.json: this is a result file; its model .*model\.toml is used"):
        assert model_file(tmp_path / "result.json") == model
    assert ModelSource().convert(f"{tmp_path}/", None, None) == str(model)
    assert ModelSource().convert("horizontal", None, None) == "horizontal"
    assert ModelSource().convert("own.py:boat", None, None) == "own.py:boat"
    (tmp_path / "empty").mkdir()
    with pytest.raises(SeatrialError, match=r"empty: this folder has no model\.toml; give the folder of a fit"):
        ModelSource().convert(f"{tmp_path}/empty", None, None)


def test_the_structure_of_a_fit_may_be_that_of_the_folder_of_a_fit(tmp_path: Path) -> None:
    (model := tmp_path / "model.toml").write_text("")
    option = next(param for param in vehicle.params if param.name == "model")
    assert option.type_cast_value(click.Context(vehicle), str(tmp_path)) == str(model)
    assert option.type_cast_value(click.Context(vehicle), "auto") == "auto"
    request, _ = vehicle_request((), (), str(tmp_path), None, {})
    assert request.model == str(model)


def test_a_folder_with_the_name_of_a_model_is_not_the_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "surge").mkdir()
    (tmp_path / "surge" / "model.toml").write_text("")
    monkeypatch.chdir(tmp_path)
    assert ModelSource().convert("surge", None, None) == "surge"
    assert ModelSource().convert("./surge", None, None) == "surge/model.toml"


def test_folder_and_result_file_without_model_are_rejected(tmp_path: Path) -> None:
    """Each error is one line and names the file to give."""
    (tmp_path / "vehicle").mkdir()
    with pytest.raises(SeatrialError, match=r"vehicle: this folder has no model\.toml; give the folder of a fit"):
        load_model(tmp_path / "vehicle")
    result = tmp_path / "result.json"
    result.write_text('{"kind": "vehicle"}')
    with pytest.raises(
        SeatrialError,
        match=r"result\.json: this is a result file \(JSON\), not a model, and no model\.toml is beside it",
    ):
        load_model(result)


def test_a_report_in_place_of_a_model_is_named(tmp_path: Path) -> None:
    report = tmp_path / "report.html"
    report.write_text("<!doctype html>\n<title>Report</title>", encoding="utf-8")
    with pytest.raises(
        SeatrialError, match=r"report\.html: this is a page \(HTML\), not a model; give the model\.toml"
    ):
        load_model(report)
