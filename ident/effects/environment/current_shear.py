"""Ocean current that changes linearly with the place."""

from __future__ import annotations

from seatrial.ident.model import Effect, Parameter, Signals


def shear(s: Signals) -> None:
    """Add the change of the current from the origin to the place of the boat to the rates of position [m/s].

    The rates of x and y are increased by ``V_xx x + V_xy y`` and ``V_yx x + V_yy y``, in place. The coefficients [1/s]
    are parameters; x and y [m] are north and east of the origin.
    """
    p, x = s.p, s.x
    s.rate["x"] = s.rate["x"] + p.V_xx * x.x + p.V_xy * x.y
    s.rate["y"] = s.rate["y"] + p.V_yx * x.x + p.V_yy * x.y


EFFECT = Effect(
    name="current-shear",
    title="a current that changes with the place",
    place="environment",
    hooks={"rate": shear},
    parameters=tuple(
        Parameter(
            f"V_{axis}{by}",
            0.0,
            "1/s",
            f"change of the current to the {to} per metre to the {along}",
            prior=(0.0, 0.005),
            step=2e-4,
            scales=False,
        )
        for axis, to in (("x", "north"), ("y", "east"))
        for by, along in (("x", "north"), ("y", "east"))
    ),
    formula="V(x, y) = V + (V_xx x + V_xy y, V_yx x + V_yy y)",
    source="shear of a current near a shore or a jetty, to first order in the distance",
    causes="a current that is weaker near a shore or a jetty",
    experiment="drifting without thrust at places that are far apart",
    requires=("plane",),
    alternatives=("current-drift", "wind", "tether", "bank"),
)
