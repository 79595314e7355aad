"""Export: every table comes out with its digits, units and names."""

from __future__ import annotations

import csv
import importlib.util
import math
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from daq import cli
from daq.errors import SeatrialError
from daq.log.reader import open_log
from daq.samples import Ahrs, Frame
from daq.tools.export import export_log, parts
from tests.daq.logs import T0, recorder, write_everything


@pytest.fixture
def log(tmp_path: Path) -> Path:
    write_everything(tmp_path / "all.mcap", n_rounds=2)
    return tmp_path / "all.mcap"


def test_csv_holds_every_table_with_all_digits(log: Path, tmp_path: Path) -> None:
    with open_log(log) as opened:
        written = export_log(opened, "csv", tmp_path / "out")
        assert {path.stem for path in written} == {part.name for part in parts(opened)} | {"events"}
        for part in parts(opened):
            with (tmp_path / "out" / f"{part.name}.csv").open(newline="") as file:
                heads, *rows = csv.reader(file)
            assert [head.partition(" [")[0] for head in heads] == list(part.rows.dtype.names or ())
            assert heads[0] == "t [s]"
            for row, wanted in zip(rows, part.rows.tolist(), strict=True):
                assert [math.nan if cell == "" else float(cell) for cell in row] == pytest.approx(
                    list(wanted), rel=0, abs=0, nan_ok=True
                )
    events = (tmp_path / "out/events.csv").read_text().splitlines()
    assert events[0] == "t [s],kind,text"
    assert events[1].endswith('mark,"round 0: Trondheimsfjorden, blåsende"')


def test_units_stand_in_the_heads(log: Path, tmp_path: Path) -> None:
    with open_log(log) as opened:
        export_log(opened, "csv", tmp_path / "out")
    assert "yaw [rad],pitch [rad]" in (tmp_path / "out/ahrs_ahrs.csv").read_text()
    assert "rpm [rev/min],current [A],duty,voltage [V]" in (tmp_path / "out/esc_1_esc.csv").read_text()


def test_nothing_is_replaced_unless_told(log: Path, tmp_path: Path) -> None:
    run = CliRunner()
    words = ["csv", str(log), "--out", str(tmp_path / "out")]
    assert run.invoke(cli.export, words).exit_code == 0
    assert isinstance(run.invoke(cli.export, words).exception, SeatrialError)
    assert run.invoke(cli.export, [*words, "--force"]).exit_code == 0


def test_a_name_from_a_foreign_log_stays_in_the_folder(tmp_path: Path) -> None:
    log = recorder(tmp_path / "odd.mcap")
    for name in ("..", "a b", "a?b"):
        log.write(name, Frame(Ahrs(0.0, 0.0, 0.0), T0, math.nan), T0)
    log.close()
    with open_log(tmp_path / "odd.mcap") as opened:
        names = sorted(path.name for path in export_log(opened, "csv", tmp_path / "deep/out"))
    assert names == ["___ahrs.csv", "a_b_ahrs-2.csv", "a_b_ahrs.csv"]
    assert sorted(path.name for path in (tmp_path / "deep").rglob("*.csv")) == names


def test_parquet_without_its_library_is_one_line(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with open_log(log) as opened, pytest.raises(SeatrialError, match=r"pip install 'seatrial\[parquet\]'"):
        export_log(opened, "parquet", tmp_path / "out")


@pytest.mark.skipif(importlib.util.find_spec("pyarrow") is None, reason="pyarrow is not installed")
def test_parquet_reads_back(log: Path, tmp_path: Path) -> None:
    import pyarrow.parquet

    with open_log(log) as opened:
        export_log(opened, "parquet", tmp_path / "out")
        rows = next(part for part in parts(opened) if part.name == "gnss_gnss").rows
    table = pyarrow.parquet.read_table(tmp_path / "out/gnss_gnss.parquet")
    assert table.column("lat").to_pylist() == pytest.approx(rows["lat"].tolist(), nan_ok=True)
    assert table.schema.field("lat").metadata[b"unit"] == b"deg"
