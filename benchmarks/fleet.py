"""Benchmark of `seatrial ident fleet`: logs per worker and time, memory, and equality of the estimates.

The logs are those of one mock boat without hidden effects, and are kept under build/. ``python -m benchmarks.fleet
--logs 1000 --seconds 300 --workers 1,2,4`` measures other numbers; ``--backend dask`` starts a local cluster.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from benchmarks.long import log
from benchmarks.measure import Figure, table

ROOT = Path(__file__).parents[1]
MB = 1e6


def figures(seed: int) -> Iterator[Figure]:
    """Yield the figures of 16 logs of a minute with one and two workers. ``seed`` selects the mock boat."""
    yield from measured(seed, 16, 60.0, (1, 2), "loky")


def measured(seed: int, n_logs: int, seconds: float, workers: Sequence[int], backend: str) -> Iterator[Figure]:
    """Yield throughput and memory for each number of workers, and whether all gave the same estimates.

    Parameters
    ----------
    seed : int
        Seed of the mock boat.
    n_logs : int
        Number of logs.
    seconds : float
        Length of each log [s].
    workers : sequence of int
        Numbers of workers. The first one is the reference of the throughput.
    backend : str
        Backend of `seatrial ident fleet`; a single worker always uses this process.
    """
    logs = [log(seed, run, seconds) for run in range(1, n_logs + 1)]
    group = f"{n_logs} logs of {seconds / 60:g} min, {backend}"
    tables: list[Any] = []
    rates: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        _fitted(logs[:1], 1, "loky", Path(folder) / "warm")  # compiles the kernels
        for n in workers:
            began = time.perf_counter()
            tables.append(_fitted(logs, n, backend if n > 1 else "loky", Path(folder) / str(n)))
            wall = time.perf_counter() - began
            rates.append(n_logs / wall / n)
            each, name = _by_log(tables[-1]), f"{n} workers" if n > 1 else "1 worker"
            note = f"{100 * rates[-1] / rates[0]:.0f} % of one worker" if n > 1 else ""
            yield Figure(group, f"{name}: logs per minute and worker", 60 * rates[-1], "", note=note)
            yield Figure(group, f"{name}: CPU of a log", sum(r["cpu"] for r in each) / n_logs, "s CPU")
            yield Figure(group, f"{name}: peak memory of a worker", max(r["memory"] for r in each) / MB, "MB")
            early = max(r["memory"] for r in each[: max(n_logs // 4, 1)]) / MB
            yield Figure(group, f"{name}: the same after a quarter of the logs", early, "MB")
        estimates = [t.select(["log", "parameter", "value", "se", "log_likelihood"]) for t in tables]
        same = all(t.equals(estimates[0]) for t in estimates)
        yield Figure(group, "the estimates are equal bit for bit", float(same), "", note="1: yes")


def _fitted(logs: Sequence[Path], workers: int, backend: str, out: Path) -> Any:
    """Run `seatrial ident fleet` on logs with a number of workers, and return its table (``pyarrow.Table``)."""
    import pyarrow.parquet

    how = ["--prior", "c1=40:2", "--fix", "c2=1.1", "--jobs", str(workers), "--backend", backend, "--out", str(out)]
    words = [sys.executable, "-m", "seatrial", "ident", "fleet", *map(str, logs), *how]
    subprocess.run(words, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True)
    return pyarrow.parquet.read_table(out / "fits.parquet")


def _by_log(fits: Any) -> list[dict[str, Any]]:
    """Return one row of the table for each log, in the order in which a worker fitted them: by growing peak memory."""
    rows = {r["log"]: r for r in fits.select(["log", "cpu", "memory"]).to_pylist()}
    return sorted(rows.values(), key=lambda r: float(r["memory"]))


def main() -> int:
    """Measure the fleet that the command line describes, and print the table."""
    parser = argparse.ArgumentParser("python -m benchmarks.fleet", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--logs", type=int, default=60)
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--workers", default="1,2", help="numbers of workers, separated by commas")
    parser.add_argument("--backend", default="loky", choices=("loky", "dask", "ray"))
    o = parser.parse_args()
    workers = [int(n) for n in o.workers.split(",")]
    print(table(list(measured(o.seed, o.logs, o.seconds, workers, o.backend))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
