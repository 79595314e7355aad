"""Tests of parallel tasks on processes of this computer, which are killed, and of errors of all backends."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import joblib
import pytest

from seatrial.daq.errors import SeatrialError
from seatrial.ident.parallel import Workers, run_many
from tests.ident.parallel import chores
from tests.ident.reports import Kept

ROOT = Path(__file__).resolve().parents[3]
LOKY = Workers(2, "loky")


def test_every_backend_gives_the_same_values() -> None:
    alone = {o.task: o.value[0] for o in run_many(range(8), chores.square, Workers(1)) if o.value}
    assert alone == {k: k * k for k in range(8)}
    found = [o.value for o in run_many(range(8), chores.square, LOKY) if o.value]
    assert sorted(v for v, _ in found) == [k * k for k in range(8)]
    processes = {p for _, p in found}
    assert len(processes) == 2
    assert os.getpid() not in processes


def test_outcomes_come_while_later_tasks_run() -> None:
    taken = []

    def tasks() -> Iterator[int]:
        for k in range(20):
            taken.append(k)
            yield k

    stream = run_many(tasks(), chores.square, LOKY)
    next(stream)
    assert len(taken) < 10
    stream.close()  # type: ignore[attr-defined]


@pytest.mark.parametrize("workers", [Workers(1), LOKY], ids=["one", "loky"])
def test_error_of_a_task_is_its_outcome(workers: Workers) -> None:
    found = {o.task: (o.value, o.error) for o in run_many(range(6), chores.picky, workers)}
    assert found[3] == (None, "three is refused")
    assert found[4] == (None, "RuntimeError: four broke")
    assert [found[k] for k in (0, 1, 2, 5)] == [(k, "") for k in (0, 1, 2, 5)]


def test_task_of_a_killed_process_is_run_again(tmp_path: Path) -> None:
    marks = [tmp_path / f"{'victim' if k == 4 else 'other'}{k}" for k in range(10)]
    reporter = Kept()
    found = list(run_many(marks, chores.die_once, LOKY, reporter))
    assert sorted(o.value or "" for o in found) == sorted(m.name for m in marks)
    assert len(reporter.warnings) == 1
    assert "a process of the tasks died" in reporter.warnings[0]


def test_task_that_always_kills_its_process_fails_and_the_others_do_not() -> None:
    reporter = Kept()
    found = {o.task: (o.value, o.error) for o in run_many(range(6), chores.die_always, LOKY, reporter)}
    assert [found.pop(k) for k in (0, 1, 3, 4, 5)] == [(k, "") for k in (0, 1, 3, 4, 5)]
    value, error = found.pop(2)
    assert value is None
    assert error.startswith("its process died 3 times")
    assert not found


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("ray") is None,
    reason="ray takes 240 MB, and is no part of the extra all: pip install 'seatrial[ray]'",
)
def test_ray_task_of_a_killed_process_is_run_again(tmp_path: Path) -> None:
    marks = [tmp_path / f"{'victim' if k == 1 else 'other'}{k}" for k in range(6)]
    reporter = Kept()
    found = list(run_many(marks, chores.die_once, Workers(2, "ray"), reporter))
    assert sorted(o.value or "" for o in found) == sorted(m.name for m in marks)
    assert reporter.lines == ["Ray cluster of 2 cores"]
    assert len(reporter.warnings) == 1


def test_any_joblib_backend_is_used_if_none_is_named() -> None:
    """The backend multiprocessing returns no result before all tasks are done."""
    for backend in ("threading", "multiprocessing"):
        with joblib.parallel_config(backend, n_jobs=2):
            found = {o.task: o.value[0] for o in run_many(range(20), chores.square) if o.value}
        assert found == {k: k * k for k in range(20)}


def test_interrupt_ends_the_processes_without_tracebacks(tmp_path: Path) -> None:
    """The terminal sends Ctrl-C to all processes of its group."""
    code = (
        "import sys; from pathlib import Path; from seatrial.ident.parallel import Workers, run_many\n"
        "from tests.ident.parallel import chores\n"
        f"marks = [Path({str(tmp_path)!r}) / str(k) for k in range(500)]\n"
        "for o in run_many(marks, chores.slow, Workers(2, 'loky')): print(o.value, flush=True)\n"
    )
    words = [sys.executable, "-c", code]
    running = subprocess.Popen(
        words, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    assert running.stdout is not None
    assert running.stdout.readline()
    os.killpg(running.pid, signal.SIGINT)
    _, err = running.communicate(timeout=60)
    assert running.returncode != 0
    assert err.count("Traceback") == 1  # that of the program above, which does not handle it
    assert err.strip().endswith("KeyboardInterrupt")
    n = len(list(tmp_path.iterdir()))
    time.sleep(0.5)
    assert len(list(tmp_path.iterdir())) == n < 500


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((1, "slurm"), "there is no such backend; use loky, dask, ray"),
        ((1, "loky", "tcp://x:1"), "have no scheduler; add --backend dask or --backend ray"),
        ((1, None, "tcp://x:1"), "have no scheduler"),
    ],
)
def test_workers_that_do_not_exist(arguments: tuple[Any, ...], message: str) -> None:
    with pytest.raises(SeatrialError, match=message):
        Workers(*arguments)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nowhere"])
def test_scheduler_that_does_not_answer(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("seatrial.ident.parallel.workers.REACH_S", 0.5)
    with pytest.raises(SeatrialError, match=r"no Dask scheduler answers there; start one with `dask scheduler`"):
        list(run_many(range(2), chores.square, Workers(backend="dask", scheduler=address)))


def test_tasks_of_a_worker_with_threads_take_turns() -> None:
    from distributed import LocalCluster

    reporter = Kept()
    with LocalCluster(n_workers=1, threads_per_worker=2, processes=True, dashboard_address="127.0.0.1:0") as running:
        workers = Workers(backend="dask", scheduler=running.scheduler_address)
        outcomes = list(run_many(range(4), chores.span, workers, reporter))
    spans = sorted(o.value for o in outcomes if o.value)
    assert len(spans) == 4
    assert all(before[1] <= after[0] for before, after in pairwise(spans))
    assert "has 2 threads, but the tasks of one process take turns" in reporter.warnings[0]


@pytest.mark.parametrize(("backend", "module"), [("dask", "distributed"), ("ray", "ray")])
def test_missing_library_names_its_extra(backend: Any, module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(SeatrialError, match=rf"needs the package {module}: pip install 'seatrial\[{backend}\]'"):
        list(run_many(range(2), chores.square, Workers(backend=backend)))
