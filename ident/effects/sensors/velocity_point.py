"""Lever arm of the body velocity, which is measured at another point than the origin, such as the GNSS antenna."""

from __future__ import annotations

from seatrial.ident.model import Effect, Estimates, Parameter, Signals, directed_size


def move(s: Signals) -> None:
    """Move the output of the body velocity [m/s] from the origin to the point of measurement, in place.

    The point is ``b_x`` forward and ``b_y`` to starboard of the origin [m]. The outputs become ``u - r b_y`` and
    ``v + r b_x``.
    """
    s.y["u"], s.y["v"] = s.y["u"] - s.p.b_y * s.x.r, s.y["v"] + s.p.b_x * s.x.r


def point(estimates: Estimates) -> str:
    """Return a clause for reports: the distances [m] of the point of measurement from the origin."""
    forward = directed_size(estimates["b_x"], "m", "forward of", "aft of")
    beside = directed_size(estimates["b_y"], "m", "to starboard of", "to port of")
    return f"the velocity is measured {forward} and {beside} the origin"


EFFECT = Effect(
    name="velocity-point",
    title="a lever arm of the measured body velocity",
    place="sensor",
    hooks={"output": move},
    parameters=(
        Parameter("b_x", 0.0, "m", "point of measurement, forward of the origin", prior=(0.0, 0.5), step=0.05),
        Parameter("b_y", 0.0, "m", "point of measurement, to starboard of the origin", prior=(0.0, 0.5), step=0.05),
    ),
    formula="u_measured = u - r b_y, v_measured = v + r b_x",
    source="Groves 2013, section 2.5: velocity of a point of a rotating body",
    experiment="turning on the spot, in both directions",
    requires=("hull", "body_velocity"),
    alternatives=("lever-arm", "cg-offset"),
    in_words=point,
)
