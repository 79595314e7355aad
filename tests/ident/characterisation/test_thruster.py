"""Tests of the thruster command: one direction only, wrong signs, and the errors of both ends."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from seatrial import command_line
from seatrial.daq.errors import SeatrialError
from seatrial.ident.characterisation.steady_bench import steady_rows
from seatrial.ident.characterisation.thruster import largest_speeds, steady_thrust
from seatrial.ident.data.record import Channel
from seatrial.ident.estimation.prior_knowledge import fix_parameters
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.report.formatting import plain
from seatrial.ident.results.answers import thruster_answer

pytestmark = pytest.mark.usefixtures("quick_compilation")

MAP = """
format = "seatrial-import 1"
[time]
column = "t"
[[signal]]
name = "n_cmd_left"
column = "cmd"
unit = "1"
role = "input"
[[signal]]
name = "n_left"
column = "n"
unit = "1"
[[signal]]
name = "force"
column = "force"
unit = "N"
"""
AHEAD = (0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.6, 0.3, 0)
BOTH = (0, 0.2, 0.4, 0.6, 0.9, 0.5, 0, -0.2, -0.4, -0.6, -0.9, -0.5, 0)
DT = 0.05


def run(*words: str, status: int = 0) -> None:
    with pytest.raises(SystemExit) as left:
        command_line.main(words)
    assert left.value.code == status, words


def write_bench(folder: Path, levels: tuple[float, ...], shaft_sign: float = 1.0, force_sign: float = 1.0) -> str:
    """Write a log of levels of 3 s each: first-order shaft, 0.1 s late, at full speed 41.1 N forward and 38.9 N in
    reverse.
    """
    rng = np.random.default_rng(0)
    command = np.repeat(levels, round(3.0 / DT))
    late, n = np.append([0.0, 0.0], command[:-2]), np.zeros(command.size)
    for k in range(1, n.size):
        n[k] = n[k - 1] + (1 - np.exp(-5.0 * DT)) * (late[k - 1] - n[k - 1])
    force = force_sign * (40 * n * np.abs(n) + 1.1 * n * n) + 0.2 * rng.standard_normal(n.size)
    shaft = shaft_sign * n + 0.003 * rng.standard_normal(n.size)
    rows = np.column_stack([np.arange(n.size) * DT, command, shaft, force])
    np.savetxt(folder / "bench.csv", rows, "%.5f", ",", header="t,cmd,n,force", comments="")
    (folder / "map.toml").write_text(MAP)
    run("import", str(folder / "map.toml"), str(folder / "bench.csv"), "-o", str(folder / "bench.mcap"))
    return str(folder / "bench.mcap")


def test_direction_that_was_not_measured_has_no_thrust(tmp_path: Path) -> None:
    """With one direction, only c1 + c2 is identifiable. The command fixes c2, and the vehicle fit uses that."""
    run("ident", "thruster", write_bench(tmp_path, AHEAD), "--out", str(tmp_path / "t"))
    result = json.loads((tmp_path / "t/result.json").read_text())
    assert "41.0" in result["answer"] or "41.1" in result["answer"]
    assert "in reverse: not measured" in result["answer"]
    assert "nan" not in result["answer"]
    assert result["warnings"][0]["code"] == "one-direction"
    assert min(result["static"]["n_model"]) == 0.0
    saved = {p["name"]: p for p in tomllib.loads((tmp_path / "t/model.toml").read_text())["parameter"]}
    assert (saved["c2"]["value"], saved["c2"]["free"]) == (0.0, False)
    assert abs(saved["c1"]["value"] - 41.1) < 4 * saved["c1"]["se"] < 1.0
    vehicle, notes = fix_parameters(horizontal_model(), tmp_path / "t/model.toml", {})
    c1, c2 = vehicle.parameter("c1"), vehicle.parameter("c2")
    assert (c1.prior or (0, 0))[1] == pytest.approx(saved["c1"]["se"])
    assert (c2.value, c2.free, str(c2.provenance)) == (0.0, False, "built-in")
    (note,) = notes
    assert "cannot separate c2 from c1" in note
    # An older model.toml, in which both were free and had no error.
    text = (tmp_path / "t/model.toml").read_text()
    bad = "\n".join(line for line in text.splitlines() if not line.startswith("se = "))
    (tmp_path / "bad.toml").write_text(bad)
    with pytest.raises(SeatrialError, match=r"bad\.toml: c1 = 41\S* N has no standard error: .* add forward"):
        fix_parameters(horizontal_model(), tmp_path / "bad.toml", {})
    fixed, _ = fix_parameters(horizontal_model(), tmp_path / "bad.toml", {"c1": 40.0})
    assert fixed.parameter("c1").value == 40.0


@pytest.mark.parametrize(
    ("shaft", "force", "message"),
    [
        (1.0, -1.0, "the force falls as the command rises"),
        (-1.0, 1.0, "left: the shaft turns in reverse at forward commands"),
    ],
)
def test_wrong_sign_gives_a_one_line_error(
    shaft: float, force: float, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run("ident", "thruster", write_bench(tmp_path, BOTH, shaft, force), "--out", str(tmp_path / "t"), status=1)
    err = capsys.readouterr().err
    assert f"bench.mcap: {message}" in err
    assert err.count("\n") == 1
    assert not (tmp_path / "t/model.toml").exists()


def estimates(correlation: float) -> Any:
    values = {"a": 5.0, "tau": 0.1, "d": 0.05, "c1": 40.0, "c2": 1.0}
    covariance = np.array([[0.09, correlation * 0.12], [correlation * 0.12, 0.16]])
    return SimpleNamespace(estimate=lambda n: (values[n], 0.1), names=("c1", "c2"), covariance=covariance)


def test_each_direction_has_its_own_error_by_the_covariance() -> None:
    force, error = steady_thrust(estimates(-0.8), np.array([1.0, -1.0, 0.0]))
    np.testing.assert_allclose(force, [41.0, -39.0, 0.0])
    np.testing.assert_allclose(error, np.sqrt([0.25 - 2 * 0.096, 0.25 + 2 * 0.096, 0.0]))
    answer = thruster_answer(estimates(-0.8), has_force=True)
    assert (
        "gives 41.00 ± 0.24 N forward and 39.00 ± 0.66 N in reverse at full speed (errors: statistical only)" in answer
    )
    answer = thruster_answer(estimates(-0.8), has_force=True, calibration=0.1)
    assert "gives 41.0 ± 4.1 N forward and 39.0 ± 4.0 N in reverse" in answer
    assert "The logs do not determine the thrust" in thruster_answer(estimates(np.nan), has_force=True)
    vague = estimates(-0.8)
    vague.covariance = 1600.0 * vague.covariance  # the standard errors are 10 N ahead and 26 N in reverse
    vague.estimate = lambda n: (5.0, 3.0) if n == "a" else estimates(0.0).estimate(n)
    answer = thruster_answer(vague, has_force=True)
    assert "N forward at full speed (errors: statistical only; in reverse: not determined)" in answer
    assert "a time constant that is not determined" in answer


def test_errors_of_steady_points_include_autocorrelation() -> None:
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 4.0, 0.0125)
    noise = np.zeros(t.size)
    for k in range(1, t.size):
        noise[k] = 0.95 * noise[k - 1] + rng.standard_normal()
    half = Channel(t, np.full(t.size, 0.5))
    (row,) = steady_rows({"n_cmd_a": half, "n_a": half, "force": Channel(t, noise)}, "n_cmd_a", "n_a")
    sd = row.force_se
    last = noise[t > t[-1] - 2.0]  # the second half
    assert sd > 2 * last.std() / np.sqrt(last.size)


def test_thrust_beyond_the_measured_speeds_is_called_extrapolated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    half = (0, 0.2, 0.35, 0.5, 0.3, 0, -0.2, -0.3, -0.4, -0.3, 0)
    run("ident", "thruster", write_bench(tmp_path, half), "--out", str(tmp_path / "t"))
    said = "extrapolated, as it was measured only up to 50 % of full speed forward and 40 % of full speed in reverse"
    assert said in " ".join(capsys.readouterr().out.split())
    assert "extrapolated, as it was measured only up to 50" in (tmp_path / "t/report.html").read_text(encoding="utf-8")
    table = np.genfromtxt(tmp_path / "t/lookup.csv", delimiter=",", names=True)
    inside = (table["command"] < 0.495) & (table["command"] > -0.395)
    beyond = (table["command"] > 0.515) | (table["command"] < -0.415)
    assert (table["extrapolated"][inside] == 0).all()
    assert (table["extrapolated"][beyond] == 1).all()
    assert inside.any()
    assert beyond.any()
    parameters = (tmp_path / "t/ardupilot.param").read_text()
    assert "SET IT TO 0 AGAIN BEFORE SEATRIAL DRIVES THE THRUSTERS" in parameters
    assert "fitted to 4 steady commands, n = 0.2 to 0.5 of full command" in parameters
    limit = parameters.rstrip().endswith("MOT_THST_EXPO,1.000")
    assert ("at its limit (1.000)" in parameters) == limit


def test_full_speed_is_not_called_extrapolated() -> None:
    answer = thruster_answer(estimates(-0.8), has_force=True, reach={1.0: 0.99, -1.0: 0.97})
    assert "extrapolated" not in answer
    answer = thruster_answer(estimates(-0.8), has_force=True, reach={1.0: 0.5, -1.0: 0.502})
    assert (
        "at full speed (errors: statistical only; extrapolated, as it was measured only up to 50 % of full speed)"
        in (answer)
    )


def test_single_outliers_do_not_extend_the_measured_speeds() -> None:
    n = np.repeat([0.0, 0.5, -0.4, 0.9], [50, 50, 50, 3])
    assert largest_speeds(n) == {1.0: 0.5, -1.0: 0.4}


def test_tables_for_other_programs_are_written(tmp_path: Path) -> None:
    """The thrust is a square of the shaft speed, so the exponent of ArduPilot is one."""
    run("ident", "thruster", write_bench(tmp_path, BOTH), "--out", str(tmp_path / "t"))
    steady = np.genfromtxt(tmp_path / "t/steady.csv", delimiter=",", names=True)
    held = steady["command"] == 0.6
    assert steady["n"][held] == pytest.approx(0.6, abs=0.01)
    assert steady["force_N"][held] == pytest.approx(41.1 * 0.36, abs=0.5)
    assert np.isnan(steady["power_W"]).all()  # the log has no current
    model = tomllib.loads((tmp_path / "t/model.toml").read_text())
    offset = next(float(p["value"]) for p in model["parameter"] if p["name"] == "bias")
    np.testing.assert_allclose(steady["subtracted_offset_N"], offset, rtol=1e-5)
    table = np.genfromtxt(tmp_path / "t/lookup.csv", delimiter=",", names=True)
    assert np.all(np.diff(table["force_N"]) > 0.0)
    assert np.all(np.diff(table["command"]) >= 0.0)
    wanted = np.interp(41.1 * 0.49, table["force_N"], table["command"])
    assert wanted == pytest.approx(0.7, abs=0.02)
    (line,) = [x for x in (tmp_path / "t/ardupilot.param").read_text().splitlines() if not x.startswith("#")]
    name, _, value = line.partition(",")
    assert name == "MOT_THST_EXPO"
    assert float(value) == pytest.approx(1.0, abs=0.05)
    page = (tmp_path / "t/report.html").read_text(encoding="utf-8")
    assert "Bode plot" in page
    assert f"less the fitted offset of the load cell: {plain(offset, 3)} N." in page
    assert "Force against command" in page
    assert "MOT_THST_EXPO = " in page
    assert "heading accumulate" not in page
