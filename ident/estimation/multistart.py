"""Multistart: the best of fits from several initial values, for a likelihood with several maxima.

With low-rate shaft telemetry, a long delay before a quick shaft and a short delay before a slow shaft explain much the
same data. A search ends at the maximum that is nearest to its start. The same happens with a dead zone if no command is
near it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product

import numpy as np

from seatrial.ident.data import Record
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.maximum_likelihood import Fit

N_STARTS = 2  # largest number of starts besides the model's own initial values
# For a start grid with ``gaining``, the log-likelihood of a point must exceed that of the fit by this: more than one
# parameter gains by chance.
START_GAIN = 2.0
MIN_GAIN = 0.5  # another maximum is taken only if its log-posterior is higher by this


def best_of_starts(first: Fit, records: Sequence[Record], refit: Callable[[Mapping[str, float]], Fit]) -> Fit:
    """Return the best of a fit and of new fits from other initial values, for a likelihood with several maxima.

    The other initial values come from the model's start grid (a grid of initial values for a few of its parameters). A
    refit replaces the best fit so far if its log-posterior is higher by more than 0.5, whether or not it has converged.
    A start from which the likelihood cannot be evaluated is skipped.

    Parameters
    ----------
    first
        Fit from the model's own initial values.
    records
        Records of this fit.
    refit
        Fits the model from given initial values by parameter. It raises ValueError if that is not possible.
    """
    best = first
    for start in alternative_starts(first, records):
        try:
            found = refit(start)
        except ValueError:  # the likelihood cannot be evaluated at this start
            continue
        best = found if found.log_posterior > best.log_posterior + MIN_GAIN else best
    return best


def alternative_starts(first: Fit, records: Sequence[Record]) -> list[dict[str, float]]:
    """Return other initial values for a search: the likeliest points of the model's start grid away from the fit.

    The start grid has initial values for a few parameters, such as delay and lag of a thruster. The log-likelihood is
    evaluated at all its points, with all other parameters as in the fit. Points are taken in the order of decreasing
    likelihood. In the first parameter of the grid, a point differs from the fit and from the points before it by more
    than 1.5 times the grid's minimum distance. A point without a finite likelihood is not taken. A fixed parameter
    keeps its value. If the option ``gaining`` of the grid is set, a point is taken only if its log-likelihood exceeds
    that of the fit by more than 2.

    Parameters
    ----------
    first
        Fit from the model's own initial values.
    records
        Records of this fit.

    Returns
    -------
    list of dict
        Initial values by parameter of the grid, at most two points. Empty if the model has no start grid, or if the
        first parameter of the grid is fixed.
    """
    model, likelihood = first.model, Likelihood(first.model)
    grid = model.start_grid
    # A start would replace the value of a fixed parameter. With the first one fixed, there is one maximum.
    if grid is None or not model.parameter(grid.names[0]).free:
        return []
    values_of = [
        values if model.parameter(name).free else (model.values[name],)
        for name, values in zip(grid.names, grid.values, strict=True)
    ]
    columns = [[p.name for p in model.parameters].index(name) for name in grid.names]
    rows = [r.for_model(model) for r in records]

    def log_likelihood(point: Sequence[float]) -> float:
        """Return the log-likelihood of all records at a point of the grid; -inf if it is not finite.

        ``point`` has one value for each parameter of the grid. All other parameters are as in the fit.
        """
        values = first.record_values.copy()
        values[:, columns] = point
        found = sum(likelihood.value(r, v) for r, v in zip(rows, values, strict=True))
        return found if np.isfinite(found) else -np.inf

    inner_points = list(product(*values_of[1:]))
    merit = np.array([[log_likelihood((a, *rest)) for rest in inner_points] for a in grid.values[0]])
    found: list[dict[str, float]] = []
    least = sum(map(likelihood.value, rows, first.record_values)) + START_GAIN if grid.gaining else -np.inf
    for at in np.argsort(-merit.max(axis=1)).tolist():
        taken = [model.values[grid.names[0]], *[f[grid.names[0]] for f in found]]
        if merit[at].max() <= least:
            break
        if len(found) < N_STARTS and min(abs(grid.values[0][at] - value) for value in taken) > 1.5 * grid.apart:
            point = (grid.values[0][at], *inner_points[int(np.argmax(merit[at]))])
            found.append(dict(zip(grid.names, map(float, point), strict=True)))
    return found
