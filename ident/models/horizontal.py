"""Horizontal motion in three degrees of freedom, with a constant current (thesis eq. 3.2 and 3.3, corrected).

The states ``u, v`` are velocities through the water. Position ``x, y`` over ground follows from these velocities and
the current. For a current that is constant and irrotational in NED, the equations are exact with the total masses in
the Coriolis terms (Fossen 2011, property 8.1). A split into rigid-body and added mass is therefore not needed:

    m_u u' = X + m_v v r - d_u u - d_uu |u| u
    m_v v' = Y - m_u u r - d_v v - d_vv |v| v
    m_r r' = N + (m_u - m_v) u v - d_r r - d_rr |r| r

The thrust is ``f = c1 n|n| + c2 n^2`` with n normalised to [-1, 1] (thesis section 4.2), at ``y_L`` and ``y_R``. If c1,
c2, masses and damping are multiplied by one factor, the motion is the same. The scale of the thrust must therefore be
known. The arms scale the yaw equation except its Munk moment ``(m_u - m_v) u v``. If the arms are unknown, they are
estimated from the Munk moment (``symmetric_arms``).

Each thruster is a chain of parts. Each part has its own stage, so that effects on the parts can be combined in any
order:

    command -> delay -> dead zone -> shaft lag (stage ``shaft``) -> dead band -> lag of the thrust -> thrust -> losses

If the shaft speed is measured, it is the input. Otherwise the commands are the inputs, and the shaft speed is a state:
``T_n n' = n_ref(t - tau_n) - n``. ``n_ref`` is the command, or zero within the dead zone (thesis section 4.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from seatrial.daq.errors import SeatrialError
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
    built_in,
    delay_weights,
    resolve_initial_states,
    tap_name,
    weighted_sum,
)
from seatrial.ident.models.dead_zone import outside_dead_zone, transition_width
from seatrial.ident.models.published_values import ARM, TABLE_1, TABLE_2
from seatrial.ident.numerics import body_to_ned, ned_to_body

Propulsion = Literal["shaft", "command", "force", "general"]
SIDES = ("left", "right")
BUILT_IN = ParameterOrigin.BUILT_IN
SYMMETRIC = "symmetric-arms"  # option in the name of a model
# Options in the name of a model by what has the given thrust, if the thrusts of both sides differ (`with_thrust_of`)
THRUST_OF = {of: f"thrust-of-{of}" for of in (*SIDES, "both")}

HULL = (
    Parameter("m_u", TABLE_1["m_u"], "kg", "surge mass with added mass", "log"),
    Parameter("m_v", TABLE_1["m_v"], "kg", "sway mass with added mass", "log"),
    Parameter("m_r", TABLE_1["m_r"], "kg m2", "yaw inertia with added inertia", "log"),
    Parameter("d_u", TABLE_1["d_u"], "kg/s", "linear surge damping", bounds=(0, INF), step=0.3),
    Parameter("d_v", TABLE_1["d_v"], "kg/s", "linear sway damping", bounds=(0, INF), step=0.5),
    Parameter("d_r", TABLE_1["d_r"], "kg m2/s", "linear yaw damping", bounds=(0, INF), step=0.1),
    Parameter("d_uu", TABLE_1["d_uu"], "kg/m", "quadratic surge damping", bounds=(0, INF), step=0.3),
    Parameter("d_vv", TABLE_1["d_vv"], "kg/m", "quadratic sway damping", bounds=(0, INF), step=0.5),
    Parameter("d_rr", TABLE_1["d_rr"], "kg m2", "quadratic yaw damping", bounds=(0, INF), step=0.1),
)
THRUST = (
    Parameter(
        "c1", TABLE_2["c1"], "N", "thrust at full speed, mean of ahead and astern", "log", free=False, origin=BUILT_IN
    ),
    Parameter(
        "c2",
        TABLE_2["c2"],
        "N",
        "thrust at full speed, half of ahead less astern",
        free=False,
        step=0.1,
        origin=BUILT_IN,
    ),
)
DELAY_STEP, N_DELAYS = 0.05, 17  # s, and number of delayed copies of each command: delays up to 0.8 s
LONGEST_DELAY = DELAY_STEP * (N_DELAYS - 1)  # s
MAX_COPY_SHIFT = 20  # largest shift of a copy of a measured input, in steps of HISTORY_STEP
# Width of the transition at the end of the dead zone, in units of the command; the parameter is its centre
DEAD_ZONE_EDGE = 0.05
SHORTEST_LAG = 0.05  # s: time constants below it are always approximated, see `shortest_lag`
COARSE_STEP_S = 0.2  # s: interval of the rows in the search of a slow vehicle
DRIVEN_SHAFT_STEP_S = 0.05  # s: longer Runge-Kutta steps would be inaccurate for a state with the shortest lag
SHAFT = (
    Parameter("T_n", 0.2, "s", "time constant of the shafts", prior=(0.2, 0.5), bounds=(0.0, 3.0), step=0.02),
    Parameter(
        "tau_n", 0.1, "s", "delay of the shafts behind the command", prior=(0.1, 0.3), bounds=(0.0, 0.8), step=0.02
    ),
    Parameter(
        "dead_zone",
        0.03,
        "",
        "command below which the shafts do not turn",
        prior=(0.0, 0.1),
        bounds=(0.0, 0.5),
        step=0.01,
    ),
)
DEAD_ZONES = StartGrid(("dead_zone",), ((0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4),), 0.03, gaining=True)
SHAFT_STATES = tuple(State(f"n_{side}", "", f"shaft speed {side}, normalised", 1e-3, sd0=0.1) for side in SIDES)
ARMS = (
    Parameter(
        "y_left", -ARM, "m", "position of the left thruster, to starboard", free=False, step=0.01, origin=BUILT_IN
    ),
    Parameter(
        "y_right", ARM, "m", "position of the right thruster, to starboard", free=False, step=0.01, origin=BUILT_IN
    ),
)
UNKNOWN_ARM = (
    Parameter(
        "y_arm",
        0.3,
        "m",
        "arm of both thrusters, estimated from the Munk moment",
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
    """Return the model of horizontal motion in surge, sway and yaw.

    Parameters
    ----------
    propulsion : "shaft", "command", "force" or "general"
        Inputs. ``shaft``: measured shaft speeds ``n_left``, ``n_right`` (-1 to 1). ``command``: commands
        ``n_cmd_left``, ``n_cmd_right`` (-1 to 1); the shaft speeds are then states. ``force``: thrusts ``f_left``,
        ``f_right`` [N]. ``general``: surge force ``X`` [N] and yaw moment ``N`` [N m].
    sensors : Sequence[str]
        Names of the sensors whose outputs the model has; keys of `SENSORS`, for example ``gyro``.
    current : bool
        Whether the model has a constant ocean current, estimated separately in each record.
    hold : "zero", "average" or "linear"
        Inputs between their samples: constant (``zero``), constant and approximated by a straight line in each row of
        the record (``average``), or interpolated linearly (``linear``). It is ignored for commands, whose hold is
        always ``average``.

    Returns
    -------
    Model
        Model with the states position x, y [m], heading psi [rad], velocity through the water u, v [m/s] and yaw rate r
        [rad/s], and with initial parameter values from the thesis.

    Raises
    ------
    KeyError
        If a sensor or the propulsion is unknown.
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
        commands = pair("n_cmd", "", "average", prefilter=False)
        inputs = tuple(i.delayed(k, DELAY_STEP) for i in commands for k in range(N_DELAYS))
        first, provides, states = (("shaft", driven_shaft), *CHAIN[1:]), ("n", "f", "n_state"), states + SHAFT_STATES
    return Model(
        "horizontal",
        resolve_initial_states(states, (SENSORS[s] for s in sensors)),
        inputs,
        tuple(SENSORS[s] for s in sensors),
        built_in(parameters),
        (*first, ("force", force), ("rate", rate), ("output", output)),
        provides=(*provides, "hull", "heading", *(name for name in VELOCITIES if name in sensors)),
        source=f"horizontal:{propulsion}" + ("" if current else ":no-current"),
        max_step=DRIVEN_SHAFT_STEP_S if propulsion == "command" else 0.1,
        start_grid=DEAD_ZONES if propulsion == "command" else None,
    )


