"""The delay and the pole of a thruster whose news come seldom: the likelihood has several tops there.

Where a shaft is heard of every few seconds, a long delay before a quick shaft and a short one before a slow shaft say
much the same, and a search ends at the top that it begins below. So it is begun at others too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ident.bench_start import POLES
from ident.dataset import Record
from ident.fit import Fit
from ident.model import Model
from ident.models.thruster import DELAY_STEP, delay_step
from ident.pe import Likelihood

Array = NDArray[np.float64]
N_STARTS = 2
APART = 0.2  # s between delays that are tried
BETTER = 0.5  # in the log-posterior


def has_several(model: Model) -> bool:
    """Whether this is a thruster with the long delays of links that poll."""
    return "bench" in model.provides and delay_step(model) > 2 * DELAY_STEP


def highest(top: Fit, records: Sequence[Record], refit: Callable[[Mapping[str, float]], Fit]) -> Fit:
    """The best of the fit and of those from other delays and poles; ``refit`` begins at the values it is given."""
    best = top
    for start in starts(top, records):
        try:
            found = refit(start)
        except ValueError:  # a start from where nothing can be evaluated
            continue
        best = found if found.log_posterior > best.log_posterior + BETTER else best
    return best


def starts(top: Fit, records: Sequence[Record]) -> list[dict[str, float]]:
    """Delay [s] and pole [1/s] to begin with: the likeliest at other delays, with all else as it was fitted."""
    model, likelihood = top.model, Likelihood(top.model)
    names = [p.name for p in model.parameters]
    tau, a = (names.index(n) for n in ("tau", "a"))
    rows = [r.for_model(model) for r in records]

    def value(delay: float, pole: float) -> float:
        values = top.record_values.copy()
        values[:, tau], values[:, a] = delay, pole
        found = sum(likelihood.value(r, v) for r, v in zip(rows, values, strict=True))
        return found if np.isfinite(found) else -np.inf

    delays = np.arange(0.0, model.parameter("tau").bounds[1], APART)
    grid = np.array([[value(float(delay), float(pole)) for pole in POLES] for delay in delays])
    found: list[dict[str, float]] = []
    for at in np.argsort(-grid.max(axis=1)).tolist():
        others = [top.model.values["tau"], *[f["tau"] for f in found]]
        if len(found) < N_STARTS and min(abs(delays[at] - other) for other in others) > 1.5 * APART:
            found.append({"tau": float(delays[at]), "a": float(POLES[int(np.argmax(grid[at]))])})
    return found
