"""Tests of messages that a guess recognises by their type:

ROS 1, ROS 2 and PX4, each with its values in the axes of the log.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from seatrial.daq.importers.guess import guess_map
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Scalar
from tests.daq.csv_files import values
from tests.daq.ulog_files import Topic, needs_pyulog, write_ulog

N = 12
T0 = 1_700_000_000.0
YAW = math.radians(135.0)  # counted from east, counter-clockwise: north-west
NORTH_WEST = math.radians(-45.0)
Make = Callable[[SimpleNamespace, int], Any]


def found_in(source: Path) -> dict[str, float]:
    """Return the last values of the signals that the guessed map imports."""
    path = source.with_suffix(".map.toml")
    path.write_text(guess_map(source).text, encoding="utf-8")
    (log,) = import_files(path, [source], out=source.with_suffix(".mcap"))
    with open_log(log) as opened:
        names = opened.sources(Scalar)
    return {name: float(values(log, name)[1][-1]) for name in names}


def kinds(store: Any, is_first: bool) -> SimpleNamespace:
    """Return functions that make the parts of messages, for ROS 1 or 2."""
    types = store.types
    geometry = {name: types[f"geometry_msgs/msg/{name}"] for name in store_names(types, "geometry_msgs/msg/")}

    def header(k: int, frame: str) -> Any:
        t = types["builtin_interfaces/msg/Time"](int(T0), 50_000_000 * k)
        first = (k,) if is_first else ()
        return types["std_msgs/msg/Header"](*first, t, frame)

    return SimpleNamespace(
        header=header,
        turn=lambda: geometry["Quaternion"](0.0, 0.0, math.sin(YAW / 2), math.cos(YAW / 2)),
        twist=lambda: geometry["Twist"](geometry["Vector3"](1.0, 0.3, 0.0), geometry["Vector3"](0.0, 0.0, 0.5)),
        pose=lambda k, turn: geometry["Pose"](geometry["Point"](1.0 * k, 2.0, 0.0), turn),
        joints=types["sensor_msgs/msg/JointState"],
        **geometry,
    )


def store_names(types: Any, package: str) -> list[str]:
    return [name.removeprefix(package) for name in types if name.startswith(package)]


def joints(m: SimpleNamespace, k: int) -> Any:
    speeds = np.array([10.0 * k, -5.0 * k])
    return m.joints(m.header(k, ""), ["left_engine_joint", "right_engine_joint"], 0 * speeds, speeds, 0 * speeds)


BODY = {"u": 1.0, "v": -0.3, "r": -0.5}
EARTH = {"vx": 0.3, "vy": 1.0}
POSE = {"x": 2.0, "y": N - 1.0, "psi": NORTH_WEST}
MESSAGES: tuple[tuple[str, str, Make, dict[str, float]], ...] = (
    ("geometry_msgs/msg/TwistStamped", "/dvl/twist",
     lambda m, k: m.TwistStamped(m.header(k, "base_link"), m.twist()), BODY),
    ("geometry_msgs/msg/TwistStamped", "/gps/vel", lambda m, k: m.TwistStamped(m.header(k, ""), m.twist()), EARTH),
    ("geometry_msgs/msg/TwistWithCovarianceStamped", "/dvl/twist",
     lambda m, k: m.TwistWithCovarianceStamped(
         m.header(k, "base_link"), m.TwistWithCovariance(m.twist(), np.zeros(36))), BODY),
    ("geometry_msgs/msg/TwistWithCovarianceStamped", "/ekf/twist",
     lambda m, k: m.TwistWithCovarianceStamped(m.header(k, "map"), m.TwistWithCovariance(m.twist(), np.zeros(36))),
     EARTH),
    ("geometry_msgs/msg/PoseStamped", "/pose",
     lambda m, k: m.PoseStamped(m.header(k, "map"), m.pose(k, m.turn())), POSE),
    ("geometry_msgs/msg/PoseWithCovarianceStamped", "/pose",
     lambda m, k: m.PoseWithCovarianceStamped(
         m.header(k, "map"), m.PoseWithCovariance(m.pose(k, m.turn()), np.zeros(36))), POSE),
    ("geometry_msgs/msg/Pose2D", "/pose", lambda m, k: m.Pose2D(1.0 * k, 2.0, YAW), POSE),
    ("sensor_msgs/msg/JointState", "/joint_states", joints, {"n_left": 1.0, "n_right": -0.5}),
)  # fmt: skip


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize(("kind", "topic", "make", "expected"), MESSAGES)
def test_a_message_of_ros_is_recognised(
    tmp_path: Path, version: int, kind: str, topic: str, make: Make, expected: dict[str, float]
) -> None:
    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    parts = kinds(store, version == 1)
    path = tmp_path / ("run.bag" if version == 1 else "run")
    times = [round((T0 + 0.05 * k) * 1e9) for k in range(N)]
    if version == 1:
        with Writer1(path) as first:
            connection = first.add_connection(topic, kind, typestore=store)
            for k, t in enumerate(times):
                first.write(connection, t, store.serialize_ros1(make(parts, k), kind))
    else:
        with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as second:
            connection2 = second.add_connection(topic, kind, typestore=store)
            for k, t in enumerate(times):
                second.write(connection2, t, store.serialize_cdr(make(parts, k), kind))
    assert found_in(path) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("topic", "speed", "named", "offered"),
    [
        ("/joint_states", 1.0, {"n_left": "velocity.left_engine", "n_right": "velocity.right_engine"}, True),
        ("/joint_states", 0.0, {"n_left": "velocity.left_engine", "n_right": "velocity.right_engine"}, True),
        ("/thrusters/command", 0.0, {"n_left": "effort.left_engine", "n_right": "effort.right_engine"}, False),
        ("/thrusters/command", 1.0, {"n_left": "velocity.left_engine", "n_right": "velocity.right_engine"}, False),
    ],
)
def test_an_effort_of_a_joint_that_varies_is_in_the_map(
    tmp_path: Path, topic: str, speed: float, named: dict[str, str], offered: bool
) -> None:
    """In a topic of commands it is the command. In another one it may be a thrust, and is offered in a comment."""
    store, kind = get_typestore(Stores.ROS2_HUMBLE), "sensor_msgs/msg/JointState"
    parts, path = kinds(store, False), tmp_path / "run"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(topic, kind, typestore=store)
        for k in range(N):
            speeds, efforts = speed * k * np.array([1.0, -2.0, 0.0]), np.array([4.0 * k, -2.0 * k, 0.1 * k])
            names = ["left_engine", "right_engine", "rudder"]
            message = parts.joints(parts.header(k, ""), names, 0 * speeds, speeds, efforts)
            writer.write(connection, round((T0 + 0.05 * k) * 1e9), store.serialize_cdr(message, kind))
    text = guess_map(path).text
    assert {signal["name"]: signal["field"] for signal in tomllib.loads(text)["signal"]} == named
    line = f'# {{ name = "f_left", topic = "{topic}", field = "effort.left_engine", unit = "N", role = "input" }}'
    assert (line in text) is offered
    assert ("f_left in N if it is the thrust; give it the name of a command" in text) is offered
    assert f'# {{ name = "NAME", topic = "{topic}", field = "effort.rudder", unit = "1" }}' in text
    assert "effort.left_engine" in text


ATTITUDE = (math.cos(NORTH_WEST / 2), 0.0, 0.0, math.sin(NORTH_WEST / 2))
PX4: tuple[tuple[str, str, str, tuple[float, ...], dict[str, float]], ...] = (
    ("vehicle_odometry", "uint8_t velocity_frame;float[3] position;float[4] q;float[3] velocity", "B10f",
     (1, 7.0, 8.0, 0.0, *ATTITUDE, 0.5, -0.25, 0.0), {"x": 7.0, "y": 8.0, "psi": NORTH_WEST, "vx": 0.5, "vy": -0.25}),
    ("vehicle_odometry", "uint8_t velocity_frame;float[3] position;float[4] q;float[3] velocity", "B10f",
     (3, 7.0, 8.0, 0.0, *ATTITUDE, 0.5, -0.25, 0.0), {"x": 7.0, "y": 8.0, "psi": NORTH_WEST, "u": 0.5, "v": -0.25}),
    ("vehicle_local_position", "float x;float y;float vx;float vy;float heading", "5f",
     (7.0, 8.0, 0.5, -0.25, NORTH_WEST), {"x": 7.0, "y": 8.0, "vx": 0.5, "vy": -0.25, "psi": NORTH_WEST}),
    ("sensor_combined", "float[3] gyro_rad;float[3] accelerometer_m_s2", "6f",
     (0.1, 0.2, 0.3, 0.5, -0.25, -9.8), {"r": 0.3, "ax": 0.5, "ay": -0.25}),
    ("vehicle_acceleration", "float[3] xyz", "3f", (0.5, -0.25, -9.8), {"ax": 0.5, "ay": -0.25}),
    ("vehicle_gps_position", "int32_t lat;int32_t lon;float vel_n_m_s;float vel_e_m_s", "2i2f",
     (634400000, 104000000, 0.5, -0.25), {"x": 0.0, "y": 0.0, "vx": 0.5, "vy": -0.25}),
    ("actuator_motors", "float[4] control", "4f", (0.25, 0.5, 0.0, 0.0), {"n_left": 0.5, "n_right": 0.25}),
    ("actuator_outputs", "float[4] output", "4f", (1400.0, 1700.0, 0.0, 0.0), {"n_left": 0.5, "n_right": -0.25}),
)  # fmt: skip


@needs_pyulog
@pytest.mark.parametrize(("name", "fields", "form", "row", "expected"), PX4)
def test_a_topic_of_px4_is_recognised(
    tmp_path: Path, name: str, fields: str, form: str, row: tuple[float, ...], expected: dict[str, float]
) -> None:
    t = 5.0 + 0.1 * np.arange(N)
    write_ulog(tmp_path / "run.ulg", {name: Topic(fields, form, t, np.tile(row, (N, 1)))})
    assert found_in(tmp_path / "run.ulg") == pytest.approx(expected, abs=1e-6)
