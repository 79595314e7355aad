"""`seatrial demo`: the whole loop on mock devices, from a bench run to a diagnosis and the ground truth.

It runs the public commands only. Each is echoed and timed, runs in a process group of its own, and ends with the demo.
"""

from __future__ import annotations

import json
import math
import os
import random
import re
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.resources import files
from itertools import count
from pathlib import Path
from types import FrameType
from typing import Any

import click

from seatrial.daq.child_process import module_command, module_environment
from seatrial.daq.errors import SeatrialError
from seatrial.daq.files import write_output
from seatrial.daq.log import open_log
from seatrial.daq.options import FiniteRange

ESTIMATION_S, VALIDATION_S = 400.0, 250.0  # run seconds of the two missions
LATE_MS, SLOWEST = 45.0, 8.0  # wall ms that samples may leave late; at this speed or slower nothing is repeated
SKIPPED = 100  # set-points of a run that may be overtaken: samples are then stamped as late as those were sent
READY_WITHIN_S = 30.0  # wall seconds for a mock to open its ports; it may have to be compiled first
TERMINATION_S = 10.0  # wall seconds between SIGTERM and SIGKILL
LATE = re.compile(r"(?:at most|up to) ([0-9.]+) ms")
OVERTAKEN = re.compile(r"([0-9]+) set-points? (?:was|were) skipped")  # as `said_of_losses` has it
ANSWER, TRUTH = "diagnosis/result.json", "truth.json"
EPILOG = "Example: seatrial demo --seed 3 --out /tmp/demo"


class StepFailed(SeatrialError):
    """A command of the demo failed; the message names it."""


class DemoInterrupted(SeatrialError):
    """The user ended the demo."""

    exit_status = 130


@click.command(epilog=EPILOG)
@click.option("--seed", type=click.IntRange(min=0), help="Seed of everything random; drawn and printed when not given.")
@click.option("--out", type=click.Path(path_type=Path), help="New folder to work in [default: seatrial-demo-SEED].")
@click.option(
    "--speed", type=FiniteRange(1.0, 50.0), default=20.0, show_default=True, help="Run seconds a wall second."
)
def demo(seed: int | None, out: Path | None, speed: float) -> None:
    """Bench run, thruster model, two missions, vehicle model, diagnosis: all on mock devices.

    The mock boat has one hidden effect, which the nominal model lacks. It is drawn from the seed and written to a
    ground-truth file. The diagnosis has to find it; the ground truth is printed last.
    """
    seed = random.SystemRandom().randrange(1, 10_000) if seed is None else seed
    folder = fresh_folder(out, seed)
    click.echo(f"demo: seed {seed}, {speed:g} times real time, in {folder}")
    for name in ("bench", "boat"):
        write_demo_rig(name, folder, speed)
    start = time.monotonic()
    steps = DemoSteps(folder)
    with steps.signals():
        missing = run_steps(steps, seed)
    click.echo(f"total: {time.monotonic() - start:.1f} s")
    if missing:
        raise SeatrialError(f"demo: this installation has no {', '.join(missing)}; the logs are in {folder}")
    print_outcome(folder)


def fresh_folder(out: Path | None, seed: int) -> Path:
    """Make the folder that the demo works in; raises SeatrialError when it holds anything."""
    folder = Path(f"seatrial-demo-{seed}") if out is None else out
    if out is None and folder.exists():
        folder = Path(time.strftime(f"seatrial-demo-{seed}-%Y%m%dT%H%M%S"))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise SeatrialError(f"demo: {folder} is not empty; name another folder with --out")
    except OSError as error:
        raise SeatrialError(f"demo: {folder}: {error.strerror}; name another folder with --out") from error
    return folder


def write_demo_rig(name: str, folder: Path, speed: float) -> None:
    """Copy the mocks' rig file into the folder, with the demo's clock speed in it."""
    text = (files("seatrial.mocks") / "rigs" / f"{name}.toml").read_text(encoding="utf-8")
    text, n_found = re.subn(r"(?m)^speed\s*=\s*[0-9.]+", f"speed = {speed!r}", text)
    if n_found != 1:
        raise SeatrialError(f"demo: the packaged rig {name}.toml has no clock speed; install seatrial again")
    write_output(folder / f"{name}-rig.toml", text)


