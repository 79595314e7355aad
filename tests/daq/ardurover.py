"""A real ArduPilot Rover in its own simulator, with a link that can be cut, and a second station that listens and
commands.

SEATRIAL_ARDUROVER names the program `ardurover`, as ArduPilot's `waf configure --board sitl; waf rover` builds it.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as dialect

PROGRAM = os.environ.get("SEATRIAL_ARDUROVER", "")
MISSING = "SEATRIAL_ARDUROVER is not set to the path of ArduPilot's simulator"
PARAMETERS = {
    "FRAME_CLASS": 2, "SERVO1_FUNCTION": 73, "SERVO3_FUNCTION": 74, "PILOT_STEER_TYPE": 1, "RC_OVERRIDE_TIME": 1,
    "FS_GCS_ENABLE": 1, "FS_THR_ENABLE": 1, "FS_ACTION": 2, "MOT_SLEWRATE": 0,
    **{f"RC{k}_{end}": us for k in (1, 3) for end, us in (("MIN", 1000), ("TRIM", 1500), ("MAX", 2000), ("DZ", 0))},
    **{f"SERVO{k}_{end}": us for k in (1, 3) for end, us in (("MIN", 1000), ("TRIM", 1500), ("MAX", 2000))},
    **{f"INS_ACC{k}_{axis}": value for k, value in (("2OFFS", 0.001), ("2SCAL", 1.001)) for axis in "XYZ"},
    **{f"INS_ACC{k}_{axis}": value for k, value in (("OFFS", 0.001), ("SCAL", 1.001)) for axis in "XYZ"},
    "BATT_MONITOR": 4, "SIM_WIND_SPD": 0, "SIM_WAVE_ENABLE": 0,
}  # fmt: skip
RIG = """\
format = "seatrial-rig 1"
name = "a simulated rover"

[[device]]
name = "autopilot"
protocol = "mavlink"
port = "udp:127.0.0.1:{port}"
rate_hz = 25.0
{more}
[[thruster]]
name = "left"
device = "autopilot"
node = 1
rc_channel = 1
pwm_us = [1000.0, 1500.0, 2000.0]
position_m = [0.0, -0.15, 0.0]

