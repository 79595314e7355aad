"""What must be said before an estimate is read: that the fit stopped short, that a sensor was stuck."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.dataset import Record
from ident.fit import Fit

FEWEST = 10  # samples that are all the same before a sensor is called stuck


def cautions(fit: Fit, records: Sequence[Record]) -> list[str]:
    """Lines for people, the fit's first; none where all is well."""
    said = []
    if not fit.converged:
        said.append(
            f"The fit did not converge: it {fit.message}. Take no estimate or error from it: look for a stuck or "
            "missing signal first, then give --start or --prior, or a model with fewer free parameters."
        )
    return said + [line for record in records for line in stuck(record)]


def stuck(record: Record) -> list[str]:
    """A line for each channel of a record whose samples are all the same."""
    lines = []
    for j, name in enumerate(record.outputs):
        y = record.y[:, j]
        y = y[np.isfinite(y)]
        if y.size >= FEWEST and np.ptp(y) == 0.0:
            lines.append(f"{record.name}: {name} reads {y[0]:.6g} in all of its {y.size} samples: a stuck sensor?")
    return lines
