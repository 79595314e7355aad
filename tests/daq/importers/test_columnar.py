"""Tests of the import of MATLAB files (versions 5 and 7.3) and Parquet: workspaces, structs, matrices, several time
axes.
"""

from __future__ import annotations

import sys
from decimal import Decimal
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.clocks import Clock, clock_of
from seatrial.daq.importers.columnar import read_matlab, read_parquet
from seatrial.daq.importers.guess import guess_map
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.importers.sources import source_kind
from seatrial.daq.importers.table import SourceOptions
from tests.daq.csv_files import values

T = 0.1 * np.arange(50)
RUN: dict[str, Any] = {
    "t": T, "yaw": 0.2 * T, "t_cmd": np.arange(6.0), "cmd_left": 0.1 * np.arange(6), "cmd_right": -0.1 * np.arange(6),
}  # fmt: skip


def save_73(path: Path, run: dict[str, Any]) -> None:
    """Write a file as MATLAB does: HDF5 after a header of 512 bytes, matrices by column, structs as groups."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in run.items():
            if isinstance(value, dict):
                group = file.create_group(name)
                for field, array in value.items():
                    group[field] = np.atleast_2d(array).reshape(1, -1)
            else:
                file[name] = np.atleast_2d(value) if np.ndim(value) < 2 else np.asarray(value).T
        file.create_group("#refs#")
    with path.open("r+b") as opened:
        opened.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512))


@pytest.fixture(params=["5", "7.3"])
def save(request: pytest.FixtureRequest) -> Any:
    return savemat if request.param == "5" else save_73


def test_vectors_with_two_time_axes_are_imported_by_their_guess(save: Any, tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    save(path, RUN)
    assert source_kind(path).name == "matlab"
    guess = guess_map(path)
    assert guess.problem == ""
    (tmp_path / "map.toml").write_text(guess.text)
    (out,) = import_files(tmp_path / "map.toml", [path], out=tmp_path / "run.mcap")
    t, psi = values(out, "psi")
    np.testing.assert_allclose(t, T, atol=1e-9)
    np.testing.assert_array_equal(psi, 0.2 * T)
    assert values(out, "n_right") == (RUN["t_cmd"].tolist(), RUN["cmd_right"].tolist())


def test_structs_and_matrices_become_columns(save: Any, tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    save(path, {"log": {"t": T, "psi": 0.2 * T}, "pos": np.stack([T, 2 * T, 3 * T], axis=1), "g": 9.81})
    tables = {table.topic: table for table in read_matlab(path, SourceOptions())}
    assert sorted(tables["log"].names) == ["psi", "t"]
    np.testing.assert_array_equal(tables["log"].columns["psi"], 0.2 * T)
    assert sorted(tables[""].names) == ["pos[0]", "pos[1]", "pos[2]"]  # g is not a column
    np.testing.assert_array_equal(tables[""].columns["pos[2]"], 3 * T)


def test_matlab_files_without_data_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    savemat(tmp_path / "a.mat", {"name": "boat"})
    with pytest.raises(SeatrialError, match=r"a\.mat: contains no vectors of numbers; objects \(timetable"):
        read_matlab(tmp_path / "a.mat", SourceOptions())
    (tmp_path / "b.mat").write_bytes(b"MATLAB 5.0 MAT-file, and no more")
    with pytest.raises(SeatrialError, match=r"b\.mat: cannot be read as a MATLAB file"):
        read_matlab(tmp_path / "b.mat", SourceOptions())
    save_73(tmp_path / "c.mat", RUN)
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(SeatrialError, match=r"pip install 'seatrial\[matlab\]'"):
        read_matlab(tmp_path / "c.mat", SourceOptions())


def test_a_datenum_becomes_a_time(tmp_path: Path) -> None:
    days = 739_000.0 + np.arange(20) / 86400.0
    savemat(tmp_path / "run.mat", {"datenum": days, "psi": np.arange(20.0)})
    lines = '[time]\ncolumn = "datenum"\nformat = "datenum"\n[[signal]]\nname = "psi"\ncolumn = "psi"\nunit = "deg"\n'
    (tmp_path / "map.toml").write_text(f'format = "seatrial-import 1"\n{lines}')
    (out,) = import_files(tmp_path / "map.toml", [tmp_path / "run.mat"], out=tmp_path / "run.mcap")
    np.testing.assert_allclose(np.diff(values(out, "psi")[0]), 1.0, atol=2e-5)
    assert values(out, "psi")[0][0] == pytest.approx((739_000 - 719_529) * 86400.0)


def test_large_integers_of_parquet_are_exact(tmp_path: Path) -> None:
    stamps = 1_700_000_000_000_000_123 + 100_000_000 * np.arange(20, dtype=np.int64)
    pq.write_table(pa.table({"stamp_ns": stamps, "heading": np.arange(20.0)}), tmp_path / "run.parquet")
    (tmp_path / "map.toml").write_text(guess_map(tmp_path / "run.parquet").text)
    (out,) = import_files(tmp_path / "map.toml", [tmp_path / "run.parquet"], out=tmp_path / "run.mcap")
    np.testing.assert_allclose(values(out, "psi")[0], 1e-9 * stamps, rtol=0, atol=3e-7)


def test_timestamps_of_parquet_become_times(tmp_path: Path) -> None:
    stamps = pa.array((1_700_000_000_000_000_000 + 1e8 * np.arange(20)).astype("datetime64[ns]"))
    table = pa.table({"time": stamps, "heading": pa.array(np.arange(20.0)), "who": pa.array(["a"] * 20)})
    pq.write_table(table, tmp_path / "run.parquet")
    (found,) = read_parquet(tmp_path / "run.parquet", SourceOptions())
    assert list(found.names) == ["time", "heading", "who"]
    assert found.text("who") == ["a"] * 20
    with pytest.raises(SeatrialError, match="'who', row 1: 'a' is text, not a number"):
        found.numbers("who")
    guess = guess_map(tmp_path / "run.parquet")
    (tmp_path / "map.toml").write_text(guess.text)
    (out,) = import_files(tmp_path / "map.toml", [tmp_path / "run.parquet"], out=tmp_path / "run.mcap")
    np.testing.assert_allclose(values(out, "psi")[0], 1_700_000_000.0 + 0.1 * np.arange(20), atol=1e-6)
    np.testing.assert_allclose(values(out, "psi")[1], np.radians(np.arange(20.0)))
    (tmp_path / "bad.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(SeatrialError, match=r"bad\.parquet: cannot be read as Parquet"):
        guess_map(tmp_path / "bad.parquet")


def clock(path: Path, columns: dict[str, Any]) -> Clock:
    """Return the clock of a Parquet file with these columns."""
    pq.write_table(pa.table(columns), path)
    return clock_of(read_parquet(path, SourceOptions())[0])


def test_the_types_of_parquet_define_the_clock(tmp_path: Path) -> None:
    path, n = tmp_path / "run.parquet", np.arange(20)
    ns = 1_700_000_000_000_000_000 + 100_000_000 * n
    stamps = pa.array(ns.astype("datetime64[ns]"))
    assert clock(path, {"k": n, "timestamp_ns": stamps}) == Clock("timestamp_ns")  # the type has priority over the name
    assert clock(path, {"k": n, "when": stamps}) == Clock("when")
    assert clock(path, {"k": n, "elapsed": pa.array(n * 10**8, pa.duration("ns"))}) == Clock("elapsed")
    texts = pa.array([f"2025-05-01T12:00:{k:02d}" for k in n])
    assert clock(path, {"k": n, "time": texts.dictionary_encode()}) == Clock("time", "iso")
    zones = pa.array(["UTC"] * 20)
    assert clock(path, {"time_zone": zones, "t_gps": 0.1 * n}) == Clock("t_gps")
    assert clock(path, {"__index_level_0__": n, "yaw": n}) == Clock()
    pq.write_table(pa.table({
        "day": pa.array(n.tolist(), pa.date32()),
        "clock": pa.array([*n[:-1].tolist(), None], pa.time32("s")),
        "volts": pa.array([Decimal(int(k)) / 4 for k in n], pa.decimal128(9, 2)),
        "list": pa.array([[1.0]] * 20),
        "stamp": pa.array([*(ns // 10**6)[:-1].tolist(), None], pa.timestamp("ms", "UTC")),
    }), path)  # fmt: skip
    (table,) = read_parquet(path, SourceOptions())
    np.testing.assert_allclose(table.columns["day"], 86400.0 * n)
    np.testing.assert_allclose(table.columns["clock"], [*(1.0 * n[:-1]), np.nan])
    np.testing.assert_array_equal(table.columns["volts"], n / 4)
    np.testing.assert_allclose(table.columns["stamp"], [*(1.7e9 + 0.1 * n[:-1]), np.nan])
    assert table.remark.startswith("left out, of a type that cannot be read: list (list<")
    assert "# caveat: left out, of a type that cannot be read: list" in guess_map(path).text
