"""Benchmark of `seatrial ident vehicle` and `diagnose` with long logs and with many logs.

The figures are CPU time and peak memory. The logs are those of a mock boat without hidden effects, and are kept under
build/. One of four logs is for validation; of two logs, the second one.
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
# Number of logs, length of each log [s], and targets of the diagnosis: CPU time [s] and memory [MB]
SIZES = (
    (2, 5 * MINUTE, None),
    (2, 20 * MINUTE, None),
    (2, 60 * MINUTE, (30.0, 1000.0)),
    (2, 240 * MINUTE, (120.0, 2000.0)),
    (8, 5 * MINUTE, None),
    (32, 5 * MINUTE, (40.0, 1000.0)),
)


def figures(seed: int) -> Iterator[Figure]:
    """Yield CPU time and peak memory of both commands for all SIZES, with the targets of the diagnosis as notes.

    ``seed`` selects the mock boat.
    """
    for n, seconds, targets in SIZES:
        logs = [log(seed, run, seconds) for run in range(1, n + 1)]
        group = f"{n} logs of {seconds / MINUTE:.0f} min"
        limits = ("", "") if targets is None else tuple(f"target: {x:.0f}" for x in targets)
        with tempfile.TemporaryDirectory() as folder:
            for command, notes in (("vehicle", ("", "")), ("diagnose", limits)):
                words = [sys.executable, "-m", "benchmarks.long", command, folder, *map(str, logs)]
                done = child(words, ROOT, os.environ)
                yield Figure(group, f"{command}: CPU", done.cpu, "s CPU", note=notes[0])
                yield Figure(group, f"{command}: peak memory", done.report["peak_mb"], "MB", note=notes[1])


def log(seed: int, run: int, seconds: float) -> Path:
    """Return the path of the log of one mission of the boat of a seed. Simulate it if the log does not exist yet.

    ``run`` selects the mission and the noise. ``seconds`` is the duration of the mission [s].
    """
    from tests.missions import boat_log, boat_with

    path = LOGS / f"boat{seed}-run{run}-{seconds:.0f}s.mcap"
    if not path.exists():
        LOGS.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".part.mcap")
        shutil.move(boat_log(partial, boat_with(None, seed), seconds, 1000 * seed + run, run), path)
    return path


def main() -> None:
    """Run one command of `seatrial ident` in this process, and print its peak memory as JSON.

    The arguments are the command ("vehicle" or "diagnose"), a folder for the results, and the logs. The last quarter of
    the logs, at least one, is for validation.
    """
    from seatrial.command_line import main as seatrial

    command, folder, *logs = sys.argv[1:]
    n = max(1, len(logs) // 4)
    words = ["ident", command, *([] if command == "vehicle" else [f"{folder}/vehicle/model.toml"]), *logs[:-n]]
    words += [word for path in logs[-n:] for word in ("--validate", path)] + ["--out", f"{folder}/{command}"]
    with open(os.devnull, "w", encoding="utf-8") as null_device, contextlib.redirect_stdout(null_device):
        try:
            seatrial(words)
        except SystemExit as end:
            if end.code:
                raise
    print(json.dumps({"peak_mb": peak_mb()}))


if __name__ == "__main__":
    main()
