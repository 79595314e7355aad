"""Tests of the reader of logs and of the command `info`. `test_log_damage` tests damaged logs."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import time
import zlib
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import zstandard
from click.testing import CliRunner

from seatrial.daq import cli
from seatrial.daq.checks.device_checks import check_devices
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log.cdr import NANO, cdr_layout
from seatrial.daq.log.mcap_chunk import MAX_CHUNK_BYTES, scan
from seatrial.daq.log.mcap_reader import RawLog
from seatrial.daq.log.mcap_writer import LogWriter
from seatrial.daq.log.reader import open_log
from seatrial.daq.log.schema import TYPES, topic
from seatrial.daq.log.segments import segment_path
from seatrial.daq.log.watchdog_note import note_path
from seatrial.daq.samples import Ahrs, Command, Esc, Frame, Gnss, LoadCell, PortHealth, Scalar
from tests.daq.logs import HEALTH, N_ROUNDS, T0, is_prefix, recorder, tables, write_everything


def test_open_log_returns_the_content_of_a_complete_log(whole: Path) -> None:
    log = open_log(whole)
    assert (log.complete, log.warnings) == (True, [])
    assert log.sources(Ahrs) == ["ahrs", "imu"]
    assert log.sources(Gnss) == ["gnss"]
    assert log.sources(Esc) == log.sources(Command) == ["esc"]
    assert (log.nodes(Esc, "esc"), log.nodes(Command, "esc")) == ([1, 2], [1])
    assert log.sources(LoadCell) == ["loadcell"]
    assert log.sources(Scalar) == ["surge"]
    assert log.sources(PortHealth) == ["ahrs"]
    assert log.duration == pytest.approx(N_ROUNDS - 1 + 0.7 - 0.001, abs=1e-6)
    assert log.events()[0] == (pytest.approx(T0 + 0.6), "mark", "round 0: Trondheimsfjorden, blåsende")
    assert [health for _, health in log.health("ahrs")] == [HEALTH] * N_ROUNDS
    raw = list(log.raw("ahrs"))
    assert [(direction, len(data)) for _, direction, data in raw] == [("rx", 256), ("tx", 0)] * N_ROUNDS
    assert len(log.sha256) == 64
    assert log.table(Command, "esc")["n_cmd"].tolist() == [-0.5] * N_ROUNDS
    assert log.table(Esc, "esc", node=2)["rpm"].tolist() == [77.0] * N_ROUNDS


def test_a_missing_topic_or_node_gives_an_error(whole: Path) -> None:
    log = open_log(whole)
    with pytest.raises(SeatrialError, match=r"no messages on /gps/gnss; use a topic that has messages: .*/gnss/gnss"):
        log.table(Gnss, "gps")
    with pytest.raises(SeatrialError, match=r"device esc has several nodes, \[1, 2\]: give one of them"):
        log.table(Esc, "esc")
    with pytest.raises(SeatrialError, match="no messages on /signal/sway"):
        log.unit("sway")


def test_time_never_decreases(tmp_path: Path) -> None:
    log = recorder(tmp_path / "a.mcap")
    for k, t in enumerate((0.0, 0.2, 0.1, 0.3)):
        log.write("surge", Frame(Scalar(k), T0 + 1.0, float("nan")), T0 + t)
    log.close()
    table = open_log(tmp_path / "a.mcap").table(Scalar, "surge")
    np.testing.assert_allclose(table["t"] - T0, [0.0, 0.2, 0.2, 0.3], atol=1e-6)
    assert table["value"].tolist() == [0.0, 1.0, 2.0, 3.0]


def test_salvage_makes_a_complete_file(whole: Path, tmp_path: Path) -> None:
    data = whole.read_bytes()
    killed, out = tmp_path / "killed.mcap", tmp_path / "whole.mcap"
    killed.write_bytes(data[: len(data) * 2 // 3])
    done = CliRunner().invoke(cli.recover, [str(killed), "-o", str(out)], catch_exceptions=False)
    assert done.exit_code == 0
    assert "cut off" in done.stderr
    again, before = open_log(out), open_log(killed)
    assert again.complete
    assert f"{out}: {sum(again.counts.values())} messages" in done.stdout
    assert repr(tables(again)) == repr(tables(before))
    assert (again.metadata, again.attachments) == (before.metadata, before.attachments)
    with pytest.raises(SeatrialError, match="the file exists already"):
        CliRunner().invoke(cli.recover, [str(killed), "-o", str(out)], catch_exceptions=False)
    with pytest.raises(SeatrialError, match="belongs to the log itself, which must not be changed"):
        CliRunner().invoke(cli.recover, [str(killed), "-o", str(killed), "--force"], catch_exceptions=False)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["killed.mcap", "whole.mcap"]


def test_info(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)  # the workers of pytest have it, and tables would be folded
    done = CliRunner().invoke(cli.info, [str(whole)], catch_exceptions=False)
    assert done.exit_code == 0
    for text in ("complete", "test rig", "Ada", "/gnss/gnss", "/dev/ttyUSB0", "mission.toml", "round 0: Trondheim"):
        assert text in done.stdout
    killed = tmp_path / "killed.mcap"
    killed.write_bytes(whole.read_bytes()[:-500])
    done = CliRunner().invoke(cli.info, [str(killed)], catch_exceptions=False)
    assert "cut off" in done.stdout
    assert "warning: the recording was cut off" in done.stdout


def test_info_of_many_events_shows_how_the_run_ended(tmp_path: Path) -> None:
    log = recorder(tmp_path / "run.mcap")
    for k in range(60):
        log.event(T0 + k, "segment", f"step {k}")
    log.event(T0 + 60.0, "stop", "force is 61.2 N, limit 60 N")
    log.close()
    out = CliRunner().invoke(cli.info, [str(tmp_path / "run.mcap")], catch_exceptions=False).stdout
    lines = out.splitlines()
    assert "step 0" in out
    assert lines[-1].endswith("stop  force is 61.2 N, limit 60 N")
    (gap,) = [line for line in lines if "left out" in line]
    shown = sum("segment  step" in line for line in lines)
    assert f"... {60 - shown} events left out" in gap


def test_info_prints_repeated_events_in_one_line(tmp_path: Path) -> None:
    log = recorder(tmp_path / "run.mcap")
    for k in range(30):
        log.event(T0 + k, "skipped", f"{k + 1} set-points")
    log.event(T0 + 30.0, "mark", "operator mark 1")
    log.event(T0 + 31.0, "skipped", "7 set-points")
    log.close()
    lines = CliRunner().invoke(cli.info, [str(tmp_path / "run.mcap")], catch_exceptions=False).stdout.splitlines()
    assert [line.split("  ")[-1] for line in lines[-3:]] == [
        "1 set-points (and 29 more until 29.000 s later)",
        "operator mark 1",
        "7 set-points",
    ]


def test_info_prints_singular_nouns_for_a_count_of_one(tmp_path: Path) -> None:
    log = recorder(tmp_path / "run.mcap", attachments={"note": b"1"})
    log.event(T0, "mark", "alone")
    log.close()
    out = CliRunner().invoke(cli.info, [str(tmp_path / "run.mcap")], catch_exceptions=False).stdout
    assert "1 message\n" in out
    assert all(words in out for words in ("longest", "gap [s]"))  # the head of a column, on two lines
    assert "note (1 byte)" in out


def test_a_wrong_message_index_does_not_change_the_table(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    log = recorder(path)
    for i in range(20):
        log.write("surge", Frame(Scalar(i), T0, float("nan")), T0 + i)
    log.close()
    data = bytearray(path.read_bytes())
    at = RawLog(path)._chunks[0]["stop"]
    assert data[at] == 7  # message index
    for wrong in (1, 2**40, 2**63 + 5):
        struct.pack_into("<Q", data, at + 9 + 6 + 8, wrong)
        path.write_bytes(data)
        assert open_log(path).table(Scalar, "surge")["value"].tolist() == list(range(20))


HOSTILE = "\x1b]0;owned\x07\x1b[2J [/bold] [red]x \u202egnp.exe \x9b31m"


def test_a_log_does_not_write_to_the_terminal(tmp_path: Path) -> None:
    """Escapes and markup of a foreign log are shown as they are spelled."""
    path = tmp_path / "run.mcap"
    log = recorder(path, attachments={HOSTILE: b"1"}, metadata={"operator": HOSTILE, HOSTILE: "x"})
    log.event(T0, HOSTILE, HOSTILE)
    log.write(HOSTILE.replace("/", "") + "[/]", Frame(Scalar(1.0), T0, float("nan")), T0)
    log.health(HOSTILE.replace("/", ""), replace(HEALTH, port=HOSTILE), T0)
    log.close()
    note_path(path).write_text(f"2026-05-01T12:00:00Z watchdog: {HOSTILE}")
    for words in ([str(path)],):
        out = CliRunner().invoke(cli.info, words, catch_exceptions=False).stdout
        assert "owned" in out
        assert not [c for c in out if not (c.isprintable() or c == "\n")]
    with open_log(path) as opened:
        assert not [c for _, kind, text in opened.events() for c in kind + text if not c.isprintable()]
    refused = CliRunner().invoke(cli.replay, [str(path), "--dir", str(tmp_path / "ports")])
    assert refused.exit_code == 1


def a_run(path: Path, n: int, kill: bool = False, chunk: int = 250) -> Path:
    """Record two AHRS at 1 kHz, the second only in the second half, with a new chunk every `chunk` samples."""
    log = recorder(path)
    for i in range(n):
        t = T0 + 1e-3 * i
        for device in ("ahrs", "imu")[: 1 + (2 * i >= n)]:
            log.write(device, Frame(Ahrs(0.1, 0.2, 0.3, r=float(i), mx=1e-5, my=0.0, mz=0.0), t, float(i)), t)
            if i % chunk == chunk // 2:
                log._writer.flush()
    if kill:
        log._writer.flush()
        log._writer._close_file()
    else:
        log.close()
    return path


@pytest.mark.parametrize("kill", [False, True])
def test_a_time_window_and_a_topic_are_read_without_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kill: bool
) -> None:
    path = a_run(tmp_path / "run.mcap", 4000, kill)
    read: list[int] = []
    pread = os.pread
    monkeypatch.setattr(os, "pread", lambda fd, n, at: read.append(n) or pread(fd, n, at))  # type: ignore[func-returns-value]
    log = open_log(path)
    opening = sum(read)
    read.clear()
    table = log.table(Ahrs, "ahrs", begin=T0 + 1.0, end=T0 + 1.5)
    assert table["r"].tolist() == list(range(1000, 1500))
    np.testing.assert_array_equal(table["t_device"], table["r"])  # joined across chunks
    assert sum(read) < 0.25 * path.stat().st_size
    read.clear()
    log.close()
    assert len(log.table(Ahrs, "imu")) == 2000
    assert sum(read) < 0.8 * path.stat().st_size
    assert opening < 0.25 * path.stat().st_size
    assert len(log.table(Ahrs, "ahrs", begin=T0 + 100.0)) == 0
    whole = open_log(path).table(Ahrs, "ahrs")
    assert repr(table.tolist()) == repr(whole[1000:1500].tolist())


def test_a_recording_that_was_cut_off_is_opened_by_its_indexes(tmp_path: Path) -> None:
    """After a cut at any byte, the counts of the log equal the number of readable messages."""
    data = a_run(tmp_path / "run.mcap", 600, chunk=40).read_bytes()
    path = tmp_path / "cut.mcap"
    for size in range(len(data) // 2, len(data), len(data) // 37):
        path.write_bytes(data[:size])
        with open_log(path) as log:
            assert len(log.table(Ahrs, "ahrs")) == log.counts["/ahrs/imu"]
            assert sum(log.counts.values()) == sum(len(found.heads) for found in log._file.read())


def test_an_incomplete_summary_does_not_hide_samples(tmp_path: Path) -> None:
    path = a_run(tmp_path / "run.mcap", 600)
    data = path.read_bytes()
    last = RawLog(path)._chunks[-1]
    record = data[last["at"] : last["stop"]]
    opcode, length, start, offsets, _ = struct.unpack("<BQQQI", data[-37:-8])
    footer = struct.pack("<BQQQ", opcode, length, start + len(record), offsets + len(record))
    checksum = struct.pack("<I", zlib.crc32(data[start:-37] + footer))
    path.write_bytes(data[: last["at"]] + record + data[last["at"] : -37] + footer + checksum + data[-8:])
    with open_log(path) as log:
        assert len(log.table(Ahrs, "imu")) > 300  # the chunk is there twice
        assert (log.complete, log.warnings) == (True, [])


def test_tables_read_together_equal_tables_read_separately(whole: Path, tmp_path: Path) -> None:
    """The logs are a complete log, a log with samples in several chunks, a cut log, and a log with a repeated chunk.

    Samples of the log with a repeated chunk are not joined.
    """
    joined = a_run(tmp_path / "run.mcap", 600, chunk=40)
    data = joined.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: 2 * len(data) // 3])
    last = RawLog(joined)._chunks[-1]
    (tmp_path / "twice.mcap").write_bytes(data[: last["stop"]] + data[last["at"] : last["stop"]])
    for path in (whole, joined, tmp_path / "cut.mcap", tmp_path / "twice.mcap"):
        with open_log(path) as log:
            one_by_one = tables(log)
        with open_log(path) as log, log.keeping_tables():
            assert repr(tables(log)) == repr(one_by_one), path
        with open_log(path) as log, log.part(T0 + 1.0, T0 + 2.0).keeping_tables():
            assert len(log.table(Ahrs, "ahrs")) == len(one_by_one["Ahrs ahrs"])


def test_an_invalid_topic_does_not_affect_tables_of_other_topics(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    log = LogWriter(path, metadata={}, attachments={}, time_ns=0)
    good, other, short = (log.channel(topic(Scalar, n), TYPES[Scalar]) for n in ("good", "short", "shorter"))
    wrong = log.channel(topic(Gnss, "gnss"), TYPES[Scalar])
    for k in range(5):
        data = cdr_layout(TYPES[Scalar], b"").pack(k * NANO, 0.0, 0.0, 1.0 * k)
        for channel, payload in ((good, data), (other, data[:20]), (short, b"\0"), (wrong, data)):
            log.add(channel, k * NANO, k * NANO, k + 1, payload)
    log.close()
    with open_log(path) as opened, opened.keeping_tables():
        assert opened.table(Scalar, "good")["value"].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
        for kind, name in ((Scalar, "short"), (Scalar, "shorter"), (Gnss, "gnss")):
            with pytest.raises(SeatrialError, match=topic(kind, name)):
                opened.table(kind, name)


MEASURE = """
import sys
from benchmarks.measure import peak_mb
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Scalar
before = peak_mb()
table = open_log(sys.argv[1]).table(Scalar, "surge")
print(len(table), table.nbytes, peak_mb() - before)
"""


def test_memory_of_reading_is_the_result_plus_24_bytes_per_message_and_48_mb(tmp_path: Path) -> None:
    n, n_topics = 300_000, 4
    log = LogWriter(tmp_path / "run.mcap", metadata={}, attachments={}, time_ns=0)
    pack = cdr_layout(TYPES[Scalar], b"").pack
    channels = [log.channel(topic(Scalar, name), TYPES[Scalar]) for name in ("surge", "sway", "heave", "yaw")]
    for i in range(n):
        stamp = round((T0 + 1e-3 * i) * NANO)
        for channel in channels:
            log.add(channel, stamp, stamp, i, pack(stamp, stamp / NANO, float("nan"), float(i)))
    log.close()
    words = [sys.executable, "-c", MEASURE, str(log.path)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    n_read, n_bytes, peak = done.stdout.split()
    assert int(n_read) == n
    assert float(peak) < (int(n_bytes) + 24 * n * n_topics) / 2**20 + 48


LIMITED = """
import resource, sys
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Ahrs
log = open_log(sys.argv[1])
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 4 * 2**20,) * 2)
try:
    log.table(Ahrs, "ahrs")
