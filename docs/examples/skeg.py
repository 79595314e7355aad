"""Effect of a skeg: lateral drag at a distance behind the centre of gravity."""

from seatrial.ident.model import INF, Effect, Parameter, Signals


def drag(s: Signals) -> None:
    """Add force Y [N] and moment N [N m] of the lateral drag. The skeg moves sideways at v - l r."""
    w = s.x.v - s.p.l_skeg * s.x.r
    Y = -s.p.d_skeg * abs(w) * w
    s.Y = s.Y + Y
    s.N = s.N - s.p.l_skeg * Y


EFFECT = Effect(
    name="skeg",
    title="a skeg or drag aft",
    place="hull",
    hooks={"force": drag},
    parameters=(
        Parameter("d_skeg", 0.0, "kg/m", "lateral drag of the skeg", prior=(0.0, 60.0), bounds=(0.0, INF), step=5.0),
        Parameter("l_skeg", 0.9, "m", "distance of the skeg behind the origin", prior=(0.9, 0.4), step=0.2),
    ),
    requires=("hull",),
    one_sided=True,
    alternatives=("cross-flow",),
)
