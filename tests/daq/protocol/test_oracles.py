"""Comparison of our decoders and encoders with independent libraries: pyubx2, dronecan, nmea2000 (canboat's database),
MSCL.
"""

from __future__ import annotations

import calendar
import json
import math
import struct
from collections.abc import Iterator
from typing import Any

import dronecan as pydronecan
import numpy as np
import pytest
from dronecan.transport import Frame as CanFrame
from dronecan.transport import Transfer
from nmea2000.decoder import NMEA2000Decoder
from pyubx2 import GET, UBXMessage, UBXReader

from seatrial.daq.protocol import dronecan, mip, nmea2000, ubx
from seatrial.daq.protocol.canframe import pack_can
from seatrial.daq.samples import NAN, Ahrs, Esc, Gnss
from tests.golden import mip_oracle
from tests.measured.data import measured

N = 200  # number of random messages of each kind
T = 1_700_000_000


def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def epoch(*messages: bytes) -> Gnss:
    """Return the single fix in these UBX messages."""
    decoder = ubx.Decoder()
    frames = decoder.feed(b"".join(messages), 0.0) + decoder.flush()
    assert decoder.checksum_errors == decoder.unparsed_bytes == 0
    (gnss,) = (frame.sample for frame in frames if isinstance(frame.sample, Gnss))
    return gnss


def nav(name: str, payload: bytes) -> tuple[bytes, Any]:
    """Return a NAV message framed by pyubx2, and its fields as read by pyubx2."""
    framed = UBXMessage("NAV", f"NAV-{name}", GET, payload=payload).serialize()
    return framed, UBXReader.parse(framed)


def pvt(random: np.random.Generator) -> tuple[bytes, Any]:
    lon, lat = random.integers(-1_800_000_000, 1_800_000_001), random.integers(-900_000_000, 900_000_001)
    height, h_msl, *velocity = random.integers(-1_000_000, 1_000_001, 5)
    payload = struct.pack(
        "<IH5BBIi4B4i2I5iIIH", random.integers(604_800_000), 2023, 11, 14, 22, 13, 20, 7, 20,
        random.integers(-500_000_000, 500_000_000), random.integers(6), random.integers(256), 0, random.integers(40),
        lon, lat, height, h_msl, *random.integers(1, 100_000, 2), *velocity, 0, 0, 0, 0, 0,
    )  # fmt: skip
    return nav("PVT", payload.ljust(92, b"\0"))


def same_pvt(ours: Gnss, theirs: Any) -> None:
    carrier = {1: 6, 2: 5}.get(theirs.carrSoln)
    differential = 4 if theirs.diffSoln and theirs.fixType in (2, 3, 4) else None
    fix = (carrier or differential or {1: 1, 2: 2, 3: 3, 4: 3}.get(theirs.fixType, 0)) if theirs.gnssFixOk else 0
    when = calendar.timegm((theirs.year, theirs.month, theirs.day, theirs.hour, theirs.min, theirs.second))
    assert ours.fix == (fix if theirs.fixType else 0)
    assert ours.n_sat == theirs.numSV
    assert ours.utc == pytest.approx(when + 1e-9 * theirs.nano, abs=1e-6)
    if theirs.fixType:
        assert (ours.lat, ours.lon) == pytest.approx((theirs.lat, theirs.lon), abs=1e-9)
        assert (ours.alt, ours.sigma_h) == pytest.approx((theirs.hMSL / 1e3, theirs.hAcc / 1e3 / math.sqrt(2)))
    if ours.fix:
        velocity = (theirs.velN / 1e3, theirs.velE / 1e3, theirs.velD / 1e3)
        assert (ours.vel_n, ours.vel_e, ours.vel_d) == pytest.approx(velocity)


def test_nav_pvt_is_read_as_pyubx2_reads_it() -> None:
    random = rng()
    for _ in range(N):
        framed, theirs = pvt(random)
        same_pvt(epoch(framed), theirs)


def test_encoded_nav_pvt_is_read_by_pyubx2() -> None:
    theirs = UBXReader.parse(ubx.encode(Gnss(T + 0.25, 41.1234567, -8.7654321, 12.345, 0.5, -0.25, 0.125, 5, 12)))
    assert (theirs.lat, theirs.lon, theirs.hMSL) == (41.1234567, -8.7654321, 12345)
    assert (theirs.velN, theirs.velE, theirs.velD) == (500, -250, 125)
    assert (theirs.gnssFixOk, theirs.carrSoln, theirs.numSV) == (1, 2, 12)


