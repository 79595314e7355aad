"""Tests of `seatrial mock` as a separate process: ports, ESC time-out, faults, the ground-truth file, and the last
line.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import select
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import can
import pytest
import serial

from seatrial.daq.protocol import vectornav, vesc
from seatrial.daq.samples import Ahrs, Esc
from seatrial.mocks.hidden_effects.catalogue import DEMO
from seatrial.mocks.hidden_effects.realistic import realistic_with

PATIENCE = 20.0  # wall seconds allowed for a short operation


def seatrial(*words: str | Path) -> list[str]:
    return [sys.executable, "-m", "seatrial", *map(str, words)]


def run(*words: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(seatrial(*words), capture_output=True, text=True, timeout=60, check=False)


def packaged(name: str, folder: Path, speed: float = 10.0, timeout_s: float = 3.0) -> Path:
    text = (files("seatrial.mocks") / "rigs" / f"{name}.toml").read_text(encoding="utf-8")
    text = re.sub(r"(?m)^speed = \S+", f"speed = {speed}", text)
    text = re.sub(r"(?m)^timeout_s = \S+", f"timeout_s = {timeout_s}", text)
    path = folder / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return path


@contextlib.contextmanager
def mock(*words: str | Path) -> Iterator[subprocess.Popen[str]]:
    """Run the mock from its message `ready` on, end it with SIGTERM, and check that it ends without an error."""
    command = seatrial("mock", *words)
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield process
        finally:
            process.terminate()
            out, err = process.communicate(timeout=PATIENCE)
        assert (process.returncode, out) == (0, ""), err
        assert re.fullmatch(r"mock: \d+\.\d s of run time, (samples were sent|FELL BEHIND) .* ms( late|; .*)\n", err), (
            err
        )


def awaited(condition: Callable[[], Any], description: str) -> Any:
    """Return the value of ``condition`` as soon as it is true."""
    deadline = time.monotonic() + PATIENCE
    while not (value := condition()):
        assert time.monotonic() < deadline, f"waited in vain for {description}"
        time.sleep(0.005)
    return value


def ahrs_samples(port: serial.Serial, decoder: vectornav.Decoder, count: int) -> list[Ahrs]:
    """Return the next ``count`` samples."""
    samples: list[Ahrs] = []
    deadline = time.monotonic() + PATIENCE
    while len(samples) < count:
        assert time.monotonic() < deadline, f"{len(samples)} of {count} samples"
        select.select([port], [], [], 0.1)
        frames = decoder.feed(port.read(port.in_waiting), 0.0)
        samples += [f.sample for f in frames if isinstance(f.sample, Ahrs)]
    return samples


def trace(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines() if line.endswith("}")]


def drive(bus: can.BusABC, node: int, n: float) -> None:
    arbitration_id, data = vesc.encode_duty(node, n)
    bus.send(can.Message(arbitration_id=arbitration_id, data=data, is_extended_id=True))


@contextlib.contextmanager
def can_bus(rig: Path, name: str = "can") -> Iterator[can.BusABC]:
    channel = str(rig.parent / "ports" / name)
    bus = can.Bus(interface="slcan", channel=channel, bitrate=500_000, sleep_after_open=0)
    try:
        yield bus
    finally:
        bus.shutdown()


def test_an_esc_follows_its_command_and_stops_within_its_timeout(tmp_path: Path) -> None:
    rig, log = packaged("boat", tmp_path), tmp_path / "trace.jsonl"
    with mock("boat", rig, "--trace", log), can_bus(rig) as bus:
        drive(bus, 1, 0.5)
        drive(bus, 2, -0.4)
        rows = awaited(lambda: [r for r in trace(log) if r["why"] == "timeout"][1:] and trace(log), "both time-outs")
        drive(bus, 1, 0.3)
        awaited(lambda: len(trace(log)) > 4, "a command after the time-out")
    commanded = {row["node"]: row for row in rows if row["why"] == "command"}
    assert (commanded[1]["n"], commanded[2]["n"]) == (0.5, -0.4)
    for row in rows:
        if row["why"] == "timeout":
            command = commanded[row["node"]]
            assert row["n"] == 0.0
            assert row["t"] - command["t"] > 3.0 - 1e-5  # a pause of the mock itself does not count against the sender
            assert 0.3 <= row["wall"] - command["wall"] < 3.0
    assert not (tmp_path / "ports" / "can").is_symlink()


def test_a_driven_boat_moves(tmp_path: Path) -> None:
    rig = packaged("boat", tmp_path, speed=20.0)
    with mock("boat", rig), can_bus(rig) as bus, serial.Serial(str(tmp_path / "ports" / "ahrs"), timeout=0) as port:
        decoder, shafts = vectornav.Decoder(), vesc.Decoder({1: 7, 2: 7})
        rate, rpm = 0.0, {1: 0.0, 2: 0.0}
        deadline = time.monotonic() + PATIENCE
        while not (rate > 0.25 and rpm[1] > 1000.0 and rpm[2] < -1000.0):  # a turn on the spot, to starboard
            assert time.monotonic() < deadline, (rate, rpm)
            drive(bus, 1, 0.7)
            drive(bus, 2, -0.7)
            batch = ahrs_samples(port, decoder, 25)
            rate = sum(s.r for s in batch) / len(batch)
            while (message := bus.recv(0.0)) is not None:
                for frame in shafts.feed_frame(message.arbitration_id, bytes(message.data), 0.0):
                    assert isinstance(frame.sample, Esc)
                    rpm[frame.sample.node] = frame.sample.rpm


def test_a_pulled_port_vanishes_and_returns_on_schedule_and_on_the_signal(tmp_path: Path) -> None:
    rig = packaged("boat", tmp_path, speed=1.0)
    ahrs, gnss = tmp_path / "ports" / "ahrs", tmp_path / "ports" / "gnss"
    faults = ("--fault", "pull/gnss@0.3:0.5", "--fault", "pull/ahrs@usr1:0.5")
    with mock("boat", rig, *faults) as process:
        awaited(lambda: not gnss.is_symlink(), "the GNSS port to vanish")
        assert ahrs.is_symlink()
        awaited(gnss.is_symlink, "the GNSS port to return")
        with serial.Serial(str(ahrs), timeout=0) as port:
            ahrs_samples(port, vectornav.Decoder(), 5)
            process.send_signal(signal.SIGUSR1)
            awaited(lambda: not ahrs.is_symlink(), "the AHRS port to vanish")
        awaited(ahrs.is_symlink, "the AHRS port to return")
        with serial.Serial(str(ahrs), timeout=0) as port:
            assert len(ahrs_samples(port, vectornav.Decoder(), 5)) >= 5


def test_a_dead_esc_gives_neither_thrust_nor_telemetry(tmp_path: Path) -> None:
    rig, log = packaged("bench", tmp_path, timeout_s=1000.0), tmp_path / "trace.jsonl"
    words = ("bench", rig, "--trace", log, "--fault", "esc-dead/thruster@usr1")
    with mock(*words) as process, can_bus(rig, "bench_can") as bus:
        drive(bus, 1, 0.5)
        awaited(lambda: trace(log), "the command")
        assert bus.recv(PATIENCE) is not None
        process.send_signal(signal.SIGUSR1)
        assert awaited(lambda: trace(log)[1:], "the end of thrust")[0]["why"] == "dead"
        drive(bus, 1, 0.6)
        awaited(lambda: bus.recv(0.5) is None, "silence on the bus")
    assert [row["n"] for row in trace(log)] == [0.5, 0.0]


def test_the_truth_file_holds_the_hidden_effect_and_the_true_parameters(tmp_path: Path) -> None:
    truths = []
    for run_number in (0, 1):
        folder = tmp_path / str(run_number)
        folder.mkdir()
        rig, truth = packaged("boat", folder), folder / "truth" / "truth.json"
        with mock(
            *("boat", rig, "--seed", "11", "--run", str(run_number), "--effect", "draw", "--truth-file", truth)
        ) as process:
            assert process.stdout is not None
            truths.append(json.loads(truth.read_text()))
            assert stat.S_IMODE(os.stat(truth).st_mode) == 0o600
    first, second = truths
    assert first["effect"] in DEMO
    assert first["parameters"]
    assert first["minor_effects"] == []
    assert len(first["sentence"]) > 20
    assert 30.0 < first["true_parameters"]["m_u"] < 45.0
    assert (first.pop("run"), second.pop("run")) == (0, 1)
    assert first == second  # the same boat with other noise


def test_a_realistic_boat_has_small_effects_beside_the_large_one(tmp_path: Path) -> None:
    rig, truth = packaged("boat", tmp_path), tmp_path / "truth.json"
    with mock("boat", rig, "--seed", "11", "--effect", "wind", "--realistic", "--truth-file", truth):
        written = json.loads(truth.read_text())
        with serial.Serial(str(tmp_path / "ports" / "ahrs"), timeout=0) as port:
            assert len(ahrs_samples(port, vectornav.Decoder(), 5)) >= 5
    effects = realistic_with("wind", 11)
    assert written["effect"] == "wind"
    assert written["parameters"] == effects[0].parameters
    small = [{"effect": e.name, "parameters": e.parameters, "sentence": e.sentence} for e in effects[1:]]
    assert written["minor_effects"] == small


def test_two_mocks_do_not_share_a_port(tmp_path: Path) -> None:
    rig = packaged("bench", tmp_path)
    with mock("bench", rig):
        second = run("mock", "bench", rig)
        assert second.returncode == 1
        assert re.fullmatch(r"seatrial: .*another mock serves this port; stop that mock first\n", second.stderr)
        assert (tmp_path / "ports" / "loadcell").is_symlink()


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        (("boat", "nowhere.toml"), 2, r"seatrial mock boat: .*nowhere\.toml' does not exist.*\n"),
        (("boat", "{bench}"), 1, r"seatrial: .*a mock boat has two thrusters.*\n"),
        (("bench", "{boat}"), 1, r"seatrial: .*a mock bench has one thruster; this rig has 2: give another rig\n"),
        (("boat", "{boat}", "--fault", "fire@3"), 1, r"seatrial: --fault fire@3: no fault 'fire'.*\n"),
        (("boat", "{boat}", "--effect", "magic"), 2, r"(?s).*'magic' is not one of.*"),
        (("bench", "{bench}", "--realistic"), 2, r"(?s).*No such option.*--realistic.*"),
    ],
)
def test_wrong_usage_gives_a_one_line_error(tmp_path: Path, words: tuple[str, ...], status: int, message: str) -> None:
    rigs = {name: str(packaged(name, tmp_path)) for name in ("boat", "bench")}
    result = run("mock", *(word.format(**rigs) for word in words))
    assert result.returncode == status, result.stderr
    assert re.fullmatch(message, result.stderr), result.stderr
    assert not (tmp_path / "ports").exists()


@pytest.mark.parametrize("words", [("mock",), ("mock", "boat"), ("mock", "bench")])
def test_help_has_an_example(words: tuple[str, ...]) -> None:
    result = run(*words, "--help")
    assert result.returncode == 0
    assert re.search(r"Example: seatrial mock (boat|bench) \w+\.toml", result.stdout)


def test_a_mock_boat_says_where_its_geometry_differs_from_that_of_the_rig(tmp_path: Path) -> None:
    path = packaged("boat", tmp_path)
    text = path.read_text(encoding="utf-8").replace("[-0.55, -0.15, 0.0]", "[-0.55, -0.3, 0.0]")
    text = text.replace("lever_arm_m = [0.0, 0.0, 0.0]", "lever_arm_m = [0.4, 0.0, -0.5]")
    path.write_text(text, encoding="utf-8")
    command = seatrial("mock", "boat", path)
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.terminate()
        _, said = process.communicate(timeout=PATIENCE)
    assert "thrusters at y = -0.15 m (left) and +0.15 m (right), in the rig at -0.3 m and +0.15 m" in said
    assert "antenna of gnss at x = 0, y = 0 m, in the rig at x = +0.4, y = +0 m" in said
