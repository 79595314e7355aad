"""--robust, --reml and --profile of the thruster's command, on a bench whose load cell has wild readings."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from daq.errors import SeatrialError
from daq.samples import LoadCell
from ident.cli.commands import ident
from ident.estimation.model_file import load_model
from mocks.plant.bench import draw_bench
from mocks.world import Reading
from tests.missions import push, write_log

EVERY, WILD = 60, 60_000.0  # readings of the cell, counts


def spoilt(reading: Reading, k: int) -> Reading:
    sample = reading.sample
    if not isinstance(sample, LoadCell) or k % EVERY:
        return reading
    return reading._replace(sample=replace(sample, counts=sample.counts + WILD))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    recording, mission = push(draw_bench(4), kind="steps")
    readings = [spoilt(r, k) for k, r in enumerate(recording.readings)]
    return write_log(tmp_path_factory.mktemp("bench") / "bench.mcap", "bench", readings, mission)


def test_outliers_are_counted_and_a_profile_is_drawn(log: Path) -> None:
    folder = log.parent / "robust"
    words = ["thruster", str(log), "--robust", "--profile", "c1", "--out", str(folder)]
    CliRunner().invoke(ident, words, catch_exceptions=False)
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    (row,) = result["profiles"]
    (c1,) = [p for p in result["fit"]["parameters"] if p["name"] == "c1"]
    assert row["low"] < c1["value"] < row["high"]
    assert abs(row["value"] - c1["value"]) < 0.1 * c1["se"]  # the maximum's, without the restricted noise
    assert abs(c1["value"] - draw_bench(4).thruster.c1) < 5 * c1["se"]
    (force,) = [line for line in result["notes"] if line.startswith("force:")]
    counted, total = int(force.split()[1]), int(force.split()[3])
    assert 0.5 * total / EVERY < counted < 3 * total / EVERY
    assert "load_cell" in tomllib.loads((folder / "model.toml").read_text(encoding="utf-8"))["robust"]
    assert '<section id="profiles"' in (folder / "report.html").read_text(encoding="utf-8")


def test_a_profile_of_nothing_is_said_before_the_fit(log: Path) -> None:
    done = CliRunner().invoke(ident, ["thruster", str(log), "--profile", "mass"])
    assert isinstance(done.exception, SeatrialError)
    assert "--profile mass: model thruster has" in str(done.exception)
    assert "fitting" not in done.output


def test_noise_is_restricted_unless_told_otherwise(log: Path) -> None:
    """The curve took part of the force's noise with it, and it stays; model.toml says how it was fitted."""
    fits = {}
    for name, words in (("plain", ["--no-reml"]), ("reml", [])):
        folder = log.parent / name
        CliRunner().invoke(ident, ["thruster", str(log), *words, "--out", str(folder)], catch_exceptions=False)
        fitted = json.loads((folder / "result.json").read_text(encoding="utf-8"))["fit"]
        assert fitted["restricted"] is load_model(folder / "model.toml").reml is (name == "reml")
        fits[name] = {p["name"]: p["value"] for p in fitted["parameters"]}
    assert 1.0001 < fits["reml"]["e_f"] / fits["plain"]["e_f"] < 1.01
    for name in ("tau", "a", "c1", "c2"):
        assert fits["reml"][name] == pytest.approx(fits["plain"][name], rel=1e-3)
