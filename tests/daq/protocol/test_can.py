"""Tests of shaft speed from CAN: any DBC, NMEA 2000, and DroneCAN's esc.Status."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from seatrial.daq.errors import SeatrialError
from seatrial.daq.protocol import dbc, dronecan
from seatrial.daq.protocol.canframe import CAN_FRAME, EXTENDED, pack_can
from seatrial.daq.rig import SOURCE, DbcSignal
from seatrial.daq.samples import Esc
from tests.daq.streams import check_splits, counters, is_close

PLAIN = """VERSION ""
NS_ :
BS_:
BU_: X
BO_ 289 Motor: 8 X
 SG_ Speed : 0|16@1- (0.5,0) [0|0] "rpm" X
 SG_ Current : 16|16@1- (0.1,0) [0|0] "A" X
 SG_ Unit : 32|8@1+ (1,0) [0|0] "" X
BO_ 290 Supply: 4 X
 SG_ Volt : 0|16@1+ (0.01,0) [0|0] "V" X
"""
MAP = (
    DbcSignal("Motor", "Speed", "rpm", "Unit", -0.5),
    DbcSignal("Motor", "Current", "current", "Unit"),
    DbcSignal("Supply", "Volt", "voltage", 2),
)
NMEA2000 = (DbcSignal("EngineParametersRapid", "EngineSpeed", "rpm", SOURCE),)


@pytest.fixture
def database(tmp_path: Path) -> object:
    path = tmp_path / "plain.dbc"
    path.write_text(PLAIN)
    return dbc.load_dbc(str(path))


def motor(rpm: float, current: float, unit: int) -> bytes:
    raw = round(rpm / 0.5).to_bytes(2, "little", signed=True) + round(current / 0.1).to_bytes(2, "little", signed=True)
    return CAN_FRAME.pack(289, 8, raw + bytes((unit, 0, 0, 0)))


def test_any_dbc_gives_a_sample_for_each_rpm(database: object) -> None:
    decoder = dbc.Decoder(database, MAP)
    supply = CAN_FRAME.pack(290, 4, (2410).to_bytes(2, "little") + b"\0\0")
    assert decoder.feed(supply, 1.0) == []
    frames = decoder.feed(motor(-300.0, 4.5, 2) + motor(100.0, -1.0, 1), 1.5)
    assert is_close(frames[0].sample, Esc(2, 150.0, 4.5, voltage=24.1))
    assert is_close(frames[1].sample, Esc(1, -50.0, -1.0))
    (later,) = decoder.feed(motor(0.0, 0.0, 2), 1.0 + dbc.STALE + 0.1)
    assert is_close(later.sample, Esc(2, 0.0, 0.0))  # the voltage is too old to be repeated
    assert counters(decoder) == (4, 0, 0)


def test_identifiers_of_11_and_29_bits_are_not_the_same(database: object) -> None:
    decoder = dbc.Decoder(database, MAP)
    assert decoder.feed(CAN_FRAME.pack(289 | EXTENDED, 8, bytes(8)), 1.0) == []
    assert decoder.frames == 0


def test_a_short_message_is_counted(database: object) -> None:
    decoder = dbc.Decoder(database, MAP)
    assert decoder.feed(CAN_FRAME.pack(289, 3, b"\1\2\3\0\0\0\0\0"), 1.0) == []
    assert counters(decoder) == (0, 0, 16)


def test_a_name_missing_in_the_dbc_is_reported_with_the_existing_names(database: object, tmp_path: Path) -> None:
    with pytest.raises(SeatrialError, match="no message 'Engine'; name one in the rig that it has: Motor, Supply"):
        dbc.Decoder(database, (DbcSignal("Engine", "Speed", "rpm", 1),))
    with pytest.raises(
        SeatrialError, match="no signal of Motor 'rpm'; name one in the rig that it has: Speed, Current, Unit"
    ):
        dbc.Decoder(database, (DbcSignal("Motor", "rpm", "rpm", 1),))
    with pytest.raises(SeatrialError, match="no signal of Motor 'Node'"):
        dbc.Decoder(database, (DbcSignal("Motor", "Speed", "rpm", "Node"),))
    (tmp_path / "bad.dbc").write_text("BO_ nonsense")
    with pytest.raises(SeatrialError, match="not a DBC file"):
        dbc.load_dbc(str(tmp_path / "bad.dbc"))


def test_nmea2000_is_identified_by_its_pgn_for_any_sender_and_priority() -> None:
    decoder = dbc.Decoder(dbc.load_dbc(str(Path(dbc.__file__).with_name("nmea2000.dbc"))), NMEA2000)
    data = bytes((0, 0x40, 0x0C, 0xFF, 0xFF, 0x7F, 0xFF, 0xFF))  # 784 rpm
    (a,) = decoder.feed(pack_can(2 << 26 | 127488 << 8 | 17, data), 1.0)
    (b,) = decoder.feed(pack_can(6 << 26 | 127488 << 8 | 35, data), 1.0)
    assert [(s.sample.node, s.sample.rpm) for s in (a, b) if isinstance(s.sample, Esc)] == [(17, 784.0), (35, 784.0)]
    assert decoder.feed(pack_can(2 << 26 | 127489 << 8 | 17, data), 1.0) == []
    (absent,) = decoder.feed(pack_can(2 << 26 | 127488 << 8 | 17, b"\0\xff\xff" + data[3:]), 1.0)
    assert isinstance(absent.sample, Esc)
    assert math.isnan(absent.sample.rpm)


# Written by the dronecan library 1.0.27: esc.Status of node 42 in transfers 0, 1, 2.
LIBRARY = (
    (0x10040A2A, "79bb000000000d80"), (0x10040A2A, "4c0043d85cd20420"), (0x10040A2A, "0c8040"),
    (0x10040A2A, "ca66070000000081"), (0x10040A2A, "5200bea95ce0b121"), (0x10040A2A, "ff9441"),
    (0x10040A2A, "75ccffffffff0082"), (0x10040A2A, "4a4056785dffff22"), (0x10040A2A, "407c42"),
)  # fmt: skip
SENT = (
    Esc(0, 1234.0, 3.5, voltage=16.2, temperature=310.0 - 273.15),
    Esc(5, -20000.0, -1.5, voltage=48.0, temperature=298.15 - 273.15),
    Esc(31, 131071.0, 100.0, voltage=12.0, temperature=350.0 - 273.15),
)
WIRE = b"".join(pack_can(identifier, bytes.fromhex(data)) for identifier, data in LIBRARY)


def test_esc_status_written_by_the_library_is_read() -> None:
    frames = check_splits(dronecan.Decoder, WIRE)
    assert len(frames) == 3
    for frame, sent in zip(frames, SENT, strict=True):
        assert is_close(frame.sample, sent, rel=1e-3, tolerance=0.13)  # these fields have 16 bits on the wire


def test_frames_equal_the_frames_of_the_library() -> None:
    ours = dronecan.encode(Esc(3, -1234.0, 3.5, voltage=16.2, temperature=310.0 - 273.15), 42, 7)
    library = ("58a7000000000d87", "4c0043d85c2efb27", "c00c47")
    assert [(identifier, data.hex()) for identifier, data in ours] == [(0x10040A2A, data) for data in library]


@pytest.mark.parametrize("lost", range(9))
def test_a_transfer_without_a_frame_is_counted_and_the_next_is_read(lost: int) -> None:
    frames = [WIRE[16 * k : 16 * k + 16] for k in range(9) if k != lost]
    decoder = dronecan.Decoder()
    found = decoder.feed(b"".join(frames), 1.0)
    assert len(found) == 2
    decoder.reset()
    assert decoder.unparsed_bytes == 32
    assert decoder.checksum_errors == 0


def test_a_wrong_checksum_of_a_transfer_is_counted() -> None:
    wire = bytearray(WIRE[:48])
    wire[16 + 8 + 2] ^= 1
    decoder = dronecan.Decoder()
    assert decoder.feed(bytes(wire), 1.0) == []
    assert counters(decoder) == (0, 1, 0)


def test_two_nodes_may_be_interleaved() -> None:
    a, b = ([pack_can(*f) for f in dronecan.encode(Esc(k, 100.0 * k), 10 + k, k)] for k in (1, 2))
    wire = b"".join(frame for pair in zip(a, b, strict=True) for frame in pair)
    found = [frame.sample for frame in dronecan.Decoder().feed(wire, 1.0)]
    assert [(s.node, s.rpm) for s in found if isinstance(s, Esc)] == [(1, 100.0), (2, 200.0)]


def test_special_codes_in_place_of_a_number_are_not_values(tmp_path: Path) -> None:
    (tmp_path / "j1939.dbc").write_text(
        """VERSION ""
