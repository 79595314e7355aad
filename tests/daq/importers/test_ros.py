"""Tests of the import of ROS 1 and 2 bags written by rosbags: axes, times, names, and one line for each error."""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
import sqlite3
import tomllib
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import seatrial as st
from seatrial.daq import cli
from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.daq.importers.guess import guess_map
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.importers.ros import _TopicMessages, read_bag
from seatrial.daq.importers.sources import source_kind
from seatrial.daq.importers.table import SourceOptions
from seatrial.daq.log.reader import Log, open_log
from seatrial.daq.samples import Ahrs, Gnss, Scalar
from seatrial.daq.tools import export_ros
from tests.daq.logs import T0, write_everything

STORE = get_typestore(Stores.ROS2_HUMBLE)
N = 20


def header(k: int) -> object:
    stamp = STORE.types["builtin_interfaces/msg/Time"](int(T0), 50_000_000 * k)
    return STORE.types["std_msgs/msg/Header"](stamp, "base_link")


def imu(k: int) -> Any:
    """Return an IMU message of a boat at rest.

    The bow faces north-west, 135 degrees from east as ROS counts, and is raised by 10 degrees (pitch -10 in ROS).
    """
    vector, turn = STORE.types["geometry_msgs/msg/Vector3"], STORE.types["geometry_msgs/msg/Quaternion"]
    yaw, pitch = math.radians(135.0), math.radians(-10.0)
    attitude = turn(
        -math.sin(yaw / 2) * math.sin(pitch / 2), math.cos(yaw / 2) * math.sin(pitch / 2),
        math.sin(yaw / 2) * math.cos(pitch / 2), math.cos(yaw / 2) * math.cos(pitch / 2),
    )  # fmt: skip
    zero, none = np.zeros(9), np.array([-1.0] + [0.0] * 8)
    return STORE.types["sensor_msgs/msg/Imu"](
        header(k), attitude, zero, vector(0.1, 0.2, 0.3 + k), zero, vector(0.0, 0.0, 9.81), zero if k else none
    )


def fix(k: int) -> object:
    status = STORE.types["sensor_msgs/msg/NavSatStatus"](2, 1)
    covariance = np.array([0.04, 0, 0, 0, 0.04, 0, 0, 0, 0.1])
    return STORE.types["sensor_msgs/msg/NavSatFix"](header(k), status, 41.0 + 1e-6 * k, -8.0, 12.0, covariance, 2)


def odometry(k: int) -> object:
    types = STORE.types
    point, turn = types["geometry_msgs/msg/Point"](1.0 * k, 2.0, 3.0), types["geometry_msgs/msg/Quaternion"](0, 0, 0, 1)
    vector = types["geometry_msgs/msg/Vector3"]
    pose = types["geometry_msgs/msg/PoseWithCovariance"](types["geometry_msgs/msg/Pose"](point, turn), np.zeros(36))
    twist = types["geometry_msgs/msg/TwistWithCovariance"](
        types["geometry_msgs/msg/Twist"](vector(0.5, 0, 0), vector(0, 0, 0.1)), np.zeros(36)
    )
    return types["nav_msgs/msg/Odometry"](header(k), "base_link", pose, twist)


