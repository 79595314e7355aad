"""Likelihood with gradient beside a plain numpy filter and CasADi's own evaluation, in one run; what a large model
takes to compile, and what a process takes from its start to a result."""

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
    """The ratios, then compile time, CPU and memory."""
    record = measured() or simulated(seed)
    yield from ratios(record)
    yield from processes(record)


def ratios(record: Record) -> Iterator[Figure]:
    """CPU of one likelihood with gradient by all 15 parameters; who is compared computes the same numbers."""
    from benchmarks.peers import casadi_gradient, numpy_value

    group = f"likelihood with gradient, {record.name}: {N_ROWS} rows, 6 states, 15 parameters, one thread"
    likelihood, names = Likelihood(model()), list(model().values)
    values = np.array(list(model().values.values()))
    value, gradient = likelihood.gradient(record, values)
    peer = casadi_gradient(model(), record)
    by_casadi, slopes = peer(values)
    given = dict(zip(names, values.tolist(), strict=True))
    by_numpy = numpy_value(given, record)
    works = {
        "ours": (lambda: likelihood.gradient(record, values), 50),
        "casadi": (lambda: peer(values), 2),
        "by differences": (lambda: numpy_value(given, record, by_hand=False), 1),
        "by hand": (lambda: numpy_value(given, record), 1),
    }
    ms = least(works, rounds=5)
    # where machine code comes to lie is chance, and in one process of thirty a kernel takes twice as long
    ours, casadi_ms = min(ms["ours"], *in_processes_of_their_own(record, 3)), ms["casadi"]
    yield Figure(group, "this engine", ours, "ms CPU", note="the least of four processes")
    yield Figure(group, "CasADi's own evaluation", casadi_ms, "ms CPU", note="reverse gradient of mapped rows")
    yield Figure(group, "faster than CasADi", casadi_ms / ours, "times", note="wanted: 50")
    n = 1 + len(names)  # forward differences: the likelihood once, and once more for each parameter
    for how in ("by differences", "by hand"):
        note = f"{n} likelihoods of {ms[how]:,.0f} ms, the least of five"
        yield Figure(group, f"numpy, Jacobians {how}", n * ms[how], "ms CPU", note=note)
        wanted = "wanted: 4000" if how == "by differences" else ""
        yield Figure(group, "faster than that", n * ms[how] / ours, "times", note=wanted)
    apart = max(abs(by_numpy - value), abs(by_casadi - value))
    yield Figure(group, "values apart", apart, "", note=f"of {value:.4f}")
    yield Figure(group, "gradients apart", float(np.abs(slopes - gradient).max() / np.abs(gradient).max()), "relative")


def least(works: Mapping[str, tuple[Callable[[], object], int]], rounds: int) -> dict[str, float]:
    """CPU time of each in ms, the least of all: what else the machine does does not count. Each is done so many times
    in every round, so that none has the machine's slower minutes to itself."""
    best = dict.fromkeys(works, np.inf)
    for _ in range(rounds):
        for name, (work, repeats) in works.items():
            for _ in range(repeats):
                began = time.process_time()
                work()
                best[name] = min(best[name], 1e3 * (time.process_time() - began))
    return best


def in_processes_of_their_own(record: Record, n: int) -> Iterator[float]:
    """CPU time of a likelihood with gradient in ms, the least in each of n processes."""
    with tempfile.TemporaryDirectory() as folder:
        file = saved(record, Path(folder))
        for _ in range(n):
            words = [sys.executable, "-m", "benchmarks.speed", "gradient", str(file)]
            yield child(words, ROOT, os.environ).report["ms"]


def saved(record: Record, folder: Path) -> Path:
    """For a child to read."""
    file = folder / "record.npz"
    np.savez(file, t=record.t, u=record.u, y=record.y)
    return file


def large() -> Model:
    """13 states, 27 parameters: the plane with current, disturbance forces and sensor offsets."""
    full = with_disturbances(horizontal_model("shaft"))
    return full.with_free(full.values)


def processes(record: Record) -> Iterator[Figure]:
    """Each in a process of its own, with an empty cache of kernels and then with a full one."""
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
                    yield Figure(group, "of it to compile", best.report["compile"], "s CPU", note="wanted: 3")


def main() -> None:
    """The work of a child: estimate, time a gradient, or compile and evaluate once; prints what only it can know."""
    work, file = sys.argv[1:]
    began, given = time.process_time(), np.load(file)
    own = Record("given", given["t"], given["u"], given["u"], given["y"], ("X", "N"), tuple(NOISE))
    if work == "estimate":
        found: dict[str, float] = {"optimum": fit(model(), [own], start=START).log_likelihood}
    elif work == "gradient":
        likelihood, values = Likelihood(model()), np.array(list(model().values.values()))
        found = least({"ms": (lambda: likelihood.gradient(own, values), 100)}, rounds=1)
    else:
        full, n = large(), 50
        names = tuple(i.name for i in full.inputs), tuple(o.name for o in full.outputs)
        u, y = np.zeros((n, 2)), np.zeros((n, len(names[1])))
        few = Record("few", np.linspace(0.0, 5.0, n), u, u, y, names[0], names[1])
        Likelihood(full).scores(few, np.array(list(full.values.values())))
        found = {"compile": time.process_time() - began}
    print(json.dumps(found | {"peak_mb": peak_mb()}))


if __name__ == "__main__":
    main()
