"""Kinds of fault that can end a run: the time within which thrust has to be zero, and the expected message."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from seatrial.bench.execution.safety_guard import COAST_S, FROZEN_S
from seatrial.daq.acquisition.watchdog import ANSWER_S, HANG_S
from seatrial.daq.config.mission_file import Mission, Segment, save_mission
from seatrial.daq.protocol.vesc import STALE

SPEED = 4.0
# All times are in wall seconds.
DEADMAN_S = 0.25
ESC_S = 1.0  # the time-out of the controllers themselves
STALE_S = 1.0  # time until a silent device is detected
GUARD_S = 0.2  # one sample, one status and one poll of the guard
SLOW_S = 0.2 / SPEED  # interval between samples of temperature, voltage and position
AFTER_DECISION_S = 0.1
BLINK_S = 0.3  # duration of a short disconnection
PAUSE_S = 0.4  # duration for which all programs are stopped: shorter than the time-out of the controllers
ZERO_AT_S = 2.0  # time of the zero command in missions whose thruster ignores zero
STEP_S = 0.5  # step duration of the missions that alternate
REOPEN_S = 0.5  # time until a port that has returned is open again
VESC, DRONECAN, MAVLINK = RIGS = "VESC", "DroneCAN", "MAVLink"
DISK = "disk"  # a file system of a few megabytes in the folder, for the trials that fill it

SENSORS = """
[[device]]
name = "ahrs"
protocol = "vectornav"
port = "ports/ahrs"
rate_hz = 50.0

[[device]]
name = "gnss"
protocol = "nmea"
port = "ports/gnss"
rate_hz = 5.0

"""  # the boat behind an autopilot also has its own sensors
LOADCELL = """
[[device]]
name = "loadcell"
protocol = "loadcell"
port = "ports/loadcell"
rate_hz = 80.0
[device.calibration]
newton_per_count = 0.001
zero_counts = 84210.0

"""
LIMITS = "[limits]\nroll_deg = 60.0\n"


@dataclass(frozen=True)
class Kind:
    """Kind of fault: how it is caused, the time within which thrust has to be zero, and the expected message."""

    what: str
    within_s: float  # wall, from the fault to the decision
    pattern: str  # regular expression that an event of the log or the note of the watchdog has to match
    fault: str = ""  # fault of the mock, started by SIGUSR1
    strike: Callable[[Any], None] | None = None  # action on the processes
    rig: str = VESC
    full: bool = False
    cut_off: bool = False  # no command can reach the thrusters: only their own time-out is left
    stays: bool = False  # the thruster ignores zero: the run has to end, and to report that zero was not confirmed
    alternates: bool = False  # the mission changes its commands every STEP_S

    @property
    def name(self) -> str:
        """Return the name of the fault with its rig."""
        return f"{self.rig}, {self.what}"

    @property
    def words(self) -> list[str]:
        """Return the further options of the run's command."""
        return ["--arm"] if self.rig == MAVLINK else []

    @property
    def lasts_s(self) -> float:
        """Return the duration of the fault in the mock [wall s]."""
        return float(self.fault.rpartition(":")[2]) / SPEED if self.fault else 0.0


def _signalled(number: signal.Signals, *who: str) -> Callable[[Any], None]:
    def strike(run: Any) -> None:
        for process_name in who:
            os.kill(getattr(run, process_name), number)

    return strike


def _fill(run: Any) -> None:
    with contextlib.suppress(OSError), (run.folder / DISK / "filler").open("wb") as file:
        while True:
            file.write(bytes(1 << 16))


def _delete(run: Any) -> None:
    """Delete the log. It stays readable through the file descriptors that are still open."""
    run.deleted = run.log.open("rb")
    run.log.unlink()


def _twice(run: Any) -> None:
    os.kill(run.pid, signal.SIGINT)
    time.sleep(0.05)  # as fast as a person presses keys
    with contextlib.suppress(ProcessLookupError):
        os.kill(run.pid, signal.SIGINT)


def _paused(run: Any) -> None:
    """Stop all programs, as a busy hypervisor does, and continue them. The trial counts from then on."""
    everybody = (run.watchdog, run.acquisition, run.pid)
    for pid in everybody:
        os.kill(pid, signal.SIGSTOP)
    time.sleep(PAUSE_S)
    for pid in everybody:
        os.kill(pid, signal.SIGCONT)


