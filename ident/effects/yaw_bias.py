"""A steady yawing moment."""

from __future__ import annotations

from ident.model import Effect, Signals
from ident.params import Parameter


def add(s: Signals) -> None:
    s.N = s.N + s.p.N_0


EFFECT = Effect(
    name="yaw-bias",
    title="a steady yawing moment",
    hooks={"force": add},
    parameters=(Parameter("N_0", 0.0, "N m", "steady yawing moment", prior=(0.0, 2.0), step=0.05),),
    formula="N += N_0",
    source="an asymmetric hull, a bent keel or a trailing line",
    experiment="coasting without thrust, and runs on opposite headings",
    requires=("hull",),
    rivals=("mismatch", "heading-moment", "sway-yaw"),
)
