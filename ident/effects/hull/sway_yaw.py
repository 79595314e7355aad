"""Linear sway-yaw damping coupling (Y_r, N_v), with the part that grows with forward speed."""

from __future__ import annotations

from seatrial.ident.model import SPEED_WIDTH, Effect, Parameter, Signals, smooth_modulus


def couple(s: Signals) -> None:
    """Subtract the coupling in damping from the sway force ``s.Y`` [N] and the yaw moment ``s.N`` [N m], in place.

    It is ``(Y_r + Y_ur |u|) r`` in sway and ``(N_v + N_uv |u|) v`` in yaw. The modulus is smoothed at zero.
    """
    speed = smooth_modulus(s.x.u, SPEED_WIDTH)
    s.Y = s.Y - (s.p.Y_r + s.p.Y_ur * speed) * s.x.r
    s.N = s.N - (s.p.N_v + s.p.N_uv * speed) * s.x.v


EFFECT = Effect(
    name="sway-yaw",
    title="linear sway-yaw damping coupling (Y_r, N_v)",
    hooks={"force": couple},
    parameters=(
        Parameter("Y_r", 0.0, "kg m/s", "sway force per yaw rate", prior=(0.0, 30.0), step=1.0),
        Parameter("N_v", 0.0, "kg m/s", "yaw moment per sway speed", prior=(0.0, 30.0), step=1.0),
        Parameter("Y_ur", 0.0, "kg", "sway force per yaw rate and forward speed", prior=(0.0, 30.0), step=1.0),
        Parameter("N_uv", 0.0, "kg", "yaw moment per sway and forward speed", prior=(0.0, 30.0), step=1.0),
    ),
    formula="Y -= (Y_r + Y_ur |u|) r, N -= (N_v + N_uv |u|) v",
    source="Fossen 2011, section 6.4; the part that grows with speed is hull lift, Norrbin 1970",
    experiment="zigzags at several speeds, and drifting sideways after a turn",
    requires=("hull",),
    alternatives=("cg-offset", "cross-flow", "lift"),
)
