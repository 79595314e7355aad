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
    """Return the model of turning on the spot. The input is the moment N [N m].

    Parameters
    ----------
    measured : "rate" or "both"
        Sensors: yaw rate r [rad/s], or also the heading psi [rad], which is then a second state.
    hold : "zero" or "linear"
        Hold of the input between its samples: constant, or linear interpolation.
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
    """Set the yaw moment ``N`` [N m]: the input less linear and quadratic damping."""
    s.N = s.u.N - s.p.d_r * s.x.r - s.p.d_rr * abs(s.x.r) * s.x.r


def _set_rates(s: Signals) -> None:
    """Set the rates of the yaw rate and of the heading. The latter is ignored in a model without heading."""
    s.rate["r"] = s.N / s.p.m_r
    s.rate["psi"] = s.x.r


def _set_outputs(s: Signals) -> None:
    """Set the outputs r [rad/s] and psi [rad]. In a model without heading, psi is zero and no sensor selects it."""
    s.y["r"] = s.x.r
    s.y["psi"] = getattr(s.x, "psi", 0.0)
