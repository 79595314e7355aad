"""Models of the BlueBoat, for leave_one_out.py and `seatrial ident vehicle --model boat.py:NAME --keep-thruster-sides`.

    authors    rigid body with quadratic drag, and the force of the data's authors, which is linear in PWM
    propeller  force from PWM by the curve c |n|^p of a propeller, separately ahead and astern, with loss of thrust by
               forward speed; lag of the motors; unequal thrusters; yaw damping that grows with forward speed
    point      propeller, and velocities at the position of the autopilot, away from the centre of the boat
    boat       point, and a heading error of the autopilot while the motors run (effect compass-motor)

Left and right of the data file are exchanged: with its signs the boat would turn against the thrust difference. The
arms are therefore exchanged here.

The priors use knowledge from outside the data: 15 kg and 1.7 kg m2, thrusters 0.285 m from the centre line, 55 N at
full PWM ahead by the maker's table and less astern. The fixed sensor noise sets the weight of the data against the
priors. The residuals are coloured over seconds, so the noise is chosen such that a sample has 1/25 of the weight of a
white sample.

Sources: Fossen 2011, 9.1 (advance: bilinear thrust), 6.4 (damping); Blanke 1981.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from seatrial.ident.effects import catalogue
from seatrial.ident.model import INF, Effect, Model, Output, Parameter, Sensor, Signals, State
from seatrial.ident.models import SIDES, horizontal_model

SMALL = 1e-3  # share of full speed; it makes powers smooth at rest
# Parameters that are fixed at these values
KNOWN = {"y_left": 0.285, "y_right": -0.285, "e_uv": 0.35, "e_r": 0.25, "e_psi": 50.0, "d_vv": 0.0, "Y_uv": 0.0}
EXPECTED = {  # mean and standard deviation of the priors
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
    """Compute the thrust of both propellers from their shaft speeds and their velocities through the water."""
    p = s.p
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        n = s.n[side]
        speed, ahead, astern = np.sqrt(n * n + SMALL * SMALL), 1.0 * (n > 0), 1.0 * (n < 0)
        inflow = s.x.u - s.arm[side] * s.x.r
        bollard = ahead * p.c_ahead * speed**p.p_ahead - astern * p.c_astern * speed**p.p_astern
        unequal = 1 + sign * (p.eps_ahead * ahead + p.eps_astern * astern)
        s.f[side] = bollard * unequal - (p.k_ahead * ahead + p.k_astern * astern) * speed * inflow


def spin_up(s: Signals) -> None:
    """Replace the commanded shaft speeds by the states of the motors, and keep the commands for their rates."""
    s.n_cmd, s.n = s.n, {side: getattr(s.x, f"n_{side}") for side in SIDES}


def approach(s: Signals) -> None:
    """Compute the rates of the shaft speeds, which follow the commands with a first-order lag."""
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
    """Compute the output ``drift``: the error of the heading less the integral of the gyro's bias."""
    s.y["drift"] = s.p.dev_ms * s.x.drawn_s + s.p.dev_mc * s.x.drawn_c - s.x.psi_b


def gyro_bias(s: Signals) -> None:
    """Compute the rate of the integral of the gyro's bias."""
    s.rate["psi_b"] = s.p.b_gyro


DRIFT = Effect(
    "drift",
    "difference between the heading and the integral of the gyro",
    {"output": drift_of_heading, "rate": gyro_bias},
    parameters=(
        Parameter("e_drift", 0.1, "rad", "noise of the difference", "log", free=False),
        # 0.001 rad/s are 17 degrees in 300 s. Each run has its own bias.
        Parameter("b_gyro", 0.0, "rad/s", "bias of the yaw gyro", prior=(0.0, 0.002), step=2e-4, per_record=True),
    ),
    states=(State("psi_b", "rad", "integral of the gyro's bias", 0.0, sd0=0.0),),
)
DRIFT_SENSOR = Sensor("drift", (Output("drift", "rad", "e_drift"),))  # leave_one_out.py computes it from psi and r


def hull(propulsion: str) -> Model:
    """Return the rigid body with force ("force") or shaft speeds ("shaft") as inputs.

    With shaft speeds the model has the effect "lift", for the yaw damping that grows with forward speed.
    """
    shaft = propulsion == "shaft"
    model = horizontal_model("shaft" if shaft else "force", ("attitude", "gyro", "body_velocity"), current=False)
    return model + catalogue()["lift"] if shaft else model


def expecting(model: Model) -> Model:
    """Return the model with priors and fixed values, and with a nearly known initial state."""
    known = {n: v for n, v in KNOWN.items() if n in model.values}
    fixed = [model.parameter(n).at(v).fixed() for n, v in known.items()]
    fixed += [p.fixed() for p in model.parameters if p.name.startswith("s_")]
    with_priors = [
        replace(model.parameter(n), value=mean, prior=(mean, sd), bounds=(0.0, INF))
        for n, (mean, sd) in EXPECTED.items()
        if n in model.values
    ]
    model = model.replace_parameters(*fixed, *with_priors)
    return replace(model, states=tuple(replace(s, sd0=min(float(s.sd0), 1e-3)) for s in model.states))


def authors() -> Model:
    """Return the model ``authors``."""
    return expecting(hull("force"))


def propeller() -> Model:
    """Return the model ``propeller``."""
    return expecting(hull("shaft") + PROPELLERS)


def point() -> Model:
    """Return the model ``point``."""
    return expecting(hull("shaft") + PROPELLERS + catalogue()["velocity-point"])


def boat() -> Model:
    """Return the model ``boat``."""
    found = catalogue()
    model = expecting(hull("shaft") + PROPELLERS + found["velocity-point"] + found["compass-motor"] + DRIFT)
    return replace(model, sensors=(*model.sensors, DRIFT_SENSOR))
