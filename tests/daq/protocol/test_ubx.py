"""Tests of UBX: epochs of one or several messages, mixed with NMEA on one port, and truncated or damaged streams."""

from __future__ import annotations

import math
import struct
import time

import pytest

from seatrial.daq.protocol import nmea, ubx
from seatrial.daq.protocol.framing import sentence
from seatrial.daq.protocol.ubx import GPS_EPOCH, WEEK, gps_to_utc
from seatrial.daq.samples import Ahrs, Frame, Gnss
from tests.daq.streams import check_garbage, check_splits, is_close

T = 1_700_000_000.0
GNSS = Gnss(T + 0.25, 41.1234567, -8.7654321, 12.345, 0.5, -0.25, 0.125, 5, 12, sigma_h=0.014)


def read(data: bytes) -> list[Gnss]:
    decoder = ubx.Decoder()
    frames = decoder.feed(data, 5.0) + decoder.flush()
    return [frame.sample for frame in frames if isinstance(frame.sample, Gnss)]


def pvt(fix: int = 3, flags: int = 1, valid: int = 7, nano: int = 0, i_tow: int = 1000) -> bytes:
    payload = struct.pack("<IH5BBIi4B4i", i_tow, 2023, 11, 14, 22, 13, 20, valid, 20, nano, fix, flags, 0, 9,
                          -87654321, 411234567, 0, 12345)  # fmt: skip
    return ubx.message(ubx.NAV_PVT, payload.ljust(92, b"\0"))


@pytest.mark.parametrize("fix", range(7))
def test_a_decoded_message_equals_the_encoded_message(fix: int) -> None:
    dimensions = 2 if fix in (2, 4) else 3
    sample = Gnss(
        T + 0.25, 41.1234567, -8.7654321, 12.345, 0.5, -0.25, 0.125, fix, 12, sigma_h=0.014, dimensions=dimensions
    )
    (found,) = read(ubx.encode(sample))
    assert found.fix == fix
    if fix:
        assert is_close(found, sample, tolerance=6e-4)
        assert (found.lat, found.lon) == pytest.approx((sample.lat, sample.lon), abs=1e-10)


def test_a_message_of_the_protocol_specification_is_encoded_correctly() -> None:
    """The message is CFG-MSG that requests NAV-PVT for each solution, as printed by u-blox with its checksum."""
    assert ubx.message((0x06, 0x01), bytes((0x01, 0x07, 0x01))).hex() == "b56206010300010701" + "1351"


def test_a_negative_nanosecond_field_is_subtracted() -> None:
    assert read(pvt(nano=-250_000))[0].utc == pytest.approx(T - 250e-6, abs=1e-9)


def test_a_position_not_marked_as_valid_has_no_fix() -> None:
    for message in (pvt(fix=3, flags=0), pvt(fix=5, flags=1)):
        (sample,) = read(message)
        assert (sample.fix, sample.lat) == (0, pytest.approx(41.1234567))
    (nothing,) = read(pvt(fix=0, flags=0))
    assert nothing.fix == 0
    assert math.isnan(nothing.lat)


def test_without_a_valid_date_there_is_no_device_time() -> None:
    decoder = ubx.Decoder()
    (frame,) = [*decoder.feed(pvt(valid=2), 5.0), *decoder.flush()]
    assert math.isnan(frame.t_device)


def test_a_time_that_is_not_resolved_is_not_utc() -> None:
    def only_frame(message: bytes) -> Frame:
        decoder = ubx.Decoder()
        (frame,) = [*decoder.feed(message, 5.0), *decoder.flush()]
        return frame

    vague = bytearray(pvt(fix=0, flags=0)[6:-2])
    struct.pack_into("<I", vague, 12, 1_000_000_000)  # accurate to a second
    for frame in (only_frame(pvt(valid=3)), only_frame(ubx.message(ubx.NAV_PVT, bytes(vague)))):
        assert math.isnan(frame.t_device)
        assert isinstance(frame.sample, Gnss)
        assert frame.sample.utc == T
    assert (
        only_frame(pvt()).t_device == only_frame(pvt(fix=0, flags=0)).t_device == T
    )  # without a fix the receiver keeps its time


