"""The suite's own arrangement: groups keep to one worker, and the list of port tests is complete."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import BESIDE, LONG, PORTS, group_of

ROOT = Path(__file__).parents[1]


def test_groups_are_by_file() -> None:
    assert {group_of(f"{file}::test_a[1]") for file in PORTS} == {"ports"}
    assert {group_of(f"{file}::test_a[1]") for file in BESIDE} == {"beside"}
    assert group_of("tests/daq/log/test_reader.py::test_a") == "tests/daq/log/test_reader.py"
    for file in (*PORTS, *BESIDE, *LONG):
        assert (ROOT / file).is_file(), file


def test_a_group_runs_on_one_worker() -> None:
    """Six cheap tests of one group on two workers; without groups both would have some."""
    pytest.importorskip("xdist", reason="runs the tests on two workers, which pytest-xdist does")
    words = ["-n", "2", "--dist", "loadgroup", "-v", "-p", "no:cacheprovider", "tests/daq/transport/test_transport.py"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *words], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stdout
    workers = re.findall(r"\[(gw\d)\] \[ *\d+%\] PASSED", done.stdout)
    assert len(workers) > 4
    assert len(set(workers)) == 1


OPENS_PORTS = re.compile(
    r"\bopenpty\(|tests\.daq\.ptys|tests\.bench\.mock_process|standin import .*\b(StandIn|until)\b|import mocks\.ports"
)


def test_every_test_that_opens_real_ports_is_in_the_group() -> None:
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        if path != Path(__file__) and OPENS_PORTS.search(path.read_text(encoding="utf-8")):
            assert path.relative_to(ROOT).as_posix() in (*PORTS, *BESIDE), path
