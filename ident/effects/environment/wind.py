"""Steady wind on the hull and superstructure above the water."""

from __future__ import annotations

import numpy as np

from ident.model import Effect, Parameter, Signals

K_AIR = 0.28  # N s2/m2, half the air density times lateral area times drag coefficient of a small boat


def blow(s: Signals) -> None:
    """(F_wx, F_wy) is the wind force in NED on a boat at rest, broadside on; the wind velocity follows from K_AIR."""
    p, psi = s.p, s.x.psi
    cos, sin = np.cos(psi), np.sin(psi)
    scale = 1 / np.sqrt(K_AIR * np.sqrt(p.F_wx * p.F_wx + p.F_wy * p.F_wy + 1e-12))
    over_x = cos * s.x.u - sin * s.x.v + getattr(p, "V_x", 0.0)
    over_y = sin * s.x.u + cos * s.x.v + getattr(p, "V_y", 0.0)
    rel_x, rel_y = p.F_wx * scale - over_x, p.F_wy * scale - over_y
    along, across = cos * rel_x + sin * rel_y, -sin * rel_x + cos * rel_y
    # without wind there is no air drag either: the drag of air at rest is part of the hull's damping
    k = K_AIR * np.tanh((p.F_wx * p.F_wx + p.F_wy * p.F_wy) * 1e4)
    speed = np.sqrt(along * along + across * across + 1e-9)
    s.X = s.X + p.w_x * k * speed * along
    s.Y = s.Y + k * speed * across
    s.N = s.N + (p.w_n * speed * across + p.w_nn * along * across) * k


EFFECT = Effect(
    name="wind",
    title="steady wind",
    place="environment",
    hooks={"force": blow},
    parameters=(
        Parameter("F_wx", 0.0, "N", "wind force to the north on the broadside", prior=(0.0, 15.0), step=3.0),
        Parameter("F_wy", 0.0, "N", "wind force to the east on the broadside", prior=(0.0, 15.0), step=3.0),
        Parameter("w_x", 0.5, "", "frontal area over lateral area", prior=(0.5, 0.3), step=0.05),
        Parameter("w_n", 0.1, "m", "lever arm of the lateral force", prior=(0.1, 0.3), step=0.02),
        Parameter("w_nn", 0.0, "m", "lever arm of the oblique part", prior=(0.0, 0.3), step=0.02),
    ),
    formula="X += w_x k |V_rel| V_along, Y += k |V_rel| V_across, N += k V_across (w_n |V_rel| + w_nn V_along)",
    source="Isherwood 1972; Blendermann 1994; Fossen 2011, section 8.1",
    experiment="drifting without thrust on several headings, and straight runs on opposite headings",
    requires=("hull",),
    rivals=("current-drift", "heading-moment", "mount"),
)
