"""Actuator test of a preflight: each thruster runs for some seconds at low thrust. The operator is warned before."""

from __future__ import annotations

from seatrial.bench.mission_generators import SegmentBuilder
from seatrial.daq.config import STATIC, Mission
from seatrial.daq.errors import SeatrialError
from seatrial.daq.rig import Rig

N_TEST = 0.3  # of full command: above the usual dead zones, and low enough that a boat hardly moves
STATIC_S, HOLD_S, REST_S = 4.0, 3.0, 1.5  # s
STAIRS, STAIR_S = 6, 0.8  # number of levels of the staircase, and s of each; it shows the edge of the dead zone


def actuator_plan(rig: Rig, n: float = N_TEST) -> Mission:
    """Return the mission of an actuator test: each thruster forward, in reverse and in a staircase, then all together.

    Parameters
    ----------
    rig : Rig
        The rig with its thrusters.
    n : float
        Largest command; limited to `limits.n_max` of the rig.

    Raises
    ------
    SeatrialError
        If the rig has no thruster.
    """
    if not rig.thrusters:
        raise SeatrialError(f"{rig.path}: --actuators needs a [[thruster]], and the rig has none")
    n = min(n, rig.limits.n_max)
    count = len(rig.thrusters)
    builder = SegmentBuilder(count)
    builder.rest(STATIC, STATIC_S)
    for k, thruster in enumerate(rig.thrusters):
        levels = [n, 0.0, -n, 0.0, *(n * (j + 1) / STAIRS for j in range(STAIRS)), 0.0]
        holds = [HOLD_S, REST_S, HOLD_S, REST_S, *[STAIR_S] * STAIRS, REST_S]
        builder.add(thruster.name, holds, [[level if j == k else 0.0 for j in range(count)] for level in levels])
    builder.add("together", [HOLD_S, REST_S, HOLD_S, REST_S], [[level] * count for level in (n, 0.0, -n, 0.0)])
    builder.rest(STATIC, STATIC_S)
    return Mission(
        name="actuator test",
        kind="mission",
        thrusters=tuple(thruster.name for thruster in rig.thrusters),
        segments=tuple(builder.segments),
        end=builder.t,
        n_max=n,
        made_by=f"seatrial check --actuators, n {n:g}",
    )


def warning(plan: Mission) -> str:
    """Return the warning that the operator has to confirm: the thrusters, the largest command, and the duration."""
    return f"{', '.join(plan.thrusters)} will turn, at up to n = {plan.n_max:g}, for up to {plan.end:.0f} s"