NS_ :
BS_:
BU_: X
BO_ 2364540158 EEC1: 8 X
 SG_ EngineSpeed : 24|16@1+ (0.125,0) [0|8031.875] "rpm" X
 SG_ Load : 16|8@1+ (1,0) [0|250] "%" X
 SG_ Distance : 40|24@1+ (1,0) [0|0] "m" X
BO_ 2314338814 Page1: 8 X
 SG_ Raw : 0|16@1+ (1,0) [0|0] "" X
 SG_ Angle : 16|16@1- (1,0) [0|0] "" X
 SG_ Four : 32|4@1+ (1,0) [0|0] "" X
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
BA_ "VFrameFormat" BO_ 2364540158 3;
BA_ "VFrameFormat" BO_ 2314338814 3;
"""
    )
    eec1, page_1 = dbc.load_dbc(str(tmp_path / "j1939.dbc")).messages
    if eec1.name != "EEC1":
        eec1, page_1 = page_1, eec1
    shipped = dbc.load_dbc(str(Path(dbc.__file__).with_name("nmea2000.dbc"))).messages[0]
    for message, name, last in (
        (eec1, "EngineSpeed", 0xFAFF), (eec1, "Load", 0xFA), (eec1, "Distance", 0xFAFFFF),
        (page_1, "Raw", 0xFFFC), (page_1, "Angle", 0x7FFC), (page_1, "Four", 0xD),
        (shipped, "EngineSpeed", 0xFAFF), (shipped, "EngineInstance", 0xFC),
    ):  # fmt: skip
        assert math.isfinite(dbc.number(message, name, last)), name
        assert math.isnan(dbc.number(message, name, last + 1)), name
