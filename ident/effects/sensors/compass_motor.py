"""The compass is drawn by the current of the motors, and the estimate of the heading follows it slowly.

A field fixed in the boat turns the compass by ``B sin(psi) + C cos(psi)``. While the motors run there is one more, of
their cables and magnets. An autopilot's filter trusts its gyro for seconds, so its heading goes there with a time
constant of its own; a body velocity that it makes from velocity over ground and this heading is turned with it, and
forward speed shows up as sway.
"""

from __future__ import annotations

import numpy as np

from ident.effects.sensors.compass import turn_body_velocity
from ident.model import Effect, Parameter, Signals, State


def follow(s: Signals) -> None:
    load = sum(abs(n) for n in s.n.values())
    s.rate["drawn_s"] = (load * np.sin(s.x.psi) - s.x.drawn_s) / s.p.T_dev
    s.rate["drawn_c"] = (load * np.cos(s.x.psi) - s.x.drawn_c) / s.p.T_dev


def turn(s: Signals) -> None:
    error = s.p.dev_ms * s.x.drawn_s + s.p.dev_mc * s.x.drawn_c
    s.y["psi"] = s.y["psi"] + error
    turn_body_velocity(s, error)


EFFECT = Effect(
    name="compass-motor",
    title="the deviation of the compass while the motors run",
    place="sensor",
    hooks={"rate": follow, "output": turn},
    parameters=(
        Parameter("dev_ms", 0.0, "rad", "sin psi, for one motor at full speed", prior=(0.0, 0.3), step=0.02),
        Parameter("dev_mc", 0.0, "rad", "cos psi, for one motor at full speed", prior=(0.0, 0.3), step=0.02),
        Parameter(
            "T_dev",
            8.0,
            "s",
            "time in which the estimated heading follows the compass",
            "log",
            prior=(8.0, 6.0),
            bounds=(0.3, 100.0),
        ),
    ),
    states=(
        State("drawn_s", "", "what B is multiplied with: sum|n_i| sin psi through the lag", 0.0, sd0=0.05),
        State("drawn_c", "", "what C is multiplied with: sum|n_i| cos psi through the lag", 0.0, sd0=0.05),
    ),
    formula="psi_measured = psi + delta, T delta' = sum|n_i| (B sin psi + C cos psi) - delta; (u, v) turned by delta",
    source="ArduPilot manual, compass/motor interference compensation; Bowditch, chapter 6, coefficients B and C",
    experiment="full ahead and full astern on four headings, tied up as well: the heading must not move",
    requires=("n", "f", "body_velocity"),
    scan={"T_dev": (3.0, 8.0, 20.0)},
    rivals=("compass", "velocity-point"),
)
