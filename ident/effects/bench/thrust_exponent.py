"""Exponent of the thrust curve other than two."""

from __future__ import annotations

import numpy as np

from ident.model import Effect, Parameter, Signals

AT_REST = 1e-6  # added to the squared shaft speed, so that its logarithm exists at rest


def bend(s: Signals) -> None:
    s.force = s.force * np.exp(s.p.p_n / 2 * np.log(s.n * s.n + AT_REST))


EFFECT = Effect(
    name="thrust-exponent",
    title="a thrust-curve exponent other than two",
    place="actuator",
    hooks={"thrust": bend},
    parameters=(
        Parameter(
            "p_n", 0.0, "", "exponent of the shaft speed, less two", prior=(0.0, 0.5), bounds=(-1.5, 2.0), step=0.01
        ),
    ),
    formula="f = (c1 n|n| + c2 n^2) |n|^p_n",
    source="Reynolds number and cavitation; manufacturers' curves have exponents of 1.8 to 2.3",
    experiment="many levels of steady speed, those below a third of full speed held long",
    requires=("bench", "thrust"),
    alternatives=("thrust-dead-band", "reverse-loss"),
)