except Exception as error:
    print(type(error).__name__, error)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of the address space")
def test_a_memory_that_is_too_small_gives_a_one_line_error(tmp_path: Path) -> None:
    path = a_run(tmp_path / "run.mcap", 40_000)
    done = subprocess.run([sys.executable, "-c", LIMITED, str(path)], capture_output=True, text=True, check=True)
    assert done.stdout.startswith(f"SeatrialError {path}: /ahrs/imu has 40000 messages")
    assert done.stdout.count("\n") == 1


def test_records_beside_the_messages_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.mcap"
    log = recorder(path, attachments={"huge.bin": bytes(300_000), "small.txt": b"1"})
    log.event(T0, "mark", "x")
    log.close()
    assert set(open_log(path).attachments) == {"rig.toml", "huge.bin", "small.txt"}
    monkeypatch.setattr("seatrial.daq.log.mcap_reader.MAX_HELD_BYTES", 200_000)
    for data in (path.read_bytes(), path.read_bytes()[:-20]):
        path.write_bytes(data)
        with open_log(path) as opened:
            assert set(opened.attachments) == {"rig.toml", "small.txt"}
            assert any("attachment at byte" in warning for warning in opened.warnings)
            assert len(opened.events()) == 1


def test_a_name_of_megabytes_is_omitted(tmp_path: Path) -> None:
    """Formerly, the escapes of its control characters for the terminal took minutes."""
    path = tmp_path / "run.mcap"
    name = "\x1b" * 4_000_000
    log = recorder(path, attachments={name: b"1", "small.txt": b"1"}, metadata={"rig": name})
    log.event(T0, "mark", "x" * 4_000_000)
    log.close()
    before = time.process_time()
    with open_log(path) as opened:
        assert set(opened.attachments) == {"rig.toml", "small.txt"}
        assert any("left out (a name of 4000000 characters is too long)" in warning for warning in opened.warnings)
        output = CliRunner().invoke(cli.info, [str(path)]).output
    assert time.process_time() - before < 5.0
    assert len(output) < 20_000
    assert "\x1b" not in output


