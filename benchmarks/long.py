"""`seatrial ident vehicle` and `diagnose` of long and of many logs: CPU and peak memory, by how much there is.

The logs are those of a mock boat that lacks nothing, kept under build/; of every four one validates, of two the second.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.measure import Figure, child, peak_mb

ROOT = Path(__file__).parents[1]
LOGS = ROOT / "build" / "long-logs"
MINUTE = 60.0
# number of logs and length of each [s]; what is wanted of the diagnosis: CPU [s], memory [MB]
SIZES = (
    (2, 5 * MINUTE, None),
    (2, 20 * MINUTE, None),
    (2, 60 * MINUTE, (30.0, 1000.0)),
    (2, 240 * MINUTE, (120.0, 2000.0)),
    (8, 5 * MINUTE, None),
    (32, 5 * MINUTE, (40.0, 1000.0)),
)


def figures(seed: int) -> Iterator[Figure]:
    """CPU and memory of both commands; a line of the diagnosis ends in what is wanted."""
    for n, seconds, wanted in SIZES:
        logs = [log(seed, run, seconds) for run in range(1, n + 1)]
        group = f"{n} logs of {seconds / MINUTE:.0f} min"
        limits = ("", "") if wanted is None else tuple(f"wanted: {x:.0f}" for x in wanted)
        with tempfile.TemporaryDirectory() as folder:
            for command, notes in (("vehicle", ("", "")), ("diagnose", limits)):
                words = [sys.executable, "-m", "benchmarks.long", command, folder, *map(str, logs)]
                done = child(words, ROOT, os.environ)
                yield Figure(group, f"{command}: CPU", done.cpu, "s CPU", note=notes[0])
                yield Figure(group, f"{command}: peak memory", done.report["peak_mb"], "MB", note=notes[1])


def log(seed: int, run: int, seconds: float) -> Path:
    """The log of one mission of the seed's boat, made where it is not yet there."""
    from tests.missions import boat_log, boat_with

    path = LOGS / f"boat{seed}-run{run}-{seconds:.0f}s.mcap"
    if not path.exists():
        LOGS.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part.mcap")
        shutil.move(boat_log(part, boat_with(None, seed), seconds, 1000 * seed + run, run), path)
    return path


def main() -> None:
    """The work of a child: one command on the logs given, then its peak memory."""
    from seatrial.command_line import main as seatrial

    what, folder, *logs = sys.argv[1:]
    n = max(1, len(logs) // 4)
    words = ["ident", what, *([] if what == "vehicle" else [f"{folder}/vehicle/model.toml"]), *logs[:-n]]
    words += [word for path in logs[-n:] for word in ("--validate", path)] + ["--out", f"{folder}/{what}"]
    with open(os.devnull, "w", encoding="utf-8") as nowhere, contextlib.redirect_stdout(nowhere):
        try:
            seatrial(words)
        except SystemExit as left:
            if left.code:
                raise
    print(json.dumps({"peak_mb": peak_mb()}))


if __name__ == "__main__":
    main()
