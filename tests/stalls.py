"""Detection of times in which the machine ran no program, and repetition of tests with deadlines in such times.

A test may kill a process and expect zero thrust 0.1 s later. If the machine stood still for 0.3 s meanwhile, the test
judges the machine instead of seatrial. Causes are a virtual core taken away by its host, or three workers on two cores.
Such a test is repeated at most twice, and the summary names it. A test that fails without a stall has failed.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import subprocess
import sys
import tempfile
import time
from typing import Protocol

import pytest
from _pytest.runner import runtestprotocol

STALL_S = 0.05  # the shortest deadlines of tests are 0.1 s
REPEATS = 2
PROPERTY = "repeated: s for which the machine had stood"
# One watcher on each core, at the priority of the tests with deadlines. It ends when the worker does.
WATCHER = """
import os, select, sys, time
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {int(sys.argv[1])})
before, ended = time.monotonic(), False
while not ended:
    ended = bool(select.select([0], [], [], 0.005)[0])
    now = time.monotonic()
    if now - before > 0.02:
        print(before, now, flush=True)
    before = now
"""


class Watching(Protocol):
    """Interface of an object that detects stalls."""

    def longest(self, since: float) -> float:
        """Return the longest stall that ended after ``since`` (monotonic s) [s], or 0 if there was none."""


class StallWatch:
    """Watchers on all cores that this process may use."""

    def __init__(self) -> None:
        self._seen = tempfile.TemporaryFile("w+")  # noqa: SIM115 - as long as the worker lives
        # The watchers share the file position with us and would overwrite the data that we have read.
        fcntl.fcntl(self._seen, fcntl.F_SETFL, fcntl.fcntl(self._seen, fcntl.F_GETFL) | os.O_APPEND)
        cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else [0]
        self.watchers = [
            subprocess.Popen(
                [sys.executable, "-I", "-S", "-c", WATCHER, str(core)], stdin=subprocess.PIPE, stdout=self._seen
            )
            for core in cores
        ]

    def longest(self, since: float) -> float:
        self._seen.seek(0)
        stalls = [[float(word) for word in line.split()] for line in self._seen if line.endswith("\n")]
        return max((end - begin for begin, end in stalls if end > since), default=0.0)

    def close(self) -> None:
        """End the watchers."""
        for watcher in self.watchers:
            assert watcher.stdin is not None
            with contextlib.suppress(BrokenPipeError):
                watcher.stdin.close()
            watcher.wait(10.0)
        self._seen.close()


def run_repeated(item: pytest.Item, nextitem: pytest.Item | None, watch: Watching) -> bool:
    """Run a test as pytest does, and repeat it if it failed during a stall. Return the result of the hook."""
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for left in reversed(range(REPEATS + 1)):
        began = time.monotonic()
        reports = runtestprotocol(item, log=False, nextitem=nextitem)
        stall = watch.longest(began)
        if left == 0 or stall < STALL_S or not any(report.failed for report in reports):
            break
        item.user_properties.append((PROPERTY, f"{stall:.2f}"))
        _forget_failed_fixtures(item)
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def _forget_failed_fixtures(item: pytest.Item) -> None:
    """Reset the fixtures of the module that failed.

    Otherwise pytest would report the same failure without a new attempt.
    """
    item._initrequest()  # type: ignore[attr-defined]
    for definitions in item._fixtureinfo.name2fixturedefs.values():  # type: ignore[attr-defined]
        for definition in definitions:
            if definition.cached_result is not None and definition.cached_result[2] is not None:
                definition.finish(item._request)  # type: ignore[attr-defined]


def summarise(terminal: pytest.TerminalReporter) -> None:
    """Name the repeated tests."""
    done = [
        (report.nodeid, [str(value) for name, value in report.user_properties if name == PROPERTY])
        for kind in ("passed", "failed")
        for report in terminal.stats.get(kind, [])
        if getattr(report, "when", "") == "call"
    ]
    repeated = [(nodeid, stalls) for nodeid, stalls in done if stalls]
    if repeated:
        terminal.section("repeated, since the machine stood still")
        for nodeid, stalls in repeated:
            terminal.line(f"{nodeid}: {', '.join(stalls)} s")
