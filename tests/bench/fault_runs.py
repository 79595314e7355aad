"""Run with one fault: the mock boat, the runner in its own process, the fault, and the outcome."""

from __future__ import annotations

import contextlib
import json
import math
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
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import IO, Any

from seatrial.daq.log.reader import open_log
from seatrial.daq.log.watchdog_note import read_note
from tests.bench.fault_kinds import AFTER_DECISION_S, DISK, Kind, write_files
from tests.bench.mock_process import mock_process
from tests.bench.runs import acquisition_of, is_alive, watchdog_of

PATIENCE_S = 20.0
POLL_S = 0.005
# No fault of a device causes this message: the machine delayed the runner.
DEADMAN = "the program that runs the mission has not responded"
MEMORY = "/dev/shm"  # a file system in memory, on Linux


@dataclass
class Trial:
    """Outcome of one trial."""

    zero_s: float = math.nan  # wall seconds from the fault to zero of the last thruster
    decided_s: float = math.nan  # wall seconds from the decision to zero thrust; NaN if the log lacks the decision
    evidence: str = ""  # event of the log or note of the watchdog that names the fault
    wrong: list[str] = field(default_factory=list)
    spoilt: str = ""  # why the run had ended before the fault: on a busy machine a deadman can end it

    def as_row(self) -> dict[str, Any]:
        """Return the trial as a row for JSON, without empty values and NaN."""
        row = asdict(self) | {"zero_s": round(self.zero_s, 4), "decided_s": round(self.decided_s, 4)}
        return {name: value for name, value in row.items() if value not in ("", []) and value == value}  # drops NaN


class Boat:
    """Reader of the mock's trace while it grows. It also keeps the time of the last fault."""

    def __init__(self, trace: Path) -> None:
        self._file = trace.open(encoding="utf-8")
        self.n: dict[int, float] = {}
        self.zero_at = self.struck_at = 0.0
        # wall seconds of pauses of the mock's own process, by which the mock extends the time-out of its controllers
        self.forgiven = 0.0

    def close(self) -> None:
        """Close the trace."""
        self._file.close()

    def turning(self) -> bool:
        """Return whether any thruster has thrust now."""
        for line in self._file:
            row = json.loads(line)
            self.n[row["node"]] = row["n"]
            self.zero_at, self.forgiven = row["wall"], row["forgiven"]
        return any(self.n.values())


@dataclass
class Running:
    """Processes of one run."""

    folder: Path
    pid: int
    acquisition: int
    watchdog: int
    log: Path
    deleted: IO[bytes] | None = None  # the open log, if the fault has deleted it


