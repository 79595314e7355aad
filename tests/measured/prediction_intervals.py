"""Shares of unused samples inside the 95 % intervals 10 s ahead, on boats of a realistic plant of other authorship.

    python -m tests.measured.prediction_intervals [--boats a,b]

For each boat under SEATRIAL_DATA/real_boats, `st.fit` fits runs 1 and 2 and is validated on run 3. The intervals are
those of the model, and those that are widened by run 3. The errors are those of run 4, which was not used.
"""

from __future__ import annotations

import argparse
import gzip
import warnings
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import seatrial as st
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.validation.calibration import (
    NEARLY_ALL,
    calibration_test,
    horizon_calibration,
    horizon_forecasts,
)
from tests.measured.real_boats import folder
from tests.recovery.logged import seatrial

HORIZON = 10.0  # s
RUNS = ("run1", "run2", "run3", "run4")


def main(words: Sequence[str] | None = None) -> None:
    """Print one line for each boat."""
    parser = argparse.ArgumentParser(description="shares of unused samples inside the 95 % intervals")
    parser.add_argument("--boats", help="names of boats, separated by commas; by default all")
    options = parser.parse_args(words)
    names = options.boats.split(",") if options.boats else sorted(p.name for p in folder().iterdir() if p.is_dir())
    warnings.simplefilter("ignore", st.SeatrialWarning)
    for name in names:
        predicted, widened = shares(name)
        print(f"{name}: predicted {100 * predicted:.1f} %, widened {100 * widened:.1f} %", flush=True)


def shares(boat: str) -> tuple[float, float]:
    """Return the shares of the samples of run 4 inside the predicted and inside the widened intervals, all channels."""
    source = folder() / boat
    with TemporaryDirectory() as name:
        work = Path(name)
        for run in RUNS:
            (work / f"{run}.csv").write_bytes(gzip.decompress((source / f"{run}.csv.gz").read_bytes()))
            seatrial(work, "import", str(source / "map.toml"), f"{run}.csv", "-o", f"{run}.mcap")
        logs = [work / f"{run}.mcap" for run in RUNS]
        fitted = st.fit(logs[:2], validate=logs[2:]).fitted
    likelihood = Likelihood(fitted.model)
    third, fourth = (
        horizon_calibration(horizon_forecasts(v.model, v.record, v.values, v.run, HORIZON, likelihood))
        for v in fitted.validation
    )
    factors = {n: 1.0 if (c := calibration_test([z])) is None else c.widening for n, z in third.items()}
    inside = [
        np.concatenate([np.abs(z) < NEARLY_ALL * by.get(n, 1.0) for n, z in fourth.items()]) for by in ({}, factors)
    ]
    return float(np.mean(inside[0])), float(np.mean(inside[1]))


if __name__ == "__main__":
    main()
