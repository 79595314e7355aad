"""Processes that run tasks: those of this computer, or those of a Dask or Ray cluster, through joblib's backends."""

from __future__ import annotations

import importlib
import logging
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from multiprocessing import resource_tracker
from typing import Any, Literal, get_args

import joblib
from joblib.externals.loky.backend import resource_tracker as loky_tracker

from seatrial.daq.errors import SeatrialError
from seatrial.ident.reporter import Reporter

Backend = Literal["loky", "dask", "ray"]
BACKENDS: tuple[Backend, ...] = get_args(Backend)
REACH_S = 10.0  # s: longest wait for an answer of a scheduler
START_S = 30.0  # s: longest wait for the first worker of a scheduler


@dataclass(frozen=True)
class Workers:
    """Processes that run tasks.

    Attributes
    ----------
    jobs
        Number of processes on this computer; -1: one for each core. None: that of ``joblib.parallel_config``, by
        default one; a cluster that is started on this computer then has one for each core. A cluster with a scheduler
        uses all of its workers.
    backend
        ``loky`` (processes of this computer), ``dask`` or ``ray``. None: that of ``joblib.parallel_config``, by default
        ``loky``.
    scheduler
        Address of the scheduler of a Dask cluster, or of the head of a Ray cluster. If it is empty, a cluster is
        started on this computer, and ended with the tasks.

    Raises
    ------
    SeatrialError
        If there is an address, but the backend is neither Dask's nor Ray's, or if the number of processes is neither a
        whole number above zero nor -1.
    """

    jobs: int | None = None
    backend: Backend | None = None
    scheduler: str = ""

    def __post_init__(self) -> None:
        """Raise SeatrialError for a name of no backend, an address without a cluster, and no number of processes."""
        wrong = isinstance(self.jobs, bool) or not isinstance(self.jobs, int) or self.jobs == 0 or self.jobs < -1
        if self.jobs is not None and wrong:
            raise SeatrialError(f"--jobs {self.jobs!r}: give a number of processes, or -1 for one for each core")
        if self.backend not in (None, *BACKENDS):
            raise SeatrialError(f"--backend {self.backend}: there is no such backend; use {', '.join(BACKENDS)}")
        if self.scheduler and self.backend not in ("dask", "ray"):
            raise SeatrialError(
                f"--scheduler {self.scheduler}: the processes of this computer have no scheduler; add --backend dask "
                "or --backend ray"
            )