def test_an_epoch_of_older_messages_is_read_as_pyubx2_reads_it() -> None:
    """The epoch consists of POSLLH, VELNED, TIMEUTC and DOP with one time of week."""
    random = rng()
    for _ in range(N):
        i_tow = int(random.integers(604_800_000))
        place = random.integers(-900_000_000, 900_000_001, 2)
        heights, speeds = random.integers(-1_000_000, 1_000_001, 2), random.integers(-100_000, 100_001, 3)
        posllh, place_theirs = nav("POSLLH", struct.pack("<I4i2I", i_tow, *place, *heights, 1234, 99))
        velned, velocity = nav("VELNED", struct.pack("<I3iIIi2I", i_tow, *speeds, 0, 0, 0, 0, 0))
        nano = int(random.integers(-500_000_000, 500_000_000))
        timeutc, clock = nav("TIMEUTC", struct.pack("<IIiH5BB", i_tow, 9, nano, 2024, 2, 29, 23, 59, 58, 7))
        dop, precision = nav("DOP", struct.pack("<I7H", i_tow, *random.integers(50, 9999, 7)))
        sol, solution = nav("SOL", struct.pack("<IihBB3iI3iIHBBI", i_tow, 0, 2300, 3, 0x0D, 0, 0, 637_000_000, 9,
                                               0, 0, 0, 9, 120, 0, 11, 0))  # fmt: skip
        ours = epoch(posllh, velned, timeutc, dop, sol)
        when = calendar.timegm((clock.year, clock.month, clock.day, clock.hour, clock.min, clock.sec))
        assert ours.utc == pytest.approx(when + 1e-9 * clock.nano, abs=1e-6)
        assert (ours.lat, ours.lon) == pytest.approx((place_theirs.lat, place_theirs.lon), abs=1e-9)
        assert (ours.alt, ours.hdop) == pytest.approx((place_theirs.hMSL / 1e3, precision.hDOP))
        assert ours.sigma_h == pytest.approx(place_theirs.hAcc / 1e3 / math.sqrt(2))
        expected = (velocity.velN / 100, velocity.velE / 100, velocity.velD / 100)
        assert (ours.vel_n, ours.vel_e, ours.vel_d) == pytest.approx(expected)
        assert (ours.fix, ours.n_sat) == (solution.gpsFix, solution.numSV)


def test_a_position_of_high_precision_is_read_as_pyubx2_reads_it() -> None:
    random = rng()
    for _ in range(N):
        i_tow = int(random.integers(604_800_000))
        place = random.integers(-900_000_000, 900_000_001, 2)
        heights, parts = random.integers(-1_000_000, 1_000_001, 2), random.integers(-9, 10, 4)
        payload = struct.pack("<B2xBI4i4b2I", 0, 0, i_tow, *place, *heights, *parts, 140, 99)
        framed, theirs = nav("HPPOSLLH", payload)
        gps, _ = nav("SOL", struct.pack("<IihBB3iI3iIHBBI", i_tow, 0, 2300, 3, 0x0D, 0, 0, 637_000_000, 9,
                                        0, 0, 0, 9, 120, 0, 11, 0))  # fmt: skip
        ours = epoch(framed, gps)
        assert (ours.lat, ours.lon) == pytest.approx((theirs.lat, theirs.lon), abs=1.1e-9)
        assert ours.alt == pytest.approx(theirs.hMSL / 1e3, abs=1.1e-4)
        assert ours.sigma_h == pytest.approx(theirs.hAcc / 1e3 / math.sqrt(2))


def test_an_attitude_is_read_as_pyubx2_reads_it() -> None:
    random = rng()
    for _ in range(N):
        roll, pitch = random.integers(-9_000_000, 9_000_001, 2)
        payload = struct.pack("<IB3x3i3I", 5, 0, roll, pitch, random.integers(36_000_000), 9, 9, 9)
        framed, theirs = nav("ATT", payload)
        ((ours),) = (frame.sample for frame in ubx.Decoder().feed(framed, 0.0))
        assert isinstance(ours, Ahrs)
        assert (ours.roll, ours.pitch) == pytest.approx((math.radians(theirs.roll), math.radians(theirs.pitch)))
        assert math.remainder(ours.yaw - math.radians(theirs.heading), math.tau) == pytest.approx(0.0, abs=1e-12)


