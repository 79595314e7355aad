"""Longitudinal offset of the centre of gravity from the origin: inertial coupling of sway and yaw."""

from __future__ import annotations

from ident.model import Effect, Parameter, Signals


def couple(s: Signals) -> None:
    x, p = s.x, s.p
    m_xg = p.x_g * p.m_u
    X = s.X + p.m_v * x.v * x.r + m_xg * x.r * x.r
    Y = s.Y - p.m_u * x.u * x.r
    N = s.N + (p.m_u - p.m_v) * x.u * x.v - m_xg * x.u * x.r
    determinant = p.m_v * p.m_r - m_xg * m_xg
    s.rate["u"] = X / p.m_u
    s.rate["v"] = (p.m_r * Y - m_xg * N) / determinant
    s.rate["r"] = (p.m_v * N - m_xg * Y) / determinant


EFFECT = Effect(
    name="cg-offset",
    title="a longitudinal offset of the centre of gravity (x_g)",
    hooks={"rate": couple},
    parameters=(Parameter("x_g", 0.0, "m", "centre of gravity forward of the origin", prior=(0.0, 0.3), step=0.01),),
    formula="m x_g (r' + u r) in sway, m x_g (v' + u r) in yaw, m x_g r^2 in surge",
    source="Fossen 2011, section 3.3",
    experiment="turns at several speeds; turning on the spot",
    requires=("hull",),
    rivals=("sway-yaw", "turning-resistance", "lever-arm"),
)