def pair(quantity: str, unit: str, hold: Hold, *, prefilter: bool = True) -> tuple[Input, ...]:
    """Return one input for each thruster, for example ``n_left`` and ``n_right`` for the quantity ``n``.

    Parameters
    ----------
    quantity : str
        Quantity of the inputs, with which their names begin.
    unit : str
        Unit of the inputs.
    hold : "zero", "average" or "linear"
        Inputs between their samples: constant (``zero``), constant and approximated by a straight line in each row of
        the record (``average``), or interpolated linearly (``linear``).
    prefilter : bool
        Whether the inputs are averaged over the same time as the sensors (`Input.prefilter`).
    """
    return tuple(Input(f"{quantity}_{side}", unit, hold, prefilter=prefilter) for side in SIDES)


def shaft(s: Signals) -> None:
    """Set the shaft speeds ``s.n`` (dict by side, ``left`` and ``right``) to the inputs ``n_left`` and ``n_right``."""
    s.n = {side: getattr(s.u, f"n_{side}") for side in SIDES}


def driven_shaft(s: Signals) -> None:
    """Set the shaft speeds ``s.n`` by side, which follow their commands by a delay, a dead zone and a first-order lag.

    The command is interpolated between its delayed copies at the delay ``tau_n`` (cubic convolution). The state of the
    lag is ``n_left`` or ``n_right``, whose time derivative ``s.rate`` is set.
    """
    weights = delay_weights(s.p.tau_n / DELAY_STEP, N_DELAYS)
    width = transition_width(s.p.dead_zone, DEAD_ZONE_EDGE)
    s.n = {}
    for side in SIDES:
        copies = [getattr(s.u, tap_name(f"n_cmd_{side}", k)) for k in range(N_DELAYS)]
        reference = outside_dead_zone(weighted_sum(weights, copies), s.p.dead_zone, width)
        s.n[side] = first_order(s, f"n_{side}", reference, s.p.T_n)


