"""Tests of a log in several files: split by size, by time, or after a full disk, and read as one log."""

from __future__ import annotations

import contextlib
import os
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from seatrial.daq.acquisition.session import Acquisition
from seatrial.daq.clock import RunClock
from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import recorder as recorder_module
from seatrial.daq.log.reader import Log, open_log
from seatrial.daq.log.recorder import Recorder, check_room
from seatrial.daq.log.recovery import recover_log
from seatrial.daq.log.segments import first_segment_of, first_segments, segments
from seatrial.daq.log.watchdog_note import note_path
from seatrial.daq.rig import Segments
from seatrial.daq.samples import Ahrs, Frame, Gnss
from tests.daq.logs import T0, StoppedClock, rig
from tests.daq.ptys import TestBoat, wait_for


def segmented(path: Path, patient: bool = False, **limits: float) -> Recorder:
    return Recorder(path, rig=replace(rig(), segments=Segments(**limits)), clock=StoppedClock(), patient=patient)


def write(log: Recorder, n: int, start: int = 0) -> None:
    for k in range(start, start + n):
        t = T0 + 0.1 * k
        log.write("ahrs", Frame(Ahrs(0.001 * k, 0.0, 0.0, mx=1e-5, my=0.0, mz=0.0), t, float(k)), t)
        if k % 10 == 0:
            log.write("gnss", Frame(Gnss(t, 41.0, -8.0), t, t), t)
        log.tick()


