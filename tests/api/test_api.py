"""Tests of the Python interface on short logs of mock boats: its results equal those of the commands."""

from __future__ import annotations

import contextlib
import html
import importlib.util
import inspect
import io
import json
import pydoc
import re
import runpy
import shutil
import subprocess
import sys
import tomllib
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal, is_typeddict

import numpy as np
import pytest
from mcap.writer import Writer
from msgspec import structs
from pandas.testing import assert_frame_equal
from scipy.io import loadmat

import seatrial as st
from seatrial import command_line
from seatrial.api.calls import as_code, python_call
from seatrial.api.fits import model_path
from seatrial.api.messages import text_of, with_texts_in_python
from seatrial.api.plots import prediction_figure
from seatrial.daq.checks import Finding
from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.daq.importers.import_map import parse_import_map
from seatrial.daq.log import bag_of_ros
from seatrial.ident.data.loading import load_run
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.maximum_likelihood import EstimationOptions
from seatrial.ident.estimation.model_file import load_model
from seatrial.ident.experiment_design.problem import DesignLimits
from seatrial.ident.results import read_result
from seatrial.ident.workflows.design import DesignRequest
from seatrial.ident.workflows.diagnose import DiagnosisRequest
from seatrial.ident.workflows.thruster import ThrusterRequest
from seatrial.ident.workflows.vehicle_model import VehicleRequest
from seatrial.mocks.plant.bench import draw_bench
from tests.ident.pages import numbers
from tests.missions import bench_log, boat_log, boat_with
from tests.page_runner import run_python
from tests.test_docs import blocks

pytestmark = pytest.mark.usefixtures("quick_compilation")

ROOT = Path(__file__).resolve().parents[2]
THRUST = {"priors": {"c1": (40.0, 2.0)}, "fixed": {"c2": 1.1}}
LIKELIHOOD: dict[str, Any] = {"score_tests": False, "reml": False, "mean_order": 1, **THRUST}


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder, boat = tmp_path_factory.mktemp("api"), boat_with("mismatch", 5)
    missions = ((100.0, 101), (60.0, 102), (90.0, 103))
    return [boat_log(folder / f"run{k}.mcap", boat, s, m, k) for k, (s, m) in enumerate(missions, 1)]


@contextlib.contextmanager
def without_warnings() -> Iterator[None]:
    """Ignore the warning about signals that the model does not use."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SeatrialWarning)
        yield


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    """Ignore these warnings in the tests. Fixtures of the module are made before."""
    with without_warnings():
        yield


@dataclass
class Page:
    """Run of the page on Python: its folder, the variables of its blocks, and the printed text."""

    folder: Path
    space: dict[str, Any]
    printed: str = ""

    def run(self, blocks: list[str]) -> None:
        """Run blocks in the folder, and keep what they print."""
        out = io.StringIO()
        with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(out):
            patch.chdir(self.folder)
            for block in blocks:
                run_python(block, "python.md", self.space)
        self.printed += out.getvalue()


def bench_run(folder: Path) -> Path:
    """Record the run of a thruster on a bench."""
    return bench_log(folder / "bench.mcap", draw_bench(4), kind="steps", count=2)


BLOCKS = blocks(ROOT / "docs/how-to/python.md", "python")


@pytest.fixture(scope="module")
def fit_page(logs: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Page:
    """Run the first block of the page, which fits a model."""
    page = Page(tmp_path_factory.mktemp("page"), {})
    for log in logs:
        shutil.copy(log, page.folder)
    page.run(BLOCKS[:1])
    return page


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a text table with the signals of a boat, ``other.csv`` of the page."""
    t = np.arange(0.0, 60.0, 0.1)
    columns = {
        "t": t,
        "psi": 0.1 * t,
        "r": 0.1 + 0.01 * np.sin(t),
        "n_left": 0.5 + 0.1 * np.sin(t),
        "n_right": 0.4 + 0 * t,
    }
    rows = np.column_stack(list(columns.values()))
    path = tmp_path_factory.mktemp("table") / "other.csv"
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.6f")
    return path


@pytest.fixture(scope="module")
def page(fit_page: Page, table: Path) -> Page:
    """Run the other blocks of the page."""
    bench_run(fit_page.folder)
    shutil.copy(table, fit_page.folder)
    fit_page.run(BLOCKS[1:])
    return fit_page


@pytest.fixture(scope="module")
def fit(fit_page: Page) -> st.FittedVehicle:
    found = fit_page.space["fit"]
    assert isinstance(found, st.FittedVehicle)
    return found


@pytest.fixture(scope="module")
def found(logs: list[Path], fit: st.FittedVehicle) -> st.FittedDiagnosis:
    """Diagnose the fit as the page does, and recommend a mission, whatever was found."""
    mission = "`seatrial mission design MODEL --discriminate mismatch,yaw-bias` generates the mission."
    with without_warnings(), pytest.MonkeyPatch.context() as patch:
        patch.setattr("seatrial.ident.results.diagnosis.recommended_experiment", lambda diagnosis: mission)
        return st.diagnose(fit, logs[0], validate=logs[1], max_effects=1)


@pytest.fixture(scope="module")
def with_mismatch(logs: list[Path]) -> st.FittedVehicle:
    """Fit a model with an effect by maximum likelihood."""
    with without_warnings():
        return st.fit(logs[0], effects=["mismatch"], **LIKELIHOOD)


@pytest.fixture(scope="module")
def drifted(logs: list[Path], fit: st.FittedVehicle) -> st.Navigated:
    """Navigate a log of another run with a GNSS outage."""
    with without_warnings():
        return st.navigate(fit, logs[2], gnss_outages=[(30.0, 50.0)])


@pytest.fixture(scope="module")
def navigated(logs: list[Path], fit: st.FittedVehicle) -> st.Navigated:
    """Navigate a log of another run with all its GNSS positions."""
    with without_warnings():
        return st.navigate(fit, logs[2])


def bag_in(folder: Path) -> Path:
    """Return the folder of a bag of ROS 2, which is made in `folder`."""
    bag = folder / "bag"
    bag.mkdir(exist_ok=True)
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 5\n", encoding="utf-8")
    return bag


def file_of_ros(folder: Path) -> Path:
    """Return a .mcap file without messages in a folder, whose header is that of a bag of ROS 2."""
    path = folder / "of_ros/of_ros.mcap"
    path.parent.mkdir(exist_ok=True)
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="libmcap 1.0")
        writer.finish()
    return path


def csv_in(folder: Path) -> Path:
    """Return a text table, which is made in `folder`."""
    table = folder / "pond_a.csv"
    table.write_text("t,yaw\n0.0,0.1\n0.1,0.2\n", encoding="utf-8")
    return table


def pandas_table() -> Any:
    """Return a DataFrame with the columns of a log, one of them ``u``."""
    import pandas

    return pandas.DataFrame({"t": [0.0, 0.1], "u": [0.2, 0.3]})


def model_in(folder: Path) -> Path:
    """Return the folder of a model, which is made in `folder`."""
    model = folder / "model"
    model.mkdir(exist_ok=True)
    (model / "model.toml").write_text('format = "seatrial-model 1"\n', encoding="utf-8")
    return model


def run(*words: object) -> None:
    with pytest.raises(SystemExit) as left:
        command_line.main([str(w) for w in words])
    assert not left.value.code


def test_the_import_loads_neither_numpy_nor_a_part() -> None:
    code = "import sys, seatrial; print([m for m in sys.modules if m == 'numpy' or m.startswith('seatrial.')])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("name", sorted(st.__all__))
def test_every_public_name_is_documented(name: str) -> None:
    thing = getattr(st, name)
    text = inspect.getdoc(thing) or ""
    assert name in dir(st)
    if inspect.isfunction(thing):
        for section in ("Parameters", "Returns", "Raises", "Examples"):
            assert f"{section}\n---" in text, section
        for parameter in inspect.signature(thing).parameters:
            described = [line.partition(" : ")[0].split(", ") for line in text.splitlines() if not line.startswith(" ")]
            assert any({parameter, f"*{parameter}", f"**{parameter}"} & set(names) for names in described), parameter
    else:
        assert len(text) > 30
    methods = [m for n, m in inspect.getmembers(thing, inspect.isfunction) if not n.startswith("_")]
    assert all(inspect.getdoc(m) for m in methods)


def test_notes_say_how_thrust_and_sensors_are_modelled(fit: st.FittedVehicle, tmp_path: Path) -> None:
    assert "thrust from the measured shaft speeds" in fit.notes
    assert not [note for note in fit.notes if "--fix" in note]  # in the words of Python
    assert st.load(fit.save(tmp_path / "fit")).notes == fit.notes