def shortest_lag(max_step: float) -> float:
    """Return the shortest time constant [s] of the state of a lag, in a model with steps up to ``max_step`` [s].

    It is half a step, at least `SHORTEST_LAG` (0.05 s). The integration over a step of more than two time constants
    would be inaccurate, and over a step of more than 2.7 unstable.
    """
    return max(SHORTEST_LAG, max_step / 2.0)


def first_order(s: Signals, state: str, driven_by: Any, time_constant: Any, shortest: float | None = None) -> Any:
    """Return a signal after a first-order lag, and set the time derivative of the state of the lag.

    Parameters
    ----------
    s : Signals
        Signals of the model. The entry of ``s.rate`` for the state is set.
    state : str
        Name of the state of the lag, in ``s.x``.
    driven_by : float or symbol
        Signal before the lag.
    time_constant : float or symbol
        Time constant [s], >= 0.
    shortest : float, optional
        Shortest time constant of the state [s], > 0. By default it is `shortest_lag` of the model.

    Returns
    -------
    float or symbol
        The state itself if the time constant is at least ``shortest``, and ``driven_by`` if it is zero.

    Notes
    -----
    In between, the state has the time constant ``shortest``, and the result is a weighted mean of the state and the
    signal. Its delay is that of a lag with the given time constant. Shorter time constants of the state would need
    shorter integration steps.
    """
    x, shortest = getattr(s.x, state), shortest_lag(s.max_step) if shortest is None else shortest
    s.rate[state] = (driven_by - x) / np.maximum(time_constant, shortest)
    return driven_by + np.minimum(time_constant / shortest, 1.0) * (x - driven_by)


def shift_in_time(s: Signals, quantity: str) -> None:
    """Shift the shaft speed or thrust input of each thruster in time, by cubic convolution of its copies.

    Parameters
    ----------
    s : Signals
        Signals of the model. The inputs are taken ``tau_delay - tau_age`` [s] before the present. Both are parameters
        of the model (a delay, and the age of telemetry at its time stamp); a parameter that the model lacks counts as
        zero. The model must have shifted copies of the inputs on both sides of this time; this is not checked.
    quantity : "n" or "f"
        Whether to replace the shaft speeds ``s.n`` or the thrusts ``s.f`` [N], for each side.

    Notes
    -----
    Every effect that shifts these inputs calls this function. Each call applies both shifts to the unshifted inputs, so
    that a second call changes nothing.
    """
    position = (getattr(s.p, "tau_delay", 0.0) - getattr(s.p, "tau_age", 0.0)) / HISTORY_STEP
    for side in SIDES:
        name = f"{quantity}_{side}"
        taps = available_taps(s, name)
        weights = delay_weights(position - taps[0], len(taps))
        past = weighted_sum(weights, [getattr(s.u, tap_name(name, k)) for k in taps])
        (s.n if quantity == "n" else s.f)[side] = past


