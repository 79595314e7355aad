"""Tests on one run of an independent simulator with known equations, as in docs/examples/otter/README.md."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.measured.data import measured, run

pytestmark = [pytest.mark.measured, pytest.mark.slow]

HERE = Path(__file__).resolve().parents[2] / "docs/examples/otter"
GIVEN = ("c1=94.649", "c2=25.0328", "y_left=-0.395", "y_right=0.395")
# The search in run.sh finds a curve N(v, r) instead of the last effect.
FOUND = ("steady-force", "cg-offset", "cross-flow")
EQUATIONS = {"m_u": 85.5, "m_v": 162.5, "m_r": 42.65, "d_u": 77.55, "d_v": 162.5, "d_r": 42.65, "d_rr": 426.5}


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    """Return result.json of the standard model, of the model with the found effects, and of the structure of the
    simulator.
    """
    folder = tmp_path_factory.mktemp("otter")
    files = [str(measured(f"otter/none_pos/run{n}.csv")) for n in (1, 3)]
    run("import", str(HERE / "otter.toml"), *files, "--out-dir", str(folder))
    common = [str(folder / "run1.mcap"), "--validate", str(folder / "run3.mcap"), "--rate", "5"]
    common += [word for value in GIVEN for word in ("--fix", value)]
    added = [word for name in FOUND for word in ("--effect", name)]
    kinds = {"standard": [], "found": added, "truth": ["--model", f"{HERE / 'hull.py'}:otter"]}
    for name, words in kinds.items():
        run("ident", "vehicle", *common, *words, "--out", str(folder / name))
    return {name: json.loads((folder / name / "result.json").read_text()) for name in kinds}


def ratio(results: dict[str, dict[str, Any]], numerator: str, denominator: str) -> float:
    """Return the ratio of the RMS errors 10 s ahead on the unused run, as a geometric mean over channels."""
    errors = [results[k]["errors"]["validation"]["horizon"] for k in (numerator, denominator)]
    assert errors[0].keys() == errors[1].keys() == {"psi", "r", "x", "y"}
    return float(np.exp(np.mean([np.log(errors[0][n]["after"] / errors[1][n]["after"]) for n in errors[0]])))


def estimate(result: dict[str, Any], name: str) -> tuple[float, float]:
    row = next(row for row in result["fit"]["parameters"] if row["name"] == name)
    return row["value"], row["se"]


@pytest.mark.study
def test_found_effects_predict_as_well_as_the_structure_of_the_simulator(results: dict[str, dict[str, Any]]) -> None:
    assert ratio(results, "found", "truth") < 1.1
    assert ratio(results, "found", "standard") < 0.6


@pytest.mark.study
def test_structure_of_the_simulator_gives_its_parameters(results: dict[str, dict[str, Any]]) -> None:
    assert results["truth"]["fit"]["converged"]
    for name, true in EQUATIONS.items():
        assert estimate(results["truth"], name)[0] == pytest.approx(true, rel=0.1), name


@pytest.mark.study
@pytest.mark.parametrize("kind", ["found", "truth"])
def test_steady_force_is_that_of_the_payload(results: dict[str, dict[str, Any]], kind: str) -> None:
    """The weight of the payload along the deck, at a trim of -1.49 degrees, is 6.38 N. No model contains this force."""
    value, error = estimate(results[kind], "X_0")
    assert value == pytest.approx(6.38, abs=0.3)
    assert error < 0.15
