"""Thruster that swings in its mount when it pushes astern: a loose bracket, or the missing lock of an outboard."""

from __future__ import annotations

from collections.abc import Mapping

from seatrial.ident.effects.propulsion.thrust_angle import angle_in_words
from seatrial.ident.model import Effect, Parameter, Signals


def swing(s: Signals) -> None:
    """Add the sideways force of thrusters that push astern to ``s.Y`` [N], and its yaw moment to ``s.N``, in place.

    The force is ``swing_L f_left + swing_R f_right`` of those thrusts that are negative, with the angles [rad] of the
    thrust lines, positive to starboard. The thrust astern is not changed. The moment is the force times ``x_swing``
    [m], the position of the thrusters forward of the origin.
    """
    astern = {side: (f - abs(f)) / 2 for side, f in s.f.items()}
    sideways = s.p.swing_L * astern["left"] + s.p.swing_R * astern["right"]
    s.Y = s.Y + sideways
    s.N = s.N + s.p.x_swing * sideways


def angles(estimates: Mapping[str, tuple[float, float]]) -> str:
    """Return a clause for reports: the angle to which each thruster turns when it pushes astern.

    ``estimates`` has estimate and standard error [rad] by parameter. Only ``swing_L`` and ``swing_R`` are used.
    """
    sides = (("swing_L", "left"), ("swing_R", "right"))
    parts = [f"the {side} thruster turns {angle_in_words(*estimates[name])}" for name, side in sides]
    return f"astern {' and '.join(parts)}"


EFFECT = Effect(
    name="swinging-mount",
    title="a thruster that swings in its mount when it pushes astern",
    place="actuator",
    hooks={"force": swing},
    parameters=(
        Parameter("swing_L", 0.0, "rad", "angle of the left thrust line astern", prior=(0.0, 0.3), step=0.01),
        Parameter("swing_R", 0.0, "rad", "angle of the right thrust line astern", prior=(0.0, 0.3), step=0.01),
        Parameter("x_swing", -0.5, "m", "position of the thrusters ahead of the origin", prior=(-0.5, 0.3), step=0.05),
    ),
    scan={"x_swing": (-0.9, -0.5, -0.1)},
    formula="Y += swing_L f_L + swing_R f_R for f < 0, N += x_swing Y",
    source="thrust allocation of fixed thrusters at an angle: Fossen 2011, section 12.3",
    causes="a loose bracket, the missing lock of an outboard or of a tilting mount",
    experiment="each thruster alone, astern and ahead, at several levels",
    requires=("f", "hull"),
    nests=("propeller-walk",),
    alternatives=("propeller-walk", "reverse-mismatch", "thrust-angle"),
    in_words=angles,
)
