"""Elastic line to a fixed point: a spring beyond its slack length."""

from __future__ import annotations

import numpy as np

from seatrial.ident.model import INF, Effect, Parameter, Signals
from seatrial.ident.numerics import ned_to_body

CORNER_WIDTH = 0.1  # width of the rounded corner at the slack length, relative to k_m l_slack


def pull(s: Signals) -> None:
    """Add the force of an elastic line to a fixed point to the surge and sway forces ``s.X``, ``s.Y`` [N], in place.

    The line is a spring with the stiffness ``k_m`` beyond its slack length ``l_slack``. Inside the slack length, the
    force is about zero; the transition is smooth. A negative slack length is a pretension. ``F_mx``, ``F_my`` are the
    force of a spring without slack at the origin of the position. With them instead of the fixed point, that force is
    linear in the parameters.
    """
    p = s.p
    north, east = p.F_mx - p.k_m * s.x.x, p.F_my - p.k_m * s.x.y
    tension, slack_tension = np.sqrt(north * north + east * east + 1e-12), p.k_m * p.l_slack
    taut = tension - slack_tension
    # remaining share of the tension: one without slack, about zero inside the slack length
    part = (taut + np.sqrt(taut * taut + CORNER_WIDTH * CORNER_WIDTH * slack_tension * slack_tension)) / (2 * tension)
    forward, starboard = ned_to_body(s.x.psi, north, east)
    s.X, s.Y = s.X + part * forward, s.Y + part * starboard


EFFECT = Effect(
    name="mooring",
    title="an elastic line to a fixed point",
    place="environment",
    hooks={"force": pull},
    parameters=(
        Parameter("k_m", 0.0, "N/m", "stiffness of the line", prior=(0.0, 3.0), bounds=(0.0, INF), step=0.02),
        Parameter(
            "F_mx", 0.0, "N", "force of the line to the north at the origin of x and y", prior=(0.0, 20.0), step=0.5
        ),
        Parameter(
            "F_my", 0.0, "N", "force of the line to the east at the origin of x and y", prior=(0.0, 20.0), step=0.5
        ),
        Parameter("l_slack", 0.0, "m", "slack length", prior=(0.0, 15.0), bounds=(-20.0, 200.0), step=0.5),
    ),
    formula="F = -k (1 - l / d) (p - a) beyond d = |p - a| = l, the fixed point a at (F_mx, F_my) / k",
    source="a mooring line or an umbilical as a spring, Faltinsen 1990, chapter 8",
    causes="a line or an umbilical that is made fast",
    experiment="runs away from the fixed point in several directions, slack and taut",
    requires=("hull",),
    one_sided=True,
    fixed_point=True,
    nests=("steady-pull",),
    alternatives=("tether", "steady-pull", "current-drift", "wind"),
)
