"""Tests of `seatrial init`: its rig runs with simulated devices, its checklist parses, and existing files are kept."""

from __future__ import annotations

import contextlib
import os
import re
import select
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from seatrial import command_line
from seatrial.bench.preflight.rig_checks import check_defaults
from seatrial.daq.config import load_rig, parse_rig
from seatrial.daq.log import open_log
from seatrial.daq.new_rig import RigDraft, Value, drafts_of, name_devices, rig_text
from seatrial.daq.new_rig.questions import WantedDevice, parse_devices
from seatrial.daq.protocol import BUILT_IN
from seatrial.daq.samples import Ahrs, Esc, Gnss
from seatrial.daq.tools import DiscoveredAutopilot, DiscoveredDevice
from tests.bench.mock_process import mock_process
from tests.daq.tools.test_discovery import SAYS, device

DEVICES = "vectornav@ports/ahrs@921600@50,nmea@ports/gnss@115200@5,vesc@slcan:ports/can@921600@50"


def init(folder: Path, *words: str) -> str:
    """Run `seatrial init` without a terminal and return its output."""
    done = CliRunner().invoke(command_line.cli, ["init", str(folder), *words], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.output


def test_a_new_rig_runs_with_simulated_devices(tmp_path: Path) -> None:
    folder = tmp_path / "boat"
    output = init(folder, "--devices", DEVICES, "--rpm-max", "4500", "--radius-m", "300")
    assert f"seatrial check {folder / 'rig.toml'}" in output
    with mock_process(folder, "boat", "rig.toml"):
        words = [sys.executable, "-m", "seatrial", "log", "rig.toml", "--duration", "2", "--out", "logs/run.mcap"]
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
        words = [sys.executable, "-m", "seatrial", "check", "rig.toml", "--seconds", "2"]
        check = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=60)
    with open_log(folder / "logs" / "run.mcap") as log:
        assert log.sources(Ahrs) == ["ahrs"]
        assert log.sources(Gnss) == ["gnss"]
        assert len(log.sources(Esc)) >= 1
        assert list(log.events())[-1][1:] == ("end", "the duration of 2 s has ended")
    assert check.returncode == 0, check.stdout + check.stderr
    assert not [line for line in check.stdout.splitlines() if line.startswith("fault")]


@pytest.mark.parametrize(
    ("device", "line"),
    [
        ("nmea@/dev/gnss@fast", "the baud rate of 'nmea@/dev/gnss@fast': 'fast' is not a whole number"),
        ("nmea@/dev/gnss@0", "the baud rate of 'nmea@/dev/gnss@0': 0 is less than 1"),
        ("nmea@/dev/gnss@38400@often", "the rate in Hz of 'nmea@/dev/gnss@38400@often': 'often' is not a number"),
    ],
)
def test_a_wrong_number_of_a_device_is_named(device: str, line: str, tmp_path: Path) -> None:
    form = "write PROTOCOL@PORT@BAUD@HZ, such as nmea@/dev/ttyUSB1@38400@5"
    with pytest.raises(ValueError, match=f"^{re.escape(line)}; {form}$"):
        parse_devices(f"vectornav,{device}")
    done = CliRunner().invoke(command_line.cli, ["init", str(tmp_path), "--yes", "--devices", device])
    assert done.exit_code == 2
    assert line in " ".join(done.output.split())


def test_help_of_yes_says_what_it_needs() -> None:
    shown = " ".join(CliRunner().invoke(command_line.cli, ["init", "--help"]).output.split())
    assert "--yes Ask nothing; needs --devices or --from-found." in shown


def test_assumed_values_are_marked_in_the_rig(tmp_path: Path) -> None:
    init(
        tmp_path, "--name", "our boat", "--devices", "nmea@/dev/gnss@38400@5,vesc", "--thrusters", "port_side,star",
        "--nodes", "7,8", "--position-m", "star=-0.4,0.25,0.1", "--pole-pairs", "11", "--rpm-max", "3000",
        "--timeout-s", "0.5", "--lever-arm-m", "0.3,0,-0.45", "--n-max", "0.4", "--voltage-min-v", "13",
    )  # fmt: skip
    text = (tmp_path / "rig.toml").read_text()
    rig = load_rig(tmp_path / "rig.toml")
    assert rig.name == "our boat"
    gnss, esc = rig.devices
    assert (gnss.name, gnss.port, gnss.baud, gnss.rate_hz, gnss.lever_arm_m) == (
        "gnss", "/dev/gnss", 38400, 5.0, (0.3, 0.0, -0.45)
    )  # fmt: skip
    assert (esc.name, esc.port) == ("esc", "socketcan:can0")
    assert [(t.name, t.node, t.pole_pairs, t.rpm_max, t.timeout_s) for t in rig.thrusters] == [
        ("port_side", 7, 11, 3000.0, 0.5), ("star", 8, 11, 3000.0, 0.5)
    ]  # fmt: skip
    assert rig.thruster("star").position_m == (-0.4, 0.25, 0.1)
    assert (rig.limits.n_max, rig.limits.voltage_min_v, rig.limits.radius_m) == (0.4, 13.0, 50.0)
    marked = {line.split(" = ")[0] for line in text.splitlines() if "default, check" in line and " = " in line}
    assert {"port", "bitrate", "position_m", "radius_m", "current_a"} <= marked
    assert not marked & {"baud", "lever_arm_m", "node", "pole_pairs", "rpm_max", "timeout_s", "n_max", "voltage_min_v"}


