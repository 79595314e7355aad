"""Benchmark of `seatrial ident diagnose` from two logs to the report.

The logs have 400 s for estimation and 250 s for validation, with ten rows per second. Each command runs in a process of
its own and compiles missing kernels.
"""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks.measure import Figure
from tests.recovery.cases import run_case
from tests.recovery.kinds import Case

EFFECTS = ("none", "cubic-drag")


def figures(seed: int) -> Iterator[Figure]:
    """Yield the figures of a diagnosis without and with a hidden effect (`EFFECTS`) of the mock boat of a seed.

    Each has CPU time with the effects that were found, and the RMS errors of a prediction 10 s ahead. Raises
    RuntimeError if a command fails.
    """
    for effect in EFFECTS:
        row = run_case(Case(effect, seed))
        group = f"diagnosis, {effect}"
        if "error" in row:
            raise RuntimeError(f"{row['key']}: {row['error']}")
        found = ", ".join(row["found"]) or "none"
        yield Figure(group, "logs to report", row["cpu"], "s CPU", note=f"found: {found}")
        for channel, unit in (("x", "m"), ("r", "rad/s")):
            after, before = row["after"]["horizon"][channel], row["before"]["horizon"][channel]
            yield Figure(group, f"10 s ahead, {channel}, validation", after, unit, note=f"before: {before:.4g}")
