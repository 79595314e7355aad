"""Times in which an autopilot was armed, by its states in a log."""

from __future__ import annotations

import numpy as np

from seatrial.daq.log.reader import Log
from seatrial.daq.samples import Autopilot


def armed_intervals(log: Log, source: str) -> list[tuple[float, float]]:
    """Return the intervals of time in which an autopilot was armed, as begin and end [s since 1970], in order of time.

    A state holds until the next one. An autopilot that is armed in its last state was armed until the end of the log.

    Parameters
    ----------
    log : Log
        The log.
    source : str
        Name of the autopilot. One without states in the log has no interval.
    """
    if source not in log.sources(Autopilot):
        return []
    table = log.table(Autopilot, source)
    armed = np.concatenate([[False], table["armed"] > 0, [False]])
    edges, times = np.flatnonzero(np.diff(armed.astype(np.int8))), [*table["t"].tolist(), max(log.end, log.start)]
    return [(times[begin], times[end]) for begin, end in zip(edges[::2], edges[1::2], strict=True)]
