"""Tests of the measured Kingfisher by public commands: the numbers in docs/examples/kingfisher/README.md."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest

from tests.measured.data import measured, run

pytestmark = [pytest.mark.measured, pytest.mark.slow, pytest.mark.study]

HERE = Path(__file__).resolve().parents[2] / "docs/examples/kingfisher"
MODELS = ("immediate", "delayed", "both", "shifted")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the results of run.sh for the models that the README discusses."""
    data = measured("kingfisher")
    out = tmp_path_factory.mktemp("kingfisher")
    surge = [str(path) for path in sorted(data.glob("surge_*.csv"))]
    bollard = str(data / "bollard_loadcell_raw_20files.csv")
    run("import", str(HERE / "bollard.toml"), bollard, "-o", str(out / "bollard.mcap"))
    for name in ("surge_steps", "surge_rest"):
        run("import", str(HERE / f"{name}.toml"), *surge, "--out-dir", str(out))
    run("ident", "thruster", str(out / "bollard.mcap"), "--settle", "0", "--out", str(out / "thruster"))
    steps = [str(path) for path in sorted(out.glob("surge_steps_*.mcap"))]
    unseen = [word for path in sorted(out.glob("surge_rest_*.mcap")) for word in ("--validate", str(path))]
    assert (len(steps), len(unseen)) == (4, 28)
    for name in MODELS:
        model = ["--model", f"{HERE / 'surge_model.py'}:{name}", "--thruster", str(out / "thruster/model.toml")]
        run("ident", "vehicle", *steps, *model, *unseen, "--test-homogeneity", "m_u", "--out", str(out / name))
    return out


@pytest.fixture(scope="module")
def results(folder: Path) -> dict[str, dict[str, Any]]:
    return {name: json.loads((folder / name / "result.json").read_text()) for name in MODELS}


def agreement(result: dict[str, Any]) -> dict[str, Any]:
    (row,) = result["homogeneity"]
    found: dict[str, Any] = row
    return found


def simulation(result: dict[str, Any]) -> float:
    return float(result["errors"]["validation"]["simulation"]["speed"]["after"])


def test_quadratic_does_not_describe_the_bench(folder: Path) -> None:
    table = tomllib.loads((folder / "thruster/model.toml").read_text())
    assert table["thrusters"] == 2
    assert len(table["measured"]["n"]) == 20
    assert not table["quadratic"]["adequate"]
    assert table["quadratic"]["rms"] == pytest.approx(5.6, abs=0.1)
    assert table["quadratic"]["largest"] == pytest.approx(-14.2, abs=0.2)
    assert table["curve"]["force"][-1] == pytest.approx(41.1, abs=0.1)
    assert table["curve"]["force"][0] == pytest.approx(-12.25, abs=0.05)
    assert all(0.05 < s < 0.7 for n, s in zip(table["curve"]["n"], table["curve"]["se"], strict=True) if n >= 0.3)


def test_common_mass_and_its_interval(results: dict[str, dict[str, Any]]) -> None:
    row = agreement(results["both"])
    assert row["value"] == pytest.approx(47.1, abs=0.5)
    assert row["se"] == pytest.approx(2.8, abs=0.2)
    assert row["mean"] == pytest.approx(45.1, abs=0.5)
    assert row["scatter"] == pytest.approx(1.6, abs=0.5)
    assert (row["low"], row["high"]) == pytest.approx((35.8, 54.4), abs=1.0)


def test_steps_differ_beyond_their_errors(results: dict[str, dict[str, Any]]) -> None:
    row = agreement(results["both"])
    assert not row["agree"]
    assert row["lr"] == pytest.approx(14.7, abs=1.5)
    assert row["values"] == pytest.approx([56.7, 48.4, 43.4, 44.3], abs=1.0)
    assert agreement(results["delayed"])["lr"] == pytest.approx(39.5, abs=2.0)


def test_delay_is_significant_and_without_it_the_steps_agree_on_a_wrong_mass(
    results: dict[str, dict[str, Any]],
) -> None:
    likelihood = {name: r["fit"]["log_likelihood"] for name, r in results.items()}
    assert likelihood["delayed"] - likelihood["immediate"] > 100
    assert agreement(results["immediate"])["agree"]
    assert agreement(results["immediate"])["value"] == pytest.approx(61.9, abs=0.5)
    tau = next(p for p in results["both"]["fit"]["parameters"] if p["name"] == "tau")
    assert tau["value"] == pytest.approx(0.63, abs=0.02)


def test_validation_runs_discriminate_the_models(results: dict[str, dict[str, Any]]) -> None:
    assert simulation(results["both"]) == pytest.approx(0.045, abs=0.003)
    assert simulation(results["delayed"]) == pytest.approx(0.103, abs=0.005)
    assert simulation(results["shifted"]) == pytest.approx(0.047, abs=0.004)
    # This model is rejected although it makes the steps agree and fits them better.
    assert agreement(results["shifted"])["agree"]
    assert results["shifted"]["fit"]["log_likelihood"] > results["both"]["fit"]["log_likelihood"] + 4
