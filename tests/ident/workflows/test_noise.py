"""Tests of `seatrial ident noise` on logs with known noise and on measured sensors at rest."""

from __future__ import annotations

import json
import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from seatrial import command_line
from seatrial.daq.protocol import vectornav
from seatrial.daq.samples import Ahrs
from tests.measured.data import measured

EXAMPLES = Path(__file__).resolve().parents[3] / "docs/examples/static"
MAP = """
format = "seatrial-import-csv 1"
[time]
rate_hz = 20.0
"""
SIGNAL = '[[signal]]\nname = "{0}"\ncolumn = "{0}"\nunit = "{1}"\nrole = "output"\n'


def run(*words: str, status: int = 0) -> None:
    with pytest.raises(SystemExit) as left:
        command_line.main([str(w) for w in words])
    assert left.value.code == status, words


@pytest.fixture
def still(tmp_path: Path) -> Path:
    """Return a log with four signals: r has white noise 0.01 and random walk 0.002, psi crosses the half turn, smooth
    is filtered, and dead is constant.
    """
    rng = np.random.default_rng(0)
    n = 4000
    r = 0.01 * rng.normal(size=n) + 0.002 * np.sqrt(0.05) * np.cumsum(rng.normal(size=n))
    psi = np.mod(math.pi + 0.05 * rng.normal(size=n) + math.pi, 2 * math.pi) - math.pi
    smooth = np.convolve(rng.normal(size=n), np.hanning(20), mode="same")
    table = np.column_stack([r, psi, smooth, np.ones(n)])
    np.savetxt(tmp_path / "still.csv", table, "%.8f", ",", header="r,psi,smooth,dead", comments="")
    units = {"r": "rad/s", "psi": "rad", "smooth": "m", "dead": "V"}
    (tmp_path / "map.toml").write_text(MAP + "".join(SIGNAL.format(n, u) for n, u in units.items()))
    run("import", tmp_path / "map.toml", tmp_path / "still.csv", "-o", tmp_path / "still.mcap")
    return tmp_path / "still.mcap"


def read(folder: Path) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    result = json.loads((folder / "result.json").read_text())
    table = tomllib.loads((folder / "noise.toml").read_text())
    assert table["format"] == "seatrial-noise 2"
    return result, {c["name"] if len(table["provenance"]["logs"]) == 1 else f"{c['log']} {c['name']}": c
                    for c in table["channel"]}  # fmt: skip


