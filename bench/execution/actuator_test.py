"""Actuator test of `seatrial check --actuators`: each thruster runs for some seconds at low thrust.

This module has the plan of the test and the warning for the operator. The test is run as a mission
(seatrial.bench.execution.runner).
"""

from __future__ import annotations

from seatrial.bench.mission_generators import SegmentBuilder
from seatrial.bench.mission_text import counted_names
from seatrial.daq.config import STATIC, Mission
from seatrial.daq.errors import SeatrialError
from seatrial.daq.rig import Rig

N_ACTUATOR_TEST = 0.3  # of full command: above the usual dead zones, and low enough that a boat hardly moves
STATIC_S, HOLD_S, REST_S = 4.0, 3.0, 1.5  # s
STAIRS, STAIR_S = 6, 0.8  # number of levels of the staircase, and s of each; it shows the edge of the dead zone


def actuator_plan(rig: Rig, n: float = N_ACTUATOR_TEST) -> Mission:
    """Return the mission of an actuator test for all thrusters of a rig.

    The thrusters run one after the other: at ``n`` for 3 s, at ``-n`` for 3 s, and forward in a staircase of six equal
    steps up to ``n``, each for 0.8 s. Then all thrusters run together, at ``n`` for 3 s and at ``-n`` for 3 s. The
    commands are zero for 1.5 s after each of these (not between the levels of a staircase), and for 4 s at the start
    and at the end.

    Parameters
    ----------
    rig : Rig
        The rig with its thrusters.
    n : float
        Largest command, as a fraction of full command. A value above `limits.n_max` of the rig is reduced to it.

    Raises
    ------
    SeatrialError
        If the rig has no thruster.
    """
    if not rig.thrusters:
        raise SeatrialError(
            f"{rig.path}: --actuators needs a [[thruster]], and the rig has none; add one, or leave --actuators out"
        )
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


def turning_warning(plan: Mission) -> str:
    """Return the warning that an operator has to confirm before an actuator test or a link test is run.

    The text names the thrusters of ``plan``, its largest command, and its duration in run seconds.
    """
    return f"{counted_names(plan.thrusters)} will turn, at up to n = {plan.n_max:g}, for up to {plan.end:.0f} s"
