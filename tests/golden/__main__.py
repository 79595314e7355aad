"""Comparison of every capture of SEATRIAL_DATA with its independent decoding: `python -m tests.golden`.

The exit status is 1 in two cases. Either less than 99.5 % of gpsd's comparable fixes, speeds, dimensions or headings
agree with ours, or one of the other captures fails its check.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from tests.golden.captures import Result, results
from tests.golden.gpsd import Comparison, Share, compare

NEEDED = 0.995


def fixes_table(rows: Sequence[Comparison]) -> Table:
    """Print the table of gpsd's captures that contain positions."""
    table = Table(
        "capture", "samples", "checksum errors", "gpsd's fixes", "agree", "of these in", "misses", "speeds",
        "dimensions", "headings", box=None, padding=(0, 1, 0, 0),
    )  # fmt: skip
    for row in rows:
        if row.fixes or row.headings.comparable:
            misses = ", ".join(f"{count} {why}" for why, count in row.misses.items())
            extra = f"{row.by_sentence} RMC, GLL" if row.by_sentence else ""
            table.add_row(
                row.name, str(row.samples), str(row.checksum_errors), str(row.fixes), str(row.agreeing), extra, misses,
                *(_text(share) for share in (row.speeds, row.modes, row.headings)),
            )  # fmt: skip
    return table


def _text(share: Share) -> str:
    return f"{share.agreeing} of {share.comparable}" if share.comparable else ""


def totals(rows: Sequence[Comparison]) -> dict[str, Share]:
    """Print the shares of all captures together."""
    found = {"fixes": Share(sum(row.comparable for row in rows), sum(row.agreeing for row in rows))}
    for name in ("speeds", "modes", "headings"):
        shares = [getattr(row, name) for row in rows]
        found[name] = Share(sum(s.comparable for s in shares), sum(s.agreeing for s in shares))
    return found


def captures_table(rows: Sequence[Result]) -> Table:
    """Print the table of the other captures."""
    table = Table("capture", "samples", "checksum errors", "unparsed bytes", "read", "", box=None)
    for row in rows:
        counts = (str(row.samples), str(row.checksum_errors), str(row.unparsed_bytes))
        table.add_row(row.name, *counts, row.summary, "right" if row.right else "WRONG")
    return table


def main() -> int:
    """Print both tables and the totals."""
    folder = os.environ.get("SEATRIAL_DATA")
    if not folder:
        print("SEATRIAL_DATA is not set to the folder of the captures", file=sys.stderr)
        return 2
    console = Console(width=160, highlight=False)
    gpsd = [compare(path) for path in sorted((Path(folder) / "gpsd/daemon").glob("*.log"))]
    console.print(fixes_table(gpsd))
    shares = totals(gpsd)
    without = [row.name for row in gpsd if not row.fixes]
    for name, share in shares.items():
        console.print(f"{name}: {_text(share)} agree within gpsd's printed digits ({100.0 * share.part:.2f} %)")
    console.print(f"no position with a time in {', '.join(without)}\n")
    other_captures = list(results(Path(folder)))
    console.print(captures_table(other_captures))
    return (
        0 if all(share.part >= NEEDED for share in shares.values()) and all(row.right for row in other_captures) else 1
    )


if __name__ == "__main__":
    sys.exit(main())
