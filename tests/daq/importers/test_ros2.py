"""Bags of ROS 2, written by rosbags: axes, times, names, and what is wrong in one line."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from daq import cli
from daq.errors import SeatrialError
from daq.importers.ros2 import import_ros2
from daq.log.reader import open_log
from daq.samples import Ahrs, Gnss, Scalar
from tests.daq.logs import T0, write_everything

STORE = get_typestore(Stores.ROS2_HUMBLE)
N = 20


def header(k: int) -> object:
    stamp = STORE.types["builtin_interfaces/msg/Time"](int(T0), 50_000_000 * k)
    return STORE.types["std_msgs/msg/Header"](stamp, "base_link")


def imu(k: int) -> Any:
    """Facing north-west in ROS's way of counting: 135 degrees from east; bow up 10 degrees (pitch -10 there)."""
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
    said = {
        "/imu/data": ("sensor_msgs/msg/Imu", imu),
        "/fix": ("sensor_msgs/msg/NavSatFix", fix),
        "/odom": ("nav_msgs/msg/Odometry", odometry),
        "/rpm": ("std_msgs/msg/Float64", lambda k: STORE.types["std_msgs/msg/Float64"](100.0 * k)),
        "/name": ("std_msgs/msg/String", lambda k: STORE.types["std_msgs/msg/String"]("boat")),
    }
    with Writer(path, version=9, storage_plugin=request.param) as writer:
        for topic, (kind, make) in said.items():
            connection = writer.add_connection(topic, kind, typestore=STORE)
            for k in range(N):
                t_ns = round((T0 + 0.05 * k + 0.01) * 1e9)
                writer.write(connection, t_ns, STORE.serialize_cdr(make(k), kind))
    return path


def test_imu_and_fix_become_samples_in_our_axes(bag: Path, tmp_path: Path) -> None:
    path, said = import_ros2(bag, topics={"/imu/data": "ahrs", "/fix": ""}, out=tmp_path / "run.mcap")
    assert said == f"{2 * N} samples"
    with open_log(path) as log:
        ahrs, gnss = log.table(Ahrs, "ahrs"), log.table(Gnss, "fix")
        assert log.metadata["import"] == "ros2"
    np.testing.assert_allclose(ahrs["t"], T0 + 0.05 * np.arange(N), atol=1e-6)  # the header's, not the bag's
    assert ahrs["yaw"] == pytest.approx(math.radians(-45.0))  # north-west
    assert ahrs["pitch"] == pytest.approx(math.radians(10.0))  # bow up
    assert ahrs["roll"] == pytest.approx(0.0, abs=1e-12)
    assert (ahrs["p"][0], ahrs["q"][0], ahrs["r"][0]) == (0.1, -0.2, -0.3)
    np.testing.assert_array_equal(ahrs["az"], -9.81)  # measured, though the covariance of one says that it is unknown
    assert (gnss["fix"][0], gnss["sigma_h"][0]) == (4, pytest.approx(0.2))
    np.testing.assert_allclose(gnss["lat"], 41.0 + 1e-6 * np.arange(N))


def test_what_an_imu_does_not_measure_is_nan(tmp_path: Path) -> None:
    """Covariance -1 and nothing but defaults: no orientation; with values in it: an unknown covariance alone."""
    path, kind, unknown = tmp_path / "bag", "sensor_msgs/msg/Imu", np.array([-1.0] + [0.0] * 8)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/imu", kind, typestore=STORE)
        for k in range(N):
            message = replace(imu(k), angular_velocity_covariance=unknown, orientation_covariance=unknown,
                              orientation=STORE.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0))
            writer.write(connection, round((T0 + 0.05 * k) * 1e9), STORE.serialize_cdr(message, kind))
    with open_log(import_ros2(path, out=tmp_path / "run.mcap")[0]) as log:
        ahrs = log.table(Ahrs, "imu")
    assert np.isnan(ahrs["yaw"]).all()
    np.testing.assert_allclose(ahrs["r"], -(0.3 + np.arange(N)))
    np.testing.assert_array_equal(ahrs["az"], -9.81)


def test_every_number_of_other_messages_is_a_signal(bag: Path, tmp_path: Path) -> None:
    path, said = import_ros2(bag, out=tmp_path / "run.mcap")
    assert said.endswith("nothing to take in /name")
    with open_log(path) as log:
        assert "odom_pose_pose_position_x" in log.sources(Scalar)
        assert not [name for name in log.sources(Scalar) if "covariance" in name]  # 36 numbers are no signals
        rpm = log.table(Scalar, "rpm_data")
        assert rpm["value"].tolist() == [100.0 * k for k in range(N)]
        np.testing.assert_allclose(rpm["t"], T0 + 0.05 * np.arange(N) + 0.01, atol=1e-6)  # it has no header
        assert log.table(Ahrs, "imu_data")["yaw"][0] == pytest.approx(math.radians(-45.0))


def test_our_own_log_comes_back_by_its_axes(tmp_path: Path) -> None:
    write_everything(tmp_path / "own.mcap")
    path, _ = import_ros2(tmp_path / "own.mcap", topics={"/ahrs/imu": "ahrs"}, axes="ned", out=tmp_path / "again.mcap")
    with open_log(tmp_path / "own.mcap") as own, open_log(path) as again:
        for name in ("yaw", "pitch", "roll", "r", "az"):
            np.testing.assert_allclose(
                again.table(Ahrs, "ahrs")[name], own.table(Ahrs, "ahrs")[name], atol=1e-12, err_msg=name
            )


def test_what_is_wrong_is_one_line(bag: Path, tmp_path: Path) -> None:
    with pytest.raises(SeatrialError, match="no topic /gps; there is: /fix, /imu/data, /name"):
        import_ros2(bag, topics={"/gps": "gnss"}, out=tmp_path / "x.mcap")
    with pytest.raises(SeatrialError, match="no messages with numbers in them on these topics"):
        import_ros2(bag, topics={"/name": ""}, out=tmp_path / "x.mcap")
    (tmp_path / "bad.mcap").write_bytes(b"no bag")
    with pytest.raises(SeatrialError, match="cannot be read as a ROS 2 bag"):
        import_ros2(tmp_path / "bad.mcap", out=tmp_path / "x.mcap")
    assert not (tmp_path / "x.mcap").exists()


def test_the_command(bag: Path, tmp_path: Path) -> None:
    out = tmp_path / "run.mcap"
    done = CliRunner().invoke(cli.import_, ["ros2", str(bag), "--topic", "/imu/data=ahrs", "-o", str(out)])
    assert done.exit_code == 0, done.output
    assert done.output == f"{out}: {N} samples\n"
