"""Steering by the flow: rudders, vanes or a deflected jet, with a moment that grows with speed."""

from __future__ import annotations

from seatrial.ident.model import Effect, Parameter, Signals


def steer(s: Signals) -> None:
    """Add the moment of rudders or a deflected jet to the yaw moment ``s.N`` [N m], in place.

    The moment is ``N_delta |u| u (n_left - n_right) / 2``, with the surge speed u [m/s] and normalised shaft speeds n.
    """
    n = list(s.n.values())
    s.N = s.N + s.p.N_delta * abs(s.x.u) * s.x.u * (n[0] - n[1]) / 2


EFFECT = Effect(
    name="steering",
    title="a steering moment of rudders or deflected thrust, which grows with speed",
    place="actuator",
    hooks={"force": steer},
    parameters=(
        Parameter(
            "N_delta",
            0.0,
            "kg",
            "yaw moment at full difference of the sides, per squared speed",
            prior=(0.0, 50.0),
            step=0.5,
        ),
    ),
    formula="N += N_delta |u| u (n_left - n_right) / 2",
    source="lift of a rudder: Fossen 2011, eq. 9.82; jets with a common nozzle",
    experiment="the same difference of the sides at several speeds",
    requires=("n", "hull"),
    alternatives=("mismatch", "turn-loss", "thruster-interaction"),
)
