"""The Otter's own equations in the horizontal plane, for ``seatrial ident vehicle --model hull.py:otter``.

Rigid body and added mass with the centre of gravity ahead of the origin, linear damping in surge, sway and yaw, a
quadratic yaw moment, cross-flow drag summed over strips of the hull (Hoerner; Fossen 2011, section 6.7), and a steady
surge force, that of the payload. Heave, roll and pitch of the simulator are left out. Every value is free.
"""

from __future__ import annotations

import numpy as np

from seatrial.ident.effects import catalogue
from seatrial.ident.model import INF, Effect, Model, Parameter, Signals
from seatrial.ident.models import horizontal_model

LENGTH, STRIPS = 2.0, 10  # m; the simulator has 20 strips, which changes c_flow and nothing else
SMALL = 0.01  # m/s; keeps |v + x r| smooth, without which the search stops short
START = {"m_u": 80.0, "m_v": 150.0, "m_r": 40.0, "d_u": 70.0, "d_r": 40.0, "d_rr": 400.0}
ABSENT = ("d_uu", "d_vv", "y_g", "Y_0")


def cross_flow(s: Signals) -> None:
    dx = LENGTH / STRIPS
    for x in np.linspace(-LENGTH / 2 + dx / 2, LENGTH / 2 - dx / 2, STRIPS):
        across = s.x.v + float(x) * s.x.r
        drag = s.p.c_flow * dx * np.sqrt(across * across + SMALL * SMALL) * across
        s.Y = s.Y - drag
        s.N = s.N - float(x) * drag


CROSS_FLOW = Effect(
    "strips",
    "cross-flow drag over strips of the hull",
    {"force": cross_flow},
    parameters=(Parameter("c_flow", 60.0, "kg/m2", "cross-flow drag per length, 0.5 rho T C_d", bounds=(0.0, INF)),),
    requires=("hull",),
)


def otter() -> Model:
    """The structure of the simulator for runs with heading, yaw rate and position."""
    effects = catalogue()
    model = horizontal_model("shaft", ("attitude", "gyro", "position"))
    model = (model + effects["cg-offset"] + effects["steady-force"] + CROSS_FLOW).with_values(START)
    return model.replace_parameters(*(model.parameter(n).at(0.0).fixed() for n in ABSENT))
