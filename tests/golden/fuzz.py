"""Fuzz test of every decoder: `python -m tests.golden.fuzz --n 1000000`.

An input consists of a few messages of the protocol, with bytes flipped, removed, doubled and inserted. It is fed whole
and in random pieces, and every tenth input also byte by byte. A decoder must raise no exception, and the samples and
counters must be the same for each way of feeding.
"""

from __future__ import annotations

import argparse
import random
import struct
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.drivers.base import LinkRole
from seatrial.daq.drivers.mavlink import MavlinkDriver
from seatrial.daq.protocol import (
    dbc,
    dronecan,
    loadcell,
    mantracourt,
    mavlink,
    mip,
    nmea,
    nmea2000,
    openscale,
    slcan,
    ubx,
    vectornav,
    vesc,
)
from seatrial.daq.protocol.canframe import pack_can
from seatrial.daq.protocol.decoder import Decoder
from seatrial.daq.protocol.framing import sentence
from seatrial.daq.protocol.mavlink_wire import Codec, EscStatus, crc16, dialect, encode_esc_status
from seatrial.daq.rig import DbcSignal
from seatrial.daq.samples import Ahrs, Esc, Gnss
from tests.daq.mavlink_ends import rig_text
from tests.daq.streams import comparable, counters

NMEA2000 = (DbcSignal("EngineParametersRapid", "EngineSpeed", "rpm", "EngineInstance"),)
_FIX = Gnss(1.7e9, 41.1, -8.6, 12.0, 0.5, -0.2, 0.1, 3, 11, 0.9, 0.4)
_ESC = Esc(3, 1234.0, 2.5, 0.3, 16.2, 31.0)
_AHRS = Ahrs(0.1, 0.2, -0.3, 0.01, 0.02, 0.03, 0.1, 0.2, -9.8, 1e-5, 2e-5, 4e-5)


class Subject(NamedTuple):
    """A decoder and the messages that it decodes."""

    make: Callable[[], Decoder]
    messages: tuple[bytes, ...]


def _can(frames: list[tuple[int, bytes]]) -> tuple[bytes, ...]:
    return tuple(pack_can(*frame) for frame in frames)


def subjects() -> dict[str, Subject]:
    """Return every decoder of the table of devices that needs no rig."""
    n2k = dbc.load_dbc(str(Path(dbc.__file__).with_name("nmea2000.dbc")))
    headings = (
        "GPHDT,123.4,T",
        "SDHDG,10.1,,,1.3,E",
        "GNTHS,77.5,A",
        "APROT,0.1,A",
        "PASHR,085335.000,224.1,T,-1.2,0.8,0",
    )
    compass = tuple(sentence(body) for body in headings)
    engine = tuple(pack_can(0x09F20011, bytes((k, 0x10 * k, 0x0C, 0xFF, 0xFF, 0x7F, 0xFF, 0xFF))) for k in range(3))
    ship = _can([*nmea2000.encode(_AHRS), *nmea2000.encode(_FIX)])
    return {
        "vectornav": Subject(vectornav.Decoder, (vectornav.encode_ascii(_AHRS), vectornav.encode_binary(_AHRS, 3.0))),
        "mip": Subject(mip.Decoder, _mip()),
        "nmea": Subject(lambda: nmea.Decoder(0.1), (*nmea.encode(_FIX).splitlines(keepends=True), *compass)),
        "ubx": Subject(lambda: ubx.Decoder(0.1), (ubx.encode(_FIX), _velned(), nmea.encode(_FIX), compass[0])),
        "loadcell": Subject(lambda: loadcell.Decoder(saturation=8388607), (loadcell.encode(2049), b"16383\n")),
        "openscale": Subject(openscale.Decoder, (openscale.encode(4.11, "kg", 21024, 8421504), b"4.11,lbs,\r\n")),
        "mantracourt": Subject(mantracourt.Decoder, (mantracourt.encode(123.456), b"?\r")),
        "slcan": Subject(slcan.Decoder, tuple(slcan.encode(*f) for f in vesc.encode_status(_ESC, 7))),  # type: ignore[arg-type]
        "vesc": Subject(lambda: vesc.Decoder({3: 7}), _can(vesc.encode_status(_ESC, 7))),
        "dronecan": Subject(dronecan.Decoder, (b"".join(_can(dronecan.encode(_ESC, 42, 7))),)),
        "dbc": Subject(lambda: dbc.Decoder(n2k, NMEA2000), engine),
        "nmea2000": Subject(lambda: nmea2000.Decoder(settle=0.0), ship),
        "mavlink": Subject(_autopilot_link, _mavlink()),
    }


def _mip() -> tuple[bytes, ...]:
    sensor = {k: struct.pack(">3f", 0.1, 0.2, -1.0) for k in (0x04, 0x05, 0x06)}
    place = struct.pack(">4d2fH", 41.0, -8.0, 60.0, 5.0, 0.5, 0.9, 0x1F)
    motion = struct.pack(">8fH", 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0x1F)
    return (
        mip.packet(mip.SENSOR, {**sensor, 0x0A: struct.pack(">4f", 0.7, 0.0, 0.0, 0.7)}),
        mip.packet(mip.FILTER, {0x05: struct.pack(">3fH", 0.01, 0.02, 0.5, 1)}),
        mip.packet(mip.GNSS_1, {0xD3: struct.pack(">dHH", 1e5, 2288, 3), 0x03: place, 0x05: motion}),
    )


RIG = parse_rig(rig_text(), Path("rig.toml"))