@contextmanager
def connected(workers: Workers, reporter: Reporter) -> Iterator[None]:
    """Context in which ``joblib.Parallel`` runs its tasks on the workers.

    A cluster that the context starts ends with it. The workers of a cluster with a scheduler stay.

    Parameters
    ----------
    workers : Workers
        Processes that run the tasks.
    reporter : Reporter
        Receives the number of workers of a cluster, and a warning about workers that have several threads.

    Raises
    ------
    SeatrialError
        If a library is missing, if the scheduler does not answer, or if its workers cannot run the tasks.
    """
    if workers.backend == "dask":
        with _dask_client(workers, reporter) as client, joblib.parallel_config("dask", client=client):
            yield
    elif workers.backend == "ray":
        with _ray_cluster(workers, reporter):
            yield
    elif workers.backend == "loky":
        # One thread of linear algebra in each process: more would only wait for each other (`seatrial.command_line`).
        with joblib.parallel_config("loky", n_jobs=workers.jobs, inner_max_num_threads=1):
            yield
    elif workers.jobs is not None:
        with joblib.parallel_config(n_jobs=workers.jobs):
            yield
    else:
        yield


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Context in which new processes are started that shall not react to Ctrl-C.

    A terminal sends Ctrl-C to all processes, but only this one has to react: it ends the others. Processes inherit the
    mask of blocked signals. A Ctrl-C in the context has its effect at the end of it.
    """
    for tracker in (loky_tracker, resource_tracker):
        tracker.ensure_running()  # its own start, by the first process, would unblock the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def local_processes(jobs: int | None) -> int:
    """Return the number of processes on this computer for ``jobs``: the number itself, or that of the cores."""
    return int(joblib.cpu_count()) if jobs is None or jobs < 1 else jobs


@contextmanager
def _dask_client(workers: Workers, reporter: Reporter) -> Iterator[Any]:
    """Context with a client of the Dask cluster at the address of ``workers``, or of one that is started here.

    SeatrialError is raised if Dask is missing, if the scheduler does not answer within 10 s, if it has no worker after
    30 s, or if a worker has another version of seatrial or none.
    """
    distributed = _import_backend("distributed", "dask")
    address = workers.scheduler
    if address:
        try:
            scheme, place = distributed.comm.parse_address(address)
            if scheme in ("tcp", "tls"):
                distributed.comm.parse_host_port(place)  # raises ValueError before the client starts its threads
            client = distributed.Client(address, timeout=REACH_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as problem:
            raise SeatrialError(
                f"--scheduler {address}: no Dask scheduler answers there; start one with `dask scheduler`, and give "
                "the address that it prints, such as tcp://192.168.1.5:8786"
            ) from problem
    else:
        # One thread for each process: a fit holds the lock of the interpreter for most of its time.
        with without_interrupts():
            client = distributed.Client(
                n_workers=local_processes(workers.jobs),
                threads_per_worker=1,
                processes=True,
                dashboard_address="127.0.0.1:0",
                set_as_default=False,
            )
    with client:
        try:
            client.wait_for_workers(1, timeout=START_S)
        except TimeoutError as problem:
            raise SeatrialError(
                f"--scheduler {address}: the Dask cluster has no workers; start one on each computer with `dask worker "
                f"{address} --nworkers=-1 --nthreads=1`"
            ) from problem
        _check_versions(client)
        threads = client.nthreads()
        reporter.progress(f"Dask cluster of {len(threads)} workers")
        if several := [worker for worker, n in threads.items() if n > 1]:
            reporter.warning(
                f"the Dask worker {several[0]} has {threads[several[0]]} threads, but the tasks of one process take "
                "turns; start the workers with --nthreads=1 and one process for each core (--nworkers=-1)"
            )
        yield client


def installed_version() -> str:
    """Return the version of seatrial in this process. The workers of a cluster call this function."""
    return version("seatrial")


def _check_versions(client: Any) -> None:
    """Raise SeatrialError if a worker of a Dask cluster lacks seatrial, or has another version than this process."""
    here = installed_version()
    try:
        versions = client.run(installed_version, on_error="return")
    except ModuleNotFoundError as problem:
        versions = {"": problem}
    for worker, found in versions.items():
        if found != here:
            words = f"cannot import seatrial ({found})" if isinstance(found, Exception) else f"has seatrial {found}"
            raise SeatrialError(
                f"the Dask worker {worker} {words}, and this computer has {here}: pip install "
                f"'seatrial[ident,dask]=={here}' there, and start the worker again"
            )


@contextmanager
def _ray_cluster(workers: Workers, reporter: Reporter) -> Iterator[None]:
    """Context in which joblib runs its tasks on the Ray cluster at the address of ``workers``, or on one started here.

    SeatrialError is raised if Ray is missing, or if there is no cluster at the address.
    """
    ray = _import_backend("ray", "ray")
    how: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    if workers.scheduler:
        how["address"] = workers.scheduler
    else:
        how |= {"address": "local", "num_cpus": local_processes(workers.jobs), "include_dashboard": False}
    try:
        with without_interrupts():
            ray.init(**how)
    except (ConnectionError, ValueError, RuntimeError) as problem:
        raise SeatrialError(
            f"--scheduler {workers.scheduler}: no Ray cluster answers there; start one with `ray start --head`, and "
            "give the address that it prints, such as 192.168.1.5:6379"
        ) from problem
    try:
        _import_backend("ray.util.joblib", "ray").register_ray()
        cores = int(ray.cluster_resources().get("CPU", 0))
        reporter.progress(f"Ray cluster of {cores} cores")
        with joblib.parallel_config("ray", n_jobs=cores):
            yield
    finally:
        ray.shutdown()


def _import_backend(module: str, extra: str) -> Any:
    """Import a module of a cluster's library, and return it.

    If it is missing, SeatrialError with the extra that installs it is raised.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as problem:
        raise SeatrialError(
            f"--backend {extra} needs the package {module.partition('.')[0]}: pip install 'seatrial[{extra}]'"
        ) from problem