def test_limits_of_a_design_reach_the_search(
    fit: st.FittedVehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []

    def stop(_source: str, request: Any, *_: Any) -> None:
        seen.append(request.limits)
        raise SeatrialError("stopped, see --max-speed and --area")

    monkeypatch.setattr("seatrial.ident.workflows.design.make_design", stop)
    with pytest.raises(SeatrialError, match="stopped, see max_speed and area"):
        st.design(fit, tmp_path / "x.toml", area=(60, 40), max_speed=1.5, energy=0.3, current=0.2)
    assert seen == [DesignLimits((60.0, 40.0), 1.5, 0.3, 0.2)]


@pytest.mark.parametrize("function", [st.fit, st.diagnose, st.thruster, st.design, st.export])
def test_help_of_a_function_names_the_help_of_its_options(function: Any) -> None:
    text = " ".join((inspect.getdoc(function) or "").split())
    (name,) = re.findall(r"which ``help\(st\.(\w+)\)`` describes", text)
    options = getattr(st, name)
    described = inspect.getdoc(options) or ""
    for option in options.__annotations__:
        assert re.search(rf"^{option} : .+\n    \S", described, re.MULTILINE), option
        assert re.search(rf"\b{option}\b", text), option


@pytest.mark.parametrize(
    "options", [st.FitOptions, st.DiagnosisOptions, st.ThrusterOptions, st.DesignOptions, st.ExportOptions]
)
def test_help_of_options_lists_them_with_their_types_and_no_method_of_dict(options: Any) -> None:
    text = pydoc.plain(pydoc.render_doc(options))
    for name in options.__annotations__:
        assert f"|  {name} : " in text
    assert "by default" in text
    for method in ("clear(", "copy(", "fromkeys(", "setdefault("):
        assert method not in text
    assert is_typeddict(options)
    assert options(progress=True) == {"progress": True}


def test_signals_of_a_log(logs: list[Path]) -> None:
    log = st.open_log(logs[0])
    assert repr(log).startswith("<Log run1.mcap: 100.0 s, 19 signals: x, y,")
    assert log["psi"].unit == "rad"
    few = replace(log, signals={f"s{k}": log["psi"] for k in range(16)})
    assert repr(few).endswith(", s14, s15>")  # no name is hidden
    many = replace(log, signals={f"s{k}": log["psi"] for k in range(17)})
    assert repr(many).endswith(", s15 and 1 more>")
    assert repr(log["psi"]) == "<Signal psi [rad]: 5001 samples, 50 Hz>"
    frame = log.to_pandas()
    assert frame["psi"].dropna().to_numpy() == pytest.approx(log["psi"].value)
    part = st.open_log(str(logs[0]), start=20.0, end=30.0)
    inside = (log["psi"].t >= 20.0) & (log["psi"].t < 30.0)
    np.testing.assert_array_equal(part["psi"].value, log["psi"].value[inside])
    assert part.duration == pytest.approx(10.0, abs=0.1)
    with pytest.raises(KeyError, match=r"has no signal 'yaw'; did you mean 'psi'\? It has x, y"):
        log["yaw"]


def test_a_pattern_in_place_of_logs_is_named(tmp_path: Path) -> None:
    for function in (st.fit, st.fit_many):
        with pytest.raises(SeatrialError, match=r"\*\.mcap: a pattern is not expanded; give the folder, or sorted\("):
            function(str(tmp_path / "*.mcap"))


def test_mock_log_is_that_of_the_packaged_boat(tmp_path: Path) -> None:
    log = st.mock_log(tmp_path / "mock.mcap", 20.0, boat=5, mission=3, effect="mismatch")
    same = st.open_log(boat_log(tmp_path / "same.mcap", boat_with("mismatch", 5), 20.0, 3, 3))
    assert list(log.signals) == list(same.signals)
    for name, signal in log.signals.items():
        np.testing.assert_array_equal(signal.value, same[name].value)
    with pytest.raises(SeatrialError, match=r"exists already; force=True replaces it, path names another$"):
        st.mock_log(tmp_path / "mock.mcap", 20.0)
    st.mock_log(tmp_path / "mock.mcap", 15.0, force=True)
    assert st.open_log(tmp_path / "mock.mcap").duration == pytest.approx(15.0, abs=0.1)
    with pytest.raises(SeatrialError, match="there is no hidden effect 'winds'"):
        st.mock_log(tmp_path / "other.mcap", effect="winds")
    with pytest.raises(SeatrialError, match="seconds=10: a mission lasts more than 10 s"):
        st.mock_log(tmp_path / "other.mcap", 10.0)


def test_check_returns_the_findings_of_the_command(logs: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    found = st.check(logs[:2])
    run("check", "--json", logs[0], logs[1])
    printed = json.loads(capsys.readouterr().out)["findings"]
    assert [f._asdict() for f in found] == printed
    assert (found.faults, found.warnings) == ([], [])
    assert repr(found).splitlines()[-1].startswith("2 logs: 0 faults, 0 warnings")
    assert repr(st.check(logs[0])).splitlines()[-1].startswith(f"{logs[0].name}: 0 faults, 0 warnings")
    assert list(found.to_pandas()["code"]) == [f.code for f in found]


def test_fit_is_that_of_the_command(logs: list[Path], fit: st.FittedVehicle, tmp_path: Path) -> None:
    fit.save(tmp_path / "python")
    words = ("--prior", "c1=40:2", "--fix", "c2=1.1", "--no-score-tests", "--validate", logs[1])
    run("ident", "vehicle", logs[0], *words, "--out", tmp_path / "command")
    results = [json.loads((tmp_path / k / "result.json").read_text("utf-8")) for k in ("python", "command")]
    assert results[0].pop("command") == fit.result.command
    for result in results:
        result.pop("created")
        result.pop("command", None)
        result["fit"].pop("cpu")
    assert results[0] == results[1]
    assert (tmp_path / "python" / "report.html").exists()
    saved = st.load(tmp_path / "command")
    assert saved.answer == fit.answer
    assert saved.params["m_u"] == pytest.approx(fit.params["m_u"])
    assert saved.summary() == fit.summary()
    assert st.load(tmp_path / "command" / "model.toml").standard_errors["m_u"] == pytest.approx(
        fit.standard_errors["m_u"]
    )


def test_estimates_with_their_uncertainty(fit: st.FittedVehicle) -> None:
    assert fit.converged
    k = fit.free.index("m_u")
    assert np.sqrt(fit.cov[k, k]) == pytest.approx(fit.standard_errors["m_u"], rel=1e-6)
    frame = fit.to_pandas()
    row = frame.loc["m_u"]
    assert (row["value"], row["unit"], row["origin"]) == (fit.params["m_u"], "kg", "estimated")
    assert row["high"] - row["low"] == pytest.approx(2 * 1.96 * row["se"], rel=1e-3)
    assert np.isnan(frame.loc["c2", "se"])
    lines = fit.summary().splitlines()
    (shown,) = [line.split() for line in lines if line.startswith("m_u ")]
    assert float(shown[1]) == pytest.approx(row["value"], rel=1e-3)
    assert float(shown[5]) == pytest.approx(row["t"], rel=1e-2)
    assert shown[6:] == ["kg", "estimated"]
    assert " ".join(fit.answer.split()) in " ".join(fit.summary().split())
    paragraphs = fit.answer.splitlines()
    assert len(paragraphs) > 1
    assert all(any(line.startswith(x[:60]) for line in lines) for x in paragraphs)  # each begins a line
    assert any(line.startswith("fixed: c2 = 1.1 N (given)") for line in lines)
    assert len(repr(fit).splitlines()) == 2 + len(paragraphs)
    assert "<table>" in fit._repr_html_()


def test_summary_says_how_often_such_names_were_right(found: st.FittedDiagnosis) -> None:
    effect = structs.replace(found.result.effects[0], title="a thrust mismatch", probability=0.988)
    known = replace(found, result=structs.replace(found.result, effects=(effect,)))
    words = (
        f"Names of the effects: {effect.attribution}: a thrust mismatch. On simulated boats with known effects, 99 % "
        f"of the names that were {effect.attribution} were right; this is no probability for your boat."
    )
    assert words in " ".join(known.summary().split())
    without = replace(found, result=structs.replace(found.result, effects=()))
    assert "Names of the effects" not in without.summary()


def test_summary_ends_with_whole_notes(fit: st.FittedVehicle) -> None:
    """A contradiction of a given thrust was only in the notes, which the summary left out."""
    given = "The estimate of c1 is 28 N, where 29 ± 1.1 N was given. Check the given value."
    listed = f"Small errors are estimated too: {', '.join(40 * ['latency'])}."
    notes = (f"{given} {60 * 'More '}. Then `seatrial ident diagnose`.", listed, "Parameter T_r: at its bound")
    noted = replace(fit, result=structs.replace(fit.result, notes=notes, warnings=()))
    text = noted.summary()
    words = " ".join(text.split())
    ends = (
        f"note: {given} {60 * 'More '}. Then `st.diagnose`.",
        f"note: {listed}",
        "note: Parameter T_r: at its bound",
    )
    assert words.endswith(" ".join(" ".join(ends).split()))
    lines = text[text.index("note: ") :].splitlines()
    assert max(map(len, lines)) <= 100
    assert all(line.startswith(("note: ", "  ")) for line in lines)
    assert "`st.diagnose`" in noted.notes[0]
    few = replace(fit, result=structs.replace(fit.result, notes=notes[2:])).summary()
    assert few.endswith("\nnote: Parameter T_r: at its bound")
    assert "note: " not in replace(fit, result=structs.replace(fit.result, notes=())).summary()


def test_a_diagnosis_without_a_recommended_experiment_says_why(found: st.FittedDiagnosis) -> None:
    assert (found.recommended_experiment is None) == bool(found.no_experiment)
    result = structs.replace(found.result, recommended_experiment=None, no_experiment="no candidate passed")
    assert "No experiment is recommended: no candidate passed." in replace(found, result=result).summary()
    advised = structs.replace(result, recommended_experiment="Turn on the spot.", no_experiment="")
    assert "Turn on the spot." in replace(found, result=advised).summary()


def test_the_recommended_mission_is_designed_for_the_diagnosed_model(found: st.FittedDiagnosis, tmp_path: Path) -> None:
    """Only the model.toml of the diagnosis has the sizes of the effects that were tried."""
    mission = "`seatrial mission design {} --discriminate mismatch,yaw-bias` generates the mission."
    call = "`st.design(diagnosis, 'tell-apart.toml', between=('mismatch', 'yaw-bias'))` generates the mission."
    assert found.recommended_experiment == call
    assert call in " ".join(found.summary().split())
    folder = found.save(tmp_path / "my diagnosis")
    assert (folder / "model.toml").is_file()
    command = mission.format(f"'{folder}/model.toml'")
    assert st.load(folder / "result.json").result.recommended_experiment == command  # type: ignore[union-attr]
    page = re.sub(r'<span class="option">(.*?)</span>', r"\1", (folder / "report.html").read_text("utf-8"))
    assert f"'{folder}/model.toml' --discriminate" in html.unescape(page)


def test_the_covariance_has_a_table_with_names(fit: st.FittedVehicle, tmp_path: Path) -> None:
    table = fit.cov_to_pandas()
    assert list(table.index) == list(table.columns) == list(fit.free)
    assert np.sqrt(table.loc["m_u", "m_u"]) == pytest.approx(fit.standard_errors["m_u"], rel=1e-6)
    assert table.loc["m_u", "d_uu"] == fit.cov[fit.free.index("m_u"), fit.free.index("d_uu")]
    with pytest.raises(AttributeError, match="no attribute 'cov_params'; did you mean 'cov_to_pandas'"):
        fit.cov_params  # noqa: B018
    saved = st.load(fit.save(tmp_path / "fit"))
    assert np.allclose(saved.cov_to_pandas(), saved.cov)
    assert list(saved.cov_to_pandas().index) == list(saved.free)


def test_predictions_show_their_unit(fit: st.FittedVehicle) -> None:
    (channels, *_) = fit.predict(5.0).values()
    assert re.search(r"RMS error \S+ rad/s\)$", repr(channels["r"]))
    assert channels["psi"].unit == "rad"
    assert list(channels["r"].to_pandas().columns) == ["measured", "predicted", "sd"]
    table = fit.predict(5.0).to_pandas()
    assert set(table[table["channel"] == "vx"]["unit"]) == {"m/s"}


def test_the_summary_says_that_the_fit_converged(fit: st.FittedVehicle) -> None:
    """The number of iterations of the last of several fits would need an explanation, and is in the report only."""
    assert fit.result.fit.message == "converged"
    assert re.search(r"^horizontal.*: PE, .*converged$", fit.summary(), re.MULTILINE | re.DOTALL)
    assert "iteration" not in fit.summary().partition("log-likelihood")[0]


def test_residuals_are_standardised(fit: st.FittedVehicle) -> None:
    for channel in fit.residuals()["run1"].values():
        assert 0.9 < channel.value.std() < 1.1
        assert channel.t.shape == channel.value.shape
        assert re.fullmatch(r"Series\(\d+ samples, [\d.]+ to [\d.]+ s\)", repr(channel))


def test_the_residual_tests_are_a_table(fit: st.FittedVehicle, tmp_path: Path) -> None:
    result = fit.result
    for role in ("estimation", "validation"):
        table = fit.residual_tests(on=role)
        channels, pairs = ([r for r in rows if r.role == role] for rows in (result.residuals, result.cross))
        assert len(table) == 3 * len(channels) + len(pairs) > 0
        assert set(table["record"]) == {log.name for log in result.logs if log.role == role}
    assert list(table["p"][:2]) == [channels[0].ljung_box_p, channels[0].periodogram_p]
    with pytest.raises(SeatrialError, match="on: 'test' names no data; give 'estimation' or 'validation'"):
        fit.residual_tests(on="test")  # type: ignore[arg-type]
    of_estimation_only = tuple(r for r in result.residuals if r.role == "estimation")
    alone = replace(fit, result=structs.replace(result, residuals=of_estimation_only))
    with pytest.raises(SeatrialError, match="no residual tests of validation data"):
        alone.residual_tests(on="validation")
    table = fit.residual_tests()
    of_estimation = [c for c in result.cross if c.role == "estimation"]
    (row,) = [r for r in result.residuals if (r.record, r.channel) == ("run1", "r")]
    of = table.query("record == 'run1' and channel == 'r' and input == ''").set_index("test")
    assert list(of["p"]) == [row.ljung_box_p, row.periodogram_p, row.normal_p]
    assert of.loc["ljung-box", "statistic"] == np.abs(row.acf).max()
    assert of.loc["ljung-box", "lag"] == row.lags[np.argmax(np.abs(row.acf))]
    k = int(np.flatnonzero(row.frequency == of.loc["periodogram", "frequency"])[0])
    assert of.loc["periodogram", "statistic"] == abs(row.cumulative[k] - (k + 1) / row.cumulative.size)
    assert of.loc["normality", "statistic"] == row.largest
    assert of.loc["normality", "statistic_is"] == "largest residual [standard deviations]"
    assert of["statistic_is"].nunique() == len(of)
    crossed = table.query("test == 'cross-correlation'").reset_index()
    assert list(crossed["p"]) == [c.p for c in of_estimation]
    assert list(crossed["input"]) == [c.input for c in of_estimation]
    assert list(crossed["statistic"]) == [c.largest for c in of_estimation]
    found = result.cross[0]
    assert crossed.loc[0, "lag"] == found.lags[np.argmax(np.abs(found.z))]
    again = st.load(fit.save(tmp_path / "fit")).residual_tests()
    assert list(again["verdict"]) == list(table["verdict"])
    with pytest.raises(SeatrialError, match=r"no result\.json of a fit was loaded"):
        st.load(tmp_path / "fit/model.toml").residual_tests()
    with pytest.raises(AttributeError, match="did you mean 'residual_tests'"):
        fit.test_normality  # noqa: B018


def test_a_printed_table_of_residual_tests_names_each_of_its_rows(fit: st.FittedVehicle) -> None:
    pandas = pytest.importorskip("pandas", reason="no pandas here")
    table = fit.residual_tests()
    with pandas.option_context("display.max_rows", 20, "display.width", 80):  # then five first and last rows
        lines = str(table).splitlines()
    assert "..." in lines[0] + lines[1]  # columns are left out
    assert {"p", "verdict"} <= set(lines[0].split())
    shown = [table.iloc[k] for k in (*range(5), *range(-5, 0))]
    for row in shown:
        label = " ".join(filter(None, (row["channel"], row["test"], row["input"])))
        assert row.name == label
        assert any(line.startswith(f"{label} ") for line in lines)
    assert table.index.is_unique
    one, *_ = fit.result.residuals
    other = structs.replace(one, record="run9")
    several = replace(fit, result=structs.replace(fit.result, residuals=(one, other), cross=())).residual_tests()
    assert several.index[0] == f"{one.record} {one.channel} ljung-box"
    assert several.index[-1] == f"run9 {one.channel} normality"


def test_residual_tests_have_the_verdicts_of_report_and_answer(
    fit: st.FittedVehicle, found: st.FittedDiagnosis
) -> None:
    """Each whiteness test fails below 0.5 %, and a correlation below 1 % over the number of correlations."""
    first = fit.result.residuals[0]
    spoiled = structs.replace(first, ljung_box_p=0.004, periodogram_p=0.006, normal_p=None, outliers=2)
    cross = [c for c in fit.result.cross if c.role == "estimation"]
    pairs = len(cross)
    cross[:2] = [structs.replace(c, p=p / pairs) for c, p in zip(cross, (0.009, 0.011), strict=False)]
    result = structs.replace(fit.result, residuals=(spoiled,), cross=tuple(cross))
    verdicts = list(replace(fit, result=result).residual_tests()["verdict"])
    assert verdicts[:5] == [
        "not white", "white", "not tested, 2 beyond 6 standard deviations", "correlated", "uncorrelated"
    ]  # fmt: skip
    for row in found.result.residuals:
        assert row.after is not None
        tests = found.residual_tests(on=row.role).query("record == @row.record and channel == @row.channel")
        whiteness = tests[tests["test"].isin(["ljung-box", "periodogram"])]
        assert (whiteness["verdict"] == "white").all() == row.after.white
        assert whiteness["p"].iloc[0] == row.after.ljung_box_p


def test_a_saved_model_has_residuals_on_a_new_log(fit: st.FittedVehicle, logs: list[Path], tmp_path: Path) -> None:
    """As resid(z, m) of MATLAB: on the log of the validation they are nearly those of the fit."""
    with pytest.warns(st.SeatrialWarning, match="run2"):  # its validation log
        judged = st.compare(fit.save(tmp_path / "vehicle"), logs[1])
    own, new = fit.residuals(on="validation")["run2"]["r"], judged.residuals()["run2"]["r"]
    np.testing.assert_allclose(new.t, own.t)
    assert np.corrcoef(new.value, own.value)[0, 1] > 0.99
    tests = judged.residual_tests()
    assert {"ljung-box", "periodogram", "normality", "cross-correlation"} == set(tests["test"])
    assert set(tests["record"]) == {"run2"}
    loaded = st.load(judged.save(tmp_path / "judged"))
    assert len(loaded.residual_tests()) == len(tests)
    np.testing.assert_allclose(loaded.residuals()["run2"]["r"].value, new.value, atol=1e-3)
    assert "r, run2: residual" in str(loaded.plot_residuals("r").to_dict())
    assert "One-step prediction errors divided by" in (tmp_path / "judged/report.html").read_text(encoding="utf-8")
    with pytest.raises(st.SeatrialError, match="there is no model 'other'"):
        judged.residuals("other")
    with pytest.raises(st.SeatrialError, match=r"there is no horizon of .* 3\.0; the names are "):
        judged.predictions()[judged.names[0]][3.0]


def test_the_limit_of_a_residual_test_is_in_its_table(fit: st.FittedVehicle) -> None:
    table = fit.residual_tests()
    limits = table.groupby("test")["limit"].unique().map(list).to_dict()
    pairs = sum(c.p is not None and c.role == "estimation" for c in fit.result.cross)
    assert pairs > 1
    assert limits == {
        "ljung-box": [0.005], "periodogram": [0.005], "normality": [0.01], "cross-correlation": [0.01 / pairs]
    }  # fmt: skip
    failed = table["verdict"].str.split(",").str[0].isin(["not white", "not normal", "correlated"])
    assert list(failed) == list(table["p"] <= table["limit"])


def test_errors_before_and_after_a_diagnosis_are_a_table(
    fit: st.FittedVehicle, found: st.FittedDiagnosis, tmp_path: Path
) -> None:
    table = found.errors_to_pandas()
    errors = found.result.errors
    assert errors.validation is not None
    assert list(table.columns) == [
        "role", "kind", "seconds", "channel", "unit", "before", "after", "low", "high", "verdict"
    ]  # fmt: skip
    for role in ("estimation", "validation"):
        for kind in ("one_step", "horizon", "simulation"):
            rows = table[(table["role"] == role) & (table["kind"] == kind)].set_index("channel")
            expected = getattr(getattr(errors, role), kind)
            assert list(rows.index) == list(expected)
            assert list(rows["before"]) == [e.before for e in expected.values()]
            assert list(rows["after"]) == [e.after for e in expected.values()]
            assert list(rows["unit"]) == [e.unit for e in expected.values()]
            seconds = found.result.horizon_seconds if kind == "horizon" else np.nan
            np.testing.assert_array_equal(rows["seconds"], seconds)
    assert len(table) == sum(len(getattr(t, k)) for t in (errors.estimation, errors.validation) for k in
                             ("one_step", "horizon", "simulation"))  # fmt: skip
    ahead = table.query("kind == 'horizon'")
    assert set(ahead["verdict"]) <= {"fell", "rose", "unchanged", ""}
    assert ((ahead["verdict"] == "") == ahead["low"].isna()).all()  # without an interval, no change is judged
    assert (ahead["verdict"] != "").any()
    assert_frame_equal(st.load(found.save(tmp_path / "found")).errors_to_pandas(), table, rtol=1e-5)
    of_fit = fit.errors_to_pandas()
    assert of_fit["before"].isna().all()
    assert (of_fit["after"] > 0.0).all()
    with pytest.raises(SeatrialError, match=r"no result\.json of a fit was loaded"):
        st.load(tmp_path / "found/model.toml").errors_to_pandas()


def test_predictions_have_the_errors_of_the_result(fit: st.FittedVehicle) -> None:
    errors = fit.result.errors.validation
    assert errors is not None
    ahead = fit.predict()["run2"]
    assert set(fit.predict()) == {"run2"}
    assert set(fit.predict(on="estimation")) == {"run1"}
    for name, row in errors.horizon.items():
        assert ahead[name].rms == pytest.approx(row.after, rel=1e-9)
    assert fit.predict(2.0)["run2"]["x"].rms < ahead["x"].rms
    assert re.fullmatch(r"Prediction\(\d+ samples, [\d.]+ to [\d.]+ s, RMS error [\d.]+ m\)", repr(ahead["x"]))
    widening = fit.result.calibration.validation
    assert widening is not None
    for name, factor in widening.horizon.items():
        z = (ahead[name].measured - ahead[name].predicted) / ahead[name].sd
        assert factor.widening is not None
        assert factor.widening >= 1.0
        assert factor.n_records == 1
        assert np.mean(np.abs(z) < 1.96) >= factor.inside_95 - 0.05
    for name, row in errors.simulation.items():
        assert fit.simulate()["run2"][name].rms == pytest.approx(row.after, rel=1e-9)


def test_intervals_of_a_fit_and_a_diagnosis_are_saved_and_used_on_an_unseen_log(
    fit: st.FittedVehicle, found: st.FittedDiagnosis, logs: list[Path], tmp_path: Path
) -> None:
    judged = {"fit": fit, "found": found}
    compared = st.compare(judged, logs[2])
    for model, (name, result) in zip(compared.result.models, judged.items(), strict=True):
        saved = load_model(result.save(tmp_path / name) / "model.toml")
        rows = result.result.calibration.validation
        assert rows is not None
        assert saved.intervals is not None
        assert saved.intervals.horizon == result.result.horizon_seconds
        for kind, seconds in ((rows.horizon, 10.0), (rows.simulation, None)):
            known = saved.intervals.widening(seconds)
            assert known.keys() == kind.keys()
            for channel, row in kind.items():
                assert known[channel] == pytest.approx(row.widening, rel=1e-4)
        assert (model.widened_horizons, model.widened_simulation) == ((10.0,), True)
        (one,) = st.compare(tmp_path / name, logs[2]).result.models
        assert one.widened_horizons == (10.0,)


def test_other_functions_get_a_fitted_model_without_its_report(
    fit: st.FittedVehicle, found: st.FittedDiagnosis
) -> None:
    """A report takes a third of the time of writing, and no function reads it."""
    for model in (fit, found):
        with model_path(model) as path:
            names = {file.name for file in path.parent.iterdir()}
        assert names == {"model.toml", "result.json", "result.parquet"}


def test_series_become_tables(fit: st.FittedVehicle) -> None:
    residuals, ahead = fit.residuals(), fit.predict()
    table = residuals.to_pandas()
    assert list(table.columns) == ["record", "channel", "t", "value"]
    assert set(table["record"]) == {"run1"}
    own = table[table["channel"] == "r"]
    np.testing.assert_array_equal(own["value"], residuals["run1"]["r"].value)
    np.testing.assert_array_equal(residuals["run1"]["r"].to_pandas().index, own["t"])
    for found in (ahead, fit.simulate()):
        table = found.to_pandas()
        assert list(table.columns) == ["record", "channel", "t", "measured", "predicted", "sd", "unit"]
        own = table[table["channel"] == "vx"]
        rms = np.sqrt(np.mean((own["measured"] - own["predicted"]) ** 2))
        assert rms == pytest.approx(found["run2"]["vx"].rms)
        assert found["run2"]["vx"].to_pandas().shape == (len(own), 3)
    t = np.arange(0.0, 5.0, 0.1)
    motion = st.simulate(fit, t, {"n_left": 0.5 + 0 * t, "n_right": 0.5 + 0 * t})
    table = motion.to_pandas()
    assert table.index.name == "t"
    assert set(table.columns) == set(motion)
    np.testing.assert_array_equal(table["u"], motion["u"].value)
    assert st.ByRecord[st.Series]().to_pandas().empty


def test_figures(fit: st.FittedVehicle, tmp_path: Path) -> None:
    figure = fit.plot("psi", "r")
    assert repr(figure) == "<Figure 'Measured (grey) and predicted 10 s ahead (blue, with its 95 % band)': 12 traces>"
    bundle = figure._repr_mimebundle_()
    assert json.loads(json.dumps(bundle))["application/vnd.plotly.v1+json"]["layout"]["height"] > 300
    drawn = figure.to_plotly()
    assert len(drawn.data) == 12
    figure.save(tmp_path / "psi.html")
    page = (tmp_path / "psi.html").read_text("utf-8")
    assert "(blue, with its 95" in page
    assert '<div class="plot" id="figure-1"' in page
    assert len(fit.plot_residuals("psi").data) == 3
    with pytest.raises(SeatrialError, match=r"record: there is no record 'run'; did you mean 'run1'\?$"):
        fit.plot("psi", record="run")
    assert len(fit.plot("psi", record="run1").data) < len(fit.plot("psi").data)
    with pytest.raises(SeatrialError, match=r"there is no channel 'yaw'; the channels are psi, r[a-z, ]*$"):
        fit.plot("yaw")
    with pytest.raises(SeatrialError, match=r"'u'; the channels are .* u is a state .*columns t, u and sd_u$"):
        fit.plot("psi", "u")


def test_figure_of_a_fit_has_validation_first_and_headings_within_a_turn(fit: st.FittedVehicle) -> None:
    trace = next(x for x in fit.result.traces if x.angle)
    turned = structs.replace(trace, role="estimation", measured=trace.measured + 8.0 * np.pi)
    unseen = structs.replace(trace, record="unseen", role="validation")
    figure = prediction_figure(structs.replace(fit.result, traces=(turned, unseen)), ["psi"])
    titles = [x["text"] for x in figure.layout["annotations"]]
    assert [words.rpartition("(")[2] for words in titles] == ["validation)", "estimation)"]
    measured = [numbers(x["y"]) for x in figure.data if x["name"] == "measured"]
    assert len(measured) == 2
    assert all(np.nanmax(np.abs(y)) <= 180.01 for y in measured)
    assert figure.layout["yaxis"]["range"] == [-180.0, 180.0]


def test_figure_of_a_fit_limits_its_range_where_the_band_is_wide(fit: st.FittedVehicle) -> None:
    """A band of thousands of metres per second would make the curves flat."""
    trace = next(x for x in fit.result.traces if x.channel == "r")
    wide = structs.replace(trace, sd_horizon=np.where(np.arange(trace.t_horizon.size) == 5, 1e3, trace.sd_horizon))
    low, high = prediction_figure(structs.replace(fit.result, traces=(wide,)), []).layout["yaxis"]["range"]
    measured = np.degrees(trace.measured[np.isfinite(trace.measured)])
    assert low <= measured.min() < measured.max() <= high
    assert high - low < 4.0 * np.ptp(measured)


def test_simulation_of_given_inputs(fit: st.FittedVehicle) -> None:
    """Equal thrusts end at the speed at which thrust and drag are equal."""
    t = np.arange(0.0, 120.0, 0.1)
    motion = st.simulate(fit, t, {"n_left": np.full(t.size, 0.5), "n_right": np.full(t.size, 0.5)}, {"u": 0.2})
    p, u = fit.params, motion["u"].value  # through the water
    assert u[0] == pytest.approx(0.2)
    later = st.simulate(fit, t[:9] + 7.0, {n: np.full(9, 0.5) for n in ("n_left", "n_right")})
    assert later["u"].t == pytest.approx(t[:9] + 7.0)
    assert p["d_u"] * u[-1] + p["d_uu"] * u[-1] ** 2 == pytest.approx(2 * 0.25 * (p["c1"] + p["c2"]), rel=0.01)
    with pytest.raises(SeatrialError, match=r"no input 'n_l'; did you mean 'n_left'\? Its inputs are n_left, n_right$"):
        st.simulate(fit, t, {"n_l": t})
    with pytest.raises(SeatrialError, match="the model has no state 'speed'"):
        st.simulate(fit, t, {"n_left": 0 * t, "n_right": 0 * t}, {"speed": 1.0})
    with pytest.raises(SeatrialError, match=r"input n_right: it is missing; .* such as {'n_left': 0.5 \+ 0 \* t, 'n_r"):
        st.simulate(fit, t, {"n_left": t})
    with pytest.raises(SeatrialError, match=r"n_left: it has the shape \(3,\), but the times have \(1200,\)"):
        st.simulate(fit, t, {"n_left": [1.0, 2.0, 3.0]})


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ({"U": 1.0}, r"start: the model has no state 'U'; did you mean 'u'\? Its states are x, "),
        ({"u": "fast"}, "start: u is 'fast'; give a finite number"),
        ({"u": np.nan}, "start: u is nan; give a finite number"),
        ([1.0], 'start: give a dict with the initial values of states by name, such as {"u": 1.0}'),
    ],
)
def test_wrong_initial_states_are_refused(fit: st.FittedVehicle, start: Any, message: str) -> None:
    t = np.arange(0.0, 1.0, 0.1)
    with pytest.raises(SeatrialError, match=message):
        st.simulate(fit, t, {"n_left": t, "n_right": t}, start)


