"""Added resistance in turns (X_rr)."""

from __future__ import annotations

from seatrial.ident.model import Effect, Parameter, Signals, in_sentence


def resist(s: Signals) -> None:
    """Subtract the resistance ``X_rr r^2`` from the surge force ``s.X`` [N], in place; r is the yaw rate [rad/s]."""
    s.X = s.X - s.p.X_rr * s.x.r * s.x.r


EFFECT = Effect(
    name="turning-resistance",
    title="added resistance in turns (X_rr)",
    hooks={"force": resist},
    parameters=(Parameter("X_rr", 0.0, "kg m", "surge resistance per squared yaw rate", prior=(0.0, 30.0), step=1.0),),
    formula="X -= X_rr r^2",
    source="MMG model, Yasukawa and Yoshimura 2015",
    experiment="turning on the spot and turning circles at several speeds",
    requires=("hull",),
    cannot_be_negative={"X_rr": "cg-offset"},  # x_g acts as r^2 in surge too
    alternatives=("cg-offset", "advance-ratio", "cross-flow"),
    in_words=in_sentence("X_rr", "kg m", "X_rr = {}"),
)
