"""Export of a log for ROS tools (`seatrial export ros`): a bag, a message package and layouts of viewers.

The bag (rosbag2, storage MCAP) contains every message of the log without change. It also contains the following
messages in the axes of REP-103 (body forward, left, up; world east, north, up) and the frames of REP-105:

| topic | type | from |
|---|---|---|
| `/ros/DEVICE/imu` | sensor_msgs/msg/Imu, frame `base_link` | every AHRS |
| `/odom` | nav_msgs/msg/Odometry, `odom` to `base_link` | the first AHRS with a heading and the first GNSS receiver |
| `/tf` | tf2_msgs/msg/TFMessage, `odom` to `base_link` | the same |

An imported log, which has signals in place of devices, gets the messages of `seatrial.daq.tools.ros_signals`.

The origin of `odom` is the first fix. The origin of `base_link` is the reference point of the lever arms in the rig
file.
"""

from __future__ import annotations

import heapq
import json
import re
import shutil
from collections.abc import Collection, Iterator, Mapping, Sequence
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
from seatrial.daq.geometry import local_ned, rotation_matrix
from seatrial.daq.log import NODE_TOPICS, Log, schema
from seatrial.daq.samples import Ahrs, Command, Esc, Frame, Gnss, LoadCell, Scalar, Servo
from seatrial.daq.tools.ros_frames import MAX_GAP_S, NO_MEASUREMENT, RosMessage, nanoseconds, pose_messages
from seatrial.daq.tools.ros_signals import FIX, fix_messages, imported_motion, imu_messages, odometry_messages

PACKAGE = "seatrial_msgs"
BAG, PACKAGE_FOLDER, FOXGLOVE, PLOTJUGGLER = "bag", PACKAGE, "foxglove.json", "plotjuggler.xml"
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")  # Okabe and Ito; colour-blind people can distinguish them
Array = NDArray[np.float64]


def export_ros(log: Log, folder: Path, force: bool = False, noise: Mapping[str, float] | None = None) -> list[Path]:
    """Export a log for ROS 2: a bag, a package with the message definitions, and layouts of viewers.

    Parameters
    ----------
    log
        The log.
    folder
        Folder of the outputs.
    force
        Whether existing outputs may be replaced. An existing folder of the bag or of the package is then deleted with
        all its content before it is written.
    noise
        Standard deviation of the noise of imported signals, by name, in SI units, for the covariances. None, or a
        signal that is not among them: unknown.

    Returns
    -------
    list
        The written files and folders: bag, seatrial_msgs, foxglove.json and plotjuggler.xml in `folder`.

    Raises
    ------
    SeatrialError
        If rosbags is not installed, if an output is a symbolic link or exists already, or if it cannot be written.
    """
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
    except ModuleNotFoundError as error:
        raise SeatrialError("bags of ROS 2 need the package rosbags: pip install 'seatrial[ros2]'") from error
    made = [folder / name for name in (BAG, PACKAGE_FOLDER, FOXGLOVE, PLOTJUGGLER)]
    for path in made:
        if path.is_symlink():
            raise SeatrialError(f"{path}: is a symbolic link, and outputs follow no links; remove it")
        if path.exists() and not force:
            raise SeatrialError(f"{path}: exists already; --force replaces it, --out names another folder")
    store = ros_types()
    ahrs = {source: log.table(Ahrs, source) for source in log.sources(Ahrs)}
    added = [
        *(_imu_messages(source, rows) for source, rows in ahrs.items()),
        _odometry_messages(log, ahrs, store.types),
    ]
    signals = imported_motion(log, noise or {})
    if signals is not None:
        added += [imu_messages(signals), fix_messages(signals), odometry_messages(signals, store.types)]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path in made[:2]:
            shutil.rmtree(path, ignore_errors=True)
        with Writer(made[0], version=9, storage_plugin=StoragePlugin.MCAP) as bag:
            kinds = {**log.types(), **{f"/ros/{source}/imu": schema.IMU for source in ahrs}}
            kinds |= {} if signals is None else signals.types
            connections = {
                name: bag.add_connection(ros_topic(name), kind, typestore=store) for name, kind in kinds.items()
            }
            for stamp_ns, name, message in heapq.merge(log.messages(), *added, key=itemgetter(0)):
                if isinstance(message, bytes):
                    data = message
                else:
                    kind = message.__msgtype__
                    if name not in connections:
                        connections[name] = bag.add_connection(name, kind, typestore=store)
                    data = bytes(store.serialize_cdr(message, kind))
                bag.write(connections[name], stamp_ns, data)
        _write_package(made[1])
        plots = _plots_of_log(log)
        write_output(
            made[2],
            json.dumps(_foxglove_layout(plots, _fix_topic(log, connections), "/tf" in connections), indent=1) + "\n",
        )
        write_output(made[3], _plotjuggler_layout(plots))
    except OSError as error:
        raise SeatrialError(
            f"{error.filename or folder}: cannot be written: {error.strerror}; give another folder with -o"
        ) from error
    return made


