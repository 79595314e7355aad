"""Study of the check of logs on healthy runs and on injected faults:

`python -m tests.bench.check_study [--healthy 50]`.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from seatrial.daq.checks.findings import findings_lines
from tests.bench.check_cases import CASES, alarms, findings, logged, named


def main() -> None:
    """Print the number of healthy runs that raise an alarm, and how often each fault is named correctly."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--healthy", type=int, default=50, help="runs without a fault, each another boat and mission")
    parser.add_argument("--each", type=int, default=5, help="runs with each fault")
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument(
        "--actuators", action="store_true", help="48 s of actuator test, in place of a mission of 120 s"
    )
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="seatrial-check-") as name:
        folder = Path(name)
        false = 0
        short = args.actuators
        for seed in range(args.seed, args.seed + args.healthy):
            found = alarms(findings(logged(folder / f"healthy{seed}.mcap", seed, None, short)))
            false += bool(found)
            print(*(f"seed {seed}: {line}" for line in findings_lines(found)), sep="\n", end="\n" if found else "")
        print(f"healthy: a false alarm in {false} of {args.healthy} runs")
        for case in CASES:
            hits = 0
            for seed in range(args.seed, args.seed + args.each):
                path = folder / f"{case.name} {seed}.mcap"
                hits += named(case, findings(logged(path, seed, case, short)))
            print(f"{case.name:<16} found and named in {hits} of {args.each} runs", flush=True)


if __name__ == "__main__":
    main()
