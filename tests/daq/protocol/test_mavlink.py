"""Tests of the MAVLink decoder: samples, events, signatures, and damaged streams."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from seatrial.daq.errors import SeatrialError
from seatrial.daq.protocol import ubx
from seatrial.daq.protocol.mavlink import MavlinkDecoder, SampleConverter
from seatrial.daq.protocol.mavlink_wire import Codec, EscStatus, crc16, dialect, encode_esc_status, read_key
from seatrial.daq.rig import AutopilotOutput
from seatrial.daq.samples import Ahrs, Autopilot, Battery, Esc, Event, Frame, Gnss, Servo
from tests.daq.mavlink_ends import Ends, mav_rig
from tests.daq.streams import check_garbage, check_splits, counters
from tests.measured.data import measured

OUTPUTS = {
    1: AutopilotOutput(1, (1000, 1500, 2000), (1100, 1500, 1900)),
    3: AutopilotOutput(3, (1000, 1500, 2000), (1000, 1600, 1900)),
}
# garbage comes before: a truncated header is distinguished from a long frame by the bytes that follow
PLUG = bytes(300)


def decoder() -> MavlinkDecoder:
    return MavlinkDecoder(SampleConverter(OUTPUTS, frozenset({3})))


def vehicle(*messages: tuple[object, ...], system: int = 1) -> list[bytes]:
    codec = Codec(system, 1)
    return [codec.encode(str(name), *fields) for name, *fields in messages]


HEARTBEAT = ("HEARTBEAT", 11, 3, 193, 0, 4, 3)


def samples(*messages: tuple[object, ...]) -> list[Frame]:
    return decoder().feed(b"".join(vehicle(*messages)), 1.0)


def servo(usec: int, left: int, right: int) -> tuple[object, ...]:
    return ("SERVO_OUTPUT_RAW", usec, 0, left, 0, right, *[0] * 13)


def test_an_estimator_that_has_lost_its_position_gives_no_fix() -> None:
    def fix(*flags: int) -> int:
        position = ("GLOBAL_POSITION_INT", 1000, 423_580_000, -710_856_831, 0, 0, 100, 0, 0, 9000)
        reports = [("EKF_STATUS_REPORT", flag, 0.0, 0.0, 0.0, 0.0, 0.0) for flag in flags]
        stream = b"".join(vehicle(HEARTBEAT, *reports, position))
        found = MavlinkDecoder(SampleConverter(gnss="fused")).feed(stream, 1.0)
        return next(frame.sample.fix for frame in found if isinstance(frame.sample, Gnss))

    assert fix() == 3  # the estimator does not report its state
    assert fix(831) == 3
    assert fix(831, 167) == 0  # dead reckoning, constant-position mode
    assert fix(831, 39) == 0


def test_the_checksum_equals_that_of_pymavlink() -> None:
    for text in (b"", b"123456789", bytes(range(256))):
        assert crc16(text) == dialect().x25crc(text).crc


def test_attitude_and_imu_of_one_moment_are_one_sample() -> None:
    imu = ("RAW_IMU", 70_131_936, 1000, 0, -1000, 0, 0, 0, 100, 200, 300)
    attitude = ("ATTITUDE", 70_131, 0.1, -0.2, 3.0, 0.01, 0.02, 0.03)
    for order in ((attitude, imu), (imu, attitude)):
        before = ("RAW_IMU", 70_111_900, 0, 0, 0, 0, 0, 0, 0, 0, 0)
        found = [f for f in samples(HEARTBEAT, before, *order) if isinstance(f.sample, Ahrs)]
        ((sample, _, t),) = found[-1:]
        assert len(found) == 2  # and the earlier IMU message, for which no attitude came
        assert isinstance(sample, Ahrs)
        # truncated to whole milliseconds: the time of the IMU is 70.131936
        assert t == pytest.approx(70.1315, abs=1e-6)
        assert (sample.yaw, sample.pitch, sample.roll) == pytest.approx((3.0, -0.2, 0.1))
        assert (sample.p, sample.q, sample.r) == pytest.approx((0.01, 0.02, 0.03))
        assert (sample.ax, sample.ay, sample.az) == pytest.approx((9.80665, 0.0, -9.80665))
        assert (sample.mx, sample.my, sample.mz) == pytest.approx((1e-5, 2e-5, 3e-5))


def test_attitude_and_imu_of_different_moments_are_two_samples() -> None:
    messages: list[tuple[object, ...]] = [HEARTBEAT]
    for k in range(5):
        messages.append(("ATTITUDE", 1000 + 40 * k, 0.1, -0.2, 3.0, 0.01, 0.02, 0.03))
        messages.append(("RAW_IMU", 1_020_000 + 40_000 * k, 1000, 0, -1000, 0, 0, 0, 0, 0, 0))
    found = [f for f in samples(*messages) if isinstance(f.sample, Ahrs)]
    attitudes = [f.t_device for f in found if isinstance(f.sample, Ahrs) and not math.isnan(f.sample.yaw)]
    accelerations = [f.t_device for f in found if isinstance(f.sample, Ahrs) and not math.isnan(f.sample.ax)]
    assert attitudes == pytest.approx([1.0005, 1.0405, 1.0805, 1.1205, 1.1605])
    assert accelerations == pytest.approx([1.02, 1.06, 1.1, 1.14])  # the last sample may still get its attitude


def test_a_slow_stream_is_sorted_by_its_device_time() -> None:
    messages: list[tuple[object, ...]] = [HEARTBEAT]
    for k in range(6):  # in groups at 1 Hz, attitude and IMU are milliseconds or a second apart
        messages.append(("RAW_IMU", 69_092_000 + 1_019_900 * k, 1000, 0, -1000, 0, 0, 0, 0, 0, 0))
        messages.append(("ATTITUDE", 70_111 + 1001 * k, 0.1, -0.2, 3.0, 0.01, 0.02, 0.03))
    times = [f.t_device for f in samples(*messages) if isinstance(f.sample, Ahrs)]
    assert times == sorted(times)
    assert len(times) >= 10


def test_an_attitude_without_imu_is_not_held_back() -> None:
    (found,) = samples(("ATTITUDE", 5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
    assert isinstance(found.sample, Ahrs)
    assert math.isnan(found.sample.ax)


def test_outputs_are_scaled_and_signed_by_the_rig() -> None:
    found = [f.sample for f in samples(servo(10, 1900, 1300), servo(20, 0, 1900))]
    assert found == [Servo(1, 1900.0, 1.0), Servo(3, 1300.0, 0.5), Servo(1, 0.0, 0.0), Servo(3, 1900.0, -1.0)]


def test_the_time_of_outputs_continues_after_a_32_bit_overflow() -> None:
    attitude = ("ATTITUDE", 4_295_000, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)  # 71.6 minutes, just past 2**32 us
    found = [f.t_device for f in samples(attitude, servo(32_704 + 20_000, 1500, 1500)) if isinstance(f.sample, Servo)]
    assert found == pytest.approx([4295.02] * 2, abs=1e-3)


def test_a_repeated_fix_gives_one_sample() -> None:
    def gps(usec: int) -> tuple[object, ...]:
        return ("GPS_RAW_INT", usec, 6, 423_580_000, -710_856_831, 1500, 121, 200, 445, 8998, 10, 0, 300, 300)

    time = ("SYSTEM_TIME", 1_795_144_521_000_000, 70_000)
    found = samples(time, gps(70_050_000), gps(70_050_000), gps(70_250_000))
    assert [f.t_device for f in found] == [70.05, 70.25]
    fix = found[0].sample
    assert isinstance(fix, Gnss)
    assert fix.utc == pytest.approx(1_795_144_521.05)
    assert (fix.lat, fix.lon, fix.alt) == pytest.approx((42.358, -71.0856831, 1.5))
    assert (fix.vel_n, fix.vel_e) == pytest.approx((4.455 * math.cos(math.radians(89.98)), 4.455), rel=1e-6)
    assert (fix.fix, fix.n_sat, fix.hdop, fix.sigma_h) == (5, 10, 1.21, pytest.approx(0.3 / math.sqrt(2.0)))
    slow = list(gps(70_450_000))
    slow[9] = 0xFFFF  # without a course over ground
    (found,) = samples(time, tuple(slow))
    assert isinstance(found.sample, Gnss)
    assert (found.sample.speed, math.isnan(found.sample.vel_n)) == (pytest.approx(4.455), True)


def test_esc_telemetry_gets_the_sign_of_the_output_and_repeats_are_dropped() -> None:
    zero = [0] * 4

    def telemetry(count: list[int]) -> tuple[object, ...]:
        return ("ESC_TELEMETRY_1_TO_4", bytes([30, 0, 31, 0]), [1600] * 4, [250] * 4, zero, [900, 0, 800, 0], count)

    found = samples(servo(1, 1300, 1300), telemetry([1, 0, 7, 0]), telemetry([2, 0, 7, 0]))
    escs = [f.sample for f in found if isinstance(f.sample, Esc)]
    assert [(esc.node, esc.rpm) for esc in escs] == [(1, -900.0), (3, 800.0), (1, -900.0)]
    assert (escs[0].current, escs[0].voltage, escs[0].temperature) == pytest.approx((2.5, 16.0, 30.0))


def test_esc_status_is_read_although_pymavlink_lacks_it() -> None:
    status = EscStatus(5_000_000, (700, 0, -650, 0), (15.5, 0.0, 15.25, 0.0), (1.5, 0.0, 2.5, 0.0), 0)
    found = decoder().feed(encode_esc_status(1, 1, 9, status), 1.0)
    assert [(f.sample.node, f.sample.rpm, f.t_device) for f in found if isinstance(f.sample, Esc)] == [
        (1, 700.0, 5.0),
        (3, 650.0, 5.0),  # reversed in the rig
    ]


def test_the_battery_is_read_from_any_message_that_contains_it() -> None:
    cells = [4100, 4050, *[65535] * 8]
    full = ("BATTERY_STATUS", 0, 0, 1, 0, cells, 1250, -1, -1, 80)
    system = ("SYS_STATUS", 0, 0, 0, 0, 7900, 500, -1, 0, 0, 0, 0, 0, 0)
    found = [f.sample for f in samples(system, full, system)]
    assert found[0] == Battery(7.9, 5.0, pytest.approx(math.nan, nan_ok=True))
    assert found[1] == Battery(8.15, 12.5, 0.8)
    assert len(found) == 2


def test_changes_of_state_and_texts_are_events() -> None:
    chunks = [("STATUSTEXT", 2, part, 7, k) for k, part in enumerate((b"a" * 50, b"b" * 50, b"end"))]
    hold = ("HEARTBEAT", 11, 3, 65, 4, 3, 3)
    found = [f.sample for f in samples(HEARTBEAT, HEARTBEAT, hold, *chunks, ("STATUSTEXT", 6, b"hello"))]
    assert [s for s in found if isinstance(s, Autopilot)][-1] == Autopilot(0, 4, 3, -1)
    assert [s for s in found if isinstance(s, Event)] == [
        Event("autopilot", "armed, MANUAL"),
        Event("autopilot", "disarmed, HOLD"),
        Event("statustext", f"critical: {'a' * 50}{'b' * 50}end"),
        Event("statustext", "info: hello"),
    ]


def test_other_systems_are_counted_and_ignored() -> None:
    there = decoder()
    assert there.feed(b"".join(vehicle(HEARTBEAT, servo(1, 1900, 1900), system=7)), 0.0) == []
    assert there.foreign == {7: 2}
    assert there.frames == 2


def test_with_a_key_only_frames_signed_with_it_are_accepted() -> None:
    key, wrong_key = bytes(range(32)), bytes(32)
    message = ("SERVO_OUTPUT_RAW", 1, 0, 1700, 0, 1500, *[0] * 13)
    for sender, heard in ((None, 0), (wrong_key, 0), (key, 2)):
        there = decoder()
        there.secure(Codec(255, 190, key, 1_800_000_000.0))
        data = Codec(1, 1, sender, 1_800_000_000.0).encode(*message)
        assert len(there.feed(data, 0.0)) == heard
        assert there.unsigned == (heard == 0)
        assert there.feed(data, 0.0) == []  # a repeated frame: recorded and replayed by somebody else


def test_a_key_file_contains_bytes_or_hexadecimal_digits(tmp_path: Path) -> None:
    path = tmp_path / "key"
    path.write_bytes(bytes(range(32)))
    assert read_key(path) == bytes(range(32))
    path.write_text(bytes(range(32)).hex() + "\n")
    assert read_key(path) == bytes(range(32))
    path.write_text("secret")
    with pytest.raises(SeatrialError, match="32 bytes or 64 hexadecimal digits"):
        read_key(path)
    with pytest.raises(SeatrialError, match="cannot be read"):
        read_key(tmp_path / "none")


def stream() -> list[bytes]:
    attitude = ("ATTITUDE", 5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    return vehicle(HEARTBEAT, attitude, servo(9, 1500, 1700), servo(19, 1600, 1400))


def test_splits_and_garbage() -> None:
    assert len(check_splits(decoder, b"".join(stream()))) == 7
    check_garbage(decoder, stream(), 7, ending=PLUG)


def test_a_message_of_an_unknown_dialect_counts_as_a_frame() -> None:
    good = stream()[0]
    body = bytes([3, 0, 0, 1, 1, 1, 0xFE, 0xFF, 0x7F]) + b"abc"  # 8388606
    unknown = b"\xfd" + body + crc16(body + b"\x2a").to_bytes(2, "little")
    there = decoder()
    there.feed(good + unknown + good, 0.0)
    assert counters(there) == (3, 0, 0)


def test_a_wrong_checksum_is_counted_and_the_next_frame_is_found() -> None:
    first, second = stream()[2], stream()[3]
    broken = bytearray(first)
    broken[-1] ^= 1
    there = decoder()
    assert len(there.feed(bytes(broken) + second, 0.0)) == 2
    assert (there.frames, there.checksum_errors) == (1, 1)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.one_of(st.binary(max_size=40), st.sampled_from(stream())), max_size=12), st.integers(0, 10**6))
def test_damaged_frames_raise_no_exception(parts: list[bytes], flip: int) -> None:
    data = bytearray(b"".join(parts))
    if data:
        data[flip % len(data)] ^= 0x40
    there = decoder()
    there.feed(bytes(data), 0.0)
    there.reset()
    assert there.unparsed_bytes <= len(data)


def test_the_messages_of_the_mock_decode_without_an_error() -> None:
    ends = Ends(mav_rig())
    ends.run(4.0)
    kinds = Counter(type(frame.sample).__name__ for frame in ends.frames)
    assert counters(ends.decoder)[1:] == (0, 0)
    assert {"Ahrs", "Gnss", "Servo", "Esc", "Battery", "Autopilot", "Event"} <= set(kinds)
    assert kinds["Ahrs"] == pytest.approx(25 * 4, rel=0.15)
    assert kinds["Gnss"] == pytest.approx(5 * 4, abs=4)


@pytest.mark.measured
def test_messages_of_a_tlog_are_counted_as_by_pymavlink() -> None:
    path = measured("ardurover/steps_boat.tlog")
    from pymavlink import mavutil

    theirs: Counter[str] = Counter()
    reader = mavutil.mavlink_connection(str(path))
    while (message := reader.recv_match()) is not None:
        theirs[message.get_type()] += 1
    reader.close()
    there = MavlinkDecoder(SampleConverter())
    found = there.feed(path.read_bytes(), 0.0)
    assert there.frames == sum(theirs.values()) == 63643
    assert there.unparsed_bytes == 8 * there.frames  # the times between the messages, which are not MAVLink
    kinds = Counter(type(frame.sample) for frame in found)
    lone = sum(isinstance(frame.sample, Ahrs) and math.isnan(frame.sample.yaw) for frame in found)
    assert kinds[Ahrs] - lone == theirs["ATTITUDE"]
    assert lone <= 1  # the first IMU message came before any attitude
    assert kinds[Servo] == 2 * (theirs["SERVO_OUTPUT_RAW"] - 1)  # the first came before there were pulses
    assert not there.foreign


def test_a_text_of_the_autopilot_does_not_write_to_the_terminal() -> None:
    samples = SampleConverter()
    text = dialect().MAVLink_statustext_message(2, b"\x1b[2Jboo\x07")
    ((event, _),) = samples.take(text)
    assert isinstance(event, Event)
    assert event.text.isprintable()
    assert "boo" in event.text


def raw_fix(usec: int, kind: int) -> tuple[object, ...]:
    return ("GPS_RAW_INT", usec, kind, 387_000_000, -90_000_000, 0, 100, 0xFFFF, 0, 0, 9, 0, 1000, 1000)


def test_a_lost_fix_is_a_sample_without_a_time() -> None:
    attitude = ("ATTITUDE", 30_000, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    messages = [raw_fix(0, 1), attitude, raw_fix(0, 1), raw_fix(31_000_000, 3), *[raw_fix(31_000_000, 1)] * 3]
    found = [f for f in samples(HEARTBEAT, *messages, raw_fix(35_000_000, 3)) if isinstance(f.sample, Gnss)]
    assert [f.sample.fix for f in found if isinstance(f.sample, Gnss)] == [0, 3, 0, 3]
    assert [f.t_device for f in found] == pytest.approx([math.nan, 31.0005, math.nan, 35.0005], nan_ok=True)
    lost = found[2].sample
    assert isinstance(lost, Gnss)
    assert all(map(math.isnan, (lost.utc, lost.lat, lost.lon, lost.sigma_h, lost.speed)))


def test_the_accuracy_of_a_fix_equals_that_read_from_ubx() -> None:
    """One receiver reports hAcc 1 m by its own protocol and through an autopilot."""
    own = ubx.Decoder()
    frames = own.feed(ubx.encode(Gnss(1.8e9, 38.7, -9.0, fix=3, sigma_h=math.sqrt(0.5))), 1.0) + own.flush()
    accuracies = [f.sample.sigma_h for f in [*frames, *samples(raw_fix(1000, 3))] if isinstance(f.sample, Gnss)]
    assert accuracies == pytest.approx([math.sqrt(0.5)] * 2, abs=1e-3)


def test_a_restart_of_the_autopilot_drops_all_earlier_state() -> None:
    def at(ms: int) -> list[tuple[object, ...]]:
        attitude = ("ATTITUDE", ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        return [attitude, ("RAW_IMU", (ms + 20) * 1000, 0, 0, -1000, 0, 0, 0, 0, 0, 0)]

    time = ("SYSTEM_TIME", 1_795_144_521_000_000, 500_000)
    before, after = [*at(500_000), *at(500_040)], [*at(3000), *at(3040)]
    for later in (after, after[1:]):  # whichever comes first
        found = samples(HEARTBEAT, time, *before, *later, raw_fix(3_050_000, 3))
        times = [f.t_device for f in found if isinstance(f.sample, Ahrs)]
        assert sum(b < a for a, b in itertools.pairwise(times)) == 1
        assert math.isnan(next(f.sample.utc for f in found if isinstance(f.sample, Gnss)))
