"""Model with the equations of the Otter simulator in the plane, for ``seatrial ident vehicle --model hull.py:otter``.

The model has rigid-body and added mass with the centre of gravity ahead of the origin, linear damping in surge, sway
and yaw, a quadratic yaw moment, cross-flow drag summed over strips of the hull (Hoerner; Fossen 2011, section 6.7), and
a steady surge force by the payload. Heave, roll and pitch of the simulator are neglected. All parameters are free.
"""

from __future__ import annotations

import numpy as np

from seatrial.ident.effects import catalogue
from seatrial.ident.model import INF, Effect, Model, Parameter, Signals
from seatrial.ident.models import horizontal_model

LENGTH, STRIPS = 2.0, 10  # m; the simulator has 20 strips, which changes only the value of c_flow
SMALL = 0.01  # m/s; it makes |v + x r| smooth, since the search would otherwise end before the optimum
START = {"m_u": 80.0, "m_v": 150.0, "m_r": 40.0, "d_u": 70.0, "d_r": 40.0, "d_rr": 400.0}  # initial values
# Parameters of the standard model and of the effects that the simulator does not have
ABSENT = ("d_uu", "d_vv", "y_g", "Y_0")


def cross_flow(s: Signals) -> None:
    """Subtract the drag of the cross-flow from the sway force and the yaw moment, summed over strips of the hull."""
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
    """Return the model for runs with heading, yaw rate and position."""
    effects = catalogue()
    model = horizontal_model("shaft", ("attitude", "gyro", "position"))
    model = (model + effects["cg-offset"] + effects["steady-force"] + CROSS_FLOW).with_values(START)
    return model.replace_parameters(*(model.parameter(n).at(0.0).fixed() for n in ABSENT))
