"""A yawing moment that does not reverse with the helm: steady, or growing with speed as of a bent keel."""

from __future__ import annotations

from ident.model import Effect, Parameter, Signals


def add(s: Signals) -> None:
    s.N = s.N + s.p.N_0 + s.p.N_uu * s.x.u * abs(s.x.u)


EFFECT = Effect(
    name="yaw-bias",
    title="a steady yawing moment",
    hooks={"force": add},
    parameters=(
        Parameter("N_0", 0.0, "N m", "steady yawing moment", prior=(0.0, 2.0), step=0.05),
        Parameter("N_uu", 0.0, "kg", "yawing moment by the square of the speed", prior=(0.0, 2.0), step=0.05),
    ),
    formula="N += N_0 + N_uu u|u|",
    source="an asymmetric or fouled hull, a bent keel, a trailing line",
    experiment="coasting without thrust, and runs on opposite headings",
    requires=("hull",),
    rivals=("mismatch", "heading-moment", "sway-yaw"),
)
