"""Gravity in the accelerometers, caused by pitch with thrust and roll in turns."""

from __future__ import annotations

from seatrial.ident.model import Effect, Parameter, Signals
from seatrial.ident.models import rotations


def add_gravity(s: Signals) -> None:
    """Add the part of gravity due to pitch and roll to the accelerometer outputs ``ax`` and ``ay`` [m/s2], in place.

    Pitch is ``k_pitch`` [rad/N] times the total thrust. Roll is ``k_roll`` times the lateral acceleration u r.
    """
    s.y["ax"] = s.y["ax"] + rotations.G * s.p.k_pitch * s.X_thrust
    s.y["ay"] = s.y["ay"] + rotations.G * s.p.k_roll * s.x.u * s.x.r


EFFECT = Effect(
    name="accelerometer-tilt",
    title="gravity in the accelerometers from pitch and roll",
    place="sensor",
    hooks={"output": add_gravity},
    parameters=(
        Parameter("k_pitch", 0.0, "rad/N", "pitch per thrust", prior=(0.0, 2e-3), step=1e-4),
        Parameter("k_roll", 0.0, "rad s2/m", "roll per lateral acceleration", prior=(0.0, 0.15), step=5e-3),
    ),
    formula="a_x += g k_pitch X, a_y += g k_roll u r",
    source="IEEE Std 1293; metacentric stability",
    causes="an inertial sensor that is not level, a hull that trims or heels with speed and turns",
    experiment="forward and reverse steps on a straight line, then turns at speed",
    requires=("hull",),
    alternatives=("accelerometer-scale", "cg-offset"),
)