def test_status_and_high_rate_solutions_are_read_as_pyubx2_reads_them() -> None:
    random = rng()
    for _ in range(N):
        i_tow, fix = int(random.integers(604_800_000)), int(random.integers(5))
        place, flags = random.integers(-900_000_000, 900_000_001, 2), int(random.integers(4))
        posllh, there = nav("POSLLH", struct.pack("<I4i2I", i_tow, *place, 0, 5000, 1234, 99))
        status, kind = nav("STATUS", struct.pack("<I4B2I", i_tow, fix, flags, 0, 0, 0, 0))
        part = random.integers(-500_000, 500_000)
        timegps, clock = nav("TIMEGPS", struct.pack("<IihbBI", i_tow, part, 2300, 18, 7, 9))
        ours = epoch(posllh, status, timegps)
        week = 315_964_800 + 604_800 * clock.week - clock.leapS
        assert ours.utc == pytest.approx(week + i_tow / 1e3 + clock.fTOW * 1e-9, abs=1e-6)
        differential = 4 if kind.diffSoln and kind.gpsFix in (2, 3, 4) else None
        known = (differential or {4: 3}.get(kind.gpsFix, kind.gpsFix)) if kind.gpsFixOk else 0
        assert (ours.fix, ours.dimensions) == (known, {0: 0, 2: 2}.get(kind.gpsFix, 3))
        if kind.gpsFix:
            assert (ours.lat, ours.lon) == pytest.approx((there.lat, there.lon), abs=1e-9)
        speed, course = int(random.integers(30_000)), int(random.integers(36_000_000))
        payload = struct.pack(
            "<IH6Bi2B2x8i4I4x", i_tow, 2023, 11, 14, 22, 13, 20, 7, random.integers(-500_000_000, 500_000_000), fix,
            flags, *place, 0, 5000, speed, speed, course, course, 1234, 99, 0, 0,
        )  # fmt: skip
        framed = UBXMessage("HNR", "HNR-PVT", GET, payload=payload).serialize()
        theirs, ours = UBXReader.parse(framed), epoch(framed)
        assert ours.fix == known
        if theirs.gpsFix:
            assert (ours.lat, ours.lon) == pytest.approx((theirs.lat, theirs.lon), abs=1e-9)
            assert (ours.alt, ours.speed) == pytest.approx((theirs.hMSL / 1e3, theirs.gSpeed / 1e3))
            north = theirs.gSpeed / 1e3 * math.cos(math.radians(theirs.headMot))
            assert ours.vel_n == pytest.approx(north, abs=1e-6)


@pytest.mark.measured
def test_a_recorded_ubx_stream_is_read_as_pyubx2_reads_it() -> None:
    path = measured("ardurover") / "ubx.bin"
    decoder = ubx.Decoder()
    frames = decoder.feed(path.read_bytes(), 0.0) + decoder.flush()
    ours = {round(f.sample.utc * 1e3): f.sample for f in frames if isinstance(f.sample, Gnss) and f.sample.fix}
    with path.open("rb") as file:
        found = [message for _, message in UBXReader(file) if message is not None]
    places = [m for m in found if m.identity in ("NAV-PVT", "NAV-POSLLH")]
    theirs = {(round(m.lat * 1e7), round(m.lon * 1e7), m.hMSL) for m in places}
    assert len(ours) > 40
    for gnss in ours.values():
        assert (round(gnss.lat * 1e7), round(gnss.lon * 1e7), round(gnss.alt * 1e3)) in theirs


