"""Errors of navigation at the ends of GNSS outages, on a run that was used neither to estimate nor to validate.

    python -m tests.measured.outages [BOAT ...]

The boats are those of `tests.measured.real_boats`. `st.fit` estimates the model from two runs and validates it on the
third. The fixes of four intervals of the fourth run are withheld, and the first fix after each is compared with the
predicted 95 % region.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import seatrial as st
from tests.measured.data import import_boat

BOATS = (
    "asv12-none",
    "asv12-umbilical",
    "asv12-fouled_prop",
    "asv13-none-acc",
    "cat14-none",
    "cat14-bent_skeg",
    "cat14-command-none",
    "toy11-none",
    "toy11-wind_strong",
)
RUNS = ("run1", "run2", "run3", "run4")  # two to estimate, one to validate, one that is not used
OUTAGES = ((25.0, 45.0), (60.0, 90.0), (105.0, 115.0), (130.0, 160.0))  # s


def errors_of(boat: str) -> list[tuple[float, float, bool]]:
    """Return error [m], 95 % radius [m] and whether the fix is in the 95 % region, for each outage of a boat."""
    with TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore", st.SeatrialWarning)
        work = Path(name)
        import_boat(boat, RUNS, work)
        logs = [work / f"{run}.mcap" for run in RUNS]
        fit = st.fit(logs[:2], validate=logs[2])
        outages = st.navigate(fit, logs[3], gnss_outages=OUTAGES).result.outages
    return [
        (o.error, o.allowed, bool(o.inside))
        for o in outages
        if o.withheld and o.error is not None and o.allowed is not None
    ]


def main(boats: Sequence[str]) -> None:
    """Print the errors of each boat, and their summary."""
    found = []
    for boat in boats or BOATS:
        of_boat = errors_of(boat)
        found += of_boat
        print(f"{boat}: " + ", ".join(f"{error:.2f} m of {radius:.2f} m" for error, radius, _ in of_boat), flush=True)
    errors, radii, inside = np.array(found).T
    print(
        f"{len(found)} outages: {100 * inside.mean():.0f} % of the fixes inside their 95 % regions, "
        f"median error {np.median(errors):.2f} m, median radius {np.median(radii):.2f} m"
    )


if __name__ == "__main__":
    main(sys.argv[1:])
