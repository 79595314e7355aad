"""Tests of fits to many logs: backends give the same numbers, and nothing is lost by a failure or an interrupt."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pyarrow.parquet
import pytest

import seatrial as st
from seatrial import command_line
from seatrial.api.messages import in_python, text_of
from seatrial.daq.errors import SeatrialError
from seatrial.ident.diagnosis import assess_model
from seatrial.ident.diagnosis.findings import ModelUncertainty
from seatrial.ident.diagnosis.model_uncertainty import with_model_uncertainty
from seatrial.ident.estimation.maximum_likelihood import EstimationOptions
from seatrial.ident.numerics import Array
from seatrial.ident.parallel import Workers
from seatrial.ident.reporter import QUIET
from seatrial.ident.results import FleetResult
from seatrial.ident.results.result_file import read_result
from seatrial.ident.results.tables import fit_summary
from seatrial.ident.workflows import fleet
from seatrial.ident.workflows.fleet import SIDES, FleetRequest, _prior_parts, fit_fleet, fleet_result
from seatrial.ident.workflows.vehicle import VehicleFit, fit_vehicle
from seatrial.ident.workflows.vehicle_model import VehicleRequest
from tests.ident.reports import Kept
from tests.missions import boat_log, boat_with

ROOT = Path(__file__).resolve().parents[3]
QUICK = ("--prior", "c1=40:2", "--fix", "c2=1.1", "--no-score-tests")
VEHICLE = VehicleRequest(
    (),
    (),
    Path(),
    EstimationOptions(reml=True, mean_order=2),
    fixed={"c2": 1.1},
    priors={"c1": (40.0, 2.0)},
    score_tests=False,
)
VARIES = ("cpu", "memory", "worker")  # columns that differ from run to run


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder, boat = tmp_path_factory.mktemp("fleet"), boat_with(None, 5)
    return [boat_log(folder / f"run{k}.mcap", boat, 30.0, 100 + k, k) for k in range(1, 5)]


@pytest.fixture(scope="module")
def alone(logs: list[Path]) -> fleet.FleetFits:
    """Fit the model to each log in this process."""
    return fit_fleet(FleetRequest(logs, VEHICLE, None, Workers(1)), "", Kept())


def run(*words: object, status: int = 0) -> None:
    with pytest.raises(SystemExit) as left:
        command_line.main([str(w) for w in words])
    assert (left.value.code or 0) == status


def same(table: Any) -> Any:
    return table.drop_columns(list(VARIES))


def test_two_processes_give_the_numbers_of_one(logs: list[Path], alone: fleet.FleetFits) -> None:
    two = fit_fleet(FleetRequest(logs, VEHICLE, None, Workers(2, "loky")), "", Kept())
    assert same(two.table).equals(same(alone.table))
    assert two.result.parameters == alone.result.parameters
    assert alone.result.fitted == 4


def test_a_folder_stands_for_its_logs(logs: list[Path], alone: fleet.FleetFits, tmp_path: Path) -> None:
    folder = fit_fleet(FleetRequest([logs[0].parent], VEHICLE, None, Workers(1)), "", Kept())
    assert same(folder.table).equals(same(alone.table))
    (failed,) = fit_fleet(FleetRequest([tmp_path], VEHICLE, None, Workers(1)), "", Kept()).result.failed
    assert "is a folder without a log (*.mcap) in it" in failed.reason


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")
def test_rows_equal_the_result_of_a_single_fit(logs: list[Path]) -> None:
    single = st.fit(logs[1], score_tests=False, fixed={"c2": 1.1}, priors={"c1": (40.0, 2.0)})
    many = st.fit_many(logs[1:3], score_tests=False, fixed={"c2": 1.1}, priors={"c1": (40.0, 2.0)}, jobs=1)
    row = many.values().loc[str(logs[1])]
    assert f"<td>{many.result.parameters[0].mean:.4g}</td>" in many._repr_html_()
    assert dict(row) == {n: v for n, v in single.params.items() if n in row.index}
    assert set(single.params) == set(row.index)
    errors = many.values("se").loc[str(logs[1])].dropna()
    assert dict(errors) == {n: v for n, v in single.standard_errors.items() if v > 0.0}
    assert repr(many).startswith("<FittedFleet: 2 logs>\nThe model was fitted to 2 of 2 logs.")
    assert "m_u" in many.summary()
    with pytest.raises(SeatrialError, match="there is no column 'values'; choose one of log, sha256"):
        many.values("values")
    with pytest.raises(SeatrialError, match="profiles: the table of many logs has no profile"):
        st.fit_many(logs, profiles=["m_u"])
    with pytest.raises(SeatrialError, match="the logs have different windows"):
        st.fit_many([st.open_log(logs[0], start=5.0), logs[1]])


def test_warnings_of_the_fits_are_python_warnings_once_for_each_kind(logs: list[Path]) -> None:
    with pytest.warns(st.SeatrialWarning) as caught:
        many = st.fit_many(logs[:3], score_tests=False, fixed={"c2": 1.1}, priors={"c1": (40.0, 2.0)}, jobs=1)
    texts = [str(w.message) for w in caught if issubclass(w.category, st.SeatrialWarning)]
    (short,) = [w for w in many.result.warnings if w.code == "short-data"]
    assert short.text.startswith(f"{logs[0]}: ")
    assert short.text.endswith(f" The same, with other numbers, holds for {logs[1]}, {logs[2]}.")
    assert texts.count(short.text) == 1
    assert len(texts) == len(many.result.warnings)
    assert "holds for" in " ".join(many.summary().split())


def test_warnings_of_different_kinds_stay_apart() -> None:
    def rows(log: str, *found: tuple[str, str]) -> Any:
        return {"log": log, "warning_texts": json.dumps(found)}

    found = fleet.warnings_of_logs([
        rows("a/1.mcap", ("log-check", "1.mcap: r: gap of 2.5 s"), ("short-data", "30 s are short.")),
        rows("a/1.mcap", ("log-check", "1.mcap: r: gap of 2.5 s"), ("short-data", "30 s are short.")),
        rows("2.mcap", ("log-check", "2.mcap: r: gap of 7 s"), ("log-check", "2.mcap: psi: a filter")),
        {"log": "3.mcap", "warning_texts": None},  # its fit has failed
    ])  # fmt: skip
    assert [(w.code, w.text) for w in found] == [
        ("log-check", "1.mcap: r: gap of 2.5 s. The same, with other numbers, holds for 2.mcap."),
        ("short-data", "a/1.mcap: 30 s are short."),
        ("log-check", "2.mcap: psi: a filter."),
    ]


def test_failed_log_is_a_row_with_its_reason(
    logs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken, copy = tmp_path / "broken.mcap", tmp_path / "copy.mcap"
    broken.write_bytes(b"no log")
    shutil.copy(logs[0], copy)
    missing, empty = tmp_path / "missing.mcap", tmp_path / "empty"
    empty.mkdir()
    words = ("--jobs", "2", *QUICK, "--out", tmp_path / "fleet")
    run("ident", "fleet", logs[0], broken, missing, empty, copy, logs[1], *words, status=1)
    shown = capsys.readouterr()
    assert "copy.mcap: is a copy of" in shown.err
    assert "fitted to 2 of 5 logs, 3 failed." in shown.out
    assert shown.err.rstrip().endswith("3 of 5 logs have no fit")
    heads = [line.split() for line in shown.out.splitlines()]
    assert ["log", "reason"] in heads
    assert ["parameter", "logs"] in [line[:2] for line in heads]
    rows = [r for r in pyarrow.parquet.read_table(tmp_path / "fleet/fits.parquet").to_pylist() if r["error"]]
    assert {(r["log"], r["parameter"]) for r in rows} == {(str(x), None) for x in (broken, missing, empty)}
    assert not any("\n" in r["error"] for r in rows)
    reasons = {r["log"]: r["error"] for r in rows}
    assert reasons[str(missing)] == "cannot be read: No such file or directory; check its path and permissions"
    result = read_result(tmp_path / "fleet/result.json")
    assert isinstance(result, FleetResult)
    assert {f.log: f.reason for f in result.failed} == reasons
    assert st.fit_many([missing], jobs=1).failed == {str(missing): reasons[str(missing)]}
    run("ident", "fleet", broken, *QUICK, "--out", tmp_path / "none", status=1)


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")
def test_saved_fleet_is_loaded_with_its_table(logs: list[Path], tmp_path: Path) -> None:
    many = st.fit_many(logs[:2], score_tests=False, fixed={"c2": 1.1}, priors={"c1": (40.0, 2.0)}, jobs=1, out=tmp_path)
    saved = st.load(tmp_path)
    assert saved.to_pandas().equals(many.to_pandas())
    assert saved.summary() == many.summary()
    assert saved._repr_html_() == many._repr_html_()
    (tmp_path / "fits.parquet").write_bytes(b"no table")
    with pytest.raises(SeatrialError, match=r"fits\.parquet: cannot be read \("):
        saved.to_pandas()
    (tmp_path / "fits.parquet").unlink()
    with pytest.raises(SeatrialError, match=r"fits\.parquet: is missing"):
        saved.to_pandas()


def test_second_run_fits_only_the_rest(logs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fitted: list[str] = []
    fit_vehicle = fleet.fit_vehicle

    def count(request: VehicleRequest, *rest: Any, **options: Any) -> Any:
        fitted.append(Path(request.logs[0]).name)
        if "run2" in fitted[-1] and not repaired:
            raise SeatrialError("no disk")
        return fit_vehicle(request, *rest, **options)

    monkeypatch.setattr(fleet, "fit_vehicle", count)
    repaired = False
    first = fit_fleet(FleetRequest(logs[:2], VEHICLE, tmp_path, Workers(1)), "", Kept())
    assert [f.reason for f in first.result.failed] == ["no disk"]
    repaired, reporter = True, Kept()
    second = fit_fleet(FleetRequest(logs, VEHICLE, tmp_path, Workers(1)), "", reporter)
    assert fitted == ["run1.mcap", "run2.mcap", "run2.mcap", "run3.mcap", "run4.mcap"]
    assert "1 of 4 logs have a fit already" in reporter.lines
    assert (second.result.fitted, second.result.failed) == (4, ())
    part = fit_fleet(FleetRequest(logs[2:], VEHICLE, tmp_path, Workers(1)), "", Kept())
    assert len(fitted) == 5
    assert part.result.n_logs == part.result.fitted == 2
    assert set(pyarrow.parquet.read_table(tmp_path / "fits.parquet")["log"].to_pylist()) == {str(x) for x in logs}


def test_fits_with_other_options_are_not_mixed(
    logs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run("ident", "fleet", logs[0], *QUICK, "--jobs", "1", "--out", tmp_path)
    run("ident", "fleet", logs[0], *QUICK, "--jobs", "1", "--rate", "5", "--out", tmp_path, status=1)
    assert "its rows were made with other options (rate); give another --out, or --force" in capsys.readouterr().err
    run("ident", "fleet", logs[0], *QUICK, "--jobs", "1", "--rate", "5", "--force", "--out", tmp_path, "--json")
    shown = capsys.readouterr()
    printed = json.loads(shown.out)
    assert (printed["kind"], printed["n_logs"], printed["fitted"]) == ("fleet", 1, 1)
    assert f"table: {tmp_path / 'fits.parquet'}" in shown.err


def started(logs: list[Path], out: Path) -> subprocess.Popen[str]:
    """Start the command in a process group of its own, and wait for its first fit."""
    words = [sys.executable, "-m", "seatrial", "ident", "fleet", *logs, *QUICK, "--jobs", "2", "--out", out]
    running = subprocess.Popen(
        [str(w) for w in words], cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    assert running.stderr is not None
    while "fitted" not in (line := running.stderr.readline()):
        assert line, "the command ended"
    return running


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder, boat = tmp_path_factory.mktemp("many"), boat_with(None, 5)
    return [boat_log(folder / f"run{k:02}.mcap", boat, 20.0, 200 + k, k) for k in range(6)]


def test_interrupted_run_keeps_its_fits(many: list[Path], tmp_path: Path) -> None:
    running = started(many, tmp_path)
    os.killpg(running.pid, signal.SIGINT)
    _, err = running.communicate(timeout=60)
    assert running.returncode == 130
    assert err.strip().splitlines()[-1] == "seatrial: interrupted"
    assert "Traceback" not in err
    done = set(pyarrow.parquet.read_table(tmp_path / "fits.parquet")["log"].to_pylist())
    assert 1 <= len(done) < len(many)
    reporter = Kept()
    found = fit_fleet(FleetRequest(many, VEHICLE, tmp_path, Workers(1)), "", reporter)
    assert f"{len(done)} of {len(many)} logs have a fit already" in reporter.lines
    assert found.result.fitted == len(many)


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="processes are found in /proc")
def test_fit_of_a_killed_process_is_done_again(many: list[Path], tmp_path: Path) -> None:
    running = started(many, tmp_path)
    children = Path(f"/proc/{running.pid}/task/{running.pid}/children")
    tasks = list(Path(f"/proc/{running.pid}/task").iterdir())
    pids = {int(p) for task in tasks for p in (task / "children").read_text().split()}
    workers = [p for p in pids if b"popen_loky" in Path(f"/proc/{p}/cmdline").read_bytes()]
    assert len(workers) == 2, children
    os.kill(workers[0], signal.SIGKILL)
    _, err = running.communicate(timeout=120)
    assert running.returncode == 0
    assert "a process of the tasks died" in err
    result = read_result(tmp_path / "result.json")
    assert isinstance(result, FleetResult)
    assert (result.fitted, result.failed) == (len(many), ())


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")
def test_part_of_a_prior_is_the_change_by_its_mean(logs: list[Path]) -> None:
    """The prior's mean is moved by a quarter of its standard deviation."""

    def fitted(mean: float) -> Any:
        thrust = {"fixed": {"c2": 1.1}, "priors": {"c1": (mean, 2.0)}}
        return st.fit_many(logs[:1], score_tests=False, reml=False, mean_order=1, jobs=1, **thrust)

    below, above = fitted(39.75), fitted(40.25)
    moved = (above.values() - below.values()).iloc[0]
    parts = below.values("prior_parts").iloc[0].map(json.loads)
    for name in ("m_u", "m_v", "m_r", "c1", "d_uu"):
        assert parts[name]["c1"] * 0.25 == pytest.approx(moved[name], rel=0.1), name
    assert below.values("se").iloc[0]["m_u"] > abs(parts["m_u"]["c1"])


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")
def test_a_fit_starts_at_the_estimates_of_its_score_tests(logs: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """Both fit the same model. The fit differs only by the second order of the mean and by REML."""
    tested = list[Any]()

    def assessed(*arguments: Any, **options: Any) -> Any:
        tested.append(assess_model(*arguments, **options))
        return tested[-1]

    monkeypatch.setattr("seatrial.ident.workflows.vehicle.assess_model", assessed)
    request = VehicleRequest([logs[0]], [], Path(), fixed={"c1": 40.0, "c2": 1.1})
    fit = fit_vehicle(request, "", QUIET, with_dynamics=False).fitted.fit
    assert tested[0].common_errors is None
    assert fit.converged
    assert fit.iterations < tested[0].nominal.fit.iterations / 2
    assert fit.log_posterior == pytest.approx(tested[0].nominal.fit.log_posterior, abs=5.0)


@pytest.mark.parametrize("matters", [False, True])
@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")
def test_a_small_loss_of_thrust_at_full_command_is_a_note(
    logs: list[Path], monkeypatch: pytest.MonkeyPatch, matters: bool
) -> None:
    scale = SimpleNamespace(text="The thrust at full command is smaller.", matters=matters)
    monkeypatch.setattr("seatrial.ident.workflows.vehicle._command_scale", lambda model, loaded: scale)
    request = VehicleRequest([logs[0]], [], Path(), fixed={"c1": 40.0, "c2": 1.1}, score_tests=False)
    result = fit_vehicle(request, "", QUIET, with_dynamics=False).result
    assert (scale.text in result.notes) is not matters
    assert (("command-scale", scale.text) in [(w.code, w.text) for w in result.warnings]) is matters


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")
def test_a_standard_error_beyond_the_prior_is_no_part_of_the_prior(logs: list[Path]) -> None:
    """The error of c1 may include that the sides differ: 15 N beside a prior of 2 N, with masses in proportion."""
    request = VehicleRequest([logs[0]], [], Path(), fixed={"c2": 1.1}, priors={"c1": (40.0, 2.0)}, score_tests=False)
    plain = fit_vehicle(request, "", QUIET, with_dynamics=False)
    names = plain.fitted.fit.names
    shift = np.array(
        [0.35 * v if n in ("c1", "m_u", "m_v") else 0.0 for n, v in zip(names, plain.fitted.fit.values, strict=True)]
    )
    n = len(names)
    wide = ModelUncertainty(tuple(names), (), np.zeros((0, n)), np.zeros((n, n)), 0.35, shift)
    fitted = replace(plain.fitted, fit=with_model_uncertainty(plain.fitted.fit, wide))
    summary = fit_summary(fitted.fit, {})
    widened = VehicleFit(fitted, msgspec.structs.replace(plain.result, fit=summary), wide)
    before, after = _prior_parts(plain), _prior_parts(widened)
    assert after["c1"]["c1"] == pytest.approx(before["c1"]["c1"], rel=0.05)
    assert after["m_u"]["c1"] == pytest.approx(before["m_u"]["c1"], rel=0.1)
    assert after["m_u"][SIDES] == pytest.approx(shift[names.index("m_u")])
    assert SIDES not in before["m_u"]


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")
def test_the_page_runs_as_written(
    logs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (ROOT / "docs/how-to/many-logs.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    assert len(blocks) == 2
    (tmp_path / "logs").mkdir()
    for log in logs[:2]:
        shutil.copy(log, tmp_path / "logs")
    monkeypatch.chdir(tmp_path)
    space: dict[str, Any] = {"__name__": "page"}
    for block in blocks:
        exec(compile(block, "many-logs.md", "exec"), space)
    assert space["masses"].shape == space["errors"].shape == (2, 2)
    assert "fitted to 2 of 2 logs" in capsys.readouterr().out
    listed = set(re.findall(r"`(\w+)`", "".join(re.findall(r"^\| (`.*?) \|", page, re.MULTILINE))))
    assert set(fleet.COLUMNS) <= listed


def made(values: Array, own: float, common: float = 0.0, **more: Any) -> Any:
    """Return the table of one parameter with these values, whose error has an own part and one of a common prior."""
    rows = [
        {"log": f"run{k}", "sha256": str(k), "parameter": "m_u", "value": float(v), "se": float(np.hypot(own, common)),
         "unit": "kg", "meaning": "mass", "free": True, "per_log": False, "converged": True,
         "prior_parts": json.dumps({"c1": common} if common else {})} | more
        for k, v in enumerate(values)
    ]  # fmt: skip
    schema = pyarrow.schema(
        [(n, {str: pyarrow.string(), float: pyarrow.float64(), int: pyarrow.int64(), bool: pyarrow.bool_()}[t])
         for n, t in fleet.COLUMNS.items()]
    )  # fmt: skip
    return pyarrow.Table.from_pylist(rows, schema=schema)


def test_differences_between_logs_are_found_beside_a_common_prior() -> None:
    rng = np.random.default_rng(3)
    noise, differences = rng.normal(0.0, 0.1, 40), rng.normal(0.0, 0.5, 40)
    equal, differing = (
        fleet_result(made(30.0 + x, 0.1, 2.0), 40, VEHICLE, "", "") for x in (noise, noise + differences)
    )
    (a,), (b,) = equal.parameters, differing.parameters
    assert a.agree
    assert a.scatter < 0.1
    assert a.se_own == pytest.approx(0.1, rel=1e-6)
    assert a.se_mean == pytest.approx(2.0, rel=0.01)  # the error of the prior does not become smaller in the mean
    assert not b.agree
    assert b.scatter == pytest.approx(0.5, rel=0.35)
    assert "differ by more than the standard errors in m_u." in differing.answer
    independent = fleet_result(made(30.0 + noise, 0.1), 40, VEHICLE, "", "").parameters[0]
    assert independent.se_mean == pytest.approx(0.1 / np.sqrt(40), rel=0.3)
    current = fleet_result(made(noise + differences, 0.1, per_log=True), 40, VEHICLE, "", "")
    assert "agree in all parameters" in current.answer


def test_false_alarm_rate_of_the_verdict() -> None:
    rng = np.random.default_rng(4)
    tables = [made(30.0 + rng.normal(0.0, 0.1, 6) + 2.0 * rng.normal(), 0.1, 2.0) for _ in range(400)]
    alarms = sum(not fleet_result(t, 6, VEHICLE, "", "").parameters[0].agree for t in tables)
    assert alarms <= 12  # 4 are expected at the level of 0.01


def test_summary_of_a_thousand_logs_is_quick() -> None:
    table = made(30.0 + np.random.default_rng(5).normal(0.0, 0.1, 1000), 0.1, 2.0)
    began = time.process_time()
    assert fleet_result(table, 1000, VEHICLE, "", "").parameters[0].n == 1000
    assert time.process_time() - began < 10.0


def test_result_says_whether_the_fits_had_score_tests() -> None:
    rows = made(np.array([30.0, 31.0]), 0.1).to_pylist()
    schema = made(np.zeros(1), 0.1).schema
    tested = replace(VEHICLE, score_tests=True)
    other = [*rows, rows[1] | {"parameter": "A_psi"}]
    notes = {}
    for name, vehicle, of in (("off", VEHICLE, rows), ("on", tested, rows), ("two", tested, other)):
        result = fleet_result(pyarrow.Table.from_pylist(of, schema=schema), 2, vehicle, "", "")
        assert result.score_tests is (name != "off")
        (notes[name],) = result.notes
        assert in_python(notes[name])[:60] in " ".join(text_of(result).split())
    assert notes["off"].startswith("The fits have no score tests: all logs have the same model")
    assert "All logs have the same model" in notes["on"]
    assert "The logs have 2 different models. --no-score-tests leaves" in notes["two"]
    own = replace(tested, model="boat.py:model")  # has no score tests in any case
    assert fleet_result(pyarrow.Table.from_pylist(rows, schema=schema), 2, own, "", "").score_tests is False


@pytest.mark.parametrize(("command", "default"), [("fleet", "score-tests"), ("changes", "no-score-tests")])
def test_help_gives_the_default_of_the_score_tests_and_its_reason(
    command: str, default: str, capsys: pytest.CaptureFixture[str]
) -> None:
    run("ident", command, "--help")
    shown = " ".join(capsys.readouterr().out.split())
    option = shown[shown.index("--score-tests / --no-score-tests") :]
    option = option[: option.index("--robust")]
    assert option.rstrip().endswith(f"[default: {default}]")
    assert "because" in option
    assert {"fleet": "`ident changes` leaves the tests out", "changes": "`ident fleet` has the tests on"}[
        command
    ] in option


def test_unconverged_fits_are_listed_and_not_compared() -> None:
    table = made(np.array([30.0, 31.0, 99.0]), 0.1)
    rows = table.to_pylist()
    rows[2] |= {"converged": False, "message": "stopped after 200 iterations"}
    result = fleet_result(pyarrow.Table.from_pylist(rows, schema=table.schema), 3, VEHICLE, "", "")
    assert [(u.log, u.reason) for u in result.unconverged] == [("run2", "stopped after 200 iterations")]
    assert result.parameters[0].n == result.fitted == 2
    assert "fitted to 2 of 3 logs, 1 did not converge." in result.answer
