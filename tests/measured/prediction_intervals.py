"""Coverage of 95 % prediction intervals 10 s ahead on a run that was used neither to estimate nor to validate.

    python -m tests.measured.prediction_intervals [--jobs 2] [--out FILE]

The boats are those of `tests.measured.real_boats`. `st.fit` estimates the model from two runs and validates it on the
third. The validation widens the intervals. The model then predicts the fourth run, and the study counts the samples
inside the intervals. Each boat is fitted with the shaft speeds of its logs, and with commands only.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import seatrial as st
from seatrial.ident.estimation import FittedModel
from seatrial.ident.validation.calibration import horizon_calibration, horizon_forecasts, pooled_calibration
from tests.measured.data import import_boat, realistic_boats
from tests.recovery.cases import code_state
from tests.recovery.resumable import listed, resume
from tests.recovery.tables import as_text

OUT = Path(__file__).parents[2] / "docs/data/prediction-intervals.jsonl"
RUNS = ("run1", "run2", "run3", "run4")  # two to estimate, one to validate, one that is not used
INPUTS = {"auto": "those of the log", "horizontal:command": "commands only"}
HORIZON = 10.0  # s
HALF_WIDTH = 1.959964  # of a 95 % interval, in standard deviations
Row = dict[str, Any]


@dataclass(frozen=True)
class IntervalCase:
    """A boat by the name of its folder, and the model by the inputs that it uses."""

    boat: str
    inputs: str

    @property
    def key(self) -> str:
        """Return the key of the case in the results."""
        return f"{self.boat}/{self.inputs}"


def run_case(case: IntervalCase) -> Row:
    """Fit one boat, and return the shares of samples inside the intervals by channel.

    ``plain`` are the intervals of the fitted model, ``widened`` those that the validation has widened.
    """
    row: Row = {"key": case.key, "code": code_state()}
    try:
        with TemporaryDirectory() as name:
            work = Path(name)
            import_boat(case.boat, RUNS, work)
            logs = [work / f"{run}.mcap" for run in RUNS]
            fit = st.fit(logs[:2], case.inputs, validate=logs[2:], horizon=HORIZON, progress=False)
            return row | shares(fit.fitted)
    except Exception as problem:  # The study continues and counts the failure.
        return row | {"error": f"{type(problem).__name__}: {problem}"}


def shares(fitted: FittedModel) -> Row:
    """Return the shares inside the intervals on the unused run, by kind of interval and channel.

    The first validation record widens the intervals. The second one is the unused run.
    """
    third, fourth = (horizon_forecasts(fitted.model, v.record, v.values, v.run, HORIZON) for v in fitted.validation)
    factors = {n: c.widening for n, c in pooled_calibration([horizon_calibration(third)]).items()}
    z = {n: np.abs(f.e / f.sd) for n, f in fourth.items()}
    plain = {n: round(float(np.mean(x < HALF_WIDTH)), 4) for n, x in z.items()}
    widened = {n: round(float(np.mean(x < HALF_WIDTH * factors[n])), 4) for n, x in z.items()}
    return {"plain": plain, "widened": widened, "factors": {n: round(f, 3) for n, f in factors.items()}}


def line(row: Row) -> str:
    """Return the line of a finished case: its key, and the shares by channel or the error."""
    return f"{row['key']} {row.get('error') or row['widened']}"


def table(rows: Sequence[Row]) -> list[list[str]]:
    """Return the mean share inside the intervals over the boats, for each model, with its 95 % interval."""
    lines = [["inputs of the model", "boats", "intervals of the fit", "widened by validation", "95 % interval of that"]]
    for inputs, title in INPUTS.items():
        some = [r for r in rows if r["key"].endswith(f"/{inputs}") and "error" not in r]
        if not some:
            continue
        plain, widened = (np.array([np.mean(list(r[kind].values())) for r in some]) for kind in ("plain", "widened"))
        half = 2.0 * widened.std(ddof=1) / np.sqrt(len(some)) if len(some) > 1 else np.nan
        mean = widened.mean()
        reach = f"{percent(mean - half)} to {percent(mean + half)}"
        lines.append([title, str(len(some)), percent(plain.mean()), percent(mean), reach])
    return lines


def percent(share: float) -> str:
    """Return a share as text in per cent, with one decimal."""
    return f"{100 * share:.1f} %"


def main() -> int:
    """Run the study, or continue it, and print its table."""
    boats = sorted(p.name for p in realistic_boats().glob("*") if p.is_dir())
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--boats", type=listed("boat", boats), default=boats)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=OUT)
    given = parser.parse_args()
    cases = [IntervalCase(boat, inputs) for boat in given.boats for inputs in INPUTS]
    warnings.simplefilter("ignore", st.SeatrialWarning)
    rows = resume(cases, run_case, line, given.jobs, given.out)
    print(as_text(table(rows)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