def test_segments_by_time_are_read_as_one_log(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    log = segmented(path, seconds=10.0)
    write(log, 350)
    log.event(T0 + 35.0, "mark", "the end")
    log.close()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.1.mcap", "run.2.mcap", "run.3.mcap", "run.mcap"]
    with open_log(path) as opened:
        assert [p.name for p in opened.paths] == ["run.mcap", "run.1.mcap", "run.2.mcap", "run.3.mcap"]
        table = opened.table(Ahrs, "ahrs")
        np.testing.assert_allclose(table["yaw"], 0.001 * np.arange(350))
        np.testing.assert_array_equal(table["t_device"], np.arange(350.0))  # joined across the borders
        np.testing.assert_allclose(table["mx"], 1e-5)
        assert len(opened.table(Gnss, "gnss")) == 35
        assert opened.events()[-1][1:] == ("mark", "the end")
        assert opened.complete
        assert opened.warnings == []
        assert opened.duration == pytest.approx(35.0)
    for part in tmp_path.iterdir():  # each segment is a complete log
        with AnyReader([part]) as reader:
            assert sum(1 for _ in reader.messages()) > 0
        with part.open("rb") as file:
            assert [attachment.name for attachment in make_reader(file).iter_attachments()] == ["rig.toml"]
    with open_log(tmp_path / "run.2.mcap") as segment:
        assert 90 <= len(segment.table(Ahrs, "ahrs")) <= 110


def test_segments_by_size(tmp_path: Path) -> None:
    log = segmented(tmp_path / "run.mcap", megabytes=1.0)
    rng = np.random.default_rng(3)
    for k in range(60):
        log.write_raw("ahrs", "rx", rng.bytes(50_000), T0 + k)
        log.tick()
    log.close()
    sizes = [p.stat().st_size for p in sorted(tmp_path.iterdir())]
    assert len(sizes) == 3
    assert max(sizes) < 1.4e6
    with open_log(tmp_path / "run.mcap") as opened:
        assert [round(t - T0) for t, _, _ in opened.raw("ahrs")] == list(range(60))
        assert log.size == sum(sizes)


def test_a_killed_last_segment_and_a_missing_segment_are_reported(tmp_path: Path) -> None:
    log = segmented(tmp_path / "run.mcap", seconds=10.0)
    write(log, 350)
    log.close()
    (tmp_path / "run.1.mcap").unlink()
    last = tmp_path / "run.3.mcap"
    last.write_bytes(last.read_bytes()[:-200])
    with open_log(tmp_path / "run.mcap") as opened:
        assert not opened.complete
        assert any(line.startswith("run.3.mcap: the recording was cut off") for line in opened.warnings)
        yaw = opened.table(Ahrs, "ahrs")["yaw"]
    assert 200 <= len(yaw) <= 250
    assert yaw[-1] == pytest.approx(0.349)


def test_a_segment_of_another_run_is_left_out_and_reported(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        log = Recorder(tmp_path / folder / "run.mcap", rig=rig(), clock=RunClock() if folder == "b" else StoppedClock())
        log.event(T0, "mark", folder)
        log.close()
    (tmp_path / "b/run.mcap").rename(tmp_path / "a/run.1.mcap")
    (tmp_path / "a/run.2.mcap").write_bytes(b"no log")
    with open_log(tmp_path / "a/run.mcap") as opened:
        assert [text for _, _, text in opened.events()] == ["a"]
        assert opened.warnings[0].startswith("a segment is left out: ") or "another run" in opened.warnings[0]
        assert len(opened.warnings) == 2


def test_a_number_with_a_leading_zero_makes_no_segment(tmp_path: Path) -> None:
    log = segmented(tmp_path / "run.mcap", seconds=10.0)
    write(log, 150)
    log.close()
    for copy in ("run.01.mcap", "run.0.mcap"):  # such as a copy that somebody renamed
        (tmp_path / copy).write_bytes((tmp_path / "run.1.mcap").read_bytes())
        assert first_segment_of(tmp_path / copy) is None
    assert segments(tmp_path / "run.mcap") == {1: tmp_path / "run.1.mcap"}
    assert [path.name for path in first_segments(tmp_path)] == ["run.0.mcap", "run.01.mcap", "run.mcap"]
    with open_log(tmp_path / "run.mcap") as opened:
        assert opened.warnings == []
        assert len(opened.table(Ahrs, "ahrs")) == 150


def test_an_existing_segment_file_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "run.1.mcap").write_bytes(b"dear to me")
    log = segmented(tmp_path / "run.mcap", seconds=10.0)
    write(log, 150)
    log.close()
    assert (tmp_path / "run.1.mcap").read_bytes() == b"dear to me"
    with open_log(tmp_path / "run.mcap") as opened:
        assert len(opened.table(Ahrs, "ahrs")) == 150


def test_a_log_is_not_started_on_a_nearly_full_disk(tmp_path: Path) -> None:
    check_room(tmp_path / "new/folder/run.mcap", 0.0)
    with pytest.raises(SeatrialError, match=r"MB free, but the rig requires 1000000000 MB to begin a log"):
        check_room(tmp_path / "new/folder/run.mcap", 1e9)
    with TestBoat(tmp_path) as boat:
        text = boat.rig_path.read_text().replace("[clock]", "[log]\nfree_mb = 1e9\n\n[clock]")
        acquisition = Acquisition(parse_rig(text, boat.rig_path), tmp_path / "log.mcap", clock=RunClock())
        with pytest.raises(SeatrialError, match="lower free_mb"), acquisition:
            pass
    assert not (tmp_path / "log.mcap").exists()


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """Return a mount function for a disk of 6 MB, and skip the test if it cannot be mounted."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=6m", "tmpfs", str(disk)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("needs the right to mount a small file system")
    try:
        yield disk
    finally:
        subprocess.run(["umount", "--lazy", str(disk)], check=True)


def test_a_log_pauses_on_a_full_disk_and_continues_when_space_returns(
    small_disk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder_module, "RETRY_S", 0.0)
    (small_disk / "hog").write_bytes(b"x" * 3_000_000)
    log = segmented(small_disk / "run.mcap", patient=True)
    rng = np.random.default_rng(3)
    k = 0
    while not log.paused:
        log.write_raw("ahrs", "rx", rng.bytes(20_000), T0 + k)
        k += 1
        assert k < 1000
    assert "the disk is full" in log.paused
    for _ in range(20):
        log.write_raw("ahrs", "rx", b"while it is full", T0 + k)
        log.tick()
        k += 1
    assert log.paused
    (small_disk / "hog").unlink()
    log.tick()
    assert not log.paused
    log.write_raw("ahrs", "rx", b"and on", T0 + k)
    log.close()
    with open_log(small_disk / "run.mcap") as opened:
        assert opened.complete
        assert opened.warnings == []
        assert [round(t - T0) for t, _, _ in opened.raw("ahrs")] == list(range(k + 1))  # no message is lost
        ((_, kind, text),) = opened.events()
    assert kind == "disk"
    assert "kept 20 messages" in text
    assert "lost" not in text


def test_a_log_that_ends_on_a_full_disk_reports_the_lost_messages(small_disk: Path) -> None:
    log = segmented(small_disk / "run.mcap", patient=True)
    rng = np.random.default_rng(3)
    while not log.paused:
        log.write_raw("ahrs", "rx", rng.bytes(20_000), T0)
    log.event(T0, "mark", "not on the disk")
    with pytest.raises(SeatrialError, match=r"the disk is full.*; 1 message received since then could not be written"):
        log.close()


def fill(path: Path) -> None:
    """Fill the disk."""
    with path.open("wb", buffering=0) as hog, contextlib.suppress(OSError):
        while True:
            hog.write(b"x" * 4096)


def test_the_acquisition_warns_within_a_second_and_continues(small_disk: Path, tmp_path: Path) -> None:
    boat_folder = tmp_path / "boat"
    boat_folder.mkdir()
    with TestBoat(boat_folder) as boat:
        text = boat.rig_path.read_text().replace("[clock]", "[log]\nfree_mb = 1.0\n\n[clock]")
        rig = parse_rig(text, boat.rig_path)
        with Acquisition(rig, small_disk / "log.mcap", clock=RunClock()) as acquisition:
            wait_for(lambda: acquisition.status().ports["ahrs"].samples > 20, what="samples")
            fill(small_disk / "hog")
            # The next flush, at most 0.25 s later, meets the full disk.
            wait_for(lambda: any("disk is full" in w for w in acquisition.status().warnings), 1.0, "the alarm")
            before = acquisition.status().ports["ahrs"].samples
            wait_for(lambda: acquisition.status().ports["ahrs"].samples > before + 30, what="more samples")
            (small_disk / "hog").unlink()
            wait_for(lambda: not acquisition.status().warnings, what="the end of the alarm")
            wait_for(lambda: acquisition.status().ports["ahrs"].samples > before + 60, what="more samples")
            last = acquisition.status()
        final = acquisition.status()
    with open_log(small_disk / "log.mcap") as opened:
        assert opened.complete
        table = opened.table(Ahrs, "ahrs")
        assert len(table) == final.ports["ahrs"].samples >= last.ports["ahrs"].samples
        assert np.all(np.diff(np.round(1e3 * table["r"])) == 1)  # the boat numbers its samples: none is missing
        assert [kind for _, kind, _ in opened.events()].count("disk") == 1
        assert len(opened.paths) == 2


def test_the_watchdog_note_of_an_earlier_log_is_not_used_for_a_new_log(tmp_path: Path) -> None:
    path, out = tmp_path / "run.mcap", tmp_path / "whole.mcap"
    note_path(path).write_text("2026-05-01T12:00:00Z watchdog: the acquisition process died\n")
    note_path(out).write_text("2026-05-01T12:00:00Z watchdog: the acquisition process died\n")
    log = segmented(path)
    write(log, 20)
    log.close()
    recover_log(path, out)
    for file in (path, out):
        with open_log(file) as opened:
            assert opened.warnings == []
    note_path(path).write_text("2026-05-01T12:00:00Z watchdog: the acquisition process died\n")
    with open_log(path) as opened:  # of this log
        assert len(opened.warnings) == 1
    note_path(tmp_path / "other.mcap").write_text("mine")
    segmented(tmp_path / "other.mcap").close()
    assert note_path(tmp_path / "other.mcap").read_text() == "mine"


def test_a_named_pipe_is_neither_a_log_nor_a_note(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    os.mkfifo(path)
    with pytest.raises(SeatrialError, match="is not a file"):
        open_log(path)
    path.unlink()
    segmented(path).close()
    os.mkfifo(note_path(path))
    open_log(path).close()


def test_beyond_the_disk_budget_the_oldest_segments_except_the_first_are_deleted(tmp_path: Path) -> None:
    log = segmented(tmp_path / "run.mcap", megabytes=1.0, keep_gigabytes=0.004)
    (tmp_path / "other.1.mcap").write_bytes(bytes(10_000_000))  # not a segment of this log
    rng = np.random.default_rng(3)
    largest = 0
    for k in range(300):
        log.write_raw("ahrs", "rx", rng.bytes(50_000), T0 + k)
        log.tick()
        on_disk = sum(p.stat().st_size for p in tmp_path.glob("run*.mcap"))
        assert on_disk == log.size or k > 150
        largest = max(largest, on_disk)
        if k == 150:  # another file in place of a segment
            replaced = min(p for p in tmp_path.glob("run.*.mcap") if p != log.path)
            replaced.unlink()
            replaced.write_bytes(b"dear to me")
    log.close()
    assert largest < 4.2e6
    assert replaced.read_bytes() == b"dear to me"
    replaced.unlink()
    names = sorted((p.name for p in tmp_path.glob("run*.mcap")), key=lambda name: (len(name), name))
    assert names[0] == "run.mcap"
    assert 3 <= len(names) <= 4
    with open_log(tmp_path / "run.mcap") as opened:
        times = [round(t - T0) for t, _, _ in opened.raw("ahrs")]
        missing = f"a segment is missing: run.1.mcap to run.{len(names_of(opened)) - 1}.mcap"
        assert opened.warnings == [f"{missing}; copy it into the folder of run.mcap, if you have it"]
        deleted = [text for _, kind, text in opened.events() if kind == "disk"]
    second = next(k for k, (a, b) in enumerate(pairwise(times)) if b != a + 1) + 1
    assert times == [*range(second), *range(times[second], 300)]
    assert all(text.endswith(", because the log is larger than keep_gb = 0.004") for text in deleted)


def names_of(log: Log) -> range:
    """Return the numbers of the segments before the second existing segment."""
    return range(int(log.paths[1].stem.rpartition(".")[2]))