def ros_topic(topic: str) -> str:
    """Return the valid ROS 2 name of a topic of the log: /can0/1/state becomes /can0/node_1/state.

    Each part of the name that begins with a digit gets "node_" in front; all other names stay. In ROS 2 no part of a
    name may begin with a digit; `ros2 bag play` leaves such topics out.
    """
    return re.sub(r"/(\d)", r"/node_\1", topic)


# REP-103 ----------------------------------------------------------------------------------------------------------


def rep_103_imu(device: str, sample: Ahrs) -> schema.Message:
    """Convert a sample of an AHRS to an Imu message in the axes of REP-103.

    The axes change from forward, starboard, down to forward, left, up: y and z change their signs. The heading counts
    from east, anticlockwise, instead of from north, clockwise. The magnetic field is left out.

    Parameters
    ----------
    device
        Name of the AHRS.
    sample
        The sample, in the body frame (FRD) and NED.

    Returns
    -------
    schema.Message
        Message for the topic /ros/DEVICE/imu in the frame `base_link`. NaN becomes 0. A covariance of -1 marks the
        quantities that the AHRS does not measure; a variance of 1e6 marks an unknown angle beside a known one.
    """
    turned = replace(
        sample, yaw=np.pi / 2 - sample.yaw, pitch=-sample.pitch,
        q=-sample.q, r=-sample.r, ay=-sample.ay, az=-sample.az, mx=np.nan, my=np.nan, mz=np.nan,
    )  # fmt: skip
    imu = schema.messages(device, Frame(turned, np.nan, np.nan))[-1]
    # Zero for NaN: a covariance of -1 marks the unknown quantities.
    finite = tuple(0.0 if value != value else value for value in imu.values)
    return schema.Message(f"/ros/{device}/imu", imu.type_name, "base_link", finite)


def _imu_messages(source: str, rows: NDArray[np.void]) -> Iterator[RosMessage]:
    """Yield a ROS Imu message in the axes of REP-103 for each sample in the table `rows` of the AHRS `source`.

    The message is encoded in CDR, for the topic /ros/SOURCE/imu. REP-103 has the axes forward, left, up.
    """
    names = [field.name for field in fields(Ahrs)]
    for row in rows:
        message = rep_103_imu(source, Ahrs(*(float(row[name]) for name in names)))
        yield RosMessage(nanoseconds(row["t"]), message.topic, message.pack(nanoseconds(row["t"])))


def _odometry_messages(log: Log, ahrs_of: Mapping[str, NDArray[np.void]], types: Any) -> Iterator[RosMessage]:
    """Yield ROS odometry and transforms of the boat's reference point at the times of the first AHRS with a heading.

    Position and velocity are interpolated linearly between the fixes before and after each time. Times outside the
    fixes, and within a gap of more than 2 s between two fixes, are left out. Nothing is yielded without a heading or
    without two fixes of one receiver. The lever arm of the receiver in the rig is corrected. An unknown pitch, roll,
    height, rate or velocity becomes 0; rates and velocities are then marked by their variance. `ahrs_of` has the table
    of samples of each AHRS, and `types` are the message classes of rosbags by name.
    """
    headed = [rows for rows in ahrs_of.values() if np.isfinite(rows["yaw"]).any()]
    fixed = [(name, rows[_has_position(rows)]) for name in log.sources(Gnss) for rows in [log.table(Gnss, name)]]
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
        R = rotation_matrix(*angles)  # body to NED
        measured = np.array([row[name] for name in "pqr"])
        rates = np.nan_to_num(measured)
        position = (1 - w) * fixes[k - 1] + w * fixes[k] - R @ arm
        v = (1 - w) * speed[k - 1] + w * speed[k]
        has_velocity = bool(np.isfinite(v[:2]).all())  # many receivers do not report the vertical velocity
        velocity = R.T @ np.nan_to_num(v) - np.cross(rates, arm) if has_velocity else np.zeros(3)
        known = (has_velocity, has_velocity, has_velocity and bool(np.isfinite(v[2])), *np.isfinite(measured).tolist())
        twist = np.diag(np.where(known, 0.0, NO_MEASUREMENT))
        moved = np.concatenate([velocity, rates])
        yield from pose_messages(row["t"], position, angles, moved, (np.zeros((6, 6)), twist), types)


