"""Distribution of the tests over the workers: tests with deadlines take turns, and long tests start early.

`pytest -n 3 --dist loadgroup` groups by the places below, with a scheduler of our own: pytest-xdist 3.8 groups by a
mark that it writes into the tests' names, which pytest 9.2 no longer takes (pytest-xdist issue 1386).

One worker begins with all tests of real ports. They mostly wait, so there is one worker more than cores; the others
compute at a lower priority and leave the cores to them.
"""

from __future__ import annotations

import os
import signal
import sys
from typing import Any

import pytest

# As `seatrial ident` does, and before any test imports numpy: all matrices are small, and threads of the linear algebra
# library would only wait for each other and for the other worker.
for library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

# Hundreds of tests start a process: a second of CPU each, where Python may not keep what it has compiled.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Whoever starts the tests in the background of a script has them ignore Ctrl-C, and every process that they start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Real ports and processes with deadlines of some milliseconds: two of these at a time would disturb each other.
PORTS = (
    "tests/bench/preflight/test_check_live.py",
    "tests/bench/execution/test_sequencer.py",
    "tests/bench/execution/test_dronecan.py",
    "tests/bench/execution/test_follow.py",
    "tests/bench/execution/test_operator_interface.py",
    "tests/bench/execution/test_fault_trials.py",
    "tests/bench/execution/test_mavlink.py",
    "tests/bench/execution/test_runner.py",
    "tests/bench/execution/test_stops.py",
    "tests/bench/execution/test_watchdog.py",
    "tests/bench/execution/test_with_mocks.py",
    "tests/daq/acquisition/test_acquire.py",
    "tests/daq/acquisition/test_acquire_thrust.py",
    "tests/daq/acquisition/test_ardurover.py",
    "tests/daq/tools/test_discovery.py",
    "tests/daq/tools/test_live.py",
    "tests/daq/acquisition/test_load.py",
    "tests/daq/drivers/test_polling.py",
    "tests/daq/tools/test_replay.py",
    "tests/daq/tools/test_ros_live.py",
    "tests/daq/log/test_segments.py",
    "tests/daq/test_clock.py",
    "tests/daq/transport/test_network_port.py",
    "tests/daq/transport/test_transport.py",
    "tests/mocks/test_cli.py",
    "tests/mocks/ports/test_ports.py",
    "tests/mocks/devices/test_slcan.py",
    "tests/test_demo.py",
)
COMPUTING_NICENESS = 10  # of workers, in tests that are not of PORTS
# Fixtures that are expensive and belong to a module: one worker makes them, once.
TOGETHER = (
    "tests/ident/cli/test_commands.py",
    "tests/ident/diagnosis/test_score_test.py",
    "tests/ident/checks/test_thruster_sides.py",
    "tests/test_package.py",
    "tests/test_site.py",
)


def group_of(nodeid: str) -> str:
    """Tests of one group run on one worker, one after the other; most tests are a group of their own."""
    file = nodeid.partition("::")[0]
    if file in PORTS:
        return "ports"
    return file if file in TOGETHER or file.startswith("tests/measured/") else nodeid


def _order(item: pytest.Item) -> int:
    if item.nodeid.partition("::")[0] in PORTS:
        return 0
    if item.get_closest_marker("slow") is not None:
        return 1
    return 3 if group_of(item.nodeid) == item.nodeid else 2


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes long comes first, so that none of it begins when all else is done."""
    items.sort(key=_order)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """A worker that computes, with all processes that it starts, leaves the cores to the one with the ports."""
    niceness = os.getpriority(os.PRIO_PROCESS, 0)
    if "PYTEST_XDIST_WORKER" in os.environ and group_of(item.nodeid) != "ports" and niceness < COMPUTING_NICENESS:
        os.nice(COMPUTING_NICENESS - niceness)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """The scheduler for --dist loadgroup; other ways of distribution are left to pytest-xdist."""
    if config.getvalue("dist") != "loadgroup":
        return None
    from xdist.scheduler.loadscope import LoadScopeScheduling

    class ByPlace(LoadScopeScheduling):
        """Work units by `group_of`, in the order of collection."""

        def _split_scope(self, nodeid: str) -> str:
            return group_of(nodeid)

    config.option.loadscopereorder = False
    return ByPlace(config, log)