def test_mip_packets_are_read_as_mscl_reads_them() -> None:
    """The values read by MSCL 68.4.5 are in a file."""
    units = {"ax": 9.80665, "ay": 9.80665, "az": 9.80665, "mx": 1e-4, "my": 1e-4, "mz": 1e-4, "sigma_h": 0.5**0.5}
    n_values = 0
    for line in mip_oracle.FILE.read_text(encoding="ascii").splitlines():
        packet, values = json.loads(line).values()
        values = {name: value * units.get(name, 1.0) for name, value in values.items()}
        found = [frame.sample for frame in mip.Decoder().feed(bytes.fromhex(packet), 0.0)]
        if not values or math.isnan(values.get("yaw", 0.0)):
            assert found == []  # an unknown attitude
            continue
        (sample,) = found
        if isinstance(sample, Gnss):
            values["fix"] = {0: 3, 1: 2}.get(values.get("fix", -1), 0)
            values.setdefault("n_sat", -1)
            values.setdefault("speed", math.hypot(*(values.get(name, NAN) for name in ("vel_n", "vel_e"))))
            if "lat" not in values:
                values = {"fix": 0, "n_sat": values["n_sat"]}
            names = {"lat", "lon", "alt", "vel_n", "vel_e", "vel_d", "speed", "sigma_h", "hdop", "fix", "n_sat"}
        else:
            names = {*"pqr", "ax", "ay", "az", "mx", "my", "mz", "yaw", "pitch", "roll"}
        for name in names:
            assert getattr(sample, name) == pytest.approx(values.get(name, NAN), rel=1e-12, nan_ok=True), name
            n_values += name in values
    assert n_values > 600


def transfer(payload: Any, source: int, number: int, priority: int = 16) -> list[tuple[int, bytes]]:
    """Return the CAN frames of a message, made by the library."""
    made = Transfer(payload=payload, source_node_id=source, transfer_id=number, transfer_priority=priority)
    return [(frame.message_id, bytes(frame.bytes)) for frame in made.to_frames()]


def read_by_library(frames: list[tuple[int, bytes]]) -> Any:
    made = Transfer()
    made.from_frames([CanFrame(identifier, data, ts_monotonic=0.0) for identifier, data in frames])
    return made.payload


def statuses() -> Iterator[tuple[Any, int, int]]:
    random, esc = rng(), pydronecan.uavcan.equipment.esc
    for number in range(N):
        kind = esc.Status(
            error_count=int(random.integers(2**31)), voltage=float(random.uniform(0, 60)),
            current=float(random.uniform(-90, 90)), temperature=float(random.uniform(250, 400)),
            rpm=int(random.integers(-(2**17), 2**17)), power_rating_pct=int(random.integers(128)),
            esc_index=int(random.integers(32)),
        )  # fmt: skip
        yield kind, int(random.integers(1, 128)), number % 32


def test_esc_status_of_the_dronecan_library_is_read() -> None:
    decoder = dronecan.Decoder()
    for status, source, number in statuses():
        frames = transfer(status, source, number)
        data = b"".join(pack_can(*frame) for frame in frames)
        (ours,) = (frame.sample for frame in decoder.feed(data, 0.0))
        theirs = read_by_library(frames)
        assert isinstance(ours, Esc)
        assert (ours.node, ours.rpm) == (theirs.esc_index, theirs.rpm)
        assert (ours.voltage, ours.current) == (theirs.voltage, theirs.current)
        assert ours.temperature == theirs.temperature - 273.15
    assert decoder.checksum_errors == decoder.unparsed_bytes == 0


def test_dronecan_frames_equal_the_frames_of_the_library() -> None:
    uavcan, random = pydronecan.uavcan, rng()
    for number in range(N):
        commands = random.integers(-8191, 8192, random.integers(1, 21)).tolist()
        ours = dronecan.encode_command({k: n / 8191 for k, n in enumerate(commands)}, 42, number % 32)
        assert ours == transfer(uavcan.equipment.esc.RawCommand(cmd=commands), 42, number % 32, dronecan.URGENT)
        assert list(read_by_library(ours).cmd) == commands
        status = uavcan.protocol.NodeStatus(uptime_sec=number)
        assert dronecan.encode_node_status(number + 0.5, 42, number % 32) == transfer(status, 42, number % 32)


def canboat(decoder: NMEA2000Decoder, frames: list[tuple[int, bytes]]) -> dict[int, dict[str, Any]]:
    """Return the last message of each PGN as read by nmea2000: numbers in SI units by their identifiers."""
    found = {}
    for identifier, data in frames:
        message = decoder.decode(f"can0  {identifier:08X}   [{len(data)}]  {data.hex(' ').upper()}")
        if message is not None:
            found[message.PGN] = {field.id: field.raw_value for field in message.fields}
    return found


