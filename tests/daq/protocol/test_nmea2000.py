"""Tests of NMEA 2000: encoded values are read back, fast packets with errors, several senders, magnetic headings."""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from pathlib import Path

import pytest

from seatrial.daq.acquisition.device_loop import DeviceLoop
from seatrial.daq.acquisition.log_thread import LogSink
from seatrial.daq.clock import RunClock
from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.protocol import nmea2000
from seatrial.daq.protocol.canframe import FRAME_BYTES, pack_can
from seatrial.daq.protocol.catalogue import make_decoder
from seatrial.daq.protocol.nmea2000 import Decoder, encode, fast_packet, identifier, split_identifier
from seatrial.daq.samples import NAN, Ahrs, Frame, Gnss
from seatrial.daq.transport.serial_port import SerialPort
from tests.daq.streams import check_splits, counters, is_close

AHRS = Ahrs(-2.1, 0.0123, -0.0456, r=-0.25)
FIX = Gnss(1_460_220_069.4, 52.55249216666667, -5.4616585, -0.71, 1.2, -0.5, fix=5, n_sat=12, hdop=0.6)


def can(frames: list[tuple[int, bytes]]) -> bytes:
    return b"".join(pack_can(*frame) for frame in frames)


def fed(*frames: tuple[int, bytes], decoder: Decoder | None = None, t: float = 5.0) -> list[Frame]:
    return (decoder or Decoder(settle=0.0)).feed(can(list(frames)), t)


def heading(raw: int, reference: int, variation: int = 0x7FFF, source: int = 35) -> tuple[int, bytes]:
    data = struct.pack("<BHhhB", 0, raw, 0x7FFF, variation, 0xFC | reference)
    return identifier(nmea2000.HEADING, source), data


def test_identifiers_carry_priority_message_and_sender() -> None:
    assert identifier(nmea2000.HEADING, 0x23) == 0x09F11223
    assert split_identifier(0x09F11223) == (127250, 0x23)
    assert split_identifier(0x18EAFF05) == (59904, 5)  # a message to one address, which is not part of the number


def test_an_encoded_heading_is_read_back() -> None:
    turn, level = fed(*encode(AHRS))
    assert (turn.sample.r, turn.t_device) == (pytest.approx(-0.25, abs=1e-7), pytest.approx(NAN, nan_ok=True))  # type: ignore[union-attr]
    assert math.isnan(turn.sample.yaw)  # type: ignore[union-attr]
    assert is_close(level.sample, Ahrs(-2.1, 0.0123, -0.0456), tolerance=5.1e-5)


def test_an_encoded_fix_is_read_back() -> None:
    (frame,) = fed(*encode(FIX, sid=9))
    assert frame.t_device == pytest.approx(FIX.utc, abs=1e-4)
    sample = frame.sample
    assert isinstance(sample, Gnss)
    assert (sample.lat, sample.lon) == (FIX.lat, FIX.lon)
    assert (sample.fix, sample.n_sat, sample.hdop, sample.alt) == (5, 12, 0.6, pytest.approx(-0.71))
    assert (sample.vel_n, sample.vel_e) == (pytest.approx(1.2, abs=6e-3), pytest.approx(-0.5, abs=6e-3))


def test_unavailable_fields_are_nan() -> None:
    void = Gnss(1.46e9, NAN, NAN)
    ((sample, _, _),) = fed(*encode(void))
    assert is_close(sample, void)
    assert fed(heading(0xFFFF, 0)) == []
    assert fed((identifier(nmea2000.TURN, 1), b"\0\xff\xff\xff\x7f\xff\xff\xff")) == []


def test_the_split_of_the_bytes_makes_no_difference() -> None:
    stream = can([*encode(AHRS), *encode(FIX), *encode(FIX, sid=1), (0x18EAFF05, b"\0\xee\0")])
    assert len(check_splits(lambda: Decoder(settle=0.0), stream)) == 4


def test_a_fast_packet_without_a_frame_is_left_out_and_counted() -> None:
    first, second = fast_packet(nmea2000.FIX, bytes(43), 1), fast_packet(nmea2000.FIX, bytes(43), 2)
    for frames, n_fixes, lost in (
        (first[:3] + first[4:], 0, 7 - 1),
        (first[:3] + second, 1, 3),
        (first[3:] + second, 1, 4),
        ([first[0], first[2], first[1], *second], 1, 3),
    ):
        there = Decoder(settle=0.0)
        assert len(fed(*frames, decoder=there)) == n_fixes
        assert counters(there) == (n_fixes, 0, lost * FRAME_BYTES)


