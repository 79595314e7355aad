"""Payload that shifts: the centre of gravity is at another place in each run, and moves at one time in a run."""

from __future__ import annotations

import numpy as np

from seatrial.ident.effects.hull.cg_offset import couple
from seatrial.ident.model import INF, PARAMETERS, Effect, Input, Parameter, Signals

WIDTH_S = 1.0  # time in which the payload moves [s]; the likelihood needs a derivative by the time of the move


def shift(s: Signals) -> None:
    """Set the centre of gravity to its place at the time t since the start of the record, in place.

    The parameter ``x_g`` becomes ``x_g + x_before``, and after ``t_shift`` also ``+ x_shift``; ``y_g`` likewise. An
    ``x_g`` that the model lacks counts as zero. The shift takes about 2 s around ``t_shift`` (a tanh).
    """
    p = s.p
    moved = (1 + np.tanh((s.u.t - p.t_shift) / WIDTH_S)) / 2
    p.x_g = getattr(p, "x_g", 0.0) + p.x_before + moved * p.x_shift
    p.y_g = getattr(p, "y_g", 0.0) + p.y_before + moved * p.y_shift


EFFECT = Effect(
    name="payload-shift",
    title="a payload that shifts between the runs and during a run",
    hooks={PARAMETERS: shift, "rate": couple},
    parameters=(
        *(
            Parameter(f"{axis}_{when}", 0.0, "m", f"{meaning} {to}", prior=(0.0, sd), step=sd / 15, per_record=True)
            for axis, to, sd in (("x", "forward", 0.15), ("y", "to starboard", 0.05))
            for when, meaning in (("shift", "shift of the centre of gravity"), ("before", "position before the shift"))
        ),
        Parameter(
            "t_shift",
            120.0,
            "s",
            "time of the shift after the start of a record",
            prior=(120.0, 120.0),
            bounds=(0.0, INF),
            step=1.0,
            scales=False,
        ),
    ),
    inputs=(Input("t", "s", "linear"),),
    scan={"t_shift": (30.0, 60.0, 90.0, 120.0, 160.0, 210.0, 280.0)},
    formula="x_g = x_before + x_shift (t > t_shift), and y_g likewise; the motion as for cg-offset",
    source="change of the mass matrix: Fossen 2011, section 3.3",
    causes="a payload, a battery or ballast that moved",
    experiment="the same run with the payload lashed down",
    requires=("hull",),
    nests=("cg-offset",),
    alternatives=("cg-offset", "mismatch", "yaw-bias", "current-drift"),
)
