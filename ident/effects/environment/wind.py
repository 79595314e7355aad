"""Steady wind on the hull and superstructure above the water."""

from __future__ import annotations

import math

import numpy as np

from seatrial.ident.model import Effect, Estimates, Parameter, Signals, size_in_words


def blow(s: Signals) -> None:
    """Add the force and moment of a steady wind to ``s.X``, ``s.Y`` [N] and ``s.N`` [N m], in place.

    The parameters ``F_wx``, ``F_wy`` are the wind force in NED on a boat at rest with the wind on the broadside. The
    wind velocity follows from this force and ``k_air``, the force per squared wind velocity. The surge force is ``w_x``
    times the component of the force along the boat. The yaw moment is ``w_n`` times the component across it, plus a
    term with the lever arm ``w_nn`` in oblique wind.

    The velocity of the boat over ground changes the relative wind. This change has no derivative at zero wind, because
    the wind velocity is the square root of the force. It is therefore faded out for winds weaker than about 1 m/s, and
    the derivative at zero wind is that of a steady force.
    """
    p, psi = s.p, s.x.psi
    cos, sin = np.cos(psi), np.sin(psi)
    along, across = cos * p.F_wx + sin * p.F_wy, -sin * p.F_wx + cos * p.F_wy
    squared = p.F_wx * p.F_wx + p.F_wy * p.F_wy + 1e-12
    # velocities times the square root of k_air, so that no k_air, not even zero, divides; the squares are forces
    scale, root = np.sqrt(p.k_air), squared**-0.25
    over_x = cos * s.x.u - sin * s.x.v + getattr(p, "V_x", 0.0)
    over_y = sin * s.x.u + cos * s.x.v + getattr(p, "V_y", 0.0)
    rel_along = along * root - scale * (cos * over_x + sin * over_y)
    rel_across = across * root + scale * (sin * over_x - cos * over_y)
    speed = np.sqrt(rel_along * rel_along + rel_across * rel_across + 1e-9 * p.k_air + 1e-18)
    # weight of the relative wind; the drag of the boat in air at rest is part of the damping of the hull
    moving = squared / (squared + p.k_air * p.k_air)
    along = along + moving * (speed * rel_along - along)
    across = across + moving * (speed * rel_across - across)
    s.X = s.X + p.w_x * along
    s.Y = s.Y + across
    s.N = s.N + p.w_n * across + p.w_nn * moving * rel_along * rel_across


def force(estimates: Estimates) -> str:
    """Return a clause for reports: the force [N] of the wind on the broadside, and where the wind comes from.

    The standard error of the force leaves out the correlation of its components. There is no wind speed, because that
    would rest on the area above the water, which is seldom known.
    """
    (north, north_error), (east, east_error) = estimates["F_wx"], estimates["F_wy"]
    size = math.hypot(north, east)
    error = math.hypot(north * north_error, east * east_error) / size if size else math.nan
    words = f"{size_in_words(size, error, 'N')} on the broadside"
    if size:
        words += f", from {math.degrees(math.atan2(-east, -north)) % 360.0:.0f} deg"
    return words


EFFECT = Effect(
    name="wind",
    title="steady wind",
    place="environment",
    hooks={"force": blow},
    parameters=(
        Parameter("F_wx", 0.0, "N", "wind force to the north, wind on the broadside", prior=(0.0, 15.0), step=1e-3),
        Parameter("F_wy", 0.0, "N", "wind force to the east, wind on the broadside", prior=(0.0, 15.0), step=1e-3),
        Parameter("w_x", 0.5, "", "frontal area over lateral area", prior=(0.5, 0.3), step=0.05),
        Parameter("w_n", 0.1, "m", "lever arm of the lateral force", prior=(0.1, 0.3), step=0.02),
        Parameter("w_nn", 0.0, "m", "lever arm of the moment in oblique wind", prior=(0.0, 0.3), step=0.02),
        Parameter(
            "k_air",
            0.28,
            "N s2/m2",
            "wind force on the broadside per squared wind speed",
            "log",
            prior=(0.28, 0.19),  # a factor of two: the lateral area in air of a small craft is seldom known
            step=0.02,
        ),
    ),
    # The moment of the lateral force is the most visible part, and its sign is unknown
    scan={"w_n": (-0.4, -0.15, -0.05, 0.0, 0.05, 0.15, 0.4)},
    formula="X += w_x k |V_rel| V_along, Y += k |V_rel| V_across, N += k V_across (w_n |V_rel| + w_nn V_along)",
    source="Isherwood 1972; Blendermann 1994; Fossen 2011, section 8.1",
    causes="wind on hull, superstructure and payload",
    experiment="drifting without thrust on several headings, and straight runs on opposite headings",
    requires=("hull",),
    alternatives=("steady-pull", "steady-force", "current-drift", "heading-moment", "mount"),
    # With w_x near 1, a small k_air and no lever arms, wind is a steady pull: on data of a pull it fits as well.
    separated_by={
        "steady-pull": "measure the wind (an anemometer, or a weather station for a run of the past; its direction has "
        "to agree with that of the force), or record a further run in calm air or on a day with another wind: the "
        "force of wind then changes, and that of another cause does not"
    },
    in_words=force,
)
