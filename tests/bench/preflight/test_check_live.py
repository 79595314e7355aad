"""Tests of `seatrial check RIG` against mock devices: thrusters turn only on request, and wrong wiring is named."""

from __future__ import annotations

import json
import math
import signal
import subprocess
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from seatrial.bench.demo import write_demo_rig
from seatrial.bench.mission_generators import make_mission
from seatrial.bench.preflight.cli import _confirmed_plan
from seatrial.daq.config import load_rig
from seatrial.daq.config.mission_file import save_mission
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Command
from tests.bench.execution.test_with_mocks import SEATRIAL, mock, trace, turning
from tests.bench.standin import StandIn, until
from tests.daq.logs import T0, recorder

FAST = 5.0  # ten wall seconds of actuator test


def check(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [*SEATRIAL, "check", *words]
    return subprocess.run(
        command, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=120, check=False
    )


def wired_wrongly(folder: Path) -> None:
    """Write a rig whose left and right thrusters are swapped. The boat of the mock is wired as in its own rig."""
    text = (folder / "boat-rig.toml").read_text(encoding="utf-8")
    text = text.replace('name = "left"', 'name = "was_left"').replace('name = "right"', 'name = "left"')
    (folder / "wrong.toml").write_text(text.replace('name = "was_left"', 'name = "right"'), encoding="utf-8")
    exchanged = (folder / "wrong.toml").read_text(encoding="utf-8")
    left_position, right_position = "[-0.55, -0.15, 0.0]", "[-0.55, 0.15, 0.0]"
    exchanged = (
        exchanged.replace(left_position, "PLACE")
        .replace(right_position, left_position)
        .replace("PLACE", right_position)
    )
    (folder / "wrong.toml").write_text(exchanged, encoding="utf-8")


def test_the_actuator_test_finds_swapped_sides_and_ends_at_zero(tmp_path: Path) -> None:
    with mock(tmp_path, "boat", speed=FAST):
        wired_wrongly(tmp_path)
        done = check(tmp_path, "wrong.toml", "--actuators", "--yes", "--json", "-o", "test.mcap", "--seconds", "2")
        turned = trace(tmp_path)
    assert done.returncode == 1, done.stderr
    reported = json.loads(done.stdout)["findings"]
    faults = [(f["check"], f["where"]) for f in reported if f["level"] == "fault"]
    assert ("sides", "right and left") in faults or ("sides", "left and right") in faults, reported
    assert {"rate", "noise", "limits", "disk", "delay", "dead band"} <= {f["check"] for f in reported}
    last = {row["node"]: row["n"] for row in turned}
    assert last == {1: 0.0, 2: 0.0}
    assert 0.25 < max(abs(row["n"]) for row in turned) <= 0.301
    with open_log(tmp_path / "test.mcap") as log:
        assert [log.table(Command, "esc", node)["n_cmd"][-1] for node in (1, 2)] == [0.0, 0.0]


def test_no_thruster_turns_unless_requested_and_confirmed(tmp_path: Path) -> None:
    with mock(tmp_path, "boat", "--fault", "silence/gnss@0:10000", speed=FAST):
        asked = check(tmp_path, "boat-rig.toml", "--actuators")
        assert asked.returncode == 2
        assert "give --yes" in asked.stderr
        # A preflight with a fault does not go on to turn propellers.
        done = check(tmp_path, "boat-rig.toml", "--actuators", "--yes", "--seconds", "1")
        assert done.returncode == 1
        assert "not tested, because there are faults already: repair what has a fault (gnss, " in done.stdout
        assert not trace(tmp_path)
    assert not list(tmp_path.rglob("*.mcap"))


def test_a_limit_without_a_source_is_a_fault_and_the_others_name_their_source(tmp_path: Path) -> None:
    with StandIn(tmp_path) as standin:
        standin.temperature = math.nan
        done = check(tmp_path, "bench-rig.toml", "--seconds", "1", "--json")
        with standin.rig.open("a", encoding="utf-8") as file:
            file.write('unwatched = ["temperature_c", "telemetry"]\n')
        without = check(tmp_path, "bench-rig.toml", "--seconds", "1", "--json")
    assert done.returncode == 1
    reported = [f for f in json.loads(done.stdout)["findings"] if f["check"] == "limits"]
    assert [f["level"] for f in reported] == ["fault", "ok"]
    assert "limits.temperature_c = 80 is not watched" in reported[0]["text"]
    assert "unwatched" in reported[0]["advice"]
    assert "force_n 60 by loadcell" in reported[1]["text"]
    assert "temperature_c" not in reported[1]["text"]
    reported = [f for f in json.loads(without.stdout)["findings"] if f["check"] == "limits"]
    assert [f["level"] for f in reported] == ["warning", "warning", "ok"]
    assert "telemetry of the speed controllers is not compared" in reported[1]["text"]


def test_a_log_without_samples_does_not_pass(tmp_path: Path) -> None:
    log = recorder(tmp_path / "empty.mcap")
    log.event(T0, "mark", "nothing")
    log.close()
    done = check(tmp_path, "empty.mcap", "--json")
    assert done.returncode == 1
    assert [f["level"] for f in json.loads(done.stdout)["findings"] if f["check"] == "log"] == ["fault"]


def test_ctrl_c_in_the_actuator_test_sends_zero_thrust(tmp_path: Path) -> None:
    command = [*SEATRIAL, "check", "boat-rig.toml", "--actuators", "--yes", "--seconds", "1", "-o", "test.mcap"]
    with mock(tmp_path, "boat", speed=FAST):
        test = subprocess.Popen(
            command, cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        until(lambda: (tmp_path / "trace.jsonl").exists() and turning(tmp_path), 30.0)
        test.send_signal(signal.SIGINT)
        _, stderr_text = test.communicate(timeout=30)
        until(lambda: not turning(tmp_path), 1.0)
    assert test.returncode == 130, stderr_text
    assert "thrust is zero" in stderr_text


def test_a_mission_is_checked_without_any_device(tmp_path: Path) -> None:
    write_demo_rig("boat", tmp_path, FAST)
    save_mission(make_mission("mixed", 60.0, 1), tmp_path / "mission.toml")
    done = check(tmp_path, "boat-rig.toml", "--mission", "mission.toml", "--seconds", "0.5", "--json")
    assert done.returncode == 1  # no boat is connected
    reported = {(f["check"], f["where"]): f for f in json.loads(done.stdout)["findings"]}
    assert {where for check, where in reported if check == "alive"} >= {"ahrs", "gnss", "esc"}
    assert reported["limits", "mixed, seed 1"]["level"] == "ok"
    assert "no c1" in reported["fence", "mixed, seed 1"]["text"]


def test_exchanged_ports_are_recognised_by_the_bytes(tmp_path: Path) -> None:
    with mock(tmp_path, "boat", speed=FAST):
        text = (tmp_path / "boat-rig.toml").read_text(encoding="utf-8")
        text = (
            text.replace('"ports/ahrs"', '"X"').replace('"ports/gnss"', '"ports/ahrs"').replace('"X"', '"ports/gnss"')
        )
        (tmp_path / "exchanged.toml").write_text(text, encoding="utf-8")
        done = check(tmp_path, "exchanged.toml", "--json")
    assert done.returncode == 1, done.stderr
    silent = {f["where"]: f for f in json.loads(done.stdout)["findings"] if f["code"] == "device-silent"}
    assert "are nmea (GNSS receiver or compass, NMEA 0183), not vectornav" in silent["ahrs"]["text"]
    assert "are the ports of ahrs and gnss exchanged?" in silent["ahrs"]["advice"]
    assert "are vectornav (VectorNav AHRS, ASCII and binary), not nmea" in silent["gnss"]["text"]
    assert "are the ports of gnss and ahrs exchanged?" in silent["gnss"]["advice"]


def test_a_refused_actuator_test_moves_nothing_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_demo_rig("boat", tmp_path, FAST)
    rig = load_rig(tmp_path / "boat-rig.toml")
    rig = replace(rig, limits=replace(rig.limits, n_max=0.5))
    asked: list[str] = []
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: True))
    monkeypatch.setattr("click.confirm", lambda text, **options: bool(asked.append(text)))
    with pytest.raises(SeatrialError, match="not started, nothing was moved") as refused:
        _confirmed_plan(rig, 0.6, yes=False, of_link=False)
    assert refused.value.exit_status == 1
    assert "thrusters left and right will turn, at up to n = 0.5" in asked[0]
    assert "--thrust 0.6 is beyond limits.n_max = 0.5 of boat-rig.toml: the test runs at up to n = 0.5" in (
        capsys.readouterr().err
    )
