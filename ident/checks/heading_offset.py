"""Angle of the heading against the motion of the boat, compared between logs.

Theory of operation. Without fast turns a boat moves through the water in the direction of its bow. The velocity over
ground abeam is then that of the current, which depends on the heading, and the forward speed times the tangent of a
constant angle: the mounting angle of the heading sensor, and the crab angle of an asymmetric boat. The velocity abeam
is regressed on the forward velocity, a current, and the terms of turns (yaw rate, and forward velocity times yaw rate,
which also contain the delay and the lever arm of the GNSS). The factor of the forward velocity gives the angle. The
boat is the same in all logs of a call, so a difference of the angle is one of the mounting or calibration.

The standard error is that of the jackknife over blocks of time. A log on a single heading cannot separate the angle
from a current, which makes its standard error large.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from seatrial.daq.checks import WARNING, Finding
from seatrial.ident.checks.latency import increments_without_pause, mean_rate
from seatrial.ident.checks.sensors import SENSOR_GRID_S, Channels, common_grid
from seatrial.ident.data import parts_between, silent_times
from seatrial.ident.numerics import Array, cumulative_integral, ned_to_body

HALF_S = 1.0  # s before and after, over which headings, positions and velocities are averaged
EVERY_S = 0.5  # s between two rows
LONGEST_INTERVAL_S = 1.1  # of positions or velocities
MIN_DURATION = 60.0  # s, of the common time of heading and GNSS
# rad/s; the regression does not describe a boat that turns faster. Below 8 deg/s many logs have too few rows; from 8 to
# 40 deg/s the angles agree.
FASTEST_TURN = np.radians(20.0)
SLOW_SHARE, FAST_PERCENTILE, LEAST_SPEED = 0.3, 90.0, 0.1  # of the fast speed of the log; m/s
FEWEST_ROWS, BLOCK_S, FEWEST_BLOCKS = 60, 15.0, 5
RIDGE = 1e-3  # of the scaled regressors: the terms that a log does not excite become zero
LEAST_DIFFERENCE = 3.0  # deg; smaller differences do not matter beside those by wind and trim
CLEAR = 4.0  # standard errors; many pairs of logs are compared


class HeadingAngle(NamedTuple):
    """Angle of the measured heading against the motion through the water, with its standard error [deg].

    It is positive if the measured heading is to starboard of the motion.
    """

    angle: float
    se: float

    @property
    def text(self) -> str:
        """Angle with its standard error: ``12.1 ± 0.6 deg``."""
        return f"{self.angle:.1f} ± {self.se:.1f} deg"


def heading_angle(c: Channels) -> HeadingAngle | None:
    """Return the mean angle of the heading against the motion through the water in a log, or in its longest part.

    The parts are those between the gaps of the log, as a fit uses them.

    Parameters
    ----------
    c
        Channels (signals) of a log by name: heading, and velocities or positions.

    Returns
    -------
    HeadingAngle or None
        None without these signals, with positions or velocities slower than 1 Hz, and if the boat is
        under way without fast turns for too short a time (30 s in 5 blocks of 15 s).
    """
    gaps = silent_times(c)
    if gaps:
        c = max(parts_between(c, gaps), key=lambda part: max((np.ptp(x.t) for x in part.values()), default=0.0))
    names = ("vx", "vy") if {"vx", "vy"} <= set(c) else ("x", "y")
    if not {"psi", *names} <= set(c) or np.median(np.diff(c[names[0]].t)) > LONGEST_INTERVAL_S:
        return None
    t = common_grid(c["psi"], *(c[n] for n in names))
    if t.size * SENSOR_GRID_S < MIN_DURATION:
        return None
    heading = np.interp(t, c["psi"].t, np.unwrap(c["psi"].value))
    r = mean_rate(heading, HALF_S)
    psi = mean_rate(cumulative_integral(t, heading), HALF_S)
    over_ground = [np.interp(t, c[n].t, c[n].value) for n in names]
    if names == ("vx", "vy"):
        over_ground = [cumulative_integral(t, s) for s in over_ground]
    u, v = ned_to_body(psi, *(mean_rate(s, HALF_S) for s in over_ground))
    half, every = round(HALF_S / SENSOR_GRID_S), round(EVERY_S / SENSOR_GRID_S)
    at = np.arange(2 * half, t.size - 2 * half, every)
    at = at[increments_without_pause(c, t, at - half, 2 * half)]
    if at.size < FEWEST_ROWS:
        return None
    speed = np.hypot(u, v)
    slow = max(LEAST_SPEED, SLOW_SHARE * float(np.percentile(speed[at], FAST_PERCENTILE)))
    at = at[(np.abs(r[at]) < FASTEST_TURN) & (speed[at] > slow)]
    block = ((t[at] - t[0]) / BLOCK_S).astype(int)
    blocks = np.unique(block)
    if at.size < FEWEST_ROWS or blocks.size < FEWEST_BLOCKS:
        return None
    X = np.column_stack([u[at], np.sin(psi[at]), np.cos(psi[at]), r[at], u[at] * r[at]])
    without = np.array([_angle(X[block != k], v[at][block != k]) for k in blocks])
    se = float(np.sqrt((blocks.size - 1) / blocks.size * np.sum((without - without.mean()) ** 2)))
    return HeadingAngle(_angle(X, v[at]), se)


def _angle(X: Array, v: Array) -> float:
    """Return the angle [deg] of the heading by a regression of the velocity abeam v (n,) on X (n, 5).

    The first column of X is the forward velocity.
    """
    scale = np.maximum(np.sqrt(np.mean(X**2, axis=0)), 1e-12)
    A = (X / scale).T @ (X / scale) / v.size + RIDGE**2 * np.eye(X.shape[1])
    factors = np.linalg.solve(A, (X / scale).T @ v / v.size) / scale
    return float(-np.degrees(np.arctan(factors[0])))


def compare_headings(logs: Sequence[tuple[str, HeadingAngle | None]]) -> list[tuple[str, Finding]]:
    """Return a warning if the angle of the heading against the motion differs between logs.

    Parameters
    ----------
    logs
        Name of each log, and the angle of its heading (`heading_angle`).

    Returns
    -------
    list of tuple
        Name of a log, and its finding ``heading-offset-differs``; at most one. The log is the one that differs most
        from the others in units of the standard error, and the text has the angles of all logs.
    """
    known: Mapping[str, HeadingAngle] = {name: angle for name, angle in logs if angle is not None}
    different = [
        (first, second)
        for k, first in enumerate(known)
        for second in list(known)[k + 1 :]
        if abs(known[first].angle - known[second].angle)
        > max(LEAST_DIFFERENCE, CLEAR * float(np.hypot(known[first].se, known[second].se)))
    ]
    if not different:
        return []
    # Of equal counts, the later log: the first one is the reference.
    odd = max(reversed(list(known)), key=lambda name: sum(name in pair for pair in different))
    angles = ", ".join(f"{name} {angle.text}" for name, angle in known.items())
    text = (
        "the angle from the motion through the water to the measured heading differs between the logs by more than its "
        f"errors: {angles} (clockwise, ± one standard error)"
    )
    advice = (
        "look whether the heading sensor was turned, remounted or calibrated anew between the logs, and mount it as "
        "before; fit logs of one mounting together, or each log with its own angle (--effect mount --per-log psi_mount)"
    )
    return [(odd, Finding(WARNING, "heading-offset-differs", "frames", "psi", text, advice))]
