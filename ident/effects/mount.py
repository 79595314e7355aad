"""The AHRS is turned about the vertical."""

from __future__ import annotations

import numpy as np

from ident.effects.compass import turn_body_velocity
from ident.model import Effect, Signals
from ident.params import Parameter


def turn(s: Signals) -> None:
    cos, sin = np.cos(s.p.psi_mount), np.sin(s.p.psi_mount)
    s.y["psi"] = s.y["psi"] + s.p.psi_mount
    turn_body_velocity(s, s.p.psi_mount)
    s.y["ax"], s.y["ay"] = cos * s.y["ax"] + sin * s.y["ay"], -sin * s.y["ax"] + cos * s.y["ay"]


EFFECT = Effect(
    name="mount",
    title="a turn of the AHRS about the vertical",
    place="sensor",
    hooks={"output": turn},
    parameters=(
        Parameter("psi_mount", 0.0, "rad", "turn of the AHRS, clockwise from above", prior=(0.0, 0.15), step=0.01),
    ),
    formula="psi_measured = psi + psi_0; accelerations turned by psi_0",
    source="boresight alignment, Groves 2013, section 5.6",
    experiment="straight runs on opposite headings, with and against the current",
    requires=("hull",),
    rivals=("compass", "wind"),
)