def test_values_that_nobody_checked_are_a_warning_until_their_mark_is_removed(tmp_path: Path) -> None:
    init(tmp_path, "--devices", "nmea,vesc")
    path = tmp_path / "rig.toml"
    (found,) = check_defaults(load_rig(path))
    assert (found.level, found.code) == ("warning", "rig-default")
    lines = path.read_text(encoding="utf-8").splitlines()
    for name in ("left.position_m", "right.position_m", "gnss.lever_arm_m", "limits."):
        assert name in found.text
    numbers = [int(number) for number in re.findall(r"\(line (\d+)\)", found.text)]
    marked = {i: line for i, line in enumerate(lines, start=1) if "default, check" in line and " = " in line}
    assert numbers == [i for i, line in marked.items() if not line.startswith("name = ")]
    path.write_text(path.read_text(encoding="utf-8").replace("default, check", "measured"), encoding="utf-8")
    assert not list(check_defaults(load_rig(path)))


def test_every_protocol_gives_a_rig_that_is_read(tmp_path: Path) -> None:
    for protocol in BUILT_IN:
        init(tmp_path / protocol, "--devices", protocol)
        rig = load_rig(tmp_path / protocol / "rig.toml")
        assert [d.protocol for d in rig.devices] == [protocol]
        assert len(rig.thrusters) == (2 if protocol in ("vesc", "dronecan", "mavlink") else 0)


def options_of(command: click.Command, words: list[str]) -> None:
    """Parse the words of a command line as click does, without opening its files; unknown options raise."""
    context = click.Context(command, info_name=command.name)
    if isinstance(command, click.Group):
        sub = command.get_command(context, words[0])
        assert sub is not None, words
        options_of(sub, words[1:])
    else:
        command.make_parser(context).parse_args(list(words))


@pytest.mark.parametrize("kind", ["boat", "bench"])
@pytest.mark.parametrize("devices", ["vesc,nmea,loadcell", "mavlink", "dronecan,ubx", "nmea"])
def test_each_command_of_the_checklist_exists(tmp_path: Path, kind: str, devices: str) -> None:
    init(tmp_path, "--kind", kind, "--devices", devices)
    text = (tmp_path / "CHECKLIST.md").read_text()
    commands = re.findall(r"`(seatrial [^`]*)`", text)
    assert len(commands) >= 3
    for line in commands:  # a repeated line writes another log
        assert re.fullmatch(r'.* --out "logs/[\w-]+-\$\(date \+%m%d-%H%M%S\)\.mcap"|(?!.*--out logs).*', line), line
    for line in commands:
        options_of(command_line.cli, shlex.split(line)[1:])
    turning = [text.index(word) for word in ("--actuators", "seatrial bench") if word in text]
    if devices == "nmea":
        assert not turning
        assert "commands no thrust" in text
    else:
        # The kill switch and the time-outs come before the first thrust.
        assert text.index("kill switch") < min(turning)
    assert ("--link-test" in text) == (devices == "mavlink")


