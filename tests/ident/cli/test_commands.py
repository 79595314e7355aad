"""End-to-end tests of the ident commands on logs of simulated devices: files, answers and error messages."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import msgspec
import pytest

from seatrial import command_line
from seatrial.ident.cli.options import SpacedLines, run_workflow
from seatrial.ident.estimation.model_file import load_model
from seatrial.ident.results.parts import VehicleResult
from seatrial.ident.results.result_file import read_result
from seatrial.mocks.hidden_effects.catalogue import make_effect
from seatrial.mocks.plant.bench import draw_bench
from seatrial.mocks.plant.boat import Boat
from tests.missions import bench_log, boat_log, boat_with, sail, write_log

pytestmark = pytest.mark.usefixtures("quick_compilation")

SEED, EFFECT = 2, "cubic-drag"
FILES = ("model.toml", "result.json", "report.html")
Outcome = tuple[int, str, str]
Run = Callable[..., Outcome]


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a bench run, and with an estimation and a validation mission of one boat with a hidden
    effect.
    """
    folder = tmp_path_factory.mktemp("logs")
    bench_log(folder / "bench.mcap", draw_bench(SEED), kind="steps", count=2)
    boat = boat_with(EFFECT, SEED)
    boat_log(folder / "estimation.mcap", boat, 150.0, 101, run=1)
    boat_log(folder / "validation.mcap", boat, 100.0, 102, run=2)
    return folder


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Return a function that runs one command line in this process and gives status, stdout and stderr."""

    def run(*words: object) -> Outcome:
        with pytest.raises(SystemExit) as leaving:
            command_line.main([str(w) for w in words])
        out, err = capsys.readouterr()
        return int(leaving.value.code or 0), out, err

    return run


def result_of(folder: Path) -> dict[str, Any]:
    """Check that all files exist, and return result.json."""
    for name in FILES:
        assert (folder / name).stat().st_size > 500, name
    return dict(json.loads((folder / "result.json").read_text(encoding="utf-8")))


@pytest.fixture(scope="module")
def fitted(logs: Path) -> Path:
    """Return the folder of a thruster fit and a vehicle fit that the commands made."""
    for words in (
        ["thruster", logs / "bench.mcap", "--out", logs / "thruster"],
        [
            "vehicle",
            logs / "estimation.mcap",
            "--thruster",
            logs / "thruster" / "model.toml",
            "--validate",
            logs / "validation.mcap",
            "--out",
            logs / "vehicle",
        ],
    ):
        with pytest.raises(SystemExit) as leaving:
            command_line.main(["ident", *map(str, words)])
        assert not leaving.value.code
    return logs


def test_thruster_command(fitted: Path) -> None:
    result = result_of(fitted / "thruster")
    assert result["kind"] == "thruster"
    assert "N forward" in result["answer"]
    truth = draw_bench(SEED).truth()
    rows = {row["name"]: row for row in result["fit"]["parameters"]}
    for name, true in (("c1", "c1"), ("a", "pole"), ("tau", "delay")):
        assert rows[name]["value"] == pytest.approx(truth[true], rel=0.05), name
    saved = load_model(fitted / "thruster" / "model.toml")
    assert saved.model.name == "thruster"
    assert saved.validity["n_cmd"] == (-0.9, 0.9)
    assert "bench.mcap" in saved.provenance["logs"][0]


def test_static_curve_has_the_steps_of_the_plan(fitted: Path) -> None:
    static = result_of(fitted / "thruster")["static"]
    assert max(static["n"]) > 0.8
    assert min(static["n"]) < -0.8


def test_vehicle_command(fitted: Path) -> None:
    result = result_of(fitted / "vehicle")
    assert result["kind"] == "vehicle"
    assert [(log["path"], log["role"]) for log in result["logs"]] == [
        ("estimation.mcap", "estimation"),
        ("validation.mcap", "validation"),
    ]
    assert result["logs"][0]["mission"] == "mixed, seed 101"
    assert len(result["logs"][0]["sha256"]) == 64
    bench = {r["name"]: r for r in result_of(fitted / "thruster")["fit"]["parameters"]}
    vehicle = {r["name"]: r for r in result["fit"]["parameters"]}
    for name in ("c1", "c2"):  # The values come from the bench, with their errors.
        assert vehicle[name]["value"] == pytest.approx(bench[name]["value"], abs=bench[name]["se"])
        assert vehicle[name]["origin"] == "measured"
        # Another loss of thrust with inflow in reverse, which the model may lack, would change c2 a little.
        most = {"c1": 1.01, "c2": 1.1}[name]
        assert 0.0 < vehicle[name]["se"] < most * bench[name]["se"]
    relative = {n: vehicle[n]["se"] / vehicle[n]["value"] for n in ("c1", "m_u")}
    assert relative["m_u"] > relative["c1"]  # The error of the thrust is part of the error of the mass.
    assert (result["warnings"], result["fit"]["scale"]["thrust"]) == ([], "measured")
    assert vehicle["m_u"]["start"] == 37.0  # The initial value comes from the rig in the log.
    assert vehicle["d_vv"]["start"] == 20.0
    assert set(result["errors"]) == {"estimation", "validation"}
    assert result["errors"]["validation"]["horizon"]["r"]["after"] < 0.1
    assert result["horizon_seconds"] == 10.0
    assert result["answer"].startswith("Prediction 10 s ahead on validation data, all channels: fit ")
    saved = load_model(fitted / "vehicle" / "model.toml")
    low, high = saved.validity["u"]
    assert -1.0 < low < 0.3 < high < 2.0


def test_diagnose_command(fitted: Path, run: Run) -> None:
    status, out, err = run(
        "ident",
        "diagnose",
        fitted / "vehicle" / "model.toml",
        fitted / "estimation.mcap",
        "--validate",
        fitted / "validation.mcap",
        "--out",
        fitted / "diagnosis",
    )
    assert (status, err) == (0, "")
    result = result_of(fitted / "diagnosis")
    assert [e["name"] for e in result["effects"]] == [EFFECT]
    assert "wave-making resistance" in result["answer"]
    assert result["answer"].split()[0] in out
    errors = result["errors"]["validation"]["simulation"]
    assert errors["x"]["after"] < errors["x"]["before"]
    saved = load_model(fitted / "diagnosis" / "model.toml")
    assert EFFECT in [e.name for e in saved.model.effects]
    # The simulator uses another exponent. At 1 m/s both forces are equal.
    assert saved.model.values["d_uuu"] == pytest.approx(make_effect(EFFECT, SEED).parameters["k"], rel=0.5)
    assert str(fitted / "diagnosis" / "report.html") in out.replace("\n", "")


def test_next_diagnosis_starts_from_a_diagnosed_model(fitted: Path, run: Run) -> None:
    model = fitted / "diagnosis" / "model.toml"
    if not model.exists():
        test_diagnose_command(fitted, run)
    status, _, err = run(
        "ident",
        "diagnose",
        model,
        fitted / "estimation.mcap",
        "--validate",
        fitted / "validation.mcap",
        "--out",
        fitted / "again",
    )
    assert (status, err) == (0, "")
    assert EFFECT not in [e["name"] for e in result_of(fitted / "again")["effects"]]


def swapped_sides(path: Path) -> Boat:
    """Write a log with exchanged thruster names."""
    boat = boat_with(None, 3)
    recording, mission = sail(boat, 120.0, 5)
    cross = {1: 2, 2: 1}
    readings = [
        r._replace(sample=replace(r.sample, node=cross[r.sample.node])) if hasattr(r.sample, "node") else r
        for r in recording.readings
    ]
    write_log(path, "boat", readings, mission)
    return boat


def test_diagnosis_rejects_logs_that_a_fit_rejects(fitted: Path, tmp_path: Path, run: Run) -> None:
    swapped_sides(tmp_path / "swapped.mcap")
    status, _, err = run(
        "ident", "diagnose", fitted / "vehicle" / "model.toml", tmp_path / "swapped.mcap", "--out", tmp_path / "refused"
    )
    assert status == 1
    assert "[thruster-sides-swapped]" in err
    assert "--despite-faults" in err
    assert not (tmp_path / "refused").exists()


def test_fit_that_did_not_converge_has_status_1(fitted: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = read_result(fitted / "vehicle" / "result.json")
    assert isinstance(result, VehicleResult)
    run_workflow(lambda reporter: result, fitted / "vehicle", False)
    fit = msgspec.structs.replace(result.fit, converged=False)
    with pytest.raises(click.exceptions.Exit) as leaving:
        run_workflow(lambda reporter: msgspec.structs.replace(result, fit=fit), fitted / "vehicle", False)
    assert leaving.value.exit_code == 1
    assert "report.html" in capsys.readouterr().out


@pytest.mark.study
def test_swapped_thrusters_are_rejected_and_reported_first_if_fitted_anyway(tmp_path: Path, run: Run) -> None:
    boat = swapped_sides(tmp_path / "swapped.mcap")
    fit = ("ident", "vehicle", tmp_path / "swapped.mcap", "--no-score-tests", "--model", "horizontal:shaft:no-current")
    status, _, err = run(*fit, "--out", tmp_path / "refused")
    assert status == 1
    assert "[thruster-sides-swapped]" in err
    assert not (tmp_path / "refused").exists()
    status, _, err = run(*fit, "--fix", "y_left=0.15", "--fix", "y_right=-0.15", "--out", tmp_path / "vehicle")
    assert (status, err) == (0, "")
    values = load_model(tmp_path / "vehicle" / "model.toml").model.values
    assert values["m_r"] == pytest.approx(boat.truth()["m_r"], rel=0.3)
    status, _, err = run(*fit, "--despite-faults", "--fix", "m_u=37", "--out", tmp_path / "despite")
    assert (status, err) == (0, "")
    result = result_of(tmp_path / "despite")
    assert result["answer"].startswith("The logs have faults that can make this result meaningless")
    assert [f["code"] for f in result["logs"][0]["findings"] if f["spoils"]] == ["thruster-sides-swapped"]


def test_results_are_replaced_only_with_force(fitted: Path, tmp_path: Path, run: Run) -> None:
    out, header = tmp_path / "noise", tmp_path / "boat.h"
    assert run("ident", "noise", fitted / "estimation.mcap", "--out", out)[0] == 0
    assert run("ident", "export", fitted / "vehicle" / "model.toml", "--to", "c", "-o", header)[0] == 0
    for words, file in (
        (("noise", fitted / "estimation.mcap", "--out", out), out / "result.json"),
        (("export", fitted / "vehicle" / "model.toml", "--to", "c", "-o", header), header),
    ):
        file.write_text("mine")
        status, _, err = run("ident", *words)
        assert (status, err.count("\n")) == (1, 1)
        assert "--force replaces it" in err
        assert file.read_text() == "mine"
        assert run("ident", *words, "--force")[0] == 0
        assert file.read_text() != "mine"


def test_fixed_and_initial_values_are_used(fitted: Path, tmp_path: Path, run: Run) -> None:
    status, _, err = run(
        "ident",
        "vehicle",
        fitted / "estimation.mcap",
        "--fix",
        "m_u=36.5",
        "--initial",
        "d_v=40",
        "--rate",
        5,
        "--model",
        "horizontal:shaft:no-current",
        "--no-score-tests",
        "--out",
        tmp_path,
    )
    assert (status, err) == (0, "")
    rows = {r["name"]: r for r in result_of(tmp_path)["fit"]["parameters"]}
    assert rows["m_u"]["value"] == 36.5
    assert not rows["m_u"]["free"]
    assert "V_x" not in rows


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            "vehicle {estimation} --validate {estimation}",
            "given for the fit and for the validation, which would prove nothing",
        ),
        ("diagnose {model} {estimation} --validate {estimation}", "given for the fit and for the validation"),
        ("vehicle {bench}", "no inputs for the horizontal model"),
        ("vehicle {estimation} --model submarine", "no model 'submarine'"),
        ("vehicle {estimation} --model nowhere.py:boat", "nowhere.py: no such"),
        ("vehicle {estimation} --fix m_x=3", "--fix m_x: model horizontal has no such parameter; it has m_u"),
        ("vehicle {estimation} --initial m_x=3", "--initial m_x: model horizontal has no such parameter; it has m_u"),
        ("vehicle {estimation} --thruster {rig}", "not 'seatrial-model 1'"),
        (
            "vehicle {estimation} --thruster {model}",
            "is the model horizontal of a boat, not of a thruster; give --thruster the model.toml of",
        ),
        (
            "vehicle {estimation} --from 20.0001 --to 20.0002",
            "there is no sample from 20.0001 s to 20.0002 s; choose a",
        ),
        ("thruster {estimation}", "a shaft speed is needed; the log has left, right; give one of them as --thruster"),
        ("thruster {bench} --thruster port", "no signal 'n_cmd_port'"),
        ("diagnose {rig} {estimation}", "not 'seatrial-model 1': give a model.toml of seatrial"),
        ("diagnose {model} {bench}", "none of the sensors of"),
        ("vehicle {rig}", "rig.toml"),
    ],
)
def test_impossible_request_gives_a_one_line_error(
    fitted: Path, tmp_path: Path, run: Run, words: str, message: str
) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text('format = "seatrial-rig 1"\n', encoding="utf-8")
    places = {
        "estimation": fitted / "estimation.mcap",
        "bench": fitted / "bench.mcap",
        "model": fitted / "vehicle" / "model.toml",
        "rig": rig,
    }
    out = tmp_path / "out"
    status, _, err = run("ident", *(w.format(**places) for w in words.split()), "--out", out)
    assert status == 1
    assert message in err
    assert err.count("\n") == 1
    assert "internal error" not in err
    assert not (out / "model.toml").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        *(
            (words, "bag is a bag of ROS 2; import it first with `seatrial import --guess ")
            for words in (
                "vehicle {bag}",
                "vehicle {log} --validate {bag}",
                "diagnose {folder} {bag}",
                "compare {folder} {folder} --on {bag}",
                "thruster {bag}",
                "noise {bag}",
                "navigate {folder} {bag}",
                "information {folder} {bag}",
                "changes --before {bag} --after {log}",
            )
        ),
        ("vehicle {folder}", "is the folder of a model or a result, not a log; give the path of a log"),
        ("vehicle {empty}", "empty is a folder without a log (*.mcap) in it; give the path of a log"),
        ("diagnose {log} {folder}", "is a log; give a model.toml or the folder of a fit; the model comes first, then"),
        ("navigate {log} {log}", "is a log; give a model.toml or the folder of a fit; the model comes first, then"),
        ("export {log} --to c", "estimation.mcap is a log; give a model.toml or the folder of a fit; `seatrial"),
        (
            "export {folder} --to ros",
            "'ros' is not one of 'python', 'casadi', 'c', 'ros2', 'fmu', 'gazebo', 'vrx'. Did",
        ),
        ("vehicle {log} --from 100 --to 90", "--to 90 s is not after --from 100 s; give a later end"),
    ],
)
def test_wrong_kind_of_file_or_value_says_what_it_is(
    logs: Path, tmp_path: Path, run: Run, words: str, message: str
) -> None:
    bag, folder, empty = (tmp_path / name for name in ("bag", "fit", "empty"))
    for path in (bag, folder, empty):
        path.mkdir()
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 5\n", encoding="utf-8")
    (bag / "bag_0.mcap").touch()
    (folder / "model.toml").write_text('format = "seatrial-model 1"\n', encoding="utf-8")
    places = {"log": logs / "estimation.mcap", "bag": bag, "folder": folder, "empty": empty}
    more = () if words.startswith("export") else ("--out", tmp_path / "out")
    status, _, err = run("ident", *(w.format(**places) for w in words.split()), *more)
    assert status == 2
    assert message in err
    assert err.count("\n") == 1


def test_a_fleet_names_a_bag_among_its_logs(logs: Path, tmp_path: Path, run: Run) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 5\n", encoding="utf-8")
    status, out, _ = run("ident", "fleet", bag, "--jobs", 1, "--out", tmp_path / "out")
    assert status == 1
    assert "is a bag of ROS 2; import it first" in " ".join(out.split())


@pytest.mark.parametrize("words", ["vehicle nowhere.mcap", "vehicle", "diagnose {log}", "vehicle {log} --fix m_u"])
def test_usage_error_has_status_2(logs: Path, run: Run, words: str) -> None:
    status, _, err = run("ident", *(w.format(log=logs / "estimation.mcap") for w in words.split()))
    assert status == 2
    assert err.startswith("seatrial ident ")
    assert err.count("\n") == 1


def test_lines_of_progress_of_one_kind_are_two_seconds_apart(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = 0.0
    monkeypatch.setattr("seatrial.ident.cli.options.time.monotonic", lambda: now)
    lines = SpacedLines()
    for k in range(10):
        now = 0.5 * k
        lines.progress(f"design: {61 * k} simulations, D {-1.5 * k:.2f}")
    lines.progress("design: track")
    lines.warning("no track")
    shown = capsys.readouterr()
    assert shown.out == ""
    assert [line.strip() for line in shown.err.splitlines()] == [
        "design: 0 simulations, D -0.00",
        "design: 244 simulations, D -6.00",
        "design: 488 simulations, D -12.00",
        "design: track",
        "no track",
    ]