def run_steps(steps: DemoSteps, seed: int) -> list[str]:
    """Run the whole loop; returns the commands that this installation does not have."""
    missing: list[str] = []
    mock = ("mock", "bench", "bench-rig.toml", "--seed", str(seed))
    _record(steps, "bench", mock, "bench run", "bench", "all", "bench-rig.toml", "-o", "bench.mcap")
    _explain(steps, missing, "thruster model", "ident", "thruster", "bench.mcap", "--out", "thruster")
    _mission(steps, seed, 1, ESTIMATION_S, "estimation")
    _mission(steps, seed, 2, VALIDATION_S, "validation")
    data = ("estimation.mcap", "--validate", "validation.mcap")
    model = ("--thruster", "thruster/model.toml")
    _explain(steps, missing, "vehicle model", "ident", "vehicle", data[0], *model, *data[1:], "--out", "vehicle")
    _explain(steps, missing, "diagnosis", "ident", "diagnose", "vehicle/model.toml", *data, "--out", "diagnosis")
    return missing


def _mission(steps: DemoSteps, seed: int, run: int, seconds: float, name: str) -> None:
    """Generate and run one mission on a newly started mock boat: the same boat and effect, other noise."""
    plan, mission_seed = f"{name}.toml", str(100 * seed + run)
    steps.run(
        f"{name} mission",
        *("mission", "generate", "--kind", "mixed", "--seconds", f"{seconds:g}", "--seed", mission_seed, "-o", plan),
    )
    boat = ("mock", "boat", "boat-rig.toml", "--seed", str(seed), "--effect", "draw", "--truth-file", TRUTH)
    mock = (*boat, "--run", str(run))
    _record(steps, "boat", mock, f"{name} run", "mission", "run", plan, "boat-rig.toml", "-o", f"{name}.mcap")


def _record(steps: DemoSteps, rig: str, mock: tuple[str, ...], name: str, *words: str) -> None:
    """Record against a mock; where this machine could not keep up, again at half the speed, down to a quarter.

    At 20 times real time a pause of 50 ms is a second of the boat's time, in which the shaft speeds, which have no
    clock of their own, are stamped late. Such a log is kept under another name; it is not a fair one to explain.
    """
    usual = speed = _speed(steps.folder / f"{rig}-rig.toml")
    for attempt in count(1):
        failed: StepFailed | None = None
        try:
            with steps.mock(*mock):
                steps.run(name, *words)
        except StepFailed as problem:  # a device that paused for a second is silent, and the guard rightly ends the run
            failed = problem
        log = steps.folder / words[-1]
        if (steps.late_ms <= LATE_MS and n_skipped(log) <= SKIPPED) or speed <= SLOWEST:
            break
        click.echo(f"  this machine was too busy for {speed:g} times real time; once more at {speed / 2:g} times")
        if log.exists():
            log.rename(log.with_name(f"{log.stem}-late{attempt if attempt > 1 else ''}.mcap"))
        speed /= 2
        write_demo_rig(rig, steps.folder, speed)
    write_demo_rig(rig, steps.folder, usual)
    if failed is not None:
        raise failed


def n_skipped(path: Path) -> int:
    """Set-points that were overtaken in a run, by the events of its log; 0 where there is none that can be read."""
    try:
        with open_log(path) as log:
            told = [OVERTAKEN.search(text) for _, kind, text in log.events() if kind == "invalid"]
    except SeatrialError:
        return 0
    return sum(int(found[1]) for found in told if found)


def _speed(rig: Path) -> float:
    found = re.search(r"(?m)^speed\s*=\s*([0-9.]+)", rig.read_text(encoding="utf-8"))
    return float(found[1]) if found else 1.0


