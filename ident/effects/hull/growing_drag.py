"""Growing drag: the surge drag rises during a run, because weed collects on the hull or the thrusters."""

from __future__ import annotations

from seatrial.ident.model import PARAMETERS, Effect, Input, Parameter, Signals


def grow(s: Signals) -> None:
    """Multiply the surge damping by its growth until the time t since the start of the record, in place.

    The factor is ``1 + g_before + g_rate t``.
    """
    p = s.p
    factor = 1.0 + p.g_before + p.g_rate * s.u.t
    p.d_u, p.d_uu = p.d_u * factor, p.d_uu * factor


EFFECT = Effect(
    name="growing-drag",
    title="a surge drag that grows during a run (weed)",
    hooks={PARAMETERS: grow},
    parameters=(
        Parameter(
            "g_before",
            0.0,
            "",
            "added share of the surge damping at the start of a record",
            prior=(0.0, 0.3),
            step=0.02,
            per_record=True,
        ),
        Parameter("g_rate", 0.0, "1/s", "growth of this share", prior=(0.0, 0.003), step=5e-5),
    ),
    inputs=(Input("t", "s", "linear"),),
    formula="d_u (1 + g), d_uu (1 + g); g = g_before + g_rate t",
    source="growth of resistance with time: Fossen 2011, section 6.4 (friction); see also the effect tether",
    causes="weed that collects, a cover that comes loose",
    experiment="the same straight run at the start and at the end of a trial; look at hull and propellers after it",
    requires=("hull",),
    alternatives=("leak", "battery-sag", "tether", "current-drift"),
)
