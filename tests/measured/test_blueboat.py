"""Tests of the measured BlueBoat by public commands, as in docs/examples/blueboat/README.md."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from seatrial import command_line
from tests.measured.data import measured, run

pytestmark = [pytest.mark.measured, pytest.mark.slow]

HERE = Path(__file__).resolve().parents[2] / "docs/examples/blueboat"
FITTED = (218, 220, 222, 224, 230, 233)
UNUSED = (221, 223, 226, 228, 232)
BOAT = {"--initial": ("m_u=15", "m_v=20", "m_r=1.7"), "--fix": ("y_left=0.285", "y_right=-0.285")}
NOISE = ("e_uv=0.05", "e_r=0.02", "e_psi=0.03", "e_xy=0.3")


def example() -> tuple[ModuleType, ModuleType]:
    """Return the modules leave_one_out.py and boat.py of the example."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(HERE))
        for name in ("leave_one_out", "boat"):  # Another test may have loaded a module of the same name.
            patch.delitem(sys.modules, name, raising=False)
        return importlib.import_module("leave_one_out"), importlib.import_module("boat")


def percent(result: dict[str, Any], channel: str, when: str) -> float:
    row = result["errors"]["validation"]["simulation"][channel]
    return float(100.0 * (1.0 - row[when] / row["spread"]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the runs as logs."""
    files = sorted(measured("blueboat").glob("fixed_00000*.csv"))
    folder = tmp_path_factory.mktemp("blueboat")
    run("import", str(HERE / "blueboat.toml"), *map(str, files), "--out-dir", str(folder))
    return folder


@pytest.fixture(scope="module")
def results(folder: Path) -> dict[str, dict[str, Any]]:
    """Return result.json of the fit and of the diagnosis."""
    logs = [str(folder / f"fixed_00000{n}.mcap") for n in FITTED]
    for n in UNUSED:
        logs += ["--validate", str(folder / f"fixed_00000{n}.mcap")]
    options = ["--model", "horizontal:force"]
    options += [word for option, values in BOAT.items() for v in values for word in (option, v)]
    options += [word for v in NOISE for word in ("--fix", v)]
    run("ident", "vehicle", *logs, *options, "--out", str(folder / "vehicle"))
    search_options = (
        "--max-effects",
        "1",
        "--out",
        str(folder / "diagnosis"),
    )  # The first effect explains most of the error.
    run("ident", "diagnose", str(folder / "vehicle/model.toml"), *logs, *search_options)
    return {k: json.loads((folder / k / "result.json").read_text()) for k in ("vehicle", "diagnosis")}


def test_swapped_sides_of_the_columns_are_rejected(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    logs = [str(folder / f"fixed_00000{n}.mcap") for n in FITTED]
    with pytest.raises(SystemExit) as left:
        command_line.main(["ident", "vehicle", *logs, "--model", "horizontal:force", "--out", str(folder / "refused")])
    assert left.value.code == 1
    assert "[thruster-sides-swapped]" in capfd.readouterr().err


@pytest.mark.study
def test_smoothed_channels_are_reported(results: dict[str, dict[str, Any]]) -> None:
    codes = {f["code"] for log in results["vehicle"]["logs"] for f in log["findings"]}
    assert "channel-smoothed" in codes
    assert not [f for log in results["vehicle"]["logs"] for f in log["findings"] if f["spoils"]]


@pytest.mark.study
def test_diagnosis_finds_an_effect_that_predicts_the_unused_runs_better(
    results: dict[str, dict[str, Any]],
) -> None:
    found = results["diagnosis"]
    assert found["effects"]
    assert percent(found, "r", "after") > percent(found, "r", "before") + 15.0
    assert found["prediction"]["verdict"] != "rose"  # Over all channels, the change is not significant.
    # For the yaw rate, the change is significant.
    assert found["errors"]["validation"]["horizon"]["r"]["verdict"] == "fell"
    assert percent(found, "v", "after") > percent(found, "v", "before")


@pytest.mark.study
def test_yaw_rate_of_the_unused_runs_is_predicted(results: dict[str, dict[str, Any]]) -> None:
    assert percent(results["diagnosis"], "r", "after") > 30.0


@pytest.mark.study
def test_better_yaw_prediction_does_not_degrade_surge(results: dict[str, dict[str, Any]]) -> None:
    found = results["diagnosis"]
    assert percent(found, "u", "after") > 40.0
    # With a wrong force, the damping alone degrades surge by four points (docs/examples/blueboat).
    assert percent(found, "u", "after") > percent(found, "u", "before") - 7.0


@pytest.fixture(scope="module")
def left_out(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the scores of cross-validation over runs, by the script of the example."""
    script, models = example()
    logs = sorted(folder.glob("fixed_*.mcap"))
    assert len(logs) == len(FITTED) + len(UNUSED)
    made = {name: getattr(models, name)() for name in ("authors", "boat")}
    return {name: script.score(model, script.records_of(model, logs), left_out=True) for name, model in made.items()}


@pytest.mark.study
def test_unused_runs_are_predicted_from_their_inputs(left_out: dict[str, dict[str, Any]]) -> None:
    """In nested cross-validation, without any choice by the predicted run, the scores are 85.0 / 14.5 / 64.0. The score
    of sway over eleven runs is accurate to about ten.
    """
    boat, authors = left_out["boat"]["pooled"], left_out["authors"]["pooled"]
    for channel, least in (("u", 80.0), ("v", 5.0), ("r", 55.0)):
        assert boat[channel] > least
        assert boat[channel] > authors[channel] + 10.0
    assert not left_out["boat"]["unconverged"]


SUBSETS = [pytest.param(k, marks=() if k == 1 else pytest.mark.study) for k in range(1, 13)]


@pytest.mark.parametrize("seed", SUBSETS)
def test_fit_to_any_eight_runs_converges(folder: Path, seed: int) -> None:
    script, models = example()
    logs = sorted(folder.glob("fixed_*.mcap"))
    some = [logs[k] for k in sorted(np.random.default_rng(seed).choice(len(logs), 8, replace=False))]
    model = models.boat()
    found = script.fitted_from_first_samples(model, script.records_of(model, some), {})
    assert found.converged
    assert 10.0 < found.model.values["m_u"] < 25.0


@pytest.mark.study
def test_estimates_are_physical(left_out: dict[str, dict[str, Any]]) -> None:
    found = left_out["boat"]["parameters"]
    assert 12.0 < found["m_u"][0] < 22.0  # The boat has 15 kg, plus added mass.
    assert found["m_r"][0] < 12.0  # With the force of the authors, it is 15 kg m2.
    assert abs(found["b_y"][0]) < 0.5  # The measured point is on board.
    drawn, error, jackknife = found["dev_mc"]
    # The motors deflect the compass while they run. A gyro bias per run explains a part of this drift.
    # The residuals may be autocorrelated for too long for a standard error.
    assert drawn < -1.96 * np.fmax(error, jackknife)
    ratios = np.array([j / e for _, e, j in found.values() if e > 0.0])
    # The errors of the jackknife are 1.8 times as large, because runs differ by more than noise.
    assert 0.7 < np.median(ratios) < 3.0


def test_model_that_predicts_a_run_is_chosen_without_this_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run 0 is predicted by ``other``, although ``own`` would be best for it. A model whose fit did not converge is
    never chosen.
    """
    script, _ = example()
    best = {"own": (0.1, 5.0, 5.0), "other": (1.0, 1.0, 1.0), "broken": (0.0, 0.0, 0.0)}

    def errors(model: str, records: list[Any], out: tuple[int, ...]) -> dict[int, Any]:
        failed = model == "broken" and len(out) == 2
        return {i: script.NO_SCORE if failed else np.full((2, 3), [[best[model][i]], [10.0]]) for i in out}

    monkeypatch.setattr(script, "errors_left_out", errors)
    monkeypatch.setattr(script, "records_of", lambda model, logs: [SimpleNamespace(name=log.stem) for log in logs])
    found = script.nested({name: name for name in best}, [Path("0"), Path("1"), Path("2")], 1)
    assert found["chosen"]["0"] == "other"
    assert "broken" not in found["chosen"].values()
    assert found["runs"]["0"]["u"] == pytest.approx(100.0 * (1.0 - np.sqrt(0.1)))
    assert len(found["unconverged"]) == 3
