"""Running the demo's commands: each in a process group of its own, echoed, timed, and ended with the demo."""

from __future__ import annotations

import os
import re
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import click

from daq.errors import SeatrialError

READY_WITHIN_S = 30.0  # wall seconds for a mock to open its ports; it may have to be compiled first
LATE = re.compile(r"(?:at most|up to) ([0-9.]+) ms")
PATIENCE_S = 10.0  # wall seconds between a polite signal and the next one


class StepFailed(SeatrialError):
    """A command of the demo failed; the message names it."""


class Interrupted(SeatrialError):
    """The user ended the demo."""

    exit_status = 130


class Steps:
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
            said = " ".join(words[:2])
            live = said.endswith("run") or said.startswith("bench")
            slower = "; was the machine too busy? --speed 5 asks less of it" if live else ""
            raise StepFailed(f"demo: `seatrial {said}` failed with exit status {status} (see above){slower}")

    def has(self, *words: str) -> bool:
        """Whether this installation has the command, by its --help."""
        command = [sys.executable, "-m", "seatrial", *words, "--help"]
        quiet = subprocess.DEVNULL
        return subprocess.run(command, cwd=self.folder, stdout=quiet, stderr=quiet, check=False).returncode == 0

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
            said = process.stderr.read().decode(errors="replace")
            process.stderr.close()
            click.echo(said, nl=False, err=True)
            found = LATE.search(said)
            self.late_ms = float(found[1]) if found else 0.0

    def _start(self, words: Sequence[str], stdout: int | None, stderr: int | None = None) -> subprocess.Popen[bytes]:
        # A session of its own: a Ctrl-C at the terminal reaches the demo alone, which then ends the runner before
        # the mock, so that the runner can still command zero.
        sys.stdout.flush()
        command = [sys.executable, "-m", "seatrial", *words]
        process = subprocess.Popen(
            command,
            cwd=self.folder,
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
        said = b""
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            while b"ready" not in said.splitlines():
                self._check_signal()
                if time.monotonic() > deadline:
                    raise StepFailed(f"demo: the mock devices were not ready within {READY_WITHIN_S:g} s")
                if not selector.select(timeout=0.1):
                    continue
                data = os.read(process.stdout.fileno(), 4096)
                if not data:
                    raise StepFailed(f"demo: the mock devices ended with exit status {process.wait()} (see above)")
                said += data

    def _check_signal(self) -> None:
        if self._signalled:
            raise Interrupted("demo: interrupted; thrusters at zero, mock devices stopped")

    def _end(self, process: subprocess.Popen[bytes]) -> None:
        """End a process and its group, politely first; nothing is left behind."""
        # SIGTERM rather than SIGINT: a Python that is still importing dies of it without a traceback.
        for number in (signal.SIGTERM, signal.SIGKILL):
            if process.poll() is not None:
                break
            os.killpg(process.pid, number)
            try:
                process.wait(timeout=PATIENCE_S)
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
