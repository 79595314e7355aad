"""Tests of export: every table is written with all digits, units and names."""

from __future__ import annotations

import csv
import importlib.util
import math
import re
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
import scipy.io
import xarray
from click.testing import CliRunner

from seatrial.daq import cli
from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.import_map import Signal
from seatrial.daq.importers.signals import SignalData
from seatrial.daq.importers.write_log import write_signals
from seatrial.daq.log.reader import open_log
from seatrial.daq.log.tables import log_tables, resample
from seatrial.daq.samples import Ahrs, Frame, Gnss, Scalar
from seatrial.daq.tools.export import export_log, export_resampled
from tests.daq.logs import T0, recorder, write_everything


@pytest.fixture
def log(tmp_path: Path) -> Path:
    write_everything(tmp_path / "all.mcap", n_rounds=2)
    return tmp_path / "all.mcap"


def test_csv_contains_every_table_with_all_digits(log: Path, tmp_path: Path) -> None:
    with open_log(log) as opened:
        written = export_log(opened, "csv", tmp_path / "out")
        assert {path.stem for path in written} == {part.name for part in log_tables(opened)} | {"events"}
        for part in log_tables(opened):
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


def test_a_time_window_is_exported(tmp_path: Path) -> None:
    log = recorder(tmp_path / "run.mcap")
    for k in range(500):
        t = T0 + 0.02 * k
        log.write("ahrs", Frame(Ahrs(0.1, 0.0, 0.0), t, 0.02 * k), t)
        if k % 50 == 0:
            log.event(t, "mark", f"{k}")
    log.close()
    words = ["csv", str(tmp_path / "run.mcap"), "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(cli.export, [*words, "--from", "2", "--to", "4"])
    assert done.exit_code == 0, done.output
    t = np.loadtxt(tmp_path / "out/ahrs_ahrs.csv", delimiter=",", skiprows=1, usecols=0) - T0
    assert (t.size, t[0], t[-1]) == (100, pytest.approx(2.0), pytest.approx(3.98))
    marks = (tmp_path / "out/events.csv").read_text().splitlines()
    assert [line.rpartition(",")[2] for line in marks[1:]] == ["100", "150"]
    for window, message in (
        (("--from", "11"), "run.mcap: no data from 11 s on; it has 10 s: give other --from and --to"),
        (("--from", "11", "--to", "12"), "run.mcap: no data from 11 to 12 s; it has 10 s"),
        (("--from", "4", "--to", "2"), "--to 2 s is not after --from 4 s; give a later end"),
    ):
        done = CliRunner().invoke(cli.export, [*words, "--force", *window])
        assert isinstance(done.exception, SeatrialError)
        assert message in str(done.exception)


def test_units_are_in_the_column_headers(log: Path, tmp_path: Path) -> None:
    with open_log(log) as opened:
        export_log(opened, "csv", tmp_path / "out")
    assert "yaw [rad],pitch [rad]" in (tmp_path / "out/ahrs_ahrs.csv").read_text()
    assert "rpm [rev/min],current [A],duty,voltage [V]" in (tmp_path / "out/esc_1_esc.csv").read_text()


def test_an_export_replaces_files_only_on_request(log: Path, tmp_path: Path) -> None:
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


def test_parquet_without_its_library_gives_a_one_line_error(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with open_log(log) as opened, pytest.raises(SeatrialError, match=r"pip install 'seatrial\[parquet\]'"):
        export_log(opened, "parquet", tmp_path / "out")


@pytest.mark.skipif(importlib.util.find_spec("pyarrow") is None, reason="writes Parquet, which needs the extra parquet")
def test_parquet_reads_back(log: Path, tmp_path: Path) -> None:
    import pyarrow.parquet

    with open_log(log) as opened:
        export_log(opened, "parquet", tmp_path / "out")
        rows = next(part for part in log_tables(opened) if part.name == "gnss_gnss").rows
    table = pyarrow.parquet.read_table(tmp_path / "out/gnss_gnss.parquet")
    assert table.column("lat").to_pylist() == pytest.approx(rows["lat"].tolist(), nan_ok=True)
    assert table.schema.field("lat").metadata[b"unit"] == b"deg"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Write a command that is held, a fast rate, a heading across the wrap of angles, and a gap."""
    t = T0 + 0.01 * np.arange(1000)
    psi = np.pi - 0.02 + 0.01 * (t - T0)
    slow = T0 + np.array([0.0, 1.0, 2.0, 8.0, 9.0, 9.99])
    signals = [
        SignalData(Signal("n_left", ("n",), role="input", hold="zero"), "1", slow, np.arange(6.0)),
        SignalData(Signal("psi", ("psi",), unit="rad"), "rad", t[::20], wrapped(psi[::20])),
        SignalData(Signal("r", ("r",), unit="rad/s"), "rad/s", t, np.sin(t - T0)),
        SignalData(Signal("u", ("u",), unit="m/s"), "m/s", slow, np.arange(6.0)),
    ]
    write_signals(tmp_path / "run.mcap", signals, metadata={}, attachments={}, note="-")
    return tmp_path / "run.mcap"


def wrapped(angle: np.ndarray) -> np.ndarray:
    return np.pi - np.mod(np.pi - angle, 2 * np.pi)


def test_each_signal_is_resampled_according_to_its_kind(run: Path) -> None:
    with open_log(run) as opened:
        table = resample(opened, 10.0)
    tau = table.t - T0
    assert len(tau) == 100
    assert table.units == {"n_left": "1", "psi": "rad", "r": "rad/s", "u": "m/s"}
    np.testing.assert_array_equal(table.columns["n_left"][[0, 9, 10, 79, 80]], [0, 0, 1, 2, 3])  # held over the gap
    np.testing.assert_allclose(table.columns["psi"][:98], wrapped(np.pi - 0.02 + 0.01 * tau[:98]), atol=1e-9)
    np.testing.assert_allclose(table.columns["r"][1:-1], np.sin(tau[1:-1]), atol=1e-3)  # means of ten samples
    u = table.columns["u"]
    assert u[15] == pytest.approx(1.5)
    assert np.isnan(u[[30, 60]]).all()  # no value is invented in 6 s without a sample
    assert u[80] == pytest.approx(3.0)


def test_the_resampled_table_is_written_as_mat_netcdf_parquet_and_csv(run: Path, tmp_path: Path) -> None:
    with open_log(run) as opened:
        table = resample(opened, 10.0)
        for form in ("mat", "netcdf", "parquet", "csv"):
            export_resampled(opened, form, tmp_path / "out", 10.0)
    mat = scipy.io.loadmat(tmp_path / "out/run.mat", squeeze_me=True)
    xr = xarray.open_dataset(tmp_path / "out/run.nc", engine="scipy")
    pq = pyarrow.parquet.read_table(tmp_path / "out/run.parquet")
    with (tmp_path / "out/run.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for name, values in table.columns.items():
        np.testing.assert_array_equal(mat[name], values)
        np.testing.assert_array_equal(xr[name].values, values)
        np.testing.assert_array_equal(pq[name].to_numpy(), values)
        cells = [row[f"{name} [{table.units[name]}]"] for row in rows]
        np.testing.assert_array_equal([float(cell or "nan") for cell in cells], values)
    np.testing.assert_array_equal(mat["t"], table.t)
    assert str(mat["units"]["psi"]) == xr["psi"].attrs["units"] == "rad"
    seconds = (xr["time"].values - np.datetime64("1970-01-01")) / np.timedelta64(1, "s")
    np.testing.assert_allclose(seconds, table.t, atol=1e-6)
    xr.close()


def test_times_relative_to_the_first_sample(run: Path, tmp_path: Path) -> None:
    words = [str(run), "--relative", "--from", "2", "--out", str(tmp_path / "out")]
    for form, *more in (("csv",), ("csv", "--rate", "10"), ("netcdf",)):
        done = CliRunner().invoke(cli.export, [form, *words, *more])
        assert done.exit_code == 0, done.output
    for name in ("r", "run"):
        with (tmp_path / f"out/{name}.csv").open(newline="") as file:
            times = [float(row["t [s]"]) for row in csv.DictReader(file)]
        assert times[0] == pytest.approx(2.0, abs=0.11)
        assert times[-1] == pytest.approx(10.0, abs=0.11)
    xr = xarray.open_dataset(tmp_path / "out/run.nc", engine="scipy")
    begin = (xr["time"].values[0] - np.datetime64(0, "s")) / np.timedelta64(1, "s")
    assert begin == pytest.approx(T0 + 2.0, abs=0.11)  # the same instant, by the unit "seconds since ..."
    assert CliRunner().invoke(cli.export, ["ros", *words]).exit_code == 2


def test_the_resampled_table_becomes_pandas_and_xarray(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with open_log(run) as opened:
        table, frame, data = resample(opened, 20.0), opened.to_pandas(20.0), opened.to_xarray(20.0)
        np.testing.assert_array_equal(frame["r"].to_numpy(), table.columns["r"])
        np.testing.assert_array_equal(data["r"].values, table.columns["r"])
        assert frame.attrs["units"]["r"] == data["r"].attrs["units"] == "rad/s"
        assert frame.index[0].timestamp() == pytest.approx(table.t[0], abs=1e-6)
        assert data["time"].values[0] == np.datetime64(round(table.t[0] * 1e9), "ns")
        monkeypatch.setitem(sys.modules, "pandas", None)
        with pytest.raises(SeatrialError, match=r"pandas is not installed: pip install 'seatrial\[tables\]'"):
            opened.to_pandas()


def test_every_kind_of_sample_is_in_the_resampled_table(log: Path, tmp_path: Path) -> None:
    run = CliRunner()
    words = ["mat", str(log), "--out", str(tmp_path / "out")]
    assert run.invoke(cli.export, words).exit_code == 0
    assert run.invoke(cli.export, ["ros", str(log), "--rate", "5", "--out", str(tmp_path / "ros")]).exit_code == 2
    with open_log(log) as opened:
        names = set(resample(opened, 10.0).columns)
    found = {name for name in scipy.io.loadmat(tmp_path / "out" / f"{log.stem}.mat") if not name.startswith("__")}
    assert found == {re.sub(r"[^A-Za-z0-9_]", "_", name) for name in names} | {"t", "units"}
    assert {"ahrs_ahrs_yaw", "esc_1_esc_rpm"} <= found


def signals_of(path: Path, **angles: np.ndarray) -> Path:
    """Write a log of angles [rad] at 50 Hz."""
    many = [
        SignalData(Signal(name, (name,), unit="rad"), "rad", T0 + 0.02 * np.arange(len(values)), values)
        for name, values in angles.items()
    ]
    write_signals(path, many, metadata={}, attachments={}, note="-")
    return path


def test_a_compass_of_a_whole_turn_is_not_averaged_through_its_jump(tmp_path: Path) -> None:
    true = np.radians(350.0) + np.radians(0.08) * np.arange(250)  # up to 370 degrees
    path = signals_of(tmp_path / "run.mcap", psi=np.mod(true, 2 * np.pi), t=true)
    with open_log(path) as opened:
        table = resample(opened, 10.0)
        export_resampled(opened, "csv", tmp_path / "out", 10.0)
    wanted = np.interp(table.t, T0 + 0.02 * np.arange(250), true)
    inside = slice(1, -1)
    error = table.columns["psi"] - wanted
    np.testing.assert_allclose(np.angle(np.exp(1j * error))[inside], 0.0, atol=2e-3)
    assert 0.0 <= table.columns["psi"].min() < table.columns["psi"].max() < 2 * np.pi  # unchanged
    # the angle was unwrapped, and stays so
    np.testing.assert_allclose(table.columns["t"][inside], wanted[inside], atol=2e-3)
    with (tmp_path / "out/run.csv").open(newline="") as file:
        first = next(iter(csv.DictReader(file)))
    assert float(first["t [s]"]) == T0  # the time, not the signal of that name
    assert float(first["t_ [rad]"]) == pytest.approx(true[0], abs=5e-3)


def test_names_that_would_be_equal_in_the_table_lose_no_column(tmp_path: Path) -> None:
    names = ("t", "t_", "t__", "ahrs_ahrs_yaw")
    path = signals_of(tmp_path / "run.mcap", **{name: np.full(100, 0.1 * k) for k, name in enumerate(names)})
    with open_log(path) as opened:
        export_resampled(opened, "csv", tmp_path / "out", 10.0)
    with (tmp_path / "out/run.csv").open(newline="") as file:
        row = {name.split(" ")[0]: float(value) for name, value in list(csv.DictReader(file))[5].items()}
    assert sorted(row) == sorted(["t", "t_", "t__", "t___", "ahrs_ahrs_yaw"])
    assert sorted(row.values())[:4] == pytest.approx([0.0, 0.1, 0.2, 0.3], abs=1e-6)
    log = recorder(tmp_path / "both.mcap")
    for k in range(20):
        log.write("ahrs", Frame(Ahrs(0.7, 0.0, 0.0), T0 + 0.1 * k, math.nan), T0 + 0.1 * k)
        log.write("ahrs_ahrs_yaw", Frame(Scalar(0.2), T0 + 0.1 * k, math.nan), T0 + 0.1 * k)
    log.close()
    with open_log(tmp_path / "both.mcap") as opened:
        columns = resample(opened, 10.0).columns
    assert sorted(np.nanmean(columns[name]) for name in columns if "yaw" in name) == pytest.approx([0.2, 0.7])


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan, math.inf])
def test_a_rate_of_the_table_that_is_not_positive_is_refused(log: Path, rate: float) -> None:
    with open_log(log) as opened, pytest.raises(SeatrialError, match="the rate of the table must be positive"):
        resample(opened, rate)


def test_longitude_is_resampled_across_the_date_line(tmp_path: Path) -> None:
    log = recorder(tmp_path / "run.mcap")
    for k in range(50):
        t, lon = T0 + 0.1 * k, 179.9999 + 4e-6 * k
        log.write("gps", Frame(Gnss(utc=t, lat=-17.0, lon=lon if lon <= 180.0 else lon - 360.0, fix=3), t, t), t)
    log.close()
    with open_log(tmp_path / "run.mcap") as opened:
        lon = resample(opened, 20.0).columns["gps_gnss_lon"]
    assert np.nanmin(np.abs(lon)) > 179.9
    assert np.nanmax(lon) <= 180.0
    assert np.nanmin(lon) < -179.9
