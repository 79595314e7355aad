"""Tests that run docs/examples/ros2_node.py with a small substitute of rclpy, on the exported model as the boat."""

from __future__ import annotations

import importlib
import importlib.util
import json
import math
import signal
import sys
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from seatrial.daq.tools.ros_frames import pose_messages
from tests.ident.workflows.test_control import PAGE, folder
from tests.page_runner import run_python
from tests.test_docs import ROOT, blocks

__all__ = ["folder"]

NODE = ROOT / "docs/examples/ros2_node.py"
DT = 0.05  # s, of the simulated boat
ODOMETRY, IMU = "/odometry/filtered", "/imu/data"
VELOCITY, FIX = "/gnss/velocity", "/gnss/fix"


class Ros:
    """Substitute of rclpy and of the computer's clock, with the boat of an exported model."""

    def __init__(self, boat: Any) -> None:
        self.boat, self.now, self.scenario = boat, 100.0, lambda: None
        self.sent: dict[str, list[tuple[float, float]]] = {}  # s and command, by topic
        self.heard: dict[str, Callable[[Any], None]] = {}
        self.timers: list[list[Any]] = []  # period, next time [s], callback
        self.silent: set[str] = set()  # topics without messages
        self.antenna = (0.0, 0.0)  # m, forward and to starboard of the centre of gravity
        self.shares = (1.0, 1.0)  # shaft speed of the left and the right thruster over that of the model
        self.logged: list[tuple[str, str]] = []
        self.parameters: dict[str, Any] = {}
        self.up, self.own_signals = False, False
        self.odometry: Any = None
        self.control: Any = None  # feedback of `lqr`

    def modules(self) -> dict[str, ModuleType]:
        """Return the modules that the node imports."""
        ros, types = self, SimpleNamespace

        class Node:
            def __init__(self, name: str) -> None:
                assert ros.up, "rclpy.init first"

            def declare_parameter(self, name: str, default: Any) -> None:
                ros.parameters.setdefault(name, default)

            def get_parameter(self, name: str) -> Any:
                return types(value=ros.parameters[name])

            def create_publisher(self, kind: Any, topic: str, depth: int) -> Any:
                ros.sent[topic] = []
                return types(publish=lambda message: ros.publish(topic, message))

            def create_subscription(self, kind: Any, topic: str, callback: Any, qos: Any) -> None:
                ros.heard[topic] = callback

            def create_timer(self, period: float, callback: Any, clock: Any) -> None:
                assert clock == "steady"
                ros.timers.append([period, ros.now + period, callback])

            def get_logger(self) -> Any:
                kinds = ("info", "warning", "error")
                return types(**{kind: partial(self._log, kind) for kind in kinds})

            def _log(self, kind: str, text: str) -> None:
                ros.logged.append((kind, text))

        def message(**values: Any) -> Any:
            return types(**{"data": 0.0} | values)

        parts: dict[str, dict[str, Any]] = {
            "rclpy": {"init": self.init, "spin": self.spin, "shutdown": self.shutdown},
            "rclpy.node": {"Node": Node},
            "rclpy.clock": {"Clock": lambda clock_type: clock_type, "ClockType": types(STEADY_TIME="steady")},
            "rclpy.qos": {"qos_profile_sensor_data": None},
            "rclpy.signals": {"SignalHandlerOptions": types(NO="none")},
            "nav_msgs": {}, "nav_msgs.msg": {"Odometry": message},
            "geometry_msgs": {}, "geometry_msgs.msg": {"TwistStamped": message},
            "sensor_msgs": {}, "sensor_msgs.msg": {"Imu": message, "NavSatFix": message},
            "std_msgs": {}, "std_msgs.msg": {"Float64": message, "Float32": message, "Header": type("Header", (), {})},
        }  # fmt: skip
        made = {name: ModuleType(name) for name in parts}
        for name, values in parts.items():
            vars(made[name]).update(values)
        vars(made["std_msgs"])["msg"] = made["std_msgs.msg"]
        return made

    def init(self, signal_handler_options: str) -> None:
        self.up, self.own_signals = True, signal_handler_options == "none"

    def spin(self, node: Any) -> None:
        self.node = node
        self.scenario()

    def shutdown(self) -> None:
        self.up = False

    def publish(self, topic: str, message: Any) -> None:
        """Store a command. As in ROS 2, nothing can be published after the shutdown, nor by a command of numpy."""
        assert self.up
        assert type(message.data) is float
        self.sent[topic].append((self.now, message.data))

    def sleep(self, seconds: float) -> None:
        self.now += seconds

    @property
    def state(self) -> dict[str, float]:
        return dict(zip(self.boat.STATES, self.simulation.x, strict=True))

    def start(self) -> None:
        self.simulation = self.boat.Simulation(DT)

    def sail(self, seconds: float) -> None:
        """Let time pass: the boat moves with the last commands, its sensors send, and due timers are called."""
        for _ in range(round(seconds / DT)):
            last = [self.sent[f"/thrusters/{n}/command"][-1:] for n in ("left", "right")]
            commands = [command[0][1] if command else 0.0 for command in last]
            self.simulation.step([share * n for share, n in zip(self.shares, commands, strict=True)])
            self.now += DT
            x = self.state
            angles = (x["psi"], 0.0, 0.0)
            twist = np.array([x["u"], x["v"], 0.0, 0.0, 0.0, x["r"]])
            types: dict[str, Any] = defaultdict(lambda: SimpleNamespace)
            zero = (np.zeros((6, 6)),) * 2
            position = np.array([x["x"], x["y"], 0.0])
            self.odometry = next(pose_messages(self.now, position, angles, twist, zero, types)).message
            for topic, message in self.messages().items():
                if topic in self.heard and topic not in self.silent:
                    self.heard[topic](message)
            for timer in self.timers:
                if self.now >= timer[1] - 1e-9:
                    timer[1] += timer[0]
                    timer[2]()

    def messages(self) -> dict[str, Any]:
        """Return the message of each topic, in axes of ROS. The velocity is that of the antenna, east and north."""
        pose, twist = self.odometry.pose.pose, self.odometry.twist.twist
        yaw = 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)
        forward, port = self.antenna[0], -self.antenna[1]
        speed = complex(twist.linear.x - twist.angular.z * port, twist.linear.y + twist.angular.z * forward)
        speed *= complex(math.cos(yaw), math.sin(yaw))
        velocity = SimpleNamespace(linear=SimpleNamespace(x=speed.real, y=speed.imag, z=0.0))
        imu = SimpleNamespace(
            orientation=pose.orientation, orientation_covariance=[0.01] * 9, angular_velocity=twist.angular
        )
        fix = SimpleNamespace(status=SimpleNamespace(status=0), latitude=54.0, longitude=10.0, altitude=0.0)
        return {ODOMETRY: self.odometry, IMU: imu, VELOCITY: SimpleNamespace(twist=velocity), FIX: fix}

    def commands(self, n: int) -> list[float]:
        """Return the last n commands of every thruster."""
        return [command for sent in self.sent.values() for _, command in sent[-n:]]

    @property
    def errors(self) -> list[str]:
        return [text for kind, text in self.logged if kind == "error"]


