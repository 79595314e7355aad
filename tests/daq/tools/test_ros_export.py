"""Tests of the export to ROS: bag, package and layouts, read by rosbags and compared with the documentation of each
tool.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner

from seatrial.daq import cli
from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.errors import SeatrialError
from seatrial.daq.geometry import local_ned
from seatrial.daq.log.reader import Log, open_log
from seatrial.daq.log.recorder import Recorder
from seatrial.daq.samples import Ahrs, Frame, Gnss
from seatrial.daq.tools.ros_export import NO_MEASUREMENT, export_ros
from tests.daq.logs import RIG, T0, StoppedClock, recorder, write_everything

rosbags = pytest.importorskip("rosbags.highlevel", reason="no reader of bags here (rosbags)")
LAT, LON = 63.4, 10.4


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Export a boat that moves north-east at 2 m/s, heading 30 degrees, turning 0.1 rad/s to starboard, bow up 5
    degrees.
    """
    folder = tmp_path_factory.mktemp("ros")
    log = recorder(folder / "run.mcap")
    for k in range(41):
        t = T0 + 0.05 * k
        sample = Ahrs(yaw=np.radians(30.0), pitch=np.radians(5.0), roll=np.radians(-2.0), p=0.01, q=0.02, r=0.1,
                      ax=0.3, ay=0.2, az=-9.7)  # fmt: skip
        log.write("ahrs", Frame(sample, t, t), t)
        if k % 4 == 0:
            lat, lon = LAT + k * 1e-6, LON + k * 2e-6
            fix = Gnss(utc=t, lat=lat, lon=lon, alt=3.0, fix=3, vel_n=1.4, vel_e=1.5, vel_d=0.0)
            log.write("gps", Frame(fix, t, t), t)
    log.close()
    with open_log(folder / "run.mcap") as opened:
        export_ros(opened, folder / "out")
    return folder


def messages(folder: Path) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    with rosbags.AnyReader([folder / "bag"]) as reader:
        for connection, _, data in reader.messages():
            found.setdefault(connection.topic, []).append(reader.deserialize(data, connection.msgtype))
    return found


def ros_counts(log: Log) -> dict[str, int]:
    """Return the number of messages by topic, under names that ROS allows."""
    return {topic.replace("/1/", "/node_1/").replace("/2/", "/node_2/"): n for topic, n in log.counts.items()}


def test_the_bag_contains_the_logged_messages_and_the_frames_of_ros(exported: Path) -> None:
    found = messages(exported / "out")
    with open_log(exported / "run.mcap") as log:
        counts = ros_counts(log)
    assert {topic: len(found[topic]) for topic in counts} == counts
    imu = found["/ros/ahrs/imu"][0]
    assert imu.header.frame_id == "base_link"
    assert (imu.angular_velocity.x, imu.angular_velocity.y, imu.angular_velocity.z) == (0.01, -0.02, -0.1)
    assert (imu.linear_acceleration.x, imu.linear_acceleration.y, imu.linear_acceleration.z) == (0.3, -0.2, 9.7)
    # The bow in east, north, up: 30 degrees from north equals 60 from east, and 5 degrees up.
    q = imu.orientation
    bow = [1 - 2 * (q.y**2 + q.z**2), 2 * (q.x * q.y + q.w * q.z), 2 * (q.x * q.z - q.w * q.y)]
    level, up = np.cos(np.radians(5.0)), np.sin(np.radians(5.0))
    assert bow == pytest.approx([level * np.cos(np.radians(60)), level * np.sin(np.radians(60)), up])
    # Starboard side up by 2 degrees (roll -2 degrees): the body's y axis, to port, points down.
    assert 2 * (q.y * q.z + q.w * q.x) == pytest.approx(-np.sin(np.radians(2.0)) * level)


def test_odometry_is_between_the_fixes_and_agrees_with_tf(exported: Path) -> None:
    found = messages(exported / "out")
    north, east = local_ned(np.array([LAT, LAT + 2e-6]), np.array([LON, LON + 4e-6]))
    third = found["/odom"][2]
    assert third.header.frame_id, third.child_frame_id == ("odom", "base_link")
    place = third.pose.pose.position
    assert (place.x, place.y, place.z) == pytest.approx((east[1], north[1], 0.0), abs=1e-6)
    speed = third.twist.twist.linear
    assert np.hypot(np.hypot(speed.x, speed.y), speed.z) == pytest.approx(np.hypot(1.4, 1.5))
    heading = np.radians(30.0)
    ahead = (1.4 * np.cos(heading) + 1.5 * np.sin(heading)) * np.cos(np.radians(5.0))
    assert speed.x == pytest.approx(ahead)
    assert speed.y > 0.0 if 1.5 * np.cos(heading) < 1.4 * np.sin(heading) else speed.y < 0.0  # y points to port
    (transform,) = found["/tf"][2].transforms
    assert transform.transform.rotation == third.pose.pose.orientation
    assert transform.transform.translation.x == place.x
    assert len(found["/tf"]) == len(found["/odom"]) == 41


