"""Tests of the comparison of two campaigns: true changes are found, and boats that scatter give no false ones."""

from __future__ import annotations

import json
import math
import re
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import numpy as np
import pandas.testing
import pytest
import scipy.stats

import seatrial as st
from seatrial import command_line
from seatrial.daq.errors import SeatrialError
from seatrial.ident.estimation.standard_errors import AT_BOUND
from seatrial.ident.models.components import telemetry_age
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.report import write_report
from seatrial.ident.report.formatting import probability
from seatrial.ident.report.sections.campaigns import (
    _signed,
    absolute_change,
    change_of,
    effect_words,
    effects_caption,
)
from seatrial.ident.report.terminal import campaign_tables
from seatrial.ident.reporter import Quiet
from seatrial.ident.results import (
    CampaignErrors,
    CampaignsResult,
    CombinationDifference,
    ErrorComparison,
    NotCompared,
    campaigns_answer,
    write_result,
)
from seatrial.ident.results.campaigns import _with_interval, q_beside
from seatrial.ident.results.parts import CommonErrorsRow, EffectParameter
from seatrial.ident.results.result_file import read_result
from seatrial.ident.workflows.campaign_combinations import rounded_below
from seatrial.ident.workflows.campaign_errors import _campaign_values, _values_without
from seatrial.ident.workflows.campaign_fits import Comparison, _q_values, compare_fits
from seatrial.ident.workflows.campaign_logs import FittedLogs, fitted_logs
from seatrial.ident.workflows.changes import ChangesRequest, _notes_on_models, _with_common_errors
from seatrial.ident.workflows.fleet import SIDES, _effects_by_parameter
from seatrial.ident.workflows.vehicle import VehicleFit
from seatrial.ident.workflows.vehicle_model import VehicleRequest
from seatrial.mocks.plant.boat import draw_boat
from seatrial.mocks.plant.effect import HiddenEffect
from tests.ident.pages import browser, chromium
from tests.missions import boat_log, boat_with

pytestmark = pytest.mark.usefixtures("quick_compilation")

ROOT = Path(__file__).resolve().parents[3]
THRUST = ("--fix", "c1=40.05", "--fix", "c2=1.11")
FIXED = {"c1": 40.05, "c2": 1.11}
FASTER = 1.3  # drag after / before


def run(*words: object, status: int = 0) -> None:
    with pytest.raises(SystemExit) as left:
        command_line.main([str(w) for w in words])
    assert (left.value.code or 0) == status


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Path]]:
    """Return logs of a boat whose mass differs in each log: before, again without a change, and with more drag."""
    folder, boat, rng = tmp_path_factory.mktemp("campaigns"), boat_with(None, 5), np.random.default_rng(1)
    found: dict[str, list[Path]] = {}
    for k, (campaign, factor) in enumerate((("before", 1.0), ("same", 1.0), ("fouled", FASTER))):
        for n in range(3):
            mass = boat.hull.mass + rng.normal(0.0, 2.0)
            hull = replace(boat.hull, d_u=1.0, d_uu=factor * boat.hull.d_uu, mass=mass)
            path = folder / f"{campaign}{n}.mcap"
            found.setdefault(campaign, []).append(
                boat_log(path, replace(boat, hull=hull), 45.0, 10 * k + n, 10 * k + n)
            )
    return found


@pytest.mark.parametrize("n", [1, 2, 30])
def test_q_values_are_those_of_scipy(n: int) -> None:
    p = np.random.default_rng(n).random(n) ** 3
    np.testing.assert_allclose(_q_values(p), scipy.stats.false_discovery_control(p), rtol=1e-12)
    assert _q_values(np.full(n, 0.2)).tolist() == [0.2] * n


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("out")


@pytest.fixture(scope="module")
def fouled(logs: dict[str, list[Path]], folder: Path) -> CampaignsResult:
    """Compare the campaigns by the command, whose options take several words."""
    campaigns = ("--before", *logs["before"], "--after", *logs["fouled"])
    run("ident", "changes", *campaigns, *THRUST, "--jobs", 1, "--out", folder)
    result = read_result(folder / "result.json")
    assert isinstance(result, CampaignsResult)
    return result


def test_a_changed_drag_is_found_with_its_size(fouled: CampaignsResult) -> None:
    assert [p.name for p in fouled.changed] == ["d_uu"]
    (drag,) = fouled.changed
    assert drag.relative is not None
    assert drag.relative == pytest.approx(FASTER - 1.0, abs=0.06)
    assert drag.low is not None
    assert drag.high is not None
    truth = (FASTER - 1.0) * boat_with(None, 5).hull.d_uu
    assert drag.low < truth < drag.high
    assert (drag.before.n, drag.after.n, len(drag.logs)) == (3, 3, 6)
    assert "1 of 10 parameters and 1 of " in fouled.answer
    assert fouled.answer.startswith("The drag ahead at 0.9 m/s has grown by ")
    assert " have changed at a false discovery rate of 5 %. " in fouled.answer
    assert re.search(r" %\), \d\.\d\d N; d_uu \+\d\.\d\d kg/m \(95 %: \+\S+ to \+\S+\), \+\d\d %\. ", fouled.answer)
    assert fouled.joint is not None
    assert fouled.joint.p is not None
    assert fouled.joint.p < 0.01
    reasons = {p.name: p.reason for p in fouled.not_compared}
    assert reasons["c1"] == "held at its given value"
    assert reasons["V_x"] == "has its own value in each log"
    assert fouled.score_tests is False
    assert fouled.notes[-1].startswith("The fits have no score tests: all logs have the same model")


def test_a_changed_drag_is_named_at_a_speed_of_the_logs(fouled: CampaignsResult) -> None:
    (drag,) = fouled.changed_combinations
    assert (drag.name, drag.parameters, drag.unit) == ("drag ahead at 0.9 m/s", ("d_u", "d_uu"), "N")
    quadratic = 0.9**2 * boat_with(None, 5).hull.d_uu
    truth = (FASTER - 1.0) * quadratic
    assert drag.low is not None
    assert drag.high is not None
    assert drag.low < truth < drag.high
    assert drag.relative == pytest.approx(truth / (0.9 * 1.0 + quadratic), abs=0.06)
    parts = {p.name: p for p in fouled.parameters}
    assert drag.before.mean == pytest.approx(
        0.9 * parts["d_u"].before.mean + 0.9**2 * parts["d_uu"].before.mean, rel=0.02
    )


def test_table_of_what_was_not_compared_goes_by_the_code_and_not_by_the_words(fouled: CampaignsResult) -> None:
    codes = ("fixed", "per-log", "at-bound")
    rows = tuple(NotCompared(name=c, meaning="", code=c, reason=f"held for reason {c}") for c in codes)
    changed = msgspec.structs.replace(fouled, not_compared=rows)
    (table,) = [t for t in campaign_tables(changed) if str(t.title) == "Not compared"]
    assert [str(cell) for cell in table.columns[0].cells] == ["at-bound"]


def test_prediction_errors_fall_with_the_changed_parameter_alone(fouled: CampaignsResult) -> None:
    rows = {(e.logs, e.values): e for e in fouled.errors}
    assert set(rows) == {("before", "before"), ("after", "before"), ("after", "changed"), ("after", "after")}
    changed = rows["after", "changed"]
    assert changed.verdict == "fell"
    assert changed.ratio is not None
    assert changed.high is not None
    assert changed.ratio < changed.high < 0.9
    own = rows["before", "before"].channels["x"].after
    without, with_it = rows["after", "before"].channels["x"].after, changed.channels["x"].after
    assert own is not None
    assert without is not None
    assert with_it is not None
    assert without > 1.5 * with_it
    assert with_it < 2.0 * own  # as well as the logs before are predicted
    assert changed.channels["x"].before == pytest.approx(without)


