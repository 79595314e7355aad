"""Tests of the static curve of force against command: known curves, autocorrelated readings, and its use as thrust."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from seatrial import command_line
from seatrial.daq.errors import SeatrialError
from seatrial.ident.characterisation.thrust_curve import (
    Levels,
    ThrustCurve,
    _merged_visits,
    adequate,
    clearly_falls,
    curve_left_out,
    find_levels,
    fit_curve,
    fit_quadratic,
    hold_advice,
    load_curve,
    save_curve,
    thrust_channels,
)
from seatrial.ident.data.record import Channel
from seatrial.ident.results.answers import curve_notes, curve_warnings
from seatrial.ident.workflows.thruster import curve_answer

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
    """Return an asymmetric force with a dead band that is constant above 0.6."""
    ahead = 50.0 * np.clip(np.abs(n) - 0.1, 0.0, 0.5)
    return np.where(n > 0, ahead, -0.3 * ahead)


def bench(truth: object, seed: int = 0, rho: float = 0.9) -> tuple[Channel, Channel]:
    rng = np.random.default_rng(seed)
    n = np.repeat(COMMANDS, 500)
    t = np.arange(n.size) * 0.02
    noise = np.concatenate([0.1 * ar1(rng, rho, 500) for _ in COMMANDS])
    return Channel(t, n), Channel(t, truth(n) + noise)  # type: ignore[operator]


def test_standard_errors_equal_the_scatter_of_the_levels() -> None:
    z = []
    for seed in range(40):
        levels = find_levels(*bench(saturating, seed), settle=0.0)
        z.append(((levels.force - saturating(levels.n)) / levels.error)[~levels.at_rest])
    assert np.std(z) == pytest.approx(1.0, abs=0.2)
    naive = 0.1 / np.sqrt(1 - 0.9**2) / np.sqrt(500)
    assert np.median(levels.se) > 2.5 * naive  # The readings are autocorrelated.


def test_settling_time_is_left_out_and_visits_are_joined() -> None:
    command = np.repeat([0.0, 0.5, 0.0, 0.5], 200)
    t = np.arange(800) * 0.02
    force = np.where(command > 0, np.repeat([0.0, 10.0, 0.0, 12.0], 200), 0.0)
    force = force + np.where(np.arange(800) % 200 < 50, -5.0, 0.0) + 0.1 * np.random.default_rng(0).normal(size=800)
    levels = find_levels(Channel(t, command), Channel(t, force), settle=1.0)
    assert levels.n.tolist() == [0.0, 0.5]
    assert levels.n_samples.tolist() == [300.0, 300.0]
    assert levels.force[1] == pytest.approx(11.0, abs=0.3)
    # The visits with 10 and 12 N differ by far more than their own errors.
    assert levels.se[1] == pytest.approx(1.0, abs=0.05)
    with pytest.raises(ValueError, match="a level needs 9 s to settle"):
        find_levels(Channel(t, command), Channel(t, force), settle=9.0)


def plan(*levels: float, hold: float = 8.0, rate: float = 20.0) -> tuple[np.ndarray, np.ndarray]:
    """Return times and commands of held levels."""
    n = np.repeat(levels, round(hold * rate))
    return np.arange(n.size) / rate, n


def pull(n: np.ndarray, noise: float = 0.3) -> np.ndarray:
    return 40.0 * n * np.abs(n) + noise * np.random.default_rng(0).standard_normal(n.size)


SYMMETRIC = (0, 0.25, -0.25, 0.5, -0.5, 0.75, -0.75, 1, -1, 0)


def test_zero_of_the_load_cell_is_subtracted_with_its_error() -> None:
    t, n = plan(*SYMMETRIC)
    levels = find_levels(Channel(t, n), Channel(t, pull(n) + 5.0))
    assert levels.offset == pytest.approx(5.0, abs=0.1)
    curve = fit_curve(levels)
    assert curve(np.zeros(1))[0] == 0.0
    np.testing.assert_allclose(curve(np.array([-1.0, 1.0])), [-40.0, 40.0], atol=0.2)
    assert curve.se[-1] == pytest.approx(np.hypot(levels.se[-1], levels.offset_se))
    found = fit_quadratic(levels)
    assert adequate(found)
    assert found.covariance[1, 1] > 2 * levels.offset_se**2  # The error of c2 includes that of the zero.
    (note,) = [line for line in curve_notes(levels, ThrustCurve(curve, 1), found) if "at rest" in line]
    assert note.startswith("The force on the load cell at rest, 5.")
    assert curve_warnings(levels) == []


def test_zero_is_unknown_without_a_rest() -> None:
    t, n = plan(*SYMMETRIC[1:-1])
    levels = find_levels(Channel(t, n), Channel(t, pull(n)))
    assert (levels.offset, levels.offset_se) == (None, 0.0)
    assert adequate(fit_quadratic(levels))
    (line,) = curve_warnings(levels)
    assert (line.code, "zero is unknown" in line.text) == ("zero-unknown", True)


def test_dead_band_gives_no_thrust_at_rest() -> None:
    """Levels inside the dead band contain only noise. Pooling must not leave this noise at rest."""
    n = np.array([-0.5, -0.1, 0.0, 0.1, 0.5])
    levels = Levels(n, np.array([-9.0, 0.2, 0.0, -0.1, 10.0]), np.full(5, 0.1), np.full(5, 50.0), np.ones(5), 5.0, 0.1)
    assert fit_curve(levels).force.tolist() == [-9.0, 0.0, 0.0, 0.0, 10.0]


@pytest.mark.parametrize("commands", [(0, 0.2, 0.4, 0.6, 0.8, 1, 0), (-0.4, -0.6, -0.8, -1), (0.2, 0.5, 0.7, 1)])
def test_commands_of_one_sign_give_one_coefficient(commands: tuple[float, ...]) -> None:
    t, n = plan(*commands)
    levels = find_levels(Channel(t, n), Channel(t, pull(n)))
    found = fit_quadratic(levels)
    assert (found.c2, found.covariance.shape) == (None, (1, 1))
    assert found.df == len(set(commands)) - 1 - (0 in commands)
    assert abs(found.c1 - 40.0) < 4 * np.sqrt(found.covariance[0, 0])
    assert adequate(found)
    answer = curve_answer(levels, ThrustCurve(fit_curve(levels), 1), found)
    lost, there = ("in reverse", "forward") if max(commands) > 0 else ("forward", "in reverse")
    assert f"{lost}: not measured" in answer
    assert f"N {there} at the largest commands" in answer
    assert "c1 n|n| describes them" in answer


@pytest.mark.parametrize(
    ("factor", "phrase"), [(1.0, "the largest is -3.8 N at"), (0.01, "the largest is -0.038 N at")]
)
def test_misfit_of_a_small_thruster_is_not_rounded_to_zero(factor: float, phrase: str) -> None:
    n = np.linspace(-1.0, 1.0, 11)
    force = factor * (40.0 * n * np.abs(n) + 4.0 * np.sin(9.0 * n))
    levels = Levels(n, force, np.full(11, 0.01 * factor), np.full(11, 50.0), np.ones(11), 5.0, 0.01 * factor)
    answer = curve_answer(levels, ThrustCurve(fit_curve(levels), 1), fit_quadratic(levels))
    assert phrase in answer
    assert " 0.0 N" not in answer


def test_common_variance_between_visits_gives_the_test_its_right_size() -> None:
    """Twelve levels of a true quadratic are visited twice. The scatter is far above the errors of the readings."""
    rng = np.random.default_rng(0)
    n = np.repeat(np.r_[-np.arange(6, 0, -1), np.arange(1, 7)] * 0.15, 2)
    rejected, z = 0, []
    for _ in range(300):
        force = 40.0 * n * np.abs(n) + 0.5 * rng.standard_normal(n.size)
        rows = zip(n, force, np.full(n.size, 0.05), np.full(n.size, 100), np.ones(n.size), strict=True)
        levels = _merged_visits(sorted(rows))
        rejected += not adequate(fit_quadratic(levels))
        z.append((levels.force - 40.0 * levels.n * np.abs(levels.n)) / levels.error)
    assert levels.dof == 12
    assert rejected <= 9  # Three are expected. With a separate scatter for each level, there were 246.
    assert np.mean(np.abs(z) < stats.t.isf(0.025, 12)) == pytest.approx(0.95, abs=0.02)


def test_scatter_at_rest_does_not_estimate_the_scatter_of_thrust() -> None:
    rows = [(0.0, 0.0, 0.1, 50, 1.0), (0.0, 3.0, 0.1, 50, 1.0), (0.5, 10.0, 0.1, 50, 1.0), (1.0, 40.0, 0.1, 50, 1.0)]
    levels = _merged_visits(rows)
    assert (levels.dof, levels.scatter) == (0, 0.0)
    np.testing.assert_allclose(levels.se, [1.5, 0.1, 0.1], rtol=0.01)


def test_too_short_hold_is_reported_with_a_suitable_settling_time() -> None:
    t, n = plan(0, 0.2, 0.4, 0.6, 0.8, hold=1.8, rate=20.0)
    with pytest.raises(
        ValueError, match=r"constant for 1\.8 s, and after --settle 1\.5 s there remain 0\.3 s.*try --settle 0\.8"
    ):
        find_levels(Channel(t, n), Channel(t, pull(n)))
    assert find_levels(Channel(t, n), Channel(t, pull(n)), settle=0.8).n.size == 5
    assert "more than 3.5 s (seatrial bench steps --hold)" in hold_advice(Channel(t, n), Channel(t[::2], n[::2]), 1.5)


@pytest.mark.parametrize(("scale", "error", "falling"), [(-40.0, 0.1, True), (40.0, 0.1, False), (-0.05, 0.1, False)])
def test_falling_force_is_found_beyond_its_errors(scale: float, error: float, *, falling: bool) -> None:
    n = np.linspace(-1, 1, 9)
    assert clearly_falls(n, scale * n * np.abs(n), error) is falling
    assert not clearly_falls(n, np.ones(9))


def test_true_quadratic_is_recovered() -> None:
    truth = lambda n: 40.0 * n * np.abs(n) + 3.0 * n * n  # noqa: E731
    levels = find_levels(*bench(truth, 3), settle=0.0)
    found = fit_quadratic(levels)
    errors = np.sqrt(np.diag(found.covariance))
    assert abs(found.c1 - 40.0) < 4 * errors[0]
    assert abs(found.c2 - 3.0) < 4 * errors[1]
    assert adequate(found)


def test_quadratic_is_rejected_for_a_saturating_thruster() -> None:
    levels = find_levels(*bench(saturating), settle=0.0)
    found = fit_quadratic(levels)
    assert not adequate(found)
    assert found.rms > 2.0
    assert curve_left_out(levels) < 0.5 * found.left_out
    curve = fit_curve(levels)
    grid = np.linspace(-1, 1, 401)
    assert (np.diff(curve(grid)) >= -1e-12).all()
    missed = np.abs(curve(grid) - saturating(grid))
    # This is the error of a straight line at a knee half-way between two levels.
    assert missed[np.abs(grid) < 0.2].max() < 2.5
    # This is the error of a cubic that flattens, from 10 N per step.
    assert missed[np.abs(grid) >= 0.2].max() < 4 / 27 * 10.0 + 0.2
    assert curve(np.array([-2.0, 2.0])).tolist() == [curve.force[0], curve.force[-1]]
    inside = np.array([-0.35, 0.25, 0.45])
    np.testing.assert_allclose(curve.slope(inside), (curve(inside + 1e-6) - curve(inside - 1e-6)) / 2e-6, rtol=1e-5)
    assert curve.slope(np.array([1.5]))[0] == 0.0


def test_falling_levels_are_pooled_with_a_larger_error() -> None:
    n, force = np.array([0.0, 0.5, 1.0]), np.array([0.0, 10.0, 9.0])
    levels = Levels(n, force, np.full(3, 0.1), np.full(3, 100.0), np.ones(3))
    curve = fit_curve(levels)
    assert curve.force.tolist() == [0.0, 9.5, 9.5]
    assert curve.se[1] == pytest.approx(np.hypot(0.1, 0.5))


def test_curve_is_restored_from_its_file(tmp_path: Path) -> None:
    levels = find_levels(*bench(saturating), settle=0.0)
    curve = fit_curve(levels)
    measured = ThrustCurve(curve, 2, 0.02)
    save_curve(tmp_path / "model.toml", measured, levels, fit_quadratic(levels), {"made_by": "test"})
    found = load_curve(tmp_path / "model.toml")
    assert found is not None
    assert (found.thrusters, found.calibration) == (2, 0.02)
    np.testing.assert_allclose(found.curve.force, curve.force, rtol=1e-6)
    np.testing.assert_allclose(found.thrust_of_one(COMMANDS), curve(COMMANDS) / 2, rtol=1e-6)
    path = tmp_path / "other.toml"
    path.write_text('format = "seatrial-model 1"\n')
    assert load_curve(path) is None
    text = (tmp_path / "model.toml").read_text()
    for bad in (
        text.replace("thrusters = 2", "thrusters = 0"),
        text.replace("[curve]", "[curves]"),
        text.replace("calibration = 0.02", "calibration = 2"),
    ):
        path.write_text(bad)
        with pytest.raises(SeatrialError, match=r"other\.toml: "):
            load_curve(path)


def test_thrust_from_commands(tmp_path: Path) -> None:
    levels = find_levels(*bench(saturating), settle=0.0)
    save_curve(tmp_path / "m.toml", ThrustCurve(fit_curve(levels), 2), levels, fit_quadratic(levels), {})
    curve = load_curve(tmp_path / "m.toml")
    assert curve is not None
    left = Channel(np.array([0.0, 1.0]), np.array([0.4, -0.4]))
    right = Channel(np.array([0.0, 0.5]), np.array([0.4, 0.5]))
    found = thrust_channels({"n_left": left, "n_right": right}, curve)
    assert found["X"].t.tolist() == [0.0, 0.5, 1.0]
    np.testing.assert_allclose(found["f_left"].value, curve.thrust_of_one(left.value))
    want = curve.thrust_of_one(np.array([0.4, 0.4, -0.4])) + curve.thrust_of_one(np.array([0.4, 0.5, 0.5]))
    np.testing.assert_allclose(found["X"].value, want)
    # A command shifted outwards by d changes the force by d X_n, forward and in reverse.
    inward = Channel(left.t, left.value - 1e-6 * np.sign(left.value))
    wider = thrust_channels({"n_left": inward, "n_right": right}, curve)
    step = found["X"].value - wider["X"].value
    left_only = thrust_channels({"n_left": left, "n_right": Channel(right.t, np.zeros(2))}, curve)
    zero = thrust_channels({"n_left": Channel(left.t, np.zeros(2)), "n_right": Channel(right.t, np.zeros(2))}, curve)
    np.testing.assert_allclose(step, 1e-6 * (left_only["X_n"].value - zero["X_n"].value), rtol=1e-3)
    command = thrust_channels({"n_left": right, "n_cmd_left": left, "n_right": right}, curve)
    # A command has priority over a shaft speed.
    np.testing.assert_allclose(command["f_left"].value, curve.thrust_of_one(left.value))
    with pytest.raises(ValueError, match="neither n_cmd_right nor n_right"):
        thrust_channels({"n_left": left}, curve)


def run(*words: str, status: int = 0) -> None:
    with pytest.raises(SystemExit) as left:
        command_line.main(words)
    assert left.value.code == status, words


def write_bench(folder: Path, both: bool = True, sign: float = 1.0) -> str:
    command, force = bench(lambda n: sign * saturating(n))
    right = command.value if both else 0.5 * command.value
    np.savetxt(folder / "bench.csv", np.column_stack([command.value, right, force.value]), "%.6f", ",",
               header="n,m,force", comments="")  # fmt: skip
    (folder / "map.toml").write_text(MAP)
    run("import", str(folder / "map.toml"), str(folder / "bench.csv"), "-o", str(folder / "bench.mcap"))
    return str(folder / "bench.mcap")


def test_thruster_command_with_a_static_curve(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write_bench(tmp_path)
    run("ident", "thruster", log, "--out", str(tmp_path / "thruster"))
    assert "does not" in capsys.readouterr().out.replace("\n", " ")
    result = json.loads((tmp_path / "thruster/result.json").read_text())
    assert (result["kind"], len(result["static"]["n"])) == ("thrust_curve", 11)
    assert len(result["static"]["force_quadratic"]) == len(result["static"]["n_model"])
    table = tomllib.loads((tmp_path / "thruster/model.toml").read_text())
    assert table["thrusters"] == 2
    assert table["quadratic"]["adequate"] is False
    assert table["measured"]["n_samples"] == [425] * 11  # Of each 10 s, the first 1.5 s are left out.
    assert "<html" in (tmp_path / "thruster/report.html").read_text()
    run("ident", "thruster", log, "--thruster", "right", "--settle", "0", "--out", str(tmp_path / "one"))
    assert tomllib.loads((tmp_path / "one/model.toml").read_text())["thrusters"] == 1
    run("ident", "thruster", log, "--robust", "--horizon", "2", "--out", str(tmp_path / "no"), status=1)
    assert "which does not use --robust and --horizon" in capsys.readouterr().err


def test_thruster_must_be_named_if_commands_differ(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write_bench(tmp_path, both=False)
    run("ident", "thruster", log, "--out", str(tmp_path / "t"), status=1)
    assert "n_left and n_right differ; name the thruster" in capsys.readouterr().err
    run("ident", "thruster", log, "--thruster", "left", "--out", str(tmp_path / "t"))


def test_reversed_load_cell_gives_a_one_line_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write_bench(tmp_path, sign=-1.0)
    run("ident", "thruster", log, "--out", str(tmp_path / "t"), status=1)
    assert "bench.mcap: the force falls as the command rises: the load cell is reversed" in capsys.readouterr().err
    assert not (tmp_path / "t/model.toml").exists()


def test_too_few_levels_are_reported_with_the_remaining_hold(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write_bench(tmp_path)
    run("ident", "thruster", log, "--settle", "9.9", "--out", str(tmp_path / "t"), status=1)
    assert "constant for 10 s, and after --settle 9.9 s there remain 0.1 s" in capsys.readouterr().err