def _autopilot_link() -> Decoder:
    """Return the decoder of a link together with the driver that receives all its frames."""
    decoder = mavlink.make_decoder(RIG.devices[0], RIG)
    codec = Codec(255, 190)
    decoder.secure(codec)
    driver = MavlinkDriver(RIG.devices[0], RIG.thrusters, codec, LinkRole.DRIVE, decoder)

    def hear(message: object) -> None:
        driver.receive(message, 5.0)
        driver.poll(5.0)

    decoder.listener = hear
    return decoder


def _mavlink() -> tuple[bytes, ...]:
    """Return valid messages, and whole frames of each decoded message with random content."""
    codec, rng = Codec(1, 1), random.Random(5)
    right = [
        ("HEARTBEAT", 11, 3, 193, 0, 4, 3), ("ATTITUDE", 1020, 0.1, -0.2, 3.0, 0.01, 0.02, 0.03),
        ("RAW_IMU", 1_020_000, 1000, 0, -1000, 0, 0, 0, 100, 200, 300),
        ("GPS_RAW_INT", 1_020_000, 6, 423_580_000, -710_856_831, 1500, 121, 200, 445, 8998, 10, 0, 300, 300),
        ("SYSTEM_TIME", 1_795_144_521_000_000, 1020), ("SERVO_OUTPUT_RAW", 1_020_000, 0, 1900, 0, 1300, *[0] * 13),
        ("STATUSTEXT", 2, b"a" * 50, 7, 0), ("STATUSTEXT", 2, b"end", 7, 1), ("COMMAND_ACK", 511, 2),
        ("PARAM_VALUE", b"SERVO1_MIN", 1100.0, 9, 800, 20),
    ]  # fmt: skip
    status = EscStatus(5_000_000, (700, 0, -650, 0), (15.5, 0.0, 15.25, 0.0), (1.5, 0.0, 2.5, 0.0), 0)
    found = 8 * [*(codec.encode(*message) for message in right), encode_esc_status(1, 1, 9, status)]
    heard = {*mavlink.make_sample_converter(RIG.devices[0], RIG).wanted, *mavlink.SERVICE} - {"ESC_STATUS"}
    for name in sorted(heard):
        kind = dialect().mavlink_map[getattr(dialect(), f"MAVLINK_MSG_ID_{name}")]
        for _ in range(3):
            content = rng.randbytes(rng.randint(1, kind.unpacker.size))
            body = struct.pack("<BBBBBBHB", len(content), 0, 0, 0, 1, 1, kind.id & 0xFFFF, kind.id >> 16) + content
            found.append(b"\xfd" + body + crc16(body + bytes([kind.crc_extra])).to_bytes(2, "little"))
    return tuple(found)


def _velned() -> bytes:
    return ubx.message((0x01, 0x12), bytes(36))


def damaged(messages: tuple[bytes, ...], rng: random.Random) -> bytes:
    """Return up to three messages with up to four damaged places."""
    data = bytearray(b"".join(rng.choices(messages, k=rng.randint(1, 3))))
    for _ in range(rng.randint(0, 4)):
        if not data:
            break
        at, kind = rng.randrange(len(data)), rng.random()
        if kind < 0.4:
            data[at] ^= 1 << rng.randrange(8)
        elif kind < 0.6:
            del data[at : at + rng.randint(1, 12)]
        elif kind < 0.75:
            data[at:at] = data[at : at + rng.randint(1, 12)]
        elif kind < 0.9:
            data[at:at] = rng.randbytes(rng.randint(1, 8))
        else:
            data[at:at] = bytes((rng.choice(b"$\xfa\xb5\x62T*,\r\n"),))
    return bytes(data)


def _fed(make: Callable[[], Decoder], pieces: list[bytes]) -> tuple[object, ...]:
    decoder = make()
    frames = [frame for piece in pieces for frame in decoder.feed(piece, 5.0)]
    if isinstance(decoder, (nmea.Decoder, ubx.Decoder)):
        frames += decoder.flush()
    samples = frames if isinstance(decoder, slcan.Decoder) else comparable(frames)
    return samples, counters(decoder)


def _pieces(data: bytes, rng: random.Random) -> list[bytes]:
    cuts = sorted(rng.randrange(len(data) + 1) for _ in range(rng.randint(1, 5)))
    return [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]


def fuzz(subject: Subject, n: int, seed: int) -> int:
    """Feed `n` damaged inputs and return the number of samples. An AssertionError names the input that fails."""
    rng = random.Random(seed)
    n_samples = 0
    for k in range(n):
        data = damaged(subject.messages, rng)
        try:
            whole = _fed(subject.make, [data])
            ways = [_pieces(data, rng)] + ([[data[i : i + 1] for i in range(len(data))]] if k % 10 == 0 else [])
            same = all(_fed(subject.make, pieces) == whole for pieces in ways)
        except Exception as error:
            raise AssertionError(f"input {k}, {data.hex()}: {type(error).__name__}: {error}") from error
        assert same, f"input {k}, {data.hex()}: the samples depend on how the bytes were cut"
        n_samples += len(whole[0])  # type: ignore[arg-type]
    return n_samples


def main() -> int:
    """Fuzz all decoders, or the decoders named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__, epilog="Example: python -m tests.golden.fuzz --n 10000 ubx")
    parser.add_argument("names", nargs="*", help="decoders (default: all)")
    parser.add_argument("--n", type=int, default=100_000, help="inputs for each")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    every = subjects()
    for name in options.names or every:
        if name not in every:
            parser.error(f"no decoder {name}; there is: {', '.join(every)}")
        began = time.process_time()
        n_samples = fuzz(every[name], options.n, options.seed)
        print(
            f"{name:12s} {options.n} inputs, {n_samples} samples, {time.process_time() - began:.1f} s CPU", flush=True
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
