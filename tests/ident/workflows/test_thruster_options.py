"""Tests of --robust, --reml and --profile of the thruster command, on a bench whose load cell has outliers."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import seatrial as st
from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.errors import SeatrialError
from seatrial.daq.samples import LoadCell
from seatrial.ident.cli.commands import ident
from seatrial.ident.estimation.model_file import load_model
from seatrial.ident.estimation.prior_knowledge import fix_parameters
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.mocks.plant.bench import draw_bench
from seatrial.mocks.world import Reading
from tests import missions
from tests.missions import push, rig_of, write_log

pytestmark = pytest.mark.usefixtures("quick_compilation")

EVERY, WILD = 60, 60_000.0  # Number of load cell readings per outlier, and size of an outlier in counts.


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


@pytest.mark.study
def test_outliers_are_counted_and_a_profile_is_drawn(log: Path) -> None:
    folder = log.parent / "robust"
    words = ["thruster", str(log), "--robust", "--profile", "c1", "--out", str(folder)]
    CliRunner().invoke(ident, words, catch_exceptions=False)
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    (row,) = result["profiles"]
    (c1,) = [p for p in result["fit"]["parameters"] if p["name"] == "c1"]
    assert row["low"] < c1["value"] < row["high"]
    # The profile uses the maximum likelihood, without the restricted noise.
    assert abs(row["value"] - c1["value"]) < 0.1 * c1["se"]
    assert abs(c1["value"] - draw_bench(4).thruster.c1) < 5 * c1["se"]
    (force,) = [line for line in result["notes"] if line.startswith("force:")]
    counted, total = int(force.split()[1]), int(force.split()[3])
    assert 0.5 * total / EVERY < counted < 3 * total / EVERY
    assert "load_cell" in tomllib.loads((folder / "model.toml").read_text(encoding="utf-8"))["robust"]
    assert '<section id="profiles"' in (folder / "report.html").read_text(encoding="utf-8")


@pytest.mark.study
def test_calibration_error_of_the_load_cell_is_in_the_standard_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a calibration error, the errors are marked as statistical only. Errors of 3 and 4 per mille add up to
    5.
    """
    recording, mission = push(draw_bench(4), kind="steps")
    calibrated_text = rig_of("bench").text.replace(
        "newton_per_count = 0.001", "newton_per_count = 0.001\nnewton_per_count_sd = 0.000003\nlever_ratio_sd = 0.004"
    )
    rows, found = {}, {}
    for name, text in (("plain", rig_of("bench").text), ("calibrated", calibrated_text)):
        rig = parse_rig(text, Path("bench.toml"))
        monkeypatch.setattr(missions, "rig_of", lambda kind, rig=rig: rig)
        log = write_log(tmp_path / f"{name}.mcap", "bench", recording.readings, mission)
        CliRunner().invoke(ident, ["thruster", str(log), "--out", str(tmp_path / name)], catch_exceptions=False)
        found[name] = json.loads((tmp_path / name / "result.json").read_text(encoding="utf-8"))
        rows[name] = {row["name"]: row for row in found[name]["fit"]["parameters"]}
    assert [found[n]["fit"]["scale"]["statistical_only"] for n in rows] == [True, False]
    plain, calibrated = (rows[n]["c1"] for n in rows)
    assert calibrated["value"] == pytest.approx(plain["value"], rel=1e-9)
    assert calibrated["se"] == pytest.approx(np.hypot(plain["se"], 0.005 * plain["value"]), rel=1e-4)
    assert rows["calibrated"]["a"]["se"] == rows["plain"]["a"]["se"]
    saved = load_model(tmp_path / "calibrated" / "model.toml")
    assert saved.uncertainty("c1") == pytest.approx(calibrated["se"], rel=1e-4)
    vehicle, _ = fix_parameters(horizontal_model(), tmp_path / "calibrated" / "model.toml", {})
    mean, sd = vehicle.parameter("c1").prior or (0.0, 0.0)
    assert (mean, sd) == (pytest.approx(plain["value"], rel=1e-6), pytest.approx(calibrated["se"], rel=1e-4))
    assert vehicle.parameter("c1").provenance == "measured"


def test_profile_of_an_unknown_parameter_is_rejected_before_the_fit(log: Path) -> None:
    done = CliRunner().invoke(ident, ["thruster", str(log), "--profile", "mass"])
    assert isinstance(done.exception, SeatrialError)
    assert "--profile mass: model thruster has" in str(done.exception)
    assert "fitting" not in done.output


@pytest.mark.study
def test_noise_is_restricted_by_default(log: Path) -> None:
    """Restricted likelihood increases the force noise and keeps the thrust curve. The model.toml contains the
    method.
    """
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


def test_a_window_of_a_bench_log_is_fitted_alone(tmp_path: Path) -> None:
    """Outside the window the load cell is wrong; the fit to the window does not see it."""
    recording, mission = push(draw_bench(4), kind="steps", count=2)
    end = recording.readings[-1].t
    begin, until = 0.05 * end, 0.9 * end
    wrong = [
        r._replace(sample=replace(r.sample, counts=-3.0 * r.sample.counts))
        if isinstance(r.sample, LoadCell) and r.t > until + 1.0
        else r
        for r in recording.readings
    ]
    good = write_log(tmp_path / "good.mcap", "bench", recording.readings, mission)
    spoilt_log = write_log(tmp_path / "spoilt.mcap", "bench", wrong, mission)
    window = st.thruster(st.open_log(spoilt_log, begin, until))
    same = st.thruster(st.open_log(good, begin, until))
    assert window.params["c1"] == pytest.approx(same.params["c1"], rel=1e-9)
    assert window.result.logs[0].path == f"spoilt.mcap[{begin:g}:{until:g}]"
    assert window.result.steady is not None
    assert np.isfinite(window.result.steady.power).any()
    words = ["thruster", str(spoilt_log), "--from", f"{begin}", "--to", f"{until}", "--out", str(tmp_path / "out")]
    CliRunner().invoke(ident, words, catch_exceptions=False)
    assert load_model(tmp_path / "out/model.toml").model.values["c1"] == pytest.approx(same.params["c1"], rel=1e-4)


def test_known_parameters_are_fixed(log: Path, tmp_path: Path) -> None:
    """The advice of a parameter at its bound is to fix it, so that the command has the option."""
    known = {"tau": 0.06, "d": 0.03, "c1": 38.0}
    words = [word for n, value in known.items() for word in ("--fix", f"{n}={value}")]
    done = CliRunner().invoke(ident, ["thruster", str(log), *words, "--out", str(tmp_path)], catch_exceptions=False)
    assert done.exit_code == 0
    saved = load_model(tmp_path / "model.toml").model
    for name, value in known.items():
        p = saved.parameter(name)
        assert (p.value, p.free, p.origin) == (value, False, "given")
    rows = {
        p["name"]: p for p in json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))["fit"]["parameters"]
    }
    assert all(rows[n]["se"] is None for n in known)
    assert rows["c2"]["se"] > 0.0
    found = st.thruster(log, fixed={"c1": 38.0, "c2": 1.0})
    assert "The thruster gives 39 N forward, as given, and 37 N in reverse, as given, at full speed" in found.answer
    with pytest.raises(SeatrialError, match="fixed: tau: 'x' is no number"):
        st.thruster(log, fixed={"tau": "x"})  # type: ignore[dict-item]
    with pytest.raises(SeatrialError, match="model thruster"):
        st.thruster(log, fixed={"m_u": 1.0})