def test_an_initial_heading_in_degrees_gives_a_warning(fit: st.FittedVehicle) -> None:
    t = np.arange(0.0, 1.0, 0.1)
    with pytest.warns(st.SeatrialWarning, match=r"start: psi is 40 rad; give radians, for degrees math.radians\(40\)"):
        st.simulate(fit, t, {"n_left": t, "n_right": t}, {"psi": 40})


@pytest.mark.parametrize("step", [0.2, 0.013, 1.7])
def test_a_simulation_has_a_value_at_each_given_time(fit: st.FittedVehicle, step: float) -> None:
    t = np.cumsum(np.random.default_rng(3).uniform(0.5 * step, 1.5 * step, 40))
    n = np.where(t < t[20], 0.4, 0.7)
    motion = st.simulate(fit, t, {"n_left": n, "n_right": 0.9 * n})
    assert all(np.array_equal(series.t, t) and series.value.shape == t.shape for series in motion.values())
    fine = np.unique(np.concatenate([t, np.arange(t[0], t[-1], 0.01)]))
    between = np.interp(fine, t, n)  # this model takes the shaft speed as linear between its samples
    finer = st.simulate(fit, fine, {"n_left": between, "n_right": 0.9 * between})
    assert motion["u"].value == pytest.approx(finer["u"].value[np.isin(fine, t)], abs=2e-4)


@pytest.mark.parametrize("hold", ["zero", "linear", None])
def test_a_simulation_has_the_hold_of_the_exported_python(
    fit: st.FittedVehicle, tmp_path: Path, hold: Literal["zero", "linear"] | None
) -> None:
    t = np.arange(40) * 0.25
    u = 0.5 + 0.2 * np.random.default_rng(2).standard_normal((t.size, 2)).clip(-1.0, 1.0)
    motion = st.simulate(fit, t, {"n_left": u[:, 0], "n_right": u[:, 1]}, hold=hold)
    space = runpy.run_path(str(st.export(fit, tmp_path / "out", "python")))
    start = [motion[name].value[0] for name in space["STATES"]]
    exported = space["Simulation"](0.25, x=start, inputs=list(u[0]), hold=hold)
    steps = u[:-1] if hold == "zero" else u[1:]  # a measured shaft speed is linear in the model
    states = np.array([start, *(exported.step(list(row)) for row in steps)])
    for j, name in enumerate(space["STATES"]):
        assert motion[name].value == pytest.approx(states[:, j], abs=1e-6), name
    other = st.simulate(fit, t, {"n_left": u[:, 0], "n_right": u[:, 1]}, hold="linear" if hold == "zero" else "zero")
    assert np.abs(other["u"].value - motion["u"].value).max() > 1e-3
    with pytest.raises(SeatrialError, match="hold 'cubic': give 'zero' or 'linear'"):
        st.simulate(fit, t, {"n_left": u[:, 0], "n_right": u[:, 1]}, hold="cubic")  # type: ignore[arg-type]


def test_delayed_copies_are_neither_rows_nor_inputs_of_a_simulation() -> None:
    from seatrial.api.loading import Saved
    from seatrial.ident.estimation import SavedModel
    from seatrial.ident.models import make_model

    model = make_model("horizontal:command")
    assert any(i.tap_of for i in model.inputs)
    saved = Saved(Path("model.toml"), SavedModel(model, {}, {}), None)
    t = np.linspace(0.0, 20.0, 100)
    motion = st.simulate(saved, t, {"n_cmd_left": 0.5 + 0 * t, "n_cmd_right": np.where(t > 5.0, 0.5, 0.1)})
    assert np.array_equal(motion["r"].t, t)
    assert np.ptp(motion["r"].value) > 0.0
    # An import map calls the commands n_left and n_right.
    named = st.simulate(saved, t, {"n_left": 0.5 + 0 * t, "n_right": np.where(t > 5.0, 0.5, 0.1)})
    assert all(np.array_equal(named[n].value, motion[n].value) for n in motion)
    with pytest.raises(SeatrialError, match="the model has no input 'n_left'; did you mean 'n_cmd_left'"):
        st.simulate(saved, t, {"n_left": 0.5 + 0 * t, "n_cmd_left": 0.5 + 0 * t})
    with pytest.raises(SeatrialError) as raised:
        st.simulate(saved, t, {"n_cmd_left": 0.5 + 0 * t})
    assert str(raised.value).startswith("input n_cmd_right: it is missing; give the inputs by name, such as")
    assert "~" not in str(raised.value)


def test_an_input_outside_the_fitted_data_gives_a_warning_or_an_error(fit: st.FittedVehicle, tmp_path: Path) -> None:
    t = np.arange(0.0, 5.0, 0.1)
    for model in (fit, fit.save(tmp_path / "fit")):
        with warnings.catch_warnings():
            warnings.simplefilter("error", SeatrialWarning)
            st.simulate(model, t, {"n_left": 0.5 + 0 * t, "n_right": 0.5 + 0 * t})
        with pytest.warns(SeatrialWarning, match="input n_right: 0.5 to 5 is outside its range in the fitted data, -"):
            st.simulate(model, t, {"n_left": 0.5 + 0 * t, "n_right": np.linspace(0.5, 5.0, t.size)})
        with pytest.raises(SeatrialError, match=r"input n_right: 0 to 1.2e\+03 is far outside its range in the"):
            st.simulate(model, t, {"n_left": 0.5 + 0 * t, "n_right": np.linspace(0.0, 1200.0, t.size)})


