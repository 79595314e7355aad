"""How things are timed here, and what a result looks like."""

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
    """One number of the table; ``peer``: what another program reached on the same data, where there is one."""

    group: str
    name: str
    value: float
    unit: str
    peer: float | None = None
    note: str = ""


def best_ms(call: Callable[[], object], repeats: int = 10) -> float:
    """The least time of a call, ms: what else the machine does only adds to it. The first call is not counted."""
    call()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return 1e3 * min(times)


@dataclass(frozen=True)
class Child:
    """What a process took: CPU [s], wall [s]; and what it reported, one line of JSON."""

    cpu: float
    wall: float
    report: dict[str, float]


def child(words: Sequence[str], folder: Path, environment: Mapping[str, str]) -> Child:
    """Run a process to its end and ask the system what it took. Raises CalledProcessError where it fails."""
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
    """The largest resident memory of this process so far [MB]. Not getrusage's on Linux: that begins with what the
    parent had."""
    status = Path("/proc/self/status")
    if status.exists():
        lines = dict(line.split(":", 1) for line in status.read_text(encoding="ascii").splitlines() if ":" in line)
        return int(lines["VmHWM"].split()[0]) / 1024
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1 << 20 if sys.platform == "darwin" else 1 << 10)


def table(figures: list[Figure]) -> str:
    """Lines for people, a heading a group."""
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
    if abs(value) < 10_000:
        return f"{value:.4g}"
    return f"{value:.4f}" if value < 0 else f"{value:,.0f}"  # a likelihood to its last digit, a rate in round numbers
