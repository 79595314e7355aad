"""Layout of a kernel's arrays: names, sizes and kinds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

ROWS = frozenset({"u", "u_next", "y", "h"})  # the data, as graphs name them


@dataclass(frozen=True)
class Layout:
    """sizes: entries of every array, in the order of the kernel's arguments; the rest as in `loop_plan.Plan`."""

    sizes: Mapping[str, int]
    rows: frozenset[str]
    lanes: frozenset[str]
    carried: frozenset[str]
    summed: tuple[str, ...]
    grams: frozenset[str]
    width: int

    def shape(self, name: str, n_rows: int, groups: int, per_row: bool = False) -> tuple[int, ...]:
        """(rows if it has them, groups and width if it is in lanes, entries in between)."""
        if name in self.grams:
            return (groups, groups, self.width, self.width)
        row = (n_rows,) if name in self.rows or per_row else ()
        lane = name in self.lanes
        return (*row, *((groups,) * lane), self.sizes[name], *((self.width,) * lane))