def boat_of_page(folder: Path, monkeypatch: pytest.MonkeyPatch, block: int, plant: str) -> Ros:
    """Write the feedback by the block of the page, and return ROS with the exported boat ``plant``."""
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(folder)
    code = blocks(PAGE, "python")[block]
    assert "control.to_json(" in code
    for name in ("plant", "commanded"):  # other tests have models of the same names
        monkeypatch.delitem(sys.modules, name, raising=False)
    found = run_python(code, str(PAGE))
    made = Ros(importlib.import_module(plant))
    del sys.modules[plant]
    made.control = found["control"]
    made.start()
    return made


@pytest.fixture
def ros(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Ros:
    """Return ROS with the boat of the page, whose inputs are shaft speeds."""
    return boat_of_page(folder, monkeypatch, 9, "plant")


@pytest.fixture
def commanded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Ros:
    """Return ROS with the boat of the page whose inputs are commands."""
    return boat_of_page(folder, monkeypatch, 10, "commanded")


@pytest.fixture
def node(ros: Ros, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Import the node; its clock is that of the simulated boat."""
    return imported_node(ros, monkeypatch)


def imported_node(ros: Ros, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Import the node with the modules of ``ros`` and the clock of its boat."""
    for name, module in ros.modules().items():
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location("ros2_node", NODE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: ros.now, sleep=ros.sleep))
    return module


def run(node: Any, ros: Ros, scenario: Callable[[], None]) -> None:
    """Run the program of the node; the scenario takes the place of `rclpy.spin`."""
    ros.scenario = scenario
    before = signal.getsignal(signal.SIGTERM)
    try:
        node.main()
        assert signal.getsignal(signal.SIGTERM) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGTERM, before)
    assert not ros.up


