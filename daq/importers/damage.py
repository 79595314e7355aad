"""Resynchronisation behind a damaged place of a binary log."""

from __future__ import annotations

from collections.abc import Callable

SURE = 3  # whole messages in a row, behind a damaged place, that are taken for the log again


def is_chain(place: int, size: int, end_of: Callable[[int], int]) -> bool:
    """Whether whole messages follow each other from a place on.

    Parameters
    ----------
    place
        Offset in the log [bytes].
    size
        Size of the log [bytes].
    end_of
        Function from the offset of a message to the offset of its end; -1 if no message can begin there.

    Returns
    -------
    bool
        True for `SURE` messages in a row, and for fewer that reach the end of the log.
    """
    for _ in range(SURE):
        place = end_of(place)
        if place < 0 or place == size:
            return place == size
    return True
