"""Surge in a straight line (thesis section 6): ``m_u u' + d_u u + d_uu |u| u = X``, nominal values of its Table 1."""

from __future__ import annotations

from typing import Literal

from seatrial.ident.model import (
    INF,
    Input,
    Model,
    Output,
    Parameter,
    ParameterOrigin,
    Sensor,
    Signals,
    State,
    built_in,
    resolve_initial_states,
)
from seatrial.ident.models.published_values import TABLE_1, TABLE_2

HULL = (
    Parameter("m_u", TABLE_1["m_u"], "kg", "surge mass with added mass", "log"),
    Parameter("d_u", TABLE_1["d_u"], "kg/s", "linear surge damping", bounds=(0, INF), step=0.3),
    Parameter("d_uu", TABLE_1["d_uu"], "kg/m", "quadratic surge damping", bounds=(0, INF), step=0.3),
)
BUILT_IN = ParameterOrigin.BUILT_IN
THRUST = (
    Parameter(
        "c1",
        2 * TABLE_2["c1"],
        "N",
        "thrust of both thrusters at full speed, odd part",
        "log",
        free=False,
        origin=BUILT_IN,
    ),
    Parameter(
        "c2",
        2 * TABLE_2["c2"],
        "N",
        "thrust of both thrusters at full speed, even part",
        free=False,
        step=0.1,
        origin=BUILT_IN,
    ),
)
STATES = (
    State("x", "m", "distance along the track", from_output="x", sd0=1.0),
    State("u", "m/s", "surge", "s_u", from_output="u", sd0=0.3),
)
NOISE = Parameter("s_u", 0.01, "m/s/sqrt(s)", "process noise of surge speed", "log")


def surge_model(
    propulsion: Literal["force", "shaft"] = "force",
    measured: Literal["position", "speed", "both"] = "position",
    *,
    hold: Literal["zero", "linear"] = "zero",
) -> Model:
    """Return the model of straight-line motion with the states x [m] and u [m/s].

    Parameters
    ----------
    propulsion : "force" or "shaft"
        Input: force X [N], or shaft speed n (normalised, common to both thrusters).
    measured : "position", "speed" or "both"
        Outputs of the sensors: x [m], u [m/s], or both.
    hold : "zero" or "linear"
        Hold of the input between its samples: constant, or linear interpolation.
    """
    sensors, noise = [], []
    if measured != "speed":
        sensors.append(Sensor("position", (Output("x", "m", "e_x"),)))
        noise.append(Parameter("e_x", 0.05, "m", "noise of the position", "log"))
    if measured != "position":
        sensors.append(Sensor("speed", (Output("u", "m/s", "e_u"),)))
        noise.append(Parameter("e_u", 0.03, "m/s", "noise of the speed", "log"))
    shaft = propulsion == "shaft"
    return Model(
        "surge",
        resolve_initial_states(STATES, sensors),
        (Input("n", "", hold) if shaft else Input("X", "N", hold),),
        tuple(sensors),
        built_in((*HULL, *(THRUST if shaft else ()), NOISE, *noise)),
        (("force", _set_force_of_shaft if shaft else _set_given_force), ("rate", _set_rates), ("output", _set_outputs)),
        source=f"surge:{propulsion}:{measured}",
    )


def _set_force_of_shaft(s: Signals) -> None:
    """Set the thrust ``X_thrust`` [N] from the shaft speed, and the force ``X`` [N] less damping."""
    s.X_thrust = s.p.c1 * s.u.n * abs(s.u.n) + s.p.c2 * s.u.n**2
    _subtract_drag(s)


def _set_given_force(s: Signals) -> None:
    """Set the thrust ``X_thrust`` [N] from the input, and the force ``X`` [N] less damping."""
    s.X_thrust = s.u.X
    _subtract_drag(s)


def _subtract_drag(s: Signals) -> None:
    """Set the force ``X`` [N]: the thrust less linear and quadratic damping."""
    s.X = s.X_thrust - s.p.d_u * s.x.u - s.p.d_uu * abs(s.x.u) * s.x.u


def _set_rates(s: Signals) -> None:
    """Set the rates of the distance x and the speed u."""
    s.rate["x"], s.rate["u"] = s.x.u, s.X / s.p.m_u


def _set_outputs(s: Signals) -> None:
    """Set the outputs x [m] and u [m/s]. The sensors of the model select theirs."""
    s.y["x"], s.y["u"] = s.x.x, s.x.u
