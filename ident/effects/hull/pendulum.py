"""Lightly damped pendulum or sloshing mass, driven by the surge acceleration: bilge water, a suspended load."""

from __future__ import annotations

import math

from ident.model import Effect, Parameter, Signals, State


def pull(s: Signals) -> None:
    omega = 2 * math.pi * s.p.f_p
    s.X = s.X + s.p.m_p * (2 * s.p.zeta_p * omega * s.x.swing_rate + omega * omega * s.x.swing)


def swing(s: Signals) -> None:
    omega = 2 * math.pi * s.p.f_p
    acceleration = s.rate["u"] - s.x.v * s.x.r
    s.rate["swing"] = s.x.swing_rate
    s.rate["swing_rate"] = -2 * s.p.zeta_p * omega * s.x.swing_rate - omega * omega * s.x.swing - acceleration


EFFECT = Effect(
    name="pendulum",
    title="a sloshing or suspended mass",
    hooks={"force": pull, "rate": swing},
    parameters=(
        Parameter("m_p", 0.0, "kg", "oscillating mass", prior=(0.0, 10.0), step=0.2),
        Parameter("f_p", 0.6, "Hz", "natural frequency", "log", prior=(0.6, 0.4), bounds=(0.15, 2.5)),
        Parameter("zeta_p", 0.06, "", "damping ratio", "log", prior=(0.06, 0.06), bounds=(0.005, 0.7)),
    ),
    states=(
        State("swing", "m", "displacement of the oscillating mass", 0.0, sd0=0.02),
        State("swing_rate", "m/s", "velocity of the oscillating mass", 0.0, sd0=0.05),
    ),
    scan={"f_p": (0.25, 0.31, 0.38, 0.46, 0.55, 0.65, 0.78, 0.95, 1.15, 1.4)},
    formula="z'' + 2 zeta w z' + w^2 z = -a_x, X += m_p (2 zeta w z' + w^2 z)",
    source="thesis section 6 names sloshing; Ibrahim 2005, equivalent mechanical models",
    experiment="chirp of equal thrust through 0.2 to 1.5 Hz",
    requires=("hull",),
    one_sided=True,
    rivals=("waves", "lag"),
)
