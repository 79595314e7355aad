"""Scales of prediction errors on two runs of a boat: how much wider intervals must be than one validation run shows.

    python -m tests.recovery.interval_study [--boats 12] [--jobs 2] [--out FILE]

Realistic mock boats make three runs. The model is fitted to the first run. It predicts 10 s ahead on the second and on
the third one, and simulates both. Each of these runs gives the scale of each channel, the root mean square of error
over predicted standard deviation. The study estimates two numbers of seatrial.ident.estimation.interval_widening:

- ``RUN_SCATTER``: the scales of two runs 10 s ahead differ by more than their few independent errors explain. It is the
  standard deviation of the logarithm of the scale of a run that remains.
- ``BOAT_SCATTER``: the standard deviation of the logarithm of the scale of a simulation between boats, about that of a
  calibrated model. Its square is the mean product of the logarithms of both runs, whose errors are independent.

The second run then widens the intervals of the third one, which was not used. The study counts the errors inside them.
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
from seatrial.ident.estimation import ErrorScale, FittedModel, RecordEvaluation, parameter_uncertainty
from seatrial.ident.estimation.interval_widening import BOAT_SCATTER
from seatrial.ident.numerics import Array
from seatrial.ident.validation.calibration import (
    NEARLY_ALL,
    horizon_calibration,
    horizon_forecasts,
    pooled_calibration,
    simulation_calibration,
)
from seatrial.ident.validation.prediction_errors import simulation_run
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
KINDS = ("horizon", "simulation")
GRID = np.linspace(0.0, 1.0, 41)  # probabilities of the quantiles of |error / sd|, from which coverage follows
DIVERGED = 99.0  # largest quantile that is stored


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
        runs = [scales_of_run(fitted, v) for v in fitted.validation]
    return row | {"runs": runs}


def scales_of_run(fitted: FittedModel, view: RecordEvaluation) -> Row:
    """Return the errors of one run over their predicted standard deviations, by kind of prediction and channel.

    Each channel has the scale, the number of independent errors, and the quantiles of the absolute values.
    """
    forecasts = horizon_forecasts(fitted.model, view.record, view.values, view.run, HORIZON)
    uncertainty = parameter_uncertainty(fitted.fit, None)
    simulated = simulation_run(fitted.model, view.record, view.values, uncertainty=uncertainty)
    errors = {
        "horizon": horizon_calibration(forecasts),
        "simulation": simulation_calibration(fitted.model, view.record, simulated),
    }
    found = {}
    for kind, by_name in errors.items():
        tested = pooled_calibration([by_name], together=kind == "simulation")
        found[kind] = {
            n: [round(c.scale, 4), round(c.n_effective, 2), quantiles(by_name[n])] for n, c in tested.items()
        }
    return found


def quantiles(z: Array) -> list[float]:
    """Return the quantiles of the absolute values of z, without NaN, at the probabilities of `GRID`."""
    size = np.minimum(np.abs(z[~np.isnan(z)]), DIVERGED)
    return [round(float(q), 3) for q in np.quantile(size, GRID)]


def scatter(rows: Sequence[Row], kind: str = "horizon") -> tuple[int, float, float]:
    """Return the number of boats and channels, the mean square of the log ratio of the scales, and the part of it that
    the numbers of independent errors explain, for one kind of prediction.
    """
    squares, sampling = [], []
    for row in rows:
        second, third = (run[kind] for run in row["runs"])
        for name in second.keys() & third.keys():
            (s2, n2), (s3, n3) = second[name][:2], third[name][:2]
            squares.append(np.log(s3 / s2) ** 2)
            # The logarithm of a mean of squares has the variance trigamma(n / 2), and that of its root a quarter.
            sampling.append(0.25 * float(polygamma(1, n2 / 2) + polygamma(1, n3 / 2)))
    return len(squares), float(np.mean(squares)), float(np.mean(sampling))


def boat_scatter(rows: Sequence[Row], kind: str = "simulation") -> float:
    """Return the standard deviation between boats of the logarithm of the scale, about zero.

    The independent errors of two runs of a boat do not contribute to the mean product of both logarithms.
    """
    products = []
    for row in rows:
        second, third = (run[kind] for run in row["runs"])
        products += [np.log(second[n][0]) * np.log(third[n][0]) for n in second.keys() & third.keys()]
    return float(np.sqrt(max(0.0, float(np.mean(products)))))


def coverage(rows: Sequence[Row], kind: str, between: float = BOAT_SCATTER) -> list[tuple[float, float]]:
    """Return for each row the mean shares of the errors of the third run inside the 95 % intervals over its channels.

    The first number is that of the intervals of the model, the second that of the intervals widened by the second run.
    ``between`` is the scatter of simulations between boats.
    """
    found = []
    for row in rows:
        second, third = (run[kind] for run in row["runs"])
        shares = []
        for name in second.keys() & third.keys():
            scale, n = second[name][:2]
            known = ErrorScale(scale, n, 1)
            factor = known.simulation_widening_by(between) if kind == "simulation" else known.widening
            shares.append([share_inside(third[name][2], NEARLY_ALL * f) for f in (1.0, factor)])
        plain, widened = np.mean(shares, axis=0).tolist()
        found.append((plain, widened))
    return found


def coverage_by_other_boats(rows: Sequence[Row]) -> float:
    """Return the mean share of simulations inside the widened intervals, each boat with the scatter of the others.

    The shares of `coverage` are of the boats from which the scatter is estimated; this one is not.
    """
    shares = []
    for boat in dict.fromkeys(r["key"].rpartition("/")[0] for r in rows):
        own, others = ([r for r in rows if (r["key"].rpartition("/")[0] == boat) is same] for same in (True, False))
        shares += [widened for _, widened in coverage(own, "simulation", boat_scatter(others))]
    return float(np.mean(shares))


def share_inside(quantiles: Sequence[float], limit: float) -> float:
    """Return the share of errors whose absolute value is below a limit, from their quantiles at `GRID`."""
    return float(np.interp(limit, quantiles, GRID))


def tables(rows: Sequence[Row]) -> list[list[list[str]]]:
    """Return the tables of the scatter between runs, of that between boats, and of the coverage on the third run."""
    runs = [["scatter between runs", "boats", "log ratio of two runs, RMS", "explained", "scatter of a run", "95 %"]]
    boats = [["scatter of simulations between boats", "boats", "scatter", "95 %"]]
    inside = [["inside 95 % intervals of the third run", "boats", "of the model", "widened", "95 %"]]
    for inputs, title in INPUTS.items():
        some = [r for r in rows if r["key"].endswith(f"/{inputs}") and "error" not in r]
        if not some:
            continue
        rng = np.random.default_rng(1)
        resampled = [[some[k] for k in rng.integers(len(some), size=len(some))] for _ in range(1000)]
        for kind in KINDS:
            _, total, sampling = scatter(some, kind)
            cells = [f"{total**0.5:.2f}", f"{sampling**0.5:.2f}", f"{run_scatter(total, sampling):.2f}"]
            spread = [run_scatter(*scatter(drawn, kind)[1:]) for drawn in resampled]
            runs.append([f"{title}, {kind}", str(len(some)), *cells, reach(spread)])
            shares = np.array(coverage(some, kind))
            plain, widened = shares.mean(axis=0).tolist()
            means = [float(np.mean([w for _, w in coverage(drawn, kind)])) for drawn in resampled[:200]]
            inside.append([f"{title}, {kind}", str(len(some)), f"{plain:.3f}", f"{widened:.3f}", reach(means, 3)])
        own = [boat_scatter(drawn) for drawn in resampled]
        boats.append([title, str(len(some)), f"{boat_scatter(some):.2f}", reach(own)])
    return [runs, boats, inside]


def reach(values: Sequence[float], digits: int = 2) -> str:
    """Return the 95 % interval of a bootstrap as text."""
    low, high = np.quantile(values, (0.025, 0.975))
    return f"{low:.{digits}f} to {high:.{digits}f}"


def run_scatter(total: float, sampling: float) -> float:
    """Return the standard deviation of the log scale of one run, from the mean square of the difference of two runs
    and its part by sampling.
    """
    return float(np.sqrt(max(0.0, total - sampling) / 2.0))


def line(row: Row) -> str:
    """Return the line of a finished case: its key, and the scales of both runs by channel or the error."""
    scales = [{k: {n: c[:2] for n, c in by_name.items()} for k, by_name in r.items()} for r in row.get("runs", ())]
    return f"{row['key']} {row.get('error') or scales}"


def main(words: Sequence[str] | None = None) -> int:
    """Run the study, or continue it, and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--boats", type=int, default=12)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=OUT)
    given = parser.parse_args(words)
    warnings.simplefilter("ignore", st.SeatrialWarning)
    rows = resume(cases(given.boats), run_case, line, given.jobs, given.out)
    for table in tables(rows):
        print(as_text(table), end="\n\n")
    share = coverage_by_other_boats([r for r in rows if "error" not in r])
    print(f"simulations inside, each boat with the scatter of the others: {share:.3f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
