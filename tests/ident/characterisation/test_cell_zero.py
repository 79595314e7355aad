"""Tests of the drift of a load cell's zero between rests: it is found, subtracted, and reported by `seatrial ident
thruster`.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.import_files import import_files
from seatrial.ident.characterisation import zero_drift
from seatrial.ident.cli.commands import ident
from seatrial.ident.data import Channel
from seatrial.ident.numerics import Array

T = np.arange(0.0, 120.0, 0.05)
C1 = 40.0  # Unit: N


def bench(drift: Array | float = 0.0, noise: float = 0.05) -> tuple[Channel, Channel]:
    """Return command and force of levels of 4 s with rests of 6 s between them."""
    levels = np.array([0.2, -0.2, 0.4, -0.4, 0.6, -0.6, 0.8, -0.8, 0.2, 0.4, 0.6, 0.8])
    phase = T % 10.0
    n = np.where(phase < 6.0, 0.0, levels[(T // 10.0).astype(int)])
    force = C1 * n * np.abs(n) + drift + noise * np.random.default_rng(3).standard_normal(T.size)
    return Channel(T, n, hold="zero"), Channel(T, force, "N")


@pytest.mark.parametrize("noise", [0.05, 1.0])
def test_constant_zero_is_not_a_drift(noise: float) -> None:
    assert zero_drift(*bench(2.0, noise), 1.5) is None


@pytest.mark.parametrize("drift", [0.03 * T, 4.0 * (1.0 - np.exp(-T / 40.0)), -0.05 * T])
def test_drift_is_subtracted_between_the_rests(drift: Array) -> None:
    command, force = bench(drift)
    found = zero_drift(command, force, 1.5)
    assert found is not None
    left = found.without_drift(force).value - C1 * command.value * np.abs(command.value)
    inside = (found.t[0] < T) & (found.t[-1] > T)
    assert np.ptp(np.convolve(left[inside], np.full(40, 1 / 40), "valid")) < 0.15
    assert found.without_drift(force).value.mean() == pytest.approx(force.value.mean(), abs=0.15)
    assert "linear between the rests" in found.text


def log(folder: Path, force: Channel, command: Channel) -> Path:
    rows = zip(T, command.value, force.value, strict=True)
    (folder / "bench.csv").write_text("t,n,f\n" + "\n".join(f"{t:.3f},{n},{f:.5f}" for t, n, f in rows) + "\n")
    (folder / "map.toml").write_text(
        'format = "seatrial-import 1"\ntime = { column = "t" }\nsignal = [\n'
        '{ name = "n_cmd_left", column = "n", unit = "1", role = "input" },\n'
        '{ name = "force", column = "f", unit = "N" },\n]\n'
    )
    (made,) = import_files(folder / "map.toml", [folder / "bench.csv"], out_dir=folder)
    return made


def test_static_curve_is_corrected_for_the_drift_and_reports_it(tmp_path: Path) -> None:
    command, force = bench(0.05 * T)
    words = ["thruster", str(log(tmp_path, force, command)), "--out", str(tmp_path / "out")]
    CliRunner().invoke(ident, words, catch_exceptions=False)
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    (line,) = [note for note in result["notes"] if "load cell's zero drifts" in note]
    assert "12 rests" in line
    ends = dict(zip(result["static"]["n"], result["static"]["force"], strict=True))
    assert ends[0.8] == pytest.approx(0.64 * C1, abs=0.15)
    assert ends[-0.8] == pytest.approx(-0.64 * C1, abs=0.15)


def test_frozen_load_cell_is_rejected(tmp_path: Path) -> None:
    """`ident thruster` runs the log checks first, like every fit."""
    command, force = bench()
    frozen = np.where(T > 25.0, force.value[np.argmax(T > 25.0)], force.value)
    path = log(tmp_path, Channel(T, frozen, "N"), command)
    words = ["thruster", str(path), "--out", str(tmp_path / "out")]
    with pytest.raises(SeatrialError, match=r"force: .* the command changes \[channel-frozen\]"):
        CliRunner().invoke(ident, words, catch_exceptions=False)
    assert not (tmp_path / "out").exists()
    CliRunner().invoke(ident, [*words, "--despite-faults"], catch_exceptions=False)
    assert (tmp_path / "out" / "result.json").exists()
