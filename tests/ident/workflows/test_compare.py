"""Tests of the comparison of models: common samples, verdicts, log score, and criteria only where they hold."""

from __future__ import annotations

import hashlib
import itertools
import json
import re
import shutil
import warnings
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import numpy as np
import pandas.testing
import pyarrow.parquet
import pytest

import seatrial as st
from seatrial import command_line
from seatrial.api.comparison import Comparison
from seatrial.api.messages import text_of
from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.ident.data.loading import LoadedLog, TimeWindow, load_all, load_run
from seatrial.ident.data.record import Channel, LogSegment, build_record, make_record
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.engine import quick_compilation
from seatrial.ident.estimation.fitted_model import evaluate_records, evaluated_in_blocks
from seatrial.ident.estimation.interval_widening import ErrorScale
from seatrial.ident.estimation.model_file import SavedModel, load_model
from seatrial.ident.model.parameter import Parameter, ParameterOrigin
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.nomoto import nomoto_model
from seatrial.ident.models.surge import surge_model
from seatrial.ident.parallel import Workers
from seatrial.ident.report.blocks import Cell
from seatrial.ident.report.formatting import with_error
from seatrial.ident.report.page import render
from seatrial.ident.report.sections.comparison import _best_cell, _error_cells, overlay_panels
from seatrial.ident.report.terminal import SHOWN_NOTES, _best_words, compared_tables
from seatrial.ident.results import (
    OTHER_SURROUNDINGS,
    SIZE_NOT_SIGNIFICANT,
    ComparedError,
    ComparedPair,
    ComparedRatio,
    ComparisonResult,
    CourseStability,
    LogScore,
    VehicleResult,
)
from seatrial.ident.results.parts import CommonErrorsRow
from seatrial.ident.results.result_file import read_result
from seatrial.ident.validation import prediction_errors
from seatrial.ident.validation.prediction_errors import PredictionErrors
from seatrial.ident.workflows import compare
from seatrial.ident.workflows.compare import (
    CompareRequest,
    _limited_warnings,
    block_of_comparison,
    compare_models,
    comparison_answer,
    labels,
    records_of_same_time,
    with_equal_averages,
)
from seatrial.ident.workflows.compared_predictions import ONE_STEP, SIMULATION, Curve, PredictedRecord
from seatrial.ident.workflows.compared_sizes import size_notes
from seatrial.ident.workflows.compared_surroundings import surroundings_notes
from seatrial.ident.workflows.comparison_errors import (
    at_common_samples,
    calibration_at,
    channel_rows,
    concentration_notes,
    limited_samples,
)
from seatrial.ident.workflows.comparison_likelihood import (
    _is_nested,
    _n_estimates,
    log_score,
    used_logs,
    why_not_comparable,
)
from seatrial.ident.workflows.dynamics import course_at_speeds
from seatrial.ident.workflows.model_differences import model_differences
from seatrial.ident.workflows.output import selected_effects
from tests.ident.pages import KINDS, loaded, numbers
from tests.ident.reports import Kept
from tests.missions import boat_log, boat_with

SCORE = LogScore(gain=10.0, low=5.0, high=15.0, blocks=8, verdict="better", held_out=True)
WORSE = "d_rr", 1.4  # a parameter of the model, and the factor that makes it a worse model


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder, boat = tmp_path_factory.mktemp("compare"), boat_with(None, 5)
    return [boat_log(folder / f"run{k}.mcap", boat, s, 100 + k, k) for k, s in ((1, 60.0), (2, 120.0), (3, 60.0))]


@pytest.fixture(scope="module")
def models(logs: list[Path]) -> list[Path]:
    """Return the files of a fitted model and of the same model with a wrong damping."""
    folder = logs[0].parent
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SeatrialWarning)
        fitted = st.fit(logs[0], model="horizontal:shaft", fixed={"c1": 40.0, "c2": 1.1}, score_tests=False)
    good, bad = (folder / name / "model.toml" for name in ("good", "bad"))
    fitted.save(good.parent)
    shutil.copytree(good.parent, bad.parent)
    name, factor = WORSE
    pattern = rf'(name = "{name}"\nvalue = )([-+.e\d]+)'
    text = good.read_text(encoding="utf-8")
    changed, n = re.subn(pattern, lambda m: f"{m.group(1)}{factor * float(m.group(2))}", text)
    assert n == 1
    bad.write_text(changed, encoding="utf-8")
    return [good, bad]


@pytest.fixture(scope="module")
def compared(models: list[Path], logs: list[Path]) -> ComparisonResult:
    """Compare both models on two logs, over two horizons."""
    return compare_models(CompareRequest(models, logs[1:], (2.0, 5.0), names=("good", "bad")), "", Kept())


def run(*words: object, status: int = 0) -> None:
    with pytest.raises(SystemExit) as left:
        command_line.main([str(w) for w in words])
    assert (left.value.code or 0) == status


def errors(t: np.ndarray, e: np.ndarray) -> PredictionErrors:
    return PredictionErrors(t, e, np.cos(t))