def _has_position(rows: NDArray[np.void]) -> NDArray[np.bool_]:
    """Return a mask (n,) of the rows of a table of GNSS samples that have a position and a fix of kind 2 or more.

    Kind 2 is a two-dimensional fix; see `Gnss.fix`.
    """
    return np.asarray((rows["fix"] >= 2) & np.isfinite(rows["lat"]) & np.isfinite(rows["lon"]))


# Interface package ------------------------------------------------------------------------------------------------


def ros_types() -> Any:
    """Return the type store of rosbags with the message types of ROS 2 (Humble) and of seatrial.

    Raises
    ------
    ModuleNotFoundError
        If rosbags is not installed.
    """
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for definition in _message_definitions():
        store.register(get_types_from_msg(definition.read_text(encoding="utf-8"), f"{PACKAGE}/msg/{definition.stem}"))
    return store


def _message_definitions() -> list[Path]:
    """Return the paths of the files (.msg) that define the messages of seatrial, sorted by name."""
    with resources.as_file(resources.files("seatrial.daq").joinpath("msg", PACKAGE)) as folder:
        return sorted(folder.glob("*.msg"))


def _write_package(folder: Path) -> None:
    """Write a ROS package with the message definitions of seatrial to a new folder, to be built by colcon.

    `ros2 topic echo` and readers of bags need this package to decode the messages. The folder must not exist; otherwise
    FileExistsError is raised.
    """
    (folder / "msg").mkdir(parents=True)
    names = []
    for definition in _message_definitions():
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
    """Plot in a layout of Foxglove or PlotJuggler.

    Attributes
    ----------
    title : str
        Title with the unit.
    curves : list of tuple
        Topic and field of each curve.
    """

    title: str  # with the unit
    curves: list[tuple[str, str]]  # topic and field


def _plots_of_log(log: Log) -> list[Plot]:
    """Return the plots for the layouts of an exported log: the most important signals of each of its devices.

    They are body rates, specific force, velocity over ground, commands, shaft speeds, pulses, forces of load cells and
    imported signals.
    """
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


def _fix_topic(log: Log, topics: Collection[str]) -> str:
    """Return the topic of the fixes for a map: of the first receiver, or of imported positions; "" without fixes."""
    receivers = log.sources(Gnss)
    return f"/{receivers[0]}/fix" if receivers else FIX if FIX in topics else ""


def _foxglove_layout(plots: Sequence[Plot], fixes: str, has_frames: bool) -> dict[str, Any]:
    """Return a layout of Foxglove Studio as the content of a JSON file.

    It has the plots below each other. Beside them are a map of the topic `fixes`, unless it is "", and a 3D view of the
    frames of the topic /tf if `has_frames` is true.
    """
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
    if fixes:
        panels["map!0"] = {"followTopic": fixes, "layer": "map"}
        side = ["map!0"]
    if has_frames:
        panels["3D!0"] = {"followTf": "base_link", "fixedFrame": "odom"}
        side.append("3D!0")
    columns = [_stacked_panels([name for name in panels if name not in side]), _stacked_panels(side)]
    left, right = columns
    layout = left if right is None else right if left is None else {
        "direction": "row", "first": left, "second": right, "splitPercentage": 65}  # fmt: skip
    return {"configById": panels, "globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1},
            "layout": layout}  # fmt: skip


def _stacked_panels(names: Sequence[str]) -> Any:
    """Return panels of a Foxglove layout in equal height below each other, as a binary tree of their names.

    One panel is its name; no panel is None.
    """
    if len(names) < 2:
        return names[0] if names else None
    half = (len(names) + 1) // 2
    return {"direction": "column", "first": _stacked_panels(names[:half]), "second": _stacked_panels(names[half:]),
            "splitPercentage": 100.0 * half / len(names)}  # fmt: skip


def _plotjuggler_layout(plots: Sequence[Plot]) -> str:
    """Return a layout of PlotJuggler as XML text, with all `plots` below each other.

    The layout opens the exported bag, which must be in the same folder. Without plots it has one empty plot.
    """
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