def test_report_and_tables(fouled: CampaignsResult, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "Estimates of d_uu from each log" in page
    assert "Changes between campaigns" in page
    assert page.count("<td>before</td>") == 3
    from seatrial.api.messages import text_of

    text = text_of(fouled)
    (drag,) = fouled.changed
    size = absolute_change(drag)
    assert float(size) == pytest.approx(drag.difference, abs=0.1 * drag.se)
    assert size.startswith("+")
    assert re.search(rf"d_uu +\d.* {re.escape(size)} +kg/m +\+\d\d % \(\+\d\d to \+\d\d\) ", text)
    assert re.search(r"drag ahead at 0.9 m/s +\d.* \+\d\.\d+ +N +\+\d\d % \(\+\d\d to \+\d\d\) ", text)
    assert fouled.joint is not None
    assert f"All {len(fouled.joint.parameters)} parameters together: p " in text
    changes = text[text.index("Changes (") :]
    assert changes.index("d_uu") < changes.index("m_u")  # changed ones first
    name, cell = '<td class="symbol" data-title="parameter">', '<td class="num" data-title="change'
    assert page.index(f"{name}d_uu</td>") < page.index(f"{name}m_u</td>")
    assert (
        page.count('<table class="dense many stacked">') == 2
    )  # smaller letters in a wide window, lines in a narrow one
    # The deciding column is one of the first, which no window cuts.
    first = re.search(r"<thead><tr>(.*?)</tr>", page[page.index("combination of parameters") - 200 :], re.DOTALL)
    assert first is not None
    assert re.findall(r">([^<\n]*)</th>", first[1])[:4] == ["combination of parameters", "", "verdict", "q"]
    assert f'{cell}">{size}</td>{cell} (95 %)">+' in re.sub(r"\n *", "", page)
    assert "Prediction error (rms) 10 s ahead" in text
    assert "V_x" not in text


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")
def test_scatter_of_the_mass_is_no_change(logs: dict[str, list[Path]], folder: Path, fouled: CampaignsResult) -> None:
    """The fits of the logs before are those of the first comparison."""
    found = st.compare_campaigns(logs["before"], logs["same"], fixed=FIXED, out=folder, jobs=1)
    assert found.changed == []
    assert re.match(r"None of \d+ parameters has changed", found.answer)
    mass = next(p for p in found.result.parameters if p.name == "m_u")
    assert mass.scatter is not None
    assert 0.5 < mass.scatter < 5.0
    assert {e.values for e in found.result.errors} == {"before", "after"}
    frame = found.to_pandas()
    assert frame.loc["m_u", "scatter"] == mass.scatter
    assert not frame["changed"].any()
    assert repr(found).startswith("<CampaignComparison: 6 logs>\nNone of")
    saved = found.save(folder / "saved")
    assert sorted(p.name for p in saved.iterdir()) == ["report.html", "result.json"]
    assert list(st.load(saved).to_pandas().index) == list(frame.index)
    assert list(frame.index) == [p.name for p in (*found.result.combinations, *found.result.parameters)]
    assert "None of " in found.answer
    assert f" nor has any of {len(found.result.combinations)} combinations of them." in found.answer
    assert "All 10 parameters together: p " in found._repr_html_()
    assert "⚠ All" not in found._repr_html_()  # a note, which is no warning
    assert not frame[["difference", "relative"]].loc[["m_u"]].isna().any().any()
    shown = found._repr_html_()
    assert "<b>None of" in shown
    assert f"<td>{absolute_change(mass)}</td><td>kg</td>" in shown
    assert f"<td>m_u</td><td>{found.to_pandas().loc['m_u', 'before']:.4g}</td>" in shown
    before = {p.name: p.before for p in fouled.parameters}
    assert mass.before.mean == pytest.approx(before["m_u"].mean, rel=0.02)  # its weights include the scatter
    assert found.table.num_rows > 0
    saved = st.load(folder)
    with pytest.raises(
        SeatrialError, match=r"'campaigns' has no figure in Python; .* its figures are in .*report.html"
    ):
        st.load(folder).plot()
    pandas.testing.assert_frame_equal(saved.to_pandas(), frame, rtol=1e-5)  # result.json is rounded
    assert saved.summary() == found.summary()
    assert saved._repr_html_() == found._repr_html_()


def test_one_log_before_and_one_after_claim_nothing(logs: dict[str, list[Path]], folder: Path) -> None:
    with pytest.warns(st.SeatrialWarning) as caught:
        found = st.compare_campaigns(logs["before"][0], logs["fouled"][0], fixed=FIXED, out=folder, jobs=1)
    texts = [str(w.message) for w in caught if issubclass(w.category, st.SeatrialWarning)]
    assert found.result.warnings
    assert len(texts) == len(set(texts)) == len(found.result.warnings)
    assert found.answer.startswith("The scatter between logs is unknown with one log before and one after")
    drag = next(p for p in found.result.parameters if p.name == "d_uu")
    assert (drag.p, drag.q, drag.low, drag.scatter, drag.changed) == (None, None, None, None, False)
    assert drag.relative == pytest.approx(FASTER - 1.0, abs=0.15)
    # The only log after would be predicted by its own estimates.
    assert [(e.logs, e.values) for e in found.result.errors] == [("after", "before")]


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")
def test_the_page_runs_as_written(
    logs: dict[str, list[Path]],
    folder: Path,
    fouled: CampaignsResult,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The fits are in the folder already."""
    page = (ROOT / "docs/how-to/changes.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    for month, campaign in (("may", "before"), ("june", "fouled")):
        (tmp_path / month).mkdir()
        for log in logs[campaign]:
            shutil.copy(log, tmp_path / month)
    (tmp_path / "changes").mkdir()
    shutil.copy(folder / "fits.parquet", tmp_path / "changes")
    monkeypatch.chdir(tmp_path)
    exec(compile(block, "changes.md", "exec"), {"__name__": "page"})
    shown = capsys.readouterr().out
    assert "['drag ahead at 0.9 m/s', 'd_uu']" in shown
    assert f" {fouled.answer[:40]}" in shown
    assert (tmp_path / "changes/report.html").exists()


def test_a_log_in_both_campaigns_is_an_error(
    logs: dict[str, list[Path]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--before", logs["before"][0], logs["same"][0], "--after", logs["same"][0], "--out", tmp_path / "x")
    run("ident", "changes", *words, status=1)
    assert "is in both campaigns" in capsys.readouterr().err
    run("ident", "changes", "--before", logs["before"][0], "--out", tmp_path / "x", status=2)
    assert "--after" in capsys.readouterr().err
    with pytest.raises(SeatrialError, match="false_discovery_rate=0: give a number above 0"):
        st.compare_campaigns(logs["before"], logs["same"], false_discovery_rate=0.0)
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"no log")
    with pytest.raises(SeatrialError, match=r"no fit to a log after has converged; .*broken.mcap: "):
        st.compare_campaigns(logs["before"][0], broken, fixed=FIXED, out=logs["before"][0].parent / "half", jobs=1)


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")
def test_a_saved_model_is_fitted_again(logs: dict[str, list[Path]], tmp_path: Path) -> None:
    first = st.fit(logs["before"][0], fixed=FIXED, score_tests=False)
    first.save(tmp_path / "model")
    again = st.fit(logs["before"][0], model=str(tmp_path / "model/model.toml"), score_tests=False)
    assert again.params["m_u"] == pytest.approx(first.params["m_u"], rel=1e-3)
    assert again.params["c1"] == FIXED["c1"]
    assert "c1" not in again.standard_errors
    other = st.fit(logs["fouled"][0], model=str(tmp_path / "model/model.toml"), score_tests=False)
    assert other.params["d_uu"] > 1.1 * first.params["d_uu"]


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")
def test_common_errors_of_the_logs_before_are_in_the_model_of_all(logs: dict[str, list[Path]], tmp_path: Path) -> None:
    """A continued run takes the common errors of the fit in its folder, and starts at its estimates."""
    fit = st.fit(logs["before"][0], fixed=FIXED, effects=["lever-arm"], score_tests=False).result
    arm = tuple(
        EffectParameter(name=p.name, meaning=p.meaning, unit=p.unit, value=p.value, se=p.se)
        for p in fit.fit.parameters
        if p.name in ("l_x", "l_y")
    )
    common = CommonErrorsRow(
        names=("lever-arm",), titles=("",), gain=None, df=None, validation_gain=None, t=None, prediction=None,
        parameters=arm,
    )  # fmt: skip
    (tmp_path / "before").mkdir()
    write_result(msgspec.structs.replace(fit, common_errors=common), tmp_path / "before/result.json")
    vehicle = VehicleRequest((), (), Path(), fixed=FIXED, score_tests=False)
    request = ChangesRequest(logs["before"], logs["same"], vehicle, tmp_path)
    changed, names = _with_common_errors(request, logs["before"], Quiet())
    assert names == changed.effects == ("lever-arm",)
    assert changed.initial == pytest.approx({p.name: p.value for p in arm}, rel=1e-5)
    assert not changed.score_tests

    found = st.compare_campaigns(logs["before"][:2], logs["same"][:2], fixed=FIXED, out=tmp_path, jobs=1)
    assert found.result.common_errors == ("lever-arm",)
    assert {"l_x", "l_y"} <= {p.name for p in found.result.parameters}
    assert any("the 1 common error of sensors and hull form" in note for note in found.result.notes)
    plain = st.compare_campaigns(
        logs["before"][:2], logs["same"][:2], fixed=FIXED, out=tmp_path / "plain", jobs=1, common_errors=False
    )
    assert plain.result.common_errors == ()
    assert "l_x" not in {p.name for p in plain.result.parameters}
    assert not (tmp_path / "plain/before").exists()


def test_logs_that_cannot_be_fitted_together_are_fitted_without_common_errors(tmp_path: Path) -> None:
    class Heard(Quiet):
        def warning(self, text: str) -> None:
            texts.append(text)

    texts = list[str]()
    (tmp_path / "broken.mcap").write_bytes(b"no log")
    vehicle = VehicleRequest((), (), Path(), score_tests=False)
    request = ChangesRequest((tmp_path / "broken.mcap",), (), vehicle, None)
    assert _with_common_errors(request, request.before, Heard()) == (vehicle, ())
    assert texts[0].startswith("the logs before cannot be fitted together to find common errors: ")


def rows_of(
    values: Mapping[str, Any], errors: float = 0.1, parts: Mapping[str, Any] | None = None, **more: Any
) -> list[dict[str, Any]]:
    """Return rows of the table for logs run0, run1, ... with values by name, an array for each parameter."""
    n = len(next(iter(values.values())))
    plain = {"meaning": "", "unit": "", "effect": None, "nuisance": False, "free": True, "per_log": False, "flag": None,
             "origin": "estimated", "converged": True, "message": "", "error": None, "duration": 60.0,
             "correlations": "{}", "prior_parts": json.dumps(parts or {})}  # fmt: skip
    return [
        plain
        | {"log": f"run{k}", "sha256": str(k), "parameter": name, "value": float(of[k]), "se": errors}
        | {key: value.get(name, plain[key]) for key, value in more.items()}
        for k in range(n)
        for name, of in values.items()
    ]


def compared(rows: list[dict[str, Any]], n_before: int) -> Comparison:
    return compare_fits(fitted_logs(rows, {str(k) for k in range(n_before, 100)}))


def test_false_discovery_rate_is_held() -> None:
    """Three of twelve parameters change, and all scatter between the logs."""
    rng = np.random.default_rng(6)
    share, power = [], []
    changed = {"p0", "p1", "p2"}
    for _ in range(30):
        scatter = rng.uniform(0.0, 0.3, 12)
        values = {
            f"p{j}": 5.0 + np.hypot(0.1, s) * rng.normal(size=10) + (np.arange(10) >= 5) * 1.5 * (j < 3)
            for j, s in enumerate(scatter)
        }
        found = {p.name for p in compared(rows_of(values), 5).parameters if p.changed}
        share.append(len(found - changed) / max(len(found), 1))
        power.append(len(found & changed) / 3)
    assert np.mean(share) <= 0.05 + 2 * np.std(share) / len(share) ** 0.5
    assert np.mean(power) > 0.9


def test_sensors_and_surroundings_do_not_hide_a_change_of_the_boat() -> None:
    """A difference of the boat with p = 0.004 has the same q value with fifteen parameters of sensors and of wind."""
    rng = np.random.default_rng(8)
    values = {f"p{j}": 5.0 + 0.1 * rng.normal(size=6) for j in range(3)}
    values["p0"][3:] += 0.35
    sensors = {f"s{j}": 5.0 + 0.1 * rng.normal(size=6) for j in range(12)}
    wind = {f"w{j}": 5.0 + 0.1 * rng.normal(size=6) for j in range(3)}
    effects = {"effect": dict.fromkeys(sensors, "compass") | dict.fromkeys(wind, "wind")}
    alone = {p.name: p for p in compared(rows_of(values), 3).parameters}
    beside = {p.name: p for p in compared(rows_of(values | sensors | wind, **effects), 3).parameters}
    assert 0.002 < (alone["p0"].p or 0.0) < 0.01
    assert beside["p0"].changed
    assert [beside[n].q for n in values] == [alone[n].q for n in values]
    assert {p.family for p in beside.values()} == {"coefficients", "surroundings"}
    assert {p.name for p in beside.values() if p.family == "coefficients"} == set(values)


def test_a_load_changes_the_mean_of_both_masses() -> None:
    """Both masses grow by 9 kg with errors of 3 kg; their mean has an error smaller by the square root of two."""
    rng, after = np.random.default_rng(2), np.arange(6) >= 3
    values = {n: x + 9.0 * after + 0.5 * rng.normal(size=6) for n, x in (("m_u", 40.0), ("m_v", 60.0))}
    found = compared(rows_of(values, 3.0), 3)
    (load,) = found.combinations
    assert (load.name, load.parameters) == ("mass, mean of m_u, m_v", ("m_u", "m_v"))
    assert load.difference == pytest.approx(9.0, abs=1.0)
    assert load.se == pytest.approx(3.0 / 2**0.5 * (2 / 3) ** 0.5, rel=0.02)
    assert load.p is not None
    assert load.p < min(p.p or 0.0 for p in found.parameters)


@pytest.mark.parametrize("n", [2, 3, 5])
def test_a_difference_has_changed_if_it_is_at_least_the_detectable_one(n: int) -> None:
    """One parameter at a time gets a difference on both sides of the limit, with the others as they are."""
    rng = np.random.default_rng(n)
    values = {f"p{j}": 50.0 + rng.normal(size=2 * n) + (np.arange(2 * n) >= n) * 9.0 * (j < 3) for j in range(8)}
    for p in compared(rows_of(values), n).parameters:
        assert p.detectable is not None
        assert p.changed == (abs(p.difference) >= p.detectable)
        for factor, changed in ((1.01, True), (0.99, False)):
            moved = values[p.name] + (np.arange(2 * n) < n) * (p.difference - factor * p.detectable)
            (found,) = [x for x in compared(rows_of(values | {p.name: moved}), n).parameters if x.name == p.name]
            assert found.changed is changed


def test_few_logs_are_the_reason_of_a_large_difference_that_is_no_change() -> None:
    d_u = np.array([10.0, 11.0, 15.0, 16.5])
    values = {"d_u": d_u, "m_u": np.array([30.0, 31.0, 30.2, 30.9]), "a": np.array([0.2, -0.2, 0.9, 0.4])}
    found = compared(rows_of(values), 2)
    of = {p.name: p for p in found.parameters}
    drag = of["d_u"]
    assert not drag.changed
    assert drag.detectable == pytest.approx(drag.se * scipy.stats.t.ppf(1 - 0.05 / 2 / 2, 2))
    (note,) = found.notes
    assert note.startswith(
        "Few logs make the intervals wide: with 2 before and 2 after, Student's t has 2 degrees of freedom, and the 95 "
        "% intervals are 2.2 times as wide as with many logs. Twice as many logs would make them about 0.4 times as "
    )
    assert f": d_u +50 % (from {100 * drag.detectable / drag.before.mean:.0f} % on), a +0.65 (from " in note
    assert "m_u" not in note  # its difference is smaller than its standard error
    more = compared(rows_of({name: np.tile(v.reshape(2, 2), 2).ravel() for name, v in values.items()}), 4)
    assert not more.notes  # with eight logs, the number of logs is not the reason


def test_parameters_that_cannot_be_compared_have_a_reason() -> None:
    values = {n: np.full(4, 1.0) for n in ("bound", "held", "current", "thrust", "lost", "good")}
    rows = rows_of(values, free={"held": False}, origin={"held": "measured"}, per_log={"current": True})
    for r in rows:
        if r["parameter"] == "bound" and r["log"] == "run3":
            r |= {"se": None, "flag": AT_BOUND}
        if r["parameter"] == "lost" and r["log"] in ("run2", "run3"):
            r |= {"se": None, "flag": "the data do not depend on it"}
        if r["parameter"] == "thrust":
            r |= {"prior_parts": json.dumps({"thrust": 0.09})}
    found = compared(rows, 2)
    assert [p.name for p in found.parameters] == ["good"]
    assert {p.name: p.reason for p in found.not_compared} == {
        "bound": "at its bound in 1 of 2 logs after",
        "held": "held at its measured value",
        "current": "has its own value in each log",
        "thrust": "known mainly from its prior (81 % of the information)",
        "lost": "no log after determines it",
    }
    assert {p.name: p.code for p in found.not_compared} == {
        "bound": "at-bound",
        "held": "fixed",
        "current": "per-log",
        "thrust": "mainly-prior",
        "lost": "undetermined",
    }
    assert found.notes == (
        "The priors of thrust are the same for both campaigns. If one of these has changed, the change appears in "
        "other parameters.",
    )


def test_only_changes_of_positive_values_are_relative() -> None:
    """Per cent of a negative value would read as a growth where its size falls."""
    after, noise = np.arange(6) >= 3, 0.02 * np.random.default_rng(9).normal(size=6)
    found = {p.name: p for p in compared(rows_of({"a": 3.0 + after + noise, "b": noise + after - 3.0}), 3).parameters}
    assert found["a"].relative == pytest.approx(1 / 3, abs=0.02)
    assert found["b"].relative is None
    assert found["b"].difference == pytest.approx(1.0, abs=0.05)


@browser
def test_tables_of_changes_fit_into_a_window_of_1400_pixels(tmp_path: Path) -> None:
    """The numbers have as many digits as those of a boat with nine common errors."""
    rng = np.random.default_rng(3)
    rows = damped_rows(rng, 3, 1.4)
    small = rows_of({"A_axy": 0.00044 + 0.00031 * rng.normal(size=6), "e_xy": 0.02028 + 0.00035 * rng.normal(size=6)})
    rows += [r | SPEEDS | {"se": 0.00031, "unit": "kg m2/s"} for r in small]
    write_report(result_of(compared(rows, 3)), tmp_path / "report.html")
    measure = "[...document.querySelector('iframe').contentDocument.querySelectorAll('.scroller')]"
    script = (  # in a frame, as the page runs no scripts but its own
        "addEventListener('load', () => { document.title = 'hidden: ' + "
        f"{measure}.map((x) => x.scrollWidth - x.clientWidth).join(' '); }});"
    )
    frame = tmp_path / "frame.html"
    style = "width: 1400px; height: 2000px; border: 0"
    frame.write_text(f'<iframe src="report.html" style="{style}"></iframe><script>{script}</script>', encoding="utf-8")
    shown = chromium(tmp_path, "--window-size=1500,2000", "--dump-dom", frame.as_uri()).stdout
    hidden = re.search(r"<title>hidden: ([\d ]+)</title>", shown)
    assert hidden is not None
    assert set(hidden[1].split()) == {"0"}


def test_effects_of_the_model_are_present_or_not() -> None:
    rng = np.random.default_rng(7)
    after = np.arange(8) >= 4
    names = {"k_T": "mismatch", "w": "wind"}
    values = {"k_T": 0.5 * after + 0.02 * rng.normal(size=8), "w": 3.0 + 0.02 * rng.normal(size=8)}
    found = compared(rows_of(values, 0.02, effect=names), 4)
    assert {(e.name, e.before, e.after, e.changed) for e in found.effects} == {
        ("mismatch", False, True, True),
        ("wind", True, True, False),
    }


@pytest.mark.parametrize(("difference", "said"), [(0.5, True), (0.0, False)])
def test_a_difference_of_the_sides_in_some_logs_is_told_if_a_campaign_has_it(difference: float, said: bool) -> None:
    """The note stood beside a table in which the difference is significant in neither campaign."""
    rng = np.random.default_rng(7)
    values = {"k_T": difference * (np.arange(8) >= 4) + 0.02 * rng.normal(size=8), "m_u": np.full(8, 40.0)}
    rows = rows_of(values, 0.02, effect={"k_T": "mismatch"})
    rows[-1]["prior_parts"] = json.dumps({SIDES: 0.01})
    notes = compared(rows, 4).notes
    assert any(note.startswith("The thrusts of both sides differ in some logs") for note in notes) == said


@pytest.mark.parametrize(
    ("value", "error", "after"), [(0.015, 0.019, False), (0.015, 0.004, None), (0.015, None, None)]
)
def test_an_effect_at_its_bound_in_some_logs_is_not_significant(
    value: float, error: float | None, after: bool | None
) -> None:
    """A log that leaves the bound by less than two standard errors shows no effect either."""
    rows = rows_of({"T_psi": np.array([0.0, 0.0, 0.0, value])}, effect={"T_psi": "heading-lag"})
    for r in rows:
        r |= {"se": error} if r["log"] == "run3" else {"se": None, "flag": f"{AT_BOUND} 0, the lowest possible value"}
    (found,) = compared(rows, 2).effects
    assert (found.before, found.after, found.changed) == (False, after, False)


def test_a_common_error_of_the_nominal_model_is_an_effect_of_the_table() -> None:
    """The age of the telemetry is an offset of a sensor for the filter, and an effect for the user."""
    model = horizontal_model("shaft") + telemetry_age()
    fit = SimpleNamespace(model=model)
    done = SimpleNamespace(fitted=SimpleNamespace(fit=fit))
    assert _effects_by_parameter(cast("VehicleFit", done)) == {"tau_age": "telemetry-age"}


@pytest.mark.parametrize("payload", [False, True])
def test_a_changed_thrust_is_a_common_factor(payload: bool) -> None:
    """All masses and damping become smaller by the factor by which the thrust becomes larger; a payload does not."""
    rng = np.random.default_rng(8)
    after = np.arange(6) >= 3
    truth = {"m_u": 40.0, "m_v": 50.0, "m_r": 10.0, "d_uu": 25.0, "d_r": 5.0}
    units = {"m_u": "kg", "m_v": "kg", "m_r": "kg m2", "d_uu": "kg/m", "d_r": "kg m2/s"}
    factor = {n: np.where(after, 1.3 if n in ("m_u", "m_v") else 1.0, 1.0) for n in truth}
    if not payload:
        factor = {n: np.where(after, 1.0 / 1.2, 1.0) for n in truth}
    values = {n: v * factor[n] * (1.0 + 0.01 * rng.normal(size=6)) for n, v in truth.items()}
    rows = rows_of(values, unit=units)
    for r in rows:
        r["se"] = 0.01 * truth[r["parameter"]]
    found = compared(rows, 3).common_factor
    assert found is not None
    assert set(found.parameters) == set(truth)
    assert found.explains is not payload
    if not payload:
        assert found.low < 1.0 / 1.2 < found.high


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1.2, "68 % of its thrust of before, and the right one all of it (99 %, 95 %: 98 to 100 %)"),
        (1.0, "68.6 ± 0.4 % of the thrust of the right one, before 100 % (eps_LR -0.188, 95 %: -0.196 to -0.179)"),
    ],
)
def test_a_lost_thrust_of_one_side_is_stated_in_words(factor: float, words: str) -> None:
    """The masses of a boat whose left thruster has lost a third seem to grow, as the thrust is taken as given."""
    rng, n = np.random.default_rng(8), 8
    after = np.arange(n) >= 4
    truth = {"m_u": 40.0, "m_v": 60.0, "m_r": 9.0, "d_uu": 25.0}
    values = {k: v * np.where(after, factor, 1.0) * (1.0 + 0.01 * rng.normal(size=n)) for k, v in truth.items()}
    values["eps_LR"] = -0.185 * after + 0.002 * rng.normal(size=n)
    units = {"m_u": "kg", "m_v": "kg", "m_r": "kg m2", "d_uu": "kg/m", "eps_LR": ""}
    rows = rows_of(values, 0.005, effect={"eps_LR": "mismatch"}, unit=units)
    for r in rows:
        r["se"] = 0.005 if r["parameter"] == "eps_LR" else 0.01 * r["value"]
    found = compared(rows, 4)
    result = result_of(found)
    assert f"the left thruster gives {words}." in campaigns_answer(result).replace("The left", "the left")


def test_masses_that_change_by_one_factor_are_named_though_the_scale_hides_each_of_them() -> None:
    rng, n = np.random.default_rng(9), 6
    after = np.arange(n) >= 3
    truth = {"m_u": 40.0, "m_v": 60.0, "m_r": 9.0, "d_uu": 25.0}
    values = {k: v * np.where(after, 1.2, 1.0) * (1.0 + 0.01 * rng.normal(size=n)) for k, v in truth.items()}
    values["eps_LR"] = -0.185 * after + 0.002 * rng.normal(size=n)
    units = {"m_u": "kg", "m_v": "kg", "m_r": "kg m2", "d_uu": "kg/m", "eps_LR": ""}
    rows = rows_of(values, 0.005, effect={"eps_LR": "mismatch"}, unit=units)
    for r in rows:
        own = 0.005 if r["parameter"] == "eps_LR" else 0.01 * r["value"]
        part = 0.19 * r["value"] if r["log"] >= "run3" and r["parameter"] != "eps_LR" else 0.0
        r |= {"se": float(np.hypot(own, part)), "prior_parts": json.dumps({SIDES: part} if part else {})}
    answer = campaigns_answer(result_of(compared(rows, 3)))
    assert answer.startswith(
        "The left thruster gives 68.7 ± 0.4 % of the thrust of the right one, before 100 % (eps_LR -0.18"
    )
    assert " 1 of 5 parameters has changed at a false discovery rate of 5 %. " in answer
    assert "Masses and damping together have changed by one factor of 1.202 (" in answer
    assert "the left thruster gives 68 % of its thrust of before" in answer


def test_sides_that_may_deviate_are_a_common_error_of_their_logs() -> None:
    values = {"m_u": np.array([40.0, 40.4, 48.0, 48.6])}
    rows = rows_of(values, 0.4)
    for r in rows:
        if r["log"] in ("run2", "run3"):
            r |= {"se": 9.2, "prior_parts": json.dumps({SIDES: 9.19})}
    found = compared(rows, 2)
    (mass,) = found.parameters
    assert 48.0 <= mass.after.mean <= 48.6
    assert mass.se == pytest.approx(9.2, abs=0.2)
    assert not mass.changed
    assert any("which side deviates" in note for note in found.notes)


@pytest.mark.parametrize(("effect", "said"), [("wind", True), ("mismatch", False), ("compass", False)])
def test_wind_of_a_campaign_is_said_to_be_no_change_of_the_boat(effect: str, said: bool) -> None:
    rows = rows_of({"m_u": np.full(4, 40.0), "p": np.array([1.0, 1.2, 3.0, 3.1])}, effect={"p": effect})
    notes = [
        note for note in compared(rows, 2).notes if "Effects of the surroundings, with values of their own" in note
    ]
    assert len(notes) == said
    assert all("in each log: wind. A difference between the campaigns is one of the weather" in note for note in notes)


def test_a_change_that_is_not_relative_has_its_unit_and_an_effect_without_verdict_its_reason() -> None:
    """The mean before is about zero, so that the change stands beside others in per cent."""
    values = {"dev_f2s": np.array([0.001, -0.0012, 0.0002, 0.021, 0.0195, 0.0205]), "k_J": np.zeros(6)}
    kinds = {"unit": {"dev_f2s": "rad", "k_J": "kg/s"}, "effect": {"dev_f2s": "compass", "k_J": "advance-ratio"}}
    rows = rows_of(values, 0.001, flag={"k_J": "half of its information comes from its prior"}, **kinds)
    for r in rows:
        if r["parameter"] == "k_J":
            r |= {"free": True, "flag": "at its bound", "se": None} if r["log"] != "run0" else {"value": 0.5}
    found = compared(rows, 3)
    (deviation,) = (p for p in found.parameters if p.name == "dev_f2s")
    assert deviation.relative is None
    assert re.fullmatch(r"\+1\.1\d* deg \(\+.* to \+.*\)", change_of(deviation))
    result = result_of(found, ())
    unknown = [e.name for e in result.effects if None in (e.before, e.after)]
    assert unknown == ["advance-ratio"]
    assert "not compared" in effect_words(result.effects[1], result)
    table = next(t for t in campaign_tables(result) if "Effects" in str(t.title))
    assert " Not compared: no parameter of the effect could be tested" in str(table.caption)
    present = msgspec.structs.replace(result.effects[0], before=True)
    assert effects_caption(msgspec.structs.replace(result, effects=(present,))) == ""


def test_a_model_without_common_errors_has_a_note() -> None:
    """Small errors of sensors can hide changes, and only the model of a diagnosis gives its sizes of effects."""
    vehicle = VehicleRequest((), (), Path(), effects=("mismatch",), score_tests=False)
    (note,) = _notes_on_models(vehicle, ())
    assert "The size of mismatch can differ from that of a diagnosis" in note
    (plain,) = _notes_on_models(replace(vehicle, effects=()), ())
    assert "The size of" not in plain
    for n in (note, plain):
        assert n.startswith("The model has no common errors of sensors and hull form, which can hide changes.")
        assert n.endswith("--model of a fit or a diagnosis of the logs before (before/model.toml).")
    for same in (replace(vehicle, score_tests=True), replace(vehicle, model="diagnosis/model.toml")):
        assert not _notes_on_models(same, ())


@pytest.mark.parametrize(("model", "verdict", "asked"), [
    ("auto", "unchanged", True), ("auto", "rose", True), ("auto", "fell", False), ("before/model.toml", "rose", False),
])  # fmt: skip
def test_changes_that_do_not_help_the_prediction_ask_for_a_model_with_common_errors(
    model: str, verdict: Any, asked: bool
) -> None:
    errors = CampaignErrors(logs="after", values="changed", channels={}, ratio=1.1, low=0.9, high=1.3, verdict=verdict)
    result = result_of(compared(rows_of({"m_u": np.full(4, 40.0)}), 2), (errors,))
    answer = campaigns_answer(msgspec.structs.replace(result, model=model))
    assert ("compare with that model: --model before/model.toml." in answer) is asked


@pytest.mark.parametrize(
    ("load", "thrust", "words"),
    [(22.0, 1.0, "grown by about the same mass (2"), (-22.0, 1.0, "fallen by about the same mass (2"), (0.0, 1.13, "")],
)
def test_a_load_adds_the_same_mass_in_surge_and_sway(load: float, thrust: float, words: str) -> None:
    rng, n = np.random.default_rng(3), 8
    after = np.arange(n) >= 4
    truth = {"m_u": 150.0, "m_v": 240.0, "m_r": 76.0, "d_uu": 38.0, "d_r": 25.0}
    added = {"m_u": load, "m_v": load, "m_r": 0.35 * load, "d_uu": 16.0}
    values = {
        k: (v + after * added.get(k, 0.0)) * np.where(after, thrust, 1.0) + 0.004 * v * rng.normal(size=n)
        for k, v in truth.items()
    }
    rows = rows_of(values, unit=dict.fromkeys(truth, "kg"))
    for r in rows:
        r["se"] = 0.004 * truth[r["parameter"]]
    answer = campaigns_answer(result_of(compared(rows, 4)))
    assert ("by about the same mass" in answer) is bool(words)
    assert words in answer


@pytest.mark.parametrize(("thrust", "errors", "said"), [(1.0, 1.0, True), (1.13, 1.0, False), (1.0, 4.0, False)])
def test_a_load_near_the_centre_of_gravity_is_told_by_the_inertia(thrust: float, errors: float, said: bool) -> None:
    """The shares of m_u (+21 %) and m_v (+13 %) alone do not exclude another thrust; that of m_r (+0 %) does."""
    truth, n = {"m_u": 69.5, "m_v": 101.8, "m_r": 19.4}, 6
    after, noise = np.arange(n) >= 3, np.array([-1.0, 0.0, 1.0, 1.0, 0.0, -1.0])
    added = {"m_u": 14.0, "m_v": 14.0, "m_r": 0.0}
    if thrust != 1.0:
        added = dict.fromkeys(truth, 0.0)
    values = {
        k: (v + after * added[k]) * np.where(after, thrust, 1.0) + (0.01 if k == "m_r" else 0.025) * errors * v * noise
        for k, v in truth.items()
    }
    rows = rows_of(values, unit=dict.fromkeys(truth, "kg"))
    for r in rows:
        r["se"] = 0.005 * truth[r["parameter"]]
    answer = campaigns_answer(result_of(compared(rows, 3)))
    words = "and m_r has not changed: as a load of about 14 kg near the centre of gravity would."
    assert (words in answer) is said


def test_a_changed_parameter_has_its_unit_and_per_cent() -> None:
    values = {"m_u": np.array([69.0, 70.0, 83.5, 84.5]), "m_v": np.array([100.0, 101.0, 100.5, 100.2])}
    found = compared(rows_of(values, unit=dict.fromkeys(values, "kg")), 2)
    answer = campaigns_answer(result_of(found))
    assert re.search(r"m_u \+14\.\d+ kg \(95 %: \+1\d\S* to \+1\d\S*\), \+21 %", answer)
    damped = result_of(compared(damped_rows(np.random.default_rng(4), 4, 0.6), 4))
    combinations, *_ = campaign_tables(damped)
    assert str(combinations.title) == "Combinations of parameters"
    assert "change" in [c.header for c in combinations.columns]
    rows = [
        CampaignErrors(logs="after", values="changed", channels={}, ratio=0.97, low=0.95, high=0.997, verdict="fell")
    ]
    said = campaigns_answer(result_of(found, tuple(rows)))
    assert "falls with the changed parameters: -3.0 % (95 %: -5.0 to -0.3 %)." in said
    rows = [msgspec.structs.replace(rows[0], high=0.9996)]
    said = campaigns_answer(result_of(found, tuple(rows)))
    assert "falls with the changed parameters: -3.00 % (95 %: -5.00 to -0.04 %)." in said


def test_logs_after_that_no_values_predict_ask_for_a_diagnosis() -> None:
    def errors(logs: Any, after: float) -> CampaignErrors:
        row = ErrorComparison(before=None, after=after, unit="rad", spread=1.6)
        return CampaignErrors(logs=logs, values=logs, channels={"psi": row})

    for size, asked in ((0.7, True), (0.3, False)):
        answer = campaigns_answer(
            result_of(compared(rows_of({"m_u": np.full(4, 40.0)}), 2), (errors("before", 0.27), errors("after", size)))
        )
        assert ("psi: its error is 2.6 times as large" in answer) is asked
        assert ("Run `seatrial ident diagnose` on the logs after" in answer) is asked


def test_a_log_that_cannot_be_predicted_is_in_the_result(
    logs: dict[str, list[Path]], folder: Path, fouled: CampaignsResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(model: Any, values: Any) -> Any:
        raise SeatrialError("parameter d_u: -1 is outside its bounds")

    assert fouled.unpredicted == ()
    monkeypatch.setattr("seatrial.ident.workflows.campaign_errors.model_values", refused)
    names = [str(x) for x in (*logs["before"], *logs["fouled"])]
    with pytest.warns(st.SeatrialWarning):
        found = st.compare_campaigns(logs["before"], logs["fouled"], fixed=FIXED, out=folder, jobs=1)
    assert sorted(x.log for x in found.result.unpredicted) == sorted(names)
    assert found.result.errors == ()
    assert "6 logs could not be predicted, so that the check of the changes by their prediction is" in found.answer
    assert "d_u: -1 is outside its bounds" in found.answer
    (table,) = [t for t in campaign_tables(found.result) if str(t.title) == "Not predicted"]
    assert len(table.rows) == 6
    page = (found.save(folder / "unpredicted") / "report.html").read_text(encoding="utf-8")
    assert "Logs without a prediction" in page


@pytest.mark.parametrize(
    ("own", "verdict", "spread", "asked"),
    [
        (0.40, "unchanged", 1.6, True),
        (0.40, "rose", 1.6, True),
        (0.40, "fell", 1.6, False),
        (0.30, "unchanged", 1.6, False),
        (0.30, "unchanged", 0.8, False),  # less motion: the error is that of the sensors
        (0.60, "unchanged", 3.2, False),
    ],
)
def test_changes_that_do_not_bring_the_error_back_ask_for_a_diagnosis_first(
    own: float, verdict: Any, spread: float, asked: bool
) -> None:
    """The error of the logs after is 1.48 times that of the logs before: a thruster had lost a fifth of its thrust."""

    def errors(logs: Any, values: Any, after: float) -> CampaignErrors:
        row = ErrorComparison(before=None, after=after, unit="rad", spread=spread if logs == "after" else 1.6)
        return CampaignErrors(logs=logs, values=values, channels={"psi": row}, verdict=verdict)

    rows = (errors("before", "before", 0.27), errors("after", "changed", 0.8), errors("after", "after", own))
    values = {"m_u": np.array([40.0, 40.1, 43.0, 43.1])}
    answer = campaigns_answer(result_of(compared(rows_of(values), 2), rows))
    first = answer.startswith("Neither the changed parameters nor values of their own bring the prediction error of")
    assert first is asked
    assert ("Run `seatrial ident diagnose` on the logs after" in answer) is asked


@pytest.mark.parametrize(
    ("interval", "text"),
    [
        ((1.138, 1.079, 1.201), "1.14 (95 %: 1.08 to 1.20)"),
        ((1.2, 1.19, 1.21), "1.200 (95 %: 1.190 to 1.210)"),
        ((1.5, 0.9, 2.3), "1.5 (95 %: 0.9 to 2.3)"),
    ],
)
def test_a_factor_has_as_many_digits_as_its_interval_needs(interval: tuple[float, float, float], text: str) -> None:
    assert _with_interval(*interval) == text


def four_fifths(
    n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
) -> tuple[float, float]:
    """Return the thrust [N] of both sides of a boat whose left thruster has lost a fifth."""
    return 0.8 * f_l, f_r


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")
def test_a_weaker_thruster_is_named_by_default(tmp_path: Path) -> None:
    """The left thruster gives four fifths of its thrust after, and nothing else has changed."""
    boat = boat_with(None, 5)
    weaker = draw_boat(5, [HiddenEffect("weak", "the left thruster has lost thrust", {}, thrust=four_fifths)])
    logs = {
        name: [boat_log(tmp_path / f"{name}{n}.mcap", b, 90.0, 10 * k + n, 10 * k + n) for n in range(3)]
        for k, (name, b) in enumerate((("before", boat), ("after", weaker)))
    }
    found = st.compare_campaigns(logs["before"], logs["after"], fixed=FIXED, jobs=1)
    assert found.changed == ["eps_LR"]
    assert re.match(r"The left thruster gives (79|80|81)[\d.]* ± [\d.]+ % of the thrust of the right one", found.answer)
    assert "One cause explains both: the left thruster gives 8" in found.answer
    assert any("The model has the effect mismatch, so that" in note for note in found.result.notes)
    assert "thrust-sides-differ" not in {w.code for w in found.result.warnings}
    assert not any("--thrust-of" in w.text for w in found.result.warnings)  # an option that the command rejects


SPEEDS = {"u_typical": 1.1, "v_typical": 0.07, "r_typical": 0.3}


def damped_rows(
    rng: np.random.Generator, n: int, growth: float = 1.0, correlation: float = -0.995
) -> list[dict[str, Any]]:
    """Return rows of n logs before and n after whose drag grows by a factor: d_u and d_uu are known by their sum."""
    after, root = np.repeat([False, True], n), np.linalg.cholesky(np.array([[1.0, correlation], [correlation, 1.0]]))
    errors = root @ rng.normal(size=(2, 2 * n))
    grown = np.where(after, growth, 1.0)
    values = {"d_u": 4.0 * grown + 4.0 * errors[0], "d_uu": 15.0 * grown + 4.0 * errors[1]}
    values |= {name: 5.0 + 0.3 * rng.normal(size=2 * n) for name in ("m_u", "m_v", "m_r", "Y_r", "N_v")}
    related = {"d_u": json.dumps({"d_uu": correlation}), "d_uu": json.dumps({"d_u": correlation})}
    rows = rows_of(values, 0.3, correlations=related, unit={"d_u": "kg/s", "d_uu": "kg/m"})
    return [r | SPEEDS | {"se": 4.0 if r["parameter"] in related else 0.3} for r in rows]


def test_a_grown_drag_is_found_though_neither_of_its_parameters_is() -> None:
    found = compared(damped_rows(np.random.default_rng(4), 3, 1.4), 3)
    assert not any(p.changed for p in found.parameters)
    drag = next(c for c in found.combinations if c.name.startswith("drag"))
    assert (drag.name, drag.parameters, drag.changed) == ("drag ahead at 1 m/s", ("d_u", "d_uu"), True)
    assert drag.relative == pytest.approx(0.4, abs=0.08)
    assert drag.logs[0].se == pytest.approx(4.0 * (2 * (1 - 0.995)) ** 0.5)  # of the sum, with the correlation
    result = result_of(found)
    answer = campaigns_answer(result)
    assert answer.startswith("The drag ahead at 1 m/s has grown by ")
    assert " N. 1 of 2 combinations of parameters has changed at a false discovery rate of 5 %." in answer
    low, high = (100 * v / drag.before.mean for v in (drag.low or 0.0, drag.high or 0.0))
    assert f"{100 * (drag.relative or 0.0):.0f} % (95 %: {low:.0f} to {high:.0f} %), {drag.difference:.1f}" in answer


def test_a_fallen_drag_is_told_with_positive_numbers() -> None:
    found = compared(damped_rows(np.random.default_rng(4), 4, 0.6), 4)
    drag = next(c for c in found.combinations if c.name.startswith("drag"))
    assert drag.changed
    words = re.search(r"has fallen by (\d+) % \(95 %: (\d+) to (\d+) %\)", campaigns_answer(result_of_one(drag)))
    assert words is not None
    size, low, high = map(int, words.groups())
    assert low < 40 < high
    assert low < size < high


def result_of_one(drag: CombinationDifference) -> CampaignsResult:
    """Return a result with one combination beside a parameter that has not changed."""
    found = compared(rows_of({"m_u": np.array([40.0, 40.1, 40.1, 40.0])}), 2)
    return msgspec.structs.replace(result_of(found), combinations=(drag,))


def test_combinations_keep_the_false_discovery_rate() -> None:
    rng = np.random.default_rng(11)
    wrong = 0
    for _ in range(60):
        found = compared(damped_rows(rng, 3), 3)
        wrong += any(p.changed for p in (*found.parameters, *found.combinations))
    assert wrong <= 6  # 3 are expected; more than 6 have a probability of 3 %


def test_the_prediction_with_the_changes_has_all_parameters_of_a_changed_combination() -> None:
    rows = damped_rows(np.random.default_rng(4), 3, 1.4)
    fitted = fitted_logs(rows, {"3", "4", "5"})
    before = _campaign_values(fitted.part(~fitted.after), {})
    values = _values_without(fitted, compare_fits(fitted), 5, before)
    assert {n for n, v in values["changed"].items() if v != before[n]} == {"d_u", "d_uu"}
    drags = {kind: v["d_u"] + v["d_uu"] for kind, v in values.items()}
    assert drags["changed"] == pytest.approx(drags["after"], rel=0.03)


def test_a_quadratic_damping_at_its_bound_in_a_log_is_part_of_the_sum() -> None:
    rng = np.random.default_rng(2)
    values = {"d_r": 5.0 + 0.1 * rng.normal(size=6), "d_rr": 3.0 + 0.1 * rng.normal(size=6)}
    values["d_r"][4], values["d_rr"][4] = 5.0 + 3.0 * math.radians(15.0), 0.0
    rows = [r | SPEEDS for r in rows_of(values, unit={"d_r": "kg m2/s", "d_rr": "kg m2"})]
    for r in rows:
        if r["value"] == 0.0:
            r |= {"se": None, "flag": f"{AT_BOUND} 0, the lowest possible value", "correlations": "{}"}
    found = compared(rows, 3)
    assert [p.name for p in found.parameters] == ["d_r"]
    (damping,) = found.combinations
    assert (damping.name, damping.unit, len(damping.logs)) == ("yaw damping at 15 deg/s", "N m", 6)
    rate = math.radians(15.0)
    assert damping.before.mean == pytest.approx(5.0 * rate + 3.0 * rate**2, rel=0.03)
    assert abs(damping.difference) < 0.05 * damping.before.mean


def test_a_damping_with_one_estimated_coefficient_is_listed_with_the_reason() -> None:
    """The row of the drag was missing without a word: d_u was at its bound in all logs."""
    rng = np.random.default_rng(2)
    values = {"d_u": np.zeros(6), "d_uu": 3.0 + 0.1 * rng.normal(size=6)}
    rows = [r | SPEEDS for r in rows_of(values, unit={"d_u": "kg/s", "d_uu": "kg/m"})]
    for r in rows:
        if r["parameter"] == "d_u":
            r |= {"se": None, "flag": f"{AT_BOUND} 0, the lowest possible value", "correlations": "{}"}
    found = compared(rows, 3)
    assert found.combinations == ()
    (drag,) = (x for x in found.not_compared if x.name == "drag ahead")
    assert (drag.code, drag.reason) == ("at-bound", "d_u: at the bound in all logs, so that it changes as d_uu does")


@pytest.mark.parametrize(("prior", "fixed"), [(False, False), (True, False), (False, True)])
def test_thrust_of_each_side_is_compared_if_the_logs_determine_it(prior: bool, fixed: bool) -> None:
    """The right thruster has lost 14 %: c1 and c2 fall by 7 %, and the left side gives 1.0753 of their mean."""
    rng, after = np.random.default_rng(5), np.arange(8) >= 4
    eps = 0.14 / 1.86
    values = {
        "c1": np.where(after, 0.93, 1.0) * 30.0 + 0.2 * rng.normal(size=8),
        "c2": np.where(after, 0.93, 1.0) * 4.0 + 0.2 * rng.normal(size=8),
        "eps_LR": eps * after + 0.004 * rng.normal(size=8),
    }
    rows = rows_of(values, effect={"eps_LR": "mismatch"}, unit={"c1": "N", "c2": "N"}, free={"c1": not fixed})
    for r in rows:
        r["se"] = 0.004 if r["parameter"] == "eps_LR" else 0.2
        if prior and r["parameter"] == "c1":
            r["prior_parts"] = json.dumps({"c1": 0.19})
    found = compared(rows, 4)
    if prior or fixed:
        assert not found.combinations
        reasons = {p.name: p.reason for p in found.not_compared}
        words = "c1: known mainly from its prior (90 % of the information)"
        assert reasons.get("thrust ahead of each side", "") == ("" if fixed else words)
        return
    left, right = found.combinations
    assert (left.name, right.name) == ("thrust ahead, left", "thrust ahead, right")
    assert left.parameters == ("c1", "c2", "eps_LR")
    assert left.relative == pytest.approx(0.0, abs=0.01)
    assert right.relative == pytest.approx(-0.14, abs=0.01)
    assert not left.changed
    share = 1.0 - rows[-1]["value"]  # error of the last log by the derivatives
    full = rows[-3]["value"] + rows[-2]["value"]
    assert right.logs[-1].se == pytest.approx(np.hypot(2**0.5 * 0.2 * share, 0.004 * full))
    answer = campaigns_answer(result_of(found))
    assert "he thrust ahead of the right thruster has fallen by 14 % (95 %: 1" in answer


@pytest.mark.parametrize(
    ("value", "rounded"),
    [(1.0, [1.0, 0.9, 0.8, 0.7]), (1.44, [1.2, 1.0]), (0.71, [0.7, 0.6, 0.5]), (17.2, [15.0, 12.0]), (0.0071, [0.007])],
)
def test_velocities_are_round_numbers_below(value: float, rounded: list[float]) -> None:
    found = rounded_below(value, 0.65 if value > 0.01 else 0.9)
    assert found == pytest.approx(rounded, rel=1e-12)


@pytest.mark.parametrize(("correlation", "speed"), [(0.0, 1.0), (-0.9999, 0.5)])
def test_a_drag_is_compared_at_the_speed_at_which_it_is_determined_best(correlation: float, speed: float) -> None:
    """With errors of 2 kg/s and 4 kg/m that cancel, the sum has none at 0.5 m/s."""
    rows = damped_rows(np.random.default_rng(4), 3, 1.4, correlation)
    for r in rows:
        r["se"] = {"d_u": 2.0, "d_uu": 4.0}.get(r["parameter"], r["se"])
    drag = next(c for c in compared(rows, 3).combinations if c.name.startswith("drag"))
    assert drag.name == f"drag ahead at {speed:g} m/s"


@pytest.mark.parametrize(("growth", "significant"), [(1.35, True), (1.1, False)])
def test_a_coefficient_whose_partner_is_at_its_bound_is_told_by_the_drag(growth: float, significant: bool) -> None:
    """The drag of a log whose d_u is at zero is in d_uu, which therefore grows more than the drag."""
    rng, after = np.random.default_rng(8), np.arange(6) >= 3
    n_bound = 2 if significant else 3
    values = {"d_u": 4.0 * np.where(after, growth, 1.0), "d_uu": 12.0 * np.where(after, growth, 1.0)}
    values["d_u"][6 - n_bound :], values["d_uu"][6 - n_bound :] = 0.0, 16.0 * growth
    values |= {name: 5.0 + 0.1 * rng.normal(size=6) for name in ("m_u", "m_v", "m_r")}
    related = {"d_u": json.dumps({"d_uu": -0.9}), "d_uu": json.dumps({"d_u": -0.9})}
    rows = [r | SPEEDS for r in rows_of(values, 0.8, correlations=related, unit={"d_u": "kg/s", "d_uu": "kg/m"})]
    for r in rows:
        if r["value"] == 0.0:
            r |= {"se": None, "flag": f"{AT_BOUND} 0, the lowest possible value", "correlations": "{}"}
    found = compared(rows, 3)
    assert [p.name for p in found.parameters if p.changed] == ["d_uu"]
    drag = next(c for c in found.combinations if c.name.startswith("drag"))
    assert drag.changed == significant
    answer = campaigns_answer(result_of(found))
    assert answer.startswith("The drag ahead at 1 m/s has grown by ")
    assert (f", which is not significant (q = {drag.q:.2g}); d_uu +" in answer) == (not significant)
    where = f"d_u is at its bound in {n_bound} of 3 logs after"
    assert f"How the drag ahead at 1 m/s is split between d_u and d_uu is not determined: {where}. " in answer
    assert "The change of d_uu may contain that of d_u; use the drag ahead at 1 m/s." in answer


@pytest.mark.parametrize(("with_changes", "told"), [(0.611, True), (0.2, False)])
def test_changes_that_do_not_explain_all_are_told_with_what_to_do(with_changes: float, told: bool) -> None:
    def errors(values: Any, x: float) -> CampaignErrors:
        channels = {
            "x": ErrorComparison(before=0.664, after=x, unit="m", spread=6.0),
            "psi": ErrorComparison(before=0.2, after=math.radians(5.0), unit="rad", spread=1.6),
        }
        return CampaignErrors(logs="after", values=values, channels=channels)

    found = compared(rows_of({"m_u": np.full(4, 40.0)}), 2)
    answer = campaigns_answer(result_of(found, (errors("changed", with_changes), errors("after", 0.165))))
    words = "These changes do not explain all: the error of x 10 s ahead is 0.61 m with them, and 0.17 m with all"
    assert (words in answer) is told
    assert ("(--effect NAME); `seatrial ident diagnose` on the logs after looks for it." in answer) is told


@pytest.mark.parametrize(("verdict", "told"), [("fell", True), ("unchanged", False)])
def test_better_prediction_without_a_changed_parameter_is_told_with_the_nearest_one(verdict: Any, told: bool) -> None:
    found = compared(
        rows_of(
            {
                "d_uu": np.array([20.0, 20.6, 21.9, 22.4]),
                "d_vv": np.array([40.0, 41.0, 40.5, 40.2]),
                "d_rr": np.array([4.0, 4.1, 4.05, 4.02]),
            }
        ),
        2,
    )
    assert not any(p.changed for p in found.parameters)
    own = CampaignErrors(logs="after", values="after", channels={}, ratio=0.85, low=0.8, high=0.9, verdict=verdict)
    answer = campaigns_answer(result_of(found, (own,)))
    assert ("So something has changed that these logs do not assign to a parameter. " in answer) is told
    assert answer.count("Nearest to a change") <= 1
    assert re.search(r"d_uu \+1\.85 \(95 %: \S+ to \S+\), \+9 %", answer) or not told


def nearly_changed(q: float) -> CampaignsResult:
    """Return a result in which the drag has not changed by a q value, and its coefficient is known less well."""
    found = compared(damped_rows(np.random.default_rng(3), 3, 1.4), 3)
    drag = next(c for c in found.combinations if "d_uu" in c.parameters)
    rest = [msgspec.structs.replace(p, q=0.6, p=0.5, changed=False) for p in found.parameters]
    rest = [
        msgspec.structs.replace(p, q=q, p=0.01, low=-1e3, high=1e3, relative=0.9) if p.name == "d_uu" else p
        for p in rest
    ]
    near = msgspec.structs.replace(drag, q=q * 1.2, p=0.012, changed=False)
    return msgspec.structs.replace(result_of(found), parameters=tuple(rest), combinations=(near,))


@pytest.mark.parametrize(("q", "first"), [(0.05012, True), (0.15, True), (0.3, False)])
def test_a_difference_near_to_a_change_begins_the_answer(q: float, first: bool) -> None:
    """The answer said that nothing has changed, above a row with drag ahead +55 % and q = 0.050."""
    result = nearly_changed(q)
    answer = campaigns_answer(result)
    words = "Nearest to a change, but not significant after the correction for "
    assert answer.startswith(words) is first
    assert (f": {result.combinations[0].meaning} +" in answer) is first  # known better than its coefficient
    assert "None of " in answer


def test_q_values_show_on_which_side_of_the_rate_they_are() -> None:
    assert [q_beside(q, 0.05) for q in (0.05012, 0.0500001, 0.04999, 0.05, 0.0949)] == [
        "0.0501", "0.0500001", "0.05", "0.05", "0.095",
    ]  # fmt: skip
    assert [probability(q, 0.05) for q in (0.05012, 0.04996, 0.05, None)] == ["0.0501", "0.050", "0.050", "–"]
    result = nearly_changed(0.05012)
    assert any("0.0501" in str(cell._cells) for t in campaign_tables(result) for cell in t.columns)


def test_an_effect_that_is_not_significant_has_its_size_and_the_errors_that_are_needed() -> None:
    """Without an effect, w_x is 0.5 and not zero: its distance from zero says nothing."""
    rng = np.random.default_rng(2)
    values = {"F_wx": 0.6 + 0.5 * rng.normal(size=6), "w_x": 0.5 + 0.02 * rng.normal(size=6)}
    result = result_of(compared(rows_of(values, 0.02, effect=dict.fromkeys(values, "wind"), unit={"F_wx": "N"}), 3))
    (wind,) = result.effects
    assert (wind.before, wind.after) == (False, False)
    assert wind.evidence_before is not None
    assert wind.evidence_before.distance < wind.evidence_before.needed
    assert re.fullmatch(r"not significant: \S+ \S+ ± \S+( N)? \(\d\.\d of \d+\.\d\)", effect_words(wind, result)[1])
    assert effects_caption(result).startswith("Not significant: the logs of this campaign alone")


def test_logs_that_scatter_point_to_the_test_that_names_them() -> None:
    values = {"d_uu": np.array([10.0, 20.0, 12.0, 21.0, 11.0, 19.0])}
    assert "`seatrial ident vehicle LOGS --test-homogeneity d_uu`" in campaigns_answer(
        result_of(compared(rows_of(values, 0.3), 3))
    )
    assert "--test-homogeneity" not in campaigns_answer(result_of(compared(rows_of(values, 9.0), 3)))


def result_of(found: Comparison, errors: tuple[CampaignErrors, ...] = ()) -> CampaignsResult:
    """Return a result with the tables of a comparison."""
    return CampaignsResult(
        created="", seatrial="", command="", logs=(), answer="", model="auto", table="", horizon=10.0,
        false_discovery_rate=0.05, campaigns=(), failed=(), parameters=found.parameters,
        combinations=found.combinations, not_compared=found.not_compared, effects=found.effects, joint=found.joint,
        common_factor=found.common_factor, errors=errors,
    )  # fmt: skip


def test_changed_value_follows_the_unchanged_ones() -> None:
    """A sum is well determined: the changed parameter takes the value that goes with the other one of before."""
    values = {"a": np.full(3, 2.0), "b": np.full(3, 5.0)}
    rows = rows_of(values, 1.0, correlations={"a": json.dumps({"b": -0.999}), "b": json.dumps({"a": -0.999})})
    part: FittedLogs = fitted_logs(rows, {"0", "1", "2"})
    found = _campaign_values(part, {}, {"a": 0.0, "b": 4.0}, {"a"})
    assert found["b"] == 4.0
    assert found["a"] == pytest.approx(3.0, abs=0.01)
    assert _campaign_values(part, {}) == pytest.approx({"a": 2.0, "b": 5.0})


@pytest.mark.parametrize(
    ("change", "error", "text"), [(0.02, 0.3, "0.0"), (-0.02, 0.3, "0.0"), (-3.6, 2.0, "−4"), (1.26, 0.3, "+1.3")]
)
def test_change_that_is_zero_when_rounded_has_no_sign(change: float, error: float, text: str) -> None:
    assert _signed(change, True, error) == text
