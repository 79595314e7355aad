"""Cross-flow drag: quadratic damping that couples sway and yaw."""

from __future__ import annotations

from seatrial.ident.model import SPEED_WIDTH, YAW_RATE_WIDTH, Effect, Parameter, Signals, smooth_modulus


def couple(s: Signals) -> None:
    """Subtract cross-flow drag from the sway force ``s.Y`` [N] and the yaw moment ``s.N`` [N m], in place.

    The drag is ``d_vr |r| v`` in sway and ``n_vr |v| r`` in yaw. The moduli are smoothed at zero.
    """
    s.Y = s.Y - s.p.d_vr * smooth_modulus(s.x.r, YAW_RATE_WIDTH) * s.x.v
    s.N = s.N - s.p.n_vr * smooth_modulus(s.x.v, SPEED_WIDTH) * s.x.r


EFFECT = Effect(
    name="cross-flow",
    title="cross-flow drag that couples sway and yaw",
    hooks={"force": couple},
    parameters=(
        Parameter("d_vr", 0.0, "kg", "sway drag per |yaw rate|", prior=(0.0, 100.0), step=3.0),
        Parameter("n_vr", 0.0, "kg m", "yaw drag per |sway speed|", prior=(0.0, 60.0), step=2.0),
    ),
    formula="Y -= d_vr |r| v, N -= n_vr |v| r",
    source="Norrbin 1970; Fedyaevsky and Sobolev 1963",
    experiment="tight turns at high and at low speed",
    requires=("hull",),
    alternatives=("sway-yaw", "lift", "turning-resistance"),
)
