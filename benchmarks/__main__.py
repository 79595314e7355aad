"""Run the benchmarks and print their figures.

python -m benchmarks [--seed S] [--only sde,speed,diagnosis,long,fleet,logging,acquisition,codecs] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import sys
import time
from dataclasses import asdict
from pathlib import Path

for _library in ("OPENBLAS", "OMP", "MKL"):  # as in seatrial.command_line: one thread, set before the import of numpy
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
# With this variable every measured process would compile its libraries to byte code again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import importlib  # noqa: E402

from benchmarks.measure import Figure, table  # noqa: E402

PARTS = ("sde", "speed", "diagnosis", "long", "fleet", "logging", "acquisition", "codecs")


def main() -> int:
    """Measure the parts that the command line selects, print the table, and write the JSON file if it is asked for.

    The exit status is 0; an unknown part ends the program with status 2. Values that are not finite become null.
    """
    parser = argparse.ArgumentParser("python -m benchmarks", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default=",".join(PARTS), help="comma-separated parts: " + ", ".join(PARTS))
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    options = parser.parse_args()
    parts = options.only.split(",")
    if set(parts) - set(PARTS):
        parser.error(f"unknown part {sorted(set(parts) - set(PARTS))[0]!r}; the parts are {', '.join(PARTS)}")
    began, figures = time.monotonic(), list[Figure]()
    for part in parts:
        print(f"measuring: {part}", file=sys.stderr, flush=True)
        figures += importlib.import_module(f"benchmarks.{part}").figures(options.seed)
    took = time.monotonic() - began
    print(table(figures))
    print(f"\n{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}; {took:.0f} s")
    if options.json:
        rows = [
            {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in asdict(f).items()}
            for f in figures
        ]
        about = {"machine": platform.machine(), "cores": os.cpu_count(), "python": platform.python_version()}
        document = {"format": "seatrial-benchmarks 1", "seed": options.seed, **about, "figures": rows}
        options.json.write_text(json.dumps(document, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
