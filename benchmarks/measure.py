"""Measurement of time and memory, and the table of figures."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Figure:
    """One number of the table."""

    group: str  # heading
    name: str
    value: float
    unit: str
    peer: float | None = None  # value of another program on the same data
    note: str = ""


def best_ms(call: Callable[[], object], repeats: int = 10) -> float:
    """Return the shortest wall time of a call [ms]. The first call does not count.

    The shortest time is the best estimate, since other programs only make a call longer.
    """
    call()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return 1e3 * min(times)


@dataclass(frozen=True)
class Child:
    """Time of a child process, and its report."""

    cpu: float  # s
    wall: float  # s
    report: dict[str, float]  # JSON that the process printed


def child(words: Sequence[str], folder: Path, environment: Mapping[str, str]) -> Child:
    """Run a process to its end and return its time and its report.

    Parameters
    ----------
    words : sequence of str
        Command line.
    folder : Path
        Working folder.
    environment : mapping of str to str
        Environment variables.

    Raises
    ------
    subprocess.CalledProcessError
        If the process fails.
    """
    began = time.perf_counter()
    with subprocess.Popen(words, cwd=folder, env=dict(environment), stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        output = process.stdout.read()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, list(words))
    return Child(used.ru_utime + used.ru_stime, time.perf_counter() - began, json.loads(output))


def peak_mb() -> float:
    """Return the largest resident memory of this process so far [MB]."""
    # On Linux the value of getrusage is not used, since it starts with the memory of the parent process.
    status = Path("/proc/self/status")
    if status.exists():
        lines = dict(line.split(":", 1) for line in status.read_text(encoding="ascii").splitlines() if ":" in line)
        return int(lines["VmHWM"].split()[0]) / 1024
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1 << 20 if sys.platform == "darwin" else 1 << 10)


def table(figures: list[Figure]) -> str:
    """Return the figures as lines of text, with a heading for each group."""
    lines, group = [], ""
    for f in figures:
        if f.group != group:
            group = f.group
            lines += ["", group]
        peer = "" if f.peer is None else f"   peer {f.peer:.9g} {f.unit}"
        note = f"   {f.note}" if f.note else ""
        lines.append(f"  {f.name:<42} {_number(f.value):>14} {f.unit:<12}{peer}{note}".rstrip())
    return "\n".join(lines[1:])


def _number(value: float) -> str:
    """Return a number as text. Large negative numbers are log-likelihoods and get four decimals."""
    if abs(value) < 10_000:
        return f"{value:.4g}"
    return f"{value:.4f}" if value < 0 else f"{value:,.0f}"