def test_fast_packets_of_two_senders_may_be_interleaved() -> None:
    first_receiver = fast_packet(nmea2000.FIX, encode_body(FIX), 1, source=10)
    second_receiver = fast_packet(nmea2000.FIX, encode_body(FIX), 1, source=20)
    mixed = [frame for pair in zip(first_receiver, second_receiver, strict=True) for frame in pair]
    there = Decoder(settle=0.0)
    assert len(fed(*mixed, decoder=there)) == 1  # the sample of the lower address
    assert counters(there) == (2, 0, 0)


def encode_body(fix: Gnss) -> bytes:
    frames = [data for word, data in encode(fix) if split_identifier(word)[0] == nmea2000.FIX]
    return b"".join([frames[0][2:], *(data[1:] for data in frames[1:])])[:43]


def test_a_frame_that_is_too_short_is_counted() -> None:
    there = Decoder(settle=0.0)
    assert fed((identifier(nmea2000.ATTITUDE, 1), b"\0\0"), (identifier(nmea2000.FIX, 1), b"\0"), decoder=there) == []
    assert counters(there) == (0, 0, 2 * FRAME_BYTES)


def test_a_magnetic_heading_needs_a_variation() -> None:
    there = Decoder(settle=0.0)
    assert fed(heading(10_000, 1), decoder=there) == []
    assert "declination_deg" in there.remark
    bus = (identifier(nmea2000.VARIATION, 3), struct.pack("<BBHhH", 0, 0xFF, 0xFFFF, 200, 0xFFFF))
    for decoder, frames, east in (
        (there, (bus, heading(10_000, 1)), 0.02),
        (Decoder(settle=0.0), (heading(10_000, 1, variation=-300),), -0.03),
        (Decoder(declination=0.05, settle=0.0), (heading(10_000, 1),), 0.05),
        (Decoder(declination=0.05, settle=0.0), (heading(10_000, 0),), 0.0),
    ):
        ((sample, _, _),) = fed(*frames, decoder=decoder)
        assert isinstance(sample, Ahrs)
        assert sample.yaw == pytest.approx(1.0 + east)
        assert decoder.remark == ""


def test_of_several_compasses_another_is_used_if_the_first_is_silent() -> None:
    there = Decoder(declination=0.0, settle=0.0)
    true, magnetic, second = heading(100, 0, source=9), heading(200, 1, source=3), heading(300, 0, source=12)

    def yaws(t: float, *frames: tuple[int, bytes]) -> list[float]:
        found = [frame.sample for frame in fed(*frames, decoder=there, t=t)]
        return [round(sample.yaw / 1e-4) for sample in found if isinstance(sample, Ahrs)]

    assert yaws(1.0, magnetic, second, true, second, magnetic, true) == [200, 300, 100, 100]
    assert yaws(2.0, magnetic, second) == []
    assert yaws(3.5, magnetic, second) == [300]
    assert yaws(6.0, magnetic) == [200]
    assert yaws(6.1, true, magnetic) == [100]


def test_a_missing_satellite_count_does_not_change_the_used_receiver() -> None:
    there, uncounted = Decoder(settle=0.0), replace(FIX, n_sat=0)
    second_receiver = fast_packet(nmea2000.FIX, encode_body(FIX), 1, source=20)
    n_frames = []
    for k in range(30):
        leader = fast_packet(nmea2000.FIX, encode_body(FIX if k % 3 else uncounted), 1, source=10)
        n_frames.append(len(fed(*leader, *second_receiver, decoder=there, t=k / 2)))
    assert n_frames[2:] == [1] * 28
    assert len(fed(*second_receiver, decoder=there, t=17.5)) == 1


def test_a_speed_without_course_and_a_differential_fix_are_read() -> None:
    slow = replace(FIX, vel_n=NAN, vel_e=NAN, speed=0.4)
    ((sample, _, _),) = fed(*encode(slow))
    assert isinstance(sample, Gnss)
    assert (sample.speed, math.isnan(sample.vel_n)) == (0.4, True)
    dops = (identifier(nmea2000.DOPS, 35), b"\x5d\xcf\x3c\x00\x5a\x00\xff\x7f")
    flat = fed(dops, *encode(FIX))[0].sample
    assert isinstance(flat, Gnss)
    assert (flat.fix, flat.dimensions, sample.dimensions) == (FIX.fix, 2, 3)