def test_masses_are_shown_and_an_implausible_one_is_named(
    models: list[Path], logs: list[Path], compared: ComparisonResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A model that predicts best may have an impossible mass."""
    saved = load_model(models[0])
    for m in compared.models:
        assert [x.name for x in m.masses] == ["m_u", "m_v", "m_r"]
        assert [x.unit for x in m.masses] == ["kg", "kg", "kg m2"]
        for x in m.masses:
            assert (x.value, x.se) == (saved.model.values[x.name], saved.errors[x.name])
    assert compared.weighed_mass is None
    assert not {"mass-implausible", "inertia-too-small"} & {w.code for w in compared.warnings}
    mass = saved.model.values["m_u"]
    assert f"(a) m_u {with_error(mass, saved.errors['m_u'], 'kg')}, m_v " in " ".join(text_of(compared).split())
    assert "Masses of (b): m_u" in render(compared)
    assert Comparison(compared).masses["good"]["m_u"] == (mass, saved.errors["m_u"])
    heavy = tmp_path / "heavy" / "model.toml"
    shutil.copytree(models[0].parent, heavy.parent)
    text = models[0].read_text(encoding="utf-8")
    changed, n = re.subn(r'(name = "m_u"\nvalue = )[-+.e\d]+', rf"\g<1>{9.0 * mass}", text)
    assert n == 1
    heavy.write_text(changed, encoding="utf-8")
    request = CompareRequest([models[0], heavy], logs[2:], (2.0,), names=("good", "heavy"))
    monkeypatch.setattr(LoadedLog, "hull", lambda log: {"mass": mass / 1.2})
    result = compare_models(request, "", Kept())
    assert result.weighed_mass == mass / 1.2
    (warning,) = [w for w in result.warnings if w.code == "mass-implausible"]
    assert warning.text.startswith("(b): The estimated mass in surge, m_u, is ")
    shown = " ".join(text_of(result).split())
    assert f"(11 times the weighed {mass / 1.2:g} kg)" in shown
    assert f"(1.2 times the weighed {mass / 1.2:g} kg)" in shown
    # Without a weighed mass of the compared logs, the warning is that of the fit, if its result belongs to the model.
    monkeypatch.setattr(LoadedLog, "hull", lambda log: {})
    of_fit = heavy.with_name("result.json")
    content = json.loads(of_fit.read_text(encoding="utf-8"))
    content["warnings"] = [{"code": "mass-implausible", "text": "The mass is wrong."}]
    of_fit.write_text(json.dumps(content), encoding="utf-8")
    result = compare_models(request, "", Kept())
    assert [w.text for w in result.warnings if w.code == "mass-implausible"] == ["(b): The mass is wrong."]
    of_fit.write_text(json.dumps(content | {"created": "2020-01-01T00:00:00Z"}), encoding="utf-8")
    assert "mass-implausible" not in {w.code for w in compare_models(request, "", Kept()).warnings}


def test_a_model_that_did_not_converge_is_named_before_it_is_used(
    models: list[Path], logs: list[Path], compared: ComparisonResult, tmp_path: Path
) -> None:
    assert "model-not-converged" not in {w.code for w in compared.warnings}
    failed = tmp_path / "model.toml"
    text = models[0].read_text(encoding="utf-8")
    failed.write_text(text.replace("name =", "converged = false\nname =", 1), encoding="utf-8")
    result = compare_models(CompareRequest([models[0], failed], logs[2:], (2.0,), names=("good", "failed")), "", Kept())
    (warning,) = [w for w in result.warnings if w.code == "model-not-converged"]
    assert warning.text.startswith("the fit of (b) did not converge, so its estimates")
    shown = " ".join(text_of(result).split())
    page = " ".join(render(result).split())
    warned = "the fit of (b) did not converge"
    assert shown.index(result.answer.partition(". ")[0]) < shown.index(warned) < shown.index("Models")
    assert page.count(f'<p class="callout warning">{warned}') == 1
    assert page.index("</h1>") < page.index(warned) < page.index("<table")
    t = np.arange(0.0, 2.0, 0.1)
    inputs = {"n_left": 0.3 + 0 * t, "n_right": 0.3 + 0 * t}
    with pytest.warns(SeatrialWarning, match="the fit of this model did not converge"):
        st.simulate(failed, t, inputs)
    for use in (lambda model: st.linearise(model, 0.5), st.steady):
        with pytest.warns(SeatrialWarning, match="the fit of this model did not converge"):
            use(failed)
    st.simulate(models[0], t, inputs)  # pytest turns a warning into an error


def test_a_comparison_says_what_differs_between_the_models(compared: ComparisonResult, models: list[Path]) -> None:
    reference, same = compared.models
    assert (reference.differences, same.differences) == (None, ())
    assert "What differs (b) values of the estimates only" in " ".join(text_of(compared).split())
    saved = load_model(models[0])
    changed = {"m_u": {"prior": (30.0, 2.0), "origin": ParameterOrigin.PRIOR}, "d_rr": {"free": False}}
    wind = saved.model + catalogue()["wind"]
    parameters = tuple(replace(p, **changed.get(p.name, {})) for p in wind.parameters)
    other = replace(
        saved,
        model=replace(wind, parameters=parameters),
        reml=not saved.reml,
        provenance={"logs": ["runs/run9.mcap sha256:0123456789abcdef"]},
    )
    found = {d.kind: d for d in model_differences(saved, other)}
    assert list(found) == ["effects", "estimated", "fixed", "priors", "logs", "method"]
    assert found["effects"].here == ("wind",)
    assert found["estimated"].in_reference == ("d_rr",)
    assert "F_wx" in found["estimated"].here
    assert [text.split(" = ")[0] for text in found["fixed"].here] == ["d_rr"]
    assert "m_u = 30 ± 2 kg" in found["priors"].here
    assert found["logs"].here == ("run9.mcap (012345)",)
    assert found["logs"].in_reference[0].startswith("run1.mcap (")
    assert model_differences(saved, replace(saved, reml=not saved.reml))[0].kind == "method"
    # A model of one's own keeps its accelerometer on logs without accelerations, which have no rate.
    no_position = {name: rate for name, rate in saved.rates.items() if name != "position"}
    (unseen,) = model_differences(saved, replace(saved, rates=no_position))
    assert (unseen.kind, unseen.here, unseen.in_reference) == ("channels", (), ("x", "y"))
    named = msgspec.structs.replace(
        compared, models=(reference, msgspec.structs.replace(same, differences=tuple(found.values())))
    )
    text = " ".join(text_of(named).split())
    assert "What differs (b) effects (b) wind estimated parameters (b)" in text
    assert "fitted to (b) run9.mcap (012345); (a) run1.mcap (" in text
    lengthy = msgspec.structs.replace(found["estimated"], here=tuple(f"parameter_{k}" for k in range(12)))
    wordy = msgspec.structs.replace(compared, models=(reference, msgspec.structs.replace(same, differences=(lengthy,))))
    block = text_of(wordy).partition("What differs")[2].partition("RMS error")[0]
    assert "parameter_11" in block
    assert max(map(len, block.splitlines())) <= 100
    page = render(named)
    assert "What differs" in page
    assert "only in (a)" in page


def test_every_kind_channel_and_model_has_an_error_and_a_verdict(compared: ComparisonResult) -> None:
    assert compared.kinds == (("one_step", None), ("horizon", 2.0), ("horizon", 5.0), ("simulation", None))
    rows = {(row.kind, row.seconds, row.channel): row for row in compared.channels}
    assert len(rows) == 4 * 8
    for row in compared.channels:
        good, bad = row.errors
        assert (good.model, bad.model, good.against_reference) == ("a", "b", None)
        assert row.spread is not None
        assert good.fit == pytest.approx(1.0 - good.rms / row.spread)
        assert bad.against_reference is not None
        assert bad.against_reference.ratio == pytest.approx(bad.rms / good.rms)
    turn = rows["horizon", 2.0, "r"]
    ratio = turn.errors[1].against_reference
    assert ratio is not None
    assert ratio.low is not None
    assert 1.0 < ratio.low < ratio.ratio
    assert (ratio.verdict, turn.best, turn.not_worse) == ("worse", "a", ("a",))
    assert turn.errors[1].against_best == ratio
    assert compared.models[1].score is not None
    assert (compared.models[1].score.verdict, compared.models[1].score.held_out) == ("worse", True)
    assert compared.best == "a"
    assert compared.answer.startswith("Best 2 s ahead: (a) good. The error of (b) over all channels is ")
    assert re.search(r"than that of \(a\) \(95 %: .* %\)\. It is \d+ % larger 5 s ahead \(95 %: ", compared.answer)
    assert sum(compared.counts("b").values()) == 32
    assert compared.counts("b")["worse"] > 3
    assert compared.counts("b")["no-interval"] > 0
    assert compared.counts("a") == {"better": 0, "worse": 0, "indistinguishable": 0, "no-interval": 0}


def test_predictions_over_time_agree_with_the_errors(compared: ComparisonResult) -> None:
    assert {trace.record for trace in compared.traces} == {"run2", "run3"}
    for model, kind, seconds in (("a", "horizon", 5.0), ("b", "simulation", None)):
        squares = []
        for trace in (x for x in compared.traces if x.channel == "vx"):
            (found,) = (p for p in trace.predictions if (p.model, p.kind, p.seconds) == (model, kind, seconds))
            e = trace.measured[np.searchsorted(trace.t, found.t)] - found.predicted
            squares.append(e[found.t > 15.0] if kind == "simulation" else e)
            assert (found.sd > 0.0).all()
        (row,) = (c for c in compared.channels if (c.kind, c.seconds, c.channel) == (kind, seconds, "vx"))
        rms = next(e.rms for e in row.errors if e.model == model)
        assert np.sqrt(np.mean(np.concatenate(squares) ** 2)) == pytest.approx(rms, rel=1e-6)


def test_two_processes_give_the_numbers_of_one(
    compared: ComparisonResult, models: list[Path], logs: list[Path]
) -> None:
    request = CompareRequest(models, logs[1:], (2.0, 5.0), names=("good", "bad"), workers=Workers(2, "loky"))
    two = compare_models(request, "", Kept())
    assert two.channels == compared.channels
    plain = [[msgspec.structs.replace(m, residuals=(), cross=()) for m in x.models] for x in (two, compared)]
    assert plain[0] == plain[1]
    for own, other in zip(two.models, compared.models, strict=True):
        assert own.residuals
        for a, b in zip(own.residuals, other.residuals, strict=True):
            np.testing.assert_array_equal(a.e, b.e)
    np.testing.assert_array_equal(two.traces[3].predictions[1].sd, compared.traces[3].predictions[1].sd)


def test_command_writes_result_and_report(
    models: list[Path],
    logs: list[Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    words = ("ident", "compare", *models, "--on", logs[2], "--horizon", "3", "--out", tmp_path / "out")
    run(*words)
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines()[:-1])) <= 80
    assert "RMS error and fit: 3 s ahead" in shown
    assert f"report: {tmp_path / 'out/report.html'}" in shown
    result = read_result(tmp_path / "out/result.json")
    assert isinstance(result, ComparisonResult)
    assert result.horizons == (3.0,)
    assert [log.role for log in result.logs] == ["compared"]
    table = pyarrow.parquet.read_table(tmp_path / "out/result.parquet").to_pandas()
    drawn = table[(table["table"] == "traces.predictions") & (table["name"] == "psi")]
    assert set(drawn["record"]) == {"run3"}
    assert drawn["predicted"].notna().all()
    page = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    for title in ("Which model is better", "Prediction errors", "Log score and criteria", "Measured and predicted"):
        assert title in page
    run(*words, status=1)
    assert "exists already; --force replaces it" in capsys.readouterr().err
    run(*words, "--force", "--json")
    printed = json.loads(capsys.readouterr().out)
    assert printed["kind"] == "comparison"
    assert len(printed["channels"]) == 3 * 8
    assert "predicted" not in printed["traces"][0]["predictions"][0]


def test_models_and_logs_that_are_given_twice_are_refused(
    models: list[Path], logs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "copy.toml"
    shutil.copy(models[0], copy)
    run("ident", "compare", models[0], models[0], "--on", logs[2], status=1)
    assert f"{models[0]} is given twice; give another model to compare it with" in capsys.readouterr().err
    run("ident", "compare", models[0], copy, "--on", logs[2], status=1)
    assert f"{copy} is the same model as {models[0]}; give another model" in capsys.readouterr().err
    with pytest.raises(SeatrialError, match=r"^b is the same model as a; give another model"):
        st.compare({"a": models[0], "b": copy}, logs[2])
    run("ident", "compare", *models, "--on", logs[2], "--on", logs[2], status=1)
    assert f"{logs[2].name}: this log is given twice, and its samples would count twice" in capsys.readouterr().err


def test_a_line_that_holds_for_all_models_is_said_once(
    models: list[Path], logs: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("seatrial.ident.workflows.compare.hold_lines", lambda saved, loaded: ["run3: other inputs"])
    reporter = Kept()
    result = compare_models(CompareRequest(models, logs[2:], (2.0,)), "", reporter)
    line = f"{models[0]}, {models[1]}: run3: other inputs"
    assert [text for text in reporter.warnings if "other inputs" in text] == [line]
    assert line in result.notes


def test_without_a_folder_nothing_is_written(
    models: list[Path], logs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run("ident", "compare", *models, "--on", logs[2])
    assert not list(tmp_path.iterdir())


def test_python_interface_takes_a_list_or_one_model_after_the_other(
    models: list[Path], logs: list[Path], tmp_path: Path
) -> None:
    listed = st.compare({"good": models[0], "bad": models[1]}, logs[2], horizon=2.0)
    one_by_one = st.compare(models[0], models[1], logs[2], horizon=[2.0])
    named = st.compare(*models, logs=[logs[2]], horizon=2.0)
    assert one_by_one.result.channels == listed.result.channels == named.result.channels
    assert (listed.names, one_by_one.names) == (("good", "bad"), tuple(map(str, models)))
    assert listed.best == "good"
    frame = listed.to_pandas()
    assert len(frame) == 3 * 8 * 2
    worst = frame[(frame["model"] == "bad") & (frame["seconds"] == 2.0)].set_index("channel")
    assert worst.loc["r", "ratio"] > 1.0
    assert "(b)" in repr(listed)
    saved = st.load(listed.save(tmp_path / "saved"))
    pandas.testing.assert_frame_equal(saved.to_pandas(), frame, rtol=1e-6)  # result.json is rounded
    assert saved.summary() == listed.summary()
    assert saved._repr_html_() == listed._repr_html_()
    again = read_result(tmp_path / "saved/result.json")
    assert isinstance(again, ComparisonResult)
    assert again.answer == listed.answer
    figures = [x.plot("r") for x in (st.load(tmp_path / "saved"), listed)]
    assert [(x["name"], x["mode"]) for x in figures[0].data] == [(x["name"], x["mode"]) for x in figures[1].data]
    assert figures[0].layout == figures[1].layout
    for call, message in (
        (lambda: st.compare(models[0], models[0], logs[2]), "is given twice; give another model to compare it with"),
        (lambda: st.compare(models), "there are no logs"),
        (lambda: st.compare(models, logs[2], 10.0), "a list of models is followed by the logs alone"),
        (lambda: listed.plot(horizon=7.0), "there is no horizon 7.0; choose 2 or 'simulation'"),
        (lambda: listed.plot("yaw"), "there is no channel 'yaw'"),
        (lambda: st.compare(models, logs[2], horizon=1000.0), "horizon 1000: .* give fewer seconds"),
        (lambda: st.compare(models, logs[2], scheduler="tcp://x:1"), "have no scheduler"),
    ):
        with pytest.raises(SeatrialError, match=message):
            call()


def test_the_page_runs_as_written(
    models: list[Path],
    logs: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for model, name in zip(models, ("vehicle", "diagnosis"), strict=True):
        shutil.copytree(model.parent, tmp_path / name)
    for name in ("run3", "run4"):
        shutil.copy(logs[2], tmp_path / f"{name}.mcap")
    monkeypatch.chdir(tmp_path)
    text = (Path(__file__).parents[3] / "docs/how-to/compare.md").read_text(encoding="utf-8")
    blocks, place = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL), dict[str, Any]()
    assert len(blocks) == 3
    for block in blocks:
        exec(compile(block, "compare.md", "exec"), place)
    shown = capsys.readouterr().out
    assert "RMS error and fit: 2 s ahead" in shown
    assert "10 s ahead the fit of all channels is" in shown
    assert "inside_95" in shown
    assert "Measured (grey) and predicted: Simulation" in (tmp_path / "overlay.html").read_text(encoding="utf-8")
    assert (tmp_path / "comparison/report.html").exists()
    assert "cross-correlation" in shown
    assert "Standardised residuals" in (tmp_path / "residuals.html").read_text(encoding="utf-8")


def test_figure_has_each_model_in_its_own_colour_and_dash(compared: ComparisonResult) -> None:
    figure = st.Comparison(compared).plot("psi", "vx", horizon="simulation")
    lines = [x for x in figure.data if x["mode"] == "lines" and "fill" not in x and x["name"] != "measured"]
    looks = {(x["name"], x["line"]["color"], x["line"]["dash"]) for x in lines}
    assert looks == {("(a) good", "#0072B2", "solid"), ("(b) bad", "#E69F00", "dash")}
    assert len(lines) == 2 * 2 * 2  # channels, records and models
    bands = [x for x in figure.data if x.get("fill") == "toself"]
    assert len(bands) == len(lines)
    shown = [x["name"] for x in figure.data if x.get("showlegend")]
    assert sorted(shown) == ["(a) good", "(b) bad", "measured"]
    titles = [x["text"] for x in figure.layout["annotations"]]
    assert titles[0].startswith("Heading ψ [deg] · fit (a) ")
    assert titles[0].endswith("run2")
    assert len(titles) == 4


def test_bands_do_not_flatten_the_curves(compared: ComparisonResult) -> None:
    """The vertical range is limited as in the report of a fit, and a caption says so."""
    (row,) = (t for t in compared.traces if t.channel == "r" and t.record == compared.traces[0].record)
    wide = tuple(msgspec.structs.replace(p, sd=p.sd + np.linspace(0.0, 50.0, p.sd.size)) for p in row.predictions)
    names = {m.label: m.label for m in compared.models}
    kind = (row.predictions[-1].kind, row.predictions[-1].seconds)
    for predictions, limited in ((wide, True), (row.predictions, False)):
        changed = msgspec.structs.replace(row, predictions=predictions)
        (panel,) = overlay_panels(compared, [changed], kind, 500, names)
        assert ("range" in panel.y) == limited
        if limited:
            low, high = panel.y["range"]
            size = np.degrees(np.ptp(row.measured[np.isfinite(row.measured)]))
            assert size <= high - low < 4.0 * size
        page = render(msgspec.structs.replace(compared, traces=(changed,)))
        assert ("The vertical range is limited" in page) == limited


def test_headings_of_a_simulation_are_continuous_beside_the_samples(compared: ComparisonResult) -> None:
    """With jumps at half a turn, a wide band of the simulation filled the panel on both sides of each jump."""
    (row,) = (t for t in compared.traces if t.channel == "psi" and t.record == compared.traces[0].record)
    turning = np.linspace(3.0, 40.0, row.t.size)  # rad: six turns, which a sensor gives from -pi to pi
    measured = np.where(np.arange(row.t.size) == 5, np.nan, np.remainder(turning + np.pi, 2.0 * np.pi) - np.pi)
    simulated = tuple(
        msgspec.structs.replace(p, predicted=np.interp(p.t, row.t, turning) - 2.0 * np.pi + 0.1)
        for p in row.predictions
        if p.kind == "simulation"
    )
    changed = msgspec.structs.replace(row, measured=measured, predictions=simulated)
    names = {m.label: m.label for m in compared.models}
    (panel,) = overlay_panels(compared, [changed], ("simulation", None), 500, names)
    samples, *curves = [x for x in panel.traces if x.get("fill") != "toself"]
    for trace, away in ((samples, 0.0), *((curve, 0.1) for curve in curves)):
        x, y = numbers(trace["x"]), np.radians(numbers(trace["y"]))
        good = np.isfinite(y)
        assert good.sum() > 100
        np.testing.assert_allclose(y[good], np.interp(x[good], row.t, turning) + away, atol=0.01)
    assert panel.y["dtick"] == 720.0  # at most six ticks


def test_more_models_than_fit_into_a_row_get_several_tables(compared: ComparisonResult) -> None:
    many = tuple(
        msgspec.structs.replace(row, errors=tuple(msgspec.structs.replace(row.errors[0], model=n) for n in labels(8)))
        for row in compared.channels
    )
    names = tuple(msgspec.structs.replace(compared.models[0], label=n) for n in labels(8))
    tables = compared_tables(msgspec.structs.replace(compared, channels=many, models=names))
    assert [len(t.columns) for t in tables[:2]] == [2 + 6 + 1, 2 + 2 + 1]
    assert labels(28)[25:] == ["z", "a1", "b1"]


def test_errors_are_compared_at_the_samples_that_all_models_predict() -> None:
    t = np.arange(10.0)
    first = {"run": {"r": errors(t, 1.0 + t), "x": errors(t, t)}, "other": {"r": errors(t, t)}}
    second = {"run": {"r": errors(t[4:], 2.0 + t[4:])}, "other": {}}
    a, b = at_common_samples([first, second])
    np.testing.assert_array_equal(a["run"]["r"].t, t[4:])
    np.testing.assert_array_equal(a["run"]["r"].e, 1.0 + t[4:])
    np.testing.assert_array_equal(a["run"]["r"].about, np.cos(t[4:]))
    np.testing.assert_array_equal(b["run"]["r"].e, 2.0 + t[4:])
    assert a["run"]["x"].t.size == 10  # only the first model predicts x at all
    assert "r" not in a["other"]


def test_model_that_limits_the_common_samples_is_named() -> None:
    """A third model that predicts few samples changes the numbers of the first two."""
    t = np.arange(100.0)
    whole = {"run": {"r": errors(t, t), "x": errors(t, t)}}
    few = {"run": {"r": errors(t[::12], t[::12])}}
    assert limited_samples([whole, whole], "ab") == []
    assert limited_samples([whole, whole, few], "abc") == ["r 9 of 100 samples, by (c)"]
    assert limited_samples([few, whole], "ab") == ["r 9 of 100 samples, by (a)"]
    nearly = {"run": {"r": errors(t[5:], t[5:])}}
    assert limited_samples([whole, nearly], "ab") == []
    parts = [{"run": PredictedRecord(t, {}, t, {ONE_STEP: own["run"]}, {})} for own in (whole, whole, few)]
    (warning,) = _limited_warnings(parts, labels(3))
    assert warning.text.endswith("One step ahead they are limited: r 9 of 100 samples, by (c).")


def test_seconds_that_have_most_of_the_errors_are_named() -> None:
    t = np.arange(0.0, 300.0, 0.1)
    event = np.where((t >= 286.0) & (t < 289.0), 40.0, 1.0)
    own = [{"run": {"r": errors(t, e), "psi": errors(t, e), "x": errors(t, np.full(t.size, 2.0))}}
           for e in (np.full(t.size, 2.0), event)]  # fmt: skip
    (note,) = concentration_notes(own, labels(2), 10.0, [1], {"run": 10.0})
    assert note.startswith(
        "A small part of the time has most of the squared error 10 s ahead: (b) 94 % of that of r, psi in 295 to 300 s "
        "of run (since the start of the log). Without these seconds, of the errors over all channels that of (b) is "
        "0.63 times that of (a). "
    )
    (decided,) = concentration_notes(own, labels(2), 10.0, [], {})
    assert "Without" not in decided
    (alone,) = concentration_notes(own[1:], labels(1), 10.0, [], {})
    assert ": 94 % of that of r, psi in 285 to 290 s of run (" in alone
    assert concentration_notes(own[:1], labels(1), 10.0, [], {}) == []


def test_note_on_the_errors_is_in_every_output(
    models: list[Path], logs: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(prediction_errors, "SMALL_PART", 0.5)
    monkeypatch.setattr(prediction_errors, "LEAST_SHARE", 0.0)
    monkeypatch.setattr(prediction_errors, "MOST_SPANS", 100)
    result = compare_models(CompareRequest(models, logs[2:], (3.0,), names=("good", "bad")), "", Kept())
    note = result.notes[0]
    assert note.startswith("A small part of the time has most of the squared error 3 s ahead: (a) ")
    assert ("Without these seconds" in note) is (result.models[1].changes[1].against_reference.verdict != "worse")
    assert Comparison(result).notes == list(result.notes)
    assert "A small part of the time has most" in text_of(result)
    assert "A small part of the time has most" in render(result)


def test_simulations_of_unstable_models_are_said_to_run_away(
    models: list[Path], logs: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    request = CompareRequest(models, logs[2:], (3.0,), names=("good", "bad"))
    # the log has 60 s, 15 s of which are filtered
    found = [CourseStability(speed=1.2, pole=pole, low=None, high=None) for pole in (-0.2, 0.5, 0.01)]
    for courses, named in ((found[:2], "(b) at 1.2 m/s in 2 s. "), ((found[0], found[2]), ""), ((None, None), "")):
        left = list(courses)
        monkeypatch.setattr(compare, "course_at_speeds", lambda *_, left=left: left.pop(0))
        result = compare_models(request, "", Kept())
        notes = [note for note in result.notes if note.startswith("The simulation of a directionally unstable model")]
        assert len(notes) == bool(named)
        assert all(named in note for note in notes)
        assert ("directionally unstable model" in text_of(result)) is bool(named)


def test_wind_of_another_day_is_named() -> None:
    """The wind of the logs of the fit acts on the compared logs, of whatever day."""
    july, october = "2026-07-01T10:00:00+00:00", "2026-10-09T10:00:00+00:00"

    def saved(effect: str, begins: tuple[str, ...], per_record: bool = False) -> Any:
        added = catalogue()[effect]
        own = tuple(replace(p, per_record=per_record) for p in added.parameters)
        plain = horizontal_model()
        model = replace(plain, parameters=(*plain.parameters, *own), effects=(added,))
        return SimpleNamespace(model=model, provenance={"begins": begins} if begins else {})

    def log(name: str, start: str | None) -> Any:
        return SimpleNamespace(run=SimpleNamespace(name=name), about={"start": start})

    logs = [log("oct", october), log("jul", "2026-07-01T21:00:00+00:00")]
    (note,) = surroundings_notes({"a": saved("mismatch", (july,)), "b": saved("wind", (july,))}, logs)
    assert note.startswith(
        f"{OTHER_SURROUNDINGS}: (b) wind with the values of the logs of the fit. The compared logs oct are of another "
        "day, and are predicted with these values."
    )
    (alone,) = surroundings_notes({"": saved("wind", (july,))}, logs)
    assert alone.startswith(f"{OTHER_SURROUNDINGS}: wind with the values")
    assert OTHER_SURROUNDINGS in SHOWN_NOTES  # the terminal and summary() have the note too
    unknown = [log("new", None), log("undated", "1970-01-01T00:00:00+00:00")]
    for silent, given in (
        (saved("wind", (july,)), logs[1:]),
        (saved("wind", (july, october)), logs),
        (saved("wind", (july,), per_record=True), logs),
        (saved("wind", ()), logs),
        (saved("wind", ("",)), logs),
        (saved("wind", (july,)), unknown),
    ):
        assert surroundings_notes({"": silent}, given) == []


def test_a_saved_model_has_the_starts_of_its_logs(
    models: list[Path], logs: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    saved = load_model(models[0])
    assert len(saved.provenance["begins"]) == len(saved.provenance["logs"])
    assert all(datetime.fromisoformat(start).tzinfo for start in saved.provenance["begins"])
    monkeypatch.setattr(compare, "surroundings_notes", lambda by, given: [f"{sorted(by)} on {len(given)}"])
    assert "['a', 'b'] on 1" in compare_models(CompareRequest(models, logs[2:], (3.0,)), "", Kept()).notes


def test_course_of_a_saved_model_is_at_the_speeds_of_its_data(models: list[Path]) -> None:
    saved = load_model(models[0])
    course = course_at_speeds(saved.model, saved.validity)
    assert course is not None
    assert course.speed <= saved.validity["u"][1]
    assert course_at_speeds(saved.model, {}) is None


def test_rows_name_the_best_model_and_those_not_distinguishable_from_it() -> None:
    rng, t = np.random.default_rng(1), np.arange(0.0, 200.0, 0.1)
    noise = [rng.normal(size=t.size) for _ in range(3)]
    own = [{"run": {"r": errors(t, scale * e)}} for scale, e in zip((1.0, 0.5, 0.501), noise, strict=True)]
    own.append({"run": {"r": errors(t, np.full(t.size, np.inf))}})
    (row,) = channel_rows(ONE_STEP, own, labels(4), {"r": "rad/s"}, {"r": 10.0})
    assert row.best in ("b", "c")
    assert row.not_worse == ("b", "c")
    assert [e.against_reference and e.against_reference.verdict for e in row.errors] == [
        None, "better", "better", "worse",
    ]  # fmt: skip
    assert row.errors[3].rms is None
    assert row.errors[3].fit is None
    assert (row.n, row.block) == (2000, 10.0)


def test_models_that_are_all_equally_good_are_all_the_best(compared: ComparisonResult) -> None:
    rng, t = np.random.default_rng(1), np.arange(0.0, 200.0, 0.1)
    own = [{"run": {"r": errors(t, rng.normal(size=t.size))}} for _ in range(3)]
    (row,) = channel_rows(ONE_STEP, own, labels(3), {"r": "rad/s"}, {"r": 10.0})
    assert len(row.not_worse) == 3
    (table,) = compared_tables(msgspec.structs.replace(compared, channels=(row,)))
    assert [str(cell) for cell in table.columns[-1].cells] == ["all"]
    assert (_best_cell(row).words, _best_cell(row).style) == ("all", "")


def test_too_few_blocks_give_no_interval_and_no_verdict(compared: ComparisonResult) -> None:
    """Errors of 29.5 m against 0.05 m are not "not distinguishable" if the log has two independent blocks."""
    t = np.arange(0.0, 20.0, 0.1)
    own = [{"run": {"x": errors(t, np.full(t.size, e))}} for e in (29.5, 0.05)]
    (row,) = channel_rows(SIMULATION, own, labels(2), {"x": "m"}, {"x": 10.0})
    ratio = row.errors[0].against_best
    assert ratio is not None
    assert ratio.ratio == pytest.approx(590.0)
    assert (ratio.low, ratio.high, ratio.blocks, ratio.verdict) == (None, None, 2, "no-interval")
    assert (row.best, row.not_worse, len(row.unproven)) == ("b", ("b",), 1)
    short = msgspec.structs.replace(compared, channels=(row,))
    assert short.counts("b") == {"better": 0, "worse": 0, "indistinguishable": 0, "no-interval": 1}
    (table,) = compared_tables(short)
    assert [str(cell) for cell in table.columns[-1].cells] == ["undecided; no interval: 2 blocks"]
    cells = _error_cells(row, row.errors[1])
    assert "no interval: 2 blocks" in [cell.words for cell in cells if isinstance(cell, Cell)]
    best = _best_cell(row)
    assert (best.words, best.style) == ("undecided; no interval: 2 blocks", "")
    known = msgspec.structs.replace(ratio, ratio=2.0, low=1.5, high=2.5, verdict="worse")
    third = msgspec.structs.replace(row.errors[0], model="c", against_best=known)
    decided = msgspec.structs.replace(row, errors=(*row.errors, third))
    assert _best_cell(decided).words == "(b); no interval: 2 blocks"
    frame = Comparison(short).to_pandas()
    assert list(frame["verdict"].dropna()) == ["no-interval"]
    assert list(frame["blocks"].dropna()) == [2]
    (enough,) = channel_rows(SIMULATION, own, labels(2), {"x": "m"}, {"x": 5.0})
    known = enough.errors[0].against_best
    assert known is not None
    assert (known.blocks, known.verdict) == (4, "worse")


def test_records_of_models_with_other_inputs_cover_the_same_time() -> None:
    t = np.arange(0.0, 60.0, 0.1)
    channels = {
        "x": Channel(t, np.sin(t), "m"),
        "u": Channel(t[50:-20], np.cos(t[50:-20]), "m/s"),
        "X": Channel(t, np.ones(t.size), "N"),
    }
    position, speed = surge_model(measured="position"), surge_model(measured="both")
    segments = [LogSegment("run", channels)]
    both = records_of_same_time([(position, segments), (speed, segments)], 10.0)
    (a,), (b,) = both
    assert a.meta["t0"] == b.meta["t0"] == pytest.approx(5.0)
    assert a.t[-1] == b.t[-1] == pytest.approx(t[-21] - 5.0)
    np.testing.assert_array_equal(a.t, b.t)


def test_a_model_that_thins_its_sensors_shares_the_samples_of_the_others() -> None:
    """The model nomoto takes single samples of heading and gyro, and the others take means."""
    ahrs, gnss = 0.018 * np.arange(3000), 0.2037 * np.arange(250)
    channels = {n: Channel(ahrs, np.sin(ahrs)) for n in ("psi", "r")}
    channels |= {n: Channel(gnss, np.cos(gnss)) for n in ("x", "y", "vx", "vy")}
    channels |= {n: Channel(gnss, np.cos(gnss), hold="zero") for n in ("n_left", "n_right")}
    models = [nomoto_model(), horizontal_model("shaft")]
    (a,), (b,) = records_of_same_time([(m, [LogSegment("run", channels)]) for m in with_equal_averages(models)], 10.0)
    for name in ("psi", "r"):
        samples = [
            record.t[np.isfinite(record.y[:, record.outputs.index(name)])] + record.meta["t0"] for record in (a, b)
        ]
        assert samples[0].size > 400
        np.testing.assert_allclose(samples[0], samples[1], atol=1e-9)


def predicted(t: np.ndarray, ll: np.ndarray, samples: dict[str, int] | None = None) -> dict[str, PredictedRecord]:
    """Return the predictions of a model on one record, of which only the log-likelihood is used."""
    return {"run": PredictedRecord(t, samples or {"r": t.size}, ll, {}, {})}


def test_log_score_sums_blocks_of_models_with_other_rows() -> None:
    t = 0.1 * np.arange(1000)
    found = log_score(predicted(t, 0 * t), predicted(t[::2], np.full(500, 0.8), {"r": 1000}), 10.0, True)
    assert found is not None
    assert found.gain == pytest.approx(400.0)
    assert found.blocks == 9
    assert found.verdict == "better"
    back = log_score(predicted(t, 0 * t + 1.0), predicted(t, np.cos(t)), 10.0, False)
    assert back is not None
    assert (back.verdict, back.held_out) == ("worse", False)


def test_models_with_other_samples_have_no_log_score() -> None:
    t = 0.1 * np.arange(1000)
    assert log_score(predicted(t, 0 * t), predicted(t, 0 * t, {"r": 999}), 10.0, True) is None
    assert log_score(predicted(t, 0 * t), predicted(t, 0 * t, {"r": 1000, "psi": 5}), 10.0, True) is None


def test_short_logs_have_a_gain_without_an_interval() -> None:
    t = 0.1 * np.arange(300)
    found = log_score(predicted(t, 0 * t), predicted(t, 0 * t + 1.0), 10.0, True)
    assert found is not None
    assert (found.gain, found.blocks) == (pytest.approx(300.0), 2)
    assert (found.low, found.high, found.verdict) == (None, None, "no-interval")


def log(times: str) -> LoadedLog:
    return LoadedLog(LogSegment("run1", {}), {"path": f"run1.mcap{times}", "sha256": "ab" * 32}, {}, None)


@pytest.mark.parametrize(
    ("change", "times", "score", "reason"),
    [
        ({}, "", SCORE, ""),
        ({}, "", None, "do not predict the same samples"),
        ({}, "[0:60]", SCORE, "fitted to another part of a compared log"),
        ({"provenance": {"logs": ["run1.mcap[0:60] sha256:abababababababab"]}}, "", SCORE, "another part of a"),
        ({"provenance": {"logs": ["a.mcap sha256:abab", "b.mcap sha256:cdcd"]}}, "", SCORE, "exactly these logs"),
        ({"reml": True}, "", SCORE, "fit with --no-reml"),
        ({"second": True}, "", SCORE, "fit with --no-second-order"),
    ],
)
def test_reason_for_no_information_criteria(
    change: dict[str, Any], times: str, score: LogScore | None, reason: str
) -> None:
    model = horizontal_model("shaft")
    saved = SavedModel(model, {}, {}, provenance={"logs": ["run1.mcap sha256:abababababababab"]})
    other = replace(saved, model=replace(model, second_order=change.get("second", False)))
    other = replace(other, **{n: v for n, v in change.items() if n != "second"})
    found = why_not_comparable((saved, other), (("run1",), ("run1",)), [log(times)], score)
    assert reason in found
    assert bool(found) is bool(reason)


def test_answer_without_a_significant_difference(compared: ComparisonResult) -> None:
    first, second = compared.models
    change = second.changes[1]
    same = msgspec.structs.replace(change.against_reference, ratio=0.98, low=0.9, high=1.1, verdict="indistinguishable")
    again = msgspec.structs.replace(second, changes=(msgspec.structs.replace(change, against_reference=same),))
    assert comparison_answer(msgspec.structs.replace(compared, models=(first, again))) == (
        f"No clear difference between (a) good and (b) {second.name} 2 s ahead. The error of (b) over all channels is "
        "2 % smaller "
        "than that of (a) (95 %: −10 to +10 %)."
    )
    poor = msgspec.structs.replace(same, ratio=4.384, low=2.9, high=6.6, verdict="worse")
    third = msgspec.structs.replace(
        second, label="c", name="poor", changes=(msgspec.structs.replace(change, against_reference=poor),)
    )
    assert comparison_answer(msgspec.structs.replace(compared, models=(first, again, third))).startswith(
        "Best 2 s ahead: (a) good. The error of (c) over all channels is 338 % larger than that of (a) (95 %: +190 to "
        "+560 %)."
    )
    short = msgspec.structs.replace(same, low=None, high=None, blocks=3, verdict="no-interval")
    again = msgspec.structs.replace(second, changes=(msgspec.structs.replace(change, against_reference=short),))
    assert comparison_answer(msgspec.structs.replace(compared, models=(first, again))) == (
        "The logs are too short for a verdict 2 s ahead (no interval: 3 blocks). The error of (b) over all channels is "
        "2 % smaller than that of (a), without an interval."
    )
    unlike = msgspec.structs.replace(second, changes=())
    assert comparison_answer(msgspec.structs.replace(compared, models=(first, unlike))).startswith(
        "The logs have no prediction"
    )


@pytest.mark.parametrize(("size", "told"), [(1.5, True), (4.0, False)])
def test_effects_whose_size_is_not_significant_are_named(size: float, told: bool) -> None:
    """The smaller error of a model with a wind of 1.5 standard errors looked as if the boat had it."""
    wind, plain = catalogue()["wind"], horizontal_model()
    own = tuple(replace(p, value=0.5 * size) if p.name == "F_wx" else p for p in wind.parameters)
    windy = replace(plain, parameters=(*plain.parameters, *own), effects=(wind,))
    errors = {p.name: 0.5 for p in own}
    saved = [cast(SavedModel, SimpleNamespace(model=m, errors=errors)) for m in (plain, windy)]
    notes = size_notes(dict(zip("ab", saved, strict=True)))
    assert bool(notes) is told
    assert not size_notes({"a": saved[1], "b": saved[1]})  # both have it
    if told:
        assert notes[0].startswith(f"{SIZE_NOT_SIGNIFICANT}: (b) wind (F_wx 0.75 ± 0.50 N). ")
        assert SIZE_NOT_SIGNIFICANT in SHOWN_NOTES


RATIOS = {"vehicle": 1.0, "rm": 0.69, "rmwind": 0.8, "diagnosis": 0.82, "command": 1.02}
FREE = {"vehicle": 16, "rm": 18, "rmwind": 20, "diagnosis": 39, "command": 18}


def _in_order(compared: ComparisonResult, order: Sequence[str]) -> ComparisonResult:
    """Return a comparison of models with the errors `RATIOS`, of which ratios below 0.75 are significant."""
    template = compared.models[1].changes[1]

    def ratio(name: str, other: str) -> ComparedRatio:
        size = RATIOS[name] / RATIOS[other]
        verdict: Any = "better" if size < 0.75 else "worse" if size > 1.0 / 0.75 else "indistinguishable"
        return ComparedRatio(ratio=size, low=0.8 * size, high=1.2 * size, blocks=9, verdict=verdict)

    letters = dict(zip(order, "abcde", strict=False))
    models = [
        msgspec.structs.replace(
            compared.models[min(k, 1)], label=letters[name], name=name, n_free=FREE[name],
            changes=() if k == 0 else (msgspec.structs.replace(template, against_reference=ratio(name, order[0])),),
        )
        for k, name in enumerate(order)
    ]  # fmt: skip
    pairs = [
        ComparedPair(model=letters[b], other=letters[a], seconds=2.0, ratio=ratio(b, a))
        for a, b in itertools.combinations(order[1:], 2)
    ]
    return msgspec.structs.replace(compared, horizons=(2.0,), models=tuple(models), pairs=tuple(pairs))


@pytest.mark.parametrize(
    "order", [("vehicle", "rm", "rmwind", "diagnosis", "command"), ("rm", "command", "diagnosis", "rmwind", "vehicle")]
)
def test_answer_does_not_depend_on_the_order_of_the_models(compared: ComparisonResult, order: Sequence[str]) -> None:
    """The best model was tested only against the first one, so that those that are as good were not named."""
    result = _in_order(compared, order)
    of = {m.name: f"({m.label}) {m.name}" for m in result.models}
    answer = comparison_answer(result)
    equal = [of[name] for name in order if name in ("rmwind", "diagnosis")]
    expected = f"Best 2 s ahead: {of['rm']}, without a clear difference over all channels from {' and '.join(equal)}. "
    assert answer.startswith(expected)
    assert f"without a clear difference is {of['rm']}: it has 18 estimated parameters, and not 20 and 39." in answer
    for name in ("vehicle", "command"):  # both are said to be worse, in either order
        assert of[name].split()[0] in answer.removeprefix(expected)
    assert result.models[order.index("rm")].label == result.best
    assert list(result.verdicts(result.best).values()).count("better") == 2


def test_simpler_of_two_models_without_a_clear_difference_is_named(compared: ComparisonResult) -> None:
    answer = comparison_answer(_in_order(compared, ("rm", "diagnosis")))
    assert answer.startswith("No clear difference between (a) rm and (b) diagnosis 2 s ahead. The error of (b) over")
    assert answer.endswith(
        " The simpler of these without a clear difference is (a) rm: it has 18 estimated parameters, and not 39."
    )
    assert "simple" not in comparison_answer(_in_order(compared, ("rm", "vehicle")))  # one of them is better
    three = comparison_answer(_in_order(compared, ("rmwind", "diagnosis", "vehicle")))
    assert three.startswith("No model is significantly better than another one 2 s ahead. The smallest error over all")
    assert "that of (a) rmwind." in three


def test_models_with_larger_errors_than_a_worse_one_are_unclear(compared: ComparisonResult) -> None:
    """A column had 44.5 and 46.7 deg as good as 26.8 deg, and left out 30.5 deg: wide intervals and a narrow one."""
    verdicts = {"a": (44.5, "indistinguishable"), "b": (30.5, "worse"), "c": (26.8, ""), "d": (27.6, "")}
    errors = []
    for label, (rms, verdict) in verdicts.items():
        size = rms / 26.8
        against = ComparedRatio(ratio=size, low=0.9, high=3.0, blocks=9, verdict=verdict or "indistinguishable")  # type: ignore[arg-type]
        errors.append(ComparedError(model=label, rms=rms, against_best=None if label == "c" else against))
    row = msgspec.structs.replace(compared.channels[0], errors=tuple(errors), best="c")
    assert (row.not_worse, row.unclear) == (("c", "d"), ("a",))
    assert _best_words(row) == "c d; unclear: a"
    assert _best_cell(row) == Cell("(c) or (d); unclear: (a)")


def test_answer_names_a_model_with_a_smaller_error_but_without_a_verdict(compared: ComparisonResult) -> None:
    first, second = compared.models
    change = second.changes[1]
    rows = []
    for label, ratio, verdict in (("b", 0.772, "better"), ("c", 0.755, "indistinguishable"), ("d", 0.9, "better")):
        of = msgspec.structs.replace(change.against_reference, ratio=ratio, low=0.5, high=1.1, verdict=verdict)
        changes = (msgspec.structs.replace(change, against_reference=of),)
        rows.append(msgspec.structs.replace(second, label=label, name=label, changes=changes))
    close = msgspec.structs.replace(
        change.against_reference, ratio=0.98, low=0.7, high=1.3, verdict="indistinguishable"
    )
    pair = ComparedPair(model="c", other="b", seconds=2.0, ratio=close)
    answer = comparison_answer(msgspec.structs.replace(compared, models=(first, *rows), pairs=(pair,)))
    assert answer.startswith("Best 2 s ahead: (b) b. ")
    assert (
        "The error of (c) c is smaller still, but differs too much between the blocks of time for a verdict." in answer
    )
    assert "(d)" not in answer


@pytest.fixture(scope="module")
def validated(models: list[Path]) -> Path:
    """Return the folder of the good model with scales of its errors over 5 s and in simulation, but not of x."""
    folder = models[0].parent.parent / "validated"
    shutil.copytree(models[0].parent, folder)
    channels = ("psi", "r", "ax", "ay", "y", "vx", "vy")
    row = "{scale = 1.5, n_effective = 40.0, n_records = 1}"
    rows = "\n".join(f"{n} = {row}" for n in channels)
    text = (folder / "model.toml").read_text(encoding="utf-8")
    own = f"\n[intervals]\nhorizon = 5.0\n\n[intervals.ahead]\n{rows}\n\n[intervals.simulation]\n{rows}\n"
    (folder / "model.toml").write_text(text + own, encoding="utf-8")
    return folder


def test_intervals_are_those_of_an_unseen_run(
    validated: Path, models: list[Path], logs: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Over the horizon of the validation and in simulation, and nowhere else, intervals are widened."""
    both = st.compare({"plain": models[0], "validated": validated}, logs[2], horizon=[2.0, 5.0])
    plain, wide = both.result.models
    assert (plain.widened_horizons, plain.widened_simulation) == ((), False)
    assert (wide.widened_horizons, wide.widened_simulation) == ((5.0,), True)
    own, curves = both.predictions()["plain"], both.predictions()["validated"]
    known = ErrorScale(1.5, 40.0, 1)
    for horizon, factor in ((2.0, 1.0), (5.0, known.widening), ("simulation", known.simulation_widening)):
        for name, p in curves[horizon]["run3"].items():
            expected = own[horizon]["run3"][name].sd * (1.0 if name == "x" else factor)
            np.testing.assert_allclose(p.sd, expected, rtol=1e-6)
    frame = both.to_pandas().set_index(["kind", "model", "channel"])
    for kind in ("horizon", "simulation"):
        narrow, wider = (frame.loc[kind].loc[n][lambda x: x["seconds"] != 2.0] for n in ("plain", "validated"))
        assert (wider["inside_95"] >= narrow["inside_95"]).all()
        assert wider["inside_95"].mean() > narrow["inside_95"].mean()
    for name, p in curves[5.0]["run3"].items():
        inside = float(np.mean(np.abs(p.measured - p.predicted) < 1.96 * p.sd))
        shown = next(
            e.inside_95
            for row in both.result.channels
            for e in row.errors
            if (row.seconds, row.channel, e.model) == (5.0, name, wide.label)
        )
        assert shown == pytest.approx(inside, abs=2e-3)
    steps = frame.loc["one_step"]
    assert (steps.loc["plain", "inside_95"] == steps.loc["validated", "inside_95"]).all()
    assert steps["inside_95"].between(0.85, 1.0).all()
    text = " ".join(both.summary().split())
    assert "(a) those of the model itself" in text
    assert "(b) widened by its validation data: 5 s ahead, simulation; those of the model itself: 2 s ahead" in text
    assert text.count("in 95 %") == 4


def test_intervals_are_not_tested_by_the_log_that_widened_them(
    validated: Path, logs: list[Path], tmp_path: Path
) -> None:
    text = (validated / "model.toml").read_text(encoding="utf-8")
    digest = hashlib.sha256(logs[2].read_bytes()).hexdigest()[:16]
    known = f'[provenance]\nvalidation = ["other.mcap sha256:{digest}"]\n'
    (tmp_path / "model.toml").write_text(text.replace("[provenance]\n", known), encoding="utf-8")
    with pytest.warns(SeatrialWarning, match="the errors on run3 have widened the intervals of the model"):
        seen = st.compare(tmp_path, logs[2]).result
    assert seen.models[0].widened_by == ("run3",)
    assert [w.code for w in seen.warnings] == ["intervals-from-compared-log"]
    assert not st.compare(tmp_path, logs[1]).result.warnings


def test_part_of_a_log_that_a_model_was_fitted_to_is_recognised(logs: list[Path], tmp_path: Path) -> None:
    options: dict[str, Any] = {"model": "horizontal:shaft", "fixed": {"c1": 40.0, "c2": 1.1}, "score_tests": False}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SeatrialWarning)
        fitted = st.fit(st.open_log(logs[1], start=10.0, end=60.0), **options)
    saved = fitted.save(tmp_path / "fit")
    digest = hashlib.sha256(logs[1].read_bytes()).hexdigest()
    assert [(x.path, x.sha256) for x in fitted.result.logs] == [("run2.mcap[10:60]", digest)]
    assert digest[:10] in render(fitted.result)
    line = f"run2.mcap[10:60] sha256:{digest[:16]}"
    assert load_model(saved / "model.toml").provenance["logs"] == [line]
    # All times are those of the log, from 10 s on.
    times = [x.t for x in (*fitted.result.traces, *fitted.result.inputs, *fitted.result.residuals)]
    times += [x.t_horizon for x in fitted.result.traces]
    for found_series in (fitted.residuals(), fitted.predict(), fitted.simulate()):
        times += [series.t for by_channel in found_series.values() for series in by_channel.values()]
    with pytest.warns(SeatrialWarning, match="The model was fitted to run2"):
        seen = st.compare(saved, st.open_log(logs[1], start=10.0, end=60.0))
    for by_horizon in seen.predictions().values():
        times += [p.t for by_log in by_horizon.values() for by_name in by_log.values() for p in by_name.values()]
    times += [series.t for by_name in seen.residuals().values() for series in by_name.values()]
    assert min(float(t[0]) for t in times) == pytest.approx(10.0, abs=0.2)
    assert max(float(t[-1]) for t in times) == pytest.approx(60.0, abs=0.2)
    (tmp_path / "other").mkdir()
    renamed = shutil.copy(logs[1], tmp_path / "other" / "moved.mcap")
    same_name = shutil.copy(logs[2], tmp_path / "other" / "run2.mcap")
    cases: list[tuple[Path, TimeWindow, tuple[str, ...], int]] = [
        (logs[1], TimeWindow(), ("run2",), 0),
        (Path(renamed), TimeWindow(), ("moved",), 0),
        (logs[1], TimeWindow(40.0, 90.0), ("run2",), 0),
        (logs[1], TimeWindow(60.0, 110.0), (), 1),
        (Path(same_name), TimeWindow(), (), 0),
    ]
    for path, window, used, n_notes in cases:
        found = compare_models(CompareRequest([saved / "model.toml"], [path], (2.0,), window=window), "", Kept())
        assert found.models[0].fitted_to == used
        assert ("compared-on-fitted-log" in [w.code for w in found.warnings]) is bool(used)
        assert len([n for n in found.notes if "fitted to another part of run2 (10 s to 60 s)" in n]) == n_notes
    # A model file of an earlier version has no hash of a part of a log.
    old = tmp_path / "old" / "model.toml"
    shutil.copytree(saved, old.parent)
    old.write_text(old.read_text(encoding="utf-8").replace(line, "run2.mcap[10:60] sha256:"), encoding="utf-8")
    for window, used in ((TimeWindow(), ("run2",)), (TimeWindow(60.0), ())):
        model = load_model(old)
        assert used_logs(model, [load_run(logs[1], "compared", window)]) == used


