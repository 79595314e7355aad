"""Write docs/thesis.md and docs/thesis.html: ``python -m benchmarks.thesis [--seed S] [--out docs] [--bench LOG]``."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

for _library in ("OPENBLAS", "OMP", "MKL"):  # matrices are small; before numpy
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

from benchmarks.thesis.page import write  # noqa: E402
from seatrial.daq.errors import SeatrialError  # noqa: E402


def main(words: Sequence[str] | None = None) -> int:
    """Both files; 1 and a line where a log cannot be used."""
    parser = argparse.ArgumentParser(
        "python -m benchmarks.thesis", description="The paper's tables and figures once more."
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("docs"), help="folder")
    parser.add_argument("--bench", type=Path, metavar="LOG", help="log of a bench run, for table 2")
    parser.add_argument("--evaluations", type=int, default=15_000, help="work of the search for designs, chapter 5")
    parser.add_argument("--repeats", type=int, default=50, help="fits of the designed experiment, chapter 5")
    given = parser.parse_args(words)
    try:
        write(
            given.out,
            given.seed,
            given.bench,
            lambda line: print(line, file=sys.stderr, flush=True),
            evaluations=given.evaluations,
            repeats=given.repeats,
        )
    except (SeatrialError, OSError) as problem:
        print(f"seatrial: {problem}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
