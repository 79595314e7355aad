"""Sideslip in turns, for the model without sway: the centrifugal sway velocity, and the speed that it costs."""

from __future__ import annotations

from seatrial.ident.model import INF, Effect, Parameter, Signals


def slide(s: Signals) -> None:
    """Add the time constant of sway ``tau_s`` to ``s.slip_time`` [s], in place.

    A Nomoto model adds the sideslip ``-slip_time u r`` to its disturbance state of the sway.
    """
    s.slip_time = s.slip_time + s.p.tau_s


EFFECT = Effect(
    name="sideslip",
    title="sideslip in turns, and the speed that it costs",
    hooks={"force": slide},
    parameters=(
        Parameter(
            "tau_s",
            0.0,
            "s",
            "sideslip per speed and yaw rate: the time constant of sway",
            prior=(0.0, 1.0),
            bounds=(0.0, INF),
            step=0.02,
        ),
    ),
    formula="v -= tau_s u r, m_u (u' - v r) = X",
    source="steady sway with linear drag, 0 = -m_u u r - d_v v, tau_s = m_u / d_v: Fossen 2011, section 7.1; or"
    " half a time step of a simulator that removes the sway in each step",
    experiment="turning circles at several speeds",
    requires=("nomoto",),
    one_sided=True,
    alternatives=("turn-loss",),
)
