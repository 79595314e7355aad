"""The GNSS antenna is not over the origin."""

from __future__ import annotations

import numpy as np

from ident.model import Effect, Signals
from ident.params import Parameter


def shift(s: Signals) -> None:
    cos, sin = np.cos(s.x.psi), np.sin(s.x.psi)
    l_x, l_y = s.p.l_x, s.p.l_y
    s.y["x"] = s.y["x"] + cos * l_x - sin * l_y
    s.y["y"] = s.y["y"] + sin * l_x + cos * l_y
    s.y["vx"] = s.y["vx"] - s.x.r * (sin * l_x + cos * l_y)
    s.y["vy"] = s.y["vy"] + s.x.r * (cos * l_x - sin * l_y)


EFFECT = Effect(
    name="lever-arm",
    title="an offset of the GNSS antenna",
    place="sensor",
    hooks={"output": shift},
    parameters=(
        Parameter("l_x", 0.0, "m", "antenna ahead of the origin", prior=(0.0, 1.5), step=0.05),
        Parameter("l_y", 0.0, "m", "antenna to starboard of the origin", prior=(0.0, 1.0), step=0.05),
    ),
    formula="p_measured = p + R(psi) l, v_measured = v + r x R(psi) l",
    source="Groves 2013, section 2.5",
    experiment="spinning on the spot, both ways round",
    requires=("hull",),
    rivals=("gnss-latency", "cg-offset"),
)
