"""GNSS lever arm: the antenna is not at the origin of the body frame."""

from __future__ import annotations

from typing import Any

from seatrial.ident.model import Effect, Estimates, Parameter, Signals, directed_size
from seatrial.ident.models import rotations, shift


def move(s: Signals) -> None:
    """Move the outputs of position and velocity over ground from the origin to the GNSS antenna, in place.

    This is for a level boat. The antenna is ``l_x`` forward and ``l_y`` to starboard of the origin of the body frame
    [m]. If the position of the antenna was given, they are the distances from this position.
    """
    shift(s, s.p.l_x, s.p.l_y)


def move_tilted(s: Signals) -> None:
    """Move the outputs of position and velocity over ground from the origin to the GNSS antenna, in place.

    This is for models with measured roll and pitch. The antenna is ``l_x`` forward, ``l_y`` to starboard and ``l_z``
    below the origin of the body frame [m]. If the position of the antenna was given, they are the distances from it.
    """
    rotations.shift(s, (s.p.l_x, s.p.l_y, s.p.l_z))


DIRECTIONS = {
    "l_x": ("farther forward", "farther aft"),
    "l_y": ("farther to starboard", "farther to port"),
    "l_z": ("farther down", "farther up"),
}


def place(estimates: Estimates) -> str:
    """Return a clause for reports: the distances [m] of the antenna from its given position, with their directions."""
    *first, last = [directed_size(estimates[n], "m", *words) for n, words in DIRECTIONS.items() if n in estimates]
    return f"the antenna is {', '.join(first)} and {last} than was given"


ARM = (
    Parameter("l_x", 0.0, "m", "antenna forward of its given position, or of the origin", prior=(0.0, 1.5), step=0.05),
    Parameter(
        "l_y", 0.0, "m", "antenna to starboard of its given position, or of the origin", prior=(0.0, 1.0), step=0.05
    ),
)
HEIGHT = Parameter(
    "l_z", 0.0, "m", "antenna below its given position, or below the origin", prior=(0.0, 1.0), step=0.05
)
COMMON: dict[str, Any] = {
    "place": "sensor",
    "source": "Groves 2013, section 2.5",
    "causes": "the position of the antenna in the rig file or import map, an antenna that was moved",
    "alternatives": ("gnss-latency", "cg-offset"),
    "in_words": place,
}
EFFECTS = (
    Effect(
        "lever-arm",
        "a GNSS antenna lever arm",
        {"output": move},
        ARM,
        formula="p_measured = p + R(psi) l, v_measured = v + r x R(psi) l",
        experiment="turning on the spot, in both directions",
        requires=("hull",),
        **COMMON,
    ),
    Effect(
        "lever-arm-attitude",
        "a GNSS antenna lever arm, in a model with measured attitude",
        {"output": move_tilted},
        (*ARM, HEIGHT),
        formula="p_measured = p + R l, v_measured = v + R (omega x l), R and omega measured",
        experiment="turning on the spot, in both directions; roll and pitch motion for the height of the antenna",
        requires=("attitude",),
        **COMMON,
    ),
)
