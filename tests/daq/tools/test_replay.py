"""Tests of the replay of a log's raw bytes on ports: for a plain reader, and for an acquisition that records them
again.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import serial

from seatrial.daq.acquisition.session import Acquisition
from seatrial.daq.clock import RunClock
from seatrial.daq.config.rig_file import load_rig, parse_rig
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log.reader import open_log
from seatrial.daq.protocol import slcan
from seatrial.daq.protocol.canframe import CAN_FRAME, pack_can
from seatrial.daq.rig import Rig, Ros2
from seatrial.daq.samples import Ahrs, Esc
from seatrial.daq.tools.replay import as_slcan, replay_log
from tests.daq.logs import T0, recorder
from tests.daq.ptys import RIG, TestBoat, wait_for


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record one and a half seconds of the test boat."""
    folder = tmp_path_factory.mktemp("boat")
    with TestBoat(folder) as boat:
        rig = parse_rig(f'{boat.rig_path.read_text()}\n[ros2]\nrouter = "tcp/10.0.0.9:7447"\n', boat.rig_path)
        with Acquisition(rig, folder / "log.mcap", clock=RunClock()) as acquisition:
            for port in ("ahrs", "esc"):
                wait_for(lambda port=port: acquisition.status().ports[port].samples > 120, 30.0, "a hundred samples")
    return folder / "log.mcap"


def test_a_reader_gets_the_same_bytes_at_the_recorded_pace(recorded: Path, tmp_path: Path) -> None:
    got = bytearray()
    times: list[float] = []
    done = threading.Event()

    def read() -> None:
        while not (tmp_path / "ports/ahrs").exists():
            time.sleep(0.005)
        with serial.Serial(str(tmp_path / "ports/ahrs"), 115200, timeout=0.05) as port:
            while not done.is_set():
                with contextlib.suppress(OSError):  # the port disappears when the log has ended
                    if data := port.read(port.in_waiting or 1):
                        got.extend(data)
                        times.append(time.monotonic())

    reader = threading.Thread(target=read)
    reader.start()
    with open_log(recorded) as log:
        sent = b"".join(data for _, direction, data in log.raw("ahrs") if direction == "rx")
        lasted = float(np.ptp([t for t, direction, _ in log.raw("ahrs") if direction == "rx"]))
        n = replay_log(log, ["ahrs"], tmp_path / "ports", speed=2.0)
    done.set()
    reader.join()
    assert n == len(sent)
    assert bytes(got) == sent
    assert times[-1] - times[0] == pytest.approx(lasted / 2.0, abs=0.3)
    assert not os.path.lexists(tmp_path / "ports/ahrs")


def test_an_acquisition_records_the_same_samples_again(recorded: Path, tmp_path: Path) -> None:
    rig = parse_rig(RIG.format(speed=1.0), tmp_path / "rig.toml")
    stop = threading.Event()
    with open_log(recorded) as log:
        thread = threading.Thread(
            target=replay_log, args=(log, ["ahrs", "esc"], tmp_path), kwargs={"speed": 2.0, "stopped": stop.is_set}
        )
        thread.start()
        wait_for(lambda: (tmp_path / "esc").is_symlink(), what="the ports")
        (tmp_path / "can").symlink_to(tmp_path / "esc")
        with Acquisition(rig, tmp_path / "again.mcap", clock=RunClock()):
            thread.join(30.0)
            stop.set()
        with open_log(tmp_path / "again.mcap") as again:
            first, second = log.table(Ahrs, "ahrs"), again.table(Ahrs, "ahrs")
            assert np.array_equal(first["r"], second["r"])
            assert np.array_equal(first["t_device"], second["t_device"])
            escs = [len(opened.table(Esc, "esc", node=1)) for opened in (log, again)]
            assert escs[0] == escs[1] > 100


def test_the_rig_of_the_log_is_beside_the_ports_while_they_exist(recorded: Path, tmp_path: Path) -> None:
    seen: list[tuple[str, Rig]] = []

    def stopped() -> bool:
        seen.append((printed[0], load_rig(tmp_path / "ports/replay.toml")))
        return True

    printed: list[str] = []
    with open_log(recorded) as log:
        assert (
            replay_log(log, ["ahrs", "esc"], tmp_path / "ports", speed=2.0, said=printed.append, stopped=stopped) == 0
        )
        own = log.rig
    assert own is not None
    ((line, rig),) = seen
    assert f"`seatrial log {tmp_path}/ports/replay.toml` records them again" in line
    ports = {device.name: device.port for device in rig.devices}
    assert ports == {"ahrs": str(tmp_path / "ports/ahrs"), "esc": f"slcan:{tmp_path}/ports/esc"}
    assert [thruster.device for thruster in rig.thrusters] == ["esc"] * len(own.thrusters)
    assert own.ros2 != rig.ros2 == Ros2()
    assert (rig.speed, rig.log_directory, rig.name) == (2.0, recorded.parent, own.name)
    assert list((tmp_path / "ports").iterdir()) == []