def test_encoded_nmea_2000_messages_are_read_by_nmea2000() -> None:
    random, decoder = rng(), NMEA2000Decoder()
    for number in range(N):
        yaw, rate = random.uniform(0.0, 6.28), random.uniform(-1, 1)
        pitch, roll = random.uniform(-1.5, 1.5, 2)
        ahrs = Ahrs(yaw, pitch, roll, r=rate)
        lat, lon, alt = random.uniform(-90, 90), random.uniform(-180, 180), random.uniform(-100, 3000)
        north, east = random.uniform(-20, 20, 2)
        gnss = Gnss(T + number / 4, lat, lon, alt, north, east, 0.0, 5, number % 30, hdop=1.25)
        theirs = canboat(decoder, [*nmea2000.encode(ahrs), *nmea2000.encode(gnss, number)])
        assert theirs[nmea2000.HEADING]["heading"] == pytest.approx(yaw, abs=5.1e-5)
        assert theirs[nmea2000.TURN]["rate"] == pytest.approx(rate, abs=1e-7)
        attitude = theirs[nmea2000.ATTITUDE]
        assert (attitude["pitch"], attitude["roll"]) == pytest.approx((pitch, roll), abs=5.1e-5)
        course = theirs[nmea2000.COURSE]
        assert course["sog"] == pytest.approx(math.hypot(north, east), abs=5.1e-3)
        assert math.remainder(course["cog"] - math.atan2(east, north), math.tau) == pytest.approx(0.0, abs=5.1e-5)
        fix = theirs[nmea2000.FIX]
        assert (fix["latitude"], fix["longitude"]) == pytest.approx((lat, lon), abs=1e-12)
        assert (fix["altitude"], fix["hdop"]) == pytest.approx((alt, 1.25), abs=1e-6)
        assert fix["date"] * 86400 + fix["time"] == pytest.approx(gnss.utc, abs=1e-4)
        assert (fix["numberOfSvs"], fix["method"]) == (number % 30, 4)


def test_nmea_2000_messages_are_read_as_nmea2000_reads_them() -> None:
    random, theirs_decoder = rng(), NMEA2000Decoder()
    for number in range(N):
        heading, deviation, variation = random.integers(62831), *random.integers(-3000, 3000, 2)
        frames = [
            (nmea2000.identifier(nmea2000.HEADING, 3), struct.pack("<BHhhB", 1, heading, deviation, variation, 0xFD)),
            (nmea2000.identifier(nmea2000.TURN, 3), struct.pack("<Bi3s", 1, random.integers(-(2**25), 2**25), b"\xff")),
        ]
        body = struct.pack(
            "<BHIqqqBBBhhiB", 1, 19000 + number, random.integers(864_000_000),
            *random.integers(-9 * 10**17, 9 * 10**17, 2), random.integers(-(10**8), 10**9),
            random.integers(9) << 4, 0xFC, random.integers(40), random.integers(2000), 150, 0, 0,
        )  # fmt: skip
        frames += nmea2000.fast_packet(nmea2000.FIX, body, number % 8, 3)
        theirs = canboat(theirs_decoder, frames)
        decoder = nmea2000.Decoder(settle=0.0)
        found = [frame.sample for frame in decoder.feed(b"".join(pack_can(*frame) for frame in frames), 0.0)]
        yaw, rate, fix = found
        assert isinstance(yaw, Ahrs)
        assert isinstance(rate, Ahrs)
        assert isinstance(fix, Gnss)
        compass, place = theirs[nmea2000.HEADING], theirs[nmea2000.FIX]
        true = compass["heading"] + compass["deviation"] + compass["variation"]
        assert math.remainder(yaw.yaw - true, math.tau) == pytest.approx(0.0, abs=1e-9)
        assert rate.r == pytest.approx(theirs[nmea2000.TURN]["rate"])
        assert (fix.lat, fix.lon) == pytest.approx((place["latitude"], place["longitude"]), abs=1e-12)
        assert (fix.alt, fix.hdop) == pytest.approx((place["altitude"], place["hdop"]))
        assert fix.utc == pytest.approx(place["date"] * 86400 + place["time"], abs=1e-4)
        assert (fix.n_sat, fix.fix) == (
            place["numberOfSvs"],
            {0: 0, 1: 3, 2: 4, 3: 3, 4: 5, 5: 6, 6: 1, 7: 1, 8: 3}[place["method"]],
        )


