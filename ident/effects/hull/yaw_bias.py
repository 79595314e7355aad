"""Yaw bias: a steady yaw moment, and a moment that grows with the square of speed, for example of a bent keel."""

from __future__ import annotations

from seatrial.ident.model import Effect, Parameter, Signals


def add(s: Signals) -> None:
    """Add ``N_0 + N_uu u|u|`` to the yaw moment ``s.N`` [N m], in place; u is the surge speed [m/s]."""
    s.N = s.N + s.p.N_0 + s.p.N_uu * s.x.u * abs(s.x.u)


EFFECT = Effect(
    name="yaw-bias",
    title="a constant or speed-dependent yaw moment",
    hooks={"force": add},
    parameters=(
        Parameter("N_0", 0.0, "N m", "constant yaw moment", prior=(0.0, 2.0), step=0.05),
        Parameter("N_uu", 0.0, "kg", "yaw moment per squared surge speed", prior=(0.0, 2.0), step=0.05),
    ),
    formula="N += N_0 + N_uu u|u|",
    source="an asymmetric or fouled hull, a bent keel, a trailing line",
    causes="a bent skeg, keel or rudder, growth on one side, a line that trails on one side",
    experiment="coasting without thrust, and runs on opposite headings",
    requires=("hull",),
    alternatives=("mismatch", "heading-moment", "sway-yaw"),
)