def test_existing_files_stay(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text("mine")
    words = ["init", str(tmp_path), "--devices", "nmea"]
    done = CliRunner().invoke(command_line.cli, words)
    assert done.exit_code == 1
    assert "exists already" in str(done.exception)
    assert (tmp_path / "rig.toml").read_text() == "mine"
    assert not (tmp_path / "CHECKLIST.md").exists()
    init(tmp_path, "--devices", "nmea", "--force")
    assert load_rig(tmp_path / "rig.toml").devices[0].protocol == "nmea"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "give the devices with --devices, --from-found or both"),
        (["--devices", "gps"], "'gps' is not a protocol; known: vectornav"),
        (["--devices", "GPS"], "; the usual ones of a device of this name are nmea and ubx"),
        (["--devices", "nmea@p@x"], "'x' is not a whole number"),
        (["--devices", "nmea@a,ubx@a"], "gnss and gnss2 have the same port"),
        (["--devices", "vesc@/dev/ttyUSB0"], "must be slcan:SERIAL or socketcan:NAME"),
        (["--devices", "nmea", "--thrusters", "left"], "--thrusters needs a device that drives thrusters"),
        (["--devices", "nmea", "--position-m", "left=0,-0.3,0"], "--position-m needs a device that drives thrusters"),
        (["--devices", "nmea", "--rpm-max", "3000"], "--rpm-max needs a device that drives thrusters"),
        (["--devices", "vesc", "--nodes", "1"], "--nodes gives 1 numbers for 2 thrusters"),
        (["--devices", "vesc", "--nodes", "1,300"], "node: must be within 0 .. 255"),
        (["--devices", "vesc", "--position-m", "aft=0,0,0"], "there is no thruster 'aft'"),
        (["--devices", "vesc", "--position-m", "left=0,0"], "is not X,Y,Z"),
        (["--devices", "loadcell", "--newton-per-count", "0"], "must be a finite number other than zero"),
    ],
)
def test_a_wrong_answer_gives_a_one_line_error_and_no_file(tmp_path: Path, words: list[str], message: str) -> None:
    folder = tmp_path / "new"
    done = CliRunner().invoke(command_line.cli, ["init", str(folder), *words])
    assert done.exit_code in (1, 2)
    assert message in (done.output if done.exit_code == 2 else str(done.exception))
    assert not folder.exists()


def test_discovered_devices_are_in_the_rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from seatrial.daq.tools import discovery

    baud, say = SAYS["nmea"]
    with device(baud, say) as port:
        monkeypatch.setattr(discovery, "list_serial_ports", lambda: [(port, "test")])
        monkeypatch.setattr(discovery, "baud_rates", lambda wanted=(): [baud])
        init(tmp_path, "--from-found", "--devices", "vesc@socketcan:can7")
    rig = load_rig(tmp_path / "rig.toml")
    assert [(d.protocol, d.port) for d in rig.devices] == [("nmea", port), ("vesc", "socketcan:can7")]
    assert rig.devices[0].baud == baud
    line = next(line for line in (tmp_path / "rig.toml").read_text().splitlines() if line.startswith("baud"))
    assert "default, check" not in line


def test_a_can_bus_that_was_found_is_the_port_of_the_controllers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    adapter = DiscoveredDevice("/dev/ttyACM3", "adapter", "slcan", 115200, says="CAN adapter")
    monkeypatch.setattr("seatrial.daq.new_rig.cli._search", lambda: [adapter])
    init(tmp_path, "--from-found", "--devices", "vesc")
    assert load_rig(tmp_path / "rig.toml").devices[0].port == "slcan:/dev/ttyACM3"
    line = next(line for line in (tmp_path / "rig.toml").read_text().splitlines() if line.startswith("port"))
    assert "default, check" in line


class Terminal:
    """Process of `seatrial init` at a terminal of its own."""

    def __init__(self, folder: Path) -> None:
        self.master, slave = os.openpty()
        words = [sys.executable, "-m", "seatrial", "init", str(folder)]
        self.process = subprocess.Popen(words, stdin=slave, stdout=slave, stderr=slave)
        os.close(slave)
        self.text = ""

    def await_text(self, words: str) -> None:
        """Read until the words appear behind the last ones, within 20 s."""
        end = time.monotonic() + 20.0
        while words not in self.text:
            assert time.monotonic() < end, self.text
            if select.select([self.master], [], [], 0.5)[0]:
                self.text += os.read(self.master, 4096).decode()
        self.text = self.text[self.text.index(words) + len(words) :]

    def answer(self, question: str, text: str) -> None:
        """Wait for a question and enter a line."""
        self.await_text(question)
        os.write(self.master, f"{text}\n".encode())


def at_terminal(test: Callable[[Terminal], None], folder: Path) -> int:
    """Run a test with a process at a terminal and return its exit status."""
    terminal = Terminal(folder)
    try:
        test(terminal)
        return terminal.process.wait(timeout=20)
    finally:
        terminal.process.kill()
        terminal.process.wait()
        os.close(terminal.master)