def old_receiver(i_tow: int, n_sat: int = 7) -> list[bytes]:
    """Return SOL, POSLLH, VELNED and DOP of one epoch, as sent by u-blox 5 and 6, in week 2288 without a leap second
    message.
    """
    sol = struct.pack("<IihBB3iI3iIHBBI", i_tow, 250_000, 2288, 3, 0x0D, 0, 0, 0, 100, 0, 0, 0, 10, 200, 0, n_sat, 0)
    place = struct.pack("<I4i2I", i_tow, -87654321, 411234567, 60000, 12345, 1414, 2000)
    motion = struct.pack("<I3iIIi2I", i_tow, 50, -25, 10, 56, 55, 0, 5, 5)
    dilution = struct.pack("<I7H", i_tow, 1, 2, 3, 4, 95, 6, 7)
    return [ubx.message((1, n), p) for n, p in ((0x06, sol), (0x02, place), (0x12, motion), (0x04, dilution))]


def test_an_epoch_of_several_messages_is_read_in_any_order() -> None:
    for order in (1, -1):
        (sample,) = read(b"".join(old_receiver(345_600_000)[::order]))
        assert sample == Gnss(
            gps_to_utc(GPS_EPOCH + 2288 * WEEK + 345_600.00025), sample.lat, sample.lon, 12.345, 0.5, -0.25, 0.1, 3, 7,
            0.95, pytest.approx(1.0, abs=1e-3),
        )  # fmt: skip
        assert (sample.lat, sample.lon) == pytest.approx((41.1234567, -8.7654321), abs=1e-9)


def test_a_complete_epoch_is_delivered_at_once() -> None:
    decoder = ubx.Decoder()
    assert decoder.feed(b"".join(old_receiver(1000)), 1.0) == []  # other messages may still come
    assert len(decoder.feed(b"".join(old_receiver(2000)[:3]), 2.0)) == 1
    (frame,) = decoder.feed(old_receiver(2000)[3], 2.1)
    assert frame.t_rx == 2.0  # the receive time of its first message


def test_the_high_precision_position_has_priority() -> None:
    fine = struct.pack("<B2xBI4i4b2I", 0, 0, 1000, -87654321, 411234567, 0, 12345, -49, 37, 0, 5, 140, 200)
    (sample,) = read(pvt() + ubx.message((1, 0x14), fine))
    assert sample.lat == pytest.approx(41.1234567 + 37e-9, abs=1e-12)
    assert sample.alt == pytest.approx(12.3455)
    assert sample.sigma_h == pytest.approx(0.0099, abs=1e-4)


def test_leap_seconds_are_applied() -> None:
    assert gps_to_utc(GPS_EPOCH + 0.5) == GPS_EPOCH + 0.5
    # The leap second at the end of 2016 has no own value in seconds since 1970: it shares that of the next day's first
    # second.
    assert gps_to_utc(1_483_228_800 + 16.5) == 1_483_228_799.5
    assert gps_to_utc(1_483_228_800 + 17.5) == 1_483_228_800.5
    assert gps_to_utc(1_483_228_800 + 18.0) == 1_483_228_800.0
    assert gps_to_utc(1_700_000_018.0) == 1_700_000_000.0


def test_mixed_with_nmea_each_solution_is_read_once_and_headings_are_kept() -> None:
    stream = b"".join(
        nmea.encode(Gnss(T + k, 41.0, -8.0, fix=3)) + pvt(i_tow=1000 * k) + sentence(f"GNHDT,{10.0 + k},T")
        for k in range(5)
    )
    frames = check_splits(ubx.Decoder, stream)
    headings = [round(math.degrees(f.sample.yaw), 6) for f in frames if isinstance(f.sample, Ahrs)]
    assert headings == [10.0, 11.0, 12.0, 13.0, 14.0]
    places = [f.sample.lat for f in frames if isinstance(f.sample, Gnss)]
    assert len(places) == 5
    assert all(lat == pytest.approx(41.1234567) for lat in places)
    assert [s.lat for s in read(nmea.encode(GNSS) * 2)] == pytest.approx([41.1234567])  # NMEA without UBX does so too


def test_the_attitude_of_a_receiver_with_inertial_sensors_is_read() -> None:
    known = struct.pack("<IB3x3i3I", 1000, 0, -150000, 250000, 35900000, 1000, 1000, 5000)
    decoder = ubx.Decoder()
    (frame,) = decoder.feed(ubx.message((1, 0x05), known), 5.0)
    assert isinstance(frame.sample, Ahrs)
    assert (frame.sample.roll, frame.sample.pitch) == pytest.approx((math.radians(-1.5), math.radians(2.5)))
    assert frame.sample.yaw == pytest.approx(math.radians(-1.0))
    assert decoder.feed(ubx.message((1, 0x05), bytes(32)), 5.0) == []


