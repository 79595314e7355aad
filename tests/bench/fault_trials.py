"""Everything that can end a run, many times each, with the mock boat: is thrust zero in time, and does the log say why?

    python -m tests.bench.fault_trials --n 100

Each trial runs a mission on the mock boat behind real ports, waits until it turns, lets one thing fail at a random
moment, and looks at when the thrusters stood (the mock's own trace) and at what the log says. Prints a table; exit
status 1 when one trial was not as it has to be.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from bench.mission import Mission, Segment, save_mission
from daq.log import open_log
from daq.stop_note import read_note
from daq.watchdog import HANG_S
from tests.bench.runs import acquisition_of, is_alive, watchdog_of

SPEED = 4.0
DEADMAN_S = 0.25  # wall, as all of these
ESC_S = 1.0  # the controllers' own time-out
STALE_S = 1.0  # of a silent device
GUARD_S = 0.2  # a sample, a status, a look of the guard
AFTER_DECISION_S = 0.1
MOCK_S = 1.0  # the mock makes good its own pauses, on a busy machine: its controllers wait so much longer
PATIENCE_S = 20.0
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
LIMITS = "[limits]\nforce_n = 60.0\nroll_deg = 60.0\n"


@dataclass(frozen=True)
class Kind:
    """One thing that fails: how, within what time after it thrust has to be zero, and what has to be said."""

    name: str
    within_s: float  # wall, from the fault; infinite where nobody knows when the fault began
    says: str  # regular expression, in an event of the log or in the watchdog's note
    fault: str = ""  # of the mock, at USR1
    strike: Callable[[Any], None] | None = None  # what is done to the processes
    full: bool = False
    cut_off: bool = False  # no command can reach the thrusters: only their own time-out is left


def _kill_runner(run: Any) -> None:
    os.kill(run.pid, signal.SIGKILL)


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
    Kind("runner killed", DEADMAN_S, "parent", strike=_kill_runner),
    Kind("runner hangs", DEADMAN_S, "runner|parent", strike=lambda r: os.kill(r.pid, signal.SIGSTOP)),
    Kind("acquisition killed", 0.1, "process died", strike=lambda r: os.kill(r.acquisition, signal.SIGKILL)),
    Kind("acquisition hangs", HANG_S, "no sign of life", strike=lambda r: os.kill(r.acquisition, signal.SIGSTOP)),
    Kind("watchdog killed", 0.1, "watchdog is gone", strike=lambda r: os.kill(r.watchdog, signal.SIGKILL)),
    Kind("CAN unplugged", ESC_S + MOCK_S, "esc ", fault="pull/esc@usr1:8", cut_off=True),
    Kind("CAN silent", STALE_S + GUARD_S, "silent", fault="silence/esc@usr1:8"),
    Kind("AHRS lost", STALE_S + GUARD_S, "ahrs .*silent", fault="pull/ahrs@usr1:8"),
    Kind("GNSS lost", STALE_S + 5 * 0.05 + GUARD_S, "gnss .*silent", fault="silence/gnss@usr1:8"),
    Kind("load cell lost", STALE_S + GUARD_S, "loadcell .*silent", fault="pull/loadcell@usr1:8"),
    Kind("too much force", GUARD_S, "force is", fault="overload/loadcell@usr1:3"),
    Kind("too much current", GUARD_S, "current of node", fault="overload/esc@usr1:3"),
    Kind("too hot", GUARD_S + 0.2 / SPEED, "temperature of node", fault="hot/esc@usr1:4"),
    Kind("battery empty", GUARD_S + 0.2 / SPEED, "voltage of node", fault="flat/esc@usr1:4"),
    Kind("out of the fence", GUARD_S + 0.2 / SPEED, "from the start", fault="away/gnss@usr1:4"),
    Kind("capsized", GUARD_S, "roll is", fault="capsize/ahrs@usr1:3"),
    Kind("disk full", 0.6, "disk is full", strike=_fill, full=True),  # the next flush meets it, 0.25 s later at most
    Kind("Ctrl-C twice", 0.1, "Ctrl-C", strike=_twice),
)


@dataclass
class Trial:
    """What came of one."""

    zero_s: float  # wall, from the fault to the last thruster at zero
    decided_s: float  # wall, from the decision to it; NaN where the decision is not in the log
    said: str
    wrong: list[str] = field(default_factory=list)


def write_rig(folder: Path) -> None:
    """The packaged boat with a load cell and a few limits more, slower than the demo."""
    text = files("mocks").joinpath("rigs", "boat.toml").read_text(encoding="utf-8")
    text = re.sub(r"speed = [\d.]+", f"speed = {SPEED}", text)
    text = re.sub(r"timeout_s = [\d.]+", f"timeout_s = {ESC_S * SPEED}", text)
    text = text.replace("[[thruster]]", LOADCELL + "[[thruster]]", 1).replace("[limits]\n", LIMITS)
    text = text.replace("[log]\n", "[log]\nfree_mb = 1.0\n")
    (folder / "rig.toml").write_text(text, encoding="utf-8")
    rows = (Segment("steps", np.array([0.5, 40.0]), np.array([[0.5, 0.4], [0.3, 0.5]])),)
    save_mission(Mission("trial", "mission", ("left", "right"), rows, 80.0), folder / "mission.toml")


@contextlib.contextmanager
def mock(folder: Path, kind: Kind) -> Iterator[subprocess.Popen[str]]:
    """A mock boat for any number of trials of one kind."""
    command = [sys.executable, "-m", "seatrial", "mock", "boat", "rig.toml", "--trace", "trace.jsonl"]
    command += ["--fault", kind.fault] if kind.fault else []
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield process
        finally:
            process.terminate()
            process.wait(timeout=10)


def _run(folder: str, log: str) -> None:
    """The runner, in a process that has everything imported."""
    import seatrial

    os.chdir(folder)
    os.setsid()
    sys.stdout = sys.stderr = open("out.txt", "w", encoding="utf-8")  # noqa: SIM115 (for the life of the process)
    seatrial.main(["mission", "run", "mission.toml", "rig.toml", "-o", log])


@contextlib.contextmanager
def small_disk(folder: Path, wanted: bool) -> Iterator[bool]:
    """A file system of 6 MB; False where this machine does not let us mount one."""
    if not wanted:
        yield True
        return
    disk = folder / DISK
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=6m", "tmpfs", str(disk)]
    if subprocess.run(mount, stderr=subprocess.DEVNULL, check=False).returncode:
        yield False
        return
    try:
        yield True
    finally:
        subprocess.run(["umount", str(disk)], check=True)


class Boat:
    """The mock's trace, read as it grows."""

    def __init__(self, folder: Path) -> None:
        self._file = (folder / "trace.jsonl").open(encoding="utf-8")
        self.n: dict[int, float] = {}
        self.zero_at = 0.0

    def close(self) -> None:
        """Let go of the trace."""
        self._file.close()

    def turning(self) -> bool:
        """Whether any thruster has thrust now."""
        for line in self._file:
            row = json.loads(line)
            self.n[row["node"]] = row["n"]
            self.zero_at = row["wall"]
        return any(self.n.values())


