from __future__ import annotations

import json
import os
import random
import resource
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import MCAP0_MAGIC

from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import mcap_writer
from seatrial.daq.log.reader import open_log
from seatrial.daq.log.record_stream import BALLAST_BYTES, WholeRecordStream
from seatrial.daq.samples import Ahrs, Frame, Scalar
from tests.daq.logs import RIG, T0, recorder, write_everything

RECORD = """
import os, struct, sys, time
from pathlib import Path
from seatrial.daq.clock import RunClock
from seatrial.daq.samples import Ahrs, Frame
from tests.daq.logs import rig
from seatrial.daq.log.recorder import Recorder
clock = RunClock()
log = Recorder(Path(sys.argv[1]), rig=rig(), clock=clock, attachments={"mission.toml": b"n = 1"}, metadata={})
while True:
    t = clock.now()
    log.write("ahrs", Frame(Ahrs(0.0, 0.0, 0.0), t, 0.0), t)
    log.tick()
    os.write(1, struct.pack("<d", t))
    time.sleep(0.002)
"""
FILL = """
import os, resource, sys
from pathlib import Path
from seatrial.daq.errors import SeatrialError
from tests.daq.logs import recorder, T0
if len(sys.argv) > 2:
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))
log = recorder(Path(sys.argv[1]))
for i in range(100_000):
    try:
        log.write_raw("ahrs", "rx", os.urandom(2000), T0 + i)
    except SeatrialError as error:
        print(i, error)
        try:
            log.write_raw("ahrs", "rx", b"", T0 + i)
        except SeatrialError as again:
            print(again)
        log.close()
        break
"""
ROOT = Path(__file__).parents[3]