def test_wrong_intervals_are_only_named_if_the_test_says_so() -> None:
    """Half of the errors are outside their intervals: many are a verdict, and a single slow error is none."""
    rng, t = np.random.default_rng(2), np.arange(0.0, 200.0, 0.1)
    quick, slow = 3.0 * rng.standard_normal(t.size), 3.0 * np.sin(t / 60.0)
    for z, verdict in ((quick, "overconfident"), (slow, "insufficient_data"), (quick / 3.0, "right")):
        e = errors(t, z)
        part = PredictedRecord(t, {"r": t.size}, t, {ONE_STEP: {"r": e}}, {}, {ONE_STEP: {"r": z}})
        tested = calibration_at(ONE_STEP, {"run": {"r": e}}, {"run": part})
        (row,) = channel_rows(ONE_STEP, [{"run": {"r": e}}], labels(1), {"r": "rad/s"}, {"r": 10.0}, [tested])
        assert row.errors[0].intervals == verdict
        assert row.errors[0].inside_95 == pytest.approx(float(np.mean(np.abs(z) < 1.96)), abs=1e-3)
    (row,) = channel_rows(ONE_STEP, [{"run": {"r": e}}], labels(1), {"r": "rad/s"}, {"r": 10.0})
    assert (row.errors[0].inside_95, row.errors[0].intervals) == (None, None)


