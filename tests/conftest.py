"""Who runs beside whom: tests that watch the clock take turns, and what takes long begins early.

`pytest -n 2 --dist loadgroup` groups by the places below, with a scheduler of our own: pytest-xdist 3.8 groups by a
mark that it writes into the tests' names, which pytest 9.2 no longer takes (pytest-xdist issue 1386).
"""

from __future__ import annotations

import signal
from typing import Any

import pytest

# Whoever starts the tests in the background of a script has them ignore Ctrl-C, and every process that they start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Real ports with deadlines of some milliseconds: two of these at a time would only measure each other.
PORTS = (
    "tests/bench/test_check_live.py",
    "tests/bench/test_course.py",
    "tests/bench/test_dronecan.py",
    "tests/bench/test_fault_trials.py",
    "tests/bench/test_mavlink.py",
    "tests/bench/test_run.py",
    "tests/bench/test_stops.py",
    "tests/bench/test_watchdog.py",
    "tests/bench/test_with_mocks.py",
    "tests/daq/test_acquire.py",
    "tests/daq/test_acquire_thrust.py",
    "tests/daq/test_find_devices.py",
    "tests/daq/test_live.py",
    "tests/daq/test_load.py",
    "tests/daq/test_poll_talker.py",
    "tests/daq/test_replay.py",
    "tests/daq/test_segments.py",
    "tests/daq/test_transport.py",
    "tests/mocks/test_cli.py",
    "tests/mocks/test_ports.py",
    "tests/mocks/test_slcan.py",
)
# Fixtures that are expensive and belong to a module: one worker makes them, once.
TOGETHER = (
    "tests/ident/test_ident_cli.py",
    "tests/ident/test_score.py",
    "tests/ident/test_sides.py",
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
