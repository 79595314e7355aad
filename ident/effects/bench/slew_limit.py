"""Slew-rate limit of the shaft speed."""

from __future__ import annotations

import numpy as np

from seatrial.ident.model import Effect, Parameter, Signals


def limit(s: Signals) -> None:
    """Limit the rate of the shaft speed [1/s] to the slew-rate limit ``n_slew``, in place, with a smooth transition.

    The limit acts on both signs of the first-order response ``a (n_ref - n)``; what other effects add to the rate is
    not limited. Only the share ``k_slew`` of the excess over the limit is removed.
    """
    unlimited = s.p.a * (s.n_ref - s.x.n)
    square = (unlimited / s.p.n_slew) * (unlimited / s.p.n_slew)
    fourth = square * square
    # smooth, because the search for the maximum stops at a corner
    limited = unlimited / np.sqrt(np.sqrt(np.sqrt(1 + fourth * fourth)))
    s.rate["n"] = s.rate["n"] + s.p.k_slew * (limited - unlimited)


EFFECT = Effect(
    name="slew-limit",
    title="a slew-rate limit of the shaft speed",
    place="actuator",
    hooks={"rate": limit},
    parameters=(
        Parameter(
            "k_slew",
            0.0,
            "",
            "share of the excess over the limit that is cut",
            prior=(1.0, 0.25),
            bounds=(0.0, 1.2),
            step=0.02,
        ),
        Parameter("n_slew", 2.0, "1/s", "slew-rate limit", "log", prior=(2.0, 2.0), bounds=(0.1, 20.0), scales=False),
    ),
    scan={"n_slew": (0.15, 0.3, 0.5, 0.8, 1.2, 1.8, 2.5, 3.5)},
    formula="n' = w / (1 + (w / S)^8)^(1/8), w = a (n_ref - n)",
    source="current limits and ramps of speed controllers",
    causes="a ramp or a current limit of the speed controller",
    experiment="steps of many sizes from rest: with a limit, larger steps take longer to rise",
    requires=("bench",),
    one_sided=True,
    alternatives=("second-lag", "spin-up"),
)
