"""The shaft speeds up faster than it slows down, or slower."""

from __future__ import annotations

import numpy as np

from ident.model import Effect, Parameter, Signals

EDGE = 0.01  # of full speed: over which speeding up turns into slowing down


def favour(s: Signals) -> None:
    up = np.tanh((abs(s.n_ref) - abs(s.x.n)) / EDGE)
    s.rate["n"] = s.rate["n"] + s.p.k_up * up * s.p.a * (s.n_ref - s.x.n)


EFFECT = Effect(
    name="spin-up",
    title="a shaft that speeds up and slows down at different paces",
    place="actuator",
    hooks={"rate": favour},
    parameters=(
        Parameter(
            "k_up", 0.0, "", "pole higher by this part speeding up, lower slowing down", prior=(0.0, 0.3),
            bounds=(-0.9, 0.9), step=0.01,
        ),
    ),
    formula="n' = a (1 + k_up s) (n_ref - n), s = 1 speeding up and -1 slowing down",
    source="speed controllers that drive a motor but do not brake it; water torque helps only to slow down",
    experiment="steps up and down between the same two speeds, several pairs of them",
    requires=("bench",),
    rivals=("slew-limit", "second-lag"),
)
