"""Every capture of SEATRIAL_DATA beside its independent decoding: `python -m tests.golden`.

Exit status 1 when fewer than 95 % of gpsd's fixes are ours too, or a capture is not as it has to be.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from tests.golden.captures import Result, results
from tests.golden.gpsd import Comparison, compare

NEEDED = 0.95


def fixes_table(rows: Sequence[Comparison]) -> Table:
    """gpsd's captures: all that have positions."""
    table = Table("capture", "samples", "checksum errors", "gpsd's fixes", "agree", "of these in", "misses", box=None)
    for row in rows:
        if row.fixes:
            misses = ", ".join(f"{count} {why}" for why, count in row.misses.items())
            other = f"{row.by_sentence} RMC, GLL" if row.by_sentence else ""
            table.add_row(
                row.name, str(row.samples), str(row.checksum_errors), str(row.fixes), str(row.agreeing), other, misses
            )
    return table


def captures_table(rows: Sequence[Result]) -> Table:
    """The other captures."""
    table = Table("capture", "samples", "checksum errors", "unparsed bytes", "read", "", box=None)
    for row in rows:
        counts = (str(row.samples), str(row.checksum_errors), str(row.unparsed_bytes))
        table.add_row(row.name, *counts, row.said, "right" if row.right else "WRONG")
    return table


def main() -> int:
    """Print both tables and what they come to."""
    folder = os.environ.get("SEATRIAL_DATA")
    if not folder:
        print("SEATRIAL_DATA does not say where the captures are", file=sys.stderr)
        return 2
    console = Console(width=150, highlight=False)
    gpsd = [compare(path) for path in sorted((Path(folder) / "gpsd/daemon").glob("*.log"))]
    console.print(fixes_table(gpsd))
    agreeing, fixes = sum(row.agreeing for row in gpsd), sum(row.fixes for row in gpsd)
    without = [row.name for row in gpsd if not row.fixes]
    console.print(
        f"\n{agreeing} of {fixes} fixes agree within gpsd's printed digits ({100.0 * agreeing / fixes:.1f} %)"
    )
    console.print(f"no position with a time in {', '.join(without)}\n")
    others = list(results(Path(folder)))
    console.print(captures_table(others))
    return 0 if agreeing >= NEEDED * fixes and all(row.right for row in others) else 1


if __name__ == "__main__":
    sys.exit(main())
