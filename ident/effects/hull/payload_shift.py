"""Payload that shifts or is taken on during a run: mass and centre of gravity change at one time."""

from __future__ import annotations

import numpy as np

from seatrial.ident.effects.hull.cg_offset import couple
from seatrial.ident.model import INF, PARAMETERS, Effect, Input, Parameter, Signals

WIDTH_S = 1.0  # time in which the change happens [s]; the likelihood needs a derivative by the time of the change


def shift(s: Signals) -> None:
    """Change the masses and the centre of gravity to their values at the time of the row."""
    p = s.p
    done = (1 + np.tanh((s.u.t - p.t_shift) / WIDTH_S)) / 2
    p.m_u, p.m_v = p.m_u + done * p.m_shift, p.m_v + done * p.m_shift
    p.x_g, p.y_g = getattr(p, "x_g", 0.0) + done * p.x_shift, getattr(p, "y_g", 0.0) + done * p.y_shift


EFFECT = Effect(
    name="payload-shift",
    title="a payload that shifts or is taken on during a run",
    hooks={PARAMETERS: shift, "rate": couple},
    parameters=(
        Parameter(
            "x_shift", 0.0, "m", "shift of the centre of gravity forward", prior=(0.0, 0.15), step=0.01, per_record=True
        ),
        Parameter(
            "y_shift",
            0.0,
            "m",
            "shift of the centre of gravity to starboard",
            prior=(0.0, 0.05),
            step=5e-3,
            per_record=True,
        ),
        Parameter("m_shift", 0.0, "kg", "added mass of the payload", prior=(0.0, 8.0), step=0.5, per_record=True),
        Parameter(
            "t_shift",
            120.0,
            "s",
            "time of the change after the start of a record",
            prior=(120.0, 120.0),
            bounds=(0.0, INF),
            step=1.0,
            scales=False,
        ),
    ),
    inputs=(Input("t", "s", "linear"),),
    scan={"t_shift": (30.0, 60.0, 90.0, 120.0, 160.0, 210.0, 280.0)},
    formula="m_u += m, m_v += m and (x_g, y_g) += (x, y) from t_shift on; the motion as for cg-offset",
    source="change of the mass matrix: Fossen 2011, section 3.3",
    experiment="the same run with the payload lashed down",
    requires=("hull",),
    alternatives=("cg-offset", "mismatch", "yaw-bias", "current-drift"),
)
