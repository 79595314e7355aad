"""Thrust that is not quadratic in shaft speed or command: a part of it is linear."""

from __future__ import annotations

from seatrial.ident.model import Effect, Parameter, Signals


def bend(s: Signals) -> None:
    """Make the share ``lambda_n`` of the thrust of each thruster linear in shaft speed instead of quadratic, in place.

    Add ``lambda_n c1 (n - n |n|)`` to each thrust in ``s.f`` [N]. Only the odd part c1 of the thrust is changed.
    """
    for side, n in s.n.items():
        s.f[side] = s.f[side] + s.p.lambda_n * s.p.c1 * (n - n * abs(n))


EFFECT = Effect(
    name="thrust-linearity",
    title="a share of the thrust that is linear in shaft speed or command",
    place="actuator",
    hooks={"thrust": bend},
    parameters=(
        Parameter(
            "lambda_n", 0.0, "", "share of the thrust that is linear", prior=(0.0, 0.5), bounds=(-1.0, 1.5), step=0.02
        ),
    ),
    formula="f_i = c1 ((1 - lambda_n) n_i |n_i| + lambda_n n_i) + c2 n_i^2",
    source="ArduPilot's MOT_THST_EXPO, whose exponent is 1 - lambda_n; jets; controllers that are linearised in thrust",
    causes="an autopilot or speed controller that linearises thrust (MOT_THST_EXPO)",
    experiment="many levels of steady command, with long levels below a third of full forward",
    requires=("n", "f"),
    alternatives=("thrust-power", "dead-band", "reverse-thrust", "advance-ratio"),
)
