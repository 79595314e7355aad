"""Tests of foreign logs, and of measured runs rewritten in foreign formats.

With --guess and a few edited lines, they give the fit of the CSV, or a one-line reason.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

from seatrial.daq.errors import SeatrialWarning
from seatrial.daq.importers.guess import guess_map
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Scalar
from tests.daq.ulog_files import Topic, write_ulog
from tests.measured.data import measured, run

pytestmark = [pytest.mark.measured, pytest.mark.slow]

EXAMPLES = Path(__file__).resolve().parents[2] / "docs/examples"
STORE = get_typestore(Stores.ROS2_HUMBLE)
T = STORE.types
SURGE = ("--model", "surge:force:speed")  # A fit that takes seconds.
ENGINES = ((0, "right"), (1, "left"))  # Numbers of the engines in PX4.
Edit = tuple[str, str]


def by_guess(source: Path, folder: Path, edits: tuple[Edit, ...] = (), keep: bool = False) -> Path:
    """Import the log by the guessed map with at most five edited lines. ``keep`` keeps repeated samples of slow
    receivers, like the maps of the examples.
    """
    assert len(edits) <= 5
    text = guess_map(source).text
    if keep:
        assert "held between measurements" in text
        text = text.replace("signal = [", 'csv = { repeats = "keep" }\nsignal = [', 1)
    for old, new in edits:
        (line,) = [line for line in text.splitlines() if old in line]
        text = text.replace(line, new if new.startswith("  {") else line.replace(old, new))
    (folder / "map.toml").write_text(text, encoding="utf-8")
    (out,) = import_files(folder / "map.toml", [source], out=folder / f"{source.stem}-guess.mcap")
    return out


def signals(path: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    with open_log(path) as log:
        return {name: (t["t"], t["value"]) for name in log.sources(Scalar) for t in [log.table(Scalar, name)]}


def fitted(path: Path, out: Path, *options: str) -> tuple[dict[str, float], dict[str, float]]:
    """Return estimates and standard errors of a fit by the command."""
    run("ident", "vehicle", str(path), *options, "--no-score-tests", "--despite-faults", "--out", str(out))
    result = json.loads((out / "result.json").read_text())
    assert result["fit"]["converged"], result["fit"]
    rows = [row for row in result["fit"]["parameters"] if row["se"]]
    return {row["name"]: row["value"] for row in rows}, {row["name"]: row["se"] for row in rows}


def estimates(path: Path, out: Path, *options: str) -> dict[str, float]:
    """Return the estimates of a fit by the command."""
    return fitted(path, out, *options)[0]


def same(expected_log: Path, found_log: Path, names: str, atol: float = 1e-9) -> None:
    """Check that these signals are equal in both logs, in times and values, within the rounding of the format."""
    a, b = signals(expected_log), signals(found_log)
    for name in names.split():
        np.testing.assert_allclose(b[name][0], a[name][0], rtol=0, atol=1e-6, err_msg=name)
        turns = 2 * np.pi * np.round((b[name][1] - a[name][1])[0] / (2 * np.pi)) if name == "psi" else 0.0
        np.testing.assert_allclose(b[name][1] - turns, a[name][1], rtol=0, atol=atol, err_msg=name)


def columns(file: Path) -> dict[str, np.ndarray]:
    with file.open(newline="") as opened:
        rows = list(csv.DictReader(opened))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0] if name}


# The BlueBoat


@pytest.fixture(scope="module")
def blueboat(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, np.ndarray]]:
    """Return the log of a run by the map of the example, and the columns of the run."""
    file = measured("blueboat/fixed_00000232.csv")
    folder = tmp_path_factory.mktemp("csv")
    (log,) = import_files(EXAMPLES / "blueboat/blueboat.toml", [file], out_dir=folder)
    return log, columns(file)


@pytest.fixture(scope="module")
def surge(blueboat: tuple[Path, dict[str, np.ndarray]], tmp_path_factory: pytest.TempPathFactory) -> dict[str, float]:
    """Return the estimates of the fit to this log."""
    return estimates(blueboat[0], tmp_path_factory.mktemp("surge") / "fit", *SURGE, "--fix", "e_u=0.05")


def quaternion(yaw: float) -> object:
    return T["geometry_msgs/msg/Quaternion"](0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))


def header(t: float, frame: str) -> object:
    ns = round(t * 1e9)
    return T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9), frame)


def write_bag(path: Path, topics: dict[str, tuple[str, np.ndarray, Callable[[int], object]]]) -> None:
    """Write topics with their type, times and messages, in the order of time."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        rows = []
        for topic, (kind, t, make) in topics.items():
            connection = writer.add_connection(topic, kind, typestore=STORE)
            rows += [(t[k], connection, kind, make, k) for k in range(len(t))]
        for when, connection, kind, make, k in sorted(rows, key=lambda row: row[0]):
            writer.write(connection, round(when * 1e9), STORE.serialize_cdr(make(k), kind))


