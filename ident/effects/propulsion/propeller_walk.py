"""Propeller walk: a sideways force of propellers that turn in the same direction, which is larger astern."""

from __future__ import annotations

from seatrial.ident.model import Effect, Parameter, Signals


def walk(s: Signals) -> None:
    """Add the sideways force of both propellers to ``s.Y`` [N], and its yaw moment to ``s.N`` [N m], in place.

    The force is ``k_ahead`` times the sum of the forward thrusts plus ``k_astern`` times the (negative) sum of the
    reverse thrusts, positive to starboard. The moment is the force times ``x_walk`` [m], the position of the propellers
    forward of the origin.
    """
    ahead = sum((f + abs(f)) / 2 for f in s.f.values())
    astern = sum((f - abs(f)) / 2 for f in s.f.values())
    sideways = s.p.k_ahead * ahead + s.p.k_astern * astern
    s.Y = s.Y + sideways
    s.N = s.N + s.p.x_walk * sideways


EFFECT = Effect(
    name="propeller-walk",
    title="propeller walk",
    place="actuator",
    hooks={"force": walk},
    parameters=(
        Parameter("k_astern", 0.0, "", "force to port over thrust astern", prior=(0.0, 0.2), step=0.01),
        Parameter("k_ahead", 0.0, "", "force to starboard over thrust ahead", prior=(0.0, 0.1), step=0.01),
        Parameter("x_walk", -0.5, "m", "position of the propellers ahead of the origin", prior=(-0.5, 0.3), step=0.05),
    ),
    scan={"x_walk": (-0.9, -0.5, -0.1)},
    formula="Y += k_ahead (f > 0) + k_astern (f < 0), N += x_walk Y, f the sum over the propellers",
    source="transverse thrust of propellers: Carlton 2018, Marine Propellers and Propulsion",
    causes="propellers that turn in the same direction, a propeller near the surface or the hull",
    experiment="equal commands from rest, ahead and then astern, at several levels",
    requires=("f", "hull"),
    alternatives=("swinging-mount", "thrust-angle", "reverse-mismatch", "mismatch", "yaw-bias", "cg-offset"),
)
