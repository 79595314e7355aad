"""Thrusters whose line of thrust is turned from the fore-and-aft direction, by design (toe-in) or by a bent mount."""

from __future__ import annotations

import math
from collections.abc import Mapping

from seatrial.ident.model import Effect, Parameter, Signals


def turn(s: Signals) -> None:
    """Add the sideways force of both thrusters to ``s.Y`` [N], and its yaw moment to ``s.N`` [N m], in place.

    The force is ``delta_L f_left + delta_R f_right``, with the angles [rad] of the thrust lines, positive to starboard.
    They are small: the forward thrust is not changed. The moment is the force times ``x_delta`` [m], the position of
    the thrusters forward of the origin.
    """
    sideways = s.p.delta_L * s.f["left"] + s.p.delta_R * s.f["right"]
    s.Y = s.Y + sideways
    s.N = s.N + s.p.x_delta * sideways


def angle_in_words(angle: float, se: float) -> str:
    """Return an angle [rad], positive to starboard, in words: "2.0 ± 0.3 deg to starboard".

    The size is shown in degrees with one decimal, and an angle of zero as "to port". A standard error ``se`` [rad] that
    is not finite is left out.
    """
    error = f" ± {math.degrees(se):.1f}" if math.isfinite(se) else ""
    return f"{abs(math.degrees(angle)):.1f}{error} deg to {'starboard' if angle > 0 else 'port'}"


def angles(estimates: Mapping[str, tuple[float, float]]) -> str:
    """Return a clause for reports: "the left thruster pushes 2.0 ± 0.3 deg to starboard and the right ...".

    ``estimates`` has estimate and standard error [rad] by parameter. Only ``delta_L`` and ``delta_R`` are used,
    positive to starboard.
    """
    sides = (("delta_L", "left"), ("delta_R", "right"))
    return " and ".join(f"the {side} thruster pushes {angle_in_words(*estimates[name])}" for name, side in sides)


EFFECT = Effect(
    name="thrust-angle",
    title="thrusters that do not push straight ahead (toe-in or a bent mount)",
    place="actuator",
    hooks={"force": turn},
    parameters=(
        Parameter("delta_L", 0.0, "rad", "angle of the left thrust line to starboard", prior=(0.0, 0.15), step=0.01),
        Parameter("delta_R", 0.0, "rad", "angle of the right thrust line to starboard", prior=(0.0, 0.15), step=0.01),
        Parameter(
            "x_delta", -0.5, "m", "position of the thrusters forward of the origin", prior=(-0.5, 0.3), step=0.05
        ),
    ),
    scan={"x_delta": (-0.9, -0.5, -0.1)},
    formula="Y += delta_L f_L + delta_R f_R, N += x_delta (delta_L f_L + delta_R f_R)",
    source="thrust allocation of fixed thrusters at an angle: Fossen 2011, section 12.3",
    causes="thrusters that are turned on their mounts or not parallel to the hull",
    experiment="each thruster alone, ahead and astern; steps of equal thrust: the boat moves sideways",
    requires=("f", "hull"),
    alternatives=("propeller-walk", "mismatch", "yaw-bias", "cg-offset"),
    in_words=angles,
)
