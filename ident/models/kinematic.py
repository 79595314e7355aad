"""Surge and sway with measured attitude and turn rates: the paper's "6DOF K" (section 6).

If a boat rolls and pitches, its accelerometers measure a part of gravity, and its yaw rate has other causes besides the
yaw moment. In this model, heading, roll, pitch and body rates are inputs, interpolated between samples, instead of
states. u, v, w are the velocities through the water along the body axes. The hull stays on the surface (Fossen 2011,
2.18: z' = 0), so

    w = (tan(theta) u - sin(phi) v) / cos(phi)
    [x', y'] = [V_x, V_y] + the first two rows of R(phi, theta, psi) [u, v, w]
    m_u u' = X + m_v (v r - w q) - d_u u - d_uu |u| u
    m_v v' = Y - m_u u r + m_v w p - d_v v - d_vv |v| v
    ax = u' + w q - v r + g sin(theta)
    ay = v' + u r - w p - g cos(theta) sin(phi)

For level motion, this is ``seatrial.ident.models.horizontal`` without its yaw equation. The added mass in heave is
assumed equal to that in sway, as for a body of revolution. Its terms are of second order in roll and pitch. The heading
and the yaw gyro have random-walk offsets, which are subtracted. The gyro offset affects only ``v r`` and ``u r``, so
its estimate depends strongly on its prior. The noise of these inputs is not modelled. The disturbance forces and the
accelerometers' noise absorb it.

Without the yaw equation, the model has no m_r, d_r and d_rr. The option ``yaw`` adds this equation as a state, which
the gyro measures and the estimated u and v drive. All other equations still use the measured yaw rate:

    m_r r' = N + (m_u - m_v) u v - d_r r - d_rr |r| r
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from seatrial.ident.model import Hold, Input, Model, Output, Sensor, Signals, State, built_in, resolve_initial_states
from seatrial.ident.models.horizontal import (
    ARMS,
    CURRENT,
    DIFFUSION,
    HULL,
    NOISE,
    SENSORS,
    SIDES,
    THRUST,
    given_thrust,
    shaft,
    thrust,
)
from seatrial.ident.models.rotations import G, set_orientation
from seatrial.ident.numerics import rotate, rotation_matrix

STATES = (
    State("x", "m", "north", from_output="x", sd0=1.0),
    State("y", "m", "east", from_output="y", sd0=1.0),
    State("u", "m/s", "surge through the water", "s_u", sd0=0.3),
    State("v", "m/s", "sway through the water", "s_v", sd0=0.3),
)
YAW_RATE = State("r", "rad/s", "yaw rate", "s_r", from_output="r", sd0=0.1)
TURN = Sensor("turn_rate", (Output("r", "rad/s", "e_r"),))
SEEN = ("accelerometer", "position", "ground_velocity")
ATTITUDE = (
    *(Input(n, "rad", "linear", angle=True, prefilter=False) for n in ("phi", "theta", "psi")),
    *(Input(n, "rad/s", "linear", prefilter=False) for n in ("p", "q", "r")),
)
OFFSETS = (
    State("bias_psi", "rad", "offset of the measured heading", 1.7e-4, sd0=0.005, nuisance=True),
    State("bias_r", "rad/s", "offset of the yaw gyro", 1e-5, sd0=0.01, nuisance=True),
)


def kinematic_model(
    propulsion: Literal["shaft", "force"] = "shaft",
    sensors: Sequence[str] = SEEN,
    *,
    current: bool = True,
    yaw: bool = False,
    hold: Hold = "linear",
) -> Model:
    """Return the model of surge and sway with measured attitude: roll, pitch, heading and body rates are inputs.

    Parameters
    ----------
    propulsion : "shaft" or "force"
        Inputs of the thrusters. ``shaft``: measured shaft speeds ``n_left``, ``n_right`` (-1 to 1). ``force``:
        thrusts ``f_left``, ``f_right`` [N].
    sensors : Sequence[str]
        Names of the sensors whose outputs the model has: ``accelerometer``, ``position``, ``ground_velocity``. Other
        names are ignored.
    current : bool
        Whether the model has a constant ocean current, estimated separately in each record.
    yaw : bool
        Whether the model has the yaw equation, which adds the state r and a sensor of the yaw rate.
    hold : "zero", "average" or "linear"
        Shaft speeds or thrusts between their samples: constant (``zero``), constant and approximated by a straight line
        in each row of the record (``average``), or interpolated linearly (``linear``). Attitude and body rates are
        always interpolated linearly.

    Returns
    -------
    Model
        Model with the states position x, y [m], velocity through the water u, v [m/s], and the offsets of the measured
        heading [rad] and of the yaw gyro [rad/s].
    """
    letter, unit = ("n", "") if propulsion == "shaft" else ("f", "N")
    chosen = [SENSORS[s] for s in SEEN if s in sensors]
    noise = [NOISE[s.name] for s in chosen]
    if yaw:
        chosen, noise = [*chosen, TURN], [*noise, NOISE["gyro"]]
    unused = () if yaw else ("m_r", "d_r", "d_rr", "s_r")
    own = HULL + (CURRENT if current else ()) + (THRUST if propulsion == "shaft" else ()) + ARMS + DIFFUSION
    first = (("shaft", _shaft_and_attitude), ("thrust", thrust))
    if propulsion == "force":
        first = (("shaft", attitude), ("thrust", given_thrust))
    options = [propulsion, *(["yaw"] if yaw else []), *([] if current else ["no-current"])]
    return Model(
        "kinematic",
        resolve_initial_states((*STATES, *((YAW_RATE,) if yaw else ()), *OFFSETS), chosen),
        (*(Input(f"{letter}_{side}", unit, hold) for side in SIDES), *ATTITUDE),
        tuple(chosen),
        built_in((*(p for p in own if p.name not in unused), *noise)),
        (*first, ("force", turning if yaw else force), ("rate", rate), ("output", output)),
        provides=(
            "plane",
            "attitude",
            *(["turn"] if yaw else []),
            *(["n_input", "n_stamp"] if propulsion == "shaft" else []),
        ),
        source=":".join(["kinematic", *options]),
    )


def attitude(s: Signals) -> None:
    """Set the orientation, body rates and heave velocity of the boat from the measured attitude (`set_orientation`).

    The measurements are the inputs ``phi``, ``theta``, ``psi`` [rad] and ``p``, ``q``, ``r`` [rad/s]. The offsets of
    heading and yaw gyro, which are states, are subtracted first. An exported model lacks these states, so that nothing
    is subtracted.
    """
    u, x = s.u, s.x
    psi, r = u.psi - getattr(x, "bias_psi", 0.0), u.r - getattr(x, "bias_r", 0.0)
    set_orientation(s, rotation_matrix(u.phi, u.theta, psi), (u.p, u.q, r))


def _shaft_and_attitude(s: Signals) -> None:
    """Set the shaft speeds ``s.n`` (dict by side) to the inputs ``n_left``, ``n_right``, and set the orientation.

    The orientation follows from the measured attitude, less the offsets of heading and yaw gyro. Body rates and heave
    velocity are set with it (`attitude`).
    """
    shaft(s)
    attitude(s)


def force(s: Signals) -> None:
    """Set the forces less damping, ``s.X`` and ``s.Y`` [N], and the thrust of both thrusters ``s.X_thrust`` [N].

    X is the thrust less damping in surge. Y is minus the damping in sway, since the thrusts push only fore and aft.
    Effects add their forces to X and Y later.
    """
    x, p = s.x, s.p
    s.X_thrust = sum(s.f.values())
    s.X = s.X_thrust - p.d_u * x.u - p.d_uu * abs(x.u) * x.u
    s.Y = -p.d_v * x.v - p.d_vv * abs(x.v) * x.v


def turning(s: Signals) -> None:
    """Set the forces ``s.X``, ``s.Y`` [N] as `force` does, and the yaw moments ``s.N_thrust`` and ``s.N`` [N m].

    ``N_thrust`` is the moment of the thrusters, and ``N`` is ``N_thrust`` less linear and quadratic yaw damping.
    """
    force(s)
    x, p = s.x, s.p
    s.N_thrust = sum(-s.arm[side] * f for side, f in s.f.items())
    s.N = s.N_thrust - p.d_r * x.r - p.d_rr * abs(x.r) * x.r


def rate(s: Signals) -> None:
    """Set the time derivatives ``s.rate`` of position [m/s], velocity [m/s2] and sensor offsets (zero).

    A model with the yaw equation also has the derivative of the yaw rate [rad/s2]. All other equations use the measured
    body rates. A model without the parameters ``V_x``, ``V_y`` has no current.
    """
    x, p = s.x, s.p
    north, east, _ = rotate(s.R, (x.u, x.v, s.w))
    s.rate["x"], s.rate["y"] = north + getattr(p, "V_x", 0.0), east + getattr(p, "V_y", 0.0)
    s.rate["u"] = (s.X + p.m_v * (x.v * s.r_rate - s.w * s.q_rate)) / p.m_u
    s.rate["v"] = (s.Y - p.m_u * x.u * s.r_rate + p.m_v * s.w * s.p_rate) / p.m_v
    if hasattr(s, "N"):
        s.rate["r"] = (s.N + (p.m_u - p.m_v) * x.u * x.v) / p.m_r
    s.rate["bias_psi"] = s.rate["bias_r"] = 0.0


def output(s: Signals) -> None:
    """Set the outputs ``s.y``: position [m], velocity over ground [m/s] and specific force ``ax``, ``ay`` [m/s2].

    A model with the yaw equation also has the output ``r`` [rad/s]: the yaw rate plus the offset of the gyro.
    """
    x, y = s.x, s.y
    y["x"], y["y"] = x.x, x.y
    y["vx"], y["vy"] = s.rate["x"], s.rate["y"]
    y["ax"] = s.rate["u"] + s.w * s.q_rate - x.v * s.r_rate - G * s.R[2][0]
    y["ay"] = s.rate["v"] + x.u * s.r_rate - s.w * s.p_rate - G * s.R[2][1]
    if hasattr(s, "N"):
        y["r"] = x.r + getattr(x, "bias_r", 0.0)