def test_frames_of_both_kinds_become_slcan_lines() -> None:
    extended = pack_can(0x0901, b"\x01\x02")
    plain = CAN_FRAME.pack(0x123, 3, b"\x0a\x0b\x0c\0\0\0\0\0")
    assert as_slcan(extended + plain) == b"T0000090120102\rt12330A0B0C\r"
    assert slcan.Decoder().feed(as_slcan(extended + plain), 0.0) == [extended.ljust(16, b"\0"), plain]


@pytest.mark.parametrize("name", ["/tmp/x", "../x", "a/b", "replay.toml", ".bashrc", "", "ahrs\n", "ünder"])
def test_a_device_name_that_is_invalid_in_a_rig_makes_no_port(tmp_path: Path, name: str) -> None:
    log = recorder(tmp_path / "hostile.mcap")
    log.write_raw(name, "rx", b"echo pwned\n", T0)
    log.close()
    ports = tmp_path / "deep" / "ports"
    with open_log(tmp_path / "hostile.mcap") as opened, pytest.raises(SeatrialError):
        replay_log(opened, [], ports, stopped=lambda: True)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["hostile.mcap"]


@pytest.mark.parametrize("name", ["ahrs", "esc", "replay.toml"])
@pytest.mark.parametrize("kind", ["file", "link", "dangling"])
def test_existing_files_are_neither_replaced_nor_removed(recorded: Path, tmp_path: Path, name: str, kind: str) -> None:
    (tmp_path / "mine").write_text("mine")
    (tmp_path / "ports").mkdir()
    there = tmp_path / "ports" / name
    if kind == "file":
        there.write_text("mine")
    else:
        there.symlink_to(tmp_path / ("mine" if kind == "link" else "nowhere"))
    before = os.lstat(there)
    with open_log(recorded) as log, pytest.raises(SeatrialError, match="a replay replaces no file"):
        replay_log(log, [], tmp_path / "ports", stopped=lambda: True)
    assert os.lstat(there).st_ino == before.st_ino
    assert [path.name for path in (tmp_path / "ports").iterdir()] == [name]
    assert (tmp_path / "mine").read_text() == "mine"
    assert not os.path.lexists(tmp_path / "nowhere")


def test_a_file_put_in_place_of_a_port_is_neither_opened_nor_removed(recorded: Path, tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("mine")
    looks = []

    def stopped() -> bool:
        looks.append(1)
        if len(looks) == 1:
            (tmp_path / "ports/ahrs").unlink()
            (tmp_path / "ports/ahrs").symlink_to(tmp_path / "mine")
        return len(looks) > 3

    with open_log(recorded) as log:
        assert replay_log(log, ["ahrs"], tmp_path / "ports", stopped=stopped) == 0
    assert [path.name for path in (tmp_path / "ports").iterdir()] == ["ahrs"]
    assert (tmp_path / "mine").read_text() == "mine"


def test_a_log_without_raw_bytes_cannot_be_replayed(tmp_path: Path) -> None:
    log = recorder(tmp_path / "empty.mcap")
    log.event(T0, "mark", "nothing")
    log.close()
    with open_log(tmp_path / "empty.mcap") as opened, pytest.raises(SeatrialError, match="the log has no raw bytes"):
        replay_log(opened, [], tmp_path)


def test_a_missing_device_of_a_replay_is_named(recorded: Path, tmp_path: Path) -> None:
    with (
        open_log(recorded) as log,
        pytest.raises(SeatrialError, match="no raw bytes of device 'gps'; give one of those with raw bytes: ahrs"),
    ):
        replay_log(log, ["gps"], tmp_path)


def test_a_device_that_is_given_twice_has_one_port(recorded: Path, tmp_path: Path) -> None:
    printed: list[str] = []
    with open_log(recorded) as log:
        assert replay_log(log, ["ahrs", "ahrs"], tmp_path, said=printed.append, stopped=lambda: True) == 0
    assert printed[0].count("ahrs") == 1
