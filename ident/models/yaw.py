"""Turning on the spot (thesis section 6): ``m_r r' + d_r r + d_rr |r| r = N``, nominal values of its Table 1."""

from __future__ import annotations

from typing import Literal

from seatrial.ident.model import INF, Input, Model, Output, Parameter, Sensor, Signals, State, built_in
from seatrial.ident.models.published_values import TABLE_1

HULL = (
    Parameter("m_r", TABLE_1["m_r"], "kg m2", "yaw inertia with added inertia", "log"),
    Parameter("d_r", TABLE_1["d_r"], "kg m2/s", "linear yaw damping", bounds=(0, INF), step=0.1),
    Parameter("d_rr", TABLE_1["d_rr"], "kg m2", "quadratic yaw damping", bounds=(0, INF), step=0.1),
    Parameter("s_r", 0.01, "rad/s/sqrt(s)", "process noise of yaw rate", "log"),
)
GYRO = Parameter("e_r", 0.005, "rad/s", "noise of the yaw gyro", "log")
COMPASS = Parameter("e_psi", 0.01, "rad", "noise of the heading", "log")


def yaw_model(measured: Literal["rate", "both"] = "rate", *, hold: Literal["zero", "linear"] = "zero") -> Model:
    """Return the model of turning on the spot: ``m_r r' = N - d_r r - d_rr |r| r``, with the input N [N m].

    Parameters
    ----------
    measured : "rate" or "both"
        Outputs of the model. ``rate``: the yaw rate r [rad/s]. ``both``: also the heading psi [rad], which is then a
        second state.
    hold : "zero" or "linear"
        Input between its samples: constant, or linear interpolation.

    Returns
    -------
    Model
        Model with initial parameter values from the thesis.
    """
    heading = measured == "both"
    states = [State("r", "rad/s", "yaw rate", "s_r", from_output="r", sd0=0.1)]
    sensors = [Sensor("gyro", (Output("r", "rad/s", "e_r"),))]
    if heading:
        states.append(State("psi", "rad", "heading", from_output="psi", sd0=0.1))
        sensors.append(Sensor("attitude", (Output("psi", "rad", "e_psi", angle=True),)))
    return Model(
        "yaw",
        tuple(states),
        (Input("N", "N m", hold),),
        tuple(sensors),
        built_in((*HULL, GYRO, *((COMPASS,) if heading else ()))),
        (("force", _set_moment), ("rate", _set_rates), ("output", _set_outputs)),
        source=f"yaw:{measured}",
    )


def _set_moment(s: Signals) -> None:
    """Set the yaw moment less damping, ``s.N = N - d_r r - d_rr |r| r`` [N m], from the input N and the yaw rate r."""
    s.N = s.u.N - s.p.d_r * s.x.r - s.p.d_rr * abs(s.x.r) * s.x.r


def _set_rates(s: Signals) -> None:
    """Set the time derivatives ``s.rate``: r' = N / m_r and psi' = r.

    A model without the state psi ignores the latter.
    """
    s.rate["r"] = s.N / s.p.m_r
    s.rate["psi"] = s.x.r


def _set_outputs(s: Signals) -> None:
    """Set the outputs ``s.y``: yaw rate r [rad/s] and heading psi [rad].

    In a model without the state psi, the output psi is zero, and no sensor of the model measures it.
    """
    s.y["r"] = s.x.r
    s.y["psi"] = getattr(s.x, "psi", 0.0)
