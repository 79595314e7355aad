"""Leak: the mass grows during a run, because water comes into the hull."""

from __future__ import annotations

from seatrial.ident.model import PARAMETERS, Effect, Input, Parameter, Signals


def fill(s: Signals) -> None:
    """Add the water in the hull at the time t since the start of the record to the masses, in place.

    Its mass over ``m_u`` is ``w_before + w_rate t``. It is spread along the hull, so the yaw inertia grows by the same
    share.
    """
    p = s.p
    share = p.w_before + p.w_rate * s.u.t
    water = share * p.m_u
    p.m_u, p.m_v, p.m_r = p.m_u + water, p.m_v + water, p.m_r * (1.0 + share)


EFFECT = Effect(
    name="leak",
    title="a mass that grows during a run (a leak)",
    hooks={PARAMETERS: fill},
    parameters=(
        Parameter(
            "w_before",
            0.0,
            "",
            "water in the hull at the start of a record, over m_u",
            prior=(0.0, 0.1),
            step=0.01,
            per_record=True,
        ),
        Parameter("w_rate", 0.0, "1/s", "growth of the water in the hull, over m_u", prior=(0.0, 0.001), step=2e-5),
    ),
    inputs=(Input("t", "s", "linear"),),
    formula="m_u + w m_u, m_v + w m_u, m_r (1 + w); w = w_before + w_rate t",
    source="added water as payload: Fossen 2011, section 3.3",
    causes="water in the hull, foam or a payload that soaks it up",
    experiment="the same run at the start and at the end of a trial; weigh the boat after it",
    requires=("hull",),
    alternatives=("growing-drag", "battery-sag", "payload-shift"),
)
