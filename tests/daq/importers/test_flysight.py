"""Tests of the import of FlySight 2 files, as written by its firmware of 2023 and later."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.daq.importers.guess import guess_map
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.log import open_log
from seatrial.daq.samples import Scalar

N = 100
START = datetime(2024, 5, 12, 13, 0, 0, tzinfo=UTC).timestamp()
HEAD = ["$FLYS,1", "$VAR,FIRMWARE_VER,v2023.09.22.2", "$VAR,SESSION_ID,88e923ed"]
GPS_S, LEAP_S, WEEK_S = 315_964_800, 18, 604_800


def track() -> list[str]:
    lines = [*HEAD, "$COL,GNSS,time,lat,lon,hMSL,velN,velE,velD,hAcc,vAcc,sAcc,numSV"]
    lines += ["$UNIT,GNSS,,deg,deg,m,m/s,m/s,m/s,m,m,m/s,", "$DATA"]
    for k in range(N):
        time = f"{datetime.fromtimestamp(START + 0.2 * k, UTC):%Y-%m-%dT%H:%M:%S.%f}"[:-3]
        lines.append(f"$GNSS,{time}Z,{59.0 + 1e-6 * k:.7f},10.0000000,3.1,{0.5 + 0.001 * k:.3f},0.1,0.0,1.0,2.0,0.3,12")
    return lines


def sensors() -> list[str]:
    """Return gyro rows with the time since power-on, whose clock is 1e-4 fast, and some rows with GPS time."""
    lines = [*HEAD, "$COL,IMU,time,wx,wy,wz,ax,ay,az,temperature", "$UNIT,IMU,s,deg/s,deg/s,deg/s,g,g,g,deg C"]
    lines += ["$COL,TIME,time,tow,week", "$UNIT,TIME,s,s,", "$DATA"]
    week, tow = divmod(START - GPS_S + LEAP_S, WEEK_S)
    for k in range(N):
        if k % 20 == 0:
            lines.append(f"$TIME,{7.0 + 0.2 * k * 1.0001:.6f},{tow + 0.2 * k:.3f},{week:.0f}")
        lines.append(f"$IMU,{7.0 + 0.2 * k * 1.0001:.6f},0.1,0.2,{0.1 * k:.2f},0.0,0.01,1.0,25.1")
    return lines


def test_a_flysight_track_is_imported(tmp_path: Path) -> None:
    source = tmp_path / "TRACK.CSV"
    source.write_text("\r\n".join(track()) + "\r\n")
    guess = guess_map(source)
    assert guess.problem.startswith("no commands, shaft speeds or forces")  # the file contains only a receiver
    (tmp_path / "map.toml").write_text(guess.text)
    (path,) = import_files(tmp_path / "map.toml", [source], out=tmp_path / "t.mcap")
    with open_log(path) as log:
        x, vx = log.table(Scalar, "x"), log.table(Scalar, "vx")
    np.testing.assert_allclose(x["t"], START + 0.2 * np.arange(N), atol=1e-3)
    np.testing.assert_allclose(x["value"], 0.1114 * np.arange(N), rtol=1e-3, atol=0.01)
    np.testing.assert_allclose(vx["value"], 0.5 + 0.001 * np.arange(N))


def test_sensors_get_the_time_of_gps(tmp_path: Path) -> None:
    source = tmp_path / "SENSOR.CSV"
    lines = sensors()
    source.write_text("\n".join([*lines[:60], lines[60][:20], *lines[61:]]) + "\n")  # one line is cut off
    guess = guess_map(source)
    assert '{ name = "r", topic = "IMU", field = "wz", unit = "deg/s" }' in guess.text
    (tmp_path / "map.toml").write_text(guess.text)
    with pytest.warns(SeatrialWarning, match="IMU: 1 row left out, incomplete or without a time"):
        (path,) = import_files(tmp_path / "map.toml", [source], out=tmp_path / "s.mcap")
    with open_log(path) as log:
        r = log.table(Scalar, "r")
    k = np.rint(10.0 * np.degrees(r["value"]))
    assert len(k) == N - 1
    np.testing.assert_allclose(r["t"], START + 0.2 * k, atol=1e-3)


@pytest.mark.parametrize("late", [0, 1])
def test_sensors_among_fixes_get_their_time(late: int, tmp_path: Path) -> None:
    """There is no GPS time. Most fixes come late, after a further row of the gyros."""
    lines = [line for line in sensors() if "TIME" not in line][:-N]
    lines[-1:] = [line for line in track() if line.startswith(("$COL", "$UNIT"))] + ["$DATA"]
    fixes = [line for line in track() if line.startswith("$GNSS")]
    gyros = [f"$IMU,{7.0 + 0.2 * k:.3f},0.1,0.2,{0.1 * k:.2f},0.0,0.01,1.0,25.1" for k in range(N)]
    behind = [k + late * (k % 10 > 0) for k in range(N)]  # the row of the gyros after which each fix stands
    for k in range(N):
        lines += [gyros[k], *(fixes[j] for j in range(N) if behind[j] == k)]
    (tmp_path / "ALL.CSV").write_text("\n".join(lines) + "\n")
    guess = guess_map(tmp_path / "ALL.CSV")
    (tmp_path / "map.toml").write_text(guess.text)
    with pytest.warns(SeatrialWarning, match="IMU: times are converted to UTC by the fixes between the rows"):
        (path,) = import_files(tmp_path / "map.toml", [tmp_path / "ALL.CSV"], out=tmp_path / "a.mcap")
    with open_log(path) as log:
        r = log.table(Scalar, "r")
    np.testing.assert_allclose(r["t"], START + 0.2 * np.arange(N), atol=1e-3)


def test_a_file_without_rows_is_refused(tmp_path: Path) -> None:
    (tmp_path / "TRACK.CSV").write_text("\n".join(track()[:6]) + "\n")
    with pytest.raises(SeatrialError, match="no lines with data below the header"):
        guess_map(tmp_path / "TRACK.CSV")
