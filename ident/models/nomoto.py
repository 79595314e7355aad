"""Surge and steering without sideslip: first-order Nomoto model (Nomoto 1957; Fossen 2011, section 7.2).

For a vehicle that goes where it points, and whose yaw rate follows the difference of its sides at once or with one
time constant: tracked and wheeled vehicles, jets, rudders or vanes behind two thrusters, most simulators of autopilots.
Sway and moments are not in it, so no arm and no inertia in yaw.

    m_u (u' - v r) = X - d_u u - d_uu |u| u,    X = sum of c1 ((1 - lambda_n) n |n| + lambda_n n) + c2 n^2
    T r' + r = (K + K_u u) delta (1 - k_3 delta^2),    delta = (n_left - n_right) / 2
    [x', y'] = R(psi) [u, v] + (V_x, V_y),    psi' = r,    v' = -v / tau_v + noise

K steers at any speed, K_u in proportion to it; k_3 is what a large angle loses. What little it slides is a disturbance.
T is zero where nobody gives it a prior (``--prior T=0.5:0.5``): a short one beside tau_n and T_r has several optima.
From ``SHORTEST_LAG`` down to zero it is as in ``ident.models.horizontal.first_order``.

Where nothing is slow, delays count: inputs act ``tau_n`` after their time stamp, the gyro is that of ``T_r`` earlier,
both by cubic convolution of the inputs' past, and GNSS is that of ``tau_gnss`` earlier: turn and acceleration of the
time since are integrated over that past and taken off. Accelerometers, which have a delay of their own and feel gravity
as the vehicle pitches, are not used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np

from ident.model import (
    Hold,
    Model,
    Parameter,
    ParameterRole,
    Residual,
    Signals,
    State,
    Variable,
    resolve_initial_states,
)
from ident.models.disturbances import TIME, adder, disturbance
from ident.models.horizontal import (
    CURRENT,
    HULL,
    NOISE,
    SENSORS,
    SHORTEST_LAG,
    SIDES,
    THRUST,
    first_order,
    pair,
    unchanged,
)
from ident.models.thruster import delay_weights

STEP, TAPS = 0.05, range(-2, 10)  # s between copies of the inputs, and which there are: 0.1 s ahead, 0.45 s back
AHEAD, LONGEST = -STEP * TAPS[0], 0.3  # s: of tau_n; of either sensor's delay, behind an input that is half as late
LINEARITY = Parameter(
    "lambda_n", 0.0, "", "share of the thrust that is linear", prior=(0.0, 0.5), bounds=(-1.0, 1.5), step=0.02
)
STEERING = (
    Parameter("K", 0.5, "rad/s", "steady yaw rate at full difference of the sides, at rest", step=0.05),
    Parameter("K_u", 0.1, "rad/m", "the same per speed", step=0.05),
    Parameter("k_3", 0.0, "", "share of it that is lost at full difference", prior=(0.0, 0.3), step=0.05),
    Parameter("T", 0.0, "s", "time constant of the yaw rate", bounds=(0.0, 10.0), free=False, step=0.02),
)
TIMING = (
    Parameter("tau_n", 0.0, "s", "delay of thrust and steering behind the inputs' time stamps", prior=(0.0, 0.1),
              bounds=(-AHEAD, LONGEST / 2), step=0.01),
    Parameter("T_r", 0.05, "s", "delay of the gyro", prior=(0.0, 0.1), bounds=(0.0, LONGEST), step=0.01),
    Parameter("tau_gnss", 0.1, "s", "age of the GNSS fix at its time stamp", prior=(0.1, 0.2), bounds=(0.0, LONGEST),
              step=0.02),
)
DIFFUSION = (
    Parameter("s_u", 0.03, "m/s/sqrt(s)", "process noise of surge speed", "log"),
    Parameter("s_r", 0.03, "rad/s/sqrt(s)", "process noise of yaw rate", "log"),
    Parameter("s_psi", 0.01, "rad/sqrt(s)", "process noise of the heading", "log"),
    Parameter("q_v", 0.02, "m/s/sqrt(s)", "diffusion of the sideslip", "log", prior=(0.02, 0.06)),
    Parameter("tau_v", 5.0, "s", "correlation time of the sideslip", "log", prior=(5.0, 10.0), bounds=(0.5, 100.0),
              role=ParameterRole.DISTURBANCE),
)
STATES = (
    State("x", "m", "north", from_output="x", sd0=1.0),
    State("y", "m", "east", from_output="y", sd0=1.0),
    State("psi", "rad", "heading", "s_psi", from_output="psi", sd0=0.1),
    State("u", "m/s", "speed ahead", "s_u", sd0=0.3),
    State("v", "m/s", "sideslip", "q_v", sd0=0.05, nuisance=True),
    State("r", "rad/s", "yaw rate behind its lag", "s_r", sd0=0.1),
)
RESIDUALS = (
    Residual("X", "N", "b_X", 10.0, "the force X", adder("X"), of=("u", "r", "psi", "t"), requires=("nomoto",)),
    Residual("r_ref", "rad/s", "b_r_ref", 0.3, "the steady yaw rate", adder("r_ref"), of=("u", "psi", "t"),
             requires=("nomoto",)),
)

SEEN = ("attitude", "gyro", "position", "ground_velocity")
VARIABLES = (
    Variable("u", "m/s", attrgetter("x.u"), functions=7),
    Variable("r", "rad/s", attrgetter("x.r")),
    Variable("psi", "rad", attrgetter("x.psi"), angle=True),
    TIME,
)


def nomoto_model(sensors: Sequence[str] = SEEN, *, current: bool = True, hold: Hold = "linear") -> Model:
    """The model, driven by the shaft speeds, or an autopilot's outputs, ``n_left`` and ``n_right`` (normalised)."""
    now = pair("n", "", hold)
    past = tuple(replace(i.delayed(k, STEP), name=_past(i.name, k)) for i in now for k in TAPS if k)
    parameters = tuple(p for p in HULL if p.name in ("m_u", "d_u", "d_uu"))
    parameters += (*(CURRENT if current else ()), *THRUST, LINEARITY, *STEERING, *TIMING, *DIFFUSION)
    chosen = tuple(SENSORS[s] for s in sensors)
    return Model(
        "nomoto",
        resolve_initial_states(STATES, chosen),
        (*now, *past),
        chosen,
        (*parameters, *(NOISE[s.name] for s in chosen)),
        (("shaft", delayed), ("dead_band", unchanged), ("thrust_lag", unchanged), ("thrust", thrust), ("force", force),
         ("rate", rate), ("output", output)),
        provides=("n", "f", "n_input", "plane", "nomoto"),
        source="nomoto" if current else "nomoto:no-current",
        residuals=RESIDUALS,
        variables=VARIABLES,
        disturbance=disturbance(("X", "r_ref")),
        max_step=SHORTEST_LAG,
    )


