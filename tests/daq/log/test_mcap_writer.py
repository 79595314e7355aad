"""Tests of our record writer against mcap's own writer: the same calls give the same bytes."""

from __future__ import annotations

import random
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from seatrial.daq.log.mcap_reader import RawLog
from seatrial.daq.log.mcap_writer import RecordWriter

Message = tuple[int, int, bytes, int, int]  # channel, log time, data, publish time, sequence
CHUNK_BYTES = 4096


def some_messages(count: int, seed: int) -> list[Message]:
    """Return messages of three channels with any length and unordered times.

    The first messages come in the order of the channels.
    """
    rng = random.Random(seed)
    channels = [1, 2, 3, *rng.choices((1, 2, 3), k=count - 3)]
    return [
        (channel, rng.randrange(2**62), rng.randbytes(rng.choice((0, 1, 40, 500))), rng.randrange(2**62), k)
        for k, channel in enumerate(channels)
    ]


def write(writer: Any, parts: list[list[Message]]) -> None:
    """Make the same calls on our writer or mcap's writer, with a flush after each part."""
    writer.add_metadata("about", {"boat": "medusa", "operator": "Ada"})
    writer.add_attachment(5, 6, "rig.toml", "application/toml", b"name = 1\n")
    schemas = [writer.register_schema(f"test/msg/{name}", "ros2msg", b"float64 x") for name in "AB"]
    for k, topic in enumerate(("/a", "/b", "/c")):
        writer.register_channel(topic, "cdr", schemas[k % 2], {"unit": "N"})
    for part in parts:
        for message in part:
            writer.add_message(*message)
        writer.flush()
    writer.finish()


def write_ours(parts: list[list[Message]]) -> bytes:
    """Write a file with our writer."""
    stream = BytesIO()
    write(RecordWriter(stream, chunk_bytes=CHUNK_BYTES, profile="ros2", library="seatrial"), parts)
    return stream.getvalue()


def write_theirs(parts: list[list[Message]]) -> bytes:
    """Write the same file with mcap's own writer."""
    stream = BytesIO()
    writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
    writer.start(profile="ros2", library="seatrial")
    write(writer, parts)
    return stream.getvalue()


def test_the_bytes_equal_the_output_of_the_mcap_library() -> None:
    # mcap writes its indexes in the order of appearance, so the first messages come in the order of the channels.
    parts = [some_messages(3, seed=0), some_messages(9, seed=1)]
    ours = write_ours(parts)
    assert ours == write_theirs(parts)


def test_every_message_is_found_by_index_and_by_time() -> None:
    messages = some_messages(400, seed=3)
    data = write_ours([messages[:150], [], messages[150:]])
    theirs = make_reader(BytesIO(data), validate_crcs=True)
    found = list(theirs.iter_messages(log_time_order=False))
    assert [(m.channel_id, m.log_time, m.data, m.publish_time, m.sequence) for _, _, m in found] == messages
    in_time = [m.log_time for _, _, m in make_reader(BytesIO(data)).iter_messages()]
    assert in_time == sorted(message[1] for message in messages)
    of_b = [m.sequence for _, _, m in make_reader(BytesIO(data)).iter_messages(topics=["/b"], log_time_order=False)]
    assert of_b == [message[4] for message in messages if message[0] == 2]
    summary = theirs.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 400
    assert summary.statistics.channel_message_counts == {k: sum(m[0] == k for m in messages) for k in (1, 2, 3)}
    assert summary.statistics.message_start_time == min(message[1] for message in messages)
    assert summary.statistics.message_end_time == max(message[1] for message in messages)
    assert len(summary.chunk_indexes) > 10
    assert all(index.uncompressed_size < CHUNK_BYTES + 600 for index in summary.chunk_indexes)


def test_a_file_without_messages_can_be_opened(tmp_path: Path) -> None:
    path = tmp_path / "none.mcap"
    path.write_bytes(write_ours([]))
    summary = make_reader(BytesIO(path.read_bytes()), validate_crcs=True).get_summary()
    assert summary is not None
    assert [channel.topic for channel in summary.channels.values()] == ["/a", "/b", "/c"]
    log = RawLog(path)
    assert (log.complete, log.warnings, log.counts) == (True, [], {})


@pytest.mark.parametrize("cut", [0.3, 0.6, 0.95])
def test_a_truncated_chunk_does_not_affect_other_chunks(tmp_path: Path, cut: float) -> None:
    messages = some_messages(300, seed=4)
    data = write_ours([messages])
    path = tmp_path / "cut.mcap"
    path.write_bytes(data[: round(cut * len(data))])
    log = RawLog(path)
    n_whole = log.counts.total()
    assert 0 < n_whole <= 300
    assert [n for found in log.read() for n in found.heads["sequence"].tolist()] == list(range(n_whole))
    assert cut * 300 - n_whole < 60


def test_an_error_of_the_stream_is_raised() -> None:
    class Full(BytesIO):
        def write(self, data: object, /) -> int:
            if self.tell() > 100:
                raise OSError(28, "No space left on device")
            return super().write(data)  # type: ignore[arg-type]

    writer = RecordWriter(Full(), chunk_bytes=1, profile="", library="")
    writer.add_message(writer.register_channel("/a", "cdr", 0, {}), 1, bytes(500), 1, 1)
    with pytest.raises(OSError, match="No space"):
        writer.add_message(1, 2, bytes(500), 2, 2)
