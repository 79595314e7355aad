"""A yawing moment that depends on heading."""

from __future__ import annotations

import numpy as np

from ident.model import Effect, Parameter, Signals


def add(s: Signals) -> None:
    psi = s.x.psi
    s.N = s.N + s.p.N_s * np.sin(psi) + s.p.N_c * np.cos(psi) + s.p.N_2s * np.sin(2 * psi) + s.p.N_2c * np.cos(2 * psi)


EFFECT = Effect(
    name="heading-moment",
    title="a yawing moment that depends on heading",
    place="environment",
    hooks={"force": add},
    parameters=(
        Parameter("N_s", 0.0, "N m", "moment with sin psi", prior=(0.0, 2.0), step=0.05),
        Parameter("N_c", 0.0, "N m", "moment with cos psi", prior=(0.0, 2.0), step=0.05),
        Parameter("N_2s", 0.0, "N m", "moment with sin 2 psi", prior=(0.0, 2.0), step=0.05),
        Parameter("N_2c", 0.0, "N m", "moment with cos 2 psi", prior=(0.0, 2.0), step=0.05),
    ),
    formula="N += N_s sin psi + N_c cos psi + N_2s sin 2psi + N_2c cos 2psi",
    source="wind and waves on an asymmetric hull; Fossen 2011, section 8.2",
    experiment="turning slowly through all headings, both ways round",
    requires=("hull",),
    any_of="N(psi)",
    rivals=("wind", "yaw-bias", "compass"),
)