def test_splits_and_garbage() -> None:
    messages = [ubx.encode(Gnss(T + k, 41.0, -8.0, 1.0, 0.1, 0.0, 0.0, 3, 9, sigma_h=0.5)) for k in range(5)]
    clean: list[Frame] = ubx.Decoder().feed(b"".join(messages), 5.0)
    check_garbage(ubx.Decoder, messages, len(clean))


def test_a_wrong_checksum_is_counted_and_gives_nothing() -> None:
    decoder = ubx.Decoder()
    broken = bytearray(pvt())
    broken[40] ^= 1
    assert decoder.feed(bytes(broken), 5.0) + decoder.flush() == []
    assert (decoder.frames, decoder.checksum_errors) == (0, 1)


@pytest.mark.parametrize("kind", [b"\x0d\x55", b"\x01\x99"])
def test_a_damaged_length_does_not_delay_a_fix(kind: bytes) -> None:
    stream = b"\xb5\x62" + kind + b"\xf0\x1f"  # 8176 bytes take 82 s at 100 bytes/s
    decoder, late = ubx.Decoder(), []
    decoder.feed(stream, 0.0)
    for k in range(1, 10):
        message = ubx.encode(Gnss(T + k, 41.0, -8.0, fix=3))
        stream += message
        late += [frame.t_rx - (frame.t_device - T) for frame in decoder.feed(message, float(k))]
    assert late == [0.0] * 9
    check_splits(ubx.Decoder, stream)
    whole = ubx.message((0x02, 0x15), b"\xb5\x62" * 500) + pvt()  # a long message of a kind that is not decoded
    decoder = ubx.Decoder()
    assert len(decoder.feed(whole, 1.0) + decoder.flush()) == 1
    assert (decoder.frames, decoder.unparsed_bytes) == (2, 0)


