"""What can end a run: kinds of fault, within what time after each thrust has to be zero, and what is to be said."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from daq.acquisition.watchdog import ANSWER_S, HANG_S
from daq.config.mission_file import Mission, Segment, save_mission

SPEED = 4.0
# Wall seconds, as all of these.
DEADMAN_S = 0.25
ESC_S = 1.0  # the controllers' own time-out
STALE_S = 1.0  # of a silent device
GUARD_S = 0.2  # a sample, a status, a look of the guard
SLOW_S = 0.2 / SPEED  # between samples of temperature, voltage and position
AFTER_DECISION_S = 0.1
DRONECAN = "boat on DroneCAN"  # the boat with other controllers
DISK = "disk"  # a file system of a few megabytes in the folder, for the trials that fill it

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
    """One thing that fails: how, within what time after it thrust has to be zero, and what has to be said."""

    name: str
    within_s: float  # wall, from the fault to the decision
    says: str  # regular expression, in an event of the log or in the watchdog's note
    fault: str = ""  # of the mock, at USR1
    strike: Callable[[Any], None] | None = None  # what is done to the processes
    rig: str = "boat"  # of those that come with the mocks
    full: bool = False
    cut_off: bool = False  # no command can reach the thrusters: only their own time-out is left

    @property
    def words(self) -> list[str]:
        """What the run is told besides."""
        return ["--arm"] if self.rig == "mavboat" else []

    @property
    def lasts_s(self) -> float:
        """How long the mock's fault goes on, wall s."""
        return float(self.fault.rpartition(":")[2]) / SPEED if self.fault else 0.0


def _signalled(who: str, number: signal.Signals) -> Callable[[Any], None]:
    def strike(run: Any) -> None:
        os.kill(getattr(run, who), number)

    return strike


def _fill(run: Any) -> None:
    with contextlib.suppress(OSError), (run.folder / DISK / "filler").open("wb") as file:
        while True:
            file.write(bytes(1 << 16))


def _twice(run: Any) -> None:
    os.kill(run.pid, signal.SIGINT)
    time.sleep(0.05)  # as fast as a hand
    with contextlib.suppress(ProcessLookupError):
        os.kill(run.pid, signal.SIGINT)


KINDS = (
    Kind("runner killed", DEADMAN_S, "parent", strike=_signalled("pid", signal.SIGKILL)),
    Kind("runner hangs", DEADMAN_S, "runner|parent", strike=_signalled("pid", signal.SIGSTOP)),
    Kind("acquisition killed", 0.1, "process died", strike=_signalled("acquisition", signal.SIGKILL)),
    Kind("acquisition hangs", HANG_S, "no sign of life", strike=_signalled("acquisition", signal.SIGSTOP)),
    Kind("watchdog killed", 0.1, "watchdog is gone", strike=_signalled("watchdog", signal.SIGKILL)),
    Kind("watchdog hangs", ANSWER_S, "watchdog has not answered", strike=_signalled("watchdog", signal.SIGSTOP)),
    Kind("hang-up (SIGHUP)", 0.1, "SIGHUP", strike=_signalled("pid", signal.SIGHUP)),
    Kind("CAN unplugged", ESC_S, "esc ", fault="pull/esc@usr1:8", cut_off=True),
    Kind("CAN silent", STALE_S + GUARD_S, "silent", fault="silence/esc@usr1:8"),
    Kind("AHRS lost", STALE_S + GUARD_S, "ahrs .*silent", fault="pull/ahrs@usr1:8"),
    Kind("GNSS lost", STALE_S + 5 * SLOW_S + GUARD_S, "gnss .*silent", fault="silence/gnss@usr1:8"),
    Kind("load cell lost", STALE_S + GUARD_S, "loadcell .*silent", fault="pull/loadcell@usr1:8"),
    Kind("too much force", GUARD_S, "force is", fault="overload/loadcell@usr1:3"),
    Kind("too much current", GUARD_S, "current of node", fault="overload/esc@usr1:3"),
    Kind("too hot", GUARD_S + SLOW_S, "temperature of node", fault="hot/esc@usr1:4"),
    Kind("battery empty", GUARD_S + SLOW_S, "voltage of node", fault="flat/esc@usr1:4"),
    Kind("out of the fence", GUARD_S + SLOW_S, "from the start", fault="away/gnss@usr1:4"),
    Kind("capsized", GUARD_S, "roll is", fault="capsize/ahrs@usr1:3"),
    Kind("disk full", 0.6, "disk is full", strike=_fill, full=True),  # the next flush meets it, 0.25 s later at most
    Kind("Ctrl-C twice", 0.1, "Ctrl-C", strike=_twice),
    Kind("MAVLink cut", ESC_S, "autopilot", fault="pull/autopilot@usr1:8", rig="mavboat", cut_off=True),
    Kind("MAVLink silent", STALE_S + GUARD_S, "autopilot.* silent", fault="silence/autopilot@usr1:8", rig="mavboat"),
    Kind("MAVLink, runner killed", DEADMAN_S, "parent", strike=_signalled("pid", signal.SIGKILL), rig="mavboat"),
    Kind("DroneCAN unplugged", ESC_S, "esc ", fault="pull/esc@usr1:8", rig=DRONECAN, cut_off=True),
    Kind("DroneCAN, runner killed", DEADMAN_S, "parent", strike=_signalled("pid", signal.SIGKILL), rig=DRONECAN),
    Kind("DroneCAN, acq. killed", 0.1, "process died", strike=_signalled("acquisition", signal.SIGKILL), rig=DRONECAN),
)


def write_files(folder: Path, kind: Kind) -> None:
    """The rig of a kind, slower than the demo and with a few limits more, and a mission of steps to run on it."""
    name = "boat" if kind.rig == DRONECAN else kind.rig
    text = files("mocks").joinpath("rigs", f"{name}.toml").read_text(encoding="utf-8")
    text = re.sub(r"speed = [\d.]+", f"speed = {SPEED}", text)
    text = re.sub(r"timeout_s = [\d.]+", f"timeout_s = {ESC_S * SPEED}", text)
    text = text.replace("[limits]\n", LIMITS).replace("[log]\n", "[log]\nfree_mb = 1.0\n")
    if kind.rig == DRONECAN:
        text = text.replace('protocol = "vesc"', 'protocol = "dronecan"')
    if kind.rig == "mavboat":
        text = text.replace(":14550", f":{_free_port()}")
    else:
        text = text.replace("[[thruster]]", LOADCELL + "[[thruster]]", 1)
        text = text.replace(LIMITS, f"{LIMITS}force_n = 60.0\n")
    (folder / "rig.toml").write_text(text, encoding="utf-8")
    rows = (Segment("steps", np.array([0.5, 40.0]), np.array([[0.5, 0.4], [0.3, 0.5]])),)
    save_mission(Mission("trial", "mission", ("left", "right"), rows, 80.0), folder / "mission.toml")


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])
