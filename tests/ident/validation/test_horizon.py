"""Tests of --horizon and of the bands on the bench, by the commands and on data simulated by the model."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from msgspec import structs
from scipy import stats

from seatrial.daq.errors import SeatrialError
from seatrial.ident.cli.commands import ident
from seatrial.ident.data.record import LogSegment
from seatrial.ident.estimation.fitted_model import fit_nominal_model
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.stochastic_simulation import simulate_stochastic
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.thruster import thruster_model
from seatrial.ident.report.sections.predictions import _verdict_cell
from seatrial.ident.results import read_result, to_json
from seatrial.ident.results.answers import calibration_notes
from seatrial.ident.results.parts import CalibrationRow, Calibrations, CalibrationTable
from seatrial.ident.studies.cases import make_case
from seatrial.ident.studies.monte_carlo import make_record
from seatrial.ident.validation import calibration
from seatrial.ident.validation.calibration import Calibration
from seatrial.ident.validation.evaluation import evaluate, prediction_changes
from seatrial.ident.validation.prediction_errors import WARM_UP, simulation_run
from seatrial.mocks.plant.bench import draw_bench
from tests.missions import bench_log, boat_log, boat_with, channels_of, sail

KINDS = ["one_step", "horizon", "simulation"]


def done(*words: object) -> Result:
    return CliRunner().invoke(ident, [str(w) for w in words], catch_exceptions=False)


def result_of(folder: Path) -> dict[str, Any]:
    result: dict[str, Any] = json.loads(to_json(read_result(folder / "result.json")))
    return result


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("bench")
    return [bench_log(folder / f"bench{k}.mcap", draw_bench(4), k) for k in (1, 2)]


@pytest.fixture(scope="module")
def boat(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder, own = tmp_path_factory.mktemp("boat"), boat_with(None, 5)
    return [boat_log(folder / "one.mcap", own, 120, 1), boat_log(folder / "two.mcap", own, 80, 2, 2)]


@pytest.mark.study
def test_thruster_is_validated_one_second_ahead_and_calibrated(bench: list[Path], tmp_path: Path) -> None:
    output = done("thruster", *bench, "--out", tmp_path).output
    result = result_of(tmp_path)
    assert result["horizon_seconds"] == thruster_model().horizon == 1.0
    assert re.search(r"1 s ahead +one step ahead +simulation", output)
    errors, calibrated = result["errors"]["estimation"], result["calibration"]["estimation"]
    assert list(errors) == list(calibrated) == KINDS
    for kind in KINDS:
        assert set(errors[kind]) == set(calibrated[kind]) == {"n", "force"}
        for name, c in calibrated[kind].items():
            assert c["verdict"] == "right", (kind, name, c)
            assert abs(c["inside_95"] - 0.95) < 0.03
    assert [line for line in result["notes"] if "errors are" in line] == []
    assert errors["one_step"]["force"]["after"] < errors["horizon"]["force"]["after"]
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert '<section id="calibration"' in page
    assert "1 s ahead" in page
    assert "10 s ahead" not in page


@pytest.mark.study
def test_errors_on_the_bench_cover_all_logs(bench: list[Path], tmp_path: Path) -> None:
    done("thruster", *bench, "--horizon", 0.5, "--out", tmp_path)
    result = result_of(tmp_path)
    assert result["horizon_seconds"] == 0.5
    for name, row in result["errors"]["estimation"]["simulation"].items():
        errors = [
            (np.array(t["measured"]) - np.array(t["model"]))[np.array(t["t"]) > t["t"][0] + WARM_UP]
            for t in result["traces"]
            if t["channel"] == name
        ]
        assert len(errors) == 2
        assert row["after"] == pytest.approx(np.sqrt(np.mean(np.concatenate(errors) ** 2)), rel=1e-3)


@pytest.mark.study
def test_horizon_of_a_boat_can_be_chosen(boat: list[Path], tmp_path: Path) -> None:
    errors = {}
    for words, horizon in (([], 10.0), (["--horizon", 4], 4.0)):
        output = done(
            "vehicle", boat[0], "--no-score-tests", "--validate", boat[1], *words, "--out", tmp_path, "--force"
        ).output
        result = result_of(tmp_path)
        assert result["horizon_seconds"] == horizon
        assert result["answer"].startswith(f"Prediction {horizon:g} s ahead on validation data, all channels: fit ")
        assert 0.0 < result["prediction"]["low"] < result["prediction"]["fit"] < result["prediction"]["high"] < 1.0
        assert f"{horizon:g} s ahead" in output
        page = (tmp_path / "report.html").read_text(encoding="utf-8")
        assert f"{horizon:g} s ahead" in page
        assert f"{14 - horizon:g} s ahead" not in page
        errors[horizon] = result["errors"]["validation"]
    assert errors[4.0]["horizon"]["psi"]["after"] < 0.7 * errors[10.0]["horizon"]["psi"]["after"]
    for kind in ("one_step", "simulation"):
        assert errors[4.0][kind] == errors[10.0][kind]
    out = tmp_path / "diagnosis"
    done(
        "diagnose",
        tmp_path / "model.toml",
        boat[0],
        "--validate",
        boat[1],
        "--horizon",
        4,
        "--max-effects",
        1,
        "--out",
        out,
    )
    result = result_of(out)
    assert result["horizon_seconds"] == 4.0
    row = result["errors"]["validation"]["horizon"]["psi"]
    assert row["before"] == pytest.approx(errors[4.0]["horizon"]["psi"]["after"], rel=0.1)
    assert set(result["calibration"]["validation"]) == set(KINDS)


def test_horizon_longer_than_the_logs_is_rejected(boat: list[Path], bench: list[Path], tmp_path: Path) -> None:
    for words in (["vehicle", boat[0], "--no-score-tests", "--validate", boat[1]], ["thruster", bench[0]]):
        failed = CliRunner().invoke(ident, [*map(str, words), "--horizon", "500", "--out", str(tmp_path)])
        assert isinstance(failed.exception, SeatrialError)
        assert str(failed.exception).startswith(
            f"--horizon 500: {words[-1].name}, the longest log that the model is evaluated on, lasts "
        )
        assert "fitting" not in failed.output
    assert CliRunner().invoke(ident, ["vehicle", str(boat[0]), "--horizon", "0"]).exit_code == 2


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [
        (0.9, 1.2, "✓ calibrated"),
        (1.07, 1.84, "too narrow, but not distinguishable from calibrated within 10 %"),
        (0.7, 0.95, "too wide, but not distinguishable from calibrated within 10 %"),
    ],
)
def test_check_mark_needs_an_interval_with_one(low: float, high: float, words: str) -> None:
    scale = 0.5 * (low + high)
    row = CalibrationRow(
        n=90, n_effective=20.0, inside_50=0.4, inside_95=0.84, scale=scale, low=low, high=high,
        pit=np.full(10, 0.1), verdict="right",
    )  # fmt: skip
    assert _verdict_cell(row).words == words


def test_notes_contain_the_horizon() -> None:
    row = CalibrationRow(
        n=9,
        n_effective=9.0,
        inside_50=0.3,
        inside_95=0.8,
        scale=1.52,
        low=1.2,
        high=1.8,
        pit=np.full(10, 0.1),
        verdict="overconfident",
    )
    wrong = Calibrations(estimation=CalibrationTable(one_step={}, horizon={"n": row}, simulation={}))
    (line,) = calibration_notes(wrong, 2.5)
    assert line == (
        "On estimation data, the errors 2.5 s ahead are larger than the model predicts, by these factors: shaft speed "
        "1.5. Multiply the predicted standard deviations of these channels by them."
    )
    tables = CalibrationTable(one_step={"n": row}, horizon={"n": row}, simulation={})
    one_step, horizon = calibration_notes(Calibrations(estimation=tables, validation=tables), 2.5)
    assert one_step.endswith("1.5. Multiply the predicted standard deviations of these channels by them.")
    assert horizon == (
        "On validation data, the errors 2.5 s ahead are larger than the model predicts, by these factors: shaft speed "
        "1.5. The intervals of this result and of `predict` in Python are already widened for this."
    )
    loose = structs.replace(row, scale=0.6, verdict="underconfident")
    wide = CalibrationTable(one_step={}, horizon={"n": loose}, simulation={})
    (line,) = calibration_notes(Calibrations(estimation=tables, validation=wide), 2.5)
    assert line.endswith(
        "0.6. The intervals of this result and of `predict` in Python are too wide by these factors: they are never "
        "narrowed."
    )
    useless = CalibrationTable(one_step={}, horizon={"n": structs.replace(loose, scale=0.02)}, simulation={})
    (line,) = calibration_notes(Calibrations(estimation=tables, validation=useless), 2.5)
    assert line.endswith("does not tell the error: use the table of errors for these channels.")


@pytest.mark.study
def test_calibration_is_right_on_simulated_bench_data() -> None:
    """At the true parameters, every verdict is right, and the intervals of the scale cover it in 95 of 100 runs."""
    case, trials = make_case("thruster"), 30
    values = np.tile(list(case.model.values.values()), (trials, 1))
    _, y = simulate_stochastic(case.model, case.inputs, values, [np.random.default_rng([7, k]) for k in range(trials)])
    likelihood, found = Likelihood(case.model), list[Calibration]()
    for k in range(trials):
        record, p = make_record(case, y[k], "r"), values[k]
        run = likelihood.filter(record, p)
        found += calibration.pooled_calibration([calibration.one_step_calibration(case.model, run)]).values()
        far = calibration.horizon_forecasts(case.model, record, p, run, 1.0, likelihood)
        found += calibration.pooled_calibration([calibration.horizon_calibration(far)]).values()
        free = calibration.simulation_calibration(case.model, record, simulation_run(case.model, record, p, likelihood))
        found += calibration.pooled_calibration([free], together=True).values()
    assert len(found) == 6 * trials
    assert {c.verdict for c in found} == {"right"}
    assert stats.binomtest(sum(c.low < 1 < c.high for c in found), len(found), 0.95).pvalue > 1e-3
    assert np.mean([c.inside_50 for c in found]) == pytest.approx(0.5, abs=0.01)
    # Too little process noise appears after a second. A horizon of one or two rows is thinned to limit the computation.
    p = p * [0.2 if q.name == "s_n" else 1.0 for q in case.model.parameters]
    run = likelihood.filter(record, p)
    poor, near = (
        calibration.horizon_calibration(calibration.horizon_forecasts(case.model, record, p, run, s, likelihood))
        for s in (1.0, 0.02)
    )
    assert calibration.pooled_calibration([poor])["n"].verdict == "overconfident"
    assert record.n_rows > calibration.MOST_STARTS >= near["n"].size > calibration.MOST_STARTS / 3


@pytest.mark.study
def test_longer_horizon_uses_longer_blocks() -> None:
    runs = [
        LogSegment(name, channels_of(sail(boat_with(None, 2), 150.0, k, run=k)[0])) for k, name in enumerate("ab", 1)
    ]
    fitted = fit_nominal_model(horizontal_model(), runs[:1], runs[1:])
    far, near = (prediction_changes(evaluated, evaluated) for evaluated in (evaluate(fitted, 60.0), evaluate(fitted)))
    assert near["validation"].channels["psi"].low == pytest.approx(1.0)
    assert np.isnan(far["validation"].channels["psi"].low)  # Errors over 90 s do not fill four blocks of 120 s.
