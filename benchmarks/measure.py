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
    """One number of the table of a benchmark.

    Attributes
    ----------
    group : str
        Heading under which the number stands.
    name : str
        Name of the number.
    value : float
        The number.
    unit : str
        Its unit; may be empty.
    peer : float or None
        Value of another program on the same data, in the same unit; None if there is no such program.
    note : str
        Remark behind the number; may be empty.
    """

    group: str
    name: str
    value: float
    unit: str
    peer: float | None = None
    note: str = ""


def best_ms(call: Callable[[], object], repeats: int = 10) -> float:
    """Return the shortest wall time [ms] of ``repeats`` calls of a function, after a first call that does not count.

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
    """Time of a child process, and its report.

    Attributes
    ----------
    cpu : float
        CPU time of the process in user and system mode [s].
    wall : float
        Wall time from start to end [s].
    report : dict of str to float
        JSON object that the process printed.
    """

    cpu: float
    wall: float
    report: dict[str, float]


def child(words: Sequence[str], folder: Path, environment: Mapping[str, str]) -> Child:
    """Run a process to its end and return its time and its report, which it must print to standard output as JSON.

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
    """Return the figures as text: a line for each figure, and a heading where the group changes."""
    lines, group = [], ""
    for f in figures:
        if f.group != group:
            group = f.group
            lines += ["", group]
        peer = "" if f.peer is None else f"   peer {f.peer:.9g} {f.unit}"
        note = f"   {f.note}" if f.note else ""
        lines.append(f"  {f.name:<42} {_format_number(f.value):>14} {f.unit:<12}{peer}{note}".rstrip())
    return "\n".join(lines[1:])


def _format_number(value: float) -> str:
    """Return a number as text with four digits.

    Numbers of 10,000 and more are rounded to integers. Those of -10,000 and less are log-likelihoods and get four
    decimals.
    """
    if abs(value) < 10_000:
        return f"{value:.4g}"
    return f"{value:.4f}" if value < 0 else f"{value:,.0f}"
