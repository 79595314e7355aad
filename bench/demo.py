"""Command `seatrial demo`: the whole workflow on mock devices, from a bench run to a diagnosis and the ground truth.

The demo uses only public commands. Each command is printed and timed. Each command runs in its own process group, which
the demo ends when it ends itself.
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
from seatrial.daq.options import FiniteRange, output_option

ESTIMATION_S, VALIDATION_S = 400.0, 250.0  # run seconds of the two missions
LATE_MS = 45.0  # wall ms by which a mock may send its samples late; a run with a longer delay is repeated
SLOWEST = 8.0  # run seconds per wall second; at this speed or a slower one no run is repeated
SKIPPED_MAX = 100  # set-points that a run may skip; a machine that skips more also stamps samples late
READY_WITHIN_S = 30.0  # wall seconds for a mock to open its ports; it may have to be compiled first
TERMINATION_S = 10.0  # wall seconds between SIGTERM and SIGKILL
LATE = re.compile(r"(?:at most|up to) ([0-9.]+) ms")
SKIPPED_SETPOINTS = re.compile(r"([0-9]+) set-points? (?:was|were) skipped")  # the words of `describe_losses`
ANSWER, TRUTH = "diagnosis/result.json", "truth.json"
EPILOG = "Example: seatrial demo --seed 3 --out /tmp/demo"


class StepFailed(SeatrialError):
    """Error of a command of the demo that failed, or of a mock that did not start. The message names the cause."""


class DemoInterrupted(SeatrialError):
    """Error of a demo that SIGINT (Ctrl-C), SIGTERM or SIGHUP has ended. The exit status is 130."""

    exit_status = 130


@click.command(epilog=EPILOG)
@click.option("--seed", type=click.IntRange(min=0), help="Seed of everything random; drawn and printed when not given.")
@output_option(click.Path(path_type=Path), "New folder to work in [default: seatrial-demo-SEED].")
@click.option(
    "--speed", type=FiniteRange(1.0, 50.0), default=20.0, show_default=True, help="Run seconds a wall second."
)
@click.option(
    "--realistic", is_flag=True, help="Give the mock boat the small imperfections of every real boat as well."
)
def demo(seed: int | None, out: Path | None, speed: float, realistic: bool) -> None:
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
        missing = run_steps(steps, seed, realistic)
    click.echo(f"total: {time.monotonic() - start:.1f} s")
    if missing:
        raise SeatrialError(
            f"demo: this installation has no {', '.join(missing)}; install the complete seatrial, and run the printed "
            f"commands on the logs in {folder}"
        )
    print_outcome(folder)


def fresh_folder(out: Path | None, seed: int) -> Path:
    """Make the empty folder in which the demo will work, and return its path.

    Parameters
    ----------
    out : Path or None
        The folder, which may exist if it is empty. If it is None, the folder is "seatrial-demo-SEED" in the current
        folder. If this exists, the date and time are appended to its name.
    seed : int
        Seed of the demo, for the name.

    Raises
    ------
    SeatrialError
        If the folder is not empty or cannot be made.
    """
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
    """Copy a rig file of the mocks to NAME-rig.toml in the folder of the demo, and set its clock speed.

    An existing copy is replaced.

    Parameters
    ----------
    name : str
        Rig of the mocks: "bench" or "boat".
    folder : Path
        Folder of the demo.
    speed : float
        Run seconds per wall second.

    Raises
    ------
    SeatrialError
        If the packaged rig file does not set the clock speed exactly once.
    """
    text = (files("seatrial.mocks") / "rigs" / f"{name}.toml").read_text(encoding="utf-8")
    text, n_found = re.subn(r"(?m)^speed\s*=\s*[0-9.]+", f"speed = {speed!r}", text)
    if n_found != 1:
        raise SeatrialError(f"demo: the packaged rig {name}.toml has no clock speed; install seatrial again")
    write_output(folder / f"{name}-rig.toml", text)


def run_steps(steps: DemoSteps, seed: int, realistic: bool = False) -> list[str]:
    """Run all commands of the demo on mock devices, from the bench run to the diagnosis.

    Parameters
    ----------
    steps : DemoSteps
        Runner of the commands, in the folder of the demo.
    seed : int
        Seed of the mock boat, the mock bench and the missions.
    realistic : bool
        Whether the mock boat has small imperfections beside its hidden effect.

    Returns
    -------
    list of str
        Commands of `seatrial ident` that were left out, such as "`seatrial ident thruster`": the first one that this
        installation lacks, and all later ones. It is empty if all commands were run.

    Raises
    ------
    StepFailed
        If an installed command fails, or a mock does not start.
    DemoInterrupted
        If a signal arrives.
    """
    missing: list[str] = []
    mock = ("mock", "bench", "bench-rig.toml", "--seed", str(seed))
    _record_with_mock(steps, "bench", mock, "bench run", "bench", "all", "bench-rig.toml", "-o", "bench.mcap")
    _run_ident(steps, missing, "thruster model", "ident", "thruster", "bench.mcap", "--out", "thruster")
    _run_mission(steps, seed, 1, ESTIMATION_S, "estimation", realistic)
    _run_mission(steps, seed, 2, VALIDATION_S, "validation", realistic)
    data = ("estimation.mcap", "--validate", "validation.mcap")
    model = ("--thruster", "thruster/model.toml")
    _run_ident(steps, missing, "vehicle model", "ident", "vehicle", data[0], *model, *data[1:], "--out", "vehicle")
    _run_ident(steps, missing, "diagnosis", "ident", "diagnose", "vehicle/model.toml", *data, "--out", "diagnosis")
    return missing


def _run_mission(steps: DemoSteps, seed: int, run: int, seconds: float, name: str, realistic: bool) -> None:
    """Generate a mission file NAME.toml, and run it on a newly started mock boat, into the log NAME.mcap.

    The parameters of the boat and its hidden effect depend only on the seed; the noise differs from run to run.

    Parameters
    ----------
    steps : DemoSteps
        Runner of the commands.
    seed : int
        Seed of the demo.
    run : int
        Number of the run, from 1. The random mission and the noise depend on it.
    seconds : float
        Duration of the mission [run s].
    name : str
        NAME of the mission file and of the log.
    realistic : bool
        Whether the boat has small imperfections beside its hidden effect.

    Raises
    ------
    StepFailed
        If a command fails, or the mock does not start.
    """
    plan, mission_seed = f"{name}.toml", str(100 * seed + run)
    steps.run(
        f"{name} mission",
        *("mission", "generate", "--kind", "mixed", "--seconds", f"{seconds:g}", "--seed", mission_seed, "-o", plan),
    )
    boat = ("mock", "boat", "boat-rig.toml", "--seed", str(seed), "--effect", "draw", "--truth-file", TRUTH)
    mock = (*boat, "--run", str(run), *(["--realistic"] if realistic else []))
    _record_with_mock(steps, "boat", mock, f"{name} run", "mission", "run", plan, "boat-rig.toml", "-o", f"{name}.mcap")


def _record_with_mock(steps: DemoSteps, rig: str, mock: tuple[str, ...], name: str, *words: str) -> None:
    """Record a log from a mock. While this machine is too slow for the clock speed of the rig, repeat at half of it.

    The machine is too slow if the mock sent samples more than 45 ms (wall) late, or if the run skipped more than 100
    set-points (a later one replaced them before they were sent). An attempt at 8 or fewer run seconds per wall second
    is not repeated, so that its log is used even if the machine was too slow.

    Parameters
    ----------
    steps : DemoSteps
        Runner of the commands.
    rig : str
        Rig of the mocks: "bench" or "boat".
    mock : tuple of str
        Arguments of `seatrial` that start the mock.
    name : str
        Name of the step, for the printed time.
    words : str
        Arguments of `seatrial` that record the log. The last one is the name of the log.

    Raises
    ------
    StepFailed
        If the command or the mock of the last attempt fails. The failure of an earlier attempt is ignored.

    Notes
    -----
    At 20 times real time a pause of 50 ms lasts one second of the boat's time. Shaft speeds have no device clock, so
    their stamps are late by the pause. The log of a repeated attempt is kept under another name (NAME-late.mcap,
    NAME-late2.mcap, ...) and not used. The clock speed in the rig file is changed for each repetition; after the last
    attempt the file has its original speed again.
    """
    usual = speed = _clock_speed(steps.folder / f"{rig}-rig.toml")
    for attempt in count(1):
        failed: StepFailed | None = None
        try:
            with steps.mock(*mock):
                steps.run(name, *words)
        except StepFailed as problem:  # after a pause of a second the guard takes a device for silent and ends the run
            failed = problem
        log = steps.folder / words[-1]
        if (steps.late_ms <= LATE_MS and n_skipped(log) <= SKIPPED_MAX) or speed <= SLOWEST:
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
    """Return the number of set-points that a run skipped, from the events "invalid" in its log, the file ``path``.

    Such an event names the losses in one segment of the mission. A set-point is skipped if a later one of the same
    thruster replaces it before it could be sent. If the log does not exist or cannot be read, return 0.
    """
    try:
        with open_log(path) as log:
            matches = [SKIPPED_SETPOINTS.search(text) for _, kind, text in log.events() if kind == "invalid"]
    except SeatrialError:
        return 0
    return sum(int(found[1]) for found in matches if found)


def _clock_speed(rig: Path) -> float:
    """Return the number of run seconds per wall second that the rig file ``rig`` sets (`speed`); 1 if it sets none.

    The first line that begins with `speed =` counts.
    """
    found = re.search(r"(?m)^speed\s*=\s*([0-9.]+)", rig.read_text(encoding="utf-8"))
    return float(found[1]) if found else 1.0


def _run_ident(steps: DemoSteps, missing: list[str], name: str, *words: str) -> None:
    """Run one command of `seatrial ident`, or leave it out and append it to ``missing``.

    The command is left out if it is not installed. It is also left out if ``missing`` is not empty, because it needs
    the result of an earlier command.

    Parameters
    ----------
    steps : DemoSteps
        Runner of the commands.
    missing : list of str
        Commands that were left out so far. It is changed in place.
    name : str
        Name of the step, for the printed time.
    words : str
        Arguments of `seatrial`.

    Raises
    ------
    StepFailed
        If the command is installed and fails.
    """
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
    """Print the outcome of the demo: what the diagnosis found, and which effect the mock boat really had.

    The lines are the conclusion of the diagnosis (`answer` in its result) with its caveat, the prediction errors before
    and after the diagnosis, the path of the report, the found effects and whether they match the hidden effect, and the
    ground truth. Found and hidden effect match if the hidden effect is among the found ones, or if there is neither a
    hidden nor a found effect. For a realistic boat, the names of its small imperfections are printed before the hidden
    effect.

    Parameters
    ----------
    folder : Path
        Folder of the demo, with the ground-truth file `truth.json` and the result of the diagnosis,
        `diagnosis/result.json`.

    Raises
    ------
    SeatrialError
        If one of the two files cannot be read, the result lacks the prediction errors, or the ground truth lacks the
        name of the effect.
    """
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
        raise SeatrialError(
            f"demo: {folder / TRUTH} does not name the hidden effect; start the demo in an empty folder"
        )
    named = found_effects(result)
    match = "match" if effect in named or (effect == "none" and not named) else "do not match"
    click.echo(f"diagnosis: {', '.join(named) or 'none'}; that and the hidden effect {match}")
    minor = [str(row["effect"]) for row in truth.get("minor_effects", [])]
    if minor:
        click.echo(
            f"ground truth: small effects of this boat, which the diagnosis may name as well: {', '.join(minor)}"
        )
    click.echo(f"ground truth: the plant's hidden effect was {effect}{_effect_details(truth)}")


def _effect_details(truth: dict[str, Any]) -> str:
    """Return the description and the parameters of the hidden effect as a text in brackets, after a space.

    ``truth`` is the content of the ground-truth file. The text is empty if it has neither description nor parameters.
    """
    parameters = truth.get("parameters", {}).items()
    numbers = [f"{key} = {value:.4g}" if isinstance(value, float) else f"{key} = {value}" for key, value in parameters]
    texts = [text for text in (truth.get("sentence", ""), ", ".join(numbers)) if text]
    return f" ({'; '.join(texts)})" if texts else ""


def found_effects(result: dict[str, Any]) -> list[str]:
    """Return the names of the effects that a diagnosis has added to the model, in their order there.

    ``result`` is the content of the diagnosis' result.json. Its list "effects" has names, or objects with a name. If
    there is no such list, no name is returned.
    """
    effects = result.get("effects", [])
    return [str(effect["name"] if isinstance(effect, dict) else effect) for effect in effects]


def error_lines(result: dict[str, Any]) -> list[str]:
    """Return a line of text for each output of the model: its RMS prediction error before and after the diagnosis.

    The errors are those on validation data.

    Parameters
    ----------
    result : dict
        Content of the diagnosis' result.json.

    Returns
    -------
    list of str
        Lines in the order of the outputs (channels) in the result.

    Raises
    ------
    SeatrialError
        If the result lacks these errors.
    """
    try:
        channels, horizon = result["errors"]["validation"]["horizon"], result["horizon_seconds"]
        return [_error_line(name, row, horizon) for name, row in channels.items()]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise SeatrialError(
            f"demo: {ANSWER} lacks the prediction errors before and after the diagnosis ({error!r}); start the demo in "
            "an empty folder"
        ) from error


def _error_line(name: str, row: dict[str, Any], horizon: float) -> str:
    """Return a line of text with the prediction errors of the output ``name`` before and after the diagnosis.

    ``row`` has these RMS errors under "before" and "after", and their unit under "unit". ``horizon`` [s] is the time
    over which was predicted. Errors in rad are converted to degrees. An error of None is written as "diverged".
    """
    unit, scale = str(row["unit"]), 1.0
    if unit.startswith("rad"):
        unit, scale = unit.replace("rad", "deg", 1), math.degrees(1.0)
    errors = (row["before"], row["after"])
    before, after = ("diverged" if e is None else f"{scale * e:.3g} {unit}".rstrip() for e in errors)
    return f"  {name:<6} error {horizon:g} s ahead on validation data {before} before, {after} after"


def _read_json(path: Path) -> dict[str, Any]:
    """Return the JSON object in the file ``path``.

    Raises SeatrialError if the file cannot be read, or if its content is not a JSON object.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SeatrialError(f"demo: {path}: cannot be read: {error.strerror}; start the demo again") from error
    except ValueError as error:
        raise SeatrialError(f"demo: {path}: not JSON ({error}); start the demo again") from error
    if not isinstance(content, dict):
        raise SeatrialError(f"demo: {path} is damaged: it is not a JSON object; start the demo again")
    return content