def test_an_unknown_name_gives_the_similar_one(logs: list[Path], fit: st.FittedVehicle, tmp_path: Path) -> None:
    for call, message in (
        (lambda: fit.params["mu"], "there is no parameter 'mu'; did you mean 'm_u'?"),
        (lambda: fit.standard_errors["mu"], "there is no estimated parameter 'mu'; did you mean 'm_u'?"),
        (lambda: st.open_log(logs[0])["yaw"], "run1.mcap has no signal 'yaw'; did you mean 'psi'? It has x, y"),
        (lambda: fit.residuals()["run9"], "there is no record 'run9'; did you mean 'run1'?"),
        (lambda: fit.predict(5.0)["other"], "there is no record 'other'; the names are run2"),
        (lambda: fit.residuals()["run1"]["yaw"], "there is no channel of run1 'yaw'; the names are "),
        (lambda: fit.linearise(0.5).bode("yaw"), "no input 'yaw'; did you mean 'turn'?"),
        (lambda: fit.linearise(0.5).bode("r"), "'r' is a state, not an input; name an input, and take the item 'r'"),
        (lambda: fit.linearise(0.5).bode("turn")["yaw"], "there is no state that responds 'yaw'; the names are v, r"),
    ):
        with pytest.raises(st.SeatrialError) as raised:
            call()
        assert isinstance(raised.value, KeyError)
        assert message in str(raised.value)
        assert str(raised.value) == raised.value.args[0]  # a plain KeyError prints it between quotes
    with pytest.raises(
        AttributeError, match="module 'seatrial' has no attribute 'linearize'; did you mean 'linearise'"
    ):
        st.linearize  # noqa: B018
    for name, meant in (("bse", "standard_errors"), ("llf", "log_likelihood"), ("residual", "residuals")):
        with pytest.raises(
            AttributeError, match=rf"'FittedVehicle' object has no attribute '{name}'; did you mean '{meant}'"
        ):
            getattr(fit, name)
    saved = st.load(fit.save(tmp_path / "fit"))
    with pytest.raises(AttributeError, match="'Saved' object has no attribute 'bse'; did you mean 'standard_errors'"):
        saved.bse  # noqa: B018
    assert not hasattr(fit, "_private")
    assert fit.params.get("mu") is None
    assert dict(fit.params) == {**fit.params}


def test_a_heading_in_degrees_gives_a_warning(fit: st.FittedVehicle) -> None:
    with pytest.warns(SeatrialWarning, match=r"psi = 40 rad; if these are degrees, give np\.radians\(40\)"):
        fit.linearise(0.5, at={"psi": 40})
    with pytest.warns(SeatrialWarning, match="psi = -90 rad"):
        fit.steady(points=3, at={"psi": -90.0})


def test_each_log_of_a_fit_has_its_own_window(logs: list[Path]) -> None:
    both = [st.open_log(logs[0], 10.0, 80.0), st.open_log(logs[1], end=60.0)]
    fit = st.fit(both, validate=logs[2], score_tests=False, **THRUST)
    names = [Path(log.path).name for log in fit.result.logs if log.role == "estimation"]
    assert names == [f"{logs[0].name}[10:80]", f"{logs[1].name}[0:60]"]
    durations = [round(r.t[-1] - r.t[0]) for r in fit.fitted.records]
    assert durations == [pytest.approx(70, abs=2), pytest.approx(60, abs=2)]


def test_log_with_commands_for_a_model_of_measured_shaft_speeds_gives_a_warning(
    fit: st.FittedVehicle, logs: list[Path], tmp_path: Path
) -> None:
    model = fit.save(tmp_path / "fit") / "model.toml"
    assert tomllib.loads(model.read_text())["holds"] == {"n_left": "linear", "n_right": "linear"}
    with warnings.catch_warnings():
        warnings.simplefilter("error", SeatrialWarning)
        st.navigate(model, logs[2], smoothed=False)
    model.write_text(model.read_text().replace('n_left = "linear"', 'n_left = "zero"'))
    with pytest.warns(SeatrialWarning, match="n_left: measured values, but the model was fitted to held commands"):
        st.navigate(model, logs[2], smoothed=False)


def test_linearisation_with_negative_damping_of_sway_gives_a_warning(logs: list[Path]) -> None:
    how = {**LIKELIHOOD, "fixed": {**LIKELIHOOD["fixed"], "d_v": 20.0, "Y_uv": -100.0}}
    lifted = st.fit(logs[1], effects=["lift"], **how)
    with pytest.warns(SeatrialWarning, match=r"^at 0\.5 m/s the estimated damping of sway without drift is negative"):
        st.linearise(lifted, 0.5)


def test_linearisation_is_shown_in_a_few_lines_and_warns_outside_the_data(fit: st.FittedVehicle) -> None:
    at = st.linearise(fit, 0.5)
    assert repr(at).startswith("<Linearisation at 0.5 m/s, stable>\nstates u, v, r")
    assert repr(at).count("time constant") == len(at.poles)
    (bode,) = at.bode("straight").values()
    assert repr(bode).startswith(f"Bode({bode.frequency.size} frequencies, ")
    with pytest.warns(SeatrialWarning, match=r"1.8 m/s is outside \S+ to \S+ m/s, within which 98 % of the speeds of"):
        st.linearise(fit, 1.8)


@pytest.mark.parametrize("most", [1.0996, 1.1004])
def test_limit_of_the_speeds_as_printed_gives_no_warning(fit: st.FittedVehicle, tmp_path: Path, most: float) -> None:
    model = fit.save(tmp_path / "fit") / "model.toml"
    model.write_text(re.sub(r"(?m)^u = .*$", f"u = [-0.8, {most}]", model.read_text()))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        st.linearise(model, 1.1)
    assert not [w for w in caught if "is outside -0.8" in str(w.message)]
    with pytest.warns(SeatrialWarning, match="1.11 m/s is outside -0.8 to 1.1 m/s, within which"):
        st.linearise(model, 1.11)


def test_operating_point_outside_the_data_warns(fit: st.FittedVehicle, tmp_path: Path) -> None:
    model = fit.save(tmp_path / "fit") / "model.toml"
    text = re.sub(r"(?m)^v = .*$", "v = [0.2, 0.5]", model.read_text())
    model.write_text(text)
    with pytest.warns(
        SeatrialWarning, match=r"at 0.5 m/s is outside the fitted data: sway v = \S+ m/s \(98 % of the data: 0.2 to 0.5"
    ):
        at = st.linearise(model, 0.5)
    assert "The operating point is outside the fitted data: sway v" in at._repr_html_()
    with warnings.catch_warnings():
        warnings.simplefilter("error", SeatrialWarning)
        st.linearise(fit, 0.5)


def test_linear_model_has_table_and_figures_with_errors(fit: st.FittedVehicle, tmp_path: Path) -> None:
    at, saved = fit.linearise(0.5), st.load(fit.save(tmp_path / "fit"))
    table = at.to_pandas()
    assert list(table.columns) == ["real", "imaginary", "time_constant", "se", "frequency", "damping", "mainly"]
    assert set(table["mainly"].str.split(", ").sum()) == set(at.states)
    np.testing.assert_allclose(table["time_constant"], -1.0 / table["real"])
    # The surge has the time constant m_u / (d_u + 2 d_uu u), and its standard error follows from their covariance.
    drag = fit.params["d_u"] + 2 * fit.params["d_uu"] * 0.5
    T = fit.params["m_u"] / drag
    k = [fit.free.index(n) for n in ("m_u", "d_u", "d_uu")]
    slope = np.array([1 / drag, -T / drag, -T / drag])
    row = table.iloc[int(np.argmin(np.abs(table["time_constant"] - T)))]
    assert row["time_constant"] == pytest.approx(T, rel=1e-3)
    assert row["se"] == pytest.approx(np.sqrt(slope @ fit.cov[np.ix_(k, k)] @ slope), rel=0.05)
    again = saved.linearise(0.5)
    np.testing.assert_allclose(again.A, at.A, rtol=1e-9)
    np.testing.assert_allclose(again.to_pandas()["se"], table["se"], rtol=1e-3)

    bode = at.plot_bode()
    assert bode.title.startswith("Bode plot of u, v, r from ")
    assert at.plot_bode("turn", "r").title.startswith("Bode plot of r from turn at 0.5 m/s")
    lines = [trace for trace in bode.data if trace["name"]]
    assert [trace["name"] for trace in lines[:3]] == ["u [m/s], straight", "v [m/s], turn", "r [deg/s], turn"]
    assert len({(trace["line"]["color"], trace["line"]["dash"]) for trace in lines[:3]}) == 3
    assert len(bode.data) == 2 * 6  # gain and phase of three states, each with its band
    assert bode.layout["xaxis"]["type"] == "log"
    assert [trace["name"] for trace in at.plot_bode("turn", "r").data if trace["name"]] == 2 * ["r [deg/s], turn"]
    with pytest.raises(SeatrialError, match=r"p: does not respond to these inputs; the states are u, v, r"):
        at.plot_bode("turn", "p")
    step = at.plot_step({"n_left": 1.0}, size=0.2, t=np.linspace(0.0, 5.0, 20))
    assert step.title.startswith("Step responses of ")
    assert " from +1 n_left at 0.5 m/s" in step.title
    rise = next(trace for trace in step.data if trace["name"] == "u")
    assert rise["y"][-1] == pytest.approx(0.2 * at.step_response("n_left", np.array([5.0]))["u"][0], rel=1e-4)
    step.save(tmp_path / "step.html")


def test_a_step_response_is_a_plain_array_and_says_so(fit: st.FittedVehicle) -> None:
    """Users read ``.value``, as of the series of `simulate`, and got an AttributeError."""
    at = fit.linearise(0.5)
    response = at.step_response("turn", np.array([0.0, 1.0]))["r"]
    assert type(response) is np.ndarray
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "python.md").read_text(encoding="utf-8")
    for text in (at.step_response.__doc__ or "", page):
        assert re.search(r"plain (NumPy )?arrays.{0,40} no series with `{1,2}\.value`", " ".join(text.split()))


def test_linear_model_is_written_for_matlab(fit: st.FittedVehicle, tmp_path: Path) -> None:
    at = fit.linearise(0.5)
    path = at.to_mat(tmp_path / "linear.mat")
    read = loadmat(path)
    for name in ("A", "B", "C", "D"):
        np.testing.assert_array_equal(read[name], getattr(at, name))
    assert read["C"].tolist() == np.eye(3).tolist()
    assert read["D"].shape == read["B"].shape
    for name in ("states", "inputs", "outputs"):
        assert [str(cell[0]) for cell in read[name].ravel()] == list(getattr(at, name))
    assert [str(cell[0]) for cell in read["state_units"].ravel()] == ["m/s", "m/s", "rad/s"]
    np.testing.assert_array_equal(read["u0"][:, 0], at.u0)
    assert read["input_delay"].tolist() == [[0.0], [0.0]]
    assert "conditions" not in read
    # The error of the surge rate by the speed follows from that of the pole of surge, which is this element.
    k = int(np.argmin(np.abs(at.poles - at.A[0, 0])))
    assert read["A_se"][0, 0] == pytest.approx(at.pole_errors[k], rel=0.05)
    with pytest.raises(SeatrialError, match=r"linear\.mat: the file exists already; force=True replaces it"):
        at.to_mat(path)
    assert at.to_mat(path, force=True) == path
    with pytest.raises(SeatrialError, match=r"linear\.m: MATLAB loads files whose name ends in \.mat"):
        at.to_mat(tmp_path / "linear.m")
    delayed = replace(at, delays={"n_right": 0.2}).to_mat(tmp_path / "delayed.mat")
    assert loadmat(delayed)["input_delay"].tolist() == [[0.0], [0.2]]
    windy = replace(at, conditions={"psi": 0.3}).to_mat(tmp_path / "windy.mat")
    assert loadmat(windy)["conditions"]["psi"][0, 0] == 0.3


def test_an_unstable_pole_has_no_time_constant(fit: st.FittedVehicle) -> None:
    at = fit.linearise(0.5)
    unstable = replace(at, A=np.diag([-0.5, -1.0, 0.36]), moved=())
    assert "pole 0.36 1/s, grows by a factor of e in 2.778 s" in repr(unstable)
    table = unstable.to_pandas()
    assert np.isnan(table.loc[table["real"] > 0.0, ["time_constant", "se"]]).all(axis=None)
    assert sorted(table["time_constant"].dropna()) == [1.0, 2.0]
    grows = "unstable: its step response grows by a factor of e in 2.78 s without limit"
    with pytest.warns(st.SeatrialWarning, match=grows) as step:
        unstable.step_response("turn", 5.0)
    with pytest.warns(st.SeatrialWarning, match=grows) as figure:
        unstable.plot_step(t=5.0)
    assert len(step) == len(figure) == 1
    shown = unstable._repr_html_()
    assert "-2.778" not in shown
    assert "<td>grows by a factor of e in 2.778 s</td>" in shown


def test_the_operating_point_has_plain_numbers(fit: st.FittedVehicle) -> None:
    at = fit.linearise(0.5)
    assert "np.float64" not in str(dict(at.operating_point))
    assert at.operating_point["n_left"] == at.u0[0]
    assert list(at.operating_point) == [*at.states, *at.inputs]
    assert f"inputs n_left = {at.u0[0]:.4g}, n_right = {at.u0[1]:.4g}" in repr(at)


def test_conditions_of_effects_are_stated_and_can_be_chosen(fit: st.FittedVehicle, tmp_path: Path) -> None:
    """A payload has shifted by default, and is where it was before at an earlier time."""
    model = fit.save(tmp_path / "fit") / "model.toml"
    shift = ("t_shift", 60.0), ("x_shift", 0.2), ("y_shift", 0.1), ("x_before", 0.0), ("y_before", 0.0)
    rows = "".join(f'[[parameter]]\nname = "{n}"\nvalue = {v}\nfree = false\n' for n, v in shift)
    text = re.sub(r"^effects = \[", 'effects = ["payload-shift", ', model.read_text(), flags=re.MULTILINE)
    model.write_text(text.replace("[validity]", "[validity]\nt = [0.0, 90.0]", 1) + rows)
    late, early = st.linearise(model, 0.5), st.load(model).linearise(0.5, at={"t": 10.0})
    assert (late.inputs, late.conditions, early.conditions) == (("n_left", "n_right"), {"t": 90.0}, {"t": 10.0})
    assert np.abs(late.A - early.A).max() > 1e-3
    assert "Taken as constant: t = 90 s." in late._content().answer
    steady = st.steady(model, points=5)
    assert steady.conditions == {"t": 90.0}
    assert steady.answer.endswith("Taken as constant: t = 90 s.")
    assert "constant" not in st.steady(fit, points=5).answer


def in_wind(fit: st.FittedVehicle, folder: Path, north: float = -3.0) -> Path:
    """Return the model.toml of a fit with a steady wind force to the north [N]."""
    model = fit.save(folder) / "model.toml"
    values = {"F_wx": north, "F_wy": 0.5, "w_x": 0.5, "w_n": 0.1, "w_nn": 0.0, "k_air": 0.28}
    rows = "".join(f'[[parameter]]\nname = "{n}"\nvalue = {v}\nfree = false\n' for n, v in values.items())
    text = re.sub(r"^effects = \[", 'effects = ["wind", ', model.read_text(), flags=re.MULTILINE)
    model.write_text(text + rows)
    return model


def test_steady_motion_in_wind_is_that_of_a_heading(fit: st.FittedVehicle, tmp_path: Path) -> None:
    """The speed differs between both directions of the wind, and no turn is steady."""
    model = in_wind(fit, tmp_path / "fit")
    against, before = st.steady(model, points=5), st.steady(model, points=5, at={"psi": np.pi})
    assert against.straight is not None
    assert before.straight is not None
    assert against.straight.value[-1] < before.straight.value[-1] - 0.01
    assert against.turns == ()
    assert "largest steady turn rate" not in against.answer
    assert "There is no steady turn: the model depends on the heading" in against.answer
    assert before.answer.endswith("Taken as constant: psi = 3.142 rad.")
    assert "psi = 0 rad" in against.plot().title


def test_linear_model_in_wind_asks_for_its_heading(fit: st.FittedVehicle, tmp_path: Path) -> None:
    model = in_wind(fit, tmp_path / "fit")
    north, chosen = st.linearise(model, 0.5), st.load(model).linearise(0.5, at={"psi": 1.0})
    assert (north.assumed, chosen.assumed) == (("psi",), ())
    assert "hold near psi = 0 rad" in north._content().answer
    with pytest.warns(SeatrialWarning, match="is linearised at psi = 0 rad"):
        north.lqr({"u": 4.0, "r": 1.0, "psi": 4.0})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        north.lqr({"u": 4.0, "r": 1.0}) if north.stable else None
        chosen.lqr({"u": 4.0, "r": 1.0, "psi": 4.0})


