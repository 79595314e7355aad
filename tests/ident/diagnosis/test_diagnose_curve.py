"""Tests of `ident diagnose` on a model that was fitted with a static thrust curve, given again by `--thruster`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from seatrial.daq.errors import SeatrialError
from seatrial.ident.cli.commands import ident
from seatrial.ident.results import read_result, to_json
from tests.missions import boat_log, boat_with

pytestmark = pytest.mark.usefixtures("quick_compilation")


def run(*words: object) -> Result:
    return CliRunner().invoke(ident, [str(w) for w in words])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a log, a curve from command to thrust, and a boat model fitted with them."""
    where = tmp_path_factory.mktemp("curve")
    boat_log(where / "one.mcap", boat_with(None, 5), 60, 1)
    n = np.linspace(-1.0, 1.0, 11)
    rows = {"n": n, "force": 40.0 * n * np.abs(n), "se": np.full(n.size, 0.1)}
    lines = [f"{name} = {np.round(z, 3).tolist()}" for name, z in rows.items()]
    text = "\n".join(['format = "seatrial-curve 1"', "thrusters = 1", "[curve]", *lines])
    (where / "curve.toml").write_text(text + "\n", encoding="utf-8")
    done = run(
        "vehicle",
        where / "one.mcap",
        "--no-score-tests",
        "--thruster",
        where / "curve.toml",
        "--out",
        where / "vehicle",
    )
    assert done.exit_code == 0, done.output
    return where


@pytest.mark.study
def test_thruster_option_gives_the_model_its_thrust_input_again(folder: Path) -> None:
    words = "diagnose", folder / "vehicle/model.toml", folder / "one.mcap", "--max-effects", 1
    done = run(*words, "--thruster", folder / "curve.toml", "--out", folder / "diagnosis")
    assert done.exit_code == 0, done.output
    thrusts = []
    for made in ("vehicle", "diagnosis"):
        result = json.loads(to_json(read_result(folder / made / "result.json")))
        assert result["kind"] == made
        thrusts.append(next(i["value"] for i in result["inputs"] if i["name"] == "f_left"))
    assert np.ptp(thrusts[0]) > 10.0
    np.testing.assert_array_equal(thrusts[0], thrusts[1])


def test_error_without_the_curve_names_the_thruster_option(folder: Path) -> None:
    done = run("diagnose", folder / "vehicle/model.toml", folder / "one.mcap")
    assert isinstance(done.exception, SeatrialError)
    assert "one.mcap: no signal for the input 'f_left'" in str(done.exception)
    assert "--thruster CURVE" in str(done.exception)
    assert "\n" not in str(done.exception)


@pytest.mark.parametrize(
    ("curve", "message"),
    [
        ("left", "--thruster left: no such file"),
        ("vehicle/model.toml", "vehicle/model.toml: contains no static thrust curve"),
    ],
)
def test_file_without_a_curve_is_rejected(
    folder: Path, monkeypatch: pytest.MonkeyPatch, curve: str, message: str
) -> None:
    monkeypatch.chdir(folder)
    done = run("diagnose", "vehicle/model.toml", "one.mcap", "--thruster", curve, "--out", "found")
    assert isinstance(done.exception, SeatrialError)
    assert message in str(done.exception)