@pytest.mark.parametrize("sensors", ["odometry", "gnss"])
def test_the_node_reaches_its_set_point_and_turns_to_starboard(sensors: str, node: Any, ros: Ros) -> None:
    ros.parameters["sensors"] = sensors

    def scenario() -> None:
        ros.sail(40.0)
        assert ros.state["u"] == pytest.approx(0.8, abs=0.01)
        assert ros.state["psi"] == pytest.approx(0.0, abs=0.01)
        north, east = ros.odometry.pose.pose.position.y, ros.odometry.pose.pose.position.x
        assert north > 10.0
        assert abs(east) < 0.1
        ros.parameters["heading"] = 90.0
        ros.sail(1.0)
        assert ros.odometry.twist.twist.angular.z < -0.05  # REP-103: negative is clockwise from above
        assert ros.sent["/thrusters/left/command"][-1][1] > ros.sent["/thrusters/right/command"][-1][1]
        ros.sail(29.0)
        assert math.degrees(ros.state["psi"]) == pytest.approx(90.0, abs=0.5)
        assert ros.odometry.pose.pose.position.x > east + 10.0  # east
        ros.parameters["heading"] = -60.0
        ros.sail(1.0)
        assert ros.odometry.twist.twist.angular.z > 0.05  # to port
        ros.sail(29.0)
        assert math.degrees(ros.state["psi"]) == pytest.approx(-60.0, abs=0.5)
        assert ros.state["u"] == pytest.approx(0.8, abs=0.01)

    run(node, ros, scenario)
    assert max(map(abs, (c for sent in ros.sent.values() for _, c in sent))) <= 0.6
    times = [t for t, _ in ros.sent["/thrusters/left/command"][:-3]]
    assert np.diff(times) == pytest.approx(0.1)
    # The guard of `seatrial mission follow` needs zero first.
    assert all(c == 0.0 for sent in ros.sent.values() for t, c in sent if t < times[0] + 0.9)
    assert ros.own_signals


def test_the_law_is_that_of_the_state_feedback(node: Any, ros: Ros) -> None:
    def scenario() -> None:
        ros.sail(5.0)
        boat = {"u": 0.75, "v": -0.04, "r": 0.02, "psi": math.radians(-175.0)}
        types: dict[str, Any] = defaultdict(lambda: SimpleNamespace)
        twist = np.array([boat["u"], boat["v"], 0.0, 0.0, 0.0, boat["r"]])
        pose = (np.zeros(3), (boat["psi"], 0.0, 0.0), twist, (np.zeros((6, 6)),) * 2)
        odometry = next(pose_messages(ros.now, *pose, types)).message
        ros.heard[ODOMETRY](odometry)
        ros.heard[IMU](SimpleNamespace(angular_velocity=odometry.twist.twist.angular))
        assert math.remainder(ros.node.x["psi"] - boat["psi"], 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)
        ros.parameters.update(heading=178.0, limit=1.0, speed=0.7)
        ros.node.wanted, ros.node.correction = 0.7, 0.0
        ros.node.update()
        wanted = ros.control(boat, psi=math.radians(178.0), u=0.7)
        assert max(map(abs, wanted)) < 1.0
        assert wanted[0] != pytest.approx(wanted[1], abs=0.1)
        assert ros.commands(1) == pytest.approx(wanted)

    run(node, ros, scenario)


