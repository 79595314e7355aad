"""Short missions as separate processes, so that tests can interrupt, stop and kill them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from seatrial.daq.config.mission_file import Mission, Segment, save_mission
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Command
from tests.bench.standin import StandIn, until

SPEED = 4.0
# Wall seconds from a stop to the last command: a poll, a message to the acquisition and a frame, on a machine that runs
# other programs too.
AT_ONCE_S = 0.5
DEADMAN_S = 0.25


def short_mission(folder: Path, n: float = 0.6, seconds: float = 8.0) -> Mission:
    """Write a short mission: rest, two steps, rest. By default it takes 14 run seconds."""
    segments = (
        Segment("static", np.array([0.0]), np.zeros((1, 1))),
        Segment("steps", np.array([3.0, 3.0 + seconds / 2]), np.array([[n], [-n / 2]])),
        Segment("static", np.array([3.0 + seconds]), np.zeros((1, 1))),
    )
    mission = Mission("short", "steps", ("left",), segments, 6.0 + seconds, n_max=0.9)
    save_mission(mission, folder / "mission.toml")
    return mission


# The command waits long for missing devices. Here the devices exist from the start, so wait only briefly.
IMPATIENT = """
import sys
from seatrial import command_line
from seatrial.bench.execution import autopilots, device_startup
from seatrial.daq.acquisition import session
device_startup.AWAIT_S = autopilots.LEAVE_S = session.WATCHDOG_S = 3.0
command_line.main(sys.argv[1:])
"""
MISSION_RUN = ("mission", "run", "mission.toml", "bench-rig.toml")


class Run:
    """`seatrial mission run`, or another command that drives thrusters, as a process."""

    def __init__(
        self, folder: Path, words: Sequence[str] = MISSION_RUN, impatient: bool = False, out: str = "run.mcap"
    ) -> None:
        self.log = folder / out
        program = ["-c", IMPATIENT] if impatient else ["-m", "seatrial"]
        self.process = subprocess.Popen(
            [sys.executable, *program, *words, "-o", out],
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self.out, self.err = "", ""

    def end(self, seconds: float = 40.0) -> int:
        """Wait for the end and return the exit status."""
        self.out, self.err = self.process.communicate(timeout=seconds)
        return self.process.returncode

    def until_turning(self, standin: StandIn) -> None:
        """Wait until the thruster turns. If the run ends before, fail with its output."""
        until(lambda: standin.n != 0.0 or self.process.poll() is not None, 20.0)
        assert self.process.poll() is None, self.process.communicate()

    def line(self) -> str:
        """Return the text on stderr after checking that it is a single line without a traceback.

        If it says that the propellers may turn, the path of the log has to stand on a second line.
        """
        two = self.err.startswith(("seatrial: MAKE SURE ", "seatrial: THRUST CONTINUES "))
        assert self.err.count("\n") == 1 + two, self.err
        assert not two or self.err.splitlines()[1].startswith("seatrial: the log "), self.err
        assert "Traceback" not in self.err
        return self.err.strip()


@contextmanager
def running(
    folder: Path, words: Sequence[str] = MISSION_RUN, impatient: bool = False, out: str = "run.mcap"
) -> Iterator[Run]:
    run = Run(folder, words, impatient, out)
    try:
        yield run
    finally:
        if run.process.poll() is None:
            run.process.kill()
        run.process.wait()
        for stream in (run.process.stdout, run.process.stderr):
            if stream is not None:
                stream.close()


def acquisition_of(runner: int) -> int:
    """Return the process id of the runner's child that acquires."""
    return _child_of(runner, "seatrial.daq.acquisition.process")


def watchdog_of(runner: int) -> int:
    """Return the process id of the runner's child that is the watchdog."""
    return _child_of(runner, "seatrial.daq.acquisition.watchdog")


def _child_of(runner: int, module: str) -> int:
    out = subprocess.run(["ps", "-wweo", "pid=,ppid=,args="], capture_output=True, text=True, check=True).stdout
    rows = [line.split(maxsplit=2) for line in out.splitlines()]
    (child,) = [int(pid) for pid, parent, args in rows if int(parent) == runner and f"-m {module}" in args]
    return child


def assert_plan_was_run(log: Path, mission: Mission, node: int = 1) -> int:
    """Check that each set-point of a one-thruster plan was sent in order or reported as skipped.

    Return the number skipped.
    """
    with open_log(log) as opened:
        sent = opened.table(Command, "esc", node=node)["n_cmd"].tolist()
        skipped = sum(int(text.split()[0]) for _, kind, text in opened.events() if kind == "skipped")
    planned = mission.setpoints()[1][:, 0].tolist()
    ahead, missed = iter(sent), 0
    n = next(ahead)
    for k, level in enumerate(planned):
        if abs(n - level) < 1e-4:
            n = next(ahead, np.nan)
        else:
            missed += 1
            assert k < len(planned) - 1, "the zero at the end was not sent"
    rest = [n, *ahead]
    assert missed == skipped, f"{missed} set-points were not sent, {skipped} are reported"
    assert not any(level > 0 or level < 0 for level in rest), "more was sent than planned"
    return missed


def kinds(log: Path) -> list[str]:
    return [kind for _, kind, _ in open_log(log).events()]


def is_alive(pid: int) -> bool:
    if Path("/proc/self/stat").exists():  # repeated calls of `ps` would load a busy machine
        try:
            state = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2]
        except OSError:
            return False
        return state.split()[0] not in ("Z", "X")
    out = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True, check=False).stdout
    return bool(out.strip()) and not out.strip().startswith("Z")
