"""CAN logs written by python-can: our own decoders with a rig and without one, a DBC, and logs as if recorded."""

from __future__ import annotations

import struct
from pathlib import Path

import can
import numpy as np
import pytest

from daq.errors import SeatrialError
from daq.importers.can_log import import_can, read_can
from daq.importers.guess import guess_map
from daq.importers.import_files import import_files
from daq.importers.table import SourceOptions
from daq.log.reader import open_log
from daq.samples import Esc
from tests.daq.csv_files import values

N = 40
T0 = 1_700_000_000.0
WRITERS = {"candump": can.CanutilsLogWriter, "asc": can.ASCWriter, "blf": can.BLFWriter}
DBC = """VERSION ""
BS_:
BU_: engine
BO_ 291 Engine: 4 engine
 SG_ Speed : 0|16@1+ (0.25,0) [0|16000] "rpm" engine
 SG_ Thrust : 16|16@1- (0.1,0) [-3000|3000] "N" engine
"""
RIG = """format = "seatrial-rig 1"
name = "boat"
[[device]]
name = "esc"
protocol = "vesc"
port = "socketcan:can0"
rate_hz = 20.0
[[thruster]]
name = "left"
device = "esc"
node = 1
position_m = [0.0, -0.3, 0.0]
pole_pairs = 7
rpm_max = 4000.0
[[thruster]]
name = "right"
device = "esc"
node = 2
position_m = [0.0, 0.3, 0.0]
pole_pairs = 7
rpm_max = 4000.0
reversed = true
"""


def write_log(folder: Path, form: str) -> Path:
    """Two VESCs and an engine that a DBC knows, 20 times a second."""
    path = folder / f"run.{'log' if form == 'candump' else form}"
    with WRITERS[form](path, channel="can0" if form == "candump" else 1) as writer:
        for k in range(N):
            for node in (1, 2):
                data = struct.pack(">ihh", 700 * k * (1 if node == 1 else -1), 10 * k, 20 * k)
                writer.on_message_received(frame(T0 + 0.05 * k + 0.001 * node, 9 << 8 | node, True, data))
            data = struct.pack("<Hh", 4 * k, -10 * k)
            writer.on_message_received(frame(T0 + 0.05 * k + 0.003, 291, False, data))
    return path


def frame(t: float, identifier: int, extended: bool, data: bytes) -> can.Message:
    channel = "can0"
    return can.Message(timestamp=t, arbitration_id=identifier, is_extended_id=extended, data=data, channel=channel)


@pytest.fixture(params=["candump", "asc", "blf"])
def log(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return write_log(tmp_path, request.param)


def test_without_a_rig_the_protocol_is_found(log: Path, tmp_path: Path) -> None:
    tables = {table.topic: table for table in read_can(log, SourceOptions())}
    assert sorted(tables) == ["esc_1", "esc_2"]
    np.testing.assert_allclose(tables["esc_2"].columns["rpm"], -700.0 * np.arange(N))  # electrical
    t = tables["esc_1"].t
    assert t is not None
    np.testing.assert_allclose(np.diff(t), 0.05, atol=2e-3)
    (tmp_path / "map.toml").write_text(guess_map(log).text)
    (out,) = import_files(tmp_path / "map.toml", [log], out=tmp_path / "x.mcap")
    np.testing.assert_allclose(values(out, "n_right")[1], -np.arange(N) / (N - 1.0), rtol=1e-6)


def test_a_dbc_makes_a_topic_of_each_message(log: Path, tmp_path: Path) -> None:
    (tmp_path / "engine.dbc").write_text(DBC)
    text = 'format = "seatrial-import 1"\ncan = { dbc = "engine.dbc" }\n'
    text += '[[signal]]\nname = "force"\ntopic = "Engine"\nfield = "Thrust"\nunit = "N"\n'
    (tmp_path / "map.toml").write_text(text)
    (out,) = import_files(tmp_path / "map.toml", [log], out=tmp_path / "x.mcap")
    np.testing.assert_allclose(values(out, "force")[1], -1.0 * np.arange(N))


def test_a_rig_makes_the_log_that_it_would_have_recorded(tmp_path: Path) -> None:
    path = write_log(tmp_path, "candump")
    (tmp_path / "rig.toml").write_text(RIG)
    out, said = import_can(path, tmp_path / "rig.toml", out=tmp_path / "run.mcap")
    assert said == f"{2 * N} samples of {3 * N} frames"
    with open_log(out) as log:
        left, right = log.table(Esc, "esc", 1), log.table(Esc, "esc", 2)
        raw = list(log.raw("esc"))
        assert log.rig is not None
    np.testing.assert_allclose(left["rpm"], 100.0 * np.arange(N))  # of the shaft
    np.testing.assert_allclose(right["rpm"], 100.0 * np.arange(N))  # reversed by the rig
    np.testing.assert_allclose(left["t"], T0 + 0.001 + 0.05 * np.arange(N), atol=1e-5)
    assert len(raw) == 3 * N
    assert {direction for _, direction, _ in raw} == {"rx"}


def test_what_is_wrong_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    path.write_text("(1.000000) can0 123#00\n(1.100000) can0 123#01\n")
    with pytest.raises(SeatrialError, match="2 frames, none of VESC, DroneCAN or NMEA 2000; name a DBC"):
        guess_map(path)
    (tmp_path / "rig.toml").write_text(RIG)
    with pytest.raises(SeatrialError, match="2 frames, none of a device of"):
        import_can(path, tmp_path / "rig.toml", out=tmp_path / "x.mcap")
    assert not (tmp_path / "x.mcap").exists()
    path.write_text("(1.000000) can0 123#00\n(1.1")
    with pytest.raises(SeatrialError, match="cannot be read as a CAN log"):
        guess_map(path)
