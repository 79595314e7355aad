"""`seatrial export ros`: a log as ROS tools want it: bag with REP-103 frames, message package, viewers' layouts.

The bag (rosbag2, storage MCAP) has every message of the log as it stands and beside them, in the axes of REP-103 (body
forward, left, up; world east, north, up) and the frames of REP-105:

| topic | type | from |
|---|---|---|
| `/ros/DEVICE/imu` | sensor_msgs/msg/Imu, frame `base_link` | every AHRS |
| `/odom` | nav_msgs/msg/Odometry, `odom` to `base_link` | the first AHRS with a heading and the first GNSS receiver |
| `/tf` | tf2_msgs/msg/TFMessage, `odom` to `base_link` | the same |

`odom` is where the first fix is; `base_link` is the origin that the rig file measures lever arms from.
"""

from __future__ import annotations

import heapq
import json
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace
from importlib import resources
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.errors import SeatrialError
from seatrial.daq.files import write_output
from seatrial.daq.log import NANO, NODE_TOPICS, Log, local_ned, quaternion, schema
from seatrial.daq.samples import Ahrs, Command, Esc, Frame, Gnss, LoadCell, Scalar, Servo

PACKAGE = "seatrial_msgs"
BAG, PACKAGE_FOLDER, FOXGLOVE, PLOTJUGGLER = "bag", PACKAGE, "foxglove.json", "plotjuggler.xml"
MAX_GAP_S = 2.0  # between fixes: where there is none for longer, no position is made up
NO_MEASUREMENT = 1e6  # variance of a speed that no sensor gives: a zero there would be a measured standstill
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")  # Okabe and Ito: told apart by the colour-blind
Array = NDArray[np.float64]


class RosMessage(NamedTuple):
    """One message to write: run time in ns, topic, and the message as rosbags makes it."""

    stamp_ns: int
    topic: str
    message: Any


def export_ros(log: Log, folder: Path, force: bool = False) -> list[Path]:
    """Write the bag, the interface package and the layouts to `folder`; returns what was written.

    Raises SeatrialError where rosbags is not installed, something of that name is there already and `force` is not
    given, or the disk refuses.
    """
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
    except ModuleNotFoundError as error:
        raise SeatrialError("bags of ROS 2 need the package rosbags: pip install 'seatrial[ros2]'") from error
    made = [folder / name for name in (BAG, PACKAGE_FOLDER, FOXGLOVE, PLOTJUGGLER)]
    for path in made:
        if path.is_symlink():
            raise SeatrialError(f"{path}: is a symbolic link, and outputs follow none; remove it")
        if path.exists() and not force:
            raise SeatrialError(f"{path}: is there already; --force replaces it, --out names another folder")
    store = ros_types()
    ahrs = {source: log.table(Ahrs, source) for source in log.sources(Ahrs)}
    added = [*(_imus(source, rows) for source, rows in ahrs.items()), _odometry(log, ahrs, store.types)]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path in made[:2]:
            shutil.rmtree(path, ignore_errors=True)
        with Writer(made[0], version=9, storage_plugin=StoragePlugin.MCAP) as bag:
            kinds = {**log.types(), **{f"/ros/{source}/imu": schema.IMU for source in ahrs}}
            connections = {
                name: bag.add_connection(ros_topic(name), kind, typestore=store) for name, kind in kinds.items()
            }
            for stamp_ns, name, told in heapq.merge(log.messages(), *added, key=itemgetter(0)):
                if isinstance(told, bytes):
                    data = told
                else:
                    kind = told.__msgtype__
                    if name not in connections:
                        connections[name] = bag.add_connection(name, kind, typestore=store)
                    data = bytes(store.serialize_cdr(told, kind))
                bag.write(connections[name], stamp_ns, data)
        _write_package(made[1])
        plots = _plots(log)
        write_output(made[2], json.dumps(_foxglove(log, plots, "/tf" in connections), indent=1) + "\n")
        write_output(made[3], _plotjuggler(plots))
    except OSError as error:
        raise SeatrialError(f"{error.filename or folder}: cannot be written: {error.strerror}") from error
    return made


def ros_topic(topic: str) -> str:
    """The name of a topic of ours in ROS 2, where no part begins with a digit (`ros2 bag play` leaves those out)."""
    return re.sub(r"/(\d)", r"/node_\1", topic)


# REP-103 ----------------------------------------------------------------------------------------------------------