def test_a_layout_has_no_panel_for_missing_topics(tmp_path: Path) -> None:
    """Fixes without a heading give a map without frames. Without fixes there is no map either."""
    for name, panels in (("gps", ["map!0"]), ("ahrs", [])):
        log = recorder(tmp_path / f"{name}.mcap")
        for k in range(5):
            t = T0 + 0.1 * k
            fix, attitude = Gnss(utc=t, lat=LAT, lon=LON, fix=3), Ahrs(yaw=0.0, pitch=0.0, roll=0.0)
            log.write(name, Frame(fix if name == "gps" else attitude, t, t), t)
        log.close()
        with open_log(tmp_path / f"{name}.mcap") as opened:
            export_ros(opened, tmp_path / name)
        layout = json.loads((tmp_path / name / "foxglove.json").read_text())
        assert [panel for panel in layout["configById"] if not panel.startswith("Plot")] == panels


def test_no_position_is_invented_between_missing_fixes(tmp_path: Path) -> None:
    log = recorder(tmp_path / "run.mcap")
    for k in range(100):
        t = T0 + 0.1 * k
        log.write("ahrs", Frame(Ahrs(yaw=0.0, pitch=0.0, roll=0.0), t, t), t)
        if not 20 < k < 80:
            log.write("gps", Frame(Gnss(utc=t, lat=LAT, lon=LON, fix=3), t, t), t)
    log.close()
    with open_log(tmp_path / "run.mcap") as opened:
        export_ros(opened, tmp_path / "out")
    stamps = [m.header.stamp.sec + m.header.stamp.nanosec / 1e9 - T0 for m in messages(tmp_path / "out")["/odom"]]
    assert not [t for t in stamps if 2.05 < t < 7.95]
    assert len(stamps) == 21 + 20


def test_an_unmeasured_speed_is_not_exported_as_zero(tmp_path: Path) -> None:
    """The log has a receiver with positions only, one without the vertical speed, and an AHRS without gyros."""
    log = recorder(tmp_path / "run.mcap")
    for k in range(40):
        t = T0 + 0.1 * k
        log.write("ahrs", Frame(Ahrs(yaw=0.0, pitch=0.0, roll=0.0, r=0.1), t, t), t)
        moving = {"vel_n": 11.0, "vel_e": 0.0} if k >= 20 else {}
        log.write("gps", Frame(Gnss(utc=t, lat=LAT + 1e-5 * k, lon=LON, fix=3, **moving), t, t), t)
    log.close()
    with open_log(tmp_path / "run.mcap") as opened:
        export_ros(opened, tmp_path / "out")
    found = messages(tmp_path / "out")["/odom"]
    variances = [np.diag(m.twist.covariance.reshape(6, 6)).tolist() for m in found]
    unknown = NO_MEASUREMENT
    assert variances[10] == [unknown, unknown, unknown, unknown, unknown, 0.0]
    assert variances[30] == [0.0, 0.0, unknown, unknown, unknown, 0.0]
    assert (found[30].twist.twist.linear.x, found[30].twist.twist.angular.z) == (11.0, -0.1)


def test_odometry_is_that_of_the_origin_of_the_boat_not_of_its_antenna(tmp_path: Path) -> None:
    """The antenna is 2 m ahead and 0.5 m above the origin. The boat turns about the origin: only the antenna moves."""
    arm, rate = np.array([2.0, 0.0, -0.5]), 0.2
    text = RIG + '[[device]]\nname = "gps"\nprotocol = "nmea"\nport = "ports/gps"\nrate_hz = 10.0\n'
    text += "lever_arm_m = [2.0, 0.0, -0.5]\n"
    log = Recorder(tmp_path / "run.mcap", rig=parse_rig(text, Path("rig.toml")), clock=StoppedClock())  # type: ignore[arg-type]
    metres = [np.diff(axis)[0] for axis in local_ned(np.array([LAT, LAT + 1e-6]), np.array([LON, LON + 1e-6]))]
    for k in range(50):
        t, yaw = T0 + 0.1 * k, rate * 0.1 * k
        log.write("ahrs", Frame(Ahrs(yaw=yaw, pitch=0.0, roll=0.0, p=0.0, q=0.0, r=rate), t, t), t)
        north, east = arm[0] * np.cos(yaw), arm[0] * np.sin(yaw)
        fix = Gnss(utc=t, lat=LAT + 1e-6 * north / metres[0], lon=LON + 1e-6 * east / metres[1], fix=3,
                   vel_n=-rate * east, vel_e=rate * north, vel_d=0.0)  # fmt: skip
        log.write("gps", Frame(fix, t, t), t)
    log.close()
    with open_log(tmp_path / "run.mcap") as opened:
        export_ros(opened, tmp_path / "out")
    for odometry in messages(tmp_path / "out")["/odom"]:
        place, speed = odometry.pose.pose.position, odometry.twist.twist.linear
        # `odom` starts at the first fix, 2 m north of the origin
        assert np.hypot(place.x - 0.0, place.y + arm[0]) < 2e-3
        assert np.hypot(speed.x, speed.y) < 2e-3