def _of(rig: str) -> Iterator[Kind]:
    """Return all kinds of fault of a rig."""
    link = "autopilot" if rig == MAVLINK else "esc"
    kill, hang = signal.SIGKILL, signal.SIGSTOP
    yield Kind("runner killed", DEADMAN_S, "parent", strike=_signalled(kill, "pid"))
    yield Kind("runner hangs", DEADMAN_S, "runner|parent", strike=_signalled(hang, "pid"))
    yield Kind("acquisition killed", 0.1, "process died", strike=_signalled(kill, "acquisition"))
    yield Kind("acquisition hangs", HANG_S, "no sign of life", strike=_signalled(hang, "acquisition"))
    yield Kind("acquisition SIGTERM", 0.1, "SIGTERM", strike=_signalled(signal.SIGTERM, "acquisition"))
    yield Kind("both killed", 0.1, "process died", strike=_signalled(kill, "acquisition", "pid"))
    yield Kind("watchdog killed", 0.1, "watchdog is gone", strike=_signalled(kill, "watchdog"))
    yield Kind("watchdog hangs", ANSWER_S, "watchdog has not answered", strike=_signalled(hang, "watchdog"))
    yield Kind("hang-up (SIGHUP)", 0.1, "SIGHUP", strike=_signalled(signal.SIGHUP, "pid"))
    yield Kind("Ctrl-C twice", 0.1, "Ctrl-C", strike=_twice)
    yield Kind("log deleted", 0.2, "log was deleted", strike=_delete)
    # the next flush detects it, 0.25 s later at most
    yield Kind("disk full", 0.6, "disk is full", strike=_fill, full=True)
    yield Kind("link pulled", ESC_S, link, fault=f"pull/{link}@usr1:8", cut_off=True)
    if rig != MAVLINK:  # a program does not see an unplugged network cable
        blink = f"pull/{link}@usr1:{BLINK_S * SPEED}"
        yield Kind("link out for 0.3 s", BLINK_S + REOPEN_S, link, fault=blink, cut_off=True)
        lasts = 3 * STALE_S + (STALE / SPEED if rig == VESC else 0.0)
        pattern = "temperature.* not watched any more"
        yield Kind("temperature not reported", lasts + GUARD_S, pattern, fault=f"mute/{link}@usr1:16")
    yield Kind("link silent", STALE_S + GUARD_S, f"{link}.* silent", fault=f"silence/{link}@usr1:8")
    yield Kind("link garbled", STALE_S + GUARD_S, f"{link}.* silent", fault=f"garbage/{link}@usr1:8")
    yield Kind("controller dead", STALE_S + GUARD_S, "left .*silent|for (thruster )?left", fault="esc-dead/left@usr1:8")
    frozen = STEP_S + FROZEN_S / SPEED + GUARD_S + 2 * SLOW_S
    if rig != MAVLINK:
        ends = ZERO_AT_S + COAST_S / SPEED + 0.25 + GUARD_S
        yield Kind("controller stuck", ends, "ignores commands", fault="esc-stuck/left@usr1:48", stays=True)
        yield Kind("telemetry frozen", frozen, "repeats the same", fault="stuck/esc@usr1:24", alternates=True)
        yield Kind("frames refused", ESC_S, "refused 10 frames", fault="refuse/esc@usr1:16", cut_off=True)
    yield Kind("load cell frozen", frozen, "loadcell repeats", fault="stuck/loadcell@usr1:24", alternates=True)
    # The fault applies to every receiver: an autopilot has its own receiver, which would replace the faulty one.
    yield Kind("position held", 10.0 / SPEED + GUARD_S, "repeats the same value", fault="hold@usr1:48")
    yield Kind("all stopped for 0.4 s", 0.0, "stood still|has not responded", strike=_paused)
    yield Kind("AHRS lost", GUARD_S, "ahrs .*lost", fault="pull/ahrs@usr1:8")
    yield Kind("GNSS lost", STALE_S + 5 * SLOW_S + GUARD_S, "gnss .*silent", fault="silence/gnss@usr1:8")
    yield Kind("load cell lost", GUARD_S, "loadcell .*lost", fault="pull/loadcell@usr1:8")
    yield Kind("too much force", GUARD_S, "force is", fault="overload/loadcell@usr1:3")
    yield Kind("too much current", GUARD_S, "current of node", fault=f"overload/{link}@usr1:3")
    yield Kind("too hot", GUARD_S + SLOW_S, "temperature of node", fault=f"hot/{link}@usr1:4")
    yield Kind("battery empty", GUARD_S + SLOW_S, "voltage of node|battery of", fault=f"flat/{link}@usr1:4")
    yield Kind("out of the fence", GUARD_S + SLOW_S, "from the start", fault="away/gnss@usr1:4")
    yield Kind("capsized", GUARD_S, "roll is", fault="capsize/ahrs@usr1:3")


KINDS = tuple(replace(kind, rig=rig) for rig in RIGS for kind in _of(rig))


def write_files(folder: Path, kind: Kind) -> None:
    """Write the rig of a kind and a mission of steps. The rig is slower than the demo and has a few more limits."""
    name = "mavboat" if kind.rig == MAVLINK else "boat"
    text = files("seatrial.mocks").joinpath("rigs", f"{name}.toml").read_text(encoding="utf-8")
    text = re.sub(r"speed = [\d.]+", f"speed = {SPEED}", text)
    text = re.sub(r"timeout_s = [\d.]+", f"timeout_s = {ESC_S * SPEED}", text)
    text = text.replace("[limits]\n", f"{LIMITS}force_n = 60.0\n").replace("[log]\n", "[log]\nfree_mb = 1.0\n")
    if kind.rig == DRONECAN:
        text = text.replace('protocol = "vesc"', 'protocol = "dronecan"')
    text = text.replace(":14550", f":{_free_port()}")
    sensors = SENSORS + LOADCELL if kind.rig == MAVLINK else LOADCELL
    text = text.replace("[[thruster]]", f"{sensors}[[thruster]]", 1)
    (folder / "rig.toml").write_text(text, encoding="utf-8")
    rows = (Segment("steps", np.array([0.5, 40.0]), np.array([[0.5, 0.4], [0.3, 0.5]])),)
    if kind.stays:
        rows = (Segment("steps", np.array([0.5, ZERO_AT_S * SPEED]), np.array([[0.6, 0.4], [0.0, 0.0]])),)
    if kind.alternates:
        t = 0.5 + STEP_S * SPEED * np.arange(38.0)
        n = np.where(np.arange(38)[:, None] % 2 == 0, [[0.6, 0.15]], [[0.15, 0.6]])
        rows = (Segment("steps", t, n),)
    save_mission(Mission("trial", "mission", ("left", "right"), rows, 80.0), folder / "mission.toml")


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])
