"""Model of a boat whose yaw rate is proportional to its speed, as in the simulator of ArduPilot Rover.

It is for `seatrial ident vehicle --model steered_boat.py:boat`.

    m_u u' = F - d_uu |u| u,  F = 20 (n_left + n_right)    surge
    T r'   = k u (n_left - n_right) - r                    yaw with a lag T instead of an inertia
    psi'   = r
    vx, vy = (u - tau u') (cos psi, sin psi)               GNSS velocity with a latency tau

The simulator uses u' = 0.5 F - 0.25 u|u| with F = 0.1 (mean PWM - 1500 us), and a yaw rate in proportion to the speed
and to the difference of the outputs. With n = (PWM - 1500 us) / 400 us, F [N] is the force above, and the true values
are m_u = 2 kg and d_uu = 0.5 kg/m. n_left and n_right are the outputs of the autopilot, not the commands to it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from seatrial.ident.model import Input, Output, Parameter, Sensor, State, plain_model

F_PER_N = 20.0  # N at one thruster for n = 1


def _surge(x: Any, u: Any, p: Any) -> Any:
    """Return the surge acceleration [m/s2]."""
    return (F_PER_N * (u.n_left + u.n_right) - p.d_uu * abs(x.u) * x.u) / p.m_u


def _f(x: Any, u: Any, p: Any) -> dict[str, Any]:
    """Return the rates of the states."""
    return {"u": _surge(x, u, p), "r": (p.k * x.u * (u.n_left - u.n_right) - x.r) / p.T, "psi": x.r}


def _h(x: Any, u: Any, p: Any) -> dict[str, Any]:
    """Return the outputs. The GNSS velocity is extrapolated back by its latency."""
    delayed = x.u - p.tau * _surge(x, u, p)
    return {"psi": x.psi, "r": x.r + p.b_r, "vx": delayed * np.cos(x.psi), "vy": delayed * np.sin(x.psi)}


boat = plain_model(
    "steered boat",
    f=_f,
    h=_h,
    states=(
        State("u", "m/s", "surge through the water", "s_u", sd0=0.5),
        State("r", "rad/s", "yaw rate", "s_r", from_output="r", sd0=0.1),
        State("psi", "rad", "heading", 1e-3, from_output="psi", sd0=0.2),
    ),
    inputs=(Input("n_left", ""), Input("n_right", "")),
    sensors=(
        Sensor("ahrs", (Output("psi", "rad", "e_psi", angle=True),)),
        Sensor("gyro", (Output("r", "rad/s", "e_r"),)),
        Sensor("gnss", (Output("vx", "m/s", "e_v"), Output("vy", "m/s", "e_v"))),
    ),
    parameters=(
        Parameter("m_u", 5.0, "kg", "surge mass with added mass", "log"),
        Parameter("d_uu", 2.0, "kg/m", "quadratic damping", "log"),
        Parameter("k", 0.5, "rad/m", "yaw rate per speed and difference of n", step=0.05),
        Parameter("T", 0.3, "s", "lag of the yaw rate", "log", bounds=(0.01, 10.0)),
        Parameter("tau", 0.1, "s", "latency of the GNSS velocity", prior=(0.1, 0.2), step=0.02),
        Parameter("b_r", 0.0, "rad/s", "bias of the gyro", prior=(0.0, 0.01), per_record=True, step=0.001),
        Parameter("s_u", 0.1, "m/s/sqrt(s)", "process noise of surge speed", "log"),
        Parameter("s_r", 0.05, "rad/s/sqrt(s)", "process noise of yaw rate", "log"),
        Parameter("e_psi", 0.01, "rad", "noise of the heading", "log"),
        Parameter("e_r", 0.01, "rad/s", "noise of the gyro", "log"),
        Parameter("e_v", 0.1, "m/s", "noise of the GNSS velocity", "log"),
    ),
)
