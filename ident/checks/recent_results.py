"""Results found last, so that two checks of a log that need the same estimate compute it once."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Sequence
from typing import Generic, TypeVar
from weakref import ref

from seatrial.ident.numerics import Array

R = TypeVar("R")
KEPT = 16  # results: more than the shafts of a boat


class RecentResults(Generic[R]):
    """Results found last, by the arrays that they were computed from. The arrays are not kept alive."""

    def __init__(self) -> None:
        """Begin without a result."""
        self._found: deque[tuple[Hashable, tuple[ref[Array], ...], R]] = deque(maxlen=KEPT)

    def get(self, arrays: Sequence[Array], compute: Callable[[], R], options: Hashable = ()) -> R:
        """Return the result for some arrays, and compute it only if it is not among the last ones.

        Parameters
        ----------
        arrays
            Arrays that the result depends on. The same arrays are meant, not equal ones. They may be empty if
            ``options`` has all that the result depends on.
        compute
            Function that computes the result.
        options
            What else the result depends on.
        """
        for others, of, found in tuple(self._found):
            same = others == options and len(of) == len(arrays)
            if same and all(known() is array for known, array in zip(of, arrays, strict=True)):
                return found
        result = compute()
        self._found.append((options, tuple(ref(array) for array in arrays), result))
        return result
