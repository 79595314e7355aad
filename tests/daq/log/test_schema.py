"""Tests of the message schemas: standard types, encoding and decoding of every sample."""

from __future__ import annotations

import math
from dataclasses import astuple, fields
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from seatrial.daq.geometry import euler_angles, quaternion
from seatrial.daq.log import schema
from seatrial.daq.log.cdr import cdr_layout, flatten, full_definition
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Ahrs, Command, Esc, Frame, Gnss, LoadCell, Scalar
from tests.daq.logs import HEALTH, SAMPLES, T0, recorder, write_everything

STANDARD = [schema.IMU, schema.MAG, schema.FIX, schema.TWIST, schema.WRENCH]


@pytest.mark.parametrize("type_name", STANDARD)
def test_standard_types_are_the_standard_ones(type_name: str) -> None:
    theirs = get_typestore(Stores.ROS2_HUMBLE).generate_msgdef(type_name, ros_version=2)[0]

    def blocks(text: str) -> list[list[str]]:  # the type itself, and the types that it needs in any order
        first, *rest = (block.split() for block in text.split("=" * 80))
        return [first, *sorted(rest)]

    assert blocks(full_definition(type_name)) == blocks(theirs)


@pytest.mark.parametrize("kind", list(schema.TYPES))
def test_own_types_have_the_fields_of_their_samples(kind: type) -> None:
    names = [field.name for field in flatten(schema.TYPES[kind])[3:]]
    assert names == ["t_rx", "t_device", *(field.name for field in fields(kind))]


def test_every_message_reads_back_in_rosbags(tmp_path: Path) -> None:
    path = tmp_path / "all.mcap"
    write_everything(path, n_rounds=3)
    seen: dict[str, int] = {}
    with AnyReader([path]) as reader:
        for connection, log_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            # Their serialiser must turn the result of their deserialiser into our bytes again.
            again = bytes(reader.typestore.serialize_cdr(message, connection.msgtype))
            assert again[: len(data)] == bytes(data)
            assert not any(again[len(data) :])
            assert log_ns >= T0 * 1e9
            seen[connection.topic] = seen.get(connection.topic, 0) + 1
            _check(connection.topic, message)
    assert seen == open_log(path).counts
    assert set(seen.values()) == {3, 6}
    assert len(seen) == 17


def _check(topic: str, message: object) -> None:
    m: object = message
    if topic == "/gnss/gnss":
        assert m.utc == 1.7e9  # type: ignore[attr-defined]
    elif topic == "/esc/1/state":
        assert (m.node, m.rpm, m.temperature) == (1, -1234.5, 31.0)  # type: ignore[attr-defined]
    elif topic == "/loadcell/wrench":
        assert m.wrench.force.x == -42.5  # type: ignore[attr-defined]
        assert m.header.frame_id == "loadcell"  # type: ignore[attr-defined]
    elif topic == "/imu/imu":
        assert m.orientation_covariance[0] == -1.0  # type: ignore[attr-defined]
        assert m.angular_velocity.z == 3.0  # type: ignore[attr-defined]
        assert m.header.frame_id == "imu_frd_ned"  # type: ignore[attr-defined]
    elif topic == "/raw/ahrs":
        assert bytes(m.data) == (b"" if m.direction else bytes(range(256)))  # type: ignore[attr-defined]
    elif topic == "/health/ahrs":
        assert (m.port, m.reconnects, m.clock_bias) == (HEALTH.port, 5, 0.004)  # type: ignore[attr-defined]