@pytest.fixture(params=[StoragePlugin.MCAP, StoragePlugin.SQLITE3], ids=["mcap", "sqlite3"])
def bag(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    path = tmp_path / "bag"
    messages = {
        "/imu/data": ("sensor_msgs/msg/Imu", imu),
        "/fix": ("sensor_msgs/msg/NavSatFix", fix),
        "/odom": ("nav_msgs/msg/Odometry", odometry),
        "/rpm": ("std_msgs/msg/Float64", lambda k: STORE.types["std_msgs/msg/Float64"](100.0 * k)),
        "/name": ("std_msgs/msg/String", lambda k: STORE.types["std_msgs/msg/String"]("boat")),
    }
    with Writer(path, version=9, storage_plugin=request.param) as writer:
        for topic, (kind, make) in messages.items():
            connection = writer.add_connection(topic, kind, typestore=STORE)
            for k in range(N):
                t_ns = round((T0 + 0.05 * k + 0.01) * 1e9)
                writer.write(connection, t_ns, STORE.serialize_cdr(make(k), kind))
    return path


def signals(source: Path, folder: Path, lines: str, root: str = 'frame = "ENU"') -> Log:
    """Return the log imported by a map of these signals."""
    path = folder / "map.toml"
    path.write_text(f'format = "seatrial-import 1"\n{root}\nsignal = [\n{lines}\n]\n')
    (out,) = import_files(path, [source], out_dir=folder / "logs", force=True)
    return open_log(out)


QUATERNION = 'fields = ["orientation.x", "orientation.y", "orientation.z", "orientation.w"]'
IMU = f"""
  {{ name = "psi", topic = "/imu/data", make = "yaw", {QUATERNION} }},
  {{ name = "theta", topic = "/imu/data", make = "pitch", {QUATERNION} }},
  {{ name = "q", topic = "/imu/data", field = "angular_velocity.y", unit = "rad/s" }},
  {{ name = "r", topic = "/imu/data", field = "angular_velocity.z", unit = "rad/s" }},
  {{ name = "az", topic = "/imu/data", field = "linear_acceleration.z", unit = "m/s2" }},
"""


def test_the_axes_of_ros_are_converted_by_one_key(bag: Path, tmp_path: Path) -> None:
    with signals(bag, tmp_path, IMU) as log:
        assert log.metadata["import"] == "ros"
        table = {name: log.table(Scalar, name) for name in log.sources(Scalar)}
    # the time of the header, not of the bag
    np.testing.assert_allclose(table["psi"]["t"], T0 + 0.05 * np.arange(N), atol=1e-6)
    assert table["psi"]["value"] == pytest.approx(math.radians(-45.0))  # north-west
    assert table["theta"]["value"] == pytest.approx(math.radians(10.0))  # the bow is raised
    assert (table["q"]["value"][0], table["r"]["value"][0]) == (-0.2, -0.3)
    np.testing.assert_array_equal(table["az"]["value"], -9.81)  # measured, although one covariance is marked as unknown
    with signals(bag, tmp_path, IMU, 'frame = "NED"') as log:
        assert log.table(Scalar, "psi")["value"] == pytest.approx(math.radians(135.0))
        assert log.table(Scalar, "r")["value"][0] == 0.3


def test_positions_of_odometry_and_of_fixes_are_imported(bag: Path, tmp_path: Path) -> None:
    lines = """
  { name = "x", topic = "/odom", field = "pose.pose.position.x", unit = "m" },
  { name = "y", topic = "/odom", field = "pose.pose.position.y", unit = "m" },
  { name = "v", topic = "/odom", field = "twist.twist.linear.x", unit = "m/s" },
"""
    with signals(bag, tmp_path, lines) as log:  # x counts east in ROS
        np.testing.assert_array_equal(log.table(Scalar, "y")["value"], np.arange(N))
        np.testing.assert_array_equal(log.table(Scalar, "x")["value"], 2.0)
        np.testing.assert_array_equal(log.table(Scalar, "v")["value"], -0.5)
    lines = """
  { name = "x", topic = "/fix", make = "north", fields = ["latitude", "longitude"] },
  { name = "y", topic = "/fix", make = "east", fields = ["latitude", "longitude"] },
"""
    with signals(bag, tmp_path, lines) as log:  # geographic coordinates have no other frame
        x = log.table(Scalar, "x")["value"]
        assert x[-1] == pytest.approx(1e-6 * (N - 1) * 111_061.0, rel=1e-3)
        np.testing.assert_allclose(log.table(Scalar, "y")["value"], 0.0, atol=1e-9)


UNKNOWN = np.array([-1.0] + [0.0] * 8)  # covariance of a part of an Imu that is not measured, or is not known


def imu_bag(path: Path, **fields: Any) -> Path:
    """Write a bag with the messages `imu` on /imu, in which the given fields are replaced; return its path."""
    kind = "sensor_msgs/msg/Imu"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/imu", kind, typestore=STORE)
        for k in range(N):
            message = replace(imu(k), **fields)
            writer.write(connection, round((T0 + 0.05 * k) * 1e9), STORE.serialize_cdr(message, kind))
    return path


def test_quantities_that_an_imu_does_not_measure_are_left_out(tmp_path: Path) -> None:
    """Covariance -1 with default values means no orientation. With other values only the covariance is unknown."""
    level = STORE.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    path = imu_bag(
        tmp_path / "bag", angular_velocity_covariance=UNKNOWN, orientation_covariance=UNKNOWN, orientation=level
    )
    (table,) = read_bag(path, SourceOptions())
    assert not [name for name in table.names if name.startswith("orientation.")]
    np.testing.assert_allclose(table.columns["angular_velocity.z"], 0.3 + np.arange(N))
    np.testing.assert_array_equal(table.columns["linear_acceleration.z"], 9.81)


def test_a_covariance_of_minus_one_means_not_measured_in_a_guessed_map(tmp_path: Path) -> None:
    """The acceleration here has gravity alone, and the driver of the angular velocity does not know its covariance."""
    path = imu_bag(
        tmp_path / "bag",
        orientation_covariance=np.zeros(9),
        angular_velocity_covariance=UNKNOWN,
        linear_acceleration_covariance=UNKNOWN,
    )
    text = guess_map(path).text
    assert [s["name"] for s in tomllib.loads(text)["signal"]] == ["psi", "r"]
    assert "\n# not measured: linear_acceleration of /imu, whose covariance begins with -1\n" in text
    assert "linear_acceleration.x" not in text
    assert "its covariance begins with -1 (not measured), but the values of angular_velocity change" in text
    with pytest.warns(
        SeatrialWarning, match="inferred from the data: .*; not measured: linear_acceleration of /imu, whose cov"
    ):
        st.import_log(path, out_dir=tmp_path)


def test_every_number_has_the_name_of_its_field(bag: Path) -> None:
    tables = {table.topic: table for table in read_bag(bag, SourceOptions())}
    assert sorted(tables) == ["/fix", "/imu/data", "/odom", "/rpm"]  # /name contains no number
    assert not [name for name in tables["/odom"].names if "covariance" in name]  # 36 numbers do not become columns
    rpm = tables["/rpm"]
    assert rpm.columns["data"].tolist() == [100.0 * k for k in range(N)]
    np.testing.assert_allclose(rpm.t, T0 + 0.05 * np.arange(N) + 0.01, atol=1e-6)  # the message has no header


def test_stamps_of_a_simulated_clock_are_moved_to_the_clock_of_the_bag(tmp_path: Path) -> None:
    """A simulator stamps from zero.

    Topics without stamps have the clock of the bag, so the stamped topics are moved to it.
    """
    path, types = tmp_path / "bag", STORE.types
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=STORE)
        for k in range(N):
            stamp = types["builtin_interfaces/msg/Time"](1, 50_000_000 * k)
            head = types["std_msgs/msg/Header"](stamp, "")
            speeds = np.array([1.0 * k, -2.0 * k])
            message = types["sensor_msgs/msg/JointState"](head, ["left_engine", "right_engine"], speeds, speeds, speeds)
            late = 0.02 if k % 2 else 0.005
            log_ns = round((T0 + 0.05 * k + late) * 1e9)
            writer.write(connection, log_ns, STORE.serialize_cdr(message, "sensor_msgs/msg/JointState"))
    (table,) = read_bag(path, SourceOptions())
    np.testing.assert_array_equal(table.columns["velocity.right_engine"], -2.0 * np.arange(N))
    np.testing.assert_allclose(table.t, T0 + 0.005 + 0.05 * np.arange(N), atol=1e-6)
    assert "another clock" in table.remark
    line = '{ name = "n_left", topic = "/joint_states", field = "velocity.left_engine", unit = "1" }'
    with pytest.warns(SeatrialWarning, match="/joint_states: its stamps are of another clock"):
        signals(path, tmp_path, line).close()


