"""Times in which an autopilot was armed, by its states or events in a log."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from seatrial.daq.log.reader import Log
from seatrial.daq.samples import Autopilot

KIND = "autopilot"  # kind of the events about arming, and name of the autopilot of a log without its states


def armed_intervals(log: Log) -> dict[str, list[tuple[float, float]]]:
    """Return the intervals in which autopilots were armed: begin and end [s since 1970] in order of time, by name.

    A state holds until the next one. An autopilot that is armed in its last state was armed until the end of the log. A
    log without states of an autopilot, such as one that a map has imported, has them in its events; the name is then
    "autopilot". An autopilot that was never armed, or whose state is unknown, is left out.

    Parameters
    ----------
    log : Log
        The log.

    Raises
    ------
    SeatrialError
        If states or events cannot be read.
    """
    found = {}
    for source in log.sources(Autopilot):
        table = log.table(Autopilot, source)
        found[source] = _intervals(table["t"].tolist(), (table["armed"] > 0).tolist(), log.end)
    if not found:
        words = [(t, text.partition(",")[0]) for t, kind, text in log.events() if kind == KIND]
        states = [(t, word == "armed") for t, word in words if word in ("armed", "disarmed")]
        found[KIND] = _intervals([t for t, _ in states], [armed for _, armed in states], log.end)
    return {source: intervals for source, intervals in found.items() if intervals}


def _intervals(t: Sequence[float], armed: Sequence[bool], end: float) -> list[tuple[float, float]]:
    """Return begin and end [s] of each interval of armed states at times ``t`` [s]; the last ends at ``end``."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(armed, dtype=np.int8), [0]])))
    times = [*t, end]
    return [(times[a], times[b]) for a, b in zip(edges[::2], edges[1::2], strict=True)]
