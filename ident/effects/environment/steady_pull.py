"""Steady force in one direction over ground: a long line, a slope of the surface, wind without a moment."""

from __future__ import annotations

import numpy as np

from seatrial.ident.model import Effect, Estimates, Parameter, Signals, directed_size


def pull(s: Signals) -> None:
    """Add the force ``(F_north, F_east)``, constant in NED, to the surge and sway forces ``s.X`` and ``s.Y`` [N].

    The force is turned to body axes by the heading. The yaw moment is not changed.
    """
    cos, sin = np.cos(s.x.psi), np.sin(s.x.psi)
    s.X = s.X + cos * s.p.F_north + sin * s.p.F_east
    s.Y = s.Y - sin * s.p.F_north + cos * s.p.F_east


def force(estimates: Estimates) -> str:
    """Return a clause for reports: "3.1 ± 0.4 N to the north and 0.2 ± 0.3 N to the west".

    Only ``F_north`` and ``F_east`` are used.
    """
    north = directed_size(estimates["F_north"], "N", "to the north", "to the south")
    east = directed_size(estimates["F_east"], "N", "to the east", "to the west")
    return f"{north} and {east}"


EFFECT = Effect(
    name="steady-pull",
    title="a steady force in one direction over ground",
    place="environment",
    hooks={"force": pull},
    parameters=(
        Parameter("F_north", 0.0, "N", "force to the north", prior=(0.0, 10.0), step=0.5),
        Parameter("F_east", 0.0, "N", "force to the east", prior=(0.0, 10.0), step=0.5),
    ),
    formula="(X, Y) += R(psi)' (F_north, F_east)",
    source="a line that is much longer than the track; the steady part of wind and waves, Fossen 2011, chapter 8",
    causes="wind, a line from the boat to a fixed point",
    experiment="drifting without thrust on several headings, and straight runs on opposite headings",
    requires=("hull",),
    alternatives=("wind", "mooring", "steady-force"),
    in_words=force,
)
