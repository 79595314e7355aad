"""Tests of the thrusters of the measured ferry by public commands, as in docs/examples/milliampere/README.md."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from seatrial.ident.data.loading import load_run
from seatrial.ident.data.record import sample_and_hold
from tests.measured.data import measured, run

pytestmark = [
    pytest.mark.measured,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:.*the log is cut there"),  # The logs have drop-outs of more than a minute.
]

HERE = Path(__file__).resolve().parents[2] / "docs/examples/milliampere"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with both logs and the fit of thruster 3."""
    data = measured("milliampere/thruster_data_test")
    out = tmp_path_factory.mktemp("milliampere")
    for k in (3, 4):
        files = [str(data / f"{name}_{k}.csv") for name in ("actuator_ref", "motor_state")]
        run("import", str(HERE / f"thruster{k}.toml"), *files, "-o", str(out / f"thruster{k}.mcap"))
    run("ident", "thruster", str(out / "thruster3.mcap"), "--out", str(out / "thruster"))
    return out


@pytest.mark.parametrize("k", [3, 4])
def test_time_stamps_are_repaired_and_only_new_samples_are_kept(folder: Path, k: int) -> None:
    found = load_run(folder / f"thruster{k}.mcap", "estimation").run.channels
    n = found["reported"]
    assert (n.value == 0).any()
    assert not (found["n_pod"].value == 0).any()
    assert 680 < n.t[-1] - n.t[0] < 710
    assert (np.diff(n.t) > 0).all()
    assert 100 < n.t.size < 250  # The log has 6101 rows.


@pytest.mark.parametrize("k", [3, 4])
def test_speed_equals_the_command_up_to_its_limit(folder: Path, k: int) -> None:
    found = load_run(folder / f"thruster{k}.mcap", "estimation").run.channels
    command, n = found["n_cmd_pod"], found["n_pod"]
    now, before = sample_and_hold(command, n.t), sample_and_hold(command, n.t - 10.0)
    settled = (now == before) & (n.value != 0) & (np.abs(now) > 0.05)
    below = settled & (np.abs(now) < 0.75)
    assert np.abs(np.median(n.value[below] / now[below]) - 1) < 0.01
    above = settled & (np.abs(now) > 0.75)
    assert above.sum() > 5
    assert np.abs(np.median(np.abs(n.value[above])) - 0.75) < 0.002


def test_first_order_shaft_is_not_sufficient(folder: Path) -> None:
    result = json.loads((folder / "thruster/result.json").read_text())
    error = result["errors"]["estimation"]["simulation"]["n"]["after"]
    assert error > 0.05  # As a share of full command. Each steady speed is known to 0.003.
    assert "its thrust is unknown without a load cell" in result["answer"]
    delay = next(p for p in result["fit"]["parameters"] if p["name"] == "tau")
    assert delay["value"] < 2.0  # The first samples after a command already show the new speed.


@pytest.mark.study
def test_diagnosis_identifies_the_speed_limit(folder: Path) -> None:
    logs = [str(folder / "thruster3.mcap"), "--validate", str(folder / "thruster4.mcap")]
    run("ident", "diagnose", str(folder / "thruster/model.toml"), *logs, "--out", str(folder / "diagnosis"))
    result = json.loads((folder / "diagnosis/result.json").read_text())
    (effect,) = result["effects"]
    assert (effect["name"], effect["attribution"]) == ("speed-limit", "identified")
    limit = next(p for p in effect["parameters"] if p["name"] == "n_top")
    assert abs(limit["value"] - 0.75) < 0.02
    error = result["errors"]["validation"]["simulation"]["n"]
    assert error["after"] < 0.15 * error["before"]
    delay = next(p for p in result["fit"]["parameters"] if p["name"] == "tau")
    assert delay["value"] < 0.6  # The likelihood has several maxima. This is the highest.
