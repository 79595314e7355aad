"""Friction that does not grow with speed."""

from __future__ import annotations

import numpy as np

from ident.model import Effect, Parameter, Signals


def resist(s: Signals) -> None:
    s.X = s.X - s.p.f_C * np.tanh(s.x.u / 0.05)


EFFECT = Effect(
    name="coulomb",
    title="friction that does not grow with speed",
    hooks={"force": resist},
    parameters=(Parameter("f_C", 0.0, "N", "friction force", prior=(0.0, 10.0), step=0.5),),
    formula="X -= f_C tanh(u / 0.05)",
    source="dragging weed or line; a smooth Coulomb law",
    experiment="slow runs ahead and astern, and coasting to rest",
    requires=("hull",),
    one_sided=True,
    one_of="X(u)",
    rivals=("cubic-drag", "dead-band", "hump"),
)
