"""Loss of thrust with advance ratio (inflow velocity at the propeller)."""

from __future__ import annotations

from seatrial.ident.model import INF, Effect, Parameter, Signals


def lose(s: Signals) -> None:
    """Reduce the thrust [N] of each thruster by ``k_J |n| u_i``, in place in ``s.f``.

    n is its normalised shaft speed, and u_i its forward speed through the water [m/s], including the speed from the yaw
    rate. A negative u_i increases the thrust.
    """
    for side, n in s.n.items():
        inflow = s.x.u - s.arm[side] * s.x.r  # forward speed of the thruster through the water
        s.f[side] = s.f[side] - s.p.k_J * abs(n) * inflow


EFFECT = Effect(
    name="advance-ratio",
    title="the loss of thrust with advance ratio",
    place="actuator",
    hooks={"thrust": lose},
    parameters=(
        Parameter(
            "k_J",
            0.0,
            "kg/s",
            "loss of thrust per inflow velocity at full speed",
            prior=(0.0, 10.0),
            bounds=(0.0, INF),
            step=0.5,
        ),
    ),
    formula="f_i -= k_J |n_i| (u - y_i r)",
    source="Blanke 1981, bilinear thrust; Fossen 2011, section 9.3",
    experiment="steps of both thrusters at several speeds, then full reverse while still moving forward",
    requires=("n", "f", "hull"),
    one_sided=True,
    alternatives=("cubic-drag", "turning-resistance", "thruster-interaction"),
)