def available_taps(s: Signals, name: str) -> list[int]:
    """Return the shifts of the shifted copies of an input that the model has, in steps of ``HISTORY_STEP`` (0.1 s).

    Parameters
    ----------
    s : Signals
        Signals of the model.
    name : str
        Name of the input, for example ``n_left``.

    Returns
    -------
    list[int]
        Shifts in ascending order, positive for earlier and negative for later values. The input itself has the shift
        zero. Shifts below -20 and above 19 are not searched. The list is empty for an unknown input.
    """
    inputs = vars(s.u)
    return [k for k in range(-MAX_COPY_SHIFT, MAX_COPY_SHIFT) if tap_name(name, k) in inputs]


def unchanged(s: Signals) -> None:
    """Change nothing. This function is a stage of a model that exists only because effects run after it."""


def thrust(s: Signals) -> None:
    """Set the thrust ``s.f = c1 n|n| + c2 n^2`` [N] of each thruster at its shaft speed, and its position.

    Both are dicts by side. The position ``s.arm`` [m] is lateral, positive to starboard.
    """
    s.f = {side: s.p.c1 * n * abs(n) + s.p.c2 * n * n for side, n in s.n.items()}
    s.arm = _lateral_positions(s.p)


CHAIN: tuple[tuple[str, ModelFunction], ...] = (
    ("shaft", shaft),
    ("dead_band", unchanged),
    ("thrust_lag", unchanged),
    ("thrust", thrust),
)


def given_thrust(s: Signals) -> None:
    """Set the thrust ``s.f`` [N] of each thruster to the input ``f_left`` or ``f_right``, and set its position.

    Both are dicts by side. The position ``s.arm`` [m] is lateral, positive to starboard.
    """
    s.f = {side: getattr(s.u, f"f_{side}") for side in SIDES}
    s.arm = _lateral_positions(s.p)


def _lateral_positions(p: Any) -> dict[str, Any]:
    """Return the lateral position [m] of each thruster by side, positive to starboard, from the parameters ``p``.

    With one common arm ``y_arm``, the positions are ``-y_arm`` (left) and ``y_arm`` (right), otherwise ``y_left`` and
    ``y_right``.
    """
    if hasattr(p, "y_arm"):
        return {"left": -p.y_arm, "right": p.y_arm}
    return {side: getattr(p, f"y_{side}") for side in SIDES}


def symmetric_arms(model: Model) -> Model:
    """Return the model with one estimated arm ``y_arm`` for both thrusters, in the place of ``y_left`` and ``y_right``.

    The model is for a boat with unknown lateral positions of its thrusters. The prior of the arm is wide: 0.3 m, with a
    standard deviation of 1 in its logarithm. The option ``symmetric-arms`` is appended to the source of the model. The
    model given is not changed. It is not checked whether it has the parameters ``y_left`` and ``y_right``.
    """
    own = tuple(p for p in model.parameters if p.name not in ("y_left", "y_right"))
    return replace(model, parameters=(*own, *UNKNOWN_ARM), source=f"{model.source}:{SYMMETRIC}")


def with_thrust_of(model: Model, of: str) -> Model:
    """Return the model with the given thrust for one side alone, or for the mean of both.

    An effect that makes the thrusts of both sides differ then leaves the thrust of the named side unchanged. The option
    ``thrust-of-left``, ``thrust-of-right`` or ``thrust-of-both`` is part of the source of the model, in the place of
    an earlier one. The model given is not changed.

    Parameters
    ----------
    model : Model
        Model with two thrusters, horizontal or kinematic.
    of : str
        Side with the given thrust, ``left`` or ``right``; ``both``: the given thrust is the mean of both sides;
        ``unknown``: the option is removed, and any other model is returned unchanged.

    Raises
    ------
    SeatrialError
        If there is no such side, or if the model is not one of these.
    """
    name, *options = model.source.split(":")
    others = [o for o in options if o not in THRUST_OF.values()]
    stages = tuple(stage for stage in model.stages if stage[0] != "thrust_of")
    if of == "unknown":
        return model if others == options else replace(model, stages=stages, source=":".join([name, *others]))
    if of not in THRUST_OF:
        raise SeatrialError(f"--thrust-of {of}: there is no such side; give left, right, both or unknown")
    if name not in ("horizontal", "kinematic") or "general" in options:
        raise SeatrialError(
            f"--thrust-of {of}: the model {model.source or model.name} has no thrust for each side; leave the option "
            "out, or take horizontal or kinematic with --model"
        )
    stages = (("thrust_of", SET_THRUST_OF[of]), *stages)
    return replace(model, stages=stages, source=":".join([name, *others, THRUST_OF[of]]))


