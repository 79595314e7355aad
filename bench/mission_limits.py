"""Dry run of a mission against the limits of its rig. No thruster is commanded."""

from __future__ import annotations

import numpy as np

from seatrial.daq.config import Mission
from seatrial.daq.errors import SeatrialError
from seatrial.daq.rig import Rig


def dry_run(mission: Mission, rig: Rig) -> None:
    """Check every set-point of a mission against `limits.n_max` of the rig. No thruster is commanded.

    The slew limit of the mission is applied to the set-points before the check.

    Raises
    ------
    SeatrialError
        If the rig has no thruster of a name in the mission, or if a set-point is NaN or its absolute value exceeds the
        limit. The message names the first such set-point of the thruster.
    """
    t, n = mission.setpoints()
    for column, name in enumerate(mission.thrusters):
        rig.thruster(name)
        beyond = np.flatnonzero(~(np.abs(n[:, column]) <= rig.limits.n_max))  # `~(<=)`: NaN counts as beyond
        if beyond.size:
            k = int(beyond[0])
            raise SeatrialError(
                f"{rig.path}: the mission commands thruster {name} n = {n[k, column]:+.3f} at {t[k]:.2f} s, and "
                f"limits.n_max is {rig.limits.n_max:g}; generate it with a smaller --n-max, or raise the limit"
            )
