"""Tare of load cells: their zero and its drift, from the segments at rest at the start and at the end."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from seatrial.daq.config import STATIC, Mission
from seatrial.daq.log import open_log
from seatrial.daq.rig import LOAD_CELLS, Rig
from seatrial.daq.samples import LoadCell

SETTLE_S = 3.0  # run seconds from zero thrust until the water and the rod are at rest


class Tare(NamedTuple):
    """Tare: mean raw measurement of one load cell while thrust is zero.

    Attributes
    ----------
    device : str
        Name of the load cell.
    where : str
        Interval at rest: "start" or "end" of the mission.
    t : float
        Mean run time of the samples [s].
    counts : float
        Mean raw measurement [counts].
    standard_error : float
        Standard error of the mean [counts], for independent samples.
    n_samples : int
        Number of samples.
    """

    device: str
    where: str
    t: float
    counts: float
    standard_error: float
    n_samples: int


def static_windows(mission: Mission, start: float) -> list[tuple[str, float, float]]:
    """Return the intervals at rest at the start and at the end of a mission that is run without repetitions.

    Parameters
    ----------
    mission : Mission
        The mission. Only its first and its last segment count, and only if they have the name of a segment at rest
        (`STATIC`).
    start : float
        Run time [s] at which the mission starts.

    Returns
    -------
    list of tuple
        ("start" or "end", begin, end), with run times [s]. An interval is missing if the mission does not rest there; a
        mission of one segment has none at the end. The last interval begins 3 s (`SETTLE_S`) after zero thrust, or in
        the middle of a segment of less than 6 s.
    """
    return windows_of([(start + begin, start + end, name) for begin, end, name in mission.segment_times()])


def windows_of(spans: Sequence[tuple[float, float, str]]) -> list[tuple[str, float, float]]:
    """Return the intervals at rest at the start and at the end of a run, from its segments as they were executed.

    Parameters
    ----------
    spans : sequence of tuple
        Begin [run s], end [run s] and name of each segment, in the order of time; at least one. Only the first and the
        last one count, and only if they have the name of a segment at rest (`STATIC`).

    Returns
    -------
    list of tuple
        ("start" or "end", begin, end), with run times [s]. An interval is missing if there is no rest; a single segment
        gives none at the end. The last interval begins 3 s (`SETTLE_S`) after zero thrust, or in the middle of a
        segment that is shorter than 6 s.
    """
    windows = []
    if spans[0][2] == STATIC:
        windows.append(("start", spans[0][0], spans[0][1]))
    if len(spans) > 1 and spans[-1][2] == STATIC:
        begin, end, _ = spans[-1]
        windows.append(("end", min(begin + SETTLE_S, (begin + end) / 2), end))
    return windows


def measure_tares(path: Path, rig: Rig, windows: Sequence[tuple[str, float, float]]) -> list[Tare]:
    """Return the mean raw measurement of each load cell in each interval at rest.

    Samples with a flag (saturated or spike) are left out.

    Parameters
    ----------
    path : Path
        The log, which may still grow.
    rig : Rig
        The rig with its load cells.
    windows : sequence of tuple
        Intervals at rest: ("start" or "end", begin, end), with run times [s]. Samples at ``end`` do not count.

    Returns
    -------
    list of Tare
        Tares in the order of the load cells in the rig, and of the intervals for each. A load cell without samples has
        no tare, and an interval with fewer than two samples gives none.

    Raises
    ------
    SeatrialError
        If the log cannot be read.
    """
    tares = []
    with open_log(path) as log:
        with_samples = log.sources(LoadCell)
        cells = [device.name for device in rig.devices if device.protocol in LOAD_CELLS and device.name in with_samples]
        tables = {name: log.table(LoadCell, name) for name in cells}
    for name, table in tables.items():
        for where, begin, end in windows:
            inside = table[(table["t"] >= begin) & (table["t"] < end) & (table["flags"] == 0)]
            if len(inside) < 2:
                continue
            error = float(np.std(inside["counts"], ddof=1)) / math.sqrt(len(inside))
            mean, t = float(np.mean(inside["counts"])), float(np.mean(inside["t"]))
            tares.append(Tare(name, where, t, mean, error, len(inside)))
    return tares


def describe_tares(tares: Sequence[Tare], rig: Rig) -> list[str]:
    """Return lines of text for the operator and the log: the tares of load cells and their drift.

    Parameters
    ----------
    tares : sequence of Tare
        Tares; those of one load cell in the order of time.
    rig : Rig
        The rig. If it has a calibration of a load cell, the drift is given in N too.

    Returns
    -------
    list of str
        A line for each tare. The second and each later tare of a load cell is followed by a line with the drift since
        the first one, in counts, and the time between them.
    """
    lines, first = [], dict[str, Tare]()
    for tare in tares:
        lines.append(
            f"{tare.device} zero at the {tare.where}: {tare.counts:.1f} counts"
            f" (standard error {tare.standard_error:.1f}, {tare.n_samples} readings)"
        )
        before = first.setdefault(tare.device, tare)
        if before is not tare:
            drift, calibration = tare.counts - before.counts, rig.device(tare.device).calibration
            force = "" if calibration is None else calibration.force(tare.counts) - calibration.force(before.counts)
            newton = f" = {force:+.3f} N" if isinstance(force, float) else ""
            lines.append(f"{tare.device} drift: {drift:+.1f} counts{newton} in {tare.t - before.t:.0f} s")
    return lines