def thrust_of(model: Model) -> str:
    """Return what has the given thrust by `with_thrust_of`: ``left``, ``right`` or ``both``; empty: it is unknown."""
    options = model.source.split(":")[1:]
    return next((of for of, option in THRUST_OF.items() if option in options), "")


def _thrust_of_left(s: Signals) -> None:
    """Set ``s.thrust_of`` to ``left``: this side has the given thrust."""
    s.thrust_of = "left"


def _thrust_of_right(s: Signals) -> None:
    """Set ``s.thrust_of`` to ``right``: this side has the given thrust."""
    s.thrust_of = "right"


SET_THRUST_OF: dict[str, ModelFunction] = {"left": _thrust_of_left, "right": _thrust_of_right, "both": unchanged}


def force(s: Signals) -> None:
    """Set the external forces less damping: ``s.X``, ``s.Y`` [N] and ``s.N`` [N m]. Effects add to them later.

    ``s.X_thrust`` [N] and ``s.N_thrust`` [N m] are set to the parts of the thrusters. They follow from the thrusts
    ``s.f`` and arms ``s.arm`` (positive to starboard, where a forward thrust turns the bow to port), or are the inputs
    X and N in a model without thrusters. The sway force Y is damping only.
    """
    x, p = s.x, s.p
    if hasattr(s, "f"):
        s.X_thrust, s.N_thrust = sum(s.f.values()), sum(-s.arm[side] * f for side, f in s.f.items())
    else:
        s.X_thrust, s.N_thrust = s.u.X, s.u.N
    s.X = s.X_thrust - p.d_u * x.u - p.d_uu * abs(x.u) * x.u
    s.Y = -p.d_v * x.v - p.d_vv * abs(x.v) * x.v
    s.N = s.N_thrust - p.d_r * x.r - p.d_rr * abs(x.r) * x.r


def rate(s: Signals) -> None:
    """Set the time derivatives ``s.rate`` of position [m/s], heading [rad/s] and body velocities [m/s2, rad/s2].

    The forces less damping ``s.X``, ``s.Y``, ``s.N`` have been set before. A model without the parameters ``V_x``,
    ``V_y`` has no current. The Coriolis terms, the Munk moment and the current are added here.
    """
    x, p = s.x, s.p
    north, east = body_to_ned(x.psi, x.u, x.v)
    s.rate["x"], s.rate["y"] = north + getattr(p, "V_x", 0.0), east + getattr(p, "V_y", 0.0)
    s.rate["psi"] = x.r
    s.rate["u"] = (s.X + p.m_v * x.v * x.r) / p.m_u
    s.rate["v"] = (s.Y - p.m_u * x.u * x.r) / p.m_v
    s.rate["r"] = (s.N + (p.m_u - p.m_v) * x.u * x.v) / p.m_r


def output(s: Signals) -> None:
    """Set the outputs ``s.y`` of all sensors of `SENSORS`. Those that no sensor of the model measures are ignored.

    They are position, heading, yaw rate, velocity over ground in NED and in the body frame, and specific force. The
    time derivatives ``s.rate`` must have been set before.
    """
    x, y = s.x, s.y
    y["x"], y["y"], y["psi"], y["r"] = x.x, x.y, x.psi, x.r
    y["vx"], y["vy"] = s.rate["x"], s.rate["y"]
    # velocity over ground in the body frame: it includes every current, also a random-walk or drifting current
    y["u"], y["v"] = ned_to_body(x.psi, y["vx"], y["vy"])
    y["ax"], y["ay"] = s.rate["u"] - x.v * x.r, s.rate["v"] + x.u * x.r
