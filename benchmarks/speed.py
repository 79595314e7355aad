"""Benchmark of the likelihood with its gradient, compared with a numpy filter and with the evaluation by CasADi.

It also measures the compile time of a large model, and the time and memory of a process from its start to a result.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from benchmarks.measure import Figure, child, peak_mb
from benchmarks.sde import N_ROWS, NOISE, PEER, START, measured, model, simulated
from seatrial.ident.data.record import Record
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.maximum_likelihood import fit
from seatrial.ident.model.structure import Model
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model

ROOT = Path(__file__).parents[1]


def figures(seed: int) -> Iterator[Figure]:
    """Yield the comparison of the likelihoods, then the figures of whole processes.

    The record is the data set sde_bench if it is available, else one that ``seed`` simulates.
    """
    record = measured() or simulated(seed)
    yield from ratios(record)
    yield from processes(record)


def ratios(record: Record) -> Iterator[Figure]:
    """Yield the CPU time of one likelihood with its gradient by all 15 parameters, for all programs.

    The last figures check that all programs compute the same values.
    """
    from benchmarks.peers import casadi_gradient, numpy_value

    group = f"likelihood with gradient, {record.name}: {N_ROWS} rows, 6 states, 15 parameters, one thread"
    likelihood, names = Likelihood(model()), list(model().values)
    values = np.array(list(model().values.values()))
    value, gradient = likelihood.gradient(record, values)
    peer = casadi_gradient(model(), record)
    by_casadi, slopes = peer(values)
    parameters = dict(zip(names, values.tolist(), strict=True))
    by_numpy = numpy_value(parameters, record)
    works = {
        "ours": (lambda: likelihood.gradient(record, values), 50),
        "casadi": (lambda: peer(values), 2),
        "by differences": (lambda: numpy_value(parameters, record, by_hand=False), 1),
        "by hand": (lambda: numpy_value(parameters, record), 1),
    }
    ms = shortest_ms(works, rounds=5)
    # The position of machine code in memory is random. In about one of 30 processes a kernel takes twice as long.
    ours, casadi_ms = min(ms["ours"], *in_other_processes(record, 3)), ms["casadi"]
    yield Figure(group, "this engine", ours, "ms CPU", note="shortest of four processes")
    yield Figure(group, "evaluation by CasADi", casadi_ms, "ms CPU", note="reverse gradient of mapped rows")
    yield Figure(group, "CasADi over this engine", casadi_ms / ours, "times", note="target: 50")
    n = 1 + len(names)  # forward differences need one likelihood, and one more for each parameter
    for method in ("by differences", "by hand"):
        note = f"{n} likelihoods of {ms[method]:,.0f} ms, shortest of five"
        yield Figure(group, f"numpy, Jacobians {method}", n * ms[method], "ms CPU", note=note)
        target = "target: 4000" if method == "by differences" else ""
        yield Figure(group, "numpy over this engine", n * ms[method] / ours, "times", note=target)
    difference = max(abs(by_numpy - value), abs(by_casadi - value))
    yield Figure(group, "difference of the values", difference, "", note=f"of {value:.4f}")
    relative = float(np.abs(slopes - gradient).max() / np.abs(gradient).max())
    yield Figure(group, "difference of the gradients", relative, "relative")


def shortest_ms(works: Mapping[str, tuple[Callable[[], object], int]], rounds: int) -> dict[str, float]:
    """Return the shortest CPU time [ms] of one call of each function, by its name.

    Parameters
    ----------
    works : mapping of str to (callable, int)
        Functions, and the number of calls of each in every round.
    rounds : int
        Number of rounds.

    Notes
    -----
    Other programs only make a call longer, so the shortest time is the best estimate. The functions alternate in
    rounds, so that a slow phase of the machine affects all of them.
    """
    best = dict.fromkeys(works, np.inf)
    for _ in range(rounds):
        for name, (work, repeats) in works.items():
            for _ in range(repeats):
                began = time.process_time()
                work()
                best[name] = min(best[name], 1e3 * (time.process_time() - began))
    return best


def in_other_processes(record: Record, n: int) -> Iterator[float]:
    """Yield the shortest CPU time [ms] of a likelihood of ``record`` with its gradient, in each of n new processes."""
    with tempfile.TemporaryDirectory() as folder:
        file = saved(record, Path(folder))
        for _ in range(n):
            words = [sys.executable, "-m", "benchmarks.speed", "gradient", str(file)]
            yield child(words, ROOT, os.environ).report["ms"]


def saved(record: Record, folder: Path) -> Path:
    """Write a record to the file record.npz in a folder, for a child process, and return its path."""
    file = folder / "record.npz"
    np.savez(file, t=record.t, u=record.u, y=record.y)
    return file


def large() -> Model:
    """Return a large model: horizontal plane with current, disturbance forces and sensor offsets.

    It has 13 states and 27 parameters.
    """
    full = with_disturbances(horizontal_model("shaft"))
    return full.with_free(full.values)


def processes(record: Record) -> Iterator[Figure]:
    """Yield CPU time and peak memory of new processes that estimate, or that compile a large model.

    Each is measured with an empty cache of compiled kernels ("cold") and a full one ("warm", the best of three).
    """
    with tempfile.TemporaryDirectory() as folder:
        file = saved(record, Path(folder))
        for work, group in (
            ("estimate", f"process start to estimate ({record.name})"),
            ("compile", f"process start to scores of {len(large().states)} states, {len(large().values)} parameters"),
        ):
            environment = {**os.environ, "SEATRIAL_CACHE": str(Path(folder) / work)}
            for name in ("cold", "warm"):
                words = [sys.executable, "-m", "benchmarks.speed", work, str(file)]
                runs = [child(words, ROOT, environment) for _ in range(1 if name == "cold" else 3)]
                best = min(runs, key=lambda r: r.cpu)
                peer = PEER.get(name) if record.name == "sde_bench" and work == "estimate" else None
                yield Figure(group, f"{name}: CPU", best.cpu, "s CPU", peer)
                yield Figure(group, f"{name}: peak memory", best.report["peak_mb"], "MB")
                if work == "compile" and name == "cold":
                    yield Figure(group, "CPU until the first scores", best.report["compile"], "s CPU", note="target: 3")


def main() -> None:
    """Run the work of a child process and print its figures as JSON, with the peak memory [MB].

    The arguments are the work and the file of a record. The work is "estimate", "gradient" (the timing of a gradient),
    or "compile" (the compilation and first evaluation of the large model).
    """
    work, file = sys.argv[1:]
    began, data = time.process_time(), np.load(file)
    record = Record("given", data["t"], data["u"], data["u"], data["y"], ("X", "N"), tuple(NOISE))
    if work == "estimate":
        found: dict[str, float] = {"optimum": fit(model(), [record], start=START).log_likelihood}
    elif work == "gradient":
        likelihood, values = Likelihood(model()), np.array(list(model().values.values()))
        found = shortest_ms({"ms": (lambda: likelihood.gradient(record, values), 100)}, rounds=1)
    else:
        full, n = large(), 50
        names = tuple(i.name for i in full.inputs), tuple(o.name for o in full.outputs)
        u, y = np.zeros((n, 2)), np.zeros((n, len(names[1])))
        short_record = Record("few", np.linspace(0.0, 5.0, n), u, u, y, names[0], names[1])
        Likelihood(full).scores(short_record, np.array(list(full.values.values())))
        found = {"compile": time.process_time() - began}
    print(json.dumps(found | {"peak_mb": peak_mb()}))


if __name__ == "__main__":
    main()
