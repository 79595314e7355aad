"""Saturation of the shaft speed."""

from __future__ import annotations

import numpy as np

from seatrial.ident.model import Effect, Parameter, Signals


def saturate(s: Signals) -> None:
    """Limit the magnitude of the reference shaft speed ``s.n_ref`` to ``n_top``, in place, with a smooth transition.

    Only the share ``k_top`` of the excess over the limit is removed.
    """
    square = (s.n_ref / s.p.n_top) * (s.n_ref / s.p.n_top)
    eighth = square * square * square * square
    power = eighth * eighth * eighth * eighth
    # smooth, because the search for the maximum stops at a corner
    limited = s.n_ref / np.sqrt(np.sqrt(np.sqrt(np.sqrt(np.sqrt(1 + power)))))
    s.n_ref = s.n_ref + s.p.k_top * (limited - s.n_ref)


EFFECT = Effect(
    name="speed-limit",
    title="a saturation of the shaft speed",
    place="actuator",
    hooks={"shaft": saturate},
    parameters=(
        Parameter(
            "k_top",
            0.0,
            "",
            "share of the excess over the limit that is cut",
            prior=(1.0, 0.25),
            bounds=(0.0, 1.2),
            step=0.02,
        ),
        Parameter("n_top", 0.8, "", "saturation limit", "log", prior=(0.8, 0.4), bounds=(0.1, 1.5)),
    ),
    scan={"n_top": (0.3, 0.45, 0.6, 0.75, 0.85)},
    formula="n_ref -> n_ref / (1 + (n_ref / n_top)^32)^(1/32)",
    source="governors, power limits and end points of speed controllers",
    causes="end points, a governor or a current limit of the speed controller",
    experiment="steady commands in small steps up to the highest",
    requires=("bench",),
    one_sided=True,
    alternatives=("speed-curve",),
)
