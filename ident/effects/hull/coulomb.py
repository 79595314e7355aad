"""Coulomb friction in surge: resistance that does not depend on speed."""

from __future__ import annotations

import numpy as np

from seatrial.ident.model import INF, Effect, ForceCurve, Parameter, Signals


def resist(s: Signals) -> None:
    """Subtract the friction force ``f_C tanh(u / 0.05)`` [N] from the surge force ``s.X``, in place.

    The friction opposes the surge speed u and is constant, except for a smooth change of sign within about 0.05 m/s.
    """
    s.X = s.X - s.p.f_C * np.tanh(s.x.u / 0.05)


EFFECT = Effect(
    name="coulomb",
    title="Coulomb friction in surge",
    hooks={"force": resist},
    parameters=(Parameter("f_C", 0.0, "N", "Coulomb friction force", prior=(0.0, 10.0), bounds=(0.0, INF), step=0.5),),
    formula="X -= f_C tanh(u / 0.05)",
    source="towed weed or line; smoothed Coulomb friction",
    causes="weed or a line that drags, a shaft that rubs",
    experiment="slow runs forward and in reverse, and coasting to rest",
    requires=("hull",),
    one_sided=True,
    parametric_form_of=ForceCurve("X", "u"),
    alternatives=("cubic-drag", "dead-band", "hump"),
)
