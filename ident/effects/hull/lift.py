"""Hull lift: sway and yaw damping in proportion to forward speed, because the hull and its skegs act as a foil."""

from __future__ import annotations

from seatrial.ident.model import SPEED_WIDTH, Effect, Parameter, Signals, smooth_modulus


def damp(s: Signals) -> None:
    """Subtract damping from the sway force ``s.Y`` [N] and the yaw moment ``s.N`` [N m], in place.

    The damping grows with the surge speed u. It is ``Y_uv |u| v`` in sway and ``N_ur |u| r`` in yaw. The modulus is
    smoothed at zero.
    """
    speed = smooth_modulus(s.x.u, SPEED_WIDTH)
    s.Y = s.Y - s.p.Y_uv * speed * s.x.v
    s.N = s.N - s.p.N_ur * speed * s.x.r


EFFECT = Effect(
    name="lift",
    title="hull lift: sway and yaw damping that grows with forward speed",
    hooks={"force": damp},
    parameters=(
        Parameter("Y_uv", 0.0, "kg/m", "sway damping per forward speed", prior=(0.0, 50.0), step=1.0),
        Parameter("N_ur", 0.0, "kg m", "yaw damping per forward speed", prior=(0.0, 30.0), step=0.5),
    ),
    formula="Y -= Y_uv |u| v, N -= N_ur |u| r",
    source="hull lift, Norrbin 1970; Blanke 1981; Fossen 2011, section 6.4",
    experiment="the same zigzag at three forward speeds, and turning on the spot",
    requires=("hull",),
    alternatives=("sway-yaw", "cross-flow"),
)