[[thruster]]
name = "right"
device = "autopilot"
node = 3
rc_channel = 3
pwm_us = [1000.0, 1500.0, 2000.0]
position_m = [0.0, 0.15, 0.0]
"""
READY = 1 | 2 | 16  # flags of EKF_STATUS_REPORT: attitude, horizontal velocity and position
NEUTRAL_US = 10.0
HEADING_DEG = 40.0  # during the start
HURRY = 10.0  # speed relative to real time until the estimator has a position


def _socket() -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", 0))
    return sock


def free_port() -> int:
    """Return a UDP port of this machine that is free."""
    with _socket() as sock:
        return int(sock.getsockname()[1])


class Relay(threading.Thread):
    """Relay of the radio link: the autopilot on one side, `port` on the other.

    `state` is open, cut (lost) or frozen (late).
    """

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self.state = "open"
        self._inner, self._outer = _socket(), _socket()
        self.autopilot = int(self._inner.getsockname()[1])
        self._port, self._vehicle = port, ("127.0.0.1", 0)
        self._late: list[tuple[socket.socket, bytes, tuple[str, int]]] = []
        self._ending = False

    def run(self) -> None:
        """Forward packets until `end`."""
        while not self._ending:
            ready, _, _ = select.select([self._inner, self._outer], [], [], 0.05)
            for sock in ready:
                with contextlib.suppress(OSError):  # no program is bound to the other port
                    data, who = sock.recvfrom(4096)
                    self._vehicle = who if sock is self._inner else self._vehicle
                    inbound = sock is self._outer
                    to = self._vehicle if inbound else ("127.0.0.1", self._port)
                    if self.state != "cut":
                        self._late.append((self._inner if inbound else self._outer, data, to))
            while self.state == "open" and self._late:
                sock, data, to = self._late.pop(0)
                sock.sendto(data, to)

    def end(self) -> None:
        """Close both sockets."""
        self._ending = True
        self.join()
        self._inner.close()
        self._outer.close()


class Rover:
    """Simulator with its relay. `outputs` contains (monotonic time, us of output 1, us of output 3), newest last."""

    def __init__(
        self, folder: Path, parameters: Mapping[str, float] | None = None, model: str = "motorboat-skid"
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.port, self.model = folder, free_port(), model
        self._parameters = {**PARAMETERS, **(parameters or {})}
        self.outputs: list[tuple[float, int, int]] = []
        self.beats: list[tuple[float, bool, int]] = []  # monotonic time, armed, mode
        self.values: dict[str, float] = {}
        self.ekf = 0
        self._beats_as: tuple[int, int] | None = None
        self._tlogs: list[BinaryIO] = []  # the last one is written to
        self._ending = False

    def __enter__(self) -> Self:
        """Start the simulator and a listener on its first link."""
        lines = "".join(f"{name} {value:g}\n" for name, value in self._parameters.items())
        (self.folder / "boat.parm").write_text(lines, encoding="ascii")
        self.relay = Relay(self.port)
        self._ear = mavutil.mavlink_connection("udpin:127.0.0.1:0", source_system=250)
        ear = self._ear.port.getsockname()[1]
        command = [PROGRAM, "--model", self.model, "--wipe", "--defaults", "boat.parm"]
        command += ["--home", f"63.44,10.40,10,{HEADING_DEG:g}"]
        command += ["--base-port", str(free_port()), "--rc-in-port", str(free_port())]
        command += ["--serial0", f"udpclient:127.0.0.1:{ear}"]
        command += ["--serial1", f"udpclient:127.0.0.1:{self.relay.autopilot}"]
        quiet = subprocess.DEVNULL
        self.process = subprocess.Popen(command, cwd=self.folder, stdin=quiet, stdout=quiet, stderr=quiet)
        self.relay.start()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Kill the simulator."""
        self._ending = True
        self.process.kill()
        self.process.wait()
        self._thread.join()
        for tlog in self._tlogs:
            tlog.close()
        self.relay.end()
        self._ear.close()

    def _listen(self) -> None:
        beat = asked = 0.0
        while not self._ending:
            message: Any = self._ear.recv_match(blocking=True, timeout=0.1)
            now = time.monotonic()
            if message is not None and self._tlogs and message.get_type() != "BAD_DATA":
                self._tlogs[-1].write(struct.pack(">Q", round(time.time() * 1e6)) + message.get_msgbuf())
            if message is not None and message.get_srcSystem() == 1:
                self._take(message, now)
            if now - asked > 2.0 and self.beats:
                asked = now
                for name, us in (("SERVO_OUTPUT_RAW", 25_000), ("EKF_STATUS_REPORT", 500_000)):
                    number = getattr(dialect, f"MAVLINK_MSG_ID_{name}")
                    self.command(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, number, us)
            if self._beats_as is not None and now - beat > 0.5:
                beat = now
                self._ear.mav.srcSystem, self._ear.mav.srcComponent = self._beats_as
                self._ear.mav.heartbeat_send(6, 8, 0, 0, 4)

    def beat_as(self, system: int | None, component: int = 190) -> None:
        """Send the heartbeats of this ground station from now on.

        None: send no heartbeats, and send commands as the listener.
        """
        self._beats_as = None if system is None else (system, component)
        if system is None:
            self._ear.mav.srcSystem, self._ear.mav.srcComponent = 250, 0

    def _take(self, m: Any, now: float) -> None:
        if m.get_type() == "HEARTBEAT" and m.autopilot == 3:
            self.beats.append((now, bool(m.base_mode & 128), m.custom_mode))
        elif m.get_type() == "SERVO_OUTPUT_RAW":
            self.outputs.append((now, m.servo1_raw, m.servo3_raw))
        elif m.get_type() == "EKF_STATUS_REPORT":
            self.ekf = m.flags
        elif m.get_type() == "PARAM_VALUE":
            self.values[m.param_id] = m.param_value

    def record(self, path: Path, interval_us: float = 100_000) -> None:
        """Write the messages that the listener receives from now on to a tlog, with attitude, IMU and fixes at this
        interval.
        """
        for name in ("ATTITUDE", "RAW_IMU", "GPS_RAW_INT"):
            self.command(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, getattr(dialect, f"MAVLINK_MSG_ID_{name}"), interval_us)
        self._tlogs.append(path.open("wb", buffering=0))  # pymavlink does not write messages received by UDP

    def command(self, number: int, *values: float) -> None:
        """Send COMMAND_LONG as the second station."""
        self._ear.mav.command_long_send(1, 1, number, 0, *values, *[0.0] * (7 - len(values)))

    def set_parameter(self, name: str, value: float) -> None:
        """Send PARAM_SET as the second station."""
        self._ear.mav.param_set_send(1, 1, name.encode(), value, 9)

    def until(self, condition: Callable[[], bool], seconds: float, awaited: str) -> None:
        """Wait for a condition. Raise TimeoutError if it does not hold in time."""
        deadline = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > deadline:
                raise TimeoutError(f"{awaited}: not in {seconds:g} s ({self.outputs[-1:]}, {self.beats[-1:]})")
            time.sleep(0.02)

    def until_ready(self) -> None:
        """Wait until the estimator has a position. Until then the simulation runs faster than real time."""

        def ready() -> bool:
            return self.ekf & READY == READY and not self.ekf & 128

        if not ready():
            self.until(lambda: bool(self.beats), 20.0, "a heartbeat")
            self.set("SIM_SPEEDUP", HURRY)
            try:
                self.until(ready, 90.0, "the estimator")
            finally:
                self.set("SIM_SPEEDUP", 1.0)

    def set(self, name: str, value: float) -> None:
        """Set one parameter and wait for its confirmation."""
        self.values.pop(name, None)

        def received() -> bool:
            self._ear.mav.param_set_send(1, 1, name.encode(), value, 9)
            time.sleep(0.2)
            return abs(self.values.get(name, 1e9) - value) < 1e-3 * max(1.0, abs(value))

        self.until(received, 5.0, name)

    def get(self, name: str) -> float:
        """Return the value of one parameter."""
        self.values.pop(name, None)

        def received() -> bool:
            self._ear.mav.param_request_read_send(1, 1, name.encode(), -1)
            time.sleep(0.1)
            return name in self.values

        self.until(received, 5.0, name)
        return self.values[name]

    def sign(self, key: bytes) -> None:
        """Turn on signing.

        From now on the autopilot accepts only signed frames on all links except this listener's link.
        """
        for _ in range(3):
            stamp = int((time.time() - 1_420_070_400) * 1e5)
            self._ear.mav.setup_signing_send(1, 1, key, stamp)
            time.sleep(0.1)

    @property
    def armed(self) -> bool:
        """Return whether the newest heartbeat reports the vehicle as armed."""
        return bool(self.beats) and self.beats[-1][1]

    @property
    def pushes(self) -> bool:
        """Return whether an output is away from neutral."""
        return bool(self.outputs) and _away(self.outputs[-1])

    def first_push(self) -> float:
        """Return the time at which the outputs last left neutral."""
        k = len(self.outputs)
        while k and _away(self.outputs[k - 1]):
            k -= 1
        return self.outputs[k][0]

    def neutral_after(self, t: float) -> float:
        """Return the time [s] from `t` (monotonic) to the first of the neutral outputs that end the record; inf if
        there are none.
        """
        rows = [row for row in self.outputs if row[0] > t]
        pushing = [k for k, row in enumerate(rows) if _away(row)]
        k = pushing[-1] + 1 if pushing else 0
        return rows[k][0] - t if k < len(rows) else float("inf")

    def last_push_after(self, t: float) -> float:
        """Return the time [s] from `t` (monotonic) to the last output away from neutral; 0 if there is none."""
        return max((row[0] - t for row in self.outputs if row[0] > t and _away(row)), default=0.0)


def _away(row: tuple[float, int, int]) -> bool:
    return any(abs(us - 1500) > NEUTRAL_US for us in row[1:] if us)
