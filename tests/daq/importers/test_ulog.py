"""Tests of the import of PX4 logs, written here by their specification: attitude, fixes, signals and times."""

from __future__ import annotations

import math
import struct
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.guess import guess_map
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.importers.table import SourceOptions
from seatrial.daq.importers.ulog import read_ulog, whole_records
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Scalar
from tests.daq.ulog_files import Topic, message, needs_pyulog, write_ulog

UTC = 1_700_000_000.0
BOOT = 5.0  # time of the first message on the autopilot's clock [s]
N = 30
FORMATS = {
    "vehicle_attitude": ("float[4] q", "4f"),
    "vehicle_angular_velocity": ("float[3] xyz", "3f"),
    "sensor_gps": (
        "uint64_t time_utc_usec;double latitude_deg;double longitude_deg;double altitude_msl_m;"
        "float vel_n_m_s;float vel_e_m_s;float vel_d_m_s;float hdop;float eph;uint8_t fix_type;uint8_t satellites_used",
        "Q3d5f2B",
    ),
    "battery_status": ("float voltage_v", "f"),
}  # fmt: skip


def flight(path: Path) -> None:
    """Write attitude, rates, fixes and a battery at 10 Hz."""
    t, yaw, k = BOOT + 0.1 * np.arange(N), 1.0, np.arange(N)
    one, zero = np.ones(N), np.zeros(N)
    fixes = (1e6 * (UTC + 0.1 * k), 41.0 * one, -8.0 * one, 3.0 * one, 0.5 * one, 0.25 * one, 0.125 * one, 0.9 * one)
    rows = {
        "vehicle_attitude": np.stack([math.cos(yaw / 2) * one, zero, zero, math.sin(yaw / 2) * one], 1),
        "vehicle_angular_velocity": np.stack([0.01 * one, 0.02 * one, 0.001 * k], 1),
        "sensor_gps": np.stack([*fixes, 1.4142135 * one, 6 * one, 17 * one], 1),
        "battery_status": (16.0 - 0.01 * k)[:, None],
    }
    write_ulog(path, {name: Topic(*FORMATS[name], t, found) for name, found in rows.items()}, BOOT)


@needs_pyulog
def test_a_px4_log_is_imported_by_its_guess(tmp_path: Path) -> None:
    flight(tmp_path / "flight.ulg")
    guess = guess_map(tmp_path / "flight.ulg")
    assert "no commands" in guess.problem
    (tmp_path / "map.toml").write_text(guess.text)
    (path,) = import_files(tmp_path / "map.toml", [tmp_path / "flight.ulg"], out=tmp_path / "flight.mcap")
    with open_log(path) as log:
        table = {name: log.table(Scalar, name) for name in log.sources(Scalar)}
    assert set(table) == {"x", "y", "vx", "vy", "psi", "r"}
    np.testing.assert_allclose(table["psi"]["t"], UTC + 0.1 * np.arange(N), atol=1e-6)
    np.testing.assert_allclose(table["psi"]["value"], 1.0, atol=1e-6)
    np.testing.assert_allclose(table["r"]["value"], 0.001 * np.arange(N), atol=1e-9)
    assert (table["vx"]["value"][0], table["vy"]["value"][0]) == (0.5, 0.25)
    np.testing.assert_allclose(table["x"]["value"], 0.0, atol=1e-9)


@needs_pyulog
def test_a_topic_without_times_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "flight.ulg"
    flight(path)
    path.write_bytes(path.read_bytes().replace(b"uint64_t timestamp;float[4] q", b"uint64_t timestamq;float[4] q"))
    assert "vehicle_attitude" not in guess_map(path).text


@needs_pyulog
def test_a_file_that_makes_the_reader_loop_gives_a_one_line_error(tmp_path: Path) -> None:
    path = tmp_path / "loop.ulg"
    path.write_bytes(b"ULog\x01\x12\x35\x01" + bytes(8) + b"\xff\xffD" * 30_000)  # the last formats end beyond the file
    with pytest.raises(SeatrialError, match="too much of the file is damaged"):
        guess_map(path)


@needs_pyulog
def test_a_damaged_ulog_gives_a_one_line_error(tmp_path: Path) -> None:
    (tmp_path / "x.ulg").write_bytes(b"ULog\x01\x12\x35")
    with pytest.raises(SeatrialError, match=r"x\.ulg: cannot be read as a PX4 log"):
        guess_map(tmp_path / "x.ulg")


def test_missing_library_gives_a_one_line_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyulog", None)
    flight(tmp_path / "flight.ulg")
    with pytest.raises(SeatrialError, match=r"pip install 'seatrial\[ulog\]'"):
        guess_map(tmp_path / "flight.ulg")


def test_a_torn_record_does_not_affect_other_records() -> None:
    def record(kind: bytes, data: bytes) -> bytes:
        return struct.pack("<HB", len(data), kind[0]) + data

    def sample(k: int) -> bytes:
        return record(b"D", struct.pack("<HQf", 0, 1000 * k, float(k)))

    head = b"ULog\x01\x12\x35\x01" + bytes(8)
    head += record(b"F", b"speed:uint64_t timestamp;float v;") + record(b"A", b"\0" + struct.pack("<H", 0) + b"speed")
    samples = [sample(k) for k in range(400)]
    assert whole_records(head + b"".join(samples)) == (None, 0)
    # The log continues in the middle of another record, because bytes of a block are lost.
    torn = head + b"".join(samples[:100]) + samples[100][:9] + samples[200][5:] + b"".join(samples[201:])
    found, n_torn = whole_records(torn)
    assert n_torn == 1
    assert found == head + b"".join(samples[:100] + samples[201:])
    hole = head + b"".join(samples[:100]) + bytes(512) + b"".join(samples[150:])
    # It is unknown whether the record before the hole is whole, so it is left out.
    assert whole_records(hole) == (head + b"".join(samples[:99] + samples[150:]), 1)
    assert whole_records(head + b"".join(samples)[:-7]) == (None, 0)  # cut off: each remaining record is valid


def test_a_torn_log_is_reported(tmp_path: Path) -> None:
    flight(tmp_path / "run.ulg")
    whole = (tmp_path / "run.ulg").read_bytes()
    n = len(whole) // 2
    (tmp_path / "torn.ulg").write_bytes(whole[:n] + whole[n + 331 :])
    tables = read_ulog(tmp_path / "torn.ulg", SourceOptions())
    assert tables
    assert {table.remark for table in tables} == {"1 damaged place: the records there are left out"}


@needs_pyulog
@pytest.mark.parametrize("kind", ["nested", "wide", "in itself"])
def test_formats_that_multiply_are_refused_at_once(tmp_path: Path, kind: str) -> None:
    """In an earlier version, some kilobytes of nested formats took gigabytes and minutes."""
    formats = {
        "nested": [*(f"a{k}:a{k + 1}[250] x;" for k in range(9)), "a9:float[250] x;"],
        "wide": ["a0:uint64_t timestamp;" + "".join(f"float[99] f{k};" for k in range(3000))],
        "in itself": ["a0:uint64_t timestamp;a0 x;"],
    }[kind]
    out = b"ULog\x01\x12\x35\x01" + bytes(8) + b"".join(message(b"F", text.encode()) for text in formats)
    (tmp_path / "run.ulg").write_bytes(out + message(b"A", struct.pack("<BH", 0, 0) + b"a0"))
    before = time.process_time()
    with pytest.raises(SeatrialError, match="its formats define more than 200000 columns"):
        read_ulog(tmp_path / "run.ulg", SourceOptions())
    assert time.process_time() - before < 2.0
