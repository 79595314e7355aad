"""Tests of the arrangement of the suite: groups stay on one worker, and the list of port tests is complete."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.conftest import BESIDE, COMPUTING_NICENESS, LONG, PORTS, group_of
from tests.stalls import StallWatch

ROOT = Path(__file__).parents[1]


def test_groups_are_by_file() -> None:
    assert {group_of(f"{file}::test_a[1]") for file in PORTS} == {"ports"}
    assert {group_of(f"{file}::test_a[1]") for file in BESIDE} == {"beside"}
    assert group_of("tests/daq/log/test_reader.py::test_a") == "tests/daq/log/test_reader.py"
    for file in (*PORTS, *BESIDE, *LONG):
        assert (ROOT / file).is_file(), file


def test_a_group_runs_on_one_worker() -> None:
    """Six cheap tests of one group run on two workers. Without groups both workers would get some."""
    pytest.importorskip("xdist", reason="runs the tests on two workers, which pytest-xdist does")
    words = ["-n", "2", "--dist", "loadgroup", "-v", "-p", "no:cacheprovider", "tests/daq/transport/test_transport.py"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *words], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stdout
    workers = re.findall(r"\[(gw\d)\] \[ *\d+%\] PASSED", done.stdout)
    assert len(workers) > 4
    assert len(set(workers)) == 1


def test_workers_that_compute_have_a_lower_priority_than_other_sessions() -> None:
    code = "from tests.conftest import step_back; step_back(); step_back(); import os; print(os.nice(0), os.getsid(0))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60, check=True
    )
    niceness, session = map(int, done.stdout.split())
    assert niceness == COMPUTING_NICENESS
    assert session != os.getsid(0)


OPENS_PORTS = re.compile(
    r"\bopenpty\(|tests\.daq\.ptys|tests\.bench\.mock_process|standin import .*\b(StandIn|until)\b|import mocks\.ports"
)


def test_every_test_that_opens_real_ports_is_in_the_group() -> None:
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        if path != Path(__file__) and OPENS_PORTS.search(path.read_text(encoding="utf-8")):
            assert path.relative_to(ROOT).as_posix() in (*PORTS, *BESIDE), path


STANDS = """
from tests.stalls import run_repeated, summarise

class Stalls:
    def longest(self, since):
        return {stall}

def pytest_runtest_protocol(item, nextitem):
    return run_repeated(item, nextitem, Stalls())

def pytest_terminal_summary(terminalreporter):
    summarise(terminalreporter)
"""
LATE = """
import pytest
runs, tries = [], []

@pytest.fixture(scope="module")
def slow():
    tries.append(1)
    assert len(tries) > 1

def test_late_once():
    runs.append(1)
    assert len(runs) == 2

def test_late_fixture(slow):
    pass

def test_wrong():
    assert False
"""


def test_a_failure_during_a_stall_is_repeated_at_most_twice_and_named(tmp_path: Path) -> None:
    (tmp_path / "test_late.py").write_text(LATE, encoding="utf-8")
    found = []
    for stall in (0.3, 0.01):
        (tmp_path / "conftest.py").write_text(STANDS.format(stall=stall), encoding="utf-8")
        words = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--rootdir", str(tmp_path), str(tmp_path)]
        done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
        found.append(done.stdout)
    assert "1 failed, 2 passed" in found[0]
    assert "test_late.py::test_late_once: 0.30 s" in found[0]
    assert "test_late.py::test_wrong: 0.30, 0.30 s" in found[0]
    assert "2 failed, 1 error" in found[1]
    assert "repeated" not in found[1]


def test_a_blocked_core_is_detected() -> None:
    watch = StallWatch()
    try:
        began = time.monotonic()
        wait_until = began + 5.0
        # A watcher that is stopped before it has started measures nothing, so the core is blocked until it does.
        while watch.longest(began) < 0.25 and time.monotonic() < wait_until:
            for number in (signal.SIGSTOP, signal.SIGCONT):  # a host takes the core away in the same way
                time.sleep(0.3)
                watch.watchers[0].send_signal(number)
            time.sleep(0.1)
        assert 0.25 < watch.longest(began) < 5.0
        assert watch.longest(time.monotonic() + 1.0) == 0.0
    finally:
        watch.close()
