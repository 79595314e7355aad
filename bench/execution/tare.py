"""The load cell's zero and its drift, from the segments at rest before and after."""

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

SETTLE_S = 3.0  # run seconds after the thrust has gone until the water and the rod are at rest


class Tare(NamedTuple):
    """The mean reading of one load cell at rest."""

    device: str
    where: str  # "start" or "end"
    t: float  # s, run time of the middle of the readings
    counts: float
    standard_error: float  # counts, as if the readings were independent
    n_samples: int


def static_windows(mission: Mission, start: float) -> list[tuple[str, float, float]]:
    """Place, begin and end [run s] of the rest at the start and at the end of a mission."""
    return windows_of([(start + begin, start + end, name) for begin, end, name in mission.starts()])


def windows_of(spans: Sequence[tuple[float, float, str]]) -> list[tuple[str, float, float]]:
    """The same of segments (begin, end, name) as they were run."""
    windows = []
    if spans[0][2] == STATIC:
        windows.append(("start", spans[0][0], spans[0][1]))
    if len(spans) > 1 and spans[-1][2] == STATIC:
        begin, end, _ = spans[-1]
        windows.append(("end", min(begin + SETTLE_S, (begin + end) / 2), end))
    return windows


def measure_tares(path: Path, rig: Rig, windows: Sequence[tuple[str, float, float]]) -> list[Tare]:
    """Mean counts of each load cell in each window, without flagged readings; from a log that may still grow."""
    tares = []
    with open_log(path) as log:
        there = log.sources(LoadCell)
        cells = [device.name for device in rig.devices if device.protocol == "loadcell" and device.name in there]
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
    """A line a tare, and one for the drift between two of the same cell, in counts and N."""
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
