"""Force against command: known curves, autocorrelated readings, and what the next step makes of it."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

import seatrial
from daq.errors import SeatrialError
from ident.characterisation.thrust_curve import (
    Levels,
    ThrustCurve,
    adequate,
    curve_left_out,
    find_levels,
    fit_curve,
    fit_quadratic,
    load_curve,
    save_curve,
    thrust_channels,
)
from ident.data.record import Channel

COMMANDS = np.round(np.linspace(-1.0, 1.0, 11), 3)
MAP = """
format = "seatrial-import-csv 1"
[time]
rate_hz = 50.0
[[signal]]
name = "n_left"
column = "n"
unit = "1"
role = "input"
[[signal]]
name = "n_right"
column = "m"
unit = "1"
role = "input"
[[signal]]
name = "force"
column = "force"
unit = "N"
"""


def ar1(rng: np.random.Generator, rho: float, n: int) -> np.ndarray:
    x = np.empty(n)
    x[0] = rng.normal() / np.sqrt(1 - rho**2)
    for k in range(1, n):
        x[k] = rho * x[k - 1] + rng.normal()
    return x


def saturating(n: np.ndarray) -> np.ndarray:
    """Asymmetric, with a dead band, level above 0.6."""
    ahead = 50.0 * np.clip(np.abs(n) - 0.1, 0.0, 0.5)
    return np.where(n > 0, ahead, -0.3 * ahead)


def bench(truth: object, seed: int = 0, rho: float = 0.9) -> tuple[Channel, Channel]:
    rng = np.random.default_rng(seed)
    n = np.repeat(COMMANDS, 500)
    t = np.arange(n.size) * 0.02
    noise = np.concatenate([0.1 * ar1(rng, rho, 500) for _ in COMMANDS])
    return Channel(t, n), Channel(t, truth(n) + noise)  # type: ignore[operator]


def test_errors_are_the_scatter_of_the_levels() -> None:
    z = []
    for seed in range(40):
        levels = find_levels(*bench(saturating, seed), settle=0.0)
        z.append((levels.force - saturating(levels.n)) / levels.se)
    assert np.std(z) == pytest.approx(1.0, abs=0.2)
    naive = 0.1 / np.sqrt(1 - 0.9**2) / np.sqrt(500)
    assert np.median(levels.se) > 2.5 * naive  # readings that are not independent


def test_settling_is_left_out_and_visits_are_joined() -> None:
    command = np.repeat([0.0, 0.5, 0.0, 0.5], 200)
    t = np.arange(800) * 0.02
    force = np.where(command > 0, np.repeat([0.0, 10.0, 0.0, 12.0], 200), 0.0)
    force = force + np.where(np.arange(800) % 200 < 50, -5.0, 0.0) + 0.1 * np.random.default_rng(0).normal(size=800)
    levels = find_levels(Channel(t, command), Channel(t, force), settle=1.0)
    assert levels.n.tolist() == [0.0, 0.5]
    assert levels.n_samples.tolist() == [300.0, 300.0]
    assert levels.force[1] == pytest.approx(11.0, abs=0.3)
    assert levels.se[1] == pytest.approx(1.0, abs=0.05)  # 10 and 12 differ by far more than their own errors
    with pytest.raises(ValueError, match="nowhere held for 9 s"):
        find_levels(Channel(t, command), Channel(t, force), settle=9.0)


def test_the_quadratic_is_recovered_where_it_is_true() -> None:
    truth = lambda n: 40.0 * n * np.abs(n) + 3.0 * n * n  # noqa: E731
    levels = find_levels(*bench(truth, 3), settle=0.0)
    found = fit_quadratic(levels)
    errors = np.sqrt(np.diag(found.covariance))
    assert abs(found.c1 - 40.0) < 4 * errors[0]
    assert abs(found.c2 - 3.0) < 4 * errors[1]
    assert adequate(found)


def test_the_quadratic_is_rejected_where_the_thruster_saturates() -> None:
    levels = find_levels(*bench(saturating), settle=0.0)
    found = fit_quadratic(levels)
    assert not adequate(found)
    assert found.rms > 2.0
    assert curve_left_out(levels) < 0.5 * found.left_out
    curve = fit_curve(levels)
    grid = np.linspace(-1, 1, 401)
    assert (np.diff(curve(grid)) >= -1e-12).all()
    missed = np.abs(curve(grid) - saturating(grid))
    assert missed[np.abs(grid) < 0.2].max() < 2.5  # what a straight line misses of a knee half-way between levels
    assert missed[np.abs(grid) >= 0.2].max() < 4 / 27 * 10.0 + 0.2  # a cubic that comes level, from 10 N a step
    assert curve(np.array([-2.0, 2.0])).tolist() == [curve.force[0], curve.force[-1]]
    inside = np.array([-0.35, 0.25, 0.45])
    np.testing.assert_allclose(curve.slope(inside), (curve(inside + 1e-6) - curve(inside - 1e-6)) / 2e-6, rtol=1e-5)
    assert curve.slope(np.array([1.5]))[0] == 0.0


def test_levels_that_fall_are_pooled_and_say_so() -> None:
    n, force = np.array([0.0, 0.5, 1.0]), np.array([0.0, 10.0, 9.0])
    levels = Levels(n, force, np.full(3, 0.1), np.full(3, 100.0), np.ones(3))
    curve = fit_curve(levels)
    assert curve.force.tolist() == [0.0, 9.5, 9.5]
    assert curve.se[1] == pytest.approx(np.hypot(0.1, 0.5))


def test_the_file_comes_back(tmp_path: Path) -> None:
    levels = find_levels(*bench(saturating), settle=0.0)
    curve = fit_curve(levels)
    measured = ThrustCurve(curve, 2, 0.02)
    save_curve(tmp_path / "model.toml", measured, levels, fit_quadratic(levels), {"made_by": "test"})
    found = load_curve(tmp_path / "model.toml")
    assert found is not None
    assert (found.thrusters, found.calibration) == (2, 0.02)
    np.testing.assert_allclose(found.curve.force, curve.force, rtol=1e-6)
    np.testing.assert_allclose(found.of_one(COMMANDS), curve(COMMANDS) / 2, rtol=1e-6)
    other = tmp_path / "other.toml"
    other.write_text('format = "seatrial-model 1"\n')
    assert load_curve(other) is None
    text = (tmp_path / "model.toml").read_text()
    for bad in (text.replace("thrusters = 2", "thrusters = 0"), text.replace("[curve]", "[curves]"),
                text.replace("calibration = 0.02", "calibration = 2")):
        other.write_text(bad)
        with pytest.raises(SeatrialError, match=r"other\.toml: "):
            load_curve(other)


def test_thrust_from_commands(tmp_path: Path) -> None:
    levels = find_levels(*bench(saturating), settle=0.0)
    save_curve(tmp_path / "m.toml", ThrustCurve(fit_curve(levels), 2), levels, fit_quadratic(levels), {})
    curve = load_curve(tmp_path / "m.toml")
    assert curve is not None
    left = Channel(np.array([0.0, 1.0]), np.array([0.4, -0.4]))
    right = Channel(np.array([0.0, 0.5]), np.array([0.4, 0.5]))
    found = thrust_channels({"n_left": left, "n_right": right}, curve)
    assert found["X"].t.tolist() == [0.0, 0.5, 1.0]
    np.testing.assert_allclose(found["f_left"].value, curve.of_one(left.value))
    want = curve.of_one(np.array([0.4, 0.4, -0.4])) + curve.of_one(np.array([0.4, 0.5, 0.5]))
    np.testing.assert_allclose(found["X"].value, want)
    # A command further out by d is worth d X_n, ahead and astern.
    inward = Channel(left.t, left.value - 1e-6 * np.sign(left.value))
    wider = thrust_channels({"n_left": inward, "n_right": right}, curve)
    step = found["X"].value - wider["X"].value
    one = thrust_channels({"n_left": left, "n_right": Channel(right.t, np.zeros(2))}, curve)
    zero = thrust_channels({"n_left": Channel(left.t, np.zeros(2)), "n_right": Channel(right.t, np.zeros(2))}, curve)
    np.testing.assert_allclose(step, 1e-6 * (one["X_n"].value - zero["X_n"].value), rtol=1e-3)
    command = thrust_channels({"n_left": right, "n_cmd_left": left, "n_right": right}, curve)
    np.testing.assert_allclose(command["f_left"].value, curve.of_one(left.value))  # a command goes before a speed
    with pytest.raises(ValueError, match="no n_cmd_right and no n_right"):
        thrust_channels({"n_left": left}, curve)


def run(*words: str, status: int = 0) -> None:
    with pytest.raises(SystemExit) as left:
        seatrial.main(words)
    assert left.value.code == status, words


def write_bench(folder: Path, both: bool = True) -> str:
    command, force = bench(saturating)
    other = command.value if both else 0.5 * command.value
    np.savetxt(folder / "bench.csv", np.column_stack([command.value, other, force.value]), "%.6f", ",",
               header="n,m,force", comments="")  # fmt: skip
    (folder / "map.toml").write_text(MAP)
    run("import", str(folder / "map.toml"), str(folder / "bench.csv"), "-o", str(folder / "bench.mcap"))
    return str(folder / "bench.mcap")


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write_bench(tmp_path)
    run("ident", "thruster", log, "--out", str(tmp_path / "thruster"))
    assert "does not" in capsys.readouterr().out.replace("\n", " ")
    result = json.loads((tmp_path / "thruster/result.json").read_text())
    assert (result["kind"], len(result["static"]["n"])) == ("thrust_curve", 11)
    assert len(result["static"]["force_quadratic"]) == len(result["static"]["n_model"])
    table = tomllib.loads((tmp_path / "thruster/model.toml").read_text())
    assert table["thrusters"] == 2
    assert table["quadratic"]["adequate"] is False
    assert table["measured"]["n_samples"] == [425] * 11  # 1.5 s of 10 s left out of each
    assert "<html" in (tmp_path / "thruster/report.html").read_text()
    run("ident", "thruster", log, "--thruster", "right", "--settle", "0", "--out", str(tmp_path / "one"))
    assert tomllib.loads((tmp_path / "one/model.toml").read_text())["thrusters"] == 1
    run("ident", "thruster", log, "--robust", "--horizon", "2", "--out", str(tmp_path / "no"), status=1)
    assert "which --robust and --horizon cannot change" in capsys.readouterr().err


def test_commands_that_differ_have_to_be_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write_bench(tmp_path, both=False)
    run("ident", "thruster", log, "--out", str(tmp_path / "t"), status=1)
    assert "n_left and n_right differ; name the thruster" in capsys.readouterr().err
    run("ident", "thruster", log, "--thruster", "left", "--out", str(tmp_path / "t"))
