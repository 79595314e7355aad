"""Tests of logs from other programs: their compression and index, and invalid messages."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import schema
from seatrial.daq.log.cdr import cdr_layout, full_definition
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import NAN, Frame, Gnss, Scalar

T = 1.7e9


def write_with(path: Path, **options: object) -> None:
    """Write a log of 5 scalars with mcap's own writer."""
    with path.open("wb") as file:
        writer = Writer(file, **options)  # type: ignore[arg-type]
        writer.start(profile="ros2")
        name = schema.TYPES[Scalar]
        channel = writer.register_channel(
            "/signal/x", "cdr", writer.register_schema(name, "ros2msg", full_definition(name).encode())
        )
        for i in range(5):
            stamp = (10 + i) * 10**9
            # frame ids of two lengths on one channel, which another program might write
            data = cdr_layout(name, b"ab" if i % 2 else b"abcdefghijk").pack(stamp, 1.0, 2.0, float(i))
            writer.add_message(channel, stamp, data, stamp)
        writer.finish()


@pytest.mark.parametrize(
    "options",
    [
        {"use_chunking": False},
        {"compression": CompressionType.NONE},
        {"compression": CompressionType.LZ4},
        {"compression": CompressionType.ZSTD, "chunk_size": 10},
        {"index_types": 0, "use_statistics": False, "repeat_channels": False},
    ],
    ids=["unchunked", "plain", "lz4", "zstd", "no index"],
)
def test_logs_of_other_writers_are_read(tmp_path: Path, options: dict[str, object]) -> None:
    if "index_types" in options:
        from mcap.writer import IndexType

        options = {**options, "index_types": IndexType.NONE}
    write_with(tmp_path / "other.mcap", **options)
    log = open_log(tmp_path / "other.mcap")
    assert (log.complete, log.warnings) == (True, [])
    table = log.table(Scalar, "x")
    assert table["value"].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert table["t"].tolist() == [10.0, 11.0, 12.0, 13.0, 14.0]
    assert log.rig is None


def test_a_log_without_a_speed_field_gets_the_speed_of_its_velocity(tmp_path: Path) -> None:
    name, added = schema.TYPES[Gnss], schema.ADDED[schema.TYPES[Gnss]]
    now = full_definition(name)
    before = "".join(line for line in now.splitlines(True) if not any(f" {field} " in line for field in added))
    fixes = [Gnss(T, 41.0, -8.0, 5.0, 3.0, 4.0, NAN, 3, 9), Gnss(T, 41.0, -8.0, fix=5)]
    for old in (True, False):
        path, n = tmp_path / f"{old}.mcap", -len(added) if old else None
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start(profile="ros2")
            kind = writer.register_schema(name, "ros2msg", (before if old else now).encode())
            channel = writer.register_channel("/g/gnss", "cdr", kind)
            for k, fix in enumerate(fixes):
                (message, *_) = schema.messages("g", Frame(fix, T, T))
                layout = cdr_layout(name, b"g" * (k + 1), added if old else ())
                writer.add_message(channel, k, layout.pack(k, *message.values[:n]), k)
            writer.finish()
        with open_log(path) as log:
            table = log.table(Gnss, "g")
        assert table["speed"][0] == 5.0
        assert np.isnan(table["speed"][1])
        assert table["dimensions"].tolist() == [3, -1]
        assert table["sigma_h"].size == 2


def break_messages(data: bytes) -> bytes:
    return b"\x00\x00\x00\x00" + data[4:]


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (break_messages, r"cannot be decoded as seatrial_msgs/msg/Scalar \(little-endian CDR\): it is damaged"),
        (lambda data: data[:20], "cannot be decoded as seatrial_msgs/msg/Scalar"),
        (lambda data: data[:8], "cannot be decoded as seatrial_msgs/msg/Scalar"),
        (lambda data: data[:12] + b"\xff\xff\xff\xff" + data[16:], "cannot be decoded as seatrial_msgs/msg/Scalar"),
        (lambda data: data[:12] + b"\0\0\0\0" + data[16:], "cannot be decoded as seatrial_msgs/msg/Scalar"),
    ],
)
def test_invalid_messages_are_refused(tmp_path: Path, change: Callable[[bytes], bytes], line: str) -> None:
    path = tmp_path / "odd.mcap"
    name = schema.TYPES[Scalar]
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        channel = writer.register_channel("/signal/x", "cdr", writer.register_schema(name, "ros2msg", b"float64 x"))
        data = cdr_layout(name, b"x").pack(10**9, 1.0, 2.0, 3.0)
        writer.add_message(channel, 1, change(data), 1)
        writer.finish()
    with pytest.raises(SeatrialError, match=line):
        open_log(path).table(Scalar, "x")


def test_a_topic_of_another_type_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "odd.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        channel = writer.register_channel("/signal/x", "json", writer.register_schema("Thing", "jsonschema", b"{}"))
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(
        SeatrialError, match=r"/signal/x: the message type is Thing \(json\), not seatrial_msgs/msg/Scalar \(cdr\)"
    ):
        open_log(path).table(Scalar, "x")