def test_every_kind_of_message_and_a_log_without_motion_are_exported(tmp_path: Path) -> None:
    write_everything(tmp_path / "all.mcap", n_rounds=2)
    run = CliRunner().invoke(cli.export, ["ros", str(tmp_path / "all.mcap"), "--out", str(tmp_path / "out")])
    assert run.exit_code == 0, run.output
    with open_log(tmp_path / "all.mcap") as log:
        counts = ros_counts(log)
    found = messages(tmp_path / "out")
    assert {topic: len(found[topic]) for topic in counts} == counts
    assert not [topic for topic in found if any(part[:1].isdigit() for part in topic.split("/"))]
    again = CliRunner().invoke(cli.export, ["ros", str(tmp_path / "all.mcap"), "--out", str(tmp_path / "out")])
    assert isinstance(again.exception, SeatrialError)
    forced = CliRunner().invoke(
        cli.export, ["ros", str(tmp_path / "all.mcap"), "--out", str(tmp_path / "out"), "--force"]
    )
    assert forced.exit_code == 0


def test_the_package_is_one_that_colcon_builds(exported: Path) -> None:
    package = exported / "out/seatrial_msgs"
    xml = ElementTree.parse(package / "package.xml").getroot()
    assert (xml.get("format"), xml.findtext("name")) == ("3", "seatrial_msgs")
    assert xml.findtext("member_of_group") == "rosidl_interface_packages"
    cmake = (package / "CMakeLists.txt").read_text()
    definitions = sorted((package / "msg").glob("*.msg"))
    assert len(definitions) >= 10
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for path in definitions:
        assert f'"msg/{path.name}"' in cmake
        types = get_types_from_msg(path.read_text(), f"seatrial_msgs/msg/{path.stem}")
        store.register(types)
        fields = [name for name, _ in types[f"seatrial_msgs/msg/{path.stem}"][1]]
        assert all(name == name.lower() for name in fields)  # the rule of rosidl for the name of a field
    if shutil.which("colcon"):
        subprocess.run(["colcon", "build", "--base-paths", str(package)], cwd=exported, check=True)


def test_layouts_show_only_existing_topics(exported: Path) -> None:
    found = messages(exported / "out")
    layout = json.loads((exported / "out/foxglove.json").read_text())

    def panels(tree: Any) -> list[str]:
        return [tree] if isinstance(tree, str) else panels(tree["first"]) + panels(tree["second"])

    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
    paths = [p["value"] for c in layout["configById"].values() for p in c.get("paths", ())]
    assert "/ahrs/imu.angular_velocity.z" in paths
    for path in paths:
        topic, *fields = path.split(".")
        value = found[topic][0]
        for field in fields:
            value = getattr(value, field)
        assert isinstance(value, float | int)
    (fix,) = found[layout["configById"]["map!0"]["followTopic"]][:1]
    assert fix.__msgtype__ == "sensor_msgs/msg/NavSatFix"
    frames = layout["configById"]["3D!0"]
    (transform,) = found["/tf"][0].transforms
    assert (frames["fixedFrame"], frames["followTf"]) == (transform.header.frame_id, transform.child_frame_id)
    root = ElementTree.parse(exported / "out/plotjuggler.xml").getroot()
    split = root.find("tabbed_widget/Tab/Container/DockSplitter")
    assert split is not None
    assert int(split.get("count", 0)) == len(split.findall("DockArea")) == len(split.get("sizes", "").split(";"))
    curves = {curve.get("name") for curve in root.iter("curve")}
    assert {path.replace(".", "/") for path in paths} == curves
    loaded = root.find("previouslyLoaded_Datafiles/fileInfo")
    assert loaded is not None
    assert (exported / "out" / str(loaded.get("filename"))).is_file()