def rep_103_imu(device: str, sample: Ahrs) -> schema.Message:
    """A message of the axes of REP-103, of a sample from forward, starboard, down and north: y and z turn round."""
    turned = replace(
        sample, yaw=np.pi / 2 - sample.yaw, pitch=-sample.pitch,
        q=-sample.q, r=-sample.r, ay=-sample.ay, az=-sample.az, mx=np.nan, my=np.nan, mz=np.nan,
    )  # fmt: skip
    imu = schema.messages(device, Frame(turned, np.nan, np.nan))[-1]
    known = tuple(0.0 if value != value else value for value in imu.values)  # what is unknown has a covariance of -1
    return schema.Message(f"/ros/{device}/imu", imu.type_name, "base_link", known)


def _imus(source: str, rows: NDArray[np.void]) -> Iterator[RosMessage]:
    names = [field.name for field in fields(Ahrs)]
    for row in rows:
        message = rep_103_imu(source, Ahrs(*(float(row[name]) for name in names)))
        yield RosMessage(_ns(row["t"]), message.topic, message.pack(_ns(row["t"])))


def _odometry(log: Log, ahrs_of: Mapping[str, NDArray[np.void]], types: Any) -> Iterator[RosMessage]:
    """Position and velocity of the rig's origin at the times of the AHRS, between the fixes on either side of each."""
    headed = [rows for rows in ahrs_of.values() if np.isfinite(rows["yaw"]).any()]
    fixed = [(name, rows[_fixes(rows)]) for name in log.sources(Gnss) for rows in [log.table(Gnss, name)]]
    fixed = [(name, rows) for name, rows in fixed if len(rows) > 1]
    if not headed or not fixed:
        return
    ahrs, (receiver, gnss) = headed[0], fixed[0]
    ahrs = ahrs[np.isfinite(ahrs["yaw"])]
    devices = log.rig.devices if log.rig is not None else ()
    arm = np.array(next((d.lever_arm_m for d in devices if d.name == receiver), (0.0, 0.0, 0.0)))
    north, east = local_ned(gnss["lat"], gnss["lon"])
    down = -(gnss["alt"] - gnss["alt"][0])
    fixes = np.column_stack([north, east, np.where(np.isfinite(down), down, 0.0)])
    after = np.clip(np.searchsorted(gnss["t"], ahrs["t"]), 1, len(gnss) - 1)
    gap = gnss["t"][after] - gnss["t"][after - 1]
    share = np.divide(ahrs["t"] - gnss["t"][after - 1], gap, out=np.full(len(ahrs), np.nan), where=gap > 0)
    good = (share == 0) | (share == 1) | ((share > 0) & (share < 1) & (gap <= MAX_GAP_S))
    speed = np.column_stack([gnss[name] for name in ("vel_n", "vel_e", "vel_d")])
    for i in np.flatnonzero(good):
        row, k, w = ahrs[i], after[i], share[i]
        angles = [0.0 if np.isnan(row[name]) else float(row[name]) for name in ("yaw", "pitch", "roll")]
        R = _rotation(*angles)  # body to NED
        measured = np.array([row[name] for name in "pqr"])
        rates = np.nan_to_num(measured)
        place = (1 - w) * fixes[k - 1] + w * fixes[k] - R @ arm
        v = (1 - w) * speed[k - 1] + w * speed[k]
        moving = bool(np.isfinite(v[:2]).all())  # many receivers do not tell how fast they rise and sink
        velocity = R.T @ np.nan_to_num(v) - np.cross(rates, arm) if moving else np.zeros(3)
        known = (moving, moving, moving and bool(np.isfinite(v[2])), *np.isfinite(measured).tolist())
        yield from _pose(row["t"], place, angles, np.concatenate([velocity, rates]), known, types)


