"""The GNSS antenna is not over the origin."""

from __future__ import annotations

from ident.model import Effect, Signals
from ident.models.known import shift
from ident.params import Parameter


def move(s: Signals) -> None:
    shift(s, s.p.l_x, s.p.l_y)


EFFECT = Effect(
    name="lever-arm",
    title="an offset of the GNSS antenna",
    place="sensor",
    hooks={"output": move},
    parameters=(
        Parameter("l_x", 0.0, "m", "antenna ahead of the origin", prior=(0.0, 1.5), step=0.05),
        Parameter("l_y", 0.0, "m", "antenna to starboard of the origin", prior=(0.0, 1.0), step=0.05),
    ),
    formula="p_measured = p + R(psi) l, v_measured = v + r x R(psi) l",
    source="Groves 2013, section 2.5",
    experiment="spinning on the spot, both ways round",
    requires=("hull",),
    rivals=("gnss-latency", "cg-offset"),
)
