"""Multistart: the best of fits from several initial values, where the likelihood is multimodal.

With low-rate shaft telemetry a long delay before a quick shaft and a short delay before a slow one explain much the
same data, and a search ends at the maximum that it starts below. So it does with a dead zone that no command is near.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product

import numpy as np

from seatrial.ident.data import Record
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.maximum_likelihood import Fit

N_STARTS = 2
WORTH = 2.0  # in the log-likelihood, of one parameter alone, by which a point is likelier than the fit: not by chance
MIN_GAIN = 0.5  # in the log-posterior, by which another maximum has to be higher


def best_of_starts(first: Fit, records: Sequence[Record], refit: Callable[[Mapping[str, float]], Fit]) -> Fit:
    """The best of a fit and of those from the model's other starts; ``refit`` begins at the values it is given."""
    best = first
    for start in alternative_starts(first, records):
        try:
            found = refit(start)
        except ValueError:  # a start from where nothing can be evaluated
            continue
        best = found if found.log_posterior > best.log_posterior + MIN_GAIN else best
    return best


def alternative_starts(first: Fit, records: Sequence[Record]) -> list[dict[str, float]]:
    """The likeliest points of the model's start grid away from the fit, with all else as it was fitted.

    Parameters: first, the fit; records, what it was fitted to.
    Returns: initial values by parameter, at most ``N_STARTS``; none for a model without a start grid.
    """
    model, likelihood = first.model, Likelihood(first.model)
    grid = model.start_grid
    if grid is None:
        return []
    columns = [[p.name for p in model.parameters].index(name) for name in grid.names]
    rows = [r.for_model(model) for r in records]

    def value(point: Sequence[float]) -> float:
        values = first.record_values.copy()
        values[:, columns] = point
        found = sum(likelihood.value(r, v) for r, v in zip(rows, values, strict=True))
        return found if np.isfinite(found) else -np.inf

    others = list(product(*grid.values[1:]))
    merit = np.array([[value((a, *rest)) for rest in others] for a in grid.values[0]])
    found: list[dict[str, float]] = []
    least = sum(map(likelihood.value, rows, first.record_values)) + WORTH if grid.gaining else -np.inf
    for at in np.argsort(-merit.max(axis=1)).tolist():
        taken = [model.values[grid.names[0]], *[f[grid.names[0]] for f in found]]
        if merit[at].max() <= least:
            break
        if len(found) < N_STARTS and min(abs(grid.values[0][at] - other) for other in taken) > 1.5 * grid.apart:
            point = (grid.values[0][at], *others[int(np.argmax(merit[at]))])
            found.append(dict(zip(grid.names, map(float, point), strict=True)))
    return found
