"""Asymmetric shaft dynamics: different time constants for acceleration and deceleration."""

from __future__ import annotations

import numpy as np

from seatrial.ident.model import Effect, Parameter, Signals

EDGE = 0.01  # width of the transition between acceleration and deceleration, relative to full speed


def change_pole(s: Signals) -> None:
    """Multiply the pole of the shaft by ``1 + k_up`` in acceleration and by ``1 - k_up`` in deceleration, in place.

    The shaft accelerates if the reference ``s.n_ref`` has a larger magnitude than the shaft speed. The rate of the
    shaft speed [1/s] is changed accordingly. The transition between both is smooth.
    """
    up = np.tanh((abs(s.n_ref) - abs(s.x.n)) / EDGE)
    s.rate["n"] = s.rate["n"] + s.p.k_up * up * s.p.a * (s.n_ref - s.x.n)


EFFECT = Effect(
    name="spin-up",
    title="different time constants for shaft acceleration and deceleration",
    place="actuator",
    hooks={"rate": change_pole},
    parameters=(
        Parameter(
            "k_up",
            0.0,
            "",
            "relative change of the pole: + in acceleration, - in deceleration",
            prior=(0.0, 0.3),
            bounds=(-0.9, 0.9),
            step=0.01,
        ),
    ),
    formula="n' = a (1 + k_up s) (n_ref - n), s = 1 in acceleration and -1 in deceleration",
    source="speed controllers that drive a motor but do not brake it: only the propeller torque decelerates the shaft",
    experiment="steps up and down between the same two speeds, several pairs of them",
    requires=("bench",),
    alternatives=("slew-limit", "second-lag"),
)
