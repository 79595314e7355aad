"""Resistance hump: wave-making resistance around one Froude number."""

from __future__ import annotations

import numpy as np

from seatrial.ident.model import INF, Effect, ForceCurve, Parameter, Signals


def resist(s: Signals) -> None:
    """Subtract a resistance with a maximum at one speed from the surge force ``s.X`` [N], in place.

    The resistance over |u| is a Gaussian bell of the height ``A_hump`` [N], centred at ``u_hump`` with the width
    ``w_hump`` [m/s]. It opposes the surge speed u; the change of sign is smooth (tanh(u / 0.1)).
    """
    u, p = s.x.u, s.p
    off = (abs(u) - p.u_hump) / p.w_hump
    s.X = s.X - p.A_hump * np.exp(-off * off / 2) * np.tanh(u / 0.1)


EFFECT = Effect(
    name="hump",
    title="a hump in the resistance curve",
    hooks={"force": resist},
    parameters=(
        Parameter("A_hump", 0.0, "N", "height of the hump", prior=(0.0, 20.0), bounds=(0.0, INF), step=1.0),
        Parameter("u_hump", 0.9, "m/s", "speed of the hump", "log", prior=(0.9, 0.4), bounds=(0.2, 5.0)),
        Parameter("w_hump", 0.2, "m/s", "width of the hump", "log", prior=(0.2, 0.1), bounds=(0.05, 1.0)),
    ),
    scan={"u_hump": (0.35, 0.5, 0.65, 0.8, 1.0, 1.25, 1.6)},
    formula="X -= A exp(-((|u| - u_h) / w)^2 / 2) sgn u",
    source="residuary resistance at a Froude number of 0.3 to 0.5 (Froude; Faltinsen 2005, section 2.2)",
    experiment="long straight runs at speeds in fine steps around the hump, up and down again",
    requires=("hull",),
    one_sided=True,
    parametric_form_of=ForceCurve("X", "u"),
    alternatives=("cubic-drag", "coulomb", "advance-ratio"),
)