def test_the_questions_at_a_terminal(tmp_path: Path) -> None:
    def answers(terminal: Terminal) -> None:
        terminal.answer("boat or bench [boat]", "ship")
        terminal.await_text("'ship' is neither boat nor bench")
        terminal.answer("boat or bench [boat]", "bench")
        terminal.answer("name of the rig", "our bench")
        terminal.answer("search the ports", "n")
        terminal.answer("devices [none]", "vesc, loadcell")
        terminal.answer("port of esc (vesc) [socketcan:can0]", "can0")
        terminal.await_text("must be slcan:SERIAL or socketcan:NAME")
        terminal.answer("port of esc", "socketcan:can1")
        terminal.answer("samples per second of esc", "")
        terminal.answer("port of loadcell", "/dev/cell")
        terminal.answer("baud rate of loadcell [115200]", "9600")
        terminal.answer("samples per second of loadcell", "80")
        terminal.answer("gain of loadcell", "-0.002")
        terminal.answer("names of the thrusters", "T200")
        terminal.answer("node of T200 [1]", "300")
        terminal.answer("node of T200 [1]", "5")
        terminal.answer("position of T200", "")
        terminal.answer("pole pairs", "7")
        terminal.answer("shaft speed", "3500")
        terminal.answer("time-out", "0.5")
        for limit in ("n_max", "current_a", "temperature_c", "voltage_min_v", "force_n"):
            terminal.await_text(f"{limit}:")
            # A voltage depends on the battery: none is proposed.
            terminal.answer("[none]" if limit == "voltage_min_v" else "]", "12" if limit == "voltage_min_v" else "")
        terminal.await_text("next: read")

    assert at_terminal(answers, tmp_path / "bench") == 0
    rig = load_rig(tmp_path / "bench" / "rig.toml")
    assert (rig.name, rig.devices[0].port, rig.devices[1].rate_hz) == ("our bench", "socketcan:can1", 80.0)
    assert rig.devices[1].calibration is not None
    assert rig.devices[1].calibration.newton_per_count == -0.002
    assert (rig.thrusters[0].name, rig.thrusters[0].node, rig.limits.voltage_min_v) == ("T200", 5, 12.0)
    assert rig.limits.radius_m is None


def test_ctrl_c_at_a_question_writes_no_file(tmp_path: Path) -> None:
    def interrupt(terminal: Terminal) -> None:
        terminal.answer("boat or bench", "")
        terminal.await_text("name of the rig")
        for _ in range(20):  # a signal between the question and the wait for its answer is noticed with the next one
            terminal.process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                terminal.process.wait(timeout=0.5)
                return

    assert at_terminal(interrupt, tmp_path / "boat") == 130
    assert not (tmp_path / "boat").exists()


def test_devices_have_names_and_numbers() -> None:
    assert name_devices(["nmea", "vesc", "ubx", "own"]) == ["gnss", "esc", "gnss2", "own"]
    assert parse_devices(" nmea@/dev/a@9600@5 , vesc,") == [
        WantedDevice("nmea", "/dev/a", 9600, 5.0),
        WantedDevice("vesc"),
    ]


@pytest.mark.parametrize(
    ("parameters", "drives"), [({}, False), ({"SERVO1_FUNCTION": 73.0, "SERVO3_FUNCTION": 74.0}, True)]
)
def test_an_autopilot_drives_only_if_its_thrusters_are_known(parameters: dict[str, float], drives: bool) -> None:
    """Without parameters the text mentions [[thruster]] only in a caveat, and the rig gets no limits of thrust."""
    rover = DiscoveredAutopilot("udp:127.0.0.1:14550", "", "mavlink", vehicle="ArduPilot Rover", parameters=parameters)
    (draft,) = drafts_of([rover])
    assert draft.drives is drives
    assert bool(parse_rig(rig_text(RigDraft(Value("boat"), [draft])), Path("rig.toml")).thrusters) is drives


def test_a_line_of_the_checklist_reads_the_newest_log(tmp_path: Path) -> None:
    init(tmp_path, "--kind", "bench", "--devices", "vesc,loadcell")
    text = (tmp_path / "CHECKLIST.md").read_text()
    (tmp_path / "logs").mkdir(exist_ok=True)
    name = re.findall(r'--out ("logs/bench-\w+-[^"]*")', text)[0]
    newest = re.findall(r'ident thruster ("[^"]*")', text)[0]
    for age in (100, 0):
        log = subprocess.run(["sh", "-c", f"printf %s {name}"], cwd=tmp_path, capture_output=True, text=True).stdout
        log = log.replace(".mcap", f"{age}.mcap")
        (tmp_path / log).write_bytes(b"")
        os.utime(tmp_path / log, (time.time() - age, time.time() - age))
    found = subprocess.run(["sh", "-c", f"printf %s {newest}"], cwd=tmp_path, capture_output=True, text=True).stdout
    assert found == log