@pytest.mark.parametrize(("frames", "n_named"), [(("gps_a", "gps_b"), 2), (("gps",), 0), (("",), 0)])
def test_two_sensors_in_one_topic_are_named(tmp_path: Path, frames: tuple[str, ...], n_named: int) -> None:
    path = tmp_path / "bag"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/fix", "sensor_msgs/msg/NavSatFix", typestore=STORE)
        for k in range(N):
            message: Any = fix(k)
            message.header.frame_id = frames[k % len(frames)]
            data = STORE.serialize_cdr(message, "sensor_msgs/msg/NavSatFix")
            writer.write(connection, round((T0 + 0.05 * k) * 1e9), data)
    (table,) = read_bag(path, SourceOptions())
    assert table.remark.count(f"{N // 2} of frame") == n_named
    assert table.remark.startswith("messages of several sensors in one topic") == bool(n_named)


@pytest.mark.parametrize(("every", "fails"), [(3, True), (30, False)])
def test_wrong_stamps_of_many_rows_end_an_import_with_an_error(tmp_path: Path, every: int, fails: bool) -> None:
    """The nanoseconds of a driver overflow: the stamp is 4.3 s ahead."""
    path, n = tmp_path / "bag", 120
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/fix", "sensor_msgs/msg/NavSatFix", typestore=STORE)
        for k in range(n):
            message: Any = fix(0)
            ahead = 4.3 if k % every == 1 else 0.0
            message.header.stamp.sec, message.header.stamp.nanosec = int(T0 + k + ahead), round(1e9 * (ahead % 1.0))
            data = STORE.serialize_cdr(message, "sensor_msgs/msg/NavSatFix")
            writer.write(connection, round((T0 + k + 0.01) * 1e9), data)
    lines = '{ name = "x", topic = "/fix", fields = ["latitude", "longitude"], make = "north" }'
    if not fails:
        with pytest.warns(SeatrialWarning, match="stamps are wrong"):
            signals(path, tmp_path, lines).close()
        return
    with (
        pytest.warns(SeatrialWarning, match="stamps are wrong"),
        pytest.raises(
            SeatrialError,
            match=r"40 rows of \d+ left out, because stamps are wrong: .*; repair the clock of the driver",
        ),
    ):
        signals(path, tmp_path, lines)


