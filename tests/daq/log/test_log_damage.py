"""Tests of truncated, damaged and hostile files: a log with the intact content, or an error of one line."""

from __future__ import annotations

import random
import struct
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import MCAP0_MAGIC

from seatrial.daq.errors import SeatrialError
from seatrial.daq.log.mcap_reader import RawLog
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Gnss
from tests.daq.logs import N_ROUNDS, T0, is_prefix, recorder, tables


@pytest.mark.parametrize("n_cuts", [25, pytest.param(60, marks=pytest.mark.study)])
def test_a_log_truncated_anywhere_keeps_its_beginning(whole: Path, tmp_path: Path, n_cuts: int) -> None:
    data, everything = whole.read_bytes(), tables(open_log(whole))
    rng = random.Random(1)
    before = 0
    for size in sorted([*range(0, 60, 7), *(rng.randrange(60, len(data)) for _ in range(n_cuts)), len(data) - 1]):
        path = tmp_path / "cut.mcap"
        path.write_bytes(data[:size])
        if size < len(MCAP0_MAGIC):
            with pytest.raises(SeatrialError, match=r"cut\.mcap: (not an MCAP log|the file is empty)"):
                open_log(path)
            continue
        with open_log(path) as log:
            assert log.warnings or log.complete
            assert is_prefix(tables(log), everything)
            n = sum(log.counts.values())
        assert n >= before  # a longer file never gives fewer samples
        before = n
    assert before == sum(len(rows) for rows in everything.values()) + sum(
        n
        for topic, n in open_log(whole).counts.items()
        if topic.endswith(("mag", "device_time", "fix", "wrench", "velocity"))
    )


@pytest.mark.parametrize("n_all", [50, pytest.param(150, marks=pytest.mark.study)])
def test_one_flipped_bit_causes_no_wrong_number(whole: Path, tmp_path: Path, n_all: int) -> None:
    """A flipped bit causes one line, or correct rows. It never causes a wrong number or a traceback."""
    data, everything = whole.read_bytes(), tables(open_log(whole))
    rng = random.Random(2)
    n_read = 0
    for _ in range(n_all):
        at = rng.randrange(len(data))
        path = tmp_path / "flip.mcap"
        path.write_bytes(data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :])
        try:
            with open_log(path) as log:
                found = tables(log)
        except SeatrialError:
            continue
        n_read += 1
        for name, rows in found.items():
            known = {repr(row) for row in everything[name]}
            # a sample may lose a companion message (device time, field) in the chunk before
            assert all(repr(row) in known for row in rows), (at, name)
    assert n_read > 0.9 * n_all


@pytest.mark.parametrize("n_trials", [60, pytest.param(160, marks=pytest.mark.study)])
def test_random_damage_gives_a_one_line_error_or_a_readable_log(whole: Path, tmp_path: Path, n_trials: int) -> None:
    data, path, everything = whole.read_bytes(), tmp_path / "damaged.mcap", repr(tables(open_log(whole)))
    rng = random.Random(3)
    for k in range(n_trials):
        at, length = rng.randrange(8, len(data)), rng.randrange(1, 400)
        target = rng.randrange(8, len(data))
        middle = [
            b"",
            rng.randbytes(length) + data[at : at + length],
            rng.randbytes(length),
            data[target : target + length],
        ]
        path.write_bytes(data[:at] + middle[k % 4] + data[at + length :])
        found = ""
        try:
            with open_log(path) as log:
                lines = log.warnings
                found = repr(tables(log))
                _ = log.rig
        except SeatrialError as error:
            lines = [str(error)]
        assert lines or found == everything, (k, at)  # damage to data that the file contains twice may go unreported
        assert not any("\n" in line for line in lines)


