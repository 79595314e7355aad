"""Horizontal motion, three degrees of freedom, with a constant current (thesis eq. 3.2 and 3.3, corrected).

States ``u, v`` are velocities through the water; ``x, y`` move over ground by those and the current. For a
current that is constant and irrotational in NED this is exact with the total masses in the Coriolis terms
(Fossen 2011, property 8.1), so no split into rigid-body and added mass is needed:

    m_u u' = X + m_v v r - d_u u - d_uu |u| u
    m_v v' = Y - m_u u r - d_v v - d_vv |v| v
    m_r r' = N + (m_u - m_v) u v - d_r r - d_rr |r| r

Thrust: ``f = c1 n|n| + c2 n^2`` with n normalised to [-1, 1] (thesis section 4.2), at ``y_L`` and ``y_R``. Multiplied
by one factor, c1, c2, masses and damping give the same motion: the scale has to be known. The arms scale the yaw
equation alone, but for its Munk moment ``(m_u - m_v) u v``: where they are unknown, that estimates them
(``symmetric_arms``).

Each thruster is one chain, whose parts have their own stages, so that effects in it compose in any order:

    command -> delay -> dead zone -> shaft lag (stage ``shaft``) -> dead band -> lag of the thrust -> thrust -> losses

Where the shaft speed is measured, it is the input; where it is not, commands are, and it is a state:
``T_n n' = n_ref(t - tau_n) - n``, ``n_ref`` the command, zero within its dead zone (thesis section 4.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from seatrial.ident.model import (
    HISTORY_STEP,
    INF,
    Hold,
    Input,
    Model,
    ModelFunction,
    Output,
    Parameter,
    ParameterOrigin,
    Sensor,
    Signals,
    StartGrid,
    State,
    resolve_initial_states,
    tap_name,
)
from seatrial.ident.models.thruster import delay_weights

Propulsion = Literal["shaft", "command", "force", "general"]
SIDES = ("left", "right")
BUILT_IN = ParameterOrigin.BUILT_IN
SYMMETRIC = "symmetric-arms"  # option of a model's name

HULL = (
    Parameter("m_u", 37.0, "kg", "surge mass with added mass", "log"),
    Parameter("m_v", 47.0, "kg", "sway mass with added mass", "log"),
    Parameter("m_r", 9.69, "kg m2", "yaw inertia with added inertia", "log"),
    Parameter("d_u", 0.2, "kg/s", "linear surge damping", bounds=(0, INF), step=0.3),
    Parameter("d_v", 50.0, "kg/s", "linear sway damping", bounds=(0, INF), step=0.5),
    Parameter("d_r", 4.14, "kg m2/s", "linear yaw damping", bounds=(0, INF), step=0.1),
    Parameter("d_uu", 25.0, "kg/m", "quadratic surge damping", bounds=(0, INF), step=0.3),
    Parameter("d_vv", 0.01, "kg/m", "quadratic sway damping", bounds=(0, INF), step=0.5),
    Parameter("d_rr", 6.23, "kg m2", "quadratic yaw damping", bounds=(0, INF), step=0.1),
)
THRUST = (
    Parameter("c1", 40.05, "N", "thrust at full speed, odd part", "log", free=False, origin=BUILT_IN),
    Parameter("c2", 1.11, "N", "thrust at full speed, even part", free=False, step=0.1, origin=BUILT_IN),
)
DELAY_STEP, N_DELAYS = 0.05, 17  # s, and copies of each command: delays up to 0.8 s
LONGEST_DELAY = DELAY_STEP * (N_DELAYS - 1)  # s
FURTHEST = 20  # copies of a measured input, at most
DEAD_ZONE_EDGE = 0.05  # of the command: over which the dead zone ends, its middle where the parameter says
NARROWEST = 1e-9  # of the command: no division by the width of no dead zone
SHORTEST_LAG = 0.05  # s, and
DRIVEN_STEP = 0.05  # s: longer Runge-Kutta steps do not follow so quick a state
SHAFT = (
    Parameter("T_n", 0.2, "s", "time constant of the shafts", prior=(0.2, 0.5), bounds=(0.0, 3.0), step=0.02),
    Parameter(
        "tau_n", 0.1, "s", "delay of the shafts behind the command", prior=(0.1, 0.3), bounds=(0.0, 0.8), step=0.02
    ),
    Parameter(
        "dead_zone", 0.03, "", "command below which the shafts stand", prior=(0.0, 0.1), bounds=(0.0, 0.5), step=0.01
    ),
)
DEAD_ZONES = StartGrid(("dead_zone",), ((0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4),), 0.03, gaining=True)
SHAFT_STATES = tuple(State(f"n_{side}", "", f"shaft speed {side}, normalised", 1e-3, sd0=0.1) for side in SIDES)
ARMS = (
    Parameter("y_left", -0.15, "m", "left thruster, to starboard", free=False, step=0.01, origin=BUILT_IN),
    Parameter("y_right", 0.15, "m", "right thruster, to starboard", free=False, step=0.01, origin=BUILT_IN),
)
UNKNOWN_ARM = (
    Parameter(
        "y_arm",
        0.3,
        "m",
        "arm of both thrusters, by the Munk moment",
        "log",
        prior=(0.3, 0.3),
        step=0.01,
        origin=BUILT_IN,
    ),
)
DIFFUSION = (
    Parameter("s_u", 0.01, "m/s/sqrt(s)", "process noise of surge speed", "log"),
    Parameter("s_v", 0.01, "m/s/sqrt(s)", "process noise of sway speed", "log"),
    Parameter("s_r", 0.01, "rad/s/sqrt(s)", "process noise of yaw rate", "log"),
)
CURRENT = (
    Parameter("V_x", 0.0, "m/s", "current to the north", prior=(0.0, 0.5), per_record=True, step=0.01),
    Parameter("V_y", 0.0, "m/s", "current to the east", prior=(0.0, 0.5), per_record=True, step=0.01),
)
SENSORS = {
    "attitude": Sensor("attitude", (Output("psi", "rad", "e_psi", angle=True),)),
    "gyro": Sensor("gyro", (Output("r", "rad/s", "e_r"),)),
    "accelerometer": Sensor("accelerometer", (Output("ax", "m/s2", "e_a"), Output("ay", "m/s2", "e_a"))),
    "position": Sensor("position", (Output("x", "m", "e_xy"), Output("y", "m", "e_xy"))),
    "ground_velocity": Sensor("ground_velocity", (Output("vx", "m/s", "e_vxy"), Output("vy", "m/s", "e_vxy"))),
    "body_velocity": Sensor("body_velocity", (Output("u", "m/s", "e_uv"), Output("v", "m/s", "e_uv"))),
}
VELOCITIES = ("ground_velocity", "body_velocity")
STANDARD = ("attitude", "gyro", "accelerometer", "position", "ground_velocity")
NOISE = {
    "attitude": Parameter("e_psi", 0.01, "rad", "noise of the heading", "log"),
    "gyro": Parameter("e_r", 0.005, "rad/s", "noise of the yaw gyro", "log"),
    "accelerometer": Parameter("e_a", 0.05, "m/s2", "noise of the accelerometers", "log"),
    "position": Parameter("e_xy", 0.05, "m", "noise of the position, per axis", "log"),
    "ground_velocity": Parameter("e_vxy", 0.05, "m/s", "noise of the velocity over ground, per axis", "log"),
    "body_velocity": Parameter("e_uv", 0.03, "m/s", "noise of the body velocity, per axis", "log"),
}


def horizontal_model(
    propulsion: Propulsion = "shaft",
    sensors: Sequence[str] = STANDARD,
    *,
    current: bool = True,
    hold: Hold = "linear",
) -> Model:
    """The horizontal model.

    propulsion: ``shaft`` takes the measured shaft speeds ``n_left``, ``n_right`` (normalised), ``command`` the commands
    ``n_cmd_left``, ``n_cmd_right``, held, ``force`` the thrusts ``f_left``, ``f_right`` [N], ``general`` the force
    ``X`` [N] and the moment ``N`` [N m].
    """
    states: tuple[State, ...] = (
        State("x", "m", "north", from_output="x", sd0=1.0),
        State("y", "m", "east", from_output="y", sd0=1.0),
        State("psi", "rad", "heading", from_output="psi", sd0=0.1),
        State("u", "m/s", "surge through the water", "s_u", sd0=0.3),
        State("v", "m/s", "sway through the water", "s_v", sd0=0.3),
        State("r", "rad/s", "yaw rate", "s_r", sd0=0.1),
    )
    parameters = HULL + (CURRENT if current else ())
    parameters += {"shaft": THRUST + ARMS, "command": SHAFT + THRUST + ARMS, "force": ARMS, "general": ()}[propulsion]
    parameters += DIFFUSION + tuple(NOISE[s] for s in sensors)
    inputs: tuple[Input, ...] = (Input("X", "N", hold), Input("N", "N m", hold))
    first: tuple[tuple[str, ModelFunction], ...] = ()
    provides: tuple[str, ...] = ()
    if propulsion == "shaft":
        inputs, first, provides = pair("n", "", hold), CHAIN, ("n", "f", "n_input", "n_stamp")
    elif propulsion == "force":
        inputs = pair("f", "N", hold)
        first, provides = (("shaft", given_thrust), ("thrust_lag", unchanged), ("thrust", unchanged)), ("f", "f_input")
    elif propulsion == "command":
        told = pair("n_cmd", "", "average", prefilter=False)
        inputs = tuple(i.delayed(k, DELAY_STEP) for i in told for k in range(N_DELAYS))
        first, provides, states = (("shaft", driven_shaft), *CHAIN[1:]), ("n", "f", "n_state"), states + SHAFT_STATES
    return Model(
        "horizontal",
        resolve_initial_states(states, (SENSORS[s] for s in sensors)),
        inputs,
        tuple(SENSORS[s] for s in sensors),
        parameters,
        (*first, ("force", force), ("rate", rate), ("output", output)),
        provides=(*provides, "hull", "heading", *(name for name in VELOCITIES if name in sensors)),
        source=f"horizontal:{propulsion}" + ("" if current else ":no-current"),
        max_step=DRIVEN_STEP if propulsion == "command" else 0.1,
        start_grid=DEAD_ZONES if propulsion == "command" else None,
    )


def pair(quantity: str, unit: str, hold: Hold, *, prefilter: bool = True) -> tuple[Input, ...]:
    """One input for each thruster."""
    return tuple(Input(f"{quantity}_{side}", unit, hold, prefilter=prefilter) for side in SIDES)


def shaft(s: Signals) -> None:
    s.n = {side: getattr(s.u, f"n_{side}") for side in SIDES}


def driven_shaft(s: Signals) -> None:
    """Shafts behind their commands: a delay, cubic between the copies, a dead zone, a first-order lag."""
    weights = delay_weights(s.p.tau_n / DELAY_STEP, N_DELAYS)
    s.n = {}
    for side in SIDES:
        told = sum(w * getattr(s.u, tap_name(f"n_cmd_{side}", k)) for k, w in enumerate(weights))
        s.n[side] = first_order(s, f"n_{side}", outside_dead_zone(told, s.p.dead_zone), s.p.T_n)


def outside_dead_zone(command: Any, dead_zone: Any) -> Any:
    """The command where it exceeds the dead zone, else zero; a smooth step of width ``DEAD_ZONE_EDGE`` about its end.

    A dead zone of less than half that width has a step from zero to twice itself: one of zero is the command itself,
    and its end is where the parameter says all the way down.
    """
    width = np.minimum(DEAD_ZONE_EDGE, 2.0 * dead_zone)
    end = dead_zone + width / 2.0
    # counted from where it is all over: without a dead zone that is nowhere below any command, of zero too
    short = np.minimum(np.maximum((end - abs(command)) / np.maximum(width, NARROWEST), 0.0), 1.0)
    return command * (1.0 - short * short * (3.0 - 2.0 * short))


def first_order(s: Signals, state: str, driven_by: Any, time_constant: Any) -> Any:
    """A signal behind a first-order lag, whose rate this sets. From ``SHORTEST_LAG`` down to zero it is a mean of the
    state, which gets no quicker, and of the signal itself, and as late as a lag of that time constant."""
    x = getattr(s.x, state)
    s.rate[state] = (driven_by - x) / np.maximum(time_constant, SHORTEST_LAG)
    return driven_by + np.minimum(time_constant / SHORTEST_LAG, 1.0) * (x - driven_by)


def shift_in_time(s: Signals, quantity: str) -> None:
    """The measured or given input of each thruster, ``tau_delay`` later and the ``age`` of its telemetry earlier, by
    cubic convolution of those of its copies that the model has: whatever shifts it in time calls this one."""
    position = (getattr(s.p, "tau_delay", 0.0) - getattr(s.p, "tau_age", 0.0)) / HISTORY_STEP
    for side in SIDES:
        name = f"{quantity}_{side}"
        taps = copies_of(s, name)
        weights = delay_weights(position - taps[0], len(taps))
        past = sum(w * getattr(s.u, tap_name(name, k)) for w, k in zip(weights, taps, strict=True))
        (s.n if quantity == "n" else s.f)[side] = past


def copies_of(s: Signals, name: str) -> list[int]:
    """The copies of a measured or given input that the model has, in steps of ``HISTORY_STEP``, one after the other."""
    return [k for k in range(-FURTHEST, FURTHEST) if hasattr(s.u, tap_name(name, k))]


def unchanged(s: Signals) -> None:
    """A place in the chain for effects."""


def thrust(s: Signals) -> None:
    s.f = {side: s.p.c1 * n * abs(n) + s.p.c2 * n * n for side, n in s.n.items()}
    s.arm = _arms(s.p)


CHAIN: tuple[tuple[str, ModelFunction], ...] = (
    ("shaft", shaft),
    ("dead_band", unchanged),
    ("thrust_lag", unchanged),
    ("thrust", thrust),
)


def given_thrust(s: Signals) -> None:
    s.f = {side: getattr(s.u, f"f_{side}") for side in SIDES}
    s.arm = _arms(s.p)


def _arms(p: Any) -> dict[str, Any]:
    """Lateral position of each thruster [m, to starboard]."""
    if hasattr(p, "y_arm"):
        return {"left": -p.y_arm, "right": p.y_arm}
    return {side: getattr(p, f"y_{side}") for side in SIDES}


def symmetric_arms(model: Model) -> Model:
    """The model with one arm ``y_arm`` for both thrusters, estimated, in place of ``y_left`` and ``y_right``; for a
    boat whose arms nobody gave. Its prior is wide: a factor of e either way."""
    own = tuple(p for p in model.parameters if p.name not in ("y_left", "y_right"))
    return replace(model, parameters=(*own, *UNKNOWN_ARM), source=f"{model.source}:{SYMMETRIC}")


def force(s: Signals) -> None:
    """External forces less damping: X, Y [N] and N [N m]; effects add to them."""
    x, p = s.x, s.p
    if hasattr(s, "f"):
        s.X_thrust, s.N_thrust = sum(s.f.values()), sum(-s.arm[side] * f for side, f in s.f.items())
    else:
        s.X_thrust, s.N_thrust = s.u.X, s.u.N
    s.X = s.X_thrust - p.d_u * x.u - p.d_uu * abs(x.u) * x.u
    s.Y = -p.d_v * x.v - p.d_vv * abs(x.v) * x.v
    s.N = s.N_thrust - p.d_r * x.r - p.d_rr * abs(x.r) * x.r


def rate(s: Signals) -> None:
    x, p = s.x, s.p
    cos, sin = np.cos(x.psi), np.sin(x.psi)
    s.rate["x"] = cos * x.u - sin * x.v + getattr(p, "V_x", 0.0)
    s.rate["y"] = sin * x.u + cos * x.v + getattr(p, "V_y", 0.0)
    s.rate["psi"] = x.r
    s.rate["u"] = (s.X + p.m_v * x.v * x.r) / p.m_u
    s.rate["v"] = (s.Y - p.m_u * x.u * x.r) / p.m_v
    s.rate["r"] = (s.N + (p.m_u - p.m_v) * x.u * x.v) / p.m_r


def output(s: Signals) -> None:
    """All that a sensor could see; the model's sensors pick theirs."""
    x, y = s.x, s.y
    cos, sin = np.cos(x.psi), np.sin(x.psi)
    y["x"], y["y"], y["psi"], y["r"] = x.x, x.y, x.psi, x.r
    y["vx"], y["vy"] = s.rate["x"], s.rate["y"]
    # over ground, in the axes of the body: whatever moves the water (a current that wanders or drifts) is in it
    y["u"], y["v"] = cos * y["vx"] + sin * y["vy"], cos * y["vy"] - sin * y["vx"]
    y["ax"], y["ay"] = s.rate["u"] - x.v * x.r, s.rate["v"] + x.u * x.r