def _pose(
    t: float, place: Array, angles: Sequence[float], twist: Array, known: Sequence[bool], types: Any
) -> Iterator[RosMessage]:
    """Odometry and transform: twist (6,) forward, starboard, down and about them, and which of it is ``known``."""
    header = _header(t, "odom", types)
    enu = {"x": float(place[1]), "y": float(place[0]), "z": float(-place[2])}
    turned = _quaternion(angles, types)
    pose = types["geometry_msgs/msg/Pose"](position=types["geometry_msgs/msg/Point"](**enu), orientation=turned)
    moved = types["geometry_msgs/msg/Twist"](linear=_vector(twist[:3], types), angular=_vector(twist[3:], types))
    unknown = np.zeros(36)
    variances = np.diag(np.where(known, 0.0, NO_MEASUREMENT)).ravel()
    yield RosMessage(_ns(t), "/odom", types["nav_msgs/msg/Odometry"](
        header=header, child_frame_id="base_link",
        pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=unknown),
        twist=types["geometry_msgs/msg/TwistWithCovariance"](twist=moved, covariance=variances),
    ))  # fmt: skip
    transform = types["geometry_msgs/msg/Transform"](
        translation=types["geometry_msgs/msg/Vector3"](**enu), rotation=turned
    )
    of = types["geometry_msgs/msg/TransformStamped"]
    stamped = of(header=header, child_frame_id="base_link", transform=transform)
    yield RosMessage(_ns(t), "/tf", types["tf2_msgs/msg/TFMessage"](transforms=[stamped]))


def _fixes(rows: NDArray[np.void]) -> NDArray[np.bool_]:
    return np.asarray((rows["fix"] >= 2) & np.isfinite(rows["lat"]) & np.isfinite(rows["lon"]))


def _ns(t: float) -> int:
    return round(float(t) * NANO)


def _header(t: float, frame: str, types: Any) -> Any:
    sec, nanosec = divmod(_ns(t), NANO)
    stamp = types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def _vector(frd: Sequence[float] | Array, types: Any) -> Any:
    """Forward, starboard, down -> forward, left, up."""
    x, y, z = map(float, frd)
    return types["geometry_msgs/msg/Vector3"](x=x, y=-y, z=-z)


def _quaternion(angles: Sequence[float], types: Any) -> Any:
    """Yaw, pitch and roll of FRD in NED -> of FLU in ENU: from east, and the other way round about y and z."""
    yaw, pitch, roll = angles
    x, y, z, w = quaternion(np.pi / 2 - yaw, -pitch, roll)
    return types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)


def _rotation(yaw: float, pitch: float, roll: float) -> Array:
    """Body to NED (Fossen 2011, eq. 2.18)."""
    x, y, z, w = quaternion(yaw, pitch, roll)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


# Interface package ------------------------------------------------------------------------------------------------


def ros_types() -> Any:
    """The types of ROS 2 and our own, as rosbags knows them. Raises ModuleNotFoundError."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for definition in _definitions():
        store.register(get_types_from_msg(definition.read_text(encoding="utf-8"), f"{PACKAGE}/msg/{definition.stem}"))
    return store


def _definitions() -> list[Path]:
    """The definitions of our own messages."""
    with resources.as_file(resources.files("seatrial.daq").joinpath("msg", PACKAGE)) as folder:
        return sorted(folder.glob("*.msg"))


def _write_package(folder: Path) -> None:
    """A package for colcon: what `ros2 topic echo` and a bag's readers need to know our messages."""
    (folder / "msg").mkdir(parents=True)
    names = []
    for definition in _definitions():
        (folder / "msg" / definition.name).write_bytes(definition.read_bytes())
        names.append(f'"msg/{definition.name}"')
    listed = "\n  ".join(names)
    (folder / "CMakeLists.txt").write_text(CMAKE.format(package=PACKAGE, messages=listed), encoding="utf-8")
    (folder / "package.xml").write_text(PACKAGE_XML.format(package=PACKAGE), encoding="utf-8")


CMAKE = """cmake_minimum_required(VERSION 3.8)
project({package})

find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
find_package(std_msgs REQUIRED)

rosidl_generate_interfaces(${{PROJECT_NAME}}
  {messages}
  DEPENDENCIES std_msgs
)

ament_export_dependencies(rosidl_default_runtime)
ament_package()
"""
PACKAGE_XML = """<?xml version="1.0"?>
<package format="3">
  <name>{package}</name>
  <version>0.2.0</version>
  <description>Messages of seatrial's logs.</description>
  <maintainer email="seatrial@users.noreply.github.com">seatrial</maintainer>
  <license>MIT</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <build_depend>rosidl_default_generators</build_depend>
  <depend>std_msgs</depend>
  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
"""


# Layouts ----------------------------------------------------------------------------------------------------------


class Plot(NamedTuple):
    """One plot: its title with the unit, and the curves as topic and field."""

    title: str
    curves: list[tuple[str, str]]


