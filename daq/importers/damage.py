"""Resynchronisation after a damaged place of a binary log."""

from __future__ import annotations

from collections.abc import Callable

RESYNC_MESSAGES = 3  # complete messages in a row that mark the end of a damaged place


def is_chain(place: int, size: int, end_of: Callable[[int], int]) -> bool:
    """Return whether complete messages of a binary log follow each other from an offset on, without a gap.

    Parameters
    ----------
    place
        Offset in the log [bytes].
    size
        Size of the log [bytes].
    end_of
        Function that returns the end [bytes] of the message at an offset; -1 if no message can begin there.

    Returns
    -------
    bool
        True for three messages in a row (`RESYNC_MESSAGES`), or for fewer messages of which the last ends exactly at
        the end of the log.
    """
    for _ in range(RESYNC_MESSAGES):
        place = end_of(place)
        if place < 0 or place == size:
            return place == size
    return True
