"""Tare of load cells: their zero and its drift, from the segments at rest at the start and at the end."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from seatrial.daq.config import STATIC, Mission
from seatrial.daq.log import open_log
from seatrial.daq.rig import Rig
from seatrial.daq.samples import LoadCell

SETTLE_S = 3.0  # run seconds from zero thrust until the water and the rod are at rest


class Tare(NamedTuple):
    """Mean reading of one load cell at rest.

    Attributes
    ----------
    device : str
        Name of the load cell.
    where : str
        Rest interval of the mission: "start" or "end".
    t : float
        Mean run time of the readings [s].
    counts : float
        Mean reading [counts].
    standard_error : float
        Standard error of the mean [counts], for independent readings.
    n_samples : int
        Number of readings.
    """

    device: str
    where: str
    t: float
    counts: float
    standard_error: float
    n_samples: int


def static_windows(mission: Mission, start: float) -> list[tuple[str, float, float]]:
    """Return the rest intervals at the start and at the end of a mission that is run without repetitions.

    Parameters
    ----------
    mission : Mission
        The mission. Only its first and last segment count, if they are named `STATIC`.
    start : float
        Run time [s] at which the mission starts.

    Returns
    -------
    list of tuple
        ("start" or "end", begin, end) in run seconds. An interval is missing if the mission does not rest there. The
        last interval begins 3 s (`SETTLE_S`) after zero thrust.
    """
    return windows_of([(start + begin, start + end, name) for begin, end, name in mission.segment_times()])


def windows_of(spans: Sequence[tuple[float, float, str]]) -> list[tuple[str, float, float]]:
    """Return the rest intervals at the start and at the end of segments as they were run.

    Parameters
    ----------
    spans : sequence of tuple
        Begin [run s], end [run s] and name of each segment, in the order of time. Only the first and the last one
        count, if they are named `STATIC`.

    Returns
    -------
    list of tuple
        ("start" or "end", begin, end) in run seconds. The last interval begins 3 s (`SETTLE_S`) after zero thrust, or
        in the middle of a segment that is shorter than 6 s.
    """
    windows = []
    if spans[0][2] == STATIC:
        windows.append(("start", spans[0][0], spans[0][1]))
    if len(spans) > 1 and spans[-1][2] == STATIC:
        begin, end, _ = spans[-1]
        windows.append(("end", min(begin + SETTLE_S, (begin + end) / 2), end))
    return windows


def measure_tares(path: Path, rig: Rig, windows: Sequence[tuple[str, float, float]]) -> list[Tare]:
    """Return the mean reading of each load cell in each interval. Flagged readings are left out.

    Parameters
    ----------
    path : Path
        The log, which may still grow.
    rig : Rig
        The rig with its load cells. Only devices with the protocol "loadcell" count.
    windows : sequence of tuple
        ("start" or "end", begin, end) in run seconds.

    Returns
    -------
    list of Tare
        Tares by load cell, then by interval. A load cell without samples and an interval with fewer than two readings
        have no tare.
    """
    tares = []
    with open_log(path) as log:
        with_samples = log.sources(LoadCell)
        cells = [device.name for device in rig.devices if device.protocol == "loadcell" and device.name in with_samples]
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
    """Return lines of text: one for each tare, and one for the drift of a load cell from its first tare to a later one.

    The drift is given in counts, and also in N if ``rig`` has a calibration of the load cell. ``tares`` are in the
    order of time.
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
