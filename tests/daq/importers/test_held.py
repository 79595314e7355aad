"""Tests of repeated values from sample-and-hold: left out by the import, found by --guess, and found by the check of a
log.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from seatrial.daq.errors import SeatrialWarning
from seatrial.daq.importers.guess import guess_map
from seatrial.daq.importers.import_files import import_files
from tests.bench.check_cases import findings
from tests.daq.checks.test_held_values import held, measured
from tests.daq.csv_files import values

SECONDS, HZ = 100.0, 20.0
T = np.arange(0.0, SECONDS, 1.0 / HZ)


@pytest.fixture
def table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write rows at 20 Hz with a receiver of 1 Hz, a heading in each row, a shaft speed of 5 Hz and a command."""
    monkeypatch.chdir(tmp_path)
    columns = {
        "time": T,
        "x": held(T, 1.0, 1),
        "y": held(T, 1.0, 1, phase=1.0),
        "yaw_rad": measured(T, 2),
        "rpm": 1000.0 * held(T, 5.0, 3),
        "cmd": np.repeat(np.random.default_rng(4).choice([0.0, 0.4, 0.8], T.size // 10), 10),
    }
    path = tmp_path / "run.csv"
    rows = "\n".join(",".join(f"{value:.6f}" for value in row) for row in zip(*columns.values(), strict=True))
    path.write_text(f"{','.join(columns)}\n{rows}\n", encoding="utf-8")
    return path


def imported(path: Path, root: str = "", of_x: str = "") -> Path:
    rows = [
        ("x", "x", "m", of_x),
        ("y", "y", "m", of_x),
        ("psi", "yaw_rad", "rad", ""),
        ("n_left", "rpm", "rev/min", 'role = "input", hold = "linear"'),
        ("n_cmd_left", "cmd", "1", 'role = "input"'),
        ("shaft", "cmd", "1", 'role = "input", hold = "linear"'),
    ]
    signals = [
        f'{{ name = "{name}", column = "{column}", unit = "{unit}"{", " * bool(extra)}{extra} }}'
        for name, column, unit, extra in rows
    ]
    text = f'format = "seatrial-import 1"\ntime = {{ column = "time" }}\n{root}\nsignal = [{", ".join(signals)}]\n'
    (path.parent / "map.toml").write_text(text, encoding="utf-8")
    return import_files(path.parent / "map.toml", [path], force=True)[0]


def test_repeats_are_left_out_by_signal_and_reported(table: Path) -> None:
    with pytest.warns(SeatrialWarning) as warnings:
        log = imported(table)
    lines = [str(warning.message).partition("run.csv: ")[2] for warning in warnings]
    reason = "values repeat the previous value and are left out"
    assert lines == [
        f"x, y: held between measurements 1 s apart; 1900 of 2000 {reason}",
        f"n_left: held between measurements 0.2 s apart; 1500 of 2000 {reason}",
    ]
    counts = {n: len(values(log, n)[0]) for n in ("x", "y", "psi", "n_left", "n_cmd_left", "shaft")}
    assert (counts["x"], counts["y"], counts["psi"]) == (100, 100, 2000)
    assert counts["n_left"] == pytest.approx(500, abs=3)  # a sensor: the same value does not occur twice
    assert (counts["n_cmd_left"], counts["shaft"]) == (2000, 2000)  # the steps of a command stay
    assert values(log, "x")[0][1] == pytest.approx(1.0)
    assert not [f for f in findings(log) if f.code == "values-held"]


@pytest.mark.parametrize(("root", "of_x"), [('csv = { repeats = "keep" }', ""), ("", 'repeats = "keep"')])
@pytest.mark.filterwarnings("ignore:.*n_left. held")
def test_repeats_that_are_kept_are_found_by_the_check(table: Path, root: str, of_x: str) -> None:
    log = imported(table, root, of_x)
    assert len(values(log, "x")[0]) == 2000
    (found,) = [f for f in findings(log) if f.code == "values-held"]
    assert (found.level, found.where) == ("warning", "x, y")
    assert "1900 of 2000" in found.text


def test_repeats_of_a_signal_are_dropped_on_request(table: Path) -> None:
    with pytest.warns(SeatrialWarning, match="n_left"):
        log = imported(table, of_x='repeats = "drop"')
    assert len(values(log, "x")[0]) == 100


def test_maps_of_the_first_format_keep_repeats(table: Path) -> None:
    with pytest.warns(SeatrialWarning):
        imported(table)
    text = (table.parent / "map.toml").read_text(encoding="utf-8")
    (table.parent / "map.toml").write_text(text.replace("seatrial-import 1", "seatrial-import-csv 1"), encoding="utf-8")
    (log,) = import_files(table.parent / "map.toml", [table], force=True)
    assert len(values(log, "x")[0]) == 2000


def test_the_guess_names_the_held_columns(table: Path) -> None:
    text = guess_map(table).text
    of_fixes, of_shaft = [line for line in text.splitlines() if "held between measurements" in line]
    assert of_fixes.startswith("# caveat: x, y: ")
    assert "1 s apart" in of_fixes
    assert of_shaft.startswith("# caveat: n: ")
    assert "0.2 s apart" in of_shaft


def propulsion(quantity: str, every: int) -> np.ndarray:
    """Return a command that holds for 3 to 9 s, or the shaft that follows with 0.25 s, held for ``every`` rows."""
    rng = np.random.default_rng(7)
    command = np.concatenate([np.full(rng.integers(60, 180), rng.uniform(-0.6, 0.9)) for _ in range(40)])[: T.size]
    value = command.copy()
    if quantity != "command":
        for k in range(1, T.size):
            value[k] = value[k - 1] + (1.0 - np.exp(-1.0 / HZ / 0.25)) * (command[k] - value[k - 1])
        value = value + 0.004 * rng.standard_normal(T.size)
    return np.repeat(value[::every], every)[: T.size]


@pytest.mark.parametrize(
    ("name", "quantity", "every", "hold"),
    [
        ("n_left", "shaft", 1, "linear"), ("n_left", "shaft", 10, "linear"), ("motor_left", "shaft", 10, "sampled"),
        ("n_left", "command", 1, ""), ("cmd_left", "command", 1, ""), ("cmd_left", "command", 20, ""),
    ],
)  # fmt: skip
def test_the_hold_of_an_input_is_guessed_by_its_values(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, quantity: str, every: int, hold: str
) -> None:
    monkeypatch.chdir(tmp_path)
    value = propulsion(quantity, every)
    text = "\n".join(f"{t:.3f},{n:.5f},{0.1 * t:.4f}" for t, n in zip(T, value, strict=True))
    (tmp_path / "run.csv").write_text(f"time,{name},yaw_rad\n{text}\n")
    guessed = guess_map(tmp_path / "run.csv").text
    assert (f'role = "input", hold = "{hold}"' in guessed) == bool(hold)
    assert ("it changes only every 1 s, every 20 rows" in guessed) == (quantity == "command" and every == 20)
    (tmp_path / "map.toml").write_text(guessed)
    if not hold or every == 1:
        (log,) = import_files(tmp_path / "map.toml", [tmp_path / "run.csv"])
        assert not [f for f in findings(log) if f.code == "input-held"]
        return
    with pytest.warns(SeatrialWarning, match=r"n_left: held between measurements 0\.50?3? s apart"):
        (log,) = import_files(tmp_path / "map.toml", [tmp_path / "run.csv"])
    assert len(values(log, "n_left")[0]) == pytest.approx(T.size / every, abs=3)
    # The map takes the shaft speed for a command.
    (tmp_path / "map.toml").write_text(guessed.replace(f', hold = "{hold}"', ""))
    (log,) = import_files(tmp_path / "map.toml", [tmp_path / "run.csv"], force=True)
    (found,) = [f for f in findings(log) if f.code == "input-held"]
    assert "the signal is 0.25 s late on average" in found.text


def test_repeats_of_a_command_in_nearly_every_row_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The thrust of a joystick at 7.5 Hz in rows of 10 Hz: without its repeats, a rest would become a ramp."""
    monkeypatch.chdir(tmp_path)
    t = 0.1 * np.arange(1500)
    force = np.cumsum(np.random.default_rng(3).normal(0.0, 4.0, 1500))[np.floor(7.5 * t).astype(int)]
    force[700:703] = 0.0
    text = "\n".join(f"{a:.1f},{f:.3f},{0.1 * a:.4f}" for a, f in zip(t, force, strict=True))
    (tmp_path / "run.csv").write_text(f"time,left_force,yaw_rad\n{text}\n")
    guessed = guess_map(tmp_path / "run.csv").text
    assert 'name = "f_left", column = "left_force", unit = "N", role = "input", hold = "sampled"' in guessed
    assert "held between measurements" not in guessed
    (tmp_path / "map.toml").write_text(guessed)
    (log,) = import_files(tmp_path / "map.toml", [tmp_path / "run.csv"])
    assert len(values(log, "f_left")[0]) == 1500
    assert not [f for f in findings(log) if f.code == "input-held"]


@pytest.mark.parametrize(("scale", "is_wrapped"), [(1.0, True), (1.0 / 3000.0, True), (1.0, False)])
def test_wrapped_speeds_are_not_taken_for_percent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scale: float, is_wrapped: bool
) -> None:
    """The telemetry sends -900 rev/min as 64636."""
    monkeypatch.chdir(tmp_path)
    rpm = np.trunc(3000.0 * propulsion("shaft", 1))
    value = scale * (np.mod(rpm, 65536.0) if is_wrapped else rpm)
    text = "\n".join(f"{t:.3f},{n:.5f},{0.1 * t:.4f}" for t, n in zip(T, value, strict=True))
    (tmp_path / "run.csv").write_text(f"time,n_left,yaw_rad\n{text}\n")
    guessed = guess_map(tmp_path / "run.csv").text
    assert ("negative speeds stored as 65536 - n" in guessed) == is_wrapped
    assert 'unit = "%"' not in guessed
    (tmp_path / "map.toml").write_text(guessed)
    (log,) = import_files(tmp_path / "map.toml", [tmp_path / "run.csv"])
    assert ("shaft-speed-wrapped" in [f.code for f in findings(log)]) == is_wrapped
