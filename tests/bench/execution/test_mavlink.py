"""Tests of missions over MAVLink with the public commands, against the mock autopilot on loopback UDP and TCP."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from seatrial.bench.execution.link_test import LinkTest, require_link_test, save_link_tests
from seatrial.daq.config.mission_file import Mission, Segment, save_mission
from seatrial.daq.config.rig_file import load_rig
from seatrial.daq.drivers.ardupilot_parameters import link_loss_hash
from seatrial.daq.drivers.base import DISARMED, LinkStatus
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Ahrs, Command, Servo
from seatrial.ident.data.loading import channels
from tests.bench.guard_replay import replay
from tests.bench.runs import IMPATIENT, acquisition_of, is_alive
from tests.bench.standin import until

SEATRIAL = [sys.executable, "-m", "seatrial"]
SPEED = 4.0
OVERRIDE_S = 1.0  # wall seconds: timeout_s of the rig divided by the speed
AT_ONCE_S = 0.5  # wall seconds, for a machine that runs other programs too
RIG = (Path(__file__).resolve().parents[3] / "mocks/rigs/mavboat.toml").read_text(encoding="utf-8")


def free_port(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])


def write_files(folder: Path, seconds: float, kind: str = "udp") -> None:
    """Write a rig with a free port and a mission: rest, both thrusters in steps, rest."""
    number = free_port(socket.SOCK_STREAM if kind == "tcp" else socket.SOCK_DGRAM)
    text = RIG.replace("udp:127.0.0.1:14550", f"{kind}:127.0.0.1:{number}")
    (folder / "rig.toml").write_text(text, encoding="utf-8")
    segments = (
        Segment("static", np.array([0.0]), np.zeros((1, 2))),
        Segment("steps", np.array([2.0, 2.0 + seconds / 2]), np.array([[0.6, 0.4], [-0.3, 0.5]])),
    )
    save_mission(Mission("short", "mission", ("left", "right"), segments, 4.0 + seconds), folder / "mission.toml")


@contextmanager
def mock(folder: Path, *words: str) -> Iterator[subprocess.Popen[str]]:
    command = [*SEATRIAL, "mock", "boat", "rig.toml", "--seed", "5", "--trace", "trace.jsonl", *words]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n", process.communicate()
            yield process
        finally:
            process.terminate()
            process.wait(timeout=10)


@contextmanager
def running(folder: Path, *words: str, impatient: bool = False) -> Iterator[subprocess.Popen[str]]:
    program = [sys.executable, "-c", IMPATIENT] if impatient else SEATRIAL
    command = [*program, "mission", "run", "mission.toml", "rig.toml", "-o", "run.mcap", *words]
    process = subprocess.Popen(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    with process:
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()


def trace(folder: Path) -> list[dict[str, Any]]:
    lines = (folder / "trace.jsonl").read_text(encoding="utf-8").splitlines()
    return [json.loads(line) for line in lines if line.endswith("}")]


def turning(folder: Path) -> bool:
    return any(now_of(folder).values())


def now_of(folder: Path) -> dict[int, float]:
    return {row["node"]: row["n"] for row in trace(folder)}


def stopped_at(folder: Path) -> float:
    """Return the wall time (monotonic, s) of the last change, after which no thruster turned."""
    until(lambda: not turning(folder), 10.0)
    return float(trace(folder)[-1]["wall"])


def until_turning(folder: Path, run: subprocess.Popen[str]) -> None:
    until(lambda: turning(folder) or run.poll() is not None, 30.0)
    assert run.poll() is None, run.communicate()


def test_a_mission_runs_and_its_reported_outputs_are_the_input_of_a_fit(tmp_path: Path) -> None:
    write_files(tmp_path, 8.0)
    with mock(tmp_path), running(tmp_path, "--arm") as run:
        out, err = run.communicate(timeout=60)
        assert run.returncode == 0, err
        assert not turning(tmp_path)
    assert "autopilot: armed" in out
    assert replay(tmp_path / "run.mcap").stop is None
    with open_log(tmp_path / "run.mcap") as log:
        assert not log.warnings
        events = [(kind, text) for _, kind, text in log.events()]
        assert ("statustext", "info: Throttle armed") in events
        assert ("statustext", "info: Throttle disarmed") in events
        assert ("parameter", "RC_OVERRIDE_TIME = 1") in events
        commands = log.table(Command, "autopilot", node=1)
        outputs = log.table(Servo, "autopilot", node=1)
        assert set(np.round(commands["n_cmd"], 3)) == {0.0, 0.6, -0.3}
        assert set(np.round(outputs["n"], 2)) == {0.0, 0.6, -0.3}
        found = channels(log)
    # The input of a fit is the output that the autopilot reports at its own rate, not the few commands.
    # Between samples the output is interpolated linearly and averaged over each step of a 10 ms grid.
    line = np.interp(outputs["t"], found["n_cmd_left"].t + 0.005, found["n_cmd_left"].value)
    assert np.abs(line - outputs["n"]).mean() < 0.003
    assert np.abs(line - outputs["n"]).max() < 0.2
    assert found["n_cmd_left"].t.size > 200 > commands.size
    stepped = outputs["t"][np.argmax(outputs["n"] > 0.5)] - commands["t"][np.argmax(commands["n_cmd"] > 0.5)]
    assert -0.05 < stepped < AT_ONCE_S * SPEED  # the mock applies a command up to one step of its plant too early
    assert found["n_left"].value.max() == pytest.approx(0.6, abs=0.05)  # shaft speed from telemetry
    assert {"x", "y", "psi", "r", "ax", "voltage_left"} <= set(found)


def test_a_disarmed_vehicle_is_not_armed_without_the_option_arm(tmp_path: Path) -> None:
    write_files(tmp_path, 8.0, "tcp")
    with mock(tmp_path), running(tmp_path) as run:
        _, err = run.communicate(timeout=60)
        assert run.returncode == 1
    assert err.startswith("seatrial: autopilot is disarmed; arm it from its transmitter, or give --arm; ")
    assert err.count("\n") == 1
    assert trace(tmp_path) == []


def test_a_wrong_parameter_is_refused_and_not_changed(tmp_path: Path) -> None:
    write_files(tmp_path, 8.0)
    rig = tmp_path / "rig.toml"
    rig.write_text(rig.read_text().replace("timeout_s = 4.0", "timeout_s = 12.0"))  # RC_OVERRIDE_TIME of the mock: 3 s
    with mock(tmp_path), running(tmp_path, "--arm") as run:
        _, err = run.communicate(timeout=60)
        assert run.returncode == 1
    assert "1 parameter forbids to drive" in err
    assert "RC_OVERRIDE_TIME is 3, wanted above 0, at most 1 s" in err
    assert trace(tmp_path) == []


@pytest.mark.parametrize("failure", ["runner killed", "link cut"])
def test_thrust_ends_if_a_process_dies_or_hangs(tmp_path: Path, failure: str) -> None:
    write_files(tmp_path, 60.0)
    impatient = failure == "link cut"  # the thrust does not return
    fault = ("--fault", "pull/autopilot@usr1:60")
    with mock(tmp_path, *fault) as devices, running(tmp_path, "--arm", impatient=impatient) as run:
        until_turning(tmp_path, run)
        acquisition = acquisition_of(run.pid)
        begun = time.monotonic()
        if failure == "link cut":
            devices.send_signal(signal.SIGUSR1)
        else:
            run.kill()
        # If no process is left to send zero, the time-out of the autopilot ends thrust.
        own = OVERRIDE_S if failure == "link cut" else 0.25
        assert stopped_at(tmp_path) - begun < own + AT_ONCE_S
        out, err = run.communicate(timeout=60)
        until(lambda: not is_alive(acquisition), 10.0)
    log = open_log(tmp_path / "run.mcap")
    assert len(log.table(Ahrs, "autopilot")) > 10
    if failure == "runner killed":
        texts = [text for _, kind, text in log.events() if kind == "stop"]
        assert any("program that started the acquisition" in text for text in texts)
        assert ("statustext", "info: Throttle disarmed") in [(kind, text) for _, kind, text in log.events()]
    else:
        message, *rest = err.splitlines()
        loud = message.startswith(("seatrial: MAKE SURE ", "seatrial: THRUST CONTINUES "))
        assert rest == ["seatrial: the log is run.mcap"] * loud, err
    if failure == "link cut":
        assert run.returncode == 3
        assert "autopilot WAS ARMED BY THIS RUN AND MAY STILL BE ARMED" in err
        assert "is disarmed" not in err
        # Disarming is tried for 10 s (here 3 s), in which the display would show the state before the end.
        assert "THE RUN ENDS: " in out
        assert "disarming autopilot takes up to 3 s. KEEP CLEAR OF THE PROPELLERS." in out
        (rest,) = [text for _, kind, text in log.events() if kind == "rest"]
        assert rest.startswith(("MAKE SURE ", "THRUST CONTINUES "))
        assert "autopilot WAS ARMED BY THIS RUN AND MAY STILL BE ARMED" in rest


def test_on_a_signed_link_the_watchdogs_zero_is_obeyed_and_confirmed(tmp_path: Path) -> None:
    write_files(tmp_path, 60.0)
    rig = tmp_path / "rig.toml"
    rig.write_text(rig.read_text().replace("system_id = 1\n", 'system_id = 1\nkey_file = "key"\n', 1))
    (tmp_path / "key").write_bytes(bytes(range(32)))
    with mock(tmp_path), running(tmp_path, "--arm") as run:
        until_turning(tmp_path, run)
        time.sleep(2.0)  # meanwhile the signature time of the autopilot advances
        begun = time.monotonic()
        os.kill(acquisition_of(run.pid), signal.SIGKILL)
        assert stopped_at(tmp_path) - begun < AT_ONCE_S
        _, err = run.communicate(timeout=60)
    assert run.returncode != 0
    assert f"autopilot: zero thrust was sent{DISARMED}" in err
    assert "MAY STILL BE" not in err


def test_a_wrong_signing_key_is_named_and_leaves_no_log(tmp_path: Path) -> None:
    write_files(tmp_path, 4.0)
    rig = tmp_path / "rig.toml"
    rig.write_text(rig.read_text().replace("system_id = 1\n", 'system_id = 1\nkey_file = "key"\n', 1))
    for key, why in ((None, "the signing key cannot be read"), (b"short", "a signing key has 32 bytes or 64")):
        if key is not None:
            (tmp_path / "key").write_bytes(key)
        with running(tmp_path, "--arm") as run:
            _, err = run.communicate(timeout=60)
        assert run.returncode == 1
        assert why in err, err
        assert not list(tmp_path.glob("run*"))


def test_ctrl_c_sends_zero_at_once_and_disarms(tmp_path: Path) -> None:
    write_files(tmp_path, 60.0)
    with mock(tmp_path), running(tmp_path, "--arm") as run:
        until_turning(tmp_path, run)
        begun = time.monotonic()
        run.send_signal(signal.SIGINT)
        assert stopped_at(tmp_path) - begun < AT_ONCE_S
        _, err = run.communicate(timeout=60)
        assert run.returncode == 130
    assert err == "seatrial: stopped by Ctrl-C; thrust is zero, autopilot is disarmed, the log is run.mcap\n"
    with open_log(tmp_path / "run.mcap") as log:
        assert ("statustext", "info: Throttle disarmed") in [(kind, text) for _, kind, text in log.events()]


def test_a_check_gets_parameters_without_acting_as_a_ground_station(tmp_path: Path) -> None:
    write_files(tmp_path, 4.0)
    with mock(tmp_path):
        done = subprocess.run(
            [*SEATRIAL, "check", "rig.toml", "--json"], cwd=tmp_path, capture_output=True, text=True, check=False
        )
    reported = json.loads(done.stdout)["findings"]
    assert not [f for f in reported if f["check"] in ("parameters", "limits", "alive") and f["level"] == "fault"], (
        reported
    )
    assert "temperature_c 80 of thruster left by autopilot" in next(
        f["text"] for f in reported if f["check"] == "limits"
    )


@pytest.mark.parametrize("kind", ["udp", pytest.param("tcp", marks=pytest.mark.study)])
def test_devices_writes_the_rig_of_the_mock_from_its_parameters(tmp_path: Path, kind: str) -> None:
    write_files(tmp_path, 4.0, kind)
    rig = load_rig(tmp_path / "rig.toml")
    with mock(tmp_path):
        words = ["devices", rig.devices[0].port, "--toml"]
        done = subprocess.run([*SEATRIAL, *words], cwd=tmp_path, capture_output=True, text=True, check=True)
    (tmp_path / "found.toml").write_text(done.stdout)
    found = load_rig(tmp_path / "found.toml")
    assert "was not answered" not in done.stdout  # every parameter that is checked has been requested
    assert [(t.name, t.node, t.output) for t in found.thrusters] == [(t.name, t.node, t.output) for t in rig.thrusters]


# the second limit is below the command of a link test, so a link test is not needed
@pytest.mark.parametrize("allowed", [pytest.param(0.3, marks=pytest.mark.study), 0.05])
def test_a_mission_with_thrust_needs_a_link_test(tmp_path: Path, allowed: float) -> None:
    write_files(tmp_path, 4.0)
    rig = tmp_path / "rig.toml"
    rig.write_text(rig.read_text().replace("link_test_n = 1.0", f"link_test_n = {allowed}"))
    with mock(tmp_path):
        with running(tmp_path, "--arm") as run:
            _, err = run.communicate(timeout=60)
        assert run.returncode == 1
        assert "a valid test of the lost link is needed: it was never done" in err
        assert trace(tmp_path) == []
        words = ["check", "rig.toml", "--actuators", "--link-test", "--yes", "--arm", "--json", "-o", "link.mcap"]
        done = subprocess.run([*SEATRIAL, *words], cwd=tmp_path, capture_output=True, text=True, check=False)
        (found,) = [f for f in json.loads(done.stdout)["findings"] if f["check"] == "link test"]
        assert (found["level"], found["code"]) == ("ok", "link-loss-ends-thrust"), done
        assert not turning(tmp_path)
        (tmp_path / "run.mcap").unlink()
        with running(tmp_path, "--arm") as run:
            _, err = run.communicate(timeout=60)
        assert run.returncode == 0, err
    kept = json.loads((tmp_path / "rig.link-test.json").read_text())["devices"]["autopilot"]
    assert kept["seconds"] == pytest.approx(OVERRIDE_S, abs=0.3)
    assert (kept["n"], kept["receiver"]) == (0.1, True)
    with open_log(tmp_path / "link.mcap") as log:
        sent = np.array([t for t, way, _ in log.raw("autopilot") if way == "tx"])
        assert np.abs(log.table(Servo, "autopilot", node=1)["n"]).max() == pytest.approx(0.1, abs=0.003)
    assert np.diff(sent).max() > kept["seconds"] * SPEED


def test_a_link_test_is_valid_if_passed_and_its_parameters_are_unchanged(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    rig = load_rig(tmp_path / "rig.toml")
    parameters = {"RC_OVERRIDE_TIME": 1.0, "FS_ACTION": 2.0, "MOT_SLEWRATE": 0.0}
    good = LinkTest(0.55, 0.1, "2026-01-01T00:00:00Z", link_loss_hash(parameters), receiver=False)
    link = LinkStatus(parameters=parameters, receiver=False)
    for test, now, why in (
        (None, link, "never done"),
        (replace(good, seconds=10.0), link, "went on for 10.00 s"),
        (good, LinkStatus(parameters={**parameters, "FS_ACTION": 5.0}, receiver=False), "have changed since 2026"),
        (replace(good, n=0.05), link, "commanded n = 0.05, which is below 0.1"),
        (
            good,
            LinkStatus(parameters=parameters, receiver=True),
            "was done with no transmitter received, and one is received now",
        ),
        (replace(good, receiver=True), link, "was done with a transmitter received, and none is received now"),
        (good, LinkStatus(parameters=parameters), "the autopilot does not report whether it receives one"),
        (
            replace(good, receiver=None),
            link,
            "the autopilot did not report on 2026-01-01T00:00:00Z whether it receives one",
        ),
    ):
        if test is not None:
            save_link_tests(rig, {"autopilot": test})
        with pytest.raises(SeatrialError, match=why):
            require_link_test(rig, "autopilot", now, 0.6)
    save_link_tests(rig, {"autopilot": good})
    more = LinkStatus(parameters={**parameters, "MOT_SLEWRATE": 9.0}, receiver=False)
    assert require_link_test(rig, "autopilot", more, 0.6) == 0.55
    (tmp_path / "rig.link-test.json").write_text("{}")
    with pytest.raises(SeatrialError, match=r"link-test\.json"):
        require_link_test(rig, "autopilot", link, 0.6)
