"""CPU time in seconds of a reference machine, so that a limit holds on machines of different speed and load."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

REFERENCE = 0.045  # s of CPU that the yardstick takes on the reference machine
TRIES = 3


def cpu_seconds(work: Callable[[], object], limit: float) -> float:
    """Return the CPU time of ``work`` in seconds of the reference machine.

    A yardstick before and after the work measures the speed of this machine. The result is the least of at most
    ``TRIES`` measurements, which end as soon as one is below ``limit``.
    """
    least = np.inf
    for _ in range(TRIES):
        before = _spent(_yardstick)
        spent = _spent(work)
        slowness = max(before, _spent(_yardstick), REFERENCE) / REFERENCE
        least = min(least, spent / slowness)
        if least < limit:
            break
    return float(least)


def slowness(repeats: int = 15) -> float:
    """Return the CPU time of the yardstick over that on the reference machine: the median of ``repeats`` times."""
    return float(np.median([_spent(_yardstick) for _ in range(repeats)])) / REFERENCE


def _spent(work: Callable[[], object]) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began


def _yardstick() -> None:
    """Do the typical work of simulations and filters: numbers in Python, and small arrays."""
    a, x, total = np.eye(6) + 0.01, np.ones(6), 0.0
    for k in range(12_000):
        x = np.minimum(a @ x, 2.0)
        values = {name: 0.5 * float(k) for name in ("u", "v", "r")}
        total += sum(values.values()) * 1e-9 + float(x[0])
    assert total > 0.0
