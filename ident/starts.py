"""Where to begin, for parameters whose likelihood has more than one hill: delays and dead zones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from ident.dataset import Record
from ident.model import Model
from ident.pe import Likelihood


def best_start(model: Model, records: Sequence[Record], grid: Mapping[str, Sequence[float]]) -> dict[str, float]:
    """The point of a grid with the largest likelihood, everything else at the model's values.

    A likelihood costs milliseconds; the product of the grid's axes should stay below some hundred points.
    """
    likelihood = Likelihood(model)
    base = np.array([p.value for p in model.parameters])
    names = [p.name for p in model.parameters]
    columns = [names.index(name) for name in grid]
    best, found = -np.inf, {name: model.parameter(name).value for name in grid}
    for point in product(*grid.values()):
        values = base.copy()
        values[columns] = point
        total = sum(likelihood.value(record, values) for record in records)
        if total > best:
            best, found = total, dict(zip(grid, point, strict=True))
    return found
