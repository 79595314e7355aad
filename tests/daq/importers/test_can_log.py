"""Tests of the import of CAN logs written by python-can: with a rig, without a rig, with a DBC, and compared with a
recording.
"""

from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path

import can
import numpy as np
import pytest

from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.daq.importers.can_log import import_can, read_can
from seatrial.daq.importers.guess import guess_map
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.importers.table import SourceOptions, Table
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Esc
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
MANY = """VERSION ""
BS_:
BU_: A
BO_ 256 Motor: 8 A
 SG_ rpm : 0|16@1- (1,0) [0|0] "" A

BO_ 257 Mux: 8 A
 SG_ M M : 0|8@1+ (1,0) [0|0] "" A
 SG_ a m0 : 8|8@1+ (1,0) [0|0] "" A

BO_ 2364540158 EEC1: 8 A
 SG_ EngSpeed : 24|16@1+ (0.125,0) [0|8031.875] "rpm" A

BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "VFrameFormat" BO_ 2364540158 3;
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
    """Write a log of two VESCs and an engine described by a DBC, 20 times a second."""
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
    np.testing.assert_allclose(tables["esc_2"].columns["rpm"], -700.0 * np.arange(N))  # electrical speed
    t = tables["esc_1"].t
    assert t is not None
    np.testing.assert_allclose(np.diff(t), 0.05, atol=2e-3)
    (tmp_path / "map.toml").write_text(guess_map(log).text)
    (out,) = import_files(tmp_path / "map.toml", [log], out=tmp_path / "x.mcap")
    np.testing.assert_allclose(values(out, "n_right")[1], -np.arange(N) / (N - 1.0), rtol=1e-6)


def test_each_message_of_a_dbc_becomes_a_topic(log: Path, tmp_path: Path) -> None:
    (tmp_path / "engine.dbc").write_text(DBC)
    text = 'format = "seatrial-import 1"\ncan = { dbc = "engine.dbc" }\n'
    text += '[[signal]]\nname = "force"\ntopic = "Engine"\nfield = "Thrust"\nunit = "N"\n'
    (tmp_path / "map.toml").write_text(text)
    (out,) = import_files(tmp_path / "map.toml", [log], out=tmp_path / "x.mcap")
    np.testing.assert_allclose(values(out, "force")[1], -1.0 * np.arange(N))


BOAT = """VERSION ""
BS_:
BU_: A
BO_ 291 MotorLeft: 4 A
 SG_ Speed : 0|16@1- (0.25,0) [0|0] "rpm" A
 SG_ Current : 16|16@1- (0.1,0) [0|0] "A" A

BO_ 292 MotorRight: 4 A
 SG_ Speed : 0|16@1- (0.25,0) [0|0] "rpm" A
 SG_ Current : 16|16@1- (0.1,0) [0|0] "A" A

BO_ 293 Compass: 4 A
 SG_ Heading : 0|16@1+ (0.01,0) [0|360] "deg" A
 SG_ YawRate : 16|16@1- (0.01,0) [0|0] "deg/s" A
