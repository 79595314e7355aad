"""Models of the BlueBoat, for leave_one_out.py and `seatrial ident vehicle --model boat.py:NAME --keep-thruster-sides`.

    authors    rigid body with quadratic drag, and the force of the data's authors: a straight line from PWM to force
    propeller  force from PWM by a propeller's curve, c |n|^p, ahead and astern apart, less what forward speed takes
               away; a lag of the motors; the thrusters need not be equal; yaw damping that grows with forward speed
    point      and the velocities are those of the autopilot, beside the centre of the boat
    boat       and the heading that the autopilot believes is drawn aside while the motors run (effect compass-motor)

The file's left is the boat's right: the boat turns against the thrust difference otherwise, so the arms are swapped
here. Priors are what is known without the data: 15 kg and 1.7 kg m2, thrusters 0.285 m off the middle, 55 N at full
PWM by the maker's table for ahead, less for astern. Between the fits and the priors stands the noise: the residuals are
coloured over seconds, so a sample counts for a twenty-fifth of what a white one would.

Sources: Fossen 2011, 9.1 (advance: bilinear thrust), 6.4 (damping); Blanke 1981.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from seatrial.ident.effects import catalogue
from seatrial.ident.model import INF, Effect, Model, Output, Parameter, Sensor, Signals, State
from seatrial.ident.models import SIDES, horizontal_model

SMALL = 1e-3  # part of full speed; keeps powers smooth at rest
KNOWN = {"y_left": 0.285, "y_right": -0.285, "e_uv": 0.35, "e_r": 0.25, "e_psi": 50.0, "d_vv": 0.0, "Y_uv": 0.0}
EXPECTED = {  # mean and standard deviation
    "m_u": (17.0, 3.0),
    "m_v": (25.0, 8.0),
    "m_r": (3.0, 2.0),
    "d_u": (1.0, 2.0),
    "d_v": (100.0, 60.0),
    "d_r": (2.0, 3.0),
    "d_uu": (8.0, 8.0),
    "d_rr": (3.0, 3.0),
    "N_ur": (30.0, 15.0),
}


def thrust_of_propellers(s: Signals) -> None:
    p = s.p
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        n = s.n[side]
        speed, ahead, astern = np.sqrt(n * n + SMALL * SMALL), 1.0 * (n > 0), 1.0 * (n < 0)
        inflow = s.x.u - s.arm[side] * s.x.r
        bollard = ahead * p.c_ahead * speed**p.p_ahead - astern * p.c_astern * speed**p.p_astern
        unequal = 1 + sign * (p.eps_ahead * ahead + p.eps_astern * astern)
        s.f[side] = bollard * unequal - (p.k_ahead * ahead + p.k_astern * astern) * speed * inflow


def spin_up(s: Signals) -> None:
    s.n_cmd, s.n = s.n, {side: getattr(s.x, f"n_{side}") for side in SIDES}


def approach(s: Signals) -> None:
    for side in SIDES:
        s.rate[f"n_{side}"] = (s.n_cmd[side] - s.n[side]) / s.p.T_n


PROPELLERS = Effect(
    "propellers",
    "a propeller's thrust curve",
    {"shaft": spin_up, "thrust": thrust_of_propellers, "rate": approach},
    parameters=(
        Parameter("c_ahead", 55.0, "N", "thrust of one propeller at full speed ahead", "log", free=False),
        Parameter("c_astern", 30.0, "N", "and astern", "log", prior=(30.0, 10.0)),
        Parameter("p_ahead", 1.7, "", "power of the speed in the thrust ahead", "log", prior=(1.7, 0.3)),
        Parameter("p_astern", 1.7, "", "and astern", "log", prior=(1.7, 0.3)),
        Parameter("k_ahead", 5.0, "kg/s", "thrust lost per forward speed at full speed ahead", prior=(5.0, 4.0),
                  bounds=(0.0, INF), step=0.5),
        Parameter("k_astern", 5.0, "kg/s", "and astern", prior=(5.0, 4.0), step=0.5),
        Parameter("eps_ahead", 0.0, "", "half the relative difference, left less right, ahead", prior=(0.0, 0.08),
                  step=0.01),
        Parameter("eps_astern", 0.0, "", "and astern", prior=(0.0, 0.08), step=0.01),
        Parameter("T_n", 0.2, "s", "lag of the motors", "log", prior=(0.2, 0.15), bounds=(0.06, 2.0)),
    ),
    states=tuple(State(f"n_{side}", "", f"shaft speed, {side}", 0.0, sd0=0.0) for side in SIDES),
    requires=("n", "f"),
    place="actuator",
)  # fmt: skip


def drift_of_heading(s: Signals) -> None:
    s.y["drift"] = s.p.dev_ms * s.x.drawn_s + s.p.dev_mc * s.x.drawn_c - s.x.psi_b


def gyro_bias(s: Signals) -> None:
    s.rate["psi_b"] = s.p.b_gyro


DRIFT = Effect(
    "drift",
    "what the heading gains on the integral of the gyro",
    {"output": drift_of_heading, "rate": gyro_bias},
    parameters=(
        Parameter("e_drift", 0.1, "rad", "noise of that", "log", free=False),
        # a thousandth of a rad/s is 17 degrees in 300 s; each run has its own
        Parameter("b_gyro", 0.0, "rad/s", "bias of the yaw gyro", prior=(0.0, 0.002), step=2e-4, per_record=True),
    ),
    states=(State("psi_b", "rad", "integral of the gyro's bias", 0.0, sd0=0.0),),
)
DRIFT_SENSOR = Sensor("drift", (Output("drift", "rad", "e_drift"),))  # leave_one_out.py makes it from psi and r


def hull(propulsion: str) -> Model:
    """The rigid body at rest at the start, with what is known of it before."""
    shaft = propulsion == "shaft"
    model = horizontal_model("shaft" if shaft else "force", ("attitude", "gyro", "body_velocity"), current=False)
    return model + catalogue()["lift"] if shaft else model


def expecting(model: Model) -> Model:
    """The model with priors and known values."""
    known = {n: v for n, v in KNOWN.items() if n in model.values}
    fixed = [model.parameter(n).at(v).fixed() for n, v in known.items()]
    fixed += [p.fixed() for p in model.parameters if p.name.startswith("s_")]
    given = [
        replace(model.parameter(n), value=mean, prior=(mean, sd), bounds=(0.0, INF))
        for n, (mean, sd) in EXPECTED.items()
        if n in model.values
    ]
    model = model.replace_parameters(*fixed, *given)
    return replace(model, states=tuple(replace(s, sd0=min(float(s.sd0), 1e-3)) for s in model.states))


def authors() -> Model:
    return expecting(hull("force"))


def propeller() -> Model:
    return expecting(hull("shaft") + PROPELLERS)


def point() -> Model:
    return expecting(hull("shaft") + PROPELLERS + catalogue()["velocity-point"])


def boat() -> Model:
    found = catalogue()
    model = expecting(hull("shaft") + PROPELLERS + found["velocity-point"] + found["compass-motor"] + DRIFT)
    return replace(model, sensors=(*model.sensors, DRIFT_SENSOR))
