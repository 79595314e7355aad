"""Tests of the export of imported logs to ROS: Imu, NavSatFix and odometry from signals, read by rosbags."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from seatrial.daq import cli
from seatrial.daq.errors import SeatrialError
from seatrial.daq.geometry import from_local_ned, local_ned
from seatrial.daq.importers.guess import guess_map
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.log.reader import open_log
from seatrial.daq.tools.ros_frames import NO_MEASUREMENT
from seatrial.daq.tools.ros_signals import declared_noise
from tests.daq.tools.test_ros_export import messages
from tests.dataflash import dataflash_head, dataflash_message

rosbags = pytest.importorskip("rosbags.highlevel", reason="no reader of bags here (rosbags)")
ROOT = Path(__file__).resolve().parents[3]
LAT, LON, HEADING, RATE = 63.4, 10.4, np.radians(30.0), 0.1
NOISE = """format = "seatrial-noise 2"
channel = [
  { log = "a", name = "psi", white = 0.02, white_se = 0.001 },
  { log = "b", name = "psi", white = 0.01, white_se = 0.001 },
  { name = "r", white = 0.001, white_se = 0.0001 }, { name = "x", white = 0.5, white_se = 0.01 },
  { name = "y", white = 0.4, white_se = 0.01 }, { name = "vx", white = 0.2, white_se = 0.01 },
  { name = "vy", white = 0.1, white_se = 0.01 }, { name = "ax", white_limit = 1.0 },
]
"""
MAP = """format = "seatrial-import 1"
time = { column = "t", format = "s" }
signal = [
  { name = "x", make = "north", columns = ["lat", "lon"] }, { name = "y", make = "east", columns = ["lat", "lon"] },
  { name = "psi", column = "psi", unit = "rad" }, { name = "r", column = "r", unit = "rad/s" },
  { name = "ax", column = "ax", unit = "m/s2" }, { name = "ay", column = "ay", unit = "m/s2" },
  { name = "vx", column = "vx", unit = "m/s" }, { name = "vy", column = "vy", unit = "m/s" },
]
"""


def imported(folder: Path, columns: dict[str, np.ndarray], text: str = MAP) -> Path:
    """Write columns as CSV, and import them with a map."""
    table = np.column_stack(list(columns.values()))
    np.savetxt(folder / "run.csv", table, "%.10g", ",", header=",".join(columns), comments="")
    (folder / "map.toml").write_text(text, encoding="utf-8")
    import_files(folder / "map.toml", [folder / "run.csv"], out=folder / "run.mcap", force=True)
    return folder / "run.mcap"


def boat() -> dict[str, np.ndarray]:
    """Return a boat that moves north-east at 2 m/s, heading 30 degrees, turning 0.1 rad/s to starboard."""
    t, one = 0.1 * np.arange(41), np.ones(41)
    lat, lon = from_local_ned(1.4 * t, 1.5 * t, (LAT, LON))
    return {
        "t": t, "lat": lat, "lon": lon, "psi": HEADING * one, "r": RATE * one, "ax": 0.3 * one, "ay": 0.2 * one,
        "vx": 1.4 * one, "vy": 1.5 * one,
    }  # fmt: skip


def exported(log: Path, *words: str) -> dict[str, list[Any]]:
    out = log.parent / "out"
    run = CliRunner().invoke(cli.export, ["ros", str(log), "--out", str(out), "--force", *words])
    assert run.exit_code == 0, run.output
    return messages(out)


def test_imported_signals_become_messages_of_ros(tmp_path: Path) -> None:
    found = exported(imported(tmp_path, boat()))
    assert {topic: len(found[topic]) for topic in ("/ros/imported/imu", "/ros/imported/fix", "/odom", "/tf")} == {
        "/ros/imported/imu": 41, "/ros/imported/fix": 41, "/odom": 41, "/tf": 41,
    }  # fmt: skip
    imu = found["/ros/imported/imu"][7]
    assert imu.header.frame_id == "base_link"
    assert imu.header.stamp.nanosec == pytest.approx(7e8, abs=1e3)
    q = imu.orientation
    assert (q.x, q.y) == (0.0, 0.0)
    assert 2.0 * np.arctan2(q.z, q.w) == pytest.approx(np.pi / 2 - HEADING)  # from east, anticlockwise
    assert np.diag(imu.orientation_covariance.reshape(3, 3)).tolist() == [NO_MEASUREMENT, NO_MEASUREMENT, 0.0]
    assert (imu.angular_velocity.x, imu.angular_velocity.z) == (0.0, -RATE)
    assert np.diag(imu.angular_velocity_covariance.reshape(3, 3)).tolist() == [NO_MEASUREMENT, NO_MEASUREMENT, 0.0]
    assert (imu.linear_acceleration.x, imu.linear_acceleration.y) == (0.3, -0.2)
    assert np.diag(imu.linear_acceleration_covariance.reshape(3, 3)).tolist() == [0.0, 0.0, NO_MEASUREMENT]
    fix, columns = found["/ros/imported/fix"][40], boat()
    assert (fix.latitude, fix.longitude) == pytest.approx(
        (columns["lat"][40], columns["lon"][40]), abs=1e-8
    )  # about 1 mm
    assert np.isnan(fix.altitude)
    assert (fix.status.status, fix.position_covariance_type) == (0, 0)
    odometry = found["/odom"][40]
    place, speed = odometry.pose.pose.position, odometry.twist.twist.linear
    assert (place.x, place.y) == pytest.approx((1.5 * 4.0, 1.4 * 4.0), abs=1e-3)
    assert speed.x == pytest.approx(1.4 * np.cos(HEADING) + 1.5 * np.sin(HEADING))
    assert speed.y == pytest.approx(1.4 * np.sin(HEADING) - 1.5 * np.cos(HEADING))  # to port
    assert odometry.twist.twist.angular.z == -RATE


def test_covariances_are_those_of_the_declared_noise(tmp_path: Path) -> None:
    (tmp_path / "noise.toml").write_text(NOISE, encoding="utf-8")
    noise = declared_noise(tmp_path / "noise.toml")
    assert (noise["psi"], "ax" in noise) == (0.02, False)  # the largest of both logs; a limit is no noise
    found = exported(imported(tmp_path, boat()), "--noise", str(tmp_path / "noise.toml"))
    imu, fix, odometry = (found[t][3] for t in ("/ros/imported/imu", "/ros/imported/fix", "/odom"))
    assert imu.orientation_covariance[8] == pytest.approx(0.02**2)
    assert imu.angular_velocity_covariance[8] == pytest.approx(0.001**2)
    assert np.diag(fix.position_covariance.reshape(3, 3)).tolist() == pytest.approx([0.16, 0.25, NO_MEASUREMENT])
    assert fix.position_covariance_type == 1
    of_pose = np.diag(odometry.pose.covariance.reshape(6, 6))
    assert of_pose.tolist() == pytest.approx([0.16, 0.25, *[NO_MEASUREMENT] * 3, 0.0004])
    # The variance along a direction of the body, from those of north (0.04) and east (0.01).
    ahead = np.array([np.cos(HEADING), np.sin(HEADING)])
    port = np.array([np.sin(HEADING), -np.cos(HEADING)])
    of_ground = np.diag([0.04, 0.01])
    expected = [[a @ of_ground @ b for b in (ahead, port)] for a in (ahead, port)]
    np.testing.assert_allclose(odometry.twist.covariance.reshape(6, 6)[:2, :2], expected, atol=1e-12)


def test_the_command_of_the_page_runs_as_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (ROOT / "docs/formats/export-ros.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```sh\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    imported(tmp_path, boat()).rename(tmp_path / "imported.mcap")
    (tmp_path / "noise").mkdir()
    (tmp_path / "noise/noise.toml").write_text(NOISE, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    program, command, *words = block.split()
    assert (program, command) == ("seatrial", "export")
    CliRunner().invoke(cli.export, words, catch_exceptions=False)
    assert messages(Path("imported-ros"))["/odom"]


def test_a_quantity_without_a_sample_is_marked_and_no_position_is_invented(tmp_path: Path) -> None:
    """The heading has every fifth row, and there is no latitude: no NavSatFix. A gap of 3 s has no odometry."""
    columns = boat()
    columns["psi"] = np.where(np.arange(41) % 5 == 0, columns["psi"], np.nan)
    gap = (columns["t"] > 0.95) & (columns["t"] < 3.95)
    columns["x"] = np.where(gap, np.nan, 1.4 * columns["t"])
    columns["y"] = np.where(gap, np.nan, 1.5 * columns["t"])
    start = 'signal = [\n  { name = "x", column = "x", unit = "m" }, { name = "y", column = "y", unit = "m" },\n'
    end = MAP[MAP.index('  { name = "psi"') :].replace("},", ', nan = "drop" },')
    text = MAP[: MAP.index("signal = [")] + start.replace("},", ', nan = "drop" },') + end
    found = exported(imported(tmp_path, columns, text.replace(" ,", ",")))
    assert "/ros/imported/fix" not in found
    assert len(found["/ros/imported/imu"]) == 41
    unknown = [m.orientation_covariance[0] == -1.0 for m in found["/ros/imported/imu"]]
    assert unknown == [k % 5 != 0 for k in range(41)]
    stamps = [m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in found["/odom"]]
    assert [round(t, 3) for t in stamps] == [0.0, 0.5, 4.0]


def test_a_dataflash_log_gets_the_messages_of_ros(tmp_path: Path) -> None:
    content = dataflash_head()
    for k in range(60):
        us = 100_000 * k
        content += dataflash_message("ATT", us, 0, 150, 0, -200, 0, 9000, 0.0, 0.0)  # roll 1.5, pitch -2, yaw 90 deg
        content += dataflash_message("IMU", us, 0, 0.01, 0.02, 0.1, 0.3, 0.2, -9.7)
        if k % 2 == 0:
            week_ms = 1_000 * 100 + 100 * k
            fix = (us, 0, 3, week_ms, 2300, 10, 90, int(63.4e7) + 10 * k, int(10.4e7), 500, 1.0, 0.0, 0.0, 0.0, 0.0, 1)
            content += dataflash_message("GPS", *fix)
    (tmp_path / "run.bin").write_bytes(content)
    (tmp_path / "map.toml").write_text(guess_map(tmp_path / "run.bin").text, encoding="utf-8")
    import_files(tmp_path / "map.toml", [tmp_path / "run.bin"], out=tmp_path / "run.mcap")
    found = exported(tmp_path / "run.mcap")
    assert len(found["/ros/imported/fix"]) == 30
    assert found["/ros/imported/fix"][29].latitude == pytest.approx(63.4 + 58e-6, abs=1e-9)
    attitudes = [m for m in found["/ros/imported/imu"] if m.orientation_covariance[0] != -1.0]
    assert len(attitudes) == 60
    q = attitudes[5].orientation
    assert 2.0 * np.arctan2(q.z, q.w) == pytest.approx(0.0, abs=1e-6)  # 90 degrees from north is east
    rates = [m for m in found["/ros/imported/imu"] if m.angular_velocity_covariance[0] != -1.0]
    assert rates[5].angular_velocity.z == pytest.approx(-0.1)
    assert found["/odom"]


def test_the_zero_of_a_position_is_kept_only_if_it_is_known(tmp_path: Path) -> None:
    for change, origin in (("", (LAT, LON)), (", scale = 0.5", None), (", offset = 3.0", None)):
        text = MAP.replace('make = "north"', f'make = "north"{change}')
        with open_log(imported(tmp_path, boat(), text)) as log:
            assert log.position_origin("x") == (None if origin is None else pytest.approx(origin))
            assert log.position_origin("psi") is None
    north, east = local_ned(*(np.array(c) for c in zip((LAT, LON), (63.41, 10.43), strict=True)))
    lat, lon = from_local_ned(north, east, (LAT, LON))
    assert (lat[1], lon[1]) == pytest.approx((63.41, 10.43), abs=1e-12)
    assert from_local_ned(np.zeros(1), np.array([5e4]), (0.0, 179.9))[1][0] == pytest.approx(-179.65, abs=0.01)


def test_noise_is_refused_for_other_forms_and_files(tmp_path: Path) -> None:
    log = imported(tmp_path, boat())
    words = [str(log), "--out", str(tmp_path / "out"), "--noise", str(tmp_path / "map.toml")]
    assert "--noise applies only to ros" in CliRunner().invoke(cli.export, ["csv", *words]).output
    with pytest.raises(SeatrialError, match=r"map\.toml: format is 'seatrial-import 1', not 'seatrial-noise 2'"):
        CliRunner().invoke(cli.export, ["ros", *words], catch_exceptions=False)
