"""Runner of many independent tasks in parallel processes, which repeats the tasks of processes that died."""

from __future__ import annotations

import contextlib
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import count, islice
from typing import Any, Generic, TypeVar

import joblib
from joblib.externals.loky.process_executor import BrokenProcessPool

from seatrial.daq.errors import SeatrialError
from seatrial.ident.parallel.workers import Workers, connected, without_interrupts
from seatrial.ident.reporter import QUIET, Reporter

T = TypeVar("T")
R = TypeVar("R")

REPEATS = 2  # a task whose process died is run again this many times, alone; then it has failed
WAVE = 4  # tasks for each process that a backend without a stream of results gets at a time
# Tasks of one process take turns, even if it has several threads: the compiler of the models is not made for threads.
_TURN = threading.Lock()


@dataclass(frozen=True)
class TaskOutcome(Generic[T, R]):
    """End of one task: its value, or the reason why it has none.

    Attributes
    ----------
    task
        The task.
    value
        What the function returned for the task; None if it failed.
    error
        Reason why the task failed, in one line; empty if it did not.
    """

    task: T
    value: R | None
    error: str = ""


def run_many(
    tasks: Iterable[T], function: Callable[[T], R], workers: Workers | None = None, reporter: Reporter = QUIET
) -> Iterator[TaskOutcome[T, R]]:
    """Run a function for each task in parallel processes, and yield each outcome as soon as it is there, in any order.

    Parameters
    ----------
    tasks : iterable of T
        Tasks. One is taken from the iterator when a process becomes free. The tasks are sent to the processes, so they
        are small: names of files, not their content.
    function : callable
        Function of one task at the top level of a module. Its errors end the task, but not the run.
    workers : Workers, optional
        Processes that run the tasks; by default those of ``joblib.parallel_config``.
    reporter : Reporter
        Receives progress and warnings.

    Yields
    ------
    TaskOutcome
        Value of a task, or the reason why it failed.

    Raises
    ------
    SeatrialError
        If a cluster cannot be used, or if processes die while no task is running.

    Notes
    -----
    If a process dies, the tasks that were running are run again one at a time. A task is the reason of the death if it
    ends its process when it runs alone, and then it fails after two repeats. One at a time is also the only order that
    helps if the memory of the computer was not enough. Dask itself moves the tasks of a dead worker to others, and
    reports a task only after it has ended several workers.
    """
    source, numbers, running = iter(tasks), count(), dict[int, T]()
    with connected(workers or Workers(), reporter):
        while True:
            try:
                yield from _run_parallel(source, function, numbers, running)
            except _deaths() as death:
                suspects = list(running.values())
                running.clear()
                if not suspects:  # no task was running: the workers cannot be used at all
                    raise SeatrialError(f"the processes of the tasks died: {_line(death)}") from death
                reporter.warning(
                    f"a process of the tasks died; the {len(suspects)} tasks that had not ended are run again one at a "
                    "time"
                )
                for task in suspects:
                    yield _run_alone(task, function)
            else:
                return


def _run_parallel(
    source: Iterator[T], function: Callable[[T], R], numbers: Iterator[int], running: dict[int, T]
) -> Iterator[TaskOutcome[T, R]]:
    """Run tasks from an iterator on joblib's present backend, and yield their outcomes as they come.

    ``running`` has the tasks that joblib has taken and whose outcomes it has not returned, by number, at any moment.
    ``numbers`` yields the numbers of the tasks. A backend that returns no result before all tasks are done gets waves
    of four tasks for each process. The error of a dead process is passed on.
    """

    def calls() -> Iterator[Any]:
        """Yield the call of each task for joblib, and note the task as running."""
        for number, task in zip(numbers, source, strict=False):
            running[number] = task
            yield joblib.delayed(_call)(function, number, task)

    try:
        run = joblib.Parallel(return_as="generator_unordered", pre_dispatch="n_jobs", batch_size=1)
    except ValueError:  # Ray's, for example
        run = joblib.Parallel(batch_size=1)
        wave, todo = WAVE * joblib.effective_n_jobs(run.n_jobs), calls()
        done = (end for first in todo for end in run([first, *islice(todo, wave - 1)]))
    else:
        with without_interrupts():
            done = run(calls())
    try:
        for number, value, error in done:
            yield TaskOutcome(running.pop(number), value, error)
    finally:
        with warnings.catch_warnings():  # joblib cancels the tasks if the caller takes no more outcomes, and warns
            warnings.simplefilter("ignore", UserWarning)
            done.close()


def _run_alone(task: T, function: Callable[[T], R]) -> TaskOutcome[T, R]:
    """Run one task while no other task is running, again if its process dies, and return its outcome."""
    for _ in range(REPEATS):
        with contextlib.suppress(*_deaths()):
            (outcome,) = _run_parallel(iter([task]), function, count(), {})
            return outcome
    return TaskOutcome(
        task, None, f"its process died {1 + REPEATS} times, such as by a lack of memory; run it alone to see why"
    )


def _call(function: Callable[[T], R], number: int, task: T) -> tuple[int, R | None, str]:
    """Run one task in a worker process; return its number, its value, and the reason if it failed."""
    with _TURN:
        try:
            return number, function(task), ""
        except Exception as problem:
            return number, None, _line(problem)


def _line(problem: BaseException) -> str:
    """Return an error as one line: its text, with the name of its class if the text was not written for users."""
    text = " ".join(str(problem).strip("'\"").split())
    return text if isinstance(problem, SeatrialError | ValueError) else f"{type(problem).__name__}: {text}"


def _deaths() -> tuple[type[BaseException], ...]:
    """Return the exceptions by which the backends report that a process died. No backend is imported for this."""
    found: list[type[BaseException]] = [BrokenProcessPool]
    if "distributed" in sys.modules:
        from distributed import KilledWorker

        found.append(KilledWorker)
    if "ray" in sys.modules:
        from ray.exceptions import RayActorError, WorkerCrashedError

        found += [RayActorError, WorkerCrashedError]
    return tuple(found)