RECORD = struct.Struct("<BQ")


def record(opcode: int, content: bytes) -> bytes:
    return RECORD.pack(opcode, len(content)) + content


def test_millions_of_empty_records_of_applications_are_skipped_quickly(tmp_path: Path) -> None:
    """The file of 62 kB has ten chunks of seven million empty records. Formerly, the reader took more than a minute."""
    plain = record(0x80, b"") * (MAX_CHUNK_BYTES // RECORD.size)
    packed = zstandard.ZstdCompressor().compress(plain)
    head = struct.pack("<QQQII", 0, 9, len(plain), 0, 4) + b"zstd" + struct.pack("<Q", len(packed))
    header = record(1, struct.pack("<II", 0, 0))
    path = tmp_path / "run.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + header + record(6, head + packed) * 10)
    before = time.process_time()
    with open_log(path) as opened:
        assert opened.counts == {}
        assert any("the uncompressed chunks have 0.7 GB, 10" in warning for warning in opened.warnings)
    assert time.process_time() - before < 5.0


def test_messages_without_an_index_are_found_among_records_of_applications() -> None:
    """The limit on records of applications does not omit messages between these records."""
    message = record(5, struct.pack("<HIQQ", 1, 0, 1, 1) + b"x")
    plain = (record(0x80, b"") * 10 + message) * 20_000
    assert len(scan([(np.frombuffer(plain, np.uint8), b"")], lambda *_: None).heads) == 20_000


def test_many_segments_are_open_one_at_a_time(tmp_path: Path) -> None:
    for number in range(40):
        log = recorder(segment_path(tmp_path / "run.mcap", number) if number else tmp_path / "run.mcap")
        log.event(T0 + number, "mark", str(number))
        log.close()
    before = len(os.listdir("/proc/self/fd"))
    opened = open_log(tmp_path / "run.mcap")
    assert [text for _, _, text in opened.events()] == [str(number) for number in range(40)]
    assert len(os.listdir("/proc/self/fd")) <= before + 1


def test_times_that_run_back_are_reported_and_checked(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    log = recorder(path)
    for i in range(20):
        t = T0 + i + (100.0 if i % 2 else 0.0)
        log.write("surge", Frame(Scalar(i), T0 + i, float("nan")), t)
        log.write("sway", Frame(Scalar(i), T0 + i, float("nan")), T0 + i)
    log.close()
    with open_log(path) as opened:
        assert opened.clock_steps == {"/signal/surge": (9, pytest.approx(99.0))}
        assert [f.where for f in check_devices(opened) if f.code == "clock-ran-back"] == ["/signal/surge"]
    out = CliRunner().invoke(cli.info, [str(path)], catch_exceptions=False).stdout
    assert "/signal/surge: its times ran back 9 times, by up to 99.0 s" in out


@pytest.mark.parametrize("limits", [(float("nan"), T0 + 1.0), (T0, float("nan"))])
def test_an_interval_of_time_that_is_not_a_number_is_refused(tmp_path: Path, limits: tuple[float, float]) -> None:
    write_everything(tmp_path / "all.mcap", n_rounds=2)
    with open_log(tmp_path / "all.mcap") as log:
        with pytest.raises(SeatrialError, match=r"begin and end .* must be numbers"):
            log.part(*limits)
        with pytest.raises(SeatrialError, match=r"begin and end .* must be numbers"):
            log.table(Ahrs, "ahrs", begin=limits[0], end=limits[1])


@pytest.mark.parametrize("seed", range(3))
def test_a_growing_log_is_extended_after_any_number_of_bytes(tmp_path: Path, seed: int) -> None:
    """The file grows by random numbers of bytes, so that most looks end inside a record."""
    write_everything(tmp_path / "whole.mcap", N_ROUNDS)
    data, path = (tmp_path / "whole.mcap").read_bytes(), tmp_path / "run.mcap"
    ends = sorted(np.random.default_rng(seed).integers(100, len(data), 30).tolist())
    path.write_bytes(data[: ends[0]])
    with open_log(path, growing=True) as log, open_log(tmp_path / "whole.mcap") as whole:
        n_extended = 0
        for begin, end in pairwise([*ends, len(data)]):
            before = tables(log)
            with path.open("ab") as file:
                file.write(data[begin:end])
            n_extended += log.extend()
            assert is_prefix(before, tables(log))
        assert n_extended > 5
        assert log.complete
        assert not log.extend()
        assert log.warnings == []
        assert (log.counts, log.start, log.end) == (whole.counts, whole.start, whole.end)
        assert repr(tables(log)) == repr(tables(whole))


def test_a_log_that_is_not_opened_as_growing_is_not_extended(tmp_path: Path) -> None:
    write_everything(tmp_path / "whole.mcap", N_ROUNDS)
    data, path = (tmp_path / "whole.mcap").read_bytes(), tmp_path / "run.mcap"
    path.write_bytes(data[: len(data) // 2])
    with open_log(path) as log:
        counts = dict(log.counts)
        path.write_bytes(data)
        assert not log.extend()
        assert log.counts == counts
