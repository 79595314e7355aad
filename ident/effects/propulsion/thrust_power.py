"""Thrust of a vehicle that follows another power of shaft speed or command than the square."""

from __future__ import annotations

import numpy as np

from ident.model import Effect, Parameter, Signals

AT_REST = 1e-6  # added to the squared shaft speed, so that its logarithm exists at rest


def bend(s: Signals) -> None:
    for side, n in s.n.items():
        bent = np.exp(s.p.p_n / 2 * np.log(n * n + AT_REST))
        s.f[side] = s.f[side] + (s.p.c1 * n * abs(n) + s.p.c2 * n * n) * (bent - 1)


EFFECT = Effect(
    name="thrust-power",
    title="a thrust-curve exponent other than two",
    place="actuator",
    hooks={"thrust": bend},
    parameters=(
        Parameter(
            "p_n", 0.0, "", "exponent of the shaft speed, less two", prior=(0.0, 0.5), bounds=(-1.5, 2.0), step=0.01
        ),
    ),
    formula="f_i = (c1 n_i |n_i| + c2 n_i^2) |n_i|^p_n",
    source="Reynolds number and cavitation; manufacturers' curves have exponents of 1.8 to 2.3",
    experiment="many levels of steady command, those below a third of full ahead held long",
    requires=("n", "f"),
    alternatives=("thrust-linearity",),
)
