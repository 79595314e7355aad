"""Thrust of a vehicle that follows another power of shaft speed or command than the square."""

from __future__ import annotations

from seatrial.ident.effects.bench.thrust_exponent import EXPONENT, SOURCE, factor, power
from seatrial.ident.model import Effect, Signals


def bend(s: Signals) -> None:
    """Change the exponent of the thrust of each thruster from 2 to ``2 + p_n``, in place in ``s.f``.

    Add ``(c1 n |n| + c2 n^2) (|n|^p_n - 1)`` [N] to each thrust, with the normalised shaft speed n.
    """
    for side, n in s.n.items():
        s.f[side] = s.f[side] + (s.p.c1 * n * abs(n) + s.p.c2 * n * n) * (factor(n, s.p.p_n) - 1)


EFFECT = Effect(
    name="thrust-power",
    title="a thrust-curve exponent other than two",
    place="actuator",
    hooks={"thrust": bend},
    parameters=(EXPONENT,),
    formula="f_i = (c1 n_i |n_i| + c2 n_i^2) |n_i|^p_n",
    source=SOURCE,
    experiment="many levels of steady command, with long levels below a third of full forward",
    requires=("n", "f"),
    alternatives=("thrust-linearity", "load-sag"),
    in_words=power,
)