def _explain(steps: DemoSteps, missing: list[str], name: str, *words: str) -> None:
    """Run one step of ident, or note that it is not installed; later steps need the earlier ones."""
    if not missing:
        try:
            steps.run(name, *words)
            return
        except StepFailed:
            if steps.has(*words[:2]):
                raise
    click.echo(f"  left out: {' '.join(words[:2])}")
    missing.append(f"`seatrial {' '.join(words[:2])}`")


def print_outcome(folder: Path) -> None:
    """Print the answer, the errors before and after, the report's path, and last the ground truth."""
    result = _read_json(folder / ANSWER)
    click.echo()
    click.secho(f"answer: {result.get('answer', 'none')}", bold=True)
    if result.get("caveat"):
        click.echo(result["caveat"])
    for line in error_lines(result):
        click.echo(line)
    click.echo(f"report: {folder / 'diagnosis' / 'report.html'}")
    truth = _read_json(folder / TRUTH)
    effect = truth.get("effect")
    if not isinstance(effect, str):
        raise SeatrialError(f"demo: {folder / TRUTH} does not name the effect")
    named = found_effects(result)
    match = "match" if effect in named or (effect == "none" and not named) else "do not match"
    click.echo(f"diagnosis: {', '.join(named) or 'none'}; that and the hidden effect {match}")
    click.echo(f"ground truth: the plant's hidden effect was {effect}{_detail(truth)}")


def _detail(truth: dict[str, Any]) -> str:
    """The effect's sentence and its parameters, in brackets."""
    parameters = truth.get("parameters", {}).items()
    numbers = [f"{key} = {value:.4g}" if isinstance(value, float) else f"{key} = {value}" for key, value in parameters]
    parts = [part for part in (truth.get("sentence", ""), ", ".join(numbers)) if part]
    return f" ({'; '.join(parts)})" if parts else ""


def found_effects(result: dict[str, Any]) -> list[str]:
    """Names of the effects that the diagnosis has added, in their order."""
    effects = result.get("effects", [])
    return [str(effect["name"] if isinstance(effect, dict) else effect) for effect in effects]


def error_lines(result: dict[str, Any]) -> list[str]:
    """The RMS prediction error over the horizon on validation data before and after, a line a channel."""
    try:
        channels, horizon = result["errors"]["validation"]["horizon"], result["horizon_seconds"]
        return [_error_line(name, row, horizon) for name, row in channels.items()]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise SeatrialError(f"demo: {ANSWER} has no error before and after ({error!r})") from error


def _error_line(name: str, row: dict[str, Any], horizon: float) -> str:
    unit, scale = str(row["unit"]), 1.0
    if unit.startswith("rad"):  # degrees are for people
        unit, scale = unit.replace("rad", "deg", 1), math.degrees(1.0)
    errors = (row["before"], row["after"])
    before, after = ("diverged" if e is None else f"{scale * e:.3g} {unit}".rstrip() for e in errors)
    return f"  {name:<6} error {horizon:g} s ahead on validation data {before} before, {after} after"


def _read_json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SeatrialError(f"demo: {path}: {error.strerror}") from error
    except ValueError as error:
        raise SeatrialError(f"demo: {path}: not JSON ({error})") from error
    if not isinstance(content, dict):
        raise SeatrialError(f"demo: {path}: not a JSON object")
    return content


