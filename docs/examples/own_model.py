"""User-defined model of a boat with one propeller and a rudder behind it (docs/how-to/own-model.md)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from seatrial.ident.model import Input, Model, Parameter, Signals
from seatrial.ident.models import horizontal_model


def rudder_boat() -> Model:
    """Return the built-in horizontal model with force and moment from shaft speed (-1 to 1) and rudder angle [rad]."""
    boat = horizontal_model("general")
    return replace(
        boat,
        inputs=(Input("n_main"), Input("rudder", "rad")),
        parameters=(
            *boat.parameters,
            Parameter("c_t", 60.0, "N", "thrust at full speed", "log"),
            Parameter("l_r", 0.3, "m", "side force of the rudder over thrust, times its lever"),
        ),
        stages=(("thrust", push), *boat.stages),
        source=f"{__file__}:rudder_boat",
    )


def push(s: Signals) -> None:
    """Compute the force X [N] and the moment N [N m] for the force stage. A positive rudder turns to starboard."""
    s.u.X = s.p.c_t * s.u.n_main * abs(s.u.n_main)
    s.u.N = s.p.l_r * s.u.X * np.sin(s.u.rudder)
