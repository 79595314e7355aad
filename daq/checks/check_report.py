"""Data for the page (HTML) of a check: findings, their logs, and the dry run of a mission."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.checks.findings import Finding
from seatrial.daq.log import WHOLE, TimeWindow

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class PredictedTrack:
    """Track of the boat over ground that is predicted for a mission.

    Attributes
    ----------
    x, y : Array (n_points,)
        Position north and east of the start [m].
    source : str
        Source of the prediction in words, for example the name of the model.
    radius : Array (n_points,), optional
        Radius [m] of the circle around each point that contains the boat with a probability of 95 %. None if it is not
        predicted.
    """

    x: FloatArray
    y: FloatArray
    source: str
    radius: FloatArray | None = None


@dataclass(frozen=True)
class DryRun:
    """Dry run of a mission, in which no thruster is commanded: its commands and its predicted track.

    Attributes
    ----------
    name : str
        Name of the mission.
    thrusters : tuple of str
        Names of the thrusters, in the order of the columns of `n`.
    t : Array (n_times,)
        Times [s] from the start of the mission, ascending, from which the commands hold.
    n : Array (n_times, n_thrusters)
        Commands, -1 to 1. The last row holds until `end`.
    end : float
        End of the mission [s].
    fence : float, optional
        Radius [m] of the rig's geofence; None if it has none.
    track : PredictedTrack, optional
        None if the track cannot be predicted.
    """

    name: str
    thrusters: tuple[str, ...]
    t: FloatArray
    n: FloatArray
    end: float
    fence: float | None = None
    track: PredictedTrack | None = None


@dataclass(frozen=True)
class CheckReport:
    """Result of `seatrial check`, the data of its HTML page: findings, and for a mission its dry run.

    Attributes
    ----------
    subject : str
        Name of the checked file; names of several files are separated by commas.
    findings : tuple of Finding
        The findings.
    logs : tuple of Path
        The logs from which the findings come.
    rig : str, optional
        Name of the rig; None if logs were checked.
    mission : DryRun, optional
        Dry run of the mission; None if no mission was checked.
    window : TimeWindow
        Interval of time of the logs that was checked. Default: the whole logs.
    """

    subject: str
    findings: tuple[Finding, ...]
    logs: tuple[Path, ...] = ()
    rig: str | None = None
    mission: DryRun | None = None
    window: TimeWindow = WHOLE
