"""Repeats of held values are left out by the import, found by --guess, and by the check of a log."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daq.errors import SeatrialWarning
from daq.importers.guess import guess_map
from daq.importers.import_files import import_files
from tests.bench.check_cases import findings
from tests.daq.checks.test_held_values import held, measured
from tests.daq.csv_files import values

SECONDS, HZ = 100.0, 20.0
T = np.arange(0.0, SECONDS, 1.0 / HZ)


@pytest.fixture
def table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Rows at 20 Hz with a receiver of 1 Hz, a heading of each row, a shaft speed of 5 Hz and a command."""
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


def test_repeats_are_left_out_by_signal_and_said(table: Path) -> None:
    with pytest.warns(SeatrialWarning) as told:
        log = imported(table)
    lines = [str(one.message).partition("run.csv: ")[2] for one in told]
    what = "values repeat the one before and are left out"
    assert lines == [
        f"x, y: held between measurements 1 s apart; 1900 of 2000 {what}",
        f"n_left: held between measurements 0.2 s apart; 1500 of 2000 {what}",
    ]
    counts = {n: len(values(log, n)[0]) for n in ("x", "y", "psi", "n_left", "n_cmd_left", "shaft")}
    assert (counts["x"], counts["y"], counts["psi"]) == (100, 100, 2000)
    assert counts["n_left"] == pytest.approx(500, abs=3)  # a sensor's: no value comes back
    assert (counts["n_cmd_left"], counts["shaft"]) == (2000, 2000)  # steps of a command stay steps
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


def test_repeats_of_one_signal_are_dropped_on_demand(table: Path) -> None:
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


def test_the_guess_says_which_are_held(table: Path) -> None:
    text = guess_map(table).text
    (caveat,) = [line for line in text.splitlines() if "held between measurements" in line]
    assert caveat.startswith("# caveat: x, y: ")
    assert "1 s apart" in caveat