def test_nested_messages_and_fields_that_appear_late_are_imported(tmp_path: Path) -> None:
    """The telemetry has several controllers. The second one is switched on after the first message, and off again."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg("int32 rpm\n", "esc_msgs/msg/Esc"))
    store.register(get_types_from_msg("uint8 count\nesc_msgs/Esc[] esc\n", "esc_msgs/msg/Escs"))
    one, several = store.types["esc_msgs/msg/Esc"], store.types["esc_msgs/msg/Escs"]
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/esc", "esc_msgs/msg/Escs", typestore=store)
        for k, n in enumerate((1, 2, 2, 1, 17)):  # so many values, as in an image, do not become columns
            message = several(n, [one(100 * k + j) for j in range(n)])
            data = store.serialize_cdr(message, "esc_msgs/msg/Escs")
            writer.write(connection, round((T0 + 0.1 * k) * 1e9), data)
    (table,) = read_bag(tmp_path / "bag", SourceOptions())
    assert list(table.names) == ["count", "esc[0].rpm", "esc[1].rpm"]
    np.testing.assert_array_equal(table.columns["count"], [1.0, 2.0, 2.0, 1.0, 17.0])
    np.testing.assert_array_equal(table.columns["esc[0].rpm"], [0.0, 100.0, 200.0, 300.0, np.nan])
    np.testing.assert_array_equal(table.columns["esc[1].rpm"], [np.nan, 101.0, 201.0, np.nan, np.nan])


def test_the_numbers_of_a_bag_do_not_become_python_objects() -> None:
    topic, message = _TopicMessages("sensor_msgs/msg/Imu"), imu(0)
    topic.add(0.0, message)
    tracemalloc.start()
    for k in range(1000):
        topic.add(1.0 * k, message)
    used, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert used < 1000 * 8 * 2.5 * len(topic.columns)  # Python objects with names take 5 kB a message


def bag_of_ros_1(path: Path) -> Path:
    """Write a bag of ROS 1 with a topic of N speeds, and return its path."""
    from rosbags.rosbag1 import Writer as Writer1

    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer1(path) as writer:
        connection = writer.add_connection("/speed", "std_msgs/msg/Float64", typestore=store)
        for k in range(N):
            message = store.types["std_msgs/msg/Float64"](0.5 * k)
            data = store.serialize_ros1(message, "std_msgs/msg/Float64")
            writer.write(connection, round((T0 + 0.1 * k) * 1e9), data)
    return path


def test_a_bag_of_ros_1_is_imported(tmp_path: Path) -> None:
    (table,) = read_bag(bag_of_ros_1(tmp_path / "run.bag"), SourceOptions())
    assert (table.topic, table.kind) == ("/speed", "std_msgs/msg/Float64")
    np.testing.assert_array_equal(table.columns["data"], 0.5 * np.arange(N))


def test_a_log_exported_to_ros_is_imported_unchanged(tmp_path: Path) -> None:
    write_everything(tmp_path / "own.mcap")
    with signals(tmp_path / "own.mcap", tmp_path, IMU.replace("/imu/data", "/ahrs/imu"), 'frame = "NED"') as log:
        psi, r = log.table(Scalar, "psi"), log.table(Scalar, "r")
    with open_log(tmp_path / "own.mcap") as own:
        ahrs = own.table(Ahrs, "ahrs")
    np.testing.assert_allclose(psi["value"], ahrs["yaw"], atol=1e-12)
    np.testing.assert_allclose(r["value"], ahrs["r"][np.isfinite(ahrs["r"])], atol=1e-12)  # NaN means not measured


def test_a_bag_exported_from_a_log_is_imported_by_its_guess(tmp_path: Path) -> None:
    """`export ros` writes the topics of the log in its own axes, and beside them those of REP-103.

    The log needs no map.
    """
    write_everything(tmp_path / "own.mcap", 12)
    with pytest.raises(
        SeatrialError, match="is a seatrial log and needs no import; check, ident and export read it directly"
    ):
        guess_map(tmp_path / "own.mcap")
    with open_log(tmp_path / "own.mcap") as own:
        export_ros(own, tmp_path / "ros")
        ahrs, gnss = own.table(Ahrs, "ahrs"), own.table(Gnss, "gnss")
    (tmp_path / "map.toml").write_text(guess_map(tmp_path / "ros/bag").text, encoding="utf-8")
    (out,) = import_files(tmp_path / "map.toml", [tmp_path / "ros/bag"], out=tmp_path / "again.mcap")
    with open_log(out) as log:
        assert {"psi", "r", "vx", "vy"} <= set(log.sources(Scalar))
        psi, r, vx = (log.table(Scalar, name)["value"] for name in ("psi", "r", "vx"))
    np.testing.assert_allclose(np.exp(1j * psi), np.exp(1j * ahrs["yaw"]), atol=1e-12)
    np.testing.assert_allclose(r[r != 0.0], ahrs["r"][np.isfinite(ahrs["r"])], atol=1e-12)  # 0 means not measured
    np.testing.assert_allclose(vx, gnss["vel_n"][np.isfinite(gnss["vel_n"])], atol=1e-12)


def test_errors_of_a_bag_import_are_one_line_each(bag: Path, tmp_path: Path) -> None:
    with pytest.raises(
        SeatrialError, match="no topic /gps; name one of its topics in the import map: /fix, /imu/data, /name"
    ):
        signals(bag, tmp_path, '{ name = "x", topic = "/gps", field = "x", unit = "m" }')
    with pytest.raises(SeatrialError, match="/rpm has no field 'rpm'; name one of these in the import map: data"):
        signals(bag, tmp_path, '{ name = "x", topic = "/rpm", field = "rpm", unit = "m" }')
    with pytest.raises(
        SeatrialError, match=r"/fix has no field 'lattitude'; did you mean 'latitude'\? Name a field of"
    ):
        signals(bag, tmp_path, '{ name = "x", topic = "/fix", field = "lattitude", unit = "m" }')
    with pytest.raises(
        SeatrialError, match=r"no field 'z'; did you mean '(orientation|angular_velocity|linear_a.*)\.z'"
    ):
        signals(bag, tmp_path, '{ name = "x", topic = "/imu/data", field = "z", unit = "m" }')
    with pytest.raises(SeatrialError, match="no field 'heading_of_boat'; name one of these") as raised:
        signals(bag, tmp_path, '{ name = "x", topic = "/imu/data", field = "heading_of_boat", unit = "m" }')
    assert "covariance" not in str(raised.value)
    with pytest.raises(SeatrialError, match=r"signal\[1\]\.field \(signal '\w+'\): missing"):
        signals(bag, tmp_path, '{ name = "x", topic = "/rpm", column = "data", unit = "m" }')
    (tmp_path / "bad.mcap").write_bytes(b"\x89MCAP0\r\n, and nothing more")
    with pytest.raises(SeatrialError, match="cannot be read as a ROS bag"):
        signals(tmp_path / "bad.mcap", tmp_path, '{ name = "x", topic = "/rpm", field = "data", unit = "m" }')
    assert not list((tmp_path / "logs").glob("*.mcap")) if (tmp_path / "logs").exists() else True


def test_a_bag_whose_pose_is_only_in_tf_is_imported(tmp_path: Path) -> None:
    """The boat moves east at 1 m/s, bow to the north-west.

    The odometry's correction and a sensor's mounting are not a pose.
    """
    types = STORE.types
    half = math.radians(135.0) / 2
    turn = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(half), math.cos(half))

    def transform(k: int, parent: str, child: str, x: float) -> Any:
        stamped = types["geometry_msgs/msg/TransformStamped"]
        placed = types["geometry_msgs/msg/Transform"](types["geometry_msgs/msg/Vector3"](x, 2.0, 0.5), turn)
        head = types["std_msgs/msg/Header"](header(k).stamp, parent)  # type: ignore[attr-defined]
        return stamped(head, child, placed)

    kind = "tf2_msgs/msg/TFMessage"
    path = tmp_path / "bag"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        tf = writer.add_connection("/tf", kind, typestore=STORE)
        drive = writer.add_connection("/thrusters/left/cmd", "std_msgs/msg/Float64", typestore=STORE)
        for k in range(N):
            message = types[kind]([
                transform(k, "map", "odom", 7.0), transform(k, "/odom", "base_link", 0.05 * k),
                transform(k, "base_link", "imu", 0.3),
            ])  # fmt: skip
            t_ns = round((T0 + 0.05 * k + 0.01) * 1e9)
            writer.write(tf, t_ns, STORE.serialize_cdr(message, kind))
            command = types["std_msgs/msg/Float64"](0.01 * k)
            writer.write(drive, t_ns, STORE.serialize_cdr(command, "std_msgs/msg/Float64"))
    guess = guess_map(path)
    assert guess.problem == "only n_left of the thrusters was recognised; name the other side by hand"
    assert "caveat: a pose of /tf" in guess.text
    assert guess.text.count("/tf:odom:base_link") >= 3
    assert "odom:imu" not in guess.text.replace("base_link:imu", "")
    (tmp_path / "map.toml").write_text(guess.text, encoding="utf-8")
    (log_path,) = import_files(tmp_path / "map.toml", [path], out_dir=tmp_path)
    with open_log(log_path) as log:
        east, heading = log.table(Scalar, "y"), log.table(Scalar, "psi")
    np.testing.assert_allclose(np.diff(east["value"]) / np.diff(east["t"]), 1.0, rtol=1e-4)
    np.testing.assert_allclose(heading["value"], math.radians(-45.0), atol=1e-9)
    wrong = guess.text.replace("/tf:odom:base_link", "/tf:odom:boat")
    (tmp_path / "wrong.toml").write_text(wrong, encoding="utf-8")
    with pytest.raises(SeatrialError, match="no transform /tf:odom:boat; name one of its topics"):
        import_files(tmp_path / "wrong.toml", [path], out_dir=tmp_path)


def test_a_bag_without_metadata_or_with_a_truncated_file_is_read(bag: Path) -> None:
    (bag / "metadata.yaml").unlink()
    tables = {table.topic: table for table in read_bag(bag, SourceOptions())}
    assert len(tables["/imu/data"]) == N
    assert "without metadata.yaml: read from 1 file" in tables["/imu/data"].remark
    (part,) = bag.iterdir()
    if part.suffix == ".mcap":
        part.write_bytes(part.read_bytes()[:-40])
        tables = {table.topic: table for table in read_bag(part, SourceOptions())}
        assert len(tables["/imu/data"]) == N
        assert "is cut off" in tables["/imu/data"].remark


def test_a_bag_with_metadata_and_a_truncated_file_is_recovered_too(bag: Path) -> None:
    (part,) = [file for file in bag.iterdir() if file.suffix in (".mcap", ".db3")]
    if part.suffix == ".mcap":
        part.write_bytes(part.read_bytes()[:-40])
        tables = {table.topic: table for table in read_bag(bag, SourceOptions())}
        assert len(tables["/imu/data"]) == N
        assert f"{part.name} is cut off: " in tables["/imu/data"].remark
        assert "without metadata.yaml" not in tables["/imu/data"].remark
        return
    part.write_bytes(part.read_bytes()[:3000])
    with pytest.raises(SeatrialError, match=r"cannot be read as a ROS bag: .*[^.]; check that the bag is complete"):
        read_bag(bag, SourceOptions())


def test_the_description_of_a_bag_names_its_folder(bag: Path) -> None:
    with pytest.raises(SeatrialError, match=rf"metadata\.yaml: describes a bag of ROS 2; give the folder .*{bag.name}"):
        source_kind(bag / "metadata.yaml")


def test_a_bag_that_was_not_closed_names_the_remedy(tmp_path: Path) -> None:
    path = tmp_path / "run.bag.active"
    path.write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(SeatrialError, match=r"rosbag reindex run\.bag\.active"):
        read_bag(path, SourceOptions())


def with_wal(folder: Path) -> Path:
    """Write a bag whose recorder was killed: half of the messages are only in SQLite's log beside the database."""
    with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/imu/data", "sensor_msgs/msg/Imu", typestore=STORE)
        for k in range(N):
            data = STORE.serialize_cdr(imu(k), "sensor_msgs/msg/Imu")
            writer.write(connection, round((T0 + 0.1 * k) * 1e9), data)
    (path,) = (folder / "bag").glob("*.db3")
    with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as database:
        rows = database.execute("SELECT * FROM messages WHERE id > ?", (N // 2,)).fetchall()
        database.execute("DELETE FROM messages WHERE id > ?", (N // 2,))
        database.execute("PRAGMA journal_mode=WAL")
        database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
        killed = folder / "killed"
        killed.mkdir()
        for name in ("metadata.yaml", path.name, f"{path.name}-wal"):
            shutil.copyfile(folder / "bag" / name, killed / name)
    return killed / path.name


@pytest.mark.parametrize("how", ["file", "folder", "folder without metadata"])
def test_a_database_with_a_wal_is_read_completely_and_not_changed(tmp_path: Path, how: str) -> None:
    path = with_wal(tmp_path)
    if how.endswith("metadata"):
        (path.parent / "metadata.yaml").unlink()
    before = {file.name: file.read_bytes() for file in path.parent.iterdir()}
    (table,) = read_bag(path if how == "file" else path.parent, SourceOptions())
    assert len(table) == N
    assert f"{path.name} read with {path.name}-wal" in table.remark
    assert {file.name: file.read_bytes() for file in path.parent.iterdir()} == before


@pytest.mark.parametrize("kind", ["pipe", "link", "damaged"])
def test_a_wal_that_is_not_a_regular_file_is_refused(tmp_path: Path, kind: str) -> None:
    path = with_wal(tmp_path)
    wal = path.with_name(f"{path.name}-wal")
    data = wal.read_bytes()
    wal.unlink()
    if kind == "pipe":
        os.mkfifo(wal)
    elif kind == "link":
        (tmp_path / "secret").write_bytes(data)
        wal.symlink_to(tmp_path / "secret")
    else:
        wal.write_bytes(data[:16] + bytes(16) + data[32:])  # SQLite takes this file for the log of another database
        (table,) = read_bag(path, SourceOptions())
        assert len(table) == N // 2
        return
    for source in (path, path.parent):
        with pytest.raises(
            SeatrialError, match="-wal: is a symbolic link, not a file" if kind == "link" else "-wal: is not a file"
        ):
            read_bag(source, SourceOptions())


def test_the_topics_of_a_bag_are_listed_before_its_import(bag: Path) -> None:
    """As a folder, or a file of it. A .mcap file is read as a log. All name the command that imports the bag."""
    for path in (bag, *bag.glob("*.db3"), *bag.glob("*.mcap")):
        done = CliRunner().invoke(cli.info, [str(path), "--json"])
        content = json.loads(done.stdout)
        rows = {row["topic"]: row for row in content["topics"]}
        assert {name: row["messages"] for name, row in rows.items()} == dict.fromkeys(
            ("/imu/data", "/fix", "/odom", "/rpm", "/name"), N
        )
        assert rows["/imu/data"]["type"] == "sensor_msgs/msg/Imu"
        assert rows["/imu/data"]["rate"] == pytest.approx(20.0, rel=0.01)
        assert (content["messages"], content["complete"]) == (5 * N, True)
        assert content["import_command"] == f"seatrial import --guess {path if path.suffix == '.db3' else bag}"
        shown = CliRunner().invoke(cli.info, [str(path)]).stdout
        assert "sensor_msgs/msg/Imu" in shown
        assert content["import_command"] in shown


def test_a_log_in_the_folder_of_a_bag_needs_no_import(bag: Path) -> None:
    write_everything(bag / "own.mcap")
    assert json.loads(CliRunner().invoke(cli.info, [str(bag / "own.mcap"), "--json"]).stdout)["import_command"] is None


@pytest.mark.parametrize("bag", [StoragePlugin.SQLITE3], indirect=True)
def test_a_bag_without_metadata_is_listed_with_a_warning(bag: Path) -> None:
    (bag / "metadata.yaml").unlink()
    content = json.loads(CliRunner().invoke(cli.info, [str(bag), "--json"]).stdout)
    assert (content["complete"], content["messages"]) == (False, 5 * N)
    assert content["warnings"] == ["without metadata.yaml: read from 1 file"]


def test_the_topics_of_a_bag_of_ros_1_are_listed(tmp_path: Path) -> None:
    path = bag_of_ros_1(tmp_path / "run.bag")
    content = json.loads(CliRunner().invoke(cli.info, [str(path), "--json"]).stdout)
    assert [(row["topic"], row["type"], row["messages"]) for row in content["topics"]] == [
        ("/speed", "std_msgs/msg/Float64", N)
    ]
    assert content["import_command"] == f"seatrial import --guess {path}"