def test_other_values_of_headings_and_fixes_are_read_as_nmea2000_reads_them() -> None:
    """Attitude and variation; course, speed and dimensions."""
    random, theirs_decoder = rng(), NMEA2000Decoder()
    for _ in range(N):
        course, speed, angles = random.integers(62831), random.integers(3000), random.integers(-15000, 15000, 3)
        mode, heading, east = int(random.integers(1, 3)), int(random.integers(62831)), int(random.integers(-3000, 3000))
        frames = [
            (nmea2000.identifier(nmea2000.COURSE, 3), struct.pack("<BBHHH", 1, 0xFC, course, speed, 0xFFFF)),
            (nmea2000.identifier(nmea2000.DOPS, 3), struct.pack("<BBhhh", 1, 0xC3 | mode << 3, 60, 90, 100)),
            (nmea2000.identifier(nmea2000.ATTITUDE, 3), struct.pack("<B3hB", 1, *angles, 0xFF)),
            (nmea2000.identifier(nmea2000.VARIATION, 3), struct.pack("<BBHhH", 1, 0xF8, 19000, east, 0xFFFF)),
            (nmea2000.identifier(nmea2000.HEADING, 3), struct.pack("<BHhhB", 1, heading, 0x7FFF, 0x7FFF, 0xFD)),
            *nmea2000.encode(Gnss(T, 41.0, -8.0, fix=4, n_sat=9), source=3),
        ]
        theirs = canboat(theirs_decoder, frames)
        found = nmea2000.Decoder(settle=0.0).feed(b"".join(pack_can(*frame) for frame in frames), 0.0)
        level, fix = (frame.sample for frame in found)
        assert isinstance(level, Ahrs)
        assert isinstance(fix, Gnss)
        attitude, motion = theirs[nmea2000.ATTITUDE], theirs[nmea2000.COURSE]
        assert (level.pitch, level.roll) == pytest.approx((attitude["pitch"], attitude["roll"]))
        true = theirs[nmea2000.HEADING]["heading"] + theirs[nmea2000.VARIATION]["variation"]
        assert math.remainder(level.yaw - true, math.tau) == pytest.approx(0.0, abs=1e-9)
        assert (fix.speed, fix.dimensions) == (pytest.approx(motion["sog"]), theirs[nmea2000.DOPS]["actualMode"] + 1)
        assert (fix.vel_n, fix.vel_e) == pytest.approx(
            (motion["sog"] * math.cos(motion["cog"]), motion["sog"] * math.sin(motion["cog"]))
        )


@pytest.mark.measured
def test_fixes_of_a_recorded_bus_are_read_as_nmea2000_reads_them() -> None:
    """The capture contains a ship's receiver at address 18.

    The adapter has joined the fast packets; they are split again.
    """
    theirs_decoder, decoder = NMEA2000Decoder(), nmea2000.Decoder(settle=0.0)
    n_fixes = 0
    lines = (measured("can") / "susteranna-actisense-serial.raw").read_text(encoding="ascii").splitlines()
    for number, line in enumerate(lines):
        words = line.split(",")
        pgn, source, data = int(words[2]), int(words[3]), bytes.fromhex("".join(words[6:]))
        if (pgn, source) != (nmea2000.FIX, 18):
            continue
        frames = nmea2000.fast_packet(pgn, data, number % 8, source)
        place = canboat(theirs_decoder, frames)[pgn]
        (frame,) = decoder.feed(b"".join(pack_can(*frame) for frame in frames), 0.0)
        ours = frame.sample
        assert isinstance(ours, Gnss)
        assert (ours.lat, ours.lon) == pytest.approx((place["latitude"], place["longitude"]), abs=1e-12)
        assert ours.utc == pytest.approx(place["date"] * 86400 + place["time"], abs=1e-4)
        assert (ours.n_sat, ours.hdop) == (place["numberOfSvs"], pytest.approx(place["hdop"]))
        n_fixes += 1
    assert n_fixes == 31