@pytest.mark.parametrize("model", ["ros", "commanded"])
def test_a_weaker_thruster_leaves_no_heading_error(
    model: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The left thruster gives 15 % less thrust than in the model. The feedback without the integral is wrong by it."""
    ros = request.getfixturevalue(model)
    node = imported_node(ros, monkeypatch)
    ros.shares = (math.sqrt(0.85), 1.0)
    ros.parameters["heading"] = 40.0

    def error() -> float:
        return math.degrees(ros.state["psi"]) - ros.parameters["heading"]

    def scenario() -> None:
        ros.sail(90.0)
        assert error() == pytest.approx(0.0, abs=0.3)
        held = ros.node.correction
        assert held > math.radians(0.5)
        ros.parameters["heading"] = 130.0  # a turn does not change it by much
        found = []
        for _ in range(60):
            ros.sail(1.0)
            found.append(error())
        assert max(found) < 4.0
        assert max(map(abs, found[-20:])) < 0.3
        monkeypatch.setattr(node, "INTEGRAL", math.inf)
        ros.node.correction = 0.0
        ros.sail(40.0)
        assert error() < -0.5

    run(node, ros, scenario)


@pytest.mark.parametrize("share", [0.85, 0.95])
def test_a_limit_near_the_inputs_of_the_speed_is_logged(share: float, node: Any, ros: Ros) -> None:
    """Above 0.9 of the limit, the feedback has too little room to steer."""
    largest = max(ros.control.u0)
    ros.parameters["limit"] = largest / share
    run(node, ros, lambda: ros.sail(3.0))
    warnings = [text for kind, text in ros.logged if kind == "warning"]
    assert len(warnings) == (share > 0.9)
    for text in warnings:
        assert text.startswith(
            f"too little room to steer: the speed of the feedback needs left {ros.control.u0[0]:.2f}"
        )


def test_the_integral_of_the_heading_rests_at_the_limit_and_is_bounded(node: Any, ros: Ros) -> None:
    def scenario() -> None:
        ros.sail(5.0)
        ros.node.correction = 0.1
        ros.parameters["limit"] = 0.05
        ros.sail(1.0)
        assert ros.node.correction == 0.1
        ros.parameters["limit"] = 0.6
        for _ in range(1000):
            ros.node.integrate(-0.3)
        assert ros.node.correction == pytest.approx(-math.radians(20.0))
        ros.node.integrate(math.pi / 2.0)  # a turn
        assert ros.node.correction == pytest.approx(-math.radians(20.0))
        ros.silent.add(IMU)
        ros.sail(1.0)
        assert ros.node.correction == 0.0

    run(node, ros, scenario)


def test_states_by_gnss_are_those_of_the_boat(node: Any, ros: Ros) -> None:
    """In a turn the antenna ahead of and beside the centre of gravity has other speeds than the boat."""
    ros.parameters["sensors"], ros.antenna = "gnss", (0.4, -0.3)
    ros.parameters["antenna"] = [0.4, -0.3]

    def scenario() -> None:
        ros.sail(20.0)
        ros.parameters["heading"] = 150.0
        for _ in range(20):
            ros.sail(1.0)
            found = ros.node.x
            for name in ("u", "v", "r"):
                assert found[name] == pytest.approx(ros.state[name], abs=1e-9)
            assert math.remainder(found["psi"] - ros.state["psi"], 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)

    run(node, ros, scenario)
    assert not ros.errors[:-1]


@pytest.mark.parametrize("antenna", [[0.3], [0.3, math.nan]])
def test_invalid_antenna_is_refused(node: Any, ros: Ros, antenna: list[float]) -> None:
    ros.parameters["antenna"] = antenna
    with pytest.raises(
        ValueError, match=r"the parameter antenna is \[0\.3.*; it must be \[forward, to starboard\] in m"
    ):
        run(node, ros, lambda: None)


def test_unknown_sensors_are_refused(node: Any, ros: Ros) -> None:
    ros.parameters["sensors"] = "gps"
    with pytest.raises(ValueError, match=r"^the parameter sensors is gps; it must be odometry or gnss$"):
        run(node, ros, lambda: None)


@pytest.mark.parametrize("fault", ["no fix", "no orientation", "no heading", "nan", "silent imu", "silent velocity"])
def test_a_fault_of_the_gnss_or_its_imu_stops_the_thrusters(fault: str, node: Any, ros: Ros) -> None:
    ros.parameters["sensors"] = "gnss"
    topic = {"no fix": FIX, "nan": VELOCITY, "silent velocity": VELOCITY}.get(fault, IMU)

    def scenario() -> None:
        ros.sail(10.0)
        assert min(ros.commands(1)) > 0.1
        good = ros.heard[topic]

        def broken(message: Any) -> None:
            if fault == "no fix":
                message.status.status = -1
            elif fault == "no orientation":
                message.orientation_covariance[0] = -1.0
            elif fault == "no heading":
                message.orientation = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=0.0)
            elif fault == "nan":
                message.twist.linear.y = math.nan
            if not fault.startswith("silent"):
                good(message)

        ros.heard[topic] = broken
        ros.sail(1.0)
        assert ros.commands(5) == [0.0] * 10
        assert ros.errors == [f"zero thrust: no valid message within 0.3 s on {topic}"]

    run(node, ros, scenario)


@pytest.mark.parametrize("topic", [ODOMETRY, IMU])
def test_a_silent_sensor_stops_the_thrusters(topic: str, node: Any, ros: Ros) -> None:
    def scenario() -> None:
        ros.sail(10.0)
        assert min(ros.commands(1)) > 0.1
        assert not ros.errors
        ros.silent.add(topic)
        ros.sail(ros.node.get_parameter("stale").value - 0.1)
        assert min(ros.commands(1)) > 0.1
        ros.sail(0.3)
        assert ros.commands(1) == [0.0, 0.0]
        ros.sail(5.0)
        assert ros.commands(40) == [0.0] * 80  # zero is repeated
        assert ros.errors == [f"zero thrust: no valid message within 0.3 s on {topic}"]
        ros.silent.clear()
        ros.sail(node.ZEROS - 0.2)
        assert ros.commands(5) == [0.0] * 10
        ros.sail(20.0)
        assert min(ros.commands(1)) > 0.1
        ros.silent.add(topic)
        ros.sail(5.0)
        assert len(ros.errors) == 2  # once for each stop

    run(node, ros, scenario)
    assert len(ros.errors) == 2


def test_without_messages_the_thrusters_never_turn(node: Any, ros: Ros) -> None:
    ros.silent |= {ODOMETRY, IMU}
    run(node, ros, lambda: ros.sail(5.0))
    assert len(ros.sent["/thrusters/left/command"]) > 40
    assert not any(ros.commands(0))
    assert ros.logged == [("info", f"zero thrust until messages arrive on {ODOMETRY} and {IMU}")]


@pytest.mark.parametrize("fault", ["nan", "no heading", "nan parameter"])
def test_values_that_are_not_finite_stop_the_thrusters(fault: str, node: Any, ros: Ros) -> None:
    """An odometry without a heading has a quaternion of zeros, which would be east."""

    def scenario() -> None:
        ros.sail(10.0)
        if fault == "nan parameter":
            ros.parameters["speed"] = math.nan
        else:
            good = ros.heard[ODOMETRY]

            def broken(message: Any) -> None:
                if fault == "nan":
                    message.twist.twist.linear.x = math.nan
                else:
                    message.pose.pose.orientation = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=0.0)
                good(message)

            ros.heard[ODOMETRY] = broken
        ros.sail(1.0)
        assert ros.commands(5) == [0.0] * 10
        assert len(ros.errors) == 1

    run(node, ros, scenario)


@pytest.mark.parametrize("end", [KeyboardInterrupt, RuntimeError, None])
def test_the_end_of_the_program_stops_the_thrusters(end: type[BaseException] | None, node: Any, ros: Ros) -> None:
    def scenario() -> None:
        ros.sail(10.0)
        assert min(ros.commands(1)) > 0.1
        if end:
            raise end("spin")

    if end is RuntimeError:
        with pytest.raises(RuntimeError, match="spin"):
            run(node, ros, scenario)
        assert not ros.up
    else:
        run(node, ros, scenario)
    assert ros.commands(3) == [0.0] * 6
    (error,) = ros.errors
    reason = "RuntimeError('spin')" if end is RuntimeError else "the node was ended"
    assert error == f"zero thrust: {reason}"


@pytest.mark.parametrize("place", ["subscription", "timer"])
def test_an_exception_in_a_callback_stops_the_thrusters(place: str, node: Any, ros: Ros) -> None:
    def scenario() -> None:
        ros.sail(10.0)
        assert min(ros.commands(1)) > 0.1
        if place == "subscription":
            ros.heard[ODOMETRY](SimpleNamespace(pose=None, twist=None))
        else:
            del ros.node.feedback["K"]
            ros.sail(1.0)

    with pytest.raises(AttributeError if place == "subscription" else KeyError):
        run(node, ros, scenario)
    assert not ros.up
    assert ros.commands(3) == [0.0] * 6
    (error,) = ros.errors
    assert error.startswith("zero thrust: ")


@pytest.fixture
def node_of_commands(commanded: Ros, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Import the node; its clock is that of the boat with commands."""
    return imported_node(commanded, monkeypatch)


def test_shaft_speeds_without_a_topic_are_estimated_from_the_commands(node_of_commands: Any, commanded: Ros) -> None:
    """The estimates are those of the boat, with delay, dead zone and lag, while the commands change and at zero."""
    ros, found = commanded, []

    def compare(seconds: float) -> None:
        for _ in range(round(seconds / DT)):
            ros.sail(DT)
            estimates = [shaft.estimate(ros.now) for shaft in ros.node.shafts.values()]
            found.append((estimates, [ros.state["n_left"], ros.state["n_right"]]))

    def scenario() -> None:
        ros.sail(30.0)
        assert ros.state["u"] == pytest.approx(0.8, abs=0.01)
        ros.parameters["heading"] = 90.0
        compare(30.0)
        assert math.degrees(ros.state["psi"]) == pytest.approx(90.0, abs=0.5)
        assert ros.state["u"] == pytest.approx(0.8, abs=0.01)
        ros.parameters["limit"] = 0.01  # within the dead zone
        compare(5.0)
        ros.silent.add(IMU)
        compare(2.0)
        assert not any(abs(n) > 1e-3 for n in found[-1][0])

    run(node_of_commands, ros, scenario)
    estimated, true = (np.array(part) for part in zip(*found, strict=True))
    assert np.ptp(true[:, 0] - true[:, 1]) > 0.2
    assert np.abs(estimated - true).max() < 0.02
    assert ("info", "estimated from the commands: n_left, n_right") in ros.logged


@pytest.mark.parametrize(
    "model",
    [
        {"T_n": 0.3, "tau_n": 0.0, "dead_zone": 0.0},
        {"T_n": 0.4, "tau_n": 0.27, "dead_zone": 0.2, "dT_n": 0.3},
        {"T_n": 0.01, "tau_n": 0.1, "dead_zone": 0.01},
    ],
)
def test_the_shaft_has_the_delay_dead_zone_and_lag_of_the_model(
    model: dict[str, float], node_of_commands: Any, commanded: Ros
) -> None:
    """A step of the command outside and inside of the dead zone, at any time after it."""
    for side, sign in (("left", -0.5), ("right", 0.5)):
        constant = max(model["T_n"] + sign * model.get("dT_n", 0.0), 0.05)
        for command, reference in ((0.5, 0.5), (-0.4, -0.4), (0.9 * model["dead_zone"], None)):
            shaft, start = node_of_commands.Shaft(side, model), commanded.now
            shaft.send(command)
            if reference is None:
                assert shaft.estimate(start + 5.0) <= 0.5 * command
                continue
            for t in (0.05, 0.2, 0.5, 2.0):
                expected = reference * (1.0 - math.exp(-max(t - model["tau_n"], 0.0) / constant))
                assert shaft.estimate(start + t) == pytest.approx(expected, abs=1e-9)


def test_shaft_speeds_with_a_topic_are_taken_from_it(
    node_of_commands: Any, commanded: Ros, monkeypatch: pytest.MonkeyPatch
) -> None:
    def shaft_speeds(message: Any, _: dict[str, float]) -> dict[str, float]:
        return {"n_left": message.left, "n_right": message.right}

    shafts = (None, shaft_speeds, {"n_left", "n_right"})
    monkeypatch.setitem(node_of_commands.SENSORS["odometry"], "/shafts", shafts)

    def scenario() -> None:
        assert not commanded.node.shafts
        commanded.heard["/shafts"](SimpleNamespace(left=0.2, right=0.3))
        commanded.sail(0.2)
        assert (commanded.node.x["n_left"], commanded.node.x["n_right"]) == (0.2, 0.3)

    run(node_of_commands, commanded, scenario)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"K": None}, r"feedback\.json lacks K: write it by control\.to_json"),
        ({"x0": [0.0]}, r"feedback\.json: K needs 2 rows of 4 numbers, x0 4 and u0 2"),
        ({"shafts": {"T_n": 0.3}}, r"shafts lacks tau_n, dead_zone: write it by control\.to_json\(\.\.\., shafts=P\)"),
    ],
)
def test_a_file_that_lacks_numbers_is_refused_at_the_start(
    changed: dict[str, Any], said: str, node: Any, ros: Ros
) -> None:
    """A file of `to_json` gave a KeyError at the first thrust."""
    feedback = json.loads(Path("feedback.json").read_text(encoding="utf-8")) | changed
    kept = {name: value for name, value in feedback.items() if value is not None}
    Path("feedback.json").write_text(json.dumps(kept), encoding="utf-8")
    with pytest.raises(ValueError, match=said):
        run(node, ros, lambda: None)
    assert not any(ros.sent.values())


