"""What a check hands over for its page: findings, the logs that show them, and the dry run of a mission."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.checks.findings import Finding

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class PredictedTrack:
    """Where a mission is expected to take the boat.

    ``x``, ``y``: north and east [m] (n,); ``radius``: of the circle about each point that holds 95 % of the boats [m]
    (n,), None where nobody has predicted it; ``source``: who predicted it, in words.
    """

    x: FloatArray
    y: FloatArray
    source: str
    radius: FloatArray | None = None


@dataclass(frozen=True)
class DryRun:
    """A mission without the boat: commands ``n`` (n_times, n_thrusters), -1 to 1, each held from its time ``t`` [s]
    (n_times,) on until the next one, the last one until ``end`` [s]; ``fence``: radius of the rig's geofence [m]."""

    name: str
    thrusters: tuple[str, ...]
    t: FloatArray
    n: FloatArray
    end: float
    fence: float | None = None
    track: PredictedTrack | None = None


@dataclass(frozen=True)
class CheckReport:
    """A finished check. ``subject``: the file that was checked, or several, for people; ``rig``: its name where a rig
    was checked, None where logs were; ``logs``: where the evidence is."""

    subject: str
    findings: tuple[Finding, ...]
    logs: tuple[Path, ...] = ()
    rig: str | None = None
    mission: DryRun | None = None