class DemoSteps:
    """Runner of `seatrial` commands as processes in one folder. The context `signals` ends those that still run.

    Attributes
    ----------
    folder : Path
        Working folder of the commands.
    seconds : list of tuple
        Name and wall time [s] of each finished command.
    late_ms : float
        Largest delay [wall ms] with which the last mock sent its samples; 0 before a mock has ended.
    """

    def __init__(self, folder: Path) -> None:
        """Store the folder in which the commands of the demo will run. No process is started.

        The folder is not created here.
        """
        self.folder = folder
        self.seconds: list[tuple[str, float]] = []
        self.late_ms = 0.0
        self._running: list[subprocess.Popen[bytes]] = []
        self._signalled = False

    def run(self, name: str, *words: str) -> None:
        """Run one command of `seatrial` to its end. Print the command before and its wall time after it.

        Parameters
        ----------
        name : str
            Name of the step, for the printed time.
        words : str
            Arguments of `seatrial`.

        Raises
        ------
        StepFailed
            If the exit status of the command is not 0.
        DemoInterrupted
            If a signal arrives inside the context `signals`. The command is then ended.
        """
        click.secho(f"$ seatrial {' '.join(words)}", bold=True)
        start = time.monotonic()
        process = self._start_command(words, stdout=None)
        try:
            status = self._wait_for_end(process)
        finally:
            self._end_process(process)
        self._note_time(name, time.monotonic() - start)
        if status != 0:
            command = " ".join(words[:2])
            live = command.endswith("run") or command.startswith("bench")
            slower = "; if the computer was too busy, give --speed 5" if live else ""
            raise StepFailed(
                f"demo: `seatrial {command}` failed with exit status {status}; follow the advice in the line "
                f"above{slower}"
            )

    def has(self, *words: str) -> bool:
        """Return whether this installation has the command `seatrial WORDS`. It is run with `--help` to find out."""
        command, quiet = module_command("seatrial", *words, "--help"), subprocess.DEVNULL
        done = subprocess.run(
            command, cwd=self.folder, env=module_environment(), stdout=quiet, stderr=quiet, check=False
        )
        return done.returncode == 0

    @contextmanager
    def mock(self, *words: str) -> Iterator[None]:
        """Run a mock in the background while the context lasts. The context begins when the mock prints `ready`.

        At the end of the context the mock is ended and its standard error is printed. `late_ms` is then the largest
        delay that the mock reports, or 0 if it reports none. A mock that is ready, and ends before the end of the
        context, gives no error here.

        Parameters
        ----------
        words : str
            Arguments of `seatrial` that start the mock.

        Raises
        ------
        StepFailed
            If the mock ends before it is ready, or is not ready within 30 s (wall).
        DemoInterrupted
            If a signal arrives before the mock is ready.
        """
        click.secho(f"$ seatrial {' '.join(words)} &", bold=True)
        start = time.monotonic()
        process = self._start_command(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        try:
            self._await_ready(process, start + READY_WITHIN_S)
            click.echo(f"  devices ready after {time.monotonic() - start:.1f} s")
            yield
        finally:
            self._end_process(process)
            assert process.stderr is not None
            output = process.stderr.read().decode(errors="replace")
            process.stderr.close()
            click.echo(output, nl=False, err=True)
            found = LATE.search(output)
            self.late_ms = float(found[1]) if found else 0.0

    def _start_command(
        self, words: Sequence[str], stdout: int | None, stderr: int | None = None
    ) -> subprocess.Popen[bytes]:
        """Start `seatrial WORDS` in the folder of the demo and in a new process session, and return the process.

        ``stdout`` and ``stderr`` are parameters of `subprocess.Popen`: with None the process writes to the stream of
        this process, with `subprocess.PIPE` to a pipe.
        """
        # Ctrl-C at the terminal then reaches only the demo. The demo ends the runner before the mock, so that the
        # runner can still command zero.
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

    def _wait_for_end(self, process: subprocess.Popen[bytes]) -> int:
        """Wait for the end of the process of a command, and return its exit status.

        Raises DemoInterrupted if a signal arrives; the process is not ended here.
        """
        while True:
            try:
                return process.wait(timeout=0.1)
            except subprocess.TimeoutExpired:
                self._check_signal()

    def _await_ready(self, process: subprocess.Popen[bytes], deadline: float) -> None:
        """Wait until a mock prints the line "ready" to its standard output, which must be a pipe.

        Earlier lines are discarded.
        Raises StepFailed at the monotonic time ``deadline`` [s] or if the mock ends, and DemoInterrupted if a signal
        arrives.
        """
        assert process.stdout is not None
        output = b""
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            while b"ready" not in output.splitlines():
                self._check_signal()
                if time.monotonic() > deadline:
                    raise StepFailed(
                        f"demo: the mock devices were not ready within {READY_WITHIN_S:g} s; end other programs, and "
                        "start the demo again"
                    )
                if not selector.select(timeout=0.1):
                    continue
                data = os.read(process.stdout.fileno(), 4096)
                if not data:
                    raise StepFailed(
                        f"demo: the mock devices ended with exit status {process.wait()}; follow the advice in the "
                        "line above"
                    )
                output += data

    def _check_signal(self) -> None:
        """Raise DemoInterrupted if SIGINT, SIGTERM or SIGHUP has arrived since the context `signals` began."""
        if self._signalled:
            raise DemoInterrupted(
                "demo: interrupted; the simulated thrusters are at zero, and the mock devices are stopped"
            )

    def _end_process(self, process: subprocess.Popen[bytes]) -> None:
        """End a process and its group by SIGTERM, and by SIGKILL if it still runs after 10 s (wall).

        A process that has ended already gets no signal. In both cases its standard output is closed if it is a pipe,
        and the process is removed from the list of running processes.
        """
        # SIGTERM and not SIGINT: it ends a Python process that is still importing without a traceback.
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

    def _note_time(self, name: str, seconds: float) -> None:
        """Append the wall time [s] of the finished step ``name`` of the demo to `seconds`, and print it."""
        self.seconds.append((name, seconds))
        click.secho(f"  {name}: {seconds:.1f} s", dim=True)

    @contextmanager
    def signals(self) -> Iterator[None]:
        """Handle SIGINT, SIGTERM and SIGHUP while the context lasts: a signal ends the demo by DemoInterrupted.

        The error is raised by the present or the next wait for a command or a mock, not by the handler.
        At the end of the context all commands that still run are ended, the newest first, and the earlier signal
        handlers are restored.
        """

        def note_signal(number: int, frame: FrameType | None) -> None:
            """Store that a signal has arrived. The wait for a command then raises DemoInterrupted."""
            self._signalled = True

        old = {number: signal.signal(number, note_signal) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
        try:
            yield
        finally:
            for process in reversed(self._running[:]):
                self._end_process(process)
            for number, handler in old.items():
                signal.signal(number, handler)