def _past(name: str, k: int) -> str:
    return f"{name}~{k}x{STEP:g}s" if k else name


def _static_thrust(p: Any, n: Any) -> Any:
    return p.c1 * ((1 - p.lambda_n) * n * abs(n) + p.lambda_n * n) + p.c2 * n * n


def _steady_rate(s: Signals, left: Any, right: Any) -> Any:
    delta, p = (left - right) / 2, s.p
    return (p.K + p.K_u * s.x.u) * delta * (1 - p.k_3 * delta * delta)


def delayed(s: Signals) -> None:
    """Inputs of ``tau_n`` ago."""
    s.past = [[getattr(s.u, _past(f"n_{side}", k)) for side in SIDES] for k in TAPS]
    now = _weights_at(s.p.tau_n)
    s.n = {side: sum(w * n[i] for w, n in zip(now, s.past, strict=True)) for i, side in enumerate(SIDES)}


def thrust(s: Signals) -> None:
    s.f = {side: _static_thrust(s.p, n) for side, n in s.n.items()}


def force(s: Signals) -> None:
    """Thrust less damping X [N], and the yaw rate r_ref [rad/s] that the difference of the sides ends at."""
    p, u = s.p, s.x.u
    s.X = sum(s.f.values()) - p.d_u * u - p.d_uu * abs(u) * u
    s.r_ref = _steady_rate(s, *s.n.values())


def rate(s: Signals) -> None:
    x = s.x
    s.r = first_order(s, "r", s.r_ref, s.p.T)
    s.rate["x"], s.rate["y"] = _over_ground(s, 0.0, 0.0)
    s.rate["psi"], s.rate["u"], s.rate["v"] = s.r, s.X / s.p.m_u + x.v * s.r, -x.v / s.p.tau_v


def _over_ground(s: Signals, turned: Any, gained: Any) -> tuple[Any, Any]:
    """Velocity north and east [m/s] before this change of heading [rad] and of speed [m/s]."""
    x, u = s.x, s.x.u - gained
    cos, sin = np.cos(x.psi - turned), np.sin(x.psi - turned)
    return cos * u - sin * x.v + getattr(s.p, "V_x", 0.0), sin * u + cos * x.v + getattr(s.p, "V_y", 0.0)


def output(s: Signals) -> None:
    x, y, p, tau = s.x, s.y, s.p, s.p.tau_gnss
    turns = [_steady_rate(s, *n) for n in s.past]
    pushes = [sum(_static_thrust(p, n) for n in both) for both in s.past]
    direct = 1 - np.minimum(p.T / SHORTEST_LAG, 1.0)  # part of the yaw rate that follows its inputs at once
    now, then = _weights_at(p.tau_n), _weights_at(p.tau_n + p.T_r)
    since = [b - a - tau * w for a, b, w in zip(_weights_to(p.tau_n), _weights_to(p.tau_n + tau), now, strict=True)]

    def weighed(weights: Sequence[Any], values: Sequence[Any]) -> Any:
        return sum(w * value for w, value in zip(weights, values, strict=True))

    slow = (1 - direct) * s.rate["r"]
    y["psi"] = x.psi
    y["r"] = s.r - p.T_r * slow + direct * (weighed(then, turns) - weighed(now, turns))
    turned = tau * s.r - tau * tau / 2 * slow + direct * weighed(since, turns)
    gained = tau * s.rate["u"] + weighed(since, pushes) / p.m_u
    y["vx"], y["vy"] = _over_ground(s, turned, gained)
    north, east = _over_ground(s, turned / 2, gained / 2)
    y["x"], y["y"] = x.x - tau * north, x.y - tau * east


def _weights_at(delay: Any) -> list[Any]:
    """Weights of the copies for the value of so long ago [s]."""
    return delay_weights(delay / STEP - TAPS[0], len(TAPS))


def _weights_to(delay: Any) -> list[Any]:
    """Weights of the copies for the integral from the first of them to so long ago [s], straight lines between them."""
    weights: list[Any] = [0.0] * len(TAPS)
    for k in range(len(TAPS) - 1):
        part = np.minimum(np.maximum(delay / STEP - TAPS[k], 0.0), 1.0)
        weights[k] = weights[k] + STEP * (part - part * part / 2)
        weights[k + 1] = weights[k + 1] + STEP * part * part / 2
    return weights
