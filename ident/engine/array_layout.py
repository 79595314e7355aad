"""Layout of the arrays that a kernel reads and writes: their names, sizes and kinds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

# Names of the data arrays in the graphs: inputs at both ends of the interval, outputs, and length of the interval
ROWS = frozenset({"u", "u_next", "y", "h"})


@dataclass(frozen=True)
class Layout:
    """Layout of the arrays of one kernel.

    Attributes
    ----------
    sizes : Mapping[str, int]
        Number of entries of each array, in the order of the kernel's arguments.
    rows : frozenset[str]
        Arrays with a separate entry vector for each row.
    lanes : frozenset[str]
        Arrays with `width` numbers for each entry, one per lane.
    carried : frozenset[str]
        Arrays whose values pass from one row to the next.
    summed : tuple[str, ...]
        Results that are summed over all rows.
    grams : frozenset[str]
        Results of `loop_plan.Gram`: blocks of a matrix over all lanes.
    width : int
        Number of lanes in one group.
    """

    sizes: Mapping[str, int]
    rows: frozenset[str]
    lanes: frozenset[str]
    carried: frozenset[str]
    summed: tuple[str, ...]
    grams: frozenset[str]
    width: int

    def shape(self, name: str, n_rows: int, groups: int, per_row: bool = False) -> tuple[int, ...]:
        """Return the shape of an array.

        Parameters
        ----------
        name : str
            Name of the array.
        n_rows, groups : int
            Number of rows, and number of groups of lanes.
        per_row : bool
            Whether a summed result is kept for each row instead of being summed.

        Returns
        -------
        tuple[int, ...]
            (n_rows if the array has rows, groups if it has lanes, entries, width if it has lanes).
            For a Gram result: (groups, groups, width, width).
        """
        if name in self.grams:
            return (groups, groups, self.width, self.width)
        row = (n_rows,) if name in self.rows or per_row else ()
        lane = name in self.lanes
        return (*row, *((groups,) * lane), self.sizes[name], *((self.width,) * lane))
