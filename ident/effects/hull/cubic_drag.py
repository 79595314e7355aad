"""Cubic surge damping: wave-making resistance near hull speed."""

from __future__ import annotations

from seatrial.ident.model import Effect, ForceCurve, Parameter, Signals


def resist(s: Signals) -> None:
    """Subtract ``d_uuu u^3``, a drag cubic in the surge speed u, from the surge force ``s.X`` [N], in place."""
    s.X = s.X - s.p.d_uuu * s.x.u * s.x.u * s.x.u


EFFECT = Effect(
    name="cubic-drag",
    title="cubic surge damping (wave-making resistance)",
    hooks={"force": resist},
    parameters=(Parameter("d_uuu", 0.0, "kg s/m2", "cubic surge damping", prior=(0.0, 30.0), step=1.0),),
    formula="X -= d_uuu u^3",
    source="residuary resistance near hull speed (Froude)",
    experiment="long straight runs at five or more speeds up to the highest",
    requires=("hull",),
    parametric_form_of=ForceCurve("X", "u"),
    cannot_be_negative={"d_uuu": "hump"},  # beyond its peak, the resistance falls with the speed
    alternatives=("advance-ratio", "hump", "coulomb"),
)
