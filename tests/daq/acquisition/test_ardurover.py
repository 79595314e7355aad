"""A real ArduPilot Rover (its own simulator on loopback) logged by the public command.

SEATRIAL_ARDUROVER names the simulator's program: `ardurover`, as ArduPilot's `waf configure --board sitl; waf rover`
builds it.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from daq.log.reader import open_log
from daq.samples import Ahrs, Servo

ARDUROVER = os.environ.get("SEATRIAL_ARDUROVER")
HEADING_DEG = 40.0  # at the start
PARAMETERS = "FRAME_CLASS 2\nSERVO1_FUNCTION 73\nSERVO3_FUNCTION 74\nSERVO1_TRIM 1500\nSERVO3_TRIM 1500\n"
RIG = """\
format = "seatrial-rig 1"
name = "a simulated rover"

[[device]]
name = "autopilot"
protocol = "mavlink"
port = "udp:127.0.0.1:{port}"
rate_hz = 25.0

[[thruster]]
name = "left"
device = "autopilot"
node = 1
rc_channel = 1
position_m = [0.0, -0.15, 0.0]
timeout_s = 1.0

[[thruster]]
name = "right"
device = "autopilot"
node = 3
rc_channel = 3
position_m = [0.0, 0.15, 0.0]
timeout_s = 1.0
"""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not ARDUROVER, reason="SEATRIAL_ARDUROVER does not say where ArduPilot's simulator is"),
]


def free_ports(count: int) -> list[int]:
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    for sock in sockets:
        sock.bind(("127.0.0.1", 0))
    numbers = [int(sock.getsockname()[1]) for sock in sockets]
    for sock in sockets:
        sock.close()
    return numbers


@pytest.fixture
def port(tmp_path: Path) -> Iterator[int]:
    """The UDP port that a rover sends to: a boat at rest in MANUAL, disarmed, no transmitter."""
    assert ARDUROVER
    link, base, rc = free_ports(3)
    (tmp_path / "boat.parm").write_text(PARAMETERS, encoding="ascii")
    command = [ARDUROVER, "--model", "motorboat-skid", "--wipe", "--defaults", "boat.parm"]
    command += ["--home", f"63.44,10.40,10,{HEADING_DEG:g}", "--base-port", str(base), "--rc-in-port", str(rc)]
    command += ["--serial0", f"udpclient:127.0.0.1:{link}"]
    quiet = subprocess.DEVNULL
    with subprocess.Popen(command, cwd=tmp_path, stdin=quiet, stdout=quiet, stderr=quiet) as process:
        try:
            yield link
        finally:
            process.kill()


def test_a_log_sends_nothing_to_a_real_autopilot(tmp_path: Path, port: int) -> None:
    (tmp_path / "rig.toml").write_text(RIG.format(port=port), encoding="utf-8")
    command = [sys.executable, "-m", "seatrial", "log", "rig.toml", "--duration", "5", "-o", "run.mcap"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    with open_log(tmp_path / "run.mcap") as log:
        raw = list(log.raw("autopilot"))
        hints = [text for _, kind, text in log.events() if kind == "hint"]
    assert [data for _, direction, data in raw if direction == "rx"]
    assert not [data for _, direction, data in raw if direction == "tx"]
    assert any("--request-rates" in text for text in hints)


def test_attitude_and_outputs_of_a_real_autopilot_are_logged(tmp_path: Path, port: int) -> None:
    (tmp_path / "rig.toml").write_text(RIG.format(port=port), encoding="utf-8")
    command = [sys.executable, "-m", "seatrial", "log", "rig.toml", "--duration", "7", "-o", "run.mcap"]
    command += ["--request-rates"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    with open_log(tmp_path / "run.mcap") as log:
        ahrs = log.table(Ahrs, "autopilot")  # ATTITUDE with RAW_IMU, 25 Hz once the rates are asked for
        outputs = [log.table(Servo, "autopilot", node) for node in (1, 3)]  # SERVO_OUTPUT_RAW
        source = log.health("autopilot")[-1][1]
    assert source.checksum_errors == 0
    assert len(ahrs) > 60
    settled = ahrs[-20:]
    assert np.allclose([settled["roll"], settled["pitch"]], 0.0, atol=np.radians(3.0))
    assert np.allclose(settled["yaw"], np.radians(HEADING_DEG), atol=np.radians(10.0))
    assert np.allclose(settled["az"], -9.81, atol=0.3)
    for output in outputs:
        assert len(output) > 60
        assert np.all(output["pwm"][-20:] == 1500.0)  # disarmed: neutral
        assert np.all(output["n"][-20:] == 0.0)
