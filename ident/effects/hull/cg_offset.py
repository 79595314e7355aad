"""Offset of the centre of gravity from the origin: inertial coupling of surge, sway and yaw.

The motion depends on products of mass and offset, and the mass without added mass is unknown. The offsets are therefore
defined with m_u: they are the offsets of the boat times its mass over m_u.
"""

from __future__ import annotations

from seatrial.ident.model import Effect, Parameter, Signals


def couple(s: Signals) -> None:
    """Replace the rates of surge, sway and yaw by those of a body with an offset centre of gravity, in place.

    ``x_g`` (forward) and ``y_g`` (to starboard) [m] are the offset from the origin, times the mass without added mass
    over ``m_u``. The forces ``s.X``, ``s.Y``, ``s.N`` are used with the additions of all other effects.
    """
    x, p = s.x, s.p
    m_xg, m_yg = p.x_g * p.m_u, p.y_g * p.m_u
    X = s.X + p.m_v * x.v * x.r + m_xg * x.r * x.r
    Y = s.Y - p.m_u * x.u * x.r + m_yg * x.r * x.r
    N = s.N + (p.m_u - p.m_v) * x.u * x.v - (m_xg * x.u + m_yg * x.v) * x.r
    turning = p.m_r - m_yg * m_yg / p.m_u - m_xg * m_xg / p.m_v
    s.rate["r"] = (N + m_yg * X / p.m_u - m_xg * Y / p.m_v) / turning
    s.rate["u"] = (X + m_yg * s.rate["r"]) / p.m_u
    s.rate["v"] = (Y - m_xg * s.rate["r"]) / p.m_v


EFFECT = Effect(
    name="cg-offset",
    title="an offset of the centre of gravity (x_g, y_g)",
    hooks={"rate": couple},
    parameters=(
        Parameter("x_g", 0.0, "m", "centre of gravity forward, times mass / m_u", prior=(0.0, 0.3), step=0.01),
        Parameter("y_g", 0.0, "m", "centre of gravity to starboard, times mass / m_u", prior=(0.0, 0.1), step=0.005),
    ),
    formula="a (v' + u r) - b (u' - v r) in yaw, a r' - b r^2 in sway, -a r^2 - b r' in surge; "
    "a = m_u x_g, b = m_u y_g",
    source="Fossen 2011, section 3.3",
    causes="a battery or ballast that is not where the drawing has it",
    experiment="turns at several speeds; turning on the spot; steps of equal thrust from rest",
    requires=("hull",),
    alternatives=("sway-yaw", "turning-resistance", "lever-arm", "mismatch"),
)
