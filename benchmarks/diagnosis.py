"""`seatrial ident diagnose` from two logs to the report: 400 s for estimation, 250 s for validation, ten rows a second.

Each command is a process of its own; kernels that were not compiled before are compiled by it.
"""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks.measure import Figure
from tests.recovery.cases import run_case
from tests.recovery.kinds import Case

EFFECTS = ("none", "cubic-drag")


def figures(seed: int) -> Iterator[Figure]:
    """CPU, whether it was right, and what the answer does to the error."""
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
