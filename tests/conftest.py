"""Distribution of the tests over the workers: tests with deadlines take turns, and long files start early.

`pytest -n 3 --dist loadgroup` groups the tests by the lists below, with a scheduler of the project. pytest-xdist 3.8
groups by a mark that it writes into the names of the tests, which pytest 9.2 no longer accepts (pytest-xdist issue
1386).

One worker begins with all tests of real ports, another worker with the tests of the second list. These tests mostly
wait, so there is one worker more than cores. Tests that compute have a lower priority and leave the cores to the
others. A test with deadlines that failed while the machine was suspended is repeated (tests/stalls.py).
"""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from tests.stalls import StallWatch, run_repeated, summarise

# As in `seatrial`, and before any test imports numpy: all matrices are small, so threads of the linear algebra library
# would only wait for each other and for the other worker.
for library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

# Hundreds of tests start a process, which takes a second of CPU if Python may not keep compiled files.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# The time of an example depends on the machine and on the other workers, and says nothing about the code.
settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")

# Code that the tests run is not registered as the user's own (seatrial.ident.models.user_code).
os.environ["SEATRIAL_KNOWN_CODE"] = str(Path(tempfile.mkdtemp(prefix="seatrial-tests-")) / "known-code")

# A script that starts the tests in the background makes them, and every process they start, ignore Ctrl-C.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Real ports and processes with deadlines of some milliseconds: two such tests at a time would disturb each other.
PORTS = (
    "tests/bench/preflight/test_check_live.py",
    "tests/bench/execution/test_sequencer.py",
    "tests/daq/acquisition/test_watchdog_parts.py",
    "tests/daq/test_child_process.py",
    "tests/bench/execution/test_dronecan.py",
    "tests/bench/execution/test_follow.py",
    "tests/bench/execution/test_operator_interface.py",
    "tests/bench/execution/test_fault_trials.py",
    "tests/bench/execution/test_live_page.py",
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
    "tests/daq/new_rig/test_init.py",
    "tests/daq/view/test_view_command.py",
    "tests/daq/tools/test_ros_live.py",
    "tests/daq/log/test_segments.py",
    "tests/daq/test_clock.py",
    "tests/daq/transport/test_network_port.py",
    "tests/daq/transport/test_transport.py",
    "tests/mocks/test_cli.py",
    "tests/test_live_blocks.py",
    "tests/mocks/ports/test_ports.py",
    "tests/mocks/devices/test_slcan.py",
)
# Tests in real time with deadlines of tenths of a second, or that adapt to a busy machine.
BESIDE = ("tests/daq/acquisition/test_ardurover.py", "tests/test_demo.py")
# Tests that compute for more than five seconds, the longest first.
LONG = (
    "tests/test_blocks.py",
    "tests/test_coming_from.py",
    "tests/test_notebooks.py",
    "tests/test_how_to.py",
    "tests/api/test_api.py",
    "tests/ident/workflows/test_changes.py",
    "tests/ident/workflows/test_fleet.py",
    "tests/ident/cli/test_commands.py",
    "tests/ident/workflows/test_ros2_node.py",
    "tests/ident/workflows/test_thrust_scale.py",
    "tests/ident/workflows/test_compare.py",
    "tests/ident/cli/test_design_cli.py",
    "tests/ident/studies/test_study.py",
    "tests/ident/checks/test_heading_offset.py",
    "tests/ident/parallel/test_dask.py",
    "tests/ident/export/test_joined.py",
    "tests/ident/engine/test_ekf_adjoint.py",
    "tests/ident/export/test_export.py",
    "tests/ident/navigation/test_navigation.py",
    "tests/ident/report/test_report_browser.py",
    "tests/ident/report/test_report.py",
    "tests/ident/export/test_fmu.py",
    "tests/ident/export/test_simulation.py",
    "tests/test_site.py",
    "tests/ident/checks/test_clock_step.py",
    "tests/ident/workflows/test_vehicle_options.py",
    "tests/ident/experiment_design/test_optimal_design.py",
    "tests/ident/workflows/test_vehicle_realistic.py",
    "tests/ident/workflows/test_control.py",
    "tests/recovery/test_recovery.py",
    "tests/test_tutorials.py",
    "tests/ident/checks/test_thruster_sides.py",
    "tests/daq/log/test_reader.py",
    "tests/ident/report/test_report_dynamics.py",
    "tests/ident/workflows/test_use_a_model.py",
    "tests/ident/estimation/test_excitation.py",
    "tests/bench/preflight/test_check_devices.py",
    "tests/ident/models/test_models_small.py",
    "tests/daq/view/test_page_browser.py",
    "tests/test_groups.py",
    "tests/ident/diagnosis/test_candidates.py",
    "tests/ident/characterisation/test_sensor_noise.py",
    "tests/bench/execution/test_guard_machine.py",
    "tests/ident/validation/test_calibration.py",
    "tests/ident/workflows/test_thruster_options.py",
    "tests/ident/characterisation/test_bench_conditions.py",
    "tests/ident/characterisation/test_thruster.py",
    "tests/bench/preflight/test_check_log.py",
    "tests/ident/parallel/test_tasks.py",
    "tests/test_troubleshooting.py",
    "tests/ident/workflows/test_vehicle.py",
    "tests/ident/estimation/test_sde_bench.py",
    "tests/ident/effects/test_effect_order.py",
    "tests/daq/importers/test_text_dialects.py",
    "tests/ident/workflows/test_moved.py",
    "tests/ident/diagnosis/test_diagnose_curve.py",
    "tests/ident/experiment_design/test_information.py",
    "tests/daq/log/test_log_damage.py",
    "tests/ident/workflows/test_dynamics.py",
    "tests/ident/results/test_result_file.py",
    "tests/ident/estimation/test_multistart.py",
    "tests/ident/data/test_log_channels.py",
    "tests/golden/test_golden.py",
    "tests/ident/models/test_driven_shaft.py",
    "tests/ident/workflows/test_vehicle_prior.py",
    "tests/measured/test_foreign.py",
    "tests/mocks/hidden_effects/test_hidden_effects.py",
    "tests/daq/protocol/test_nmea.py",
    "tests/mocks/hidden_effects/test_realistic.py",
    "tests/recovery/test_misuse.py",
    "tests/ident/checks/test_frames.py",
    "tests/daq/protocol/test_vectornav.py",
    "tests/test_glossary.py",
    "tests/ident/workflows/test_check_first.py",
    "tests/ident/effects/test_weak_effects.py",
    "tests/ident/estimation/test_meta_analysis.py",
    "tests/test_package.py",
    "tests/test_house.py",
    "tests/ident/data/test_shared_frame.py",
)
GC_THRESHOLD = (50_000, 20, 50)  # the default of (700, 10, 10) takes 1 % of the time
COMPUTING_NICENESS = 19  # nice level of workers with tests that compute
WATCH = pytest.StashKey[StallWatch]()
STEPPED_BACK = threading.Event()