def test_steady_motion_is_that_of_a_long_simulation(fit: st.FittedVehicle, tmp_path: Path) -> None:
    steady, saved = fit.steady(means=(0.5,), points=21), st.load(fit.save(tmp_path / "fit"))
    assert steady.straight is not None
    np.testing.assert_allclose(steady.straight.value, saved.steady((0.5,), 21).curves[0].value, rtol=1e-6)
    # The simulation has the current of the fit, the steady motion is through the water.
    model = tmp_path / "fit/model.toml"
    text = re.sub(r"(name = \"(V_x|V_y)\"(?:\n.+)*?\nvalue = ).*", r"\g<1>0.0", model.read_text())
    model.write_text(text)
    assert st.load(model).params["V_x"] == 0.0
    (turn,), t = steady.turns, np.arange(0.0, 120.0, 0.1)
    k = turn.command.size - 3
    commands = {"n_left": turn.mean + turn.command[k], "n_right": turn.mean - turn.command[k]}
    motion = st.simulate(model, t, {n: np.full(t.size, c) for n, c in commands.items()})
    assert turn.value[k] == pytest.approx(motion["r"].value[-1], rel=1e-3)
    assert turn.sd[k] > 0.0
    assert np.all(np.diff(steady.straight.value) > 0.0)
    assert "The largest steady turn rate is" in steady.answer
    assert " m/s, at a shaft speed of " in steady.answer
    top = steady.straight.value.size - 1
    value, error = steady.straight.value[top], steady.straight.sd[top]
    assert f"speed is {value:.3g} ± {error:.2g} m/s" in steady.answer  # one standard error, as everywhere
    assert "not determined" not in steady.answer + steady._repr_html_()
    vague = replace(steady, curves=tuple(structs.replace(c, sd=0.6 * np.abs(c.value)) for c in steady.curves))
    assert "The largest steady turn rate is not determined: its standard error is more than half" in vague.answer
    assert "<td>not determined</td>" in vague._repr_html_()
    assert np.isfinite(vague.to_pandas()["value"]).any()  # the numbers are kept
    assert steady._content().columns[1] == "shaft speed"
    names = {"", "speed", "speed, unstable course", "speed, beyond the data", f"mean shaft speed {turn.mean:.2g}"}
    assert {trace["name"] for trace in steady.plot().data} == names
    assert {trace["name"] for trace in replace(steady, speeds=None).plot().data} == names - {"speed, beyond the data"}
    fastest = steady.straight.value[-1]
    slow = replace(steady, speeds=(-0.2, 0.5 * fastest))
    assert f"beyond {0.5 * fastest:.2g} m/s, below which 99 % of the data are." in slow.answer
    assert steady.speeds == pytest.approx(tomllib.loads(text)["validity"]["u"], rel=1e-3)
    line = next(trace for trace in slow.plot().data if trace["name"] == "speed, beyond the data")
    assert line["line"]["dash"] == "dot"
    frame = steady.to_pandas()
    assert len(frame) == steady.straight.command.size + turn.command.size
    reached = replace(steady, turn_rates=(-0.02, 0.01)).answer
    assert ", beyond ± 1.1 deg/s, within which 98 % of the data are" in reached
    assert "within which" not in replace(steady, turn_rates=(-9.0, 9.0)).answer
    saved = st.load(fit.save(tmp_path / "saved"))
    assert (saved.warnings, saved.converged) == (fit.warnings, True)
    with pytest.raises(SeatrialError, match=r"no result.json of a fit was loaded"):
        _ = st.load(tmp_path / "saved/model.toml").converged
    assert steady.turn_rates == saved.saved_model().validity["r"]
    with pytest.raises(SeatrialError, match="means 2: give parts of the largest command"):
        fit.steady(means=(2.0,))
    with pytest.raises(SeatrialError, match="points 2: give a whole number of at least 3"):
        fit.steady(points=2)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> st.FittedThruster:
    return st.thruster(bench_run(tmp_path_factory.mktemp("bench")))


def test_thruster_is_a_fitted_model_like_a_boat(bench: st.FittedThruster, tmp_path: Path) -> None:
    se = dict(zip(bench.free, np.sqrt(np.diag(bench.cov)), strict=True))
    assert se["c1"] == pytest.approx(bench.standard_errors["c1"], rel=1e-6)
    (residuals,) = bench.residuals().values()
    assert set(residuals) == {"n", "force"}
    assert residuals["force"].value.std() == pytest.approx(1.0, abs=0.2)
    (ahead,), (simulated,) = bench.predict().values(), bench.simulate().values()
    assert ahead["force"].rms == pytest.approx(bench.result.errors.estimation.horizon["force"].after, rel=0.05)
    assert simulated["force"].rms < 0.05 * np.ptp(simulated["force"].measured)
    assert len(bench.plot_residuals("n").data) == 3
    saved = st.load(bench.save(tmp_path / "bench"))
    assert saved.to_pandas().loc["c1", "se"] == pytest.approx(se["c1"], rel=1e-6)
    t = np.arange(0.0, 5.0, 0.02)
    motions = [st.simulate(model, t, {"n_cmd": np.full(t.size, 0.5)}) for model in (bench, saved)]
    assert motions[0]["force"].value[-1] == pytest.approx(motions[1]["force"].value[-1], rel=1e-6)
    assert motions[0]["n"].value[-1] > 0.3
    with pytest.raises(SeatrialError, match=r"input n_cmd: it is missing; give the inputs by name, such as {'n_cmd': "):
        st.simulate(bench, t, {})
    with pytest.raises(SeatrialError, match="has no forward speed u"):
        saved.linearise(0.5)
    with pytest.raises(SeatrialError, match="has no steady motion: it needs a speed u"):
        saved.steady()


def test_notebooks_show_every_result(
    logs: list[Path],
    fit: st.FittedVehicle,
    found: st.FittedDiagnosis,
    bench: st.FittedThruster,
    drifted: st.Navigated,
    navigated: st.Navigated,
    tmp_path: Path,
) -> None:
    """Each result has its answer and a table whose numbers are its own."""
    saved, again = st.load(fit.save(tmp_path / "fit")), st.load(found.save(tmp_path / "found"))
    assert isinstance(again, st.SavedDiagnosis)
    assert again.to_pandas().loc["eps_LR", "value"] == pytest.approx(found.params["eps_LR"], rel=1e-6)
    at = [found.free.index(name) for name in again.free]
    expected = found.cov[np.ix_(at, at)]
    scale = np.sqrt(np.outer(expected.diagonal(), expected.diagonal()))
    np.testing.assert_allclose(again.cov / scale, expected / scale, atol=1e-5)  # the file rounds the correlations
    with pytest.raises(
        st.SeatrialError, match="a loaded result has no residuals, which needs the logs: fit them"
    ) as no:
        again.residuals()
    assert isinstance(no.value, AttributeError)
    assert not hasattr(again, "residuals")
    only_model = st.load(tmp_path / "fit/model.toml")
    assert only_model.to_pandas().loc["m_u", "value"] == pytest.approx(fit.params["m_u"], rel=1e-6)
    compared = st.compare({"a<b": fit, "with": found}, logs[2])
    ahead = compared.to_pandas().query("kind == 'horizon' and channel == 'r' and model == 'with'")
    shown: list[tuple[Any, tuple[str, str]]] = [
        (saved, ("m_u", f"{fit.params['m_u']:.4g}")),
        (again, ("eps_LR", f"{found.params['eps_LR']:.4g}")),
        (only_model, ("m_u", f"{fit.params['m_u']:.4g}")),
        (compared, ("a&lt;b", f"{np.degrees(ahead['rms'].iloc[0]):.3g}")),
        (drifted, ("95 % radius", f"{drifted.result.outages[0].at_end.radius:.3g}")),
        (navigated, ("state at the end", "run3")),
        (fit.linearise(0.5), ("time constant [s]", "stable")),
        (fit.steady(), ("turn rate, mean", "deg/s")),
        (bench, ("c1", f"{bench.params['c1']:.4g}")),
        (st.open_log(logs[0]), ("psi", "run1.mcap")),
        (st.check(logs[0]), ("finding", "advice")),
    ]
    for thing, words in shown:
        text = thing._repr_html_()
        assert text.count("<table>") == 1, type(thing)
        assert text.count("<tr>") > 1, type(thing)
        for word in words:
            assert word in text, (type(thing), word)


def test_export_writes_the_file_of_the_command(fit: st.FittedVehicle, tmp_path: Path) -> None:
    fit.save(tmp_path / "vehicle")
    run("ident", "export", tmp_path / "vehicle", "--to", "c", "--name", "boat", "-o", tmp_path / "command.h")
    for k, model in enumerate((fit, tmp_path / "vehicle", st.load(tmp_path / "vehicle"))):
        path = st.export(model, tmp_path / "out", "c", name="boat", force=k > 0)
        assert path == tmp_path / "out/boat.h"
        assert path.read_text() == (tmp_path / "command.h").read_text()
    path = st.export(fit, tmp_path / "new/boat.h", "c", name="boat")
    assert path == tmp_path / "new/boat.h"
    assert path.read_text() == (tmp_path / "command.h").read_text()
    path = st.export(fit, tmp_path / "out", "fmu", source_only=True)
    assert path.name == "horizontal.fmu"
    assert path.read_bytes().startswith(b"PK")
    names = [st.export(fit, tmp_path / "out", t).name for t in ("python", "casadi", "ros2")]
    assert names == ["horizontal.py", "horizontal_casadi.py", "horizontal.yaml"]
    with pytest.raises(SeatrialError, match=r"horizontal.py: the file exists already; force=True replaces it, folder"):
        st.export(fit, tmp_path / "out", "python")
    with pytest.warns(
        SeatrialWarning, match="the name 'my boat' is not valid in the file and becomes my_boat"
    ) as found:
        st.export(fit, tmp_path / "out", "c", name="my boat")
    assert [w.filename for w in found] == [__file__]
    with pytest.raises(SeatrialError, match=r"^mass has no effect on an export to python; leave it out"):
        st.export(fit, tmp_path, "python", mass=30.0)
    with pytest.raises(SeatrialError, match="give mass and inertia"):
        st.export(fit, tmp_path, "gazebo")
    with pytest.raises(SeatrialError, match=r"there is no format .matlab.; did you mean .fmu. \(FMI"):
        st.export(fit, tmp_path, "matlab")  # type: ignore[arg-type]
    with pytest.raises(SeatrialError, match=r"`st.linearise\(MODEL, SPEED\).to_mat\(FILE\)` in Python\)\? The formats"):
        st.export(fit, tmp_path, "MATLAB")  # type: ignore[arg-type]
    with pytest.raises(SeatrialError, match="there is no option 'thrusters'; did you mean 'thruster'"):
        st.export(fit, tmp_path, "c", thrusters="x")  # type: ignore[call-arg]
    with pytest.raises(SeatrialError, match=r"^thruster: the boat has no thruster 'bow'"):
        st.export(fit, tmp_path, "c", thruster={"bow": tmp_path / "vehicle"})


def test_diagnosis_names_the_effect(logs: list[Path], found: st.FittedDiagnosis, tmp_path: Path) -> None:
    assert list(found.effects) == ["mismatch"]
    assert found.params["eps_LR"] == pytest.approx(-0.06, abs=0.03)
    again = st.load(found.save(tmp_path / "found"))
    assert again.answer == found.answer
    assert st.navigate(again, logs[2], smoothed=False).states  # a loaded model can be used like the fitted one
    loaded, fitted = (st.compare(model, logs[2]).result.channels for model in (again, found))
    assert [row.errors[0].rms for row in loaded] == pytest.approx([row.errors[0].rms for row in fitted], rel=1e-6)
    with pytest.raises(SeatrialError, match=r"model 2 is the same model as .*; give another model to compare it with"):
        st.compare([again, found], logs[2])
    assert again.params["eps_LR"] == pytest.approx(found.params["eps_LR"], rel=1e-6)


def test_a_parameter_is_held_at_its_given_value_in_a_diagnosis(
    logs: list[Path], fit: st.FittedVehicle, found: st.FittedDiagnosis
) -> None:
    assert found.standard_errors["m_r"] > 0.0
    with without_warnings():
        held = st.diagnose(fit, logs[0], validate=logs[1], max_effects=1, fixed={"m_r": 10.0, "d_vv": 20.0})
    assert list(held.effects) == ["mismatch"]
    for name, value in {"m_r": 10.0, "d_vv": 20.0}.items():
        (row,) = [p for p in held.result.fit.parameters if p.name == name]
        assert (row.value, row.free, row.origin) == (value, False, "given")
        refits = [r.fitted.fit.model.values[name] for x in held.found.rounds for r in x.refits]
        assert refits
        assert set(refits) == {value}
    with pytest.raises(SeatrialError, match=r"^fixed m_x: model horizontal.* has no such parameter"):
        st.diagnose(fit, logs[0], validate=logs[1], fixed={"m_x": 1.0})
    with pytest.raises(SeatrialError, match="fixed: m_r: 'heavy' is no number"):
        st.diagnose(fit, logs[0], validate=logs[1], fixed={"m_r": "heavy"})  # type: ignore[dict-item]