def test_blueboat_as_a_ros_2_bag(
    blueboat: tuple[Path, dict[str, np.ndarray]], surge: dict[str, float], tmp_path: Path
) -> None:
    """The topics are those of VRX's WAM-V, and the axes those of REP-103. The IMU has no accelerometer."""
    log, c = blueboat
    t, yaw = c["original_timestamp"] * 1e-3, np.pi / 2 - np.radians(c["yaw"])
    vector, unknown = T["geometry_msgs/msg/Vector3"], np.array([-1.0] + [0.0] * 8)

    def odometry(k: int) -> object:
        point = T["geometry_msgs/msg/Point"](c["y_ned"][k], c["x_ned"][k], 0.0)
        pose = T["geometry_msgs/msg/PoseWithCovariance"](
            T["geometry_msgs/msg/Pose"](point, quaternion(yaw[k])), np.zeros(36)
        )
        twist = T["geometry_msgs/msg/Twist"](vector(c["surge"][k], -c["sway"][k], 0.0), vector(0.0, 0.0, 0.0))
        whole = T["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36))
        return T["nav_msgs/msg/Odometry"](header(t[k], "odom"), "wamv/base_link", pose, whole)

    def imu(k: int) -> object:
        rate = vector(0.0, 0.0, -c["yaw_rate"][k])
        zero = vector(0.0, 0.0, 0.0)
        return T["sensor_msgs/msg/Imu"](
            header(t[k], "wamv/imu"), quaternion(yaw[k]), np.zeros(9), rate, np.zeros(9), zero, unknown
        )

    def thrust(name: str) -> Callable[[int], object]:
        return lambda k: T["std_msgs/msg/Float64"](c[name][k])

    number = "std_msgs/msg/Float64"
    write_bag(tmp_path / "bag", {
        "/wamv/sensors/position/odometry": ("nav_msgs/msg/Odometry", t, odometry),
        "/wamv/sensors/imu/imu/data": ("sensor_msgs/msg/Imu", t, imu),
        "/wamv/thrusters/left/thrust": (number, t, thrust("left_force")),
        "/wamv/thrusters/right/thrust": (number, t, thrust("right_force")),
        "/wamv/thrusters/left/pos": (number, t, lambda k: T["std_msgs/msg/Float64"](0.0)),
    })  # fmt: skip
    again = by_guess(tmp_path / "bag", tmp_path, keep=True)
    same(log, again, "x y u v psi r f_left f_right")
    assert estimates(again, tmp_path / "fit", *SURGE, "--fix", "e_u=0.05") == pytest.approx(surge, rel=1e-6)


def px4(fields: str, t: np.ndarray, *columns: np.ndarray) -> Topic:
    """Return a topic of floats."""
    return Topic(fields, f"{len(columns)}f", t, np.stack(columns, 1))


def blueboat_px4(path: Path, log: Path, c: dict[str, np.ndarray]) -> None:
    t, half = c["original_timestamp"] * 1e-3, np.radians(c["yaw"]) / 2
    n = {side: signals(log)[f"n_{side}"][1] for side in ("left", "right")}
    zero = np.zeros(len(t))
    write_ulog(path, {
        "vehicle_local_position": px4("float x;float y", t, c["x_ned"], c["y_ned"]),
        "vehicle_attitude": px4("float[4] q", t, np.cos(half), zero, zero, np.sin(half)),
        "vehicle_angular_velocity": px4("float[3] xyz", t, zero, zero, c["yaw_rate"]),
        "actuator_motors": px4("float[2] control", t, n["right"], n["left"]),
    })  # fmt: skip


def test_blueboat_as_a_px4_log(blueboat: tuple[Path, dict[str, np.ndarray]], tmp_path: Path) -> None:
    log, c = blueboat
    blueboat_px4(tmp_path / "run.ulg", log, c)
    again = by_guess(tmp_path / "run.ulg", tmp_path, keep=True)
    assert sorted(signals(again)) == ["n_left", "n_right", "psi", "r", "x", "y"]
    same(log, again, "x y psi r n_left n_right", atol=5e-6)  # The format has float32 values.


def test_fit_of_blueboat_as_a_px4_log(
    blueboat: tuple[Path, dict[str, np.ndarray]], surge: dict[str, float], tmp_path: Path
) -> None:
    """The log has the odometry of an estimator with body velocities. Two edited lines convert shares of the thrust to
    newtons.
    """
    log, c = blueboat
    t, half, full = c["original_timestamp"] * 1e-3, np.radians(c["yaw"]) / 2, 80.0
    zero, body = np.zeros(len(t)), np.full(len(t), 3.0)
    place = (c["x_ned"], c["y_ned"], zero, np.cos(half), zero, zero, np.sin(half), c["surge"], c["sway"], zero)
    odometry = np.stack([body, *place], 1)
    write_ulog(tmp_path / "run.ulg", {
        "vehicle_odometry": Topic(
            "uint8_t velocity_frame;float[3] position;float[4] q;float[3] velocity", "B10f", t, odometry
        ),
        "actuator_motors": px4("float[2] control", t, c["right_force"] / full, c["left_force"] / full),
    })  # fmt: skip
    usual = 'topic = "actuator_motors", field = "control[{}]", unit = "1", role = "input", hold = "sampled"'
    force = f'topic = "actuator_motors", field = "control[{{}}]", unit = "N", scale = {full}, role = "input"'
    edits = [(f'name = "n_{s}", {usual.format(k)}', f'name = "f_{s}", {force.format(k)}') for k, s in ENGINES]
    again = by_guess(tmp_path / "run.ulg", tmp_path, tuple(edits), keep=True)
    same(log, again, "x y u v psi f_left f_right", atol=1e-5)  # The format has float32 values.
    assert estimates(again, tmp_path / "fit", *SURGE, "--fix", "e_u=0.05") == pytest.approx(surge, rel=1e-4)


@pytest.mark.parametrize("form", ["mat", "parquet"])
def test_blueboat_as_columns_of_mat_and_parquet(
    blueboat: tuple[Path, dict[str, np.ndarray]], surge: dict[str, float], tmp_path: Path, form: str
) -> None:
    log, c = blueboat
    path = tmp_path / f"run.{form}"
    if form == "mat":
        savemat(path, c)
    else:
        import pyarrow
        import pyarrow.parquet

        pyarrow.parquet.write_table(pyarrow.table(c), path)
    again = by_guess(path, tmp_path, keep=True)
    same(log, again, "x y u v psi r f_left f_right", atol=1e-12)
    assert estimates(again, tmp_path / "fit", *SURGE, "--fix", "e_u=0.05") == pytest.approx(surge, rel=1e-6)


def test_slow_receiver_in_the_rows_of_a_fast_table(tmp_path: Path) -> None:
    """The positions of the BlueBoat have 5 Hz, in rows of 10 Hz."""
    with pytest.warns(SeatrialWarning, match="x, y: held between measurements 0.2"):
        log = signals(by_guess(measured("blueboat/fixed_00000232.csv"), tmp_path))
    assert len(log["x"][0]) == pytest.approx(0.5 * len(log["psi"][0]), rel=0.02)
    assert np.median(np.diff(log["x"][0])) == pytest.approx(0.2, abs=0.01)


# The Kingfisher: two clocks, and commands from -1 to 1.


@pytest.mark.study
@pytest.mark.parametrize("form", ["bag", "ulg", "mat"])
def test_kingfisher_in_other_formats(tmp_path: Path, form: str) -> None:
    files = sorted(measured("kingfisher").glob("surge_*.csv"))
    reference = (EXAMPLES / "kingfisher/surge.toml").read_text()
    line, unit = 'column = "cmd_left"\nunit = ', ('"1"', '"N"\nscale = 40')
    force = f'name = "n_left"\n{line}{unit[0]}', f'name = "X"\n{line}{unit[1]}'
    (tmp_path / "surge.toml").write_text(reference.replace(*force))  # Both thrusters had the same command.
    (log,) = import_files(tmp_path / "surge.toml", files, out_dir=tmp_path)
    cmd, vel = (columns(file) for file in files)
    t_cmd, t_vel = cmd["t_s"] + 1.0, vel["t_s"] + 1.0  # Time stamps of zero count as missing.
    if form == "bag":

        def velocity(k: int) -> object:
            linear = T["geometry_msgs/msg/Vector3"](vel["vel_x"][k], vel["vel_y"][k], 0.0)
            return T["geometry_msgs/msg/Vector3Stamped"](header(t_vel[k], "odom"), linear)

        def command(side: str) -> Callable[[int], object]:
            return lambda k: T["std_msgs/msg/Float64"](cmd[f"cmd_{side}"][k])

        write_bag(tmp_path / "bag", {
            "/left_thrust_cmd": ("std_msgs/msg/Float64", t_cmd, command("left")),
            "/right_thrust_cmd": ("std_msgs/msg/Float64", t_cmd, command("right")),
            "/navsat/vel": ("geometry_msgs/msg/Vector3Stamped", t_vel, velocity),
        })  # fmt: skip
        source = tmp_path / "bag"
        edit = 'name = "n_left", topic = "/left_thrust_cmd", field = "data", unit = "1"'
    elif form == "ulg":
        source = tmp_path / "run.ulg"
        write_ulog(source, {
            "vehicle_local_position": px4("float vx;float vy", t_vel, vel["vel_x"], vel["vel_y"]),
            "actuator_motors": px4("float[2] control", t_cmd, cmd["cmd_right"], cmd["cmd_left"]),
        })  # fmt: skip
        edit = 'name = "n_left", topic = "actuator_motors", field = "control[1]", unit = "1", role = "input", '
        edit += 'hold = "sampled"'
    else:
        source = tmp_path / "run.mat"
        savemat(source, {"t_cmd": t_cmd, "cmd_left": cmd["cmd_left"], "cmd_right": cmd["cmd_right"], "t_vel": t_vel,
                         "vel_x": vel["vel_x"], "vel_y": vel["vel_y"]})  # fmt: skip
        edit = 'name = "n_left", column = "cmd_left", unit = "1"'
    force = edit.replace("n_left", "X").replace('"1"', '"N", scale = 40.0').replace('"sampled"', '"zero"')
    rounding = 2e-6 if form == "ulg" else 1e-12  # The format ulg has float32 values.
    again = by_guess(source, tmp_path, ((edit, force),), keep=True)
    a, b = signals(log), signals(again)
    np.testing.assert_allclose(b["X"][1], a["X"][1], rtol=0, atol=rounding)
    np.testing.assert_allclose(b["n_right"][0] - 1.0, a["n_right"][0], rtol=0, atol=1e-6)
    speed = [np.hypot(found[x][1], found[y][1]) for found, x, y in ((a, "speed_x", "speed_y"), (b, "vx", "vy"))]
    np.testing.assert_allclose(speed[1], speed[0], rtol=0, atol=rounding)
    fits = [estimates(path, tmp_path / str(k), *SURGE) for k, path in enumerate((log, again))]
    assert fits[1] == pytest.approx(fits[0], rel=1e-5)


# Foreign logs

NO_FIT = {
    "px4_sample_small.ulg": "not a boat (MAV_TYPE 22)",
    "px4_tagged.ulg": "not a boat (MAV_TYPE 2)",
    "roboboat_gps_and_imu_inputs.bag": "no commands, shaft speeds or forces of thrusters",
    "roboboat_nathan01_merged.bag": "no position, velocity, heading or yaw rate",
    "vtol.tlog": "not a boat (MAV_TYPE 1)",
}


@pytest.mark.filterwarnings("ignore:.*left out, because times repeat")
@pytest.mark.parametrize("name", NO_FIT)
def test_log_that_cannot_be_fitted_gives_a_one_line_reason(name: str, tmp_path: Path) -> None:
    source = measured(f"foreign/{name}")
    guess = guess_map(source)
    assert NO_FIT[name] in guess.problem
    assert "\n" not in guess.problem
    log = by_guess(source, tmp_path)  # The available signals are still imported.
    assert signals(log)


def test_scalars_of_a_simulator_are_fitted_after_two_edited_lines(tmp_path: Path) -> None:
    source = measured("foreign/usv_simulator_trial.bag")
    force = '  { name = "X", topic = "u_speed", field = "data", unit = "N", role = "input" },'
    speed = '  { name = "u", topic = "y_speed", field = "data", unit = "m/s" },'
    log = by_guess(source, tmp_path, (('topic = "u_speed"', force), ('topic = "y_speed"', speed)))
    found = estimates(log, tmp_path / "fit", "--model", "surge:force:speed")
    assert found["m_u"] == pytest.approx(31.9, abs=0.5)


def test_imu_with_unknown_covariances_keeps_its_measurements(tmp_path: Path) -> None:
    found = signals(by_guess(measured("foreign/roboboat_gps_and_imu_inputs.bag"), tmp_path))
    assert set(found) == {"x", "y", "vx", "vy", "psi", "r", "ax", "ay"}
    assert len(found["psi"][0]) == len(found["r"][0]) == 5266
    assert len(found["x"][0]) == 89


@pytest.mark.study
def test_autopilot_log_is_imported_by_its_guessed_map(tmp_path: Path) -> None:
    source = measured("ardurover/steps_boat.tlog")
    assert guess_map(source).problem == ""
    found = signals(by_guess(source, tmp_path))
    assert {"x", "y", "vx", "vy", "psi", "r", "n_left", "n_right"} <= set(found)
    assert np.ptp(found["n_left"][1]) > 0.2
