"""Runs of one simulated boat with two thrusters, as other programs record them. seatrial writes none of the files.

The writers use scipy (MATLAB), rosbags (ROS 2) and the layout of ArduPilot's DataFlash messages.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

from tests.dataflash import dataflash_head, dataflash_message
from tests.own_boats import OwnBoat, simulated_run

T0 = 1_750_000_000.0  # s since 1970, start of the runs
FULL_THRUST, ARM, SHAFT_LAG = 40.0, 0.3, 0.2  # N of one thruster, m, s
DEVIATION = 0.04  # rad, of ArduPilot's compass: measured heading - heading = DEVIATION sin(heading)
LAT, LON, RADIUS = 41.0, -8.0, 6_371_000.0  # degrees, m
GPS_EPOCH, LEAP_SECONDS, WEEK = 315_964_800, 18, 604_800  # s
STORE = get_typestore(Stores.ROS2_HUMBLE)


def _two_thrusters(commands: Sequence[float], shafts: Sequence[float]) -> Sequence[float]:
    left, right = (FULL_THRUST * n * abs(n) for n in shafts)
    lags = [(command - n) / SHAFT_LAG for command, n in zip(commands, shafts, strict=True)]
    return left + right, 0.0, ARM * (left - right), *lags


BOAT = OwnBoat({"n_left": (-0.6, 1.0), "n_right": (-0.6, 1.0)}, _two_thrusters, 2, {})


class Run(NamedTuple):
    """Measured run: times [s] from zero, and columns by name (inputs, psi, r, x, y, vx, vy, ax, ay) in SI units."""

    t: np.ndarray
    columns: dict[str, np.ndarray]


@cache
def run(seed: int, seconds: float = 70.0) -> Run:
    """Return a run with random steps of both thrusters, at 10 Hz."""
    return Run(*simulated_run(BOAT, seed, seconds))


def write_plotjuggler(path: Path, r: Run) -> None:
    """Write a CSV as PlotJuggler exports it: paths of topics, axes of ROS, empty cells between samples."""
    slow = np.arange(r.t.size) % 2 == 1  # the position has every second row only
    columns = {
        "/imu/data/angular_velocity/z": -r.columns["r"],
        "/imu/data/orientation/yaw": np.angle(np.exp(1j * (np.pi / 2 - r.columns["psi"]))),
        "/odom/pose/pose/position/x": np.where(slow, np.nan, r.columns["y"]),
        "/odom/pose/pose/position/y": np.where(slow, np.nan, r.columns["x"]),
        "/thrusters/left/command/data": r.columns["n_left"],
        "/thrusters/right/command/data": r.columns["n_right"],
    }
    lines = [",".join(["__time", *columns])]
    for t, *values in zip(T0 + r.t, *columns.values(), strict=True):
        lines.append(",".join([f"{t:.6f}", *("" if np.isnan(v) else f"{v:.9f}" for v in values)]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_mat(path: Path, r: Run) -> None:
    """Write a workspace of MATLAB with the names of the page: the time and the signals as column vectors."""
    names = {"n_left": "n_left", "n_right": "n_right", "psi": "psi_rad", "r": "r_rad_s", "x": "x_m", "y": "y_m"}
    savemat(path, {"t": r.t, **{new: r.columns[name] for name, new in names.items()}}, oned_as="column")


def write_bag(path: Path, r: Run) -> None:
    """Write a rosbag2: Imu in the axes of REP-103, NavSatFix, and a Float64 for each thruster."""
    types = STORE.types
    vector, turn = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    zero = np.zeros(9)
    with Writer(path, version=9) as writer:
        topics = {
            "/imu/data": "sensor_msgs/msg/Imu",
            "/fix": "sensor_msgs/msg/NavSatFix",
            "/thrusters/left/command": "std_msgs/msg/Float64",
            "/thrusters/right/command": "std_msgs/msg/Float64",
        }
        open_topics = {
            name: (writer.add_connection(name, kind, typestore=STORE), kind) for name, kind in topics.items()
        }
        for k, t in enumerate(r.t):
            at = {name: float(column[k]) for name, column in r.columns.items()}
            stamp = round((T0 + t) * 1e9)
            time = types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
            header = types["std_msgs/msg/Header"](time, "base_link")
            yaw = np.pi / 2 - at["psi"]
            attitude = turn(0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
            rates, force = vector(0.0, 0.0, -at["r"]), vector(at["ax"], -at["ay"], 9.81)
            status = types["sensor_msgs/msg/NavSatStatus"](2, 1)
            messages = {
                "/imu/data": types["sensor_msgs/msg/Imu"](header, attitude, zero, rates, zero, force, zero),
                "/fix": types["sensor_msgs/msg/NavSatFix"](header, status, *_place(at["x"], at["y"]), 0.0, zero, 2),
                "/thrusters/left/command": types["std_msgs/msg/Float64"](at["n_left"]),
                "/thrusters/right/command": types["std_msgs/msg/Float64"](at["n_right"]),
            }
            for name, message in messages.items():
                connection, kind = open_topics[name]
                writer.write(connection, stamp, STORE.serialize_cdr(message, kind))


def write_stand(path: Path) -> None:
    """Write the table of a thrust stand (RCbenchmark) with forward commands. The thrust is quadratic in the command."""
    t = np.arange(0.0, 72.0, 0.02)
    command = np.repeat((0.0, 0.2, 0.0, 0.4, 0.6, 0.8, 1.0, 0.5, 0.0), t.size // 9)
    n = np.zeros(t.size)
    for k in range(t.size - 1):
        n[k + 1] = n[k] + 0.02 / SHAFT_LAG * (command[k] - n[k])
    rng = np.random.default_rng(3)
    force = FULL_THRUST * n * n + 0.1 * rng.normal(size=t.size)
    rpm = np.abs(3000.0 * n + 5.0 * rng.normal(size=t.size))
    lines = ["Time (s),ESC signal (µs),Thrust (kgf),Voltage (V),Current (A),Motor Optical Speed (RPM)"]
    for row in zip(t, 1000.0 + 1000.0 * command, force / 9.80665, 14.8 + 0.0 * t, 20.0 * n * n, rpm, strict=True):
        lines.append("{:.2f},{:.0f},{:.5f},{:.2f},{:.2f},{:.0f}".format(*row))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


SERVOS = {1: 73.0, 3: 74.0}  # output: function (throttle left, throttle right)


def write_dataflash(path: Path, r: Run) -> None:
    """Write a BIN of ArduPilot Rover with two thrusters. The compass has a deviation."""
    out = bytearray(dataflash_head())

    def add(name: str, *values: float | bytes) -> None:
        out.extend(dataflash_message(name, *values))

    add("MSG", 1_000_000, b"ArduRover V4.6.0 (1a2b3c4d)")
    add("ARM", 1_000_000, 1)
    for servo, function in SERVOS.items():
        values = {"FUNCTION": function, "MIN": 1100.0, "TRIM": 1500.0, "MAX": 1900.0, "REVERSED": 0.0}
        for key, value in values.items():
            add("PARM", 1_000_000, f"SERVO{servo}_{key}".encode(), value)
    for k, t in enumerate(r.t):
        at = {name: float(column[k]) for name, column in r.columns.items()}
        us = 30_000_000 + round(1e6 * t)
        week, seconds = divmod(T0 + t - GPS_EPOCH + LEAP_SECONDS, WEEK)
        place = (*(round(1e7 * degrees) for degrees in _place(at["x"], at["y"])), 0)
        speed, course = np.hypot(at["vx"], at["vy"]), np.degrees(np.arctan2(at["vy"], at["vx"])) % 360.0
        add("GPS", us, 0, 4, round(1000 * seconds), int(week), 12, 80, *place, speed, course, 0.0, 0.0, 0.0, 1)
        add("GPA", us, 0, us // 1000)
        heading = np.degrees(at["psi"] + DEVIATION * np.sin(at["psi"])) % 360.0
        add("ATT", us, 0, 0, 0, 0, 0, round(100 * (heading if heading < 180.0 else heading - 360.0)), 0.0, 0.0)
        add("IMU", us + 90, 0, 0.0, 0.0, at["r"], at["ax"], at["ay"], -9.81)
        add("RCOU", us, round(1500 + 400 * at["n_left"]), 0, round(1500 + 400 * at["n_right"]))
    path.write_bytes(out)


def _place(north: float, east: float) -> tuple[float, float]:
    """Return latitude and longitude [deg] of a place north and east [m] of the start."""
    lat = LAT + np.degrees(north / RADIUS)
    return float(lat), float(LON + np.degrees(east / RADIUS / np.cos(np.radians(LAT))))
