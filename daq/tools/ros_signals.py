"""ROS messages of the imported signals of a log: Imu, NavSatFix and odometry in the axes of REP-103.

| topic | type | from the signals |
|---|---|---|
| `/ros/imported/imu` | sensor_msgs/msg/Imu | `psi`, `theta`, `phi`; `p`, `q`, `r`; `ax`, `ay`, `az` |
| `/ros/imported/fix` | sensor_msgs/msg/NavSatFix | `x`, `y` made from latitude and longitude; `lat`, `lon` |
| `/odom`, `/tf` | nav_msgs/msg/Odometry and its transform | `psi` and `x`, `y`; `vx`, `vy` or `u`, `v`; rates |

An Imu message has a quantity only if one of its signals has a sample at this time; otherwise its covariance is -1. An
unmeasured component beside a measured one is 0 with a variance of 1e6. The variance of a measured component is that of
its declared noise. Without one it is 0, which means unknown in ROS.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from seatrial.daq.config import parse_toml, read_text
from seatrial.daq.errors import SeatrialError
from seatrial.daq.geometry import from_local_ned, local_ned, quaternion, rotation_matrix
from seatrial.daq.log import NANO, Log, schema
from seatrial.daq.samples import Ahrs, Gnss, Scalar
from seatrial.daq.tools.ros_frames import MAX_GAP_S, NO_MEASUREMENT, Array, RosMessage, pose_messages

IMU, FIX = "/ros/imported/imu", "/ros/imported/fix"
ANGLES, RATES, FORCES = ("phi", "theta", "psi"), ("p", "q", "r"), ("ax", "ay", "az")
TURNED = (1.0, -1.0, -1.0)  # signs of a vector from forward, starboard, down to forward, left, up
UNITS = {
    **dict.fromkeys(ANGLES, "rad"),
    **dict.fromkeys(RATES, "rad/s"),
    **dict.fromkeys(FORCES, "m/s2"),
    **dict.fromkeys(("x", "y"), "m"),
    **dict.fromkeys(("vx", "vy", "u", "v"), "m/s"),
    **dict.fromkeys(("lat", "lon"), "rad"),
}
NOISE_FORMAT = "seatrial-noise 2"
NO_ESTIMATE = np.array([-1.0, *[0.0] * 8])  # of a quantity without a sample, in sensor_msgs
GPS, APPROXIMATED = 1, 1  # service of the status, and kind of the covariance, of a NavSatFix


@dataclass(frozen=True)
class Series:
    """Samples of one signal: times ``t`` (n,) [ns since 1970], rising, and values ``y`` (n,) in SI units, finite."""

    t: np.typing.NDArray[np.int64]
    y: Array

    def between(self, t: np.typing.NDArray[np.int64]) -> Array:
        """Return the values at times (m,) [ns], by linear interpolation.

        NaN outside the samples, and in gaps of more than 2 s. A time of a sample has its value.
        """
        after = np.clip(np.searchsorted(self.t, t), 0, self.t.size - 1)
        before = np.clip(after - 1, 0, None)
        exact = self.t[after] == t
        inside = (self.t[before] <= t) & (t <= self.t[after]) & (self.t[after] - self.t[before] <= MAX_GAP_S * NANO)
        start = self.t[0]  # differences: the times themselves have more digits than a float
        found = np.interp((t - start).astype(float), (self.t - start).astype(float), self.y)
        return np.where(exact, self.y[after], np.where(inside, found, np.nan))


@dataclass(frozen=True)
class ImportedMotion:
    """Imported signals of the motion of a boat, in NED and in body axes (FRD).

    Attributes
    ----------
    series
        Samples by name of the signal, which is one of `UNITS`.
    noise
        Standard deviation of the noise by name of the signal, in SI units; signals with unknown noise are not in it.
    origin
        Latitude and longitude [deg] of the zero of x and y; None if they are unknown.
    has_imu, has_fixes, has_odometry
        Whether there are messages of each kind.
    """

    series: Mapping[str, Series]
    noise: Mapping[str, float]
    origin: tuple[float, float] | None
    has_imu: bool
    has_fixes: bool
    has_odometry: bool

    @property
    def types(self) -> dict[str, str]:
        """Message type of each topic that is encoded already."""
        both = {IMU: (schema.IMU, self.has_imu), FIX: (schema.FIX, self.has_fixes)}
        return {topic: kind for topic, (kind, there) in both.items() if there}

    def variance(self, name: str, measured: bool) -> float:
        """Return the variance of a component: 1e6 without a measurement, 0 if the noise is unknown."""
        return self.noise.get(name, 0.0) ** 2 if measured else NO_MEASUREMENT


def declared_noise(path: Path) -> dict[str, float]:
    """Return the white noise by channel of a noise.toml (`seatrial ident noise`), in SI units.

    A channel of several logs has the largest. Channels without white noise are left out. SeatrialError is raised if the
    file is no noise.toml.
    """
    table = parse_toml(read_text(path), path).values
    if table.get("format") != NOISE_FORMAT:
        raise SeatrialError(f"{path}: format is {table.get('format')!r}, not {NOISE_FORMAT!r}: give a noise.toml")
    found: dict[str, float] = {}
    try:
        for channel in table.get("channel", ()):
            if "white" in channel and "white_se" in channel:
                name, white = str(channel["name"]), float(channel["white"])
                found[name] = max(white, found.get(name, 0.0))
    except (AttributeError, KeyError, TypeError, ValueError) as problem:
        raise SeatrialError(
            f"{path}: a channel is incomplete ({problem}); run `seatrial ident noise` again"
        ) from problem
    return found


def imported_motion(log: Log, noise: Mapping[str, float]) -> ImportedMotion | None:
    """Return the imported signals of motion of a log, or None if it has none.

    An Imu message is made only if the log has no AHRS, a fix only if it has no GNSS receiver, and odometry only if it
    has not both. Signals in another unit than that of models are left out. ``noise``: standard deviations by name.
    """
    series = {}
    for name in log.sources(Scalar):
        if UNITS.get(name) == log.unit(name):
            table = log.table(Scalar, name)
            t, first = np.unique(np.round(table["t"] * NANO).astype(np.int64), return_index=True)
            y = table["value"][first]
            if np.isfinite(y).any():
                series[name] = Series(t[np.isfinite(y)], y[np.isfinite(y)])
    if not series:
        return None
    has_ahrs, has_gnss = bool(log.sources(Ahrs)), bool(log.sources(Gnss))
    origins = {log.position_origin(name) for name in ("x", "y") if name in series}
    origin = origins.pop() if len(origins) == 1 and {"x", "y"} <= set(series) else None
    placed = {"x", "y"} <= set(series) or {"lat", "lon"} <= set(series)
    geodetic = origin is not None or {"lat", "lon"} <= set(series)
    return ImportedMotion(
        series,
        noise,
        origin,
        has_imu=not has_ahrs and bool({*ANGLES, *RATES, *FORCES} & set(series)),
        has_fixes=not has_gnss and geodetic,
        has_odometry=not (has_ahrs and has_gnss) and placed and "psi" in series,
    )


def imu_messages(motion: ImportedMotion) -> Iterator[RosMessage]:
    """Yield an Imu message, encoded in CDR, for each time at which an angle, a rate or a force has a sample."""
    names = [n for n in (*ANGLES, *RATES, *FORCES) if n in motion.series]
    if not (motion.has_imu and names):
        return
    times = np.unique(np.concatenate([motion.series[n].t for n in names]))
    values = {n: np.full(times.size, np.nan) for n in (*ANGLES, *RATES, *FORCES)}
    for name in names:
        values[name][np.searchsorted(times, motion.series[name].t)] = motion.series[name].y
    columns = np.column_stack(list(values.values()))
    for t, row in zip(times.tolist(), columns, strict=True):
        known = np.isfinite(row)
        roll, pitch, yaw, *vectors = np.where(known, row, 0.0).tolist()
        signed = [sign * value for sign, value in zip(TURNED * 2, vectors, strict=True)]
        covariances = [
            _covariance(motion, group, known[3 * k : 3 * k + 3]) for k, group in enumerate((ANGLES, RATES, FORCES))
        ]
        content = (
            *quaternion(np.pi / 2 - yaw if known[2] else 0.0, -pitch, roll),
            covariances[0].tobytes(),
            *signed[:3],
            covariances[1].tobytes(),
            *signed[3:],
            covariances[2].tobytes(),
        )
        message = schema.Message(IMU, schema.IMU, "base_link", content)
        yield RosMessage(t, IMU, message.pack(t))


def _covariance(motion: ImportedMotion, names: Sequence[str], known: np.typing.NDArray[np.bool_]) -> Array:
    """Return the covariance (9,) of three components about or along the axes; -1 first if none has a sample."""
    if not known.any():
        return NO_ESTIMATE
    return np.diag([motion.variance(n, bool(k)) for n, k in zip(names, known, strict=True)]).ravel()


def fix_messages(motion: ImportedMotion) -> Iterator[RosMessage]:
    """Yield a NavSatFix message, encoded in CDR, for each time at which both coordinates have a sample.

    The height is NaN. The covariance is that of the noise of y (east) and x (north), if both are declared.
    """
    if not motion.has_fixes:
        return
    series = motion.series
    names = ("x", "y") if motion.origin is not None else ("lat", "lon")
    t, first, second = np.intersect1d(series[names[0]].t, series[names[1]].t, return_indices=True)
    a, b = series[names[0]].y[first], series[names[1]].y[second]
    lat, lon = (np.degrees(a), np.degrees(b)) if motion.origin is None else from_local_ned(a, b, motion.origin)
    declared = {"x", "y"} <= set(motion.noise)
    variances = [motion.variance("y", True), motion.variance("x", True), NO_MEASUREMENT] if declared else [0.0] * 3
    covariance, kind = np.diag(variances).tobytes(), APPROXIMATED if declared else 0
    for stamp, north, east in zip(t.tolist(), lat.tolist(), lon.tolist(), strict=True):
        content = (0, GPS, north, east, float("nan"), covariance, kind)
        yield RosMessage(stamp, FIX, schema.Message(FIX, schema.FIX, "base_link", content).pack(stamp))


def odometry_messages(motion: ImportedMotion, types: Any) -> Iterator[RosMessage]:
    """Yield ROS odometry and transforms at the times of the heading.

    Position, velocity, other angles and rates are interpolated between their samples. Times without a position, such as
    those in gaps of more than 2 s, are left out. ``types`` are the message classes of rosbags by name.
    """
    if not motion.has_odometry:
        return
    series = dict(motion.series)
    if not {"x", "y"} <= set(series):
        t, first, second = np.intersect1d(series["lat"].t, series["lon"].t, return_indices=True)
        if not t.size:
            return
        local = local_ned(np.degrees(series["lat"].y[first]), np.degrees(series["lon"].y[second]))
        series |= {name: Series(t, part) for name, part in zip(("x", "y"), local, strict=True)}
    t = series["psi"].t
    at = {n: series[n].between(t) if n in series else np.full(t.size, np.nan) for n in UNITS}
    for k in np.flatnonzero(np.isfinite(at["x"] + at["y"])):
        now = {name: float(values[k]) for name, values in at.items()}
        known = {name: value == value for name, value in now.items()}
        angles = [now[name] if known[name] else 0.0 for name in ("psi", "theta", "phi")]
        velocity, of_velocity = _body_velocity(motion, now, known, angles)
        rates = [now[name] if known[name] else 0.0 for name in RATES]
        of_pose = np.diag(
            [motion.variance("y", True), motion.variance("x", True), NO_MEASUREMENT]
            + [motion.variance(name, known[name]) for name in ANGLES]
        )
        of_twist = np.diag([0.0] * 3 + [motion.variance(name, known[name]) for name in RATES])
        of_twist[:3, :3] = of_velocity
        yield from pose_messages(
            int(t[k]) / NANO,
            np.array([now["x"], now["y"], 0.0]),
            angles,
            np.array([*velocity, *rates]),
            (of_pose, of_twist),
            types,
        )


def _body_velocity(
    motion: ImportedMotion, now: Mapping[str, float], known: Mapping[str, bool], angles: Sequence[float]
) -> tuple[Array, Array]:
    """Return the velocity forward, starboard, down [m/s] and its covariance (3, 3) in forward, left, up.

    It is that of ``u`` and ``v``, or else of ``vx`` and ``vy``. An unknown velocity is 0, with a variance of 1e6.
    """
    covariance = np.diag([NO_MEASUREMENT] * 3)
    if known["u"] and known["v"]:
        velocity = np.array([now["u"], now["v"], 0.0])
        covariance[:2, :2] = np.diag([motion.variance("u", True), motion.variance("v", True)])
    elif known["vx"] and known["vy"]:
        R = rotation_matrix(*angles)
        velocity = R.T @ np.array([now["vx"], now["vy"], 0.0])
        level = rotation_matrix(angles[0], 0.0, 0.0)[:2, :2]
        of_ground = np.diag([motion.variance("vx", True), motion.variance("vy", True)])
        covariance[:2, :2] = np.diag([1.0, -1.0]) @ level.T @ of_ground @ level @ np.diag([1.0, -1.0])
    else:
        velocity = np.zeros(3)
    return velocity, covariance
