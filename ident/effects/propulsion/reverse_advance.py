"""Loss of thrust with inflow that is another one in reverse."""

from __future__ import annotations

from seatrial.ident.model import Effect, Parameter, Signals


def lose(s: Signals) -> None:
    """Reduce the thrust [N] of each thruster whose shaft turns in reverse by ``k_Ja |n| u_i``, in place in ``s.f``.

    n is its normalised shaft speed, and u_i its forward speed through the water [m/s], including the speed from the yaw
    rate. The loss adds to that of `advance-ratio`, which is the same in both directions of the shaft.
    """
    for side, n in s.n.items():
        inflow = s.x.u - s.arm[side] * s.x.r  # forward speed of the thruster through the water
        s.f[side] = s.f[side] - s.p.k_Ja * abs(n) * inflow * (n < 0)


EFFECT = Effect(
    name="reverse-advance",
    title="a loss of thrust with advance ratio that is another one in reverse",
    place="actuator",
    hooks={"thrust": lose},
    parameters=(
        Parameter(
            "k_Ja", 0.0, "kg/s", "loss of thrust per inflow velocity in reverse, less k_J", prior=(0.0, 10.0), step=0.5
        ),
    ),
    formula="f_i -= k_Ja |n_i| (u - y_i r) for n_i < 0",
    source="four-quadrant open-water data; Fossen 2011, section 9.3",
    causes="the blade profile of a propeller in reverse, and its flow when it brakes the boat",
    experiment="full reverse while still moving forward, and straight runs astern, at several speeds",
    requires=("n", "f", "hull"),
    alternatives=("advance-ratio", "reverse-thrust", "reverse-mismatch"),
)