def until(condition: Callable[[], bool]) -> bool:
    """Wait for a condition and return whether it became true in time."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(POLL_S)
    return True


def mock(folder: Path, kind: Kind, trace: Path) -> contextlib.AbstractContextManager[subprocess.Popen[str]]:
    """Start a mock boat for any number of trials of one kind."""
    fault = ["--fault", kind.fault] if kind.fault else []
    return mock_process(folder, "boat", "rig.toml", "--trace", str(trace), *fault)


@contextlib.contextmanager
def small_disk(folder: Path, wanted: bool) -> Iterator[bool]:
    """Mount a file system of 6 MB. Yield False if this machine does not permit the mount."""
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


def trials(kind: Kind, seeds: list[int]) -> Iterator[Trial]:
    """Yield one trial per seed, all with one mock boat. Yield no trial if this machine does not permit them."""
    # The mock writes its trace in the measured loop, and a busy disk could delay a write.
    memory = MEMORY if os.access(MEMORY, os.W_OK) else None
    with tempfile.TemporaryDirectory(prefix="seatrial-faults-") as name, tempfile.TemporaryDirectory(dir=memory) as shm:
        folder, trace = Path(name), Path(shm) / "trace.jsonl"
        write_files(folder, kind)
        with (
            small_disk(folder, kind.full) as there,
            mock(folder, kind, trace) as devices,
            contextlib.closing(Boat(trace)) as boat,
        ):
            for seed in seeds if there else ():
                yield trial(kind, folder, devices, boat, seed)
                # wait until the fault is over
                time.sleep(max(boat.struck_at + kind.lasts_s + POLL_S - time.monotonic(), 0.0))


def trial(kind: Kind, folder: Path, devices: subprocess.Popen[str], boat: Boat, seed: int) -> Trial:
    """Run one mission with a fault at a moment drawn from `seed`."""
    log = folder / (DISK if kind.full else "") / f"run-{seed}.mcap"
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(
        [
            "seatrial.command_line",
            "seatrial.bench.cli",
            "seatrial.bench.execution.operator_interface",
            "seatrial.bench.execution.runner",
            "seatrial.daq.log.reader",
        ]
    )
    words = ["mission", "run", "mission.toml", "rig.toml", "-o", str(log), *kind.words]
    process = context.Process(target=_run, args=(str(folder), words))
    (folder / "out.txt").write_text("")
    process.start()
    assert process.pid is not None
    try:
        if not until(lambda: boat.turning() or not process.is_alive()) or not process.is_alive():
            return _no_trial(f"it never turned: {_last_line(folder)}")
        running = _processes(folder, process.pid, log)
        if running is None:
            process.join(PATIENCE_S)
            return _no_trial(f"it was over: {_last_line(folder)}")
        forgiven = boat.forgiven
        time.sleep(random.Random(seed).uniform(0.0, 0.3))  # the fault has to strike at many different times
        boat.struck_at = begun = time.monotonic()
        if kind.fault:
            devices.send_signal(signal.SIGUSR1)
        elif kind.strike is not None:
            kind.strike(running)
            # The disk is full only after its last byte, and a pause ends when the programs continue: count from here.
            begun = time.monotonic() if kind.full or kind.what.startswith("all stopped") else begun
        if kind.stays:
            process.join(PATIENCE_S)
            wrong = [] if process.exitcode == 3 else [f"exit status {process.exitcode}"]
            wrong += (
                []
                if "zero thrust was sent, not confirmed: thruster left turns at" in _last_line(folder)
                else [_last_line(folder)]
            )
        else:
            wrong = [] if until(lambda: not boat.turning()) else ["thrust did not end"]
        if kind.what == "runner hangs":
            os.kill(process.pid, signal.SIGCONT)
        process.join(PATIENCE_S)
        ended = until(lambda: not is_alive(running.acquisition) and not is_alive(running.watchdog))
        wrong += [] if ended and process.exitcode is not None else ["a process stayed"]
    finally:
        if process.is_alive():
            process.kill()
            process.join()
    if running.deleted is not None:
        with running.deleted as deleted:
            log.write_bytes(deleted.read())
    line = _last_line(folder) if kind.full or running.deleted else ""  # the message that the log cannot contain
    found = _judged(kind, log, begun, boat, boat.forgiven - forgiven if kind.cut_off else 0.0, [line, *wrong])
    for path in [*log.parent.glob(f"{log.stem}*"), log.parent / "filler"]:
        path.unlink(missing_ok=True)
    return found


def _run(folder: str, words: list[str]) -> None:
    """Run the runner in a process that has already imported everything."""
    from seatrial import command_line

    os.chdir(folder)
    os.setsid()
    sys.stdout = sys.stderr = open("out.txt", "w", encoding="utf-8")  # noqa: SIM115 (for the life of the process)
    command_line.main(words)


def _no_trial(why: str) -> Trial:
    return Trial(spoilt=why)


def _last_line(folder: Path) -> str:
    lines = (folder / "out.txt").read_text(encoding="utf-8").splitlines()
    lines = [line for line in lines if not line.startswith("seatrial: the log ")]  # the line below the message
    return lines[-1] if lines else ""


def _processes(folder: Path, pid: int, log: Path) -> Running | None:
    """Return the processes of a run, or None if the run is about to end."""
    try:
        return Running(folder, pid, acquisition_of(pid), watchdog_of(pid), log)
    except ValueError:
        return None


def _judged(kind: Kind, log: Path, begun: float, boat: Boat, forgiven: float, found: list[str]) -> Trial:
    line, *wrong = found
    folder = log.parent.parent if kind.full else log.parent
    if boat.turning() and not kind.stays:
        wrong.append("thrust came back")
    with open_log(log) as opened:
        events = opened.events()
        origin, speed = json.loads(opened.metadata["origin"]), float(opened.metadata["speed"])

    def wall(t: float) -> float:
        """Convert a run time, which follows the raw clock, to the monotonic clock of the stand-ins."""
        return float(origin[0] + (t - origin[1]) / speed) + slewed

    slewed = time.monotonic() - time.clock_gettime(time.CLOCK_MONOTONIC_RAW)

    stops = [(wall(t), text) for t, event, text in events if event == "stop"]
    texts = [*(text for _, text in stops), read_note(log), line]
    evidence = next((text for text in texts if re.search(kind.pattern, text)), "").replace(f"{folder}/", "")
    too_early = [text for t, text in stops if t < boat.struck_at or (DEADMAN in text and not evidence)]
    if too_early and not wrong:
        return _no_trial(too_early[0])
    decided = [float(text.split()[0]) for _, event, text in events if event == "decided"]
    after = boat.zero_at - wall(decided[0]) if decided else math.nan
    zero = boat.zero_at - begun - forgiven
    wrong += [] if evidence else [f"the log does not contain the reason: {texts}"]
    if kind.stays:  # the thruster cannot be stopped: the time at which the run decided to end counts
        zero, after = (wall(decided[0]) - begun if decided else math.inf), 0.0
    if zero > kind.within_s + AFTER_DECISION_S:
        wrong.append(f"zero after {zero:.3f} s")
    if after > AFTER_DECISION_S and not kind.cut_off:
        wrong.append(f"zero {after:.3f} s after the decision")
    return Trial(zero, after, evidence, wrong)
