"""Structural resonance of the rod that holds the thruster."""

from __future__ import annotations

import math

from seatrial.ident.model import Effect, Parameter, Signals, State


def filter_force(s: Signals) -> None:
    """Replace the share ``g_rod`` of the thrust ``s.force`` by the force after the resonance of the rod, in place.

    ``s.pushed`` is set to the thrust before, which drives the resonance.
    """
    s.pushed = s.force
    s.force = s.force + s.p.g_rod * (s.x.rod - s.force)


def swing(s: Signals) -> None:
    """Set the rates of the two states of the resonance of the rod that holds the thruster, in place.

    The thrust ``s.pushed`` drives the resonance, with the natural frequency ``f_rod`` [Hz] and damping ratio
    ``zeta_rod``.
    """
    omega = 2 * math.pi * s.p.f_rod
    s.rate["rod"] = omega * s.x.rod_rate
    s.rate["rod_rate"] = omega * (s.pushed - s.x.rod) - 2 * s.p.zeta_rod * omega * s.x.rod_rate


EFFECT = Effect(
    name="rod-flex",
    title="a structural resonance of the rod",
    place="bench",
    hooks={"thrust": filter_force, "rate": swing},
    parameters=(
        Parameter(
            "g_rod",
            0.0,
            "",
            "share of the force that passes the resonance",
            prior=(0.5, 0.5),
            bounds=(0.0, 2.0),
            step=0.02,
        ),
        Parameter(
            "f_rod",
            6.0,
            "Hz",
            "natural frequency of the rod",
            "log",
            prior=(6.0, 6.0),
            bounds=(1.0, 25.0),
            scales=False,
        ),
        Parameter("zeta_rod", 0.05, "", "damping ratio of the rod", "log", prior=(0.05, 0.05), bounds=(0.003, 0.7)),
    ),
    states=(
        State("rod", "N", "force after the resonance", 0.0, sd0=0.1),
        State("rod_rate", "N", "rate of the force after the resonance, over the angular frequency", 0.0, sd0=0.1),
    ),
    scan={"f_rod": (1.8, 2.4, 3.2, 4.2, 5.2, 6.4, 7.8, 9.5, 12.0, 15.0)},
    formula="z'' + 2 zeta w z' + w^2 z = w^2 f, F -> F + g (z - F)",
    source="a mass on a cantilever; a hammer test of the rod shows the frequency",
    causes="a rod or frame of the bench that bends",
    experiment="steps between zero and half speed with the cell at 80 Hz or more; a tap on the rod at rest",
    requires=("bench", "thrust"),
    one_sided=True,
    alternatives=("cell-lag",),
)