def group_of(nodeid: str) -> str:
    """Return the group of a test.

    Tests of one group run on one worker in order; the tests of a file share its fixtures.
    """
    file = nodeid.partition("::")[0]
    return "ports" if file in PORTS else "beside" if file in BESIDE else file


ORDER = {group: k for k, group in enumerate(("ports", "beside", *LONG))}


@pytest.fixture(scope="module")
def quick_compilation() -> Iterator[None]:
    """Compile the kernels of a module in a fifth of the time, with less optimisation.

    It pays for models that no other module fits. The machine code of other models is compiled once for all modules.
    """
    from seatrial.ident.engine import filter_kernels, jit

    with jit.quick_compilation(0):
        yield
    # A kernel in memory remains that of its model, and its rounding differs from that of other processes.
    for kernels in (filter_kernels._recent, filter_kernels._known, filter_kernels._by_model):
        kernels.clear()


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Exclude the loaded modules and tests from garbage collection, because they stay until the end."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(*GC_THRESHOLD)
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sort the longest tests first, so that no long test starts when all others are done."""
    items.sort(key=lambda item: ORDER.get(group_of(item.nodeid), len(ORDER)))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Lower the priority of a worker that computes, with all processes that it starts, in favour of the tests in real
    time.
    """
    computes = group_of(item.nodeid) not in ("ports", "beside")
    if "PYTEST_XDIST_WORKER" in os.environ and computes:
        step_back()


def step_back() -> None:
    """Set the least priority once, for this process and, where Linux shares the cores by sessions, for its session.

    If Linux shares the cores by sessions, a nice process takes as much time as another session. Acquisition and
    watchdog have their own sessions.
    """
    if STEPPED_BACK.is_set():
        return
    STEPPED_BACK.set()
    os.nice(COMPUTING_NICENESS - os.getpriority(os.PRIO_PROCESS, 0))
    with contextlib.suppress(OSError):  # not Linux, or no sharing by sessions
        os.setsid()
        Path("/proc/self/autogroup").write_text(str(COMPUTING_NICENESS), encoding="ascii")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Repeat a failed test with deadlines if the machine, and not seatrial, was late."""
    if group_of(item.nodeid) not in ("ports", "beside"):
        return None
    watch = item.config.stash.get(WATCH, None)
    if watch is None:
        watch = item.config.stash[WATCH] = StallWatch()
        item.config.add_cleanup(watch.close)
    return run_repeated(item, nextitem, watch)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Name the repeated tests in the summary."""
    summarise(terminalreporter)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Return the scheduler for --dist loadgroup. Other ways of distribution are left to pytest-xdist."""
    if config.getvalue("dist") != "loadgroup":
        return None
    from xdist.scheduler.loadscope import LoadScopeScheduling

    class ByPlace(LoadScopeScheduling):
        """Scheduler whose work units follow `group_of`, in the order of collection."""

        def _split_scope(self, nodeid: str) -> str:
            return group_of(nodeid)

    config.option.loadscopereorder = False
    return ByPlace(config, log)
