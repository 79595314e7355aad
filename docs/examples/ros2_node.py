"""Node of ROS 2 that holds speed and heading with the state feedback of `lqr` (docs/how-to/control.md).

THE THRUSTERS TURN AS SOON AS IT RUNS. It needs rclpy and the file of the feedback, but neither seatrial nor numpy.

Messages give psi, u, v and r (`SENSORS`): those of an odometry and an IMU, or, with `-p sensors:=gnss`, those of a GNSS
receiver and an IMU with a heading. The shaft speeds n_left and n_right, which only a model with commands has,
are ESTIMATED from the commands that the node sends, by the delay, dead zone and lag of the model. No message corrects
them.
"""

from __future__ import annotations

import json
import math
import signal
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

import rclpy
import std_msgs.msg
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Imu, NavSatFix

RATE = 10.0  # Hz, of the commands
ZEROS = 1.0  # s, of zero commands with fresh messages before the first thrust
RAMP = 0.05  # m/s2: the wanted speed rises from that of the boat (page: start by a ramp)
INTEGRAL = 10.0  # s, time constant of the heading's integral: at least five times that of the slowest pole of the loop
NEAR = math.radians(20.0)  # the integral rests at larger errors, as in a turn
LARGEST = math.radians(20.0)  # of the integral
NUMBERS = ("states", "inputs", "K", "x0", "u0")  # keys that the file of the feedback must have
State = dict[str, float]


def feedback_of(path: str) -> dict[str, Any]:
    """Return the feedback that `to_json` of `lqr` wrote. Raise ValueError if the file lacks what the node needs."""
    with open(path, encoding="utf-8") as file:
        found: dict[str, Any] = json.load(file)
    if missing := [key for key in NUMBERS if key not in found]:
        raise ValueError(f"{path} lacks {', '.join(missing)}: write it by control.to_json, with control = ....lqr(...)")
    n, m = len(found["states"]), len(found["inputs"])
    if (
        len(found["K"]) != m
        or any(len(row) != n for row in found["K"])
        or len(found["x0"]) != n
        or len(found["u0"]) != m
    ):
        raise ValueError(f"{path}: K needs {m} rows of {n} numbers, x0 {n} and u0 {m}: write it by control.to_json")
    if missing := [key for key in ("T_n", "tau_n", "dead_zone") if key not in (found.get("shafts") or {key: 0})]:
        raise ValueError(f"{path}: shafts lacks {', '.join(missing)}: write it by control.to_json(..., shafts=P)")
    return found


def heading(q: Any) -> State:
    """Return the heading of the model (clockwise from north) from a quaternion of ROS (ENU: REP-103)."""
    if abs(math.hypot(q.w, q.x, q.y, q.z) - 1.0) > 0.01:
        return {"psi": math.nan}  # a message without a heading has zeros there
    return {"psi": math.pi / 2.0 - math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))}


def motion(odometry: Any, _: State) -> State:
    """Return heading and speeds of the model (NED, FRD) from a nav_msgs/Odometry (pose ENU, twist FLU: REP-103)."""
    speed = odometry.twist.twist.linear
    return heading(odometry.pose.pose.orientation) | {"u": speed.x, "v": -speed.y}


def turn_rate(imu: Any, _: State) -> State:
    """Return the yaw rate of the model (positive to starboard) from a sensor_msgs/Imu with the axes FLU."""
    return {"r": -imu.angular_velocity.z}


def attitude(imu: Any, x: State) -> State:
    """Return heading and yaw rate from a sensor_msgs/Imu whose orientation is from ENU to FLU."""
    if imu.orientation_covariance[0] == -1.0:
        return {"psi": math.nan}  # REP-145: the IMU has no orientation
    return heading(imu.orientation) | turn_rate(imu, x)


def ground_speeds(velocity: Any, x: State) -> State:
    """Return the speeds over ground from a geometry_msgs/TwistStamped (ENU), with heading and yaw rate of the IMU."""
    east, north = velocity.twist.linear.x, velocity.twist.linear.y
    psi, r = x.get("psi", math.nan), x.get("r", math.nan)  # NaN before the first message of the IMU
    c, s = math.cos(psi), math.sin(psi)
    return {"u": north * c + east * s + r * x["antenna_y"], "v": east * c - north * s - r * x["antenna_x"]}


def valid_fix(fix: Any, _: State) -> State:
    """Return no state from a sensor_msgs/NavSatFix, or a NaN if the receiver has no fix: its velocity is then wrong."""
    return {} if fix.status.status >= 0 else {"fix": math.nan}


# Type, conversion and states of each topic, for each value of the parameter `sensors`. A state that is given here is
# taken from its messages, not estimated: add a topic of the shaft speeds here, if the boat has one.
SENSORS: dict[str, dict[str, tuple[Any, Callable[[Any, State], State], set[str]]]] = {
    "odometry": {
        "/odometry/filtered": (Odometry, motion, {"psi", "u", "v"}),
        "/imu/data": (Imu, turn_rate, {"r"}),
    },
    "gnss": {
        "/imu/data": (Imu, attitude, {"psi", "r"}),
        "/gnss/velocity": (TwistStamped, ground_speeds, {"u", "v"}),
        "/gnss/fix": (NavSatFix, valid_fix, set()),
    },
}


