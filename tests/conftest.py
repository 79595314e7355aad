"""Distribution of the tests over the workers: tests with deadlines take turns, and long files start early.

`pytest -n 3 --dist loadgroup` groups by the places below, with a scheduler of our own: pytest-xdist 3.8 groups by a
mark that it writes into the tests' names, which pytest 9.2 no longer takes (pytest-xdist issue 1386).

One worker begins with all tests of real ports, another with those beside them. They mostly wait, so there is one worker
more than cores; tests that compute do so at a lower priority and leave the cores to them. One with deadlines that
failed while the machine stood still is repeated (tests/stalls.py).
"""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

from tests.stalls import StallWatch, run_repeated, summarise

# As `seatrial` does, and before any test imports numpy: all matrices are small, and threads of the linear algebra
# library would only wait for each other and for the other worker.
for library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

# Hundreds of tests start a process: a second of CPU each, where Python may not keep what it has compiled.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# What tests run is not remembered as the user's own (seatrial.ident.models.user_code).
os.environ["SEATRIAL_KNOWN_CODE"] = str(Path(tempfile.mkdtemp(prefix="seatrial-tests-")) / "known-code")

# Whoever starts the tests in the background of a script has them ignore Ctrl-C, and every process that they start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Real ports and processes with deadlines of some milliseconds: two of these at a time would disturb each other.
PORTS = (
    "tests/bench/preflight/test_check_live.py",
    "tests/bench/execution/test_sequencer.py",
    "tests/daq/acquisition/test_watchdog_parts.py",
    "tests/daq/test_child_process.py",
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
    "tests/daq/tools/test_discovery.py",
    "tests/daq/tools/test_live.py",
    "tests/daq/tools/test_live_table.py",
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
)
# Real time too, but with deadlines of tenths of a second, or that set themselves right on a busy machine.
BESIDE = ("tests/daq/acquisition/test_ardurover.py", "tests/test_demo.py")
# What computes for more than ten seconds, the longest first.
LONG = (
    "tests/test_package.py",
    "tests/recovery/test_recovery.py",
    "tests/ident/validation/test_horizon.py",
    "tests/ident/report/test_report.py",
    "tests/ident/workflows/test_thruster_options.py",
    "tests/ident/cli/test_commands.py",
    "tests/ident/models/test_rotations.py",
    "tests/ident/diagnosis/test_thruster_diagnosis.py",
    "tests/ident/workflows/test_thrust_scale.py",
    "tests/ident/navigation/test_navigation.py",
    "tests/ident/studies/test_study.py",
    "tests/ident/models/test_driven_shaft.py",
    "tests/measured/test_foreign.py",
    "tests/ident/diagnosis/test_diagnose_curve.py",
    "tests/ident/diagnosis/test_search.py",
    "tests/recovery/test_misuse.py",
    "tests/ident/engine/test_ekf_adjoint.py",
    "tests/ident/effects/test_weak_effects.py",
    "tests/ident/experiment_design/test_optimal_design.py",
    "tests/ident/cli/test_design_cli.py",
    "tests/ident/workflows/test_vehicle_options.py",
    "tests/ident/estimation/test_sde_bench.py",
    "tests/ident/export/test_export.py",
    "tests/ident/validation/test_whiteness.py",
    "tests/ident/report/test_report_browser.py",
    "tests/ident/models/test_kinematic.py",
    "tests/recovery/test_bench_recovery.py",
    "tests/ident/studies/test_study_starts.py",
    "tests/bench/preflight/test_check_log.py",
    "tests/ident/characterisation/test_sensor_noise.py",
    "tests/ident/checks/test_thruster_sides.py",
    "tests/mocks/hidden_effects/test_hidden_effects.py",
    "tests/recovery/test_rigs.py",
)
COMPUTING_NICENESS = 19  # of workers, in tests that compute
WATCH = pytest.StashKey[StallWatch]()
STEPPED_BACK = threading.Event()


def group_of(nodeid: str) -> str:
    """Tests of one group run on one worker, one after the other: those of a file, which share its fixtures."""
    file = nodeid.partition("::")[0]
    return "ports" if file in PORTS else "beside" if file in BESIDE else file


ORDER = {group: k for k, group in enumerate(("ports", "beside", *LONG))}


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Modules and tests stay until the end: nothing of them is looked through for garbage, now or later."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes long comes first, so that none of it begins when all else is done."""
    items.sort(key=lambda item: ORDER.get(group_of(item.nodeid), len(ORDER)))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """A worker that computes, with all processes that it starts, leaves the cores to those in real time."""
    computes = group_of(item.nodeid) not in ("ports", "beside")
    if "PYTEST_XDIST_WORKER" in os.environ and computes:
        step_back()


def step_back() -> None:
    """The least priority, once: of this process, and of its session where Linux shares the cores by sessions.

    There a nice process takes as much as another session's: and acquisition and watchdog have sessions of their own.
    """
    if STEPPED_BACK.is_set():
        return
    STEPPED_BACK.set()
    os.nice(COMPUTING_NICENESS - os.getpriority(os.PRIO_PROCESS, 0))
    with contextlib.suppress(OSError):  # no Linux, or no such share
        os.setsid()
        Path("/proc/self/autogroup").write_text(str(COMPUTING_NICENESS), encoding="ascii")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Tests with deadlines are repeated where the machine, and not seatrial, was late."""
    if group_of(item.nodeid) not in ("ports", "beside"):
        return None
    watch = item.config.stash.get(WATCH, None)
    if watch is None:
        watch = item.config.stash[WATCH] = StallWatch()
        item.config.add_cleanup(watch.close)
    return run_repeated(item, nextitem, watch)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Repetitions are named."""
    summarise(terminalreporter)


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
