"""Scatter of prediction errors between runs: how much wider intervals must be than one validation run shows.

    python -m tests.recovery.interval_study [--boats 12] [--jobs 2] [--out FILE]

Realistic mock boats make three runs. The model is fitted to the first run, and predicts 10 s ahead on the second and on
the third one. Each of these runs gives the scale of each channel, the root mean square of error over predicted standard
deviation. The scales of two runs differ by more than their few independent errors explain. The study estimates the
standard deviation of the logarithm of the scale of a run that remains: ``RUN_SCATTER`` in
seatrial.ident.validation.calibration.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.special import polygamma

import seatrial as st
from seatrial.bench.mission_generators import make_mission
from seatrial.ident.validation.calibration import horizon_calibration, horizon_forecasts, pooled_calibration
from seatrial.mocks.offline_simulation import simulate
from tests.missions import write_log
from tests.recovery.cases import Row, code_state
from tests.recovery.kinds import NONE, Case, all_large, boat_of
from tests.recovery.resumable import resume
from tests.recovery.tables import as_text

OUT = Path(__file__).parents[2] / "docs/data/interval-scatter.jsonl"
FIRST_SEED = 301  # boats that no other study uses
SECONDS = (400.0, 250.0, 250.0)  # to estimate, to validate, and a run that is not used
INPUTS = {"auto": "shaft speeds", "horizontal:command": "commands only"}
HORIZON = 10.0  # s


@dataclass(frozen=True)
class ScatterCase:
    """A realistic mock boat, and the model by the inputs that it uses."""

    boat: Case
    inputs: str

    @property
    def key(self) -> str:
        """Return the key of the case in the results."""
        return f"{self.boat.key}/{self.inputs}"


def cases(boats: int) -> list[ScatterCase]:
    """Return the boats, of which every second one has a large effect that the model lacks."""
    found = []
    for seed in range(FIRST_SEED, FIRST_SEED + boats):
        large = str(np.random.default_rng([seed, 91]).choice(all_large(seed)))
        boat = Case(large, seed, "realistic") if seed % 2 else Case(NONE, seed, "realistic-clean")
        found += [ScatterCase(boat, inputs) for inputs in INPUTS]
    return found


def run_case(case: ScatterCase) -> Row:
    """Fit one boat, and return scale and number of independent errors by channel, on the second and the third run."""
    row: Row = {"key": case.key, "code": code_state()}
    seed = case.boat.seed
    with TemporaryDirectory() as name:
        logs = []
        for run, lasts in enumerate(SECONDS, start=1):
            t, n = make_mission("mixed", lasts, 100 * run + seed).setpoints()
            recording = simulate(boat_of(case.boat), t, np.asarray(n), lasts, run)
            logs.append(Path(name) / f"run{run}.mcap")
            write_log(logs[-1], "boat", recording.readings)
        try:
            fit = st.fit(logs[:1], case.inputs, validate=logs[1:], horizon=HORIZON, progress=False)
        except Exception as problem:  # The study continues and counts the failure.
            return row | {"error": f"{type(problem).__name__}: {problem}"}
        fitted = fit.fitted
        runs = []
        for v in fitted.validation:
            forecasts = horizon_forecasts(fitted.model, v.record, v.values, v.run, HORIZON)
            tested = pooled_calibration([horizon_calibration(forecasts)])
            runs.append({n: [round(c.scale, 4), round(c.n_effective, 2)] for n, c in tested.items()})
    return row | {"runs": runs}


def scatter(rows: Sequence[Row]) -> tuple[int, float, float]:
    """Return the number of boats and channels, the mean square of the log ratio of the scales, and the part of it that
    the numbers of independent errors explain.
    """
    squares, sampling = [], []
    for row in rows:
        second, third = row["runs"]
        for name in second.keys() & third.keys():
            (s2, n2), (s3, n3) = second[name], third[name]
            squares.append(np.log(s3 / s2) ** 2)
            # The logarithm of a mean of squares has the variance trigamma(n / 2), and that of its root a quarter.
            sampling.append(0.25 * float(polygamma(1, n2 / 2) + polygamma(1, n3 / 2)))
    return len(squares), float(np.mean(squares)), float(np.mean(sampling))


def table(rows: Sequence[Row]) -> list[list[str]]:
    """Return the scatter of the scales between runs, by the inputs of the model, with its 95 % interval."""
    lines = [["inputs of the model", "boats", "log ratio of two runs, RMS", "explained", "scatter of a run", "95 %"]]
    for inputs, title in INPUTS.items():
        some = [r for r in rows if r["key"].endswith(f"/{inputs}") and "error" not in r]
        if not some:
            continue
        _, total, sampling = scatter(some)
        rng = np.random.default_rng(1)
        drawn = [scatter([some[k] for k in rng.integers(len(some), size=len(some))]) for _ in range(1000)]
        low, high = np.quantile([run_scatter(t, s) for _, t, s in drawn], (0.025, 0.975))
        cells = [f"{total**0.5:.2f}", f"{sampling**0.5:.2f}", f"{run_scatter(total, sampling):.2f}"]
        lines.append([title, str(len(some)), *cells, f"{low:.2f} to {high:.2f}"])
    return lines


def run_scatter(total: float, sampling: float) -> float:
    """Return the standard deviation of the log scale of one run, from the mean square of the difference of two runs
    and its part by sampling.
    """
    return float(np.sqrt(max(0.0, total - sampling) / 2.0))


def line(row: Row) -> str:
    """Return the line of a finished case: its key, and the scales by channel or the error."""
    return f"{row['key']} {row.get('error') or row['runs']}"


def main(words: Sequence[str] | None = None) -> int:
    """Run the study, or continue it, and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--boats", type=int, default=12)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=OUT)
    given = parser.parse_args(words)
    warnings.simplefilter("ignore", st.SeatrialWarning)
    print(as_text(table(resume(cases(given.boats), run_case, line, given.jobs, given.out))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