def test_an_excluded_effect_is_not_found(
    logs: list[Path],
    fit: st.FittedVehicle,
    found: st.FittedDiagnosis,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The boat has a mismatch, which the search finds if it is not excluded."""
    assert "mismatch" in found.effects
    assert found.result.excluded_effects == ()
    assert "Left out" not in found.answer
    without = st.diagnose(fit, logs[0], validate=logs[1], max_effects=1, exclude="mismatch", progress=True)
    lines = capsys.readouterr().err.splitlines()
    assert all(
        re.match(r"\d+:\d\d so far(, about \d+ (s|min) to go(, seldom more than \d+ (s|min))?)?: ", t) for t in lines
    )
    for stage in ("fitting ", "round 1 of at most 1: ", "refitting with ", "computing the importance", "validation: "):
        assert any(stage in line for line in lines), stage
    assert " to go" in lines[-1]
    assert "mismatch" not in without.effects
    names = {c.name for r in without.result.rounds for c in r.candidates}
    assert "yaw-bias" in names
    assert "mismatch" not in names | {c.name for c in without.result.remaining_candidates}
    assert "mismatch" not in {d.name for d in without.result.detectable}
    assert without.effects
    for effect in without.result.effects:  # each of them competes with the mismatch
        assert (effect.attribution, effect.not_excluded[-1]) == ("ambiguous", "mismatch")
    assert (
        "Left out of the search (exclude): a thrust mismatch of the left and right thrusters. If the data contain this "
        "effect, other effects or the disturbance forces stand for it." in without.answer
    )
    folder = without.save(tmp_path / "without")
    assert st.load(folder).result.excluded_effects == ("mismatch",)
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert 'Left out of the search (<span class="option">--exclude</span>)' in text


def test_a_model_is_fitted_again_without_one_effect(
    logs: list[Path], fit: st.FittedVehicle, with_mismatch: st.FittedVehicle
) -> None:
    """The page on the own boat tells to fit the other effects."""
    both = st.fit(logs[1], effects=["lever-arm", "mismatch"], **LIKELIHOOD)
    assert set(both.params) - set(with_mismatch.params) == {"l_x", "l_y"}
    assert set(with_mismatch.params) - set(fit.params) == {"eps_LR"}
    with pytest.raises(
        SeatrialError, match=r"^exclude mismatch: the model to diagnose contains this effect, and a diagnosis removes "
    ):
        st.diagnose(with_mismatch, logs[0], exclude=["wind", "mismatch"])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("mismach", "there is no effect of this name; did you mean 'mismatch'"),
        ("qqqqqqqq", "there is no effect of this name; the effects are accelerometer-scale, "),
        ("psi(n_diff)", "this is a curve that is fitted without a formula, and curves cannot be left out"),
    ],
)
def test_an_unknown_excluded_effect_is_refused(
    name: str, message: str, logs: list[Path], fit: st.FittedVehicle
) -> None:
    with pytest.raises(SeatrialError, match=f"^exclude {re.escape(name)}: {message}"):
        st.diagnose(fit, logs[0], exclude=name)


def test_comparison_prefers_the_model_with_the_effect(
    logs: list[Path],
    fit: st.FittedVehicle,
    found: st.FittedDiagnosis,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    compared = st.compare({"nominal": fit, "mismatch": found}, logs[2])
    nominal, better = compared.result.models
    assert better.n_free == nominal.n_free + 1
    (turn,) = (row for row in compared.result.channels if (row.kind, row.channel) == ("horizon", "r"))
    assert turn.errors[1].rms < 0.6 * turn.errors[0].rms
    assert better.score is not None
    assert (better.score.verdict, better.score.held_out) == ("better", True)
    assert (nominal.changes, nominal.score) == ((), None)
    assert compared.best == "mismatch"
    assert set(compared.to_pandas()["model"]) == {"nominal", "mismatch"}
    predictions = compared.predictions()
    seconds = compared.result.horizons[0]
    assert list(predictions) == ["nominal", "mismatch"]
    assert list(predictions["nominal"]) == [seconds, "simulation"]
    for k, name in enumerate(predictions):
        rate = predictions[name][seconds]["run3"]["r"]
        # The errors of the table are those of the samples that both models predict, which are all of the curve here.
        assert rate.rms == pytest.approx(turn.errors[k].rms, rel=1e-6)
        heading = predictions[name]["simulation"]["run3"]["psi"]
        assert np.abs(heading.measured - heading.predicted).max() <= np.pi
        assert np.isfinite(heading.sd).all()
        # So are those of the simulation: the samples that the filter has seen before it are in neither of them.
        for row in compared.result.channels:
            if row.kind == "simulation":
                simulated = predictions[name]["simulation"]["run3"][row.channel]
                assert simulated.t[0] > 15.0
                assert simulated.rms == pytest.approx(row.errors[k].rms, rel=1e-6)
    table = predictions.to_pandas()
    assert [*table.columns] == [
        *["record", "model", "kind", "horizon", "channel", "t", "measured", "predicted", "sd", "unit"]
    ]
    assert set(table["kind"]) == {"horizon", "simulation"}
    (rows,) = (len(x) for key, x in table.groupby(["model", "kind", "channel"]) if key == ("mismatch", "horizon", "r"))
    assert rows == predictions["mismatch"][seconds]["run3"]["r"].t.size
    assert better.no_criteria == "not all models were fitted to exactly these logs"
    # On the log of the fit the summary says that the errors are too small.
    own = st.compare(fit, found, logs[0])
    assert "(a) and (b) were fitted to run1" in own.summary()
    assert "No AIC, BIC or likelihood ratio: a model was fitted with REML" in " ".join(own.summary().split())
    (turn,) = (row for row in own.result.channels if (row.kind, row.channel) == ("horizon", "r"))
    assert turn.errors[0].rms == pytest.approx(fit.predict(on="estimation")["run1"]["r"].rms, rel=0.05)
    assert own.result.models[1].score is not None
    assert not own.result.models[1].score.held_out
    paths = [x.save(tmp_path / name) for x, name in ((fit, "a"), (found, "b"))]  # The command finds model.toml there.
    run("ident", "compare", *paths, "--on", logs[2], "--out", tmp_path / "out")
    printed = capsys.readouterr().out
    assert "RMS error and fit: 10 s ahead" in printed
    by_command = read_result(tmp_path / "out/result.json")
    assert [[e.rms for e in row.errors] for row in by_command.channels] == [
        pytest.approx([e.rms for e in row.errors], rel=1e-6) for row in compared.result.channels
    ]


def test_nested_fits_to_the_same_log_have_information_criteria(
    logs: list[Path], with_mismatch: st.FittedVehicle
) -> None:
    plain, with_effect = st.fit(logs[0], **LIKELIHOOD), with_mismatch
    assert (plain.result.effect_parameters, with_effect.result.effect_parameters) == ((), ("eps_LR",))
    names = [line.split()[0] for line in with_effect.summary().splitlines() if "estimated" in line.split()]
    assert names[0] == "eps_LR"
    (_, row) = st.compare([plain, with_effect], logs[0]).result.models
    assert row.criteria is not None
    gain = with_effect.log_likelihood - plain.log_likelihood
    assert row.criteria.gain == pytest.approx(gain, abs=0.5)
    assert row.criteria.parameters == 1
    assert row.criteria.aic == pytest.approx(2 - 2 * row.criteria.gain)
    assert with_effect.aic - plain.aic == pytest.approx(2 - 2 * gain)
    assert row.criteria.bic < row.criteria.aic + 10.0
    assert row.criteria.p is not None
    assert row.criteria.p < 1e-6
    (_, back) = st.compare([with_effect, plain], logs[0]).result.models
    assert back.criteria is not None
    assert back.criteria.aic == pytest.approx(-row.criteria.aic)
    assert back.criteria.p is None  # The larger model is not nested in the smaller one.


@pytest.mark.pages
def test_the_page_runs_as_written(page: Page) -> None:
    assert len(BLOCKS) == 9
    assert "better: with effects" in page.printed or "better: nominal" in page.printed
    assert "<Log other.mcap: 59.9 s, 4 signals" in page.printed
    assert "scale: measured" in page.printed
    assert (page.folder / "next.toml").exists()
    names = {"model.toml", "result.json", "result.parquet", "report.html"}
    tables = {"steady.csv", "lookup.csv", "ardupilot.param"}
    assert {p.name for p in (page.folder / "thruster").iterdir()} == names | tables
    assert {p.name for p in (page.folder / "vehicle").iterdir()} == names


@pytest.mark.parametrize(
    ("options", "request_type"),
    [
        (st.FitOptions, VehicleRequest),
        (st.DiagnosisOptions, DiagnosisRequest),
        (st.ThrusterOptions, ThrusterRequest),
        (st.DesignOptions, DesignRequest),
    ],
)
def test_the_help_of_options_states_their_defaults(options: type, request_type: Any) -> None:
    """A default of a switch, number or text of the computation stands in the entry of the option."""
    entries = re.split(r"\n *(?=\w+ : )", inspect.getdoc(options) or "")[1:]
    words = {entry.partition(" : ")[0]: " ".join(entry.split()) for entry in entries}
    assert list(words) == list(options.__annotations__)
    of_request = {f.name: f.default for f in fields(request_type) + fields(EstimationOptions)}
    of_request |= {"reml": True, "mean_order": 2}  # of a fit in Python and by the commands
    for name, default in of_request.items():
        if name in words and isinstance(default, bool | int | float | str) and default not in ("", np.inf):
            text = f"{default:g}" if isinstance(default, float) else str(default)
            assert re.search(rf"\b{text}\b.*default|default.*\b{text}\b", words[name]), name


def test_options_with_another_name_in_python_are_in_the_reference() -> None:
    page = (ROOT / "docs/reference.md").read_text(encoding="utf-8")
    table = page.partition("## Options with another name on the command line")[2].partition("## Results")[0]
    rows = {tuple(x.strip(" `") for x in line.split("|")[1:3]) for line in table.splitlines() if line.startswith("| `")}
    assert {
        ("--robust", "outlier_model"), ("--fix", "fixed"), ("--on", "logs"), ("--to", "format"), ("--out", "folder"),
        ("--thruster", "name"), ("--second-order", "mean_order=2"), ("--filter", "smoothed=False"),
        ("--effects", "effects_file"), ("--from", "st.open_log(log, start=)"), ("--out", ".save(folder)"),
    } <= rows  # fmt: skip
    assert not {option for option, _ in rows} & {"--horizon", "--mass", "--max-effects", "--validate", "--output"}


def test_the_reference_is_up_to_date() -> None:
    spec = importlib.util.spec_from_file_location("reference", ROOT / "docs/site/reference.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    page = (ROOT / "docs/reference.md").read_text(encoding="utf-8")
    assert page == module.page(), "run python docs/site/reference.py"
    assert all(re.search(rf"^### (st\.)?{name}$", page, re.MULTILINE) for name in st.__all__)


def test_navigate_returns_and_saves_the_states(drifted: st.Navigated, tmp_path: Path) -> None:
    done = drifted
    states = done.states["run3"]
    assert set(states) > {"t", "x", "y", "psi", "u", "v", "r", "sd_x", "gnss"}
    inside = (states["t"] > 40.0) & (states["t"] < 50.0)
    assert states["sd_x"][inside].max() > 2 * np.median(states["sd_x"])
    frame = done.to_pandas()
    assert set(frame["log"]) == {"run3"}
    assert len(frame) == states["t"].size
    done.save(tmp_path / "out")
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "run3.csv",
        "result.json",
        "result.parquet",
        "report.html",
    }
    assert "30" in done.answer or "20" in done.answer
    assert repr(done).startswith("<Navigated: run3>")
    saved = st.load(tmp_path / "out")
    assert saved.to_pandas().equals(frame)
    assert "GNSS outages" in saved.summary()
    assert "<td>run3</td>" in saved._repr_html_()
    assert st.load(tmp_path / "out/result.json").to_pandas().equals(frame)
    (tmp_path / "out/run3.csv").unlink()
    with pytest.raises(SeatrialError, match=r"run3\.csv: is missing, and the table of this result is in it"):
        saved.to_pandas()


def test_a_log_is_a_mapping_of_its_signals(logs: list[Path], fit: st.FittedVehicle) -> None:
    log = st.open_log(logs[0])
    assert list(log) == list(log.keys()) == list(log.signals)
    assert len(log) == len(log.signals) > 3
    assert ("psi" in log, "heading" in log, 0 in log) == (True, False, False)
    assert dict(log.items())["psi"] is log["psi"]
    assert log.get("heading") is None
    with pytest.raises(KeyError, match="no signal 0; it has "):
        log[0]  # type: ignore[index]
    assert st.check(log) == st.check(logs[0])  # and still one log, not a sequence of paths
    with pytest.raises(SeatrialError, match="is a log, not a model"):
        st.compare(log, fit)
    with pytest.raises(SeatrialError, match="inputs: give a dict"):
        st.simulate(fit, [0.0, 1.0], log)


def test_navigation_of_a_log_of_the_fit_gives_a_warning(
    logs: list[Path],
    fit: st.FittedVehicle,
    navigated: st.Navigated,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.warns(SeatrialWarning, match=r"the model was fitted to run1: these data are counted twice"):
        done = st.navigate(fit, [logs[0], logs[2]], smoothed=False)
    assert [w.code for w in done.result.warnings if w.code == "navigated-fitted-log"] == ["navigated-fitted-log"]
    with pytest.warns(SeatrialWarning, match="the model was fitted to run1"):  # a part of the log has no hash
        st.navigate(fit, st.open_log(logs[0], 20.0, 60.0), smoothed=False)
    assert not [w for w in navigated.warnings if "counted twice" in w]
    model = fit.save(tmp_path / "vehicle") / "model.toml"
    capsys.readouterr()
    run("ident", "navigate", model, logs[0], "--out", tmp_path / "out")
    assert "these data are counted twice" in " ".join("".join(capsys.readouterr()).split())
    assert "these data are counted twice" in (tmp_path / "out/report.html").read_text(encoding="utf-8")


def test_the_command_of_a_result_repeats_the_run(
    logs: list[Path], fit: st.FittedVehicle, found: st.FittedDiagnosis, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It has every argument that is not the default; a fitted model is the call that fitted it."""
    made = fit.result.command
    assert made.startswith("seatrial.fit(['run1.mcap'], validate=['run2.mcap'], ")
    assert "priors={'c1': (40.0, 2.0)}" in made
    assert "fixed={'c2': 1.1}" in made
    assert "model=" not in made
    assert found.result.command == f"seatrial.diagnose({made}, ['run1.mcap'], validate=['run2.mcap'], max_effects=1)"
    saved = st.load(fit.save(tmp_path / "vehicle"))
    part = st.open_log(logs[2], start=np.float64(20.0))
    done = st.navigate(saved, part, gnss_outages=(30, np.int64(50)), smoothed=False)
    assert done.result.command == (
        f"seatrial.navigate(seatrial.load({str(tmp_path / 'vehicle')!r}), "
        "[seatrial.open_log('run3.mcap', start=20.0)], gnss_outages=((30.0, 50.0),), smoothed=False)"
    )
    compared = st.compare({"a": tmp_path / "vehicle", "b": found}, logs[2], horizon=[5.0])
    assert compared.result.command == (
        f"seatrial.compare({{'a': {str(tmp_path / 'vehicle')!r}, 'b': {found.result.command}}}, logs=['run3.mcap'], "
        "horizon=[5.0])"
    )
    monkeypatch.chdir(logs[0].parent)
    again = eval(made, {"seatrial": st})
    assert again.params == fit.params
    assert again.result.command == made
    repeated = eval(done.result.command, {"seatrial": st})
    assert repeated.files["run3.csv"] == done.files["run3.csv"]


@pytest.mark.parametrize(
    ("value", "code"),
    [
        (np.array([1.0, 2.0]), "[1.0, 2.0]"),
        ({"c1": np.float64(6.5)}, "{'c1': 6.5}"),
        ((3.0,), "(3.0,)"),
        (["a", Path("b")], "['a', 'b']"),
        (None, "None"),
        (object, "<class 'object'>"),
    ],
)
def test_the_value_of_an_argument_is_code(value: Any, code: str) -> None:
    assert as_code(value) == code


def test_many_logs_are_shown_by_their_number() -> None:
    call = python_call(st.fit_many, {"logs": [f"{k}.mcap" for k in range(21)], "out": None, "mass": 3.0})
    assert call == "seatrial.fit_many([21 logs], mass=3.0)"


def test_one_pair_is_one_gnss_outage(logs: list[Path], fit: st.FittedVehicle, drifted: st.Navigated) -> None:
    expected = [(o.start, o.withheld) for o in drifted.result.outages]
    for outages in ((30.0, 50.0), np.array([[30, 50]])):
        done = st.navigate(fit, logs[2], gnss_outages=outages, smoothed=False)
        assert [(o.start, o.withheld) for o in done.result.outages] == expected
    assert any(withheld for _, withheld in expected)


def test_texts_of_results_and_checks_have_no_options_of_the_command_line(
    logs: list[Path], fit: st.FittedVehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A flag of an estimate, an answer and the advice of a check may name options, which are arguments in Python."""
    flag: dict[str, Any] = {"flag": "at its bound. Fix it (--fix d_rr=0)", "flag_codes": ("at bound",)}
    rows = [structs.replace(p, **flag) for p in fit.result.fit.parameters]
    result = structs.replace(fit.result, fit=structs.replace(fit.result.fit, parameters=tuple(rows)))
    result = structs.replace(result, answer="The mass is uncertain: give it (--fix e_psi=VALUE) or --prior m_u=30:2.")
    told = replace(fit, result=result)
    text = " ".join(told.summary().split())
    assert "Fix it (fixed={'d_rr': 0})" in text
    assert "give it (fixed={'e_psi': VALUE}) or priors={'m_u': (30, 2)}." in text
    assert "--fix" not in text
    assert set(told.to_pandas()["flag"]) == {"at bound"}
    assert "estimated, at bound" in text
    assert set(told.to_pandas()["origin"]) == {f"{p.origin}, at bound" for p in rows}
    assert "at bound" not in fit.summary()
    assert "--fix" not in text_of(result)
    assert with_texts_in_python(result).residuals is result.residuals  # what has no option is not copied
    advice = "the heading is 0.02 rad off: --fix e_psi=0.02"
    told_by = [Finding("warning", "code", "heading", "run1", "it is off", advice)]
    monkeypatch.setattr("seatrial.bench.preflight.log_findings.log_findings", lambda *_: told_by)
    (found,) = st.check(logs[0])
    assert found.advice == "the heading is 0.02 rad off: fixed={'e_psi': 0.02}"


def test_a_log_that_exists_is_named_with_the_arguments_of_the_import(table: Path, tmp_path: Path) -> None:
    st.import_log(table, out_dir=tmp_path)
    with pytest.raises(SeatrialError, match=r"; force=True replaces it, out_dir names another$"):
        st.import_log(table, out_dir=tmp_path)


def test_a_file_without_a_recognised_signal_gives_an_error_about_this_file(tmp_path: Path) -> None:
    file = tmp_path / "junk.csv"
    file.write_text("aa,bb\n" + "".join(f"{k},{k * k}\n" for k in range(20)), encoding="utf-8")
    with pytest.raises(SeatrialError) as raised:
        st.import_log(file, out_dir=tmp_path)
    text = str(raised.value)
    assert text.startswith(f"{file}: no signal was recognised in ")
    assert f"write a map with st.guess_map('{file}', 'map.toml')" in text
    assert "give it as map_path" in text
    assert "junk.toml" not in text


BOAT: Any = {
    "geometry": {
        "y_left": -0.3,
        "y_right": 0.3,
        "x_thrusters": -0.6,
        "mass": 30,
        "lever_arm_m": (0.1, 0, 0),
        "lever_arm_sd": 0.02,
    },
    "scale": {"c1": np.float32(40.0), "c1_sd": 1.0, "c2": 5.0},
}
PULLED = {"c1": 78.5, "c2": 17.5, "c1_sd": 2.5, "c2_sd": 2.5}
NUMBERS = {
    "y_left": -0.3,
    "y_right": 0.3,
    "x_thrusters": -0.6,
    "mass": 30.0,
    "antenna_x": 0.1,
    "lever_arm_sd": 0.02,
    "c1": 40.0,
    "c1_sd": 1.0,
    "c2": 5.0,
}


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")
def test_numbers_of_the_boat_are_given_in_python_for_a_guessed_and_for_a_given_map(table: Path, tmp_path: Path) -> None:
    written, lighter = tmp_path / "map.toml", {"geometry": {"mass": 28.0}}
    text = st.guess_map(table, written, **BOAT)
    assert "What no file has" not in text
    assert NUMBERS.items() <= dict(parse_import_map(text, written).vehicle).items()
    for given, map_path, mass in ((BOAT, None, 30.0), (lighter, written, 28.0)):
        (log,) = st.import_log(table, map_path, out_dir=tmp_path, force=True, **given)
        assert load_run(log, "log").hull() == {"mass": mass}
    assert "mass = 30" in written.read_text(encoding="utf-8")


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")
def test_bollard_pull_ahead_and_astern_gives_both_coefficients_of_thrust(table: Path, tmp_path: Path) -> None:
    written = tmp_path / "map.toml"
    pull = {"ahead": 96.0, "astern": 61.0, "ahead_sd": 3.0, "astern_sd": 4.0}
    assert parse_import_map(st.guess_map(table, scale=pull), written).vehicle == PULLED
    assert parse_import_map(st.guess_map(table, scale={"ahead": 96.0}), written).vehicle == {"ahead": 96.0}
    st.guess_map(table, written, **BOAT)
    (log,) = st.import_log(table, written, out_dir=tmp_path, scale=pull)  # in place of c1 and c2 of the map
    assert load_run(log, "log").vehicle == NUMBERS | {"antenna_y": 0.0, "antenna_z": 0.0} | PULLED


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"geometry": {"y_lft": -0.3}}, "geometry.y_lft: unknown key 'y_lft'; did you mean 'y_left'?"),
        ({"scale": {"c1": -3}}, "scale.c1: must be positive, not -3"),
        ({"scale": {"c1": "forty"}}, "c1 in [scale]: must be a number or numbers, not 'forty'"),
        ({"full_speed": {"n_lft": 2900}}, "n_lft: no signal whose full speed is guessed"),
        ({"full_speed": 272.27}, "full_speed, 272.27: give the number of each signal, such as full_speed={'n_left'"),
        ({"full_speed": {"n_left": 0}}, "full_speed of n_left, 0: give the number at full speed ahead, above zero"),
    ],
)
@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")
def test_a_wrong_number_of_the_boat_is_one_line(table: Path, tmp_path: Path, wrong: Any, message: str) -> None:
    with pytest.raises(SeatrialError, match=re.escape(message)):
        st.guess_map(table, **wrong)
    with pytest.raises(SeatrialError, match=re.escape(message)):
        st.import_log(table, out_dir=tmp_path / "none", **wrong)
    assert not (tmp_path / "none").exists()
    assert not list(tmp_path.glob("*.mcap"))


def test_a_number_at_full_speed_takes_the_place_of_a_guess(tmp_path: Path) -> None:
    file = tmp_path / "shafts.csv"
    rows = [f"{0.1 * k:.1f},{k % 50},{0.1 * (k % 7):.2f},{20 * (k % 60)},{20 * (k % 60)}" for k in range(300)]
    file.write_text("\n".join(["t,heading,gyro_z,rpm_left,rpm_right", *rows]), encoding="utf-8")
    guessed = st.guess_map(file)
    assert "scale: inferred, 1 / 1180" in guessed
    known = st.guess_map(file, full_speed={"n_left": 2000.0, "n_right": 2000.0})
    assert known.count("scale = 0.0005,") == 2
    assert "scale: inferred" not in known
    assert "scale: given, 1 / " in known
    assert "is assumed to be full forward" not in known
    assert "times the given" not in known
    of_other_unit = st.guess_map(file, full_speed={"n_left": 11000.0, "n_right": 2000.0})
    assert "n_left: the largest number is 1180, 0.11 times the given 11000; give it in the unit of the" in of_other_unit
    assert "n_right: the largest number" not in of_other_unit


def test_the_warning_of_an_import_separates_what_was_given_from_what_was_inferred(tmp_path: Path) -> None:
    file = tmp_path / "shafts.csv"
    rows = [f"{0.1 * k:.1f},{k % 50},{0.1 * (k % 7):.2f},{20 * (k % 60)},{20 * (k % 60)}" for k in range(300)]
    file.write_text("\n".join(["t,heading,gyro_z,rpm_left,rpm_right", *rows]), encoding="utf-8")
    given = {"geometry": {"y_left": -0.3, "y_right": 0.3}, "full_speed": {"n_left": 2000.0}}
    with pytest.warns(SeatrialWarning) as issued:
        st.import_log(file, out_dir=tmp_path, **given)
    (text,) = (str(w.message) for w in issued if "inferred" in str(w.message))
    inferred, _, rest = text.partition("; as given: ")
    assert "its greatest number, 1180, is assumed to be full forward" in inferred
    assert "2000" not in inferred
    assert rest.startswith(
        "geometry (y_left, y_right), full_speed (n_left); if it is wrong, correct the map of st.guess_"
    )


def test_a_guessed_map_is_written_corrected_and_used(table: Path, tmp_path: Path) -> None:
    written = tmp_path / "map.toml"
    text = st.guess_map(table, written)
    assert written.read_text(encoding="utf-8") == text == st.guess_map([table])
    assert text.startswith("# ")
    assert st.guess_map(table, written) == text  # as when a notebook cell runs again
    corrected = f"{text}# corrected\n"
    written.write_text(corrected, encoding="utf-8")
    with pytest.raises(SeatrialError, match=r"exists already; force=True replaces it, path names another$"):
        st.guess_map(table, written)
    assert written.read_text(encoding="utf-8") == corrected
    assert st.guess_map(table, written, force=True) == text == written.read_text(encoding="utf-8")
    with warnings.catch_warnings():
        warnings.simplefilter("error", SeatrialWarning)  # a given map is no guess
        (log,) = st.import_log(table, map_path=written, out_dir=tmp_path)
    assert "psi" in st.open_log(log)


def test_an_error_of_a_guessed_map_names_the_file(table: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The guessed map is a temporary file, which the user cannot open."""

    def fails(map_path: Path, *_: Any, **__: Any) -> None:
        raise SeatrialError(f"{map_path}: signal[1]: unknown")

    monkeypatch.setattr("seatrial.daq.importers.import_files.import_files", fails)
    with pytest.raises(SeatrialError, match=rf"^guessed map of {table}: signal\[1\]: unknown$"):
        st.import_log(table, out_dir=tmp_path)


def test_files_with_the_same_caveats_give_one_warning_with_a_call_that_runs(tmp_path: Path) -> None:
    folder, t = tmp_path / "my runs", np.arange(0.0, 20.0, 0.1)
    folder.mkdir()
    files = [folder / "lake_1.csv", folder / "lake_2.csv"]
    for file, top in zip(files, (400.0, 900.0), strict=True):
        table = np.column_stack([t, np.cos(t), top * np.sin(t), top * np.cos(t), t**2])
        np.savetxt(file, table, delimiter=",", header="t,yaw,rpm_port,rpm_stbd,mystery", comments="")
    with pytest.warns(SeatrialWarning) as issued:
        st.import_log(files, out_dir=tmp_path / "logs")
    texts = [str(w.message) for w in issued]
    guess = [x for x in texts if "this was inferred from the data" in x]
    left_out = [x for x in texts if "not recognised and left out: mystery" in x]
    assert (len(guess), len(left_out), len(texts)) == (1, 1, 2)
    for text in texts:
        assert text.startswith("lake_1.csv, lake_2.csv: ")
        call = f"st.guess_map({[str(file) for file in files]!r}, 'map.toml')"
        assert f" the map of {call} and give it as map_path" in text
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        eval(call, {"st": st})
    assert len(st.import_log(files, tmp_path / "map.toml", out_dir=tmp_path / "again")) == 2


@pytest.mark.parametrize(
    ("outages", "message"),
    [
        (60.0, "gnss_outages 60.0: give pairs (from, to) in s, such as gnss_outages=[(60.0, 90.0)]"),
        ("60:90", "gnss_outages '60:90': give pairs"),
        ({30.0: 50.0}, "gnss_outages {30.0: 50.0}: give pairs"),
        (None, "gnss_outages None: give pairs"),
        (np.array(3.0), "gnss_outages array(3.): give pairs"),
        ([30.0, 50.0, 60.0], "gnss_outages 30.0: is no pair of numbers; give pairs"),
        ([(30.0, 50.0), 60.0], "gnss_outages 60.0: is no pair of numbers"),
        ([(30.0, "50")], "gnss_outages (30.0, '50'): is no pair of numbers"),
        ([(30.0, 50.0, 60.0)], "gnss_outages (30.0, 50.0, 60.0): is no pair of numbers"),
        ((50.0, 30.0), "gnss_outages (50, 30): the end is not a time after the beginning"),
        ([(30.0, np.nan)], "gnss_outages (30, nan): the end is not a time after the beginning"),
        ((30.0, np.inf), "gnss_outages (30, inf): the end is not a time after the beginning"),
        ((500.0, 600.0), "give an interval in this time to gnss_outages"),
    ],
)
def test_a_malformed_gnss_outage_gives_a_one_line_error(
    logs: list[Path], fit: st.FittedVehicle, outages: Any, message: str
) -> None:
    with pytest.raises(SeatrialError) as raised:
        st.navigate(fit, logs[2], gnss_outages=outages)
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda logs, fit: st.fit("missing.mcap"), "missing.mcap: no such file or folder"),
        (lambda logs, fit: st.fit([]), "no log was given"),
        (
            lambda logs, fit: st.fit(logs[0], despite=True),
            "there is no option 'despite'; did you mean 'despite_faults'?",
        ),
        (
            lambda logs, fit: st.compare([fit, fit], logs[0], horizons=5.0),
            "compare has no argument 'horizons'; did you mean 'horizon'?",
        ),
        (
            lambda logs, fit: st.open_log(logs[0], begin=5.0),
            "open_log has no argument 'begin'; the names are path, start",
        ),
        (lambda logs, fit: st.fit(logs[0], window=(0.0, 60.0)), "there is no option 'window'; the options are"),
        (
            lambda logs, fit: st.fit(logs[0], common_errors=False),
            "there is no option 'common_errors'; did you mean 'sc",
        ),
        (lambda logs, fit: st.fit(logs[0], effects="skeg"), "effects skeg: there is no such effect"),
        (lambda logs, fit: st.fit(logs[0], effects="skeg.py"), "effects skeg.py: takes the name of an effect"),
        (
            lambda logs, fit: st.fit(logs[0], effects=["wind", catalogue()["mismatch"]]),
            "effects mismatch: takes the name of an effect; give the file that defines an effect of your own",
        ),
        (lambda logs, fit: st.fit(logs[0], fixed={"c7": 1.0}), "fixed c7"),
        (lambda logs, fit: st.fit(logs[0], priors={"m_u": 30.0}), "priors: m_u: give a pair of mean and standard"),
        (
            lambda logs, fit: st.fit(logs[0], fixed=["c1=6.85"]),
            """fixed: give a dict, such as {"c1": 6.85}, not ['c1=6.85']""",
        ),
        (lambda logs, fit: st.fit(logs[0], initial="m_u=30"), 'initial: give a dict, such as {"m_u": 30.0}, not'),
        (lambda logs, fit: st.fit(logs[0], priors=["c1"]), 'priors: give a dict, such as {"c1": (6.85, 0.3)}, not'),
        (lambda logs, fit: st.fit(logs[0], fixed={"c1": "6.85"}), "fixed: c1: '6.85' is no number; give a dict, such"),
        (lambda logs, fit: st.fit(logs[0], priors={"c1": (6.85, "a")}), "priors: c1: (6.85, 'a') is no number"),
        (lambda logs, fit: st.fit(logs[0], priors={"c1": (np.nan, 1.0)}), "priors: c1: (nan, 1.0) is not finite; give"),
        (lambda logs, fit: st.fit(logs[0], fixed={"c1": np.nan}), "fixed: c1: nan is not finite; give finite numbers"),
        (lambda logs, fit: st.fit(logs[0], model=3), "model: 3 is no name of a model; give a name, such as 'horizont"),
        (lambda logs, fit: st.fit_many(logs, model=None), "model: None is no name of a model; give a name, such as"),
        (lambda logs, fit: st.fit(logs[0], score_tests="no"), "score_tests 'no': give True or False"),
        (lambda logs, fit: st.fit(logs[0], progress=1), "progress 1: give True or False"),
        (lambda logs, fit: st.diagnose(fit, logs[0], despite_faults="yes"), "despite_faults 'yes': give True or False"),
        (
            lambda logs, fit: st.fit_many(logs, jobs=0),
            "jobs 0: give a number of processes, or -1 for one for each core",
        ),
        (lambda logs, fit: st.fit_many(logs, jobs="2"), "jobs '2': give a number of processes, or -1 for one for each"),
        (
            lambda logs, fit: st.export(fit, "boat.txt", "ros2"),
            "boat.txt: is not the name of a folder, nor of a file with the ending .yaml of this format",
        ),
        (lambda logs, fit: st.fit(logs[0], rate=1000), "rate 1000: give a number from 1 to 200, in Hz"),
        (lambda logs, fit: st.diagnose(fit, logs[0], rate=0.5), "rate 0.5: give a number from 1 to 200, in Hz"),
        (lambda logs, fit: st.navigate(fit, logs[0], rate="10"), "rate '10': give a number from 1 to 200, in Hz"),
        (
            lambda logs, fit: st.fit(pandas_table()),
            "DataFrame: this is not a log; give the path of a log or the result of st.open_log; write a table to a "
            "file first, such as run.csv, and import it with st.import_log",
        ),
        (lambda logs, fit: st.check(pandas_table()), "DataFrame: this is not a log"),
        (lambda logs, fit: st.open_log(pandas_table()), "DataFrame: this is not a log"),
        (lambda logs, fit: st.open_log({"t": [0.0]}), "dict: this is not a log; give the path of a log or the"),
        (lambda logs, fit: st.fit(logs[0], validate=pandas_table()), "DataFrame: this is not a log"),
        (
            lambda logs, fit: st.load(csv_in(logs[0].parent)),
            "is neither a model.toml nor a result.json; it seems to be",
        ),
        (lambda logs, fit: st.load(3), "int: this is no path; give the path of a model.toml, of a result.json, or of"),
        (lambda logs, fit: st.fit(logs[0], horizon=-5.0), "horizon -5: give a time above zero"),
        (lambda logs, fit: st.fit(logs[0], validation=logs[1]), "no option 'validation'; did you mean 'validate'?"),
        (lambda logs, fit: st.simulate(fit, {"n_left": [0.5]}, [0.0, 1.0]), "times: give numbers"),
        (lambda logs, fit: st.fit(logs[0], model="boat"), "boat"),
        (lambda logs, fit: st.fit(logs[0], validate=logs[0]), "for the fit and for the validation"),
        (
            lambda logs, fit: st.fit(logs[0], validate=st.open_log(logs[1], 5.0)),
            "validation logs are always used as a whole",
        ),
        (lambda logs, fit: st.diagnose("nowhere", logs[0]), "nowhere: no such file"),
        (
            lambda logs, fit: st.open_log(bag_in(logs[0].parent)),
            "bag is a bag of ROS 2; import it first with `st.import_log('",
        ),
        (
            lambda logs, fit: st.fit(bag_in(logs[0].parent)),
            "bag is a bag of ROS 2; import it first with `st.import_log('",
        ),
        (
            lambda logs, fit: st.check(bag_in(logs[0].parent)),
            "bag is a bag of ROS 2; import it first with `st.import_log('",
        ),
        (
            lambda logs, fit: st.fit(logs[0].parent),
            "is a folder of 3 logs: name one of run1.mcap, run2.mcap, run3.mcap",
        ),
        (lambda logs, fit: st.fit(model_in(logs[0].parent)), "is the folder of a model or a result, not a log; give"),
        (lambda logs, fit: st.fit(fit), "FittedVehicle: this is not a log; give the path of a log or the result of"),
        (lambda logs, fit: st.diagnose(logs[0], fit), "run1.mcap: is a log, not a model; the model is the first"),
        (lambda logs, fit: st.diagnose(st.open_log(logs[0]), fit), "run1.mcap: is a log, not a model; the model is"),
        (lambda logs, fit: st.navigate(logs[0], fit), "FittedVehicle: this is not a log; give the path of a log"),
        (lambda logs, fit: st.diagnose(3, logs[0]), "int: this is not a model; give a model.toml, a folder with one"),
        (lambda logs, fit: st.export(logs[0], "out", "c"), "run1.mcap: is a log, not a model; the model is the first"),
        (lambda logs, fit: st.open_log(logs[0], 100.0, 90.0), "end 90 s is not after start 100 s; give a later end"),
        (lambda logs, fit: st.open_log(logs[0], 50.0001, 50.0002), "there is no sample from 50.0001 s to 50.0002 s"),
        (
            lambda logs, fit: st.simulate(fit, np.arange(100) / 10, np.zeros((100, 2))),
            "inputs: give a dict with the values of each input by name, such as {'n_left': 0.5 + 0 * t, 'n_right': 0.5",
        ),
        (
            lambda logs, fit: st.simulate(fit, [0, 1, 2], {"n_left": [1, np.nan, 1], "n_right": [1, 1, 1]}),
            "input n_left: 1 of 3 samples are not finite numbers",
        ),
        (
            lambda logs, fit: st.simulate(fit, [2, 1, 0], {"n_left": [1, 1, 1], "n_right": [1, 1, 1]}),
            "times: 1 s follows 2 s; the times must increase",
        ),
        (
            lambda logs, fit: st.fit(logs[0], thruster=fit.save(logs[0].parent / "boat")),
            "boat/model.toml: is the model horizontal of a boat, not of a thruster; give thruster the model.toml of",
        ),
        (lambda logs, fit: st.simulate(fit, 3.0, {"n_left": 1.0}), "times: they have the shape (); give a list of two"),
        (lambda logs, fit: st.compare([], logs[2]), "there is no model; give one"),
        (
            lambda logs, fit: st.compare(logs[2], fit),
            "run3.mcap: is a log, not a model; the model is the first argument, and the",
        ),
        (lambda logs, fit: st.load(logs[0]), r"run1.mcap: is a log, not a model or a result; open it with st.open_log"),
        (lambda logs, fit: st.load(logs[0].parent), "contains neither model.toml nor result.json"),
        (lambda logs, fit: st.thruster(logs[0], stroke=2), "there is no option 'stroke'"),
        (lambda logs, fit: st.design("boat", "x.toml"), "boat"),
        (
            lambda logs, fit: st.fit_many(logs, homogeneity="d_uu"),
            "homogeneity: this tests all logs of one fit together",
        ),
        (lambda logs, fit: st.fit(logs, homogeneity="zz", score_tests=False), "homogeneity zz: not a free parameter"),
        (lambda logs, fit: st.design(fit, "x.toml", area=60.0), "area 60.0: give its sides to north and east in m, s"),
        (lambda logs, fit: st.design(fit, "x.toml", prior_halfwidth=1.5), "prior_halfwidth 1.5: give a number from 0"),
        (lambda logs, fit: st.design(fit, "x.toml", max_speed=0), "max_speed 0: give a speed above zero, in m/s"),
        (lambda logs, fit: st.design(fit, "x.toml", energy=2.0), "energy 2.0: give a number from 1e-06 to 1 (full p"),
        (lambda logs, fit: st.design(fit, "x.toml", current="1"), "current '1': give a number from 0 to 2 m/s"),
        (
            lambda logs, fit: st.design(fit, "x.toml", evaluations=100),
            "evaluations 100: give a whole number of at leas",
        ),
        (lambda logs, fit: st.design(fit, "x.toml", steps=1), "steps 1: give a whole number from 2 to 1000"),
        (lambda logs, fit: st.design(fit, "x.toml", criterion="T"), "criterion 'T': choose D, A, E, Ds"),
        (lambda logs, fit: st.design(fit, "x.toml", criterion="Ds"), "criterion Ds needs the parameters to estimate"),
        (
            lambda logs, fit: st.design(fit, "x.toml", between="wind,lag"),
            "between 'wind,lag': give exactly two effects",
        ),
        (lambda logs, fit: st.design(fit, "x.toml", rates=5.0), "rates 5.0: give a dict by sensor, in Hz, such as"),
        (
            lambda logs, fit: st.design(fit, "x.toml", rates={"gyros": "5"}),
            "rates: gyros: '5': give a number above zero",
        ),
        (
            lambda logs, fit: st.export(fit, "x", "simulink"),
            "did you mean 'fmu' (FMI 2.0 co-simulation, for Simulink, O",
        ),
        (lambda logs, fit: st.export(fit, "x", "pyton"), "did you mean 'python'? The formats are python, casadi, c,"),
        (lambda logs, fit: st.export(fit, "x", "c", name=3), "name 3: give a text, the prefix of functions and of the"),
        (
            lambda logs, fit: fit.linearise(0.5, at=3),
            'at: give a dict of conditions by name, such as {"psi": 0.5}, not',
        ),
        (lambda logs, fit: fit.linearise(0.5, at={"psi": "a"}), "at: psi 'a': give a number, in SI units and radians"),
        (lambda logs, fit: fit.steady(points="9"), "points '9': give a whole number of at least 3"),
        (lambda logs, fit: fit.steady(means=0.5), "means: give a list of numbers from 0 to 1, such as [0.0, 0.5], not"),
        (
            lambda logs, fit: fit.linearise(0.5).plot_step(size="1"),
            "size '1': give a number, in the unit of the inputs",
        ),
        (lambda logs, fit: fit.linearise(0.5).eigenvalues, "'Linearisation' object has no attribute 'eigenvalues'"),
        (
            lambda logs, fit: st.simulate(fit, [0, 1], {"n_left": "ab"}),
            "input n_left: 'ab' is no array of numbers; give",
        ),
        (lambda logs, fit: st.open_log(logs[0], 500.0), "no data are left from 500 s on"),
        (lambda logs, fit: st.fit(logs[0], effects="umbilical"), "did you mean towed-line (a line or umbilical that"),
        (lambda logs, fit: st.fit(logs[0], effects="towed"), "did you mean towed-line (a line or"),
        (lambda logs, fit: st.fit(logs[0], horizon="10"), "horizon '10': give a time above zero, in s"),
        (lambda logs, fit: st.fit(logs[0], mass="32.5 kg"), "mass '32.5 kg': give a mass above zero, in kg"),
        (lambda logs, fit: st.compare([fit, logs[1]], logs[0], horizon="3"), "run2.mcap: is a log, not a model"),
        (lambda logs, fit: st.compare([fit, "b"], logs[0], horizon="3"), "horizon '3': give a time above zero, in s"),
        (
            lambda logs, fit: st.diagnose(fit, logs[0], max_effects=0),
            "max_effects 0: give a whole number of at least 1",
        ),
        (lambda logs, fit: st.diagnose(fit, logs[0], max_effects="2"), "max_effects '2': give a whole number of at"),
        (lambda logs, fit: st.open_log(logs[0], start="10"), "start '10': give a number, in s"),
        (lambda logs, fit: st.open_log(logs), "3 logs: st.open_log opens one log; give the path of one"),
        (
            lambda logs, fit: st.import_log(logs[0], map_path=["map.toml"]),
            "map_path: ['map.toml'] is no path; give the",
        ),
        (lambda logs, fit: st.import_log(logs[0], out_dir=["logs"]), "out_dir: ['logs'] is no path; give the path of"),
        (lambda logs, fit: st.export(fit, ["boat"], "c"), "folder: ['boat'] is no path; give the path of one file"),
        (
            lambda logs, fit: st.export(fit, "boat.h", "ros2"),
            "boat.h: is not the name of a folder, nor of a file with the ending .yaml of this format",
        ),
        (
            lambda logs, fit: st.export(fit, "boat", "c", thruster=["left=left/model.toml"]),
            'thruster: give a path, or a dict of them, such as {"left": "left/model.toml"}, not [',
        ),
        (lambda logs, fit: fit.plot().save(["figure.html"]), "path: ['figure.html'] is no path; give the path of one"),
        (lambda logs, fit: fit.save(csv_in(logs[0].parent)), "is a file, and save writes several files to a folder;"),
        (
            lambda logs, fit: st.fit(logs[0], priors={"c1": (32, 0)}),
            "priors: c1: the standard deviation 0 is not above zero; if the value is known, give fixed={'c1': 32}",
        ),
        (
            lambda logs, fit: st.open_log(file_of_ros(logs[0].parent)),
            "of_ros.mcap is a bag of ROS 2; import it first with `st.import_log('",
        ),
        (lambda logs, fit: fit.predict(horizon=-1.0), "horizon -1.0: give a time above zero [s]"),
        (lambda logs, fit: fit.predict(horizon="5"), "horizon '5': give a time above zero [s]"),
        (lambda logs, fit: fit.predict(horizon=500.0), "horizon 500: the longest record lasts "),
        (lambda logs, fit: fit.residuals(on="val"), "on: 'val' names no data; give 'estimation' or 'validation'"),
        (lambda logs, fit: fit.simulate(-3), "on: -3 names no data"),
        (lambda logs, fit: fit.linearise("0.9"), "speed '0.9': give a number, in m/s, such as 0.5"),
        (lambda logs, fit: fit.linearise(0), "speed 0 m/s: give a number other than zero"),
        (
            lambda logs, fit: fit.linearise(0.5).lqr([4, 1, 4]),
            "Q: give the weights of states by name, such as {'u': 4.0",
        ),
        (
            lambda logs, fit: fit.linearise(0.5).lqr({"u": 4.0}, 1.0),
            "R: give the weights of inputs by name, such as {'n_left'",
        ),
    ],
)
def test_wrong_arguments_give_a_one_line_error(
    logs: list[Path], fit: st.FittedVehicle, call: object, message: str
) -> None:
    assert callable(call)
    with pytest.raises(SeatrialError) as raised:
        call(logs, fit)
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    "call",
    [
        lambda a, b, good, model: st.compare_campaigns([a, good], [good, b]),
        lambda a, b, good, model: st.compare(model, [a, good, b]),
        lambda a, b, good, model: st.fit([good, a], validate=b),
        lambda a, b, good, model: st.diagnose(model, [a, b], validate=good),
        lambda a, b, good, model: st.navigate(model, [a, good, b]),
        lambda a, b, good, model: st.thruster([a, b]),
        lambda a, b, good, model: st.check([a, b, good]),
    ],
)
def test_all_files_that_are_no_logs_are_named_before_the_first_is_read(call: Any, tmp_path: Path) -> None:
    a, b, good, model = (tmp_path / name for name in ("a.csv", "b.csv", "good.mcap", "model.toml"))
    for file in (a, b, model):
        file.write_text("t,u\n0,1\n", encoding="utf-8")
    good.write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(SeatrialError) as error:
        call(a, b, good, model)
    files = [str(a), str(b)]
    assert str(error.value) == (
        f"{a}, {b}: not MCAP logs; use `st.import_log` for logs of other formats: `st.guess_map({files!r}, "
        f"'map.toml')`, then `st.import_log({files!r}, 'map.toml')`"
    )


def test_a_file_of_a_ros_bag_is_named_with_the_way_to_import_it(logs: list[Path], tmp_path: Path) -> None:
    (fault,) = st.check(file_of_ros(tmp_path)).faults
    assert (fault.code, fault.text) == ("ros-bag", "it is a bag of ROS 2, not a log")
    assert fault.advice == f"import it with `st.import_log('{tmp_path / 'of_ros/of_ros.mcap'}')`, and check the log"
    (tmp_path / "of_ros/metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 5\n", encoding="utf-8")
    with pytest.raises(SeatrialError, match=rf"import it first with `st\.import_log\('{tmp_path / 'of_ros'}'\)`$"):
        st.fit(tmp_path / "of_ros/of_ros.mcap")
    assert bag_of_ros(logs[0]) is None  # a log has the profile of ROS 2 too


def test_comparison_of_a_model_with_itself_is_rejected() -> None:
    with pytest.raises(SeatrialError, match=r"a\.toml is given twice; give another model to compare it with"):
        st.compare(["a.toml", Path("a.toml")], "run.mcap")