def test_share_inside_useless_intervals_is_not_shown(compared: ComparisonResult) -> None:
    """All errors of a heading lie within a band of three turns, whatever the model predicts."""
    t = np.arange(0.0, 200.0, 0.1)
    e, sd = errors(t, np.sin(t / 60.0)), np.where(t < 50.0, 0.1, 5.0)
    for factor, shown in ((1.0, False), (0.1, True)):
        z, curve = {"psi": e.e / sd}, {"psi": Curve(t, e.e, factor * sd)}
        part = PredictedRecord(t, {"psi": t.size}, t, {SIMULATION: {"psi": e}}, {SIMULATION: curve}, {SIMULATION: z})
        tested = calibration_at(SIMULATION, {"run": {"psi": e}}, {"run": part})
        (row,) = channel_rows(SIMULATION, [{"run": {"psi": e}}], labels(1), {"psi": "rad"}, {"psi": 10.0}, [tested])
        assert (row.errors[0].inside_95 is None) is not shown
        assert row.errors[0].intervals is not None
        result = msgspec.structs.replace(compared, channels=(row,))
        assert (result.inside_95("simulation", None, "a") is None) is not shown
        names = [str(cell) for cell in compared_tables(result)[0].columns[0].cells]
        assert ("in 95 %" in names) is shown