@pytest.mark.parametrize("unit", [b"\xb5\x62\x01\x99\xff\x1f", b"\xb5\x62\x01\x99\xff\x1f\xb5\x62\x01\x07\x5c\x00"])
def test_the_cost_of_false_headers_is_linear_in_the_length(unit: bytes) -> None:
    false = unit * (30_000 // len(unit))
    decoder, start = ubx.Decoder(), time.process_time()
    found = decoder.feed(false + pvt() + false, 1.0) + decoder.flush()
    assert time.process_time() - start < 3.0  # 0.4; with each header parsed separately 15
    assert (len(found), decoder.frames) == (1, 1)


def test_an_attitude_gets_a_time_from_its_time_of_week() -> None:
    decoder = ubx.Decoder()
    fix = Gnss(1_700_000_000.0, 59.0, 10.0, 3.0, 0.5, 0.1, 0.0, fix=3, n_sat=9)
    tow = round((fix.utc + 18 - ubx.GPS_EPOCH) * 1000) % 604_800_000

    def attitude(ms: int) -> bytes:
        payload = struct.pack("<IB3x3i3I", (tow + ms) % 604_800_000, 0, 0, 0, 9_000_000, 100_000, 100_000, 100_000)
        return ubx.message((0x01, 0x05), payload)

    (before,) = decoder.feed(attitude(-100), 5.0)
    assert math.isnan(before.t_device)
    decoder.feed(ubx.encode(fix), 5.1)
    decoder.flush()
    found = [frame.t_device for ms in (40, 140, -604_800_000 + 240) for frame in decoder.feed(attitude(ms), 5.2)]
    assert found == pytest.approx([fix.utc + 0.04, fix.utc + 0.14, fix.utc + 0.24], abs=1e-6)


def test_the_velocity_of_sol_is_rotated_from_ecef() -> None:
    """Reference: the difference of two positions in ECEF, a second apart, resolved into north and east."""
    lat, lon, north, east, down = 59.0, 10.0, 1.5, -0.7, 0.2

    def ecef(lat: float, lon: float, alt: float) -> tuple[float, float, float]:
        a, e2 = 6378137.0, 6.69437999014e-3
        n = a / math.sqrt(1.0 - e2 * math.sin(math.radians(lat)) ** 2)
        flat = (n + alt) * math.cos(math.radians(lat))
        z = (n * (1.0 - e2) + alt) * math.sin(math.radians(lat))
        return flat * math.cos(math.radians(lon)), flat * math.sin(math.radians(lon)), z

    before, dt = ecef(lat, lon, 0.0), 1e4  # so far apart that the centimetre resolution of the message does not matter
    step = 1e-6
    d_north = [(b - a) / step for a, b in zip(before, ecef(lat + step, lon, 0.0), strict=True)]
    d_east = [(b - a) / step for a, b in zip(before, ecef(lat, lon + step, 0.0), strict=True)]
    d_down = [a - b for a, b in zip(before, ecef(lat, lon, 1.0), strict=True)]
    unit = [[x / math.hypot(*vector) for x in vector] for vector in (d_north, d_east, d_down)]
    v = [north * unit[0][k] + east * unit[1][k] + down * unit[2][k] for k in range(3)]
    place = [round(100 * x) for x in before]
    speed = [round(100 * dt * x) for x in v]
    sol = struct.pack("<IihBB3iI3iIHBBI", 1000, 0, 2288, 3, 0x0D, *place, 100, *speed, 10, 200, 0, 7, 0)
    (sample,) = read(ubx.message((1, 0x06), sol))
    assert (sample.lat, sample.lon) == pytest.approx((lat, lon), abs=1e-6)
    found = [x / dt for x in (sample.vel_n, sample.vel_e, sample.vel_d)]
    assert found == pytest.approx([north, east, down], abs=1e-5)


@pytest.mark.parametrize(
    ("gps_fix", "flags", "fix"), [(3, 1, 3), (3, 3, 4), (2, 1, 2), (3, 0, 0), (5, 1, 0), (0, 1, 0)]
)
def test_a_position_with_its_status_alone_is_a_fix(gps_fix: int, flags: int, fix: int) -> None:
    place = old_receiver(1000)[1]
    (sample,) = read(place + ubx.message((1, 0x03), struct.pack("<I4B2I", 1000, gps_fix, flags, 0, 0, 0, 0)))
    assert sample.fix == fix
    assert math.isfinite(sample.lat) is (gps_fix > 0)


def hnr(nano: int, flags: int = 1) -> bytes:
    payload = struct.pack(
        "<IH6Bi2B2x8i4I4x", 1000, 2023, 11, 14, 22, 13, 20, 0x07, nano, 3, flags, -87654321, 411234567, 60000, 12345,
        1000, 1000, 9_000_000, 0, 14, 20, 5, 5,
    )  # fmt: skip
    return ubx.message((0x28, 0x00), payload)


def test_the_high_rate_solution_has_priority_over_the_epochs() -> None:
    samples = read(hnr(0) + hnr(100_000_000) + pvt() + hnr(200_000_000))
    assert [round(s.utc % 1.0, 3) for s in samples] == [0.0, 0.1, 0.2]
    assert (samples[0].vel_n, samples[0].vel_e) == pytest.approx((0.0, 1.0), abs=1e-9)
    assert (samples[0].lat, samples[0].lon, samples[0].fix) == (pytest.approx(41.1234567), pytest.approx(-8.7654321), 3)
    assert read(hnr(0, flags=0))[0].fix == 0


def test_epochs_are_used_again_after_the_high_rate_solution_ends() -> None:
    decoder = ubx.Decoder()
    decoder.feed(hnr(0), 1.0)
    payload = struct.pack("<IB3x3i3I", 1050, 0, 0, 0, 9_000_000, 100_000, 100_000, 100_000)
    (attitude,) = decoder.feed(ubx.message((0x01, 0x05), payload), 1.1)
    assert attitude.t_device == pytest.approx(T + 0.05)  # from the time of the high-rate solution
    assert decoder.feed(pvt(i_tow=2000) + pvt(i_tow=3000), 2.0) == []
    found = [frame.t_rx for k in range(4, 9) for frame in decoder.feed(pvt(i_tow=1000 * k), float(k))]
    assert found == [4.0, 5.0, 6.0, 7.0, 8.0]
    decoder.feed(hnr(0), 9.0)
    decoder.reset()  # the port was reopened, and the receiver lost its configuration
    assert len(decoder.feed(pvt(i_tow=10_000), 9.5) + decoder.flush()) == 1
