"""Study of faults and wrong parameters on ArduPilot Rover, repeated under several settings of its failsafes.

    python -m tests.bench.autopilot_faults --n 2 --out docs/data/autopilot-faults.jsonl --docs docs/safety.md

Each trial runs a mission with the public command against ArduPilot Rover in its own simulator (SEATRIAL_ARDUROVER). The
link passes through a relay that can be cut. A second station reads the outputs 40 times a second. All trials are kept,
and only missing trials are run. `--docs` writes the table between its marks in a page.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from seatrial.daq.acquisition.process import SILENCE_S
from seatrial.daq.acquisition.watchdog import ANSWER_S, HANG_S
from seatrial.daq.config.mission_file import Mission, Segment, save_mission
from tests.bench.fault_trials import into
from tests.bench.runs import acquisition_of, watchdog_of
from tests.daq.ardurover import MISSING, PROGRAM, RIG, Rover

SEATRIAL = [sys.executable, "-m", "seatrial"]
N = 0.3
AT_ONCE_S = 0.1  # for a fault that kills one of our own processes and leaves another one alive
SAMPLE_S = 0.05  # resolution of the observed outputs: they arrive every 25 ms and are read up to 25 ms later
SUPERVISED_S = 0.5  # from the first thrust, or from the change of the parameter, to the last thrust, with all delays
AFTER_S = 9.0  # watched after a cut: the failsafe of the ground station acts after 6.5 s
BACK_S = 8.0
OWN, STRANGER, HOLD, RTL, DISARM = 255, 254, 4, 11, 400
REBOOT_S = 0.5  # after a reboot command the outputs end within this time
MARKS = ("<!-- python -m tests.bench.autopilot_faults -->", "<!-- end of the faults -->")


REFUSAL, OUTPUT = "to drive, yours to set", "puts out n = "
PARAMETER = re.compile(r"[A-Z0-9]+_[A-Z0-9_]+")


class Trial(NamedTuple):
    """Trial of one fault, or of one wrong parameter (`NAME value`), under one setting of the autopilot."""

    fault: str
    setting: str
    seconds: float  # from the fault to the last output at neutral
    allowed: float
    message: str  # the last line that the run printed
    disarmed: bool  # at the end of the trial
    warned: bool  # whether the run warned that the vehicle may still be armed

    @property
    def good(self) -> bool:
        """Return whether thrust ended in time and a vehicle left armed is named, or a wrong parameter was named as the
        reason.
        """
        name, _, value = self.fault.partition(" ")
        if PARAMETER.fullmatch(name) and value:
            refused = REFUSAL in self.message and f"{name} is" in self.message and self.seconds == 0.0
            ended = OUTPUT in self.message and 0.0 < self.seconds <= self.allowed
            return (refused or ended) and self.disarmed
        return self.seconds <= self.allowed and (self.disarmed or self.warned)


@dataclass
class Run:
    """Processes of a mission that is under way."""

    rover: Rover
    pid: int
    acquisition: int
    watchdog: int

    def kill(self, number: signal.Signals, *who: str) -> None:
        for name in who:
            os.kill(getattr(self, name), number)


class Fault(NamedTuple):
    """Fault: how to cause it, and the time [s] until seatrial detects it.

    If the time is None, no process of ours is left to detect it and the time of the link test counts.
    """

    name: str
    seen_s: float | None
    strike: Callable[[Run], None]
    watched_s: float = 2.5
    no_pulses: bool = False  # whether the outputs themselves end; the time then counts until the last pulse that pushed


def killed(number: signal.Signals, *who: str) -> Callable[[Run], None]:
    return lambda run: run.kill(number, *who)


def cut(run: Run) -> None:
    run.rover.relay.state = "cut"


def back_later(state: str) -> Callable[[Run], None]:
    def strike(run: Run) -> None:
        run.rover.relay.state = state
        time.sleep(BACK_S)
        run.rover.relay.state = "open"

    return strike


def held_up(run: Run) -> None:
    run.rover.process.send_signal(signal.SIGSTOP)
    time.sleep(5.0)
    run.rover.process.send_signal(signal.SIGCONT)


def reboot(run: Run) -> None:
    run.rover.command(246, 1.0, 0.0, 0.0, 0.0, 0.0, 20190226.0)


def parameter(name: str, value: float) -> Callable[[Run], None]:
    return lambda run: run.rover.set_parameter(name, value)


def with_a_second(component_heard: bool) -> Callable[[Run], None]:
    def strike(run: Run) -> None:
        run.rover.beat_as(OWN, 230 if component_heard else 190)
        # the autopilot does not forward messages that have our own address: cut the link, so that only the second
        # station acts
        if not component_heard:
            cut(run)

    return strike


RESTORED = ("FS_THR_ENABLE", "FS_GCS_ENABLE", "RC_OVERRIDE_TIME")  # 1 in every setting; faults change them
KILL, STOP = signal.SIGKILL, signal.SIGSTOP
FAULTS = (
    Fault("runner killed", 0.0, killed(KILL, "pid")),
    Fault("runner hangs", SILENCE_S, killed(STOP, "pid")),
    Fault("acquisition killed", 0.0, killed(KILL, "acquisition")),
    Fault("acquisition hangs", HANG_S, killed(STOP, "acquisition")),
    Fault("watchdog killed", 0.0, killed(KILL, "watchdog")),
    Fault("watchdog hangs", ANSWER_S, killed(STOP, "watchdog")),
    Fault("runner and acquisition killed", 0.0, killed(KILL, "pid", "acquisition")),
    Fault("Ctrl-C", 0.0, killed(signal.SIGINT, "pid")),
    Fault("hang-up (SIGHUP)", 0.0, killed(signal.SIGHUP, "pid")),
    Fault("SIGTERM", 0.0, killed(signal.SIGTERM, "pid")),
    Fault("all of ours killed", None, killed(KILL, "watchdog", "acquisition", "pid"), AFTER_S),
    Fault("link cut", None, cut, AFTER_S),
    Fault("link cut for 8 s", None, back_later("cut"), 1.0),
    Fault("link held up for 8 s, all comes late", None, back_later("frozen"), 1.0),
    Fault("disarmed by another station", 0.0, lambda run: run.rover.command(DISARM, 0.0)),
    Fault("put into HOLD by another station", 0.0, lambda run: run.rover.command(176, 1.0, float(HOLD))),
    Fault("put into RTL by another station", 0.0, lambda run: run.rover.command(176, 1.0, float(RTL))),
    Fault("another station sets FS_THR_ENABLE 0", SUPERVISED_S, parameter("FS_THR_ENABLE", 0.0)),
    Fault("another station sets FS_GCS_ENABLE 0", SUPERVISED_S, parameter("FS_GCS_ENABLE", 0.0)),
    Fault("another station sets RC_OVERRIDE_TIME 3", SUPERVISED_S, parameter("RC_OVERRIDE_TIME", 3.0)),
    Fault("another station beats with our id", 1.0, with_a_second(True)),
    Fault("the same unseen, and the link cut", None, with_a_second(False), AFTER_S),
    Fault("autopilot reboots", REBOOT_S, reboot, 2.5, True),
    Fault("autopilot stands still for 5 s", 5.0, held_up),
)


@dataclass(frozen=True)
class Setting:
    """Setting of an autopilot: its parameters and failsafes."""

    name: str
    parameters: dict[str, float] = field(default_factory=dict)
    signed: bool = False


SETTINGS = (
    Setting("receiver, FS_ACTION 2"),
    Setting("receiver, FS_ACTION 5", {"FS_ACTION": 5}),
    Setting("no receiver, FS_ACTION 2", {"SIM_RC_FAIL": 1}),
    Setting("no receiver, signed", {"SIM_RC_FAIL": 1}, signed=True),
)
# One wrong parameter each, on a boat without a receiver. The run is refused, or the comparison of outputs with commands
# ends it.
WRONG: tuple[tuple[str, float], ...] = (
    *(("FS_THR_ENABLE", value) for value in (0, 2)), *(("FS_ACTION", value) for value in (0, 1, 3, 4)),
    ("FS_GCS_ENABLE", 0), ("FS_GCS_TIMEOUT", 120), ("FS_TIMEOUT", 30), ("RC_OPTIONS", 34), ("PILOT_STEER_TYPE", 0),
    *(("RC_OVERRIDE_TIME", value) for value in (-1, 0, 3)), ("MOT_THST_ASYM", 2), ("MOT_THST_EXPO", 0.65),
    ("MOT_THR_MAX", 60), ("MANUAL_STR_EXPO", 0.6), ("SERVO1_REVERSED", 1), ("RC1_REVERSED", 1), ("RCMAP_ROLL", 3),
    ("RCMAP_THROTTLE", 1), ("SERVO3_FUNCTION", 70), ("SERVO1_MAX", 1900), ("MOT_THR_MIN", 40), ("MOT_SLEWRATE", 20),
    ("RC1_DZ", 190), ("BATT_FS_LOW_ACT", 1), ("BATT_FS_CRT_ACT", 3),
)  # fmt: skip


def write_files(folder: Path, rover: Rover, setting: Setting) -> None:
    """Write the rig, the signing key and the mission into a folder."""
    (folder / "key").write_bytes(bytes(range(32)))
    more = 'key_file = "key"\n' if setting.signed else ""
    text = RIG.format(port=rover.port, more=more) + "\n[limits]\nlink_test_n = 0.2\n"
    (folder / "rig.toml").write_text(text, encoding="utf-8")
    rows = (Segment("steps", np.array([0.5]), np.array([[N, N]])),)
    save_mission(Mission("trial", "mission", ("left", "right"), rows, 120.0), folder / "mission.toml")


def link_test(folder: Path) -> float:
    """Run the link test and return the time that it measured [s]."""
    words = ["check", "rig.toml", "--actuators", "--link-test", "--yes", "--arm"]
    done = subprocess.run([*SEATRIAL, *words], cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stdout + done.stderr)
    return float(json.loads((folder / "rig.link-test.json").read_text())["devices"]["autopilot"]["seconds"])


def start(folder: Path) -> subprocess.Popen[str]:
    log = f"run{len(list(folder.glob('run*.mcap')))}.mcap"
    words = ["mission", "run", "mission.toml", "rig.toml", "--arm", "-o", log]
    pipe = subprocess.PIPE
    return subprocess.Popen(
        [*SEATRIAL, *words], cwd=folder, stdout=pipe, stderr=pipe, text=True, start_new_session=True
    )


def try_fault(folder: Path, rover: Rover, fault: Fault, setting: Setting, measured: float) -> Trial:
    """Run one mission with one fault and return the trial."""
    process = start(folder)
    rover.until(lambda: rover.pushes or process.poll() is not None, 90.0, "thrust")
    if process.poll() is not None:
        raise RuntimeError(process.communicate()[1])
    time.sleep(random.uniform(0.5, 1.0))
    run = Run(rover, process.pid, acquisition_of(process.pid), watchdog_of(process.pid))
    begun = time.monotonic()
    fault.strike(run)
    with contextlib.suppress(TimeoutError):
        rover.until(lambda: not rover.pushes, 20.0, "neutral")
    time.sleep(fault.watched_s)
    seconds = rover.last_push_after(begun) if fault.no_pulses else rover.neutral_after(begun)
    rover.relay.state = "open"
    rover.beat_as(None)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(timeout=20.0 if fault.name not in ("runner hangs",) else 0.1)
    for pid in (run.pid, run.acquisition, run.watchdog):
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(timeout=20.0)
    if process.poll() is None:
        process.kill()
    message = process.communicate()[1].strip().splitlines()[-1:] or [""]
    seen = measured if fault.seen_s is None else fault.seen_s
    allowed = seen + AT_ONCE_S + SAMPLE_S
    rover.until(lambda: rover.beats[-1][0] > time.monotonic() - 2.0, 60.0, "a heartbeat")
    disarmed = not rover.armed
    warned = "MAY STILL BE" in message[0] or "all of ours" in fault.name
    for name in RESTORED:
        rover.set_parameter(name, 1.0)
    _put_right(rover)
    if fault.no_pulses and setting.signed:  # a start with the simulator's parameters deletes its signing key
        rover.sign((folder / "key").read_bytes())
    return Trial(fault.name, setting.name, seconds, allowed, message[0], disarmed, warned)


def _put_right(rover: Rover) -> None:
    """Disarm the vehicle, set it to MANUAL and wait until it has a position."""

    def done() -> bool:
        rover.command(DISARM, 0.0, 21196.0)
        rover.command(176, 1.0, 0.0)
        time.sleep(0.5)
        return not rover.armed and rover.beats[-1][2] == 0 and not rover.pushes

    rover.until(done, 30.0, "the state before a trial")
    rover.until_ready()


def try_parameter(folder: Path, rover: Rover, name: str, value: float, setting: Setting) -> Trial:
    """Run one mission with one wrong parameter and return the trial."""
    before = rover.get(name)
    rover.set(name, value)
    started, process = time.monotonic(), start(folder)
    rover.until(lambda: rover.pushes or process.poll() is not None, 90.0, "thrust or refusal")
    begun = rover.first_push() if rover.pushes else time.monotonic()
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(timeout=10.0)
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    message = process.communicate()[1].strip().splitlines()[-1:] or [""]
    refused = REFUSAL in message[0]
    seconds = rover.last_push_after(started) if refused else rover.neutral_after(begun)
    ended = time.monotonic()
    rover.until(lambda: rover.beats[-1][0] > ended, 10.0, "a heartbeat")
    trial = Trial(f"{name} {value:g}", setting.name, seconds, SUPERVISED_S, message[0], not rover.armed, False)
    rover.set(name, before)
    _put_right(rover)
    return trial


@contextlib.contextmanager
def ready_rover(setting: Setting) -> Iterator[tuple[Path, Rover]]:
    """Yield a rover with this setting and a position, and the folder with the files of a mission."""
    with tempfile.TemporaryDirectory(prefix="seatrial-faults-") as name:
        folder = Path(name)
        with Rover(folder / "sitl", setting.parameters) as rover:
            write_files(folder, rover, setting)
            rover.until_ready()
            if setting.signed:
                rover.sign((folder / "key").read_bytes())
            yield folder, rover


def trials(only: str, n: int, rows: Sequence[Trial]) -> Iterator[Trial]:
    """Yield the trials that `rows` lacks of `n` trials of each fault and each parameter, round by round."""
    for k in range(1, n + 1):
        often = Counter((row.fault, row.setting) for row in rows)
        yield from _round(only, {cell for cell, m in often.items() if m >= k})


def _round(only: str, known: set[tuple[str, str]]) -> Iterator[Trial]:
    wanted = [(s, f) for s in SETTINGS for f in FAULTS if re.search(only, f"{f.name}, {s.name}")]
    for setting in SETTINGS:
        faults = [f for s, f in wanted if s is setting and (f.name, s.name) not in known]
        wrong = [row for row in WRONG if setting is SETTINGS[2] and re.search(only, f"{row[0]} {row[1]:g}")]
        wrong = [row for row in wrong if (f"{row[0]} {row[1]:g}", setting.name) not in known]
        if not faults and not wrong:
            continue
        with ready_rover(setting) as (folder, rover):
            measured = link_test(folder)
            print(f"{setting.name}: link test {measured:.2f} s", flush=True)
            for fault in faults:
                yield try_fault(folder, rover, fault, setting, measured)
            for name, value in wrong:
                yield try_parameter(folder, rover, name, value, setting)


def page(rows: list[Trial]) -> str:
    """Return the Markdown tables of docs/safety.md: faults by settings, and refused parameters."""
    cells: dict[tuple[str, str], list[Trial]] = {}
    for row in rows:
        cells.setdefault((row.fault, row.setting), []).append(row)
    good = sum(row.good for row in rows)
    out = ["", f"{good} of {len(rows)} trials were correct."]
    late = [f"{r.fault} ({r.setting}) {r.seconds:.2f} s of {r.allowed:.2f}" for r in rows if not r.good]
    out[-1] += f" Not so: {'; '.join(late)}." if late else ""
    out += ["", "| what fails | " + " | ".join(s.name for s in SETTINGS) + " |", "|---|" + "---:|" * len(SETTINGS)]
    for fault in FAULTS:
        words = [_cell(cells.get((fault.name, setting.name), [])) for setting in SETTINGS]
        out.append(f"| {fault.name} | {' | '.join(words)} |")
    refused: list[tuple[str, float]] = []
    ended: list[tuple[str, float]] = []
    for name, value in WRONG:
        found = cells.get((f"{name} {value:g}", SETTINGS[2].name), [])
        if found:
            longest = max(trial.seconds for trial in found)
            (ended if longest else refused).append((found[0].fault, longest))
    out += ["", "These settings were refused before any thrust: " + ", ".join(f"`{name}`" for name, _ in refused) + "."]
    out += ["", "With these settings, the comparison of outputs with commands ended the run: "]
    out[-1] += ", ".join(f"`{name}` after {seconds:.2f} s" for name, seconds in ended) + "."
    return "\n".join([*out, ""])


def _cell(found: list[Trial]) -> str:
    """Return the longest time among the trials of a cell [s]."""
    if not found:
        return "-"
    armed = "" if all(trial.disarmed for trial in found) else " (armed)"
    return f"{max(trial.seconds for trial in found):.2f}{armed}"


def kept(path: Path | None) -> list[Trial]:
    """Return the trials of a file in their order, or an empty list if the file does not exist."""
    lines: list[str] = path.read_text(encoding="utf-8").splitlines() if path and path.exists() else []
    return [msgspec.json.decode(line, type=Trial) for line in lines]


def main() -> None:
    """Run the missing trials and print those that failed. The exit status is 1 if a trial failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="regular expression of 'fault, setting' or 'PARAMETER value'")
    parser.add_argument("--n", type=int, default=1, help="trials of each")
    parser.add_argument("--out", type=Path, help="file of JSON lines to keep trials in and to go on from")
    parser.add_argument("--docs", type=Path, help="page that gets the table")
    options = parser.parse_args()
    rows = kept(options.out)
    if not PROGRAM:
        print(f"nothing was tried: {MISSING}")
    for trial in trials(options.only, options.n, rows) if PROGRAM else ():
        rows.append(trial)
        state = "ok " if trial.good else "BAD"
        took = f"{trial.seconds:5.2f} of {trial.allowed:.2f} s"
        print(f"{state} {took}  {trial.fault}, {trial.setting}: {trial.message}", flush=True)
        if options.out:
            with options.out.open("a", encoding="utf-8") as file:
                file.write(msgspec.json.encode(trial).decode() + "\n")
    if options.docs:
        into(options.docs, MARKS, page(rows))
    bad = [row for row in rows if not row.good]
    print(f"{len(rows) - len(bad)} of {len(rows)} trials were correct")
    raise SystemExit(1 if bad else 0)


if __name__ == "__main__":
    main()
