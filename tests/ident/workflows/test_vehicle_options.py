"""Tests of --robust, --reml, --second-order and --profile: from the commands to model.toml, result and report."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from rich.console import Console

import seatrial as st
from seatrial.daq.errors import SeatrialError
from seatrial.ident.cli.commands import ident
from seatrial.ident.data.loading import LoadedLog, load_all, load_run
from seatrial.ident.diagnosis import search
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.model_file import load_model
from seatrial.ident.model.outlier_density import robust_sensors
from seatrial.ident.model.structure import Effect
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.report.terminal import print_result
from seatrial.ident.reporter import QUIET
from seatrial.ident.results.commands import ONLY_CHOSEN, untested_notes
from seatrial.ident.workflows import diagnose as workflow
from seatrial.ident.workflows.diagnose import DiagnosisRequest, diagnosis
from seatrial.ident.workflows.fleet import portable, settings_of
from seatrial.ident.workflows.vehicle_model import VehicleRequest, vehicle_problem
from tests.missions import boat_log, boat_with, rig_of

pytestmark = pytest.mark.usefixtures("quick_compilation")


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder, boat = tmp_path_factory.mktemp("logs"), boat_with(None, 5)
    return boat_log(folder / "one.mcap", boat, 90, 1), boat_log(folder / "two.mcap", boat, 80, 2, 2)


THRUST = ("--fix", "c1=40.05", "--fix", "c2=1.11")


@pytest.fixture(scope="module")
def out(logs: tuple[Path, Path]) -> Path:
    folder = logs[0].parent / "vehicle"
    words = ["vehicle", str(logs[0]), "--no-score-tests", *THRUST, "--robust", "--profile", "V_x"]
    CliRunner().invoke(ident, [*words, "--out", str(folder)], catch_exceptions=False)
    return folder


def test_vehicle_command_draws_profiles_and_counts_outliers(out: Path) -> None:
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert [p["name"] for p in result["profiles"]] == ["V_x@0"]
    for row in result["profiles"]:
        (parameter,) = [p for p in result["fit"]["parameters"] if p["name"] == row["name"].partition("@")[0]]
        assert row["low"] < parameter["value"] < row["high"]
        # The profile uses the maximum likelihood, without the restricted noise.
        assert abs(row["value"] - parameter["value"]) < 0.1 * parameter["se"]
        assert not any("better fit" in note for note in row["notes"])
        assert row["low"] == pytest.approx(row["wald_low"], abs=parameter["se"])
        assert len(row["grid"]) == len(row["drop"]) >= 7
    counts = [line for line in result["notes"] if "treated as outliers" in line]
    assert {line.partition(":")[0] for line in counts} == {"psi", "r", "ax", "ay", "x", "y", "vx", "vy"}
    page = (out / "report.html").read_text(encoding="utf-8")
    assert '<section id="profiles"' in page
    assert "samples were treated as outliers" in page


@pytest.mark.study
def test_robust_model_stays_robust(out: Path, logs: tuple[Path, Path]) -> None:
    table = tomllib.loads((out / "model.toml").read_text(encoding="utf-8"))
    assert table["robust"] == table["sensors"]
    saved = load_model(out / "model.toml")
    assert robust_sensors(saved.model) == tuple(table["sensors"])
    request = DiagnosisRequest(out / "model.toml", logs[:1], logs[1:], out / "diagnosis", rate=10.0, max_effects=1)
    again = diagnosis(request, "test", QUIET)
    assert any("treated as outliers" in line for line in again.notes)
    assert tomllib.loads((out / "diagnosis/model.toml").read_text(encoding="utf-8"))["robust"] == table["robust"]


def test_unknown_robust_sensor_in_the_file_is_rejected(out: Path, tmp_path: Path) -> None:
    text = (out / "model.toml").read_text(encoding="utf-8")
    (tmp_path / "model.toml").write_text(text.replace('robust = ["', 'robust = ["sonar", "'), encoding="utf-8")
    with pytest.raises(SeatrialError, match="has no sensor 'sonar'"):
        load_model(tmp_path / "model.toml")


@pytest.mark.parametrize(
    ("name", "message"),
    [("mass", "--profile mass: model horizontal has"), ("c1", "--profile c1: the parameter is fixed, not estimated")],
)
def test_impossible_profile_is_rejected_before_the_fit(name: str, message: str, logs: tuple[Path, Path]) -> None:
    done = CliRunner().invoke(ident, ["vehicle", str(logs[0]), "--no-score-tests", "--fix", "c1=40", "--profile", name])
    assert isinstance(done.exception, SeatrialError)
    assert message in str(done.exception)
    assert "fitting" not in done.output


@pytest.mark.study
def test_restricted_noise_keeps_the_dynamics_and_increases_their_errors(logs: tuple[Path, Path]) -> None:
    """A dozen parameters of the dynamics take degrees of freedom from the disturbances."""
    fits = []
    for name, more in (("plain", ["--no-reml"]), ("reml", [])):
        folder = logs[0].parent / name
        words = ["vehicle", str(logs[0]), "--no-score-tests", *THRUST, *more, "--out", str(folder)]
        CliRunner().invoke(ident, words, catch_exceptions=False)
        fitted = json.loads((folder / "result.json").read_text(encoding="utf-8"))["fit"]
        restricted = name == "reml"
        assert fitted["restricted"] is load_model(folder / "model.toml").reml is restricted
        fits.append(fitted["parameters"])
    plain, reml = ({p["name"]: (p["value"], p["se"]) for p in parameters} for parameters in fits)
    for name in ("m_u", "m_v", "m_r", "d_v", "d_r"):
        (value, error), (restricted_value, larger) = plain[name], reml[name]
        assert restricted_value == pytest.approx(value, abs=0.5 * error)
        assert 1.005 < larger / error < 1.1


@pytest.mark.study
def test_second_order_mean_is_saved_with_the_model_and_not_used_in_a_diagnosis(logs: tuple[Path, Path]) -> None:
    folder = logs[0].parent / "bent"
    CliRunner().invoke(
        ident, ["vehicle", str(logs[0]), "--no-score-tests", "--out", str(folder)], catch_exceptions=False
    )
    assert load_model(folder / "model.toml").model.second_order
    assert json.loads((folder / "result.json").read_text(encoding="utf-8"))["fit"]["second_order"]
    diagnosed = folder / "diagnosis"
    request = DiagnosisRequest(folder / "model.toml", logs[:1], logs[1:], diagnosed, rate=10.0, max_effects=1)
    diagnosis(request, "test", QUIET)
    assert not load_model(folder / "diagnosis/model.toml").model.second_order


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")  # signals that the model does not use
@pytest.mark.parametrize("saved", [False, True])
def test_effects_have_the_position_of_the_thrusters_of_the_log(saved: bool, logs: tuple[Path, Path], out: Path) -> None:
    """They have it in a model of the catalogue and in a model.toml, whose log did not give it."""
    model = str(out / "model.toml") if saved else "horizontal:shaft"
    request = VehicleRequest(logs[:1], [], out, model=model, effects=("thrust-angle", "propeller-walk"))
    log = replace(load_run(logs[0], "one"), vehicle={"x_thrusters": -0.9, "x_thrusters_sd": 0.03})
    found = vehicle_problem(request, [log], []).model
    assert [found.parameter(n).prior for n in ("x_delta", "x_walk")] == [(-0.9, 0.03)] * 2
    assert found.parameter("x_delta").meaning.endswith(" (prior: x_thrusters)")
    of_rig = vehicle_problem(request, [replace(load_run(logs[0], "one"), rig=rig_of("boat"), vehicle={})], []).model
    assert of_rig.parameter("x_delta").meaning.endswith(" (prior: position_m of the thrusters in the rig file)")


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")  # signals that the model does not use
def test_a_search_has_the_position_of_the_thrusters_of_the_log(
    logs: tuple[Path, Path], out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """model.toml has no prior of an effect that it lacks: the command and `st.diagnose` take it from the log."""

    class Stopped(Exception):
        pass

    found: list[Effect] = []

    def stop(_records: Any, _data: Any, candidates: dict[str, Effect], *_: Any) -> None:
        found.append(candidates["thrust-angle"])
        raise Stopped

    def load_with_position(*arguments: Any) -> tuple[list[LoadedLog], list[LoadedLog]]:
        loaded, others = load_all(*arguments)
        return [replace(log, vehicle={"x_thrusters": -0.9, "x_thrusters_sd": 0.03}) for log in loaded], others

    monkeypatch.setattr(workflow, "load_all", load_with_position)
    monkeypatch.setattr(search, "_Search", stop)
    words = ["diagnose", str(out / "model.toml"), str(logs[0]), "--out", str(logs[0].parent / "searched")]
    with pytest.raises(Stopped):
        CliRunner().invoke(ident, words, catch_exceptions=False)
    with pytest.raises(Stopped):
        st.diagnose(out / "model.toml", logs[0])
    for effect in found:
        (position,) = (p for p in effect.parameters if p.name == "x_delta")
        assert (position.prior, effect.scan["x_delta"]) == ((-0.9, 0.03), (-0.9,))
        assert position.meaning.endswith(" (prior: x_thrusters)")
    assert len(found) == 2


@pytest.mark.parametrize(
    ("name", "advice"),
    [
        (
            "x_delta=-0.45",
            "give x_thrusters and x_thrusters_sd in [geometry] of the import map, or in [vehicle] of the",
        ),
        ("delta_L=0.02", "fit it with `seatrial ident vehicle --effect thrust-angle --fix delta_L=0.02`, and diagnose"),
    ],
)
def test_a_parameter_of_a_missing_effect_cannot_be_held_in_a_search(
    name: str, advice: str, logs: tuple[Path, Path], out: Path
) -> None:
    done = CliRunner().invoke(ident, ["diagnose", str(out / "model.toml"), str(logs[0]), "--fix", name])
    assert isinstance(done.exception, SeatrialError)
    assert advice in str(done.exception)
    assert "--no-score-tests" not in str(done.exception)


@pytest.mark.study
def test_second_order_mean_of_a_user_model_can_be_switched_off(logs: tuple[Path, Path], tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(
        "from dataclasses import replace\nfrom seatrial.ident.models.horizontal import horizontal_model\n\n\n"
        "def bent():\n    return replace(horizontal_model(), second_order=True)\n",
        encoding="utf-8",
    )
    model, out = f"{tmp_path / 'own.py'}:bent", str(tmp_path / "out")
    words = ["vehicle", str(logs[0]), "--no-score-tests", "--model", model, "--out", out, "--force"]
    for more, there in ([], True), (["--no-second-order"], False):
        CliRunner().invoke(ident, [*words, *more], catch_exceptions=False)
        assert ("second_order = true" in (tmp_path / "out/model.toml").read_text(encoding="utf-8")) is there


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")  # signals that the model does not use
def test_chosen_effects_without_score_tests_name_the_errors_that_they_lack(logs: tuple[Path, Path]) -> None:
    """The score tests select the small errors of sensors and hull form. A model of a tested fit has them already."""
    how: dict[str, Any] = {"fixed": {"c1": 40.05, "c2": 1.11}, "score_tests": False, "reml": False, "mean_order": 1}
    chosen = st.fit(logs[0], effects=["cubic-drag"], **how)
    (note,) = (n for n in chosen.notes if n.startswith(ONLY_CHOSEN))
    assert note.endswith("add the effects to the model of a tested fit: model='FIT/model.toml'.")
    console = Console(record=True, width=2000)
    print_result(chosen.result, console)
    shown = console.export_text()
    assert ONLY_CHOSEN in shown
    assert "by score tests: the standard errors assume a complete model. Small errors of sensors and hull" in shown
    assert "such as a difference between the thrusters, are in the standard errors. Take the estimates as" in shown
    tested = st.fit(logs[0], effects=["gnss-latency", "heading-lag"], **how)  # as if the tests had selected them
    assert any(n.startswith(ONLY_CHOSEN) for n in tested.notes)
    file = tested.save(logs[0].parent / "tested") / "model.toml"
    both = st.fit(logs[0], model=str(file), effects=["cubic-drag"], score_tests=False)
    assert {"gnss-latency", "heading-lag", "cubic-drag"} <= {e.name for e in both.fitted.fit.model.effects}
    assert not any(n.startswith(ONLY_CHOSEN) for n in both.notes)
    assert any(n.endswith("errors of sensors and hull form: gnss-latency, heading-lag.") for n in both.notes)


def test_the_note_on_a_model_of_ones_own_says_how_to_add_common_errors() -> None:
    """The note said that --no-score-tests skips them, an option that was not given."""
    own = replace(horizontal_model("shaft"), source="own.py:boat")
    (bare,) = untested_notes(own, ())
    assert "by score tests, because it is a model of your own: the standard errors" in bare
    assert "hull form are not estimated; --effect adds one: " in bare
    assert "gnss-latency" in bare
    (some,) = untested_notes(own + catalogue()["gnss-latency"], ("tau_gnss",))
    assert "Small errors of sensors and hull form in it: gnss-latency; --effect adds others: " in some
    assert "--no-score-tests" not in bare + some
    (built_in,) = untested_notes(horizontal_model("shaft"), ())
    assert "--no-score-tests skips them" in built_in


def test_the_file_of_user_effects_is_a_setting_of_a_fleet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.py").write_text("EFFECT = 1", encoding="utf-8")
    request = portable(VehicleRequest((), (), Path(), effects_file=Path("own.py")))
    assert request.effects_file == tmp_path / "own.py"
    before = settings_of(request)["effects_file"]
    Path("own.py").write_text("EFFECT = 2", encoding="utf-8")
    assert settings_of(request)["effects_file"] != before