def test_a_damaged_chunk_does_not_affect_other_chunks(whole: Path, tmp_path: Path) -> None:
    raw = RawLog(whole)
    at = raw._chunks[N_ROUNDS // 2]
    data = bytearray(whole.read_bytes())
    data[(at["at"] + at["stop"]) // 2] ^= 0xFF
    (tmp_path / "hole.mcap").write_bytes(data)
    log = open_log(tmp_path / "hole.mcap")
    assert len(log.table(Gnss, "gnss")) == 2 * (N_ROUNDS - 1)
    assert [("damaged and left out" in warning) for warning in log.warnings] == [True]


def test_a_wrong_length_does_not_affect_other_chunks(whole: Path, tmp_path: Path) -> None:
    record = int(RawLog(whole)._chunks[N_ROUNDS // 2]["at"])
    data = bytearray(whole.read_bytes())
    for wrong in (2**50, 0):
        struct.pack_into("<Q", data, record + 1, wrong)
        (tmp_path / "hole.mcap").write_bytes(data)
        log = open_log(tmp_path / "hole.mcap")
        assert len(log.table(Gnss, "gnss")) == 2 * (N_ROUNDS - 1)
        assert log.warnings
    (tmp_path / "hole.mcap").write_bytes(data[:-100])  # and without the footer
    assert len(open_log(tmp_path / "hole.mcap").table(Gnss, "gnss")) == 2 * (N_ROUNDS - 1)


def test_part_of_a_cut_chunk_is_used(tmp_path: Path) -> None:
    path = tmp_path / "big.mcap"
    log = recorder(path)
    rng = np.random.default_rng(5)
    for i in range(250):
        log.write_raw("ahrs", "rx", rng.bytes(1000), T0 + i)
    log.close()
    at = RawLog(path)._chunks[0]
    data = path.read_bytes()
    expected = list(open_log(path).raw("ahrs"))
    path.write_bytes(data[: at["at"] + (at["stop"] - at["at"]) * 3 // 4])
    found = list(open_log(path).raw("ahrs"))
    assert 100 < len(found) < 250
    assert found == expected[: len(found)]


@pytest.mark.parametrize(
    "content",
    [b"", b"\x89MCA", b"PK\x03\x04" * 100, b"time,x\n1,2\n", b"\0" * 4096],
    ids=["0", "4", "zip", "csv", "zeros"],
)
def test_a_file_that_is_not_a_log_gives_a_one_line_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "what.mcap"
    path.write_bytes(content)
    with pytest.raises(SeatrialError, match=r"what\.mcap: (not an MCAP log|the file is empty)"):
        open_log(path)
    with pytest.raises(SeatrialError, match="cannot be read: No such file"):
        open_log(tmp_path / "none.mcap")


def chunk_record(packed: bytes, size: int, compression: bytes = b"zstd", checksum: int = 0) -> bytes:
    head = struct.pack("<QQQII", 0, 0, size, checksum, len(compression)) + compression
    content = head + struct.pack("<Q", len(packed)) + packed
    return struct.pack("<BQ", 6, len(content)) + content


HOSTILE = {
    "record of 2^60 bytes": struct.pack("<BQ", 5, 2**60),
    "record of 2^64 - 1 bytes": struct.pack("<BQ", 5, 2**64 - 1),
    "chunk of stated length 2^62": chunk_record(zstandard.compress(b"x" * 100), 2**62),
    "bomb with a small stated length": chunk_record(zstandard.compress(bytes(200 * 2**20)), 100),
    "frame of stated length 2^40": chunk_record(
        b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", 2**40) + b"\x01\0\0", 2**40 % 2**26
    ),
    "message of no length": chunk_record(struct.pack("<BQ", 5, 3) + b"abc", 12, b""),
    "name of 4 GB": struct.pack("<BQ", 4, 12) + struct.pack("<HHII", 1, 1, 2**32 - 1, 0),
    "metadata that goes on": struct.pack("<BQ", 12, 12) + struct.pack("<III", 0, 2**32 - 1, 2**31),
    "zeros": b"\0" * 500,
    "index of nothing": struct.pack("<BQ", 7, 22) + struct.pack("<HIQQ", 1, 16, 5, 2**63),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_lengths_take_no_memory(whole: Path, tmp_path: Path, name: str) -> None:
    import resource

    data = whole.read_bytes()
    end = RawLog(whole)._chunks[0]["stop"]
    path = tmp_path / "hostile.mcap"
    path.write_bytes(data[:end] + HOSTILE[name] + data[end:])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    log = open_log(path)
    assert repr(tables(log)) == repr(tables(open_log(whole)))  # the intact part after the damage is found again
    assert log.complete
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 150_000  # kB


def test_a_bomb_of_small_messages_takes_no_memory(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file of some kilobytes declares thirty million messages.

    Messages up to the limit are read, and the rest is left out.
    """
    import resource

    monkeypatch.setattr("seatrial.daq.log.mcap_reader.FEW_MESSAGES", 200_000)
    data, end = whole.read_bytes(), RawLog(whole)._chunks[-1]["stop"]
    record = struct.pack("<BQHIQQ", 5, 22, 60_000, 0, 10**9, 10**9)
    bomb = chunk_record(zstandard.compress(record * 300_000), len(record) * 300_000)
    path = tmp_path / "bomb.mcap"
    path.write_bytes(data[:end] + bomb * 100 + data[end:])
    assert path.stat().st_size < 300_000
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with open_log(path) as log:
        assert any("than a real log of its size has" in warning for warning in log.warnings)
        assert repr(tables(log)) == repr(tables(open_log(whole)))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000  # kB; all messages would need 1.4 GB
