"""Numbers of the README that come directly from the logs: python docs/examples/milliampere/figures.py LOG...

The import drops repeated values of the shaft speed, so each sample is a new value.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from seatrial.ident.data import load_run, sample_and_hold

SETTLED = 8.0  # s after a command, from which the shaft speed is taken as settled


def main() -> None:
    """Print for each log the intervals of the shaft speed, its delay after commands, and its settled values."""
    for path in map(Path, sys.argv[1:]):
        found = load_run(path, "estimation").run.channels
        command, n = found["n_cmd_pod"], found["reported"]
        gaps = np.diff(n.t)
        print(
            f"{path.stem}: {n.t.size} samples in {n.t[-1] - n.t[0]:.0f} s, "
            f"{np.median(gaps):.1f} s apart in the median, {np.percentile(gaps, 95):.1f} s in one of twenty"
        )
        changes = np.flatnonzero(np.diff(command.value, prepend=np.nan) != 0)
        ends = np.append(command.t[changes[1:]], n.t[-1])
        first, rows = [], {}
        for k, end in zip(changes, ends, strict=True):
            after = (n.t > command.t[k]) & (n.t < end)
            times = n.t[after & (n.t > command.t[k])]
            first += [float(times[0] - command.t[k])] if times.size else []
            settled = n.value[after & (n.t > command.t[k] + SETTLED) & (n.value != 0)]
            if settled.size:
                rows[float(command.value[k])] = float(np.median(settled))
        delays = f"{min(first):.2f} to {max(first):.2f} s, median {np.median(first):.2f} s"
        print(f"  first sample after a command: {delays}")
        print("  settled: " + ", ".join(f"{c:+.1f} -> {v:+.3f}" for c, v in sorted(rows.items())))
        commanded = sample_and_hold(command, n.t)
        # Zeros are lost reports if the command was not zero now and 5 s before.
        lost = (n.value == 0) & (np.abs(commanded) > 0) & (np.abs(sample_and_hold(command, n.t - 5.0)) > 0)
        print(f"  zero while commanded to turn: {int(lost.sum())} of {n.t.size}")


if __name__ == "__main__":
    main()
