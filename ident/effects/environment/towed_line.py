"""Line that the boat tows at its stern, such as an umbilical: it trails behind and follows turns late."""

from __future__ import annotations

import numpy as np

from seatrial.ident.model import INF, Effect, Parameter, Signals, State, smooth_modulus

SLOW = 0.1  # m/s; the modulus of the speed is rounded below it, because a Kalman filter needs its derivative


def pull(s: Signals) -> None:
    """Add the pull of the line to the forces [N] and to the yaw moment [N m], in place.

    The tension is ``k_line`` times the squared velocity of the tow point along the line. It is zero if the tow point
    moves towards the line.
    """
    p, x = s.p, s.x
    along = x.u * np.cos(x.line) + (x.v + p.x_line * x.r) * np.sin(x.line)
    tension = p.k_line * along * (along + np.sqrt(along * along + 1e-6)) / 2
    sideways = tension * np.sin(x.line)
    s.X = s.X - tension * np.cos(x.line)
    s.Y = s.Y - sideways
    s.N = s.N - p.x_line * sideways


def trail(s: Signals) -> None:
    """Set the rate of the angle of the line [rad/s]: the line turns as a rod that is dragged at one end (tractrix).

    The angle also decays towards the stern if the boat moves astern. A line that is pushed would fold, and its angle
    would have no stable value; it has no tension then.
    """
    p, x = s.p, s.x
    across = (x.v + p.x_line * x.r) * np.cos(x.line) - smooth_modulus(x.u, SLOW) * np.sin(x.line)
    s.rate["line"] = across / p.l_line - x.r


EFFECT = Effect(
    name="towed-line",
    title="a line or umbilical that the boat tows",
    place="environment",
    hooks={"force": pull, "rate": trail},
    parameters=(
        Parameter(
            "k_line",
            0.0,
            "kg/m",
            "drag of the line per squared speed",
            prior=(0.0, 10.0),
            bounds=(0.0, INF),
            step=0.3,
        ),
        Parameter("l_line", 8.0, "m", "length of the line", "log", prior=(8.0, 6.0), bounds=(0.3, 200.0)),
        Parameter("x_line", -0.5, "m", "position of the tow point forward of the origin", prior=(-0.5, 0.3), step=0.05),
    ),
    states=(State("line", "rad", "direction of the pull on the line, from the bow", 0.0, sd0=0.3),),
    scan={"l_line": (1.0, 3.0, 8.0, 20.0)},
    formula="F = -k V^2 (V >= 0) at x_line along the line, V the velocity of the tow point along the line, "
    "a' = (v + x_line r) cos(a) / l - |u| sin(a) / l - r its angle from the bow",
    source="quasi-steady towing of a short line (tractrix); Faltinsen 1990, chapter 8",
    experiment="zigzags and turns at several speeds, with and without the line",
    requires=("hull",),
    one_sided=True,
    alternatives=("tether", "yaw-bias", "sway-yaw", "cg-offset", "turning-resistance"),
)