"""


def test_a_guess_with_a_dbc_has_messages_and_units(tmp_path: Path) -> None:
    (tmp_path / "dbc").mkdir()
    (tmp_path / "maps").mkdir()
    (tmp_path / "dbc/boat.dbc").write_text(BOAT)
    rows = []
    for k in range(N):
        frames = {291: struct.pack("<hh", 40 * k, 10), 292: struct.pack("<hh", -20 * k, 10)}
        frames[293] = struct.pack("<Hh", 9000 + 100 * k, 1000)
        rows += [f"({T0 + 0.05 * k:.6f}) can0 {number:03X}#{data.hex()}\n" for number, data in frames.items()]
    (tmp_path / "run.log").write_text("".join(rows))
    words = ["--guess", "run.log", "--dbc", "dbc/boat.dbc", "-o", "maps/map.toml"]
    run = [sys.executable, "-m", "seatrial", "import"]
    subprocess.run([*run, *words], cwd=tmp_path, check=True, capture_output=True)
    (out,) = import_files(tmp_path / "maps/map.toml", [tmp_path / "run.log"], out=tmp_path / "x.mcap")
    np.testing.assert_allclose(values(out, "psi")[1], np.radians(90.0 + np.arange(N)), rtol=1e-9)
    np.testing.assert_allclose(values(out, "r")[1], np.radians(10.0), rtol=1e-9)
    left, right = (values(out, f"n_{side}")[1] for side in ("left", "right"))
    np.testing.assert_allclose(left, np.arange(N) / (N - 1.0), atol=1e-9)
    np.testing.assert_allclose(right, -0.5 * np.asarray(left), atol=1e-9)
    words = ["maps/map.toml", *words[1:4]]
    done = subprocess.run([*run, *words], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "--dbc applies only with --guess" in done.stderr
    with pytest.raises(SeatrialError, match=r"is not a CAN log .*; leave out --dbc"):
        guess_map(tmp_path / "dbc/boat.dbc", tmp_path / "dbc/boat.dbc")


def by_dbc(folder: Path, *lines: str) -> list[Table]:
    """Return the tables of a candump, with a frame each 0.1 s, read by the DBC `MANY`."""
    (folder / "many.dbc").write_text(MANY)
    text = "".join(f"({T0 + 0.1 * k:.6f}) {line}\n" for k, line in enumerate(lines))
    (folder / "run.log").write_text(text)
    return read_can(folder / "run.log", SourceOptions(dbc=folder / "many.dbc"))


def test_two_buses_are_two_topics(tmp_path: Path) -> None:
    ahead, astern = "can0 100#E803000000000000", "can1 100#18FC000000000000"
    found = {table.topic: table.columns["rpm"].tolist() for table in by_dbc(tmp_path, ahead, astern, ahead, astern)}
    assert found == {"can0_Motor": [1000.0, 1000.0], "can1_Motor": [-1000.0, -1000.0]}
    assert [table.topic for table in by_dbc(tmp_path, ahead)] == ["Motor"]


def test_the_same_node_on_two_buses_is_two_controllers(tmp_path: Path) -> None:
    """Without a rig, the same node on two buses is two controllers."""
    rows = [(k, bus) for k in range(N) for bus in (0, 1)]
    text = "".join(f"({T0 + 0.05 * k:.6f}) can{bus} 00000901#{1000 * k * (bus + 1):08X}00000000\n" for k, bus in rows)
    (tmp_path / "run.log").write_text(text)
    found = {table.topic: table.columns["rpm"][-1] for table in read_can(tmp_path / "run.log", SourceOptions())}
    assert found == {"can0_esc_1": 1000.0 * (N - 1), "can1_esc_1": 2000.0 * (N - 1)}
    text = guess_map(tmp_path / "run.log").text
    assert 'name = "n_left", topic = "can0_esc_1"' in text
    assert 'name = "n_right", topic = "can1_esc_1"' in text


def test_an_unavailable_field_of_j1939_is_left_out(tmp_path: Path) -> None:
    (table,) = by_dbc(tmp_path, "can0 18F00400#FFFFFF4038FFFFFF", "can0 18F00400#FFFFFFFFFFFFFFFF")
    np.testing.assert_array_equal(table.columns["EngSpeed"], [1800.0, np.nan])


def test_frames_that_do_not_match_the_dbc_are_counted(tmp_path: Path) -> None:
    (table,) = by_dbc(tmp_path, "can0 101#0001000000000000", "can0 101#0501000000000000", "can0 101#00")
    assert table.columns["a"].tolist() == [1.0]
    text = 'format = "seatrial-import 1"\ncan = { dbc = "many.dbc" }\n'
    text += '[[signal]]\nname = "a"\ntopic = "Mux"\nfield = "a"\nunit = "1"\nrole = "output"\n'
    (tmp_path / "map.toml").write_text(text)
    with pytest.warns(SeatrialWarning, match=r"run\.log: Mux: 2 frames left out: the DBC cannot decode them"):
        import_files(tmp_path / "map.toml", [tmp_path / "run.log"], out=tmp_path / "x.mcap")
    with pytest.raises(SeatrialError, match=r"none of its 1 frame is defined in .*many\.dbc"):
        by_dbc(tmp_path, "can0 101#0501000000000000")


@pytest.mark.parametrize("name", ["RUN.ASC", "run.txt", "run.log"])
def test_the_kind_of_a_log_is_found_by_its_content(tmp_path: Path, name: str) -> None:
    path = write_log(tmp_path, "asc").rename(tmp_path / name)
    assert len(read_can(path, SourceOptions())) == 2


def test_an_import_with_a_rig_equals_a_recording(tmp_path: Path) -> None:
    path = write_log(tmp_path, "candump")
    (tmp_path / "rig.toml").write_text(RIG)
    out, summary = import_can(path, tmp_path / "rig.toml", out=tmp_path / "run.mcap")
    assert summary == f"{2 * N} samples of {3 * N} frames"
    with open_log(out) as log:
        left, right = log.table(Esc, "esc", 1), log.table(Esc, "esc", 2)
        raw = list(log.raw("esc"))
        assert log.rig is not None
    np.testing.assert_allclose(left["rpm"], 100.0 * np.arange(N))  # speed of the shaft
    np.testing.assert_allclose(right["rpm"], 100.0 * np.arange(N))  # reversed by the rig
    np.testing.assert_allclose(left["t"], T0 + 0.001 + 0.05 * np.arange(N), atol=1e-5)
    assert len(raw) == 3 * N
    assert {direction for _, direction, _ in raw} == {"rx"}


def test_errors_of_a_can_log_are_one_line_each(tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    path.write_text("(1.000000) can0 123#00\n(1.100000) can0 123#01\n")
    with pytest.raises(SeatrialError, match="none of its 2 frames is VESC, DroneCAN or NMEA 2000; give the DBC"):
        guess_map(path)
    (tmp_path / "rig.toml").write_text(RIG)
    with pytest.raises(SeatrialError, match="none of its 2 frames belongs to a device of"):
        import_can(path, tmp_path / "rig.toml", out=tmp_path / "x.mcap")
    assert not (tmp_path / "x.mcap").exists()
    (tmp_path / "x.mcap").write_bytes(b"an earlier log")
    with pytest.raises(SeatrialError, match="none of its 2 frames belongs to a device of"):
        import_can(path, tmp_path / "rig.toml", out=tmp_path / "x.mcap", force=True)
    assert (tmp_path / "x.mcap").read_bytes() == b"an earlier log"
    with pytest.raises(SeatrialError, match="is the source of this import and is never replaced"):
        import_can(path, tmp_path / "rig.toml", out=tmp_path / "rig.toml", force=True)
    path.write_text("(1.000000) can0 123#00\n" + "what is this?\n" * 2)
    with pytest.raises(
        SeatrialError, match=r"unknown kind of file; give one that import reads|no table of numbers found"
    ):
        guess_map(path)
    path.write_text("(1.000000) can0 123#00\n" * 60 + "what is this?\n" * 70)
    with pytest.raises(SeatrialError, match="cannot be read as a CAN log: line 61 is not a frame of candump -L"):
        guess_map(path)
