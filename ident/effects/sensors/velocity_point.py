"""Body velocities of another point than the origin: of the GNSS antenna, or of the autopilot in one of the hulls."""

from __future__ import annotations

from ident.model import Effect, Parameter, Signals


def move(s: Signals) -> None:
    s.y["u"], s.y["v"] = s.y["u"] - s.p.b_y * s.x.r, s.y["v"] + s.p.b_x * s.x.r


EFFECT = Effect(
    name="velocity-point",
    title="an offset of the point whose velocity is measured",
    place="sensor",
    hooks={"output": move},
    parameters=(
        Parameter("b_x", 0.0, "m", "the point ahead of the origin", prior=(0.0, 0.5), step=0.05),
        Parameter("b_y", 0.0, "m", "the point to starboard of the origin", prior=(0.0, 0.5), step=0.05),
    ),
    formula="u_measured = u - r b_y, v_measured = v + r b_x",
    source="Groves 2013, section 2.5: velocity of a point of a turning body",
    experiment="spinning on the spot, both ways round",
    requires=("hull", "body_velocity"),
    rivals=("lever-arm", "cg-offset"),
)
