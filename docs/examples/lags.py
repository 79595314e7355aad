"""User-defined model of a boat with a propeller and a rudder, with two lags as states (docs/how-to/own-model.md)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from seatrial.ident.model import Input, Model, Parameter, Signals, State
from seatrial.ident.models import first_order, horizontal_model


def lagging_boat() -> Model:
    """Return the built-in horizontal model with force and moment from command (-1 to 1) and rudder angle [rad]."""
    boat = horizontal_model("general")
    return replace(
        boat,
        states=(
            *boat.states,
            State("n", "", "shaft speed, normalised", 1e-3, sd0=0.1),
            State("jet", "N", "thrust that the flow at the rudder corresponds to", 0.1, sd0=5.0),
        ),
        inputs=(Input("n_cmd", prefilter=False), Input("rudder", "rad")),
        parameters=(
            *boat.parameters,
            Parameter("c_t", 60.0, "N", "thrust at full speed", "log"),
            Parameter("l_r", 0.3, "m", "side force of the rudder over thrust, times its lever"),
            Parameter("T_n", 0.3, "s", "time constant of the shaft", bounds=(0.0, 3.0)),
            Parameter("T_jet", 0.5, "s", "time constant of the flow at the rudder", bounds=(0.0, 5.0)),
        ),
        stages=(("thrust", push), *boat.stages),
        max_step=0.05,  # s, of the integration; the shortest time constant of `first_order` needs it
        source=f"{__file__}:lagging_boat",
    )


def push(s: Signals) -> None:
    """Compute force X [N] and moment N [N m]. The shaft lags behind its command, and the flow behind the thrust."""
    n = first_order(s, "n", s.u.n_cmd, s.p.T_n)
    s.u.X = s.p.c_t * n * abs(n)
    jet = first_order(s, "jet", s.u.X, s.p.T_jet)
    s.u.N = s.p.l_r * jet * np.sin(s.u.rudder)
