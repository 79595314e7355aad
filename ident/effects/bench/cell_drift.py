"""Load-cell creep after switching on or loading."""

from __future__ import annotations

import numpy as np

from seatrial.ident.model import Effect, Input, Parameter, Signals


def creep(s: Signals) -> None:
    """Add the drift of the load cell to the output ``force`` [N] of the model, in place.

    The drift is ``F_creep (1 - exp(-t / T_creep))`` at the time t since the start of the record.
    """
    s.y["force"] = s.y["force"] + s.p.F_creep * (1 - np.exp(-s.u.t / s.p.T_creep))


EFFECT = Effect(
    name="cell-drift",
    title="load-cell drift (creep)",
    place="bench",
    hooks={"output": creep},
    parameters=(
        Parameter("F_creep", 0.0, "N", "final value of the drift", prior=(0.0, 3.0), step=0.05, per_record=True),
        Parameter(
            "T_creep",
            60.0,
            "s",
            "time constant of the drift",
            "log",
            prior=(60.0, 60.0),
            bounds=(5.0, 2000.0),
            scales=False,
        ),
    ),
    inputs=(Input("t", "s", "linear"),),
    scan={"T_creep": (20.0, 60.0, 300.0)},
    formula="F_measured = F + F_creep (1 - exp(-t / T_creep))",
    source="creep and warm-up of strain gauges, OIML R 60",
    causes="a load cell that warms up, an amplifier without temperature compensation",
    experiment="the unloaded cell logged for an hour from switching on; a tare before and after every run",
    requires=("bench", "thrust"),
    alternatives=("recirculation",),
)
