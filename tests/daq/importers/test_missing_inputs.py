"""Tests of inputs without a value: zero if the format defines it so, otherwise a gap that a fit leaves out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.importers.missing_inputs import input_gaps
from seatrial.daq.importers.ros import read_bag
from seatrial.daq.importers.table import SourceOptions
from seatrial.daq.importers.ulog import read_ulog
from seatrial.ident.data import load_all
from tests.bench.check_cases import findings
from tests.daq.csv_files import values
from tests.daq.ulog_files import Topic, needs_pyulog, write_ulog

NAN = float("nan")
T = 0.1 * np.arange(600)
STOPPED = ((T >= 20.0) & (T < 32.0)) | ((T >= 45.0) & (T < 48.0))


@needs_pyulog
def test_nan_of_px4_motors_is_a_motor_that_is_stopped(tmp_path: Path) -> None:
    control = np.stack([np.where(STOPPED, NAN, 0.5), np.where(STOPPED, NAN, -0.4), np.full(T.size, NAN)], axis=1)
    write_ulog(tmp_path / "run.ulg", {"actuator_motors": Topic("float[3] control", "3f", T, control)})
    (table,) = read_ulog(tmp_path / "run.ulg", SourceOptions())
    np.testing.assert_allclose(table.columns["control[0]"], np.where(STOPPED, 0.0, 0.5))
    np.testing.assert_allclose(table.columns["control[1]"], np.where(STOPPED, 0.0, -0.4), rtol=1e-6)
    assert np.isnan(table.columns["control[2]"]).all()  # this motor does not exist
    assert f"{STOPPED.sum()} messages of {T.size} with a stopped motor" in table.full_remark


def test_nan_of_px4_motors_in_a_bag_is_a_motor_that_is_stopped(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "px4_msgs/msg/ActuatorMotors"
    store.register(get_types_from_msg("uint64 timestamp\nfloat32[2] control\n", kind))
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/fmu/out/actuator_motors", kind, typestore=store)
        for k, t in enumerate(T):
            message = store.types[kind](k, np.array([NAN if STOPPED[k] else 0.5, 0.25], np.float32))
            writer.write(connection, round((1.7e9 + t) * 1e9), store.serialize_cdr(message, kind))
    (table,) = read_bag(tmp_path / "bag", SourceOptions())
    np.testing.assert_allclose(table.columns["control[0]"], np.where(STOPPED, 0.0, 0.5))
    assert "stopped motor" in table.remark


def log_of(tmp_path: Path, of_left: str = "", left: np.ndarray | None = None) -> Path:
    """Import a table with commands, some of which are empty, and return the log."""
    left = np.where(STOPPED, NAN, 0.5 + 0.001 * T) if left is None else left
    rows = "\n".join(
        f"{t:.1f},{'' if np.isnan(n) else f'{n:.6f}'},0.3,{0.01 * np.sin(t):.6f}" for t, n in zip(T, left, strict=True)
    )
    (tmp_path / "run.csv").write_text(f"t,left,right,psi\n{rows}\n")
    signals = [
        f'{{ name = "n_left", column = "left", unit = "1", role = "input"{of_left} }}',
        '{ name = "n_right", column = "right", unit = "1", role = "input" }',
        '{ name = "psi", column = "psi", unit = "rad" }',
    ]
    text = f'format = "seatrial-import 1"\ntime = {{ column = "t" }}\nsignal = [{", ".join(signals)}]\n'
    (tmp_path / "map.toml").write_text(text)
    return import_files(tmp_path / "map.toml", [tmp_path / "run.csv"], out=tmp_path / "run.mcap", force=True)[0]


@pytest.mark.parametrize("hold", ["zero", "sampled", "linear"])
def test_a_command_without_a_value_is_a_gap(tmp_path: Path, hold: str) -> None:
    with pytest.warns(SeatrialWarning, match=r"n_left: unknown for 15\.0 s, in 2 gaps; a fit leaves these times out"):
        log = log_of(tmp_path, f', nan = "drop", hold = "{hold}"')
    t, n = map(np.array, values(log, "n_left"))
    np.testing.assert_allclose(t[np.isnan(n)], [20.0, 45.0])
    (found,) = [f for f in findings(log) if f.code == "input-missing"]
    assert (found.level, found.where) == ("warning", "n_left")
    assert "15.0 s, in 2 gaps, from 20.0 s on, the longest of 12.0 s" in found.text


def test_a_fit_leaves_the_gaps_out(tmp_path: Path) -> None:
    with pytest.warns(SeatrialWarning):
        log = log_of(tmp_path, ', nan = "drop"')
    loaded, _ = load_all([log], [])
    assert [(part.run.t_from, part.run.t_to) for part in loaded] == [
        pytest.approx((0.0, 20.0)), pytest.approx((32.0, 45.0)), pytest.approx((48.0, 59.9))
    ]  # fmt: skip
    assert [part.about["name"] for part in loaded] == ["run[0:20]", "run[32:45]", "run[48:59.9]"]
    for part in loaded:
        times = np.array([part.run.t_from, *part.run.channels["psi"].t[[0, -1]], part.run.t_to])
        assert np.all(np.diff(times - np.array([0.11, 0.0, 0.0, 0.0])) >= 0.0)


def test_a_log_whose_inputs_are_mostly_unknown_cannot_be_fitted(tmp_path: Path) -> None:
    left = np.where(np.arange(T.size) % 90 < 60, 0.5, NAN)
    with pytest.warns(SeatrialWarning):
        log = log_of(tmp_path, ', nan = "drop"', left)
    with pytest.raises(
        SeatrialError, match=r"run\.mcap: no segment of the log in which all inputs are known is as long as 10 s"
    ):
        load_all([log], [])


def test_a_map_can_define_an_empty_cell_as_zero(tmp_path: Path) -> None:
    log = log_of(tmp_path, ', nan = "zero", scale = 0.5, offset = 0.25')
    n = np.array(values(log, "n_left")[1])
    np.testing.assert_array_equal(n[STOPPED], 0.0)
    np.testing.assert_allclose(n[~STOPPED], 0.5 + 0.0005 * T[~STOPPED], atol=1e-6)
    assert not [f for f in findings(log) if f.code == "input-missing"]


def test_sparse_columns_and_short_losses_have_no_gaps() -> None:
    """A table of several rates has empty cells. A command that is written only when it changes has long pauses."""
    sparse = np.where(np.arange(T.size) % 5 == 0, 0.5, NAN)
    on_change = np.where(np.arange(T.size) % 70 == 0, 0.5, NAN)
    lossy = np.where(np.random.default_rng(1).random(T.size) < 0.1, NAN, 0.5)
    for n in (sparse, on_change, lossy):
        assert not input_gaps(T, n).any()