class DemoSteps:
    """Runs `seatrial ...` commands in `folder`; everything still running ends when the context does."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.seconds: list[tuple[str, float]] = []
        self.late_ms = 0.0  # wall ms by which the last mock's samples left late, at most
        self._running: list[subprocess.Popen[bytes]] = []
        self._signalled = False

    def run(self, name: str, *words: str) -> None:
        """Run one command to its end; raises StepFailed unless it succeeds, Interrupted on a signal."""
        click.secho(f"$ seatrial {' '.join(words)}", bold=True)
        start = time.monotonic()
        process = self._start(words, stdout=None)
        try:
            status = self._wait(process)
        finally:
            self._end(process)
        self._note(name, time.monotonic() - start)
        if status != 0:
            command = " ".join(words[:2])
            live = command.endswith("run") or command.startswith("bench")
            slower = "; was the machine too busy? --speed 5 asks less of it" if live else ""
            raise StepFailed(f"demo: `seatrial {command}` failed with exit status {status} (see above){slower}")

    def has(self, *words: str) -> bool:
        """Whether this installation has the command, by its --help."""
        command, quiet = module_command("seatrial", *words, "--help"), subprocess.DEVNULL
        done = subprocess.run(
            command, cwd=self.folder, env=module_environment(), stdout=quiet, stderr=quiet, check=False
        )
        return done.returncode == 0

    @contextmanager
    def mock(self, *words: str) -> Iterator[None]:
        """Run a mock in the background for the body of a `with`, from its word `ready` on.

        Afterwards `late_ms` says whether the machine could keep up.
        """
        click.secho(f"$ seatrial {' '.join(words)} &", bold=True)
        start = time.monotonic()
        process = self._start(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        try:
            self._await_ready(process, start + READY_WITHIN_S)
            click.echo(f"  devices ready after {time.monotonic() - start:.1f} s")
            yield
        finally:
            self._end(process)
            assert process.stderr is not None
            output = process.stderr.read().decode(errors="replace")
            process.stderr.close()
            click.echo(output, nl=False, err=True)
            found = LATE.search(output)
            self.late_ms = float(found[1]) if found else 0.0

    def _start(self, words: Sequence[str], stdout: int | None, stderr: int | None = None) -> subprocess.Popen[bytes]:
        # A session of its own: a Ctrl-C at the terminal reaches the demo alone, which then ends the runner before
        # the mock, so that the runner can still command zero.
        sys.stdout.flush()
        process = subprocess.Popen(
            module_command("seatrial", *words),
            cwd=self.folder,
            env=module_environment(),
            stdin=subprocess.DEVNULL,
            stdout=stdout,
            stderr=stderr,
            start_new_session=True,
        )
        self._running.append(process)
        return process

    def _wait(self, process: subprocess.Popen[bytes]) -> int:
        while True:
            try:
                return process.wait(timeout=0.1)
            except subprocess.TimeoutExpired:
                self._check_signal()

    def _await_ready(self, process: subprocess.Popen[bytes], deadline: float) -> None:
        assert process.stdout is not None
        output = b""
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            while b"ready" not in output.splitlines():
                self._check_signal()
                if time.monotonic() > deadline:
                    raise StepFailed(f"demo: the mock devices were not ready within {READY_WITHIN_S:g} s")
                if not selector.select(timeout=0.1):
                    continue
                data = os.read(process.stdout.fileno(), 4096)
                if not data:
                    raise StepFailed(f"demo: the mock devices ended with exit status {process.wait()} (see above)")
                output += data

    def _check_signal(self) -> None:
        if self._signalled:
            raise DemoInterrupted("demo: interrupted; thrusters at zero, mock devices stopped")

    def _end(self, process: subprocess.Popen[bytes]) -> None:
        """End a process and its group: SIGTERM, then SIGKILL; no process is left behind."""
        # SIGTERM rather than SIGINT: a Python that is still importing dies of it without a traceback.
        for number in (signal.SIGTERM, signal.SIGKILL):
            if process.poll() is not None:
                break
            os.killpg(process.pid, number)
            try:
                process.wait(timeout=TERMINATION_S)
            except subprocess.TimeoutExpired:
                continue
        if process.stdout is not None:
            process.stdout.close()
        if process in self._running:
            self._running.remove(process)

    def _note(self, name: str, seconds: float) -> None:
        self.seconds.append((name, seconds))
        click.secho(f"  {name}: {seconds:.1f} s", dim=True)

    @contextmanager
    def signals(self) -> Iterator[None]:
        """Take SIGINT, SIGTERM and SIGHUP for the body of a `with`; whatever runs is ended at its end."""

        def take(number: int, frame: FrameType | None) -> None:
            self._signalled = True

        old = {number: signal.signal(number, take) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
        try:
            yield
        finally:
            for process in reversed(self._running[:]):
                self._end(process)
            for number, handler in old.items():
                signal.signal(number, handler)