WORDS_OF_A_COMPARISON = ("(a)", "best", "Best", "better", "worse", "differs", "Likelihood", "log score", "ratio")


def test_one_model_is_evaluated(
    validated: Path, models: list[Path], logs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(validated.parent)
    monkeypatch.setenv("COLUMNS", "80")
    judged = st.compare("validated", logs[2], horizon=5.0)
    (m,) = judged.result.models
    assert (m.label, m.name, judged.best) == ("a", "validated", "validated")
    rows = judged.to_pandas()
    assert len(rows) == 3 * 8
    ahead = rows[rows["seconds"] == 5.0]
    share = judged.result.inside_95("horizon", 5.0, "a")
    assert share is not None
    # The measure is that of the answer of a fit.
    fit = 1 - np.exp(np.log(1 - ahead["fit"]).mean())
    assert judged.answer.startswith(
        f"5 s ahead the fit of all channels is {100 * fit:.0f} % (1 - geometric mean of error / standard deviation of "
        f"8 channels); {100 * share:.0f} % of the errors of all channels lie inside the 95 % intervals."
    )
    assert st.compare([models[0]], logs[2]).result.models[0].widened_simulation is False
    capsys.readouterr()
    run("ident", "compare", "validated", "--on", logs[2], "--horizon", 5, "--out", tmp_path / "judged")
    text = capsys.readouterr().out
    assert max(len(line) for line in text.splitlines() if not line.startswith("report: ")) <= 80
    assert "5 s ahead the fit of all channels is" in " ".join(text.split())
    assert "inside the 95 %" in text
    page = (tmp_path / "judged/report.html").read_text(encoding="utf-8")
    shown = page[page.index("<body") : page.index("<script", page.index("<body"))]
    assert "Evaluation of a model" in shown
    assert "inside the 95 % interval" in shown.replace("\u00a0", " ")
    for word in WORDS_OF_A_COMPARISON:
        assert word not in text, word
        assert not re.search(rf">{re.escape(word)}|[ (]{re.escape(word)} ", shown), word
    again = read_result(tmp_path / "judged/result.json")
    assert isinstance(again, ComparisonResult)
    assert again.is_evaluation
    assert again.answer == judged.answer
    assert st.load(tmp_path / "judged").summary() == judged.summary()


def test_narrow_intervals_are_in_the_answer(compared: ComparisonResult) -> None:
    (first, _), rows = compared.models, []
    for row in compared.channels:
        verdict = "overconfident" if row.channel in ("r", "vx") else "insufficient_data"
        own = tuple(msgspec.structs.replace(e, intervals=verdict, inside_95=0.5) for e in row.errors)
        rows.append(msgspec.structs.replace(row, errors=own[:1]))
    one = msgspec.structs.replace(compared, models=(first,), channels=tuple(rows), traces=())
    assert comparison_answer(one).endswith("; 50 % of the errors of all channels lie inside the 95 % intervals. The "
                                           "intervals of r, vx are too narrow.")  # fmt: skip
    one = msgspec.structs.replace(one, answer=comparison_answer(one))
    assert text_of(one).count("too narrow") == 1 + 2 * 4 + 1
    page = render(one)
    assert "too few errors for a verdict" in page


def test_nested_models() -> None:
    small = horizontal_model("shaft")
    large = small + catalogue()["mismatch"]
    assert _is_nested(small, large)
    assert not _is_nested(large, small)
    assert not _is_nested(small, horizontal_model("command"))
    # The same structure with another arm is another model.
    arm: Parameter = large.parameter("y_left")
    assert not arm.free
    assert not _is_nested(small, large.replace_parameters(replace(arm, value=2 * arm.value)))
    assert _is_nested(small.with_free([n for n in small.free if n != "c2"]), small)
    assert _n_estimates(large, 1) == _n_estimates(small, 1) + 1
    own = sum(p.per_record and p.free for p in small.parameters)
    assert own > 0
    assert _n_estimates(small, 3) == _n_estimates(small, 1) + 2 * own


@pytest.fixture(scope="module")
def weedy_models(logs: list[Path], models: list[Path]) -> list[Path]:
    """Return the files of a model, and of one with an effect that has a parameter of its own for each log."""
    how: dict[str, Any] = {"model": "horizontal:shaft", "fixed": {"c1": 40.0, "c2": 1.1}, "score_tests": False}
    with warnings.catch_warnings(), quick_compilation(0):  # No other module fits this effect.
        warnings.simplefilter("ignore", SeatrialWarning)
        weedy = st.fit(logs[0], validate=logs[2], effects=["growing-drag"], **how)
    return [models[0], weedy.save(logs[0].parent / "weedy") / "model.toml"]


def test_effects_that_are_estimated_on_the_compared_log_are_named(logs: list[Path], weedy_models: list[Path]) -> None:
    """The errors of such a model are those of a fit. An effect that the user requested was selected by no log."""
    result = compare_models(CompareRequest(weedy_models, [logs[2]], (2.0,), names=("plain", "weedy")), "", Kept())
    assert [m.per_log for m in result.models] == [("V_x", "V_y"), ("V_x", "V_y", "g_before")]
    assert {w.code: w.text.partition(":")[0] for w in result.warnings} == {
        "effect-estimated-on-compared-log": "(b) estimates parameters of an effect anew on each compared log "
        "(g_before of growing-drag)",
        "intervals-from-compared-log": "the errors on run3 have widened the intervals of (b), so that the share of the "
        "errors inside is no test of the intervals. Compare on logs that no model has used.",
    }
    assert "Estimated anew for each compared log: (a) V_x, V_y; (b) V_x, V_y, g_before." in result.notes
    assert result.models[1].score is not None
    folders = [file.parent for file in weedy_models]
    message = r"its parameters differ between the fitted runs, and the model has their means \(g_before = \S+: \w"
    with pytest.warns(SeatrialWarning, match=message):
        st.linearise(folders[1], 0.5)
    with warnings.catch_warnings():
        warnings.simplefilter("error", SeatrialWarning)
        st.linearise(folders[0], 0.5)


@pytest.mark.parametrize("line", ['selected = ["growing-drag"]\n', ""], ids=["selected", "older file"])
def test_effects_that_a_validation_log_has_accepted_are_named(
    logs: list[Path], weedy_models: list[Path], tmp_path: Path, line: str
) -> None:
    """A log that selected the effects of a model is no unused log. A file without their names counts all effects."""
    text = weedy_models[1].read_text(encoding="utf-8")
    assert "\nselected = []\n" in text
    accepted = tmp_path / "model.toml"
    accepted.write_text(text.replace("selected = []\n", line), encoding="utf-8")
    request = CompareRequest([*weedy_models, accepted], [logs[2]], (2.0,), names=("plain", "requested", "accepted"))
    result = compare_models(request, "", Kept())
    (warning,) = (w for w in result.warnings if w.code == "compared-on-validation-log")
    assert warning.text.startswith("effects of (c), also those of the timing and mounting of sensors")
    assert [bool(m.selected_by) for m in result.models] == [False, False, True]


def test_selected_effects_are_those_of_a_diagnosis_and_the_common_errors() -> None:
    gains = dict.fromkeys(("gain", "df", "validation_gain", "t", "prediction"))
    common = CommonErrorsRow(names=("lift",), titles=("hull lift",), parameters=(), **gains)
    found = msgspec.structs.replace(loaded(KINDS["diagnosis"]()), common_errors=common)
    assert found.effects
    assert selected_effects(found) == [*(e.name for e in found.effects), "lift"]
    bench = KINDS["thruster"]()
    fitted = loaded({n: bench[n] for n in bench if n in VehicleResult.__struct_fields__} | {"kind": "vehicle"})
    assert selected_effects(msgspec.structs.replace(fitted, common_errors=common)) == ["lift"]
    assert selected_effects(msgspec.structs.replace(fitted, common_errors=None)) == []


def test_effects_with_parameters_of_a_log_are_compared_in_blocks(
    logs: list[Path], weedy_models: list[Path], compared: ComparisonResult
) -> None:
    """A long log is cut into the same blocks for all models, and no block is predicted with its own estimates."""
    reporter = Kept()
    result = compare_models(CompareRequest(weedy_models, [logs[1]], (2.0,), names=("plain", "weedy")), "", reporter)
    (warning,) = result.warnings
    assert warning.code == "compared-in-blocks"
    assert "(b) g_before of growing-drag. All models are therefore compared on 5 blocks in time" in warning.text
    assert result.models[1].score is not None
    assert (result.models[1].score.held_out, result.models[1].score.blocks) == (True, 10)  # two of 10 s in each block
    assert result.models[1].criteria is None
    assert {trace.record for trace in result.traces} == {"run2"}
    for trace in result.traces:
        for row in trace.predictions:
            assert np.all(np.diff(row.t) > 0.0)
            assert row.t[0] < 25.0 < 90.0 < row.t[-1]  # in the first block, and in the last one
    (simulated,) = (c for c in result.channels if (c.kind, c.channel) == ("simulation", "r"))
    (whole,) = (c for c in compared.channels if (c.kind, c.channel) == ("simulation", "r"))
    assert simulated.n < whole.n  # each block begins with 15 s of filtering
    page = render(result)
    assert "blocks in time of each log" in page


def test_estimates_of_a_block_come_from_the_other_blocks(logs: list[Path], weedy_models: list[Path]) -> None:
    """Wrong samples in one block change the parameter of the effect in the other blocks, and not in this one."""
    saved = load_model(weedy_models[1])
    (run,) = load_all([logs[1]], [])[0]
    model = replace(saved.model, second_order=False)
    record = make_record(model, run.run, 10.0)
    y = record.y.copy()
    y[record.t > 0.8 * record.t[-1] + 0.1, [record.outputs.index("vx")]] *= 0.5
    at = [p.name for p in model.parameters].index("g_before")
    found = []
    for r in (record, replace(record, y=y)):
        whole, _ = evaluate_records(model, [r])
        found.append([v.values[at] for v in evaluated_in_blocks(whole[0].model, whole, model.block)])
    before, after = np.array(found)
    assert before.size == 5
    moved = np.abs(after - before)
    assert moved[4] < 0.3 * moved[:4].min()


def test_logs_are_cut_only_for_effects_of_a_log_and_if_they_are_long_enough() -> None:
    plain, weedy = horizontal_model("shaft"), horizontal_model("shaft") + catalogue()["growing-drag"]
    t = 0.1 * np.arange(1201)
    record = build_record(
        plain, {n: Channel(t, np.zeros(t.size), "") for n in (*(i.name for i in plain.inputs), "psi")}
    )
    assert block_of_comparison([plain, plain], [[record]] * 2, (2.0,)) is None
    assert block_of_comparison([plain, weedy], [[record]] * 2, (2.0,)) == weedy.block
    assert block_of_comparison([plain, weedy], [[record]] * 2, (2.0, 10.0)) is None


def test_models_that_used_the_same_log_have_one_warning(compared: ComparisonResult) -> None:
    first, *_ = compared.models
    row = msgspec.structs.replace(first, fitted_to=("run1",), selected_by=("run3",), widened_by=())
    a, b, c = (msgspec.structs.replace(row, label=label) for label in "abc")
    c = msgspec.structs.replace(c, fitted_to=("run2",), selected_by=())
    texts = [w.text for w in compare._warnings([a, b, c])]
    assert [text.partition(".")[0] for text in texts] == [
        "(a) and (b) were fitted to run1: their errors there are smaller than on other logs",
        "(c) was fitted to run2: its errors there are smaller than on other logs",
        "effects of (a) and (b), also those of the timing and mounting of sensors and of the hull form, were accepted "
        "by run3: their errors there may be smaller than on other logs",
    ]
