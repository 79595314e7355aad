"""What the README states of the logs themselves: python docs/examples/milliampere/figures.py LOG..."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from seatrial.ident.data import load_run, sample_and_hold

SETTLED = 8.0  # s after a command


def main() -> None:
    """News of the shaft speed, the speed that each command settles at, and how long news of it takes."""
    for path in map(Path, sys.argv[1:]):
        found = load_run(path, "estimation").run.channels
        told, n = found["n_cmd_pod"], found["reported"]
        gaps = np.diff(n.t)
        print(
            f"{path.stem}: {n.t.size} news in {n.t[-1] - n.t[0]:.0f} s, {np.median(gaps):.1f} s apart in the median, "
            f"{np.percentile(gaps, 95):.1f} s in one of twenty"
        )
        changes = np.flatnonzero(np.diff(told.value, prepend=np.nan) != 0)
        ends = np.append(told.t[changes[1:]], n.t[-1])
        first, rows = [], {}
        for k, end in zip(changes, ends, strict=True):
            after = (n.t > told.t[k]) & (n.t < end)
            late = n.t[after & (n.t > told.t[k])]
            first += [float(late[0] - told.t[k])] if late.size else []
            settled = n.value[after & (n.t > told.t[k] + SETTLED) & (n.value != 0)]
            if settled.size:
                rows[float(told.value[k])] = float(np.median(settled))
        print(f"  first news after a command: {min(first):.2f} to {max(first):.2f} s, median {np.median(first):.2f} s")
        print("  settled: " + ", ".join(f"{c:+.1f} -> {v:+.3f}" for c, v in sorted(rows.items())))
        commanded = sample_and_hold(told, n.t)
        lost = (n.value == 0) & (np.abs(commanded) > 0) & (np.abs(sample_and_hold(told, n.t - 5.0)) > 0)
        print(f"  zero while commanded to turn: {int(lost.sum())} of {n.t.size}")


if __name__ == "__main__":
    main()