def _plots(log: Log) -> list[Plot]:
    """What one looks at first, of what the log has."""
    found = []
    for source in log.sources(Ahrs):
        imu = f"/{source}/imu"
        found.append(Plot(f"{source}: p, q, r [rad/s]", [(imu, f"angular_velocity.{axis}") for axis in "xyz"]))
        found.append(Plot(f"{source}: specific force [m/s2]", [(imu, f"linear_acceleration.{axis}") for axis in "xy"]))
    for source in log.sources(Gnss):
        fix = f"/{source}/gnss"
        found.append(Plot(f"{source}: velocity north, east [m/s]", [(fix, "vel_n"), (fix, "vel_e")]))
    for kind, field, title in ((Command, "n_cmd", "command [-1..1]"), (Esc, "rpm", "shaft speed [rev/min]"),
                               (Servo, "pwm", "pulse [us]")):  # fmt: skip
        for source in log.sources(kind):
            topics = [ros_topic(f"/{source}/{n}/{NODE_TOPICS[kind]}") for n in log.nodes(kind, source)]
            found.append(Plot(f"{source}: {title}", [(topic, field) for topic in topics]))
    for source in log.sources(LoadCell):
        found.append(Plot(f"{source}: force [N]", [(f"/{source}/counts", "force")]))
    for source in log.sources(Scalar):
        found.append(Plot(f"{source} [{log.unit(source) or '-'}]", [(f"/signal/{source}", "value")]))
    return found


def _foxglove(log: Log, plots: Sequence[Plot], has_frames: bool) -> dict[str, Any]:
    """A layout of Foxglove Studio: a map and the frames of what has them, and the plots below each other."""
    panels: dict[str, Any] = {}
    for number, plot in enumerate(plots):
        panels[f"Plot!{number}"] = {
            "title": plot.title,
            "paths": [
                {"value": f"{name}.{field}", "enabled": True, "timestampMethod": "headerStamp",
                 "color": COLORS[i % len(COLORS)]}
                for i, (name, field) in enumerate(plot.curves)
            ],
            "showLegend": True, "isSynced": True, "xAxisVal": "timestamp",
        }  # fmt: skip
    side: list[str] = []
    if receivers := log.sources(Gnss):
        panels["map!0"] = {"followTopic": f"/{receivers[0]}/fix", "layer": "map"}
        side = ["map!0"]
    if has_frames:
        panels["3D!0"] = {"followTf": "base_link", "fixedFrame": "odom"}
        side.append("3D!0")
    columns = [_stacked([name for name in panels if name not in side]), _stacked(side)]
    left, right = columns
    layout = left if right is None else right if left is None else {
        "direction": "row", "first": left, "second": right, "splitPercentage": 65}  # fmt: skip
    return {"configById": panels, "globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1},
            "layout": layout}  # fmt: skip


def _stacked(names: Sequence[str]) -> Any:
    """Panels of equal height below each other, as the binary tree that a layout is."""
    if len(names) < 2:
        return names[0] if names else None
    half = (len(names) + 1) // 2
    return {"direction": "column", "first": _stacked(names[:half]), "second": _stacked(names[half:]),
            "splitPercentage": 100.0 * half / len(names)}  # fmt: skip


def _plotjuggler(plots: Sequence[Plot]) -> str:
    """A layout of PlotJuggler: one tab, the plots below each other; it opens the bag beside it."""
    root = ElementTree.Element("root")
    window = ElementTree.SubElement(root, "tabbed_widget", {"parent": "main_window", "name": "Main Window"})
    tab = ElementTree.SubElement(window, "Tab", tab_name="log", containers="1")
    n = max(len(plots), 1)
    sizes = ";".join([f"{1 / n:.6f}"] * n)
    split = ElementTree.SubElement(
        ElementTree.SubElement(tab, "Container"), "DockSplitter", orientation="-", count=str(n), sizes=sizes
    )
    for title, curves in plots or [Plot("empty", [])]:
        area = ElementTree.SubElement(split, "DockArea", name=title)
        plot = ElementTree.SubElement(area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false")
        ElementTree.SubElement(plot, "limitY")
        for i, (name, field) in enumerate(curves):
            curve = f"{name}/{field.replace('.', '/')}"
            ElementTree.SubElement(plot, "curve", name=curve, color=COLORS[i % len(COLORS)])
    ElementTree.SubElement(window, "currentTabIndex", index="0")
    ElementTree.SubElement(root, "use_relative_time_offset", enabled="1")
    files = ElementTree.SubElement(root, "previouslyLoaded_Datafiles")
    ElementTree.SubElement(files, "fileInfo", prefix="", filename=f"{BAG}/{BAG}.mcap")
    ElementTree.indent(root, " ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
