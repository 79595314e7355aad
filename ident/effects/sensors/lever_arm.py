"""The GNSS antenna is not over the origin."""

from __future__ import annotations

from typing import Any

from ident.model import Effect, Parameter, Signals
from ident.models import rotations, shift


def move(s: Signals) -> None:
    shift(s, s.p.l_x, s.p.l_y)


def move_tilted(s: Signals) -> None:
    rotations.shift(s, (s.p.l_x, s.p.l_y, s.p.l_z))


ARM = (
    Parameter("l_x", 0.0, "m", "antenna ahead of the origin", prior=(0.0, 1.5), step=0.05),
    Parameter("l_y", 0.0, "m", "antenna to starboard of the origin", prior=(0.0, 1.0), step=0.05),
)
HEIGHT = Parameter("l_z", 0.0, "m", "antenna below the origin", prior=(0.0, 1.0), step=0.05)
SAID: dict[str, Any] = {
    "place": "sensor",
    "source": "Groves 2013, section 2.5",
    "rivals": ("gnss-latency", "cg-offset"),
}
TITLE = "an offset of the GNSS antenna"
EFFECTS = (
    Effect(
        "lever-arm",
        TITLE,
        {"output": move},
        ARM,
        formula="p_measured = p + R(psi) l, v_measured = v + r x R(psi) l",
        experiment="spinning on the spot, both ways round",
        requires=("hull",),
        **SAID,
    ),
    Effect(
        "lever-arm-attitude",
        TITLE,
        {"output": move_tilted},
        (*ARM, HEIGHT),
        formula="p_measured = p + R l, v_measured = v + R (omega x l), R and omega measured",
        experiment="spinning on the spot, both ways round; rolling and pitching for its height",
        requires=("attitude",),
        **SAID,
    ),
)
