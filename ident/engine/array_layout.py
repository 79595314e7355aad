"""Layout of the arrays that a kernel reads and writes: their names, sizes and kinds.

A kernel is a program that runs over the rows of a record. A row holds the samples of one instant, and the inputs up to
the next row.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from seatrial.ident.numerics import Array

# Names of the data arrays in the graphs: inputs at both ends of the interval, outputs, and length of the interval
ROWS = frozenset({"u", "u_next", "y", "h"})
# Names of the arrays of the filter's mean (n,) and covariance (n, stride), and of their derivatives by the parameters,
# (n,) and (n, n) in lanes, in kernels that have the covariance as a matrix
MEAN, COVARIANCE, DERIVATIVE_OF_MEAN, DERIVATIVE_OF_COVARIANCE = "m", "P", "dm", "dP"


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
        Names of the routines (`matrix_routines`) that the machine code calls.
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

    def state_arrays(self, s: Array) -> dict[str, Array]:
        """Return the arrays by name that hold a filter state at the start of a run; they are new.

        Parameters
        ----------
        s : Array (n_s,)
            Filter state: the mean, and the upper triangle of the covariance by matrix rows.
        """
        if COVARIANCE not in self.sizes:
            return {"s": np.array(s, dtype=np.float64)}
        n = self.sizes[MEAN]
        P = np.zeros((n, self.sizes[COVARIANCE] // n))
        i, j = np.triu_indices(n)
        P[i, j] = P[j, i] = s[n:]
        return {MEAN: np.array(s[:n], dtype=np.float64), COVARIANCE: P.ravel()}

    @property
    def derivative_arrays(self) -> tuple[str, ...]:
        """Names of the arrays, in lanes, of the derivatives of the filter state in a kernel of sensitivities."""
        return tuple(name for name in ("ds", DERIVATIVE_OF_MEAN, DERIVATIVE_OF_COVARIANCE) if name in self.sizes)

    def derivative_entries(self, entry: int) -> list[tuple[str, int]]:
        """Return where a kernel of sensitivities holds the derivative of an entry of the filter state.

        They are pairs (name of the array, index in it): two pairs for an entry of the covariance off its diagonal, if
        the kernel has the covariance as a matrix. ``entry`` is the index in the filter state, as in `state_arrays`.
        """
        if DERIVATIVE_OF_COVARIANCE not in self.sizes:
            return [("ds", entry)]
        n = self.sizes[DERIVATIVE_OF_MEAN]
        if entry < n:
            return [(DERIVATIVE_OF_MEAN, entry)]
        i, j = (int(index[entry - n]) for index in np.triu_indices(n))
        return [(DERIVATIVE_OF_COVARIANCE, k) for k in sorted({i * n + j, j * n + i})]

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
