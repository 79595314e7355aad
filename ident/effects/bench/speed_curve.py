"""Nonlinear static gain from command to shaft speed."""

from __future__ import annotations

from seatrial.ident.model import Effect, Parameter, Signals


def change_gain(s: Signals) -> None:
    """Multiply the reference shaft speed ``s.n_ref`` by a gain that depends on its magnitude and sign, in place.

    The gain is ``1 + g_0 + g_1 |n_ref| + g_2 sgn(n_ref) + g_3 n_ref^2``.
    """
    change = s.p.g_1 * abs(s.n_ref) + s.p.g_3 * s.n_ref * s.n_ref
    s.n_ref = s.n_ref * (1 + s.p.g_0 + change + s.p.g_2 * ((s.n_ref > 0) - 1.0 * (s.n_ref < 0)))


EFFECT = Effect(
    name="speed-curve",
    title="a nonlinear static gain from command to shaft speed",
    place="actuator",
    hooks={"shaft": change_gain},
    parameters=(
        Parameter("g_0", 0.0, "", "relative gain error at low command", prior=(0.0, 0.3), step=0.01),
        Parameter("g_1", 0.0, "", "change of the gain at full command, linear", prior=(0.0, 0.3), step=0.01),
        Parameter(
            "g_2", 0.0, "", "relative gain error in forward; its negative in reverse", prior=(0.0, 0.2), step=0.01
        ),
        Parameter("g_3", 0.0, "", "change of the gain at full command, quadratic", prior=(0.0, 0.3), step=0.01),
    ),
    formula="n_ref *= 1 + g_0 + g_1 |n_ref| + g_2 sgn(n_ref) + g_3 n_ref^2",
    source="speed controllers without feedback: propeller torque grows with the square of speed",
    experiment="many levels of steady command of both signs",
    requires=("bench",),
    alternatives=("supply-sag", "controller-dead-band"),
)
