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
        "thrust of both thrusters at full speed, mean of ahead and astern",
        "log",
        free=False,
        origin=BUILT_IN,
    ),
    Parameter(
        "c2",
        2 * TABLE_2["c2"],
        "N",
        "thrust of both thrusters at full speed, half of ahead less astern",
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
    """Return the model of straight-line motion: ``m_u u' = X - d_u u - d_uu |u| u`` and ``x' = u``.

    Parameters
    ----------
    propulsion : "force" or "shaft"
        Input of the model. ``force``: surge force X [N]. ``shaft``: normalised shaft speed n, common to both thrusters,
        with ``X = c1 n|n| + c2 n^2``.
    measured : "position", "speed" or "both"
        Outputs of the model: distance x along the track [m], speed u [m/s], or both. Each has its own sensor.
    hold : "zero" or "linear"
        Input between its samples: constant, or linear interpolation.

    Returns
    -------
    Model
        Model with the states x [m] and u [m/s], and initial parameter values from the thesis.
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
    """Set the thrust ``s.X_thrust = c1 n|n| + c2 n^2`` [N] at the input n, and ``s.X`` [N]: the thrust less damping."""
    s.X_thrust = s.p.c1 * s.u.n * abs(s.u.n) + s.p.c2 * s.u.n**2
    _subtract_drag(s)


def _set_given_force(s: Signals) -> None:
    """Set the thrust ``s.X_thrust`` [N] to the input X, and ``s.X`` [N] to the thrust less damping."""
    s.X_thrust = s.u.X
    _subtract_drag(s)


def _subtract_drag(s: Signals) -> None:
    """Set the force ``s.X = X_thrust - d_u u - d_uu |u| u`` [N]: the thrust less damping at the speed u [m/s]."""
    s.X = s.X_thrust - s.p.d_u * s.x.u - s.p.d_uu * abs(s.x.u) * s.x.u


def _set_rates(s: Signals) -> None:
    """Set the time derivatives ``s.rate`` of the states: x' = u [m/s] and u' = X / m_u [m/s2]."""
    s.rate["x"], s.rate["u"] = s.x.u, s.X / s.p.m_u


def _set_outputs(s: Signals) -> None:
    """Set the outputs ``s.y`` to the states x [m] and u [m/s].

    A model that measures only one of them ignores the other.
    """
    s.y["x"], s.y["u"] = s.x.x, s.x.u