def test_every_sample_is_read_back_unchanged(tmp_path: Path) -> None:
    path = tmp_path / "all.mcap"
    write_everything(path)
    log = open_log(path)
    for kind in (Ahrs, Gnss, Esc, Command, LoadCell, Scalar):
        for source in dict.fromkeys(device for device, sample in SAMPLES if isinstance(sample, kind)):
            written = [(k, s) for k, (device, s) in enumerate(SAMPLES) if isinstance(s, kind) and device == source]
            for node in {getattr(sample, "node", None) for _, sample in written}:
                mine = [(k, s) for k, s in written if getattr(s, "node", None) == node]
                table = log.table(kind, source, node)
                names = [field.name for field in fields(kind)]
                assert list(table.dtype.names or ()) == ["t", "t_rx", "t_device", *names]
                expected = np.array([astuple(sample) for _, sample in mine], float)
                found = np.array([[float(row[name]) for name in names] for row in table])
                np.testing.assert_allclose(found, expected, rtol=0, atol=1e-15)
                times = T0 + 0.01 * np.array([k for k, _ in mine])
                np.testing.assert_allclose(table["t"], times, rtol=0, atol=5e-7)
                np.testing.assert_allclose(table["t_rx"], times + 0.001, rtol=0, atol=5e-7)
                assert not table["t_device"].any()


angle = st.floats(-math.pi, math.pi)


@given(yaw=angle, pitch=st.floats(-1.57, 1.57), roll=angle)
def test_quaternion_and_angles_are_converted_both_ways(yaw: float, pitch: float, roll: float) -> None:
    q = quaternion(yaw, pitch, roll)
    assert math.hypot(*q) == pytest.approx(1.0)
    found = euler_angles(*(np.array([part]) for part in q))
    # asin loses half of the digits at the poles
    for one, other, tolerance in zip(found, (yaw, pitch, roll), (1e-9, 1e-7, 1e-9), strict=True):
        difference = math.remainder(float(one[0]) - other, 2.0 * math.pi)
        assert abs(difference) < tolerance


def test_quaternion_rotates_body_to_ned() -> None:
    x, y, z, w = quaternion(math.pi / 2, 0.0, 0.0)  # bow to the east
    bow = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])
    np.testing.assert_allclose(bow, [0.0, 1.0, 0.0], atol=1e-15)
    x, y, z, w = quaternion(0.0, math.pi / 6, 0.0)  # bow raised, so the down component is negative
    assert 2 * (x * z - w * y) == pytest.approx(-0.5)


@settings(max_examples=40, deadline=None)
@given(frame_id=st.text(st.characters(codec="ascii", min_codepoint=33), max_size=12), value=st.floats())
def test_packed_messages_are_read_by_the_dtype_of_the_layout(frame_id: str, value: float) -> None:
    found = cdr_layout(schema.TYPES[Scalar], frame_id.encode())
    data = found.pack(1_234_567_890_123_456_789, 1.5, 2.5, value)
    assert len(data) == found.dtype.itemsize
    row = np.frombuffer(data, found.dtype)[0]
    assert (row["sec"], row["nanosec"], row["t_rx"], row["t_device"]) == (1_234_567_890, 123_456_789, 1.5, 2.5)
    np.testing.assert_equal(float(row["value"]), value)


def test_a_text_may_contain_any_characters(tmp_path: Path) -> None:
    log = recorder(tmp_path / "a.mcap")
    log.event(T0, "mark", "a\0b \udc80 \N{WAVE DASH}\n")
    log.close()
    assert open_log(tmp_path / "a.mcap").events() == [(T0, "mark", "ab ? \N{WAVE DASH}\n")]


def test_a_port_state_is_not_a_measurement() -> None:
    with pytest.raises(TypeError, match="PortHealth is not a measurement"):
        list(schema.messages("x", Frame(HEALTH, 0.0, 0.0)))


def test_angles_beside_an_unknown_angle_are_kept(tmp_path: Path) -> None:
    """A receiver with two antennas measures heading and pitch, one with a single antenna no heading."""
    nan = math.nan
    sent = [(yaw, pitch, roll) for yaw in (0.3, nan) for pitch in (-0.2, nan) for roll in (0.1, nan)]
    log = recorder(tmp_path / "run.mcap")
    for k, angles in enumerate(sent):
        log.write("gnss", Frame(Ahrs(*angles), T0 + k, nan), T0 + k)
    log.close()
    with open_log(tmp_path / "run.mcap") as opened:
        table = opened.table(Ahrs, "gnss")
    np.testing.assert_allclose(np.column_stack([table[n] for n in ("yaw", "pitch", "roll")]), sent, atol=1e-15)
