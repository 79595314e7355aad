"""User-defined model of a boat with one steered outboard or azimuth thruster (docs/how-to/own-model.md)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from seatrial.ident.model import Input, Model, Parameter, Signals
from seatrial.ident.models import horizontal_model


def outboard() -> Model:
    """Return the horizontal model of a boat with one steered thruster; inputs are shaft speed and angle [rad]."""
    boat = horizontal_model("general")
    return replace(
        boat,
        inputs=(Input("n_main"), Input("delta", "rad")),
        parameters=(
            *boat.parameters,
            Parameter("c_t", 60.0, "N", "thrust at full speed", "log"),
            Parameter("x_t", -0.6, "m", "position of the thruster, forward", free=False),
            Parameter("delta_0", 0.0, "rad", "angle of the thrust while the measured angle is zero", prior=(0.0, 0.1)),
        ),
        stages=(("thrust", steered_thrust), boat.stages[0], ("side_force", side_force), *boat.stages[1:]),
        source=f"{__file__}:outboard",
    )


def steered_thrust(s: Signals) -> None:
    """Set force X, Y [N] and moment N [N m] of the thruster. A positive angle turns the thrust to starboard."""
    thrust = s.p.c_t * s.u.n_main * abs(s.u.n_main)
    angle = s.u.delta + s.p.delta_0
    s.u.X = thrust * np.cos(angle)
    s.u.Y = thrust * np.sin(angle)
    s.u.N = s.p.x_t * s.u.Y


def side_force(s: Signals) -> None:
    """Add the side force of the thruster. The built-in stage ``force`` before it uses only X and N."""
    s.Y = s.Y + s.u.Y
