"""Command that writes docs/thesis.md and docs/thesis.html.

``python -m benchmarks.thesis [--seed S] [--out docs] [--bench LOG]``
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

for _library in ("OPENBLAS", "OMP", "MKL"):  # as in seatrial.command_line: one thread, set before the import of numpy
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

from benchmarks.thesis.page import write  # noqa: E402
from seatrial.daq.errors import SeatrialError  # noqa: E402


def main(words: Sequence[str] | None = None) -> int:
    """Write thesis.md and thesis.html. ``words`` are the arguments; None for those of the process.

    Return the exit status: 0, or 1 with a message on standard error if a log or file cannot be read or written.
    """
    parser = argparse.ArgumentParser(
        "python -m benchmarks.thesis", description="Make the tables and figures of the paper again from simulated data."
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("docs"), help="folder for both files")
    parser.add_argument("--bench", type=Path, metavar="LOG", help="log of a bench run, for table 2")
    parser.add_argument(
        "--evaluations", type=int, default=15_000, help="evaluations in the search for designs, chapter 5"
    )
    parser.add_argument(
        "--repeats", type=int, default=50, help="simulated repeats of the designed experiment, chapter 5"
    )
    options = parser.parse_args(words)
    try:
        write(
            options.out,
            options.seed,
            options.bench,
            lambda line: print(line, file=sys.stderr, flush=True),
            evaluations=options.evaluations,
            repeats=options.repeats,
        )
    except (SeatrialError, OSError) as problem:
        print(f"seatrial: {problem}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