def test_a_fix_has_the_speed_of_its_own_receiver() -> None:
    there = Decoder(settle=0.0)
    mine, *fix = encode(FIX, source=18)
    second_receiver, *_ = encode(replace(FIX, vel_n=9.0, speed=NAN), source=3)
    ((sample, _, _),) = fed(mine, second_receiver, *fix, decoder=there)
    assert isinstance(sample, Gnss)
    assert sample.vel_n == pytest.approx(FIX.vel_n, abs=6e-3)


def test_samples_wait_until_all_senders_are_known() -> None:
    there = Decoder()
    body = encode_body(FIX)
    slower, leader = (fast_packet(nmea2000.FIX, body, 1, source=source) for source in (20, 10))
    level, *_ = encode(Ahrs(NAN, 0.1, 0.2))
    n_frames = [len(fed(*frames, decoder=there, t=t)) for t, frames in (
        (1.0, slower), (1.3, leader), (2.0, slower), (2.3, leader), (3.0, slower), (3.3, leader)
    )]  # fmt: skip
    assert n_frames == [0, 0, 0, 1, 0, 1]
    found = [fed(heading(100, 0), level, heading(100, 1), decoder=there, t=t) for t in (1.0, 2.0, 2.3)]
    assert [len(frames) for frames in found] == [0, 0, 1]
    assert found[2][0].sample.roll == pytest.approx(0.2)  # type: ignore[union-attr]
    assert there.remark == ""
    there.reset()
    assert fed(heading(100, 0), decoder=there, t=3.0) == []
    assert fed(heading(100, 1), decoder=Decoder(), t=0.0) == []
    lost = Decoder()
    fed(heading(100, 1), decoder=lost, t=0.0)
    assert lost.remark == ""
    fed(heading(100, 1), decoder=lost, t=1.5)
    assert "declination_deg" in lost.remark


def test_an_old_course_is_not_that_of_a_new_fix() -> None:
    there = Decoder(settle=0.0)
    course, *fix = encode(FIX)
    fed(course, decoder=there, t=1.0)
    ((sample, _, _),) = fed(*fix, decoder=there, t=3.5)
    assert isinstance(sample, Gnss)
    assert math.isnan(sample.vel_n)


@pytest.mark.parametrize("transmitted", [(AHRS, FIX), (FIX,), (AHRS,)])
def test_the_rate_is_the_rate_of_headings_or_of_fixes_if_no_headings_are_sent(
    tmp_path: Path, transmitted: tuple[Ahrs | Gnss, ...]
) -> None:
    text = (
        'format = "seatrial-rig 1"\nname = "r"\n[[device]]\nname = "bus"\nprotocol = "nmea2000"\n'
        'port = "slcan:can"\nrate_hz = 10.0\n'
    )
    rig = parse_rig(text, tmp_path / "rig.toml")
    device = rig.devices[0]
    assert device.bitrate == 250_000
    loop = DeviceLoop(device, SerialPort("can", 115200), make_decoder(device, rig), RunClock(), LogSink())
    for k in range(7):
        loop._decode_received(can([frame for sample in transmitted for frame in encode(sample, sid=k)]), 10.0 + k)
    assert loop._rated == 5  # from 1.2 s on


def test_a_receiver_with_a_fix_precedes_one_without() -> None:
    there, received = Decoder(settle=0.0), []
    void = replace(FIX, lat=NAN, lon=NAN, fix=0, n_sat=3)
    for k in range(6):
        blind = fast_packet(nmea2000.FIX, encode_body(void), k, source=5)
        seeing = fast_packet(nmea2000.FIX, encode_body(FIX), k, source=10)
        received += fed(*blind, *seeing, decoder=there, t=k / 2)
    assert [frame.sample.fix for frame in received if isinstance(frame.sample, Gnss)] == [0, *[5] * 6]
    assert math.isnan(received[0].t_device)  # before its first fix a receiver sends the time of its own clock
    assert received[1].t_device == pytest.approx(FIX.utc, abs=1e-4)
    blind = fast_packet(nmea2000.FIX, encode_body(void), 0, source=5)
    assert (
        len(fed(*blind, decoder=there, t=2.5 + nmea2000.STALE_S + 0.1)) == 1
    )  # the second_receiver receiver is silent
