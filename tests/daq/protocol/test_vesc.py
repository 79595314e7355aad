"""Tests of VESC on CAN and of slcan: frames of a real controller, frames made by hand, and damaged lines."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from seatrial.daq.protocol import slcan
from seatrial.daq.protocol.canframe import CAN_FRAME, pack_can, unpack_can
from seatrial.daq.protocol.vesc import STALE, Decoder, decode_command, encode_duty, encode_status
from seatrial.daq.samples import NAN, Esc
from tests.daq.streams import check_splits, counters, is_close
from tests.measured.data import measured

ESC = Esc(1, 1234.0, -3.0, 0.25, 15.9, 31.0)
RAW = b"".join(pack_can(*frame) for frame in encode_status(ESC, 7))
TWICE = RAW + RAW  # temperature and voltage of the first sample are repeated in the second


def make() -> Decoder:
    return Decoder({1: 7, 2: 5})


def test_status_1_is_read_as_in_the_manual() -> None:
    # erpm 0x00002108 = 8456 with 7 pole pairs; current 0xffe2 = -3.0 A; duty 0x00fa = 0.25
    data = bytes.fromhex("00002108ffe200fa")
    (frame,) = make().feed_frame(9 << 8 | 1, data, 3.0)
    assert is_close(frame.sample, Esc(1, 8456 / 7, -3.0, 0.25, NAN, NAN))
    assert frame.t_rx == 3.0


def test_status_4_and_5_are_added_to_the_next_status_1() -> None:
    decoder = make()
    assert decoder.feed_frame(16 << 8 | 1, bytes.fromhex("0136fe8400000000"), 1.0) == []  # 31.0 deg C; motor -38
    assert (
        decoder.feed_frame(27 << 8 | 1, bytes.fromhex("00000000009f"), 1.0) == []
    )  # 15.9 V; six bytes in older firmware
    (frame,) = decoder.feed_frame(9 << 8 | 1, bytes(8), 1.5)
    assert is_close(frame.sample, Esc(1, 0.0, 0.0, 0.0, 15.9, 31.0))
    (frame,) = decoder.feed_frame(9 << 8 | 1, bytes(8), 1.0 + STALE + 0.1)
    assert is_close(frame.sample, Esc(1, 0.0, 0.0, 0.0, NAN, NAN))
    (frame,) = decoder.feed_frame(9 << 8 | 2, bytes(8), 1.5)
    assert is_close(frame.sample, Esc(2, 0.0, 0.0, 0.0, NAN, NAN))


def test_rpm_and_duty_of_a_reversed_thruster_have_the_sign_of_its_commands() -> None:
    frames = Decoder({1: 7}, frozenset({1})).feed(RAW, 0.0)
    assert is_close(frames[0].sample, Esc(1, -1234.0, -3.0, -0.25, NAN, NAN))


def test_frames_of_other_nodes_and_other_packets_are_ignored() -> None:
    decoder = make()
    assert decoder.feed(pack_can(9 << 8 | 9, bytes(8)) + pack_can(99 << 8 | 1, bytes(8)), 0.0) == []
    assert decoder.feed(CAN_FRAME.pack(0x123, 8, bytes(8)), 0.0) == []  # an identifier of 11 bits
    assert decoder.other_nodes == {9: 1}
    assert decoder.unparsed_bytes == 0


def test_short_frames_and_impossible_lengths_are_unparsed() -> None:
    decoder = make()
    assert decoder.feed_frame(9 << 8 | 1, b"\0\0", 0.0) == []
    assert decoder.feed(CAN_FRAME.pack(0x8000_0901, 9, bytes(8)), 0.0) == []
    assert counters(decoder) == (0, 0, 32)


def test_splits() -> None:
    assert len(check_splits(make, TWICE)) == 2


@given(
    st.floats(-6000, 6000),
    st.floats(-200, 200),
    st.floats(-1, 1),
    st.floats(0, 60),
    st.floats(-30, 120),
    st.integers(1, 20),
)
@settings(max_examples=300, deadline=None)
def test_status_round_trip(
    rpm: float, current: float, duty: float, voltage: float, temperature: float, pairs: int
) -> None:
    sample = Esc(7, rpm, current, duty, voltage, temperature)
    decoder = Decoder({7: pairs})
    frames = [f for _ in range(2) for frame in encode_status(sample, pairs) for f in decoder.feed_frame(*frame, 0.0)]
    back = frames[1].sample
    assert isinstance(back, Esc)
    assert abs(back.rpm - rpm) <= 0.51 / pairs
    assert max(abs(back.current - current), abs(back.voltage - voltage), abs(back.temperature - temperature)) <= 0.0501
    assert abs(back.duty - duty) <= 0.000501


@given(st.integers(0, 255), st.floats(-1, 1))
@settings(max_examples=300, deadline=None)
def test_command_round_trip(node: int, n: float) -> None:
    found = decode_command(*encode_duty(node, n))
    assert found is not None
    assert found[0] == node
    assert abs(found[1] - n) <= 0.51e-5


def test_a_command_has_the_expected_bytes() -> None:
    assert encode_duty(3, 0.5) == (3, (50_000).to_bytes(4, "big"))
    assert encode_duty(3, -1.0) == (3, (-100_000).to_bytes(4, "big", signed=True))
    assert decode_command(9 << 8 | 3, bytes(8)) is None
    assert decode_command(3, b"\0") is None


@pytest.mark.parametrize("n", [1.01, -1.01, NAN, math.inf])
def test_commands_beyond_full_duty_are_refused(n: float) -> None:
    with pytest.raises(ValueError, match="between -1 and 1"):
        encode_duty(1, n)


@given(st.lists(st.binary(max_size=60)))
@settings(max_examples=500, deadline=None)
def test_random_bytes_raise_no_exception(pieces: list[bytes]) -> None:
    decoder = make()
    for piece in pieces:
        decoder.feed(piece, 0.0)
    assert decoder.unparsed_bytes <= sum(map(len, pieces))


@pytest.mark.measured
def test_frames_of_a_real_vesc_at_rest_are_read() -> None:
    text = measured("can/vesc_forum_frames.log").read_text()
    frames = [(int(name, 16), bytes.fromhex(data)) for name, data in re.findall(r"([0-9A-F]{8})#([0-9A-F]+)", text)]
    assert len(frames) == 5
    decoder = Decoder({4: 7})
    samples = [f.sample for frame in frames + frames for f in decoder.feed_frame(*frame, 0.0)]
    assert is_close(samples[0], Esc(4, 0.0, 0.0, 0.041, NAN, NAN))
    assert is_close(samples[1], Esc(4, 0.0, 0.0, 0.041, 23.9, 25.3))
    assert decoder.unparsed_bytes == 0


def test_slcan_lines_are_read_and_written() -> None:
    (frame,) = slcan.Decoder().feed(b"T00000901800002108FFE200FA\r", 0.0)
    assert unpack_can(frame) == (0x901, bytes.fromhex("00002108FFE200FA"))
    (stamped,) = slcan.Decoder().feed(b"T000009012ABCD1234\r", 0.0)
    assert unpack_can(stamped) == (0x901, b"\xab\xcd")
    (short,) = slcan.Decoder().feed(b"t1231ff\r", 0.0)
    assert unpack_can(short) is None
    assert slcan.encode(0x901, b"\xab\xcd") == b"T000009012ABCD\r"
    assert slcan.open_channel(500_000) == b"\rC\rS6\rO\r"
    with pytest.raises(ValueError, match="no bit rate 123"):
        slcan.open_channel(123)


@given(st.integers(0, 2**29 - 1), st.binary(max_size=8))
@settings(max_examples=300, deadline=None)
def test_slcan_round_trip(identifier: int, data: bytes) -> None:
    (frame,) = slcan.Decoder().feed(slcan.encode(identifier, data), 0.0)
    assert unpack_can(frame) == (identifier, data)


def test_slcan_splits_and_garbage() -> None:
    line = slcan.encode(0x901, bytes(range(8)))
    stream = b"\xff\xfe boot\r" + line + b"z\r\a" + line[:-4] + line + b"T0000\r" + line + b"T12"
    expected = slcan.Decoder()
    frames = expected.feed(stream, 0.0)
    assert len(frames) == 3
    assert expected.unparsed_bytes == len(b"\xff\xfe boot") + len(line) - 4 + 5
    for size in (1, 2, 5, 11):
        decoder = slcan.Decoder()
        pieces = [stream[i : i + size] for i in range(0, len(stream), size)]
        assert [frame for piece in pieces for frame in decoder.feed(piece, 0.0)] == frames
        assert decoder.unparsed_bytes == expected.unparsed_bytes


def test_an_slcan_line_without_one_character_gives_no_frame() -> None:
    line = slcan.encode(0x901, bytes(8))
    for at in range(len(line)):
        decoder = slcan.Decoder()
        frames = decoder.feed(line[:at] + line[at + 1 :] + line, 0.0)
        assert len(frames) == 1, at
        assert unpack_can(frames[0]) == (0x901, bytes(8))


@given(st.lists(st.one_of(st.binary(max_size=40), st.text("Tt0189ABF\r", max_size=40).map(str.encode))))
@settings(max_examples=500, deadline=None)
def test_random_bytes_to_slcan_raise_no_exception(pieces: list[bytes]) -> None:
    decoder = slcan.Decoder()
    for piece in pieces:
        for frame in decoder.feed(piece, 0.0):
            assert len(frame) == CAN_FRAME.size
    assert decoder.feed(b"\r" + slcan.encode(0x901, b""), 0.0)[-1] == pack_can(0x901, b"")
