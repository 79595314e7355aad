"""Tests of VectorNav: against the log of a VN-100, ArduPilot's simulated VN-300, and truncated or damaged streams."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from seatrial.daq.protocol.framing import crc16, sentence
from seatrial.daq.protocol.vectornav import SYNC, Decoder, encode_ascii, encode_binary, message_layout
from seatrial.daq.samples import NAN, Ahrs
from tests.daq.streams import check_garbage, check_splits, counters, is_close
from tests.measured.data import measured

AHRS = Ahrs(1.0, 0.1, -0.2, 0.01, 0.02, 0.03, 0.1, 0.2, -9.8, 2e-5, 1e-6, 4e-5)
angle = st.floats(-3.1, 3.1)
ahrs = st.builds(Ahrs, angle, st.floats(-1.5, 1.5), angle, *[st.floats(-9, 9)] * 6, *[st.floats(-1e-4, 1e-4)] * 3)


def binary(groups: int, words: list[int], payload: bytes) -> bytes:
    """Return a message with a correct CRC."""
    body = bytes([groups]) + struct.pack(f"<{len(words)}H", *words) + payload
    return bytes([SYNC]) + body + struct.pack(">H", crc16(body))


def test_a_line_of_a_real_vn100_is_read_in_the_units_of_its_manual() -> None:
    line = (
        b"$VNYMR,+100.949,-007.330,+000.715,-00.0049,-00.2449,+00.5397,-01.258,-00.100,-09.701,"
        b"-00.000018,+00.001122,-00.000551*69\r\n"
    )
    (frame,) = check_splits(Decoder, line)
    yaw, pitch, roll = map(math.radians, (100.949, -7.330, 0.715))
    mag = (-0.0049e-4, -0.2449e-4, 0.5397e-4)
    expected = Ahrs(yaw, pitch, roll, -18e-6, 1122e-6, -551e-6, -1.258, -0.1, -9.701, *mag)
    assert is_close(frame.sample, expected)
    assert frame.t_rx == 5.0
    assert math.isnan(frame.t_device)


def test_quaternion_and_imu_sentences_are_read() -> None:
    # 30 degrees of yaw, then 20 of pitch, then 10 of roll, as the product of three half-angle rotations.
    cy, sy, cp, sp, cr, sr = (f(math.radians(a / 2)) for a in (30, 20, 10) for f in (math.cos, math.sin))
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    quaternion = f"VNQMR,{x:+.9f},{y:+.9f},{z:+.9f},{w:+.9f},+00.1,+00.2,+00.3,+1,+2,-9,+0.1,+0.2,+0.3"
    imu = "VNIMU,-00.0350,+00.4222,-00.6643,-00.015,+00.019,+09.948,+00.002066,-00.008442,-00.044656,+20.7,+084.322"
    first, second = check_splits(Decoder, sentence(quaternion) + sentence(imu))
    yaw, pitch, roll = map(math.radians, (30, 20, 10))
    assert is_close(first.sample, Ahrs(yaw, pitch, roll, 0.1, 0.2, 0.3, 1, 2, -9, 1e-5, 2e-5, 3e-5), tolerance=1e-8)
    mag = (-0.0350e-4, 0.4222e-4, -0.6643e-4)
    expected = Ahrs(NAN, NAN, NAN, 0.002066, -0.008442, -0.044656, -0.015, 0.019, 9.948, *mag)
    assert is_close(second.sample, expected)


def test_sentences_may_carry_a_crc16() -> None:
    body = sentence("VNYPR,+010.000,+000.000,+000.000")[1:-5]
    decoder = Decoder()
    (frame,) = decoder.feed(b"$%b*%04X\r\n" % (body, crc16(body)), 0.0)
    assert isinstance(frame.sample, Ahrs)
    assert frame.sample.yaw == pytest.approx(math.radians(10))
    assert decoder.feed(b"$%b*%04X\r\n" % (body, crc16(body) ^ 1), 0.0) == []
    assert decoder.checksum_errors == 1


@pytest.mark.parametrize("words", ["+1,+2", "+1,+2,abc", "nan,nan,nan", "1_0,2,3", ""])
def test_a_sentence_with_a_right_checksum_and_wrong_fields_is_unparsed(words: str) -> None:
    decoder = Decoder()
    data = sentence("VNYPR," + words)
    assert decoder.feed(data, 0.0) == []
    assert counters(decoder) == (0, 0, len(data) - 2)


@given(ahrs, st.floats(0, 1e6))
@settings(max_examples=300, deadline=None)
def test_binary_round_trip(sample: Ahrs, t_device: float) -> None:
    (frame,) = Decoder().feed(encode_binary(sample, t_device), 2.0)
    assert is_close(frame.sample, sample, rel=1e-6, tolerance=1e-12)
    assert frame.t_device == pytest.approx(t_device, abs=1e-9)


@given(ahrs)
@settings(max_examples=300, deadline=None)
def test_ascii_round_trip_to_the_digits_that_the_device_sends(sample: Ahrs) -> None:
    (frame,) = Decoder().feed(encode_ascii(sample), 2.0)
    back = frame.sample
    assert isinstance(back, Ahrs)
    half = 0.5001
    for names, step in (
        (("yaw", "pitch", "roll"), math.radians(1e-3)),
        (("p", "q", "r"), 1e-6),
        (("ax", "ay", "az"), 1e-3),
        (("mx", "my", "mz"), 1e-8),
    ):
        for name in names:
            assert abs(getattr(back, name) - getattr(sample, name)) <= half * step


def test_a_binary_message_without_magnetometer_has_no_magnetic_field() -> None:
    (frame,) = Decoder().feed(encode_binary(Ahrs(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.8), 1.0), 0.0)
    assert isinstance(frame.sample, Ahrs)
    assert math.isnan(frame.sample.mx)
    assert not math.isnan(frame.sample.az)


def test_garbage_between_messages_is_skipped() -> None:
    messages = [encode_ascii(AHRS), encode_binary(AHRS, 1.0), encode_binary(AHRS, 2.0), encode_ascii(AHRS)]
    check_garbage(Decoder, messages, 4)


def test_a_flipped_bit_is_counted_and_removes_one_message() -> None:
    good = encode_binary(AHRS, 1.0)
    for at in range(1, len(good)):
        bad = bytearray(good)
        bad[at] ^= 0x10
        # A wrong length may make the decoder wait for more bytes, hence the valid messages after it.
        decoder = Decoder()
        frames = decoder.feed(bytes(bad) + 20 * good, 0.0)
        assert len(frames) == 20, at
        # Bytes that look like CR and LF are not counted.
        assert len(good) - 8 <= decoder.unparsed_bytes <= len(good)


def test_a_message_may_contain_any_fields_of_any_group() -> None:
    # Group 2 TimeStartup and TimeStatus, 3 Temp and Accel, 5 VpeStatus and Quaternion, 7 (GNSS 2) PosLla.
    payload = struct.pack("<QB", 3_000_000_000, 7) + struct.pack("<4f", 20.0, 1.0, 2.0, -9.0)
    payload += struct.pack("<H4f", 1, 0.0, 0.0, 0.0, 1.0) + bytes(24)
    message = binary(0b101_0110, [0x0201, 0x0210, 0x0005, 0x0020], payload)
    (frame,) = check_splits(Decoder, message)
    assert is_close(frame.sample, Ahrs(0.0, -0.0, 0.0, NAN, NAN, NAN, 1.0, 2.0, -9.0))
    assert frame.t_device == 3.0


def test_fields_that_are_not_in_the_manual_make_no_message() -> None:
    assert message_layout(b"\x02\x00\x04") is None  # group 2 has ten fields
    assert message_layout(b"\x01\x00\x00") is None  # no field requested
    decoder = Decoder()
    junk = binary(2, [0x0400], bytes(8))
    (frame,) = decoder.feed(junk + encode_binary(AHRS, 1.0), 0.0)
    assert is_close(frame.sample, AHRS, rel=1e-6)
    assert decoder.unparsed_bytes == len(junk)


@given(
    st.lists(st.one_of(st.binary(max_size=80), st.sampled_from([encode_binary(AHRS, 1.0), b"$VNYMR,", b"\xfa\x01"])))
)
@settings(max_examples=1000, deadline=None)
def test_random_bytes_raise_no_exception(pieces: list[bytes]) -> None:
    decoder = Decoder()
    for piece in pieces:
        decoder.feed(piece, 0.0)
    assert decoder.unparsed_bytes <= sum(map(len, pieces))
    decoder.feed(b"\n" * 3000, 0.0)  # longer than any message: the decoder waits for no more bytes
    assert decoder.feed(encode_binary(AHRS, 9.0), 0.0)[-1].t_device == 9.0


LOST = 78  # the parser of the logger itself left out this one of its 99 frames


@pytest.mark.measured
def test_the_log_of_a_real_vn100_is_decoded_as_its_logger_did() -> None:
    raw = measured("vectornav/F00294").read_bytes()
    text = measured("vectornav/parsed/F00294_B").read_text().splitlines()
    columns = [name.strip() for name in text[0].split(",") if name.strip()]
    rows = [
        dict(zip(columns, map(float, filter(None, map(str.strip, row.split(",")))), strict=True)) for row in text[1:]
    ]
    decoder = Decoder()
    frames = check_splits(Decoder, raw)
    decoder.feed(raw, 0.0)
    assert (len(frames), len(rows)) == (99, 98)
    del frames[LOST]
    assert decoder.checksum_errors == 0
    gauss, deg = 1e-4, math.pi / 180
    kept = {
        "mx": ("MagX", gauss), "my": ("MagY", gauss), "mz": ("MagZ", gauss),
        "ax": ("AccX", 1.0), "ay": ("AccY", 1.0), "az": ("AccZ", 1.0),
        "p": ("GyroX", 1.0), "q": ("GyroY", 1.0), "r": ("GyroZ", 1.0),
        "yaw": ("Yaw", deg), "pitch": ("Pitch", deg), "roll": ("Roll", deg),
    }  # fmt: skip
    for field, (column, scale) in kept.items():
        ours = np.array([getattr(frame.sample, field) for frame in frames]) / scale
        np.testing.assert_allclose(ours, [row[column] for row in rows], rtol=1e-6, atol=1e-12, err_msg=field)


@pytest.mark.measured
def test_all_lines_recorded_by_other_users_are_read() -> None:
    decoder = Decoder()
    frames = decoder.feed(measured("vectornav/ascii_samples.txt").read_bytes(), 0.0)
    assert len(frames) == 11
    assert counters(decoder) == (11, 0, 0)


@pytest.mark.measured
def test_twelve_minutes_of_a_vn100_at_rest_are_read() -> None:
    decoder = Decoder()
    frames = decoder.feed(measured("static/vn100_stationary_40Hz_vnymr.txt").read_bytes(), 0.0)
    assert counters(decoder) == (len(frames), 0, 0)
    assert len(frames) > 30_000
    gravity = np.array(
        [math.hypot(f.sample.ax, f.sample.ay, f.sample.az) for f in frames if isinstance(f.sample, Ahrs)]
    )
    assert abs(gravity.mean() - 9.97) < 0.05  # this sensor reads 1.7 % high during the whole log
    assert max(f.sample.az for f in frames if isinstance(f.sample, Ahrs)) < -9.5


@pytest.mark.measured
def test_a_capture_of_ardupilots_simulated_vn300_is_read() -> None:
    decoder = Decoder()
    frames = decoder.feed(measured("ardurover/vn.bin").read_bytes(), 0.0)
    assert decoder.checksum_errors == 0
    assert decoder.unparsed_bytes < 200  # the truncated end of the capture
    times = [frame.t_device for frame in frames]
    assert times == sorted(times)
    resting = [
        frame.sample.az for frame in frames if isinstance(frame.sample, Ahrs) and not math.isnan(frame.sample.az)
    ]
    assert np.mean(resting) == pytest.approx(-9.81, abs=0.05)
