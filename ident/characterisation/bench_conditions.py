"""Conditions that a log of a thruster has to meet: a boat at rest, and a dead zone that the shaft speeds confirm.

A thruster model assumes that the boat does not move. Its shaft does not turn inside the dead zone, and follows the
whole command outside.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from seatrial.ident.checks import speed_of_positions, speed_of_velocities
from seatrial.ident.data import Channel
from seatrial.ident.models import DEAD_ZONE_EDGE
from seatrial.ident.numerics import Array, steady_segments

MOVING = 0.3  # m/s, 90 % quantile of the speed over ground; noise of a receiver, or a boat on its lines, gives less
POSITIONS_OVER_S = 10.0  # over which positions are differenced, so that their noise gives less than `MOVING`
SPEED_QUANTILE = 0.9  # of the speed over ground; a test may begin and end with the boat at rest
SETTLED_TIME_CONSTANTS = 4.0  # after a change of command, until the shaft speed counts as settled
MIN_SAMPLES = 4  # of the settled shaft speed
LEAST_SPEED = 0.02  # of full speed; a shaft turns at larger speeds


@dataclass(frozen=True)
class TurningShaft:
    """Command inside a fitted dead zone that was held, and at which the shaft turned.

    Attributes
    ----------
    command
        Command, as a part of full command, -1 to 1.
    speed
        Median of the settled shaft speed, as a part of full speed.
    start, end
        Times [s] between which the command was held, in the time of the channels.
    """

    command: float
    speed: float
    start: float
    end: float


def speed_over_ground(channels: Mapping[str, Channel]) -> float | None:
    """Return the speed over ground [m/s] that a boat exceeded for a tenth of its log.

    Parameters
    ----------
    channels
        Signals of the log. The speed is that of ``vx`` and ``vy``, or else of ``u``, of ``speed``, or of the change of
        the positions ``x`` and ``y`` over 10 s.

    Returns
    -------
    float or None
        None if the log has none of these signals.
    """
    speed = _speeds(channels)
    speed = speed[np.isfinite(speed)]
    return float(np.quantile(speed, SPEED_QUANTILE)) if speed.size else None


def _speeds(channels: Mapping[str, Channel]) -> Array:
    """Return samples of the speed over ground (n,) [m/s]; empty if the signals of a log do not give it."""
    if {"vx", "vy"} <= channels.keys():
        return speed_of_velocities(channels["vx"], channels["vy"]).value
    for name in ("u", "speed"):
        if name in channels:
            return np.abs(channels[name].value)
    if {"x", "y"} <= channels.keys():
        return speed_of_positions(channels["x"], channels["y"], POSITIONS_OVER_S).value
    return np.empty(0)


def turning_inside_dead_zone(
    command: Channel, shaft: Channel, dead_zone: float, delay: float, time_constant: float
) -> TurningShaft | None:
    """Return the held command inside a fitted dead zone at which the shaft turned fastest; None if it never turned.

    Only the settled shaft speed counts: from four time constants after the delay on. The end of the dead zone has a
    transition of 0.5 % of full command, in which the model gives only a part of the command. The upper half of it
    counts as inside: a shaft that settles there is one for which no dead zone of the model fits.

    Parameters
    ----------
    command
        Commands, as parts of full command, each held until the next one.
    shaft
        Measured shaft speed, as a part of full speed.
    dead_zone
        End of the fitted dead zone, as a part of full command.
    delay, time_constant
        Fitted delay and time constant of the shaft [s].
    """
    settle = delay + SETTLED_TIME_CONSTANTS * time_constant
    inside = dead_zone + 0.5 * DEAD_ZONE_EDGE
    found = []
    for held in steady_segments(command.t, command.value, float(max(command.t[-1], shaft.t[-1]))):
        if not 0.0 < abs(held.level) < inside:
            continue
        n = shaft.value[(shaft.t >= held.start + settle) & (shaft.t < held.end) & np.isfinite(shaft.value)]
        if n.size >= MIN_SAMPLES and np.sign(held.level) * np.median(n) > LEAST_SPEED:
            found.append(TurningShaft(held.level, float(np.median(n)), held.start, held.end))
    return max(found, key=lambda x: abs(x.speed), default=None)
