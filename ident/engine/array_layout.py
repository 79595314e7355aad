"""Layout of the arrays that a kernel reads and writes: their names, sizes and kinds.

A kernel is a program that runs over the rows of a record. A row holds the samples of one instant, and the inputs up to
the next row.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

# Names of the data arrays in the graphs: inputs at both ends of the interval, outputs, and length of the interval
ROWS = frozenset({"u", "u_next", "y", "h"})
# Names of the arrays of the derivatives of the filter's mean (n,) and covariance (n, n) by the parameters, in lanes
DERIVATIVE_OF_MEAN, DERIVATIVE_OF_COVARIANCE = "dm", "dP"


@dataclass(frozen=True)
class Layout:
    """Layout of the arrays that one kernel reads and writes.

    A kernel is a program that runs over the rows (instants) of a record.

    Attributes
    ----------
    sizes : Mapping[str, int]
        Number of entries of each array, in the order of the kernel's arguments.
    rows : frozenset[str]
        Names of the arrays with separate entries for each row.
    lanes : frozenset[str]
        Names of the arrays with `width` numbers for each entry, one per lane. A lane is one element of the processor's
        vector registers. It holds, for example, the derivative by one parameter.
    carried : frozenset[str]
        Names of the arrays whose values pass from one row to the next, such as the state of a filter.
    summed : tuple[str, ...]
        Names of the results that are summed over all rows, such as the log-likelihood.
    grams : frozenset[str]
        Names of the results that are matrices of inner products between all lanes (`loop_plan.GramStage`), in blocks
        of (width, width). Only blocks on and above the diagonal are written.
    width : int
        Number of lanes in one group: the numbers that a vector register holds (2, 4 or 8 in double precision).
    single : frozenset[str]
        Names of the arrays in single precision. All others are in double precision.
    routines : tuple[str, ...]
        Names of the routines (`lane_routines`) that the machine code calls.
    """

    sizes: Mapping[str, int]
    rows: frozenset[str]
    lanes: frozenset[str]
    carried: frozenset[str]
    summed: tuple[str, ...]
    grams: frozenset[str]
    width: int
    single: frozenset[str] = frozenset()
    routines: tuple[str, ...] = ()

    def dtype(self, name: str) -> type[np.floating]:
        """Return the type of the numbers of the array ``name``: float32 for an array of `single`, otherwise float64."""
        return np.float32 if name in self.single else np.float64

    def shape(self, name: str, n_rows: int, groups: int, per_row: bool = False) -> tuple[int, ...]:
        """Return the shape of an array of the kernel for a given number of rows and lanes.

        Parameters
        ----------
        name : str
            Name of the array. An unknown name raises KeyError.
        n_rows, groups : int
            Number of rows, and number of groups of `width` lanes.
        per_row : bool
            Whether the array is a summed result of which the value of each row is wanted, instead of the sum.

        Returns
        -------
        tuple[int, ...]
            (n_rows, groups, entries, width). n_rows is absent if the array is not in `rows` and ``per_row`` is False.
            groups and width are absent if the array is not in `lanes`. A result in `grams` has the shape
            (groups, groups, width, width), whatever ``per_row`` is.
        """
        if name in self.grams:
            return (groups, groups, self.width, self.width)
        row = (n_rows,) if name in self.rows or per_row else ()
        lane = name in self.lanes
        return (*row, *((groups,) * lane), self.sizes[name], *((self.width,) * lane))
