"""Tests of the import maps in the docs: the maps are valid, and the measured runs are imported with them unchanged."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
import pytest

from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.import_files import assumed_roles_line, import_files
from seatrial.daq.importers.import_map import load_import_map
from seatrial.daq.importers.units import UNITS
from seatrial.daq.log.reader import open_log
from tests.daq.csv_files import DOCS, EXAMPLES, values
from tests.measured import data


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_units_agree_with_their_definitions() -> None:
    assert UNITS["kn"] == ("m/s", pytest.approx(0.514444, rel=1e-5))
    assert UNITS["kgf"][1] * UNITS["lbf"][1] == pytest.approx(9.80665 * 4.448222, rel=1e-6)
    assert UNITS["deg"][1] == pytest.approx(0.01745329, rel=1e-6)
    assert all(UNITS[si] == (si, 1.0) for si, _ in UNITS.values())


@pytest.mark.parametrize("path", sorted(EXAMPLES.rglob("*.toml")), ids=lambda path: path.stem)
def test_the_worked_maps_are_valid(path: Path) -> None:
    if "seatrial-import-csv" in path.read_text(encoding="utf-8"):
        import_map = load_import_map(path)
        assert import_map.sources
        assert not assumed_roles_line(import_map)


def test_the_documented_map_is_valid(folder: Path) -> None:
    found = re.findall(
        r"```toml\n(format = \"seatrial-import .*?)```", (DOCS / "formats" / "import.md").read_text(), re.DOTALL
    )
    assert found
    for text in found:
        (folder / "map.toml").write_text(text)
        import_map = load_import_map(folder / "map.toml")
        assert import_map.sources
        assert not assumed_roles_line(import_map)


@pytest.fixture
def measured() -> Path:
    return data.measured()


def column(path: Path, name: str) -> list[float]:
    with path.open() as file:
        return [float(row[name]) for row in csv.DictReader(file)]


@pytest.mark.measured
def test_the_blueboat_runs_are_imported_by_their_map(folder: Path, measured: Path) -> None:
    files = sorted((measured / "blueboat").glob("*.csv"))
    logs = import_files(EXAMPLES / "blueboat" / "blueboat.toml", files)
    assert len(logs) == 11
    for path, out in zip(files, logs, strict=True):
        t, psi = values(out, "psi")
        np.testing.assert_allclose(np.cos(psi), np.cos(np.radians(column(path, "yaw"))), atol=1e-9)
        assert np.abs(np.diff(psi)).max() < 0.5  # the angle is unwrapped
        assert values(out, "f_left")[1] == column(path, "left_force")
        np.testing.assert_allclose(np.diff(t), 0.1, atol=1e-6)
    # Check of the unit of yaw_rate, in the run with the most turning: d(psi)/dt = 1.0 r.
    t, psi = map(np.array, values(logs[7], "psi"))
    r = np.array(values(logs[7], "r")[1])
    assert np.gradient(psi, t) @ r / (r @ r) == pytest.approx(1.0, abs=0.02)


@pytest.mark.measured
def test_the_kingfisher_runs_are_imported_by_their_map(folder: Path, measured: Path) -> None:
    files = sorted((measured / "kingfisher").glob("surge_*.csv"))
    (out,) = import_files(EXAMPLES / "kingfisher" / "surge.toml", files)
    assert (len(values(out, "n_left")[0]), len(values(out, "speed_x")[0])) == (14669, 22716)
    steps = import_files(EXAMPLES / "kingfisher" / "surge_steps.toml", files)
    assert [path.stem for path in steps] == [f"surge_steps_step{i}" for i in (1, 2, 3, 4)]
    assert open_log(steps[0]).duration == pytest.approx(215.0 - 171.0, abs=0.15)
    t, _ = values(steps[3], "speed_x")
    assert np.median(np.diff(t)) == pytest.approx(0.25, abs=0.06)  # the rate of the receiver, not of the logger
    t, n = map(np.array, values(steps[2], "n_left"))
    assert set(n) == {0.0, 0.4}  # at rest until the first command of the step
    assert t[n > 0][0] == pytest.approx(402.69, abs=0.01)
    (bollard,) = import_files(
        EXAMPLES / "kingfisher" / "bollard.toml", [measured / "kingfisher" / "bollard_loadcell_raw_20files.csv"]
    )
    n, force = np.array(values(bollard, "n_left")[1]), np.array(values(bollard, "force")[1])
    assert len(np.unique(n)) == 20
    # tcurve.csv has half of this thrust, for one thruster
    assert force[n == 1.0].mean() == pytest.approx(2 * 20.3, rel=0.01)


@pytest.mark.measured
def test_nanoseconds_that_lost_their_zeros(folder: Path, measured: Path) -> None:
    (folder / "map.toml").write_text(
        'format = "seatrial-import-csv 1"\n[csv]\nnan = "drop"\n[time]\ncolumn = "time"\n'
        'format = "%Y/%m/%d %H:%M:%S"\nfraction = "unpadded-ns"\n'
        '[[signal]]\nname = "speed"\ncolumn = "motor_speed"\nunit = "rev/min"\n'
    )
    path = measured / "milliampere" / "thruster_data_test" / "motor_state_1.csv"
    (out,) = import_files(folder / "map.toml", [path])
    t = np.array(values(out, "speed")[0])
    assert len(t) > 5000
    assert np.diff(t).min() > 0.0  # read as decimals, time would run backwards at every lost zero
    decimal = (folder / "map.toml").read_text().replace("unpadded-ns", "decimal")
    (folder / "map.toml").write_text(decimal)
    with pytest.raises(SeatrialError, match="time runs back"):
        import_files(folder / "map.toml", [path], force=True)
