"""Tests of `import --guess`: styles of text, column names with units, messages of ROS and mavros, and the choice of
signals.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.io import savemat

import seatrial as st
from seatrial.daq import cli
from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.daq.importers import guess
from seatrial.daq.importers.bench_table import _command_scale
from seatrial.daq.importers.clocks import Clock, clock_of
from seatrial.daq.importers.guess import Guess, guess_map, guess_maps, outputs
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.importers.import_map import parse_import_map
from seatrial.daq.importers.recognise import pulse_keys, read_name, resting_pulse
from seatrial.daq.importers.sources import SourceKind
from seatrial.daq.importers.table import Table, TextStyle
from seatrial.daq.importers.text_table import sniff_style
from tests.daq.csv_files import values

N = 30
TIME = 0.1 * np.arange(N)


def guessed_signals(path: Path) -> dict[str, dict[str, Any]]:
    """Return the signals of a guessed map by name, after an import with the map."""
    text = guess_map(path).text
    map_path = path.with_suffix(".map.toml")
    map_path.write_text(text, encoding="utf-8")
    found = {signal["name"]: signal for signal in tomllib.loads(text)["signal"]}
    if found:
        import_files(map_path, [path], out=path.with_suffix(".mcap"), force=True)
    return found


def write(folder: Path, columns: dict[str, np.ndarray], delimiter: str = ",", decimal: str = ".") -> Path:
    lines = [delimiter.join(columns)]
    for row in zip(*columns.values(), strict=True):
        lines.append(delimiter.join(f"{value:.9g}".replace(".", decimal) for value in row))
    path = folder / "run.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "style"),
    [
        ("t,psi\n" + "0.5,1.5\n" * 9, TextStyle(",", ".")),
        ("made by X\n\nt;psi\n" + "0,5;1,5\n" * 9, TextStyle(";", ",", skip_rows=2)),
        ("t\tpsi\n" + "0.5\t1.5\n" * 9, TextStyle("\t", ".")),
        ("  t   psi\n" + "  0.5   1.5\n" * 9, TextStyle("blank", ".")),
        ("Z5\N{DEGREE SIGN}/1\n of a run\n" + "  .5   1.5  \n" * 9,
         TextStyle("blank", ".", "latin-1", 2, ("column_1", "column_2"))),
        ("t,psi\n" + "0.5,1.5\n,\n\n" * 9, TextStyle(",", ".")),
    ],
)  # fmt: skip
def test_the_style_of_a_text(text: str, style: TextStyle) -> None:
    assert sniff_style(Path("x"), text.encode("latin-1")) == style


def test_a_text_without_a_table_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("Dear reader,\nthis is a letter.\n")
    with pytest.raises(SeatrialError, match="no table of numbers found in this text"):
        guess_map(tmp_path / "x.csv")
    (tmp_path / "x.bin").write_bytes(bytes(100))
    with pytest.raises(SeatrialError, match="unknown kind of file; give one that import reads"):
        guess_map(tmp_path / "x.bin")


def test_blanks_between_columns_other_encodings_and_blank_rows(tmp_path: Path) -> None:
    path = tmp_path / "run.dat"
    rows = "".join(f"  {0.1 * k:.1f}   {10 + k}.0 \n\n" for k in range(N))
    path.write_bytes(f"Kurs \N{DEGREE SIGN}\n time  yaw[deg]\n{rows}".encode("latin-1"))
    assert guessed_signals(path)["psi"]["unit"] == "deg"
    t, psi = values(tmp_path / "run.mcap", "psi")
    np.testing.assert_allclose(t, TIME, atol=1e-9)
    np.testing.assert_allclose(psi, np.radians(10.0 + np.arange(N)))


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-16 BE with its mark"])
def test_text_of_two_bytes_a_character(tmp_path: Path, encoding: str) -> None:
    """Excel saves "Unicode text" in this way."""
    text = "t\tKurs \N{DEGREE SIGN}\tyaw[deg]\r\n" + "".join(f"{0.1 * k:.1f}\t1\t{10 + k}.0\r\n" for k in range(N))
    name, _, mark = encoding.partition(" ")
    path = tmp_path / "run.txt"
    path.write_bytes(b"\xfe\xff" + text.encode("utf-16-be") if mark else text.encode(name))
    assert guessed_signals(path)["psi"]["unit"] == "deg"
    np.testing.assert_allclose(values(tmp_path / "run.mcap", "psi")[1], np.radians(10.0 + np.arange(N)))
    path.write_bytes(text.encode())
    message = r"run\.txt: is not utf-16 text \(.*\); save it as UTF-8" if not name[6:] else "run.txt: "
    with pytest.raises(SeatrialError, match=message) as caught:
        import_files(tmp_path / "run.map.toml", [path], out=tmp_path / "again.mcap")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("column", "meaning", "unit"),
    [
        ("yaw [deg]", "psi", "deg"), ("Heading (rad)", "psi", "rad"), ("yawRate", "r", ""), ("sog_kn", "speed", "kn"),
        ("vel_n", "vx", ""), ("pos_n", "x", ""), ("r_dps", "r", "deg/s"), ("Latitude", "lat", ""), ("rudder", "", ""),
        ("u_m_s", "u", "m/s"), ("gyro_z (deg/s)", "r", "deg/s"), ("t_ms", "", "ms"), ("speed_ms", "speed", "m/s"),
        ("x [cm]", "x", "cm"), ("u [mm/s]", "u", "mm/s"), ("thrust_left [N]", "", "N"), ("lat [degE7]", "lat", "degE7"),
        ("x_s", "x", ""), ("r [1/s]", "r", ""), ("t [ns]", "", "ns"), ("cmd [-]", "", "1"),
        ("Speed [rpm]", "", "rev/min"),
        # behind a sensor, except an axis of the sensor, and the heading of a GNSS, which may be its course
        ("gps_vn_mps", "vx", "m/s"), ("gnss_vel_e", "vy", ""), ("imu_yaw_rate_dps", "r", "deg/s"), ("gps_x", "", ""),
        ("ahrs_heading_deg", "psi", "deg"), ("gps_heading_deg", "", "deg"), ("imu_vx", "", ""),
    ],
)  # fmt: skip
def test_a_column_name_gives_meaning_and_unit(column: str, meaning: str, unit: str) -> None:
    name = read_name(column)
    assert (name.meaning, name.unit) == (meaning, unit)


def test_columns_of_a_receiver_and_of_pulses_are_found(tmp_path: Path) -> None:
    """Speed and course, latitude and longitude, pulses for each side, and milliseconds."""
    path = write(tmp_path, {
        "timestamp": 1e5 + 100.0 * np.arange(N), "lat": 63.0 + 1e-5 * np.arange(N), "lon": 10.0 + 0 * TIME,
        "sog_kn": 2.0 + 0 * TIME, "cog": 90.0 + 0 * TIME,
        "pwm_port": 1500.0 + np.arange(N), "pwm_stbd": 1500.0 - np.arange(N),
    })  # fmt: skip
    found = guessed_signals(path)
    assert set(found) == {"x", "y", "vx", "vy", "n_left", "n_right"}
    log = tmp_path / "run.mcap"
    np.testing.assert_allclose(np.diff(values(log, "x")[1]), 1.1146, rtol=1e-3)
    np.testing.assert_allclose(values(log, "vy")[1], 2.0 * 1852 / 3600, rtol=1e-9)
    np.testing.assert_allclose(values(log, "vx")[1], 0.0, atol=1e-12)
    t, n = values(log, "n_right")
    np.testing.assert_allclose(n, -np.arange(N) / 400.0, atol=1e-12)
    np.testing.assert_allclose(t, 100.0 + TIME, atol=1e-6)


def test_an_unknown_heading_of_mavlink_is_left_out(tmp_path: Path) -> None:
    hdg = np.where(np.arange(N) < 5, 65535.0, 35_000.0 + 40.0 * np.arange(N)) % 65536
    path = write(tmp_path, {"t": TIME, "hdg": np.where(hdg == 65535, hdg, hdg % 36_000)})
    assert guessed_signals(path)["psi"]["unit"] == "cdeg"
    t, psi = values(tmp_path / "run.mcap", "psi")
    np.testing.assert_allclose(t, TIME[5:], atol=1e-9)
    np.testing.assert_allclose(np.diff(psi), np.radians(0.4), atol=1e-9)


def test_an_unknown_unit_is_a_caveat(tmp_path: Path) -> None:
    path = write(tmp_path, {"t": TIME, "x [fathom]": TIME, "y [cm]": TIME, "heading [m]": 100.0 + TIME})
    found = guessed_signals(path)
    assert [found[name]["unit"] for name in ("x", "y", "psi")] == ["m", "cm", "deg"]
    text = guess_map(path).text
    assert "  # caveat: 'fathom' in 'x [fathom]' is not a unit of this signal and is ignored\n" in text
    assert "  # caveat: 'm' in 'heading [m]' is not a unit of this signal and is ignored\n" in text


def thrusters(guess: Guess) -> dict[str, tuple[str, str, str]]:
    """Return column, unit and hold of each signal of a guess."""
    signals = tomllib.loads(guess.text)["signal"]
    usual = {"input": "zero", "output": "linear"}
    return {
        s["name"]: (s["column"], s["unit"], s.get("hold", usual[s.get("role", "output")])) for s in signals
    }  # fmt: skip


def columns(*names: str, top: float = 40.0) -> Table:
    """Return columns with a swing of up to about `top`."""
    return Table(Path("x"), "", {name: top * np.sin(TIME + k) for k, name in enumerate(names)}, TIME)


@pytest.mark.parametrize(
    ("names", "found", "caveat"),
    [
        (("X", "Y"), {"x": ("X", "m", "linear"), "y": ("Y", "m", "linear")}, "X is assumed to be a position"),
        (("N", "E"), {"x": ("N", "m", "linear"), "y": ("E", "m", "linear")}, ""),
        (("X [m]", "Y [m]"), {"x": ("X [m]", "m", "linear"), "y": ("Y [m]", "m", "linear")}, ""),
        (("X", "N"), {"X": ("X", "N", "zero"), "N": ("N", "Nm", "zero")}, "X is assumed to be the surge force in N"),
        (
            ("X", "Y", "N"),
            {"X": ("X", "N", "zero"), "N": ("N", "Nm", "zero")},
            "N is assumed to be the yaw moment in Nm",
        ),
        (("X [kgf]", "N [Nm]"), {"X": ("X [kgf]", "kgf", "zero"), "N": ("N [Nm]", "Nm", "zero")}, ""),
    ],
)
def test_capital_letters_are_forces_or_a_position(
    guess_of: Guessing, names: tuple[str, ...], found: dict[str, tuple[str, str, str]], caveat: str
) -> None:
    guess = guess_of("matlab", columns(*names))
    assert thrusters(guess) == found
    assert (f"# caveat: {caveat}" in guess.text) if caveat else ("# caveat" not in guess.text)


@pytest.mark.parametrize(
    ("name", "top", "found", "caveat"),
    [
        ("thrust_left [%]", 40.0, ("n_left", "%", "zero"), ""),
        ("thrust_left [%]", 0.9, ("n_left", "%", "zero"),
         'its numbers are at most 0.9; if they are fractions, not per cent, give unit = "1"'),
        ("thrust_left [N]", 40.0, ("f_left", "N", "zero"), ""),
        ("thrust_left", 40.0, ("f_left", "N", "zero"), "its numbers, up to 40, are assumed to be newtons"),
        ("f_left", 40.0, ("f_left", "N", "zero"), "its numbers, up to 40, are assumed to be newtons"),
        ("thrust_left [us]", 1900.0, ("n_left", "1", "zero"), "1500 us is assumed to be rest"),
        ("thrust_left [rpm]", 900.0, ("n_left", "1", "linear"),
         "its greatest number, 900, is assumed to be full forward; "
         'assumed to be a measured shaft speed; if it is a command, give hold = "zero"'),
        ("rpm_left", 900.0, ("n_left", "1", "linear"),
         "its greatest number, 900, is assumed to be full forward; assumed to be a measured"),
        ("rpm_cmd_left", 900.0, ("n_left", "1", "zero"), "its greatest number, 900, is assumed to be full forward\n"),
        ("cmd_left", 0.9, ("n_left", "1", "zero"), ""),
        ("n_left", 0.9, ("n_left", "1", "zero"), ""),
        ("n", 0.9, ("n", "1", "zero"), ""),
        ("u_port", 80.0, ("n_left", "%", "zero"), "its numbers, up to 80, are assumed to be per cent"),
        ("u_stbd", 0.9, ("n_right", "1", "zero"), ""),
        ("u_left", 1900.0, ("n_left", "1", "zero"), "1500 us is assumed to be rest"),
        ("uRight [%]", 80.0, ("n_right", "%", "zero"), ""),
        ("cmd_port", 80.0, ("n_left", "%", "zero"), "its numbers, up to 80, are assumed to be per cent"),
        ("u_right [m/s]", 1.9, None, ""),
        ("u_r", 1.9, None, ""),
        ("u_wind_left", 1.9, None, ""),
        ("n_left_ref", 0.9, ("n_left", "1", "zero"), ""),
        ("n_left_filtered", 0.9, ("n_left", "1", "zero"), ""),
        ("n_sat", 9.0, None, ""),
        ("n_satellites", 9.0, None, ""),
        ("n_bytes", 9.0, None, ""),
        ("motor_left [W]", 90.0, None, ""),
        ("motor_left [deg]", 90.0, None, ""),
    ],
)  # fmt: skip
def test_the_unit_of_a_thruster_follows_from_its_numbers(
    guess_of: Guessing, name: str, top: float, found: tuple[str, str, str] | None, caveat: str
) -> None:
    guess = guess_of("matlab", Table(Path("x"), "", {name: np.linspace(0.5 * top, top, N)}, TIME))
    assert thrusters(guess) == ({} if found is None else {found[0]: (name, *found[1:])})
    assert (f"# caveat: {caveat}" in guess.text) if caveat else ("# caveat" not in guess.text)


def test_u_of_a_side_is_a_command_beside_the_velocities(tmp_path: Path) -> None:
    """Both sides get one scale, although one of them has small numbers only."""
    turn = np.cos(TIME)
    names = {"u": 0.9 * turn, "v": 0.1 * turn, "u_port": 60.0 * turn, "u_stbd": 0.5 * turn}
    path = write(tmp_path, {"t": TIME, "yaw": turn, **names, "n_port_rpm": 900.0 * turn, "n_stbd_rpm": 900.0 * turn})
    found = guessed_signals(path)
    assert {n: s["column"] for n, s in found.items()} == {
        "u": "u", "v": "v", "psi": "yaw", "n_left": "n_port_rpm", "n_right": "n_stbd_rpm", "n_cmd_left": "u_port",
        "n_cmd_right": "u_stbd",
    }  # fmt: skip
    for name in ("n_cmd_left", "n_cmd_right"):
        assert found[name]["unit"] == "%"
        assert found[name]["role"] == "input"
        assert "hold" not in found[name]
    assert "role" not in found["u"]


def test_the_column_n_for_north_does_not_affect_the_thruster_scale(guess_of: Guessing) -> None:
    table = columns("N", "E", "yaw", "n_left", "n_right", top=0.5)
    table.columns["N"] = 100.0 * table.columns["N"]
    found = thrusters(guess_of("matlab", table))
    assert [found[name][1] for name in ("n_left", "n_right", "x")] == ["1", "1", "m"]


def test_left_and_right_use_the_same_quantity(guess_of: Guessing) -> None:
    """A measurement precedes its set-point and a pair precedes a single column, in any order of the columns."""
    names = ("rpm_left_setpoint", "rpm_left", "rpm_right", "rpm_right_setpoint")
    found = thrusters(guess_of("matlab", columns(*names, top=500.0)))
    assert found == {"n_left": ("rpm_left", "1", "linear"), "n_right": ("rpm_right", "1", "linear")}
    found = thrusters(guess_of("matlab", columns("duty_left", "cmd_right", "cmd_left", top=1.0)))
    assert {name: signal[0] for name, signal in found.items()} == {"n_left": "cmd_left", "n_right": "cmd_right"}
    found = thrusters(guess_of("matlab", columns("duty_left", "cmd_right", top=1.0)))
    assert len(found) == 1
    found = thrusters(guess_of("matlab", columns("motor_left_setpoint", "motor_right_setpoint", top=1.0)))
    assert found["n_left"] == ("motor_left_setpoint", "1", "zero")
    found = thrusters(guess_of("matlab", columns("motor_1_left", "motor_2_right", top=1.0)))
    assert set(found) == {"n_left", "n_right"}


def test_no_pulse_is_a_thruster_at_rest(tmp_path: Path) -> None:
    """A disarmed autopilot sends no pulses. The last command does not hold until the end."""
    pulses = np.where(TIME < 1.0, 1900.0, 0.0)
    guessed_signals(write(tmp_path, {"t": TIME, "yaw_deg": 100.0 + TIME, "pwm_left": pulses, "pwm_right": pulses}))
    t, n = values(tmp_path / "run.mcap", "n_left")
    assert len(t) == N
    np.testing.assert_allclose(n, np.where(TIME < 1.0, 1.0, 0.0), atol=1e-12)


@pytest.mark.parametrize(
    ("left", "right", "rests", "caveat"),
    [
        (1510.0, 1505.0, (1510.0, 1505.0), "1510 us is assumed to be rest (60 % of the pulses have this value), 1110"),
        (1510.0, None, (1510.0, 1510.0), "1510 us is assumed to be rest (60 % of the pulses on the other side have"),
        (1600.0, 1600.0, (1500.0, 1500.0), "1500 us is assumed to be rest, 1100 and 1900 us full astern and ahead"),
        (None, None, (1500.0, 1500.0), "1500 us is assumed to be rest, 1100 and 1900 us full astern and ahead"),
    ],
)  # fmt: skip
def test_pulses_are_scaled_from_the_value_at_which_the_output_rests(
    guess_of: Guessing, left: float | None, right: float | None, rests: tuple[float, float], caveat: str
) -> None:
    """A trim beside 1500 us is found in the data. A boat may cruise at a constant pulse far from it."""
    moving = 1500.0 + 300.0 * np.sin(TIME + 0.1)
    pulses = {
        f"pwm_{side}": moving if rest is None else np.where(np.arange(N) % 5 < 3, rest, moving)
        for side, rest in (("left", left), ("right", right))
    }
    text = guess_of("matlab", Table(Path("x"), "", {"yaw": TIME, **pulses}, TIME)).text
    found = {signal["name"]: signal for signal in tomllib.loads(text)["signal"]}
    for name, rest in zip(("n_left", "n_right"), rests, strict=True):
        assert found[name]["scale"] * rest + found[name]["offset"] == pytest.approx(0.0, abs=1e-6)
        assert found[name]["scale"] == 1.0 / 400.0
    assert f"# caveat: {caveat}" in text


def test_the_rest_of_pulses_is_not_clear_beside_a_frequent_usual_rest() -> None:
    pulses = np.concatenate([np.full(60, 1500.0), np.full(100, 1510.0), np.full(40, 1700.0), np.zeros(500)])
    assert resting_pulse(pulses) is None
    assert resting_pulse(pulses[60:]) == (1510.0, pytest.approx(100 / 140))
    assert resting_pulse(np.append(np.full(9, 1510.0), np.full(100, 1700.0))) is None  # too few of all pulses


@pytest.mark.parametrize("top", [800.0, 90.0, 0.9])
def test_left_and_right_have_the_same_scale(tmp_path: Path, top: float) -> None:
    """The scale is that of the side with the larger range, so that equal numbers stay equal."""
    speed = np.abs(np.sin(TIME))
    path = write(tmp_path, {"t": TIME, "yaw_deg": 100.0 + TIME, "cmd_left": 1000.0 * speed, "cmd_right": top * speed})
    guessed_signals(path)
    n_left, n_right = (np.array(values(tmp_path / "run.mcap", name)[1]) for name in ("n_left", "n_right"))
    assert n_left.max() == pytest.approx(1.0)
    np.testing.assert_allclose(n_right, 1e-3 * top * n_left, rtol=1e-6)


def test_controllers_have_the_same_scale() -> None:
    tables = [Table(Path("x"), f"esc_{k}", {"rpm": 1000.0 / k + 0 * TIME}, TIME, "Esc") for k in (1, 2)]
    assert {c.signals[0].full for c in outputs(tables)} == {1000.0}


def test_a_scale_that_is_guessed_from_the_largest_number_says_so_on_its_line(tmp_path: Path) -> None:
    turn = np.cos(TIME)
    path = write(tmp_path, {"t": TIME, "yaw": turn, "rpm_port": 900.0 * turn, "rpm_stbd": 450.0 * turn})
    lines = [line for line in guess_map(path).text.splitlines() if "rpm_" in line]
    remark = (
        "# scale: inferred, 1 / 900, the largest number of this file; better: 1 / (number at full speed), the same on "
        "both sides, in all files and in the log of the bench"
    )
    assert len(lines) == 2
    assert all(line.endswith(f"}},  {remark}") for line in lines)
    assert {s.get("scale") for s in tomllib.loads(guess_map(path).text)["signal"]} == {None, 0.00111111111}
    percent = write(tmp_path, {"t": TIME, "yaw": turn, "cmd_port [%]": 50.0 * turn, "cmd_stbd [%]": turn})
    assert "a guess" not in guess_map(percent).text


def test_files_that_share_a_map_share_its_guessed_scale(tmp_path: Path) -> None:
    turn, paths = np.cos(TIME), [tmp_path / "one.csv", tmp_path / "two.csv"]
    for path, top in zip(paths, (400.0, 1000.0), strict=True):
        columns_of = {"t": TIME, "yaw": turn, "rpm_port": top * turn, "rpm_stbd": 0.5 * top * turn}
        write(tmp_path, columns_of).rename(path)
    maps = guess_maps(paths)
    for made in maps:
        scales = {s["name"]: s.get("scale") for s in tomllib.loads(made.text)["signal"]}
        assert scales == {"psi": None, "n_left": 0.001, "n_right": 0.001}
        assert "1 / 1000, the largest number of these 2 files" in made.text
        assert "`seatrial import --guess one.csv two.csv`" in made.text
    assert guess_map(paths[0]).full == {"n_left": 400.0, "n_right": 400.0}
    # A file of other columns is not one of those of the scale.
    write(tmp_path, {"t": TIME, "force [N]": turn, "cmd [%]": 50.0 * turn}).rename(tmp_path / "pool.csv")
    assert "1 / 1000, the largest number of these 2 files" in guess_maps([*paths, tmp_path / "pool.csv"])[0].text
    words = ["--guess", *map(str, paths), "-o", str(tmp_path / "both.toml")]
    CliRunner().invoke(cli.import_, words, catch_exceptions=False)
    assert (tmp_path / "both.toml").read_text(encoding="utf-8") == maps[0].text
    with pytest.warns(SeatrialWarning, match=r"(one|two)\.csv: without an import map, .*: .* 1000, is assumed to"):
        logs = st.import_log(paths, out_dir=tmp_path / "logs")
    assert [np.abs(values(log, "n_left")[1]).max() for log in logs] == pytest.approx([0.4, 1.0])


def commands_and_speeds(left: str = "cmd_left", right: str = "cmd_right", rpm: str = "rpm_") -> dict[str, np.ndarray]:
    """Return columns of commands and shaft speeds of both sides, with a heading."""
    turn = np.cos(TIME)
    return {
        "t": TIME, "yaw": turn, left: 0.5 * np.sign(turn), right: 0.4 * np.sign(turn), f"{rpm}left": 900.0 * turn,
        f"{rpm}right": 450.0 * turn,
    }  # fmt: skip


def test_commands_and_shaft_speeds_are_both_in_the_map(tmp_path: Path) -> None:
    path = write(tmp_path, commands_and_speeds())
    found = guessed_signals(path)
    assert {name: found[name]["column"] for name in found if name != "psi"} == {
        "n_cmd_left": "cmd_left", "n_cmd_right": "cmd_right", "n_left": "rpm_left", "n_right": "rpm_right",
    }  # fmt: skip
    assert all(found[f"n_cmd_{side}"]["role"] == "input" for side in ("left", "right"))
    assert all(found[f"n_{side}"]["hold"] == "linear" for side in ("left", "right"))
    assert "also in the source" not in guess_map(path).text
    assert np.abs(values(tmp_path / "run.mcap", "n_cmd_left")[1]).max() == 0.5
    assert np.abs(values(tmp_path / "run.mcap", "n_left")[1]).max() == pytest.approx(0.5)


def test_a_column_n_beside_commands_is_a_shaft_speed(guess_of: Guessing) -> None:
    found = thrusters(guess_of("matlab", columns("n_left", "n_right", "n_cmd_left", "n_cmd_right", "yaw", top=0.5)))
    assert [found[name][0] for name in ("n_left", "n_right", "n_cmd_left", "n_cmd_right")] == [
        "n_left", "n_right", "n_cmd_left", "n_cmd_right",
    ]  # fmt: skip
    assert found["n_left"][2] == "linear"


def test_one_side_of_a_shaft_speed_does_not_rename_the_commands(tmp_path: Path) -> None:
    """A comment has the caveat of its guessed scale, too."""
    table = commands_and_speeds()
    del table["rpm_right"]
    text = guess_map(write(tmp_path, table)).text
    assert {s["name"] for s in tomllib.loads(text)["signal"]} == {"psi", "n_left", "n_right"}
    (line,) = (line for line in text.splitlines() if "rpm_left" in line)
    assert line.startswith('  # { name = "n_left"')
    assert "# scale: inferred, 1 / 900, the largest number of this file; better: 1 / (number at full speed)" in line


@pytest.mark.parametrize(
    ("count", "first", "name"),
    [
        (2, "guess r1.csv r2.csv`. Check each caveat, then run `seatrial import MAP r1.csv r2.csv`.", "r1, r2"),
        (
            5,
            "guess FILE...` of r1.csv r2.csv r3.csv and 2 more. Check each caveat, then run `seatrial import MAP "
            "FILE...` with all of them.",
            "r1, r2, r3 and 2 more",
        ),
    ],
)
def test_a_map_of_several_files_names_them(tmp_path: Path, count: int, first: str, name: str) -> None:
    paths = [tmp_path / f"r{k}.csv" for k in range(1, count + 1)]
    for path in paths:
        write(tmp_path, {"t": TIME, "yaw": np.cos(TIME), "cmd_left": np.cos(TIME), "cmd_right": np.cos(TIME)}).rename(
            path
        )
    text = guess_maps(paths)[0].text
    assert first in text.splitlines()[0]
    assert tomllib.loads(text)["name"] == name


@pytest.mark.parametrize(
    ("name", "times", "form", "caveat"),
    [
        ("time", TIME, "s", ""),
        ("time", 1.7e9 + np.arange(N), "s", ""),
        ("time", 1.7e9 + 1.0 * np.arange(N), "s", ""),
        ("time", 1.5e9 + 20.0 * np.arange(N), "s", "a time since the start may be in"),
        ("time", 1.7e12 + 100.0 * np.arange(N), "ms", ""),
        ("time", 1.7e15 + 1e5 * np.arange(N), "us", ""),
        ("time", 1.7e18 + 1e8 * np.arange(N), "ns", ""),
        # microseconds since the start
        ("time", 1.5e9 + 2e4 * np.arange(N), "us", "steps of 2e+04 are assumed to be microseconds"),
        ("time", 1.5e12 + 2e7 * np.arange(N), "ns", "steps of 2e+07 are assumed to be nanoseconds"),
        ("time", 739_000.5 + TIME / 86400.0, "datenum", ""),
        ("time", 1.0 * np.arange(N), "s", "steps of 1 are assumed to be seconds"),
        ("time", 1e-4 * np.arange(N), "s", "steps of 0.0001 are assumed to be seconds"),
        ("time [week]", TIME, "s", "'week' in 'time [week]' is not a unit of time"),
        ("time [min]", TIME / 60.0, "min", ""),
        ("time [sec]", TIME, "s", ""),
        ("time (UTC)", TIME, "s", ""),
        ("t [µs]", 1e5 * TIME, "us", ""),
        ("utc", 120000.0 + TIME, "s", "a time of day, hhmmss, has"),
        ("utc", np.append(55.0 + np.arange(5), 100.0 + np.arange(10)), "s", "a time of day, hhmmss, has"),
        ("t", 12000.0 + 5.0 * TIME, "s", "a time of day, hhmmss, has"),
        ("t", 12050.0 + 5.0 * TIME, "s", ""),  # seconds of a minute do not exceed 59
    ],
)  # fmt: skip
def test_the_unit_of_a_time(name: str, times: np.ndarray, form: str, caveat: str) -> None:
    clock = clock_of(Table(Path("x"), "", {name: times, "yaw": 200.0 + times}))
    assert (clock.column, clock.form) == (name, form)
    assert caveat in clock.caveat
    assert bool(caveat) == bool(clock.caveat)


def test_a_first_column_with_a_command_or_a_signal_is_not_a_time() -> None:
    for name in ("PWM (µs)", "yaw"):
        assert clock_of(Table(Path("x"), "", {name: TIME, "force": TIME})) == Clock()
    assert clock_of(Table(Path("x"), "", {"k": TIME, "yaw": TIME})).caveat.startswith("its first column rises evenly")


def test_each_table_has_its_own_clock(tmp_path: Path) -> None:
    """Two names of the same clock, in s and ms, and a table before which no time is taken."""
    battery = {"t_batt": np.arange(7.0), "volts": 12.0 + np.arange(7.0)}
    path = tmp_path / "run.mat"
    savemat(path, {
        **battery, "t": TIME, "x": TIME, "y": TIME, "cmd_left": np.sin(TIME), "cmd_right": np.cos(TIME),
        "imu": {"t": 50.0 * np.arange(40), "yaw": 200.0 + np.arange(40)}, "yaw_rate": np.arange(11.0),
    })  # fmt: skip
    found = guessed_signals(path)
    text = guess_map(path).text
    assert tomllib.loads(text)["time"] == {"column": "t", "format": "s"}
    assert (found["psi"]["time"], found["psi"]["time_format"]) == ("t", "ms")
    assert "# caveat: imu, 't': steps of 50 are assumed to be milliseconds" in text
    assert "r" not in found  # the table has no times
    assert '# { name = "r", column = "yaw_rate"' in text
    log = tmp_path / "run.mcap"
    assert [values(log, name)[0][-1] for name in ("x", "n_left", "psi")] == pytest.approx([2.9, 2.9, 1.95])


def test_times_of_a_day_are_imported(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("time,yaw_deg\n" + "".join(f"12:00:{k:02d},{90 + k}\n" for k in range(N)))
    assert "psi" in guessed_signals(path)
    assert "# caveat: times of day without a date: give the date, origin =" in guess_map(path).text
    assert values(tmp_path / "run.mcap", "psi")[0] == [43200.0 + k for k in range(N)]


@pytest.mark.parametrize(
    ("values", "unit", "caveat"),
    [
        (np.mod(300.0 + 10.0 * np.arange(N), 360.0), "deg", ""),  # the angle jumps
        (200.0 + TIME, "deg", ""),  # the angle begins beyond one turn
        (0.5 * np.arange(N), "deg", "an angle of up to 14.5, without a jump by a turn, is assumed to be in degrees"),
        (5.0 + 100.0 * np.arange(N), "deg", "an angle of up to 2905, without a jump"),
        (TIME, "rad", "an angle of at most 2.90 is assumed to be in radians"),
        (np.mod(30000.0 + 1000.0 * np.arange(N), 36000.0), "cdeg", ""),
        (20000.0 + TIME, "cdeg", "an angle that begins at 20000 is assumed to be in centidegrees"),
    ],
)
def test_the_unit_of_an_angle(guess_of: Guessing, values: np.ndarray, unit: str, caveat: str) -> None:
    text = guess_of("matlab", Table(Path("x"), "", {"hdg": values}, TIME)).text
    assert tomllib.loads(text)["signal"][0]["unit"] == unit
    assert (f"# caveat: {caveat}" in text) if caveat else ("# caveat" not in text)
    text = guess_of("matlab", Table(Path("x"), "", {"sog [kn]": TIME, "cog": values}, TIME)).text
    assert tomllib.loads(text)["signal"][0]["units"] == ["kn", unit]
    assert bool(caveat) == ("# caveat" in text)


def test_assumed_units_have_caveats(guess_of: Guessing) -> None:
    columns = {"sog": TIME, "acc_x": TIME, "acc_y": TIME, "lat": 3845.95 + TIME, "lon": 9012.5 + TIME}
    text = guess_of("matlab", Table(Path("x"), "", columns, TIME)).text
    assert "# caveat: a speed of at most 2.9 is assumed to be in m/s\n" in text
    assert "# caveat: accelerations are assumed to be in m/s2, not in g\n" in text
    assert {signal["name"] for signal in tomllib.loads(text)["signal"]} == {"speed", "ax", "ay"}
    assert "# 3848.85 is not a latitude in degrees; the format may be ddmm.mmmm" in text
    known = {f"{name} [{unit}]": TIME for name, unit in (("sog", "kn"), ("acc_x", "g"), ("acc_y", "g"), ("cog", "deg"))}
    assert "# caveat" not in guess_of("matlab", Table(Path("x"), "", known, TIME)).text


def test_a_measured_signal_that_is_always_zero_is_left_out(tmp_path: Path) -> None:
    """A command may be zero in a whole log, and a short table says nothing."""
    columns = {"t": TIME, "heading_deg": 10.0 * TIME, "ax": 0.0 * TIME, "ay": 0.0 * TIME, "cmd_left": 0.0 * TIME}
    columns |= {"cmd_right": np.sin(TIME)}
    text = guess_map(write(tmp_path, columns)).text
    assert "# not measured: ax, ay, 0 in the whole source\n" in text
    assert {signal["name"] for signal in tomllib.loads(text)["signal"]} == {"psi", "n_left", "n_right"}
    short = guess_map(write(tmp_path, {name: values[:5] for name, values in columns.items()})).text
    assert {"ax", "ay"} <= {signal["name"] for signal in tomllib.loads(short)["signal"]}


def test_the_unit_of_a_rate_follows_from_the_heading(tmp_path: Path) -> None:
    psi = 60.0 * np.sin(0.8 * TIME)  # deg, 10 Hz
    degrees = {"t": TIME, "yaw": psi, "yaw_rate": 48.0 * np.cos(0.8 * TIME)}
    assert guessed_signals(write(tmp_path, degrees))["r"]["unit"] == "deg/s"
    assert "# caveat: deg/s if the heading is in deg\n" in guess_map(tmp_path / "run.csv").text
    radians = {**degrees, "yaw_rate": np.radians(degrees["yaw_rate"])}
    assert guessed_signals(write(tmp_path, radians))["r"]["unit"] == "rad/s"
    against = {**radians, "yaw_rate": -radians["yaw_rate"]}
    assert (
        "it has the opposite sign of the heading's derivative; sign = -1 may be needed"
        in guess_map(write(tmp_path, against)).text
    )
    slow = {"t": TIME, "yaw": 100.0 + 0.1 * psi, "yaw_rate": 4.8 * np.cos(0.8 * TIME)}
    assert (
        guessed_signals(write(tmp_path, slow))["r"]["unit"] == "deg/s"
    )  # according to the heading, not to the largest number


def test_the_parameters_of_an_autopilot_define_its_outputs() -> None:
    tables = [
        Table(Path("x"), f"servo_{k}", {"pwm": 1500.0 + TIME}, TIME, "Servo", parameters=PARAMETERS) for k in (1, 2, 3)
    ]
    found = {c.signals[0].name: (c.table.topic, c.signals[0].extra, c.caveat) for c in outputs(tables)}
    rest = 'missing = 0, missing_is = 0, role = "input", hold = "sampled"'
    assert found["n_left"] == ("servo_2", f"scale = 0.0025, offset = -3.75, {rest}", "")
    assert found["n_right"] == ("servo_1", f"scale = -0.002, offset = 3, {rest}", "")
    for table in tables:
        table.parameters = {**PARAMETERS, "SERVO2_MAX": 2000.0}
    caveat = next(c.caveat for c in outputs(tables) if c.signals[0].name == "n_left")
    full = "full commands are 1.11 and -0.889, not 1 and -1; name a rig in [mavlink] of the map to scale each direction"
    assert caveat == f"SERVO2_TRIM is not in the middle: {full}"
    for table in tables:
        table.parameters = {}
    found = {c.signals[0].name: (c.table.topic, bool(c.caveat)) for c in outputs(tables)}
    assert found == {"n_left": ("servo_1", True), "n_right": ("servo_3", True)}


@pytest.mark.parametrize(
    ("parameters", "problem"),
    [
        ({"SERVO1_FUNCTION": 26.0, "SERVO3_FUNCTION": 70.0},
         "SERVO1_FUNCTION 26 (steering), SERVO3_FUNCTION 70 (throttle)"),
        ({"SERVO3_FUNCTION": 73.0}, "SERVO3_FUNCTION 73 (throttle left)"),
        ({"SERVO1_FUNCTION": 33.0, "SERVO2_FUNCTION": 34.0}, "SERVO1_FUNCTION 33, SERVO2_FUNCTION 34"),
    ],
)  # fmt: skip
def test_outputs_without_left_and_right_throttle_are_a_problem(
    guess_of: Guessing, parameters: dict[str, float], problem: str
) -> None:
    pulses = {"pwm": 1500.0 + TIME}
    tables = [Table(Path("x"), f"servo_{k}", pulses, TIME, "Servo", parameters=parameters) for k in (1, 2, 3)]
    assert not list(outputs(tables))
    attitude = Table(Path("x"), "ahrs", {"yaw": TIME}, TIME, "Ahrs", parameters=parameters)
    guess = guess_of("mavlink", *tables, attitude)
    assert guess.problem.startswith(f"its outputs are not a left and a right throttle: {problem}; name")


@pytest.mark.parametrize(
    "parameters", [{"SERVO1_FUNCTION": 73.0}, {"SERVO2_FUNCTION": 0.0}, {"SERVO3_FUNCTION": 74.0}, {}]
)
def test_outputs_with_unknown_functions_have_the_usual_numbers(parameters: dict[str, float]) -> None:
    pulses = {"pwm": 1500.0 + TIME}
    tables = [Table(Path("x"), f"servo_{k}", pulses, TIME, "Servo", parameters=parameters) for k in (1, 2, 3)]
    found = {c.signals[0].name: (c.table.topic, bool(c.caveat)) for c in outputs(tables)}
    assert found == {"n_left": ("servo_1", True), "n_right": ("servo_3", True)}


def test_an_output_without_a_range_has_the_usual_one() -> None:
    parameters = {**PARAMETERS, "SERVO2_MIN": 1500.0, "SERVO2_MAX": 1500.0}
    pulses = {"pwm": 1500.0 + TIME}
    tables = [Table(Path("x"), f"servo_{k}", pulses, TIME, "Servo", parameters=parameters) for k in (1, 2)]
    (left,) = (c for c in outputs(tables) if c.signals[0].name == "n_left")
    assert left.caveat.startswith("SERVO2_MIN is not below SERVO2_MAX and is ignored; ")
    assert left.signals[0].extra.startswith("scale = 0.0025, offset = -3.75")


PARAMETERS = {
    "SERVO2_FUNCTION": 73.0, "SERVO2_TRIM": 1500.0, "SERVO2_MIN": 1100.0, "SERVO2_MAX": 1900.0,
    "SERVO1_FUNCTION": 74.0, "SERVO1_TRIM": 1500.0, "SERVO1_MIN": 1000.0, "SERVO1_MAX": 2000.0, "SERVO1_REVERSED": 1.0,
}  # fmt: skip
STORE = get_typestore(Stores.ROS2_HUMBLE)
RC_OUT = "std_msgs/Header header\nuint16[] channels\n"
STORE.register(get_types_from_msg(RC_OUT, "mavros_msgs/msg/RCOut"))


def test_the_topics_of_mavros_are_found(tmp_path: Path) -> None:
    """Earth-fixed and body velocities by their topics, the compass in degrees from north, outputs 1 and 3."""
    types = STORE.types

    def head(k: int) -> Any:
        return types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](100, 10_000_000 * k), "map")

    def twist(k: int) -> Any:
        vector = types["geometry_msgs/msg/Vector3"]
        message = types["geometry_msgs/msg/Twist"](vector(1.0, 2.0, 0.0), vector(0.0, 0.0, 0.5))
        header = head(k)
        return types["geometry_msgs/msg/TwistStamped"](header, message)

    def pulses(k: int) -> Any:
        return types["mavros_msgs/msg/RCOut"](head(k), np.array([1500 + k, 0, 1500 - k, 0], np.uint16))

    topics = {
        "/mavros/local_position/velocity_local": ("geometry_msgs/msg/TwistStamped", twist),
        "/mavros/setpoint_velocity/cmd_vel": ("geometry_msgs/msg/TwistStamped", twist),
        "/mavros/global_position/compass_hdg": ("std_msgs/msg/Float64", lambda k: types["std_msgs/msg/Float64"](90.0)),
        "/mavros/rc/out": ("mavros_msgs/msg/RCOut", pulses),
    }
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, (kind, make) in topics.items():
            connection = writer.add_connection(topic, kind, typestore=STORE)
            for k in range(N):
                writer.write(connection, round((100 + 0.01 * k) * 1e9), STORE.serialize_cdr(make(k), kind))
    found = guessed_signals(tmp_path / "bag")
    assert {name: signal["topic"].rpartition("/")[2] for name, signal in found.items()} == {
        "vx": "velocity_local", "vy": "velocity_local", "psi": "compass_hdg", "n_left": "out", "n_right": "out",
    }  # fmt: skip
    log = tmp_path / "bag.mcap"
    assert values(log, "vx")[1][0] == 2.0  # north is y of ENU
    assert values(log, "psi")[1][0] == pytest.approx(np.pi / 2)  # a compass counts from north
    np.testing.assert_allclose(values(log, "n_right")[1], -np.arange(N) / 400.0, atol=1e-12)


Guessing = Callable[..., Guess]


@pytest.fixture
def guess_of(monkeypatch: pytest.MonkeyPatch) -> Guessing:
    """Return a function that guesses the map of a source with the given tables."""

    def guess_of(kind: str, *tables: Table) -> Guess:
        monkeypatch.setattr(guess, "source_kind", lambda path: SourceKind(kind, lambda path, options: list(tables)))
        return guess_map(Path("x"))

    return guess_of


def test_a_second_table_measures_what_the_first_one_does_not(guess_of: Guessing) -> None:
    tables = [
        Table(Path("x"), "", {"t": TIME, "ax": factor * np.sin(TIME), "ay": factor * np.cos(TIME)})
        for factor in (0.0, 1.0)
    ]
    text = guess_of("mat", *tables).text
    assert "# not measured: ax, ay, 0 in the whole source\n" in text
    assert '{ name = "ax", ' in text


def scalar(topic: str, values: np.ndarray) -> Table:
    """Return a topic that contains only numbers."""
    return Table(Path("x"), topic, {"data": values}, TIME, "std_msgs/msg/Float64")


@pytest.mark.parametrize(
    ("topic", "frame_id", "is_ned"),
    [
        ("/vel_ned", "", True), ("/imu/velocity_ned", "", True), ("/NED/vel", "", True), ("/vel", "ins_frd_ned", True),
        ("/vel", "gnss_ned", True), ("/vel", "map_ned", True), ("/vel_planned", "", False), ("/vel", "map", False),
        ("/vel", "nedlib", False),
    ],
)  # fmt: skip
def test_the_axes_of_a_topic_follow_from_its_name_or_frame(
    guess_of: Guessing, topic: str, frame_id: str, is_ned: bool
) -> None:
    velocity = {"vector.x": TIME, "vector.y": TIME}
    table = Table(Path("x"), topic, velocity, TIME, "geometry_msgs/msg/Vector3Stamped", frame_id)
    signals = tomllib.loads(guess_of("ros", table).text)["signal"]
    assert [signal.get("frame") for signal in signals] == ["NED" if is_ned else None] * 2


@pytest.mark.parametrize(
    ("topic", "frame", "caveat"),
    [
        ("/mavros/global_position/compass_hdg", "NED", ""),
        ("/state/heading", "NED", "assumed clockwise from north"),
        ("/state/yaw", None, "assumed counter-clockwise from east"),
        ("/state/yaw_ned", "NED", ""),
    ],
)
def test_the_axes_of_a_heading_without_a_position(
    guess_of: Guessing, topic: str, frame: str | None, caveat: str
) -> None:
    text = guess_of("ros", scalar(topic, 200.0 + TIME)).text
    (signal,) = tomllib.loads(text)["signal"]
    assert signal.get("frame") == frame
    assert (f"# caveat: {caveat}" in text) if caveat else ("clockwise" not in text)


def test_yaw_and_its_rate_alone_have_the_axes_of_the_bag(guess_of: Guessing) -> None:
    text = guess_of("ros", scalar("/state/yaw", TIME), scalar("/state/yaw_rate", 1.0 + 0.0 * TIME)).text
    assert [signal.get("frame") for signal in tomllib.loads(text)["signal"]] == [None, None]
    assert "assumed positive to port" in text


def test_a_topic_of_px4_does_not_change_the_axes_of_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    local = dict.fromkeys(("x", "y", "vx", "vy"), TIME)
    pose = {f"pose.pose.position.{axis}": TIME for axis in "xy"}
    tables = [
        Table(Path("x"), "/odom", pose, TIME, "nav_msgs/msg/Odometry"),
        Table(Path("x"), "/fmu/out/vehicle_local_position", local, TIME, "px4_msgs/msg/VehicleLocalPosition"),
    ]
    monkeypatch.setattr(guess, "source_kind", lambda path: SourceKind("ros", lambda path, options: tables))
    found = tomllib.loads(guess_map(Path("x")).text)
    assert found["frame"] == "ENU"
    frames = {signal["name"]: (signal["topic"], signal.get("frame")) for signal in found["signal"]}
    assert frames["x"] == ("/odom", None)
    assert frames["vx"] == ("/fmu/out/vehicle_local_position", "NED")


def test_the_import_command_writes_a_log(tmp_path: Path) -> None:
    path = write(tmp_path, {"t": TIME, "yaw_deg": 10.0 + TIME})
    run = CliRunner()
    done = run.invoke(cli.import_, ["--guess", str(path)])
    assert done.exit_code == 0
    assert done.stdout.startswith("# From `seatrial import --guess run.csv`")
    assert "no model can be fitted to these signals: no commands" in done.stderr
    out = tmp_path / "map.toml"
    assert run.invoke(cli.import_, ["--guess", str(path), "-o", str(out)]).exit_code == 0
    assert isinstance(run.invoke(cli.import_, ["--guess", str(path), "-o", str(out)]).exception, SeatrialError)
    assert run.invoke(cli.import_, ["--guess", str(path), "-o", str(out), "--force"]).exit_code == 0
    refused = run.invoke(cli.import_, ["--guess", str(path), "-o", str(path), "--force"]).exception
    assert "is the source of this import and is never replaced" in str(refused)
    done = run.invoke(cli.import_, [str(out), str(path), "-o", str(tmp_path / "run.mcap")])
    assert done.stdout == f"{tmp_path / 'run.mcap'}\n"
    assert run.invoke(cli.import_, [str(out)]).exit_code == 2
    guessed = json.loads(run.invoke(cli.import_, ["--guess", str(path), "--json"]).stdout)
    assert (guessed["source"], guessed["map"]) == (str(path), None)
    assert guessed["text"] == out.read_text().replace(f" -o {out}", "")
    assert guessed["problem"].startswith("no commands")
    done = run.invoke(cli.import_, [str(out), str(path), "--out-dir", str(tmp_path / "logs"), "--json"])
    logs = [str(tmp_path / "logs/run.mcap")]
    assert json.loads(done.stdout) == {
        "format": "seatrial-import 1",
        "map": str(out),
        "sources": [str(path)],
        "logs": logs,
    }
    assert Path(logs[0]).exists()


def test_a_column_that_is_not_recognised_has_the_unit_of_its_name(tmp_path: Path) -> None:
    rows = "\n".join(f"{0.1 * k:.1f},{k % 7 - 3},{0.01 * k:.2f},{k}" for k in range(50))
    (tmp_path / "run.csv").write_text(f"time_s,steering_deg,tank (m),lamp\n{rows}\n", encoding="utf-8")
    text = guess_map(tmp_path / "run.csv").text
    for column, unit in (("steering_deg", "deg"), ("tank (m)", "m"), ("lamp", "1")):
        assert f'# {{ name = "NAME", column = "{column}", unit = "{unit}" }},  # ' in text


@pytest.mark.parametrize(
    ("columns", "geometry", "scale"),
    [("cmd_left,cmd_right", True, True), ("left_force,right_force", True, False), ("north,east", False, False)],
)
def test_a_guessed_map_has_examples_of_what_no_file_has(
    tmp_path: Path, columns: str, geometry: bool, scale: bool
) -> None:
    rows = "\n".join(f"{0.1 * k:.1f},{0.01 * k:.3f},{k % 7},{0.3 * (k % 5):.1f}" for k in range(200))
    (tmp_path / "run.csv").write_text(f"time,yaw_rad,{columns}\n{rows}\n")
    guessed = guess_map(tmp_path / "run.csv").text
    assert ("# y_left = -0.3" in guessed) is geometry
    assert ("# [scale]" in guessed) is scale
    assert ("if only the thrust ahead is known, leave the other one out" in guessed) is scale
    if geometry:  # the examples are valid without the sign of a comment
        map_text, examples = guessed.split("# [geometry]")
        tables = re.sub("(?m)^# ", "", "# [geometry]" + examples)
        found = parse_import_map(map_text + tables, tmp_path / "map.toml")
        boat = {"y_left": -0.3, "y_right": 0.3, "x_thrusters": -0.5, "mass": 30.0, "length": 1.6}
        boat |= {"antenna_x": 0.1, "antenna_y": 0.0, "antenna_z": 0.0, "lever_arm_sd": 0.02}
        thrust = {"c1": 40.0, "c2": 5.0} | dict.fromkeys(("c1_sd", "c2_sd"), 1.5 / math.sqrt(2.0))
        assert found.vehicle == pytest.approx(boat | (thrust if scale else {}))


@pytest.mark.parametrize(
    ("largest", "rest", "full"),
    [(0.8, 0.0, 1000.0), (0.2, 0.0, 800.0), (80.0, 0.0, 1000.0), (100.0, 0.0, 800.0), (320.0, 1500.0, 1000.0)],
    ids=["fraction", "too small", "per cent", "full", "pulses"],
)
def test_full_speed_is_that_of_the_largest_command(tmp_path: Path, largest: float, rest: float, full: float) -> None:
    """The largest speed of a log is seldom full speed. The largest command shows which part of it was reached."""
    lines = ["time,yaw_rad,cmd_left,cmd_right,rpm_left,rpm_right"]
    for k in range(400):
        part = (np.sin(0.05 * k), np.sin(0.07 * k)) if k > 60 else (0.0, 0.0)
        cells = [0.1 * k, 0.01 * k, *(rest + largest * x for x in part), *(800.0 * x for x in part)]
        lines.append(",".join(f"{x:.6g}" for x in cells))
    (tmp_path / "run.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    guessed = guess_map(tmp_path / "run.csv")
    assert guessed.full["n_left"] == pytest.approx(full, rel=1e-3)
    assert ("over its largest command, 0.8; better" in guessed.text) is (full == 1000.0)


@pytest.mark.parametrize("unit", ["_pct", "_percent", " [%]", " (percent)"])
def test_a_shaft_speed_in_per_cent_is_scaled_like_a_command_in_per_cent(tmp_path: Path, unit: str) -> None:
    table = {
        name if name in ("t", "yaw") else f"{name}{unit}": column * (1.0 if name in ("t", "yaw") else 100.0)
        for name, column in commands_and_speeds(rpm="shaft_").items()
    }
    for side in ("left", "right"):
        table[f"shaft_{side}{unit}"] = 0.9 * table[f"cmd_{side}{unit}"]
    path = write(tmp_path, table)
    found = guessed_signals(path)
    names = [f"{n}_{side}" for n in ("n_cmd", "n") for side in ("left", "right")]
    assert [(found[name]["unit"], "scale" in found[name]) for name in names] == [("%", False)] * 4
    largest = [np.abs(values(tmp_path / "run.mcap", name)[1]).max() for name in names]
    assert largest == pytest.approx([0.5, 0.4, 0.45, 0.36])


def test_command_in_the_first_line_names_the_files_as_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    folder = Path("my bags")
    folder.mkdir()
    (folder / "run.csv").write_text("time,yaw_rad\n" + "\n".join(f"{0.1 * k},{0.01 * k}" for k in range(50)) + "\n")
    assert "then run `seatrial import MAP 'my bags/run.csv'`" in guess_map(folder / "run.csv").text


def test_offset_of_zero_has_no_sign() -> None:
    """A map had ``offset = -0``, which looks like a mistake."""
    command = np.repeat([0.0, 50.0, 100.0, 0.0, -50.0], 20)
    for is_reversed in (False, True):
        keys, _ = _command_scale(command, np.abs(command), is_reversed)
        assert "offset = 0," in keys
    assert "offset = 0," in pulse_keys(0.0)