def test_age_and_type_of_messages_are_parameters(node: Any, ros: Ros) -> None:
    ros.parameters |= {"stale": 1.0, "message": "Float32"}

    def scenario() -> None:
        ros.sail(10.0)
        ros.silent.add(IMU)
        ros.sail(0.8)
        assert min(ros.commands(1)) > 0.1
        ros.sail(0.4)
        assert ros.commands(1) == [0.0] * 2

    run(node, ros, scenario)
    assert any("no valid message within 1 s on /imu/data" in text for text in ros.errors)


@pytest.mark.parametrize(
    ("name", "value"), [("stale", 0.0), ("stale", math.nan), ("message", "Header"), ("message", "F")]
)
def test_invalid_age_or_type_is_refused(name: str, value: Any, node: Any, ros: Ros) -> None:
    ros.parameters[name] = value
    with pytest.raises(ValueError, match=f"the parameter {name} is {value}; it must be"):
        run(node, ros, lambda: None)


@pytest.mark.parametrize("missing", ["n_left", "bank_angle"])
def test_a_state_without_a_message_or_an_estimate_is_refused(missing: str, node: Any, ros: Ros) -> None:
    """The file of a model of shaft speeds has no model of the shafts."""
    feedback = json.loads(Path("feedback.json").read_text(encoding="utf-8"))
    feedback["states"] = [*feedback["states"], missing]
    feedback["x0"], feedback["K"] = [*feedback["x0"], 0.0], [[*row, 0.0] for row in feedback["K"]]
    Path("feedback.json").write_text(json.dumps(feedback), encoding="utf-8")
    with pytest.raises(ValueError, match=rf"no message gives the states \['{missing}'\]"):
        run(node, ros, lambda: None)
    assert not any(ros.sent.values())
