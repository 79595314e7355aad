"""Exponent of the thrust curve other than two."""

from __future__ import annotations

from typing import Any

import numpy as np

from seatrial.ident.model import Effect, Estimates, Parameter, Signals, size_in_words

AT_REST = 1e-6  # added to the squared shaft speed, so that its logarithm is finite at rest


EXPONENT = Parameter(
    "p_n", 0.0, "", "exponent of the shaft speed, less two", prior=(0.0, 0.5), bounds=(-1.5, 2.0), step=0.01
)
SOURCE = "Reynolds number and cavitation; manufacturers' curves have exponents of 1.8 to 2.3"


def factor(n: Any, p_n: Any) -> Any:
    """Return |n|^p_n: the factor from a quadratic thrust to a thrust with the exponent 2 + p_n.

    ``n`` is the normalised shaft speed. |n| is computed as ``sqrt(n^2 + 1e-6)``, so that the factor has a finite
    derivative at rest.
    """
    return np.exp(p_n / 2 * np.log(n * n + AT_REST))


def bend(s: Signals) -> None:
    """Change the exponent of the thrust ``s.force`` from 2 to ``2 + p_n``, in place: multiply it by |n|^p_n.

    n is the normalised shaft speed.
    """
    s.force = s.force * factor(s.n, s.p.p_n)


def power(estimates: Estimates) -> str:
    """Return a clause for reports: the power of the shaft speed with which the thrust grows."""
    less_two, error = estimates["p_n"]
    return f"the thrust grows with the power {size_in_words(2.0 + less_two, error, '').rstrip()} of the shaft speed"


EFFECT = Effect(
    name="thrust-exponent",
    title="a thrust-curve exponent other than two, on the bench",
    place="actuator",
    hooks={"thrust": bend},
    parameters=(EXPONENT,),
    formula="f = (c1 n|n| + c2 n^2) |n|^p_n",
    source=SOURCE,
    experiment="many levels of steady speed, with long levels below a third of full speed",
    requires=("bench", "thrust"),
    alternatives=("thrust-dead-band", "reverse-loss"),
    in_words=power,
)
