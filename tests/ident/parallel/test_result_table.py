"""Tests of the table of results: rows come back as they were written, and a damaged or other file is refused."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pyarrow.parquet
import pytest

from seatrial.daq.errors import SeatrialError
from seatrial.ident.parallel import ResultTable, result_table

COLUMNS: dict[str, type] = {"task": str, "value": float, "n": int, "good": bool, "error": str}


def open_table(path: Path | None, **settings: Any) -> ResultTable:
    return ResultTable(path, COLUMNS, "task", "error", settings)


def test_rows_are_read_again_and_failed_tasks_are_not_finished(tmp_path: Path) -> None:
    path = tmp_path / "new/fits.parquet"
    with open_table(path, rate=10.0) as table:
        table.add([{"task": "b", "value": 1.5, "n": 2, "good": True}, {"task": "b", "value": None}])
        table.add([{"task": "a", "error": "no signal"}])
        assert table.keys == {"a", "b"}
        table.sort("task")
    written = pyarrow.parquet.read_table(path)
    assert written["task"].to_pylist() == ["a", "b", "b"]
    assert written["value"].to_pylist() == [None, 1.5, None]
    assert [str(f.type) for f in written.schema] == ["string", "double", "int64", "bool", "string"]
    with open_table(path, rate=10.0) as again:
        assert again.keys == {"b"}
        again.add([{"task": "a", "value": 3.0}])
    assert pyarrow.parquet.read_table(path)["value"].to_pylist() == [1.5, None, 3.0]


def test_file_is_written_when_the_block_is_left_by_an_error(tmp_path: Path) -> None:
    path = tmp_path / "fits.parquet"

    def interrupted() -> None:
        with open_table(path) as table:
            table.add([{"task": "a", "value": 1.0}])
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert open_table(path).keys == {"a"}


def test_file_is_replaced_from_time_to_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, clock = tmp_path / "fits.parquet", [100.0]
    monkeypatch.setattr(result_table.time, "monotonic", lambda: clock[0])
    table = open_table(path)
    table.add([{"task": "a"}])
    assert not path.exists()
    clock[0] += 11.0
    table.add([{"task": "b"}])
    assert open_table(path).keys == {"a", "b"}
    table.add([{"task": "c"}])
    assert open_table(path).keys == {"a", "b"}


def test_table_of_other_options_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "fits.parquet"
    with open_table(path, model="surge", rate=10.0):
        pass
    assert not path.exists()  # a run without results leaves no file that could refuse the next one
    with open_table(path, model="surge", rate=10.0) as table:
        table.add([{"task": "a", "error": "no signal"}])
    assert not open_table(path, model="yaw").keys
    with open_table(path, model="surge", rate=10.0) as table:
        table.add([{"task": "a", "value": 1.0}])
    with pytest.raises(SeatrialError, match=r"fits\.parquet: its rows were made with other options \(model, seed\)"):
        open_table(path, model="yaw", rate=10.0, seed=1)


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "fits.parquet"
    path.write_bytes(b"PAR1 and nothing else")
    with pytest.raises(SeatrialError, match="cannot be read as Parquet"):
        open_table(path)
    pyarrow.parquet.write_table(pyarrow.table({"x": [1]}), path)
    with pytest.raises(SeatrialError, match="is not a table of this command; give another --out, or --force"):
        open_table(path)
    assert path.exists()


def test_table_without_a_file_keeps_its_rows() -> None:
    with open_table(None) as table:
        table.add([{"task": "a", "n": 1}])
    assert table.table()["n"].to_pylist() == [1]


def test_missing_library_names_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(SeatrialError, match=r"pip install 'seatrial\[parquet\]'"):
        open_table(None)
