"""Tests of MicroStrain's MIP: sensor, filter and GNSS packets, and truncated or damaged streams."""

from __future__ import annotations

import math
import struct

import pytest

from seatrial.daq.protocol import mip
from seatrial.daq.protocol.ubx import GPS_EPOCH, WEEK
from seatrial.daq.samples import Ahrs, Gnss
from tests.daq.streams import check_garbage, counters

SENSOR = mip.packet(
    mip.SENSOR,
    {
        0x04: struct.pack(">3f", 0.0, 0.0, -1.0),
        0x05: struct.pack(">3f", 0.1, 0.2, 0.3),
        0x06: struct.pack(">3f", 0.25, 0.0, 0.5),
        0x0A: struct.pack(">4f", math.cos(0.25), 0.0, 0.0, math.sin(0.25)),
    },
)
FILTER = mip.packet(mip.FILTER, {0x05: struct.pack(">3fH", 0.01, -0.02, 1.5, 1)})


def ahrs(data: bytes) -> list[Ahrs]:
    return [frame.sample for frame in mip.Decoder().feed(data, 5.0) if isinstance(frame.sample, Ahrs)]


def test_the_ping_of_the_manual_is_a_valid_packet() -> None:
    """MicroStrain's protocol page shows this packet: base command, ping, checksum E0 C6."""
    assert mip.packet(0x01, {0x01: b""}).hex() == "756501020201e0c6"


def test_without_a_filter_the_attitude_of_the_sensor_is_used() -> None:
    (sample,) = ahrs(SENSOR)
    assert (sample.yaw, sample.p, sample.q, sample.r) == pytest.approx((0.5, 0.1, 0.2, 0.3), abs=1e-6)
    assert sample.az == pytest.approx(-9.80665)
    assert (sample.mx, sample.mz) == pytest.approx((0.25e-4, 0.5e-4))


def test_with_a_filter_its_attitude_and_the_newest_rates_are_used() -> None:
    # once the filter sends, each filter packet gives one sample
    first, second, third = ahrs(SENSOR + FILTER + SENSOR + FILTER)
    assert first.yaw == pytest.approx(0.5, abs=1e-6)
    for sample in (second, third):
        assert (sample.roll, sample.pitch, sample.yaw) == pytest.approx((0.01, -0.02, 1.5), abs=1e-6)
        assert sample.r == pytest.approx(0.3)
    invalid = mip.packet(mip.FILTER, {0x05: struct.pack(">3fH", 0.01, -0.02, 1.5, 0)})
    assert len(ahrs(SENSOR + invalid + SENSOR)) == 2


def test_a_fix_of_mip_is_read() -> None:
    place = struct.pack(">4d2fH", 41.5, -8.5, 60.0, 5.0, 0.5, 0.9, 0x1F)
    motion = struct.pack(">8fH", 1.0, -0.5, 0.25, 1.146, 1.125, 5.82, 0.0, 0.0, 0x1F)
    time = struct.pack(">dHH", 1000.25, 2288, 3)
    fields = {0xD3: time, 0x0B: struct.pack(">BBHH", 6, 19, 0, 7), 0x03: place, 0x05: motion}
    (frame,) = mip.Decoder().feed(mip.packet(mip.GNSS_1, fields), 5.0)
    utc = GPS_EPOCH + 2288 * WEEK + 1000.25 - 18.0
    assert frame.sample == Gnss(
        utc, 41.5, -8.5, 5.0, 1.0, -0.5, 0.25, 5, 19, frame.sample.hdop, pytest.approx(0.3535534), 1.125
    )
    assert frame.t_device == utc
    (void,) = mip.Decoder().feed(mip.packet(mip.GNSS_1, {0x03: bytes(42)}), 5.0)
    assert isinstance(void.sample, Gnss)
    assert (void.sample.fix, math.isnan(void.sample.lat), math.isnan(void.t_device)) == (0, True, True)


def test_splits_and_garbage() -> None:
    check_garbage(mip.Decoder, [SENSOR] * 4, 4)


def test_damaged_packets_are_counted() -> None:
    decoder = mip.Decoder()
    broken = bytearray(SENSOR)
    broken[12] ^= 4
    assert decoder.feed(bytes(broken), 5.0) == []
    assert (decoder.frames, decoder.checksum_errors) == (0, 1)
    body = mip.SYNC + bytes((0x80, 3, 9, 4, 0))  # a field that is longer than its packet
    decoder = mip.Decoder()
    assert decoder.feed(body + mip.checksum(body), 5.0) == []
    assert counters(decoder)[:2] == (0, 0)


def test_vectors_of_several_packets_are_joined() -> None:
    """Rates at 100 Hz and accelerations at 50 Hz are sometimes in separate packets."""
    accel = mip.packet(mip.SENSOR, {0x04: struct.pack(">3f", 0.0, 0.0, -1.0)})
    rate = mip.packet(mip.SENSOR, {0x05: struct.pack(">3f", 0.1, 0.2, 0.3)})
    decoder = mip.Decoder()
    decoder.feed(accel, 5.0)
    for data in (rate, FILTER):
        (frame,) = decoder.feed(data, 5.1)
        assert isinstance(frame.sample, Ahrs)
        assert (frame.sample.p, frame.sample.az) == pytest.approx((0.1, -9.80665), abs=1e-6)
    (later,) = decoder.feed(FILTER, 5.0 + mip.STALE_S + 0.05)
    assert isinstance(later.sample, Ahrs)
    assert (later.sample.r, math.isnan(later.sample.az)) == (pytest.approx(0.3), True)  # too old to be repeated


def test_samples_continue_after_the_filter_loses_its_attitude() -> None:
    invalid = mip.packet(mip.FILTER, {0x05: struct.pack(">3fH", 0.01, -0.02, 1.5, 0)})
    decoder = mip.Decoder()
    n_samples = [
        len(decoder.feed(data, 5.0)) for data in (SENSOR, FILTER, SENSOR, invalid, SENSOR, SENSOR, FILTER, SENSOR)
    ]
    assert n_samples == [1, 1, 0, 0, 1, 1, 1, 0]
    assert len(decoder.feed(SENSOR, 5.0 + mip.FILTER_S + 0.1)) == 1  # no more packets came from the filter