def until(condition: Callable[[], bool]) -> bool:
    """Wait for it; whether it came."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.005)
    return True


@dataclass
class Running:
    """The processes of one run."""

    folder: Path
    pid: int
    acquisition: int
    watchdog: int


def trial(kind: Kind, folder: Path, devices: subprocess.Popen[str], boat: Boat, seed: int) -> Trial:
    """One run that fails at a moment drawn from `seed`."""
    log = folder / (DISK if kind.full else "") / f"run-{seed}.mcap"
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["bench.run", "bench.cli", "bench.display", "daq.log", "seatrial"])
    process = context.Process(target=_run, args=(str(folder), str(log)))
    process.start()
    assert process.pid is not None
    try:
        if not until(lambda: boat.turning() or not process.is_alive()) or not process.is_alive():
            return Trial(float("nan"), float("nan"), "", ["it never turned"])
        running = Running(folder, process.pid, acquisition_of(process.pid), watchdog_of(process.pid))
        time.sleep(random.Random(seed).uniform(0.0, 0.3))  # the moment is the point
        begun = time.monotonic()
        if kind.fault:
            devices.send_signal(signal.SIGUSR1)
        elif kind.strike is not None:
            kind.strike(running)
        wrong = [] if until(lambda: not boat.turning()) else ["thrust did not end"]
        if kind.name == "runner hangs":
            os.kill(process.pid, signal.SIGCONT)
        process.join(PATIENCE_S)
        ended = until(lambda: not is_alive(running.acquisition) and not is_alive(running.watchdog))
        wrong += [] if ended and process.exitcode is not None else ["a process stayed"]
    finally:
        if process.is_alive():
            process.kill()
            process.join()
    lines = (folder / "out.txt").read_text(encoding="utf-8").splitlines()
    line = lines[-1] if kind.full and lines else ""  # no log can say that its disk is full
    found = _judged(kind, log, begun, boat, [line, *wrong])
    for path in [*log.parent.glob(f"{log.stem}*"), log.parent / "filler"]:
        path.unlink(missing_ok=True)
    return found


def _judged(kind: Kind, log: Path, begun: float, boat: Boat, found: list[str]) -> Trial:
    line, *wrong = found
    with open_log(log) as opened:
        events = opened.events()
        origin, speed = json.loads(opened.metadata["origin"]), float(opened.metadata["speed"])
    texts = [text for _, event, text in events if event == "stop"] + [read_note(log), line]
    said = next((text for text in texts if re.search(kind.says, text)), "")
    decided = [float(text.split()[0]) for _, event, text in events if event == "decided"]
    after = boat.zero_at - (origin[0] + (decided[0] - origin[1]) / speed) if decided else float("nan")
    wrong += [] if said else [f"the log does not say why: {texts}"]
    if boat.zero_at - begun > kind.within_s + AFTER_DECISION_S:
        wrong.append(f"zero after {boat.zero_at - begun:.3f} s")
    if after > AFTER_DECISION_S and not kind.cut_off:
        wrong.append(f"zero {after:.3f} s after the decision")
    return Trial(boat.zero_at - begun, after, said, wrong)


def trials(kind: Kind, n: int, seed: int) -> list[Trial]:
    """So many of one kind, with one mock boat."""
    with tempfile.TemporaryDirectory(prefix="seatrial-faults-") as name:
        folder = Path(name)
        write_rig(folder)
        with (
            small_disk(folder, kind.full) as there,
            mock(folder, kind) as devices,
            contextlib.closing(Boat(folder)) as boat,
        ):
            if not there:
                return []
            out = []
            for k in range(n):
                out.append(trial(kind, folder, devices, boat, seed + k))
                seconds = float(kind.fault.rpartition(":")[2]) / SPEED if kind.fault else 0.0
                time.sleep(seconds)  # for the fault to be over
        return out


def row(kind: Kind, found: list[Trial]) -> str:
    """One line of the table."""
    if not found:
        return f"{kind.name:<19} not tried: no small file system can be mounted here"
    zero = np.array([t.zero_s for t in found]) * 1e3
    after = np.array([t.decided_s for t in found]) * 1e3
    good = sum(not t.wrong for t in found)
    decided = f"{np.nanmax(after):6.0f}" if np.isfinite(after).any() else "     -"
    limit = f"{1e3 * (kind.within_s + AFTER_DECISION_S):5.0f}" if np.isfinite(kind.within_s) else "    -"
    times = f"{np.nanmedian(zero):6.0f} {np.nanmax(zero):6.0f}" if np.isfinite(zero).any() else "     -      -"
    return f"{kind.name:<19} {good:4d}/{len(found):<4d} {times}  {limit} {decided}   {found[0].said[:60]}"


def main() -> None:
    """Run what was asked for and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=int, default=20, help="trials of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="kinds whose name contains this")
    options = parser.parse_args()
    print(f"{'what fails':<19} {'good':>9} {'median':>6} {'max':>6}  {'limit':>5} {'after':>6}   said")
    print(f"{'':<19} {'':>9} {'from fault to zero, ms':>20}  {'decision':>6}")
    bad = 0
    for kind in (kind for kind in KINDS if options.only in kind.name):
        found = trials(kind, options.n, options.seed)
        bad += sum(bool(t.wrong) for t in found)
        print(row(kind, found), flush=True)
        for t in found:
            for problem in t.wrong:
                print(f"    {problem}", flush=True)
    print("all as they have to be" if not bad else f"{bad} trials were not as they have to be")
    sys.exit(bool(bad))


if __name__ == "__main__":
    main()
