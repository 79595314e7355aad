"""Drag of a towed line or tether."""

from __future__ import annotations

import numpy as np

from seatrial.ident.model import INF, Effect, Parameter, Signals


def drag(s: Signals) -> None:
    """Add the drag of a towed line to the surge and sway forces ``s.X``, ``s.Y`` [N], in place.

    The drag is ``k_tether d |V| V`` against the velocity V over ground, with the distance d of the boat from the fixed
    end of the line (``x_tether``, ``y_tether``). In a model without current, the current is zero.
    """
    p, x = s.p, s.x
    cos, sin = np.cos(x.psi), np.sin(x.psi)
    over_x = cos * x.u - sin * x.v + getattr(p, "V_x", 0.0)
    over_y = sin * x.u + cos * x.v + getattr(p, "V_y", 0.0)
    distance = np.sqrt((x.x - p.x_tether) * (x.x - p.x_tether) + (x.y - p.y_tether) * (x.y - p.y_tether) + 1e-6)
    pull = p.k_tether * distance * np.sqrt(over_x * over_x + over_y * over_y + 1e-9)
    s.X = s.X - pull * (cos * over_x + sin * over_y)
    s.Y = s.Y - pull * (-sin * over_x + cos * over_y)


EFFECT = Effect(
    name="tether",
    title="the drag of a tether or towed line",
    place="environment",
    hooks={"force": drag},
    parameters=(
        Parameter(
            "k_tether",
            0.0,
            "kg/m2",
            "drag coefficient per metre of line",
            prior=(0.0, 0.15),
            bounds=(0.0, INF),
            step=5e-3,
        ),
        *(
            Parameter(
                f"{axis}_tether",
                0.0,
                "m",
                f"position of the fixed end of the line, {side} of the origin",
                prior=(0.0, 20.0),
                step=1.0,
            )
            for axis, side in (("x", "north"), ("y", "east"))
        ),
    ),
    scan={f"{axis}_tether": (-30.0, -12.0, 0.0, 12.0, 30.0) for axis in "xy"},
    formula="F -= k d |V| V, d the distance from the fixed end, V the velocity over ground",
    source="Faltinsen 1990, chapter 8: drag of a cable that is towed in the direction of its length d",
    causes="a long cable that the boat drags along",
    experiment="the same runs near the fixed end of the tether and far from it, outbound and inbound",
    requires=("hull",),
    one_sided=True,
    fixed_point=True,
    alternatives=("mooring", "battery-sag", "current-drift", "wind"),
)