class Shaft:
    """Estimate of a shaft speed from the sent commands: delay, dead zone and first-order lag of the exported model."""

    def __init__(self, side: str, model: dict[str, float]) -> None:
        """Start at rest. ``model`` has ``T_n``, ``tau_n`` [s], ``dead_zone`` and perhaps ``dT_n`` [s] of the model."""
        half = model.get("dT_n", 0.0) / 2.0  # effect lag-mismatch: the right shaft is slower
        self.constant = max(model["T_n"] + {"left": -half, "right": half}[side], 0.05)  # s, as in the model
        self.delay, self.dead_zone = model["tau_n"], model["dead_zone"]
        self.n, self.reference, self.time = 0.0, 0.0, time.monotonic()
        self.waiting: deque[tuple[float, float]] = deque()  # time [s] at which a command takes effect, and the command

    def send(self, command: float) -> None:
        """Store a command that is sent now."""
        self.waiting.append((time.monotonic() + self.delay, command))

    def estimate(self, now: float) -> float:
        """Return the shaft speed at the time `now` [s], 1 is full speed."""
        while self.waiting and self.waiting[0][0] <= now:
            since, command = self.waiting.popleft()
            self.turn(since)
            self.reference = self.outside_dead_zone(command)
        self.turn(now)
        return self.n

    def turn(self, until: float) -> None:
        """Let the shaft follow its reference up to this time [s]."""
        self.n += (1.0 - math.exp(-(until - self.time) / self.constant)) * (self.reference - self.n)
        self.time = until

    def outside_dead_zone(self, command: float) -> float:
        """Return the command, or zero within the dead zone, whose edge is smooth as in the model."""
        width = min(0.05, 2.0 * self.dead_zone)
        inside = min(max((self.dead_zone + width / 2.0 - abs(command)) / max(width, 1e-9), 0.0), 1.0)
        return command * (1.0 - inside * inside * (3.0 - 2.0 * inside))