def test_known_noise_is_estimated(still: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run("ident", "noise", still, "--out", tmp_path / "noise")
    output = " ".join(capsys.readouterr().out.split())
    result, channels = read(tmp_path / "noise")
    assert set(channels) == {"r", "psi", "smooth"}
    for name, white, walk in (("r", 0.01, 0.002), ("psi", 0.05, 0.0)):
        c = channels[name]
        assert abs(c["white"] - white) < 4 * c["white_se"]
        assert abs(c["random_walk"] - walk) < 4 * c.get("random_walk_se", 0.01)
        assert c["accepted"]
        assert "reason" not in c
    assert not channels["smooth"]["accepted"]
    assert channels["smooth"]["reason"].startswith("its innovations are correlated by +0.")
    assert "2 of 3 channels are white noise plus a random walk. These are not: smooth. Such numbers" in output
    assert channels["smooth"]["predictable"] > 0.3
    assert "do not put them into a filter" in output
    assert any(line.startswith("smooth: not white") and line.endswith("at a lower rate.") for line in result["notes"])
    assert any("dead: all samples have the same value" in line for line in result["notes"])
    assert {r["channel"]: r["accepted"] for r in result["noise"]} == {"r": True, "psi": True, "smooth": False}
    report = (tmp_path / "noise/report.html").read_text()
    assert "Sensor noise" in report


def test_json_output_is_only_the_result_without_its_curves(
    still: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    run("ident", "noise", still, "--out", tmp_path / "noise", "--json")
    printed, beside = capsys.readouterr()
    shown, result = json.loads(printed), read(tmp_path / "noise")[0]
    assert "report.html" in beside
    curves = {"noise", "curves_file"}  # the file with the curves belongs to result.json
    assert {k: v for k, v in shown.items() if k not in curves} == {k: v for k, v in result.items() if k not in curves}
    for short, whole in zip(shown["noise"], result["noise"], strict=True):
        left_out = {k for k, v in whole.items() if isinstance(v, list) or (isinstance(v, dict) and "parquet" in v)}
        assert {"frequency", "psd", "psd_model"} <= left_out
        kept = {k: v for k, v in whole.items() if k not in left_out | {"bands", "allan"}}
        assert {k: v for k, v in short.items() if k not in ("bands", "allan")} == kept
        assert short["allan"] == {k: v for k, v in whole["allan"].items() if not isinstance(v, list)}
    assert len(printed) < 6000 < (tmp_path / "noise/result.json").stat().st_size


def test_only_the_named_signals_are_analysed(still: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run("ident", "noise", still, "--signal", "psi", "--signal", "r", "--out", tmp_path / "some")
    assert list(read(tmp_path / "some")[1]) == ["psi", "r"]
    run("ident", "noise", still, "--signal", "rr", "--out", tmp_path / "x", status=1)
    assert "still.mcap: no signal 'rr'; the log has dead, psi, r, smooth" in " ".join(capsys.readouterr().err.split())
    run("ident", "noise", still, "--signal", "dead", "--out", tmp_path / "x", status=1)
    assert "all samples have the same value" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "x").exists()


def test_all_axes_of_an_ahrs_are_analysed(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    capture = tmp_path / "vn.txt"
    rows = 0.01 * rng.normal(size=(600, 9)) + [0, 0, 0, 0, 0, 0, 0, 0, -9.8]
    capture.write_bytes(b"".join(vectornav.encode_ascii(Ahrs(*row)) for row in rows))
    run("import", "raw", "vectornav", capture, "--rate", "40", "-o", tmp_path / "vn.mcap")
    run("ident", "noise", tmp_path / "vn.mcap", "--out", tmp_path / "noise")
    channels = read(tmp_path / "noise")[1]
    assert set(channels) == {"psi", "theta", "phi", "p", "q", "r", "ax", "ay", "az"}
    assert all(c["white"] == pytest.approx(0.01, rel=0.15) for c in channels.values())
    assert channels["az"]["interval"] == pytest.approx(0.025)


def test_hum_is_reported_with_its_frequency(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    t = 0.05 * np.arange(4000)
    hum = rng.normal(size=4000) + np.sin(2 * np.pi * 3.2 * t)
    np.savetxt(tmp_path / "hum.csv", hum, "%.8f", header="r", comments="")
    (tmp_path / "map.toml").write_text(MAP + SIGNAL.format("r", "rad/s"))
    run("import", tmp_path / "map.toml", tmp_path / "hum.csv", "-o", tmp_path / "hum.mcap")
    run("ident", "noise", tmp_path / "hum.mcap", "--out", tmp_path / "noise")
    result, channels = read(tmp_path / "noise")
    assert channels["r"]["reason"].startswith("a spectral line at 3.2 Hz has 3")
    assert "Find what turns or hums" in result["notes"][0]


def test_spikes_and_coarse_resolution_are_reported_first(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    r = 0.01 * rng.normal(size=4000)
    spikes = r + np.where(np.arange(4000) % 900 == 450, 1.0, 0.0)
    table = np.column_stack([r, spikes, 0.06 * np.round(rng.normal(size=4000) / 6.0)])
    np.savetxt(tmp_path / "odd.csv", table, "%.8f", ",", header="r,q,p", comments="")
    (tmp_path / "map.toml").write_text(MAP + "".join(SIGNAL.format(n, "rad/s") for n in "rqp"))
    run("import", tmp_path / "map.toml", tmp_path / "odd.csv", "-o", tmp_path / "odd.mcap")
    for name, message in (
        ("q", ", but with 4 of 4000 innovations beyond 6 standard deviations, the largest "),
        ("p", "steps of 0.06 rad/s from value to value, coarse compared with its noise."),
        ("r", "The channel is white noise plus a random walk."),
    ):
        run("ident", "noise", tmp_path / "odd.mcap", "--signal", name, "--out", tmp_path / name)
        result = read(tmp_path / name)[0]
        assert message in result["answer"]
        consequence = {"q": "The numbers include these samples", "p": "The numbers are not those"}.get(
            name, "The numbers "
        )
        assert any(consequence in line for line in result["notes"]) == (name != "r")
    run("ident", "noise", tmp_path / "odd.mcap", "--out", tmp_path / "all")
    both = "All 3 channels are white noise plus a random walk, but with spikes, jumps or coarse steps in q, p."
    assert read(tmp_path / "all")[0]["answer"] in (both, both.replace("q, p", "p, q"))


@pytest.mark.measured
def test_gps_at_rest(tmp_path: Path) -> None:
    folder = measured("static")
    logs = []
    for name, pattern in (("single", "gps_LAB1_*.csv"), ("rtk", "gps_LAB2_*.csv")):
        (file,) = folder.glob(pattern)
        logs.append(tmp_path / f"{name}.mcap")
        run("import", EXAMPLES / f"gps_{name}.toml", file, "-o", logs[-1])
    run("ident", "noise", *logs, "--out", tmp_path / "noise")
    result, channels = read(tmp_path / "noise")
    assert [c for c, row in channels.items() if row["accepted"]] == ["rtk x", "rtk y"]
    assert channels["rtk x"]["white"] == pytest.approx(0.0030, abs=0.0003)
    assert channels["single x"]["largest_correlation"] > 0.8
    assert "These are not: single x" in result["answer"]


@pytest.mark.measured
def test_a_vectornav_at_rest(tmp_path: Path) -> None:
    capture = measured("static") / "vn100_stationary_40Hz_vnymr.txt"
    run("import", "raw", "vectornav", capture, "--rate", "40", "-o", tmp_path / "vn.mcap")
    run("ident", "noise", tmp_path / "vn.mcap", "--signal", "psi", "--out", tmp_path / "noise")
    (psi,) = read(tmp_path / "noise")[1].values()
    assert math.degrees(psi["random_walk"]) == pytest.approx(0.0104, rel=0.05)
    assert "white_se" not in psi  # The signal is nearly a pure random walk.
    assert psi["accepted"]


@pytest.mark.measured
def test_vibrating_channels_of_a_vectornav_are_rejected(tmp_path: Path) -> None:
    capture = measured("static") / "vn100_stationary_40Hz_vnymr.txt"
    run("import", "raw", "vectornav", capture, "--rate", "40", "-o", tmp_path / "vn.mcap")
    run("ident", "noise", tmp_path / "vn.mcap", "--out", tmp_path / "noise")
    channels = read(tmp_path / "noise")[1]
    assert {n for n, c in channels.items() if c["accepted"]} == {"psi", "r", "ax", "ay"}
    # There are 31 lags, none with a correlation above 0.17.
    assert channels["az"]["predictable"] == pytest.approx(0.12, abs=0.01)


def test_a_log_is_cut_at_its_gap(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    t = np.append(np.arange(2000), np.arange(2000) + 2_000_000) * 0.05
    r = 0.01 * rng.normal(size=t.size) + np.where(t > 1000.0, 5.0, 0.0)
    np.savetxt(tmp_path / "still.csv", np.column_stack([t, r]), "%.8f", ",", header="t,r", comments="")
    clock = 'format = "seatrial-import-csv 1"\n[time]\ncolumn = "t"\n'
    (tmp_path / "map.toml").write_text(clock + SIGNAL.format("r", "rad/s"))
    run("import", tmp_path / "map.toml", tmp_path / "still.csv", "-o", tmp_path / "still.mcap")
    run("ident", "noise", tmp_path / "still.mcap", "--out", tmp_path / "noise")
    result, noise = read(tmp_path / "noise")
    assert noise["r"]["accepted"]
    assert noise["r"]["n"] == 4000
    assert noise["r"]["white"] == pytest.approx(0.01, rel=0.1)
    assert any("r: cut at 1 gap" in note for note in result["notes"])
