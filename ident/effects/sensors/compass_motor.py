"""Magnetic interference of the motor current in the compass, with the lag of the AHRS heading filter.

A magnetic field fixed in the boat causes a heading error in ``sin(psi)`` and ``cos(psi)``. The current of the motors
adds a field in proportion to the current. The heading filter of an autopilot relies on its gyro over seconds, so the
estimated heading follows the compass with a time constant. A body velocity computed from the velocity over ground and
this heading is rotated by the same error. Forward speed then appears as sway.
"""

from __future__ import annotations

import numpy as np

from seatrial.ident.effects.sensors.compass import turn_body_velocity
from seatrial.ident.model import Effect, Parameter, Signals, State


def follow(s: Signals) -> None:
    """Set the rates of the two filter states of the magnetic interference of the motors, in place.

    With the sum of the magnitudes of the shaft speeds as the load, the states follow load times sin psi and load times
    cos psi with the time constant ``T_dev`` of the heading filter.
    """
    load = sum(abs(n) for n in s.n.values())
    s.rate["drawn_s"] = (load * np.sin(s.x.psi) - s.x.drawn_s) / s.p.T_dev
    s.rate["drawn_c"] = (load * np.cos(s.x.psi) - s.x.drawn_c) / s.p.T_dev


def turn(s: Signals) -> None:
    """Add the heading error due to the motor currents to the output of the heading [rad], in place.

    The error is ``dev_ms`` and ``dev_mc`` times the two filter states (load times sin psi and cos psi). The output of
    the body velocity is rotated by the same error.
    """
    error = s.p.dev_ms * s.x.drawn_s + s.p.dev_mc * s.x.drawn_c
    s.y["psi"] = s.y["psi"] + error
    turn_body_velocity(s, error)


EFFECT = Effect(
    name="compass-motor",
    title="motor-current magnetic interference in the compass",
    place="sensor",
    hooks={"rate": follow, "axes": turn},
    parameters=(
        Parameter(
            "dev_ms", 0.0, "rad", "amplitude of sin psi, for one motor at full speed", prior=(0.0, 0.3), step=0.02
        ),
        Parameter(
            "dev_mc", 0.0, "rad", "amplitude of cos psi, for one motor at full speed", prior=(0.0, 0.3), step=0.02
        ),
        Parameter(
            "T_dev",
            8.0,
            "s",
            "time constant of the heading filter",
            "log",
            prior=(8.0, 6.0),
            bounds=(0.3, 100.0),
            scales=False,
        ),
    ),
    states=(
        State("drawn_s", "", "regressor of dev_ms: sum|n_i| sin psi after the heading filter", 0.0, sd0=0.05),
        State("drawn_c", "", "regressor of dev_mc: sum|n_i| cos psi after the heading filter", 0.0, sd0=0.05),
    ),
    formula="psi_measured = psi + delta, T delta' = sum|n_i| (dev_ms sin psi + dev_mc cos psi) - delta; "
    "(u, v) rotated by delta",
    source="ArduPilot manual, compass/motor interference compensation; Bowditch, chapter 6",
    causes="cables of the motors or of the battery near the compass",
    experiment="full forward and full reverse on four constant headings, under way and moored",
    requires=("n", "f", "hull"),
    scan={"T_dev": (3.0, 8.0, 20.0)},
    alternatives=("compass", "compass-filtered", "velocity-point"),
)