class Controller(Node):
    """Node that sends a command in [-1, 1] to each thruster at a fixed rate, and zero if a message is late."""

    def __init__(self) -> None:
        super().__init__("boat_controller")
        self.declare_parameter("sensors", "odometry")  # or gnss
        for name, default in (("feedback", "feedback.json"), ("speed", 0.8), ("heading", 0.0), ("limit", 0.6)):
            self.declare_parameter(name, default)  # heading: deg, clockwise from north; limit: largest command
        self.declare_parameter("stale", 0.3)  # s: an older message stops the thrusters
        self.declare_parameter("message", "Float64")  # type of the commands, of std_msgs, with one number `data`
        self.message = getattr(std_msgs.msg, self.get_parameter("message").value, None)
        if self.message is None or not hasattr(self.message(), "data"):
            raise ValueError(
                f"the parameter message is {self.get_parameter('message').value}; it must be a type of std_msgs with a "
                "number: Float64 or Float32"
            )
        if not 0.0 < self.get_parameter("stale").value < math.inf:
            raise ValueError(f"the parameter stale is {self.get_parameter('stale').value}; it must be seconds above 0")
        # m, of the GNSS antenna forward and to starboard of the centre of gravity, for the sensors gnss
        self.declare_parameter("antenna", [0.0, 0.0])
        antenna = list(self.get_parameter("antenna").value)
        if len(antenna) != 2 or not all(map(math.isfinite, antenna)):
            raise ValueError(f"the parameter antenna is {antenna}; it must be [forward, to starboard] in m: [0.3, 0.0]")
        if (sensors := self.get_parameter("sensors").value) not in SENSORS:
            raise ValueError(f"the parameter sensors is {sensors}; it must be {' or '.join(SENSORS)}")
        topics = SENSORS[sensors]
        self.feedback = feedback_of(self.get_parameter("feedback").value)
        names = [n.removeprefix("n_").removeprefix("cmd_") for n in self.feedback["inputs"]]
        missing = set(self.feedback["states"]).difference(*(states for _, _, states in topics.values()))
        # The commands give the shaft speeds, if the file has the model of the shafts.
        sides = [n for n in names if f"n_{n}" in missing] if self.feedback.get("shafts") else []
        if missing := missing - {f"n_{n}" for n in sides}:
            raise ValueError(
                f"no message gives the states {sorted(missing)}: subscribe to them (SENSORS). Shaft speeds are "
                "estimated if the file of the feedback has the key shafts: control.to_json(..., shafts=P)"
            )
        self.shafts = {n: Shaft(n, self.feedback["shafts"]) for n in sides}  # by side
        self.names = names
        self.commands = [self.create_publisher(self.message, f"/thrusters/{n}/command", 10) for n in names]
        self.x: State = dict(zip(("antenna_x", "antenna_y"), antenna, strict=True))  # and the latest states
        self.heard = dict.fromkeys(topics, -math.inf)  # s, of the last valid message of each topic
        self.stopped, self.since, self.wanted = "start", time.monotonic(), 0.0  # reason, its time [s], ramp [m/s]
        self.correction = 0.0  # rad, of the wanted heading: the integral of the heading error
        for topic, (kind, convert, _) in topics.items():
            self.create_subscription(kind, topic, partial(self.hear, topic, convert), qos_profile_sensor_data)
        # A steady clock: a jump of the time of day, such as by GNSS, changes neither the rate nor an age.
        self.create_timer(1.0 / RATE, self.update, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.get_logger().info(f"zero thrust until messages arrive on {' and '.join(topics)}")
        if sides:
            self.get_logger().info(f"estimated from the commands: {', '.join(f'n_{n}' for n in sides)}")

    def hear(self, topic: str, convert: Callable[[Any, State], State], message: Any) -> None:
        """Store the measured values of a message. The node ignores a message with a value that is not finite."""
        found = convert(message, self.x)
        if all(map(math.isfinite, found.values())):
            self.x |= found
            self.heard[topic] = time.monotonic()

    def update(self) -> None:
        """Send the commands of the feedback, or zero. ``ros2 param set`` changes a set-point while the node runs."""
        speed, heading, limit, stale = (self.get_parameter(n).value for n in ("speed", "heading", "limit", "stale"))
        now = time.monotonic()
        self.x |= {f"n_{n}": shaft.estimate(now) for n, shaft in self.shafts.items()}
        if late := [topic for topic, heard in self.heard.items() if not now - heard <= stale]:
            return self.stop(f"no valid message within {stale:g} s on {' and '.join(late)}")
        if not all(map(math.isfinite, (speed, heading, limit))):
            return self.stop("speed, heading and limit must be finite")
        if self.stopped and now - self.since < ZEROS:
            return self.send([0.0] * len(self.commands))
        if self.stopped:
            self.get_logger().info("messages arrive: the thrusters turn")
            if max(map(abs, self.feedback["u0"])) > 0.9 * limit:
                steady = ", ".join(f"{n} {u0:.2f}" for n, u0 in zip(self.names, self.feedback["u0"], strict=True))
                self.get_logger().warning(
                    f"too little room to steer: the speed of the feedback needs {steady}, more than 0.9 of the limit "
                    f"{limit:g}; set a larger limit, or write the feedback of a lower speed"
                )
            self.stopped, self.wanted = "", self.x["u"]
        self.wanted = min(speed, self.wanted + RAMP / RATE)
        goal = dict(zip(self.feedback["states"], self.feedback["x0"], strict=True))
        goal |= {"psi": math.radians(heading) + self.correction, "u": self.wanted}
        error = {n: self.x[n] - goal[n] for n in self.feedback["states"]}
        if "psi" in error:  # the shorter turn
            error["psi"] = math.remainder(error["psi"], 2.0 * math.pi)
        rows = zip(self.feedback["u0"], self.feedback["K"], strict=True)
        commands = [u0 - sum(k * e for k, e in zip(row, error.values(), strict=True)) for u0, row in rows]
        if "psi" in error and max(map(abs, commands)) < limit:
            self.integrate(math.remainder(math.radians(heading) - self.x["psi"], 2.0 * math.pi))
        return self.send([min(max(n, -limit), limit) for n in commands])

    def integrate(self, error: float) -> None:
        """Add a heading error [rad] to the correction of the wanted heading.

        The feedback alone leaves an error where a thruster, the wind or the current differs from the model.
        """
        if abs(error) < NEAR:
            changed = self.correction + error / (INTEGRAL * RATE)
            self.correction = min(max(changed, -LARGEST), LARGEST)

    def send(self, commands: list[float]) -> None:
        """Publish one command for each thruster."""
        for name, publisher, n in zip(self.names, self.commands, commands, strict=True):
            publisher.publish(self.message(data=float(n)))
            if name in self.shafts:
                self.shafts[name].send(float(n))

    def stop(self, reason: str) -> None:
        """Send zero. Log the reason once, when the thrusters stop."""
        self.send([0.0] * len(self.commands))
        if not self.stopped:
            self.get_logger().error(f"zero thrust: {reason}")
        self.stopped, self.since, self.correction = reason, time.monotonic(), 0.0


def main() -> None:
    """Run the node until it ends by Ctrl-C, by SIGTERM or with an exception. In all cases, send zero at the end."""
    # With handlers of rclpy, the node could not send zero any more after the signal.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    node, reason = Controller(), "the node was ended"
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    except BaseException as error:
        reason = repr(error)
        raise
    finally:
        for _ in range(3):  # with time to leave this process
            node.stop(reason)
            time.sleep(0.05)
        rclpy.shutdown()


if __name__ == "__main__":
    main()