def run_fill(path: Path, *limit: str) -> tuple[int, list[str]]:
    """Write until the disk is full. Return the number of written messages and the printed lines."""
    command = [sys.executable, "-c", FILL, str(path), *limit]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=True)
    first, *rest = done.stdout.splitlines()
    count, _, line = first.partition(" ")
    return int(count), [line, *rest]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_killed_recording_keeps_all_but_the_last_moment(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "run.mcap"
    n_before = random.Random(seed).randint(150, 500)
    process = subprocess.Popen([sys.executable, "-c", RECORD, str(path)], cwd=ROOT, stdout=subprocess.PIPE)
    assert process.stdout is not None
    received = process.stdout.read(8 * n_before)
    os.kill(process.pid, signal.SIGKILL)
    received += process.stdout.read()
    process.wait()
    process.stdout.close()
    written = np.frombuffer(received[: len(received) // 8 * 8], "<f8")
    log = open_log(path)
    table = log.table(Ahrs, "ahrs")
    assert not log.complete
    assert any("cut off" in warning for warning in log.warnings)
    assert written[-1] - table["t"][-1] <= 0.3
    np.testing.assert_allclose(table["t"], written[: len(table)], atol=1e-6)
    assert log.attachments == {"rig.toml": RIG.encode(), "mission.toml": b"n = 1"}
    assert log.rig is not None
    assert {"git", "host", "operator", "command_line", "version.seatrial"} <= set(log.metadata)


def test_metadata_and_attachments_are_in_the_file_before_the_first_sample(tmp_path: Path) -> None:
    log = recorder(tmp_path / "run.mcap", metadata={"operator": "Ada"})
    found = open_log(tmp_path / "run.mcap")
    assert found.metadata["operator"] == "Ada"
    assert found.metadata["rig"] == "test rig"
    assert json.loads(found.metadata["origin"]) == [0.0, T0]
    assert found.rig is not None
    assert found.counts == {}
    log.close()
    assert log.size == (tmp_path / "run.mcap").stat().st_size


def test_log_time_never_decreases_and_stamps_stay(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    log = recorder(path)
    rng = np.random.default_rng(4)
    t_rx = T0 + np.arange(500) * 0.01 + rng.normal(0.0, 0.02, 500)
    for k, t in enumerate(t_rx.tolist()):
        log.write("surge" if k % 2 else "sway", Frame(Scalar(k), t, float("nan")), T0 + k * 0.01)
    log.close()
    with path.open("rb") as file:
        times = [message.log_time for _, _, message in make_reader(file).iter_messages(log_time_order=False)]
    assert len(times) == 500
    assert np.all(np.diff(times) >= 0)
    table = open_log(path).table(Scalar, "surge")
    np.testing.assert_array_equal(table["t_rx"], t_rx[1::2])
    np.testing.assert_allclose(table["t"], T0 + np.arange(1, 500, 2) * 0.01, atol=1e-6)


@pytest.mark.parametrize("t", [float("nan"), float("inf"), -5.0, 1e300])
def test_an_invalid_time_is_replaced_by_the_time_of_the_log(tmp_path: Path, t: float) -> None:
    log = recorder(tmp_path / "run.mcap")
    log.write("surge", Frame(Scalar(1.0), T0, float("nan")), T0)
    log.write("surge", Frame(Scalar(2.0), t, float("nan")), t)
    log.close()
    table = open_log(tmp_path / "run.mcap").table(Scalar, "surge")
    np.testing.assert_allclose(table["t"], [T0, T0], atol=1e-6)


def test_few_waiting_messages_are_written_soon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mcap_writer, "FEW_FLUSH_S", 0.0)
    monkeypatch.setattr(mcap_writer, "FLUSH_S", 1000.0)
    path = tmp_path / "run.mcap"
    log = recorder(path)

    def on_disk() -> int:
        log.tick()
        return sum(open_log(path).counts.values())

    log.event(T0, "mark", "alone")
    assert on_disk() == 1
    for k in range(mcap_writer.FEW_WAITING + 1):
        log.event(T0 + k, "mark", "one of many")
    assert on_disk() == 1
    monkeypatch.setattr(mcap_writer, "FLUSH_S", 0.0)
    assert on_disk() == mcap_writer.FEW_WAITING + 2
    log.close()


def test_the_chunks_stay_small_without_a_tick(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    log = recorder(path)
    for i in range(1000):
        log.write_raw("ahrs", "rx", os.urandom(1000), T0 + i)
    on_disk = path.stat().st_size
    log.close()
    assert 700_000 < on_disk < log.size


def test_a_log_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(b"dear to me")
    with pytest.raises(SeatrialError, match=r"run\.mcap: the file exists already"):
        recorder(path)
    assert path.read_bytes() == b"dear to me"


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(SeatrialError, match=r"the folder cannot be created: .*file is not a folder"):
        recorder(tmp_path / "file" / "run.mcap")


def test_after_close(tmp_path: Path) -> None:
    log = recorder(tmp_path / "run.mcap")
    log.close()
    log.close()
    with pytest.raises(SeatrialError, match="closed already"):
        log.event(T0, "mark", "late")


def test_a_short_write_leaves_complete_records(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    count, lines = run_fill(path, str(1_000_000))
    assert "writing failed (File too large)" in lines[0]
    assert "has no footer" in lines[0]
    assert lines[1] == lines[0]
    assert path.stat().st_size <= 1_000_000
    log = open_log(path)
    assert not log.complete
    assert all("inside a record" not in warning for warning in log.warnings)  # not torn
    kept = list(log.raw("ahrs"))
    assert count - 2 * 256 * 1024 // 2000 < len(kept) <= count
    np.testing.assert_allclose([t for t, _, _ in kept], T0 + np.arange(len(kept)))
    assert {len(data) for _, _, data in kept} == {2000}


def test_a_log_on_a_full_disk_is_closed_and_keeps_all_earlier_messages(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", str(disk)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("needs the right to mount a small file system")
    try:
        path = disk / "run.mcap"
        count, lines = run_fill(path)
        assert "writing failed (No space left on device)" in lines[0]
        assert "closed and complete up to there" in lines[0]
        log = open_log(path)
        assert log.complete
        assert log.warnings == []
        # the message that met the full disk is in the log as well
        assert [len(data) for _, _, data in log.raw("ahrs")] == [2000] * (count + 1)
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == count + 1
        assert os.listdir(disk) == ["run.mcap"]  # the ballast is gone
        log.close()
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_a_log_without_room_for_the_ballast_leaves_no_open_file(tmp_path: Path) -> None:
    """A recorder on a full disk tries again every 0.25 s, and would run out of file descriptors."""
    n_open = len(os.listdir("/dev/fd"))
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (BALLAST_BYTES // 2, hard))  # acts like a full disk
    try:
        with pytest.raises(OSError, match="File too large"):
            WholeRecordStream(tmp_path / "run.mcap")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert len(os.listdir("/dev/fd")) == n_open
    assert os.listdir(tmp_path) == []


def test_the_mcap_library_reads_the_log_completely(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_everything(path)
    data = path.read_bytes()
    assert data.startswith(MCAP0_MAGIC)
    assert data.endswith(MCAP0_MAGIC)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        header = reader.get_header()
        summary = reader.get_summary()
        assert len(list(reader.iter_messages())) == sum(open_log(path).counts.values())
        assert [attachment.name for attachment in reader.iter_attachments()] == ["rig.toml", "mission.toml"]
    assert header.profile == "ros2"
    assert summary is not None
    assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
