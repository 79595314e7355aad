"""ROS messages in the axes of REP-103 and the frames of REP-105: poses, transforms, headers and vectors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.geometry import quaternion
from seatrial.daq.log import NANO

MAX_GAP_S = 2.0  # s; positions are not interpolated over a longer time between two fixes
NO_MEASUREMENT = 1e6  # variance of an unmeasured quantity; with variance 0 its value 0 would be a measurement
Array = NDArray[np.float64]


class RosMessage(NamedTuple):
    """One ROS message to write to a bag, with its time and topic.

    Attributes
    ----------
    stamp_ns : int
        Time of the run clock [ns since 1970].
    topic : str
        Name of the topic.
    message : object
        Message of rosbags, or bytes in CDR.
    """

    stamp_ns: int  # time of the run clock, ns since 1970
    topic: str
    message: Any  # object of rosbags, or bytes in CDR


def pose_messages(
    t: float, position: Array, angles: Sequence[float], twist: Array, covariances: tuple[Array, Array], types: Any
) -> Iterator[RosMessage]:
    """Yield the ROS odometry message and the transform for one pose of the boat, converted to the axes of REP-103.

    Parameters
    ----------
    t
        Time [s since 1970].
    position
        North, east and down from the first fix [m], shape (3,).
    angles
        Yaw, pitch and roll [rad].
    twist
        Velocity forward, starboard, down [m/s] and angular velocity about these axes [rad/s], shape (6,).
    covariances
        Covariances of the pose and of the twist, each (6, 6), in the axes of REP-103. Zero means unknown.
    types
        Message classes of rosbags by name.
    """
    header = _ros_header(t, "odom", types)
    enu = {"x": float(position[1]), "y": float(position[0]), "z": float(-position[2])}
    turned = _ros_quaternion(angles, types)
    pose = types["geometry_msgs/msg/Pose"](position=types["geometry_msgs/msg/Point"](**enu), orientation=turned)
    moved = types["geometry_msgs/msg/Twist"](
        linear=_ros_vector(twist[:3], types), angular=_ros_vector(twist[3:], types)
    )
    of_pose, of_twist = (covariance.ravel() for covariance in covariances)
    yield RosMessage(nanoseconds(t), "/odom", types["nav_msgs/msg/Odometry"](
        header=header, child_frame_id="base_link",
        pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=of_pose),
        twist=types["geometry_msgs/msg/TwistWithCovariance"](twist=moved, covariance=of_twist),
    ))  # fmt: skip
    transform = types["geometry_msgs/msg/Transform"](
        translation=types["geometry_msgs/msg/Vector3"](**enu), rotation=turned
    )
    stamped_type = types["geometry_msgs/msg/TransformStamped"]
    stamped = stamped_type(header=header, child_frame_id="base_link", transform=transform)
    yield RosMessage(nanoseconds(t), "/tf", types["tf2_msgs/msg/TFMessage"](transforms=[stamped]))


def nanoseconds(t: float) -> int:
    """Convert the time of a message from s to whole nanoseconds, rounded to the nearest one."""
    return round(float(t) * NANO)


def _ros_header(t: float, frame: str, types: Any) -> Any:
    """Return a ROS message header with a time [s since 1970] and the name of a frame.

    `types` are the message classes of rosbags by name.
    """
    sec, nanosec = divmod(nanoseconds(t), NANO)
    stamp = types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def _ros_vector(frd: Sequence[float] | Array, types: Any) -> Any:
    """Convert a vector from forward, starboard, down to a ROS vector in the axes forward, left, up.

    `types` are the message classes of rosbags by name.
    """
    x, y, z = map(float, frd)
    return types["geometry_msgs/msg/Vector3"](x=x, y=-y, z=-z)


def _ros_quaternion(angles: Sequence[float], types: Any) -> Any:
    """Convert yaw, pitch and roll [rad] in NED to the ROS quaternion of the body (forward, left, up) in ENU.

    Yaw then counts from east instead of north. Yaw and pitch change their signs with the axes z and y. `types` are the
    message classes of rosbags by name.
    """
    yaw, pitch, roll = angles
    x, y, z, w = quaternion(np.pi / 2 - yaw, -pitch, roll)
    return types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)
