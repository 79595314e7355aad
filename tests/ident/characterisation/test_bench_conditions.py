"""Tests of the conditions of a thruster's log: a boat at rest, and a dead zone that the shaft speeds confirm."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from seatrial.ident.characterisation.bench_conditions import speed_over_ground, turning_inside_dead_zone
from seatrial.ident.data.record import Channel
from seatrial.ident.estimation.model_file import load_model
from seatrial.ident.export.formats import export
from seatrial.ident.export.joined import Drive, _remarks
from seatrial.ident.models.dead_zone import TURNS_INSIDE
from seatrial.ident.results.answers import dead_zone_warnings, moving_boat_warnings
from tests.ident.characterisation.test_thruster import MAP, run
from tests.measured.data import import_boat, realistic_boats

pytestmark = pytest.mark.usefixtures("quick_compilation")

DT, HOLD, POLE, DEAD = 0.05, 6.0, 5.0, 0.045
LEVELS = (0.0, 0.5, 0.105, 0.4, -0.5, -0.3, 0.8, 0.0)
GNSS = """
[[signal]]
name = "vx"
column = "vx"
unit = "m/s"
[[signal]]
name = "vy"
column = "vy"
unit = "m/s"
"""


def shaft_of(command: Any) -> Any:
    """Return the speed of a shaft of first order (n,) whose controller subtracts its dead zone from the command."""
    reached = np.sign(command) * np.maximum(np.abs(command) - DEAD, 0.0) / (1.0 - DEAD)
    n = np.zeros(command.size)
    for k in range(1, n.size):
        n[k] = n[k - 1] + (1 - np.exp(-POLE * DT)) * (reached[k - 1] - n[k - 1])
    return n


def held(levels: tuple[float, ...] = LEVELS) -> tuple[Channel, Channel]:
    command = np.repeat(levels, round(HOLD / DT))
    t = DT * np.arange(command.size)
    return Channel(t, command), Channel(t, shaft_of(command))


def thruster_of(folder: Path, speed: float) -> Any:
    """Return result.json of the thruster fit to a log with the velocity ``speed`` [m/s] to the east."""
    rng = np.random.default_rng(0)
    command, shaft = held()
    noise = 0.05 * rng.standard_normal((2, command.t.size))
    n = shaft.value + 0.003 * rng.standard_normal(command.t.size)
    force = 40.0 * n * np.abs(n) + 0.2 * rng.standard_normal(n.size)
    rows = np.column_stack([command.t, command.value, n, force, noise[0], speed + noise[1]])
    np.savetxt(folder / "log.csv", rows, "%.5f", ",", header="t,cmd,n,force,vx,vy", comments="")
    (folder / "map.toml").write_text(MAP + GNSS)
    run("import", str(folder / "map.toml"), str(folder / "log.csv"), "-o", str(folder / "log.mcap"))
    run("ident", "thruster", str(folder / "log.mcap"), "--out", str(folder / "t"))
    return json.loads((folder / "t/result.json").read_text())


@pytest.mark.parametrize(("speed", "moves"), [(0.0, False), (1.2, True)])
def test_log_of_a_moving_boat_is_named_as_no_bench_run(speed: float, moves: bool, tmp_path: Path) -> None:
    result = thruster_of(tmp_path, speed)
    warnings = {w["code"]: w["text"] for w in result["warnings"]}
    assert ("boat-moves" in warnings) == moves
    if moves:
        assert "log.mcap: the boat moves (more than 1.3 m/s over ground" in warnings["boat-moves"]
        assert "The thrust is that of the moving boat" in warnings["boat-moves"]
    # The controller subtracts its dead zone, so that no dead zone of the model fits.
    assert (
        "at a command of 10.5 % the shaft turns at 6.2 % of full speed (from 12.0 to 18.0 s)"
        in (warnings["dead-zone-contradicted"])
    )
    # The warning, the model and what is exported of it agree: d is kept, as it predicts the shaft best.
    said = "The dead zone is therefore not determined: d is only the value with which this model predicts"
    assert said in warnings["dead-zone-contradicted"]
    (d,) = (p for p in result["fit"]["parameters"] if p["name"] == "d")
    assert d["flag"] == TURNS_INSIDE
    saved = load_model(tmp_path / "t/model.toml")
    assert saved.flags["d"] == TURNS_INSIDE
    header = str(export(saved, "python"))
    value = saved.model.parameter("d").value
    assert value > 0.09
    assert f"d = {value:.3g} is {TURNS_INSIDE}, where this model gives" in header
    joined = _remarks([Drive("n_left", "left", saved, saved.model)], own_curve=False)
    assert f"d_left is zero: its data do not determine the fitted {value:.3g}" in " ".join(joined)
    assert TURNS_INSIDE not in str(export(replace(saved, flags={}), "python"))
    assert "its dead zone is not determined" in result["answer"]
    assert "does not turn below" not in result["answer"]


def test_speed_comes_from_the_best_signal_of_the_log() -> None:
    t = np.arange(0.0, 100.0, 0.2)
    rng = np.random.default_rng(1)
    still = {n: Channel(t, 0.5 * rng.standard_normal(t.size)) for n in ("x", "y")}
    assert (speed_over_ground(still) or 9.9) < 0.3
    moving = still | {"x": Channel(t, 1.5 * t + still["x"].value)}
    assert speed_over_ground(moving) == pytest.approx(1.5, abs=0.2)
    assert speed_over_ground({"u": Channel(t, np.full(t.size, -0.8))}) == pytest.approx(0.8)
    assert speed_over_ground({"psi": Channel(t, t)}) is None
    assert moving_boat_warnings({"a": None, "b": 0.1}, has_force=True) == []
    (warning,) = moving_boat_warnings({"a": None, "b": 0.5}, has_force=False)
    assert warning.text.startswith("b: the boat moves")
    assert "`seatrial ident export BOAT --to python --thruster FILE`" in warning.text  # the use of such a model


def test_shaft_contradicts_a_dead_zone_only_if_it_turns_steadily_inside() -> None:
    command, shaft = held()
    found = turning_inside_dead_zone(command, shaft, 0.11, 0.05, 1 / POLE)
    assert found is not None
    assert (found.command, found.start, found.end) == (0.105, 12.0, 18.0)
    assert found.speed == pytest.approx(0.06 / 0.955, abs=1e-3)
    assert turning_inside_dead_zone(command, shaft, 0.09, 0.05, 1 / POLE) is None  # the command lies outside
    # A shaft that slows down to rest inside a true dead zone turns, but not steadily.
    slowing = held((0.0, 0.9, 0.03, 0.9, -0.03, 0.0))
    assert turning_inside_dead_zone(*slowing, 0.045, 0.05, 1 / POLE) is None
    assert dead_zone_warnings({"a": None}, 0.1) == []


@pytest.mark.skipif(not realistic_boats().is_dir(), reason="SEATRIAL_DATA has no boats of a realistic plant")
def test_voyage_of_a_realistic_boat_gives_no_sure_dead_zone(tmp_path: Path) -> None:
    import_boat("cat14-none", ["run1"], tmp_path)
    run("ident", "thruster", str(tmp_path / "run1.mcap"), "--thruster", "right", "--out", str(tmp_path / "t"))
    result = json.loads((tmp_path / "t/result.json").read_text())
    assert {"boat-moves", "dead-zone-contradicted"} <= {w["code"] for w in result["warnings"]}
