"""Commands to DroneCAN speed controllers: frames that others have put on a bus, the driver, and the rig's keys."""

from __future__ import annotations

from pathlib import Path

import pytest

from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.drivers.base import LinkRole
from seatrial.daq.drivers.dronecan import STATUS_S, DronecanDriver
from seatrial.daq.drivers.factory import make_driver
from seatrial.daq.drivers.setpoints import Due
from seatrial.daq.errors import SeatrialError
from seatrial.daq.protocol import dronecan
from seatrial.daq.protocol.canframe import CAN_FRAME, pack_can, unpack_can
from seatrial.daq.protocol.catalogue import make_decoder
from seatrial.daq.protocol.dronecan import Assembler, MessageType, frames_of
from seatrial.daq.rig import Rig
from seatrial.daq.samples import Esc

RIG = """
format = "seatrial-rig 1"
name = "bench"
[[device]]
name = "esc"
protocol = "dronecan"
port = "slcan:can"
rate_hz = 40.0
own_node = {own}
[[thruster]]
name = "left"
device = "esc"
node = {node}
position_m = [0.0, -0.15, 0.0]
rpm_max = 4500.0
[[thruster]]
name = "right"
device = "esc"
node = 3
position_m = [0.0, 0.15, 0.0]
rpm_max = 4500.0
reversed = true
"""


def rig(own: int = 100, node: int = 1) -> Rig:
    return parse_rig(RIG.format(own=own, node=node), "rig.toml")


def crc64(text: bytes) -> int:
    """Return the CRC-64-WE of a text, computed bit by bit. The specification computes signatures with it."""
    crc = 0xFFFFFFFFFFFFFFFF
    for byte in text:
        crc ^= byte << 56
        for _ in range(8):
            crc = (crc << 1 ^ (0x42F0E1EBA9EA3693 if crc >> 63 else 0)) & 0xFFFFFFFFFFFFFFFF
    return crc ^ 0xFFFFFFFFFFFFFFFF


def crc16(data: bytes, crc: int) -> int:
    """Return the CRC-16-CCITT of data, computed bit by bit."""
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ (0x1021 if crc >> 15 else 0)) & 0xFFFF
    return crc


def test_frames_of_a_command_equal_a_captured_bus() -> None:
    # Issue 68 of dronecan/libcanard: 1404067F, 13 5B 05 5F F3 C7 5D D3 is RawCommand [5651, 5569, 4095, 7453].
    values = [5651, 5569, 4095, 7453]
    seen = bytes.fromhex("135B055FF3C75DD3")
    assert dronecan.decode_command(seen[:-1]) == [value / dronecan.FULL for value in values]
    ours = dronecan.encode_command({k: value / dronecan.FULL for k, value in enumerate(values)}, 127, 0x13)
    assert [data for _, data in ours] == [seen]
    assert ours[0][0] & 0xFFFFFF == 0x1404067F & 0xFFFFFF  # all but the priority, which is ours to choose
    found = list(Assembler(dronecan.RAW_COMMAND).take(0x1404067F, seen, 1.0))
    assert found == [(seen[:-1], 1.0)]


def test_frame_of_a_node_status_equals_a_captured_bus() -> None:
    # jdefrance7/SeniorDesignProject, UAVCAN_Receiver_Test_v0: type 341, uptime 28 s, transfer 0; an Arduino printed 16
    # of the identifier's bits, 21782.
    ((identifier, data),) = dronecan.encode_node_status(28.9, 22, 0)
    assert identifier & 0xFFFF == 21782
    assert identifier >> 8 & 0xFFFF == 341
    assert data == bytes.fromhex("1C000000000000C0")


def test_signature_and_seed_follow_from_the_definition() -> None:
    definition = b"uavcan.equipment.esc.RawCommand\nsaturated int14[<=20] cmd"
    assert crc64(definition) == dronecan.RAW_COMMAND.signature
    # Seeds of libcanard's own tests.
    assert (dronecan.RAW_COMMAND.seed, dronecan.STATUS.seed) == (0xE4B8, 0x1591)


def test_more_than_four_controllers_take_several_frames_with_a_checksum() -> None:
    commands = {k: (-1.0) ** k * (k + 1) / 20 for k in range(20)}
    frames = dronecan.encode_command(commands, 5, 9)
    assert [len(data) for _, data in frames] == [8, 8, 8, 8, 8, 3]
    body = b"".join(data[:-1] for _, data in frames)
    assert int.from_bytes(body[:2], "little") == crc16(body[2:], 0xE4B8)
    assert [data[-1] for _, data in frames] == [0x89, 0x29, 0x09, 0x29, 0x09, 0x69]
    assembler = Assembler(dronecan.RAW_COMMAND)
    found = [payload for frame in frames for payload, _ in assembler.take(*frame, 0.0)]
    assert len(found) == 1
    assert dronecan.decode_command(found[0]) == pytest.approx(list(commands.values()), abs=0.5 / dronecan.FULL)


