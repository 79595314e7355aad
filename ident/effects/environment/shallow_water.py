"""Drag that changes with the place, as over a shoal or among weed."""

from __future__ import annotations

from seatrial.ident.model import Effect, Parameter, Signals


def drag(s: Signals) -> None:
    """Subtract a quadratic drag [N] that changes with the place from the surge force ``s.X``, in place.

    The drag is ``(d_north x + d_east y) u |u|`` at the place x, y [m] north and east of the origin, with the surge
    speed u.
    """
    p, x = s.p, s.x
    s.X = s.X - (p.d_north * x.x + p.d_east * x.y) * x.u * abs(x.u)


EFFECT = Effect(
    name="shallow-water",
    title="a drag that changes with the place, as over a shoal",
    place="environment",
    hooks={"force": drag},
    parameters=tuple(
        Parameter(f"d_{axis}", 0.0, "kg/m2", f"increase of d_uu per metre to the {axis}", prior=(0.0, 0.2), step=5e-3)
        for axis in ("north", "east")
    ),
    formula="X -= (d_north x + d_east y) u|u|",
    source="resistance in shallow water: Lackenby 1963, to first order in the distance",
    causes="a part of the area that is shallow",
    experiment="straight runs at one level of thrust over the shoal and beside it",
    requires=("hull",),
    fixed_point=True,
    alternatives=("tether", "bank", "wind", "current-shear"),
)
