"""Tests with a real ArduPilot Rover in its own simulator on loopback: logged, checked and driven by the public
commands.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from seatrial.daq.config.rig_file import load_rig
from seatrial.daq.drivers.base import DISARMED
from seatrial.daq.log.reader import open_log
from seatrial.daq.protocol.mavlink import MavlinkDecoder, SampleConverter
from seatrial.daq.samples import Ahrs, Gnss, Servo
from tests.bench.autopilot_faults import FAULTS, SETTINGS, link_test, ready_rover, start, try_fault, try_parameter
from tests.daq.ardurover import HEADING_DEG, MISSING, PROGRAM, RIG, Rover

FORCED = 21196.0  # param2 of a forced arming
FAILSAFE_S = 8.0  # time after the last heartbeat of a ground station: FS_GCS_TIMEOUT, FS_TIMEOUT and 1.5 s
BUSY_S = 0.3  # longer than on an idle machine
pytestmark = [pytest.mark.slow, pytest.mark.skipif(not PROGRAM, reason=MISSING)]


@pytest.fixture(scope="module")
def rover(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rover]:
    """Yield a boat at rest in MANUAL, disarmed, without a transmitter."""
    with Rover(tmp_path_factory.mktemp("sitl"), {"SIM_RC_FAIL": 1}) as rover:
        yield rover


@pytest.fixture(scope="module")
def signed() -> Iterator[tuple[Path, Rover]]:
    """Yield a boat with a signed link and without a transmitter, and a mission for it."""
    with ready_rover(SETTINGS[3]) as found:
        yield found


@pytest.fixture(scope="module")
def measured(signed: tuple[Path, Rover]) -> float:
    """Return the time that the link test measures [s]."""
    return link_test(signed[0])


@pytest.fixture
def port(rover: Rover, tmp_path: Path) -> int:
    """Return the port on which the boat is received."""
    rover.until(lambda: bool(rover.beats), 20.0, "a heartbeat")
    return rover.port


def test_a_log_does_not_send_to_a_real_autopilot(tmp_path: Path, port: int) -> None:
    (tmp_path / "rig.toml").write_text(RIG.format(port=port, more=""), encoding="utf-8")
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
    (tmp_path / "rig.toml").write_text(RIG.format(port=port, more=""), encoding="utf-8")
    command = [sys.executable, "-m", "seatrial", "log", "rig.toml", "--duration", "7", "-o", "run.mcap"]
    command += ["--request-rates"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    with open_log(tmp_path / "run.mcap") as log:
        ahrs = log.table(Ahrs, "autopilot")  # ATTITUDE with RAW_IMU, 25 Hz after the request of rates
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


def test_a_fix_that_a_real_autopilot_loses_is_reported(tmp_path: Path, rover: Rover) -> None:
    """Without a fix the time of the fix stands still, at 0 since boot.

    The samples are neither duplicates nor do they have a device time.
    """
    rover.until(lambda: bool(rover.beats), 20.0, "a heartbeat")
    rover.record(tmp_path / "run.tlog", 200_000)
    rover.until_ready()
    rover.set("SIM_GPS1_ENABLE", 0.0)
    try:
        time.sleep(5.0)
    finally:
        rover.set("SIM_GPS1_ENABLE", 1.0)
    decoder, data = MavlinkDecoder(SampleConverter()), (tmp_path / "run.tlog").read_bytes()
    fixes = [f for f in decoder.feed(data, 0.0) if isinstance(f.sample, Gnss)]
    kinds = [f.sample.fix for f in fixes if isinstance(f.sample, Gnss)]
    lost = len(kinds) - kinds[::-1].index(0) - 1
    assert max(kinds[:lost]) >= 3
    assert all(np.isnan(f.t_device) == (kind == 0) for f, kind in zip(fixes, kinds, strict=True))
    times = [f.t_device for f in fixes if np.isfinite(f.t_device)]
    assert times == sorted(times)


@pytest.mark.study
def test_the_rig_that_devices_writes_passes_the_check(tmp_path: Path, port: int, rover: Rover) -> None:
    address = f"udp:127.0.0.1:{port}"
    rover.until_ready()
    done = subprocess.run(
        [sys.executable, "-m", "seatrial", "devices", address, "--toml"], capture_output=True, text=True, check=True
    )
    (tmp_path / "rig.toml").write_text(done.stdout, encoding="utf-8")
    (tmp_path / "wanted.toml").write_text(RIG.format(port=port, more=""), encoding="utf-8")
    found, wanted = (load_rig(tmp_path / name).thrusters for name in ("rig.toml", "wanted.toml"))
    assert [(t.name, t.node, t.output) for t in found] == [(t.name, t.node, t.output) for t in wanted]
    command = [sys.executable, "-m", "seatrial", "check", "rig.toml", "--json"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    reported = json.loads(done.stdout)["findings"]
    assert [f for f in reported if f["level"] != "ok"] == []
    assert any("ArduPilot Rover" in f["text"] for f in reported)


def test_the_end_of_a_log_does_not_drive_the_boat_home(tmp_path: Path, port: int, rover: Rover) -> None:
    """With FS_ACTION 1 an armed boat drives home 6.5 s after the last heartbeat of a ground station."""
    (tmp_path / "rig.toml").write_text(RIG.format(port=port, more=""), encoding="utf-8")
    before = rover.get("FS_ACTION")
    rover.until_ready()
    rover.set("SIM_RC_FAIL", 0.0)  # without a receiver the boat would hold at once
    rover.set("FS_ACTION", 1.0)
    try:
        rover.command(400, 1.0, FORCED)
        rover.until(lambda: rover.armed, 10.0, "armed")
        for words in ("check rig.toml", "log rig.toml --duration 4 --request-rates -o run.mcap"):
            begun = time.monotonic()
            command = [sys.executable, "-m", "seatrial", *words.split()]
            done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
            assert "armed, a transmitter is received" in done.stdout or "log" in words, done.stdout
            time.sleep(FAILSAFE_S)
            manual = {(True, 0)}  # armed state and mode
            assert {(armed, mode) for t, armed, mode in rover.beats if t > begun} == manual, words
            assert not rover.pushes, words
    finally:
        rover.command(400, 0.0, FORCED)
        rover.command(176, 1.0, 0.0)
        rover.set("FS_ACTION", before)
        rover.set("SIM_RC_FAIL", 1.0)
        rover.until(lambda: not rover.armed, 10.0, "disarmed")


@pytest.mark.usefixtures("measured")
def test_a_refusal_to_arm_states_its_reason(signed: tuple[Path, Rover]) -> None:
    folder, rover = signed
    rover.set("BATT_ARM_VOLT", 20.0)
    with start(folder) as run:
        _, err = run.communicate(timeout=60)
    rover.set("BATT_ARM_VOLT", 0.0)
    assert run.returncode == 1
    assert "below minimum arming voltage" in err


@pytest.mark.parametrize(
    ("name", "message"),
    [
        pytest.param("acquisition killed", DISARMED, marks=pytest.mark.study),
        ("link cut for 8 s", "thrust is zero"),
    ],
)
def test_a_fault_on_a_signed_link_ends_thrust_and_disarms(
    signed: tuple[Path, Rover], measured: float, name: str, message: str
) -> None:
    folder, rover = signed
    (fault,) = [fault for fault in FAULTS if fault.name == name]
    trial = try_fault(folder, rover, fault, SETTINGS[3], measured)
    assert trial.seconds < trial.allowed + BUSY_S, trial
    assert trial.disarmed
    assert json.loads((folder / "rig.link-test.json").read_text())["devices"]["autopilot"]["receiver"] is False
    assert message in trial.message


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("FS_ACTION", 1.0),
        *(pytest.param(*case, marks=pytest.mark.study) for case in (("RC_OPTIONS", 34.0), ("MOT_THR_MIN", 40.0))),
    ],
)
def test_a_wrong_parameter_is_refused_or_ended(signed: tuple[Path, Rover], name: str, value: float) -> None:
    folder, rover = signed
    trial = try_parameter(folder, rover, name, value, SETTINGS[3])
    assert trial._replace(allowed=trial.allowed + BUSY_S).good, trial


def test_an_unsigned_rig_gets_a_message_about_the_signature(signed: tuple[Path, Rover]) -> None:
    folder, _ = signed
    rig = (folder / "rig.toml").read_text(encoding="utf-8").replace('key_file = "key"\n', "")
    (folder / "unsigned.toml").write_text(rig, encoding="utf-8")
    command = [sys.executable, "-m", "seatrial", "check", "unsigned.toml", "--json"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert any("no key_file" in f["text"] for f in json.loads(done.stdout)["findings"] if f["level"] == "fault")