@pytest.mark.parametrize("n", [-1.0, -0.3, 0.0, 0.5, 1.0])
def test_ends_and_middle_are_exact(n: float) -> None:
    ((_, data),) = dronecan.encode_command({2: n}, 1, 0)
    first, second, found = dronecan.decode_command(data[:-1])
    assert (first, second) == (0.0, 0.0)
    assert found == pytest.approx(n, abs=0.5 / dronecan.FULL)
    assert (found == n) or n in (-0.3, 0.5)


@pytest.mark.parametrize("commands", [{0: 1.01}, {0: float("nan")}, {20: 0.0}, {-1: 0.0}])
def test_invalid_commands_are_rejected(commands: dict[int, float]) -> None:
    with pytest.raises(ValueError, match="is invalid; commands are -1 to 1"):
        dronecan.encode_command(commands, 1, 0)


@pytest.mark.parametrize("size", [0, 1, 7, 8, 14, 33])
def test_a_transfer_of_any_size_is_decoded_unchanged(size: int) -> None:
    kind, payload = MessageType(77, 0x1234567890ABCDEF, 40), bytes(range(size))
    assembler = Assembler(kind)
    found = [done for frame in frames_of(kind, payload, 3, 31) for done in assembler.take(*frame, 2.0)]
    assert found == [(payload, 2.0)]
    assert (assembler.unparsed_bytes, assembler.checksum_errors) == (0, 0)


def decoded(raw: bytes) -> tuple[list[list[float]], int]:
    """Return the commands in the bytes that a driver sends, and the number of NodeStatus messages."""
    assembler, found, statuses = Assembler(dronecan.RAW_COMMAND), [], 0
    for at in range(0, len(raw), CAN_FRAME.size):
        frame = unpack_can(raw[at : at + CAN_FRAME.size])
        assert frame is not None
        statuses += frame[0] >> 8 & 0xFFFF == dronecan.NODE_STATUS.number
        found += [dronecan.decode_command(payload) for payload, _ in assembler.take(*frame, 0.0)]
    return found, statuses


def test_each_message_contains_the_commands_of_all_controllers() -> None:
    driver = make_driver(rig().devices[0], rig(), make_decoder(rig().devices[0], rig()), LinkRole.DRIVE)
    assert isinstance(driver, DronecanDriver)
    ((raw, carried),) = driver.command([Due(1, 0.5, True)], {1: 0.5}, 10.0)
    assert carried == [Due(1, 0.5, True)]
    commands, statuses = decoded(raw)
    assert commands == [pytest.approx([0.0, 0.5, 0.0, 0.0], abs=1e-4)]
    assert statuses == 1
    ((raw, _),) = driver.command([Due(3, 0.25, True)], {1: 0.5, 3: 0.25}, 10.0 + STATUS_S / 2)
    assert decoded(raw) == ([pytest.approx([0.0, 0.5, 0.0, -0.25], abs=1e-4)], 0)  # 3 is reversed
    ((raw, _),) = driver.command([], {1: 0.5, 3: 0.25}, 10.0 + STATUS_S)
    assert decoded(raw)[1] == 1
    ((raw, _),) = driver.zero(12.0)
    assert decoded(raw) == ([[0.0, 0.0, 0.0, 0.0]], 0)


def test_successive_transfers_have_different_counters() -> None:
    driver = DronecanDriver(frozenset({0}), frozenset(), 7)
    numbers = []
    for k in range(40):
        ((raw, _),) = driver.zero(float(k))
        frame = unpack_can(raw)
        assert frame is not None
        numbers.append(frame[1][-1] & 0x1F)
    assert numbers == [k % 32 for k in range(40)]


def test_a_reversed_controller_reports_speeds_of_opposite_sign() -> None:
    decoder = make_decoder(rig().devices[0], rig())
    wire = [pack_can(*f) for node in (1, 3) for f in dronecan.encode(Esc(node, -900.0), 20 + node, 0)]
    found = {f.sample.node: f.sample.rpm for f in decoder.feed(b"".join(wire), 1.0) if isinstance(f.sample, Esc)}
    assert found == {1: -900.0, 3: 900.0}


def test_invalid_nodes_of_a_rig_are_rejected(tmp_path: Path) -> None:
    assert [thruster.pole_pairs for thruster in rig().thrusters] == [1, 1]
    assert rig(own=42).devices[0].own_node == 42
    with pytest.raises(SeatrialError, match=r"thruster.*node.*19"):
        rig(node=20)
    with pytest.raises(SeatrialError, match=r"own_node.*127"):
        rig(own=128)
    alone = parse_rig(RIG.partition("[[thruster]]")[0].format(own=100), "rig.toml")
    assert make_driver(alone.devices[0], alone, make_decoder(alone.devices[0], alone), LinkRole.DRIVE) is None
